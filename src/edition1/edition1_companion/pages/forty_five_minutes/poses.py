"""Calibration by motion against calibration with measured poses, on robots that are not as described (synthetic).

Moments, gains and offsets of a robot are off by what ``repro calibrate --self`` believes, and in one of two cases the
place of its parts and the Earth field by their tolerances as well; both ways of calibration know which. The robot is
calibrated from a motion, or with poses that are known as well as ``repro calibrate`` assumes. Then another motion is
estimated from its Hall sensors by least squares. All fields come from magpylib, IMUs err as on the rest of the page.
The code that did this is that of the last commit of the first edition.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from edition1.estimation.levenberg_marquardt import jacobian
from edition1.kinematics.motion import tip_motion
from edition1.robot_file.load import load_robot
from edition1.robot_file.robot_file import RobotFile
from edition1_companion.book.project import find_project

RATE_HZ = 5.0
"""Of all motions: five minutes then have as many time steps as ``repro calibrate --self`` uses."""
TEST_S = 120.0
POSES, POSE_M, POSE_RAD = 100, 0.2e-3, float(np.radians(0.5))
"""How many poses, and how well they are known: what ``repro calibrate`` assumes."""
SENSORS = ("magnets", "magnets and IMUs", "magnets, IMUs and length")
"""What motion teaches from; with the length, every segment stays as long as poses would know it to be."""
STRAIGHT = ("magnets, straight at first", "magnets and IMUs, straight at first")
"""The same motion, of which it is known that it begins straight, in the middle of the elongation."""


def stated_percent(robot: RobotFile, q: Float[Tensor, "t n_q"], error: Float[Tensor, "t s s"]) -> float:
    """Root mean square error of the tip in percent of the length, by noise and a covariance of readings' errors."""
    _, by_q = jacobian(robot.sensing(), q)
    to_tip = tip_motion(robot.robot, q)[1] @ torch.linalg.pinv(by_q)
    C = to_tip @ (error + robot.noise**2 * torch.eye(by_q.shape[-2]).double()) @ to_tip.mT
    return 100 / robot.robot.length * float(C.diagonal(dim1=-2, dim2=-1).sum(-1).mean().sqrt())


def described(name: str) -> RobotFile:
    """The robot of a file in ``data/robots``, read at `RATE_HZ`."""
    return replace(load_robot(find_project().data / "robots" / f"{name}.toml"), rate_hz=RATE_HZ)
