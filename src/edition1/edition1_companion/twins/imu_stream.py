"""A short SYNTHETIC stream of IMU readings, to try a page without a recording; nothing in it was measured."""

from __future__ import annotations

import numpy as np
import pandas as pd
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from edition1.errors import bad_input, require
from edition1.estimation.imu_chain import sensor_orientations

# Median angles between neighbours [deg], base to tip, of the order recorded by Martin et al.; the first is
# the angle from the upright base to IMU 0 and, like the last, assumed.
NEIGHBOUR_ANGLES_DEG = (12.0, 22.0, 18.0, 13.0, 14.0, 10.0, 8.5, 8.0)
QUANTUM = 2.0**-14  # resolution of a quaternion component of the BNO055 (datasheet BST-BNO055-DS000)
NOISE_RAD = np.radians(0.2)  # assumed
MEDIAN_WAVE = (
    1.44  # median length of a pair of sums of three unit sinusoids each, so that the angles are medians
)
REPEAT_PROBABILITY = 0.001  # assumed: the order of what the recordings show
JUMP_RAD = np.radians(30.0)  # the order of the single steps in the recordings (24 to 36 deg)


def synthetic_stream(
    *, seed: int, duration_s: float = 20.0, rate_hz: float = 35.0, along_arm: str = "z"
) -> pd.DataFrame:
    """Make readings of eight IMUs on a smoothly moving arm that stands on its base; synthetic throughout.

    Each link bends by an angle and in a direction that are sums of slow sinusoids with random frequencies and
    phases, with neither twist nor stretch. The IMUs are read in turn at even intervals, with white noise
    (0.2 deg per axis, assumed), the quantisation of the BNO055, and some repeated readings. Halfway one IMU's
    heading steps by 30 deg within one interval and stays there, so that a jump can be seen.

    Parameters
    ----------
    seed
        Seed of the random numbers: the same seed gives the same readings.
    duration_s
        Length of the stream [s].
    rate_hz
        Readings per IMU and second [Hz].
    along_arm
        Axis of the synthetic sensors that points along the arm: "x", "y" or "z".

    Returns
    -------
    pandas.DataFrame
        One row per reading: ``sequence, time_s, imu, x, y, z, w``, in the form of
        `edition1_companion.recordings.martin2022.read_readings`.

    Raises
    ------
    InputError
        Unknown axis, a rate that is not above zero, or less than two rounds of readings.

    Examples
    --------
    >>> synthetic_stream(seed=0, duration_s=2.0)["imu"].head(9).tolist()
    [0, 1, 2, 3, 4, 5, 6, 7, 0]
    """
    require(np.isfinite(rate_hz) and rate_hz > 0, "rate_hz", "synthetic_stream", "above zero [Hz]", rate_hz)
    if not (np.isfinite(duration_s) and duration_s * rate_hz >= 2):
        raise bad_input(
            "duration_s", "synthetic_stream", "long enough for two rounds of readings [s]", duration_s
        )
    rng = np.random.default_rng(seed)
    imus = len(NEIGHBOUR_ANGLES_DEG)
    sequence = np.arange(int(duration_s * rate_hz) * imus)
    time_s, imu = sequence / (rate_hz * imus), sequence % imus
    links = smooth_motion(time_s, rng)[sequence, imu]
    sensors = Rotation.from_quat(sensor_orientations(links[:, None], along_arm)[:, 0])
    heading = np.where((imu == rng.integers(imus)) & (time_s > duration_s / 2), JUMP_RAD, 0.0)
    turned = Rotation.from_rotvec(heading[:, None] * [0.0, 0.0, 1.0]) * sensors
    noisy = turned * Rotation.from_rotvec(rng.normal(0.0, NOISE_RAD, (len(sequence), 3)))
    quaternions = np.round(noisy.as_quat() / QUANTUM) * QUANTUM
    for row in np.flatnonzero(rng.random(len(sequence)) < REPEAT_PROBABILITY):
        if row >= imus:
            quaternions[row] = quaternions[row - imus]
    return pd.DataFrame(
        {"sequence": sequence, "time_s": time_s, "imu": imu} | dict(zip("xyzw", quaternions.T, strict=True))
    )


def smooth_motion(
    time_s: Float[np.ndarray, " samples"], rng: np.random.Generator
) -> Float[np.ndarray, "samples imus 4"]:
    """Return link orientations (XYZW, link to world, link along z) of a smoothly moving synthetic arm.

    The bending of the links follows one pair of slow random signals, later towards the tip: the arm swings
    and circles as a whole.

    Parameters
    ----------
    time_s
        Times [s].
    rng
        Source of the frequencies (0.05 to 0.35 Hz) and phases.
    """
    frequencies = rng.uniform(0.05, 0.35, (2, 3))
    phases = rng.uniform(0.0, 2.0 * np.pi, (2, 3))
    link = Rotation.identity(len(time_s))
    orientations = []
    for delay_s, angle_deg in enumerate(NEIGHBOUR_ANGLES_DEG):
        shifted = np.asarray(time_s)[:, None, None] - 0.1 * delay_s
        waves = np.sin(2.0 * np.pi * frequencies * shifted + phases).sum(axis=-1)
        bend = np.radians(angle_deg) * waves / MEDIAN_WAVE
        link = link * Rotation.from_rotvec(np.column_stack([bend, np.zeros(len(time_s))]))
        orientations.append(link.as_quat())
    return np.stack(orientations, axis=1)
