"""The notebooks of the first edition in a build: what runs again and what does not, failures, warnings."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from edition1_companion.book.after.build import run


@pytest.fixture
def book(root: Path, notebook_at, writes_a_table) -> Path:
    """Return a project with two notebooks."""
    for name in ("a", "b"):
        notebook_at(root / "notebooks" / f"{name}.ipynb", writes_a_table(f"table_{name}"))
    return root


def build(root: Path) -> tuple[int, list[str]]:
    return run(root, ["a", "b"], 2)


def test_what_makes_notebooks_run_again(book, tmp_path):
    assert build(book) == (2, [])
    assert build(book) == (0, [])
    results = {path: path.read_bytes() for path in (book / "results").glob("*.csv")}
    (book / "src/edition1/edition1/module.py").write_text('"""Another module."""\n')
    assert build(book) == (2, [])
    (tmp_path / "recordings" / "new.csv").write_text("1\n")
    assert build(book) == (2, [])
    # in a folder of their own: the tables without recordings are committed
    with_recordings = book / "results" / "with_recordings"
    assert {path: path.read_bytes() for path in (book / "results").glob("*.csv")} == results
    assert {path.name for path in with_recordings.iterdir()} == {path.name for path in results}
    (tmp_path / "recordings" / "new.csv").unlink()
    assert build(book) == (2, [])
    notebook = book / "notebooks" / "a.ipynb"
    notebook.write_text(notebook.read_text().replace("n: int = 3", "n: int = 6"))
    assert build(book) == (1, [])
    assert (book / "results/table_a.csv").read_text() == "n,third\n6,2\n"
    (book / "results/table_b.csv").write_text("edited by hand\n")
    assert build(book) == (1, [])


def test_listed_tables_are_thinned_in_the_results_of_the_book_only(book, notebook_at):
    """Rows stay as they were written, and runs of one's own have them all."""
    text = "n,x\n" + "".join(f"{n},0.10\n" for n in (3, 1, 1, 2, 5))
    cell = f"from edition1_companion.book.results import results_dir\n(results_dir() / 'thinned.csv').write_text({text!r})"
    notebook_at(book / "notebooks" / "a.ipynb", cell)
    build(book)
    assert (book / "results/thinned.csv").read_text() == "n,x\n3,0.10\n1,0.10\n1,0.10\n"
    command = [sys.executable, "-m", "edition1_companion.cli", "run", "notebooks/a.ipynb"]
    subprocess.run([*command, "-o", "runs/a.ipynb"], check=True, stdout=subprocess.DEVNULL)
    assert (book / "runs/thinned.csv").read_text() == text


def test_a_failing_notebook_does_not_stop_the_others(book, notebook_at):
    notebook_at(book / "notebooks" / "a.ipynb", "undefined_name")
    assert build(book) == (
        2,
        [
            "notebooks/a.ipynb failed in code cell 2: undefined_name\n"
            "  NameError: name 'undefined_name' is not defined\n"
            "  The partial notebook is runs/a.failed.ipynb"
        ],
    )
    assert (book / "runs/a.failed.ipynb").is_file()
    count, failures = build(book)
    assert (count, len(failures)) == (1, 1)


def test_a_page_with_a_warning_is_refused_until_it_has_none(book, notebook_at, writes_a_table):
    warns = "import warnings\nwarnings.warn('old', DeprecationWarning)"
    notebook_at(book / "notebooks" / "a.ipynb", writes_a_table("table_a"), warns)
    for ran in (2, 1):
        count, (said,) = build(book)
        assert count == ran
        assert said.startswith("a.ipynb shows a warning: ")
        assert "DeprecationWarning: old" in said
