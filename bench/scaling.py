"""How the cost grows: time per call against samples, particles, segments, sensors and sensor-magnet pairs."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pandas as pd
import torch
from edition1.estimation.base import track
from edition1.estimation.levenberg_marquardt import LevenbergMarquardt
from edition1.estimation.orientations import exponential
from edition1.kernels import _chain as compiled_chain
from edition1.kernels import compiled
from edition1.kinematics.paper_robots import pcc_robot
from edition1.sensing.bend_sensor import BendSensor
from edition1.sensing.magnetic import MagneticSensing
from edition1.sensing.magnets import ring
from edition1.sensing.multipole import MultipoleField
from edition1_companion.pages.performance.rows import COLUMNS, SCALING, rate
from edition1_companion.pages.performance.tables import exponents
from edition1_companion.pages.probabilistic_curvature.simulation import PAPER
from edition1_companion.recordings.martin2022_models import MARKERS, selection
from edition1_companion.twins.bend_curves import LENGTH_M, bend_curve, bend_readings
from edition1_companion.twins.calibrated_robots import box
from edition1_companion.twins.calibration_session import SENSOR_NOISE_MT
from edition1_companion.twins.trajectories import lemniscate
from torch import Tensor

from bench.compiled_training_set import training_rows

EXPONENT = 1.1
"""Largest exponent of cost that meets the target."""
TARGETED = ("samples", "particles", "sensor-magnet pairs")
"""What the target is about."""


@dataclass(frozen=True)
class Curve:
    """Cost of a capability against one or more sizes.

    Parameters
    ----------
    capability
        What is computed.
    settings
        What is varied.
    sizes
        What that counts, by names, each from a setting to the size.
    prepare
        From a setting to the work, which is timed, and counts as one; preparing is not timed.
    """

    capability: str
    settings: tuple[int, ...]
    sizes: Mapping[str, Callable[[int], int]]
    prepare: Callable[[int], Callable[[], int]]


def curves() -> tuple[Curve, ...]:
    """All that are measured."""
    count = {"samples": int}
    by_segments = {"segments": int, "sensor-magnet pairs": lambda n: 3 * n * n}
    by_sensors = {"sensors": lambda k: 9 * k, "sensor-magnet pairs": lambda k: 27 * k}
    decades, segments = (10, 30, 100, 300, 1000, 3000, 10_000), (1, 2, 3, 4, 6, 8, 12)
    return (
        Curve("LM, n_b = 3", decades, count, lambda n: _least_squares(3, 3, n)),
        Curve("training set, n_b = 3", (*decades[2:], 30_000), count, _training_set),
        Curve("PCC-extended", (80, 240, 800, 2400, 8000, 24_000), count, _chain),
        Curve("particle filter", (*decades[2:], 30_000), {"particles": int}, _particles),
        Curve("LM, more sensors", (1, 2, 4, 8, 16, 32), by_sensors, lambda k: _least_squares(3, 3 * k, 200)),
        Curve("LM, more segments", segments, by_segments, lambda n: _least_squares(n, 3, 200)),
        Curve("training set, more segments", segments, by_segments, lambda n: _training_set(2000, n)),
    )


def scaling(chosen: Sequence[Curve] | None = None) -> pd.DataFrame:
    """Measure the curves: columns ``capability, against, size, seconds``, the processor time of one call."""
    rows = []
    for curve in curves() if chosen is None else chosen:
        costs = [1 / rate(curve.prepare(setting)) for setting in curve.settings]
        for against, size in curve.sizes.items():
            pairs = zip(curve.settings, costs, strict=True)
            rows += [(curve.capability, against, size(setting), cost) for setting, cost in pairs]
    return pd.DataFrame(rows, columns=["capability", "against", "size", "seconds"])


def exponent_rows(points: pd.DataFrame) -> Iterator[dict[str, Any]]:
    """Line of the benchmark's table for every exponent; here less is better."""
    for found in exponents(points).itertuples():
        target = EXPONENT if found.against in TARGETED else None
        yield dict.fromkeys(COLUMNS) | {
            "capability": f"exponent: {found.capability}, in {found.against}",
            "kind": SCALING,
            "ours": found.exponent,
            "unit": "exponent of the cost",
            "error": found.deviation,
            "target": target,
            "met": None if target is None else found.exponent <= target,
            "note": "over the largest decade; error: largest relative deviation from the power law",
        }


def _least_squares(n: int, per_segment: int, samples: int) -> Callable[[], int]:
    """Three iterations on robots side by side."""
    robot = pcc_robot(n, per_segment)
    sensing = MagneticSensing(robot, MultipoleField.of(ring("released")))
    method = LevenbergMarquardt(compiled(sensing), *box(n), noise_mt=SENSOR_NOISE_MT, iterations=3)
    q = lemniscate(n)[torch.arange(samples) % 400]
    noise = (
        SENSOR_NOISE_MT
        * torch.randn(samples, len(robot.sensors), generator=torch.Generator().manual_seed(0)).double()
    )
    u = sensing(lemniscate(n))[(torch.arange(samples) + 1) % 400] + noise
    state = method.init(q)
    return lambda: bool(method.step(state, u, 0.0))


def _training_set(samples: int, n: int = 3) -> Callable[[], int]:
    return lambda: bool(training_rows(n, seed=0, samples=samples))


def _chain(samples: int) -> Callable[[], int]:
    turns = 0.2 * np.random.default_rng(0).standard_normal((samples, 9, 3))
    q, chosen = exponential(np.cumsum(turns, axis=1)), selection("pcc", 8)
    return lambda: bool(len(compiled_chain.pcc_extended(q, chosen, MARKERS)))


def follow_flower(
    sensing: Callable[[Tensor], Tensor], steps: int, *, particles: int = 1000
) -> Callable[[], int]:
    """Work: the filter of Mitchell et al. along Flower, made before and so not timed; returns the updates.

    Parameters
    ----------
    sensing, particles
        As for :class:`~edition1.estimation.particle_filter.ParticleFilter`.
    steps
        Number of steps.
    """
    noise, readings = PAPER.filter().process_noise[0, 0], bend_readings(bend_curve("flower")[:steps])
    method = replace(PAPER.filter(), process_noise=noise, sensing=sensing, particles=particles)
    return lambda: len(track(method, readings, torch.zeros(2, dtype=torch.float64)).q)


def _particles(particles: int) -> Callable[[], int]:
    work = follow_flower(compiled(BendSensor(LENGTH_M)), 5, particles=particles)
    return lambda: bool(work())
