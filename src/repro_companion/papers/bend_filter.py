"""Our filter for the rig of Table 2: it needs no true start, no elongation and no step size.

Thin plates through the readings of T5.train predict the readings of a bend. A Kalman filter follows the bend, with
errors of the prediction that persist for a while. Every recording has a bias that its sensors share, so one filter
runs for each of several biases, and they are weighed by how well they predict the readings. Where their mean cannot
explain the readings any more, the filters begin anew.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from repro import Drift, Drifting, KalmanFilter
from repro.estimators.kalman import KalmanState
from repro_companion.papers.rig import RATE_HZ, SENSORS, Recording

CELL_MM, FEWEST, SMOOTHING = 1.5, 10, 1.0
"""The plates rest on means over square cells that hold so many frames at least; how far they may miss these means."""
BIASES = np.arange(-10.0, 11.0, 2.0)[:, None]
BIAS_MV = 4.0
"""Biases of the filters, and the standard deviation of a bias before the first reading [mV]."""
LOST, LASTING = 4.0, 20
"""A filter is lost if the readings are off by so many times what the map leaves of T5.train, for so many frames."""


class ThinPlates:
    """Readings [mV] as thin plates over the bend [mm], one for each sensor: smooth inside, flat far outside."""

    def __init__(self, bend: np.ndarray, u: np.ndarray) -> None:
        cells = np.floor(bend / CELL_MM).astype(int)
        _, cell, frames = np.unique(cells, axis=0, return_inverse=True, return_counts=True)
        columns = [np.bincount(cell.ravel(), column) / frames for column in (*bend.T, *u.T)]
        means = np.column_stack(columns)[frames >= FEWEST]
        self.centres, at_centres = means[:, :2], means[:, 2:]
        plates = self._plates(self.centres)[0] + SMOOTHING * np.eye(len(means))
        plane = np.column_stack([np.ones(len(means)), self.centres])
        system = np.block([[plates, plane], [plane.T, np.zeros((3, 3))]])
        weights = np.linalg.solve(system, np.vstack([at_centres, np.zeros((3, u.shape[1]))]))
        self.weights, self.level, self.tilt = weights[:-3], weights[-3], weights[-2:]

    def _plates(self, bend: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return plates ``r² log r`` of all centres and their slopes by the bend."""
        apart = bend[..., None, :] - self.centres
        square = np.maximum((apart**2).sum(axis=-1), 1e-12)
        return square * np.log(square) / 2, (np.log(square) + 1)[..., None] * apart

    def __call__(self, bend: np.ndarray) -> np.ndarray:
        """Return readings ``[..., s]`` at bends ``[..., 2]``."""
        return self.linearise(bend)[0]

    def linearise(self, bend: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return readings ``[..., s]`` and their slopes ``[..., s, 2]``."""
        plates, slopes = self._plates(bend)
        u = plates @ self.weights + self.level + bend @ self.tilt
        by_bend = np.swapaxes(slopes, -1, -2) @ self.weights + self.tilt
        return u, np.swapaxes(by_bend, -1, -2)


class Bend(NamedTuple):
    """Bends of trajectories at some time or at all times, with their covariances."""

    mean: np.ndarray
    """``[..., trajectory, 2]`` [mm]."""
    covariance: np.ndarray
    residual: np.ndarray
    """What the mean leaves of the readings, in units of what the map leaves of T5.train ``[..., trajectory]``."""
    doubtful: np.ndarray | None = None
    """Whether the filters are lost ``[..., trajectory]``."""
    begun: np.ndarray | None = None
    """How often they began anew ``[trajectory]``."""


def weighed_step(
    kalman: KalmanFilter, state: KalmanState, log_weight: np.ndarray, u: np.ndarray, t: float
) -> tuple[KalmanState, np.ndarray, np.ndarray, np.ndarray]:
    """Take readings ``[..., filter, s]`` in; return state, weights, means and covariances of the filters.

    A filter counts by the probability that it gave to all readings so far. Laplace's approximation of it needs what
    the estimate has at hand: chi-square at the maximum of the posterior, and how far the reading has shrunk the
    covariance.
    """
    n = kalman.n_q + len(kalman.drift_names)
    before = kalman.predicted(state, t).covariance[..., :n, :n]
    state, estimate = kalman.step(state, u, t)
    after = state.covariance[..., :n, :n]
    shrunk = np.linalg.slogdet(before)[1] - np.linalg.slogdet(after)[1]
    log_weight = log_weight - (estimate.chi2 + shrunk) / 2
    return state, log_weight - log_weight.max(axis=-1, keepdims=True), estimate.q, estimate.covariance


class BendFilter:
    """Filters of all biases; with ``own_biases`` every sensor has one more, about as large as errors in T5.train."""

    def __init__(self, train: Recording, own_biases: bool = False, restarts: bool = True) -> None:
        bend = 1e3 * train.q[:, :2]
        self.map, self.restarts, self.own_biases = ThinPlates(bend, train.u), restarts, own_biases
        self.starts = bend[::100]
        left = train.u - self.map(bend)
        self.unit = left.std(axis=0)
        white = np.diff(left, axis=0).std(axis=0) / 2**0.5
        slow = np.sqrt(np.maximum(self.unit**2 - white**2, 0.0))
        drifts = [_fading(left, float(np.sqrt((slow**2).mean())))]
        if own_biases:
            drifts.append(Drift("offset", start=float(np.sqrt((self.unit**2).mean()))))
        rate = 2 * (bend[20:] - bend[:-20])  # [mm/s]
        change = (rate[20:] - rate[:-20]).std(axis=0) / 0.5**0.5
        low, high, model = bend.min(axis=0) - 2, bend.max(axis=0) + 2, Drifting(self.map, drifts)
        self.kalman = KalmanFilter(model, low, high, white, change, rate.std(axis=0), iterations=5)

    def begin(self, u: np.ndarray) -> tuple[KalmanState, np.ndarray]:
        """Return states at the bends of T5.train that explain readings ``[trajectory, s]`` best, and weights."""
        off = (u[:, None, None] - BIASES[:, None] - self.map(self.starts)) / self.unit
        best = (off**2).sum(axis=-1).argmin(axis=-1)
        return self.kalman.init(self.starts[best]), np.tile(-0.5 * (BIASES[:, 0] / BIAS_MV) ** 2, (len(u), 1))

    def step(
        self, state: KalmanState, log_weight: np.ndarray, u: np.ndarray, t: float
    ) -> tuple[KalmanState, np.ndarray, Bend]:
        """Take readings ``[trajectory, s]`` in; the bend is the mean over the filters."""
        state, log_weight, q, C = weighed_step(self.kalman, state, log_weight, u[:, None] - BIASES, t)
        weight = np.exp(log_weight)[..., None]
        weight /= weight.sum(axis=1, keepdims=True)
        mean, bias = (weight * q).sum(axis=1), (weight * BIASES).sum(axis=1)
        if self.own_biases:
            bias = bias + (weight * state.q[..., 2 + SENSORS :]).sum(axis=1)
        off = (q - mean[:, None])[..., None]
        covariance = (weight[..., None] * (C + off * np.swapaxes(off, -1, -2))).sum(axis=1)
        left = (u - self.map(mean) - bias) / self.unit
        return state, log_weight, Bend(mean, covariance, np.sqrt((left**2).mean(axis=-1)))

    def follow(self, u: np.ndarray) -> Bend:
        """Return the bends for readings ``[t, trajectory, s]`` [mV].

        Lost filters of a trajectory give way to others that begin with the last frames, if these halve the residual.
        """
        n = u.shape[1]
        doubtful, begun = np.zeros(u.shape[:2], bool), np.zeros(n, int)
        whole = Bend(*(np.empty((*u.shape[:2], *shape)) for shape in ((2,), (2, 2), ())), doubtful, begun)
        state, log_weight = self.begin(u[0])
        lasting = np.zeros(n, dtype=int)
        for k, u_k in enumerate(u):
            state, log_weight, now = self.step(state, log_weight, u_k, k / RATE_HZ)
            lasting = np.where(now.residual > LOST, lasting + 1, 0)
            due = np.flatnonzero((lasting > 0) & (lasting % LASTING == 0)) if self.restarts else []
            for i in due:
                recent = slice(k - LASTING + 1, k)
                other, weight, again, residuals = self._anew(u[recent.start : k + 1, i : i + 1], recent.start)
                before = np.append(whole.residual[recent, i], now.residual[i])
                if (residuals**2).mean() < (before**2).mean() / 4:
                    for own, new in zip(
                        (*state[:3], log_weight, *now[:3]), (*other[:3], weight, *again[:3]), strict=True
                    ):
                        own[i] = new[0]
                    lasting[i], begun[i] = 0, begun[i] + 1
            for of_all, of_now in zip((*whole[:3], doubtful), (*now[:3], lasting >= LASTING), strict=True):
                of_all[k] = of_now
        return whole

    def _anew(self, u: np.ndarray, first: int) -> tuple[KalmanState, np.ndarray, Bend, np.ndarray]:
        """Begin with readings ``[t, 1, s]`` from a frame on; return where that ends, and all residuals."""
        state, log_weight, now = self.step(*self.begin(u[0]), u[0], first / RATE_HZ)
        residuals = [now.residual[0]]
        for k, u_k in enumerate(u[1:], first + 1):
            state, log_weight, now = self.step(state, log_weight, u_k, k / RATE_HZ)
            residuals.append(now.residual[0])
        return state, log_weight, now, np.array(residuals)


def _fading(left: np.ndarray, deviation: float) -> Drift:
    """Return errors of so much, which fade as fast as what the map leaves ``[t, s]``: to 1/e in that time."""
    lags = np.arange(1, min(200, len(left)))
    like = np.array([(left[lag:] * left[:-lag]).mean() for lag in lags]) / max(deviation**2, 1e-12)
    fade = lags[np.argmax(like < np.exp(-1))] / RATE_HZ
    return Drift("offset", start=deviation, walk=deviation * (2 / fade) ** 0.5, time_s=fade)
