"""A sweep: a run of a notebook for every point of a grid, and the tables of the points, joined to tidy ones."""

from __future__ import annotations

import csv
import io
import json
import shlex
from collections.abc import Collection, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from edition1.errors import bad_input, require
from edition1.files import write_whole
from edition1_companion.book.parameters import Parameter
from edition1_companion.book.points import Point, environment_of_runs, finished
from edition1_companion.book.project import Project, shown
from edition1_companion.book.provenance import notebook_key, read_inputs
from edition1_companion.book.sweep_grid import OWNER, value_text


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
        Parameters of every point, from :func:`~edition1_companion.book.sweep_grid.grid_points`.
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


def write_sweep(
    folder: Path,
    name: str,
    notebook: Path,
    grid: Mapping[str, Sequence[Any]],
    points: Sequence[Point],
    failures: Collection[int],
    *,
    declared: Mapping[str, Parameter],
    chosen: str = "",
) -> tuple[list[Path], list[str]]:
    """Write the joined tables of a sweep and, as ``<name>.json``, what they belong to.

    The only table of a notebook, or the chosen one, becomes ``<name>.csv``; several become ``<name>_<table>.csv``.

    Parameters
    ----------
    folder
        Of the sweep.
    name
        Of the files, without ending.
    notebook
        What was run.
    grid
        Values of the parameters, from :func:`~edition1_companion.book.sweep_grid.read_grid`.
    points
        All points of this call.
    failures
        Indices of those without result.
    declared
        All parameters of the notebook: the defaults of those that are not swept are named.
    chosen
        See :func:`joined_tables`.

    Returns
    -------
    paths
        What was written.
    left_out
        See :func:`joined_tables`.
    """
    tables, left_out = joined_tables(tables_of(points), chosen)
    about = folder / f"{name}.json"
    names = {table: f"{name}.csv" if len(tables) == 1 else f"{name}_{table}.csv" for table in tables}
    for old in set(_tables_before(about)) - set(names.values()):
        (folder / old).unlink(missing_ok=True)
    for table, text in tables.items():
        write_whole(folder / names[table], text)
    settings = {
        "command": shown_command(shown(notebook), grid),
        "grid": dict(grid),
        "defaults": {name: one.default for name, one in declared.items() if name not in grid},
        "points": len(points),
        "failed": [point.parameters for point in points if point.index in failures],
        "tables": sorted(names.values()),
    }
    write_whole(about, json.dumps(settings, indent=1) + "\n")
    return [about, *(folder / file for file in settings["tables"])], left_out


def _tables_before(about: Path) -> list[str]:
    try:
        names = json.loads(about.read_text(encoding="utf-8"))["tables"]
    except (
        OSError,
        ValueError,
        LookupError,
        TypeError,
        RecursionError,
    ):  # none, or damaged: nothing is removed
        return []
    return names if isinstance(names, list) and all(isinstance(x, str) for x in names) else []


def joined_tables(
    results: Sequence[tuple[Mapping[str, Any], Sequence[Path]]], chosen: str = ""
) -> tuple[dict[str, str], list[str]]:
    """Join the tables of all points, one tidy table per name.

    Parameters
    ----------
    results
        For every finished point its parameters and the tables that it wrote. Rows keep this order.
    chosen
        Join only the table of this name (without ``.csv``); all when empty.

    Returns
    -------
    tables
        Name to text of the CSV: one column per parameter, then those of the table. A column of the table that has the
        name of a parameter is called ``table_<name>``. Numbers stand as the points wrote them.
    left_out
        Why a table could not be joined, one line each: it is missing in some points, or its columns differ.

    Raises
    ------
    InputError
        If no point wrote the chosen table.
    """
    by_name: dict[str, list[tuple[Mapping[str, Any], Path]]] = {}
    for parameters, paths in results:
        for path in paths:
            # rows of the scorecard belong to the book, not to points of a sweep
            if path.suffix == ".csv" and not path.name.endswith(".rows.csv"):
                by_name.setdefault(path.stem, []).append((parameters, path))
    if chosen and results and chosen not in by_name:
        names = ", ".join(sorted(by_name)) or "none"
        raise bad_input("table", OWNER, f"a table that the notebook writes ({names})", chosen)
    tables, left_out = {}, []
    for name, parts in sorted(by_name.items()):
        if chosen and name != chosen:
            continue
        contents = [_read(path) for _, path in parts]
        headers = {tuple(lines[0]) for lines in contents}
        if len(parts) < len(results):
            left_out.append(f"{name}: {len(results) - len(parts)} of {len(results)} points did not write it")
        elif len(headers) > 1:
            odd = sorted(set.union(*map(set, headers)) - set.intersection(*map(set, headers)))
            left_out.append(f"{name}: its columns differ between points ({', '.join(odd) or 'in order'})")
        else:
            tables[name] = _joined(
                [(point, lines) for (point, _), lines in zip(parts, contents, strict=True)]
            )
    return tables, left_out


def _read(path: Path) -> list[list[str]]:
    with path.open(encoding="utf-8", newline="") as stream:
        return list(csv.reader(stream)) or [[]]


def _joined(parts: Sequence[tuple[Mapping[str, Any], list[list[str]]]]) -> str:
    names = list(parts[0][0])
    columns = [f"table_{column}" if column in names else column for column in parts[0][1][0]]
    stream = io.StringIO()
    writer = csv.writer(stream, lineterminator="\n")
    writer.writerow([*names, *columns])
    for parameters, lines in parts:
        # a line of a table that is empty but for its end reads as no cells at all
        writer.writerows([*map(_cell, parameters.values()), *(line or [""])] for line in lines[1:])
    return stream.getvalue()


def _cell(value: Any) -> str:
    """Return a value as it stands in a table: as pandas writes numbers and truth values, lists as JSON."""
    if isinstance(value, (list, dict)):
        return json.dumps(value)
    return str(value)


def tables_of(points: Iterable[Point]) -> list[tuple[dict[str, Any], list[Path]]]:
    """Return parameters and tables of every finished point."""
    records = [(point, finished(point)) for point in points]
    return [
        (point.parameters, [point.output.parent / name for name in record.results])
        for point, record in records
        if record
    ]


def shown_command(notebook: str, grid: Mapping[str, Sequence[Any]]) -> str:
    """Return the command of a sweep as it could be typed; values that only a grid file can hold are named only."""
    words = ["repro", "sweep", notebook]
    for name, values in grid.items():
        texts = [value_text(value) for value in values]
        plain = not any(isinstance(x, (list, dict)) or (isinstance(x, str) and "," in x) for x in values)
        words += ["-p", name, ",".join(texts)] if plain else []
    filed = [name for name in grid if name not in words]
    return shlex.join(words) + (" --grid FILE" if filed else "")
