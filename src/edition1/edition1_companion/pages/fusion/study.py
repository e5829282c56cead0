r"""Magnets and IMUs of one robot in one filter, on synthetic readings with noise, drift and a stray field.

Three estimators with the same constant-curvature model, motion prior and rest pose: the ring's three sensors, the two
IMUs, and both. The slow errors of the IMUs (mounting, heading, tilt) are in the state, and so is a stray field where
there is one. Every run starts with one reading at rest, straight at mid elongation, which is known to all of them.

Information adds: where the model is true, the covariance of both is below that of either. How far below follows from
the filters' own covariances on readings without noise (a posterior Cramer-Rao bound to first order); the errors are
counted on readings with noise.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
from jaxtyping import Float
from scipy.spatial.transform import Rotation
from torch import Tensor

from edition1.errors import require
from edition1.estimation.drift_filter import Drift, DriftFilter
from edition1.estimation.kalman_filter import IteratedKalmanFilter
from edition1.kinematics.mounts import magnet_mounts
from edition1.kinematics.paper_robots import Dimensions
from edition1.sensing.magnetic import EARTH_MT
from edition1.sensing.stacked import StackedSensing
from edition1_companion.pages.fusion.models import Imus, Magnets, ring_model, rotation_vector
from edition1_companion.twins.calibrated_robots import VELOCITY_SHARE, box, start
from edition1_companion.twins.imu_errors import ornstein_uhlenbeck, read_imus
from edition1_companion.twins.segment_motion import ROBOT, Motion
from edition1_companion.twins.segment_robot import IMU_ERRORS, MAGNET_NOISE_MT, MID_ELONGATION_M, RING

STEPS, RATE_HZ = 100, 10.0
ERRORS = replace(IMU_ERRORS, rate_hz=RATE_HZ, latency_s=0.0, skew_s=0.0, repeats=0.0)
"""Of the IMUs: their angles as they are; read together with the magnets, with time stamps that are right."""
IMU_NOISE_RAD = 1e-3
"""White noise of a rotation vector about each axis [rad]; assumed. That of the rounding is 5e-5."""
STRAY_TIME_S = 10.0
METHODS = ("magnets", "IMUs", "both")
ITERATIONS = 4


@dataclass(frozen=True)
class Surroundings:
    """What the magnetic readings suffer from.

    Parameters
    ----------
    name
        In tables.
    noise_mt
        White noise of a reading [mT].
    stray_mt
        Field in the base frame that wanders, 0 for none: standard deviation along each axis [mT]; its correlation
        time is ``STRAY_TIME_S``.
    """

    name: str
    noise_mt: float
    stray_mt: float = 0.0


SETTINGS = (
    Surroundings("noise of the sensors", MAGNET_NOISE_MT),
    Surroundings("7 times the noise", 7 * MAGNET_NOISE_MT),
    Surroundings("stray field", MAGNET_NOISE_MT, EARTH_MT / math.sqrt(3)),
)
"""The stray field is as strong as that of the Earth, as if the base turned; it is assumed."""


@dataclass(frozen=True)
class Record:
    """Readings of motions: time first, the reading at rest before them; then motions, then draws.

    The last draw is without noise, drift and stray field.
    """

    magnets: Float[Tensor, "t m draws 3"]
    turns: Float[Tensor, "t m draws 3"]


def record(motions: Sequence[Motion], seeds: Sequence[int], setting: Surroundings) -> Record:
    """Simulate readings: fields by magpylib at the true poses, IMUs by their error model.

    Parameters
    ----------
    motions
        Of ``STEPS`` steps or fewer, at ``RATE_HZ``.
    seeds
        One for each draw.
    setting
        Errors of the magnetic readings.

    Raises
    ------
    InputError
        If there is no seed.
    """
    require(seeds, "draws", "record", "at least 1", 0)
    magnets, turns = [], []
    for place, motion in enumerate(motions):
        field, axes, tip = _clean(motion)
        u, v = [], []
        for seed in seeds:
            rng = np.random.default_rng([seed, place])
            noise = setting.noise_mt * rng.standard_normal(field.shape)
            shape = (len(field), 3)
            stray = ornstein_uhlenbeck(shape, 1 / RATE_HZ, std=setting.stray_mt, time_s=STRAY_TIME_S, rng=rng)
            u.append(field + np.einsum("tsx,tx->ts", axes, stray) + noise)
            v.append(_turns(tip, int(rng.integers(2**31))) + IMU_NOISE_RAD * rng.standard_normal(shape))
        magnets.append(np.stack([*u, field], axis=1))
        turns.append(np.stack([*v, Rotation.from_matrix(tip).as_rotvec()], axis=1))
    return Record(*(torch.from_numpy(np.stack(x, axis=1)) for x in (magnets, turns)))


def _clean(motion: Motion) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Readings without errors, directions of the sensors and orientations of the tip; at rest first."""
    rest = ROBOT.mount_poses(
        start(1), magnet_mounts([0, 0], [Dimensions.MAGNET_AXIAL_M, Dimensions.LENGTH_M])
    )
    ring = torch.cat([rest[None, 0], motion.at(Dimensions.MAGNET_AXIAL_M)])
    tip = torch.cat([rest[None, 1], motion.at(Dimensions.LENGTH_M)])
    sensors = tip.unsqueeze(1) @ ROBOT.sensors.local
    R = ring[:, None, :3, :3]
    offset = sensors[..., :3, 3] - ring[:, None, :3, 3]
    flux = torch.from_numpy(RING.field((R.mT @ offset.unsqueeze(-1)).squeeze(-1).numpy()))
    axes = sensors[..., :3, 2]
    field = ((R @ flux.unsqueeze(-1)).squeeze(-1) * axes).sum(-1)
    return field.numpy(), axes.numpy(), tip[:, :3, :3].numpy()


def _turns(tip: np.ndarray, seed: int) -> np.ndarray:
    """Measured rotation vectors [rad] of the tip's IMU seen from that of the base, which stays upright."""
    quaternions = Rotation.from_matrix(tip).as_quat()

    def orientations_at(times: np.ndarray) -> np.ndarray:
        own = quaternions[np.rint(times * RATE_HZ).astype(int)]
        return np.stack([np.broadcast_to([0.0, 0.0, 0.0, 1.0], own.shape), own], axis=1)

    stop = (len(tip) - 1) / RATE_HZ
    read = read_imus(orientations_at, start_s=0.0, stop_s=stop, errors=ERRORS, seed=seed).orientations
    base, top = (Rotation.from_quat(read[:, k]) for k in (0, 1))
    return rotation_vector(torch.from_numpy((base.inv() * top).as_matrix())).numpy()


def imu_drift() -> Drift:
    """Nine slow errors of the relative orientation: constant and wandering on the left, mounting on the right."""
    two, tilt, heading = math.sqrt(2), ERRORS.tilt_static_rad, ERRORS.heading_offset_rad
    mounting = ERRORS.mounting_rad
    constant = [math.hypot(two * tilt, mounting)] * 2 + [math.hypot(two * heading, mounting)]
    wander = [two * ERRORS.tilt_dynamic_rad] * 2 + [two * ERRORS.heading_wander_rad]
    times = [math.inf] * 3 + [ERRORS.tilt_time_s] * 2 + [ERRORS.heading_time_s] + [math.inf] * 3
    std = torch.tensor(constant + wander + [mounting] * 3, dtype=torch.float64)
    return Drift(std, torch.tensor(times, dtype=torch.float64))


@dataclass(frozen=True)
class Tracked:
    """Estimates of one method: time (without the rest), motions, draws.

    The covariance is of all coordinates that the method estimates: the IMUs do not see the elongation, which is
    held in the middle.
    """

    q: Float[Tensor, "t m draws 3"]
    covariance: Float[Tensor, "t m draws n n"]


def estimates(
    method: str, recorded: Record, setting: Surroundings, *, share: float, shape_mt: float = 0.0
) -> Tracked:
    """Run one method over a record.

    Parameters
    ----------
    method
        One of ``METHODS``.
    recorded, setting
        Readings and their errors, which the filter knows.
    share
        Process noise, in widths of the box per s^1.5.
    shape_mt
        Noise [mT] that the filter adds to that of the magnetic readings, for a shape that is not the model's.
    """
    n = 2 if method == "IMUs" else 3
    low, high = (bound[:n] for bound in box(1))
    moving = (low, high, share * (high - low), VELOCITY_SHARE * (high - low))
    noise_mt, stray = math.hypot(setting.noise_mt, shape_mt), setting.stray_mt > 0
    magnets, imus = (
        (Magnets(stray), noise_mt, recorded.magnets),
        (Imus(n == 2), IMU_NOISE_RAD, recorded.turns),
    )
    if method == "magnets" and not stray:
        kalman = IteratedKalmanFilter(ring_model(), *moving, noise_mt=noise_mt, iterations=ITERATIONS)
        return _tracked(kalman, recorded.magnets)
    parts = {"magnets": [magnets], "IMUs": [imus], "both": [magnets, imus]}[method]
    drifts = [imu_drift()] if method != "magnets" else []
    if stray and method != "IMUs":
        size = torch.full((3,), setting.stray_mt, dtype=torch.float64)
        drifts.append(Drift(size, torch.full_like(size, STRAY_TIME_S)))
    models, noises, readings = zip(*parts, strict=True)
    stacked = StackedSensing(models, noises)
    drift = Drift(torch.cat([d.std for d in drifts]), torch.cat([d.time_s for d in drifts]))
    return _tracked(
        DriftFilter(stacked, *moving, drift, iterations=ITERATIONS), stacked.scaled(list(readings))
    )


def _tracked(method: IteratedKalmanFilter | DriftFilter, u: Tensor) -> Tracked:
    """Calibrate on the reading at rest where there is something to calibrate, then follow."""
    n = len(method.lower)
    q0 = start(1)[:n].expand(*u.shape[1:-1], n)
    state = method.init(q0)
    if isinstance(method, DriftFilter):
        state, _ = method.step(state, u[0], 0.0, known=q0)
        state = method.released(state, q0)
    q, covariance = [], []
    for k in range(1, len(u)):
        state, estimate = method.step(state, u[k], k / RATE_HZ)
        q.append(torch.nn.functional.pad(estimate.q, (0, 3 - n), value=MID_ELONGATION_M))
        covariance.append(estimate.covariance)
    return Tracked(torch.stack(q), torch.stack(covariance))
