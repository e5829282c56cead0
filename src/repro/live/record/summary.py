"""What a recorder has counted."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True)
class Summary:
    """What a recording holds, as its sidecar tells.

    Attributes
    ----------
    path
        The file; None if no frame came, so that none was written.
    counters
        Those of `repro.live.wire.frame.Counters`, ``reconnects`` and ``received_bytes``.
    seconds
        How long it was recorded.
    """

    path: Path | None
    counters: dict[str, int]
    seconds: float

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
