"""A recording for other programs: as a table in CSV or Parquet, or as messages in MCAP."""

from __future__ import annotations

import heapq
import json
import math
from collections.abc import Iterator
from itertools import repeat
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from scipy.spatial.transform import Rotation

from repro.chain import Place, point_on
from repro.common import Array, bad_input, new, require, whole
from repro.robot import Robot
from repro.robot_file import load_robot
from repro_board.record import Recording, read_recording, readings_of

FORMS = ("csv", "parquet", "mcap")
_LATE_S, _LATE_SHARE = 1.0, 1e-3
"""By so much, and this share of the recording, estimates may lie outside it."""
POSES = 20
"""So many places of the backbone are written for each estimate."""
_DECIMALS = 5
"""Of their positions [m] and quaternions: 0.01 mm is less than any camera resolves."""
Json = dict[str, Any]


def _object(**parts: Json) -> Json:
    return {"type": "object", "properties": parts, "required": list(parts)}


_NUMBER = {"type": "number"}
_TIME = _object(
    sec={"type": "integer", "minimum": 0}, nsec={"type": "integer", "minimum": 0, "maximum": 999_999_999}
)
_POSE = _object(
    position=_object(x=_NUMBER, y=_NUMBER, z=_NUMBER),
    orientation=_object(x=_NUMBER, y=_NUMBER, z=_NUMBER, w=_NUMBER),
)
_POSES = _object(
    timestamp=_TIME | {"title": "time"}, frame_id={"type": "string"}, poses={"type": "array", "items": _POSE}
)
"""What Foxglove publishes as foxglove.PosesInFrame, without what a message may lack."""


def export(
    path: str | Path,
    output: str | Path,
    *,
    to: str = "",
    robot: Robot | str | Path | None = None,
    estimates: str | Path | None = None,
) -> tuple[list[str], int]:
    """Write a recording as a new file, whole or not at all; return what a user should know, and the samples' number.

    Parameters
    ----------
    path
        Of the recording.
    output
        A new file.
    to
        ``csv``, ``parquet`` or ``mcap``; by default what the ending of the file says, CSV without one. A table is
        that of `table_of`. Messages of MCAP are JSON: ``/readings`` has the rows of the table, ``/readings/3``
        those of stream 3 where there are several, ``/estimate`` those of the estimates, without what is missing, and
        ``/notes`` what was noted. ``/backbone`` has poses along the estimated shape in the frame of the base, as
        ``foxglove.PosesInFrame``.
    robot
        Write its readings, one row a time step, instead of the samples of the board; or the path of its file.
    estimates
        For MCAP: the table that ``repro track`` made of this recording; with a robot also as poses.

    Raises
    ------
    InputError
        If the file exists or cannot be made, the recording is empty, or the estimates are not of this recording or
        not of this robot.
    """
    output = Path(output)
    form = to or output.suffix[1:].lower() or "csv"
    require(
        form in FORMS, "to", "the export", f"one of {', '.join(FORMS)} (--to, or the file's ending)", form
    )
    require(estimates is None or form == "mcap", "estimates", "the export", "left out, but for mcap", form)
    new(output, "the export")
    recording = read_recording(path)
    robot = load_robot(robot) if isinstance(robot, str | Path) else robot
    table, remarks = table_of(recording, robot)
    tables, poses = _by_stream(table.drop(columns="note", errors="ignore")), None
    if recording.notes:
        tables = {"/notes": pd.DataFrame(recording.notes), **tables}
    if estimates is not None:
        estimated = estimates_table(estimates, recording.times)
        tables = {"/estimate": estimated, **tables}
        if robot is None:
            remarks.append("No poses of the backbone are written: they need the robot file (--robot).")
        else:
            q = configurations(robot, estimated, Path(estimates).name)
            poses = _backbones(recording.unix_s + estimated["time_s"].to_numpy(), robot, q)
    with whole(output, "the export") as part:
        if form == "csv":
            table.to_csv(part, index=False)
        elif form == "parquet":
            try:
                table.to_parquet(part, index=False)
            except ImportError as error:
                must = 'csv or mcap, unless pyarrow is installed (the extra "parquet")'
                raise bad_input("to", "the export", must, form) from error
        else:
            _write_mcap(part, recording, tables, poses)
    return remarks, len(recording.samples)


def table_of(recording: Recording, robot: Robot | None = None) -> tuple[pd.DataFrame, list[str]]:
    """Return a data frame of a recording and its remarks.

    It has ``time_s`` from the first sample, ``unix_s``, ``board_s`` by the clock of the board where it sends one, and
    with a robot its readings by their names in mT, IMUs as rotation vectors in rad. Without one it has a row for each
    sample: ``stream``, ``sequence`` where the board sends it, and the values by the names and units that the board
    sends, else u1, u2 and so on. Where something was noted, ``note`` has it in the row that is nearest in time.
    """
    require(len(recording.samples), "recording", recording.path.name, "one with samples", "none")
    if robot is not None:
        readings = readings_of(robot, recording)
        names = [f"{name}_{'mT' if k < robot.n_magnetic else 'rad'}" for k, name in enumerate(robot.names)]
        times = np.asarray(readings.times)
        columns = _clocks(recording, times) | _notes(recording, times)
        return pd.DataFrame(columns | dict(zip(names, readings.T, strict=True))), list(readings.remarks)
    remarks, widths = list(recording.remarks), {len(sample.values) for sample in recording.samples}
    if len(widths) > 1:
        remarks.append(f"samples have {min(widths)} to {max(widths)} values; missing ones are empty")
    values = np.full((len(recording.samples), max(widths)), np.nan)
    for k, sample in enumerate(recording.samples):
        values[k, : len(sample.values)] = sample.values
    columns = _clocks(recording, recording.times) | _notes(recording, recording.times)
    columns["stream"] = np.array([sample.stream for sample in recording.samples])
    sequence = [sample.sequence for sample in recording.samples]
    if None not in sequence:
        columns["sequence"] = np.array(sequence)
    units = recording.units or [""] * len(recording.names)
    names = [f"{name}_{unit}" if unit else name for name, unit in zip(recording.names, units, strict=True)]
    if len(names) != max(widths) or len({*names, *columns}) < len(names) + len(columns):
        names = [f"u{k + 1}" for k in range(max(widths))]
    return pd.DataFrame(columns | dict(zip(names, values.T, strict=True))), remarks


def _clocks(recording: Recording, times: Array) -> dict[str, Array]:
    """Return times of a recording by all clocks."""
    columns = {"time_s": times.round(9), "unix_s": recording.unix_s + times}
    board_us = [sample.time_us for sample in recording.samples]
    if None not in board_us:
        columns["board_s"] = np.interp(times, recording.times, np.array(board_us, float)) / 1e6
    return columns


def _notes(recording: Recording, times: Array) -> dict[str, Array]:
    """Return what was noted, in the row that is nearest in time; no column where nothing was."""
    texts: dict[int, list[str]] = {}
    for note in recording.notes:
        texts.setdefault(int(np.abs(times - note.time_s).argmin()), []).append(note.text)
    column = np.array(["; ".join(texts.get(k, [])) for k in range(len(times))], dtype=object)
    return {"note": column} if recording.notes else {}


def estimates_table(path: str | Path, times: Array | None = None) -> pd.DataFrame:
    """Return a table that ``repro track`` wrote; refuse what is none, or is not of readings at these times [s]."""
    path = Path(path)
    require(path.is_file(), "estimates", path.name, "a file that exists", path)
    try:
        table = pd.read_csv(path)
    except (OSError, ValueError) as error:
        raise bad_input("estimates", path.name, "a table of repro track", error) from error
    there = "time_s" in table and "status" in table and len(table) and table["time_s"].dtype.kind in "if"
    require(there, "estimates", path.name, "a table of repro track", ", ".join(map(str, table.columns)))
    at, cut = table["time_s"], table["status"].isna().to_numpy()
    received = f"line {2 + int(cut.argmax())} without a status (cut off?)"
    require(not cut.any(), "estimates", path.name, "a whole table of repro track", received)
    require((np.diff(at) > 0).all(), "time_s", path.name, "increasing", "times that do not")
    if times is not None:
        first, last = float(times[0]), float(times[-1])
        spare_s = _LATE_S + _LATE_SHARE * (last - first)
        within = at.between(first - spare_s, last + spare_s).all()
        must = f"within the recording, {first:.3g} to {last:.3f} s"
        require(within, "time_s", path.name, must, f"{at.min():.3f} to {at.max():.3f} s")
    return table


def configurations(robot: Robot, table: pd.DataFrame, name: str) -> Array:
    """Return the configurations ``[t, n_q]`` of a table of estimates; refuse estimates of another robot.

    Its coordinates must be those of the robot, and its tips where this robot has them.
    """
    labels = [f"{coordinate}_{unit}" if unit else coordinate for coordinate, unit, _ in robot.units]
    tips = [f"tip_{axis}_mm" for axis in "xyz"]
    missing = [label for label in (*labels, *tips) if label not in table]
    must = "estimates of this robot"
    require(not missing, "estimates", name, must, f"a table without {', '.join(missing)}")
    given = table[[*labels, *tips]].apply(pd.to_numeric, errors="coerce").to_numpy(float)
    q = given[:, : robot.n_q] / [factor for *_, factor in robot.units]
    known = np.isfinite(given.sum(axis=1))  # of a row that lacks a number there is no sum
    require(known.any(), "estimates", name, "known in a row or more", "none")
    off_mm = np.abs(1e3 * robot.tip(q[known])[:, :3, 3] - given[known, robot.n_q :]).max()
    # The table has seven digits of each.
    far = f"tips up to {off_mm:.3g} mm from those of this robot"
    require(off_mm < 0.001 + 0.1 * robot.length, "estimates", name, must, far)
    return np.where(known[:, None], q, np.nan)


def _by_stream(table: pd.DataFrame) -> dict[str, pd.DataFrame]:
    """Return the rows of each stream, by topic."""
    several = "stream" in table and bool(table["stream"].nunique() > 1)
    parts = table.groupby("stream" if several else np.zeros(len(table)))
    return {f"/readings/{stream}" if several else "/readings": part for stream, part in parts}


def _rows(unix_s: float, table: pd.DataFrame) -> Iterator[tuple[int, Json]]:
    """Yield the times of rows since 1970 [ns], and what is in them, without what is missing."""
    for row in table.sort_values("time_s", kind="stable").astype(object).to_dict("records"):
        content = {str(name): x for name, x in row.items() if isinstance(x, str) or math.isfinite(x)}
        yield round(1e9 * (unix_s + row["time_s"])), content


def _backbones(unix_s: Array, robot: Robot, q: Array) -> Iterator[tuple[int, Json]]:
    """Yield the times since 1970 [ns] of known shapes, and poses of places along each."""
    places = even_places(robot)
    for k in np.flatnonzero(np.isfinite(q).all(1)).tolist():
        T = robot.poses(q[k], places)
        turns = Rotation.from_matrix(T[:, :3, :3]).as_quat().round(_DECIMALS).tolist()
        points = T[:, :3, 3].round(_DECIMALS).tolist()
        poses = [
            {
                "position": dict(zip("xyz", p, strict=True)),
                "orientation": dict(zip("xyzw", turn, strict=True)),
            }
            for p, turn in zip(points, turns, strict=True)
        ]
        time_ns = round(1e9 * unix_s[k])
        stamp = dict(zip(("sec", "nsec"), divmod(time_ns, 10**9), strict=True))
        yield time_ns, {"timestamp": stamp, "frame_id": "base", "poses": poses}


def even_places(robot: Robot) -> list[Place]:
    """Return places along the backbone that are as far apart as each other; the last is the tip."""
    lengths = np.array([segment.length for segment in robot.segments])
    ends = lengths.cumsum()
    found = []
    for along in np.linspace(0, ends[-1], POSES)[:-1]:
        k = int(np.searchsorted(ends, along))
        found.append(point_on(k + 1, float(np.clip(along - ends[k] + lengths[k], 0, lengths[k]))))
    return [*found, point_on(len(lengths), float(lengths[-1]))]


def _write_mcap(
    path: Path,
    recording: Recording,
    tables: dict[str, pd.DataFrame],
    poses: Iterator[tuple[int, Json]] | None,
) -> None:
    from mcap.writer import Writer

    with path.open("wb") as file:
        writer, streams = Writer(file), []
        writer.start(library="repro")

        def add(topic: str, name: str, schema: Json, messages: Iterator[tuple[int, Json]]) -> None:
            number = writer.register_schema(name, "jsonschema", json.dumps(schema).encode())
            streams.append(zip(messages, repeat(writer.register_channel(topic, "json", number))))

        for topic, part in tables.items():
            kinds = {name: "number" if x.kind in "ifu" else "string" for name, x in part.dtypes.items()}
            schema = {"type": "object", "properties": {name: {"type": kind} for name, kind in kinds.items()}}
            add(topic, topic[1:], schema, _rows(recording.unix_s, part))
        if poses is not None:
            add("/backbone", "foxglove.PosesInFrame", _POSES, poses)
        for (time_ns, content), channel in heapq.merge(*streams, key=lambda message: message[0][0]):
            writer.add_message(channel, time_ns, json.dumps(content).encode(), time_ns)
        writer.add_metadata("recording", {name: json.dumps(x) for name, x in recording.about.items()})
        writer.finish()
