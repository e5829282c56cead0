"""A sweep: one run of a notebook for every point of a grid, in folders that are named by their keys."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from repro.errors import bad_input, require
from repro_companion.book.points import Point, environment_of_runs
from repro_companion.book.project import Project
from repro_companion.book.provenance import notebook_key, read_inputs
from repro_companion.book.sweep_grid import OWNER


def check_folder(folder: Path, project: Project) -> None:
    """Refuse a folder for a sweep that belongs to the book, or is a file.

    Raises
    ------
    InputError
        If it does.
    """
    if owner := project.owner_of(folder):
        raise bad_input("output", OWNER, f"outside {owner}/, which belongs to the book", folder)
    require(not folder.exists() or folder.is_dir(), "output", OWNER, "a folder", folder)


def plan(notebook: Path, grid: Sequence[Mapping[str, Any]], folder: Path, project: Project) -> list[Point]:
    """Return the points of a sweep, each with its key and its place ``points/<16 digits of the key>/``.

    Parameters
    ----------
    notebook
        What is run.
    grid
        Parameters of every point, from :func:`~repro_companion.book.sweep_grid.grid_points`.
    folder
        Of the sweep.
    project
        Whose package, data and lock the keys name.
    """
    inputs, here, environment = read_inputs(project), Path.cwd(), environment_of_runs()
    points = []
    for index, parameters in enumerate(grid):
        key = notebook_key(notebook, parameters, inputs, project)
        place = folder.absolute() / "points" / key[:16]
        points.append(
            Point(
                index=index,
                parameters=dict(parameters),
                key=key,
                notebook=notebook.absolute(),
                output=place / f"{notebook.stem}.ipynb",
                results=place,
                failed=place / f"{notebook.stem}.failed.ipynb",
                lock=place / ".lock",
                here=here,
                environment=environment,
            )
        )
    return points
