r"""A rod whose curvature and twist are short series along its arc: what constant and affine curvature begin.

With Legendre polynomials :math:`P_k` and the arc length :math:`s` the strain about the axis :math:`j` of the backbone
frame is :math:`\kappa_j(s) = \sum_k q_{jk} \sqrt{2k+1}\, P_k(2s/L - 1)` [rad/m], so that :math:`\sum_k q_{jk}^2` is
its mean square. One term is constant curvature, two are affine curvature in a plane that may turn. The backbone is
neither stretched nor sheared; its frame follows :math:`T' = T\, (e_z, \kappa)^\wedge` and is integrated by the
exponential map over ``parts`` pieces, each with the strain at its middle: exact for one term, with an error of second
order in the length of a piece for more.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import torch
from jaxtyping import Float
from numpy.polynomial.legendre import legval
from torch import Tensor

from edition1 import se3
from edition1.errors import bad_input, require


@dataclass(frozen=True)
class StrainSeries:
    """One rod; its configuration holds the terms about x, those about y, then those of the twist about z [rad/m].

    Parameters
    ----------
    length
        Of the backbone [m].
    bending
        Terms about each of the two axes across.
    torsion
        Terms about the backbone.
    parts
        Pieces of the integration.

    Raises
    ------
    InputError
        If the length is not positive, there is no term, or fewer pieces than terms.

    Examples
    --------
    A quarter circle of length 0.2 m towards -y, by its curvature about x:

    >>> rod = StrainSeries(0.2, bending=1, torsion=0)
    >>> rod.pose(torch.tensor([torch.pi / 0.4, 0.0], dtype=torch.float64), torch.tensor(1.0))[:3, 3]
    tensor([ 0.0000, -0.1273,  0.1273], dtype=torch.float64)
    """

    length: float
    bending: int = 3
    torsion: int = 1
    parts: int = 8

    def __post_init__(self) -> None:
        require(self.length > 0, "length", "StrainSeries", "positive [m]", self.length)
        if self.bending < 0 or self.torsion < 0 or not self.n_q:
            raise bad_input(
                "bending, torsion", "StrainSeries", "numbers of terms", (self.bending, self.torsion)
            )
        if self.parts < max(self.bending, self.torsion):
            raise bad_input("parts", "StrainSeries", "at least the number of terms", self.parts)

    @property
    def n_q(self) -> int:
        """Number of terms."""
        return 2 * self.bending + self.torsion

    @property
    def coordinates(self) -> tuple[str, ...]:
        """Names of the terms."""
        counts = (("x", self.bending), ("y", self.bending), ("z", self.torsion))
        return tuple(f"kappa_{axis}{k}" for axis, count in counts for k in range(count))

    @cached_property
    def basis(self) -> Float[np.ndarray, "parts 3 n_q"]:
        """Strain in the middle of each piece, by each term."""
        middles = (2 * np.arange(self.parts) + 1) / self.parts - 1
        basis, column = np.zeros((self.parts, 3, self.n_q)), 0
        for axis, count in enumerate((self.bending, self.bending, self.torsion)):
            for k in range(count):
                basis[:, axis, column] = np.sqrt(2 * k + 1) * legval(middles, np.eye(count)[k])
                column += 1
        return basis

    def pose(self, q: Float[Tensor, "*q n_q"], v: Float[Tensor, "*v"]) -> Float[Tensor, "*batch 4 4"]:
        """Pose ``T_base_v`` of the backbone frame at ``v``.

        Parameters
        ----------
        q
            Terms of the series [rad/m].
        v
            Backbone coordinate, 0 at the base and 1 at the tip; broadcasts against the batch of ``q``.

        Raises
        ------
        InputError
            If the last dimension of ``q`` is not the number of terms, or ``q`` is not finite.
        """
        if q.shape[-1:] != (self.n_q,):
            raise bad_input(
                "q", "StrainSeries.pose", f"of last dimension {self.n_q}", f"shape {tuple(q.shape)}"
            )
        se3.require_finite(q, "q", "StrainSeries.pose")
        strain = torch.einsum("ijk,...k->...ij", torch.from_numpy(self.basis).to(q), q)
        v, h = v.to(q), self.length / self.parts
        batch = torch.broadcast_shapes(q.shape[:-1], v.shape)
        ahead = q.new_tensor([0.0, 0.0, 1.0])
        T = torch.eye(4).to(q).expand(*batch, 4, 4)
        for i in range(self.parts):
            piece = (v * self.length - i * h).clamp(0.0, h).expand(batch).unsqueeze(-1)
            twist = torch.cat([ahead.expand(*batch, 3), strain[..., i, :].expand(*batch, 3)], -1)
            T = T @ se3.exponential(piece * twist)
        return T
