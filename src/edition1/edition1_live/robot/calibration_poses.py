"""Tables of known poses, and the readings that belong to them: cut out of a recording, or kept in a file."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float, Int
from torch import Tensor

from edition1.errors import bad_input, require
from edition1.robot_file.columns import MAGNETIC_STREAM
from edition1.robot_file.robot_file import RobotFile
from edition1_live.record.recording import Recording
from edition1_live.robot.kept_readings import Part, part_of, read_kept
from edition1_live.robot.number_table import check_columns, read_numbers
from edition1_live.robot.readings_file import frames_of

WINDOW_S = 0.5
"""Readings are averaged over this time [s]: around ``time_s`` of a table, or after a key was pressed."""
_RATE_FACTOR = 1.25
"""A rate that differs from the stated one by more than this factor is told."""
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
        Warnings: poses that were not still, another rate than stated.
    """

    values: Float[Tensor, "poses channels"]
    notes: tuple[str, ...]


def coordinate_columns(robot: RobotFile) -> dict[str, float]:
    """Columns of a table of poses, and the factor from their unit to SI.

    Examples
    --------
    >>> from edition1.robot_file.load import load_robot
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
    require(path.is_file(), "path", "read_poses", f"a CSV with the columns {', '.join(columns)}", path)
    table = read_numbers(path)
    times = [name for name in ("time_s", "start_s", "end_s") if name in table.columns]
    check_columns(path.name, list(columns), [name for name in table.columns if name not in times], "times")
    if times not in ([], ["time_s"], ["start_s", "end_s"]):
        raise bad_input("times", path.name, "time_s, or start_s and end_s", ", ".join(times))
    require(table.lines, "table", path.name, "at least one pose", "none")
    complete = np.isfinite(table.rows(table.columns)).all(axis=1)
    if not complete.all():
        row = int(np.flatnonzero(~complete)[0])
        raise bad_input("table", path.name, "complete", f"a number missing in pose {row + 1}")
    window = None
    if times == ["time_s"]:
        window = table.columns["time_s"][:, None] + np.array([-WINDOW_S / 2, WINDOW_S / 2])
    elif times:
        window = table.rows(times)
        if not (window[:, 1] > window[:, 0]).all():
            row = int(np.flatnonzero(~(window[:, 1] > window[:, 0]))[0])
            raise bad_input("end_s", path.name, "after start_s", f"{window[row, 1]:g} in pose {row + 1}")
    as_written = table.rows(columns)
    q = torch.from_numpy(as_written * np.array(list(columns.values())))
    named = [name.rsplit("_", 1) for name in columns]
    words = (
        ", ".join(f"{name} {x:g} {unit}" for x, (name, unit) in zip(row, named, strict=True))
        for row in as_written
    )
    return Poses(q, window, tuple(words))


def farthest_points(
    x: Float[Tensor, "points n"], first: Float[Tensor, " n"], most: int
) -> Int[Tensor, " chosen"]:
    """Return indices of points that spread: each is the farthest from ``first`` and from those chosen before.

    Fewer than ``most`` where all others coincide with one of these.

    Examples
    --------
    >>> x = torch.tensor([[0.0], [1.0], [2.0], [10.0]])
    >>> farthest_points(x, torch.tensor([0.0]), 2).tolist()
    [3, 2]
    """
    chosen, distance = [], (x - first).square().sum(-1)
    while len(chosen) < most and float(distance.max()) > 0:
        chosen.append(int(distance.argmax()))
        distance = torch.minimum(distance, (x - x[chosen[-1]]).square().sum(-1))
    return torch.tensor(chosen, dtype=torch.long)


def recorded_readings(recording: Recording, robot: RobotFile, poses: Poses) -> PoseReadings:
    """Average the frames of a recording over each pose.

    Raises
    ------
    InputError
        If the recording does not fit the robot (:func:`edition1_live.robot.readings_file.frames_of`), the table has no
        times, or there is no frame in a pose.
    """
    fits, notes = frames_of(recording, robot)
    if poses.window_s is None:
        raise bad_input("poses", "a recording", "given with time_s, or start_s and end_s", "no times")
    own = fits & (recording.stream == MAGNETIC_STREAM)
    time_s, values = recording.time_s[own], recording.values[own, : robot.channels]
    complete = np.isfinite(values).all(axis=1)
    parts = []
    for k, (start, end) in enumerate(poses.window_s):
        inside = complete & (time_s >= start) & (time_s <= end)
        if not inside.any():
            span = f"{time_s.min():.3f} to {time_s.max():.3f} s" if len(time_s) else "no frame at all"
            expected = f"within the recording ({span})"
            raise bad_input(f"pose {k + 1}", "the table", expected, f"no frame from {start:g} to {end:g} s")
        parts.append(part_of(values[inside], float(np.ptp(time_s[inside]))))
    found = pose_readings(parts, robot)
    return replace(found, notes=(*notes, *found.notes))


def read_kept_readings(path: Path, robot: RobotFile, poses: Poses) -> PoseReadings:
    """Readings in poses that a session at a port has left in a file.

    Raises
    ------
    InputError
        If the file is damaged or of another kind of robot, or holds another number of poses than the table.
    """
    parts, q = read_kept(path, robot.channels, tuple(coordinate_columns(robot)))
    if len(parts) != len(poses.q):
        expected = f"of all {len(poses.q)} poses of the table (with the port in its place a session goes on)"
        raise bad_input("readings", path.name, expected, f"{len(parts)} poses")
    taken = pose_readings(parts, robot)
    if torch.allclose(q, poses.q, rtol=1e-9, atol=1e-12):
        return taken
    other = f"{path.name} was taken with another table of poses; the one given is used."
    return PoseReadings(taken.values, (*taken.notes, other))


def moved(part: Part, robot: RobotFile) -> bool:
    """Whether readings scatter more than they would if the robot were still."""
    return bool((part.deviation[list(robot.channel)] > STILL * robot.noise).any())


def pose_readings(parts: list[Part], robot: RobotFile) -> PoseReadings:
    """Put poses together, with notes on those that were not still, and on another rate than the file says."""
    notes = [
        f"Pose {k + 1} was not still: its readings scatter by more than {STILL:g} times the noise of {robot.name}."
        for k, part in enumerate(parts)
        if moved(part, robot)
    ]
    seconds = sum(part.seconds for part in parts)
    rate = sum(part.frames - 1 for part in parts) / seconds if seconds else robot.rate_hz
    if not 1 / _RATE_FACTOR < rate / robot.rate_hz < _RATE_FACTOR:
        notes.append(f"{rate:.3g} frames arrive per second; {robot.name} says rate_hz = {robot.rate_hz:g}.")
    return PoseReadings(torch.from_numpy(np.array([part.mean for part in parts])), tuple(notes))
