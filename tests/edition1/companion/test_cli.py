"""The command line, as a reader meets it: exit codes, messages, outputs."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import nbformat
import numpy as np
import pytest

from edition1_companion.cli import app

CELLS = """\
n: int = 3  # how many
step: float = 0.5  # step [m]
fast: bool = False  # a short run
gains: list = [1]  # gains
"""
LISTING = """\
Parameters of a.ipynb:
  n: int = 3          how many
  step: float = 0.5   step [m]
  fast: bool = False  a short run
  gains: list = [1]   gains
"""
TABLE = """\
import pandas as pd
from edition1_companion.book.results import write_table
if n < 0:
    raise ValueError("n is negative")
write_table(pd.DataFrame({"n": [n], "step_m": [step], "fast": [fast], "gain": [gains[0]]}), "t")"""


def repro(*arguments: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "edition1_companion.cli", *arguments]
    return subprocess.run(command, capture_output=True, text=True, check=False)


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return a project with one notebook; it is the current folder."""
    (tmp_path / "pyproject.toml").write_text("[tool.repro]\n")
    kernel = {"name": "python3", "language": "python", "display_name": "Python 3"}
    notebook = nbformat.v4.new_notebook(metadata={"kernelspec": kernel})
    notebook.cells = [
        nbformat.v4.new_code_cell(CELLS, metadata={"tags": ["parameters"]}),
        nbformat.v4.new_code_cell(TABLE),
    ]
    nbformat.write(notebook, tmp_path / "a.ipynb")
    published = tmp_path / "data" / "published" / "published.csv"
    published.parent.mkdir(parents=True)
    published.write_text("paper,artefact,row,quantity,unit,value,std\na2020,Table 1,one,e_u,mT,0.015,0.002\n")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("REPRO_DATA_DIR", str(tmp_path / "recordings"))
    return tmp_path


def test_help_imports_nothing_heavy():
    done = repro("--help")
    assert done.returncode == 0
    assert "run" in done.stdout
    assert "scorecard" in done.stdout
    heavy = "{'torch', 'pandas', 'papermill', 'numpy'}"
    code = f"import sys, edition1_companion.cli; sys.exit(bool({heavy} & set(sys.modules)))"
    subprocess.run([sys.executable, "-c", code], check=True)


def test_a_run_with_parameters(folder):
    parameters = ["-p", "n", "5", "-p", "step", "-1e-3", "-p", "fast", "true", "-p", "gains", "[2e3, x]"]
    done = repro("run", "a.ipynb", *parameters)
    assert done.returncode == 0, done.stderr
    assert done.stderr == ""
    notebook, table = done.stdout.splitlines()
    (run,) = (folder / "runs").iterdir()
    assert notebook.startswith(f"runs/{run.name}/a.ipynb  (")
    assert table == f"runs/{run.name}/t.csv"
    assert run.name.startswith("a-")
    assert len(run.name) == len("a-01234567")
    assert sorted(os.listdir(run)) == ["a.ipynb", "a.provenance.json", "t.csv"]
    assert (run / "t.csv").read_text() == "n,step_m,fast,gain\n5,-0.001,True,2000\n"


def test_a_named_output_and_a_failure(folder):
    assert repro("run", "a.ipynb", "-o", "out/mine.ipynb").returncode == 0
    assert sorted(os.listdir("out")) == ["mine.ipynb", "mine.provenance.json", "t.csv"]
    before = Path("out/mine.ipynb").read_bytes()
    done = repro("run", "a.ipynb", "-o", "out/mine.ipynb", "-p", "n", "-5")
    assert done.returncode == 1
    assert done.stdout == ""
    assert done.stderr == (
        "a.ipynb failed in code cell 3: import pandas as pd\n"
        "  ValueError: n is negative\n"
        "  The partial notebook is out/mine.failed.ipynb\n"
    )
    assert Path("out/mine.ipynb").read_bytes() == before
    assert sorted(os.listdir("out")) == ["mine.failed.ipynb", "mine.ipynb", "mine.provenance.json", "t.csv"]


@pytest.mark.parametrize(
    "typed",
    [
        "",
        " ",
        "it's",
        "-o",
        "--helpful",
        "-p",
        "---",
        "1",
        "True",
        "{a: 1}",
        "größe 10 µm 🤖",
        "a=b; x & | # %",
        "\\",
    ],
)
def test_a_text_arrives_as_typed(typed):
    _, bound, _ = app.parse_args(
        ["run", "a.ipynb", "-p", "name", typed], exit_on_error=False, print_error=False
    )
    assert bound.arguments["parameters"] == [("name", typed)]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (
            ["-p", "nonsense", "1"],
            "Input parameter nonsense of a.ipynb must be one of the parameters listed below; "
            "instead received nonsense = 1.\n" + LISTING,
        ),
        (
            ["-p", "n", "1.5"],
            "Input parameter n of a.ipynb must be int: a whole number, such as 3; instead received 1.5.\n"
            + LISTING,
        ),
        (["-p", "n"], 'Command "run" parameter -p requires 2 positional arguments. Only got 1.\n'),
        (
            ["-o", "notebooks/b.ipynb"],
            "Input output of repro run must be outside notebooks/, which belongs to the book; "
            "instead received notebooks/b.ipynb.\n",
        ),
        (["--nonsense"], "Unknown option: --nonsense.\n"),
    ],
)
def test_wrong_input(folder, arguments, message):
    done = repro("run", "a.ipynb", *arguments)
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr == "repro: " + message
    assert not (folder / "runs").exists()


def test_versions_of_what_computes(folder):
    done = repro("run", "--versions")
    assert (done.returncode, done.stderr) == (0, "")
    first, *libraries, last = done.stdout.splitlines()
    assert re.fullmatch(r"repro \d+\.\d+\.\d+, Python 3\.\d+\.\d+, .+", first)
    assert f"numpy {np.__version__}" in libraries
    assert last == f"Recordings: {folder / 'recordings'}"
    assert "must be named; instead received none" in repro("run").stderr


def test_notebooks_that_cannot_run(folder):
    done = repro("run", "no.ipynb")
    assert done.returncode == 2
    assert done.stderr == (
        "repro: Input notebook of repro run must be an existing file; instead received no.ipynb.\n"
    )
    nbformat.write(nbformat.v4.new_notebook(cells=[nbformat.v4.new_code_cell("1")]), folder / "b.ipynb")
    done = repro("run", "b.ipynb")
    assert done.returncode == 2
    assert done.stderr == (
        "repro: Input notebook of repro run must be a notebook with a cell tagged parameters; "
        "instead received b.ipynb.\n"
    )


def test_scorecard(folder):
    done = repro("scorecard", "--write-reference", "reference.csv")
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout == (
        "       reproduced  better  differs  weak  printed again  not comparable  missing  all\n"
        "a2020           0       0        0     0              0               0        1    1\n"
        "all             0       0        0     0              0               0        1    1\n"
        "\n"
        "All rows: results/scorecard.csv\n"
    )
    assert len(Path("results/scorecard.csv").read_text().splitlines()) == 2
    reference = Path("reference.csv").read_text()
    assert reference == "paper,artefact,row,quantity,unit,verdict\na2020,Table 1,one,e_u,mT,missing\n"
    assert repro("scorecard", "--require", "reference.csv").returncode == 0


def test_a_scorecard_with_another_verdict():
    Path("reference.csv").write_text(
        "paper,artefact,row,quantity,unit,verdict\na2020,Table 1,one,e_u,mT,reproduced\n"
    )
    done = repro("scorecard", "--require", "reference.csv")
    assert done.returncode == 1
    assert done.stderr == (
        "Verdicts other than in reference.csv:\n"
        "  a2020 / Table 1 / one / e_u / mT: was reproduced, is missing\n"
    )


def test_a_missing_reference_is_wrong_input():
    done = repro("scorecard", "--require", "no.csv")
    assert done.returncode == 2
    assert done.stderr == (
        "repro: Input file of the scorecard must be an existing CSV file; instead received no.csv.\n"
    )
