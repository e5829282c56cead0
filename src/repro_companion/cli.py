"""The command ``repro``: what is rewritten is here, every other command is the first edition's."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from importlib.util import find_spec
from pathlib import Path

from edition1_companion.cli import app
from edition1_companion.cli import main as run_command

NEEDS = {
    "record export import emulate calibrate live track smooth fit": ["edition1"],
    "run sweep fetch": ["book", "edition1"],
}
"""The extras that commands need. A command that is not here runs with the required packages alone."""
PACKAGES = {
    "book": ["papermill", "nbformat", "ipykernel", "yaml", "joblib", "pooch", "requests"],
    "edition1": ["torch", "jaxtyping", "tqdm", "rosbags", "PIL", "serial", "cobs", "mcap"],
}
"""By these we see whether an extra is installed."""


def named(extras: Sequence[str]) -> str:
    """Return extras as a sentence names them."""
    return f"the extra{'s' if len(extras) > 1 else ''} " + " and ".join(f'"{extra}"' for extra in extras)


for names, extras in NEEDS.items():
    for name in names.split():
        app[name].group = f"Commands that need {named(extras)}"


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


def main() -> int:
    """Run the command line. Where an extra is missing, say in one line which, before anything else is asked for."""
    command = sys.argv[1] if len(sys.argv) > 1 else ""
    extras = next((extras for names, extras in NEEDS.items() if command in names.split()), [])
    missing = [extra for extra in extras if not all(map(find_spec, PACKAGES[extra]))]
    if not missing or {"--help", "-h"} & set(sys.argv):
        return run_command()
    brings = f'pip install "repro-soft-robots[{",".join(missing)}]"'
    print(f"repro {command} needs {named(missing)}: {brings}", file=sys.stderr)
    return 2


if __name__ == "__main__":
    sys.exit(main())
