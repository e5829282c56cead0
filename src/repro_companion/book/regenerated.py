"""The numbers that notebooks regenerate: what a row must hold before the scorecard takes it."""

from __future__ import annotations

import re
from collections.abc import Mapping

from repro.errors import bad_input, require
from repro_companion.book.published import Published, RowKey, is_number, row_key

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

    def refuse(column: str, must_be: str) -> None:
        raise bad_input(f"{column} of row {key}", owner, must_be, full[column] or "nothing")

    if not is_number(full["regenerated"]):
        refuse("regenerated", "a finite number")
    std = full["regenerated_std"]
    if std and not (is_number(std) and float(std) >= 0):
        refuse("regenerated_std", "a finite number of 0 or more, or left out")
    if full["n_seeds"] and not re.fullmatch(r"[1-9]\d*", full["n_seeds"]):
        refuse("n_seeds", "a whole number of 1 or more, or left out")
    if not full["setting"]:
        refuse("setting", "the setting under which the number was regenerated")
    if full["best"] and not is_number(full["best"]):
        refuse("best", "a finite number, or left out")
    if bool(full["best"]) != bool(full["best_method"]):
        refuse("best_method", "given exactly where best is")
    full["comparable"] = full["comparable"] or "true"
    if full["comparable"] not in ("true", "false"):
        refuse("comparable", "true or false")
    return full
