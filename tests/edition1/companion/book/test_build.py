"""The build of a miniature book: what runs again and what does not, failures, leftovers."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

CONFIG = """\
title: Small
execute: {execute_notebooks: "off"}
only_build_toc_files: true
exclude_patterns: [generated]
"""


def executed(output: str) -> set[str]:
    """Return the notebooks that a build finished."""
    return {line.partition(":")[0] for line in output.splitlines() if ": done in " in line}


@pytest.fixture
def book(root: Path, notebook_at, writes_a_table) -> Path:
    """Return a project with two notebooks and a site of three pages."""
    for name in ("a", "b"):
        path = notebook_at(root / "notebooks" / f"{name}.ipynb", writes_a_table(f"table_{name}"))
        # a page needs a title
        path.write_text(path.read_text().replace('"cells": [', '"cells": [' + TITLE, 1))
    (root / "book").mkdir()
    (root / "book/_config.yml").write_text(CONFIG)
    (root / "book/_toc.yml").write_text(
        "format: jb-book\nroot: index\nchapters:\n- file: notebooks/a\n- file: notebooks/b\n"
    )
    (root / "book/index.md").write_text("# Small\n\n```{include} generated/counts.md\n```\n")
    return root


TITLE = '{"cell_type": "markdown", "id": "title", "metadata": {}, "source": ["# Title"]},'
UP_TO_DATE = "2 of 2 notebooks were up to date; the site was too.\n"


def test_a_book_from_nothing_and_what_makes_it_run_again(book, build, tmp_path):
    first = build()
    assert first.returncode == 0, first.stdout + first.stderr
    assert executed(first.stdout) == {"a", "b"}
    assert "a: started\n" in first.stdout
    assert "0 of 2 notebooks were up to date; the site was built in " in first.stdout
    site = book / "book/_build/html"
    assert (
        "<strong>Of the 0 left, 0 are reproduced, 0 better, and 0 differ.</strong>"
        in (site / "index.html").read_text()
    )
    assert (site / "notebooks/a.html").is_file()
    assert sorted(os.listdir(book / "results")) == [
        "scorecard.csv",
        "table_a.csv",
        "table_b.csv",
    ]

    assert build().stdout == UP_TO_DATE

    # a page that breaks: the site stays, and the next build does not take it for finished
    (book / "book/index.md").write_text("# Small\n\n[nowhere](nowhere.md)\n")
    for _ in range(2):
        broken = build()
        assert broken.returncode == 1
        assert executed(broken.stdout) == set()
        assert "nowhere" in broken.stderr
        assert "jupyter-book ended with 1; the site was not replaced." in broken.stderr
    assert (
        "<strong>Of the 0 left, 0 are reproduced, 0 better, and 0 differ.</strong>"
        in (site / "index.html").read_text()
    )


@pytest.fixture
def without_site(book: Path) -> Path:
    """Return a project whose build ends after its notebooks, for want of published numbers."""
    (book / "data/published/published.csv").unlink()
    return book


def test_what_makes_notebooks_run_again(without_site, build, tmp_path):
    root = without_site
    assert executed(build().stdout) == {"a", "b"}
    assert executed(build().stdout) == set()
    results = {path: path.read_bytes() for path in (root / "results").glob("*.csv")}

    (root / "src/edition1/edition1/module.py").write_text('"""Another module."""\n')
    assert executed(build().stdout) == {"a", "b"}
    (tmp_path / "recordings" / "new.csv").write_text("1\n")
    assert executed(build().stdout) == {"a", "b"}
    # in a folder of their own: the tables without recordings are committed
    with_recordings = root / "results" / "with_recordings"
    assert {path: path.read_bytes() for path in (root / "results").glob("*.csv")} == results
    assert {path.name for path in with_recordings.iterdir()} == {path.name for path in results}
    (tmp_path / "recordings" / "new.csv").unlink()
    assert executed(build().stdout) == {"a", "b"}

    notebook = root / "notebooks" / "a.ipynb"
    notebook.write_text(notebook.read_text().replace("n: int = 3", "n: int = 6"))
    assert executed(build().stdout) == {"a"}
    assert (root / "results/table_a.csv").read_text() == "n,third\n6,2\n"

    (root / "results/table_b.csv").write_text("edited by hand\n")
    (root / "book/notebooks/a.ipynb").unlink()
    assert executed(build().stdout) == {"a", "b"}
    assert (root / "results/table_b.csv").read_text() == "n,third\n3,1\n"

    notebook.unlink()
    assert executed(build().stdout) == set()
    assert {path.name for path in (root / "results").glob("*.csv")} == {"table_b.csv"}
    assert sorted(os.listdir(root / "book/notebooks")) == ["b.ipynb", "b.provenance.json"]


def test_only_tables_that_a_notebook_wrote_stay(without_site, build):
    """A committed table does not outlive its notebook."""
    results = without_site / "results"
    results.mkdir()
    (results / "of_no_notebook.csv").write_text("n\n1\n")
    build()
    assert sorted(os.listdir(results)) == ["table_a.csv", "table_b.csv"]


def test_listed_tables_are_thinned_in_the_results_of_the_book_only(without_site, build, notebook_at):
    """Rows stay as they were written, and runs of one's own have them all."""
    root = without_site
    text = "n,x\n" + "".join(f"{n},0.10\n" for n in (3, 1, 1, 2, 5))
    cell = f"from edition1_companion.book.results import results_dir\n(results_dir() / 'thinned.csv').write_text({text!r})"
    notebook_at(root / "notebooks" / "a.ipynb", cell)
    build()
    assert (root / "results/thinned.csv").read_text() == "n,x\n3,0.10\n1,0.10\n1,0.10\n"
    command = [
        sys.executable,
        "-m",
        "edition1_companion.cli",
        "run",
        "notebooks/a.ipynb",
        "-o",
        "runs/a.ipynb",
    ]
    subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
    assert (root / "runs/thinned.csv").read_text() == text


def test_a_failing_notebook_does_not_stop_the_others(without_site, build, notebook_at):
    root = without_site
    notebook_at(root / "notebooks" / "a.ipynb", "undefined_name")
    done = build()
    assert done.returncode == 1
    assert executed(done.stdout) == {"b"}
    assert "a: failed after " in done.stdout
    assert done.stderr == (
        "notebooks/a.ipynb failed in code cell 2: undefined_name\n"
        "  NameError: name 'undefined_name' is not defined\n"
        "  The partial notebook is runs/a.failed.ipynb\n"
    )
    assert (root / "runs/a.failed.ipynb").is_file()
    assert not (root / "results/scorecard.csv").exists()
    again = build()
    assert (again.returncode, executed(again.stdout)) == (1, set())


def test_a_page_with_a_warning_is_refused_until_it_has_none(without_site, build, notebook_at, writes_a_table):
    warns = "import warnings\nwarnings.warn('old', DeprecationWarning)"
    notebook_at(without_site / "notebooks" / "a.ipynb", writes_a_table("table_a"), warns)
    for run in ({"a", "b"}, {"a"}):
        done = build()
        assert (done.returncode, executed(done.stdout)) == (1, run)
        assert done.stderr.startswith("a.ipynb shows a warning: ")
        assert "DeprecationWarning: old" in done.stderr


def test_a_table_of_two_notebooks_is_refused(without_site, build, notebook_at, writes_a_table):
    notebook_at(without_site / "notebooks" / "a.ipynb", writes_a_table("table_b"))
    done = build()
    assert done.returncode == 1
    assert done.stderr == "The table table_b.csv is written by more than one notebook: a, b.\n"
    # without records, both run again
    assert os.listdir(without_site / "results") == ["table_b.csv"]


def test_an_interrupted_build_is_not_taken_for_finished(without_site, notebook_at, build):
    root = without_site
    slow = "from pathlib import Path\nPath('begun').touch()\nimport time\ntime.sleep(60)"
    notebook_at(root / "notebooks" / "a.ipynb", slow)
    command = [sys.executable, "-m", "edition1_companion.book.after.build"]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
    deadline = time.monotonic() + 30
    while not (root / "begun").exists() and time.monotonic() < deadline:
        time.sleep(0.05)
    process.send_signal(signal.SIGTERM)
    process.communicate(timeout=20)
    assert process.returncode == 143
    assert not (root / "book/notebooks/a.provenance.json").exists()
    assert not (root / "book/notebooks/a.ipynb").exists()


def test_a_wrong_number_of_jobs(without_site, build, monkeypatch):
    monkeypatch.setenv("JOBS", "many")
    done = build()
    assert done.returncode == 2
    assert done.stderr == (
        "Input JOBS of the build must be a whole number of 1 or more; instead received many.\n"
    )
