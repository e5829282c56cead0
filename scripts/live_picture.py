"""Take the picture on the page ``live``, book/_static/live_page.png: ``python scripts/live_picture.py [CHROMIUM]``.

It shows ``repro live`` on an emulated board of which a chip freezes, so it differs a little each time.
"""

from __future__ import annotations

import re
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import IO, Any

from playwright.sync_api import sync_playwright

import repro
from repro_companion.run import project_folder

FLAGS = ["--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]
BOARD = "emulate robot.toml --fault stick 2 --fault-from 8 --port-file board"
LIVE = "live board --robot robot.toml --browser"
AFTER_ALARM_MS = 4000


def main(chromium: str = "/usr/bin/chromium") -> None:
    """Start the board and ``repro live``, and wait for the alarm."""
    folder, command = Path(tempfile.mkdtemp()), str(Path(sys.executable).with_name("repro"))
    (folder / "robot.toml").write_bytes((repro.example() / "robot.toml").read_bytes())
    board = subprocess.Popen([command, *BOARD.split()], cwd=folder, stdout=subprocess.DEVNULL)
    while not (folder / "board").exists():
        time.sleep(0.1)
    live = subprocess.Popen([command, *LIVE.split()], cwd=folder, stderr=subprocess.PIPE, text=True)
    said: IO[str] | Any = live.stderr
    address = next(found[0] for line in said if (found := re.search(r"http\S+", line)))
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=chromium, args=FLAGS)
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


if __name__ == "__main__":
    main(*sys.argv[1:])
