"""Prototype of links with a vector: headings, one frame and the vectors of all links, from motion capture of joints.

The position of joint k is the sum of ``R_z(heading_i) R_i v_i`` over the links before it, turned by a small rotation.
The vectors have a drawing and a tolerance, as everything else that a calibration finds.
"""

from __future__ import annotations

import numpy as np
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation


def calibrate_links(turns, joints, drawn, *, tolerance=0.03, noise=0.03, level=0.05, along_only=False):
    """Return ``predicted(turns) -> positions [t, n, 3]``.

    Parameters
    ----------
    turns
        Rotation matrices of the IMUs ``[t, n, 3, 3]``, upright.
    joints
        Positions of the ends of the links from the first one's start ``[t, n, 3]`` [m].
    drawn
        Vector of every link in the frame of its IMU, about along z ``[n, 3]`` [m].
    tolerance, noise, level
        Standard deviations of a vector [m], of a position [m] and of the tilt of the frame [rad].
    along_only
        Whether only lengths are fitted, as today.
    """
    n = turns.shape[1]
    drawn = np.asarray(drawn, float)

    def predicted(z, turns):
        frame = Rotation.from_rotvec(z[:3]).as_matrix()
        heading = Rotation.from_rotvec(np.outer(z[3 : 3 + n], [0.0, 0.0, 1.0])).as_matrix()
        vectors = drawn + z[3 + n :].reshape(n, 3) * tolerance
        return np.cumsum(np.einsum("kij,tkjl,kl->tki", heading, turns, vectors), axis=1) @ frame.T

    held = np.ones(3)
    held[:2] = 1e3 if along_only else 1.0

    def residuals(z):
        off = (predicted(z, turns) - joints) / noise
        return np.concatenate([off.ravel(), z[:3] / level, (z[3 + n :].reshape(n, 3) * held).ravel()])

    first = min(
        (
            least_squares(residuals, np.r_[np.zeros(3), np.full(n, a), np.zeros(3 * n)])
            for a in (-2.0, -0.5, 0.5, 2.0)
        ),
        key=lambda fit: fit.cost,
    )
    return lambda turns: predicted(first.x, turns)
