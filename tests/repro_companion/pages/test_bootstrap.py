"""Intervals by resampling against the normal law of a mean, and their random numbers."""

import numpy as np
import pytest

from repro_companion.book.bootstrap import interval, ratio_interval, resampled


def test_interval_of_a_mean_is_that_of_the_normal_law():
    values = np.random.default_rng(1).standard_normal(400)
    low, high = interval(values[resampled(400, 0)].mean(1))
    half = 1.959964 * values.std() / 20
    assert (low, high) == pytest.approx((values.mean() - half, values.mean() + half), abs=0.05 * half)


def test_pairs_stay_together():
    """What both share cancels; resampled apart, the ratio would scatter by a tenth."""
    rng = np.random.default_rng(0)
    lower = rng.uniform(0.5, 1.5, 20)
    upper = 2 * lower + 1e-3 * rng.standard_normal(20)
    low, high = ratio_interval(upper, lower, resampled(20, 0))
    assert low < upper.mean() / lower.mean() < high
    assert high - low < 2e-3
    apart = upper[resampled(20, 0)].mean(1) / lower[resampled(20, 1)].mean(1)
    assert np.subtract(*interval(apart)) < -0.3


def test_a_seed_gives_the_same_bits_and_a_generator_goes_on():
    once = resampled(7, 3, bootstraps=5)
    np.testing.assert_array_equal(once, resampled(7, 3, bootstraps=5))
    assert once.shape == (5, 7)
    assert set(once.flat) <= set(range(7))
    rng = np.random.default_rng(3)
    np.testing.assert_array_equal(resampled(7, rng, bootstraps=5), once)
    assert (resampled(7, rng, bootstraps=5) != once).any()
