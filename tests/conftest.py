"""What all tests share: one thread, the settings of hypothesis, and the browser."""

from __future__ import annotations

import os
import signal
from collections.abc import Iterator

import pytest
from chromium import find, started
from hypothesis import HealthCheck, settings

collect_ignore = ["conftest.py"]  # it has no examples to run, and other folders have a module of this name

os.environ.setdefault("OMP_NUM_THREADS", "1")  # for libraries that modules of tests load, torch among them
# Started in the background of a script, this process and its children ignore interruptions, which tests send.
signal.signal(signal.SIGINT, signal.default_int_handler)
settings.register_profile(
    "repro", deadline=None, derandomize=True, max_examples=50, suppress_health_check=[HealthCheck.too_slow]
)  # how busy the computer is says nothing about a law
settings.load_profile("repro")


@pytest.fixture(scope="module")
def browser() -> Iterator:
    """Return Chromium; the tests that need it are skipped where there is none.

    Not for longer than a module: as long as it runs, playwright's event loop is in the way of any other.
    """
    pytest.importorskip("playwright.sync_api")
    executable = find()
    if executable is None:
        pytest.skip("Chromium is not installed")
    with started(executable) as chromium:
        yield chromium
