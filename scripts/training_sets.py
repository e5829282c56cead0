"""The rows that the networks of Baaij et al. 2023 are trained on, sections 3.2 and 4.2: relations and readings."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import torch

from repro import Robot, Sensor
from repro.chain import point_on
from repro_companion.papers.baaij import (
    CURVATURE,
    EARTH_MT,
    RINGS,
    SEEDS,
    SENSOR_RADIAL,
    affine_robot,
    bounds,
    robot,
)

DATA_SEED, SAMPLES = 1, 120_000


def uniform_draws(seed: int) -> Callable[..., np.ndarray]:
    """Return a function ``(low, high, *shape)`` that draws evenly from torch's generator, as the authors' program."""
    generator = torch.Generator().manual_seed(seed)

    def uniform(low: float, high: float, *shape: int) -> np.ndarray:
        return low + (high - low) * torch.rand(*shape, generator=generator, dtype=torch.float64).numpy()

    return uniform


@dataclass(frozen=True)
class SegmentNetwork:
    """A network of section 3.2: it predicts the sensors of one segment, counted from 0."""

    n_segments: int
    segment: int
    earth: bool
    seed: int
    learning_rate: ClassVar[float] = 0.18

    @property
    def name(self) -> str:
        """File name without its ending."""
        kind = "earth" if self.earth else "pcc"
        return f"{kind}_nb{self.n_segments}_segment{self.segment + 1}_seed{self.seed}"

    def rows(self, samples: int = SAMPLES) -> tuple[np.ndarray, np.ndarray]:
        """Return relations as angles and readings: three rows for each random shape and placement of the sensors."""
        uniform, n, axis = uniform_draws(DATA_SEED), self.n_segments, None
        bend = bounds(1)[1][0]
        bends, longer = uniform(-bend, bend, samples, n, 2), uniform(0.0, bounds(1)[1][2], samples, n, 1)
        turn = uniform(0.0, 2 * math.pi / 3, samples)
        tilt, radial = np.zeros(samples), np.full(samples, SENSOR_RADIAL)
        if self.earth:
            axis = uniform(-1.0, 1.0, samples, 3)
            axis /= np.linalg.norm(axis, axis=-1, keepdims=True)
        else:
            tilt = uniform(-math.radians(20), math.radians(20), samples)
            radial = uniform(26e-3 / 3, 52e-3 / 3, samples)
        q = np.concatenate([bends, longer], axis=-1).reshape(samples, -1)
        arm = robot(n)
        own = [sensor for sensor in arm.sensors if sensor.segment == self.segment + 1]
        return _training_rows(arm, arm, own, q, turn, tilt, radial, axis)


@dataclass(frozen=True)
class AffineNetwork:
    """A network of section 4.2: it predicts one sensor of the affine robot, counted from 0."""

    sensor: int
    seed: int
    learning_rate: ClassVar[float] = 0.15

    @property
    def name(self) -> str:
        """File name without its ending."""
        return f"affine_sensor{self.sensor + 1}_seed{self.seed}"

    def rows(self, samples: int = SAMPLES) -> tuple[np.ndarray, np.ndarray]:
        """Return relations as angles and readings; only the readings know of the shift of the magnets."""
        uniform = uniform_draws(DATA_SEED)
        high = (*CURVATURE, 2 * math.pi, bounds(1)[1][2])
        q = np.stack(
            [uniform(a, b, samples) for a, b in zip((-high[0], -high[1], 0.0, 0.0), high, strict=True)], -1
        )
        turn, radial = uniform(0.0, 2 * math.pi / 9, samples), np.full(samples, SENSOR_RADIAL)
        arm, told = affine_robot(), affine_robot(shift=0.0)
        return _training_rows(arm, told, [arm.sensors[self.sensor]], q, turn, 0 * radial, radial, None)


def trained_networks() -> Iterator[SegmentNetwork | AffineNetwork]:
    """Yield the 27 networks of Table 1 and the 27 of section 4.4."""
    robots = ((1, False), (2, False), (3, False), (3, True))
    yield from (SegmentNetwork(n, k, earth, seed) for n, earth in robots for seed in SEEDS for k in range(n))
    yield from (AffineNetwork(sensor, seed) for seed in SEEDS for sensor in range(9))


def _training_rows(
    arm: Robot, told: Robot, sensors: Sequence[Sensor], q: np.ndarray, turn: np.ndarray, tilt: np.ndarray,
    radial: np.ndarray, axis: np.ndarray | None,
) -> tuple[np.ndarray, np.ndarray]:  # fmt: skip
    """Return relations to the magnets of ``told``, and readings of ``arm``, whose sensors differ by sample."""
    parts = [*arm.magnets, *told.magnets, *(point_on(s.segment, s.at) for s in sensors)]
    places, n_m = [getattr(part, "place", part) for part in parts], len(arm.magnets)
    T = np.concatenate([arm.poses(some, places) for some in np.array_split(q, -(-len(q) // 10_000))])
    true, believed = T[:, :n_m], T[:, n_m : 2 * n_m]
    xi, u = [], []
    for sensor, frame in zip(sensors, np.moveaxis(T[:, 2 * n_m :], 1, 0), strict=True):
        at, along = _mounted(frame, turn + sensor.azimuth, tilt, radial)
        xi.append(_relations(at, along, believed, axis))
        u.append((along * _field(at, true, 0 * at if axis is None else EARTH_MT * axis)).sum(-1))
    rows = np.stack(xi, 1).reshape(-1, 1 + 4 * n_m).astype(np.float32)
    return rows, np.stack(u, 1).ravel().astype(np.float32)


def _mounted(
    frame: np.ndarray, azimuth: np.ndarray, tilt: np.ndarray, radial: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return places and axes of sensors around frames ``[sample, 4, 4]``."""
    c, s, R = np.cos(azimuth), np.sin(azimuth), frame[:, :3, :3]
    along = np.stack([-np.sin(tilt) * c, -np.sin(tilt) * s, -np.cos(tilt)], -1)
    out = np.stack([radial * c, radial * s, 0 * azimuth], -1)
    return frame[:, :3, 3] + np.einsum("nij,nj->ni", R, out), np.einsum("nij,nj->ni", R, along)


def _relations(at: np.ndarray, along: np.ndarray, magnets: np.ndarray, axis: np.ndarray | None) -> np.ndarray:
    """Return relations of sensors to the Earth's field, or to x without one, and to magnets ``[sample, k, 4, 4]``."""
    found = [_angle(along, np.array([[1.0, 0.0, 0.0]]) if axis is None else axis)]
    for T in np.moveaxis(magnets, 1, 0):
        p, m = at - T[:, :3, 3], T[:, :3, 2]
        found += [np.linalg.norm(p, axis=-1), _angle(along, m), _angle(p, along), _angle(p, m)]
    return np.stack(found, -1)


def _field(at: np.ndarray, magnets: np.ndarray, B: np.ndarray) -> np.ndarray:
    """Return a field and that of the released rings at places, one for each sample [mT]."""
    for T in np.moveaxis(magnets, 1, 0):
        R = T[:, :3, :3]
        p = np.einsum("nji,nj->ni", R, at - T[:, :3, 3])
        B = B + np.einsum("nij,nj->ni", R, RINGS["released"].field(p))
    return B


def _angle(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return np.arctan2(np.linalg.norm(np.cross(a, b), axis=-1), (a * b).sum(-1))
