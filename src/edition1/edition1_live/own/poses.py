"""Measured poses of one's own: configurations, or poses of the segments' ends, over time."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from edition1.errors import bad_input, require
from edition1.robot_file.robot_file import RobotFile
from edition1_live.own.bodies import configurations_of, end_poses, is_motive, read_bodies
from edition1_live.own.samples import GAP_STEPS, interpolated
from edition1_live.robot.calibrate import pose_covariance
from edition1_live.robot.calibration_poses import coordinate_columns
from edition1_live.robot.number_table import check_columns, read_numbers, times_of

_BEYOND, _MOST_BEYOND = 0.25, 0.05
"""Poses may be this share of the width of the bounds beyond them, and this share of the poses farther."""
_LEAST_MOTION = 0.05
"""Poses must move some coordinate by this share of the width of its bounds."""


@dataclass(frozen=True)
class MeasuredPoses:
    """Measured poses over time; those of frames without a pose are left out.

    Parameters
    ----------
    time_s
        By the clock of the motion capture [s].
    q
        Configurations.
    covariance
        Of every configuration.
    tip
        Measured positions of the tip in the base frame [m]; none where configurations were measured.
    tip_covariance
        Of the tip [m^2].
    step_s
        Time between two frames of the motion capture [s].
    frames
        Number of frames, with those that have no pose.
    notes
        What was left out, and how well the robot's kinematics fit.
    """

    time_s: Float[np.ndarray, " poses"]
    q: Float[Tensor, "poses n_q"]
    covariance: Float[Tensor, "poses n_q n_q"]
    tip: Float[Tensor, "poses 3"] | None
    tip_covariance: Float[Tensor, "3 3"] | None
    step_s: float
    frames: int
    notes: tuple[str, ...]

    @property
    def longest_gap_s(self) -> float:
        """Poses farther apart than this are not interpolated over [s]."""
        return GAP_STEPS * self.step_s

    @property
    def gaps(self) -> int:
        """How many times poses are farther apart than that."""
        return int((np.diff(self.time_s) > self.longest_gap_s).sum())

    def counted_from(self, start_s: float) -> MeasuredPoses:
        """Return the same with another zero of the clock [s]."""
        return replace(self, time_s=self.time_s - start_s)

    def at(
        self, values: Float[np.ndarray, "poses k"], time_s: Float[np.ndarray, " times"]
    ) -> Float[np.ndarray, "times k"]:
        """Interpolate what belongs to the poses; NaN in gaps."""
        return interpolated(self.time_s, values, time_s, self.longest_gap_s)


def read_measured_poses(
    path: Path,
    robot: RobotFile,
    *,
    bodies: Sequence[str] = (),
    straight_s: float = 0.0,
    noise_m: float,
    noise_rad: float,
) -> MeasuredPoses:
    """Read measured poses.

    Parameters
    ----------
    path
        A CSV with ``time_s`` and the coordinates as in a table of poses (``delta_x_1_mm``), or for the end of every
        segment ``x_1_mm, y_1_mm, z_1_mm`` (or ``_m``) and ``qx_1, qy_1, qz_1, qw_1``, with number 0 for a base that
        moves; or a CSV that Motive exported.
    robot
        As described.
    bodies
        For Motive: rigid bodies on the ends of the segments from base to tip; before them, if there is one more,
        that on the base.
    straight_s
        The robot stands straight and unstretched for the first so many seconds: turns and shifts of the bodies
        against the segments' ends are taken from there [s]. With 0 there are none.
    noise_m, noise_rad
        Standard deviations of a measured length (of coordinates, or of positions along each axis), and angle.

    Raises
    ------
    InputError
        If the file does not hold poses of this robot; the message names column and line, or says what does not fit.
    """
    require(0 <= straight_s < math.inf, "straight-s", "repro fit", "0 or above", straight_s)
    time_s, table = _rows(path, robot, bodies)
    seen = np.asarray(np.isfinite(table).reshape(len(table), -1).all(axis=1))
    tip, tip_covariance, notes = None, None, ()
    if table.ndim == 2:
        require(not straight_s, "straight-s", "repro fit", "for measured poses of bodies only", path.name)
        q = torch.from_numpy(table[seen])
        covariance = pose_covariance(robot, noise_m, noise_rad).expand(len(q), -1, -1)
    else:
        require(seen.any(), "poses", path.name, "seen in some frame by all bodies", "none in any frame")
        T = end_poses(path.name, robot, time_s[seen], table[seen], straight_s)
        q, covariance, fits, notes = configurations_of(path.name, robot, T, noise_m, noise_rad)
        seen[seen] = fits
        tip, tip_covariance = T[fits, -1, :3, 3], noise_m**2 * torch.eye(3, dtype=torch.float64)
    require(len(q) >= 3, "poses", path.name, "at least three", f"{len(q)} of {len(seen)} rows")
    _check_range(path, robot, q)
    if len(q) < len(seen):
        notes = (*notes, f"{len(seen) - len(q)} of {len(seen)} rows of {path.name} have no pose.")
    step_s = float(np.median(np.diff(time_s)))
    return MeasuredPoses(time_s[seen], q, covariance, tip, tip_covariance, step_s, len(seen), notes)


def _rows(path: Path, robot: RobotFile, bodies: Sequence[str]) -> tuple[np.ndarray, np.ndarray]:
    """Return times [s], and coordinates ``[rows, n_q]`` or positions [m] and quaternions ``[rows, bodies, 7]``."""
    if is_motive(path):
        ends = len(robot.robot.segments)
        if len(bodies) not in (ends, ends + 1) or len(set(bodies)) != len(bodies):
            expected = f"{ends} different rigid bodies from base to tip, or {ends + 1} with one on the base"
            raise bad_input("body", "repro fit", expected, ", ".join(bodies) or "none (use --body NAME)")
        return read_bodies(path, bodies)
    require(not bodies, "body", "repro fit", "for files of Motive only", path.name)
    table = read_numbers(path)
    time_column, time_s = times_of(path.name, table, apart=True)
    found = [name for name in table.columns if name != time_column]
    columns = coordinate_columns(robot)
    if any(name in found for name in columns):
        check_columns(path.name, list(columns), found, "a time")
        return time_s, table.rows(columns) * np.array(list(columns.values()))
    first = int("qx_0" not in found)
    numbers = range(first, len(robot.robot.segments) + 1)
    unit = "_m" if f"x_{first}_m" in found else "_mm"
    wanted = [[f"{axis}_{k}{unit}" for axis in "xyz"] + [f"q{axis}_{k}" for axis in "xyzw"] for k in numbers]
    names = [name for names in wanted for name in names]
    if not any(name in found for name in names):
        expected = f"{', '.join(columns)}, or for the end of every segment {', '.join(wanted[-1])}"
        raise bad_input("columns", path.name, expected, ", ".join(found))
    check_columns(path.name, names, found, "a time")
    values = table.rows(names).reshape(-1, len(wanted), 7)
    values[..., :3] *= 1.0 if unit == "_m" else 1e-3
    return time_s, values


def _check_range(path: Path, robot: RobotFile, q: Tensor) -> None:
    """Refuse poses in another unit: most of them beyond the bounds, or hardly moving."""
    width = robot.upper - robot.lower
    names = list(coordinate_columns(robot).items())
    far = (q < robot.lower - _BEYOND * width) | (q > robot.upper + _BEYOND * width)
    share = float(far.any(-1).double().mean())
    if share > _MOST_BEYOND:
        k = int(far.double().mean(0).argmax())
        name, factor = names[k]
        low, high, least, most = (
            float(x[k]) / factor for x in (robot.lower, robot.upper, q.amin(0), q.amax(0))
        )
        expected = f"within the bounds of {robot.name}, {low:.4g} to {high:.4g} (units, axes, bounds?)"
        seen = f"{least:.4g} to {most:.4g}, {math.ceil(100 * share)} % of the poses far outside"
        raise bad_input(name, path.name, expected, seen)
    moved = (q.amax(0) - q.amin(0)) / width
    if float(moved.max()) < _LEAST_MOTION:
        k = int(moved.argmax())
        expected = f"poses that move by {100 * _LEAST_MOTION:g} % of the bounds of {robot.name} (units?)"
        seen = f"{names[k][0]} that moves by {float(moved[k]):.1%}, and no other by more"
        raise bad_input("poses", path.name, expected, seen)
