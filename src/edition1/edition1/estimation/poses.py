"""From measured poses of the segments' tips to configurations and their covariance."""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import Tensor

from edition1 import se3
from edition1.errors import bad_input
from edition1.kinematics.motion import backbone_motion
from edition1.kinematics.mounts import magnet_mounts
from edition1.kinematics.robot import Robot

_ITERATIONS = 20


def configurations(
    robot: Robot,
    T_0_tip: Float[Tensor, "*batch segments 4 4"],
    *,
    position_m: float,
    rotation_rad: float,
    start: Float[Tensor, "*batch n_q"] | None = None,
) -> tuple[Float[Tensor, "*batch n_q"], Float[Tensor, "*batch n_q n_q"]]:
    r"""Configuration that fits the measured poses of all segments' tips best, and its covariance.

    Each segment by itself, from straight or from ``start``, then all together by Gauss-Newton on
    :math:`\|p - \hat p\|^2/\sigma_p^2 + \|R - \hat R\|_F^2/2\sigma_R^2`. A rotation error of :math:`\sigma_R` about
    each axis gives twice its square in the Frobenius norm, so for small errors this is the maximum-likelihood
    estimate, and the inverse of its Hessian the covariance.

    Parameters
    ----------
    robot
        Its segments.
    T_0_tip
        Measured poses of the tip of every segment in the base frame; positions in m.
    position_m, rotation_rad
        Standard deviations of a measured position along each axis, and of a measured rotation about each axis.
    start
        Where the iteration starts, for segments whose straight pose has more than one configuration.

    Raises
    ------
    InputError
        If there is not one finite pose per segment, a standard deviation is not positive, or the iteration does
        not converge (poses that the robot cannot take).
    """
    n = len(robot.segments)
    if T_0_tip.shape[-3:] != (n, 4, 4):
        raise bad_input(
            "T_0_tip", "configurations", f"of shape (..., {n}, 4, 4)", f"shape {tuple(T_0_tip.shape)}"
        )
    se3.require_finite(T_0_tip, "T_0_tip", "configurations")
    if not (position_m > 0 and rotation_rad > 0):
        received = (position_m, rotation_rad)
        raise bad_input("position_m, rotation_rad", "configurations", "positive", received)
    tips = magnet_mounts(range(n), torch.tensor([segment.length for segment in robot.segments]))
    weight = T_0_tip.new_tensor([1 / (2**0.5 * rotation_rad)] * 3 + [1 / position_m])
    if start is not None:
        q = start
    elif n == 1:
        q = T_0_tip.new_zeros(*T_0_tip.shape[:-3], robot.n_q)
    else:
        bases = torch.cat(
            [torch.eye(4).to(T_0_tip).expand_as(T_0_tip[..., :1, :, :]), T_0_tip[..., :-1, :, :]], -3
        )
        own = (se3.inverse(bases) @ T_0_tip).split(1, dim=-3)
        singles = (Robot((segment,)) for segment in robot.segments)
        each = [
            configurations(robot, T, position_m=position_m, rotation_rad=rotation_rad)[0]
            for robot, T in zip(singles, own, strict=True)
        ]
        q = torch.cat(each, dim=-1)
    for _ in range(_ITERATIONS):
        T, dT = backbone_motion(robot, q, tips)
        r = ((T_0_tip - T)[..., :3, :] * weight).flatten(-3)
        J = (dT[..., :3, :] * weight).movedim(-3, -1).flatten(-4, -2)
        information = J.mT @ J
        step, singular = torch.linalg.solve_ex(information, (J.mT @ r.unsqueeze(-1)).squeeze(-1))
        if bool(singular.any()):
            expected = "near the configuration, where the poses determine it"
            raise bad_input("start", "configurations", expected, "a configuration where they do not")
        q = q + step
        if float(step.abs().max()) < 1e-10:
            return q, torch.linalg.inv(information)
    raise bad_input("T_0_tip", "configurations", "poses that the robot can take", "poses without a fit")
