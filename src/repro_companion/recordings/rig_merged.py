"""The authors' merged files of T0 to T5: configurations, relations and readings, one row per sensor and frame."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd

from repro.errors import bad_input
from repro.sensing.rig import RIG_SENSORS
from repro_companion.recordings.baaij2023 import Recording, data_folder, split

CONFIGURATION = ["q_dx_0", "q_dy_0", "q_dL_0"]
RELATIONS = ["lambda", "d_0", "alpha_0", "beta_0", "theta_0"]
MERGED = ["time_idx", "sensor_id", *CONFIGURATION, *RELATIONS, "u"]
"""Columns of the merged files; distances in m, angles in rad, readings in mV, one row per sensor and frame."""


def merged_table(recording: Recording) -> pd.DataFrame:
    """Recording in the schema of the authors' merged files, :data:`MERGED`."""
    n, xi = len(recording), recording.relations()
    values = {
        "time_idx": np.repeat(recording.frame, RIG_SENSORS),
        "sensor_id": np.tile(range(RIG_SENSORS), n),
    }
    values |= dict(zip(CONFIGURATION, np.repeat(recording.q, RIG_SENSORS, axis=0).T, strict=True))
    values |= dict(zip(RELATIONS, xi.reshape(-1, len(RELATIONS)).T, strict=True))
    return pd.DataFrame(values | {"u": recording.u.ravel()})


def write_merged(recording: Recording, folder: Path, *, test_share: float = 0.3) -> None:
    """Write the merged file of a recording and those of its two parts, in the authors' schema and places."""
    merged = data_folder(folder) / "merged_data"
    merged.mkdir(parents=True, exist_ok=True)
    train, test = split(recording, test_share)
    for part, ending in ((recording, ""), (train, "_train"), (test, "_test")):
        merged_table(part).to_csv(merged / f"{recording.name}{ending}.csv", index=False, lineterminator="\n")


def read_merged(name: str, folder: Path | None = None) -> Recording:
    """Read a merged file, the authors' or one of :func:`write_merged`.

    Parameters
    ----------
    name
        Name of the recording, with ``_train`` or ``_test`` for a part.
    folder
        The paper's folder; by default ``baaij2023`` below `repro_companion.recordings.sources.data_dir`.

    Raises
    ------
    FileNotFoundError
        If there is no such file.
    InputError
        A missing column, rows that are not three sensors of one frame each, or numbers that are missing.
    """
    path = data_folder(folder) / "merged_data" / f"{name}.csv"
    table = pd.read_csv(path)
    if missing := [column for column in MERGED if column not in table.columns]:
        raise bad_input("columns", path.name, ", ".join(MERGED), f"none named {', '.join(missing)}")
    sensors = table["sensor_id"].to_numpy()
    n = len(table) // RIG_SENSORS
    if n == 0 or not np.array_equal(sensors, np.tile(range(RIG_SENSORS), n)):
        raise bad_input("sensor_id", path.name, "0, 1, 2 in every frame", sensors[:4].tolist())
    try:
        values = table[[*CONFIGURATION, "u"]].to_numpy(dtype=float)
    except ValueError as error:
        raise bad_input("rows", path.name, "numbers", error) from error
    if not np.isfinite(values).all():
        rows = int((~np.isfinite(values)).any(axis=1).sum())
        raise bad_input("rows", path.name, "complete", f"{rows} with a missing number")
    frame = table["time_idx"].to_numpy()[::RIG_SENSORS]
    if (np.diff(frame) <= 0).any():
        row = int(np.argmax(np.diff(frame) <= 0))
        raise bad_input("time_idx", path.name, "increasing", f"{frame[row]} before {frame[row + 1]}")
    return Recording(name, frame, values[::RIG_SENSORS, :3], values[:, 3].reshape(n, RIG_SENSORS))
