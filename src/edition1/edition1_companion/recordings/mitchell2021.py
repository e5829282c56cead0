"""The recordings of Mitchell et al. (2021): Hall sensor and motion capture, as tidy tables.

Axes are those of the bend state: x along the body, which is column 0 of the files (on the sensor's serial line it is
the last field); against the model, y is mirrored. The sensor, an MLX90363, sends components that depend on its own
gain (data sheet rev. 005, section 14.4.1), and the recordings show that gain switch: see `HallTake`.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd
from jaxtyping import Float

from edition1.errors import InputError, bad_input
from edition1_companion.recordings.alignment import Lag, find_lag
from edition1_companion.recordings.mitchell2021_capture import Capture, read_text
from edition1_companion.recordings.sources import data_dir

FOLDER = "mitchell2021"
MT_PER_UNIT = 10.0
"""The files' unit in mT: 1000 counts of 0.01 mT."""
LARGEST_UNIT = 8.192
"""End of the sensor's range in the files' unit: its components have 14 bits with sign."""
LIVE_S = 1e-3
"""Readings that follow each other faster came out of a buffer [s]; the sensor is read every 12 to 17 ms."""
GAIN_RATIO = 1.155
"""Ratio of the field's magnitude across a switch of gain: 1.154 to 1.156 at those of the recordings."""
LEAST_GAIN_STEP = 0.1
"""Logarithm of the ratio of consecutive magnitudes that counts as a switch; other steps stay below 0.05."""
LARGEST_DROPPED = 0.05
"""Share of the rows that may be unreadable, come out of a buffer, or be beyond the sensor's range."""
LONGEST_BUFFER = 25
"""Rows that a buffer may hold in any case; 14 to 23 in the recordings."""
REST_S = 2.0
FIELD = ["bx_mT", "by_mT", "bz_mT"]
_ROW = re.compile(r"\[([^\[\],]+)\],([^\[\],]+)")


@dataclass(frozen=True)
class Take:
    """One test and the files that exist of it; None where one is missing."""

    name: str
    hall: Path | None = None
    capture: Path | None = None
    filtered: Path | None = None


@dataclass(frozen=True)
class HallTake:
    """Readings of the Hall sensor, and what was dropped or masked.

    Attributes
    ----------
    name
        The file's name without its ending.
    start_unix_s
        Time of the first reading kept, seconds since 1970 UTC, by the clock of the computer that recorded.
    readings
        One row per reading: ``time_s`` after the first; ``bx_mT, by_mT, bz_mT``, as sent (x along the body), NaN
        where masked; ``gain``, the sensor's gain relative to the first reading, inferred. Where it switches, all
        three components jump by one factor between two readings, up when the axial field has fallen to 19 mT and
        down when it has risen to 25.6 mT. The field over ``gain`` is continuous; ratios of components need no
        correction.
    unreadable
        Rows that are no reading; dropped.
    drained
        Leading rows with false times, from the emptying of a buffer; dropped.
    masked
        Readings beyond the sensor's range.
    switches
        Switches of gain.
    """

    name: str
    start_unix_s: float
    readings: pd.DataFrame
    unreadable: int
    drained: int
    masked: int
    switches: int

    @property
    def longest_gap_s(self) -> float:
        """Longest time between readings [s]."""
        return float(self.readings["time_s"].diff().max())


def takes(folder: Path | None = None) -> list[Take]:
    """Return the tests of which a Hall file or a motion capture is found, in order of name.

    Parameters
    ----------
    folder
        The paper's folder; by default ``mitchell2021`` below `edition1_companion.recordings.sources.data_dir`.
    """
    folder = folder or data_dir() / FOLDER
    found: dict[str, dict[str, Path]] = {}
    for kind, pattern in (
        ("hall", "experiment_data/*_test_*.csv"),
        ("capture", "mocap/bend_*.csv"),
        ("filtered", "filter_readings/bend_*.csv"),
    ):
        for path in folder.glob(pattern):
            found.setdefault(path.stem.replace("_test_", "_"), {})[kind] = path
    return [Take(name, **files) for name, files in sorted(found.items())]


def files_found(folder: Path | None = None) -> list[Path]:
    """Return all files of the paper that are found, calibration readings among them; ``folder`` as for `takes`."""
    folder = folder or data_dir() / FOLDER
    found = [path for take in takes(folder) for path in (take.hall, take.capture, take.filtered) if path]
    return found + sorted(folder.glob("calibrate_data/*/*deg_*.csv"))


def read_hall(path: Path) -> HallTake:
    """Read a Hall file: rows ``[x y z],unix_time``.

    The recording starts with what a buffer held: rows that follow each other within `LIVE_S`, whose times are those
    of their emptying. All rows up to the first longer interval are dropped, so always the first, which may be junk.

    Raises
    ------
    FileNotFoundError
        If there is no such file.
    InputError
        A file that is no text, no reading left, times that do not increase, or more than `LARGEST_DROPPED` of the
        rows unreadable, out of a buffer or beyond the range.
    """
    rows = [_reading(line) for line in read_text(path).splitlines()]
    unreadable = rows.count(None)
    table = np.array([row for row in rows if row is not None]).reshape(-1, 4)
    intervals = np.diff(table[:, 3])
    if (intervals <= 0).any():
        row = int(np.argmax(intervals <= 0))
        raise bad_input("times", path.name, "increasing", f"a step of {intervals[row]:g} s to row {row + 1}")
    live = np.flatnonzero(intervals > LIVE_S)
    if live.size == 0:
        seen = f"{len(table)} readings and {unreadable} rows that are none"
        raise bad_input("rows", path.name, f"readings, two of them more than {LIVE_S:g} s apart", seen)
    drained = int(live[0]) + 1
    time_s, field = table[drained:, 3], table[drained:, :3]
    outside = np.any(np.abs(field) > LARGEST_UNIT, axis=1)
    total = len(table) + unreadable
    for what, count, allowed in (
        ("unreadable", unreadable, 0),
        ("out of a buffer", drained, LONGEST_BUFFER),
        ("beyond the sensor's range", int(outside.sum()), 0),
    ):
        if count > max(LARGEST_DROPPED * total, allowed):
            expected = f"at most {LARGEST_DROPPED:.0%} {what}"
            raise bad_input("rows", path.name, expected, f"{count} of {total}, {count / total:.1%}")
    field = np.where(outside[:, None], np.nan, field)
    gain, switches = _gain(field)
    readings = pd.DataFrame(
        {"time_s": time_s - time_s[0]} | dict(zip(FIELD, MT_PER_UNIT * field.T, strict=True))
    )
    readings["gain"] = gain
    return HallTake(path.stem, float(time_s[0]), readings, unreadable, drained, int(outside.sum()), switches)


def _reading(line: str) -> list[float] | None:
    match = _ROW.fullmatch(line.strip())
    try:
        row = [float(text) for text in (*match[1].split(), match[2])] if match else []
    except ValueError:
        return None
    return row if len(row) == 4 and np.isfinite(row).all() else None


def _gain(field: np.ndarray) -> tuple[np.ndarray, int]:
    """Return the gain relative to the first reading, and how often it switches."""
    magnitude = pd.Series(np.linalg.norm(field, axis=1)).ffill().bfill().to_numpy()
    steps = np.diff(np.log(np.maximum(magnitude, 1e-3)), prepend=np.log(max(magnitude[0], 1e-3)))
    switched = np.abs(steps) > LEAST_GAIN_STEP
    return GAIN_RATIO ** np.cumsum(np.sign(steps) * switched), int(switched.sum())


def bending_signal(hall: HallTake) -> Float[np.ndarray, " readings"]:
    """Return the change of the transverse over the axial field since the first two seconds, as one magnitude.

    It grows with the bend angle, needs no gain, and is NaN where a reading is masked.
    """
    table = hall.readings
    ratios = table[["by_mT", "bz_mT"]].to_numpy() / table[["bx_mT"]].to_numpy()
    rest = np.nanmedian(ratios[table["time_s"] < REST_S], axis=0)
    return np.linalg.norm(ratios - rest, axis=1)


def align(hall: HallTake, capture: Capture) -> tuple[pd.DataFrame, Lag]:
    """Bring a motion capture onto the clock of its Hall recording.

    There is no common trigger. Both files carry clock times that agree to about a second; the rest is the lag at
    which `bending_signal` and the captured bend correlate best. Each reading then takes the nearest frame.

    Returns
    -------
    table, lag
        The readings that have a frame within half a frame's time, with ``bend_rad``, ``direction_rad`` and
        ``tilt_z_rad`` of `edition1_companion.recordings.mitchell2021_capture.Capture.motion` (NaN where masked), and the
        lag: seconds to add to the clock times of the capture.

    Raises
    ------
    InputError
        If the two do not overlap by their clocks, or `edition1_companion.recordings.alignment.find_lag` finds no clear
        peak.
    """
    hall_s = hall.start_unix_s + hall.readings["time_s"].to_numpy()
    motion_s = capture.start_unix_s + capture.motion["time_s"].to_numpy()
    if hall_s[-1] <= motion_s[0] or motion_s[-1] <= hall_s[0]:
        seen = f"a capture from {motion_s[0] - hall_s[0]:.1f} to {motion_s[-1] - hall_s[0]:.1f} s"
        raise bad_input(
            "capture", hall.name, f"within the recording, 0 to {hall_s[-1] - hall_s[0]:.1f} s", seen
        )
    bend = capture.motion["bend_rad"].to_numpy()
    # Seconds since 1970 leave few digits; both clocks are counted from the recording's first reading.
    try:
        lag = find_lag(hall_s - hall_s[0], bending_signal(hall), motion_s - hall_s[0], bend)
    except InputError as error:
        raise InputError(f"{hall.name}: {error}") from error
    motion = capture.motion.assign(time_s=motion_s - hall_s[0] + lag.lag_s, frame=range(len(motion_s)))
    table = pd.merge_asof(
        hall.readings, motion, on="time_s", direction="nearest", tolerance=0.51 / capture.rate_hz
    )
    return table.dropna(subset="frame").drop(columns="frame").reset_index(drop=True), lag
