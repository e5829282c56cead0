"""What a change of a parameter does: computed by the build, beside the results, shown below the form."""

from __future__ import annotations

import json
import re
import shlex
from pathlib import Path

import nbformat
import pandas as pd
import pytest
from edition1_companion.book.after.alternatives import Alternative, alternatives_of, run_until_written
from edition1_companion.book.after.before_after import WHOLE, check, compared
from edition1_companion.book.after.page_notes import with_notes
from edition1_companion.book.parameters import convert_all, declared_parameters
from edition1_companion.book.project import Project
from edition1_companion.book.run_form import command_line
from edition1_companion.book.runner import read_notebook, run_notebook
from edition1_companion.cli import app
from test_build import CONFIG, TITLE, executed

PROJECT = Project(Path(__file__).resolve().parents[4])
PAGES = sorted(PROJECT.notebooks.glob("*.ipynb"))
ONLY_SHOWN = {"sweep"}
"""Pages on which a parameter only chooses what is shown of a committed table."""
SIX = {"title": "six", "parameters": {"n": 6}, "table": "table_a", "rows": {}, "values": {"third": "n / 3"}}


def set_alternatives(path: Path, *alternatives: dict) -> None:
    notebook = json.loads(path.read_text())
    notebook["metadata"]["repro"] = {"alternatives": alternatives}
    path.write_text(json.dumps(notebook))


@pytest.fixture
def book(root: Path, notebook_at, writes_a_table) -> Path:
    """Return a project of one page with an exercise, whose last cell counts how often it is run."""
    counts = "from pathlib import Path\nwith Path('counted').open('a') as file:\n    file.write('x')"
    path = notebook_at(root / "notebooks" / "a.ipynb", writes_a_table("table_a"), counts)
    exercise = (
        '{"cell_type": "markdown", "id": "exercise", "metadata": {}, "source": ["## Exercise\\n\\nGuess."]},'
    )
    path.write_text(path.read_text().replace('"cells": [', '"cells": [' + TITLE + exercise, 1))
    set_alternatives(path, SIX | {"exercise": "this run"})
    (root / "book").mkdir()
    (root / "book/_config.yml").write_text(CONFIG)
    (root / "book/_toc.yml").write_text("format: jb-book\nroot: index\nchapters:\n- file: notebooks/a\n")
    (root / "book/index.md").write_text("# Small\n\n```{include} generated/counts.md\n```\n")
    return root


def test_a_page_shows_the_run_before_and_after(book, build):
    first = build()
    assert first.returncode == 0, first.stdout + first.stderr
    assert "alternatives: 1 short runs with other parameters" in first.stdout
    html = page_with_notes(book)
    assert "Before and after: six" in html
    assert "repro run notebooks/a.ipynb -p n 6" in html
    shown = re.search(r'<details class="before-after">.*?</details>', html, re.DOTALL)
    assert shown
    cells = re.findall(r"<t[dh][^>]*>([^<]*)</t[dh]>", shown[0])
    assert cells == ["third, before", "third, after", "1", "2"]
    assert 'href="#before-after-0"' in html
    # neither among the results, nor run beyond the table
    assert (book / "results/table_a.csv").read_text() == "n,third\n3,1\n"
    assert (book / "counted").read_text() == "x"
    (place,) = (book / ".cache/alternatives/a").iterdir()
    assert (place / "table_a.csv").read_text() == "n,third\n6,2\n"

    again = build()
    assert "alternatives" not in again.stdout
    assert "1 of 1 notebooks were up to date; the site was too." in again.stdout
    (place / "table_a.csv").write_text("edited by hand\n")
    assert "alternatives: 1 short runs" in build().stdout
    assert (place / "table_a.csv").read_text() == "n,third\n6,2\n"

    set_alternatives(book / "notebooks/a.ipynb")
    assert executed(build().stdout) == {"a"}
    assert not place.exists()
    assert "before-after" not in page_with_notes(book)


def page_with_notes(book: Path) -> str:
    """Return all Markdown of the page as the site shows it."""
    page = json.loads((book / "book/notebooks/a.ipynb").read_text())
    cells = with_notes(page, Project(book), "a")["cells"]
    return "\n".join("".join(cell["source"]) for cell in cells if cell["cell_type"] == "markdown")


def test_an_alternative_that_fails_stops_the_build(book, build, notebook_at, writes_a_table):
    path = notebook_at(book / "notebooks/a.ipynb", "1 / (n - 6)", writes_a_table("table_a"))
    set_alternatives(path, SIX)
    done = build()
    assert done.returncode == 1
    head = "notebooks/a.ipynb with n=6 failed in code cell 2: 1 / (n - 6)\n"
    assert head + "  ZeroDivisionError: division by zero\n" in done.stderr
    set_alternatives(path, SIX | {"table": "other", "parameters": {"n": 5}})
    assert "notebooks/a.ipynb with n=5 does not write the table other.csv\n" in build().stderr
    set_alternatives(path, SIX | {"wrong": 1})
    assert "Input alternatives of the metadata of a.ipynb must be as its class has it" in build().stderr


def test_a_run_up_to_a_table_writes_what_the_whole_run_writes(tmp_path, monkeypatch):
    notebook, parameters = PROJECT.notebooks / "kinematics.ipynb", {"delta_mm": 34.56}
    run_notebook(notebook, parameters, tmp_path / "whole.ipynb", tmp_path / "whole", project=PROJECT)
    part = tmp_path / "part"
    part.mkdir()
    monkeypatch.setenv("REPRO_RESULTS_DIR", str(part))
    run_until_written(read_notebook(notebook), parameters, part / "kinematics_equation_15.csv")
    names = {path.name for path in part.iterdir()}
    assert names == {"kinematics_shapes.csv", "kinematics_equation_15.csv"}
    assert all((part / name).read_bytes() == (tmp_path / "whole" / name).read_bytes() for name in names)


def test_rows_alike_are_averaged_and_others_stand_beside_a_dash():
    one = Alternative(
        "x", {}, "t", {"kind": "kind"}, {"size [mm]": "abs(x_mm)", "twice": "2 * x_mm"}, "x_mm < 9"
    )
    before = pd.DataFrame({"kind": ["b", "a", "b", "b"], "x_mm": [-1.0, 2.0, 3.0, 9.0]})
    after = pd.DataFrame({"kind": ["b", "c"], "x_mm": [float("inf"), 5.0]})
    table = compared(one, before, after.assign(x_mm=[8.0, 5.0]))
    assert list(table.columns) == [
        "kind",
        "size [mm], before",
        "size [mm], after",
        "twice, before",
        "twice, after",
    ]
    rows = table.fillna(-1).to_numpy().tolist()
    assert rows == [["b", 2, 8, 2, 16], ["a", 2, -1, 4, -1], ["c", -1, 5, -1, 10]]


@pytest.mark.parametrize("path", PAGES, ids=lambda path: path.stem)
def test_alternatives_of_the_book(path):
    """Values are allowed, and what is called the run of the exercise is its own command."""
    notebook = read_notebook(path)
    alternatives = alternatives_of(notebook, path.name)
    assert bool(alternatives) != (path.stem in ONLY_SHOWN)
    declared = declared_parameters(notebook, path.name)
    texts = [cell.source for cell in notebook.cells if cell.source.startswith("## Exercise\n")]
    commands = re.findall(r"^\.venv/bin/repro (run .+)$", "\n".join(texts), re.MULTILINE)
    asked = [values_of(command, declared) for command in commands]
    for one in alternatives:
        run = values_of(command_line("x.ipynb", one.runs()["after"]).partition(" ")[2], declared)
        assert run == one.runs()["after"]
        assert one.parameters
        assert (run in asked) == (one.exercise in WHOLE)


def values_of(command: str, declared: dict) -> dict:
    _, bound, _ = app.parse_args(shlex.split(command), exit_on_error=False, print_error=False)
    return convert_all(bound.kwargs.get("parameters") or [], declared, "x.ipynb")


def test_a_notebook_says_it_in_its_metadata():
    notebook = nbformat.v4.new_notebook(metadata={"repro": {"alternatives": [SIX]}})
    assert alternatives_of(notebook, "a.ipynb") == [Alternative(**SIX)]


@pytest.mark.parametrize(
    ("exercise", "run"),
    [("this run", "this run"), ("this run first", "this run"), ("in full", "a smaller run")],
)
def test_a_smaller_run_than_the_exercise_asks_for_is_called_so(exercise, run):
    assert f"Check your prediction: {run}, before" in check(Alternative(**SIX, exercise=exercise))
