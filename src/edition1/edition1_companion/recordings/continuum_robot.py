"""Recordings of a tendon-driven continuum robot with motion capture (space_time_continuum, MIT licence).

A trial is a folder with one file a sensor. Line 1 of a file names the sensor's kind, line 2 the columns, then one row
a reading: time [s], arc length [m], data. A gyroscope's data are its angular velocity in its own frame [rad/s]. Those
of a pose are its logarithm in se(3), translation part first: with ``rho, phi`` the rotation is ``exp(phi)`` and the
position ``V(phi) rho``, where V is the left Jacobian of SO(3). The base is at the origin, z along the straight robot.

Two recordings are part of the project, in ``data/recordings/continuum_robot``; others are looked for where
``repro fetch continuum_robot`` puts them. The files ``vicon0.csv`` to ``vicon4.csv`` are the truth and no input of an
estimator.
"""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float

from edition1.errors import bad_input, require
from edition1.se3 import exponential
from edition1_companion.recordings.sources import data_dir

KINDS = {"aurora": 6, "vicon": 6, "gyro": 3}
"""Numbers in a reading of each kind of sensor."""
SENSORS = ("aurora0", "aurora1", "gyro_mid", "gyro_ee")
TRUTH = ("vicon0", "vicon1", "vicon2", "vicon3", "vicon4")
LENGTH_M = 0.466
"""Of the robot."""
STATIONS_M = (0.1165, 0.233, 0.3495, 0.466)
"""Places whose positions are judged: the quarters of the arc."""
WINDOWS_S = {
    "slow_free_space": (19.0, 29.0),
    "impulse_1": (20.0, 30.0),
    "fast_contact": (10.0, 20.0),
    "impulse_2": (8.0, 18.0),
    "out_of_bounds": (15.0, 25.0),
}
"""Part of each released trial that the authors' program estimates and scores."""
ONE_RECORDING = {"impulse_1": "fast_contact"}
"""Trials whose files are the same, byte for byte: two windows of one recording."""
FETCHED = Path("continuum_robot/assets/data")


@dataclass(frozen=True)
class Readings:
    """What one sensor gave."""

    kind: str
    """One of :data:`KINDS`."""
    arc_m: float
    """Where it sits along the robot."""
    time_s: Float[np.ndarray, " n"]
    data: Float[np.ndarray, "n d"]


@dataclass(frozen=True)
class Trial:
    """A recording, or the part of one that is scored."""

    name: str
    folder: Path
    window_s: tuple[float, float] | None
    """Part that is scored; the whole recording where None."""

    def readings(self, sensor: str) -> Readings:
        """Return the readings of a sensor within the window.

        Raises
        ------
        InputError
            As :func:`read_readings`.
        """
        found = read_readings(self.folder / f"{sensor}.csv")
        if self.window_s is None:
            return found
        inside = (found.time_s >= self.window_s[0]) & (found.time_s <= self.window_s[1])
        return Readings(found.kind, found.arc_m, found.time_s[inside], found.data[inside])


def find_trials(committed: Path) -> list[Trial]:
    """Return the trials below a folder and below the fetched recordings, each content once.

    A trial that the authors released is scored in its window, and a second one in the same recording is found with
    it; any other folder is a trial that is scored whole.

    Parameters
    ----------
    committed
        ``data/recordings/continuum_robot``.
    """
    folders = [path for root in (committed, data_dir() / FETCHED) for path in sorted(root.glob("*/"))]
    contents: dict[str, Path] = {}
    for folder in folders:
        if (folder / f"{SENSORS[0]}.csv").is_file():
            contents.setdefault(_content(folder), folder)
    trials = []
    for folder in contents.values():
        names = [folder.name]
        for first, second in ONE_RECORDING.items():
            if folder.name in (first, second):
                names = [first, second]
        trials += [Trial(name, folder, WINDOWS_S.get(name)) for name in names]
    return trials


def _content(folder: Path) -> str:
    digest = hashlib.sha256()
    for name in (*SENSORS, *TRUTH):
        path = folder / f"{name}.csv"
        digest.update(path.read_bytes() if path.is_file() else b"")
    return digest.hexdigest()


def read_readings(path: Path) -> Readings:
    """Read the file of one sensor.

    Parameters
    ----------
    path
        A CSV file as in the description of this module.

    Raises
    ------
    InputError
        If the file does not exist, names another kind of sensor, or a row has too few or too many numbers, one that
        is not finite, another arc length than the first, or a time that is not after the row before.
    """
    require(path.is_file(), "recording", "the continuum robot", "an existing file", path)
    head, *lines = path.read_text(encoding="utf-8", errors="replace").splitlines() or [""]
    kind = head.removeprefix("sensor type:,").strip()
    if kind not in KINDS or not head.startswith("sensor type:,"):
        expected = "sensor type:, and one of " + ", ".join(KINDS)
        raise bad_input(f"line 1 of {path.name}", "the continuum robot", expected, repr(head))
    rows = [
        _numbers(line, KINDS[kind] + 2, f"line {n} of {path.name}") for n, line in enumerate(lines[1:], 3)
    ]
    require(rows, path.name, "the continuum robot", "at least one reading behind two lines", len(lines))
    table = np.array(rows)
    late, apart = np.diff(table[:, 0]) <= 0, table[1:, 1] != table[0, 1]
    for wrong, expected, column in ((late, "a later time than before", 0), (apart, f"at {rows[0][1]} m", 1)):
        if wrong.any():
            n = int(wrong.argmax()) + 1
            raise bad_input(f"line {n + 3} of {path.name}", "the continuum robot", expected, rows[n][column])
    return Readings(kind, rows[0][1], table[:, 0], table[:, 2:])


def _numbers(line: str, count: int, place: str) -> list[float]:
    refusal = bad_input(
        place, "the continuum robot", f"{count} finite numbers with commas between", repr(line)
    )
    try:
        numbers = [float(text) for text in line.split(",")]
    except ValueError:
        raise refusal from None
    if len(numbers) != count or not np.isfinite(numbers).all():
        raise refusal
    return numbers


def poses(readings: Readings) -> Float[np.ndarray, "n 4 4"]:
    """Poses of a tracker or of the motion capture, from their logarithms."""
    return exponential(torch.as_tensor(readings.data)).numpy()
