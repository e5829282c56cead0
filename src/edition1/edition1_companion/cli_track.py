"""The commands ``repro track``, ``repro smooth`` and ``repro fit``: estimation of what was recorded."""

from __future__ import annotations

import math
import sys
from collections.abc import Sequence
from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from edition1.errors import bad_input, require
from edition1_companion.book.project import shown
from edition1_companion.cli_terminal import load_described


def track(
    file: Path,
    /,
    *,
    robot: Path,
    output: Annotated[Path, Parameter(name=["-o", "--output"])],
    calibration: Path | None = None,
    estimator: str = "",
    failed: Annotated[list[int] | None, Parameter(negative="", metavar="NUMBER")] = None,
    grown: float = 1.0,
) -> int:
    """Estimate the shape from a recording: repro track FILE --robot ROBOT.toml -o ESTIMATES.csv.

    Parameters
    ----------
    file
        A recording of repro record; or a CSV with time_s and a column for each reading, such as u1_mT or channel_1.
    robot
        The robot as described.
    output
        The estimates, a new CSV: times, coordinates and the tip with their uncertainty.
    calibration
        From repro calibrate.
    estimator
        As for repro live.
    failed
        Number of a sensor not to use, from 1; may be repeated.
    grown
        As for repro live.
    """
    return estimated(file, robot, calibration, estimator, failed or [], output, grown)


def estimated(
    file: Path,
    robot: Path,
    calibration: Path | None,
    estimator: str,
    failed: Sequence[int],
    output: Path | None,
    grown: float,
) -> int:
    """Estimate a file, write the estimates if there is an output, and say what came of it."""
    from edition1_live.follow.estimate_table import EstimateFile
    from edition1_live.follow.follower import track_readings
    from edition1_live.follow.live_text import limits
    from edition1_live.follow.robot_estimator import robot_estimator
    from edition1_live.record.recording_file import WriteFailed
    from edition1_live.robot.readings_file import read_readings

    described = load_described(robot, calibration, to=sys.stderr)
    method = replace(robot_estimator(described, estimator, failed=failed), grown=grown)
    for never in limits(method):
        print(f"Note: {never}", file=sys.stderr)
    readings = read_readings(file, described)
    table = None if output is None else EstimateFile(output, method)
    each = (lambda *_: None) if table is None else table.add
    print("Preparing the estimator (the first time its kernels are compiled: a minute).", file=sys.stderr)
    try:
        with table or nullcontext():
            method.prepared()
            follower, said = track_readings(readings, method, each, progress=sys.stderr.isatty())
    except WriteFailed as failure:
        print(f"repro: {failure}", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        print(f"Stopped; {0 if table is None else table.written} estimates are written.", file=sys.stderr)
        return 130
    print("\n".join(said), file=sys.stderr)
    if not follower.estimated:
        print("No frame could be used.", file=sys.stderr)
        return 1
    if table is None:
        print("Nothing is stored: repro track -o FILE.csv, or --estimates FILE.csv, does.", file=sys.stderr)
    else:
        print(f"{shown(table.path)}  ({table.written} estimates)")
    return 0


def smooth(
    file: Path,
    /,
    *,
    robot: Path,
    output: Annotated[Path, Parameter(name=["-o", "--output"])],
    calibration: Path | None = None,
    failed: Annotated[list[int] | None, Parameter(negative="", metavar="NUMBER")] = None,
    lag: float = math.inf,
) -> int:
    """Estimate the shape by earlier and later readings: repro smooth FILE --robot ROBOT.toml -o ESTIMATES.csv.

    A Kalman filter, then back over its estimates. For robots with magnetic sensors.

    Parameters
    ----------
    file
        A recording of repro record; or a CSV with time_s and a column for each reading, such as u1_mT or channel_1.
    robot
        The robot as described.
    output
        The estimates, a new CSV with the columns of repro track.
    calibration
        From repro calibrate.
    failed
        Number of a sensor not to use, from 1; may be repeated.
    lag
        How many seconds later a reading may be to count; all of them when not given.
    """
    from edition1_live.follow.estimate_table import EstimateFile
    from edition1_live.follow.robot_estimator import robot_estimator
    from edition1_live.follow.smoother import smooth_readings
    from edition1_live.record.recording_file import WriteFailed
    from edition1_live.robot.readings_file import read_readings

    described = load_described(robot, calibration, to=sys.stderr)
    expected = "one with magnetic sensors (repro track takes IMUs)"
    require(described.channel, "robot", "repro smooth", expected, described.name)
    method = robot_estimator(described, "kalman", failed=failed or [])
    readings = read_readings(file, described)
    table = EstimateFile(output, method)
    print("Preparing the estimator (the first time its kernels are compiled: a minute).", file=sys.stderr)
    try:
        with table:
            estimates, said = smooth_readings(readings, method, lag_s=lag, progress=sys.stderr.isatty())
            for time_s, estimate in estimates:
                table.add(time_s, estimate)
    except WriteFailed as failure:
        print(f"repro: {failure}", file=sys.stderr)
        return 1
    print("\n".join(said), file=sys.stderr)
    print(f"{shown(table.path)}  ({table.written} estimates)")
    return 0


def fit(
    readings: Path,
    poses: Path,
    /,
    *,
    robot: Path,
    output: Annotated[Path, Parameter(name=["-o", "--output"])],
    model: str = "calibration",
    body: Annotated[list[str] | None, Parameter(negative="", metavar="NAME")] = None,
    straight_s: float = 0.0,
    pose_noise_mm: float = 0.2,
    pose_noise_deg: float = 0.5,
    share: float = 0.4,
    longest_lag: float = 10.0,
    seed: int = 0,
) -> int:
    """Judge a robot by motion capture: repro fit READINGS POSES.csv --robot ROBOT.toml -o FOLDER.

    Finds the lag between the two clocks, calibrates the robot on the first part of the recording, estimates the shape
    in the rest from a cold start, and says how far that is from the measured poses, before and after.

    Parameters
    ----------
    readings
        A recording of repro record, or a CSV as for repro track: time_s, and a column for each reading by its name.
    poses
        A CSV with time_s and a column for each coordinate, such as delta_x_1_mm; or for the end of every segment
        x_1_mm, y_1_mm, z_1_mm, qx_1, qy_1, qz_1, qw_1; or a CSV that Motive exported.
    robot
        The robot as described.
    output
        A new folder: errors.csv, estimates.csv, estimates.png, report.txt, calibration.json.
    model
        calibration; or network: a small network for each sensor is trained on the first part instead.
    body
        For a CSV of Motive: the rigid body on the end of a segment, from base to tip; may be repeated. One more,
        given first, is the base.
    straight_s
        The robot stands straight and unstretched for the first so many seconds: there, turns and shifts of the bodies
        against the ends of the segments are measured.
    pose_noise_mm, pose_noise_deg
        How well the poses are known: standard deviation of lengths, and of angles.
    share
        Of the time, for the first part.
    longest_lag
        Largest difference between the clocks that is tried, in seconds.
    seed
        Of the networks.
    """
    from edition1_live.own.fit import fit as fit_recording
    from edition1_live.own.poses import read_measured_poses
    from edition1_live.own.results import check_new, write_results
    from edition1_live.own.samples import timed_readings
    from edition1_live.robot.readings_file import read_readings

    check_new(output)
    if not (0 < pose_noise_mm < math.inf and 0 < pose_noise_deg < math.inf):
        given = f"{pose_noise_mm:g} mm and {pose_noise_deg:g} deg"
        raise bad_input("pose noise", "repro fit", "positive", given)
    described = load_described(robot)
    described.sensing()  # refuses robots without magnetic sensors
    noise = {"noise_m": pose_noise_mm * 1e-3, "noise_rad": pose_noise_deg * math.pi / 180}
    measured = read_measured_poses(poses, described, bodies=body or [], straight_s=straight_s, **noise)
    taken = timed_readings(read_readings(readings, described), described)
    found = fit_recording(
        described,
        taken,
        measured,
        model=model,
        share=share,
        longest_lag_s=longest_lag,
        seed=seed,
        say=lambda text: print(text, file=sys.stderr, flush=True),
    )
    print(f"{write_results(output, found, measured)}\n\nWritten: {output}")
    return 0
