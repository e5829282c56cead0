r"""By how much the clock of the motion capture differs from that of the readings.

The poses predict readings by the robot as described, and these are correlated with the measured ones at every lag,
over all sensors together; then the lag is refined to a fraction of a sample by least squares, each sensor with a gain
and an offset of its own. Nothing is interpolated over a gap of either.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.signal import correlate

from edition1.errors import bad_input, require
from edition1_live.own.samples import Samples

LEAST_R = 0.8
"""Correlation below which no lag is accepted."""
MARGIN = 0.02
"""By how much the best correlation must exceed that of any other peak."""
_SLOPES = 0.5, 2.0
"""Measured readings may move this many times as much as predicted."""
_BLOCKS = 8
"""Blocks of time whose own lags tell the error and the drift."""
_ITERATIONS = 15
_MOST_STEPS = 1 << 17
OWNER = "repro fit"


@dataclass(frozen=True)
class Lag:
    """By how much one clock is ahead of another.

    Parameters
    ----------
    lag_s
        To be added to the times of the poses to have those of the readings [s].
    error_s
        Its standard deviation, by what the blocks of the recording say [s].
    r
        Correlation of predicted and measured readings.
    residual
        Root mean square of what is left after a gain and an offset for each sensor [unit].
    common_s
        Time over which both are known [s].
    """

    lag_s: float
    error_s: float
    r: float
    residual: float
    common_s: float


@dataclass(frozen=True)
class Correlations:
    """Correlation of readings and predictions at every lag that was tried.

    Parameters
    ----------
    lag_s, r, slope
        Lags [s]; correlation, -1 where too little is in common; slope.
    """

    lag_s: Float[np.ndarray, " lags"]
    r: Float[np.ndarray, " lags"]
    slope: Float[np.ndarray, " lags"]

    @property
    def best(self) -> int:
        """Where the correlation is highest."""
        return int(np.argmax(self.r))


def correlations(readings: Samples, predicted: Samples, longest_s: float) -> Correlations:
    """Correlate at lags from minus to plus ``longest_s``, in steps of the shorter of the two sampling times.

    Raises
    ------
    InputError
        If at no lag half of the shorter recording is in common, or a signal does not vary.
    """
    step_s = min(float(np.median(np.diff(s.time_s))) for s in (readings, predicted))
    step_s = max(step_s, max(float(np.ptp(s.time_s)) for s in (readings, predicted)) / _MOST_STEPS)
    starts, grids = [], []
    for signal in (readings, predicted):
        first, last = int(np.ceil(signal.time_s[0] / step_s)), int(np.floor(signal.time_s[-1] / step_s))
        starts.append(first)
        grids.append(signal.at(np.arange(first, last + 1) * step_s))
    n = min(round(longest_s / step_s), abs(starts[0] - starts[1]) + sum(map(len, grids)))
    shifts = np.arange(-n, n + 1)
    known = [np.isfinite(grid).all(axis=1) for grid in grids]
    # Centred, so that differences of large sums lose no digits.
    a, b = (
        np.where(on[:, None], g - g[on].mean(axis=0) if on.any() else 0, 0)
        for g, on in zip(grids, known, strict=True)
    )
    at = shifts + starts[1] - starts[0]
    inside = (at > -len(b)) & (at < len(a))

    def sums(x: np.ndarray, y: np.ndarray) -> np.ndarray:
        found = np.zeros(len(at))
        found[inside] = correlate(x, y, method="fft")[at[inside] + len(b) - 1]
        return found

    on_a, on_b = (on.astype(float) for on in known)
    common = np.round(sums(on_a, on_b))
    least = max(3.0, min(on_a.sum(), on_b.sum()) / 2)
    if common.max(initial=0) < least:
        spans = [
            f"{s.time_s[0]:.6g} to {s.time_s[-1]:.6g} s ({on.sum() * step_s:.3g} s without gaps)"
            for s, on in zip((readings, predicted), known, strict=True)
        ]
        expected = f"of one time within {longest_s:g} s, with half of the shorter in common"
        raise bad_input("readings and poses", OWNER, expected, f"{spans[0]} and {spans[1]}")
    count = np.maximum(common, 1.0)
    product, square_a, square_b = (np.zeros(len(at)) for _ in range(3))
    for x, y in zip(a.T, b.T, strict=True):
        sum_x, sum_y = sums(x, on_b), sums(on_a, y)
        product += sums(x, y) - sum_x * sum_y / count
        square_a += sums(x**2, on_b) - sum_x**2 / count
        square_b += sums(on_a, y**2) - sum_y**2 / count
    good = (common >= least) & (square_a > 1e-9 * (a**2).sum()) & (square_b > 1e-9 * (b**2).sum())
    require(good.any(), "readings and poses", OWNER, "moving", "a constant")
    r = np.where(good, product / np.sqrt(np.where(good, square_a * square_b, 1.0)), -1.0)
    slope = np.where(good, product / np.where(good, square_b, 1.0), 0.0)
    return Correlations(shifts * step_s, r, slope)


def check_peak(found: Correlations, robot: str) -> None:
    """Refuse a correlation without one clear peak inside of the search, and readings of another size.

    Raises
    ------
    InputError
        As said.
    """
    r, k = found.r, found.best
    best = f"r = {r[k]:.3f} at {found.lag_s[k]:+.3f} s"
    if r[k] < LEAST_R:
        expected = f"of one motion: readings that correlate by {LEAST_R:g} with those that {robot} predicts"
        raise bad_input("readings and poses", OWNER, expected, f"{best}, at best")
    if not 0 < k < len(r) - 1:
        expected = f"of clocks that differ by less than {found.lag_s[-1]:g} s (--longest-lag)"
        raise bad_input("readings and poses", OWNER, expected, f"{best}, at the end of the search")
    low = np.flatnonzero(r < r[k] - 2 * MARGIN)
    left, right = low[low < k].max(initial=-1), low[low > k].min(initial=len(r))
    others = np.concatenate([np.arange(left + 1), np.arange(right, len(r))])
    other = int(others[np.argmax(r[others])]) if others.size else k
    if other != k and r[other] > r[k] - MARGIN:
        expected = "alike at one lag only (a motion that repeats itself needs a smaller --longest-lag)"
        seen = f"{best}, and r = {r[other]:.3f} at {found.lag_s[other]:+.3f} s"
        raise bad_input("readings and poses", OWNER, expected, seen)
    if left < 0 and right == len(r):
        raise bad_input(
            "readings and poses", OWNER, "moving enough to show a lag", f"{best}, and no less at any"
        )
    if not _SLOPES[0] < found.slope[k] < _SLOPES[1]:
        expected = (
            f"readings that move {_SLOPES[0]:g} to {_SLOPES[1]:g} times as much as {robot} predicts (units?)"
        )
        raise bad_input("readings", OWNER, expected, f"{found.slope[k]:.3g} times as much")


def refined(readings: Samples, predicted: Samples, near_s: float) -> Lag:
    r"""Refine a lag to a fraction of a sample.

    What the shifted prediction leaves shall not correlate with the rate of the readings,
    :math:`\sum \dot u\,(u - g\,\hat u(t - \text{lag})) = 0`. Least squares would lock to samples: interpolation
    smooths the noise of the poses more the farther it is from one. In this sum that noise has mean zero. How fast it
    changes with the lag is :math:`\sum \dot u\,g\,\dot{\hat u}`, not :math:`\sum \dot u^2`, in which the noise of the
    readings may be the larger part.

    Raises
    ------
    InputError
        If too little is in common, nothing moves, or the lag is not near.
    """
    step_s = max(float(np.median(np.diff(s.time_s))) for s in (readings, predicted))
    reach = 2.0 * step_s
    shifted = [predicted.at(readings.time_s - near_s + shift) for shift in (-reach, reach)]
    rate = (readings.at(readings.time_s + step_s) - readings.at(readings.time_s - step_s)) / (2 * step_s)
    use = np.isfinite(np.concatenate([*shifted, rate], axis=1)).all(axis=1)
    time_s, u, rate = readings.time_s[use], readings.values[use], rate[use]
    predicted_rate = (shifted[1] - shifted[0])[use] / (2 * reach)
    require(len(u) >= 4 * _BLOCKS, "readings and poses", OWNER, f"at least {4 * _BLOCKS} in common", len(u))
    u = u - u.mean(axis=0)

    def fitted(shift: float) -> tuple[np.ndarray, np.ndarray]:
        """Prediction without its mean, and its gain for each sensor."""
        x = predicted.at(time_s - near_s - shift)
        x = x - x.mean(axis=0)
        return x, (u * x).sum(axis=0) / np.maximum((x**2).sum(axis=0), np.finfo(float).tiny)

    shift = 0.0
    for _ in range(_ITERATIONS):
        x, gain = fitted(shift)
        weight = max((rate * gain * predicted_rate).sum(), np.finfo(float).tiny)
        change = float((rate * (u - gain * x)).sum() / weight)
        shift = float(np.clip(shift - change, -reach, reach))
    if abs(shift) >= reach:
        expected = f"alike near the lag {near_s:+.3f} s"
        raise bad_input("readings and poses", OWNER, expected, "a correlation that rises away from there")
    x, gain = fitted(shift)
    left = u - gain * x
    error_s = _error_s(-left * rate, gain * predicted_rate * rate)
    r = float((gain * x * u).sum() / np.sqrt(((gain * x) ** 2).sum() * (u**2).sum()))
    common_s = float(len(u) * np.median(np.diff(readings.time_s)))
    return Lag(near_s + shift, error_s, r, float(np.sqrt((left**2).mean())), common_s)


def _error_s(left: np.ndarray, slope: np.ndarray) -> float:
    """Error of the lag [s], from the lag that each block of time asks for by itself.

    Of every time and sensor: what is left of the sum that shall vanish, and how fast that changes with the lag.
    """
    weight = np.maximum([part.sum() for part in np.array_split(slope, _BLOCKS)], np.finfo(float).tiny)
    own = np.array([part.sum() for part in np.array_split(left, _BLOCKS)]) / weight
    share = weight / weight.sum()
    rest = own - share @ own
    return float(np.sqrt((share**2 * rest**2).sum() * _BLOCKS / (_BLOCKS - 1)))
