"""Readings of one's own: a recording, or a CSV table, as the time steps that estimators take live."""

# pyright: reportArgumentType=false, reportCallIssue=false, reportAttributeAccessIssue=false

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import groupby
from pathlib import Path

import numpy as np
from jaxtyping import Float

from repro.errors import bad_input
from repro.live.follow.robot_estimator import MAGNETIC_STREAM
from repro.live.follow.time_steps import TimeStep, TimeSteps
from repro.live.own.tables import read_timed
from repro.live.record.recording import read_recording
from repro.live.record.recording_file import MAGIC
from repro.live.robot.robot_file import RobotFile
from repro.live.robot.robot_tables import UNITS
from repro.live.wire.frame import Frame

MOST_LEFT_OUT = 0.05
"""Share of the frames of a recording that may be of another width."""


@dataclass(frozen=True)
class TimedReadings:
    """Readings over time.

    Parameters
    ----------
    steps
        As estimators take them; times by the board's clock where it sends one, else by arrival.
    signal
        Readings of the sensors without the offsets of the robot file [unit]; NaN where one is missing.
    notes
        What was left out.
    """

    steps: tuple[TimeStep, ...]
    signal: Float[np.ndarray, "steps s"]
    notes: tuple[str, ...]

    @property
    def time_s(self) -> Float[np.ndarray, " steps"]:
        """Times of the steps [s]."""
        return np.array([step.time_s for step in self.steps])

    def counted_from(self, start_s: float) -> TimedReadings:
        """Return the same with another zero of the clock [s]."""
        return replace(self, steps=tuple(s._replace(time_s=s.time_s - start_s) for s in self.steps))


def read_own_readings(path: Path, robot: RobotFile) -> TimedReadings:
    """Read a recording of ``repro record``, or a CSV with a time column and a column for each reading.

    Raises
    ------
    InputError
        If the file does not fit the robot; the message names column and line.
    """
    if path.is_file():
        with path.open("rb") as stream:
            if stream.read(len(MAGIC)) == MAGIC:
                return _recorded(path, robot)
        if path.suffix == ".rec":
            read_recording(path)  # says what is wrong with it
    time_s, table = read_timed(path, "readings")
    if len(table.columns) != robot.channels:
        expected = f"time and {robot.channels} readings, the channels of {robot.name}"
        raise bad_input("columns", path.name, expected, f"{len(table.columns)}: {', '.join(table.columns)}")
    for name in table.columns:
        ending = name.rsplit("_", 1)[-1].lower()
        if ending in {unit.lower() for unit in UNITS} - {robot.unit.lower()}:
            raise bad_input(f"column {name}", path.name, f"in {robot.unit}, the unit of {robot.name}", name)
    frames = [Frame(MAGNETIC_STREAM, None, None, tuple(row)) for row in table.to_numpy().tolist()]
    steps = tuple(TimeStep(t, 0, 0, (frame,)) for t, frame in zip(time_s.tolist(), frames, strict=True))
    return _timed(steps, robot, ())


def _recorded(path: Path, robot: RobotFile) -> TimedReadings:
    recording = read_recording(path)
    if recording.format != robot.format:
        expected = f"of the format {robot.format}, as described in {robot.name}"
        raise bad_input("recording", path.name, expected, recording.format)
    if len(recording.frames) < 3:
        raise bad_input("recording", path.name, "of at least three frames", len(recording.frames))
    fits = recording.widths == robot.channels
    other = len(fits) - int(fits.sum())
    if other > MOST_LEFT_OUT * len(fits):
        expected = f"of frames of {robot.channels} values, the channels of {robot.name}"
        raise bad_input("recording", path.name, expected, f"{other} of {len(fits)} frames of another number")
    together = TimeSteps((MAGNETIC_STREAM,), robot.rate_hz)
    steps: list[TimeStep] = []
    for host_ns, frames in groupby(recording.as_frames(), key=lambda pair: pair[0]):
        steps += together.add(host_ns, [frame for _, frame in frames if len(frame.values) == robot.channels])
    start_s = float(recording.frames["time_s"].iloc[0])
    notes = [f"{other} frames of another number of values were left out."] if other else []
    if recording.damaged_bytes:
        notes.append(f"{recording.damaged_bytes} damaged bytes of the recording were left out.")
    if together.others:
        notes.append(f"{sum(together.others.values())} frames of other streams were left out.")
    return _timed(tuple(s._replace(time_s=start_s + s.time_s) for s in steps), robot, tuple(notes))


def _timed(steps: tuple[TimeStep, ...], robot: RobotFile, notes: tuple[str, ...]) -> TimedReadings:
    frames = [frame for step in steps for frame in step.frames if frame is not None]
    signal = np.array([robot.signal(frame.values).numpy() for frame in frames])
    if missing := int(np.isnan(signal).any(axis=1).sum()):
        notes = (*notes, f"{missing} frames lack a reading.")
    rate_hz = 1.0 / float(np.median(np.diff([step.time_s for step in steps])))
    if not 0.8 < rate_hz / robot.rate_hz < 1.25:
        notes = (*notes, f"{rate_hz:.4g} frames/s, where {robot.name} says {robot.rate_hz:g}.")
    return TimedReadings(steps, signal, notes)
