"""The hand: smooth, within the arm's reach, in three modes."""

import numpy as np
import pytest
from edition1.errors import InputError
from edition1_companion.twins.stick_motion import (
    DURATION_S,
    LEAD_IN_S,
    MODES,
    STICK_ARC_M,
    hand_path,
    mode_at,
)

TIME_S = np.arange(-LEAD_IN_S, DURATION_S, 0.005)


def test_it_is_smooth_and_starts_at_rest_on_the_upright_arm():
    path = hand_path(TIME_S)
    speed = np.linalg.norm(np.gradient(path, 0.005, axis=0), axis=-1)
    assert np.linalg.norm(path[0] - [0, 0, STICK_ARC_M]) < 1e-12
    assert speed[0] < 1e-4
    assert speed.max() < 0.6  # m/s
    assert np.abs(np.diff(path, n=2, axis=0)).max() / 0.005**2 < 2.0  # m/s², no jump of the velocity


def test_it_stays_where_the_point_of_the_arm_can_be():
    reach = np.linalg.norm(hand_path(TIME_S), axis=-1)
    assert reach.max() < STICK_ARC_M + 1e-9
    assert hand_path(TIME_S)[:, 2].min() > 0


def test_three_modes_and_what_they_are():
    time_s = np.arange(0.0, DURATION_S, 0.1)
    mode, path = mode_at(time_s), hand_path(time_s)
    assert set(mode) == set(MODES)
    radius, height = np.linalg.norm(path[:, :2], axis=-1), path[:, 2]
    swing = path[mode == "oscillating", 0]
    assert (np.diff(np.sign(swing)) != 0).sum() > 15  # from one side of the base to the other
    assert np.ptp(height[mode == "buckling"]) > 0.15
    turned = np.unwrap(np.arctan2(path[:, 1], path[:, 0]))[(time_s > 114) & (time_s < 132)]
    assert turned[-1] - turned[0] > 2 * np.pi  # about the vertical
    assert radius[(time_s > 114) & (time_s < 132)].min() > 0.2


def test_bad_input():
    with pytest.raises(
        InputError, match=r"Input time_s of mode_at must be 0 or later \[s\]; instead received -1.0"
    ):
        mode_at(np.array([3.0, -1.0]))
