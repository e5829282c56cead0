"""A table of a run beside the same table of the book: rows that belong together, and how far numbers differ.

Tables of two machines may differ within tolerances. On one machine a table is the same byte for byte. Another
processor, BLAS or release of Python adds numbers in another order, and last digits move; where a descent is chaotic
or an arg-min is nearly a tie, more than those. Which columns move, how far and why stands in
``data/tolerances.csv``: measured, not guessed.
"""

from __future__ import annotations

from dataclasses import dataclass
from fnmatch import fnmatchcase
from pathlib import Path

import numpy as np
import pandas as pd
from edition1.errors import require
from pandas.api import types

OCCURRENCE = " row"
"""Column that tells rows with the same labels apart, by their order; no table of results has a name with a space."""


@dataclass(frozen=True)
class TableDifference:
    """How a table of a run differs from the book's."""

    name: str
    keys: list[str]
    """Columns by which rows were matched; empty where they were matched by their order."""
    book: pd.DataFrame
    """Matched rows of the book; index and columns are those of ``run``, a missing cell is NaN."""
    run: pd.DataFrame
    """Matched rows of the run."""
    only_book: pd.DataFrame
    """Rows that only the book has."""
    only_run: pd.DataFrame
    """Rows that only the run has."""
    other_columns: list[str]
    """Columns that only one of the two has."""

    @property
    def changed(self) -> list[str]:
        """Columns in which a matched row differs."""
        return [column for column in self.run if self.differs(column).any()]

    @property
    def identical(self) -> bool:
        """Whether the tables hold the same."""
        return not (self.changed or len(self.only_book) or len(self.only_run) or self.other_columns)

    def is_number(self, column: str) -> bool:
        """Return whether a column holds numbers in both tables."""
        return all(
            types.is_numeric_dtype(t[column]) and not types.is_bool_dtype(t[column])
            for t in (self.book, self.run)
        )

    def differs(self, column: str) -> pd.Series:
        """Return for each matched row whether a column differs; two missing cells are equal."""
        book, run = self.book[column], self.run[column]
        return (book != run) & ~(book.isna() & run.isna())

    def difference(self, column: str) -> pd.Series:
        """Return run less book of a column of numbers; equal infinities differ by nothing."""
        book, run = self.book[column].astype(float), self.run[column].astype(float)
        return (run - book).where(book != run, 0.0).where(~(book.isna() | run.isna()))

    def relative(self, column: str) -> pd.Series:
        """Return the difference in units of the book's value; missing where that is 0, unless both are."""
        book, difference = self.book[column].astype(float).abs(), self.difference(column)
        ratio = difference / book.where((book > 0) & np.isfinite(book))
        return ratio.where(difference != 0, 0.0).where(difference.notna())


def compare_tables(name: str, book: pd.DataFrame, run: pd.DataFrame) -> TableDifference:
    """Match the rows of two tables and return how they differ.

    Parameters
    ----------
    name
        Name of the table.
    book, run
        The tables. Rows are matched by the first columns that tell them apart and hold no fractions (labels, seeds,
        numbers of segments), else by ``time_s`` or the first column if it rises from row to row, else by their order.
    """
    keys = _keys(book, run)
    shared = [column for column in book if column in run]
    numbered_book, numbered_run = (_numbered(table, keys) for table in (book, run))
    index = [*keys, OCCURRENCE]
    by_book, by_run = numbered_book.set_index(index), numbered_run.set_index(index)
    common = by_book.index.intersection(by_run.index, sort=False)
    values = [column for column in shared if column not in keys]
    return TableDifference(
        name=name,
        keys=keys,
        book=by_book.loc[common, values],
        run=by_run.loc[common, values],
        only_book=book[~by_book.index.isin(common)],
        only_run=run[~by_run.index.isin(common)],
        other_columns=sorted(set(book) ^ set(run)),
    )


def _numbered(table: pd.DataFrame, keys: list[str]) -> pd.DataFrame:
    table = table.reset_index(drop=True)
    number = table.groupby(keys, dropna=False).cumcount() if keys else pd.Series(range(len(table)))
    return table.assign(**{OCCURRENCE: number})


def _keys(book: pd.DataFrame, run: pd.DataFrame) -> list[str]:
    keys: list[str] = []
    for column in book:
        kinds = [types.is_float_dtype(table[column]) for table in (book, run) if column in table]
        if len(kinds) < 2 or any(kinds):
            break
        # the same labels must not read as numbers in one table and as texts in the other
        if types.is_numeric_dtype(book[column]) != types.is_numeric_dtype(run[column]):
            break
        keys.append(str(column))
        if not any(table.duplicated(keys).any() for table in (book, run)):
            return keys
    if not keys:
        # a measured value that happens to be different in each row tells nothing; times and grids rise
        for column in ("time_s", *book.columns[:1]):
            if column in book and column in run and all(_rises(table[column]) for table in (book, run)):
                return [str(column)]
    return keys


def _rises(values: pd.Series) -> bool:
    return types.is_numeric_dtype(values) and values.is_monotonic_increasing and values.is_unique


def read_csv(path: Path) -> pd.DataFrame:
    """Read a table of results; an empty file is an empty table."""
    try:
        # a label such as "n/a" or "None" is a label
        return pd.read_csv(path, keep_default_na=False, na_values=[""])
    except pd.errors.EmptyDataError:
        return pd.DataFrame()


COLUMNS = ("table", "column", "tolerance", "reason")


@dataclass(frozen=True)
class Tolerance:
    """How far columns may move."""

    table: str
    """Name of a table without its ending, or a pattern with ``*``."""
    column: str
    """Name of a column, or a pattern with ``*``."""
    tolerance: float
    """Largest difference, in parts of the largest magnitude in that column; 1 lets words differ."""
    reason: str
    """Why it moves."""

    def holds_for(self, table: str, column: str) -> bool:
        """Return whether this is about a column."""
        return fnmatchcase(table, self.table) and fnmatchcase(column, self.column)


def read_tolerances(path: Path) -> list[Tolerance]:
    """Read ``data/tolerances.csv``; the last line that fits a column counts.

    Raises
    ------
    InputError
        If a column is missing, a tolerance is not a positive number, or a reason is empty.
    """
    table = pd.read_csv(path, dtype=str, keep_default_na=False)
    require(tuple(table) == COLUMNS, "header", path.name, ",".join(COLUMNS), ",".join(map(str, table)))
    tolerances = [
        Tolerance(name, column, float(pd.to_numeric(value, errors="coerce")), reason)
        for name, column, value, reason in table.itertuples(index=False)
    ]
    for line, (one, given) in enumerate(zip(tolerances, table["tolerance"], strict=True), 2):
        require(one.tolerance > 0, f"tolerance of line {line}", path.name, "a positive number", given)
        require(one.reason, f"reason of line {line}", path.name, "why the column moves", "nothing")
    return tolerances


def moved(difference: TableDifference, column: str) -> float:
    """Return how far a column of numbers moved, in parts of its largest magnitude; inf where a cell came or went."""
    book, run = (table[column].astype(float) for table in (difference.book, difference.run))
    if (book.isna() != run.isna()).any():
        return float("inf")
    off = difference.difference(column).abs().max()  # equal infinities differ by nothing
    largest = max(table.abs().where(np.isfinite(table), 0.0).max() for table in (book, run))
    return off and float(off / largest)


def beyond(first: Path, second: Path, tolerances: list[Tolerance]) -> list[str]:
    """Return one line for each column of a table that differs by more than it may.

    Parameters
    ----------
    first, second
        The table on the two machines.
    tolerances
        From :func:`read_tolerances`. Numbers of rows and names of columns must be the same.
    """
    difference = compare_tables(first.stem, read_csv(first), read_csv(second))
    rows = len(difference.only_book) + len(difference.only_run)
    found = [f"{first.name} has {rows} rows that only one of the two has"] if rows else []
    found += [f"{first.name}: only one of the two has {column}" for column in difference.other_columns]
    for column in difference.changed:
        allowed = [t.tolerance for t in tolerances if t.holds_for(first.stem, column)]
        if not difference.is_number(column):
            if not allowed or allowed[-1] < 1:
                found.append(f"{first.name}: {column} says something else")
            continue
        off = moved(difference, column)
        if off > (allowed[-1] if allowed else 0.0):
            found.append(
                f"{first.name}: {column} moved by {off:.1e} of its largest value; "
                + (f"{allowed[-1]:.0e} is allowed" if allowed else "none is allowed")
            )
    return found
