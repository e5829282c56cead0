"""Run a notebook with parameters: whole or not at all, with a record of what it was made from.

A notebook declares its parameters in the cell tagged ``parameters``, one a line: ``name: type = default  # meaning``.
The meaning may end in what is allowed: ``, at least 1``, ``, above 0 and at most 10``, ``, 0 to 10`` or
``, one of: a, b``.
"""

from __future__ import annotations

import datetime
import difflib
import hashlib
import importlib.metadata
import itertools
import json
import operator
import os
import platform
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from repro.common import InputError, bad_input, cache_folder, require

Json = Any
"""A value of a parameter, or what else JSON can hold."""
Record = dict[str, Json]
"""What a run was made from, and what it wrote."""
PACKAGES = ("repro", "repro_board", "repro_companion")
SOURCES = ("src", "notebooks", "data", "requirements.lock")
"""What the numbers of a page depend on; the tables that pages write, in results/, are none of it."""
LIBRARIES = ("numpy", "numba", "scipy", "magpylib", "matplotlib", "pandas", "papermill", "torch")
KINDS = {
    "int": "a whole number, such as 3",
    "float": "a number, such as 1e-3",
    "str": "a text",
    "bool": "true or false",
    "list": 'a list, such as [1, 2] or ["a", "b"]',
    "dict": 'a dictionary, such as {"a": 1}',
}
READERS: dict[str, Callable[[str], Json]] = {
    "int": int,
    "float": float,
    "str": str,
    "bool": lambda text: {"true": True, "false": False}[text.lower()],
    "list": json.loads,
    "dict": json.loads,
}
"""How a typed text becomes a value of each kind."""
BOUNDS = {"at least": operator.ge, "above": operator.gt, "at most": operator.le, "below": operator.lt}
_NUMBER = r"[-+]?[\d.]+(?:e[-+]?\d+)?"
_BOUND = rf"(?:{'|'.join(BOUNDS)}) {_NUMBER}"
_RULE = re.compile(
    rf",\s*(one of: [^\[\]]+|{_NUMBER} to {_NUMBER}|{_BOUND}(?: and {_BOUND})?)\s*(?:\[[^]]*\])?$"
)
_ONE_THREAD = ("OMP_NUM", "MKL_NUM", "OPENBLAS_NUM", "NUMEXPR_NUM", "NUMBA_NUM", "VECLIB_MAXIMUM")


class RunFailed(Exception):
    """A notebook stopped before its end; the message names the cell and the partial notebook."""


@dataclass(frozen=True)
class Parameter:
    """A parameter as its notebook declares it."""

    name: str
    kind: str
    default: str
    meaning: str

    @property
    def rule(self) -> str:
        """Return which values are allowed, as the comment says it; empty where it does not."""
        found = _RULE.search(self.meaning)
        return found[1].strip() if found else ""

    def allows(self, value: Json) -> bool:
        """Return whether the rule allows a value; in a list it holds for each."""
        values = value if self.kind == "list" else [value]
        if self.rule.startswith("one of: "):
            return {typed(one) for one in values} <= set(self.rule[8:].split(", "))
        low, to, high = self.rule.partition(" to ")
        ends = f"at least {low} and at most {high}" if to else self.rule
        bounds = re.findall(rf"({'|'.join(BOUNDS)}) (\S+)", ends)
        numbers = all(type(one) in (int, float) for one in values)
        within = (BOUNDS[word](one, float(bound)) for word, bound in bounds for one in values)
        return not bounds or (numbers and all(within))


def project_folder() -> Path:
    """Return the checkout that the current folder is in."""
    here = Path.cwd()
    for folder in (here, *here.parents):
        if (folder / "data" / "published").is_dir():
            return folder
    raise bad_input("current folder", "repro", "inside a checkout of the project", here)


def check_place(output: Path, root: Path, notebook: Path | None = None) -> None:
    """Refuse an output among the sources and tables of the book, and for a run one that is no notebook's name."""
    own = ("book", "notebooks", "results", "data", "src")
    inside = next((name for name in own if output.resolve().is_relative_to((root / name).resolve())), "")
    require(not inside, "output", "repro", f"outside {inside}/, which belongs to the book", output)
    named = (
        output.suffix == ".ipynb" and not output.is_dir() and output.resolve() != (notebook or root).resolve()
    )
    require(notebook is None or named, "output", "repro", "another file whose name ends in .ipynb", output)
    folder = output.absolute() if notebook is None else output.absolute().parent
    lowest = next(path for path in (folder, *folder.parents) if os.path.lexists(path))
    require(
        lowest.is_dir(),
        "output",
        "repro",
        "in folders, there already or new",
        f"{output}: {lowest.name} is a file",
    )


def declared(notebook: Path) -> dict[str, Parameter]:
    """Return the parameters that a notebook declares."""
    from papermill import inspect_notebook

    require(notebook.is_file(), "notebook", "repro run", "an existing file", notebook)
    try:
        found = inspect_notebook(notebook)
    except Exception as error:
        raise bad_input("notebook", "repro run", "a Jupyter notebook", f"{notebook} ({error})") from error
    parameters = {}
    for name, one in found.items():
        kind = one["inferred_type_name"].partition("[")[0].strip()
        require(kind in KINDS, f"parameter {name}", notebook.name, f"one of {', '.join(KINDS)}", kind)
        parameters[name] = Parameter(name, kind, one["default"], one["help"].strip())
    return parameters


def listing(parameters: Mapping[str, Parameter]) -> str:
    """Return one line for each parameter."""
    return "\n".join(
        f"  {one.name}: {one.kind} = {one.default}  {one.meaning}" for one in parameters.values()
    )


def chosen(
    parameters: Mapping[str, Parameter], given: Sequence[tuple[str, str]], owner: str
) -> list[tuple[Parameter, str]]:
    """Return the given parameters with their texts; one that does not exist is refused with the nearest that does."""
    found: dict[str, tuple[Parameter, str]] = {}
    for name, text in given:
        if name not in parameters:
            near = difflib.get_close_matches(name, parameters, 1, 0.0)
            mean = f"; did you mean {near[0]}?\nThe parameters are\n{listing(parameters)}" if near else "."
            raise InputError(f"{owner} has no parameter {name}{mean}")
        require(name not in found, f"parameter {name}", owner, "given once", f"{text} as well")
        found[name] = parameters[name], text
    return list(found.values())


def converted(
    parameters: Mapping[str, Parameter], given: Sequence[tuple[str, str]], owner: str
) -> dict[str, Json]:
    """Return typed texts as values of the declared types, each allowed by its rule."""
    return {one.name: value_of(one, text, owner) for one, text in chosen(parameters, given, owner)}


def value_of(parameter: Parameter, text: str, owner: str) -> Json:
    """Return a typed text as a value of its parameter, or refuse it."""
    try:
        value = READERS[parameter.kind](text)
    except Exception:
        value = None  # of no kind
    check_value(parameter, value, owner, text)
    return value


def check_value(parameter: Parameter, value: object, owner: str, text: str) -> None:
    """Refuse a value that is not as its notebook declares the parameter; a float may be a whole number."""
    kind, name = parameter.kind, f"parameter {parameter.name}"
    of_kind = type(value).__name__ == kind or (kind == "float" and type(value) is int)
    require(of_kind, name, owner, f"{kind}: {KINDS[kind]}", text)
    require(are_finite(value), name, owner, "finite, below 1e308 in size", text)
    must_be = ("a list of values, each " if kind == "list" else "") + parameter.rule
    require(parameter.allows(value), name, owner, must_be, text)


def are_finite(value: Json) -> bool:
    """Return whether the numbers in a value are finite and none is too large for a float."""
    if isinstance(value, list | dict):
        return all(map(are_finite, value.values() if isinstance(value, dict) else value))
    return not isinstance(value, int | float) or abs(value) < 1e308


def typed(value: Json) -> str:
    """Return a value as one types it."""
    return value if isinstance(value, str) else json.dumps(value, default=str)


# Keys and records


def digests(folder: Path, leave_out: Sequence[str] = ()) -> dict[str, str]:
    """Return the SHA-256 of every file below a folder by its path there; hidden files and caches do not count."""
    found = {}
    for top, folders, files in os.walk(folder, followlinks=True):
        here = Path(top)
        folders[:] = sorted(
            name
            for name in folders
            if not name.startswith(".")
            and name != "__pycache__"
            and (here / name).relative_to(folder).as_posix() not in leave_out
        )
        for name in sorted(files):
            if not name.startswith("."):
                found[(here / name).relative_to(folder).as_posix()] = digest(here / name)
    return found


def digest(path: Path) -> str:
    """Return the SHA-256 of a file; empty where there is none."""
    return hashlib.sha256(path.read_bytes()).hexdigest() if path.is_file() else ""


def combined(content: Json) -> str:
    """Return one SHA-256 of what JSON can hold."""
    return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()


def recordings_folder() -> Path:
    """Return where the authors' recordings lie: REPRO_DATA_DIR, else the user's cache."""
    chosen = os.environ.get("REPRO_DATA_DIR") or cache_folder()
    return Path(chosen).expanduser().absolute()


def recordings() -> dict[str, str]:
    """Return the recordings with their hashes; kernels that were compiled into the same cache are none."""
    return digests(recordings_folder(), leave_out=["numba"])


def inputs_of(root: Path, found: Mapping[str, str] | None = None) -> str:
    """Return one hash of what every notebook depends on: packages, data, recordings, lock."""
    ours = [digests(folder) for folder in (*(root / "src" / package for package in PACKAGES), root / "data")]
    recorded = dict(recordings() if found is None else found)
    return combined([ours, recorded, digest(root / "requirements.lock")])


def key_of(notebook: Path, parameters: Mapping[str, Json], inputs: str) -> str:
    """Return the key of a run: it changes with anything that the results depend on."""
    return combined([digest(notebook), dict(parameters), inputs])


def record_path(output: Path) -> Path:
    """Return where the record of an executed notebook lies."""
    return output.with_name(f"{output.stem}.provenance.json")


def read_record(output: Path) -> Record | None:
    """Return the record of an executed notebook; None where there is none."""
    try:
        return json.loads(record_path(output).read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return None


def is_finished(output: Path, results: Path, key: str) -> bool:
    """Return whether a run of this key left its output and its tables, and nobody changed them."""
    record = read_record(output) or {"key": ""}
    whole = record["key"] == key and output.is_file()
    return whole and all(digest(results / name) == was for name, was in record["results"].items())


def versions() -> dict[str, str]:
    """Return the versions of what computes."""
    there = {one.name: one.version for one in importlib.metadata.distributions()}
    found = {name: there.get(name, "not installed") for name in ("repro-soft-robots", *LIBRARIES)}
    return {"python": platform.python_version(), **found}


def commit_of(root: Path) -> str:
    """Return the commit of a checkout, with "-dirty" where sources differ from it; empty without git."""
    # A project unpacked inside somebody else's repository must not report that repository's commit.
    if not (root / ".git").exists() or shutil.which("git") is None:
        return ""
    git = ["git", "--no-optional-locks", "-C", root]
    asked = ["rev-parse", "--verify", "--quiet", "HEAD"], ["status", "--porcelain", "--", *SOURCES]
    commit, changes = (
        subprocess.run([*git, *words], capture_output=True, text=True, check=False).stdout.strip()
        for words in asked
    )
    return f"{commit}-dirty" if commit and changes else commit


# One run


def run(
    notebook: Path,
    parameters: Mapping[str, Json],
    output: Path,
    results: Path,
    *,
    root: Path,
    progress: bool = False,
) -> Record:
    """Run a notebook and return the record; its output and tables appear when it has finished."""
    import papermill
    from traitlets.config import Config

    in_book = output.resolve().is_relative_to(root.resolve() / "book")
    failed = (root / "runs" if in_book else output.parent) / f"{output.stem}.failed.ipynb"
    found = recordings()
    key = key_of(notebook, parameters, inputs_of(root, found))
    started, clock = datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds"), time.monotonic()
    output.parent.mkdir(parents=True, exist_ok=True)
    with (
        tempfile.TemporaryDirectory(prefix=f".{output.stem}-", dir=output.parent) as staging,
        tempfile.TemporaryDirectory(prefix="repro-") as sockets,
    ):
        partial, tables = Path(staging) / output.name, Path(staging) / "tables"
        tables.mkdir()
        own = {f"{name}_THREADS": "1" for name in _ONE_THREAD} | {
            "REPRO_RESULTS": str(tables.absolute()),
            "REPRO_DATA_DIR": str(recordings_folder()),
            "PYDEVD_DISABLE_FILE_VALIDATION": "1",  # the debugger of ipykernel would warn at every start
        }
        before = dict(os.environ)
        os.environ.update(own)
        try:
            papermill.execute_notebook(
                str(notebook.absolute()),
                str(partial.absolute()),
                dict(parameters),
                kernel_name="python3",
                language="python",
                progress_bar=progress,
                shutdown_kernel="immediate",  # all is written by then
                # On TCP ports a kernel dies where another program takes one of them first.
                config=Config(KernelManager={"transport": "ipc", "ip": f"{sockets}/kernel"}),
            )
        except BaseException as error:
            message = _keep(notebook, partial, failed, error)
            if not isinstance(error, Exception):
                print(message, file=sys.stderr)
                raise
            raise RunFailed(message) from error
        finally:
            os.environ.clear()
            os.environ.update(before)
        _name_places(partial, notebook, output)
        record = {
            "notebook": shown(notebook, root),
            "parameters": dict(parameters),
            "key": key,
            "commit": commit_of(root),
            "versions": versions(),
            "recordings": dict(found),
            "started": started,
            "seconds": round(time.monotonic() - clock, 1),
            "results": digests(tables),
        }
        _publish(record, tables, results, partial, output)
    failed.unlink(missing_ok=True)
    return record


def shown(path: Path, start: Path | None = None) -> str:
    """Return a path as readers are told it: from the current folder, or another, where it lies below."""
    start, path = (start or Path.cwd()).absolute(), path.absolute()
    return path.relative_to(start).as_posix() if path.is_relative_to(start) else str(path)


def _publish(record: Record, tables: Path, results: Path, partial: Path, output: Path) -> None:
    """Move tables and notebook to their places, the record last; tables of the run before go."""
    before = read_record(output) or {"results": {}}
    record_path(output).unlink(missing_ok=True)
    for name in before["results"].keys() - record["results"].keys():
        (results / name).unlink(missing_ok=True)
    for name in record["results"]:
        place = results / name
        place.parent.mkdir(parents=True, exist_ok=True)
        beside = place.with_name(f".{place.name}.part")  # results may lie on another disk than the output
        shutil.copyfile(tables / name, beside)
        beside.replace(place)
    partial.replace(output)
    record_path(output).write_text(json.dumps(record, indent=1) + "\n", encoding="utf-8")


def _keep(notebook: Path, partial: Path, failed: Path, error: BaseException) -> str:
    """Keep the partial notebook; return where it is, and what went wrong in which cell."""
    name, value = getattr(error, "ename", type(error).__name__), getattr(error, "evalue", str(error))
    said = f"{name}: {value}".strip().removesuffix(":").partition("\n")[0]
    if not partial.is_file():
        return f"{shown(notebook)} failed before its first cell: {said}"
    _name_places(partial, notebook, failed)
    failed.parent.mkdir(parents=True, exist_ok=True)
    shutil.move(partial, failed)
    line = getattr(error, "source", "").strip().partition("\n")[0]
    what = f"failed in the cell `{line}`: {said}" if line else f"was stopped before its end ({said})"
    return f"{shown(notebook)} {what}\nThe partial notebook is {shown(failed)}"


def _name_places(path: Path, notebook: Path, output: Path) -> None:
    """Replace the absolute paths that papermill notes by names."""
    content = json.loads(path.read_text(encoding="utf-8"))
    content["metadata"]["papermill"].update(input_path=notebook.name, output_path=output.name)
    path.write_text(json.dumps(content, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")


def stop_on_termination() -> None:
    """Let a request to terminate clean up as an interruption from the keyboard does."""
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(128 + signal.SIGTERM))


# Runs in processes of their own: pages of the book, points of a sweep


@dataclass(frozen=True)
class Point:
    """One run among several; its places are absolute."""

    notebook: Path
    parameters: dict[str, Json]
    key: str
    output: Path
    results: Path
    root: Path

    @property
    def finished(self) -> bool:
        """Return whether it need not run."""
        return is_finished(self.output, self.results, self.key)

    @property
    def label(self) -> str:
        """Return the parameters as readers name the point."""
        return " ".join(f"{name}={typed(value)}" for name, value in self.parameters.items())


def run_point(point: Point) -> tuple[str, float]:
    """Run a point in a process of its own; return why it failed (empty when it did not), and the seconds."""
    clock = time.monotonic()
    places = map(str, (point.notebook, point.output, point.results, point.root))
    done = subprocess.run(
        [sys.executable, "-m", "repro_companion.run", *places, json.dumps(point.parameters)],
        stdin=subprocess.DEVNULL,
        capture_output=True,
        text=True,
        errors="replace",
        check=False,
    )
    said = done.stdout.strip() or done.stderr.strip() or f"exit {done.returncode}"
    if not done.returncode and not point.finished:
        return "it ran with other sources, data or lock than it was planned with", time.monotonic() - clock
    return said if done.returncode else "", time.monotonic() - clock


def grid_of(
    parameters: Mapping[str, Parameter], given: Sequence[tuple[str, str]], owner: str
) -> dict[str, list[Json]]:
    """Return the values of each parameter that is swept: 1,2 or, half open, 0:3; [1, 2] is one value."""
    grid: dict[str, list[Json]] = {}
    for one, text in chosen(parameters, given, owner):
        values, empty = [], re.search(r"(^|,) *(,|$)", text)
        require(not empty, f"parameter {one.name}", owner, "a value between any two commas", repr(text))
        for item in re.findall(
            r"(?:\[[^]]*\]|\{[^}]*\}|[^,\[{])+", text
        ):  # commas within brackets divide nothing
            ends = re.fullmatch(r"([-+]?\d+):([-+]?\d+)", item) if one.kind in ("int", "list") else None
            for each in map(str, range(int(ends[1]), int(ends[2]))) if ends else [item]:
                bare = one.kind == "list" and not each.startswith("[")
                values.append(value_of(one, f"[{each}]" if bare else each, owner))
        differ = len(values) == len({*map(typed, values)}) > 0
        require(differ, f"parameter {one.name}", owner, "one value or more, which differ", text)
        grid[one.name] = values
    require(grid, "parameters", "repro sweep", "given, each as -p NAME VALUES", "none")
    return grid


def points_of(notebook: Path, grid: Mapping[str, Sequence[Json]], folder: Path, root: Path) -> list[Point]:
    """Return the points of a sweep; the last parameter varies fastest."""
    inputs, points = inputs_of(root), []
    for values in itertools.product(*grid.values()):
        parameters = dict(zip(grid, values, strict=True))
        key = key_of(notebook, parameters, inputs)
        place = folder.absolute() / "points" / key[:16] / notebook.name
        points.append(Point(notebook.absolute(), parameters, key, place, place.with_suffix(""), root))
    return points


def sweep(points: Sequence[Point], *, jobs: int, scheduler: str = "") -> dict[str, str]:
    """Run the points that are not finished, by Dask; return why points failed, by their label."""
    from distributed import Client, as_completed

    todo = [point for point in points if not point.finished]
    failures: dict[str, str] = {}
    if not todo:
        return failures
    own = {"n_workers": min(jobs, len(todo)), "threads_per_worker": 1, "processes": False}
    try:
        client = Client(scheduler, timeout=10) if scheduler else Client(**own, dashboard_address=None)
    except (OSError, ValueError, TypeError) as error:
        must_be = "the address of a Dask scheduler that answers, such as tcp://host:8786"
        raise bad_input("scheduler", "repro sweep", must_be, f"{scheduler} ({error})") from error
    with client:
        futures = dict(zip(client.map(run_point, todo, pure=False), todo, strict=True))
        for number, future in enumerate(as_completed(futures), len(points) - len(todo) + 1):
            error, label = future.exception(), futures[future].label
            said, seconds = (str(error), 0.0) if error else future.result()
            failures |= {label: said} if said else {}
            print(
                f"{number} of {len(points)}: {label} {'failed' if said else 'done'} ({seconds:.1f} s)",
                file=sys.stderr,
            )
    return failures


def joined(points: Sequence[Point], folder: Path) -> list[Path]:
    """Join the tables of all finished points, with a column for each parameter; return what was written."""
    import pandas as pd

    parts: dict[str, list[pd.DataFrame]] = {}
    for point in points:
        own = {
            name: typed(*value) if isinstance(value, list) and len(value) == 1 else typed(value)
            for name, value in point.parameters.items()
        }
        for name in (read_record(point.output) or {"results": {}})["results"] if point.finished else ():
            if name.endswith(".csv") and not name.endswith(".rows.csv"):  # these belong to the scorecard
                table = pd.read_csv(point.results / name, dtype=str, keep_default_na=False)
                table = table.rename(columns={column: f"table_{column}" for column in own})
                parts.setdefault(name, []).append(pd.DataFrame(own, index=table.index).join(table))
    for name, tables in parts.items():
        pd.concat(tables).to_csv(folder / name, index=False, lineterminator="\n")
    return [folder / name for name in parts]


def main(arguments: Sequence[str]) -> int:
    """Run one point."""
    stop_on_termination()
    notebook, output, results, root = map(Path, arguments[:4])
    try:
        run(notebook, json.loads(arguments[4]), output, results, root=root)
    except (RunFailed, InputError) as failure:
        print(failure)  # libraries write to standard error
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
