"""How readings and a measured motion go together: the lag between their clocks, and the axes of the base."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy.fft import next_fast_len

from repro.common import Array, bad_input, numbers, require
from repro.robot import Robot
from repro.sensing import Sensing
from repro_board.cleaning import without_spikes

GAP_STEPS = 2.5
"""Longest gap over which is interpolated [usual steps]."""
_FEWEST, _MOST_ROWS = 5, 4000
"""Held poses that tell a lag, and rows that are used at most."""


class Lag(NamedTuple):
    """How well readings follow a motion as they are put together, and at the best of all lags."""

    lag_s: float
    """By how much later the readings are to be taken for the least residual [s]."""
    residual: float
    """Root mean square of what the motion leaves of the readings as they are, in their unit."""
    best: float
    """The same at the best lag."""
    spread: float
    """Root mean square of the readings about their means."""
    other: float
    """The least residual at any lag that is not next to the best one."""


def search_lag(motion: ArrayLike, readings: ArrayLike, rate_hz: float, longest_s: float = math.inf) -> Lag:
    """Find the lag between readings and a motion, over the whole recording.

    The readings of an instant are a smooth function of the shape. So we fit them by a quadratic function of the
    motion at every lag of up to half the recording in either direction, each time over all frames that both have, and
    take the lag with the least residual. Sums over frames are products of Fourier transforms, so all lags together
    cost little more than one. A frame without a pose or with a missing reading counts nowhere.

    A motion that repeats itself without end has many lags that are equally good; then the smallest one is returned.

    Parameters
    ----------
    motion
        Coordinates ``[t, m]`` that motion capture gives, NaN where it is lost.
    readings
        Readings ``[t, s]`` of the same frames, if there is no lag; NaN where one is missing.
    rate_hz
        Frames per second.
    longest_s
        Largest lag that is tried [s].

    Raises
    ------
    InputError
        If there are not as many readings as poses, less than two seconds of them, or at no lag enough of both.

    Examples
    --------
    Readings that were taken half a second too early:

    >>> t = np.arange(4000) / 40
    >>> q = np.stack([np.sin(t), np.sin(1.7 * t + 0.3)], axis=-1)
    >>> u = np.roll(q @ [[30.0, 5.0], [-8.0, 20.0]], 20, axis=0)
    >>> search_lag(q[20:], u[20:], rate_hz=40).lag_s
    0.5
    """
    owner = "search_lag"
    q = numbers(motion, "motion", owner, (None, None), finite=False)
    u = numbers(readings, "readings", owner, (None, None), finite=False)
    n = len(q)
    require(len(u) == n, "readings", owner, f"one row for each of {n} poses", f"{len(u)} rows")
    require(n >= 2 * rate_hz, "motion", owner, "two seconds long or more", f"{n / rate_hz:g} s")
    seen, read = (np.asarray(np.isfinite(x).all(axis=1)) for x in (q, u))
    for name, there in (("motion", seen), ("readings", read)):
        gone = int((~there).sum())
        require(there.sum() > n / 2, name, owner, "there in most frames", f"{gone} of {n} missing")
    most = int(min(n // 2, longest_s * rate_hz))
    v, lags = (u - u[read].mean(axis=0)).T, np.arange(-most, most + 1)
    v[:, ~read] = 0.0
    residual = _residuals(_quadratic(q, seen), v, read, lags)
    least = float(residual.min())
    must = "there together at some lag"
    require(math.isfinite(least), "motion and readings", owner, must, "too few frames")
    equal = np.flatnonzero(residual <= least * (1 + 1e-6))
    best = int(equal[np.argmin(np.abs(lags[equal]))])
    spread = float(np.sqrt((v[:, read] ** 2).mean()))
    other = _elsewhere(residual, best, least + 0.2 * max(spread - least, 0.0))
    return Lag(float(lags[best] / rate_hz), float(residual[most]), float(residual[best]), spread, other)


def _quadratic(q: Array, seen: Array) -> Array:
    """Return a constant, the coordinates and their products ``[k, t]``, zero where a pose is not seen."""
    x = ((q - q[seen].mean(axis=0)) / np.maximum(q[seen].std(axis=0), 1e-12)).T
    x[:, ~seen] = 0.0
    low, up = np.triu_indices(len(x))
    return np.vstack([seen, x, x[low] * x[up]])


def _residuals(columns: Array, v: Array, read: Array, lags: Array) -> Array:
    """Return what columns ``[k, t]`` leave of readings ``[s, t]`` at every lag, root mean square.

    It is infinite where too few frames are left: a few fit any function.
    """
    k, n = columns.shape
    size, (i, j) = next_fast_len(2 * n, real=True), np.triu_indices(k)
    of_read, of_v = np.fft.rfft(read, size), np.fft.rfft(v, size)

    def sums(series: Array, spectrum: Array) -> Array:
        """Sum over t of the series at t times readings at t + lag, for every lag."""
        return np.fft.irfft(np.fft.rfft(series, size).conj() * spectrum, size)[..., lags]

    A, b = np.empty((k, k, len(lags))), sums(columns, of_v[:, None])
    A[i, j] = A[j, i] = sums(columns[i] * columns[j], of_read)
    total = sums(columns[0], np.fft.rfft((v**2).sum(axis=0), size))
    count = A[0, 0].copy()
    A[range(k), range(k)] += 1e-9 * count  # for a coordinate that hardly moves
    fitted = np.linalg.solve(np.moveaxis(A, -1, 0), np.moveaxis(b, -1, 0).swapaxes(1, 2))
    left = total - np.einsum("skl,lks->l", b, fitted)
    residual = np.sqrt(np.maximum(left, 0.0) / np.maximum(len(v) * count, 1.0))
    return np.where(count > max(2 * k, n / 8), residual, math.inf)


def _elsewhere(residual: Array, best: int, limit: float) -> float:
    """Return the least residual beyond the lags about the best one, between which it stays below a limit."""
    high = np.flatnonzero(residual > limit)
    first, last = high[high < best].max(initial=-1), high[high > best].min(initial=len(residual))
    apart = np.concatenate([residual[: first + 1], residual[last:]])
    return float(apart.min(initial=math.inf if len(high) else residual.min()))


class Signal(NamedTuple):
    """Values over time ``[t, k]``; between two samples that are farther apart than ``gap`` nothing is known."""

    times: Array
    values: Array
    gap: float

    @classmethod
    def of(cls, times: Array, values: Array) -> Signal:
        """Leave out rows that are not complete."""
        there = np.isfinite(values).all(1)
        return cls(times[there], values[there], GAP_STEPS * float(np.median(np.diff(times))))

    def at(self, when: Array) -> Array:
        """Return values ``[len(when), k]``, linearly between samples; NaN in gaps."""
        t = self.times
        after = np.clip(np.searchsorted(t, when), 1, len(t) - 1)
        near = (when >= t[0]) & (when <= t[-1]) & (t[after] - t[after - 1] <= self.gap)
        found = np.stack([np.interp(when, t, column) for column in self.values.T], axis=-1)
        return np.where(near[:, None], found, np.nan)


def clock_lag(motion: Signal, readings: Signal, longest_s: float, noise: Array) -> float:
    """Return by how much the readings are later than the motion [s], to a sample, or refuse what is no one motion.

    Readings that hardly vary beyond their noise tell nothing, such as those of an IMU on the base.
    """
    owner = "repro evaluate"
    start, end = max(motion.times[0], readings.times[0]), min(motion.times[-1], readings.times[-1])
    columns = (motion.values.shape[1] + 1) * (motion.values.shape[1] + 2) / 2
    step = max(min(motion.gap, readings.gap) / GAP_STEPS, (end - start) * columns**2 / 1e7)
    when = np.arange(start, end, step)
    spread = np.nanstd(readings.values, axis=0).clip(1e-12)
    tells = spread > 2 * noise
    tells |= not tells.any()
    u = (readings.at(when) / spread)[:, tells]
    found = search_lag(motion.at(when), u, 1 / step, longest_s)
    best = f"{found.best / found.spread:.0%} of the readings unexplained at {found.lag_s:+.3f} s"
    require(found.best < 0.5 * found.spread, "readings and poses", owner, "of one motion", f"{best}, at best")
    longest = min(longest_s, (end - start) / 2)
    inside = abs(found.lag_s) < longest - 2 * step
    if longest < longest_s and not inside:
        expected = f"together for {2 * longest_s:g} s, to find the lag between their clocks (--longest-lag)"
        raise bad_input("readings and poses", owner, expected, f"{end - start:.3g} s")
    expected = f"of clocks that differ by less than {longest_s:g} s (--longest-lag)"
    require(inside, "readings and poses", owner, expected, f"{best}, at the end of the search")
    expected = "alike at one lag only (a motion that repeats itself needs a smaller --longest-lag)"
    require(
        found.other > 1.1 * found.best, "readings and poses", owner, expected, f"{best}, and elsewhere too"
    )
    return found.lag_s


def fine_lag(sensing: Sensing, motion: Signal, t: Array, u: Array, near: float) -> tuple[float, float]:
    """Return the lag at which a calibrated robot predicts the readings best, and its standard deviation [s].

    Twelve blocks of time, which tell equally much, have a lag each; the median hardly moves with a bad one.
    """
    h, scale, shifts = 2 * motion.gap / GAP_STEPS, 1 / np.nanstd(u, axis=0).clip(1e-12), np.zeros(1)
    for _ in range(20):
        rows = [u, *(motion.at(t - near + x) for x in (0.0, h, -h))]
        use = np.isfinite(np.concatenate(rows, axis=1)).all(1)
        require(
            use.sum() >= 48, "readings and poses", "repro evaluate", "in 48 rows together", int(use.sum())
        )
        v, ahead, behind = (sensing(q[use]) for q in rows[1:])
        r = sensing.difference(u[use], v)
        r, rate = scale * (r - r.mean(0)), scale * sensing.difference(ahead, behind) / (2 * h)
        told = np.cumsum(np.square(rate).sum(1))
        edges = np.searchsorted(told, told[-1] * np.arange(1, 12) / 12)
        blocks = zip(np.split(r, edges), np.split(rate, edges), strict=True)
        shifts = np.array([-(a * b).sum() / max((b * b).sum(), 1e-300) for a, b in blocks])
        near += float(np.median(shifts))
        if abs(np.median(shifts)) < 1e-6:
            break
    require(math.isfinite(near), "lag", "repro evaluate", "finite", near)
    return near, float(1.2533 * shifts.std() / math.sqrt(12))


def held_lag(robot: Robot, q: Array, windows: Array, t: Array, u: Array, remarks: list[str]) -> float:
    """Return by how much held poses are later by the clock of the readings [s]; zero where that goes as well."""
    n, whole = robot.n_magnetic, np.isfinite(np.hstack([q, windows])).all(axis=1)
    if whole.sum() < _FEWEST or not n or len(t) < 2:
        return 0.0
    drawn, windows = robot.sensing()(q[whole])[:, :n], windows[whole]
    x = np.insert(without_spikes(robot, q, u, t, [])[:, :n], 0, 1.0, axis=1)
    sums = np.cumsum(np.where(np.isfinite(x).all(axis=1, keepdims=True), x, 0.0), axis=0)
    sums, edges = np.concatenate([np.zeros((1, n + 1)), sums]), windows.T + np.array([[-1e-9], [1e-9]])

    def left(lag: float) -> float:
        first, last = (np.searchsorted(t, end + lag) for end in edges)
        total = sums[last] - sums[first]
        return unexplained(total[:, 1:] / total[:, :1], drawn) if total[:, 0].all() else math.inf

    length = float(np.median(np.diff(windows)))
    ends = t[0] - windows[:, 0].min() - length / 2, t[-1] - windows[:, 1].max() + length / 2
    lags = np.arange(*ends, max(float(np.median(np.diff(t))), length / 20))
    shares, given = np.array([left(lag) for lag in lags] or [math.inf]), left(0.0)
    least, far = shares.min(), np.flatnonzero(shares > 2 * shares.min())
    k = int(shares.argmin())
    good = slice(far[far < k].max(initial=-1) + 1, far[far > k].min(initial=len(lags)))
    lag = float(lags[good][[0, -1]].mean()) if least < 0.25 else 0.0  # in the middle of the hold
    other = shares[np.abs(lags - lag) > length].min(initial=math.inf) if lag else 0.0
    if given <= 2 * least + 0.005 or other < 2 * least:
        return 0.0
    words = f"{least:.0%} of the readings unexplained, {min(given, 1.0):.0%} as given"
    remarks.append(f"Lag: {lag:+.2f} s to be added to the times of the poses: {words}.")
    return lag


def unexplained(u: Array, drawn: Array) -> float:
    """Return the share of readings ``[t, s]`` that those of the robot as described leave, by a line each."""
    v, w = (x - x.mean(0) for x in (u, drawn))
    cosine = (v * w).sum(0) / np.sqrt(np.square(v).sum(0) * np.square(w).sum(0)).clip(1e-300)
    return float(1 - np.square(cosine.clip(0)).mean())


def in_axes_of_the_readings(
    robot: Robot, q: Array, turned: Mapping[int, Array], u: Array, lines: list[str]
) -> Array:
    """Return poses ``[t, n_q]`` by the axes of the base that the readings ``u`` ``[t, s]`` of their times show.

    Bodies do not tell how the base is turned about a straight robot: we predict the readings for every turn.
    """
    n, ways = robot.n_magnetic, {0: q, **turned}
    use = np.flatnonzero(np.isfinite(np.concatenate([q, u[:, :n]], axis=1)).all(1))
    use = use[:: 1 + len(use) // _MOST_ROWS]
    left = {k: unexplained(u[use, :n], robot.sensing()(x[use])[:, :n]) for k, x in ways.items() if n}
    angle = min(left, key=lambda k: left[k], default=0)
    if angle and left[angle] < left[0] / 2:
        shares = f"{left[angle]:.0%} of the readings unexplained, {left[0]:.0%} otherwise"
        lines.append(f"The base is taken as turned by {angle} deg about the straight robot: {shares}.")
        return np.where(np.isnan(q), np.nan, ways[angle])
    return q
