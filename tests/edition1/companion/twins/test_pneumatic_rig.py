"""The digital twin: the same bits for the same seed, a frozen configuration, and files with what was recorded."""

from dataclasses import replace

import numpy as np
import pytest

from edition1_companion.twins.pneumatic_actuation import TRAJECTORIES
from edition1_companion.twins.pneumatic_rig import record_rig, record_twin
from edition1_companion.twins.rig_motion import MODELS
from edition1_companion.twins.rig_twins import nominal_twin, random_twin, second_twin
from edition1_companion.twins.sensor_board import DRIFTS, FULL_SCALE_MV, LSB_MV, analogue_readings

FROZEN = "0392762d3f26ffd65d4dea95776c16d5bd67c28be19db1cb1c4c85a380f9783d"
SECOND = "fc31ef79729d3a655e3ca6efff240fa4ed0329b30a669f28b979824e8a6ce9f4"
MEMBER = "acd4ba71cd938c8ca7b232baa2f875d0c791f05507a787609905fcdd9b0ede52"
ELONGATION_MM = (5.85, 6.38, 5.73, 6.11, 5.76, 6.13)
"""Mean elongation in T0 to T5, from the running means of networks trained on the authors' recordings."""


def test_nominal_twin_is_frozen():
    # If this fails, everything that was concluded from the twin has to be run again.
    assert nominal_twin().sha256 == FROZEN


def test_second_twin_and_random_twins_are_frozen():
    assert second_twin().sha256 == SECOND
    assert random_twin(23).sha256 == MEMBER


def test_hash_sees_every_change():
    twin = nominal_twin()
    assert replace(twin, gain_scatter=0.041).sha256 != FROZEN
    assert replace(twin, board=replace(twin.board, noise_mv=0.241)).sha256 != FROZEN


def test_same_seed_same_bits_and_another_seed_differs():
    first, again, other = (record_rig(nominal_twin(), "T0", seed=s, duration_s=3.0) for s in (3, 3, 4))
    np.testing.assert_array_equal(first.readings_mv, again.readings_mv)
    np.testing.assert_array_equal(first.track.ring_m, again.track.ring_m)
    assert not np.array_equal(first.readings_mv[:100], other.readings_mv[:100])


@pytest.mark.parametrize("trajectory", TRAJECTORIES)
def test_recordings_start_at_rest_and_are_whole_steps_of_the_converter(trajectory):
    recording = record_rig(nominal_twin(), trajectory, seed=0, duration_s=4.0)
    u, q = recording.readings_mv, recording.motion.q
    np.testing.assert_array_equal(u / LSB_MV, np.round(u / LSB_MV))
    assert (np.abs(q[recording.motion.time_s <= 2.5]) == 0).all()
    assert q[700, 2] == pytest.approx(4.5e-3, abs=1e-6)
    assert (
        np.abs(u[:10] - nominal_twin().board.rest_mv).max() < 40
    )  # bias and gain; inflated it is 250 mV more
    assert abs(len(u) - 40 * (8 + 4 + 4)) <= 81  # all but a start within two seconds
    assert len(u) == len(recording.track.time_s)
    assert 0 <= min(recording.sensors_start_s, recording.capture_start_s) <= 2


def test_files_lie_where_the_authors_have_them(tmp_path):
    recording = record_rig(nominal_twin(), "T1", seed=0, duration_s=1.0)
    capture, sensors = recording.write(tmp_path)
    data = tmp_path / "datasets" / "experimental"
    assert capture == data / "raw_motion_capture_data" / "synthetic" / "synthetic_T1_Quat.csv"
    assert sensors == data / "sensor_data" / "synthetic_T1_SV.csv"
    assert sensors.read_text().splitlines()[0] == "u1,u2,u3"
    assert len(capture.read_text().splitlines()) == 7 + len(recording.track.time_s)


def test_random_twins_vary_in_kind_and_never_saturate():
    twins = [random_twin(seed) for seed in range(24)]
    assert {twin.hysteresis for twin in twins} == set(MODELS)
    assert {twin.board.drift for twin in twins} == set(DRIFTS)
    assert len({twin.sha256 for twin in twins}) == 24
    assert random_twin(5) == random_twin(5)
    for twin in twins:
        u = record_rig(twin, "T3", seed=0, duration_s=10.0).readings_mv
        assert u.min() > 0
        assert u.max() < FULL_SCALE_MV - LSB_MV


@pytest.fixture(scope="module")
def second():
    return record_twin(second_twin()).read


@pytest.mark.parametrize(("number", "name"), list(enumerate(TRAJECTORIES)))
def test_second_twin_has_the_known_elongation_slope_and_workspace(second, number, name):
    q = 1e3 * second[name].q
    slope, _ = np.polyfit((q[:, :2] ** 2).sum(axis=1), q[:, 2], 1)
    assert q[:, 2].mean() == pytest.approx(ELONGATION_MM[number], abs=0.05)
    assert slope == pytest.approx(-0.038 if name == "T2" else 0.025, abs=1e-3)
    if name in ("T1", "T2"):
        assert q[:, 0].mean() == pytest.approx({"T1": 5.1, "T2": -2.0}[name], abs=0.05)


def test_what_is_called_elongation_is_not_felt_by_the_sensors():
    # At equal bends the two twins have equal readings: what is known of the first one's holds for the second.
    for name in ("T0", "T5"):
        first, other = (record_rig(twin, name, seed=3) for twin in (nominal_twin(), second_twin()))
        np.testing.assert_array_equal(first.readings_mv, other.readings_mv)
        assert np.abs(first.track.ring_m - other.track.ring_m).max() > 3e-4


def test_without_noise_hysteresis_and_gaps_the_readings_are_those_of_the_board():
    plain = nominal_twin()
    board = replace(plain.board, noise_mv=0.0, inflated_noise_mv=0.0, drift_mv=0.0)
    capture = replace(plain.capture, noise_mm=0.0, noise_deg=0.0, gaps_per_s=0.0, clock_ppm=0.0)
    inner = replace(plain.inner, hysteresis_mm=0.0, across_s=0.0)
    quiet = replace(
        plain,
        board=board,
        capture=capture,
        inner=inner,
        bias_mv=(0.0,) * 6,
        bias_scatter_mv=0.0,
        gain_scatter=0.0,
    )
    twin = record_twin(quiet, trajectories=["T4"], longest_s=20.0, skip=0)
    recording = twin.read["T4"]
    slow = (
        np.linalg.norm(np.gradient(recording.q[:, :2], axis=0), axis=1) * 40 < 2e-3
    )  # where a frame late is little
    error = recording.u - analogue_readings(board, recording.q, recording.q)
    assert slow.mean() > 0.9
    assert np.abs(error[slow]).max() < 1.0
