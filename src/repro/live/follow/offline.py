"""A recording, or a table of readings, estimated as a live session would: same time steps, same estimator."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from itertools import groupby
from pathlib import Path

from tqdm import tqdm

from repro.errors import bad_input
from repro.estimation.base import Estimate
from repro.estimation.consistency import STATUS
from repro.live.follow.follower import Follower
from repro.live.follow.readings_table import read_table
from repro.live.follow.robot_estimator import RobotEstimator
from repro.live.follow.time_steps import TimeStep, TimeSteps
from repro.live.record.recording import Recording, read_recording
from repro.live.record.recording_file import MAGIC, sidecar_path
from repro.live.wire.csv_text import check_units
from repro.live.wire.frame import Frame

QUATERNION = 4


@dataclass(frozen=True)
class Readings:
    """What was recorded.

    Attributes
    ----------
    frames
        Arrival [ns] and frame, in order.
    start_s
        Time of the first frame in the recording or the table [s].
    notes
        What was left out, one sentence each.
    """

    frames: Sequence[tuple[int, Frame]]
    start_s: float
    notes: list[str]


@dataclass
class Tracked:
    """What became of a recording.

    Attributes
    ----------
    follower
        The estimator behind the last time step, and its counters.
    seconds
        How long it took.
    notes
        What was left out, one sentence each.
    consistency
        How many estimates are consistent, suspicious, wrong; zeros where the estimator does not say.
    """

    follower: Follower
    seconds: float = 0.0
    notes: list[str] = field(default_factory=list)
    consistency: list[int] = field(default_factory=lambda: [0] * len(STATUS))

    def lines(self) -> list[str]:
        """Return the summary in words: estimates, consistency, and what could not be used."""
        follower = self.follower
        rate = f", {follower.estimated / self.seconds:.0f} per second" if self.seconds else ""
        said = [f"{follower.estimated} estimates by {follower.estimator.name} in {self.seconds:.1f} s{rate}."]
        if sum(self.consistency):
            counts = zip(self.consistency, STATUS, strict=True)
            said.append(f"Consistency: {', '.join(f'{n} {word}' for n, word in counts)}.")
        if follower.refused:
            said.append(f"{follower.refused} time steps without an estimate. {follower.refusal}")
        for name, count in zip(follower.estimator.sensors, follower.missing, strict=True):
            if count:
                said.append(f"{name} gave no reading in {count} time steps and was left out there.")
        return said + self.notes


def read_readings(path: Path, estimator: RobotEstimator) -> Readings:
    """Read what an estimator takes: a recording of `repro record`, or a CSV as `repro export` writes it.

    Raises
    ------
    InputError
        If the file is not there, is neither, or does not fit the robot.
    """
    if not path.is_file():
        raise bad_input(
            "file", "repro track", "a recording, or a CSV of readings", f"{path}, which is not there"
        )
    with path.open("rb") as stream:
        head = stream.read(4096)
    if head.startswith(MAGIC) or b"\0" in head or sidecar_path(path).is_file():
        return _recorded(read_recording(path), path.name, estimator)
    frames, start_s, notes = read_table(path, estimator)
    return Readings(frames, start_s, notes)


def _recorded(recording: Recording, name: str, estimator: RobotEstimator) -> Readings:
    robot = estimator.robot
    if recording.format != robot.format:
        raise bad_input("recording", robot.name, f"of the format {robot.format}", recording.format)
    units = recording.metadata.get("units")
    if recording.format == "csv" and isinstance(units, list) and len(units) == len(recording.channels):
        check_units(recording.channels, units, robot.unit if robot.channel else None)
    width = QUATERNION if estimator.positions else robot.channels
    frames = list(recording.as_frames())
    fitting = [
        (ns, frame)
        for ns, frame in frames
        if len(frame.values) == width or frame.stream not in estimator.streams
    ]
    notes = []
    if lost := recording.torn_bytes + recording.damaged_bytes:
        notes.append(f"{lost} bytes of {name} are not whole and were left out.")
    if others := len(frames) - len(fitting):
        notes.append(f"{others} frames have another number of values than {width} and were left out.")
    if not any(frame.stream in estimator.streams for _, frame in fitting):
        found = sorted({len(frame.values) for _, frame in frames})
        expected = f"one with frames of {width} values, as described in {robot.name}"
        raise bad_input("recording", name, expected, f"{len(frames)} frames of {found} values")
    first_ns = next(ns for ns, frame in fitting if frame.stream in estimator.streams)
    return Readings(fitting, 1e-9 * (first_ns - recording.metadata["start_host_ns"]), notes)


def time_steps(readings: Readings, steps: TimeSteps) -> Iterator[list[TimeStep]]:
    """Yield the time steps that frames complete, those that arrived together at once, as a port gives them."""
    for arrival_ns, group in groupby(readings.frames, key=lambda pair: pair[0]):
        yield steps.add(arrival_ns, [frame for _, frame in group])


def track_readings(
    readings: Readings,
    estimator: RobotEstimator,
    each: Callable[[float, Estimate], None],
    *,
    progress: bool = False,
    seed: int = 0,
) -> Tracked:
    """Estimate readings at full speed, by the same steps as live.

    Parameters
    ----------
    readings
        From :func:`read_readings`.
    estimator
        As for a live session.
    each
        Is given time [s] and estimate of every time step that has one.
    progress
        Show a progress bar.
    seed
        Of estimators that draw random numbers.
    """
    steps = TimeSteps(estimator.streams, estimator.robot.rate_hz)
    tracked = Tracked(Follower(estimator, seed=seed), notes=list(readings.notes))
    began = time.monotonic()
    with tqdm(total=len(readings.frames), unit="frames", disable=not progress) as bar:
        counted = 0
        for complete in time_steps(readings, steps):
            for step in complete:
                _, estimate = tracked.follower.step(step)
                if estimate is None:
                    continue
                if (status := estimate.diagnostics.get("status")) is not None:
                    tracked.consistency[int(status)] += 1
                each(readings.start_s + step.time_s, estimate)
            used = sum(frame is not None for step in complete for frame in step.frames)
            counted += used
            bar.update(used)
        bar.update(len(readings.frames) - counted)
    tracked.seconds = time.monotonic() - began
    if steps.others:
        streams = ", ".join(f"{stream} ({n} frames)" for stream, n in steps.others.items())
        tracked.notes.append(f"Streams that {estimator.robot.name} does not have: {streams}.")
    return tracked
