"""The command that estimates from a port; thin, it imports what it needs when it runs."""

from __future__ import annotations

import math
import sys
import threading
from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter

from edition1.errors import bad_input, require
from edition1_companion.book.project import shown
from edition1_companion.cli_terminal import Screen, load_described, set_by_signals
from edition1_companion.cli_track import estimated

if TYPE_CHECKING:
    from edition1_live.follow.live_state import LiveState

BLOCK_S = 0.25
"""Time between two states on a terminal, which shows them in one place [s]."""


def live(
    port: str,
    /,
    *,
    robot: Path,
    calibration: Path | None = None,
    estimator: str = "",
    output: Annotated[Path | None, Parameter(name=["-o", "--output"])] = None,
    browser: Annotated[bool, Parameter(negative="")] = False,
    browser_socket: int | None = None,
    failed: Annotated[list[int] | None, Parameter(negative="", metavar="NUMBER")] = None,
    baud: int = 115200,
    duration: float = math.inf,
    estimates: Path | None = None,
    grown: float = 1.0,
) -> int:
    """Estimate the shape from a port: repro live PORT --robot ROBOT.toml -o RECORDING; stop with Ctrl-C.

    Parameters
    ----------
    port
        Such as /dev/ttyACM0, COM3 or socket://localhost:7000; or a recording, which is estimated at full speed.
    robot
        The robot as described.
    calibration
        From repro calibrate.
    estimator
        levenberg_marquardt, kalman, gradient_descent or particle_filter for magnetic sensors (the first by default),
        imu_chain for IMUs.
    output
        A recording of everything that arrives, as from repro record; a new file. Without it nothing is recorded.
    browser
        Show shape and readings on a page for the browser of this computer; its address is printed.
    browser_socket
        Number of a TCP port of this computer for that page; 0, as by default, for a free one.
    failed
        Number of a sensor not to use, from 1; may be repeated.
    baud
        Bits per second of the port.
    duration
        Stop after this many seconds.
    estimates
        Store the estimates as they come, as repro track does; a new CSV.
    grown
        State every ± so many times as large as the estimator does: repro fit says how large it has to be to hold.
    """
    if Path(port).is_file():
        given = {"output": output is not None, "browser": browser, "duration": duration != math.inf}
        file = Path(port).name
        for name, is_given in given.items():
            require(
                not is_given, name, "repro live", f"left out for {file}, which is a file, not a port", "it"
            )
        print(
            f"{file} is a file, not a port: it is estimated at full speed, not in its own time.",
            file=sys.stderr,
        )
        return estimated(Path(port), robot, calibration, estimator, failed or [], estimates, grown)

    from edition1_live.follow import live_text
    from edition1_live.follow.browser import BrowserView
    from edition1_live.follow.estimate_table import EstimateFile
    from edition1_live.follow.robot_estimator import robot_estimator
    from edition1_live.follow.session import follow
    from edition1_live.record.recording_file import WriteFailed

    if browser_socket is not None and not browser:
        raise bad_input("browser_socket", "repro live", "left out without --browser", browser_socket)
    described = load_described(robot, calibration, to=sys.stderr)
    method, stop = robot_estimator(described, estimator, failed=failed or []), threading.Event()
    method = replace(method, grown=grown)
    set_by_signals(stop)
    view = BrowserView(method, browser_socket or 0) if browser else None
    screen = Screen(lambda state: live_text.block(method, state), BLOCK_S)

    def show(state: LiveState) -> None:
        if view is not None:
            view.publish(state)
        screen.show(state)

    print("Preparing the estimator (the first time its kernels are compiled: a minute).", file=sys.stderr)
    table = None if estimates is None else EstimateFile(estimates, method)
    each = None if table is None else lambda found: table.add(found.step.time_s, found.estimate)
    with view or nullcontext():
        if view is not None:
            print(f"Open {view.address} in a browser.", flush=True)
        options = {"output": output, "baud": baud, "duration_s": duration, "each": each}
        try:
            with table or nullcontext():
                state = follow(port, method, **options, stop=stop, show=show, warn=screen.line)
        except WriteFailed as failure:
            screen.line(f"repro: {failure}")
            return 1
    screen.line("\n".join(live_text.block(method, state)))
    if not state.estimated:
        screen.line("No frame came, or none could be used.")
        return 1
    if state.recorded.path is not None:
        print(shown(state.recorded.path))
    if table is not None:
        print(f"{shown(table.path)}  ({table.written} estimates)")
    return 0
