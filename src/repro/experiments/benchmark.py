"""What costs how much: our routes against plain references, measured side by side in one run."""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable

import magpylib as magpy
import numpy as np
import pandas as pd
import torch
from scipy.spatial.transform import Rotation

from repro.kinematics.robot import Robot
from repro.sensing.magnetic import readings
from repro.sensing.magnets import MT_PER_T, Ring, ring
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


def benchmark() -> pd.DataFrame:
    """Every measured capability: columns ``capability, kind, ours, unit, reference, ratio, error, note``.

    ``error`` is the largest difference [mT] between ours and the reference on the same configurations.
    """
    torch.set_num_threads(1)
    magnet, robot = ring("released"), pcc_robot(3)
    q = training_set(3, seed=0, samples=200).q
    difference = np.abs(
        objects_per_configuration(robot, q, magnet) - readings(robot, q, magnet).numpy()
    ).max()

    def ours() -> int:
        return len(training_set(3, seed=0, samples=TRAINING_SAMPLES).q)

    def reference() -> int:
        return len(objects_per_configuration(robot, q, magnet))

    fast, plain = rate(ours), rate(reference)
    row = {
        "capability": "training set, n_b = 3",
        "kind": "implementation",
        "ours": fast,
        "unit": "configurations per CPU second",
        "reference": plain,
        "ratio": fast / plain,
        "error": difference,
        "note": "vectorised magpylib; reference: magpylib objects, one getB per configuration",
    }
    return pd.DataFrame([row])
