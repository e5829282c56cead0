"""Figures in frames: one drawing, of which the slider shows a part; a still with a text where no script runs."""

from __future__ import annotations

import base64
import io
import json
import re
from pathlib import Path

import matplotlib.pyplot as plt
import nbformat
import numpy as np
import pytest
from edition1.errors import InputError
from edition1_companion.book.after.page_notes import figures_of
from edition1_companion.book.frame_strip import Frame, FrameStrip, page_strip
from page_on_screen import pixels, wait_until
from PIL import Image

PROJECT = Path(__file__).resolve().parents[4]
AXE = PROJECT / "tests" / "vendor" / "axe-core" / "axe.min.js"
SCRIPT, STYLE = (PROJECT / "book" / "_static" / name for name in ("frame_strip.js", "repro.css"))
# whatever the page would load or run besides is an error on the console
PAGE = """<!doctype html><html lang="en" data-theme="{theme}"><head><meta charset="utf-8"><title>Frames</title>
<meta name="viewport" content="width=device-width"><link rel="stylesheet" href="{style}">
<meta http-equiv="Content-Security-Policy"
 content="default-src 'none'; script-src file:; style-src file: 'unsafe-inline'; img-src data:">
<script src="{script}"></script></head><body class="bd-article"><main><h1>Frames</h1>{body}</main></body></html>"""


@page_strip
def steps() -> FrameStrip:
    """Draw a point in each frame, a line in the last two, a frame of axes in all."""
    figure, panel = plt.subplots(figsize=(4, 3))
    panel.set(xlim=(0, 5), ylim=(0, 5), xlabel="x", title="Steps")
    points = [panel.plot(k + 1, k + 1, "o", ms=12, color="#0072B2")[0] for k in range(4)]
    (line,) = panel.plot([1, 4], [1, 4], color="#D55E00")
    frames = [Frame(f"Step {k} </script> & <b>", [p, line][: 1 + (k > 1)]) for k, p in enumerate(points)]
    return FrameStrip(figure, frames, 'Four steps, the last "there".')


@pytest.fixture(scope="module")
def strip() -> FrameStrip:
    return steps()


@pytest.fixture
def show(browser, tmp_path):
    """Open a page with a strip; at the end nothing may have gone wrong, and nothing asked of anyone."""
    contexts, asked, console = [], [], []

    def open_page(strip: FrameStrip, theme: str = "light", width: int = 480, **options):
        path = tmp_path / "page.html"
        # Without its fonts: those lie beside it in a built site only.
        style = re.sub(r"@font-face \{.*?\}", "", STYLE.read_text(encoding="utf-8"))
        (tmp_path / "strip.css").write_text(style, encoding="utf-8")
        names = {"style": "strip.css", "script": SCRIPT.as_uri(), "theme": theme}
        path.write_text(PAGE.format(body=strip.to_html(), **names), encoding="utf-8")
        contexts.append(browser.new_context(viewport={"width": width, "height": 700}, **options))
        page = contexts[-1].new_page()
        page.on("request", lambda request: asked.append(request.url))
        page.on("pageerror", lambda error: console.append(str(error)))
        page.on("console", lambda message: console.append(message.text))
        page.goto(path.as_uri())
        return page

    yield open_page
    for context in contexts:
        context.close()
    assert console == []
    assert [url for url in asked if not url.startswith(("file:", "data:"))] == []


def test_what_is_in_several_frames_is_drawn_once(strip):
    """The still has its own frame alone; the same figure gives the same bytes."""
    html = strip.to_html()
    assert html == strip.to_html()
    found = re.fullmatch(
        r'<div class="frame-strip"><img src="data:image/png;base64,([^"]+)" alt="([^"]+)" width="384">'
        r'<script type="application/json">([^<]+)</script></div>',
        html,
    )
    assert found is not None
    data = json.loads(found[3])
    assert found[2] == "Four steps, the last &quot;there&quot;."
    assert re.findall(r'<g id="(f-[^"]*)">', strip.svg([3])) == ["f-3--4", "f-2-3--3"]
    assert sorted(re.findall(r'<g id="(f-[^"]*)">', data["svg"])) == [
        "f-0--0", "f-1--1", "f-2--2", "f-2-3--3", "f-3--4",
    ]  # fmt: skip
    assert data["frames"] == [f"Step {k} </script> & <b>" for k in range(4)]
    assert data["still"] == 3


def test_a_strip_has_frames(strip):
    with pytest.raises(InputError, match="at least two"):
        FrameStrip(strip.figure, strip.frames[:1], "One.")
    with pytest.raises(InputError, match="number of a frame"):
        FrameStrip(strip.figure, strip.frames, "Four.", still=4)


def test_the_still_can_be_downloaded(strip):
    cell = nbformat.v4.new_code_cell("")
    cell.outputs = [nbformat.v4.new_output("display_data", {"text/html": strip.to_html()})]
    (figure,) = figures_of(nbformat.v4.new_notebook(cells=[cell]))
    picture = np.asarray(Image.open(io.BytesIO(figure.files["png"])).convert("RGB")).astype(int)
    colour = np.array([0x00, 0x72, 0xB2])  # of the points, of which the still has one
    blue = np.argwhere(np.abs(picture - colour).max(axis=-1) < 30)
    assert len(blue) > 50
    assert np.ptp(blue, axis=0).max() < 20


@pytest.mark.parametrize("theme", ["light", "dark"])
def test_slider_shows_what_belongs_to_a_frame(strip, show, theme):
    """Pixel by pixel what is drawn of that frame alone, and says what happens there."""
    page = show(strip, theme)
    slider = page.get_by_role("slider", name="Frame")
    assert slider.input_value() == "3"
    slider.focus()
    for k, key in ((0, "Home"), (1, "ArrowRight"), (2, "ArrowRight"), (3, "End")):
        page.keyboard.press(key)
        said = strip.frames[k].says
        assert slider.get_attribute("aria-valuetext") == said
        assert page.locator(".frame-strip-says").inner_text() == said
        alt = strip.alt if k == 3 else said
        wait_until(page, f"document.querySelector('.frame-strip img').alt === {json.dumps(alt)}")
        shown = pixels(page.locator(".frame-strip img"))
        alone = base64.b64encode(strip.svg([k]).encode()).decode()
        page.evaluate(
            "src => { const image = document.querySelector('.frame-strip img'); image.dataset.kept = image.src;"
            " image.src = src; return image.decode(); }",
            f"data:image/svg+xml;base64,{alone}",
        )
        np.testing.assert_array_equal(pixels(page.locator(".frame-strip img")), shown)
        page.evaluate(
            "() => { const image = document.querySelector('.frame-strip img'); image.src = image.dataset.kept;"
            " return image.decode(); }"
        )


def test_it_plays_when_asked_and_stops_at_the_end(strip, show):
    page = show(strip)
    slider, play = page.get_by_role("slider"), page.get_by_role("button")
    page.wait_for_timeout(900)
    assert slider.input_value() == "3", "never by itself"
    play.click()
    assert slider.input_value() == "0", "from the end it begins anew"
    assert play.inner_text() == "Pause"
    wait_until(page, "document.querySelector('.frame-strip input').value === '3'")
    assert play.inner_text() == "Play"
    page.wait_for_timeout(900)
    assert slider.input_value() == "3"


def test_the_slider_ends_the_play(strip, show):
    page = show(strip)
    play = page.get_by_role("button")
    play.click()
    page.get_by_role("slider").press("ArrowRight")
    assert play.inner_text() == "Play"
    page.wait_for_timeout(900)
    assert page.get_by_role("slider").input_value() == "1"


def test_less_motion_where_the_reader_asks_for_it(strip, show):
    page = show(strip, reduced_motion="reduce")
    assert page.get_by_role("slider").count() == 1
    assert page.get_by_role("button").count() == 0


def test_a_still_without_scripts(strip, show):
    page = show(strip, java_script_enabled=False)
    picture = page.get_by_role("img", name=strip.alt)
    assert picture.bounding_box()["width"] > 300
    assert page.get_by_role("slider").count() == 0


@pytest.mark.parametrize("width", [1000, 390])
def test_readable_by_all(strip, show, width):
    """By the rules of axe, and no wider than the window."""
    page = show(strip, width=width)
    assert page.evaluate("document.documentElement.scrollWidth") <= width
    page.evaluate(AXE.read_text(encoding="utf-8"))
    found = page.evaluate("() => axe.run(document, {preload: false, resultTypes: ['violations']})")
    assert [violation["id"] for violation in found["violations"]] == []
