r"""Training sets for sensor models: random configurations and sensor placements (Baaij et al. 2023, 3.2 and 4.2)."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from edition1.errors import require
from edition1.kinematics.paper_robots import Dimensions, affine_robot, pcc_robot
from edition1.kinematics.robot import Robot
from edition1.sensing.magnetic import EARTH_MT, readings
from edition1.sensing.magnets import Cube, Ring, ring

BENDING_M = 22e-3 * math.radians(54)
"""Bound of ``delta_x`` and ``delta_y`` [m]: a bending of 54 degrees, 20.73 mm."""
ELONGATION_M = {"released": 6.6e-3, "published": 5.5e-3}
"""Upper bound of the elongation [m]: in the released code, and in section 3.2."""
_TILT_RAD = math.radians(20)
RADIAL_M = (26e-3 / 3, 52e-3 / 3)
"""Bounds of ``d_s,r`` [m]: two and four thirds of 13 mm (printed 8.7 and 17.3 mm)."""


CURVATURE_RAD = (1.2 * math.pi / 4, 1.2 * math.pi)
"""Bounds of ``|kappa_0|`` and ``|kappa_1|`` [rad]: 0.942 and 3.770 (section 4.2), on both sides of zero as in the
released code."""


@dataclass(frozen=True)
class TrainingSet:
    """Random robots in random configurations, and what their sensors read.

    Parameters
    ----------
    robot
        Batch of robots: one placement of the sensors for every sample.
    q
        Configurations [m], those of affine curvature [rad, rad, rad, m].
    earth_axis
        Direction of the Earth field of every sample; none without Earth field.
    u
        Readings [mT].
    """

    robot: Robot
    q: Float[Tensor, "n n_q"]
    earth_axis: Float[Tensor, "n 3"] | None
    u: Float[Tensor, "n s"]


@dataclass(frozen=True)
class Draws:
    """What is random in a training set of section 3.2.

    Parameters
    ----------
    q
        Configurations [m].
    azimuth, tilt, radial
        Azimuth offset [rad], tilt [rad] and radius [m] of the sensors of each sample.
    earth_axis
        Direction of the Earth field; none without Earth field.
    """

    q: Float[Tensor, "n n_q"]
    azimuth: Float[Tensor, " n"]
    tilt: Float[Tensor, " n"]
    radial: Float[Tensor, " n"]
    earth_axis: Float[Tensor, "n 3"] | None


def draw(
    seed: int, samples: int, n_segments: int, sensors_per_segment: int, *, earth: bool, elongation_m: float
) -> Draws:
    """Draw configurations and placements. Parameters are those of :func:`training_set`."""
    uniform = _uniform(seed)
    bending = uniform(-BENDING_M, BENDING_M, samples, n_segments, 2)
    elongation = uniform(0.0, elongation_m, samples, n_segments, 1)
    q = torch.cat([bending, elongation], dim=-1).flatten(-2)
    azimuth = uniform(0.0, 2 * math.pi / sensors_per_segment, samples)
    if not earth:
        tilt, radial = uniform(-_TILT_RAD, _TILT_RAD, samples), uniform(*RADIAL_M, samples)
        return Draws(q, azimuth, tilt, radial, None)
    axis = uniform(-1.0, 1.0, samples, 3)
    axis /= torch.linalg.vector_norm(axis, dim=-1, keepdim=True)
    return Draws(
        q, azimuth, torch.zeros_like(azimuth), torch.full_like(azimuth, Dimensions.SENSOR_RADIAL_M), axis
    )


def training_set(
    n_segments: int,
    *,
    seed: int,
    samples: int = 120_000,
    magnet: Ring | Cube | None = None,
    earth: bool = False,
    elongation_m: float = ELONGATION_M["released"],
    sensors_per_segment: int = 3,
) -> TrainingSet:
    """Training set of section 3.2, generated in seconds and never stored.

    Each sample draws ``delta_x`` and ``delta_y`` within 20.73 mm and the elongation within ``elongation_m`` for
    every segment, and one azimuth offset, one tilt (20 degrees) and one radius (8.67 to 17.33 mm) for all its
    sensors. With an Earth field only the azimuth offset and the direction of the field are random, as in the
    released training sets.

    Parameters
    ----------
    n_segments
        Number of segments.
    seed
        Seed of all draws: the same seed gives the same bits.
    samples
        Number of samples.
    magnet
        Magnet in every segment; the ring ``"released"`` when not given.
    earth
        Add an Earth field of 0.065 mT in a random direction.
    elongation_m
        Upper bound of the elongation: see :data:`ELONGATION_M`.
    sensors_per_segment
        Sensors in each tip plane.

    Raises
    ------
    InputError
        If ``samples`` is not positive.
    """
    require(samples >= 1, "samples", "training_set", "positive", samples)
    drawn = draw(seed, samples, n_segments, sensors_per_segment, earth=earth, elongation_m=elongation_m)
    placed = {"tilt": drawn.tilt, "radial": drawn.radial, "azimuth_offset": drawn.azimuth}
    robot = pcc_robot(n_segments, sensors_per_segment, **placed)
    earth_mt = None if drawn.earth_axis is None else EARTH_MT * drawn.earth_axis
    u = readings(robot, drawn.q, magnet or ring("released"), earth_mt=earth_mt)
    return TrainingSet(robot, drawn.q, drawn.earth_axis, u)


def affine_training_set(
    *, seed: int, samples: int = 120_000, magnet: Ring | Cube | None = None
) -> TrainingSet:
    r"""Training set of section 4.2: random shapes of the affine robot, its sensors turned about it at random.

    As in the released code the curvatures are drawn on both sides of zero, so the set holds each shape under both of
    its configurations; the text draws them from zero.

    Parameters
    ----------
    seed
        Seed of all draws: the same seed gives the same bits.
    samples
        Number of samples.
    magnet
        Both magnets; the ring ``"released"`` when not given.

    Raises
    ------
    InputError
        If ``samples`` is not positive.
    """
    require(samples >= 1, "samples", "affine_training_set", "positive", samples)
    uniform = _uniform(seed)
    kappa = [uniform(-bound, bound, samples) for bound in CURVATURE_RAD]
    phi = uniform(0.0, 2 * math.pi, samples)
    dL = uniform(0.0, ELONGATION_M["released"], samples)
    q = torch.stack([*kappa, phi, dL], dim=-1)
    robot = affine_robot(azimuth_offset=uniform(0.0, 2 * math.pi / 9, samples))
    return TrainingSet(robot, q, None, readings(robot, q, magnet or ring("released")))


def _uniform(seed: int) -> Callable[..., Tensor]:
    generator = torch.Generator().manual_seed(seed)

    def uniform(low: float, high: float, *shape: int) -> Tensor:
        return low + (high - low) * torch.rand(*shape, generator=generator, dtype=torch.float64)

    return uniform
