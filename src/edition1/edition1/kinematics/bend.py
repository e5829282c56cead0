r"""A segment that only bends: the arc of Mitchell et al. 2021 (section II), by its bend vector.

The state of the paper is a bend direction :math:`\theta` and a bend angle :math:`\varphi`. The bend vector
:math:`q = \varphi (\cos\theta, \sin\theta)` holds the same two numbers without the singularity at
:math:`\varphi = 0`, where the direction means nothing; a negative angle folds to the opposite direction.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from edition1.errors import require
from edition1.kinematics.constant_curvature import ConstantCurvature

MAX_BEND = torch.pi / 2
"""Largest bend angle of Mitchell et al. 2021, section II [rad]."""


@dataclass(frozen=True)
class Bend:
    r"""A segment of constant curvature that does not stretch.

    With the base along z the tip is at :math:`(r\cos\theta, r\sin\theta, L\sin\varphi/\varphi)`,
    :math:`r = L (1 - \cos\varphi)/\varphi`, turned by the rotation vector
    :math:`\varphi (-\sin\theta, \cos\theta, 0)`: no twist.

    Parameters
    ----------
    length
        Length of the arc [m].

    Raises
    ------
    InputError
        If the length is not positive.

    Examples
    --------
    A quarter circle of 15 mm towards y ends at (0, 2 L/pi, 2 L/pi):

    >>> q = torch.tensor([0.0, torch.pi / 2], dtype=torch.float64)
    >>> 1e3 * Bend(15e-3).pose(q, torch.tensor(1.0))[:3, 3]
    tensor([0.0000, 9.5493, 9.5493], dtype=torch.float64)
    """

    length: float

    def __post_init__(self) -> None:
        require(self.length > 0, "length", "Bend", "positive [m]", self.length)

    @property
    def coordinates(self) -> tuple[str, ...]:
        """Names of the configuration variables."""
        return ("bend_x", "bend_y")

    @property
    def n_q(self) -> int:
        """Number of configuration variables."""
        return 2

    def pose(self, q: Float[Tensor, "*q 2"], v: Float[Tensor, "*v"]) -> Float[Tensor, "*batch 4 4"]:
        """Pose ``T_base_v`` of the backbone frame at ``v``.

        Parameters
        ----------
        q
            Bend vector [rad].
        v
            Backbone coordinate, 0 at the base and 1 at the tip; broadcasts against the batch of ``q``.

        Raises
        ------
        InputError
            If the last dimension of ``q`` is not 2, or ``q`` is not finite.
        """
        # At a radius of 1 m the Delta-parametrisation is the bend vector.
        arc = ConstantCurvature(self.length, 1.0)
        return arc.pose(torch.cat([q, torch.zeros_like(q[..., :1])], dim=-1), v)


def bend_vector(
    angle: Float[Tensor, "*batch"], direction: Float[Tensor, "*batch"]
) -> Float[Tensor, "*batch 2"]:
    """Bend vector [rad] of a bend angle and a bend direction [rad]; a negative angle points the other way.

    Examples
    --------
    >>> bend_vector(torch.tensor(-1.0), torch.tensor(0.0))
    tensor([-1., -0.])
    """
    return torch.stack([angle * direction.cos(), angle * direction.sin()], dim=-1)


def bend_angle_and_direction(
    q: Float[Tensor, "*batch 2"],
) -> tuple[Float[Tensor, "*batch"], Float[Tensor, "*batch"]]:
    """Bend angle, not negative, and bend direction in (-pi, pi] [rad]; the direction of a straight arc is 0."""
    return torch.linalg.vector_norm(q, dim=-1), torch.atan2(q[..., 1], q[..., 0])
