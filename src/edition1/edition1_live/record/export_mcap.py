"""A recording as an mcap file, with JSON messages that say their own schema: Foxglove and PlotJuggler open it.

======================= ================================================================================
topic                   a message
======================= ================================================================================
``/readings``           a frame: ``time_s``, ``sequence`` and ``device_us`` as in the table, and its values by their
                        names; where a recording has several streams, one topic for each, ``/readings/3``
``/estimate``           a row of a table of estimates, and from its deviations and correlations the
                        ``covariance`` of the coordinates and the ``tip_covariance``, in products of their units
``/health``             an event of the port or of a session; and as the last one, ``end``, all counters
======================= ================================================================================

The time of a message is that of arrival since 1970 by the computer's clock [ns], as ``unix_s`` of the table; since
the start of the recording where that is not known. A number comes out bit for bit; one that is missing or not
finite is not in its message.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from edition1.errors import bad_input, require
from edition1.files import whole_file
from edition1_live.record.recording import Recording
from edition1_live.robot.number_table import read_rows

_WORDS = "consistency"
"""The column of a table of estimates that holds words."""
_WHOLE = ("sequence", "device_us")
_LATE_S, _LATE_SHARE = 1.0, 1e-3
"""By so much, and this share of the recording, estimates may lie outside it: they have the clock of the board."""
Message = tuple[int, str, dict[str, Any]]
"""Time [ns], topic and content."""


def write_mcap(recording: Recording, path: Path, names: Sequence[str], estimates: Path | None) -> list[str]:
    """Write a recording, and the estimates made from it; return what the file does not hold as it was recorded.

    Parameters
    ----------
    recording, path
        As for `edition1_live.record.export.export`.
    names
        Of the values.
    estimates
        A table of `repro track`, `repro smooth` or `repro live`.

    Raises
    ------
    InputError
        If the table is no such table, or not of this recording.
    """
    from mcap.writer import Writer

    start_ns = 0
    remarks = []
    if "start_unix_s" in recording.metadata:
        start_ns = round(1e9 * recording.metadata["start_unix_s"])
    else:
        remarks.append("when it started is not known: times count from its start, as if that were 1970")
    infinite = int(np.isinf(recording.values).sum())
    if infinite:
        remarks.append(f"{infinite} infinite values are left out")
    messages = [*_readings(recording, names), *_health(recording)]
    if estimates is not None:
        messages += _estimates(recording, estimates)
    messages.sort(key=lambda message: message[0])
    topics = dict.fromkeys(topic for _, topic, _ in messages)
    schemas = {topic: _schema(topic, (c for _, t, c in messages if t == topic)) for topic in topics}
    with whole_file(path) as temporary, temporary.open("wb") as stream:
        writer = Writer(stream)
        writer.start(library="repro")
        channels = {}
        for topic, schema in schemas.items():
            number = writer.register_schema(schema["title"], "jsonschema", json.dumps(schema).encode())
            channels[topic] = writer.register_channel(topic, "json", number)
        for ns, topic, content in messages:
            data = json.dumps(content, allow_nan=False).encode()
            writer.add_message(channels[topic], start_ns + ns, data, start_ns + ns)
        writer.add_metadata("recording", {name: json.dumps(v) for name, v in recording.metadata.items()})
        writer.finish()
    return remarks


def _readings(recording: Recording, names: Sequence[str]) -> Iterator[Message]:
    start_ns, streams = recording.metadata["start_host_ns"], recording.stream.tolist()
    several = len(set(streams)) > 1
    sent = [recording.sent(name).tolist() for name in _WHOLE]
    columns = (
        recording.host_ns.tolist(),
        streams,
        recording.time_s.tolist(),
        *sent,
        recording.values.tolist(),
    )
    for host_ns, stream, time_s, *whole, row in zip(*columns, strict=True):
        content: dict[str, Any] = {"time_s": time_s}
        content |= {name: x for name, x in zip(_WHOLE, whole, strict=True) if x is not None}
        content |= {name: x for name, x in zip(names, row, strict=True) if math.isfinite(x)}
        yield host_ns - start_ns, f"/readings/{stream}" if several else "/readings", content


def _health(recording: Recording) -> Iterator[Message]:
    metadata, start_ns = recording.metadata, recording.metadata["start_host_ns"]
    end_ns = int(recording.host_ns.max()) - start_ns
    for note in recording.notes:
        at_ns = note.get("host_ns")
        ns = at_ns - start_ns if isinstance(at_ns, int) else end_ns
        yield ns, "/health", {"time_s": ns / 1e9, **{k: v for k, v in note.items() if k != "host_ns"}}
    counted = {"torn_bytes": recording.torn_bytes, "damaged_bytes": recording.damaged_bytes}
    counted |= metadata.get("counters", {})
    yield end_ns, "/health", {"time_s": end_ns / 1e9, "event": "end", **counted}


def _estimates(recording: Recording, path: Path) -> Iterator[Message]:
    rows = read_rows(path)
    head = rows[0][1] if rows else []
    if not {"time_s", "tip_x_mm"} <= set(head) or len(rows) < 2:
        raise bad_input("estimates", path.name, "a table of repro track, smooth or live", ", ".join(head))
    last_s = float(recording.time_s.max())
    spare_s = _LATE_S + _LATE_SHARE * last_s
    for line, cells in rows[1:]:
        if len(cells) != len(head):
            raise bad_input(f"line {line}", path.name, f"of {len(head)} cells, as the header", len(cells))
        content = {}
        for name, cell in zip(head, cells, strict=True):
            if cell:
                content[name] = cell if name == _WORDS else _number(path, line, name, cell)
        time_s = content.get("time_s", math.nan)
        if not -spare_s <= time_s <= last_s + spare_s:
            expected = f"within the recording, 0 to {last_s:.3f} s"
            raise bad_input(f"time_s in line {line}", path.name, expected, time_s)
        yield round(1e9 * time_s), "/estimate", content | _covariances(content)


def _number(path: Path, line: int, name: str, cell: str) -> float:
    try:
        value = float(cell)
    except ValueError:
        value = math.nan
    require(math.isfinite(value), f"{name} in line {line}", path.name, "a number", repr(cell))
    return value


def _covariances(content: Mapping[str, Any]) -> dict[str, list[list[float]]]:
    """Return the covariances that the deviations and correlations of a row say, as far as it has them all."""
    found = {}
    split = [name.rpartition("_sd_") for name in content if "_sd_" in name]
    for name, of_tip in (("covariance", False), ("tip_covariance", True)):
        own = [(a, f"{a}_sd_{unit}") for a, _, unit in split if a.startswith("tip_") is of_tip]
        try:
            matrix = [[content[s] * content[t] * _correlation(content, a, b) for b, t in own] for a, s in own]
        except KeyError:  # none where a deviation is zero, or not finite
            continue
        if matrix:
            found[name] = matrix
    return found


def _correlation(content: Mapping[str, Any], a: str, b: str) -> float:
    if a == b:
        return 1.0
    there = f"{a}__{b}_correlation"
    return content[there if there in content else f"{b}__{a}_correlation"]


def _schema(topic: str, contents: Iterable[Mapping[str, Any]]) -> dict[str, Any]:
    """Return the JSON schema of all messages of a topic; a message may lack what another has."""
    properties = {name: _kind(value) for content in contents for name, value in content.items()}
    return {"title": f"repro{topic.replace('/', '.')}", "type": "object", "properties": properties}


def _kind(value: object) -> dict[str, Any]:
    if isinstance(value, list):
        return {"type": "array", "items": _kind(value[0])} if value else {"type": "array"}
    return {"type": "string" if isinstance(value, str) else "number"}
