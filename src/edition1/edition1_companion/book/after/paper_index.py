"""Where each table, figure, equation and trajectory of the papers is found in the book."""

from __future__ import annotations

import json
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from edition1.errors import require
from edition1_companion.book.project import Project
from edition1_companion.book.published import read_csv
from edition1_companion.book.scorecard_page import PAPERS
from edition1_companion.book.templates import rendered

KINDS = {
    "table": "Tables",
    "figure": "Figures",
    "equation": "Equations",
    "trajectory": "Trajectories",
    "section": "Numbers in the text",
}
"""Kinds of entries, with the heading under which they stand."""

STATUSES = ("regenerated", "redrawn", "implemented", "not reproduced")
"""Computed here; drawn from the equations in the place of a schematic; in the code; a photograph or schematic."""


@dataclass(frozen=True)
class IndexEntry:
    """One artefact of a paper and its place in the book; texts, empty where there is none."""

    paper: str
    kind: str
    artefact: str
    """As it is called in the paper and in the scorecard."""
    shows: str
    status: str
    page: str
    """Path of the page without its suffix, from the root of the site."""
    anchor: str
    """Name of a figure, or a heading in the form that links have."""
    code: str
    """Full name of what computes it."""
    note: str

    @property
    def link(self) -> str:
        """The place in the built site, from its root."""
        return f"{self.page}.html" + (f"#{self.anchor}" if self.anchor else "")

    @property
    def code_name(self) -> str:
        """What computes it, without its module."""
        return self.code.rsplit(".", 1)[-1]


COLUMNS = tuple(IndexEntry.__dataclass_fields__)


def index_path(project: Project) -> Path:
    """Return the file that lists what the papers contain."""
    return project.published.with_name("index.csv")


def read_index(path: Path) -> list[IndexEntry]:
    """Read the index of the papers, in the order of the file.

    Parameters
    ----------
    path
        CSV file with the columns ``paper, kind, artefact, shows, status, page, anchor, code, note``.

    Returns
    -------
    list of IndexEntry
        One per line.

    Raises
    ------
    InputError
        If the file is missing or has other columns, an entry stands twice, has no page, or is of an unknown kind or
        status.
    """
    entries: dict[tuple[str, str, str], IndexEntry] = {}
    for line in read_csv(path, COLUMNS):
        entry = IndexEntry(**line)
        key = (entry.paper, entry.kind, entry.artefact)
        require(key not in entries, "entry", path.name, "listed once", " / ".join(key))
        require(entry.kind in KINDS, "kind", path.name, "one of " + ", ".join(KINDS), entry.kind)
        require(entry.status in STATUSES, "status", path.name, "one of " + ", ".join(STATUSES), entry.status)
        require(entry.page, f"page of {' / '.join(key)}", path.name, "the page to look at", "nothing")
        entries[key] = entry
    return list(entries.values())


def places(entries: Iterable[IndexEntry]) -> dict[tuple[str, str], str]:
    """Return the links of the artefacts whose numbers the scorecard lists, by paper and artefact."""
    return {(entry.paper, entry.artefact): entry.link for entry in entries if entry.kind not in ("equation",)}


def page_titles(project: Project, entries: Iterable[IndexEntry]) -> dict[str, str]:
    """Return the titles of the pages to which entries lead, by the path of the page."""
    return {page: _title(project, page) for page in sorted({entry.page for entry in entries})}


def _title(project: Project, page: str) -> str:
    notebook, other = project.root / f"{page}.ipynb", project.book / f"{page}.md"
    if notebook.is_file():
        text = "".join(json.loads(notebook.read_text(encoding="utf-8"))["cells"][0]["source"])
    else:
        require(other.is_file(), "page", "index.csv", "a page of the book", page)
        text = other.read_text(encoding="utf-8")
    return re.findall(r"^# (.+)$", text, flags=re.MULTILINE)[0]


def index_page(entries: Sequence[IndexEntry], titles: Mapping[str, str]) -> str:
    """Return the index as MyST: a heading for each paper, and a table for each kind of artefact.

    Parameters
    ----------
    entries
        What the papers contain.
    titles
        Of their pages.
    """
    return rendered("paper_index.html", entries=entries, titles=titles, papers=PAPERS, kinds=KINDS)
