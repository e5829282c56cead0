"""Mitchell et al. 2021: the module with one magnet and one sensor, its simulated curves, and the filters on them."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from datetime import datetime, timedelta, timezone
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from scipy.spatial.transform import Rotation

from repro import (
    BendSensor,
    ConstantCurvature,
    Cube,
    KalmanFilter,
    LevenbergMarquardt,
    Magnet,
    ParticleFilter,
    Robot,
    Sensor,
    simulated_readings,
    track,
)
from repro.common import bad_input, require
from repro.estimators.base import Estimate
from repro.estimators.particle import BendDisc
from repro.motion_capture import Motion as MotionCapture
from repro.motion_capture import read_motion, undo_exchanges
from repro_board.lag import search_lag
from repro_companion.papers.fetch import read_sources
from repro_companion.run import digest, project_folder, recordings_folder
from repro_companion.show import number, ratio_interval

LENGTH = 15e-3
"""Length of the arc from sensor to magnet, section III-A [m]; 14 mm in the released simulations."""
CUBE = Cube(6.35e-3, 1320.0)
"""K&J B444B, a cube of 1/4 inch, magnetised along the arc."""
LARGEST_BEND = math.pi / 2
SENSOR_NOISE_MT = 0.025
"""Noise of the real sensor for each axis: 0.021 to 0.026 mT in the recordings at rest."""
SIGMA_MT = 0.01
"""The sigma of eq. (1) in the released code; the paper gives none."""
CURVES = ("spiral", "flower", "seagull")
STEP = 0.01
"""Increment of the parameter t of the curves, which has no unit."""


# The module and the curves, section II


def robot(length: float = LENGTH) -> Robot:
    """Return the module: an arc with the cube at its end, and a sensor of three axes at its base."""
    arc = ConstantCurvature(length, radius=1.0, extensible=False)  # its coordinates are the bend vector [rad]
    return Robot([arc], [Magnet(CUBE, segment=1, at=length)], [Sensor(segment=0, at=0.0, axes=3)])


def bend_vector(angle: Any, direction: Any) -> np.ndarray:
    """Return bend vectors ``[..., 2]`` [rad]; a negative angle bends the other way."""
    return np.stack([angle * np.cos(direction), angle * np.sin(direction)], axis=-1)


def times() -> np.ndarray:
    """Return the parameter of the curves: 3,142 values from 0 to 10 pi."""
    return np.arange(0, 10 * math.pi, STEP)


def curve(name: str) -> np.ndarray:
    """Return a curve of section II-D as bend vectors ``[t, 2]`` [rad], eqs (5) to (7)."""
    t = times()
    angle, direction = {
        "spiral": (0.03 * t, t),
        "flower": (np.sin(t), (0.1 * t) ** 2),
        "seagull": (np.abs(np.sin(t)), np.sin(t) + math.pi / 2),
    }[name]
    return bend_vector(angle, direction)


def readings(
    q: np.ndarray, length: float = LENGTH, noise_mt: float = 0.0, generator: np.random.Generator | None = None
) -> np.ndarray:
    """Return synthetic readings ``[..., 3]`` [mT] at bend vectors, by magpylib, with white noise on every axis."""
    u = simulated_readings(robot(length), q)
    return u if generator is None else u + noise_mt * generator.standard_normal(u.shape)


def position_errors(found: np.ndarray, truth: np.ndarray, length: float = LENGTH) -> np.ndarray:
    """Return how far apart [mm] the magnet is at two bend vectors, the error of Fig. 5."""
    position = BendSensor(length).position
    return 1e3 * np.linalg.norm(position(found) - position(truth), axis=-1)


def particle_filter(
    process_noise_pi: Any, length: float = LENGTH, sigma_mt: float = SIGMA_MT, **how: Any
) -> ParticleFilter:
    """Return the filter of section II, with whatever is changed; several process noises [pi rad] are a batch."""
    width = np.pi * np.asarray(process_noise_pi, dtype=float)[..., None] * np.ones(2)
    how = {"estimate": "best tenth", "resampling": "multinomial", **how}
    return ParticleFilter(
        BendSensor(length, CUBE), width, sigma_mt / math.sqrt(2), BendDisc(LARGEST_BEND), **how
    )


# Errors on the curves, section II-D


@dataclass(frozen=True)
class Setting:
    """A way to follow the curves, and what it is given."""

    name: str
    process_noise_pi: float = 0.02
    """Standard deviation of what moves a particle in one step, or changes its velocity [pi rad]."""
    length: float = LENGTH
    noise_mt: float = 0.0
    """Of the readings, for each axis; the filter knows it."""
    particles: int = 1000
    how: tuple[str, ...] = ("best tenth", "multinomial", "random walk")
    """Estimate, resampling and motion of a particle filter, or the name of another method."""

    def method(self, batch: int = 1) -> Any:
        """Return the estimator."""
        bound = np.full(2, LARGEST_BEND)
        if self.how == ("least squares",):
            return LevenbergMarquardt(BendSensor(self.length, CUBE), -bound, bound, noise=self.noise_mt)
        if self.how == ("Kalman filter",):
            # The parameter t of the curves counts as time: its steps of 0.01 turn noise per step into noise per time.
            change = np.full(2, self.process_noise_pi * math.pi / STEP**1.5)
            return KalmanFilter(
                BendSensor(self.length, CUBE),
                -bound,
                bound,
                self.noise_mt,
                change,
                velocity=np.ones(2),
                iterations=5,
            )
        sigma = math.sqrt(2) * self.noise_mt or SIGMA_MT
        estimate, resampling, motion = self.how
        return particle_filter(
            np.full(batch, self.process_noise_pi),
            self.length,
            sigma,
            particles=self.particles,
            estimate=estimate,
            resampling=resampling,
            motion=motion,
        )


OURS = ("weighted", "systematic", "constant velocity")
PRINTED = Setting("as printed")
"""The paper's equations at its process noise; it states no sigma."""
FITS = replace(PRINTED, name="fits, not stated", process_noise_pi=0.005, length=14e-3)
"""The same with the process noise and the length of the released simulations."""
NOISY = replace(PRINTED, name="best tenth, sensor noise", noise_mt=SENSOR_NOISE_MT)
BEST = replace(
    NOISY, name="weighted mean, constant velocity, sensor noise", process_noise_pi=0.0005, how=OURS
)
"""Process noise and motion have the smallest error on Spiral among those of the study."""
KALMAN = replace(BEST, name="Kalman filter, sensor noise", particles=0, how=("Kalman filter",))
SINGLE = replace(NOISY, name="least squares, sensor noise", particles=0, how=("least squares",))
NOISES_PI = (0.0005, 0.001, 0.002, 0.005, 0.01, 0.02)
STUDY_SEEDS = range(10)


def follow(
    setting: Setting, seed: int = 0, steps: int | None = None, curves: Sequence[str] = CURVES
) -> np.ndarray:
    """Return the errors ``[t, curves]`` [mm] of a method that starts straight, where the curves start."""
    q = np.stack([curve(name) for name in curves], axis=1)[:steps]
    u = readings(q, setting.length, setting.noise_mt, np.random.default_rng(seed))
    found = track(setting.method(), u, np.zeros((len(curves), 2)), times=times()[:steps], seed=seed)
    return position_errors(found.q, q, setting.length)


def errors_over_time(errors: dict[tuple[Setting, str], np.ndarray]) -> pd.DataFrame:
    """Return errors ``[t]`` [mm] by setting and curve as one table."""
    t, tables = times(), []
    for (setting, name), error in errors.items():
        run = {"setting": setting.name, "process_noise_pi": setting.process_noise_pi}
        run |= {"particles": setting.particles}
        tables.append(pd.DataFrame({"curve": name, "t": t[: len(error)], "error_mm": error, **run}))
    return pd.concat(tables, ignore_index=True)


def summary(table: pd.DataFrame) -> pd.DataFrame:
    """Return root mean square, mean and largest error of each run in a table of errors over time."""
    by = table.assign(square=table["error_mm"] ** 2).groupby(
        ["setting", "process_noise_pi", "particles", "curve"], sort=False
    )
    found = by.agg(rmse_mm=("square", "mean"), mean_mm=("error_mm", "mean"), worst_mm=("error_mm", "max"))
    return found.assign(rmse_mm=found["rmse_mm"] ** 0.5).reset_index()


def study(seeds: Sequence[int] = STUDY_SEEDS) -> list[tuple[Setting, int]]:
    """Return what the committed study runs: six methods, and process noises and numbers of particles."""
    few = [100 + seed for seed in seeds[:3]]  # what is chosen is not reported on the same draws
    tasks = [(s, seed) for s in (PRINTED, FITS, NOISY, BEST, KALMAN, SINGLE) for seed in seeds]
    for noise_pi in NOISES_PI:
        for motion in ("random walk", "constant velocity"):
            walk = replace(BEST, name=motion, process_noise_pi=noise_pi, how=(*OURS[:2], motion))
            tasks += [(walk, seed) for seed in few]
        walk = replace(PRINTED, name="process noise", process_noise_pi=noise_pi)
        tasks += [(walk, seed) for seed in few]
    counts = (30, 100, 300, 3000)
    return tasks + [(replace(PRINTED, name="count", particles=n), seed) for n in counts for seed in few]


def study_rows(setting: Setting, seed: int) -> list[tuple[Any, ...]]:
    """Return the errors of one run of the study, a row for each curve."""
    rmse = np.sqrt((follow(setting, seed) ** 2).mean(axis=0))
    run = (setting.name, setting.process_noise_pi, setting.particles)
    return [(*run, name, seed, x) for name, x in zip(CURVES, rmse, strict=True)]


STUDY_COLUMNS = ["setting", "process_noise_pi", "particles", "curve", "seed", "rmse_mm"]


def law_mm(process_noise_pi: Any, particles: Any = 1000, length: float = LENGTH) -> Any:
    """Return the error [mm] of the best tenth of a cloud much wider than the likelihood, near the straight arc."""
    width = process_noise_pi * math.pi * 1e3 * length / 2
    return math.sqrt(math.log(10 / 9)) * width / np.sqrt(particles / 10)


def over_seeds(table: pd.DataFrame) -> pd.DataFrame:
    """Return mean and standard deviation of the study's errors over the seeds."""
    by = table.groupby(STUDY_COLUMNS[:4], sort=False)["rmse_mm"]
    return by.agg(rmse_mm="mean", rmse_std_mm="std", seeds="count").reset_index()


def gain(table: pd.DataFrame, method: str, other: str) -> pd.DataFrame:
    """Return by curve how many times the error of another method one has, with a paired bootstrap (95 %)."""
    lines = []
    for name in CURVES:
        own = table[table["curve"] == name].pivot_table(index="seed", columns="setting", values="rmse_mm")
        a, b = own[method].dropna().to_numpy(), own[other].dropna().to_numpy()
        lines.append((name, method, other, a.mean() / b.mean(), *ratio_interval(a, b)))
    return pd.DataFrame(lines, columns=["curve", "setting", "than", "ratio", "ratio_low", "ratio_high"])


def gain_in_words(table: pd.DataFrame) -> str:
    """Return what our filter gains, on the curves that had no part in its choice, and a Kalman filter beside it."""
    ratio = table.set_index(["setting", "curve"])["ratio"]
    flower, seagull = (100 * ratio[BEST.name, name] for name in ("flower", "seagull"))
    less = [100 - 100 * ratio[KALMAN.name, name] for name in ("flower", "seagull")]
    sizes = "{} % smaller still on Flower, and {} % on Seagull".format(*(number(x, 1) for x in less))
    return (
        f"**Our best filter has {flower:.0f} % of the error of least squares on single readings on Flower, and"
        f" {seagull:.0f} % on Seagull.** Neither curve was used to choose its noise."
        f" The error of a Kalman filter with the same noises is {sizes if min(less) > 0 else 'not smaller on both'}."
    )


def segments_in_words(table: pd.DataFrame) -> str:
    """Return what a cloud of a thousand and least squares find with six unknowns and more, and what to use there."""
    many = table[table["unknowns"] >= 6]
    worth = many["effective"].max()
    found = [
        f"{number(many[x].min(), 2)} to {number(many[x].max(), 2)} mm" for x in ("1000", "least squares")
    ]
    return (
        "**More segments.** The authors expect that their filter extends to several magnets and sensors (section V)."
        " On the arms of Table 1 of Baaij et al., with six and nine unknowns, a cloud of a thousand"
        f" particles is worth {'a single one' if worth < 1.5 else f'at most {worth:.1f} particles'}. Its tip error is"
        f" {found[0]}, and the error of least squares is {found[1]}. Use least squares there, or a"
        " Kalman filter if the arm moves smoothly."
    )


PRINTED_WORDS = (
    "as printed: process noise 0.02 pi, L = 15 mm, noise-free; sigma 0.01 mT is not stated; start straight"
)
BEST_METHOD = (
    "weighted mean, constant velocity, 0.0005 pi (chosen on Spiral), 1000 particles; "
    "sensor noise 0.025 mT per axis, start straight, mean of ten seeds"
)


def changed(own: Setting, steps: int) -> str:
    """Return what a run has that is not as printed, for the scorecard."""
    differing = {
        f"process noise {own.process_noise_pi:g} pi": own.process_noise_pi != PRINTED.process_noise_pi,
        f"L = {1e3 * own.length:g} mm": own.length != PRINTED.length,
        f"{steps} steps": steps < len(times()),
    }
    return "".join(f"; here {words}" for words, differs in differing.items() if differs)


def scorecard_rows(table: pd.DataFrame, means: pd.DataFrame, changed: str = "") -> pd.DataFrame:
    """Return the rows of sections II-D and IV from a page's errors and the study's means over seeds."""
    lines = []
    own = means.set_index(["setting", "curve"])["rmse_mm"]
    for line in table[(table["setting"] == PRINTED.name) & (table["particles"] == 1000)].itertuples():
        fits = own[FITS.name, line.curve]
        note = f"the same equations at 0.005 pi and L = 14 mm, which fit but are not stated: {fits:.4f} mm"
        lines.append(
            {"artefact": "Section II-D", "row": line.curve, "quantity": "rmse_position", "unit": "mm"}
            | {"regenerated": line.rmse_mm, "n_seeds": 1, "setting": PRINTED_WORDS + changed, "note": note}
            | {"best": own[BEST.name, line.curve], "best_method": BEST_METHOD}
        )
    measured = pd.read_csv(project_folder() / "data" / "benchmark.csv").set_index("capability")["figure"]
    note = (
        "updates per second of one core's processor time;"
        " we take the printed 60 Hz to be the rate of the sensor (inferred)"
    )
    lines.append(
        {"artefact": "Section IV", "row": "1000 particles", "quantity": "update_rate", "unit": "Hz"}
        | {"regenerated": measured[UPDATES], "setting": "benchmark", "note": note}
    )
    return pd.DataFrame(lines).assign(paper="mitchell2021")


UPDATES = "ParticleFilter, N = 1000 [updates/s]"
"""Name of the update rate among the measured times."""


# Bend tests and light bulb, section IV: what is in the files

FOLDER = "mitchell2021"
RECORDED_LENGTH = 13e-3
"""Length of the arc in the released code for recorded data [m]."""
MT_PER_UNIT, LARGEST_UNIT = 10.0, 8.192
"""Unit of the files: 1000 steps of 0.01 mT; the components have 14 bits with sign."""
MODEL_FROM_FILE = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, -1.0], [-1.0, 0.0, 0.0]])
"""In the files x is along the body; the magnet points the other way, and y is mirrored."""
ZONE = timezone(timedelta(hours=-5))
"""Of the start times of the motion capture."""
REST_S, LIVE_S, LONGEST_BUFFER = 2.0, 1e-3, 25
BODY, PAD_S, LEAST_LOGGED = "Module", 5.0, 0.9


class Hall(NamedTuple):
    """Readings of the Hall sensor, and what was left out of them."""

    time_s: np.ndarray
    """Since 1970."""
    u: np.ndarray
    """Flux density ``[t, 3]`` [mT] in the axes of the model, as sent."""
    facts: dict[str, int]

    @property
    def ratio(self) -> np.ndarray:
        """Fields across over along the body."""
        return ratio(self.u)


def ratio(u: np.ndarray) -> np.ndarray:
    """Return the fields across over the field along the body, x and y as one complex number."""
    return (u[..., 0] + 1j * u[..., 1]) / u[..., 2]


def median(z: np.ndarray) -> complex:
    """Return the median of complex numbers, real and imaginary parts apart."""
    return complex(np.median(z.real), np.median(z.imag))


def read_hall(path: Path) -> Hall:
    """Read a file of the Hall sensor, rows ``[x y z],unix_time``; what a buffer held at the start is dropped."""
    lines = path.read_text(encoding="utf-8", errors="replace").splitlines()
    cells = [re.split(r"[\[\],\s]+", line.strip()) for line in lines]
    numbers = pd.DataFrame([row[1:] for row in cells if len(row) == 5], columns=range(4), dtype=object)
    table = numbers.apply(pd.to_numeric, errors="coerce").to_numpy(float)
    table = table[np.isfinite(table).all(axis=1)]
    steps, n = np.diff(table[:, 3]), len(lines)
    live = np.flatnonzero(steps > LIVE_S)
    require(
        len(live), "rows", path.name, "readings, two of them a millisecond apart", f"{len(table)} readings"
    )
    require((steps > 0).all(), "times", path.name, "increasing", "a step back")
    drained, unreadable = int(live[0]) + 1, n - len(table)
    table = table[drained:]
    outside = (np.abs(table[:, :3]) > LARGEST_UNIT).any(axis=1)
    u = MT_PER_UNIT * table[~outside, :3] @ MODEL_FROM_FILE.T
    for what, count, allowed in (("unreadable or beyond the range", unreadable + int(outside.sum()), 0),
                                 ("out of a buffer", drained, LONGEST_BUFFER)):  # fmt: skip
        require(count <= max(n / 20, allowed), "rows", path.name, f"at most 5 % {what}", f"{count} of {n}")
    # The sensor switches its own gain, so that all components jump by one factor.
    switches = int((np.abs(np.diff(np.log(np.linalg.norm(u, axis=1)))) > 0.1).sum())
    facts = {
        "buffered": drained,
        "unreadable": unreadable,
        "beyond_range": int(outside.sum()),
        "gain_switches": switches,
    }
    return Hall(table[~outside, 3], u, facts)


class Motion(NamedTuple):
    """Motion of the module by motion capture, and what was done about exchanged markers."""

    start_s: float
    """Since 1970."""
    rate_hz: float
    q: np.ndarray
    """Bend vector [rad] as a complex number, by the tilt of the y axis, which is up; NaN where masked."""
    tilt_z: np.ndarray
    facts: dict[str, float]


SHAKE, GUARD = np.radians(2.0), 6
"""Turn from one frame to the next that a bending module does not make [rad]; frames masked on either side of it."""


def motion(take: MotionCapture) -> Motion:
    """Return the bend of the module from motion capture."""
    require(BODY in take.bodies, "body", take.name, BODY, ", ".join(take.bodies))
    if take.started is None:
        raise bad_input("Capture Start Time", take.name, "in the header", "nothing")
    poses, n = take.bodies[BODY], len(take.times) + take.missing
    turned, undone = undo_exchanges(poses[:, :4])
    jumps = 2 * np.arccos(np.minimum(np.abs((turned[1:] * turned[:-1]).sum(axis=1)), 1.0)) > SHAKE
    turned[np.convolve(np.r_[False, jumps], np.ones(2 * GUARD))[GUARD : GUARD + len(turned)] > 0] = np.nan
    seen = np.isfinite(turned[:, 0])
    axes = np.full((len(turned), 3, 3), np.nan)
    axes[seen] = Rotation.from_quat(turned[seen]).as_matrix()
    upright = np.degrees(np.arccos(axes[seen][0, 1, 1]))
    require(upright < 45, "first frame", take.name, "upright within 45 deg", f"{upright:.1f} deg")
    tilt, tilt_z = np.arccos(np.clip(axes[:, [1, 2], [1, 2]], -1.0, 1.0)).T
    q, high = tilt * np.exp(1j * np.arctan2(axes[:, 0, 1], axes[:, 2, 1])), tilt > np.radians(40)
    # The place of the body hardly depends on which marker is which: it says whether the tilt is right.
    moved = np.linalg.norm(poses[seen][:, [4, 6]] - poses[seen][0, [4, 6]], axis=1)
    powers, degrees = (moved / max(moved.max(), 1e-9))[:, None] ** np.arange(1, 6), np.degrees(tilt[seen])
    off = degrees - powers @ np.linalg.lstsq(powers, degrees)[0]
    facts = {
        "frames": n,
        "undone": int(undone.sum()),
        "undone_above_40_percent": 100 * float(undone[high].mean()) if high.any() else 0.0,
        "masked_percent": 100 * (1 - seen.sum() / n),
        "off_displacement_deg": float(np.sqrt((off**2).mean())),
    }
    return Motion(take.started.replace(tzinfo=ZONE).timestamp(), take.rate_hz, q, tilt_z, facts)


# One take: both, on one clock


@dataclass(frozen=True, eq=False)
class Take:
    """A bend test on the clock of the Hall sensor, where motion capture runs."""

    name: str
    time_s: np.ndarray
    u: np.ndarray
    """Readings ``[t, 3]`` [mT] in the axes of the model, as sent."""
    ratio: np.ndarray
    """Field across over field along the body, less its median over the first two seconds."""
    rest_mt: np.ndarray
    """Mean of the first hundred readings, which the released code subtracts across the body."""
    q: np.ndarray
    """Bend vector [rad] by motion capture, complex; NaN where masked."""
    tilt_z: np.ndarray
    log: np.ndarray | None
    """Output of the authors' filter, complex bend vectors [rad]; NaN where it has none."""
    facts: dict[str, float]

    @property
    def test(self) -> str:
        """Number of the test: one direction each."""
        return self.name[5]


def aligned(name: str, hall: Hall, motion: Motion, log: pd.DataFrame | None = None) -> Take:
    """Bring motion capture onto the clock of the Hall sensor: there is no common trigger, so we search the lag."""
    start, rate, n = hall.time_s[0], motion.rate_hz, len(motion.q)
    t = hall.time_s - start
    relative = hall.ratio - median(hall.ratio[t < REST_S])
    pad = round(PAD_S * rate)
    at = motion.start_s - start + np.arange(-pad, n + pad) / rate
    k = np.searchsorted((t[1:] + t[:-1]) / 2, at)
    read = np.where(np.abs(t[k] - at) < 1.5 * np.median(np.diff(t)), relative[k], np.nan)
    pairs = [np.column_stack([x.real, x.imag]) for x in (np.pad(motion.q, pad, constant_values=np.nan), read)]
    lag = search_lag(*pairs, rate)
    frame = np.rint((t - lag.lag_s - motion.start_s + start) * rate).astype(int)
    own = (frame >= 0) & (frame < n)
    frame = frame[own]
    longest = float(np.diff(t[own]).max())
    facts = {"readings": int(own.sum()), **hall.facts, **motion.facts, "lag_s": lag.lag_s,
             "lag_residual": lag.best / lag.spread, "longest_gap_s": longest}  # fmt: skip
    logged = None if log is None else on_readings(log, t)[own]
    if logged is not None and np.isfinite(logged).mean() < LEAST_LOGGED:
        logged = None
    return Take(name, t[own], hall.u[own], relative[own], hall.u[:100].mean(axis=0), motion.q[frame],
                motion.tilt_z[frame], logged, facts)  # fmt: skip


def on_readings(log: pd.DataFrame, t: np.ndarray) -> np.ndarray:
    """Return the authors' output at the times of the readings, by its own clock; NaN where it has no row."""
    own = log["time"].to_numpy()
    sample = own[np.linspace(0, len(own) - 1, 200).astype(int)]
    offsets = t - own[len(own) // 2]

    def nearest(x: np.ndarray, of: np.ndarray) -> np.ndarray:
        return np.searchsorted((of[1:] + of[:-1]) / 2, x)

    at = sample + offsets[:, None]
    offset = offsets[(np.abs(t[nearest(at, t)] - at) < LIVE_S).sum(axis=1).argmax()]
    k = nearest(t - offset, own)
    q = log["bend_ang"].to_numpy() * np.exp(
        1j * (np.pi - log["bend_dir"].to_numpy())
    )  # their y is not mirrored
    return np.where(np.abs(own[k] + offset - t) < LIVE_S, q[k], np.nan)


def recorded_takes() -> list[Take]:
    """Return the bend tests of which both recordings are in REPRO_DATA_DIR."""
    folder, found = recordings_folder() / FOLDER, []
    for name in (f"{test}_try_{attempt}" for test in range(6) for attempt in (1, 2)):
        hall, capture = folder / f"experiment_data/bend_test_{name}.csv", folder / f"mocap/bend_{name}.csv"
        log = folder / f"filter_readings/bend_{name}.csv"
        if hall.is_file() and capture.is_file():
            logged = pd.read_csv(log) if log.is_file() else None
            found.append(aligned(f"bend_{name}", read_hall(hall), motion(read_motion(capture)), logged))
    return found


def unlike_released() -> list[str]:
    """Return which recordings of section IV are not those that the authors released, by their hashes."""
    listed = read_sources(project_folder() / "data" / "sources.json", FOLDER)
    found = [source for source in listed if not source.path.startswith("calibrate")]
    return [one.path for one in found if digest(recordings_folder() / one.name) not in ("", one.sha256)]


# SYNTHETIC takes: what a sensor and motion capture would have seen of a module that bends as told

TRANSVERSE_GAIN, TILTED_MT, TURNED, LAG_S, RATE_HZ = 1.2, (0.3, -0.5), 0.4, 0.5, 61.0
"""Invented: gain across over along the body, field of a tilted magnet, azimuth of the capture, lag, rate."""
START_S, HEIGHT = 1.6e9, 0.116
SYNTHETIC = ((0, 1), (0, 2), (2, 1), (4, 1))
"""Tests and tries."""
EVENTS = {"light_-1": (), "light_0": (10.0, 15.0, 20.0), "light_1": (9.0, 14.0, 20.0), "light_2": (15.0,)}
"""When the bulb is tightened in the synthetic files [s]."""
HALF_TURNED = Rotation.from_rotvec(np.radians(178.0) * np.array([0.0, 0.3, 0.954]))
"""The synthetic exchange of markers."""


def up_and_down(t: np.ndarray, duration_s: float) -> np.ndarray:
    """Return the bend [rad] of a module that rests for 4 s, rises to 50 deg and falls again."""
    return np.radians(50.0) * np.sin(np.pi * np.clip((t - 4.0) / duration_s, 0.0, 1.0)) ** 2


def synthetic_hall(
    bend: Callable[[np.ndarray], np.ndarray], towards: float, duration_s: float, rng: np.random.Generator
) -> Hall:
    """Return readings of magpylib's field, with a sensor that is not as drawn, noise and steps of 0.01 mT."""
    steps = rng.uniform(0.8, 1.2, int(duration_s * RATE_HZ)) / RATE_HZ
    t = np.cumsum(steps) - steps[0]
    u = readings(bend_vector(bend(t), towards), RECORDED_LENGTH)
    u[:, :2] = TRANSVERSE_GAIN * u[:, :2] + TILTED_MT
    u += SENSOR_NOISE_MT * rng.standard_normal(u.shape) @ MODEL_FROM_FILE.T
    return Hall(
        START_S + t,
        np.round(u, 2),
        dict.fromkeys(("buffered", "unreadable", "beyond_range", "gain_switches"), 0),
    )


def synthetic_capture(q: np.ndarray) -> MotionCapture:
    """Return motion capture of bends, complex [rad], 120 a second; above 40 deg some markers are exchanged."""
    bend, about = np.abs(q), np.stack([np.cos(np.angle(q)), 0 * np.abs(q), -np.sin(np.angle(q))], axis=-1)
    turned = Rotation.from_rotvec(bend[:, None] * about)
    off = (bend > np.radians(40)) & (np.arange(len(q)) % 120 < 40)
    seen = np.where(off[:, None], (turned * HALF_TURNED).as_quat(), turned.as_quat())
    aside = HEIGHT * np.exp(1j * np.angle(q)) * bend / 2 * np.sinc(bend / 2 / np.pi) ** 2
    place = np.stack([aside.imag, HEIGHT * np.sinc(bend / np.pi), aside.real], axis=-1)
    poses = np.round(np.hstack([seen, place]), 6)
    started = datetime.fromtimestamp(START_S + 1.0 - LAG_S, ZONE).replace(tzinfo=None)
    return MotionCapture("synthetic", started, 120.0, np.arange(len(q)) / 120, {BODY: poses}, 0)


def synthetic_takes(seed: int = 0, duration_s: float = 12.0) -> list[Take]:
    """Return synthetic bend tests: 60 deg of direction from test to test."""
    takes = []
    for test, attempt in SYNTHETIC:
        rng, towards = np.random.default_rng([seed, test, attempt]), np.radians(60.0) * test
        hall = synthetic_hall(lambda t: up_and_down(t, duration_s), towards, duration_s + 8.0, rng)
        bend = up_and_down(np.arange(1.0, duration_s + 7.0, 1 / 120), duration_s)
        capture = synthetic_capture(bend * np.exp(1j * (towards + TURNED)))
        takes.append(aligned(f"bend_{test}_try_{attempt}", hall, motion(capture)))
    return takes


def synthetic_light(seed: int = 0) -> dict[str, Hall]:
    """Return synthetic light-bulb files: first the module moves and rests, in others it grasps and tightens."""

    def tightening(t: np.ndarray, events: Sequence[float]) -> np.ndarray:
        bumps = sum((np.exp(-(((t - at) / 0.5) ** 2)) for at in events), 0 * t)
        return np.radians(40.0 * np.clip((t - 3.0) / 2.0, 0.0, 1.0) + 8.0 * bumps)

    def hall(k: int, events: Sequence[float]) -> Hall:
        bend = (lambda t: tightening(t, events)) if events else lambda t: up_and_down(t, 11.0)
        return synthetic_hall(bend, np.radians(30.0), 30.0, np.random.default_rng([seed, 100 + k]))

    return {name: hall(k, events) for k, (name, events) in enumerate(EVENTS.items())}


def bend_takes(seed: int = 0) -> tuple[list[Take], str]:
    """Return the bend tests that are found in REPRO_DATA_DIR, else synthetic ones, and which these are."""
    found = recorded_takes()
    return (found, "recorded") if found else (synthetic_takes(seed), "synthetic")


def side_by_side(readings: Sequence[np.ndarray]) -> np.ndarray:
    """Return readings ``[t, axes]`` of takes as one array ``[t, take, axes]``; after its end a take has none."""
    table = np.full((max(map(len, readings)), len(readings), readings[0].shape[1]), np.nan)
    for k, u in enumerate(readings):
        table[: len(u), k] = u
    return table


def calibrations(take: Take, takes: Sequence[Take]) -> dict[str, list[Take]]:
    """Return the takes that may calibrate a take, by name; it is never among them."""
    same = [other for other in takes if other.test == take.test and other is not take]
    others = [other for other in takes if other.test != take.test]
    return {"none": []} | ({"other try": same} if same else {}) | ({"other tests": others} if others else {})


# Fig. 9 as tables


class Run(NamedTuple):
    """What one method found on one take."""

    method: str
    calibration: str
    length_mm: float
    take: Take
    q: np.ndarray
    """Bend vectors [rad], complex."""
    deviation: np.ndarray | None = None
    """Standard deviation of the bend [rad] that the method states."""

    @property
    def name(self) -> str:
        """The method as a reader sees it."""
        label = METHODS[self.method, self.calibration]
        return f"{label}, {self.length_mm:g} mm" if self.method.startswith("paper") else label

    @property
    def turned(self) -> np.ndarray:
        """Direction beyond that of motion capture, as complex numbers of size one, where the bend is large enough."""
        bent = (np.abs(self.take.q) >= np.radians(LEAST_BEND_DEG)) & np.isfinite(self.q)
        return np.exp(1j * np.angle(self.q[bent] / self.take.q[bent]))


LEAST_BEND_DEG = 20.0
"""Directions are compared from this bend on."""
METHODS = {
    ("motion capture", "none"): "motion capture",
    ("paper, printed noise", "none"): "paper's filter, printed noise",
    ("paper, as released", "none"): "paper's filter, as released",
    ("authors' output", "none"): "authors' own output",
    ("ours", "none"): "ratios, not calibrated",
    ("ours", "other tests"): "ratios, calibrated on other tests",
    ("ours", "other try"): "ratios, calibrated on the other try",
}
FIG_9 = {"paper, as released": "none", "authors' output": "none", "ours": "other tests"}
"""Methods that are drawn over time, and their calibrations."""
BENDS_DEG = {
    "rmse_deg": (0, 180),
    "rmse_below_20_deg": (0, 20),
    "rmse_20_to_40_deg": (20, 40),
    "rmse_above_40_deg": (40, 180),
}


def bend_deviation(found: Estimate) -> np.ndarray:
    """Return the standard deviation of the bend [rad] from the covariance of the bend vector."""
    along = found.q / np.maximum(np.linalg.norm(found.q, axis=-1, keepdims=True), 1e-12)
    return np.sqrt(np.einsum("...i,...ij,...j", along, found.covariance, along))


def rms_deg(x: np.ndarray) -> float:
    """Return a root mean square in degrees, over what is known."""
    return float(np.degrees(np.sqrt(np.nanmean(np.abs(x) ** 2)))) if np.isfinite(x).any() else np.nan


def bend_errors(runs: Sequence[Run]) -> pd.DataFrame:
    """Return errors of the bend by method and take, also by the size of the bend, and of the direction.

    A sensor does not know how it was turned against motion capture: unless a calibration says so, the mean turn of
    the takes of other tests is taken off.
    """
    lines = []
    for run in runs:
        truth, off = np.abs(run.take.q), np.abs(run.q) - np.abs(run.take.q)
        alike = [other for other in runs if other.name == run.name and other.take.test != run.take.test]
        mean = sum(other.turned.sum() for other in alike) if run.calibration == "none" else 1.0
        turned = np.angle(run.turned / np.exp(1j * np.angle(mean)))
        line = {"method": run.method, "calibration": run.calibration, "length_mm": run.length_mm}
        line |= {"name": run.name, "take": run.take.name}
        for name, (low, high) in BENDS_DEG.items():
            line[name] = rms_deg(off[(np.degrees(truth) >= low) & (np.degrees(truth) < high)])
        line["rmse_tilt_z_deg"] = rms_deg(np.abs(run.q) - run.take.tilt_z)
        line["direction_deg"] = rms_deg(turned)
        line["within_percent"] = np.nan
        if run.deviation is not None:
            line["within_percent"] = 100 * (np.abs(off) <= 2 * run.deviation)[np.isfinite(off)].mean()
        lines.append(line)
    return pd.DataFrame(lines)


def taken(takes: Sequence[Take]) -> pd.DataFrame:
    """Return what was found of each take on the way."""
    table = pd.DataFrame([{"take": take.name, **take.facts} for take in takes])
    others = [table["lag_s"].drop(k).median() for k in table.index]
    return table.assign(
        lag_off_s=table["lag_s"] - others, peak_deg=[np.degrees(np.nanmax(abs(x.q))) for x in takes]
    )


def median_errors(errors: pd.DataFrame) -> pd.DataFrame:
    """Return medians over the takes, and how many takes there are."""
    groups = errors.groupby(["method", "calibration", "length_mm", "name"], sort=False, dropna=False)
    return groups.median(numeric_only=True).assign(takes=groups.size()).reset_index()


def over_time(runs: Sequence[Run], points: int = 200) -> pd.DataFrame:
    """Return bends and directions over time, these less their mean and where the bend is large enough."""
    lines = []
    takes = {run.take.name: run.take for run in runs}
    for run in [*(Run("motion capture", "none", np.nan, take, take.q) for take in takes.values()), *runs]:
        bent = (np.abs(run.take.q) >= np.radians(LEAST_BEND_DEG)) & np.isfinite(run.q)
        mean = np.exp(1j * np.angle(run.q[bent])).sum()
        direction = np.where(bent, np.degrees(np.angle(run.q / mean)), np.nan)
        columns = {"time_s": run.take.time_s - run.take.time_s[0], "bend_deg": np.degrees(np.abs(run.q))}
        table = pd.DataFrame(
            {**columns, "direction_deg": direction, "take": run.take.name, "method": run.name}
        )
        lines.append(table[:: max(len(table) // points, 1)])
    return pd.concat(lines, ignore_index=True)


# Fig. 8


QUIET_S, BASELINE_S, LEAST_S = 10.0, 10.0, 0.1


def light_files(seed: int = 0) -> tuple[dict[str, Hall], str]:
    """Return the light-bulb files, recorded or else synthetic, and which these are; the first is the trial run."""
    folder = recordings_folder() / FOLDER / "experiment_data"
    paths = {name: folder / f"{name.replace('_', '_test_')}.csv" for name in EVENTS}
    if all(path.is_file() for path in paths.values()):
        return {name: read_hall(path) for name, path in paths.items()}, "recorded"
    return synthetic_light(seed), "synthetic"


def rest_of(hall: Hall) -> tuple[complex, float]:
    """Return the ratio at rest and its deviation, in the ten seconds in which it varies least."""
    t, x = hall.time_s - hall.time_s[0], hall.ratio
    require(t[-1] > 2 * QUIET_S, "recording", "rest_of", f"longer than {2 * QUIET_S:g} s", f"{t[-1]:.1f} s")
    parts = [x[(t >= a) & (t < a + QUIET_S)] for a in np.arange(0.0, t[-1] - QUIET_S, 0.5)]
    scatter = [(part.real.std() + part.imag.std()) / 2 for part in parts]
    return median(parts[int(np.argmin(scatter))]), float(min(scatter))
