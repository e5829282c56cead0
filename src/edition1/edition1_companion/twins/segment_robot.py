"""One segment that carries the sensors of all three papers, and what they read of it (synthetic).

The segment is that of Baaij et al. 2023, 110 mm long. It carries their ring and three single-axis sensors; the cube
and the three-axis Hall sensor of Mitchell et al. 2021, 15 mm apart along the body; and an IMU at either end, as in
Martin et al. 2022. Frames have z along the body; the base frame is that of the clamp, its z axis vertical.

Fields come from magpylib at the true poses, never from the model of an estimator.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float
from scipy.spatial.transform import Rotation
from torch import Tensor

from edition1 import se3
from edition1.errors import require
from edition1.kinematics.paper_robots import Dimensions
from edition1.sensing.magnets import B444B, Cube, Ring, ring
from edition1.sensing.placement import Tolerances, placed
from edition1_companion.twins.calibration_session import L_MAX
from edition1_companion.twins.imu_errors import ImuErrors
from edition1_companion.twins.segment_imus import as_quaternions, imu_readings, streamed
from edition1_companion.twins.segment_motion import ROBOT, Motion
from edition1_companion.twins.training_set import BENDING_M, ELONGATION_M

RING = ring("released")
MID_ELONGATION_M = 2.75e-3
APART_M = 0.015
"""From the Hall sensor to the cube along the body (Mitchell et al. 2021, section III)."""
PLACES_M = (0.0, 0.0475)
"""Where the Hall sensor may sit [m]: at the base, or so that the cube and it are on either side of the middle."""
MAGNET_NOISE_MT = 7.1e-4
"""Of the ring's sensors: the larger of the two levels of Baaij et al. 2023, section 5.2."""
HALL_NOISE_MT, HALL_STEP_MT = 0.025, 0.01
"""Noise of a component and resolution of the Hall sensor, measured in the recordings of Mitchell et al. 2021."""
IMU_ERRORS = ImuErrors()
POSE_POSITION_M, POSE_ROTATION_RAD = 0.2e-3, math.radians(0.2)
"""Noise of a measured pose of the tip: standard deviation along and about each axis."""


@dataclass(frozen=True)
class Parts:
    """Where the parts really are and what they are worth, for several robots ("draws").

    Rigid motions ``T_backbone_part``; the sensors' gains and the strengths of the magnets are relative. ``turns``
    are quaternions XYZW: of the mounting (sensor to body) and of the constant error of the world, per IMU.
    """

    ring: Float[Tensor, "draws 4 4"]
    ring_sensors: Float[Tensor, "draws s 4 4"]
    ring_gain: Float[Tensor, "draws s"]
    cube: Float[Tensor, "draws 4 4"]
    hall: Float[Tensor, "draws 4 4"]
    hall_gain: Float[Tensor, "draws 3"]
    strength: Float[Tensor, "draws 2"]
    turns: Float[np.ndarray, "two draws imus 4"]
    errors: ImuErrors


def draw_parts(draws: int, *, seed: int = 0, as_drawn: bool = False) -> Parts:
    """Draw robots; every draw has a generator of its own.

    Tolerances are normal with the standard deviations of :class:`~edition1.sensing.placement.Tolerances`, for the ring
    and its sensors and likewise for cube and Hall sensor (whose two tilts have the tolerance of a sensor's tilt, and
    its turn about the body that of a sensor's azimuth); that of the moments is the strength of each magnet as a
    whole. Mounting, heading and static tilt of the IMUs are those of their errors.

    Parameters
    ----------
    draws
        Robots.
    seed
        Of all draws.
    as_drawn
        No tolerances, and IMUs without constant errors.

    Raises
    ------
    InputError
        If there is no draw.
    """
    require(draws >= 1, "draws", "draw_parts", "at least 1", draws)
    size = 0.0 if as_drawn else 1.0
    normal = np.stack([_generator(seed, draw, 0).standard_normal(60) for draw in range(draws)])
    x = torch.from_numpy(size * normal)
    limits, moments = Tolerances(), torch.from_numpy(RING.multipoles(L_MAX))
    scale = limits.of_parameters(ROBOT, 0)
    own = placed(ROBOT, moments[:0], x[:, : len(scale)] * scale)
    rest = x[:, 20:]
    tilt = limits.magnet_tilt_rad * rest[:, 3:5]
    cube = se3.pose(
        se3.rotation_x(tilt[:, 0]) @ se3.rotation_y(tilt[:, 1]), limits.magnet_position_m * rest[:, :3]
    )
    a, b = (limits.sensor_tilt_rad * rest[:, 5:7]).unbind(-1)
    turned = se3.rotation_z(limits.sensor_azimuth_rad * rest[:, 7]) @ se3.rotation_x(a) @ se3.rotation_y(b)
    errors = IMU_ERRORS.scaled(size)
    mounting = errors.mounting_rad * normal[:, 40:46].reshape(-1, 2, 3)
    world = np.concatenate(
        [
            errors.tilt_static_rad * normal[:, 46:50].reshape(-1, 2, 2),
            errors.heading_offset_rad * normal[:, 50:52].reshape(-1, 2, 1),
        ],
        axis=-1,
    )
    return Parts(
        ring=own.magnets.local[:, 0],
        ring_sensors=own.sensors.local,
        ring_gain=own.gain,
        cube=cube,
        hall=se3.pose(turned, torch.zeros(draws, 3, dtype=x.dtype)),
        hall_gain=1 + limits.sensor_gain * rest[:, 8:11],
        strength=1 + limits.moments * rest[:, 11:13],
        turns=np.stack([_quaternions(mounting), _quaternions(world)]),
        errors=IMU_ERRORS,
    )


@dataclass(frozen=True)
class Readings:
    """What the sensors read, step by step.

    Parameters
    ----------
    magnets
        The ring's sensors [mT].
    hall
        The Hall sensor at each of :data:`PLACES_M` [mT], z along the body.
    imus
        Quaternions XYZW of the IMUs at base and tip, body to world; the last reading is held.
    """

    magnets: Float[Tensor, "t draws s"]
    hall: Float[Tensor, "t draws places 3"]
    imus: Float[Tensor, "t draws imus 4"]


def simulate(
    motion: Motion, parts: Parts, *, seed: int = 0, noise: bool = True, both_magnets: bool = False
) -> Readings:
    """Read all sensors along a motion; draw by draw, noise is the same for every motion.

    Parameters
    ----------
    motion
        Of the segment.
    parts
        Robots.
    seed
        Of the noise.
    noise
        Whether there is noise, and errors of the IMUs that vary. Their latency stays.
    both_magnets
        Whether the field of the cube at the base reaches the ring's sensors, and that of the ring the Hall sensor
        at the base. Elsewhere each sensor reads its own magnet alone, as on a robot that carries one of the two.
    """
    magnets, hall = _fields(lambda arc_m: motion.at(arc_m).unsqueeze(1), parts, both_magnets)
    steps, draws = magnets.shape[:2]
    normal = np.stack(
        [_generator(seed, draw, 1).standard_normal((steps, 9)) for draw in range(draws)], axis=1
    )
    rngs = [_generator(seed, draw, 2) for draw in range(draws)]
    imus = streamed(motion, parts.turns, parts.errors, rngs, size=float(noise))
    return _with_noise(magnets, hall, imus, torch.from_numpy(normal), float(noise))


def calibration_session(
    parts: Parts, *, poses: int = 60, seed: int = 0
) -> tuple[Float[Tensor, "draws poses 4 4"], Readings]:
    """Measured poses of the tip and readings there, of robots that are moved through random poses.

    The poses have constant curvature, within the box in which Baaij et al. 2023 train. They are a second apart, and
    measured to 0.2 mm and 0.2 degrees; IMUs have time to settle.

    Parameters
    ----------
    parts
        Robots.
    poses
        Number of poses.
    seed
        Of poses and noise.

    Raises
    ------
    InputError
        If there are fewer than three poses.
    """
    require(poses >= 3, "poses", "calibration_session", "at least 3", poses)
    draws = len(parts.ring)
    rngs = [_generator(seed, draw, 3) for draw in range(draws)]
    uniform = torch.from_numpy(np.stack([rng.random((poses, 3)) for rng in rngs], axis=1))
    high = uniform.new_tensor([BENDING_M, BENDING_M, ELONGATION_M["released"]])
    q = high * torch.where(torch.tensor([True, True, False]), 2 * uniform - 1, uniform)  # [poses, draws, 3]

    def at(arc_m: float) -> Tensor:
        return ROBOT.segments[0].pose(q, q.new_tensor(arc_m / Dimensions.LENGTH_M))

    magnets, hall = _fields(at, parts, False)
    normal = torch.from_numpy(np.stack([rng.standard_normal((poses, 15)) for rng in rngs], axis=1))
    true = np.stack([as_quaternions(at(arc)) for arc in (0.0, Dimensions.LENGTH_M)], axis=-2)
    imus = imu_readings(true, parts.turns, parts.errors, rngs, interval_s=1.0, size=1.0)
    tip, angle = at(Dimensions.LENGTH_M), POSE_ROTATION_RAD * normal[..., 9:12]
    turn = se3.rotation_x(angle[..., 0]) @ se3.rotation_y(angle[..., 1]) @ se3.rotation_z(angle[..., 2])
    measured = se3.pose(tip[..., :3, :3] @ turn, tip[..., :3, 3] + POSE_POSITION_M * normal[..., 12:15])
    return measured.transpose(0, 1), _with_noise(magnets, hall, imus, normal[..., :9], 1.0)


def _fields(at: Callable[[float], Tensor], parts: Parts, both: bool) -> tuple[Tensor, Tensor]:
    """Flux density [mT] along the ring's sensors ``[t, draws, s]``, at the Hall sensors ``[t, draws, places, 3]``."""
    T_ring = at(Dimensions.MAGNET_AXIAL_M) @ parts.ring
    T_cubes = torch.stack([at(place + APART_M) @ parts.cube for place in PLACES_M], dim=-3)
    T_hall = torch.stack([at(place) @ parts.hall for place in PLACES_M], dim=-3)
    T_tip = at(Dimensions.LENGTH_M).unsqueeze(-3) @ parts.ring_sensors
    ring_mt, cube_mt = parts.strength.unbind(-1)
    at_tip = ring_mt[:, None, None] * _flux(RING, T_ring.unsqueeze(-3), T_tip)
    at_hall = cube_mt[:, None, None] * _flux(B444B, T_cubes, T_hall)
    if both:
        at_tip = at_tip + cube_mt[:, None, None] * _flux(B444B, T_cubes[..., :1, :, :], T_tip)
        other = ring_mt[:, None, None] * _flux(RING, T_ring.unsqueeze(-3), T_hall)
        at_hall = at_hall + other * other.new_tensor([1.0, 0.0])[:, None]
    return parts.ring_gain * at_tip[..., 2], parts.hall_gain.unsqueeze(-2) * at_hall


def _flux(magnet: Ring | Cube, T_magnet: Tensor, T_sensor: Tensor) -> Tensor:
    """Flux density [mT] by magpylib in the frames of the sensors."""
    turn, offset = T_magnet[..., :3, :3], T_sensor[..., :3, 3] - T_magnet[..., :3, 3]
    local = (turn.mT @ offset.unsqueeze(-1)).squeeze(-1)
    B = torch.from_numpy(magnet.field(local.numpy())).unsqueeze(-1)
    return (T_sensor[..., :3, :3].mT @ (turn @ B)).squeeze(-1)


def _with_noise(magnets: Tensor, hall: Tensor, imus: np.ndarray, normal: Tensor, size: float) -> Readings:
    magnets = magnets + size * MAGNET_NOISE_MT * normal[..., :3]
    hall = hall + size * HALL_NOISE_MT * normal[..., 3:].unflatten(-1, (2, 3))
    if size > 0:
        hall = torch.round(hall / HALL_STEP_MT) * HALL_STEP_MT
    return Readings(magnets, hall, torch.from_numpy(imus))


def _quaternions(vectors: np.ndarray) -> np.ndarray:
    """Quaternions XYZW of rotation vectors [rad]."""
    return Rotation.from_rotvec(vectors.reshape(-1, 3)).as_quat().reshape(*vectors.shape[:-1], 4)


def _generator(seed: int, draw: int, stream: int) -> np.random.Generator:
    """Generator of one draw and one purpose: more draws leave the first ones as they are."""
    return np.random.default_rng([seed, draw, stream])
