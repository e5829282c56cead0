"""A robot whose sensors drift for 45 minutes: its readings, and five ways to follow it. Synthetic.

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
from magpylib.func import dipole_field
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from repro import Drift, Drifting, Imu, KalmanFilter, Robot, simulated_readings
from repro.estimators.monitor import INCONSISTENT, Monitor
from repro.estimators.track import Trajectory
from repro_companion.papers import baaij, martin

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
IRON_A_M2, IRON_M, IRON_S = 1.0, 0.13, 60.0
"""Moment of a magnetised tool, its distance from the axis of the robot, and how long it stays."""


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
    iron_s: tuple[float, float]
    """When the iron begins to come, and when it is gone [s]."""


def draw(seed: int, minutes: float = MINUTES, size: float = 1.0) -> Run:
    """Draw motion, drift of so many times its size, and readings.

    In a run of less than 20 minutes the iron comes in its middle third.
    """
    generators = [np.random.default_rng([45, seed, k]) for k in range(5)]
    arm, times = robot(), np.arange(round(60 * minutes * RATE_HZ)) / RATE_HZ
    q, errors = motion(times, generators[0]), size * drift(len(times), generators[1])
    moment, gain, offset, heading, tilt = np.split(errors, [1, 10, 19, 22], axis=1)
    foreign, iron_s = foreign_readings(arm, q, times, generators[2])
    u = simulated_readings(arm, q)
    hall = (1 + gain) * ((1 + moment) * u[:, :9] + foreign) + offset
    hall += baaij.NOISE_MT * generators[3].standard_normal(hall.shape)

    each = (len(times), 3, 3)
    lean = np.zeros(each)
    lean[..., :2] = tilt.reshape(-1, 3, 2) + SWAY * fading((len(times), 3, 2), SWAY_S, generators[4])
    noise = IMU_NOISE * generators[4].standard_normal(each)
    turns = (noise, heading[..., None] * [0.0, 0.0, 1.0], lean, u[:, 9:])
    noisy, turned, leant, true = (Rotation.from_rotvec(x.reshape(-1, 3)) for x in turns)
    imus = (noisy * turned * leant * true).as_rotvec().reshape(-1, 9)
    return Run(*(x[::EVERY] for x in (times, q, np.hstack([hall, imus]), errors)), iron_s)


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


def foreign_readings(
    arm: Robot, q: np.ndarray, times: np.ndarray, generator: np.random.Generator
) -> tuple[np.ndarray, tuple[float, float]]:
    """Return what the Hall sensors read of the Earth and of a tool ``[t, 9]`` [mT], and when the tool is near.

    It comes within five seconds from a metre away, at the height of the first segment, stays, and goes.
    """
    last = times[-1]
    start = generator.uniform(*((last / 3, last * 2 / 3) if last < 1200 else (300.0, 0.95 * last)))
    azimuth, direction = generator.uniform(0, 2 * np.pi), generator.standard_normal(3)
    near = np.clip(np.minimum(times - start, start + IRON_S - times) / 5.0, 0.0, 1.0)
    away = (1.0 - (1.0 - IRON_M) * near**2 * (3 - 2 * near))[:, None, None]
    place = away * [math.cos(azimuth), math.sin(azimuth), 0.0] + [0.0, 0.0, 0.08]
    T = arm.poses(q, [sensor.place for sensor in arm.sensors])
    moment = IRON_A_M2 * direction / np.linalg.norm(direction)
    field = 1e3 * dipole_field("B", (T[..., :3, 3] - place).reshape(-1, 3), moment).reshape(-1, 9, 3)
    field[near == 0] = 0.0
    return (T[..., :3, 2] * (field + EARTH)).sum(-1), (start, start + IRON_S)


# Following the robot

CHANCE, AGREES, CALM_S = 1e-8, 1e-3, 10.0
"""Chance of a false alarm at a row; Hall sensors agree with the IMUs above this chance, and must for so long [s]."""
SWAYING = Drift("tilt", SWAY, SWAY * math.sqrt(2 / SWAY_S), time_s=SWAY_S)


def drifts(believed: float = 1.0) -> list[Drift]:
    """Return what the filter believes to wander: by the true sizes, or so many times them."""
    walk = believed / math.sqrt(SIZE_S)
    return [
        Drift("moment", 0.0, 3 * walk * abs(WARMING), shared=True),  # a walk lags behind what goes one way
        Drift("gain", 0.0, walk * GAIN),
        Drift("offset", 0.0, walk * OFFSET),
        Drift("heading", 0.0, walk * HEADING),
        # An error that fades in T, less what it was at the start, has the variance of one that fades in 2 T.
        Drift("tilt", 0.0, believed * TILT * math.sqrt(2 / TILT_S), time_s=2 * TILT_S),
        SWAYING,
    ]


def kalman_filter(wander: Sequence[Drift]) -> KalmanFilter:
    """Return a filter of the robot; if nothing wanders, the sway of the IMUs counts as white noise."""
    arm, (low, high) = robot(), baaij.bounds(3)
    sensing = Drifting(arm.sensing(), wander) if wander else arm.sensing()
    noise = np.repeat([baaij.NOISE_MT, IMU_NOISE if wander else SWAY], 9)
    return KalmanFilter(sensing, low, high, noise, 0.6 * (high - low), 0.5 * (high - low))


def follow(method: KalmanFilter, run: Run) -> Trajectory:
    """Follow a robot, and leave its Hall sensors out while a field that no error explains bends the shape.

    That is so if the sway that the readings ask for is beyond chance, or if the monitor finds them inconsistent twice
    within ten seconds; once may be a glitch. Then lasting errors stay as they were known, and everything else begins
    anew from the IMUs at every row, until the Hall sensors have agreed with them for a while.
    """
    watched, only_imus, rows = Monitor(method), np.arange(18) >= 9, []
    state, agreed_s, before, odd_s = watched.init(START), CALM_S, 0.0, -CALM_S
    fresh, errors = state.inner, slice(method.n_q, method.n_q + len(method.drift_std))
    lasting = slice(method.n_q, errors.stop - 6)
    for u, t in zip(run.readings, run.times.tolist(), strict=True):
        count = agreed_s >= CALM_S  # the Hall sensors do
        after, found = watched.step(state, u, t, mask=None if count else only_imus)
        sway, odd = (found.details["drift"][-6:] / SWAY) ** 2, found.details["status"] == INCONSISTENT
        if count and (sway.sum() > chi2.isf(CHANCE, 6) or (odd and t - odd_s < CALM_S)):
            count, agreed_s = False, 0.0
        odd_s = t if odd else odd_s
        if not count:
            known = method.predicted(state.inner, t)
            q, P = fresh.q.copy(), fresh.covariance.copy()
            q[lasting], P[lasting, lasting] = known.q[lasting], known.covariance[lasting, lasting]
            anew = fresh._replace(q=q, covariance=P)
            found = method.step(anew, u, t, mask=only_imus)[1]
            after = after._replace(inner=anew._replace(t=t))
            surprise = method.step(anew, u, t)[1].chi2 - found.chi2
            agreed_s = agreed_s + t - before if surprise <= chi2.isf(AGREES, 9) else 0.0
        elif odd:  # the monitor goes on without a reading, and the IMUs know more than that
            found = method.step(state.inner, u, t, mask=only_imus)[1]
        state, before = after, t
        std = np.sqrt(np.diagonal(state.inner.covariance))[errors]
        rows.append((*found[:6], state.inner.q[errors], std, "consistent" if count else "left out"))
    *fields, drifted, std, status = (np.array(x) for x in zip(*rows, strict=True))
    return Trajectory(run.times, *fields, {"drift": drifted, "drift_std": std}, status)


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
    """Return the error of the tip [%], NEES, and seconds: with iron near, with an alarm then, with an alarm else.

    In the 15 s after the iron has gone an alarm counts as neither.
    """
    error, _, nees = tip_errors(run, found)
    near, later = ((run.times >= run.iron_s[0]) & (run.times < run.iron_s[1] + more) for more in (0.0, 15.0))
    alarm = np.isin(found.status, ("left out", "inconsistent"))
    seconds = {"iron_s": near, "flag_iron_s": alarm & near, "flag_else_s": alarm & ~later}
    table = pd.DataFrame({"square": error**2, "nees": nees, **seconds}).groupby(run.times // 60)
    means = pd.DataFrame({"tip_rmse_percent": np.sqrt(table["square"].mean()), "nees": table["nees"].mean()})
    whole = means.join(table[list(seconds)].sum() * (run.times[1] - run.times[0])).rename_axis("minute")
    return whole.reset_index().assign(minute=lambda x: x["minute"].astype(int) + 1)


# Tables


def by_run(minutes: pd.DataFrame, last: int = LAST) -> pd.DataFrame:
    """Return the error of the tip [%] and the mean NEES over the last minutes, by run and method."""
    end = minutes[minutes["minute"] > minutes["minute"].max() - last]
    end = end.assign(tip_rmse_percent=end["tip_rmse_percent"] ** 2)
    means = end.groupby(["twin", "method"], sort=False)[["tip_rmse_percent", "nees"]].mean().reset_index()
    return means.assign(tip_rmse_percent=np.sqrt(means["tip_rmse_percent"]))


def iron(minutes: pd.DataFrame) -> pd.DataFrame:
    """Return error of the tip [%] and NEES in the minute with most iron, and alarms then and else [s], by run."""
    groups = minutes.groupby(["twin", "method"], sort=False)
    most = minutes.loc[groups["iron_s"].idxmax()].set_index(["twin", "method"])[["tip_rmse_percent", "nees"]]
    return most.join(groups[["flag_iron_s", "flag_else_s"]].sum()).reset_index()
