"""The command ``repro``: what is rewritten is here, every other command is the first edition's."""

from __future__ import annotations

import os
import sys
from collections.abc import Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import Annotated, Any

from cyclopts import App, Parameter, Token

from edition1_companion.cli import app as first_edition
from edition1_companion.cli import main as run_command
from repro_board import cli as board

NEEDS = {
    "record export import emulate calibrate live track smooth fit": ["edition1"],
    "run": ["book"],
    "sweep": ["book", "cluster"],
    "fetch": ["book", "edition1"],
}
"""The extras that commands need. A command that is not here runs with the required packages alone."""
PACKAGES = {
    "book": ["papermill", "nbformat", "ipykernel", "yaml", "joblib", "pooch", "requests"],
    "cluster": ["distributed"],
    "edition1": ["torch", "jaxtyping", "tqdm", "rosbags", "PIL", "serial", "cobs", "mcap"],
}
"""By these we see whether an extra is installed."""


def named(extras: Sequence[str]) -> str:
    """Return extras as a sentence names them."""
    return f"the extra{'s' if len(extras) > 1 else ''} " + " and ".join(f'"{extra}"' for extra in extras)


def _as_typed(_: Any, tokens: Sequence[Token]) -> list[tuple[str, str]]:
    """Return names and values as they were typed: a value may start with a hyphen or look like JSON."""
    words = [token.value for token in tokens]
    return list(zip(words[::2], words[1::2], strict=True))


NAME_AND_VALUE = Parameter(
    name=["-p", "--parameter"],
    metavar="NAME VALUE",
    allow_leading_hyphen=True,
    negative="",
    json_list=False,
    json_dict=False,
    converter=_as_typed,
)
Given = Annotated[list[tuple[str, str]] | None, NAME_AND_VALUE]
Output = Annotated[Path | None, Parameter(name=["-o", "--output"])]

app = App(name="repro", help=first_edition.help, version_flags=[], help_format="plaintext")
for name in " ".join(NEEDS).split():
    if name not in ("run", "sweep"):
        app.command(first_edition[name], name=name)


@app.command
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
    from repro_companion import run as tool

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


@app.command
def sweep(
    notebook: Path,
    /,
    *,
    parameters: Given = None,
    jobs: int = 0,
    scheduler: str = "",
    output: Output = None,
) -> int:
    """Run a notebook for every combination of values: repro sweep NOTEBOOK -p noise_mt 0,0.005 -p seeds 0:3.

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
    from repro_companion import run as tool

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
    from repro_companion import run as tool

    root = tool.project_folder()
    from repro_companion import scorecard as card
    from repro_companion.build import results_folder, write_scorecard

    path = results_folder(root) / "scorecard.csv"
    try:
        rows = write_scorecard(root, path.parent)
        changed = card.changed(rows, require) if require else []
    except (ValueError, OSError) as error:
        raise tool.InputError(str(error)) from error
    print(f"{card.counts(rows).to_string()}\n\nAll rows: {tool.shown(path)}")
    if changed:
        print(f"Verdicts other than in {require}:", *changed, sep="\n  ", file=sys.stderr)
        return 1
    if write_reference:
        card.write(rows[[*card.KEY, "verdict"]], write_reference)
    return 0


@app.command
def compare(old: Path | None = None, new: Path | None = None, /) -> int:
    """Compare tables of results: repro compare [OLD NEW]. Without folders, results/ with what is committed.

    On the processor that computed the committed tables they must be the same byte for byte. Elsewhere, and between
    two folders, cells may differ as far as data/tolerances.csv says. The exit status is 1 if a table differs more.

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
    print(f"Tables: {result.summary()}.")
    return 1 if result.found else 0


for name, words in board.COMMANDS.items():  # for the list of commands: they are run by their own module
    app.command(App(name=name, help=words))
for names, extras in NEEDS.items():
    for name in names.split():
        app[name].group = f"Commands that need {named(extras)}"


def main() -> int:
    """Run the command line. Where an extra is missing, say in one line which, before anything else is asked for."""
    words = sys.argv[1:]
    command = words[0] if words else ""
    if command in board.COMMANDS:
        return board.main(words)
    extras = next((extras for names, extras in NEEDS.items() if command in names.split()), [])
    missing = [extra for extra in extras if not all(map(find_spec, PACKAGES[extra]))]
    if missing and not {"--help", "-h"} & set(words):
        brings = f'pip install "repro-soft-robots[{",".join(missing)}]"'
        print(f"repro {command} needs {named(missing)}: {brings}", file=sys.stderr)
        return 2
    from repro_companion.run import InputError, is_first_edition

    notebook = next((Path(word) for word in words if word.endswith(".ipynb")), None)
    old = command == "run" and notebook is not None and is_first_edition(notebook)
    try:
        return run_command(first_edition if old else app)
    except (InputError, FileNotFoundError) as error:
        print(f"repro {command}: {error}", file=sys.stderr)
        return 2


if __name__ == "__main__":
    sys.exit(main())
