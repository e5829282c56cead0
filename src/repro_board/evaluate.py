"""What ``track``, ``calibrate`` and ``evaluate`` do with files.

Each function takes files, writes new files only, and returns a :class:`Report`. An evaluation finds the lag between
the clocks, calibrates the robot on the first part of the recording, estimates the rest from a cold start, and
compares with the measured poses, which enter no estimate.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pandas as pd

from repro.check import mirrors_in_words
from repro.common import Array, bad_input, new, require, whole
from repro.estimators.calibration import Calibration, calibrate, calibration_text, load_calibration
from repro.estimators.kalman import KalmanFilter
from repro.estimators.least_squares import LevenbergMarquardt
from repro.estimators.track import Trajectory, track
from repro.estimators.track import smooth as smoothed
from repro.motion_files import Poses, read_poses
from repro.readings import Readings
from repro.robot import Robot
from repro.robot_file import load_robot
from repro.tables import read_table
from repro_board.calibrations import TOLERANCES, by_motion, with_poses
from repro_board.cleaning import averaged, complete, frozen, repeats, unwrapped, without_spikes
from repro_board.export import table_of
from repro_board.lag import GAP_STEPS, Signal, clock_lag, fine_lag, held_lag, in_axes_of_the_readings
from repro_board.record import Note, Recording, is_recording, read_recording, readings_of
from repro_board.report import (
    Report,
    calibration_report,
    csv,
    errors_table,
    notes_in_words,
    picture,
    some,
    suspicions,
    tip_known,
    written,
)

ESTIMATORS = ("levenberg_marquardt", "kalman")
"""Those that a monitor watches."""
NOT_WRITTEN = "No table is written (-o shape.csv writes one)."
_WINDOW_S = 0.5
"""Readings are averaged over this time around a pose with one time."""
_MOST_NOISE = 1e4
"""Of measured poses [mm, deg]."""
_LEAST_S, _APART_S = 5.0, 1.0
"""Shortest part of an evaluation, and time between the two parts [s]."""


def _robot(path: Path | str, owner: str) -> Robot:
    robot = load_robot(path)
    stated = robot.total_noise is not None and robot.lower is not None
    require(stated, "robot", owner, "one whose file states the noise of its readings", "none")
    return robot


def _readings(robot: Robot, source: Path | str | Recording, rate_hz: float | None = None) -> Readings:
    table: object = source
    if rate_hz is not None and not isinstance(source, Recording):
        expected = "left out for a recording, which has its own times"
        require(not is_recording(source), "rate", Path(source).name, expected, rate_hz)
        table = read_table(source, rate_hz)
    u = readings_of(robot, table)
    u.remarks = (*u.remarks, *_pace(robot, u.times))
    return u


def _pace(robot: Robot, times: Array | None) -> list[str]:
    """Say what is odd about the times of readings."""
    if times is None:
        unknown = "There are neither times nor a rate: rows count as one second each (give --rate)."
        return [] if robot.rate_hz else [unknown]
    if len(times) < 3:
        return []
    steps, found = np.diff(times), []
    usual, k = float(np.median(steps)), int(steps.argmax())
    if robot.rate_hz and not 0.2 < usual * robot.rate_hz < 5.0:
        stated = f"the robot file says {robot.rate_hz:g} readings in a second"
        found.append(f"The readings are {usual:.3g} s apart, but {stated}: is the unit of the times right?")
    if steps[k] > max(GAP_STEPS * usual, 0.2):
        found.append(f"The longest gap without a reading is {steps[k]:.3g} s, after {times[k]:.3f} s.")
    return found


def estimator_of(
    robot: Robot, name: str = "", owner: str = "repro track"
) -> LevenbergMarquardt | KalmanFilter:
    """Return the estimator of a name for a robot: least squares if none is given."""
    name = name or ESTIMATORS[0]
    require(name in ESTIMATORS, "estimator", owner, f"one of {', '.join(ESTIMATORS)}", name)
    return KalmanFilter(robot) if name == "kalman" else LevenbergMarquardt(robot)


def with_calibration(shape: Trajectory, calibration: Calibration | None) -> Trajectory:
    """Return estimates whose covariances hold what the calibration left open, too."""
    if calibration is None:
        return shape
    parts = np.array_split(shape.q, 1 + len(shape.q) // 2000)  # of bounded memory
    lasting = np.concatenate([calibration.lasting_covariance(part) for part in parts])
    return replace(shape, covariance=shape.covariance + lasting)


def track_file(
    readings: Path | str | Recording,
    robot: Path | str,
    *,
    output: Path | str | None = None,
    calibration: Path | str | None = None,
    estimator: str = "",
    smooth: bool = False,
    failed: Sequence[int | str] = (),
    rate_hz: float | None = None,
) -> Report:
    """Estimate the shape from a recording or a table of readings, and write the estimates as a table."""
    owner = "repro track"
    path = None if output is None else new(output, owner)
    described = _robot(robot, owner)
    known = None if calibration is None else load_calibration(calibration, described)
    arm = described if known is None else known.robot
    if smooth:
        require(estimator in ("", "kalman"), "estimator", owner, "kalman with --smooth", estimator)
    method = estimator_of(arm, "kalman" if smooth else estimator)
    u = _readings(arm, readings, rate_hz)
    for name in failed:
        u[:, arm.parts == arm.part(name, owner)] = np.nan
    run_over = smoothed if smooth else track
    shape = with_calibration(run_over(method, u), known)
    lines, frame = [*u.remarks, repr(shape)], shape.to_frame()
    drawn = f", if the robot is built exactly as {Path(robot).name} says (not calibrated)"
    lines.append(tip_known(frame) + drawn * (known is None))
    lines.append(NOT_WRITTEN if path is None else written(path, csv(frame), owner))
    return Report("\n".join([*lines, *suspicions(shape), *mirrors_in_words(arm)]), shape)


def pose_covariance(robot: Robot, noise_mm: float, noise_deg: float) -> Array:
    """Return the covariance ``[n_q, n_q]`` of poses whose lengths and angles are known so well."""
    given = f"{noise_mm:g} mm and {noise_deg:g} deg"
    good = 0 < noise_mm <= _MOST_NOISE and 0 < noise_deg <= _MOST_NOISE
    require(good, "pose noise", "the command", f"positive and at most {_MOST_NOISE:g}", given)
    angle = [name.startswith(("kappa", "phi", "rotation")) for name in robot.coordinates]
    return np.diag(np.where(angle, math.radians(noise_deg), 1e-3 * noise_mm) ** 2)


def _holds(measured: Poses, u: Readings, owner: str) -> Array | None:
    """Return beginning and end of every held pose ``[poses, 2]`` [s], or nothing where each has a row of readings."""
    alike, times = len(u) == len(measured.q), measured.times
    if measured.windows is not None:
        require(u.times is not None, "times", "the readings", "given (a column time_s, or --rate)", "none")
        return measured.windows
    if times is None or u.times is None:
        expected = "held from start_s to end_s, or at time_s, or as many as the readings have rows"
        require(alike, "poses", owner, expected, f"{len(measured.q)} poses for {len(u)} rows")
        return None
    if alike and np.abs(times - u.times).max() < _WINDOW_S / 10:
        return None
    return times[:, None] + np.array([-0.5, 0.5]) * _WINDOW_S


def _by_clock(windows: Array, clock: str, readings: Path | str) -> Array:
    """Return beginnings and ends ``[poses, 2]`` by the times of the readings, from another clock than theirs."""
    if not clock:
        return windows
    recorded = is_recording(readings)
    source = table_of(read_recording(readings))[0].filter(regex="_s$") if recorded else readings
    table = read_table(source)._replace(owner=Path(readings).name)
    own, name = table.scaled(f"{clock}s")[0], f"column {clock}s"
    require((np.diff(own) >= 0).all(), name, table.owner, "increasing", "a clock that began anew")
    return windows + np.interp(windows, own, table.times - own)


def calibrate_files(
    readings: Path | str,
    poses: Path | str | None,
    robot: Path | str,
    output: Path | str,
    *,
    pose_noise_mm: float = 0.2,
    pose_noise_deg: float = 0.5,
    rate_hz: float | None = None,
) -> Report:
    """Calibrate a robot from readings in held poses, and write a calibration."""
    owner = "repro calibrate"
    path, arm = new(output, owner), _robot(robot, owner)
    u = _readings(arm, readings, rate_hz)
    if poses is None:
        raise bad_input("poses", owner, "given (repro calibrate READINGS POSES.csv), or --self", "neither")
    sigma = pose_covariance(arm, pose_noise_mm, pose_noise_deg)
    name, measured = Path(poses).name, read_poses(arm, poses, covariance=sigma)
    remarks, where = [*u.remarks, *measured.remarks], [f"{name}, line {line}" for line in measured.lines]
    values = _in_poses(arm, readings, u, measured, where, remarks)
    n = arm.n_magnetic
    both, labels = np.concatenate([values[:, :n], measured.q], axis=1), [*arm.names[:n], *arm.coordinates]
    use = complete(both, "poses and readings", name, labels, 1)
    if lost := [place for place, there in zip(where, use, strict=True) if not there]:
        remarks.append(
            f"{len(lost)} poses lack a reading, a coordinate or a time and are left out: {some(lost)}."
        )
    q, rows = measured.q[use], np.nan_to_num(values[use])  # orientations are not calibrated here
    kept = [place for place, there in zip(where, use, strict=True) if there]
    found = calibrate(arm, q, rows, q_covariance=sigma, tolerances=TOLERANCES, rows=kept)
    remarks += [calibration_report(found, q, rows), written(path, calibration_text(found), owner)]
    return Report("\n".join(remarks), found)


def _in_poses(
    robot: Robot, source: Path | str, u: Readings, measured: Poses, where: list[str], remarks: list[str]
) -> Array:
    """Return the readings of every pose: of its row, or their mean while it was held."""
    windows, t, values = (
        _holds(measured, u, where[0].partition(", line")[0]),
        np.asarray(u.times),
        np.array(u),
    )
    if windows is None:
        return values
    windows = _by_clock(windows, measured.clock, source)
    windows = windows + held_lag(robot, measured.q, windows, t, values, remarks)
    means, more = averaged(robot, t, values, windows, where)
    remarks += more
    return means


def calibrate_by_motion(
    readings: Path | str, robot: Path | str, output: Path | str, *, rate_hz: float | None = None
) -> Report:
    """Calibrate a robot from readings in motion, without poses, and write a calibration."""
    owner = "repro calibrate"
    path, arm = new(output, owner), _robot(robot, owner)
    u = _readings(arm, readings, rate_hz)
    there = np.isfinite(u).sum(axis=0)
    received = f"{there.min()} of {arm.names[int(there.argmin())]}"
    require(there.min() > 2, "readings", owner, "there in three rows or more, for --self", received)
    found, text = by_motion(arm, np.array(u))
    return Report("\n".join([*u.remarks, text, written(path, calibration_text(found), owner)]), found)


class _Both(NamedTuple):
    """Readings, and the motion that was measured meanwhile by another clock."""

    t: Array
    u: Array
    clean: Array
    """Times [s], readings ``[t, s]``, and these without what is far beyond all others."""
    motion: Signal
    lag: float
    """To be added to the times of the motion [s]."""

    def poses(self, lag: float, ahead_s: float = 0.0) -> Array:
        return self.motion.at(self.t - lag + ahead_s)


class _Parts(NamedTuple):
    begin: float
    border: float
    end: float
    first: Array
    rest: Array


class _Fitted(NamedTuple):
    robot: Robot
    calibration: Calibration | None
    u: Array
    """Readings with the frames of IMUs undone."""
    lag: float
    error: float
    later: float
    later_error: float
    """The lag of the first part and of the rest, each with its deviation [s]."""
    words: list[str]


def evaluate_files(
    readings: Path | str,
    poses: Path | str,
    robot: Path | str,
    output: Path | str,
    *,
    bodies: Sequence[str] = (),
    straight_s: float = 0.0,
    pose_noise_mm: float = 0.2,
    pose_noise_deg: float = 0.5,
    share: float = 0.4,
    longest_lag_s: float = 10.0,
    rate_hz: float | None = None,
) -> Report:
    """Compare estimates with measured poses: lag, calibration on the first part, errors on the rest, a new folder."""
    owner = "repro evaluate"
    folder, arm = new(output, owner), _robot(robot, owner)
    require(0 < share < 1, "share", owner, "between 0 and 1", share)
    require(0 < longest_lag_s < math.inf, "longest-lag", owner, "positive and finite", longest_lag_s)
    sigma = pose_covariance(arm, pose_noise_mm, pose_noise_deg)
    recording = read_recording(readings) if rate_hz is None and is_recording(readings) else None
    u = _readings(arm, recording or readings, rate_hz)
    measured = read_poses(arm, poses, bodies=bodies, straight_s=straight_s, covariance=sigma)
    lines = [*u.remarks, *measured.remarks]
    both = _together(arm, u, measured, longest_lag_s, lines)
    parts = _parts(both, share)
    fitted = _fitted(arm, both, parts, sigma, [f"{Path(readings).name}, line {k}" for k in u.lines])
    truth = both.poses(fitted.lag)
    shapes = _estimated(arm, both, parts, fitted)
    if (plain := _interpolated(arm, both, parts, truth, sigma)) is not None:
        shapes["readings interpolated"] = plain
    shape = _given(arm, both, parts, truth[parts.rest])
    table = errors_table(shape, sigma, shapes)
    notes = _notes(recording, u, both)
    lines += [*_said(both, parts, fitted, truth), *notes_in_words(notes), *_errors_in_words(table)]
    _write(folder, table, {"measured": shape, **shapes}, lines, fitted.calibration, notes)
    return Report("\n".join([*lines, f"Written: {folder.name}"]), table)


def _together(
    robot: Robot, readings: Readings, measured: Poses, longest_lag_s: float, lines: list[str]
) -> _Both:
    """Clean readings and poses, and find the lag between their clocks."""
    owner = "repro evaluate"
    for name, given in (("readings", readings.times), ("poses", measured.times)):
        received = "none" if given is None else len(given)
        enough = given is not None and len(given) > 2
        require(enough, "times", owner, f"given with the {name}, three or more", received)
    t, times, q, u = (np.array(x) for x in (readings.times, measured.times, measured.q, readings))
    complete(q, "poses", owner, robot.coordinates, 3)
    complete(u, "readings", owner, robot.names, 3)
    if t[0] > times[-1] or times[0] > t[-1]:
        t, times = t - t[0], times - times[0]
        lines.append("The clocks have no time in common: each is counted from its first row.")
    clean, same = without_spikes(robot, q, u, t, lines), repeats(q)
    # Frozen or at rest: the readings say so once the lag is known.
    moving = np.where(same[:, None] & (same.mean() < 0.5), np.nan, q)
    noise = np.asarray(robot.total_noise)
    lag = clock_lag(Signal.of(times, moving), Signal.of(t, unwrapped(robot, clean)), longest_lag_s, noise)
    at_poses = Signal.of(t, clean).at(times + lag)
    q = in_axes_of_the_readings(robot, q, measured.turned, at_poses, lines)
    still = frozen(q, times + lag, t, clean, noise)
    if still.any():
        when = some([f"{x:.2f} s" for x in times[still & ~np.roll(still, 1)]])
        lines.append(
            f"{still.sum()} poses repeat the one before while the readings move: left out, from {when}."
        )
        q[still] = np.nan
    motion = Signal.of(times, q)
    motion.values[:] = robot.free_angles.continuous(motion.values)
    return _Both(t, u, clean, motion, lag)


def _parts(both: _Both, share: float) -> _Parts:
    """Return the part that calibrates, and the rest."""
    t = both.t
    begin, end = t[np.isfinite(both.poses(both.lag)).all(1)][[0, -1]]
    border = begin + share * (end - begin)
    expected = f"together for {_LEAST_S:g} s in the first part and in the rest"
    seen = f"{end - begin:.1f} s, a share of {share:g} of them first"
    long = min(border - begin, end - border - _APART_S) >= _LEAST_S
    require(long, "readings and poses", "repro evaluate", expected, seen)
    first, rest = (t >= begin) & (t <= border), (t >= border + _APART_S) & (t <= end)
    return _Parts(begin, border, end, first, rest)


def _fitted(robot: Robot, both: _Both, parts: _Parts, sigma: Array, where: list[str]) -> _Fitted:
    """Calibrate with the first part: a better robot tells the lag better, and that the robot."""
    step, error, lag, first = both.motion.gap / GAP_STEPS, 0.0, both.lag, parts.first
    tuned, known, u, words = robot, None, both.clean, list[str]()
    for _ in range(4):
        at, ahead, behind = (both.poses(lag, x) for x in (0.0, step, -step))
        speed, before = np.nan_to_num(ahead - behind) / (2 * step), lag
        C = sigma + error**2 * speed[:, :, None] * speed[:, None, :]
        tuned, known, u, words = with_poses(robot, np.where(first[:, None], at, np.nan), both.clean, C, where)
        lag, error = fine_lag(tuned.sensing(), both.motion, both.t[first], u[first], lag)
        if abs(lag - before) < max(0.5 * error, 1e-4):
            break
    later = fine_lag(tuned.sensing(), both.motion, both.t[parts.rest], u[parts.rest], lag)
    return _Fitted(tuned, known, u, lag, error, *later, words)


def _estimated(robot: Robot, both: _Both, parts: _Parts, fitted: _Fitted) -> dict[str, Trajectory]:
    """Estimate the rest from a cold start, by the robot as described and as calibrated."""
    corrected, found = np.where(np.isfinite(both.clean), fitted.u, both.u), dict[str, Trajectory]()
    models = {
        "as described": (robot, both.u, None),
        "calibrated": (fitted.robot, corrected, fitted.calibration),
    }
    for name in ESTIMATORS:
        for which, (model, u, calibration) in models.items():
            shape = track(estimator_of(model, name), u[parts.rest], times=both.t[parts.rest])
            found[f"{which}, {name.replace('_', ' ')}"] = with_calibration(shape, calibration)
    return found


def _given(robot: Robot, both: _Both, parts: _Parts, q: Array) -> Trajectory:
    """Return configurations of the rest that no estimator has made."""
    no = np.full(len(q), np.nan)
    return Trajectory(both.t[parts.rest], q, None, both.u[parts.rest], no, no, no, robot=robot)


def _interpolated(robot: Robot, both: _Both, parts: _Parts, q: Array, sigma: Array) -> Trajectory | None:
    """Return the rest by a plain interpolation of what was read in known poses, where few coordinates move."""
    from scipy.interpolate import RBFInterpolator

    u, rest = both.u, both.u[parts.rest]
    use = parts.first & np.isfinite(q).all(1) & np.isfinite(both.clean).all(1)
    moves = np.ptp(q[use], axis=0) > 10 * np.sqrt(np.diag(sigma))
    if not 0 < moves.sum() <= 2:
        return None
    rows, scale, size = np.flatnonzero(use), u[use].std(0).clip(1e-12), q[use].std(0).clip(1e-12)
    rows = rows[:: 1 + len(rows) // 300]
    plain = RBFInterpolator(u[rows] / scale, q[rows] / size, smoothing=0.1)  # thin plates
    there, found = np.isfinite(rest).all(1), np.full((len(rest), q.shape[1]), np.nan)
    found[there] = size * plain(rest[there] / scale)
    return _given(robot, both, parts, found)


def _said(both: _Both, parts: _Parts, fitted: _Fitted, truth: Array) -> list[str]:
    """Say lag, parts, what calibration found, and whether the clocks drift."""
    (begin, border, end, _, rest), lag, error = parts, fitted.lag, fitted.error
    unknown = int((~np.isfinite(truth[rest]).all(1)).sum())
    lines = [
        f"Lag: {1e3 * lag:+.2f} ± {1e3 * error:.2f} ms to be added to the times of the poses.",
        f"First part {begin:.2f} to {border:.2f} s; evaluated {border + _APART_S:.2f} to {end:.2f} s.",
        *([f"{unknown} of its {rest.sum()} rows have no pose and are not compared."] if unknown else []),
        *fitted.words,
    ]
    step, longer = both.motion.gap / GAP_STEPS, fitted.later - lag
    if abs(longer) > max(step / 2, 4 * math.hypot(error, fitted.later_error)):
        drift = 1e6 * longer / ((end + _APART_S - begin) / 2)
        doubt = f"DOUBT: the lag of the rest is longer by {1e3 * longer:+.1f} ms"
        lines.append(f"{doubt}: the clocks drift ({drift:+.0f} ppm), or the robot has changed.")
    return lines


def _notes(recording: Recording | None, readings: Readings, both: _Both) -> list[Note]:
    """Return the notes of a recording by the times of the evaluation, which may begin at its first row."""
    if recording is None or readings.times is None:
        return []
    earlier = float(readings.times[0] - both.t[0])
    return [note._replace(time_s=note.time_s - earlier) for note in recording.notes]


def _errors_in_words(table: pd.DataFrame) -> list[str]:
    tip = table[table["quantity"] == "tip"].drop(columns=["quantity", "unit"])
    return [
        "Errors of the tip [mm], in how many rows the 95 % ellipsoid holds the measured tip [%], and how many",
        "times larger every ± must be for 95 % (grown; repro live --grown takes it):",
        tip.to_string(index=False, float_format="%.3g", na_rep="-"),
    ]


def _write(
    folder: Path,
    table: pd.DataFrame,
    shapes: Mapping[str, Trajectory],
    lines: list[str],
    known: Calibration | None,
    notes: Sequence[Note],
) -> None:
    """Write the folder, which appears when it is complete."""
    frames, measured = {name: shape.to_frame() for name, shape in shapes.items()}, shapes["measured"]
    joined = pd.concat([frame.add_prefix(f"{name}: ") for name, frame in frames.items()], axis=1)
    files = {"errors.csv": csv(table), "estimates.csv": csv(joined), "report.txt": "\n".join(lines) + "\n"}
    if known is not None:
        files["calibration.json"] = calibration_text(known)
    drawn = [unit for unit, fixed in zip(measured.units(), measured.robot.fixed, strict=True) if not fixed]
    image = picture(frames, drawn, notes)
    with whole(folder, "repro evaluate") as stage:
        stage.mkdir()
        (stage / "estimates.png").write_bytes(image)
        for name, content in files.items():
            (stage / name).write_text(content, encoding="utf-8", newline="\n")
