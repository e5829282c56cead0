r"""The iterated Kalman filter with errors of the sensors in its state: what drifts is estimated, not averaged.

The state is :math:`(q, \dot q, b)`. The configuration moves as in
:class:`~edition1.estimation.kalman_filter.IteratedKalmanFilter`; every error :math:`b` is an Ornstein-Uhlenbeck
process about zero, :math:`E[b(t)\, b(t + \tau)] = \sigma_b^2 e^{-\tau/T}`, which for :math:`T = \infty` is an
unknown constant. An error that lasts is not white: a filter that takes it for noise believes that it averages out,
and its covariance is too small.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import torch
from jaxtyping import Float
from torch import Tensor

from edition1.errors import bad_input, require
from edition1.estimation._step import driven
from edition1.estimation.base import Estimate, check_start
from edition1.estimation.kalman_filter import IteratedKalmanFilter, KalmanState

_WIDEST = 12.0
"""Errors are kept within this many standard deviations: a bound that least squares needs and nothing reaches."""


@dataclass(frozen=True)
class Drift:
    """Errors of sensors that last: Ornstein-Uhlenbeck processes, independent of one another.

    Parameters
    ----------
    std
        Standard deviation of each at any time, before readings [unit of the error].
    time_s
        Correlation time of each [s]; infinite for a constant.

    Raises
    ------
    InputError
        If they do not describe the same number of errors, at least one, or are not positive.
    """

    std: Float[Tensor, " n_b"]
    time_s: Float[Tensor, " n_t"]

    def __post_init__(self) -> None:
        if self.std.shape != self.time_s.shape or not len(self.std):
            shapes = f"shapes {tuple(self.std.shape)} and {tuple(self.time_s.shape)}"
            raise bad_input("std, time_s", "Drift", "one of each for every error", shapes)
        for name in ("std", "time_s"):
            if not bool((getattr(self, name) > 0).all()):
                raise bad_input(name, "Drift", "positive", getattr(self, name).tolist())
        if not bool(torch.isfinite(self.std).all()):
            raise bad_input("std", "Drift", "finite", self.std.tolist())


@dataclass(frozen=True)
class DriftFilter:
    """Estimator of a configuration by sensors whose errors last.

    In its state, ``q`` is :math:`(q, b)`, and the velocity of ``b`` is zero. An estimate holds the configuration
    and its covariance alone; the errors stand in its diagnostics as ``drift``.

    Parameters
    ----------
    sensing
        ``(q, b)`` to predicted readings, batched and differentiable.
    lower, upper, acceleration, velocity
        Of the configuration, as in :class:`~edition1.estimation.kalman_filter.IteratedKalmanFilter`.
    drift
        The errors.
    noise_mt
        Standard deviation of a reading, in its unit.
    iterations
        Largest number of iterations in an update.

    Raises
    ------
    InputError
        As :class:`~edition1.estimation.kalman_filter.IteratedKalmanFilter`.

    Examples
    --------
    A reading of the sum of a coordinate and an equally uncertain error tells half of it to each:

    >>> one = torch.ones(1, dtype=torch.float64)
    >>> box = (-(3**0.5) * one, 3**0.5 * one)
    >>> drift = Drift(one, 3.0 * one)
    >>> method = DriftFilter(lambda x: x.sum(-1, keepdim=True), *box, one, one, drift, noise_mt=1e-6)
    >>> _, estimate = method.step(method.init(0 * one), one, 0.0)
    >>> round(float(estimate.q), 6), round(float(estimate.diagnostics["drift"]), 6)
    (0.5, 0.5)
    """

    sensing: Callable[[Tensor], Tensor]
    lower: Float[Tensor, " n_q"]
    upper: Float[Tensor, " n_q"]
    acceleration: Float[Tensor, " n_q"]
    velocity: Float[Tensor, " n_q"]
    drift: Drift
    noise_mt: float = 1.0
    iterations: int = 8

    def __post_init__(self) -> None:
        short = {"noise_mt": self.noise_mt, "iterations": self.iterations}
        q = (self.lower, self.upper, self.acceleration, self.velocity)
        IteratedKalmanFilter(self.sensing, *q, **short)  # refuses what does not describe a configuration now
        _ = self._whole

    @cached_property
    def _whole(self) -> IteratedKalmanFilter:
        """The filter of ``(q, b)``; only its update is used, so the motion of ``b`` in it has no effect."""
        std = self.drift.std.to(self.lower)
        far, one = _WIDEST * std, torch.ones_like(std)
        return IteratedKalmanFilter(
            self.sensing,
            torch.cat([self.lower, -far]),
            torch.cat([self.upper, far]),
            torch.cat([self.acceleration, one]),
            torch.cat([self.velocity, one]),
            noise_mt=self.noise_mt,
            iterations=self.iterations,
        )

    def init(self, q0: Float[Tensor, "*batch n_q"], *, seed: int = 0) -> KalmanState:
        """State at ``q0``, at rest, errors zero; nothing is random, the seed has no effect."""
        check_start(q0, (self.lower, self.upper), "DriftFilter", n_q=len(self.lower))
        std = self.drift.std.to(q0)
        x = torch.cat([q0, torch.zeros_like(std).expand(*q0.shape[:-1], -1)], dim=-1)
        width, rest = (self.upper - self.lower).to(q0), torch.zeros_like(std)
        variances = torch.cat([width**2 / 12, std**2, self.velocity.to(q0) ** 2, rest])
        return KalmanState(x, torch.zeros_like(x), torch.diag(variances).expand(*q0.shape[:-1], -1, -1))

    def released(self, state: KalmanState, q0: Float[Tensor, "*batch n_q"]) -> KalmanState:
        """State that keeps what is known about the errors, and forgets the configuration: as new at ``q0``.

        After readings in a pose that is ``known``, a calibration.
        """
        fresh, n = self.init(q0), len(self.lower)
        whole = state.q.shape[-1]
        keep = torch.zeros(2 * whole, dtype=torch.bool)
        keep[n:whole] = True
        both = keep.unsqueeze(-1) & keep
        x = torch.where(keep[:whole], state.q, fresh.q)
        return KalmanState(x, fresh.velocity, torch.where(both, state.covariance, fresh.covariance), state.t)

    def step(
        self,
        state: KalmanState,
        u: Float[Tensor, "*batch s"],
        t: float,
        *,
        mask: Tensor | None = None,
        known: Tensor | None = None,
    ) -> tuple[KalmanState, Estimate]:
        """Predict to time ``t`` and take in ``u``; ``drift`` is in the diagnostics of the plain filter.

        Raises
        ------
        InputError
            If ``t`` is not after the last step, a mask does not fit, a reading is infinite, or no sensor is left.
        """
        require(state.t is None or t > state.t, "t", "DriftFilter", f"after the last step, {state.t} s", t)
        n = len(self.lower)
        if known is not None:
            free = torch.full((len(self.drift.std),), torch.nan).to(known).expand(*known.shape[:-1], -1)
            known = torch.cat([known, free], dim=-1)
        before = self.predicted(state, t)
        # Without a time, a state is taken as it is: predicted here.
        before = KalmanState(before.q, before.velocity, before.covariance)
        new, found = self._whole.step(before, u, t, mask=mask, known=known)
        assert found.covariance is not None
        diagnostics = {**found.diagnostics, "drift": found.q[..., n:]}
        return new, Estimate(found.q[..., :n], found.covariance[..., :n, :n], found.u_hat, diagnostics)

    def motion(self, tau: float) -> tuple[Tensor, Tensor]:
        """Transition of ``(q, b)`` and velocity over ``tau`` [s], and the covariance that it adds."""
        n, std = len(self.lower), self.drift.std.to(self.lower)
        kept = torch.exp(-tau / self.drift.time_s.to(std))
        move, noise = driven(tau, torch.cat([self.acceleration, 0 * std]))
        whole = n + len(std)
        stay, added = move.diagonal()[:whole], noise.diagonal()[:whole]
        stay[n:], added[n:] = kept, std**2 * (1 - kept**2)
        return move, noise

    def predicted(self, state: KalmanState, t: float) -> KalmanState:
        """State carried to a time ``t`` [s] without a reading.

        Raises
        ------
        InputError
            If ``t`` is before that of the state.
        """
        if state.t is None:
            return KalmanState(state.q, state.velocity, state.covariance, t)
        require(t >= state.t, "t", "DriftFilter", f"not before the last step, {state.t} s", t)
        tau, x = t - state.t, state.q
        move, noise = (y.to(x) for y in self.motion(tau))
        P = move @ state.covariance @ move.mT + noise
        stay = move.diagonal()[: x.shape[-1]]
        return KalmanState(stay * x + tau * state.velocity, state.velocity, P, t)
