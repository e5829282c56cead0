r"""Ratios of the transverse over the axial field: readings of a bent arc that need no gain of the sensor.

A sensor that changes its own gain multiplies all three components by one unknown factor; the two ratios stay. For a
dipole they depend on the bend alone, not on the length of the arc: their magnitude is
:math:`\rho = \sin\varphi/(3 + \cos\varphi)`, which grows up to 109 deg.

The bend comes back from the two ratios in closed form for a dipole at the end of the arc, magnetised along it,
:math:`\varphi = \arctan\rho + \arcsin\bigl(3\rho/\sqrt{1 + \rho^2}\bigr)`. Two ratios determine the two coordinates
of the bend, so a few steps of Gauss-Newton from there give the bend of the full model, for any number of readings at
once.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from edition1.estimation.levenberg_marquardt import covariance, jacobian
from edition1.kinematics.bend import MAX_BEND
from edition1.sensing.bend_sensor import BendSensor


def transverse_to_axial(u: Float[Tensor, "*batch 3"]) -> Float[Tensor, "*batch 2"]:
    """Transverse over axial components, in the model's axes; NaN where a component is."""
    return torch.where(torch.isnan(u).any(-1, keepdim=True), torch.nan, u[..., :2] / u[..., 2:])


@dataclass(frozen=True)
class FieldRatios:
    r"""Sensor model of an estimator: bend vector to the two ratios, :math:`A\, h(q)`.

    Parameters
    ----------
    sensor
        Gives the ratios :math:`h(q)` of a sensor that is as drawn.
    matrix
        :math:`A`: what the real ratios are of them. A multiple of a rotation is a common factor (the sensor's
        transverse over its axial gain, the share of the bend between sensor and magnet) and a turn about the body;
        any other matrix has a factor of each transverse axis too.

    Examples
    --------
    Near the straight arc the ratios are a quarter of the bend, a little more for a cube:

    >>> as_drawn = FieldRatios(BendSensor(15e-3), torch.eye(2, dtype=torch.float64))
    >>> as_drawn(torch.tensor([0.004, 0.0], dtype=torch.float64)) / 0.004
    tensor([0.2566, 0.0000], dtype=torch.float64)
    """

    sensor: BendSensor
    matrix: Float[Tensor, "2 2"]

    def __call__(self, q: Float[Tensor, "*batch 2"]) -> Float[Tensor, "*batch 2"]:
        """Return the ratios at bend ``q`` [rad]."""
        return transverse_to_axial(self.sensor(q)) @ self.matrix.T.to(q)


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
