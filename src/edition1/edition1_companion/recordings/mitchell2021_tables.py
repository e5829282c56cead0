"""What lies beside the recordings of Mitchell et al. (2021): the authors' filter output, and calibration readings."""

from __future__ import annotations

import re
from io import StringIO
from pathlib import Path

import numpy as np
import pandas as pd
from jaxtyping import Float

from edition1.errors import bad_input, require
from edition1_companion.recordings.mitchell2021 import FIELD, FOLDER, MT_PER_UNIT
from edition1_companion.recordings.mitchell2021_capture import read_text
from edition1_companion.recordings.sources import data_dir

LARGEST_SPIKE = 1.0
"""Distance from the median of its file that makes a calibration reading a spike, in the files' unit."""
DIRECTIONS = {"0dir": 0.0, "pi2dir": np.pi / 2, "pidir": np.pi, "3pi2dir": 3 * np.pi / 2}
SAME_TIME_S = 1e-3
"""A row of the log and a reading are one when their times differ by less than this [s]."""
ANCHORS = 9
SAMPLED = 200
"""Rows of a log that are tried as the one of a given reading, and rows at which such a trial is judged."""


def read_filtered(path: Path) -> pd.DataFrame:
    """Read the authors' logged output: ``time_s``, ``direction_rad``, ``bend_rad``.

    Raises
    ------
    InputError
        A file that is no table, a column that is missing, cells that are no numbers, or times that do not increase.
    """
    text = read_text(path)
    try:
        table: pd.DataFrame = pd.read_csv(StringIO(text))
    except (pd.errors.ParserError, pd.errors.EmptyDataError) as error:
        raise bad_input("rows", path.name, "a table", error) from error
    names = {"time": "time_s", "bend_dir": "direction_rad", "bend_ang": "bend_rad"}
    if missing := [name for name in names if name not in table]:
        raise bad_input("columns", path.name, ", ".join(names), f"none of {missing}")
    table = table.rename(columns=names).loc[:, list(names.values())].apply(pd.to_numeric, errors="coerce")
    table = table.astype(float)
    bad = np.flatnonzero(~np.isfinite(table.to_numpy()).all(axis=1))
    if not len(table) or len(bad):
        seen = f"others in {len(bad)} rows, first in row {bad[0] + 1}" if len(bad) else "no row"
        raise bad_input("rows", path.name, "finite numbers", seen)
    if not (np.diff(table["time_s"]) > 0).all():
        row = int(np.argmin(np.diff(table["time_s"]) > 0)) + 2
        raise bad_input("times", path.name, "increasing", f"a step back to row {row}")
    return table


def on_readings(
    log: pd.DataFrame, time_s: Float[np.ndarray, " readings"], all_s: Float[np.ndarray, " all"]
) -> pd.DataFrame:
    """Bring the authors' output onto the clock of the readings, by its own times.

    The log has the time of every reading that it has processed, counted from its own first row. That row may be any
    reading, or none that is left; the log may end before the readings. So its clock is moved to where most of its
    times are times of readings.

    Parameters
    ----------
    log
        Table of :func:`read_filtered`.
    time_s
        Readings for which the output is wanted, increasing [s].
    all_s
        All readings of the file, increasing, on the same clock [s].

    Returns
    -------
    DataFrame
        ``direction_rad`` and ``bend_rad`` at each of ``time_s``; NaN where the log has no row within `SAME_TIME_S`.

    Examples
    --------
    >>> log = pd.DataFrame({"time_s": [0.0, 0.02, 0.03], "direction_rad": 0.0, "bend_rad": [0.1, 0.2, 0.3]})
    >>> readings_s = np.array([0.0, 0.015, 0.035, 0.045, 0.06])
    >>> on_readings(log, readings_s, readings_s)["bend_rad"].tolist()
    [nan, 0.1, 0.2, 0.3, nan]
    """
    own_s = log["time_s"].to_numpy()
    rows = np.unique(np.linspace(0, len(own_s) - 1, SAMPLED).round().astype(int))
    best = -1, 0.0
    for anchor in np.unique(np.linspace(0, len(own_s) - 1, ANCHORS).round().astype(int)):
        offsets = all_s - own_s[anchor]
        at = own_s[rows] + offsets[:, None]
        right = (
            np.searchsorted(all_s, at).clip(1, len(all_s) - 1) if len(all_s) > 1 else np.zeros(at.shape, int)
        )
        nearest = np.minimum(np.abs(all_s[right] - at), np.abs(all_s[right - 1] - at))
        matched = (nearest < SAME_TIME_S).sum(axis=1)
        k = int(np.argmax(matched))
        best = max(best, (int(matched[k]), float(offsets[k])))
    clock = log.assign(time_s=own_s + best[1])
    wanted = pd.DataFrame({"time_s": time_s})
    found = pd.merge_asof(wanted, clock, on="time_s", direction="nearest", tolerance=SAME_TIME_S)
    return pd.DataFrame({name: found[name] for name in ("direction_rad", "bend_rad")})


def read_calibration(folder: Path | None = None) -> pd.DataFrame:
    """Read the calibration readings, taken at known bends held still.

    Parameters
    ----------
    folder
        As for `takes`; the files are ``calibrate_data/<direction>/<angle>deg_<repeat>.csv``.

    Returns
    -------
    pandas.DataFrame
        One row per reading: ``direction_rad`` and ``bend_rad``, nominal, ``repeat``, and ``bx_mT, by_mT, bz_mT``. A
        reading that is more than 10 mT off the median of its file in any component is a spike: NaN. The gain of each
        file is unknown.

    Raises
    ------
    InputError
        If a file holds anything but rows of three numbers.
    """
    parts = []
    for path in sorted((folder or data_dir() / FOLDER).glob("calibrate_data/*/*deg_*.csv")):
        match = re.fullmatch(r"(\d+)deg_(\d+)", path.stem)
        if path.parent.name not in DIRECTIONS or not match:
            raise bad_input(
                "file", "calibrate_data", "DIRECTION/ANGLEdeg_REPEAT.csv", f"{path.parent.name}/{path.name}"
            )
        raw = _three_numbers(path)
        spike = np.any(np.abs(raw - np.median(raw, axis=0)) > LARGEST_SPIKE, axis=1)
        field = MT_PER_UNIT * np.where(spike[:, None], np.nan, raw)
        pose = {
            "direction_rad": DIRECTIONS[path.parent.name],
            "bend_rad": np.radians(float(match[1])),
            "repeat": int(match[2]),
        }
        parts.append(pd.DataFrame(field, columns=FIELD).assign(**pose)[[*pose, *FIELD]])
    columns = ["direction_rad", "bend_rad", "repeat", *FIELD]
    return pd.concat(parts, ignore_index=True) if parts else pd.DataFrame(columns=columns)


def _three_numbers(path: Path) -> np.ndarray:
    """Return the rows of a file that holds nothing but rows of three numbers."""
    owner, rows = f"{path.parent.name}/{path.name}", []
    for k, line in enumerate(read_text(path).splitlines(), start=1):
        try:
            row = [float(text) for text in line.split(",")]
        except ValueError:
            row = []
        if len(row) != 3 or not np.isfinite(row).all():
            raise bad_input("rows", owner, "three numbers each", f"{line!r} in line {k}")
        rows.append(row)
    require(rows, "rows", owner, "three numbers each", "no row")
    return np.array(rows)
