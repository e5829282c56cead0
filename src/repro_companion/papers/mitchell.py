"""Mitchell et al. 2021: the module with one magnet and one sensor, its simulated curves, and the filters on them."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import timedelta, timezone
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike
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
    Sensing,
    Sensor,
    simulated_readings,
    track,
)
from repro.common import bad_input, require
from repro.estimators.base import Estimate
from repro.estimators.particle import BendDisc, Box
from repro.motion_files import Motion as MotionCapture
from repro.motion_files import read_motion, undo_exchanges
from repro_board.lag import search_lag
from repro_companion import show
from repro_companion.papers import baaij
from repro_companion.papers.fetch import listed_files, states
from repro_companion.run import project_folder, recordings_folder
from repro_companion.show import mean_ratio, number, sentences

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


def bend_vector(angle: np.ndarray | float, direction: np.ndarray | float) -> np.ndarray:
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
    process_noise_pi: ArrayLike, length: float = LENGTH, sigma_mt: float = SIGMA_MT, **how: str | int
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

    def method(self, batch: int = 1) -> LevenbergMarquardt | KalmanFilter | ParticleFilter:
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
        how = dict(zip(("estimate", "resampling", "motion"), self.how, strict=True))
        noise_pi = np.full(batch, self.process_noise_pi)
        return particle_filter(noise_pi, self.length, sigma, particles=self.particles, **how)


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
    tables = [
        pd.DataFrame({"curve": name, "t": times()[: len(error)], "error_mm": error}).assign(
            setting=setting.name, process_noise_pi=setting.process_noise_pi, particles=setting.particles
        )
        for (setting, name), error in errors.items()
    ]
    return pd.concat(tables, ignore_index=True)


def runs(own: Setting, errors: Mapping[tuple[int, str], np.ndarray], seed: int, steps: int) -> pd.DataFrame:
    """Return errors over time: given ones by particles and curve, and the library's as it fits and at its best."""
    found = {(replace(own, particles=n), name): error for (n, name), error in errors.items()}
    counts = dict.fromkeys(n for n, _ in errors)
    for setting in [*(replace(FITS, particles=n) for n in counts), BEST]:
        both = follow(setting, seed, steps)
        found |= {(setting, name): both[:, k] for k, name in enumerate(CURVES)}
    return errors_over_time(found)


def thinned(table: pd.DataFrame) -> pd.DataFrame:
    """Return every 15th step of each run in a table of errors over time."""
    return table[table.groupby(["setting", "particles", "curve"], sort=False).cumcount() % 15 == 0]


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


def study_rows(setting: Setting, seed: int) -> list[tuple[str | float, ...]]:
    """Return the errors of one run of the study, a row for each curve."""
    rmse = np.sqrt((follow(setting, seed) ** 2).mean(axis=0))
    run = (setting.name, setting.process_noise_pi, setting.particles)
    return [(*run, name, seed, x) for name, x in zip(CURVES, rmse, strict=True)]


STUDY_COLUMNS = ["setting", "process_noise_pi", "particles", "curve", "seed", "rmse_mm"]


def law_mm(
    process_noise_pi: np.ndarray | float, particles: np.ndarray | float = 1000, length: float = LENGTH
) -> np.ndarray:
    """Return the error [mm] of the best tenth of a cloud much wider than the likelihood, near the straight arc."""
    width = process_noise_pi * math.pi * 1e3 * length / 2
    return math.sqrt(math.log(10 / 9)) * width / np.sqrt(particles / 10)


def over_seeds(table: pd.DataFrame) -> pd.DataFrame:
    """Return mean and standard deviation of the study's errors over the seeds."""
    by = table.groupby(STUDY_COLUMNS[:4], sort=False)["rmse_mm"]
    return by.agg(rmse_mm="mean", rmse_std_mm="std", seeds="count").reset_index()


def beside_print(printed: pd.Series, summary: pd.DataFrame, means: pd.DataFrame) -> pd.DataFrame:
    """Return the published errors [mm] by curve, those of a page as printed, and those of the setting that fits."""
    here = summary[(summary["particles"] == 1000) & (summary["setting"] == PRINTED.name)].set_index("curve")
    fits = means[means["setting"] == FITS.name].set_index("curve")
    columns = {"RMSE [mm]": pd.Series({name: name.capitalize() for name in CURVES}), "published": printed}
    columns |= {"process noise as stated": here["rmse_mm"], "¼ of it, arc 14 mm": fits["rmse_mm"]}
    return pd.DataFrame({name: column[list(CURVES)] for name, column in columns.items()})


def by_noise(means: pd.DataFrame) -> tuple[pd.DataFrame, pd.Series, pd.DataFrame, float]:
    """Return errors over process noise: without sensor noise, by the law, and with it; last, of least squares."""
    clean = means[means["setting"] == "process noise"]
    noise_pi = np.geomspace(5e-4, 0.02, 30)
    noisy = means[means["setting"].isin(["random walk", "constant velocity"])]
    single = means.loc[means["setting"] == SINGLE.name, "rmse_mm"].mean()
    return clean, pd.Series(law_mm(noise_pi), index=noise_pi), noisy, single


def discs(
    truth: Mapping[str, np.ndarray], state: np.ndarray, q: np.ndarray
) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Return bends [deg] for Figs 3 and 4: every fourth of each curve, and of one state with its particles."""

    def degrees(bend: np.ndarray, **about: str) -> pd.DataFrame:
        return pd.DataFrame(np.degrees(bend), columns=["x_deg", "y_deg"]).assign(**about)

    curves = [degrees(bend[::4], curve=name) for name, bend in truth.items()]
    return pd.concat(curves), pd.concat([degrees(q, part="particle"), degrees(state[None], part="truth")])


def gain(table: pd.DataFrame, method: str, other: str) -> pd.DataFrame:
    """Return by curve how many times the error of another method one has, with a paired bootstrap (95 %)."""
    lines = []
    for name in CURVES:
        own = table[table["curve"] == name].pivot_table(index="seed", columns="setting", values="rmse_mm")
        a, b = own[method].dropna().to_numpy(), own[other].dropna().to_numpy()
        lines.append((name, method, other, *mean_ratio(a, b)))
    return pd.DataFrame(lines, columns=["curve", "setting", "than", "ratio", "ratio_low", "ratio_high"])


def gains(table: pd.DataFrame) -> pd.DataFrame:
    """Return by curve what our filter gains over least squares on single readings, and a Kalman filter over ours."""
    pairs = (BEST, SINGLE), (KALMAN, BEST)
    return pd.concat(gain(table, method.name, other.name) for method, other in pairs)


def gain_in_words(table: pd.DataFrame) -> str:
    """Return what our filter gains, on the curves that had no part in its choice, and a Kalman filter beside it."""
    ratio = table.set_index(["setting", "curve"])["ratio"]
    flower, seagull = (100 * ratio[BEST.name, name] for name in ("flower", "seagull"))
    less = [100 - 100 * ratio[KALMAN.name, name] for name in ("flower", "seagull")]
    sizes = "{} % smaller still on Flower, and {} % on Seagull".format(*(number(x, 1) for x in less))
    better = min(less) > 0
    return (
        f"With velocities our particle filter has {flower:.0f} % of the error of least squares on single readings on"
        f" Flower, and {seagull:.0f} % on Seagull. Neither curve was used to choose its noise."
        f" The error of a Kalman filter with the same noises is {sizes if better else 'not smaller on both'}."
        f"{' **So take the Kalman filter for one bend.**' if better else ''}"
    )


SEGMENT_NOISE_MT = 7.1e-4
"""Noise of the robots in Table 1 of Baaij et al. [mT]."""


def many_segments(particles: Sequence[int], seed: int, steps: int) -> pd.DataFrame:
    """Return errors of the tip [mm] on the arms of Table 1 of Baaij et al.: clouds of so many, and least squares.

    All start at the truth, and a cloud knows the size of the true steps. The effective number is of a thousand.
    """
    lines = []
    for n_segments in (1, 2, 3):
        robot = baaij.robot(n_segments, sensors_per_segment=4)
        q = baaij.lemniscate(n_segments)[:steps]
        u = baaij.simulate(robot, q, noise_mt=SEGMENT_NOISE_MT, seed=seed)
        sensing, (lower, upper) = Sensing(robot), baaij.bounds(n_segments)
        step = np.sqrt((np.diff(q, axis=0) ** 2).mean(axis=0))
        line: dict[str | int, float] = {"unknowns": 3 * n_segments}
        for n in particles:
            cloud = ParticleFilter(sensing, step, SEGMENT_NOISE_MT, Box(lower, upper), n)
            shape = track(cloud, u, q[0], seed=seed)
            line[n] = baaij.pose_errors(robot, shape.q, q)["tip_mm"]
            if n == 1000:
                line["effective"] = shape.details["effective_sample_size"].mean()
        single = LevenbergMarquardt(sensing, lower, upper, SEGMENT_NOISE_MT)
        line["least squares"] = baaij.pose_errors(robot, track(single, u, q[0]).q, q)["tip_mm"]
        lines.append(line)
    return pd.DataFrame(lines)


def segments_shown(table: pd.DataFrame) -> pd.DataFrame:
    """Return this table as a page shows it."""
    clouds = {name: f"{name} particles [mm]" for name in table if name.isdecimal()}
    return table[["unknowns", "least squares", *clouds]].rename(
        columns={"least squares": "least squares [mm]", **clouds}
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


def readable(rows: Sequence[Sequence[str]], columns: int) -> np.ndarray:
    """Return the rows in which every cell is a finite number."""
    cells = pd.DataFrame(rows, columns=range(columns), dtype=object)
    table = cells.apply(pd.to_numeric, errors="coerce").to_numpy(float)
    return table[np.isfinite(table).all(axis=1)]


def read_hall(path: Path) -> Hall:
    """Read a file of the Hall sensor, rows ``[x y z],unix_time``; what a buffer held at the start is dropped."""
    lines = path.read_text(encoding="utf-8", errors="replace").splitlines()
    cells = [re.split(r"[\[\],\s]+", line.strip()) for line in lines]
    table = readable([row[1:] for row in cells if len(row) == 5], 4)
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


KINDS_OF_FILES = {
    "experiment_data": "of the Hall sensor in the experiments",
    "mocap": "of motion capture",
    "filter_readings": "of the authors' filter",
    "calibrate_data": "at nominal bends",
}


FILES = """
{% if not found %}
We may not pass the recordings on, so this page was built without them. Its numbers are from a run with 9 of the 12
takes and two of three repetitions at nominal bends. The first command brings all {{ listed }} files
({{ megabytes | fixed(0) }} MB). Then the page draws Figs 8 and 9 over time, and computes every number from your copy.
{% elif missing %}
Not found: {{ missing | join(", ") }}. {{ checked }} What needs the missing ones stands here as an earlier run found
it, or not at all. These commands bring them:
{% else %}
All {{ listed }} released files are here. {{ checked }}
{% endif %}
"""
COMMAND = "\n\n```bash\n.venv/bin/repro fetch mitchell2021\nmake page P=bend_tests\n```\n"


def files_in_words() -> str:
    """Return which of the released recordings are in REPRO_DATA_DIR, and which are not those, by their hashes."""
    found, listed, missing = states(FOLDER), listed_files(FOLDER), []
    for kind, words in KINDS_OF_FILES.items():
        own = [state for path, state in found.items() if path.startswith(f"{kind}/")]
        missing += [f"{own.count('missing')} of {len(own)} files {words}"] if "missing" in own else []
    other = [path for path, state in found.items() if state == "another"]
    named = f"**Not the released files: {', '.join(other[:5])}{' and others' * (len(other) > 5)}.**"
    checked = named if other else "What was found has its published checksums."
    megabytes = 1e-6 * sum(one.size or 0 for one in listed)
    told = {"missing": missing, "checked": checked, "listed": len(listed), "megabytes": megabytes}
    return sentences(FILES, found=set(found.values()) != {"missing"}, **told) + COMMAND * bool(missing)


def of_recordings(name: str, computed: pd.DataFrame | None) -> pd.DataFrame:
    """Return a table computed from recordings, or without them what the committed study of this name found."""
    return show.study(name) if computed is None else computed


# A module at nominal bends: calibrate_data

DIRECTIONS_DEG = {"0dir": 0.0, "pi2dir": 90.0, "pidir": 180.0, "3pi2dir": 270.0}
"""Folders of calibrate_data, and the nominal direction of the bend in each."""
SPIKE_UNITS = 1.0
"""A row this far from its file's median is no bend: at rest the whole field is 2 units."""
SUSPECT = ("0dir", 90)
"""Files that read less than those of 40 deg in their direction, in both repetitions that we have."""


class NominalBends(NamedTuple):
    """What the sensor read of a module at nominal bends, one value for each file."""

    files: pd.DataFrame
    """Direction, nominal bend, repetition, and what was counted."""
    q: np.ndarray
    """Nominal bend vectors [rad], complex."""
    ratio: np.ndarray
    """Field across over field along the body, less the ratio at rest: medians."""
    across_mt: np.ndarray
    """Field across the body, less the field at rest [mT], complex: medians."""
    rest: complex
    """The ratio at rest."""

    def of(self, chosen: np.ndarray) -> NominalBends:
        """Return some of the files."""
        return NominalBends(*(x[chosen] for x in self[:4]), self.rest)

    @property
    def suspect(self) -> np.ndarray:
        """Which files are those of SUSPECT."""
        return ((self.files["direction"] == SUSPECT[0]) & (self.files["bend_deg"] == SUSPECT[1])).to_numpy()


def read_nominal(path: Path) -> tuple[np.ndarray, dict[str, int]]:
    """Read a file of calibrate_data, rows ``x,y,z`` without times; return readings [mT] and what was dropped."""
    lines = path.read_text(encoding="utf-8", errors="replace").splitlines()
    table = readable([row for line in lines if len(row := line.split(",")) == 3], 3)
    owner, unreadable = f"calibrate_data/{path.parent.name}/{path.name}", len(lines) - len(table)
    require(len(table) and unreadable <= len(lines) / 20, "rows", owner,
            "x,y,z and at most 5 % unreadable", f"{unreadable} of {len(lines)} unreadable")  # fmt: skip
    middle = np.median(table, axis=0)
    require(0.5 < np.linalg.norm(middle) < LARGEST_UNIT, "median field", owner,
            f"between 0.5 and {LARGEST_UNIT:g} units of 10 mT", f"{np.linalg.norm(middle):g}")  # fmt: skip
    spikes = (np.abs(table - middle) > SPIKE_UNITS).any(axis=1)
    require(spikes.sum() <= len(lines) / 20, "rows", owner, f"within {SPIKE_UNITS:g} unit of the median but 5 %",
            f"{spikes.sum()} of {len(lines)} elsewhere")  # fmt: skip
    facts = {"rows": len(lines), "unreadable": unreadable, "spikes": int(spikes.sum())}
    return MT_PER_UNIT * table[~spikes] @ MODEL_FROM_FILE.T, facts


def nominal_bends() -> NominalBends | None:
    """Return the files of calibrate_data in REPRO_DATA_DIR; without a file at rest there are none."""
    folder, lines = recordings_folder() / FOLDER / "calibrate_data", []
    for path in sorted(folder.glob("*/*.csv")):
        name = re.fullmatch(r"(\d0?)deg_([1-3])", path.stem)
        if path.parent.name not in DIRECTIONS_DEG or name is None:
            must_be = f"DIRECTION/BENDdeg_REPETITION.csv, with one of {', '.join(DIRECTIONS_DEG)}"
            raise bad_input("file", "calibrate_data", must_be, f"{path.parent.name}/{path.name}")
        u, facts = read_nominal(path)
        line = {"direction": path.parent.name, "bend_deg": int(name[1]), "repetition": int(name[2]), **facts}
        lines.append(line | {"ratio": median(ratio(u)), "across_mt": median(u[:, 0] + 1j * u[:, 1])})
    files = pd.DataFrame(lines)
    if files.empty or (straight := files["bend_deg"] == 0).sum() == 0:
        return None
    ratios, across = (files.pop(name).to_numpy(complex) for name in ("ratio", "across_mt"))
    towards = np.radians(files["direction"].map(DIRECTIONS_DEG).to_numpy())
    q = np.radians(files["bend_deg"].to_numpy()) * np.exp(1j * towards)
    less = [x - x[straight].mean() for x in (ratios, across)]
    return NominalBends(files, q, *less, ratios[straight].mean()).of(~straight.to_numpy())


def nominal_length_mm(bends: NominalBends, length_mm: float) -> float:
    """Return the length of the arc [mm] with which the model's field across the body fits nominal bends best.

    This field is nearly a dipole's and goes with the inverse cube of the length, so one length gives all others.
    """
    own = bends.of(~bends.suspect)
    u = BendSensor(1e-3 * length_mm)(np.stack([own.q.real, own.q.imag], axis=-1))
    model = u[:, 0] + 1j * u[:, 1]
    gain = abs((own.across_mt * model.conj()).sum()) / (np.abs(model) ** 2).sum()
    return length_mm * gain ** (-1 / 3)


def nominal_errors(
    bends: NominalBends, calibrate: Callable[..., complex], invert: Callable[..., Sequence[np.ndarray]]
) -> pd.DataFrame:
    """Return what nominal bends calibrate, how well, and how well they repeat: of all, and of each direction alone.

    The bend of a file is found with the other repetitions as calibration.
    """
    suspect, direction = bends.suspect, bends.files["direction"].to_numpy()
    groups = {"all": ~suspect} | {
        f"{degrees:.0f}°": (direction == folder) & ~suspect for folder, degrees in DIRECTIONS_DEG.items()
    }
    groups |= {"all, with 90° in direction 0°": ~suspect | suspect, "90° in direction 0°": suspect}
    lines = []
    for name, own in ((name, bends.of(chosen)) for name, chosen in groups.items() if chosen.any()):
        c, repetition = calibrate([own]), own.files["repetition"].to_numpy()
        crossed, bend = np.full(len(own.q), np.nan), np.abs(invert(own.ratio, c)[0])
        for left in (repetition == one for one in set(repetition)):
            if not left.all():
                crossed[left] = np.abs(invert(own.ratio[left], calibrate([own.of(~left)]))[0])
        # Two draws differ by the root of twice their variance.
        alike = own.files.assign(twice=np.sqrt(2) * bend).groupby(["direction", "bend_deg"])["twice"]
        line = {"direction": name, "files": len(own.q), "gain": abs(c), "turn_deg": np.degrees(np.angle(c)),
                "error_deg": rms_deg(crossed - np.abs(own.q)), "repeat_deg": rms_deg(alike.std().to_numpy()),
                "largest_ratio": np.abs(own.ratio).max(), "rest": abs(own.rest)}  # fmt: skip
        lines.append(line | own.files[["rows", "spikes", "unreadable"]].sum().to_dict())
    return pd.DataFrame(lines)


NOMINAL_WORDS = """
**On the takes, ratios calibrated at nominal bends have an error of {{ at_bends }}°, which is {{ "worse" if worse
else "better" }} than without any calibration.** Without it the error is {{ without }}°, and with a calibration on
other tests {{ tests }}°. The files show a part of the reason. In them the ratio is {{ all.gain | two }} times as
large as in the model, on the takes {{ low | two }} to {{ high | two }} times, so every bend comes out at about {{
size | fixed(0) }} % of its size. At rest the ratio has a size of {{ all.rest | two }} there, and of about {{ rest |
two }} on the takes. So it is probably another module, or the same one mounted in another way (inferred). Nor need a
nominal bend be the bend between sensor and magnet. A dipole on an arc of up to 90° has ratios of at most 1/3, and
the files reach {{ all.largest_ratio | two }}.
"""
AGREEMENT = """
**The files disagree with each other.** Bends of two repetitions differ by {{ all.repeat_deg | two }}° (RMS). Bends
that we find with the other repetitions as calibration have an error of {{ all.error_deg | two }}°. With a *c* for
each direction it is {{ least | two }}° to {{ most | two }}°, which helps little, so we keep one *c*.
{% if suspect is not none %}
The {{ suspect.files | fixed(0) }} files of 90° in direction 0° alone would give a *c* of {{ suspect.gain | two }}.
They read like much smaller bends, and we do not know why. We leave them out.
{% endif %}
"""


def nominal_in_words(nominal: pd.DataFrame, rmse_deg: pd.Series, takes: pd.DataFrame) -> str:
    """Return what a calibration at nominal bends is worth on the takes, and why, as far as the files show it."""
    by = nominal.set_index("direction")
    one, turned = by.loc["all"], by.loc[by.index.str.fullmatch(r"\d+°"), "error_deg"]
    hows = ("nominal bends", "none", "other tests")
    at_bends, without, tests = rmse_deg.reindex([METHODS["ours", how] for how in hows]).to_numpy(float)
    if np.isnan(at_bends):
        return "The files at nominal bends are not here. The table has what this page found with them."
    low, middle, high = np.quantile(takes["gain"], [0, 0.5, 1])
    errors = {"at_bends": number(at_bends, 2), "without": number(without, 2), "tests": number(tests, 2)}
    sizes = {"low": low, "high": high, "size": 100 * middle / one["gain"], "rest": takes["rest"].median()}
    worth = sentences(NOMINAL_WORDS, worse=at_bends > without, all=one, **errors, **sizes)
    suspect = by.loc["90° in direction 0°"] if "90° in direction 0°" in by.index else None
    return (
        f"{worth}\n\n{sentences(AGREEMENT, all=one, least=turned.min(), most=turned.max(), suspect=suspect)}"
    )


def side_by_side(readings: Sequence[np.ndarray]) -> np.ndarray:
    """Return readings ``[t, axes]`` of takes as one array ``[t, take, axes]``; after its end a take has none."""
    table = np.full((max(map(len, readings)), len(readings), readings[0].shape[1]), np.nan)
    for k, u in enumerate(readings):
        table[: len(u), k] = u
    return table


def calibrations(
    take: Take, takes: Sequence[Take], bends: NominalBends | None = None
) -> dict[str, list[Take | NominalBends]]:
    """Return what may calibrate a take, by name: other takes, and nominal bends; it is never among them."""
    same = [other for other in takes if other.test == take.test and other is not take]
    others = [other for other in takes if other.test != take.test]
    nominal = [] if bends is None else [bends.of(~bends.suspect)]
    found = {"other try": same, "other tests": others, "nominal bends": nominal}
    return {"none": []} | {name: some for name, some in found.items() if some}


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
        return f"{label}, {self.length_mm:.3g} mm" if self.method.startswith("paper") else label

    @property
    def turned(self) -> np.ndarray:
        """Direction beyond that of motion capture, as complex numbers of size one, where the bend is large enough."""
        bent = (np.abs(self.take.q) >= np.radians(LEAST_BEND_DEG)) & np.isfinite(self.q)
        return np.exp(1j * np.angle(self.q[bent] / self.take.q[bent]))


TURN_UNKNOWN = ("none", "nominal bends")
"""Calibrations without motion capture."""
LEAST_BEND_DEG = 20.0
"""Directions are compared from this bend on."""
METHODS = {
    ("motion capture", "none"): "motion capture",
    ("paper, printed noise", "none"): "paper's filter, printed noise",
    ("paper, as released", "none"): "paper's filter, as released",
    ("authors' output", "none"): "authors' own output",
    ("ours", "none"): "ratios, not calibrated",
    ("paper, as released", "nominal bends"): "paper's filter, arc from nominal bends",
    ("ours", "nominal bends"): "ratios, calibrated at nominal bends",
    ("ours", "other tests"): "ratios, calibrated on other tests",
    ("ours", "other try"): "ratios, calibrated on the other try",
}
FIG_9 = (("paper, as released", "none"), ("authors' output", "none"), ("ours", "other tests"))
"""Methods that are drawn over time, and their calibrations."""
COMPARED = (("paper, as released", "none"), ("ours", "none"), ("ours", "other tests"))
"""And those whose errors the page compares, the first one with both arcs."""
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


def bend_errors(runs: Sequence[Run]) -> pd.DataFrame | None:
    """Return errors of the bend by method and take, also by the size of the bend, and of the direction.

    A sensor does not know how it was turned against motion capture: unless other takes calibrate it, the mean turn of
    the takes of other tests is taken off.
    """
    if not runs:
        return None
    lines = []
    for run in runs:
        truth, off = np.abs(run.take.q), np.abs(run.q) - np.abs(run.take.q)
        size = np.degrees(truth)
        alike = [other for other in runs if other.name == run.name and other.take.test != run.take.test]
        mean = sum(other.turned.sum() for other in alike) if run.calibration in TURN_UNKNOWN else 1.0
        within = None if run.deviation is None else (np.abs(off) <= 2 * run.deviation)[np.isfinite(off)]
        lines.append({
            "method": run.method,
            "calibration": run.calibration,
            "length_mm": run.length_mm,
            "name": run.name,
            "take": run.take.name,
            **{name: rms_deg(off[(size >= low) & (size < high)]) for name, (low, high) in BENDS_DEG.items()},
            "rmse_tilt_z_deg": rms_deg(np.abs(run.q) - run.take.tilt_z),
            "direction_deg": rms_deg(np.angle(run.turned / np.exp(1j * np.angle(mean)))),
            "within_percent": np.nan if within is None else 100 * within.mean(),
        })  # fmt: skip
    return pd.DataFrame(lines)


def taken(takes: Sequence[Take], gains: Sequence[float]) -> pd.DataFrame | None:
    """Return what was found of each take on the way, with the size of the c that fits it; None without takes."""
    if not takes:
        return None
    table = pd.DataFrame([{"take": take.name, **take.facts} for take in takes])
    others = [table["lag_s"].drop(k).median() for k in table.index]
    return table.assign(
        lag_off_s=table["lag_s"] - others,
        peak_deg=[np.degrees(np.nanmax(abs(x.q))) for x in takes],
        rest=[abs(ratio(x.rest_mt)) for x in takes],
        gain=gains,
    )


def runs_of_the_paper(
    takes: Sequence[Take],
    bends: NominalBends | None,
    follow: Callable[..., np.ndarray],
    across: Callable[[np.ndarray, np.ndarray], np.ndarray],
    length_mm: float,
) -> list[Run]:
    """Return what the paper's filter finds on all takes at once, as printed and as released, and its own output."""
    if not takes:
        return []
    zeroed = side_by_side([across(take.u, take.rest_mt) for take in takes])
    arcs = [("none", length_mm), ("none", 15.0)]
    if bends:
        arcs.append(("nominal bends", nominal_length_mm(bends, length_mm)))
    printed = follow(side_by_side([take.u for take in takes]), process_noise_pi=0.002)
    filtered = {("paper, printed noise", "none", length_mm): printed}
    filtered |= {("paper, as released", *arc): follow(zeroed, arc[1]) for arc in arcs}
    runs = [
        Run(*how, take, q[: len(take.u), k] @ [1, 1j])
        for how, q in filtered.items()
        for k, take in enumerate(takes)
    ]
    logged = [take for take in takes if take.log is not None]
    return runs + [Run("authors' output", "none", np.nan, take, take.log) for take in logged]


def compared(errors: pd.DataFrame) -> pd.DataFrame:
    """Return the errors of the methods that the page compares: the paper's filter also with an arc of 15 mm."""
    return errors[pd.MultiIndex.from_frame(errors[["method", "calibration"]]).isin(COMPARED)]


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


QUIET_S = 10.0


def light_files() -> dict[str, Hall]:
    """Return the light-bulb files in REPRO_DATA_DIR, the trial run first; none unless all are there."""
    folder = recordings_folder() / FOLDER / "experiment_data"
    paths = {f"light_{k}": folder / f"light_test_{k}.csv" for k in (-1, 0, 1, 2)}
    return (
        {name: read_hall(path) for name, path in paths.items()}
        if all(map(Path.is_file, paths.values()))
        else {}
    )


def rest_of(hall: Hall) -> tuple[complex, float]:
    """Return the ratio at rest and its deviation, in the ten seconds in which it varies least."""
    t, x = hall.time_s - hall.time_s[0], hall.ratio
    require(t[-1] > 2 * QUIET_S, "recording", "rest_of", f"longer than {2 * QUIET_S:g} s", f"{t[-1]:.1f} s")
    parts = [x[(t >= a) & (t < a + QUIET_S)] for a in np.arange(0.0, t[-1] - QUIET_S, 0.5)]
    scatter = [(part.real.std() + part.imag.std()) / 2 for part in parts]
    return median(parts[int(np.argmin(scatter))]), float(min(scatter))


BULB = ["light_0", "light_1", "light_2"]
"""Files of the experiments; the trial run has the number -1."""
Events = Callable[[pd.DataFrame, float, float], list[tuple[float, float]]]


def event_counts(rises: Mapping[str, pd.DataFrame], noise: float, events: Events) -> pd.DataFrame | None:
    """Return how many events every file has, by threshold in units of the noise and by what is merged."""
    if not rises:
        return None
    return pd.DataFrame(
        {"times_noise": times, "threshold": times * noise, "merged_s": apart}
        | {"frozen": (times, apart) == (10, 1.0)}
        | {name: len(events(one, times * noise, apart)) for name, one in rises.items()}
        for times in (5, 10, 20, 40)
        for apart in (0.25, 1.0)
    )


def bulb_events(rises: Mapping[str, pd.DataFrame], noise: float, events: Events) -> pd.DataFrame:
    """Return start and end [s] of the events of every file, above ten times the noise."""
    marks = [(name, *span) for name in BULB for span in events(rises[name], 10 * noise, 1.0)]
    return pd.DataFrame(marks, columns=["file", "start_s", "end_s"])


def bulb_curves(
    light: Mapping[str, Hall],
    rises: Mapping[str, pd.DataFrame],
    follow: Callable[..., np.ndarray],
    across: Callable[[np.ndarray, np.ndarray], np.ndarray],
) -> pd.DataFrame:
    """Return ratios over time with bend and direction by the paper's filter, a row in four."""
    rested = [across(light[name].u, light[name].u[:100].mean(axis=0)) for name in BULB]
    bent = follow(side_by_side(rested)) @ [1, 1j]
    parts = []
    for name, q in zip(BULB, bent.T, strict=True):
        own = q[: len(rises[name])]
        columns = {"bend_deg": np.degrees(abs(own)), "direction_deg": np.degrees(np.angle(own))}
        parts.append(rises[name].assign(file=name, **columns))
    return pd.concat(parts)[::4]


def bulb_shown(counts: pd.DataFrame) -> pd.DataFrame:
    """Return the events in each file beside the attempts that the caption of Fig. 8 counts."""
    number_of = counts.set_index("frozen")[[*BULB, "light_-1"]]
    return pd.DataFrame({
        "file": ["0", "1", "2", "trial run"],
        "attempts by the caption": ["3", "3", "1", "–"],
        "events": number_of.loc[True].to_numpy(),
        "fewest, of all settings": number_of.min().to_numpy(),
        "most": number_of.max().to_numpy(),
    })  # fmt: skip


BULB_WORDS = """
On the authors' files 0, 1 and 2 the detector finds {{ events | join(", ") }} events, and {{ trial }} in the trial
run. The caption counts 3, 3 and 1. With other thresholds and other pauses between events it finds these in {{ equal
or "none" }} of {{ settings }} settings. So a threshold alone does not tell the attempts from other movements. Which
file is which experiment is our guess.
{% if here %}
To our eye there are three sharp peaks in file 1 and one long one in file 2, but in file 0 we cannot count three.
Two things are ours and not the paper's. The ratio starts far above zero, because the module rests in another shape
than in the trial run (inferred). In file 1 the field across the body changes its sign after 24 s. Less the readings
at rest it is then larger than any bend makes it, so our run of the filter goes to its bound of 90°.
{% else %}
The figure itself needs the recordings. The commands at the top of this page bring them.
{% endif %}
"""


def bulb_in_words(counts: pd.DataFrame, here: bool) -> str:
    """Return what the detector finds, and how that depends on its settings."""
    frozen = counts[counts["frozen"]].iloc[0]
    equal = int((counts[BULB] == [3, 3, 1]).all(axis=1).sum())
    found = {"events": [*frozen[BULB]], "trial": frozen["light_-1"], "equal": equal, "settings": len(counts)}
    return sentences(BULB_WORDS, here=here, **found)


# What the page shows of the takes

CAPTION = (
    "Paper Fig. 9, from the authors' recordings. Upper panels: bend angle over time. Lower panels: bend direction"
    " minus its mean, where the bend is above 20°. Wide grey: motion capture."
)
ERRORS = {
    "name": "method",
    "rmse_deg": "bend, y [°]",
    "rmse_above_40_deg": "above 40° [°]",
    "rmse_tilt_z_deg": "bend, z [°]",
    "direction_deg": "direction [°]",
    "takes": "takes",
}
"""Of the methods."""


def exchanged_in_words(facts: pd.DataFrame) -> str:
    """Return in how many frames and takes markers were exchanged, and how well the tilt then fits the place."""
    many, misfit = facts["undone_above_40_percent"].gt(30).sum(), facts["off_displacement_deg"].median()
    return (
        f"In {facts['undone'].sum():,} of {facts['frames'].sum():,} frames markers were exchanged, and we turned the"
        f" body back. In {many} takes this concerns more than 30 % of the frames above 40°. Where the body is hardly"
        " depends on which marker is which, so we can check the result: its tilt should be a smooth function of its"
        f" place. It is, within {number(misfit, 1)}° (root mean square, median over the takes)."
    )


WORTH = """
{% macro closer(of) %}{{ "the ratios" if of[0] < of[1] else "the filter" }}{% endmacro %}
**{{ "Against either tilt of the body " ~ closer(y) ~ " came closer to motion capture"
if closer(y) == closer(z) else "Which method is closer to motion capture depends on what we call the bend" }}.**
If it is the tilt of the body's *y* axis, the ratios, calibrated on other recordings, have an error of
{{ y[0] | two }}°, and the paper's filter as released has {{ y[1] | two }}°. If it is the tilt of *z*, as in the
released code, the ratios have {{ z[0] | two }}° and the filter has {{ z[1] | two }}°. We take *y*, because the body
moves to where *y* tilts. We also calibrate on it, which favours our ratios.
{% if alike %}
In {{ alike }} of the takes the choice hardly matters to the filter. There the ratios have an error of
{{ there[0] | two }}° and the filter {{ there[1] | two }}°.
{% endif %}
If we give the filter an arc of 15 mm, it comes to {{ y[2] | two }}° for *y* and {{ z[2] | two }}° for *z* without any
calibration; we explain below why. All these are medians over {{ takes }} of the 12 recorded takes. The paper prints
no errors for Fig. 9. *All numbers* has all {{ methods }} methods.
"""


def errors_in_words(errors: pd.DataFrame) -> str:
    """Return how near the methods come to the bend, and how that depends on the axis whose tilt it is."""
    own, filtered = compared(errors), COMPARED[0]
    by = own.pivot(index="take", columns=["method", "calibration", "length_mm"])
    length = own["length_mm"].iloc[0]
    chosen = [(*COMPARED[2], length), (*filtered, length), (*filtered, 15.0)]
    y, z = (by[of].reindex(columns=chosen) for of in ("rmse_deg", "rmse_tilt_z_deg"))
    alike = (y.iloc[:, 1] - z.iloc[:, 1]).abs() < 0.5  # degrees between errors that are taken for the same
    parts = {"y": y, "z": z, "there": y[alike]}
    numbers = {name: part.median().tolist() for name, part in parts.items()}
    return sentences(WORTH, **numbers, takes=len(y), alike=alike.sum(), methods=errors["name"].nunique())
