"""Tables: text files, logs of boards and data frames, with names and units of their columns."""

from __future__ import annotations

import csv
import math
import re
from collections import Counter
from collections.abc import Mapping, Sequence
from contextlib import suppress
from difflib import get_close_matches
from pathlib import Path
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np

from repro.common import Array, InputError, bad_input, printable, require, scalar
from repro.lines import (
    DATES,
    SECONDS,
    SI,
    is_clock,
    is_missing,
    is_number,
    is_time,
    labelled,
    name_and_unit,
    number,
    plotted,
    seconds,
    separator,
    unit_behind,
    unit_of,
    unwrapped,
)

_DIGITS = re.compile(r"[-+.0-9eE]*")
_COMMENT = ("#", "%")
_FEW = 20
"""One line of so many may be damaged: it is left out and counted, as a port does. Of more the first is refused."""
_HINT = "; decimal commas need another separator, such as ;"
_CLOCKS = "a time such as 14:02:11.5 or 2024-05-03 14:02:11.5"


class Table(NamedTuple):
    """Numbers of a table, NaN where there is none, with the names and units of their columns.

    ``lines`` are the lines of a file, or the rows of a data frame from 1; times are in seconds. ``remarks`` say what
    was left out or put together, ``refusals`` why a column cannot be used, if anybody wants it.
    """

    owner: str
    columns: tuple[str, ...]
    names: tuple[str, ...]
    units: tuple[str, ...]
    values: Array
    lines: Sequence[int]
    times: Array | None
    remarks: tuple[str, ...] = ()
    refusals: Mapping[str, InputError] = MappingProxyType({})

    @property
    def unnamed(self) -> int:
        """How many columns have no name but their number."""
        return sum(re.fullmatch(r"column \d+", column) is not None for column in self.columns)

    def require_numbers(self, column: int) -> None:
        """Refuse a column that cannot be used."""
        if self.columns[column] in self.refusals:
            raise self.refusals[self.columns[column]]

    def column_of(self, channel: str | float, own: str) -> int:
        """Return the column of a channel: by its name, or by its number, or by the name of its reading."""
        by_name = isinstance(channel, str)
        wanted = {channel} if by_name else {f"{prefix}{channel}" for prefix in ("", "u", "ch", "channel")}
        wanted |= {own, own.replace(" ", "")}
        spelt = [{name, re.sub("[ _]", "", name.lower())} for name in self.names]
        found = [k for k, names in enumerate(spelt) if wanted & {*names, self.columns[k]}]
        if len(found) != 1:
            low, word = {name.lower(): name for name in self.names}, str(channel).lower()
            near = [low[name] for name in get_close_matches(word, low, 1)]
            # Names that differ in one letter or digit are those of two readings, such as x_1 and y_1.
            near = [x for x in near if len(x) != len(word) or sum(map(str.__ne__, x.lower(), word)) != 1]
            words = channel if by_name else f"u{channel}_mT, channel_{channel}, or {own}"
            words = f"one column for {own}: {words}" + (f" (is it {near[0]}?)" if near and not found else "")
            received = [self.columns[k] for k in found] if found else f"none among {', '.join(self.columns)}"
            raise bad_input("columns", self.owner, words, received)
        self.require_numbers(found[0])
        return found[0]

    def scaled(self, name: str, units: Sequence[str] = ("",)) -> tuple[Array, str]:
        """Return the column of a name in SI units, and its own unit; refuse other units than those named."""
        k = self.column_of(name, name)
        unit, expected = self.units[k], " or ".join(units) or "no unit"
        require(unit in units, f"column {self.columns[k]}", self.owner, f"in {expected}", unit or "no unit")
        return self.values[:, k] * SI.get(unit, 1.0), unit


def read_table(source: Any, rate_hz: float | None = None) -> Table:
    """Read a data frame, or a text file: a table with a line of names, or what a board has printed.

    A file is in UTF-8 or UTF-16. Cells are separated by commas, semicolons, tabs or blanks, or have labels
    (``x: 1.5 uT y: 2``); decimal commas are read between semicolons and tabs. Above the numbers, lines that begin
    with ``#`` or ``%`` are comments, other text is left out, and a line of units below the names is read. Without
    names the columns are u1, u2 and so on. A first column without a name is an index and is left out; the index of a
    data frame is the time if it has moments or fractions, or is called so. Times are numbers or those of a clock;
    counters of 32 or 16 bits that start again from 0 are put on. Streams that take turns (a column ``stream``, or one
    number a line) are put together to one row for each turn. A line of twenty that is damaged is left out and
    counted. A column without numbers is refused when it is used.

    Parameters
    ----------
    source
        A data frame, a path, or a table that was read.
    rate_hz
        Rows per second, for a table without times.

    Raises
    ------
    InputError
        If it is not a table, a cell is no number, or times do not increase, with the file and the line; or if the
        rate is not positive.
    """
    if isinstance(source, Table):
        return source
    rate = None if rate_hz is None else scalar(rate_hz, "rate_hz", "read_table", "positive and finite [Hz]")
    remarks: list[str] = []
    if isinstance(source, str | Path):
        table, restarts = _file(Path(source), remarks)
    else:
        table, restarts = _frame(source, remarks), []
    require(
        len(table.values), "file", table.owner, "a line of names and lines of numbers", "0 lines of numbers"
    )
    clock = [k for k, name in enumerate(table.names) if is_time(name)]
    for k in clock:
        table.require_numbers(k)
    times = _times(table, clock, restarts, remarks) if clock else None
    keep = [k for k, column in enumerate(table.columns) if k not in clock and (k or column.strip())]
    columns, names, units = (tuple(x[k] for k in keep) for x in (table.columns, table.names, table.units))
    infinite = np.isinf(table.values[:, keep])
    values = np.where(infinite, np.nan, table.values[:, keep])
    table = table._replace(columns=columns, names=names, units=units, values=values, times=times)
    table = _put_together(table, remarks)
    times = table.times
    if times is not None:
        times = spread(times, table.lines, table.owner, remarks)
        remarks += [] if rate is None else [f"{table.owner} has times: the rate of {rate:g} Hz is not used."]
    elif rate is not None:
        times = np.arange(len(table.values)) / rate
    note_count(int(infinite.sum()), infinite.size, f"numbers of {table.owner}", "missing: infinite", remarks)
    return table._replace(times=times, remarks=tuple(remarks))


def _frame(frame: Any, remarks: list[str]) -> Table:
    """Return all columns of a data frame."""
    owner, kind = "the table", type(frame).__name__
    require(hasattr(frame, "infer_objects"), "table", "read_table", "a data frame or a path", kind)
    frame = _with_times(frame.infer_objects(), remarks)
    header = [str(name) for name in frame.columns]
    values, refusals = np.full(frame.shape, np.nan), dict[str, InputError]()
    for k, (name, dtype) in enumerate(zip(header, frame.dtypes, strict=True)):
        if dtype.kind in "fiu":
            values[:, k] = frame.iloc[:, k].to_numpy(dtype=float, na_value=np.nan)
        else:
            refusals[name] = bad_input(f"column {name}", owner, "of numbers", f"{dtype} values")
    require(header, "table", owner, "one with columns", "none")
    names, units = zip(*map(name_and_unit, header), strict=True)
    return Table(owner, tuple(header), names, units, values, range(1, len(frame) + 1), None, (), refusals)


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
    marked = content[:2] in (b"\xff\xfe", b"\xfe\xff") and content[2:4] != b"\0\0"  # that is UTF-32
    few_zeros = 10 * content[:1000].count(0) <= len(content[:1000])  # they are damage
    received = "bytes that are zero (a binary file, or UTF-16 without a mark: save it as UTF-8)"
    expected = "text in UTF-8, or in UTF-16 with a byte order mark"
    require(marked or few_zeros, "file", path.name, expected, received)
    odd = sum(byte < 32 and byte not in b"\0\t\n\r\f\x1b" for byte in content[:1000])
    received = "bytes that are no text (packed, or a spreadsheet? unpack it, or save it as CSV)"
    require(marked or 20 * odd <= len(content[:1000]), "file", path.name, expected, received)
    try:
        return content.decode("utf-16" if marked else "utf-8-sig")
    except UnicodeDecodeError as error:
        line = content[: error.start].count(b"\n") + 1
        remarks.append(f"{path.name} is not in UTF-8 (line {line}): it is read as Windows-1252.")
        return content.decode("cp1252", errors="replace")


def _printed(text: str, owner: str, remarks: list[str]) -> list[tuple[int, str]]:
    """Return the lines with anything in them, and their numbers; the last one may be cut."""
    whole = _joined([(k, line.strip(" ")) for k, line in enumerate(re.split(r"\r\n|\r|\n", text), start=1)])
    kept = [(k, line) for k, line in whole if line.strip() and not line.startswith("sep=")]
    # Without what Python, JSON and plotters put around the numbers.
    kept = [(k, ":".join(plotted(line) or (unwrapped(line),))) for k, line in kept]
    if len(kept) > 2 and text[-1] not in "\r\n":
        parts = [re.split(r"[.,;:\s]+", line) for _, line in kept[-100:]]
        if {len(part[-1]) for part in parts[:-1] if len(part) == len(parts[-1])} != {len(parts[-1][-1])}:
            cut = "does not end, and its last cell may be cut: it is left out."
            remarks.append(f"Line {kept.pop()[0]} of {owner} {cut}")
    return [(k, line) for k, line in kept if line]


def _joined(lines: list[tuple[int, str]]) -> list[tuple[int, str]]:
    """Put lines together that one quoted cell spans, as a name with its unit below it may."""
    found: list[tuple[int, str]] = []
    for k, line in lines:
        if '"' in line and found and found[-1][1].count('"') % 2:
            found[-1] = found[-1][0], f"{found[-1][1]} {line}"
        else:
            found.append((k, line))
    return found


def _file(path: Path, remarks: list[str]) -> tuple[Table, list[int]]:
    """Return all columns of a file, and the lines in which its names come again."""
    owner = printable(path.name)
    require(path.is_file(), "table", "read_table", "a file that exists", path)
    printed = _printed(text_of(path, remarks), owner, remarks)
    plain = [line for _, line in printed if not line.startswith(_COMMENT)]
    require(plain, "file", owner, "a table", "nothing")
    marks = Counter(":" if _labels(x) else separator(x) for x in plain[:: 1 + len(plain) // 500])
    mark = marks.most_common(1)[0][0]
    rows = _labelled(printed) if mark == ":" else [_Row(k, _cells(line, mark)) for k, line in printed]
    given, units, body, damaged = _named(rows, mark, owner, remarks)
    restarts = [row.line for row in rows if row.cells == given][1:]
    header = tuple(map(printable, given)) or tuple(f"column {k + 1}" for k in range(len(body[0].cells)))
    split = _split(header if given else (), units, body[0].cells, owner, remarks)
    names, units = zip(*split, strict=True)
    values, bad = _values([row.cells for row in body], [k for k, name in enumerate(names) if is_time(name)])
    refusals, spoilt = _judged(bad, values, body, header, names, owner)
    damaged = sorted([*damaged, *(body[k].line for k in spoilt)])
    if damaged:
        n, first = len(body) + len(damaged) - len(spoilt), f"(the first: line {damaged[0]})"
        note_count(len(damaged), n, f"lines of {owner}", f"damaged and left out {first}", remarks)
    use = [k for k in range(len(body)) if k not in spoilt]
    lines = [body[k].line for k in use]
    return Table(owner, header, names, units, values[use], lines, None, (), refusals), restarts


class _Row(NamedTuple):
    """A line of a table."""

    line: int
    cells: list[str]


def _labels(line: str) -> dict[str, str]:
    """Return the numbers in a line by their labels, with units; none if there is anything else in it."""
    stamp, arrow, rest = line.rpartition(" -> ")
    found = labelled(rest)
    return {"time": stamp, **found} if arrow and found else found


def _labelled(printed: list[tuple[int, str]]) -> list[_Row]:
    """Return lines with labels as a table with names; a label that hardly any line has is none."""
    found = [(k, line, _labels(line)) for k, line in printed]
    times = Counter(name for _, _, labels in found for name in labels)
    names = [name for name, n in times.items() if n > len(printed) / 50]
    rows = [
        _Row(k, [labels.get(name, "") for name in names] if labels.keys() & {*names} else [line, ""])
        for k, line, labels in found
    ]
    return [_Row(0, names), *rows]


def _cells(line: str, mark: str) -> list[str]:
    stamp, arrow, line = line.rpartition(" -> ")
    try:
        by_mark = next(csv.reader([line], delimiter=mark, skipinitialspace=True))
    except csv.Error:  # a cell is longer than any number or name
        by_mark = line.split(mark)
    found = line.split() if mark == " " else by_mark
    return [cell.strip() for cell in ([stamp, *found] if arrow else found)]


def _is_comment(cell: str) -> bool:
    """Return whether a line that begins with this cell is a comment; a spreadsheet's #N/A is a missing number."""
    return cell.startswith(_COMMENT) and not is_missing(cell)


def _filled(row: Sequence[str]) -> int:
    """Return the number of cells without the empty ones at the end."""
    return max((k for k, cell in enumerate(row, 1) if cell), default=0)


def _named(
    rows: list[_Row], mark: str, owner: str, remarks: list[str]
) -> tuple[list[str], list[str], list[_Row], list[int]]:
    """Return names (empty if there are none), units and lines of a table, and the numbers of damaged ones."""
    plain = [k for k, (_, cells) in enumerate(rows) if not (cells and _is_comment(cells[0]))]
    width = Counter(len(rows[k].cells) for k in plain).most_common(1)[0][0]
    first = _first(rows, plain, width)
    above, below = [rows[k] for k in plain if k < first], rows[first:]
    names, units, lost = _head(above, width, owner)
    total = len(above) + len(below)
    note_count(lost, total, f"lines of {owner}", "above the table and left out", remarks)
    end = max((k for k, row in enumerate(below, 1) if any(row.cells)), default=0)
    note_count(len(below) - end, total, f"lines of {owner}", "empty, at the end, and left out", remarks)
    body = [
        row
        for row in below[:end]
        if not _is_comment(row.cells[0])
        and (any(map(is_number, filter(None, row.cells))) or (len(row.cells) == width and row.cells != names))
    ]
    note_count(end - len(body), total, f"lines of {owner}", "text and left out", remarks)
    require(body, "file", owner, "a line of names and lines of numbers", "0 lines of numbers")
    n, damaged = _damaged(body, names, owner)
    whole = [_Row(row.line, row.cells[:n]) for k, row in enumerate(body) if k not in damaged]
    cells = [cell for row in whole for cell in row.cells] if mark == "," and not names else []
    if any(re.fullmatch(r"0\d+", cell) for cell in cells) and not any("." in cell for cell in cells):
        raise bad_input("file", owner, f"of numbers with decimal points{_HINT}", "numbers such as 0123")
    return names[:n], [*units, *n * [""]][:n], whole, [body[k].line for k in sorted(damaged)]


def _first(rows: list[_Row], plain: list[int], width: int) -> int:
    """Return the first line with numbers in all columns that have more numbers than texts: others may have text."""
    found = [k for k in plain if len(rows[k].cells) == width and any(rows[k].cells)]
    lines = [rows[k].cells for k in found[:: 1 + len(found) // 200] if any(map(is_number, rows[k].cells))]
    text = np.mean([[not is_number(cell) for cell in row] for row in lines] or [[True] * width], axis=0)
    missing = np.mean([[is_missing(cell) for cell in row] for row in lines] or [[False] * width], axis=0)
    numeric = 1 - text - missing > text
    columns = np.flatnonzero(numeric if numeric.any() else ~numeric)
    whole = (k for k in found if all(is_number(rows[k].cells[c]) for c in columns))
    return next(whole, plain[0] + 1)


def _head(above: list[_Row], width: int, owner: str) -> tuple[list[str], list[str], int]:
    """Return names and units in the lines above the numbers, and how many of these say nothing."""

    def may_name(row: list[str]) -> bool:
        return (len(row) > 1 or width == 1) and not all(map(is_number, row))

    rows, names, units, lost = [row.cells for row in above], [], [], 0
    if rows and any(rows[-1]) and None not in (found := [unit_of(cell) for cell in rows[-1]]):
        units = [unit or "" for unit in found]
        rows.pop()
    # Names differ from each other; below them some programs write a line of types.
    while (
        len(rows) > 1
        and may_name(rows[-2])
        and len({*rows[-2]}) == len(rows[-2]) == len(rows[-1]) > len({*rows[-1]})
    ):
        rows.pop()
        lost += 1
    if rows and may_name(rows[-1]):
        names = rows.pop()
        if any(re.fullmatch(r"[+-]?\d*[.,]\d+", cell) for cell in names):
            word = next(cell for cell in names if not is_number(cell))
            where = f"{owner}, line {above[len(rows)].line},"
            raise bad_input("cell", where, "a number, or all of them names", repr(word))
    return names, units, len(rows) + lost


def _damaged(body: list[_Row], names: list[str], owner: str) -> tuple[int, set[int]]:
    """Return how many cells a line has, and which lines have others; refuse more than a few."""
    sizes = [_filled(row.cells) for row in body]
    times = Counter(sizes)
    usual = max(size for size, k in times.items() if _FEW * k > len(body) or k == max(times.values()))
    n = _filled(names) or usual
    damaged = {k for k, row in enumerate(body) if len(row.cells) < n or sizes[k] > n}
    if damaged and _FEW * len(damaged) > len(body):
        first = body[min(damaged)]
        words = "as the line of names" + _HINT * (_filled(first.cells) > n) if names else "as the others"
        raise bad_input(f"line {first.line}", owner, f"of {n} cells, {words}", len(first.cells))
    return n, damaged


def _split(
    header: Sequence[str], units: list[str], row: list[str], owner: str, remarks: list[str]
) -> list[tuple[str, str]]:
    """Return names and units of columns; without a line of names a first column of clock times has one."""
    split = [name_and_unit(name) for name in header]
    if not header:
        first = int(is_clock(row[0]))
        require(len(row) > first, "table", owner, "of times and numbers", "times alone")
        split = [("time", "s")] * first + [(f"u{k}", "") for k in range(1, len(row) + 1 - first)]
        remarks.append(f"{owner} has no line of names: its columns are {split[first][0]} to {split[-1][0]}.")
    return [
        (name, own or unit_behind(unit) or ("s" if ":" in cell else ""))
        for (name, own), unit, cell in zip(split, units, row, strict=True)
    ]


def _values(rows: list[list[str]], clock: list[int]) -> tuple[Array, dict[int, list[int]]]:
    """Return the numbers of cells, and by column the rows in which there is none."""
    comma = not any("." in cell and ":" not in cell for row in rows for cell in row)
    values, bad = np.full((len(rows), len(rows[0])), np.nan), dict[int, list[int]]()
    for k, row in enumerate(rows):
        with suppress(ValueError):  # most rows are plain numbers, and this is four times as fast
            if _DIGITS.fullmatch("".join(row)):
                values[k] = [float(cell) for cell in row]
                continue
        for c, cell in enumerate(row):
            try:
                at = c in clock and is_clock(cell)
                values[k, c] = seconds(cell) if at else number(cell.replace(",", ".") if comma else cell)
            except ValueError:
                bad.setdefault(c, []).append(k)
    return values, bad


def _judged(
    bad: dict[int, list[int]],
    values: Array,
    rows: list[_Row],
    header: Sequence[str],
    names: Sequence[str],
    owner: str,
) -> tuple[dict[str, InputError], set[int]]:
    """Return why columns cannot be used that are text, or of which many cells are, and the rows of few such cells."""
    numbers = {c: np.isfinite(values[:, c]).sum() for c in bad}
    few = [own for c, own in bad.items() if len(own) < numbers[c] and _FEW * len(own) <= len(rows)]
    spoilt = {k for own in few for k in own}
    spoilt = spoilt if _FEW * len(spoilt) <= len(rows) else set()
    refusals = {}
    for c, own in bad.items():
        if not spoilt.issuperset(own):
            where = f"{owner}, line {rows[own[0]].line}, column {header[c] or 'without a name'},"
            must = _CLOCKS if is_time(names[c]) else "a number"
            refusals[header[c]] = bad_input("cell", where, must, repr(rows[own[0]].cells[c]))
    return refusals, spoilt


def note_count(n: int, of: int, what: str, why: str, remarks: list[str]) -> None:
    """Add a remark if there are any."""
    if n:
        remarks.append(f"{n} of {of} {what} {'is' if n == 1 else 'are'} {why}.")


def _times(table: Table, clock: list[int], restarts: list[int], remarks: list[str]) -> Array:
    """Return the times of the rows [s]."""
    header, values, lines, owner = table.columns, table.values, table.lines, table.owner
    days = [k for k in clock if table.names[k].lower() in DATES]
    rest = [k for k in clock if k not in days] or days
    stated = [k for k in rest if table.units[k]] or rest
    own = stated[0]
    must = "the only one of times (rename the others: a name such as clock_2 is no time)"
    require(len(stated) == 1, f"column {header[stated[-1]]}", owner, must, "another")
    if other := [header[k] for k in rest if k != own]:
        remarks.append(f"Column {', '.join(other)} of {owner} is left out: times are those of {header[own]}.")
    unit, name = table.units[own], f"column {header[own]}"
    require(unit in SECONDS or not unit, name, owner, "in s, ms, us, ns or min", unit)
    times = values[:, own] * SECONDS.get(unit, 1.0)
    bad = [lines[k] for k in np.flatnonzero(~np.isfinite(times)).tolist()]
    require(not bad, name, owner, "a time in every line", f"none in line {', '.join(map(str, bad[:1]))}")
    usual = float(np.median(np.diff(times))) if len(times) > 1 else 0.0
    for line in restarts:
        k = int(np.searchsorted(lines, line))
        if 0 < k < len(times) and times[k] < times[k - 1]:
            times[k:] += times[k - 1] + usual - times[k]
            remarks.append(f"The board began again in line {line} of {owner}: times go on from those before.")
    require(unit or usual <= 1, name, owner, "named with its unit, such as time_ms", f"steps of {usual:g}")
    if days:
        return times if days == rest else times + values[:, days].sum(axis=1)
    period, step = _period(times, unit, usual), np.diff(times)
    if (again := step < -period / 2).any():
        times[1:] += period * np.cumsum(again)
        line = list(lines)[int(again.argmax()) + 1]
        remarks.append(f"Times of {owner} start again from 0 in line {line}: they are put on.")
    return times


def _period(times: Array, unit: str, usual: float) -> float:
    """Return when times start again [s]: at midnight, or where the 32 or 16 bits of a counter end."""
    if unit not in ("ms", "us"):
        return 86400.0 if unit == "s" and times.max() < 86400 else math.inf
    short, step = 2**16 * SECONDS[unit], np.diff(times)
    over = step[step < -short / 2] + short
    goes_on = len(over) and times.max() < short and (over > 0).all() and (over <= 3 * usual).all()
    return short if goes_on else 2**32 * SECONDS[unit]


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
    note_count(n, len(times), f"times of {owner}", "equal to the one before: spread evenly", remarks)
    require(len(first) > 1, "times", owner, "more than one", f"{times[0]:g} s in every row")
    at, known = np.r_[first, 2 * first[-1] - first[-2]], times[first]
    return np.interp(np.arange(len(times)), at, np.r_[known, 2 * known[-1] - known[-2]])


def _put_together(table: Table, remarks: list[str]) -> Table:
    """Return one row for each turn of streams, or of columns of which every row has one."""
    values, names, times = table.values, list(table.names), table.times
    there = np.isfinite(values)
    # Boards print the number of an IMU, then its quaternion.
    headless = len(names) == 5 and table.columns[0] == "column 1" and there.all(1).any()
    if headless and 0.9 < np.nanmedian(np.linalg.norm(values[:, 1:], axis=1)) < 1.1:
        names = ["stream", "qw", "qx", "qy", "qz"]
    if "stream" in names:
        of_stream = names.index("stream")
        table.require_numbers(of_stream)
        usable = [column not in table.refusals for column in table.columns]
        own = [k for k in range(len(names)) if k != of_stream and usable[k]]
        streams, which = np.unique(values[:, of_stream], return_inverse=True)
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
    group = _turns(which.tolist(), times)
    found = np.full((group[-1] + 1, len(names) // turn.shape[1], turn.shape[1]), np.nan)
    found[group, which] = turn
    if (n := len(values)) > len(found):
        remarks.append(f"{n} of {n} rows of {table.owner} are put together to {len(found)}.")
    last = np.flatnonzero(np.diff(group, append=-1)).tolist()
    return table._replace(
        columns=tuple(columns), names=tuple(names), units=tuple(units), values=found.reshape(len(found), -1),
        lines=[table.lines[k] for k in last], times=None if times is None else times[last],
    )  # fmt: skip


def _turns(streams: list[int], times: Array | None) -> Array:
    """Return the number of the turn to which each row of a stream belongs."""
    later = np.zeros(len(streams), dtype=bool) if times is None else np.diff(times, prepend=times[0]) != 0
    together = times is not None and not later[1:].all()
    cut = 0 if together else cut_turn(streams, streams)
    new, seen = list[bool](), set[int]()
    for k, stream in enumerate(streams):
        new.append(k > 0 and (stream in seen or k == cut or bool(together and later[k])))
        seen = {stream} if new[-1] else seen | {stream}
    return np.cumsum(new)


def cut_turn(order: Sequence[int], streams: Sequence[int]) -> int:
    """Return how many of the first in an order of streams are the end of a turn: they rise to the highest number.

    In a turn streams come by their numbers, and a log may begin in its middle; 0 if the first turn is whole.
    """
    before = list(order[: order.index(min(streams))]) if min(streams) in order else []
    return len(before) if before and before == sorted({*before}) and before[-1] == max(streams) else 0
