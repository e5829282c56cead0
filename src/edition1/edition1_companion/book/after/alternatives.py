"""What a change of a parameter does: tables of a notebook before and after it, computed when the book is built.

A notebook names them in its metadata, ``repro: {"alternatives": [...]}``, see :class:`Alternative`. Each is run up to
the cell that writes its table, in a process that begins with the libraries loaded: most take a second, and none
draws a figure that nobody sees. What they write lies below ``.cache/alternatives``, never among the results.
"""

from __future__ import annotations

import contextlib
import datetime
import io
import os
import shutil
import time
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import dataclass, field
from multiprocessing import get_context
from pathlib import Path
from typing import TYPE_CHECKING, Any

from edition1.errors import bad_input

from edition1_companion.book.digests import combined_digest, file_digest, tree_digests
from edition1_companion.book.points import (
    Outcome,
    Point,
    Runner,
    environment_of_runs,
    once,
    one_thread,
)
from edition1_companion.book.project import Project, find_project, shown
from edition1_companion.book.provenance import Inputs, make_record, notebook_key, record_path, write_record
from edition1_companion.book.runner import changed_environment, read_notebook

if TYPE_CHECKING:
    from nbformat import NotebookNode

LIBRARIES = ("torch", "pandas", "matplotlib.pyplot", "numba", "scipy.spatial", "IPython.display", "nbformat")
"""What nearly every notebook imports first."""


@dataclass(frozen=True)
class Alternative:
    """A run with other parameters, and what of it is compared with the run before."""

    title: str
    """What is changed, in words."""
    parameters: dict[str, Any]
    """What is changed."""
    table: str
    """Name of the table without its ending."""
    rows: dict[str, str]
    """Columns that name a row, or expressions of them, with their headings; rows alike are averaged."""
    values: dict[str, str]
    """What is compared, an expression of columns by its heading: ``{"error [mm]": "(x_mm**2 + y_mm**2)**0.5"}``."""
    where: str = ""
    """Which rows, as pandas' ``query`` has it."""
    both: dict[str, Any] = field(default_factory=dict)
    """Parameters that differ from the notebook's own in both runs, such as ``{"fast": true}``."""
    exercise: str = ""
    """What the exercise of the page asks for: *this run*, or what is less here; empty if nothing of the kind."""

    def runs(self) -> dict[str, dict[str, Any]]:
        """Return the parameters of the two runs, without those that are the notebook's own."""
        return {"before": self.both, "after": self.both | self.parameters}


def alternatives_of(notebook: NotebookNode, name: str) -> list[Alternative]:
    """Return the alternatives that the metadata of a notebook names.

    Raises
    ------
    InputError
        If one of them is not what :class:`Alternative` holds.
    """
    given = notebook.metadata.get("repro", {}).get("alternatives", [])
    try:
        return [Alternative(**one) for one in given]
    except TypeError as error:
        raise bad_input("alternatives", f"the metadata of {name}", "as its class has it", error) from error


def alternatives_folder(project: Project) -> Path:
    """Return where the tables of all alternatives lie."""
    return project.root / ".cache" / "alternatives"


def alternative_points(project: Project, inputs: Inputs) -> list[Point]:
    """Return all runs that the alternatives of a book need, as points with folders of their own."""
    wanted = {
        run_folder(project, notebook.stem, one.table, parameters): (notebook, one.table, parameters)
        for notebook in sorted(project.notebooks.glob("*.ipynb"))
        for one in alternatives_of(read_notebook(notebook), notebook.name)
        for parameters in one.runs().values()
        if parameters  # else it is the page's own run
    }
    return [
        Point(
            index=index,
            parameters=parameters,
            key=notebook_key(notebook, parameters, inputs, project),
            notebook=notebook,
            output=folder / f"{table}.csv",
            results=folder,
            failed=folder / f"{table}.failed",
            lock=project.cache / "locks" / f"{notebook.stem}-{folder.name}",
            here=project.root,
            environment=environment_of_runs(),
        )
        for index, (folder, (notebook, table, parameters)) in enumerate(wanted.items())
    ]


def run_folder(project: Project, stem: str, table: str, parameters: Mapping[str, Any]) -> Path:
    """Return the folder of a run of a notebook up to a table; that of the results where no parameter is changed."""
    if not parameters:
        return project.results
    return alternatives_folder(project) / stem / f"{table}-{combined_digest(parameters)[:8]}"


def remove_other_runs(project: Project, points: Sequence[Point]) -> None:
    """Remove the tables of alternatives that are named no longer."""
    wanted = {point.results for point in points}
    for folder in alternatives_folder(project).glob("*/*"):
        if folder not in wanted:
            shutil.rmtree(folder)


def warm_runner(jobs: int, inputs: Inputs) -> Runner:
    """Return a runner of processes that are copied from one with the libraries loaded, ``jobs`` at a time.

    A process takes one point and ends, so that no run sees what another has left in the modules.
    """

    def run(points: Sequence[Point]) -> Iterator[Outcome]:
        with changed_environment(one_thread()):
            context = get_context("forkserver")
            context.set_forkserver_preload([__name__, *LIBRARIES])
            pool = ProcessPoolExecutor(min(jobs, len(points)), mp_context=context, max_tasks_per_child=1)
            try:
                for done in as_completed([pool.submit(_run, point, inputs) for point in points]):
                    yield done.result()
            finally:
                pool.shutdown(cancel_futures=True)

    return run


def _run(point: Point, inputs: Inputs) -> Outcome:
    return once(point, lambda _: _run_here(point, inputs))


def _run_here(point: Point, inputs: Inputs) -> str:
    shutil.rmtree(point.results)
    point.results.mkdir()
    os.chdir(point.here)
    os.environ |= {**point.environment, "REPRO_RESULTS_DIR": str(point.results), "MPLBACKEND": "Agg"}
    started, clock = datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds"), time.monotonic()
    try:
        run_until_written(read_notebook(point.notebook), point.parameters, point.output)
    except NotebookStopped as stop:
        return f"{shown(point.notebook)} with {point.label()} {stop}"
    record = make_record(
        find_project(),
        point.notebook,
        point.parameters,
        inputs,
        started=started,
        seconds=time.monotonic() - clock,
        results=tree_digests(point.results),
        executed=file_digest(point.output),
    )
    write_record(record, record_path(point.results, point.output.stem))
    return ""


class NotebookStopped(Exception):
    """A cell raised an error, or the table was not written; the message says which."""


def run_until_written(notebook: NotebookNode, parameters: Mapping[str, Any], table: Path) -> None:
    """Run the cells of a notebook in this process, in one thread, until there is a table.

    Raises
    ------
    NotebookStopped
        If a cell raises an error, or no cell writes the table.
    """
    import warnings

    import torch
    from IPython.display import display

    torch.set_num_threads(1)
    warnings.simplefilter("ignore")
    names: dict[str, Any] = {"__name__": "__main__", "display": display}
    cells = [cell for cell in notebook.cells if cell.cell_type == "code"]
    for number, cell in enumerate(cells, start=1):
        try:
            with contextlib.redirect_stdout(io.StringIO()):
                exec(compile(cell.source, f"code cell {number}", "exec"), names)
        except Exception as error:
            head = cell.source.strip().partition("\n")[0]
            said = f"failed in code cell {number}: {head}\n  {type(error).__name__}: {error}"
            raise NotebookStopped(said) from error
        if "parameters" in cell.metadata.get("tags", []):
            names |= parameters
        if table.is_file():
            return
    raise NotebookStopped(f"does not write the table {table.name}")
