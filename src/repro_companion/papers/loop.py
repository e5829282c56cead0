"""Arms, references, loads and errors for the page on an estimate in a control loop."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence

import numpy as np
import pandas as pd

from repro_companion.papers.baaij import RATE_HZ, bounds
from repro_companion.show import sentences

REST = np.array([0.0, 0.0, 2.75e-3])
"""A straight segment at the middle of its elongation [m]: where all runs begin."""
CONTROLLERS = {"moderate gain": (2.0, 8.0), "high gain": (6.0, 30.0)}
"""Gains: proportional, integral [1/s]."""
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
        self.k_p, self.k_i = gains.T[..., None]
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


def tracking_means(errors: pd.DataFrame) -> pd.DataFrame:
    """Return means over seeds and references by estimator, controller and arm."""
    groups = errors.groupby(["estimator", "controller", "session"], sort=False)
    columns = ["tracking_mm", "estimate_mm", "offset_mm", "bounded_%"]
    return groups["seed"].nunique().rename("seeds").to_frame().join(groups[columns].mean()).reset_index()


def tracking_table(means: pd.DataFrame, session: str) -> pd.DataFrame:
    """Return tracking errors [mm] by what is fed back and controller, and the largest error of each estimate [mm]."""
    part = means[means["session"] == session]
    wide = part.pivot(index="estimator", columns="controller", values="tracking_mm")
    wide = wide.loc[part["estimator"].unique(), list(CONTROLLERS)].rename_axis(columns=None)
    return wide.assign(error=part.groupby("estimator")["estimate_mm"].max()).reset_index()


HEADINGS = {
    "estimator": "fed back",
    "moderate gain": "moderate gain [mm]",
    "high gain": "high gain [mm]",
    "error": "error of the estimate [mm]",
}


NOISES = {"session": "arm", "noise_mt": "noise [mT]"} | {x: f"{x} [mm]" for x in (ALONE, FILTER, INFORMED)}


def noise_table(noises: pd.DataFrame) -> pd.DataFrame:
    """Return tracking errors [mm] with high gain by arm, noise of the sensors [mT] and estimator, of the study."""
    part = noises[(noises["controller"] == "high gain") & noises["estimator"].isin((ALONE, FILTER, INFORMED))]
    wide = part.pivot_table("tracking_mm", ["session", "noise_mt"], "estimator", sort=False)
    return (
        wide.rename_axis(columns=None).reset_index().sort_values(["session", "noise_mt"], ignore_index=True)
    )


IN_SHORT = """
**In short.** Yes, if the filter is given the command. With high gain and the noise of real sensors, {{ noise }} mT
(the first row), the bend is then {{ as_modelled[informed] | fixed(2) }} mm off its reference, against
{{ as_modelled[alone] | fixed(2) }} mm with least squares, whose estimate comes a sample late. A Kalman filter without
the command does as well at this noise if the arm is as modelled, but it is the worst of the three if the arm bends a
fifth further ({{ softer[plain] | fixed(1) }} mm). The table has root mean squares of this distance (synthetic); the
tip is off by about 2.5 times as much.
"""


def in_words(table: pd.DataFrame) -> str:
    """Return which estimate tracks best with high gain at the least noise, on both arms."""
    noise = table["noise_mt"].min()
    as_modelled, softer = (
        table[(table["session"] == arm) & (table["noise_mt"] == noise)].iloc[0] for arm in ARMS
    )
    names = {"alone": ALONE, "plain": FILTER, "informed": INFORMED}
    return sentences(IN_SHORT, noise=f"{noise:g}", as_modelled=as_modelled, softer=softer, **names)


SOFTER = """
With moderate gain, of the four estimators the {{ steady }} loses least: its tracking error grows from
{{ before | fixed(2) }} to {{ after | fixed(2) }} mm,
{{ "and it also tracks best" if steady == best else "but the " ~ best ~ " tracks best" }} ({{ least | fixed(2) }} mm).
"""


def softer_in_words(means: pd.DataFrame) -> str:
    """Return how tracking with moderate gain changes if the arm is softer than the filter believes."""
    part = means[(means["controller"] == "moderate gain") & ~means["estimator"].str.startswith("truth")]
    wide = part.pivot(index="estimator", columns="session", values="tracking_mm")
    before, after = (wide[session] for session in ARMS)
    steady, best = (after / before).idxmin(), after.idxmin()
    values = {"before": before[steady], "after": after[steady], "least": after[best]}
    return sentences(SOFTER, steady=steady, best=best, **values)
