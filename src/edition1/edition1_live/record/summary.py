"""What a recorder says of what came: a recording in numbers and words, and bytes that hold no frame of its format."""

from __future__ import annotations

import math
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from edition1.errors import InputError, bad_input
from edition1.robot_file.columns import FORMATS
from edition1_live.wire.csv_text import Layout
from edition1_live.wire.formats import channel_names, parser
from edition1_live.wire.frame import Frame

_DROPPED = ("malformed", "checksum_errors", "oversized")


@dataclass(frozen=True)
class Summary:
    """What a recording holds, as its sidecar tells.

    Attributes
    ----------
    path
        The file; None if no frame came, so that none was written.
    counters
        Those of `edition1_live.wire.frame.Counters`, ``reconnects`` and ``received_bytes``.
    seconds
        How long it was recorded.
    refused
        The first whole line or frame that was malformed, in words.
    """

    path: Path | None
    counters: dict[str, int]
    seconds: float
    refused: str = ""

    @property
    def dropped(self) -> int:
        """Whole lines or frames that were not accepted, and so not recorded."""
        return sum(self.counters.get(name, 0) for name in _DROPPED)

    @property
    def mostly_dropped(self) -> bool:
        """Whether more was dropped than accepted."""
        return self.dropped > self.counters["frames"]

    def losses(self) -> str:
        """Return in words what was dropped, and how the first of it looked; empty if nothing was."""
        if not self.dropped:
            return ""
        parts = [
            f"{self.counters[name]} {name.replace('_', ' ')}" for name in _DROPPED if self.counters.get(name)
        ]
        total = self.dropped + self.counters["frames"]
        first = f"; the first: {self.refused}" if self.refused else ""
        return f"{self.dropped} of {total} lines or frames were dropped ({', '.join(parts)}){first}."

    def __str__(self) -> str:
        """Return one line for the screen: frames, and everything else that is not zero."""
        rate = self.counters["frames"] / self.seconds if self.seconds else 0.0
        names = {"received_bytes": "bytes", "discarded_bytes": "bytes discarded"}
        others = [
            f"{number} {names.get(name, name.replace('_', ' '))}"
            for name, number in self.counters.items()
            if number and name != "frames"
        ]
        return ", ".join([f"{self.seconds:.0f} s: {self.counters['frames']} frames ({rate:.1f}/s)", *others])


def channels_of(format: str, width: int, layout: Layout | None) -> dict[str, Any]:
    """Return metadata on the values of a frame: their names, and of lines with labels all that these say."""
    if layout is None:
        return {"channels": channel_names(format, width)}
    return {"channels": layout.names, "units": layout.value_units, "lines": str(layout)}


_GARBAGE_S = 2.0
"""Bytes that hold no frame for this long are not of the format [s]."""
_GARBAGE_BYTES = {"frames": 520, "hall": 200, "millivolts": 200, "quaternions": 250, "csv": 200}
"""Fewer bytes than these say nothing, whatever the time: a whole frame or line may be missing yet."""
_KEPT_BYTES = 16384
"""First bytes kept to find the format that they are of."""
_FITTING = 0.95
"""Share of the lines that must fit a format for it to be recommended."""
_SHOWN_BYTES = 60
"""Of the first line, in a message."""


class Suspect:
    """Bytes after an opening that hold no frame so far."""

    def __init__(self, format: str, channels: int | None = None) -> None:
        self.format = format
        self.channels = channels
        self.bytes = bytearray()
        self.count = 0
        self.since = math.inf

    def add(self, chunk: bytes) -> None:
        """Take the next bytes."""
        self.since = min(self.since, time.monotonic())
        self.count += len(chunk)
        self.bytes += chunk[: _KEPT_BYTES - len(self.bytes)]

    def ripe(self) -> bool:
        """Whether there are enough of them, for long enough."""
        return self.count >= _GARBAGE_BYTES[self.format] and time.monotonic() - self.since >= _GARBAGE_S

    def verdict(self, port: str, baud: int, owner: str = "repro record", refused: str = "") -> InputError:
        """Say what the bytes are, as far as they tell; to the user of the command ``owner``.

        ``refused`` is what the parser said of the first of them.
        """
        seen = f"{self.count} bytes from {port} without a frame, the first {_first_line(bytes(self.bytes))}"
        recording = owner == "repro record"
        for other in dict.fromkeys((self.format, *FORMATS)):
            frames, packets = self._tried(other)
            if not frames or len(frames) < _FITTING * packets:
                continue
            if other == self.format:
                widths = sorted({len(frame.values) for frame in frames})
                counts = " or ".join(map(str, widths))
                what = "frames" if other == "frames" else "lines"
                must = f"{counts} ({what} of {counts} values arrived, {self.channels} were expected)"
                return bad_input("channels", owner, must, self.channels)
            change = f"--format {other}" if recording else f'format = "{other}" in the robot file'
            must = f"that of the board: {len(frames)} of {packets} frames are {other} ({change})"
            if other in ("hall", "millivolts"):
                change = "--format csv" if recording else 'format = "csv"'
                must += f", or other numbers ({change})"
            return bad_input("format", owner, must, f"{self.format}, {seen}")
        if self._is_text():
            must = f"that of the board; its lines are text that fits none of {', '.join(FORMATS)}"
            why = f" ({refused.rpartition(': ')[2]})" if self.format == "csv" and refused else ""
            return bad_input("format", owner, must + why, f"{self.format}, {seen}")
        must = f"the rate of the board ({_GARBAGE_S:g} s of garbage: wrong rate, or no format of ours)"
        return bad_input("baud", owner, must, f"{baud}, {seen}")

    def _is_text(self) -> bool:
        printable = sum(byte in b"\t\r\n" or 32 <= byte < 127 for byte in self.bytes)
        return printable >= _FITTING * len(self.bytes)

    def _tried(self, format: str) -> tuple[list[Frame], int]:
        """Return frames that a parser of a format finds, and how many packets or lines it has seen."""
        _, _, behind = bytes(self.bytes).partition(b"\n")
        n = behind.partition(b"\n")[0].count(b",") + 1
        trial = parser(format, n if format == "millivolts" == self.format else None)
        frames: list[Frame] = []
        for first in range(0, len(self.bytes), 4096):
            frames += trial.feed(bytes(self.bytes[first : first + 4096]))
        return frames, len(frames) + sum(getattr(trial.counters, name) for name in _DROPPED)


def _first_line(data: bytes) -> str:
    """Return the first whole line of bytes as it can be printed; the first bytes where they are no text."""
    parts = data.split(b"\n", 2)
    line = (parts[1] if len(parts) == 3 else data)[:_SHOWN_BYTES].rstrip(b"\r\n")
    text = line.decode(errors="replace")
    plain = text.replace("\t", " ").replace("\r", " ")
    return repr(text) if plain.isprintable() and "\ufffd" not in plain else line[:16].hex(" ")
