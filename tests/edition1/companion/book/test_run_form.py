"""The form on a notebook's page: what it prints is executed, in a shell and by the programs that it names."""

from __future__ import annotations

import ast
import shlex
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from urllib.parse import unquote

import nbformat
import pytest
import yaml
from click.testing import CliRunner
from edition1.errors import InputError
from edition1_companion.book.parameters import Parameter, convert_all, declared_parameters
from edition1_companion.book.run_form import default_value, form_html, parameters_yaml
from edition1_companion.book.runner import read_notebook
from edition1_companion.cli import app
from papermill.cli import papermill as papermill_command
from rule_cases import CASES, OF_CHOICES

PROJECT = Path(__file__).resolve().parents[4]
SCRIPT = PROJECT / "book" / "_static" / "run_form.js"
CELLS = """\
steps: int = 10  # steps
noise_mt: float = 1e-5  # noise [mT]
name: str = "it's a \\"name\\" & <b>"  # a text
fast: bool = False  # short
rows: list = [1e-5, 2, "a, b", True, None]  # rows
layout: dict = {}  # columns
"""
DEFAULTS = {
    "steps": 10,
    "noise_mt": 1e-5,
    "name": 'it\'s a "name" & <b>',
    "fast": False,
    "rows": [1e-5, 2, "a, b", True, None],
    "layout": {},
}


def declared(source: str = CELLS) -> dict[str, Parameter]:
    notebook = nbformat.v4.new_notebook()
    notebook.cells = [nbformat.v4.new_code_cell(source, metadata={"tags": ["parameters"]})]
    return declared_parameters(notebook, "a.ipynb")


@pytest.fixture(scope="module")
def tab(browser) -> Iterator[Any]:
    """Return one tab for all tests."""
    tab = browser.new_page()
    yield tab
    tab.close()


@pytest.fixture
def page(tab, tmp_path, monkeypatch) -> Iterator[Any]:
    """Return the form of a notebook, open from a file; the notebook is there too, and its project current."""
    (tmp_path / "pyproject.toml").write_text("[tool.repro]\n")
    kernel = {"name": "python3", "language": "python", "display_name": "Python 3"}
    notebook = nbformat.v4.new_notebook(metadata={"kernelspec": kernel})
    notebook.cells = [nbformat.v4.new_code_cell(CELLS, metadata={"tags": ["parameters"]})]
    (tmp_path / "notebooks").mkdir()
    nbformat.write(notebook, tmp_path / "notebooks" / "a.ipynb")
    monkeypatch.chdir(tmp_path)
    html = f'<!doctype html><meta charset="utf-8">{form_html("notebooks/a.ipynb", declared())}'
    place = tmp_path / "page.html"
    place.write_text(f"{html}<script>{SCRIPT.read_text()}</script>", encoding="utf-8")
    problems: list[str] = []
    events = {
        "pageerror": lambda error: problems.append(str(error)),
        "request": lambda request: problems.append(request.url) if request.url != place.as_uri() else None,
    }
    for event, note in events.items():
        tab.on(event, note)
    tab.goto(place.as_uri())
    yield tab
    for event, note in events.items():
        tab.remove_listener(event, note)
    assert problems == []


def fill(page, **values: str | bool) -> None:
    for name, value in values.items():
        field = page.locator(f"[data-name={name}]")
        field.set_checked(value) if isinstance(value, bool) else field.fill(value)


def reset(page) -> None:
    page.get_by_role("button").press("Enter")
    page.get_by_role("status").filter(has_text="No value changed").wait_for()


def command(page, key: str) -> str:
    return page.locator(f"[data-command={key}]").text_content()


def words(line: str) -> list[str]:
    """Return the words of a command as a POSIX shell divides it; shlex must agree."""
    said = subprocess.run(["sh", "-c", f"printf '%s\\0' {line}"], capture_output=True, check=True).stdout
    divided = said.decode().split("\0")[:-1]
    assert divided == shlex.split(line)
    return divided


def values_of_repro(line: str) -> dict[str, Any]:
    """Return the values that ``repro run`` would run with."""
    _, bound, _ = app.parse_args(words(line)[1:], exit_on_error=False, print_error=False)
    assert bound.args == (Path("notebooks/a.ipynb"),)
    return convert_all(bound.kwargs.get("parameters") or [], declared(), "a.ipynb")


def values_of_papermill(line: str) -> dict[str, Any]:
    """Return the values that papermill itself puts into the notebook."""
    done = CliRunner().invoke(papermill_command, [*words(line)[1:], "--prepare-only"])
    assert done.exit_code == 0, done.output
    cells = [c for c in read_notebook(Path("my_run.ipynb")).cells if "injected-parameters" in c.metadata.tags]
    assigned = ast.parse(cells[0].source if cells else "").body
    values: dict[str, Any] = {}
    for node in assigned:
        assert isinstance(node, ast.Assign)
        exec(compile(ast.Module([node], []), "cell", "exec"), values)
    values.pop("__builtins__", None)
    return values


def same(one: dict[str, Any], other: dict[str, Any]) -> bool:
    """Whether values are equal, types included."""
    return repr(sorted(one.items())) == repr(sorted(other.items()))


TEXTS = [
    "",
    " ",
    "it's",
    'a "b" $HOME `ls` \\n !x',
    "-o",
    "--helpful",
    "-p",
    "---",
    "1",
    "True",
    "[1, 2]",
    "{a: 1}",
    "größe 10 µm 🤖",
    "a=b; rm x & | > < * ? ~ # %",
    "\\",
    "''",
    "null",
]


@pytest.mark.parametrize("typed", TEXTS)
def test_a_text_arrives_as_typed(page, typed):
    fill(page, name=typed)
    expected = {"name": typed}
    assert same(values_of_repro(command(page, "repro")), expected)
    assert same(values_of_papermill(command(page, "papermill")), expected)
    assert same(yaml.safe_load(command(page, "yaml")), DEFAULTS | expected)


TYPED = [
    ("steps", "-3", -3),
    ("steps", "007", 7),
    ("noise_mt", "-2e-4", -2e-4),
    ("noise_mt", "3", 3.0),
    ("noise_mt", "1E3", 1e3),
    ("noise_mt", ".5", 0.5),
    ("rows", "[]", []),
    ("rows", "[ 1,2 , -3, +4,]", [1, 2, -3, 4]),
    ("rows", "[1e-5, -.5, 5., 1E+3, .inf, 0.1e5]", [1e-5, -0.5, 5.0, 1e3, float("inf"), 1e4]),
    ("rows", "[n_s=6, 'it''s', \"a\\tb\", on, ~, True, -x, a b, a:b, '']", None),
    ("rows", "[[1, [2]], {a: [x, 'y z'], \"b c\": {}}]", [[1, [2]], {"a": ["x", "y z"], "b c": {}}]),
    ("rows", '["$(ls)", "`x`", "\'", "\\"", "\\\\"]', ["$(ls)", "`x`", "'", '"', "\\"]),
    ("layout", "{time: 0, pose: [1, 2]}", {"time": 0, "pose": [1, 2]}),
    ("layout", '{"on": on, "1": 2.5, "größe": null}', {"on": "on", "1": 2.5, "größe": None}),
]


@pytest.mark.parametrize(("name", "typed", "value"), TYPED, ids=[case[1] for case in TYPED])
def test_a_value_arrives_as_repro_run_reads_it(page, name, typed, value):
    # what a reader typed, read by the converter of repro run itself
    expected = convert_all([(name, typed)], declared(), "a.ipynb")
    assert value is None or same({name: value}, expected)
    fill(page, **{name: typed})
    assert same(values_of_repro(command(page, "repro")), expected)
    assert same(values_of_papermill(command(page, "papermill")), expected)
    assert same(yaml.safe_load(command(page, "yaml")), DEFAULTS | expected)


REFUSED = [
    ("steps", "1.5"),
    ("steps", "1e3"),
    ("steps", ""),
    ("noise_mt", ""),
    ("rows", "1, 2"),
    ("rows", ""),
    ("rows", "[1"),
    ("rows", "[1]]"),
    ("rows", "[,1]"),
    ("rows", "{}"),
    ("rows", '["a]'),
    ("rows", "[" * 25 + "]" * 25),
    ("layout", "[]"),
    ("layout", "{1: 2}"),
]


@pytest.mark.parametrize(("name", "typed"), REFUSED)
def test_what_repro_run_refuses_gets_no_command(page, name, typed):
    with pytest.raises(InputError):
        convert_all([(name, typed)], declared(), "a.ipynb")
    fill(page, **{name: typed})
    assert not page.locator(".run-form-commands").is_visible()
    assert page.locator(".run-form-refused").is_visible()
    assert page.locator(f"[data-name={name}]").get_attribute("aria-invalid") == "true"
    assert page.locator(f"#run-form-{name}-error").inner_text().startswith("Must be a ")
    page.get_by_role("button").press("Enter")
    page.locator(".run-form-commands").wait_for(state="visible")
    assert page.locator("[aria-invalid]").count() == 0
    assert command(page, "repro") == ".venv/bin/repro run notebooks/a.ipynb"


@pytest.mark.parametrize("typed", ["[&a 1]", "[!!int 1]", "[*a]", "[1 # 2]", '["\\x41"]'])
def test_yaml_beyond_plain_values_gets_no_command(page, typed):
    fill(page, rows=typed)
    assert page.locator("#run-form-rows-error").inner_text() == "Must be a list in YAML, such as [1, 2]"
    assert not page.locator(".run-form-commands").is_visible()


@pytest.mark.parametrize("typed", ["-h", "--help", "--"])
def test_a_text_that_cannot_be_passed_is_refused(page, typed):
    fill(page, name=typed)
    said = page.locator("#run-form-name-error").inner_text()
    assert said == f"Must be another text than {typed}, which repro does not read as a value"
    assert not page.locator(".run-form-commands").is_visible()


@pytest.fixture(scope="module")
def ruled(browser, tmp_path_factory) -> Iterator[Any]:
    """Return the form of parameters with rules, x0, x1 and so on, open from a file."""
    parameters = {
        f"x{k}": Parameter(f"x{k}", case.kind, case.default, case.meaning)
        for k, case in enumerate(CASES + OF_CHOICES)
    }
    place = tmp_path_factory.mktemp("form") / "page.html"
    html = f'<!doctype html><meta charset="utf-8">{form_html("notebooks/a.ipynb", parameters)}'
    place.write_text(f"{html}<script>{SCRIPT.read_text()}</script>", encoding="utf-8")
    tab = browser.new_page()
    tab.goto(place.as_uri())
    yield tab
    tab.close()


@pytest.mark.parametrize("number", range(len(CASES)), ids=lambda k: CASES[k].meaning)
def test_the_form_allows_what_repro_run_allows(ruled, number):
    """One rule, two programs: what is refused names the rule, and nothing is said to be unchanged then."""
    case, name = CASES[number], f"x{number}"
    field, status = ruled.locator(f"[data-name={name}]"), ruled.get_by_role("status")
    error = ruled.locator(f"#run-form-{name}-error")
    if field.evaluate("field => field.tagName") == "SELECT":
        rule = Parameter(name, case.kind, case.default, case.meaning).rule
        offered = {str(choice) for choice in rule.choices} if rule else set()
        assert set(field.locator("option").all_inner_texts()) == offered
        return
    as_number = field.get_attribute("type") == "number"  # where letters cannot be typed
    for text in case.allowed:
        field.fill(text)
        assert error.inner_text() == ""
        assert f"-p {name}" in command(ruled, "repro") or "No value changed" in status.inner_text()
    for text in case.refused:
        if not (as_number and text.lstrip("-").isalpha()):
            field.fill(text)
            assert error.inner_text() == f"Must be {case.must_be}", text
            assert status.inner_text() == "1 value is not allowed"
    reset(ruled)


def test_a_range_is_told_to_the_browser(ruled):
    field = ruled.locator("[data-name=x0]")
    assert (field.get_attribute("min"), field.get_attribute("max")) == ("1", "6")
    assert ruled.locator("[data-name=x3]").get_attribute("max") is None


def test_choices_of_a_list_by_keyboard(ruled):
    """Boxes to tick, named after the parameter; what is ticked arrives as a list in the order of the choices."""
    models, seeds = (f"x{len(CASES) + k}" for k in range(2))
    group = ruled.get_by_role("group", name=models)
    group.get_by_label("fast network").press("Space")
    assert command(ruled, "repro").endswith(f"""-p {models} '["fast network", "multipole"]'""")
    for label in ("fast network", "multipole"):
        group.get_by_label(label).press("Space")
    assert ruled.locator(f"#run-form-{models}-error").inner_text() == f"Must be {OF_CHOICES[0].must_be}"
    group.get_by_label("multipole").press("Space")
    assert command(ruled, "repro") == ".venv/bin/repro run notebooks/a.ipynb"
    for label in ("0", "1"):
        ruled.get_by_role("group", name=seeds).get_by_label(label).press("Space")
    assert command(ruled, "repro").endswith(f"-p {seeds} '[]'")
    reset(ruled)


def test_a_long_list_is_seen_whole(ruled):
    """A box of text grows with its lines, and takes no new line itself."""
    field = ruled.locator(f"[data-name=x{len(CASES) - 2}]")
    assert field.evaluate("field => field.tagName") == "TEXTAREA"
    field.fill(f"[{', '.join(['0.125'] * 40)}]")
    assert field.evaluate("field => field.scrollHeight <= field.clientHeight && field.clientHeight > 40")
    field.fill("[1,\n2]")
    assert command(ruled, "repro").endswith("'[1, 2]'")
    reset(ruled)


def test_several_values_by_keyboard_alone(page):
    """Tab reaches every field in order; the space bar ticks a box; the download is what is shown."""
    page.locator("[data-name=steps]").focus()
    page.keyboard.press("Control+a")
    page.keyboard.type("-4")
    page.keyboard.press("Tab")  # which selects the text of the next field
    page.keyboard.type("2e-3")
    for key in ("Tab", "Tab", "Space"):
        page.keyboard.press(key)
    expected = {"steps": -4, "noise_mt": 2e-3, "fast": True}
    assert command(page, "repro").endswith("-p steps -4 -p noise_mt 2e-3 -p fast true")
    assert same(values_of_repro(command(page, "repro")), expected)
    assert command(page, "papermill").endswith("-p steps -4 -p noise_mt 2.0e-3 -y 'fast: true'")
    assert same(values_of_papermill(command(page, "papermill")), expected)
    assert page.get_by_role("status").inner_text() == "3 values changed"
    link = page.locator(".run-form-yaml").get_attribute("href")
    assert unquote(link.partition(",")[2]) == command(page, "yaml")
    assert page.get_by_label("noise_mt").count() == 1


def test_the_printed_line_runs(page, tmp_path):
    """The whole line, in a shell, with nothing changed but the place of the program."""
    fill(page, name="it's", rows="[1e-3]", steps="-2", fast=True)
    (tmp_path / ".venv" / "bin").mkdir(parents=True)
    program = tmp_path / ".venv" / "bin" / "repro"
    program.write_text(f'#!/bin/sh\nexec {shlex.quote(sys.executable)} -m edition1_companion.cli "$@"\n')
    program.chmod(0o755)
    done = subprocess.run(["sh", "-c", command(page, "repro")], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    source = read_notebook(Path(done.stdout.splitlines()[0].rpartition("  (")[0])).cells[1].source
    for line in ('name = "it\'s"', "rows = [0.001]", "steps = -2", "fast = True"):
        assert line in source


def test_without_javascript_the_own_commands_are_there(browser, tmp_path):
    html = form_html("notebooks/a.ipynb", declared())
    (tmp_path / "page.html").write_text(f'<meta charset="utf-8">{html}', encoding="utf-8")
    context = browser.new_context(java_script_enabled=False)
    page = context.new_page()
    page.goto((tmp_path / "page.html").as_uri())
    assert page.locator("form").is_hidden()
    assert command(page, "repro") == ".venv/bin/repro run notebooks/a.ipynb"
    assert same(yaml.safe_load(command(page, "yaml")), DEFAULTS)
    context.close()


def test_the_script_changes_nothing_before_the_reader_does(page):
    static = form_html("notebooks/a.ipynb", declared())
    assert command(page, "repro") in static
    assert command(page, "papermill") in static
    assert same(yaml.safe_load(command(page, "yaml")), yaml.safe_load(parameters_yaml(DEFAULTS)))


@pytest.mark.parametrize("path", sorted((PROJECT / "notebooks").glob("*.ipynb")), ids=lambda path: path.stem)
def test_every_notebook_of_the_book_has_a_form(path):
    """No blank line, which would end the HTML for MyST; the YAML is what the cell holds."""
    found = declared_parameters(read_notebook(path), path.name)
    assert "\n\n" not in form_html(f"notebooks/{path.name}", found)
    values = {name: default_value(parameter, path.name) for name, parameter in found.items()}
    cell = next(c for c in read_notebook(path).cells if "parameters" in c.metadata.get("tags", []))
    names: dict[str, Any] = {}
    exec(cell.source, names)
    assert same(values, {name: names[name] for name in found})
    assert same(yaml.safe_load(parameters_yaml(values)), values)


def test_a_default_that_is_computed_is_refused():
    message = (
        "Input parameter n of a.ipynb must be given as a whole number, such as 3; instead received 2 * 3."
    )
    with pytest.raises(InputError) as error:
        default_value(Parameter("n", "int", "2 * 3", ""), "a.ipynb")
    assert str(error.value) == message
