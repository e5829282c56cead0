"""A run beside the book: one page with the parameters, tables and figures that differ."""

from __future__ import annotations

import base64
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pandas as pd
from edition1.errors import bad_input, require
from edition1.files import write_whole

from edition1_companion.book.after.diff_tables import OCCURRENCE, TableDifference, compare_tables, read_csv
from edition1_companion.book.after.page_notes import FigureFiles, figures_of
from edition1_companion.book.parameters import declared_parameters
from edition1_companion.book.project import Project, shown
from edition1_companion.book.provenance import RECORD_SUFFIX, Record, read_record, record_path
from edition1_companion.book.run_form import default_value
from edition1_companion.book.runner import read_notebook
from edition1_companion.book.templates import rendered


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
    notebook, record = project.executed / f"{stem}.ipynb", read_record(record_path(project.results, stem))
    if record is None or not notebook.is_file() or record.notebook != run.record.notebook:
        raise bad_input(
            "run",
            "repro diff",
            "of a notebook that the book has (make book computes it)",
            f"one of {run.record.notebook}",
        )
    return Side(record, notebook, project.results)


ROWS = 100
"""Rows of a table that a page shows; those with the largest differences come first when there are more."""
ONLY_ROWS = 20
"""Rows without a counterpart that a page shows."""


def write_diff(place: Path, project: Project) -> tuple[Path, str]:
    """Write the comparison of a run with the book beside the run, as ``<name>.diff.html``.

    Parameters
    ----------
    place
        The folder of a run, or its executed notebook.
    project
        Whose book it is compared with.

    Returns
    -------
    tuple
        The page, which needs no other file, and a summary in words.

    Raises
    ------
    InputError
        If there is no such run, the book has not run the notebook, or a table is not there any more.
    """
    run = find_run(place)
    book = find_book(run, project)
    if run.notebook.resolve() == book.notebook.resolve():
        raise bad_input("run", "repro diff", "another run than the book's own", place)
    tables = [_compare(name, book, run) for name in sorted({*book.record.results, *run.record.results})]
    page = run.results / f"{run.notebook.stem}.diff.html"
    write_whole(page, _page(book, run, tables))
    lines = [_in_words(table) for table in tables]
    return page, "\n".join(lines)


def _compare(name: str, book: Side, run: Side) -> TableDifference | str:
    for side, other in ((book, "run"), (run, "book")):
        if name not in side.record.results:
            return f"{name}: only the {other} has it"
        if not (side.results / name).is_file():
            raise bad_input("run", "repro diff", "complete", f"no {shown(side.results / name)}")
    if not name.endswith(".csv"):
        same = book.record.results[name] == run.record.results[name]
        return f"{name}: {'identical' if same else 'differs'}"
    return compare_tables(name, read_csv(book.results / name), read_csv(run.results / name))


def _in_words(table: TableDifference | str) -> str:
    if isinstance(table, str):
        return table
    if table.identical:
        return f"{table.name}: identical"
    rows = int(pd.DataFrame({c: table.differs(c) for c in table.changed}).any(axis=1).sum())
    parts = [f"{rows} of {len(table.run)} matched rows differ"]
    parts += [
        f"{len(part)} only in the {owner}"
        for part, owner in ((table.only_book, "book"), (table.only_run, "run"))
        if len(part)
    ]
    if table.other_columns:
        parts.append(f"columns in only one of them: {', '.join(table.other_columns)}")
    return f"{table.name}: " + "; ".join(parts)


def _page(book: Side, run: Side, tables: Iterable[TableDifference | str]) -> str:
    return rendered(
        "diff.html",
        title=f"A run of {run.record.notebook} beside the book",
        facts=list(_facts(book, run)),
        tables=list(map(_shown, tables)),
        figures=list(_figures(book.figures(), run.figures())),
    )


def _facts(book: Side, run: Side) -> Iterable[tuple[str, Any, Any]]:
    """Return what the two were made from, where it differs."""
    ours, theirs = book.parameters(), run.parameters()
    for name in {**ours, **theirs}:
        one, other = (side.get(name, "not there") for side in (ours, theirs))
        if repr(one) != repr(other):
            yield f"parameter {name}", one, other
    a, b = book.record, run.record
    changed = dict(a.data.get("recordings", {}).items() ^ b.data.get("recordings", {}).items())
    facts = [
        ("code", *(", ".join(f"{key} {value}" for key, value in record.code.items()) for record in (a, b))),
        ("Python", a.python, b.python),
        *((x, a.libraries.get(x), b.libraries.get(x)) for x in {**a.libraries, **b.libraries}),
        ("recordings", "", f"{len(changed)} differ" if changed else ""),
    ]
    yield from (fact for fact in facts if fact[1] != fact[2])


def _shown(table: TableDifference | str) -> dict[str, Any]:
    """Return what the page shows of a table: words, and lines where there are any."""
    shown: dict[str, Any] = {"words": _in_words(table), "lines": [], "only": []}
    if isinstance(table, str) or table.identical:
        return shown
    changed = table.changed
    shown["only"] = [*_only(table.name, "book", table.only_book), *_only(table.name, "run", table.only_run)]
    if not changed:
        return shown
    size = pd.DataFrame(
        {c: table.relative(c).abs() if table.is_number(c) else table.differs(c) * 1.0 for c in changed}
    )
    rows = list(range(len(table.run)))
    if len(rows) > ROWS:
        order = size.fillna(float("inf")).where(size.notna() | table.run[changed].notna(), 0.0).max(axis=1)
        largest = order.reset_index(drop=True).sort_values(ascending=False, kind="stable")
        rows = list(largest.index[:ROWS])
        shown["words"] += f"; the {ROWS} with the largest relative differences are shown"
    labels = table.run.index.to_frame(index=False)
    told_apart = not table.keys or bool(labels[OCCURRENCE].to_numpy().any())
    if told_apart:
        labels[OCCURRENCE] += 1
    columns = [*table.keys, *([OCCURRENCE] if told_apart else [])]
    parts = ["Book", "Run", "Difference", "%"]
    cells = [_cells(table, column) for column in changed]
    return shown | {
        "labels": [*table.keys, *(["row"] if told_apart else [])],
        "groups": [(column, parts if table.is_number(column) else parts[:2]) for column in changed],
        "lines": [
            (
                [_text(labels[name].iloc[row]) for name in columns],
                [x for column in cells for x in column[row]],
            )
            for row in rows
        ],
    }


def _only(name: str, owner: str, rows: pd.DataFrame) -> Iterable[tuple[str, list[str], list[list[str]]]]:
    """Return the first rows that only one of the two has."""
    if not rows.empty:
        part = rows.head(ONLY_ROWS)
        number = f"the first {len(part)} of {len(rows)}" if len(rows) > len(part) else str(len(rows))
        lines = [[_text(value) for value in row] for row in part.itertuples(index=False, name=None)]
        yield f"{name}, rows only in the {owner}: {number}", list(map(str, rows)), lines


def _cells(table: TableDifference, column: str) -> list[list[str]]:
    sides = [table.book[column], table.run[column]]
    if table.is_number(column):
        sides += [table.difference(column), 100 * table.relative(column)]
    texts = [[_text(value, signed=number > 1) for value in side] for number, side in enumerate(sides)]
    if len(texts) == 4:
        texts[3] = ["" if text == "" else f"{float(text):+.3g}" for text in texts[3]]
    return [list(row) for row in zip(*texts, strict=True)]


def _text(value: Any, *, signed: bool = False) -> str:
    if pd.isna(value):
        return ""
    if isinstance(value, float):
        return f"{value:+.6g}" if signed else f"{value:.6g}"
    return str(value)


def _figures(book: list[FigureFiles], run: list[FigureFiles]) -> Iterable[dict[str, Any]]:
    ours, theirs = ({figure.name: figure for figure in side} for side in (book, run))
    for name in {**ours, **theirs}:
        figure = ours.get(name) or theirs[name]
        sides = ours.get(name), theirs.get(name)
        pictures = [side.files.get("png") if side else None for side in sides]
        same = pictures[0] is not None and pictures[0] == pictures[1]
        # the words beside the book's figure tell its numbers, which need not be the run's
        alts = figure.alt or figure.name, f"The same figure of the run: {figure.name}"
        data = [base64.b64encode(picture).decode() if picture else "" for picture in pictures]
        yield {
            "title": f"{figure.caption or name}{' (identical)' if same else ''}",
            "pictures": list(zip(data, alts, ("Book", "Run"), strict=True)),
        }
