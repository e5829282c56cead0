r"""A rod whose curvature is a polynomial along it, in both directions of bending.

With the Legendre polynomials :math:`P_k` of :math:`2s/L - 1` the curvature about the axes x and y of the section is
:math:`\kappa(s) = \sum_k c_k P_k/L`, so that a coefficient is an angle [rad]: the first two are the bend of an arc.
The rod neither twists nor stretches.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from edition1 import se3

_STEPS = 4
"""Steps in a quarter, each by two Gauss points (Magnus, fourth order): 2 um off at the tip at bends as here."""
_GAUSS = 3**0.5 / 6


@dataclass(frozen=True)
class CurvatureSeries:
    """A rod of polynomial curvature; a configuration holds the coefficients about x and then those about y [rad].

    Parameters
    ----------
    length
        Length [m].
    terms
        Coefficients for each direction: 1 is an arc, 2 an affine curvature, 3 a quadratic one.
    """

    length: float
    terms: int

    @property
    def n_q(self) -> int:
        """Number of coefficients."""
        return 2 * self.terms

    def quarters(self, q: Float[Tensor, "*batch n_q"]) -> Float[Tensor, "*batch 4 4 4"]:
        """Poses in the base at a quarter, a half, three quarters of the length, and at the tip."""
        coefficients, n = q.unflatten(-1, (2, self.terms)), 4 * _STEPS
        middle = 2 * (torch.arange(n).to(q) + 0.5) / n - 1
        first, second = (self._strain(coefficients, middle + side * 2 * _GAUSS / n) for side in (-1, 1))
        T = se3.exponential((first + second) / (2 * n) + _GAUSS / (2 * n * n) * _bracket(first, second))
        while T.shape[-3] > 4:  # neighbours, until one motion is left for each quarter
            T = T[..., ::2, :, :] @ T[..., 1::2, :, :]
        poses = [T[..., 0, :, :]]
        for k in range(1, 4):
            poses.append(poses[-1] @ T[..., k, :, :])
        return torch.stack(poses, dim=-3)

    def _strain(self, coefficients: Tensor, x: Tensor) -> Tensor:
        """Motion for a unit of s/L in the frame there, translation first: ``[*batch, steps, 6]``."""
        P = torch.stack([torch.ones_like(x), x, (3 * x * x - 1) / 2][: self.terms], dim=-1)
        bend = (coefficients.unsqueeze(-3) * P.unsqueeze(-2)).sum(-1)
        ahead = bend.new_tensor([0.0, 0.0, self.length]).expand(*bend.shape[:-1], 3)
        return torch.cat([ahead, bend, torch.zeros_like(bend[..., :1])], dim=-1)


def _bracket(a: Tensor, b: Tensor) -> Tensor:
    """Lie bracket of two motions."""
    (v, w), (x, y) = (c.split(3, dim=-1) for c in (a, b))
    cross = torch.linalg.cross
    return torch.cat([cross(w, x) + cross(v, y), cross(w, y)], dim=-1)
