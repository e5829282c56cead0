"""The viewer in a real browser, from a file: drawn, moved, turned, read aloud, and asking for nothing else."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pytest
import torch
from page_on_screen import NO_GPU, differing, pixels, wait_until

from edition1.kinematics.paper_robots import pcc_robot
from edition1_live.view.robot_view import live_frame, live_scene, shape_view
from edition1_live.view.shape_view import VIEWER, ShapeView, Traces

FRAMES = 31
# Whatever the page would load or run besides the script and inline pictures is an error on the console
PAGE = """<!doctype html><html lang="en"><head><meta charset="utf-8"><title>Shape</title>
<meta name="viewport" content="width=device-width">
<meta http-equiv="Content-Security-Policy" content="default-src 'none'; script-src file:; img-src data:">
</head><body>{body}<script src="{viewer}"></script></body></html>"""


@dataclass
class Seen:
    """What happened while a page was open."""

    requests: list[str] = field(default_factory=list)
    console: list[str] = field(default_factory=list)


@pytest.fixture(scope="module")
def view() -> ShapeView:
    """Return a bending robot, its estimate, and readings."""
    times = np.linspace(0.0, 1.5, FRAMES)
    q = torch.zeros(FRAMES, 3, dtype=torch.float64)
    q[:, 0] = torch.linspace(0.0, 0.03, FRAMES)
    covariance = torch.diag(torch.tensor([1e-3, 1e-3, 1e-4], dtype=torch.float64) ** 2)
    readings = {f"sensor {k}": np.sin(times + k) for k in range(1, 9)}
    return shape_view(
        pcc_robot(),
        q,
        times=times,
        label="A robot that bends, synthetic.",
        estimate=q + 5e-4,
        covariance=covariance.expand(FRAMES, -1, -1),
        traces=[Traces("readings", "mT", readings)],
    )


@pytest.fixture
def seen() -> Seen:
    """Return what the pages of a test do."""
    return Seen()


@pytest.fixture
def show(browser, tmp_path: Path, seen: Seen) -> Iterator:
    """Open a page with a body and return it; at the end nothing may have gone wrong."""
    pages = []

    def open_page(body: str, width: int = 480, before: str = "", **media):
        path = tmp_path / "page.html"
        path.write_text(PAGE.format(body=body, viewer=VIEWER.as_uri()), encoding="utf-8")
        page = browser.new_page()
        pages.append(page)
        page.set_viewport_size({"width": width, "height": 900})
        page.emulate_media(**media)
        page.on("request", lambda request: seen.requests.append(request.url))
        page.on("pageerror", lambda error: seen.console.append(str(error)))
        page.on("console", lambda message: seen.console.append(message.text))
        if before:
            page.add_init_script(before)
        page.goto(path.as_uri())
        return page

    yield open_page
    for page in pages:
        page.close()
    assert [line for line in seen.console if NO_GPU not in line] == []
    outside = [url for url in seen.requests if not url.startswith(("file:", "data:"))]
    assert outside == []


def test_slider_moves_the_shape(show, view, seen):
    """The canvas is drawn; a key on the slider moves shape, time and cursor; nothing but two files is read."""
    page = show(view.to_html())
    assert not page.locator("img").is_visible(), "the picture gives way"
    first = pixels(page.locator("canvas"))
    assert len(np.unique(first.reshape(-1, 3), axis=0)) > 100, "blank"
    slider = page.get_by_role("slider", name="Time")
    assert slider.get_attribute("aria-valuetext") == "0.00 s of 1.50 s"
    cursor = page.locator(".shape-view-trace line").first
    assert float(cursor.get_attribute("x1")) == 0.0
    slider.focus()
    page.keyboard.press("ArrowRight")
    assert slider.get_attribute("aria-valuetext") == "0.05 s of 1.50 s"
    page.keyboard.press("End")
    assert slider.input_value() == str(FRAMES - 1)
    assert float(cursor.get_attribute("x1")) == 1000.0
    assert page.locator(".shape-view-clock").inner_text() == "1.50 s"
    assert differing(first, pixels(page.locator("canvas"))) > 700, "the shape did not move"
    page.keyboard.press("Home")
    assert differing(first, pixels(page.locator("canvas"))) == 0, "the same frame is the same picture"
    assert len(seen.requests) <= 3, "page, script, and the picture inside the page"


def test_keys_turn_the_view(show, view):
    """Arrow keys turn, plus and minus change the distance, and the button leads back."""
    page = show(view.to_html())
    first = pixels(page.locator("canvas"))
    canvas = page.get_by_role("img", name=view.label).last
    for key in ("ArrowLeft", "ArrowUp", "+"):
        canvas.focus()
        before = pixels(page.locator("canvas"))
        page.keyboard.press(key)
        assert differing(before, pixels(page.locator("canvas"))) > 200, key
    page.get_by_role("button", name="Reset view").click()
    assert differing(first, pixels(page.locator("canvas"))) == 0


def test_mouse_turns_the_view_and_the_wheel_scrolls_the_page(show, view):
    """A drag turns the view; the wheel zooms only in a picture that was chosen."""
    page = show(view.to_html() + "<div>text</div>" * 100)
    first = pixels(page.locator("canvas"))
    box = page.locator("canvas").bounding_box()
    x, y = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
    page.mouse.move(x, y)
    page.mouse.wheel(0, 100)
    wait_until(page, "scrollY > 0")
    page.evaluate("scrollTo(0, 0)")
    page.mouse.move(x, y)
    page.mouse.down()
    page.mouse.move(x + 80, y, steps=4)
    page.mouse.up()
    turned = pixels(page.locator("canvas"))
    assert differing(first, turned) > 200
    page.mouse.wheel(0, 100)
    assert differing(turned, pixels(page.locator("canvas"))) > 200
    assert page.evaluate("scrollY") == 0


def test_traces_say_their_values_and_set_the_time(show, view):
    """A trace has a text and its values at the time that is shown; pointing at it goes there."""
    page = show(view.to_html())
    configuration, trace, more = page.locator(".shape-view-trace").all()
    svg = trace.get_by_role("img")
    assert svg.get_attribute("aria-label").startswith(
        "readings in mT over time, from −1 to 1: sensor 1, sensor 2"
    )
    box = svg.bounding_box()
    page.mouse.click(box["x"] + box["width"] * 0.51, box["y"] + 20)
    assert page.get_by_role("slider", name="Time").input_value() == "15"
    value = np.sin(view.time_s[15] + 1)
    assert trace.locator("li").first.inner_text().strip() == f"sensor 1 {value:.3g}"
    assert configuration.locator("li").first.inner_text() == "Δx₁ 15 (15.5)"
    assert [panel.locator("li").count() for panel in (trace, more)] == [4, 4]  # eight readings, in one scale
    assert [panel.locator("p").count() for panel in (trace, more)] == [1, 0]
    limits = [panel.locator(".shape-view-limits span").all_inner_texts() for panel in (trace, more)]
    assert limits == [["1", "0", "−1"]] * 2


def test_play_runs_once_and_only_when_asked(show, view):
    """Nothing moves by itself; Play runs to the end and stops there."""
    page = show(view.to_html(), reduced_motion="reduce")
    slider = page.get_by_role("slider", name="Time")
    page.wait_for_timeout(300)
    assert slider.input_value() == "0"
    page.get_by_role("button", name="Play").click()
    page.get_by_role("button", name="Pause").wait_for()
    wait_until(page, f"document.querySelector('input').value === '{FRAMES - 1}'")
    page.get_by_role("button", name="Play").wait_for()


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_theme_of_the_page_counts(show, view, scheme):
    """The truth is black on light pages, white on dark ones; the attribute of the book's theme comes first."""
    colour = {"light": "rgb(0, 0, 0)", "dark": "rgb(255, 255, 255)"}
    other = {"light": "dark", "dark": "light"}[scheme]
    page = show(view.to_html(), color_scheme=scheme)
    truth = "getComputedStyle(document.querySelector('[data-role=truth]')).backgroundColor"
    assert page.evaluate(truth) == colour[scheme]
    before = pixels(page.locator("canvas"))
    page.evaluate(f"document.documentElement.dataset.theme = '{other}'")
    wait_until(page, f"{truth} === '{colour[other]}'")
    assert differing(before, pixels(page.locator("canvas"))) > 100


def test_narrow_screens(show, view):
    """Everything fits on a telephone, and what can be touched is large enough; a turned telephone is noticed."""
    width = 320
    page = show(view.to_html(), width=width)
    assert page.evaluate("document.documentElement.scrollWidth") <= width
    for button in page.get_by_role("button").all():
        box = button.bounding_box()
        assert box["height"] >= 24
        assert box["x"] + box["width"] <= width
    page.set_viewport_size({"width": 480, "height": 320})
    wait_until(page, "document.querySelector('canvas').width > 400")
    assert len(np.unique(pixels(page.locator("canvas")).reshape(-1, 3), axis=0)) > 100


def test_without_webgl_the_picture_stays(show, view):
    """No canvas, no error: the picture with its text."""
    refuse = "HTMLCanvasElement.prototype.getContext = () => null;"
    page = show(view.to_html(), before=refuse)
    assert page.locator("canvas").count() == 0
    assert page.locator("img").is_visible()
    assert page.locator("img").get_attribute("alt") == view.label
    assert page.evaluate("reproViewer.mount(document.createElement('div'), {}) === null")


def test_live_shapes_one_after_the_other(show):
    """Without times there is no slider; each update replaces the shape; disposing leaves nothing behind."""
    robot = pcc_robot()
    q = torch.zeros(3, dtype=torch.float64)
    covariance = torch.diag(torch.tensor([1e-3, 1e-3, 1e-4], dtype=torch.float64) ** 2)
    page = show("<div id='here'></div>")
    scene = live_scene(robot, label="The estimated shape.", covariance=True)
    mount = "scene => { window.handle = reproViewer.mount(document.getElementById('here'), scene); }"
    page.evaluate(mount, scene)
    assert page.get_by_role("slider").count() == 0
    legend = page.locator(".shape-view-legend").inner_text()
    for name in ("estimate", "± 2 standard deviations", "magnets", "sensors"):
        assert name in legend
    pictures = [pixels(page.locator("canvas"))]
    for bend in (0.0, 0.03, 0.0):
        q[0] = bend
        page.evaluate(
            "frame => handle.update(frame)", json.loads(json.dumps(live_frame(robot, q, covariance)))
        )
        pictures.append(pixels(page.locator("canvas")))
    empty, straight, bent, again = pictures
    assert differing(empty, straight) > 400
    assert differing(straight, bent) > 700
    assert differing(straight, again) == 0
    page.evaluate("handle.dispose()")
    assert page.evaluate("document.getElementById('here').innerHTML") == ""
