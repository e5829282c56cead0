"""Any estimator for a described robot: made from its file, and fed with time steps."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from repro.errors import InputError, bad_input
from repro.estimation.base import Estimate, Estimator
from repro.estimation.gradient_descent import GradientDescent
from repro.estimation.imu_models import exact_arcs
from repro.estimation.imu_selection import Selection
from repro.estimation.imu_shape import ImuShape
from repro.estimation.kalman_filter import IteratedKalmanFilter
from repro.estimation.levenberg_marquardt import LevenbergMarquardt, jacobian
from repro.estimation.model_error import WithModelError
from repro.estimation.particle_filter import ParticleFilter
from repro.estimation.regions import Box
from repro.live.follow.time_steps import TimeStep
from repro.live.robot.robot_file import RobotFile
from repro.report.robot_view import POINTS_PER_SEGMENT

ESTIMATORS = ("levenberg_marquardt", "kalman", "gradient_descent", "particle_filter", "imu_chain")
"""The first is that of magnetic sensors, the last that of IMUs."""
MAGNETIC_STREAM = 0
"""Stream of the frames that hold the readings of magnetic sensors."""
ACCELERATION_SHARE, VELOCITY_SHARE = 0.2, 0.5
"""Of the Kalman filter, in widths of the bounds: as chosen on T2 for the robots of Baaij et al."""
MOST_PARTICLE_COORDINATES = 4
PARTICLES = 500
MOVE_SHARE = 0.5
"""Random walk of a particle in one second, in widths of the bounds."""
IMU_NOISE_RAD = 0.0035
"""Standard deviation of an orientation about each axis, 0.2 degrees, assumed [rad]."""
FREE_BASE = (0.0, 0.0, 0.0, 1.0)
"""Orientation of the base: upright."""


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
    """

    robot: RobotFile
    name: str
    method: Estimator[Any]
    start: Float[Tensor, " n_q"]
    streams: tuple[int, ...]
    use: Bool[Tensor, " readings"]

    @property
    def positions(self) -> bool:
        """Whether the estimates are positions of points, not configurations."""
        return self.name == "imu_chain"

    @property
    def sensors(self) -> tuple[str, ...]:
        """Names of the sensors, in the order of :meth:`missing`."""
        if self.positions:
            return tuple(f"IMU {stream}" for stream in self.streams)
        return tuple(f"sensor {k + 1}" for k in range(len(self.robot.channel)))

    def readings(self, step: TimeStep) -> Float[Tensor, " readings"]:
        """What the estimator takes of a time step; NaN where a reading is missing.

        Raises
        ------
        InputError
            If a frame has another number of values than the robot file says.
        """
        if not self.positions:
            (frame,) = step.frames
            assert frame is not None  # with one stream a step is one frame
            return self.robot.signal(frame.values)
        rows: list[Sequence[float]] = [FREE_BASE]
        for frame in step.frames:
            if frame is not None and len(frame.values) != len(FREE_BASE):
                expected = f"a quaternion of 4 values, as described in {self.robot.name}"
                raise bad_input("frame", "the stream", expected, f"{len(frame.values)} values")
            rows.append([float("nan")] * len(FREE_BASE) if frame is None else frame.values)
        return torch.tensor(rows, dtype=torch.float64).flatten()

    def missing(self, u: Float[Tensor, " readings"]) -> list[bool]:
        """Whether each sensor gave no number, without those that shall not be used."""
        gone = torch.isnan(u) & self.use
        if self.positions:
            gone = gone.unflatten(-1, (-1, len(FREE_BASE))).any(-1)[1:]
        return gone.tolist()

    def prepared(self) -> None:
        """Estimate once from readings made up: kernels are compiled now, not when the first frame waits."""
        if self.positions:
            u = torch.tensor([FREE_BASE] * (len(self.streams) + 1), dtype=torch.float64).flatten()
        else:
            u = self.robot.sensing()(self.start)
        state = self.method.init(self.start, seed=0)
        for k in range(2):
            state, _ = self.method.step(state, u, 0.1 * k, mask=self.use)


def robot_estimator(
    robot: RobotFile,
    name: str = "",
    *,
    failed: Sequence[int] = (),
    model: Callable[[Tensor], Tensor] | None = None,
) -> RobotEstimator:
    """Make an estimator for a robot.

    Least squares, the Kalman filter and gradient descent are compiled, but for a sensor model of one's own.

    Parameters
    ----------
    robot
        As described, and calibrated.
    name
        One of :data:`ESTIMATORS`; by default the one for the sensors of the robot.
    failed
        Numbers of sensors not to use, from 1 (IMUs: from 1 at the base).
    model
        A sensor model of your own, as for :meth:`repro.live.robot.robot_file.RobotFile.sensing`.

    Raises
    ------
    InputError
        If there is no such estimator, it does not fit the robot, or no such sensor or none is left.

    Examples
    --------
    >>> from repro.live.robot.robot_file import load_robot
    >>> robot_estimator(load_robot("data/robots/one_segment.toml")).name
    'levenberg_marquardt'
    """
    magnetic = bool(robot.channel)
    name = name or ESTIMATORS[0 if magnetic else -1]
    if name not in ESTIMATORS:
        raise bad_input("estimator", "repro live", f"one of {', '.join(ESTIMATORS)}", name)
    if magnetic == (name == "imu_chain"):
        fitting = ESTIMATORS[:-1] if magnetic else ESTIMATORS[-1:]
        sensors = "magnetic sensors" if magnetic else "IMUs"
        expected = f"{' or '.join(fitting)} for the {sensors} of {robot.name}"
        raise bad_input("estimator", "repro live", expected, name)
    n = len(robot.channel) if magnetic else len(robot.imus)
    if wrong := [k for k in failed if not 1 <= k <= n]:
        raise bad_input("failed", "repro live", f"numbers of sensors, 1 to {n}", wrong[0])
    if len(set(failed)) == n:
        raise bad_input("failed", "repro live", f"fewer than all {n} sensors", f"{n} of them")
    works = torch.tensor([k + 1 not in failed for k in range(n)])
    if not magnetic:
        method, use = _imu_chain(robot), torch.cat([torch.tensor([True]), works]).repeat_interleave(4)
        start = torch.zeros(3 * len(method.arc_lengths), dtype=torch.float64)
        return RobotEstimator(robot, name, method, start, tuple(imu.stream for imu in robot.imus), use)
    method = _magnetic(robot, name, model)
    if robot.error is not None and model is None:
        bounds = None if name == "gradient_descent" else (robot.lower, robot.upper)
        method = WithModelError(method, robot.sensing(), robot.noise, robot.error, bounds, "compiled")
    return RobotEstimator(robot, name, method, robot.start, (MAGNETIC_STREAM,), works)


def _magnetic(robot: RobotFile, name: str, model: Callable[[Tensor], Tensor] | None) -> Estimator[Any]:
    sensing, low, high = robot.sensing(model), robot.lower, robot.upper
    width, backend = high - low, "torch" if model is not None else "compiled"
    if name == "levenberg_marquardt":
        return LevenbergMarquardt(sensing, low, high, noise_mt=robot.noise, backend=backend)
    if name == "kalman":
        acceleration, velocity = ACCELERATION_SHARE * width, VELOCITY_SHARE * width
        options = {"noise_mt": robot.noise, "backend": backend}
        return IteratedKalmanFilter(sensing, low, high, acceleration, velocity, **options)
    if name == "gradient_descent":
        return GradientDescent(sensing, _step_size(robot, sensing), backend=backend)
    if len(low) > MOST_PARTICLE_COORDINATES:
        expected = (
            f"another one for {robot.name}: particles fill at most {MOST_PARTICLE_COORDINATES} coordinates"
        )
        raise bad_input("estimator", "repro live", expected, f"{name} for {len(low)}")
    walk = MOVE_SHARE * width / robot.rate_hz**0.5
    options = {"particles": PARTICLES, "region": Box(low, high), "estimate": "Gauss-Newton"}
    return ParticleFilter(sensing, walk, robot.noise, **options)


def _step_size(robot: RobotFile, sensing: Callable[[Tensor], Tensor]) -> Float[Tensor, " n_q"]:
    r"""Steps that are stable where the robot starts, and with any one coordinate at a bound.

    With ``n`` coordinates the loss, scaled by its own curvatures, curves by at most ``n`` in any direction.
    """
    ends = torch.where(torch.eye(len(robot.lower), dtype=torch.bool), robot.lower, robot.start)
    ends = torch.cat([ends, torch.where(torch.eye(len(ends), dtype=torch.bool), robot.upper, robot.start)])
    _, J = jacobian(sensing, torch.cat([ends, robot.start[None]]))
    curvature = 2 * J.square().mean(-2).amax(0)
    return 1 / (len(robot.lower) * curvature.clamp_min(torch.finfo(J.dtype).tiny))


def _imu_chain(robot: RobotFile) -> ImuShape:
    arcs = [imu.arc_m for imu in robot.imus]
    if arcs[0] == 0:
        expected = "above 0: the base is upright by itself, an IMU there tells nothing"
        raise bad_input("at_mm of IMU 1", robot.name, expected, "0")
    ends = (0.0, *arcs)
    selection = Selection(tuple(range(len(ends))), ends, tuple(b - a for a, b in pairwise(ends)), sub_links=1)
    n = (POINTS_PER_SEGMENT - 1) * len(robot.robot.segments)
    points = tuple(arcs[-1] * (k + 1) / n for k in range(n))
    return ImuShape(exact_arcs, selection, points, IMU_NOISE_RAD)


class Follower:
    """Steps an estimator from one time step to the next, and counts what it could not use.

    Parameters
    ----------
    estimator
        What to step.
    seed
        Of estimators that draw random numbers.

    Attributes
    ----------
    estimated
        Time steps with an estimate.
    missing
        For every sensor, time steps in which it gave no number.
    refused
        Time steps without an estimate: no reading was a number, or one was infinite, or no orientation.
    refusal
        Why the last of these was refused.
    """

    def __init__(self, estimator: RobotEstimator, *, seed: int = 0) -> None:
        self.estimator = estimator
        self.estimated = self.refused = 0
        self.refusal = ""
        self.missing = [0] * len(estimator.sensors)
        self._state = estimator.method.init(estimator.start, seed=seed)

    def step(self, step: TimeStep) -> tuple[Float[Tensor, " readings"], Estimate | None]:
        """Return the readings of a time step, and the estimate; none where the readings cannot be used.

        Raises
        ------
        InputError
            If a frame has another number of values than the robot file says.
        """
        u = self.estimator.readings(step)
        for k, gone in enumerate(self.estimator.missing(u)):
            self.missing[k] += gone
        try:
            self._state, estimate = self.estimator.method.step(
                self._state, u, step.time_s, mask=self.estimator.use
            )
        except InputError as error:
            self.refused += 1
            self.refusal = str(error)
            return u, None
        self.estimated += 1
        return u, estimate
