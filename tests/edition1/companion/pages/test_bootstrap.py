"""Intervals by resampling against the normal law of a mean, and their random numbers."""

import numpy as np
import pytest

from edition1_companion.book.bootstrap import interval, ratio_interval, resampled, resampled_blocks


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


def test_blocks_keep_neighbours_together():
    """Each value four times: blocks give about the interval of the distinct ones, single draws half of it."""
    values = np.repeat(np.random.default_rng(2).standard_normal(1000), 4)
    low, high = interval(values[resampled_blocks(4000, 40, 0, bootstraps=2000)].mean(1))
    assert high - low == pytest.approx(2 * 1.959964 * values.std() / np.sqrt(1000), rel=0.2)
    short = interval(values[resampled(4000, 0, bootstraps=2000)].mean(1))
    assert short[1] - short[0] == pytest.approx((high - low) / 2, rel=0.2)
    index = resampled_blocks(10, 3, 1, bootstraps=4)
    assert index.shape == (4, 10)
    np.testing.assert_array_equal(np.diff(index[:, :9].reshape(4, 3, 3), axis=2) % 10, 1)


def test_a_block_of_one_is_no_block():
    np.testing.assert_array_equal(resampled_blocks(9, 1, 5, bootstraps=3), resampled(9, 5, bootstraps=3))
