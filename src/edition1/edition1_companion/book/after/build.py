"""Building the book: run the notebooks whose inputs changed, compute the scorecard, build the site.

``python -m edition1_companion.book.after.build`` is what ``make book`` runs. With nothing changed it only hashes.
"""

from __future__ import annotations

import hashlib
import json
import os
import sys
from collections.abc import Iterable, Sequence
from dataclasses import replace
from pathlib import Path

from edition1.errors import InputError, bad_input
from edition1.files import write_whole
from edition1_companion.book.after.paper_index import index_path, page_titles, read_index
from edition1_companion.book.after.site import SiteFailed, build_site
from edition1_companion.book.digests import combined_digest, write_if_changed
from edition1_companion.book.points import (
    BESIDE_OTHERS,
    Point,
    Stopped,
    environment_of_runs,
    finished,
    local_runner,
    run_points,
)
from edition1_companion.book.project import Project, find_project
from edition1_companion.book.provenance import (
    RECORD_SUFFIX,
    Inputs,
    notebook_key,
    read_inputs,
    read_record,
    record_path,
)
from edition1_companion.book.scorecard import ScorecardRow, compute_scorecard, scorecard_csv
from edition1_companion.book.termination import stop_on_termination


def build(project: Project, jobs: int) -> int:
    """Build the book of a project.

    Parameters
    ----------
    project
        What to build.
    jobs
        How many notebooks may run at once.

    Returns
    -------
    int
        0, or 1 where a notebook, the scorecard or the site failed.
    """
    notebooks = sorted(project.notebooks.glob("*.ipynb"))
    remove_leftovers(project, notebooks)
    inputs = read_inputs(project)
    pages = page_points(project, inputs)
    due = [page for page in pages if not finished(page)]
    # The tables of the papers take longest and come last in the alphabet: the others fill in beside them.
    if not run_pages(due[::-1], jobs) or not _tables_are_told_apart(project, notebooks):
        return 1
    if not _pages_are_quiet(due):
        return 1
    _remove_other_tables(project, pages)
    try:
        rows = compute_scorecard(project)
        write_if_changed(project.results / "scorecard.csv", scorecard_csv(rows))
        _write_scorecard_pages(project, rows, inputs)
        seconds = build_site(project)
    except (InputError, SiteFailed) as error:
        print(error, file=sys.stderr)
        return 1
    current = f"{len(notebooks) - len(due)} of {len(notebooks)} notebooks were up to date"
    print(f"{current}; the site {'was too' if seconds is None else f'was built in {seconds:.0f} s'}.")
    return 0


def _write_scorecard_pages(project: Project, rows: Sequence[ScorecardRow], inputs: Inputs) -> None:
    """Write what the site shows of the scorecard, unless all that it follows from is as it was."""
    numbers = hashlib.sha256(scorecard_csv(rows).encode()).hexdigest()
    titles = page_titles(project, read_index(index_path(project)))
    key = combined_digest([inputs.sources, inputs.data, titles, {"scorecard": numbers, "lock": inputs.lock}])
    done, last = project.cache / "scorecard", project.book / "generated" / "scorecard.json"
    if last.is_file() and done.is_file() and done.read_text(encoding="utf-8").strip() == key:
        return
    from edition1_companion.book.after.scorecard_files import (
        write_scorecard_files,  # draws: its import alone takes a second
    )

    write_scorecard_files(project, rows)
    write_whole(done, key + "\n")


def page_points(project: Project, inputs: Inputs) -> list[Point]:
    """Return the pages of a book as points: with the notebooks' own parameters, in the folders of the book."""
    # Partial notebooks go where readers look for runs, not where the site looks for pages.
    runs, environment = project.root / "runs", environment_of_runs("PYTHONPATH")
    return [
        Point(
            index=index,
            parameters={},
            key=notebook_key(notebook, {}, inputs, project),
            notebook=notebook,
            output=project.executed / notebook.name,
            results=project.results,
            failed=runs / f"{notebook.stem}.failed.ipynb",
            lock=project.cache / "locks" / notebook.stem,
            here=project.root,
            environment=environment,
            announced=True,
        )
        for index, notebook in enumerate(sorted(project.notebooks.glob("*.ipynb")))
    ]


def remove_leftovers(project: Project, notebooks: Iterable[Path]) -> None:
    """Remove pages and records of notebooks that are no longer there."""
    stems = {notebook.stem for notebook in notebooks}
    for page in project.executed.glob("[!.]*"):  # not those of a run that was killed: it will run again
        if page.name.removesuffix(RECORD_SUFFIX).removesuffix(".ipynb") not in stems:
            page.unlink()


def _remove_other_tables(project: Project, pages: Iterable[Point]) -> None:
    """Remove the tables that no page wrote: the committed ones would outlive their notebook."""
    records = (read_record(record_path(page.output)) for page in pages)
    written = {"scorecard.csv"}.union(*(record.results for record in records if record))
    for table in project.results.glob("*.csv"):
        if table.name not in written:
            table.unlink()


def _tables_are_told_apart(project: Project, notebooks: Iterable[Path]) -> bool:
    """Return whether no two notebooks wrote the same table; where two did, both count as not run."""
    writers: dict[str, list[str]] = {}
    for notebook in notebooks:
        record = read_record(record_path(project.executed / notebook.name))
        for name in record.results if record else ():
            writers.setdefault(name, []).append(notebook.stem)
    shared = {name: stems for name, stems in writers.items() if len(stems) > 1}
    for name, stems in shared.items():
        print(f"The table {name} is written by more than one notebook: {', '.join(stems)}.", file=sys.stderr)
        for stem in stems:
            record_path(project.executed / f"{stem}.ipynb").unlink(missing_ok=True)
    return not shared


def _pages_are_quiet(pages: Iterable[Point]) -> bool:
    """Return whether no page that was run shows a warning; one that does counts as not run."""
    quiet = True
    for page in pages:
        cells = json.loads(page.output.read_text(encoding="utf-8"))["cells"]
        outputs = [output for cell in cells for output in cell.get("outputs", [])]
        said = "".join("".join(output["text"]) for output in outputs if output.get("name") == "stderr")
        if said:
            print(f"{page.notebook.name} shows a warning: {said.strip()}", file=sys.stderr)
            record_path(page.output).unlink(missing_ok=True)
            quiet = False
    return quiet


def run_pages(pages: Sequence[Point], jobs: int) -> bool:
    """Run pages, several at once; a failure does not stop the others, and is printed when all have ended.

    Parameters
    ----------
    pages
        What to run, from :func:`page_points`.
    jobs
        How many may run at once.

    Returns
    -------
    bool
        Whether all succeeded.
    """
    if min(jobs, len(pages)) > 1:
        pages = [replace(page, environment=page.environment | BESIDE_OTHERS) for page in pages]
    failures = run_points(pages, local_runner(jobs)) if pages else {}
    for message in failures.values():
        print(message, file=sys.stderr)
    return not failures


def jobs_from_environment() -> int:
    """Return how many notebooks may run at once: the environment variable ``JOBS``, else one per core.

    Raises
    ------
    InputError
        If ``JOBS`` is no whole number of 1 or more.
    """
    chosen = os.environ.get("JOBS", "").strip()
    if not chosen:
        # Fewer than os.cpu_count() where a container or a batch system grants fewer.
        return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    if not chosen.isdecimal() or int(chosen) < 1:
        raise bad_input("JOBS", "the build", "a whole number of 1 or more", chosen)
    return int(chosen)


def main() -> int:
    """Build the book of the current project; return 0, 1 on failure or 2 for wrong input."""
    stop_on_termination()
    try:
        return build(find_project(), jobs_from_environment())
    except InputError as error:
        print(error, file=sys.stderr)
        return 2
    except Stopped as stop:
        return 143 if isinstance(stop.__cause__, SystemExit) else 130
    except KeyboardInterrupt:
        return 130


if __name__ == "__main__":
    sys.exit(main())
