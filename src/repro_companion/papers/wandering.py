"""A robot whose sensors drift for 45 minutes: its readings, and a filter that follows it. Synthetic.

The robot has three segments of Baaij et al. 2023, a ring in the middle of each, three Hall sensors and an IMU at each
tip. Its base is clamped upright in a constant field of the Earth. At the start everything is as calibrated, and from
then on it drifts. The fields come from magpylib at the true poses.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import pandas as pd
from scipy.spatial.transform import Rotation

from repro import Drift, Drifting, Imu, KalmanFilter, Robot, simulated_readings
from repro.estimators.track import Trajectory
from repro_companion.papers import baaij, martin
from repro_companion.show import sentences

RATE_HZ, MINUTES, EVERY = 4.0, 45.0, 4
"""Readings per second, and which of them a filter takes: on seed 100 twice as many gained a few percent."""
SIZE_S = 60 * MINUTES
"""Time after which a random walk has the size that is stated [s]."""
EARTH, IMU_NOISE = (baaij.EARTH_MT, 0.0, 0.0), 1e-3
START, PERIODS_S = np.array([0.0, 0.0, 2.75e-3] * 3), (4.0, 40.0)
WARMING = -0.0011 * 10.0
"""Relative loss of all moments over 45 minutes: 10 K at the coefficient of sintered NdFeB."""
OFFSET, GAIN, HEADING = 0.01, 0.001, math.radians(10.0 * math.sqrt(0.75))
"""Standard deviation of random walks after 45 minutes [mT, relative, rad]."""
TILT, TILT_S = math.radians(0.2), 1200.0
SWAY, SWAY_S = math.radians(1.0), 3.0
"""Error of an IMU's vertical that lasts, and in motion: standard deviation [rad] and correlation time [s]."""
LAST = 15
"""Minutes at the end that count."""


def robot() -> Robot:
    """Return the robot of Table 1 with three segments, and an IMU at each tip."""
    drawn = baaij.robot(3)
    imus = [Imu(segment, baaij.LENGTH, noise=IMU_NOISE) for segment in (1, 2, 3)]
    low, high = baaij.bounds(3)
    return Robot(
        drawn.segments, drawn.magnets, drawn.sensors, imus, lower=low, upper=high, start=START, earth=EARTH,
        rate_hz=RATE_HZ,
    )  # fmt: skip


class Run(NamedTuple):
    """Readings of 45 minutes, and the truth behind them."""

    times: np.ndarray
    q: np.ndarray
    readings: np.ndarray
    """Nine flux densities [mT], then a rotation vector [rad] of each IMU."""
    errors: np.ndarray
    """True errors of the sensors, in the order of :func:`drifts` without the sway."""


def draw(seed: int, minutes: float = MINUTES, size: float = 1.0) -> Run:
    """Draw motion, drift of so many times its size, and readings."""
    of_motion, of_drift, of_hall, of_imus = (np.random.default_rng([45, seed, k]) for k in (0, 1, 3, 4))
    arm, times = robot(), np.arange(round(60 * minutes * RATE_HZ)) / RATE_HZ
    q, errors = motion(times, of_motion), size * drift(len(times), of_drift)
    moment, gain, offset, heading, tilt = np.split(errors, [1, 10, 19, 22], axis=1)
    u = simulated_readings(arm, q)
    hall = (1 + gain) * ((1 + moment) * u[:, :9] + earth_readings(arm, q)) + offset
    hall += baaij.NOISE_MT * of_hall.standard_normal(hall.shape)

    each = (len(times), 3, 3)
    lean = np.zeros(each)
    lean[..., :2] = tilt.reshape(-1, 3, 2) + SWAY * fading((len(times), 3, 2), SWAY_S, of_imus)
    noise = IMU_NOISE * of_imus.standard_normal(each)
    turns = (noise, heading[..., None] * [0.0, 0.0, 1.0], lean, u[:, 9:])
    noisy, turned, leant, true = (Rotation.from_rotvec(x.reshape(-1, 3)) for x in turns)
    imus = (noisy * turned * leant * true).as_rotvec().reshape(-1, 9)
    return Run(*(x[::EVERY] for x in (times, q, np.hstack([hall, imus]), errors)))


def earth_readings(arm: Robot, q: np.ndarray) -> np.ndarray:
    """Return what the Hall sensors read of the Earth ``[t, 9]`` [mT]."""
    return arm.poses(q, [sensor.place for sensor in arm.sensors])[..., :3, 2] @ EARTH


def motion(times: np.ndarray, generator: np.random.Generator) -> np.ndarray:
    """Return smooth configurations within the bounds ``[t, 9]`` [m]: squashed sums of twelve sines."""
    frequency = generator.uniform(1 / PERIODS_S[1], 1 / PERIODS_S[0], (9, 12))
    phase = generator.uniform(0, 2 * np.pi, (9, 12))
    waves = np.sin(2 * np.pi * times[:, None, None] * frequency + phase).sum(-1)
    return START + np.tile([0.015, 0.015, START[2]], 3) * np.tanh(np.sqrt(2 / 12) * waves)


def fading(shape: tuple[int, int, int], time_s: float, generator: np.random.Generator) -> np.ndarray:
    """Return stationary processes of unit variance with the correlation exp(-t/time_s), at our rate."""
    steps, *paths = shape
    return martin.wandering(steps, (paths[0], paths[1]), time_s * RATE_HZ / martin.RATE_HZ, generator)


def drift(steps: int, generator: np.random.Generator) -> np.ndarray:
    """Return the errors of the sensors ``[t, 28]``; none at the start."""
    tilt = TILT * fading((steps, 3, 2), TILT_S, generator).reshape(steps, 6)
    warming = np.arange(steps)[:, None] * WARMING / (SIZE_S * RATE_HZ)
    sizes = np.repeat([GAIN, OFFSET, HEADING], [9, 9, 3]) / math.sqrt(SIZE_S * RATE_HZ)
    parts = [generator.standard_normal((steps, n)) for n in (9, 9, 3)]
    errors = np.hstack([warming, np.cumsum(sizes * np.hstack(parts), axis=0), tilt])
    return errors - errors[0]


# Following the robot

SWAYING = Drift("tilt", SWAY, SWAY * math.sqrt(2 / SWAY_S), time_s=SWAY_S)


def drifts() -> list[Drift]:
    """Return what the filter believes to wander: by the true sizes."""
    walk = 1 / math.sqrt(SIZE_S)
    return [
        Drift("moment", 0.0, 3 * walk * abs(WARMING), shared=True),  # a walk lags behind what goes one way
        Drift("gain", 0.0, walk * GAIN),
        Drift("offset", 0.0, walk * OFFSET),
        Drift("heading", 0.0, walk * HEADING),
        # An error that fades in T, less what it was at the start, has the variance of one that fades in 2 T.
        Drift("tilt", 0.0, TILT * math.sqrt(2 / TILT_S), time_s=2 * TILT_S),
        SWAYING,
    ]


def kalman_filter(wander: Sequence[Drift]) -> KalmanFilter:
    """Return a filter of the robot; if nothing wanders, the sway of the IMUs counts as white noise."""
    arm, (low, high) = robot(), baaij.bounds(3)
    sensing = Drifting(arm.sensing(), wander) if wander else arm.sensing()
    noise = np.repeat([baaij.NOISE_MT, IMU_NOISE if wander else SWAY], 9)
    return KalmanFilter(sensing, low, high, noise, 0.6 * (high - low), 0.5 * (high - low))


def tip_errors(run: Run, found: Trajectory) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the error of the tip, the deviation that is stated for it [% of the length], and its NEES over 3.

    The estimates may end before the run.
    """
    arm = robot()
    tip, G = arm.tip_slopes(found.q)
    off, C = tip - arm.tip(run.q[: len(tip)])[:, :3, 3], G @ found.covariance @ np.swapaxes(G, 1, 2)
    nees = (off * np.linalg.solve(C, off[..., None])[..., 0]).sum(-1) / 3
    percent = 100 / arm.length
    return percent * np.linalg.norm(off, axis=-1), percent * np.sqrt(np.trace(C, axis1=1, axis2=2)), nees


def by_minute(run: Run, found: Trajectory) -> pd.DataFrame:
    """Return the root mean square error of the tip [%] and the mean NEES, minute by minute."""
    error, _, nees = tip_errors(run, found)
    table = pd.DataFrame({"square": error**2, "nees": nees}).groupby(run.times // 60).mean()
    minutes = 1 + np.arange(len(table))
    return pd.DataFrame({
        "minute": minutes, "tip_rmse_percent": np.sqrt(table["square"]), "nees": table["nees"]
    })  # fmt: skip


# Tables


def by_run(minutes: pd.DataFrame, last: int = LAST) -> pd.DataFrame:
    """Return the error of the tip [%] and the mean NEES over the last minutes, by run and method."""
    end = minutes[minutes["minute"] > minutes["minute"].max() - last]
    end = end.assign(tip_rmse_percent=end["tip_rmse_percent"] ** 2)
    means = end.groupby(["twin", "method"], sort=False)[["tip_rmse_percent", "nees"]].mean().reset_index()
    return means.assign(tip_rmse_percent=np.sqrt(means["tip_rmse_percent"]))


HEADINGS = {
    "median_percent": "error, median [%]",
    "min_percent": "least [%]",
    "max_percent": "most [%]",
    "nees": "normalised error",
}


def by_method(runs: pd.DataFrame) -> pd.DataFrame:
    """Return median, least and largest error of the tip [%] and the mean NEES of all runs, by method."""
    tip = {f"{x}_percent": ("tip_rmse_percent", x) for x in ("median", "min", "max")}
    return runs.groupby("method", sort=False).agg(**tip, nees=("nees", "mean")).reset_index()


IN_SHORT = """
**What to see.** If sensors drift and the filter does not know it, the error of the tip in the last third of 45
minutes is {{ once | fixed(1) }} % of the length. With the drift in the state of the filter it is
{{ own | fixed(1) }} %, and the stated uncertainty is
{{ "about right" if 0.5 < nees < 1.5 else "too small" if nees > 1 else "too large" }}. It takes both kinds of sensors:
with the drift in the state, magnets alone still have {{ magnets | fixed(1) }} %. **Two things favour this filter:**
we told it the true size of each drift, and we chose the size of the offsets so that *calibrated once* ends at 2 to
4 % in other runs than those of the table.
"""


def in_words(table: pd.DataFrame) -> str:
    """Return what it gains to have the drift in the state."""
    error, nees = (table.set_index("method")[column] for column in ("median_percent", "nees"))
    own = "self-calibrating"
    return sentences(
        IN_SHORT, once=error["fused"], own=error[own], nees=nees[own], magnets=error[f"magnets {own}"]
    )


COLUMNS = """
Error of the tip in the last {{ last }} minutes, root mean square; 1 % is 3.3 mm. *Calibrated once:* magnets and IMUs,
drift ignored. *Drift in the state:* the method of this page; *magnets, drift in state:* the same without IMUs.
*Knows the drift:* the same filter on sensors without drift, the best we can hope for.
*Normalised error:* squared error over stated variance, mean; 1 is perfect,
{{ nees | fixed(0) }} means errors about {{ times | fixed(0) }} times as large as stated.
"""


def of_columns(table: pd.DataFrame) -> str:
    """Return what methods and columns of the table mean."""
    nees = table.set_index("method").loc["fused", "nees"]
    return sentences(COLUMNS, last=LAST, nees=nees, times=math.sqrt(nees))


LEARNT = {
    "moments [%]": (0, 100.0),
    "offset of sensor 5 [mT]": (14, 1.0),
    "heading of IMU 3 [°]": (21, math.degrees(1)),
}
"""Errors that the page draws: which of the state, and their unit."""


def learnt(run: Run, found: Trajectory) -> pd.DataFrame:
    """Return three true errors of sensors with their estimates and deviations, once a minute."""
    estimate, std = found.details["drift"], found.details["drift_std"]
    minutes = np.arange(1, len(run.times) // 60 + 1)
    parts = []
    for name, (k, unit) in LEARNT.items():
        columns = {"truth": run.errors[:, k], "estimate": estimate[:, k], "std": std[:, k]}
        part = {column: unit * values[59::60] for column, values in columns.items()}
        parts.append(pd.DataFrame(part | {"error": name, "minute": minutes}))
    return pd.concat(parts)
