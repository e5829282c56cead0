"""The series of multipoles of an axisymmetric magnet: its polynomials, and the factors of the field."""

from __future__ import annotations

import numpy as np
import torch
from jaxtyping import Float
from numpy.polynomial import Legendre, legendre
from torch import Tensor


def multipole_polynomials(
    l_max: int,
) -> tuple[Float[np.ndarray, "terms power"], Float[np.ndarray, "terms power"]]:
    r"""Coefficients of :math:`-P'_l(c)` and :math:`P'_{l+1}(c)`, odd ``l``, in ascending powers of ``c``.

    With them the field of an axisymmetric magnet is, for the unit vectors :math:`m` along its axis and
    :math:`\hat p` towards the point, and :math:`c = m \cdot \hat p`,

    .. math:: B = \sum_l \frac{A_l}{r^{l+2}} \left[-P'_l(c)\, m + P'_{l+1}(c)\, \hat p\right] .
    """
    orders = range(1, l_max + 1, 2)
    along_axis = [_power_series(-Legendre.basis(n).deriv(), l_max + 1) for n in orders]
    along_offset = [_power_series(Legendre.basis(n + 1).deriv(), l_max + 1) for n in orders]
    return np.array(along_axis), np.array(along_offset)


def _power_series(p: Legendre, n: int) -> np.ndarray:
    coefficients = legendre.leg2poly(p.coef)
    return np.pad(coefficients, (0, n - len(coefficients)))


def multipole_factors(
    moments: Float[Tensor, "*m terms"], d: Float[Tensor, "*batch"], cos_theta: Float[Tensor, "*batch"]
) -> tuple[Float[Tensor, "*batch"], Float[Tensor, "*batch"]]:
    """Factors ``f`` and ``g`` [mT] of the field ``B = f m + g p/|p|`` of an axisymmetric magnet.

    Parameters
    ----------
    moments
        :math:`A_1, A_3, ...` [mT m^(l+2)].
    d
        Distance from the centre of the magnet [m].
    cos_theta
        Cosine of the angle between the axis of the magnet and the vector to the point.
    """
    terms = moments.shape[-1]
    along_axis, along_offset = (d.new_tensor(p) for p in multipole_polynomials(2 * terms - 1))
    order = torch.arange(1, 2 * terms, 2, device=d.device)
    # Powers by integer exponents: exact, and differentiable at cos_theta = 0 where c**0 is constant.
    powers = torch.stack([cos_theta**k for k in range(along_axis.shape[-1])], dim=-1)
    weights = moments.to(d) / d.unsqueeze(-1) ** (order + 2)
    return (weights * (powers @ along_axis.T)).sum(-1), (weights * (powers @ along_offset.T)).sum(-1)
