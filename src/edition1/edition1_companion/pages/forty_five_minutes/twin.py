"""A robot with magnets, Hall sensors and IMUs that drift for 45 minutes (synthetic).

The robot is that of Baaij et al. 2023 with three segments: a ring in the middle of each and three single-axis sensors
at its tip; an IMU sits at each tip as well. Its base is clamped upright, in a constant Earth field. At the start all
is as calibrated; from then on it drifts. Fields come from magpylib at the true poses.

All sizes were fixed before any estimator that calibrates itself saw a reading. Those with a source are as there. The
wander of the Hall sensors' offsets has none that fits every sensor; it was set so that a plain
fusion, which takes the calibration of the start for true, ends between 2 and 4 % of the length on twins that are not
judged: it errs by 1.8, 4.8, 4.2, 2.5 and 3.0 % over the last 15 minutes of those of the seeds 100 to 104, 3.0 % in the
median. No other value was tried.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import magpylib as magpy
import numpy as np
import torch
from jaxtyping import Float
from scipy.spatial.transform import Rotation
from torch import Tensor

from edition1.errors import bad_input
from edition1.kinematics.mounts import magnet_mounts
from edition1.kinematics.paper_robots import Dimensions, pcc_robot
from edition1.sensing.magnetic import EARTH_MT
from edition1.sensing.magnets import ring
from edition1_companion.twins.imu_errors import ImuErrors, ornstein_uhlenbeck

ROBOT = pcc_robot(3)
IMUS = magnet_mounts(range(3), Dimensions.LENGTH_M)
RING = ring("released")
EARTH = torch.tensor([EARTH_MT, 0.0, 0.0], dtype=torch.float64)
"""Field in the base frame [mT]; direction assumed."""
RATE_HZ, MINUTES = 4.0, 45.0
NOISE_MT, IMU_NOISE_RAD = 7.1e-4, 1e-3
"""White noise of a Hall sensor (the larger of Baaij et al. 2023, section 5.2), and of an IMU (assumed)."""
BENDING_M, ELONGATION_M = 0.015, 2.75e-3
"""Largest bending coordinate, and mean and amplitude of the elongation."""
PERIODS_S = (4.0, 40.0)
"""Shortest and longest period of the motion; assumed."""


@dataclass(frozen=True)
class Sizes:
    """How much drifts; what is marked "assumed" has no source.

    Parameters
    ----------
    warming_k
        All magnets warm up evenly by this [K]; assumed.
    remanence_per_k
        Temperature coefficient of the remanence of NdFeB [1/K]: -0.09 to -0.12 % for sintered grades, -0.11 % for
        those of class H (e-magnetsuk.com, temperature ratings; advancedmagnets.com).
    offset_mt
        Standard deviation of a sensor's offset at the end of its random walk [mT]: see above. Less than data sheets
        of plain Hall sensors allow over 10 K (Allegro A1302: 0.3 V at 13 mV/mT over its whole range).
    gain
        The same of its relative gain; assumed.
    heading_rad
        The same of the heading of an IMU without a compass [rad], beside magnets of no use: 10 degrees in an hour
        (log of a BNO055, community.bosch-sensortec.com, "BNO055 Heading Drifts"), by random walk 8.7 in 45 minutes.
    tilt_rad, tilt_time_s
        Error of an IMU's vertical that lasts [rad], and its correlation time [s]; assumed.
    iron_a_m2, iron_m, iron_s
        Moment of a magnetised steel tool [A m^2], its distance from the axis of the robot [m] at the height of the
        first segment, and how long it stays [s]; assumed.
    """

    warming_k: float = 10.0
    remanence_per_k: float = -0.0011
    offset_mt: float = 0.01
    gain: float = 0.001
    heading_rad: float = float(np.radians(10.0 * np.sqrt(0.75)))
    tilt_rad: float = float(np.radians(0.2))
    tilt_time_s: float = 1200.0
    iron_a_m2: float = 1.0
    iron_m: float = 0.13
    iron_s: float = 60.0


FAST_TILT = ImuErrors().tilt_dynamic_rad, ImuErrors().tilt_time_s
"""Error of an IMU's vertical while it moves: standard deviation [rad] and correlation time [s]; assumed there."""


@dataclass(frozen=True)
class Twin:
    """A run of 45 minutes.

    Parameters
    ----------
    time_s
        Of each step.
    q
        Truth [m].
    hall_mt
        Readings of the Hall sensors [mT].
    imus
        Readings of the IMUs: rotation vectors [rad] from each to the base.
    errors
        True errors at each step, by the kinds of :class:`~edition1.estimation.wander.Wander` and in their units: one
        column for each magnet, Hall sensor or IMU, two for a tilt, of which what lasts. Known at the start.
    iron_s
        When the iron begins to come and when it is gone [s].
    """

    time_s: Float[np.ndarray, " t"]
    q: Float[Tensor, "t n_q"]
    hall_mt: Float[Tensor, "t s"]
    imus: Float[Tensor, "t imus 3"]
    errors: Mapping[str, Float[np.ndarray, "t *parts"]]
    iron_s: tuple[float, float]


def draw_twin(seed: int, *, minutes: float = MINUTES, sizes: Sizes | None = None) -> Twin:
    """Draw the motion, the drift and the readings of a twin.

    Parameters
    ----------
    seed
        Of all that is random.
    minutes
        Of the run; a shorter one drifts as the beginning of a long one does, and iron comes in its middle third.
    sizes
        Of the drift.

    Raises
    ------
    InputError
        If the run is shorter than six minutes.
    """
    if not minutes >= 6:
        raise bad_input("minutes", "draw_twin", "at least 6", minutes)
    sizes = sizes or Sizes()
    rngs = [np.random.default_rng([45, seed, k]) for k in range(5)]
    time = np.arange(round(60 * minutes * RATE_HZ)) / RATE_HZ
    q = torch.from_numpy(_motion(time, rngs[0]))
    errors = _drift(time, sizes, rngs[1])
    poses = ROBOT.mount_poses(q, ROBOT.magnets.joined(ROBOT.sensors).joined(IMUS))
    magnets, sensors, imus = poses.split([len(ROBOT.magnets), len(ROBOT.sensors), len(IMUS)], dim=1)
    flux = _flux(magnets, sensors, 1 + errors["moment"]) + EARTH.numpy()
    iron, when = _iron(time, sensors[..., :3, 3].numpy(), sizes, rngs[2])
    along = (sensors[..., :3, 2].numpy() * (flux + iron)).sum(-1)
    hall = (1 + errors["gain"]) * along + errors["offset"] + NOISE_MT * rngs[3].standard_normal(along.shape)
    return Twin(time, q, torch.from_numpy(hall), _orientations(imus, errors, rngs[4]), errors, when)


def _motion(time: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Sums of sines with random frequencies and phases, kept within bounds: smooth at any rate."""
    waves, slow, fast = 12, 1 / PERIODS_S[1], 1 / PERIODS_S[0]
    frequency, phase = (
        rng.uniform(slow, fast, (ROBOT.n_q, waves)),
        rng.uniform(0, 2 * np.pi, (ROBOT.n_q, waves)),
    )
    x = np.zeros((len(time), ROBOT.n_q))
    for k in range(waves):
        x += np.sqrt(2 / waves) * np.sin(2 * np.pi * np.outer(time, frequency[:, k]) + phase[:, k])
    middle = np.tile([0.0, 0.0, ELONGATION_M], 3)
    return middle + np.tile([BENDING_M, BENDING_M, ELONGATION_M], 3) * np.tanh(x)


def _drift(time: np.ndarray, sizes: Sizes, rng: np.random.Generator) -> dict[str, np.ndarray]:
    steps, n_s, n_i = len(time), len(ROBOT.sensors), len(IMUS)
    share = time[:, None] / (60 * MINUTES)

    def walk(n: int, end: float) -> np.ndarray:
        steps_taken = rng.standard_normal((steps, n)) * end / np.sqrt(60 * MINUTES * RATE_HZ)
        return np.cumsum(steps_taken, axis=0) - steps_taken[0]

    tilt = ornstein_uhlenbeck(
        (steps, n_i, 2), 1 / RATE_HZ, std=sizes.tilt_rad, time_s=sizes.tilt_time_s, rng=rng
    )
    warmed = sizes.remanence_per_k * sizes.warming_k * share * np.ones(len(ROBOT.magnets))
    return {
        "moment": (1 + warmed) - 1,  # as the factor 1 + error holds it
        "gain": (1 + walk(n_s, sizes.gain)) - 1,
        "offset": walk(n_s, sizes.offset_mt),
        "heading": walk(n_i, sizes.heading_rad),
        "tilt": tilt - tilt[0],
    }


def _flux(magnets: Tensor, sensors: Tensor, moments: np.ndarray) -> np.ndarray:
    """Flux density [mT] of all magnets at the sensors, in the base frame."""
    R = magnets[:, None, :, :3, :3]
    offset = sensors[:, :, None, :3, 3] - magnets[:, None, :, :3, 3]
    B = torch.from_numpy(RING.field((R.mT @ offset.unsqueeze(-1)).squeeze(-1).numpy()))
    return ((R @ B.unsqueeze(-1)).squeeze(-1).numpy() * moments[:, None, :, None]).sum(2)


def _iron(
    time: np.ndarray, sensors: np.ndarray, sizes: Sizes, rng: np.random.Generator
) -> tuple[np.ndarray, tuple[float, float]]:
    """Flux density [mT] of a tool that comes within five seconds from a metre away, stays and goes; and when."""
    start = rng.uniform(
        time[-1] / 3 if time[-1] < 1200 else 300.0, time[-1] * (2 / 3 if time[-1] < 1200 else 0.95)
    )
    azimuth, direction = rng.uniform(0, 2 * np.pi), rng.standard_normal(3)
    since = time - start
    near = np.clip(np.minimum(since, sizes.iron_s - since) / 5.0, 0.0, 1.0)
    near = near * near * (3 - 2 * near)
    from_axis = sizes.iron_m + (1.0 - sizes.iron_m) * (1 - near)
    place = np.stack([from_axis * np.cos(azimuth), from_axis * np.sin(azimuth), 0 * near + 0.08], axis=-1)
    here = near > 0
    tool = magpy.misc.Dipole(moment=sizes.iron_a_m2 * direction / np.linalg.norm(direction))
    flux = np.zeros_like(sensors)
    flux[here] = 1e3 * tool.getB((sensors[here] - place[here, None]).reshape(-1, 3)).reshape(
        -1, len(ROBOT.sensors), 3
    )
    return flux, (start, start + sizes.iron_s)


def _orientations(imus: Tensor, errors: Mapping[str, np.ndarray], rng: np.random.Generator) -> Tensor:
    """Rotation vectors that the IMUs read: the true orientation, then tilt, then heading about the vertical."""
    shape = tuple(imus.shape[:2])
    fast = ornstein_uhlenbeck((*shape, 2), 1 / RATE_HZ, std=FAST_TILT[0], time_s=FAST_TILT[1], rng=rng)
    tilt = np.concatenate([errors["tilt"] + fast, np.zeros((*shape, 1))], axis=-1)
    noise = IMU_NOISE_RAD * rng.standard_normal((*shape, 3))
    heading = errors["heading"][..., None] * np.array([0.0, 0.0, 1.0])
    turns = [Rotation.from_rotvec(x.reshape(-1, 3)) for x in (noise, heading, tilt)]
    true = Rotation.from_matrix(imus[..., :3, :3].reshape(-1, 3, 3).numpy())
    return torch.from_numpy((turns[0] * turns[1] * turns[2] * true).as_rotvec().reshape(*shape, 3))
