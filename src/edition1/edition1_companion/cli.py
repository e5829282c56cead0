"""The command ``repro``: a thin list of commands.

Each imports what it needs when it runs, so that help is instant.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated

from cyclopts import App, CycloptsError, Parameter

from edition1.errors import InputError, bad_input
from edition1_companion import cli_calibrate, cli_live, cli_robot, cli_track
from edition1_companion.book.project import find_project, shown
from edition1_companion.cli_terminal import pairs

app = App(
    name="repro",
    help="Run notebooks of the companion with parameters of your own, and compare results with the papers.",
    version_flags=[],
    help_format="plaintext",
)

Given = Annotated[list[tuple[str, str]] | None, pairs(["-p", "--parameter"], "NAME VALUE")]
Output = Annotated[Path | None, Parameter(name=["-o", "--output"])]


@app.command
def run(
    notebook: Path | None = None,
    /,
    *,
    parameters: Given = None,
    output: Output = None,
    versions: Annotated[bool, Parameter(negative="")] = False,
) -> int:
    """Run a notebook: repro run NOTEBOOK [-p NAME VALUE ...] [-o OUT.ipynb].

    Parameters
    ----------
    notebook
        The notebook to run; it is not changed.
    parameters
        A parameter and its value, such as -p n_segments 3; may be repeated. Lists and dictionaries are YAML.
    output
        The executed notebook; tables are written beside it. By default a folder below runs/.
    versions
        Run nothing; print the versions of what computes, and where recordings are looked for.
    """
    if versions:
        from edition1_companion.book.provenance import version_lines

        print("\n".join(version_lines()))
        return 0
    if notebook is None:
        raise bad_input("notebook", "repro run", "named", "none")
    project = find_project()
    from edition1_companion.book.parameters import convert_all, declared_parameters
    from edition1_companion.book.provenance import notebook_key, read_inputs
    from edition1_companion.book.runner import (
        NotebookFailed,
        check_output,
        default_output,
        read_notebook,
        run_notebook,
    )
    from edition1_companion.book.termination import stop_on_termination

    stop_on_termination()
    declared = declared_parameters(read_notebook(notebook), notebook.name)
    values = convert_all(parameters or [], declared, notebook.name)
    if output is None:
        output = default_output(
            notebook, notebook_key(notebook, values, read_inputs(project), project), project
        )
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
    project = find_project()
    from edition1.files import write_whole
    from edition1_companion.book.scorecard import (
        REFERENCE_COLUMNS,
        changed_verdicts,
        compute_scorecard,
        scorecard_csv,
        summary,
    )

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
    listed = find_project().data / "sources.json"
    from edition1_companion.book.termination import stop_on_termination
    from edition1_companion.recordings.download import fetch as fetch_files
    from edition1_companion.recordings.download import listing
    from edition1_companion.recordings.sources import data_dir, read_sources

    stop_on_termination()
    folder = data_dir()
    files = read_sources(listed, [paper] if paper else [])
    if list_only:
        print(f"{listing(files, folder)}\nFolder: {shown(folder)}")
        return 0
    report = fetch_files(files, folder, mirror=mirror or None, progress=sys.stderr.isatty())
    print(report, file=sys.stderr if report.failed else sys.stdout)
    return 1 if report.failed else 0


for command in (
    cli_live.record,
    cli_live.export,
    cli_live.import_,
    cli_live.emulate,
    cli_calibrate.calibrate,
    cli_robot.live,
    cli_track.track,
    cli_track.smooth,
    cli_track.fit,
):
    app.command(command)


def main(commands: App = app) -> int:
    """Run the command line; return 0, 1 where a notebook or a comparison failed, or 2 for wrong input."""
    try:
        return commands(exit_on_error=False, print_error=False, result_action="return_value") or 0
    except (InputError, CycloptsError) as error:
        print(f"repro: {error}", file=sys.stderr)
        return 2
    except ModuleNotFoundError as missing:
        package = str(missing.name).partition(".")[0]
        if package.startswith(("repro", "edition1")):
            raise
        extras = "parquet" if package == "pyarrow" else "book,edition1"
        bring = f'pip install "repro-soft-robots[{extras}]" brings it'
        print(f"repro: This needs {package}, which is not installed: {bring}.", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        return 130
    except Exception as error:
        from edition1_live.record.recording_file import WriteFailed

        if not isinstance(error, (OSError, WriteFailed)):
            raise
        what = f"{error.filename}: {error.strerror}" if getattr(error, "filename", None) else error
        print(f"repro: A file cannot be read or written: {what}.", file=sys.stderr)
        return 1


if __name__ == "__main__":
    sys.exit(main())
