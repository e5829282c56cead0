r"""The field of a cuboid magnet in closed form, in torch: batched and differentiable.

The two pole faces of a cuboid that is magnetised along z carry the magnetic charge :math:`\pm J`. Integrated over
both, Coulomb's law gives sums over the eight corners, with :math:`(\xi, \eta, \zeta)` the vector from a
corner to the point, :math:`r` its length and :math:`s` the sign of the corner (the product of those of its
coordinates):

.. math:: B_x = -\frac{J}{4\pi} \sum s \ln(\eta + r), \quad
          B_y = -\frac{J}{4\pi} \sum s \ln(\xi + r), \quad
          B_z = \frac{J}{4\pi} \sum s \arctan\frac{\xi\eta}{\zeta r} .

This is a model for estimators; readings that they are judged on come from magpylib (:mod:`edition1.sensing.magnets`).
"""

from __future__ import annotations

import math

import torch
from jaxtyping import Float
from torch import Tensor

from edition1.errors import require

_CORNERS = ((2, 1, 1), (1, 2, 1), (1, 1, 2))


def cuboid_field(
    positions: Float[Tensor, "*batch 3"], dimensions: tuple[float, float, float], polarisation_mt: float
) -> Float[Tensor, "*batch 3"]:
    r"""Flux density [mT] of a cuboid outside of it, at positions [m], both in the frame of the magnet.

    Parameters
    ----------
    positions
        Points outside the magnet, not on its edges. Derivatives exist off the planes of the pole faces.
    dimensions
        Lengths of the edges along x, y and z [m].
    polarisation_mt
        Magnetic polarisation along z [mT].

    Raises
    ------
    InputError
        If a dimension is not positive.

    Examples
    --------
    On the axis of a cube, one edge from its face; far away it is the dipole :math:`2 J V/(4 \pi r^3)`:

    >>> point = torch.tensor([[0.0, 0.0, 1.5], [0.0, 0.0, 100.0]], dtype=torch.float64)
    >>> field = cuboid_field(point, (1.0, 1.0, 1.0), 1000.0)[:, 2]
    >>> float(field[1]) / (2 * 1000 / (4 * math.pi * 100**3))  # doctest: +ELLIPSIS
    0.99999...
    """
    require(min(dimensions) > 0, "dimensions", "cuboid_field", "positive [m]", dimensions)
    x, y, z = positions.unbind(-1)
    return torch.stack(cuboid_components(x, y, z, dimensions, polarisation_mt), dim=-1)


def cuboid_components(
    x: Float[Tensor, "*batch"],
    y: Float[Tensor, "*batch"],
    z: Float[Tensor, "*batch"],
    dimensions: tuple[float, float, float],
    polarisation_mt: float,
) -> tuple[Float[Tensor, "*batch"], Float[Tensor, "*batch"], Float[Tensor, "*batch"]]:
    """Components of :func:`cuboid_field` at ``(x, y, z)``, for a caller that has them one by one."""
    # The field is that of the mirror image in the first octant, where eta + r does not cancel.
    p = torch.stack([x, y, z]).reshape(3, 1, -1)
    mirror = torch.copysign(p.new_ones(()), p)
    # One axis of length 2 for each coordinate of the corners, the upper ones first; the points come last.
    corners = p.new_tensor([[[edge / 2], [-edge / 2]] for edge in dimensions])
    parts = (p * mirror - corners).unbind(0)
    xi, eta, zeta = (c.reshape(*shape, c.shape[-1]) for c, shape in zip(parts, _CORNERS, strict=True))
    r = (xi * xi + eta * eta + zeta * zeta).sqrt()
    angle = torch.atan2(xi * eta * zeta.sign(), zeta.abs() * r)
    scale = polarisation_mt / (4 * math.pi)
    lateral = mirror[:2, 0] * (mirror[2] * -scale)
    along_x, along_y = _ratio(eta + r).log() * lateral[0], _ratio(xi + r).log() * lateral[1]
    return along_x.reshape(x.shape), along_y.reshape(x.shape), (scale * _difference(angle)).reshape(x.shape)


def _ratio(x: Tensor) -> Tensor:
    """Product over the corners, those of negative sign inverted: a sum of eight logarithms becomes one."""
    for _ in range(3):
        x = x[0] / x[1]
    return x


def _difference(x: Tensor) -> Tensor:
    """Sum over the corners with their signs."""
    for _ in range(3):
        x = x[0] - x[1]
    return x
