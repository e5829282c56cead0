"""One clock from two: the delay is found, and with perfect sensors nothing but the model's error remains."""

from pathlib import Path

import numpy as np
import pytest

from edition1.estimation.imu_models import tangent_spline
from edition1_companion.recordings.martin2022_models import selection
from edition1_companion.twins.arm_recording import MotionCapture, record_soft_arm
from edition1_companion.twins.arm_trial import synchronised
from edition1_companion.twins.imu_errors import PERFECT, ImuErrors
from edition1_companion.twins.soft_arm import load_soft_arm


@pytest.fixture(scope="module")
def arm():
    return load_soft_arm(Path(__file__).parents[4] / "data" / "soft_arm.npz")


@pytest.mark.parametrize("seed", range(3))
def test_delay_is_found_to_a_millisecond_with_perfect_sensors(arm, seed):
    recording = record_soft_arm(arm, seed=seed, errors=PERFECT)
    assert synchronised(recording).lag.lag_s == pytest.approx(recording.capture_start_s, abs=1e-3)


def test_delay_holds_the_latency_and_no_offset_of_the_frame(arm):
    capture = MotionCapture(origin_m=(0.006, -0.014, -0.034), heading_rad=0.3)
    recording = record_soft_arm(arm, seed=5, capture=capture)
    late = ImuErrors().latency_s
    assert synchronised(recording).lag.lag_s == pytest.approx(recording.capture_start_s + late, abs=5e-3)


def test_samples_are_the_arm_at_one_time(arm):
    trial = synchronised(record_soft_arm(arm, seed=0, errors=PERFECT, capture=MotionCapture(noise_m=0.0)))
    assert len(trial.time_s) == pytest.approx(7700, abs=60)  # the paper has about 8,000 in 250 s
    assert trial.orientations.shape == (len(trial.time_s), 9, 4)
    assert set(trial.mode) == {"oscillating", "buckling", "circling"}
    true = arm.positions_at(trial.time_s, np.array(trial.point_arcs_m))
    assert np.linalg.norm(trial.points - true, axis=-1).max() < 1e-3  # a delay of 1 ms at 0.6 m/s is 0.6 mm
    turned = 1 - np.abs((trial.orientations * arm.orientations_at(trial.time_s)).sum(-1))
    assert np.degrees(2 * np.arccos(1 - turned.max())) < 0.3  # interpolated between rounds
    estimate = tangent_spline(trial.orientations, selection("pcc", 8), [0.36, 0.60])
    assert np.median(np.linalg.norm(estimate - trial.points[:, :2], axis=-1), axis=0).max() < 2.5e-3
