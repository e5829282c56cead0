r"""Poses along a rod and how they move with its configuration, compiled: the twin of ``StrainSeries.pose``.

A body Jacobian says by which twist, in its own frame, a pose moves: :math:`T^{-1}\, dT = (J\, dq)^\wedge`,
translation part first. Along a piece of length :math:`\ell` and strain :math:`\xi` it becomes
:math:`\mathrm{Ad}(E^{-1})\, J + \ell\, J_r(\ell\xi)\, \partial\xi/\partial q` with :math:`E = \exp(\ell\xi)`
(Barfoot, State Estimation for Robotics, 2nd ed., section 8.1).
"""

from __future__ import annotations

import math

import numpy as np

from edition1.kernels.compilation import machine_code

_TERMS = 40
"""Largest number of terms of the Jacobian of SE(3); for twists of 0.1, as those of a piece are, seven are enough."""


@machine_code()
def _times(A, B):
    """Product of two small matrices: at their size a call of BLAS costs more than the product."""
    out = np.zeros((A.shape[0], B.shape[1]))
    for i in range(A.shape[0]):
        for k in range(A.shape[1]):
            if A[i, k] != 0.0:
                for j in range(B.shape[1]):
                    out[i, j] += A[i, k] * B[k, j]
    return out


@machine_code()
def _cross(w):
    return np.array([[0.0, -w[2], w[1]], [w[2], 0.0, -w[0]], [-w[1], w[0], 0.0]])


@machine_code()
def _coefficients(z):
    """sin(t)/t, (1 - cos t)/t^2 and (t - sin t)/t^3 of z = t^2."""
    if z < 1e-3:
        a = 1 - z / 6 * (1 - z / 20 * (1 - z / 42))
        b = 0.5 - z / 24 * (1 - z / 30 * (1 - z / 56))
        return a, b, 1 / 6 - z / 120 * (1 - z / 42 * (1 - z / 72))
    t = math.sqrt(z)
    half = math.sin(t / 2) / t
    return math.sin(t) / t, 2 * half * half, (t - math.sin(t)) / (t * z)


@machine_code()
def exponential(x):
    """Rigid motion of a twist, translation part first."""
    W = _cross(x[3:])
    a, b, c = _coefficients(x[3] * x[3] + x[4] * x[4] + x[5] * x[5])
    W2 = _times(W, W)
    T = np.eye(4)
    T[:3, :3] += a * W + b * W2
    T[:3, 3] = (np.eye(3) + b * W + c * W2) @ np.ascontiguousarray(x[:3])
    return T


@machine_code()
def logarithm(T):
    """Twist of a rigid motion of less than half a turn."""
    odd = np.array([T[2, 1] - T[1, 2], T[0, 2] - T[2, 0], T[1, 0] - T[0, 1]]) / 2
    s, c = math.sqrt(odd @ odd), (T[0, 0] + T[1, 1] + T[2, 2] - 1) / 2
    angle = math.atan2(s, c)
    phi = odd * (angle / s if s > 1e-8 else 1.0)
    z = phi @ phi
    a, b, _ = _coefficients(z)
    k = 1 / 12 + z / 720 * (1 + z / 42) if z < 1e-3 else (1 - a / (2 * b)) / z
    W = _cross(phi)
    x = np.empty(6)
    x[:3] = (np.eye(3) - W / 2 + k * _times(W, W)) @ np.ascontiguousarray(T[:3, 3])
    x[3:] = phi
    return x


@machine_code()
def inverse(T):
    """Inverse of a rigid motion."""
    R_T = np.ascontiguousarray(T[:3, :3].T)
    out = np.eye(4)
    out[:3, :3] = R_T
    out[:3, 3] = -(R_T @ np.ascontiguousarray(T[:3, 3]))
    return out


@machine_code()
def left_jacobian(x):
    """Left Jacobian of SE(3); the right one is that of the opposite twist.

    It is the sum of the powers of the bracket of the twist by (k + 1)!. All have the same block twice on the diagonal
    and one above it.
    """
    V, W = _cross(x[:3]), _cross(x[3:])
    diagonal, above = np.eye(3), np.zeros((3, 3))
    total = np.eye(6)
    for k in range(1, _TERMS):
        largest = 0.0
        for i in range(3):
            d0, d1, d2 = diagonal[i]
            a0, a1, a2 = above[i]
            for j in range(3):
                above[i, j] = (
                    d0 * V[0, j] + d1 * V[1, j] + d2 * V[2, j] + a0 * W[0, j] + a1 * W[1, j] + a2 * W[2, j]
                ) / (k + 1)
                diagonal[i, j] = (d0 * W[0, j] + d1 * W[1, j] + d2 * W[2, j]) / (k + 1)
                total[i, j] += diagonal[i, j]
                total[i, 3 + j] += above[i, j]
                largest = max(largest, abs(diagonal[i, j]), abs(above[i, j]))
        if largest < 1e-17:
            break
    total[3:, 3:] = total[:3, :3]
    return total


@machine_code()
def _adjoint(T):
    out = np.zeros((6, 6))
    R = T[:3, :3]
    out[:3, :3], out[3:, 3:], out[:3, 3:] = R, R, _times(_cross(T[:3, 3]), R)
    return out


@machine_code()
def rod_motion(q, basis, h, base, stations):
    """Poses ``[m, 4, 4]`` at stations (arc lengths [m], ascending) and their body Jacobians ``[m, 6, n]``.

    The first six of ``q`` are the twist of the base if ``base`` is true; the others are the terms of the strain.
    """
    n, parts = len(q), len(basis)
    first = 6 if base else 0
    strain = np.ascontiguousarray(q[first:])
    T, J, x = np.eye(4), np.zeros((6, n)), np.zeros(6)
    if base:
        T = exponential(q[:6])
        J[:, :6] = left_jacobian(-q[:6])
    poses, jacobians = np.empty((len(stations), 4, 4)), np.empty((len(stations), 6, n))
    done = 0
    for i in range(parts):
        B = basis[i]
        kappa = np.zeros(3)
        for j in range(len(strain)):
            for k in range(3):
                kappa[k] += B[k, j] * strain[j]
        while done < len(stations) and (stations[done] < (i + 1) * h * (1 - 1e-12) or i == parts - 1):
            piece = min(stations[done] - i * h, h)
            x[2], x[3:] = piece, piece * kappa
            E, slope = exponential(x), piece * left_jacobian(-x)
            poses[done] = _times(T, E)
            jacobians[done] = _times(_adjoint(inverse(E)), J)
            jacobians[done, :, first:] += _times(slope[:, 3:], B)
            done += 1
        if done == len(stations):
            break
        x[2], x[3:] = h, h * kappa
        E, slope = exponential(x), h * left_jacobian(-x)
        T = _times(T, E)
        J = _times(_adjoint(inverse(E)), J)
        J[:, first:] += _times(slope[:, 3:], B)
    return poses, jacobians
