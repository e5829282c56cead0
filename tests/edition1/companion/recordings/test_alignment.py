"""Lags between synthetic signals: exact ones are found, unclear ones are refused."""

import numpy as np
import pytest

from edition1.errors import InputError
from edition1_companion.recordings.alignment import find_lag


def bend(time_s: np.ndarray) -> np.ndarray:
    """A synthetic test: bending up and down in uneven steps within 5 to 25 s."""
    x = np.clip((time_s - 5.0) / 20.0, 0.0, 1.0)
    return np.sin(np.pi * x) ** 2 + 0.05 * np.sin(9.0 * np.pi * x)


@pytest.mark.parametrize("lag_s", [-3.21, -0.004, 0.0, 0.507, 4.9])
def test_known_lag_at_different_rates_and_scales(lag_s):
    rng = np.random.default_rng(0)
    a_s = np.cumsum(rng.uniform(0.012, 0.021, 2500))
    b_s = np.arange(0, 30, 1 / 120)
    noisy = 3.0 + 0.2 * bend(a_s) + 0.002 * rng.standard_normal(len(a_s))
    lag = find_lag(a_s, noisy, b_s, bend(b_s + lag_s))
    assert lag.lag_s == pytest.approx(lag_s, abs=0.01)
    assert lag.r > 0.999
    assert 0.5 < lag.width_s < 3.0


def test_a_shift_of_one_clock_shifts_the_lag():
    t = np.arange(0, 30, 0.02)
    moved = find_lag(t, bend(t), t - 1.5, bend(t))
    assert moved.lag_s == pytest.approx(1.5, abs=1e-9)
    assert moved.r == pytest.approx(1.0, abs=1e-12)
    assert moved.common_s == pytest.approx(30, abs=0.05)


@pytest.mark.parametrize("share", [-0.3, 0.3, 0.5])
def test_lag_between_two_steps(share):
    """A signal shifted by a share of a sample: the parabola through three steps finds it, on the right side."""
    step_s = 0.02
    t = np.arange(0, 30, step_s)
    lag_s = 1.5 + share * step_s
    lag = find_lag(t, bend(t), t, bend(t + lag_s), step_s=step_s)
    assert lag.lag_s == pytest.approx(lag_s, abs=0.02 * step_s)


def test_width_of_a_peak_of_known_shape():
    """Two bumps exp(-t^2) correlate as exp(-lag^2/2), lower by 0.02 at a lag of sqrt(-2 ln 0.98) = 0.201 s."""
    t = np.arange(0, 60, 0.01)
    bump = np.exp(-((t - 30) ** 2))
    lag = find_lag(t, bump, t, bump)
    assert lag.width_s == pytest.approx(2 * np.sqrt(-2 * np.log(0.98)), rel=0.05)
    assert lag.common_s == pytest.approx(60, abs=0.02)


def test_masked_samples_are_not_bridged():
    t = np.arange(0, 30, 0.02)
    masked = np.where((t > 12) & (t < 18), np.nan, bend(t))
    masked[::50] = np.nan
    lag = find_lag(t, bend(t), t - 0.7, masked)
    assert lag.lag_s == pytest.approx(0.7, abs=1e-6)
    assert lag.r == pytest.approx(1.0, abs=1e-9)
    assert lag.common_s < 24


def test_two_equal_peaks_are_refused():
    t = np.arange(0, 30, 0.02)
    with pytest.raises(InputError) as caught:
        find_lag(t, np.sin(np.pi * t), t, np.sin(np.pi * t))
    message = str(caught.value)
    assert message.startswith(
        "Input recordings of find_lag must be with one peak, 0.02 above any other; instead"
    )
    lags = [float(text.split(" s")[0]) for text in message.split(" at ")[1:]]
    assert np.diff(lags) % 2 == 0
    assert message.count("r = 1.000") == 2


def test_unrelated_signals_are_refused():
    t = np.arange(0, 30, 0.02)
    rng = np.random.default_rng(0)
    with pytest.raises(
        InputError, match=r"with a clear peak, r of at least 0\.9; instead received r = 0\.[0-2]"
    ):
        find_lag(t, rng.standard_normal(len(t)), t, rng.standard_normal(len(t)))


def test_lag_outside_the_search_is_refused():
    t = np.arange(0, 40, 0.02)
    with pytest.raises(InputError, match=r"with a clear peak; .* at the end of the search, \+2\.00 s"):
        find_lag(t, bend(t), t, bend(t + 3.0), longest_s=2.0)


def test_recordings_of_different_times_are_refused():
    t = np.arange(0, 30, 0.02)
    with pytest.raises(InputError) as caught:
        find_lag(t, bend(t), t + 100, bend(t))
    assert str(caught.value) == (
        "Input recordings of find_lag must be of one time, with half of the shorter in common; "
        "instead received at most 0.0 s in common, of 30.0 s."
    )


def test_constant_signals_are_refused():
    t = np.arange(0, 30, 0.02)
    with pytest.raises(InputError, match="signals of find_lag must be varying; instead received a constant"):
        find_lag(t, bend(t), t, np.ones_like(t))


def test_times_that_do_not_increase_are_refused():
    t = np.arange(0, 30, 0.02)
    with pytest.raises(InputError, match="time_b_s of find_lag must be at least three increasing times"):
        find_lag(t, bend(t), t[::-1].copy(), bend(t))


def test_a_gap_is_not_bridged():
    """Twenty seconds of readings are missing: a straight line over them would move the peak."""
    t = np.arange(0, 60, 0.0164)
    slow = bend(t / 2.0)
    here = (t < 14) | (t > 34)
    capture_s = np.arange(5, 55, 1 / 120)
    lag = find_lag(t[here], slow[here], capture_s - 0.53, bend(capture_s / 2.0))
    assert lag.lag_s == pytest.approx(0.53, abs=0.005)
    assert lag.r > 0.99999
    assert lag.common_s == pytest.approx(30, abs=0.2)


def test_intervals_up_to_three_median_ones_are_bridged():
    t = np.arange(0, 30, 0.02)
    kept = np.ones(len(t), dtype=bool)
    kept[100::50] = kept[101::50] = False
    whole = find_lag(t[kept], bend(t)[kept], t, bend(t))
    assert whole.common_s == pytest.approx(29.9, abs=0.1)
    kept[102::50] = False
    assert find_lag(t[kept], bend(t)[kept], t, bend(t)).common_s < 28.5


@pytest.mark.parametrize("lag_s", [1.96, 1.99, -1.97])
def test_a_lag_beside_the_end_of_the_search_is_refused(lag_s):
    t = np.arange(0, 40, 0.02)
    with pytest.raises(InputError, match=r"with a clear peak; .* at the end of the search"):
        find_lag(t, bend(t), t, bend(t + lag_s), longest_s=2.0)
    assert find_lag(t, bend(t), t, bend(t + 1.9), longest_s=2.0).lag_s == pytest.approx(1.9, abs=0.01)


def test_a_lag_beside_those_with_too_little_in_common_is_refused():
    """The correlation still rises where half of the shorter recording is just in common."""
    t = np.arange(0, 12, 0.02)
    with pytest.raises(InputError, match=r"with a clear peak; .* at the end of the search"):
        find_lag(t, bend(t), t, bend(t + 8.0), longest_s=10.0, least_r=0.5)
