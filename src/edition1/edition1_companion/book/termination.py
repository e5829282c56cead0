"""How a command is stopped from outside."""

from __future__ import annotations

import signal
import sys


def stop_on_termination() -> None:
    """Let a request to terminate run the clean-up that an interruption from the keyboard runs."""

    def stop(*_: object) -> None:
        # `timeout` sends it twice: the second must not cut the clean-up short
        signal.signal(signal.SIGTERM, signal.SIG_IGN)
        sys.exit(128 + signal.SIGTERM)

    signal.signal(signal.SIGTERM, stop)
