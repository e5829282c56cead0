r"""A Kalman filter that calibrates its sensors while the robot moves.

Its state is :math:`(q, b, \dot q)`. The configuration moves as in
:class:`~edition1.estimation.kalman_filter.IteratedKalmanFilter`; every error :math:`b` of a magnet, a Hall sensor or an
IMU wanders from what it was at the start,

.. math:: \dot b = -b/T + w, \qquad E[w(t)\,w(t')] = s^2\,\delta(t - t'),

a random walk for :math:`T = \infty`. What no reading tells apart (the moment of a magnet and the gains of all who see
it) stays as uncertain as its prior lets it; :meth:`SelfCalibratingFilter.undetermined` says it by name.

What no state explains must not bend the shape. If the surprise of the readings is beyond chance, or an error that
fades has left its own distribution, the Hall sensors are left out until they agree with the IMUs again.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from edition1 import se3
from edition1.errors import bad_input
from edition1.estimation._step import conditioned
from edition1.estimation._window import limit
from edition1.estimation.base import Estimate, check_start, usable
from edition1.estimation.kalman_filter import KalmanState
from edition1.estimation.wander import Errors, Wander, errors
from edition1.kernels._motion import array, chain
from edition1.kernels._self_calibration import Parts, drift, take_in
from edition1.kinematics.mounts import Mounts
from edition1.kinematics.robot import Robot
from edition1.sensing.seen_directions import SeenDirections

_CALM_S = 10.0
"""Hall sensors that were left out count again after agreeing for so long [s]."""
_AGREES = 1e-3
"""They agree unless chance explains their surprise more rarely than this."""


@dataclass(frozen=True)
class SelfCalibratingState(KalmanState):
    """State of the filter, its errors behind ``q``; ``calm_s`` is NaN, or how long left-out Hall sensors agree."""

    calm_s: Float[Tensor, "*batch"] | None = None


@dataclass(frozen=True)
class SelfCalibratingFilter:
    r"""Estimator of a configuration by Hall sensors and IMUs whose errors wander.

    Readings are those of the robot's Hall sensors [mT], then a rotation vector [rad] from each IMU to the base. An
    estimate holds the configuration; its diagnostics hold the errors as ``errors`` with their ``errors_std``, and
    ``flag``: whether the Hall sensors are left out.

    Parameters
    ----------
    robot
        With its magnets and sensors, if it has any.
    lower, upper, acceleration, velocity
        Of the configuration, as in :class:`~edition1.estimation.kalman_filter.IteratedKalmanFilter`.
    wanders
        The errors; what is not named is as drawn.
    moments
        Of the magnets [mT m^(l+2)], one row for all or a row for each.
    imus
        Mounts of the IMUs.
    earth_mt
        Field in the base frame [mT]; none when not given. The z axis of that frame is the vertical of the IMUs.
    noise_mt, imu_noise_rad
        White noise of a Hall sensor, and of an IMU about each axis.
    iterations
        Largest number of linearisations in an update.
    gate
        Chance of a false flag at a reading, if model and noise are right; none to take in whatever is read.

    Raises
    ------
    InputError
        If there is nothing to read, or a number is not positive or does not fit the robot.

    Examples
    --------
    A tip that is held straight, and an IMU there that says it has turned: its heading has.

    >>> import edition1 as repro
    >>> one = torch.ones(3, dtype=torch.float64)
    >>> robot = repro.Robot((repro.ConstantCurvature(0.11, 0.022),))
    >>> options = {"imus": repro.magnet_mounts([0], [0.11]), "wanders": [repro.Wander("heading", 0.1)]}
    >>> method = repro.SelfCalibratingFilter(robot, -0.02 * one, 0.02 * one, one, one, **options)
    >>> turned, straight = torch.tensor([0.0, 0.0, 0.05], dtype=torch.float64), 0 * one
    >>> _, estimate = method.step(method.init(straight), turned, 0.0)
    >>> estimate.diagnostics["errors"].round(decimals=3)
    tensor([0.0500], dtype=torch.float64)
    """

    robot: Robot
    lower: Float[Tensor, " n_q"]
    upper: Float[Tensor, " n_q"]
    acceleration: Float[Tensor, " n_q"]
    velocity: Float[Tensor, " n_q"]
    wanders: Sequence[Wander] = ()
    moments: Float[Tensor, "*m terms"] | None = None
    imus: Mounts | None = None
    earth_mt: Float[Tensor, " 3"] | None = None
    noise_mt: float = 1e-3
    imu_noise_rad: float = 1e-3
    iterations: int = 3
    gate: float | None = None

    def __post_init__(self) -> None:
        owner, n_q = "SelfCalibratingFilter", self.robot.n_q
        for name in ("lower", "upper", "acceleration", "velocity"):
            if getattr(self, name).shape != (n_q,):
                shape = f"shape {tuple(getattr(self, name).shape)}"
                raise bad_input(name, owner, f"one for each of {n_q} coordinates", shape)
        for name in ("acceleration", "velocity", "noise_mt", "imu_noise_rad", "iterations"):
            if not bool((torch.as_tensor(getattr(self, name)) > 0).all()):
                raise bad_input(name, owner, "positive", getattr(self, name))
        if self.gate is not None and not 0 < self.gate < 1:
            raise bad_input("gate", owner, "between 0 and 1, or none", self.gate)
        if self.n_hall and (not len(self.robot.magnets) or self.moments is None):
            raise bad_input("moments", owner, "those of some magnets that the Hall sensors see", "none")
        n_m = len(self.robot.magnets)
        if self.moments is not None and self.moments.shape[:-1] not in ((), (1,), (n_m,)):
            shape = f"shape {tuple(self.moments.shape)}"
            raise bad_input("moments", owner, f"one row, or one for each of {n_m} magnets", shape)
        if self.earth_mt is not None and self.earth_mt.shape != (3,):
            raise bad_input("earth_mt", owner, "one vector", f"shape {tuple(self.earth_mt.shape)}")
        for name in ("moments", "earth_mt"):
            if (values := getattr(self, name)) is not None:
                se3.require_finite(values, name, owner)
        if not self.n_hall and not self.imus:
            raise bad_input("imus", owner, "some, or Hall sensors on the robot", "neither")

    @property
    def n_hall(self) -> int:
        """Number of Hall sensors."""
        return len(self.robot.sensors)

    @cached_property
    def errors(self) -> Errors:
        """What wanders, error by error."""
        n_i = 0 if self.imus is None else len(self.imus)
        return errors(self.wanders, len(self.robot.magnets), self.n_hall, n_i)

    @cached_property
    def _parts(self) -> Parts:
        robot, mounts = self.robot, self.robot.magnets.joined(self.robot.sensors)
        n_i = 0 if self.imus is None else len(self.imus)
        if self.imus is not None and n_i:
            any_direction = torch.eye(3).double()[:1].expand(n_i, 3)
            mounts = mounts.joined(SeenDirections(robot, self.imus, tuple(range(n_i)), any_direction).axes)
        links, _ = chain(robot, mounts)
        moments = torch.zeros(1, 1) if self.moments is None else self.moments
        moments = moments.expand(len(robot.magnets), moments.shape[-1])
        earth = torch.zeros(3) if self.earth_mt is None else self.earth_mt
        noise = [self.noise_mt] * self.n_hall + [self.imu_noise_rad] * (3 * n_i)
        return Parts(
            chain=links,
            moments=array(moments),
            gain=np.ones(self.n_hall),
            earth=array(earth),
            kind=self.errors.kind,
            which=self.errors.part,
            variance=np.square(np.array(noise)),
            low=array(self.lower),
            high=array(self.upper),
        )

    @cached_property
    def _before(self) -> np.ndarray:
        """Standard deviation of every state before any reading."""
        width = array(self.upper - self.lower) / math.sqrt(12)
        return np.concatenate([width, self.errors.start, array(self.velocity)])

    def init(self, q0: Float[Tensor, "*batch n_q"], *, seed: int = 0) -> SelfCalibratingState:
        """State at ``q0``, at rest, as calibrated; nothing is random, the seed has no effect."""
        check_start(q0, (self.lower, self.upper), "SelfCalibratingFilter", n_q=self.robot.n_q)
        batch = q0.shape[:-1]
        q = torch.cat([q0, q0.new_zeros(*batch, len(self.errors.names))], dim=-1)
        covariance = torch.from_numpy(np.diag(self._before**2)).expand(*batch, -1, -1)
        calm = torch.full(batch, math.nan, dtype=torch.float64)
        return SelfCalibratingState(q, torch.zeros_like(q0), covariance, None, calm)

    def step(
        self,
        state: SelfCalibratingState,
        u: Float[Tensor, "*batch s"],
        t: float,
        *,
        mask: Tensor | None = None,
        known: Tensor | None = None,
    ) -> tuple[SelfCalibratingState, Estimate]:
        """Predict to time ``t`` [s] and take in ``u``; an IMU of which a number is missing is left out whole.

        Raises
        ------
        InputError
            If ``t`` is not after the last step, ``u`` has another width than the sensors, a mask does not fit, a
            reading is infinite, no sensor is left, or the filter has lost the robot.
        """
        owner, s, n = "SelfCalibratingFilter", len(self._parts.variance), self.robot.n_q
        if state.t is not None and not t > state.t:
            raise bad_input("t", owner, f"after the last step, {state.t} s", t)
        if u.shape[-1] != s:
            raise bad_input("u", owner, f"of last dimension {s}", f"shape {tuple(u.shape)}")
        use, m = usable(u, mask, owner), state.q.shape[-1]
        batch = torch.broadcast_shapes(state.q.shape[:-1], u.shape[:-1])
        x, P, rows, used, calm = (
            array(y.expand((*batch, *y.shape[y.ndim - k :]))).reshape(-1, *y.shape[y.ndim - k :])
            for y, k in (
                (torch.cat([state.q, state.velocity], -1), 1),
                (state.covariance, 2),
                (u.detach(), 1),
                (use, 1),
                (torch.as_tensor(math.nan) if state.calm_s is None else state.calm_s, 0),
            )
        )
        held = None if known is None else array(known.expand(*batch, n)).reshape(-1, n)
        tau, parts, density = 0.0 if state.t is None else t - state.t, self._parts, array(self.acceleration)
        u_hat, chi2 = np.empty((len(x), s)), np.empty(len(x))
        for k in range(len(x)):
            if tau:
                drift(x[k], P[k], parts.low, parts.high, density, self.errors.walk, self.errors.rate, tau)
            if held is not None:
                x[k], P[k] = conditioned(x[k], P[k], held[k])
            try:
                x[k], P[k], chi2[k], calm[k] = self._gated(
                    x[k], P[k], rows[k], used[k], calm[k], tau, None if held is None else held[k], u_hat[k]
                )
            except np.linalg.LinAlgError as error:
                expected = "near enough to what the state predicts, or a filter that starts anew"
                raise bad_input("u", owner, expected, "readings that make the covariance singular") from error
        std = np.sqrt(np.diagonal(P, axis1=-2, axis2=-1)[:, n:m])
        x, P, u_hat, chi2, used, calm, std = (
            torch.from_numpy(y).reshape((*batch, *y.shape[1:])) for y in (x, P, u_hat, chi2, used, calm, std)
        )
        new = SelfCalibratingState(x[..., :m].to(state.q), x[..., m:].to(state.q), P, t, calm)
        diagnostics = {"masked": s - used.sum(-1), "chi2": chi2.to(state.q), "dof": used.sum(-1)}
        diagnostics |= {"errors": new.q[..., n:], "errors_std": std.to(state.q), "flag": ~calm.isnan()}
        covariance = P[..., :n, :n].clone().to(state.q)  # a view would keep all of P alive
        return new, Estimate(new.q[..., :n], covariance, u_hat.to(state.q), diagnostics)

    def undetermined(
        self, state: SelfCalibratingState, elapsed_s: float, threshold: float = 0.9
    ) -> list[str]:
        """What the readings of a time [s] since the start did not determine, in sentences; of one trajectory."""
        n, m = self.robot.n_q, state.q.shape[-1]
        return self.errors.undetermined(state.covariance[n:m, n:m].double().numpy(), elapsed_s, threshold)

    def _gated(
        self,
        x: np.ndarray,
        P: np.ndarray,
        u: np.ndarray,
        use: np.ndarray,
        calm: float,
        tau: float,
        held: np.ndarray | None,
        u_hat: np.ndarray,
    ) -> tuple[np.ndarray, np.ndarray, float, float]:
        """Update of one member, its chi-square, and how long left-out Hall sensors agree; they leave ``use``."""
        options = (self.iterations, u_hat)
        magnetic = np.arange(len(u)) < self.n_hall
        gate = self.gate if magnetic.any() and (use & ~magnetic).any() else None
        if gate is None or math.isnan(calm):
            mine = use.copy()
            y, C, chi2 = take_in(self._parts, x, P, u, mine, *options)
            fast = np.isfinite(self.errors.fast_std)
            out_of_range = ((y[self.robot.n_q :][: len(fast)][fast] / self.errors.fast_std[fast]) ** 2).sum()
            if gate is None or (
                chi2 <= limit(gate, int(mine.sum())) and out_of_range <= limit(gate, int(fast.sum()))
            ):
                use[:] = mine
                return y, C, chi2, math.nan
            x, P, calm = *self._released(x, P), 0.0
            if held is not None:
                x, P = conditioned(x, P, held)
        whole = take_in(self._parts, x, P, u, use.copy(), *options)[2]
        seen = int((use & magnetic).sum())
        use &= ~magnetic
        y, C, chi2 = take_in(self._parts, x, P, u, use, *options)
        calm = calm + tau if seen and whole - chi2 <= limit(_AGREES, seen) else 0.0
        return y, C, chi2, math.nan if calm >= _CALM_S else calm

    def _released(self, x: np.ndarray, P: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """State that keeps what is known of the lasting errors, and forgets how sure it was of all else."""
        keep = np.zeros(len(x), dtype=bool)
        keep[self.robot.n_q :][: len(self.errors.names)] = ~np.isfinite(self.errors.fast_std)
        y, C = x.copy(), np.diag(self._before**2)
        C[np.ix_(keep, keep)] = P[np.ix_(keep, keep)]
        y[self.robot.n_q :][~keep[self.robot.n_q :]] = 0.0
        return y, C
