"""The command ``repro``: what is rewritten is here, every other command is the first edition's."""

from __future__ import annotations

import sys
from pathlib import Path

from edition1_companion.cli import app, main

__all__ = ["main"]


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


if __name__ == "__main__":
    sys.exit(main())
