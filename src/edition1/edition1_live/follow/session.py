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
from pathlib import Path
from typing import Any

from edition1.errors import require
from edition1.estimation.consistency import Status
from edition1_live.follow.follower import Follower
from edition1_live.follow.live_state import LiveEstimate, LiveState, Tally
from edition1_live.follow.robot_estimator import RobotEstimator
from edition1_live.follow.time_steps import TimeStep, TimeSteps
from edition1_live.record.ports import check_port
from edition1_live.record.recorder import record
from edition1_live.record.recording_file import check_new
from edition1_live.wire.frame import Frame

_OWNER = "repro live"
_QUEUE_S, SHORTEST_QUEUE = 0.25, 8
"""What waits for the estimator: time steps of so many seconds, at least so many."""
_IDLE_S = 0.1
"""How often the session looks around when nothing arrives [s]."""
SHOW_S = 0.05
"""Time between two states that are shown [s]."""
_SWITCH_S = 5e-4
"""After this time a thread lets another one work [s]; 5 ms, as usual, would be longer than an estimate takes."""


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
        As for `edition1_live.record.ports.open_port`.
    estimator
        From :func:`edition1_live.follow.robot_estimator.robot_estimator`.
    output
        The recording, as for `edition1_live.record.recorder.record`; none by default.
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
        The port cannot be opened, or the recording exists. What the port sends, or that it goes, ends nothing.
    WriteFailed
        The disk is full or refuses. What was written is kept.
    """
    require(duration_s > 0, "duration", _OWNER, "a time above zero [s]", duration_s)
    if output is not None:
        check_new(output, _OWNER)
    check_port(port, baud, _OWNER)
    estimator.prepared()  # which may take a minute
    session = _Session(estimator, stop or threading.Event(), warn, seed, duration_s)
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
    return session.tally.state()


@contextmanager
def _undisturbed() -> Iterator[None]:
    """Keep the interpreter from long pauses of its own."""
    before = sys.getswitchinterval()
    sys.setswitchinterval(_SWITCH_S)
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
        duration_s: float,
    ) -> None:
        self.estimator, self.stop, self.warn = estimator, stop, warn
        rate_hz = estimator.robot.rate_hz
        self.steps = TimeSteps(estimator.streams, rate_hz)
        self.queue: queue.SimpleQueue[TimeStep] = queue.SimpleQueue()  # only one thread puts
        self.longest = max(SHORTEST_QUEUE, math.ceil(_QUEUE_S * rate_hz))
        self.tally = Tally(Follower(estimator, seed=seed), self.steps, rate_hz, duration_s)
        self.notes: queue.SimpleQueue[dict[str, Any]] = queue.SimpleQueue()
        self.noted = ("consistent", "", ())
        self.ended = threading.Event()
        self.failure: BaseException | None = None

    def read(self, port: str, output: Path | None, baud: int, duration_s: float) -> None:
        """Record; in a thread of its own."""
        robot = self.estimator.robot
        # Frames of ours that have another number of values can be told from garbage, and are in `step`.
        channels = robot.channels or None if robot.format in ("millivolts", "csv") else None
        try:
            summary = record(
                port, robot.format, output, baud=baud, channels=channels, duration_s=duration_s, stop=self.stop,
                show=self.tally.note, warn=self.warn, each=self.put, watch=self.tally.watch, owner=_OWNER,
                unit=robot.unit, notes=self.notes,
            )  # fmt: skip
            self.tally.note(summary)
        except BaseException as error:  # belongs to the thread that estimates
            self.failure = error
        finally:
            self.ended.set()

    def put(self, arrival_ns: int, frames: Sequence[Frame]) -> None:
        self.tally.arrived()
        for step in self.steps.add(arrival_ns, frames):
            if self.queue.qsize() < self.longest:
                self.queue.put(step)
                continue
            if not self.tally.dropped:
                self.warn(
                    "Overload: the estimator is slower than the stream. What arrives while "
                    f"{self.longest} time steps wait is not estimated, only recorded."
                )
            self.tally.drop()

    def estimate(
        self,
        show: Callable[[LiveState], None] | None,
        each: Callable[[LiveEstimate], None] | None,
    ) -> None:
        """Estimate until the reader has ended and nothing waits."""
        shown = time.monotonic()
        while not (self.ended.is_set() and self.queue.empty()):
            try:
                step = self.queue.get(timeout=_IDLE_S)
            except queue.Empty:
                pass
            else:
                found = self.tally.step(step)
                self.note_verdict(step)
                if found is not None and each is not None:
                    each(found)
            self.tally.tick(self.stop.is_set())
            now = time.monotonic()
            if show is not None and now - shown >= SHOW_S:
                shown = now
                show(self.tally.state())

    def note_verdict(self, step: TimeStep) -> None:
        """Write into the recording whether the readings fit, whenever that changes."""
        verdict = self.tally.verdict
        known = (Status(verdict.status).word, verdict.cause, verdict.suspects)
        if known != self.noted:
            self.noted = known
            suspects = [self.estimator.sensors[k] for k in verdict.suspects]
            said = {"consistency": known[0], "cause": known[1], "suspects": suspects}
            self.notes.put({"event": "consistency", "host_ns": step.arrival_ns, **said})
