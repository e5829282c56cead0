r"""What orientation sensors on a robot read, as directions that they see: :math:`u = R_i(q)^T d`.

``d`` is a direction that is fixed in the base, :math:`R_i` the orientation of a sensor in the base frame. All three
axes of the base together are the orientation, without the jumps that angles and rotation vectors have at half a turn;
the vertical alone is what a sensor knows whose heading is arbitrary.

If the orientation has an error of standard deviation :math:`\sigma` about every axis, a single direction moves by
:math:`\sigma` across itself. Three axes in place of three angles count every turn twice: with a noise of
:math:`\sqrt 2\,\sigma` for each of their nine components the information is that of the orientation, exactly.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from edition1 import se3
from edition1.errors import bad_input
from edition1.kinematics.motion import backbone_motion
from edition1.kinematics.mounts import Mounts
from edition1.kinematics.robot import Robot
from edition1.sensing._slopes import with_jacobian


@dataclass(frozen=True)
class SeenDirections:
    """Sensor model ``u = sensing(q)``: three components for every direction, in the frame of the sensor that sees it.

    Parameters
    ----------
    robot
        Its kinematics.
    imus
        Mounts of the sensors; their frames are those of the mounts.
    seen_by
        For every direction, which of them sees it, from 0.
    directions
        Unit vectors in the base frame.

    Raises
    ------
    InputError
        If there is not one sensor for each of some directions.

    Examples
    --------
    The tip of a segment bent by a quarter of a turn towards x looks along x and sees the vertical along -x:

    >>> from edition1.kinematics.mounts import magnet_mounts
    >>> from edition1.kinematics.paper_robots import pcc_robot
    >>> up = torch.tensor([[0.0, 0.0, 1.0]], dtype=torch.float64)
    >>> sensing = SeenDirections(pcc_robot(1), magnet_mounts([0], [0.11]), (0,), up)
    >>> sensing(torch.tensor([0.022 * torch.pi / 2, 0.0, 0.0], dtype=torch.float64)).round(decimals=6) + 0.0
    tensor([-1.,  0.,  0.], dtype=torch.float64)
    """

    robot: Robot
    imus: Mounts
    seen_by: tuple[int, ...]
    directions: Float[Tensor, "n 3"]

    def __post_init__(self) -> None:
        n = len(self.seen_by)
        if not n or self.directions.shape != (n, 3):
            received = f"directions of shape {tuple(self.directions.shape)} seen by {n} sensors"
            raise bad_input("directions", "SeenDirections", "one for each of seen_by", received)
        if not all(0 <= k < len(self.imus) for k in self.seen_by):
            raise bad_input("seen_by", "SeenDirections", f"from 0 to {len(self.imus) - 1}", self.seen_by)

    @property
    def axes(self) -> Mounts:
        """Mounts whose z axes are those along which the components are, in their order."""
        at = [k for k in self.seen_by for _ in range(3)]
        # x, y and z of a sensor in turn become the last column; the others follow, so that it stays a rotation.
        turns = (
            torch.eye(3)
            .double()[torch.tensor([[1, 2, 0], [2, 0, 1], [0, 1, 2]])]
            .mT.repeat(len(self.seen_by), 1, 1)
        )
        local = self.imus.local.double()[..., at, :, :]
        local = se3.pose(local[..., :3, :3] @ turns, local[..., :3, 3])
        return Mounts(tuple(self.imus.segment[k] for k in at), self.imus.axial[..., at], local)

    def __call__(self, q: Float[Tensor, "*batch n_q"]) -> Float[Tensor, "*batch s"]:
        """Return the components of all directions, one after the other."""
        return with_jacobian(q, self)

    def linearise(
        self, q: Float[Tensor, "*batch n_q"]
    ) -> tuple[Float[Tensor, "*batch s"], Float[Tensor, "*batch s n_q"]]:
        """Components of all directions and their derivatives by ``q``."""
        T, dT = backbone_motion(self.robot, q, self.imus)
        seen_by, d = list(self.seen_by), self.directions.to(q).unsqueeze(-1)
        local = self.imus.local.to(q)[..., seen_by, :3, :3].mT
        u = local @ (T[..., seen_by, :3, :3].mT @ d)
        J = local.unsqueeze(-3) @ (dT[..., seen_by, :, :3, :3].mT @ d.unsqueeze(-3))
        return u.squeeze(-1).flatten(-2), J.squeeze(-1).mT.flatten(-3, -2)
