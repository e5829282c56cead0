"""A page about a recording: shape, readings, alarms and notes over time, in one file that asks for no other."""

from __future__ import annotations

import html
import json
import re
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pandas as pd

from repro.common import Array, bad_input, new, printable, require
from repro.estimators.monitor import STATUS, TRUSTED
from repro.robot import Robot
from repro.robot_file import load_robot
from repro_board.evaluate import NOT_WRITTEN, track_file
from repro_board.export import configurations, estimates_table
from repro_board.record import Note, is_recording, read_recording, readings_of
from repro_board.report import MEANING, Report, written
from repro_board.shape_view import MOST_FRAMES, PAGE, VIEWER, Json, View, cells, view

FRAMES, ROWS = 1200, 2000
"""So many shapes, and so many rows of the lines, are drawn of a longer recording."""
_OWNER = "repro show"
_WELL, _TRUSTED = ("consistent", "unchecked"), [STATUS[number] for number in TRUSTED]
_LEFT_OUT = {"left out": "what is named does not fit the other readings, and the shape does without it"}
_DAY_S = 86400.0


class Seen(NamedTuple):
    """What there is to show.

    Estimates are a table as ``repro track`` writes it, and the same as ``q`` ``[t, n_q]``, perhaps with covariances.
    Readings ``[t, s]`` have times [s] of their own.
    """

    robot: Robot
    frame: pd.DataFrame
    q: Array
    covariance: Array | None
    times: Array
    readings: Array
    notes: Sequence[Note]
    words: list[str]


def show_file(
    source: Path | str, robot: Path | str, output: Path | str, *, estimates: Path | str | None = None
) -> Report:
    """Write a page about a recording, readings or estimates as a new HTML file; without estimates they are made."""
    path, source = new(output, _OWNER), Path(source)
    is_page = path.suffix.lower() in (".html", ".htm")
    require(is_page, "output", _OWNER, "a file whose name ends in .html", path.name)
    seen = read(source, robot, estimates)
    text, words = page(seen, source.name)
    return Report("\n".join([*seen.words, *words, written(path, text, _OWNER)]), seen.frame)


def read(path: Path, robot: Path | str, estimates: Path | str | None = None) -> Seen:
    """Read what there is to show; without estimates they are made."""
    require(path.is_file(), "file", _OWNER, "one that exists", path)
    arm, source, notes, name = load_robot(robot), path, (), path.name
    if is_recording(path):
        source = read_recording(path)
        require(source.samples, "recording", name, "one with samples", "none")
        notes = source.notes
    head = path.read_bytes()[:4000].splitlines()[:1]
    alone = {b"time_s", b"chi2", b"status"} <= {label for line in head for label in line.split(b",")}
    if alone:
        must = "left out where the file itself holds estimates"
        require(estimates is None, "estimates", _OWNER, must, estimates)
        frame, none = estimates_table(path), np.zeros((0, len(arm.names)))
        return Seen(arm, frame, configurations(arm, frame, name), None, np.zeros(0), none, notes, [])
    if estimates is None:
        report = track_file(source, robot)
        shape, words = report.found, [line for line in report.text.splitlines() if line != NOT_WRITTEN]
        frame = shape.to_frame()
        return Seen(arm, frame, shape.q, shape.covariance, shape.times, shape.readings, notes, words)
    u = readings_of(arm, source)
    if u.times is None:
        raise bad_input("times", name, "given (a column time_s)", "none")
    frame = estimates_table(estimates, u.times)
    q = configurations(arm, frame, Path(estimates).name)
    return Seen(arm, frame, q, None, u.times, np.asarray(u), notes, list(u.remarks))


def page(seen: Seen, name: str) -> tuple[str, list[str]]:
    """Return a page, and what is to be said of it."""
    times = seen.frame["time_s"].to_numpy(float)
    began = float(np.floor(times[0])) if abs(times[0]) > _DAY_S else 0.0
    seen, times = seen._replace(times=seen.times - began), times - began
    said, code = _said(seen.frame)
    edges = np.flatnonzero(np.diff(code, prepend=-1, append=-1)).tolist()
    alarms = [(first, end - 1) for first, end in pairwise(edges) if said[code[first]]["level"]]
    known = np.flatnonzero(np.isfinite(seen.q).all(1))
    rows = _rows_shown(known, [first for first, _ in alarms])
    shape = _shape(seen, times, rows, [said[k]["named"] for k in code[rows]])
    charts = _charts(seen, times)
    moments = np.concatenate([times, seen.times, [note.time_s for note in seen.notes]])
    told = {
        "from": float(moments.min()),
        "to": float(max(moments.max(), moments.min() + 1e-3)),
        "said": said,
        "at": code[rows].tolist(),
        "alarms": [[times[a], times[b], b - a + 1, int(code[a])] for a, b in alarms],
        "notes": sorted(seen.notes),
        "charts": charts,
    }
    thinned = any(chart["thinned"] for chart in charts)
    remarks = {
        f"{len(rows)} of {len(known)} shapes are drawn; the alarms are all there.": len(rows) < len(known),
        "Lines are drawn through the least and the largest of every few values.": thinned,
        f"Times count from {began:.0f} s.": began,
    }
    words = [text for text, holds in remarks.items() if holds]
    return _written_out(seen, name, shape, told, words), words


def _said(frame: pd.DataFrame) -> tuple[list[Json], Array]:
    """Return all that is said of rows, and which of it is said of every row.

    The level is 0 if all is well, 1 if the shape is to be trusted all the same, else 2.
    """
    named = frame["suspects"].astype(object).fillna("") if "suspects" in frame else [""] * len(frame)
    pairs = list(zip(frame["status"].astype(str), named, strict=True))
    number = {pair: k for k, pair in enumerate(dict.fromkeys(pairs))}
    said = [
        {
            "words": f"{status} ({who})" if who else status,
            "named": who,
            "meaning": (MEANING | _LEFT_OUT).get(status, ""),
            "level": 0 if status in _WELL and not who else 1 if status in _TRUSTED else 2,
        }
        for status, who in number
    ]
    return said, np.array([number[pair] for pair in pairs])


def _rows_shown(known: Array, alarms: list[int]) -> Array:
    """Return rows for shapes, of those that are known: evenly many, and where alarms begin."""
    even = known[np.linspace(0, len(known) - 1, min(FRAMES, len(known))).astype(int)]
    began = np.intersect1d(alarms, known)[: MOST_FRAMES - len(even)]
    return np.union1d(even, began.astype(int))


def _shape(seen: Seen, times: Array, rows: Array, named: list[str]) -> View:
    """Return the shapes of some rows, with the sensors that are suspected in each."""
    C = None if seen.covariance is None else seen.covariance[rows]
    label, most = "The estimated shape over time.", MOST_FRAMES
    found = view(seen.robot, seen.q[rows], times[rows], label, covariance=C, estimated=True, frames=most)
    number = {name: k for k, name in enumerate(seen.robot.part_names[: len(seen.robot.sensors)])}
    frames = [[number[who] for who in text.split(", ") if who in number] for text in named]
    found.data["widest"] = 2 * found.data["radius"]  # else what nobody knows would hide the rest
    if any(frames):
        found.data["suspects"] = {"name": "suspected", "frames": frames}
    return found


def _charts(seen: Seen, times: Array) -> list[Json]:
    """Return the lines over time: readings, and the tip."""
    names, n = seen.robot.names, seen.robot.n_magnetic
    tip = seen.frame[[f"tip_{axis}_mm" for axis in "xyz"]].to_numpy(float)
    charts = []
    for title, labels, at, values in (
        ("Readings [mT]", names[:n], seen.times, seen.readings[:, :n]),
        ("Rotation vectors of IMUs [rad]", names[n:], seen.times, seen.readings[:, n:]),
        ("Tip [mm]", ["x", "y", "z"], times, tip),
    ):
        if values.size:
            at_shown, rows = _extremes(at, values)
            chart = {"title": title, "names": labels, "thinned": len(rows) < len(values)}
            chart |= {"time_s": at_shown.round(6).tolist(), "rows": [cells(row) for row in rows]}
            charts.append(chart | {"gap_s": max(1.0, 5 * float(np.ptp(at)) / len(rows))})
    return charts


def _extremes(times: Array, values: Array) -> tuple[Array, Array]:
    """Return the rows, or of many the least and the largest values in equal parts of them."""
    if len(times) <= ROWS:
        return times, values
    edges = np.linspace(0, len(times), ROWS // 2 + 1).astype(int)
    ends = np.stack([times[edges[:-1]], times[edges[1:] - 1]], axis=1)
    both = [extreme.reduceat(values, edges[:-1]) for extreme in (np.fmin, np.fmax)]
    return ends.ravel(), np.stack(both, axis=1).reshape(-1, values.shape[1])


def _written_out(seen: Seen, name: str, shape: View, told: Json, words: list[str]) -> str:
    """Return the page as text."""
    robot = printable(seen.robot.source.name) if seen.robot.source else "a robot"
    span_s = np.ptp(seen.frame["time_s"])
    about = f"{len(seen.frame)} estimates over {span_s:.4g} s, for {robot}."
    # An end of a script in a name must not end the element.
    data = json.dumps(told, separators=(",", ":"), allow_nan=False).replace("<", "\\u003c")
    scripts = [path.read_text(encoding="utf-8") for path in (VIEWER, PAGE / "traces.js", PAGE / "show.js")]
    parts = {
        "title": html.escape(printable(name)),
        "about": html.escape(" ".join([about, *words])),
        "words": "".join(f"<p>{html.escape(line)}</p>" for line in seen.words or ["They were read."]),
        "style": (PAGE / "live.css").read_text(encoding="utf-8"),
        "shape": shape.to_html(),
        "data": f'<script id="told" type="application/json">{data}</script>',
        "script": "".join(f"<script>{script}</script>\n" for script in scripts),
    }
    template = (PAGE / "show.html").read_text(encoding="utf-8")
    return re.sub(r"<!-- (\w+) -->", lambda place: parts[place[1]], template)
