"""Where Chromium is, and how it is started for tests; run as a program, it installs one where there is none."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

NAMES = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable", "chrome")
ON_MACOS = tuple(
    Path(f"/Applications/{name}.app/Contents/MacOS/{name}") for name in ("Chromium", "Google Chrome")
)
FLAGS = [
    "--headless",
    "--no-sandbox",
    "--disable-gpu",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
]
LONGEST_MS = 120_000
"""What a browser has not done by then it does not do, however busy the computer is."""
MISSING = (
    "Chromium is needed to check the pages and could not be installed. Debian and Ubuntu: apt-get install chromium; "
    "elsewhere: .venv/bin/playwright install chromium. One that lies elsewhere: CHROMIUM=/path/to/it make check-site"
)


def find() -> str | None:
    """Return the program: the one named in ``CHROMIUM``, one that is installed, or playwright's own."""
    if named := os.environ.get("CHROMIUM"):
        return shutil.which(named)
    for name in NAMES:
        if found := shutil.which(name):
            return found
    for path in ON_MACOS:
        if path.is_file():
            return str(path)
    return _of_playwright()


def _of_playwright() -> str | None:
    from playwright.sync_api import sync_playwright

    with sync_playwright() as playwright:
        path = Path(playwright.chromium.executable_path)
    return str(path) if path.is_file() else None


def install() -> None:
    """Install Chromium: by apt-get where that may be used, otherwise by playwright; may fail, and then says why."""
    commands = [[sys.executable, "-m", "playwright", "install", "chromium"]]
    if shutil.which("apt-get") and hasattr(os, "geteuid") and os.geteuid() == 0:
        apt = ["apt-get", "-qq", "-o", "Dpkg::Use-Pty=0"]
        commands = [
            [*apt, "update"],
            [*apt, "install", "-y", "--no-install-recommends", "chromium"],
        ]
    environment = {**os.environ, "DEBIAN_FRONTEND": "noninteractive"}
    for command in commands:
        if subprocess.run(command, env=environment, stdout=subprocess.DEVNULL, check=False).returncode:
            print(f"This failed: {' '.join(command)}", file=sys.stderr)
            return


@contextmanager
def started(executable: str) -> Iterator:
    """Start Chromium; every page that it opens has a profile of its own."""
    from playwright.sync_api import sync_playwright

    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=executable, args=FLAGS, timeout=LONGEST_MS)
        yield browser
        browser.close()


def main() -> int:
    """Make sure that there is a Chromium, and print where; return 0, or 1 where there is none and none can be had."""
    if find() is None:
        print("Chromium is not installed; installing it.", file=sys.stderr)
        install()
        if find() is None:
            print(MISSING, file=sys.stderr)
            return 1
    print(find())
    return 0


if __name__ == "__main__":
    sys.exit(main())
