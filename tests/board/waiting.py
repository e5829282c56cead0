"""Waiting for what another thread or process does, however busy the computer is, and a clock that nothing delays."""

import time

LONGEST_S = 60.0
"""What has not come by then does not come. No test may need it."""


def until(holds, longest_s: float = LONGEST_S) -> None:
    """Wait until something holds, and fail if it does not in time."""
    end = time.monotonic() + longest_s
    while not holds():
        assert time.monotonic() < end
        time.sleep(0.005)


class Clock:
    """In place of ``time``: it stands still but for a microsecond whenever somebody looks, and for all sleep."""

    def __init__(self) -> None:
        self.now_s = 1000.0

    def monotonic(self) -> float:
        self.now_s += 1e-6
        return self.now_s

    def sleep(self, seconds: float) -> None:
        self.now_s += seconds
