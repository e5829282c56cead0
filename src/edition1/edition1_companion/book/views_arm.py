"""3-D view of a soft arm by what its IMUs say: the chain of Martin et al. 2022."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from edition1.estimation.imu_chain import adjacent_angles, point_at, rigid_body
from edition1.estimation.orientations import tangents
from edition1_companion.book.views_frames import every_nth
from edition1_live.view.shape_view import Markers, Shape, ShapeView, Traces

RADIUS_M = 0.0125
"""Radius of the body that is drawn [m]; assumed, as that of the simulated rod."""
POINTS_PER_LINK = 4
LONGEST_S = 40.0
"""No view shows more than the beginning of this length [s]."""
FRAMES = 200
"""Most frames of a view: the arm is fast."""


def chain_view(
    time_s: Float[np.ndarray, " samples"],
    orientations: Float[np.ndarray, "samples imus 4"],
    link_lengths_m: Float[np.ndarray, " imus"],
    source: str,
    sensors_m: Float[np.ndarray, " imus"] | None = None,
) -> ShapeView:
    """Chain of straight links, one for each IMU, over time (Martin et al. 2022, equation 2).

    Of a long stream the beginning is shown.

    Parameters
    ----------
    time_s
        Times of the samples [s].
    orientations
        Unit quaternions XYZW, link frame to world.
    link_lengths_m
        Lengths of the links, base to tip [m].
    source
        Where the orientations come from.
    sensors_m
        Where the sensors sit along the chain [m]; at the ends of their links when not given.
    """
    n = int(np.searchsorted(time_s, time_s[0] + LONGEST_S))
    shown = every_nth(n, FRAMES)
    q, times = orientations[shown], time_s[shown]
    joints = rigid_body(q, link_lengths_m)
    arcs = np.linspace(0.0, link_lengths_m.sum(), POINTS_PER_LINK * len(link_lengths_m) + 1)
    pairs, up = np.degrees(adjacent_angles(q)), tangents(q)
    at = joints[:, 1:] if sensors_m is None else point_at(joints, link_lengths_m, sensors_m)
    tip_mm = 1e3 * joints[:, -1]
    label = (
        f"Arm as a chain of {len(link_lengths_m)} straight links along its IMUs, from a {source}. {len(times)} "
        f"frames from {times[0]:.4g} to {times[-1]:.4g} s. The tip is at z = {tip_mm[:, 2].min():.0f} to "
        f"{tip_mm[:, 2].max():.0f} mm; neighbours are turned by {pairs.max():.0f} degrees at most."
    )
    between = {f"{k} to {k + 1}": pairs[:, k] for k in range(pairs.shape[1])}
    return ShapeView(
        label=label,
        time_s=times,
        shapes=(Shape(f"chain of links, {source}", point_at(joints, link_lengths_m, arcs), role="estimate"),),
        radius_m=RADIUS_M,
        sensors=Markers(at, up, "IMUs"),
        traces=(
            Traces("angle between neighbours", "deg", between),
            Traces("inclination of the IMUs", "deg", inclinations(up, first=0)),
            Traces("tip", "mm", {axis: tip_mm[:, k] for k, axis in enumerate("xyz")}),
        ),
    )


def inclinations(up: Float[np.ndarray, "samples imus 3"], *, first: int) -> dict[str, np.ndarray]:
    """Angle of each IMU from the vertical [deg], by its number.

    Parameters
    ----------
    up
        Unit vectors along the z axes of the IMUs.
    first
        Number of the first IMU.
    """
    angles = np.degrees(np.arccos(up[..., 2].clip(-1.0, 1.0)))
    return {f"IMU {k}": column for k, column in enumerate(angles.T, start=first)}
