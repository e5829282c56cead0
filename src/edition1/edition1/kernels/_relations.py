r"""Relations between a sensor and the magnets, compiled, and how slopes by relations become slopes by configuration.

A reading depends on the measurement direction ``o`` and, for every magnet, on its axis ``m`` and the vector ``p``
from it to the sensor at ``x``. Its slopes are a wrench about the origin: torque
:math:`o \times \partial u/\partial o + x \times \partial u/\partial p` and force :math:`\partial u/\partial p` on
the sensor, and the opposite on the magnet, because moving both together changes nothing. The slope by a configuration
variable is the wrench times the twist by which it moves what the wrench acts on.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from edition1.kernels.compilation import machine_code


class Pairs(NamedTuple):
    """One sensor and all magnets."""

    xi: np.ndarray
    """Relations ``[1 + 4 m]``."""
    gradient: np.ndarray
    """Slopes ``[1 + 4 m]`` of the reading by the relations."""
    sine: np.ndarray
    """Sines ``[1 + 4 m]`` of the angles."""
    turn: np.ndarray
    """Cross products ``[1 + 3 m, 3]``: ``o`` with the Earth field, then ``o, m``; ``o, p``; ``m, p`` per magnet."""
    direction: np.ndarray
    """Unit vectors ``[m, 3]`` from the magnets to the sensor."""
    wrench: np.ndarray
    """Torque and force ``[1 + m, 6]`` on the sensor: in all, then by magnet."""
    carried: np.ndarray
    """Torque and force ``[6]`` on what lies beyond a segment."""


@machine_code()
def pairs(n_m):
    """Room for the relations of one sensor."""
    n = 1 + 4 * n_m
    return Pairs(
        np.zeros(n),
        np.zeros(n),
        np.zeros(n),
        np.zeros((1 + 3 * n_m, 3)),
        np.zeros((n_m, 3)),
        np.zeros((1 + n_m, 6)),
        np.zeros(6),
    )


@machine_code()
def relate(axis, position, j, earth, angles, room):
    """Relations of sensor mount ``j`` with the first mounts, the magnets; as angles if ``angles``."""
    xi, sine, turn, direction = room.xi, room.sine, room.turn, room.direction
    o = axis[j]
    xi[0] = o[0] * earth[0] + o[1] * earth[1] + o[2] * earth[2]
    _cross(o, earth, turn[0])
    for k in range(len(direction)):
        m, p_hat = axis[k], direction[k]
        d = 0.0
        for r in range(3):
            p_hat[r] = position[j, r] - position[k, r]
            d += p_hat[r] * p_hat[r]
        d = math.sqrt(d)
        for r in range(3):
            p_hat[r] /= d
        at = 1 + 4 * k
        xi[at] = d
        xi[at + 1] = o[0] * m[0] + o[1] * m[1] + o[2] * m[2]
        xi[at + 2] = o[0] * p_hat[0] + o[1] * p_hat[1] + o[2] * p_hat[2]
        xi[at + 3] = m[0] * p_hat[0] + m[1] * p_hat[1] + m[2] * p_hat[2]
        _cross(o, m, turn[1 + 3 * k])
        _cross(o, p_hat, turn[2 + 3 * k])
        _cross(m, p_hat, turn[3 + 3 * k])
    if angles:
        for i in range(len(turn)):
            at = i + (i + 2) // 3  # a distance stands before every three
            sine[at] = math.sqrt(turn[i, 0] ** 2 + turn[i, 1] ** 2 + turn[i, 2] ** 2)
            xi[at] = math.atan2(sine[at], xi[at])


@machine_code()
def see(axis, j, direction, room):
    """Component of a direction fixed in the base along the axis of mount ``j``, and the torque of its slope."""
    o, wrench = axis[j], room.wrench
    wrench[:] = 0.0
    _cross(o, direction, room.turn[0])
    for r in range(3):
        wrench[0, r] = room.turn[0, r]
    return o[0] * direction[0] + o[1] * direction[1] + o[2] * direction[2]


@machine_code()
def wrenches(position, j, angles, room):
    """Torques and forces on sensor mount ``j`` from the slopes by its relations."""
    gradient, turn, wrench = room.gradient, room.turn, room.wrench
    if angles:
        for i in range(len(turn)):
            at = i + (i + 2) // 3
            # Where two directions are parallel the angle has a kink: the middle of both sides, as in torch.
            gradient[at] = -gradient[at] / room.sine[at] if room.sine[at] > 0.0 else 0.0
    for r in range(3):
        wrench[0, r] = gradient[0] * turn[0, r]
        wrench[0, 3 + r] = 0.0
    x, y, z = position[j, 0], position[j, 1], position[j, 2]
    for k in range(len(room.direction)):
        at, i = 1 + 4 * k, 1 + 3 * k
        by_alpha, by_beta, by_theta = gradient[at + 1], gradient[at + 2], gradient[at + 3]
        d, p_hat, force = room.xi[at], room.direction[k], wrench[1 + k, 3:]
        s_x = (by_beta * turn[i + 1, 0] + by_theta * turn[i + 2, 0]) / d
        s_y = (by_beta * turn[i + 1, 1] + by_theta * turn[i + 2, 1]) / d
        s_z = (by_beta * turn[i + 1, 2] + by_theta * turn[i + 2, 2]) / d
        f_x = gradient[at] * p_hat[0] + p_hat[1] * s_z - p_hat[2] * s_y
        f_y = gradient[at] * p_hat[1] + p_hat[2] * s_x - p_hat[0] * s_z
        f_z = gradient[at] * p_hat[2] + p_hat[0] * s_y - p_hat[1] * s_x
        wrench[1 + k, 0] = by_alpha * turn[i, 0] + by_beta * turn[i + 1, 0] + y * f_z - z * f_y
        wrench[1 + k, 1] = by_alpha * turn[i, 1] + by_beta * turn[i + 1, 1] + z * f_x - x * f_z
        wrench[1 + k, 2] = by_alpha * turn[i, 2] + by_beta * turn[i + 1, 2] + x * f_y - y * f_x
        force[0], force[1], force[2] = f_x, f_y, f_z
        for r in range(6):
            wrench[0, r] += wrench[1 + k, r]


@machine_code(reorder=True)
def pull_back(chain, motion, j, scale, room, row):
    """Slopes of the reading of sensor mount ``j`` by every configuration variable, times ``scale``."""
    wrench, carried, n_m, here = room.wrench, room.carried, len(room.direction), chain.segment[j]
    last = len(chain.family) - 1
    for g in range(last + 1):
        first, beyond = chain.first[g], chain.first[g + 1]
        for c in range(first, beyond):
            row[c] = _power(motion.own[j, c - first], wrench[0]) if here == g else 0.0
        for k in range(n_m):
            if chain.segment[k] == g:
                for c in range(first, beyond):
                    row[c] -= _power(motion.own[k, c - first], wrench[1 + k])
        if g < last:
            for r in range(6):  # on all that the tip of the segment carries
                carried[r] = wrench[0, r] if here > g else 0.0
            for k in range(n_m):
                if chain.segment[k] > g:
                    for r in range(6):
                        carried[r] -= wrench[1 + k, r]
            for c in range(first, beyond):
                row[c] += _power(motion.tip[c], carried)
        for c in range(first, beyond):
            row[c] *= scale


@machine_code(reorder=True)
def _power(twist, wrench):
    turning = twist[0] * wrench[0] + twist[1] * wrench[1] + twist[2] * wrench[2]
    return turning + twist[3] * wrench[3] + twist[4] * wrench[4] + twist[5] * wrench[5]


@machine_code()
def _cross(a, b, out):
    x = a[1] * b[2] - a[2] * b[1]
    y = a[2] * b[0] - a[0] * b[2]
    out[2] = a[0] * b[1] - a[1] * b[0]
    out[0], out[1] = x, y
