r"""Permanent magnets: their fields by magpylib, and the multipoles of axisymmetric ones."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import magpylib as magpy
import numpy as np
from jaxtyping import Float
from numpy.polynomial import Legendre
from numpy.polynomial.legendre import leggauss

from edition1.errors import bad_input, require

_MT_PER_T = 1e3


@dataclass(frozen=True)
class Ring:
    """A ring magnet, magnetised along its axis (the z axis of its frame).

    Parameters
    ----------
    outer_diameter, inner_diameter, height
        Dimensions [m]. An inner diameter of zero is a full cylinder.
    polarisation_mt
        Magnetic polarisation [mT].

    Raises
    ------
    InputError
        If the dimensions do not describe a ring.

    Examples
    --------
    >>> Ring(24e-3, 12e-3, 6e-3, 1450.0).field(np.array([0.0, 0.0, 0.05])).round(3)  # on the axis, 50 mm away [mT]
    array([0.   , 0.   , 3.402])
    """

    outer_diameter: float
    inner_diameter: float
    height: float
    polarisation_mt: float

    def __post_init__(self) -> None:
        if not 0 <= self.inner_diameter < self.outer_diameter or not self.height > 0:
            expected = "0 <= inner < outer and a positive height [m]"
            raise bad_input("dimensions", "Ring", expected, self)
        require(
            math.isfinite(self.polarisation_mt), "polarisation_mt", "Ring", "finite", self.polarisation_mt
        )

    def field(self, positions: Float[np.ndarray, "*batch 3"]) -> Float[np.ndarray, "*batch 3"]:
        """Flux density [mT] at positions [m], both in the frame of the magnet, by magpylib: the oracle.

        The ring is the full cylinder less its bore; magpylib solves both in closed form.
        """
        total = _cylinder(self.outer_diameter, self.height, self.polarisation_mt, positions)
        if self.inner_diameter > 0:
            total -= _cylinder(self.inner_diameter, self.height, self.polarisation_mt, positions)
        return total

    def multipoles(self, l_max: int) -> Float[np.ndarray, " terms"]:
        r"""Axial multipole moments :math:`A_1, A_3, \dots, A_{l_{max}}` [mT m^(l+2)].

        Outside the sphere around the magnet the scalar potential is
        :math:`\sum_l A_l P_l(\cos\theta)/r^{l+1}`. The faces of the ring carry the magnetic charge
        :math:`\pm J`, so :math:`A_l = J \int_a^b \varrho\, r^l P_l(h/2r)\, d\varrho` with
        :math:`r^2 = \varrho^2 + h^2/4` (even ``l`` vanish). The integrand is a polynomial: Gauss-Legendre
        quadrature is exact. :math:`A_1 = J V/4\pi`.

        Raises
        ------
        InputError
            If ``l_max`` is not a positive odd number.

        Examples
        --------
        >>> moments = ring("published").multipoles(5)
        >>> np.round(moments * [1e9, 1e15, 1e21], 0)  # mT mm^(l+2)
        array([   58725., -1453444.,  7729678.])
        """
        if l_max < 1 or l_max % 2 == 0:
            raise bad_input("l_max", "Ring.multipoles", "a positive odd number", l_max)
        nodes, weights = leggauss(l_max + 2)
        a, b = self.inner_diameter / 2, self.outer_diameter / 2
        rho = (b + a) / 2 + (b - a) / 2 * nodes
        r = np.hypot(rho, self.height / 2)
        terms = [r**n * Legendre.basis(n)(self.height / 2 / r) for n in range(1, l_max + 1, 2)]
        return self.polarisation_mt * (b - a) / 2 * (np.array(terms) * rho) @ weights


@dataclass(frozen=True)
class Cube:
    """A cube magnet, magnetised along the z axis of its frame.

    Parameters
    ----------
    edge
        Length of an edge [m].
    polarisation_mt
        Magnetic polarisation [mT].

    Raises
    ------
    InputError
        If the edge is not positive, or the polarisation not finite.

    Examples
    --------
    >>> Cube(10e-3, 1450.0).field(np.array([0.0, 0.0, 0.1])).round(4)  # a dipole's 2 J a^3 / (4 pi r^3) [mT]
    array([0.    , 0.    , 0.2308])
    """

    edge: float
    polarisation_mt: float

    def __post_init__(self) -> None:
        require(self.edge > 0, "edge", "Cube", "positive [m]", self.edge)
        require(
            math.isfinite(self.polarisation_mt), "polarisation_mt", "Cube", "finite", self.polarisation_mt
        )

    def field(self, positions: Float[np.ndarray, "*batch 3"]) -> Float[np.ndarray, "*batch 3"]:
        """Flux density [mT] at positions [m], both in the frame of the magnet, by magpylib."""
        dimensions = (self.edge, self.edge, self.edge)
        return _flux(magpy.func.cuboid_field, dimensions, self.polarisation_mt, positions)


_RINGS = {
    "released": Ring(24e-3, 12e-3, 6e-3, 1450.0),
    "published": Ring(12e-3, 6e-3, 6e-3, 1450.0),
}
"""Two readings of the ring of Baaij et al. 2023, section 3.1: the text gives 12 and 6 mm as diameters
(``published``); the released simulator uses the same numbers as radii (``released``), and the printed errors
in mT and step sizes belong to that ring."""

B444B = Cube(edge=6.35e-3, polarisation_mt=1320.0)
"""The cube of Mitchell et al. 2021, section III: a quarter-inch cube, polarisation as in the released code."""


def ring(name: str) -> Ring:
    """Ring of this name: ``"released"`` (24/12 mm) or ``"published"`` (12/6 mm).

    Raises
    ------
    InputError
        If there is no ring of this name.
    """
    require(name in _RINGS, "name", "ring", f"one of {', '.join(map(repr, _RINGS))}", repr(name))
    return _RINGS[name]


def _cylinder(diameter: float, height: float, polarisation_mt: float, positions: np.ndarray) -> np.ndarray:
    return _flux(magpy.func.cylinder_field, (diameter, height), polarisation_mt, positions)


def _flux(
    field: Callable[..., np.ndarray],
    dimensions: tuple[float, ...],
    polarisation_mt: float,
    positions: np.ndarray,
) -> np.ndarray:
    if np.shape(positions)[-1:] != (3,):
        raise bad_input("positions", "field", "of last dimension 3", f"shape {np.shape(positions)}")
    points = np.asarray(positions, dtype=float).reshape(-1, 3)
    n = len(points)
    if n == 0:
        return np.zeros(np.shape(positions))
    require(math.isfinite(points.sum()), "positions", "field", "finite [m]", "NaN or infinity")
    polarisation = np.array([0.0, 0.0, polarisation_mt / _MT_PER_T])
    flux = field(
        "B",
        points,
        dimensions=np.broadcast_to(np.array(dimensions), (n, len(dimensions))),
        polarizations=np.broadcast_to(polarisation, (n, 3)),
        squeeze=False,
    )
    return _MT_PER_T * flux.reshape(np.shape(positions))
