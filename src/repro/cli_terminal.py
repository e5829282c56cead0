"""How a command that goes on until it is stopped is stopped, and how it writes to a terminal that may go."""

from __future__ import annotations

import signal
import sys
import threading
from contextlib import suppress


def set_by_signals(stop: threading.Event) -> None:
    """Let an interruption, a request to terminate and the end of the terminal set an event."""
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: stop.set())
    hung_up = getattr(signal, "SIGHUP", None)  # not on Windows
    if hung_up is not None and signal.getsignal(hung_up) != signal.SIG_IGN:  # nohup wants to go on
        signal.signal(hung_up, lambda *_: stop.set())


def to_terminal(text: str, end: str = "\n") -> None:
    """Write to standard error, if that is still there: a recording does not end with its terminal."""
    with suppress(OSError):
        print(text, end=end, file=sys.stderr, flush=True)
