r"""Iterated extended Kalman filter of a rod: a short series of strains, each a Gaussian process in time.

Every term :math:`q_i` of the strain, and of the twist of the base where that moves, is a Matern process of
smoothness 3/2, :math:`E[q(t)\,q(t+\tau)] = \sigma^2 (1 + \lambda\tau)\, e^{-\lambda\tau}`: a particle that white
noise accelerates and that is drawn back to rest. Over a step :math:`(q, \dot q)` moves by

.. math::
   F = e^{-\lambda\tau}
   \begin{bmatrix} 1 + \lambda\tau & \tau \\ -\lambda^2\tau & 1 - \lambda\tau \end{bmatrix},
   \qquad Q = \sigma^2 \left(\mathrm{diag}(1, \lambda^2) - F\, \mathrm{diag}(1, \lambda^2)\, F^T\right),

exactly, however long the step is (Teetaert et al. 2025 hold a Gaussian process in space and in time against a
continuum robot; Särkkä and Solin 2019, section 12.3, give the process). Sensors may be read at any time, one by one:
what was not read at a step is NaN. Errors of a sensor that last are states too, as in
:class:`~edition1.estimation.drift_filter.DriftFilter`.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from edition1.errors import bad_input, require
from edition1.estimation._step import conditioned, matern
from edition1.estimation.base import Estimate, check_start, usable
from edition1.estimation.kalman_filter import KalmanState
from edition1.estimation.rod_sensors import RodSensor, layout
from edition1.kernels._rod import rod_motion
from edition1.kernels._rod_filter import Layout, carry, kalman_gain, reduced, rod_innovation, rod_readings
from edition1.kinematics.strain_series import StrainSeries

_STILL = 0.01
"""An update ends when no state moves by more than this share of its standard deviation before any reading."""


@dataclass(frozen=True)
class RodFilter:
    r"""Estimator of the strain of a rod from readings at any time.

    The configuration is the twist of the base in the world (m, rad; only where ``base_std`` says that it is not
    known), then the terms of the strain [rad/m]. In the state, ``q`` holds the lasting errors of the sensors behind
    it. Readings are those of the sensors, one behind the other; the frame of the world is that of the base.

    Parameters
    ----------
    rod
        Its series.
    sensors
        What is read.
    strain_std
        Standard deviation of each term [rad/m], before any reading.
    rate
        Rate :math:`\lambda` of the terms [1/s]: how fast the strain may change and is forgotten.
    base_std
        Standard deviations of the position [m] and the rotation [rad] of the base, about each axis; none if it
        stays at the origin.
    base_rate
        Rate of the base [1/s].
    iterations
        Largest number of linearisations in an update.

    Raises
    ------
    InputError
        If there is no sensor, one sits beyond the ends, or a value is not positive.

    Examples
    --------
    The tip of a rod of 1 m is turned by 0.3 rad, so its curvature is 0.3 rad/m:

    >>> rod = StrainSeries(1.0, bending=1, torsion=0)
    >>> filter = RodFilter(rod, (RodSensor("orientation", (1e-3,) * 3, arc_m=1.0),), (10.0,) * 2, rate=1.0)
    >>> turned = torch.tensor([0.3, 0.0, 0.0], dtype=torch.float64)
    >>> state, estimate = filter.step(filter.init(torch.zeros(2, dtype=torch.float64)), turned, 0.0)
    >>> estimate.q.round(decimals=3), estimate.covariance.diagonal().sqrt().round(decimals=3)
    (tensor([0.3000, 0.0000], dtype=torch.float64), tensor([0.0010, 0.0010], dtype=torch.float64))
    """

    rod: StrainSeries
    sensors: tuple[RodSensor, ...]
    strain_std: tuple[float, ...]
    rate: float
    base_std: tuple[float, float] | None = None
    base_rate: float = 0.1
    iterations: int = 8

    def __post_init__(self) -> None:
        if len(self.strain_std) != self.rod.n_q:
            expected = f"one for each of {self.rod.n_q} terms"
            raise bad_input("strain_std", "RodFilter", expected, len(self.strain_std))
        for name, values in (
            ("strain_std", self.strain_std),
            ("rate", (self.rate,)),
            ("base_std", self.base_std or (1.0,)),
            ("base_rate", (self.base_rate,)),
            ("iterations", (self.iterations,)),
        ):
            require(all(x > 0 for x in values), name, "RodFilter", "positive", getattr(self, name))
        require(self.sensors, "sensors", "RodFilter", "at least one", "none")
        for sensor in self.sensors:
            if not 0 <= sensor.arc_m <= self.rod.length * (1 + 1e-12):
                expected = f"between 0 and the length {self.rod.length} m"
                raise bad_input("arc_m", "RodFilter", expected, sensor.arc_m)

    @property
    def n_q(self) -> int:
        """Number of configuration variables."""
        return len(self._std)

    @cached_property
    def _std(self) -> np.ndarray:
        base = () if self.base_std is None else (self.base_std[0],) * 3 + (self.base_std[1],) * 3
        return np.array(base + self.strain_std)

    @cached_property
    def _rates(self) -> np.ndarray:
        return np.where(np.arange(self.n_q) < self.n_q - self.rod.n_q, self.base_rate, self.rate)

    @cached_property
    def _lasting(self) -> tuple[np.ndarray, np.ndarray]:
        """Standard deviations and rates [1/s] of the errors that last."""
        std = [x for sensor in self.sensors for x in sensor.lasting_std]
        rates = [1 / sensor.lasting_time_s for sensor in self.sensors for _ in sensor.lasting_std]
        return np.array(std), np.array(rates)

    @cached_property
    def _scale(self) -> np.ndarray:
        """Standard deviation of every state before any reading."""
        return np.concatenate([self._std, self._lasting[0], self._std * self._rates])

    @cached_property
    def _layout(self) -> Layout:
        return layout(self.rod, self.sensors, base=self.base_std is not None)

    def init(self, q0: Float[Tensor, "*batch n_q"], *, seed: int = 0) -> KalmanState:
        """State at ``q0``, at rest, errors zero; nothing is random, the seed has no effect."""
        check_start(q0, None, "RodFilter", n_q=self.n_q)
        q = torch.cat([q0, q0.new_zeros(*q0.shape[:-1], len(self._lasting[0]))], dim=-1)
        covariance = torch.from_numpy(np.diag(self._scale**2)).expand(*q0.shape[:-1], -1, -1)
        return KalmanState(q, torch.zeros_like(q0), covariance)

    def motion(self, tau: float) -> tuple[Tensor, Tensor]:
        """Transition of configuration, lasting errors and velocities over ``tau`` [s], and what noise adds."""
        std, rates = self._lasting
        return matern(self._std, self._rates, std, rates, tau)

    def predicted(self, state: KalmanState, t: float) -> KalmanState:
        """State carried to a time ``t`` [s] without a reading.

        Raises
        ------
        InputError
            If ``t`` is before that of the state.
        """
        if state.t is None:
            return KalmanState(state.q, state.velocity, state.covariance, t)
        require(t >= state.t, "t", "RodFilter", f"not before the last step, {state.t} s", t)
        move, noise = self.motion(t - state.t)
        x = torch.cat([state.q, state.velocity], -1).double() @ move.mT
        m = state.q.shape[-1]
        q, velocity = x[..., :m].to(state.q), x[..., m:].to(state.q)
        return KalmanState(q, velocity, move @ state.covariance @ move.mT + noise, t)

    def step(
        self,
        state: KalmanState,
        u: Float[Tensor, "*batch s"],
        t: float,
        *,
        mask: Tensor | None = None,
        known: Tensor | None = None,
    ) -> tuple[KalmanState, Estimate]:
        """Predict to time ``t`` and take in ``u``; ``lasting`` errors are in the diagnostics.

        A pose or an orientation of which a number is missing is left out whole.

        Raises
        ------
        InputError
            If ``t`` is not after the last step, ``u`` has another width than the sensors, a mask does not fit, a
            reading is infinite, or no sensor is left.
        """
        require(state.t is None or t > state.t, "t", "RodFilter", f"after the last step, {state.t} s", t)
        s = int(self._layout.row[-1])
        require(u.shape[-1] == s, "u", "RodFilter", f"of last dimension {s}", f"shape {tuple(u.shape)}")
        use = usable(u, mask, "RodFilter")
        n, m = self.n_q, state.q.shape[-1]
        batch = np.broadcast_shapes(state.q.shape[:-1], u.shape[:-1])
        x = torch.cat([state.q, state.velocity], -1).double()
        x = x.expand(*batch, -1).reshape(-1, n + m).numpy().copy()
        P = state.covariance.double().expand(*batch, -1, -1).reshape(-1, n + m, n + m).numpy().copy()
        rows, used = (y.expand(*batch, -1).reshape(-1, s).numpy().copy() for y in (u.detach().double(), use))
        held = None if known is None else known.double().expand(*batch, -1).reshape(-1, n).numpy()
        u_hat, chi2 = np.empty((len(x), s)), np.empty(len(x))
        for k in range(len(x)):
            if state.t is not None:
                carry(x[k], P[k], self._std, self._rates, *self._lasting, t - state.t)
            if held is not None:
                x[k], P[k] = conditioned(x[k], P[k], held[k])
            chi2[k] = self._take_in(x[k], P[k], rows[k], used[k])
            rod_readings(self._layout, x[k], n, self._models(x[k], slopes=False)[0], u_hat[k])
        new, cov, u_hat, chi2, dof, masked = (
            torch.from_numpy(y).reshape(batch + y.shape[1:])
            for y in (x, P, u_hat, chi2, used.sum(-1), (~used).sum(-1))
        )
        after = KalmanState(new[..., :m].to(state.q), new[..., m:].to(state.q), cov, t)
        diagnostics = {
            "masked": masked,
            "chi2": chi2.to(state.q),
            "dof": dof,
            "lasting": after.q[..., n:],
        }
        covariance = cov[..., :n, :n].to(state.q)
        return after, Estimate(after.q[..., :n], covariance, u_hat.to(state.q), diagnostics)

    def positions(
        self,
        q: Float[Tensor, "*batch n_q"],
        covariance: Float[Tensor, "*batch n_q n_q"],
        arcs_m: tuple[float, ...],
    ) -> tuple[Float[Tensor, "*batch m 3"], Float[Tensor, "*batch m 3 3"]]:
        """Positions [m] of places along the rod, and their covariances, to first order.

        Parameters
        ----------
        q, covariance
            Of an estimate.
        arcs_m
            Places [m] along the rod, from base to tip.

        Raises
        ------
        InputError
            If the places are not on the rod, or not in this order.
        """
        rod = self.rod
        ends = (0.0, *arcs_m, rod.length * (1 + 1e-12))
        if not all(a <= b for a, b in itertools.pairwise(ends)):
            expected = f"places from base to tip, between 0 and the length {rod.length} m"
            raise bad_input("arcs_m", "RodFilter.positions", expected, arcs_m)
        where, spread = [], []
        P = covariance.double().reshape(-1, self.n_q, self.n_q).numpy()
        for x, C in zip(q.double().reshape(-1, self.n_q).numpy(), P, strict=True):
            T, J = rod_motion(
                x, rod.basis, rod.length / rod.parts, self.base_std is not None, np.array(arcs_m)
            )
            slope = T[:, :3, :3] @ J[:, :3]
            where.append(T[:, :3, 3])
            spread.append(slope @ C @ slope.swapaxes(-1, -2))
        shape = (*q.shape[:-1], len(arcs_m), 3)
        position, cov = (torch.from_numpy(np.stack(values)).to(q) for values in (where, spread))
        return position.reshape(shape), cov.reshape(*shape, 3)

    def _take_in(self, x: np.ndarray, P: np.ndarray, u: np.ndarray, use: np.ndarray) -> float:
        """Update one member in place, and clear ``use`` of poses that are not whole; chi-square of its surprise."""
        prior = x.copy()
        gain, H, r, chi2 = self._gain(x, prior, P, u, use)
        for k in range(self.iterations):
            moved = prior + gain @ r - x
            x += moved
            if k + 1 == self.iterations or np.abs(moved / self._scale).max() < _STILL:
                break
            gain, H, r, chi2 = self._gain(x, prior, P, u, use)
        P[:] = reduced(P, gain, H)
        return chi2

    def _gain(
        self, x: np.ndarray, prior: np.ndarray, P: np.ndarray, u: np.ndarray, use: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, float]:
        """Gain of an update linearised at ``x``, with derivatives, surprise of the readings and its chi-square."""
        s = len(u)
        r, H, R = np.zeros(s), np.zeros((s, len(x))), np.zeros(s)
        rod_innovation(self._layout, x, prior, P, u, use, self.n_q, *self._models(x, slopes=True), r, H, R)
        if not use.any():
            expected = "at least one pose or orientation without a missing number"
            raise bad_input("u", "RodFilter", expected, "none")
        gain, chi2 = kalman_gain(P, r[use], H[use], R[use])
        return gain, H[use], r[use], chi2

    def _models(self, x: np.ndarray, *, slopes: bool) -> tuple[np.ndarray, np.ndarray]:
        """Readings of the sensors that are models, in their places, and their derivatives by the strain."""
        terms = self.rod.n_q
        value, slope = np.zeros(self._layout.row[-1]), np.zeros((self._layout.row[-1], terms))
        strain = torch.from_numpy(x[self.n_q - terms : self.n_q].copy())
        for k, sensor in enumerate(self.sensors):
            if sensor.sensing is None:
                continue
            here = slice(self._layout.row[k], self._layout.row[k + 1])
            value[here] = sensor.sensing(strain).detach().numpy()
            if slopes:
                slope[here] = torch.autograd.functional.jacobian(sensor.sensing, strain).numpy()
        return value, slope
