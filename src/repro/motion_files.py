"""Motion capture in files: what Motive, Vicon and Qualisys export, and the configurations that it shows."""

from __future__ import annotations

import csv
import math
import re
from collections.abc import Mapping, Sequence
from contextlib import suppress
from datetime import datetime
from itertools import pairwise
from pathlib import Path
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from repro.common import Array, InputError, bad_input, numbers, printable, require
from repro.estimators.calibration import outside
from repro.estimators.fit_shape import fit_shape, measured_poses, places_of
from repro.lines import SI
from repro.parts import Assembly
from repro.readings import POSITION_FIRST, bodies_of, configurations_of
from repro.tables import Table, read_table, text_of

_SHOWN = 200
"""Shapes by which the axes of the base are found."""
_LENGTH_UNITS = {"Millimeters": 1e-3, "Centimeters": 1e-2, "Meters": 1.0}
_DECIMAL_COMMA = re.compile(r"^([-+\d: ,]*\d),(\d+)$", re.ASCII)
"""In a number or a time of day."""
_POSE = [("Rotation", axis) for axis in "XYZW"] + [("Position", axis) for axis in "XYZ"]
_OF_VICON = ("Segments", "Objects", "Joints", "Trajectories", "Devices", "Model Outputs")
_EXPORTS = ("Format Version", "NO_OF_FRAMES", *_OF_VICON)
"""What files of Motive, Qualisys and Vicon begin with; the parts of a file of Vicon."""
_FROZEN, _JUMP_STEPS, _FRAME_S, _ORIGIN = 20, 5.0, 0.5, 5e-3
"""Frames are frozen if more are equal in a row and the next step is so many usual ones; rows farther apart than this
are no frames [s]; a body that is mostly farther from the origin does not go there [m]."""
_SLACK, _OUTSIDE, _MISFIT = 0.1, 0.05, 0.1
"""Poses may be outside the bounds by this share of their width, this share of the poses farther, and the kinematics
may miss them by this share of the robot's length."""
_STILL = 0.02
"""How far bodies may be from their mean places while the robot is straight, as a share of its length."""
_TURNED = math.radians(25.0)
"""A body that is mostly turned more against the robot's kinematics was defined in other axes."""
_EQUAL = 5e-5
"""Two ways of the axes fit alike if their misfits differ by no more than a tenth and this [m]."""


class Motion(NamedTuple):
    """Poses of rigid bodies over time, in the axes of the motion capture."""

    name: str
    """Of the take."""
    started: datetime | None
    """When it started, by the clock of the computer that recorded; ``None`` if the file does not say."""
    rate_hz: float
    """Frames per second in the file."""
    times: Array
    """Time of each frame after the start ``[t]`` [s]."""
    bodies: dict[str, Array]
    """By name ``[t, 7]``: quaternion X, Y, Z, W, then position X, Y, Z [m]; NaN where the body is lost."""
    lines: Sequence[int] = ()
    """Line of each frame in the file."""
    remarks: tuple[str, ...] = ()
    """What was left out."""
    missing: int = 0
    """Frames that the header announces and the file does not have."""
    up: str = "z"
    """The axis that points up."""


def read_motion(path: Path | str) -> Motion:
    """Read the rigid bodies of a file of motion capture.

    The file is an export of OptiTrack Motive (CSV with quaternions, versions 1.20 to 1.29), Vicon (CSV with
    segments, other parts before and after), Qualisys (TSV with bodies, "6D", decimal points or commas), or a table
    with the columns ``time_s, x_1_mm, y_1_mm, z_1_mm, qx_1, qy_1, qz_1, qw_1`` for body "1" and so on. Quaternions
    lead from the body to the axes of the file; in Motive y points up. A frame is lost where cells are empty, where a
    body has no orientation, or lies in the origin without a turn; more than 20 frames that are equal bit for bit and
    end in a jump are frozen and lost too.

    Parameters
    ----------
    path
        The file.

    Raises
    ------
    InputError
        If it is no such file, has another version, unit or type of rotation, no body, times that do not increase, or
        quaternions that are not unit within 0.01.

    Examples
    --------
    One body, which is lost in the second of three frames:

    >>> import tempfile
    >>> first = "Format Version,1.23,Export Frame Rate,40,Total Exported Frames,3"
    >>> text = f'''{first},Rotation Type,Quaternion,Length Units,Millimeters
    ...
    ... ,Type,Rigid Body,Rigid Body,Rigid Body,Rigid Body,Rigid Body,Rigid Body,Rigid Body
    ... ,Name,Tip,Tip,Tip,Tip,Tip,Tip,Tip
    ... ,ID,1,1,1,1,1,1,1
    ... ,,Rotation,Rotation,Rotation,Rotation,Position,Position,Position
    ... Frame,Time (Seconds),X,Y,Z,W,X,Y,Z
    ... 0,0.000,0,0,0,1,5,110,-3
    ... 1,0.025,,,,,,,
    ... 2,0.050,0.6,0,0,0.8,5,90,-60
    ... '''
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     file = Path(folder, "tilt.csv")
    ...     _ = file.write_text(text)
    ...     take = read_motion(file)
    >>> take.name, take.rate_hz, list(take.bodies)
    ('tilt', 40.0, ['Tip'])
    >>> take.bodies["Tip"][:, 4:]
    array([[ 0.005,  0.11 , -0.003],
           [   nan,    nan,    nan],
           [ 0.005,  0.09 , -0.06 ]])
    """
    path, remarks = Path(path), list[str]()
    require(path.is_file(), "path", "read_motion", "a file that exists", path)
    text, owner = text_of(path, remarks), path.name
    if not _is_export(text):
        return _motion_of(read_table(path))
    read = _motive if text.startswith("Format") else _qualisys if text.startswith("NO") else _vicon
    separator = "\t" if read is _qualisys else ","
    motion = read([next(csv.reader([line], delimiter=separator), []) for line in text.splitlines()], path)
    frames = len(motion.times)
    increasing = frames and np.all(np.diff(motion.times) > 0)
    require(increasing, "times", owner, "increasing from frame to frame", "others, or no frame")
    if motion.missing:
        remarks.append(f"{owner} has {frames} frames, {motion.missing} fewer than its header says.")
    bodies = {printable(name): poses for name, poses in motion.bodies.items()}
    for name, poses in bodies.items():
        _clear_lost(poses, f"{name} in {owner}", motion.lines, remarks)
    return motion._replace(bodies=bodies, remarks=tuple(remarks))


def _is_export(text: str) -> bool:
    """Whether a text is what Motive, Qualisys or Vicon export, by its first cell."""
    return re.split(r"[,\t\r\n]", text, maxsplit=1)[0] in _EXPORTS


def _numbers_of(
    rows: Sequence[Sequence[str]], header: int, end: int, wanted: Sequence[int], owner: str
) -> tuple[Array, list[int]]:
    """Return the wanted columns of the rows below a header ``[t, n]``, NaN where a cell is empty, and their lines."""
    lines = [k + 1 for k in range(header, end) if any(rows[k])]
    try:
        values = [[float(rows[k - 1][c] or "nan") for c in wanted] for k in lines]
    except (ValueError, IndexError) as error:
        raise bad_input("frames", owner, "rows of numbers", error) from error
    return np.array(values).reshape(-1, len(wanted)), lines


def _motive(rows: list[list[str]], path: Path) -> Motion:
    owner = path.name
    header = {"Coordinate Space": "Global"} | dict(zip(rows[0][::2], rows[0][1::2], strict=False))
    version = header.get("Format Version", "nothing")
    require(re.fullmatch(r"1\.2\d", version), "Format Version", owner, "1.20 to 1.29", version)
    known = {
        "Rotation Type": ("Quaternion",), "Length Units": tuple(_LENGTH_UNITS), "Coordinate Space": ("Global",)
    }  # fmt: skip
    for key, values in known.items():
        require(header.get(key) in values, key, owner, " or ".join(values), header.get(key, "nothing"))
    try:
        rate_hz, announced = float(header["Export Frame Rate"]), int(header["Total Exported Frames"])
        axes = next(k for k, row in enumerate(rows) if row[:1] == ["Frame"])
        began = header.get("Capture Start Time")
        started = None if began is None else datetime.strptime(began, "%Y-%m-%d %I.%M.%S.%f %p")
    except (KeyError, ValueError, StopIteration) as error:
        words = (
            "one with frame rate, number of frames and, if any, start time, and a line that begins with Frame"
        )
        raise bad_input("header", owner, words, error or "another") from error
    # Older versions do not say which line is which: there the names are in the fourth.
    names = next((row for row in rows[:axes] if row[1:2] == ["Name"]), rows[min(3, axes)])
    columns = list(zip(names, rows[axes - 1], rows[axes], strict=False))
    keys = {name: [(name, *key) for key in _POSE] for name, kind, _ in columns if kind == "Rotation"}
    picked = {name: [columns.index(key) for key in own] for name, own in keys.items() if {*own} <= {*columns}}
    require(picked, "rigid bodies", owner, "there with rotation and position", "none")
    wanted = [1, *(k for own in picked.values() for k in own)]
    table, lines = _numbers_of(rows, axes + 1, len(rows), wanted, owner)
    poses = table[:, 1:].reshape(len(table), -1, 7).swapaxes(0, 1).copy()
    poses[..., 4:] *= _LENGTH_UNITS[header["Length Units"]]
    bodies, name = dict(zip(picked, poses, strict=True)), header.get("Take Name", path.stem)
    return Motion(name, started, rate_hz, table[:, 0], bodies, lines, (), max(announced - len(table), 0), "y")


def _vicon(rows: list[list[str]], path: Path) -> Motion:
    owner, wanted = path.name, ["RX", "RY", "RZ", "TX", "TY", "TZ"]
    first = next((k for k, row in enumerate(rows) if row and row[0] in _OF_VICON[:2]), 0)
    end = next((k for k, row in enumerate(rows) if k > first + 5 and not any(row)), len(rows))
    header = [*rows[first : first + 5], *5 * [[""]]]
    starts = [k for k in range(len(header[3])) if header[3][k : k + 6] == wanted]
    known = all(len(own := header[4][k : k + 6]) == 6 and {*own} <= {*SI} for k in starts)
    stated = starts and known and re.fullmatch(r"[\d.]+", header[1][0])
    words = "of Vicon: a rate, names, RX, RY, RZ, TX, TY, TZ of each segment, and their units"
    require(stated, "header", owner, words, "another")
    table, lines = _numbers_of(rows, first + 5, end, [0, *(k + c for k in starts for c in range(6))], owner)
    bodies, rate_hz = dict[str, Array](), float(header[1][0])
    for n, k in enumerate(starts):
        own = table[:, 1 + 6 * n : 7 + 6 * n] * [SI[unit] for unit in header[4][k : k + 6]]
        q = Rotation.from_rotvec(np.nan_to_num(own[:, :3])).as_quat()
        there = np.isfinite(own).all(axis=1, keepdims=True)
        bodies[header[2][k]] = np.concatenate([q * there, own[:, 3:]], axis=1)
    return Motion(path.stem, None, rate_hz, (table[:, 0] - 1) / rate_hz, bodies, lines)


def _qualisys(rows: list[list[str]], path: Path) -> Motion:
    rows = [[_DECIMAL_COMMA.sub(r"\1.\2", cell) for cell in row] for row in rows]
    axes = next((k for k, row in enumerate(rows) if row[:2] == ["Frame", "Time"]), 0)
    header = {row[0]: row[1:] for row in rows[:axes] if row}
    names = header.get("BODY_NAMES", [])
    whole = axes and all(rows[axes][2 + 16 * n :][:3] == ["X", "Y", "Z"] for n in range(len(names)))
    words = "of Qualisys 6D: BODY_NAMES, then Frame, Time, and X, Y, Z, angles, Residual, Rot[0] to Rot[8]"
    require(names and whole and "Rot[0]" in rows[axes], "header", path.name, words, "another")
    wanted = [1, *(2 + 16 * n + c for n in range(len(names)) for c in (0, 1, 2, *range(7, 16)))]
    table, lines = _numbers_of(rows, axes + 1, len(rows), wanted, path.name)
    bodies = dict[str, Array]()
    for n, name in enumerate(names):
        own = table[:, 1 + 12 * n : 13 + 12 * n]
        R = own[:, 3:].reshape(-1, 3, 3).swapaxes(1, 2)  # by columns
        there = np.isfinite(R).all((1, 2)) & (np.abs(np.linalg.det(np.nan_to_num(R)) - 1) < 0.01)
        q = Rotation.from_matrix(np.where(there[:, None, None], R, np.eye(3))).as_quat()
        bodies[name] = np.concatenate([q * there[:, None], 1e-3 * own[:, :3]], axis=1)
    started = None
    with suppress(KeyError, ValueError, IndexError):
        started = datetime.strptime(header["TIME_STAMP"][0], "%Y-%m-%d, %H:%M:%S.%f")
    rate_hz = float(header.get("FREQUENCY", ["nan"])[0])
    return Motion(path.stem, started, rate_hz, table[:, 0], bodies, lines)


def _motion_of(table: Table) -> Motion:
    """Return the bodies of a table."""
    bodies, remarks, times = bodies_of(table), list(table.remarks), table.times
    if times is None or len(times) < 2:
        expected = "there in two rows or more: a column time_s, or a file of Motive, Vicon or Qualisys"
        raise bad_input("times", table.owner, expected, "none" if times is None else "one row")
    for name, poses in bodies.items():
        _clear_lost(poses, f"body {name} in {table.owner}", table.lines, remarks)
    rate_hz = 1 / float(np.median(np.diff(times)))
    return Motion(Path(table.owner).stem, None, rate_hz, times, bodies, table.lines, tuple(remarks))


def _clear_lost(poses: Array, owner: str, lines: Sequence[int], remarks: list[str]) -> None:
    """Make frames NaN in which a body was lost or frozen; refuse what is no orientation."""
    q, p = poses[:, :4], poses[:, 4:]
    markers = bool(np.isnan(q).all())
    size = np.ones(len(q)) if markers else np.linalg.norm(q, axis=1)
    lost = ~np.isfinite(p).all(axis=1) | ~np.isfinite(size) | (size == 0)
    off = np.abs(size[~lost] - 1).max(initial=0)
    name, _, file = owner.rpartition(" in ")
    require(off < 0.01, f"quaternions of {name}", file, "unit within 0.01", f"an error of {off:.3g}")
    origin = (p == 0).all(axis=1) & (markers | (np.abs(q[:, 3]) == 1))
    away = np.linalg.norm(p[~origin & ~lost], axis=1)
    if len(away) and np.median(away) > _ORIGIN:  # else the body may be there
        lost |= origin
    poses[lost] = np.nan
    _say(lost, f"Frames of {owner} without a pose", lines, remarks)
    _clear_frozen(poses, p, f"Frames of {owner}", lines, remarks)


def _clear_frozen(values: Array, place: Array, what: str, lines: Sequence[int], remarks: list[str]) -> None:
    """Make rows NaN that only repeat the one before, many times, until they jump: what rests goes on slowly."""
    seen = np.flatnonzero(np.isfinite(place).all(axis=1))
    if len(seen) == 0:
        return
    rows, x = np.nan_to_num(values[seen]), place[seen] / np.maximum(np.nanstd(place, axis=0), 1e-12)
    last = np.flatnonzero(
        (rows[1:] != rows[:-1]).any(axis=1)
    )  # of each run of equal rows, but the one at the end
    step, length = np.linalg.norm(x[last + 1] - x[last], axis=1), np.diff(last, prepend=-1)
    frozen = np.zeros(len(values), dtype=bool)
    for k in np.flatnonzero(length > _FROZEN):
        if step[k] > _JUMP_STEPS * np.median(step):
            frozen[seen[last[k] - length[k] + 2 : last[k] + 1]] = True
    values[frozen] = np.nan
    what += f" left out, which only repeat the one before, more than {_FROZEN} in a row"
    _say(frozen, what, lines, remarks)


def _say(rows: Array, what: str, lines: Sequence[int], remarks: list[str]) -> None:
    """Add a remark on some rows: how many they are, and where."""
    at = np.flatnonzero(rows)
    if len(at):
        parts = np.split(at, np.flatnonzero(np.diff(at) > 1) + 1)
        words = [f"{lines[x[0]]} to {lines[x[-1]]}" if len(x) > 1 else f"{lines[x[0]]}" for x in parts[:4]]
        more = ", and so on" if len(parts) > 4 else ""
        where = f"line{'s' * (len(at) > 1)} {', '.join(words)}{more}"
        remarks.append(f"{what}: {len(at)} of {len(rows)} ({where}).")


class Poses(NamedTuple):
    """Measured configurations."""

    times: Array | None
    """Of the rows [s]; None if they have none."""
    q: Array
    """Configurations ``[t, n_q]`` [m, rad]; NaN where the pose is not known."""
    lines: Sequence[int]
    """Where the rows stand in the file."""
    remarks: tuple[str, ...]
    """What was left out."""
    windows: Array | None = None
    """When rows start and end ``[t, 2]`` [s], if they say so."""
    clock: str = ""
    """By which clock: that of the readings, or ``board_`` or ``unix_``."""
    turned: Mapping[int, Array] = MappingProxyType({})
    """Configurations ``[t, n_q]`` that fit as well, by the angle of the base about the straight robot [deg]."""


def read_poses(
    robot: Assembly,
    path: object,
    *,
    bodies: Sequence[str] = (),
    straight_s: float = 0.0,
    covariance: ArrayLike | None = None,
) -> Poses:
    """Read measured poses of a robot: from its coordinates, or from bodies on the ends of its segments.

    Coordinates are columns with a unit (``delta_x_1_mm, delta_y_1_mm``), with ``time_s``, or ``start_s`` and
    ``end_s``, or neither. Held poses may also start and end by other clocks: ``start_board_s`` and ``end_board_s``,
    or ``start_unix_s`` and ``end_unix_s``. Bodies are those of :func:`read_motion`; z points along the straight robot
    to its tip, but for Motive, where y does. Rows that cannot be right are NaN and told.

    Parameters
    ----------
    robot
        The robot.
    path
        The file, or a data frame.
    bodies
        Names of the bodies from base to tip, one on the end of every segment; with one more, the first is on the
        base. All bodies of the file, in their order, if not given.
    straight_s
        The robot is straight and unstretched for the first so many seconds: shifts and turns of bodies against the
        ends of the segments are taken from there [s], and along which axes the robot points. With 0 there are none.
    covariance
        Covariance of a measured configuration ``[n_q, n_q]``, by which it may be outside the bounds; a tenth of their
        width if not given.

    Raises
    ------
    InputError
        If the file has no poses of this robot, or most of them are outside its bounds.
    """
    require(0 <= straight_s < math.inf, "straight_s", "read_poses", "0 or above", straight_s)
    if isinstance(path, str | Path) and Path(path).is_file() and _is_export(text_of(Path(path), [])):
        return _fitted(robot, read_motion(path), Path(path).name, bodies, straight_s, covariance)
    table = read_table(path)
    if not set(robot.coordinates) & set(table.names):
        return _fitted(robot, _motion_of(table), table.owner, bodies, straight_s, covariance)
    given = "coordinates of the robot, and bodies or a straight start beside them"
    require(not (straight_s or bodies), "poses", table.owner, "bodies", given)
    q, times, remarks = configurations_of(robot, table), table.times, list(table.remarks)
    clocks = [x for x in ("unix_", "board_", "") if {f"start_{x}s", f"end_{x}s"} <= {*table.names}]
    windows, clock = None, "".join(clocks[:1])
    if clocks:
        ends = [table.scaled(f"{end}_{clock}s")[0] for end in ("start", "end")]
        windows, times = np.stack(ends, axis=1), np.mean(ends, axis=0)
    elif times is not None and len(times) > 1 and np.median(np.diff(times)) < _FRAME_S:
        zero = np.asarray((q == 0).all(axis=1))
        if robot.n_q > 1 and zero.mean() < 0.5:
            q[zero] = np.nan
        _clear_frozen(q, q, f"Rows of {table.owner}", table.lines, remarks)
    _say(np.asarray(np.isnan(q).any(axis=1)), f"Rows of {table.owner} without a pose", table.lines, remarks)
    _clear_outside(robot, q, table.owner, table.lines, remarks, covariance, "(units, axes, bounds?)")
    return Poses(times, q, table.lines, tuple(remarks), windows, clock)


def _clear_outside(
    robot: Assembly,
    q: Array,
    owner: str,
    lines: Sequence[int],
    remarks: list[str],
    covariance: ArrayLike | None,
    hint: str,
) -> None:
    """Make poses NaN that are outside the robot's bounds; refuse some that are far, or most of them."""
    if robot.lower is None or robot.upper is None:
        return
    width = robot.upper - robot.lower
    free = robot.fixed | robot.free_angles.free  # nobody measures a fixed one exactly
    slack = np.where(free, np.inf, _SLACK * width + 1e-9)
    far = (q < robot.lower - slack) | (q > robot.upper + slack)
    out = far if covariance is None else far | outside(robot, q, covariance)
    rows, c = np.asarray(out.any(axis=1)), int(out.sum(axis=0).argmax())
    name, many = robot.coordinates[c], far.any(axis=1).sum() > max(1, _OUTSIDE * len(q))
    _, unit, factor = robot.units[c]
    bounds = f"{factor * robot.lower[c]:.4g} to {factor * robot.upper[c]:.4g} {unit}"
    if many or rows.sum() > max(1, len(q) / 2):
        received = (
            f"{factor * np.nanmin(q[:, c]):.4g} to {factor * np.nanmax(q[:, c]):.4g} {unit}, "
            f"{rows.sum()} of {len(q)} poses outside"
        )
        raise bad_input(name, owner, f"within the robot's bounds, {bounds} {hint}", received)
    q[rows] = np.nan
    _say(rows, f"Poses of {owner} left out, outside the robot's bounds, for {name} {bounds}", lines, remarks)


def _at_rest(
    T: Array, times: Array, straight_s: float, names: Sequence[str], length: float, owner: str
) -> Array:
    """Return the mean pose of every body ``[n, 4, 4]`` in the first seconds, in which it must be still."""
    rest = np.tile(np.eye(4), (T.shape[1], 1, 1))
    still = f"so short that the bodies are still for the first {straight_s:g} s"
    for k, name in enumerate(names):
        own = T[(times < times[0] + straight_s) & np.isfinite(T[:, k, 0]).all(axis=1), k]
        require(len(own), "bodies", owner, f"seen in the first {straight_s:g} s", f"no pose of {name}")
        rest[k, :3, :3] = Rotation.from_matrix(own[:, :3, :3]).mean().as_matrix()
        rest[k, :3, 3] = own[:, :3, 3].mean(axis=0)
        away = float(np.median(np.linalg.norm(own[:, :3, 3] - rest[k, :3, 3], axis=1)))
        moves = f"{name} that is {1e3 * away:.3g} mm from its mean place"
        require(away <= _STILL * max(length, 0.05), "straight_s", owner, still, moves)
    return rest


def _straightened(robot: Assembly, T: Array, rest: Array) -> tuple[dict[int, Array], Array]:
    """Return poses of the ends of segments, straight at rest, and the rotation of the base.

    The base has its axes along those of the capture, in whichever of 24 ways fits the robot best, or leans from them
    to the line of the bodies at rest. It is at the origin, or where the last end is at rest by its length away. Ways
    that fit alike are turns about the straight robot [deg]: only readings tell them apart.
    """
    straight = robot.poses(np.zeros(robot.n_q), places_of(robot, None, len(rest), "read_poses"))
    tip, moves, seen = rest[-1, :3, 3], T @ np.linalg.inv(rest), np.isfinite(T[:, :, 0, 3]).any(axis=1)
    shown = np.flatnonzero(seen)[np.linspace(0, seen.sum() - 1, _SHOWN).astype(int)]
    ways = sorted(Rotation.create_group("O").as_matrix(), key=lambda R: (-round(R[0, 0]), -round(R.trace())))
    line = tip - rest[0, :3, 3] * (len(rest) > 1)
    line = line / np.linalg.norm(line).clip(1e-12)
    leaning = [R for R in ways if R[:, 2] @ line > 0.57]
    ways += [
        Rotation.from_quat([*np.cross(R[:, 2], line), 1 + R[:, 2] @ line]).as_matrix() @ R for R in leaning
    ]
    bases = np.tile(np.eye(4), (2, len(ways), 1, 1))
    bases[..., :3, :3] = ways
    bases[1, :, :3, 3] = tip - bases[1, :, :3, :3] @ straight[-1, :3, 3]
    bases = bases[int(np.linalg.norm(tip) > 1.5 * robot.length) :].reshape(-1, 4, 4)
    misfits = []
    for base in bases:
        fit = fit_shape(robot, np.linalg.inv(base) @ moves[shown] @ base @ straight, leave_out=False)
        beyond = outside(robot, fit.q).any(axis=1).mean()
        misfits.append(np.sqrt(np.nanmedian(np.square(fit.residual))) + robot.length * beyond)
    good = bases[np.array(misfits) <= 1.1 * min(misfits) + _EQUAL]
    ways = dict[int, Array]()
    for base in good[::-1]:
        R = good[0, :3, :3].T @ base[:3, :3]
        if R[2, 2] > 1 - 1e-9:
            angle = round(math.degrees(math.atan2(R[1, 0], R[0, 0])))
            ways[angle] = np.linalg.inv(base) @ moves @ base @ straight
    return ways, good[0, :3, :3]


def _fitted(
    robot: Assembly,
    motion: Motion,
    owner: str,
    bodies: Sequence[str],
    straight_s: float,
    covariance: ArrayLike | None,
) -> Poses:
    """Return the configurations that fit bodies best."""
    names, T = _bodies_on_ends(robot, motion, owner, bodies)
    ways, remarks = {0: T}, list(motion.remarks)
    if straight_s > 0:
        ways, R = _straightened(robot, T, _at_rest(T, motion.times, straight_s, names, robot.length, owner))
        T = ways[0]
        axes = R[[0, 2, 1]] * [[1], [1], [-1]] if motion.up == "y" else R
        largest = np.abs(axes).argmax(axis=0)
        x, _, z = ("-+"[int(own[k] > 0)] + "xyz"[k] for own, k in zip(axes.T, largest, strict=True))
        said = f"the straight robot points along {z}, and x of its base along {x}."
        remarks.append(f"By the axes of {owner}, {said}")
    require(np.isfinite(T[:, :, 0, 3]).any(), "poses", owner, "seen in some frame", "none")

    try:
        shapes = fit_shape(robot, T, times=motion.times, leave_out=False)
    except InputError as error:
        raise InputError(f"{owner}: {error}") from error
    q, miss = shapes.q.copy(), shapes.residual
    typical, most = float(np.sqrt(np.nanmedian(miss**2))), _MISFIT * robot.length
    remarks.append(f"The robot's kinematics miss the poses of {owner} by {1e3 * typical:.2f} mm (median).")
    hint = (
        f"with {motion.up} along the straight robot (units, bounds, order of bodies or of quaternions, axes? "
    )
    hint += "A straight start tells the axes: --straight-s)"
    received = f"poses {1e3 * typical:.3g} mm from the nearest shape"
    require(typical < most, "poses", owner, f"those that the robot can take, {hint}", received)
    _check_turns(shapes.residuals[..., 3:], names, owner)

    far = miss > most
    q[far] = np.nan
    _say(far, f"Poses of {owner} left out, which the robot cannot take", motion.lines, remarks)
    _clear_outside(robot, q, owner, motion.lines, remarks, covariance, hint)
    turned = {angle: fit_shape(robot, x, leave_out=False).q for angle, x in ways.items() if angle}
    return Poses(motion.times, q, motion.lines, tuple(remarks), turned=turned)


def _bodies_on_ends(
    robot: Assembly, motion: Motion, owner: str, bodies: Sequence[str]
) -> tuple[list[str], Array]:
    """Return the names of the bodies on the ends of the segments, and their poses ``[t, n, 4, 4]``, z up."""
    n, there = len(robot.segments), list(motion.bodies)
    short = {name.rpartition(":")[2]: name for name in there}  # Vicon: subject:segment
    names = [short.get(name, name) for name in bodies] or there
    known = len(names) in (n, n + 1) and len({*names}) == len(names) and {*names} <= {*there}
    expected = f"one on the end of each of {n} segments, from base to tip, or {n + 1} with the base first"
    expected += f" (the file has {', '.join(there)})"
    require(known, "bodies", owner, expected, ", ".join(names) or "none")
    poses = np.stack([motion.bodies[name] for name in names], axis=1)[..., POSITION_FIRST]
    if motion.up == "y":
        poses = poses[..., [0, 2, 1, 3, 5, 4, 6]] * [1, -1, 1, 1, -1, 1, 1]
    T = measured_poses(poses, owner)
    return names[-n:], np.linalg.inv(T[:, :1]) @ T[:, 1:] if len(names) > n else T


def _check_turns(turns: Array, names: Sequence[str], owner: str) -> None:
    """Refuse bodies whose axes are mostly turned against the ends of the segments ``[t, n, 3]`` [rad]."""
    for name, own in zip(names, np.swapaxes(turns, 0, 1), strict=True):
        sizes = np.linalg.norm(own[np.isfinite(own[:, 0])], axis=-1)
        turned = float(np.median(sizes)) if len(sizes) else 0.0
        expected = "turned as the end of its segment (a straight start takes its own turn away: --straight-s)"
        received = f"turned against it by {math.degrees(turned):.0f} deg"
        require(turned < _TURNED, f"body {name}", owner, expected, received)


JUMP, HALF_TURN, ALIKE, REST = np.radians([90.0, 170.0, 15.0, 5.0])
"""Turns [rad]: from frame to frame that no body makes; least turn of exchanged markers; largest one between exchanges
that count as equal, and at the ends of a stretch that was turned back."""


def undo_exchanges(quaternions: ArrayLike) -> tuple[Array, Array]:
    """Turn a rigid body back in the frames in which motion capture took its markers for each other.

    Markers that lie nearly symmetrically are now and then exchanged. The body is then seen turned by a half turn in
    its own axes, always the same one, from one frame to the next, and back again later. The jumps themselves tell the
    half turn, if there are two of them or more. A stretch of turned frames is turned back if that joins it to its
    neighbours within 5 degrees. The first frame counts as right.

    Parameters
    ----------
    quaternions
        Orientations X, Y, Z, W of the body ``[t, 4]``, NaN where it is lost.

    Returns
    -------
    tuple
        The orientations, NaN also where the body is turned and cannot be turned back; and which frames were turned
        back.

    Raises
    ------
    InputError
        If there is no orientation.

    Examples
    --------
    A body that stands still, with a half turn about x in three frames:

    >>> seen = np.tile([0.0, 0.0, 0.0, 1.0], (8, 1))
    >>> seen[[2, 5, 6]] = [1.0, 0.0, 0.0, 0.0]
    >>> found, undone = undo_exchanges(seen)
    >>> np.abs(found @ [0.0, 0.0, 0.0, 1.0]), np.flatnonzero(undone)
    (array([1., 1., 1., 1., 1., 1., 1., 1.]), array([2, 5, 6]))
    """
    rows = numbers(quaternions, "quaternions", "undo_exchanges", (None, 4), finite=False)
    there = np.flatnonzero(np.isfinite(rows).all(axis=1))
    expected = "there in one frame or more"
    require(len(there), "quaternions", "undo_exchanges", expected, f"{len(rows)} lost frames")
    q, n = rows[there], len(there)
    seen: Any = Rotation.from_quat(q)
    right, last = np.ones(n, dtype=bool), q[0]
    for k, x in enumerate(q):
        right[k] = abs(x @ last) > np.cos(JUMP / 2)  # q and -q are one rotation
        last = x if right[k] else last
    edge, steps = right[1:] != right[:-1], (seen[:-1].inv() * seen[1:]).magnitude()
    k = np.flatnonzero(edge)
    jumps = seen[np.where(right[k], k, k + 1)].inv() * seen[np.where(right[k], k + 1, k)]
    turns, left = [], jumps[jumps.magnitude() > HALF_TURN]
    while len(left):
        alike = (left[0].inv() * left).magnitude() < ALIKE
        if alike.sum() > 1:  # seen once, nothing says that it is always the same
            turns.append(left[alike].mean())
        left = left[~alike]
    undone = np.zeros(n, dtype=bool)
    for a, b in pairwise([0, *np.flatnonzero(edge | (steps > JUMP)) + 1, n]):
        least = REST
        for turn in () if right[a] else turns:
            back = seen[a:b] * turn.inv()
            for inner, outer in ((0, a - 1), (-1, b)):
                if outer < n and (right | undone)[outer]:
                    rest = (Rotation.from_quat(q[outer]).inv() * back[inner]).magnitude()
                    if rest < least:
                        least, q[a:b], undone[a:b] = rest, back.as_quat(), True
    q[~right & ~undone] = np.nan
    found, which = np.full(rows.shape, np.nan), np.zeros(len(rows), dtype=bool)
    found[there], which[there] = q, undone
    return found, which
