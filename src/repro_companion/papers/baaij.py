"""The simulated robots of Baaij et al. 2023: their geometry, motion, readings and networks, and their descent."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from repro import (
    ConstantCurvature,
    GradientDescent,
    Magnet,
    Network,
    Ring,
    Robot,
    Sensing,
    Sensor,
    load_network,
    simulated_readings,
)
from repro_companion.show import project_folder

LENGTH, RADIUS = 0.110, 0.022
"""Length of a segment, and distance of its actuators from the backbone [m]."""
MAGNET_AT, SENSOR_RADIAL = 0.055, 0.013
"""Where the ring of a segment is along it, and how far its sensors are from the backbone [m]."""
RINGS = {"released": Ring(24e-3, 12e-3, 6e-3, 1450.0), "published": Ring(12e-3, 6e-3, 6e-3, 1450.0)}
"""The released program takes the diameters of the text, 12 and 6 mm, as radii."""
EARTH_MT = 0.065
STEPS, RATE_HZ = 400, 40.0
BEND = RADIUS * math.pi / 4
"""Largest bend of a trajectory [m]: 45 degrees."""
MOMENTUM, ITERATIONS = 0.3, 20
SEEDS = (0, 1, 2)
SETTING = "as released: ring 24/12 mm, start at ground truth, momentum carried"


def robot(
    n_segments: int = 1,
    sensors_per_segment: int = 3,
    *,
    tilt: float = 0.0,
    radial: float = SENSOR_RADIAL,
    azimuth: float = 0.0,
    ring: str = "released",
) -> Robot:
    """Return the robot of section 3.1: a ring in the middle of each segment, sensors around its tip [m, rad]."""
    magnets = [Magnet(RINGS[ring], segment, MAGNET_AT) for segment in range(1, n_segments + 1)]
    sensors = [
        Sensor(segment, LENGTH, radial, azimuth + 2 * math.pi * j / sensors_per_segment, tilt)
        for segment in range(1, n_segments + 1)
        for j in range(sensors_per_segment)
    ]
    return Robot([ConstantCurvature(LENGTH, RADIUS)] * n_segments, magnets, sensors)


def network(n_segments: int, segment: int, seed: int, *, earth: bool = False) -> Network:
    """Return our trained network for the sensors of one segment, counted from 1."""
    name = f"{'earth' if earth else 'pcc'}_nb{n_segments}_segment{segment}_seed{seed}"
    return load_network(project_folder() / "data" / "networks" / f"{name}.safetensors")


def networks(n_segments: int, seed: int, *, earth: bool = False) -> list[Network]:
    """Return our trained networks, one for each segment."""
    return [network(n_segments, segment, seed, earth=earth) for segment in range(1, n_segments + 1)]


def bending(steps: int = STEPS) -> np.ndarray:
    """Return T1 of one segment: a bend towards x that grows to 45 degrees ``[steps, 3]`` [m]."""
    return np.outer(np.linspace(0, 1, steps), [BEND, 0.0, 0.0])


def lemniscate(n_segments: int, *, half: bool = False, steps: int = STEPS) -> np.ndarray:
    """Return the lemniscate T3, or its half T2, of every segment ``[steps, 3 n_segments]`` [m]."""
    s, turns = np.linspace(0, 1, steps), math.pi if half else 2 * math.pi
    columns = []
    for i in range(n_segments):
        phase = 2 * math.pi * i / n_segments
        columns += [BEND * np.sin(2 * turns * s + phase), BEND * np.sin(turns * s + phase)]
        columns += [2.75e-3 * (1 + np.sin(2 * math.pi * s + phase))]
    return np.stack(columns, axis=-1)


def simulate(robot: Robot, q: np.ndarray, *, earth_mt=None, noise_mt: float = 0.0, seed: int = 0) -> np.ndarray:
    """Return readings ``[t, s]`` [mT] by magpylib, with noise of a standard deviation."""
    u = simulated_readings(robot, q, earth_mt)
    return u + noise_mt * draws(seed, *u.shape) if noise_mt else u


def draws(seed: int, *shape: int) -> np.ndarray:
    """Return normal draws of the first edition's generator."""
    import torch

    generator = torch.Generator().manual_seed(seed)
    return torch.randn(shape, generator=generator, dtype=torch.float64).numpy()


def relative_errors(found: np.ndarray, truth: np.ndarray) -> np.ndarray:
    """Return the errors of eq. (13) ``[..., n_q]`` [%] of estimates ``[t, ..., n_q]``: relative to the range."""
    wide = truth.reshape(len(truth), *(1,) * (found.ndim - 2), -1)
    return 100 * np.sqrt(((found - wide) ** 2).mean(0)) / (truth.max(0) - truth.min(0))


def step_sizes(n_segments: int) -> list[float]:
    """Return the step sizes of section 3.3 for every coordinate; they belong to the released ring."""
    bend, elongation = {1: (3.5e-4, 3.5e-4), 2: (3e-3, 3e-4)}.get(n_segments, (2e-3, 2e-4))
    return [bend, bend, elongation] * n_segments


def descent(sensing: Sensing, n_segments: int, *, iterations: int = ITERATIONS) -> GradientDescent:
    """Return the released estimator: eqs (9) to (12), its momentum carried from one time step to the next."""
    return GradientDescent(sensing, step_sizes(n_segments), MOMENTUM, iterations)


# Table 1


@dataclass(frozen=True)
class Row:
    """One row of Table 1 as printed."""

    name: str
    """As in data/published/published.csv."""
    label: str
    n_segments: int = 3
    sensors_per_segment: int = 3
    tilt_deg: float = 0.0
    radial: float = SENSOR_RADIAL
    earth: tuple[float, float, float] | None = None
    same_as: str = ""
    """The row that prints the same run."""

    def robot(self) -> Robot:
        """Return its robot."""
        tilt = math.radians(self.tilt_deg)
        return robot(self.n_segments, self.sensors_per_segment, tilt=tilt, radial=self.radial)

    def earth_mt(self) -> np.ndarray | None:
        """Return the field of the Earth [mT], if there is one."""
        return None if self.earth is None else EARTH_MT * np.array(self.earth)

    def sensing(self, seed: int) -> Sensing:
        """Return the sensor model of the paper: one trained network for each segment."""
        trained = networks(self.n_segments, seed, earth=self.earth is not None)
        return Sensing(self.robot(), trained, earth=self.earth)


ROWS = (
    Row("n_b=1", "1 segment", n_segments=1),
    Row("n_b=2", "2 segments", n_segments=2),
    Row("n_b=3", "3 segments"),
    Row("n_s=6", "6 sensors", sensors_per_segment=2),
    Row("n_s=9", "9 sensors", same_as="n_b=3"),
    Row("n_s=12", "12 sensors", sensors_per_segment=4),
    Row("n_s=18", "18 sensors", sensors_per_segment=6),
    Row("nominal", "nominal", same_as="n_b=3"),
    Row("psi_s=10deg", "tilted by 10°", tilt_deg=10.0),
    Row("d_s_r=16mm", "at radius 16 mm", radial=16e-3),
    Row("n_e=(1,0,0)", "Earth field, x", earth=(1.0, 0.0, 0.0)),
    Row("n_e=(0,1,0)", "Earth field, y", earth=(0.0, 1.0, 0.0)),
    Row("n_e=(0,0,1)", "Earth field, z", earth=(0.0, 0.0, 1.0)),
)
"""The 13 rows of Table 1 in their order; two print a run again. All move along T3."""
