r"""A segment whose curvature is an affine function of the backbone coordinate (Baaij et al. 2023, appendix A.2).

With :math:`\kappa(v) = \kappa_0 + \kappa_1 v` the bending angle is :math:`\theta(v) = \kappa_0 v + \kappa_1 v^2/2`,
eq. (17); curvatures belong to the coordinate :math:`v \in [0, 1]` and are angles [rad]. The position, eq. (18), is
the integral of the tangent. The paper uses Simpson's rule with 101 points; here it is Gauss-Legendre quadrature with
``_NODES`` = 24 points, whose error is below 2e-14 of the length up to :math:`|\kappa_0| = \pi` and
:math:`|\kappa_1| = 4\pi`, and which is exact, with its derivatives, for :math:`\kappa_1 \to 0`.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from jaxtyping import Float
from numpy.polynomial.legendre import leggauss
from torch import Tensor

from edition1 import se3
from edition1.errors import bad_input, require

_NODES = 24


@dataclass(frozen=True)
class AffineCurvature:
    r"""One segment of affine curvature in one plane, and constant elongation.

    The configuration is :math:`q = (\kappa_0, \kappa_1, \phi, \delta L)`, eq. (16) [rad, rad, rad, m]. Bending by
    :math:`\theta > 0` at the azimuth :math:`\phi` turns the tangent towards
    :math:`(\sin\phi, -\cos\phi)`. The same shape has two configurations, :math:`(\kappa_0, \kappa_1, \phi)` and
    :math:`(-\kappa_0, -\kappa_1, \phi + \pi)`.

    Parameters
    ----------
    length
        Unextended length :math:`L_0` [m].

    Raises
    ------
    InputError
        If the length is not positive.

    Examples
    --------
    A quarter circle (:math:`\kappa_1 = 0`) of length 0.2 m towards -y:

    >>> q = torch.tensor([torch.pi / 2, 0.0, 0.0, 0.0], dtype=torch.float64)
    >>> AffineCurvature(0.2).pose(q, torch.tensor(1.0))[:3, 3]
    tensor([ 0.0000, -0.1273,  0.1273], dtype=torch.float64)
    """

    length: float

    def __post_init__(self) -> None:
        require(self.length > 0, "length", "AffineCurvature", "positive [m]", self.length)

    @property
    def coordinates(self) -> tuple[str, ...]:
        """Names of the configuration variables."""
        return ("kappa_0", "kappa_1", "phi", "delta_L")

    @property
    def n_q(self) -> int:
        """Number of configuration variables."""
        return 4

    def pose(self, q: Float[Tensor, "*q 4"], v: Float[Tensor, "*v"]) -> Float[Tensor, "*batch 4 4"]:
        """Pose ``T_base_v`` of the backbone frame at ``v``, eqs (17)-(18).

        Parameters
        ----------
        q
            Configuration [rad, rad, rad, m].
        v
            Backbone coordinate, 0 at the base and 1 at the tip; broadcasts against the batch of ``q``.

        Raises
        ------
        InputError
            If the last dimension of ``q`` is not 4, or ``q`` is not finite.
        """
        if q.shape[-1:] != (self.n_q,):
            raise bad_input("q", "AffineCurvature.pose", "of last dimension 4", f"shape {tuple(q.shape)}")
        se3.require_finite(q, "q", "AffineCurvature.pose")
        v = v.to(q)
        k0, k1, phi, dL = q.unbind(-1)
        theta = k0 * v + k1 * v * v / 2
        nodes, weights = (q.new_tensor(x) for x in leggauss(_NODES))
        s = v.unsqueeze(-1) * (nodes + 1) / 2
        along = k0.unsqueeze(-1) * s + k1.unsqueeze(-1) * s * s / 2
        across, ahead = (v / 2 * (weights * f).sum(-1) for f in (along.sin(), along.cos()))
        L = self.length + dL
        position = torch.stack(
            torch.broadcast_tensors(L * across * phi.sin(), -L * across * phi.cos(), L * ahead), -1
        )
        turn = se3.rotation_z(phi)
        return se3.pose(turn @ se3.rotation_x(theta) @ turn.mT, position)
