"""What costs how much: every capability against plain references, side by side in one run, on one core.

Time is processor time, a rate the median of some repeats; compilation does not count. The page "Performance" shows
what is measured here.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import torch
from edition1.estimation.imu_models import pcc_extended
from edition1.estimation.orientations import exponential
from edition1.kernels import _chain as compiled_chain
from edition1.kernels import compiled
from edition1.kernels._bend import CompiledBendSensor
from edition1.kernels._bend_series import BendSeries
from edition1.kernels._sensing import CompiledSensing
from edition1.kinematics.bend import MAX_BEND
from edition1.kinematics.paper_robots import pcc_robot
from edition1.sensing.bend_sensor import BendSensor
from edition1.sensing.magnetic import MagneticSensing, readings
from edition1.sensing.magnets import B444B, ring
from edition1_companion.pages.imu_markers.scorecard import CAPABILITY as CHAIN
from edition1_companion.pages.performance.rows import (
    COLUMNS,
    RELEASED_FILTER,
    RELEASED_GENERATOR,
    Goal,
    rate,
    row,
)
from edition1_companion.pages.probabilistic_curvature.scorecard import CAPABILITY as PARTICLES
from edition1_companion.recordings.martin2022_models import MARKERS, selection
from edition1_companion.twins.bend_curves import LENGTH_M, bend_curve, bend_readings
from edition1_companion.twins.table_1_method import sensor_models
from edition1_companion.twins.training_set import training_set

from bench.arithmetic import arithmetic_rows
from bench.compiled_training_set import training_rows
from bench.references import (
    chain_by_equations,
    chain_vectorised,
    cube_fields,
    objects_per_configuration,
)
from bench.scaling import exponent_rows, follow_flower, scaling
from bench.trackers import multipole, tracker_rows

FIELD_ERROR_MT = 1e-4
"""Largest error of the field that the particle filter may make in order to meet its target [mT]."""
SAMPLES = 8000
"""Samples of the IMUs, as many as the paper scores."""
CHAIN_SECONDS = 15e-3
"""Target for that many samples."""


def benchmark(networks: Path) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Measure everything: minutes.

    Parameters
    ----------
    networks
        Folder of the trained networks.

    Returns
    -------
    DataFrame, DataFrame
        A line for every ratio, exponent and arithmetic limit, with the columns of
        :data:`~edition1_companion.pages.performance.rows.COLUMNS`; and the points of the scaling curves.
    """
    torch.set_num_threads(1)
    ((model, inputs),) = sensor_models(["fast network"], 3, (0,), networks, "released").values()
    mlp = MagneticSensing(pcc_robot(3), model, inputs)
    rows = [*tracker_rows(networks, mlp), *generator_rows(), *particle_rows(), *chain_rows()]
    points = scaling()
    rows += [*exponent_rows(points), *arithmetic_rows(networks, mlp)]
    return pd.DataFrame(rows, columns=list(COLUMNS)), points


def generator_rows(samples: int = 100_000, few: int = 100, repeats: int = 5) -> Iterator[dict[str, Any]]:
    """Training sets for three segments: drawn, bent and read by one kernel."""
    magnet, robot = ring("released"), pcc_robot(3)
    q, unit = training_set(3, seed=0, samples=few).q, "configurations per CPU second"
    exact = training_set(3, seed=0, samples=few)
    error = float((training_rows(3, seed=0, samples=few).u - exact.u).abs().max())
    ours = rate(lambda: len(training_rows(3, seed=0, samples=samples).q), repeats)
    note = "multipoles to order 9; reference: {}; error: largest difference of the readings [mT]"
    for count, ratio, together in (("sensor", 2000.0, False), ("configuration", 500.0, True)):
        other = rate(
            lambda joint=together: len(objects_per_configuration(robot, q, magnet, together=joint)), 3
        )
        goal = Goal(200_000.0, ratio, RELEASED_GENERATOR[3])
        text = note.format(f"magpylib objects, one getB per {count}")
        yield row(f"training set, n_b = 3, getB per {count}", "model", unit, (ours, other), error, text, goal)
    vectorised = rate(lambda: len(training_set(3, seed=0, samples=samples // 5).q), repeats)
    text = note.format("vectorised magpylib for all configurations at once")
    yield row("training set, n_b = 3, vectorised magpylib", "model", unit, (ours, vectorised), error, text)
    q = training_set(3, seed=0, samples=samples // 20).q
    series = rate(lambda: len(readings(robot, q, magnet, route="multipole")), repeats)
    found = (
        readings(robot, q[:few], magnet, route="multipole")
        - CompiledSensing(multipole(3)).linearise(q[:few])[0]
    )
    text = note.format("the same series in torch, batched, on configurations that are drawn already")
    rates = (ours, series)
    yield row(
        "training set, n_b = 3, torch batched", "implementation", unit, rates, float(found.abs().max()), text
    )


def particle_rows(steps: int = 300, repeats: int = 5) -> Iterator[dict[str, Any]]:
    """Particle filter of Mitchell et al. with 1000 particles along Flower."""
    unit, flower = "updates per CPU second", bend_curve("flower")
    cloud = flower[50:1050].numpy()
    series = BendSeries(LENGTH_M, MAX_BEND)
    error = float((series(flower) - bend_readings(flower)).abs().max())
    ours = rate(follow_flower(compiled(BendSensor(LENGTH_M)), steps), repeats)
    fields = rate(lambda: len(cube_fields(cloud, LENGTH_M, B444B)) // 1000, repeats)
    note = "compiled, the field by a series; reference: {}; error: largest of the field along Flower [mT]"
    goal = Goal(5_000.0, 6.0 if error <= FIELD_ERROR_MT else np.inf, RELEASED_FILTER)
    text = note.format(
        "the fields of 1000 particles by vectorised magpylib alone, without weighing and resampling"
    )
    yield row(PARTICLES, "model", unit, (ours, fields), error, text, goal)
    filtered = rate(follow_flower(bend_readings, steps // 6), repeats)
    text = note.format("the same filter in torch with magpylib as its model")
    released = Goal(released=RELEASED_FILTER)
    yield row(f"{PARTICLES}, filter by magpylib", "model", unit, (ours, filtered), error, text, released)
    closed = rate(follow_flower(lambda q: CompiledBendSensor(LENGTH_M)(q), steps // 3), repeats)
    difference = float((CompiledBendSensor(LENGTH_M)(flower) - bend_readings(flower)).abs().max())
    text = (
        "torch's filter, the closed form by a kernel; reference: this filter with magpylib; error: as above"
    )
    rates = (closed, filtered)
    yield row(f"{PARTICLES}, closed form", "implementation", unit, rates, difference, text, released)
    batched = rate(follow_flower(BendSensor(LENGTH_M), steps // 3), repeats)
    difference = float((series(flower) - BendSensor(LENGTH_M)(flower)).abs().max())
    text = note.format("the same filter in torch, all particles in a batch, closed form of the cube")
    yield row(f"{PARTICLES}, torch batched", "model", unit, (ours, batched), difference, text)


def chain_rows(samples: int = SAMPLES, repeats: int = 5) -> Iterator[dict[str, Any]]:
    """All joints of the PCC-extended chain from eight IMUs, 16 segments."""
    chosen, unit = selection("pcc", 8), "samples per CPU second"
    q = imu_orientations(samples)
    n = chosen.sub_links
    arcs = np.minimum(np.cumsum(np.repeat(chosen.link_lengths, n) / n), sum(chosen.link_lengths))

    def ours() -> np.ndarray:
        return compiled_chain.pcc_extended(q, chosen, arcs)

    def interpreted() -> np.ndarray:
        return pcc_extended(q, chosen, arcs)

    speed, note = (
        rate(lambda: len(ours()), repeats),
        "all 16 joints; reference: {}; error: of the joints [mm]",
    )
    goal = Goal(SAMPLES / CHAIN_SECONDS, 4.0)
    references = (
        (CHAIN, lambda: chain_vectorised(q, chosen)[:, 1:], "equations (3) to (5) in vectorised NumPy", goal),
        (
            f"{CHAIN}, closed form",
            interpreted,
            "the sum in closed form, in NumPy, as the pages use it",
            Goal(),
        ),
        (
            f"{CHAIN}, loop",
            lambda: chain_by_equations(q[:200], chosen)[:, 1:],
            "a loop, SciPy's Slerp",
            Goal(),
        ),
    )
    for name, other, text, wanted in references:
        joints = other()
        error = 1e3 * float(np.abs(joints - ours()[: len(joints)]).max())
        rates = (speed, rate(lambda f=other: len(f()), repeats))
        yield row(name, "implementation", unit, rates, error, note.format(text), wanted)

    def markers() -> np.ndarray:
        return compiled_chain.pcc_extended(q, chosen, MARKERS)

    error = 1e3 * float(np.abs(markers() - pcc_extended(q, chosen, MARKERS)).max())
    rates = (
        rate(lambda: len(markers()), repeats),
        rate(lambda: len(pcc_extended(q, chosen, MARKERS)), 3),
    )
    note = "positions of both markers only; reference: NumPy, as the pages use it; error: of these positions [mm]"
    yield row(f"{CHAIN}, markers", "implementation", unit, rates, error, note)


def imu_orientations(samples: int) -> np.ndarray:
    """Orientations ``[samples, 9, 4]`` of a base and eight IMUs, at random turns from one to the next: synthetic."""
    turns = 0.2 * np.random.default_rng(0).standard_normal((samples, 9, 3)) * (np.arange(9)[:, None] > 0)
    return exponential(np.cumsum(turns, axis=1))
