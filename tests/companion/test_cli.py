"""The command line: what it refuses, how it ends, what starting it imports."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from .sample import in_project

BOOK = ["run", "sweep", "scorecard", "compare", "fetch"]


def repro(*arguments: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "repro_companion.cli", *arguments]
    return subprocess.run(command, capture_output=True, text=True, check=False)


@pytest.fixture(autouse=True)
def root(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    return in_project(tmp_path, monkeypatch)


def test_starting_imports_neither_jupyter_nor_torch():
    heavy = "{'torch', 'papermill', 'nbformat', 'jupyter_client', 'pandas', 'distributed', 'numba'}"
    code = f"import sys, repro_companion.cli, repro_companion.run; sys.exit(str({heavy} & set(sys.modules)))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.stderr.strip() == "set()"


def test_an_unknown_command_and_an_unknown_paper_end_with_2():
    done = repro("fetc")
    assert (done.returncode, done.stdout) == (2, "")
    assert 'Did you mean "fetch"?' in done.stderr
    Path("data/sources.json").write_text('{"p2020": {}}')
    done = repro("fetch", "none")
    assert (done.returncode, done.stdout) == (2, "")
    assert (
        done.stderr
        == "repro fetch: Input paper of repro fetch must be one of p2020; instead received none.\n"
    )


def test_a_run_writes_tables_beside_its_output():
    done = repro(
        "run", "notebooks/a.ipynb", "-p", "noise_mt", "5e-1", "-p", "seeds", "[4]", "-o", "runs/x.ipynb"
    )
    assert (done.returncode, done.stderr) == (0, "")
    first, *tables = done.stdout.splitlines()
    assert first.startswith("runs/x.ipynb  (")
    assert tables == ["runs/x/t.csv"]
    assert Path("runs/x/t.csv").read_text() == "seed,x\n4,1.5000\n"
    assert not Path("results").exists()


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        ("run notebooks/a.ipynb -p nois_mt 1", "a.ipynb has no parameter nois_mt; did you mean noise_mt?"),
        ("run notebooks/a.ipynb -p noise_mt -1", "must be at least 0; instead received -1."),
        ("run notebooks/a.ipynb -p fast maybe", "must be bool: true or false; instead received maybe."),
        ("run notebooks/a.ipynb -o results/x.ipynb", "must be outside results/, which belongs to the book"),
        ("run notebooks/none.ipynb", "must be an existing file; instead received notebooks/none.ipynb."),
        ("run", "Input notebook of repro run must be named; instead received none."),
        ("sweep notebooks/a.ipynb", "must be given, each as -p NAME VALUES; instead received none."),
        (
            "sweep notebooks/a.ipynb -p noise_mt 0,x",
            "must be float: a number, such as 1e-3; instead received x.",
        ),
        (
            "sweep notebooks/a.ipynb -p fast true --jobs 1.5",
            "--jobs: it must be a whole number of at most 18 digits",
        ),
        (
            "sweep notebooks/a.ipynb -p fast true -o requirements.lock/x",
            "in folders, there already or new; instead received",
        ),
        ("run notebooks/a.ipynb -o requirements.lock/x.ipynb", "x.ipynb: requirements.lock is a file."),
        ("sweep notebooks/a.ipynb -p fast true --jobs -1", "must be at least 1; instead received -1."),
    ],
)
def test_wrong_input_ends_with_2_before_anything_runs(arguments, said):
    done = repro(*arguments.split())
    assert (done.returncode, done.stdout) == (2, "")
    assert said in done.stderr.splitlines()[0]
    assert not Path("runs").exists()


def test_a_failure_ends_with_1_and_names_the_partial_notebook():
    done = repro("run", "notebooks/a.ipynb", "-p", "noise_mt", "2")
    assert (done.returncode, done.stdout) == (1, "")
    cause, place = done.stderr.splitlines()
    assert cause.endswith("RuntimeError: too much noise")
    assert Path(place.removeprefix("The partial notebook is ")).is_file()
