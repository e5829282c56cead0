r"""The sensor of a bent arc as a polynomial, compiled: for filters with many particles and a limit on the bend.

The field of the cube at the base of the arc is smooth in the bend vector :math:`(x, y)`, and turns and is mirrored
with it as a square does. Functions with these symmetries are polynomials in :math:`a = x^2 + y^2` and
:math:`b = 4 x^2 y^2`:

.. math:: B_x = x\,(P + x^2 Q), \qquad B_y = y\,(P + y^2 Q), \qquad B_z = G, \qquad P, Q, G \in \mathbb{R}[a, b].

The coefficients are those of least squares over the disc that bends may reach; what is left is measured on other
points against the closed form, and a series that is not good enough is refused.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cache, cached_property

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from edition1.errors import bad_input, require
from edition1.kernels._bend import bend_field
from edition1.kernels.compilation import machine_code
from edition1.sensing.magnets import B444B, Cube

_A_TERMS, _B_TERMS = 8, 4
"""Powers of ``a`` and of ``b``, from zero: 3 pT and less left for the cube and the arc of Mitchell et al. 2021."""
_LARGEST_ERROR_MT = 1e-4
"""A series further than this from the closed form is refused [mT]."""


@machine_code(reorder=True)
def series_field(x, y, coefficients, reach, scratch, out):
    """Write the flux density at bends ``x[n], y[n]`` into ``out[3, n]``; ``scratch`` is ``[5, n]``.

    Loops over particles are the inner ones: several particles go through the processor at once.
    """
    n, unit = len(x), 1.0 / reach
    a, b, P, Q, G = scratch[0], scratch[1], scratch[2], scratch[3], scratch[4]
    for i in range(n):
        xx, yy = (unit * x[i]) ** 2, (unit * y[i]) ** 2
        a[i], b[i] = xx + yy, 4.0 * xx * yy
    _polynomial(coefficients[0], a, b, P)
    _polynomial(coefficients[1], a, b, Q)
    _polynomial(coefficients[2], a, b, G)
    for i in range(n):
        s, t = unit * x[i], unit * y[i]
        out[0, i] = s * (P[i] + s * s * Q[i])
        out[1, i] = t * (P[i] + t * t * Q[i])
        out[2, i] = G[i]


@machine_code(reorder=True)
def _polynomial(c, a, b, out):
    """Sum of ``c[j, k] b^j a^k`` by Horner's rule."""
    out[:] = 0.0
    for j in range(_B_TERMS - 1, -1, -1):
        c_0, c_1, c_2, c_3 = c[j, 0], c[j, 1], c[j, 2], c[j, 3]
        c_4, c_5, c_6, c_7 = c[j, 4], c[j, 5], c[j, 6], c[j, 7]
        for i in range(len(a)):
            t = a[i]
            high = ((c_7 * t + c_6) * t + c_5) * t + c_4
            low = ((c_3 * t + c_2) * t + c_1) * t + c_0
            t *= t
            out[i] = out[i] * b[i] + high * (t * t) + low


@dataclass(frozen=True)
class BendSeries:
    """Sensor model like :class:`~edition1.kernels._bend.CompiledBendSensor`, for bends up to a limit.

    Parameters
    ----------
    length
        Length of the arc from sensor to magnet [m].
    reach
        Largest bend angle [rad], below pi.
    cube
        The magnet.

    Raises
    ------
    InputError
        If the length or the reach is not positive, the reach not below pi, or the series further than 1e-4 mT from
        the closed form: for a long reach, or a magnet close to the sensor.

    Examples
    --------
    >>> series = BendSeries(15e-3, math.pi / 2)
    >>> series(torch.zeros(2, dtype=torch.float64))[2]
    tensor(15.8308, dtype=torch.float64)
    >>> series.error_mt < 1e-8
    True
    """

    length: float
    reach: float
    cube: Cube = B444B

    def __post_init__(self) -> None:
        require(self.length > 0, "length", "BendSeries", "positive [m]", self.length)
        require(0 < self.reach < math.pi, "reach", "BendSeries", "between 0 and pi [rad]", self.reach)
        if not self.error_mt <= _LARGEST_ERROR_MT:
            expected = f"such that the series is within {_LARGEST_ERROR_MT:g} mT of the closed form"
            received = f"{self.length:g} m and {self.reach:g} rad, {self.error_mt:.2g} mT off"
            raise bad_input("length, reach", "BendSeries", expected, received)

    def __call__(self, q: Float[Tensor, "*batch 2"]) -> Float[Tensor, "*batch 3"]:
        """Return the flux density [mT] in the frame of the sensor, z along the straight arc.

        Raises
        ------
        InputError
            If a bend is beyond the reach, where the series means nothing.
        """
        flat = q.detach().cpu().double().reshape(-1, 2).numpy()
        if not (np.hypot(*flat.T) <= self.reach * (1 + 1e-12)).all():
            worst = float(np.hypot(*flat.T).max())
            raise bad_input("q", "BendSeries", f"of a bend of {self.reach:g} rad at most", worst)
        return torch.from_numpy(self._values(flat)).reshape(*q.shape[:-1], 3).to(q)

    @cached_property
    def coefficients(self) -> Float[np.ndarray, "3 b a"]:
        """Coefficients of P, Q and G [mT], of powers of ``b`` and ``a`` in units of the reach."""
        q = _points(self.reach, 60, 24)
        u, s = self._closed(q), q / self.reach
        a, b = (s * s).sum(1), 4 * (s[:, 0] * s[:, 1]) ** 2
        terms = (
            b[:, None, None] ** np.arange(_B_TERMS)[:, None] * a[:, None, None] ** np.arange(_A_TERMS)
        ).reshape(len(q), -1)
        lateral = np.concatenate([np.hstack([c * terms, c**3 * terms]) for c in s.T[..., None]])
        P_Q = np.linalg.lstsq(lateral, u[:, :2].T.ravel(), rcond=None)[0]
        G = np.linalg.lstsq(terms, u[:, 2], rcond=None)[0]
        return np.concatenate([P_Q, G]).reshape(3, _B_TERMS, _A_TERMS)

    @cached_property
    def error_mt(self) -> float:
        """Largest difference from the closed form [mT], on points that the coefficients do not come from."""
        q = _points(self.reach, 97, 41)
        return float(np.abs(self._values(q) - self._closed(q)).max())

    def _closed(self, q: np.ndarray) -> np.ndarray:
        out = np.empty((len(q), 3))
        bend_field(q, self.length, self.cube.edge, self.cube.polarisation_mt, out)
        return out

    def _values(self, q: np.ndarray) -> np.ndarray:
        x, y = (np.ascontiguousarray(c) for c in q.T)
        out = np.empty((3, len(q)))
        series_field(x, y, self.coefficients, self.reach, np.empty((5, len(q))), out)
        return np.ascontiguousarray(out.T)


@cache
def bend_series(length: float, reach: float, cube: Cube) -> BendSeries:
    """Return the series of an arc: fitted once, however many filters there are. See :class:`BendSeries`."""
    return BendSeries(length, reach, cube)


def _points(reach: float, rings: int, spokes: int) -> np.ndarray:
    """Bends on rings that crowd towards the limit, where series are worst; an eighth of the disc is all of it."""
    radius = reach * np.sin(np.linspace(0, math.pi / 2, rings))
    direction = np.linspace(0.0, math.pi / 4, spokes)
    return np.stack(
        [np.outer(radius, np.cos(direction)).ravel(), np.outer(radius, np.sin(direction)).ravel()], axis=1
    )
