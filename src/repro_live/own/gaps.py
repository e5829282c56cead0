"""Values between samples: interpolated linearly, but never over a gap."""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float

GAP_STEPS = 2.5
"""Samples farther apart than this many of their usual steps are not interpolated over."""


def longest_gap_s(time_s: Float[np.ndarray, " samples"]) -> float:
    """Longest time between two samples over which is interpolated [s]: :data:`GAP_STEPS` median steps."""
    return GAP_STEPS * float(np.median(np.diff(time_s)))


def known(
    sampled_s: Float[np.ndarray, " samples"], time_s: Float[np.ndarray, " times"], gap_s: float
) -> Bool[np.ndarray, " times"]:
    """Whether times lie at a sample, or between two that are at most ``gap_s`` apart.

    Examples
    --------
    >>> known(np.array([0.0, 0.1, 0.9]), np.array([-0.1, 0.0, 0.05, 0.5, 0.9]), 0.25)
    array([False,  True,  True, False,  True])
    """
    after = np.searchsorted(sampled_s, time_s, side="right")
    k = np.clip(after, 1, len(sampled_s) - 1)
    between = (after > 0) & (after < len(sampled_s)) & (sampled_s[k] - sampled_s[k - 1] <= gap_s)
    return between | ((after > 0) & (sampled_s[np.clip(after - 1, 0, None)] == time_s))


def interpolated(
    sampled_s: Float[np.ndarray, " samples"],
    values: Float[np.ndarray, "samples k"],
    time_s: Float[np.ndarray, " times"],
    gap_s: float,
) -> Float[np.ndarray, "times k"]:
    """Values at times, linearly between samples; NaN where nothing is :func:`known`."""
    columns = [np.interp(time_s, sampled_s, column) for column in values.T]
    return np.where(known(sampled_s, time_s, gap_s)[:, None], np.stack(columns, axis=-1), np.nan)
