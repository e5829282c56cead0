"""Results in words: what a cell gives stands in text, captions and alternative texts, and nothing is left open."""

from __future__ import annotations

import nbformat
import pytest
from nbformat.v4 import new_code_cell, new_markdown_cell, new_notebook

from edition1.errors import InputError
from edition1_companion.book.project import find_project
from edition1_companion.book.runner import run_notebook
from edition1_companion.book.values import fill, filled

FIGURE = {
    "figure": {"caption": "It is {{ratio}} times, below {setting}`60 deg`.", "name": "fig-x"},
    "image": {"alt": "{{ ratio }}."},
}
CELLS = (
    ("markdown", "**Answer.** It is {{ratio}} times print, {{wrong}} aside."),
    (
        "code",
        "from edition1_companion.book.values import give, say\ngive(ratio=f'{1 / 3:.2f}')\nsay(f'It is {2:.1f}.')",
    ),
)


def write(path, cells):
    notebook = new_notebook(
        cells=[new_markdown_cell(t) if kind == "markdown" else new_code_cell(t) for kind, t in cells]
    )
    notebook.cells[-1].metadata["mystnb"] = FIGURE
    nbformat.write(notebook, path)


def run(tmp_path, cells):
    source, output = tmp_path / "page.ipynb", tmp_path / "run" / "page.ipynb"
    write(source, cells)
    run_notebook(source, {}, output, tmp_path / "results", project=find_project())
    return nbformat.read(output, as_version=4)


def test_values_stand_in_text_caption_and_alternative_text(tmp_path):
    text, code = (("markdown", CELLS[0][1].replace("{{wrong}} aside", "exactly")), CELLS[1])
    executed = run(tmp_path, [text, code])
    assert executed.cells[0].source == "**Answer.** It is 0.33 times print, exactly."
    about = executed.cells[1].metadata["mystnb"]
    assert (about["figure"]["caption"], about["image"]["alt"]) == ("It is 0.33 times, below 60 deg.", "0.33.")
    assert [output.data["text/markdown"] for output in executed.cells[1].outputs] == ["It is 2.0."]
    assert executed.metadata["repro"]["values"] == {"ratio": "0.33"}


def test_an_open_place_stops_the_run(tmp_path):
    with pytest.raises(InputError, match=r"\{\{wrong\}\}.*cell 0 of page.ipynb.*one of ratio"):
        run(tmp_path, CELLS)


def test_filling_twice_changes_nothing():
    notebook = new_notebook(cells=[new_markdown_cell("One text.")])
    fill(notebook, "page")
    assert notebook.cells[0].source == "One text."
    assert filled("{{table_1.ratio}} of {{x}}", {"table_1.ratio": "0.81", "x": "y"}, "here") == "0.81 of y"
    with pytest.raises(InputError, match="one of none"):
        filled("{{a}}", {}, "here")
