"""A notebook that logs its runs, and sweeps of it in processes of their own."""

from __future__ import annotations

import subprocess
import sys
import time
from collections import Counter
from pathlib import Path

# begins a line in a log for every run of the cell, and another one when it ends
LOGGED = """\
import os, time
with open(os.environ["SWEEP_LOG"], "a") as log:
    print("begun", n, os.getpid(), file=log, flush=True)
    time.sleep(seconds)
    print("done", n, os.getpid(), file=log, flush=True)
if n == 13:
    raise ValueError("unlucky")"""
PARAMETERS = "n: int = 3  # how many\nseconds: float = 0.0  # to sleep"


def logged(root: Path, word: str) -> Counter[int]:
    """Return how often every point was begun or done."""
    lines = (root / "log").read_text().splitlines() if (root / "log").exists() else []
    return Counter(int(line.split()[1]) for line in lines if line.split()[0] == word)


COMMAND = """\
import sys
from cyclopts import App
from edition1_companion.cli_sweep import sweep
app = App(name="repro")
app.command(sweep)
sys.exit(app(["sweep", *sys.argv[1:]], result_action="return_value"))"""


def in_background(*arguments: str) -> subprocess.Popen[str]:
    """Call the command in a process of its own."""
    command = [sys.executable, "-c", COMMAND, *arguments]
    streams = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
    return subprocess.Popen(command, start_new_session=True, **streams)


def wait_for(condition, seconds: float = 180.0) -> None:
    """Wait until a condition holds."""
    deadline = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < deadline, "waited too long"
        time.sleep(0.02)
