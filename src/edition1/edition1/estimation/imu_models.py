r"""Shapes of the arm between IMUs: the paper's two chains, its proposal for a faster one, and two smooth curves.

All models have one signature, ``model(orientations, selection, arc_lengths) -> positions``: from the
orientations of the selected IMUs to the positions of points at given arc lengths, in the world frame, with
the base at the origin.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from jaxtyping import Float
from numpy.polynomial.legendre import leggauss
from scipy.interpolate import CubicSpline

from edition1.errors import bad_input
from edition1.estimation._imu_arcs import Points, from_base, links_between, points_on, positions
from edition1.estimation._quaternions import unit_quaternions
from edition1.estimation.imu_chain import point_at, rigid_body
from edition1.estimation.imu_selection import Selection
from edition1.estimation.orientations import tangents

ShapeModel = Callable[[np.ndarray, Selection, Sequence[float]], np.ndarray]
"""From orientations ``[*samples, imus, 4]``, a selection and arc lengths to positions ``[*samples, points, 3]``."""

_QUADRATURE_NODES = 4
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
        Distances from the origin of the chain along it [m].

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
    return from_base(point_at(joints, selection.link_lengths, arc_lengths), selection)


def pcc_extended(
    orientations: Float[np.ndarray, "*samples imus 4"],
    selection: Selection,
    arc_lengths: Points,
) -> Float[np.ndarray, "*samples points 3"]:
    """Positions on the PCC-extended rigid-body model: straight sub-segments, interpolated between adjacent IMUs.

    Sub-segment k of n has the orientation ``slerp(q_i, q_i+1, (2k + 1)/2n)``, by the shorter way round; with the
    selection's interpolation "inner points", ``slerp(q_i, q_i+1, (k + 1)/(n + 1))``. Joints follow from the sum in
    closed form, points between them by linear interpolation.

    Parameters
    ----------
    orientations
        Unit quaternions XYZW of the selected IMUs, the base first, link frame to world.
    selection
        One link between each two IMUs, with its sub-segments.
    arc_lengths
        Distances from the origin of the chain along it [m].

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
    links_between(selection, "pcc_extended")
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
    links_between(selection, "exact_arcs")
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
    links_between(selection, "tangent_interpolation")
    d = _tangents(orientations, selection, "tangent_interpolation")
    n = selection.sub_links
    middles = (1 - selection.turn_share) / 2 + selection.turn_share * ((2 * np.arange(n) + 1) / (2 * n))[
        :, None
    ]
    between = (1 - middles) * d[..., :-1, None, :] + middles * d[..., 1:, None, :]
    sub_lengths = np.repeat(np.array(selection.link_lengths) / n, n)
    directions = _unit(between, "tangent_interpolation").reshape(*d.shape[:-2], len(sub_lengths), 3)
    joints = np.cumsum(directions * sub_lengths[:, None], axis=-2)
    joints = np.concatenate([np.zeros_like(joints[..., :1, :]), joints], axis=-2)
    return from_base(point_at(joints, sub_lengths, arc_lengths), selection)


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
    links_between(selection, "tangent_spline")
    d = _tangents(orientations, selection, "tangent_spline")
    points = points_on(arc_lengths, selection, "tangent_spline")
    knots = np.append(0.0, np.cumsum(selection.link_lengths))
    pieces = np.unique(np.concatenate([knots[knots <= points.max(initial=0.0)], points]))
    at, weights = leggauss(_QUADRATURE_NODES)
    nodes = (pieces[:-1, None] + np.diff(pieces)[:, None] * (at + 1) / 2).ravel()
    weights = (np.diff(pieces)[:, None] * weights / 2).ravel()
    basis = CubicSpline(knots, np.eye(len(knots)), bc_type="not-a-knot")(nodes)
    before = (nodes[:, None] < points) * weights[:, None]  # what each node adds to each point
    directions = _unit(np.moveaxis(np.moveaxis(d, -2, -1) @ basis.T, -2, -1), "tangent_spline")
    return from_base(np.moveaxis(np.moveaxis(directions, -2, -1) @ before, -2, -1), selection)


def _arcs(
    orientations: np.ndarray, selection: Selection, arc_lengths: Points, owner: str, n: int
) -> np.ndarray:
    """Positions on arcs (n = 0) or on chains of n sub-segments per link."""
    q = unit_quaternions(orientations, owner)
    _one_per_imu(q, selection, owner)
    points = points_on(arc_lengths, selection, owner)
    turn_share = selection.turn_share if n else 1.0
    return from_base(positions(q, np.array(selection.link_lengths), points, n, turn_share), selection)


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


def _one_per_imu(q: np.ndarray, selection: Selection, owner: str) -> None:
    if q.shape[-2] != len(selection.imus):
        expected = f"those of the {len(selection.imus)} IMUs of the selection"
        raise bad_input("orientations", owner, expected, f"shape {q.shape}")
