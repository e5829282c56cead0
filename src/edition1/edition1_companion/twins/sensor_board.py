r"""The sensor board of the rig: three magnetoresistive sensors that are not where and what the drawing says.

A reading is the field of the ring and of the Earth at the sensor along its direction of sensitivity, plus what no
field of the ring explains: a smooth function of the bend (assumed; in the authors' recordings a model of the ring
with free gains on three axes leaves 5 to 12 % of the range). Then noise, drift and the converter, an ADS1115
(Texas Instruments, SBAS444): 16 bits over plus and minus 2048 mV.

Inferred: 50 mV/mT (section 5.1) is before the amplification by 100, so the sensitivity is 5000 mV/mT.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from edition1 import se3
from edition1.kinematics.mounts import Mounts
from edition1.sensing.magnets import ring
from edition1_companion.recordings.rig_robot import RIG_SENSORS, rig_earth_axis, rig_robot

LSB_MV = 2.0 * 2048.0 / 2**16
"""Step of the converter [mV]: 0.0625."""
FULL_SCALE_MV = 2048.0
"""End of the converter's range [mV]; the largest code is one step below."""
DRIFTS = ("constant", "ramp", "random walk")
"""Shapes of the drift."""
DRIFT_TIME_S = 1500.0
"""Time after which a ramp, or one standard deviation of a random walk, has reached the size of the drift [s]."""

Triple = tuple[float, float, float]


@dataclass(frozen=True)
class Board:
    """Sensors, magnet and electronics as they are.

    Parameters
    ----------
    sensitivity
        Per sensor the vector of its sensitivity in its own frame [mV/mT]; as drawn it is ``(0, 0, 5000)``.
    shift_mm
        Per sensor how far it is from its place, in its own frame.
    magnet_shift_mm, magnet_tilt_deg
        How far the magnet is from its place, and its tilt about x and y.
    earth_mt
        Flux density of the Earth field, along the direction of section 5.2.
    rest_mv
        Readings of the straight, unextended segment: the offset is trimmed.
    curvature
        Second derivatives ``xx, xy, yy`` of what no field explains, per sensor, by the bend of the tip [mV/mm²].
    ripple_mv, ripple_period_mm, ripple_azimuth_deg
        The part of it that is not quadratic: a sine of the bend in one direction, per sensor.
    noise_mv, inflated_noise_mv
        Standard deviation of the noise at rest, and of a further one in proportion to the mean pressure.
    drift_mv, drift
        Size and shape, one of :data:`DRIFTS`, of the drift; its sign and exact size are random for each sensor.
    """

    sensitivity: tuple[Triple, ...]
    shift_mm: tuple[Triple, ...]
    magnet_shift_mm: Triple
    magnet_tilt_deg: tuple[float, float]
    earth_mt: float
    rest_mv: Triple
    curvature: tuple[Triple, ...]
    ripple_mv: Triple
    ripple_period_mm: float
    ripple_azimuth_deg: Triple
    noise_mv: float
    inflated_noise_mv: float
    drift_mv: float
    drift: str


def analogue_readings(
    board: Board, q: Float[np.ndarray, "samples 3"], q_magnet: Float[np.ndarray, "samples 3"]
) -> Float[np.ndarray, "samples 3"]:
    """Readings [mV] before noise, drift and converter; the field is magpylib's.

    Parameters
    ----------
    board
        The sensors.
    q, q_magnet
        Configuration of the tip, and the one that gives the pose of the magnet [m].
    """
    sensitivity = np.array(board.sensitivity)
    rest = np.zeros((1, 3))
    change = (field(board, q, q_magnet) - field(board, rest, rest)) * sensitivity
    return np.array(board.rest_mv) + change.sum(axis=-1) + _unexplained(board, 1e3 * q[:, :2])


def field(
    board: Board, q: Float[np.ndarray, "samples 3"], q_magnet: Float[np.ndarray, "samples 3"]
) -> Float[np.ndarray, "samples 3 3"]:
    """Flux density [mT] at the sensors, each in its own frame: of the ring ``"published"`` and of the Earth."""
    robot, upright = rig_robot(), torch.eye(3, dtype=torch.float64)
    shifted = _moved(robot.sensors, se3.pose(upright, 1e-3 * _tensor(board.shift_mm)))
    T_s = robot.mount_poses(torch.from_numpy(q), shifted)
    tilt_x, tilt_y = np.radians(board.magnet_tilt_deg)
    tilted = se3.rotation_x(_tensor(tilt_x)) @ se3.rotation_y(_tensor(tilt_y))
    moved = _moved(robot.magnets, se3.pose(tilted, 1e-3 * _tensor(board.magnet_shift_mm)))
    T_m = robot.mount_poses(torch.from_numpy(q_magnet), moved)
    R_m = T_m[..., :3, :3]
    offset = (R_m.mT @ (T_s[..., :3, 3] - T_m[..., :3, 3]).unsqueeze(-1)).squeeze(-1)
    flux = torch.from_numpy(ring("published").field(offset.numpy()))
    B = (R_m @ flux.unsqueeze(-1)).squeeze(-1) + board.earth_mt * rig_earth_axis()
    return (T_s[..., :3, :3].mT @ B.unsqueeze(-1)).squeeze(-1).numpy()


def _tensor(values: Any) -> Tensor:
    return torch.tensor(values, dtype=torch.float64)


def _moved(mounts: Mounts, motion: Tensor) -> Mounts:
    return Mounts(mounts.segment, mounts.axial, mounts.local @ motion)


def _unexplained(board: Board, bend_mm: np.ndarray) -> np.ndarray:
    """Smooth function of the bend, zero with zero slope of its quadratic part where the segment is straight [mV]."""
    x, y = bend_mm[:, :1], bend_mm[:, 1:]
    xx, xy, yy = np.array(board.curvature).T
    azimuth = np.radians(board.ripple_azimuth_deg)
    along = 2.0 * np.pi / board.ripple_period_mm * (x * np.cos(azimuth) + y * np.sin(azimuth))
    return (xx * x * x + 2.0 * xy * x * y + yy * y * y) / 2.0 + np.array(board.ripple_mv) * np.sin(along)


def disturbance(
    board: Board,
    time_s: Float[np.ndarray, " samples"],
    inflation: Float[np.ndarray, " samples"],
    rng: np.random.Generator,
) -> Float[np.ndarray, "samples 3"]:
    """Noise and drift [mV] of a recording.

    Parameters
    ----------
    board
        The sensors.
    time_s
        Times of the readings [s].
    inflation
        Mean pressure over the offset pressure.
    rng
        Source of the random numbers.
    """
    shape = (len(time_s), RIG_SENSORS)
    noise = np.hypot(board.noise_mv, board.inflated_noise_mv * inflation)[:, None] * rng.standard_normal(
        shape
    )
    size, since = board.drift_mv * rng.standard_normal(RIG_SENSORS), (time_s - time_s[0])[:, None]
    if board.drift == "constant":
        return noise + size
    if board.drift == "ramp":
        return noise + size * since / DRIFT_TIME_S
    steps = rng.standard_normal(shape) * np.sqrt(np.diff(since, axis=0, prepend=0.0) / DRIFT_TIME_S)
    return noise + board.drift_mv * steps.cumsum(axis=0)


def converted(mv: Float[np.ndarray, "*shape"]) -> Float[np.ndarray, "*shape"]:
    """Readings [mV] as the converter gives them: whole steps, clipped to 0 and one step below 2048 mV.

    Examples
    --------
    >>> converted(np.array([-3.0, 1.04, 5000.0]))
    array([0.0000000e+00, 1.0625000e+00, 2.0479375e+03])
    """
    return np.clip(np.round(mv / LSB_MV) * LSB_MV, 0.0, FULL_SCALE_MV - LSB_MV)
