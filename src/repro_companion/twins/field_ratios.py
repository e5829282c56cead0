r"""Ratios of the transverse over the axial field: readings of a bent arc that need no gain of the sensor.

A sensor that changes its own gain multiplies all three components by one unknown factor; the two ratios stay. For a
dipole they depend on the bend alone, not on the length of the arc: their magnitude is
:math:`\sin\varphi/(3 + \cos\varphi)`, which grows up to 109 deg.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from repro.sensing.bend_sensor import BendSensor


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
