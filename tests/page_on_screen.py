"""What a page in the browser shows, and waiting until it does."""

from __future__ import annotations

import io
from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np
import pytest
from PIL import Image
from playwright.sync_api import Error as PlaywrightError

NO_GPU = "GPU stall due to ReadPixels"
"""What Chromium says of every 3-D view when there is no GPU; a page cannot prevent it."""


@contextmanager
def window(browser, width: int, scheme: str) -> Iterator[tuple]:
    """Open an empty page in a window of its own; yield it with a list of all addresses that it asks for."""
    context = browser.new_context(viewport={"width": width, "height": 900}, color_scheme=scheme)
    page, asked, failed = context.new_page(), [], []
    page.on("request", lambda request: asked.append(request.url))
    page.on("pageerror", lambda error: failed.append(error))
    yield page, asked
    context.close()
    assert not failed


def wait_until(page, condition: str) -> None:
    """Wait for a condition; the browser's own way of doing so evaluates text, which our pages forbid."""
    for _ in range(200):
        try:
            if page.evaluate(condition):
                return
        except PlaywrightError as error:  # the page was just reloading itself
            if "Execution context was destroyed" not in str(error):
                raise
        page.wait_for_timeout(50)
    pytest.fail(f"never: {condition}")


def pixels(element) -> np.ndarray:
    """Return an element as it is on the screen, from 0 to 255, once all that is due is drawn."""
    two_frames = "() => new Promise(done => requestAnimationFrame(() => requestAnimationFrame(done)))"
    element.page.evaluate(two_frames)
    return np.asarray(Image.open(io.BytesIO(element.screenshot())).convert("RGB")).astype(int)


def differing(one: np.ndarray, other: np.ndarray) -> int:
    """Return how many pixels differ visibly."""
    return int((np.abs(one - other).max(-1) > 40).sum())


def red(element) -> int:
    """Return how many pixels of an element are red, as a sensor that is suspected is drawn."""
    picture = pixels(element)
    return int(((picture[..., 0] > 90) & (picture[..., 0] > 2 * picture[..., 1:].max(-1))).sum())
