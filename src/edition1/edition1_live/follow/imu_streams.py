"""Frames of IMUs, alone or beside those of magnetic sensors: the readings of a time step, and their models."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import torch
from jaxtyping import Bool, Float
from scipy.spatial.transform import Rotation
from torch import Tensor

from edition1.errors import bad_input
from edition1.estimation.base import Estimate, Estimator, usable
from edition1.estimation.imu_models import exact_arcs
from edition1.estimation.imu_selection import Selection
from edition1.estimation.imu_shape import ImuShape
from edition1.estimation.orientations import UPRIGHT
from edition1.robot_file.imu_readings import beside_imus
from edition1.robot_file.robot_file import RobotFile
from edition1.sensing.stacked import StackedSensing
from edition1_live.follow.time_steps import TimeStep
from edition1_live.view.robot_view import POINTS_PER_SEGMENT
from edition1_live.wire.frame import Frame


def chain(robot: RobotFile) -> ImuShape:
    """Estimator of a robot of IMUs alone.

    Raises
    ------
    InputError
        If there is an IMU at the base.
    """
    arcs = [imu.arc_m for imu in robot.imus]
    if arcs[0] == 0:
        expected = "above 0: the base is upright by itself, an IMU there tells nothing"
        raise bad_input("at_mm of IMU 1", robot.name, expected, "0")
    ends = (0.0, *arcs)
    selection = Selection(tuple(range(len(ends))), ends, tuple(b - a for a, b in pairwise(ends)), sub_links=1)
    n = (POINTS_PER_SEGMENT - 1) * len(robot.robot.segments)
    points = tuple(arcs[-1] * (k + 1) / n for k in range(n))
    return ImuShape(exact_arcs, selection, points, robot.imu_noise)


def quaternions(robot: RobotFile, step: TimeStep) -> Float[Tensor, " readings"]:
    """Orientations of the base and of the cross-sections of all IMUs in the base; NaN where nothing came.

    Raises
    ------
    InputError
        If a frame has another number of values than the robot file says.
    """
    rows: list[Sequence[float]] = [UPRIGHT]
    for imu, frame in zip(robot.imus, step.frames, strict=True):
        values = quaternion(robot, frame) or [math.nan] * len(UPRIGHT)
        rows.append(imu.in_cross_section(values, robot.base_orientation))
    return torch.tensor(rows, dtype=torch.float64).flatten()


def stacked(robot: RobotFile, magnetic: Callable[[Tensor], Tensor]) -> StackedSensing:
    """Sensor model of the magnetic sensors and the IMUs of a robot, each in units of its noise."""
    imus = robot.imus, robot.imu_noise, robot.base_orientation
    return beside_imus(magnetic, robot.noise, robot.robot, *imus)


def error_beside(robot: RobotFile) -> Callable[[Tensor], Tensor]:
    """Covariance of the readings of :func:`stacked` by the error of the magnetic model: that of IMUs has none."""
    n = sum(_components(robot))

    def error(q: Tensor) -> Tensor:
        assert robot.error is not None  # asked of robots that have one
        return torch.nn.functional.pad(robot.error(q) / robot.noise**2, (0, n, 0, n))

    return error


def readings(robot: RobotFile, model: StackedSensing, step: TimeStep) -> Float[Tensor, " readings"]:
    """What :func:`stacked` predicts of a time step, as measured; NaN where nothing came.

    Raises
    ------
    InputError
        If a frame has another number of values than the robot file says.
    """
    magnetic, *others = step.frames
    u = torch.full((len(robot.channel),), torch.nan, dtype=torch.float64)
    if magnetic is not None:
        u = robot.signal(magnetic.values)
    parts = [
        imu.seen(quaternion(robot, frame), robot.base_orientation)
        for imu, frame in zip(robot.imus, others, strict=True)
    ]
    return model.scaled([u, torch.cat(parts)])


def quaternion(robot: RobotFile, frame: Frame | None) -> Sequence[float] | None:
    """Return the four values of the frame of an IMU; none without one.

    Raises
    ------
    InputError
        If there are not four.
    """
    if frame is not None and len(frame.values) != len(UPRIGHT):
        expected = f"a quaternion of {len(UPRIGHT)} values, as described in {robot.name}"
        raise bad_input("frame", "the stream", expected, f"{len(frame.values)} values")
    return None if frame is None else frame.values


def _components(robot: RobotFile) -> list[int]:
    """Return how many numbers each IMU has in the model."""
    return [imu.components for imu in robot.imus]


def by_sensor(robot: RobotFile, flags: Bool[Tensor, " readings"]) -> list[bool]:
    """For every magnetic sensor its flag, and for every IMU whether any of its components has one."""
    n = len(robot.channel)
    return flags[:n].tolist() + [bool(part.any()) for part in flags[n:].split(_components(robot))]


def by_reading(robot: RobotFile, works: Bool[Tensor, " sensors"]) -> Bool[Tensor, " readings"]:
    """Flags of magnetic sensors and IMUs, repeated for every component of an IMU."""
    return works.repeat_interleave(torch.tensor([1] * len(robot.channel) + _components(robot)))


def redundant(robot: RobotFile, use: Bool[Tensor, "*batch readings"]) -> Tensor:
    """Return how many of the readings that are used are no numbers of their own: nine components are three angles.

    The sum of squared residuals, in units of the noise, has as many degrees of freedom fewer.
    """
    parts = use[..., len(robot.channel) :].split(_components(robot), dim=-1)
    counts = [part.shape[-1] - imu.freedoms for part, imu in zip(parts, robot.imus, strict=True)]
    whole = torch.stack([part.all(-1) for part in parts], dim=-1)
    return (whole * torch.tensor(counts)).sum(-1)


@dataclass(frozen=True)
class Counted:
    """Estimator of stacked readings that counts the components of an IMU as the angles which they are.

    Parameters
    ----------
    estimator
        Of the readings of :func:`stacked`.
    robot
        Their robot.
    """

    estimator: Estimator[Any]
    robot: RobotFile

    def init(self, q0: Tensor, *, seed: int = 0) -> Any:
        """State of the estimator itself."""
        return self.estimator.init(q0, seed=seed)

    def step(
        self, state: Any, u: Tensor, t: float, *, mask: Tensor | None = None, known: Tensor | None = None
    ) -> tuple[Any, Estimate]:
        """Step the estimator; ``dof`` in the diagnostics is lower by :func:`redundant`."""
        state, found = self.estimator.step(state, u, t, mask=mask, known=known)
        dof = found.diagnostics["dof"] - redundant(self.robot, usable(u, mask, "Counted"))
        return state, replace(found, diagnostics={**found.diagnostics, "dof": dof.clamp_min(0)})


def shown(
    robot: RobotFile, model: StackedSensing, u: Float[Tensor, " readings"]
) -> Float[Tensor, " sensors"]:
    """Readings to draw: of magnetic sensors in their unit, of IMUs how far the robot leans there [deg].

    It leans from the axis of the base; where the heading is free, from the vertical.
    """
    n, sigma = len(robot.channel), torch.as_tensor(model.noise[1])
    parts = (u[n:] * sigma).split(_components(robot))
    axes = Rotation.from_quat([imu.mounted for imu in robot.imus]).as_matrix()[
        :, 2
    ]  # the backbone as IMUs see it
    leans = [part[-3:] @ torch.from_numpy(axis) for part, axis in zip(parts, axes, strict=True)]
    return torch.cat([u[:n] * robot.noise, torch.rad2deg(torch.arccos(torch.stack(leans).clamp(-1, 1)))])
