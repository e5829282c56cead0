"""A live session: one thread reads and records a port, this one estimates what has arrived.

Between the two is a queue of a quarter of a second. When the estimator is too slow it is full, and what arrives then
is not estimated: the newest goes first, what waits stays in order. That is counted and said; the recording keeps
everything.
"""

from __future__ import annotations

import gc
import math
import queue
import sys
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

from jaxtyping import Float
from torch import Tensor

from repro.errors import bad_input
from repro.estimation.base import Estimate
from repro.live.follow.latency import STAGES, Latencies
from repro.live.follow.robot_estimator import Follower, RobotEstimator
from repro.live.follow.time_steps import TimeStep, TimeSteps
from repro.live.record.recorder import Summary, record
from repro.live.wire.frame import Frame

QUEUE_S, SHORTEST_QUEUE = 0.25, 8
"""What waits for the estimator: time steps of so many seconds, at least so many."""
IDLE_S = 0.1
"""How often the session looks around when nothing arrives [s]."""
SHOW_S = 0.05
"""Time between two states that are shown [s]."""
SWITCH_S = 5e-4
"""After this time a thread lets another one work [s]; 5 ms, as usual, would be longer than an estimate takes."""
RATE_S = 1.0
"""The rate is that of the last second or more [s]."""


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
    readings, estimate
        Of that time step; None before there is one.
    rate_hz
        Time steps estimated per second.
    estimated, dropped, refused
        Time steps with an estimate; not estimated because the estimator was too slow; not estimated because no
        reading could be used.
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
        By :data:`repro.live.follow.latency.STAGES`.
    """

    seconds: float
    time_s: float
    readings: Float[Tensor, " readings"] | None
    estimate: Estimate | None
    rate_hz: float
    estimated: int
    dropped: int
    refused: int
    refusal: str
    missing: tuple[int, ...]
    missing_now: tuple[bool, ...]
    other_streams: dict[int, int]
    recorded: Summary
    latencies: dict[str, Latencies]


def follow(
    port: str,
    estimator: RobotEstimator,
    *,
    output: Path | None = None,
    baud: int = 115200,
    duration_s: float = math.inf,
    stop: threading.Event | None = None,
    show: Callable[[LiveState], None] | None = None,
    each: Callable[[LiveEstimate], None] | None = None,
    warn: Callable[[str], None] = print,
    seed: int = 0,
) -> LiveState:
    """Estimate from a port until told to stop, and record it.

    Parameters
    ----------
    port, baud
        As for `repro.live.record.ports.open_port`.
    estimator
        From :func:`repro.live.follow.robot_estimator.robot_estimator`.
    output
        The recording, as for `repro.live.record.recorder.record`; none by default.
    duration_s
        Stop after this time [s].
    stop
        Stop when this is set, from a signal or another thread.
    show
        Is given the state every :data:`SHOW_S`; the estimator waits for it.
    each
        Is given every estimate; the estimator waits for it.
    warn
        Is given what the user should know at once; also from the reader's thread.
    seed
        Of estimators that draw random numbers.

    Returns
    -------
    LiveState
        The state at the end.

    Raises
    ------
    InputError
        As `repro.live.record.recorder.record`, and if frames have another number of values than the robot file says.
    WriteFailed
        The disk is full or refuses. What was written is kept.
    """
    if not duration_s > 0:
        raise bad_input("duration", "repro live", "a time above zero [s]", duration_s)
    estimator.prepared()
    session = _Session(estimator, stop or threading.Event(), warn, seed)
    reader = threading.Thread(target=session.read, args=(port, output, baud, duration_s), daemon=True)
    with _undisturbed():
        reader.start()
        try:
            session.estimate(show, each)
        finally:
            session.stop.set()
            reader.join()
    if session.failure is not None:
        raise session.failure
    return session.state()


@contextmanager
def _undisturbed() -> Iterator[None]:
    """Keep the interpreter from long pauses of its own."""
    before = sys.getswitchinterval()
    sys.setswitchinterval(SWITCH_S)
    gc.collect()
    gc.freeze()  # looking through all that torch and others have made takes a tenth of a second
    try:
        yield
    finally:
        gc.unfreeze()
        sys.setswitchinterval(before)


class _Session:
    def __init__(
        self,
        estimator: RobotEstimator,
        stop: threading.Event,
        warn: Callable[[str], None],
        seed: int,
    ) -> None:
        self.estimator, self.stop, self.warn = estimator, stop, warn
        robot = estimator.robot
        self.steps = TimeSteps(estimator.streams, robot.rate_hz)
        self.follower = Follower(estimator, seed=seed)
        self.queue: queue.SimpleQueue[TimeStep] = queue.SimpleQueue()  # only one thread puts
        self.longest = max(SHORTEST_QUEUE, math.ceil(QUEUE_S * robot.rate_hz))
        self.dropped = 0
        self.ended = threading.Event()
        self.failure: BaseException | None = None
        self.recorded = Summary(None, {"frames": 0}, 0.0)
        self.latencies = {stage: Latencies() for stage in STAGES}
        self.began = self.counted_at = time.monotonic()
        self.counted = 0
        self.rate_hz = 0.0
        self.last: tuple[float, Tensor, Estimate] | None = None
        self.missing_now = tuple(False for _ in estimator.sensors)

    def read(self, port: str, output: Path | None, baud: int, duration_s: float) -> None:
        """Record; in a thread of its own."""
        robot = self.estimator.robot
        # Frames of ours that have another number of values can be told from garbage, and are in `step`.
        channels = robot.channels or None if robot.format in ("millivolts", "csv") else None
        try:
            self.recorded = record(
                port, robot.format, output, baud=baud, channels=channels, duration_s=duration_s, stop=self.stop,
                show=self.note, warn=self.warn, each=self.put, unit=robot.unit,
            )  # fmt: skip
        except BaseException as error:  # belongs to the thread that estimates
            self.failure = error
        finally:
            self.ended.set()

    def note(self, summary: Summary) -> None:
        self.recorded = summary

    def put(self, arrival_ns: int, frames: Sequence[Frame]) -> None:
        for step in self.steps.add(arrival_ns, frames):
            if self.queue.qsize() < self.longest:
                self.queue.put(step)
                continue
            if not self.dropped:
                self.warn(
                    "Overload: the estimator is slower than the stream. What arrives while "
                    f"{self.longest} time steps wait is not estimated, only recorded."
                )
            self.dropped += 1

    def estimate(
        self,
        show: Callable[[LiveState], None] | None,
        each: Callable[[LiveEstimate], None] | None,
    ) -> None:
        """Estimate until the reader has ended and nothing waits."""
        shown = time.monotonic()
        while not (self.ended.is_set() and self.queue.empty()):
            try:
                step = self.queue.get(timeout=IDLE_S)
            except queue.Empty:
                pass
            else:
                self.one(step, each)
            now = time.monotonic()
            if now - self.counted_at >= RATE_S and not self.ended.is_set():
                done = self.follower.estimated
                self.rate_hz = (done - self.counted) / (now - self.counted_at)
                self.counted, self.counted_at = done, now
            if show is not None and now - shown >= SHOW_S:
                shown = now
                show(self.state())

    def one(self, step: TimeStep, each: Callable[[LiveEstimate], None] | None) -> None:
        taken_ns = time.monotonic_ns()
        before = list(self.follower.missing)
        u, estimate = self.follower.step(step)
        done_ns = time.monotonic_ns()
        self.missing_now = tuple(a > b for a, b in zip(self.follower.missing, before, strict=True))
        if estimate is None:
            return
        moments = (step.arrival_ns, step.parsed_ns, taken_ns, done_ns)
        for stage, start, end in zip(STAGES, moments, moments[1:], strict=False):
            self.latencies[stage].add(1e-9 * (end - start))
        self.latencies["total"].add(1e-9 * (done_ns - step.arrival_ns))
        self.last = (step.time_s, u, estimate)
        if each is not None:
            each(LiveEstimate(step, estimate, taken_ns, done_ns))

    def state(self) -> LiveState:
        time_s, readings, estimate = self.last or (math.nan, None, None)
        seconds = time.monotonic() - self.began
        return LiveState(
            seconds=seconds,
            time_s=time_s,
            readings=readings,
            estimate=estimate,
            rate_hz=self.rate_hz or self.follower.estimated / seconds,
            estimated=self.follower.estimated,
            dropped=self.dropped,
            refused=self.follower.refused,
            refusal=self.follower.refusal,
            missing=tuple(self.follower.missing),
            missing_now=self.missing_now,
            other_streams=dict(self.steps.others),
            recorded=self.recorded,
            latencies=self.latencies,
        )
