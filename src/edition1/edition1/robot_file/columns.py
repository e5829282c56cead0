"""Which column of a table is which channel of a robot: found by name and unit, never guessed."""

from __future__ import annotations

import re
from collections.abc import Sequence

from edition1.errors import bad_input

_UNITS = ("nT", "uT", "µT", "μT", "mT", "mG", "gauss", "uV", "µV", "mV", "V", "counts", "raw", "deg", "rad")
"""Units that a name may end in after ``_``; in brackets it may have any."""
TIME_UNITS = {"s": 1e6, "sec": 1e6, "ms": 1e3, "us": 1.0, "µs": 1.0, "μs": 1.0}
"""Microseconds of a unit of time."""
TIME_NAMES = {
    **dict.fromkeys(("time", "t", "timestamp"), ""),
    **dict.fromkeys(("seconds", "sec"), "s"),
    **dict.fromkeys(("millis", "milliseconds", "ms"), "ms"),
    **dict.fromkeys(("micros", "microseconds", "us"), "us"),
}
"""Names of a column of times, and the unit that a name says."""
_NAMED_UNIT = re.compile(r"(.*?)[ _]*[(\[][ ]*(.*?)[ ]*[)\]]")
_NUMBERED = re.compile(r"(u|ch|channel|sensor)_?([1-9][0-9]*)", re.IGNORECASE)


def name_and_unit(text: str) -> tuple[str, str]:
    """Split the name of a column from its unit.

    Examples
    --------
    >>> name_and_unit("Mag X (uT)"), name_and_unit("u1_mV"), name_and_unit("time_ms"), name_and_unit("x_1")
    (('Mag X', 'uT'), ('u1', 'mV'), ('time', 'ms'), ('x_1', ''))
    """
    if match := _NAMED_UNIT.fullmatch(text):
        return match[1], match[2]
    name, _, unit = text.rpartition("_")
    if name and (unit in _UNITS or (unit in TIME_UNITS and name.lower() in TIME_NAMES)):
        return name, unit
    return text, ""


def is_numbered(column: str) -> bool:
    """Tell whether the name of a column has the number of a channel or of a sensor."""
    return _NUMBERED.fullmatch(name_and_unit(column)[0]) is not None


def channel_columns(
    owner: str,
    names: Sequence[str],
    unit: str,
    robot: str,
    channels: int,
    used: Sequence[int],
    own: Sequence[str] = (),
) -> list[str | None]:
    """Return the column of every channel; none for channels that no sensor has.

    Parameters
    ----------
    owner
        Of the table, for messages.
    names
        Of its columns.
    unit, robot
        Unit of the readings, and the file that says so.
    channels, used
        Number of channels of the stream, and which of them the sensors have, from 0.
    own
        Names that the format of the stream gives its channels, which count too.

    Raises
    ------
    InputError
        If a column is missing, ambiguous or of another unit.
    """
    found: dict[int, list[str]] = {k: [] for k in range(channels)}
    for column in dict.fromkeys(map(str, names)):
        name, in_unit = name_and_unit(column)
        numbered = _NUMBERED.fullmatch(name)
        if column in own:
            found[own.index(column)].append(column)
        elif numbered:
            k = int(numbered[2]) - 1
            if numbered[1].lower() == "sensor":
                k = used[k] if k < len(used) else channels
            if k in found:
                found[k].append(column)
        else:
            continue
        if in_unit and unit != "raw" and in_unit.lower() != unit.lower():
            raise bad_input(f"column {column}", owner, f"in {unit}, the unit of {robot}", in_unit)
    columns: list[str | None] = [None] * channels
    for sensor, k in enumerate(used):
        if len(found[k]) != 1:
            first = f"{own[k]}, " if own else ""
            expected = f"one column: {first}u{k + 1}_{unit}, channel_{k + 1} or sensor_{sensor + 1}"
            received = (
                f"{', '.join(found[k])}: {len(found[k])}"
                if found[k]
                else f"none among {', '.join(map(str, names))}"
            )
            raise bad_input(f"channel {k + 1}", owner, expected, received)
        (columns[k],) = found[k]
    return columns


FORMATS = ("frames", "hall", "millivolts", "quaternions", "csv")
"""Of a stream: our own frames; the lines of Mitchell et al. [counts], of Baaij et al. [mV], and of Martin et al.
(x, y, z, w); and lines of numbers as sketches print them."""


MAGNETIC_STREAM = 0
"""Stream of the frames that hold the readings of magnetic sensors."""
