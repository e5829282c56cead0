"""The two runs that a comparison is about: one of a reader's own, and the book's of the same notebook."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from repro.errors import bad_input, require
from repro_companion.book.after.page_notes import FigureFiles, figures_of
from repro_companion.book.parameters import declared_parameters
from repro_companion.book.project import Project
from repro_companion.book.provenance import RECORD_SUFFIX, Record, read_record, record_path
from repro_companion.book.run_form import default_value
from repro_companion.book.runner import read_notebook


@dataclass(frozen=True)
class Side:
    """One of the two runs that a page compares."""

    record: Record
    notebook: Path
    """The executed notebook."""
    results: Path
    """The folder of its tables."""

    def parameters(self) -> dict[str, Any]:
        """Return all parameters it ran with: its own and the changed ones."""
        executed = read_notebook(self.notebook)
        if not any("parameters" in cell.metadata.get("tags", []) for cell in executed.cells):
            return {}
        declared = declared_parameters(executed, self.notebook.name)
        own = {name: default_value(item, self.notebook.name) for name, item in declared.items()}
        return own | self.record.parameters

    def figures(self) -> list[FigureFiles]:
        """Return its figures."""
        return figures_of(read_notebook(self.notebook))


def find_run(place: Path) -> Side:
    """Return the run at a place.

    Parameters
    ----------
    place
        The folder of a run, or its executed notebook.

    Raises
    ------
    InputError
        If there is not exactly one run with its record.
    """
    what = "the folder or the executed notebook of a finished repro run"
    if place.is_dir():
        records = sorted(place.glob(f"*{RECORD_SUFFIX}"))
        if len(records) > 1:
            names = ", ".join(path.name.removesuffix(RECORD_SUFFIX) + ".ipynb" for path in records)
            raise bad_input("run", "repro diff", f"one of the notebooks {names}", place)
        require(records, "run", "repro diff", what, f"{place}, which has no *{RECORD_SUFFIX}")
        place = records[0].with_name(records[0].name.removesuffix(RECORD_SUFFIX) + ".ipynb")
    require(place.is_file() and place.suffix == ".ipynb", "run", "repro diff", what, place)
    record = read_record(record_path(place.parent, place.stem))
    if record is None:
        raise bad_input("run", "repro diff", what, f"{place}, without {place.stem}{RECORD_SUFFIX}")
    return Side(record, place, place.parent)


def find_book(run: Side, project: Project) -> Side:
    """Return the book's run of the same notebook.

    Raises
    ------
    InputError
        If the book has none.
    """
    stem = Path(run.record.notebook).stem
    notebook, record = (
        project.executed / f"{stem}.ipynb",
        read_record(record_path(project.results, stem)),
    )
    if record is None or not notebook.is_file() or record.notebook != run.record.notebook:
        raise bad_input(
            "run",
            "repro diff",
            "of a notebook that the book has (make book computes it)",
            f"one of {run.record.notebook}",
        )
    return Side(record, notebook, project.results)
