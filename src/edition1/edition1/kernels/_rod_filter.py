"""A step of the filter of a rod, compiled: the motion of its states, what sensors say, and the Kalman update.

States are the configuration (``n``), errors of sensors that last, and the velocities of the configuration (``n``).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from edition1.kernels._rod import exponential, inverse, left_jacobian, logarithm, rod_motion
from edition1.kernels.compilation import machine_code

POSE, ORIENTATION, GYROSCOPE, MODEL = range(4)


class Layout(NamedTuple):
    """A rod and its sensors, as arrays."""

    basis: np.ndarray
    """Strain in the middle of each piece by each term ``[parts, 3, terms]``."""
    piece: float
    """Length of a piece [m]."""
    base: bool
    """Whether the first six of the configuration are the twist of the base."""
    kind: np.ndarray
    """Of each sensor."""
    stations: np.ndarray
    """Places with sensors, from base to tip [m]."""
    station: np.ndarray
    """Which of them is that of each sensor."""
    row: np.ndarray
    """First reading of each sensor, and their number."""
    error: np.ndarray
    """First lasting error of each sensor among the states; -1 for none."""
    variance: np.ndarray
    """Of the white error of each reading."""
    outliers: np.ndarray
    """Degrees of freedom of Student's t of each sensor."""


@machine_code()
def carry(x, P, std, rate, lasting_std, lasting_rate, tau):
    """Move mean and covariance over a time, in place: a Matern process of smoothness 3/2 for each coordinate."""
    n, m = len(std), len(std) + len(lasting_std)
    a, b, c, d = np.empty(n), np.empty(n), np.empty(n), np.empty(n)
    for i in range(n):
        faded = math.exp(-rate[i] * tau)
        a[i], b[i] = faded * (1 + rate[i] * tau), faded * tau
        c[i], d[i] = -rate[i] * rate[i] * b[i], faded * (1 - rate[i] * tau)
        x[i], x[m + i] = a[i] * x[i] + b[i] * x[m + i], c[i] * x[i] + d[i] * x[m + i]
    stay = np.exp(-lasting_rate * tau)
    x[n:m] *= stay
    for _ in range(2):  # F P, then F (F P)^T
        for j in range(len(x)):
            for i in range(n):
                P[i, j], P[m + i, j] = (
                    a[i] * P[i, j] + b[i] * P[m + i, j],
                    c[i] * P[i, j] + d[i] * P[m + i, j],
                )
            for i in range(n, m):
                P[i, j] *= stay[i - n]
        P[:] = P.T.copy()
    for i in range(n):
        v = std[i] * std[i]
        w = v * rate[i] * rate[i]
        P[i, i] += v - a[i] * a[i] * v - b[i] * b[i] * w
        P[m + i, m + i] += w - c[i] * c[i] * v - d[i] * d[i] * w
        both = a[i] * c[i] * v + b[i] * d[i] * w
        P[i, m + i] -= both
        P[m + i, i] -= both
    for i in range(n, m):
        P[i, i] += lasting_std[i - n] ** 2 * (1 - stay[i - n] ** 2)


@machine_code()
def _error(layout, k, x, width):
    first = layout.error[k]
    return x[first : first + width].copy() if first >= 0 else np.zeros(width)


@machine_code()
def rod_readings(layout, x, n, value, out):
    """Write what the sensors read at a state; ``value`` holds the readings of models."""
    poses, jacobians = rod_motion(x[:n], layout.basis, layout.piece, layout.base, layout.stations)
    for k in range(len(layout.kind)):
        first, stop = layout.row[k], layout.row[k + 1]
        error = _error(layout, k, x, stop - first)
        if layout.kind[k] == MODEL:
            out[first:stop] = value[first:stop] + error
            continue
        here = layout.station[k]
        if layout.kind[k] == GYROSCOPE:
            for i in range(3):
                out[first + i] = error[i]
                for j in range(n):
                    out[first + i] += jacobians[here, 3 + i, j] * x[len(x) - n + j]
        else:
            twist = np.zeros(6)
            twist[6 - len(error) :] = error
            out[first:stop] = logarithm(poses[here] @ exponential(twist))[6 - len(error) :]


@machine_code()
def rod_innovation(layout, x, prior, P, u, use, n, value, slope, r, H, R):
    """Write what readings say beyond the prior, by derivatives at ``x``, these, and the variances of white errors.

    That of a pose is the twist, in the sensor's frame, from the predicted pose to the one that was read. ``value``
    and ``slope`` hold readings of models and their derivatives by the strain. ``use`` is cleared where a pose is not
    whole.
    """
    for k in range(len(layout.kind)):
        first, stop = layout.row[k], layout.row[k + 1]
        kind = layout.kind[k]
        if not use[first:stop].any():
            continue
        if kind <= ORIENTATION and not use[first:stop].all():
            use[first:stop] = False
            continue
        error = _error(layout, k, x, stop - first)
        station = layout.stations[layout.station[k] : layout.station[k] + 1]
        poses, J = rod_motion(x[:n], layout.basis, layout.piece, layout.base, station)
        if kind == MODEL:
            H[first:stop, n - slope.shape[1] : n] = slope[first:stop]
            r[first:stop] = u[first:stop] - value[first:stop] - error
        elif kind == GYROSCOPE:
            H[first:stop, len(x) - n :] = J[0, 3:]
            r[first:stop] = u[first:stop] - J[0, 3:] @ x[len(x) - n :] - error
        else:
            read, here = np.zeros(6), poses[0]
            read[6 - len(error) :] = u[first:stop]
            if kind == ORIENTATION:
                here[:3, 3] = 0.0
            twist = logarithm(inverse(here) @ exponential(read))
            r[first:stop] = twist[6 - len(error) :] - error
            low = 6 - len(error)
            H[first:stop, :n] = np.linalg.solve(left_jacobian(twist)[low:, low:].copy(), J[0, low:].copy())
        if layout.error[k] >= 0:
            for i in range(stop - first):
                H[first + i, layout.error[k] + i] = 1.0
        r[first:stop] += H[first:stop] @ (x - prior)
        R[first:stop] = layout.variance[first:stop]
        if layout.outliers[k] < math.inf:
            here = np.flatnonzero(use[first:stop]) + first
            S = H[here] @ P @ H[here].T + np.diag(R[here])
            surprise = r[here] @ np.linalg.solve(S, r[here])
            R[first:stop] *= max(1.0, (layout.outliers[k] + surprise) / (layout.outliers[k] + len(here)))


@machine_code()
def kalman_gain(P, r, H, R):
    """Gain of surprises with white errors of variance ``R``, and their chi-square."""
    PH = P @ H.T
    S = H @ PH + np.diag(R)
    return np.linalg.solve(S, PH.T).T.copy(), r @ np.linalg.solve(S, r)


@machine_code()
def reduced(P, gain, H):
    """Covariance after an update."""
    out = P - gain @ (H @ P)
    return (out + out.T) / 2
