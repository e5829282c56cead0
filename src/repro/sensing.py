r"""From a configuration to readings, with slopes: poses, relations of eq. (1) of Baaij et al. 2023, a field model.

A reading depends on each pair of a sensor and a magnet through four scalars only: the distance :math:`d` and the
cosines of :math:`\alpha, \beta, \theta`, eqs (4) to (6); and through :math:`\lambda` on the field of the Earth. Every
field model returns the reading and its slopes in these scalars. One chain rule takes them to the configuration: the
slopes of a pair are a force :math:`F` and a torque :math:`M` between sensor and magnet, referred to the origin, and

.. math:: \frac{\partial u}{\partial q_c} = F \cdot (\nu_c^s - \nu_c^m) + M \cdot (\omega_c^s - \omega_c^m)

with the twists of the two frames. Segments before both move them together, with equal twists, and are skipped.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple, Protocol, runtime_checkable

import numpy as np
from numba import extending, types
from numba.core import cgutils, imputils
from numba.np import arrayobj

from repro.chain import Frames, frames, kinds_of, turn
from repro.common import Array, ArrayLike, bad_input, kernel, numbers, require, rows_of
from repro.magnets import Cube
from repro.networks import RELU, SILU, Layers, Network, nodes, predict
from repro.parts import Assembly

_VALUES, _SLOPES, _RELATIONS, _WRENCHES = range(4)


def cut(x, at, shape):
    """Return a part of a contiguous array from its ``at``-th number on; slices take much longer to compile."""
    return x.reshape(-1)[at : at + math.prod(shape)].reshape(shape)


@extending.type_callable(cut)
def _type_of_cut(_):
    return lambda x, at, shape: x.copy(ndim=len(shape), layout="C")


@extending.lower_builtin(cut, types.Array, types.Integer, types.BaseTuple)
def _lower_cut(context, builder, signature, given):
    own, (of_x, of_at, of_shape) = signature.return_type, signature.args
    x, found = context.make_array(of_x)(context, builder, given[0]), context.make_array(own)(context, builder)
    sizes = zip(cgutils.unpack_tuple(builder, given[2]), of_shape, strict=True)
    shape = [context.cast(builder, n, kind, types.intp) for n, kind in sizes]
    strides = [x.itemsize]
    for n in shape[:0:-1]:
        strides.insert(0, builder.mul(n, strides[0]))
    data = builder.gep(x.data, [context.cast(builder, given[1], of_at, types.intp)])
    arrayobj.populate_array(found, data, shape, strides, x.itemsize, x.meminfo)
    return imputils.impl_ret_borrowed(context, builder, own, found._getvalue())


class Tables(NamedTuple):
    """A robot and its field model as arrays for the kernels."""

    chain: Frames
    magnet_frame: Array
    magnet_place: Array
    """Position and axis of every magnet in its frame ``[m, 6]``."""
    row_frame: Array
    row_place: Array
    """Position and measuring axis of every magnetic reading in its frame ``[s, 6]``."""
    imu_frame: Array
    imu_rotation: Array
    moments: Array
    """Moments ``[m, terms]`` [mT m^(l+2)]."""
    gain: Array
    offset: Array
    earth: Array
    """Field [mT] for multipoles, else its direction for the relation lambda."""
    angles: bool
    network: Array
    """Which network predicts each reading."""
    widths: Array
    silu: bool


def pack(t: Tables) -> tuple[Array, Array]:
    """Return the tables as whole numbers and numbers in two flat arrays: numba takes few arguments much faster.

    The whole numbers begin with where every table begins and ends, first those of whole numbers.
    """
    c, head = t.chain, [t.moments.shape[1], t.angles, t.silu]
    of_chain = [c.kind, c.first, c.segment, c.tip]
    whole = [head, *of_chain, t.magnet_frame, t.row_frame, t.imu_frame, t.network, t.widths]
    real = [c.size, c.v, t.magnet_place, t.row_place, t.imu_rotation, t.moments, t.gain, t.offset, t.earth]
    ends = [np.cumsum([0, *map(np.size, parts)]) for parts in (whole, real)]
    ends[0] += len(ends[0]) + len(ends[1])
    ints = np.concatenate([*ends, *whole]).astype(np.int64)
    return ints, np.concatenate([np.ravel(x) for x in real]).astype(np.float64)


@kernel(allocates=True)
def unpack(i, x):
    """Return the tables as views of the two arrays, by their order in the lists of ``pack``."""
    terms, angles, silu = i[i[0]], i[i[0] + 1] == 1, i[i[0] + 2] == 1
    segments, frames, magnets = i[2] - i[1], i[4] - i[3], i[6] - i[5]
    rows, imus, layers = i[7] - i[6], i[8] - i[7], i[10] - i[9]
    chain = Frames(
        cut(i, i[1], (segments,)), cut(x, i[11], (segments, 6)), cut(i, i[2], (segments + 1,)),
        cut(i, i[3], (frames,)), cut(x, i[12], (frames,)), cut(i, i[4], (segments,)),
    )  # fmt: skip
    return Tables(
        chain, cut(i, i[5], (magnets,)), cut(x, i[13], (magnets, 6)), cut(i, i[6], (rows,)),
        cut(x, i[14], (rows, 6)), cut(i, i[7], (imus,)), cut(x, i[15], (imus, 3, 3)),
        cut(x, i[16], (magnets, terms)), cut(x, i[17], (rows,)), cut(x, i[18], (rows,)), cut(x, i[19], (3,)),
        angles, cut(i, i[8], (rows,)), cut(i, i[9], (layers,)), silu,
    )  # fmt: skip


@kernel(allocates=True)
def network_for(t, weights):
    """Return the layers of the networks with room for one evaluation; None without weights."""
    if weights is None:  # known when it is compiled
        return None
    return Layers(t.widths, SILU if t.silu else RELU, weights, *nodes(t.widths, weights))


class Room(NamedTuple):
    """Arrays that one evaluation writes to."""

    R: Array
    p: Array
    X: Array
    T: Array
    W: Array
    L: Array
    magnets: Array
    """Position and axis of every magnet in the base frame."""
    sensor: Array
    """Position and axis of the sensor at hand."""
    pairs: Array
    """Of every magnet, the vector to the sensor, then the sines of alpha, beta and theta."""
    xi: Array
    gradient: Array
    """Relations of the sensor at hand, and slopes of its reading."""
    wrenches: Array
    """Force and torque of every magnet on the sensor at hand; last the torque of the Earth's field."""


def numbers_in_room(t):
    """Return how many numbers one evaluation writes."""
    return 48 * len(t.chain.v) + 26 * len(t.magnet_frame) + 71


@kernel(allocates=True)
def room_for(t, x):
    """Return the room for one evaluation, cut from one array."""
    f, m = len(t.chain.v), len(t.magnet_frame)
    at, n = 48 * f, 48 * f + 6 * m
    return Room(
        cut(x, 0, (f, 3, 3)), cut(x, 9 * f, (f, 3)), cut(x, 12 * f, (f, 6, 6)),
        cut(x, at, (3, 4)), cut(x, at + 12, (6, 6)), cut(x, at + 48, (3, 3)),
        cut(x, at + 57, (m, 6)), cut(x, n + 57, (6,)), cut(x, n + 63, (m, 6)),
        cut(x, n + 6 * m + 63, (4 * m + 1,)), cut(x, n + 10 * m + 64, (4 * m + 1,)),
        cut(x, n + 14 * m + 65, (m + 1, 6)),
    )  # fmt: skip


@kernel
def geometry(kinds, t, q, slopes, room):
    """Write all frames and the places of the magnets at a configuration."""
    frames(kinds, t.chain, q, slopes, room.R, room.p, room.X, room.T, room.W, room.L)
    R, place, out = room.R, t.magnet_place, room.magnets
    for k in range(len(t.magnet_frame)):
        f = t.magnet_frame[k]
        for i in range(3):
            x, y, z = R[f, i, 0], R[f, i, 1], R[f, i, 2]
            out[k, i] = room.p[f, i] + x * place[k, 0] + y * place[k, 1] + z * place[k, 2]
            out[k, 3 + i] = x * place[k, 3] + y * place[k, 4] + z * place[k, 5]


@kernel
def _sine(a, b, c, x, y, z):
    """Length of a cross product: accurate where two directions are parallel."""
    u, v, w = b * z - c * y, c * x - a * z, a * y - b * x
    return math.sqrt(u * u + v * v + w * w)


@kernel
def relate(t, j, room):
    """Write the relations of sensor ``j`` as cosines, or as angles with their sines."""
    f, R, place, s, xi, m = t.row_frame[j], room.R, t.row_place, room.sensor, room.xi, room.magnets
    for i in range(3):
        x, y, z = R[f, i, 0], R[f, i, 1], R[f, i, 2]
        s[i] = room.p[f, i] + x * place[j, 0] + y * place[j, 1] + z * place[j, 2]
        s[3 + i] = x * place[j, 3] + y * place[j, 4] + z * place[j, 5]
    a, b, c = s[3], s[4], s[5]
    xi[0] = a * t.earth[0] + b * t.earth[1] + c * t.earth[2]
    for k in range(len(t.magnet_frame)):
        at, u, v, w = 1 + 4 * k, m[k, 3], m[k, 4], m[k, 5]
        x, y, z = s[0] - m[k, 0], s[1] - m[k, 1], s[2] - m[k, 2]
        d = math.sqrt(x * x + y * y + z * z)
        room.pairs[k, 0], room.pairs[k, 1], room.pairs[k, 2] = x, y, z
        xi[at] = d
        xi[at + 1] = a * u + b * v + c * w
        xi[at + 2] = (a * x + b * y + c * z) / d
        xi[at + 3] = (u * x + v * y + w * z) / d
        if t.angles:
            sines = _sine(a, b, c, u, v, w), _sine(a, b, c, x, y, z) / d, _sine(u, v, w, x, y, z) / d
            for i in range(3):
                room.pairs[k, 3 + i] = sines[i]
                xi[at + 1 + i] = math.atan2(sines[i], xi[at + 1 + i])
    if t.angles:
        xi[0] = math.atan2(_sine(a, b, c, t.earth[0], t.earth[1], t.earth[2]), xi[0])


@kernel(reorder=True)
def _multipoles(moments, xi, gradient):
    """Reading from the moments of all magnets and the Earth's field, and its slopes by the relations."""
    u = xi[0]
    gradient[0] = 1.0
    for k in range(len(moments)):
        at = 1 + 4 * k
        inverse, ca, cb, c = 1.0 / xi[at], xi[at + 1], xi[at + 2], xi[at + 3]
        square = inverse * inverse
        decay = square * inverse
        by_d = by_a = by_b = by_c = 0.0
        # Legendre polynomials P_n, their first (s) and second (h) slopes, by recurrence.
        p0, p1, s0, s1, h0, h1 = 1.0, c, 0.0, 1.0, 0.0, 0.0
        for i in range(moments.shape[1]):
            n = 2 * i + 1
            p2, s2, h2 = (
                ((2 * n + 1) * c * p1 - n * p0) / (n + 1),
                s0 + (2 * n + 1) * p1,
                h0 + (2 * n + 1) * s1,
            )
            weight = moments[k, i] * decay
            by_a -= weight * s1
            by_b += weight * s2
            by_c += weight * (h2 * cb - h1 * ca)
            by_d -= (n + 2) * weight * (s2 * cb - s1 * ca)
            p0, s0, h0 = p2, s2, h2
            n += 1
            p1, s1, h1 = (
                ((2 * n + 1) * c * p2 - n * p1) / (n + 1), s1 + (2 * n + 1) * p2, h1 + (2 * n + 1) * s2
            )  # fmt: skip
            decay *= square
        u += by_a * ca + by_b * cb
        gradient[at], gradient[at + 1], gradient[at + 2], gradient[at + 3] = by_d * inverse, by_a, by_b, by_c
    return u


@kernel
def wrenches(t, room):
    """Turn slopes by the relations into a force and a torque for every magnet, referred to the origin."""
    s, g, m, out = room.sensor, room.gradient, room.magnets, room.wrenches
    n_m, earth = len(t.magnet_frame), t.earth
    px, py, pz, ox, oy, oz = s[0], s[1], s[2], s[3], s[4], s[5]
    if t.angles:  # from slopes by angles to slopes by cosines; zero where two directions are parallel
        sine = _sine(ox, oy, oz, earth[0], earth[1], earth[2])
        g[0] = -g[0] / sine if sine > 0.0 else 0.0
        for k in range(n_m):
            for c in range(3):
                sine = room.pairs[k, 3 + c]
                g[2 + 4 * k + c] = -g[2 + 4 * k + c] / sine if sine > 0.0 else 0.0
    for k in range(n_m):
        at, u, v, w = 1 + 4 * k, m[k, 3], m[k, 4], m[k, 5]
        x, y, z = room.pairs[k, 0], room.pairs[k, 1], room.pairs[k, 2]
        inverse = 1.0 / math.sqrt(x * x + y * y + z * z)
        a, b, c = g[at + 1], g[at + 2] * inverse, g[at + 3] * inverse
        along = (ox * x + oy * y + oz * z) * inverse * b + (u * x + v * y + w * z) * inverse * c
        along = (g[at] - along) * inverse
        fx, fy, fz = along * x + b * ox + c * u, along * y + b * oy + c * v, along * z + b * oz + c * w
        ax, ay, az = a * u + b * x, a * v + b * y, a * w + b * z  # the slope by the axis of the sensor
        out[k, 0], out[k, 1], out[k, 2] = fx, fy, fz
        out[k, 3] = py * fz - pz * fy + oy * az - oz * ay
        out[k, 4] = pz * fx - px * fz + oz * ax - ox * az
        out[k, 5] = px * fy - py * fx + ox * ay - oy * ax
    out[n_m, 0] = out[n_m, 1] = out[n_m, 2] = 0.0
    out[n_m, 3] = g[0] * (oy * earth[2] - oz * earth[1])
    out[n_m, 4] = g[0] * (oz * earth[0] - ox * earth[2])
    out[n_m, 5] = g[0] * (ox * earth[1] - oy * earth[0])


@kernel
def pull_back(t, j, factor, room, J):
    """Write the slopes of reading ``j`` by the configuration, times a factor."""
    first, tip, X, w, n_m = t.chain.first, t.chain.tip, room.X, room.wrenches, len(t.magnet_frame)
    for c in range(J.shape[1]):
        J[j, c] = 0.0
    fs = t.row_frame[j]
    gs = t.chain.segment[fs]
    for k in range(n_m + 1):
        fm = t.magnet_frame[k] if k < n_m else 0
        gm = t.chain.segment[fm]
        if fm == fs or (k == n_m and w[k, 3] == 0.0 and w[k, 4] == 0.0 and w[k, 5] == 0.0):
            continue
        fx, fy, fz, mx, my, mz = w[k, 0], w[k, 1], w[k, 2], w[k, 3], w[k, 4], w[k, 5]
        for g in range(max(min(gs, gm), 0), max(gs, gm) + 1):
            a, b = (fs if g == gs else tip[g]), (fm if g == gm else tip[g])
            for c in range(first[g + 1] - first[g]):
                total = 0.0
                if g <= gs:
                    total += mx * X[a, c, 0] + my * X[a, c, 1] + mz * X[a, c, 2]
                    total += fx * X[a, c, 3] + fy * X[a, c, 4] + fz * X[a, c, 5]
                if g <= gm:
                    total -= mx * X[b, c, 0] + my * X[b, c, 1] + mz * X[b, c, 2]
                    total -= fx * X[b, c, 3] + fy * X[b, c, 4] + fz * X[b, c, 5]
                J[j, first[g] + c] += factor * total


@kernel(entry=True)
def rotation_vector(R, out):
    """Write the rotation vector of a rotation matrix, by its quaternion: accurate up to half a turn."""
    w = 1.0 + R[0, 0] + R[1, 1] + R[2, 2]
    x, y, z = R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]
    if w < 1.0:  # near half a turn: the largest component of the axis comes from the diagonal
        i = 0
        if R[1, 1] > R[i, i]:
            i = 1
        if R[2, 2] > R[i, i]:
            i = 2
        j, k = (i + 1) % 3, (i + 2) % 3
        w = R[k, j] - R[j, k]
        sign = 1.0 if w >= 0.0 else -1.0
        w = abs(w)
        out[i] = sign * (1.0 + R[i, i] - R[j, j] - R[k, k])
        out[j], out[k] = sign * (R[j, i] + R[i, j]), sign * (R[k, i] + R[i, k])
    else:
        out[0], out[1], out[2] = x, y, z
    sine = math.sqrt(out[0] * out[0] + out[1] * out[1] + out[2] * out[2])
    share = 2.0 * math.atan2(sine, w) / sine if sine > 1e-12 * w else 2.0 / w
    out[0], out[1], out[2] = share * out[0], share * out[1], share * out[2]


@kernel
def evaluate(kinds, network, t, q, slopes, u_hat, J, room):
    """Write the readings predicted at one configuration, and their slopes if ``slopes``.

    The slopes of an IMU are its turns in the base frame, not the slopes of its rotation vector.
    """
    geometry(kinds, t, q, slopes, room)
    n_s = len(t.row_frame)
    for j in range(n_s):
        relate(t, j, room)
        if network is None:  # known when it is compiled
            u = _multipoles(t.moments, room.xi, room.gradient)
        else:
            u = predict(network, t.network[j], room.xi, slopes, room.gradient)
        u_hat[j] = t.gain[j] * u + t.offset[j]
        if slopes:
            wrenches(t, room)
            pull_back(t, j, t.gain[j], room, J)
    if kinds is not None:
        _orientations(t, slopes, u_hat, J, room)


@kernel
def _orientations(t, slopes, u_hat, J, room):
    chain, n_s, product = t.chain, len(t.row_frame), room.T
    for i in range(len(t.imu_frame)):
        f, row = t.imu_frame[i], n_s + 3 * i
        for a in range(3):
            for b in range(3):
                product[a, b] = 0.0
                for c in range(3):
                    product[a, b] += room.R[f, a, c] * t.imu_rotation[i, c, b]
        rotation_vector(product, u_hat[row : row + 3])
        if slopes:
            J[row : row + 3, :] = 0.0
            for g in range(chain.segment[f] + 1):
                at = f if g == chain.segment[f] else chain.tip[g]
                for c in range(chain.first[g], chain.first[g + 1]):
                    for a in range(3):
                        J[row + a, c] = room.X[at, c - chain.first[g], a]


@kernel
def difference(n_s, u, u_hat, r):
    """Write what was read beyond what was predicted, NaN where nothing was read."""
    for j in range(n_s):
        r[j] = u[j] - u_hat[j] if math.isfinite(u[j]) else math.nan


@kernel
def turned(n_s, u, u_hat, r, A, B, W):
    """Write the same for IMUs: the rotation vector, in the base frame, from predicted to measured orientation.

    ``A``, ``B`` and ``W`` are room.
    """
    for row in range(n_s, len(u), 3):
        if not (math.isfinite(u[row]) and math.isfinite(u[row + 1]) and math.isfinite(u[row + 2])):
            r[row : row + 3] = math.nan
            continue
        turn(u[row], u[row + 1], u[row + 2], A, W)
        turn(-u_hat[row], -u_hat[row + 1], -u_hat[row + 2], B, W)
        for a in range(3):
            for b in range(3):
                W[a, b] = A[a, 0] * B[0, b] + A[a, 1] * B[1, b] + A[a, 2] * B[2, b]
        rotation_vector(W, r[row : row + 3])


@kernel
def residuals(kinds, t, u, u_hat, r, room):
    """Write what was read beyond what was predicted, of all sensors of a robot."""
    difference(len(t.row_frame), u, u_hat, r)
    if kinds is not None:  # known when it is compiled
        turned(len(t.row_frame), u, u_hat, r, room.T, room.L, room.W)


@kernel(entry=True, allocates=True)
def _batch(ints, floats, weights, kinds, work, q, task, u, J, extra):
    """Evaluate a batch: one kernel for all tasks, because compiling it takes seconds.

    ``work`` is room for one evaluation. ``extra`` takes the relations or the wrenches.
    """
    t = unpack(ints, floats)
    network, room = network_for(t, weights), room_for(t, work)
    for n in range(len(q)):
        if task <= _SLOPES:
            evaluate(kinds, network, t, q[n], task == _SLOPES, u[n], J[n if task == _SLOPES else 0], room)
            continue
        geometry(kinds, t, q[n], task == _SLOPES, room)
        for j in range(len(t.row_frame)):
            relate(t, j, room)
            if task == _RELATIONS:
                extra[n, j, :] = room.xi
            else:
                u[n, j] = _multipoles(t.moments, room.xi, room.gradient)
                wrenches(t, room)
                extra[n, j, :] = room.wrenches.ravel()


@kernel(entry=True, allocates=True)
def batch_difference(n_s, u, u_hat, r):
    """Write what was read beyond what was predicted for a batch, rotations behind ``n_s`` plain readings."""
    A, B, W = np.zeros((3, 4)), np.zeros((3, 3)), np.zeros((6, 6))
    for n in range(len(u)):
        difference(n_s, u[n], u_hat[n], r[n])
        turned(n_s, u[n], u_hat[n], r[n], A, B, W)


_NO_ROWS, _NO_SLOPES = np.empty((0, 0)), np.empty((1, 0, 0))


def _zero_network(width: int, inputs: str) -> Network:
    """Predict nothing; of the type of the paper's networks, so that one compilation serves them and multipoles."""
    return Network([(np.zeros((1, width), np.float32), np.zeros(1, np.float32))], "relu", inputs)


@runtime_checkable
class Linearised(Protocol):
    """A model that gives its slopes, too."""

    def linearise(self, x: Array) -> tuple[Array, Array]:
        """Return values, and their slopes by ``x``."""
        ...


class Sensing:
    """Sensor model ``u = sensing(q)`` of a robot: its magnetic sensors and its IMUs.

    Readings are those of the sensors, one for every axis, in the unit of the model; then, for every IMU, the
    rotation vector [rad] that turns its frame to the base frame.

    Parameters
    ----------
    robot
        With sensors, IMUs, or both.
    model
        How relations become magnetic readings. ``None``: the multipoles of the robot's magnets [mT]. A
        :class:`.Network`, or several: as many as there are readings, or as there are segments with sensors.
    moments
        Moments of the magnets [mT m^(l+2)], ``[terms]`` or ``[m, terms]``; those of their shapes if not given.
    l_max
        Highest order of the multipoles of their shapes.
    gain
        Factor of every magnetic reading, which is ``gain * model + offset``.
    offset
        Every magnetic reading without a field.
    earth
        Field of the Earth in the base frame [mT]. Networks take its direction, x if not given, as the relation
        lambda, as in the paper.

    Raises
    ------
    InputError
        If there is nothing to read, or something does not fit the robot.

    Examples
    --------
    A dipole straight below a sensor that looks down, -2 A_1/d^3 at d = 55 mm:

    >>> from repro import ConstantCurvature, Disc, Magnet, Robot, Sensing, Sensor
    >>> magnet = Magnet(Disc(6e-3, 3e-3, 1300.0), segment=1, at=0.055)
    >>> robot = Robot([ConstantCurvature(0.11, 0.022)], [magnet], [Sensor(segment=1, at=0.11)])
    >>> Sensing(robot, moments=[1e-4])([0.0, 0.0, 0.0])
    array([-1.20210368])
    """

    compiled = True
    """Whether the kernels of estimators know the model."""

    def __init__(
        self,
        robot: Assembly,
        model: Network | Sequence[Network] | None = None,
        *,
        moments: ArrayLike | None = None,
        l_max: int = 9,
        gain: ArrayLike = 1.0,
        offset: ArrayLike = 0.0,
        earth: ArrayLike | None = None,
    ) -> None:
        owner = "Sensing"
        self.robot, self.model = robot, model
        self.n_q, self.n_readings, self.rotations = robot.n_q, robot.n_readings, robot.rotations
        self.n_magnetic, n_m = robot.n_magnetic, len(robot.magnets)
        require(self.n_readings, "robot", owner, "one with sensors or IMUs", "neither")
        complete = not robot.sensors or robot.magnets or earth is not None
        require(complete, "robot", owner, "one with magnets", "none")
        self.moments = self._moments(moments, l_max)
        networks = [] if model is None else self._networks(model)
        default = [0.0, 0.0, 0.0] if model is None else [1.0, 0.0, 0.0]
        along = numbers(default if earth is None else earth, "earth", owner, (3,))
        if model is not None:
            require(np.any(along), "earth", owner, "a direction", earth)
            along = along / np.linalg.norm(along)
        places = [part.place for part in (*robot.magnets, *robot.sensors, *robot.imus)]
        chain, frame = robot.frames(places)
        of_sensors = [
            [*sensor.place.position, *axis]
            for sensor in robot.sensors
            for axis in sensor.place.rotation.T[-sensor.axes :]
        ]
        self.tables = Tables(
            chain=chain,
            magnet_frame=frame[:n_m],
            magnet_place=np.array([[*p.position, *p.rotation[:, 2]] for p in places[:n_m]]).reshape(n_m, 6),
            row_frame=frame[n_m + robot.parts[: self.n_magnetic]],
            row_place=np.array(of_sensors).reshape(-1, 6),
            imu_frame=frame[n_m + len(robot.sensors) :],
            imu_rotation=np.array([imu.place.rotation for imu in robot.imus]).reshape(-1, 3, 3),
            moments=self.moments,
            gain=self._per_reading(gain, "gain"),
            offset=self._per_reading(offset, "offset"),
            earth=along,
            angles=model is not None and networks[0].inputs == "angles",
            network=self._network_of_reading(max(len(networks), 1)),
            widths=np.array(networks[0].widths if networks else [0]),
            silu=model is not None and networks[0].activation == "silu",
        )
        kinds = chain.kind if robot.imus else kinds_of(chain)
        weights = np.stack([network.weights for network in networks]) if networks else None
        self._in_room = numbers_in_room(self.tables)
        self.packed = (*pack(self.tables), weights, kinds)
        """For kernels: the tables, then weights and kinds of segments. Without a network there are no weights, and
        without IMUs or segments of other kinds than constant curvature no kinds: what these need is not compiled."""

    def work(self) -> Array:
        """Return what kernels write to in one evaluation."""
        return np.zeros(self._in_room)

    def _moments(self, moments: ArrayLike | None, l_max: int) -> Array:
        n_m = len(self.robot.magnets)
        if moments is None:
            rows = [magnet.shape.multipoles(l_max) for magnet in self.robot.magnets]
            return np.array(rows) if rows else np.zeros((0, 1))
        values = numbers(moments, "moments", "Sensing", (None,) if np.ndim(moments) == 1 else (n_m, None))
        require(values.shape[-1], "moments", "Sensing", "at least one", "none")
        return np.broadcast_to(values, (n_m, values.shape[-1]))

    def _per_reading(self, value: ArrayLike, name: str) -> Array:
        found = numbers(value, name, "Sensing")
        fits = found.shape in ((), (self.n_magnetic,))
        expected = f"one number or one for each of {self.n_magnetic} magnetic readings"
        require(fits, name, "Sensing", expected, f"shape {found.shape}")
        return np.broadcast_to(found, (self.n_magnetic,))

    def _networks(self, model: Network | Sequence[Network]) -> Sequence[Network]:
        """Networks that fit the robot and each other."""
        networks = model if isinstance(model, Sequence) else [model]
        width = 1 + 4 * len(self.robot.magnets)
        for network in networks or [None]:
            if not isinstance(network, Network):
                raise bad_input("model", "Sensing", "networks", type(network).__name__)
            expected = f"one of {width} relations, as the robot has"
            require(network.n_inputs == width, "model", "Sensing", expected, f"{network.n_inputs}")
            alike = network.architecture == networks[0].architecture
            require(alike, "model", "Sensing", "networks of one architecture", "several")
        return networks

    def _network_of_reading(self, n: int) -> Array:
        """One network for all, one for each reading, or one for each segment with sensors."""
        segments = [sensor.segment for sensor in self.robot.sensors for _ in range(sensor.axes)]
        if n == 1:
            return np.zeros(len(segments), dtype=np.int64)
        if n == len(segments):
            return np.arange(n)
        used, of_reading = np.unique(segments, return_inverse=True)
        expected = (
            f"one network, one for each of {len(segments)} readings or of {len(used)} segments with sensors"
        )
        require(n == len(used), "model", "Sensing", expected, f"{n} networks")
        return of_reading

    def relations(self, q: ArrayLike) -> Array:
        """Return the relations ``[..., s, 1 + 4 m]`` of eq. (1) that the model takes [rad or cosines; m]."""
        q = self.robot.check_q(q, "Sensing")
        xi = np.empty((math.prod(q.shape[:-1]), self.n_magnetic, 1 + 4 * len(self.robot.magnets)))
        ints, floats, _, kinds = self.packed
        _batch(ints, floats, None, kinds, self.work(), rows_of(q), _RELATIONS, _NO_ROWS, _NO_SLOPES, xi)
        return xi.reshape(*q.shape[:-1], *xi.shape[1:])

    def too_near(self, q: ArrayLike) -> Array:
        """Return which readings ``[..., s]`` are taken so close to a magnet that multipoles do not give its field."""
        q = self.robot.check_q(q, "Sensing")
        near = np.zeros((*q.shape[:-1], self.n_readings), dtype=bool)
        if self.model is None and self.robot.magnets:
            reach = [magnet.shape.reach for magnet in self.robot.magnets]
            near[..., : self.n_magnetic] = (self.relations(q)[..., 1::4] < reach).any(-1)
        return near

    def __call__(self, q: ArrayLike) -> Array:
        """Return the predicted readings ``[..., s]`` at configurations ``[..., n_q]``."""
        q = self.robot.check_q(q, "Sensing")
        u = np.empty((*q.shape[:-1], self.n_readings))
        _batch(*self.packed, self.work(), rows_of(q), _VALUES, rows_of(u), _NO_SLOPES, _NO_SLOPES)
        return u

    def linearise(self, q: ArrayLike) -> tuple[Array, Array]:
        """Return readings ``[..., s]`` and their slopes ``[..., s, n_q]``.

        The slopes of an IMU are by how much it turns about the axes of the base [rad per unit of the coordinate].
        """
        q = self.robot.check_q(q, "Sensing")
        u = np.empty((*q.shape[:-1], self.n_readings))
        J = np.empty((math.prod(q.shape[:-1]), self.n_readings, self.n_q))
        _batch(*self.packed, self.work(), rows_of(q), _SLOPES, rows_of(u), J, _NO_SLOPES)
        return u, J.reshape(*u.shape, self.n_q)

    def difference(self, u: ArrayLike, u_hat: ArrayLike) -> Array:
        """Return what was read beyond what was predicted ``[..., s]``, NaN where nothing was read.

        Of an IMU that is the rotation vector, in the base frame, from the predicted to the measured orientation.
        """
        u, u_hat = np.broadcast_arrays(np.asarray(u, dtype=float), np.asarray(u_hat, dtype=float))
        r = np.empty(u.shape)
        batch_difference(self.n_magnetic, rows_of(u), rows_of(u_hat), rows_of(r))
        return r

    def wrenches(self, q: ArrayLike) -> tuple[Array, Array]:
        """Return the multipole readings without gain and offset, and the wrench of every magnet on every reading.

        The wrench ``[..., s, m + 1, 6]`` is a force, then a torque about the origin of the base frame: a reading
        changes by ``wrench @ (motion, turn)`` when its sensor moves by that twist, and by the negative when the
        magnet does. The last one is that of the Earth's field.
        """
        require(self.model is None, "model", "wrenches", "multipoles", type(self.model).__name__)
        q = self.robot.check_q(q, "Sensing")
        u = np.empty((*q.shape[:-1], self.n_magnetic))
        wrench = np.empty((math.prod(q.shape[:-1]), self.n_magnetic, 6 * (len(self.robot.magnets) + 1)))
        _batch(*self.packed, self.work(), rows_of(q), _WRENCHES, rows_of(u), _NO_SLOPES, wrench)
        return u, wrench.reshape(*u.shape, -1, 6)


def sensing_of(robot: Assembly) -> Sensing:
    """Return the sensor model of a robot, with the gain and offset of every sensor and the Earth's field."""
    gain, offset = (
        robot.per_reading(name, none, none)[: robot.n_magnetic]
        for name, none in (("gain", 1.0), ("offset", 0.0))
    )
    return Sensing(robot, robot.model, moments=robot.moments, gain=gain, offset=offset, earth=robot.earth)


def relations(
    robot: Assembly, q: ArrayLike, *, inputs: str = "cosines", earth: ArrayLike | None = None
) -> Array:
    r"""Return the relations between all sensors and magnets of a robot, eqs (3) to (7) of Baaij et al. 2023.

    Parameters
    ----------
    robot
        With sensors and magnets.
    q
        Configurations ``[..., n_q]``.
    inputs
        ``"cosines"``, smooth in the configuration, or ``"angles"`` [rad] as in the paper.
    earth
        Direction of the field of the Earth in the base frame; x if not given.

    Returns
    -------
    numpy.ndarray
        ``[..., s, 1 + 4 m]``: for every reading :math:`\lambda`, then :math:`d` [m], :math:`\alpha`, :math:`\beta`,
        :math:`\theta` for every magnet.

    Examples
    --------
    >>> from repro import ConstantCurvature, Disc, Magnet, Robot, Sensor
    >>> magnet = Magnet(Disc(6e-3, 3e-3, 1300.0), segment=1, at=0.055)
    >>> robot = Robot([ConstantCurvature(0.11, 0.022)], [magnet], [Sensor(segment=1, at=0.11)])
    >>> relations(robot, [0.0, 0.0, 0.0]).round(3) + 0.0
    array([[ 0.   ,  0.055, -1.   , -1.   ,  1.   ]])
    """
    return Sensing(robot, _zero_network(1 + 4 * len(robot.magnets), inputs), earth=earth).relations(q)


_CUBE = Cube(6.35e-3, 1320.0)
"""The cube of Mitchell et al. 2021, a quarter of an inch long."""


@dataclass(frozen=True)
class BendSensor:
    r"""Sensor model of Mitchell et al. 2021: from a bend vector to the flux density at the base of the arc.

    The bend vector :math:`q = \varphi (\cos\theta, \sin\theta)` [rad] has the bend angle as its length and points
    towards the bend. It has no singularity where the arc is straight, unlike :math:`(\theta, \varphi)`. The field of
    the cube is its closed form, exact to rounding.

    Parameters
    ----------
    length
        Length of the arc from the sensor to the centre of the magnet [m], longer than 1.25 edges of the
        cube: below half a turn the sensor then stays clear of it.
    cube
        The magnet; if not given the B444B of the paper, 1/4 inch with 1320 mT.

    Raises
    ------
    InputError
        If the length is not longer than 1.25 edges.

    Examples
    --------
    Straight, the sensor is on the axis of the cube, 15 mm from its centre:

    >>> sensor = BendSensor(0.015)
    >>> sensor([0.0, 0.0]).round(4)
    array([ 0.    ,  0.    , 15.8308])

    A quarter circle of length L ends at (2 L/pi, 0, 2 L/pi):

    >>> sensor.position([np.pi / 2, 0.0]).round(6)
    array([0.009549, 0.      , 0.009549])
    """

    length: float
    cube: Cube = _CUBE

    def __post_init__(self) -> None:
        fits = 1.25 * self.cube.edge < self.length < math.inf
        require(fits, "length", "BendSensor", "longer than 1.25 edges of the cube [m]", self.length)

    def __call__(self, q: ArrayLike) -> Array:
        """Return the flux density ``[..., 3]`` [mT] in the frame of the sensor, z along the straight arc.

        ``q`` are bend vectors ``[..., 2]`` [rad] of less than half a turn; NaN gives NaN.
        """
        q = numbers(q, "q", "BendSensor", (..., 2), finite=False)
        out = np.empty((*q.shape[:-1], 3))
        half_edge, scale = self.cube.edge / 2, self.cube.polarisation_mt / (4 * math.pi)
        flat = np.ascontiguousarray(q).reshape(-1)
        _bend_field(flat, self.length / half_edge, scale, out.reshape(-1))
        return out

    def position(self, q: ArrayLike) -> Array:
        """Return the position of the magnet ``[..., 3]`` [m] in the frame of the sensor."""
        q = numbers(q, "q", "BendSensor", (..., 2), finite=False)
        angle = np.hypot(q[..., :1], q[..., 1:])
        half = np.sinc(angle / (2 * math.pi))
        return self.length * np.concatenate([q * half**2 / 2, np.sinc(angle / math.pi)], axis=-1)


@kernel(entry=True, allocates=True)
def _bend_field(q, length, scale, out):
    r"""Write the flux density for flat bend vectors; lengths are in half edges, ``scale`` is J/(4 pi).

    The two pole faces carry the magnetic charge :math:`\pm J`. Coulomb's law gives sums over the eight corners, whose
    sign is the product of the signs of their coordinates. With :math:`(\xi, \eta, \zeta)` from a corner to the sensor
    and :math:`r` its length, :math:`B_x = -J/4\pi \sum \pm \ln(\eta + r)`,
    :math:`B_y = -J/4\pi \sum \pm \ln(\xi + r)` and :math:`B_z = J/4\pi \sum \pm \arctan(\xi\eta/\zeta r)`.

    Eight logarithms become one of a ratio, eight arctangents the angle of a product of complex numbers. Series, exact
    to rounding, stand for the functions of the angle, and short loops call nothing but the square root: so the
    processor handles several bends at once.
    """
    n = len(q) // 2
    s, c, x_root, y_root, z_half = np.empty((5, n))
    for i in range(n):
        square = 0.25 * (q[2 * i] * q[2 * i] + q[2 * i + 1] * q[2 * i + 1])
        half = cosine = 1.0  # sin(h)/h and cos(h) of half the angle
        for k in range(11, -1, -1):
            half = 1.0 - square * (1.0 / ((2 * k + 2) * (2 * k + 3))) * half
            cosine = 1.0 - square * (1.0 / ((2 * k + 1) * (2 * k + 2))) * cosine
        s[i], c[i] = half * cosine, 0.5 * half * half
        # The field is a mirror image of that in the first octant, where eta + r does not cancel.
        x, y, z = abs(length * q[2 * i] * c[i]), abs(length * q[2 * i + 1] * c[i]), abs(length * s[i])
        x_up, x_down, y_up, y_down, re, im = 1.0, 1.0, 1.0, 1.0, 1.0, 0.0
        for j in range(2):
            for k in range(2):
                # Corners at +x and -x; where y and z have different signs, they change places.
                near, far = (x - 1.0, x + 1.0) if j == k else (x + 1.0, x - 1.0)
                eta, zeta = y - 1.0 + 2.0 * j, z - 1.0 + 2.0 * k
                a = math.sqrt(near * near + eta * eta + zeta * zeta)
                b = math.sqrt(far * far + eta * eta + zeta * zeta)
                x_up, x_down, y_up, y_down = (
                    x_up * (eta + a),
                    x_down * (eta + b),
                    y_up * (near + a),
                    y_down * (far + b),
                )
                p, m = zeta * zeta * a * b + eta * eta * near * far, eta * zeta * (near * b - far * a)
                re, im = re * p - im * m, re * m + im * p
        x_root[i], y_root[i] = math.sqrt(x_up / x_down), math.sqrt(y_up / y_down)
        z_half[i] = im / (math.sqrt(re * re + im * im) + re)
    for i in range(n):
        # A logarithm is four times the inverse of tanh at x, an angle four times that of tan at z.
        x, y = (x_root[i] - 1.0) / (x_root[i] + 1.0), (y_root[i] - 1.0) / (y_root[i] + 1.0)
        z = z_half[i] / (1.0 + math.sqrt(1.0 + z_half[i] * z_half[i]))
        Bx = By = Bz = 0.0
        for k in range(15, -1, -1):
            Bx, By, Bz = (
                Bx * (x * x) + 1.0 / (2 * k + 1),
                By * (y * y) + 1.0 / (2 * k + 1),
                1.0 / (2 * k + 1) - Bz * (z * z),
            )
        u, v, side = q[2 * i], q[2 * i + 1], math.copysign(4.0 * scale, s[i])
        Bx, By, Bz = (
            math.copysign(1.0, u) * side * x * Bx,
            math.copysign(1.0, v) * side * y * By,
            4.0 * scale * z * Bz,
        )
        # Rodrigues' rotation about (-v, u, 0): B + s w x B + c w x (w x B).
        along = u * Bx + v * By
        push = s[i] * Bz - c[i] * along
        out[3 * i], out[3 * i + 1] = Bx + u * push, By + v * push
        out[3 * i + 2] = Bz - s[i] * along - c[i] * (u * u + v * v) * Bz
