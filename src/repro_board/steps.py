"""From the samples of a board's streams to time steps of a robot: the readings of one moment together."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from repro import Robot
from repro.common import Array, InputError, require
from repro.readings import Columns, check_orientations, columns_of, losses, rows_of, taken_in_order
from repro.tables import Table, cut_turn, spread
from repro_board.wire import WRAP, Parser, Sample

_NUMBERED = re.compile(r"(u|ch|channel|sensor)[ _]?[0-9]+", re.IGNORECASE)
_EARLY_S, _LATE_S = 1.0, 2.0
"""A board whose clock differs from arrival by more than these, since the step before, began anew [s]."""
_SHORTEST_S = 1e-6
_LEAST_STEPS = 20
"""So many steps tell how many there are per second, and whether orientations are mounted as the robot says."""
STILL = 10
"""A clock that shows one time in more steps in a row stands still, or is too coarse to be used."""
JUMPED = "The board's clock jumped, or the board began anew: times go on from those of arrival."
STANDS_STILL = "The board's clock stands still, or is too coarse: times are those of arrival."


class Labels(NamedTuple):
    """Names and units of values, and how they were sent, as far as somebody says it."""

    names: tuple[str, ...] = ()
    units: tuple[str, ...] = ()
    format: str | None = None


NO_LABELS = Labels()


class Step(NamedTuple):
    """Readings ``[s]`` of a robot at one time [s]; NaN where nothing came."""

    time_s: float
    u: Array


class Steps:
    """Puts the samples of a robot's streams together.

    Stream 0 has the readings of magnetic sensors: each of its samples is a step, beside which IMUs keep what they
    said last. Of IMUs alone a step is complete when all have sent, or when one sends again. An IMU that misses three
    of its turns is silent: its readings are missing. What the values of stream 0 mean is found as in a table, and
    :meth:`repro.Robot.missing` says of each row what is missing: how samples are divided among calls changes nothing.

    Times begin with the first arrival that is given, and increase. Samples that arrived together belong in one call
    of `feed`, which spreads them where they have no time of their own. Steps of one time are as far apart as those of
    the time before. A clock that shows one time in more than ten steps stands still: times are those of arrival.
    After a jump of the clock they go on from the arrival.

    Parameters
    ----------
    robot
        Whose readings they are. The number of an IMU's stream is in its ``channels``; 1, 2 and so on if not given.
    source
        What the samples come from, whose ``names`` and ``units`` say what the values are: a parser, or labels.
        Without it they are the channels 1, 2, 3 and so on, in the unit of the robot.

    Attributes
    ----------
    counters
        Steps, samples of other streams or with another number of values, which are left out, and jumps of the clock.
    remarks
        What a user should know, one sentence each.

    Examples
    --------
    >>> import repro
    >>> robot = repro.Robot([repro.Link(0.1)], imus=[repro.Imu(1, 0.05), repro.Imu(1, 0.1)])
    >>> steps = Steps(robot)
    >>> upright = np.array([0.0, 0.0, 0.0, 1.0])
    >>> [len(steps.feed([Sample(k, None, None, 0, upright)], 0.1 * k)) for k in (1, 2, 1, 2)]
    [0, 1, 0, 1]
    """

    def __init__(self, robot: Robot, source: Parser | Labels = NO_LABELS) -> None:
        self.counters = {"steps": 0, "other_streams": 0, "other_widths": 0, "clock_jumps": 0}
        self.remarks: list[str] = []
        self._losses = np.zeros((4, robot.n_readings), dtype=int)
        self._robot, self._source = robot, source
        channels = [k if imu.channels is None else imu.channels for k, imu in enumerate(robot.imus, 1)]
        own = {int(x): 4 for x in channels if isinstance(x, int | float)}
        self._magnetic = bool(robot.sensors) or len(own) < len(channels)
        if self._magnetic:
            require(0 not in own, "stream", "an IMU", "above 0, which is that of magnetic sensors", 0)
        self._widths: dict[int, int] = {0: 0, **own} if self._magnetic else own  # 0: not known yet
        self._leaders = {0} if self._magnetic else set(own)
        self._values: dict[int, Array] = {stream: np.full(4, np.nan) for stream in own}
        self._fresh: set[int] = set()
        self._order: list[int] | None = []  # streams that came before the first row
        self._age = dict.fromkeys(self._widths, 1)  # steps since a stream sent, and how many are usual
        self._usual = dict.fromkeys(self._widths, 1.0)
        self._table: Table | None = None  # without rows
        self._columns: Columns | None = None
        self._seen: list[Array] = []  # the first rows, by which orientations are checked
        self._sent: float | None = None  # time of the last sample
        self._before: tuple[float, float] | None = None  # time and arrival of the step before [s]
        # When the board's clock changed last: time [s] and clock [µs]; its steps, and how far apart such are.
        self._tick: tuple[float, float | None] = (0.0, None)
        self._alike, self._apart_s = 1, 1.0 / (robot.rate_hz or 100.0)
        self._first_s = 0.0

    def feed(self, samples: Sequence[Sample], arrived_s: float) -> list[Step]:
        """Take samples that arrived together [s]; return the steps that they complete.

        Raises
        ------
        InputError
            If the robot has a reading that the board does not send, or sends in another unit.
        """
        rows = [row for sample in samples for row in self._put(sample, sample.time_us)]
        if not rows:
            return []
        values = np.array([row for row, _ in rows])
        if self._columns is None:
            self._table = self._named(values[:0])
            self._columns = columns_of(self._robot, self._table, [])
        u, counts = rows_of(self._robot, self._columns, values)
        self._losses += counts
        self._check(values)
        times = self._when([sent_us for _, sent_us in rows], arrived_s)
        self.counters["steps"] += len(rows)
        return [Step(time_s, row) for time_s, row in zip(times, u, strict=True)]

    def losses(self) -> list[str]:
        """Return what is missing of the steps so far, one sentence for each kind of loss."""
        return losses(self._robot, self._losses)

    def table(self, samples: Sequence[Sample], times: Array, owner: str) -> Table:
        """Return the rows that the samples of a whole recording complete, as a table, by the times given [s]."""
        found = [
            row for sample, t in zip(samples, times.tolist(), strict=True) for row in self._put(sample, t)
        ]
        received = " ".join([f"{len(samples)} samples.", *self.remarks])
        require(found, "recording", owner, "one with readings of the robot", received)
        rows, at = zip(*found, strict=True)
        table = self._named(np.array(rows))
        return table._replace(owner=owner, times=spread(np.array(at), table.lines, owner, self.remarks))

    def _check(self, values: Array) -> None:
        """Say once, by the first rows, if the orientations of IMUs are not as the robot says."""
        more = values[: _LEAST_STEPS - len(self._seen)] if self._robot.imus else values[:0]
        self._seen += list(more)
        if self._table and self._columns and len(more) and len(self._seen) == _LEAST_STEPS:
            table = self._table._replace(values=np.array(self._seen), lines=range(1, _LEAST_STEPS + 1))
            try:
                check_orientations(self._robot, self._columns, table)
            except InputError as error:
                self.remarks.insert(0, str(error))

    def _put(self, sample: Sample, sent: float | None) -> list[tuple[Array, float | None]]:
        """Take the values of a sample and its time; return what is complete, with the time of its last sample."""
        stream, width = sample.stream, self._widths.get(sample.stream)
        expected = width or len(self._source.names) or len(sample.values)
        fits = width is not None and len(sample.values) == expected
        if not fits:
            self.counters["other_streams" if width is None else "other_widths"] += 1
            other = "are none of the robot's" if width is None else f"have other than {expected} values"
            if (text := f"Samples of stream {stream} {other}: left out.") not in self.remarks:
                self.remarks.append(text)
            return []
        rows = [self._row()] if stream in self._fresh or self._began_before(sample) else []
        self._widths[stream], self._values[stream] = len(sample.values), sample.values
        usual = self._usual[stream]
        self._usual[stream] += (min(self._age[stream], 4 * usual) - usual) / 8
        self._age[stream], self._sent = 0, sent
        self._fresh |= {stream} & self._leaders
        if all(leader in self._fresh or self._silent(leader) for leader in self._leaders):
            rows.append(self._row())
        return rows

    def _began_before(self, sample: Sample) -> bool:
        """Return whether a turn begins with this sample, and what came so far is the end of the one before.

        Times tell turns; without them the numbers of the streams do.
        """
        if self._order is None or sample.time_us is not None:
            return False
        self._order.append(sample.stream)
        return cut_turn(self._order, [*self._leaders]) == len(self._order) - 1 > 0

    def _silent(self, stream: int) -> bool:
        return self._age[stream] > 2 * self._usual[stream]

    def _row(self) -> tuple[Array, float | None]:
        parts = [np.full(n, np.nan) if self._silent(k) else self._values[k] for k, n in self._widths.items()]
        self._age = {stream: age + 1 for stream, age in self._age.items()}
        self._fresh, self._order = set(), None
        return np.concatenate(parts), self._sent

    def _named(self, rows: Array) -> Table:
        """Return a table of rows. Names that mean no channel are those of channels or readings in their order."""
        n = self._widths[0] if self._magnetic else 0
        said, units = tuple(self._source.names), tuple(self._source.units)
        bare = "mT" if all(sensor.unit == "mT" for sensor in self._robot.sensors) else ""
        units = (
            tuple("raw" if x == "counts" else x or bare for x in units) if len(units) == n else (bare,) * n
        )
        imus = [f"q{axis}_{stream}" for stream in list(self._widths)[self._magnetic :] for axis in "xyzw"]
        numbered = tuple(f"u{k + 1}" for k in range(n))
        names = said if len(said) == n else numbered
        # Of values without names any may be the one too many, unless the robot says which channels it takes.
        by_number = self._source.format in (None, "frames")
        by_number &= all(sensor.channels is not None for sensor in self._robot.sensors)
        columns = names if len(said) == n or by_number else [f"column {k + 1}" for k in range(n)]
        lines, units = range(1, len(rows) + 1), (*units, *[""] * len(imus))
        table = Table("the board", (*columns, *imus), (*names, *imus), units, rows, lines, None)
        in_order = n == self._robot.n_magnetic and not any(map(_NUMBERED.fullmatch, said))
        table, words = taken_in_order(self._robot, table, n) if in_order else (table, [])
        self.remarks[:0] = words
        return table

    def _when(self, sent_us: Sequence[float | None], arrived_s: float) -> list[float]:
        """Return the times of steps that arrived together: they increase, whatever the clocks do."""
        n, found = len(sent_us), list[float]()
        usual_s = 1.0 / (self._robot.rate_hz or 100.0)
        if self._before is None:
            self._first_s = arrived_s - (n - 1) * usual_s
            self._before = self._first_s - usual_s, self._first_s - usual_s
        time_s, before_s = self._before
        gap_s, spread_s = arrived_s - before_s, self._apart(n, usual_s, arrived_s, self._before)
        end_s = max(arrived_s, time_s + n * spread_s)
        for behind, time_us in zip(reversed(range(n)), sent_us, strict=True):
            passed_s = self._passed(time_us)
            by_clock_s = self._by_clock(passed_s, gap_s)
            at_s = end_s - behind * spread_s if by_clock_s is None else by_clock_s
            time_s = max(at_s, time_s + _SHORTEST_S)
            if passed_s != 0:  # the clock shows another time, or none
                self._tick = at_s if at_s > self._tick[0] else time_s, time_us
            found.append(time_s)
        self._before = time_s, arrived_s
        return found

    def _apart(self, n: int, usual_s: float, arrived_s: float, before: tuple[float, float]) -> float:
        """Return the time between steps that arrived together, where no clock tells it."""
        (time_s, before_s), steps = before, self.counters["steps"]
        if steps > _LEAST_STEPS:  # by a rate that is stated too low time would run ahead
            usual_s = min(usual_s, (time_s - self._first_s) / (steps - 1))
        if arrived_s <= before_s:
            return usual_s
        return min(max((arrived_s - time_s) / n, usual_s / 4), usual_s)

    def _passed(self, time_us: float | None) -> float:
        """Return the time that has passed by the clock of the board; infinite where there is none."""
        last_us = self._tick[1]
        if time_us is None or last_us is None:
            return math.inf
        return 1e-6 * ((time_us - last_us + WRAP // 2) % WRAP - WRAP // 2)

    def _by_clock(self, passed_s: float, gap_s: float) -> float | None:
        """Return the time of a step by the clock of the board; None where the clock is not to be believed."""
        tick_s, alike = self._tick[0], self._alike
        self._alike = alike + 1 if passed_s == 0 else 1
        if self._alike > STILL and STANDS_STILL not in self.remarks:
            self.remarks.append(STANDS_STILL)
        if 1 < self._alike <= STILL:
            return tick_s + alike * self._apart_s
        if passed_s != 0 and alike <= STILL and -_EARLY_S < passed_s < gap_s + _LATE_S:
            self._apart_s = passed_s / alike
            return tick_s + passed_s
        within = -_EARLY_S < passed_s < alike * gap_s + _LATE_S
        if alike <= STILL and not within and math.isfinite(passed_s):
            self.counters["clock_jumps"] += 1
            self.remarks += [JUMPED] * (JUMPED not in self.remarks)
        return None
