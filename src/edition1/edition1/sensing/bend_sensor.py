r"""What one three-axis sensor reads of a cube at the other end of a bent arc (Mitchell et al. 2021, section II).

The sensor sits at the base of the arc, aligned with it; the cube at its tip, magnetised along the arc. Seen from
the tip an arc without twist is its own mirror image, so in the frame of the magnet the sensor is at
:math:`L (q_x c, q_y c, -s)` with :math:`s = \sin\varphi/\varphi` and :math:`c = (1 - \cos\varphi)/\varphi^2`.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from edition1 import se3
from edition1.errors import bad_input, require
from edition1.sensing._cuboid import cuboid_components
from edition1.sensing.magnets import B444B, Cube


@dataclass(frozen=True)
class BendSensor:
    """Sensor model ``u = sensor(q)`` of an estimator: bend vector to flux density, differentiable.

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
    Straight, the sensor is 15 mm from the centre of the cube, on its axis:

    >>> BendSensor(15e-3)(torch.zeros(2, dtype=torch.float64))[2]
    tensor(15.8308, dtype=torch.float64)
    """

    length: float
    cube: Cube = B444B

    def __post_init__(self) -> None:
        require(self.length > 0, "length", "BendSensor", "positive [m]", self.length)

    def __call__(self, q: Float[Tensor, "*batch 2"]) -> Float[Tensor, "*batch 3"]:
        """Return the flux density [mT] in the frame of the sensor, z along the straight arc; bend ``q`` below pi."""
        if q.shape[-1:] != (2,):
            raise bad_input("q", "BendSensor", "of last dimension 2", f"shape {tuple(q.shape)}")
        x, y = q.unbind(-1)
        z = x * x + y * y
        half = se3.sinc(z / 4)  # sin(phi/2)/(phi/2): both functions of the angle by one series
        s, c = half * (1 - z / 4 * half * half).sqrt(), half * half / 2
        edges = (self.cube.edge, self.cube.edge, self.cube.edge)
        L, J = self.length, self.cube.polarisation_mt
        Bx, By, Bz = cuboid_components(L * x * c, L * y * c, -L * s, edges, J)
        # Rodrigues' rotation about (-y, x, 0): B + s w x B + c w x (w x B)
        along = x * Bx + y * By
        push = s * Bz - c * along
        return torch.stack([Bx + x * push, By + y * push, Bz - s * along - c * z * Bz], dim=-1)

    def position(self, q: Float[Tensor, "*batch 2"]) -> Float[Tensor, "*batch 3"]:
        """Return the position of the magnet [m] in the frame of the sensor."""
        z = (q * q).sum(-1, keepdim=True)
        return self.length * torch.cat([q * se3.cosc(z), se3.sinc(z)], dim=-1)
