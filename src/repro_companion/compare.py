"""Compare tables of results: two folders, or ``results/`` with what is committed.

On one kind of processor the same sources give the same bytes. Another kind adds numbers in another order, so last
digits move, and more than these where a descent is chaotic. ``data/tolerances.csv`` says which cells move, how far
and why.
"""

from __future__ import annotations

import io
import json
import subprocess
import tempfile
import zipfile
from dataclasses import dataclass, field
from fnmatch import fnmatchcase
from pathlib import Path

import numpy as np
import pandas as pd
from pandas.api.types import is_bool_dtype, is_float_dtype, is_numeric_dtype

from repro.common import bad_input
from repro_companion.run import digest

REFERENCE = "# reference processor: "
"""How the first line of ``data/tolerances.csv`` begins; the name is LLVM's, which chooses the instructions."""
CRATE = "ro-crate-metadata.json"
"""What an archive of the project has in place of git: the hash of every table, and what wrote it."""

_UNPACK_AGAIN = (
    " On another kind of processor, unpack the archive a second time and name both folders, so that the tolerances "
    "count: repro compare SECOND/results results"
)


@dataclass
class Comparison:
    """What a comparison of two folders of tables found."""

    same: int = 0
    """Number of tables that are the same byte for byte."""
    close: int = 0
    """Number of tables whose cells differ, none by more than it may."""
    found: list[str] = field(default_factory=list)
    """One line for each table or column that differs by more than it may."""
    advice: str = ""
    """What to do about it."""

    def summary(self) -> str:
        """Return the counts in one line."""
        counts = [f"{self.same} the same byte for byte"]
        counts += [f"{self.close} within the tolerances of data/tolerances.csv"] if self.close else []
        n = len(self.found)
        counts += [f"{n} difference{'s' if n > 1 else ''}"] if n else []
        return ", ".join(counts) + "." + self.advice


def compare_folders(old: Path, new: Path, root: Path, *, exact: bool = False) -> Comparison:
    """Compare all tables of two folders.

    Parameters
    ----------
    old, new
        Folders with tables (``*.csv``).
    root
        The project, with ``data/tolerances.csv``.
    exact
        Whether every table must be the same byte for byte.

    Returns
    -------
    Comparison
        Counts, and what differs. ``scorecard.csv`` follows from the other tables: it is compared byte for byte or
        not at all.
    """
    tolerances = read_tolerances(root)
    result = Comparison()
    for name in sorted({path.name for folder in (old, new) for path in folder.glob("*.csv")}):
        missing = [folder for folder in (old, new) if not (folder / name).is_file()]
        if missing:
            result.found.append(f"{name} is missing in {missing[0]}")
        elif (old / name).read_bytes() == (new / name).read_bytes():
            result.same += 1
        elif exact:
            result.found.append(f"{name} is not the same byte for byte")
        elif name != "scorecard.csv":
            found = compare_tables(old / name, new / name, tolerances)
            result.close += not found
            result.found += found
    return result


def compare_tables(old: Path, new: Path, tolerances: pd.DataFrame) -> list[str]:
    """Return one line for each column of a table that differs by more than it may.

    Parameters
    ----------
    old, new
        The files.
    tolerances
        Columns ``table, row, column, tolerance, reason``; the last line whose patterns fit a cell counts. ``row`` is
        a pattern for the texts and whole numbers of a row, with blanks between them. A tolerance is in parts of the
        largest number of the column; 1 and more also lets words differ.
    """
    first, second = _read(old), _read(new)
    if set(first) != set(second):
        return [f"{old.name}: only one of the two has {', '.join(sorted(set(first) ^ set(second)))}"]
    keys = _keys(first, second)
    first, second = (_by_keys(table, keys) for table in (first, second))
    common = first.index.intersection(second.index, sort=False)
    lost = max(len(first), len(second)) - len(common)
    if lost:
        return [f"{old.name} has {lost} row{'s' * (lost > 1)} that only one of the two has"]
    first, second = first.loc[common], second.loc[common]
    rows, found = row_texts(first), []
    for column in first:
        most = allowed(rows, old.stem, str(column), tolerances)
        moved = _moved(first[column], second[column])
        if n := int((moved > most).sum()):
            worst = int(np.argmax(moved - most))
            found.append(
                f"{old.name}: {column} differs in {n} row{'s' * (n > 1)}, most where the row is"
                f" '{rows[worst]}': by {moved[worst]:.1e} of the column's largest; {most[worst]:.0e} is allowed"
            )
    return found


def read_tolerances(root: Path) -> pd.DataFrame:
    """Return the lines of ``data/tolerances.csv``."""
    path = root / "data" / "tolerances.csv"
    try:
        return pd.read_csv(path, comment="#", dtype={"tolerance": float})
    except ValueError as error:
        raise bad_input("file", str(path), "a table in UTF-8 with commas", error) from error


def row_texts(table: pd.DataFrame) -> list[str]:
    """Return the texts and whole numbers of each row, with blanks between them."""
    texts = table.columns[[not is_float_dtype(table[column]) for column in table]]
    return [" ".join(map(str, row)) for row in table[texts].itertuples(index=False)]


def allowed(rows: list[str], table: str, column: str, tolerances: pd.DataFrame) -> np.ndarray:
    """Return how far each cell of a column may move: as the last line says whose patterns fit."""
    most = np.zeros(len(rows))
    for line in tolerances.itertuples():
        if fnmatchcase(table, str(line.table)) and fnmatchcase(column, str(line.column)):
            most[[fnmatchcase(row, str(line.row)) for row in rows]] = line.tolerance
    return most


def compare_with_head(root: Path) -> Comparison:
    """Compare ``results/`` of a project with the tables that are committed.

    On the reference processor every byte must be the same, elsewhere the tolerances hold. An unpacked archive has no
    git but hashes in its crate: there every byte must be the same.

    Raises
    ------
    ValueError
        If the project is neither a checkout of git nor an archive.
    """
    if (root / CRATE).is_file() and not (root / ".git").exists():
        return compare_with_crate(root)
    done = subprocess.run(
        ["git", "-C", root, "archive", "--format=zip", "HEAD", "results"], capture_output=True, check=False
    )
    if done.returncode:
        raise ValueError(f"The committed tables cannot be read: {done.stderr.decode().strip()}")
    with tempfile.TemporaryDirectory() as folder:
        with zipfile.ZipFile(io.BytesIO(done.stdout)) as archive:
            archive.extractall(folder)
        committed = Path(folder) / "results"
        return compare_folders(committed, root / "results", root, exact=on_reference_processor(root))


def compare_with_crate(root: Path) -> Comparison:
    """Compare ``results/`` of an unpacked archive with the hashes that its crate lists."""
    parts = json.loads((root / CRATE).read_text(encoding="utf-8"))["@graph"]
    sealed = {part["@id"]: part["sha256"] for part in parts if "sha256" in part}
    here = {f"results/{path.name}": digest(path) for path in (root / "results").glob("*.csv")}
    result = Comparison()
    for name in sorted({*here, *(name for name in sealed if name.startswith("results/"))}):
        if here.get(name) == sealed.get(name):
            result.same += 1
        else:
            result.found.append(f"{name} is not the table of {CRATE}")
            result.advice = _UNPACK_AGAIN
    return result


def on_reference_processor(root: Path) -> bool:
    """Return whether this computer has the kind of processor on which the committed tables were computed."""
    from llvmlite.binding import get_host_cpu_name

    first = (root / "data" / "tolerances.csv").read_text(encoding="utf-8").partition("\n")[0]
    return first == f"{REFERENCE}{get_host_cpu_name()}"


def _read(path: Path) -> pd.DataFrame:
    try:
        return pd.read_csv(path, keep_default_na=False, na_values=[""])  # a label "None" is a label
    except pd.errors.EmptyDataError:
        return pd.DataFrame()
    except ValueError as error:
        raise bad_input("file", str(path), "a table in UTF-8 with commas", error) from error


def _keys(first: pd.DataFrame, second: pd.DataFrame) -> list[str]:
    """Return the first columns without fractions, as many as tell rows apart."""
    keys: list[str] = []
    for column in first:
        if is_float_dtype(first[column]) or is_float_dtype(second[column]):
            break
        keys.append(str(column))
        if not (first.duplicated(keys).any() or second.duplicated(keys).any()):
            break
    return keys


def _by_keys(table: pd.DataFrame, keys: list[str]) -> pd.DataFrame:
    """Return a table whose index is its keys and the place among rows of the same keys."""
    place = table.groupby(keys, dropna=False).cumcount() if keys else pd.Series(range(len(table)))
    return table.set_index(pd.MultiIndex.from_arrays([*(table[key] for key in keys), place]))


def _moved(first: pd.Series, second: pd.Series) -> np.ndarray:
    """Return how far each cell moved, in parts of the column's largest; 1 for a word, infinity for a lost number."""
    numbers = all(is_numeric_dtype(column) and not is_bool_dtype(column) for column in (first, second))
    if not numbers:
        return ((first != second) & ~(first.isna() & second.isna())).to_numpy(float)
    a, b = first.to_numpy(float), second.to_numpy(float)
    both = np.concatenate([a, b])
    largest = np.abs(both[np.isfinite(both)]).max(initial=0.0) or 1.0
    with np.errstate(invalid="ignore"):
        moved = np.where((a == b) | (np.isnan(a) & np.isnan(b)), 0.0, np.abs(a - b) / largest)
    return np.nan_to_num(moved, nan=np.inf)
