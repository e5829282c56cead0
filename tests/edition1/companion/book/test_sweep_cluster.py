"""A sweep on a real Dask scheduler with two worker processes, one of which is killed."""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from logged_runs import LOGGED, PARAMETERS, in_background, logged, wait_for

import edition1 as repro
from edition1.errors import InputError
from edition1_companion.book.points import run_points
from edition1_companion.book.project import find_project
from edition1_companion.book.sweep import plan
from edition1_companion.book.sweep_cluster import cluster_runner, connect, difference
from edition1_companion.cli_sweep import sweep

pytest.importorskip("distributed", reason="the extra cluster is not installed")


@pytest.fixture
def notebook(root, notebook_at, writes_a_table, monkeypatch):
    monkeypatch.setenv("SWEEP_LOG", str(root / "log"))
    cells = (LOGGED, writes_a_table("t"))
    return notebook_at(root / "notebooks" / "a.ipynb", *cells, parameters=PARAMETERS)


@pytest.fixture
def cluster(root):
    """Return functions that start a scheduler and workers, as processes; all are killed in the end."""
    processes: list[subprocess.Popen] = []
    file = root / "scheduler.json"

    def start(*arguments: str, **changes: str) -> subprocess.Popen:
        environment = os.environ | changes
        command = [sys.executable, "-m", *arguments]
        with (root / "dask.log").open("a") as log:
            process = subprocess.Popen(
                command, stdout=log, stderr=log, env=environment, start_new_session=True
            )
        processes.append(process)
        return process

    def scheduler(**changes: str) -> str:
        options = ["--host", "127.0.0.1", "--port", "0", "--no-dashboard", "--no-show"]
        start("distributed.cli.dask_scheduler", *options, "--scheduler-file", str(file), **changes)
        wait_for(lambda: file.exists() and file.stat().st_size > 0)
        return json.loads(file.read_text())["address"]

    def worker(name: str, **changes: str) -> subprocess.Popen:
        options = ["--nthreads", "1", "--no-nanny", "--no-dashboard", "--name", name]
        return start("distributed.cli.dask_worker", *options, "--scheduler-file", str(file), **changes)

    yield scheduler, worker, processes
    for process in processes:
        if process.poll() is None:
            os.killpg(process.pid, signal.SIGKILL)
        process.wait()


@pytest.mark.parametrize("with_its_point", [False, True])
def test_a_worker_that_is_killed(root, notebook, cluster, with_its_point):
    scheduler, worker, _ = cluster
    address = scheduler()
    workers = [worker("one"), worker("two")]
    arguments = ["notebooks/a.ipynb", "-p", "n", "0:4", "-p", "seconds", "1", "--scheduler", address]
    running = in_background(*arguments)
    wait_for(lambda: sum(logged(root, "begun").values()) >= 2)  # one point on each worker
    kill = os.killpg if with_its_point else os.kill
    kill(workers[0].pid, signal.SIGKILL)
    _, err = running.communicate(timeout=120)
    assert (running.returncode, err.splitlines()[-1]) == (0, "4 of 4 points are finished."), err
    lines = (root / "runs" / "a-sweep" / "sweep.csv").read_text().splitlines()
    assert [line.partition(",")[0] for line in lines[1:]] == list("0123")
    begun = logged(root, "begun")
    # a process that is left behind finishes its point; one that is killed leaves it to the other worker
    assert sorted(begun.values()) == [1, 1, 1, 2 if with_its_point else 1]


def test_a_point_that_no_worker_survives_fails_and_the_others_do_not(root, notebook_at, cluster, capsys):
    kills_the_worker = "import os\nif n == 1:\n    os.kill(int(os.environ['WORKER']), 9)"
    notebook_at(root / "notebooks" / "a.ipynb", kills_the_worker)
    scheduler, worker, _ = cluster
    address = scheduler(DASK_DISTRIBUTED__SCHEDULER__ALLOWED_FAILURES="0")
    # what a worker starts, and only that, knows the worker
    starts = "import os; os.environ['WORKER'] = str(os.getpid())"
    site = root / "site"
    site.mkdir()
    (site / "sitecustomize.py").write_text(
        f"import sys\nif 'dask_worker' in ' '.join(sys.orig_argv):\n    {starts}\n"
    )
    path = os.pathsep.join([str(site), os.environ.get("PYTHONPATH", "")])
    worker("one", PYTHONPATH=path)
    worker("two", PYTHONPATH=path)
    running = in_background("notebooks/a.ipynb", "-p", "n", "0:3", "--scheduler", address)
    _, err = running.communicate(timeout=120)
    assert running.returncode == 1, err
    assert "n=1: KilledWorker: " in err
    assert err.splitlines()[-1] == "2 of 3 points are finished."


@pytest.fixture
def another_package(root):
    """Return a PYTHONPATH under which repro is a copy with one more module."""
    copy = root / "copy"
    shutil.copytree(Path(str(repro.__file__)).parent, copy / "edition1")
    (copy / "edition1" / "one_more.py").write_text('"""One more."""\n')
    return os.pathsep.join([str(copy), os.environ.get("PYTHONPATH", "")])


def test_a_cluster_of_one_thread(root, notebook, cluster, capsys):
    scheduler, worker, _ = cluster
    address = scheduler()
    worker("one")
    assert sweep(Path("notebooks/a.ipynb"), parameters=[("n", "0:3")], scheduler=address) == 0
    assert capsys.readouterr().err.splitlines()[-1] == "3 of 3 points are finished."
    assert logged(root, "done") == dict.fromkeys(range(3), 1)


def test_a_scheduler_that_is_killed(root, notebook, cluster):
    scheduler, worker, processes = cluster
    address = scheduler()
    worker("one")
    running = in_background(
        "notebooks/a.ipynb", "-p", "n", "0:4", "-p", "seconds", "2", "--scheduler", address
    )
    wait_for(lambda: sum(logged(root, "begun").values()) == 2)
    os.killpg(processes[0].pid, signal.SIGKILL)
    out, err = running.communicate(timeout=120)
    last = err.splitlines()[-1]
    assert (running.returncode, last) == (
        1,
        "The scheduler is gone: 1 of 4 points are finished; run the same command again to go on.",
    ), err
    assert "Traceback" not in err
    assert out.splitlines() == ["runs/a-sweep/sweep.json", "runs/a-sweep/sweep.csv"]
    assert len((root / "runs" / "a-sweep" / "sweep.csv").read_text().splitlines()) == 2
    # what was running is waited for or done again, what is finished is found
    assert sweep(Path("notebooks/a.ipynb"), parameters=[("n", "0:4"), ("seconds", "2")], jobs=1) == 0
    assert len((root / "runs" / "a-sweep" / "sweep.csv").read_text().splitlines()) == 5
    assert sorted(logged(root, "done").values()) == [1] * 4


def test_a_sweep_on_a_cluster_that_is_terminated(root, notebook, cluster):
    scheduler, worker, _ = cluster
    address = scheduler()
    worker("one")
    arguments = ["notebooks/a.ipynb", "-p", "n", "0:4", "-p", "seconds", "2", "--scheduler", address]
    running = in_background(*arguments)
    wait_for(lambda: sum(logged(root, "begun").values()) == 2)
    running.terminate()
    _, err = running.communicate(timeout=120)
    count = "Interrupted: 1 of 4 points are finished; run the same command again to go on."
    said = [line for line in err.splitlines() if "Waiting for a worker" not in line]  # which may start late
    assert (running.returncode, said) == (143, [count])
    # the worker goes on with the point that it runs, and takes no other
    assert sweep(Path("notebooks/a.ipynb"), parameters=[("n", "0:2"), ("seconds", "2")], jobs=1) == 0
    assert logged(root, "begun") == logged(root, "done") == {0: 1, 1: 1}


def test_workers_with_another_package_are_named(root, notebook, cluster, another_package):
    scheduler, worker, _ = cluster
    address = scheduler()
    worker("two", PYTHONPATH=another_package)
    with pytest.raises(InputError) as refused:
        sweep(Path("notebooks/a.ipynb"), parameters=[("n", "1")], scheduler=address)
    message = str(refused.value)
    assert message.startswith("Input worker tcp://127.0.0.1:")
    assert " of repro sweep must be of the same source of repro as here, " in message
    assert not logged(root, "begun")


def test_a_worker_that_joins_later_is_asked_too(root, notebook, cluster, another_package):
    scheduler, worker, _ = cluster
    address = scheduler()
    worker("one")
    client = connect(address)
    try:
        worker("two", PYTHONPATH=another_package)
        wait_for(lambda: len(client.ncores()) == 2)
        points = plan(notebook, [{"n": n} for n in range(2)], root / "s", find_project())
        failures = run_points(points, cluster_runner(client))
    finally:
        client.close()
    assert len(failures) >= 1
    for failure in failures.values():
        assert failure.startswith("Input worker tcp://127.0.0.1:")
        assert " must be of the same source of repro as here, " in failure
    assert sum(logged(root, "done").values()) == 2 - len(failures)


def test_what_is_said_of_workers():
    ours = {"version of repro": "1", "source of repro": "a"}
    assert difference("tcp://w:1", dict(ours), ours) is None
    assert str(difference("tcp://w:1", ours | {"version of repro": "2"}, ours)) == (
        "Input worker tcp://w:1 of repro sweep must be of the same version of repro as here, 1; instead received 2."
    )
    assert str(difference("tcp://w:1", ModuleNotFoundError("No module named 'repro'"), ours)) == (
        "Input worker tcp://w:1 of repro sweep must be able to import this repro; "
        """instead received ModuleNotFoundError("No module named 'repro'")."""
    )


def test_a_scheduler_that_does_not_answer(root, notebook, monkeypatch):
    monkeypatch.setattr("edition1_companion.book.sweep_cluster.TIMEOUT_S", 0.2)
    with pytest.raises(
        InputError, match=r"^Input scheduler of repro sweep must be the address of a Dask scheduler"
    ):
        sweep(Path("notebooks/a.ipynb"), parameters=[("n", "1")], scheduler="tcp://127.0.0.1:9")
