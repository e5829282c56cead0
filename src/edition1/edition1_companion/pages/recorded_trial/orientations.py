r"""Orientations of the IMUs in the paper's own trial, from positions that two of its models gave.

The trial's readings are not at hand, what the models made of them is. A link of ``rigid.csv`` points along the z axis
:math:`d_{i+1}` of IMU :math:`i + 1`, and the link of ``pcc1.csv`` that ends there along the z axis :math:`m` of the
orientation halfway between the IMUs :math:`i` and :math:`i + 1`: two directions, four equations, for the three
unknowns of the next orientation. With the orientation halfway :math:`h`, which takes z to :math:`m` and is else
turned about it by an unknown angle :math:`\beta`,

.. math:: q_{i+1} = h\, q_i^{-1} h, \qquad h = h_0 R_z(\beta), \qquad
          R_z(\beta)\, q_i^{-1} m = h_0^{-1} d_{i+1},

so that :math:`\beta` is the angle about z between two known vectors. The fourth equation, that both are equally far
from z, says that :math:`m` is as far from :math:`d_i` as from :math:`d_{i+1}`: nothing but the data can make it hold.
On a straight link, where both vectors are on the z axis, no angle is told.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from edition1.errors import bad_input
from edition1.estimation.imu_models import pcc_extended
from edition1.estimation.imu_selection import Selection
from edition1.estimation.orientations import exponential, product, tangents

_CONJUGATE = np.array([-1.0, -1.0, -1.0, 1.0])
_START_ANGLES = 72  # of the search for the last orientation
_STEPS = 12  # of Gauss and Newton, each with half a start angle at most

Quaternions = Float[np.ndarray, "rows 4"]
Vectors = Float[np.ndarray, "rows 3"]


def next_orientation(before: Quaternions, halfway: Vectors, following: Vectors) -> Quaternions:
    """The orientation whose z axis is ``following``, and halfway to which from ``before`` the z axis is ``halfway``.

    Parameters
    ----------
    before
        Unit quaternions XYZW.
    halfway, following
        Unit vectors; halfway is of the shorter way round.

    Returns
    -------
    Quaternions
        Unit quaternions XYZW. Where the three directions coincide, the turn about them is arbitrary.

    Examples
    --------
    A quarter turn about x, from upright; then the same with a frame that was turned about z before:

    >>> upright, h = np.array([[0.0, 0.0, 0.0, 1.0]]), np.sqrt(0.5)
    >>> next_orientation(upright, np.array([[0.0, -h, h]]), np.array([[0.0, -1.0, 0.0]])).round(6) + 0.0
    array([[0.707107, 0.      , 0.      , 0.707107]])
    """
    h = _taking_z_to(halfway)
    a, b = _turned(before * _CONJUGATE, halfway), _turned(h * _CONJUGATE, following)
    h = product(h, _about_z(np.arctan2(b[:, 1], b[:, 0]) - np.arctan2(a[:, 1], a[:, 0])))
    found = product(h, product(before * _CONJUGATE, h))
    # What is left of the fourth equation goes into the direction halfway.
    return product(exponential(np.cross(tangents(found), following)), found)


def orientations_between(
    base: Quaternions,
    halfway: Float[np.ndarray, "rows links 3"],
    following: Float[np.ndarray, "rows links 3"],
) -> Float[np.ndarray, "rows imus 4"]:
    """Orientations of a base and of the IMUs after it, by :func:`next_orientation` one after another."""
    found = [base]
    for link in range(halfway.shape[1]):
        found.append(next_orientation(found[-1], halfway[:, link], following[:, link]))
    return np.stack(found, axis=1)


def last_orientation(
    before: Quaternions, third: Vectors, start: Quaternions, step: Vectors, link_m: float, sub_links: int
) -> Quaternions:
    """The orientation at the end of two links: one from ``before``, a longer one from ``start``.

    Parameters
    ----------
    before
        Orientations at the start of the one link, unit quaternions XYZW.
    third
        Unit vectors: its z axes after a third of the turn.
    start
        Orientations at the start of the other link.
    step
        Displacement [m] over the first three quarters of its sub-segments, at midpoints.
    link_m, sub_links
        Its length [m] and its sub-segments, a multiple of 4.

    Returns
    -------
    Quaternions
        Of the angles about ``third`` that are left, the one whose displacement comes closest: five equations for
        three unknowns.

    Raises
    ------
    InputError
        If ``sub_links`` is no multiple of 4.
    """
    if sub_links < 4 or sub_links % 4:
        raise bad_input("sub_links", "last_orientation", "a multiple of 4", sub_links)
    other = Selection((0, 1), (0.0, link_m), (link_m,), sub_links=sub_links)
    known, back = _taking_z_to(third), before * _CONJUGATE

    def ended(angle: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """End, its displacement less the given one, and whether the way to it is the shorter one."""
        h = product(product(known, _about_z(angle)), back)
        end = product(h, product(h, product(h, before)))
        found = pcc_extended(np.stack([start, end], axis=1), other, [0.75 * link_m])[:, 0]
        return end, found - step, np.abs(h[:, 3]) >= np.cos(np.radians(30.5))

    angles = np.linspace(-np.pi, np.pi, _START_ANGLES, endpoint=False)
    sizes = []
    for angle in angles:
        _, error, shorter = ended(np.full(len(before), angle))
        sizes.append(np.where(shorter, np.linalg.norm(error, axis=1), np.inf))
    angle = angles[np.argmin(sizes, axis=0)]
    for _ in range(_STEPS):
        error, ahead = ended(angle)[1], ended(angle + 1e-6)[1]
        slope = (ahead - error) / 1e-6
        change = (slope * error).sum(axis=1) / np.maximum((slope**2).sum(axis=1), 1e-30)
        angle = angle - np.clip(change, -np.pi / _START_ANGLES, np.pi / _START_ANGLES)
    return ended(angle)[0]


def unevenness_deg(
    before: Float[np.ndarray, "*samples 3"],
    halfway: Float[np.ndarray, "*samples 3"],
    following: Float[np.ndarray, "*samples 3"],
) -> Float[np.ndarray, "*samples"]:
    """What the fourth equation leaves: angle from ``before`` to ``halfway`` less that on to ``following`` [deg]."""
    return np.degrees(_angle(before, halfway) - _angle(halfway, following))


def _angle(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return np.arctan2(np.linalg.norm(np.cross(a, b), axis=-1), (a * b).sum(axis=-1))


def _about_z(angle: np.ndarray) -> np.ndarray:
    return np.stack([0 * angle, 0 * angle, np.sin(angle / 2), np.cos(angle / 2)], axis=-1)


def _taking_z_to(direction: np.ndarray) -> np.ndarray:
    """Unit quaternions that take z to a direction; of opposite ones, half a turn about x."""
    x, y, z = np.moveaxis(direction, -1, 0)
    q = np.stack([-y, x, 0 * x, 1 + z], axis=-1)
    norm = np.linalg.norm(q, axis=-1, keepdims=True)
    return np.where(norm > 1e-9, q / np.maximum(norm, 1e-9), [1.0, 0.0, 0.0, 0.0])


def _turned(q: np.ndarray, vector: np.ndarray) -> np.ndarray:
    """Vectors turned by unit quaternions."""
    x, w = q[..., :3], q[..., 3:]
    return vector + 2 * np.cross(x, np.cross(x, vector) + w * vector)
