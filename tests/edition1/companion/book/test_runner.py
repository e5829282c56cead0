"""One notebook, run for real: whole outputs, failures kept aside, records."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import nbformat
import pytest

from edition1.errors import InputError
from edition1_companion.book.digests import file_digest
from edition1_companion.book.project import find_project
from edition1_companion.book.runner import check_output, default_output, read_notebook


def run(*places: Path) -> subprocess.CompletedProcess[str]:
    """Run a notebook as a build does: NOTEBOOK OUTPUT RESULTS FAILED."""
    command = [sys.executable, "-m", "edition1_companion.book.runner", *map(str, places)]
    return subprocess.run(command, capture_output=True, text=True, check=False)


def listed(folder: Path) -> list[str]:
    return sorted(path.relative_to(folder).as_posix() for path in folder.rglob("*") if path.is_file())


@pytest.fixture
def places(root, notebook_at, writes_a_table):
    names = "('OMP_NUM_THREADS', 'MKL_NUM_THREADS', 'REPRO_DATA_DIR')"
    shows_its_surroundings = f"import os\nprint(*[os.environ[name] for name in {names}])"
    # braces in a path must not be taken for a format
    notebook = notebook_at(root / "notebooks" / "a{b}.ipynb", writes_a_table("t"), shows_its_surroundings)
    return notebook, root / "out" / "a{b}.ipynb", root / "results", root / "runs" / "a{b}.failed.ipynb"


def test_a_run_and_a_later_failure(root, places, notebook_at, tmp_path, writes_a_table):
    notebook, output, results, failed = places
    done = run(*places)
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")
    assert listed(results) == ["t.csv"]
    assert (results / "t.csv").read_text() == "n,third\n3,1\n"
    executed = nbformat.read(output, as_version=4)
    assert executed.cells[2].outputs[0].text == f"1 1 {tmp_path / 'recordings'}\n"
    assert executed.metadata.papermill.output_path == "a{b}.ipynb"
    assert executed.metadata.papermill.input_path == "a{b}.ipynb"
    record = json.loads(output.with_name("a{b}.provenance.json").read_text())
    assert record["notebook"] == "notebooks/a{b}.ipynb"
    assert record["results"] == {"t.csv": file_digest(results / "t.csv")}
    assert record["executed"] == file_digest(output)

    before = {path: path.read_bytes() for path in (output, *results.iterdir())}
    notebook_at(notebook, writes_a_table("t"), writes_a_table("u"), "\n1 / (n - n)\n", "print('never')")
    done = run(*places)
    assert done.returncode == 1
    assert done.stdout == (
        "notebooks/a{b}.ipynb failed in code cell 4: 1 / (n - n)\n"
        "  ZeroDivisionError: division by zero\n"
        "  The partial notebook is runs/a{b}.failed.ipynb\n"
    )
    assert {path: path.read_bytes() for path in (output, *results.iterdir())} == before
    assert "division by zero" in failed.read_text()

    notebook_at(notebook, writes_a_table("u"))
    assert run(*places).returncode == 0
    assert listed(results) == ["u.csv"]
    assert not failed.exists()


def test_a_kernel_takes_no_port_that_another_program_could_take_first(root, places, notebook_at, monkeypatch):
    # A TMPDIR of its own: what is left there after the run would be the run's.
    (root / "t").mkdir()
    monkeypatch.setenv("TMPDIR", str(root / "t"))
    notebook_at(
        places[0],
        "from ipykernel.connect import get_connection_info",
        "print(get_connection_info(unpack=True)['transport'])",
    )
    done = run(*places)
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")
    assert nbformat.read(places[1], as_version=4).cells[-1].outputs[0].text == "ipc\n"
    assert listed(root / "t") == []


def test_a_kernel_that_dies_before_the_first_cell(root, places, tmp_path, monkeypatch):
    kernel = tmp_path / "jupyter" / "kernels" / "python3"
    kernel.mkdir(parents=True)
    starts = [sys.executable, "-c", "raise SystemExit('no')", "-f", "{connection_file}"]
    spec = {"argv": starts, "display_name": "python3", "language": "python"}
    (kernel / "kernel.json").write_text(json.dumps(spec))
    monkeypatch.setenv("JUPYTER_PATH", str(tmp_path / "jupyter"))
    done = run(*places)
    assert done.returncode == 1
    assert "failed in code cell 0: (none was begun)\n  RuntimeError: Kernel died" in done.stdout


def test_a_kernel_that_dies(root, places, notebook_at):
    notebook_at(places[0], "import os\nos._exit(3)")
    done = run(*places)
    assert done.returncode == 1
    assert done.stdout.startswith(
        "notebooks/a{b}.ipynb failed in code cell 2: import os\n  DeadKernelError: Kernel died\n"
    )
    assert places[3].is_file()
    assert not places[1].exists()


def test_the_end_of_a_kernel_says_nothing(root, places, notebook_at, writes_a_table):
    at_its_end = "import atexit, os\natexit.register(os.write, 2, b'Socket operation on non-socket')"
    notebook_at(places[0], writes_a_table("t"), at_its_end)
    done = run(*places)
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")
    assert (root / "results" / "t.csv").is_file()


@pytest.mark.parametrize(("stop", "code"), [(signal.SIGINT, 130), (signal.SIGTERM, 143)])
def test_an_interrupted_run_leaves_only_the_partial_notebook(root, places, notebook_at, stop, code):
    notebook_at(places[0], "from pathlib import Path\nPath('begun').touch()\nimport time\ntime.sleep(60)")
    command = [sys.executable, "-m", "edition1_companion.book.runner", *map(str, places)]
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True)
    deadline = time.monotonic() + 30
    while not (root / "begun").exists() and time.monotonic() < deadline:
        time.sleep(0.05)
    process.send_signal(stop)
    _, message = process.communicate(timeout=20)
    assert process.returncode == code
    assert "The partial notebook is runs/a{b}.failed.ipynb" in message
    assert not (root / "results").exists()
    assert os.listdir(places[1].parent) == []
    assert places[3].is_file()


def test_plain_papermill_works_and_leaves_the_book_alone(root, notebook_at, writes_a_table):
    notebook_at(root / "notebooks" / "a.ipynb", writes_a_table("t"))
    command = [sys.executable, "-m", "papermill", "notebooks/a.ipynb", "out.ipynb", "-p", "n", "6"]
    subprocess.run(command, check=True, capture_output=True)
    assert (root / "runs" / "t.csv").read_text() == "n,third\n6,2\n"
    assert not (root / "results").exists()


def test_notebooks_that_cannot_be_read(root):
    with pytest.raises(
        InputError, match=r"notebook of repro run must be an existing file; instead received no.ipynb"
    ):
        read_notebook(Path("no.ipynb"))
    for text in (
        "{",
        "[]",
        "{}",
        "[" * 200_000,
        '{"cells": [{"source": ' + "[" * 200_000,
        '{"cells": 3, "nbformat": 4, "nbformat_minor": 5, "metadata": {}}',
    ):
        Path("bad.ipynb").write_text(text)
        with pytest.raises(
            InputError, match="notebook of repro run must be a Jupyter notebook; instead received bad"
        ):
            read_notebook(Path("bad.ipynb"))


def test_outputs_by_default(root, monkeypatch):
    project = find_project()
    notebook = root / "notebooks" / "a.ipynb"
    assert default_output(notebook, "0123456789", project) == root / "runs" / "a-01234567" / "a.ipynb"
    (root / "work").mkdir()
    monkeypatch.chdir(root / "work")
    assert (
        default_output(notebook, "0123456789", project) == root / "work" / "runs" / "a-01234567" / "a.ipynb"
    )
    monkeypatch.chdir(root / "notebooks")
    assert default_output(notebook, "0123456789", project) == root / "runs" / "a-01234567" / "a.ipynb"


@pytest.mark.parametrize(
    ("output", "must_be"),
    [
        ("book/notebooks/a.ipynb", "outside book/, which belongs to the book"),
        ("notebooks/../notebooks/b.ipynb", "outside notebooks/, which belongs to the book"),
        ("results/a.ipynb", "outside results/, which belongs to the book"),
        ("linked/a.ipynb", "outside results/, which belongs to the book"),
        ("a.html", "a file name that ends in .ipynb"),
        ("folder.ipynb", "a file name that ends in .ipynb"),
        ("own.ipynb", "another file than the notebook"),
    ],
)
def test_outputs_that_are_refused(root, output, must_be):
    Path("results").mkdir()
    Path("linked").symlink_to("results")
    Path("folder.ipynb").mkdir()
    with pytest.raises(InputError) as refused:
        check_output(Path("own.ipynb"), Path(output), find_project())
    assert str(refused.value) == f"Input output of repro run must be {must_be}; instead received {output}."
