"""A SYNTHETIC recording of the soft arm: IMUs and motion capture, each on its own clock; nothing in it was measured.

The readings have the form of a recorded bag (`edition1_companion.recordings.martin2022.read_readings`), so that both
pass through the same reader.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pandas as pd
from jaxtyping import Float

from edition1.errors import bad_input
from edition1_companion.twins.imu_errors import ImuErrors, read_imus
from edition1_companion.twins.soft_arm import SoftArm

MARKER_ARCS_M = (0.36, 0.60)
"""Distances of the markers M1 and M2 from the base [m] (section III-A)."""
CHECK_ARCS_M = (0.20, 0.48, 0.64)
"""Distances of further points [m], which the paper did not record and no fit may use."""


@dataclass(frozen=True)
class MotionCapture:
    """How motion capture sees the arm.

    Parameters
    ----------
    rate_hz
        Frames per second (section III-A).
    noise_m
        Standard deviation along each axis [m]: the precision that section III-A states, taken so.
    latest_start_s
        It starts at an unknown time between 0 and this [s] after the IMUs; assumed.
    origin_m
        Where it sees the origin of the base frame [m]; a nonzero value means that its frame was not quite placed.
    heading_rad
        How its frame is turned about the vertical [rad].
    """

    rate_hz: float = 100.0
    noise_m: float = 0.001
    latest_start_s: float = 2.0
    origin_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    heading_rad: float = 0.0


@dataclass(frozen=True)
class ArmRecording:
    """What was recorded of a soft arm; synthetic.

    Attributes
    ----------
    readings
        One row per reading of an IMU: ``sequence, time_s, imu, x, y, z, w``, in the form of a recorded bag.
    capture_time_s
        Times of the frames of the motion capture, on its own clock, which starts at 0 [s].
    points
        Positions [m] that motion capture saw, in its frame.
    point_arcs_m
        Their distances from the base [m]: :data:`MARKER_ARCS_M`, then :data:`CHECK_ARCS_M`.
    capture_start_s
        The truth that a recording does not tell: the time of the IMUs' clock at which the other one starts [s].
    """

    readings: pd.DataFrame
    capture_time_s: Float[np.ndarray, " frames"]
    points: Float[np.ndarray, "frames points 3"]
    point_arcs_m: tuple[float, ...]
    capture_start_s: float


def record_soft_arm(
    arm: SoftArm, *, seed: int, errors: ImuErrors | None = None, capture: MotionCapture | None = None
) -> ArmRecording:
    """Record a motion with eight IMUs and motion capture.

    Parameters
    ----------
    arm
        How the arm moved.
    seed
        Seed of all random numbers: the same seed gives the same bits.
    errors
        Errors of the IMUs; the defaults of :class:`edition1_companion.twins.imu_errors.ImuErrors` when not given.
    capture
        How motion capture sees the arm; the defaults of :class:`MotionCapture` when not given.

    Raises
    ------
    InputError
        If the motion is shorter than the latest start of motion capture.
    """
    errors, capture = errors or ImuErrors(), capture or MotionCapture()
    first, last = float(arm.time_s[0]), float(arm.time_s[-1])
    if not last - first > capture.latest_start_s:
        longer = f"longer than {capture.latest_start_s:g} s"
        raise bad_input("arm", "record_soft_arm", longer, f"{last - first:g} s")
    read = read_imus(
        lambda time_s: arm.orientations_at(time_s)[:, 1:],
        start_s=first,
        stop_s=last,
        errors=errors,
        seed=seed,
    )
    rounds, imus = read.time_s.shape
    readings = pd.DataFrame(
        {
            "sequence": np.arange(rounds * imus),
            "time_s": read.time_s.ravel(),
            "imu": np.tile(np.arange(imus), rounds),
        }
        | dict(zip("xyzw", read.orientations.reshape(-1, 4).T, strict=True))
    )
    rng = np.random.default_rng([seed, 1])  # apart from the IMUs' numbers
    start = first + rng.uniform(0.0, capture.latest_start_s)
    time_s = np.arange(int((last - start) * capture.rate_hz) + 1) / capture.rate_hz
    arcs = MARKER_ARCS_M + CHECK_ARCS_M
    seen = (
        arm.positions_at(start + time_s, np.array(arcs)) @ _about_z(capture.heading_rad).T + capture.origin_m
    )
    seen = seen + capture.noise_m * rng.standard_normal(seen.shape)
    return ArmRecording(readings, time_s, seen, arcs, start)


def _about_z(angle: float) -> np.ndarray:
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
