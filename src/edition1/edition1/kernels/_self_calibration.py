r"""A step of the filter that calibrates itself, compiled: what sensors say beyond a state, and the Kalman update.

States are the configuration (``n``), the errors of the sensors, and the velocities of the configuration (``n``). A
Hall sensor of gain :math:`1 + g_s` and offset :math:`o_s` reads magnets of relative moments :math:`1 + m_k`,

.. math:: u_s = (1 + g_s) \bigl(o^T b_\oplus + \sum_k (1 + m_k)\, u_{sk}(q)\bigr) + o_s,

and an IMU the orientation :math:`E R(q)` with :math:`E = e^{h\,[e_z]_\times} e^{[(t_x, t_y, 0)]_\times}`.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from edition1.kernels._motion import Chain, move, scratch
from edition1.kernels._multipole import multipole
from edition1.kernels._relations import pairs, pull_back, relate, wrenches
from edition1.kernels._rod import exponential, left_jacobian, logarithm
from edition1.kernels._rod_filter import kalman_gain, reduced
from edition1.kernels.compilation import machine_code

MOMENT, GAIN, OFFSET, HEADING, TILT_X, TILT_Y = range(6)


class Parts(NamedTuple):
    """A robot and its sensors, as arrays."""

    chain: Chain
    """Mounts of the magnets, of the Hall sensors, and of the x, y and z axes of each IMU."""
    moments: np.ndarray
    """Moments ``[m, terms]`` [mT m^(l+2)]."""
    gain: np.ndarray
    """Gain of each Hall sensor as drawn."""
    earth: np.ndarray
    """Field in the base frame [mT]."""
    kind: np.ndarray
    """Of each error."""
    which: np.ndarray
    """Magnet, Hall sensor or IMU of each error; -1 for all."""
    variance: np.ndarray
    """White noise of each reading."""
    low: np.ndarray
    high: np.ndarray


@machine_code()
def innovate(parts, x, u, use, r, H, u_hat):
    """Write predicted readings, what is read beyond them, and slopes of the prediction by the states.

    That of an IMU is the rotation vector, in the base frame, from the predicted orientation to the one that was
    read; ``use`` is cleared where it is not whole.
    """
    chain, n_m, n_h, n = parts.chain, len(parts.moments), len(parts.gain), parts.chain.first[-1]
    motion, pair = scratch(chain), pairs(n_m)
    strength, gain, offset = np.ones(n_m), np.ones(n_h), np.zeros(n_h)
    error = np.zeros(((len(u) - n_h) // 3, 3))  # tilt about x and y, heading
    for k in range(len(parts.kind)):
        kind, at, value = parts.kind[k], parts.which[k], x[n + k]
        here = slice(0, None) if at < 0 else slice(at, at + 1)
        if kind == MOMENT:
            strength[here] += value
        elif kind == GAIN:
            gain[here] += value
        elif kind == OFFSET:
            offset[here] += value
        elif kind == HEADING:
            error[here, 2] += value
        else:
            error[here, kind - TILT_X] += value
    move(chain, 0, x, True, motion)
    r[:], H[:] = 0.0, 0.0
    by_moment = np.empty(n_m)
    for s in range(n_h):
        j, factor = n_m + s, parts.gain[s] * gain[s]
        relate(motion.axis, motion.position, j, parts.earth, False, pair)
        flux = pair.xi[0]
        pair.gradient[0] = 1.0
        for k in range(n_m):
            at = 1 + 4 * k
            found = multipole(
                parts.moments[k], pair.xi[at], pair.xi[at + 1], pair.xi[at + 2], pair.xi[at + 3]
            )
            by_moment[k] = found[0]
            flux += strength[k] * found[0]
            for c in range(4):
                pair.gradient[at + c] = strength[k] * found[1 + c]
        u_hat[s] = factor * flux + offset[s]
        if not use[s]:
            continue
        wrenches(motion.position, j, False, pair)
        pull_back(chain, motion, j, factor, pair, H[s])
        r[s] = u[s] - u_hat[s]
        for k in range(len(parts.kind)):
            kind, at = parts.kind[k], parts.which[k]
            if kind == MOMENT:
                H[s, n + k] = factor * (by_moment.sum() if at < 0 else by_moment[at])
            elif kind == GAIN and (at == s or at < 0):
                H[s, n + k] = parts.gain[s] * flux
            elif kind == OFFSET and (at == s or at < 0):
                H[s, n + k] = 1.0
    for i in range(len(error)):
        _orientation(parts, motion, i, n_m + n_h + 3 * i, error[i], n_h + 3 * i, u, use, r, H, u_hat)


@machine_code()
def _orientation(parts, motion, i, mount, error, row, u, use, r, H, u_hat):
    """Three readings of an IMU, as in ``innovate``."""
    chain, n, rows = parts.chain, parts.chain.first[-1], slice(row, row + 3)
    twist = np.zeros(6)
    twist[3:5] = error[:2]
    lean, by_tilt = exponential(twist)[:3, :3].copy(), left_jacobian(twist)[3:, 3:].copy()
    yaw = np.eye(3)
    yaw[0, 0] = yaw[1, 1] = math.cos(error[2])
    yaw[1, 0] = math.sin(error[2])
    yaw[0, 1] = -yaw[1, 0]
    E, R = yaw @ lean, np.empty((3, 3))
    for c in range(3):
        R[:, c] = motion.axis[mount + c]
    T = np.eye(4)
    T[:3, :3] = E @ R
    u_hat[rows] = logarithm(T)[3:]
    if not use[rows].all():
        use[rows] = False
        return
    twist[3:] = u[rows]
    T[:3, :3] = exponential(twist)[:3, :3].copy() @ (E @ R).T.copy()
    away = logarithm(T)
    away[:3] = 0.0
    r[rows] = away[3:]
    slopes = np.zeros((3, H.shape[1]))  # turns in the base frame by each state
    here = chain.segment[mount]
    for g in range(here + 1):
        for c in range(chain.first[g], chain.first[g + 1]):
            turn = motion.own[mount, c - chain.first[g]] if g == here else motion.tip[c]
            for a in range(3):
                slopes[a, c] = E[a, 0] * turn[0] + E[a, 1] * turn[1] + E[a, 2] * turn[2]
    tilted = yaw @ by_tilt
    for k in range(len(parts.kind)):
        if (parts.which[k] != i and parts.which[k] >= 0) or parts.kind[k] < HEADING:
            continue
        if parts.kind[k] == HEADING:
            slopes[2, n + k] = 1.0
        else:
            slopes[:, n + k] = tilted[:, parts.kind[k] - TILT_X]
    H[rows] = np.linalg.solve(left_jacobian(-away)[3:, 3:].copy(), slopes)


@machine_code()
def drift(x, P, low, high, density, walk, rate, tau):
    """Move mean and covariance over a time, in place: constant velocities, errors that walk and fade.

    A coordinate that no reading holds would become less certain than its bounds leave it: then they count as a
    reading, of their middle and of the variance of a uniform distribution between them.
    """
    n, m = len(density), len(density) + len(walk)
    stay = np.exp(-rate * tau)
    x[:n] += tau * x[m:]
    x[n:m] *= stay
    for _ in range(2):  # F P, then F (F P)^T
        for j in range(len(x)):
            for i in range(n):
                P[i, j] += tau * P[m + i, j]
            for i in range(n, m):
                P[i, j] *= stay[i - n]
        P[:] = P.T.copy()
    for i in range(n):
        d = density[i] * density[i]
        P[i, i] += d * tau**3 / 3
        P[i, m + i] += d * tau * tau / 2
        P[m + i, i] += d * tau * tau / 2
        P[m + i, m + i] += d * tau
    for i in range(n, m):
        w, c = walk[i - n] * walk[i - n], rate[i - n]
        P[i, i] += w * tau if c == 0.0 else w * (1 - stay[i - n] ** 2) / (2 * c)
    for i in range(n):
        width = high[i] - low[i]
        if P[i, i] > width * width / 12:
            total, column = P[i, i] + width * width / 12, P[:, i].copy()
            x += column / total * ((low[i] + high[i]) / 2 - x[i])
            P -= np.outer(column, column) / total


@machine_code()
def take_in(parts, prior, P, u, use, iterations, u_hat):
    """State and covariance after an update, and the chi-square of its residuals and of what it moved.

    ``use`` is cleared as in ``innovate``. The chi-square is linearised where the update ends: at the prior it would
    count the curvature of the readings as a surprise. Iterations end when no state moves by a hundredth of its prior
    standard deviation.
    """
    x, n = prior.copy(), parts.chain.first[-1]
    r, H = np.empty(len(u)), np.empty((len(u), len(x)))
    innovate(parts, x, u, use, r, H, u_hat)
    here = np.flatnonzero(use)
    if len(here) == 0:
        return x, P.copy(), 0.0
    slopes, std = H[here], np.sqrt(np.maximum(np.diag(P), 1e-30))
    gain, chi2 = kalman_gain(P, r[here], slopes, parts.variance[here])
    for k in range(iterations):
        moved = prior + gain @ (r[here] + H[here] @ (x - prior)) - x
        x += moved
        for i in range(n):
            if P[i, i] > 0.0:
                x[i] = min(max(x[i], parts.low[i]), parts.high[i])
        done = k + 1 == iterations or np.abs(moved / std).max() < 0.01
        slopes = H[here]
        innovate(parts, x, u, use, r, H, u_hat)
        if done:
            break
        gain, chi2 = kalman_gain(P, r[here] + H[here] @ (x - prior), H[here], parts.variance[here])
    return x, reduced(P, gain, slopes), chi2
