"""The two ports an emulated board can have: a pseudo-terminal, and a TCP port of this computer."""

from __future__ import annotations

import contextlib
import os
import select
import shutil
import socket
import sys
import tempfile
import time
from pathlib import Path

from edition1.errors import bad_input, require

HAS_PTY = sys.platform != "win32"
"""Whether there are pseudo-terminals here."""
_CHUNK = 65536
"""Most bytes in one call of the operating system."""
_DRAIN_S = 2.0
"""How long a reader has to take what was sent, before the port disappears [s]."""
_EMPTY = 30
"""So many times in a row nothing waits, 3 ms apart, once all was taken: a busy system hands bytes on late."""


class PtyLink:
    """A pseudo-terminal, behind a symbolic link that stays the same when the port reappears.

    Parameters
    ----------
    port_file
        The link; by default one in a temporary folder.

    Attributes
    ----------
    address
        What a reader opens, the path of the link; stays the same.

    Raises
    ------
    InputError
        On Windows, or if there is something else at that path.
    """

    def __init__(self, port_file: Path | None = None) -> None:
        require(HAS_PTY, "port", "PtyLink", "a socket on this system", "a pseudo-terminal, which it has not")
        self._folder = None
        if port_file is None:
            self._folder = Path(tempfile.mkdtemp(prefix="repro-"))
        self._path = (port_file or Path(f"{self._folder}/port")).absolute()
        self.address = str(self._path)
        of_a_port = self._path.is_symlink() and os.readlink(self._path).startswith("/dev/")
        if self._path.exists() and not of_a_port:
            raise bad_input("port_file", "PtyLink", "a new name, or that of an earlier port", port_file)
        self._master: int | None = None
        self._name = ""

    def appear(self) -> None:
        """Make a pseudo-terminal and let the link point to it."""
        import tty

        self._master, slave = os.openpty()
        os.set_blocking(self._master, False)
        tty.setraw(slave)
        self._name = os.ttyname(slave)
        os.close(slave)  # from now on the master hangs up whenever nobody has the port open
        with contextlib.suppress(FileNotFoundError):
            self._path.unlink()
        self._path.symlink_to(self._name)

    def vanish(self) -> None:
        """Remove the link and, once a reader has taken what was sent, the pseudo-terminal."""
        self._path.unlink(missing_ok=True)
        if self._master is not None:
            self._drain()
            os.close(self._master)
            self._master = None

    def remove(self) -> None:
        """Remove the port for good."""
        self.vanish()
        if self._folder:
            shutil.rmtree(self._folder, ignore_errors=True)

    def has_reader(self) -> bool:
        """Whether somebody has the port open."""
        if self._master is None:
            return False
        poll = select.poll()
        poll.register(self._master, select.POLLIN)
        events = dict(poll.poll(0)).get(self._master, 0)
        if events & select.POLLIN:  # what the reader writes is not for us
            with contextlib.suppress(OSError):
                os.read(self._master, _CHUNK)
        return not events & select.POLLHUP

    def write(self, data: memoryview, timeout_s: float) -> int:
        """Send what fits within a time [s]."""
        if self._master is None or not select.select([], [self._master], [], timeout_s)[1]:
            return 0
        try:
            return os.write(self._master, data[:_CHUNK])
        except OSError:  # it is full after all
            return 0

    def _drain(self) -> None:
        deadline, empty = time.monotonic() + _DRAIN_S, 0
        while self.has_reader() and empty < _EMPTY and time.monotonic() < deadline:
            waiting = _waiting(self._name)
            empty = 0 if waiting else empty + 1
            time.sleep(0.003)


def _waiting(name: str) -> int:
    """Bytes that a pseudo-terminal holds for its reader; 0 where it lets nobody else ask."""
    import fcntl
    import termios

    try:
        slave = os.open(name, os.O_RDWR | os.O_NOCTTY)
    except OSError:
        return 0
    try:
        return int.from_bytes(fcntl.ioctl(slave, termios.FIONREAD, bytes(4)), sys.byteorder)
    finally:
        os.close(slave)


class SocketLink:
    """A TCP port of this computer, for one reader at a time; nobody else can reach it.

    Parameters
    ----------
    port
        Its number; 0 takes a free one.

    Raises
    ------
    InputError
        If it is no number of a port, or in use.
    """

    def __init__(self, port: int = 0) -> None:
        require(0 <= port <= 65535, "socket", "SocketLink", "0 to 65535", port)
        self._listener: socket.socket | None = None
        self._reader: socket.socket | None = None
        self._port = port
        try:
            self.appear()
        except OSError as error:
            raise bad_input("socket", "SocketLink", "a free port", f"{port}: {error.strerror}") from error

    def appear(self) -> None:
        """Listen."""
        if self._listener is not None:
            return
        listener = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
        if os.name == "posix":  # elsewhere this would let two listen to one port
            listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            listener.bind(("127.0.0.1", self._port))
            listener.listen(1)
        except OSError:
            listener.close()
            raise
        listener.setblocking(False)
        self._listener, self._port = listener, listener.getsockname()[1]
        self.address = f"socket://127.0.0.1:{self._port}"

    def vanish(self) -> None:
        """Close the connection, which delivers what was sent, and listen no more."""
        self._leave()
        if self._listener is not None:
            self._listener.close()
            self._listener = None

    def remove(self) -> None:
        """Remove the port for good."""
        self.vanish()

    def has_reader(self) -> bool:
        """Whether somebody is connected."""
        if self._reader is not None:
            try:  # what the reader writes is not for us; its end is
                if self._reader.recv(_CHUNK) == b"":
                    self._leave()
            except BlockingIOError:
                pass
            except OSError:
                self._leave()
        if self._reader is None and self._listener is not None:
            with contextlib.suppress(BlockingIOError):
                self._reader, _ = self._listener.accept()
                self._reader.setblocking(False)
                self._reader.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        return self._reader is not None

    def write(self, data: memoryview, timeout_s: float) -> int:
        """Send what fits within a time [s]."""
        if self._reader is None or not select.select([], [self._reader], [], timeout_s)[1]:
            return 0
        try:
            return self._reader.send(data[:_CHUNK])
        except BlockingIOError:
            return 0
        except OSError:
            self._leave()
            return 0

    def _leave(self) -> None:
        if self._reader is not None:
            self._reader.close()
            self._reader = None


Link = PtyLink | SocketLink
"""A port that can appear and disappear."""


def open_link(kind: str = "") -> Link:
    """Return a port of a kind: ``pty``, ``socket``, or by default a pseudo-terminal where there are such."""
    return PtyLink() if kind == "pty" or (not kind and HAS_PTY) else SocketLink()
