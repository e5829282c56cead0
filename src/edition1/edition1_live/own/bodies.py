"""Rigid bodies on a robot: from a file of OptiTrack Motive, to poses of its segments' ends, and to configurations."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Bool, Float
from scipy.spatial.transform import Rotation
from torch import Tensor

from edition1 import se3
from edition1.errors import InputError, bad_input, require
from edition1.estimation.poses import configurations
from edition1.robot_file.robot_file import RobotFile
from edition1_live.own.optitrack import read_frames, read_header
from edition1_live.robot.number_table import check_times, read_rows

_LENGTH_UNITS = {"Meters": 1.0, "Centimeters": 1e-2, "Millimeters": 1e-3}
_KEYS = [("Position", axis) for axis in "XYZ"] + [("Rotation", axis) for axis in "XYZW"]


def is_motive(path: Path) -> bool:
    """Whether a file starts as Motive's exports do."""
    if not path.is_file():
        return False
    with path.open("rb") as stream:
        return stream.read(64).removeprefix(b"\xef\xbb\xbf").startswith(b"Format Version")


def read_bodies(
    path: Path, names: Sequence[str]
) -> tuple[Float[np.ndarray, " frames"], Float[np.ndarray, "frames bodies 7"]]:
    """Read times [s], and of every named body position [m] and quaternion (x, y, z, w); NaN where it was not seen.

    Motive's y axis points up and a body's axes are the world's when it is defined, so with a robot that stands
    straight up :math:`(x, y, z) = (X, -Z, Y)` are axes with z towards its tip, for world and bodies.

    Parameters
    ----------
    path
        CSV export with quaternions, global coordinates; versions 1.2x.
    names
        Of the bodies.

    Raises
    ------
    InputError
        Another version, rotation type or unit; a body that is not there; numbers that are none; fewer frames than
        the header says.
    """
    rows = read_rows(path)
    axes = next((k for k, (_, row) in enumerate(rows) if row[0] == "Frame"), 0)
    heads = {row[1]: row for _, row in rows[:axes] if len(row) > 1}
    if axes < 2 or "Name" not in heads:
        raise bad_input("header", path.name, "one of Motive: lines with Name and Frame", "none")
    first = rows[0][1]
    version = dict(zip(first[0::2], first[1::2], strict=False)).get("Format Version", "")
    require(version.startswith("1.2"), "Format Version", path.name, "1.20 to 1.29", version or "nothing")
    header = read_header([first], path.name, version=version, frames=len(rows) - axes - 1)
    for name, accepted in (("Length Units", list(_LENGTH_UNITS)), ("Coordinate Space", ["Global"])):
        if header.get(name) not in accepted:
            raise bad_input(name, path.name, " or ".join(accepted), header.get(name, "nothing"))
    columns = list(zip(heads["Name"], rows[axes - 1][1], rows[axes][1], strict=False))
    there = sorted({name for name, kind, _ in columns if kind == "Rotation"})
    if missing := [name for name in names if any((name, *key) not in columns for key in _KEYS)]:
        expected = f"rigid bodies of the file ({', '.join(there) or 'there is none'})"
        raise bad_input("body", path.name, expected, ", ".join(missing))
    picked = [columns.index((name, *key)) for name in names for key in _KEYS]
    table = read_frames([row for _, row in rows[axes + 1 :]], [1, *picked], path.name)
    lines = [line for line, _ in rows[axes + 1 :]]
    check_times(path.name, "Time (Seconds)", table[:, 0], lines, apart=True)
    bodies = table[:, 1:].reshape(len(table), len(names), 7)
    bodies[..., :3] *= _LENGTH_UNITS[header["Length Units"]]
    x, y, z = (bodies[..., [k, k + 3]].copy() for k in range(3))
    bodies[..., [0, 3]], bodies[..., [1, 4]], bodies[..., [2, 5]] = x, -z, y
    return table[:, 0], bodies


_MOST_UNFIT = 0.05
"""Share of the poses that may be none that the robot can take; 20 of them at most."""
_TRIED = 20
_MOST_MISFIT = 0.1, 0.35
"""Largest misfit of the kinematics, root mean square: share of the length of the robot, and angle [rad]."""


def end_poses(
    owner: str,
    robot: RobotFile,
    time_s: Float[np.ndarray, " poses"],
    bodies: Float[np.ndarray, "poses bodies 7"],
    straight_s: float,
) -> Float[Tensor, "poses segments 4 4"]:
    """Poses of the segments' ends in the base frame.

    Parameters
    ----------
    owner
        Name of the file, for messages.
    robot
        As described.
    time_s
        Times [s].
    bodies
        Positions [m] and quaternions (x, y, z, w), in one frame; with one more than segments the first is the base.
    straight_s
        See :func:`edition1_live.own.poses.read_measured_poses`.

    Raises
    ------
    InputError
        If a quaternion is not unit within 0.01.
    """
    error = np.abs(np.linalg.norm(bodies[..., 3:], axis=-1) - 1.0)
    if error.max() > 0.01:
        k = int(error.max(axis=1).argmax())
        raise bad_input(
            "quaternions", owner, "unit within 0.01", f"an error of {error.max():.3g} at {time_s[k]:g} s"
        )
    T = torch.zeros(*bodies.shape[:2], 4, 4, dtype=torch.float64)
    T[..., :3, :3] = torch.from_numpy(
        Rotation.from_quat(bodies[..., 3:].reshape(-1, 4)).as_matrix().reshape(*bodies.shape[:2], 3, 3)
    )
    T[..., :3, 3] = torch.from_numpy(bodies[..., :3])
    T[..., 3, 3] = 1.0
    if T.shape[1] > len(robot.robot.segments):
        T = se3.inverse(T[:, :1]) @ T[:, 1:]
    if straight_s > 0:
        rest = torch.from_numpy(time_s < time_s[0] + straight_s)
        mean = T[rest].mean(0)
        U, _, V = torch.linalg.svd(mean[:, :3, :3])
        mean[:, :3, :3] = U @ V  # the rotation nearest to the mean
        straight = robot.robot.base_poses(torch.zeros(robot.robot.n_q, dtype=torch.float64))[1:]
        T = T @ (se3.inverse(mean) @ straight)
    return T


def configurations_of(
    owner: str,
    robot: RobotFile,
    T: Float[Tensor, "poses segments 4 4"],
    noise_m: float,
    noise_rad: float,
) -> tuple[Tensor, Tensor, Bool[np.ndarray, " poses"], tuple[str, ...]]:
    """Configurations and covariances of the poses that the robot can take, which these are, and how well it fits.

    Raises
    ------
    InputError
        If too many poses have no configuration, or the kinematics miss them by far.
    """
    fits = np.zeros(len(T), dtype=bool)
    parts: list[tuple[Tensor, Tensor]] = []
    most = min(math.ceil(_MOST_UNFIT * len(T)), _TRIED)
    waiting, unfit = [(0, len(T))], 0

    def fitted(first: int, last: int) -> tuple[Tensor, Tensor] | None:
        try:
            return configurations(robot.robot, T[first:last], position_m=noise_m, rotation_rad=noise_rad)
        except InputError:
            return None

    # A few tell at once whether these are poses of the robot: in other axes most have a fit, a bad one.
    tried = np.unique(np.linspace(0, len(T) - 1, _TRIED).astype(int)).tolist()
    few = [(k, found[0]) for k in tried if (found := fitted(k, k + 1)) is not None]
    if len(tried) - len(few) > 2 * _MOST_UNFIT * len(tried):
        raise _misfit(owner, f"{len(tried) - len(few)} of {len(tried)} tried without a fit")
    _misses(owner, robot, torch.cat([q for _, q in few]), T[[k for k, _ in few]])
    while waiting:
        first, last = waiting.pop()
        found = fitted(first, last)
        if found is None:
            if last - first > 1:
                middle = (first + last) // 2
                waiting += [(middle, last), (first, middle)]
                continue
            unfit += 1
            if unfit > most:
                raise _misfit(owner, f"more than {most} of {len(T)} without a fit")
            continue
        parts.append(found)
        fits[first:last] = True
    q, covariance = (torch.cat(values) for values in zip(*parts, strict=True))
    text = _misses(owner, robot, q, T[torch.from_numpy(fits)])
    note = f"The kinematics of {robot.name} miss the measured poses by {text} (root mean square)."
    lost = (f"{unfit} poses are none that the robot can take.",) if unfit else ()
    return q, covariance, fits, (note, *lost)


def _misses(owner: str, robot: RobotFile, q: Tensor, measured: Tensor) -> str:
    """Say by how much the kinematics miss measured poses; refuse if it is by far."""
    difference = robot.robot.base_poses(q)[:, 1:] - measured
    miss = float(difference[..., :3, 3].square().sum(-1).mean().sqrt())
    turn = float(difference[..., :3, :3].square().sum((-2, -1)).mean().sqrt()) / math.sqrt(2)
    text = f"{1e3 * miss:.2f} mm and {math.degrees(turn):.2f} deg"
    if miss > _MOST_MISFIT[0] * robot.robot.length or turn > _MOST_MISFIT[1]:
        raise _misfit(owner, f"poses that its nearest shapes miss by {text} (root mean square)")
    return text


def _misfit(owner: str, received: str) -> InputError:
    expected = "poses that the robot can take, in m or mm as their columns say, z along the straight robot to its tip"
    return bad_input("poses", owner, expected, received)
