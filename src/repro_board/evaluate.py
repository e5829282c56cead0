"""Estimates against motion capture: its files, exchanged markers, and whether readings and poses are of one time."""

from __future__ import annotations

import csv
import re
from datetime import datetime
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from scipy.fft import next_fast_len
from scipy.spatial.transform import Rotation

from repro.common import Array, bad_input, numbers, require

LENGTH_UNITS = {"Millimeters": 1e-3, "Centimeters": 1e-2, "Meters": 1.0}
"""Units that Motive exports, in metres."""
POSE = [("Rotation", axis) for axis in "XYZW"] + [("Position", axis) for axis in "XYZ"]


class MotionCapture(NamedTuple):
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
    missing: int
    """Frames that the header announces and the file does not have."""


def read_motive(path: Path | str) -> MotionCapture:
    """Read rigid bodies from a CSV file of OptiTrack Motive.

    The file is an export with quaternions, format versions 1.20 to 1.29 (we know files of 1.21 and 1.23), in
    millimetres, centimetres or metres. In Motive the y axis points up, and the axes of a body are those of the world
    at the moment when the body is defined. Quaternions lead from the body to the world. A frame in which a body is
    lost has empty cells or a quaternion of zeros. Columns of single markers are left out.

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
    ...     take = read_motive(file)
    >>> take.name, take.rate_hz, list(take.bodies)
    ('tilt', 40.0, ['Tip'])
    >>> take.bodies["Tip"][:, 4:]
    array([[ 0.005,  0.11 , -0.003],
           [   nan,    nan,    nan],
           [ 0.005,  0.09 , -0.06 ]])
    """
    path = Path(path)
    owner = path.name
    try:
        with path.open(newline="", encoding="utf-8-sig") as stream:
            rows = list(csv.reader(stream))
    except (UnicodeDecodeError, csv.Error) as error:
        raise bad_input("content", owner, "a table in UTF-8", error) from error
    header = dict(zip(rows[0][::2], rows[0][1::2], strict=False)) if rows else {}
    version = header.get("Format Version", "nothing")
    require(re.fullmatch(r"1\.2\d", version), "Format Version", owner, "1.20 to 1.29", version)
    for key, known in {"Rotation Type": ("Quaternion",), "Length Units": tuple(LENGTH_UNITS)}.items():
        require(header.get(key) in known, key, owner, " or ".join(known), header.get(key, "nothing"))
    space = header.get("Coordinate Space", "Global")
    require(space == "Global", "Coordinate Space", owner, "Global", space)
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
    keys = {name: [(name, *key) for key in POSE] for name, kind, _ in columns if kind == "Rotation"}
    picked = {name: [columns.index(key) for key in own] for name, own in keys.items() if {*own} <= {*columns}}
    require(picked, "rigid bodies", owner, "there with rotation and position", "none")
    try:
        wanted = [1, *(k for own in picked.values() for k in own)]
        frames = [[float(row[k] or "nan") for k in wanted] for row in rows[axes + 1 :] if row]
    except (ValueError, IndexError) as error:
        raise bad_input("frames", owner, "rows of numbers", error) from error
    table = np.array(frames).reshape(-1, len(wanted))
    increasing = len(table) and np.all(np.diff(table[:, 0]) > 0)
    require(increasing, "times", owner, "increasing from frame to frame", "others, or no frame")
    poses = table[:, 1:].reshape(len(table), -1, 7).swapaxes(0, 1).copy()
    size = np.linalg.norm(poses[..., :4], axis=-1)
    poses[~np.isfinite(poses).all(axis=-1) | (size == 0)] = np.nan
    off = float(np.nanmax(np.abs(np.where(size == 0, np.nan, size) - 1), initial=0))
    require(off < 0.01, "quaternions", owner, "unit within 0.01", f"an error of {off:.3g}")
    poses[..., 4:] *= LENGTH_UNITS[header["Length Units"]]
    bodies = dict(zip(picked, poses, strict=True))
    take = header.get("Take Name", path.stem)
    return MotionCapture(take, started, rate_hz, table[:, 0], bodies, max(announced - len(table), 0))


JUMP, HALF_TURN, ALIKE, REST = np.radians([90.0, 170.0, 15.0, 5.0])
"""Turns [rad]: from frame to frame that no body makes; least turn of exchanged markers; largest one between exchanges
that count as equal, and at the ends of a stretch that was turned back."""


def undo_exchanges(quaternions: Any) -> tuple[Array, Array]:
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
    require(
        len(there), "quaternions", "undo_exchanges", "there in one frame or more", f"{len(rows)} lost frames"
    )
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


class Lag(NamedTuple):
    """How well readings follow a motion as they are put together, and at the best of all lags."""

    lag_s: float
    """By how much later the readings are to be taken for the least residual [s]."""
    residual: float
    """Root mean square of what the motion leaves of the readings as they are, in their unit."""
    best: float
    """The same at the best lag."""
    spread: float
    """Root mean square of the readings about their means."""


def search_lag(motion: Any, readings: Any, rate_hz: float) -> Lag:
    """Find the lag between readings and a motion, over the whole recording.

    The readings of an instant are a smooth function of the shape. So we fit them by a quadratic function of the
    motion at every lag of up to half the recording in either direction, each time over all frames that both have, and
    take the lag with the least residual. Sums over frames are products of Fourier transforms, so all lags together
    cost little more than one. A frame without a pose or with a missing reading counts nowhere.

    A motion that repeats itself without end has many lags that are equally good; then the smallest one is returned.

    Parameters
    ----------
    motion
        Coordinates ``[t, m]`` that motion capture gives, NaN where it is lost.
    readings
        Readings ``[t, s]`` of the same frames, if there is no lag; NaN where one is missing.
    rate_hz
        Frames per second.

    Raises
    ------
    InputError
        If there are not as many readings as poses, or less than two seconds of them.

    Examples
    --------
    Readings that were taken half a second too early:

    >>> t = np.arange(4000) / 40
    >>> q = np.stack([np.sin(t), np.sin(1.7 * t + 0.3)], axis=-1)
    >>> u = np.roll(q @ [[30.0, 5.0], [-8.0, 20.0]], 20, axis=0)
    >>> search_lag(q[20:], u[20:], rate_hz=40).lag_s
    0.5
    """
    owner = "search_lag"
    q, u = (
        numbers(motion, "motion", owner, (None, None), finite=False),
        numbers(readings, "readings", owner, (None, None), finite=False),
    )
    n = len(q)
    require(len(u) == n, "readings", owner, f"one row for each of {n} poses", f"{len(u)} rows")
    require(n >= 2 * rate_hz, "motion", owner, "two seconds long or more", f"{n / rate_hz:g} s")
    seen, read = (np.asarray(np.isfinite(x).all(axis=1)) for x in (q, u))
    for name, there in (("motion", seen), ("readings", read)):
        require(
            there.sum() > n / 2, name, owner, "there in most frames", f"{int((~there).sum())} of {n} missing"
        )
    x = ((q - q[seen].mean(axis=0)) / np.maximum(q[seen].std(axis=0), 1e-12)).T
    v = (u - u[read].mean(axis=0)).T
    x[:, ~seen], v[:, ~read] = 0.0, 0.0
    low, up = np.triu_indices(len(x))
    columns = np.vstack([seen, x, x[low] * x[up]])
    i, j = np.triu_indices(len(columns))
    size, lags = next_fast_len(2 * n, real=True), np.arange(-(n // 2), n // 2 + 1)
    of_read, of_v = np.fft.rfft(read, size), np.fft.rfft(v, size)

    def sums(series: Array, spectrum: Array) -> Array:
        """Sum over t of the series at t times readings at t + lag, for every lag."""
        return np.fft.irfft(np.fft.rfft(series, size).conj() * spectrum, size)[..., lags]

    k = len(columns)
    A, b = np.empty((k, k, len(lags))), sums(columns, of_v[:, None])
    A[i, j] = A[j, i] = sums(columns[i] * columns[j], of_read)
    total = sums(seen, np.fft.rfft((v**2).sum(axis=0), size))
    count = A[0, 0].copy()
    A[range(k), range(k)] += 1e-9 * count  # for a coordinate that hardly moves
    fitted = np.linalg.solve(np.moveaxis(A, -1, 0), np.moveaxis(b, -1, 0).swapaxes(1, 2))
    left = total - np.einsum("skl,lks->l", b, fitted)
    residual = np.sqrt(np.maximum(left, 0.0) / np.maximum(len(v) * count, 1.0))
    equal = np.flatnonzero(residual <= residual.min() * (1 + 1e-6))
    best = int(equal[np.argmin(np.abs(lags[equal]))])
    spread = float(np.sqrt((v[:, read] ** 2).mean()))
    return Lag(float(lags[best] / rate_hz), float(residual[n // 2]), float(residual[best]), spread)
