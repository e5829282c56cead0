"""The robot whose sensors drift: its readings, the filter that follows it, and the study of the page."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest

from repro import simulated_readings
from repro.estimators.drift import DriftModel
from repro_companion.papers import wandering

METHOD = wandering.kalman_filter(wandering.drifts())
ROWS = 150


@pytest.fixture(scope="module")
def run():
    return wandering.draw(100, minutes=9.0)


@pytest.fixture(scope="module")
def found(run):
    return wandering.follow(METHOD, run)


def test_the_filter_and_the_simulation_mean_the_same_errors(run):
    """Without noise, sway and iron the sensor model of the filter reads what the run does, to the multipoles."""
    arm, k = wandering.robot(), 100  # before the iron comes
    model = DriftModel(wandering.Drifting(arm.sensing(), wandering.drifts()), arm.lower, arm.upper, "test")
    x = np.concatenate([run.q[k], run.errors[k], np.zeros(6)])
    still = np.concatenate([run.q[k], np.zeros(34)])
    off = run.readings[k] - model(x[None])[0]
    assert np.abs(off[:9]).max() < 5 * 7.1e-4
    assert np.abs(off[9:]).max() < 5 * wandering.SWAY
    exact = simulated_readings(arm, run.q[k], wandering.EARTH)
    np.testing.assert_allclose(model(still[None])[0], exact, atol=1e-4)


def test_walks_end_with_the_size_that_is_stated():
    steps = round(wandering.SIZE_S * wandering.RATE_HZ)
    ends = np.array([wandering.drift(steps, np.random.default_rng(k))[-1] for k in range(100)])
    assert ends[:, 0] == pytest.approx(wandering.WARMING, rel=1e-3)
    for columns, size in ((slice(1, 10), 0.001), (slice(10, 19), 0.01), (slice(19, 22), wandering.HEADING)):
        assert ends[:, columns].std() == pytest.approx(size, rel=0.15)
    # A tilt less what it was at the start has up to twice its variance.
    expected = wandering.TILT * np.sqrt(2 * (1 - np.exp(-wandering.SIZE_S / wandering.TILT_S)))
    assert ends[:, 22:].std() == pytest.approx(expected, rel=0.15)


def test_the_filter_believes_the_walks_of_the_simulation():
    walk = np.sqrt(wandering.SIZE_S) * METHOD.drift_walk
    assert walk[1] == pytest.approx(wandering.GAIN)
    assert walk[10] == pytest.approx(wandering.OFFSET)
    assert walk[19] == pytest.approx(wandering.HEADING)
    lasting, sway = METHOD.drift_walk[22:28] ** 2, METHOD.drift_walk[28:] ** 2
    rates = METHOD.drift_rate[22:28], METHOD.drift_rate[28:]
    np.testing.assert_allclose(lasting / (2 * rates[0]), 2 * wandering.TILT**2)  # stationary variances
    np.testing.assert_allclose(sway / (2 * rates[1]), wandering.SWAY**2)
    assert (METHOD.drift_std == np.repeat([0, wandering.SWAY], [28, 6])).all()


def test_iron_is_noticed_and_spoils_nothing_that_lasts(run, found):
    error, stated, nees = wandering.tip_errors(run, found)
    alarm = found.status == "left out"
    near = (run.times >= run.iron_s[0]) & (run.times < run.iron_s[1])
    assert alarm[near].sum() >= 15
    assert not alarm[run.times < run.iron_s[0]].any()
    later = run.times > run.iron_s[1] + 15
    assert np.sqrt((error[later] ** 2).mean()) < 0.5
    assert 0.3 < nees[later].mean() < 2
    assert 0.3 < nees[alarm].mean() < 3
    assert stated[alarm].min() > 2 * np.median(stated[~alarm])


def test_a_sway_beyond_chance_leaves_the_hall_sensors_out(run, monkeypatch):
    monkeypatch.setattr(wandering, "CHANCE", 1.0)  # then any sway is
    first = run._replace(times=run.times[:20], readings=run.readings[:20])
    assert set(wandering.follow(METHOD, first).status) == {"left out"}


def test_lasting_errors_stay_while_the_hall_sensors_are_left_out(found):
    alarm = np.flatnonzero(found.status == "left out")
    alarm = alarm[np.flatnonzero(np.diff(alarm) == 1) + 1]  # all but the first row of each
    b, std = found.details["drift"][:, :22], found.details["drift_std"][:, :22]
    np.testing.assert_array_equal(b[alarm], b[alarm - 1])  # of walks; tilts fade
    assert (std[alarm] > std[alarm - 1]).all()


@pytest.mark.parametrize("sensor", [0, 4])
def test_one_impossible_code_moves_nothing_by_its_deviation(run, found, sensor):
    spiked = run.readings[:ROWS].copy()
    spiked[120, sensor] = 32.767
    other = wandering.follow(METHOD, run._replace(times=run.times[:ROWS], readings=spiked))
    change = np.abs(other.details["drift"] - found.details["drift"][:ROWS])[120:, :28]
    assert (change < 0.5 * found.details["drift_std"][120:ROWS, :28]).all()
    assert change.max() > 0


def test_nees_of_errors_as_stated_is_one(run):
    """Estimates that are drawn from the covariance that they state."""
    rng, arm = np.random.default_rng(0), wandering.robot()
    C = np.diag(np.full(9, 1e-10))
    q = run.q[:ROWS] + 1e-5 * rng.standard_normal((ROWS, 9))
    drawn = wandering.Trajectory(run.times[:ROWS], q, np.broadcast_to(C, (ROWS, 9, 9)), *(np.zeros(1),) * 4)
    error, stated, nees = wandering.tip_errors(run, drawn)
    assert nees.mean() == pytest.approx(1, abs=0.2)
    assert np.sqrt((error**2).mean()) == pytest.approx(np.sqrt((stated**2).mean()), rel=0.2)
    tip = arm.tip(q)[:, :3, 3] - arm.tip(run.q[:ROWS])[:, :3, 3]
    np.testing.assert_allclose(error, 100 / 0.33 * np.linalg.norm(tip, axis=1))


def test_minutes_add_up(run, found):
    table = wandering.by_minute(run, found)
    assert list(table["minute"]) == list(range(1, 10))
    assert table["iron_s"].sum() == 60
    error, _, nees = wandering.tip_errors(run, found)
    assert (table["tip_rmse_percent"] ** 2).mean() == pytest.approx((error**2).mean())
    assert table["nees"].mean() == pytest.approx(nees.mean())
    alarm = run.times[found.status == "left out"]
    assert table["flag_iron_s"].sum() == (alarm < run.iron_s[1]).sum()
    assert table["flag_else_s"].sum() == (alarm >= run.iron_s[1] + 15).sum()


MINUTES_OF_IRON = pd.DataFrame({
    "twin": 1, "method": "fused", "minute": [1, 2, 3, 4], "tip_rmse_percent": [50.0, 0.0, 0.0, 3.0],
    "nees": [50.0, 1.0, 2.0, 6.0], "iron_s": [0.0, 20.0, 40.0, 0.0], "flag_iron_s": [0.0, 5.0, 7.0, 0.0],
    "flag_else_s": [1.0, 0.0, 0.0, 2.0],
})  # fmt: skip


@pytest.mark.parametrize(
    ("found", "expected"),
    [
        # A root mean square over the last three of four minutes.
        (lambda: wandering.by_run(MINUTES_OF_IRON, last=3), [3**0.5, 3]),
        # Errors count in the minute that has most of the iron, alarms in all.
        (lambda: wandering.iron(MINUTES_OF_IRON), [0.0, 2.0, 12.0, 3.0]),
    ],
)
def test_numbers_of_the_page_by_hand(found, expected):
    assert found().iloc[0, 2:].to_list() == pytest.approx(expected)
