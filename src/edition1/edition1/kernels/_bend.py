"""The sensor of a bent arc, compiled: what :mod:`edition1.sensing.bend_sensor` reads, for filters that need values only.

It computes in double precision whatever the precision of the caller, and has no derivatives; torch remains the
reference.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from edition1.errors import require
from edition1.kernels.compilation import machine_code
from edition1.sensing.magnets import B444B, Cube

SERIES_SWITCH = 1e-3
"""Squared angle below which sin(phi/2)/(phi/2) is a series of three terms, exact to 4e-15."""


@machine_code()
def bend_field(q, length, edge, polarisation_mt, out):
    """Write the flux density for every bend vector ``q[n, 2]`` into ``out[n, 3]``."""
    a = edge / 2
    scale = polarisation_mt / (4 * math.pi)
    for n in range(len(q)):
        u, v = q[n, 0], q[n, 1]
        t = u * u + v * v
        if t < SERIES_SWITCH:
            half = 1 - t / 24 + t * t / 1920
        else:
            phi = math.sqrt(t)
            half = 2 * math.sin(phi / 2) / phi
        s, c = half * math.sqrt(1 - t / 4 * half * half), half * half / 2
        # The sensor seen from the magnet, mirrored into the first octant: see the field of a cuboid.
        x, y, z = length * u * c, length * v * c, -length * s
        sx, sy, sz = math.copysign(1.0, x), math.copysign(1.0, y), math.copysign(1.0, z)
        x, y, z = x * sx, y * sy, z * sz
        ratio_x, ratio_y, angle = 1.0, 1.0, 0.0
        for j in range(2):
            eta = y - a + 2 * a * j
            for k in range(2):
                zeta = z - a + 2 * a * k
                upper, lower = x - a, x + a
                r_upper = math.sqrt(upper * upper + eta * eta + zeta * zeta)
                r_lower = math.sqrt(lower * lower + eta * eta + zeta * zeta)
                ratio = (eta + r_upper) / (eta + r_lower)
                slope = (upper + r_upper) / (lower + r_lower)
                # Two corners' arctangents by one: their difference is within half a turn.
                p_upper, p_lower = upper * eta, lower * eta
                if zeta < 0:
                    p_upper, p_lower = -p_upper, -p_lower
                b_upper, b_lower = abs(zeta) * r_upper, abs(zeta) * r_lower
                turn = math.atan2(
                    p_upper * b_lower - p_lower * b_upper, b_upper * b_lower + p_upper * p_lower
                )
                if j == k:
                    ratio_x, ratio_y, angle = ratio_x * ratio, ratio_y * slope, angle + turn
                else:
                    ratio_x, ratio_y, angle = ratio_x / ratio, ratio_y / slope, angle - turn
        Bx = -scale * sx * sz * math.log(ratio_x)
        By = -scale * sy * sz * math.log(ratio_y)
        Bz = scale * angle
        along = u * Bx + v * By
        push = s * Bz - c * along
        out[n, 0], out[n, 1], out[n, 2] = Bx + u * push, By + v * push, Bz - s * along - c * t * Bz


@dataclass(frozen=True)
class CompiledBendSensor:
    """Sensor model like :class:`~edition1.sensing.bend_sensor.BendSensor`, without derivatives.

    Parameters
    ----------
    length
        Length of the arc from sensor to magnet [m].
    cube
        The magnet.

    Raises
    ------
    InputError
        If the length is not positive.

    Examples
    --------
    >>> CompiledBendSensor(15e-3)(torch.zeros(2, dtype=torch.float64))[2]
    tensor(15.8308, dtype=torch.float64)
    """

    length: float
    cube: Cube = B444B
    is_compiled: ClassVar[bool] = True

    def __post_init__(self) -> None:
        require(self.length > 0, "length", "CompiledBendSensor", "positive [m]", self.length)

    def __call__(self, q: Float[Tensor, "*batch 2"]) -> Float[Tensor, "*batch 3"]:
        """Return the flux density [mT] in the frame of the sensor, z along the straight arc; bend ``q`` below pi."""
        flat = np.asarray(q.numpy(force=True), dtype=np.float64).reshape(-1, 2)
        out = np.empty((len(flat), 3))
        bend_field(flat, self.length, self.cube.edge, self.cube.polarisation_mt, out)
        return torch.from_numpy(out.reshape(*q.shape[:-1], 3)).to(q)
