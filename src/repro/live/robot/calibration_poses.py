"""Readings in known poses: cut out of a recording, or taken one after the other by a person at the robot."""

# pyright: reportArgumentType=false, reportCallIssue=false, reportAttributeAccessIssue=false

from __future__ import annotations

import math
import threading
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pandas as pd
import torch
from jaxtyping import Float
from torch import Tensor

from repro.errors import bad_input
from repro.live.record.recording import Recording
from repro.live.robot.robot_file import RobotFile
from repro.live.robot.robot_parts import MAGNETIC_STREAM
from repro.live.wire.csv_text import check_units
from repro.live.wire.frame import Frame

WINDOW_S = 0.5
"""Readings are averaged over this time [s]: around ``time_s`` of a table, or after a key was pressed."""
SILENCE_S = 5.0
"""Without a frame for so long [s] there is something wrong with the port."""
STILL = 5.0
"""A reading that scatters by more than this many standard deviations of its noise was not still."""


@dataclass(frozen=True)
class Poses:
    """Known poses.

    Parameters
    ----------
    q
        Configurations.
    window_s
        Beginning and end of each pose in a recording [s]; none where the table has no times.
    words
        Each pose in words.
    """

    q: Float[Tensor, "poses n_q"]
    window_s: Float[np.ndarray, "poses 2"] | None
    words: tuple[str, ...]


@dataclass(frozen=True)
class PoseReadings:
    """Readings in poses.

    Parameters
    ----------
    values
        Values of a frame, averaged over each pose.
    notes
        Warnings about poses that were not still.
    """

    values: Float[Tensor, "poses channels"]
    notes: tuple[str, ...]


def coordinate_columns(robot: RobotFile) -> dict[str, float]:
    """Columns of a table of poses, and the factor from their unit to SI.

    Examples
    --------
    >>> from repro.live.robot.robot_file import load_robot
    >>> coordinate_columns(load_robot("data/robots/one_segment.toml"))
    {'delta_x_1_mm': 0.001, 'delta_y_1_mm': 0.001, 'delta_L_1_mm': 0.001}
    """
    units = {"delta": ("mm", 1e-3), "kappa": ("rad", 1.0), "phi": ("deg", math.radians(1.0))}
    found = {}
    for name in robot.robot.coordinates:
        unit, factor = units[name.split("_")[0]]
        found[f"{name}_{unit}"] = factor
    return found


def read_poses(path: Path, robot: RobotFile) -> Poses:
    """Read a table of poses: a CSV with one column per coordinate, and ``time_s``, or ``start_s`` and ``end_s``.

    Raises
    ------
    InputError
        If the file is not there, a column is missing or unknown, or a number is missing.
    """
    columns = coordinate_columns(robot)
    if not path.is_file():
        raise bad_input("path", "read_poses", f"a CSV with the columns {', '.join(columns)}", path)
    try:
        table = pd.read_csv(path, dtype=float, comment="#", skipinitialspace=True)
    except ValueError as error:
        raise bad_input("table", path.name, "a CSV of numbers with a header", error) from error
    times = [name for name in ("time_s", "start_s", "end_s") if name in table]
    if missing := [name for name in columns if name not in table]:
        raise bad_input("columns", path.name, f"{', '.join(columns)}", f"none called {', '.join(missing)}")
    if unknown := [name for name in table if name not in columns and name not in times]:
        raise bad_input("columns", path.name, f"{', '.join(columns)} and times", f"also {', '.join(unknown)}")
    if times not in ([], ["time_s"], ["start_s", "end_s"]):
        raise bad_input("times", path.name, "time_s, or start_s and end_s", ", ".join(times))
    if not len(table):
        raise bad_input("table", path.name, "at least one pose", "none")
    if not np.isfinite(table.to_numpy()).all():
        row = int(np.flatnonzero(~np.isfinite(table.to_numpy()).all(axis=1))[0])
        raise bad_input("table", path.name, "complete", f"a number missing in pose {row + 1}")
    window = None
    if times == ["time_s"]:
        window = table["time_s"].to_numpy()[:, None] + np.array([-WINDOW_S / 2, WINDOW_S / 2])
    elif times:
        window = table[times].to_numpy()
        if not (window[:, 1] > window[:, 0]).all():
            row = int(np.flatnonzero(~(window[:, 1] > window[:, 0]))[0])
            raise bad_input("end_s", path.name, "after start_s", f"{window[row, 1]:g} in pose {row + 1}")
    q = torch.from_numpy(table[list(columns)].to_numpy() * np.array(list(columns.values())))
    words = []
    for row in table[list(columns)].itertuples(index=False):
        parts = (name.rsplit("_", 1) for name in columns)
        words.append(", ".join(f"{name} {x:g} {unit}" for x, (name, unit) in zip(row, parts, strict=True)))
    return Poses(q, window, tuple(words))


def recorded_readings(recording: Recording, robot: RobotFile, poses: Poses) -> PoseReadings:
    """Average the frames of a recording over each pose.

    Raises
    ------
    InputError
        If the recording is of another format or number of channels than the robot, the table has no times, or there
        is no frame in a pose.
    """
    if recording.format != robot.format:
        raise bad_input("recording", robot.name, f"of the format {robot.format}", recording.format)
    magnetic = (recording.frames["stream"] == MAGNETIC_STREAM).to_numpy() if robot.imus else slice(None)
    channels = recording.channels[: robot.channels] if robot.imus else recording.channels
    if len(channels) != robot.channels:
        expected = f"of {robot.channels} channels, as described"
        raise bad_input("recording", robot.name, expected, f"one of {len(channels)}")
    units = recording.metadata.get("units")
    if recording.format == "csv" and isinstance(units, list) and len(units) == robot.channels:
        check_units(recording.channels, units, robot.unit)
    if poses.window_s is None:
        raise bad_input("poses", "a recording", "given with time_s, or start_s and end_s", "no times")
    time_s = recording.frames["time_s"].to_numpy()[magnetic]
    values = recording.frames[channels].to_numpy(dtype=float)[magnetic]
    complete = np.isfinite(values).all(axis=1)
    parts = []
    for k, (start, end) in enumerate(poses.window_s):
        inside = complete & (time_s >= start) & (time_s <= end)
        if not inside.any():
            span = f"{time_s.min():.3f} to {time_s.max():.3f} s" if len(time_s) else "no frame at all"
            expected = f"within the recording ({span})"
            raise bad_input(f"pose {k + 1}", "the table", expected, f"no frame from {start:g} to {end:g} s")
        parts.append(values[inside])
    averages = _averages(parts, robot)
    told = tuple(f"Recording: {remark}." for remark in recording.remarks)
    return replace(averages, notes=told + averages.notes)


def guide(
    robot: RobotFile,
    poses: Poses,
    frames: Iterator[Frame],
    *,
    say: Callable[[str], object],
    ask: Callable[[str], object],
    silence_s: float = SILENCE_S,
) -> PoseReadings:
    """Lead a person through the poses: say each, wait for a key, average what then arrives.

    Frames are taken in all the time, so that those averaged arrived after the key was pressed. A pose that was not
    still is asked for once more.

    Parameters
    ----------
    robot
        As described.
    poses
        In the order in which they are asked for; times have no meaning here.
    frames
        From a port, without end; read in a thread of its own.
    say, ask
        Show a line; show a line and wait for the Enter key.
    silence_s
        Longest wait for frames [s].

    Raises
    ------
    InputError
        If no frames come, or frames have another number of values than the file says.
    """
    source = _Collector(frame for frame in frames if not robot.imus or frame.stream == MAGNETIC_STREAM)
    parts = []
    for k, words in enumerate(poses.words):
        question = f"Pose {k + 1} of {len(poses.words)}: {words}. Hold it still and press Enter. "
        part = _taken(robot, source, question, ask, silence_s)
        if _moved(part, robot):
            say("That was not still: once more.")
            part = _taken(robot, source, question, ask, silence_s)
        parts.append(part)
    return _averages(parts, robot)


def _taken(
    robot: RobotFile, source: _Collector, question: str, ask: Callable[[str], object], silence_s: float
) -> np.ndarray:
    ask(question)
    frames = source.next(max(2, round(WINDOW_S * robot.rate_hz)), silence_s)
    for frame in frames:
        robot.signal(frame.values)  # refuses frames of another number of values
    return np.array([frame.values for frame in frames])


class _Collector:
    """Reads frames in a thread, and keeps those that are asked for."""

    def __init__(self, frames: Iterator[Frame]) -> None:
        self._changed = threading.Condition()
        self._wanted, self._taken = 0, []
        self._end: BaseException | None = None
        threading.Thread(target=self._read, args=(frames,), daemon=True).start()

    def _read(self, frames: Iterator[Frame]) -> None:
        end: BaseException = EOFError("the stream ended")
        try:
            for frame in frames:
                with self._changed:
                    if len(self._taken) < self._wanted:
                        self._taken.append(frame)
                        self._changed.notify()
        except Exception as error:  # belongs to whoever waits for frames
            end = error
        with self._changed:
            self._end = end
            self._changed.notify()

    def next(self, count: int, silence_s: float) -> list[Frame]:
        """Return frames that arrive from now on."""
        with self._changed:
            self._taken, self._wanted = [], count
            while len(self._taken) < count:
                have = len(self._taken)
                if self._end is not None:
                    raise bad_input(
                        "frames", "repro calibrate", f"{count} for a pose", f"{have}: {self._end}"
                    )
                if not self._changed.wait(silence_s) and len(self._taken) == have:
                    received = f"{have}, then none for {silence_s:g} s"
                    raise bad_input("frames", "repro calibrate", f"{count} for a pose", received)
            self._wanted = 0
            return self._taken


def _moved(part: np.ndarray, robot: RobotFile) -> bool:
    return len(part) > 1 and bool(
        (part[:, list(robot.channel)].std(axis=0, ddof=1) > STILL * robot.noise).any()
    )


def _averages(parts: list[np.ndarray], robot: RobotFile) -> PoseReadings:
    notes = tuple(
        f"Pose {k + 1} was not still: its readings scatter by more than {STILL:g} times the noise of {robot.name}."
        for k, part in enumerate(parts)
        if _moved(part, robot)
    )
    return PoseReadings(torch.from_numpy(np.array([part.mean(axis=0) for part in parts])), notes)
