"""Serial ports and sockets: listed, opened with messages that say what to do, read, and opened again when lost."""

from __future__ import annotations

import errno
import os
import select
import sys
import threading
import time
from contextlib import suppress
from pathlib import Path

import serial
from serial.tools import list_ports

from edition1.errors import InputError, bad_input

_MOST_BYTES = 65536
"""Bytes taken at once."""
_BUSY = (errno.EBUSY, errno.EAGAIN)


def ports() -> list[tuple[str, str]]:
    """Return name and description of the serial ports found, in order of name."""
    found = []
    for port in sorted(list_ports.comports()):
        known = [text for text in (port.description, port.manufacturer) if text and text != "n/a"]
        if port.vid is not None:
            known.append(f"USB {port.vid:04x}:{port.pid:04x}")
        found.append((port.device, ", ".join(dict.fromkeys(known)) or "no description"))
    return found


def listing() -> str:
    """Return the serial ports found as a table, or say that there are none."""
    found = ports()
    if not found:
        return (
            "No serial port found. A board shows when it is plugged in; socket://HOST:PORT works without one."
        )
    width = max(len(name) for name, _ in found)
    return "\n".join(f"{name:{width}}  {description}" for name, description in found)


def open_port(port: str, baud: int = 115200, owner: str = "repro record") -> serial.SerialBase:
    """Open a port for this process alone.

    Parameters
    ----------
    port
        Such as ``/dev/ttyACM0``, ``COM3`` or ``socket://localhost:7000``.
    baud
        Bits per second; means nothing to a board that is itself a USB device, and to a socket.
    owner
        The command that asks, for the messages of errors.

    Raises
    ------
    InputError
        If there is no such port, it is in use, or this user may not open it.
    """
    try:
        opened = serial.serial_for_url(port, baudrate=baud, timeout=0, do_not_open=True)
        opened.exclusive = True
        opened.open()
    except (OSError, ValueError) as error:
        raise _refusal(port, baud, error, owner) from error
    return opened


def check_port(port: str, baud: int = 115200, owner: str = "repro record") -> None:
    """Refuse a port that is not there, or that this user may not open, as `open_port` would; touch none.

    Opening resets many a board, and takes the one connection of a socket: nothing is said of those, nor on Windows.

    Raises
    ------
    InputError
        As `open_port`.
    """
    if "://" in port or os.name != "posix":
        return
    for mode, code in ((os.F_OK, errno.ENOENT), (os.R_OK | os.W_OK, errno.EACCES)):
        if not os.access(port, mode):
            raise _refusal(port, baud, OSError(code, os.strerror(code)), owner)


def close_port(opened: serial.SerialBase) -> None:
    """Close a port, also one that has disappeared."""
    plain = getattr(opened, "_socket", None)
    if plain is not None:
        plain.close()  # pyserial leaves it open when the other side has hung up
    with suppress(OSError):  # there may be nothing left to close
        opened.close()


def read_available(opened: serial.SerialBase, timeout_s: float) -> bytes:
    """Wait for bytes, at most for a time, and return those that have arrived; none after the time.

    Raises
    ------
    OSError
        If the port has disappeared.
    """
    plain = getattr(opened, "_socket", None)
    if plain is None and os.name != "posix":
        opened.timeout = timeout_s
        first = opened.read(1)
        return first + opened.read(opened.in_waiting) if first else b""
    # pyserial's own reading waits for a number of bytes and takes those of a socket one at a time.
    if not select.select([opened.fileno()], [], [], timeout_s)[0]:
        return b""
    chunk = plain.recv(_MOST_BYTES) if plain is not None else os.read(opened.fileno(), _MOST_BYTES)
    if not chunk:
        raise ConnectionResetError(f"{opened.port} was closed at the other side.")
    return chunk


def _refusal(port: str, baud: int, error: OSError | ValueError, owner: str) -> InputError:
    code, is_path = getattr(error, "errno", None), "://" not in port
    if isinstance(error, ValueError) and "baud" in str(error).lower():
        return bad_input("baud", owner, "a rate that the port can be set to", baud)
    if (is_path and code == errno.ENOENT) or (os.name == "nt" and "FileNotFoundError" in str(error)):
        there = "; ".join(f"{name} ({description})" for name, description in ports()) or "none at the moment"
        return bad_input("port", owner, f"one that is there (found: {there})", f"{port}, which is not")
    if (is_path and code == errno.EACCES) or (os.name == "nt" and "PermissionError" in str(error)):
        return bad_input("port", owner, _permission(port), f"{port}, permission denied")
    if code in _BUSY:
        return bad_input(
            "port", owner, "free (close the program that has it open)", f"{port}, which is in use"
        )
    if not is_path:
        expected = "reachable, as socket://HOST:PORT of a program that waits for connections"
        return bad_input("port", owner, expected, error)
    return bad_input("port", owner, "a serial port", error)


def _permission(port: str) -> str:
    """What helps where a port may not be opened."""
    if sys.platform == "win32":
        return "free (Windows refuses a port that another program has open: close that)"
    if sys.platform == "darwin":
        return "one that you may read and write (macOS: allow the device under Privacy & Security)"
    import grp  # not on Windows

    try:
        group = grp.getgrgid(Path(port).stat().st_gid).gr_name
    except (OSError, KeyError):
        group = "dialout"
    if group in ("root", "wheel"):  # joining that would give far more than the port
        return f"one that you may read and write (it is {group}'s alone: a udev rule gives it to dialout or uucp)"
    return f"one that you may read and write (join its group: sudo usermod -aG {group} $USER, then log out and in)"


_RETRY_S = (0.05, 1.0)
"""Shortest and longest wait before a lost port is opened again [s]; it doubles in between."""


class LastingPort:
    """A port that is read as long as it is there.

    Parameters
    ----------
    name, baud, owner
        As for `edition1_live.record.ports.open_port`.

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
        """Return the bytes that have arrived, as `edition1_live.record.ports.read_available`.

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
        wait_s = _RETRY_S[0]
        while not stop.wait(min(wait_s, max(0.0, end - time.monotonic()))) and time.monotonic() < end:
            wait_s = min(2 * wait_s, _RETRY_S[1])
            try:
                self._opened = open_port(self.name, self.baud, self.owner)
            except InputError:
                continue
            self.reconnects += 1
            return True
        return False
