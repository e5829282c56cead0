"""The path of 20 minutes: its stations add up, its commands are accepted, its figures exist."""

from __future__ import annotations

import json
import re
import shlex
from pathlib import Path

import pytest

from edition1_companion.book.parameters import convert, convert_all, declared_parameters
from edition1_companion.book.runner import read_notebook
from edition1_companion.cli import app

ROOT = Path(__file__).resolve().parents[2]
PAGE = (ROOT / "book" / "reading.md").read_text(encoding="utf-8")
STATIONS = re.findall(
    r"^## (\d+)\. [^\n]+ \((\d+) minutes?\)$(.*?)(?=^## )", PAGE, flags=re.MULTILINE | re.DOTALL
)


def commands(text: str) -> list[list[str]]:
    """Return the lines of the blocks of code, as words."""
    blocks = re.findall(r"```bash\n(.*?)```", text, re.DOTALL)
    return [shlex.split(line) for block in blocks for line in block.strip().splitlines()]


def test_the_stations_take_twenty_minutes():
    assert [int(number) for number, _, _ in STATIONS] == list(range(1, len(STATIONS) + 1))
    assert 6 <= len(STATIONS) <= 8
    assert sum(int(minutes) for _, minutes, _ in STATIONS) == 20


@pytest.mark.parametrize(("number", "minutes", "text"), STATIONS)
def test_station(number, minutes, text):
    """One command, which the command line accepts; of a run, one value that differs from the notebook's own."""
    ((program, *words),) = commands(text)
    assert program == ".venv/bin/repro"
    command, given, *_ = app.parse_args(words, exit_on_error=False, print_error=False)
    if command.__name__ == "run":
        notebook = ROOT / given.arguments["notebook"]
        assert f"](notebooks/{notebook.name})" in text
        declared = declared_parameters(read_notebook(notebook), notebook.name)
        values = convert_all(given.arguments["parameters"], declared, notebook.name)
        values.pop("fast", None)
        ((name, value),) = values.items()
        default = str(declared[name].default).strip("\"'")
        assert value != convert(declared[name], default, notebook.name), f"{name} has this value already"


def test_commands_stand_at_stations():
    assert len(commands(PAGE)) == len(STATIONS)


def test_figures_exist():
    """Every figure that is named is drawn by the notebook that its station links."""
    named = 0
    for _, _, text in STATIONS:
        names = set()
        for notebook in re.findall(r"\]\(notebooks/(\w+\.ipynb)\)", text):
            cells = json.loads((ROOT / "notebooks" / notebook).read_text(encoding="utf-8"))["cells"]
            names |= {cell["metadata"].get("mystnb", {}).get("figure", {}).get("name") for cell in cells}
        wanted = set(re.findall(r"<(fig-[\w-]+)>", text))
        assert wanted <= names
        named += len(wanted)
    assert named == len(re.findall(r"<(fig-[\w-]+)>", PAGE)) > 5


@pytest.mark.parametrize("name", ["index", "reading"])
def test_links_lead_to_sources(name):
    """Pages and notebooks that the entrance names exist."""
    text = (ROOT / "book" / f"{name}.md").read_text(encoding="utf-8")
    for link in re.findall(r"\]\(((?!http)[^)#]+)\)", text):
        source = ROOT / link if link.startswith("notebooks/") else ROOT / "book" / link
        assert source.is_file(), link


def test_every_chapter_is_offered():
    """The landing page and the path lead to every chapter."""
    entrance = (ROOT / "book" / "index.md").read_text(encoding="utf-8")
    for path in (ROOT / "book" / "chapters").glob("*.md"):
        assert f"](chapters/{path.name})" in entrance
        assert f"](chapters/{path.name})" in PAGE
