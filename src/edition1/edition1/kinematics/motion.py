"""How mounts and the tip move when the configuration changes: where they are, and the derivatives."""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import Tensor

from edition1 import se3
from edition1.kinematics.mounts import Mounts
from edition1.kinematics.robot import Robot, Segment


def backbone_motion(
    robot: Robot, q: Float[Tensor, "*q n_q"], mounts: Mounts
) -> tuple[Float[Tensor, "*batch n 4 4"], Float[Tensor, "*batch n n_q 4 4"]]:
    r"""Poses ``T_0_backbone`` of the backbone at mounts, and their derivatives by every configuration variable.

    A segment is differentiated only with respect to its own variables; what it carries moves rigidly with its tip:
    :math:`\partial T = W\,T` with :math:`W = \partial T_{0,k}\, T_{0,k}^{-1}` for all mounts beyond the tip ``k``.
    Mounts in one plane share its frame. Several times cheaper than differentiating the whole chain for every mount.

    Parameters
    ----------
    robot
        Its segments.
    q
        Configuration.
    mounts
        Mounts on its segments, those of the robot or others; a batch of them broadcasts. What is mounted there has
        the pose ``T_0_backbone @ mounts.local``, and its derivative likewise.

    Returns
    -------
    tuple
        Rigid motions, positions in m, and their derivatives, whose last row is zero.

    Examples
    --------
    A straight segment that begins to bend towards x turns its tip about y by 1/radius:

    >>> from edition1.kinematics.constant_curvature import ConstantCurvature
    >>> from edition1.kinematics.mounts import magnet_mounts
    >>> robot = Robot((ConstantCurvature(0.11, 0.022),))
    >>> T, dT = backbone_motion(robot, torch.zeros(3, dtype=torch.float64), magnet_mounts([0], 0.11))
    >>> dT[0, 0, :3, 2] * 0.022  # tangent by delta_x
    tensor([1., 0., 0.], dtype=torch.float64)
    """
    frames, plane_of_mount = _frames(robot, mounts)
    own_poses, own_motions = _own_motion(robot, q, frames)
    base = torch.eye(4).to(q).expand(*q.shape[:-1], 4, 4)
    carried = q.new_zeros(*q.shape[:-1], 0, 4, 4)
    poses, motions = [], []
    for k, (i, _) in enumerate(frames):
        T, own = base @ own_poses[k], base.unsqueeze(-3) @ own_motions[k]
        batch = own.shape[:-3]
        moved = (carried.flatten(-3, -2) @ T).unflatten(-2, (-1, 4))
        moved = torch.cat([moved.expand(*batch, *moved.shape[-3:]), own], dim=-3)
        poses.append(T)
        motions.append(_padded(moved, robot.n_q))
        if k + 1 < len(frames) and frames[k + 1][0] > i:  # the tip, last of its segment
            base = T
            carried = (moved.flatten(-3, -2) @ se3.inverse(T)).unflatten(-2, (-1, 4))
    T = torch.stack(torch.broadcast_tensors(*poses), dim=-3)
    dT = torch.stack(torch.broadcast_tensors(*motions), dim=-4)
    return T[..., plane_of_mount, :, :], dT[..., plane_of_mount, :, :, :]


def tip_motion(
    robot: Robot, q: Float[Tensor, "*batch n_q"]
) -> tuple[Float[Tensor, "*batch 3"], Float[Tensor, "*batch 3 n_q"]]:
    r"""Positions of the tip, and their derivatives :math:`J = \partial p / \partial q` by the configuration.

    To first order a covariance :math:`C` of the configuration gives the tip the covariance :math:`J C J^T`. For one
    point this is cheaper than :func:`backbone_motion`: three reverse passes, however many segments there are.

    Parameters
    ----------
    robot
        Its segments.
    q
        Configuration.

    Returns
    -------
    tuple
        Positions in the base frame [m], and their derivatives [m per unit of each configuration variable].

    Raises
    ------
    InputError
        If the last dimension of ``q`` is not that of the robot, or ``q`` is not finite.

    Examples
    --------
    The tip of a straight segment moves by :math:`L/2d` when it begins to bend, and with its elongation:

    >>> from edition1.kinematics.constant_curvature import ConstantCurvature
    >>> position, J = tip_motion(Robot((ConstantCurvature(0.11, 0.022),)), torch.zeros(3, dtype=torch.float64))
    >>> position
    tensor([0.0000, 0.0000, 0.1100], dtype=torch.float64)
    >>> J
    tensor([[2.5000, 0.0000, 0.0000],
            [0.0000, 2.5000, 0.0000],
            [0.0000, 0.0000, 1.0000]], dtype=torch.float64)
    """

    def summed(x: Tensor) -> tuple[Tensor, Tensor]:
        position = robot.tip(x)[..., :3, 3]
        return position.reshape(-1, 3).sum(0), position  # members of a batch do not depend on each other

    J, position = torch.func.jacrev(summed, has_aux=True)(q)
    return position, J.movedim(0, -2)


_Frame = tuple[int, Tensor]
"""Segment and backbone coordinate ``v`` (a batch of them for a batch of robots)."""


def _frames(robot: Robot, mounts: Mounts) -> tuple[list[_Frame], list[int]]:
    """Distinct frames on the backbone, from base to tip, each segment but the last ending with its tip."""
    frames: list[_Frame] = []
    plane_of_mount = [0] * len(mounts)
    last = max(len(robot.segments) - 1, 0)
    for i, segment in enumerate(robot.segments):
        first = len(frames)
        for k in (k for k, j in enumerate(mounts.segment) if j == i):
            v = mounts.axial[..., k] / segment.length
            # With a gradient, equal heights are still two variables.
            same = [
                j for j in range(first, len(frames)) if not v.requires_grad and torch.equal(frames[j][1], v)
            ]
            plane_of_mount[k] = same[0] if same else len(frames)
            if not same:
                frames.append((i, v))
        if i < last:
            frames.append((i, torch.ones((), dtype=torch.float64)))
    return frames, plane_of_mount


def _own_motion(robot: Robot, q: Tensor, frames: list[_Frame]) -> tuple[list[Tensor], list[Tensor]]:
    """Pose of each frame in the base of its segment and its own derivative; equal segments are evaluated at once."""
    parts = robot.split(q)
    groups: dict[Segment, list[int]] = {}
    for k, (i, _) in enumerate(frames):
        groups.setdefault(robot.segments[i], []).append(k)
    poses: dict[int, Tensor] = {}
    motions: dict[int, Tensor] = {}
    for segment, here in groups.items():
        v = torch.stack(torch.broadcast_tensors(*(frames[k][1] for k in here)), dim=-1)
        T, dT = _segment_motion(segment, torch.stack([parts[frames[k][0]] for k in here], dim=-2), v.to(q))
        poses |= dict(zip(here, T.unbind(-3), strict=True))
        motions |= dict(zip(here, dT.unbind(-4), strict=True))
    return [poses[k] for k in range(len(frames))], [motions[k] for k in range(len(frames))]


def _segment_motion(segment: Segment, q: Tensor, v: Tensor) -> tuple[Tensor, Tensor]:
    """Poses ``[..., n, 4, 4]`` and derivatives ``[..., n, n_q, 4, 4]``, one forward pass per variable."""

    def along(direction: Tensor) -> tuple[Tensor, Tensor]:
        return torch.func.jvp(lambda x: segment.pose(x, v), (q,), (direction.expand_as(q),))[:2]

    T, dT = torch.func.vmap(along)(torch.eye(segment.n_q).to(q))
    return T[0], dT.movedim(0, -3)


def _padded(motion: Tensor, n_q: int) -> Tensor:
    """Append the derivatives by the variables of segments further out: zero."""
    missing = n_q - motion.shape[-3]
    return torch.cat([motion, motion.new_zeros(*motion.shape[:-3], missing, 4, 4)], dim=-3)
