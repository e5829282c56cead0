"""The lag between the clocks of readings and poses: signals that are known, shifted by a known time."""

import numpy as np
import pytest

from edition1.errors import InputError
from edition1_live.own.lag import Correlations, check_peak, correlations, refined
from edition1_live.own.samples import Samples

RATE_HZ = 50.0


def moving(time_s):
    """Two smooth signals that do not repeat themselves."""
    faster = 0.37 * (time_s + 10.0) ** 1.1
    return np.stack([np.sin(time_s) + np.sin(faster), np.cos(1.3 * time_s + 0.2 * np.sin(time_s))], axis=-1)


def shifted(lag_s, *, drift=0.0, gain=1.0, noise=0.0, seconds=60.0):
    """Readings whose clock is ahead of the poses' by a lag, and faster by a drift; and predictions."""
    pose_s = np.arange(0.0, seconds, 1 / RATE_HZ)
    reading_s = np.arange(0.0, seconds, 1 / 80.0)
    values = gain * moving((reading_s - lag_s) / (1 + drift))
    values = values + noise * np.random.default_rng(0).standard_normal(values.shape)
    return Samples.of(reading_s, values), Samples.of(pose_s, moving(pose_s))


@pytest.mark.parametrize("lag_s", [-0.7, 0.0, 1.2 + 0.3 / 50])
def test_the_best_step_and_the_part_of_a_step(lag_s):
    """To be added to the times of the poses: readings at t show the pose at t - lag. 1/2500 of a sample, no noise."""
    readings, predicted = shifted(lag_s)
    found = correlations(readings, predicted, 3.0)
    assert found.lag_s[found.best] == pytest.approx(lag_s, abs=1 / 80)
    check_peak(found, "the robot")
    exact = refined(readings, predicted, float(found.lag_s[found.best]))
    assert exact.lag_s == pytest.approx(lag_s, abs=2e-4)
    assert exact.r == pytest.approx(1.0, abs=1e-4)
    assert exact.common_s == pytest.approx(60.0 - abs(lag_s), abs=0.2)


def test_size_of_what_is_left():
    """Readings move 1.3 times as much as predicted; white noise of 0.05 is left."""
    readings, predicted = shifted(0.2, gain=1.3, noise=0.05)
    found = refined(readings, predicted, 0.2)
    assert found.residual == pytest.approx(0.05, rel=0.05)
    assert abs(found.lag_s - 0.2) < 4 * found.error_s
    assert found.error_s < 2e-3


@pytest.mark.parametrize("ppm", [-300.0, 300.0])
def test_of_clocks_that_drift_the_lag_is_that_of_the_middle(ppm):
    """At 300 ppm the lag grows by 0.3 ms every second: 18 ms over the recording, 9 ms in its middle."""
    readings, predicted = shifted(0.0, drift=1e-6 * ppm)
    found = refined(readings, predicted, 0.0)
    assert found.lag_s == pytest.approx(1e-6 * ppm * 30.0, rel=0.15)


@pytest.mark.parametrize("noise", [0.005, 0.05, 0.2])
def test_error_of_the_lag_is_that_of_many_recordings(noise):
    """The blocks say how far the lag scatters, within a factor of 1.5; from a start that is 10 ms off, no bias stays.

    At 0.2 the noise of the rate is 8 times the rate: it must not count as motion.
    """
    found = []
    for seed in range(24):
        readings, predicted = shifted(0.1, seconds=20.0)
        values = readings.values + noise * np.random.default_rng(seed).standard_normal(readings.values.shape)
        found.append(refined(Samples.of(readings.time_s, values), predicted, 0.11))
    lags = np.array([one.lag_s for one in found])
    said = np.sqrt(np.mean([one.error_s**2 for one in found]))
    assert lags.std() / 1.5 < said < 1.5 * lags.std()
    assert abs(lags.mean() - 0.1) < 4 * lags.std() / np.sqrt(len(lags))


@pytest.mark.parametrize(
    ("r", "slope", "message"),
    [
        (0.79, 1.0, r"correlate by 0\.8"),
        (0.9, 0.49, "0.49 times as much"),
        (0.9, 2.1, "2.1 times as much"),
    ],
)
def test_peaks_that_are_refused_and_just_not(r, slope, message):
    """A single peak; at least 0.8, and between half and twice as much."""
    lag_s = np.linspace(-1.0, 1.0, 21)
    shape = np.maximum(0.0, 1 - 4 * np.abs(lag_s))
    check_peak(Correlations(lag_s, 0.81 * shape, np.full(21, 1.9)), "the robot")
    check_peak(Correlations(lag_s, 0.81 * shape, np.full(21, 0.51)), "the robot")
    with pytest.raises(InputError, match=message):
        check_peak(Correlations(lag_s, r * shape, np.full(21, slope)), "the robot")


@pytest.mark.parametrize(("below", "refused"), [(0.015, True), (0.025, False)])
def test_another_peak_nearly_as_high_is_refused(below, refused):
    """Nearly: less than 0.02 below the best."""
    lag_s = np.linspace(-1.0, 1.0, 21)
    r = np.zeros(21)
    r[5], r[15] = 0.9, 0.9 - below
    found = Correlations(lag_s, r, np.ones(21))
    if refused:
        with pytest.raises(InputError, match="alike at one lag only"):
            check_peak(found, "the robot")
    else:
        check_peak(found, "the robot")
