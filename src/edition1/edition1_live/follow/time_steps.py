"""From frames to time steps: the frames of one moment together, with a time that an estimator can take."""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from itertools import groupby
from typing import NamedTuple

from edition1.robot_file.robot_file import RobotFile
from edition1_live.robot.readings_file import Readings, stream_widths
from edition1_live.wire.frame import WRAP, Frame

_PLAUSIBLE_S = 2.0
"""A board whose clock says this much more than the host's arrivals was reset [s]."""
_SHORTEST_S = 1e-6
"""Time from one step to the next, at least [s]: estimators want times that increase."""


class TimeStep(NamedTuple):
    """What the streams of a robot sent at one time.

    Attributes
    ----------
    time_s
        Since the first frame [s]: by the clock of the board, or where it sends none by arrival.
    arrival_ns
        Arrival of its last bytes, by the host's monotonic clock [ns].
    parsed_ns
        When its frames were read out of them, by the same clock [ns].
    frames
        One of each stream, in their order; None where one is missing.
    """

    time_s: float
    arrival_ns: int
    parsed_ns: int
    frames: tuple[Frame | None, ...]


class TimeSteps:
    """Puts frames together: a step is complete when every stream has sent, or when one sends again.

    Parameters
    ----------
    streams
        Streams of the robot; frames of others are counted and left out.
    rate_hz
        Steps per second: frames that arrive together and have no time of their own are spread by it.

    Attributes
    ----------
    others
        How many frames of other streams came, by stream.

    Examples
    --------
    The first of two IMUs sends twice in a row, since the second one failed:

    >>> steps = TimeSteps((0, 1), 30.0)
    >>> frames = [Frame(stream, None, None, (float(k),)) for k, stream in enumerate((0, 1, 0, 0))]
    >>> [[f and f.values[0] for f in step.frames] for step in steps.add(10**9, frames)]
    [[0.0, 1.0], [2.0, None]]
    """

    def __init__(self, streams: Sequence[int], rate_hz: float) -> None:
        self.others: dict[int, int] = {}
        self._place = {stream: k for k, stream in enumerate(streams)}
        self._rate_hz = rate_hz
        self._waiting: list[Frame | None] = [None] * len(self._place)
        self._time_s = 0.0
        self._before: tuple[float, int | None] | None = (
            None  # arrival [s] and time of the board of the last step
        )

    def add(self, arrival_ns: int, frames: Sequence[Frame]) -> list[TimeStep]:
        """Take frames that arrived together; return the steps that they complete, in order."""
        complete: list[tuple[Frame | None, ...]] = []
        for frame in frames:
            place = self._place.get(frame.stream)
            if place is None:
                self.others[frame.stream] = self.others.get(frame.stream, 0) + 1
                continue
            if self._waiting[place] is not None:
                complete.append(self._taken())
            self._waiting[place] = frame
            if None not in self._waiting:
                complete.append(self._taken())
        parsed_ns, steps = time.monotonic_ns(), []
        for behind, together in zip(reversed(range(len(complete))), complete, strict=True):
            sent_us = next((frame.device_us for frame in together if frame is not None), None)
            time_s = self._time(1e-9 * arrival_ns - behind / self._rate_hz, sent_us)
            steps.append(TimeStep(time_s, arrival_ns, parsed_ns, together))
        return steps

    def _taken(self) -> tuple[Frame | None, ...]:
        together = tuple(self._waiting)
        self._waiting[:] = [None] * len(self._place)
        return together

    def _time(self, host_s: float, sent_us: int | None) -> float:
        """Time since the first step: it increases, whatever the clocks do."""
        before, self._before = self._before, (host_s, sent_us)
        if before is None:
            return 0.0
        passed_s = host_s - before[0]
        if sent_us is not None and before[1] is not None:
            # one wrap is 72 minutes: a longer silence is told by the host alone
            device_s = 1e-6 * ((sent_us - before[1]) % WRAP)
            if device_s < passed_s + _PLAUSIBLE_S:
                passed_s = device_s
        self._time_s += max(passed_s, _SHORTEST_S)
        return self._time_s


def time_steps(readings: Readings, robot: RobotFile) -> Iterator[list[TimeStep]]:
    """Yield the time steps that frames complete, those that arrived together at once, as a port gives them."""
    steps = TimeSteps(tuple(stream_widths(robot)), robot.rate_hz)
    for arrival_ns, group in groupby(readings.frames, key=lambda pair: pair[0]):
        yield steps.add(arrival_ns, [frame for _, frame in group])
