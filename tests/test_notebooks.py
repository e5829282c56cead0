"""What is asked of a page: its size, and that no result is typed into its text."""

from __future__ import annotations

import ast
import json
import re
from pathlib import Path

import pandas as pd
import pytest

from repro.common import InputError

ROOT = Path(__file__).resolve().parents[1]
PAGES = {
    path.stem: json.loads(path.read_text(encoding="utf-8"))["cells"]
    for path in sorted(ROOT.glob("notebooks/*.ipynb"))
}
NO_PROSE = re.compile(
    r"```.*?```|\$\$.*?\$\$|\$[^$\n]*\$|`[^`\n]*`|<[^>]+>|^\|.*?$|\{[a-z:_]+\}|\]\([^)]*\)",
    re.DOTALL | re.MULTILINE,
)
"""Code, formulas, rows of tables, places of links."""
HIDDEN = {"parameters", "remove-input", "hide-input"}
DIRECTIVE = re.compile(r"^(`{3,}|:{3,})\{(?:dropdown|figure)\}.*?^\1\s*$", re.DOTALL | re.MULTILINE)


def sources(page: str, kind: str) -> list[str]:
    """Return the cells of one kind."""
    return ["".join(cell["source"]) for cell in PAGES[page] if cell["cell_type"] == kind]


@pytest.mark.parametrize("page", PAGES)
def test_a_page_is_short(page):
    """CONTRIBUTING says so: 12 cells, 110 statements, 88 columns where a reader sees the code, 1,000 words."""
    code = sources(page, "code")
    assert len(code) <= 13, "12 and the parameters"
    nodes = [node for cell in code for node in ast.walk(ast.parse(cell))]
    assert sum(isinstance(node, ast.stmt) for node in nodes) <= 110
    shown = [
        "".join(cell["source"])
        for cell in PAGES[page]
        if cell["cell_type"] == "code" and not HIDDEN & set(cell["metadata"].get("tags", []))
    ]
    assert max(len(line) for cell in shown for line in cell.splitlines()) <= 88
    text = NO_PROSE.sub(" ", DIRECTIVE.sub(" ", "\n".join(sources(page, "markdown"))))
    assert len(re.findall(r"[A-Za-zÀ-ÿ'’]+", text)) <= 1000


@pytest.mark.parametrize("page", PAGES)
def test_a_page_shows_its_item_first(page):
    tags = [tag for cell in PAGES[page] for tag in cell["metadata"].get("tags", [])]
    assert 1 <= tags.count("first") <= 2
    assert tags.count("parameters") == 1


@pytest.mark.parametrize("page", PAGES)
def test_a_page_outside_of_the_project_stops_in_its_first_cell(page, tmp_path, monkeypatch):
    """As papermill runs it from another folder: before the work, not where it saves a table."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("REPRO_RESULTS", raising=False)
    parameters, first, *_ = sources(page, "code")
    with pytest.raises(InputError, match="must be inside a checkout of the project; instead received"):
        exec(f"{parameters}\n{first}", {})


@pytest.mark.parametrize("page", PAGES)
def test_no_result_is_typed_into_the_text(page):
    """A number with three or more significant digits that stands in a column that the page computed."""
    code = "\n".join(sources(page, "code"))
    computed: set[str] = set()
    for name in set(re.findall(r"\"([a-z0-9_.]+)\"", code)):
        path = ROOT / "results" / f"{name}.csv"
        if path.is_file():
            numbers = pd.read_csv(path).select_dtypes("float").to_numpy().ravel()
            computed |= {f"{number:.{digits}g}" for number in numbers for digits in (3, 4, 5)}
    text = DIRECTIVE.sub(" ", "\n".join(sources(page, "markdown")))
    typed = {
        found
        for found in re.findall(r"(?<![\w.{-])\d+\.\d+", text)
        if len(found.replace(".", "").lstrip("0")) > 2
    }
    assert typed & computed == set()
