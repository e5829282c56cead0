"""Errors of the estimators on the bend tests of Mitchell et al. 2021, against both readings of motion capture."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import pandas as pd
import torch

from edition1.errors import bad_input
from edition1.sensing.bend_sensor import BendSensor
from edition1_companion.twins.bend_filters import (
    LEAST_BEND_DEG,
    NONE,
    OUR_LENGTH_MM,
    calibrations,
    fit_readings,
    fit_takes,
    ours,
    paper_filters,
)
from edition1_companion.twins.bend_tests import BendTake, facts

SETTING = ["method", "calibration", "length_mm"]
BEND_BINS_DEG = (0.0, 20.0, 40.0, 180.0)
"""Bends by motion capture between which errors are also given [deg]."""
BY_BEND = ["rmse_below_20_deg", "rmse_20_to_40_deg", "rmse_above_40_deg"]
"""Columns of the errors between these bends."""
TARGET_DEG = 2.0
"""Largest median error of the bend angle for a calibration by the other try of the same test [deg]."""


@dataclass(frozen=True)
class Run:
    """Estimates of one method on one take.

    Attributes
    ----------
    method, calibration, length_mm
        What was run; the length is NaN where it is not known.
    take
        On what.
    estimates
        ``bend_rad, direction_rad, deviation_rad`` at each reading, deviations NaN where there are none.
    in_capture_frame
        Whether directions are azimuths of the motion capture.
    """

    method: str
    calibration: str
    length_mm: float
    take: BendTake
    estimates: pd.DataFrame
    in_capture_frame: bool = False


def run_all(
    takes: Sequence[BendTake],
    readings: pd.DataFrame,
    *,
    lengths_mm: Sequence[float] = (13.0, 14.0, 15.0),
    particles: int = 1000,
    seed: int = 0,
) -> list[Run]:
    """Run all methods on all takes; the paper's filter at lengths other than ours on first tries only.

    Parameters
    ----------
    takes
        Bend tests.
    readings
        Calibration readings; may be empty.
    lengths_mm
        Arc lengths of the models [mm], ours among them.
    particles, seed
        Of the paper's filter.

    Raises
    ------
    InputError
        If our arc length is not among the lengths.
    """
    if OUR_LENGTH_MM not in lengths_mm:
        raise bad_input("lengths_mm", "run_all", f"with {OUR_LENGTH_MM:g} among them", list(lengths_mm))
    runs = []
    for length in lengths_mm:
        sensor = BendSensor(1e-3 * length)
        for take in takes:
            runs.append(Run("ours", "none, not zeroed", length, take, ours(take, NONE, sensor, zeroed=False)))
            runs += [
                Run("ours", found.name, length, take, ours(take, found, sensor), found.in_capture_frame)
                for found in calibrations(take, takes, sensor, readings)
            ]
    filtered = [
        (take, length)
        for length in lengths_mm
        for take in takes
        if length == OUR_LENGTH_MM or take.attempt == 1
    ]
    tables = paper_filters(filtered, particles=particles, seed=seed)
    for (take, length), by_method in zip(filtered, tables, strict=True):
        runs += [Run(method, "none", length, take, table) for method, table in by_method.items()]
    runs += [
        Run("authors' output", "none", np.nan, take, take.logged.assign(deviation_rad=np.nan))
        for take in takes
        if take.logged is not None
    ]
    return runs


def errors_by_take(runs: Sequence[Run]) -> pd.DataFrame:
    """Errors by method, calibration, arc length and take, over the readings at which motion capture is not masked.

    Returns
    -------
    DataFrame
        Columns ``method, calibration, length_mm, take, rmse_deg`` (bend angle against the tilt of the y axis), the
        same over part of the readings, :data:`BY_BEND`, by the tilt of the y axis; ``rmse_tilt_z_deg`` (the same
        estimates against the tilt of the z axis), ``direction_deg`` (root mean
        square where the bend is at least `LEAST_BEND_DEG`; for directions that are not azimuths of the motion
        capture, after the mean offset of the takes of the other tests is subtracted), ``within_percent`` (readings
        within two reported deviations).
    """
    rows = []
    for run in runs:
        truth, found = run.take.truth, run.estimates
        bend = truth["bend_rad"]
        error = found["bend_rad"] - bend
        inside = (error.abs() <= 2.0 * found["deviation_rad"])[bend.notna()]
        same = [
            other for other in runs if _setting(other) == _setting(run) and other.take.test != run.take.test
        ]
        turned = _turned(run)
        if not run.in_capture_frame:
            turned = turned - _mean_angle(np.concatenate([_turned(other) for other in same] or [[]]))
        turned = np.angle(np.exp(1j * turned))
        rows.append(
            {
                "method": run.method,
                "calibration": run.calibration,
                "length_mm": run.length_mm,
                "take": run.take.name,
                "rmse_deg": _rms_deg(error),
                **{
                    name: _rms_deg(error[bend.between(*np.radians(edges), inclusive="left")])
                    for name, edges in zip(BY_BEND, pairwise(BEND_BINS_DEG), strict=True)
                },
                "rmse_tilt_z_deg": _rms_deg(found["bend_rad"] - truth["tilt_z_rad"]),
                "direction_deg": _rms_deg(pd.Series(turned)),
                "within_percent": 100.0 * inside.mean()
                if bool(found["deviation_rad"].notna().any())
                else np.nan,
            }
        )
    return pd.DataFrame(rows)


def evidence(takes: Sequence[BendTake], runs: Sequence[Run]) -> pd.DataFrame:
    """What speaks for either reading of motion capture: its peaks beside that of the sensor.

    Returns
    -------
    DataFrame
        Columns of :func:`edition1_companion.twins.bend_tests.facts`, and by ours without calibration
        ``peak_hall_deg``, the largest bend, and ``turned_deg``, the mean of its direction less the azimuth of the y
        axis.
    """
    rows = [
        (run.take.name, run.estimates["bend_rad"].quantile(0.999), _mean_angle(_turned(run)))
        for run in runs
        if (run.method, run.calibration, run.length_mm) == ("ours", "none", OUR_LENGTH_MM)
    ]
    table = pd.DataFrame(rows, columns=["take", "peak_hall_deg", "turned_deg"]).set_index("take")
    return facts(takes).merge(np.degrees(table), on="take")


def median_errors(table: pd.DataFrame) -> pd.DataFrame:
    """Medians of :func:`errors_by_take` over the takes, with the number of takes."""
    by = table.groupby(SETTING, sort=False, dropna=False)
    columns = ["rmse_deg", *BY_BEND, "rmse_tilt_z_deg", "direction_deg", "within_percent"]
    return by[columns].median().assign(takes=by["take"].nunique()).reset_index()


def estimates_over_time(runs: Sequence[Run], shown: Sequence[str], every: int = 4) -> pd.DataFrame:
    """Estimates and motion capture over time, at our arc length, for a figure.

    Parameters
    ----------
    runs
        All runs.
    shown
        Names of takes.
    every
        Every which reading.

    Returns
    -------
    DataFrame
        Columns ``take, method, calibration, time_s, bend_deg, direction_deg, deviation_deg``, with the methods
        ``capture, y axis`` and ``capture, z axis``. Directions are relative to their own mean where the bend is at
        least `LEAST_BEND_DEG`, and missing elsewhere.
    """
    parts = []
    for run in runs:
        if run.take.name in shown and (run.length_mm == OUR_LENGTH_MM or np.isnan(run.length_mm)):
            parts.append(_curve(run.take, run.method, run.calibration, run.estimates, every))
    for take in {run.take.name: run.take for run in runs if run.take.name in shown}.values():
        for name, column in (("capture, y axis", "bend_rad"), ("capture, z axis", "tilt_z_rad")):
            table = pd.DataFrame(
                {"bend_rad": take.truth[column], "direction_rad": take.truth["direction_rad"]}
            )
            parts.append(_curve(take, name, "none", table.assign(deviation_rad=np.nan), every))
    return pd.concat(parts, ignore_index=True)


def beside_log(runs: Sequence[Run]) -> pd.DataFrame:
    """Root mean square difference of the bend angle between the paper's filter and the authors' own output.

    Columns ``take, method, difference_deg``, for the takes of which that output exists; it may be empty.
    """
    rows = [
        (run.take.name, run.method, _rms_deg(run.estimates["bend_rad"] - run.take.logged["bend_rad"]))
        for run in runs
        if run.take.logged is not None and run.method.startswith("paper") and run.length_mm == OUR_LENGTH_MM
    ]
    return pd.DataFrame(rows, columns=["take", "method", "difference_deg"])


def factors(takes: Sequence[BendTake], readings: pd.DataFrame) -> pd.DataFrame:
    """Factors of the ratios against the model as drawn: ``fitted_to`` (a take, calibration readings), ``factor``."""
    sensor = BendSensor(1e-3 * OUR_LENGTH_MM)
    fitted = [fit_takes(take.name, [take], sensor) for take in takes]
    if len(readings):
        fitted.append(fit_readings(readings, sensor))
    rows = [(found.name, float(torch.linalg.vector_norm(found.matrix[0]))) for found in fitted]
    return pd.DataFrame(rows, columns=["fitted_to", "factor"])


def _setting(run: Run) -> tuple[str, str, str]:
    return run.method, run.calibration, str(run.length_mm)


def _turned(run: Run) -> np.ndarray:
    """Estimated less captured direction where the bend is large enough [rad]."""
    bent = (run.take.truth["bend_rad"] >= np.radians(LEAST_BEND_DEG)).to_numpy()
    turned = run.estimates["direction_rad"] - run.take.truth["direction_rad"]
    return turned[bent].dropna().to_numpy()


def _mean_angle(angles: np.ndarray) -> float:
    return float(np.angle(np.exp(1j * angles).mean())) if len(angles) else np.nan


def _rms_deg(error: pd.Series) -> float:
    return float(np.degrees(np.sqrt((error**2).mean())))


def _curve(take: BendTake, method: str, calibration: str, table: pd.DataFrame, every: int) -> pd.DataFrame:
    bent = (take.truth["bend_rad"] >= np.radians(LEAST_BEND_DEG)) & table["direction_rad"].notna()
    direction = table["direction_rad"].where(bent)
    relative = np.angle(np.exp(1j * (direction - _mean_angle(direction.dropna().to_numpy()))))
    curve = pd.DataFrame(
        {
            "take": take.name,
            "method": method,
            "calibration": calibration,
            "time_s": take.time_s,
            "bend_deg": np.degrees(table["bend_rad"]),
            "direction_deg": np.degrees(relative),
            "deviation_deg": np.degrees(table["deviation_rad"]),
        }
    )
    return curve.iloc[::every]
