"""Bytes that hold no frame of the format asked for: another format, or another rate."""

from __future__ import annotations

import math
import time

from repro.errors import InputError, bad_input
from repro.live.wire.formats import FORMATS, parser

GARBAGE_S = 2.0
"""Bytes that hold no frame for this long are not of the format [s]."""
GARBAGE_BYTES = {"frames": 520, "hall": 200, "millivolts": 200, "quaternions": 250}
"""Fewer bytes than these say nothing, whatever the time: a whole frame or line may be missing yet."""
KEPT_BYTES = 16384
"""First bytes kept to find the format that they are of."""


class Suspect:
    """Bytes after an opening that hold no frame so far."""

    def __init__(self, format: str) -> None:
        self.format = format
        self.bytes = bytearray()
        self.count = 0
        self.since = math.inf

    def add(self, chunk: bytes) -> None:
        """Take the next bytes."""
        self.since = min(self.since, time.monotonic())
        self.count += len(chunk)
        self.bytes += chunk[: KEPT_BYTES - len(self.bytes)]

    def ripe(self) -> bool:
        """Whether there are enough of them, for long enough."""
        return self.count >= GARBAGE_BYTES[self.format] and time.monotonic() - self.since >= GARBAGE_S

    def verdict(self, port: str, baud: int, owner: str = "repro record") -> InputError:
        """Say what the bytes are, as far as they tell; to the user of the command ``owner``."""
        fitting = {}
        for other in FORMATS:
            trial = parser(other)
            for first in range(0, len(self.bytes), 4096):
                trial.feed(bytes(self.bytes[first : first + 4096]))
            fitting[other] = trial.counters.frames
        best = max(fitting, key=lambda name: fitting[name])
        seen = f"{self.count} bytes from {port} without a frame"
        if fitting[best]:
            change = f"--format {best}" if owner == "repro record" else f'format = "{best}" in the robot file'
            must = f"that of the board: {fitting[best]} frames are {best} ({change})"
            return bad_input("format", owner, must, f"{self.format}, {seen}")
        must = f"the rate of the board ({GARBAGE_S:g} s of garbage: wrong rate, or no format of ours)"
        return bad_input("baud", owner, must, f"{baud}, {seen}")
