"""A recording for other programs: as a table in CSV or Parquet, or as messages in MCAP."""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
import pandas as pd

from repro.common import Array, bad_input, require, whole
from repro.robot import Robot
from repro.robot_file import load_robot
from repro_board.record import Recording, read_recording, readings_of

FORMS = ("csv", "parquet", "mcap")
_LATE_S, _LATE_SHARE = 1.0, 1e-3
"""By so much, and this share of the recording, estimates may lie outside it."""


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
        ``/notes`` what was noted.
    robot
        Write its readings, one row a time step, instead of the samples of the board; or the path of its file.
    estimates
        For MCAP: the table that ``repro track`` made of this recording.

    Raises
    ------
    InputError
        If the file exists or cannot be made, the recording is empty, or the estimates are not of this recording.
    """
    output = Path(output)
    form = to or output.suffix[1:].lower() or "csv"
    require(
        form in FORMS, "to", "the export", f"one of {', '.join(FORMS)} (--to, or the file's ending)", form
    )
    require(estimates is None or form == "mcap", "estimates", "the export", "left out, but for mcap", form)
    require(not output.exists(), "output", "the export", "a new file", output)
    recording = read_recording(path)
    robot = load_robot(robot) if isinstance(robot, str | Path) else robot
    table, remarks = table_of(recording, robot)
    estimated = None if estimates is None else _estimates(Path(estimates), float(recording.times[-1]))
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
            _write_mcap(part, recording, table, estimated)
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
        magnetic = sum(sensor.axes for sensor in robot.sensors)
        names = [f"{name}_{'mT' if k < magnetic else 'rad'}" for k, name in enumerate(robot.names)]
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
        nearest = np.rint(np.interp(times, recording.times, np.arange(len(board_us)))).astype(int)
        columns["board_s"] = np.array(board_us)[nearest] / 1e6
    return columns


def _notes(recording: Recording, times: Array) -> dict[str, Array]:
    """Return what was noted, in the row that is nearest in time; no column where nothing was."""
    texts: dict[int, list[str]] = {}
    for note in recording.notes:
        texts.setdefault(int(np.abs(times - note.time_s).argmin()), []).append(note.text)
    column = np.array(["; ".join(texts.get(k, [])) for k in range(len(times))], dtype=object)
    return {"note": column} if recording.notes else {}


def _estimates(path: Path, last_s: float) -> pd.DataFrame:
    try:
        table = pd.read_csv(path)
    except (OSError, ValueError) as error:
        raise bad_input("estimates", path.name, "a table of repro track", error) from error
    there = "time_s" in table and "status" in table and len(table) and table["time_s"].dtype.kind in "if"
    require(there, "estimates", path.name, "a table of repro track", ", ".join(map(str, table.columns)))
    spare_s, times = _LATE_S + _LATE_SHARE * last_s, table["time_s"]
    within = times.between(-spare_s, last_s + spare_s).all()
    must = f"within the recording, 0 to {last_s:.3f} s"
    require(within, "time_s", path.name, must, f"{times.min():.3f} to {times.max():.3f} s")
    return table


def _write_mcap(
    path: Path, recording: Recording, table: pd.DataFrame, estimates: pd.DataFrame | None
) -> None:
    from mcap.writer import Writer

    several = "stream" in table and bool(table["stream"].nunique() > 1)
    topics = {"/estimate": estimates} if estimates is not None else {}
    if recording.notes:
        topics["/notes"] = pd.DataFrame(recording.notes)
        table = table.drop(columns="note")
    for stream, part in table.groupby("stream" if several else np.zeros(len(table))):
        topics[f"/readings/{stream}" if several else "/readings"] = part
    messages = []
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start(library="repro")
        for topic, part in topics.items():
            kinds = {name: "number" if x.kind in "ifu" else "string" for name, x in part.dtypes.items()}
            schema = {"type": "object", "properties": {name: {"type": kind} for name, kind in kinds.items()}}
            number = writer.register_schema(topic[1:], "jsonschema", json.dumps(schema).encode())
            channel = writer.register_channel(topic, "json", number)
            for row in part.astype(object).to_dict("records"):
                content = {name: x for name, x in row.items() if isinstance(x, str) or math.isfinite(x)}
                messages.append((round(1e9 * (recording.unix_s + row["time_s"])), channel, content))
        for time_ns, channel, content in sorted(messages, key=lambda message: message[0]):
            writer.add_message(channel, time_ns, json.dumps(content).encode(), time_ns)
        writer.add_metadata("recording", {name: json.dumps(x) for name, x in recording.about.items()})
        writer.finish()
