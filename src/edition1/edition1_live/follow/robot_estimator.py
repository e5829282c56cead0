"""Any estimator for a described robot: made from its file, and fed with time steps."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from edition1.errors import bad_input, require
from edition1.estimation.base import Estimate, Estimator, kernel
from edition1.estimation.gradient_descent import GradientDescent
from edition1.estimation.kalman_filter import IteratedKalmanFilter
from edition1.estimation.levenberg_marquardt import LevenbergMarquardt, jacobian
from edition1.estimation.model_error import WithModelError
from edition1.estimation.monitor import Monitored
from edition1.estimation.multistart import starts_within
from edition1.estimation.orientations import UPRIGHT
from edition1.estimation.particle_filter import ParticleFilter
from edition1.estimation.regions import Box
from edition1.kernels import compiled
from edition1.robot_file.columns import MAGNETIC_STREAM
from edition1.robot_file.robot_file import RobotFile
from edition1.sensing.magnetic import MagneticSensing
from edition1.sensing.own_model import Given, OwnModel
from edition1.sensing.stacked import StackedSensing
from edition1_live.follow import imu_streams
from edition1_live.follow.time_steps import TimeStep

ESTIMATORS = ("levenberg_marquardt", "kalman", "gradient_descent", "particle_filter", "imu_chain")
"""The first is that of magnetic sensors, the last that of IMUs."""
ACCELERATION_SHARE, VELOCITY_SHARE = 0.2, 0.5
"""Of the Kalman filter, in widths of the bounds: as chosen on T2 for the robots of Baaij et al."""
_MOST_PARTICLE_COORDINATES = 4
_PARTICLES = 500
_MOVE_SHARE = 0.5
"""Random walk of a particle in one second, in widths of the bounds."""
_STARTS = 8
"""Configurations from which a monitor looks for a better start, besides where the robot starts."""
_LOOK_S, _SLOW_LOOK_S = 0.25, 5.0
"""Time between two looks of the monitor for what is wrong, and with a model of one's own, whose fits are slow [s]."""


@dataclass(frozen=True)
class RobotEstimator:
    """An estimator that takes the frames of a robot.

    Parameters
    ----------
    robot
        As described, and calibrated.
    name
        One of :data:`ESTIMATORS`.
    method
        The estimator; its ``q`` is the configuration of the robot, or for ``imu_chain`` the positions of points
        along it.
    start
        Where it starts.
    streams
        Streams of the frames of a time step.
    use
        Which readings to use.
    stacked
        Sensor model of magnetic sensors and IMUs together, whose readings are in units of their noise; none where
        there are only the ones or the others.
    grown
        How many times the deviations that it states are stated here: the band that holds, see
        :mod:`edition1.estimation.conformal`.
    """

    robot: RobotFile
    name: str
    method: Monitored[Any]
    start: Float[Tensor, " n_q"]
    streams: tuple[int, ...]
    use: Bool[Tensor, " readings"]
    stacked: StackedSensing | None = None
    grown: float = 1.0

    def __post_init__(self) -> None:
        require(0 < self.grown < math.inf, "grown", "repro live", "a positive number", self.grown)

    def stated(self, estimate: Estimate) -> Estimate:
        """Return an estimate with the covariance that is stated of it."""
        if estimate.covariance is None or self.grown == 1.0:
            return estimate
        return replace(estimate, covariance=self.grown**2 * estimate.covariance)

    @property
    def positions(self) -> bool:
        """Whether the estimates are positions of points, not configurations."""
        return self.name == "imu_chain"

    @property
    def sensors(self) -> tuple[str, ...]:
        """Names of the sensors, in the order of :meth:`missing`."""
        magnetic = tuple(f"sensor {k + 1}" for k in range(len(self.robot.channel)))
        return magnetic + tuple(f"IMU {imu.stream}" for imu in self.robot.imus)

    def readings(self, step: TimeStep) -> Float[Tensor, " readings"]:
        """What the estimator takes of a time step; NaN where a reading is missing.

        Raises
        ------
        InputError
            If a frame has another number of values than the robot file says.
        """
        if self.stacked is not None:
            return imu_streams.readings(self.robot, self.stacked, step)
        if not self.positions:
            (frame,) = step.frames
            assert frame is not None  # with one stream a step is one frame
            return self.robot.signal(frame.values)
        return imu_streams.quaternions(self.robot, step)

    def shown(self, u: Float[Tensor, " readings"]) -> Float[Tensor, " sensors"]:
        """Readings to draw, one for each sensor: in its unit, of an IMU how far the robot leans there [deg]."""
        if self.stacked is not None:
            return imu_streams.shown(self.robot, self.stacked, u)
        if not self.positions:
            return u
        x, y = u.unflatten(-1, (-1, 4))[1:, :2].unbind(-1)
        return torch.rad2deg(torch.arccos((1 - 2 * (x * x + y * y)).clamp(-1, 1)))

    def missing(self, u: Float[Tensor, " readings"]) -> list[bool]:
        """Whether each sensor gave no number, without those that shall not be used."""
        return self._by_sensor(torch.isnan(u) & self.use)

    @property
    def redundancy(self) -> tuple[int, int]:
        """Number of independent readings in use, and of unknowns; of a chain of IMUs, which follows each, as many."""
        readings = int(self.use.sum())
        if self.positions:
            return readings, readings
        if self.stacked is not None:
            readings -= int(imu_streams.redundant(self.robot, self.use))
        return readings, len(self.robot.lower)

    @property
    def used(self) -> list[bool]:
        """Whether each sensor is used."""
        return self._by_sensor(self.use)

    def _by_sensor(self, flags: Bool[Tensor, " readings"]) -> list[bool]:
        if self.stacked is not None:
            return imu_streams.by_sensor(self.robot, flags)
        return (flags.unflatten(-1, (-1, 4)).any(-1)[1:] if self.positions else flags).tolist()

    def prepared(self) -> None:
        """Estimate once from readings made up: kernels are compiled now, not when the first frame waits."""
        if self.positions:
            u = torch.tensor(UPRIGHT * (len(self.streams) + 1), dtype=torch.float64)
        else:
            u = (self.stacked or self.robot.sensing())(self.start)
        state = self.method.init(self.start, seed=0)
        for k in range(2):
            state, _ = self.method.step(state, u, 0.1 * k, mask=self.use)


def robot_estimator(
    robot: RobotFile,
    name: str = "",
    *,
    failed: Sequence[int] = (),
    model: Given | Sequence[Given] | None = None,
    inputs: str = "cosines",
) -> RobotEstimator:
    """Make an estimator for a robot.

    Least squares, the Kalman filter and gradient descent are compiled, but for a sensor model of one's own: that runs
    in torch, so an estimate takes some 50 ms instead of 1.

    Parameters
    ----------
    robot
        As described, and calibrated.
    name
        One of :data:`ESTIMATORS`; by default the one for the sensors of the robot.
    failed
        Numbers of sensors not to use, from 1 (IMUs: from 1 at the base, after the magnetic sensors if there are any).
    model
        A sensor model of your own, as for :meth:`edition1.robot_file.robot_file.RobotFile.sensing`: a module of torch,
        TorchScript or the path of its file, any callable, or a list of them.
    inputs
        Whether that model takes relations as ``"cosines"`` or as ``"angles"``.

    Raises
    ------
    InputError
        If there is no such estimator, it does not fit the robot, or no such sensor or none is left.

    Examples
    --------
    >>> from edition1.robot_file.load import load_robot
    >>> robot_estimator(load_robot("data/robots/one_segment.toml")).name
    'levenberg_marquardt'
    """
    magnetic = bool(robot.channel)
    name = name or ESTIMATORS[0 if magnetic else -1]
    require(name in ESTIMATORS, "estimator", "repro live", f"one of {', '.join(ESTIMATORS)}", name)
    if magnetic == (name == "imu_chain"):
        fitting = ESTIMATORS[:-1] if magnetic else ESTIMATORS[-1:]
        sensors = "magnetic sensors" if magnetic else "IMUs"
        expected = f"{' or '.join(fitting)} for the {sensors} of {robot.name}"
        raise bad_input("estimator", "repro live", expected, name)
    n = len(robot.channel) + len(robot.imus)
    if wrong := [k for k in failed if not 1 <= k <= n]:
        raise bad_input("failed", "repro live", f"numbers of sensors, 1 to {n}", wrong[0])
    require(len(set(failed)) != n, "failed", "repro live", f"fewer than all {n} sensors", f"{n} of them")
    works = torch.tensor([k + 1 not in failed for k in range(n)])
    if not magnetic:
        method, use = imu_streams.chain(robot), torch.cat([torch.tensor([True]), works]).repeat_interleave(4)
        start = torch.zeros(3 * len(method.arc_lengths), dtype=torch.float64)
        watched = Monitored(method, method, start[None], robot.rate_hz)
        return RobotEstimator(robot, name, watched, start, tuple(imu.stream for imu in robot.imus), use)
    sensing = robot.sensing(model, inputs=inputs)
    own = isinstance(sensing, MagneticSensing) and isinstance(sensing.model, OwnModel)
    noise, stacked, use = robot.noise, None, works
    if robot.imus:
        stacked, use, noise = imu_streams.stacked(robot, sensing), imu_streams.by_reading(robot, works), 1.0
    seen = (stacked or sensing) if own else compiled(stacked or sensing)
    solver = LevenbergMarquardt(seen, robot.lower, robot.upper, noise_mt=noise)
    watched = monitored(robot, name, solver)
    streams = (MAGNETIC_STREAM, *(imu.stream for imu in robot.imus))
    return RobotEstimator(robot, name, watched, robot.start, streams, use, stacked)


def monitored(robot: RobotFile, name: str, solver: LevenbergMarquardt) -> Monitored[Any]:
    """Estimator for magnetic sensors, watched, and with the error of the model, if the robot knows it.

    Parameters
    ----------
    robot
        Whose readings these are.
    name
        One of :data:`ESTIMATORS`.
    solver
        Least squares with the sensor model, which looks for other starts. In torch the model is one of the user's:
        slow, and of an error that nobody knows.
    """
    method, own = _magnetic(robot, name, solver), kernel(solver.sensing) is None
    pair: tuple[Estimator[Any], Estimator[Any]] = (method, solver)
    if robot.error is not None and not own:
        box = (robot.lower, robot.upper)
        own_box = None if isinstance(method, GradientDescent) else box
        error = imu_streams.error_beside(robot) if robot.imus else robot.error
        given = (solver.sensing, solver.noise_mt, error)
        pair = (
            WithModelError(method, *given, own_box),
            WithModelError(solver, *given, box),
        )
    starts = torch.cat([robot.start[None], starts_within(robot.lower, robot.upper, _STARTS, seed=0)])
    options: dict[str, Any] = {"unknowns": len(robot.lower), "look_s": _SLOW_LOOK_S if own else _LOOK_S}
    if robot.imus:
        n = len(robot.channel) + len(robot.imus)
        options["sensors"] = torch.stack(
            [imu_streams.by_reading(robot, torch.arange(n) == k) for k in range(n)]
        )
        pair = (imu_streams.Counted(pair[0], robot), imu_streams.Counted(pair[1], robot))
    return Monitored(pair[0], pair[1], starts, robot.rate_hz, **options)


def _magnetic(robot: RobotFile, name: str, solver: LevenbergMarquardt) -> Estimator[Any]:
    sensing, low, high, noise = solver.sensing, robot.lower, robot.upper, solver.noise_mt
    width = high - low
    if name == "levenberg_marquardt":
        return solver
    if name == "kalman":
        acceleration, velocity = ACCELERATION_SHARE * width, VELOCITY_SHARE * width
        return IteratedKalmanFilter(sensing, low, high, acceleration, velocity, noise_mt=noise)
    if name == "gradient_descent":
        return GradientDescent(sensing, _step_size(robot, sensing), noise_mt=noise)
    if len(low) > _MOST_PARTICLE_COORDINATES:
        expected = (
            f"another one for {robot.name}: particles fill at most {_MOST_PARTICLE_COORDINATES} coordinates"
        )
        raise bad_input("estimator", "repro live", expected, f"{name} for {len(low)}")
    walk = _MOVE_SHARE * width / robot.rate_hz**0.5
    options = {"particles": _PARTICLES, "region": Box(low, high), "estimate": "Gauss-Newton"}
    return ParticleFilter(sensing, walk, noise, **options)


def _step_size(robot: RobotFile, sensing: Callable[[Tensor], Tensor]) -> Float[Tensor, " n_q"]:
    r"""Steps that are stable where the robot starts, and with any one coordinate at a bound.

    With ``n`` coordinates the loss, scaled by its own curvatures, curves by at most ``n`` in any direction.
    """
    ends = torch.where(torch.eye(len(robot.lower), dtype=torch.bool), robot.lower, robot.start)
    ends = torch.cat([ends, torch.where(torch.eye(len(ends), dtype=torch.bool), robot.upper, robot.start)])
    _, J = jacobian(sensing, torch.cat([ends, robot.start[None]]))
    curvature = 2 * J.square().mean(-2).amax(0)
    return 1 / (len(robot.lower) * curvature.clamp_min(torch.finfo(J.dtype).tiny))
