"""Tables of readings and poses: text files and data frames with names and units in their first line."""

from __future__ import annotations

import csv
import math
import re
from collections.abc import Sequence
from difflib import get_close_matches
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from repro.common import Array, bad_input, require
from repro.robot import Robot, Sensor

_TO_MT = {"T": 1e3, "mT": 1.0, "uT": 1e-3, "nT": 1e-6, "G": 0.1, "gauss": 0.1, "mG": 1e-4}
_SECONDS = {"s": 1.0, "sec": 1.0, "seconds": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9, "min": 60.0}
_SI = {"mm": 1e-3, "cm": 1e-2, "m": 1.0, "deg": math.pi / 180, "rad": 1.0}
_UNITS = {unit.lower(): unit for unit in (*_TO_MT, *_SI, "mV", "V", "raw")} | {"counts": "raw"}
_TIMES = ("time", "t", "timestamp", "elapsed time", "elapsed", "zeit", "seconds", "millis", "micros")
_IN_BRACKETS = re.compile(r"(.*?)[ _]*[(\[] *(.*?) *[)\]]")
_EMPTY = ("", "nan", "na", "n/a", "null", "none", "-")


class Readings(np.ndarray):
    """Readings ``[t, s]`` with the times of their rows in ``times`` [s], or None."""

    times: Array | None = None

    def __getitem__(self, key: Any) -> Any:
        """Return a part; rows keep their times."""
        found = super().__getitem__(key)
        if self.times is not None and isinstance(found, Readings) and found.shape[1:] == self.shape[1:]:
            found.times = self.times[key[0] if isinstance(key, tuple) else key]
        return found


class Table(NamedTuple):
    """Numbers of a table, NaN where there is none, with the names and units of their columns.

    ``lines`` are the lines of a file, or the rows of a data frame from 1; times are in seconds.
    """

    owner: str
    columns: tuple[str, ...]
    names: tuple[str, ...]
    units: tuple[str, ...]
    values: Array
    lines: Sequence[int]
    times: Array | None

    def scaled(self, name: str, units: Sequence[str] = ("",)) -> tuple[Array, str]:
        """Return the column of a name in SI units, and its own unit; refuse other units than those named."""
        k = _column(self, name, name)
        unit, expected = self.units[k], " or ".join(units) or "no unit"
        require(unit in units, f"column {self.columns[k]}", self.owner, f"in {expected}", unit)
        return self.values[:, k] * _SI.get(unit, 1.0), unit


def name_and_unit(column: str) -> tuple[str, str]:
    """Split the name of a column from its unit.

    Examples
    --------
    >>> name_and_unit("Mag X (uT)"), name_and_unit("u1_mT"), name_and_unit("time_ms"), name_and_unit("x_1")
    (('Mag X', 'uT'), ('u1', 'mT'), ('time', 'ms'), ('x_1', ''))
    """
    text = column.strip().replace("µ", "u").replace("μ", "u")
    if found := _IN_BRACKETS.fullmatch(text):
        return found[1], _UNITS.get(found[2].lower(), found[2])
    name, _, unit = text.rpartition("_")
    if name and unit.lower() in _UNITS:
        return name, _UNITS[unit.lower()]
    return (name, unit) if name.lower() in _TIMES and unit.lower() in _SECONDS else (text, "")


def read_table(source: Any) -> Table:
    """Read a data frame, or a text file with the names of its columns in the first line.

    A file is in UTF-8 or UTF-16, separated by commas, semicolons or tabs; numbers have points, or commas throughout.
    Lines that begin with ``#`` or ``%`` are comments. A first column without a name is an index and is left out.

    Parameters
    ----------
    source
        A data frame, or a path.

    Raises
    ------
    InputError
        If it is not a table, or a cell is no number; with the file and the line.
    """
    if isinstance(source, str | Path):
        owner = Path(source).name
        require(Path(source).is_file(), "table", "read_table", "a file that exists", source)
        header, values, lines = _cells(Path(source).read_bytes(), owner)
    else:
        owner, kind = "the table", type(source).__name__
        require(hasattr(source, "infer_objects"), "table", "read_table", "a data frame or a path", kind)
        frame = source.infer_objects()
        header, lines = [str(name) for name in frame.columns], range(1, len(frame) + 1)
        for name, dtype in zip(header, frame.dtypes, strict=True):
            require(dtype.kind in "fiu", f"column {name}", owner, "of numbers", f"{dtype} values")
        values = frame.to_numpy(dtype=float, na_value=np.nan)
    require(len(values), "file", owner, "a line of names and lines of numbers", "0 lines of numbers")
    values = np.where(np.isfinite(values), values, np.nan)
    split = [name_and_unit(column) for column in header]
    clock = [k for k, (name, _) in enumerate(split) if name.lower() in _TIMES]
    times = None
    for k in clock:
        require(times is None, f"column {header[k]}", owner, "the only one of times", "another")
        unit = split[k][1] or {"millis": "ms", "micros": "us"}.get(split[k][0].lower(), "s")
        require(unit in _SECONDS, f"column {header[k]}", owner, "in s, ms, us, ns or min", unit)
        times = values[:, k] * _SECONDS[unit]
        bad = [lines[i] for i in np.flatnonzero(np.isnan(times))]
        require(not bad, f"column {header[k]}", owner, "times", f"none in line {bad[:1]}")
    keep = [k for k, name in enumerate(header) if k not in clock and (k or name.strip())]
    return Table(
        owner, tuple(header[k] for k in keep), tuple(split[k][0] for k in keep), tuple(split[k][1] for k in keep),
        values[:, keep], lines, times,
    )  # fmt: skip


def _cells(content: bytes, owner: str) -> tuple[list[str], Array, list[int]]:
    """Return the names of the columns, the numbers of the rows, NaN for cells without one, and their lines."""
    try:
        text = content.decode("utf-16" if content[:2] in (b"\xff\xfe", b"\xfe\xff") else "utf-8-sig")
    except UnicodeDecodeError as error:
        raise bad_input("file", owner, "text in UTF-8", error) from error
    numbered = enumerate(text.splitlines(), start=1)
    kept = [(k, line) for k, line in numbered if line.strip() and not line.startswith(("#", "%", "sep="))]
    require(kept, "file", owner, "a table", "nothing")
    separator = next((mark for mark in "\t;" if mark in kept[0][1]), ",")
    rows = [next(csv.reader([line], delimiter=separator)) for _, line in kept]
    header, lines = [name.strip() for name in rows[0]], [line for line, _ in kept[1:]]
    n = len(header) - (header[-1] == "")  # a separator at the end of every line
    comma = not any("." in line for _, line in kept[1:])
    values = np.full((len(lines), n), np.nan)
    for k, row in enumerate(rows[1:]):
        if len(row) < n or any(row[n:]):
            hint = "; decimal commas need another separator, such as ;" if len(row) > n else ""
            raise bad_input(f"line {lines[k]}", owner, f"of {n} cells, as the first line{hint}", len(row))
        for c, cell in enumerate(row[:n]):
            if cell.strip().lower() in _EMPTY:
                continue
            try:
                values[k, c] = float((cell.replace(",", ".", 1) if comma else cell).replace("_", "?"))
            except ValueError as error:
                where = f"{owner}, line {lines[k]}, column {header[c] or 'without a name'},"
                raise bad_input("cell", where, "a number", repr(cell)) from error
    return header[:n], values, lines


def read_readings(robot: Robot, source: Any) -> Readings:
    """Return the readings of a table ``[t, s]`` for a robot: see :meth:`repro.Robot.readings`."""
    table, used = read_table(source), []
    columns, axes = [np.zeros((len(table.values), 0))], [(x, k) for x in robot.sensors for k in range(x.axes)]
    for j, (sensor, axis) in enumerate(axes):
        channel = j + 1 if sensor.channels is None else sensor.channels[axis]
        used.append(_column(table, channel, robot.names[j]))
        columns.append(table.values[:, used[-1:]] * _factor(table, used[-1], sensor))
    for k, imu in enumerate(robot.imus):
        names = k + 1 if imu.channels is None else imu.channels
        if isinstance(names, int | float):
            names = [f"q{axis}_{names:g}" for axis in "xyzw"]
        used += (own := [_column(table, name, str(name)) for name in names])
        columns.append(_rotation_vectors(table, table.values[:, own], imu.world))
    for column in {k for k in used if used.count(k) > 1}:
        received = f"{table.columns[column]} for {used.count(column)} of them"
        raise bad_input("channels", table.owner, "another column for every reading", received)
    readings = np.concatenate(columns, axis=1).view(Readings)
    readings.times = table.times
    return readings


def _column(table: Table, channel: Any, own: str) -> int:
    """Return the column of a channel: by its name, or by its number, or by the name of its reading."""
    wanted = [channel] if isinstance(channel, str) else [f"u{channel}", f"ch{channel}", f"channel{channel}"]
    wanted = {own, own.replace(" ", ""), *wanted}
    spelt = [{name, re.sub("[ _]", "", name.lower())} for name in table.names]
    found = [k for k, names in enumerate(spelt) if wanted & {*names, table.columns[k]}]
    if len(found) != 1:
        words = channel if isinstance(channel, str) else f"u{channel}_mT, channel_{channel}, or {own}"
        low = {name.lower(): name for name in table.names}
        near = [low[name] for name in get_close_matches(str(channel).lower(), low, 1)]
        words = f"one column for {own}: {words}" + (f" (is it {near[0]}?)" if near else "")
        received = [table.columns[k] for k in found] if found else f"none among {', '.join(table.columns)}"
        raise bad_input("columns", table.owner, words, received)
    return found[0]


def _factor(table: Table, column: int, sensor: Sensor) -> float:
    """Return what takes a column to mT."""
    unit = table.units[column]
    if unit in _TO_MT:
        return _TO_MT[unit]
    expected = "in mT or another unit of flux density"
    expected += "" if sensor.unit in _TO_MT else f", or in {sensor.unit}"
    own = unit in ("", sensor.unit) or (unit, sensor.unit) == ("V", "mV")
    require(own, f"column {table.columns[column]}", table.owner, expected, unit)
    return (1e3 if unit == "V" else 1.0) / sensor.per_mt


def _rotation_vectors(table: Table, q: Array, world: Any) -> Array:
    """Return rotation vectors ``[t, 3]`` of quaternions XYZW in the base frame, NaN for those of norm zero."""
    from scipy.spatial.transform import Rotation

    norm = np.linalg.norm(q, axis=-1)
    there = np.isfinite(norm) & (norm > 0)
    for row in np.flatnonzero(there & (np.abs(norm - 1) > 0.02)):
        where = f"{table.owner}, line {table.lines[int(row)]},"
        raise bad_input("quaternion", where, "of norm 1 (raw counts?)", f"one of norm {norm[row]:.4g}")
    base = Rotation.identity() if world is None else Rotation.from_quat(world).inv()
    turns = np.full((len(q), 3), np.nan)
    turns[there] = (base * Rotation.from_quat(q[there])).as_rotvec()
    return turns


def read_configurations(robot: Robot, source: Any) -> tuple[Array, Array | None, list[str]]:
    """Return measured configurations ``[t, n_q]`` [m, rad] of a table, their times [s] or None, names of rows.

    Columns are named after the coordinates, with a unit: ``delta_x_1_mm``, ``phi_2_deg``. Coordinates that the robot
    fixes may be left out.

    Raises
    ------
    InputError
        If a column is missing or in no unit, or a number is missing; with the file and the line.
    """
    table = read_table(source)
    rows = [f"{table.owner}, line {line}" for line in table.lines]
    q = np.zeros((len(table.values), robot.n_q))
    for c, name in enumerate(robot.coordinates):
        if name not in table.names and robot.fixed[c] and robot.lower is not None:
            q[:, c] = robot.lower[c]
            continue
        angle = robot.angles[c] or name.startswith("kappa")
        q[:, c], _ = table.scaled(name, ("rad", "deg") if angle else ("mm", "cm", "m"))
        for row in np.flatnonzero(np.isnan(q[:, c])):
            raise bad_input("pose", f"{rows[row]},", f"a number for {name}", "none")
    return q, table.times, rows


def read_poses(source: Any) -> tuple[Array, Array | None]:
    """Return measured poses of bodies ``[t, n, 7]``, or of markers ``[t, n, 3]``, and their times [s] or None.

    Body k has the columns ``x_k_mm, y_k_mm, z_k_mm`` (or ``_m``, ``_cm``) and the quaternion ``qx_k, qy_k, qz_k,
    qw_k``; markers have no quaternion. Bodies are in the order of their numbers.

    Raises
    ------
    InputError
        If a column is missing.
    """
    table = read_table(source)
    bodies = sorted(
        {int(name.split("_")[1]) for name in table.names if re.fullmatch(r"q?[xyzw]_[0-9]+", name)}
    )
    require(bodies, "columns", table.owner, "x_1_mm, y_1_mm, z_1_mm and so on", ", ".join(table.columns))
    whole = any(f"qx_{body}" in table.names for body in bodies)
    found = []
    for body in bodies:
        found += [table.scaled(f"{axis}_{body}", ("mm", "cm", "m"))[0] for axis in "xyz"]
        found += [table.scaled(f"q{axis}_{body}")[0] for axis in "xyzw"] if whole else []
    return np.stack(found, -1).reshape(len(table.values), len(bodies), -1), table.times
