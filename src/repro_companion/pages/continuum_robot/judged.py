"""Readings on one clock, the motion capture at its own time stamps, and what is judged of estimates there."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pandas as pd
import torch
from jaxtyping import Float
from scipy.optimize import brentq, least_squares
from scipy.stats import chi2
from torch import Tensor

from repro import se3
from repro.estimation.kalman_filter import KalmanState
from repro.estimation.rod_filter import RodFilter
from repro.estimation.smoothing import smoothed
from repro_companion.recordings.continuum_robot import LENGTH_M, SENSORS, STATIONS_M, TRUTH, Trial, poses

WIDTHS = (6, 6, 3, 3)
"""Numbers in a reading of each of ``SENSORS``."""
TIP = slice(6, 12)
"""Columns of the tracker at the tip."""
RELEASED = {"released filter": "filter", "released window": "window", "released batch": "batch"}
"""Estimators of the released program, and the ends of the names of their files."""
Parts = Sequence[tuple[np.ndarray, np.ndarray]]
"""Errors ``[k, 3]`` [m] and covariances ``[k, 3, 3]`` at each station."""
_AT_95 = float(chi2(3).ppf(0.95))


@dataclass(frozen=True)
class Capture:
    """What was read in a trial, and what the motion capture saw."""

    name: str
    time_s: Float[np.ndarray, " n"]
    """Of the readings, all sensors together."""
    u: Float[Tensor, "n 18"]
    """Readings, NaN where a sensor was not read."""
    truth: tuple[tuple[np.ndarray, np.ndarray], ...]
    """Times ``[k]`` and poses ``[k, 4, 4]`` of the bodies at the four stations, each at its own stamps."""

    @property
    def asked_s(self) -> Float[np.ndarray, " m"]:
        """Times at which the motion capture saw any body."""
        return np.unique(np.concatenate([time_s for time_s, _ in self.truth]))


def load(trial: Trial) -> Capture:
    """Read a trial in its window."""
    times, rows = [], []
    for k, name in enumerate(SENSORS):
        readings = trial.readings(name)
        first = sum(WIDTHS[:k])
        row = np.full((len(readings.time_s), sum(WIDTHS)), np.nan)
        row[:, first : first + WIDTHS[k]] = readings.data
        times.append(readings.time_s)
        rows.append(row)
    time_s, place = np.unique(np.concatenate(times), return_inverse=True)
    u = np.full((len(time_s), sum(WIDTHS)), np.nan)
    for k, row in zip(place, np.concatenate(rows), strict=True):
        u[k] = np.where(np.isnan(row), u[k], row)
    bodies = [trial.readings(name) for name in TRUTH[1:]]
    return Capture(trial.name, time_s, torch.from_numpy(u), tuple((b.time_s, poses(b)) for b in bodies))


def without_tracker(capture: Capture, seed: int, *, run_s: float, share: float) -> Capture:
    """Leave out the tracker at the tip in runs of a length [s], for a share of the time, drawn by a seed."""
    run = ((capture.time_s - capture.time_s[0]) / run_s).astype(int)
    count = run[-1] + 1
    gone = np.random.default_rng(seed).permutation(count)[: round(share * count)]
    u = capture.u.clone()
    u[torch.from_numpy(np.isin(run, gone)), TIP] = torch.nan
    some = ~torch.isnan(u).all(-1)
    return replace(capture, time_s=capture.time_s[some.numpy()], u=u[some])


def filtered(method: RodFilter, capture: Capture) -> tuple[list[KalmanState], list[int]]:
    """States at all readings and all frames of the motion capture in their order, and which are at the latter.

    A state at a frame is the prediction from the readings until then. Before the first it is the prior.
    """
    state = method.init(torch.zeros(method.n_q, dtype=torch.float64))
    events = [(t, 0, k) for k, t in enumerate(capture.time_s.tolist())]
    events += [(t, 1, 0) for t in capture.asked_s.tolist()]
    states, frames = [], []
    for t, asked, k in sorted(events):
        if asked:
            state = method.predicted(state, t)
            frames.append(len(states))
        else:
            state, _ = method.step(state, capture.u[k], t)
        states.append(state)
    return states, frames


Estimates = dict[str, tuple[Float[np.ndarray, "m 4 3"], Float[np.ndarray, "m 4 3 3"]]]
"""Positions [m] of the four stations at all frames, and their covariances, by estimator."""


def at_frames(
    method: RodFilter, states: Sequence[KalmanState], frames: Sequence[int]
) -> tuple[np.ndarray, np.ndarray]:
    """Positions [m] of the stations and their covariances in some of the states."""
    q, P = (torch.stack([getattr(states[k], part) for k in frames]) for part in ("q", "covariance"))
    n = method.n_q
    at, spread = method.positions(q[:, :n], P[:, :n, :n], STATIONS_M)
    return at.numpy(), spread.numpy()


def estimates(method: RodFilter, capture: Capture) -> Estimates:
    """Filter and smoother at the frames of the motion capture."""
    states, frames = filtered(method, capture)
    back = smoothed(method, states)
    return {"filter": at_frames(method, states, frames), "smoother": at_frames(method, back, frames)}


def errors(capture: Capture, found: tuple[np.ndarray, np.ndarray]) -> list[tuple[np.ndarray, np.ndarray]]:
    """Errors ``[k, 3]`` [m] and covariances ``[k, 3, 3]`` at each station, at its own time stamps."""
    asked, (at, spread) = capture.asked_s, found
    out = []
    for station, (time_s, T) in enumerate(capture.truth):
        rows = np.searchsorted(asked, time_s)
        out.append((at[rows, station] - T[:, :3, 3], spread[rows, station]))
    return out


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
