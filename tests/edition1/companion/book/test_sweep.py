"""Sweeps, run for real: resumed, interrupted, in parts."""

from __future__ import annotations

import json
import os
import signal
import time
from pathlib import Path

import psutil
import pytest
from cyclopts import App
from logged_runs import LOGGED, PARAMETERS, in_background, logged, wait_for

from edition1.errors import InputError
from edition1_companion.book.points import finished, local_runner, run_points
from edition1_companion.book.project import find_project
from edition1_companion.book.sweep import joined_tables, plan, shown_command
from edition1_companion.cli_sweep import sweep


@pytest.fixture
def notebook(root, notebook_at, writes_a_table, monkeypatch):
    monkeypatch.setenv("SWEEP_LOG", str(root / "log"))
    cells = (LOGGED, writes_a_table("t"))
    return notebook_at(root / "notebooks" / "a.ipynb", *cells, parameters=PARAMETERS)


def command(*arguments: str) -> int:
    """Call the command as the command line does."""
    app = App(name="repro")
    app.command(sweep)
    return app(["sweep", *arguments], exit_on_error=False, print_error=False, result_action="return_value")


def test_a_sweep_and_the_same_again(root, notebook, capsys):
    arguments = ["notebooks/a.ipynb", "-p", "n", "2,13,6", "--jobs", "2"]
    assert command(*arguments) == 1
    out, err = capsys.readouterr()
    assert out == "runs/a-sweep/sweep.json\nruns/a-sweep/sweep.csv\n"
    (partial,) = (root / "runs" / "a-sweep" / "points").glob("*/*.failed.ipynb")
    assert err.splitlines() == [
        "n=13: notebooks/a.ipynb failed in code cell 3: import os, time",
        "    ValueError: unlucky",
        f"    The partial notebook is {partial.relative_to(root)}",
        "2 of 3 points are finished.",
    ]
    table = root / "runs" / "a-sweep" / "sweep.csv"
    assert table.read_text() == "n,table_n,third\n2,2,0.666667\n6,6,2\n"
    assert json.loads(table.with_suffix(".json").read_text()) == {
        "command": "repro sweep notebooks/a.ipynb -p n 2,13,6",
        "grid": {"n": [2, 13, 6]},
        "defaults": {"seconds": "0.0"},
        "points": 3,
        "failed": [{"n": 13}],
        "tables": ["sweep.csv"],
    }

    # a larger grid: what is finished is found, what failed is tried again; that its list is damaged is no matter
    table.with_suffix(".json").write_text("[" * 200_000)
    assert command(*arguments[:3], "2,6,13,9", "--jobs", "1") == 1
    assert logged(root, "begun") == {2: 1, 6: 1, 13: 2, 9: 1}
    assert table.read_text() == "n,table_n,third\n2,2,0.666667\n6,6,2\n9,9,3\n"

    # a table that was changed by hand, or another package, is not what the record says
    (changed,) = [x for x in (root / "runs" / "a-sweep" / "points").glob("*/t.csv") if "9,3" in x.read_text()]
    changed.write_text("n,third\n9,4\n")
    assert command(*arguments[:3], "2,9", "--jobs", "1") == 0
    assert logged(root, "begun") == {2: 1, 6: 1, 13: 2, 9: 2}
    assert table.read_text() == "n,table_n,third\n2,2,0.666667\n9,9,3\n"
    (root / "src" / "edition1" / "edition1" / "module.py").write_text('"""Another module."""\n')
    (point,) = plan(notebook, [{"n": 2}], root / "runs" / "a-sweep", find_project())
    assert finished(point) is None


def test_parts_make_the_whole(root, notebook, capsys):
    folder = root / "runs" / "a-sweep"
    for part in ("1/2", "2/2"):
        assert command("notebooks/a.ipynb", "-p", "n", "0:3", "--jobs", "1", "--part", part) == 0
    assert (folder / "sweep-1-of-2.csv").read_text() == "n,table_n,third\n0,0,0\n2,2,0.666667\n"
    assert (folder / "sweep-2-of-2.csv").read_text() == "n,table_n,third\n1,1,0.333333\n"
    assert command("notebooks/a.ipynb", "-p", "n", "0:3", "--jobs", "1") == 0
    assert len((folder / "sweep.csv").read_text().splitlines()) == 4
    assert logged(root, "done") == dict.fromkeys(range(3), 1)


def test_a_sweep_that_is_killed_goes_on(root, notebook):
    arguments = ["notebooks/a.ipynb", "-p", "n", "0:3", "-p", "seconds", "1.5", "--jobs", "1"]
    killed = in_background(*arguments)
    wait_for(lambda: logged(root, "begun"))
    killed.kill()
    killed.communicate()
    # its point goes on without it, and the next sweep waits for that one
    assert not logged(root, "done")
    assert command(*arguments) == 0
    assert logged(root, "begun") == logged(root, "done") == dict.fromkeys(range(3), 1)
    assert len((root / "runs" / "a-sweep" / "sweep.csv").read_text().splitlines()) == 4


@pytest.mark.parametrize(
    ("number", "send", "status"),
    [
        (signal.SIGINT, os.killpg, 130),  # as the keyboard does: to all processes
        (signal.SIGTERM, os.kill, 143),
        (signal.SIGTERM, os.killpg, 143),  # as some batch systems do
    ],
)
def test_an_interrupted_sweep_says_how_to_go_on(root, notebook, number, send, status):
    arguments = ["notebooks/a.ipynb", "-p", "n", "13,0,1,2", "-p", "seconds", "2", "--jobs", "1"]
    sweeping = in_background(*arguments)
    wait_for(lambda: sum(logged(root, "begun").values()) >= 3)  # both workers may begin at once
    send(sweeping.pid, number)
    out, err = sweeping.communicate(timeout=60)
    assert sweeping.returncode == status
    assert "Traceback" not in err
    lines = err.splitlines()
    assert lines[0].startswith("n=13 seconds=2.0: notebooks/a.ipynb failed in code cell 3")
    assert lines[-1] == "Interrupted: 1 of 4 points are finished; run the same command again to go on."
    assert out.splitlines() == ["runs/a-sweep/sweep.json", "runs/a-sweep/sweep.csv"]
    assert len((root / "runs" / "a-sweep" / "sweep.csv").read_text().splitlines()) == 2
    about = json.loads((root / "runs" / "a-sweep" / "sweep.json").read_text())
    assert [point["n"] for point in about["failed"]] == [13, 1, 2]
    assert command(*arguments[:3], "0:3", *arguments[4:]) == 0
    assert logged(root, "done")[0] == 1


def test_a_sweep_that_is_terminated_ends_its_workers(root, notebook):
    arguments = ["notebooks/a.ipynb", "-p", "n", "0:4", "-p", "seconds", "2", "--jobs", "2"]
    sweeping = in_background(*arguments)
    wait_for(lambda: sum(logged(root, "begun").values()) >= 3)  # both workers may begin at once
    started = psutil.Process(sweeping.pid).children(recursive=True)
    for _ in range(2):  # as `timeout` does
        os.kill(sweeping.pid, signal.SIGTERM)
        time.sleep(0.02)
    _, err = sweeping.communicate(timeout=60)
    assert sweeping.returncode == 143
    folder = root / "runs" / "a-sweep"
    points = plan(notebook, [{"n": n, "seconds": 2.0} for n in range(4)], folder, find_project())
    done = [point for point in points if finished(point)]
    assert 1 <= len(done) <= 2
    count = f"Interrupted: {len(done)} of 4 points are finished; run the same command again to go on."
    assert err.splitlines() == [count]
    assert len((folder / "sweep.csv").read_text().splitlines()) == 1 + len(done)
    # no table stands without its record, and nobody goes on to write one
    assert {path.parent for path in folder.glob("points/*/t.csv")} == {point.output.parent for point in done}
    assert len(started) >= 4  # two workers, and at least one point with its kernel
    wait_for(lambda: not any(process.is_running() and process.status() != "zombie" for process in started))
    assert command(*arguments) == 0
    assert len((folder / "sweep.csv").read_text().splitlines()) == 5


def test_a_half_written_point_is_run_again(root, notebook):
    (point,) = plan(notebook, [{"n": 4}], root / "s", find_project())
    left = point.output.parent / ".a-k3x"
    left.mkdir(parents=True)
    (left / "t.csv").write_text("n,th")
    (point.output.parent / "t.csv").write_text("n,third\n4,")
    point.output.write_text("{")
    assert run_points([point], local_runner(1)) == {}
    assert (point.output.parent / "t.csv").read_text() == "n,third\n4,1.33333\n"
    assert not left.exists()
    assert finished(point)


def test_a_package_that_changes_while_points_run_is_noticed(root, notebook):
    (point,) = plan(notebook, [{"n": 4}], root / "s", find_project())
    (root / "src" / "edition1" / "edition1" / "module.py").write_text('"""Another module."""\n')
    assert run_points([point], local_runner(1)) == {
        0: "it ran with another package, data, lock or libraries than it was planned with"
    }


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["-p", "n", "1", "--jobs", "0"], "jobs of repro sweep must be at least 1; instead received 0."),
        (
            ["-p", "n", "1", "--jobs", "2", "--scheduler", "tcp://a:1"],
            "jobs of repro sweep must be left out with --scheduler; instead received 2.",
        ),
        (
            ["-p", "n", "1", "-o", "results/s"],
            "output of repro sweep must be outside results/, which belongs to the book; "
            "instead received results/s.",
        ),
        (
            ["-p", "n", "1", "-o", "pyproject.toml"],
            "output of repro sweep must be a folder; instead received pyproject.toml.",
        ),
        (
            ["-p", "n", "1", "--scheduler", "host:8786"],
            "scheduler of repro sweep must be an address such as tcp://host:8786; instead received host:8786.",
        ),
    ],
)
def test_what_is_refused_before_anything_runs(root, notebook, arguments, message):
    with pytest.raises(InputError) as refused:
        command("notebooks/a.ipynb", *arguments)
    assert str(refused.value) == f"Input {message}"
    assert not logged(root, "begun")


def test_help_warns_of_pickles(capsys):
    command("--help")
    text = " ".join(capsys.readouterr().out.replace("│", " ").split())
    assert "A Dask scheduler executes pickles" in text
    assert "trusted networks or with TLS only" in text


def test_tables_are_joined_or_named(tmp_path):
    def wrote(n: int, **tables: str) -> tuple[dict, list[Path]]:
        paths = []
        for name, text in tables.items():
            paths.append(tmp_path / str(n) / f"{name.replace('__', '.')}.csv")
            paths[-1].parent.mkdir(exist_ok=True)
            paths[-1].write_text(text)
        return {"n": n, "gains": [1, "x"]}, paths

    results = [
        wrote(1, t="a,label\n1,\"x,y\"\n,\n", u="a\n1\n", v="a\n1\n", t__rows="paper\nb\n"),
        wrote(2, t="a,label\n2,z\n", u="a,b\n1,2\n"),
    ]  # fmt: skip
    tables, left_out = joined_tables(results)
    assert tables == {"t": 'n,gains,a,label\n1,"[1, ""x""]",1,"x,y"\n1,"[1, ""x""]",,\n2,"[1, ""x""]",2,z\n'}
    assert left_out == ["u: its columns differ between points (b)", "v: 1 of 2 points did not write it"]
    assert joined_tables(results, "t") == (tables, [])
    with pytest.raises(InputError) as refused:
        joined_tables(results, "w")
    assert str(refused.value) == (
        "Input table of repro sweep must be a table that the notebook writes (t, u, v); instead received w."
    )
    assert joined_tables([], "t") == ({}, [])


def test_the_command_that_is_shown():
    grid = {"n": [1, 2], "ring": ["a b", "c"], "gains": [[1], [2]]}
    assert shown_command("a.ipynb", grid) == "repro sweep a.ipynb -p n 1,2 -p ring 'a b,c' --grid FILE"
