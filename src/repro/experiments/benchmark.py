"""What costs how much: our routes against plain references, measured side by side in one run."""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable
from typing import Any

import magpylib as magpy
import numpy as np
import pandas as pd
import torch
from jaxtyping import Float
from scipy.spatial.transform import Rotation, Slerp

from repro.estimation.imu_models import pcc_extended
from repro.estimation.imu_selection import MARKERS, Selection, selection
from repro.estimation.orientations import exponential
from repro.experiments.martin2022_scorecard import CAPABILITY as CHAIN
from repro.experiments.mitchell2021_scorecard import CAPABILITY as PARTICLES
from repro.experiments.mitchell2021_simulation import updates
from repro.kinematics.robot import Robot
from repro.sensing.compiled_bend import CompiledBendSensor
from repro.sensing.magnetic import readings
from repro.sensing.magnets import MT_PER_T, Ring, ring
from repro.simulation.bend_curves import bend_curve, bend_readings
from repro.simulation.robots import pcc_robot
from repro.simulation.training_set import training_set

TRAINING_SAMPLES = 120_000


def rate(work: Callable[[], int], repeats: int = 3) -> float:
    """Items per second of processor time: the median of some repeats, after one that does not count."""
    work()
    found = []
    for _ in range(repeats):
        start = time.process_time()
        items = work()
        found.append(items / (time.process_time() - start))
    return statistics.median(found)


def objects_per_configuration(robot: Robot, q: torch.Tensor, magnet: Ring) -> np.ndarray:
    """Readings by magpylib objects posed anew for every configuration, one ``getB`` for all its sensors."""
    outer = magpy.magnet.Cylinder(
        polarization=(0, 0, magnet.polarisation_mt / MT_PER_T),
        dimension=(magnet.outer_diameter, magnet.height),
    )
    bore = magpy.magnet.Cylinder(
        polarization=(0, 0, -magnet.polarisation_mt / MT_PER_T),
        dimension=(magnet.inner_diameter, magnet.height),
    )
    rows = []
    for T_m, T_s in zip(robot.magnet_poses(q).numpy(), robot.sensor_poses(q).numpy(), strict=True):
        sources = []
        for T in T_m:
            turn = Rotation.from_matrix(T[:3, :3])
            sources += [part.copy(position=T[:3, 3], orientation=turn) for part in (outer, bore)]
        sensors = [magpy.Sensor(position=T[:3, 3], orientation=Rotation.from_matrix(T[:3, :3])) for T in T_s]
        rows.append(magpy.getB(sources, sensors, sumup=True)[:, 2])
    return MT_PER_T * np.array(rows)


def chain_by_equations(
    orientations: Float[np.ndarray, "samples imus 4"], chosen: Selection
) -> Float[np.ndarray, "samples joints 3"]:
    """Joints of the PCC-extended chain of Martin et al. 2022 by a plain loop over equations (3) to (5)."""
    n, samples = chosen.sub_links, []
    for q in orientations:
        joints = [np.zeros(3)]
        for k, length in enumerate(chosen.link_lengths):
            between = Slerp([0.0, 1.0], Rotation.from_quat(q[k : k + 2]))
            for j in range(n):
                joints.append(joints[-1] + between((2 * j + 1) / (2 * n)).apply([0.0, 0.0, length / n]))
        samples.append(np.array(joints))
    return np.array(samples)


def benchmark() -> pd.DataFrame:
    """Every measured capability: columns ``capability, kind, ours, unit, reference, ratio, error, note``.

    ``error`` is the largest difference between ours and the reference on the same input, in mT or, of the chain, mm.
    """
    torch.set_num_threads(1)
    return pd.DataFrame([_training_set(), _particle_filter(), _chain_of_imus()])


def _training_set() -> dict[str, Any]:
    magnet, robot = ring("released"), pcc_robot(3)
    q = training_set(3, seed=0, samples=200).q
    plain = objects_per_configuration(robot, q, magnet)
    return _row(
        "training set, n_b = 3",
        "configurations per CPU second",
        rate(lambda: len(training_set(3, seed=0, samples=TRAINING_SAMPLES).q)),
        rate(lambda: len(objects_per_configuration(robot, q, magnet))),
        np.abs(plain - readings(robot, q, magnet).numpy()).max(),
        "vectorised magpylib; reference: magpylib objects, one getB per configuration",
    )


def _particle_filter() -> dict[str, Any]:
    sensor, q = CompiledBendSensor(15e-3), bend_curve("flower")
    return _row(
        PARTICLES,
        "updates per CPU second",
        rate(lambda: updates(sensor)),
        rate(lambda: updates(bend_readings, 100)),
        float((sensor(q) - bend_readings(q)).abs().max()),
        "the paper's filter on Flower; reference: the same filter with magpylib as its model",
    )


def _chain_of_imus() -> dict[str, Any]:
    chosen = selection("pcc", 8)
    turns = 0.2 * np.random.default_rng(0).standard_normal((8000, 9, 3)) * (np.arange(9)[:, None] > 0)
    q = exponential(np.cumsum(turns, axis=1))
    arcs = np.minimum(np.cumsum(np.repeat(chosen.link_lengths, 2) / 2), sum(chosen.link_lengths))
    difference = chain_by_equations(q[:200], chosen)[:, 1:] - pcc_extended(q[:200], chosen, arcs)
    return _row(
        CHAIN,
        "samples per CPU second",
        rate(lambda: len(pcc_extended(q, chosen, MARKERS))),
        rate(lambda: len(chain_by_equations(q[:200], chosen))),
        1e3 * np.abs(difference).max(),
        "positions of both markers; reference: a loop over equations (3) to (5) with SciPy's Slerp",
    )


def _row(
    capability: str, unit: str, ours: float, reference: float, error: float, note: str
) -> dict[str, Any]:
    return {
        "capability": capability,
        "kind": "implementation",
        "ours": ours,
        "unit": unit,
        "reference": reference,
        "ratio": ours / reference,
        "error": error,
        "note": note,
    }
