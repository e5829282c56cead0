"""A port that may disappear, and is opened again when it is back."""

from __future__ import annotations

import threading
import time

import serial

from repro.errors import InputError
from repro_live.record.ports import close_port, open_port, ports, read_available

RETRY_S = (0.05, 1.0)
"""Shortest and longest wait before a lost port is opened again [s]; it doubles in between."""


class LastingPort:
    """A port that is read as long as it is there.

    Parameters
    ----------
    name, baud, owner
        As for `repro_live.record.ports.open_port`.

    Raises
    ------
    InputError
        If it cannot be opened at first.
    """

    def __init__(self, name: str, baud: int, owner: str) -> None:
        self.name, self.baud, self.owner = name, baud, owner
        # before the port is open: it takes longer than a buffer may hold frames
        self.description = dict(ports()).get(name, "")
        self.reconnects = 0
        self._opened: serial.SerialBase | None = open_port(name, baud, owner)

    def read(self, timeout_s: float) -> bytes:
        """Return the bytes that have arrived, as `repro_live.record.ports.read_available`.

        Raises
        ------
        OSError
            If the port has disappeared.
        """
        if self._opened is None:
            raise ConnectionResetError(f"{self.name} is not open.")
        return read_available(self._opened, timeout_s)

    def close(self) -> None:
        """Close the port, if it is open."""
        if self._opened is not None:
            close_port(self._opened)
            self._opened = None

    def reopen(self, end: float, stop: threading.Event) -> bool:
        """Wait until the closed port can be opened again; return whether it is open.

        Parameters
        ----------
        end
            When to give up, by the monotonic clock [s].
        stop
            Give up when this is set.
        """
        wait_s = RETRY_S[0]
        while not stop.wait(min(wait_s, max(0.0, end - time.monotonic()))) and time.monotonic() < end:
            wait_s = min(2 * wait_s, RETRY_S[1])
            try:
                self._opened = open_port(self.name, self.baud, self.owner)
            except InputError:
                continue
            self.reconnects += 1
            return True
        return False
