"""The shape of an arm from the orientations of IMUs along it: a chain of rigid links (Martin et al. 2022).

Orientations are quaternions XYZW (SciPy's order) that turn link coordinates into world coordinates
(``T_world_link``); a link lies along the z axis of its own frame. Lengths are in metres, angles in radians.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from edition1.errors import bad_input, require
from edition1.estimation._imu_arcs import Points
from edition1.estimation._quaternions import turn_between, unit_quaternions
from edition1.estimation.orientations import product, tangents

_Lengths = Sequence[float] | Float[np.ndarray, " links"]

_HALF = np.sqrt(0.5)
# R_imu_link: turns link coordinates (link along z) into those of a sensor with the named axis along the link.
_R_IMU_LINK = {
    "x": np.array([0.0, _HALF, 0.0, _HALF]),
    "y": np.array([-_HALF, 0.0, 0.0, _HALF]),
    "z": np.array([0.0, 0.0, 0.0, 1.0]),
}


def link_orientations(
    orientations: Float[np.ndarray, "*samples imus 4"], along_arm: str = "z"
) -> Float[np.ndarray, "*samples imus 4"]:
    """Turn sensor orientations into link orientations, for sensors mounted with another axis along the arm.

    Equation (2) takes the z axis of an IMU as the direction of its link. An IMU whose ``along_arm`` axis
    points from the base to the tip needs one fixed rotation first:
    ``R_world_link = R_world_imu R_imu_link`` with ``R_imu_link e_z = e_along_arm``. The turn about the link
    that remains free does not change the shape.

    Parameters
    ----------
    orientations
        Unit quaternions XYZW of the IMUs, sensor frame to world.
    along_arm
        Axis of the sensors that points along the arm, base to tip: "x", "y" or "z".

    Raises
    ------
    InputError
        Unknown axis, or quaternions that are not unit within 1e-3.

    Examples
    --------
    A sensor whose y axis points up in the world, on a link that points up:

    >>> y_up = np.array([[np.sqrt(0.5), 0.0, 0.0, np.sqrt(0.5)]])
    >>> tangents(link_orientations(y_up, "y")).round(12) + 0.0
    array([[0., 0., 1.]])
    """
    turn = _mounting(along_arm, "link_orientations")
    return product(unit_quaternions(orientations, "link_orientations"), turn)


def rigid_body(
    orientations: Float[np.ndarray, "*samples imus 4"], link_lengths: _Lengths
) -> Float[np.ndarray, "*samples joints 3"]:
    r"""Joint positions of the rigid-body model, one link per IMU.

    .. math:: \hat x_i = \sum_{j=0}^{i-1} R_q(q_j) \, (0, 0, L_j)^T

    Parameters
    ----------
    orientations
        Unit quaternions XYZW of the links, base to tip, link frame to world. With ``L_0 = 0``, as in the
        paper's experiments, the base's own orientation has no effect and is left out here.
    link_lengths
        Length of each link [m], one per IMU; zero is allowed.

    Returns
    -------
    Float[np.ndarray, "*samples joints 3"]
        Positions [m] of the ``imus + 1`` joints in the world frame, the first at the origin.

    Raises
    ------
    InputError
        Quaternions that are not finite or not unit within 1e-3, or lengths that are negative, not finite or
        not one per IMU.

    References
    ----------
    Martin, Bruder and Wood (2022), section II-A, equation (2).

    Examples
    --------
    Two upright links of 80 mm:

    >>> rigid_body(np.array([[0.0, 0.0, 0.0, 1.0]] * 2), [0.08, 0.08])[:, 2]
    array([0.  , 0.08, 0.16])
    """
    directions = tangents(unit_quaternions(orientations, "rigid_body"))
    lengths = _lengths(link_lengths, directions.shape[-2], "rigid_body")
    steps = directions * lengths[:, None]
    return np.concatenate([np.zeros_like(steps[..., :1, :]), np.cumsum(steps, axis=-2)], axis=-2)


def point_at(
    joints: Float[np.ndarray, "*samples joints 3"], link_lengths: _Lengths, arc_lengths: Points
) -> Float[np.ndarray, "*samples points 3"]:
    """Positions at given arc lengths, by linear interpolation between adjacent joints.

    Parameters
    ----------
    joints
        Joint positions [m], as `rigid_body` returns them.
    link_lengths
        Length of each link [m], one less than there are joints.
    arc_lengths
        Distances from the first joint along the chain [m], between 0 and the sum of the link lengths.

    Returns
    -------
    Float[np.ndarray, "*samples points 3"]
        Positions [m] in the frame of ``joints``.

    Raises
    ------
    InputError
        Wrong shapes, lengths that are negative or not finite, or an arc length beyond the chain.

    References
    ----------
    Martin, Bruder and Wood (2022), section II, the paragraph before II-A.

    Examples
    --------
    >>> upright = rigid_body(np.array([[0.0, 0.0, 0.0, 1.0]] * 2), [0.08, 0.08])
    >>> point_at(upright, [0.08, 0.08], [0.02, 0.12])[:, 2]
    array([0.02, 0.12])
    """
    joints = np.asarray(joints, dtype=float)
    if joints.ndim < 2 or joints.shape[-1] != 3 or joints.shape[-2] < 2:
        raise bad_input("joints", "point_at", "an array (..., joints >= 2, 3)", f"shape {joints.shape}")
    lengths = _lengths(link_lengths, joints.shape[-2] - 1, "point_at")
    total = lengths.sum()
    arcs = np.atleast_1d(np.asarray(arc_lengths, dtype=float))
    beyond = ~((arcs >= 0) & (arcs <= total * (1 + 1e-12)))
    if arcs.ndim != 1 or beyond.any():
        raise bad_input(
            "arc_lengths",
            "point_at",
            f"distances between 0 and {total:g} m",
            arcs[beyond] if arcs.ndim == 1 else arcs,
        )
    starts = np.cumsum(lengths) - lengths
    passed = np.clip(
        arcs[:, None] - starts, 0.0, lengths
    )  # metres of each link between the base and the point
    fraction = np.divide(passed, lengths, out=np.zeros_like(passed), where=lengths > 0)
    return joints[..., :1, :] + fraction @ np.diff(joints, axis=-2)


def adjacent_angles(
    orientations: Float[np.ndarray, "*samples imus 4"],
) -> Float[np.ndarray, "*samples pairs"]:
    """Angle of the rotation from each IMU to the next one.

    Parameters
    ----------
    orientations
        Unit quaternions XYZW, base to tip.

    Returns
    -------
    Float[np.ndarray, "*samples pairs"]
        ``imus - 1`` angles [rad] between 0 and pi. Twist about the arm counts like bending.

    Raises
    ------
    InputError
        Quaternions that are not finite or not unit within 1e-3.

    Examples
    --------
    >>> quarter = np.array([[0.0, 0.0, 0.0, 1.0], [np.sqrt(0.5), 0.0, 0.0, np.sqrt(0.5)]])
    >>> np.degrees(adjacent_angles(quarter)).round(9)
    array([90.])
    """
    q = unit_quaternions(orientations, "adjacent_angles")
    return np.linalg.norm(turn_between(q[..., :-1, :], q[..., 1:, :]), axis=-1)


def _mounting(along_arm: str, owner: str) -> np.ndarray:
    """Return R_imu_link of sensors with the named axis along the arm."""
    require(along_arm in _R_IMU_LINK, "along_arm", owner, 'one of "x", "y" and "z"', along_arm)
    return _R_IMU_LINK[along_arm]


def _lengths(link_lengths: _Lengths, links: int, owner: str) -> np.ndarray:
    """Check link lengths and return them as an array [m]."""
    lengths = np.asarray(link_lengths, dtype=float)
    if lengths.shape != (links,):
        raise bad_input(
            "link_lengths", owner, f"one length per link, {links} in all", f"shape {lengths.shape}"
        )
    if not (np.isfinite(lengths) & (lengths >= 0)).all():
        raise bad_input("link_lengths", owner, "finite and not negative [m]", lengths)
    return lengths


def sensor_orientations(
    orientations: Float[np.ndarray, "*samples imus 4"], along_arm: str = "z"
) -> Float[np.ndarray, "*samples imus 4"]:
    """Turn link orientations into sensor orientations: undoes `link_orientations`, whose arguments it takes.

    Raises
    ------
    InputError
        As `link_orientations`.
    """
    turn = _mounting(along_arm, "sensor_orientations") * [-1.0, -1.0, -1.0, 1.0]
    return product(unit_quaternions(orientations, "sensor_orientations"), turn)
