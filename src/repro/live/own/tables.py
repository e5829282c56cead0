"""CSV tables of numbers with a time: read so that what is wrong is said with file, column and line."""

# pyright: reportArgumentType=false, reportCallIssue=false, reportAttributeAccessIssue=false

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np
import pandas as pd

from repro.errors import InputError, bad_input

TIME_COLUMNS = {"time_s": 1.0, "time_ms": 1e-3, "time_us": 1e-6}
"""Columns that hold times, and the factor to seconds."""


def table_error(path: Path, line: int, column: str, must_be: str, received: object) -> InputError:
    """Return the error for a cell of a table: file, line (from 1, the header among them) and column."""
    return bad_input(f"{column} in line {line}", path.name, must_be, received)


def read_rows(path: Path, what: str) -> list[tuple[int, list[str]]]:
    """Read a CSV file as (number of the line, cells); without empty lines and comments (``#``).

    Raises
    ------
    InputError
        If there is no such file, or it is no text in UTF-8.
    """
    if not path.is_file():
        raise bad_input(what, "repro fit", "a file that exists", path)
    try:
        with path.open(newline="", encoding="utf-8-sig") as stream:
            rows = csv.reader(stream)
            return [
                (rows.line_num, row)
                for row in rows
                if any(map(str.strip, row)) and not row[0].startswith("#")
            ]
    except (UnicodeDecodeError, csv.Error) as error:
        raise bad_input("file", path.name, "a CSV in UTF-8", error) from error


def read_timed(path: Path, what: str) -> tuple[np.ndarray, pd.DataFrame]:
    """Read a table with a time column: times [s], which increase, and the other columns.

    An empty cell is NaN.

    Parameters
    ----------
    path
        A CSV with a header: one of :data:`TIME_COLUMNS`, and columns of numbers.
    what
        What the table holds, for messages.

    Raises
    ------
    InputError
        If the file is no such table; the message names line and column.
    """
    rows = read_rows(path, what)
    head = [name.strip() for name in rows[0][1]] if rows else []
    times = [name for name in head if name in TIME_COLUMNS]
    if len(times) != 1:
        expected = f"a header with one of {', '.join(TIME_COLUMNS)} and comma-separated columns"
        raise bad_input("first line", path.name, expected, ", ".join(head) or "nothing")
    if twice := sorted({name for name in head if head.count(name) > 1}):
        raise bad_input("columns", path.name, "of different names", f"{', '.join(twice)} twice")
    numbers = np.full((len(rows) - 1, len(head)), np.nan)
    for k, (line, row) in enumerate(rows[1:]):
        if len(row) != len(head):
            raise bad_input(f"line {line}", path.name, f"of {len(head)} cells, as the header", len(row))
        for j, cell in enumerate(row):
            try:
                numbers[k, j] = float(cell) if cell.strip() else np.nan
            except ValueError:
                raise table_error(path, line, head[j], "a number", repr(cell)) from None
            if np.isinf(numbers[k, j]):
                raise table_error(path, line, head[j], "finite", cell.strip())
    time_s = numbers[:, head.index(times[0])] * TIME_COLUMNS[times[0]]
    check_times(path, times[0], time_s, [line for line, _ in rows[1:]])
    return time_s, pd.DataFrame(numbers, columns=head).drop(columns=times)


def check_times(path: Path, column: str, time_s: np.ndarray, lines: list[int]) -> None:
    """Refuse fewer than three times, a missing one, and one that is not after the one before.

    Raises
    ------
    InputError
        As said.
    """
    if len(time_s) < 3:
        raise bad_input("table", path.name, "at least three rows", len(time_s))
    if not np.isfinite(time_s).all():
        line = lines[int(np.argmin(np.isfinite(time_s)))]
        raise table_error(path, line, column, "a time", "an empty cell")
    late = np.flatnonzero(~(np.diff(time_s) > 0))
    if late.size:
        k = int(late[0]) + 1
        expected = f"after the time before, {time_s[k - 1]:.6g} s"
        raise table_error(path, lines[k], column, expected, f"{time_s[k]:.6g} s")
