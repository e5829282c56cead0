"""Estimates against motion capture: whether readings and poses are of one time."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from scipy.fft import next_fast_len

from repro.common import Array, numbers, require


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


def search_lag(motion: Any, readings: Any, rate_hz: float) -> Lag:
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

    Raises
    ------
    InputError
        If there are not as many readings as poses, or less than two seconds of them.

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
    q, u = (
        numbers(motion, "motion", owner, (None, None), finite=False),
        numbers(readings, "readings", owner, (None, None), finite=False),
    )
    n = len(q)
    require(len(u) == n, "readings", owner, f"one row for each of {n} poses", f"{len(u)} rows")
    require(n >= 2 * rate_hz, "motion", owner, "two seconds long or more", f"{n / rate_hz:g} s")
    seen, read = (np.asarray(np.isfinite(x).all(axis=1)) for x in (q, u))
    for name, there in (("motion", seen), ("readings", read)):
        require(
            there.sum() > n / 2, name, owner, "there in most frames", f"{int((~there).sum())} of {n} missing"
        )
    x = ((q - q[seen].mean(axis=0)) / np.maximum(q[seen].std(axis=0), 1e-12)).T
    v = (u - u[read].mean(axis=0)).T
    x[:, ~seen], v[:, ~read] = 0.0, 0.0
    low, up = np.triu_indices(len(x))
    columns = np.vstack([seen, x, x[low] * x[up]])
    i, j = np.triu_indices(len(columns))
    size, lags = next_fast_len(2 * n, real=True), np.arange(-(n // 2), n // 2 + 1)
    of_read, of_v = np.fft.rfft(read, size), np.fft.rfft(v, size)

    def sums(series: Array, spectrum: Array) -> Array:
        """Sum over t of the series at t times readings at t + lag, for every lag."""
        return np.fft.irfft(np.fft.rfft(series, size).conj() * spectrum, size)[..., lags]

    k = len(columns)
    A, b = np.empty((k, k, len(lags))), sums(columns, of_v[:, None])
    A[i, j] = A[j, i] = sums(columns[i] * columns[j], of_read)
    total = sums(seen, np.fft.rfft((v**2).sum(axis=0), size))
    count = A[0, 0].copy()
    A[range(k), range(k)] += 1e-9 * count  # for a coordinate that hardly moves
    fitted = np.linalg.solve(np.moveaxis(A, -1, 0), np.moveaxis(b, -1, 0).swapaxes(1, 2))
    left = total - np.einsum("skl,lks->l", b, fitted)
    residual = np.sqrt(np.maximum(left, 0.0) / np.maximum(len(v) * count, 1.0))
    equal = np.flatnonzero(residual <= residual.min() * (1 + 1e-6))
    best = int(equal[np.argmin(np.abs(lags[equal]))])
    spread = float(np.sqrt((v[:, read] ** 2).mean()))
    return Lag(float(lags[best] / rate_hz), float(residual[n // 2]), float(residual[best]), spread)
