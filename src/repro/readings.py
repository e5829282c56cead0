"""Readings of a robot, its configurations, and poses of bodies, from the columns of tables."""

from __future__ import annotations

import math
import re
from collections import Counter
from collections.abc import Iterable, Mapping
from itertools import chain
from typing import Any, NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from repro.common import Array, InputError, bad_input, require
from repro.lines import TO_MT
from repro.parts import Assembly, Imu, Sensor
from repro.tables import Table, note_count, read_table


class Readings(np.ndarray):
    """Readings ``[t, s]``.

    ``times`` are those of their rows [s], or None; ``lines`` say where they stand; ``remarks`` what is missing.
    Copies, parts and what is computed of every reading keep them. ``without_times`` says that it is not known any
    more which times the rows have, as when several readings are put together.
    """

    times: Array | None = None
    lines: Any = None
    remarks: tuple[str, ...] = ()
    without_times: bool = False

    def __array_finalize__(self, source: Array | None) -> None:
        """Take what is known of the rows of an array of the same shape."""
        if isinstance(source, Readings) and source.shape == self.shape:
            self.__dict__.update(source.__dict__)
        elif isinstance(source, Readings):
            self.without_times = source.without_times or source.times is not None

    def __getitem__(self, key: Any) -> Any:
        """Return a part; rows keep their times and lines."""
        found = super().__getitem__(key)
        if isinstance(found, Readings) and found.ndim == self.ndim > 1:
            rows = key[0] if isinstance(key, tuple) and key else key
            own = [None if x is None else x[rows] for x in (self.times, self.lines)]
            if all(x is None or x.shape == found.shape[:1] for x in own):
                (found.times, found.lines), found.without_times = own, self.without_times
        return found

    def __array_function__(
        self, func: Any, types: Iterable[type], args: Iterable[object], kwargs: Mapping[str, object]
    ) -> Any:
        """Let ``numpy.where``, ``numpy.concatenate`` and others return readings, too."""
        found = super().__array_function__(func, types, args, kwargs)
        if type(found) is np.ndarray and found.ndim > 1:
            found = found.view(Readings)
            found.__array_finalize__(self)
        return found

    def __reduce__(self) -> tuple[object, ...]:
        """Return what is pickled."""
        return _readings, (np.asarray(self), vars(self))


def _readings(values: Array, facts: Mapping[str, object]) -> Readings:
    """Return readings of which facts are known."""
    found = values.view(Readings)
    found.__dict__.update(facts)
    return found


class Columns(NamedTuple):
    """Which columns of a table have the magnetic readings of a robot, their factors to mT, and the quaternions."""

    magnetic: list[int]
    factors: Array
    quaternions: list[list[int]]


def read_readings(robot: Assembly, source: Any) -> Readings:
    """Return the readings of a table ``[t, s]`` for a robot: see :meth:`repro.Robot.readings`."""
    table = read_table(source)
    remarks, infinite = list(table.remarks), np.isinf(table.values)  # those of a recording may be
    note_count(int(infinite.sum()), infinite.size, f"numbers of {table.owner}", "missing: infinite", remarks)
    n = sum(sensor.axes for sensor in robot.sensors)
    if not robot.imus and len(table.columns) == n == table.unnamed:
        table, words = taken_in_order(robot, table, n)
        remarks += words
    columns = columns_of(robot, table, remarks)
    check_orientations(robot, columns, table)
    u, why = rows_of(robot, columns, table.values)
    remarks += losses(robot, why)
    facts = {"times": table.times, "lines": np.asarray(table.lines), "remarks": tuple(remarks)}
    return _readings(u, facts)


def taken_in_order(robot: Assembly, table: Table, n: int) -> tuple[Table, list[str]]:
    """Return a table whose first n columns mean channels, or readings in their order, and the words for it.

    So it is where its own names mean no channel of the robot.
    """
    own, rest, words = table.names[:n], table.names[n:], list[str]()
    for other in (tuple(f"u{k + 1}" for k in range(n)), tuple(robot.names[:n])):
        try:
            columns_of(robot, table, [])
            break
        except InputError:
            table = table._replace(columns=(*other, *rest), names=(*other, *rest))
            said = f"{', '.join(own)} are taken for {', '.join(other)}, in this order."
            words = [said] if own != other else []
    return table, words


def columns_of(robot: Assembly, table: Table, remarks: list[str]) -> Columns:
    """Return where the readings of a robot stand; refuse a table without one of them, or with one of them twice."""
    axes = [(sensor, k) for sensor in robot.sensors for k in range(sensor.axes)]
    unnamed = table.unnamed
    counts = unnamed and (unnamed < len(table.columns) or not robot.imus)
    expected = f"{len(axes)} columns, one for every reading (a line of names above them says which is which)"
    require(not counts or unnamed == len(axes), "table", table.owner, expected, f"{unnamed}")
    used, factors, bare, quaternions = [], [], [], []
    for j, (sensor, axis) in enumerate(axes):
        channel = j + 1 if sensor.channels is None else sensor.channels[axis]
        used.append(table.column_of(channel, robot.names[j]))
        factors.append(_factor(table, used[-1], sensor))
        bare += [table.names[used[-1]]] if not table.units[used[-1]] and sensor.unit == "mT" else []
    if bare:
        remarks.append(f"Columns without a unit are taken as mT: {', '.join(bare)}.")
    for k, imu in enumerate(robot.imus, 1):
        names = k if imu.channels is None else imu.channels
        if isinstance(names, int | float):
            names = [f"q{axis}_{names:g}" for axis in "xyzw"]
        quaternions.append([table.column_of(name, str(name)) for name in names])
    for column, times in Counter([*used, *chain.from_iterable(quaternions)]).items():
        received = f"{table.columns[column]} for {times} of them"
        require(times == 1, "channels", table.owner, "another column for every reading", received)
    return Columns(used, np.array(factors), quaternions)


def rows_of(robot: Assembly, columns: Columns, values: Array) -> tuple[Array, Array]:
    """Return the readings of rows ``[t, s]``, each by itself, and how many are there or missing for what reason.

    The counts ``[4, s]`` are in the order of :meth:`repro.Robot.missing`. Those of several blocks of rows add up.
    """
    with np.errstate(over="ignore"):
        parts = [values[:, columns.magnetic] * columns.factors]
    for imu, own in zip(robot.imus, columns.quaternions, strict=True):
        q, turns = values[:, own], np.full((len(values), 3), np.nan)
        _, there, off = _norms(q)
        if (good := there & ~off).any():
            turns[good] = (_world_of(imu).inv() * Rotation.from_quat(q[good])).as_rotvec()
        parts.append(turns)
    u = np.concatenate(parts, axis=1)
    why = robot.missing(u)
    u[why > 0] = np.nan
    return u, (why == np.arange(4)[:, None, None]).sum(1)


def losses(robot: Assembly, counts: Array) -> list[str]:
    """Return a sentence for each kind of reading that is missing, by counts ``[4, s]``."""
    found, of, n = [], int(counts[:, :1].sum()), sum(sensor.axes for sensor in robot.sensors)
    _, nothing, at_end, all_zero = counts.tolist()
    for name, lost, beyond in zip(robot.names[:n], nothing, at_end, strict=False):
        note_count(beyond, of, f"readings of {name}", "missing: at the end of its range", found)
        note_count(lost, of, f"readings of {name}", "missing", found)
    note_count(sum(all_zero[:1]), of, "rows", "missing: all readings are zero", found)
    for name, lost in zip(robot.part_names[len(robot.sensors) :], nothing[n::3], strict=True):
        note_count(lost, of, f"quaternions of {name}", "missing: empty, zero or not of norm 1", found)
    return found


def check_orientations(robot: Assembly, columns: Columns, table: Table) -> None:
    """Refuse quaternions that are none, or whose numbers seem to be in another order."""
    names = robot.part_names[len(robot.sensors) :]
    for k, (imu, own) in enumerate(zip(robot.imus, columns.quaternions, strict=True)):
        q, name = table.values[:, own], f"quaternions of {names[k]}"
        norm, there, off = _norms(q)
        if off.sum() > 0.01 * there.sum() + 2:
            typical, line = float(np.median(norm[off])), table.lines[int(off.argmax())]
            need = "divide raw counts by their scale" if typical > 2 else "with four decimals"
            need = f"of norm 1{':' if typical > 2 else ','} {need}"
            raise bad_input(name, table.owner, need, f"norms such as {typical:.5g}, from line {line}")
        good = q[there & ~off]
        if k or not len(good):
            continue
        drawn = robot.poses(np.zeros(robot.n_q), [imu.place])[0, :3, :3]
        seen = (_world_of(imu) * Rotation.from_matrix(drawn)).as_quat()
        as_read, other = (
            2 * math.acos(min(1.0, float(np.median(np.abs(order @ seen)))))
            for order in (good, good[:, [1, 2, 3, 0]])
        )
        if as_read > 2.8 and other < as_read / 2:
            expected = "in the order x, y, z, w, of an IMU that is mounted as the robot file says"
            received = f"turns by {math.degrees(as_read):.0f} deg, and {math.degrees(other):.0f} with w first"
            raise bad_input(name, table.owner, expected, received)


def _world_of(imu: Imu) -> Rotation:
    """Return how the base is turned in the world that the quaternions of an IMU refer to."""
    return Rotation.identity() if imu.world is None else Rotation.from_quat(imu.world)


def _factor(table: Table, column: int, sensor: Sensor) -> float:
    """Return what takes a column to mT."""
    unit = table.units[column]
    if unit in TO_MT:
        return TO_MT[unit]
    own = unit in ("", sensor.unit) or (unit, sensor.unit) == ("V", "mV")
    expected = "in mT or another unit of flux density"
    expected += "" if sensor.unit in TO_MT else f", or in {sensor.unit}"
    require(own, f"column {table.columns[column]}", table.owner, expected, unit)
    return (1e3 if unit == "V" else 1.0) / sensor.per_mt


def _norms(q: Array) -> tuple[Array, Array, Array]:
    """Return the norms of quaternions, which of them are there, and which of these are of another norm than 1."""
    norm = np.linalg.norm(q, axis=-1)
    there = np.isfinite(norm) & (norm > 0)
    return norm, there, there & (np.abs(norm - 1) > 2e-3)


def configurations_of(robot: Assembly, table: Table) -> Array:
    """Return the configurations ``[t, n_q]`` [m, rad] that the columns of a table state, NaN where one is missing."""
    q = np.zeros((len(table.values), robot.n_q)) + (0.0 if robot.lower is None else robot.lower)
    for c, name in enumerate(robot.coordinates):
        if name in table.names or not robot.fixed[c]:
            angle = robot.angles[c] or name.startswith("kappa")
            q[:, c], _ = table.scaled(name, ("rad", "deg") if angle else ("mm", "cm", "m"))
    return q


POSITION_FIRST = [4, 5, 6, 0, 1, 2, 3]
"""Order of the columns of a body with its position first, then its quaternion."""


def bodies_of(table: Table) -> dict[str, Array]:
    """Return the bodies of a table ``[t, 7]``, quaternion X, Y, Z, W and position [m]; markers have no quaternion.

    Body k has the columns ``x_k_mm, y_k_mm, z_k_mm`` (or ``_m``, ``_cm``) and the quaternion ``qx_k, qy_k, qz_k,
    qw_k``. Bodies are in the order of their numbers.

    Raises
    ------
    InputError
        If a column is missing.
    """
    found = sorted(
        {int(name.split("_")[1]) for name in table.names if re.fullmatch(r"q?[xyzw]_[0-9]+", name)}
    )
    require(found, "columns", table.owner, "x_1_mm, y_1_mm, z_1_mm and so on", ", ".join(table.columns))
    whole, bodies = any(name.startswith("qx_") for name in table.names), dict[str, Array]()
    for body in found:
        q = [
            table.scaled(f"q{axis}_{body}")[0] if whole else np.full(len(table.values), np.nan)
            for axis in "xyzw"
        ]
        p = [table.scaled(f"{axis}_{body}", ("mm", "cm", "m"))[0] for axis in "xyz"]
        bodies[str(body)] = np.stack([*q, *p], axis=1)
    return bodies
