r"""The chain of Martin et al. 2022 between IMUs, compiled: `edition1.estimation.imu_models.pcc_extended` in one pass.

Of the turn from one IMU to the next the unit quaternion :math:`(v, w)` is at hand, with
:math:`|v| = \sin(\varphi/2)`. So a whole link takes no trigonometric function of :math:`\varphi/2`, and with
:math:`\theta = \varphi/2n` the factor of its first :math:`k` sub-segments is :math:`\sin(k\theta)/(k\sin\theta)`,
where halving an angle takes a square root only.
"""

from __future__ import annotations

import math

import numpy as np
from jaxtyping import Float

from edition1.estimation import imu_models
from edition1.estimation._imu_arcs import from_base, links_between, place, points_on
from edition1.estimation.imu_models import Points
from edition1.estimation.imu_selection import Selection
from edition1.estimation.orientations import UNIT_TOLERANCE
from edition1.kernels.compilation import machine_code

_SMALL = 1e-300  # a sine this small turns nothing, and can be divided by
_TINY = 1e-150  # its square cannot


def pcc_extended(
    orientations: Float[np.ndarray, "*samples imus 4"], selection: Selection, arc_lengths: Points
) -> Float[np.ndarray, "*samples points 3"]:
    """As :func:`edition1.estimation.imu_models.pcc_extended`, to rounding.

    Several times faster with the printed interpolation; with another one it is that function.

    Parameters
    ----------
    orientations, selection, arc_lengths
        As there.

    Raises
    ------
    InputError
        As there.
    """
    if selection.turn_share == 1 and np.shape(orientations)[-2:] == (len(selection.imus), 4):
        links_between(selection, "pcc_extended")
        points = points_on(arc_lengths, selection, "pcc_extended")
        lengths, n = np.array(selection.link_lengths), selection.sub_links
        q = np.ascontiguousarray(orientations, dtype=np.float64)
        link, share = place(lengths, points)
        order = np.argsort(link, kind="stable")
        out = np.empty((*q.shape[:-2], len(points), 3))
        whole = np.minimum((share * n).astype(np.int64), n - 1)
        flat, rows = q.reshape(-1, *q.shape[-2:]), out.reshape(-1, len(points), 3)
        if _chain(flat, lengths, order, link, share, whole, n, UNIT_TOLERANCE, rows):
            return from_base(out, selection)
        # The other route says which quaternion is wrong.
    return imu_models.pcc_extended(orientations, selection, arc_lengths)


@machine_code(reorder=True)
def _chain(q, lengths, order, link, share, whole, n, tolerance, out):
    """Walk up the chain of every sample; false if a quaternion is not unit."""
    n_points, n_links = len(order), len(lengths)
    for m in range(len(q)):
        x_0, y_0, z_0 = 0.0, 0.0, 0.0  # start of the link
        ax, ay, az, aw, error = _unit(q[m, 0])
        if not error <= tolerance:
            return False
        p = 0
        for k in range(n_links):
            bx, by, bz, bw, error = _unit(q[m, k + 1])
            if not error <= tolerance:
                return False
            dx, dy, dz = 2.0 * (ax * az + ay * aw), 2.0 * (ay * az - ax * aw), 1.0 - 2.0 * (ax * ax + ay * ay)
            # The turn b a^-1, by the shorter way round.
            vx = -bw * ax + bx * aw - by * az + bz * ay
            vy = -bw * ay + bx * az + by * aw - bz * ax
            vz = -bw * az - bx * ay + by * ax + bz * aw
            w = bw * aw + bx * ax + by * ay + bz * az
            if w < 0.0:
                vx, vy, vz, w = -vx, -vy, -vz, -w
            sine = max(math.sqrt(vx * vx + vy * vy + vz * vz), _SMALL)
            single, straight = _share(sine, w, n)
            ahead = vx * dx + vy * dy + vz * dz
            per_sine, per_side = 1.0 / sine, 1.0 / (n * single)
            S = sine * per_side
            along = (1.0 - S * w) * per_sine * per_sine * ahead if sine > _TINY else 0.0
            step_x = S * (w * dx + vy * dz - vz * dy) + along * vx
            step_y = S * (w * dy + vz * dx - vx * dz) + along * vy
            step_z = S * (w * dz + vx * dy - vy * dx) + along * vz
            ux, uy, uz, length = vx * per_sine, vy * per_sine, vz * per_sine, lengths[k]
            nx, ny, nz = uy * dz - uz * dy, uz * dx - ux * dz, ux * dy - uy * dx
            ahead = ux * dx + uy * dy + uz * dz
            while p < n_points and link[order[p]] == k:
                at = order[p]
                p += 1
                t, side, cosine = share[at], 0.0, 1.0
                for _ in range(whole[at]):  # sine and cosine of the whole sub-segments' angle
                    side, cosine = side * straight + cosine * single, cosine * straight - side * single
                next_side = side * straight + cosine * single
                next_cosine = cosine * straight - side * single
                rest, S = t - whole[at] / n, side * per_side
                cross = S * side + rest * (side * next_cosine + cosine * next_side)
                level = S * cosine + rest * (cosine * next_cosine - side * next_side)
                along = (t - level) * ahead
                out[m, at, 0] = x_0 + length * (level * dx + cross * nx + along * ux)
                out[m, at, 1] = y_0 + length * (level * dy + cross * ny + along * uy)
                out[m, at, 2] = z_0 + length * (level * dz + cross * nz + along * uz)
            x_0, y_0, z_0 = x_0 + length * step_x, y_0 + length * step_y, z_0 + length * step_z
            ax, ay, az, aw = bx, by, bz, bw
    return True


@machine_code(reorder=True)
def _unit(q):
    """Components of a quaternion rescaled to unit length, and how far its norm was from 1."""
    norm = math.sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3])
    scale = 1.0 / norm
    return scale * q[0], scale * q[1], scale * q[2], scale * q[3], abs(norm - 1.0)


@machine_code(reorder=True)
def _share(sine, cosine, n):
    """Sine and cosine of one ``n``-th of an angle up to a right angle: by halves as long as that goes."""
    while n % 2 == 0:
        half = math.sqrt(0.5 + 0.5 * cosine)
        sine, cosine, n = 0.5 * sine / half, half, n // 2
    if n > 1:
        angle = math.atan2(sine, cosine) / n
        sine, cosine = math.sin(angle), math.cos(angle)
    return sine, cosine
