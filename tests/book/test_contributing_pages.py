"""The pages for contributors: what they show is written where they say, and does what they say.

The pages are the only place of their examples. Each test follows all of them in a copy of the project.
"""

from __future__ import annotations

import os
import re
import shlex
import shutil
import subprocess
import sys
from pathlib import Path

import nbformat
import pytest

PROJECT = Path(__file__).resolve().parents[2]
PAGES = [
    (PROJECT / "book" / "contributing" / f"{name}.md").read_text(encoding="utf-8")
    for name in ("sensor_model", "estimator", "paper")
]
COPIED = (
    "pyproject.toml",
    "requirements.lock",
    "src",
    "tests",
    "notebooks",
    "book",
    "data/published",
)
LEFT_OUT = shutil.ignore_patterns("__pycache__", "_build", "_static", "generated", "vendor", "*.egg-info")
PART = re.compile(r"^`([^`\n]+)`([^\n]*):\n\n```(\w+)\n(.*?)^```$", re.MULTILINE | re.DOTALL)
"""A path, which part of the file it is, language, and text."""
BREAK = re.compile(r"^To see it fail, write `([^`]+)` instead of `([^`]+)` in\s`([^`]+)`\.$", re.MULTILINE)


def patched(text: str, difference: str) -> str:
    """Return a text after a difference; each of its hunks must have exactly one place."""
    for hunk in filter(None, re.split(r"^\n", difference, flags=re.MULTILINE)):
        lines = hunk.splitlines(keepends=True)
        old = "".join(line[1:] for line in lines if line[0] == " ")
        assert text.count(old) == 1, f"no single place for {hunk}"
        text = text.replace(old, "".join(line[1:] for line in lines))
    return text


def follow(page: str, folder: Path) -> None:
    """Write the files of a page, and change those that it changes."""
    notebooks: dict[str, nbformat.NotebookNode] = {}
    kernel = {"name": "python3", "language": "python", "display_name": "Python 3"}
    for name, part, language, text in PART.findall(page):
        path = folder / name
        if path.suffix == ".ipynb":
            make = nbformat.v4.new_markdown_cell if language == "markdown" else nbformat.v4.new_code_cell
            tags = {"tags": ["parameters"]} if "`parameters`" in part else {}
            notebook = notebooks.setdefault(name, nbformat.v4.new_notebook(metadata={"kernelspec": kernel}))
            notebook.cells.append(make(text.rstrip(), metadata=tags))
        elif language == "diff":
            path.write_text(patched(path.read_text(encoding="utf-8"), text), encoding="utf-8")
        else:
            assert not path.exists(), f"{name} is there by now: the page needs another example"
            path.write_text(text, encoding="utf-8")
    for name, notebook in notebooks.items():
        nbformat.write(notebook, folder / name)


def command(page: str, start: str) -> list[str]:
    """Return the arguments of the only command of a page that starts so."""
    lines = [line for block in re.findall(r"```sh\n(.*?)```", page, re.DOTALL) for line in block.splitlines()]
    (found,) = [line for line in lines if line.startswith(start)]
    return shlex.split(found.removeprefix(start))


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Return a copy of the project in which all pages were followed."""
    for name in COPIED:
        source, target = PROJECT / name, tmp_path / name
        target.parent.mkdir(parents=True, exist_ok=True)
        if source.is_dir():
            shutil.copytree(source, target, ignore=LEFT_OUT)
        else:
            shutil.copyfile(source, target)
    for page in PAGES:
        follow(page, tmp_path)
    return tmp_path


def run(folder: Path, module: str, *arguments: str) -> subprocess.CompletedProcess[str]:
    """Run a program on a copy of the project."""
    environment = {name: value for name, value in os.environ.items() if not name.startswith("PYTEST_")}
    environment |= {
        "PYTHONPATH": f"{folder / 'src'}:{folder / 'src' / 'edition1'}",
        "REPRO_DATA_DIR": str(folder / "recordings"),
    }
    whole = [sys.executable, "-m", module, *arguments]
    return subprocess.run(whole, cwd=folder, env=environment, capture_output=True, text=True, check=False)


def run_pytest(folder: Path, *arguments: str) -> tuple[int, str, dict[str, str]]:
    """Run pytest; return its exit status, what it printed, and outcomes by test."""
    done = run(folder, "pytest", "-p", "no:cacheprovider", "-rA", *arguments)
    found = re.findall(r"^(PASSED|FAILED|ERROR) (.+?)(?: - .*)?$", done.stdout, re.MULTILINE)
    return done.returncode, done.stdout + done.stderr, {name: outcome for outcome, name in found}


def joined(pages: list[str]) -> tuple[list[str], list[str]]:
    """Return the files that the pages give to pytest, and all arguments as one run, which imports torch once only."""
    files, chosen = [], []
    for page in pages:
        arguments = command(page, ".venv/bin/pytest ")
        at = arguments.index("-k") if "-k" in arguments else len(arguments)
        files += arguments[:at]
        chosen.append(
            " ".join(arguments[at + 1 :]) or " or ".join(Path(name).stem for name in arguments[:at])
        )
    return files, [*files, "-k", " or ".join(f"({expression})" for expression in chosen)]


def test_the_commands_at_the_end_of_the_pages_pass(folder):
    files, arguments = joined(PAGES)
    status, printed, outcomes = run_pytest(folder, *arguments)
    assert status == 0, printed
    assert set(outcomes.values()) == {"PASSED"}
    for file in files:
        assert any(name.startswith(file + "::") for name in outcomes), file
    contract = [
        name for name in outcomes if name.startswith("tests/edition1/library/estimation/test_contract.py")
    ]
    assert len(contract) >= 17, "the whole suite, of which each test ran with the new estimator"
    assert all("[alpha-beta" in name for name in contract)
    assert (
        "tests/edition1/companion/book/test_paper_index.py::test_places_exist[baaij2023-Section 3.2]"
        in outcomes
    )


def test_a_broken_example_fails(folder):
    tests = []
    for page in PAGES:
        ((new, old, name),) = BREAK.findall(page)
        text = (folder / name).read_text(encoding="utf-8")
        assert text.count(old) == 1, f"{name}: no single place for {old}"
        (folder / name).write_text(text.replace(old, new), encoding="utf-8")
        tests += [path for path, *_ in PART.findall(page) if Path(path).name.startswith("test_")]
    tests.remove("tests/edition1/library/estimation/test_contract.py")  # which a lag does not concern
    status, printed, outcomes = run_pytest(folder, *tests)
    assert status == 1, printed
    for file in tests:
        assert "FAILED" in {outcome for name, outcome in outcomes.items() if name.startswith(file + "::")}, (
            file
        )


def test_the_number_of_the_paper_gets_its_verdict(folder):
    arguments = command(PAGES[2], ".venv/bin/repro run ")
    done = run(folder, "edition1_companion.cli", "run", *arguments, "-o", "runs/range.ipynb")
    assert done.returncode == 0, done.stderr
    (folder / "results").mkdir()
    shutil.copy(folder / "runs" / "training_range.rows.csv", folder / "results")  # as `make book` does
    done = run(
        folder, "edition1_companion.cli", "scorecard", *command(PAGES[2], ".venv/bin/repro scorecard ")
    )
    assert done.returncode == 0, done.stderr
    reference = (folder / "data" / "scorecard_reference.csv").read_text(encoding="utf-8")
    assert "\nbaaij2023,Section 3.2,training set,tip_angle,deg,reproduced\n" in reference


def test_examples_are_in_the_style_of_the_project(folder):
    files = sorted(
        {name for page in PAGES for name, *_ in PART.findall(page) if name.endswith((".py", ".ipynb"))}
    )
    assert len(files) == 8
    for arguments in (["check", "--no-cache"], ["format", "--check", "--no-cache"]):
        done = run(folder, "ruff", *arguments, *files)
        assert done.returncode == 0, done.stdout
