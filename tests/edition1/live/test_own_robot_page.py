"""The page "Your own robot", followed to its end: every command as it stands and in its order, in two terminals."""

from __future__ import annotations

import json
import os
import re
import shlex
import shutil
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from moving_robot import robot_readings
from own_rig import Rig

from edition1.robot_file.load import load_robot
from edition1_live.emulate.links import HAS_PTY
from edition1_live.record.recording import read_recording

PROJECT = Path(__file__).parents[3]
COMMANDS = [
    line
    for block in re.findall(r"```sh\n(.*?)```", (PROJECT / "book" / "own_robot.md").read_text(), re.S)
    for line in block.strip().splitlines()
]
ROBOT = PROJECT / "data" / "robots" / "one_segment.toml"
LONG_S = 240.0
"""Longest wait for anything: the first use of compiled kernels takes a minute or two."""
LIVE_S = 3.0
FAULT_S = 5.0
CTRL_C = "\x03"

pytestmark = pytest.mark.skipif(not HAS_PTY, reason="no pseudo-terminals on this system")


class Terminal:
    """A terminal in a folder, in which one command runs at a time."""

    def __init__(self, folder: Path, command: str) -> None:
        program, *rest = shlex.split(command)
        assert program == "repro"
        self._master, slave = os.openpty()
        self._process = subprocess.Popen(
            [sys.executable, "-m", "edition1_companion.cli", *rest],
            cwd=folder,
            stdin=slave,
            stdout=slave,
            stderr=slave,
            preexec_fn=lambda: os.login_tty(slave),  # so that Ctrl-C reaches it
            env={**os.environ, "COLUMNS": "200"},
        )
        os.close(slave)
        self.command, self.text = command, ""
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()

    def _read(self) -> None:
        while True:
            try:
                data = os.read(self._master, 65536)
            except OSError:  # the command ended
                return
            if not data:
                return
            self.text += data.decode(errors="replace")

    def type(self, keys: str) -> None:
        os.write(self._master, keys.encode())

    def wait_for(self, pattern: str) -> None:
        """Wait until a pattern is shown."""
        self.wait(lambda: re.search(pattern, self.text) is not None, pattern)

    def wait(self, done: Callable[[], bool], what: str) -> None:
        deadline = time.monotonic() + LONG_S
        while not done():
            ended = self._process.poll() is not None
            if ended:
                self._reader.join(5)
                if done():
                    return
            assert not ended, f"{self.command} ended before {what}:\n{self.text}"
            assert time.monotonic() < deadline, f"{self.command}: no {what}:\n{self.text}"
            time.sleep(0.02)

    def end(self, keys: str = "") -> str:
        """Wait until the command ends, after these keys; return what it said."""
        if keys and self._process.poll() is None:
            self.type(keys)
        code = self._process.wait(LONG_S)
        self._reader.join(5)
        os.close(self._master)
        assert code == 0, f"{self.command}\n{self.text}"
        return self.text

    def kill(self) -> None:
        if self._process.poll() is None:
            self._process.kill()
            self._process.wait()


class Reader:
    """Somebody who follows the page: the robot in one terminal, everything else in another."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.robot: Terminal | None = None
        self.other: Terminal | None = None
        self.said: dict[str, str] = {}

    def follow(self, command: str) -> None:
        """Do what the page says with a command."""
        if command.startswith("repro emulate"):
            self.switch_off()
            assert not (self.folder / "board").exists()
            self.robot = Terminal(self.folder, command)
            self.robot.wait_for(r"Port: .*board")
            return
        self.other = Terminal(self.folder, command)
        if command.startswith("repro calibrate board"):
            self.take_poses(self.other)
        elif command.startswith("repro live"):
            self.other.wait_for(r"estimates/s")
            time.sleep(FAULT_S + LIVE_S if "two_segments" in command else LIVE_S)
            self.said[command] = self.other.end(CTRL_C)
            return
        self.said[command] = self.other.end()

    def take_poses(self, other: Terminal) -> None:
        assert self.robot is not None
        count = len(pd.read_csv(self.folder / "poses.csv"))
        for k in range(1, count + 1):
            other.wait_for(rf"Pose {k} of {count}\b")
            self.robot.wait_for(rf"Holding pose {k} of {count}\b")
            other.type("\n")
            if k < count:
                other.wait_for(rf"Pose {k + 1} of {count}\b")
                self.robot.type("\n")

    def switch_off(self) -> None:
        if self.robot is not None:
            self.robot.end(CTRL_C)
            self.robot = None

    def leave(self) -> None:
        for terminal in (self.robot, self.other):
            if terminal is not None:
                terminal.kill()


def read_by_one(folder: Path, commands: list[str]) -> Reader:
    """Follow commands of the page in a folder that has the robots."""
    shutil.copytree(PROJECT / "data" / "robots", folder / "data" / "robots")
    if any(command.startswith("repro fit") for command in commands):
        rig = Rig.of("one_segment")  # what a reader has recorded with motion capture
        rig.write_recording(folder / "motion.rec")
        rig.write_poses(folder / "captured.csv", *rig.measured())
    reader = Reader(folder)
    try:
        for command in commands:
            reader.follow(command)
        reader.switch_off()
    finally:
        reader.leave()
    return reader


@pytest.fixture(scope="module")
def followed(tmp_path_factory: pytest.TempPathFactory) -> list[Reader]:
    """Follow the page from its first command to its last.

    What it says of a recording in which poses were held is half a minute of waiting, on which nothing else depends:
    somebody else follows that meanwhile.
    """
    folders = [tmp_path_factory.mktemp(name) for name in ("robot", "held")]
    parts = [[command for command in COMMANDS if ("held" in command) == held] for held in (False, True)]
    with ThreadPoolExecutor(2) as pool:
        return list(pool.map(read_by_one, folders, parts))


def said(followed: list[Reader], start: str) -> tuple[Path, str]:
    """Return where the only command that starts so ran, and what it said."""
    ((folder, found),) = [
        (reader.folder, text)
        for reader in followed
        for command, text in reader.said.items()
        if command.startswith(start)
    ]
    return folder, found


def test_record(followed):
    folder, _ = said(followed, "repro record board --format frames --channels 3 --duration 5")
    assert len(read_recording(folder / "first.rec").frames) > 100


@pytest.mark.parametrize(
    ("command", "name"),
    [("repro calibrate board", "calibration.json"), ("repro calibrate held.rec", "from_recording.json")],
)
def test_calibrate(followed, command, name):
    """Both ways find the robot: its readings are predicted ten times better than by its file, and chi2 is near 1."""
    folder, text = said(followed, command)
    assert f"Written: {name}" in text
    assert "Warning" not in text
    assert 0.2 < json.loads((folder / name).read_text())["chi2"] < 2
    true = robot_readings(load_robot(ROBOT), duration_s=2.0, rate_hz=50.0, tolerances=1.0)
    worst = []
    for calibration in (None, folder / name):
        found = load_robot(folder / "data" / "robots" / "one_segment.toml", calibration)
        predicted = found.values(found.lower.new_tensor(true.q)).numpy()
        worst.append(np.abs(predicted - true.values).max())
    assert worst[1] < 0.1 * worst[0]


def test_live(followed):
    _, text = said(followed, "repro live board --robot data/robots/one_segment.toml --calibration")
    assert "estimates/s by levenberg_marquardt" in text
    assert "delta_x_1 " in text


def test_live_with_a_broken_sensor(followed):
    """It says that the readings do not fit, and which sensor it is."""
    _, text = said(followed, "repro live board --robot data/robots/two_segments.toml")
    assert "estimates/s by levenberg_marquardt" in text
    assert "Wrong, not to be trusted: residuals are" in text
    assert "It is sensor 3 (--failed 3 leaves it out)." in text
    assert "delta_x_2 " in text


def test_the_recording_is_taken_out_and_estimated(followed):
    of_first = "repro export first.rec --robot data/robots/one_segment.toml"
    folder, exported = said(followed, f"{of_first} -o")
    _, together = said(followed, f"{of_first} --estimates")
    _, imported = said(followed, "repro import")
    _, tracked = said(followed, "repro track")
    n = len(read_recording(folder / "first.rec").frames)
    assert f"first.csv  ({n} frames)" in exported
    assert f"first.mcap  ({n} frames)" in together
    assert f"again.rec  ({n} frames)" in imported
    assert list(pd.read_csv(folder / "first.csv"))[-3:] == ["u1_mT", "u2_mT", "u3_mT"]
    assert f"estimates.csv  ({n} estimates)" in tracked
    page = (PROJECT / "book" / "own_robot.md").read_text()
    (code,) = [block for block in re.findall(r"```python\n(.*?)```", page, re.S) if "read_recording" in block]
    subprocess.run([sys.executable, "-c", code], cwd=folder, check=True)
    table, named = pd.read_csv(folder / "estimates.csv"), set(re.findall(r"`(\w+)`", page))
    assert {name for name in table if "_1" not in name and "y" not in name and "z" not in name} <= named


def test_the_exported_table_gives_the_same_estimates(followed):
    folder, _ = said(followed, "repro track")
    (command,) = [command for command in COMMANDS if command.startswith("repro track")]
    again = command.replace("first.rec", "first.csv").replace("estimates.csv", "again.csv")
    Terminal(folder, again).end()
    assert (folder / "again.csv").read_bytes() == (folder / "estimates.csv").read_bytes()


def test_fit(followed):
    folder, text = said(followed, "repro fit")
    assert "Lag: +3" in text
    assert "Written: judged" in text
    named = {"errors.csv", "estimates.csv", "estimates.png", "report.txt", "calibration.json"}
    assert {path.name for path in (folder / "judged").iterdir()} == named
