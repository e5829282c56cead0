"""Lines of text with numbers, as boards print them and tables hold them: one grammar of names, numbers and units.

A line has numbers alone or with labels and units (``x: 1.5 uT, y: 2``), between commas, semicolons, tabs or blanks.
What stays when its numbers are taken out is its form: lines of one form have the same columns.
"""

from __future__ import annotations

import functools
import math
import re
from collections.abc import Sequence
from datetime import UTC, datetime
from itertools import pairwise

TO_MT = {"T": 1e3, "mT": 1.0, "uT": 1e-3, "nT": 1e-6, "G": 0.1, "gauss": 0.1, "mG": 1e-4}
SECONDS = {"s": 1.0, "sec": 1.0, "seconds": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9, "min": 60.0}
SI = {"mm": 1e-3, "cm": 1e-2, "m": 1.0, "deg": math.pi / 180, "rad": 1.0}
UNITS = {unit.lower(): unit for unit in (*TO_MT, *SI, "mV", "V", "raw")} | {"counts": "raw"}
DATES = ("date", "datum")
TIMES = {
    "t": "", "time": "", "timestamp": "", "elapsed": "", "elapsed time": "", "seconds": "s", "sec": "s",
    "seconds_elapsed": "s", "millis": "ms", "milliseconds": "ms", "ms": "ms", "micros": "us", "microseconds": "us",
    "us": "us", **dict.fromkeys(DATES, ""),
}  # fmt: skip
"""Names of a column of times, and the unit that a name says."""
MARK = "\0"
"""Stands for a number in the form of a line: all of it but its numbers."""
_WORDS = r"(?i:[+-]?nan|n/?a|null|none|[+-]?ovf|-?1\.#[A-Z]+|#n/?[av]|##+|#[^\W\d][\w/]*[!?])"
"""For a number that is missing; also what a spreadsheet writes in any language, and ##### in too narrow a column."""
_MISSING = re.compile(rf"(?:|--?|{_WORDS})")
_NUMBER = re.compile(r"[+-]?(\d+[.,]?\d*|[.,]\d+)(e[+-]?\d+)?|[+-]?inf(inity)?", re.ASCII | re.IGNORECASE)
_CLOCK = re.compile(r"(?=\d)(\d{4}-\d\d-\d\d)?[T ]?(\d{1,2}:\d\d:\d\d\S*)?", re.ASCII)
_IN_LINE = re.compile(  # no whole number begins with a zero, as decimals behind a comma may
    rf"(?<![\w.#+-])(?:{_WORDS}|[+-]?(?i:inf|infinity))(?![\w.])"
    r"|(?<![^\s,;:=])-{1,2}(?=[\s,;]|$)"
    r"|(?<![\w.^])([+-]?(?:[0-9]+\.[0-9]*|0|[1-9][0-9]*|\.[0-9]+)(?![0-9])(?:[eE][+-]?[0-9]{1,3}(?![0-9.]))?)"
    r"(?! *[:=\])])"  # a number in a label
)
_EMPTY = re.compile(r"(?<=[,;\t:=])(?=[,;\t])|^(?=[,;\t])")
_BLANKS = re.compile(r" *([;,\t:=]) *| +(?= )")
_LETTER = "A-Za-zµμΩ°%"
_UNIT = (
    rf"(?![xXbB][0-9]|[eE](?![{_LETTER}])|(?i:nan|inf|ovf)(?![{_LETTER}]))"  # 0x10, 1.5e, and no numbers
    rf"[{_LETTER}][{_LETTER}/²³^*]*[0-9]?(?![0-9{_LETTER}])"
)
_BETWEEN = re.compile(rf"(?: ?({_UNIT}))?([ ,;\t]?)(?:([^\W\d][\w .()\[\]/#°%-]*?)[:=])?")
_NAME = re.compile(r"[^\W\d][\w .()\[\]/²³^*#°%-]*")
_IN_BRACKETS = re.compile(r"(.*?)[ _]*[(\[] *(.*?) *[)\]]")
_WRAPPED = re.compile(r"b(['\"])(.*?)(?:\\r)?(?:\\n)?\1|[(\[{](.*)[)\]}],?")
"""How Python prints bytes and tuples, and JSON objects."""
_PLOTTED = re.compile(r">([^>:,|]+):([^:§|]*)(?:§([^|]*))?(?:\|.*)?")


def name_and_unit(column: str) -> tuple[str, str]:
    """Split the name of a column from its unit.

    Examples
    --------
    >>> name_and_unit("Mag X (uT)"), name_and_unit("/board/u1_mT"), name_and_unit("time_ms"), name_and_unit("x_1")
    (('Mag X', 'uT'), ('u1', 'mT'), ('time', 'ms'), ('x_1', ''))
    >>> name_and_unit("a_(uT)"), name_and_unit("Bx (Gauss)"), name_and_unit("B_x"), name_and_unit("delta_L_1_mm")
    (('a', 'uT'), ('Bx', 'gauss'), ('B_x', ''), ('delta_L_1', 'mm'))
    """
    text = column.strip().replace("µ", "u").replace("μ", "u")
    text = text.rsplit("/", 1)[-1] if text.startswith("/") else text
    if found := _IN_BRACKETS.fullmatch(text):
        return found[1], UNITS.get(found[2].lower(), found[2])
    name, _, unit = text.rpartition("_")
    if is_time(name) and unit.lower() in SECONDS:
        return name, unit.lower()
    if name and unit.lower() in UNITS:
        return name, UNITS[unit.lower()]
    return text, TIMES.get(text.lower(), "")


def unit_of(cell: str) -> str | None:
    """Return the unit that a cell below a name states, bare or in brackets; None if it states anything else."""
    text = cell.strip(" ()[]").replace("µ", "u").replace("μ", "u").lower()
    return {"": "", "-": "", **UNITS, **{unit: unit for unit in SECONDS}}.get(text)


def unit_behind(text: str) -> str:
    """Return the unit that stands behind a number by its usual name, or as it stands if nobody knows it.

    Examples
    --------
    >>> unit_behind("µT"), unit_behind("Gauss"), unit_behind("furlong")
    ('uT', 'gauss', 'furlong')
    """
    known = unit_of(text)
    return text if known is None else known


def is_time(name: str) -> bool:
    """Return whether a column of this name has times."""
    low = name.lower().strip("_ ")
    return name != "T" and (low in TIMES or low.startswith(("time", "zeit", "seconds")))  # T is a temperature


def of_all(units: Sequence[str]) -> list[str]:
    """Return the units of columns: one that stands behind the last number alone is that of all."""
    alone = bool(units) and bool(units[-1]) and not any(units[:-1])
    return [units[-1]] * len(units) if alone else list(units)


def separator(text: str) -> str:
    """Return what separates the cells of a line."""
    return next((mark for mark in "\t;," if mark in text), " ")


def unwrapped(text: str) -> str:
    """Return a line without what Python and JSON put around its numbers."""
    found = _WRAPPED.fullmatch(text)
    return (found[2] or found[3] or "").strip(" ") if found else text


def plotted(text: str) -> tuple[str, str] | None:
    """Return name and cell of a line for a plotter, such as ``>x:1.5§uT``, which has one number."""
    found = _PLOTTED.fullmatch(text)
    return (found[1].strip(), f"{found[2]}{found[3] or ''}") if found else None


def fields(text: str) -> tuple[str, list[str]]:
    """Return the form of a line and its numbers, empty where one is missing."""
    text = _EMPTY.sub("nan", _BLANKS.sub(r"\1", text.replace(MARK, "\ufffd")))
    return _IN_LINE.sub(MARK, text), _IN_LINE.findall(text)


@functools.lru_cache(64)
def columns(form: str) -> tuple[tuple[str, str], ...]:
    """Return label and unit of every number; nothing if the form is not that of a line of numbers."""
    first, *between = [_BETWEEN.fullmatch(part) for part in f",{form}".split(MARK)]
    parts = [part for part in between if part]
    if not first or not first[2] or not parts or len(parts) < len(between) or parts[-1][3]:
        return ()
    found = tuple((before[3] or "", behind[1] or "") for before, behind in pairwise([first, *parts]))
    separators, labelled = {part[2] for part in parts[:-1]}, {bool(label) for label, _ in found}
    one_form = len(separators) < 2 or labelled == {True}
    return found if "" not in separators and one_form and len(labelled) == 1 else ()


def labelled(text: str) -> dict[str, str]:
    """Return the numbers of a line by label and unit; nothing if a number has no label."""
    form, cells = fields(text.replace('"', ""))
    found = columns(form)
    if not found or not found[0][0]:
        return {}
    own = [k for k, (label, _) in enumerate(found) if not is_time(name_and_unit(label)[0])]
    units = [unit for _, unit in found]
    for k, unit in zip(own, of_all([units[k] for k in own]), strict=True):
        units[k] = unit
    names = [f"{label} [{unit}]" if unit else label for (label, _), unit in zip(found, units, strict=True)]
    return dict(zip(names, cells, strict=True))


def names_of(text: str) -> tuple[str, ...]:
    """Return the names in a line of names; nothing if one is no name."""
    mark = separator(text)
    cells = text.split() if mark == " " else text.rstrip(mark + " ").split(mark)
    names = tuple(cell.strip() for cell in cells)
    return names if all(_NAME.fullmatch(name) and not _IN_LINE.fullmatch(name) for name in names) else ()


def is_missing(cell: str) -> bool:
    """Return whether a cell is empty, or has a word for a number that is missing."""
    return _MISSING.fullmatch(cell) is not None


def is_clock(cell: str) -> bool:
    """Return whether a cell has a time of the day, a date, or both."""
    return _CLOCK.fullmatch(cell) is not None


def is_number(cell: str) -> bool:
    """Return whether a cell has a number, a time of a clock, or none that is missing."""
    return _NUMBER.fullmatch(cell) is not None or is_clock(cell) or is_missing(cell)


def number(cell: str) -> float:
    """Return the number of a cell with a decimal point, NaN where it is missing."""
    if is_missing(cell):
        return math.nan
    if "," in cell or not _NUMBER.fullmatch(cell):  # float would take digits of any script, and underscores
        raise ValueError(cell)
    return float(cell)


def seconds(cell: str) -> float:
    """Return seconds since 1970, or since midnight if there is no date, by the clock that wrote them."""
    cell = re.sub(r"(?<![\d:])(\d:)", r"0\1", cell)
    moment = datetime.fromisoformat(cell if "-" in cell[:5] else f"1970-01-01T{cell}")
    return moment.replace(tzinfo=UTC).timestamp()
