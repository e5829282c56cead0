"""What is judged of the estimates at the frames of the motion capture, beside the released program."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import torch
from jaxtyping import Float
from scipy.optimize import brentq, least_squares
from scipy.stats import chi2

from edition1 import se3
from edition1.estimation.rod_filter import RodFilter
from edition1_companion.recordings.continuum_robot import LENGTH_M, STATIONS_M, Trial, poses
from edition1_companion.twins.followed_rod import TIP, Capture, Parts, at_frames, errors, filtered

RELEASED = {"released filter": "filter", "released window": "window", "released batch": "batch"}
"""Estimators of the released program, and the ends of the names of their files."""
_AT_95 = float(chi2(3).ppf(0.95))


def without_tracker(capture: Capture, seed: int, *, run_s: float, share: float) -> Capture:
    """Leave out the tracker at the tip in runs of a length [s], for a share of the time, drawn by a seed."""
    run = ((capture.time_s - capture.time_s[0]) / run_s).astype(int)
    count = run[-1] + 1
    gone = np.random.default_rng(seed).permutation(count)[: round(share * count)]
    u = capture.u.clone()
    u[torch.from_numpy(np.isin(run, gone)), TIP] = torch.nan
    some = ~torch.isnan(u).all(-1)
    return replace(capture, time_s=capture.time_s[some.numpy()], u=u[some])


def rmse_mm(parts: Sequence[np.ndarray]) -> list[float]:
    """Root mean square distance at each station [mm]."""
    return [1e3 * float(np.sqrt((part**2).sum(-1).mean())) for part in parts]


def released(capture: Capture, folder: Path, ending: str, constants: np.ndarray) -> list[np.ndarray] | None:
    """Errors of the released program's estimates at each station, moved by the constants; none without a file."""
    path = folder / f"{capture.name}_{ending}.csv"
    if not path.is_file():
        return None
    table = pd.read_csv(path).to_numpy()
    out = []
    for arc, (time_s, T) in zip(STATIONS_M, capture.truth, strict=True):
        rows = table[np.abs(table[:, 1] - arc) < 1e-3]
        near = np.abs(time_s[:, None] - rows[:, 0]).argmin(1)
        kept = np.abs(time_s - rows[near, 0]) < 1e-3
        moved = with_constants(constants, exponential(rows[near, 2:8]), arc / LENGTH_M)
        out.append((moved[:, :3, 3] - T[:, :3, 3])[kept])
    return out


def exponential(twists: Float[np.ndarray, "*n 6"]) -> Float[np.ndarray, "*n 4 4"]:
    """Rigid motions of twists."""
    return se3.exponential(torch.from_numpy(np.ascontiguousarray(twists))).numpy()


def with_constants(
    constants: Float[np.ndarray, " 18"], T: Float[np.ndarray, "*n 4 4"], share: float
) -> Float[np.ndarray, "*n 4 4"]:
    """Poses in the frame of the motion capture, moved from a sensor's body to that of the motion capture.

    The constants are the twists of the tracker's frame, of the body at the base and of that at the tip; between them
    the twist of the body goes with the share of the length.
    """
    frame, base, tip = constants.reshape(3, 6)
    return exponential(frame) @ T @ exponential((1 - share) * base + share * tip)


def fitted_constants(trial: Trial, *, rotation_m: float, apart_s: float = 0.011) -> Float[np.ndarray, " 18"]:
    """Constants that bring the trackers onto the motion capture in all of a recording, by least squares.

    Parameters
    ----------
    trial
        Its recording is used whole.
    rotation_m
        An error of one radian counts as much as one of this length [m].
    apart_s
        A reading and a frame within this time belong together [s].
    """
    whole = Trial(trial.name, trial.folder, None)
    pairs = []
    for share, (tracker, body) in enumerate((("aurora0", "vicon0"), ("aurora1", "vicon4"))):
        read, seen = whole.readings(tracker), whole.readings(body)
        near = np.abs(seen.time_s[:, None] - read.time_s).argmin(1)
        kept = np.abs(seen.time_s - read.time_s[near]) < apart_s
        pairs.append((float(share), poses(read)[near[kept]], poses(seen)[kept]))

    def residuals(constants: np.ndarray) -> np.ndarray:
        parts = [1e-3 * constants]  # what the trackers cannot tell apart stays near nothing
        for share, T, truth in pairs:
            moved = with_constants(constants, T, share)
            turned = se3.logarithm(torch.from_numpy(np.linalg.inv(moved) @ truth)).numpy()[:, 3:]
            parts += [(moved[:, :3, 3] - truth[:, :3, 3]).ravel(), rotation_m * turned.ravel()]
        return np.concatenate(parts)

    return least_squares(residuals, np.zeros(18)).x


def calibrated(capture: Capture, constants: Float[np.ndarray, " 18"]) -> Capture:
    """The same readings, with the trackers moved by the constants."""
    u = capture.u.clone()
    for share, columns in ((0.0, slice(0, 6)), (1.0, TIP)):
        read = ~torch.isnan(u[:, columns]).any(-1)
        moved = with_constants(constants, exponential(u[read][:, columns].numpy()), share)
        u[read, columns] = se3.logarithm(torch.from_numpy(moved))
    return replace(capture, u=u)


WIDER: dict[str, tuple[Callable[[np.ndarray, float], np.ndarray], float]] = {
    "factor": (lambda C, x: x * C, 1.0),
    "addition": (lambda C, x: C + x * np.eye(3), 0.0),
}
"""How a covariance is made larger by one number, and the number that leaves it as it is."""


def widened(parts: Parts, by: str, blocks: int) -> list[float]:
    """The smallest number at each station with which 95 % ellipsoids hold 95 % of these positions.

    In every one of some blocks of time: errors last, so that a whole trial is a few samples only.

    Parameters
    ----------
    parts
        Errors and covariances at each station.
    by
        ``factor`` of the covariance, or ``addition`` to it [m^2], the same in all directions.
    blocks
        Number of blocks.
    """
    larger, least = WIDER[by]
    out = []
    for error, spread in parts:
        of_block = list(zip(np.array_split(error, blocks), np.array_split(spread, blocks), strict=True))

        def missing(x: float, of_block: Parts = of_block) -> float:
            quantiles = [np.quantile(_squared(e, larger(C, x)), 0.95) for e, C in of_block]
            return float(max(quantiles)) - _AT_95

        out.append(brentq(missing, least, 1e3 if by == "factor" else 1.0) if missing(least) > 0 else least)
    return out


def _squared(error: np.ndarray, C: np.ndarray) -> np.ndarray:
    """Normalised errors, squared."""
    return np.einsum("ni,ni->n", error, np.linalg.solve(C, error[..., None])[..., 0])


def coverage(parts: Parts, by: str, numbers: Sequence[float]) -> tuple[np.ndarray, np.ndarray]:
    """Squared normalised errors of all stations and frames, and semi-axes of the 95 % ellipsoids [mm].

    The semi-axis is the geometric mean of the three.
    """
    larger = [(error, WIDER[by][0](spread, x)) for (error, spread), x in zip(parts, numbers, strict=True)]
    axes = [1e3 * np.sqrt(_AT_95) * np.linalg.det(C) ** (1 / 6) for _, C in larger]
    return np.concatenate([_squared(*part) for part in larger]), np.concatenate(axes)


def held_percent(normalised: Float[np.ndarray, " k"]) -> float:
    """Share within the 95 % ellipsoids [%]."""
    return 100 * float((normalised < _AT_95).mean())


def by_setting(
    make: Callable[..., RodFilter],
    captures: Mapping[str, Capture],
    settings: Mapping[str, Mapping[str, float]],
) -> pd.DataFrame:
    """Mean error of the filter over the stations by trial, with one setting changed at a time."""
    rows = []
    for label, changed in settings.items():
        method = make(**changed)
        for trial, capture in captures.items():
            found = errors(capture, at_frames(method, *filtered(method, capture)))
            rows.append((label, trial, float(np.mean(rmse_mm([error for error, _ in found])))))
    return pd.DataFrame(rows, columns=["changed", "trial", "rmse_mm"])
