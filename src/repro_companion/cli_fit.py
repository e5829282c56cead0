"""The command ``repro fit``; registered by `repro_companion.cli`. It imports what it needs when it runs."""

from __future__ import annotations

import math
import sys
from pathlib import Path
from typing import Annotated

from cyclopts import Parameter


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
    import torch

    from repro.errors import bad_input
    from repro.robot_file.load import load_robot
    from repro_live.follow.readings_file import read_readings
    from repro_live.own.fit import fit as fit_recording
    from repro_live.own.poses import read_measured_poses
    from repro_live.own.readings import timed_readings
    from repro_live.own.results import check_new, write_results

    torch.set_num_threads(1)
    check_new(output)
    if not (0 < pose_noise_mm < math.inf and 0 < pose_noise_deg < math.inf):
        given = f"{pose_noise_mm:g} mm and {pose_noise_deg:g} deg"
        raise bad_input("pose noise", "repro fit", "positive", given)
    described = load_robot(robot)
    for note in described.notes:
        print(f"Warning: {note}")
    described.sensing()  # refuses robots without magnetic sensors
    noise = {"noise_m": pose_noise_mm * 1e-3, "noise_rad": pose_noise_deg * torch.pi / 180}
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
