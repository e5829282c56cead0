"""A described robot in place of a board: what ``repro emulate --robot`` plays; synthetic."""

from __future__ import annotations

import math
import os
import threading
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import replace
from itertools import chain
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from edition1.errors import bad_input, require
from edition1.robot_file.load import load_robot
from edition1.robot_file.robot_file import RobotFile
from edition1_live.emulate.board import BLOCK, Reading
from edition1_live.emulate.hold_poses import (
    LOOK_AHEAD_S,
    Motion,
    held_by_hand,
    held_in_time,
    measured_poses,
    spread_poses,
    write_poses,
)
from edition1_live.emulate.robot_readings import RobotReadings, course, readings_along, true_robot
from edition1_live.emulate.sensor_faults import SensorFaults, with_sensor_faults
from edition1_live.wire.formats import encode
from edition1_live.wire.frame import Frame
from edition1_live.wire.text import HALL_RANGE, MILLIVOLT_RANGE

_PART_S = 0.5
"""Readings are made, and sent, for so long at once [s]."""
_RANGES = {"hall": HALL_RANGE, "millivolts": MILLIVOLT_RANGE}


class RobotBoard(NamedTuple):
    """What a board sends of a robot.

    Attributes
    ----------
    label, format
        What it is, and its wire format.
    notes
        Warnings.
    readings, block
        For :func:`edition1_live.emulate.board.passages`; rounded to what the format carries.
    """

    label: str
    format: str
    notes: tuple[str, ...]
    readings: Iterator[Reading]
    block: int = BLOCK


def open_board(
    path: Path,
    *,
    rate_hz: float | None = None,
    tolerances: float = 0.0,
    hold_poses: Path | None = None,
    hold_s: float | None = None,
    faults: SensorFaults | None = None,
    from_s: float = 0.0,
    seed: int = 0,
) -> RobotBoard:
    """Return what the board of a robot file sends: it moves, or is held in poses whose table is written.

    Parameters
    ----------
    path
        The robot file.
    rate_hz
        Rounds of readings per second; by default as in the file.
    tolerances, faults, from_s, seed
        As of :func:`robot_board`.
    hold_poses
        Hold the robot in poses, and write the table of these, as measured, to this new file.
    hold_s
        How long each is held [s]; by default until a line comes on the standard input.

    Raises
    ------
    InputError
        If the file is no robot, another file has the name of the table, or a number is out of range.
    """
    robot = load_robot(path)
    rate_hz = robot.rate_hz if rate_hz is None else rate_hz
    require(0 < rate_hz < math.inf, "rate", "repro emulate", "above zero [Hz]", rate_hz)
    frames = len(robot.imus) + bool(robot.channel)  # of a round
    block = max(1, round(_PART_S * rate_hz)) * frames
    options: dict[str, Any] = {"tolerances": tolerances, "faults": faults, "from_s": from_s, "seed": seed}
    if hold_poses is None:
        require(hold_s is None, "hold", "repro emulate", "left out without --hold-poses", hold_s)
        return robot_board(robot, moving(robot, rate_hz, seed=seed), **options)._replace(block=block)
    q = spread_poses(robot, seed=seed)
    measured = measured_poses(robot, q, seed=seed)
    if hold_s is not None:
        board = robot_board(robot, held_in_time(q, rate_hz, hold_s), **options)
        write_poses(hold_poses, robot, measured, hold_s=hold_s)
        return board._replace(block=block)

    def say(k: int) -> None:
        more = " Enter moves on to the next." if k + 1 < len(q) else " It is the last."
        print(f"Holding pose {k + 1} of {len(q)}.{more}", flush=True)

    board = robot_board(robot, held_by_hand(q, rate_hz, _enter_pressed(), say), **options)
    write_poses(hold_poses, robot, measured)
    return board._replace(block=max(1, round(LOOK_AHEAD_S * rate_hz)) * frames)


def robot_board(
    robot: RobotFile,
    motion: Motion,
    *,
    tolerances: float = 0.0,
    faults: SensorFaults | None = None,
    from_s: float = 0.0,
    seed: int = 0,
) -> RobotBoard:
    """Let a robot move, and return what its board sends.

    Lines of text carry what a converter does: values beyond its range are clipped to it.

    Parameters
    ----------
    robot
        As described.
    motion
        From :func:`moving`, or of :mod:`edition1_live.emulate.hold_poses`.
    tolerances, seed
        As of :func:`~edition1_live.emulate.robot_readings.true_robot`.
    faults, from_s
        As of :func:`~edition1_live.emulate.sensor_faults.with_sensor_faults`.

    Raises
    ------
    InputError
        If the robot cannot have these tolerances or faults, or its format cannot carry what its sensors read.
    """
    faults = faults or SensorFaults()
    faults.check(robot)
    if faults.nan and robot.format != "frames":
        raise bad_input("fault", robot.name, f"one that {robot.format} can carry", "nan")
    built = true_robot(robot, tolerances, seed=seed)
    parts = _parts(built, motion, faults, from_s, seed)
    first = next(parts)
    for reading in first.readings():  # now, not when somebody reads
        if reading.time_s > first.time_s[0]:
            break
        encode(robot.format, Frame(reading.stream, 0, 0, reading.values))
    label = f"{robot.name} by its networks," if robot.networks else f"{robot.name},"
    readings = (reading for part in chain([first], parts) for reading in part.readings())
    return RobotBoard(f"{label} SYNTHETIC", robot.format, (*robot.notes, *_clipped(built)), readings)


def moving(robot: RobotFile, rate_hz: float, *, seed: int = 0) -> Motion:
    """Move for ever, as :func:`~edition1_live.emulate.robot_readings.course` says."""
    size, first = max(1, round(_PART_S * rate_hz)), 0
    while True:
        time_s = np.arange(first, first + size) / rate_hz
        yield time_s, course(robot, time_s, seed=seed)
        first += size


def _parts(
    built: RobotFile, motion: Motion, faults: SensorFaults, from_s: float, seed: int
) -> Iterator[RobotReadings]:
    before = None
    for time_s, q in motion:
        rng = np.random.default_rng([seed, 2, round(1e6 * time_s[0])])
        part = readings_along(built, time_s, q, rng=rng)
        before = with_sensor_faults(part, faults, from_s=from_s, before=before, seed=seed)
        yield replace(before, values=carried(built.format, before.values))


def carried(format: str, values: np.ndarray) -> np.ndarray:
    """Return values as a format carries them: of single precision, or clipped and in steps."""
    if format == "frames":
        return values.astype(np.float32).astype(float)
    if format in _RANGES:
        values = np.clip(values, *_RANGES[format])
    return values.round() + 0.0 if format == "hall" else values


def _clipped(built: RobotFile) -> tuple[str, ...]:
    """Name the sensors that leave the range of their format within a minute of motion."""
    if built.format not in _RANGES or not built.channel:
        return ()
    low, high = _RANGES[built.format]
    time_s = np.linspace(0.0, 60.0, 257)
    values = readings_along(built, time_s, course(built, time_s)).values[:, list(built.channel)]
    outside = ((values < low) | (values > high)).any(axis=0)
    if not outside.any():
        return ()
    names = ", ".join(str(k + 1) for k in np.flatnonzero(outside))
    return (f"readings of sensor {names} leave {low:g} to {high:g} {built.unit}, and are clipped to that.",)


def _enter_pressed() -> Callable[[], bool]:
    """Return a function that says whether another line came on the standard input, each once."""
    lines = threading.Semaphore(0)

    def read() -> None:
        # not by sys.stdin, whose lock a thread that still waits would hold when the program ends
        with suppress(OSError):  # there may be no standard input
            while data := os.read(0, 4096):
                for _ in range(data.count(b"\n")):
                    lines.release()

    threading.Thread(target=read, daemon=True).start()
    return lambda: lines.acquire(blocking=False)
