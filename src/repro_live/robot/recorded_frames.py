"""Which frames of a recording are those of a robot; what the others are is said."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable

import numpy as np
from jaxtyping import Bool

from repro.errors import bad_input
from repro.robot_file.parts import MAGNETIC_STREAM
from repro.robot_file.robot_file import RobotFile
from repro.robot_file.tables import UPRIGHT
from repro_live.record.recording import Recording
from repro_live.wire.csv_text import check_units


def stream_widths(robot: RobotFile) -> dict[int, int]:
    """Return the streams of a robot, in the order of a time step, and how many values a frame of each has.

    Examples
    --------
    >>> from repro.robot_file.load import load_robot
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
    if recording.format == "csv" and isinstance(units, list) and len(units) == len(recording.channels):
        check_units(recording.channels, units, robot.unit if robot.channel else None)
    widths, streams = stream_widths(robot), recording.frames["stream"].to_numpy()
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
    return fits, notes + other_streams(robot, streams.tolist())


def other_streams(robot: RobotFile, streams: Iterable[int]) -> list[str]:
    """Say of which streams there are frames that the robot does not have; empty if of none."""
    own = stream_widths(robot)
    found = Counter(stream for stream in streams if stream not in own)
    said = ", ".join(f"{stream} ({n} frames)" for stream, n in found.items())
    return [f"Streams that {robot.name} does not have: {said}."] if found else []
