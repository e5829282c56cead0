"""Actuation of T0 to T5: pressures against torques, and what section 5.3 says about each sequence."""

import numpy as np
import pytest

from edition1_companion.twins.pneumatic_actuation import (
    AZIMUTH_RATE,
    DURATION_S,
    PERIOD_S,
    SPEED_NM_PER_S,
    TRAJECTORIES,
    Chambers,
    torque_sequence,
)

CHAMBERS = Chambers()


def sequence(name: str, rate_hz: float = 50.0) -> tuple[np.ndarray, np.ndarray]:
    time_s = np.arange(0, DURATION_S[name], 1 / rate_hz)
    return time_s, torque_sequence(name, time_s, CHAMBERS, seed=0)


def test_pressures_give_the_torque_back_and_keep_their_mean():
    torque = np.random.default_rng(0).normal(0, 0.03, (50, 2))
    pressures = CHAMBERS.pressures(torque)
    np.testing.assert_allclose(CHAMBERS.torque(pressures), torque, atol=1e-15)
    np.testing.assert_allclose(pressures.mean(axis=1), CHAMBERS.offset_mbar)


def test_a_pressure_bends_away_from_its_chamber_about_the_axis_across():
    chambers = Chambers(azimuth_deg=0.0)
    x, y = chambers.torque(np.array([325.0, 225.0, 225.0]))
    assert x == pytest.approx(0, abs=1e-15)
    assert y == pytest.approx(100e2 * 150e-6 * 0.013)  # pressure, area, lever


@pytest.mark.parametrize("name", TRAJECTORIES)
def test_pressures_stay_between_zero_and_the_peak(name):
    pressures = CHAMBERS.pressures(sequence(name)[1])
    assert pressures.min() > -0.1
    assert pressures.max() < CHAMBERS.peak_mbar + 0.1
    if name not in ("T0", "T2", "T4"):  # their highest pressures need not be at the limit
        assert pressures.max() == pytest.approx(CHAMBERS.peak_mbar, abs=0.5)


@pytest.mark.parametrize("name", ["T1", "T2", "T3"])
def test_periodic_sequences_repeat(name):
    time_s = np.linspace(0, PERIOD_S[name], 100)
    first, later = (torque_sequence(name, time_s + k * PERIOD_S[name], CHAMBERS, seed=0) for k in (0, 5))
    np.testing.assert_allclose(first, later, atol=1e-12)


@pytest.mark.parametrize("name", ["T0", "T4"])
def test_sequences_of_constant_speed(name):
    time_s, torque = sequence(name)
    speed = np.linalg.norm(np.diff(torque, axis=0), axis=1) / np.diff(time_s)
    straight = np.abs(speed - SPEED_NM_PER_S[name]) < 1e-3 * SPEED_NM_PER_S[name]
    assert straight.mean() > 0.98  # not across the corners of T0


def test_spiral_starts_at_zero_and_ends_at_the_reference_torque():
    _, torque = sequence("T4")
    radius = np.linalg.norm(torque, axis=1)
    assert radius[0] == 0
    assert radius[-1] == pytest.approx(CHAMBERS.reference_nm, rel=1e-3)
    assert (np.diff(radius) > 0).all()


def test_planar_bending_is_planar_and_one_sided():
    _, torque = sequence("T1")
    assert np.abs(torque[:, 0]).max() < 1e-15
    assert torque[:, 1].max() <= 1e-15  # about -y: towards -x


def test_flower_has_fifty_bending_cycles_in_a_turn():
    assert 2 * np.pi / AZIMUTH_RATE / PERIOD_S["T5"] == pytest.approx(50, rel=0.005)
    time_s = np.array([2.5, 2.5 + 500.0])
    first, later = torque_sequence("T5", time_s, CHAMBERS, seed=0)
    np.testing.assert_allclose(first, later, atol=0.02 * CHAMBERS.reference_nm)


def test_random_points_depend_on_the_seed_and_nothing_moves_outside_the_sequence():
    time_s = np.array([-1.0, 10.0, 201.0])
    a, b = (torque_sequence("T0", time_s, CHAMBERS, seed=seed) for seed in (0, 1))
    assert not np.allclose(a[1], b[1])
    assert (a[[0, 2]] == 0).all()
