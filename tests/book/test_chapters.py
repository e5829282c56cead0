"""The chapter pages: complete, their equations those of the papers, their numbers those of the pages they sum up."""

from __future__ import annotations

import ast
import importlib
import inspect
import json
import re
from pathlib import Path
from xml.etree import ElementTree

import pytest
from loose_digits import loose_digits, texts
from papermill import inspect_notebook

from edition1_companion.book.after.paper_index import read_index
from edition1_companion.book.values import PLACE

ROOT = Path(__file__).resolve().parents[2]
CHAPTERS = ROOT / "book" / "chapters"

PARTS = ("first_steps", "magnets", "imus", "particles", "live", "one_robot", "speed")
OTHER_PAGES = {"live": ["own_robot.md", "wire_formats.md"], "speed": ["sweeps.md"]}
"""Pages of a chapter that are no notebooks."""

PAPER_OF = {
    "first_steps": "baaij2023",
    "magnets": "baaij2023",
    "imus": "martin2022",
    "particles": "mitchell2021",
    "speed": "baaij2023",
}
"""Pages whose numbered equations are of one paper, in the code that the index of the papers names."""

PROSE = [*ROOT.glob("notebooks/*.ipynb"), *ROOT.glob("book/*.md"), *ROOT.glob("book/c*/*.md")]
"""Pages of the book, less those that are generated."""
WITH_VALUES = [path for path in PROSE if path.suffix == ".md" and "{{" in path.read_text(encoding="utf-8")]
DERIVED = frozenset(["first_steps", "magnets", "imus", "particles"])
"""Chapters that derive what they state; `test_derivations` checks each step."""
HEADINGS = ["The question", "The idea", "The equations", "The result", "Exercises", "What to read next"]
HEADINGS_WITH_DERIVATIONS = [*HEADINGS[:4], "Derivations", *HEADINGS[4:]]
FRONT_MATTER = re.compile(r"\A---\n.*?\n---\n\n?", re.DOTALL)
EQUATION = re.compile(r"^\(([a-z0-9-]+)\)=\n\$\$\n(.*?)\n\$\$$", re.MULTILINE | re.DOTALL)
ROLE = re.compile(r"\{py:(\w+)\}`~((?:repro|edition1)[\w.]+)`")
PLACES = re.compile(r"\b(?:eqs?\.|sections?|Figs?\.|Table)\s+[(\d][\d.()]*(?:(?:,| and| to) [(\d][\d.()]*)*")


def page(name: str) -> str:
    """Return the source of a chapter page, as far as it is read."""
    return FRONT_MATTER.sub("", (CHAPTERS / f"{name}.md").read_text(encoding="utf-8"))


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


def test_every_page_opens_a_part():
    assert sorted(path.stem for path in CHAPTERS.glob("*.md")) == sorted(PARTS)


@pytest.mark.parametrize("name", PARTS)
def test_form(name):
    """Question, idea in three sentences, equations, result, derivations, exercises, what to read next.

    Short enough to be read; derivations and exercises have room of their own.
    """
    assert list(sections(name)) == (HEADINGS_WITH_DERIVATIONS if name in DERIVED else HEADINGS)
    idea = prose(sections(name)["The idea"])
    assert len(re.findall(r"[.!?](?= [A-Z]|$)", idea)) == 3, idea
    assert "?" in sections(name)["The question"]
    apart = sum(len(sections(name).get(part, "").splitlines()) for part in ("Derivations", "Exercises"))
    assert len(page(name).splitlines()) - apart <= 120
    assert apart <= 120


@pytest.mark.parametrize("name", PARTS)
def test_two_exercises_with_folded_solutions(name):
    """Each is done by a command that names a notebook of the book and parameters that it has."""
    exercises = sections(name)["Exercises"]
    option = r" -p \w+ (?:\"[^\"]*\"|\S+)"
    commands = re.findall(
        rf"```bash\n\.venv/bin/repro run (notebooks/\w+\.ipynb)((?:{option})+)\n```", exercises
    )
    assert len(commands) == exercises.count("```bash") == exercises.count("```{dropdown} Solution") == 2
    for notebook, options in commands:
        known = inspect_notebook(str(ROOT / notebook))
        assert set(re.findall(r" -p (\w+) ", options)) <= set(known)
        assert chapter_of(ROOT / notebook) == name or f"../{notebook}" in exercises, notebook


def chapter_of(notebook: Path) -> str:
    """Return the chapter that a notebook names below its title."""
    lines = json.loads(notebook.read_text(encoding="utf-8"))["cells"][0]["source"]
    (name,) = re.findall(r"Chapter: \[[^\]]+\]\(\.\./chapters/(\w+)\.md\)\.$", lines[2].strip())
    return name


@pytest.mark.parametrize("notebook", sorted(ROOT.glob("notebooks/*.ipynb")), ids=lambda path: path.stem)
def test_every_notebook_is_summed_up_by_its_chapter(notebook):
    """Below its title stands its chapter, whose result links it by its title."""
    title = (
        json.loads(notebook.read_text(encoding="utf-8"))["cells"][0]["source"][0].removeprefix("# ").strip()
    )
    result = sections(chapter_of(notebook))["The result"]
    assert f"[{title}](../notebooks/{notebook.name})" in result


@pytest.mark.parametrize("name", OTHER_PAGES)
def test_every_other_page_is_summed_up(name):
    assert all(f"(../{page})" in sections(name)["The result"] for page in OTHER_PAGES[name])


@pytest.mark.parametrize("name", PARTS)
def test_links_lead_to_sources(name):
    for link in re.findall(r"\]\(([^)#]+)\)", page(name)):
        if link.startswith("../notebooks/"):
            assert (ROOT / link.removeprefix("../")).is_file(), link
        else:
            assert (CHAPTERS / link).is_file(), link


def given_by(notebook: str) -> set[str]:
    """Return the names of the results that a notebook makes known: ``give(name=…)``."""
    cells = json.loads((ROOT / "notebooks" / f"{notebook}.ipynb").read_text(encoding="utf-8"))["cells"]
    code = "\n".join("".join(cell["source"]) for cell in cells if cell["cell_type"] == "code")
    calls = [node for node in ast.walk(ast.parse(code)) if isinstance(node, ast.Call)]
    named = [call for call in calls if isinstance(call.func, ast.Name) and call.func.id == "give"]
    return {f"{notebook}.{keyword.arg}" for call in named for keyword in call.keywords}


@pytest.mark.parametrize("path", WITH_VALUES, ids=lambda path: path.stem)
def test_results_are_filled_in_from_notebooks(path):
    """Every result in the text of a page is a value that the notebook it names gives."""
    places = set(PLACE.findall(path.read_text(encoding="utf-8")))
    known = {name for place in places for name in given_by(place.partition(".")[0])}
    assert places <= known


@pytest.mark.parametrize("path", PROSE, ids=lambda path: f"{path.parent.name}-{path.stem}")
def test_no_digit_is_loose(path):
    """Nothing measured is typed: every digit is of a paper, a setting, or put there by the build."""
    loose = {place: found for place, text in texts(path).items() if (found := loose_digits(text))}
    assert loose == {}


def test_a_typed_result_is_found():
    """As on the page of the bend tests once: a number of events that the table did not hold."""
    assert loose_digits("In the recordings 7, 6 and 3 events; twice as many.") != []
    assert (
        loose_digits("Ten times as far, {setting}`5 mm` or {{bend_tests.far}} mm, eq. (3), Fig. 9, T2") != []
    )
    vouched = "{setting}`5 mm`, {{bend_tests.far}} mm, eqs (3) to (7), Fig. 9, section 3.1, T2, $x^2$, `f(2)`"
    assert loose_digits(vouched) == []
    assert loose_digits("{setting}`1e-6 m`, {setting}`-3 mV`") == ["{setting}`1e-6 m`", "{setting}`-3 mV`"]
    assert loose_digits("```{dropdown} More\n17 mm\n```\n```python\nx = 3\n```") != []
    assert loose_digits("```{include} a.md\n```\n```python\nx = 3\n```") == []


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
    assert sum(page(name).count(f":file: {path.name}\n") for name in PARTS) == 1
    assert "http" not in path.read_text(encoding="utf-8")
