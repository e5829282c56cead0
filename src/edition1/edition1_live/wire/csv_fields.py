"""Fields of a line of numbers as sketches print them: labels, numbers, units, names of columns, and times."""

from __future__ import annotations

import re
from typing import NamedTuple

from edition1.robot_file.columns import TIME_NAMES, TIME_UNITS, name_and_unit

SEPARATORS = {";": "semicolons", ",": "commas", "\t": "tabs", " ": "blanks"}
"""The first of these that a line has separates its fields; blanks around a field mean nothing."""
BLANKS = " \t"
_LETTER = "A-Za-zµμΩ°%"
_NUMBER = r"[+-]?(?:[0-9]+(?:\.[0-9]*)?|\.[0-9]+)(?:[eE][+-]?[0-9]{1,3})?|[+-]?(?i:nan)(?![A-Za-z])"
_UNIT = (
    rf"(?![xXbB][0-9]|[eE](?![{_LETTER}])|(?i:nan|inf|ovf)(?![{_LETTER}]))"  # 0x10, 1.5e, and no numbers
    rf"[{_LETTER}][{_LETTER}/²³^*]*(?:[0-9](?![0-9{_LETTER}]))?"
)
_LABEL = rf"[{_LETTER}_][{_LETTER}0-9_ .()\[\]/#-]*?"
_WORD = rf"[{_LETTER}_][{_LETTER}0-9_.()\[\]/#-]*?"
_FIELD = re.compile(rf"(?:({_LABEL})[ \t]*[:=][ \t]*)?({_NUMBER})[ \t]*({_UNIT})?")
_ITEM = re.compile(rf"(?:({_WORD})[ ]*[:=][ ]*)?({_NUMBER})(?:[ ]*({_UNIT})(?![ ]*[:=]))?(?:[ ]+|$)")
_NAME = re.compile(rf"[{_LETTER}_][{_LETTER}0-9_ .()\[\]/²³^*#-]*")
_DECIMAL_COMMAS = re.compile(r"[+-]?[0-9]+,[0-9]+(?:,[ ]+[+-]?[0-9]+,[0-9]+)+")
_NO_NUMBER = re.compile(r"(?i:[+-]?(?:nan|inf|infinity|ovf))")


class Line(NamedTuple):
    """A line of numbers.

    Attributes
    ----------
    separator
        One of :data:`SEPARATORS`.
    labels, units
        Of each field, empty where it has none.
    trailing
        Whether a separator stands behind the last field.
    values
        The numbers, as printed; NaN where ``nan`` is.
    """

    separator: str
    labels: tuple[str, ...]
    units: tuple[str, ...]
    trailing: bool
    values: tuple[float, ...]


def read_line(text: str) -> Line | str:
    """Return the numbers of a line; or in words why it is none.

    Examples
    --------
    >>> read_line("X: 1.2 uT, Y: -3 uT")
    Line(separator=',', labels=('X', 'Y'), units=('uT', 'uT'), trailing=False, values=(1.2, -3.0))
    >>> read_line("x=1.2 y=.5").values
    (1.2, 0.5)
    >>> read_line("1,5;2,5")
    "'1,5' is no number with a decimal point"
    """
    text = text.strip(BLANKS)
    separator = separator_of(text)
    if separator == " ":
        return _items(text)
    fields = [field.strip(BLANKS) for field in text.split(separator)]
    trailing = len(fields) > 1 and not fields[-1]
    if trailing:
        fields.pop()
    found = []
    for field in fields:
        match = _FIELD.fullmatch(field)
        if match is None:
            return f"{field!r} is no number with a decimal point" if field else "a field is empty"
        found.append(match.groups(default=""))
    return _line(separator, found, trailing)


def decimal_commas(text: str) -> bool:
    """Whether a line may hold decimal commas, as ``1,5, 2,5`` does: two numbers or four."""
    return _DECIMAL_COMMAS.fullmatch(text.strip(BLANKS)) is not None


def separator_of(text: str) -> str:
    """Return what separates the fields of a line."""
    return next(separator for separator in SEPARATORS if separator in text or separator == " ")


def _items(text: str) -> Line | str:
    found, at = [], 0
    while at < len(text) or not found:
        match = _ITEM.match(text, at)
        if match is None:
            return f"{text[at:]!r} is no number with a decimal point" if text else "the line is empty"
        found.append(match.groups(default=""))
        at = match.end()
    return _line(" ", found, False)


def _line(separator: str, found: list[tuple[str, ...]], trailing: bool) -> Line | str:
    labels, numbers, units = (tuple(column) for column in zip(*found, strict=True))
    if any(labels) and not all(labels):
        return "some numbers have a label, others have none"
    values = tuple(map(float, numbers))
    if any(value in (float("inf"), float("-inf")) for value in values):
        return "a number is too large"
    return Line(separator, labels, units, trailing, values)


def read_header(text: str) -> tuple[str, ...]:
    """Return the names of columns in a line; none if it is no header.

    Examples
    --------
    >>> read_header("time_ms, X (uT), Y (uT)")
    ('time_ms', 'X (uT)', 'Y (uT)')
    >>> read_header("1,2,3")
    ()
    """
    text = text.strip(BLANKS)
    separator = separator_of(text)
    fields = text.split() if separator == " " else text.rstrip(separator + BLANKS).split(separator)
    names = tuple(field.strip(BLANKS).strip('"') for field in fields)
    if not all(_NAME.fullmatch(name) and not _NO_NUMBER.fullmatch(name) for name in names):
        return ()
    return names


def time_scale(name: str, unit: str) -> float | None:
    """Return the microseconds of a unit of a column of times; 0 if its unit is not said, None if it is no time.

    ``T`` is a temperature or a field, not a time.

    Examples
    --------
    >>> time_scale("time", "ms"), time_scale("Millis", ""), time_scale("t", ""), time_scale("T", "")
    (1000.0, 1000.0, 0.0, None)
    """
    if name == "T" or name.lower() not in TIME_NAMES:
        return None
    return TIME_UNITS.get(unit or TIME_NAMES[name.lower()], 0.0)


def may_be_cut(name: str) -> bool:
    """Whether a name may be the end of that of a column of times, with another meaning."""
    whole = [*TIME_NAMES, *(f"{name}_{unit}" for name in ("time", "t", "timestamp") for unit in TIME_UNITS)]
    name = name.lower()
    return time_scale(*name_and_unit(name)) is None and any(text.endswith(name) for text in whole)
