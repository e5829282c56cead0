"""Waiting for what another thread does."""

import time


def until(holds, longest_s: float = 5.0) -> None:
    """Wait until something holds, and fail if it does not in time."""
    end = time.monotonic() + longest_s
    while not holds():
        assert time.monotonic() < end
        time.sleep(0.005)
