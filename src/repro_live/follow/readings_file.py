"""Readings in a file: a recording or a table, as the frames and time steps that a live session would take."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import compress, groupby
from pathlib import Path

from repro.errors import bad_input
from repro.robot_file.robot_file import RobotFile
from repro_live.follow.readings_table import read_table
from repro_live.follow.time_steps import TimeStep, TimeSteps
from repro_live.record.recording import read_recording
from repro_live.record.recording_file import MAGIC, sidecar_path
from repro_live.robot.recorded_frames import frames_of, stream_widths
from repro_live.wire.frame import Frame


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


def time_steps(readings: Readings, robot: RobotFile) -> Iterator[list[TimeStep]]:
    """Yield the time steps that frames complete, those that arrived together at once, as a port gives them."""
    steps = TimeSteps(tuple(stream_widths(robot)), robot.rate_hz)
    for arrival_ns, group in groupby(readings.frames, key=lambda pair: pair[0]):
        yield steps.add(arrival_ns, [frame for _, frame in group])
