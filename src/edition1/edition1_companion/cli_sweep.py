"""The command ``repro sweep``; registered by `edition1_companion.cli`. It imports what it needs when it runs."""

from __future__ import annotations

import signal
import sys
from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from edition1.errors import bad_input
from edition1_companion.book.project import find_project, runs_folder, shown
from edition1_companion.cli_terminal import pairs

Given = Annotated[list[tuple[str, str]] | None, pairs(["-p", "--parameter"], "NAME VALUES")]


def sweep(
    notebook: Path,
    /,
    *,
    parameters: Given = None,
    grid: Path | None = None,
    jobs: int | None = None,
    scheduler: str = "",
    part: str = "",
    table: str = "",
    output: Annotated[Path | None, Parameter(name=["-o", "--output"])] = None,
) -> int:
    """Run a notebook at every point of a grid: repro sweep NOTEBOOK -p sensors 2,3,4,6 -p seed 0:10.

    Each point is one repro run with one thread. Points that are finished are found and not run again, so the same
    command goes on where it was stopped. Failures are listed at the end; the exit status is then 1. A Dask scheduler
    executes pickles, that is any code that reaches it: use it in trusted networks or with TLS only.

    Parameters
    ----------
    notebook
        The notebook to run; it is not changed.
    parameters
        A parameter and its values: 2,3,4,6 or, for whole numbers, 0:10 (10 is not among them); may be repeated.
    grid
        A file of more parameters, YAML or JSON, each with a list of values; here values may be lists themselves.
    jobs
        Points at a time on this computer; as many as it has cores by default.
    scheduler
        Run on the workers of this Dask scheduler, such as tcp://host:8786 or tls://host:8786. Trusted networks or
        TLS only. Needs the extra cluster, and a folder that all workers see under the same path.
    part
        Run only the i-th of n parts, such as 2/8: for job arrays without Dask. Without it the same command then
        joins what all parts found.
    table
        Join only this table of the notebook, into sweep.csv.
    output
        Folder of points and joined tables; by default runs/NAME-sweep.
    """
    project = find_project()
    from edition1_companion.book.parameters import declared_parameters
    from edition1_companion.book.points import Stopped, finished, local_runner, run_points
    from edition1_companion.book.runner import read_notebook
    from edition1_companion.book.sweep import check_folder, plan, write_sweep
    from edition1_companion.book.sweep_grid import grid_points, read_grid, read_part
    from edition1_companion.book.termination import stop_on_termination

    stop_on_termination()
    declared = declared_parameters(read_notebook(notebook), notebook.name)
    values = read_grid(parameters or [], grid, declared, notebook.name)
    number, parts = read_part(part)
    if jobs is not None and (jobs < 1 or scheduler):
        must_be = "left out with --scheduler" if scheduler else "at least 1"
        raise bad_input("jobs", "repro sweep", must_be, jobs)
    folder = output or runs_folder(project) / f"{notebook.stem}-sweep"
    check_folder(folder, project)
    points = plan(notebook, grid_points(values), folder, project)[number - 1 :: parts]
    client = None
    if scheduler:
        from edition1_companion.book.sweep_cluster import cluster_runner, connect

        client = connect(scheduler)
        runner = cluster_runner(client)
    else:
        runner = local_runner(jobs)
    stopped: Stopped | None = None
    try:
        failures = run_points(points, runner, progress=sys.stderr.isatty())
    except Stopped as stop:
        stopped, failures = stop, stop.failures
    finally:
        if client is not None:
            client.close()
    name = "sweep" if parts == 1 else f"sweep-{number}-of-{parts}"
    missing = {point.index for point in points if not finished(point)} if stopped else set(failures)
    paths, left_out = write_sweep(
        folder, name, notebook, values, points, missing, declared=declared, chosen=table
    )
    for path in paths:
        print(shown(path))
    for line in left_out:
        print(f"Not joined: {line}", file=sys.stderr)
    for point in points:
        if point.index in failures:
            reason = failures[point.index].replace("\n", "\n  ")
            print(f"{point.label()}: {reason}", file=sys.stderr)
    count = f"{len(points) - len(missing)} of {len(points)} points are finished"
    if stopped is None:
        print(f"{count}.", file=sys.stderr)
        return 1 if failures else 0
    print(f"{stopped}: {count}; run the same command again to go on.", file=sys.stderr)
    if isinstance(stopped.__cause__, SystemExit):  # of a request to terminate
        return 128 + signal.SIGTERM
    return 128 + signal.SIGINT if isinstance(stopped.__cause__, KeyboardInterrupt) else 1
