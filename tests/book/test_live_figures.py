"""The live figures, opened from disk without the site: by keyboard, by pointer, from an address, and at rest."""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
import pytest
from page_on_screen import differing, pixels, wait_until
from page_visit import AXE, SEVERE, VIOLATIONS

ROOT = Path(__file__).resolve().parents[2]
LIVE = ROOT / "book" / "_static" / "live"
FIGURES = ("magnets", "particles", "failure", "landscape", "imus")
PARTS = ("model", "figure", *FIGURES)
LARGEST_LINES, LARGEST_BYTES = 1850, 110_000
FIRST_FRAME_MS = 300
NOW = "document.querySelector('.live-figure').live.now"
IN_THE_ADDRESS = """() => {
  const { state, view } = document.querySelector('.live-figure').live, said = location.hash.split(/[=,]/);
  return Object.keys(state).every(key => state[key] === view.defaults[key] || said.includes(key + ':' + state[key]));
}"""
"""Where a figure has come to rest its address says all of its state."""
ERRORS = r"(?:less than )?([\d.]+) mm with least squares, ([\d.]+) mm with gradient descent"


def said(page, pattern: str) -> re.Match:
    """Return what the summary in words says, once it says it."""
    wait_until(page, f"() => /{pattern}/.test(document.querySelector('.live-text').textContent)")
    found = re.search(pattern, page.locator(".live-text").inner_text())
    assert found is not None
    return found


def moved_to(page, label: str, key: str, times: int = 1) -> None:
    slider = page.get_by_label(label)
    slider.focus()
    for _ in range(times):
        page.keyboard.press(key)


def test_small_enough_to_be_read():
    texts = [(LIVE / f"{part}.js").read_text(encoding="utf-8") for part in PARTS]
    assert sum(text.count("\n") for text in texts) <= LARGEST_LINES
    assert sum(len(text.encode()) for text in texts) <= LARGEST_BYTES


@pytest.mark.parametrize("name", FIGURES)
@pytest.mark.parametrize("width", [390, 1400])
def test_drawn_and_at_rest(figure, name, width):
    """Soon after it is loaded the figure is there, fits its page, is accessible, and does not move by itself."""
    page = figure(name, width=width)
    tools = page.context.new_cdp_session(page)
    tools.send("Performance.enable")

    def worked_ms() -> float:
        """Of the processor, for the thread of the page: others that are busy do not count."""
        measured = {one["name"]: one["value"] for one in tools.send("Performance.getMetrics")["metrics"]}
        return 1e3 * measured["ThreadTime"]

    before_ms = worked_ms()
    page.evaluate(
        "() => { const box = document.querySelector('.live-figure'); REPRO.views[box.dataset.live](box); }"
    )
    assert worked_ms() - before_ms < FIRST_FRAME_MS
    stage = page.locator(".live-stage")
    before = pixels(stage)
    assert before.std() > 5
    page.wait_for_timeout(150)
    assert differing(before, pixels(stage)) == 0
    assert page.evaluate("document.documentElement.scrollWidth") <= width
    page.evaluate(AXE.read_text(encoding="utf-8"))
    assert [one for one in page.evaluate(VIOLATIONS, None) if one["impact"] in SEVERE] == []
    fields = page.locator(".live-figure :is(input, select)")
    unnamed = fields.evaluate_all("all => all.filter(one => !one.labels.length).length")
    assert unnamed == 0


@pytest.mark.parametrize("name", [name for name in FIGURES if name != "failure"])
def test_a_handle_is_moved_by_pointer_and_by_keys(figure, name):
    """Each way changes the picture and the address; the address alone brings the same picture and words again."""
    page = figure(name)
    stage, handle = page.locator(".live-stage"), page.locator(".live-handle")
    before = pixels(stage)
    handle.focus()
    for key in ("ArrowRight", "ArrowUp", "ArrowRight"):
        page.keyboard.press(key)
    by_keys = pixels(stage)
    assert differing(before, by_keys) > 50
    box = handle.bounding_box()
    x, y = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
    page.mouse.move(x, y)
    page.mouse.down()
    page.mouse.move(x - 30, y + 10, steps=4)
    page.mouse.up()
    handle.blur()
    by_pointer = pixels(stage)
    assert differing(by_keys, by_pointer) > 50
    after = handle.bounding_box()
    assert abs(after["x"] - (box["x"] - 30)) < 12, "the handle follows the pointer"
    wait_until(page, IN_THE_ADDRESS)
    words = page.locator(".live-text").inner_text()
    again = figure(name, page.evaluate("location.hash"))
    assert differing(by_pointer, pixels(again.locator(".live-stage"))) < 30
    assert again.locator(".live-text").inner_text() == words


def test_least_squares_against_descent(figure):
    """From the straight pose least squares needs few steps, and the paper's steps more than it takes."""
    page = figure("magnets", "#magnets=segments:1,noise:0,start:straight")
    lm, descent = map(float, said(page, ERRORS).groups())
    assert lm <= 1e-4 < 0.1 < descent
    moved_to(page, "Evaluations", "Home")
    early, _ = map(float, said(page, "after 2 evaluations: " + ERRORS).groups())
    assert early > 100 * lm


def test_a_descent_from_the_truth_owes_its_error_to_its_start(figure):
    """From the truth it is closer than least squares with every noise; the words give what a cold start has."""
    for seed in (1, 2, 3):
        page = figure("magnets", f"#magnets=seed:{seed}")
        least, near = map(float, said(page, ERRORS).groups())
        cold = said(page, r"from the straight pose it has ([\d.]+) mm").group(1)
        assert near < least < float(cold) / 10
        page.get_by_label("Start").select_option("straight")
        said(page, f"least squares, {cold} mm with gradient descent")
        assert "started at the true shape" not in page.locator(".live-text").inner_text()


def test_the_figure_starts_as_the_paper_does(figure):
    """At the true shape, then from estimate to estimate: after a jump the descent is behind, and it catches up."""
    page = figure("magnets", "#magnets=segments:1,noise:0")
    error = "() => { const { now } = document.querySelector('.live-figure').live; return now.off_mm(now.descent.q); }"
    assert page.evaluate(error) < 1e-6
    behind = []
    for evaluations in (20, 19, 20):  # another number asks again for the same shape
        page.evaluate(
            f"document.querySelector('.live-figure').live.set({{course: 160, evaluations: {evaluations}}})"
        )
        page.evaluate("() => new Promise(done => requestAnimationFrame(() => requestAnimationFrame(done)))")
        behind.append(page.evaluate(error))
    assert behind[0] > 0.1
    assert behind[2] < behind[1] < behind[0]


def test_a_sensor_off_leaves_a_direction_open(figure):
    """Two sensors do not determine a segment: shapes that read alike are drawn, until it is on again."""
    page = figure("magnets", "#magnets=segments:1")
    assert "shapes are drawn" not in page.locator(".live-text").inner_text()
    second = page.get_by_role("button", name="Sensor 2 on segment 1")
    second.focus()
    page.keyboard.press("Enter")
    said(page, "2 of 3 sensors in use.*other shapes are drawn")
    assert second.get_attribute("aria-pressed") == "false"
    alike = page.evaluate("""() => {
      const { live } = document.querySelector('.live-figure'), { ghosts, sensing, lm, use } = live.now;
      const off = q => Math.max(...sensing(q, false).u.map((u, s) => use[s] * Math.abs(u - lm.u[s])));
      return Math.max(...ghosts.shapes.map(off));
    }""")
    assert alike < 0.03, "the shapes read alike [mT]"
    second.press("Enter")
    said(page, "3 of 3 sensors in use")


def test_calibration_finds_the_parts(figure):
    """With parts that are not where the drawing has them, the error falls once the model is calibrated."""
    page = figure("magnets", "#magnets=segments:1,tolerances:true")
    as_drawn = float(said(page, ERRORS).group(1))
    page.get_by_label("Model calibrated").check()
    said(page, "The model is calibrated")
    assert float(said(page, ERRORS).group(1)) < as_drawn / 3


@pytest.mark.slow
def test_particles_step_by_step(figure):
    """Weighing, drawing and moving in turn bring the cloud to the bend; the error then keeps to the law's order."""
    page = figure("particles")
    for _ in range(14):
        for name in ("Weigh", "Draw anew", "Move"):
            page.get_by_role("button", name=name, exact=True).click()
            wait_until(
                page, f"() => document.querySelector('.live-controls button').textContent !== '{name}'"
            )
    errors = page.evaluate("document.querySelector('.live-figure').live.errors")
    assert errors[0] > 3
    assert np.mean(errors[-4:]) < 0.3


def test_more_imus_and_a_better_model(figure):
    """With perfect sensors the error falls with their number, and from rigid links to the extended model."""
    page = figure("imus", "#imus=imus:2,mounting:0,heading:0,tilt:0")
    two = page.evaluate(NOW)
    page.get_by_label("IMUs", exact=True).select_option("8")
    said(page, "With 8 IMUs.*The IMUs are perfect")
    eight = page.evaluate(NOW)
    assert eight["pcc"]["errors"][1] < two["pcc"]["errors"][1] / 4
    assert eight["pcc"]["errors"][1] < eight["rigid"]["errors"][1] / 4


def test_opposite_sensors_are_needed(figure):
    """Without both sensors of an axis a segment does not know its bend; the figure says so, and the tip is lost."""
    page = figure("failure")
    assert float(said(page, r"the tip is off by ([\d.]+) mm").group(1)) < 2
    second = page.get_by_role("button", name="Sensor 2, on segment 1")
    second.focus()
    page.keyboard.press("Enter")
    assert float(said(page, r"2 of 12 .* is off by ([\d.]+) mm.*bend in y of segment 1 is not").group(1)) > 50
    assert second.get_attribute("aria-pressed") == "false"
    page.get_by_role("button", name="All work").click()
    said(page, "All sensors work")


@pytest.mark.parametrize(("step", "rests"), [(0.2, True), (0.3, True), (0.5, True), (0.7, False), (1, False)])
def test_a_descent_rests_only_below_the_limit(figure, step, rests):
    """With the published momentum: whether it comes to rest is what the product of step and curvature says."""
    page = figure("landscape", f"#landscape=step:{step},evaluations:70")
    now = page.evaluate(NOW)
    (before, last), left = now["trail"][-2:], now["left"]
    moved = np.hypot(last["x"] - before["x"], last["y"] - before["y"])
    assert (left is None and moved < 0.01) == rests
    said(
        page, "the descent comes to rest there" if rests else "is not at rest|no descent comes to rest there"
    )
    if rests:
        assert now["product"] < now["limit"]


def test_where_the_loss_curves_downwards_nothing_rests(figure):
    page = figure("landscape", "#landscape=step:3")
    said(page, "γλ is -31: the loss curves downwards there, and no descent comes to rest")
    assert page.evaluate(NOW)["product"] < 0


def test_a_press_on_the_map_starts_there(figure):
    page = figure("landscape")
    handle, canvas = (page.locator(part).bounding_box() for part in (".live-handle", ".live-stage canvas"))
    x, y = handle["x"] + handle["width"] / 2 + 60, handle["y"] + handle["height"] / 2 - 40
    page.mouse.click(x, y)
    state = page.evaluate("document.querySelector('.live-figure').live.state")
    assert state["x"] / state["y"] == pytest.approx(1.5, rel=0.05)
    page.mouse.click(canvas["x"] + canvas["width"] - 30, y)  # beside the map
    assert page.evaluate("document.querySelector('.live-figure').live.state") == state


def test_motion_only_on_demand(figure):
    """The course runs when asked to; where motion is unwanted, a press is one step."""
    page = figure("magnets")
    follow = page.get_by_role("button", name="Follow the course")
    follow.click()
    wait_until(page, "() => document.querySelector('.live-figure').live.state.course > 61")
    page.get_by_role("button", name="Pause").click()
    page.emulate_media(reduced_motion="reduce")
    course = "document.querySelector('.live-figure').live.state.course"
    before = page.evaluate(course)
    follow.click()
    wait_until(page, f"() => {course} !== {before}")
    page.wait_for_timeout(100)
    assert page.evaluate(course) == pytest.approx((before + 20) % 400)


NONSENSE = [
    "#magnets=segments:9,noise:x,off:99,q:1;2",
    "#magnets=%E0%A4%A",
    "#magnets=course:-5,view:1e9",
    "#failure=off:99;x;1.5;3;3,from:-3,time:1e9,noise:-1",
    "#landscape=step:-5,x:1e9,y:x,evaluations:0.5,momentum:7",
    "#imus=imus:3,segments:9,shape:1;2,heading:-4,model:x",
]


@pytest.mark.parametrize("address", NONSENSE)
def test_an_address_that_makes_no_sense(figure, address):
    """The figure shows itself as far as the address can be read."""
    name = address[1:].partition("=")[0]
    assert pixels(figure(name, address).locator(".live-stage")).std() > 5


def pages_with_figures() -> dict[str, str]:
    """Return pages that have a live figure, as text."""
    notebooks = {
        path.name: json.loads(path.read_text(encoding="utf-8")) for path in ROOT.glob("notebooks/*.ipynb")
    }
    texts = {
        name: "".join("".join(cell["source"]) for cell in one["cells"]) for name, one in notebooks.items()
    }
    texts["index.md"] = (ROOT / "book" / "index.md").read_text(encoding="utf-8")
    return {name: text for name, text in texts.items() if "data-live=" in text}


@pytest.mark.parametrize(("page", "text"), pages_with_figures().items(), ids=pages_with_figures())
def test_a_still_without_scripts(page, text):
    """Each figure has a picture with words in its place."""
    stills = re.findall(
        r'data-live="(\w+)".*?>\s*<noscript>.*?<img src="(?:../)?_static/live/(\w+)\.png"[^>]* alt="([^"]{60,})"',
        text,
    )
    assert len(stills) == text.count("data-live=")
    for name, picture, words in stills:
        assert picture == name in FIGURES
        assert (LIVE / f"{picture}.png").stat().st_size < 25_000
        assert words.endswith(".")
