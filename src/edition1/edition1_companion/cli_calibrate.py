"""Calibration of a robot, in measured poses or by motion; thin, it imports what it needs when it runs."""

from __future__ import annotations

import math
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter

from edition1.errors import bad_input, require
from edition1_companion.cli_terminal import load_described

if TYPE_CHECKING:
    from edition1.robot_file.robot_file import RobotFile
    from edition1_live.own.motion import Beginning
    from edition1_live.robot.calibration_poses import PoseReadings, Poses


def calibrate(
    source: str,
    /,
    *,
    robot: Path,
    output: Annotated[Path, Parameter(name=["-o", "--output"])],
    poses: Path | None = None,
    by_motion: Annotated[bool, Parameter(name="--self", negative="")] = False,
    calibration: Path | None = None,
    duration: float = 300.0,
    elongation_mm: float | None = None,
    straight_mm: float | None = None,
    pose_noise_mm: float = 0.2,
    pose_noise_deg: float = 0.5,
    baud: int = 115200,
) -> int:
    """Calibrate a robot: repro calibrate PORT --robot ROBOT.toml --poses POSES.csv -o CALIBRATION.json.

    Leads through the poses at a port, or takes them from a recording. Fits the placement of magnets and sensors,
    gains, offsets, the moments of the magnets and the Earth field in the base frame; says what stays undetermined.
    With --self no poses are measured: moments, gains and offsets are found while the robot moves.

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
        The calibration, JSON; must not exist yet. At a port the readings of every pose, or with --self of the motion,
        are kept beside it as they come. With poses the same command goes on after an interruption; a motion that was
        interrupted is kept, to be given in place of the port or moved away.
    by_motion
        Without measured poses, while the robot bends every way.
    calibration
        With --self, an earlier calibration in poses, which knows the placement and the Earth field.
    duration
        With --self at a port, how many seconds of motion to record.
    elongation_mm
        With --self, the elongation that every segment keeps while it bends, known to the pose noise in mm.
    straight_mm
        With --self, the robot is straight at its first reading, every segment longer by so many mm; both known to the
        pose noise. Where a segment cannot stretch, 0.
    pose_noise_mm, pose_noise_deg
        How well the poses are known: standard deviation of coordinates in mm, and of those in rad and deg.
    baud
        Bits per second of the port.
    """
    from edition1_live.robot.calibrate import calibrate as fit
    from edition1_live.robot.calibrate import check_plausible, pose_covariance, report
    from edition1_live.robot.calibration_poses import read_poses

    require(not output.exists(), "output", "repro calibrate", "a file that does not exist yet", output)
    place = next(folder for folder in output.absolute().parents if folder.exists())
    require(place.is_dir(), "output", "repro calibrate", "in a folder", f"{output}: {place} is none")
    described = load_described(robot)
    described.sensing()  # refuses robots without magnetic sensors before anybody is asked for poses
    covariance = pose_covariance(described, pose_noise_mm * 1e-3, pose_noise_deg * math.pi / 180)
    if by_motion:
        from edition1_live.own.motion import Beginning, at_elongation

        require(poses is None, "poses", "repro calibrate --self", "left out", poses)
        expected = "a name such as today.json: the motion is recorded to the same with .rec"
        require(output.suffix != ".rec", "output", "repro calibrate --self", expected, output)
        asked = "bend every segment every way, and stretch it"
        begins = None
        if elongation_mm is not None:
            asked = "bend every segment every way, and do not stretch it"
            described = at_elongation(described, elongation_mm * 1e-3, pose_noise_mm * 1e-3)
        if straight_mm is not None:
            asked = f"begin straight, {asked}"
            begins = Beginning.straight(described, straight_mm * 1e-3, covariance)
        return _calibrate_by_motion(
            source,
            described,
            output,
            calibration=calibration,
            begins=begins,
            asked=asked,
            duration=duration,
            baud=baud,
        )
    for name, given in {
        "elongation": elongation_mm,
        "straight": straight_mm,
        "calibration": calibration,
    }.items():
        require(given is None, name, "repro calibrate", "left out without --self", given)
    if poses is None:
        raise bad_input("poses", "repro calibrate", "given (--poses POSES.csv), or --self", "neither")
    table = read_poses(poses, described)
    taken = _pose_readings(source, described, table, output, baud)
    for note in taken.notes:
        print(f"Warning: {note}")
    found = fit(described, taken.values, table.q, covariance)
    check_plausible(found, described)
    found.write(output)
    print(f"{report(found, described.unit)}\nWritten: {output}")
    return 0


def _calibrate_by_motion(
    source: str,
    robot: RobotFile,
    output: Path,
    *,
    calibration: Path | None,
    begins: Beginning | None,
    asked: str,
    duration: float,
    baud: int,
) -> int:
    """Find moments, gains and offsets from a file of readings in motion, or from a port."""
    from edition1.robot_file.calibration_file import RobotCalibration
    from edition1_live.own.samples import timed_readings
    from edition1_live.own.self_calibration import report, self_calibrate
    from edition1_live.record.recorder import record
    from edition1_live.record.recording import read_recording
    from edition1_live.robot.readings_file import read_readings

    earlier = None if calibration is None else RobotCalibration.read(calibration)
    owner = "repro calibrate --self"
    file = Path(source)
    if not file.is_file():
        file = output.with_suffix(".rec")
        if file.exists():
            earlier_motion = read_recording(file)
            whole = earlier_motion.metadata.get("ended") == "stopped"
            expected = (
                f"recorded to its end (to record anew, move {file} away; to use it, give it as the port)"
            )
            received = f"one that was interrupted after {len(earlier_motion.frames)} frames"
            require(whole, "earlier motion", owner, expected, received)
            print(f"{file} holds an earlier motion, which is used; to record anew, move it away.")
        else:
            print(f"Recording {duration:g} s to {file}: {asked}.", flush=True)
            channels = robot.channels if robot.format == "csv" else None
            options = {"baud": baud, "channels": channels, "duration_s": duration, "unit": robot.unit}
            try:
                record(source, robot.format, file, owner=owner, **options)
            except BaseException:
                if file.is_file():
                    print(f"Interrupted: {file} keeps what came.")
                raise
            require(file.is_file(), "port", owner, "one at which frames arrive", f"none for {duration:g} s")
    taken = timed_readings(read_readings(file, robot), robot, owner)
    for note in taken.notes:
        print(f"Warning: {note}")
    found = self_calibrate(robot, taken, earlier=earlier, begins=begins, progress=sys.stderr.isatty())
    found.calibration.write(output)
    print(f"{report(found)}\nWritten: {output}")
    return 0


def _pose_readings(source: str, robot: RobotFile, poses: Poses, output: Path, baud: int) -> PoseReadings:
    """Readings in poses from a recording, from a file of readings, or from a person at a port."""
    from edition1_live.record.recording import read_recording
    from edition1_live.robot.calibration_port import guide, port_frames
    from edition1_live.robot.calibration_poses import (
        coordinate_columns,
        read_kept_readings,
        recorded_readings,
    )
    from edition1_live.robot.kept_readings import KeptReadings, is_kept

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
    try:
        input(question)
    except EOFError as error:
        raise bad_input("answer", "repro calibrate", "the Enter key", "the end of the input") from error
