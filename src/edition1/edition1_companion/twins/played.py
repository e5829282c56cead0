"""What the board of a robot of Baaij et al. sends, with the truth beside it; synthetic."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float
from torch import Tensor

from edition1.errors import bad_input, require
from edition1.kinematics.paper_robots import pcc_robot
from edition1.robot_file.robot_file import RobotFile
from edition1.sensing.magnetic import readings as field_readings
from edition1_companion.twins.takes import Take, carried, even
from edition1_companion.twins.trajectories import lemniscate

PERIOD_S = 10.0
"""Duration of the lemniscate T3 [s]."""


@dataclass(frozen=True)
class Played:
    """What a board sends, and the truth.

    Attributes
    ----------
    robot
        Whose readings.
    take
        What is sent; its sequence numbers count the rows.
    q
        Configurations, one for each row.
    """

    robot: RobotFile
    take: Take
    q: Float[Tensor, "readings n_q"]


def played(robot: RobotFile, *, rate_hz: float, seconds: float, seed: int) -> Played:
    """Return noisy readings on the lemniscate T3 of a robot of Baaij et al., as its board sends them.

    Parameters
    ----------
    robot
        Segments of constant curvature with ring magnets.
    rate_hz
        Readings per second.
    seconds
        How long, at most 10 s.
    seed
        Of the noise.

    Raises
    ------
    InputError
        If the robot is another one, or there is less than one reading.
    """
    n = len(robot.robot.segments)
    if robot.magnet is None or robot.robot.n_q != 3 * n or robot.format != "frames":
        raise bad_input("robot", "played", "one of Baaij et al. that sends frames", robot.name)
    count = round(rate_hz * seconds)
    if not 1 <= count <= rate_hz * PERIOD_S:
        raise bad_input("seconds", "played", f"of one reading at least, {PERIOD_S:g} at most", seconds)
    q = lemniscate(n, steps=round(rate_hz * PERIOD_S))[:count]
    u = field_readings(robot.robot, q, robot.magnet, earth_mt=robot.earth_mt).numpy() * robot.gain.numpy()
    u += robot.offset.numpy() + robot.noise * np.random.default_rng(seed).standard_normal(u.shape)
    values = np.zeros((count, robot.channels))
    values[:, list(robot.channel)] = u
    label = f"lemniscate T3 of {robot.name} [{robot.unit}], SYNTHETIC"
    take = even(label, "frames", carried("frames", values), rate_hz)
    return Played(replace(robot, rate_hz=rate_hz), take, q)


def with_sensors(robot: RobotFile, sensors: int) -> RobotFile:
    """Return a robot with another number of sensors in the tip plane of its only segment."""
    require(len(robot.robot.segments) == 1, "robot", "with_sensors", "one of one segment", robot.name)
    return replace(
        robot,
        robot=replace(robot.robot, sensors=pcc_robot(1, sensors).sensors),
        channels=sensors,
        channel=tuple(range(sensors)),
        gain=robot.gain[:1].expand(sensors).clone(),
        offset=robot.offset[:1].expand(sensors).clone(),
    )
