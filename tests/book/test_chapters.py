"""The chapter pages: complete, their equations those of the papers, their numbers those of the pages they sum up."""

from __future__ import annotations

import importlib
import inspect
import json
import re
from functools import cache
from pathlib import Path
from xml.etree import ElementTree

import pytest
import yaml

from repro_companion.book.after.paper_index import read_index

ROOT = Path(__file__).resolve().parents[2]
CHAPTERS = ROOT / "book" / "chapters"

PARTS = {
    "first_steps": "From an equation to a page",
    "magnets": "Learned magnetic proprioception",
    "imus": "Shape from IMUs",
    "particles": "Probabilistic curvature sensing",
    "live": "Your own robot",
    "one_robot": "One robot, many sensors",
    "speed": "Speed and sweeps",
}
"""The part of the book that each page opens."""

PAPER_OF = {
    "first_steps": "baaij2023",
    "magnets": "baaij2023",
    "imus": "martin2022",
    "particles": "mitchell2021",
    "speed": "baaij2023",
}
"""Pages whose numbered equations are of one paper, in the code that the index of the papers names."""

HEADINGS = ["The question", "The idea", "The equations", "The result", "What to read next"]
EQUATION = re.compile(r"^\(([a-z0-9-]+)\)=\n\$\$\n(.*?)\n\$\$$", re.MULTILINE | re.DOTALL)
ROLE = re.compile(r"\{py:(\w+)\}`~(repro[\w.]+)`")
NUMBER = r"(?<![\w.])\d+(?:\.\d+)?(?:e-?\d+)?"
PHRASE = re.compile(
    rf"{NUMBER}(?:(?: to | and ){NUMBER})*(?: (?:%|mm|mT|deg|s|times|random|particles)(?!\w))?"
)
PLACES = re.compile(r"\b(?:eqs?\.|sections?|Figs?\.|Table)\s+[(\d][\d.()]*(?:(?:,| and| to) [(\d][\d.()]*)*")


def page(name: str) -> str:
    """Return the source of a chapter page."""
    return (CHAPTERS / f"{name}.md").read_text(encoding="utf-8")


def sections(name: str) -> dict[str, str]:
    """Return the text below each heading of the second level."""
    parts = re.split(r"^## (.+)$", page(name), flags=re.MULTILINE)
    return dict(zip(parts[1::2], parts[2::2], strict=True))


def prose(text: str) -> str:
    """Return what is left without figures, formulas, roles and the targets of links, on one line."""
    for pattern, new in (
        (r"```.*?```", " "),
        (r"\([a-z0-9-]+\)=\n", ""),
        (r"\$\$.*?\$\$", " "),
        (r"\$[^$]*\$", "x"),
        (r"\{[\w:]+\}`[^`]*`", "x"),
        (r"\[([^\]]*)\]\([^)]*\)", r"\1"),
        (r"[*]+", ""),
    ):
        text = re.sub(pattern, new, text, flags=re.DOTALL)
    return " ".join(text.split())


@cache
def opening(notebook: str) -> str:
    """Return question and answer of a notebook, on one line."""
    cells = json.loads((ROOT / "notebooks" / f"{notebook}.ipynb").read_text(encoding="utf-8"))["cells"]
    text = "".join(next(cell for cell in cells if cell["cell_type"] == "markdown")["source"])
    found = re.search(r"\*\*Question.*?(?=\n\n\*\*Source)", text, re.DOTALL)
    assert found, f"{notebook} does not open with question, answer and source"
    return " ".join(found[0].replace("*", "").split())


def notebooks_in(text: str) -> list[str]:
    """Return the notebooks that a text links."""
    return re.findall(r"\]\(\.\./notebooks/(\w+)\.ipynb\)", text)


def results(name: str) -> list[str]:
    """Return the paragraphs and list items of the result."""
    return [item for item in re.split(r"\n\n|\n(?=- )", sections(name)["The result"].strip()) if item.strip()]


def unheld(phrase: str, text: str) -> bool:
    """Tell whether a text lacks a phrase, as whole numbers."""
    return re.search(rf"(?<![\w.]){re.escape(phrase)}(?![\d]|\.\d)", text) is None


def test_every_page_opens_a_part():
    assert sorted(path.stem for path in CHAPTERS.glob("*.md")) == sorted(PARTS)


@pytest.mark.parametrize("name", PARTS)
def test_form(name):
    """Question, idea in three sentences, equations, result, what to read next; short enough to be read."""
    assert list(sections(name)) == HEADINGS
    idea = prose(sections(name)["The idea"])
    assert len(re.findall(r"[.!?](?= [A-Z]|$)", idea)) == 3, idea
    assert "?" in sections(name)["The question"]
    assert len(page(name).splitlines()) <= 120


@pytest.mark.parametrize("name", PARTS)
def test_every_page_of_the_part_is_summed_up(name):
    """What the part holds, by the table of contents, stands in the result or is recommended."""
    contents = yaml.safe_load((ROOT / "book" / "_toc.yml").read_text(encoding="utf-8"))
    (part,) = [part for part in contents["parts"] if part["caption"] == PARTS[name]]
    files = [item["file"] for item in part["chapters"] if not item["file"].startswith("chapters/")]
    for file in files:
        ending = ".ipynb" if file.startswith("notebooks/") else ".md"
        assert f"(../{file}{ending})" in sections(name)["The result"], file


@pytest.mark.parametrize("name", PARTS)
def test_links_lead_to_sources(name):
    for link in re.findall(r"\]\(([^)#]+)\)", page(name)):
        if link.startswith("../notebooks/"):
            assert (ROOT / link.removeprefix("../")).is_file(), link
        else:
            assert (CHAPTERS / link).is_file(), link


@pytest.mark.parametrize("name", PARTS)
def test_numbers_of_the_result_stand_in_the_notebooks(name):
    """Every number, with its unit and as a whole range, is copied from the answer of a notebook linked beside it."""
    for item in results(name):
        text = PLACES.sub("", prose(item))
        sources = " ".join(map(opening, notebooks_in(item)))
        missing = [phrase for phrase in PHRASE.findall(text) if unheld(phrase, sources)]
        assert not missing, f"{missing} of: {item}"


@pytest.mark.parametrize("name", PARTS)
def test_nothing_else_types_numbers(name):
    """Outside the result there are no measured numbers that could go stale: only places in the papers."""
    for heading, text in sections(name).items():
        if heading != "The result":
            assert not re.findall(NUMBER, PLACES.sub("", prose(text))), heading


def test_a_changed_number_is_found():
    """The comparison is of whole numbers with their units."""
    held = "at 0.019 to 0.022 mm, 11.5 mm and 0.44 times that; nine takes 1.8 deg)."
    assert PHRASE.findall("0.019 to 0.022 mm and 1.8 deg, in 2 ways") == ["0.019 to 0.022 mm", "1.8 deg", "2"]
    assert not any(unheld(phrase, held) for phrase in ("0.019 to 0.022 mm", "1.8 deg", "0.44 times"))
    changed = ("0.018 to 0.022 mm", "0.022 times", "1.5 mm", "0.4", "11", "0.44 mm")
    assert all(unheld(phrase, held) for phrase in changed)


@pytest.mark.parametrize("name", ["magnets", "imus", "particles"])
def test_verdicts_come_from_the_build(name):
    """Counts of verdicts are included from what the build writes, and typed nowhere."""
    result = sections(name)["The result"]
    assert f"```{{include}} ../generated/verdicts_{PAPER_OF[name]}.md\n```" in result
    assert not re.findall(r"\d+ (?:reproduced|better|differs|not comparable|missing)", page(name))


@pytest.mark.parametrize("name", PARTS)
def test_equations_have_labels_and_the_numbers_of_the_paper(name):
    """A label ends in the number that stands at the right; an equation of ours has a word and no number."""
    found = EQUATION.findall(page(name))
    assert 3 <= len(found) == page(name).count("$$") / 2
    assert len({label for label, _ in found}) == len(found)
    for label, formula in found:
        prefix, _, ending = label.rpartition("-eq-")
        assert prefix == name.replace("_", "-")
        # in the formula: one set by \\tag is pushed to the right, and what is wider than the screen begins at its end
        number = re.findall(r" \\qquad \\text\{\((\d+)\)\}$", formula)
        assert number == ([ending] if ending.isdigit() else []), label
        assert r"\tag" not in formula


@pytest.mark.parametrize("name", PAPER_OF)
def test_equations_are_linked_to_what_implements_them(name):
    """The next name of the package after an equation is the one in the index of the papers."""
    index = read_index(ROOT / "data" / "published" / "index.csv")
    code = {entry.artefact: entry.code for entry in index if entry.paper == PAPER_OF[name]}
    for match in EQUATION.finditer(page(name)):
        number = match[1].rpartition("-eq-")[2]
        if number.isdigit():
            after = ROLE.search(page(name), match.end())
            assert after is not None
            assert after[2] == code[f"eq. ({number})"], match[1]


@pytest.mark.parametrize("name", PARTS)
def test_names_of_the_package_exist(name):
    """A reference leads to where the name is defined, and says what it is."""
    roles = ROLE.findall(page(name))
    assert len(roles) >= 2
    assert page(name).count("{py:") == len(roles)
    for kind, target in roles:
        module, _, attribute = target.rpartition(".")
        found = getattr(importlib.import_module(module), attribute)
        assert found.__module__ == module, target
        assert kind == ("class" if inspect.isclass(found) else "func"), target


@pytest.mark.parametrize("path", sorted(CHAPTERS.glob("*.svg")), ids=lambda path: path.stem)
def test_schematics(path):
    """Drawn in the colour of the text, with a name for those who do not see it, and used."""
    figure = ElementTree.parse(path).getroot()
    drawing = figure[0]
    assert drawing.get("role") == "img"
    assert len(drawing.get("aria-label", "")) > 40
    assert drawing.get("fill") == "currentColor"
    assert f":file: {path.name}" in page(path.stem)
    assert "http" not in path.read_text(encoding="utf-8")
