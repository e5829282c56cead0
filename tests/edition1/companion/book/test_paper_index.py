"""The index of the papers: complete, and every place in it exists."""

from __future__ import annotations

import json
import pkgutil
import re
from pathlib import Path

import pytest

from edition1.errors import InputError
from edition1_companion.book.after.paper_index import (
    COLUMNS,
    IndexEntry,
    index_page,
    index_path,
    page_titles,
    places,
    read_index,
)
from edition1_companion.book.project import Project
from edition1_companion.book.published import read_published

PROJECT = Project(Path(__file__).resolve().parents[4])
ENTRIES = read_index(index_path(PROJECT))

NUMBERED = {
    "baaij2023": {"Table": ["1", "2"], "Fig.": range(1, 12), "eq.": range(1, 19)},
    "mitchell2021": {"Table": [], "Fig.": range(1, 10), "eq.": range(1, 8)},
    "martin2022": {"Table": ["I", "II"], "Fig.": range(1, 7), "eq.": range(1, 8)},
}
"""What each paper numbers, counted in the papers."""

TRAJECTORIES = {
    "baaij2023": {"full lemniscate", "affine flower", "T0", "T1", "T2", "T3", "T4", "T5"},
    "mitchell2021": {"Spiral", "Flower", "Seagull"},
    "martin2022": {"oscillating", "buckling", "circling"},
}


@pytest.mark.parametrize("paper", NUMBERED)
def test_every_number_of_the_papers_is_listed(paper):
    """No table, figure or equation of a paper is left out, and none is made up."""
    for word, numbers in NUMBERED[paper].items():
        pattern = rf"{re.escape(word)} \(?(\w+)\)?"
        found = {
            match[1]
            for entry in ENTRIES
            if entry.paper == paper and (match := re.match(pattern, entry.artefact))
        }
        assert found == {str(number) for number in numbers}, word


@pytest.mark.parametrize("paper", TRAJECTORIES)
def test_every_trajectory_is_listed(paper):
    listed = {entry.artefact for entry in ENTRIES if (entry.paper, entry.kind) == (paper, "trajectory")}
    assert listed >= TRAJECTORIES[paper]


def test_every_row_of_the_scorecard_has_a_place():
    """Whatever the papers print as a number leads to a page."""
    rows = {(key.paper, key.artefact) for key in read_published(PROJECT.published)}
    assert rows <= set(places(ENTRIES))


@pytest.mark.parametrize("entry", ENTRIES, ids=lambda entry: f"{entry.paper}-{entry.artefact}")
def test_places_exist(entry):
    """The page is in the book and has the figure or heading; the code can be imported."""
    anchors = _anchors(entry.page)
    assert not entry.anchor or entry.anchor in anchors, sorted(anchors)
    if entry.code:
        found = pkgutil.resolve_name(entry.code)
        assert entry.code == f"{found.__module__}.{found.__qualname__}"


def _anchors(page: str) -> set[str]:
    """Return the names of a page's figures and the form that links to its headings have."""
    notebook = PROJECT.root / f"{page}.ipynb"
    names = set()
    if notebook.is_file():
        cells = json.loads(notebook.read_text(encoding="utf-8"))["cells"]
        names = {cell["metadata"].get("mystnb", {}).get("figure", {}).get("name", "") for cell in cells}
        text = "\n".join("".join(cell["source"]) for cell in cells if cell["cell_type"] == "markdown")
    else:
        text = (PROJECT.book / f"{page}.md").read_text(encoding="utf-8")
    headings = re.findall(r"^#+ (.+)$", text, flags=re.MULTILINE)
    return names | {re.sub(r"[^a-z0-9]+", "-", heading.lower()).strip("-") for heading in headings}


def test_page():
    """A heading for each paper, tables by kind, links to page and code, and why something is not reproduced."""
    page = index_page(ENTRIES, page_titles(PROJECT, ENTRIES))
    assert re.findall(r"^## (.+)$", page, flags=re.MULTILINE) == [
        "Baaij et al. (2023)",
        "Mitchell et al. (2021)",
        "Martin et al. (2022)",
    ]
    assert '<a href="notebooks/table_1.html">Table 1: shape from magnets in simulation</a>' in page
    assert "<code>relations</code>" in page
    assert "<code>ParticleFilter</code>" in page
    assert "<td>not reproduced (photographs)</td>" in page
    assert page.count("<tr>") == len(ENTRIES) + page.count("<thead>")
    assert not re.search(r"\n\n(?!<table|## )", page.rstrip()), "an empty line ends a block of HTML"


LINE = {
    "paper": "a2020",
    "kind": "figure",
    "artefact": "Fig. 1",
    "shows": "x",
    "status": "redrawn",
    "page": "p",
}


@pytest.mark.parametrize(
    ("lines", "message"),
    [
        (
            [LINE, LINE],
            "Input entry of index.csv must be listed once; instead received a2020 / figure / Fig. 1.",
        ),
        (
            [{**LINE, "kind": "photo"}],
            "Input kind of index.csv must be one of table, figure, equation, trajectory, section; instead received "
            "photo.",
        ),
        (
            [{**LINE, "status": "done"}],
            "Input status of index.csv must be one of regenerated, redrawn, implemented, not reproduced; instead "
            "received done.",
        ),
        (
            [{**LINE, "page": ""}],
            "Input page of a2020 / figure / Fig. 1 of index.csv must be the page to look at; instead received "
            "nothing.",
        ),
    ],
)
def test_broken_index(lines, message, tmp_path):
    path = tmp_path / "index.csv"
    texts = [",".join(line.get(column, "") for column in COLUMNS) for line in lines]
    path.write_text("\n".join([",".join(COLUMNS), *texts]) + "\n", encoding="utf-8")
    with pytest.raises(InputError) as error:
        read_index(path)
    assert str(error.value) == message


def test_links_of_an_entry():
    entry = IndexEntry("a2020", "figure", "Fig. 1", "x", "redrawn", "notebooks/a", "fig-a", "a.track", "")
    assert entry.link == "notebooks/a.html#fig-a"
    assert entry.code_name == "track"
