r"""Conformal prediction: by how much the covariance of any estimator must grow to hold as often as it says.

An estimator states a covariance :math:`C`. Where the truth :math:`x` is known, the *score* of an estimate is its
Mahalanobis distance over that within which a Gaussian lies with the level :math:`1-\alpha`, in :math:`n` coordinates

.. math:: s = \sqrt{e^T C^{-1} e \,/\, F^{-1}_{\chi^2_n}(1-\alpha)}, \qquad e = \hat q - x .

A score of one is the edge of the stated ellipsoid. The band of the estimate is that ellipsoid, times the *factor*
that conformal prediction finds from scores of before: whatever their distribution, the next score is below it with
probability :math:`1-\alpha` if it might as well have been one of them.
"""

from __future__ import annotations

import math

import numpy as np
from jaxtyping import Float
from scipy.stats import chi2

from edition1.errors import require

_ROUNDING = 1e-12
"""Share by which sums of weights may be off."""


def ellipsoid_scores(
    error: Float[np.ndarray, "k n"], covariance: Float[np.ndarray, "k n n"], level: float
) -> Float[np.ndarray, " k"]:
    """Scores of estimates: 1 on the edge of the ellipsoid that would hold a Gaussian with this level.

    Parameters
    ----------
    error
        Estimates less the truth, in any unit.
    covariance
        Stated of the estimates, in that unit squared.
    level
        How often the ellipsoid is to hold, between 0 and 1.

    Raises
    ------
    InputError
        If the level is not between 0 and 1.

    Examples
    --------
    One coordinate, of which 95 % lie within 1.96 standard deviations:

    >>> ellipsoid_scores(np.array([[3.92]]), np.array([[[1.0]]]), 0.95).round(3)
    array([2.])
    """
    _require_level(level, "ellipsoid_scores")
    squared = np.einsum("ki,ki->k", error, np.linalg.solve(covariance, error[..., None])[..., 0])
    return np.sqrt(squared / chi2(error.shape[-1]).ppf(level))


def conformal_factor(
    scores: Float[np.ndarray, " k"], level: float, weights: Float[np.ndarray, " k"] | None = None
) -> float:
    r"""The factor that holds the next score with a probability of at least ``level``.

    The next score has the weight 1, and might be infinite: with weights :math:`w_i` the factor is the smallest score
    with :math:`\sum_{s_i \le s} w_i \ge (1-\alpha)\,(1 + \sum_i w_i)`. Without weights, that is the
    :math:`\lceil (k+1)(1-\alpha) \rceil`-th smallest of :math:`k`.

    Parameters
    ----------
    scores
        Of estimates whose truth is known, at least 0. Any score will do, as long as a larger one is worse.
    level
        How often the next score is to be held, between 0 and 1.
    weights
        Between 0 and 1, how much each counts; 1 when not given. Against drift the older count less. Of scores that
        follow one another, and are alike, see :func:`block_weights`.

    Returns
    -------
    float
        Infinite where there are too few scores to say: fewer than ``level / (1 - level)``.

    Raises
    ------
    InputError
        If the level is not between 0 and 1, a score is negative or not a number, or a weight is not between 0 and 1.

    References
    ----------
    Vovk, Gammerman, Shafer 2005, Algorithmic Learning in a Random World; Barber, Candès, Ramdas, Tibshirani 2023,
    Conformal prediction beyond exchangeability, for weights; Dunn, Wasserman, Ramdas 2023, Distribution-free
    prediction sets for two-layer hierarchical models, for groups that are alike inside.

    Examples
    --------
    Of nine scores the largest holds the next one in nine cases of ten; eight are too few.

    >>> conformal_factor(np.arange(1.0, 10.0), 0.9), conformal_factor(np.arange(1.0, 9.0), 0.9)
    (9.0, inf)
    """
    _require_level(level, "conformal_factor")
    _require_scores(scores, "conformal_factor")
    w = np.ones(len(scores)) if weights is None else np.asarray(weights, dtype=float)
    fit = w.shape == np.shape(scores) and bool(((w >= 0) & (w <= 1)).all())
    require(fit, "weights", "conformal_factor", "one between 0 and 1 for each score", w)
    order = np.argsort(scores)
    reached = np.cumsum(w[order]) >= level * (1 + w.sum()) * (1 - _ROUNDING)
    return float(np.asarray(scores)[order][reached.argmax()]) if reached.any() else math.inf


def block_weights(time_s: Float[np.ndarray, " k"], block_s: float) -> Float[np.ndarray, " k"]:
    """Weights of scores that are alike within blocks of time: those of a block together count as one.

    Parameters
    ----------
    time_s
        When the estimates were made; blocks are counted from the first [s].
    block_s
        How long a block is, above 0 [s].

    Raises
    ------
    InputError
        If a time is not finite, or the block is not longer than 0.

    Examples
    --------
    Two estimates in the first second, one in the next, and none until the sixth:

    >>> block_weights(np.array([7.25, 8.0, 8.5, 12.5]), 1.0)
    array([0.5, 0.5, 1. , 1. ])
    """
    require(bool(np.isfinite(time_s).all()), "time_s", "block_weights", "finite", time_s)
    require(0 < block_s < math.inf, "block_s", "block_weights", "positive [s]", block_s)
    _, block, alike = np.unique((time_s - time_s[:1]) // block_s, return_inverse=True, return_counts=True)
    return 1.0 / alike[block]


def adaptive_factors(
    scores: Float[np.ndarray, " k"], level: float, *, first: float, step: float, delay: int
) -> Float[np.ndarray, " k"]:
    r"""Factors that follow the scores, whose truth becomes known a while later: a reference, not a forecast.

    With :math:`m_j = 1` where score :math:`j` was above its factor, else 0,

    .. math:: c_{j+1} = \max(0,\; c_j + \gamma\,(m_{j+1-d} - \alpha)) .

    It misses a share :math:`\alpha` in the long run, whatever the scores are.

    Parameters
    ----------
    scores
        In the order of time, at least 0.
    level
        How often they are to be held, between 0 and 1.
    first
        Factor until the first truth is known, at least 0.
    step
        By how much a miss widens the band, above 0.
    delay
        After how many estimates the truth of one is known, at least 1.

    Raises
    ------
    InputError
        If an input is not as said.

    References
    ----------
    Gibbs, Candès 2021, Adaptive conformal inference under distribution shift, applied to the factor in place of the
    level, so that no band is infinite: Angelopoulos, Candès, Tibshirani 2023, Conformal PID control.

    Examples
    --------
    >>> adaptive_factors(np.array([3.0, 3.0, 0.1, 0.1]), 0.9, first=1.0, step=1.0, delay=1).round(1)
    array([1. , 1.9, 2.8, 2.7])
    """
    owner = "adaptive_factors"
    _require_level(level, owner)
    _require_scores(scores, owner)
    require(first >= 0, "first", owner, "at least 0", first)
    require(step > 0, "step", owner, "positive", step)
    require(delay >= 1, "delay", owner, "a whole number of estimates, at least 1", delay)
    factors = np.full(len(scores), float(first))
    for j in range(delay, len(scores)):
        missed = scores[j - delay] > factors[j - delay]
        factors[j] = max(0.0, factors[j - 1] + step * (missed - (1 - level)))
    return factors


def interval_score(
    error: Float[np.ndarray, " k"], radius: Float[np.ndarray, " k"], level: float
) -> Float[np.ndarray, " k"]:
    r"""What a band costs: its width, and the more the farther the truth lies outside. Smaller is better.

    .. math:: S = 2 r + \frac{2}{\alpha} \max(0,\; |e| - r)

    For one coordinate it is the interval score of the interval :math:`\hat q \pm r`. For several, the band is a ball
    and the error a distance; an ellipsoid is measured as the ball of the same volume, in the coordinates that make
    it one. In the mean, no band does better than that whose radius is the quantile of the errors.

    Parameters
    ----------
    error
        Distances of the estimates from the truth.
    radius
        Of the bands, in the same unit, at least 0.
    level
        How often the bands are to hold, between 0 and 1.

    Raises
    ------
    InputError
        If the level is not between 0 and 1, or a radius is negative.

    References
    ----------
    Gneiting, Raftery 2007, Strictly proper scoring rules, prediction, and estimation, eq. (43).

    Examples
    --------
    A band of +-1 that holds, and one that misses by 0.5:

    >>> interval_score(np.array([0.3, 1.5]), np.ones(2), 0.9).round(6)
    array([ 2., 12.])
    """
    _require_level(level, "interval_score")
    require((np.asarray(radius) >= 0).all(), "radius", "interval_score", "at least 0", radius)
    return 2 * radius + 2 / (1 - level) * np.maximum(0.0, np.abs(error) - radius)


def _require_level(level: float, owner: str) -> None:
    require(0 < level < 1, "level", owner, "between 0 and 1", level)


def _require_scores(scores: np.ndarray, owner: str) -> None:
    right = np.ndim(scores) == 1 and bool((np.asarray(scores) >= 0).all())
    require(right, "scores", owner, "one number for each estimate, at least 0", scores)
