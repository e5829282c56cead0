"""Readings in known poses are checked before anything is calibrated with them."""

from __future__ import annotations

from torch import Tensor

from edition1 import se3
from edition1.errors import bad_input, require
from edition1.kinematics.robot import Robot


def check_readings(owner: str, robot: Robot, q: Tensor, u: Tensor) -> None:
    """Refuse readings that are not one finite number for each sensor of the robot in each pose.

    Raises
    ------
    InputError
        As said.
    """
    require(q.shape[-1] == robot.n_q, "q", owner, f"of last dimension {robot.n_q}", f"shape {tuple(q.shape)}")
    expected = (*q.shape[:-1], len(robot.sensors))
    if q.ndim < 2 or u.shape != expected:
        words = f"one reading for each of {len(robot.sensors)} sensors in each pose, shape {expected}"
        raise bad_input("u", owner, words, f"shape {tuple(u.shape)}")
    se3.require_finite(q, "q", owner)
    se3.require_finite(u, "u", owner)
