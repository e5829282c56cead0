"""Mitchell et al. 2021: the module with one magnet and one sensor, its simulated curves, and the filters on them."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike

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
from repro.estimators.particle import BendDisc, Box
from repro_companion.papers import baaij
from repro_companion.run import project_folder
from repro_companion.show import mean_ratio, number

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


def beside_print(
    printed: pd.Series, summary: pd.DataFrame, means: pd.DataFrame, process_noise_pi: float = 0.02
) -> pd.DataFrame:
    """Return the published errors [mm] by curve, those of a page as printed, and those of the setting that fits.

    The heading has the process noise of the page, in parts of π.
    """
    here = summary[(summary["particles"] == 1000) & (summary["setting"] == PRINTED.name)].set_index("curve")
    fits = means[means["setting"] == FITS.name].set_index("curve")
    columns = {"RMSE [mm]": pd.Series({name: name.capitalize() for name in CURVES}), "published": printed}
    stated = " (stated)" * (process_noise_pi == PRINTED.process_noise_pi)
    columns |= {f"process noise {process_noise_pi:g}π rad{stated}": here["rmse_mm"]}
    columns |= {f"{FITS.process_noise_pi:g}π rad, arc 14 mm": fits["rmse_mm"]}
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
