"""Tables of readings and poses: text files and data frames with names and units in their first line."""

from __future__ import annotations

import csv
import math
import re
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from repro.common import Array, bad_input, require
from repro.robot import Robot

_TO_MT = {"T": 1e3, "mT": 1.0, "uT": 1e-3, "nT": 1e-6, "G": 0.1, "gauss": 0.1, "mG": 1e-4}
_SECONDS = {"s": 1.0, "sec": 1.0, "seconds": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9, "min": 60.0}
_SI = {"mm": 1e-3, "cm": 1e-2, "m": 1.0, "deg": math.pi / 180, "rad": 1.0}
_OTHER = ("mV", "V", "raw", "counts")
_UNITS = {unit.lower(): unit for unit in (*_TO_MT, *_SI, *_OTHER)}
_TIMES = ("time", "t", "timestamp", "elapsed time", "elapsed", "zeit", "seconds", "millis", "micros")
_IN_BRACKETS = re.compile(r"(.*?)[ _]*[(\[] *(.*?) *[)\]]")
_NUMBERED = re.compile(r"(?:u|ch|channel|sensor)?[_ ]?([1-9][0-9]*)", re.IGNORECASE)
_EMPTY = ("", "nan", "na", "n/a", "null", "none", "-")


class Readings(np.ndarray):
    """Readings ``[t, s]`` with the times of their rows in ``times`` [s], or None; parts of its rows keep theirs."""

    times: Array | None = None

    def __getitem__(self, key: Any) -> Any:
        """Return rows, columns or numbers."""
        found = super().__getitem__(key)
        if isinstance(found, Readings) and self.times is not None and found.ndim == self.ndim:
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
    lines: tuple[int, ...]
    times: Array | None

    def where(self, row: int, column: int) -> str:
        """Return the place of a cell in words."""
        return f"{self.owner}, line {self.lines[row]}, column {self.columns[column]},"


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
    Lines that begin with ``#`` or ``%`` are comments. A line of units may follow that of the names. A first column
    without a name is an index and is left out.

    Parameters
    ----------
    source
        A data frame, or a path.

    Raises
    ------
    InputError
        If it is not a table, or a cell is no number; with the file and the line.
    """
    if hasattr(source, "columns") and hasattr(source, "to_numpy"):
        owner, header = "the table", [str(name) for name in source.columns]
        numeric = all(getattr(dtype, "kind", "O") in "fiu" for dtype in source.dtypes)
        rows: Any = source.to_numpy(dtype=float if numeric else object)
        lines = list(range(1, len(rows) + 1))
    else:
        path = isinstance(source, str | Path)
        require(path, "table", "read_table", "a data frame or a path", type(source).__name__)
        require(Path(source).is_file(), "table", "read_table", "a file that exists", source)
        owner = Path(source).name
        header, rows, lines = _cells(Path(source), owner)
    require(len(rows), "file", owner, "a line of names and lines of numbers", f"{len(rows)} lines of numbers")
    split = [name_and_unit(column) for column in header]
    if all(str(cell).strip().lower() in {*_UNITS, *_SECONDS} for cell in rows[0]):
        split = [(name, str(cell).strip()) for (name, _), cell in zip(split, rows[0], strict=True)]
        rows, lines = rows[1:], lines[1:]
    for k, name in enumerate(header):
        once = header.count(name) == 1 and f"{name}.1" not in header  # pandas renames the second of a name
        require(once or k == 0, f"column {name}", owner, "there once", "several of them")
    numeric = isinstance(rows, np.ndarray) and rows.dtype.kind == "f"
    values = rows.copy() if numeric else _numbers(rows, header, lines, owner)
    values[~np.isfinite(values)] = np.nan
    keep = [k for k, name in enumerate(header) if name.strip() or k]
    times = None
    for k in list(keep):
        name, unit = split[k]
        if name.lower() in _TIMES:
            usual = {"millis": "ms", "micros": "us"}.get(name.lower(), "s")
            require(
                (unit or usual) in _SECONDS, f"column {header[k]}", owner, "in s, ms, us, ns or min", unit
            )
            require(times is None, f"column {header[k]}", owner, "the only one of times", "another")
            times = values[:, k] * _SECONDS[unit or usual]
            bad = np.flatnonzero(~np.isfinite(times))
            require(
                not len(bad),
                f"column {header[k]}",
                owner,
                "times",
                f"none in line {[lines[i] for i in bad[:1]]}",
            )
            keep.remove(k)
    return Table(
        owner, tuple(header[k] for k in keep), tuple(split[k][0] for k in keep), tuple(split[k][1] for k in keep),
        values[:, keep], tuple(lines), times,
    )  # fmt: skip


def _cells(path: Path, owner: str) -> tuple[list[str], list[list[str]], list[int]]:
    """Return the names of the columns, the cells of the rows, and the lines of these."""
    content = path.read_bytes()
    try:
        text = content.decode("utf-16" if content[:2] in (b"\xff\xfe", b"\xfe\xff") else "utf-8-sig")
    except UnicodeDecodeError as error:
        raise bad_input("file", owner, "text in UTF-8", error) from error
    kept = [
        (k, line) for k, line in enumerate(text.splitlines(), start=1) if line.strip() and line[0] not in "#%"
    ]
    stated = kept[0][1][4:5] if kept and kept[0][1].lower().startswith("sep=") else ""
    kept = kept[1:] if stated else kept
    require(kept, "file", owner, "a table", "nothing")
    first = kept[0][1]
    separator = stated or next((mark for mark in "\t;" if mark in first), ",")
    rows = [
        row for _, row in zip(kept, csv.reader((line for _, line in kept), delimiter=separator), strict=False)
    ]
    header = [name.strip() for name in rows[0]]
    numeric = [name for name in header if name and _is_number(name.replace(",", "."))]
    if header and len(numeric) == len(header):
        header, rows, kept = [str(k) for k in range(1, len(header) + 1)], [[], *rows], [(0, ""), *kept]
    n = len(header) - (header[-1] == "")  # a separator at the end of every line
    for (line, _), row in zip(kept[1:], rows[1:], strict=True):
        if len(row) != n and not (len(row) == n + 1 and not row[-1].strip()):
            hint = (
                "; decimal commas need another separator, such as ;"
                if separator == "," and len(row) > n
                else ""
            )
            raise bad_input(f"line {line}", owner, f"of {n} cells, as the first line{hint}", f"{len(row)}")
    return header[:n], [row[:n] for row in rows[1:]], [line for line, _ in kept[1:]]


def _numbers(rows: Any, header: list[str], lines: list[int], owner: str) -> Array:
    """Return the numbers in all cells, NaN for those without one."""
    comma = not any("." in cell for row in rows for cell in row if isinstance(cell, str))
    values = np.empty((len(rows), len(header)))
    for k, row in enumerate(rows):
        c = -1
        try:
            for c, cell in enumerate(row):
                values[k, c] = _number(cell, comma)
        except (TypeError, ValueError) as error:
            where = f"{owner}, line {lines[k]}, column {header[c] or 'without a name'},"
            raise bad_input("cell", where, "a number", repr(row[c])) from error
    return values


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True


def _number(cell: Any, comma: bool) -> float:
    """Return the number in a cell, NaN if there is none."""
    if isinstance(cell, str):
        text = cell.strip()
        cell = math.nan if text.lower() in _EMPTY else text.replace(",", ".", 1) if comma else text
    elif cell is None or type(cell).__name__ in ("NAType", "NaTType"):
        cell = math.nan
    elif not isinstance(cell, int | float | np.number) or isinstance(cell, bool):
        raise TypeError  # dates and spans of time would be taken for numbers
    return float(cell)


def read_readings(robot: Robot, source: Any) -> Readings:
    """Return the readings of a table ``[t, s]`` for a robot: see :meth:`repro.Robot.readings`."""
    table = read_table(source)
    if table.names and all(
        name.isdigit() for name in table.names
    ):  # numbers alone say little of what they are
        n = robot.n_readings + len(robot.imus)
        expected = f"with names, or of {n} numbers"
        require(len(table.names) == n, "columns", table.owner, expected, f"{len(table.names)} without names")
    taken: set[int] = set()
    columns, count = [np.zeros((len(table.values), 0))], 0
    for k, sensor in enumerate(robot.sensors):
        for axis in range(sensor.axes):
            count += 1
            channel = sensor.channels[axis] if sensor.channels is not None else count
            own = robot.names[count - 1]
            column = _column(table, channel, own, k + 1 if sensor.axes == 1 else None)
            require(
                column not in taken, f"column {table.columns[column]}", table.owner, "of one sensor", "two"
            )
            taken.add(column)
            columns.append(table.values[:, [column]] * _factor(table, column, sensor.per_mt))
    for k, imu in enumerate(robot.imus):
        names = imu.channels
        if not isinstance(names, list | tuple):
            number = k + 1 if names is None else names
            names = [f"q{axis}_{number}" for axis in "xyzw"]
        q = np.stack([table.values[:, _column(table, name, name, None)] for name in names], axis=-1)
        columns.append(_rotation_vectors(table, q, imu.world))
    readings = np.concatenate(columns, axis=1).view(Readings)
    readings.times = table.times
    return readings


def _column(table: Table, channel: Any, own: str, sensor: int | None) -> int:
    """Return the column of a channel: by its name, or by its number, or by the number of its sensor."""
    found = []
    for k, name in enumerate(table.names):
        numbered = _NUMBERED.fullmatch(name)
        if isinstance(channel, str):
            fits = channel in (name, table.columns[k])
        else:
            by_sensor = name.lower().startswith("sensor")
            fits = numbered is not None and int(numbered[1]) == (sensor if by_sensor else channel)
        found += [k] if fits or own == name else []
    if len(found) != 1:
        wanted = channel if isinstance(channel, str) else f"u{channel}_mT, channel_{channel}, or {own}"
        near = [name for name in table.names if name.lower() == str(channel).lower()]
        words = f"one column for {own}: {wanted}" + (f" (is it {near[0]}?)" if near else "")
        received = [table.columns[k] for k in found] if found else f"none among {', '.join(table.columns)}"
        raise bad_input("columns", table.owner, words, received)
    return found[0]


def _factor(table: Table, column: int, per_mt: float) -> float:
    """Return what takes a column to mT."""
    unit = table.units[column]
    if unit in _TO_MT:
        return _TO_MT[unit]
    expected = (
        f"in mT or another unit of flux density{', or in that of the robot file' if per_mt != 1 else ''}"
    )
    right = unit == "" or (unit in _OTHER and per_mt != 1)
    require(right, f"column {table.columns[column]}", table.owner, expected, unit)
    return (1e3 if unit == "V" else 1.0) / per_mt


def _rotation_vectors(table: Table, q: Array, world: Any) -> Array:
    """Return rotation vectors ``[t, 3]`` of quaternions XYZW in the base frame, NaN for those of norm zero."""
    from scipy.spatial.transform import Rotation

    norm = np.linalg.norm(q, axis=-1)
    there = np.isfinite(norm) & (norm > 0)
    wrong = np.flatnonzero(there & (np.abs(norm - 1) > 0.02))
    if len(wrong):
        where = f"{table.owner}, line {table.lines[wrong[0]]},"
        raise bad_input("quaternion", where, "of norm 1 (raw counts?)", f"one of norm {norm[wrong[0]]:.4g}")
    turns = np.full((len(q), 3), np.nan)
    if there.any():
        base = Rotation.identity() if world is None else Rotation.from_quat(world).inv()
        turns[there] = (base * Rotation.from_quat(q[there])).as_rotvec()
    return turns


def read_configurations(robot: Robot, source: Any) -> tuple[Array, Array | None]:
    """Return measured configurations ``[t, n_q]`` [m, rad] of a table, and their times [s] or None.

    Columns are named after the coordinates, with a unit: ``delta_x_1_mm``, ``phi_2_deg``. Coordinates that the robot
    fixes may be left out.

    Raises
    ------
    InputError
        If a column is missing or in no unit, or a coordinate is outside of its bounds; with the file and the line.
    """
    table = read_table(source)
    q = np.zeros((len(table.values), robot.n_q))
    for c, name in enumerate(robot.coordinates):
        if name not in table.names and robot.fixed[c] and robot.lower is not None:
            q[:, c] = robot.lower[c]
            continue
        k = _column(table, name, name, None)
        angle = robot.angles[c] or name.startswith("kappa")
        allowed = ("rad", "deg") if angle else ("mm", "cm", "m")
        right = table.units[k] in allowed
        require(right, f"column {table.columns[k]}", table.owner, f"in {', '.join(allowed)}", table.units[k])
        q[:, c] = table.values[:, k] * _SI[table.units[k]]
        if robot.lower is not None and robot.upper is not None and not robot.angles[c]:
            low, high, slack = robot.lower[c], robot.upper[c], 0.01 * (robot.upper[c] - robot.lower[c]) + 1e-9
            for row in np.flatnonzero((q[:, c] < low - slack) | (q[:, c] > high + slack)):
                words = f"within its bounds, {low / _SI[table.units[k]]:g} to {high / _SI[table.units[k]]:g}"
                received = f"{table.values[row, k]:g} {table.units[k]}"
                raise bad_input("pose", table.where(int(row), k), words, received)
    return q, table.times


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
    bodies = sorted(name[2:] for name in table.names if re.fullmatch(r"x_[0-9]+", name))
    require(bodies, "columns", table.owner, "x_1_mm, y_1_mm, z_1_mm and so on", ", ".join(table.columns))
    whole = any(f"qx_{body}" in table.names for body in bodies)
    found = []
    for body in sorted(bodies, key=int):
        for axis in "xyz":
            k = _column(table, f"{axis}_{body}", f"{axis}_{body}", None)
            length = table.units[k] in ("mm", "cm", "m")
            require(length, f"column {table.columns[k]}", table.owner, "in mm, cm or m", table.units[k])
            found.append(table.values[:, k] * _SI[table.units[k]])
        names = [f"q{axis}_{body}" for axis in "xyzw"] if whole else []
        found += [table.values[:, _column(table, name, name, None)] for name in names]
    return np.stack(found, -1).reshape(len(table.values), len(bodies), -1), table.times
