"""What a recording holds, in numbers and in words."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from repro_live.record.recording import channel_names
from repro_live.wire.csv_text import Layout

_DROPPED = ("malformed", "checksum_errors", "oversized")


@dataclass(frozen=True)
class Summary:
    """What a recording holds, as its sidecar tells.

    Attributes
    ----------
    path
        The file; None if no frame came, so that none was written.
    counters
        Those of `repro_live.wire.frame.Counters`, ``reconnects`` and ``received_bytes``.
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
