"""Lag between two recordings of one motion that have no common trigger, by cross-correlation."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.signal import correlate

from edition1.errors import bad_input, require

LONGEST_INTERVAL = 3.0
"""Longest interval that is interpolated over, in median intervals of its recording."""
EDGE_STEPS = 5
"""A best lag within this many steps of the end of the search may be that of a peak beyond it."""


@dataclass(frozen=True)
class Lag:
    """By how much one clock is ahead of another.

    Attributes
    ----------
    lag_s
        To be added to the second recording's times to have the first one's [s].
    r
        Correlation coefficient of the two signals at this lag.
    width_s
        Width of the peak where the correlation has fallen by the margin of `find_lag` [s].
    common_s
        Time over which both signals are known at this lag [s].
    """

    lag_s: float
    r: float
    width_s: float
    common_s: float


def find_lag(
    time_a_s: Float[np.ndarray, " samples_a"],
    a: Float[np.ndarray, " samples_a"],
    time_b_s: Float[np.ndarray, " samples_b"],
    b: Float[np.ndarray, " samples_b"],
    *,
    longest_s: float = 5.0,
    step_s: float = 0.01,
    least_r: float = 0.9,
    margin: float = 0.02,
) -> Lag:
    """Find the lag at which two signals correlate best, and refuse one that is not clearly the best.

    Both signals are interpolated linearly at even steps; nothing is interpolated across samples that are NaN, nor
    across a gap, an interval of more than `LONGEST_INTERVAL` median ones. Each correlation is over the steps at which
    both signals are known. The best step is refined by a parabola through its neighbours.

    Parameters
    ----------
    time_a_s, time_b_s
        Increasing times [s], each on its own clock.
    a, b
        Signals that should be proportional to each other up to an offset, positively; masked samples are NaN.
    longest_s
        Lags from minus this to plus this are tried [s].
    step_s
        Distance between lags tried [s].
    least_r
        Correlation below which no lag is accepted.
    margin
        By how much the best correlation must exceed that of every other peak. A rise counts as another peak where
        the correlation is lower by twice this in between.

    Raises
    ------
    InputError
        Times that do not increase; signals that at no lag have half of the shorter one in common; a constant
        signal; no clear peak: the best correlation is too low, lies at the end of the search (within `EDGE_STEPS` of
        it, or beside lags at which too little is in common), or another peak is nearly as high.

    Examples
    --------
    >>> t = np.arange(0.0, 20.0, 0.02)
    >>> bump = np.exp(-((t - 8.0) ** 2))
    >>> round(find_lag(t, bump, t, np.exp(-((t - 6.5) ** 2))).lag_s, 3)
    1.5
    """
    for name, values in (("time_a_s", time_a_s), ("time_b_s", time_b_s)):
        if len(values) < 3 or not (np.diff(values) > 0).all():
            raise bad_input(name, "find_lag", "at least three increasing times", values)
    # The steps of both lie on one grid, so that a lag is a whole number of them.
    grid_a, on_a = _even(time_a_s, a, step_s)
    grid_b, on_b = _even(time_b_s, b, step_s)
    first = grid_b - grid_a
    shifts = np.arange(-round(longest_s / step_s), round(longest_s / step_s) + 1)
    least = min(np.isfinite(on_a).sum(), np.isfinite(on_b).sum()) / 2
    r, common = _correlations(on_a, on_b, shifts + first, max(3.0, least))
    if common.max() < max(3.0, least):
        seen = f"at most {common.max() * step_s:.1f} s in common, of {2 * least * step_s:.1f} s"
        raise bad_input("recordings", "find_lag", "of one time, with half of the shorter in common", seen)
    require(np.isfinite(r).any(), "signals", "find_lag", "varying", "a constant")
    known = np.flatnonzero(np.isfinite(r))
    r = np.where(np.isfinite(r), r, -1.0)
    best = int(np.argmax(r))
    edge = min(best - known[0], known[-1] - best) < 1 or min(best, len(r) - 1 - best) < EDGE_STEPS
    if edge:
        seen = f"its highest correlation, {r[best]:.3f}, at the end of the search, {shifts[best] * step_s:+.2f} s"
        raise bad_input("recordings", "find_lag", "with a clear peak", seen)
    if r[best] < least_r:
        seen = f"r = {r[best]:.3f} at {shifts[best] * step_s:+.2f} s"
        raise bad_input("recordings", "find_lag", f"with a clear peak, r of at least {least_r:g}", seen)
    low = np.flatnonzero(r < r[best] - 2.0 * margin)
    left, right = low[low < best].max(initial=-1), low[low > best].min(initial=len(r))
    others = np.concatenate([np.arange(left + 1), np.arange(right, len(r))])
    other = int(others[np.argmax(r[others])]) if others.size else best
    if other != best and r[other] > r[best] - margin:
        seen = ", ".join(f"r = {r[k]:.3f} at {shifts[k] * step_s:+.2f} s" for k in (best, other))
        raise bad_input("recordings", "find_lag", f"with one peak, {margin:g} above any other", seen)
    before, top, after = r[best - 1 : best + 2]
    bend = before - 2.0 * top + after
    offset = 0.5 * (before - after) / bend if bend < 0 else 0.0
    width_s = float((r[left + 1 : right] > top - margin).sum() * step_s)
    return Lag(float((shifts[best] + offset) * step_s), float(top), width_s, float(common[best] * step_s))


def _even(time_s: np.ndarray, values: np.ndarray, step_s: float) -> tuple[int, np.ndarray]:
    """Return the number of the first step and the values at even steps; NaN beside a NaN and in gaps."""
    first, last = int(np.ceil(time_s[0] / step_s)), int(np.floor(time_s[-1] / step_s))
    at = np.arange(first, last + 1) * step_s
    intervals = np.diff(time_s)
    gap = intervals > (LONGEST_INTERVAL + 1e-6) * np.median(intervals)
    before = (np.searchsorted(time_s, at, side="right") - 1).clip(0, len(gap) - 1)
    return first, np.where(gap[before] & (at > time_s[before]), np.nan, np.interp(at, time_s, values))


def _correlations(
    a: np.ndarray, b: np.ndarray, shifts: np.ndarray, least: float
) -> tuple[np.ndarray, np.ndarray]:
    """Correlate a[k + shift] with b[k] where both are known, for each shift; return r and the number of samples.

    r is NaN where the samples are too few or a signal is constant.
    """
    known = np.isfinite(a).astype(float), np.isfinite(b).astype(float)
    zero = [
        np.where(on, x - x[on > 0].mean(), 0.0) if on.any() else on
        for x, on in zip((a, b), known, strict=True)
    ]
    inside = (shifts > -len(b)) & (shifts < len(a))

    def sums(x: np.ndarray, y: np.ndarray) -> np.ndarray:
        found = np.zeros(len(shifts))
        found[inside] = correlate(x, y, method="fft")[shifts[inside] + len(b) - 1]
        return found

    common = np.round(sums(known[0], known[1]))
    n = np.maximum(common, 1.0)
    sum_a, sum_b = sums(zero[0], known[1]), sums(known[0], zero[1])
    square_a = sums(zero[0] ** 2, known[1]) - sum_a**2 / n
    square_b = sums(known[0], zero[1] ** 2) - sum_b**2 / n
    product = sums(zero[0], zero[1]) - sum_a * sum_b / n
    # Transforms leave rounding errors of the order of 1e-14 of the whole sum where a signal is constant.
    varies = (square_a > 1e-9 * (zero[0] ** 2).sum()) & (square_b > 1e-9 * (zero[1] ** 2).sum())
    good = (common >= least) & varies
    return np.where(good, product / np.sqrt(np.where(good, square_a * square_b, 1.0)), np.nan), common
