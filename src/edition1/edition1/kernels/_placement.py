"""Slopes of the readings by the placement of parts, gains, moments, offsets and Earth field, compiled.

The same derivatives as those of :class:`edition1.sensing.placement.PlacedReadings`, for one robot as it is: fast enough
for every reading of a live stream.
"""

from __future__ import annotations

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from edition1.kernels._motion import array, chain, move, scratch
from edition1.kernels._multipole import multipole
from edition1.kernels._relations import pairs, relate
from edition1.kernels.compilation import machine_code
from edition1.kinematics.mounts import Mounts
from edition1.kinematics.robot import Robot
from edition1.sensing.placement import mount_slopes, placed


class PlacementSlopes:
    """Derivatives of readings by every parameter of a robot, at given parameters.

    Parameters
    ----------
    robot, moments
        As drawn.
    parameters
        Where to differentiate, in the order of :func:`edition1.sensing.placement.parameter_names`; m, rad, relative.
    gain
        Readings per flux density of every sensor as drawn [unit/mT].
    earth_mt
        Earth field in the base frame [mT].

    Raises
    ------
    InputError
        If the parameters do not fit, or a segment is not of constant or of affine curvature.
    """

    def __init__(
        self,
        robot: Robot,
        moments: Float[Tensor, "*m terms"],
        parameters: Float[Tensor, " k"],
        gain: Float[Tensor, " s"],
        earth_mt: Float[Tensor, " 3"],
    ) -> None:
        parts = placed(robot, moments, parameters)
        mounts = parts.magnets.joined(parts.sensors)
        # Three mounts more for each: their axes are those of the frame of the backbone there.
        turned = torch.zeros(3, 4, 4, dtype=torch.float64)
        turned[0, 0, 2] = turned[1, 1, 2] = turned[2, 2, 2] = 1.0
        frames = Mounts(
            tuple(np.repeat(mounts.segment, 3).tolist()),
            mounts.axial.repeat_interleave(3, -1),
            turned.repeat(len(mounts), 1, 1),
        )
        self._chain = chain(robot, mounts.joined(frames))[0]
        self._moves = tuple(array(x) for x in mount_slopes(robot, moments, parameters))
        rows = [x.expand(len(robot.magnets), -1) for x in (parts.moments, moments)]  # of each magnet
        self._moments = (*map(array, rows), moments.ndim == 1)
        self._gain = array(gain * parts.gain), array(gain)
        self._earth = array(earth_mt)

    def __call__(self, q: Float[np.ndarray, "n n_q"]) -> Float[np.ndarray, "n s all"]:
        """Slopes at configurations, by the parameters, then the offsets and the Earth field [unit/mT].

        The offsets are those of the readings [unit], so their slopes are 0 and 1.
        """
        rows = np.ascontiguousarray(q, dtype=np.float64)
        return _slopes(self._chain, rows, self._moves, self._moments, self._gain, self._earth)


@machine_code()
def _slopes(links, q, moves, moments, gain, earth):
    """Slopes ``[n, s, all]`` for configurations ``[n, n_q]``."""
    by_magnet, by_sensor = moves  # [n, p, 2, 3]: axis and position by parameter, in the frame of the backbone
    moments, drawn, shared = moments
    total, file = gain
    n_m, n_s, terms = len(by_magnet), len(by_sensor), drawn.shape[1]
    own_terms = 0 if shared else terms
    own_m, own_s = by_magnet.shape[1], by_sensor.shape[1] + 1
    first_moment = own_m * n_m + own_s * n_s
    first_offset = first_moment + (terms if shared else terms * n_m)
    J = np.zeros((len(q), n_s, first_offset + n_s + 3))
    motion, pair, one = scratch(links), pairs(n_m), np.zeros(terms)
    by_o, by_m, by_p, by_x = np.zeros(3), np.zeros(3), np.zeros(3), np.zeros(3)
    for i in range(len(q)):
        move(links, 0, q[i], False, motion)
        for s in range(n_s):
            j, row = n_m + s, J[i, s]
            relate(motion.axis, motion.position, j, earth, False, pair)
            o, xi, u = motion.axis[j], pair.xi, pair.xi[0]
            for r in range(3):
                by_o[r], by_x[r] = earth[r], 0.0
            for k in range(n_m):
                at, m, p_hat = 1 + 4 * k, motion.axis[k], pair.direction[k]
                d, alpha, beta, theta = xi[at], xi[at + 1], xi[at + 2], xi[at + 3]
                part, by_d, by_alpha, by_beta, by_theta = multipole(moments[k], d, alpha, beta, theta)
                u += part
                for r in range(3):
                    by_o[r] += by_alpha * m[r] + by_beta * p_hat[r]
                    by_m[r] = by_alpha * o[r] + by_theta * p_hat[r]
                    across = by_beta * (o[r] - beta * p_hat[r]) + by_theta * (m[r] - theta * p_hat[r])
                    by_p[r] = by_d * p_hat[r] + across / d
                    by_x[r] += by_p[r]
                for c in range(own_m):
                    row[own_m * k + c] = total[s] * _moved(
                        motion, n_m + n_s, k, by_magnet[k, c], by_m, by_p, -1.0
                    )
                for t in range(terms):
                    one[t] = 1.0
                    own = total[s] * drawn[k, t]
                    row[first_moment + k * own_terms + t] += own * multipole(one, d, alpha, beta, theta)[0]
                    one[t] = 0.0
            at = own_m * n_m + own_s * s
            for c in range(own_s - 1):
                row[at + c] = total[s] * _moved(motion, n_m + n_s, j, by_sensor[s, c], by_o, by_x, 1.0)
            row[at + own_s - 1] = file[s] * u
            row[first_offset + s] = 1.0
            for r in range(3):
                row[first_offset + n_s + r] = total[s] * o[r]
    return J


@machine_code()
def _moved(motion, n, j, by_parameter, by_axis, by_position, sign):
    """Slope by a parameter that moves mount ``j``, whose frame has its axes from mount ``n + 3 j`` on."""
    slope = 0.0
    for c in range(3):
        e = motion.axis[n + 3 * j + c]
        for r in range(3):
            slope += e[r] * (by_axis[r] * by_parameter[0, c] + sign * by_position[r] * by_parameter[1, c])
    return slope
