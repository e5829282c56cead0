"""A sweep: one ``repro run`` for every point of a grid, each run once, whatever is interrupted in between.

The outputs of a point lie in a folder named by its key (see :mod:`repro_companion.book.provenance`). A point whose
record has that key is finished and not run again. While a point runs, its process holds a lock on the folder: where
the sweep or the worker that started it dies, the process goes on, and whoever comes next waits for it and finds its
record.
"""

from __future__ import annotations

import fcntl
import os
import shutil
import subprocess
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from repro.errors import bad_input
from repro_companion.book.digests import file_digest
from repro_companion.book.project import Project
from repro_companion.book.provenance import Record, notebook_key, read_inputs, read_record, record_path
from repro_companion.book.sweep_grid import OWNER, value_text
from repro_companion.recordings.sources import data_dir

LOCK = ".lock"
QUIET = "ignore:resource_tracker:UserWarning"
_ONE_THREAD = ("OMP_NUM_THREADS", "MKL_NUM_THREADS", "OPENBLAS_NUM_THREADS", "NUMBA_NUM_THREADS")


@dataclass(frozen=True)
class Point:
    """One run of a notebook."""

    index: int
    """Place in the grid, from 0."""
    parameters: dict[str, Any]
    """Values of the parameters that are swept."""
    key: str
    """What :func:`~repro_companion.book.provenance.notebook_key` says."""
    notebook: Path
    """What is run, absolute."""
    output: Path
    """The executed notebook, absolute; tables and record lie beside it."""
    here: Path
    """Folder that ``repro run`` is called in."""
    data: Path
    """Folder of the recordings."""

    def command(self) -> list[str]:
        """Return the ``repro run`` of this point."""
        given = [x for name, value in self.parameters.items() for x in ("-p", name, value_text(value))]
        module = [sys.executable, "-m", "repro_companion.cli", "run"]
        return [*module, str(self.notebook), *given, "-o", str(self.output)]

    def label(self) -> str:
        """Return the point as a reader names it: ``n=2 seed=0``."""
        return " ".join(f"{name}={value_text(value)}" for name, value in self.parameters.items())


@dataclass(frozen=True)
class Outcome:
    """What became of a point."""

    index: int
    failure: str = ""
    """Why it has no result; empty when it has."""


class RunnerGone(Exception):
    """What runs the points is gone; the message says what it was."""


class SweepStopped(Exception):
    """A sweep was stopped before its end, as the message says; what is finished is kept.

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


def check_folder(folder: Path, project: Project) -> None:
    """Refuse a folder for a sweep that belongs to the book, or is a file.

    Raises
    ------
    InputError
        If it does.
    """
    if owner := project.owner_of(folder):
        raise bad_input("output", OWNER, f"outside {owner}/, which belongs to the book", folder)
    if folder.exists() and not folder.is_dir():
        raise bad_input("output", OWNER, "a folder", folder)


def plan(notebook: Path, grid: Sequence[Mapping[str, Any]], folder: Path, project: Project) -> list[Point]:
    """Return the points of a sweep, each with its key and its place ``points/<16 digits of the key>/``.

    Parameters
    ----------
    notebook
        What is run.
    grid
        Parameters of every point, from :func:`~repro_companion.book.sweep_grid.grid_points`.
    folder
        Of the sweep.
    project
        Whose package, data and lock the keys name.
    """
    inputs, here, data = read_inputs(project), Path.cwd(), data_dir()
    points = []
    for index, parameters in enumerate(grid):
        key = notebook_key(notebook, parameters, inputs, project)
        output = folder.absolute() / "points" / key[:16] / f"{notebook.stem}.ipynb"
        points.append(Point(index, dict(parameters), key, notebook.absolute(), output, here, data))
    return points


def finished(point: Point) -> Record | None:
    """Return the record of a finished point; None if there is none of this key, or a table is not as recorded."""
    folder = point.output.parent
    record = read_record(record_path(folder, point.output.stem))
    if record is None or record.key != point.key:
        return None
    for name, digest in record.results.items():
        path = folder / name
        if not path.is_file() or file_digest(path) != digest:
            return None
    return record


def run_point(point: Point) -> Outcome:
    """Run a point in a process of its own unless it is finished; wait if another process runs it already."""
    try:
        return Outcome(point.index, _run(point))
    except Exception as error:  # a point that cannot be run must not end the sweep
        return Outcome(point.index, f"{type(error).__name__}: {error}")


def _run(point: Point) -> str:
    folder = point.output.parent
    folder.mkdir(parents=True, exist_ok=True)
    with (folder / LOCK).open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        if finished(point):
            return ""
        for path in [x for x in folder.iterdir() if x.name.startswith(".") and x.name != LOCK]:
            shutil.rmtree(path) if path.is_dir() else path.unlink()  # left by a run that was killed
        environment = os.environ | dict.fromkeys(_ONE_THREAD, "1") | {"REPRO_DATA_DIR": str(point.data)}
        done = subprocess.run(
            point.command(),
            cwd=point.here,
            env=environment,
            stdin=subprocess.DEVNULL,
            capture_output=True,
            text=True,
            check=False,
            # the lock belongs to whoever has the file open: it outlives this process, not that one
            pass_fds=[lock.fileno()],
        )
        if done.returncode:
            ended = (
                f"ended by signal {-done.returncode}" if done.returncode < 0 else f"exit {done.returncode}"
            )
            return done.stderr.strip() or ended
        if not finished(point):
            return "it ran with another package, data, lock or libraries than the sweep was planned with"
    return ""


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
        yield from parallel(joblib.delayed(run_point)(point) for point in points)

    return run


def run_points(points: Sequence[Point], runner: Runner, *, progress: bool = False) -> dict[int, str]:
    """Run the points that are not finished.

    Parameters
    ----------
    points
        From :func:`plan`.
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
    SweepStopped
        On an interruption from the keyboard or a request to terminate (see
        :func:`~repro_companion.book.runner.stop_on_termination`), or where the scheduler of a cluster goes away.
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
            raise SweepStopped(why, failures) from stop
    return {index: reason for index, reason in (reasons | told).items() if reason}
