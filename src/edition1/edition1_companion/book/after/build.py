"""Running the notebooks of the first edition whose inputs changed.

``repro_companion.build`` calls :func:`run`. With nothing changed it only hashes.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Sequence
from dataclasses import replace
from pathlib import Path

from edition1_companion.book.points import (
    BESIDE_OTHERS,
    Point,
    Stopped,
    environment_of_runs,
    finished,
    local_runner,
    run_points,
)
from edition1_companion.book.project import Project
from edition1_companion.book.provenance import Inputs, notebook_key, read_inputs, record_path


def run(root: Path, names: Sequence[str], jobs: int) -> tuple[int, list[str]]:
    """Run notebooks of a project that are due.

    Parameters
    ----------
    root
        Folder of the project.
    names
        Of the notebooks, without their ending.
    jobs
        How many may run at once.

    Returns
    -------
    count
        How many were run.
    failures
        Why some of them failed; one that shows a warning does.
    """
    project = Project(root)
    due = [page for page in page_points(project, read_inputs(project), names) if not finished(page)]
    # The tables of the papers take longest and come last in the alphabet: the others fill in beside them.
    try:
        failures = run_pages(due[::-1], jobs)
    except Stopped as stop:
        raise stop.__cause__ or stop from None
    return len(due), failures or warnings_shown(due)


def page_points(project: Project, inputs: Inputs, names: Iterable[str]) -> list[Point]:
    """Return pages of a book as points: with the notebooks' own parameters, in the folders of the book."""
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
        for index, notebook in enumerate(project.notebooks / f"{name}.ipynb" for name in sorted(names))
    ]


def warnings_shown(pages: Iterable[Point]) -> list[str]:
    """Return the warnings that pages which were run show; such a page counts as not run."""
    found = []
    for page in pages:
        cells = json.loads(page.output.read_text(encoding="utf-8"))["cells"]
        outputs = [output for cell in cells for output in cell.get("outputs", [])]
        said = "".join("".join(output["text"]) for output in outputs if output.get("name") == "stderr")
        if said:
            found.append(f"{page.notebook.name} shows a warning: {said.strip()}")
            record_path(page.output).unlink(missing_ok=True)
    return found


def run_pages(pages: Sequence[Point], jobs: int) -> list[str]:
    """Run pages, several at once; a failure does not stop the others.

    Parameters
    ----------
    pages
        What to run, from :func:`page_points`.
    jobs
        How many may run at once.

    Returns
    -------
    list of str
        Why pages failed.
    """
    if min(jobs, len(pages)) > 1:
        pages = [replace(page, environment=page.environment | BESIDE_OTHERS) for page in pages]
    return list(run_points(pages, local_runner(jobs)).values()) if pages else []
