"""One frame of a sensor board, whatever the format it came in."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import NamedTuple, Protocol, runtime_checkable


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


@runtime_checkable
class Parser(Protocol):
    """Bytes in, frames out; chunks may be cut anywhere.

    Attributes
    ----------
    counters
        What it has seen.
    refused
        The first whole packet or line that counts as malformed, in words; empty before there is one.
    """

    counters: Counters
    refused: str

    def feed(self, chunk: bytes) -> list[Frame]:
        """Take the next bytes; return the frames that they complete, in order."""
        ...

    def reopened(self) -> None:
        """Forget a frame begun: the port was opened, and the first bytes may be the end of a frame."""
        ...
