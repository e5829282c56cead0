"""The command ``repro diff``; registered by `repro_companion.cli`. It imports what it needs when it runs."""

from __future__ import annotations

from pathlib import Path


def diff(place: Path, /) -> int:
    """Compare a run with the book: repro diff runs/NAME-12345678. Writes NAME.diff.html beside the run.

    The page shows which parameters differ, tables side by side with absolute and relative differences, and figures
    side by side. A difference is no failure: the exit status is 0.

    Parameters
    ----------
    place
        The folder of a repro run, or its executed notebook.
    """
    from repro_companion.book.after.diff_page import write_diff
    from repro_companion.book.project import find_project, shown

    page, summary = write_diff(place, find_project())
    print(summary)
    print(f"The page: {shown(page)}")
    return 0
