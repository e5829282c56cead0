"""The numbers that papers print, as text: that tells how exact they are; and what notebooks regenerate of them."""

from __future__ import annotations

import csv
import io
import math
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

from edition1.errors import bad_input, require


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


def csv_text(rows: Iterable[Mapping[str, Any]], columns: Sequence[str]) -> str:
    """Return rows as a CSV file with these columns; others are left out."""
    stream = io.StringIO()
    writer = csv.DictWriter(stream, columns, lineterminator="\n", extrasaction="ignore")
    writer.writeheader()
    writer.writerows(rows)
    return stream.getvalue()


def is_number(text: str) -> bool:
    """Return whether a text is a finite number."""
    try:
        return math.isfinite(float(text)) and "_" not in text
    except ValueError:
        return False


ROW_COLUMNS = (
    *RowKey._fields,
    "regenerated",
    "regenerated_std",
    "n_seeds",
    "setting",
    "best",
    "best_method",
    "note",
    "comparable",
)
"""Columns of a file of scorecard rows."""


def check_row(row: Mapping[str, str], owner: str, published: Mapping[RowKey, Published]) -> dict[str, str]:
    """Return a scorecard row with every column, or refuse it.

    Parameters
    ----------
    row
        Texts by column; columns that may be left out may be missing or empty.
    owner
        The file or notebook that it comes from, for messages.
    published
        The published numbers; the row must be one of them.

    Raises
    ------
    InputError
        As for :func:`write_scorecard_rows`.
    """
    unknown = [column for column in row if column not in ROW_COLUMNS]
    require(not unknown, "columns", owner, "among " + ", ".join(ROW_COLUMNS), ", ".join(unknown))
    full = {column: row.get(column, "") for column in ROW_COLUMNS}
    key = row_key(full)
    require(key in published, "row", owner, "a row of published.csv", str(key))

    full["comparable"] = full["comparable"] or "true"
    std, best = full["regenerated_std"], full["best"]
    for column, holds, must_be in (
        ("regenerated", is_number(full["regenerated"]), "a finite number"),
        (
            "regenerated_std",
            not std or (is_number(std) and float(std) >= 0),
            "a finite number of 0 or more, or left out",
        ),
        (
            "n_seeds",
            not full["n_seeds"] or re.fullmatch(r"[1-9]\d*", full["n_seeds"]),
            "a whole number of 1 or more, or left out",
        ),
        ("setting", full["setting"], "the setting under which the number was regenerated"),
        ("best", not best or is_number(best), "a finite number, or left out"),
        ("best_method", bool(best) == bool(full["best_method"]), "given exactly where best is"),
        ("comparable", full["comparable"] in ("true", "false"), "true or false"),
    ):
        require(holds, f"{column} of row {key}", owner, must_be, full[column] or "nothing")
    return full
