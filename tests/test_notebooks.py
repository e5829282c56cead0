"""Figures and tables of the notebooks: named as in their papers, with captions and alternative texts."""

from __future__ import annotations

import ast
import importlib
import inspect
import json
import re
from collections import Counter
from pathlib import Path

import pytest

from repro.report.paper_index import index_path, read_index
from repro.report.project import Project

PROJECT = Project(Path(__file__).resolve().parents[1])
NOTEBOOKS = {
    path.stem: json.loads(path.read_text("utf-8")) for path in PROJECT.root.glob("notebooks/*.ipynb")
}
FIGURES = [
    (page, cell["metadata"]["mystnb"])
    for page, notebook in sorted(NOTEBOOKS.items())
    for cell in notebook["cells"]
    if "figure" in cell["metadata"].get("mystnb", {})
]
ENTRIES = [entry for entry in read_index(index_path(PROJECT)) if entry.status in ("regenerated", "redrawn")]
THREE_LINES = 320
"""Characters."""


def texts(page: str) -> str:
    """Return the text of a page between its cells of code."""
    cells = NOTEBOOKS[page]["cells"]
    return "\n\n".join("".join(cell["source"]) for cell in cells if cell["cell_type"] == "markdown")


@pytest.mark.parametrize(
    ("page", "told"), FIGURES, ids=lambda x: x if isinstance(x, str) else x["figure"]["name"]
)
def test_figure_tells_what_it_shows(page, told):
    """A caption of sentences, at most three lines, and an alternative text with the essential numbers."""
    caption, alt = told["figure"]["caption"], told["image"]["alt"]
    assert caption.endswith(".")
    assert len(caption) <= THREE_LINES, len(caption)
    assert "$" not in caption, "it is a link's text as well, where no mathematics is set"
    assert re.search(r"\d", alt), "the essential numbers"
    assert alt.endswith(".")


def test_names_of_figures_are_unique():
    names = Counter(told["figure"]["name"] for _, told in FIGURES)
    assert [name for name, times in names.items() if times > 1] == []


def figure_functions(tree: ast.AST) -> tuple[dict[str, str], set[str]]:
    """Return the names under which modules of figures are imported, and the functions imported from them."""
    modules, functions = {}, set()
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom) and node.module == "repro.report":
            modules |= {x.asname or x.name: x.name for x in node.names if x.name.startswith("figures_")}
        elif isinstance(node, ast.ImportFrom) and (node.module or "").startswith("repro.report.figures_"):
            functions |= {x.asname or x.name for x in node.names}
    return modules, functions


@pytest.mark.parametrize("page", sorted(NOTEBOOKS))
def test_every_cell_that_draws_has_a_caption(page):
    """What a module of figures draws is a figure of the page."""
    code = [cell for cell in NOTEBOOKS[page]["cells"] if cell["cell_type"] == "code"]
    modules, functions = figure_functions(ast.parse("\n".join("".join(cell["source"]) for cell in code)))
    for cell in code:
        for node in ast.walk(ast.parse("".join(cell["source"]))):
            if not isinstance(node, ast.Call):
                continue
            called, draws = node.func, False
            if isinstance(called, ast.Attribute) and isinstance(called.value, ast.Name):
                module = modules.get(called.value.id)
                draws = module is not None and returns_a_figure(module, called.attr)
            elif isinstance(called, ast.Name):
                draws = called.id in functions
            if draws:
                assert "figure" in cell["metadata"].get("mystnb", {}), ast.unparse(node)


def returns_a_figure(module: str, name: str) -> bool:
    """Tell whether a function of a module of figures draws one."""
    function = getattr(importlib.import_module(f"repro.report.{module}"), name)
    return inspect.signature(function).return_annotation == "Figure"


def begins_with(caption: str, artefact: str) -> bool:
    """Tell whether a caption begins with the number of a figure, alone or in a range."""
    if found := re.match(r"Figs (\d+) (?:to|and) (\d+)\b", caption):
        return artefact in {f"Fig. {n}" for n in range(int(found[1]), int(found[2]) + 1)}
    return re.match(rf"{re.escape(artefact)}(?![\d(])", caption) is not None


def test_ranges_of_figures():
    assert begins_with("Figs 3 to 5: errors.", "Fig. 4")
    assert begins_with("Fig. 4(b): readings.", "Fig. 4(b)")
    assert not begins_with("Figs 3 to 5: errors.", "Fig. 6")
    assert not begins_with("Fig. 11, lower row: stills.", "Fig. 1")


@pytest.mark.parametrize(
    "entry", [e for e in ENTRIES if e.kind == "figure"], ids=lambda e: f"{e.paper}-{e.artefact}"
)
def test_caption_begins_with_the_number_of_the_paper(entry):
    (caption,) = [told["figure"]["caption"] for _, told in FIGURES if told["figure"]["name"] == entry.anchor]
    assert begins_with(caption, entry.artefact), caption


@pytest.mark.parametrize(
    "entry", [e for e in ENTRIES if e.kind == "table"], ids=lambda e: f"{e.paper}-{e.artefact}"
)
def test_heading_above_a_table_names_it(entry):
    """Below the title of the page as well, so that the table is found."""
    headings = re.findall(r"^##+ (.+)$", texts(Path(entry.page).name), flags=re.MULTILINE)
    assert any(re.search(rf"{entry.artefact}\b", heading) for heading in headings), headings


@pytest.mark.parametrize(
    "entry",
    [e for e in ENTRIES if e.kind == "section" and e.artefact != "Abstract"],
    ids=lambda e: f"{e.paper}-{e.artefact}",
)
def test_page_names_the_section_whose_numbers_it_has(entry):
    place = entry.artefact.removeprefix("Section ")
    assert re.search(rf"\b{re.escape(place)}\b", texts(Path(entry.page).name), flags=re.IGNORECASE)
