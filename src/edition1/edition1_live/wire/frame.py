"""A frame of a stream, what a parser is and counts, and where frames begin and end among the bytes."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import NamedTuple

WRAP = 1 << 32
"""Sequence numbers and device times [µs] start again from 0 after this: 71.6 minutes."""


class Frame(NamedTuple):
    """What a sensor board sent at one time.

    Attributes
    ----------
    stream
        Stream of the board, such as the number of an IMU; 0 where a format has one stream only.
    sequence
        Number of the frame in its stream, 32 bits, wraps; None where a format has none.
    device_us
        Time by the clock of the board [µs], 32 bits, wraps; None where a format has none.
    values
        Readings, in the unit of the format.
    """

    stream: int
    sequence: int | None
    device_us: int | None
    values: tuple[float, ...]


@dataclass
class Counters:
    """What a parser has seen; whatever it did not accept is counted in exactly one of the others.

    Attributes
    ----------
    frames
        Accepted frames.
    checksum_errors
        Whole packets whose checksum or coding is wrong.
    malformed
        Whole packets or lines with another number of fields, a wrong version, or values out of range.
    oversized
        Runs of bytes without a delimiter, longer than any frame; dropped.
    first_partial
        Beginnings cut off by opening the port in the middle of a frame: 0 or 1 for each opening.
    gaps
        Frames that the sequence numbers say are missing.
    restarts
        Times at which a stream began anew (the board was reset).
    repeats
        Frames equal in every byte to the one before in their stream; dropped.
    discarded_bytes
        Bytes of everything that was not accepted.
    """

    frames: int = 0
    checksum_errors: int = 0
    malformed: int = 0
    oversized: int = 0
    first_partial: int = 0
    gaps: int = 0
    restarts: int = 0
    repeats: int = 0
    discarded_bytes: int = 0

    def as_dict(self) -> dict[str, int]:
        """Names and values."""
        return {field.name: getattr(self, field.name) for field in fields(self)}


class Parser:
    """Bytes in, frames out; chunks may be cut anywhere. The bytes are cut at a delimiter of one byte.

    Parameters
    ----------
    delimiter
        The byte that ends a packet; packets do not hold it.
    longest
        Length of the longest packet [bytes]. A longer run without a delimiter is dropped as it comes, up to the
        next delimiter, and counted as ``oversized``: so no more than this is ever kept.

    Attributes
    ----------
    counters
        What it has seen; ``discarded_bytes`` counts no delimiters.
    refused
        The first whole packet or line that counts as malformed, in words; empty before there is one.
    """

    def __init__(self, delimiter: bytes, longest: int) -> None:
        self.counters = Counters()
        self.refused = ""
        self._delimiter, self._longest = delimiter, longest
        self._begun = b""
        self._oversized, self._opened = False, True

    def feed(self, chunk: bytes) -> list[Frame]:
        """Take the next bytes; return the frames that they complete, in order."""
        frames = self._frames(*self._split(chunk))
        self.counters.frames += len(frames)
        return frames

    def reopened(self) -> None:
        """Forget a packet begun (its bytes count as discarded): the next may be the end of one only."""
        self._drop_begun()
        self._oversized, self._opened = False, True

    def _frames(self, packets: list[bytes], cut: bool) -> list[Frame]:
        """Return the frames in whole packets without delimiters.

        With ``cut`` the first packet is the first since the port was opened: what came before it is not known.
        """
        raise NotImplementedError

    def _refuse(self, size: int, why: str) -> None:
        """Count a whole packet that is malformed; keep in words why the first of them is."""
        self.counters.malformed += 1
        self.counters.discarded_bytes += size
        self.refused = self.refused or why

    def _split(self, chunk: bytes) -> tuple[list[bytes], bool]:
        packets = (self._begun + chunk).split(self._delimiter)
        self._begun = packets.pop()
        cut = False
        if packets:
            cut, self._opened = self._opened, False
            if self._oversized:
                self.counters.discarded_bytes += len(packets.pop(0))
                self._oversized = cut = False
            if packets and max(map(len, packets)) > self._longest:
                cut = cut and len(packets[0]) <= self._longest
                for packet in packets:
                    if len(packet) > self._longest:
                        self.counters.oversized += 1
                        self.counters.discarded_bytes += len(packet)
                packets = [packet for packet in packets if len(packet) <= self._longest]
        if self._oversized:
            self._drop_begun()
        elif len(self._begun) > self._longest:
            self._oversized = True
            self.counters.oversized += 1
            self._drop_begun()
        return packets, cut

    def _drop_begun(self) -> None:
        self.counters.discarded_bytes += len(self._begun)
        self._begun = b""
