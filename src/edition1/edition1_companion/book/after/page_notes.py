"""What the book adds to the page of a notebook: where it comes from, how it is run, and what can be downloaded.

The additions are made when the site is built, from the record of the run; the executed notebook stays as it is.
"""

from __future__ import annotations

import base64
import re
from collections.abc import Mapping
from dataclasses import dataclass
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING, Any

from edition1_companion.book.digests import combined_digest
from edition1_companion.book.parameters import Parameter, declared_parameters, listing
from edition1_companion.book.project import Project
from edition1_companion.book.provenance import RECORD_SUFFIX, Record, read_record, record_path
from edition1_companion.book.runner import read_notebook

if TYPE_CHECKING:
    from nbformat import NotebookNode

FOLDER = "downloads"
"""Folder of the site that holds the files of :func:`page_files`, one folder a notebook."""

_ENDINGS = {"image/png": "png", "image/svg+xml": "svg", "application/pdf": "pdf"}
_PICTURE_IN_HTML = re.compile(r'<div class="shape-view"><img src="data:image/png;base64,([^"]+)"')


@dataclass(frozen=True)
class FigureFiles:
    """A figure of an executed notebook."""

    name: str
    """Its name in the book, or ``figure-1`` where it has none."""
    caption: str
    files: dict[str, bytes]
    """Content by ending: ``png`` and ``svg`` or ``pdf``."""


def figures_of(executed: NotebookNode) -> list[FigureFiles]:
    """Return the figures of an executed notebook; those of 3-D views by their stills."""
    found = []
    for cell in executed.cells:
        about = cell.metadata.get("mystnb", {})
        figure = about.get("figure", {})
        pictures = [
            files for output in cell.get("outputs", []) for files in _pictures(output.get("data", {}))
        ]
        for number, files in enumerate(pictures, 1):
            name = figure.get("name") or f"figure-{len(found) + 1}"
            # name and caption belong to the first picture of their cell
            caption = figure.get("caption", "") if number == 1 else ""
            name = name if number == 1 else f"{name}-{number}"
            found.append(FigureFiles(name, caption, files))
    return found


def _pictures(data: Mapping[str, Any]) -> list[dict[str, bytes]]:
    """Return the pictures of an output, each in all its forms: one, or one for each 3-D view."""
    files = {}
    for kind, ending in _ENDINGS.items():
        if kind in data:
            text = data[kind] if isinstance(data[kind], str) else "".join(data[kind])
            files[ending] = text.encode() if kind == "image/svg+xml" else base64.b64decode(text)
    views = _PICTURE_IN_HTML.findall("".join(data.get("text/html", "")))
    return [files] if files else [{"png": base64.b64decode(view)} for view in views]


def page_files(project: Project, stem: str) -> dict[str, bytes]:
    """Return what a reader can download from the page of a notebook, by name: notebook, tables, figures.

    Parameters
    ----------
    project
        Where notebooks and results lie.
    stem
        Name of the notebook without its ending.
    """
    executed = project.executed / f"{stem}.ipynb"
    places = {
        f"{stem}.ipynb": project.notebooks / f"{stem}.ipynb",
        f"{stem}.executed.ipynb": executed,
        f"{stem}{RECORD_SUFFIX}": record_path(executed),
    }
    record = read_record(record_path(executed))
    places |= {name: project.results / name for name in (record.results if record else ())}
    files = {name: path.read_bytes() for name, path in places.items() if path.is_file()}
    for figure in figures_of(read_notebook(executed)):
        files |= {f"{figure.name}.{ending}": content for ending, content in figure.files.items()}
    return files


def write_page_files(project: Project, stem: str, site: Path) -> None:
    """Write :func:`page_files` to ``downloads/<stem>`` of a site."""
    for name, content in page_files(project, stem).items():
        path = site / FOLDER / stem / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(content)


def with_notes(page: dict[str, Any], project: Project, stem: str) -> dict[str, Any]:
    """Return an executed notebook, as JSON, with a line below its title, and its parameters and the downloads at its end.

    Parameters
    ----------
    page
        The notebook as JSON holds it; not changed.
    project
        Where its source, its tables and its record lie.
    stem
        Its name without the ending.
    """
    place = project.executed / f"{stem}.ipynb"
    executed, record = read_notebook(place), read_record(record_path(place))
    name = record.notebook if record else f"notebooks/{stem}.ipynb"
    tagged = any("parameters" in cell.metadata.get("tags", []) for cell in executed.cells)
    declared = declared_parameters(executed, name) if tagged else {}
    sections = []
    if declared:
        sections.append(("run", _RUN.format(notebook=name, listing=listing(declared, Path(name).name))))
    sections.append(("downloads", _downloads(project, stem, executed, record, declared)))
    added = [
        {"cell_type": "markdown", "id": f"page-{key}", "metadata": {}, "source": text}
        for key, text in sections
    ]
    cells = [_without_bar(_with_light_pictures(cell)) for cell in page["cells"]]
    if cells and cells[0]["cell_type"] == "markdown":
        cells[0]["source"] = _below_title(
            "".join(cells[0]["source"]), _summary(bool(declared)), _data(executed)
        )
    return {**page, "cells": cells + added}


def _with_light_pictures(cell: Mapping[str, Any]) -> dict[str, Any]:
    """Leave of a figure that is there as SVG and as PNG the one of fewer bytes for the page."""
    outputs = []
    for output in cell.get("outputs", []):
        data = dict(output.get("data", {}))
        if {"image/svg+xml", "image/png"} <= set(data):
            files = _pictures(data)[0]
            del data["image/png" if len(files["svg"]) < len(files["png"]) else "image/svg+xml"]
        outputs.append({**output, "data": data} if data else output)
    return {**cell, "outputs": outputs} if outputs else dict(cell)


def _without_bar(cell: Mapping[str, Any]) -> dict[str, Any]:
    """Leave a folded cell out of the page that shows nothing and gives the text its values: no method is in it."""
    tags = cell["metadata"].get("tags", [])
    if "hide-input" not in tags or cell.get("outputs") or not _GIVES.search("".join(cell["source"])):
        return dict(cell)
    return {**cell, "metadata": {**cell["metadata"], "tags": [*tags, "remove-cell"]}}


_GIVES = re.compile(r"^give\(", re.MULTILINE)
_RUN = """\
## Run it with your parameters

Name the values that you change, each with `-p`, in the folder of the repository after `make env` (or `make book`):

```bash
.venv/bin/repro run {notebook} -p NAME VALUE
```

`repro run` refuses a value that a parameter cannot have. The run has a folder of its own, so the book's results stay as
they are.

````{{dropdown}} Parameters and their values on this page
```text
{listing}
```
````
"""


def _data(executed: NotebookNode) -> str:
    """Return what a title says of data that stand in for recordings which this build has not found."""
    values = executed.metadata.get("repro", {}).get("values", {})
    return " (synthetic)" if values.get("source") == "synthetic" else ""


def _below_title(source: str, line: str, data: str) -> str:
    title, newline, rest = source.partition("\n")
    return f"{title}{data}\n\n{line}\n{newline}{rest}" if title.startswith("# ") else source


def _summary(has_parameters: bool) -> str:
    run = '<a href="#run-it-with-your-parameters">Run it with your parameters</a>'
    parts = [run] if has_parameters else []
    parts.append('<a href="#provenance-and-downloads">Data, figures and notebook</a>')
    return f'<p class="page-summary">{" · ".join(parts)}</p>'


def provenance_line(record: Record, declared: Mapping[str, Parameter]) -> str:
    """Return what a page was made from as one paragraph of HTML.

    Parameters
    ----------
    record
        The record of the run.
    declared
        The notebook's parameters, of which the seeds are named.
    """
    values = {name: parameter.default for name, parameter in declared.items()}
    values |= {name: str(value) for name, value in record.parameters.items()}
    changed = ", ".join(f"{name} = {values[name]}" for name in record.parameters)
    seeds = ", ".join(
        f"{name} = {str(value).strip('[]')}" for name, value in values.items() if "seed" in name
    )
    recordings = record.data.get("recordings", {})
    source = str(record.data.get("source", "unknown"))
    if recordings:
        found = f"found, of all papers: {len(recordings)} files in {source}"
        source = f"{found}, SHA-256 {combined_digest(recordings)[:12]}"
    facts = [
        ("Notebook", record.notebook),
        ("Parameters", changed or ("its own" if declared else "none")),
        ("Seed", seeds or "fixed in the code"),
        ("Code", _code(record)),
        ("Recordings", source),
        ("All inputs", f"SHA-256 {record.key[:12]}"),
        ("Python", record.python),
        ("Run", f"{record.started[:10]}, {record.seconds:.1f} s"),
    ]
    cells = "; ".join(f"<b>{escape(key)}:</b> {escape(value)}" for key, value in facts)
    return f'<p class="provenance">{cells}.</p>'


def _code(record: Record) -> str:
    commit = record.code.get("commit")
    if not commit:
        return f"source archive {str(record.code.get('source archive', ''))[:12]}"
    changed = " with uncommitted changes" if record.code.get("dirty") else ""
    return f"commit {commit[:12]}{changed}"


def _downloads(
    project: Project,
    stem: str,
    executed: NotebookNode,
    record: Record | None,
    declared: Mapping[str, Parameter],
) -> str:
    files = page_files(project, stem)

    def link(name: str, text: str) -> str:
        place = f"../{FOLDER}/{stem}/{name}"
        return f'<a href="{escape(place)}" download>{escape(text)}</a> ({_size(len(files[name]))})'

    own = [
        (f"{stem}.ipynb", "source"),
        (f"{stem}.executed.ipynb", "executed"),
        (f"{stem}{RECORD_SUFFIX}", "full record of the run"),
    ]
    lines = ["## Provenance and downloads", ""]
    if record:
        lines += [provenance_line(record, declared), ""]
    lines.append("- Notebook: " + ", ".join(link(name, text) for name, text in own if name in files))
    if tables := [name for name in (record.results if record else ()) if name in files]:
        lines.append("- Tables: " + ", ".join(link(name, name) for name in tables))
    figures = figures_of(executed)
    numbered, pixels_only = {figure.name for figure in figures if figure.caption}, {}
    for figure in figures:
        links = ", ".join(link(f"{figure.name}.{ending}", ending.upper()) for ending in figure.files)
        named, picture, (first, _, number) = figure.name, "", figure.name.rpartition("-")
        if named in numbered:
            named = f"{{numref}}`{named}`"
        elif first in numbered:  # another picture of the same cell
            named, picture = f"{{numref}}`{first}`", f", picture {number}"
        lines.append(f"- {named}{picture}: {links}")
        if not {"svg", "pdf"} & set(figure.files):
            pixels_only[named] = None
    if pixels_only:
        lines.append(f"- Without a vector version (too large, or 3-D views): {', '.join(pixels_only)}")
    return "\n".join(lines) + "\n"


def _size(count: int) -> str:
    for unit, size in (("MB", 1e6), ("kB", 1e3)):
        if count >= size:
            return f"{count / size:.1f}\xa0{unit}" if count < 10 * size else f"{count / size:.0f}\xa0{unit}"
    return f"{count}\xa0bytes"
