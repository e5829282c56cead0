"""The command ``repro track``, and ``repro live`` of a file: estimation of what was recorded."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from repro.errors import bad_input


def track(
    file: Path,
    /,
    *,
    robot: Path,
    output: Annotated[Path, Parameter(name=["-o", "--output"])],
    calibration: Path | None = None,
    estimator: str = "",
    failed: Annotated[list[int] | None, Parameter(negative="", metavar="NUMBER")] = None,
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
    """
    return estimated(file, robot, calibration, estimator, failed or [], output)


def live_file(
    file: Path,
    robot: Path,
    calibration: Path | None,
    estimator: str,
    failed: Sequence[int],
    estimates: Path | None,
    *,
    of_a_port: Sequence[str] = (),
) -> int:
    """Estimate a file that was given to ``repro live`` in place of a port; refuse options that only a port has."""
    if of_a_port:
        raise bad_input(
            of_a_port[0], "repro live", f"left out for {file.name}, which is a file, not a port", "it"
        )
    print(
        f"{file.name} is a file, not a port: it is estimated at full speed, not in its own time.",
        file=sys.stderr,
    )
    return estimated(file, robot, calibration, estimator, failed, estimates)


def estimated(
    file: Path,
    robot: Path,
    calibration: Path | None,
    estimator: str,
    failed: Sequence[int],
    output: Path | None,
) -> int:
    """Estimate a file, write the estimates if there is an output, and say what came of it."""
    import torch

    from repro.robot_file.load import load_robot
    from repro_companion.book.project import shown
    from repro_live.follow.estimate_table import EstimateFile
    from repro_live.follow.offline import track_readings
    from repro_live.follow.readings_file import read_readings
    from repro_live.follow.robot_estimator import robot_estimator
    from repro_live.follow.verdict_words import redundancy_words
    from repro_live.record.recording_file import WriteFailed

    torch.set_num_threads(1)
    described = load_robot(robot, calibration)
    for note in described.notes:
        print(f"Warning: {note}", file=sys.stderr)
    method = robot_estimator(described, estimator, failed=failed)
    if never := redundancy_words(*method.redundancy):
        print(f"Note: {never}", file=sys.stderr)
    readings = read_readings(file, described)
    table = None if output is None else EstimateFile(output, method)
    each = (lambda *_: None) if table is None else table.add
    print("Preparing the estimator (the first time its kernels are compiled: a minute).", file=sys.stderr)
    try:
        try:
            method.prepared()
            tracked = track_readings(readings, method, each, progress=sys.stderr.isatty())
        finally:
            if table is not None:
                table.close()
    except WriteFailed as failure:
        print(f"repro: {failure}", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        print(f"Stopped; {0 if table is None else table.written} estimates are written.", file=sys.stderr)
        return 130
    print("\n".join(tracked.lines()), file=sys.stderr)
    if not tracked.follower.estimated:
        print("No frame could be used.", file=sys.stderr)
        return 1
    if table is None:
        print("Nothing is stored: repro track -o FILE.csv, or --estimates FILE.csv, does.", file=sys.stderr)
    else:
        print(f"{shown(table.path)}  ({table.written} estimates)")
    return 0
