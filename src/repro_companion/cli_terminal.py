"""What commands share: options of a name and a value, how one that goes on is stopped, and how it writes lines."""

from __future__ import annotations

import signal
import sys
import threading
from collections.abc import Sequence
from contextlib import suppress
from typing import Any

from cyclopts import Parameter, Token


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


def to_terminal(text: str, end: str = "\n") -> None:
    """Write to standard error, if that is still there: a recording does not end with its terminal."""
    with suppress(OSError):
        print(text, end=end, file=sys.stderr, flush=True)
