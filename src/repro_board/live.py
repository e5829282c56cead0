"""What commands do at a port: ``record`` writes all that comes, ``live`` follows a robot and shows it."""

from __future__ import annotations

import math
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, closing, contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, NamedTuple

from rich.columns import Columns
from rich.console import Console, Group
from rich.live import Live
from rich.text import Text

import repro
from repro.common import InputError, bad_input, new, require, whole
from repro.estimators.calibration import load_calibration
from repro.estimators.track import trajectory
from repro.robot_file import load_robot
from repro_board.keys import Keys, keyboard
from repro_board.record import Writer, stopping
from repro_board.report import Report
from repro_board.session import (
    BOOT_TEXT,
    Follower,
    Port,
    Session,
    no_readings,
    notes,
    open_port,
    sentences,
    summary,
)
from repro_board.view import SILENT_S, Moment, PageServer, Row
from repro_board.wire import Parser, is_text, raw

NOTHING = "No readings of this robot came, so nothing was estimated."


class Summary(NamedTuple):
    """What `record` has done so far, or in the end; ``path`` is None where there is no file."""

    path: Path | None
    seconds: float
    received: int
    samples: int
    reconnects: int
    format: str | None
    counters: dict[str, int]
    remarks: tuple[str, ...]
    notes: int = 0

    def __str__(self) -> str:
        """Return a line of numbers, and one for each remark."""
        counted = {"reconnects": self.reconnects, "notes": self.notes} | self.counters
        words = {
            name: (name.removesuffix("s") if n == 1 else name).replace("_", " ")
            for name, n in counted.items()
        }
        others = [f"{n} {words[name]}" for name, n in counted.items() if n and name != "frames"]
        rate = f"{self.samples} samples of {self.format or 'no known format'}"
        rate += f" ({self.samples / self.seconds:.1f}/s)" if self.seconds >= 1 else ""
        numbers = [f"{self.seconds:.0f} s: {self.received} bytes", rate, *others]
        return "\n".join([", ".join(numbers), *self.remarks])


def record(
    port: str,
    path: str | Path,
    *,
    baud: int = 115200,
    duration_s: float = math.inf,
    format: str | None = None,
    channels: int | None = None,
    stop: threading.Event | None = None,
    show: Callable[[Summary], None] | None = None,
) -> Summary:
    """Record a port until the time is over, ``stop`` is set, or Ctrl-C; wait for a port that is lost.

    Format and channels are for what is shown, and for readers to try first. ``show`` gets the state once per second,
    and whenever a key has changed it. Keys are read where standard input is a terminal.
    """
    require(duration_s > 0, "duration", "repro record", "a time above zero [s]", duration_s)
    stop = stop or threading.Event()
    about = {"port": port, "baud": baud, "format": format, "channels": channels, "version": repro.__version__}
    about["started"] = time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime())
    with closing(Writer(path, about)) as file, closing(open_port(port, baud)) as line, stopping(stop):
        taker = _Taker(file, line, Parser(format, channels))
        shown, lines = taker.start, ()
        with keyboard(line, file) as keys:
            while not stop.is_set() and (left := taker.start + duration_s - time.monotonic()) > 0:
                taker.take(min(0.1, left))
                before, lines = lines, keys.lines()
                if show and (lines != before or time.monotonic() >= shown + 1):
                    shown = time.monotonic()
                    show(taker.summary(*taker.wrong(), last=lines))
        file.close(taker.summary()._asdict() | {"path": None})
        return taker.summary(*([] if taker.samples else taker.wrong()))


class _Taker:
    """What `record` takes from a port, and has taken so far."""

    def __init__(self, file: Writer, line: Port, parser: Parser) -> None:
        self.file, self.line, self.parser = file, line, parser
        self.start = self.heard = self.sampled = time.monotonic()
        self.samples, self.opened = 0, line.opened
        self.apart_s = 0.0  # longest time between bytes

    def take(self, timeout_s: float) -> None:
        """Write and count what arrives."""
        data, now = self.line.read(timeout_s), time.monotonic()
        again, self.opened = self.line.opened > self.opened, self.line.opened
        self.file.take(data, again)
        if again:
            self.parser.reopened()
            self.heard = self.sampled = now
        found = len(self.parser.feed(data))
        self.samples += found
        if data:
            self.apart_s, self.heard = max(self.apart_s, now - self.heard), now
        if found:
            self.sampled = now

    def wrong(self) -> list[str]:
        """Return why there are no samples at the moment, and the last bytes; nothing if there are."""
        late = time.monotonic() - max(SILENT_S, 2 * self.apart_s)
        why = BOOT_TEXT if is_text(self.parser.last) else "Is --baud the rate of the board?"
        why = "" if self.parser.remarks else why  # they are shown, too
        if self.line.lost:
            said = f"{self.line.address} is away ({self.line.lost}); waiting for it"
        else:
            said = no_readings("", self.heard < late, self.file.received, self.sampled < late, why)
        return [text for text in (said, raw(self.parser.last)) if said and text]

    def summary(self, *wrong: str, last: tuple[str, ...] = ()) -> Summary:
        """Return the state; what is wrong stands before the remarks of the parser, and keys behind them."""
        return Summary(
            self.file.path if self.file.received else None, time.monotonic() - self.start, self.file.received,
            self.samples, self.line.opened - 1, self.parser.format, {**self.parser.counters},
            (*wrong, *self.parser.remarks, *last), self.file.notes,
        )  # fmt: skip


def terminal(seen: Moment) -> Group:
    """Return what rich shows: tip and coordinates, fit and counts, and what is wrong."""
    style = "" if seen.trusted else "dim italic"
    return Group(
        Columns([Text(x, style) for x in seen.numbers], padding=(0, 3)),
        *(Text(f"{name:9} {text}") for name, text in seen.summary),
        *(Text(f"! {x}", "bold red") for x in seen.alarms),
        *([Text(seen.raw)] if seen.raw else []),
        *(Text(x, "dim") for x in seen.notes),
    )


@contextmanager
def shown(session: Session, keys: Keys, browser_socket: int | None) -> Iterator[None]:
    """Show a session and keys on the terminal and, with the number of a socket, a page for the browser."""
    console = Console(stderr=True)

    def on_the_terminal() -> Any:
        seen = session.guarded(lambda: terminal(session.moment), "view on the terminal")
        return Group(
            Text(f"! {seen}", "bold red") if isinstance(seen, str) else seen,
            *(Text(line) for line in keys.lines()),
        )

    with ExitStack() as opened:
        if browser_socket is not None:
            page = opened.enter_context(PageServer(session, browser_socket))
            console.print(f"Open {page.address} in a browser of this computer.", soft_wrap=True, markup=False)
        opened.enter_context(Live(get_renderable=on_the_terminal, console=console, refresh_per_second=4))
        yield


@contextmanager
def table_of_estimates(path: Path, session: Session) -> Iterator[None]:
    """Write a new CSV with the columns of ``Trajectory.to_frame``, in a thread, as estimates come.

    The file takes its name at the end of the session, whole.
    """
    rows = session.rows = deque[Row]()

    def write() -> None:
        last = False
        with whole(path, "live") as part:
            while not last:
                last = session.stop.wait(0.2)
                if taken := [rows.popleft() for _ in range(len(rows))]:
                    times, u, found = zip(*taken, strict=True)
                    frame = trajectory(times, u, found, session.robot, session.follower.monitor).to_frame()
                    frame.to_csv(part, index=False, mode="a", header=not part.exists())

    thread = threading.Thread(target=session.guarded, args=(write,), daemon=True)
    thread.start()
    try:
        yield
    finally:
        session.stop.set()
        thread.join()
    session.settle()  # the last lines may have failed after ``run``


@dataclass(frozen=True)
class Line:
    """A port, and what a board sends through it."""

    port: str
    baud: int = 115200
    format: str | None = None


@dataclass(frozen=True)
class Method:
    """By what a robot is followed, without which sensors, and how many times as large every ± is stated."""

    estimator: str = ""
    calibration: Path | None = None
    failed: Sequence[int | str] = ()
    grown: float = 1.0


def live(
    line: Line,
    robot: str | Path,
    method: Method = Method(),
    *,
    output: Path | None = None,
    estimates: Path | None = None,
    browser_socket: int | None = None,
    duration_s: float = math.inf,
    stop: threading.Event | None = None,
) -> Report:
    """Estimate the shape of a robot from a port until ``stop`` is set, and report counts and remarks at the end."""
    require(duration_s > 0, "duration", "live", "above zero [s]", duration_s)
    for name, path in (("output", output), ("estimates", estimates)):
        if path is not None:
            new(path, "live", name)
    another = estimates is None or estimates != output
    require(another, "estimates", "live", "another file than the recording", estimates)
    follower = _follower(robot, method)
    follower.warm()
    writer = None
    with ExitStack() as opened:
        port = opened.enter_context(closing(open_port(line.port, line.baud)))
        session = Session(follower, port, line.format, with_shape=browser_socket is not None)
        session.stop = stop or session.stop
        if output is not None:
            writer = opened.enter_context(closing(Writer(output, asdict(line))))
            session.record = writer.take
        opened.enter_context(stopping(session.stop))
        keys = opened.enter_context(keyboard(port, writer))
        if estimates is not None:
            opened.enter_context(table_of_estimates(estimates, session))
        opened.enter_context(shown(session, keys, browser_socket))
        session.run(duration_s)
    if session.refusal and not session.own["estimates"]:
        raise InputError(session.refusal)
    counted = [f"{name}: {text}" for name, text in summary(session).items()]
    noted = [f"notes: {writer.notes} in {writer.path.name}"] if writer and writer.notes else []
    nothing = [] if session.own["estimates"] else [NOTHING, *sentences(session)]
    return Report("\n".join([*counted, *noted, *notes(session), *nothing]), session.counters())


def _follower(path: str | Path, method: Method) -> Follower:
    robot, calibration = load_robot(path), None
    if robot.total_noise is None:
        raise bad_input("robot", "live", "one whose file states the noise of its readings", Path(path).name)
    if method.calibration is not None:
        calibration = load_calibration(method.calibration, robot)
        robot = calibration.robot
    return Follower(robot, method.estimator, method.failed, method.grown, calibration)
