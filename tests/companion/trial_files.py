"""Files of a synthetic trial in the form in which Martin et al. released theirs, with a motion capture of our own."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
from scipy.spatial.transform import Rotation

from repro_companion.papers import martin_capture, martin_files
from repro_companion.papers.martin import Trial

START = pd.Timestamp("2022-02-23 15:44:33.431827")
BASE_MM = np.array([12.0, -34.0, 900.0])


def turned_about(axis: list[float], *angles: float) -> np.ndarray:
    """Return the quaternions of turns about an axis."""
    return Rotation.from_rotvec(np.outer(angles, axis)).as_quat()


def times_of(since_s: np.ndarray) -> list[str]:
    """Return times as the files have them."""
    return [f"{START + pd.Timedelta(t, 's'):%Y/%m/%d/%H:%M:%S.%f}" for t in since_s]


def clock_of(rows: int) -> np.ndarray:
    """Return the uneven times of rows, 34 a second [s]."""
    return np.cumsum(np.random.default_rng(0).uniform(0.022, 0.036, rows))


def write_tables(trial: Trial, leave_out: tuple[str, ...] = ()) -> None:
    """Write the tables of the models, the first point of each row 0 as the authors have it."""
    for name, points in martin_files.synthetic_tables(trial).items():
        if name in leave_out:
            continue
        given = np.isfinite(points).all(axis=-1)
        columns = {"time": times_of(clock_of(len(points))), ".header.frame_id": ""}
        for k in range(8):
            columns[f".ID_{k}"] = np.where(given[:, k], k, 0)
            columns |= {f".{x}{k}": np.nan_to_num(points[:, k, j]) for j, x in enumerate("xyz")}
        path = martin_files.place_of(name)
        path.parent.mkdir(parents=True, exist_ok=True)
        pd.DataFrame(columns).to_csv(path, index=False, float_format="%.9g")


def write_capture(points_mm: np.ndarray) -> Path:
    """Write M1 and M2 ``[rows, 2, 3]`` [mm] from the base, in the axes of the models, as the cameras saw them."""
    seen = np.stack([points_mm[..., 1], -points_mm[..., 0], points_mm[..., 2] + 17.0], axis=-1) + BASE_MM
    table = pd.DataFrame(0.0, index=range(len(seen)), columns=["", " ", *martin_capture.HEADER])
    table[""], table[" "] = np.arange(1, len(seen) + 1), 0
    table[["xbase", "ybase", "zbase"]] = BASE_MM
    for k, body in enumerate("47"):
        table[[f"{x}{body}" for x in "xyz"]] = seen[:, k]
    path = martin_files.place_of(martin_files.CAPTURE)
    path.parent.mkdir(parents=True, exist_ok=True)
    table.rename(columns={" ": ""}).to_csv(path, index=False, float_format="%.6f")
    return path


def as_recorded(rows_mm: np.ndarray, clock_s: np.ndarray) -> np.ndarray:
    """Return a motion capture of 100 Hz that has given points at the times of rows, and lines in between."""
    steps = np.rint(100 * clock_s).astype(int)
    flat = [np.interp(np.arange(steps[-1] + 50), steps, x) for x in rows_mm.reshape(len(steps), -1).T]
    return np.stack(flat, axis=-1).reshape(-1, 2, 3)
