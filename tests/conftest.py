"""The browser, for the tests of all folders."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
from chromium import find, started

collect_ignore = ["conftest.py"]  # it has no examples to run, and other folders have a module of this name


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
