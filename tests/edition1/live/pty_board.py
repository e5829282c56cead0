"""A port that a test writes into."""

from __future__ import annotations

import os
import time
from pathlib import Path


class Board:
    """A board on a pseudo-terminal; the port is a link, so that it can be plugged out and in."""

    def __init__(self, folder: Path) -> None:
        self.port = folder / "port"
        self.master = -1

    def plug_in(self) -> None:
        import termios
        import tty

        self.master, slave = os.openpty()
        tty.setraw(slave)
        self.slave = slave
        self.speed = lambda: termios.tcgetattr(slave)[4]
        self.unopened = self.speed()
        self.port.symlink_to(os.ttyname(slave))

    def opened(self) -> None:
        """Wait until a program has opened the port, which empties it: it has set its rate just before."""
        deadline = time.monotonic() + 60
        while self.speed() == self.unopened:
            assert time.monotonic() < deadline, "nobody opens the port"
            time.sleep(0.01)
        time.sleep(0.2)

    def unplug(self) -> None:
        self.port.unlink()
        os.close(self.master)
        os.close(self.slave)
        self.master = -1

    def send(self, data: bytes) -> None:
        while data:
            data = data[os.write(self.master, data) :]
