"""Readings in a file: which frames of a recording, or columns of a table, are those of a robot is never guessed."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import compress
from pathlib import Path

import numpy as np
from jaxtyping import Bool

from edition1.errors import bad_input
from edition1.estimation.orientations import UPRIGHT
from edition1.robot_file.columns import MAGNETIC_STREAM, channel_columns, is_numbered, name_and_unit
from edition1.robot_file.robot_file import RobotFile
from edition1_live.record.recording import Recording, read_recording
from edition1_live.record.recording_file import MAGIC, sidecar_path
from edition1_live.robot.number_table import NumberTable, read_numbers, times_of, whole_numbers
from edition1_live.wire.csv_text import check_units
from edition1_live.wire.formats import channel_names
from edition1_live.wire.frame import WRAP, Frame


def stream_widths(robot: RobotFile) -> dict[int, int]:
    """Return the streams of a robot, in the order of a time step, and how many values a frame of each has.

    Examples
    --------
    >>> from edition1.robot_file.load import load_robot
    >>> stream_widths(load_robot("data/robots/two_segments.toml"))
    {0: 8}
    """
    magnetic = {MAGNETIC_STREAM: robot.channels} if robot.channel else {}
    return magnetic | {imu.stream: len(UPRIGHT) for imu in robot.imus}


def frames_of(recording: Recording, robot: RobotFile) -> tuple[Bool[np.ndarray, " frames"], list[str]]:
    """Return which frames of a recording are those of a robot, and notes on the others and on what is damaged.

    Raises
    ------
    InputError
        If the recording is of another format or unit than the robot, or no frame of it fits.
    """
    if recording.format != robot.format:
        raise bad_input("recording", robot.name, f"of the format {robot.format}", recording.format)
    units = recording.metadata.get("units")
    if isinstance(units, list) and len(units) == len(recording.channels):
        check_units(recording.channels, units, robot.unit if robot.channel else None)
    widths, streams = stream_widths(robot), recording.stream
    fits, notes = np.zeros(len(streams), dtype=bool), [f"Recording: {text}." for text in recording.remarks]
    for stream, width in widths.items():
        own = streams == stream
        fits |= own & (recording.widths == width)
        if others := int((own & (recording.widths != width)).sum()):
            notes.append(
                f"{others} frames of stream {stream} have another number of values than {width} and were left out."
            )
    if not fits.any():
        expected = " or ".join(f"{width} values in stream {stream}" for stream, width in widths.items())
        found = Counter(zip(recording.widths.tolist(), streams.tolist(), strict=True))
        received = ", ".join(f"{n} frames of {width} values in stream {k}" for (width, k), n in found.items())
        raise bad_input("recording", robot.name, f"one with frames of {expected}", received or "no frame")
    return fits, notes + _other_streams(robot, streams.tolist())


def _other_streams(robot: RobotFile, streams: Iterable[int]) -> list[str]:
    """Say of which streams there are frames that the robot does not have; empty if of none."""
    own = stream_widths(robot)
    found = Counter(stream for stream in streams if stream not in own)
    said = ", ".join(f"{stream} ({n} frames)" for stream, n in found.items())
    return [f"Streams that {robot.name} does not have: {said}."] if found else []


_KNOWN = ("unix_s", "host_ns", "sequence", "stream", "device_us")
"""Columns beside times and readings that `repro export` writes."""


def read_table(path: Path, robot: RobotFile) -> tuple[list[tuple[int, Frame]], float, list[str]]:
    """Read a table of readings with a column of times.

    Parameters
    ----------
    path
        A CSV with a header. Times are in ``time_s``, ``time_ms`` or the like; ``device_us`` and ``stream`` are used
        where they are. A reading of channel 2 is in ``u2``, ``ch2``, ``channel_2``, under the name of the format
        (``y_counts``), or under the number of its sensor, ``sensor_2``; each with a unit behind it, as ``u2_mT`` or
        ``u2 [mT]``, or without. Of a board that sends ``csv``, labels of its own count in their order, as in its
        lines, if they are as many as its channels and no column is numbered. IMUs are in ``x``, ``y``, ``z``, ``w``
        with their ``stream``; of a board that sends ``frames`` also in ``u1`` to ``u4``, without a unit.
    robot
        What sent the readings.

    Returns
    -------
    frames, start_s, notes
        Times [ns] and frames; the first time [s]; columns and streams that are not used.

    Raises
    ------
    InputError
        If a column is missing, ambiguous or of another unit, or a time is missing or decreases.
    """
    table = read_numbers(path)
    names = list(table.columns)
    time_column, time_s = times_of(path.name, table, apart=False)
    chosen: list[str | None] = []
    quaternion: list[str] = []
    values: dict[int, list[list[float]]] = {}
    if robot.channel:
        labels = [name for name in names if name not in (time_column, *_KNOWN)]
        numbered = any(map(is_numbered, labels))
        if robot.format == "csv" and not numbered and len(labels) == robot.channels:
            check_units(labels, [name_and_unit(name)[1] for name in labels], robot.unit)
            chosen += labels
        else:
            own = channel_names(robot.format, robot.channels)
            stream = (robot.unit, robot.name, robot.channels, robot.channel)
            chosen += channel_columns(path.name, names, *stream, own)
        values[MAGNETIC_STREAM] = _rows(table, chosen)
    if robot.imus:
        quaternion = list("xyzw") if "x" in names else channel_names(robot.format, len(UPRIGHT))
        wanted = ("stream", *quaternion)
        if missing := [name for name in wanted if name not in names]:
            raise bad_input("columns", path.name, ", ".join(wanted), f"none called {', '.join(missing)}")
        values |= dict.fromkeys((imu.stream for imu in robot.imus), _rows(table, quaternion))
    streams = [number or 0 for number in whole_numbers(path.name, table, "stream", 1 << 16)]
    device_us = whole_numbers(path.name, table, "device_us", WRAP)
    arrival_ns = np.round(1e9 * (time_s - time_s[0])).astype(np.int64).tolist()
    rows = enumerate(zip(arrival_ns, streams, device_us, strict=True))
    frames = [
        (ns, Frame(k, None, sent_us, tuple(values[k][row]))) for row, (ns, k, sent_us) in rows if k in values
    ]
    start_s = float(time_s[0]) + (1e-9 * frames[0][0] if frames else 0.0)
    unused = [name for name in names if name not in (time_column, *_KNOWN, *chosen, *quaternion)]
    notes = [f"Columns of {path.name} that are not used: {', '.join(unused)}."] if unused else []
    return frames, start_s, notes + _other_streams(robot, streams)


def _rows(table: NumberTable, columns: Sequence[str | None]) -> list[list[float]]:
    """Values of chosen columns; NaN where none is chosen."""
    values = np.full((len(table.lines), len(columns)), np.nan)
    for k, name in enumerate(columns):
        if name is not None:
            values[:, k] = table.columns[name]
    return values.tolist()


@dataclass(frozen=True)
class Readings:
    """What was recorded.

    Attributes
    ----------
    frames
        Arrival [ns] and frame, in order; those of the robot alone.
    start_s
        Time of the first frame in the recording or the table [s].
    notes
        What was left out, one sentence each.
    """

    frames: Sequence[tuple[int, Frame]]
    start_s: float
    notes: list[str]


def read_readings(path: Path, robot: RobotFile) -> Readings:
    """Read what a robot sent: a recording of `repro record`, or a CSV as `repro export` writes it.

    Raises
    ------
    InputError
        If the file is not there, is neither, or does not fit the robot.
    """
    if not path.is_file():
        raise bad_input(
            "path", "readings", "a recording, or a CSV of readings", f"{path}, which is not there"
        )
    with path.open("rb") as stream:
        head = stream.read(4096)
    if not (head.startswith(MAGIC) or b"\0" in head or sidecar_path(path).is_file()):
        return Readings(*read_table(path, robot))
    recording = read_recording(path)
    fits, notes = frames_of(recording, robot)
    frames = list(compress(recording.as_frames(), fits))
    return Readings(frames, 1e-9 * (frames[0][0] - recording.metadata["start_host_ns"]), notes)
