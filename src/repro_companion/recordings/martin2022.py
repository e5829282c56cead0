"""The IMU recordings of Martin et al. (2022): ROS 1 bags, read as they are and brought onto one clock.

The bags stand in the authors' repository below ``ros_packages/sesa/bags``. Topic ``quat_meas`` carries one
message per reading: ``std_msgs/Header header, uint8 ID, float32 w, x, y, z``. The header's stamp is zero in
both bags, so the time of a reading is the time at which it was recorded.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from jaxtyping import Float
from rosbags.rosbag1 import Reader
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from scipy.spatial.transform import Rotation, Slerp

from repro.errors import bad_input
from repro.estimation.orientations import UNIT_TOLERANCE
from repro_companion.recordings.released import verified
from repro_companion.recordings.sources import data_dir

BAG_FOLDER = "martin2022/ros_packages/sesa/bags"
# Names and sha256 of the released files (repository State-Estimator-for-Soft-Arm-SESA, commit 6045c11).
BAGS = {
    "prev_saved_data_to_play.bag": "da3bc1bec3dfd165fc457f272085ccf425d701534142bbbf97f4103f87dfe9da",
    "freshly_recorded_data.bag": "3cb51b202a6895c201ac1989c2ca18c0dea4ad13a36c39a4d18894597c34b52c",
}
READING_COLUMNS = ("sequence", "time_s", "imu", "x", "y", "z", "w")
GAP_FACTOR = 2.0


@dataclass(frozen=True)
class ImuStream:
    """Orientations of all IMUs on one clock, and what was found on the way there.

    Attributes
    ----------
    time_s
        Times of the samples [s]: those of the readings of the last IMU of a round.
    orientations
        Unit quaternions XYZW, sensor frame to world, of continuous sign.
    facts
        One row per IMU: ``readings``, ``rate_hz`` (mean), ``median_interval_ms``, ``longest_interval_ms``,
        ``gaps`` (intervals above twice the median), ``samples_in_gaps``, ``repeats`` (readings equal to the
        one before to the last bit), ``jumps`` and ``largest_step_deg`` (angle between consecutive readings),
        ``sign_flips``, ``rescaled`` (norm off 1 by more than 1e-6) and ``largest_norm_error``.
    jumps
        One row per jump: ``time_s``, ``imu``, ``step_deg``, and ``axis_z``, the vertical part of the step's
        unit axis in the world frame (1 or -1: a change of heading alone). Jumps stay in the data.
    lost
        Messages whose sequence numbers are missing.
    """

    time_s: Float[np.ndarray, " samples"]
    orientations: Float[np.ndarray, "samples imus 4"]
    facts: pd.DataFrame
    jumps: pd.DataFrame
    lost: int


def find_bag(name: str) -> Path | None:
    """Return where a released bag lies below `repro_companion.recordings.sources.data_dir`, or None if it does not.

    Raises
    ------
    InputError
        If ``name`` is none of the released bags, or the file found is not the released one (by its sha256).
    """
    if name not in BAGS:
        raise bad_input("name", "find_bag", f"one of {', '.join(BAGS)}", name)
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
    if not rows:
        raise bad_input("topic", path.name, f"one with messages (the bag has {topics or 'none'})", topic)
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
    if between not in ("interpolate", "hold"):
        raise bad_input("between", "one_clock", '"interpolate" or "hold"', between)
    if not jump_deg > 0:
        raise bad_input("jump_deg", "one_clock", "an angle above zero [deg]", jump_deg)
    _check(readings, imus)
    ids, time_s = readings["imu"].to_numpy(), readings["time_s"].to_numpy(dtype=float)
    quaternions = readings[["x", "y", "z", "w"]].to_numpy(dtype=float)
    times = [time_s[ids == imu] for imu in range(imus)]
    last = times[-1]
    ticks = last[(last >= max(t[0] for t in times)) & (last <= min(t[-1] for t in times))]
    if ticks.size == 0:
        raise bad_input("readings", "one_clock", "of all IMUs over some common time", "none")
    parts = [
        _track(imu, times[imu], quaternions[ids == imu], ticks, between, jump_deg) for imu in range(imus)
    ]
    orientations, facts, jumps = zip(*parts, strict=True)
    return ImuStream(
        time_s=ticks,
        orientations=np.stack(orientations, axis=1),
        facts=pd.DataFrame(facts),
        jumps=pd.concat(jumps).sort_values("time_s", ignore_index=True),
        lost=int((np.diff(readings["sequence"].to_numpy(dtype=np.int64)) - 1).sum()),
    )


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


def _track(
    imu: int, time_s: np.ndarray, raw: np.ndarray, ticks: np.ndarray, between: str, jump_deg: float
) -> tuple[np.ndarray, dict[str, Any], pd.DataFrame]:
    """Return one IMU's orientations at the ticks, its facts, and its jumps."""
    if len(time_s) < 2:
        raise bad_input("readings", "one_clock", "at least two per IMU", f"{len(time_s)} of IMU {imu}")
    norms = np.linalg.norm(raw, axis=1, keepdims=True)
    unit, norm_error = raw / norms, np.abs(norms - 1.0)
    rotations = Rotation.from_quat(unit)
    turns = np.degrees((rotations[1:] * rotations[:-1].inv()).as_rotvec())  # in the world frame
    steps_deg = np.linalg.norm(turns, axis=1)
    jumped = steps_deg > jump_deg
    intervals = np.diff(time_s)
    gap = intervals > GAP_FACTOR * np.median(intervals)
    latest = np.searchsorted(time_s, ticks, side="right") - 1
    at_ticks = unit[latest] if between == "hold" else Slerp(time_s, rotations)(ticks).as_quat()
    facts = {
        "imu": imu,
        "readings": len(time_s),
        "rate_hz": len(intervals) / (time_s[-1] - time_s[0]),
        "median_interval_ms": 1e3 * np.median(intervals),
        "longest_interval_ms": 1e3 * intervals.max(),
        "gaps": int(gap.sum()),
        "samples_in_gaps": int((np.append(gap, False)[latest] & (ticks > time_s[latest])).sum()),
        "repeats": int((raw[1:] == raw[:-1]).all(axis=1).sum()),
        "jumps": int(jumped.sum()),
        "largest_step_deg": steps_deg.max(),
        "sign_flips": int(((raw[1:] * raw[:-1]).sum(axis=1) < 0).sum()),
        "rescaled": int((norm_error > 1e-6).sum()),
        "largest_norm_error": norm_error.max(),
    }
    jumps = pd.DataFrame({"time_s": time_s[1:][jumped], "imu": imu, "step_deg": steps_deg[jumped]})
    jumps["axis_z"] = turns[jumped, 2] / steps_deg[jumped]
    return _continuous(at_ticks), facts, jumps


def _continuous(quaternions: np.ndarray) -> np.ndarray:
    """Flip signs so that consecutive quaternions lie on one side (q and -q are one rotation)."""
    flips = np.where((quaternions[1:] * quaternions[:-1]).sum(axis=1) < 0, -1.0, 1.0)
    return quaternions * np.cumprod(np.append(1.0, flips))[:, None]
