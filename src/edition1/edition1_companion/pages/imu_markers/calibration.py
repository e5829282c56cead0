"""Beyond Martin et al. (2022): IMUs calibrated against the motion capture of the first 60 s, judged on the rest.

Nothing was chosen by what is judged: noise, tolerances and solver are the defaults of
`edition1.estimation.imu_calibration`, every tenth sample of the first 60 s is used (about three a second), and the
points at 200, 480 and 640 mm are never seen by a fit. In the synthetic motion the first 60 s hold one mode,
oscillating. The delay between the clocks is found over the whole trial, as the paper does.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pandas as pd
from edition1.errors import require
from edition1.estimation.imu_calibration import calibrate_imus, calibrated
from edition1.estimation.imu_models import pcc_extended, tangent_spline
from tqdm import tqdm

from edition1_companion.book.bootstrap import ratio_interval, resampled
from edition1_companion.recordings.martin2022_models import MARKERS, selection
from edition1_companion.twins.arm_trial import ArmTrial, draw
from edition1_companion.twins.soft_arm import load_soft_arm

FIRST_S = 60.0
"""What a calibration may use [s]."""
EVERY = 10
DRAWS = 10
MODELS = {"PCC-16": pcc_extended, "spline": tangent_spline}
BASELINE = "PCC-16"
FRAME, FULL = " + frame", " + all"
"""Ends of the names of calibrated models: frame alone (6 parameters), with heading and mounting of each IMU (27)."""
TARGETS = {"PCC-16" + FRAME: 0.8, "spline" + FULL: 0.6}
"""Largest ratio to the baseline that was set as a target."""
MARKERS_MEAN = "markers"
"""Name of the mean over both markers in :func:`ratios`."""
BOOTSTRAPS = 2000


def calibration_errors(trial: ArmTrial, *, first_s: float = FIRST_S, every: int = EVERY) -> pd.DataFrame:
    """Errors after the first part of a trial: both models as they are, with the frame fitted, with all fitted.

    Parameters
    ----------
    trial
        Orientations and points; the first two points are the markers.
    first_s
        End of the part that a calibration may use; the rest is judged [s].
    every
        Every n-th sample of the first part is used.

    Returns
    -------
    DataFrame
        Columns ``method, mode, point_mm, median_mm, q75_mm``; ``mode`` is "all" or one of those in the rest.

    Raises
    ------
    InputError
        If the trial has no samples before or after ``first_s``.
    """
    used = np.flatnonzero(trial.time_s < trial.time_s[0] + first_s)[::every]
    rest = trial.time_s >= trial.time_s[0] + first_s
    require(used.size and rest.any(), "first_s", "calibration_errors", "within the trial, above 0 s", first_s)
    arm = selection("pcc", 8)
    q, markers = arm.of(trial.orientations), trial.points[:, : len(MARKERS)]
    mode, seen = trial.mode[rest], trial.points[rest]
    lines = []
    for name, model in MODELS.items():
        for per_imu in (None, False, True):
            if per_imu is None:
                method, turned, offset = name, q[rest], np.zeros(3)
            else:
                fit = calibrate_imus(q[used], markers[used], model, arm, per_imu=per_imu)
                method = name + (FULL if per_imu else FRAME)
                turned, offset = calibrated(q[rest], fit), fit.translation_m
            error = 1e3 * np.linalg.norm(model(turned, arm, trial.point_arcs_m) + offset - seen, axis=-1)
            for part in ("all", *dict.fromkeys(mode.tolist())):
                here = error if part == "all" else error[mode == part]
                for arc, values in zip(trial.point_arcs_m, here.T, strict=True):
                    lines.append((method, part, 1e3 * arc, *np.percentile(values, [50, 75])))
    return pd.DataFrame(lines, columns=["method", "mode", "point_mm", "median_mm", "q75_mm"])


def over_sensors(
    draws: Sequence[int], *, first_s: float, every: int, data: Path, progress: bool = False
) -> pd.DataFrame:
    """:func:`calibration_errors` of several draws of sensors and frames, with a column ``draw``.

    Parameters
    ----------
    draws
        Their seeds.
    first_s, every
        As for :func:`calibration_errors`.
    data
        Folder of the motion, ``soft_arm.npz``.
    progress
        Show a bar.
    """
    arm = load_soft_arm(data / "soft_arm.npz")
    tables = [
        calibration_errors(draw(arm, seed).trial, first_s=first_s, every=every).assign(draw=seed)
        for seed in tqdm(draws, desc="calibration", disable=not progress)
    ]
    return pd.concat(tables, ignore_index=True)


def ratio_to_uncalibrated(table: pd.DataFrame, *, seed: int = 0) -> pd.DataFrame:
    """Medians against those of the uncalibrated PCC-extended model, with paired bootstrap intervals over the draws.

    Parameters
    ----------
    table
        As from :func:`over_sensors`.
    seed
        Of the bootstrap.

    Returns
    -------
    DataFrame
        Columns ``method, mode, point`` ("200 mm" and so on; "markers": mean of the medians of both), ``median_mm``
        (mean over the draws), ``ratio`` of it to that of the baseline, with its 95 % interval ``ratio_low`` and
        ``ratio_high``, ``target`` (NaN where none was set) and ``draws``.
    """
    medians = table.pivot_table(index="draw", columns=["method", "mode", "point_mm"], values="median_mm")
    markers = [1e3 * arc for arc in MARKERS]
    points = {MARKERS_MEAN: markers} | {f"{x:g} mm": [x] for x in sorted(table["point_mm"].unique())}
    lines = []
    for method in dict.fromkeys(table["method"]):
        for mode in dict.fromkeys(table["mode"]):
            for name, arcs in points.items():
                ours, base = (
                    medians.loc[:, [(who, mode, x) for x in arcs]].mean(axis=1).to_numpy()
                    for who in (method, BASELINE)
                )
                index = resampled(len(ours), seed, bootstraps=BOOTSTRAPS)
                low, high = ratio_interval(ours, base, index)
                numbers = (ours.mean(), ours.mean() / base.mean(), low, high)
                lines.append((method, mode, name, *numbers, TARGETS.get(method, np.nan), len(ours)))
    columns = ["method", "mode", "point", "median_mm", "ratio", "ratio_low", "ratio_high", "target", "draws"]
    return pd.DataFrame(lines, columns=columns)
