"""Bootstrap intervals (95 %) over draws: of a mean, and of the ratio of two means over the same draws."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float, Int

BOOTSTRAPS = 10_000


def resampled(
    n: int, seed: int | np.random.Generator, *, bootstraps: int = BOOTSTRAPS
) -> Int[np.ndarray, "bootstraps n"]:
    """Draw from ``n`` draws, with replacement, as many as there are: numbers of the draws in each bootstrap.

    Parameters
    ----------
    n
        Number of draws.
    seed
        Or the generator that goes on.
    bootstraps
        How often.
    """
    return np.random.default_rng(seed).integers(n, size=(bootstraps, n))


def resampled_blocks(
    n: int, block: int, seed: int | np.random.Generator, *, bootstraps: int = BOOTSTRAPS
) -> Int[np.ndarray, "bootstraps n"]:
    """Draw from ``n`` draws that follow one another in time, in blocks: neighbours are alike and stay together.

    Each block begins anywhere, and goes on at the beginning where the draws end.

    Parameters
    ----------
    n
        Number of draws.
    block
        Number of neighbours that are drawn together; 1 is :func:`resampled`.
    seed
        Or the generator that goes on.
    bootstraps
        How often.
    """
    starts = np.random.default_rng(seed).integers(n, size=(bootstraps, -(-n // block)))
    return ((starts[..., None] + np.arange(block)) % n).reshape(bootstraps, -1)[:, :n]


def interval(values: Float[np.ndarray, " bootstraps"]) -> tuple[float, float]:
    """Quantiles between which 95 % of the values lie."""
    low, high = np.quantile(values, [0.025, 0.975])
    return float(low), float(high)


def ratio_interval(
    upper: Float[np.ndarray, " n"], lower: Float[np.ndarray, " n"], index: Int[np.ndarray, "bootstraps n"]
) -> tuple[float, float]:
    """Interval of the ratio of two means, paired: both from the same draws.

    Parameters
    ----------
    upper, lower
        One number for each draw.
    index
        From :func:`resampled`.

    Examples
    --------
    Numbers that are proportional leave nothing to chance:

    >>> x = np.array([1.0, 2.0, 4.0])
    >>> ratio_interval(3 * x, x, resampled(3, 0))
    (3.0, 3.0)
    """
    return interval(upper[index].mean(1) / lower[index].mean(1))


def ratio_of_means(
    upper: Float[np.ndarray, " n"], lower: Float[np.ndarray, " n"], index: Int[np.ndarray, "bootstraps n"]
) -> dict[str, float]:
    """Ratio of two means over the same draws with its interval: columns ``ratio, ratio_low, ratio_high``."""
    low, high = ratio_interval(upper, lower, index)
    return {"ratio": float(upper.mean() / lower.mean()), "ratio_low": low, "ratio_high": high}


def mean_rms(
    errors: Float[np.ndarray, "n columns"], index: Int[np.ndarray, "bootstraps n"]
) -> Float[np.ndarray, " bootstraps"]:
    """Mean over columns of the root mean square over draws, for every bootstrap; NaN is left out.

    Parameters
    ----------
    errors
        One row for each draw.
    index
        From :func:`resampled` or :func:`resampled_blocks`; the draws themselves are ``np.arange(n)[None]``.

    Examples
    --------
    >>> mean_rms(np.array([[3.0, 1.0], [4.0, np.nan]]), np.arange(2)[None]).round(3)
    array([2.268])
    """
    squares = errors**2
    counted = np.isfinite(squares)
    sums = np.where(counted, squares, 0.0)[index].sum(axis=1)
    return np.sqrt(sums / counted[index].sum(axis=1)).mean(axis=1)
