"""Results again from a clean copy: the same tables are the same, and every difference is found and named."""

import os
import shutil
import subprocess
import sys

import pytest
from edition1.errors import InputError
from edition1_companion.book.after.rebuild import against, copy_sources, differences, rebuild
from edition1_companion.book.project import Project

WRITES = 'from edition1_companion.book.results import results_dir\n(results_dir() / "{}").write_text({})'


@pytest.fixture
def checkout(root):
    """A miniature project, a git checkout that imports the package under test."""
    subprocess.run(["git", "init", "-q"], check=True)
    (root / ".gitignore").write_text("results/\nbook/notebooks/\n.cache/\nruns/\n")
    return root


def execute(root):
    """Run the notebooks of a project, as the build does, without its site."""
    program = "from edition1_companion.book import project as p; from edition1_companion.book.after import build as b\n"
    program += "from edition1_companion.book.provenance import read_inputs\npr = p.find_project()\n"
    program += "b.run_pages(b.page_points(pr, read_inputs(pr)), 2)"
    subprocess.run([sys.executable, "-c", program], cwd=root, check=True, stdout=subprocess.DEVNULL)


def test_tables_that_follow_from_the_sources_are_the_same_and_others_are_named(
    checkout, notebook_at, monkeypatch
):
    notebook_at(checkout / "notebooks/same.ipynb", WRITES.format("same.csv", "f'n\\n{n / 3:g}\\n'"))
    notebook_at(
        checkout / "notebooks/other.ipynb",
        "import os",
        WRITES.format("other.csv", "f'process\\n{os.getpid()}\\n'"),
    )
    execute(checkout)
    monkeypatch.setenv("PYTHONPATH", "elsewhere")
    (found,) = rebuild(Project(checkout), 2)
    first, second = (
        (folder / "other.csv").read_text().split()
        for folder in (checkout / "results", checkout / ".cache/again/results")
    )
    assert found == f"other.csv differs from line 2 on: {first[1]} | {second[1]}"
    assert os.environ["PYTHONPATH"] == "elsewhere"


def test_a_book_that_is_not_built_cannot_be_compared(checkout, notebook_at):
    notebook_at(checkout / "notebooks/same.ipynb", WRITES.format("same.csv", "'n\\n'"))
    expected = r"Input results of make reproduce must be up to date \(run make book first\); .* same to run."
    with pytest.raises(InputError, match=f"^{expected}$"):
        rebuild(Project(checkout), 2)


def test_tables_of_another_build_are_compared_without_a_run(checkout, notebook_at, tmp_path):
    notebook_at(checkout / "notebooks/same.ipynb", WRITES.format("same.csv", "'n\\n1\\n'"))
    execute(checkout)
    other, empty = tmp_path / "other", tmp_path / "empty"
    empty.mkdir()
    shutil.copytree(checkout / "results", other)
    assert against(other, Project(checkout)) == []
    (other / "same.csv").write_text("n\n2\n")
    assert against(other, Project(checkout)) == ["same.csv differs from line 2 on: 1 | 2"]
    with pytest.raises(
        InputError, match="AGAINST of make reproduce must be a folder with tables of another build"
    ):
        against(empty, Project(checkout))
    append = (checkout / "notebooks/same.ipynb").open("a")
    with append:
        append.write("\n")
    with pytest.raises(InputError, match="up to date"):
        against(other, Project(checkout))


def test_a_copy_has_no_results_and_nothing_of_an_earlier_copy(checkout, tmp_path):
    (checkout / "results").mkdir()
    (checkout / "results/old.csv").write_text("n\n")
    (checkout / "new.py").write_text("")
    copy = tmp_path / "copy"
    copy.mkdir()
    (copy / "rest").write_text("")
    copy_sources(checkout, copy)
    names = {str(path.relative_to(copy)) for path in copy.rglob("*") if path.is_file()}
    assert {"new.py", "pyproject.toml", "src/edition1/edition1/module.py"} <= names
    assert not names & {"rest", "results/old.csv"}


def test_without_git_there_is_no_telling_what_are_sources(root, tmp_path):
    expected = (
        "Input project of make reproduce must be a git checkout: git knows what are sources; .*project."
    )
    with pytest.raises(InputError, match=f"^{expected}$"):
        copy_sources(root, tmp_path / "copy")


def test_differences_are_missing_tables_longer_ones_and_single_bytes(tmp_path):
    one, two = tmp_path / "one", tmp_path / "two"
    tables = {
        one: {"same": "a\n1\n", "gone": "a\n", "longer": "a\n1\n", "end": "a\r\n", "scorecard": "a\n"},
        two: {"same": "a\n1\n", "new": "a\n", "longer": "a\n1\n2\n", "end": "a\n", "scorecard": "b\n"},
    }
    for folder, texts in tables.items():
        folder.mkdir()
        for name, text in texts.items():
            (folder / f"{name}.csv").write_bytes(text.encode())
    assert differences(one, two) == [
        "end.csv differs from line 1 on: a\r | a",
        f"gone.csv is missing in {two}",
        "longer.csv differs from line 3 on:  | 2",
        f"new.csv is missing in {one}",
    ]
