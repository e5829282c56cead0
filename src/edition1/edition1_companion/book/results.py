"""What notebooks write: tables of numbers, and the rows of the scorecard that they regenerate.

Files hold results only, never a date, a commit or a path: two builds of the same sources are then identical,
and a difference means something.
"""

from __future__ import annotations

import math
import os
import re
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from edition1.errors import bad_input, require
from edition1.files import write_whole
from edition1_companion.book.project import find_project, runs_folder
from edition1_companion.book.published import (
    ROW_COLUMNS,
    RowKey,
    check_row,
    csv_text,
    read_published,
    row_key,
)

if TYPE_CHECKING:
    from pandas import DataFrame

DIGITS = 10
"""Significant digits of a number in a table."""

_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_-]*")
_DATE_OR_PATH = re.compile(r"\d{4}-\d{2}-\d{2}|^(/|~|[A-Za-z]:[\\/])")


def results_dir() -> Path:
    """Return the folder for the tables of the notebook that runs, absolute; it is created.

    The environment variable ``REPRO_RESULTS_DIR``, which ``repro run`` and the build set, else ``runs/``
    below the current folder: a notebook opened by hand never overwrites the book's results.
    """
    chosen = os.environ.get("REPRO_RESULTS_DIR", "")
    folder = Path(chosen).expanduser().absolute() if chosen else runs_folder()
    folder.mkdir(parents=True, exist_ok=True)
    return folder


def write_table(table: DataFrame, name: str) -> None:
    """Write a table of results as ``<name>.csv`` in :func:`results_dir`.

    Numbers have 10 significant digits; a missing one is an empty cell. Nothing is returned, so that a cell that
    ends in a call shows no path.

    Parameters
    ----------
    table
        Numbers, truth values and short labels; column names end in their unit. Row numbers are not written.
    name
        Name of the file without its ending: letters, digits, ``_`` and ``-``.

    Raises
    ------
    InputError
        If the name is not one, the index is more than row numbers, a column occurs twice, or a cell holds
        something else (dates and absolute paths included).
    """
    from pandas import api

    _check_name(name)
    # Whole numbers without a name are what is left of row numbers after a selection.
    if table.index.name is not None or not api.types.is_integer_dtype(table.index.dtype):
        raise bad_input(
            "index", f"table {name}", "row numbers without a name (see reset_index)", list(table.index)
        )
    if not table.columns.is_unique:
        raise bad_input("columns", f"table {name}", "different from one another", list(table.columns))
    for column in table.columns:
        values = table[column]
        if api.types.is_numeric_dtype(values.dtype) and not api.types.is_complex_dtype(values.dtype):
            continue
        for value in values:
            _check_label(value, f"column {column} of table {name}")
    text = table.to_csv(index=False, float_format=f"%.{DIGITS}g", lineterminator="\n")
    write_whole(results_dir() / f"{name}.csv", text)


def read_table(name: str) -> DataFrame:
    """Read a table that this notebook wrote with :func:`write_table`: figures are drawn from what was written.

    Parameters
    ----------
    name
        Name of the file without its ending.

    Raises
    ------
    InputError
        If there is no such table.
    """
    from pandas import read_csv

    path = results_dir() / f"{name}.csv"
    require(path.is_file(), "name", "read_table", "a table that this notebook has written", name)
    return read_csv(path)


def _check_name(name: str) -> None:
    if not _NAME.fullmatch(name) or name == "scorecard":
        raise bad_input("name", "a table", "letters, digits, _ and -, and not scorecard", name)


def _check_label(value: Any, owner: str) -> None:
    if not isinstance(value, str) or _DATE_OR_PATH.search(value):
        raise bad_input("value", owner, "a number or a label without date or absolute path", value)


def write_scorecard_rows(rows: Iterable[Mapping[str, Any]], name: str) -> None:
    """Write the published numbers that a notebook regenerated, as ``<name>.rows.csv`` in :func:`results_dir`.

    Parameters
    ----------
    rows
        One mapping per number: ``paper, artefact, row, quantity, unit`` (a row of ``published.csv``),
        ``regenerated`` (by the paper's own method, in the row's unit) and ``setting`` are needed;
        ``regenerated_std``, ``n_seeds``, ``best`` with ``best_method`` (an improvement), ``note`` and
        ``comparable`` (True unless said otherwise) may be left out.
    name
        Name of the file without its endings.

    Raises
    ------
    InputError
        If a row is not in ``published.csv``, occurs twice, has an unknown column or a wrong value.
    """
    _check_name(name)
    published = read_published(find_project().published)
    texts: dict[RowKey, dict[str, str]] = {}
    for row in rows:
        checked = check_row({column: _as_text(value) for column, value in row.items()}, name, published)
        key = row_key(checked)
        require(key not in texts, "row", name, "given once", str(key))
        texts[key] = checked
    write_whole(results_dir() / f"{name}.rows.csv", csv_text(texts.values(), ROW_COLUMNS))


def _as_text(value: Any) -> str:
    if value is None:
        return ""
    if isinstance(value, str):
        return value
    if str(value) in ("True", "False"):
        return str(value).lower()
    number = float(value)
    return "" if math.isnan(number) else f"{number:.{DIGITS}g}"
