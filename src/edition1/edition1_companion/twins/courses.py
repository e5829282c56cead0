"""The courses that an emulated board can play, computed; and, as they are by default, in a file beside this module.

So boards can be emulated where torch is not installed. ``python -m edition1_companion.twins.courses`` writes the file.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from jaxtyping import Float

from edition1.kinematics.paper_robots import pcc_robot
from edition1.sensing.magnetic import readings as field_readings
from edition1.sensing.magnets import ring
from edition1_companion.twins.bend_curves import CURVES, bend_curve, bend_readings
from edition1_companion.twins.imu_stream import synthetic_stream
from edition1_companion.twins.pneumatic_actuation import TRAJECTORIES
from edition1_companion.twins.pneumatic_rig import record_rig
from edition1_companion.twins.rig_twins import nominal_twin
from edition1_companion.twins.takes import ADC_STEPS, ARM_HZ, ARM_S, KEPT, STEPS
from edition1_companion.twins.trajectories import lemniscate


def lemniscate_mt(steps: int = STEPS) -> Float[np.ndarray, "steps 3"]:
    """Readings along T3 of Baaij et al. [mT]."""
    return field_readings(pcc_robot(), lemniscate(1, steps=steps), ring("released")).numpy()


def curve_mt(name: str) -> Float[np.ndarray, "steps 3"]:
    """Field of the cube of Mitchell et al. along a curve, in the axes of the model [mT]."""
    return bend_readings(bend_curve(name)).numpy()


def rig_mv(name: str, seed: int = 0) -> Float[np.ndarray, "steps 3"]:
    """Readings of the twin of the rig [mV]: steps of its converter."""
    return record_rig(nominal_twin(), name, seed=seed).readings_mv


def arm_table(
    seed: int = 0, *, duration_s: float = ARM_S, rate_hz: float = ARM_HZ
) -> Float[np.ndarray, "readings 6"]:
    """Time [s], number and quaternion of the IMUs of an arm."""
    table = synthetic_stream(seed=seed, duration_s=duration_s, rate_hz=rate_hz)
    return table[["time_s", "imu", *"xyzw"]].to_numpy(float)


def all_courses() -> dict[str, np.ndarray]:
    """Return all courses at their own rates, of seed 0, as they are kept."""
    found = {"lemniscate": lemniscate_mt(), "arm": arm_table()} | {name: curve_mt(name) for name in CURVES}
    for name in TRAJECTORIES:
        found[f"twin:{name}"] = np.rint(rig_mv(name) * ADC_STEPS).astype(np.int16)
    return found


if __name__ == "__main__":
    np.savez_compressed(Path(KEPT), **all_courses())
