r"""Rauch-Tung-Striebel smoothing: what later readings say about earlier states, for every Kalman-type estimator.

With the state :math:`x_k, P_k` after its own readings, the transition :math:`F` to the next one and
:math:`P^-_{k+1} = F P_k F^T + Q`,

.. math:: G = P_k F^T (P^-_{k+1})^{-1}, \qquad \hat x_k = x_k + G\,(\hat x_{k+1} - F x_k), \qquad
   \hat P_k = P_k + G\,(\hat P_{k+1} - P^-_{k+1})\,G^T,

from the last state backwards (Särkkä and Svensson 2023, Bayesian Filtering and Smoothing, 2nd ed., section 12.2). For
a linear model this is the posterior given all readings. A state without readings of its own, as ``predicted`` gives
it, is smoothed like any other: so a smoothed estimate can be had at any time.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Protocol, runtime_checkable

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from edition1.errors import bad_input, require
from edition1.estimation.base import Estimate, Trajectory, stacked
from edition1.estimation.kalman_filter import KalmanState


@runtime_checkable
class KalmanType(Protocol):
    """A filter whose states move linearly between readings."""

    def init(self, q0: Tensor, *, seed: int = 0) -> KalmanState:
        """State before the first step."""
        ...

    def step(
        self, state: KalmanState, u: Tensor, t: float, *, mask: Tensor | None = None
    ) -> tuple[KalmanState, Estimate]:
        """Predict to ``t`` and take in ``u``."""
        ...

    def predicted(self, state: KalmanState, t: float) -> KalmanState:
        """State carried to ``t`` without a reading."""
        ...

    def motion(self, tau: float) -> tuple[Tensor, Tensor]:
        """Transition of configuration and velocity over ``tau`` [s], and the covariance that it adds."""
        ...


def smoothed(
    method: KalmanType, states: Sequence[KalmanState], *, lag_s: float = math.inf
) -> list[KalmanState]:
    """States given later readings as well.

    Parameters
    ----------
    method
        The filter that the states are of.
    states
        After a step, or ``predicted``, in the order of time.
    lag_s
        How far ahead readings count [s]: all of them if infinite, else those within this time after each state, as
        they are known to somebody who waits that long.

    Raises
    ------
    InputError
        If there is no state, one has no time, they are not in order, or the lag is negative.
    """
    if not states or any(state.t is None for state in states):
        raise bad_input("states", "smoothed", "at least one, each after a step", f"{len(states)} states")
    require(lag_s >= 0, "lag_s", "smoothed", "not negative [s]", lag_s)
    t = np.array([state.t for state in states])
    if (np.diff(t) < 0).any():
        k = int((np.diff(t) < 0).argmax())
        raise bad_input("states", "smoothed", "in the order of time", f"{t[k + 1]} s after {t[k]} s")
    x = np.stack([torch.cat([state.q, state.velocity], -1).double().numpy() for state in states])
    P = np.stack([state.covariance.double().numpy() for state in states])
    links = [_link(method, x[k], P[k], t[k + 1] - t[k]) for k in range(len(t) - 1)]
    if math.isinf(lag_s):
        for k in reversed(range(len(t) - 1)):
            x[k], P[k] = _given_next(links[k], x[k], P[k], x[k + 1], P[k + 1])
        return [_state(states[k], x[k], P[k]) for k in range(len(t))]
    out = []
    for k in range(len(t)):
        last = int(np.searchsorted(t, t[k] + lag_s, side="right")) - 1
        mean, cov = x[last], P[last]
        for j in reversed(range(k, last)):
            mean, cov = _given_next(links[j], x[j], P[j], mean, cov)
        out.append(_state(states[k], mean, cov))
    return out


_Link = tuple[np.ndarray, np.ndarray, np.ndarray]


def _link(method: KalmanType, x: np.ndarray, P: np.ndarray, tau: float) -> _Link:
    """Gain, and mean and covariance that the next state had before its readings."""
    move, noise = (y.double().numpy() for y in method.motion(tau))
    cross = move @ P
    before = cross @ move.T + noise
    # Scaled to a unit diagonal, as positions and velocities differ by orders; a state without variance has no gain.
    spread = np.sqrt(np.diagonal(before, axis1=-2, axis2=-1))
    scale = np.divide(1.0, spread, out=np.zeros_like(spread), where=spread > 0)
    scaled = before * scale[..., :, None] * scale[..., None, :]
    empty = (scale == 0)[..., None] * np.eye(scale.shape[-1])
    gain = np.linalg.solve(scaled + empty, cross * scale[..., :, None]) * scale[..., :, None]
    return gain.swapaxes(-1, -2), (move @ x[..., None])[..., 0], before


def _given_next(
    link: _Link, x: np.ndarray, P: np.ndarray, x_next: np.ndarray, P_next: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    gain, mean, before = link
    x = x + (gain @ (x_next - mean)[..., None])[..., 0]
    return x, P + gain @ (P_next - before) @ gain.swapaxes(-1, -2)


def _state(like: KalmanState, x: np.ndarray, P: np.ndarray) -> KalmanState:
    m = like.q.shape[-1]
    q, velocity = (torch.from_numpy(y.copy()).to(like.q) for y in (x[..., :m], x[..., m:]))
    return KalmanState(q, velocity, torch.from_numpy(P.copy()).to(like.covariance), like.t)


def smooth(
    method: KalmanType,
    readings: Float[Tensor, "t *batch s"],
    q0: Float[Tensor, "*batch n_q"],
    times_s: Sequence[float],
    *,
    lag_s: float = math.inf,
) -> Trajectory:
    """Run a filter over recorded readings, then backwards: the sibling of :func:`~edition1.estimation.base.track`.

    The predicted readings and the diagnostics are those of the filter.

    Parameters
    ----------
    method
        A Kalman-type estimator.
    readings
        One row per time step, NaN where a sensor was not read.
    q0
        Where the filter starts.
    times_s
        Time of each row [s], increasing.
    lag_s
        As in :func:`smoothed`.

    Raises
    ------
    InputError
        If there is not one time for each row, the filter has no ``motion``, or as its ``step``.

    Examples
    --------
    A coordinate read without error at both ends of a second was halfway in its middle:

    >>> from edition1.estimation.kalman_filter import IteratedKalmanFilter
    >>> one = torch.ones(1, dtype=torch.float64)
    >>> def both(q):
    ...     return torch.cat([q, 0 * q], -1)
    >>> method = IteratedKalmanFilter(both, -9 * one, 9 * one, one, 100 * one, noise_mt=1e-4)
    >>> u = torch.tensor([[0.0, torch.nan], [torch.nan, 0.0], [1.0, torch.nan]], dtype=torch.float64)
    >>> smooth(method, u, 0 * one, [0.0, 0.5, 1.0]).q.flatten().round(decimals=3)
    tensor([0.0000, 0.5000, 1.0000], dtype=torch.float64)
    """
    if not len(readings) or len(times_s) != len(readings):
        raise bad_input(
            "times_s", "smooth", f"one for each of {len(readings)} rows, at least one", len(times_s)
        )
    if not isinstance(method, KalmanType):
        raise bad_input("method", "smooth", "a filter that says how its state moves", type(method).__name__)
    state, states, estimates = method.init(q0), [], []
    for u, t in zip(readings, times_s, strict=True):
        state, estimate = method.step(state, u, float(t))
        states.append(state)
        estimates.append(estimate)
    found = stacked(estimates)
    n = found.q.shape[-1]
    back = smoothed(method, states, lag_s=lag_s)
    q, P = torch.stack([s.q[..., :n] for s in back]), torch.stack([s.covariance[..., :n, :n] for s in back])
    return Trajectory(q, P.to(q), found.u_hat, found.diagnostics)
