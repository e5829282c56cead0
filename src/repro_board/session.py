"""A robot followed live: bytes from a port become time steps, estimates, and what a person should know of them.

One thread reads the port and hands on every byte to who records it. The session parses and estimates in a thread
of its own. If it falls behind, it estimates the newest time step and counts those that it leaves out. What other
threads tell it comes through its inbox; what they may show of it is its moment, which it replaces 20 times a second.
"""

from __future__ import annotations

import contextlib
import errno
import gc
import math
import os
import queue
import select
import socket
import sys
import threading
import time
from collections import deque
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple
from urllib.parse import urlsplit

import numpy as np

from repro.common import Array, InputError, bad_input, require
from repro.estimators.base import Estimate, NearMagnets, evenly
from repro.estimators.calibration import Calibration
from repro.estimators.monitor import (
    BEYOND_BOUNDS,
    CONSISTENT,
    FROZEN,
    INCONSISTENT,
    LEFT_OUT,
    SAID,
    STATUS,
    TRUSTED,
    UNCHECKED,
    UNDETERMINED,
    Monitor,
)
from repro.robot import Robot
from repro_board.evaluate import ESTIMATORS, estimator_of
from repro_board.shape_view import view
from repro_board.steps import Step, Steps
from repro_board.view import SILENT_S, UNKNOWN, Moment, Row, Shared
from repro_board.wire import DAMAGED, Parser, is_text, raw

MOST_BYTES = 65536
"""Bytes taken from a port at once."""
LET_GO, UPLOAD_S = "let go of, for an upload of firmware", 30.0
"""Why a port is away that was let go of, and for how long it is [s]."""
BURST, LOOK_S, SHAPES = 64, 0.05, 200
"""Rows of an alarm that the monitor sees at once; afterwards it looks once in so many seconds [s]; shapes for which
what a calibration left open is known beforehand."""
BEHIND_S = 0.1
"""A time step that has waited longer [s] is left out if there is a newer one."""
WINDOW_S, SAMPLE_S, MOMENT_S = 2.0, 0.25, 0.05
"""What counts as happening now, how often counts are kept for that, and time between two moments [s]."""
SWITCH_S = 5e-4
"""After this time a thread lets another one work [s]; the usual 5 ms are longer than an estimate takes."""


class Port:
    """A serial port or a socket that is opened again, as often as it must, whenever it is lost or was let go of.

    ``opened`` counts how often it was opened; ``lost`` says why it is away, and is empty while it is there.
    """

    def __init__(self, address: str, baud: int) -> None:
        self.address, self.baud = address, baud
        self._line = _open(address, baud)
        self.opened, self.lost = 1, ""
        self._wait_s = self._due = self._free_until = 0.0

    @property
    def free_s(self) -> float:
        """For how long others may have it still [s]."""
        return max(0.0, self._free_until - time.monotonic())

    def let_go(self) -> None:
        """Let others have the port for a while, or take it back at once; any thread may ask for that."""
        self._free_until = 0.0 if self.free_s else time.monotonic() + UPLOAD_S

    def read(self, timeout_s: float) -> bytes:
        """Return what has arrived; nothing after the time, or where the port had to be opened again."""
        try:
            if self.free_s and not self.lost:
                self.lost, self._due = LET_GO, 0.0
                self.close()
            if self.lost:
                self._reopen(timeout_s)
            elif select.select([self._line], [], [], timeout_s)[0]:
                data = os.read(self._line.fileno(), MOST_BYTES)
                if data:
                    return data
                raise ConnectionResetError(0, "closed at the other side")
        except BlockingIOError:
            pass
        except (OSError, ValueError) as error:
            self._wait_s = min(1.0, 2 * self._wait_s or 0.05) if self.lost else 0.0
            self._due = time.monotonic() + self._wait_s
            self.lost = getattr(error, "strerror", None) or str(error)
            self.close()
        return b""

    def _reopen(self, timeout_s: float) -> None:
        time.sleep(min(timeout_s, max(self.free_s, self._due - time.monotonic(), 0.0)))
        if not self.free_s and time.monotonic() >= self._due:
            self._line = _open(self.address, self.baud)
            self.opened, self.lost = self.opened + 1, ""

    def close(self) -> None:
        """Close it, also when it has disappeared."""
        with contextlib.suppress(OSError):
            self._line.close()


def _open(address: str, baud: int) -> Any:
    if address.startswith("socket:"):
        where = urlsplit(address)
        return socket.create_connection((where.hostname or "", where.port or 0), timeout=2.0)
    import serial

    return serial.Serial(address, baud, timeout=0, exclusive=True)


def open_port(address: str, baud: int = 115200) -> Port:
    """Open a port for this process alone: ``/dev/ttyACM0`` or ``socket://HOST:PORT``; refuse it in words."""
    require(0 < baud < 2**31, "baud", "the board", "a rate above zero", baud)
    try:
        return Port(address, baud)
    except (OSError, ValueError) as error:
        must = {
            errno.ENOENT: f"one that is there; found: {ports()}",
            errno.EACCES: "one that you may use (sudo usermod -aG dialout $USER, then log in again)",
            errno.EAGAIN: "free (close the program that has it open)",
            errno.EBUSY: "free (close the program that has it open)",
        }.get(
            getattr(error, "errno", None) or 0, "a serial port, or socket://HOST:PORT of a listening program"
        )
        why = getattr(error, "strerror", None) or error
        raise bad_input("port", "the board", must, f"{address} ({why})") from error


def ports() -> str:
    """Return the serial ports of this computer, with what they say they are, one a line."""
    from serial.tools import list_ports

    found = [f"{port.device}  {port.description}" for port in sorted(list_ports.comports())]
    return "\n".join(found) or "no serial port (plug a board in; socket://HOST:PORT works without one)"


BY_BOUNDS = 0.9 / math.sqrt(12)
"""Standard deviation from which a coordinate is known by its bounds alone [widths of the bounds]."""
BOOT_TEXT = "It is text, but not of the expected form. Many boards print such lines when they start."
_ASK = "Is --baud the rate of the board, and does it send what the robot file says?"


def no_readings(lost: str, silent: object, received: int, unread: object, why: str) -> str:
    """Return why a port gives no readings, in a sentence; nothing if it does. ``why`` is what is known of bytes."""
    causes = {
        f"The port is {LET_GO}.": lost == LET_GO,
        "The port is gone; we wait until it is there again.": lost,
        "Nothing arrives yet. Is the board powered and programmed? Reset it.": silent and not received,
        "Nothing arrives any more. Has the board lost its power or its wires?": silent,
        f"Bytes arrive, but no readings. {why}": unread,
    }
    return next((text for text, holds in causes.items() if holds), "")


class Follower:
    """An estimator and its monitor. A long alarm costs little more than none.

    In an alarm the monitor fits the readings without each part in turn, which takes as long as ten to thirty
    estimates. After ``BURST`` rows it does so every ``LOOK_S``. The rows between are estimated without the readings
    that it left out last.
    """

    def __init__(
        self,
        robot: Robot,
        name: str = "",
        failed: Sequence[int | str] = (),
        grown: float = 1.0,
        calibration: Calibration | None = None,
    ) -> None:
        owner = "live"
        self.name, self.estimator = name or ESTIMATORS[0], estimator_of(robot, name, owner)
        require(0 < grown <= 1e6, "grown", owner, "positive and at most 1e6", grown)
        self.robot, self.failed, self.grown = robot, [robot.part(x, owner) for x in failed], grown
        self._shapes = self._open = None
        if calibration is not None:  # what it left open, in shapes between which it hardly changes
            self._shapes = evenly(np.asarray(robot.lower), np.asarray(robot.upper), SHAPES)
            self._open = calibration.lasting_covariance(self._shapes)
        self.monitor = Monitor(self.estimator)
        self._unused = np.isin(robot.parts, self.failed)
        self.begin()

    def begin(self) -> None:
        """Forget everything."""
        self.state = self.monitor.init()
        self.said = {"status": np.array(0)}
        self._inner: Any = None
        self._burst, self._looked = BURST, -math.inf
        self._near = NearMagnets.of(self.robot, self.robot.n_readings)

    def warm(self) -> None:
        """Compile and load what an estimate or an alarm needs, so that no reading waits for it."""
        u = np.asarray(self.robot.sensing()(self.robot.usual_shape)).ravel()
        for k in range(30):
            self.step(
                u + 1e-6 * k * np.arange(len(u)) + 100.0 * (k >= 10) * (np.arange(len(u)) == 0), 0.01 * k
            )
        self.begin()

    def step(self, u: Array, t: float) -> Estimate:
        """Estimate a time step."""
        near = np.zeros(len(u), dtype=bool) if self._near is None else self._near.readings()
        u = np.where(self._unused | near, np.nan, u)
        alarm = self.said["status"] in (LEFT_OUT, INCONSISTENT)
        if alarm and self._burst <= 0 and t - self._looked < LOOK_S:
            u = np.where(self.said["left_out"], np.nan, u)
            self._inner, found = self.estimator.step(self._inner, u, t)
            more = {name: self.said[name] for name in SAID}
            found = found._replace(
                covariance=self.said["growth"] * np.asarray(found.covariance), details=found.details | more
            )
        else:
            self.state, found = self.monitor.step(self.state, u, t)
            self._inner, self.said, self._looked = self.state.inner, found.details, t
            self._burst = min(self._burst + (-1 if alarm else 1), BURST)
        if self._near is not None:
            self._near.q, found = found.q, found._replace(details=found.details | {"too_near": near})
        total = np.asarray(found.covariance)
        if self._shapes is not None and self._open is not None:
            width = np.where(self.robot.fixed, 1.0, np.ptp(self._shapes, axis=0))
            away = self.robot.free_angles.difference(self._shapes, found.q) / width
            total = total + self._open[np.square(away).sum(axis=1).argmin()]
        return found._replace(covariance=self.grown**2 * total)


class PortState(NamedTuple):
    """What a port has become: whether it was opened again, and why it is away, if it is."""

    again: bool
    lost: str


class Session(Shared):
    """A port with its parser and estimator.

    What is not :class:`Shared` is the session's own. ``record`` is given all bytes, and whether the port was opened
    again before them, in the thread that reads the port.
    """

    def __init__(
        self,
        follower: Follower,
        port: Port,
        format: str | None = None,
        *,
        with_shape: bool = False,
    ) -> None:
        self.follower, self.port, self.with_shape = follower, port, with_shape
        super().__init__(follower.robot)
        source = self.robot.source
        self.parser = Parser(format or (source.stream.get("format") if source else None))
        self.steps = Steps(self.robot, source=self.parser)
        self.record: Callable[[bytes, bool], None] = lambda *_: None
        self.remarks: dict[str, float] = {}  # and when each was made last
        self.pending = deque[tuple[float, Step]]()
        self.last: Row | None = None
        self.began = self.heard = self.estimated_at = time.monotonic()
        self.own = {"bytes": 0, "time_steps": 0, "estimates": 0, "skipped": 0}
        self.lost = self.blind = self.refusal = (
            ""  # why the port is away, a view has failed, a row was refused
        )
        self.apart_s = 3.0 / (self.robot.rate_hz or 3.0)  # three time steps of the robot file
        self.latencies = deque[float](maxlen=5000)
        self.counts: deque[tuple[float, dict[str, int]]] = deque(maxlen=round(WINDOW_S / SAMPLE_S))
        self.moment = self.look()

    def run(self, duration_s: float = math.inf) -> None:
        """Follow the port until ``stop`` is set, the time is over, or a file cannot be written."""
        reader = threading.Thread(target=self.guarded, args=(self._read,), daemon=True)
        before = sys.getswitchinterval()
        sys.setswitchinterval(SWITCH_S)
        gc.freeze()  # a look through all that the libraries have made takes a tenth of a second
        self.began = self.heard = self.estimated_at = time.monotonic()
        reader.start()
        try:
            while not self.stop.is_set() and time.monotonic() - self.began < duration_s:
                self.turn()
        finally:
            self.stop.set()
            reader.join()
            gc.unfreeze()
            sys.setswitchinterval(before)
        self.settle()

    def settle(self) -> None:
        """Take in what other threads have said last, without bytes; raise what has failed there."""
        with contextlib.suppress(queue.Empty):
            while True:
                at, item = self.inbox.get_nowait()
                if not isinstance(item, bytes):
                    self._take(at, item)

    def _read(self) -> None:
        state = self.port.opened, self.port.lost
        while not self.stop.is_set():
            data, at = self.port.read(0.05), time.monotonic()
            before, state = state, (self.port.opened, self.port.lost)
            again = state[0] != before[0]
            if state != before:
                self.inbox.put((at, PortState(again, state[1])))
            if data:
                self.inbox.put((at, data))
            self.record(data, again)

    def turn(self) -> None:
        """Take in what has arrived, estimate one time step, and look if it is time for that."""
        wait, now = not self.pending, time.monotonic()
        if not self.counts or now - self.counts[-1][0] >= SAMPLE_S:
            self.counts.append((now, self.counters()))
        idle = not self.pending and self.inbox.empty()  # no time step has to wait for a moment, unless all do
        if now - self.moment.made_s >= (MOMENT_S if idle else 4 * MOMENT_S):
            self.moment = self.look()
        with contextlib.suppress(queue.Empty):
            self._take(*self.inbox.get(wait, MOMENT_S))
            while True:
                self._take(*self.inbox.get_nowait())
        if len(self.pending) > 1 and time.monotonic() - self.pending[0][0] > BEHIND_S:
            self.own["skipped"] += len(self.pending) - 1
            self.pending = deque([self.pending[-1]])
        if self.pending:
            self._estimate(*self.pending.popleft())

    def _take(self, at: float, item: object) -> None:
        match item:
            case bytes():
                self._parse(at, item)
            case PortState():
                self.lost = item.lost
                if item.again:
                    self.parser.reopened()
            case str():
                self.blind = item
            case BaseException():
                raise item

    def _parse(self, at: float, data: bytes) -> None:
        self.heard = at
        self.own["bytes"] += len(data)
        found = []
        try:
            found = self.steps.feed(self.parser.feed(data), at - self.began)
        except InputError as error:  # the board is that of another robot
            self._refused(error)
        for remarks in (self.parser.remarks, self.steps.remarks):
            self.remarks |= dict.fromkeys(remarks, time.monotonic())
            remarks.clear()  # it is made again if the cause comes again
        self.own["time_steps"] += len(found)
        self.pending.extend((at, step) for step in found)

    def _estimate(self, at: float, step: Step) -> None:
        try:
            found = self.follower.step(step.u, step.time_s)
        except InputError as error:  # of this row; the next one may do
            self._refused(error)
            return
        self.estimated_at = time.monotonic()
        self.own["estimates"] += 1
        self.latencies.append(self.estimated_at - at)
        self.last = step.time_s, step.u, found
        self.rows.append(self.last)

    def _refused(self, error: InputError) -> None:
        self.refusal = str(error)
        self.remarks[self.refusal] = time.monotonic()

    def counters(self) -> dict[str, int]:
        """Return all counts since the beginning."""
        left_out = {name: n for name, n in self.steps.counters.items() if name != "steps"}
        return {**self.parser.counters, **left_out, **self.own}

    @property
    def status(self) -> int:
        """The number of what the monitor says."""
        return 0 if self.last is None else int(self.last[2].details.get("status", 0))

    @property
    def silent_s(self) -> float:
        """Time since the last byte [s]."""
        return time.monotonic() - self.heard

    @property
    def age_s(self) -> float:
        """How old the newest estimate is [s]; zero while it is of now."""
        age_s = time.monotonic() - self.estimated_at
        return age_s if age_s > max(SILENT_S, self.apart_s) else 0.0

    def recent(self) -> tuple[dict[str, int], float]:
        """Return what was counted of late, and in how many seconds."""
        then, before = self.counts[0] if self.counts else (self.began, {})
        counts = {name: n - before.get(name, 0) for name, n in self.counters().items()}
        return counts, max(time.monotonic() - then, 1e-3)

    def cause(self) -> str:
        """Return the last remark since the last estimate: those before are no cause of a fault."""
        late = {at: text for text, at in self.remarks.items() if at > self.estimated_at}
        return late[max(late)] if late else ""

    def look(self) -> Moment:
        """Return what is shown of the moment; if that cannot be made the session goes on, as it may be recording."""
        made_s = time.monotonic()
        try:
            return moment(self, made_s)
        except Exception as error:
            return UNKNOWN._replace(made_s=made_s, alarms=(self.blinded("view", error),))


# ------------------------------------------------------------------------------------------- what is said of it
def moment(session: Session, made_s: float) -> Moment:
    """Return what is shown of a session."""
    robot, last, status, age_s = session.robot, session.last, session.status, session.age_s
    named, row, shape = suspects(last[2] if last else None), None, None
    if last is not None and np.isfinite(last[2].q).all():
        t, u, found = last
        row = t, u, (u - found.u_hat) / np.asarray(robot.total_noise)
        if session.with_shape:
            C = np.asarray(found.covariance)[None]
            shape = dict(view(robot, found.q[None], [0.0], "now", covariance=C).data)
            shape["suspects"] = [k for k in named if k < len(robot.sensors)]
    doubt = "old" if age_s else STATUS[status] if status not in (CONSISTENT, UNCHECKED) else ""
    doubtful = tuple(np.flatnonzero(np.isin(robot.parts, named)).tolist())
    return Moment(
        made_s, in_numbers(session), tuple(summary(session).items()), sentences(session), notes(session),
        not age_s and status in TRUSTED, doubt, doubtful, age_s, row, shape,
        raw(session.parser.last) if _of_the_wire(session) else "",
    )  # fmt: skip


def suspects(found: Estimate | None) -> tuple[int, ...]:
    """Return the parts that the monitor names."""
    return () if found is None else tuple(np.flatnonzero(found.details.get("suspects", ())).tolist())


def sentences(session: Session) -> tuple[str, ...]:
    """Return what is wrong at the moment, in sentences that stay the same as long as it is."""
    wrong = _of_the_wire(session)
    return (wrong,) if wrong else (*_of_the_pace(session), *_of_the_estimate(session))


def _of_the_wire(session: Session) -> str:
    """Return why there are no time steps; nothing if there are some."""
    counts, (recent, _) = session.counters(), session.recent()
    late, why = time.monotonic() - session.began > SILENT_S, session.cause() or _ASK
    quiet = session.silent_s > max(SILENT_S, session.apart_s)
    silent = quiet if counts["bytes"] else late
    unread = late and recent["bytes"] and not recent["frames"]
    another = late and recent["frames"] and not recent["estimates"]
    known = session.cause() or (BOOT_TEXT if is_text(session.parser.last) else _ASK)
    wrong = no_readings(session.lost, silent, counts["bytes"], unread, known)
    return wrong or (f"What arrives does not fit this robot. {why}" if another else "")


def _of_the_pace(session: Session) -> list[str]:
    """Return what is odd about the number of frames and time steps."""
    (recent, span_s), stated = session.recent(), session.robot.rate_hz or 0.0
    damaged = sum(recent.get(name, 0) for name in DAMAGED)
    share, rate = damaged / max(damaged + recent["frames"], 1), recent["time_steps"] / span_s
    goes_on = session.silent_s < max(SILENT_S / 4, session.apart_s)
    steady = goes_on and session.counters()["time_steps"] > recent["time_steps"] > 0
    another = stated and steady and not damaged and not 0.8 < rate / stated < 1.25
    word = "More" if rate > stated else "Fewer"
    odd = {
        f"About {10 * round(10 * share)} % of the frames are damaged: look at cable and --baud.": share
        > 0.05,
        f"{word} than the {stated:g} time steps of the robot file arrive in a second.": another,
        "The estimator is slower than the board: time steps are left out.": recent["skipped"],
    }
    return [text for text, holds in odd.items() if holds]


def _of_the_estimate(session: Session) -> list[str]:
    """Return what the monitor says, which bounds the shape touches, and which sensors say nothing."""
    if session.last is None or session.age_s:
        return []
    (_, u, found), robot, named = session.last, session.robot, suspects(session.last[2])
    names = robot.part_names
    who, leave = " or ".join(names[k] for k in named), "".join(f" (--failed {k + 1})" for k in named[:1])
    causes = (
        "something magnetic nearby, several sensors, or a robot that is not as described (repro calibrate)"
    )
    words = {
        LEFT_OUT: f"What {who or 'a sensor'} reads does not fit the other readings and is left out{leave}.",
        INCONSISTENT: f"Do not trust the shape: it does not explain the readings. The cause may be {who or causes}.",
        FROZEN: "Do not trust the shape: the board repeats itself, all its readings are old.",
        UNDETERMINED: "Do not trust the shape: there are fewer readings than unknowns.",
        BEYOND_BOUNDS: "The readings fit only beyond the bounds of the robot file. The shape stays within them.",
    }
    # Where the rest just suffices for a shape, nothing can check it, but the part that is left out is known.
    status = LEFT_OUT if session.status == UNCHECKED and named else session.status
    touched = np.flatnonzero(found.details.get("at_bound", ()))
    near = np.flatnonzero(found.details.get("too_near", ()))
    there = np.bincount(robot.parts, np.isfinite(u), len(names)) > 0
    return [
        *([words[status]] if status in words else []),
        *(f"{robot.coordinates[c]} is at a bound of the robot file." for c in touched),
        *(
            f"{names[k]} is so close to a magnet that its field is not known: it is left out."
            for k in np.unique(robot.parts[near])
        ),
        *(
            f"There is no reading of {names[k]}; it is left out."
            for k in np.flatnonzero(~there)
            if k not in session.follower.failed
        ),
    ]


def notes(session: Session) -> tuple[str, ...]:
    """Return what else to know: what was asked for, and what happened so far."""
    skipped, unused = (
        session.counters()["skipped"],
        ", ".join(session.robot.part_names[k] for k in session.follower.failed),
    )
    bare = session.last is not None and session.status == UNCHECKED
    said = {
        session.blind: session.blind,
        f"Not used, as asked: {unused}.": unused,
        f"Every ± is {session.follower.grown:g} times what the estimator states.": session.follower.grown
        != 1.0,
        f"{skipped} time steps were left out because newer ones had come; a recording has them.": skipped,
        "There are no more readings than unknowns: a wrong sensor looks like another shape.": bare,
    }
    return (*session.remarks, *session.steps.losses(), *(text for text, holds in said.items() if holds))


def in_numbers(session: Session) -> tuple[str, ...]:
    """Return the tip and the coordinates, each with its standard deviation."""
    robot, last = session.robot, session.last
    if last is None or not np.isfinite(last[2].q).all():
        return ()
    found = last[2]
    q, C = found.q, np.asarray(found.covariance)
    p, G = robot.tip_slopes(q)
    values, slopes = np.concatenate([p, q]), np.concatenate([G, np.eye(len(q))])
    sd = np.sqrt(np.maximum(np.diag(slopes @ C @ slopes.T), 0.0))
    widths = np.concatenate([np.full(3, robot.length), np.asarray(robot.upper) - np.asarray(robot.lower)])
    units = [(f"tip {axis}", "mm", 1e3) for axis in "xyz"]
    units += robot.units
    said = []
    for (name, unit, factor), x, s, w in zip(units, values, sd, widths, strict=True):
        if w == 0:  # fixed by its bounds
            continue
        digits = 4 if unit == "rad" else 2
        known = f"{name} {factor * x:.{digits}f} ± {factor * s:.{digits}f} {unit}"
        alone = " by its bounds alone" if s > BY_BOUNDS * w and not name.startswith("tip") else ""
        said.append(f"{name} undetermined" if not s <= w else known + alone)
    return tuple(said)


def summary(session: Session) -> dict[str, str]:
    """Return fit, pace, latency and losses in words."""
    fit, counts, (recent, span_s) = "no estimate yet", session.counters(), session.recent()
    if session.last is not None:
        found = session.last[2]
        chi2, dof, fit = float(found.chi2), float(found.dof), STATUS[session.status]
        if chi2 >= 0 and dof > 0:
            fit += f", residuals {math.sqrt(chi2 / dof):.1f} times the noise"
    p50, p99 = 1e3 * np.quantile(session.latencies or [np.nan], [0.5, 0.99])
    own = ("bytes", "time_steps", "estimates", "skipped")
    others = [f"{n} {name.replace('_', ' ')}" for name, n in counts.items() if n and name not in own]
    pace = f"{recent['time_steps'] / span_s:.3g} time steps/s, {counts['estimates']} estimates"
    return {
        "fit": f"{session.age_s:.0f} s old; {fit}" if session.age_s else fit,
        "pace": f"{pace} by {session.follower.name}",
        "latency": f"{p50:.2g} ms in the median, {p99:.2g} ms in 99 %"
        if session.latencies
        else "no estimate yet",
        "received": ", ".join(others) or "nothing",
    }
