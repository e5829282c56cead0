r"""Shapes of the arm between IMUs: the paper's two chains, its proposal for a faster one, and two smooth curves.

All models have one signature, ``model(orientations, selection, arc_lengths) -> positions``: from the
orientations of the selected IMUs to the positions of points at given arc lengths, in the world frame, with
the base at the origin.

.. rubric:: One formula for sub-segments and for arcs

On a link of length :math:`L` the orientation turns from IMU to IMU about a fixed axis :math:`a` by the angle
:math:`\varphi`; its tangent at the fraction :math:`t` is :math:`d(t) = e^{t\varphi[a]_\times} d(0)`. With
:math:`\mathrm{sinc}\,x = \sin x/x`, the sum of equation (5) over the first :math:`k = tn` of :math:`n`
sub-segments is a geometric series in :math:`e^{\varphi[a]_\times/n}`, and its value is

.. math:: x(t) = L\,t\,\bigl(S\, d(t/2) + (1 - S)\,(a \cdot d(0))\,a\bigr),
          \qquad S = \frac{\mathrm{sinc}(t\varphi/2)}{\mathrm{sinc}(\varphi/2n)},

which tends to the arc of constant curvature (and torsion) as :math:`n \to \infty`, where the denominator
becomes 1: the left Jacobian of SO(3) applied to :math:`L t\, d(0)`. The joints of the chain lie on that arc,
widened by the factor :math:`1/\mathrm{sinc}(\varphi/2n) = 1 + \varphi^2/24n^2 + O(n^{-4})` across the axis.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from jaxtyping import Float
from numpy.polynomial.legendre import leggauss
from scipy.interpolate import CubicSpline

from repro.errors import bad_input
from repro.estimation.imu_chain import Points, point_at, rigid_body
from repro.estimation.imu_selection import Selection
from repro.estimation.orientations import axis_and_angle, tangents, turn_between, unit_quaternions

ShapeModel = Callable[[np.ndarray, Selection, Sequence[float]], np.ndarray]
"""From orientations ``[*samples, imus, 4]``, a selection and arc lengths to positions ``[*samples, points, 3]``."""

QUADRATURE_NODES = 4
"""Gauss-Legendre nodes per piece of the spline: exact for polynomials of degree 7, the spline is of degree 3."""

_OPPOSITE = 1e-6  # tangents this close to opposite have no direction between them


def chain(
    orientations: Float[np.ndarray, "*samples imus 4"], selection: Selection, arc_lengths: Points
) -> Float[np.ndarray, "*samples points 3"]:
    """Positions on the paper's chain for a selection: rigid-body if it has no sub-segments, else PCC-extended.

    Parameters and errors are those of the two models.
    """
    return (pcc_extended if selection.sub_links else rigid_links)(orientations, selection, arc_lengths)


def rigid_links(
    orientations: Float[np.ndarray, "*samples imus 4"], selection: Selection, arc_lengths: Points
) -> Float[np.ndarray, "*samples points 3"]:
    """Positions on the rigid-body model: straight links along the IMUs' z axes.

    Parameters
    ----------
    orientations
        Unit quaternions XYZW of the selected IMUs, link frame to world.
    selection
        One link per IMU.
    arc_lengths
        Distances from the base along the chain [m].

    Raises
    ------
    InputError
        Quaternions that are not finite or not unit within 1e-3; IMUs and links that do not match; an arc
        length beyond the chain.

    References
    ----------
    Martin, Bruder and Wood (2022), section II-A, equation (2).
    """
    joints = rigid_body(orientations, selection.link_lengths)
    return point_at(joints, selection.link_lengths, arc_lengths)


def pcc_extended(
    orientations: Float[np.ndarray, "*samples imus 4"], selection: Selection, arc_lengths: Points
) -> Float[np.ndarray, "*samples points 3"]:
    """Positions on the PCC-extended rigid-body model: straight sub-segments, interpolated between adjacent IMUs.

    Sub-segment k of n has the orientation ``slerp(q_i, q_i+1, (2k + 1)/2n)``, by the shorter way round.
    Joints follow from the sum in closed form, points between them by linear interpolation.

    Parameters
    ----------
    orientations
        Unit quaternions XYZW of the selected IMUs, the base first, link frame to world.
    selection
        One link between each two IMUs, with its sub-segments.
    arc_lengths
        Distances from the base along the chain [m].

    Raises
    ------
    InputError
        As `rigid_links`, and if the selection has no sub-segments.

    References
    ----------
    Martin, Bruder and Wood (2022), section II-B, equations (3) to (7).

    Examples
    --------
    A quarter circle of 640 mm (radius 407 mm) from two orientations and 16 sub-segments:

    >>> quarter = np.array([[0.0, 0.0, 0.0, 1.0], [0.0, np.sqrt(0.5), 0.0, np.sqrt(0.5)]])
    >>> bent = Selection((0, 8), (0.0, 0.64), (0.64,), sub_links=16)
    >>> (1e3 * pcc_extended(quarter, bent, [0.64])).round(1) + 0.0
    array([[407.6,   0. , 407.6]])
    >>> (1e3 * exact_arcs(quarter, bent, [0.64])).round(1) + 0.0
    array([[407.4,   0. , 407.4]])
    """
    _links_between(selection, "pcc_extended")
    return _arcs(orientations, selection, arc_lengths, "pcc_extended", selection.sub_links)


def exact_arcs(
    orientations: Float[np.ndarray, "*samples imus 4"], selection: Selection, arc_lengths: Points
) -> Float[np.ndarray, "*samples points 3"]:
    """Positions on the limit of ever more sub-segments: between IMUs the frame turns at a constant rate.

    Each link is one screw motion in SE(3): an arc of constant curvature if neighbours differ by bending
    alone, a helix if they are also twisted. The sub-segments of the selection have no effect.

    Parameters
    ----------
    orientations, selection, arc_lengths
        As `pcc_extended`.

    Raises
    ------
    InputError
        As `pcc_extended`.

    References
    ----------
    Martin, Bruder and Wood (2022), section II-B: "As n increases, this model approximates a PCC model".
    """
    _links_between(selection, "exact_arcs")
    return _arcs(orientations, selection, arc_lengths, "exact_arcs", 0)


def tangent_interpolation(
    orientations: Float[np.ndarray, "*samples imus 4"], selection: Selection, arc_lengths: Points
) -> Float[np.ndarray, "*samples points 3"]:
    """Positions on a chain as `pcc_extended`, its sub-segments along linearly interpolated tangents.

    The paper proposes it for speed: of each orientation only the z axis is kept, and between two of them the
    interpolation is linear. Here the interpolated vectors are rescaled to unit length, so that sub-segments
    keep their lengths (the paper does not say). Twist of the IMUs about the arm has no effect at all.

    Parameters
    ----------
    orientations, selection, arc_lengths
        As `pcc_extended`.

    Raises
    ------
    InputError
        As `pcc_extended`, and if neighbours point in opposite directions.

    References
    ----------
    Martin, Bruder and Wood (2022), section V, on computation.
    """
    _links_between(selection, "tangent_interpolation")
    d = _tangents(orientations, selection, "tangent_interpolation")
    n = selection.sub_links
    middles = ((2 * np.arange(n) + 1) / (2 * n))[:, None]
    between = (1 - middles) * d[..., :-1, None, :] + middles * d[..., 1:, None, :]
    sub_lengths = np.repeat(np.array(selection.link_lengths) / n, n)
    directions = _unit(between, "tangent_interpolation").reshape(*d.shape[:-2], len(sub_lengths), 3)
    joints = np.cumsum(directions * sub_lengths[:, None], axis=-2)
    joints = np.concatenate([np.zeros_like(joints[..., :1, :]), joints], axis=-2)
    return point_at(joints, sub_lengths, arc_lengths)


def tangent_spline(
    orientations: Float[np.ndarray, "*samples imus 4"], selection: Selection, arc_lengths: Points
) -> Float[np.ndarray, "*samples points 3"]:
    r"""Positions along a smooth curve whose tangent is a cubic spline through the tangents of the IMUs.

    Each component of the z axes of the IMUs is interpolated over arc length by a cubic spline with
    "not-a-knot" ends (through three tangents a parabola, through two a line), the vector rescaled to unit
    length and integrated, :math:`x(s) = \int_0^s d/|d|`, by Gauss-Legendre quadrature between IMUs. Tangents
    at IMUs are met exactly; twist about the arm has no effect. The sub-segments of the selection have no
    effect either.

    Parameters
    ----------
    orientations, selection, arc_lengths
        As `pcc_extended`.

    Raises
    ------
    InputError
        As `pcc_extended`, and if neighbours point in opposite directions.
    """
    _links_between(selection, "tangent_spline")
    d = _tangents(orientations, selection, "tangent_spline")
    points = _points(arc_lengths, selection, "tangent_spline")
    knots = np.append(0.0, np.cumsum(selection.link_lengths))
    pieces = np.unique(np.concatenate([knots[knots <= points.max(initial=0.0)], points]))
    at, weights = leggauss(QUADRATURE_NODES)
    nodes = (pieces[:-1, None] + np.diff(pieces)[:, None] * (at + 1) / 2).ravel()
    weights = (np.diff(pieces)[:, None] * weights / 2).ravel()
    basis = CubicSpline(knots, np.eye(len(knots)), bc_type="not-a-knot")(nodes)
    before = (nodes[:, None] < points) * weights[:, None]  # what each node adds to each point
    directions = _unit(np.moveaxis(np.moveaxis(d, -2, -1) @ basis.T, -2, -1), "tangent_spline")
    return np.moveaxis(np.moveaxis(directions, -2, -1) @ before, -2, -1)


def _arcs(
    orientations: np.ndarray, selection: Selection, arc_lengths: Points, owner: str, n: int
) -> np.ndarray:
    """Positions on arcs (n = 0) or on chains of n sub-segments per link."""
    q = unit_quaternions(orientations, owner)
    _one_per_imu(q, selection, owner)
    points = _points(arc_lengths, selection, owner)
    d, lengths = tangents(q[..., :-1, :]), np.array(selection.link_lengths)
    axis, angle = axis_and_angle(turn_between(q[..., :-1, :], q[..., 1:, :]))
    steps = lengths[:, None] * _chord(d, axis, angle, np.ones_like(lengths), n)
    starts = np.cumsum(steps, axis=-2) - steps
    ends = np.cumsum(lengths)
    link = np.minimum(np.searchsorted(ends, points), len(lengths) - 1)
    share = np.clip((points - ends[link]) / lengths[link] + 1.0, 0.0, 1.0)
    d, axis, angle = d[..., link, :], axis[..., link, :], angle[..., link]
    joint = np.minimum(np.floor(share * n), n - 1) / n if n else share
    within = joint[:, None] * _chord(d, axis, angle, joint, n)
    if n:
        within = within + (share - joint)[:, None] * _turned(d, axis, angle * (joint + 0.5 / n))
    return starts[..., link, :] + lengths[link, None] * within


def _chord(d: np.ndarray, axis: np.ndarray, angle: np.ndarray, share: np.ndarray, n: int) -> np.ndarray:
    """Displacement per arc length from the start of a link to a share of it; see the head of this module."""
    s = np.sinc(share * angle / (2 * np.pi)) / (np.sinc(angle / (2 * np.pi * n)) if n else 1.0)
    along = (axis * d).sum(axis=-1, keepdims=True) * axis
    return s[..., None] * _turned(d, axis, angle * share / 2) + (1 - s)[..., None] * along


def _turned(d: np.ndarray, axis: np.ndarray, angle: np.ndarray) -> np.ndarray:
    """Rodrigues' formula."""
    sine, cosine = np.sin(angle)[..., None], np.cos(angle)[..., None]
    x, y, z = np.moveaxis(axis, -1, 0)
    a, b, c = np.moveaxis(d, -1, 0)
    across = np.stack([y * c - z * b, z * a - x * c, x * b - y * a], axis=-1)
    along = (x * a + y * b + z * c)[..., None] * axis
    return cosine * d + sine * across + (1 - cosine) * along


def _tangents(orientations: np.ndarray, selection: Selection, owner: str) -> np.ndarray:
    q = unit_quaternions(orientations, owner)
    _one_per_imu(q, selection, owner)
    d = tangents(q)
    _unit(d[..., :-1, :] + d[..., 1:, :], owner)
    return d


def _unit(vectors: np.ndarray, owner: str) -> np.ndarray:
    """Rescale vectors between tangents; zero is one between opposite tangents."""
    norms = np.sqrt(np.einsum("...i,...i->...", vectors, vectors))[..., None]
    if (norms < _OPPOSITE).any():
        expected = "such that neighbours do not point in opposite directions"
        raise bad_input("orientations", owner, expected, f"{int((norms < _OPPOSITE).sum())} that do")
    return vectors / norms


def _links_between(selection: Selection, owner: str) -> None:
    if not selection.sub_links:
        raise bad_input("selection", owner, "one with links between IMUs (sub_links above 0)", selection)


def _one_per_imu(q: np.ndarray, selection: Selection, owner: str) -> None:
    if q.shape[-2] != len(selection.imus):
        expected = f"those of the {len(selection.imus)} IMUs of the selection"
        raise bad_input("orientations", owner, expected, f"shape {q.shape}")


def _points(arc_lengths: Points, selection: Selection, owner: str) -> np.ndarray:
    """Check arc lengths and return them as an array [m]."""
    points, total = np.atleast_1d(np.asarray(arc_lengths, dtype=float)), sum(selection.link_lengths)
    if points.ndim != 1 or not ((points >= 0) & (points <= total * (1 + 1e-12))).all():
        raise bad_input("arc_lengths", owner, f"distances between 0 and {total:g} m", points)
    return points
