r"""Where mounts are and how they move, compiled: chains of segments of constant or of affine curvature.

Both segments turn by a rotation vector :math:`\varphi` in the transverse plane, so one set of formulas serves both:
the frame turns by :math:`\omega = J_l(\varphi)\,\dot\varphi` with the left Jacobian of SO(3). Motions are twists
:math:`(\omega, \nu)` about the origin of the base frame: a point ``x`` moves by :math:`\omega \times x + \nu`.
All that a segment carries beyond its tip moves by the same twist.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import torch
from numpy.polynomial.legendre import leggauss
from torch import Tensor

from edition1.errors import bad_input
from edition1.kernels.compilation import machine_code
from edition1.kinematics.affine_curvature import AffineCurvature
from edition1.kinematics.constant_curvature import ConstantCurvature
from edition1.kinematics.mounts import Mounts
from edition1.kinematics.robot import Robot

_CONSTANT, AFFINE = 0, 1
_NODES, _WEIGHTS = leggauss(24)
_OWN = 4
"""Largest number of configuration variables of a segment."""
# (1 - sinc)/z and (1/2 - cosc)/z as series in z = theta^2; nine terms leave less than 1e-17 below z = 1.
_S = np.array([(-1.0) ** k / math.factorial(2 * k + 3) for k in range(9)])
_C = np.array([(-1.0) ** k / math.factorial(2 * k + 4) for k in range(9)])


class Chain(NamedTuple):
    """Segments and mounts of a batch of robots."""

    family: np.ndarray
    """``_CONSTANT`` or ``AFFINE``, for each segment."""
    length: np.ndarray
    """Unextended lengths [m]."""
    radius: np.ndarray
    """Radii ``d`` [m] of segments of constant curvature."""
    first: np.ndarray
    """First configuration variable of each segment, and their number."""
    segment: np.ndarray
    """Segment of each mount."""
    v: np.ndarray
    """Backbone coordinate ``[robots, n]`` of each mount."""
    axis: np.ndarray
    """Axis ``[robots, n, 3]`` of each mount in the frame of the backbone."""
    position: np.ndarray
    """Position ``[robots, n, 3]`` of each mount in the frame of the backbone [m]."""


class Motion(NamedTuple):
    """What ``move`` fills in, and its scratch space."""

    axis: np.ndarray
    """Axes ``[n, 3]`` in the base frame."""
    position: np.ndarray
    """Positions ``[n, 3]`` in the base frame [m]."""
    own: np.ndarray
    """Twists ``[n, 4, 6]`` of each mount by the variables of its own segment."""
    tip: np.ndarray
    """Twists ``[n_q, 6]`` of what lies beyond the segment of each variable."""
    frame: np.ndarray
    base: np.ndarray
    local: np.ndarray
    world: np.ndarray


def chain(robot: Robot, mounts: Mounts) -> tuple[Chain, torch.Size]:
    """Tables of a robot and the shape of its batch.

    Raises
    ------
    InputError
        If a segment is not of constant or of affine curvature.
    """
    families = {ConstantCurvature: _CONSTANT, AffineCurvature: AFFINE}
    for segment in robot.segments:
        if type(segment) not in families:
            expected = "of constant or of affine curvature to be compiled"
            raise bad_input("segments", "Robot", expected, type(segment).__name__)
    length = torch.tensor([segment.length for segment in robot.segments], dtype=torch.float64)
    first = np.cumsum([0, *(segment.n_q for segment in robot.segments)])
    batch = torch.broadcast_shapes(mounts.axial.shape[:-1], mounts.local.shape[:-3])
    v = mounts.axial.double() / length[list(mounts.segment)]
    local = mounts.local.double().expand(*batch, -1, 4, 4).reshape(-1, len(mounts), 4, 4)
    return Chain(
        np.array([families[type(segment)] for segment in robot.segments]),
        length.numpy(),
        np.array([getattr(segment, "radius", 1.0) for segment in robot.segments]),
        first,
        np.array(mounts.segment),
        array(v.expand(*batch, len(mounts)).reshape(-1, len(mounts))),
        array(local[:, :, :3, 2]),
        array(local[:, :, :3, 3]),
    ), batch


def array(x: Tensor) -> np.ndarray:
    """Copy of a tensor as kernels take it: contiguous, truth values or double precision."""
    values = x.numpy(force=True)
    return np.array(values, np.bool_ if values.dtype == np.bool_ else np.float64, order="C")


@machine_code()
def scratch(chain):
    """Room for one evaluation of ``move``."""
    n, n_q = len(chain.segment), chain.first[-1]
    return Motion(
        np.zeros((n, 3)),
        np.zeros((n, 3)),
        np.zeros((n, _OWN, 6)),
        np.zeros((n_q, 6)),
        np.zeros((3, 4)),
        np.zeros((3, 4)),
        np.zeros((_OWN, 6)),
        np.zeros((_OWN, 6)),
    )


@machine_code()
def move(chain, robot, q, slopes, motion):
    """Axes and positions of all mounts of one robot at ``q``, and their twists if ``slopes``."""
    last = len(chain.family) - 1
    for r in range(3):
        for k in range(4):
            motion.base[r, k] = 1.0 if r == k else 0.0
    for g in range(last + 1):
        n_own = chain.first[g + 1] - chain.first[g]
        at = -1.0
        for i in range(len(chain.segment)):
            if chain.segment[i] != g:
                continue
            if chain.v[robot, i] != at:  # mounts in one plane share its frame
                at = chain.v[robot, i]
                _frame(chain, g, q, at, slopes, motion)
            _mount(chain, robot, i, slopes, n_own, motion)
        if g < last:
            if at != 1.0:
                _frame(chain, g, q, 1.0, slopes, motion)
            if slopes:
                for c in range(n_own):
                    for r in range(6):
                        motion.tip[chain.first[g] + c, r] = motion.world[c, r]
            for r in range(3):
                for k in range(4):
                    motion.base[r, k] = motion.frame[r, k]


@machine_code()
def _mount(chain, robot, i, slopes, n_own, motion):
    """Place mount ``i`` in the present frame."""
    frame = motion.frame
    for r in range(3):
        a, x = 0.0, 0.0
        for k in range(3):
            a += frame[r, k] * chain.axis[robot, i, k]
            x += frame[r, k] * chain.position[robot, i, k]
        motion.axis[i, r] = a
        motion.position[i, r] = x + frame[r, 3]
    if slopes:
        for c in range(n_own):
            for r in range(6):
                motion.own[i, c, r] = motion.world[c, r]


@machine_code()
def _frame(chain, g, q, v, slopes, motion):
    """Frame of the backbone at ``v`` of segment ``g`` in the base frame, and its twists."""
    local, base, frame, world = motion.local, motion.base, motion.frame, motion.world
    if chain.family[g] == _CONSTANT:
        f_x, f_y, p_x, p_y, p_z, S, C = _constant(chain, g, q, v, slopes, local)
    else:
        f_x, f_y, p_x, p_y, p_z, S, C = _affine(chain, g, q, v, slopes, local)
    z = f_x * f_x + f_y * f_y
    sinc, cosc = 1.0 - z * S, 0.5 - z * C
    across = f_x * f_y * cosc
    for r in range(3):
        b_0, b_1, b_2 = base[r, 0], base[r, 1], base[r, 2]
        frame[r, 0] = b_0 * (1.0 - f_y * f_y * cosc) + b_1 * across - b_2 * f_y * sinc
        frame[r, 1] = b_0 * across + b_1 * (1.0 - f_x * f_x * cosc) + b_2 * f_x * sinc
        frame[r, 2] = b_0 * f_y * sinc - b_1 * f_x * sinc + b_2 * (1.0 - z * cosc)
        frame[r, 3] = b_0 * p_x + b_1 * p_y + b_2 * p_z + base[r, 3]
    if not slopes:
        return
    for c in range(chain.first[g + 1] - chain.first[g]):
        d_x, d_y = local[c, 0], local[c, 1]  # of the rotation vector
        turn = f_x * d_y - f_y * d_x
        w_x, w_y, w_z = d_x + S * f_y * turn, d_y - S * f_x * turn, cosc * turn
        for r in range(3):
            world[c, r] = base[r, 0] * w_x + base[r, 1] * w_y + base[r, 2] * w_z
            world[c, 3 + r] = base[r, 0] * local[c, 3] + base[r, 1] * local[c, 4] + base[r, 2] * local[c, 5]
        w_x, w_y, w_z = world[c, 0], world[c, 1], world[c, 2]
        world[c, 3] -= w_y * frame[2, 3] - w_z * frame[1, 3]
        world[c, 4] -= w_z * frame[0, 3] - w_x * frame[2, 3]
        world[c, 5] -= w_x * frame[1, 3] - w_y * frame[0, 3]


@machine_code()
def _series(z):
    """``(1 - sinc)/z`` and ``(1/2 - cosc)/z``; all functions of a bend follow from them without cancellation."""
    if z < 1.0:
        S, C = 0.0, 0.0
        for k in range(8, -1, -1):
            S = S * z + _S[k]
            C = C * z + _C[k]
        return S, C
    theta = math.sqrt(z)
    half = math.sin(theta / 2.0) / theta
    return (1.0 - math.sin(theta) / theta) / z, (0.5 - 2.0 * half * half) / z


@machine_code()
def _constant(chain, g, q, v, slopes, local):
    """Rotation vector, position and series of a segment of constant curvature; derivatives go to ``local``."""
    first = chain.first[g]
    d = chain.radius[g]
    a_x, a_y, L = q[first] / d, q[first + 1] / d, chain.length[g] + q[first + 2]
    S, C = _series(v * v * (a_x * a_x + a_y * a_y))
    z = v * v * (a_x * a_x + a_y * a_y)
    sinc, cosc = 1.0 - z * S, 0.5 - z * C
    s, c = v * sinc, v * v * cosc
    if slopes:
        ds = v * v * v * (S - cosc)  # 2 v^3 d sinc/dz
        dc = v * v * v * v * 2.0 * (C - 0.5 * S)
        local[:, :] = 0.0
        local[0, 1], local[1, 0] = v / d, -v / d
        local[0, 3] = L * (c + a_x * a_x * dc) / d
        local[1, 4] = L * (c + a_y * a_y * dc) / d
        local[0, 4] = local[1, 3] = L * a_x * a_y * dc / d
        local[0, 5], local[1, 5] = L * a_x * ds / d, L * a_y * ds / d
        local[2, 3], local[2, 4], local[2, 5] = a_x * c, a_y * c, s
    return -v * a_y, v * a_x, L * a_x * c, L * a_y * c, L * s, S, C


@machine_code()
def _affine(chain, g, q, v, slopes, local):
    """Rotation vector, position and series of a segment of affine curvature; derivatives go to ``local``."""
    first = chain.first[g]
    k_0, k_1, phi, L = q[first], q[first + 1], q[first + 2], chain.length[g] + q[first + 3]
    across, ahead, across_0, ahead_0, across_1, ahead_1 = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for k in range(len(_NODES)):
        s = v * (_NODES[k] + 1.0) / 2.0
        angle = k_0 * s + k_1 * s * s / 2.0
        sine, cosine = v / 2.0 * _WEIGHTS[k] * math.sin(angle), v / 2.0 * _WEIGHTS[k] * math.cos(angle)
        across += sine
        ahead += cosine
        across_0 += s * cosine
        ahead_0 -= s * sine
        across_1 += s * s / 2.0 * cosine
        ahead_1 -= s * s / 2.0 * sine
    theta = k_0 * v + k_1 * v * v / 2.0
    x, y = math.cos(phi), math.sin(phi)
    S, C = _series(theta * theta)
    if slopes:
        local[:, :] = 0.0
        local[0, 0], local[0, 1] = v * x, v * y
        local[1, 0], local[1, 1] = v * v / 2.0 * x, v * v / 2.0 * y
        local[2, 0], local[2, 1] = -theta * y, theta * x
        local[0, 3], local[0, 4], local[0, 5] = L * across_0 * y, -L * across_0 * x, L * ahead_0
        local[1, 3], local[1, 4], local[1, 5] = L * across_1 * y, -L * across_1 * x, L * ahead_1
        local[2, 3], local[2, 4] = L * across * x, L * across * y
        local[3, 3], local[3, 4], local[3, 5] = across * y, -across * x, ahead
    return theta * x, theta * y, L * across * y, -L * across * x, L * ahead, S, C
