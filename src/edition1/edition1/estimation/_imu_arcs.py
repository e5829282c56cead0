r"""Arcs and chains of sub-segments between IMUs by one closed form, vectorised.

On a link of length :math:`L` the orientation turns from IMU to IMU about a fixed axis :math:`a` by the angle
:math:`\varphi`; its tangent at the fraction :math:`t` is :math:`d(t) = e^{t\varphi[a]_\times} d(0)`. With
:math:`\mathrm{sinc}\,x = \sin x/x`, the sum of equation (5) over the first :math:`k = tn` of :math:`n`
sub-segments is a geometric series in :math:`e^{\varphi[a]_\times/n}`, and its value is

.. math:: x(t) = L\,t\,\bigl(S\, d(t/2) + (1 - S)\,(a \cdot d(0))\,a\bigr),
          \qquad S = \frac{\mathrm{sinc}(t\varphi/2)}{\mathrm{sinc}(\varphi/2n)},

which tends to the arc of constant curvature (and torsion) as :math:`n \to \infty`, where the denominator
becomes 1: the left Jacobian of SO(3) applied to :math:`L t\, d(0)`. The joints of the chain lie on that arc,
widened by the factor :math:`1/\mathrm{sinc}(\varphi/2n) = 1 + \varphi^2/24n^2 + O(n^{-4})` across the axis.

These :math:`n` sub-segments are turned to the middles of :math:`n` equal parts of the turn. Where they are spread
evenly over a share :math:`c` of it, about its middle, :math:`x(t)` has :math:`d((1 - c + ct)/2)` in place of
:math:`d(t/2)`, and :math:`\varphi` in :math:`S` is :math:`c\varphi`.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from edition1.errors import bad_input
from edition1.estimation._quaternions import axis_and_angle, turn_between
from edition1.estimation.imu_selection import Selection
from edition1.estimation.orientations import tangents


def positions(
    q: Float[np.ndarray, "*samples imus 4"],
    lengths: Float[np.ndarray, " links"],
    points: Float[np.ndarray, " points"],
    n: int,
    turn_share: float = 1.0,
) -> Float[np.ndarray, "*samples points 3"]:
    """Positions on arcs (``n = 0``) or on chains of ``n`` sub-segments per link.

    Parameters
    ----------
    q
        Unit quaternions XYZW, link frame to world; one more than there are links.
    lengths
        Of the links [m].
    points
        Arc lengths [m] from the base, on the chain.
    n
        Sub-segments of each link.
    turn_share
        Share c of a link's turn over which they are spread.
    """
    d = tangents(q[..., :-1, :])
    axis, angle = axis_and_angle(turn_between(q[..., :-1, :], q[..., 1:, :]))
    steps = lengths[:, None] * _chord(d, axis, angle, np.ones_like(lengths), n, turn_share)
    starts = np.cumsum(steps, axis=-2) - steps
    link, share = place(lengths, points)
    d, axis, angle = d[..., link, :], axis[..., link, :], angle[..., link]
    joint = np.minimum(np.floor(share * n), n - 1) / n if n else share
    within = joint[:, None] * _chord(d, axis, angle, joint, n, turn_share)
    if n:
        middle = (1 - turn_share) / 2 + turn_share * (joint + 0.5 / n)
        within = within + (share - joint)[:, None] * _turned(d, axis, angle * middle)
    return starts[..., link, :] + lengths[link, None] * within


def place(
    lengths: Float[np.ndarray, " links"], points: Float[np.ndarray, " points"]
) -> tuple[np.ndarray, np.ndarray]:
    """Link of each point, and the share of that link before it."""
    ends = np.cumsum(lengths)
    link = np.minimum(np.searchsorted(ends, points), len(lengths) - 1)
    return link, np.clip((points - ends[link]) / lengths[link] + 1.0, 0.0, 1.0)


def _chord(
    d: np.ndarray, axis: np.ndarray, angle: np.ndarray, share: np.ndarray, n: int, c: float
) -> np.ndarray:
    """Displacement per arc length from the start of a link to a share of it; see the head of this module."""
    s = np.sinc(share * c * angle / (2 * np.pi)) / (np.sinc(angle * c / (2 * np.pi * n)) if n else 1.0)
    along = (axis * d).sum(axis=-1, keepdims=True) * axis
    return s[..., None] * _turned(d, axis, angle * (1 - c + c * share) / 2) + (1 - s)[..., None] * along


def _turned(d: np.ndarray, axis: np.ndarray, angle: np.ndarray) -> np.ndarray:
    """Rodrigues' formula."""
    sine, cosine = np.sin(angle)[..., None], np.cos(angle)[..., None]
    x, y, z = np.moveaxis(axis, -1, 0)
    a, b, c = np.moveaxis(d, -1, 0)
    across = np.stack([y * c - z * b, z * a - x * c, x * b - y * a], axis=-1)
    along = (x * a + y * b + z * c)[..., None] * axis
    return cosine * d + sine * across + (1 - cosine) * along


def from_base(points: np.ndarray, selection: Selection) -> np.ndarray:
    """Move points of a chain from its origin to the base."""
    return points + np.array(selection.origin_m) if any(selection.origin_m) else points


def links_between(selection: Selection, owner: str) -> None:
    """Refuse a selection without sub-segments."""
    if not selection.sub_links:
        raise bad_input("selection", owner, "one with links between IMUs (sub_links above 0)", selection)


def points_on(arc_lengths: Points, selection: Selection, owner: str) -> np.ndarray:
    """Check arc lengths and return them as an array [m]."""
    points, total = np.atleast_1d(np.asarray(arc_lengths, dtype=float)), sum(selection.link_lengths)
    if points.ndim != 1 or not ((points >= 0) & (points <= total * (1 + 1e-12))).all():
        raise bad_input("arc_lengths", owner, f"distances between 0 and {total:g} m", points)
    return points


Points = float | Sequence[float] | Float[np.ndarray, " points"]
