"""Tables and sentences of the pages on an emulated board."""

from __future__ import annotations

import re
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest
from scipy.spatial.transform import Rotation

import repro
from repro_board.emulate import MOVE_S, course, spread_poses
from repro_companion.papers import emulated


def test_the_capture_sees_the_end_of_each_segment_later_by_its_clock_and_with_its_noise():
    robot = repro.load_robot(repro.example() / "robot.toml")
    table = emulated.captured(robot, 5.0, seed=3)
    times = table["time_s"].to_numpy() - emulated.CAPTURE_LATE_S
    np.testing.assert_allclose(times, np.arange(200) / 40)
    tip = robot.tip(course(robot, times, seed=3))
    off = table[["x_2_mm", "y_2_mm", "z_2_mm"]].to_numpy() - 1e3 * tip[:, :3, 3]
    assert off.std() == pytest.approx(emulated.CAPTURE_MM, rel=0.1)
    seen = Rotation.from_quat(table[[f"q{axis}_2" for axis in "xyzw"]].to_numpy())
    turned = (seen * Rotation.from_matrix(tip[:, :3, :3]).inv()).as_rotvec()
    assert turned.std() == pytest.approx(emulated.CAPTURE_RAD, rel=0.1)


STATUS = np.array(["consistent", "left out", "left out", "left out"])
SHAPE = SimpleNamespace(status=STATUS)
ERROR, STD = np.array([1.0, 2.0, 3.0, 8.0]), np.array([1.0, 1.0, 2.0, 4.0])
STEPS = pd.DataFrame({
    "time_s": [1.0, 5.0, 6.0, 7.0, 7.0], "sensors": [2, 2, 2, 2, 4], "failure": "stuck", "status": [1, 0, 1, 2, 0],
    "tip_error_mm": [99.0, 1.0, 2.0, 9.0, 5.0], "tip_std_mm": [99.0, 4.0, 5.0, 6.0, 7.0],
    "named": [True, False, True, True, False],
})  # fmt: skip


@pytest.mark.parametrize(
    ("found", "expected"),
    [
        (lambda: emulated.cases({"a": (SHAPE, ERROR, STD)}), ["a", 2.5, 8, 1.5, 75]),
        # The larger arm first; what was before the failure does not count.
        (lambda: emulated.failures(STEPS, 4.0), [4, "stuck", 5, 7, 0, 0, *[np.nan] * 3]),
        (lambda: emulated.failures(STEPS, 4.0)[1:], [2, "stuck", 2, 5, 200 / 3, 200 / 3, 2, 1, 4]),
    ],
)
def test_numbers_of_the_pages_by_hand(found, expected):
    row = found().iloc[0].to_list()
    assert row == [x if isinstance(x, str) else pytest.approx(x, nan_ok=True) for x in expected]


def test_a_chip_is_named_only_if_no_other_is():
    suspects = np.array([[0, 0], [0, 1], [0, 1], [1, 1]], dtype=bool)
    said = emulated.failing_in_words(np.arange(4.0), suspects, STD, chip=2, fails_at_s=0.5)
    assert "in 67 % of the rows" in said
    assert "grows in this run from 1.0 mm before the failure to 2.0 mm after it" in said


@pytest.mark.parametrize(
    ("share", "words"), [(1.0, "in all rows"), (0.995, "in nearly all rows"), (0.9, "in 90 % of the rows")]
)
def test_coverage_in_words(share, words):
    inside = np.arange(1000) < 1000 * share
    said = emulated.calibrated_in_words(ERROR, 4 * STD, inside, 32, 1.0)
    assert words in said
    assert "so the stated ± is larger, 6.0 mm" in said
    assert ("This is too much" in said) == (share > 0.95)


@pytest.mark.parametrize(
    ("lost", "wrong", "words"),
    [
        (0, 0, "frames none is lost, and no wrong readings are kept"),
        (1, 1, "frames 1 is lost, and 1 wrong reading is kept"),
        (2, 3, "frames 2 are lost, and 3 wrong readings are kept"),
    ],
)
def test_lost_and_wrong_frames_in_words(lost, wrong, words):
    table = pd.DataFrame({"intact": [1000, 234], "intact_lost": [0, lost], "wrong": [wrong, 0]})
    assert f"Of 1,234 intact {words}" in emulated.faults_in_words(table)


def test_the_page_records_for_as_long_as_the_poses_take():
    page = (Path(__file__).parents[2] / "notebooks/own_robot.ipynb").read_text(encoding="utf-8")
    (seconds,) = re.findall(r"--hold-poses.*\n.*--duration (\d+)", page)
    robot = repro.load_robot(repro.example() / "robot.toml")
    assert float(seconds) > len(spread_poses(robot, seed=3)) * (2.0 + MOVE_S)
