"""Allowed values at the end of a parameter's comment: what keeps to them, and that every notebook of the first edition has them."""

import re
import shlex
import subprocess
import sys
from pathlib import Path

import pytest
from rule_cases import CASES

from edition1.errors import InputError
from edition1_companion.book.parameters import Parameter, convert, convert_all, declared_parameters
from edition1_companion.book.runner import read_notebook
from edition1_companion.cli import app

PROJECT = Path(__file__).resolve().parents[4]
PAGES = sorted(path for path in (PROJECT / "notebooks").glob("*.ipynb") if b"edition1" in path.read_bytes())
FREE = {("recorded_trial", "capture_layout")}
"""Texts and dictionaries of which there is no fixed set: takes, a part of a name, columns of a file of one's own."""


@pytest.mark.parametrize("case", CASES, ids=lambda case: case.meaning)
def test_values_keep_to_the_rule_in_the_comment(case):
    parameter = Parameter("x", case.kind, case.default, case.meaning)
    for text in case.allowed:
        convert(parameter, text, "page.ipynb")
    for text in case.refused:
        with pytest.raises(InputError) as error:
            convert(parameter, text, "page.ipynb")
        assert str(error.value) == (
            f"Input parameter x of page.ipynb must be {case.must_be}; instead received {text}."
        )


def test_words_within_a_comment_are_no_rule():
    parameter = Parameter("x", "float", "1.0", "compared for at least 10 for an estimate [s]")
    assert parameter.rule is None
    assert convert(parameter, "-1", "page.ipynb") == -1


@pytest.mark.parametrize("path", PAGES, ids=lambda path: path.stem)
def test_every_parameter_says_what_is_allowed(path):
    """Its default keeps to it."""
    notebook = read_notebook(path)
    cell = next(cell for cell in notebook.cells if "parameters" in cell.metadata.get("tags", []))
    defaults = {}
    exec(cell.source, defaults)
    for name, parameter in declared_parameters(notebook, path.name).items():
        if parameter.type != "bool":
            assert (parameter.rule is None) == ((path.stem, name) in FREE), name
        if parameter.rule:
            assert parameter.rule.allows(defaults[name]), name


@pytest.mark.parametrize("path", PAGES, ids=lambda path: path.stem)
def test_commands_of_exercises_are_accepted(path):
    notebook = read_notebook(path)
    declared = declared_parameters(notebook, path.name)
    texts = [cell.source for cell in notebook.cells if cell.source.startswith("## Exercise\n")]
    for command in re.findall(r"^\.venv/bin/repro (run .+)$", "\n".join(texts), re.MULTILINE):
        _, bound, _ = app.parse_args(shlex.split(command), exit_on_error=False, print_error=False)
        assert bound.arguments["notebook"] == Path(f"notebooks/{path.name}")
        assert convert_all(bound.arguments["parameters"], declared, path.name)


def test_a_run_beyond_the_range_is_refused():
    command = [
        sys.executable,
        "-m",
        "edition1_companion.cli",
        "run",
        "notebooks/live.ipynb",
        "-p",
        "seed",
        "-4",
    ]
    done = subprocess.run(command, cwd=PROJECT, capture_output=True, text=True, check=False)
    assert done.returncode == 2
    said = "Input parameter seed of live.ipynb must be at least 0; instead received -4."
    assert done.stderr.startswith(f"repro: {said}\n")
