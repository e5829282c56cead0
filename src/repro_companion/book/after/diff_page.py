"""A run beside the book: one page with the parameters, tables and figures that differ."""

from __future__ import annotations

import base64
from collections.abc import Iterable
from html import escape
from pathlib import Path
from typing import Any

import pandas as pd

from repro.errors import bad_input
from repro.files import write_whole
from repro_companion.book.after.diff_runs import Side, find_book, find_run
from repro_companion.book.after.diff_tables import OCCURRENCE, TableDifference, compare_tables, read_csv
from repro_companion.book.after.page_notes import FigureFiles
from repro_companion.book.project import Project, shown
from repro_companion.book.provenance import Record

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
    title = f"A run of {run.record.notebook} beside the book"
    body = [
        f"<h1>{escape(title)}</h1>",
        "<p>Differences are run less book; relative ones in per cent of the book’s value.</p>",
        "<h2>Parameters and provenance</h2>",
        _settings(book, run),
        "<h2>Tables</h2>",
        *map(_table, tables),
        "<h2>Figures</h2>",
        *_figures(book.figures(), run.figures()),
    ]
    head = [
        '<!doctype html>\n<html lang="en"><head><meta charset="utf-8">',
        f'<meta name="viewport" content="width=device-width"><title>{escape(title)}</title>',
        f"<style>{_STYLE}</style></head><body><main>",
    ]
    return "\n".join([*head, *body, "</main></body></html>"]) + "\n"


def _settings(book: Side, run: Side) -> str:
    sides = book.parameters(), run.parameters()
    rows = [(name, *(side.get(name, "not there") for side in sides)) for name in {**sides[0], **sides[1]}]
    facts = [(f"parameter {name}", one, other) for name, one, other in rows if repr(one) != repr(other)]
    facts += [(name, one, other) for name, one, other in _facts(book.record, run.record) if one != other]
    if not facts:
        return "<p>No parameter and no input differs.</p>"
    lines = [
        f'<tr><th scope="row">{escape(name)}</th>'
        + "".join(f"<td>{escape(str(value))}</td>" for value in values)
        + "</tr>"
        for name, *values in facts
    ]
    return _scroll("What differs", f"<thead>{_head(['', 'Book', 'Run'])}</thead>", lines)


def _facts(book: Record, run: Record) -> Iterable[tuple[str, Any, Any]]:
    def code(record: Record) -> str:
        return ", ".join(f"{key} {value}" for key, value in record.code.items())

    yield "code", code(book), code(run)
    yield "Python", book.python, run.python
    for name in {**book.libraries, **run.libraries}:
        yield name, book.libraries.get(name), run.libraries.get(name)
    changed = dict(book.data.get("recordings", {}).items() ^ run.data.get("recordings", {}).items())
    yield "recordings", "", f"{len(changed)} differ" if changed else ""


def _table(table: TableDifference | str) -> str:
    if isinstance(table, str) or table.identical:
        return f"<p>{escape(_in_words(table))}.</p>"
    changed, words = table.changed, escape(_in_words(table))
    rest = _only(table.name, "book", table.only_book) + _only(table.name, "run", table.only_run)
    if not changed:
        return f"<p>{words}.</p>{rest}"
    size = pd.DataFrame(
        {c: table.relative(c).abs() if table.is_number(c) else table.differs(c) * 1.0 for c in changed}
    )
    shown_rows = list(range(len(table.run)))
    if len(shown_rows) > ROWS:
        order = size.fillna(float("inf")).where(size.notna() | table.run[changed].notna(), 0.0).max(axis=1)
        largest = order.reset_index(drop=True).sort_values(ascending=False, kind="stable")
        shown_rows = list(largest.index[:ROWS])
        words += f"; the {ROWS} with the largest relative differences are shown"
    labels = table.run.index.to_frame(index=False)
    told_apart = not table.keys or bool(labels[OCCURRENCE].to_numpy().any())
    groups, names = "", [*map(escape, table.keys), *(["row"] if told_apart else [])]
    head = f'<td colspan="{len(names)}"></td>'
    for column in changed:
        parts = ["Book", "Run", "Difference", "%"] if table.is_number(column) else ["Book", "Run"]
        groups += f'<th scope="colgroup" colspan="{len(parts)}">{escape(str(column))}</th>'
        names += parts
    cells = [_cells(table, column) for column in changed]
    lines = []
    for row in shown_rows:
        keys = [labels[name].iloc[row] for name in table.keys]
        keys += [labels[OCCURRENCE].iloc[row] + 1] if told_apart else []
        line = "".join(f'<th scope="row">{escape(_text(key))}</th>' for key in keys)
        line += "".join(f"<td>{escape(text)}</td>" for column in cells for text in column[row])
        lines.append(f"<tr>{line}</tr>")
    return _scroll(words, f"<thead><tr>{head}{groups}</tr>{_head(names)}</thead>", lines) + rest


def _only(name: str, owner: str, rows: pd.DataFrame) -> str:
    """Return the first rows that only one of the two has."""
    if rows.empty:
        return ""
    part = rows.head(ONLY_ROWS)
    number = f"the first {len(part)} of {len(rows)}" if len(rows) > len(part) else str(len(rows))
    lines = [
        f"<tr>{''.join(f'<td>{escape(_text(value))}</td>' for value in row)}</tr>"
        for row in part.itertuples(index=False, name=None)
    ]
    head = _head(escape(str(column)) for column in rows)
    return _scroll(f"{escape(name)}, rows only in the {owner}: {number}", f"<thead>{head}</thead>", lines)


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


def _head(names: Iterable[str]) -> str:
    cells = [f'<th scope="col">{name}</th>' if name else "<td></td>" for name in names]
    return f"<tr>{''.join(cells)}</tr>"


def _scroll(title: str, head: str, lines: Iterable[str]) -> str:
    body = "\n".join(lines)
    return (
        f'<div class="scroll" tabindex="0" role="region" aria-label="{title}">'
        f"<table><caption>{title}</caption>{head}<tbody>\n{body}\n</tbody></table></div>"
    )


def _figures(book: list[FigureFiles], run: list[FigureFiles]) -> Iterable[str]:
    ours, theirs = ({figure.name: figure for figure in side} for side in (book, run))
    names = {**ours, **theirs}
    if not names:
        yield "<p>There are none.</p>"
    for name in names:
        one, other = ours.get(name), theirs.get(name)
        figure = one or other
        assert figure is not None
        pictures = [side.files.get("png") if side else None for side in (one, other)]
        same = pictures[0] is not None and pictures[0] == pictures[1]
        title = escape(figure.caption or name)
        yield f"<h3>{title}{' (identical)' if same else ''}</h3>"
        # the words beside the book's figure tell its numbers, which need not be the run's
        alts = (figure.alt or figure.name, f"The same figure of the run: {figure.name}")
        yield (
            '<div class="pair">'
            + "".join(
                _picture(picture, alt, owner)
                for picture, alt, owner in zip(pictures, alts, ("Book", "Run"), strict=True)
            )
            + "</div>"
        )


def _picture(picture: bytes | None, alt: str, owner: str) -> str:
    if picture is None:
        return f"<figure><figcaption>{owner}: not there</figcaption></figure>"
    data = base64.b64encode(picture).decode()
    image = f'<img alt="{escape(alt)}" src="data:image/png;base64,{data}">'
    return f"<figure><figcaption>{owner}</figcaption>{image}</figure>"


_STYLE = """
:root { color-scheme: light dark; }
body { font: 16px/1.5 system-ui, sans-serif; margin: 0; }
main { max-width: 80rem; margin: auto; padding: 1rem; }
h1, h2, h3, p { overflow-wrap: anywhere; }
h1 { font-size: 1.6rem; } h2 { font-size: 1.3rem; } h3 { font-size: 1rem; margin-bottom: 0.3rem; }
.scroll { overflow: auto; max-height: 36rem; margin-bottom: 1.5rem; border: 1px solid #8888; }
.scroll:focus-visible { outline: 2px solid; }
table { border-collapse: collapse; font-size: 0.85rem; font-variant-numeric: tabular-nums; }
caption { text-align: left; padding: 0.4rem; font-weight: 600; position: sticky; left: 0; }
caption { width: min(60rem, calc(100vw - 4rem)); }
th, td { padding: 0.2rem 0.6rem; text-align: right; border-top: 1px solid #8886; }
th { font-weight: 600; white-space: nowrap; }
th[scope="row"], th[scope="colgroup"] { text-align: left; }
th[scope="colgroup"] { border-left: 1px solid #8888; }
.pair { display: grid; grid-template-columns: repeat(auto-fit, minmax(min(100%, 24rem), 1fr)); gap: 1rem; }
figure { margin: 0; } figcaption { font-size: 0.85rem; }
img { max-width: 100%; height: auto; background: #fff; }
"""
