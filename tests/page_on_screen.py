"""What a page in the browser shows, and waiting until it does."""

from __future__ import annotations

import io
from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np
import pytest
from chromium import LONGEST_MS
from PIL import Image
from playwright.sync_api import Error as PlaywrightError

NO_GPU = "GPU stall due to ReadPixels"
"""What Chromium says of every 3-D view when there is no GPU; a page cannot prevent it."""


@contextmanager
def window(browser, width: int, scheme: str) -> Iterator[tuple]:
    """Open an empty page in a window of its own; yield it with a list of all addresses that it asks for."""
    context = browser.new_context(viewport={"width": width, "height": 900}, color_scheme=scheme)
    context.set_default_timeout(LONGEST_MS)
    page, asked, failed = context.new_page(), [], []
    page.on("request", lambda request: asked.append(request.url))
    page.on("pageerror", lambda error: failed.append(error))
    yield page, asked
    context.close()
    assert not failed


def wait_until(page, condition) -> None:
    """Wait for what is to hold, here or, as text, in the page; the browser's own way is forbidden to our pages."""
    for _ in range(600):
        try:
            if condition() if callable(condition) else page.evaluate(condition):
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


def at_rest(element) -> np.ndarray:
    """Return an element once two pictures of it, 0.3 s apart, are the same."""
    pictures = [pixels(element)]

    def rests() -> bool:
        element.page.wait_for_timeout(300)
        pictures.append(pixels(element))
        return np.array_equal(*pictures[-2:])

    wait_until(element.page, rests)
    return pictures[-1]


def differing(one: np.ndarray, other: np.ndarray) -> int:
    """Return how many pixels differ visibly."""
    return int((np.abs(one - other).max(-1) > 40).sum())


def red(element) -> int:
    """Return how many pixels of an element are red, as a sensor that is suspected is drawn."""
    picture = pixels(element)
    return int(((picture[..., 0] > 90) & (picture[..., 0] > 2 * picture[..., 1:].max(-1))).sum())
