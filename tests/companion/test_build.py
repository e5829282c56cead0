"""The build of a miniature book: what runs again and what does not, failures, leftovers, and what a page shows."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pandas as pd
import pytest

from repro_companion import build as tool
from repro_companion import run
from repro_companion.scorecard import AUTHORS
from repro_companion.show import KEY, ROW_COLUMNS

from .sample import in_project, notebook

CONFIG = """\
title: Small
execute: {execute_notebooks: "off"}
only_build_toc_files: true
exclude_patterns: [generated]
"""
HASH = 40 * "0"
SOURCES = f"""\
{{"a2020": {{"repository": "https://github.com/o/n", "commit": "{HASH}",
 "readers": [{{"files": "x", "page": "a", "use": "y"}}], "files": [{{"path": "x.csv", "git_blob": "{HASH}"}}]}}}}
"""
PUBLISHED = """\
paper,artefact,row,quantity,unit,value,std
a2020,Table 1,one,e_u,mT,0.015,0.002
"""


@pytest.fixture
def root(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return a project with two notebooks and a site; it is the current folder."""
    in_project(tmp_path, monkeypatch)
    monkeypatch.setenv("JOBS", "2")
    notebook(tmp_path / "notebooks/other.ipynb", "o")
    for name, text in {
        "pyproject.toml": "",
        "data/published/published.csv": PUBLISHED,
        "data/sources.json": SOURCES,
        "data/published/index.csv": "paper,kind,artefact,shows,status,page,anchor,code,note\n"
        "a2020,table,Table 1,errors,regenerated,notebooks/a,,,\n",
        "book/_config.yml": CONFIG,
        "book/_toc.yml": "format: jb-book\nroot: index\nchapters:\n- file: notebooks/a\n- file: notebooks/other\n",
        "book/index.md": "# Small\n\nA page.\n",
        "book/bibliography.md": "# Bibliography\n",
    }.items():
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(text)
    return tmp_path


def build(*names: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "repro_companion.build", *names]
    return subprocess.run(command, capture_output=True, text=True, check=False)


@pytest.mark.slow
def test_a_book_from_nothing_and_a_page_that_breaks(root):
    (root / "results").mkdir()
    (root / "results/of_no_notebook.csv").write_text("n\n1\n")
    first = build()
    assert first.returncode == 0, first.stdout + first.stderr
    assert "a: started\n" in first.stdout
    assert "a: done in " in first.stdout
    assert "0 of 2 notebooks were up to date; the site was built in " in first.stdout
    assert sorted(os.listdir(root / "results")) == ["o.csv", "scorecard.csv", "t.csv"]
    for name in ("index", "notebooks/a", "notebooks/other"):
        assert (root / f"book/_build/html/{name}.html").is_file()
    assert build().stdout == "2 of 2 notebooks were up to date; the site was too.\n"
    (root / "book/index.md").write_text("# Small\n\n[nowhere](nowhere.md)\n")
    for _ in range(2):  # the second does not take it for finished
        broken = build()
        assert broken.returncode == 1
        assert "nowhere" in broken.stderr
        assert "jupyter-book ended with 1; the site was not replaced." in broken.stderr
    assert "A page." in (root / "book/_build/html/index.html").read_text()


@pytest.mark.slow
def test_a_page_alone(root):
    head = "paper,section,page,headline,claim,found,why\n"
    (root / "data/published/claims.csv").write_text(
        f"{head}a2020,Abstract,notebooks/a,,Errors are small,Yes,luck\n"
    )
    done = build("a")
    assert done.returncode == 0, done.stderr
    place = done.stdout.splitlines()[-1].partition("  (")[0]
    assert "Sample" in Path(place).read_text()
    assert "Errors are small" in (root / "book/generated/claims_a.md").read_text()
    assert not (root / "book/_build/html").exists()
    assert build("none").returncode == 2


@pytest.fixture
def without_site(root: Path) -> Path:
    """Return a project whose build ends after its notebooks, for want of printed numbers."""
    (root / "data/published/published.csv").write_text("")
    return root


@pytest.mark.slow
def test_a_page_runs_again_when_its_inputs_change(without_site):
    root = without_site

    def ran() -> set[str]:
        def begun() -> dict[str, float]:
            folder = root / "book/notebooks"
            return {path.name: path.stat().st_mtime_ns for path in folder.glob("*.ipynb")}

        before = begun()
        build()
        return {name.partition(".")[0] for name, at in begun().items() if before.get(name) != at}

    killed = root / "book/notebooks/.a-0123"  # what a run leaves that was killed
    killed.mkdir(parents=True)
    (killed / "a.ipynb").write_text("{}")
    assert ran() == {"a", "other"}
    assert not killed.exists()
    assert ran() == set()
    (root / "src/repro/module.py").write_text("x = 2\n")
    assert ran() == {"a", "other"}
    (root / "results/t.csv").write_text("edited by hand\n")
    assert ran() == {"a"}
    assert (root / "results/t.csv").read_text() == "seed,x\n0,1.0000\n"
    (root / "recordings/p").mkdir(parents=True)
    (root / "recordings/p/new.csv").write_text("1\n")
    assert ran() == {"a", "other"}
    assert sorted(os.listdir(root / "results/with_recordings")) == ["o.csv", "t.csv"]
    (root / "notebooks/a.ipynb").unlink()
    build()
    assert sorted(os.listdir(root / "book/notebooks")) == ["other.ipynb", "other.provenance.json"]
    assert os.listdir(root / "results/with_recordings") == ["o.csv"]


@pytest.mark.slow
def test_failures_warnings_and_shared_tables_are_refused(without_site):
    root = without_site
    notebook(root / "notebooks/fails.ipynb", "f", "undefined_name")
    notebook(root / "notebooks/warns.ipynb", "w", "import warnings\nwarnings.warn('old', UserWarning)")
    done = build()
    assert done.returncode == 1
    assert "fails: failed after " in done.stdout
    assert "a: done in " in done.stdout
    assert (
        "failed in the cell `undefined_name`: NameError: name 'undefined_name' is not defined" in done.stderr
    )
    assert "The partial notebook is runs/fails.failed.ipynb" in done.stderr
    assert "warns.ipynb shows a warning: " in done.stderr
    assert not (root / "book/notebooks/warns.provenance.json").exists()
    (root / "notebooks/warns.ipynb").unlink()
    notebook(root / "notebooks/fails.ipynb", "t")
    done = build()
    assert done.stderr == "The table t.csv is written by more than one notebook: a, fails.\n"


def test_a_wrong_number_of_jobs(root, monkeypatch):
    monkeypatch.setenv("JOBS", "many")
    done = build()
    assert done.returncode == 2
    assert (
        done.stderr == "Input JOBS of the build must be a whole number of 1 or more; instead received many.\n"
    )


def test_a_second_build_is_refused_in_one_sentence(root):
    with tool.alone(root):
        done = build("a")
    assert (done.returncode, done.stdout) == (1, "")
    assert done.stderr == (
        "Another `make book` or `make page` is at work in this folder. Run this again when it has ended.\n"
    )
    with tool.alone(root):  # the lock of one that has ended is free
        pass


def test_what_a_page_shows(root):
    """The output of ``first`` comes after the title, plumbing is gone, and three folds stand at the end."""
    page = root / "notebooks/a.ipynb"
    output = root / "book/notebooks/a.ipynb"
    run.run(page, {}, output, root / "results", root=root)
    executed = json.loads(output.read_text())
    (shown,) = (cell for cell in executed["cells"] if "first" in cell["metadata"].get("tags", []))
    shown["metadata"]["mystnb"] = {"figure": {"name": "fig-a", "caption": "what could be"}}
    shown["outputs"][0]["metadata"] = {"caption": "what is"}
    before = json.dumps(executed)
    cells = tool.page_of(executed, root, "a")["cells"]
    assert json.dumps(executed) == before
    title, first, *body = cells[:-3]
    assert title["source"][0].startswith("# Sample")
    assert first["outputs"][0]["text"] == ["what comes first\n"]
    assert first["metadata"]["tags"] == ["remove-input"]
    assert first["metadata"]["mystnb"]["figure"] == {"name": "fig-a", "caption": "what is"}
    assert all(not cell.get("outputs") for cell in body)
    hidden = ["remove-cell" in cell["metadata"].get("tags", []) for cell in body]
    assert hidden == [True, True, *[False] * (len(body) - 2)]
    (values,) = (cell["source"] for cell in body if cell["id"].startswith("values-"))
    assert "<code>noise_mt = 0.0, seeds = [0, 1]</code>" in values, "where a reader first sees the names"
    folds = [cell["source"] for cell in cells[-3:]]
    assert [fold.partition("} ")[2].partition("\n")[0] for fold in folds] == [
        "All numbers",
        "Parameters",
        "Provenance",
    ]
    assert "{download}`t.csv <../../results/t.csv>`, 1 rows" in folds[0]
    assert "| `noise_mt` | `0.0` | noise of a sensor [mT], at least 0 |" in folds[1]
    assert ".venv/bin/repro run notebooks/a.ipynb -p fast true -o runs/a.ipynb" in folds[1]
    assert "Recordings: none fetched" in folds[2]


def test_the_scorecard_has_both_states_wherever_it_is_built(root):
    """The first is that of ``results/``; the second has what a study knows of the files, or else this build."""

    def verdicts(value: float, name: str, about: str, comparable: bool) -> list[str]:
        """Return the verdicts after a table was written: of the build, with files in it, and of both states."""
        (root / name).mkdir(parents=True, exist_ok=True)
        key = dict(zip(KEY, ["a2020", "Table 1", "one", "e_u", "mT"], strict=True))
        row = {"regenerated": value, "setting": about, "note": "n", "comparable": str(comparable).lower()}
        pd.DataFrame([key | row], columns=ROW_COLUMNS).to_csv(root / name / "a.rows.csv", index=False)
        card, *states = tool.write_scorecard(root, tool.results_folder(root))
        return [card["verdict"][0], card["with_files_verdict"][0], *(state["verdict"][0] for state in states)]

    none = "not_comparable"
    assert verdicts(9, "results", "synthetic", False) == [none, "", none, none]
    assert verdicts(0.016, "data/studies", AUTHORS, True) == [none, "reproduced", none, "reproduced"]
    (root / "recordings").mkdir()
    (root / "recordings/a.csv").write_text("1\n")
    assert verdicts(0.5, "results/with_recordings", AUTHORS, True) == ["differs", "differs", none, "differs"]
    assert ",0.016," in (root / "results/scorecard.csv").read_text(), "each build writes its own"
