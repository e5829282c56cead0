"""From the samples of a board's streams to time steps of a robot: the readings of one moment together."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from repro import Robot
from repro.common import Array, InputError, require
from repro.tables import Table, read_readings
from repro_board.wire import WRAP, Sample

_NUMBERED = re.compile(r"(u|ch|channel|sensor)[ _]?[0-9]+", re.IGNORECASE)
_EARLY_S, _LATE_S = 1.0, 2.0
"""A board whose clock differs from arrival by more than these, since the step before, began anew [s]."""
_SHORTEST_S = 1e-6
_LEAST_STEPS = 20
"""So many steps tell how many there are per second."""


class Step(NamedTuple):
    """Readings ``[s]`` of a robot at one time [s]; NaN where nothing came."""

    time_s: float
    u: Array


class Steps:
    """Puts the samples of a robot's streams together.

    Times are on the axis of the arrivals that are given, and increase. Stream 0 has the readings of magnetic sensors: each of its samples is a step, beside which IMUs keep what they
    said last. Of IMUs alone a step is complete when all have sent, or when one sends again. An IMU that misses three
    of its turns is silent: its readings are missing. What the columns of stream 0 mean is found as in a table.

    Parameters
    ----------
    robot
        Whose readings they are.
    times
        ``board``: by its clock, where it sends one; or ``arrival``.
    source
        What the samples come from, whose ``names`` and ``units`` say what the values are: a parser or a recording.
        Without it they are the channels 1, 2, 3 and so on, in the unit of the robot.

    Attributes
    ----------
    counters
        Steps, and samples of other streams or with another number of values, which are left out.
    remarks
        What a user should know, one sentence each.

    Examples
    --------
    >>> import repro
    >>> robot = repro.Robot([repro.Link(0.1)], imus=[repro.Imu(1, 0.05), repro.Imu(1, 0.1)])
    >>> steps = Steps(robot)
    >>> upright = np.array([0.0, 0.0, 0.0, 1.0])
    >>> [len(steps.add(Sample(k, None, None, 0, upright), 0.1 * k)) for k in (1, 2, 1, 2)]
    [0, 1, 0, 1]
    """

    def __init__(self, robot: Robot, times: str = "board", source: Any = None) -> None:
        require(times in ("board", "arrival"), "times", "Steps", "board or arrival", repr(times))
        self.counters = {"steps": 0, "other_streams": 0, "other_widths": 0}
        self.remarks: list[str] = []
        self._robot, self._times, self._source = robot, times, source
        channels = [k if imu.channels is None else imu.channels for k, imu in enumerate(robot.imus, 1)]
        own = {int(x): 4 for x in channels if isinstance(x, int | float)}
        magnetic = bool(robot.sensors) or len(own) < len(channels)
        require(not magnetic or 0 not in own, "stream", "an IMU", "above 0: that is the magnetic sensors'", 0)
        self._widths: dict[int, int] = {0: 0, **own} if magnetic else own  # 0: not known yet
        self._magnetic = magnetic
        self._leaders = {0} if magnetic else set(own)
        self._values: dict[int, Array] = {stream: np.full(4, np.nan) for stream in own}
        self._fresh: set[int] = set()
        self._age = dict.fromkeys(self._widths, 1)  # steps since a stream sent, and how many are usual
        self._usual = dict.fromkeys(self._widths, 1.0)
        self._waiting, self._usual_waiting = 0, 0.0  # samples since the last step, and how many are usual
        self._table: Table | None = None
        self._time_us: int | None = None  # of the last sample
        self._before: tuple[float, float, int | None] | None = (
            None  # step before: time, arrival [s], board [µs]
        )
        self._first_s = 0.0

    def add(self, sample: Sample, arrived_s: float) -> list[Step]:
        """Take a sample and when it arrived [s]; return the steps that it completes."""
        return self.feed([sample], arrived_s)

    def feed(self, samples: Sequence[Sample], arrived_s: float) -> list[Step]:
        """Take samples that arrived together [s]; return the steps that they complete.

        Those without a time of their own are spread over the time since the samples before.

        Raises
        ------
        InputError
            If the robot has a reading that the board does not send, or sends in another unit.
        """
        rows = [row for sample in samples for row in self._put(sample)]
        if not rows:
            return []
        u = self._readings(np.array([row for row, _ in rows]))
        times = self._when([time_us for _, time_us in rows], arrived_s)
        self.counters["steps"] += len(rows)
        return [Step(time_s, row) for time_s, row in zip(times, u, strict=True)]

    def _put(self, sample: Sample) -> list[tuple[Array, int | None]]:
        """Take the values of a sample; return what is complete, with the time of its last sample."""
        stream, values = sample.stream, sample.values
        if stream not in self._widths:
            self.counters["other_streams"] += 1
            self._remark(f"The robot has no stream {stream}: its samples are left out.")
            return []
        if len(values) != (self._widths[stream] or len(values)):
            self.counters["other_widths"] += 1
            self._remark(f"Samples of stream {stream} do not have {self._widths[stream]} values: left out.")
            return []
        self._widths[stream] = len(values)
        rows = [self._row(self._time_us)] if stream in self._fresh else []
        self._usual[stream] += (min(self._age[stream], 4 * self._usual[stream]) - self._usual[stream]) / 8
        self._values[stream], self._age[stream], self._time_us = values, 0, sample.time_us
        self._fresh |= {stream} & self._leaders
        self._waiting += 1
        if all(x in self._fresh or self._silent(x) for x in self._leaders):
            self._usual_waiting += (self._waiting - self._usual_waiting) / 8
            rows.append(self._row(sample.time_us))
        elif 0 in self._values and self._waiting > 4 * self._usual_waiting + 4 * len(self._widths):
            self._age[0] = 1 << 30  # the magnetic sensors are silent: go on with the IMUs
            rows.append(self._row(sample.time_us))
        return rows

    def _silent(self, stream: int) -> bool:
        return self._age[stream] > 2 * self._usual[stream]

    def _row(self, time_us: int | None) -> tuple[Array, int | None]:
        parts = [np.full(n, np.nan) if self._silent(k) else self._values[k] for k, n in self._widths.items()]
        self._age = {stream: age + 1 for stream, age in self._age.items()}
        self._fresh, self._waiting = set(), 0
        return np.concatenate(parts), time_us

    def _readings(self, rows: Array) -> Array:
        """Return readings ``[t, s]`` of rows of values: as those of a table with the same columns."""
        first = self._table is None
        table = self._columns(rows) if self._table is None else self._table
        self._table = table._replace(values=rows, lines=range(1, len(rows) + 1))
        found = read_readings(self._robot, self._table)
        for text in found.remarks if first else ():
            self._remark(text)
        return np.asarray(found)

    def _columns(self, rows: Array) -> Table:
        """Return a table of the rows; names that mean no channel are those of the channels in their order."""
        n = self._widths[0] if self._magnetic else 0
        numbered = tuple(f"u{k + 1}" for k in range(n))
        said, units = (tuple(getattr(self._source, x, ())) for x in ("names", "units"))
        names = said if len(said) == n else numbered
        units = tuple("raw" if unit == "counts" else unit for unit in units) if len(units) == n else ("",) * n
        imus = [f"q{axis}_{stream}" for stream in list(self._widths)[self._magnetic :] for axis in "xyzw"]
        columns = *names, *imus
        units = *units, *[""] * len(imus)
        table = Table("the board", columns, columns, units, rows, range(1, len(rows) + 1), None)
        others = [numbered, self._robot.names[:n]]
        if n != sum(sensor.axes for sensor in self._robot.sensors) or any(map(_NUMBERED.fullmatch, said)):
            return table
        while others:
            try:
                read_readings(self._robot, table)
                break
            except InputError:
                own = others.pop(0)
                table = table._replace(columns=(*own, *imus), names=(*own, *imus))
                self._remark(f"{', '.join(names)} are taken for {', '.join(own)}, in this order.")
        return table

    def _when(self, sent_us: Sequence[int | None], arrived_s: float) -> list[float]:
        """Return the times of steps that arrived together: they increase, whatever the clocks do."""
        n, steps, found = len(sent_us), self.counters["steps"], []
        usual_s = 1.0 / (self._robot.rate_hz or 100.0)
        if self._before is None:
            self._first_s = arrived_s - (n - 1) * usual_s
            self._before = self._first_s - usual_s, self._first_s - usual_s, None
        time_s, before_s, before_us = self._before
        if steps > _LEAST_STEPS:  # a rate that is stated too low would make time run ahead
            usual_s = min(usual_s, (time_s - self._first_s) / steps)
        gap_s = arrived_s - before_s
        spread_s = min(max((arrived_s - time_s) / n, usual_s / 4), usual_s) if gap_s > 0 else usual_s
        end_s = max(arrived_s, time_s + n * spread_s)
        for behind, time_us in zip(reversed(range(n)), sent_us, strict=True):
            passed_s = end_s - behind * spread_s - time_s
            if self._times == "board" and time_us is not None and before_us is not None:
                by_board_s = 1e-6 * ((time_us - before_us + WRAP // 2) % WRAP - WRAP // 2)
                if -_EARLY_S < by_board_s < gap_s + _LATE_S:
                    passed_s = by_board_s
            time_s, before_us = time_s + max(passed_s, _SHORTEST_S), time_us
            found.append(time_s)
        self._before = time_s, arrived_s, before_us
        return found

    def _remark(self, text: str) -> None:
        if text not in self.remarks:
            self.remarks.append(text)
