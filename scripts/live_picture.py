"""Take the pictures of what lives on pages: ``python scripts/live_picture.py [CHROMIUM]``.

book/_static/live_page.png is for the pages ``live`` and ``commands``. It shows ``repro live`` on an emulated board of
which a chip freezes, so it differs a little each time. book/_static/show_page.png shows ``repro show`` for
``commands``. The others stand in place of the live figures where there are no scripts, book/_static/live/NAME.png.
"""

from __future__ import annotations

import io
import re
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import IO, Any

from PIL import Image
from playwright.sync_api import Browser, sync_playwright

import repro
from repro_companion.run import project_folder

FLAGS = ["--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]
BOARD = "emulate robot.toml --fault stick 2 --fault-from 8 --port-file board"
LIVE = "live board --robot robot.toml --browser"
AFTER_ALARM_MS = 4000
FIGURES = {
    "magnets": "start:straight",  # so that the descent is seen beside the true shape
    "particles": "",
    "failure": "off:4;8;12",
    "landscape": "",
    "imus": "",
}
"""Live figures, each with its state in the address."""
PARTS = ("model", "figure", "landscape_grid")
"""Scripts that a figure may need, in the order in which they are loaded; its own comes last."""
PRESSED = {"particles": 3 * 40}
"""How often the first button is pressed: three times for a step of the filter."""
WIDTH, COLOURS = 700, 96
PAGE = """<!doctype html><html data-theme="light"><meta charset="utf-8"><link rel="stylesheet" href="live.css">
<style>:root {{ --pst-color-background: #fff; --pst-color-border: #fff; }} body {{ margin: 0; }}
.live-handle {{ display: none; }} .live-figure {{ margin: 0; }}</style>
<div class="live-figure" data-live="{name}"></div>{scripts}"""


def live_page(browser: Browser) -> None:
    """Start the board and ``repro live``, wait for the alarm, and take the picture."""
    folder, command = Path(tempfile.mkdtemp()), str(Path(sys.executable).with_name("repro"))
    (folder / "robot.toml").write_bytes((repro.example() / "robot.toml").read_bytes())
    board = subprocess.Popen([command, *BOARD.split()], cwd=folder, stdout=subprocess.DEVNULL)
    while not (folder / "board").exists():
        time.sleep(0.1)
    live = subprocess.Popen([command, *LIVE.split()], cwd=folder, stderr=subprocess.PIPE, text=True)
    said: IO[str] | Any = live.stderr
    address = next(found[0] for line in said if (found := re.search(r"http\S+", line)))
    page = browser.new_page(viewport={"width": 620, "height": 1200}, color_scheme="light")
    page.goto(address)
    page.wait_for_selector("#alarms p")
    page.wait_for_timeout(AFTER_ALARM_MS)
    below: Any = page.locator("#numbers-title").bounding_box()
    page.screenshot(
        path=project_folder() / "book" / "_static" / "live_page.png",
        clip={"x": 0, "y": 0, "width": 620, "height": below["y"]},
    )
    for process in (live, board):
        process.terminate()
        process.wait()


def show_page(browser: Browser) -> None:
    """Write what ``repro show`` makes of the example's table, and take the picture down to its alarms."""
    folder, command = Path(tempfile.mkdtemp()), str(Path(sys.executable).with_name("repro"))
    files = [repro.example() / "mine.csv", "--robot", repro.example() / "robot.toml", "-o", "shown.html"]
    subprocess.run([command, "show", *files], cwd=folder, check=True)
    page = browser.new_page(viewport={"width": 620, "height": 1200}, color_scheme="light")
    page.goto((folder / "shown.html").as_uri())
    page.wait_for_timeout(2000)
    below: Any = page.get_by_role("heading", name="Alarms").bounding_box()
    clip: Any = {"x": 0, "y": 0, "width": 620, "height": below["y"]}
    taken = Image.open(io.BytesIO(page.screenshot(clip=clip))).convert("RGB")
    path = project_folder() / "book" / "_static" / "show_page.png"
    taken.quantize(COLOURS, Image.Quantize.MAXCOVERAGE).save(path, optimize=True)


def still(browser: Browser, name: str) -> None:
    """Take the picture of a live figure as it is when its page is opened."""
    folder = project_folder() / "book" / "_static" / "live"
    page = browser.new_page(viewport={"width": WIDTH, "height": 900})
    # What lies beside a page from disk may be loaded from there.
    page.goto(f"{(folder / 'live.css').as_uri()}#{name}={FIGURES[name]}")
    scripts = "".join(f'<script charset="utf-8" src="{part}.js"></script>' for part in (*PARTS, name))
    page.set_content(PAGE.format(name=name, scripts=scripts))
    page.wait_for_function("document.querySelector('.live-figure').live?.dirty === false")
    press = "times => { for (let k = 0; k < times; k++) document.querySelector('.live-controls button').click(); }"
    page.evaluate(press, PRESSED.get(name, 0))
    page.wait_for_timeout(500)
    taken = Image.open(io.BytesIO(page.locator(".live-stage").screenshot())).convert("RGB")
    taken.quantize(COLOURS, Image.Quantize.MAXCOVERAGE).save(folder / f"{name}.png", optimize=True)
    page.close()


def main(chromium: str = "/usr/bin/chromium") -> None:
    """Take all pictures."""
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=chromium, args=FLAGS)
        for name in FIGURES:
            still(browser, name)
        live_page(browser)
        show_page(browser)


if __name__ == "__main__":
    main(*sys.argv[1:])
