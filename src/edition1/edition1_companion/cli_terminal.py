"""What commands share: options of a name and a value, how one that goes on is stopped, and how it writes lines."""

from __future__ import annotations

import shutil
import signal
import sys
import textwrap
import threading
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any, TextIO

from cyclopts import Parameter, Token

if TYPE_CHECKING:
    from edition1.robot_file.robot_file import RobotFile

PLAIN_S = 9.5
"""Time between two states where the output is no terminal [s]: a recorder shows one every second."""


def pairs(names: str | list[str], metavar: str) -> Parameter:
    """Return the option: its values are passed on as typed, for they may start with a hyphen or look like JSON.

    Parameters
    ----------
    names
        Of the option, such as ``["-p", "--parameter"]``.
    metavar
        The pair as help shows it.
    """
    return Parameter(
        name=names,
        metavar=metavar,
        allow_leading_hyphen=True,
        negative="",
        json_list=False,
        json_dict=False,
        converter=_as_typed,
    )


def _as_typed(_: Any, tokens: Sequence[Token]) -> list[tuple[str, str]]:
    """Return names and values: cyclopts itself would take a value that starts with { for a whole pair in JSON."""
    words = [token.value for token in tokens]
    return list(zip(words[::2], words[1::2], strict=True))


def set_by_signals(stop: threading.Event) -> None:
    """Let an interruption, a request to terminate and the end of the terminal set an event."""

    def set_beside(*_: object) -> None:
        # Not here: the main thread may have been stopped while it holds the lock of the event.
        threading.Thread(target=stop.set, daemon=True).start()

    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, set_beside)
    hung_up = getattr(signal, "SIGHUP", None)  # not on Windows
    if hung_up is not None and signal.getsignal(hung_up) != signal.SIG_IGN:  # nohup wants to go on
        signal.signal(hung_up, set_beside)


def to_terminal(text: str) -> None:
    """Write to standard error, if that is still there: a recording does not end with its terminal."""
    with suppress(OSError):
        print(text, file=sys.stderr, flush=True)


class Screen:
    """Standard error: lines that are written over on a terminal, now and then one line elsewhere.

    Parameters
    ----------
    lines
        What to show of a state.
    every_s
        Time between two states on a terminal [s].
    """

    def __init__(self, lines: Callable[[Any], list[str]], every_s: float = 0.0) -> None:
        self._terminal = sys.stderr.isatty()
        self._lines, self._every_s = lines, every_s if self._terminal else PLAIN_S
        self._shown = time.monotonic()
        self._height = 0
        self._lock = threading.Lock()

    def show(self, state: Any) -> None:
        """Show a state in the place of the one before, if it is time to."""
        if time.monotonic() - self._shown < self._every_s:
            return
        self._shown = time.monotonic()
        with self._lock:
            lines = self._lines(state)
            if not self._terminal:
                to_terminal(" | ".join(lines))
                return
            size = shutil.get_terminal_size()
            # a line that the terminal breaks, or one that it moved out of sight, could not be written over
            lines = [part for text in lines for part in textwrap.wrap(text, max(size.columns - 1, 20))]
            lines = lines[: size.lines - 1]
            to_terminal(self._up() + "\n".join(lines))
            self._height = len(lines)

    def line(self, text: str) -> None:
        """Write for good; the states go on below."""
        with self._lock:
            to_terminal(self._up() + text)
            self._height = 0

    def _up(self) -> str:
        """Go to the beginning of the last state and clear it."""
        return f"\x1b[{self._height}F\x1b[J" if self._height else ""


def load_described(robot: Path, calibration: Path | None = None, *, to: TextIO | None = None) -> RobotFile:
    """Load a robot, print what is to be noted (to standard output by default), and let torch use one thread."""
    import torch

    from edition1.robot_file.load import load_robot

    torch.set_num_threads(1)
    found = load_robot(robot, calibration)
    for note in found.notes:
        print(f"Warning: {note}", file=to)
    return found
