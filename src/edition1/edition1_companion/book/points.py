"""Notebooks at points of their parameters, each run once, whatever is interrupted in between.

The pages of the book and the points of a sweep are run by the same functions. A point whose record has its key (see
:mod:`edition1_companion.book.provenance`) is finished and not run again. While a point runs, its process holds a lock:
where the build, the sweep or the worker that started it dies, the process goes on, and whoever comes next waits for
it and finds its record.
"""

from __future__ import annotations

import fcntl
import json
import os
import shutil
import subprocess
import sys
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from edition1_companion.book.digests import file_digest
from edition1_companion.book.provenance import Record, read_record, record_path
from edition1_companion.recordings.sources import data_dir

QUIET = "ignore:resource_tracker:UserWarning"
BESIDE_OTHERS = {"REPRO_PROCESSES": "1"}
"""Environment of a notebook that runs beside others: the cores are taken, and more processes only load libraries."""
_ONE_THREAD = ("OMP", "MKL", "OPENBLAS", "NUMEXPR", "VECLIB_MAXIMUM", "NUMBA")


@dataclass(frozen=True)
class Point:
    """One run of a notebook."""

    index: int
    """Place in the grid, or among the pages, from 0."""
    parameters: dict[str, Any]
    """Values that differ from the notebook's own."""
    key: str
    """What :func:`~edition1_companion.book.provenance.notebook_key` says."""
    notebook: Path
    """What is run, absolute."""
    output: Path
    """The executed notebook, absolute."""
    results: Path
    """Folder of tables and record, absolute."""
    failed: Path
    """Where the partial notebook is kept on failure."""
    lock: Path
    """File that is locked while it runs."""
    here: Path
    """Folder that the run is started in."""
    environment: dict[str, str]
    """What the process finds in its environment besides that of the worker."""
    announced: bool = False
    """Whether a line says when it starts and ends."""

    def command(self) -> list[str]:
        """Return the command that runs this point."""
        places = map(str, (self.notebook, self.output, self.results, self.failed))
        return [
            sys.executable,
            "-m",
            "edition1_companion.book.runner",
            *places,
            json.dumps(self.parameters),
        ]

    def label(self) -> str:
        """Return the point as a reader names it: ``n=2 seed=0``."""
        return " ".join(f"{name}={json.dumps(value)}" for name, value in self.parameters.items())


def environment_of_runs(*names: str) -> dict[str, str]:
    """Return where recordings are, and those of the environment variables that are set here."""
    given = {name: os.environ[name] for name in names if name in os.environ}
    return {"REPRO_DATA_DIR": str(data_dir()), **given}


def one_thread() -> dict[str, str]:
    """Return the environment in which the libraries that compute use one thread: sums then have one order."""
    return {name + ("_THREADS" if "MAX" in name else "_NUM_THREADS"): "1" for name in _ONE_THREAD}


@dataclass(frozen=True)
class Outcome:
    """What became of a point."""

    index: int
    failure: str = ""
    """Why it has no result; empty when it has."""


class RunnerGone(Exception):
    """What runs the points is gone; the message says what it was."""


class Stopped(Exception):
    """Runs were stopped before their end, as the message says; what is finished is kept.

    Parameters
    ----------
    why
        The message.
    failures
        Index to reason of every point that failed before.
    """

    def __init__(self, why: str, failures: dict[int, str]) -> None:
        super().__init__(why)
        self.failures = failures


Runner = Callable[[Sequence[Point]], Iterable[Outcome]]
"""Runs points in any order, side by side."""


def finished(point: Point) -> Record | None:
    """Return the record of a finished point; None if there is none of this key, or what it made has changed."""
    record = read_record(record_path(point.output))
    if record is None or record.key != point.key:
        return None
    made = {point.results / name: digest for name, digest in record.results.items()}
    made[point.output] = record.executed
    return record if all(path.is_file() and file_digest(path) == made[path] for path in made) else None


def run_point(point: Point, environment: Mapping[str, str] | None = None) -> Outcome:
    """Run a point in a process of its own unless it is finished; wait if another process runs it already.

    Parameters
    ----------
    point
        What to run.
    environment
        Of that process, that of this one when not given. A worker may be older than the environment of who calls.
    """
    try:
        point.results.mkdir(parents=True, exist_ok=True)
        point.lock.parent.mkdir(parents=True, exist_ok=True)
        with point.lock.open("w") as lock:
            fcntl.flock(lock, fcntl.LOCK_EX)
            done = finished(point)
            return Outcome(point.index, "" if done else _run(point, environment or os.environ, lock.fileno()))
    except Exception as error:  # a point that cannot be run must not end the others
        return Outcome(point.index, f"{type(error).__name__}: {error}")


def _run(point: Point, environment: Mapping[str, str], lock: int) -> str:
    for path in point.output.parent.glob(f".{point.output.stem}-*"):  # left by a run that was killed
        shutil.rmtree(path) if path.is_dir() else path.unlink()
    started = time.monotonic()
    _announce(point, "started")
    done = subprocess.run(
        point.command(),
        cwd=point.here,
        env={**environment, **point.environment},
        stdin=subprocess.DEVNULL,
        capture_output=True,
        text=True,
        errors="replace",
        check=False,
        # the lock belongs to whoever has the file open: it outlives this process, not that one
        pass_fds=[lock],
    )
    ended = "failed after" if done.returncode else "done in"
    _announce(point, f"{ended} {time.monotonic() - started:.1f} s")
    if done.returncode:
        code = done.returncode
        ended = f"ended by signal {-code}" if code < 0 else f"exit {code}"
        return done.stdout.strip() or done.stderr.strip() or ended
    if not finished(point):
        return "it ran with another package, data, lock or libraries than it was planned with"
    return ""


def _announce(point: Point, what: str) -> None:
    if point.announced:  # one write per line: lines of several processes must not mix
        print(f"{point.notebook.stem}: {what}\n", end="", flush=True)


def local_runner(jobs: int | None) -> Runner:
    """Return a runner of ``jobs`` processes at a time on this computer, as many as there are cores when not given."""

    def run(points: Sequence[Point]) -> Iterator[Outcome]:
        import joblib

        # The tracker of loky's locks, a process of its own, warns of those that are cleared away while it is stopped.
        given = os.environ.get("PYTHONWARNINGS", "")
        if QUIET not in given:
            os.environ["PYTHONWARNINGS"] = f"{given},{QUIET}".lstrip(",")
        parallel = joblib.Parallel(
            n_jobs=min(jobs or joblib.cpu_count(), len(points)),
            backend="loky",
            batch_size=1,
            return_as="generator_unordered",
        )
        here = dict(os.environ)
        yield from parallel(joblib.delayed(run_point)(point, here) for point in points)

    return run


def run_points(points: Sequence[Point], runner: Runner, *, progress: bool = False) -> dict[int, str]:
    """Run the points that are not finished.

    Parameters
    ----------
    points
        What to run.
    runner
        From :func:`local_runner`, or of a cluster.
    progress
        Draw a progress bar.

    Returns
    -------
    dict
        Index to reason of every point that has no result now.

    Raises
    ------
    Stopped
        On an interruption from the keyboard or a request to terminate (see
        :func:`~edition1_companion.book.runner.stop_on_termination`), or where the scheduler of a cluster goes away.
    """
    from tqdm import tqdm

    todo = [point for point in points if not finished(point)]
    reasons = {point.index: "not run, because a worker process was killed: try again" for point in todo}
    told: dict[int, str] = {}
    with tqdm(total=len(points), initial=len(points) - len(todo), unit="point", disable=not progress) as bar:
        try:
            for outcome in runner(todo) if todo else ():
                told[outcome.index] = outcome.failure
                bar.update()
        except BrokenProcessPool:
            pass  # what was running goes on and is found by the next call
        except (KeyboardInterrupt, SystemExit, RunnerGone) as stop:
            failures = {index: reason for index, reason in told.items() if reason}
            why = str(stop) if isinstance(stop, RunnerGone) else "Interrupted"
            raise Stopped(why, failures) from stop
    return {index: reason for index, reason in (reasons | told).items() if reason}
