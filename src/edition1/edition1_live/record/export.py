"""A recording as a table, for other programs, or as a file that the loaders of the papers' files read."""

from __future__ import annotations

import csv
from collections.abc import Mapping
from pathlib import Path

import numpy as np
from jaxtyping import Int

from edition1.errors import bad_input, require
from edition1.files import whole_file, write_whole
from edition1_live.record.export_mcap import write_mcap
from edition1_live.record.recording import Recording

FORMS = ("csv", "parquet", "mcap")
"""Files that other programs open."""
SCHEMAS = {"hall": 3, "millivolts": 3, "quaternions": 4}
"""Layouts of the files of the three papers, and the number of values of a frame."""
_TIE_NS = 1000
"""Readings that arrived together are written this much apart, since times in these files must increase [ns]."""
_MILLIVOLTS_HZ = 40.0
"""Rate that the loader of the files of Baaij et al. takes."""
_ROWS = 4096
"""Rows of a table that are in memory as text."""
_COUNTS_PER_UNIT = 1000.0
"""Counts of the Hall sensor per unit of the files of Mitchell et al."""
_TYPE = "estimator/msg/quat"
_MESSAGE = "std_msgs/Header header\nuint8 ID\nfloat32 w\nfloat32 x\nfloat32 y\nfloat32 z\n"


def export(
    recording: Recording,
    path: Path,
    schema: str = "",
    *,
    to: str = "",
    unit: str = "",
    estimates: Path | None = None,
) -> list[str]:
    """Write the readings of a recording as a table, or in the schema of a loader.

    Parameters
    ----------
    recording
        What to write.
    path
        A new file. By default a CSV of all frames, with any number of values: ``time_s``, arrival after the start of
        the recording; ``unix_s``, the same since 1970 by the computer's clock; ``stream`` and ``sequence`` where the
        format has them; ``device_us``, the clock of the board as sent, where it sends one; then the values under
        their names, empty where a frame has none or NaN.
    schema
        One of :data:`SCHEMAS` for another layout: rows ``[x y z],unix_time`` in thousands of counts for ``hall``;
        columns u1, u2, u3 [mV] and time_s for ``millivolts``; for ``quaternions`` a ROS 1 bag, whose components are
        float32. The recording must have that format, or ``frames``, which do not know the unit of their values.
    to
        One of :data:`FORMS`; by default that of the name of the file, or ``csv``. Parquet holds the columns of the
        table, and `edition1_live.record.export_mcap` says what mcap holds.
    unit
        Unit of the values of a table, where their names do not say it.
    estimates
        For mcap: a table of estimates made from this recording.

    Returns
    -------
    list of str
        What the file does not hold as it was recorded; empty if nothing.

    Raises
    ------
    InputError
        If the recording has another format, or the wrong number of values or of streams, or no frame; or the file
        exists.
    """
    require(schema in ("", *SCHEMAS), "schema", "export", f"one of {', '.join(SCHEMAS)}, or left out", schema)
    if schema and recording.format not in ("frames", schema):
        raise bad_input(
            "recording", f"export as {schema}", f"of the format {schema} or frames", recording.format
        )
    if path.exists():
        raise bad_input("output", "export", "a new file (give another name, or move the old one)", path)
    named = path.suffix.removeprefix(".").lower()
    if not to and not schema and named not in ("", "txt", "bag", *FORMS):
        raise bad_input("output", "export", f"named .{', .'.join(FORMS)}, or with --to", path)
    form = to or (named if named in FORMS and not schema else "csv")
    require(form in FORMS, "to", "export", f"one of {', '.join(FORMS)}", form)
    require(not (schema and to), "to", "export", f"left out with --as {schema}", to)
    require(estimates is None or form == "mcap", "estimates", "export", "left out, but for mcap", form)
    if not schema:
        require(path.suffix != ".bag", "output", "export", "a CSV (--as quaternions writes a bag)", path)
        require(len(recording.rows), "recording", "export", "one with frames", "no frame")
        if form == "mcap":
            return write_mcap(recording, path, _named_with_unit(recording, unit), estimates)
        return _write_table(recording, path, unit, form)
    if not len(recording.rows) or (recording.widths != SCHEMAS[schema]).any():
        must = f"frames of {SCHEMAS[schema]} values each"
        found = sorted(set(recording.widths.tolist())) or "no frame"
        raise bad_input("recording", f"export as {schema}", must, found)
    if schema != "quaternions" and (streams := np.unique(recording.stream)).size > 1:
        raise bad_input("recording", f"export as {schema}", "of one stream", streams.tolist())
    write = {"hall": _write_hall, "millivolts": _write_millivolts, "quaternions": _write_bag}[schema]
    return write(recording, path)


def _named_with_unit(recording: Recording, unit: str) -> list[str]:
    """Return the names of the values of a recording; those without a unit get one, if it is given."""
    said = recording.metadata.get("units")
    known = said if isinstance(said, list) and len(said) == len(recording.channels) else []
    if recording.format not in ("frames", "csv") or not unit:
        return recording.channels
    return [
        name if k < len(known) and known[k] else f"{name}_{unit}" for k, name in enumerate(recording.channels)
    ]


def _write_table(recording: Recording, path: Path, unit: str, form: str) -> list[str]:
    columns = {"time_s": recording.time_s}
    if "start_unix_s" in recording.metadata:
        start_ns = round(1e9 * recording.metadata["start_unix_s"]) - recording.metadata["start_host_ns"]
        columns["unix_s"] = (recording.host_ns + start_ns) / 1e9
    if recording.format in ("frames", "quaternions"):
        columns["stream"] = recording.stream
    sent = {name: recording.sent(name) for name in ("sequence", "device_us")}
    columns |= {name: numbers for name, numbers in sent.items() if numbers.count()}
    columns |= dict(zip(_named_with_unit(recording, unit), _or_masked(recording.values).T, strict=True))
    if form == "parquet":
        from pyarrow import parquet, table  # pyright: ignore[reportMissingImports]

        with whole_file(path) as temporary:
            parquet.write_table(table(columns), temporary)
    else:
        _write_csv(path, columns)
    widths = sorted(set(recording.widths.tolist()))
    return [f"frames have {widths[0]} to {widths[-1]} values; missing ones are empty"] if widths[1:] else []


def _or_masked(values: np.ndarray) -> np.ma.MaskedArray:
    return np.ma.array(values, mask=np.isnan(values))


def _write_csv(path: Path, columns: Mapping[str, np.ndarray]) -> None:
    """Write columns, a part of the rows at a time; what is masked is empty."""
    rows = len(next(iter(columns.values())))
    with whole_file(path) as temporary, temporary.open("w", encoding="utf-8", newline="") as stream:
        write = csv.writer(stream, lineterminator="\n")
        write.writerow(columns)
        for first in range(0, rows, _ROWS):
            part = (column[first : first + _ROWS].tolist() for column in columns.values())
            write.writerows(zip(*part, strict=True))


def _write_hall(recording: Recording, path: Path) -> list[str]:
    unix_ns, remarks = _times(recording)
    # The last field of a line is the component along the body, column 0 of the files.
    values = recording.values[:, ::-1] / _COUNTS_PER_UNIT
    rows = zip(values.tolist(), (1e-9 * unix_ns).tolist(), strict=True)
    write_whole(path, "".join(f"[{x!r} {y!r} {z!r}],{t!r}\n" for (x, y, z), t in rows))
    return [*remarks, "the loader drops the first reading, and all that follow it within 1 ms"]


def _write_millivolts(recording: Recording, path: Path) -> list[str]:
    time_s = recording.time_s
    values = zip(("u1", "u2", "u3"), _or_masked(recording.values).T, strict=True)
    _write_csv(path, dict(values) | {"time_s": time_s})  # the loader takes columns by their names
    if len(time_s) < 2:
        return []
    rate_hz = (len(time_s) - 1) / (time_s[-1] - time_s[0]) if time_s[-1] > time_s[0] else np.inf
    late = int((np.diff(time_s) > 2 / _MILLIVOLTS_HZ).sum())
    remarks = []
    if abs(rate_hz / _MILLIVOLTS_HZ - 1) > 0.02:
        remarks.append(f"{rate_hz:.1f} frames/s were recorded; the loader takes {_MILLIVOLTS_HZ:g} Hz")
    if late:
        remarks.append(
            f"{late} pauses of more than {2e3 / _MILLIVOLTS_HZ:g} ms; the loader takes equal steps of time"
        )
    return remarks


def _write_bag(recording: Recording, path: Path) -> list[str]:
    from rosbags.rosbag1 import Writer
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    unix_ns, remarks = _times(recording)
    store = get_typestore(Stores.ROS1_NOETIC)
    store.register(get_types_from_msg(_MESSAGE, _TYPE))
    message, head = store.types[_TYPE], store.types["std_msgs/msg/Header"]
    zero = store.types["builtin_interfaces/msg/Time"](sec=0, nanosec=0)
    quaternions = recording.values.astype(np.float32)
    rows = zip(recording.stream.tolist(), quaternions, unix_ns.tolist(), strict=True)
    with whole_file(path) as temporary, Writer(temporary) as bag:
        connection = bag.add_connection("/quat_meas", _TYPE, typestore=store)
        for number, (imu, (x, y, z, w), time_ns) in enumerate(rows):
            reading = message(head(number, zero, ""), ID=imu, w=w, x=x, y=y, z=z)
            bag.write(connection, time_ns, store.serialize_ros1(reading, _TYPE))
    return remarks


def _times(recording: Recording) -> tuple[Int[np.ndarray, " frames"], list[str]]:
    """Times of arrival since 1970 [ns], made to increase."""
    if "start_unix_s" not in recording.metadata:
        expected = "one that says when it started (its first block, or the file beside it)"
        raise bad_input("recording", "export", expected, "one whose start is not known")
    host_ns = recording.host_ns - recording.metadata["start_host_ns"]
    steps = np.arange(len(host_ns), dtype=np.int64) * _TIE_NS
    apart = np.maximum.accumulate(host_ns - steps) + steps
    moved = int((apart != host_ns).sum())
    unix_ns = round(1e9 * recording.metadata["start_unix_s"]) + apart
    remark = f"{moved} readings that arrived together are written {_TIE_NS / 1e3:g} µs apart"
    return unix_ns, [remark] if moved else []
