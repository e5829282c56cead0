"""Orientations of IMUs as arrays of unit quaternions: checked, turned, interpolated and filled where missing.

Quaternions are XYZW (SciPy's order) and turn link coordinates into world coordinates (``T_world_link``); a
link lies along the z axis of its own frame. A quaternion and its negative are one orientation.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

UNIT_TOLERANCE = 1e-3
"""Largest distance of a quaternion's norm from 1 that is taken for rounding and rescaled."""


def tangents(orientations: Float[np.ndarray, "*samples 4"]) -> Float[np.ndarray, "*samples 3"]:
    """Directions of links in the world: the z axes of their frames, the third column of equation (1).

    Examples
    --------
    >>> tangents(np.array([np.sqrt(0.5), 0.0, 0.0, np.sqrt(0.5)])).round(12) + 0.0
    array([ 0., -1.,  0.])
    """
    x, y, z, w = np.moveaxis(orientations, -1, 0)
    return np.stack([2 * (x * z + y * w), 2 * (y * z - x * w), 1 - 2 * (x * x + y * y)], axis=-1)


def product(
    first: Float[np.ndarray, "*#samples 4"], second: Float[np.ndarray, "*#samples 4"]
) -> Float[np.ndarray, "*samples 4"]:
    """Quaternion of the turn ``second`` followed by the turn ``first``, both in the same fixed frame."""
    ax, ay, az, aw = np.moveaxis(first, -1, 0)
    bx, by, bz, bw = np.moveaxis(second, -1, 0)
    return np.stack(
        [
            aw * bx + ax * bw + ay * bz - az * by,
            aw * by - ax * bz + ay * bw + az * bx,
            aw * bz + ax * by - ay * bx + az * bw,
            aw * bw - ax * bx - ay * by - az * bz,
        ],
        axis=-1,
    )


def exponential(vector: Float[np.ndarray, "*samples 3"]) -> Float[np.ndarray, "*samples 4"]:
    """Quaternion of a rotation vector [rad].

    Examples
    --------
    >>> exponential(np.array([0.0, 0.0, np.pi])).round(12) + 0.0
    array([0., 0., 1., 0.])
    """
    half = np.linalg.norm(vector, axis=-1, keepdims=True) / 2
    return np.concatenate([0.5 * np.sinc(half / np.pi) * vector, np.cos(half)], axis=-1)


UPRIGHT = [0.0, 0.0, 0.0, 1.0]
