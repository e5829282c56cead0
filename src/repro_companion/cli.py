"""The command ``repro``: the commands of the book, beside those for a robot and a board of ``repro_board.cli``."""

from __future__ import annotations

import os
import sys
from importlib.util import find_spec
from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from repro_board.cli import BOOK, EXTRAS, Output, Whole, app, pairs, says_extras
from repro_board.cli import main as run_command
from repro_companion import run as tool
from repro_companion.papers import fetch as files

NEEDS = {
    "record": ["board"],
    "live": ["board"],
    "run": ["book"],
    "sweep": ["book", "cluster"],
    "fetch": ["book"],
}
"""The extras that commands need. A command that is not here runs with the required packages alone."""
Given = Annotated[list[tuple[str, str]] | None, pairs("-p", "--parameter")]


@app.command(group=BOOK, sort_key=1)
def run(
    notebook: Path | None = None,
    /,
    *,
    parameters: Given = None,
    output: Output = None,
    versions: Annotated[bool, Parameter(negative="")] = False,
) -> int:
    """Run a notebook with parameters: repro run NOTEBOOK [-p NAME VALUE ...] [-o OUT.ipynb].

    Parameters
    ----------
    notebook
        The notebook to run; it is not changed.
    parameters
        A parameter and its value, such as -p n_segments 3 or -p seeds "[0, 1]"; may be repeated.
    output
        The executed notebook. Its tables are written to the folder of the same name. By default it lies in runs/.
    versions
        Run nothing; print the versions of what computes.
    """
    if versions:
        lines = [f"{name} {version}" for name, version in tool.versions().items()]
        print(*lines, f"Recordings: {tool.recordings_folder()}", sep="\n")
        return 0
    if notebook is None:
        raise tool.bad_input("notebook", "repro run", "named", "none")
    root = tool.project_folder()
    values = tool.converted(tool.declared(notebook), parameters or [], notebook.name)
    key = tool.key_of(notebook, values, tool.inputs_of(root))
    output = output or Path("runs", f"{notebook.stem}-{key[:8]}.ipynb")
    tool.check_place(output, root, notebook)
    tool.stop_on_termination()
    try:
        record = tool.run(
            notebook, values, output, output.with_suffix(""), root=root, progress=sys.stderr.isatty()
        )
    except tool.RunFailed as failure:
        print(failure, file=sys.stderr)
        return 1
    tables = (output.with_suffix("") / name for name in record["results"])
    print(f"{output}  ({record['seconds']:.1f} s)", *tables, sep="\n")
    return 0


@app.command(group=BOOK, sort_key=2)
def sweep(
    notebook: Path,
    /,
    *,
    parameters: Given = None,
    jobs: Whole = 0,
    scheduler: str = "",
    output: Output = None,
) -> int:
    """Run a notebook for every combination of values: repro sweep NOTEBOOK -p bend_deg 30,60 -p n_segments 1:4.

    Combinations that have been run are not run again, so the same command goes on where it was stopped. Those that
    fail are named, and the others go on. A Dask scheduler runs any code that reaches it: use it in trusted networks
    or with TLS only.

    Parameters
    ----------
    notebook
        The notebook to run; it is not changed.
    parameters
        A parameter and its values: 2,3,6 or 0:10 (10 is not among them). A list as one value is written [0,1,2].
    jobs
        Runs at a time on this computer; by default one per core.
    scheduler
        Run on the workers of this Dask scheduler, such as tcp://host:8786. They need this checkout and its folders
        under the same path.
    output
        Folder of the runs and of the tables that join theirs; by default runs/NAME-sweep.
    """
    root = tool.project_folder()
    tool.require(jobs >= 0, "jobs", "repro sweep", "at least 1", jobs)
    grid = tool.grid_of(tool.declared(notebook), parameters or [], notebook.name)
    folder = output or Path("runs", f"{notebook.stem}-sweep")
    tool.check_place(folder, root)
    points = tool.points_of(notebook, grid, folder, root)
    failures = tool.sweep(points, jobs=jobs or os.cpu_count() or 1, scheduler=scheduler)
    print(*tool.joined(points, folder), sep="\n")
    for label, why in failures.items():
        print(f"{label}: {why}", file=sys.stderr)
    print(f"{len(points) - len(failures)} of {len(points)} points are finished.", file=sys.stderr)
    return 1 if failures else 0


@app.command(group=BOOK, sort_key=3)
def scorecard(*, require: Path | None = None, write_reference: Path | None = None) -> int:
    """Compare the book's results with every number of the papers; write results/scorecard.csv.

    Parameters
    ----------
    require
        A reference; exit with 1 if any verdict is not the one that it has, for the better or for the worse.
    write_reference
        Write today's verdicts as a reference to this file.
    """
    root = tool.project_folder()
    from repro_companion import scorecard as card
    from repro_companion.build import results_folder, write_scorecard

    path = results_folder(root) / "scorecard.csv"
    try:
        rows, *states = write_scorecard(root, path.parent)
        changed = card.changed(rows, require) if require else []
    except (ValueError, OSError) as error:
        raise tool.InputError(str(error)) from error
    print(f"{card.summary(*states)}\n\nAll rows: {tool.shown(path)}")
    if changed:
        print(f"Verdicts other than in {require}:", *changed, sep="\n  ", file=sys.stderr)
        return 1
    if write_reference:
        card.write(rows[[*card.KEY, "verdict"]], write_reference)
    return 0


@app.command(group=BOOK, sort_key=4)
def compare(old: Path | None = None, new: Path | None = None, /) -> int:
    """Compare tables of results: repro compare [OLD NEW]. Without folders, results/ with what is committed.

    On the processor that computed the committed tables they must be the same byte for byte. Elsewhere, and between
    two folders, cells may differ as far as data/tolerances.csv says. The exit status is 1 if a table differs more.
    An unpacked archive of `make artifact` has no git: there the tables must have the hashes of its crate.

    Parameters
    ----------
    old, new
        Folders with tables.
    """
    here = Path.cwd()
    root = next((f for f in (here, *here.parents) if (f / "data" / "tolerances.csv").is_file()), None)
    wrong = [str(folder) for folder in (old, new) if folder and not any(folder.glob("*.csv"))]
    if root is None or wrong or (old is None) != (new is None):
        said = f"there are no tables (*.csv) in {', '.join(wrong)}" if wrong else "give two folders, or none"
        said = said if root else "go to a checkout of the project: its data/tolerances.csv is needed"
        print(f"repro compare: {said}.", file=sys.stderr)
        return 2
    from repro_companion.compare import compare_folders, compare_with_head

    try:
        result = compare_folders(old, new, root) if old and new else compare_with_head(root)
    except ValueError as error:
        print(f"repro compare: {error}", file=sys.stderr)
        return 2
    print(*result.found, sep="\n", file=sys.stderr, end="\n" if result.found else "")
    print(f"Tables: {result.summary()}")
    return 1 if result.found else 0


@app.command(group=BOOK, sort_key=5)
def fetch(
    paper: str = "",
    /,
    *,
    page: str = "",
    mirror: Annotated[str, Parameter(env_var="REPRO_MIRROR")] = "",
    list_only: Annotated[bool, Parameter(name="--list", negative="")] = False,
) -> int:
    """Download the authors' public recordings that are not in REPRO_DATA_DIR yet; go on where it stopped.

    Parameters
    ----------
    paper
        One paper, such as mitchell2021; all by default.
    page
        Only what this page reads, such as table_2.
    mirror
        Download from MIRROR/PAPER/PATH, such as a folder of recordings served over HTTP, instead of GitHub.
    list_only
        Download nothing; print what there is, which page reads it and for what, how much of it is here, and where
        it comes from.
    """
    sources = files.read_sources(tool.project_folder() / "data" / "sources.json", paper, page)
    folder = tool.recordings_folder()
    if list_only:
        print(f"{files.listing(sources, folder)}\nFolder: {tool.shown(folder)}")
        return 0
    tool.stop_on_termination()
    said, complete = files.fetch(sources, folder, mirror, show=sys.stderr.isatty())
    print(said, file=sys.stdout if complete else sys.stderr)
    return 0 if complete else 1


def main() -> int:
    """Run the command line; where an extra is missing, say in one line which, before anything else is asked for."""
    words = sys.argv[1:]
    command = words[0] if words else ""
    missing = [extra for extra in NEEDS.get(command, ()) if not all(map(find_spec, EXTRAS[extra]))]
    if missing and not {"--help", "-h"} & set(words):
        return says_extras(f"repro {command}", missing)
    return run_command(words, app)


if __name__ == "__main__":
    sys.exit(main())
