"""A link that notes when what was sent."""

from __future__ import annotations

import time

import numpy as np
from jaxtyping import Int

from repro_live.emulate.emulator import Link


class NotedLink:
    """A link as it is, and the times at which it was written to.

    Parameters
    ----------
    link
        What is written to.
    """

    def __init__(self, link: Link) -> None:
        self._link = link
        self._times_ns: list[int] = []
        self._bytes: list[int] = []

    @property
    def address(self) -> str:
        """What to open."""
        return self._link.address

    def appear(self) -> None:
        """Make the port."""
        self._link.appear()

    def vanish(self) -> None:
        """Take the port away."""
        self._link.vanish()

    def remove(self) -> None:
        """Remove the port for good."""
        self._link.remove()

    def has_reader(self) -> bool:
        """Whether somebody has the port open."""
        return self._link.has_reader()

    def write(self, data: memoryview, timeout_s: float) -> int:
        """Send what fits within a time [s], and note when."""
        began_ns = time.monotonic_ns()
        sent = self._link.write(data, timeout_s)
        if sent:
            self._times_ns.append(began_ns)
            self._bytes.append(sent + (self._bytes[-1] if self._bytes else 0))
        return sent

    def sent_ns(self, ends: Int[np.ndarray, " n"]) -> Int[np.ndarray, " n"]:
        """When the byte before each of these places in all that was sent went out, by the monotonic clock [ns]."""
        return np.array(self._times_ns)[np.searchsorted(self._bytes, ends)]
