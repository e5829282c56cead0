"""What a live session knows at a moment, and the counts that it follows from."""

from __future__ import annotations

import math
import statistics
import time
from collections import deque
from dataclasses import dataclass
from typing import Literal, NamedTuple

from jaxtyping import Float
from torch import Tensor

from edition1.estimation.base import Estimate
from edition1.estimation.consistency import Status, Verdict
from edition1_live.follow.follower import Follower
from edition1_live.follow.latency import STAGES, Latencies
from edition1_live.follow.time_steps import TimeStep, TimeSteps
from edition1_live.record.summary import Summary

_WINDOW_S = 1.0
"""The rate is that of the last second or more; what happened within it happens now [s]."""
_GAP_S = 0.25
"""Readings farther apart than this are no continuous trace [s]."""
_FEW_STEPS = 3
"""Windows and gaps are at least so many time steps long, however slow the board is."""
_STEPS = 9
"""How long a time step is, is the median of so many."""
_BYTES_S = 2.5
"""Bytes without a frame that came within this time come now: the recorder tells of them once a second [s]."""

Arriving = Literal["frames", "bytes", "nothing", "no port"]


class LiveEstimate(NamedTuple):
    """One time step, estimated.

    Attributes
    ----------
    step
        What was sent.
    estimate
        What follows.
    taken_ns, done_ns
        When the estimator began and was done, by the host's monotonic clock [ns].
    """

    step: TimeStep
    estimate: Estimate
    taken_ns: int
    done_ns: int


@dataclass(frozen=True)
class LiveState:
    """What a session knows at a moment.

    Attributes
    ----------
    seconds
        Since the session began.
    time_s
        Time of the last time step with an estimate, since the first frame; NaN before there is one.
    since_s
        Time of the first time step from which they came without a gap until this one; NaN before there is one.
    readings, estimate
        Of that time step; None before there is one.
    verdict
        Whether these readings fit the robot.
    doubted
        Time steps whose readings did not.
    age_s
        Since the last estimate, or without one since the session began [s].
    silent
        Whether that is so long that the estimate is not of now.
    arriving
        What came lately: frames, bytes without a frame, nothing; or not even the port is there.
    foreign
        Why what arrives cannot be of the format, in words; empty where it is not known.
    rate_hz
        Time steps estimated per second, in the last second or more.
    estimated, dropped, refused
        Time steps with an estimate; not estimated because the estimator was too slow; not estimated because no
        reading could be used.
    dropped_now, refused_now
        Whether such ones came lately.
    refusal
        Why the last of these was refused.
    missing
        For every sensor, time steps in which it gave no number.
    missing_now
        Whether it gave none in the last one.
    other_streams
        Frames of streams that the robot does not have, by stream.
    recorded
        What the recorder counted.
    latencies
        By :data:`edition1_live.follow.latency.STAGES`.
    """

    seconds: float
    time_s: float
    since_s: float
    readings: Float[Tensor, " readings"] | None
    estimate: Estimate | None
    verdict: Verdict
    doubted: int
    age_s: float
    silent: bool
    arriving: Arriving
    foreign: str
    rate_hz: float
    estimated: int
    dropped: int
    refused: int
    dropped_now: bool
    refused_now: bool
    refusal: str
    missing: tuple[int, ...]
    missing_now: tuple[bool, ...]
    other_streams: dict[int, int]
    recorded: Summary
    latencies: dict[str, Latencies]


def trusted(state: LiveState) -> bool:
    """Whether the shape that is shown is one of now, and explains the readings."""
    return state.estimate is not None and not state.silent and state.verdict.status < Status.WRONG


class Tally:
    """Counts what happens in a session, for one thread that reads and one that estimates; none waits for the other.

    Parameters
    ----------
    follower
        Whose estimates these are.
    steps
        Where its time steps come from.
    rate_hz
        Time steps per second, as the robot file says.
    duration_s
        How long the session lasts at most [s].
    """

    def __init__(self, follower: Follower, steps: TimeSteps, rate_hz: float, duration_s: float) -> None:
        self.dropped = 0
        self._follower, self._steps = follower, steps
        self._began = time.monotonic()
        self._end = self._began + duration_s
        self._apart_s = deque([1 / rate_hz], _STEPS)
        self._rate_hz = math.nan  # as long as nothing was measured
        self._counted, self._counted_at = 0, self._began
        self._time_s = self._since_s = math.nan
        self._last: tuple[Tensor, Estimate] | None = None
        self._missing_now = (False,) * len(follower.missing)
        self._estimated_at = self._began
        self._arrived_at = self._bytes_at = self._dropped_at = self._refused_at = -math.inf
        self._lost, self._foreign = False, ""
        self._recorded = Summary(None, {"frames": 0}, 0.0)
        self._latencies = {stage: Latencies() for stage in STAGES}

    def arrived(self) -> None:
        """Frames came."""
        self._arrived_at, self._foreign = time.monotonic(), ""

    def drop(self) -> None:
        """A time step cannot be estimated, since too many wait."""
        self.dropped += 1
        self._dropped_at = time.monotonic()

    def watch(self, what: str, words: str) -> None:
        """Take what happened to the port, as from `edition1_live.record.recorder.record`."""
        self._lost = what == "lost" or (self._lost and what != "reopened")
        self._foreign = words if what == "foreign" else ""

    @property
    def verdict(self) -> Verdict:
        """On the readings of the last time step."""
        return self._follower.verdict

    def note(self, summary: Summary) -> None:
        """Take what the recorder counted."""
        before, now = self._recorded.counters, summary.counters
        if now["received_bytes"] > before.get("received_bytes", 0) and now["frames"] == before["frames"]:
            self._bytes_at = time.monotonic()
        self._recorded = summary

    def step(self, step: TimeStep) -> LiveEstimate | None:
        """Estimate a time step."""
        taken_ns, before = time.monotonic_ns(), tuple(self._follower.missing)
        u, estimate = self._follower.step(step)
        done_ns = time.monotonic_ns()
        self._missing_now = tuple(a > b for a, b in zip(self._follower.missing, before, strict=True))
        if estimate is None:
            self._refused_at = 1e-9 * done_ns
            return None
        moments = (step.arrival_ns, step.parsed_ns, taken_ns, done_ns)
        for stage, start, end in zip(STAGES, moments, moments[1:], strict=False):
            self._latencies[stage].add(1e-9 * (end - start))
        self._latencies["total"].add(1e-9 * (done_ns - step.arrival_ns))
        apart_s = step.time_s - self._time_s
        if not (apart_s <= _GAP_S or apart_s <= _FEW_STEPS * statistics.median(self._apart_s)):
            self._since_s = step.time_s
        if not math.isnan(apart_s):
            self._apart_s.append(apart_s)
        self._time_s, self._estimated_at, self._last = step.time_s, 1e-9 * done_ns, (u, estimate)
        return LiveEstimate(step, estimate, taken_ns, done_ns)

    def tick(self, ended: bool) -> None:
        """Measure the rate, if it is time; nothing is measured, and no silence lasts, after the end."""
        now, done = time.monotonic(), self._follower.estimated
        passed_s = now - self._counted_at
        if ended:
            self._end = min(self._end, now)
        elif now < self._end and passed_s >= _WINDOW_S and passed_s >= self._window_s():
            self._rate_hz = (done - self._counted) / passed_s
            self._counted, self._counted_at = done, now

    def _window_s(self) -> float:
        return max(_WINDOW_S, _FEW_STEPS * statistics.median(self._apart_s))

    def state(self) -> LiveState:
        """Sum it up."""
        now, window_s, follower = min(time.monotonic(), self._end), self._window_s(), self._follower
        seconds, age_s = now - self._began, max(0.0, now - self._estimated_at)
        readings, estimate = self._last or (None, None)
        arriving: Arriving = "nothing"
        if self._lost:
            arriving = "no port"
        elif now - self._arrived_at < window_s:
            arriving = "frames"
        elif now - self._bytes_at < _BYTES_S:
            arriving = "bytes"
        return LiveState(
            seconds=seconds,
            time_s=self._time_s,
            since_s=self._since_s,
            readings=readings,
            estimate=estimate,
            verdict=follower.verdict,
            doubted=follower.estimated - follower.consistency[Status.CONSISTENT],
            age_s=age_s,
            silent=age_s > window_s,
            arriving=arriving,
            foreign=self._foreign,
            rate_hz=follower.estimated / max(seconds, 1e-3) if math.isnan(self._rate_hz) else self._rate_hz,
            estimated=follower.estimated,
            dropped=self.dropped,
            refused=follower.refused,
            dropped_now=now - self._dropped_at < window_s,
            refused_now=now - self._refused_at < window_s,
            refusal=follower.refusal,
            missing=tuple(follower.missing),
            missing_now=self._missing_now,
            other_streams=dict(self._steps.others),
            recorded=self._recorded,
            latencies=self._latencies,
        )
