"""Tables of the page: errors, coverage, errors over time and with drop-outs; and its 3-D view."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import pandas as pd
import torch

from edition1.estimation.rod_filter import RodFilter
from edition1_companion.pages.continuum_robot import judged
from edition1_companion.pages.continuum_robot.figures import robot_view
from edition1_companion.recordings.continuum_robot import LENGTH_M, STATIONS_M
from edition1_companion.twins import followed_rod
from edition1_companion.twins.followed_rod import Parts
from edition1_live.view.shape_view import ShapeView

SEEN = "slow_free_space"
"""The trial that settings are chosen on; it is not judged."""
_POINTS = 17
_BLOCKS = 5
"""Of two seconds each, in the window of ``SEEN``."""


def error_table(
    parts: Mapping[tuple[str, str, str], Parts],
    released: Mapping[tuple[str, str, str], Sequence[np.ndarray] | None],
) -> pd.DataFrame:
    """Root mean square error by trial, setting, estimator and station."""
    errors = {key: [error for error, _ in stations] for key, stations in parts.items()}
    errors |= {key: list(stations) for key, stations in released.items() if stations is not None}
    rows = [
        (trial, setting, estimator, 1e3 * arc, value)
        for (setting, trial, estimator), stations in errors.items()
        for arc, value in zip(STATIONS_M, judged.rmse_mm(stations), strict=True)
    ]
    columns = ["trial", "setting", "estimator", "station_mm", "rmse_mm"]
    return pd.DataFrame(rows, columns=columns).sort_values(columns[:2], kind="stable", ignore_index=True)


def coverage_table(parts: Mapping[tuple[str, str], Parts]) -> pd.DataFrame:
    """How many positions the 95 % ellipsoids hold, by trial and for all that are judged together."""
    rows = []
    for estimator in dict.fromkeys(name for _, name in parts):
        of_trial = {trial: stations for (trial, name), stations in parts.items() if name == estimator}
        numbers = {by: judged.widened(of_trial[SEEN], by, _BLOCKS) for by in judged.WIDER}
        wider = {(t, by): judged.coverage(s, by, x) for t, s in of_trial.items() for by, x in numbers.items()}
        alone = {t: judged.coverage(s, "factor", [1.0] * len(s)) for t, s in of_trial.items()}
        pooled = [t for t in of_trial if t != SEEN]
        for label, trials in [*((t, [t]) for t in of_trial), ("judged", pooled)]:
            if not trials:
                continue
            normalised, axes = (np.concatenate([wider[t, "factor"][i] for t in trials]) for i in (0, 1))
            added = np.concatenate([wider[t, "addition"][0] for t in trials])
            held = [
                judged.held_percent(x)
                for x in (normalised, np.concatenate([alone[t][0] for t in trials]), added)
            ]
            rows.append(
                (label, estimator, *held, float(np.exp(np.log(axes).mean())), float(normalised.mean() / 3))
            )
    names = ["coverage_percent", "alone_percent", "addition_percent", "semi_axis_mm", "normalised_error"]
    return pd.DataFrame(rows, columns=["trial", "estimator", *names])


def time_table(
    parts: Mapping[tuple[str, str], Parts], captures: Mapping[str, followed_rod.Capture]
) -> pd.DataFrame:
    """Error at the middle and the tip at every frame."""
    tables = []
    for (trial, estimator), stations in parts.items():
        for station in (1, 3):
            error = 1e3 * np.linalg.norm(stations[station][0], axis=-1)
            table = pd.DataFrame({"time_s": captures[trial].truth[station][0], "error_mm": error})
            tables.append(
                table.assign(trial=trial, estimator=estimator, station_mm=1e3 * STATIONS_M[station])
            )
    return pd.concat(tables)[["trial", "estimator", "station_mm", "time_s", "error_mm"]].reset_index(
        drop=True
    )


def dropout_table(
    captures: Mapping[str, followed_rod.Capture],
    dropped: Mapping[tuple[str, int], followed_rod.Estimates],
    means: pd.DataFrame,
) -> pd.DataFrame:
    """Mean error without the tracker at times, and its ratio to that with it."""
    whole = means[means["setting"] == "raw"].set_index(["trial", "estimator"])["rmse_mm"]
    rows = []
    for (trial, seed), estimates in dropped.items():
        for name, found in estimates.items():
            errors = [error for error, _ in followed_rod.errors(captures[trial], found)]
            value = float(np.mean(judged.rmse_mm(errors)))
            rows.append((trial, seed, name, value, value / float(whole.loc[trial, name])))
    return pd.DataFrame(rows, columns=["trial", "seed", "estimator", "rmse_mm", "ratio"])


def view(trial: str, capture: followed_rod.Capture, method: RodFilter, stations: Parts) -> ShapeView:
    """The filter's shape at the frames that show all bodies."""
    shared = capture.asked_s
    for time_s, _ in capture.truth:
        shared = np.intersect1d(shared, time_s)
    states, frames = followed_rod.filtered(method, capture)
    kept = [states[k] for k in frames if states[k].t in set(shared.tolist())]
    n = method.n_q
    q, P = torch.stack([s.q[:n] for s in kept]), torch.stack([s.covariance[:n, :n] for s in kept])
    arcs = tuple(np.linspace(0.0, LENGTH_M, _POINTS).tolist())
    points, spread = method.positions(q, P, arcs)
    deviation = torch.einsum("tkii->tk", spread).div(3).sqrt()
    bodies = np.stack([T[np.isin(time_s, shared)] for time_s, T in capture.truth], axis=1)
    error = np.mean(
        [
            1e3 * np.linalg.norm(part[np.isin(time_s, shared)], axis=-1)
            for (part, _), (time_s, _) in zip(stations, capture.truth, strict=True)
        ],
        axis=0,
    )
    return robot_view(trial, shared, (points.numpy(), deviation.numpy()), bodies, error)
