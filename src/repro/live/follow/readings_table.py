"""Readings in a CSV, one column for each: which column is which channel is found by name, and never guessed."""

# pyright: reportArgumentType=false, reportCallIssue=false, reportAttributeAccessIssue=false

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pandas as pd

from repro.errors import bad_input
from repro.live.follow.robot_estimator import RobotEstimator
from repro.live.record.recording import channel_names
from repro.live.robot.robot_file import RobotFile
from repro.live.wire.csv_fields import name_and_unit, time_scale
from repro.live.wire.csv_text import WRAP, check_units
from repro.live.wire.frame import Frame

KNOWN = ("unix_s", "host_ns", "sequence", "stream", "device_us")
"""Columns beside times and readings that `repro export` writes."""
_NUMBERED = re.compile(r"(u|ch|channel|sensor)_?([1-9][0-9]*)", re.IGNORECASE)


def read_table(path: Path, estimator: RobotEstimator) -> tuple[list[tuple[int, Frame]], float, list[str]]:
    """Read a table of readings with a column of times.

    Parameters
    ----------
    path
        A CSV with a header. Times are in ``time_s``, ``time_ms`` or the like; ``device_us`` and ``stream`` are used
        where they are. A reading of channel 2 is in ``u2``, ``ch2``, ``channel_2``, under the name of the format
        (``y_counts``), or under the number of its sensor, ``sensor_2``; each with a unit behind it, as ``u2_mT`` or
        ``u2 [mT]``, or without. Of a board that sends ``csv``, labels of its own count in their order, as in its
        lines, if they are as many as its channels and no column is numbered. IMUs are in ``x``, ``y``, ``z``, ``w``
        with their ``stream``.
    estimator
        Whose robot sent the readings.

    Returns
    -------
    frames, start_s, notes
        Times [ns] and frames; the first time [s]; columns that are not used.

    Raises
    ------
    InputError
        If a column is missing, ambiguous or of another unit, or a time is missing or decreases.
    """
    robot = estimator.robot
    try:
        table = pd.read_csv(path, dtype=float, comment="#", skipinitialspace=True)
    except ValueError as error:
        raise bad_input(
            "table", path.name, "a CSV of numbers with a header, separated by commas", error
        ) from error
    names = [str(name).strip() for name in table]
    table.columns = names
    twice = [name for name in names if (plain := re.sub(r"\.[0-9]+$", "", name)) != name and plain in names]
    if twice:  # so a second column of one name is called
        raise bad_input(
            "columns", path.name, "of different names", f"{re.sub(r'[.][0-9]+$', '', twice[0])} twice"
        )
    if not len(table):
        raise bad_input("table", path.name, "at least one row", "none")
    time_column, time_s = _times(path.name, table)
    if estimator.positions:
        chosen: Sequence[str | None] = list("xyzw")
        if missing := [name for name in ("stream", *"xyzw") if name not in names]:
            raise bad_input("columns", path.name, "stream, x, y, z, w", f"none called {', '.join(missing)}")
    else:
        labels = [name for name in names if name not in (time_column, *KNOWN)]
        numbered = any(_NUMBERED.fullmatch(name_and_unit(name)[0]) for name in labels)
        if robot.format == "csv" and not numbered and len(labels) == robot.channels:
            check_units(labels, [name_and_unit(name)[1] for name in labels], robot.unit)
            chosen = labels
        else:
            chosen = _channels(path.name, names, robot)
    values = np.full((len(table), len(chosen)), np.nan)
    for k, name in enumerate(chosen):
        if name is not None:
            values[:, k] = table[name]
    stream = _whole(path.name, table, "stream", 1 << 16)
    device_us = _whole(path.name, table, "device_us", WRAP)
    unused = [name for name in names if name not in (time_column, *KNOWN, *chosen)]
    notes = [f"Columns of {path.name} that are not used: {', '.join(unused)}."] if unused else []
    arrival_ns = np.round(1e9 * (time_s - time_s[0])).astype(np.int64).tolist()
    rows = zip(arrival_ns, stream, device_us, values.tolist(), strict=True)
    frames = [(ns, Frame(number or 0, None, sent_us, tuple(row))) for ns, number, sent_us, row in rows]
    return frames, float(time_s[0]), notes


def _times(owner: str, table: pd.DataFrame) -> tuple[str, np.ndarray]:
    scales = {name: time_scale(*name_and_unit(name)) for name in table if name not in KNOWN}
    found = [name for name, scale in scales.items() if scale is not None]
    if len(found) != 1:
        received = f"{len(found)}: {', '.join(found)}" if found else f"none among {', '.join(table)}"
        raise bad_input("times", owner, "one column, such as time_s", received)
    name = found[0]
    scale = scales[name]
    if not scale:
        raise bad_input("times", owner, f"named with their unit, such as {name}_s or {name}_ms", name)
    time_s = table[name].to_numpy() * (1e-6 * scale)
    if not np.isfinite(time_s).all():
        row = int(np.flatnonzero(~np.isfinite(time_s))[0]) + 1
        raise bad_input(name, owner, "a number in every row", f"none in row {row}")
    if (np.diff(time_s) < 0).any():
        row = int(np.flatnonzero(np.diff(time_s) < 0)[0]) + 2
        raise bad_input(name, owner, "times that do not decrease", f"{table[name][row - 1]:g} in row {row}")
    if time_s[-1] - time_s[0] > 1e9:
        raise bad_input(name, owner, "within 30 years", f"{time_s[0]:g} to {time_s[-1]:g} s")
    return name, time_s


def _channels(owner: str, names: Sequence[str], robot: RobotFile) -> list[str | None]:
    """Return the column of every channel; none for channels that no sensor has."""
    found: dict[int, list[str]] = {k: [] for k in range(robot.channels)}
    own = channel_names(robot.format, robot.channels)
    for column in dict.fromkeys(names):
        name, unit = name_and_unit(column)
        numbered = _NUMBERED.fullmatch(name)
        if column in own:
            found[own.index(column)].append(column)
        elif numbered:
            k = int(numbered[2]) - 1
            if numbered[1].lower() == "sensor":
                k = robot.channel[k] if k < len(robot.channel) else robot.channels
            if k in found:
                found[k].append(column)
        else:
            continue
        if unit and robot.unit != "raw" and unit.lower() != robot.unit.lower():
            raise bad_input(f"column {column}", owner, f"in {robot.unit}, the unit of {robot.name}", unit)
    columns: list[str | None] = [None] * robot.channels
    for sensor, k in enumerate(robot.channel):
        if len(found[k]) != 1:
            expected = f"one column: {own[k]}, u{k + 1}_{robot.unit}, channel_{k + 1} or sensor_{sensor + 1}"
            received = (
                f"{', '.join(found[k])}: {len(found[k])}" if found[k] else f"none among {', '.join(names)}"
            )
            raise bad_input(f"channel {k + 1}", owner, expected, received)
        (columns[k],) = found[k]
    return columns


def _whole(owner: str, table: pd.DataFrame, name: str, end: int) -> list[int | None]:
    """Whole numbers of a column; none where it, or a number, is missing."""
    if name not in table:
        return [None] * len(table)
    column = table[name].to_numpy()
    wrong = ~np.isnan(column) & ~((column >= 0) & (column < end) & (column % 1 == 0))
    if wrong.any():
        row = int(np.flatnonzero(wrong)[0])
        raise bad_input(
            name, owner, f"whole numbers from 0 to {end - 1}", f"{column[row]:g} in row {row + 1}"
        )
    return [None if np.isnan(x) else int(x) for x in column]
