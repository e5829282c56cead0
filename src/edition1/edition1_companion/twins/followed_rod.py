"""The rod filter on the recorded continuum robot: readings on one clock, estimates and errors at every frame."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from edition1.estimation.kalman_filter import KalmanState
from edition1.estimation.rod_filter import RodFilter
from edition1.estimation.rod_sensors import RodSensor
from edition1.estimation.smoothing import smoothed
from edition1.kinematics.strain_series import StrainSeries
from edition1_companion.recordings.continuum_robot import LENGTH_M, SENSORS, STATIONS_M, TRUTH, Trial, poses

WIDTHS = (6, 6, 3, 3)
"""Numbers in a reading of each of ``SENSORS``."""
TIP = slice(6, 12)
"""Columns of the tracker at the tip."""
Parts = Sequence[tuple[np.ndarray, np.ndarray]]
"""Errors ``[k, 3]`` [m] and covariances ``[k, 3, 3]`` at each station."""


def chosen_filter() -> RodFilter:
    """The filter of the page on this robot, with its defaults."""
    rod = StrainSeries(LENGTH_M, bending=3, torsion=1)
    white, lasting = (2e-3,) * 3 + (0.01,) * 3, (3e-3,) * 3 + (0.02,) * 3  # [m], [rad]
    tracker = {"std": white, "lasting_std": lasting, "lasting_time_s": 1.0}
    sensors = (
        RodSensor("pose", arc_m=0.0, **tracker),
        RodSensor("pose", arc_m=LENGTH_M, **tracker),
        RodSensor("gyroscope", (0.1,) * 3, arc_m=LENGTH_M / 2),  # [rad/s]
        RodSensor("gyroscope", (0.1,) * 3, arc_m=LENGTH_M),
    )
    std = tuple(2.0 / (k + 1) ** 2.0 for k in range(3))  # [rad/m]
    return RodFilter(rod, sensors, std + std + (0.3,), 7.0, base_std=(3e-3, 0.02), iterations=1)


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
