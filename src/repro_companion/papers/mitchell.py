"""Mitchell et al. 2021: the module with one magnet and one sensor, its simulated curves, and the filters on them."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from repro import (
    BendSensor,
    ConstantCurvature,
    Cube,
    Magnet,
    ParticleFilter,
    Robot,
    Sensor,
    simulated_readings,
)
from repro.estimators.particle import BendDisc

LENGTH = 15e-3
"""Length of the arc from sensor to magnet, section III-A [m]; 14 mm in the released simulations."""
CUBE = Cube(6.35e-3, 1320.0)
"""K&J B444B, a cube of 1/4 inch, magnetised along the arc."""
LARGEST_BEND = math.pi / 2
SENSOR_NOISE_MT = 0.025
"""Noise of the real sensor for each axis: 0.021 to 0.026 mT in the recordings at rest."""
SIGMA_MT = 0.01
"""The sigma of eq. (1) in the released code; the paper gives none."""
CURVES = ("spiral", "flower", "seagull")


# The module and the curves, section II


def robot(length: float = LENGTH) -> Robot:
    """Return the module: an arc with the cube at its end, and a sensor of three axes at its base."""
    arc = ConstantCurvature(length, radius=1.0, extensible=False)  # its coordinates are the bend vector [rad]
    return Robot([arc], [Magnet(CUBE, segment=1, at=length)], [Sensor(segment=0, at=0.0, axes=3)])


def bend_vector(angle: Any, direction: Any) -> np.ndarray:
    """Return bend vectors ``[..., 2]`` [rad]; a negative angle bends the other way."""
    return np.stack([angle * np.cos(direction), angle * np.sin(direction)], axis=-1)


def times() -> np.ndarray:
    """Return the parameter of the curves: 3,142 values from 0 to 10 pi."""
    return np.arange(0, 10 * math.pi, 0.01)


def curve(name: str) -> np.ndarray:
    """Return a curve of section II-D as bend vectors ``[t, 2]`` [rad], eqs (5) to (7)."""
    t = times()
    angle, direction = {
        "spiral": (0.03 * t, t),
        "flower": (np.sin(t), (0.1 * t) ** 2),
        "seagull": (np.abs(np.sin(t)), np.sin(t) + math.pi / 2),
    }[name]
    return bend_vector(angle, direction)


def readings(
    q: np.ndarray, length: float = LENGTH, noise_mt: float = 0.0, generator: np.random.Generator | None = None
) -> np.ndarray:
    """Return synthetic readings ``[..., 3]`` [mT] at bend vectors, by magpylib, with white noise on every axis."""
    u = simulated_readings(robot(length), q)
    return u if generator is None else u + noise_mt * generator.standard_normal(u.shape)


def position_errors(found: np.ndarray, truth: np.ndarray, length: float = LENGTH) -> np.ndarray:
    """Return how far apart [mm] the magnet is at two bend vectors, the error of Fig. 5."""
    position = BendSensor(length).position
    return 1e3 * np.linalg.norm(position(found) - position(truth), axis=-1)


def particle_filter(
    process_noise_pi: Any, length: float = LENGTH, sigma_mt: float = SIGMA_MT, **how: Any
) -> ParticleFilter:
    """Return the filter of section II, with whatever is changed; several process noises [pi rad] are a batch."""
    width = np.pi * np.asarray(process_noise_pi, dtype=float)[..., None] * np.ones(2)
    how = {"estimate": "best tenth", "resampling": "multinomial", **how}
    return ParticleFilter(
        BendSensor(length, CUBE), width, sigma_mt / math.sqrt(2), BendDisc(LARGEST_BEND), **how
    )
