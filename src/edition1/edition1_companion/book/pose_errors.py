"""How far an estimated shape is from the true one, in the units of whoever uses the robot."""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import Tensor

from edition1 import se3
from edition1.kinematics.robot import Robot


def pose_errors(
    robot: Robot, q_hat: Float[Tensor, "t *batch n_q"], q: Float[Tensor, "t *true n_q"]
) -> dict[str, Float[Tensor, "*batch"]]:
    """Root-mean-squared errors over time of the tip and of the whole backbone.

    Parameters
    ----------
    robot
        Its kinematics; mounts do not matter.
    q_hat
        Estimates, time first.
    q
        Truth, broadcasts against the estimates.

    Returns
    -------
    dict
        ``tip_mm`` (distance between estimated and true tip), ``orientation_deg`` (angle of the rotation between
        them), ``shape_mm`` (distance between corresponding points, over the backbone).
    """
    T_hat, T = robot.tip(q_hat), robot.tip(q)
    tip = torch.linalg.vector_norm(T_hat[..., :3, 3] - T[..., :3, 3], dim=-1)
    angle = angle_deg((se3.inverse(T) @ T_hat)[..., :3, :3])
    points = robot.backbone(q_hat) - robot.backbone(q)
    shape = points.square().sum(-1).mean(-1)
    return {
        "tip_mm": 1e3 * tip.square().mean(0).sqrt(),
        "orientation_deg": angle.square().mean(0).sqrt(),
        "shape_mm": 1e3 * shape.mean(0).sqrt(),
    }


def angle_deg(turn: Float[Tensor, "*batch 3 3"]) -> Float[Tensor, "*batch"]:
    """Angle of a rotation [deg], exact for small ones, too."""
    skew = turn - turn.mT
    sine = torch.stack([skew[..., 2, 1], skew[..., 0, 2], skew[..., 1, 0]], dim=-1).norm(dim=-1) / 2
    cosine = (turn.diagonal(dim1=-2, dim2=-1).sum(-1) - 1) / 2
    return torch.atan2(sine, cosine).rad2deg()
