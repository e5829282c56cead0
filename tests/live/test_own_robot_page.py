"""The page "Your own robot": every command on it runs, against the emulator, as a reader would run it."""

from __future__ import annotations

import re
import shlex
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest
import torch
from own_rig import Rig

from repro.live.emulate.links import HAS_PTY
from repro.live.record.recording import read_recording
from repro.live.record.recording_file import RecordingFile
from repro.live.robot.calibration_poses import coordinate_columns
from repro.live.robot.robot_file import RobotFile, load_robot
from repro.live.wire.frame import Frame

PROJECT = Path(__file__).parents[2]
COMMANDS = [
    line
    for block in re.findall(r"```sh\n(.*?)```", (PROJECT / "book" / "own_robot.md").read_text(), re.S)
    for line in block.strip().splitlines()
]
ENTER = "\n" * 40
SECOND_NS = 10**9

pytestmark = pytest.mark.skipif(not HAS_PTY, reason="no pseudo-terminals on this system")


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder as the page takes it to be: with the robots, and the tables of poses that a reader makes."""
    path = tmp_path_factory.mktemp("robot")
    shutil.copytree(PROJECT / "data" / "robots", path / "data" / "robots")
    robot = load_robot(path / "data" / "robots" / "one_segment.toml")
    generator = torch.Generator().manual_seed(0)
    q = robot.lower + (robot.upper - robot.lower) * torch.rand(
        12, 3, dtype=torch.float64, generator=generator
    )
    names = ",".join(coordinate_columns(robot))
    rows = [",".join(f"{1e3 * x:.6f}" for x in row) for row in q.tolist()]
    held = [f"{row},{k + 0.5}" for k, row in enumerate(rows)]
    (path / "held.csv").write_text("\n".join([f"{names},time_s", *held]) + "\n")
    recorded(path / "held.rec", robot, q, hold=1000)
    # at the port the robot rests in one pose, which is asked for again and again
    still = ",".join(f"{1e3 * x:.6f}" for x in robot.start.tolist())
    (path / "poses.csv").write_text("\n".join([names, *[still] * 4]) + "\n")
    recorded(path / "still.rec", robot, robot.start[None], hold=500)
    return path


def recorded(path: Path, robot: RobotFile, q: torch.Tensor, *, hold: int) -> None:
    """Record poses, each held for so many frames at 1000 Hz."""
    noise = np.random.default_rng(0)
    values = robot.values(q).repeat_interleave(hold, 0).numpy()
    values = values + robot.noise * noise.standard_normal(values.shape)
    about = {"format": "frames", "start_unix_s": 0.0, "start_host_ns": 0}
    with RecordingFile(path, about) as file:
        for k, row in enumerate(values.tolist()):
            file.append(k * SECOND_NS // 1000, [Frame(0, k, k * 1000, tuple(row))])


def arguments(command: str) -> list[str]:
    program, *rest = shlex.split(command)
    assert program == "repro"
    return [sys.executable, "-m", "repro.cli", *rest]


@contextmanager
def board(folder: Path, command: str) -> Iterator[None]:
    """Run an emulated board until its port is there, and stop it at the end."""
    process = subprocess.Popen(
        arguments(command), cwd=folder, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE
    )
    try:
        deadline = time.monotonic() + 60
        while not (folder / "board").exists():
            assert process.poll() is None, process.communicate()[1]
            assert time.monotonic() < deadline
            time.sleep(0.05)
        yield
    finally:
        process.send_signal(signal.SIGINT)
        process.communicate(timeout=30)
    assert process.returncode == 0


def run(folder: Path, command: str, given: str = "") -> str:
    done = subprocess.run(
        arguments(command), cwd=folder, input=given, capture_output=True, text=True, timeout=240, check=False
    )
    assert done.returncode == 0, f"{command}\n{done.stdout}{done.stderr}"
    return done.stdout + done.stderr


def one(start: str) -> str:
    """Return the only command that starts so."""
    (found,) = [command for command in COMMANDS if command.startswith(start)]
    return found


def test_no_command_is_forgotten():
    known = [
        *("repro emulate", "repro record"),
        *("repro calibrate board", "repro calibrate held.rec"),
        *("repro live", "repro fit"),
    ]
    assert sorted(COMMANDS) == sorted(map(one, known))


def test_emulate_record_and_live(folder):
    with board(folder, one("repro emulate")):
        assert "frames" in run(folder, one("repro record"))
        # as on the page, but for the end: there it is Ctrl-C
        told = run(folder, one("repro live").replace("--calibration calibration.json", "") + " --duration 3")
    assert len(read_recording(folder / "first.rec").frames) > 100
    assert "estimates/s by levenberg_marquardt" in told
    assert "delta_x_1 " in told


def test_calibrate_from_a_recording_and_live_with_it(folder):
    (folder / "calibration.json").unlink(missing_ok=True)
    told = run(folder, one("repro calibrate held.rec"))
    assert "Written: calibration.json" in told
    with board(folder, "repro emulate still.rec --loop --port-file board"):
        told = run(folder, one("repro live") + " --duration 3")
    found = re.search(r"delta_x_1 (\S+) ± \S+ mm   delta_y_1 (\S+) ± \S+ mm", told)
    assert found is not None, told
    assert all(abs(float(x)) < 0.5 for x in found.groups()), "straight, but for the priors of the calibration"


def test_calibrate_at_the_port(folder):
    (folder / "calibration.json").unlink(missing_ok=True)
    with board(folder, "repro emulate still.rec --loop --port-file board"):
        told = run(folder, one("repro calibrate board"), given=ENTER)
    assert "Pose 4 of 4" in told
    assert "Written: calibration.json" in told


def test_fit(folder):
    rig = Rig.of("one_segment")
    rig.write_recording(folder / "motion.rec")
    rig.write_poses(folder / "captured.csv", *rig.measured())
    told = run(folder, one("repro fit"))
    assert "Lag: +3" in told
    assert "Written: judged" in told
    named = {"errors.csv", "estimates.csv", "estimates.png", "report.txt", "calibration.json"}
    assert {path.name for path in (folder / "judged").iterdir()} == named
