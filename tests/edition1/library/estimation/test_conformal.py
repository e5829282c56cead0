"""Conformal prediction: its law on exchangeable draws, a library beside it, closed forms, and what it refuses."""

import math

import numpy as np
import pytest
from crepes import ConformalRegressor
from scipy.stats import chi, norm

from edition1.errors import InputError
from edition1.estimation.conformal import (
    adaptive_factors,
    block_weights,
    conformal_factor,
    ellipsoid_scores,
    interval_score,
)


@pytest.mark.parametrize("level", [0.5, 0.9, 0.95])
@pytest.mark.parametrize("k", [30, 200])
def test_factor_is_that_of_crepes(k, level):
    """Bands of a library, for residuals over their stated deviations."""
    rng = np.random.default_rng(k)
    sigma, other = rng.uniform(0.5, 2.0, k), rng.uniform(0.5, 2.0, 7)
    residuals = sigma * rng.standard_t(3, k)
    library = ConformalRegressor().fit(residuals, sigmas=sigma)
    low, high = library.predict_int(np.zeros(7), sigmas=other, confidence=level).T
    factor = conformal_factor(np.abs(residuals) / sigma, level)
    np.testing.assert_allclose(high, factor * other, rtol=1e-12)
    np.testing.assert_allclose(low, -factor * other, rtol=1e-12)


def test_next_score_is_held_as_often_as_said():
    """Over many draws of 39 scores from a heavy tail; the exact probability is 36/40."""
    scores = np.random.default_rng(0).standard_cauchy((20_000, 40)) ** 2
    factors = np.array([conformal_factor(row[:-1], 0.9) for row in scores])
    assert 0.88 < (scores[:, -1] <= factors).mean() < 0.92
    assert (scores[:, -1] <= factors).mean() == pytest.approx(0.9, abs=3 * math.sqrt(0.09 / 20_000))


def test_groups_that_are_alike_count_once():
    """A group shifts all its ten scores. The next group is held as said if each score counts a tenth; not if one."""
    rng = np.random.default_rng(1)
    held = {"tenth": [], "one": []}
    for _ in range(4000):
        shift = rng.lognormal(0.0, 1.0, (13, 1))
        scores = shift * rng.uniform(0.9, 1.1, (13, 10))
        known = scores[:-1].ravel()
        for name, weights in (("tenth", np.full(120, 0.1)), ("one", None)):
            held[name].append((scores[-1] <= conformal_factor(known, 0.9, weights)).mean())
    assert 0.9 <= np.mean(held["tenth"]) < 0.96
    assert np.mean(held["one"]) < 0.885


def test_each_block_that_has_estimates_weighs_one():
    """Wherever the clock is zero; blocks as long as a step leave every score alone; of nothing there is nothing."""
    time_s = np.sort(np.random.default_rng(3).uniform(0.0, 60.0, 500)) + 1e6
    weights, block = block_weights(time_s, 2.0), (time_s - time_s[0]) // 2.0
    assert np.bincount(block.astype(int), weights) == pytest.approx(np.ones(30), abs=1e-12)
    assert (block_weights(np.arange(9.0), 1.0) == 1).all()
    assert len(block_weights(np.empty(0), 1.0)) == 0


def test_weights_of_zero_and_one_choose():
    scores = np.random.default_rng(2).exponential(size=60)
    chosen = np.arange(60) % 2 == 0
    assert conformal_factor(scores, 0.8, chosen.astype(float)) == conformal_factor(scores[chosen], 0.8)


def test_recent_scores_count_more_under_drift():
    """Scores that grow: with half the weight after ten, the factor is near the newest."""
    scores = np.arange(1.0, 101.0)
    weights = 0.5 ** (np.arange(100)[::-1] / 10)
    assert conformal_factor(scores, 0.8) == 81.0
    factor = conformal_factor(scores, 0.8, weights)
    held = weights[scores <= factor].sum() / (1 + weights.sum())
    below = weights[scores < factor].sum() / (1 + weights.sum())
    assert below < 0.8 <= held
    assert factor > 95


@pytest.mark.parametrize(("level", "k"), [(0.9, 9), (0.8, 4), (0.5, 1), (0.95, 19)])
def test_too_few_scores_say_nothing(level, k):
    assert conformal_factor(np.ones(k), level) == 1.0
    assert conformal_factor(np.ones(k - 1), level) == math.inf


def test_scores_of_a_gaussian_are_below_one_as_often_as_the_level():
    """In three coordinates with a full covariance; and twice as far is twice the score."""
    rng = np.random.default_rng(3)
    A = rng.normal(size=(3, 3))
    error = rng.normal(size=(40_000, 3)) @ A.T
    C = np.broadcast_to(A @ A.T, (len(error), 3, 3))
    scores = ellipsoid_scores(error, C, 0.9)
    assert (scores <= 1).mean() == pytest.approx(0.9, abs=0.005)
    np.testing.assert_allclose(ellipsoid_scores(2 * error, C, 0.9), 2 * scores)
    np.testing.assert_allclose(scores[0] * chi(3).ppf(0.9), np.linalg.norm(np.linalg.solve(A, error[0])))


@pytest.mark.parametrize("delay", [1, 25])
def test_adaptive_factors_miss_the_share_whatever_the_scores_do(delay):
    """Within the bound: what the factor can have moved in all, over the step and the number of scores."""
    rng = np.random.default_rng(4)
    drift = np.where(np.arange(6000) < 3000, 1.0, 4.0) * (1 + 0.5 * np.sin(np.arange(6000) / 300))
    scores, step = drift * rng.uniform(0.0, 1.0, 6000), 0.05
    factors = adaptive_factors(scores, 0.9, first=1.0, step=step, delay=delay)
    missed = (scores > factors).mean()
    assert missed == pytest.approx(
        0.1, abs=(scores.max() + (delay + 1) * step) / (step * 6000) + delay / 6000
    )
    assert factors[5900:].mean() > 2 * factors[2000:2900].mean()


def test_adaptive_factors_know_the_truth_only_after_the_delay():
    scores = np.random.default_rng(5).exponential(size=50)
    other = np.where(np.arange(50) < 20, scores, 9.0)
    plain, changed = (adaptive_factors(s, 0.9, first=2.0, step=0.3, delay=8) for s in (scores, other))
    assert np.array_equal(plain[:28], changed[:28])
    assert (plain[:8] == 2.0).all()
    assert not np.array_equal(plain[28:], changed[28:])


def test_interval_score_is_least_at_the_quantile():
    """Of Gaussian errors: no other width of the band does better, and 90 % are held there."""
    error = np.random.default_rng(6).normal(size=200_000)
    radii = np.linspace(1.0, 2.5, 61)
    means = [interval_score(error, np.full(len(error), r), 0.9).mean() for r in radii]
    assert radii[int(np.argmin(means))] == pytest.approx(norm.ppf(0.95), abs=0.03)


def test_interval_score_is_that_of_the_two_ends():
    """Eq. (43) of Gneiting and Raftery 2007, written with lower and upper end."""
    rng = np.random.default_rng(7)
    x, found, r, alpha = rng.normal(size=90), rng.normal(size=90), rng.uniform(0, 2, 90), 0.2
    low, high = found - r, found + r
    printed = (high - low) + 2 / alpha * ((low - x) * (x < low) + (x - high) * (x > high))
    np.testing.assert_allclose(interval_score(found - x, r, 1 - alpha), printed, rtol=1e-12)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (
            lambda: conformal_factor(np.ones(3), 1.0),
            "Input level of conformal_factor must be between 0 and 1",
        ),
        (
            lambda: conformal_factor(np.array([1.0, np.nan]), 0.9),
            "Input scores of conformal_factor must be one number",
        ),
        (lambda: conformal_factor(np.array([-1.0]), 0.9), "at least 0"),
        (
            lambda: conformal_factor(np.ones(2), 0.9, np.array([1.0, 1.5])),
            "Input weights of conformal_factor must be",
        ),
        (lambda: adaptive_factors(np.ones(2), 0.9, first=1.0, step=0.0, delay=1), "step of adaptive_factors"),
        (
            lambda: adaptive_factors(np.ones(2), 0.9, first=1.0, step=1.0, delay=0),
            "a whole number of estimates",
        ),
        (
            lambda: adaptive_factors(np.ones(2), 0.9, first=-1.0, step=1.0, delay=1),
            "first of adaptive_factors",
        ),
        (lambda: block_weights(np.array([0.0, np.nan]), 1.0), "time_s of block_weights must be finite"),
        (lambda: block_weights(np.zeros(2), 0.0), "block_s of block_weights must be positive"),
        (lambda: interval_score(np.ones(1), -np.ones(1), 0.9), "radius of interval_score must be at least 0"),
        (lambda: ellipsoid_scores(np.ones((1, 1)), np.ones((1, 1, 1)), 0.0), "level of ellipsoid_scores"),
    ],
)
def test_what_cannot_be_used_is_refused(call, message):
    with pytest.raises(InputError, match=message):
        call()
