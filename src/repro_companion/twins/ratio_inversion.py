r"""Bend from the two ratios of the transverse over the axial field: closed form for a dipole, then Gauss-Newton.

A dipole at the end of the arc, magnetised along it, has the ratio
:math:`\rho = \sin\varphi/(3 + \cos\varphi)`, hence
:math:`\varphi = \arctan\rho + \arcsin\bigl(3\rho/\sqrt{1 + \rho^2}\bigr)`. Two ratios determine the two coordinates
of the bend, so a few steps from there give the bend of the full model, for any number of readings at once.
"""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import Tensor

from repro.estimation.levenberg_marquardt import covariance, jacobian
from repro.kinematics.bend import MAX_BEND
from repro_companion.twins.field_ratios import FieldRatios

_STEPS = 4
"""Gauss-Newton steps; what is left after them is rounding."""


def _dipole_bend(rho: Float[Tensor, "*batch"]) -> Float[Tensor, "*batch"]:
    """Bend angle [rad] at which a dipole has this ratio; 109.5 deg for ratios beyond the largest, 0.354.

    Examples
    --------
    >>> phi = torch.tensor(1.0, dtype=torch.float64)
    >>> _dipole_bend(phi.sin() / (3 + phi.cos()))
    tensor(1., dtype=torch.float64)
    """
    return rho.atan() + (3 * rho / (1 + rho * rho).sqrt()).clamp(max=1.0).asin()


def invert(
    measured: Float[Tensor, "n 2"], model: FieldRatios, noise: float, largest: float = MAX_BEND
) -> tuple[Float[Tensor, "n 2"], Float[Tensor, " n"]]:
    """Bend vectors of ratios, each alone, and standard deviations of the bend angle, both [rad].

    A bend beyond the largest is set to the largest; NaN stays NaN.

    Parameters
    ----------
    measured
        Ratios less those at rest.
    model
        Model of the ratios.
    noise
        Standard deviation of a ratio.
    largest
        Largest bend angle [rad]: the paper's bound unless given.
    """
    as_drawn = torch.linalg.solve(model.matrix, measured.mT).mT
    rho = torch.linalg.vector_norm(as_drawn, dim=-1, keepdim=True)
    along = torch.where(rho > 0, as_drawn / rho, torch.tensor([1.0, 0.0]).to(rho))
    q = _dipole_bend(rho).clamp(max=largest) * along
    for _ in range(_STEPS):
        found, J = jacobian(model, q)
        q = q + torch.linalg.solve(J, (measured - found).unsqueeze(-1)).squeeze(-1)
        angle = torch.linalg.vector_norm(q, dim=-1, keepdim=True)
        q = q * (largest / angle.clamp_min(largest))
    known = ~torch.isnan(q).any(-1)
    J = torch.where(known[:, None, None], jacobian(model, torch.where(known[:, None], q, 0.0))[1], 1.0)
    deviation = (along.unsqueeze(-2) @ covariance(J, noise) @ along.unsqueeze(-1)).flatten().sqrt()
    return q, torch.where(known, deviation, torch.nan)
