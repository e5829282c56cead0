"""Martin et al. 2022: the arm with eight IMUs, a SYNTHETIC trial of it, errors of both models, the released files."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import cache, cached_property
from typing import NamedTuple

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike
from scipy.interpolate import CubicSpline
from scipy.signal import lfilter
from scipy.spatial.transform import Rotation, Slerp

from repro import Arm, calibrate_imus, calibrated, pcc_extended, rigid_body
from repro.common import require
from repro.estimators.imu import ShapeModel
from repro_companion.run import project_folder
from repro_companion.scorecard import published
from repro_companion.show import KEY, mean_ratio, number, sentences

# The arm and Table I

POSITIONS = 0.08 * np.arange(9)
"""Of the base and of IMUs #1 to #8 along the arm [m]."""
MARKERS = (0.36, 0.6)
"""Of M1 and M2 [m]."""
RIGID = {
    ("table", 2): (2, 6),
    ("table", 4): (2, 4, 6, 8),
    ("text", 2): (2, 6),
    ("text", 4): (1, 3, 5, 7),
    ("files", 2): (1, 6),
    ("files", 4): (1, 3, 5, 7),
}
"""IMUs of the rigid-body model: Table I and the text differ for four IMUs, the released files for two."""
HALF_TURN = (0.0, 0.0, 1.0, 0.0)
"""Of the base in the released chains: ``base_orientation_quaternion`` in ``my_config.yaml``."""
ORIGIN = (0.0, 0.0, 0.0178)
"""Of the released chains, above the base [m]."""
UP = np.array([0.0, 0.0, 1.0])


def arm(model: str, n_imus: int = 8, segments: int = 16, reading: str = "text") -> Arm:
    """Return IMUs and links of a model, "rigid" or "pcc", by Table I, the text, or the IMUs of the released files."""
    require(model in ("rigid", "pcc"), "model", "arm", "'rigid' or 'pcc'", repr(model))
    require(n_imus in (2, 4, 8), "n_imus", "arm", "2, 4 or 8", n_imus)
    require(reading in ("table", "text", "files"), "reading", "arm", "table, text or files", repr(reading))
    links = [0.64 / n_imus] * n_imus
    if model == "rigid":
        imus = RIGID.get((reading, n_imus), tuple(range(1, 9)))
        return Arm(imus, POSITIONS[list(imus)], links, MARKERS)
    whole = segments >= n_imus and segments % n_imus == 0
    require(whole, "segments", "arm", f"a multiple of the {n_imus} IMUs", segments)
    imus = tuple(range(0, 9, 8 // n_imus))
    return Arm(imus, POSITIONS[list(imus)], links, MARKERS, sub_segments=segments // n_imus)


def released_arm(model: str, n_imus: int = 8, segments: int = 16) -> Arm:
    """Return the chain behind a figure, with which the released table follows, and where it was evaluated."""
    if (model, n_imus) == ("rigid", 8):
        model, segments = "pcc", 8  # the boxes of the rigid-body model with eight IMUs are those of pcc1.csv
    own, rigid = arm(model, n_imus, segments, "files"), model == "rigid"
    first, *others = own.link_lengths
    made = replace(
        own,
        link_lengths=[first - (0.018 if rigid else ORIGIN[2]), *others],
        markers=(0.302, 0.542) if rigid else (0.3022, 0.5422),
        interpolation="midpoints",
        base_turn=(0.0, 0.0, 0.0, 1.0) if rigid else HALF_TURN,
        origin=ORIGIN,
    )
    if n_imus < 8:
        return made
    links = [0.057, *others]
    if segments > 8:
        return replace(made, link_lengths=links, markers=(0.337, 0.577), interpolation="inner points")
    seven = {"imus": own.imus[:-1], "imu_arcs": own.imu_arcs[:-1], "link_lengths": links[:-1]}
    return replace(made, **seven, markers=(0.297, 0.537))


def mid_section() -> Arm:
    """Return the chain of rigid.csv, which is in no figure: each IMU in the middle of its link but the first."""
    return Arm(range(1, 8), POSITIONS[1:8], [0.12, *[0.08] * 6], MARKERS)


def at_the_markers(made: Arm) -> Arm:
    """Return a released chain evaluated at the markers, if it was evaluated 40 mm before them."""
    if abs(made.markers[0] + made.origin[2] - MARKERS[0]) < 0.02:
        return made
    markers = [at + 0.04 for at in made.markers]
    if sum(made.link_lengths) < markers[1]:  # it ends below M2: IMU #8 takes it on
        longer = {"imus": [*made.imus, 8], "imu_arcs": [*made.imu_arcs, POSITIONS[8]]}
        made = replace(made, link_lengths=[*made.link_lengths, 0.08], **longer)
    return replace(made, markers=markers)


def shape(q: np.ndarray, made: Arm, arcs: ArrayLike) -> np.ndarray:
    """Return positions ``[..., points, 3]`` [m] by the arm's model, from orientations of base and all IMUs."""
    model = pcc_extended if np.any(made.sub_segments) else rigid_body
    return model(made.select(q), made, arcs)


# A SYNTHETIC trial: a Cosserat rod moved by a stick, as IMUs and motion capture would have seen it

SCHEDULE = {
    0.0: "oscillating",
    90.0: "buckling",
    112.0: "circling",
    134.0: "oscillating",
    206.0: "buckling",
    226.0: "circling",
}
"""Start [s] of each mode of motion; assumed, as all of the motion."""
SEEN = (*MARKERS, 0.20, 0.48, 0.64)
"""Markers, and further points that no fit may use [m]."""
RATE_HZ, LATENCY_S, SKEW_S, LATEST_START_S = 31.0, 0.010, 0.0038, 2.0
"""Readings of an IMU each second (section III-A); and assumed: their age, time between IMUs, start of the cameras."""
CAPTURE_HZ, CAPTURE_NOISE = 100.0, 0.001
"""Section III-A."""
LEAST_TOGETHER = 1000
"""Samples of the motion capture that two signals have in common to be compared."""


def product(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Return quaternions XYZW of the turns ``b``, then ``a``."""
    v = a[..., 3:] * b[..., :3] + b[..., 3:] * a[..., :3] + np.cross(a[..., :3], b[..., :3])
    return np.concatenate([v, a[..., 3:] * b[..., 3:] - (a * b)[..., :3].sum(-1, keepdims=True)], axis=-1)


@dataclass(frozen=True)
class Motion:
    """How the synthetic arm moved: positions ``[t, points, 3]`` [m] and orientations ``[t, 9, 4]`` at 50 Hz."""

    time_s: np.ndarray
    positions: np.ndarray
    arcs: np.ndarray
    orientations: np.ndarray

    @cached_property
    def splines(self) -> tuple[CubicSpline, list[CubicSpline]]:
        """Cubic splines in time, of the positions and of each orientation."""
        turned = [CubicSpline(self.time_s, q) for q in self.orientations.swapaxes(0, 1)]
        return CubicSpline(self.time_s, self.positions), turned

    def points(self, time_s: np.ndarray, arcs: Sequence[float] | np.ndarray) -> np.ndarray:
        """Return positions ``[t, points, 3]`` [m] at distances from the base that the file has."""
        columns = [int(np.argmin(np.abs(self.arcs - arc))) for arc in arcs]
        return self.splines[0](time_s)[:, columns]

    def imu(self, time_s: np.ndarray, k: int) -> np.ndarray:
        """Return how an IMU is turned, as quaternions ``[t, 4]``."""
        q = self.splines[1][k](time_s)
        return q / np.linalg.norm(q, axis=-1, keepdims=True)


@cache
def motion() -> Motion:
    """Read the motion, which PyElastica computed; the file holds second differences in time."""
    with np.load(project_folder() / "data" / "soft_arm.npz", allow_pickle=False) as file:
        steps = [file[name].astype(np.int64) for name in ("positions", "orientations")]
        positions, q = (np.moveaxis(x.cumsum(axis=-1).cumsum(axis=-1), -1, 0) for x in steps)
        q = q / np.linalg.norm(q, axis=-1, keepdims=True)
        return Motion(file["time_s"], 1e-5 * positions, file["point_arcs_m"], q)


@dataclass(frozen=True)
class Errors:
    """Standard deviations of what sensors and motion capture get wrong; all assumed."""

    mounting_deg: float = 3.0
    """Of each IMU about each of its axes."""
    heading_deg: float = 6.0
    heading_wander_deg: float = 2.0
    """With a correlation time of 40 s."""
    tilt_deg: float = 1.0
    """About each horizontal axis, once constant and once varying within 3 s."""
    frame_mm: float = 5.0
    """Of the origin of the motion capture, along each axis."""
    frame_deg: float = 2.0
    """Of its direction about the vertical."""


def wandering(
    steps: int, paths: tuple[int, int], time_s: float, generator: np.random.Generator
) -> np.ndarray:
    """Return stationary Gaussian processes of unit variance and correlation exp(-t/time_s), one step per reading."""
    decay = math.exp(-1 / (RATE_HZ * time_s))
    drawn = generator.standard_normal((steps, *paths))
    drawn[1:] *= math.sqrt(1 - decay**2)
    return lfilter([1.0], [1.0, -decay], drawn, axis=0)


def read_imus(moved: Motion, errors: Errors, generator: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Return times ``[rounds, 8]`` [s] and quaternions ``[rounds, 8, 4]`` of IMUs that are read in turn."""
    rounds = int((moved.time_s[-1] - 7 * SKEW_S) * RATE_HZ * (1 + 1e-12)) + 1
    seen_s = np.minimum(np.arange(rounds)[:, None] / RATE_HZ + SKEW_S * np.arange(8), moved.time_s[-1])
    mounting = np.radians(errors.mounting_deg) * generator.standard_normal((8, 3))
    heading = np.radians(errors.heading_deg) * generator.standard_normal((8, 1))
    tilt = np.radians(errors.tilt_deg) * generator.standard_normal((8, 2))
    wander = np.radians(errors.heading_wander_deg) * wandering(rounds, (8, 1), 40.0, generator)
    sway = np.radians(errors.tilt_deg) * wandering(rounds, (8, 2), 3.0, generator)
    repeated = generator.random((rounds, 8)) < 0.001
    q = np.empty((rounds, 8, 4))
    for k in range(8):
        turn, lean, mounted = (
            Rotation.from_rotvec(v).as_quat()
            for v in ((heading[k] + wander[:, k]) * UP, (tilt[k] + sway[:, k]) @ np.eye(2, 3), mounting[k])
        )
        q[:, k] = product(product(turn, lean), product(moved.imu(seen_s[:, k], k + 1), mounted))
    q = np.round(q * 2.0**14) / 2.0**14  # resolution of the sensor, datasheet BST-BNO055-DS000
    repeated[0] = False
    latest = np.maximum.accumulate(np.where(repeated, 0, np.arange(rounds)[:, None]), axis=0)
    return seen_s + LATENCY_S, np.take_along_axis(q, latest[..., None], axis=0)


@dataclass(frozen=True)
class Trial:
    """A trial on the clock of the IMUs: an upright base and eight IMUs ``[t, 9, 4]``, points ``[t, n, 3]`` [m]."""

    time_s: np.ndarray
    orientations: np.ndarray
    points: np.ndarray
    """M1 and M2 first."""


@dataclass(frozen=True)
class SyntheticTrial(Trial):
    """A synthetic trial with five points, and what a recording does not tell."""

    frame: Rotation
    origin: np.ndarray
    """Of the motion capture."""

    @property
    def mode(self) -> np.ndarray:
        """Return the mode of motion at each sample."""
        return modes_at(self.time_s)

    def truth(self, moved: Motion, arcs: Sequence[float] | np.ndarray, every: int = 1) -> np.ndarray:
        """Return where points of the arm were at every n-th sample [m], in the frame of the motion capture."""
        points = moved.points(self.time_s[::every] - LATENCY_S, arcs)
        return points @ self.frame.as_matrix().T + self.origin


def modes_at(time_s: np.ndarray) -> np.ndarray:
    """Return the mode of motion at each time."""
    return np.array([*SCHEDULE.values()])[np.searchsorted([*SCHEDULE], time_s, side="right") - 1]


def clock_lag(
    time_s: np.ndarray, a: np.ndarray, other_s: np.ndarray, b: np.ndarray, widest_s: float = 5.0
) -> float:
    """Return what to add to the other clock [s]: where two signals correlate best (section III-B3)."""
    step, widest = 1 / CAPTURE_HZ, round(CAPTURE_HZ * widest_s)
    on = []
    for t, values in ((time_s, a), (other_s, b)):
        k = np.arange(math.ceil(t[0] / step), math.floor(t[-1] / step) + 1)
        on.append((int(k[0]), np.interp(k * step, t, values)))
    (first_a, a), (first_b, b) = on

    def correlation(lag: int) -> float:
        start = first_b - first_a + lag  # of the second signal, in steps of the first
        i, j = max(start, 0), min(start + len(b), len(a))
        both = a[i:j], b[i - start : j - start]
        if j - i < LEAST_TOGETHER or min(map(np.ptp, both)) == 0:
            return -1.0
        return float(np.corrcoef(*both)[0, 1])

    coarse = max(range(-widest, widest + 1, 10), key=correlation)
    best = max(range(coarse - 10, coarse + 11), key=correlation)
    before, top, after = (correlation(best + k) for k in (-1, 0, 1))
    return step * (best + (before - after) / (2 * (before - 2 * top + after)))


def draw(moved: Motion, seed: int, errors: Errors | None = None) -> SyntheticTrial:
    """Record the motion with other sensors and another frame, and bring the recording onto one clock."""
    errors = errors or Errors()
    sensors, cameras, frames = (np.random.default_rng(s) for s in (seed, [seed, 1], [seed, 2]))
    origin = errors.frame_mm / 1e3 * frames.standard_normal(3)
    frame = Rotation.from_rotvec(np.radians(errors.frame_deg) * frames.standard_normal() * UP)
    read_s, q = read_imus(moved, errors, sensors)
    start = cameras.uniform(0.0, LATEST_START_S)
    capture_s = np.arange(int((moved.time_s[-1] - start) * CAPTURE_HZ) + 1) / CAPTURE_HZ
    seen = moved.points(start + capture_s, SEEN) @ frame.as_matrix().T + origin
    seen = seen + CAPTURE_NOISE * cameras.standard_normal(seen.shape)
    # The clock is that of the last IMU of a round; the others are interpolated.
    time_s = read_s[read_s[:, 7] <= read_s[-1, 0], 7]
    each = [Slerp(read_s[:, k], Rotation.from_quat(q[:, k]))(time_s).as_quat() for k in range(8)]
    q = np.stack([np.broadcast_to([0.0, 0.0, 0.0, 1.0], each[0].shape), *each], axis=1)
    height = shape(q, arm("pcc"), MARKERS[1])[:, 0, 2]
    capture_s = capture_s + clock_lag(time_s, height, capture_s, seen[:, 1, 2])
    known = (time_s >= capture_s[0]) & (time_s <= capture_s[-1])
    columns = [np.interp(time_s[known], capture_s, x) for x in seen.reshape(len(seen), -1).T]
    points = np.stack(columns, axis=-1).reshape(-1, len(SEEN), 3)
    return SyntheticTrial(time_s[known], q[known], points, frame, origin)


def synthetic_trials(seeds: Sequence[int], errors: Errors) -> list[SyntheticTrial]:
    """Return a trial of the motion for each seed, in their order."""
    moved = motion()
    with ThreadPoolExecutor() as pool:
        return [*pool.map(lambda seed: draw(moved, seed, errors), seeds)]


# Errors of the markers: Table II, Figs 3 to 6

FILES, DESCRIBED, SAME_POINT = "as in the files", "as described", "same point"
"""The chains of the released files where they were evaluated; text and Table I; those chains at the markers."""
QUANTILES = {"q05_mm": 5, "q25_mm": 25, "median_mm": 50, "q75_mm": 75, "q95_mm": 95}
KEYS = ["figure", "case", "model", "n_imus", "segments", "evaluation", "marker"]
AT_POINTS = ["before_m1_mm", "before_m2_mm", "m1_mm", "m2_mm"]
"""Medians of a chain 40 mm before both markers and at them."""
IN_TABLE_II = (
    ("8 interpolated links", "rigid-body", "before"),
    ("16 interpolated links, files", "PCC-extended", "at"),
)
"""Chains of the page behind the columns of the paper, and where the files evaluate them."""
RIGID_8, PCC_16 = "rigid-body, 8 IMUs", "PCC-extended, 8 IMUs, 16 segments"


class Case(NamedTuple):
    """A model as it stands in a figure."""

    figure: str
    model: str
    n_imus: int
    segments: int

    @property
    def name(self) -> str:
        """The case in words."""
        words = "PCC-extended, {} IMUs, {} segments" if self.model == "pcc" else "rigid-body, {} IMUs"
        return words.format(self.n_imus, self.segments)

    def arms(self) -> dict[str, Arm]:
        """Return its chain as in the released files, as described, and the released one at the markers."""
        released = released_arm(*self[1:])
        return {DESCRIBED: arm(*self[1:]), FILES: released, SAME_POINT: at_the_markers(released)}


def cases(imus: Sequence[int] = (2, 4, 8), segments: Sequence[int] = (8, 16, 32, 64)) -> list[Case]:
    """Return the models of Figs 3 to 5."""
    return [
        *(Case("Fig. 3", "rigid", n, n) for n in imus),
        *(Case("Fig. 4", "pcc", 8, n) for n in segments),
        *(Case("Fig. 5", "pcc", n, 16) for n in imus),
    ]


def distances(trial: Trial, made: Arm) -> np.ndarray:
    """Return how far a model's points are from M1 and M2 ``[t, 2]`` [mm]."""
    return 1e3 * np.linalg.norm(shape(trial.orientations, made, made.markers) - trial.points[:, :2], axis=-1)


def marker_errors(trials: Sequence[Trial], chosen: Sequence[Case]) -> pd.DataFrame:
    """Return quantiles of the markers' errors [mm] over the samples of each trial."""
    arms = [(case, evaluation, made) for case in chosen for evaluation, made in case.arms().items()]

    def of_trial(trial: Trial) -> dict[Arm, np.ndarray]:
        return {
            made: np.percentile(distances(trial, made), [*QUANTILES.values()], axis=0)
            for made in {made for *_, made in arms}
        }

    with ThreadPoolExecutor() as pool:
        found = [*pool.map(of_trial, trials)]
    lines = [
        (draw, case.figure, case.name, *case[1:], evaluation, f"M{k + 1}", *quantiles[made][:, k])
        for draw, quantiles in enumerate(found)
        for case, evaluation, made in arms
        for k in (0, 1)
    ]
    return pd.DataFrame(lines, columns=["draw", *KEYS, *QUANTILES])


def printed_numbers() -> dict[str, pd.DataFrame]:
    """Return the printed numbers of Table II and of Figs 3 to 5."""
    return {name: published("martin2022", name) for name in ("Table II", "Fig. 3", "Fig. 4", "Fig. 5")}


def chains_at_points(found: Mapping[str, Sequence[float]]) -> pd.DataFrame:
    """Return a row for each chain: median errors [mm] 40 mm before M1 and M2, and at them."""
    table = pd.DataFrame.from_dict(found, orient="index", columns=AT_POINTS)
    return table.rename_axis("chain").reset_index()


def chains_shown(apart: pd.DataFrame, printed: pd.DataFrame) -> pd.DataFrame:
    """Return the errors of the chains [mm] with headings, beside what Table II prints of two of them."""
    percent = printed[printed["quantity"] == "median"].set_index("row")["value"]
    m1, m2 = (1e3 * at / 100 for at in MARKERS)
    in_print = {
        chain: f"{percent[f'M1 {model}'] * m1:.0f}, {percent[f'M2 {model}'] * m2:.0f} {where}"
        for chain, model, where in IN_TABLE_II
    }
    heads = ["before M1", "before M2", "at M1", "at M2"]
    shown = apart.rename(columns=dict(zip(AT_POINTS, heads, strict=True)))
    return shown.assign(**{"Table II": [in_print.get(name, "–") for name in apart["chain"]]})


def chains_in_words(apart: pd.DataFrame, table: pd.DataFrame, synthetic: bool) -> str:
    """Return what the chains and their points do to the error, and how it goes with the number of IMUs."""
    medians = apart.set_index("chain")
    before, here = (medians.loc["8 interpolated links", c] for c in ("before_m1_mm", "m1_mm"))
    ends, middle = medians["m1_mm"].iloc[:2]
    fine = medians.loc["16 interpolated links, files", "m1_mm"]
    boxes = table[(table["evaluation"] == FILES) & (table["figure"] != "Fig. 4")]
    by_imus = boxes.groupby(["figure", "marker", "n_imus"])["median_mm"].mean()
    falls = by_imus.groupby(["figure", "marker"]).diff().dropna().lt(0).all()
    described = _rigid_medians(table)[DESCRIBED].xs("M1", level="marker")
    sizes = ", ".join(f"{x:.0f} mm with {count} IMUs" for count, x in described.items())
    numbers = {"before": before, "here": here, "fine": fine, "ends": ends, "middle": middle}
    less = {"apart": 100 * (1 - fine / before), "together": 100 * (1 - fine / here)}
    chains = sentences(CHAINS, **numbers, **less, synthetic=synthetic)
    return "\n\n".join((chains, sentences(BY_IMUS, falls=falls, sizes=sizes)))


def by_mode(error: np.ndarray, mode: np.ndarray, arcs: Iterable[float]) -> pd.DataFrame:
    """Return median and third quartile of errors ``[t, points]`` [mm] in all and in each mode of motion."""
    parts = []
    for part in ("all", *dict.fromkeys(mode.tolist())):
        median, q3 = np.percentile(error[(mode == part) | (part == "all")], [50, 75], axis=0)
        places = {"mode": part, "arc_mm": 1e3 * np.array([*arcs])}
        parts.append(pd.DataFrame(places | {"median_mm": median, "q75_mm": q3}))
    return pd.concat(parts, ignore_index=True)


def hull(moved: Motion, trials: Sequence[SyntheticTrial], every: int = 32) -> pd.DataFrame:
    """Return the arm in one pose of each mode, with the third quartile of the error as radius: Fig. 6.

    The errors are those of the PCC-extended model against the true points of the synthetic arm, in every n-th sample.
    """
    arcs, parts, first = 0.04 * np.arange(1, 17), [], trials[0]
    off = [shape(x.orientations[::every], arm("pcc"), arcs) - x.truth(moved, arcs, every) for x in trials]
    radius = np.percentile(1e3 * np.linalg.norm(np.concatenate(off), axis=-1), 75, axis=0)
    both = np.concatenate([first.truth(moved, arcs), shape(first.orientations, arm("pcc"), arcs)], axis=-1)
    for mode in dict.fromkeys(first.mode.tolist()):
        samples = np.flatnonzero(first.mode == mode)
        k = samples[len(samples) // 4]
        parts.append(in_hull(mode, first.time_s[k], arcs, both[k], radius))
    return pd.concat(parts, ignore_index=True)


def in_hull(mode: str, time_s: float, arcs: np.ndarray, both: np.ndarray, radius: np.ndarray) -> pd.DataFrame:
    """Return true and estimated points ``[n, 6]`` [m] of one pose with the radius [mm] around them, as a table."""
    columns = [f"{of}{axis}_mm" for of in ("", "estimate_") for axis in "xyz"]
    pose = pd.DataFrame(1e3 * both, columns=columns).assign(mode=mode, time_s=time_s)
    return pose.assign(arc_mm=1e3 * arcs, radius_mm=radius)


# The scorecard

TIME = "pcc_extended, 8 IMUs, 16 segments [samples/s]"
"""Name of the rate among the measured times."""
TIME_NOTE = (
    "CPU seconds of one core for 8,000 samples; the printed 18 minutes are of another computer, and the times in the "
    "released pcc2.csv span 20.7 min, so replay may be included: no ratio is stated"
)
NOTES: dict[str | tuple[str, str], str] = {
    "Fig. 3": "read off the figure",
    "Fig. 5": "read off the figure",
    "Section IV-A": "taken for marker M1",
    ("M1 rigid-body", "median"): "section IV-B prints 13.6 % for the same",
    ("M2 rigid-body", "median"): "section IV-B prints 11.5 % for the same",
}
"""By artefact, or by row and quantity."""
SYNTHETIC = "synthetic"
BEST_METHOD = "exact arcs of eight IMUs, calibrated on the first 60 s, evaluated on the rest"


def cases_of(row: str, known: Iterable[str]) -> tuple[list[str], str]:
    """Return which cases a row of the published numbers is about, and the marker.

    "16 segments and more" are those of the figure, and 48 segments where these are known.
    """
    n, segments = (re.search(rf"(\d+) {what}", row) for what in ("IMUs", "segments"))
    imus, parts = int(n[1]) if n else 8, int(segments[1]) if segments else 16
    model = "rigid" if "rigid" in row else "pcc"
    finer = (16, 32, 48, 64) if "and more" in row else (parts,)
    names = [Case("", model, imus, k).name for k in finer]
    return [name for name, k in zip(names, finer, strict=True) if k != 48 or name in known], (
        "M2" if row.startswith("M2") else "M1"
    )


def scorecard_rows(
    table: pd.DataFrame,
    best: pd.DataFrame,
    setting: str = SYNTHETIC,
    best_method: str = f"{BEST_METHOD}; synthetic",
) -> pd.DataFrame:
    """Return the rows of Martin et al.: as in the released files; the other evaluations stand in the notes.

    ``best`` has the errors of our method by distance along the arm [mm]. What is not synthetic is comparable.
    """
    data = project_folder() / "data"
    rate = pd.read_csv(data / "benchmark.csv").set_index("capability")["figure"][TIME]
    values = table.pivot_table(
        index=["evaluation", "draw"], columns=["case", "marker"], values=["median_mm", "q75_mm"]
    )
    lines, known = [], set(table["case"])
    for row in published("martin2022")[KEY[1:]].to_dict("records"):
        cases, marker = cases_of(row["row"], known)
        if row["quantity"] == "time":
            lines.append(row | {"regenerated": 8000 / rate, "setting": "benchmark", "note": TIME_NOTE})
            continue
        if not {RIGID_8 if row["quantity"] == "reduction" else cases[0], *cases} <= known:
            continue
        ours, own = _regenerated(row, values, cases, marker), {}
        if cases == [PCC_16] and row["quantity"] != "reduction":
            at, scale = _in_print(row["unit"], marker)
            own = {"best": scale * best[COLUMN[row["quantity"]]][at], "best_method": best_method}
        lines.append(row | own | {
            "regenerated": ours[FILES].mean(),
            "regenerated_std": ours[FILES].std(),
            "n_seeds": len(ours[FILES]),
            "setting": setting,
            "note": _note(row, cases, ours),
            "comparable": setting != SYNTHETIC,
        })  # fmt: skip
    return pd.DataFrame(lines).assign(paper="martin2022")


COLUMN = {"median": "median_mm", "q3": "q75_mm"}
"""Of each quantity."""


def _in_print(unit: str, marker: str) -> tuple[float, float]:
    """Return the marker's distance along the arm [mm], and the factor from errors in mm to a unit of print."""
    at = 1e3 * MARKERS[marker == "M2"]
    return at, 100 / at if unit == "%" else 1.0


def _regenerated(row: dict[str, str], values: pd.DataFrame, cases: list[str], marker: str) -> pd.Series:
    """Return a printed quantity by evaluation and draw, in the unit of print."""
    if row["quantity"] == "reduction":
        medians = values["median_mm"]
        return 100 * (1 - medians[PCC_16] / medians[RIGID_8]).mean(axis=1)
    _, scale = _in_print(row["unit"], marker)
    return scale * values[COLUMN[row["quantity"]]][[(case, marker) for case in cases]].mean(axis=1)


def _note(row: dict[str, str], cases: list[str], ours: pd.Series) -> str:
    """Return what is known of a row, and what the other evaluations give."""
    said = NOTES.get(row["artefact"]) or NOTES.get((row["row"], row["quantity"]), "")
    if row["quantity"] == "reduction":
        said = "of the medians"
    elif len(cases) > 1:
        segments = re.findall(r"(\d+) segments", " ".join(cases))
        said = f"mean of {', '.join(segments)}"
    if not {DESCRIBED, SAME_POINT} <= set(ours.index.get_level_values("evaluation")):
        return said
    text, marker_too = (f"{ours[way].mean():.3g}" for way in (DESCRIBED, SAME_POINT))
    others = f"the chain of the text: {text}; the chain of the files at the marker: {marker_too}"
    return "; ".join(filter(None, (said, others)))


def best_errors(calibration: pd.DataFrame) -> pd.DataFrame:
    """Return median and third quartile [mm] of our method by distance along the arm, means over the draws."""
    own = calibration[(calibration["method"] == BEST) & (calibration["mode"] == "all")]
    return own.groupby("point_mm")[["median_mm", "q75_mm"]].mean()


# What the page says of the synthetic arm


ABOUT_THE_ARM = (
    "Our *synthetic* arm is an elastic rod, moved by a stick in the three ways that the paper describes. Its IMUs are"
    " badly mounted, lose their heading and tilt a little, and the cameras have a frame of their own. We assumed the"
    " sizes of all these errors."
)


def below_table_ii(table: pd.DataFrame) -> str:
    """Return what the lower numbers of Table II are, and what the other chains give."""
    of_text = 100 * _rigid_medians(table)[DESCRIBED, 8] / (1e3 * np.array(MARKERS))
    return (
        "Lower: synthetic trials, mean ± standard deviation over sensor draws. The rigid-body chain of the files has"
        " interpolated links and is evaluated 40 mm before the markers (see below). Italic: the same chain at the"
        " markers. With the rigid links of the text the medians are {:.1f} % (M1) and {:.1f} % (M2).".format(
            *of_text
        )
    )


def _rigid_medians(table: pd.DataFrame) -> pd.Series:
    """Return medians [mm] of the rigid-body model, means over the draws, by evaluation, IMUs and marker."""
    return table[table["model"] == "rigid"].groupby(["evaluation", "n_imus", "marker"])["median_mm"].mean()


CHAINS = """
Median errors in mm, 40 mm *before* each marker and *at* it.
{% if together < apart %}
**{{ "On our synthetic arm" if synthetic else "In the authors' trial" }} the place of evaluation matters more than the
choice between the two models of Table II.**
{% endif %}
At M1 the third and the last row compare
{{ before | fixed(1) }} mm with {{ fine | fixed(1) }} mm, {{ apart | percent_less }}. At the same point it would be
{{ here | fixed(1) }} mm with {{ fine | fixed(1) }} mm, {{ together | percent_less }}. The paper states about 25 %
less. Where a *rigid* link sits matters more: {{ ends | fixed(0) }} mm if it ends at its IMU, as in the text, and
{{ middle | fixed(0) }} mm if the IMU is in its middle.
"""
BY_IMUS = """
{% if falls %}
At the points of the files the errors fall with the number of IMUs, as the published ones do in Figs 3 and 5.
{% endif %}
With the rigid links of the text the error at M1 is {{ sizes }}. With eight IMUs the links end at their IMUs, and with
fewer the IMUs sit in the middle.
"""


# Beyond the paper: calibrated on the first minute

BASELINE, BEST = "PCC-16", "exact arcs + all"
"""Names of methods in the study ``martin_calibration``: the paper's model as it is, and ours."""


def calibrated_errors(trial: SyntheticTrial, model: ShapeModel, per_imu: bool | None) -> pd.DataFrame:
    """Return errors [mm] after the first minute; on it the frame, or headings and mountings too, are calibrated."""
    made, q, origin = arm("pcc"), trial.orientations, np.zeros(3)
    first = trial.time_s - trial.time_s[0] < 60.0
    if per_imu is not None:
        found = calibrate_imus(q[first][::10], trial.points[first][::10, :2], model, made, per_imu=per_imu)
        q, origin = calibrated(q, found), found.translation
    off = model(q[~first], made, SEEN) + origin - trial.points[~first]
    return by_mode(1e3 * np.linalg.norm(off, axis=-1), trial.mode[~first], SEEN)


def calibration_ratios(table: pd.DataFrame) -> pd.DataFrame:
    """Return medians against those of the uncalibrated PCC-extended model, with a paired bootstrap (95 %)."""
    markers = table[table["point_mm"].isin(1e3 * np.array(MARKERS))].assign(point="markers")
    whole = pd.concat([markers, table.assign(point=table["point_mm"].map("{:g} mm".format))])
    medians = whole.pivot_table(
        index="draw", columns=["method", "mode", "point"], values="median_mm", sort=False
    )
    lines = []
    for method, mode, point in medians:
        ours, base = (medians[name, mode, point].to_numpy() for name in (method, BASELINE))
        lines.append((method, mode, point, ours.mean(), *mean_ratio(ours, base, 2000), len(ours)))
    names = ["method", "mode", "point", "median_mm", "ratio", "ratio_low", "ratio_high", "draws"]
    return pd.DataFrame(lines, columns=names)


CALIBRATED = """
{% if synthetic %}
{{ own }} Our synthetic sensors err in the ways that the fit knows. Expect less gain on a real arm.
{% else %}
The cell above has the medians of the authors' trial. *Not calibrated* has no frame fitted either. The table of
both evaluations says what the frame alone gives. On the synthetic arm it is so: {{ own }}
{% endif %}
"""


def calibration_in_words(ratios: pd.DataFrame, parameters: int, synthetic: bool) -> str:
    """Return how much the calibration gains on the synthetic arm, and what that says of the arm of the page."""
    own = ratios[(ratios["mode"] == "all") & (ratios["point"] == "markers")].set_index("method")
    median_mm = {name: f"{number(x, 2)} mm" for name, x in own["median_mm"].items()}
    imus = (parameters - 6) // 3
    words = (
        f"Over both markers and {own['draws'].max()} synthetic draws the median error falls from"
        f" {median_mm[BASELINE]} to {median_mm[BEST]}, with {parameters} parameters: six of the frame, and three of"
        f" each of the {imus} IMUs between base and M2. The frame alone brings it to"
        f" {median_mm['exact arcs + frame']}."
    )
    return sentences(CALIBRATED, own=words, synthetic=synthetic)
