"""Tables of readings and poses: text files, logs of boards and data frames, with names and units of their columns."""

from __future__ import annotations

import csv
import math
import re
from collections import Counter
from collections.abc import Sequence
from contextlib import suppress
from datetime import UTC, datetime
from difflib import get_close_matches
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from repro.common import Array, bad_input, printable, require
from repro.parts import Assembly, Sensor

_TO_MT = {"T": 1e3, "mT": 1.0, "uT": 1e-3, "nT": 1e-6, "G": 0.1, "gauss": 0.1, "mG": 1e-4}
SECONDS = {"s": 1.0, "sec": 1.0, "seconds": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9, "min": 60.0}
_SI = {"mm": 1e-3, "cm": 1e-2, "m": 1.0, "deg": math.pi / 180, "rad": 1.0}
_UNITS = {unit.lower(): unit for unit in (*_TO_MT, *_SI, "mV", "V", "raw")} | {"counts": "raw"}
_DATES = ("date", "datum")
TIMES = {
    "t": "", "time": "", "timestamp": "", "elapsed": "", "elapsed time": "", "seconds": "s", "sec": "s",
    "seconds_elapsed": "s", "millis": "ms", "milliseconds": "ms", "ms": "ms", "micros": "us", "microseconds": "us",
    "us": "us", **dict.fromkeys(_DATES, ""),
}  # fmt: skip
"""Names of a column of times, and the unit that a name says."""
_IN_BRACKETS = re.compile(r"(.*?)[ _]*[(\[] *(.*?) *[)\]]")
_DIGITS = re.compile(r"[-+.0-9eE]*")
_MISSING = re.compile(
    r"|nan|na|n/a|null|none|--?|ovf|-?1\.#\w+|#n/?[av]|##+|#[^\W\d][\w/]*[!?]", re.IGNORECASE
)
"""Also what a spreadsheet writes, in any language: #N/A, #NV, #DIV/0!, and ##### where a column is too narrow."""
_COMMENT = ("#", "%")
_NUMBER = re.compile(r"[+-]?(\d+[.,]?\d*|[.,]\d+)(e[+-]?\d+)?|[+-]?inf(inity)?", re.ASCII | re.IGNORECASE)
_UNNAMED = re.compile(r"column \d+")
_CLOCK = re.compile(r"(?=\d)(\d{4}-\d\d-\d\d)?[T ]?(\d\d:\d\d:\d\d\S*)?", re.ASCII)
_LABEL = re.compile(
    r"([^\W\d][\w./()\[\]]*) *[:=] *([+-]?[\d.]+(?:[eE][+-]?\d+)?(?=[^\W\d]*(?:[\s,;]|$))|[^\s,;:=]*)"
    r"(?: *([^\W\d]+)(?=[\s,;]|$))?[\s,;]*"
)
"""A label, its number and perhaps a unit, such as ``x: 1.5 uT``."""


class Readings(np.ndarray):
    """Readings ``[t, s]``.

    ``times`` are those of their rows [s], or None; ``lines`` say where they stand; ``remarks`` what is missing.
    Copies, parts and what is computed of every reading keep them. ``without_times`` says that it is not known any
    more which times the rows have, as when several readings are put together.
    """

    times: Array | None = None
    lines: Any = None
    remarks: tuple[str, ...] = ()
    without_times: bool = False

    def __array_finalize__(self, source: Any) -> None:
        """Take what is known of the rows of an array of the same shape."""
        if isinstance(source, Readings) and source.shape == self.shape:
            self.__dict__.update(source.__dict__)
        elif isinstance(source, Readings):
            self.without_times = source.without_times or source.times is not None

    def __getitem__(self, key: Any) -> Any:
        """Return a part; rows keep their times and lines."""
        found = super().__getitem__(key)
        if isinstance(found, Readings) and found.ndim == self.ndim > 1:
            rows = key[0] if isinstance(key, tuple) and key else key
            own = [None if x is None else x[rows] for x in (self.times, self.lines)]
            if all(x is None or x.shape == found.shape[:1] for x in own):
                (found.times, found.lines), found.without_times = own, self.without_times
        return found

    def __array_function__(self, function: Any, types: Any, args: Any, kwargs: Any) -> Any:
        """Let ``numpy.where``, ``numpy.concatenate`` and others return readings, too."""
        found = super().__array_function__(function, types, args, kwargs)
        if type(found) is np.ndarray and found.ndim > 1:
            found = found.view(Readings)
            found.__array_finalize__(self)
        return found

    def __reduce__(self) -> Any:
        """Return what is pickled."""
        make, args, state = super().__reduce__()
        return make, args, (state, self.__dict__)

    def __setstate__(self, state: Any) -> None:
        """Take what was pickled."""
        super().__setstate__(state[0])
        self.__dict__.update(state[1])


class Table(NamedTuple):
    """Numbers of a table, NaN where there is none, with the names and units of their columns.

    ``lines`` are the lines of a file, or the rows of a data frame from 1; times are in seconds. ``remarks`` say what
    was left out or put together.
    """

    owner: str
    columns: tuple[str, ...]
    names: tuple[str, ...]
    units: tuple[str, ...]
    values: Array
    lines: Sequence[int]
    times: Array | None
    remarks: tuple[str, ...] = ()

    def scaled(self, name: str, units: Sequence[str] = ("",)) -> tuple[Array, str]:
        """Return the column of a name in SI units, and its own unit; refuse other units than those named."""
        k = _column(self, name, name)
        unit, expected = self.units[k], " or ".join(units) or "no unit"
        require(unit in units, f"column {self.columns[k]}", self.owner, f"in {expected}", unit)
        return self.values[:, k] * _SI.get(unit, 1.0), unit


def name_and_unit(column: str) -> tuple[str, str]:
    """Split the name of a column from its unit.

    Examples
    --------
    >>> name_and_unit("Mag X (uT)"), name_and_unit("/board/u1_mT"), name_and_unit("time_ms"), name_and_unit("x_1")
    (('Mag X', 'uT'), ('u1', 'mT'), ('time', 'ms'), ('x_1', ''))
    """
    text = column.strip().replace("µ", "u").replace("μ", "u")
    text = text.rsplit("/", 1)[-1] if text.startswith("/") else text
    if found := _IN_BRACKETS.fullmatch(text):
        return found[1], _UNITS.get(found[2].lower(), found[2])
    name, _, unit = text.rpartition("_")
    if is_time(name) and unit.lower() in SECONDS:
        return name, unit.lower()
    if name and unit.lower() in _UNITS:
        return name, _UNITS[unit.lower()]
    return text, TIMES.get(text.lower(), "")


def is_time(name: str) -> bool:
    """Return whether a column of this name has times."""
    low = name.lower().strip("_ ")
    return name != "T" and (low in TIMES or low.startswith(("time", "zeit", "seconds")))  # T is a temperature


def read_table(source: Any, rate_hz: float | None = None) -> Table:
    """Read a data frame, or a text file: a table with a line of names, or what a board has printed.

    A file is in UTF-8 or UTF-16. Cells are separated by commas, semicolons, tabs or blanks, or have labels
    (``x: 1.5 uT y: 2``); decimal commas are read between semicolons and tabs. Above the numbers, lines that begin
    with ``#`` or ``%`` are comments, other text is left out, and a line of units below the names is read. Without
    names the columns are u1, u2 and so on. A first column without a name is an index and is left out; the index of a
    data frame is the time if it has moments or fractions, or is called so. Times are numbers or those of a clock;
    counters of 32 bits that start again from 0 are put on. Streams that take turns (a column ``stream``, or one
    number a line) are put together to one row for each turn.

    Parameters
    ----------
    source
        A data frame, a path, or a table that was read.
    rate_hz
        Rows per second, for a table without times.

    Raises
    ------
    InputError
        If it is not a table, a cell is no number, or times do not increase; with the file and the line.
    """
    if isinstance(source, Table):
        return source
    remarks: list[str] = []
    lines: Sequence[int]
    if isinstance(source, str | Path):
        owner = printable(Path(source).name)
        require(Path(source).is_file(), "table", "read_table", "a file that exists", source)
        header, split, values, lines = _file(text_of(Path(source), remarks), owner, remarks)
    else:
        owner, kind = "the table", type(source).__name__
        require(hasattr(source, "infer_objects"), "table", "read_table", "a data frame or a path", kind)
        frame = _with_times(source.infer_objects(), remarks)
        header, lines = [str(name) for name in frame.columns], range(1, len(frame) + 1)
        split = [name_and_unit(column) for column in header]
        for name, dtype in zip(header, frame.dtypes, strict=True):
            require(dtype.kind in "fiu", f"column {name}", owner, "of numbers", f"{dtype} values")
        values = frame.to_numpy(dtype=float, na_value=np.nan)
    require(len(values), "file", owner, "a line of names and lines of numbers", "0 lines of numbers")
    clock = [k for k, (name, _) in enumerate(split) if is_time(name)]
    times = _times(values, header, split, clock, lines, owner, remarks) if clock else None
    keep = [k for k, name in enumerate(header) if k not in clock and (k or name.strip())]
    columns, names, units = ([x[k] for k in keep] for x in (header, *map(list, zip(*split, strict=True))))
    infinite = np.isinf(values[:, keep])
    values = np.where(infinite, np.nan, values[:, keep])
    table = Table(owner, tuple(columns), tuple(names), tuple(units), values, lines, times)
    table = _put_together(table, remarks)
    times = table.times
    if times is not None:
        times = spread(times, table.lines, owner, remarks)
    elif rate_hz is not None:
        times = np.arange(len(table.values)) / rate_hz
    _count(int(infinite.sum()), infinite.size, f"numbers of {owner}", "missing: infinite", remarks)
    return table._replace(times=times, remarks=tuple(remarks))


def _with_times(frame: Any, remarks: list[str]) -> Any:
    """Return a data frame with its index as a column, if that has times and no column does.

    It has if it holds moments, or fractions, or its name says so; whole numbers without a name number the rows.
    """
    index = frame.index if frame.index.nlevels > 1 else frame.index.infer_objects()
    kind, name = index.dtype.kind, str(index.name or "time")
    says_so = kind in "iuf" and is_time(name_and_unit(name)[0]) and (index.name or kind == "f")
    clock = kind in "mM" or says_so
    if not clock or any(is_time(name_and_unit(str(column))[0]) for column in frame.columns):
        unused = clock or any(level is not None for level in index.names)
        remarks += ["The index of the table is left out."] * unused
        return frame
    if kind in "mM":
        index = index.tz_localize(None) if getattr(index, "tz", None) else index
        index, name = (index - index.dtype.type(0, "s")) / np.timedelta64(1, "s"), "time_s"
    return frame.assign(**{name: index})[[name, *frame.columns]]


def text_of(path: Path, remarks: list[str]) -> str:
    """Return the text of a file; other than UTF-8 and UTF-16 with a byte order mark it is told or refused."""
    content = path.read_bytes()
    marked = content[:2] in (b"\xff\xfe", b"\xfe\xff")
    try:
        if b"\0" in content[:1000] and not marked:
            words = "bytes that are zero (a binary file, or UTF-16 without a mark: save it as UTF-8)"
            raise bad_input("file", path.name, "text in UTF-8, or in UTF-16 with a byte order mark", words)
        return content.decode("utf-16" if marked else "utf-8-sig")
    except UnicodeDecodeError as error:
        line = content[: error.start].count(b"\n") + 1
        remarks.append(f"{path.name} is not in UTF-8 (line {line}): it is read as Windows-1252.")
        return content.decode("cp1252", errors="replace")


def _file(
    text: str, owner: str, remarks: list[str]
) -> tuple[list[str], list[tuple[str, str]], Array, list[int]]:
    """Return the columns, their names and units, the numbers, and their lines."""
    kept = [(k, _bare(line)) for k, line in enumerate(re.split(r"\r\n|\r|\n", text), start=1)]
    kept = [(k, line) for k, line in kept if line.strip() and not line.startswith("sep=")]
    plain = [line for _, line in kept if not line.startswith(_COMMENT)]
    require(plain, "file", owner, "a table", "nothing")
    if text[-1] not in "\r\n" and len(kept) > 2:
        parts = [re.split(r"[.,;:\s]+", line) for _, line in kept[-100:]]
        if {len(part[-1]) for part in parts[:-1] if len(part) == len(parts[-1])} != {len(parts[-1][-1])}:
            line, _ = kept.pop()
            remarks.append(
                f"Line {line} of {owner} does not end, and its last cell may be cut: it is left out."
            )
    marks = Counter(map(_separator, plain[:: 1 + len(plain) // 500]))
    separator, lines = marks.most_common(1)[0][0], [k for k, _ in kept]
    if separator == ":":
        rows, lines = _labelled(kept), [0, *lines]
    else:
        rows = [_cells(line, separator, owner) for _, line in kept]
    names, units, rows, lines = _named(rows, lines, separator, owner, remarks)
    header = [printable(name) for name in names or ()] or [f"column {k}" for k in range(1, len(rows[0]) + 1)]
    split = [name_and_unit(name) for name in header]
    if names is None:
        first = int(_CLOCK.fullmatch(rows[0][0]) is not None)
        split = [("time", "s")] * first + [(f"u{k}", "") for k in range(1, len(header) + 1 - first)]
        require(len(header) > first, "table", owner, "of times and numbers", "times alone")
        remarks.append(f"{owner} has no line of names: its columns are {split[first][0]} to {split[-1][0]}.")
    split = [
        (name, own or _UNITS.get(unit.lower(), unit) or ("s" if ":" in cell else ""))
        for (name, own), unit, cell in zip(split, units, rows[0], strict=True)
    ]
    at = [k for k, (name, _) in enumerate(split) if is_time(name)]
    comma = not any("." in cell and ":" not in cell for row in rows for cell in row)
    values = np.full((len(rows), len(header)), np.nan)
    for k, row in enumerate(rows):
        with suppress(ValueError):  # most rows are plain numbers, and this is four times as fast
            if _DIGITS.fullmatch("".join(row)):
                values[k] = [float(cell) for cell in row]
                continue
        for c, cell in enumerate(row):
            try:
                clock = c in at and _CLOCK.fullmatch(cell)
                values[k, c] = _seconds(cell) if clock else _number(cell.replace(",", ".") if comma else cell)
            except ValueError as error:
                where = f"{owner}, line {lines[k]}, column {header[c] or 'without a name'},"
                raise bad_input("cell", where, "a time" if c in at else "a number", repr(cell)) from error
    return header, split, values, lines


def _bare(line: str) -> str:
    """Return a line without what Python, JSON and plotters put around the numbers."""
    line = line.strip(" ").removeprefix(">")
    if line[:2] in ("b'", 'b"'):
        line = re.sub(r"(\\r)?(\\n)?['\"]$", "", line[2:])
    return line[1:-1] if line[:1] in ("(", "[", "{") and line[-1:] in (")", "]", "}") else line


def _separator(line: str) -> str:
    return ":" if _labels(line) else next((mark for mark in "\t;," if mark in line), " ")


def _labels(line: str) -> dict[str, str]:
    """Return the numbers in a line by their labels, with units; none if there is anything else in it."""
    stamp, arrow, rest = line.replace('"', "").rpartition(" -> ")
    found = [] if _LABEL.sub("", rest).strip() else _LABEL.findall(rest)
    named = {f"{name} [{unit}]" if unit else name: cell for name, cell, unit in found}
    return {"time": stamp, **named} if arrow and found else named


def _labelled(kept: list[tuple[int, str]]) -> list[list[str]]:
    """Return lines with labels as a table with names; a label that hardly any line has is none."""
    found = [(line, _labels(line)) for _, line in kept]
    times = Counter(name for _, labels in found for name in labels)
    names = [name for name, n in times.items() if n > len(kept) / 50]
    rows = [
        [row.get(name, "") for name in names] if row.keys() & {*names} else [line, ""] for line, row in found
    ]
    return [names, *rows]


def _cells(line: str, separator: str, owner: str) -> list[str]:
    stamp, arrow, line = line.rpartition(" -> ")
    try:
        by_mark = next(csv.reader([line], delimiter=separator, skipinitialspace=True))
    except csv.Error as error:
        raise bad_input("file", owner, "a table", error) from error
    found = line.split() if separator == " " else by_mark
    return [cell.strip() for cell in ([stamp, *found] if arrow else found)]


def _is_number(cell: str) -> bool:
    return any(kind.fullmatch(cell) for kind in (_NUMBER, _CLOCK, _MISSING))


def _is_comment(cell: str) -> bool:
    """Return whether a line that begins with this cell is a comment; a spreadsheet's #N/A is a missing number."""
    return cell.startswith(_COMMENT) and not _MISSING.fullmatch(cell)


def _filled(row: Sequence[str]) -> int:
    """Return the number of cells without the empty ones at the end."""
    n = len(row)
    while n and not row[n - 1]:
        n -= 1
    return n


def _named(
    rows: list[list[str]], lines: list[int], separator: str, owner: str, remarks: list[str]
) -> tuple[list[str] | None, list[str], list[list[str]], list[int]]:
    """Return names (None if there are none), units, cells and lines of a table; refuse lines of another form."""
    plain = [k for k, row in enumerate(rows) if not (row and _is_comment(row[0]))]
    width = Counter(len(rows[k]) for k in plain).most_common(1)[0][0]
    whole = (k for k, row in enumerate(rows) if len(row) == width and all(map(_is_number, row)) and any(row))
    first = next(whole, plain[0] + 1)
    above = [k for k in plain if k < first]
    rows, lines = [rows[k] for k in above] + rows[first:], [lines[k] for k in above] + lines[first:]
    first = j = len(above)
    names, units = None, []
    if j and any(rows[j - 1]) and {cell.lower() for cell in rows[j - 1]} <= {*_UNITS, *SECONDS, "", "-"}:
        j, units = j - 1, rows[j - 1]
    if j and (len(rows[j - 1]) > 1 or width == 1) and not all(map(_is_number, rows[j - 1])):
        j, names = j - 1, rows[j - 1]
        if any(re.fullmatch(r"[+-]?\d*[.,]\d+", cell) for cell in names):
            word = next(cell for cell in names if not _is_number(cell))
            raise bad_input(
                "cell", f"{owner}, line {lines[j]},", "a number, or all of them names", repr(word)
            )
    _count(j, len(rows), f"lines of {owner}", "above the table and left out", remarks)
    body = [
        k
        for k in range(first, len(rows))
        if not _is_comment(rows[k][0])
        and (any(map(_is_number, filter(None, rows[k]))) or (len(rows[k]) == width and rows[k] != names))
    ]
    _count(len(rows) - first - len(body), len(rows), f"lines of {owner}", "text and left out", remarks)
    require(body, "file", owner, "a line of names and lines of numbers", "0 lines of numbers")
    rows, lines = [rows[k] for k in body], [lines[k] for k in body]
    own, n = _filled(names or []), max(_filled(row) for row in [names or [], *rows])
    hint = "; decimal commas need another separator, such as ;"
    for line, row in zip(lines, rows, strict=True):
        if len(row) < n or (names and own < n):
            words = "as the line of names" + hint * (own < n) if names else "as the others"
            raise bad_input(f"line {line}", owner, f"of {own or n} cells, {words}", len(row))
    cells = [cell for row in rows for cell in row] if separator == "," and not names else []
    if any(re.fullmatch(r"0\d+", cell) for cell in cells) and not any("." in cell for cell in cells):
        raise bad_input("file", owner, f"of numbers with decimal points{hint}", "numbers such as 0123")
    return names and names[:n], [*units, *n * [""]][:n], [row[:n] for row in rows], lines


def _count(n: int, of: int, what: str, why: str, remarks: list[str]) -> None:
    """Add a remark if there are any."""
    if n:
        remarks.append(f"{n} of {of} {what} {'is' if n == 1 else 'are'} {why}.")


def _number(cell: str) -> float:
    if _MISSING.fullmatch(cell):
        return math.nan
    if "," in cell or not _NUMBER.fullmatch(cell):  # float would take digits of any script, and underscores
        raise ValueError(cell)
    return float(cell)


def _seconds(cell: str) -> float:
    """Return seconds since 1970, or since midnight if there is no date, by the clock that wrote them."""
    moment = datetime.fromisoformat(cell if "-" in cell[:5] else f"1970-01-01T{cell}")
    return moment.replace(tzinfo=UTC).timestamp()


def _times(
    values: Array,
    header: Sequence[str],
    split: Any,
    clock: list[int],
    lines: Sequence[int],
    owner: str,
    remarks: list[str],
) -> Array:
    """Return the times of the rows [s]."""
    days = [k for k in clock if split[k][0].lower() in _DATES]
    rest = [k for k in clock if k not in days] or days
    stated = [k for k in rest if split[k][1]] or rest
    k = stated[0]
    require(len(stated) == 1, f"column {header[stated[-1]]}", owner, "the only one of times", "another")
    if other := [header[c] for c in rest if c != k]:
        remarks.append(f"Column {', '.join(other)} of {owner} is left out: times are those of {header[k]}.")
    unit, name = split[k][1], f"column {header[k]}"
    require(unit in SECONDS or not unit, name, owner, "in s, ms, us, ns or min", unit)
    times = values[:, k] * SECONDS.get(unit, 1.0)
    bad = [lines[i] for i in np.flatnonzero(~np.isfinite(times)).tolist()]
    require(not bad, name, owner, "times", f"none in line {bad[:1]}")
    step = np.diff(times)
    usual = float(np.median(step)) if len(step) else 0.0
    require(unit or usual <= 1, name, owner, "named with its unit, such as time_ms", f"steps of {usual:g}")
    # A clock starts again at midnight, a counter of the board after 32 bits.
    ticks = 2**32 * SECONDS.get(unit, 1.0)
    period = ticks if unit in ("ms", "us") else 86400.0 if unit == "s" and times.max() < 86400 else math.inf
    if days != rest:
        times = times + values[:, days].sum(axis=1)
    if not days and (again := step < -period / 2).any():
        times[1:] += period * np.cumsum(again)
        line = list(lines)[int(again.argmax()) + 1]
        remarks.append(f"Times of {owner} start again from 0 in line {line}: they are put on.")
    return times


def spread(times: Array, lines: Sequence[int], owner: str, remarks: list[str]) -> Array:
    """Return times that increase: rows of one time are spread evenly, and a time that goes back is refused."""
    step = np.diff(times)
    for k in np.flatnonzero(step < 0).tolist():
        received = f"{times[k + 1]:.10g} s after {times[k]:.10g} s (did the board start again?)"
        raise bad_input(f"time in line {lines[k + 1]}", owner, "later than the one before", received)
    first = np.flatnonzero(np.r_[True, step > 0])
    if len(first) == len(times):
        return times
    n = len(times) - len(first)
    _count(n, len(times), f"times of {owner}", "equal to the one before: spread evenly", remarks)
    require(len(first) > 1, "times", owner, "more than one", f"{times[0]:g} s in every row")
    at, known = np.r_[first, 2 * first[-1] - first[-2]], times[first]
    return np.interp(np.arange(len(times)), at, np.r_[known, 2 * known[-1] - known[-2]])


def _put_together(table: Table, remarks: list[str]) -> Table:
    """Return one row for each turn of streams, or of columns of which every row has one."""
    values, names, times = table.values, list(table.names), table.times
    there = np.isfinite(values)
    # Boards print the number of an IMU, then its quaternion.
    headless = len(names) == 5 and table.columns[0] == "column 1"
    if headless and 0.9 < np.nanmedian(np.linalg.norm(values[:, 1:], axis=1)) < 1.1:
        names = ["stream", "qw", "qx", "qy", "qz"]
    if "stream" in names:
        own = [k for k, name in enumerate(names) if name != "stream"]
        streams, which = np.unique(values[:, names.index("stream")], return_inverse=True)
        short = [names[k] if len(names[k]) > 1 else f"q{names[k]}" for k in own]
        several, own_number = len(streams) > 1, ("qx", "qy", "qz", "qw")
        names = [
            f"{name}_{x:g}" if several or name in own_number else name for x in streams for name in short
        ]
        columns = names if several else short
        units, turn = [table.units[k] for k in own] * len(streams), values[:, own]
    elif len(values) >= 2 * len(names) > 2 and (there.sum(1) == 1).all():
        which, turn, columns, units = there.argmax(1), values[there][:, None], table.columns, table.units
    else:
        return table
    together = times is not None and len(times) > 1 and (np.diff(times) == 0).any()
    group, seen = np.zeros(len(values), dtype=int), set[int]()
    for i, key in enumerate(which.tolist()):
        new = i > 0 and (key in seen or (together and times is not None and times[i] != times[i - 1]))
        seen = {key} if new else seen | {key}
        group[i] = group[i - 1] + new if i else 0
    found = np.full((group[-1] + 1, len(names) // turn.shape[1], turn.shape[1]), np.nan)
    found[group, which] = turn
    if (n := len(values)) > len(found):
        remarks.append(f"{n} of {n} rows of {table.owner} are put together to {len(found)}.")
    last = np.flatnonzero(np.diff(group, append=-1)).tolist()
    return Table(
        table.owner, tuple(columns), tuple(names), tuple(units), found.reshape(len(found), -1),
        [table.lines[k] for k in last], None if times is None else times[last],
    )  # fmt: skip


class Columns(NamedTuple):
    """Which columns of a table have the magnetic readings of a robot, their factors to mT, and the quaternions."""

    magnetic: list[int]
    factors: Array
    quaternions: list[list[int]]


def read_readings(robot: Assembly, source: Any) -> Readings:
    """Return the readings of a table ``[t, s]`` for a robot: see :meth:`repro.Robot.readings`."""
    table = read_table(source)
    remarks, infinite = list(table.remarks), np.isinf(table.values)
    _count(int(infinite.sum()), infinite.size, f"numbers of {table.owner}", "missing: infinite", remarks)
    columns = columns_of(robot, table, remarks)
    check_orientations(robot, columns, table)
    u, why = rows_of(robot, columns, table.values)
    readings = u.view(Readings)
    readings.times, readings.lines = table.times, np.asarray(table.lines)
    readings.remarks = (*remarks, *losses(robot, why))
    return readings


def columns_of(robot: Assembly, table: Table, remarks: list[str]) -> Columns:
    """Return where the readings of a robot stand; refuse a table without one of them, or with one of them twice."""
    axes = [(sensor, k) for sensor in robot.sensors for k in range(sensor.axes)]
    unnamed = sum(map(bool, map(_UNNAMED.fullmatch, table.columns)))
    if unnamed and (unnamed < len(table.columns) or not robot.imus):
        words = f"{len(axes)} columns, one for every reading (a line of names above them says which is which)"
        require(unnamed == len(axes), "table", table.owner, words, f"{unnamed}")
    used, factors, bare, quaternions = [], [], [], []
    for j, (sensor, axis) in enumerate(axes):
        channel = j + 1 if sensor.channels is None else sensor.channels[axis]
        used.append(_column(table, channel, robot.names[j]))
        factors.append(_factor(table, used[-1], sensor))
        bare += [table.names[used[-1]]] if not table.units[used[-1]] and sensor.unit == "mT" else []
    if bare:
        remarks.append(f"Columns without a unit are taken as mT: {', '.join(bare)}.")
    for k, imu in enumerate(robot.imus, 1):
        names = k if imu.channels is None else imu.channels
        if isinstance(names, int | float):
            names = [f"q{axis}_{names:g}" for axis in "xyzw"]
        quaternions.append([_column(table, name, str(name)) for name in names])
    every = used + [k for own in quaternions for k in own]
    for column in {k for k in every if every.count(k) > 1}:
        received = f"{table.columns[column]} for {every.count(column)} of them"
        raise bad_input("channels", table.owner, "another column for every reading", received)
    return Columns(used, np.array(factors), quaternions)


def rows_of(robot: Assembly, columns: Columns, values: Array) -> tuple[Array, Array]:
    """Return the readings of rows ``[t, s]``, each by itself, and how many are there or missing for what reason.

    The counts ``[4, s]`` are in the order of :meth:`repro.Robot.missing`. Those of several blocks of rows add up.
    """
    with np.errstate(over="ignore"):
        parts = [values[:, columns.magnetic] * columns.factors]
    for imu, own in zip(robot.imus, columns.quaternions, strict=True):
        parts.append(_rotation_vectors(values[:, own], imu.world))
    u = np.concatenate(parts, axis=1)
    why = robot.missing(u)
    u[why > 0] = np.nan
    return u, (why == np.arange(4)[:, None, None]).sum(1)


def losses(robot: Assembly, counts: Array) -> list[str]:
    """Return a sentence for each kind of reading that is missing, by counts ``[4, s]``."""
    found, of, n = [], int(counts[:, :1].sum()), sum(sensor.axes for sensor in robot.sensors)
    _, nothing, at_end, all_zero = counts.tolist()
    for name, lost, beyond in zip(robot.names[:n], nothing, at_end, strict=False):
        _count(beyond, of, f"readings of {name}", "missing: at the end of its range", found)
        _count(lost, of, f"readings of {name}", "missing", found)
    _count(sum(all_zero[:1]), of, "rows", "missing: all readings are zero", found)
    for name, lost in zip(robot.part_names[len(robot.sensors) :], nothing[n::3], strict=True):
        _count(lost, of, f"quaternions of {name}", "missing: empty, zero or not of norm 1", found)
    return found


def check_orientations(robot: Assembly, columns: Columns, table: Table) -> None:
    """Refuse quaternions that are none, or whose numbers seem to be in another order."""
    from scipy.spatial.transform import Rotation

    for k, (imu, own) in enumerate(zip(robot.imus, columns.quaternions, strict=True)):
        q, name = table.values[:, own], f"quaternions of {robot.part_names[len(robot.sensors) + k]}"
        norm, there, off = _norms(q)
        if off.sum() > 0.01 * there.sum() + 2:
            typical, line = float(np.median(norm[off])), table.lines[int(off.argmax())]
            need = "of norm 1: divide raw counts by their scale"
            need = need if typical > 2 else "of norm 1, with four decimals"
            raise bad_input(name, table.owner, need, f"norms such as {typical:.5g}, from line {line}")
        good = q[there & ~off]
        if k or not len(good):
            continue
        drawn = Rotation.from_matrix(robot.poses(np.zeros(robot.n_q), [imu.place])[0, :3, :3])
        seen = (Rotation.from_quat([0, 0, 0, 1] if imu.world is None else imu.world) * drawn).as_quat()
        as_read, other = (
            2 * math.acos(min(1.0, float(np.median(np.abs(order @ seen)))))
            for order in (good, good[:, [1, 2, 3, 0]])
        )
        if as_read > 2.8 and other < as_read / 2:
            expected = "in the order x, y, z, w, of an IMU that is mounted as the robot file says"
            received = f"turns by {math.degrees(as_read):.0f} deg, and {math.degrees(other):.0f} with w first"
            raise bad_input(name, table.owner, expected, received)


def _column(table: Table, channel: Any, own: str) -> int:
    """Return the column of a channel: by its name, or by its number, or by the name of its reading."""
    wanted = (
        [channel]
        if isinstance(channel, str)
        else [f"{channel}", f"u{channel}", f"ch{channel}", f"channel{channel}"]
    )
    wanted = {own, own.replace(" ", ""), *wanted}
    spelt = [{name, re.sub("[ _]", "", name.lower())} for name in table.names]
    found = [k for k, names in enumerate(spelt) if wanted & {*names, table.columns[k]}]
    if len(found) != 1:
        words = channel if isinstance(channel, str) else f"u{channel}_mT, channel_{channel}, or {own}"
        low, word = {name.lower(): name for name in table.names}, str(channel).lower()
        near = [low[name] for name in get_close_matches(word, low, 1)]
        # Names that differ in one letter or digit are those of two readings, such as x_1 and y_1.
        near = [x for x in near if len(x) != len(word) or sum(map(str.__ne__, x.lower(), word)) != 1]
        words = f"one column for {own}: {words}" + (f" (is it {near[0]}?)" if near else "")
        received = [table.columns[k] for k in found] if found else f"none among {', '.join(table.columns)}"
        raise bad_input("columns", table.owner, words, received)
    return found[0]


def _factor(table: Table, column: int, sensor: Sensor) -> float:
    """Return what takes a column to mT."""
    unit = table.units[column]
    if unit in _TO_MT:
        return _TO_MT[unit]
    expected = "in mT or another unit of flux density"
    expected += "" if sensor.unit in _TO_MT else f", or in {sensor.unit}"
    own = unit in ("", sensor.unit) or (unit, sensor.unit) == ("V", "mV")
    require(own, f"column {table.columns[column]}", table.owner, expected, unit)
    return (1e3 if unit == "V" else 1.0) / sensor.per_mt


def _norms(q: Array) -> tuple[Array, Array, Array]:
    """Return the norms of quaternions, which of them are there, and which of these are of another norm than 1."""
    norm = np.linalg.norm(q, axis=-1)
    there = np.isfinite(norm) & (norm > 0)
    return norm, there, there & (np.abs(norm - 1) > 2e-3)


def _rotation_vectors(q: Array, world: Any) -> Array:
    """Return rotation vectors ``[t, 3]`` of quaternions XYZW in the base frame, NaN for those that are none."""
    from scipy.spatial.transform import Rotation

    _, there, off = _norms(q)
    base = Rotation.identity() if world is None else Rotation.from_quat(world).inv()
    turns = np.full((len(q), 3), np.nan)
    if (good := there & ~off).any():
        turns[good] = (base * Rotation.from_quat(q[good])).as_rotvec()
    return turns


def configurations_of(robot: Assembly, table: Table) -> Array:
    """Return the configurations ``[t, n_q]`` [m, rad] that the columns of a table state, NaN where one is missing."""
    q = np.zeros((len(table.values), robot.n_q))
    for c, name in enumerate(robot.coordinates):
        if name not in table.names and robot.fixed[c] and robot.lower is not None:
            q[:, c] = robot.lower[c]
            continue
        angle = robot.angles[c] or name.startswith("kappa")
        q[:, c], _ = table.scaled(name, ("rad", "deg") if angle else ("mm", "cm", "m"))
    return q


POSITION_FIRST = [4, 5, 6, 0, 1, 2, 3]
"""Order of the columns of a body with its position first, then its quaternion."""


def bodies_of(table: Table) -> dict[str, Array]:
    """Return the bodies of a table ``[t, 7]``, quaternion X, Y, Z, W and position [m]; markers have no quaternion.

    Body k has the columns ``x_k_mm, y_k_mm, z_k_mm`` (or ``_m``, ``_cm``) and the quaternion ``qx_k, qy_k, qz_k,
    qw_k``. Bodies are in the order of their numbers.

    Raises
    ------
    InputError
        If a column is missing.
    """
    found = sorted(
        {int(name.split("_")[1]) for name in table.names if re.fullmatch(r"q?[xyzw]_[0-9]+", name)}
    )
    require(found, "columns", table.owner, "x_1_mm, y_1_mm, z_1_mm and so on", ", ".join(table.columns))
    whole, bodies = any(name.startswith("qx_") for name in table.names), dict[str, Array]()
    for body in found:
        q = [
            table.scaled(f"q{axis}_{body}")[0] if whole else np.full(len(table.values), np.nan)
            for axis in "xyzw"
        ]
        p = [table.scaled(f"{axis}_{body}", ("mm", "cm", "m"))[0] for axis in "xyz"]
        bodies[str(body)] = np.stack([*q, *p], axis=1)
    return bodies
