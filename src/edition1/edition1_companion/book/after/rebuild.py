"""Whether results follow from the sources alone: all notebooks run again in a clean copy, and tables are compared.

``make reproduce`` runs this after ``make book``. With a folder, the tables of the book are compared with those in it,
such as ``results/`` of another commit, and nothing is run again; with two, these two. With
``--other-machine`` columns may differ by their tolerance: see :mod:`edition1_companion.book.after.diff_tables`.
"""

from __future__ import annotations

import shutil
import subprocess
import sys
from itertools import zip_longest
from pathlib import Path

from edition1.errors import InputError, bad_input, require

from edition1_companion.book.after.build import jobs_from_environment, page_points, run_pages
from edition1_companion.book.after.diff_tables import Tolerance, beyond, read_tolerances
from edition1_companion.book.points import Stopped, finished
from edition1_companion.book.project import Project, find_project
from edition1_companion.book.provenance import read_inputs
from edition1_companion.book.runner import changed_environment
from edition1_companion.book.termination import stop_on_termination

OTHER_MACHINE = "--other-machine"
SHOWN = 100
"""Characters of a line that are shown where two tables differ."""


def against(folder: Path, project: Project, tolerances: list[Tolerance] | None = None) -> list[str]:
    """Compare the tables of the book with those of a folder: one line for each that is not the same.

    With tolerances, one line for each column that differs by more than it may.

    Raises
    ------
    InputError
        If the book is not up to date, or the folder has no tables.
    """
    check_up_to_date(project)
    if not any(folder.glob("*.csv")):
        raise bad_input("AGAINST", "make reproduce", "a folder with tables of another build", folder)
    return differences(project.results, folder, tolerances)


def check_up_to_date(project: Project) -> None:
    """Refuse a book whose notebooks are to be run.

    Raises
    ------
    InputError
        If there is one.
    """
    pages = page_points(project, read_inputs(project))
    due = [page.notebook.stem for page in pages if not finished(page)]
    if due:
        raise bad_input(
            "results", "make reproduce", "up to date (run make book first)", f"{', '.join(due)} to run"
        )


def rebuild(project: Project, jobs: int) -> list[str]:
    """Run all notebooks of a project in a copy of its sources, and compare the tables that they write.

    The copy is ``.cache/again`` and stays there. It holds what git knows or does not ignore: no results, no caches.

    Parameters
    ----------
    project
        Whose book is built.
    jobs
        How many notebooks may run at once.

    Returns
    -------
    list of str
        One line for each table that is not the same, byte for byte; the copy's notebooks that failed say so
        themselves, and their tables are missing.

    Raises
    ------
    InputError
        If the book is not up to date, or the project is not a git checkout.
    """
    check_up_to_date(project)
    copy = Project(project.root / ".cache" / "again")
    copy_sources(project.root, copy.root)
    with changed_environment(
        {"PYTHONPATH": str(copy.root / "src" / "edition1")}
    ):  # the copy's own package, not the installed one
        run_pages(page_points(copy, read_inputs(copy)), jobs)
    return differences(project.results, copy.results)


def copy_sources(root: Path, copy: Path) -> None:
    """Copy what git knows or does not ignore to a folder, which is emptied first.

    Raises
    ------
    InputError
        If there is no git, or the folder is not a checkout.
    """
    command = ["git", "-C", str(root), "ls-files", "-z", "--cached", "--others", "--exclude-standard"]
    if not (root / ".git").exists() or shutil.which("git") is None:
        raise bad_input("project", "make reproduce", "a git checkout: git knows what are sources", root.name)
    listed = subprocess.run(command, capture_output=True, text=True, check=True).stdout
    shutil.rmtree(copy, ignore_errors=True)
    for name in filter(None, listed.split("\0")):
        if (root / name).is_file():  # not where a file was removed, but not from git yet
            (copy / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy2(root / name, copy / name)


def differences(first: Path, second: Path, tolerances: list[Tolerance] | None = None) -> list[str]:
    """Return one line for each ``.csv`` of two folders that is not the same in both, byte for byte.

    With tolerances, one for each of their columns that differs by more than it may. ``scorecard.csv`` is left out:
    the build makes it from the others.
    """
    names = {path.name for folder in (first, second) for path in folder.glob("*.csv")} - {"scorecard.csv"}
    found = []
    for name in sorted(names):
        missing = [folder for folder in (first, second) if not (folder / name).is_file()]
        if missing:
            found.append(f"{name} is missing in {missing[0]}")
            continue
        pair = [(folder / name).read_bytes() for folder in (first, second)]
        if pair[0] == pair[1]:
            continue
        if tolerances is not None:
            found += beyond(first / name, second / name, tolerances)
            continue
        lines = zip_longest(
            *(text.decode("utf-8", "replace").split("\n") for text in pair), fillvalue="(no line)"
        )
        number, (a, b) = next((k, both) for k, both in enumerate(lines, 1) if both[0] != both[1])
        found.append(f"{name} differs from line {number} on: {a[:SHOWN]} | {b[:SHOWN]}")
    return found


def main(*arguments: str) -> int:
    """Compare; return 0, 1 where a table differs, or 2 for wrong input."""
    stop_on_termination()
    given = [Path(folder) for folder in arguments if folder != OTHER_MACHINE]
    other = OTHER_MACHINE in arguments
    try:
        require(
            given or not other, "OTHER_MACHINE", "make reproduce", "given with AGAINST or STUDIES", "alone"
        )
        project = find_project()
        tolerances = read_tolerances(project.root / "data/tolerances.csv") if other else None
        if len(given) == 2:
            found = differences(given[0], given[1], tolerances)
        elif given:
            found = against(given[0], project, tolerances)
        else:
            found = rebuild(project, jobs_from_environment())
    except InputError as error:
        print(error, file=sys.stderr)
        return 2
    except (KeyboardInterrupt, Stopped):
        return 130
    for line in found:
        print(line, file=sys.stderr)
    if not found:
        count = len({path.name for path in (given or [project.results])[0].glob("*.csv")} - {"scorecard.csv"})
        how = "within the tolerances of data/tolerances.csv" if other else "byte for byte"
        print(f"All {count} tables are the same, {how}.")
    return 1 if found else 0


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))
