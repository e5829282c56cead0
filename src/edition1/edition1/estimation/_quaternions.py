"""Quaternions of IMUs: checked, compared, and filled where they are missing."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from edition1.errors import bad_input
from edition1.estimation.orientations import UNIT_TOLERANCE, exponential, product

_TINY = 1e-300  # an angle this small turns nothing, and can be divided by


def unit_quaternions(orientations: np.ndarray, owner: str) -> np.ndarray:
    """Check orientations and return them rescaled to unit length, in float64.

    Parameters
    ----------
    orientations
        Quaternions XYZW ``[*samples, imus, 4]``.
    owner
        Whose input it is, for the message.

    Raises
    ------
    InputError
        Another shape, or quaternions that are not finite or not unit within 1e-3.
    """
    shape = np.shape(orientations)
    if len(shape) < 2 or shape[-1] != 4 or shape[-2] == 0:
        raise bad_input("orientations", owner, "quaternions XYZW, an array (..., imus, 4)", f"shape {shape}")
    q = np.asarray(orientations, dtype=float)
    norms = np.linalg.norm(q, axis=-1, keepdims=True)
    error = np.abs(norms[..., 0] - 1.0)
    if not (error <= UNIT_TOLERANCE).all():  # "not <=" also catches NaN
        worst = q.reshape(-1, 4)[int(np.argmax(np.where(np.isnan(error), np.inf, error)))]
        raise bad_input("orientations", owner, "finite unit quaternions (within 1e-3)", worst)
    return q / norms


def turn_between(
    first: Float[np.ndarray, "*samples 4"], second: Float[np.ndarray, "*samples 4"]
) -> Float[np.ndarray, "*samples 3"]:
    """Rotation vector [rad], in world coordinates, of the shortest turn that takes ``first`` to ``second``.

    Examples
    --------
    >>> quarter = exponential(np.array([[0.0, 0.0, 0.0], [np.pi / 2, 0.0, 0.0]]))
    >>> np.degrees(turn_between(quarter[0], -quarter[1])).round(9) + 0.0
    array([90.,  0.,  0.])
    """
    relative = product(second, first * [-1.0, -1.0, -1.0, 1.0])
    relative = np.where(relative[..., 3:] < 0, -relative, relative)  # q and -q: the shorter way round
    sine = np.maximum(np.linalg.norm(relative[..., :3], axis=-1, keepdims=True), _TINY)
    return relative[..., :3] * (2 * np.arctan2(sine, relative[..., 3:]) / sine)


def axis_and_angle(
    vector: Float[np.ndarray, "*samples 3"],
) -> tuple[Float[np.ndarray, "*samples 3"], Float[np.ndarray, "*samples"]]:
    """Unit axis and angle [rad] of a rotation vector; the axis of no turn is zero."""
    angle = np.asarray(np.linalg.norm(vector, axis=-1))
    return vector / np.maximum(angle, _TINY)[..., None], angle


def filled(
    orientations: Float[np.ndarray, "*samples imus 4"], arcs: Sequence[float]
) -> Float[np.ndarray, "*samples imus 4"]:
    """Fill orientations that are missing (NaN) from the IMUs that are there.

    Between two IMUs the missing one takes the spherical linear interpolation at its arc position (equation
    4), beyond the first or the last the orientation of the nearest. That is the mean of a random walk of the
    orientation along the arc; its spread is part of the covariance of `edition1.estimation.imu_shape.ImuShape`.

    Parameters
    ----------
    orientations
        Unit quaternions XYZW; an IMU with any component NaN is missing.
    arcs
        Arc positions of the IMUs [m], increasing.

    Raises
    ------
    InputError
        If no IMU of a sample is left, or the others are not unit within 1e-3.

    Examples
    --------
    >>> q = exponential(np.array([[0.0, 0.0, 0.0], [np.nan] * 3, [np.pi / 2, 0.0, 0.0]]))
    >>> np.degrees(turn_between(q[0], filled(q, [0.0, 0.1, 0.3])[1])).round(9) + 0.0
    array([30.,  0.,  0.])
    """
    missing = np.asarray(np.isnan(orientations).any(axis=-1))
    if missing.all(axis=-1).any():
        raise bad_input("orientations", "filled", "at least one IMU that is not NaN in every sample", "none")
    q = unit_quaternions(np.where(missing[..., None], [0.0, 0.0, 0.0, 1.0], orientations), "filled")
    flat, lost = q.reshape(-1, *q.shape[-2:]), missing.reshape(-1, missing.shape[-1])
    for pattern in np.unique(lost, axis=0):
        rows = (lost == pattern).all(axis=1)
        for imu in np.flatnonzero(pattern):
            before, after, share = neighbours(pattern, arcs, int(imu))
            start = flat[rows, before]
            step = share * turn_between(start, flat[rows, after])
            flat[rows, imu] = product(exponential(step), start)
    return flat.reshape(q.shape)


def neighbours(missing: np.ndarray, arcs: Sequence[float], imu: int) -> tuple[int, int, float]:
    """Return the nearest IMUs there are before and after a missing one, and its share of the way between them.

    Beyond the first and the last IMU that is there, both are the nearest one and the share is zero.
    """
    there = np.flatnonzero(~missing)
    before, after = there[there < imu][-1:], there[there > imu][:1]
    if not (before.size and after.size):
        nearest = int(np.concatenate([before, after])[0])
        return nearest, nearest, 0.0
    first, last = int(before[0]), int(after[0])
    return first, last, (arcs[imu] - arcs[first]) / (arcs[last] - arcs[first])
