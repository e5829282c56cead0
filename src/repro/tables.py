"""Tables of readings and poses: text files, logs of boards and data frames, with names and units of their columns."""

from __future__ import annotations

import csv
import math
import re
from collections import Counter
from collections.abc import Sequence
from datetime import date
from difflib import get_close_matches
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from repro.common import Array, bad_input, require
from repro.robot import Robot, Sensor

_TO_MT = {"T": 1e3, "mT": 1.0, "uT": 1e-3, "nT": 1e-6, "G": 0.1, "gauss": 0.1, "mG": 1e-4}
_SECONDS = {"s": 1.0, "sec": 1.0, "seconds": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9, "min": 60.0}
_SI = {"mm": 1e-3, "cm": 1e-2, "m": 1.0, "deg": math.pi / 180, "rad": 1.0}
_UNITS = {unit.lower(): unit for unit in (*_TO_MT, *_SI, "mV", "V", "raw")} | {"counts": "raw"}
_DATES = ("date", "datum")
_TIMES = ("t", "elapsed", "elapsed time", "millis", "micros", *_DATES)
_TIME_BEGINS = ("time", "zeit", "seconds")
_UNIT_BY_NAME = {"millis": "ms", "micros": "us", "seconds": "s", "seconds_elapsed": "s"}
_IN_BRACKETS = re.compile(r"(.*?)[ _]*[(\[] *(.*?) *[)\]]")
_MISSING = {
    "",
    "nan",
    "na",
    "n/a",
    "#n/a",
    "null",
    "none",
    "-",
    "--",
    "ovf",
    "1.#qnan",
    "-1.#qnan",
    "1.#ind",
    "-1.#ind",
}
_INFINITE = {"1.#inf", "-1.#inf"}
_NUMBER = re.compile(r"[+-]?(\d+[.,]?\d*|[.,]\d+)(e[+-]?\d+)?|[+-]?inf(inity)?", re.ASCII | re.IGNORECASE)
_CLOCK = re.compile(r"(?=\d)(\d{4}-\d\d-\d\d)?[T ]?(\d\d?:\d\d:\d\d(?:[.,]\d+)?)? *(?:Z|[+-]\d\d:?\d\d)?")
_LABEL = re.compile(r"([^\W\d][\w./()\[\]]*) *[:=] *([^\s,;:=]*)(?: *([^\W\d]\w*)(?=[\s,;]|$))?[\s,;]*")


class Readings(np.ndarray):
    """Readings ``[t, s]``.

    ``times`` are those of their rows [s], or None; ``lines`` say where they stand; ``remarks`` what is missing.
    """

    times: Array | None = None
    lines: Any = None
    remarks: tuple[str, ...] = ()

    def __getitem__(self, key: Any) -> Any:
        """Return a part; rows keep their times and lines."""
        found = super().__getitem__(key)
        if isinstance(found, Readings) and found.shape[1:] == self.shape[1:]:
            rows = key[0] if isinstance(key, tuple) else key
            found.times = None if self.times is None else self.times[rows]
            found.lines = None if self.lines is None else self.lines[rows]
        return found


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
    if _is_time(name) and unit.lower() in _SECONDS:
        return name, unit.lower()
    if name and unit.lower() in _UNITS:
        return name, _UNITS[unit.lower()]
    return text, _UNIT_BY_NAME.get(text.lower(), "")


def _is_time(name: str) -> bool:
    low = name.lower().strip("_ ")
    return low in _TIMES or low.startswith(_TIME_BEGINS)


def read_table(source: Any, rate_hz: float | None = None) -> Table:
    """Read a data frame, or a text file: a table with a line of names, or what a board has printed.

    A file is in UTF-8 or UTF-16. Cells are separated by commas, semicolons, tabs or blanks, or have labels
    (``x: 1.5 uT y: 2``); decimal commas are read between semicolons and tabs. Lines that begin with ``#`` or ``%``
    are comments, text above the names is left out, and a line of units below them is read. Without names the columns
    are u1, u2 and so on. A first column without a name is an index and is left out. Times are numbers or those of a
    clock; counters of 32 bits that start again from 0 are put on. Streams that take turns (a column ``stream``, or
    one number a line) are put together to one row for each turn.

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
        owner = Path(source).name
        require(Path(source).is_file(), "table", "read_table", "a file that exists", source)
        header, split, values, lines, decimals = _file(text_of(Path(source), remarks), owner, remarks)
    else:
        owner, kind, decimals = "the table", type(source).__name__, 9
        require(hasattr(source, "infer_objects"), "table", "read_table", "a data frame or a path", kind)
        frame = source.infer_objects()
        header, lines = [str(name) for name in frame.columns], range(1, len(frame) + 1)
        split = [name_and_unit(column) for column in header]
        for k, dtype in enumerate(frame.dtypes):
            if dtype.kind == "M" and _is_time(split[k][0]):
                ticks = frame.iloc[:, k].to_numpy("datetime64[ns]").astype(np.int64)
                frame, split[k] = frame.assign(**{header[k]: ticks / 1e9}), (split[k][0], "s")
            else:
                require(dtype.kind in "fiu", f"column {header[k]}", owner, "of numbers", f"{dtype} values")
        values = frame.to_numpy(dtype=float, na_value=np.nan)
    require(len(values), "file", owner, "a line of names and lines of numbers", "0 lines of numbers")
    if infinite := int(np.isinf(values).sum()):
        remarks.append(f"{infinite} numbers of {owner} are infinite: they are missing.")
        values = np.where(np.isinf(values), np.nan, values)
    clock = [k for k, (name, _) in enumerate(split) if _is_time(name)]
    times = _times(values, header, split, clock, lines, owner, remarks) if clock else None
    keep = [k for k, name in enumerate(header) if k not in clock and (k or name.strip())]
    columns, names, units = (
        [header[k] for k in keep],
        [split[k][0] for k in keep],
        [split[k][1] for k in keep],
    )
    table = Table(owner, tuple(columns), tuple(names), tuple(units), values[:, keep], lines, times)
    table, rows = _put_together(table), len(values)
    if len(table.values) < rows:
        remarks.append(f"{rows} rows of {owner} take turns: they are put together to {len(table.values)}.")
    times = table.times
    if times is not None:
        times = _increasing(times, decimals, table.lines, owner, remarks)
    elif rate_hz is not None:
        times = np.arange(len(table.values)) / rate_hz
    return table._replace(times=times, remarks=tuple(remarks))


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
) -> tuple[list[str], list[tuple[str, str]], Array, list[int], int]:
    """Return the columns, their names and units, the numbers, their lines, and the decimals of times."""
    kept = [(k, _bare(line)) for k, line in enumerate(re.split(r"\r\n|\r|\n", text), start=1)]
    kept = [(k, line) for k, line in kept if line.strip() and not line.startswith(("#", "%", "sep="))]
    require(kept, "file", owner, "a table", "nothing")
    if text[-1] not in "\r\n" and len(kept) > 2:
        parts = [re.split(r"[.,;:\s]+", line) for _, line in kept[-100:]]
        if {len(part[-1]) for part in parts[:-1] if len(part) == len(parts[-1])} != {len(parts[-1][-1])}:
            remarks.append(
                f"Line {kept.pop()[0]} of {owner} does not end, and its last cell may be cut: it is left out."
            )
    found = Counter(_separator(line) for _, line in kept[:: 1 + len(kept) // 500])
    separator = found.most_common(1)[0][0]
    lines = [k for k, _ in kept]
    if separator == ":":
        names, units, rows, lines = _labelled(kept, owner, remarks)
    else:
        rows = [_cells(line, separator, owner) for _, line in kept]
        names, units, rows, lines = _named(rows, lines, separator, owner, remarks)
    header = names or [f"column {k}" for k in range(1, len(rows[0]) + 1)]
    split = [name_and_unit(name) for name in header]
    if names is None:
        first = int(_CLOCK.fullmatch(rows[0][0]) is not None)
        split = [("time", "s")] * first + [(f"u{k}", "") for k in range(1, len(header) + 1 - first)]
        remarks.append(f"{owner} has no line of names: its columns are {split[first][0]} to {split[-1][0]}.")
    for k, unit in enumerate(units):
        clock = "s" if ":" in rows[0][k] else ""
        split[k] = split[k][0], split[k][1] or _UNITS.get(unit.lower(), unit) or clock
    at = [k for k, (name, _) in enumerate(split) if _is_time(name)]
    comma = not any("." in cell and ":" not in cell for row in rows for cell in row)
    values = np.full((len(rows), len(header)), np.nan)
    for k, row in enumerate(rows):
        for c, cell in enumerate(row):
            try:
                plain = cell.replace(",", ".", 1) if comma else cell
                values[k, c] = _seconds(cell) if c in at and _CLOCK.fullmatch(cell) else _number(plain)
            except ValueError as error:
                where = f"{owner}, line {lines[k]}, column {header[c] or 'without a name'},"
                raise bad_input("cell", where, "a number", repr(cell)) from error
    decimals = max((len(re.split("[.,]", row[k] + ".")[1]) for row in rows for k in at), default=9)
    return header, split, values, lines, decimals


def _bare(line: str) -> str:
    """Return a line without what Python, JSON and plotters put around the numbers."""
    line = line.strip(" ").removeprefix(">")
    if line[:2] in ("b'", 'b"'):
        line = re.sub(r"(\\r)?(\\n)?['\"]$", "", line[2:])
    return line[1:-1] if line[:1] in ("(", "[", "{") and line[-1:] in (")", "]", "}") else line


def _separator(line: str) -> str:
    if _labels(line):
        return ":"
    return next((mark for mark in "\t;," if mark in line), " ")


def _labels(line: str) -> list[tuple[str, str, str]]:
    """Return label, number and unit of everything in a line that consists of them; none in another one."""
    stamp, arrow, rest = line.replace('"', "").rpartition(" -> ")
    found = [] if _LABEL.sub("", rest).strip() else _LABEL.findall(rest)
    return [("time", stamp, "s"), *found] if arrow and found else found


def _labelled(kept: list[tuple[int, str]], owner: str, remarks: list[str]) -> tuple[Any, Any, Any, list[int]]:
    """Return names, units, cells and lines of lines with labels; what hardly any line has is no label."""
    found = [(k, _labels(line)) for k, line in kept]
    times = Counter(name for _, labels in found for name, *_ in labels)
    names = [name for name, n in times.items() if n > len(kept) / 50]
    units = {name: unit for _, labels in reversed(found) for name, _, unit in labels if unit}
    rows = [(k, {name: cell for name, cell, _ in labels}) for k, labels in found]
    rows = [(k, row) for k, row in rows if row.keys() & set(names)]
    _left_out(len(kept) - len(rows), owner, remarks)
    cells = [[row.get(name, "") for name in names] for _, row in rows]
    return names, [units.get(name, "") for name in names], cells, [k for k, _ in rows]


def _left_out(n: int, owner: str, remarks: list[str]) -> None:
    if n:
        remarks.append(f"{n} lines of {owner} hold text and no numbers: they are left out.")


def _cells(line: str, separator: str, owner: str) -> list[str]:
    stamp, arrow, line = line.rpartition(" -> ")
    try:
        found = (
            line.split()
            if separator == " "
            else next(csv.reader([line], delimiter=separator, skipinitialspace=True))
        )
    except csv.Error as error:
        raise bad_input("file", owner, "a table", error) from error
    return [cell.strip() for cell in ([stamp, *found] if arrow else found)]


def _is_number(cell: str) -> bool:
    found = _NUMBER.fullmatch(cell) or _CLOCK.fullmatch(cell) or cell.lower() in _MISSING | _INFINITE
    return bool(found)


def _filled(row: Sequence[str]) -> int:
    """Return the number of cells without the empty ones at the end."""
    return max((k for k, cell in enumerate(row, start=1) if cell), default=0)


def _named(
    rows: list[list[str]], lines: list[int], separator: str, owner: str, remarks: list[str]
) -> tuple[Any, ...]:
    """Return names (None if there are none), units, cells and lines of a table; refuse lines of another form."""
    width = Counter(len(row) for row in rows).most_common(1)[0][0]
    whole = [len(row) == width and all(map(_is_number, row)) and any(row) for row in rows]
    first = j = whole.index(True) if True in whole else min(1, len(rows))
    names, units = None, []
    if j and {cell.lower() for cell in rows[j - 1]} <= {*_UNITS, *_SECONDS, "", "-"} and any(rows[j - 1]):
        j, units = j - 1, rows[j - 1]
    if j and (len(rows[j - 1]) > 1 or width == 1) and not all(map(_is_number, rows[j - 1])):
        j, names = j - 1, rows[j - 1]
        words = [cell for cell in names if not _is_number(cell)]
        if any(re.fullmatch(r"[+-]?\d*[.,]\d+", cell) for cell in names):
            raise bad_input(
                "cell", f"{owner}, line {lines[j]},", "a number, or all of them names", repr(words[0])
            )
    if j:
        remarks.append(f"The first {j} lines of {owner} are no part of the table: they are left out.")
    body = [k for k in range(first, len(rows)) if any(map(_is_number, filter(None, rows[k]))) or (
        len(rows[k]) == width and rows[k] != names)]  # fmt: skip
    _left_out(len(rows) - first - len(body), owner, remarks)
    require(body, "file", owner, "a line of names and lines of numbers", "0 lines of numbers")
    rows, lines = [rows[k] for k in body], [lines[k] for k in body]
    cells = [cell for row in rows for cell in row]
    comma = any(re.fullmatch(r"0\d+", cell) for cell in cells) and not any("." in cell for cell in cells)
    hint = "; decimal commas need another separator, such as ;"
    n = max(map(_filled, rows))
    if names is not None:
        own = _filled(names)
        if own == n - 1 and all(row[0].strip('"').isdecimal() for row in rows) and _is_counter(rows):
            names = ["", *names]  # R leaves out the name of its index
        elif own < n:
            raise bad_input(
                f"line {lines[0]}", owner, f"of {own} cells, as the line of names{hint * comma}", n
            )
        n = max(n, own if all(len(row) >= own for row in rows) else 0)
    elif comma and separator == ",":
        raise bad_input("file", owner, f"of numbers with decimal points{hint}", "numbers such as 0123")
    for k, row in enumerate(rows):
        if len(row) < n or any(row[n:]):
            raise bad_input(f"line {lines[k]}", owner, f"of {n} cells, as the others{hint * comma}", len(row))
    return names and names[:n], (units + n * [""])[:n], [row[:n] for row in rows], lines


def _is_counter(rows: Sequence[Sequence[str]]) -> bool:
    first = int(rows[0][0])
    return [row[0] for row in rows] == [str(first + k) for k in range(len(rows))]


def _number(cell: str) -> float:
    if cell.lower() in _MISSING:
        return math.nan
    if cell.lower() in _INFINITE:
        return math.inf
    if not _NUMBER.fullmatch(cell):
        raise ValueError(cell)
    return float(cell)


def _seconds(cell: str) -> float:
    """Return seconds since 1970, or since midnight if there is no date, by the clock that wrote them."""
    found = _CLOCK.fullmatch(cell)
    day, clock = found.groups() if found else (None, None)
    days = date.fromisoformat(day).toordinal() - date(1970, 1, 1).toordinal() if day else 0
    hours, minutes, seconds = clock.replace(",", ".").split(":") if clock else (0, 0, 0)
    return 86400.0 * days + 3600 * int(hours) + 60 * int(minutes) + float(seconds)


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
    require(len(stated) == 1, f"column {header[stated[-1]]}", owner, "the only one of times", "another")
    k = stated[0]
    if other := [header[c] for c in rest if c != k]:
        remarks.append(f"Column {', '.join(other)} of {owner} is left out: times are those of {header[k]}.")
    unit = split[k][1]
    require(unit in _SECONDS or not unit, f"column {header[k]}", owner, "in s, ms, us, ns or min", unit)
    times = values[:, k] * _SECONDS.get(unit, 1.0)
    bad = [lines[i] for i in np.flatnonzero(np.isnan(times))]
    require(not bad, f"column {header[k]}", owner, "times", f"none in line {bad[:1]}")
    step = float(np.median(np.diff(times))) if len(times) > 1 else 0.0
    require(
        unit or step <= 1,
        f"column {header[k]}",
        owner,
        "named with its unit, such as time_ms",
        f"steps of {step:g}",
    )
    period = {"ms": 2**32 * 1e-3, "us": 2**32 * 1e-6, "s": 86400.0 if times.max() < 86400 else math.inf}.get(
        unit, math.inf
    )
    if days and days != rest:
        times = times + values[:, days[0]]
    elif (again := np.diff(times) < -period / 2).any():
        times[1:] += period * np.cumsum(again)
        remarks.append(
            f"Times of {owner} start again from 0 at line {lines[int(again.argmax()) + 1]}: they are put on."
        )
    return times


def _increasing(times: Array, decimals: int, lines: Sequence[int], owner: str, remarks: list[str]) -> Array:
    """Return times that increase; those that were rounded to equal ones are spread evenly, others are refused."""
    step = np.diff(times)
    for k in np.flatnonzero((step < 0) | ((step == 0) & (decimals > 2))) + 1:
        again = (
            "again (are rows there twice, or do times need more decimals?)" if step[k - 1] == 0 else "after"
        )
        received = (
            f"{times[k]:.10g} s {again} {times[k - 1]:.10g} s"
            if step[k - 1]
            else f"{times[k]:.10g} s {again}"
        )
        raise bad_input(f"time in line {lines[k]}", owner, "later than the one before", received)
    if not (step == 0).any():
        return times
    remarks.append(
        f"{int((step == 0).sum())} rows of {owner} have the time before them: they are spread evenly."
    )
    first = np.flatnonzero(np.r_[True, step > 0])
    require(len(first) > 1, "times", owner, "more than one", f"{times[0]:g} s in every row")
    known = times[first]
    return np.interp(
        np.arange(len(times)),
        np.r_[first, 2 * first[-1] - first[-2]],
        np.r_[known, 2 * known[-1] - known[-2]],
    )


def _put_together(table: Table) -> Table:
    """Return one row for each turn of streams, or of columns of which every row has one."""
    values, names = table.values, list(table.names)
    if len(names) == 5 and table.columns[0] == "column 1" and _are_quaternions(values[:, 1:]):
        names = [
            "stream",
            "qw",
            "qx",
            "qy",
            "qz",
        ]  # as boards print them: number of the IMU, then the quaternion
    there = np.isfinite(values)
    if "stream" in names:
        k = names.index("stream")
        turn, n = np.delete(values, k, axis=1), len(names) - 1
        streams, which = np.unique(values[:, k], return_inverse=True)
        labels = [
            (name if len(name) > 1 else f"q{name}", unit)
            for name, unit in zip(names, table.units, strict=True)
        ]
        del labels[k]
        names = [
            f"{name}_{stream:g}" if len(streams) > 1 else name for stream in streams for name, _ in labels
        ]
        columns, units = names, [unit for _ in streams for _, unit in labels]
    elif len(values) >= 2 * len(names) > 2 and (there.sum(1) == 1).all():
        which, n, turn = there.argmax(1), 1, values[there][:, None]
        columns, units = table.columns, table.units
    else:
        return table
    times, lines = table.times, table.lines
    together = times is not None and len(times) > 1 and (np.diff(times) == 0).any()
    group, seen = np.zeros(len(values), dtype=int), set[int]()
    for i, key in enumerate(which.tolist()):
        new = key in seen or (together and times is not None and i and times[i] != times[i - 1])
        seen = {key} if new else seen | {key}
        group[i] = group[i - 1] + new if i else 0
    found = np.full((group[-1] + 1, len(names) // n, n), np.nan)
    found[group, which] = turn
    last = np.flatnonzero(np.diff(group, append=group[-1] + 1))
    return Table(
        table.owner, tuple(columns), tuple(names), tuple(units), found.reshape(len(found), -1),
        [lines[k] for k in last], None if times is None else times[last],
    )  # fmt: skip


def _are_quaternions(q: Array) -> bool:
    return abs(float(np.nanmedian(np.linalg.norm(q, axis=1))) - 1) < 0.1


def read_readings(robot: Robot, source: Any) -> Readings:
    """Return the readings of a table ``[t, s]`` for a robot: see :meth:`repro.Robot.readings`."""
    table, used = read_table(source), []
    remarks, n_t = list(table.remarks), len(table.values)
    columns, axes = [np.zeros((n_t, 0))], [(x, k) for x in robot.sensors for k in range(x.axes)]
    if table.columns[:1] == ("column 1",) and not robot.imus:
        words = f"{len(axes)} columns, one for every reading (a line of names above them says which is which)"
        require(len(table.columns) == len(axes), "table", table.owner, words, f"{len(table.columns)}")
    bare = []
    for j, (sensor, axis) in enumerate(axes):
        channel = j + 1 if sensor.channels is None else sensor.channels[axis]
        used.append(_column(table, channel, robot.names[j]))
        bare += [table.columns[used[-1]]] if not table.units[used[-1]] and sensor.unit == "mT" else []
        u = table.values[:, used[-1]] * _factor(table, used[-1], sensor)
        beyond = np.abs(u) >= sensor.range
        _missing(beyond.sum(), n_t, f"readings of {robot.names[j]}", ": at the end of its range", remarks)
        _missing(np.isnan(u).sum(), n_t, f"readings of {robot.names[j]}", "", remarks)
        columns.append(np.where(beyond, np.nan, u)[:, None])
    if bare:
        remarks.append(f"Columns without a unit are taken as mT: {', '.join(bare)}.")
    u = np.concatenate(columns, axis=1)
    if u.shape[1] > 2 and 0 < (silent := (u == 0).all(axis=1)).sum() < n_t / 2:
        u[silent] = np.nan
        _missing(silent.sum(), n_t, "rows", ": all their readings are zero", remarks)
    columns = [u]
    for k, imu in enumerate(robot.imus):
        names = k + 1 if imu.channels is None else imu.channels
        if isinstance(names, int | float):
            names = [f"q{axis}_{names:g}" for axis in "xyzw"]
        used += (own := [_column(table, name, str(name)) for name in names])
        name = robot.part_names[len(robot.sensors) + k]
        columns.append(_rotation_vectors(table, table.values[:, own], imu.world, name, remarks))
    for column in {k for k in used if used.count(k) > 1}:
        received = f"{table.columns[column]} for {used.count(column)} of them"
        raise bad_input("channels", table.owner, "another column for every reading", received)
    readings = np.concatenate(columns, axis=1).view(Readings)
    readings.times, readings.lines, readings.remarks = table.times, np.asarray(table.lines), tuple(remarks)
    return readings


def _missing(n: int, of: int, what: str, why: str, remarks: list[str]) -> None:
    if n:
        remarks.append(f"{n} of {of} {what} are missing{why}.")


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
        low = {name.lower(): name for name in table.names}
        near = [low[name] for name in get_close_matches(str(channel).lower(), low, 1)]
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


def _rotation_vectors(table: Table, q: Array, world: Any, name: str, remarks: list[str]) -> Array:
    """Return rotation vectors ``[t, 3]`` of quaternions XYZW in the base frame, NaN for those that are none."""
    from scipy.spatial.transform import Rotation

    norm = np.linalg.norm(q, axis=-1)
    there = np.isfinite(norm) & (norm > 0)
    off = there & (np.abs(norm - 1) > 2e-3)
    if off.sum() > 0.01 * there.sum() + 2:
        typical, line = float(np.median(norm[off])), table.lines[int(off.argmax())]
        need = (
            "of norm 1: divide raw counts by their scale" if typical > 2 else "of norm 1, with four decimals"
        )
        raise bad_input(
            f"quaternions of {name}", table.owner, need, f"norms such as {typical:.5g}, from line {line}"
        )
    _missing(
        (~there | off).sum(), len(q), f"quaternions of {name}", ": empty, zero or not of norm 1", remarks
    )
    there &= ~off
    base = Rotation.identity() if world is None else Rotation.from_quat(world).inv()
    turns = np.full((len(q), 3), np.nan)
    turns[there] = (base * Rotation.from_quat(q[there])).as_rotvec()
    return turns


def read_configurations(robot: Robot, source: Any) -> tuple[Array, Array | None, list[str]]:
    """Return measured configurations ``[t, n_q]`` [m, rad] of a table, their times [s] or None, names of rows.

    Columns are named after the coordinates, with a unit: ``delta_x_1_mm``, ``phi_2_deg``. Coordinates that the robot
    fixes may be left out.

    Raises
    ------
    InputError
        If a column is missing or in no unit, or a number is missing; with the file and the line.
    """
    table = read_table(source)
    rows, q = [f"{table.owner}, line {line}" for line in table.lines], configurations_of(robot, table)
    for row, c in np.argwhere(np.isnan(q)):
        raise bad_input("pose", f"{rows[row]},", f"a number for {robot.coordinates[c]}", "none")
    return q, table.times, rows


def configurations_of(robot: Robot, table: Table) -> Array:
    """Return the configurations ``[t, n_q]`` [m, rad] that the columns of a table state, NaN where one is missing."""
    q = np.zeros((len(table.values), robot.n_q))
    for c, name in enumerate(robot.coordinates):
        if name not in table.names and robot.fixed[c] and robot.lower is not None:
            q[:, c] = robot.lower[c]
            continue
        angle = robot.angles[c] or name.startswith("kappa")
        q[:, c], _ = table.scaled(name, ("rad", "deg") if angle else ("mm", "cm", "m"))
    return q
