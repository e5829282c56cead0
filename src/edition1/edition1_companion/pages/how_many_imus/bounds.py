r"""How far a model of the arm can be off between perfect IMUs: bounds from the largest curvature and its slope.

Assumptions: the arm neither stretches nor shears, so its tangent is the z axis of its frame; the IMUs are
exact and at their arc positions. The frame turns along the arm at a body rate :math:`|\omega| \le \kappa`
with :math:`|\omega'| \le \kappa'`; without twist the first is the curvature and the second bounds the
derivative of its two components in a parallel (Bishop) frame. With the tangent :math:`d` and that of the
model :math:`\hat d`, the error at :math:`s` is at most :math:`\int_0^s |\hat d - d|`, and never above
:math:`2s`. What follows is summed over links of length :math:`h`; :math:`x` is the distance from the start of
a link, :math:`k = \kappa h`.

**Rigid link, IMU at m.** The angle to the IMU's tangent is at most :math:`\kappa|\sigma - m|`, its chord
:math:`2\sin(\kappa|\sigma - m|/2)`: an integral of about :math:`\kappa h^2/2` for an IMU at the end of the
link, :math:`\kappa h^2/4` in its middle. Taylor's formula about :math:`m` with
:math:`|d''| \le M = \sqrt{\kappa'^2 + \kappa^4}` gives
:math:`\kappa\,|(b - m)^2 - (a - m)^2|/2 + M \int_a^b (\sigma - m)^2/2`: for an IMU in the middle
:math:`M h^3/24`. The smaller of the two counts.

**Exact arc.** Let :math:`e` be the rotation vector from the model's frame to the true one. Both ends of a
link are exact, and the parts of :math:`e'` across :math:`e` do not change its length:
:math:`|e|' \le |\omega - \hat\omega|` with the constant rate :math:`\hat\omega` of the arc, so :math:`|e(x)|`
is at most the integral of :math:`|\omega - \hat\omega|` from either end. With
:math:`|\omega|, |\hat\omega| \le \kappa`: :math:`|e| \le 2\kappa\min(x, h - x)`. With the slope: the mean
rate :math:`\bar\omega` has :math:`|\omega - \bar\omega| \le \kappa'(x^2 + (h - x)^2)/2h`, and
:math:`\int |e| \le 3\kappa'h^3/32 + Dh^2/4` over the link, where :math:`D \ge |\hat\omega - \bar\omega|`
comes from rates at different places not commuting. Integrating
:math:`e' = (\omega - \hat\omega) + e\times(\omega + \hat\omega)/2 + c\,e\times(e\times(\omega - \hat\omega))`,
:math:`c\,|e|^2 = g = 1 - (|e|/2)\cot(|e|/2)`, over the link gives

.. math:: Dh \le k\,(3\kappa'h^2/32 + Dh/4) + g\,(\kappa'h^2/3 + Dh), \qquad |e| \le \kappa'h^2/6 + Dh/2,

whose smallest solution is the bound (:math:`D` is continuous in :math:`h` and starts at 0): of third order in
:math:`h`. The smaller of the two counts.

**PCC-extended.** Its joints lie on the arcs, widened by :math:`f = 1/\mathrm{sinc}(\min(k, \pi)/2n)` across
the axis (`edition1.estimation.imu_models`): at most :math:`(f - 1)` times the arc length off, of order
:math:`k^2/24n^2`. On a sub-segment of length :math:`w`, :math:`\kappa y(w - y)/2` is added at the distance
:math:`y` from its joint.

**Tangent interpolation.** The linear interpolation :math:`v` between tangents differs from :math:`d` by
:math:`\int G(x, \tau)\, d''(\tau)\, d\tau` with Green's function :math:`G \ge 0`,
:math:`\int G\, d\tau = x(h - x)/2`. Across :math:`d(x)` the size of :math:`d''(\tau)` is at most
:math:`\kappa' + \kappa^3|\tau - x|`, so that of :math:`v` is at most
:math:`r = \kappa' x(h - x)/2 + \kappa^3 x(h - x)(x^2 + (h - x)^2)/6h`, and with :math:`|v| \ge \cos(k/2)` the
sine of the angle between :math:`v` and :math:`d` at most :math:`S = r/\cos(k/2)`. This needs
:math:`k < \pi/2` and :math:`S < 1`. Sub-segments add the error of the midpoint rule on that curve, whose rate
is at most :math:`(2/h)\tan(k/2)`.

All but the rigid link with its IMU at the end are of third order in :math:`h` per link, of second order for
the arm.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from edition1.errors import bad_input, require
from edition1.estimation.imu_selection import Selection

Bound = Float[np.ndarray, " points"]
_Points = float | Sequence[float] | Bound


def rigid_bound(
    selection: Selection, arc_lengths: _Points, *, curvature: float, slope: float = math.inf
) -> Bound:
    """Bound of the position error of `edition1.estimation.imu_models.rigid_links` between perfect IMUs.

    Parameters
    ----------
    selection
        One link per IMU.
    arc_lengths
        Points, by their distance from the base [m].
    curvature
        Largest body rate along the arm [rad/m].
    slope
        Largest derivative of it [rad/m^2]; infinite where nothing is known.

    Returns
    -------
    Float[np.ndarray, " points"]
        Bounds [m].

    Raises
    ------
    InputError
        If the curvature is negative or not finite, the slope negative or NaN, an arc length is beyond the
        chain, or the selection is not for this model.

    Examples
    --------
    Eight links of 80 mm with IMUs at their ends, and with IMUs in their middles, bent by at most 4 rad/m:

    >>> arm = Selection(tuple(range(1, 9)), tuple(0.08 * np.arange(1, 9)), (0.08,) * 8)
    >>> (1e3 * rigid_bound(arm, 0.64, curvature=4.0, slope=20.0)).round(1)
    array([102.2])
    >>> middles = Selection(arm.imus, tuple(0.08 * np.arange(8) + 0.04), arm.link_lengths)
    >>> (1e3 * rigid_bound(middles, 0.64, curvature=4.0, slope=20.0)).round(1)
    array([4.4])
    """
    points, starts, lengths = _checked(selection, arc_lengths, curvature, slope, "rigid_bound", between=False)
    a = (starts - np.array(selection.arcs)) + np.zeros_like(points)[:, None]
    b = a + np.clip(points[:, None] - starts, 0.0, lengths)
    bounds = _chord_integral(b, curvature) - _chord_integral(a, curvature)
    if math.isfinite(slope):
        M = math.hypot(slope, curvature**2)
        bounds = np.minimum(bounds, curvature * np.abs(b**2 - a**2) / 2 + M * (b**3 - a**3) / 6)
    return _total(bounds, points)


def arcs_bound(
    selection: Selection, arc_lengths: _Points, *, curvature: float, slope: float = math.inf
) -> Bound:
    """Bound of the position error of `edition1.estimation.imu_models.exact_arcs` between perfect IMUs.

    Parameters
    ----------
    selection
        One link between each two IMUs, as long as they are apart.
    arc_lengths, curvature, slope
        As :func:`rigid_bound`.

    Raises
    ------
    InputError
        As :func:`rigid_bound`.
    """
    points, starts, h = _checked(selection, arc_lengths, curvature, slope, "arcs_bound", between=True)
    x = np.clip(points[:, None] - starts, 0.0, h)
    near, far = np.minimum(x, h / 2), np.minimum(h - x, h / 2)
    first = curvature * (near**2 + (h / 2) ** 2 - far**2)
    D = np.array([_commutator(curvature * length, slope * length**2) for length in h]) / h
    if np.isfinite(D).all():
        second = _half(near, h, slope, D) + _half(h / 2, h, slope, D) - _half(far, h, slope, D)
        first = np.minimum(first, second)
    return _total(first, points)


def pcc_bound(
    selection: Selection, arc_lengths: _Points, *, curvature: float, slope: float = math.inf
) -> Bound:
    """Bound of the position error of `edition1.estimation.imu_models.pcc_extended` between perfect IMUs.

    Parameters and errors as :func:`arcs_bound`.
    """
    points, starts, h = _checked(selection, arc_lengths, curvature, slope, "pcc_bound", between=True)
    n = selection.sub_links
    factor = 1 / np.sinc(np.minimum(curvature * h, np.pi) / (2 * np.pi * n))
    joint, inside = _sub_joints(points, starts, h, n)
    deviation = ((factor - 1) * joint + curvature * inside).sum(axis=1)
    arcs = arcs_bound(selection, arc_lengths, curvature=curvature, slope=slope)
    return np.minimum(arcs + deviation, 2 * points)


def _chord_integral(y: np.ndarray, curvature: float) -> np.ndarray:
    """Integral from 0 to y of the chord 2 sin(curvature |y|/2), at most 2; odd in y."""
    if curvature == 0:
        return np.zeros_like(y)
    turned = np.minimum(np.abs(y), np.pi / curvature)
    return np.sign(y) * (8 / curvature * np.sin(curvature * turned / 4) ** 2 + 2 * (np.abs(y) - turned))


def _half(x: np.ndarray, h: np.ndarray, slope: float, D: np.ndarray) -> np.ndarray:
    """Integral of the bound of the angle from one end of an arc up to x <= h/2."""
    return slope / (24 * h) * (x**4 + (h - x) ** 4 - h**4 + 4 * h**3 * x) + D * x**2 / 2


def _commutator(k: float, a: float) -> float:
    """Smallest solution D h of the inequality at the head of this module; infinite if there is none."""
    if k >= np.pi or math.isinf(a):
        return math.inf
    D = 0.0
    for _ in range(1000):
        e = a / 6 + D / 2
        if e >= np.pi / 2:
            return math.inf
        g = 1 - (e / 2) / math.tan(e / 2) if e > 1e-4 else e * e / 12
        new = k * (3 * a / 32 + D / 4) + g * (a / 3 + D)
        if new - D <= 1e-13 * new:
            return new * (1 + 1e-9)
        D = new
    return math.inf


def _sub_joints(
    points: np.ndarray, starts: np.ndarray, h: np.ndarray, n: int
) -> tuple[np.ndarray, np.ndarray]:
    """Arc length on each link up to the sub-joint nearest to a point, and y (w - y)/2 of the point."""
    x, w = np.clip(points[:, None] - starts, 0.0, h), h / n
    joint = np.round(x / w) * w
    y = np.abs(x - joint)
    return joint, y * (w - y) / 2


def _checked(
    selection: Selection,
    arc_lengths: _Points,
    curvature: float,
    slope: float,
    owner: str,
    *,
    between: bool,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Check the input; return points, starts of links and their lengths [m]."""
    if not (math.isfinite(curvature) and curvature >= 0):
        raise bad_input("curvature", owner, "finite and not negative [rad/m]", curvature)
    require(slope >= 0, "slope", owner, "not negative [rad/m^2]", slope)
    lengths = np.array(selection.link_lengths)
    ends = np.cumsum(lengths)
    if between and not (selection.sub_links and np.allclose(selection.arcs, [0.0, *ends], atol=1e-9)):
        raise bad_input("selection", owner, "links from IMU to IMU, from the base on", selection)
    if selection.turn_share != 1:
        raise bad_input("selection", owner, 'one with the interpolation "midpoints"', selection)
    if not between and selection.sub_links:
        raise bad_input("selection", owner, "one link per IMU (sub_links 0)", selection)
    points = np.atleast_1d(np.asarray(arc_lengths, dtype=float))
    if points.ndim != 1 or not ((points >= 0) & (points <= ends[-1] * (1 + 1e-12))).all():
        raise bad_input("arc_lengths", owner, f"distances between 0 and {ends[-1]:g} m", points)
    return points, ends - lengths, lengths


def _total(per_link: np.ndarray, points: np.ndarray) -> np.ndarray:
    return np.minimum(per_link.sum(axis=1), 2 * points)
