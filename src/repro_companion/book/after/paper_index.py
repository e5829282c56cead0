"""Where each table, figure, equation and trajectory of the papers is found in the book."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from html import escape
from pathlib import Path

from repro.errors import require
from repro_companion.book.project import Project
from repro_companion.book.published import read_csv
from repro_companion.book.scorecard_page import PAPERS

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
    def code_link(self) -> str:
        """The place in the API reference, from the root of the site; empty where no public code is named."""
        if self.code.split(".")[0] not in PUBLIC:
            return ""
        package, *modules = [part for part in self.code.split(".")[:-1] if part.islower()]
        return f"api/{'.'.join((package, *(modules[:-1] or modules)))}.html#{self.code}"


PUBLIC = ("repro", "repro_live")
"""Packages that are in the API reference."""
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


def index_page(entries: Sequence[IndexEntry]) -> str:
    """Return the index as MyST: a heading for each paper, and a table for each kind of artefact.

    Parameters
    ----------
    entries
        What the papers contain.
    """
    parts = []
    for paper in dict.fromkeys(entry.paper for entry in entries):
        parts.append(f"## {PAPERS.get(paper, paper)}")
        for kind, heading in KINDS.items():
            chosen = [entry for entry in entries if (entry.paper, entry.kind) == (paper, kind)]
            if chosen:
                parts.append(_table(f"{PAPERS.get(paper, paper)}: {heading.lower()}", chosen))
    return "\n\n".join(parts) + "\n"


def _table(title: str, entries: list[IndexEntry]) -> str:
    head = "".join(f'<th scope="col">{name}</th>' for name in ("In the paper", "Shows", "Here", "Where"))
    # no blank line: it would end the block of HTML for MyST
    lines = [
        f'<div class="scorecard-scroll" tabindex="0" role="region" aria-label="{escape(title)}">',
        '<table class="scorecard paper-index">',
        f"<caption>{escape(title)}</caption>",
        f"<thead><tr>{head}</tr></thead>",
        "<tbody>",
        *map(_line, entries),
        "</tbody>",
        "</table>",
        "</div>",
    ]
    return "\n".join(lines)


def _line(entry: IndexEntry) -> str:
    here = entry.status + (f" ({entry.note})" if entry.note else "")
    where = f'<a href="{escape(entry.link)}">{escape(_title(entry))}</a>'
    if entry.code:
        name = entry.code.rsplit(".", 1)[-1]
        named = f"<code>{escape(name)}</code>"
        where += f', <a href="{escape(entry.code_link)}">{named}</a>' if entry.code_link else f", {named}"
    return (
        f'<tr><th scope="row">{escape(entry.artefact)}</th><td>{escape(entry.shows)}</td>'
        f"<td>{escape(here)}</td><td>{where}</td></tr>"
    )


def _title(entry: IndexEntry) -> str:
    return entry.page.rsplit("/", 1)[-1].replace("_", " ")
