"""Lines of numbers as sketches print them: ``1.2,3.4``, ``X: 1.2 uT, Y: -3 uT``, ``x=1.2 y=3``; labels and all.

The form of a line (separator, number of values, labels, units, column of times) is that of the first lines that
agree. Every later line must have it. Nothing is repaired: what does not fit is dropped and counted. The page "Wire
formats" of the book says what such lines cannot detect.
"""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from typing import NamedTuple

from edition1.errors import bad_input
from edition1_live.wire.csv_fields import (
    BLANKS,
    SEPARATORS,
    Line,
    decimal_commas,
    may_be_cut,
    name_and_unit,
    read_header,
    read_line,
    separator_of,
    time_scale,
)
from edition1_live.wire.frame import WRAP, Frame, Parser

AGREEING = 3
"""Lines of one form that fix it."""
MOST_HELD = 32
"""Lines that wait for that, at most."""
MOST_VALUES = 118
LONGEST_LINE = 4096
"""Bytes of a line."""
_LATEST = 1e16
"""Times are below this, in any unit: more has no microseconds any more."""
RESERVED = ("time_s", "host_ns", "stream", "sequence", "device_us")
"""Columns of a recording that no value may be called."""


class Layout(NamedTuple):
    """The form of the lines of a board.

    Attributes
    ----------
    separator, labels, units, trailing
        As in :class:`~edition1_live.wire.csv_fields.Line`.
    header
        Names from a header line; none if there was none.
    """

    separator: str
    labels: tuple[str, ...]
    units: tuple[str, ...]
    trailing: bool
    header: tuple[str, ...] = ()

    @property
    def columns(self) -> list[tuple[str, str]]:
        """Name and unit of every column, the time's too; a unit behind the last number only is that of all."""
        units = list(self.units)
        values = [k for k in range(len(units)) if k != self.time_column]
        if values and units[values[-1]] and not any(units[k] for k in values[:-1]):
            for k in values:
                units[k] = units[values[-1]]
        return self._with_units(units)

    @property
    def time_column(self) -> int | None:
        """Place of the column of times; None without one."""
        pairs = enumerate(self._with_units(self.units))
        return next((k for k, pair in pairs if time_scale(*pair) is not None), None)

    def _with_units(self, units: Sequence[str]) -> list[tuple[str, str]]:
        named = map(name_and_unit, self.header or self.labels)
        return [(name, unit or by_name) for (name, by_name), unit in zip(named, units, strict=True)]

    @property
    def value_units(self) -> list[str]:
        """Units of the values, empty where a line says none."""
        return [unit for k, (_, unit) in enumerate(self.columns) if k != self.time_column]

    @property
    def names(self) -> list[str]:
        """Names of the values with their units, as the columns of a recording; u1, u2, ... where they have none."""
        columns = [column for k, column in enumerate(self.columns) if k != self.time_column]
        plain = [re.sub(r"\W+", "_", name).strip("_") for name, _ in columns]
        numbered = [f"u{k + 1}" for k in range(len(plain))]
        for names in (plain, numbered):
            found = [
                f"{name}_{unit}" if unit else name for name, (_, unit) in zip(names, columns, strict=True)
            ]
            if "" not in names and len(set(found)) == len(found) and not set(found) & set(RESERVED):
                return found
        return numbered

    def __str__(self) -> str:
        """Return it in words, for the screen."""
        n, by = len(self.names), SEPARATORS[self.separator]
        text = f"{n} value{'s' * (n > 1)} a line" + f", separated by {by}" * (len(self.units) > 1)
        text += f": {', '.join(self.names)}"
        if (k := self.time_column) is None:
            return text
        name, unit = self.columns[k]
        if time_scale(name, unit):
            return f"{text}; times in {name}"
        return f"{text}; {name} is a time without a unit and is left out, times are those of arrival"


class CsvParser(Parser):
    """Parser of lines of numbers.

    The first line after an opening is dropped, as by :class:`edition1_live.wire.text.TextParser`, but may be a header.
    The first lines wait until :data:`AGREEING` of them agree. Empty lines mean nothing; a header that comes again
    counts as a restart, and after another header nothing is accepted.

    Parameters
    ----------
    channels
        Values that every line must have, without a time; by default those of the first lines that agree.
    unit
        What lines must say if they say a unit; otherwise `feed` raises InputError. By default, and for ``raw``, any.
    wrap
        Times start again from 0 after this [µs]: as those of frames do, unless it is more.

    Attributes
    ----------
    layout
        Form of the lines; None before it is known.
    refused
        The first line that was not accepted, and why; empty if there is none.
    """

    def __init__(self, channels: int | None = None, unit: str | None = None, *, wrap: int = WRAP) -> None:
        super().__init__(b"\n", LONGEST_LINE)
        self.layout: Layout | None = None
        self._channels, self._unit, self._wrap = channels, unit, wrap
        self._header: tuple[str, ...] = ()
        self._header_separator = ""
        self._other_header = False
        self._held: list[tuple[Layout, Line, bytes]] = []
        self._time: tuple[int, float] | None = None

    def reopened(self) -> None:
        """Forget a line begun, and those that wait; the next one is dropped too."""
        super().reopened()
        self._other_header = False
        while self._held:
            self._drop(self._held.pop(0)[-1], "too few lines before the port was opened anew")

    def _frames(self, packets: list[bytes], cut: bool) -> list[Frame]:
        frames: list[Frame] = []
        if cut:
            self.counters.first_partial += 1
            self.counters.discarded_bytes += len(packets[0])
            self._named(_text(packets.pop(0)), cut=True)
        for raw in packets:
            if raw.removesuffix(b"\r").strip(BLANKS.encode()):
                frames += self._line(raw)
        return frames

    def _line(self, raw: bytes) -> list[Frame]:
        line = read_line(_text(raw))
        if isinstance(line, str):
            if not self._named(_text(raw), cut=False):
                self._drop(raw, line)
            return []
        if self.layout is not None:
            if self._other_header or line[:4] != self.layout[:4]:
                self._drop(raw, self._difference(line))
                return []
            return self._frame(line, raw)
        fits = self._header_separator == line.separator and len(self._header) == len(line.values)
        layout = Layout(*line[:4], header=self._header if fits and not any(line.labels) else ())
        n = len(line.values) - (layout.time_column is not None)
        if decimal_commas(_text(raw)):
            self._drop(raw, "decimal commas, or twice as many numbers?")
        elif not 1 <= n <= MOST_VALUES or (self._channels is not None and n != self._channels):
            self._drop(raw, f"{n} values, not {self._channels or f'1 to {MOST_VALUES}'}")
        else:
            return self._hold(layout, line, raw)
        return []

    def _hold(self, layout: Layout, line: Line, raw: bytes) -> list[Frame]:
        """Keep a line; when enough agree, their form is that of the board."""
        self._held.append((layout, line, raw))
        agreeing = sum(held[0] == layout for held in self._held)
        if agreeing < AGREEING:
            if len(self._held) > MOST_HELD:
                self._drop(self._held.pop(0)[-1], f"no {AGREEING} of the first lines have one form")
            return []
        check_units(layout.names, layout.value_units, self._unit)
        self.layout = layout
        if (k := layout.time_column) is not None:
            self._time = (k, time_scale(*layout.columns[k]) or 0.0)
        held, self._held, frames = self._held, [], []
        for other, numbers, packet in held:
            if other != layout:
                self._drop(packet, self._difference(numbers))
            else:
                frames += self._frame(numbers, packet)
        return frames

    def _frame(self, line: Line, raw: bytes) -> list[Frame]:
        """Return the frame of a line of the right form; none if its time is impossible."""
        if self._time is None:
            return [Frame(0, None, None, line.values)]
        k, scale = self._time
        if not 0 <= line.values[k] <= _LATEST:
            self._drop(raw, f"a time must be from 0 to {_LATEST:g}")
            return []
        device_us = round(line.values[k] * scale) % self._wrap if scale else None
        return [Frame(0, None, device_us, line.values[:k] + line.values[k + 1 :])]

    def _named(self, text: str, *, cut: bool) -> bool:
        """Take a header; return whether a line is one. One cut off in front tells the other columns only."""
        names, separator = read_header(text), separator_of(text.strip(BLANKS))
        if self.layout is None:
            if names and not (cut and may_be_cut(names[0])):
                self._header, self._header_separator = names, separator
            return bool(names)
        if len(names) != len(self.layout.units) or separator != self.layout.separator:
            return False
        expected = self.layout.header
        self._other_header = bool(expected) and names[int(cut) :] != expected[int(cut) :]
        if not cut and not self._other_header:
            self.counters.restarts += 1
        return not self._other_header

    def _difference(self, line: Line) -> str:
        """Say why a line does not have the form of the others."""
        assert self.layout is not None
        if self._other_header:
            return "after a header with other names"
        counts = len(line.values), len(self.layout.units)
        if counts[0] != counts[1]:
            return f"{counts[0]} numbers, not {counts[1]}"
        words = ("another separator", "other labels", "other units", "another end")
        pairs = zip(words, line, self.layout, strict=False)
        other = next((word for word, a, b in pairs if a != b), "another header")
        return f"{other} than the lines before"

    def _drop(self, raw: bytes, why: str) -> None:
        self._refuse(len(raw), f"{_text(raw)[:80]!r}: {why}")


def _text(raw: bytes) -> str:
    return raw.removesuffix(b"\r").decode(errors="replace")


def check_units(names: Sequence[str], units: Sequence[str], unit: str | None) -> None:
    """Refuse values that are said to have another unit than expected; ``raw`` and none take any.

    Raises
    ------
    InputError
        If there is one.
    """
    for name, said in zip(names, units, strict=True):
        if said and unit not in (None, "raw") and said.lower() != unit.lower():
            must = f'{said}, as the lines say of {name} (or "raw", with gains in {said}/mT)'
            raise bad_input("unit", "the robot file", must, unit)


def write_line(frame: Frame) -> bytes:
    r"""Return the values of a frame as a line with commas, ``\r\n`` included, in digits that give the same numbers.

    Raises
    ------
    InputError
        If the frame has another stream than 0, no value, too many, or an infinite one.

    Examples
    --------
    >>> write_line(Frame(0, None, None, (1.5, -2.0)))
    b'1.5,-2.0\r\n'
    """
    if frame.stream:
        raise bad_input("stream", "a line of text", "0, the only one", frame.stream)
    if not 1 <= len(frame.values) <= MOST_VALUES or any(map(math.isinf, frame.values)):
        raise bad_input(
            "values", "a line of text", f"1 to {MOST_VALUES} numbers, none infinite", frame.values
        )
    return ",".join(repr(float(value)) for value in frame.values).encode() + b"\r\n"
