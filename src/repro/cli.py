"""The command ``repro``: a thin list of commands.

Each imports what it needs when it runs, so that help is instant.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated

from cyclopts import App, CycloptsError, Parameter

from repro import cli_diff, cli_fit, cli_live, cli_robot, cli_sweep, cli_track
from repro.cli_pairs import pairs
from repro.errors import InputError, bad_input

app = App(
    name="repro",
    help="Run notebooks of the companion with parameters of your own, and compare results with the papers.",
    version_flags=[],
    help_format="plaintext",
)

Given = Annotated[list[tuple[str, str]] | None, pairs(["-p", "--parameter"], "NAME VALUE")]
Output = Annotated[Path | None, Parameter(name=["-o", "--output"])]


@app.command
def run(notebook: Path, /, *, parameters: Given = None, output: Output = None) -> int:
    """Run a notebook: repro run NOTEBOOK [-p NAME VALUE ...] [-o OUT.ipynb].

    Parameters
    ----------
    notebook
        The notebook to run; it is not changed.
    parameters
        A parameter and its value, such as -p n_segments 3; may be repeated. Lists and dictionaries are YAML.
    output
        The executed notebook; tables are written beside it. By default a folder below runs/.
    """
    from repro.report.parameters import convert_all, declared_parameters
    from repro.report.project import find_project, shown
    from repro.report.provenance import notebook_key, read_inputs
    from repro.report.runner import (
        NotebookFailed,
        check_output,
        default_output,
        read_notebook,
        run_notebook,
        stop_on_termination,
    )

    stop_on_termination()
    project = find_project()
    declared = declared_parameters(read_notebook(notebook), notebook.name)
    values = convert_all(parameters or [], declared, notebook.name)
    if output is None:
        output = default_output(notebook, notebook_key(notebook, values, read_inputs(project)), project)
    check_output(notebook, output, project)
    try:
        record = run_notebook(
            notebook, values, output, output.parent, project=project, progress=sys.stderr.isatty()
        )
    except NotebookFailed as failure:
        print(failure, file=sys.stderr)
        return 1
    print(f"{shown(output)}  ({record.seconds:.1f} s)")
    for table in record.results:
        print(f"{shown(output.parent / table)}")
    return 0


@app.command
def scorecard(*, require: Path | None = None, write_reference: Path | None = None) -> int:
    """Compare the book's results with every number of the papers; write results/scorecard.csv.

    Parameters
    ----------
    require
        A reference; exit with 1 if any verdict is not the one that it has, for the better or for the worse.
    write_reference
        Write today's verdicts as a reference to this file.
    """
    from repro.report.files import write_whole
    from repro.report.project import find_project, shown
    from repro.report.scorecard import (
        REFERENCE_COLUMNS,
        changed_verdicts,
        compute_scorecard,
        scorecard_csv,
        summary,
    )

    project = find_project()
    rows = compute_scorecard(project)
    path = project.results / "scorecard.csv"
    write_whole(path, scorecard_csv(rows))
    print(f"{summary(rows)}\n\nAll rows: {shown(path)}")
    changed = changed_verdicts(rows, require) if require else []
    if changed:
        print(f"Verdicts other than in {require}:", *changed, sep="\n  ", file=sys.stderr)
        return 1
    if write_reference:
        write_whole(write_reference, scorecard_csv(rows, REFERENCE_COLUMNS))
    return 0


@app.command
def train(*, only: str = "", folder: Path | None = None, checkpoints: Path | None = None) -> int:
    """Train the networks of the paper's recipe that data/networks/ does not have yet; go on where it stopped.

    Parameters
    ----------
    only
        Train only those whose name starts with this, such as pcc_nb1.
    folder
        Folder of the networks, in place of data/networks/.
    checkpoints
        Folder of the state between runs, in place of .cache/book/networks/.
    """
    import torch

    from repro.experiments.baaij2023.rig_training import RigSpec, rig_specs, train_rig
    from repro.experiments.baaij2023.training import specs
    from repro.experiments.baaij2023.training import train as train_network
    from repro.report.project import find_project, shown

    torch.set_num_threads(1)  # several of these run side by side faster than one with several threads
    project = find_project()
    folder, checkpoints = folder or project.data / "networks", checkpoints or project.cache / "networks"
    wanted = [spec for spec in (*specs(), *rig_specs()) if spec.name.startswith(only)]
    if not wanted:
        raise bad_input("only", "repro train", "the start of a network's name", repr(only))
    missing = [spec for spec in wanted if not (folder / f"{spec.name}.safetensors").exists()]
    print(f"{len(wanted) - len(missing)} of {len(wanted)} networks are there.")
    for spec in missing:
        print(spec.name, flush=True)
        progress = sys.stderr.isatty()
        if isinstance(spec, RigSpec):
            path = train_rig(spec, folder, checkpoints, progress=progress)
        else:
            path = train_network(spec, folder, checkpoints, progress=progress)
        print(f"  {shown(path)}", flush=True)
    return 0


@app.command
def studies() -> int:
    """Compute the tables in data/studies/ that are missing or belong to other settings (minutes each, resumable)."""
    from functools import partial

    import torch

    from repro.experiments.placement.study import write_placement_study
    from repro.live.follow.alarm_study import ALARMS
    from repro.report.project import find_project, shown
    from repro.report.studies import write_studies

    torch.set_num_threads(1)
    folder = find_project().data / "studies"
    progress = sys.stderr.isatty()
    for write in (partial(write_studies, further=[ALARMS]), write_placement_study):
        for path in write(folder, progress=progress):
            print(shown(path), flush=True)
    return 0


@app.command
def bench() -> int:
    """Measure what costs how much on this computer: results/bench.csv, and all rows in data/benchmark*.csv (minutes).

    A target that is missed is a result like any other: the exit status is 0.
    """
    from repro.experiments.benchmark.capabilities import benchmark
    from repro.experiments.benchmark.tables import with_targets
    from repro.report.files import write_whole
    from repro.report.project import find_project, shown

    project = find_project()
    table, points = benchmark(project.data / "networks")
    for path, part in (
        (project.results / "bench.csv", with_targets(table)),
        (project.data / "benchmark.csv", table),
        (project.data / "benchmark_scaling.csv", points),
    ):
        path.parent.mkdir(parents=True, exist_ok=True)
        write_whole(path, part.to_csv(index=False, float_format="%.4g", lineterminator="\n"))
        print(shown(path))
    print(with_targets(table).drop(columns=["error", "note"]).to_string(index=False))
    return 0


@app.command
def fetch(
    paper: str = "",
    /,
    *,
    mirror: Annotated[str, Parameter(env_var="REPRO_MIRROR")] = "",
    list_only: Annotated[bool, Parameter(name="--list", negative="")] = False,
) -> int:
    """Download the authors' public recordings that are not below REPRO_DATA_DIR yet; go on where it stopped.

    Parameters
    ----------
    paper
        One paper, such as mitchell2021; all by default.
    mirror
        Download from MIRROR/PAPER/PATH, such as a folder of recordings served over HTTP, instead of GitHub.
    list_only
        Download nothing; print what there is, how much of it is here already, and where it comes from.
    """
    from repro.recordings.download import fetch as fetch_files
    from repro.recordings.download import listing
    from repro.recordings.sources import data_dir, read_sources
    from repro.report.project import find_project, shown
    from repro.report.runner import stop_on_termination

    stop_on_termination()
    folder = data_dir()
    files = read_sources(find_project().data / "sources.json", [paper] if paper else [])
    if list_only:
        print(f"{listing(files, folder)}\nFolder: {shown(folder)}")
        return 0
    report = fetch_files(files, folder, mirror=mirror or None, progress=sys.stderr.isatty())
    print(report, file=sys.stderr if report.failed else sys.stdout)
    return 1 if report.failed else 0


for command in (cli_live.record, cli_live.export, cli_live.emulate, cli_robot.calibrate, cli_robot.live):
    app.command(command)
app.command(cli_track.track)
app.command(cli_fit.fit)
app.command(cli_sweep.sweep)
app.command(cli_diff.diff)


def main() -> int:
    """Run the command line; return 0, 1 where a notebook or a comparison failed, or 2 for wrong input."""
    try:
        return app(exit_on_error=False, print_error=False, result_action="return_value") or 0
    except (InputError, CycloptsError) as error:
        print(f"repro: {error}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        return 130


if __name__ == "__main__":
    sys.exit(main())
