r"""What one three-axis sensor reads of a cube at the other end of a bent arc (Mitchell et al. 2021, section II).

The sensor sits at the base of the arc, aligned with it; the cube at its tip, magnetised along the arc. An arc without
twist is its own mirror image, so in the frame of the magnet the sensor is at :math:`L (q_x c, q_y c, -s)`, with
:math:`s = \sin\varphi/\varphi` and :math:`c = (1 - \cos\varphi)/\varphi^2`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from repro.common import Array, kernel, numbers, require
from repro.magnets import Cube


@dataclass(frozen=True)
class BendSensor:
    r"""Sensor model of Mitchell et al. 2021: from a bend vector to the flux density at the base of the arc.

    The bend vector :math:`q = \varphi (\cos\theta, \sin\theta)` [rad] has the bend angle as its length and points
    towards the bend. It has no singularity where the arc is straight, unlike :math:`(\theta, \varphi)`. The field of
    the cube is its closed form, exact to rounding.

    Parameters
    ----------
    length
        Length of the arc from the sensor to the centre of the magnet [m], longer than 1.25 edges of the
        cube: below half a turn the sensor then stays clear of it.
    cube
        The magnet; if not given the B444B of the paper, 1/4 inch with 1320 mT.

    Raises
    ------
    InputError
        If the length is not longer than 1.25 edges.

    Examples
    --------
    Straight, the sensor is on the axis of the cube, 15 mm from its centre:

    >>> sensor = BendSensor(0.015)
    >>> sensor([0.0, 0.0]).round(4)
    array([ 0.    ,  0.    , 15.8308])

    A quarter circle of length L ends at (2 L/pi, 0, 2 L/pi):

    >>> sensor.position([np.pi / 2, 0.0]).round(6)
    array([0.009549, 0.      , 0.009549])
    """

    length: float
    cube: Cube = field(default_factory=lambda: Cube(6.35e-3, 1320.0))

    def __post_init__(self) -> None:
        fits = 1.25 * self.cube.edge < self.length < math.inf
        require(fits, "length", "BendSensor", "longer than 1.25 edges of the cube [m]", self.length)

    def __call__(self, q: Any) -> Array:
        """Return the flux density ``[..., 3]`` [mT] in the frame of the sensor, z along the straight arc.

        ``q`` are bend vectors ``[..., 2]`` [rad] of less than half a turn; NaN gives NaN.
        """
        q = numbers(q, "q", "BendSensor", (..., 2), finite=False)
        out = np.empty((*q.shape[:-1], 3))
        half_edge, scale = self.cube.edge / 2, self.cube.polarisation_mt / (4 * math.pi)
        flat = np.ascontiguousarray(q).reshape(-1)
        _bend_field(flat, self.length / half_edge, scale, out.reshape(-1))
        return out

    def position(self, q: Any) -> Array:
        """Return the position of the magnet ``[..., 3]`` [m] in the frame of the sensor."""
        q = numbers(q, "q", "BendSensor", (..., 2), finite=False)
        angle = np.hypot(q[..., :1], q[..., 1:])
        half = np.sinc(angle / (2 * math.pi))
        return self.length * np.concatenate([q * half**2 / 2, np.sinc(angle / math.pi)], axis=-1)


@kernel
def _bend_field(q, length, scale, out):
    r"""Write the flux density for flat bend vectors; lengths are in half edges, ``scale`` is J/(4 pi).

    The two pole faces carry the magnetic charge :math:`\pm J`. Coulomb's law gives sums over the eight corners, whose
    sign is the product of the signs of their coordinates. With :math:`(\xi, \eta, \zeta)` from a corner to the sensor
    and :math:`r` its length, :math:`B_x = -J/4\pi \sum \pm \ln(\eta + r)`,
    :math:`B_y = -J/4\pi \sum \pm \ln(\xi + r)` and :math:`B_z = J/4\pi \sum \pm \arctan(\xi\eta/\zeta r)`.

    Eight logarithms become one of a ratio, eight arctangents the angle of a product of complex numbers. Series, exact
    to rounding, stand for the functions of the angle, and short loops call nothing but the square root: so the
    processor handles several bends at once.
    """
    n = len(q) // 2
    s, c, x_root, y_root, z_half = np.empty((5, n))
    for i in range(n):
        square = 0.25 * (q[2 * i] * q[2 * i] + q[2 * i + 1] * q[2 * i + 1])
        half = cosine = 1.0  # sin(h)/h and cos(h) of half the angle
        for k in range(11, -1, -1):
            half = 1.0 - square * (1.0 / ((2 * k + 2) * (2 * k + 3))) * half
            cosine = 1.0 - square * (1.0 / ((2 * k + 1) * (2 * k + 2))) * cosine
        s[i], c[i] = half * cosine, 0.5 * half * half
        # The field is a mirror image of that in the first octant, where eta + r does not cancel.
        x, y, z = abs(length * q[2 * i] * c[i]), abs(length * q[2 * i + 1] * c[i]), abs(length * s[i])
        x_up, x_down, y_up, y_down, re, im = 1.0, 1.0, 1.0, 1.0, 1.0, 0.0
        for j in range(2):
            for k in range(2):
                # Corners at +x and -x; where y and z have different signs, they change places.
                near, far = (x - 1.0, x + 1.0) if j == k else (x + 1.0, x - 1.0)
                eta, zeta = y - 1.0 + 2.0 * j, z - 1.0 + 2.0 * k
                a = math.sqrt(near * near + eta * eta + zeta * zeta)
                b = math.sqrt(far * far + eta * eta + zeta * zeta)
                x_up, x_down, y_up, y_down = (
                    x_up * (eta + a),
                    x_down * (eta + b),
                    y_up * (near + a),
                    y_down * (far + b),
                )
                p, m = zeta * zeta * a * b + eta * eta * near * far, eta * zeta * (near * b - far * a)
                re, im = re * p - im * m, re * m + im * p
        x_root[i], y_root[i] = math.sqrt(x_up / x_down), math.sqrt(y_up / y_down)
        z_half[i] = im / (math.sqrt(re * re + im * im) + re)
    for i in range(n):
        # A logarithm is four times the inverse of tanh at x, an angle four times that of tan at z.
        x, y = (x_root[i] - 1.0) / (x_root[i] + 1.0), (y_root[i] - 1.0) / (y_root[i] + 1.0)
        z = z_half[i] / (1.0 + math.sqrt(1.0 + z_half[i] * z_half[i]))
        Bx = By = Bz = 0.0
        for k in range(15, -1, -1):
            Bx, By, Bz = (
                Bx * (x * x) + 1.0 / (2 * k + 1),
                By * (y * y) + 1.0 / (2 * k + 1),
                1.0 / (2 * k + 1) - Bz * (z * z),
            )
        u, v, side = q[2 * i], q[2 * i + 1], math.copysign(4.0 * scale, s[i])
        Bx, By, Bz = (
            math.copysign(1.0, u) * side * x * Bx,
            math.copysign(1.0, v) * side * y * By,
            4.0 * scale * z * Bz,
        )
        # Rodrigues' rotation about (-v, u, 0): B + s w x B + c w x (w x B).
        along = u * Bx + v * By
        push = s[i] * Bz - c[i] * along
        out[3 * i], out[3 * i + 1] = Bx + u * push, By + v * push
        out[3 * i + 2] = Bz - s[i] * along - c[i] * (u * u + v * v) * Bz
