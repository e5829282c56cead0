"""The robot whose sensors drift: its readings, the filter that follows it, and the study of the page."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest

from repro import simulated_readings, track
from repro.estimators.drift import DriftModel
from repro_companion.papers import wandering

METHOD = wandering.kalman_filter(wandering.drifts())
ROWS = 150


@pytest.fixture(scope="module")
def run():
    return wandering.draw(100, minutes=9.0)


@pytest.fixture(scope="module")
def found(run):
    return track(METHOD, run.readings, wandering.START, times=run.times, monitor=None)


def test_the_filter_and_the_simulation_mean_the_same_errors(run):
    """Without noise and sway the sensor model of the filter reads what the run does, to the multipoles."""
    arm, k = wandering.robot(), 100
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
    assert ends[:, 0] == pytest.approx(-0.011, rel=1e-3)  # warm magnets are weaker
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


def test_the_stated_uncertainty_of_the_tip_is_right_if_the_drift_is_in_the_state(run, found):
    late = run.times > 300
    error, _, nees = wandering.tip_errors(run, found)
    once = track(wandering.kalman_filter([]), run.readings, wandering.START, times=run.times, monitor=None)
    assert 0.2 < np.median(once.chi2[:100] / once.dof[:100]) < 1  # where nothing wanders the sway is noise
    off, _, of_once = wandering.tip_errors(run, once)
    assert 0.5 < nees[late].mean() < 1.5
    assert of_once[late].mean() > 3
    assert 2 * (error[late] ** 2).mean() < (off[late] ** 2).mean()


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
    error, _, nees = wandering.tip_errors(run, found)
    assert (table["tip_rmse_percent"] ** 2).mean() == pytest.approx((error**2).mean())
    assert table["nees"].mean() == pytest.approx(nees.mean())


def test_errors_are_drawn_at_the_end_of_each_minute_in_the_unit_that_their_name_has(run, found):
    table = wandering.learnt(run, found)
    assert list(table["minute"]) == [*range(1, 10)] * 3
    heading = table[table["error"] == "heading of IMU 3 [°]"]
    np.testing.assert_allclose(np.radians(heading["truth"]), run.errors[59::60, 21])
    off = np.abs(table["estimate"] - table["truth"]) / table["std"]
    assert off.median() < 2


MINUTES = pd.DataFrame({
    "twin": 1, "method": "fused", "minute": [1, 2, 3, 4], "tip_rmse_percent": [50.0, 0.0, 0.0, 3.0],
    "nees": [50.0, 1.0, 2.0, 6.0],
})  # fmt: skip
RUNS = pd.DataFrame({"method": "fused", "tip_rmse_percent": [1.0, 2.0, 6.0], "nees": [1.0, 2.0, 6.0]})


@pytest.mark.parametrize(
    ("found", "expected"),
    [
        # A root mean square over the last three of four minutes.
        (lambda: wandering.by_run(MINUTES, last=3).iloc[0, 2:], [3**0.5, 3]),
        (lambda: wandering.by_method(RUNS).iloc[0, 1:], [2, 1, 6, 3]),
    ],
)
def test_numbers_of_the_page_by_hand(found, expected):
    assert found().to_list() == pytest.approx(expected)


@pytest.mark.parametrize(("nees", "words"), [(1.2, "about right"), (3.0, "too small"), (0.2, "too large")])
def test_the_page_says_whether_the_stated_uncertainty_is_right(nees, words):
    table = pd.DataFrame(
        {
            "method": ["fused", "self-calibrating", "magnets self-calibrating"],
            "median_percent": [2.0, 0.5, 1.9],
            "nees": nees,
        }
    )
    assert "magnets alone still have 1.9 %" in wandering.in_words(table)
    assert f"uncertainty is {words}" in wandering.in_words(table)
