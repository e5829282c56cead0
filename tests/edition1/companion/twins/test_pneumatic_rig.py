"""The digital twin: the same bits for the same seed, a frozen configuration, and files with what was recorded."""

from dataclasses import replace

import numpy as np
import pytest
from edition1_companion.twins.pneumatic_actuation import TRAJECTORIES
from edition1_companion.twins.pneumatic_rig import record_rig, record_twin
from edition1_companion.twins.rig_motion import MODELS
from edition1_companion.twins.rig_twins import ELONGATION_MM, nominal_twin, random_twin, second_twin
from edition1_companion.twins.sensor_board import DRIFTS, FULL_SCALE_MV, LSB_MV

FROZEN = "0392762d3f26ffd65d4dea95776c16d5bd67c28be19db1cb1c4c85a380f9783d"
SECOND = "fc31ef79729d3a655e3ca6efff240fa4ed0329b30a669f28b979824e8a6ce9f4"
MEMBER = "acd4ba71cd938c8ca7b232baa2f875d0c791f05507a787609905fcdd9b0ede52"


def test_nominal_twin_is_frozen():
    # If this fails, everything that was concluded from the twin has to be run again.
    assert nominal_twin().sha256 == FROZEN


def test_second_twin_and_the_first_family_are_frozen():
    # The first family's networks are kept by these hashes: the second one may not change them.
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


def test_second_family_varies_in_elongation_and_never_saturates():
    twins = [random_twin(seed, second=True) for seed in range(24)]
    assert len({twin.sha256 for twin in twins}) == 24
    assert twins[5] == random_twin(5, second=True)
    lengths = np.array([twin.differences.elongation_mm for twin in twins])
    lengths += np.array(ELONGATION_MM) - second_twin().differences.elongation_mm
    assert lengths.std(axis=1, ddof=1).mean() == pytest.approx(0.3, abs=0.06)
    for twin in twins:
        assert twin.bending == random_twin(twins.index(twin)).bending
        for name in ("T1", "T2"):
            u = record_rig(twin, name, seed=0, duration_s=10.0).readings_mv
            assert u.min() > 0
            assert u.max() < FULL_SCALE_MV - LSB_MV
