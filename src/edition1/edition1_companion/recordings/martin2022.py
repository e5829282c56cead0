"""The IMU recordings of Martin et al. (2022): ROS 1 bags, read as they are and brought onto one clock.

The bags stand in the authors' repository below ``ros_packages/sesa/bags``. Topic ``quat_meas`` carries one
message per reading: ``std_msgs/Header header, uint8 ID, float32 w, x, y, z``. The header's stamp is zero in
both bags, so the time of a reading is the time at which it was recorded.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from rosbags.rosbag1 import Reader
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from edition1.errors import bad_input, require
from edition1.estimation.orientations import UNIT_TOLERANCE
from edition1_companion.recordings.imu_clock import ImuStream, on_clock_of_last
from edition1_companion.recordings.released import verified
from edition1_companion.recordings.sources import data_dir

BAG_FOLDER = "martin2022/ros_packages/sesa/bags"
# Names and sha256 of the released files (repository State-Estimator-for-Soft-Arm-SESA, commit 6045c11).
BAGS = {
    "prev_saved_data_to_play.bag": "da3bc1bec3dfd165fc457f272085ccf425d701534142bbbf97f4103f87dfe9da",
    "freshly_recorded_data.bag": "3cb51b202a6895c201ac1989c2ca18c0dea4ad13a36c39a4d18894597c34b52c",
}
READING_COLUMNS = ("sequence", "time_s", "imu", "x", "y", "z", "w")


def find_bag(name: str) -> Path | None:
    """Return where a released bag lies below `edition1_companion.recordings.sources.data_dir`, or None if it does not.

    Raises
    ------
    InputError
        If ``name`` is none of the released bags, or the file found is not the released one (by its sha256).
    """
    require(name in BAGS, "name", "find_bag", f"one of {', '.join(BAGS)}", name)
    return verified(data_dir() / BAG_FOLDER / name, name, BAG_FOLDER, sha256=BAGS[name])


def read_messages(path: Path, topic: str) -> pd.DataFrame:
    """Read all messages of a topic of a ROS 1 bag: one row each, one column per number or text.

    Parameters
    ----------
    path, topic
        The bag, and the name of the topic with or without its leading slash.

    Returns
    -------
    pandas.DataFrame
        ``time_s``, the time of recording in seconds after the bag's first message, then the message's fields
        under their names (``header.seq`` for a field of a field).

    Raises
    ------
    FileNotFoundError
        If there is no such file.
    InputError
        If the file is not a whole ROS 1 bag (truncated, not closed, damaged), or has no message on the topic.
    """
    if not path.is_file():
        raise FileNotFoundError(f"There is no bag {path.name} in {path.parent}.")
    try:
        rows, topics = _read(path, topic)
    except (
        Exception
    ) as error:  # a damaged file can fail anywhere in the parser, with whatever is raised there
        raise bad_input(
            "file", path.name, "a complete ROS 1 bag", f"{type(error).__name__}: {error}"
        ) from error
    require(rows, "topic", path.name, f"one with messages (the bag has {topics or 'none'})", topic)
    return pd.DataFrame(rows)


def _read(path: Path, topic: str) -> tuple[list[dict[str, Any]], str]:
    """Return the messages of one topic, and the names of all topics."""
    with Reader(path) as bag:
        topics = ", ".join(sorted({connection.topic for connection in bag.connections}))
        wanted = [c for c in bag.connections if c.topic.lstrip("/") == topic.lstrip("/")]
        if not wanted:
            return [], topics
        store = get_typestore(Stores.EMPTY)
        for connection in wanted:
            store.register(get_types_from_msg(connection.msgdef.data, connection.msgtype))
        return [
            {"time_s": (time_ns - bag.start_time) * 1e-9}
            | dict(_fields(store.deserialize_ros1(raw, connection.msgtype)))
            for connection, time_ns, raw in bag.messages(wanted)
        ], topics


def _fields(message: Any, prefix: str = "") -> Iterator[tuple[str, Any]]:
    """Yield name and value of the fields of a message, nested ones under joined names."""
    for name, value in vars(message).items():
        if hasattr(value, "__msgtype__"):
            yield from _fields(value, f"{prefix}{name}.")
        elif not name.startswith("_"):
            yield f"{prefix}{name}", value


def read_readings(path: Path, topic: str = "quat_meas") -> pd.DataFrame:
    """Read the IMU readings of a bag, unchanged.

    Returns
    -------
    pandas.DataFrame
        One row per reading in order of time: ``sequence`` (number of the message), ``time_s`` (time of
        recording after the bag's first message), ``imu`` (the file's ID, from 0), and the quaternion
        ``x, y, z, w`` (sensor frame to world, as sent: neither rescaled nor made continuous).

    Raises
    ------
    FileNotFoundError, InputError
        As `read_messages`, and if the messages of the topic hold something else.
    """
    messages = read_messages(path, topic).rename(columns={"header.seq": "sequence", "ID": "imu"})
    if missing := [name for name in READING_COLUMNS if name not in messages]:
        expected = f"messages with {', '.join(READING_COLUMNS)}"
        raise bad_input(f"topic {topic}", path.name, expected, f"none of {missing}")
    return messages.loc[:, list(READING_COLUMNS)]


def one_clock(
    readings: pd.DataFrame, *, imus: int = 8, between: str = "interpolate", jump_deg: float = 20.0
) -> ImuStream:
    """Check readings and bring all IMUs onto one clock.

    The IMUs are read in turn, so no two readings have one time. The clock is that of the last IMU of a round
    (``imus - 1``), from the first moment at which every IMU has been read to the last. At these times the
    other IMUs take either the spherical linear interpolation between their readings before and after, or the
    latest reading, which is up to one round old. Gaps and jumps are bridged in the same way, and counted.

    Parameters
    ----------
    readings
        Columns ``sequence, time_s, imu, x, y, z, w``, as from `read_readings`.
    imus
        Number of IMUs; their ids are ``0 ... imus - 1`` and they are read in this order. Missing messages are
        accepted and counted.
    between
        "interpolate" or "hold".
    jump_deg
        Angle between consecutive readings of an IMU above which they count as a jump [deg].

    Raises
    ------
    InputError
        Missing columns, values that are not finite, an id that is unknown, absent, duplicated or out of
        order, time stamps that do not increase, or a quaternion whose norm is off 1 by more than 1e-3.
    """
    _check(readings, imus)
    ids, time_s = readings["imu"].to_numpy(), readings["time_s"].to_numpy(dtype=float)
    quaternions = readings[["x", "y", "z", "w"]].to_numpy(dtype=float)
    times = [time_s[ids == imu] for imu in range(imus)]
    lost = int((np.diff(readings["sequence"].to_numpy(dtype=np.int64)) - 1).sum())
    stream = on_clock_of_last(
        times, [quaternions[ids == imu] for imu in range(imus)], between=between, jump_deg=jump_deg
    )
    return replace(stream, lost=lost)


def _check(readings: pd.DataFrame, imus: int) -> None:
    """Refuse readings whose order, ids, times or norms cannot be trusted."""
    if missing := [name for name in READING_COLUMNS if name not in readings]:
        raise bad_input("columns", "readings", ", ".join(READING_COLUMNS), f"none of {missing}")
    values = readings[["sequence", "time_s", "x", "y", "z", "w"]].to_numpy(dtype=float)
    if not (finite := np.isfinite(values).all(axis=1)).all():
        row = int(np.argmin(finite))
        raise bad_input("values", "readings", "finite", f"{values[row].tolist()} in row {row}")
    if (found := set(readings["imu"].tolist())) != set(range(imus)):
        raise bad_input("ids", "readings", f"0 to {imus - 1}, each present", sorted(found))
    for column, name in enumerate(("sequence", "time_s")):
        steps = np.diff(values[:, column])
        if (steps <= 0).any():
            row = int(np.argmax(steps <= 0))
            seen = f"a step of {steps[row]:g} to row {row + 1}"
            raise bad_input(name, "readings", "increasing in order of time", seen)
    _check_order(values[:, 1], readings["imu"].to_numpy(dtype=np.int64), imus)
    error = np.abs(np.linalg.norm(values[:, 2:], axis=1) - 1.0)
    if (error > UNIT_TOLERANCE).any():
        row = int(np.argmax(error))
        seen = f"{values[row, 2:].tolist()} in row {row}"
        raise bad_input("quaternions", "readings", f"unit within {UNIT_TOLERANCE:g}", seen)


def _check_order(time_s: np.ndarray, ids: np.ndarray, imus: int) -> None:
    """Refuse ids that come twice in a round, or not in turn.

    After a pause of half a round or more any id may follow: such readings were missed, not exchanged.
    """
    first = time_s[ids == ids[0]]
    round_s = np.median(np.diff(first)) if first.size > 1 else np.inf
    forward = np.diff(ids) % imus
    prompt = np.diff(time_s) < round_s / 2
    for name, wrong in (("duplicated", forward == 0), ("out of order", forward > imus // 2)):
        if (wrong & prompt).any():
            row = int(np.argmax(wrong & prompt)) + 1
            seen = f"an id {name}: {ids[row]} after {ids[row - 1]} at row {row}"
            raise bad_input("ids", "readings", f"in turn, 0 to {imus - 1}", seen)
