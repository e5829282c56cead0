"""Motions, loads and errors for the page on filtering over time and on the estimate in a control loop."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence

import numpy as np
import pandas as pd
from scipy.stats import chi2

from repro import KalmanFilter, LevenbergMarquardt, Sensing, simulated_readings, track
from repro_companion.papers.baaij import BEND, NOISE_MT, RATE_HZ, STEPS, bounds, lemniscate, robot
from repro_companion.show import number, ratio_interval, sentences

# Filtering over time

TRAJECTORIES = ("T0", "T1", "T2", "T3")
METHODS = ("Levenberg-Marquardt", "Kalman filter")
RESAMPLES = 4_000
REST = np.array([0.0, 0.0, 2.75e-3])
"""A straight segment at the middle of its elongation [m]: where all runs begin."""


def trajectory(name: str, n_segments: int) -> np.ndarray:
    """Return a motion of every segment ``[400, 3 n_segments]`` [m], 10 s long.

    T0 is random: each coordinate a sum of five sines of random phase, 0.1 to 0.5 Hz. T1 bends in a plane, T2 is half
    a lemniscate, T3 a whole one.
    """
    s = np.linspace(0, 1, STEPS)
    if name == "T0":
        phase = 2 * math.pi * np.random.default_rng(0).random((3 * n_segments, 5))
        waves = np.sin(2 * math.pi * np.arange(1, 6) * s[:, None, None] + phase).sum(-1)
        size = np.tile([BEND, BEND, REST[2]], n_segments)
        return np.tile(REST, n_segments) + 0.75 * size * waves / np.abs(waves).max(0)
    if name == "T1":
        return np.tile(np.stack([BEND * s, 0 * s, REST[2] + 0 * s], axis=-1), n_segments)
    return lemniscate(n_segments, half=name == "T2")


def temporal_errors(
    segments: Sequence[int],
    names: Sequence[str],
    seeds: Sequence[int],
    noise_mt: float,
    share: float,
    steps: int,
) -> pd.DataFrame:
    """Return errors and coverage of least squares at every step and of the filter, by robot, trajectory and seed.

    ``error_percent`` is relative to the range of T3, the mean over the coordinates. ``nees`` is the squared error
    over its covariance, one if that is right. ``score`` is the mean negative logarithm of the density at the truth.
    ``share`` is the process noise, in ranges between the bounds per s^1.5.
    """
    lines = []
    for n_segments, name in itertools.product(segments, names):
        arm, (low, high), q = (
            robot(n_segments),
            bounds(n_segments),
            trajectory(name, n_segments)[:steps, None],
        )
        sensing, start = Sensing(arm), np.tile(REST, (len(seeds), n_segments))
        alone = LevenbergMarquardt(sensing, low, high, noise_mt)
        kalman = KalmanFilter(sensing, low, high, noise_mt, acceleration=share * (high - low))
        clean = simulated_readings(arm, q)
        draws = [noise_mt * np.random.default_rng(seed).standard_normal(clean[:, 0].shape) for seed in seeds]
        u, span = clean + np.stack(draws, axis=1), np.ptp(lemniscate(n_segments), axis=0)
        fits = alone.step(alone.init(np.broadcast_to(start, (len(q), *start.shape))), u)[1]
        filtered = track(kalman, u, start, rate_hz=RATE_HZ, monitor=None)
        for method, found in zip(METHODS, (fits, filtered), strict=True):
            keys = {"n_b": n_segments, "trajectory": name, "method": method, "seed": list(seeds)}
            scores = temporal_scores(found.q - q, np.asarray(found.covariance), span)
            lines.append(pd.DataFrame(keys | scores))
    return pd.concat(lines, ignore_index=True)


def temporal_scores(error: np.ndarray, C: np.ndarray, span: np.ndarray) -> dict[str, np.ndarray]:
    """Return scores by seed of errors ``[t, seed, n_q]`` with their covariances, relative to ranges ``[n_q]``."""
    distance = (error * np.linalg.solve(C, error[..., None])[..., 0]).sum(-1)
    size = np.linalg.slogdet(2 * math.pi * C / np.outer(span, span))[1]
    return {
        "error_percent": 100 * (np.sqrt((error**2).mean(0)) / span).mean(-1),
        "covered_percent": 100 * (distance <= chi2.ppf(0.95, len(span))).mean(0),
        "nees": distance.mean(0) / len(span),
        "score": (distance + size).mean(0) / 2,
    }


def temporal_gains(table: pd.DataFrame) -> pd.DataFrame:
    """Return filter beside least squares by robot and trajectory, means over seeds; T2 chose the process noise."""
    lines = []
    for (n_b, name), part in table.groupby(["n_b", "trajectory"], sort=False):
        wide = part.drop(columns=["n_b", "trajectory"]).pivot(index="seed", columns="method")
        alone, kalman = (wide["error_percent"][method].to_numpy() for method in METHODS)
        low, high = ratio_interval(kalman, alone, RESAMPLES)
        scores = {
            f"{short}_{value}": wide[value][method].mean()
            for value in ("covered_percent", "nees")
            for short, method in zip(("lm", "filter"), METHODS, strict=True)
        }
        lines.append({
            "n_b": n_b,
            "trajectory": name,
            "chosen_here": name == "T2",
            "lm_percent": alone.mean(),
            "filter_percent": kalman.mean(),
            "ratio": kalman.mean() / alone.mean(),
            "ratio_low": low,
            "ratio_high": high,
            **scores,
        })  # fmt: skip
    return pd.DataFrame(lines)


def one_bend(q: np.ndarray, found: dict[str, tuple[np.ndarray, np.ndarray]]) -> pd.DataFrame:
    """Return the error of the first bend over time and twice its stated deviation [mm], by method."""
    tables = {
        method: pd.DataFrame({
            "time_s": np.arange(len(q)) / RATE_HZ,
            "method": method,
            "error_mm": 1e3 * (mean - q)[:, 0],
            "two_sigma_mm": 2e3 * np.sqrt(covariance[:, 0, 0]),
        })
        for method, (mean, covariance) in found.items()
    }  # fmt: skip
    return pd.concat(tables.values(), ignore_index=True)


# Closing the loop

CONTROLLERS = {"PI": (2.0, 8.0, 0.0), "PI and feed-forward": (2.0, 8.0, 1.0), "high gain": (6.0, 30.0, 1.0)}
"""Gains: proportional, integral [1/s], feed-forward."""
ARMS = {"as modelled": 1.0, "softer by a fifth": 1.2}
"""How far the arm bends, over what is commanded."""
REFERENCES = ("step", "circle", "lemniscate")
ALONE, FILTER, INFORMED = "least squares", "Kalman filter", "Kalman filter with command"
VELOCITY, LOAD = 6.4, 0.1
"""Process noise of the filters in the loop, in ranges per s^1.5 and per s^0.5: the best ones on the ellipse."""
RISE_S, SETTLED_S = 0.5, 2.0
"""Time that a step takes, and time from which on errors count [s]."""


def reference(name: str, time_s: np.ndarray) -> np.ndarray:
    """Return a configuration to follow ``[t, 3]`` [m]; the ellipse is there to choose the process noise."""
    turns = 2 * math.pi * time_s
    if name == "step":
        corners = 9e-3 * np.array([[1, 0], [0, 1], [-1, 0], [0, -1]])
        k, since = (time_s // 2).astype(int), time_s % 2
        done = (1 - np.cos(math.pi * np.minimum(since / RISE_S, 1))[:, None]) / 2
        bend = (1 - done) * corners[k - 1 & 3] + done * corners[k & 3]
    elif name == "circle":
        bend = 10e-3 * np.stack([np.cos(turns / 4), np.sin(turns / 4)], axis=-1)
    elif name == "lemniscate":
        bend = 12e-3 * np.stack([np.sin(turns / 4), np.sin(turns / 8)], axis=-1)
    else:
        bend = np.stack([11e-3 * np.cos(turns / 5), 6e-3 * np.sin(turns / 5)], axis=-1)
    return np.column_stack([bend, np.full(len(bend), REST[2])])


Run = tuple[np.ndarray, np.ndarray, np.ndarray]
"""The bend, what was fed back, and the command, each ``[t, case, 3]`` [m]."""


class Cases:
    """All loops that run side by side: every controller, arm, reference and seed; arrays are ``[case, 3]``."""

    def __init__(
        self, seeds: Sequence[int], noise_mt: float, load_mm: float, steps: int, references=REFERENCES
    ) -> None:
        names = ["controller", "session", "reference", "seed"]
        self.table = pd.DataFrame(itertools.product(CONTROLLERS, ARMS, references, seeds), columns=names)
        gains = np.array([CONTROLLERS[name] for name in self.table["controller"]])
        self.k_p, self.k_i, self.phi = gains.T[..., None]
        self.softness = np.ones((len(gains), 3))
        self.softness[:, :2] = self.table["session"].map(ARMS).to_numpy()[:, None]
        time_s = np.arange(steps + 1) / RATE_HZ
        self.reference = np.stack([reference(name, time_s) for name in self.table["reference"]], axis=1)
        draw = {seed: disturbances(seed, noise_mt, load_mm, steps) for seed in seeds}
        noise, load = zip(*(draw[seed] for seed in self.table["seed"]), strict=True)
        self.noise, self.load = np.stack(noise, axis=1), np.stack(load, axis=1)

    def errors(self, runs: dict[str, Run]) -> pd.DataFrame:
        """Return errors [mm] of the bend by estimator and case, the loop that is fed the truth among the runs."""
        late, (low, high), parts = round(SETTLED_S * RATE_HZ), bounds(1), []

        def rms(difference: np.ndarray) -> np.ndarray:
            return 1e3 * np.sqrt((difference[late:, :, :2] ** 2).sum(-1).mean(0))

        for estimator, (q, fed_back, command) in runs.items():
            r, bounded = self.reference[: len(q)], ((command <= low) | (command >= high))[late:, :, :2]
            columns = {
                "tracking_mm": rms(r - q),
                "tracking_truth_mm": rms(r - runs["truth"][0]),
                "estimate_mm": rms(fed_back - q),
                "offset_mm": 1e3 * np.linalg.norm((fed_back - q)[late:, :, :2].mean(0), axis=-1),
                "apparent_mm": rms(r - fed_back),
                "bounded_%": 100 * bounded.any(-1).mean(0),
            }
            parts.append(self.table.assign(**columns, estimator=estimator))
        return pd.concat(parts, ignore_index=True)


def over_time(cases: Cases, runs: dict[str, Run], controller: str, name: str) -> pd.DataFrame:
    """Return reference, bend and what was fed back [mm] of the first run with a controller and a reference."""
    table, lines = cases.table, []
    [case] = np.flatnonzero((table["controller"] == controller) & (table["reference"] == name))[:1]
    for feedback in ("truth", ALONE, FILTER, INFORMED):
        q, fed_back, _ = runs[feedback]
        curves = {"reference": cases.reference[: len(q)], "delta": q, "fed_back": fed_back}
        columns = {
            f"{curve}_{axis}_mm": (1e3 * values[:, case, k]).round(4)
            for k, axis in enumerate("xy")
            for curve, values in curves.items()
        }
        about = {"reference": name, "feedback": feedback, "time_s": np.arange(len(q)) / RATE_HZ}
        lines.append(pd.DataFrame(about | columns))
    return pd.concat(lines, ignore_index=True)


def disturbances(seed: int, noise_mt: float, load_mm: float, steps: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the noise of three readings [mT], and a load on the bend ``[t, 3]`` [m] that forgets within a second."""
    rng, load, kept = np.random.default_rng(seed), np.zeros((steps, 3)), math.exp(-1 / RATE_HZ)
    noise, pushes = noise_mt * rng.standard_normal((steps + 1, 3)), rng.standard_normal((steps, 2))
    load[0, :2] = pushes[0]
    for k in range(1, steps):
        load[k, :2] = kept * load[k - 1, :2] + math.sqrt(1 - kept**2) * pushes[k]
    return noise, 1e-3 * load_mm * load


def tracking_ratios(errors: pd.DataFrame, keys: Sequence[str]) -> pd.DataFrame:
    """Return means over seeds, and the tracking error over the error of the loop that is fed the truth."""
    lines, columns = [], ["tracking_mm", "tracking_truth_mm", "estimate_mm", "offset_mm", "bounded_%"]
    for values, part in errors.groupby(list(keys), sort=False):
        by_seed = part.groupby("seed")[columns].mean()
        line = dict(zip(keys, values, strict=True)) | {"seeds": len(by_seed)} | by_seed.mean().to_dict()
        off, least = by_seed[columns[:2]].to_numpy().T
        low, high = ratio_interval(off, least, RESAMPLES)
        lines.append(line | {"ratio": off.mean() / least.mean(), "low": low, "high": high})
    return pd.DataFrame(lines)


def tracking_table(means: pd.DataFrame, session: str) -> pd.DataFrame:
    """Return tracking errors [mm], a row for what is fed back and a column for each controller.

    The last columns are the largest error of the estimate, and how often a command was at its bound.
    """
    part = means[means["session"] == session]
    wide = part.pivot(index="estimator", columns="controller", values="tracking_mm")
    wide = wide.loc[part["estimator"].unique(), list(CONTROLLERS)].rename_axis(columns=None)
    largest = part.groupby("estimator")[["estimate_mm", "bounded_%"]].max()
    return wide.assign(error=largest["estimate_mm"], bounded=largest["bounded_%"]).reset_index()


IN_SHORT = """
**In short.** With moderate gain and feed-forward it
{{ "hardly matters" if forward.max() < 1.25 * forward.min() else "matters less" }}
which estimate you feed back: the bend is {{ forward.min() | fixed(2) }} to {{ forward.max() | fixed(2) }} mm off its
reference. With high gain the estimate decides. From best to worst: {{ listed }}. Fed with the true bend, the same
loop has {{ high.truth | fixed(2) }} mm. If the arm bends a fifth further than the filter believes, this order
{{ "stays the same" if same_order else "changes" }}.
"""


def in_words(means: pd.DataFrame) -> str:
    """Return which estimate tracks best, on the arm as modelled and on the softer one."""
    tracking = means.pivot(index="estimator", columns=["session", "controller"], values="tracking_mm")
    high, softer = (tracking[session, "high gain"] for session in ARMS)
    order, then = ([*x[[INFORMED, ALONE, FILTER]].sort_values().index] for x in (high, softer))
    forward = tracking["as modelled", "PI and feed-forward"].drop(["truth", "truth, one sample late"])
    listed = ", ".join(f"{name} {high[name]:.1f} mm" for name in order)
    return sentences(IN_SHORT, forward=forward, high=high, listed=listed, same_order=order == then)


def alone_in_words(gains: pd.DataFrame, noise_mt: float, loop_noise_mt: float) -> str:
    """Return what filtering alone gains and loses, and at how much noise."""
    first = gains[gains["n_b"] == gains["n_b"].iloc[0]].set_index("trajectory")
    columns = ["lm_percent", "filter_percent"]
    smooth, random = ([number(x, 2) for x in first.loc[name, columns]] for name in ("T3", "T0"))
    return (
        f"**Filtering alone.** On the smooth motion T3, least squares has an error of {smooth[0]} % of the range"
        f" and a Kalman filter {smooth[1]} %; on random motion they have {random[0]} % and {random[1]} %. The"
        f" sensor noise is {noise_mt / NOISE_MT:.0f} times the noise of real sensors here, and"
        f" {loop_noise_mt / NOISE_MT:.0f} times in the loop, so that the estimators differ at all."
    )


SOFTER = """
With feed-forward, of the four estimators the {{ steady }} loses least: its tracking error grows from
{{ before | fixed(2) }} to {{ after | fixed(2) }} mm,
{{ "and it also tracks best" if steady == best else "but the " ~ best ~ " tracks best" }} ({{ least | fixed(2) }} mm).
"""


def softer_in_words(means: pd.DataFrame) -> str:
    """Return how tracking with feed-forward changes if the arm is softer than the filter believes."""
    part = means[(means["controller"] == "PI and feed-forward") & ~means["estimator"].str.startswith("truth")]
    wide = part.pivot(index="estimator", columns="session", values="tracking_mm")
    before, after = (wide[session] for session in ARMS)
    steady, best = (after / before).idxmin(), after.idxmin()
    values = {"before": before[steady], "after": after[steady], "least": after[best]}
    return sentences(SOFTER, steady=steady, best=best, **values)


CLAIM = """
With the command the ratio is at most 1.3 in {{ met }} of {{ tried }} combinations of controller, arm and reference,
{{ "all" if plain == met else plain }} of them with the plain PI controller. So the claim
{{ "holds here" if met == tried else "does not hold in general" }}. A ratio depends on its denominator. With
feed-forward the error with the truth is at most about {{ truth | fixed(1) }} mm, so noise, the late reading and the
load all show.
"""


def claim(ratios: pd.DataFrame) -> str:
    """Return how often the filter that knows the command is nearly as good as the truth."""
    part = ratios[ratios["estimator"] == INFORMED]
    met, fed_truth = part[part["ratio"] <= 1.3], ratios[ratios["estimator"] == "truth"]
    truth = fed_truth.loc[fed_truth["controller"] != "PI", "tracking_mm"].max()
    plain = (met["controller"] == "PI").sum()
    return sentences(CLAIM, met=len(met), tried=len(part), plain=plain, truth=truth)
