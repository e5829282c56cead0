"""A robot followed live: bytes from a port become time steps, estimates, and what a person should know of them.

One thread reads the port and writes the recording, which has every byte. The session parses and estimates. If it
falls behind, it estimates the newest time step and counts those that it leaves out.
"""

from __future__ import annotations

import copy
import gc
import math
import queue
import sys
import threading
import time
from collections import deque
from collections.abc import Callable, Sequence
from contextlib import ExitStack, closing
from pathlib import Path
from typing import Any

import numpy as np

from repro.common import Array, InputError, require, whole
from repro.estimators.base import Estimate, NearMagnets, evenly
from repro.estimators.monitor import (
    BEYOND_BOUNDS,
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
from repro.estimators.track import trajectory
from repro.robot import Robot
from repro_board.evaluate import ESTIMATORS, estimator_of
from repro_board.record import Writer, open_port, stopping
from repro_board.steps import Steps
from repro_board.wire import Parser

BURST, LOOK_S, SHAPES = 64, 0.05, 200
"""Rows of an alarm that the monitor sees at once; afterwards it looks once in so many seconds [s]; shapes for which
what a calibration left open is known beforehand."""
BEHIND_S = 0.1
"""A time step that has waited longer [s] is left out if there is a newer one."""
WINDOW_S, SAMPLE_S, SILENT_S = 2.0, 0.25, 1.0
"""What counts as happening now, how often counts are kept for that, and after which time nothing comes [s]."""
DAMAGED = ("checksum_errors", "malformed", "oversized")
SWITCH_S = 5e-4
"""After this time a thread lets another one work [s]; the usual 5 ms are longer than an estimate takes."""


BY_BOUNDS = 0.9 / math.sqrt(12)
"""Standard deviation from which a coordinate is known by its bounds alone [widths of the bounds]."""


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
        failed: Sequence[Any] = (),
        grown: float = 1.0,
        calibration: Any = None,
    ) -> None:
        owner = "live"
        self.name, self.estimator = name or ESTIMATORS[0], estimator_of(robot, name, owner)
        require(0 < grown < math.inf, "grown", owner, "positive", grown)
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
        self.state: Any = self.monitor.init()
        self.said: dict[str, Any] = {"status": 0}
        self._inner, self._burst, self._looked = None, BURST, -math.inf
        self._near = NearMagnets.of(self.robot, self.robot.n_readings)

    def warm(self) -> None:
        """Compile and load what an estimate or an alarm needs, so that no reading waits for it."""
        q, robot = self.robot.start, self.robot
        if q is None and robot.lower is not None and robot.upper is not None:
            q = (robot.lower + robot.upper) / 2
        u = np.asarray(robot.sensing()(np.zeros(robot.n_q) if q is None else q)).ravel()
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
            C: Any = found.covariance
            more = {name: self.said[name] for name in SAID}
            found = found._replace(covariance=self.said["growth"] * C, details=found.details | more)
        else:
            self.state, found = self.monitor.step(self.state, u, t)
            self._inner, self.said, self._looked = self.state.inner, found.details, t
            self._burst = min(self._burst + (-1 if alarm else 1), BURST)
        if self._near is not None:
            self._near.q, found = found.q, found._replace(details=found.details | {"too_near": near})
        total: Any = found.covariance
        if self._shapes is not None and self._open is not None:
            width = np.where(self.robot.fixed, 1.0, np.ptp(self._shapes, axis=0))
            away = self.robot.free_angles.difference(self._shapes, found.q) / width
            total = total + self._open[np.square(away).sum(axis=1).argmin()]
        return found._replace(covariance=self.grown**2 * total)

    def suspects(self, found: Estimate | None) -> list[int]:
        """Return the parts that the monitor names."""
        return [] if found is None else np.flatnonzero(found.details.get("suspects", ())).tolist()


class Session:
    """A port with its parser and estimator. Other threads may look at it at any time."""

    def __init__(
        self, follower: Follower, port: Any, writer: Writer | None = None, format: str | None = None
    ) -> None:
        self.follower, self.port, self.writer = follower, port, writer
        stated = getattr(follower.robot.source, "stream", {}).get("format")
        self.parser = Parser(format or stated)
        self.steps = Steps(follower.robot, source=self.parser)
        self.stop, self.failure, self.blind = threading.Event(), None, ""
        self.remarks: dict[str, float] = {}  # and when each was made last
        self.each: Callable[[Any], None] = lambda _: None
        self.arrivals: queue.SimpleQueue[tuple[float, bytes | None]] = queue.SimpleQueue()
        self.pending: deque[tuple[float, Any]] = deque()
        self.last: tuple[float, Array, Estimate] | None = None
        self.began = self.heard = self.estimated_at = time.monotonic()
        self.own = {"bytes": 0, "time_steps": 0, "estimates": 0, "skipped": 0}
        self.refusal, self.latencies = "", deque[float](maxlen=5000)
        self.counts: deque[tuple[float, dict[str, int]]] = deque(maxlen=round(WINDOW_S / SAMPLE_S))

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
        if self.failure is not None:
            raise self.failure

    def guarded(self, work: Callable[[], Any], view: str = "") -> Any:
        """Work in another thread. What fails there ends the session, and ``run`` raises it.

        If a view fails the session goes on, because it may be recording; ``blind`` says which view, and why.
        """
        try:
            return work()
        except BaseException as error:
            if view:
                why = f"{type(error).__name__}: {error}"
                self.blind = f"The {view} has failed, and the session goes on without it ({why})."
                return None
            self.failure = self.failure or error
            self.stop.set()
            return None

    def at_once(self) -> Session:
        """Return the session for a look from another thread: its last estimate stays the same meanwhile."""
        return copy.copy(self)

    def _read(self) -> None:
        opened = self.port.opened
        while not self.stop.is_set():
            data, at = self.port.read(0.05), time.monotonic()
            if self.port.opened != opened:
                opened = self.port.opened
                self.arrivals.put((at, None))
                if self.writer is not None:
                    self.writer.opened(self.writer.now_ns())
            if data:
                self.arrivals.put((at, data))
                if self.writer is not None:
                    self.writer.write(self.writer.now_ns(), data)

    def turn(self) -> None:
        """Take in what has arrived, and estimate one time step."""
        wait, now = not self.pending, time.monotonic()
        if not self.counts or now - self.counts[-1][0] >= SAMPLE_S:
            self.counts.append((now, self.counters()))
        try:
            self._take(*self.arrivals.get(wait, 0.05))
            while True:
                self._take(*self.arrivals.get_nowait())
        except queue.Empty:
            pass
        if len(self.pending) > 1 and time.monotonic() - self.pending[0][0] > BEHIND_S:
            self.own["skipped"] += len(self.pending) - 1
            self.pending = deque([self.pending[-1]])
        if self.pending:
            self._estimate(*self.pending.popleft())

    def _take(self, at: float, data: bytes | None) -> None:
        if data is None:
            self.parser.reopened()
            return
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

    def _estimate(self, at: float, step: Any) -> None:
        try:
            found = self.follower.step(step.u, step.time_s)
        except InputError as error:  # of this row; the next one may do
            self._refused(error)
            return
        self.estimated_at = time.monotonic()
        self.own["estimates"] += 1
        self.latencies.append(self.estimated_at - at)
        self.last = step.time_s, step.u, found
        self.each(self.last)

    def _refused(self, error: InputError) -> None:
        self.refusal = str(error)
        self.remarks[self.refusal] = time.monotonic()

    def of_now(self) -> str:
        """Return the last remark since the last estimate, if there is any: those before are no cause of a fault."""
        late = {at: text for text, at in [*self.remarks.items()] if at > self.estimated_at}
        return late[max(late)] if late else ""

    def counters(self) -> dict[str, int]:
        """Return all counts since the beginning."""
        left_out = {name: n for name, n in self.steps.counters.items() if name != "steps"}
        return {**self.parser.counters, **left_out, **self.own}

    def recent(self) -> tuple[dict[str, int], float]:
        """Return the counts of the last seconds, and how many these are."""
        now, counters = time.monotonic(), self.counters()
        then, before = self.counts[0] if self.counts else (self.began, {})
        return {name: n - before.get(name, 0) for name, n in counters.items()}, max(now - then, 1e-3)

    def age_s(self) -> float:
        """Return how old the estimate is, zero while it is of now."""
        age_s = time.monotonic() - self.estimated_at
        return age_s if age_s > max(SILENT_S, 3.0 / (self.follower.robot.rate_hz or 3.0)) else 0.0

    def status(self) -> int:
        """Return the number of what the monitor says."""
        return 0 if self.last is None else int(self.last[2].details.get("status", 0))


def sentences(session: Session) -> list[str]:
    """Return what is wrong at the moment, in sentences that stay the same as long as it is."""
    robot, counters, (recent, span_s) = session.follower.robot, session.counters(), session.recent()
    now, apart_s = time.monotonic(), 3.0 / (robot.rate_hz or 3.0)
    late = now - session.began > SILENT_S
    silent = now - session.heard > max(SILENT_S, apart_s)
    frames, damaged = recent["frames"], sum(recent.get(name, 0) for name in DAMAGED)
    ask = "Is --baud the rate of the board, and does it send what the robot file says?"
    why = session.of_now() or ask
    wire = [
        (session.port.lost, "The port is gone; we wait until it is there again."),
        (
            late and not counters["bytes"],
            "Nothing arrives yet. Is the board powered and programmed? Reset it.",
        ),
        (
            counters["bytes"] and silent,
            "Nothing arrives any more. Has the board lost its power or its wires?",
        ),
        (late and recent["bytes"] and not frames, f"Bytes arrive, but no readings. {why}"),
        (frames and not recent["estimates"] and late, f"What arrives does not fit this robot. {why}"),
    ]
    for holds, text in wire:
        if holds:
            return [text]
    share, rate, stated = (
        damaged / max(damaged + frames, 1),
        recent["time_steps"] / span_s,
        robot.rate_hz or 0.0,
    )
    steady = counters["time_steps"] > recent["time_steps"] > 0 and now - session.heard < max(
        SAMPLE_S, apart_s
    )
    word = "More" if rate > stated else "Fewer"
    another = stated and steady and not damaged and not 0.8 < rate / stated < 1.25
    also = [
        (
            share > 0.05,
            f"About {10 * round(10 * share) or 5} % of the frames are damaged: look at cable and --baud.",
        ),
        (another, f"{word} than the {stated:g} time steps of the robot file arrive in a second."),
        (recent["skipped"], "The estimator is slower than the board: time steps are left out."),
    ]
    return [text for holds, text in also if holds] + _alarms(session)


def _alarms(session: Session) -> list[str]:
    follower, last = session.follower, session.last
    if last is None or session.age_s():
        return []
    status = int(last[2].details["status"])
    names, suspects = follower.robot.part_names, follower.suspects(last[2])
    who, leave = (
        " or ".join(names[k] for k in suspects),
        "".join(f" (--failed {k + 1})" for k in suspects[:1]),
    )
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
    there = np.bincount(follower.robot.parts, np.isfinite(last[1]), len(names)) > 0
    gone = [k for k in np.flatnonzero(~there) if k not in follower.failed]
    said = [words[status]] if status in words else []
    touched = last[2].details.get("at_bound", np.zeros(0))
    said += [
        f"{follower.robot.coordinates[c]} is at a bound of the robot file." for c in np.flatnonzero(touched)
    ]
    near = last[2].details.get("too_near", np.zeros(len(follower.robot.parts), dtype=bool))
    said += [
        f"{names[k]} is so close to a magnet that its field is not known: it is left out."
        for k in np.unique(follower.robot.parts[near])
    ]
    return said + [f"There is no reading of {names[k]}; it is left out." for k in gone]


def notes(session: Session) -> list[str]:
    """Return what else to know: what was asked for, and what happened so far."""
    follower, skipped = session.follower, session.own["skipped"]
    unused = ", ".join(follower.robot.part_names[k] for k in follower.failed)
    bare = session.last is not None and session.status() == UNCHECKED
    said = [
        (session.blind, session.blind),
        (unused, f"Not used, as asked: {unused}."),
        (follower.grown != 1.0, f"Every ± is {follower.grown:g} times what the estimator states."),
        (skipped, f"{skipped} time steps were left out because newer ones had come; a recording has them."),
        (bare, "There are no more readings than unknowns: a wrong sensor looks like another shape."),
    ]
    told = [*session.remarks, *session.steps.losses()]
    return [*told, *(text for holds, text in said if holds)]


def numbers(session: Session) -> list[str]:
    """Return the tip and the coordinates, each with its standard deviation."""
    robot, last = session.follower.robot, session.last
    if last is None or not np.isfinite(last[2].q).all():
        return []
    t, u, found = last
    low: Any = robot.lower
    q, C = found.q, np.asarray(found.covariance)
    p, G = robot.tip_slopes(q)
    values, slopes = np.concatenate([p, q]), np.concatenate([G, np.eye(len(q))])
    sd = np.sqrt(np.maximum(np.diag(slopes @ C @ slopes.T), 0.0))
    widths = np.concatenate([np.full(3, robot.length), robot.upper - low])
    units = [(f"tip {axis}", "mm", 1e3) for axis in "xyz"]
    units += trajectory([t], [u], [found], robot, None).units()
    said = []
    for (name, unit, factor), x, s, w in zip(units, values, sd, widths, strict=True):
        if w == 0:  # fixed by its bounds
            continue
        digits = 4 if unit == "rad" else 2
        known = f"{name} {factor * x:.{digits}f} ± {factor * s:.{digits}f} {unit}"
        alone = " by its bounds alone" if s > BY_BOUNDS * w and not name.startswith("tip") else ""
        said.append(f"{name} undetermined" if not s <= w else known + alone)
    return said


def summary(session: Session) -> dict[str, str]:
    """Return fit, pace, latency and losses in words."""
    (recent, span_s), counters, fit = session.recent(), session.counters(), "no estimate yet"
    if session.last is not None:
        found = session.last[2]
        chi2, dof, fit = float(found.chi2), float(found.dof), STATUS[int(found.details["status"])]
        if chi2 >= 0 and dof > 0:
            fit += f", residuals {math.sqrt(chi2 / dof):.1f} times the noise"
    age_s, latencies = session.age_s(), list(session.latencies)
    p50, p99 = 1e3 * np.quantile(latencies or [np.nan], [0.5, 0.99])
    counts = [
        f"{n} {name.replace('_', ' ')}" for name, n in counters.items() if n and name not in session.own
    ]
    pace = f"{recent['time_steps'] / span_s:.3g} time steps/s, {session.own['estimates']} estimates"
    return {
        "fit": f"{age_s:.0f} s old; {fit}" if age_s else fit,
        "pace": f"{pace} by {session.follower.name}",
        "latency": f"{p50:.2g} ms in the median, {p99:.2g} ms in 99 %" if latencies else "no estimate yet",
        "received": ", ".join(counts) or "nothing",
    }


def terminal(session: Session) -> Any:
    """Return what rich shows: tip and coordinates, fit and counts, and what is wrong."""
    from rich.columns import Columns
    from rich.console import Group
    from rich.text import Text

    session = session.at_once()
    style = "dim italic" if session.age_s() or session.status() not in TRUSTED else ""
    return Group(
        Columns([Text(x, style) for x in numbers(session)], padding=(0, 3)),
        *(Text(f"{name:9} {text}") for name, text in summary(session).items()),
        *(Text(f"! {x}", "bold red") for x in sentences(session)),
        *(Text(x, "dim") for x in notes(session)),
    )


class Table:
    """A new CSV with the columns of ``Trajectory.to_frame``; a thread writes lines as estimates come.

    The file takes its name at the end of the session, whole.
    """

    def __init__(self, path: Path, session: Session) -> None:
        self.path, self.session, self.waiting = path, session, deque[Any]()
        session.each = self.waiting.append
        self._thread = threading.Thread(target=session.guarded, args=(self._write_all,), daemon=True)

    def __enter__(self) -> None:
        self._thread.start()

    def __exit__(self, kind: object, *_: object) -> None:
        self.session.stop.set()
        self._thread.join()
        if kind is None and self.session.failure is not None:  # of the last lines, after ``run``
            raise self.session.failure

    def _write_all(self) -> None:
        last = False
        with whole(self.path, "live") as part:
            while not last:
                last = self.session.stop.wait(0.2)
                if rows := [self.waiting.popleft() for _ in range(len(self.waiting))]:
                    times, u, found = zip(*rows, strict=True)
                    follower = self.session.follower
                    frame = trajectory(times, u, found, follower.robot, follower.monitor).to_frame()
                    frame.to_csv(part, index=False, mode="a", header=not part.exists())


def live(
    port: str,
    robot: str | Path,
    *,
    calibration: Path | None = None,
    estimator: str = "",
    output: Path | None = None,
    browser: bool = False,
    browser_socket: int = 0,
    failed: Sequence[Any] = (),
    baud: int = 115200,
    duration_s: float = math.inf,
    estimates: Path | None = None,
    grown: float = 1.0,
    format: str | None = None,
    stop: threading.Event | None = None,
) -> str:
    """Estimate the shape of a robot from a port until ``stop`` is set, and return counts and remarks at the end."""
    from rich.console import Console
    from rich.live import Live
    from rich.text import Text

    from repro.estimators.calibration import load_calibration
    from repro.robot_file import load_robot

    require(duration_s > 0, "duration", "live", "above zero [s]", duration_s)
    for name, path in (("output", output), ("estimates", estimates)):
        require(path is None or not path.exists(), name, "live", "a new file", path)
    described = load_robot(robot)
    stated, must = described.total_noise is not None, "one whose file states the noise of its readings"
    require(stated, "robot", "live", must, Path(robot).name)
    known = None if calibration is None else load_calibration(calibration, described)
    follower, console = (
        Follower(described if known is None else known.robot, estimator, failed, grown, known),
        Console(stderr=True),
    )
    follower.warm()
    with ExitStack() as open_now:
        opened = open_now.enter_context(closing(open_port(port, baud)))
        about = {"port": port, "baud": baud, "format": format}
        writer = None if output is None else open_now.enter_context(closing(Writer(output, about)))
        session = Session(follower, opened, writer, format)
        session.stop = stop or session.stop
        open_now.enter_context(stopping(session.stop))
        if estimates is not None:
            open_now.enter_context(Table(estimates, session))
        if browser:
            from repro_board.page_server import PageServer

            page = open_now.enter_context(PageServer(session, browser_socket))
            console.print(f"Open {page.address} in a browser of this computer.", soft_wrap=True, markup=False)

        def state() -> Any:
            seen = session.guarded(lambda: terminal(session), "view on the terminal")
            return Text(f"! {session.blind}", "bold red") if seen is None else seen

        show = Live(get_renderable=state, console=console, refresh_per_second=4)
        open_now.enter_context(show)
        session.run(duration_s)
    if session.refusal and not session.own["estimates"]:
        raise InputError(session.refusal)
    return "\n".join([*(f"{name}: {text}" for name, text in summary(session).items()), *notes(session)])
