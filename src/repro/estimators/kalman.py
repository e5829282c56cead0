r"""Iterated extended Kalman filter with a constant-velocity prior, and the smoother.

The state is :math:`(q, \dot q)`. White acceleration of density :math:`a^2` drives every coordinate, so over
:math:`\tau` its covariance grows by :math:`a^2 [[\tau^3/3, \tau^2/2], [\tau^2/2, \tau]]`. The readings depend on
:math:`q` alone. The update is therefore the maximum of the posterior of :math:`q`,

.. math:: \min_q \|u - h(q)\|^2/\sigma^2 + (q - q^-)^T (P^-_{qq})^{-1} (q - q^-),

which Levenberg-Marquardt finds within the bounds; the velocity follows by regression on :math:`q`. For a linear
:math:`h` without active bounds this is the Kalman filter.
"""

from __future__ import annotations

import copy
import math
from collections.abc import Sequence
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from repro.angles import FreeAngles
from repro.common import Array, bad_input, kernel, numbers, require
from repro.estimators.base import (
    Estimate,
    Tuned,
    batch_of,
    described,
    in_line,
    incoming,
    known_coordinates,
    parts_of,
    spread,
    start,
)
from repro.estimators.drift import Drifting, DriftModel
from repro.estimators.least_squares import (
    BOUND,
    CHI2,
    MISSING,
    TURN,
    USED,
    LevenbergMarquardt,
    cholesky,
    solve,
)


class KalmanState(NamedTuple):
    """What a Kalman or rod filter knows at a time.

    Parameters
    ----------
    q
        Configuration, then errors of sensors, which have no velocity ``[..., n_q + k]``.
    velocity
        Velocities of the configuration ``[..., n_q]`` [unit/s].
    covariance
        Covariance of both, ``q`` first ``[..., 2 n_q + k, 2 n_q + k]``.
    t
        Their time [s]; ``None`` before the first step.
    """

    q: Array
    velocity: Array
    covariance: Array
    t: float | None = None


_NO_LIMITS = np.empty((2, 0))
_MOTIONS = 64
"""So many transitions are remembered: equal steps of a clock differ by rounding."""


class MotionModel(Tuned):
    """What filters with a motion model share: ``motion(tau)`` gives the transition and the noise that it adds."""

    needs_time = True
    angles: FreeAngles

    @cached_property
    def _motions(self) -> dict[float, tuple[Array, Array]]:
        return {}

    def motion(self, tau: float) -> tuple[Array, Array]:
        """Return the transition of ``(q, velocity)`` over a time [s], and the covariance that noise adds."""
        raise NotImplementedError

    def predicted(self, state: KalmanState, t: float) -> KalmanState:
        """Return the state carried to a time ``t`` [s] without a reading.

        Raises
        ------
        InputError
            If ``t`` is before the time of the state.
        """
        if state.t is None:
            return state._replace(t=t)
        if not t >= state.t:
            raise bad_input("t", type(self).__name__, f"not before the last step, {state.t} s", t)
        batch, n = state.q.shape[:-1], state.q.shape[-1]
        x, P, *_ = self.carried(state, t, batch)
        return KalmanState(x[..., :n], x[..., n:], P, t)

    def carried(
        self, state: KalmanState, t: float, batch: tuple[int, ...], limits: Array = _NO_LIMITS
    ) -> tuple[Array, Array, Array, Array, bool]:
        """Return mean and covariance of a batch at a later time [s], as the fit of their first coordinates starts.

        With the limits ``[2, n]`` of these coordinates that is their mean within the limits, their information, and
        whether one of them is certain.
        """
        tau = 0.0 if state.t is None else t - state.t
        if tau not in self._motions:
            if len(self._motions) >= _MOTIONS:
                self._motions.clear()
            self._motions[tau] = self.motion(tau)
        (F, Q), n = self._motions[tau], limits.shape[1]
        m = len(F)
        x, P = (
            spread(np.concatenate([state.q, state.velocity], axis=-1), (*batch, m)),
            spread(state.covariance, (*batch, m, m)),
        )
        start, information = np.empty((*batch, n)), np.empty((*batch, n, n))
        certain = _predict(F, Q, limits, *in_line(batch, x, P, start, information))
        return x, P, start, information, certain

    def near(self, state: KalmanState, reference: Array) -> KalmanState:
        """Return the same state with angles next to those of a reference ``[..., n_q]``."""
        return state

    def wrapped(self, state: KalmanState) -> KalmanState:
        """Return the same state with angles within their bounds."""
        return state

    def by_bounds(self, C: Array) -> Array:
        """Return covariances ``[..., n_q, n_q]`` that leave no direction more open than bounds do."""
        return C


class KalmanFilter(MotionModel):
    r"""Estimator that weighs the readings against a prediction at constant velocity.

    The readings' errors are taken for white noise. Errors that last are states of their own: give a
    :class:`repro.Drifting` as the sensor model, and their estimates stand in the details.

    Parameters
    ----------
    sensing
        A robot, or configuration to readings, as for :class:`repro.LevenbergMarquardt`.
    lower, upper
        Bounds of ``q``; the robot's if not given. Before the first reading a coordinate has the standard deviation
        of a uniform distribution between them. Equal bounds fix a coordinate: it has no variance.
    noise
        Standard deviation of a reading, one number or one for each, in their unit; the robot's if not given.
    acceleration
        Process noise :math:`a` of every coordinate [unit/s^1.5], about the typical change of its velocity within a
        second. A swing of amplitude :math:`A` and period :math:`T` has :math:`a \approx A (2\pi/T)^{3/2}`. The rule
        of thumb if not given: half of the range between its bounds, right for a swing over half of the range in four
        seconds. A robot that moves ten times slower wants a thirtieth of it.
    velocity
        Standard deviation of every velocity before the first reading [unit/s]; half of the range if not given.
    iterations, tolerance
        As for :class:`repro.LevenbergMarquardt`.

    Raises
    ------
    InputError
        If a number is not positive or does not fit the coordinates.

    Examples
    --------
    A reading of noise 1 and an equally uncertain prior end halfway:

    >>> from repro import KalmanFilter
    >>> root = 3**0.5
    >>> method = KalmanFilter(lambda q: q, [-root], [root], noise=1.0, acceleration=[1.0], velocity=[1.0])
    >>> estimate = method.step(method.init([0.0]), [1.0], t=0.0)[1]
    >>> estimate.q.round(6), estimate.covariance.round(6)
    (array([0.5]), array([[0.5]]))
    """

    def __init__(
        self,
        sensing: Any,
        lower: ArrayLike | None = None,
        upper: ArrayLike | None = None,
        noise: ArrayLike | None = None,
        acceleration: ArrayLike | None = None,
        velocity: ArrayLike | None = None,
        *,
        iterations: int = 50,
        tolerance: float = 1e-4,
    ) -> None:
        owner = "KalmanFilter"
        self.robot, sensing, lower, upper, noise = described(sensing, lower, upper, noise, owner)
        low, high = numbers(lower, "lower", owner, (None,)), numbers(upper, "upper", owner, (None,))
        self.n_q, self._by_rule = len(low), acceleration is None
        rates = []
        for name, value in (("acceleration", acceleration), ("velocity", velocity)):
            rate = (high - low) / 2 if value is None else numbers(value, name, owner, (self.n_q,))
            require(value is None or (rate > 0).all(), name, owner, "positive", rate)
            rates.append(np.where(high > low, rate, 0.0))
        self.acceleration, self.velocity = rates
        none = np.zeros(0)
        self.drift_std, self.drift_walk, self.drift_rate, self.drift_names = none, none, none, ()
        if isinstance(sensing, Drifting):
            sensing = DriftModel(sensing, low, high, owner)
            self.drift_std, self.drift_walk, self.drift_rate = sensing.states
            self.drift_names = sensing.names
        far = 1e3 * np.maximum(self.drift_std, 1e-9) + 1e6 * self.drift_walk
        self._update = LevenbergMarquardt(
            sensing,
            np.concatenate([low, -far]),
            np.concatenate([high, far]),
            noise,
            iterations=iterations,
            tolerance=tolerance,
        )
        self._width, self.angles = high - low, self._update.angles

    def __repr__(self) -> str:
        """Say its process noise, and whether that is the rule of thumb."""
        words = ", ".join(f"{a:.3g}" for a in self.acceleration)
        rule = ", by the rule of thumb: half of each range" if self._by_rule else ""
        return f"KalmanFilter of {self.n_q} coordinates; process noise {words} [unit/s^1.5]{rule}"

    def init(self, q0: ArrayLike | None = None, seed: int = 0) -> KalmanState:
        """Return the state at rest at ``q0`` ``[..., n_q]``, else where the robot starts or amid the bounds."""
        bounds = self._update
        middle = (bounds.lower + bounds.upper)[: self.n_q] / 2
        if q0 is None and self.robot is not None:
            q0 = self.robot.start
        q = middle if q0 is None else start(q0, self.n_q, "KalmanFilter")
        drift = np.zeros((*q.shape[:-1], len(self.drift_std)))
        q = bounds.init(np.concatenate([q, drift], axis=-1)).q
        assert q is not None
        std = np.concatenate([self._width / math.sqrt(12), self.drift_std, self.velocity])
        P = np.broadcast_to(np.diag(std**2), (*q.shape[:-1], len(std), len(std)))
        return KalmanState(q, np.zeros((*q.shape[:-1], self.n_q)), P, None)

    def motion(self, tau: float) -> tuple[Array, Array]:
        """Return the transition of (q, drift, velocity) over ``tau`` [s], and the covariance that it adds."""
        n, k = self.n_q, len(self.drift_std)
        F, Q = np.eye(2 * n + k), np.zeros((2 * n + k, 2 * n + k))
        i, e, v = np.arange(n), np.arange(n, n + k), np.arange(n + k, 2 * n + k)
        F[i, v] = tau
        density = self.acceleration**2
        Q[i, i], Q[i, v], Q[v, i], Q[v, v] = (
            tau**3 / 3 * density,
            tau**2 / 2 * density,
            tau**2 / 2 * density,
            tau * density,
        )
        if k:
            rate = np.where(self.drift_rate > 0, self.drift_rate, 1.0)
            grown = np.where(self.drift_rate > 0, -np.expm1(-2 * self.drift_rate * tau) / (2 * rate), tau)
            F[e, e], Q[e, e] = np.exp(-self.drift_rate * tau), self.drift_walk**2 * grown
        return F, Q

    @property
    def bounds(self) -> tuple[Array, Array]:
        """Bounds of the coordinates."""
        return self._update.lower[: self.n_q], self._update.upper[: self.n_q]

    def parts_of(self, n_readings: int) -> tuple[Array, Array]:
        """Return which part every reading belongs to, and which readings never stay the same ``[s]``."""
        return parts_of(self.robot, self._update.noise, n_readings)

    def widened(self, share: float) -> KalmanFilter:
        """Return this filter with bounds that are a share of their width farther out on each side."""
        found = copy.copy(self)
        found._update = self._update.widened(share)
        return found

    def by_bounds(self, C: Array) -> Array:
        """Return covariances ``[..., n_q, n_q]`` that leave no direction more open than the bounds do.

        Between two readings a variance may grow far beyond that. The state keeps it: the bounds are no new reading.
        """
        known = self._update.by_bounds[: self.n_q]
        if (C.diagonal(0, -2, -1) @ known <= 1).all():  # no direction can be beyond
            return C
        width = 1 / np.sqrt(np.where(known > 0, known, 1.0))
        scaled = C / np.outer(width, width)
        values, vectors = np.linalg.eigh(scaled)
        scaled = (vectors * np.minimum(values, 1.0)[..., None, :]) @ np.swapaxes(vectors, -1, -2)
        return scaled * np.outer(width, width)

    def near(self, state: KalmanState, reference: Array) -> KalmanState:
        """Return the same state with angles next to those of a reference ``[..., n_q]``."""
        n = state.q.shape[-1]
        q = self.angles.nearest(state.q, reference)
        moved = (q != state.q).any(-1)
        if not moved.any():
            return state
        slopes, k = self.angles.slopes(state.q, q), self.n_q
        turned = np.zeros_like(state.covariance)
        turned[..., :n, :n], turned[..., n:, n:] = slopes, slopes[..., :k, :k]
        turned = np.where(moved[..., None, None], turned, np.eye(turned.shape[-1]))
        velocity = (turned[..., n:, n:] @ state.velocity[..., None])[..., 0]
        P = turned @ state.covariance @ np.swapaxes(turned, -1, -2)
        return state._replace(q=q, velocity=velocity, covariance=P)

    def wrapped(self, state: KalmanState) -> KalmanState:
        """Return the same state within the bounds: a rotation vector is singular after a whole turn."""
        state = self.near(state, self.angles.middle) if self.angles else state
        return state._replace(q=state.q.clip(self._update.lower, self._update.upper))

    def step(
        self,
        state: KalmanState,
        u: ArrayLike,
        t: float = 0.0,
        mask: ArrayLike | None = None,
        known: ArrayLike | None = None,
    ) -> tuple[KalmanState, Estimate]:
        """Predict to the time ``t`` [s] and take in ``u``.

        The details hold ``iterations`` and ``at_bound``, with errors that wander also ``drift`` and ``drift_std``.
        ``chi2`` counts what the prior is off, too.

        Raises
        ------
        InputError
            If ``t`` is not after the last step, or the readings do not fit the model.
        """
        if not (state.t is None or t > state.t):
            raise bad_input("t", "KalmanFilter", f"after the last step, {state.t} s", t)
        fit, k = self._update, self.n_q
        u = incoming(u, mask, "KalmanFilter", fit.model.n_readings)
        known = known_coordinates(known, k, "KalmanFilter")
        batch, n = batch_of(state.q, u), fit.n_q
        x, P, q, information, certain = self.carried(state, t, batch, self._limits)
        given = None
        if known is not None or certain:
            given = self._given(x[..., :n], P, known)
        q, u_hat, C, at_bound, status, counts = fit.fit(q, u, given, (x[..., :n], information))
        open_ = _update(fit.by_bounds[:k], *in_line(batch, x, P, q, C, information))
        after = KalmanState(q, x[..., n:], P, t)
        after = self.wrapped(after) if self.angles else after
        C = after.covariance[..., :k, :k]
        details = {"iterations": status[..., TURN], "at_bound": at_bound[..., :k]}
        if len(self.drift_std):
            details["drift"] = after.q[..., k:]
            details["drift_std"] = np.sqrt(np.diagonal(after.covariance, axis1=-2, axis2=-1)[..., k:n])
        n_used, chi2 = counts[..., USED][()], status[..., CHI2][()]
        # The prior adds a residual for every coordinate, and the fit uses up one for each that is free.
        dof = n_used + counts[..., BOUND][()]
        C = self.by_bounds(C) if open_ or self.angles else C
        return after, Estimate(after.q[..., :k], C, u_hat, chi2, dof, counts[..., MISSING][()], details)

    @cached_property
    def _limits(self) -> Array:
        return np.array(self._update.limits)

    def _given(self, q: Array, P: Array, known: Array | None) -> Array | None:
        """Return what is certain or known ``[..., n_q + k]``, NaN for the rest; nothing if there is none."""
        certain = P.diagonal(0, -2, -1)[..., : q.shape[-1]] <= 0
        values = np.where(certain, q, np.nan)
        if known is not None:
            shape = np.broadcast_shapes(values.shape[:-1], known.shape[:-1])
            values = np.broadcast_to(values, (*shape, values.shape[-1])).copy()
            values[..., : self.n_q] = np.where(np.isnan(known), values[..., : self.n_q], known)
            values = self.angles.nearest(values, q) if self.angles else values
        return None if np.isnan(values).all() else values


@kernel(entry=True, allocates=True)
def _predict(F, Q, limits, x, P, start, information):
    """Carry mean and covariance over a time, in place; write where a fit of the first coordinates starts.

    That is their mean within limits, with the inverse of their covariance; rows of what is certain are zero. Return
    whether there are such.
    """
    m, n, certain = len(F), limits.shape[1], False
    moved, turned, L, column = np.zeros(m), np.zeros((m, m)), np.zeros((n, n)), np.zeros(n)
    for k in range(len(P) // m):
        y, C = x[k * m : (k + 1) * m], P[k * m : (k + 1) * m]
        _sparse_product(F, C, turned)
        for a in range(m):
            moved[a] = 0.0
            for b in range(m):
                moved[a] += F[a, b] * y[b]
        y[:] = moved
        for a in range(m):
            for b in range(m):
                C[a, b] = turned[b, a]
        _sparse_product(F, C, turned)
        for a in range(m):
            for b in range(a + 1):
                C[a, b] = C[b, a] = 0.5 * (turned[a, b] + Q[a, b] + turned[b, a] + Q[b, a])
        for a in range(n):
            start[k * n + a] = min(max(y[a], limits[0, a]), limits[1, a])
            certain = certain or not C[a, a] > 0.0
        _invert_prior(C, L, column, information[k * n : (k + 1) * n])
    return certain


@kernel
def _sparse_product(F, C, out):
    """Write ``F C``; most of a transition is zero."""
    m = len(F)
    for a in range(m):
        for c in range(m):
            out[a, c] = 0.0
        for b in range(m):
            if F[a, b] != 0.0:
                for c in range(m):
                    out[a, c] += F[a, b] * C[b, c]


@kernel
def _invert_prior(P, L, column, information):
    """Write the inverse of the covariance of the configuration; rows of what is certain are zero."""
    n = len(information)
    for a in range(n):
        for b in range(a + 1):
            L[a, b] = P[a, b] if P[a, a] > 0.0 and P[b, b] > 0.0 else 0.0
        if not P[a, a] > 0.0:
            L[a, a] = 1.0
    cholesky(L, 1e-300)
    for b in range(n):
        for a in range(n):
            column[a] = 1.0 if a == b and P[b, b] > 0.0 else 0.0
        solve(L, column)
        for a in range(n):
            information[a, b] = column[a]
    for a in range(n):
        for b in range(a):
            information[a, b] = information[b, a] = 0.5 * (information[a, b] + information[b, a])


@kernel(entry=True, allocates=True)
def _update(by_bounds, x, P, q, C, information):
    """Move mean and covariance to the posterior ``q``, ``C``: what is no configuration follows by regression.

    Return whether variances may be beyond those that the bounds leave.
    """
    n, m, open_ = C.shape[1], P.shape[1], False
    gain, new = np.zeros((m - n, n)), np.zeros((m - n, n))
    for k in range(len(P) // m):
        at = slice(k * n, (k + 1) * n)
        y, V = x[k * m : (k + 1) * m], P[k * m : (k + 1) * m]
        _regress(y, V, q[at], C[at], information[at], gain, new)
        share = 0.0
        for a in range(len(by_bounds)):
            share += by_bounds[a] * V[a, a]
        open_ = open_ or not share <= 1.0
    return open_


@kernel
def _regress(x, P, q, C, information, gain, new):
    n, rest = len(q), len(gain)
    for v in range(rest):
        for a in range(n):
            gain[v, a] = 0.0
            for b in range(n):
                gain[v, a] += P[n + v, b] * information[b, a]
    for v in range(rest):
        for a in range(n):
            x[n + v] += gain[v, a] * (q[a] - x[a])
            new[v, a] = 0.0
            for b in range(n):
                new[v, a] += gain[v, b] * C[b, a]
    for v in range(rest):
        for w in range(v + 1):
            total = 0.5 * (P[n + v, n + w] + P[n + w, n + v])
            for a in range(n):
                total += new[v, a] * gain[w, a] - gain[v, a] * P[a, n + w]
            P[n + v, n + w] = P[n + w, n + v] = total
    for a in range(n):
        x[a] = q[a]
        for v in range(rest):
            P[n + v, a] = P[a, n + v] = new[v, a]
        for b in range(n):
            P[a, b] = 0.5 * (C[a, b] + C[b, a])


def smoothed(method: MotionModel, states: Sequence[Any], restarted: Array | None = None) -> list[Any]:
    r"""Return what later readings say about earlier states: Rauch, Tung and Striebel.

    With the state :math:`x_k, P_k` after its own readings, the transition :math:`F` to the next one and
    :math:`P^-_{k+1} = F P_k F^T + Q`,

    .. math:: G = P_k F^T (P^-_{k+1})^{-1}, \quad \hat x_k = x_k + G\,(\hat x_{k+1} - F x_k), \quad
       \hat P_k = P_k + G\,(\hat P_{k+1} - P^-_{k+1})\,G^T

    from the last state backwards (Särkkä and Svensson 2023, section 12.2).

    Parameters
    ----------
    method
        A Kalman or rod filter: it has ``motion(tau)``.
    states
        After a step, or ``predicted``, in the order of time.
    restarted
        Which of them do not come from the one before ``[t, ...]``: nothing goes back from there.

    Raises
    ------
    InputError
        If there is no state, one has no time, or they are not in order.
    """
    if not states or any(state.t is None for state in states):
        raise bad_input("states", "smoothed", "at least one, each after a step", f"{len(states)} states")
    t = np.array([state.t for state in states])
    require((np.diff(t) >= 0).all(), "states", "smoothed", "in the order of time", "others")
    x = np.stack([np.concatenate([state.q, state.velocity], axis=-1) for state in states])
    P, n = np.stack([state.covariance for state in states]), states[0].q.shape[-1]
    for k in reversed(range(len(t) - 1)):
        gain, mean, before = _link(method.motion(t[k + 1] - t[k]), x[k], P[k])
        if restarted is not None:
            gain = gain * ~restarted[k + 1][..., None, None]
        y, C = x[k + 1], P[k + 1]
        if method.angles:  # the later state may have been wrapped
            later = method.near(
                states[k + 1]._replace(q=y[..., :n], velocity=y[..., n:], covariance=C), mean[..., :n]
            )
            y, C = np.concatenate([later.q, later.velocity], axis=-1), later.covariance
        x[k] += (gain @ (y - mean)[..., None])[..., 0]
        P[k] += gain @ (C - before) @ np.swapaxes(gain, -1, -2)
        P[k] = 0.5 * (P[k] + np.swapaxes(P[k], -1, -2))
    found = [
        state._replace(q=y[..., :n], velocity=y[..., n:], covariance=C)
        for state, y, C in zip(states, x, P, strict=True)
    ]
    return [method.wrapped(state) for state in found]


def _link(motion: tuple[Array, Array], x: Array, P: Array) -> tuple[Array, Array, Array]:
    """Gain, and mean and covariance that the next state had before its readings."""
    F, Q = motion
    cross = F @ P
    before = cross @ F.T + Q
    # Scaled to a unit diagonal, as positions and velocities differ by orders; a state without variance has no gain.
    std = np.sqrt(np.diagonal(before, axis1=-2, axis2=-1))
    scale = np.divide(1.0, std, out=np.zeros_like(std), where=std > 0)
    scaled = before * scale[..., :, None] * scale[..., None, :] + (scale == 0)[..., None] * np.eye(
        std.shape[-1]
    )
    gain = np.linalg.solve(scaled, cross * scale[..., :, None]) * scale[..., :, None]
    return np.swapaxes(gain, -1, -2), x @ F.T, before
