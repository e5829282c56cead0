"""The numbers that the papers print, as text: what was printed tells how exact it is."""

from __future__ import annotations

import csv
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

from repro.errors import bad_input, require


class RowKey(NamedTuple):
    """What identifies a number of a paper."""

    paper: str
    artefact: str
    """Table, figure or section."""
    row: str
    quantity: str
    unit: str

    def __str__(self) -> str:
        return " / ".join(self)


@dataclass(frozen=True)
class Published:
    """A printed number; texts, so that trailing zeros count."""

    value: str
    std: str
    """Standard deviation, empty where none is printed."""


PUBLISHED_COLUMNS = (*RowKey._fields, "value", "std")


def read_published(path: Path) -> dict[RowKey, Published]:
    """Read the published numbers, in the order of the file.

    Parameters
    ----------
    path
        CSV file with the columns ``paper, artefact, row, quantity, unit, value, std``.

    Returns
    -------
    dict
        Key to printed value.

    Raises
    ------
    InputError
        If the file is missing, has other columns, a key twice, or a value that is not a number.
    """
    published: dict[RowKey, Published] = {}
    for row in read_csv(path, PUBLISHED_COLUMNS):
        key = row_key(row)
        require(key not in published, "row", path.name, "listed once", str(key))
        if not is_number(row["value"]) or (row["std"] and not is_number(row["std"])):
            raise bad_input("value", path.name, f"a number in row {key}", f"{row['value']}, {row['std']}")
        published[key] = Published(row["value"], row["std"])
    return published


def row_key(row: Mapping[str, str]) -> RowKey:
    """Return the key of a row of a CSV file."""
    return RowKey(*(row[name] for name in RowKey._fields))


def read_csv(path: Path, columns: Sequence[str]) -> list[dict[str, str]]:
    """Read a CSV file as texts.

    Parameters
    ----------
    path
        The file, UTF-8.
    columns
        The columns it must have, in this order.

    Returns
    -------
    list of dict
        One dictionary per line.

    Raises
    ------
    InputError
        If the file is missing, has other columns, or a line with more or fewer cells.
    """
    require(path.is_file(), "file", "the scorecard", "an existing CSV file", path)
    with path.open(encoding="utf-8", newline="") as stream:
        reader = csv.reader(stream)
        header = next(reader, [])
        require(header == list(columns), "columns", path.name, ", ".join(columns), ", ".join(header))
        rows = []
        for cells in reader:
            if len(cells) != len(header):
                raise bad_input(f"line {reader.line_num}", path.name, f"{len(header)} cells", f"{len(cells)}")
            rows.append(dict(zip(header, cells, strict=True)))
    return rows


def is_number(text: str) -> bool:
    """Return whether a text is a finite number."""
    try:
        return math.isfinite(float(text)) and "_" not in text
    except ValueError:
        return False
