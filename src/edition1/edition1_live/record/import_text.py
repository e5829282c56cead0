"""Readings of others as a recording: a table with named columns, or lines as a sketch printed them.

A table has a header and cells apart by commas, semicolons or tabs. Every row must be whole; an empty cell is a
reading that is missing. Anything else is read as `repro record` reads lines of ``csv``, header or not: what does not
have the form of the others is left out, counted and said.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from edition1.errors import bad_input, require
from edition1.files import whole_file
from edition1_live.record.recording_file import RecordingFile, check_new, write_sidecar
from edition1_live.record.summary import Summary
from edition1_live.robot.number_table import numbers_of, times_of, whole_numbers
from edition1_live.wire.csv_fields import read_header, separator_of, time_scale
from edition1_live.wire.csv_text import MOST_VALUES, CsvParser, Layout, name_and_unit
from edition1_live.wire.formats import channel_names, parser
from edition1_live.wire.frame import WRAP, Frame

_ABSOLUTE_S = 1e7
"""Times from here on are no times since a start: they are counted from the first one."""


@dataclass(frozen=True)
class _Read:
    """What a file holds: times [s], or none; frames; names and units of the values; the start, where it is said."""

    time_s: np.ndarray | None
    frames: list[Frame]
    names: list[str]
    units: list[str]
    summary: Summary
    start_unix_s: float | None = None


def import_text(
    path: Path, output: Path, *, format: str = "", rate_hz: float | None = None, unit: str = ""
) -> tuple[Summary, list[str]]:
    """Make a recording of a text file.

    Parameters
    ----------
    path
        The text, in UTF-8. A column of times has its unit (``time_s``, ``t_ms``, ``millis``); ``stream``,
        ``sequence``, ``device_us`` and ``unix_s`` are as `repro export` writes them; all others are values.
    output
        The recording, a new file. It is there when it is whole.
    format
        What a robot file calls the stream of the board; by default ``csv``, or ``frames`` with several streams.
    rate_hz
        Readings per second, of a file without times.
    unit
        Of the values whose names say none.

    Returns
    -------
    summary, notes
        What was read and left out; what the recording does not hold as the file has it.

    Raises
    ------
    InputError
        If the file is not there, is no such text, has no times or two, or does not have what the format has; or the
        recording exists.
    """
    check_new(output, "repro import")
    require(path.is_file(), "file", "repro import", "a text file", f"{path}, which is not there")
    try:
        text = path.read_text(encoding="utf-8-sig")
    except UnicodeDecodeError as error:
        raise bad_input("file", path.name, "text in UTF-8", error) from error
    separator = _table_separator(text)
    read = _table(path.name, text, separator) if separator else _lines(path.name, text)
    if (read.time_s is None) != (rate_hz is not None):
        expected = "left out: the file has times" if rate_hz else "given: the file has no column of times"
        raise bad_input("rate", "repro import", expected, rate_hz or "none")
    require(rate_hz is None or 0 < rate_hz < math.inf, "rate", "repro import", "above zero [Hz]", rate_hz)
    several = any(frame.stream for frame in read.frames)
    format = format or ("frames" if several else "csv")
    width = len(read.names)
    parser(format, width)  # refuses an unknown format, and one of another number of values
    require(not (several and format not in ("frames", "quaternions")), "format", path.name, "frames", format)
    numbers = [int(found[1]) for name in read.names if (found := re.match(r"\D*(\d+)", name))]
    if len(numbers) == width and numbers != sorted(numbers):
        raise bad_input("columns", path.name, "in the order of their numbers", ", ".join(read.names))
    names = [name if said else f"{name}_{unit}" * bool(unit) or name for name, said in _both(read)]
    notes = []
    if format != "csv" and names != (own := channel_names(format, width)):
        notes.append(f"{', '.join(names)} are called {', '.join(own)}, as those of {format}")
        names = own
    time_s = np.arange(len(read.frames)) / (rate_hz or 1.0) if read.time_s is None else read.time_s
    first_s = float(time_s[0]) if abs(time_s[0]) >= _ABSOLUTE_S else 0.0
    if first_s:
        notes.append(f"times are counted from the first one, {first_s:.6f} s")
    head: dict[str, Any] = {"format": format, "channels": names, "start_host_ns": 0, "source": path.name}
    head |= (
        {"units": [said or unit for said in read.units]}
        if format in ("csv", "frames") and not several
        else {}
    )
    head |= {} if read.start_unix_s is None else {"start_unix_s": read.start_unix_s}
    arrivals_ns = np.round((time_s - first_s) * 1e9).astype(np.int64).tolist()
    with whole_file(output) as temporary, RecordingFile(temporary, head) as file:
        for host_ns, frame in zip(arrivals_ns, read.frames, strict=True):
            file.append(host_ns, [frame])
    summary = Summary(output, read.summary.counters, read.summary.seconds, read.summary.refused)
    write_sidecar(output, head | {"ended": "imported", "counters": summary.counters})
    return summary, notes


def _both(read: _Read) -> Iterator[tuple[str, str]]:
    return zip(read.names, read.units, strict=True)


def _table_separator(text: str) -> str:
    """Return what separates the cells of a table; none if the text does not begin with a header and a row."""
    lines = [line for line in text.splitlines() if line.strip() and not line.startswith("#")][:2]
    if len(lines) < 2 or not read_header(lines[0]):
        return ""
    separator = separator_of(lines[0].strip())
    cells = [line.count(separator) for line in lines]
    return separator if separator != " " and cells[0] == cells[1] else ""


def _table(owner: str, text: str, separator: str) -> _Read:
    table = numbers_of(owner, text, separator)
    known = ("unix_s", "host_ns", "stream", "sequence", "device_us")
    timed = any(time_scale(*name_and_unit(name)) is not None for name in table.columns)
    time_column, time_s = times_of(owner, table, apart=False) if timed else ("", None)
    values = [name for name in table.columns if name not in (time_column, *known)]
    count = f"1 to {MOST_VALUES} columns of values"
    require(1 <= len(values) <= MOST_VALUES, "table", owner, count, ", ".join(table.columns))
    require(table.lines, "table", owner, "at least one row", 0)
    numbers = zip(
        whole_numbers(owner, table, "stream", 1 << 16),
        whole_numbers(owner, table, "sequence", WRAP),
        whole_numbers(owner, table, "device_us", WRAP),
        strict=True,
    )
    rows = zip(numbers, table.rows(values).tolist(), strict=True)
    frames = [Frame(stream or 0, sequence, us, tuple(row)) for (stream, sequence, us), row in rows]
    layout = Layout(separator, ("",) * len(values), ("",) * len(values), False, tuple(values))
    seconds = 0.0 if time_s is None else float(time_s[-1] - time_s[0])
    start = None
    if "unix_s" in table.columns and time_s is not None and math.isfinite(table.columns["unix_s"][0]):
        start = float(table.columns["unix_s"][0] - time_s[0])
    summary = Summary(None, {"frames": len(frames)}, seconds)
    return _Read(time_s, frames, layout.names, layout.value_units, summary, start)


def _lines(owner: str, text: str) -> _Read:
    lines = CsvParser(wrap=1 << 62)
    frames = lines.feed(b"\n")  # a file begins with a whole line, so that nothing is dropped
    frames += lines.feed(text.replace("\r\n", "\n").replace("\r", "\n").encode() + b"\n")
    lines.counters.first_partial = 0
    if lines.layout is None:
        expected = "a table of numbers with a header, or lines of numbers of one form, three at least"
        raise bad_input("file", owner, expected, lines.refused or "no such line")
    time_s = None
    if frames[0].device_us is not None:
        sent_us = np.array([frame.device_us for frame in frames])
        if (back := np.flatnonzero(np.diff(sent_us) < 0)).size:
            k = int(back[0])
            expected = "not before the time before (cut the file where the board began anew)"
            received = f"one {1e-6 * (sent_us[k] - sent_us[k + 1]):g} s before that"
            raise bad_input(f"time of the line of numbers {k + 2}", owner, expected, received)
        time_s = sent_us / 1e6
        frames = [frame._replace(device_us=int(us) % WRAP) for frame, us in zip(frames, sent_us, strict=True)]
    seconds = 0.0 if time_s is None else float(time_s[-1] - time_s[0])
    summary = Summary(None, lines.counters.as_dict(), seconds, lines.refused)
    return _Read(time_s, frames, lines.layout.names, lines.layout.value_units, summary)
