"""A continuum robot under motion capture, recorded by others: readings, filter and smoother, models of its shape.

The recordings were published with two papers of Teetaert et al. under the MIT licence, in
``data/recordings/continuum_robot``. A trial is a folder with one file for each sensor: the first line names its kind,
the second its columns; then every row is a time [s], a distance along the robot [m] and the data. A gyroscope gives
its angular velocity in its own frame [rad/s]. Trackers and motion capture give a pose as its logarithm in se(3), the
translation part first [m, rad]. The motion capture is the truth and never an input.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from functools import reduce
from itertools import pairwise, product
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pandas as pd
from scipy import stats
from scipy.optimize import brentq, least_squares
from scipy.spatial.transform import RigidTransform, Rotation

import repro
from repro.common import bad_input, require
from repro.estimators.imu import ShapeModel
from repro.estimators.kalman import smoothed
from repro.estimators.rod import RodFilter
from repro_companion.run import digest, project_folder, recordings_folder
from repro_companion.show import number, sentences

LENGTH = 0.466
STATIONS = (0.1165, 0.233, 0.3495, 0.466)
"""Where errors are computed: the quarters of the arm [m]."""
WIDTHS = {"aurora0": 6, "aurora1": 6, "gyro_mid": 3, "gyro_ee": 3}
"""Files of the sensors, in the order of the readings, and how many numbers each reads."""
TIP_TRACKER = slice(6, 12)
BODIES = tuple(f"vicon{k}" for k in range(5))
CHOOSING = "slow_free_space"
"""The trial on which we choose; all others are only evaluated."""
WINDOWS_S = {
    "slow_free_space": (19.0, 29.0),
    "impulse_1": (20.0, 30.0),
    "fast_contact": (10.0, 20.0),
    "impulse_2": (8.0, 18.0),
    "out_of_bounds": (15.0, 25.0),
}
"""The part of each trial that the authors' program estimates and scores."""
SAME = ("impulse_1", "fast_contact")
"""Two windows of one recording: their files are the same."""
RELEASED = project_folder() / "data/recordings/continuum_robot/released_estimates"
"""What the authors' released program made of these trials, run by us."""
NEAR_S = 0.011
"""A reading of a tracker and a frame of the motion capture within this time belong together."""


class Capture(NamedTuple):
    """What was read in a window, NaN where a sensor was not read, and the poses of the bodies at the stations."""

    name: str
    time_s: np.ndarray
    u: np.ndarray
    truth: tuple[tuple[np.ndarray, np.ndarray], ...]
    folder: Path


class TrackerErrors(NamedTuple):
    """Standard deviations of position [m] and rotation [rad], new at every reading, and of what lasts a time [s]."""

    white: tuple[float, float]
    lasting: tuple[float, ...]
    time_s: float


def read(
    folder: Path, sensor: str, window: tuple[float, float] | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """Return times ``[n]`` and data ``[n, 3 or 6]`` of a file.

    Raises
    ------
    InputError
        If it is not there, or a row is not as described at the head of this module.
    """
    path, width = folder / f"{sensor}.csv", WIDTHS.get(sensor, 6)
    require(path.is_file(), "recording", "the continuum robot", "a file that exists", path)
    try:
        table = np.loadtxt(path, delimiter=",", skiprows=2, ndmin=2)
    except ValueError as error:
        raise bad_input(path.name, "the continuum robot", "rows of numbers below two lines", error) from error
    good = table.shape[1:] == (2 + width,) and len(table) and np.isfinite(table).all()
    require(good, path.name, "the continuum robot", f"rows of {2 + width} numbers", f"shape {table.shape}")
    require(
        (np.diff(table[:, 0]) > 0).all(), path.name, "the continuum robot", "later in every row", "others"
    )
    if window is not None:
        table = table[(table[:, 0] >= window[0]) & (table[:, 0] <= window[1])]
    return table[:, 0], table[:, 2:]


def poses(twists: np.ndarray) -> np.ndarray:
    """Return poses ``[..., 4, 4]`` of logarithms, translation part first."""
    flat = np.roll(twists.reshape(-1, 6), 3, axis=1)
    return RigidTransform.from_exp_coords(flat).as_matrix().reshape(*twists.shape[:-1], 4, 4)


def logarithms(T: np.ndarray) -> np.ndarray:
    """Return logarithms ``[..., 6]`` of poses, translation part first."""
    flat = RigidTransform.from_matrix(T.reshape(-1, 4, 4)).as_exp_coords()
    return np.roll(flat, 3, axis=1).reshape(*T.shape[:-2], 6)


def trials() -> dict[str, tuple[Path, tuple[float, float] | None]]:
    """Return folder and window of every trial, CHOOSING first, fetched ones last; a window of None is all."""
    roots = (
        project_folder() / "data/recordings/continuum_robot",
        recordings_folder() / "continuum_robot/assets/data",
    )
    folders = [path for root in roots for path in sorted(root.glob("*/")) if (path / "aurora0.csv").is_file()]
    content = {tuple(digest(path / f"{name}.csv") for name in WIDTHS): path for path in reversed(folders)}
    found = {
        name: (folder, WINDOWS_S.get(name))
        for folder in sorted(content.values(), key=folders.index)
        for name in (SAME if folder.name in SAME else (folder.name,))
    }
    return {name: found[name] for name in sorted(found, key=lambda name: name != CHOOSING)}


def capture(name: str, folder: Path, window: tuple[float, float] | None) -> Capture:
    """Return what was read in a window, all sensors on one clock."""
    parts = [read(folder, sensor, window) for sensor in WIDTHS]
    time_s, place = np.unique(np.concatenate([t for t, _ in parts]), return_inverse=True)
    u, edges, at = np.full((len(time_s), 18), np.nan), np.cumsum([0, *WIDTHS.values()]), 0
    for (t, data), (first, stop) in zip(parts, pairwise(edges), strict=True):
        u[place[at : at + len(t)], first:stop] = data
        at += len(t)
    truth = [read(folder, body, window) for body in BODIES[1:]]
    return Capture(name, time_s, u, tuple((t, poses(x)) for t, x in truth), folder)


def tracker_pairs() -> list[tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """Return times, poses of the tracker and of the body beside it, at base and tip, over all of CHOOSING."""
    folder, pairs = trials()[CHOOSING][0], []
    for tracker, body in (("aurora0", "vicon0"), ("aurora1", "vicon4")):
        (t, x), (frames, y) = read(folder, tracker), read(folder, body)
        near = np.abs(frames[:, None] - t).argmin(1)
        kept = np.abs(frames - t[near]) < NEAR_S
        pairs.append((frames[kept], poses(x[near[kept]]), poses(y[kept])))
    return pairs


def moved(constants: np.ndarray, T: np.ndarray, share: float) -> np.ndarray:
    """Return poses in the frame of the motion capture, of its bodies instead of the trackers'.

    The constants ``[18]`` are twists of the tracker's frame, of the body at the base and of the body at the tip; in
    between, the body's twist goes with the share of the length.
    """
    frame, base, tip = constants.reshape(3, 6)
    return poses(frame) @ T @ poses((1 - share) * base + share * tip)


def calibration_constants() -> np.ndarray:
    """Fit the 18 constants to all of CHOOSING: a radian counts as much as 0.1 m."""
    pairs = tracker_pairs()

    def residuals(constants: np.ndarray) -> np.ndarray:
        parts = [1e-3 * constants]  # what the trackers do not tell apart stays small
        for share, (_, T, truth) in enumerate(pairs):
            found = moved(constants, T, share)
            turned = Rotation.from_matrix(found[:, :3, :3]).inv() * Rotation.from_matrix(truth[:, :3, :3])
            parts += [(found - truth)[:, :3, 3].ravel(), 0.1 * turned.as_rotvec().ravel()]
        return np.concatenate(parts)

    return least_squares(residuals, np.zeros(18)).x


def calibrated(read_out: Capture, constants: np.ndarray) -> Capture:
    """Return the same readings with the trackers moved by the constants."""
    u = read_out.u.copy()
    for share, columns in enumerate((slice(0, 6), TIP_TRACKER)):
        there = np.isfinite(u[:, columns]).all(1)
        u[there, columns] = logarithms(moved(constants, poses(u[there, columns]), share))
    return read_out._replace(u=u)


def tracker_errors(constants: np.ndarray) -> pd.DataFrame:
    """Return how large the errors of the trackers are, and how they last, over all of CHOOSING.

    A residual is the twist from tracker to motion capture. We take its root mean square, its white part, which has
    half of the variance of the steps from frame to frame, and the time after which its correlation falls below 1/e,
    infinite if it does not in a quarter of the trial. Each is for one axis, a mean over three.
    """
    rows = []
    for share, (t, T, truth) in enumerate(tracker_pairs()):
        r = logarithms(np.linalg.inv(moved(constants, T, share)) @ truth)
        near = np.diff(t) < 0.1
        white = (np.diff(r, axis=0)[near] ** 2).mean(0) / 2
        for part, columns in (("position_mm", slice(0, 3)), ("rotation_deg", slice(3, 6))):
            x, factor = r[:, columns], 1e3 if part == "position_mm" else math.degrees(1)
            steps = range(1, len(x) // 4)
            fading = [(x[k:] * x[:-k]).mean() / (x**2).mean() for k in steps]
            lag = next((k for k, c in zip(steps, fading, strict=True) if c < math.exp(-1)), math.inf)
            rows.append(
                {
                    "tracker": ("base", "tip")[share],
                    "part": part,
                    "rms": factor * math.sqrt((x**2).mean()),
                    "white": factor * math.sqrt(white[columns].mean()),
                    "lasts_s": float(lag * np.median(np.diff(t))),
                }
            )
    return pd.DataFrame(rows)


def gyroscope_errors() -> tuple[float, float]:
    """Return the root mean square [rad/s] by which gyroscopes and turning bodies differ over all of CHOOSING."""
    folder, found = trials()[CHOOSING][0], []
    for gyroscope, body in (("gyro_mid", "vicon2"), ("gyro_ee", "vicon4")):
        (t, rate), (frames, x) = read(folder, gyroscope), read(folder, body)
        R = Rotation.from_matrix(poses(x)[:, :3, :3])
        turn = (R[:-1].inv() * R[1:]).as_rotvec() / np.diff(frames)[:, None]
        within = [(t >= a) & (t <= b) for a, b in pairwise(frames)]
        steps = zip(within, turn, np.diff(frames), strict=True)
        off = [rate[k].mean(0) - w for k, w, step in steps if k.any() and step < 0.1]
        found.append(float(np.sqrt(np.mean(np.square(off)))))
    return found[0], found[1]


ERROR_MODELS = ("white", "inflated", "estimated")
TRACKER_HZ = 50.0


def errors_of(table: pd.DataFrame, model: str, memory_s: float) -> list[TrackerErrors]:
    """Return the errors of the trackers at base and tip for a filter, by one of three models of what lasts in them.

    "White" takes the whole error for white, "estimated" follows what lasts beside the shape. "Inflated" counts what
    lasts as often as a tracker is read while the shape remembers, so that it keeps its size in their mean.
    """
    found = []
    for tracker in ("base", "tip"):
        own = table[table["tracker"] == tracker].set_index("part")
        rms, white = (own[name].to_numpy() * [1e-3, math.radians(1)] for name in ("rms", "white"))
        lasting = np.sqrt(rms**2 - white**2)
        often = max(1.0, TRACKER_HZ * memory_s) if model == "inflated" else 1.0
        whole = TrackerErrors(tuple(np.sqrt(white**2 + often * lasting**2)), (), math.inf)
        apart = TrackerErrors(tuple(white), tuple(lasting), float(own["lasts_s"].mean()))
        found.append(apart if model == "estimated" else whole)
    return found


def estimates(method: RodFilter, readings: Capture) -> dict[str, list[tuple[np.ndarray, np.ndarray]]]:
    """Return errors ``[k, 3]`` [m] of filter and smoother and their covariances at each station's own frames.

    At a frame the filter says what the readings until then make of the shape; the smoother knows all readings.
    """
    asked = np.unique(np.concatenate([t for t, _ in readings.truth]))
    events = [(t, 0, k) for k, t in enumerate(readings.time_s)] + [(t, 1, 0) for t in asked]
    state, states, frames = method.init(), [], []
    for t, is_frame, k in sorted(events):
        if is_frame:
            state = method.predicted(state, t)
            frames.append(len(states))
        else:
            state, _ = method.step(state, readings.u[k], t)
        states.append(state)
    found = {}
    for name, passed in (("filter", states), ("smoother", smoothed(method, states))):
        q, C = (np.stack([getattr(passed[k], part) for k in frames]) for part in ("q", "covariance"))
        n = method.n_q
        p, spread = method.positions(q[:, :n], C[:, :n, :n], STATIONS)
        rows = [np.searchsorted(asked, t) for t, _ in readings.truth]
        found[name] = [
            (p[row, k] - T[:, :3, 3], spread[row, k])
            for k, (row, (_, T)) in enumerate(zip(rows, readings.truth, strict=True))
        ]
    return found


def released(readings: Capture, estimator: str, constants: np.ndarray) -> list[np.ndarray] | None:
    """Return errors [m] of the authors' program at each station, moved by the constants; None without its file."""
    path = RELEASED / f"{readings.name}_{estimator}.csv"
    if not path.is_file():
        return None
    table, found = np.loadtxt(path, delimiter=",", skiprows=1), []
    for arc, (t, T) in zip(STATIONS, readings.truth, strict=True):
        own = table[np.abs(table[:, 1] - arc) < 1e-3]
        near = np.abs(t[:, None] - own[:, 0]).argmin(1)
        kept = np.abs(t - own[near, 0]) < 1e-3
        at = moved(constants, poses(own[near, 2:8]), arc / LENGTH)
        found.append((at[:, :3, 3] - T[:, :3, 3])[kept])
    return found


def error_rows(
    name: str, setting: str, estimator: str, errors: Sequence[np.ndarray]
) -> list[dict[str, str | float]]:
    """Return the root mean square error [mm] at every station."""
    return [
        {"trial": name, "setting": setting, "estimator": estimator, "station_mm": 1e3 * arc}
        | {"rmse_mm": 1e3 * math.sqrt((e**2).sum(-1).mean())}
        for arc, e in zip(STATIONS, errors, strict=True)
    ]


def scores(parts: Sequence[tuple[np.ndarray, np.ndarray]], added: float = 0.0) -> np.ndarray:
    """Return squared errors in units of their covariance, all stations one after the other.

    The covariance is the stated one and one of an error that is added, of one deviation [m] along every axis.
    """
    both = [(error, C + added**2 * np.eye(3)) for error, C in parts]
    return np.concatenate(
        [np.einsum("ni,ni->n", e, np.linalg.solve(C, e[..., None])[..., 0]) for e, C in both]
    )


def coverage(found: dict[str, list[tuple[np.ndarray, np.ndarray]]], level: float = 0.9) -> pd.DataFrame:
    """Return how often ellipsoids cover the truth [%] and how large they are [mm], as stated and widened, by trial.

    What widens them is an error that is added to every position, the smallest with which they cover the level in
    CHOOSING. Their size is the median of the shortest and of the longest semi-axis.
    """
    edge = stats.chi2(3).ppf(level)

    def beyond(added: float) -> float:
        return float(np.quantile(scores(found[CHOOSING], added), level) - edge)

    needed, lines = brentq(beyond, 0.0, 2 * LENGTH) if beyond(0.0) > 0 else 0.0, []
    for name, parts in found.items():
        variances = np.concatenate([np.linalg.eigvalsh(C) for _, C in parts])
        for ellipsoids, added in (("as stated", 0.0), ("widened", needed)):
            covered = scores(parts, added) <= edge
            axes = 1e3 * np.median(np.sqrt(edge * (variances + added**2)), axis=0)
            lines.append(
                {"trial": name, "ellipsoids": ellipsoids, "added_mm": 1e3 * added, "positions": len(covered)}
                | {"covered_percent": 100 * covered.mean(), "shortest_mm": axes[0], "longest_mm": axes[-1]}
            )
    return pd.DataFrame(lines)


# Models of the shape, fitted to the motion capture itself


def body_poses(name: str) -> np.ndarray:
    """Return poses ``[frames, 5, 4, 4]`` of all bodies in the frame of the first, where all were seen at one time."""
    folder, window = trials()[name]
    seen = [read(folder, body, window) for body in BODIES]
    common = reduce(np.intersect1d, [t for t, _ in seen])
    T = np.stack([poses(x[np.searchsorted(t, common)]) for t, x in seen], axis=1)
    return np.linalg.inv(T[:, :1]) @ T


def shape_models() -> dict[str, repro.Robot]:
    """Return arms of one, two and three arcs, and of affine curvature; none of them lengthens."""
    arcs = {
        f"{word} arc{'s' * (n > 1)}": repro.Robot(
            [repro.ConstantCurvature(LENGTH / n, 1.0, extensible=False)] * n
        )
        for n, word in enumerate(("one", "two", "three"), 1)
    }
    turn = [-20.0, -40.0, -math.pi, 0.0], [20.0, 40.0, math.pi, 0.0]
    affine = repro.Robot(
        [repro.AffineCurvature(LENGTH)], lower=turn[0], upper=turn[1], start=[0.3, 0.1, 0.1, 0.0]
    )
    return {**arcs, "affine curvature": affine}


def at_stations(robot: repro.Robot) -> list[tuple[int, float]]:
    """Return segment and place along it of every station."""
    length, found = robot.segments[0].length, []
    for arc in STATIONS:
        segment = max(1, math.ceil(arc / length - 1e-9))
        found.append((segment, min(arc - (segment - 1) * length, length)))
    return found


SEEN = {"tip": (3,), "middle and tip": (1, 3)}
"""Stations whose poses a fit is given."""


def floors(
    names: Sequence[str], every: int, unseen_error: Callable[[repro.Robot, np.ndarray, list[int]], float]
) -> pd.DataFrame:
    """Return how far models of the shape are from the bodies [mm], where a fit to some poses does not see them.

    The bodies sit beside the arm, which is a part of these errors. Their turn about the arm is not used: their
    rotation is the shortest one to their direction.
    """
    rows = []
    for name in names:
        T = body_poses(name)[::every, 1:]
        x, y, z = np.moveaxis(T[..., :3, 2], -1, 0)
        across = np.hypot(x, y)
        turn = (np.arctan2(across, z) / across)[..., None] * np.stack([-y, x, 0 * z], axis=-1)
        T[..., :3, :3] = Rotation.from_rotvec(turn.reshape(-1, 3)).as_matrix().reshape(*turn.shape, 3)
        rows += [
            {
                "trial": name,
                "model": model,
                "given": given,
                "error_mm": float(unseen_error(robot, T, [*seen])),
            }
            for (model, robot), (given, seen) in product(shape_models().items(), SEEN.items())
        ]
    return pd.DataFrame(rows)


def imu_arm(n: int, where: str) -> repro.Arm:
    """Return an arm with IMUs at its base and at n - 1 stations, links ending at them or centred on them.

    Links that end at their IMU have no use for the one on the base.
    """
    arcs = LENGTH * np.arange(5) / 4
    imus = {5: (0, 1, 2, 3, 4), 3: (0, 2, 4), 2: (0, 4)}[n]
    at, link = arcs[list(imus)], LENGTH / (n - 1)
    if where == "end":
        return repro.Arm(imus[1:], at[1:], [link] * (n - 1), STATIONS)
    if where == "middle":
        return repro.Arm(imus, at, [link / 2, *[link] * (n - 2), link / 2], STATIONS)
    return repro.Arm(imus, at, [link] * (n - 1), STATIONS, sub_segments=2)


IMU_MODELS: dict[str, tuple[ShapeModel, str]] = {
    "rigid links that end at their IMU": (repro.rigid_body, "end"),
    "rigid links centred on their IMU": (repro.rigid_body, "middle"),
    "PCC-extended, two sub-segments": (repro.pcc_extended, "between"),
    "exact arcs": (repro.exact_arcs, "between"),
}


def imu_errors(names: Sequence[str]) -> pd.DataFrame:
    """Return errors of the IMU models [mm] on this arm, with orientations and positions of the motion capture."""
    rows = []
    for name in names:
        T = body_poses(name)
        for n, (model, (function, where)) in product((2, 3, 5), IMU_MODELS.items()):
            arm = imu_arm(n, where)
            R = Rotation.from_matrix(T[:, list(arm.imus), :3, :3].reshape(-1, 3, 3))
            shape = function(R.as_quat().reshape(len(T), -1, 4), arm, STATIONS)
            error = 1e3 * np.sqrt(((shape - T[:, 1:, :3, 3]) ** 2).sum(-1).mean(0)).mean()
            rows.append({"trial": name, "bodies": n, "model": model, "error_mm": error})
    return pd.DataFrame(rows)


def still(
    readings: Capture, parts: Sequence[tuple[np.ndarray, np.ndarray]], constants: np.ndarray
) -> pd.DataFrame:
    """Return positions [mm] by motion capture, our smoother and the released window, where the middle errs most."""
    common = reduce(np.intersect1d, [t for t, _ in readings.truth])
    rows = [np.searchsorted(t, common) for t, _ in readings.truth]
    off = np.stack([error[row] for row, (error, _) in zip(rows, parts, strict=True)], axis=1)
    p = np.stack([T[row, :3, 3] for row, (_, T) in zip(rows, readings.truth, strict=True)], axis=1)
    k = int(np.linalg.norm(off[:, 1], axis=-1).argmax())
    lines = {"motion capture": p[k], "our smoother": p[k] + off[k]}
    path = RELEASED / f"{readings.name}_window.csv"
    if path.is_file():
        table = np.loadtxt(path, delimiter=",", skiprows=1)
        own = table[np.abs(table[:, 0] - common[k]) < 1e-3]
        arcs = [own[np.abs(own[:, 1] - arc).argmin()] for arc in STATIONS]
        lines["window, released"] = np.stack(
            [moved(constants, poses(row[2:8]), row[1] / LENGTH)[:3, 3] for row in arcs]
        )
    points = [
        {"line": name, "station_mm": 1e3 * arc, **dict(zip(("x_mm", "y_mm", "z_mm"), 1e3 * x, strict=True))}
        for name, line in lines.items()
        for arc, x in zip(STATIONS, line, strict=True)
    ]
    return pd.DataFrame(points).assign(time_s=common[k])


# What the page shows

WORDS = {"slow_free_space": "slow, untouched", "impulse_1": "hit", "fast_contact": "shaken"}
"""Trials as a reader sees them."""


def span(values: pd.Series, digits: int = 0) -> str:
    """Return the smallest and the largest value, once if they read the same."""
    return " to ".join(dict.fromkeys(f"{x:.{digits}f}" for x in (values.min(), values.max())))


def floors_in_words(floors: pd.DataFrame) -> str:
    """Return how wrong one and two arcs are that know the pose of the tip."""
    arcs = floors[floors["given"] == "tip"].set_index("model")["error_mm"]
    share = 100 * arcs["one arc"] / (1e3 * LENGTH)
    return (
        f"**An arc is {span(arcs['one arc'])} mm wrong on this arm**, or {span(share)} % of its length, although"
        f" it knows where the tip is. Two arcs are {span(arcs['two arcs'])} mm wrong. Here are root mean square"
        " distances at the bodies that the fit did not see, in three trials."
    )


def by_trial(table: pd.DataFrame, rows: list[str], value: str) -> pd.DataFrame:
    """Return a table of errors [mm] with a column for each trial, rows and columns in their order."""
    wide = table.pivot_table(value, rows, "trial", sort=False)[list(table["trial"].unique())]
    return wide.rename(columns=lambda name: f"{WORDS.get(name, name)} [mm]").reset_index()


def rows_of(name: str, setting: str, model: str, found: dict[str, list]) -> list[dict]:
    """Return the errors at every station of what the estimators found."""
    return [
        row | {"model": model}
        for estimator, part in found.items()
        for row in error_rows(name, setting, estimator, [error for error, _ in part])
    ]


def choice_in_words(trackers: pd.DataFrame, slow: pd.Series, choice: pd.DataFrame) -> str:
    """Return how wrong the tip's tracker is, what the slow trial chooses, and where another model is better."""
    tip = trackers.query("setting == 'calibrated' and tracker == 'tip'").set_index("part")["rms"]
    kept = str(slow.idxmin())
    others = " and ".join(f"*{model}* has {slow[model]:.1f} mm" for model in ERROR_MODELS if model != kept)
    smoother = choice[choice["estimator"] == "smoother"].set_index(["model", "setting", "trial"])["rmse_mm"]
    lower = smoother["inflated"] < smoother["white"]
    return (
        f"After calibration the tip's tracker is wrong by {tip['position_mm']:.1f} mm and"
        f" {tip['rotation_deg']:.1f}° along and about each axis. The slow trial chooses *{kept}* with"
        f" {slow[kept]:.1f} mm, and {others}. By our smoother alone, *inflated* would be better than *white* in"
        f" {lower.sum()} of {lower.size} cases (raw or calibrated, by trial)."
    )


def all_errors(
    ours: pd.DataFrame, captures: dict[str, Capture], settings: dict[str, np.ndarray]
) -> pd.DataFrame:
    """Return our errors at every station, then those of the released program."""
    rows = []
    for setting, estimator, name in product(settings, ("filter", "window", "batch"), captures):
        error = released(captures[name], estimator, settings[setting])
        if error is not None:
            rows += error_rows(name, setting, f"released {estimator}", error)
    return pd.concat([ours.drop(columns="model"), pd.DataFrame(rows)], ignore_index=True)


RAW = """
**In short.** On raw readings our smoother is {{ "better" if hit[0] < hit[1] else "worse" }} than the authors' own
sliding window when the arm is hit ({{ hit[0] | fixed(0) }} mm against {{ hit[1] | fixed(0) }} mm), and
{{ "better" if slow[0] < slow[1] else "worse" }} in the slow trial, on which we chose its settings
({{ slow[0] | fixed(0) }} mm against {{ slow[1] | fixed(0) }} mm).
"""


def raw_in_words(errors: pd.Series) -> str:
    """Return our errors on raw readings beside those of the released window, in a trial that chose nothing first."""
    hit, slow = (
        [errors[name, "raw", estimator] for estimator in ("smoother", "released window")]
        for name in (SAME[0], CHOOSING)
    )
    return sentences(RAW, hit=hit, slow=slow)


COMPARED = {"smoother": "our smoother", "released window": "authors' window"}
"""Estimators that the page compares, as a reader sees them."""


def compared(errors: pd.Series) -> pd.DataFrame:
    """Return our errors above those of the released window, on raw readings first, with a column for each trial."""
    table = errors.rename("error_mm").reset_index().replace({"estimator": COMPARED})
    table = table[table["estimator"].isin(COMPARED.values())].rename(columns={"setting": "readings"})
    raw_first = table.sort_values("readings", ascending=False, kind="stable")
    return by_trial(raw_first, ["readings", "estimator"], "error_mm")


SURE = """
**How sure can one be?** With calibrated trackers our smoother is off by {{ slow }} mm along the arm in the slow
trial, on which we chose its settings, and by {{ off }} mm in the others. The ellipsoids of filter and smoother should
cover {{ level }} % of the positions. In the other trials they cover {{ stated.covered }} as stated, with semi-axes of
{{ stated.axes }} mm. If we widen them until they cover {{ level }} % in the slow trial, they cover
{{ widened.covered }} in the others, with semi-axes of {{ widened.axes }} mm.
"""


def sure_in_words(errors: pd.Series, bands: pd.DataFrame, kept: str, level: float) -> str:
    """Return how large our errors are, and the size of the regions that cover the truth as often as they say."""
    smoother = errors.xs("smoother", level="estimator").xs("calibrated", level="setting")
    others = bands[(bands["model"] == kept) & (bands["trial"] != CHOOSING)]
    stated, widened = (others[others["ellipsoids"] == how] for how in ("as stated", "widened"))
    return sentences(
        SURE,
        off=span(smoother.drop(CHOOSING)),
        slow=f"{smoother[CHOOSING]:.0f}",
        level=f"{100 * level:.0f}",
        stated=region(stated),
        widened=region(widened),
    )


def region(bands: pd.DataFrame) -> dict[str, str]:
    """Return from where to where semi-axes go, and how often their ellipsoids cover the truth."""
    covered = np.average(bands["covered_percent"], weights=bands["positions"])
    axes = " to ".join(number(x, 1) for x in (bands["shortest_mm"].min(), bands["longest_mm"].max()))
    return {"axes": axes, "covered": f"{covered:.0f} %"}


def sure_shown(bands: pd.DataFrame) -> pd.DataFrame:
    """Return for each estimator how often its ellipsoids cover the truth, by trial, and their extreme semi-axes."""
    keys = ["ellipsoids", "estimator"]
    axes = bands.groupby(keys, sort=False).agg({"shortest_mm": "min", "longest_mm": "max"})
    covered = bands.pivot_table("covered_percent", keys, "trial", sort=False)
    covered = covered.rename(columns=lambda name: f"{WORDS.get(name, str(name)).split(',')[0]} [%]")
    heads = {"shortest_mm": "shortest [mm]", "longest_mm": "longest [mm]"}
    table = covered.join(axes.rename(columns=heads)).reset_index()
    table["ellipsoids"] = table.pop("estimator") + ", " + table["ellipsoids"]
    return table
