"""CSV tables of numbers, with times or without: what is wrong is said with file, line and column."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float

from edition1.errors import bad_input, require
from edition1.robot_file.columns import name_and_unit
from edition1_live.wire.csv_fields import SEPARATORS, time_scale

_LONGEST_S = 1e9


@dataclass(frozen=True)
class NumberTable:
    """Columns of numbers by their names, NaN for an empty cell, and the line of the file that each row stands in."""

    lines: list[int]
    columns: dict[str, Float[np.ndarray, " rows"]]

    def rows(self, names: Iterable[str]) -> Float[np.ndarray, "rows columns"]:
        """Return some of the columns, beside each other."""
        return np.column_stack([self.columns[name] for name in names])


def read_rows(path: Path) -> list[tuple[int, list[str]]]:
    """Read a CSV file as (number of the line, cells); without empty lines and comments (``#``).

    Raises
    ------
    InputError
        If there is no such file, or it is no text in UTF-8.
    """
    return _rows_of(path.name, _text_of(path), ",")


def _text_of(path: Path) -> str:
    require(path.is_file(), "path", path.name, "a CSV that is there", path)
    try:
        return path.read_text(encoding="utf-8-sig")
    except UnicodeDecodeError as error:
        raise bad_input("file", path.name, "a CSV in UTF-8", error) from error


def _rows_of(owner: str, text: str, separator: str) -> list[tuple[int, list[str]]]:
    rows = csv.reader(io.StringIO(text, newline=""), delimiter=separator)
    try:
        return [
            (rows.line_num, row) for row in rows if any(map(str.strip, row)) and not row[0].startswith("#")
        ]
    except csv.Error as error:
        raise bad_input("file", owner, "a CSV in UTF-8", error) from error


def read_numbers(path: Path) -> NumberTable:
    """Read a CSV of numbers with a header.

    Raises
    ------
    InputError
        If the file is no such table; the message names line and column.
    """
    return numbers_of(path.name, _text_of(path), ",")


def numbers_of(owner: str, text: str, separator: str) -> NumberTable:
    """Take a text as :func:`read_numbers` takes a file; the cells are apart by one of the known separators."""
    rows = _rows_of(owner, text, separator)
    head = [name.strip() for name in rows[0][1]] if rows else []
    require(
        head,
        "table",
        owner,
        f"a CSV of numbers with a header, separated by {SEPARATORS[separator]}",
        "nothing",
    )
    if twice := sorted({name for name in head if head.count(name) > 1}):
        raise bad_input("columns", owner, "of different names", f"{', '.join(twice)} twice")
    numbers = np.full((len(rows) - 1, len(head)), np.nan)
    for k, (line, row) in enumerate(rows[1:]):
        if len(row) != len(head):
            raise bad_input(f"line {line}", owner, f"of {len(head)} cells, as the header", len(row))
        for j, cell in enumerate(row):
            try:
                numbers[k, j] = float(cell) if cell.strip() else np.nan
            except ValueError:
                expected = f"a number (cells are separated by {SEPARATORS[separator]})"
                raise bad_input(f"{head[j]} in line {line}", owner, expected, repr(cell)) from None
    return NumberTable([line for line, _ in rows[1:]], dict(zip(head, numbers.T.copy(), strict=True)))


def check_columns(owner: str, wanted: Sequence[str], found: Sequence[str], times: str) -> None:
    """Refuse columns, those of times apart, that are not the ones wanted; the latter are said, and ``times``.

    Raises
    ------
    InputError
        If one is missing, or there is another.
    """
    names = ", ".join(wanted)
    if missing := [name for name in wanted if name not in found]:
        raise bad_input("columns", owner, names, f"none called {', '.join(missing)}")
    if unknown := [name for name in found if name not in wanted]:
        raise bad_input("columns", owner, f"{names} and {times}", f"also {', '.join(unknown)}")


def times_of(owner: str, table: NumberTable, *, apart: bool) -> tuple[str, Float[np.ndarray, " rows"]]:
    """Return the name of the column of times, such as ``time_s`` or ``time_ms``, and the times [s].

    Raises
    ------
    InputError
        If there is not one such column, or as :func:`check_times`.
    """
    scales = {name: time_scale(*name_and_unit(name)) for name in table.columns}
    found = {name: scale for name, scale in scales.items() if scale is not None}
    if len(found) != 1:
        received = f"{len(found)}: {', '.join(found)}" if found else f"none among {', '.join(table.columns)}"
        raise bad_input("times", owner, "one column, such as time_s", received)
    ((name, scale),) = found.items()
    require(scale, "times", owner, f"named with their unit, such as {name}_s or {name}_ms", name)
    time_s = table.columns[name] * (1e-6 * scale)
    check_times(owner, name, time_s, table.lines, apart=apart)
    return name, time_s


def check_times(
    owner: str, column: str, time_s: Float[np.ndarray, " rows"], lines: Sequence[int], *, apart: bool
) -> None:
    """Refuse no time, a missing one, and one before the one before; with ``apart`` also equal ones, and fewer than 3.

    Raises
    ------
    InputError
        As said.
    """
    if len(time_s) < (3 if apart else 1):
        raise bad_input("table", owner, "at least three rows" if apart else "at least one row", len(time_s))
    if not np.isfinite(time_s).all():
        line = lines[int(np.argmin(np.isfinite(time_s)))]
        raise bad_input(f"{column} in line {line}", owner, "a time", "an empty cell, or an infinite one")
    step_s = np.diff(time_s)
    if (late := np.flatnonzero(step_s <= 0 if apart else step_s < 0)).size:
        k = int(late[0]) + 1
        expected = f"{'after' if apart else 'not before'} the time before, {time_s[k - 1]:.6g} s"
        raise bad_input(f"{column} in line {lines[k]}", owner, expected, f"{time_s[k]:.6g} s")
    if time_s[-1] - time_s[0] > _LONGEST_S:
        expected = f"within {_LONGEST_S:g} s, 30 years"
        raise bad_input(column, owner, expected, f"{time_s[0]:g} to {time_s[-1]:g} s")


def whole_numbers(owner: str, table: NumberTable, name: str, end: int) -> list[int | None]:
    """Whole numbers of a column; none where it, or a number, is missing."""
    if name not in table.columns:
        return [None] * len(table.lines)
    column = table.columns[name]
    wrong = ~np.isnan(column) & ~((column >= 0) & (column < end) & (column % 1 == 0))
    if wrong.any():
        row = int(np.flatnonzero(wrong)[0])
        received = f"{column[row]:g} in line {table.lines[row]}"
        raise bad_input(name, owner, f"whole numbers from 0 to {end - 1}", received)
    return [None if np.isnan(x) else int(x) for x in column]
