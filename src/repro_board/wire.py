"""What a sensor board sends over a wire: numbered frames with a checksum, or lines of text; bytes in, samples out.

The page "Wire formats" of the book states every byte of a frame, every form of line, and what each counter counts.
"""

from __future__ import annotations

import math
import re
import struct
from typing import NamedTuple
from zlib import crc32

import numpy as np
from numpy.typing import ArrayLike

from repro.common import Array, numbers, require
from repro.lines import (
    MARK,
    SECONDS,
    TIMES,
    columns,
    fields,
    is_time,
    name_and_unit,
    names_of,
    of_all,
    plotted,
    separator,
    unit_behind,
    unwrapped,
)

FORMATS = ("frames", "csv", "hall", "millivolts", "quaternions")
COUNTERS = (
    "frames", "checksum_errors", "malformed", "oversized", "first_partial", "gaps", "restarts", "repeats",
    "discarded_bytes",
)  # fmt: skip
DAMAGED = ("checksum_errors", "malformed", "oversized")
"""Of these counters: what was dropped because it is damaged."""
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
        self.counters: dict[str, int] = dict.fromkeys(COUNTERS, 0)
        self.remarks: list[str] = []
        self.format: str | None = None
        self.names: tuple[str, ...] = ()
        self.units: tuple[str, ...] = ()
        self._delimiter, self._longest = delimiter, longest
        self.rest, self._end = b"", 0
        self._oversized, self._opened = False, True
        self._clocks: dict[int, tuple[int, int]] = {}  # by stream: time as sent and without wraps [µs]

    def drop_rest(self) -> None:
        """Forget a packet begun, as after the port was opened again."""
        self._discard(self.rest)
        self.rest, self._oversized, self._opened = b"", False, True

    def _split(self, data: bytes) -> list[tuple[int, bytes, bool]]:
        """Return the packets that the bytes complete: place, content, whether its beginning may be cut off."""
        packets = (self.rest + data).split(self._delimiter)
        at = self._end - len(self.rest)
        self._end += len(data)
        self.rest = packets.pop()
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
        if self._oversized or len(self.rest) > self._longest:
            self._discard(self.rest, "" if self._oversized else "oversized")
            self.rest, self._oversized = b"", True
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
_PRINTED = re.compile(rb"[\t -~]{12}\r?\n")


class _Frames(_Packets):
    """Frames: COBS between two zero bytes, with sequence number, device time and CRC-32."""

    def __init__(self, channels: int | None) -> None:
        from cobs import cobs

        super().__init__(b"\0", _LONGEST_PACKET)
        self._cobs = cobs
        self._layouts = {key: x for key, x in _LAYOUTS.items() if channels in (None, key[1])}
        self._last: dict[int, tuple[int, bytes]] = {}  # by stream: number and bytes of the last frame

    def feed(self, data: bytes) -> list[Sample]:
        found, counters = [], self.counters
        for start, packet, cut in self._split(data):
            if not packet:
                continue
            try:
                body = self._cobs.decode(packet)
            except self._cobs.DecodeError:
                body = b""
            if crc32(body) != _RESIDUE:
                self._discard(packet, "first_partial" if cut else "checksum_errors")
                continue
            size, kind, n = self._layouts.get(body[2:4], (0, None, 0))
            if size != len(body) or body[0] != _VERSION:
                self._discard(packet, "malformed")
                words = f"of another version or number of values ({body[3]} in stream {body[1]})"
                self._remark(f"Left out were frames {words}.")
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
        self.format = "frames" if found else self.format
        return found

    def _discard(self, packet: bytes, counter: str = "") -> None:
        super()._discard(packet, counter)
        if _PRINTED.search(packet):
            self._remark("Text arrives among the frames: a board that prints lines has the format csv.")


def encode(
    sample_values: ArrayLike, stream: int = 0, sequence: int = 0, time_us: int = 0, kind: str = "float32"
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
    from cobs import cobs

    return b"\0" + cobs.encode(body + crc32(body).to_bytes(4, "little")) + b"\0"


# ------------------------------------------------------------------------------------------------- lines of numbers
_LONGEST_LINE, _LONGEST_FIELD = 4096, 25
_AGREEING, _AGREEING_PAIRS, _MOST_HELD = 3, 20, 32
"""Lines of one form that fix it; more where pairs of whole numbers may have decimal commas, since one decimal in ten
begins with a zero; and lines that wait for that at most."""
_MOST_COMMAS = 2.5
"""Of the last hundred lines with decimal commas: fewer may be damage."""
_LATEST_US = 1e16
_COMMAS = re.compile(r"[+-]?[0-9]+,[0-9]+(?:(?:,?[ ]+|[ ]*[;\t][ ]*)[+-]?[0-9]+,[0-9]+)+[;,]?")
_PAIRS = re.compile(r"[+-]?[0-9]+,[0-9]{2,}(?:,[+-]?[0-9]+,[0-9]{2,})*")
_QUOTED = re.compile(r'"([^"]*)"')
_COUNT, _DECIMAL = r"(?:0|-?[1-9][0-9]{0,3})", r"-?[0-9]+(?:\.[0-9]+)?(?:[eE][-+]?[0-9]{1,3})?"
_PAPERS = {
    "hall": (f"{_COUNT}(?:,{_COUNT})*", -8192.0, 8191.0, ("z", "y", "x"), "counts"),
    "millivolts": (f"{_DECIMAL}(?:,{_DECIMAL})*", 0.0, 2048.0, (), "mV"),
    "quaternions": (rf"(?:0|[1-9][0-9]{{0,2}})(?:, ?{_DECIMAL})*", -1.001, 1.001, ("x", "y", "z", "w"), ""),
}
"""Of the lines of the papers: form, range (14 bits of an MLX90363; Baaij et al., section 5.1), names, unit."""
NORM_TOLERANCE = 1e-3
"""How far the norm of a quaternion may be from 1: four decimals stay within, two do not."""


class _Lines(_Packets):
    """Lines of numbers as sketches print them, whose form is that of the first that agree; or those of a paper."""

    def __init__(self, format: str | None, channels: int | None) -> None:
        super().__init__(b"\n", _LONGEST_LINE)
        self._channels, self._paper = channels, re.compile(b"")
        self._form, self._separator, self._header = "", "", ()
        self._closed = ""  # why nothing is accepted any more
        self._held: list[tuple[str, str, int, bytes]] = []  # lines that wait: form, text, place and bytes
        self._group: dict[str, str] = {}  # lines of one number each, which make one line
        self._time: tuple[int, float] | None = None  # column of the times, and its unit [µs]
        self._commas, self._seen_newline = 0.0, False
        self._accepted = self._misfits = (
            0  # lines since the form was fixed, and how many in a row have another
        )
        if format in _PAPERS:
            self._read_as(str(format), channels or 3)

    def _read_as(self, format: str, n: int) -> None:
        form, *_, names, unit = _PAPERS[format]
        self.format, self._paper, self.names = format, re.compile(form.encode()), names or _numbered(n)
        self.units = (unit,) * len(self.names)
        self._longest = _LONGEST_FIELD * (len(self.names) + (format == "quaternions"))

    def feed(self, data: bytes) -> list[Sample]:
        found: list[Sample] = []
        self._seen_newline = self._seen_newline or b"\n" in data
        if not self._seen_newline and (self.rest + data).count(b"\r") > _AGREEING:
            self._delimiter, self._seen_newline = b"\r", True
        for start, packet, cut in self._split(data):
            text = _plain(packet)
            if cut:
                self._discard(packet, "first_partial")
                self._take_names(text, cut=True)
            elif text:
                read = self._of_paper if self.format in _PAPERS else self._line
                found += read(text, packet, start)
        return found

    def drop_rest(self) -> None:
        super().drop_rest()
        held, self._held, self._group, self._closed = self._held, [], {}, ""
        for *_, packet in held:
            self._drop(packet, f"fewer than {_AGREEING} lines of one form")

    def _of_paper(self, _: str, packet: bytes, start: int) -> list[Sample]:
        line, stream, norm = packet.removesuffix(b"\r"), 0, 1.0
        low, high = _PAPERS[str(self.format)][1:3]
        if self._paper.fullmatch(line):
            values = np.array(line.split(b","), dtype=np.float64)
            if self.format == "quaternions":  # number, w, x, y, z
                stream, values = int(values[0]), np.roll(values[1:], -1)
                norm = float(np.linalg.norm(values))
            fits = len(values) == len(self.names) and stream <= 255 and abs(norm - 1) <= NORM_TOLERANCE
            if fits and low <= values.min() and values.max() <= high:
                return [Sample(stream, None, None, start, values)]
        of_norm = f", of norm 1 within {NORM_TOLERANCE:g}" if self.format == "quaternions" else ""
        self._drop(packet, f"no line of {self.format}{of_norm}")
        return []

    def _line(self, text: str, packet: bytes, start: int) -> list[Sample]:
        """Return the samples that a line completes."""
        if single := plotted(text):
            name, line = single[0], ",".join(self._group.values())
            whole = name in self._group or len(self._group) > MOST_VALUES
            self._group = ({} if whole else self._group) | {name: ":".join(single)}
            return self._line(line, line.encode(), start) if whole else []
        form, cells = fields(text)
        values = [float(cell or "nan") for cell in cells]
        if f"{form}{MARK}" == self._form:  # the last field is empty
            form, values = self._form, [*values, math.nan]
        if form == self._form and not self._closed:
            return self._sample(values, packet, start)
        found = columns(form)
        if not found and self._take_names(text):
            return []
        if _COMMAS.fullmatch(text) or (not found and _PAIRS.fullmatch(text)):
            self._drop(packet, why := "numbers must have decimal points, not commas")
            self._commas += 1
            if self._commas > _MOST_COMMAS:
                self._closed = why
                self._remark(f"Nothing is read: {why}.")
        elif self._closed or self._form or not found:
            self._misfits += bool(found and self._accepted <= _MOST_HELD)
            if self._misfits > _MOST_HELD:  # what fixed the form was printed before the data
                self._form, self._misfits, self._accepted = "", 0, 0
            other = f"{len(found)} numbers in another form than the lines before"
            self._drop(packet, self._closed or (other if found else "not a line of numbers"))
        else:
            return self._hold(found, (form, text, start, packet))
        return []

    def _hold(self, found: tuple[tuple[str, str], ...], line: tuple[str, str, int, bytes]) -> list[Sample]:
        """Keep a line; when enough agree, their form is that of the board."""
        form, text, _, packet = line
        named, clock = self._named(found, form)
        n = len(found) - (clock is not None)
        if not 1 <= n <= MOST_VALUES or self._channels not in (None, n) or not any(fields(text)[1]):
            self._drop(packet, f"{n} numbers, not {self._channels or f'1 to {MOST_VALUES}'}")
            return []
        self._held.append(line)
        texts = [text for other, text, *_ in self._held if other == form]
        pairs = self._channels is None and all(map(_PAIRS.fullmatch, texts))
        widths = {len(field) for text in texts for field in text.split(",")[1::2]}
        if len(texts) < (_AGREEING_PAIRS if pairs and len(widths) == 1 else _AGREEING):
            if len(self._held) > _MOST_HELD:
                self._drop(self._held.pop(0)[3], f"no {_AGREEING} of the first lines have one form")
            return []
        held, self._held, read = self._held, [], self._line
        quaternion = _Lines("quaternions", 4)._of_paper
        if self._channels in (None, 4) and all(quaternion("", text.encode(), 0) for text in texts):
            self._read_as("quaternions", 4)
            read = self._of_paper
        else:
            self._fix(named, clock, form)
        return [sample for _, text, start, packet in held for sample in read(text, packet, start)]

    def _named(
        self, found: tuple[tuple[str, str], ...], form: str
    ) -> tuple[list[tuple[str, str]], int | None]:
        """Return names and units of the columns, by labels or a header, and which of them is the time."""
        names = [label for label, _ in found]
        if not any(names) and len(self._header) == len(names) and self._separator == separator(form):
            names = list(self._header)
        split = [(name_and_unit(name), unit) for name, (_, unit) in zip(names, found, strict=True)]
        named = [(name, unit_behind(said) or unit) for (name, unit), said in split]
        return named, next((k for k, x in enumerate(named) if _time_scale(*x) is not None), None)

    def _fix(self, named: list[tuple[str, str]], clock: int | None, form: str) -> None:
        self.format, self._form, self._time = "csv", form, None
        if self._header and len(self._header) != len(named) and self._separator != " ":
            self._remark(f"{len(self._header)} names stand before lines of {len(named)} numbers: not used.")
        if clock is not None:
            self._time = clock, _time_scale(*named.pop(clock)) or 0.0
            if not self._time[1]:
                self._remark("The column of times has no unit and is left out; times are those of arrival.")
        names, units = zip(*named, strict=True)
        units = tuple(of_all(units))
        if "" in names or len(set(names)) < len(names):
            names = _numbered(len(names)) if any((*names, *units)) else ()
        self.names, self.units = names, units[: len(names)]

    def _sample(self, values: list[float], packet: bytes, start: int) -> list[Sample]:
        """Return the sample of a line of the right form; none if a number is impossible."""
        time_us = None
        if self._time is not None:
            clock, scale = self._time
            sent_us = values.pop(clock) * scale
            if not 0 <= sent_us <= _LATEST_US:
                values.append(math.inf)
            elif scale:
                time_us = self._unwrapped(0, round(sent_us), False)
        if any(map(math.isinf, values)):
            self._drop(packet, "a number is too large, or the time is missing or negative")
            return []
        self._commas *= 0.99
        self._misfits, self._accepted = 0, self._accepted + 1
        return [Sample(0, None, time_us, start, np.array(values))]

    def _take_names(self, text: str, *, cut: bool = False) -> bool:
        """Take a header; return whether a line is one. One cut off in front tells the other columns only."""
        names, mark = names_of(text), separator(text)
        if not names:
            return False
        if self._form:
            if (len(names), mark) != (self._form.count(MARK), separator(self._form)):
                if mark != " " and self._accepted <= _MOST_HELD:  # the data begin here
                    self._form, self._header, self._separator = "", names, mark
                return not self._form
            same = names[int(cut) :] == self._header[int(cut) :] or not self._header
            self._closed = "" if same else "after a header with other names"
            self.counters["restarts"] += same and not cut
            return same
        if not (cut and _may_be_cut(names[0])):
            self._header, self._separator = names, mark
            while self._held and mark != " ":
                self._drop(self._held.pop()[3], "before the names of the columns")
        return True

    def _drop(self, packet: bytes, why: str) -> None:
        self._discard(packet, "malformed")
        if self.counters["malformed"] == 1:
            self._remark(f"Left out were lines such as {_plain(packet)[:80]!r}: {why}.")


def _plain(packet: bytes) -> str:
    """Return the text of a line without quotes and what Python or JSON put round it."""
    text = packet.decode(errors="replace").strip().replace(MARK, "\ufffd")
    return unwrapped(_QUOTED.sub(r"\1", text)).strip()


def _numbered(n: int) -> tuple[str, ...]:
    return tuple(f"u{k + 1}" for k in range(n))


def _time_scale(name: str, unit: str) -> float | None:
    """Return the microseconds of a unit of a column of times, 0 if it is not said; None if the column is no time."""
    return 1e6 * SECONDS.get(unit, 0.0) if is_time(name) else None


def _may_be_cut(name: str) -> bool:
    """Whether a name may be the end of that of a column of times, with another meaning."""
    whole = [*TIMES, *(f"{time}_{unit}" for time in ("time", "t", "timestamp") for unit in SECONDS)]
    return _time_scale(*name_and_unit(name)) is None and any(x.endswith(name.lower()) for x in whole)


def text_line(values: ArrayLike, format: str, stream: int = 0) -> bytes:
    r"""Return the line of text that a board prints, ``\r\n`` included.

    Parameters
    ----------
    values
        Numbers, as many and as large as the format has; in ``csv`` NaN is a missing reading. ``millivolts`` has four
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
    if format == "csv":
        fits = 1 <= len(given) <= MOST_VALUES and not np.isinf(given).any() and stream == 0
        require(fits, "values", owner, f"1 to {MOST_VALUES} numbers of stream 0, none infinite", given)
        return ",".join(map(repr, given.tolist())).encode() + b"\r\n"
    decimals = {"hall": 0, "millivolts": 4, "quaternions": 6}[format]
    fields = [f"{value + 0.0:.{decimals}f}" for value in given.round(decimals)]
    if format == "quaternions":
        fields = [str(stream), *fields[-1:], *fields[:-1]]
    line = ",".join(fields).encode()
    back = _Lines(format, len(given))._of_paper("", line, 0)
    off = np.abs(back[0].values - given).max() if back and back[0].stream == stream else math.inf
    words = {
        "hall": "3 whole numbers",
        "millivolts": "numbers",
        "quaternions": "a stream to 255 and a unit quaternion",
    }
    low, high = _PAPERS[format][1:3]
    require(
        off <= 0.1**decimals * (decimals > 0),
        "values",
        owner,
        f"{words[format]} from {low:g} to {high:g}",
        given,
    )
    return line + b"\r\n"


# ----------------------------------------------------------------------------------------------------------- parser
_UNKNOWN_BYTES = 4096
"""After so many bytes without a frame or lines of one form, that is said."""
_LAST = 32
"""Bytes that a parser keeps, for a person to look at."""


def raw(data: bytes) -> str:
    """Return bytes as text, with a dot for what is none, and in a second line in hex; nothing for no bytes."""
    text = "".join(chr(x) if 32 <= x < 127 else "." for x in data)
    return f"The last {len(data)} bytes as text: {text}\nin hex: {data.hex(' ')}" if data else ""


def is_text(data: bytes) -> bool:
    """Return whether nearly all bytes are printed: with a wrong rate they would not be."""
    return sum(32 <= x < 127 or x in b"\t\r\n" for x in data) > 0.9 * len(data)


class Parser:
    r"""Bytes in, samples out; chunks may be cut anywhere. What is not accepted is counted and is no sample.

    Parameters
    ----------
    format
        One of ``frames``, ``csv``, ``hall``, ``millivolts``, ``quaternions``. Without it the first valid frame, or
        the first three lines that agree, tell; lines of ``hall`` and ``millivolts`` are then read as ``csv``.
    channels
        Values that every sample must have; any number by default.

    Attributes
    ----------
    format
        What arrives; None until it is known.
    names, units
        Of the values, if header or labels say them.
    counters
        Samples, and what was dropped: the page "Wire formats" explains each.
    last
        The last bytes, whatever they are.
    remarks
        What a user should know, one sentence each.

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
        own = len(_PAPERS[format][3]) if format in _PAPERS else 0
        fits = channels is None or (channels == own if own else channels in range(1, MOST_VALUES + 1))
        require(fits, "channels", format or "Parser", str(own or f"1 to {MOST_VALUES}"), channels)
        frames = [_Frames(channels)] if format in (None, "frames") else []
        lines = [_Lines(format, channels)] if format != "frames" else []
        self._readers: list[_Frames | _Lines] = [*frames, *lines]
        self._given, self.last = format, b""
        self._take(self._readers[-1])

    def _take(self, reader: _Frames | _Lines) -> None:
        self.format, self.names, self.units = self._given or reader.format, reader.names, reader.units
        self.counters, self.remarks = reader.counters, reader.remarks

    def feed(self, data: bytes) -> list[Sample]:
        """Take the next bytes; return the samples that they complete, in order."""
        found: list[Sample] = []
        self.last = (self.last + data[-_LAST:])[-_LAST:]
        for reader in self._readers:
            if found := reader.feed(data):
                if isinstance(
                    reader, _Frames
                ):  # lines of numbers may be what a board prints before its frames
                    self._readers = [reader]
                break
        self._take(self._readers[-1])
        self.counters["frames"] += len(found)
        if self.format is None and self.counters["discarded_bytes"] > _UNKNOWN_BYTES:
            words = "No frame and no lines of numbers arrive: are baud rate and format right?"
            self.remarks += [words] * (words not in self.remarks)
        if not found and b"\0" in data and self._given in FORMATS[1:] and _Frames(None).feed(data):
            words = f"Frames arrive among the lines: their format is frames, not {self._given}."
            self.remarks += [words] * (words not in self.remarks)
        return found

    def reopened(self) -> None:
        """Forget what was begun: the port was opened again, and the next bytes may be the end of something only."""
        for reader in self._readers:
            reader.drop_rest()

    def close(self) -> None:
        """End. A last line without its end may be cut off: it is no sample."""
        reader = self._readers[-1]
        if isinstance(reader, _Lines) and (last := _plain(reader.rest)):
            self.remarks.append(f"The last line has no end and was left out: {last[:80]!r}.")
        reader.drop_rest()
