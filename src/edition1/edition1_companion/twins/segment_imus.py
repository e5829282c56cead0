"""What the IMUs at the ends of the one robot read, for several robots at once (synthetic).

The model is that of :mod:`edition1_companion.twins.imu_errors`, with the constant errors drawn elsewhere: mounting, then
the true orientation, then the errors of the vertical and of the heading. Repeated readings and changes of sign are
left out: the first are rare, and no estimate depends on the second.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation
from torch import Tensor

from edition1.kinematics.paper_robots import Dimensions
from edition1_companion.twins.imu_errors import ImuErrors, continuous_signs, ornstein_uhlenbeck
from edition1_companion.twins.segment_motion import Motion


def streamed(
    motion: Motion,
    turns: Float[np.ndarray, "two draws imus 4"],
    errors: ImuErrors,
    rngs: Sequence[np.random.Generator],
    *,
    size: float,
) -> Float[np.ndarray, "t draws imus 4"]:
    """Latest readings at every step of a motion: the IMUs are read in turn, at their own rate and with their latency.

    Parameters
    ----------
    motion
        Of the segment.
    turns
        Quaternions XYZW: of the mounting, and of the constant errors of the world.
    errors
        Rate, latency, and errors that vary.
    rngs
        One generator per draw.
    size
        Factor on the errors that vary; at 0 nothing is rounded either.
    """
    time = motion.time_s.numpy()
    start = -2 / errors.rate_hz - errors.latency_s
    skew = errors.skew_s * np.arange(2)
    rounds = int((time[-1] - start) * errors.rate_hz) + 1
    seen = start + np.arange(rounds)[:, None] / errors.rate_hz + skew
    ends = np.stack([as_quaternions(motion.at(arc)) for arc in (0.0, Dimensions.LENGTH_M)], axis=1)
    ends = continuous_signs(ends, axis=0)
    true = np.stack(
        [
            np.stack([np.interp(seen[:, imu], time, ends[:, imu, c]) for c in range(4)], axis=-1)
            for imu in range(2)
        ],
        axis=1,
    )
    read = imu_readings(true[:, None], turns, errors, rngs, interval_s=1 / errors.rate_hz, size=size)
    latest = np.floor((time[:, None] - errors.latency_s - skew - start) * errors.rate_hz + 1e-9).astype(int)
    return np.stack([read[latest[:, imu], :, imu] for imu in range(2)], axis=-2)


def imu_readings(
    true: Float[np.ndarray, "rounds some imus 4"],
    turns: Float[np.ndarray, "two draws imus 4"],
    errors: ImuErrors,
    rngs: Sequence[np.random.Generator],
    *,
    interval_s: float,
    size: float,
) -> Float[np.ndarray, "rounds draws imus 4"]:
    """Readings of true orientations at even intervals.

    Parameters
    ----------
    true
        Quaternions XYZW, body to base; one for all draws, or one for each.
    turns, errors, rngs, size
        As for :func:`streamed`.
    interval_s
        Time between the rounds [s].
    """
    rounds, draws = len(true), len(rngs)
    heading, tilt = (
        np.stack(
            [
                ornstein_uhlenbeck((rounds, 2, n), interval_s, std=size * std, time_s=tau, rng=rng)
                for rng in rngs
            ],
            axis=1,
        )
        for n, std, tau in (
            (1, errors.heading_wander_rad, errors.heading_time_s),
            (2, errors.tilt_dynamic_rad, errors.tilt_time_s),
        )
    )
    shape = (rounds, draws, 2, 4)
    mounting, world = (Rotation.from_quat(np.broadcast_to(q, shape).reshape(-1, 4)) for q in turns)
    turn = Rotation.from_rotvec(np.concatenate([tilt, heading], axis=-1).reshape(-1, 3))
    straight = Rotation.from_quat(np.broadcast_to(true, shape).reshape(-1, 4))
    q = (turn * world * straight * mounting).as_quat().reshape(shape)
    if errors.quantum > 0 and size > 0:
        q = np.round(q / errors.quantum) * errors.quantum
    return q / np.linalg.norm(q, axis=-1, keepdims=True)


def as_quaternions(T: Float[Tensor, "*batch n n"]) -> Float[np.ndarray, "*batch 4"]:
    """Quaternions XYZW of poses or rotations."""
    R = T[..., :3, :3].numpy()
    return Rotation.from_matrix(R.reshape(-1, 3, 3)).as_quat().reshape(*R.shape[:-2], 4)
