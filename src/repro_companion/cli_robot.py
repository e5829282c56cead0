"""Commands for a robot of one's own; thin, each imports what it needs when it runs."""

from __future__ import annotations

import math
import shutil
import sys
import textwrap
import threading
import time
from contextlib import nullcontext
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter

from repro_companion.cli_terminal import set_by_signals, to_terminal
from repro_companion.cli_track import live_file

if TYPE_CHECKING:
    from repro.robot_file.robot_file import RobotFile
    from repro_live.follow.browser import BrowserView
    from repro_live.follow.live_state import LiveState
    from repro_live.follow.robot_estimator import RobotEstimator
    from repro_live.robot.calibration_poses import PoseReadings, Poses

BLOCK_S, PLAIN_S = 0.25, 10.0
"""Time between two states: on a terminal, which shows them in one place, and elsewhere [s]."""


def calibrate(
    source: str,
    /,
    *,
    robot: Path,
    poses: Path,
    output: Annotated[Path, Parameter(name=["-o", "--output"])],
    pose_noise_mm: float = 0.2,
    pose_noise_deg: float = 0.5,
    baud: int = 115200,
) -> int:
    """Calibrate a robot: repro calibrate PORT --robot ROBOT.toml --poses POSES.csv -o CALIBRATION.json.

    Leads through the poses at a port, or takes them from a recording. Fits the placement of magnets and sensors,
    gains, offsets, the moments of the magnets and the Earth field in the base frame; says what stays undetermined.

    Parameters
    ----------
    source
        A port, such as /dev/ttyACM0; or a file that repro record wrote; or the readings that an earlier session at a
        port has left beside its output, such as calibration.readings.csv.
    robot
        The robot as described.
    poses
        A CSV with a column per coordinate, such as delta_x_1_mm; for a recording also time_s, or start_s and end_s.
    output
        The calibration, JSON; must not exist yet. At a port the readings of every pose are kept beside it as they
        come, and the same command goes on after an interruption.
    pose_noise_mm, pose_noise_deg
        How well the poses are known: standard deviation of coordinates in mm, and of those in rad and deg.
    baud
        Bits per second of the port.
    """
    import torch

    from repro.errors import bad_input
    from repro.robot_file.calibration_file import write_calibration
    from repro.robot_file.load import load_robot
    from repro_live.robot.calibrate import calibrate as fit
    from repro_live.robot.calibrate import check_plausible, pose_covariance, report
    from repro_live.robot.calibration_poses import read_poses

    torch.set_num_threads(1)
    if output.exists():
        raise bad_input("output", "repro calibrate", "a file that does not exist yet", output)
    described = load_robot(robot)
    for note in described.notes:
        print(f"Warning: {note}")
    described.sensing()  # refuses robots without magnetic sensors before anybody is asked for poses
    table = read_poses(poses, described)
    covariance = pose_covariance(described, pose_noise_mm * 1e-3, pose_noise_deg * torch.pi / 180)
    taken = _pose_readings(source, described, table, output, baud)
    for note in taken.notes:
        print(f"Warning: {note}")
    found = fit(described, taken.values, table.q, covariance)
    check_plausible(found, described)
    write_calibration(output, found)
    print(f"{report(found, described.unit)}\nWritten: {output}")
    return 0


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
    """
    import torch

    from repro.errors import bad_input

    if Path(port).is_file():
        given = {"output": output is not None, "browser": browser, "duration": duration != math.inf}
        of_a_port = [name for name, is_given in given.items() if is_given]
        return live_file(
            Path(port), robot, calibration, estimator, failed or [], estimates, of_a_port=of_a_port
        )

    from repro.robot_file.load import load_robot
    from repro_companion.book.project import shown
    from repro_live.follow import live_text
    from repro_live.follow.browser import BrowserView
    from repro_live.follow.estimate_table import EstimateFile
    from repro_live.follow.robot_estimator import robot_estimator
    from repro_live.follow.session import follow
    from repro_live.record.recording_file import WriteFailed

    if browser_socket is not None and not browser:
        raise bad_input("browser_socket", "repro live", "left out without --browser", browser_socket)
    torch.set_num_threads(1)
    described = load_robot(robot, calibration)
    for note in described.notes:
        print(f"Warning: {note}", file=sys.stderr)
    method, stop = robot_estimator(described, estimator, failed=failed or []), threading.Event()
    set_by_signals(stop)
    view = BrowserView(method, browser_socket or 0) if browser else None
    screen = _Block(method, view)
    print("Preparing the estimator (the first time its kernels are compiled: a minute).", file=sys.stderr)
    table = None if estimates is None else EstimateFile(estimates, method)
    each = None if table is None else lambda found: table.add(found.step.time_s, found.estimate)
    with view or nullcontext():
        if view is not None:
            print(f"Open {view.address} in a browser.", flush=True)
        options = {"output": output, "baud": baud, "duration_s": duration, "each": each}
        try:
            with table or nullcontext():
                state = follow(port, method, **options, stop=stop, show=screen.show, warn=screen.line)
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


class _Block:
    """Standard error: lines that are written over on a terminal, now and then a line elsewhere."""

    def __init__(self, estimator: RobotEstimator, view: BrowserView | None) -> None:
        self._estimator, self._view = estimator, view
        self._terminal = sys.stderr.isatty()
        self._shown = time.monotonic()
        self._height = 0
        self._lock = threading.Lock()

    def show(self, state: LiveState) -> None:
        from repro_live.follow import live_text

        if self._view is not None:
            self._view.publish(state)
        if time.monotonic() - self._shown < (BLOCK_S if self._terminal else PLAIN_S):
            return
        self._shown = time.monotonic()
        with self._lock:
            if not self._terminal:
                to_terminal(live_text.line(self._estimator, state))
                return
            lines = live_text.block(self._estimator, state)
            size = shutil.get_terminal_size()
            # a line that the terminal breaks, or one that it moved out of sight, could not be written over
            lines = [part for text in lines for part in textwrap.wrap(text, max(size.columns - 1, 20))]
            lines = lines[: size.lines - 1]
            to_terminal(self._up() + "\n".join(lines))
            self._height = len(lines)

    def line(self, text: str) -> None:
        """Write for good; the block goes on below."""
        with self._lock:
            to_terminal(self._up() + text)
            self._height = 0

    def _up(self) -> str:
        """Go to the beginning of the block and clear it."""
        return f"\x1b[{self._height}F\x1b[J" if self._height else ""


def _pose_readings(source: str, robot: RobotFile, poses: Poses, output: Path, baud: int) -> PoseReadings:
    """Readings in poses from a recording, from a file of readings, or from a person at a port."""
    from repro_live.record.recording import read_recording
    from repro_live.robot.calibration_port import guide, port_frames
    from repro_live.robot.calibration_poses import coordinate_columns, read_kept_readings, recorded_readings
    from repro_live.robot.kept_readings import KeptReadings, is_kept

    if is_kept(Path(source)):
        return read_kept_readings(Path(source), robot, poses)
    if Path(source).is_file():
        return recorded_readings(read_recording(Path(source)), robot, poses)
    frames = port_frames(source, baud, robot, print)
    beside = output.with_name(f"{output.stem}.readings.csv")
    kept = KeptReadings(beside, robot.channels, tuple(coordinate_columns(robot)))
    try:
        return guide(robot, poses, frames, say=print, ask=_ask, kept=kept)
    finally:
        print(f"Readings of {len(kept.parts)} of {len(poses.words)} poses are in {beside}.")


def _ask(question: str) -> None:
    from repro.errors import bad_input

    try:
        input(question)
    except EOFError as error:
        raise bad_input("answer", "repro calibrate", "the Enter key", "the end of the input") from error
