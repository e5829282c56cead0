"""How a command that goes on until it is stopped is stopped, and how it writes to a terminal that may go."""

from __future__ import annotations

import signal
import sys
import threading
from contextlib import suppress


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


def to_terminal(text: str, end: str = "\n") -> None:
    """Write to standard error, if that is still there: a recording does not end with its terminal."""
    with suppress(OSError):
        print(text, end=end, file=sys.stderr, flush=True)
