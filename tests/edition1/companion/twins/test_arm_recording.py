"""The synthetic recording: its form, what motion capture sees, and that nothing of one side leaks into the other."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from edition1.errors import InputError
from edition1_companion.recordings.martin2022 import READING_COLUMNS, one_clock
from edition1_companion.twins.arm_recording import CHECK_ARCS_M, MARKER_ARCS_M, MotionCapture, record_soft_arm
from edition1_companion.twins.imu_errors import PERFECT
from edition1_companion.twins.soft_arm import load_soft_arm


@pytest.fixture(scope="module")
def arm():
    return load_soft_arm(Path(__file__).parents[4] / "data" / "soft_arm.npz")


def test_has_the_form_of_a_recorded_bag(arm):
    recording = record_soft_arm(arm, seed=0)
    assert tuple(recording.readings.columns) == READING_COLUMNS
    stream = one_clock(recording.readings)
    assert stream.lost == 0
    assert (stream.facts["gaps"] == 0).all()
    np.testing.assert_allclose(stream.facts["rate_hz"], 31.0)
    assert len(stream.time_s) == pytest.approx(250 * 31, abs=2)
    assert recording.point_arcs_m == MARKER_ARCS_M + CHECK_ARCS_M


def test_motion_capture_sees_the_arm_within_its_noise(arm):
    capture = MotionCapture(origin_m=(0.006, -0.014, -0.034), heading_rad=0.1)
    recording = record_soft_arm(arm, seed=2, capture=capture)
    true = arm.positions_at(
        recording.capture_start_s + recording.capture_time_s, np.array(recording.point_arcs_m)
    )
    c, s = np.cos(0.1), np.sin(0.1)
    turned = np.stack(
        [c * true[..., 0] - s * true[..., 1], s * true[..., 0] + c * true[..., 1], true[..., 2]], axis=-1
    )
    noise = recording.points - turned - capture.origin_m
    assert noise.std() == pytest.approx(0.001, rel=0.02)
    assert np.abs(noise.mean(axis=0)).max() < 5e-5
    np.testing.assert_allclose(np.diff(recording.capture_time_s), 0.01, atol=1e-9)
    assert 0 <= recording.capture_start_s < 2
    assert recording.capture_time_s[0] == 0


def test_same_seed_same_bits_and_sensors_do_not_change_motion_capture(arm):
    a, b, c = (record_soft_arm(arm, seed=seed) for seed in (3, 3, 4))
    pd.testing.assert_frame_equal(a.readings, b.readings, check_exact=True)
    np.testing.assert_array_equal(a.points, b.points)
    assert a.capture_start_s != c.capture_start_s
    assert not a.readings.equals(c.readings)
    perfect = record_soft_arm(arm, seed=3, errors=PERFECT)
    np.testing.assert_array_equal(a.points, perfect.points)


def test_bad_input(arm):
    with pytest.raises(
        InputError,
        match=r"Input arm of record_soft_arm must be longer than 300 s; instead received 250 s\.",
    ):
        record_soft_arm(arm, seed=0, capture=MotionCapture(latest_start_s=300.0))
