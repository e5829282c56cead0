"""What a sensor board sends over a wire: numbered frames with a checksum, or lines of text; bytes in, samples out.

The page "Wire formats" of the book states every byte of a frame, every form of line, and what each counter counts.
"""

from __future__ import annotations

import math
import re
import struct
from collections.abc import Callable
from typing import Any, NamedTuple
from zlib import crc32

import numpy as np
from cobs import cobs

from repro.common import Array, numbers, require
from repro.tables import name_and_unit

FORMATS = ("frames", "csv", "hall", "millivolts", "quaternions")
COUNTERS = (
    "frames", "checksum_errors", "malformed", "oversized", "first_partial", "gaps", "restarts", "repeats",
    "discarded_bytes",
)  # fmt: skip
WRAP = 1 << 32
"""Sequence numbers and times [µs] of a board begin again from 0 after this."""
MOST_VALUES = 118
_LONGEST_SILENCE_US = 60_000_000
"""A clock that goes back has wrapped if less than this passed meanwhile; else the board began anew [µs]."""


class Sample(NamedTuple):
    """What a board sent at one time.

    ``sequence`` and ``time_us`` (by the board's clock, without its wraps) are None where a format has none. A board
    that begins anew begins again with its time. ``start`` is the place of the first byte since the parser began.
    """

    stream: int
    sequence: int | None
    time_us: int | None
    start: int
    values: Array


class _Packets:
    """Bytes cut at a delimiter. Every byte is in a sample, a delimiter, discarded, or in a packet not complete."""

    def __init__(self, delimiter: bytes, longest: int) -> None:
        self.counters = dict.fromkeys(COUNTERS, 0)
        self.remarks: list[str] = []
        self.format: str | None = None
        self.names: tuple[str, ...] = ()
        self.units: tuple[str, ...] = ()
        self._delimiter, self._longest = delimiter, longest
        self._rest, self._end = b"", 0
        self._oversized, self._opened = False, True
        self._clocks: dict[int, tuple[int, int]] = {}  # by stream: time as sent and without wraps [µs]

    def drop_rest(self) -> None:
        """Forget a packet begun, as after the port was opened again."""
        self._discard(self._rest)
        self._rest, self._oversized, self._opened = b"", False, True

    def _split(self, data: bytes) -> list[tuple[int, bytes, bool]]:
        """Return the packets that the bytes complete: place, content, whether its beginning may be cut off."""
        packets = (self._rest + data).split(self._delimiter)
        at = self._end - len(self._rest)
        self._end += len(data)
        self._rest = packets.pop()
        found = []
        for packet in packets:
            if self._oversized:  # the end of a run that is counted already
                self._discard(packet)
            elif len(packet) > self._longest:
                self._discard(packet, "oversized")
            else:
                found.append((at, packet, self._opened))
            at += len(packet) + 1
            self._oversized = self._opened = False
        if self._oversized or len(self._rest) > self._longest:
            self._discard(self._rest, "" if self._oversized else "oversized")
            self._rest, self._oversized = b"", True
        return found

    def _discard(self, packet: bytes, counter: str = "") -> None:
        self.counters["discarded_bytes"] += len(packet)
        if counter:
            self.counters[counter] += 1

    def _remark(self, text: str) -> None:
        if text not in self.remarks:
            self.remarks.append(text)

    def _unwrapped(self, stream: int, sent_us: int, anew: bool) -> int:
        """Return the time since the board began, without the wraps of its clock."""
        last_us, time_us = self._clocks.get(stream, (sent_us, sent_us))
        passed = sent_us - last_us
        if passed < 0 and passed % WRAP < _LONGEST_SILENCE_US:
            passed %= WRAP
        time_us = sent_us if anew or passed < 0 else time_us + passed
        self._clocks[stream] = sent_us, time_us
        return time_us


# ---------------------------------------------------------------------------------------------------------- frames
_KINDS = {"float32": (1, "<f4", 59), "int16": (2, "<i2", MOST_VALUES)}
"""Number of the type of a frame's values, type, and how many it holds at most: so COBS adds exactly one byte."""
_LONGEST_PACKET = 253
_RESIDUE = 0x2144DF1C
"""CRC-32 of any bytes that are followed by their own CRC-32, lowest byte first."""
_VERSION = 1
_HEAD = struct.Struct("<BBBBII")
_READ_HEAD = struct.Struct("<4xII").unpack_from
_LAYOUTS = {
    bytes([code, n]): (_HEAD.size + n * np.dtype(kind).itemsize + 4, np.dtype(kind), n)
    for code, kind, most in _KINDS.values()
    for n in range(1, most + 1)
}
"""By type and count of the values, as in a frame: its length, the type and the count."""
_PRINTED = re.compile(rb"[\t -~]{12,}\r?\n")


class _Frames(_Packets):
    """Frames: COBS between two zero bytes, with sequence number, device time and CRC-32."""

    def __init__(self, channels: int | None) -> None:
        super().__init__(b"\0", _LONGEST_PACKET)
        self._layouts = {key: x for key, x in _LAYOUTS.items() if channels in (None, key[1])}
        self._last: dict[int, tuple[int, bytes]] = {}  # by stream: number and bytes of the last frame

    def feed(self, data: bytes) -> list[Sample]:
        found, counters = [], self.counters
        for start, packet, cut in self._split(data):
            if not packet:
                continue
            try:
                body = cobs.decode(packet)
            except cobs.DecodeError:
                body = b""
            if crc32(body) != _RESIDUE:
                self._discard(packet, "first_partial" if cut else "checksum_errors")
                continue
            size, kind, n = self._layouts.get(body[2:4], (0, None, 0))
            if size != len(body) or body[0] != _VERSION:
                self._discard(packet, "malformed")
                known = body[0] == _VERSION and _LAYOUTS.get(body[2:4], (0,))[0] == len(body)
                what = f"{body[3]} values in stream {body[1]}" if known else "another version or length"
                self._remark(f"Left out were frames of {what}.")
                continue
            stream = body[1]
            sequence, sent_us = _READ_HEAD(body)
            before, anew = self._last.get(stream), False
            if before is not None and (step := (sequence - before[0]) % WRAP) != 1:
                if packet == before[1]:
                    self._discard(packet, "repeats")
                    continue
                anew = not 1 < step < WRAP // 2
                counters["restarts" if anew else "gaps"] += 1 if anew else step - 1
            self._last[stream] = sequence, packet
            values = np.frombuffer(body, kind, n, _HEAD.size).astype(np.float64)
            found.append(Sample(stream, sequence, self._unwrapped(stream, sent_us, anew), start, values))
        if found:
            self.format = "frames"
            counters["frames"] += len(found)
        return found

    def close(self) -> list[Sample]:
        self.drop_rest()
        return []

    def _discard(self, packet: bytes, counter: str = "") -> None:
        super()._discard(packet, counter)
        if printed := _PRINTED.search(packet):
            line = printed[0].decode().strip()[:60]
            words = f"Text arrives where frames should, such as {line!r}"
            if not any(text.startswith(words[:12]) for text in self.remarks):
                self._remark(f"{words}: a board that prints lines has the format csv.")


def encode(
    sample_values: Any, stream: int = 0, sequence: int = 0, time_us: int = 0, kind: str = "float32"
) -> bytes:
    """Return the bytes of a frame, delimiters included.

    Parameters
    ----------
    sample_values
        1 to 59 numbers for ``float32``, which rounds them and has NaN for a missing reading; 1 to 118 whole numbers
        for ``int16``.
    stream
        0 to 255.
    sequence, time_us
        Number of the frame in its stream, and time of the reading [µs]; both wrap after 32 bits.
    kind
        ``float32`` or ``int16``.

    Raises
    ------
    InputError
        If any of them does not fit.

    Examples
    --------
    >>> encode([1.0], stream=7, sequence=1, time_us=1000).hex(" ")
    '00 06 01 07 01 01 01 01 01 03 e8 03 01 01 01 07 80 3f 7d 30 d6 ee 00'
    """
    owner = "a frame"
    require(kind in _KINDS, "kind", owner, " or ".join(_KINDS), repr(kind))
    code, number, most = _KINDS[kind]
    values = numbers(sample_values, "values", owner, (None,), finite=False)
    require(stream in range(256), "stream", owner, "0 to 255", stream)
    require(min(sequence, time_us) >= 0, "sequence, time_us", owner, "not negative", (sequence, time_us))
    require(1 <= len(values) <= most, "values", owner, f"1 to {most} of {kind}", len(values))
    with np.errstate(over="ignore", invalid="ignore"):
        sent = values.astype(number)
        fits = (sent == values) if kind == "int16" else np.isfinite(sent) | ~np.isfinite(values)
    require(fits.all(), "values", owner, f"numbers that {kind} holds", values)
    body = _HEAD.pack(_VERSION, stream, code, len(values), sequence % WRAP, time_us % WRAP) + sent.tobytes()
    return b"\0" + cobs.encode(body + crc32(body).to_bytes(4, "little")) + b"\0"


# ------------------------------------------------------------------------------------------------- lines of numbers
_LONGEST_LINE, _LONGEST_FIELD = 4096, 25
_AGREEING, _MOST_HELD = 3, 32
"""Lines of one form that fix it, and lines that wait for that at most."""
_AGREEING_PAIRS = 20
"""The same where whole numbers in pairs may be numbers with decimal commas: one digit in ten is a zero."""
_LATEST_US = 1e16
_TIME_UNITS = {"s": 1e6, "sec": 1e6, "seconds": 1e6, "ms": 1e3, "us": 1.0, "ns": 1e-3, "min": 6e7}
"""Microseconds of a unit of time."""
_TIME_NAMES = {
    **dict.fromkeys(("time", "t", "timestamp"), ""),
    **dict.fromkeys(("seconds", "sec"), "s"),
    **dict.fromkeys(("millis", "milliseconds", "ms"), "ms"),
    **dict.fromkeys(("micros", "microseconds", "us"), "us"),
}
_LETTER = "A-Za-zµμΩ°%"
# A leading zero is in no whole number that a sketch prints, but may stand behind a decimal comma.
_NUMBER = r"[+-]?(?:[0-9]+\.[0-9]*|0|[1-9][0-9]*|\.[0-9]+)(?![0-9])(?:[eE][+-]?[0-9]{1,3})?"
_WORD = r"(?i:[+-]?(?:nan|inf|infinity|ovf)|1\.#[a-z]+|#?n/?a|null|none|-)(?![A-Za-z0-9])"
"""A reading that is missing."""
_UNIT = (
    rf"(?![xXbB][0-9]|[eE](?![{_LETTER}])|(?i:nan|inf|ovf)(?![{_LETTER}]))"  # 0x10, 1.5e, and no numbers
    rf"[{_LETTER}][{_LETTER}/²³^*]*(?:[0-9](?![0-9{_LETTER}]))?"
)
_LABEL = r"(?:([^\W\d][\w{}.()\[\]/#°%-]*?)[ ]*[:=][ ]*)?"
_FIELD = re.compile(rf"{_LABEL.format(' ')}({_NUMBER}|{_WORD}|)[ ]*({_UNIT})?")
_ITEM = re.compile(rf"{_LABEL.format('')}({_NUMBER}|{_WORD})(?:[ ]*({_UNIT})(?![ ]*[:=]))?(?:[ ]+|$)")
_NAME = re.compile(r"[^\W\d][\w .()\[\]/²³^*#°%-]*")
_MISSING = re.compile(f"{_WORD}|")
_COMMAS = re.compile(r"[+-]?[0-9]+,[0-9]+(?:(?:,?[ ]+|[ ]*[;\t][ ]*)[+-]?[0-9]+,[0-9]+)+[;,]?")
_PAIRS = re.compile(r"[+-]?[0-9]+,[0-9]{2,}(?:,[+-]?[0-9]+,[0-9]{2,})*")
_WRAPPED = re.compile(r"b'(.*?)(?:\\r)?(?:\\n)?'|[(\[{](.*)[)\]}],?")
"""How Python prints bytes and tuples, and JSON objects."""
_TELEPLOT = re.compile(rf">([^:,|]+):({_NUMBER}|{_WORD})(?:§([^|]*))?(?:\|.*)?")

_WHOLE, _DECIMAL = r"(?:0|-?[1-9][0-9]{0,3})", r"-?[0-9]+(?:\.[0-9]+)?(?:[eE][-+]?[0-9]{1,3})?"
_RANGES = {"hall": (-8192.0, 8191.0), "millivolts": (0.0, 2048.0), "quaternions": (-1.001, 1.001)}
"""Of the lines of the papers: 14 bits of an MLX90363 [counts]; Baaij et al., section 5.1 [mV]; a unit quaternion."""
_COLUMNS = {"hall": ("z", "y", "x"), "quaternions": ("x", "y", "z", "w")}
_UNITS = {"hall": "counts", "millivolts": "mV", "quaternions": ""}
NORM_TOLERANCE = 1e-3
"""How far the norm of a quaternion may be from 1: four decimals stay within, two do not."""


class _Form(NamedTuple):
    """All of a line but its numbers; ``trailing``: a separator stands behind the last one."""

    separator: str
    labels: tuple[str, ...]
    units: tuple[str, ...]
    trailing: bool


class _Held(NamedTuple):
    """A line that waits for others of its form."""

    form: _Form
    values: list[float]
    start: int
    packet: bytes


class _Lines(_Packets):
    """Lines of numbers as sketches print them, whose form is that of the first that agree; or those of a paper."""

    def __init__(self, format: str | None, channels: int | None) -> None:
        paper = _RANGES.get(format or "")
        n = channels or len(_COLUMNS.get(format or "", "123"))
        super().__init__(b"\n", _LONGEST_FIELD * (n + (n == 4)) if paper else _LONGEST_LINE)
        self._channels, self._paper = channels, None
        self._form: _Form | None = None
        self._header: tuple[str, ...] = ()
        self._header_separator = ""
        self._closed = False  # after another header or decimal commas nothing is accepted
        self._held: list[_Held] = []
        self._group: list[tuple[str, str]] = []  # lines of one number each: name and field
        self._group_start = 0
        self._time: tuple[int, float] | None = None  # column of the times, and its unit [µs]
        self._commas = 0
        self._seen_newline = False
        if paper:
            self._read_as(str(format), n)

    def _read_as(self, format: str, n: int) -> None:
        self.format, self._paper = format, _paper_line(format, n)
        self.names = _COLUMNS.get(format, tuple(f"u{k + 1}" for k in range(n)))
        self.units = (_UNITS[format],) * n

    def feed(self, data: bytes) -> list[Sample]:
        found: list[Sample] = []
        self._seen_newline = self._seen_newline or b"\n" in data
        if not self._seen_newline and (self._rest + data).count(b"\r") > _AGREEING:
            self._delimiter, self._seen_newline = b"\r", True
        for start, packet, cut in self._split(data):
            if cut:
                self._discard(packet, "first_partial")
                if not self._paper:
                    self._take_names(_plain(packet), cut=True)
            elif self._paper:
                found += self._sample_of_paper(packet, start)
            elif text := _plain(packet):
                found += self._line(text, packet, start)
        self.counters["frames"] += len(found)
        return found

    def drop_rest(self) -> None:
        super().drop_rest()
        self._closed, self._group, held = False, [], self._held
        self._held = []
        for line in held:
            self._drop(line.packet, f"fewer than {_AGREEING} lines of one form")

    def close(self) -> list[Sample]:
        if last := _plain(self._rest):
            self._remark(f"The last line has no end and was left out: {last[:80]!r}.")
        self.drop_rest()
        return []

    def _sample_of_paper(self, packet: bytes, start: int) -> list[Sample]:
        found = self._paper(packet) if self._paper else None
        if found is None:
            self._drop(packet, f"no line of {self.format}")
            return []
        return [Sample(found[0], None, None, start, found[1])]

    def _line(self, text: str, packet: bytes, start: int) -> list[Sample]:
        """Return the samples that a line completes."""
        if single := _TELEPLOT.fullmatch(text):
            name, group = single[1].strip(), self._group
            whole = any(name == other for other, _ in group)
            line = ", ".join(field for _, field in group)
            begun = self._group_start
            self._group = [*([] if whole else group), (name, f"{name}: {single[2]} {single[3] or ''}")]
            self._group_start = begun if group and not whole else start
            return self._line(line, line.encode(), begun) if whole else []
        n = len(self._form.labels) if self._form else len(self._header)
        line = _read_line(text, n)
        if _COMMAS.fullmatch(text) or (isinstance(line, str) and _PAIRS.fullmatch(text)):
            self._drop(packet, "numbers must have decimal points, not commas")
            self._commas += 1
            if self._commas >= _AGREEING and 100 * self._commas > self.counters["frames"]:
                self._closed, self._form, self._held = True, None, []
                self._remark(
                    "Numbers must have decimal points: the lines have decimal commas, nothing is read."
                )
        elif isinstance(line, str):
            if not self._take_names(text):
                self._drop(packet, line)
        elif self._closed:
            self._drop(packet, "after other names or decimal commas")
        elif self._form is None:
            return self._hold(_Held(*line, start, packet))
        elif line[0] != self._form:
            self._drop(packet, _difference(line[0], self._form))
        else:
            return self._sample(line[1], start, packet)
        return []

    def _hold(self, line: _Held) -> list[Sample]:
        """Keep a line; when enough agree, their form is that of the board."""
        clock = self._columns(line.form)[2]
        n = len(line.values) - (clock is not None)
        if not 1 <= n <= MOST_VALUES or self._channels not in (None, n) or all(map(math.isnan, line.values)):
            self._drop(line.packet, f"{n} numbers, not {self._channels or f'1 to {MOST_VALUES}'}")
            return []
        self._held.append(line)
        agreeing = [other for other in self._held if other.form == line.form]
        texts = [_plain(other.packet) for other in agreeing]
        pairs = self._channels is None and all(map(_PAIRS.fullmatch, texts))
        pairs = pairs and len({len(field) for text in texts for field in text.split(",")[1::2]}) == 1
        if len(agreeing) < (_AGREEING_PAIRS if pairs else _AGREEING):
            if len(self._held) > _MOST_HELD:
                self._drop(self._held.pop(0).packet, f"no {_AGREEING} of the first lines have one form")
            return []
        held, self._held, found = self._held, [], []
        quaternion = _paper_line("quaternions", 4)
        if self._channels in (None, 4) and all(quaternion(other.packet) for other in agreeing):
            self._read_as("quaternions", 4)
        else:
            self._fix(line.form)
        for other in held:
            if other.form != line.form:
                self._drop(other.packet, _difference(other.form, line.form))
            elif self._paper:
                found += self._sample_of_paper(other.packet, other.start)
            else:
                found += self._sample(other.values, other.start, other.packet)
        return found

    def _columns(self, form: _Form) -> tuple[list[str], list[str], int | None]:
        """Return names and units of the columns, and which of them is the time."""
        fits = self._header_separator == form.separator and len(self._header) == len(form.labels)
        split = [name_and_unit(x) for x in (form.labels if any(form.labels) or not fits else self._header)]
        units = [own or unit for own, (_, unit) in zip(form.units, split, strict=True)]
        clocks = (k for k, (name, _) in enumerate(split) if _time_scale(name, units[k]) is not None)
        return [name for name, _ in split], units, next(clocks, None)

    def _fix(self, form: _Form) -> None:
        names, units, clock = self._columns(form)
        self.format, self._form = "csv", form
        if self._header and len(self._header) != len(names) and self._header_separator != " ":
            self._remark(f"{len(self._header)} names stand before lines of {len(names)} numbers: not used.")
        if clock is not None:
            scale = _time_scale(names.pop(clock), units.pop(clock))
            self._time = clock, scale or 0.0
            if not scale:
                self._remark("The column of times has no unit and is left out; times are those of arrival.")
        if units[-1] and not any(units[:-1]):
            units = units[-1:] * len(units)
        if not all(names) or len(set(names)) < len(names):
            names = [f"u{k + 1}" for k in range(len(names))] if any(names) or any(units) else []
        self.names, self.units = tuple(names), tuple(units) if names else ()

    def _sample(self, values: list[float], start: int, packet: bytes) -> list[Sample]:
        """Return the sample of a line of the right form; none if its time is impossible."""
        sent_us = None
        if self._time is not None:
            clock, scale = self._time
            time = values.pop(clock)
            if not 0 <= time * scale <= _LATEST_US:
                self._drop(packet, "no time")
                return []
            sent_us = self._unwrapped(0, round(time * scale), False) if scale else None
        return [Sample(0, None, sent_us, start, np.array(values))]

    def _take_names(self, text: str, *, cut: bool = False) -> bool:
        """Take a header; return whether a line is one. One cut off in front tells the other columns only."""
        names, separator = _read_names(text), _separator(text)
        if self._form is None:
            if names and not (cut and _may_be_cut(names[0])):
                self._header, self._header_separator = names, separator
                for line in self._held if separator != " " else []:
                    self._drop(line.packet, "before the names of the columns")
                self._held = self._held if separator == " " else []
            return bool(names)
        if len(names) != len(self._form.labels) or separator != self._form.separator:
            return False
        self._closed = bool(self._header) and names[int(cut) :] != self._header[int(cut) :]
        if not cut and not self._closed:
            self.counters["restarts"] += 1
        return not self._closed

    def _drop(self, packet: bytes, why: str) -> None:
        self._discard(packet, "malformed")
        if self.counters["malformed"] == 1:
            self._remark(
                f"Left out were lines such as {packet[:80].decode(errors='replace').strip()!r}: {why}."
            )


def _plain(packet: bytes) -> str:
    """Return the text of a line without quotes and what Python or JSON put round it."""
    text = packet.decode(errors="replace").strip().replace('"', "")
    wrapped = _WRAPPED.fullmatch(text)
    return (wrapped[1] or wrapped[2] or "").strip() if wrapped else text


def _separator(text: str) -> str:
    return next((mark for mark in ";,\t" if mark in text), " ")


def _read_line(text: str, n: int) -> tuple[_Form, list[float]] | str:
    """Return form and numbers of a line, NaN where one is missing; or in words why it is none.

    Behind the last separator stands nothing, unless ``n`` fields are expected: then the last one is missing.
    """
    separator, trailing, found, at = _separator(text), False, [], 0
    if separator == " ":
        while at < len(text):
            match = _ITEM.match(text, at)
            if match is None:
                return f"{text[at:]!r} is no number"
            found.append(match.groups(default=""))
            at = match.end()
    else:
        fields = [field.strip() for field in text.split(separator)]
        trailing = not fields[-1] and len(fields) != n
        for field in fields[:-1] if trailing else fields:
            match = _FIELD.fullmatch(field)
            if match is None or (match[3] and not match[2]):
                return f"{field!r} is no number"
            found.append(match.groups(default=""))
    labels, printed, units = zip(*found, strict=True)
    values = [math.nan if _MISSING.fullmatch(x) else float(x) for x in printed]
    if any(labels) and not all(labels):
        return "some numbers have a label, others have none"
    if any(map(math.isinf, values)):
        return "a number is too large"
    return _Form(separator, labels, units, trailing), values


def _read_names(text: str) -> tuple[str, ...]:
    """Return the names of columns in a line; none if it is no header."""
    separator = _separator(text)
    fields = text.split() if separator == " " else text.rstrip(separator + " ").split(separator)
    names = tuple(field.strip() for field in fields)
    return names if all(_NAME.fullmatch(name) and not _MISSING.fullmatch(name) for name in names) else ()


def _difference(form: _Form, usual: _Form) -> str:
    """Say why a line does not have the form of the others."""
    counts = len(form.labels), len(usual.labels)
    if counts[0] != counts[1]:
        return f"{counts[0]} numbers, not {counts[1]}"
    words = ("another separator", "other labels", "other units", "another end")
    return (
        next(word for word, a, b in zip(words, form, usual, strict=True) if a != b) + " than the lines before"
    )


def _time_scale(name: str, unit: str) -> float | None:
    """Return the microseconds of a unit of a column of times, 0 if it is not said; None if the column is no time."""
    if name == "T" or name.lower() not in _TIME_NAMES:  # T is a temperature or a field
        return None
    return _TIME_UNITS.get(unit or _TIME_NAMES[name.lower()], 0.0)


def _may_be_cut(name: str) -> bool:
    """Whether a name may be the end of that of a column of times, with another meaning."""
    whole = [*_TIME_NAMES, *(f"{time}_{unit}" for time in ("time", "t", "timestamp") for unit in _TIME_UNITS)]
    return _time_scale(*name_and_unit(name)) is None and any(x.endswith(name.lower()) for x in whole)


def _paper_line(format: str, n: int) -> Callable[[bytes], tuple[int, Array] | None]:
    """Return what reads a line of a paper: stream and values, or None where a character or a value is impossible."""
    low, high = _RANGES[format]
    first, field = {"hall": (_WHOLE, f",{_WHOLE}"), "millivolts": (_DECIMAL, f",{_DECIMAL}")}.get(
        format, ("(?:0|[1-9][0-9]{0,2})", f",[ ]?{_DECIMAL}")
    )
    form = re.compile(f"{first}(?:{field}){{{n - (format != 'quaternions')}}}".encode())

    def read(line: bytes) -> tuple[int, Array] | None:
        line = line.removesuffix(b"\r")
        if not form.fullmatch(line):
            return None
        values, stream = np.array(line.split(b","), dtype=np.float64), 0
        if format == "quaternions":
            stream, values = int(values[0]), np.roll(values[1:], -1)  # w, x, y, z on the line
            if stream > 255 or abs(np.linalg.norm(values) - 1) > NORM_TOLERANCE:
                return None
        return (stream, values) if (low <= values).all() and (values <= high).all() else None

    return read


def text_line(values: Any, format: str, stream: int = 0) -> bytes:
    r"""Return the line of text that a board prints, ``\r\n`` included.

    Parameters
    ----------
    values
        Numbers, NaN where a reading is missing: as many and as large as the format has. ``millivolts`` has four
        decimals, ``quaternions`` (x, y, z, w) six, ``csv`` all digits.
    format
        ``csv``, ``hall``, ``millivolts`` or ``quaternions``.
    stream
        Number of the IMU; 0 for the other formats.

    Raises
    ------
    InputError
        If the line would not be read as what was given.

    Examples
    --------
    >>> text_line([1.5, -2.0], "csv"), text_line([0.0625, -0.25, 0.5, 0.826797], "quaternions", 3)
    (b'1.5,-2.0\r\n', b'3,0.826797,0.062500,-0.250000,0.500000\r\n')
    """
    owner = f"a line of {format}"
    require(format in FORMATS[1:], "format", "text_line", " or ".join(FORMATS[1:]), repr(format))
    given = numbers(values, "values", owner, (None,), finite=False)
    require(stream == 0 or format == "quaternions", "stream", owner, "0, the only one", stream)
    if format == "csv":
        fits = 1 <= len(given) <= MOST_VALUES and not np.isinf(given).any()
        require(fits, "values", owner, f"1 to {MOST_VALUES} numbers, none infinite", given)
        return ",".join(map(repr, given.tolist())).encode() + b"\r\n"
    decimals = {"hall": 0, "millivolts": 4, "quaternions": 6}[format]
    fields = [f"{value + 0.0:.{decimals}f}" for value in given.round(decimals)]
    if format == "quaternions":
        fields = [str(stream), *fields[-1:], *fields[:-1]]
    line, n = ",".join(fields).encode(), len(_COLUMNS.get(format, given))
    read = _paper_line(format, n)(line) if len(given) == n else None
    same = read is not None and np.abs(read[1] - given).max() <= 0.51 * 10.0**-decimals * (decimals > 0)
    require(same, "values", owner, f"{n} from {_RANGES[format][0]:g} to {_RANGES[format][1]:g}", given)
    return line + b"\r\n"


# ----------------------------------------------------------------------------------------------------------- parser
_UNKNOWN_BYTES = 4096
"""After so many bytes without a frame or lines of one form, that is said."""


class Parser:
    r"""Bytes in, samples out; chunks may be cut anywhere. What is not accepted is counted and is no sample.

    Parameters
    ----------
    format
        One of ``frames``, ``csv``, ``hall``, ``millivolts``, ``quaternions``. Without it the first valid frame, or
        the first three lines that agree, tell; lines of ``hall`` and ``millivolts`` are then read as ``csv``.
    channels
        Values that every sample must have; any number by default.

    Raises
    ------
    InputError
        If there is no such format, or it cannot have that many values.

    Examples
    --------
    >>> hall = Parser("hall")
    >>> [sample.values.tolist() for sample in hall.feed(b"34,5\r\n12,-7,2310\r\n12,-7,23")]
    [[12.0, -7.0, 2310.0]]
    >>> hall.counters["first_partial"], hall.names, hall.units[0]
    (1, ('z', 'y', 'x'), 'counts')
    """

    def __init__(self, format: str | None = None, channels: int | None = None) -> None:
        require(format in (None, *FORMATS), "format", "Parser", f"one of {', '.join(FORMATS)}", repr(format))
        own = len(_COLUMNS.get(format or "", ()))
        fits = channels is None or (channels == own if own else channels in range(1, MOST_VALUES + 1))
        require(fits, "channels", f"{format or 'Parser'}", str(own or f"1 to {MOST_VALUES}"), channels)
        frames = [_Frames(channels)] if format in (None, "frames") else []
        self._readers: list[_Frames | _Lines] = (
            frames if format == "frames" else [*frames, _Lines(format, channels)]
        )
        self._format = format

    @property
    def _reader(self) -> _Frames | _Lines:
        return self._readers[-1]

    @property
    def format(self) -> str | None:
        """What arrives; None until it is known."""
        return self._format or self._reader.format

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the values, if header or labels say them."""
        return self._reader.names

    @property
    def units(self) -> tuple[str, ...]:
        """Units of the values, empty where none is said."""
        return self._reader.units

    @property
    def counters(self) -> dict[str, int]:
        """Samples, and what was dropped: the page "Wire formats" explains each."""
        return self._reader.counters

    @property
    def remarks(self) -> list[str]:
        """What a user should know, one sentence each."""
        dropped = self.counters["discarded_bytes"]
        if self.format is None and dropped > _UNKNOWN_BYTES:
            unknown = f"No frame and no lines of numbers in {dropped} bytes: are baud rate and format right?"
            return [unknown, *self._reader.remarks]
        return self._reader.remarks

    def feed(self, data: bytes) -> list[Sample]:
        """Take the next bytes; return the samples that they complete, in order."""
        for reader in self._readers:
            found = reader.feed(data)
            if found and len(self._readers) > 1:
                self._readers = [reader]
            if found:
                return found
        return []

    def reopened(self) -> None:
        """Forget what was begun: the port was opened again, and the next bytes may be the end of something only."""
        for reader in self._readers:
            reader.drop_rest()

    def close(self) -> list[Sample]:
        """End: return the samples that waited. A last line without its end may be cut off, and is none."""
        return self._reader.close()
