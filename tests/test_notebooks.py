"""Figures and tables of the notebooks: named as in their papers, with captions and alternative texts."""

from __future__ import annotations

import ast
import importlib.util
import inspect
import json
import re
import statistics
from collections import Counter
from pathlib import Path
from types import ModuleType

import pytest

import edition1 as repro
from edition1_companion.book.after.paper_index import index_path, read_index
from edition1_companion.book.project import Project

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
PACKAGES = ("edition1", "edition1_live", "edition1_companion")
THREE_LINES = 320
"""Characters."""
FOLDED = {"parameters", "hide-input", "remove-input", "hide-cell", "remove-cell"}
"""Tags of cells whose code a reader does not see, or that is none."""
NO_METHOD_OF_ITS_OWN = {"closed_loop", "sweep"}
"""The sweep runs another page; the estimator of the loop is the rig's, which is no part of the library."""


def texts(page: str) -> str:
    """Return the text of a page between its cells of code."""
    cells = NOTEBOOKS[page]["cells"]
    return "\n\n".join("".join(cell["source"]) for cell in cells if cell["cell_type"] == "markdown")


@pytest.mark.parametrize("page", sorted(NOTEBOOKS))
def test_a_page_opens_with_question_answer_and_source(page):
    """In this order, and what is folded comes after them."""
    opening = "".join(NOTEBOOKS[page]["cells"][0]["source"])
    heads = re.findall(
        r"^(?:\*\*(Question|Answer|Source)\.\*\*|```\{dropdown\})", opening, flags=re.MULTILINE
    )
    assert heads[:3] == ["Question", "Answer", "Source"]
    assert not any(heads[3:])


@pytest.mark.parametrize(
    ("page", "told"), FIGURES, ids=lambda x: x if isinstance(x, str) else x["figure"]["name"]
)
def test_figure_tells_what_it_shows(page, told):
    """A caption of sentences, at most three lines, and an alternative text with the essential numbers.

    Numbers of results are put in by the build, and so are sentences that depend on the data found.
    """
    caption, alt = told["figure"]["caption"], told["image"]["alt"]
    assert caption.endswith((".", "}}"))
    assert len(caption) <= THREE_LINES, len(caption)
    assert "$" not in caption, "it is a link's text as well, where no mathematics is set"
    assert re.search(r"\d|\{\{", alt), "the essential numbers"
    assert alt.endswith(".")


def test_names_of_figures_are_unique():
    names = Counter(told["figure"]["name"] for _, told in FIGURES)
    assert [name for name, times in names.items() if times > 1] == []


def code(page: str) -> list[str]:
    """Return the cells of code of a page."""
    return ["".join(cell["source"]) for cell in NOTEBOOKS[page]["cells"] if cell["cell_type"] == "code"]


def taken_from_repro(page: str) -> dict[str, tuple[ModuleType, str]]:
    """Return what a page takes from the package, as ``(module, name)`` by the expression that stands for it there."""
    tree, modules, taken = ast.parse("\n".join(code(page))), {}, {}
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom) and (node.module or "").split(".")[0] in PACKAGES:
            for imported in node.names:
                source, name = importlib.import_module(f"{node.module}"), imported.asname or imported.name
                if is_package(source) and importlib.util.find_spec(f"{node.module}.{imported.name}"):
                    modules[name] = importlib.import_module(f"{node.module}.{imported.name}")
                else:
                    taken[name] = source, imported.name
    for node in ast.walk(tree):
        if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name) and node.value.id in modules:
            taken[ast.unparse(node)] = modules[node.value.id], node.attr
    return taken


def is_package(module: ModuleType) -> bool:
    return hasattr(module, "__path__")


@pytest.mark.parametrize("page", sorted(NOTEBOOKS))
def test_a_page_takes_names_from_where_they_are_defined(page):
    """Not through a module that happens to import them too: it may stop doing so, and only the page would fail."""
    taken = taken_from_repro(page)
    assert taken, "every page computes with the package"
    for expression, (module, name) in taken.items():
        assert hasattr(module, name), f"{expression} does not exist"
        value = getattr(module, name)
        if module is not repro and (inspect.isfunction(value) or inspect.isclass(value)):
            assert value.__module__ == module.__name__, f"{expression} is defined elsewhere"


@pytest.mark.parametrize("page", sorted(NOTEBOOKS))
def test_a_page_takes_no_code_of_another_page(page):
    """Its key would not notice when that code changes."""
    modules = {module.__name__ for module, _ in taken_from_repro(page).values()}
    assert not {name for name in modules if name.startswith("edition1_companion.book.after")}
    of_pages = {name.split(".")[2] for name in modules if name.startswith("edition1_companion.pages.")}
    assert of_pages <= {page}


def visible_code(page: str) -> str:
    """Return the code that the page shows."""
    cells = [cell for cell in NOTEBOOKS[page]["cells"] if cell["cell_type"] == "code"]
    shown = [cell for cell in cells if not FOLDED & set(cell["metadata"].get("tags", ()))]
    return "\n".join("".join(cell["source"]) for cell in shown)


def called_names(code: str) -> set[str]:
    """Return what code calls, or a part of it: ``track`` of ``track(...)``, ``ring`` of ``ring("x").field(...)``."""
    calls = [node.func for node in ast.walk(ast.parse(code)) if isinstance(node, ast.Call)]
    names = set()
    for called in calls:
        while isinstance(called, ast.Attribute):
            called = called.value
        if isinstance(called, ast.Name):
            names.add(called.id)
    return names


@pytest.mark.parametrize("page", sorted(NOTEBOOKS))
def test_a_page_calls_the_library_in_sight(page):
    """Its method is in its cells: robot, model, estimator, parser or generator of a public module."""
    sources = ["".join(c["source"]) for c in NOTEBOOKS[page]["cells"] if c["cell_type"] == "code"]
    nodes = [node for source in sources for node in ast.walk(ast.parse(source))]
    taken = {
        alias.asname or alias.name
        for node in nodes
        if isinstance(node, ast.ImportFrom)
        and (node.module or "").split(".")[0] in ("edition1", "edition1_live")
        for alias in node.names
    }
    called = called_names(visible_code(page)) & taken
    assert bool(called) != (page in NO_METHOD_OF_ITS_OWN), f"calls in sight: {sorted(called)}"


def test_code_in_sight_is_as_long_as_a_page():
    lengths = []
    for page in NOTEBOOKS:
        lines = (line.strip() for line in visible_code(page).splitlines())
        lengths.append(sum(bool(line) and not line.startswith(("#", "import ", "from ")) for line in lines))
    assert 25 <= statistics.median(lengths) <= 60


def draws(module: ModuleType, name: str) -> bool:
    """Tell whether something is a function of a module of figures, and returns one."""
    function = getattr(module, name)
    if "figures" not in module.__name__.rsplit(".")[-1] or not inspect.isfunction(function):
        return False
    return inspect.signature(function).return_annotation == "Figure"


@pytest.mark.parametrize("page", sorted(NOTEBOOKS))
def test_every_cell_that_draws_has_a_caption(page):
    """What a module of figures draws is a figure of the page."""
    drawing = {expression for expression, taken in taken_from_repro(page).items() if draws(*taken)}
    for cell in NOTEBOOKS[page]["cells"]:
        if cell["cell_type"] == "code" and "figure" not in cell["metadata"].get("mystnb", {}):
            tree = ast.parse("".join(cell["source"]))
            called = {ast.unparse(node.func) for node in ast.walk(tree) if isinstance(node, ast.Call)}
            assert called & drawing == set()


def test_captions_are_asked_of_most_pages():
    """The test above knows a function that draws when it sees one."""
    pages = [page for page in NOTEBOOKS if any(draws(*taken) for taken in taken_from_repro(page).values())]
    assert len(pages) > len(NOTEBOOKS) / 2, pages


def names_figure(caption: str, artefact: str) -> bool:
    """Tell whether a caption names a figure of the paper, alone or in a range."""
    ranges = re.findall(r"\bFigs (\d+) (?:to|and) (\d+) of the paper", caption)
    numbers = {f"Fig. {n}" for low, high in ranges for n in range(int(low), int(high) + 1)}
    return artefact in numbers or f"{artefact} of the paper" in caption


def test_ranges_of_figures():
    assert names_figure("Errors: Figs 3 to 5 of the paper.", "Fig. 4")
    assert names_figure("Readings, as in Fig. 4(b) of the paper.", "Fig. 4(b)")
    assert not names_figure("Errors: Figs 3 to 5 of the paper.", "Fig. 6")
    assert not names_figure("Stills, as in Fig. 11 of the paper.", "Fig. 1")


@pytest.mark.parametrize(
    "entry", [e for e in ENTRIES if e.kind == "figure"], ids=lambda e: f"{e.paper}-{e.artefact}"
)
def test_caption_names_the_figure_of_the_paper(entry):
    (caption,) = [told["figure"]["caption"] for _, told in FIGURES if told["figure"]["name"] == entry.anchor]
    assert names_figure(caption, entry.artefact), caption


def test_no_figure_has_two_numbers():
    """The book numbers its figures: a caption that began with the paper's number would read Fig. 61 Fig. 9."""
    assert [
        told["figure"]["name"] for _, told in FIGURES if told["figure"]["caption"].startswith("Fig")
    ] == []


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
