"""The example that the page of the board plays, synthetic; run as a program, it writes the file anew."""

from __future__ import annotations

import base64
import json
from pathlib import Path

import numpy as np
from edition1.robot_file.load import load_robot
from edition1_live.emulate.board import passages
from edition1_live.emulate.faults import Faults
from edition1_live.emulate.robot_readings import course, readings_along

ROOT = Path(__file__).resolve().parents[2]
ROBOT = ROOT / "data" / "robots" / "two_segments.toml"
EXAMPLE = ROOT / "book" / "_static" / "board" / "example.js"
RATE_HZ, SECONDS, STUCK_S, STUCK = 25, 16, 12, 2
FAULTS = Faults(flips=1e-4, drops=1e-4)


def frames() -> bytes:
    """What an emulated board sends; sensor 3 sticks at the end."""
    robot, time_s = load_robot(ROBOT), np.arange(RATE_HZ * SECONDS) / RATE_HZ
    read = readings_along(robot, time_s, course(robot, time_s, seed=3), rng=np.random.default_rng(3))
    read.values[time_s >= STUCK_S, STUCK] = read.values[time_s < STUCK_S, STUCK][-1]
    return b"".join(passage.data for passage in passages(read.readings(), "frames", FAULTS, seed=2))


def main() -> None:
    """Write the file."""
    example = {
        "robot": ROBOT.read_text(encoding="utf-8"),
        "seconds": SECONDS,
        "frames": base64.b64encode(frames()).decode(),
    }
    words = "/* What an emulated board sends, synthetic: made by tests/book/board_example.py. */"
    EXAMPLE.write_text(f"{words}\nBOARD.example = {json.dumps(example)};\n", encoding="utf-8")


if __name__ == "__main__":
    main()
