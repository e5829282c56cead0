"""The commands for a robot and for a board; ``repro`` adds those of the book to them.

Each command imports what it needs when it runs, so that help comes at once.
"""

from __future__ import annotations

import io
import math
import re
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import App, CycloptsError, Group, Parameter, Token

from repro.common import FULL_DISK, InputError, new, require, whole

if TYPE_CHECKING:
    from repro.improve import Improvement

ROBOT, BOARD, BOOK = (
    Group(name, sort_key=k) for k, name in enumerate(("A robot of your own", "A board on a wire", "The book"))
)
"""How ``repro --help`` lists the commands."""
EXTRAS = {
    "board": ("serial", "cobs", "mcap", "rich", "tornado"),
    "book": ("papermill", "nbformat", "ipykernel", "joblib", "requests"),
    "cluster": ("distributed",),
    "parquet": ("pyarrow",),
}
"""Which packages the extras bring."""

app = App(
    name="repro",
    help="The shape of a soft robot from its sensors, and the results of three papers on it.",
    version_flags=[],
    help_format="plaintext",
)
app["--help"].group = Group("Help", sort_key=9)


def as_typed(_: object, tokens: Sequence[Token]) -> list[tuple[str, str]]:
    """Return names and values as they were typed: a value may start with a hyphen or look like JSON."""
    words = [token.value for token in tokens]
    return list(zip(words[::2], words[1::2], strict=True))


def as_whole(_: object, tokens: Sequence[Token]) -> int:
    """Return a whole number; what is none is refused, where cyclopts would round it."""
    text = tokens[0].value
    if not re.fullmatch(r"[+-]?[0-9]{1,18}", text):
        raise ValueError(f"it must be a whole number of at most 18 digits; instead received {text}.")
    return int(text)


def pairs(*names: str) -> Parameter:
    """Return an option of a name and a value that may be given several times."""
    return Parameter(
        name=names,
        metavar="NAME VALUE",
        allow_leading_hyphen=True,
        negative="",
        json_list=False,
        json_dict=False,
        converter=as_typed,
    )


Output = Annotated[Path | None, Parameter(name=["-o", "--output"])]
NewFile = Annotated[Path, Parameter(name=["-o", "--output"])]
Whole = Annotated[int, Parameter(converter=as_whole)]
MaybeWhole = Annotated[int | None, Parameter(converter=as_whole)]
Flag = Annotated[bool, Parameter(negative="")]
Names = Annotated[list[str] | None, Parameter(negative="", metavar="NAME")]
Faults = Annotated[list[tuple[str, str]] | None, pairs("--fault")]


@app.command(group=ROBOT, sort_key=1)
def check(
    robot: Path,
    /,
    *,
    samples: Whole = 400,
    target_mm: float | None = None,
    improve: Flag = False,
    before_calibration: Flag = False,
    output: Output = None,
    picture: Path | None = None,
) -> int:
    """Say whether a robot can work, before any reading is taken; with --improve, what would help it.

    Parameters
    ----------
    robot
        A robot file (TOML).
    samples
        How many random shapes are tried.
    target_mm
        How well the tip is to be known: the median of its ± after a calibration.
    improve
        Where it cannot work or misses the target, look for better places of its chips and magnets, and for more
        chips. What may change is what the file marks as free.
    before_calibration
        The target, and the search, are about the ± before a calibration.
    output
        With --improve: the better robot, a new robot file.
    picture
        With --improve: the ± over the number of chips, a new picture (PNG, SVG or PDF).
    """
    from repro.check import check_design
    from repro.improve import falls_short, improve_design
    from repro.robot_file import load_robot

    positive = target_mm is None or 0 < target_mm < math.inf
    require(positive, "target_mm", "repro check", "positive", target_mm)
    aimed = improve or target_mm is not None or not before_calibration
    require(aimed, "before_calibration", "repro check", "left out without --target-mm or --improve", True)
    for name, given in (("output", output), ("picture", picture)):
        require(improve or given is None, name, "repro check", "left out without --improve", given)
        if given is not None:  # a search takes its time
            new(given, "repro check", name)
    kinds = (".png", ".svg", ".pdf")
    drawn = picture is None or picture.suffix in kinds
    require(drawn, "picture", "repro check", f"one of {', '.join(kinds)}", picture)
    arm, target = load_robot(robot), None if target_mm is None else target_mm / 1e3
    if improve:
        with shown_in_place() as show:
            found = improve_design(
                arm, target=target, as_built=before_calibration, samples=samples, show=show
            )
        write_improvement(found, robot, output, picture)
    else:
        found = check_design(arm, samples=samples)
    print(found)
    short = falls_short(found, target, before_calibration)
    if short and found.can_work:
        print(f"The target of ±{target_mm:g} mm is missed.")
    return int(short)


def write_improvement(found: Improvement, robot: Path, output: Path | None, picture: Path | None) -> None:
    """Write the new robot file and the picture of a search, where they are wanted and there is something to write."""
    from repro.robot_file import write_improved

    if output is not None and found.changes:
        write_improved(robot, found.robot, output)
    if picture is not None and found.by_chips:
        with whole(picture, "repro check") as part:
            found.plot().figure.savefig(part, format=picture.suffix[1:])
    for path, there in ((output, bool(found.changes)), (picture, bool(found.by_chips))):
        if path is not None:
            print(
                f"{path}" if there else f"{path} is not written: there is nothing to write.", file=sys.stderr
            )


@app.command(group=ROBOT, sort_key=2)
def track(
    readings: Path,
    /,
    *,
    robot: Path,
    output: Output = None,
    calibration: Path | None = None,
    estimator: str = "",
    smooth: Flag = False,
    failed: Names = None,
    rate: float | None = None,
) -> int:
    """Estimate the shape from readings: repro track READINGS --robot ROBOT.toml -o SHAPE.csv.

    Parameters
    ----------
    readings
        A recording of repro record, or a table: a column for each reading, by name or number.
    robot
        The robot file.
    output
        The estimates, a new CSV file.
    calibration
        From repro calibrate.
    estimator
        levenberg_marquardt (the default) or kalman.
    smooth
        Let later readings count as well: a Kalman filter, and back over it.
    failed
        Name of a sensor not to use, or its number from 1 in the robot file; may be repeated.
    rate
        Readings per second, where the table has no times.
    """
    from repro_board.evaluate import track_file

    return tell(track_file(
        readings, robot, output=output, calibration=calibration, estimator=estimator, smooth=smooth,
        failed=failed or (), rate_hz=rate,
    ))  # fmt: skip


@app.command(group=ROBOT, sort_key=3)
def calibrate(
    readings: Path,
    poses: Path | None = None,
    /,
    *,
    robot: Path,
    output: NewFile,
    by_motion: Annotated[bool, Parameter(name="--self", negative="")] = False,
    pose_noise_mm: float | None = None,
    pose_noise_deg: float | None = None,
    rate: float | None = None,
) -> int:
    """Calibrate a robot: repro calibrate READINGS POSES.csv --robot ROBOT.toml -o CALIBRATION.json.

    Parameters
    ----------
    readings
        A recording or a table of readings, taken while the robot is held in known poses.
    poses
        A table with a column for each coordinate, and from when to when it was held so: start_s and end_s after the
        first reading, or by the clock of the board or of the day, start_board_s or start_unix_s.
    robot
        The robot file.
    output
        The calibration, a new JSON file.
    by_motion
        Without measured poses: find moments, gains and offsets while the robot bends every way.
    pose_noise_mm
        How well the poses are known: standard deviation of their lengths; 0.2 if not given.
    pose_noise_deg
        The same of their angles; 0.5 if not given.
    rate
        Readings per second, where their table has no times.
    """
    from repro_board.evaluate import calibrate_by_motion, calibrate_files

    noise = {"pose_noise_mm": pose_noise_mm, "pose_noise_deg": pose_noise_deg}
    if by_motion:
        for name, given in {"poses": poses, **noise}.items():
            require(given is None, name, "repro calibrate", "left out with --self", given)
        done = calibrate_by_motion(readings, robot, output, rate_hz=rate)
    else:
        stated = {name: value for name, value in noise.items() if value is not None}
        done = calibrate_files(readings, poses, robot, output, rate_hz=rate, **stated)
    return tell(done)


@app.command(group=ROBOT, sort_key=4)
def evaluate(
    readings: Path,
    poses: Path,
    /,
    *,
    robot: Path,
    output: NewFile,
    body: Names = None,
    straight_s: float = 0.0,
    pose_noise_mm: float = 0.2,
    pose_noise_deg: float = 0.5,
    share: float = 0.4,
    longest_lag: float = 10.0,
    rate: float | None = None,
) -> int:
    """Compare estimates with motion capture: repro evaluate READINGS POSES --robot ROBOT.toml -o FOLDER.

    Finds the lag between the two clocks, calibrates the robot on the first part of the recording, estimates the shape
    in the rest from a cold start, and says how far that is from the measured poses, before and after.

    Parameters
    ----------
    readings
        A recording or a table of readings.
    poses
        A table of coordinates or of poses over time, or a file of Motive, Vicon or Qualisys.
    robot
        The robot file.
    output
        A new folder: errors.csv, estimates.csv, estimates.png, report.txt, calibration.json.
    body
        The rigid body on the end of a segment, from base to tip; may be repeated. One more, given first, is the base.
    straight_s
        The robot is straight for the first so many seconds, standing or hanging: there, the bodies are aligned with
        the segments, and the axes of the base with the room.
    pose_noise_mm
        How well the poses are known: standard deviation of their lengths.
    pose_noise_deg
        The same of their angles.
    share
        Of the time, for the first part.
    longest_lag
        Largest difference between the clocks that is tried, in seconds.
    rate
        Readings per second, where their table has no times.
    """
    from repro_board.evaluate import evaluate_files

    return tell(evaluate_files(
        readings, poses, robot, output, bodies=body or (), straight_s=straight_s, pose_noise_mm=pose_noise_mm,
        pose_noise_deg=pose_noise_deg, share=share, longest_lag_s=longest_lag, rate_hz=rate,
    ))  # fmt: skip


@app.command(group=ROBOT, sort_key=5)
def show(
    file: Path,
    /,
    *,
    robot: Path,
    output: NewFile,
    estimates: Path | None = None,
) -> int:
    """Write shape, readings and alarms as a page: repro show FILE --robot ROBOT.toml -o PAGE.html.

    Parameters
    ----------
    file
        A recording of repro record, a table of readings, or the estimates of repro track.
    robot
        The robot file.
    output
        A new HTML file, which a browser shows without a network.
    estimates
        What repro track or live wrote of this recording or these readings; if not given they are tracked now.
    """
    from repro_board.show import show_file

    return tell(show_file(file, robot, output, estimates=estimates))


@app.command(group=BOARD, sort_key=1)
def record(
    port: str = "",
    /,
    *,
    output: Output = None,
    baud: Whole = 115200,
    format: str = "",
    channels: MaybeWhole = None,
    duration: float = math.inf,
    list_only: Annotated[bool, Parameter(name="--list", negative="")] = False,
) -> int:
    """Record a port: repro record PORT -o FILE.rec; stop with Ctrl-C.

    In a terminal, the key n writes a note into the recording, with its time: type it, then Enter, or Esc to drop it.
    The key u lets go of the port for 30 seconds, to upload firmware, and takes it back at once if pressed again.

    Parameters
    ----------
    port
        Such as /dev/ttyACM0, COM3 or socket://localhost:7000.
    output
        The recording, a new file with every byte that came and when.
    baud
        Bits per second; means nothing to a board that is itself a USB device.
    format
        What the board sends, for the counts that are shown: frames, csv, hall, millivolts or quaternions. Found by
        itself if not given.
    channels
        How many values a frame has, for the counts that are shown.
    duration
        Stop after this many seconds.
    list_only
        Record nothing; list the ports.
    """
    from repro_board import live as tool
    from repro_board.session import ports

    if list_only:
        print(ports())
        return 0
    require(port, "PORT", "repro record", "given (repro record --list shows them)", "none")
    if output is None:
        raise InputError("Input output of repro record must be given (-o FILE.rec); instead received none.")
    with shown_in_place() as show:
        done = tool.record(
            port, output, baud=baud, format=format or None, channels=channels, duration_s=duration, show=show
        )
    print(done)
    if done.path is None:
        print("Nothing came, and no file was written.", file=sys.stderr)
    return int(not done.samples)


@app.command(group=BOARD, sort_key=2)
def live(
    port: str,
    /,
    *,
    robot: Path,
    calibration: Path | None = None,
    estimator: str = "",
    output: Output = None,
    estimates: Path | None = None,
    browser: Flag = False,
    browser_socket: Whole = 0,
    failed: Names = None,
    baud: Whole = 115200,
    format: str = "",
    duration: float = math.inf,
    grown: float = 1.0,
) -> int:
    """Estimate the shape from a port: repro live PORT --robot ROBOT.toml; stop with Ctrl-C.

    In a terminal, the key n writes a note into the recording of -o, and u lets go of the port for 30 seconds, as in
    repro record.

    Parameters
    ----------
    port
        Such as /dev/ttyACM0, COM3 or socket://localhost:7000.
    robot
        The robot file.
    calibration
        From repro calibrate.
    estimator
        levenberg_marquardt (the default) or kalman.
    output
        Also record everything that arrives, as repro record does; a new file.
    estimates
        Also write the estimates, as repro track does; a new CSV file, which is there when the session ends.
    browser
        Show shape and readings on a page for the browser of this computer; its address is printed.
    browser_socket
        Number of a TCP port of this computer for that page; 0 for a free one.
    failed
        Name of a sensor not to use, or its number from 1 in the robot file; may be repeated.
    baud
        Bits per second of the port.
    format
        What the board sends, if not what the robot file says.
    duration
        Stop after this many seconds.
    grown
        State every ± so many times as large, if repro evaluate finds the truth outside too often.
    """
    from repro_board import live as tool

    require(
        browser or not browser_socket, "browser_socket", "live", "left out without --browser", browser_socket
    )
    line = tool.Line(port, baud, format or None)
    done = tool.live(
        line, robot, tool.Method(estimator, calibration, failed or (), grown), output=output, estimates=estimates,
        browser_socket=browser_socket if browser else None, duration_s=duration,
    )  # fmt: skip
    print(done)
    return int(not done.found["estimates"])


@app.command(group=BOARD, sort_key=3)
def export(
    recording: Path,
    /,
    *,
    output: NewFile,
    to: str = "",
    robot: Path | None = None,
    estimates: Path | None = None,
) -> int:
    """Write a recording for other programs: repro export RECORDING -o FILE.csv, .parquet or .mcap.

    Parameters
    ----------
    recording
        From repro record.
    output
        A new file.
    to
        csv, parquet or mcap (for Foxglove and PlotJuggler); by default as the name of the file says.
    robot
        The robot file that names the readings and their unit.
    estimates
        For mcap: a table that repro track or live wrote of this recording; with --robot also as poses in 3-D.
    """
    from repro_board.export import export as export_to

    remarks, samples = export_to(recording, output, to=to, robot=robot, estimates=estimates)
    for remark in remarks:
        print(remark, file=sys.stderr)
    return tell(f"{output}  ({samples} samples)")


@app.command(group=BOARD, sort_key=4)
def emulate(
    source: Path,
    /,
    *,
    rate: float | None = None,
    speed: float = 1.0,
    loop: Flag = False,
    tolerances: float = 0.0,
    hold_poses: Path | None = None,
    hold: float | None = None,
    fault: Faults = None,
    fault_from: float = 0.0,
    seed: Whole = 0,
    port_file: Path | None = None,
    socket: MaybeWhole = None,
) -> int:
    """Play readings into a port as a board would: repro emulate ROBOT.toml or RECORDING; stop with Ctrl-C.

    Parameters
    ----------
    source
        A robot file, whose robot moves and reads what its sensors would (synthetic); or a recording.
    rate
        Readings per second.
    speed
        Speed relative to real time; inf: as fast as the reader takes it.
    loop
        Begin a recording again at its end.
    tolerances
        How far the robot is from its file: 0 as described, 1 as repro check assumes.
    hold_poses
        Hold the robot in one pose after the other, and write them to this new table.
    hold
        For so many seconds in each pose.
    fault
        A fault and its value, such as --fault flips 1e-4; may be repeated. Chances: flips, drops, duplicates, bursts,
        stalls, disconnects, reboots. Name or number of a sensor: unplug, stick, saturate, gain, nan. Distance of a
        foreign magnet in mm: magnet. Times the noise of the file: noise. Of the clock: drift_ppm.
    fault_from
        The faults begin so many seconds after the first reading.
    seed
        Of motion, readings and faults.
    port_file
        Name of the port, a symbolic link.
    socket
        Number of a TCP port of this computer instead, 0 for a free one.
    """
    from repro_board.emulate import emulate as play

    require(socket is None or port_file is None, "port_file", "emulate", "left out with socket", port_file)
    return play(
        source, port_file or socket or 0, rate_hz=rate, speed=speed, loop=loop, tolerances=tolerances,
        hold_poses=hold_poses, hold_s=hold, faults=fault or (), fault_from=fault_from, seed=seed,
    )  # fmt: skip


def tell(done: object) -> int:
    """Print what a command did; return that all is well."""
    print(done)
    return 0


@contextmanager
def shown_in_place() -> Iterator[Callable[[object], None] | None]:
    """Give what shows a state: in one place on a terminal, else not at all."""
    from rich.console import Console
    from rich.live import Live
    from rich.text import Text

    console = Console(stderr=True)
    if not console.is_terminal:
        yield None
        return
    with Live(
        console=console, auto_refresh=False, transient=True
    ) as place:  # at its end the cursor is seen again
        yield lambda state: place.update(Text(str(state)), refresh=True)


def says_extras(name: str, extras: Sequence[str]) -> int:
    """Say which extras a command lacks, and return its status."""
    named = f"the extra{'s' if len(extras) > 1 else ''} " + " and ".join(f'"{extra}"' for extra in extras)
    print(f'{name} needs {named}: pip install "repro-soft-robots[{",".join(extras)}]"', file=sys.stderr)
    return 2


def main(words: Sequence[str] | None = None, commands: App = app) -> int:
    """Run a command; return its status: 1 where something came out badly, 2 for input that cannot be used."""
    words = sys.argv[1:] if words is None else list(words)
    if isinstance(sys.stdout, io.TextIOWrapper):
        sys.stdout.reconfigure(errors="replace")  # a terminal without ± shows a question mark
    name = f"repro {words[0]}" if words and not words[0].startswith("-") else "repro"
    try:
        return commands(words, exit_on_error=False, print_error=False, result_action="return_value") or 0
    except (InputError, CycloptsError) as error:
        print(f"{name}: {error}", file=sys.stderr)
    except ModuleNotFoundError as missing:
        package = str(missing.name).partition(".")[0]
        if package.startswith("repro"):
            raise
        return says_extras(name, [next((x for x, brought in EXTRAS.items() if package in brought), "book")])
    except OSError as error:
        what = f"{error.filename}: {error.strerror}" if error.filename else error
        print(f"{name}: a file cannot be read or written: {what}", file=sys.stderr)
        return 1 if error.errno in FULL_DISK else 2
    except KeyboardInterrupt:
        return 130
    return 2


if __name__ == "__main__":
    sys.exit(main())
