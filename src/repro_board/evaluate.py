"""What ``track``, ``calibrate`` and ``evaluate`` do with files, and the lag between readings and a motion.

Each function takes files, writes new files only, and returns a :class:`Report`. An evaluation finds the lag between
the clocks, calibrates the robot on the first part of the recording, estimates the rest from a cold start, and
compares with the measured poses, which enter no estimate.
"""

from __future__ import annotations

import io
import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from scipy.fft import next_fast_len
from scipy.spatial.transform import Rotation
from scipy.stats import chi2 as chi_square

from repro.check import mirrors_in_words
from repro.common import Array, bad_input, numbers, require, whole
from repro.estimators.calibration import Calibration, calibrate, calibration_text, load_calibration
from repro.estimators.drift import Drift, Drifting, DriftModel
from repro.estimators.kalman import KalmanFilter
from repro.estimators.least_squares import LevenbergMarquardt
from repro.estimators.track import Trajectory, track
from repro.estimators.track import smooth as smoothed
from repro.robot import Robot
from repro.robot_file import load_robot
from repro.tables import read_table
from repro.tolerances import Tolerances, placed

ESTIMATORS = ("levenberg_marquardt", "kalman")
"""Those that a monitor watches."""
TOLERANCES = Tolerances(sensor_gain=0.05, sensor_offset=0.5, earth=0.05)
"""How far a robot may be from its file, where the file states nothing."""
_COVERED = 0.95
_SPIKE = 6.0
"""A sample farther from the median than so many deviations is left out."""
_WINDOW_S = 0.5
"""Readings are averaged over this time around a pose with one time."""
_MODEL_ERROR, _MOST_ROWS, _ROUNDS = 0.003, 4000, 40
"""Without poses: share of a reading that its model is off; rows that are used, and most rounds."""
_CAUSES = (
    "parts that are not where the file says, which poses would tell; axes exchanged or of the wrong sign; another "
    "unit or robot; iron or magnets nearby"
)
_GAP_STEPS, _LEAST_S, _APART_S = 2.5, 5.0, 1.0
"""Longest gap over which is interpolated, in usual steps; shortest part of an evaluation, and time between the two
parts [s]."""
_MOST_POSES, _FEWEST = 150, 5
"""Poses that calibrate at most, and held ones that tell a lag."""


@dataclass(frozen=True)
class Report:
    """What a command did: ``str`` gives the words for its user, ``found`` the numbers."""

    text: str
    found: Any

    def __str__(self) -> str:
        """Return the words."""
        return self.text


def _new(path: Path | str, owner: str) -> Path:
    path = Path(path)
    expected = "one that does not exist yet"
    require(not (path.exists() or path.is_symlink()), "output", owner, expected, path.name)
    require(path.parent.is_dir(), "output", owner, "in a folder that exists", path)
    return path


def _written(path: Path, text: str, owner: str) -> str:
    with whole(path, owner) as part:
        part.write_text(text, encoding="utf-8", newline="\n")
    return f"Written: {path.name}"


def _csv(frame: Any) -> str:
    """Return a table as text; times keep their microseconds however large they are."""
    frame = frame.assign(time_s=frame["time_s"].map("{:.6f}".format)) if "time_s" in frame else frame
    return frame.to_csv(index=False, lineterminator="\n", float_format="%.7g")


def _some(words: Sequence[Any], most: int = 5) -> str:
    rest = f" and {len(words) - most} more" if len(words) > most else ""
    return ", ".join(map(str, words[:most])) + rest


def _robot(path: Path | str, owner: str) -> Any:
    robot = load_robot(path)
    stated = robot.total_noise is not None and robot.lower is not None
    require(stated, "robot", owner, "one whose file states the noise of its readings", "none")
    return robot


def _readings(robot: Robot, source: Path | str, rate_hz: float | None = None) -> Any:
    from repro_board.record import readings_of

    u = readings_of(robot, source if rate_hz is None else read_table(source, rate_hz))
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
    if steps[k] > max(_GAP_STEPS * usual, 0.2):
        found.append(f"The longest gap without a reading is {steps[k]:.3g} s, after {times[k]:.3f} s.")
    return found


def estimator_of(robot: Any, name: str = "", owner: str = "repro track") -> Any:
    """Return the estimator of a name for a robot: least squares if none is given."""
    name = name or ESTIMATORS[0]
    require(name in ESTIMATORS, "estimator", owner, f"one of {', '.join(ESTIMATORS)}", name)
    return KalmanFilter(robot) if name == "kalman" else LevenbergMarquardt(robot)


def with_calibration(shape: Trajectory, calibration: Calibration | None) -> Trajectory:
    """Return estimates whose covariances hold what the calibration left open, too."""
    if calibration is None or shape.covariance is None:
        return shape
    parts = np.array_split(shape.q, 1 + len(shape.q) // 2000)  # of bounded memory
    lasting = np.concatenate([calibration.lasting_covariance(part) for part in parts])
    return replace(shape, covariance=shape.covariance + lasting)


def track_file(
    readings: Path | str,
    robot: Path | str,
    *,
    output: Path | str | None = None,
    calibration: Path | str | None = None,
    estimator: str = "",
    smooth: bool = False,
    failed: Sequence[Any] = (),
    rate_hz: float | None = None,
) -> Report:
    """Estimate the shape from a recording or a table of readings, and write the estimates as a table."""
    owner = "repro track"
    path = None if output is None else _new(output, owner)
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
    lines = [*u.remarks, repr(shape)]
    frame = shape.to_frame()
    if shape.covariance is not None:
        tip = np.sqrt(np.square(frame[[f"tip_{axis}_sd_mm" for axis in "xyz"]].to_numpy()).sum(1))
        middle, worst = float(np.median(tip)), float(tip.max())
        known_to = f"known to ±{middle:.2g} mm in most rows" if middle < 1e3 else "not known in most rows"
        known_to += f", ±{worst:.2g} mm in the worst" if middle < 1e3 and worst < 1e3 else ""
        built = (
            "" if known else f", if the robot is built exactly as {Path(robot).name} says (not calibrated)"
        )
        lines.append(f"tip: {known_to}{built}")
    if path is None:
        lines.append("No table is written (-o shape.csv writes one).")
    else:
        lines.append(_written(path, _csv(frame), owner))
    return Report("\n".join([*lines, *suspicions(shape), *mirrors_in_words(arm)]), shape)


def suspicions(shape: Trajectory) -> list[str]:
    """Say in sentences which sensors do not fit the others, and what else the monitor found."""
    if shape.status is None or shape.suspects is None:
        return ["Nothing watches this estimator: a sensor that fails is not noticed."]
    n, counts = len(shape.times), Counter(shape.status.tolist())
    words = {
        "inconsistent": "the readings do not fit together, and no single sensor explains it "
        "(unit, order or sign of the columns wrong, or not calibrated?)",
        "frozen": "the board repeats itself: all readings are old",
        "undetermined": "there are fewer readings than unknowns",
        "beyond bounds": "the readings fit only beyond the bounds of the robot file; the shape stays within",
        "unchecked": "the fit uses up all readings: a wrong one would look like another shape",
    }
    lines = [f"In {counts[name]} of {n} rows {text}." for name, text in words.items() if counts[name]]
    names = shape.robot.part_names if shape.robot is not None else range(1, 1 + shape.suspects.shape[1])
    for name, rows in zip(names, shape.suspects.T, strict=True):
        if rows.any():
            first, last = shape.times[rows][[0, -1]]
            when = f"{rows.sum()} of {n} rows, from {first:.3f} to {last:.3f} s"
            lines.append(f"Suspected: {name} does not fit the other sensors in {when}.")
    lines += [
        f"{name} is at a bound of the robot in {rows} of {n} rows."
        for name, rows in shape.at_bounds().items()
    ]
    return lines or ["All rows are consistent, and no sensor is suspected."]


def pose_covariance(robot: Robot, noise_mm: float, noise_deg: float) -> Array:
    """Return the covariance ``[n_q, n_q]`` of poses whose lengths and angles are known so well."""
    given = f"{noise_mm:g} mm and {noise_deg:g} deg"
    good = 0 < noise_mm < math.inf and 0 < noise_deg < math.inf
    require(good, "pose noise", "the command", "positive", given)
    angle = [name.startswith(("kappa", "phi", "rotation")) for name in robot.coordinates]
    return np.diag(np.where(angle, math.radians(noise_deg), 1e-3 * noise_mm) ** 2)


def _holds(measured: Any, u: Any, owner: str) -> Array | None:
    """Return beginning and end of every held pose ``[poses, 2]`` [s], or nothing where each has a row of readings."""
    alike, times = len(u) == len(measured.q), measured.times
    if "window_s" in measured.known:
        require(u.times is not None, "times", "the readings", "given (a column time_s, or --rate)", "none")
        return measured.known["window_s"]
    if times is None or u.times is None:
        expected = "held from start_s to end_s, or at time_s, or as many as the readings have rows"
        require(alike, "poses", owner, expected, f"{len(measured.q)} poses for {len(u)} rows")
        return None
    if alike and np.abs(times - u.times).max() < _WINDOW_S / 10:
        return None
    return times[:, None] + np.array([-0.5, 0.5]) * _WINDOW_S


def _by_clock(windows: Array, clock: str, readings: Path | str) -> Array:
    """Return beginnings and ends ``[poses, 2]`` by the times of the readings, from another clock than theirs."""
    from repro_board.export import table_of
    from repro_board.record import MAGIC, read_recording

    if not clock:
        return windows
    with Path(readings).open("rb") as file:
        recorded = file.read(len(MAGIC)) == MAGIC
    source = table_of(read_recording(readings))[0].filter(regex="_s$") if recorded else readings
    table = read_table(source)._replace(owner=Path(readings).name)
    own, name = table.scaled(f"{clock}s")[0], f"column {clock}s"
    require((np.diff(own) >= 0).all(), name, table.owner, "increasing", "a clock that began anew")
    return windows + np.interp(windows, own, table.times - own)


def _held_lag(robot: Any, q: Array, windows: Array, u: Any, remarks: list[str]) -> float:
    """Return by how much held poses are later by the clock of the readings [s]; zero where that goes as well."""
    n, t, whole = sum(sensor.axes for sensor in robot.sensors), u.times, np.isfinite(q).all(1)
    if whole.sum() < _FEWEST or not n:
        return 0.0
    drawn, windows = robot.sensing()(q[whole])[:, :n], windows[whole]
    x = np.insert(_without_spikes(robot, q, np.array(u), t, [])[:, :n], 0, 1.0, axis=1)
    sums = np.cumsum(np.where(np.isfinite(x).all(axis=1, keepdims=True), x, 0.0), axis=0)
    sums, edges = np.concatenate([np.zeros((1, n + 1)), sums]), windows.T + np.array([[-1e-9], [1e-9]])

    def left(lag: float) -> float:
        first, last = (np.searchsorted(t, end + lag) for end in edges)
        total = sums[last] - sums[first]
        return _unexplained(total[:, 1:] / total[:, :1], drawn) if total[:, 0].all() else math.inf

    length = float(np.median(np.diff(windows)))
    ends = t[0] - windows[:, 0].min() - length / 2, t[-1] - windows[:, 1].max() + length / 2
    lags = np.arange(*ends, max(float(np.median(np.diff(t))), length / 20))
    shares, given = np.array([left(lag) for lag in lags] or [math.inf]), left(0.0)
    least, far = shares.min(), np.flatnonzero(shares > 2 * shares.min())
    k = int(shares.argmin())
    good = slice(far[far < k].max(initial=-1) + 1, far[far > k].min(initial=len(lags)))
    lag = float(lags[good][[0, -1]].mean()) if least < 0.25 else 0.0  # in the middle of the hold
    other = shares[np.abs(lags - lag) > length].min(initial=math.inf) if lag else 0.0
    if given <= 2 * least + 0.005 or other < 2 * least:
        return 0.0
    unexplained = f"{least:.0%} of the readings unexplained, {min(given, 1.0):.0%} as given"
    remarks.append(f"Lag: {lag:+.2f} s to be added to the times of the poses: {unexplained}.")
    return lag


def _unexplained(u: Array, drawn: Array) -> float:
    """Return the share of readings ``[t, s]`` that those of the robot as described leave, by a line each."""
    v, w = (x - x.mean(0) for x in (u, drawn))
    cosine = (v * w).sum(0) / np.sqrt(np.square(v).sum(0) * np.square(w).sum(0)).clip(1e-300)
    return float(1 - np.square(cosine.clip(0)).mean())


def _averaged(robot: Any, u: Any, windows: Array, where: Sequence[str]) -> tuple[Array, list[str]]:
    """Return the mean readings of every held pose, NaN where there are none, and what was left out."""
    means, spikes, moved, noise = [], [], [], np.nan_to_num(robot.total_noise)
    for (begin, end), place in zip(windows, where, strict=True):
        rows = np.flatnonzero((u.times >= begin - 1e-9) & (u.times <= end + 1e-9))
        span = f"within the readings, {u.times[0]:g} to {u.times[-1]:g} s after the first"
        span += " (start_board_s and start_unix_s are times of other clocks)"
        require(len(rows), "pose", f"{place},", span, f"none from {begin:g} to {end:g} s")
        x = np.ma.masked_invalid(np.array(u[rows]))
        middle = np.ma.median(x, axis=0)
        off = np.abs(x - middle)
        x[off > _SPIKE * np.maximum(1.4826 * np.ma.median(off, axis=0), noise)] = np.ma.masked
        for row, j in np.argwhere(x.mask & np.isfinite(u[rows])):
            seen = f"{u[rows[row], j]:.4g}, not {middle[j]:.4g}"
            spikes.append(f"{robot.names[j]} at {u.times[rows[row]]:g} s ({seen})")
        moved += [place] if (x.std(axis=0) > 5 * noise).any() else []
        means.append(x.mean(axis=0).filled(np.nan))
    remarks = {f"Readings that do not fit their hold, and are left out: {len(spikes)}": spikes}
    remarks |= {f"Poses in which the readings were not still: {len(moved)}": moved}
    return np.array(means), [f"{text}: {_some(names)}." for text, names in remarks.items() if names]


def _complete(x: Array, what: str, owner: str, labels: Sequence[str], least: int) -> Array:
    """Return which rows are complete; refuse too few, and say what is missing most often."""
    missing = np.isnan(x)
    whole = np.asarray(~missing.any(axis=1))
    received = f"{whole.sum()} of {len(x)}, most often without {labels[int(missing.sum(0).argmax())]}"
    require(whole.sum() >= least, what, owner, f"complete in {least} rows or more", received)
    return whole


def calibrate_files(
    readings: Path | str,
    poses: Path | str | None,
    robot: Path | str,
    output: Path | str,
    *,
    self_: bool = False,
    pose_noise_mm: float = 0.2,
    pose_noise_deg: float = 0.5,
    rate_hz: float | None = None,
) -> Report:
    """Calibrate a robot from readings in held poses, or without poses from its motion, and write a calibration."""
    from repro.motion_files import read_poses

    owner = "repro calibrate"
    path, arm = _new(output, owner), _robot(robot, owner)
    u = _readings(arm, readings, rate_hz)
    if self_:
        require(poses is None, "poses", owner, "left out with --self", poses)
        text, found = _by_motion(arm, np.array(u))
        return Report("\n".join([*u.remarks, text, _written(path, calibration_text(found), owner)]), found)
    if poses is None:
        raise bad_input("poses", owner, "given (repro calibrate READINGS POSES.csv), or --self", "neither")
    sigma = pose_covariance(arm, pose_noise_mm, pose_noise_deg)
    name, measured = Path(poses).name, read_poses(arm, poses, covariance=sigma)
    where = [f"{name}, line {line}" for line in measured.lines]
    windows, remarks = _holds(measured, u, name), [*u.remarks, *measured.remarks]
    values = np.array(u)
    if windows is not None:
        windows = _by_clock(windows, measured.known.get("clock", ""), readings)
        windows = windows + _held_lag(arm, measured.q, windows, u, remarks)
        values, more = _averaged(arm, u, windows, where)
        remarks += more
    n = sum(sensor.axes for sensor in arm.sensors)
    both, labels = np.concatenate([values[:, :n], measured.q], axis=1), [*arm.names[:n], *arm.coordinates]
    whole = _complete(both, "poses and readings", name, labels, 1)
    if not whole.all():
        lost = [place for place, use in zip(where, whole, strict=True) if not use]
        remarks.append(f"{len(lost)} poses lack a reading or a coordinate and are left out: {_some(lost)}.")
    rows = np.nan_to_num(values[whole])  # orientations are not calibrated here
    where = [place for place, use in zip(where, whole, strict=True) if use]
    found = calibrate(arm, measured.q[whole], rows, q_covariance=sigma, tolerances=TOLERANCES, rows=where)
    text = _calibration_report(found, measured.q[whole], rows)
    return Report("\n".join([*remarks, text, _written(path, calibration_text(found), owner)]), found)


def _calibration_report(found: Calibration, q: Array, u: Array) -> str:
    n = sum(sensor.axes for sensor in found.robot.sensors)
    before, after = (
        np.sqrt(np.square(u - x.sensing()(q))[:, :n].mean()) for x in (found.described, found.robot)
    )
    kept = [
        name
        for name, now, prior in zip(found.names, found.deviation, found.tolerances, strict=True)
        if now > 0.9 * prior
    ]
    undetermined = f"{len(kept)} parameters stay as uncertain as before: {_some(kept)}." if kept else ""
    lines = [
        repr(found),
        f"Residual of the readings: {before:.3g} mT as described, {after:.3g} mT calibrated.",
        undetermined or "The poses determine every parameter better than its tolerance.",
    ]
    return "\n".join(lines)


def _by_motion(robot: Any, u: Array) -> tuple[str, Calibration]:
    r"""Find moments, gains and offsets while the robot moves: least squares over all rows, the shapes eliminated.

    Every row has a shape of its own, so only what no shape explains tells anything of the errors. A Kalman filter
    with the same errors in its state takes the smoothness of the motion for knowledge and states far too little.
    """
    owner = "repro calibrate --self"
    fits = robot.magnets and robot.sensors and robot.model is None
    require(fits, "robot", owner, "one with magnets and sensors, and without networks", "another")
    alike = len({magnet.shape for magnet in robot.magnets}) == 1
    drifts = [Drift("moment", 0.05, shared=alike), Drift("gain", 0.05), Drift("offset", 0.5)]
    drifts += [Drift("heading", 0.2), Drift("tilt", 0.1)] if robot.imus else []  # found, and forgotten
    model = DriftModel(Drifting(robot.sensing(), drifts), robot.lower, robot.upper, owner)
    u, n, start = u[:: 1 + len(u) // _MOST_ROWS], robot.n_q, model.states[0]
    # The model and the places of parts are no better than a share of the reading.
    size = np.sqrt(np.nanmean(np.square(u), axis=0)) * (np.arange(u.shape[1]) < model.n_hall)
    noise = np.hypot(robot.total_noise, _MODEL_ERROR * size)
    q = track(LevenbergMarquardt(robot, noise=noise), u, rate_hz=1.0, monitor=None).q
    lower, upper = (np.concatenate([x, c * start]) for x, c in ((robot.lower, -1e3), (robot.upper, 1e3)))
    method, prior = LevenbergMarquardt(model, lower, upper, noise), np.diag(start**-2)
    theta, step, damping, best, first = 0 * start, 0 * start, 1e-3, math.inf, math.nan
    H, g, fit, gate = prior, step, np.ones(len(u)), math.inf
    for _ in range(_ROUNDS):
        errors = np.tile(theta + step, (len(q), 1))
        known = np.concatenate([np.full(q.shape, np.nan), errors], axis=1)
        estimate = method.step(method.init(np.concatenate([q, errors], axis=1)), u, known=known)[1]
        x, chi2 = estimate.q, estimate.chi2
        u_hat, J = model.linearise(x)
        r, J = model.difference(u, u_hat) / noise, J / noise[:, None]
        held = (x[:, :n] <= robot.lower) | (x[:, :n] >= robot.upper)
        fit = chi2 / np.maximum(np.isfinite(r).sum(1) - (~held).sum(1), 1)
        weight = chi2 / np.maximum(fit, 1e-300)
        penalty = np.square((theta + step) / start).sum()
        first = float(np.median(fit)) if math.isnan(first) else first
        cost = (weight * np.minimum(fit, gate)).sum() + penalty
        if cost < best:
            settled, theta, q, damping = best - cost < 1e-3, theta + step, x[:, :n], damping / 10
            gate = _SPIKE**2 * max(1.0, float(np.median(fit)))
            best = (weight * np.minimum(fit, gate)).sum() + penalty
            J, r = np.where(np.isfinite(r)[..., None], J, 0.0), np.nan_to_num(r)
            A, B = np.where(held[:, None], 0.0, J[..., :n]), J[..., n:]
            by_shape = np.linalg.pinv(np.swapaxes(A, 1, 2) @ A, rcond=1e-9, hermitian=True)
            across = (B - A @ (by_shape @ (np.swapaxes(A, 1, 2) @ B))) * (fit <= gate)[:, None, None]
            H, g = np.einsum("tsk,tsl->kl", across, across) + prior, np.einsum("tsk,ts->k", across, r)
            if settled:
                break
        else:
            damping *= 10
        step = np.linalg.solve(H + damping * np.diag(np.diag(H)), g - theta / start**2)
    spread, changes = max(1.0, float(np.median(fit))), _parameters(robot, model.names, alike)
    rows = np.array(list(changes.values()))
    estimate, tolerance = rows @ theta, np.sqrt(np.square(rows) @ start**2)
    C = rows @ np.linalg.inv((H - prior) / spread + prior) @ rows.T / np.outer(tolerance, tolerance)
    deviation, far = np.sqrt(np.diag(C)) * tolerance, np.abs(estimate) / tolerance
    if far.max() > 5.0 or spread > 16.0:
        expected = f"those of this robot in motion (usual causes if not: {_CAUSES})"
        worst = f"{list(changes)[int(far.argmax())]} {far.max():.3g} times as far off as assumed"
        seen = f"{worst}, and a chi-square per reading of {spread:.3g}"
        raise bad_input("readings", owner, expected, seen)
    moved = placed(robot, dict(zip(changes, estimate.tolist(), strict=True)))
    quality = (spread, len(u), math.sqrt(first), math.sqrt(spread))
    exact = np.zeros([sum(sensor.axes for sensor in robot.sensors)] * 2)
    found = Calibration(moved, robot, tuple(changes), estimate, deviation, tolerance, C, *quality, exact)
    lines = [
        f"{len(u)} rows of readings in motion; {(fit > gate).sum()} do not fit (spikes, failures) and are left out."
    ]
    for name, value, now, before in zip(changes, estimate, deviation, tolerance, strict=True):
        scale, unit = (1.0, "mT") if "offset" in name else (100.0, "%")
        words = ", not determined" if now > 0.9 * before else ""
        words += "; DOUBT: beyond twice what was assumed" if abs(value) > 2 * before else ""
        change = f"{scale * value:+.2g} ± {scale * now:.2g} {unit}"
        lines.append(f"  {name}: {change} (before ± {scale * before:.2g}){words}")
    lines.append("The places of magnets and sensors are taken as described: only measured poses tell these.")
    return "\n".join(lines), found


def _parameters(robot: Robot, errors: Sequence[str], alike: bool) -> dict[str, Array]:
    """Return by how much every parameter of a calibration changes with the errors that a drift model has."""
    rows, one = {}, dict(zip(errors, np.eye(len(errors)), strict=True))
    for m in ["of all"] if alike else range(1, 1 + len(robot.magnets)):
        names = [f"moment A{2 * k + 1}" for k in range(robot.sensing().moments.shape[1])]
        rows |= {name if alike else f"magnet {m} {name}": one[f"moment {m}"] for name in names}
    reading, offsets = 0, robot.per_reading("offset", 0.0, 0.0)
    for j, sensor in enumerate(robot.sensors, 1):
        for axis in [""] if sensor.axes == 1 else [" x", " y", " z"]:
            reading += 1
            gain = rows[f"sensor {j} gain{axis}"] = one[f"gain {reading}"]
            # The drifting gain is that of the whole reading, the calibrated one that of the field alone.
            rows[f"sensor {j} offset{axis}"] = one[f"offset {reading}"] + offsets[reading - 1] * gain
    return rows


class Lag(NamedTuple):
    """How well readings follow a motion as they are put together, and at the best of all lags."""

    lag_s: float
    """By how much later the readings are to be taken for the least residual [s]."""
    residual: float
    """Root mean square of what the motion leaves of the readings as they are, in their unit."""
    best: float
    """The same at the best lag."""
    spread: float
    """Root mean square of the readings about their means."""
    other: float
    """The least residual at any lag that is not next to the best one."""


def search_lag(motion: Any, readings: Any, rate_hz: float, longest_s: float = math.inf) -> Lag:
    """Find the lag between readings and a motion, over the whole recording.

    The readings of an instant are a smooth function of the shape. So we fit them by a quadratic function of the
    motion at every lag of up to half the recording in either direction, each time over all frames that both have, and
    take the lag with the least residual. Sums over frames are products of Fourier transforms, so all lags together
    cost little more than one. A frame without a pose or with a missing reading counts nowhere.

    A motion that repeats itself without end has many lags that are equally good; then the smallest one is returned.

    Parameters
    ----------
    motion
        Coordinates ``[t, m]`` that motion capture gives, NaN where it is lost.
    readings
        Readings ``[t, s]`` of the same frames, if there is no lag; NaN where one is missing.
    rate_hz
        Frames per second.
    longest_s
        Largest lag that is tried [s].

    Raises
    ------
    InputError
        If there are not as many readings as poses, less than two seconds of them, or at no lag enough of both.

    Examples
    --------
    Readings that were taken half a second too early:

    >>> t = np.arange(4000) / 40
    >>> q = np.stack([np.sin(t), np.sin(1.7 * t + 0.3)], axis=-1)
    >>> u = np.roll(q @ [[30.0, 5.0], [-8.0, 20.0]], 20, axis=0)
    >>> search_lag(q[20:], u[20:], rate_hz=40).lag_s
    0.5
    """
    owner = "search_lag"
    q, u = (
        numbers(motion, "motion", owner, (None, None), finite=False),
        numbers(readings, "readings", owner, (None, None), finite=False),
    )
    n = len(q)
    require(len(u) == n, "readings", owner, f"one row for each of {n} poses", f"{len(u)} rows")
    require(n >= 2 * rate_hz, "motion", owner, "two seconds long or more", f"{n / rate_hz:g} s")
    seen, read = (np.asarray(np.isfinite(x).all(axis=1)) for x in (q, u))
    for name, there in (("motion", seen), ("readings", read)):
        require(
            there.sum() > n / 2, name, owner, "there in most frames", f"{int((~there).sum())} of {n} missing"
        )
    x = ((q - q[seen].mean(axis=0)) / np.maximum(q[seen].std(axis=0), 1e-12)).T
    v = (u - u[read].mean(axis=0)).T
    x[:, ~seen], v[:, ~read] = 0.0, 0.0
    low, up = np.triu_indices(len(x))
    columns = np.vstack([seen, x, x[low] * x[up]])
    i, j = np.triu_indices(len(columns))
    most = int(min(n // 2, longest_s * rate_hz))
    size, lags = next_fast_len(2 * n, real=True), np.arange(-most, most + 1)
    of_read, of_v = np.fft.rfft(read, size), np.fft.rfft(v, size)

    def sums(series: Array, spectrum: Array) -> Array:
        """Sum over t of the series at t times readings at t + lag, for every lag."""
        return np.fft.irfft(np.fft.rfft(series, size).conj() * spectrum, size)[..., lags]

    k = len(columns)
    A, b = np.empty((k, k, len(lags))), sums(columns, of_v[:, None])
    A[i, j] = A[j, i] = sums(columns[i] * columns[j], of_read)
    total = sums(seen, np.fft.rfft((v**2).sum(axis=0), size))
    count = A[0, 0].copy()
    A[range(k), range(k)] += 1e-9 * count  # for a coordinate that hardly moves
    fitted = np.linalg.solve(np.moveaxis(A, -1, 0), np.moveaxis(b, -1, 0).swapaxes(1, 2))
    left = total - np.einsum("skl,lks->l", b, fitted)
    residual = np.sqrt(np.maximum(left, 0.0) / np.maximum(len(v) * count, 1.0))
    residual[~(count > max(2 * k, n / 8))] = math.inf  # a few frames fit any function
    least = float(residual.min())
    require(
        math.isfinite(least), "motion and readings", owner, "there together at some lag", "too few frames"
    )
    equal = np.flatnonzero(residual <= least * (1 + 1e-6))
    best = int(equal[np.argmin(np.abs(lags[equal]))])
    spread = float(np.sqrt((v[:, read] ** 2).mean()))
    high = np.flatnonzero(residual > least + 0.2 * max(spread - least, 0.0))
    left_of, right_of = high[high < best].max(initial=-1), high[high > best].min(initial=len(lags))
    apart = np.concatenate([residual[: left_of + 1], residual[right_of:]])
    other = float(apart.min(initial=math.inf if len(high) else least))
    return Lag(float(lags[best] / rate_hz), float(residual[most]), float(residual[best]), spread, other)


class Signal(NamedTuple):
    """Values over time ``[t, k]``; between two samples that are farther apart than ``gap`` nothing is known."""

    times: Array
    values: Array
    gap: float

    @classmethod
    def of(cls, times: Array, values: Array) -> Signal:
        """Leave out rows that are not complete."""
        there = np.isfinite(values).all(1)
        return cls(times[there], values[there], _GAP_STEPS * float(np.median(np.diff(times))))

    def at(self, when: Array) -> Array:
        """Return values ``[len(when), k]``, linearly between samples; NaN in gaps."""
        t = self.times
        after = np.clip(np.searchsorted(t, when), 1, len(t) - 1)
        near = (when >= t[0]) & (when <= t[-1]) & (t[after] - t[after - 1] <= self.gap)
        found = np.stack([np.interp(when, t, column) for column in self.values.T], axis=-1)
        return np.where(near[:, None], found, np.nan)


def _repeats(q: Array) -> Array:
    """Return which poses ``[t]`` equal the one before."""
    return np.concatenate([[False], (q[1:] == q[:-1]).all(1)])


def _frozen(q: Array, times: Array, t: Array, u: Array, noise: Any) -> Array:
    """Return which poses ``[t]`` repeat the one before while the readings move."""
    repeats, frozen = _repeats(q), np.zeros(len(q), dtype=bool)
    edges = np.flatnonzero(np.diff(np.concatenate([repeats, [False]]).astype(int), prepend=0))
    for begin, end in edges.reshape(-1, 2):
        first, last = np.searchsorted(t, [times[begin - 1], times[end - 1]])
        beside = int(last - first < 3)  # a short hold has too few readings of its own
        x = u[max(first - beside, 0) : last + beside]
        x = x[np.isfinite(x).all(1)]
        frozen[begin:end] = len(x) > 1 and (np.ptp(x, axis=0) > _SPIKE * noise).any()
    return frozen


def _orientations(robot: Robot, u: Array, k: int) -> tuple[Array, slice]:
    """Return rows and columns of what an IMU has measured."""
    first = robot.n_readings - 3 * (len(robot.imus) - k)
    columns = slice(first, first + 3)
    return np.flatnonzero(np.isfinite(u[:, columns]).all(1)), columns


def _unwrapped(robot: Robot, u: Array) -> Array:
    """Return readings with orientations relative to their mean: no rotation vector jumps by a turn."""
    u = u.copy()
    for k in range(len(robot.imus)):
        rows, columns = _orientations(robot, u, k)
        if len(rows):
            turns = Rotation.from_rotvec(u[rows, columns])
            u[rows, columns] = (turns.mean().inv() * turns).as_rotvec()
    return u


def _without_spikes(robot: Any, q: Array, u: Array, t: Array, lines: list[str]) -> Array:
    """Return readings ``[t, s]`` without those far beyond what the robot should read in its poses: errors of the bus.

    Orientations are whole, or missing.
    """
    u, n = u.copy(), sum(sensor.axes for sensor in robot.sensors)
    drawn = robot.sensing()(q[np.isfinite(q).all(1)])[:, :n]
    off = np.abs(u[:, :n] - np.nanmedian(u[:, :n], axis=0))
    usual = np.maximum(_SPIKE * 1.4826 * np.nanmedian(off, axis=0), 2 * np.ptp(drawn, axis=0))
    far = off > np.maximum(usual, _SPIKE * np.nan_to_num(robot.total_noise)[:n])
    u[:, :n][far] = np.nan
    if (rows := far.any(1)).any():
        when = _some([f"{x:.2f} s" for x in t[rows & ~np.roll(rows, 1)]])
        what = "Readings far beyond all others, left out of lag and calibration"
        lines.append(f"{what}: {far.sum()} in {rows.sum()} of {len(u)} rows, from {when}.")
    return u


def _turned(robot: Robot, q: Array, turned: Mapping[int, Array], u: Array, lines: list[str]) -> Array:
    """Return poses ``[t, n_q]`` by the axes of the base that the readings ``u`` ``[t, s]`` of their times show.

    Bodies do not tell how the base is turned about a straight robot: we predict the readings for every turn.
    """
    n, ways = sum(sensor.axes for sensor in robot.sensors), {0: q, **turned}
    use = np.flatnonzero(np.isfinite(np.concatenate([q, u[:, :n]], axis=1)).all(1))
    use = use[:: 1 + len(use) // _MOST_ROWS]
    left = {k: _unexplained(u[use, :n], robot.sensing()(x[use])[:, :n]) for k, x in ways.items() if n}
    angle = min(left, key=lambda k: left[k], default=0)
    if angle and left[angle] < left[0] / 2:
        shares = f"{left[angle]:.0%} of the readings unexplained, {left[0]:.0%} otherwise"
        lines.append(f"The base is taken as turned by {angle} deg about the straight robot: {shares}.")
        return np.where(np.isnan(q), np.nan, ways[angle])
    return q


def _alike(q: Array, u: Array) -> Array:
    """Return which rows go with the others: their readings are a smooth function of the pose."""
    x, low, up = (q - q.mean(0)) / np.maximum(q.std(0), 1e-12), *np.triu_indices(q.shape[1])
    columns = np.column_stack([np.ones(len(q)), x, x[:, low] * x[:, up]])[:, : len(q) // 4]
    there: Any = np.isfinite(u).all(1)
    keep, v = there, u / u[there].std(0).clip(1e-12)
    for _ in range(5):
        size = np.linalg.norm(v - columns @ np.linalg.lstsq(columns[keep], v[keep])[0], axis=1)
        keep = there & (size <= _SPIKE * np.median(size[keep]))
    return keep | ~there


def calibrated_with(
    robot: Robot, q: Array, u: Array, covariance: Array, where: Sequence[str]
) -> tuple[Robot, Calibration | None, Array, list[str]]:
    """Calibrate magnets, sensors and IMUs with the rows whose pose ``q`` ``[t, n_q]`` is not NaN.

    Returns the robot, what was found of its magnets and sensors, all readings with the frames of the IMUs undone, and
    the words for it.
    """
    found, words, n = None, [], sum(sensor.axes for sensor in robot.sensors)
    known = np.flatnonzero(np.isfinite(q).all(1))
    known = known[_alike(q[known], _unwrapped(robot, u[known]))]
    for _ in range(2 if robot.sensors else 0):
        rows = known[np.isfinite(u[known, :n]).all(1)]
        rows = rows[:: 1 + len(rows) // _MOST_POSES]
        found = calibrate(
            robot,
            q[rows],
            np.nan_to_num(u[rows]),
            None,
            covariance[rows],
            tolerances=TOLERANCES,
            rows=[where[int(k)] for k in rows],
        )
        size = np.linalg.norm((u[known] - found.sensing()(q[known]))[:, :n], axis=1)
        known = known[~(size > _SPIKE * np.nanmedian(size))]
    imus, u = [], u.copy()
    for k, imu in enumerate(robot.imus):
        rows, columns = _orientations(robot, u, k)
        own = np.intersect1d(rows, known)
        name = robot.part_names[len(robot.sensors) + k]
        require(len(own), name, "repro evaluate", "there in the first part", "nothing")
        measured, mounting, frame = (
            Rotation.from_rotvec(u[own, columns]),
            Rotation.identity(),
            Rotation.identity(),
        )
        expected = Rotation.from_matrix(robot.poses(q[own], [imu.place])[:, 0, :3, :3])
        for _ in range(100):  # each is the mean of what the other leaves
            mounting = (expected.inv() * frame.inv() * measured).mean()
            frame = (measured * mounting.inv() * expected.inv()).mean()
        u[rows, columns] = (frame.inv() * Rotation.from_rotvec(u[rows, columns])).as_rotvec()
        mounted = (Rotation.from_matrix(imu.place.rotation) * mounting).as_quat()
        imus.append(replace(imu, orientation=mounted))
        angles = " and ".join(f"{math.degrees(x.magnitude()):.2g}" for x in (mounting, frame))
        words.append(f"{name}: mounting and frame off by {angles} deg; mounted = {mounted.round(4).tolist()}")
    moved = robot if found is None else found.robot
    words += [] if found is None else [repr(found)]
    if left := int(np.isfinite(q).all(1).sum()) - len(known):
        words.append(f"{left} rows of the first part do not go with their poses and are not fitted.")
    return moved.replaced(imus=imus, source=moved.source), found, u, words


def clock_lag(motion: Signal, readings: Signal, longest_s: float) -> float:
    """Return by how much the readings are later than the motion [s], to a sample, or refuse what is no one motion."""
    owner = "repro evaluate"
    start, end = max(motion.times[0], readings.times[0]), min(motion.times[-1], readings.times[-1])
    columns = (motion.values.shape[1] + 1) * (motion.values.shape[1] + 2) / 2
    step = max(min(motion.gap, readings.gap) / _GAP_STEPS, (end - start) * columns**2 / 1e7)
    when = np.arange(start, end, step)
    u = readings.at(when) / np.nanstd(readings.values, axis=0).clip(1e-12)
    found = search_lag(motion.at(when), u, 1 / step, longest_s)
    best = f"{found.best / found.spread:.0%} of the readings unexplained at {found.lag_s:+.3f} s"
    require(found.best < 0.5 * found.spread, "readings and poses", owner, "of one motion", f"{best}, at best")
    longest = min(longest_s, (end - start) / 2)
    inside = abs(found.lag_s) < longest - 2 * step
    if longest < longest_s and not inside:
        expected = f"together for {2 * longest_s:g} s, to find the lag between their clocks (--longest-lag)"
        raise bad_input("readings and poses", owner, expected, f"{end - start:.3g} s")
    expected = f"of clocks that differ by less than {longest_s:g} s (--longest-lag)"
    require(inside, "readings and poses", owner, expected, f"{best}, at the end of the search")
    expected = "alike at one lag only (a motion that repeats itself needs a smaller --longest-lag)"
    require(
        found.other > 1.1 * found.best, "readings and poses", owner, expected, f"{best}, and elsewhere too"
    )
    return found.lag_s


def fine_lag(sensing: Any, motion: Signal, t: Array, u: Array, near: float) -> tuple[float, float]:
    """Return the lag at which a calibrated robot predicts the readings best, and its standard deviation [s].

    Twelve blocks of time, which tell equally much, have a lag each; the median hardly moves with a bad one.
    """
    h, scale, shifts = 2 * motion.gap / _GAP_STEPS, 1 / np.nanstd(u, axis=0).clip(1e-12), np.zeros(1)
    for _ in range(20):
        rows = [u, *(motion.at(t - near + x) for x in (0.0, h, -h))]
        use = np.isfinite(np.concatenate(rows, axis=1)).all(1)
        require(
            use.sum() >= 48, "readings and poses", "repro evaluate", "in 48 rows together", int(use.sum())
        )
        v, ahead, behind = (sensing(q[use]) for q in rows[1:])
        r = sensing.difference(u[use], v)
        r, rate = scale * (r - r.mean(0)), scale * sensing.difference(ahead, behind) / (2 * h)
        told = np.cumsum(np.square(rate).sum(1))
        edges = np.searchsorted(told, told[-1] * np.arange(1, 12) / 12)
        blocks = zip(np.split(r, edges), np.split(rate, edges), strict=True)
        shifts = np.array([-(a * b).sum() / max((b * b).sum(), 1e-300) for a, b in blocks])
        near += float(np.median(shifts))
        if abs(np.median(shifts)) < 1e-6:
            break
    require(math.isfinite(near), "lag", "repro evaluate", "finite", near)
    return near, float(1.2533 * shifts.std() / math.sqrt(12))


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
    import pandas as pd

    from repro.motion_files import read_poses

    owner = "repro evaluate"
    folder, arm = _new(output, owner), _robot(robot, owner)
    require(0 < share < 1, "share", owner, "between 0 and 1", share)
    require(0 < longest_lag_s < math.inf, "longest-lag", owner, "positive and finite", longest_lag_s)
    sigma = pose_covariance(arm, pose_noise_mm, pose_noise_deg)
    u = _readings(arm, readings, rate_hz)
    measured = read_poses(arm, poses, bodies=bodies, straight_s=straight_s, covariance=sigma)
    for name, times in (("readings", u.times), ("poses", measured.times)):
        require(times is not None and len(times) > 2, "times", owner, f"given with the {name}", "none")
    q, lines = np.array(measured.q), [*u.remarks, *measured.remarks]
    t, times, values = np.array(u.times), np.array(measured.times), np.array(u)
    _complete(q, "poses", owner, arm.coordinates, 3)
    _complete(values, "readings", owner, arm.names, 3)
    if t[0] > times[-1] or times[0] > t[-1]:
        t, times = t - t[0], times - times[0]
        lines.append("The clocks have no time in common: each is counted from its first row.")
    clean, where = (
        _without_spikes(arm, q, values, t, lines),
        [f"{Path(readings).name}, line {k}" for k in u.lines],
    )
    repeats = _repeats(q)  # frozen or at rest: the readings say so once the lag is known
    moving = np.where(repeats[:, None] & (repeats.mean() < 0.5), np.nan, q)
    lag = clock_lag(Signal.of(times, moving), Signal.of(t, _unwrapped(arm, clean)), longest_lag_s)
    q = _turned(arm, q, measured.known.get("turned", {}), Signal.of(t, clean).at(times + lag), lines)
    frozen = _frozen(q, times + lag, t, clean, arm.total_noise)
    if frozen.any():
        when = _some([f"{x:.2f} s" for x in times[frozen & ~np.roll(frozen, 1)]])
        lines.append(
            f"{frozen.sum()} poses repeat the one before while the readings move: left out, from {when}."
        )
        q[frozen] = np.nan
    motion = Signal.of(times, q)
    motion.values[:] = arm.free_angles.continuous(motion.values)
    begin, end = t[np.isfinite(motion.at(t - lag)).all(1)][[0, -1]]
    border = begin + share * (end - begin)
    expected = f"together for {_LEAST_S:g} s in the first part and in the rest"
    seen = f"{end - begin:.1f} s, a share of {share:g} of them first"
    require(
        min(border - begin, end - border - _APART_S) >= _LEAST_S, "readings and poses", owner, expected, seen
    )
    first, rest = (t >= begin) & (t <= border), (t >= border + _APART_S) & (t <= end)
    step, error, words, tuned, known, corrected = motion.gap / _GAP_STEPS, 0.0, [], arm, None, clean
    for _ in range(4):  # a better robot tells the lag better, and that the robot
        at, ahead, behind = (motion.at(t - lag + x) for x in (0.0, step, -step))
        speed = np.nan_to_num(ahead - behind) / (2 * step)
        C, before = sigma + error**2 * speed[:, :, None] * speed[:, None, :], lag
        tuned, known, corrected, words = calibrated_with(
            arm, np.where(first[:, None], at, np.nan), clean, C, where
        )
        lag, error = fine_lag(tuned.sensing(), motion, t[first], corrected[first], lag)
        if abs(lag - before) < max(0.5 * error, 1e-4):
            break
    later, later_error = fine_lag(tuned.sensing(), motion, t[rest], corrected[rest], lag)
    truth, no = motion.at(t - lag), np.full(int(rest.sum()), np.nan)
    shapes = {}
    for name in ESTIMATORS[:2]:
        for which, model, x, c in (
            ("as described", arm, values, None),
            ("calibrated", tuned, np.where(np.isfinite(clean), corrected, values), known),
        ):
            shape = track(estimator_of(model, name), x[rest], times=t[rest])
            shapes[f"{which}, {name.replace('_', ' ')}"] = with_calibration(shape, c)
    use = first & np.isfinite(truth).all(1) & np.isfinite(clean).all(1)
    moves = np.ptp(truth[use], axis=0) > 10 * np.sqrt(np.diag(sigma))
    if 0 < moves.sum() <= 2:
        plain = _interpolated(values, truth, use, rest)
        shapes["readings interpolated"] = Trajectory(
            t[rest], plain, None, values[rest], no, no, no, robot=arm
        )
    unknown = int((~np.isfinite(truth[rest]).all(1)).sum())
    lines += [
        f"Lag: {1e3 * lag:+.2f} ± {1e3 * error:.2f} ms to be added to the times of the poses.",
        f"First part {begin:.2f} to {border:.2f} s; evaluated {border + _APART_S:.2f} to {end:.2f} s.",
        *([f"{unknown} of its {len(no)} rows have no pose and are not compared."] if unknown else []),
        *words,
    ]
    if abs(later - lag) > max(step / 2, 4 * math.hypot(error, later_error)):
        drift = 1e6 * (later - lag) / ((end + _APART_S - begin) / 2)
        longer = f"DOUBT: the lag of the rest is longer by {1e3 * (later - lag):+.1f} ms"
        lines.append(f"{longer}: the clocks drift ({drift:+.0f} ppm), or the robot has changed.")
    shape = Trajectory(t[rest], truth[rest], None, values[rest], no, no, no, robot=arm)
    table = errors_table(shape, sigma, shapes)
    tip = table[table["quantity"] == "tip"].drop(columns=["quantity", "unit"])
    lines += [
        "Errors of the tip [mm], in how many rows the 95 % ellipsoid holds the measured tip [%], and how many"
    ]
    lines += ["times larger every ± must be for 95 % (grown; repro live --grown takes it):"]
    lines += [tip.to_string(index=False, float_format="{:.3g}".format, na_rep="-")]
    frames = {name: x.to_frame() for name, x in {"measured": shape, **shapes}.items()}
    joined = pd.concat([frame.add_prefix(f"{name}: ") for name, frame in frames.items()], axis=1)
    files = {"errors.csv": _csv(table), "estimates.csv": _csv(joined), "report.txt": "\n".join(lines) + "\n"}
    if known is not None:
        files["calibration.json"] = calibration_text(known)
    picture = _picture(
        frames, [unit for unit, fixed in zip(shape.units(), arm.fixed, strict=True) if not fixed]
    )
    with whole(folder, owner) as stage:  # the folder appears when it is complete
        stage.mkdir()
        (stage / "estimates.png").write_bytes(picture)
        for name, content in files.items():
            (stage / name).write_text(content, encoding="utf-8", newline="\n")
    return Report("\n".join([*lines, f"Written: {folder.name}"]), table)


def _interpolated(u: Array, q: Array, use: Array, rest: Array) -> Array:
    """Return configurations of the rest by a plain interpolation of what was read in known poses."""
    from scipy.interpolate import RBFInterpolator

    rows, scale, size = np.flatnonzero(use), u[use].std(0).clip(1e-12), q[use].std(0).clip(1e-12)
    rows = rows[:: 1 + len(rows) // 300]
    plain = RBFInterpolator(u[rows] / scale, q[rows] / size, smoothing=0.1)  # thin plates
    there, found = np.isfinite(u[rest]).all(1), np.full((int(rest.sum()), q.shape[1]), np.nan)
    found[there] = size * plain(u[rest][there] / scale)
    return found


def errors_table(measured: Trajectory, sigma: Array, shapes: Mapping[str, Trajectory]) -> Any:
    """Return errors by estimate and quantity, and how often 95 % regions hold the measured pose, itself uncertain.

    ``grown`` is how many times larger every ± must be stated for them to hold it in 95 % of the rows.
    """
    import pandas as pd

    rows, robot, units = [], measured.robot, measured.units()
    for name, shape in shapes.items():
        use = np.isfinite(measured.q).all(1) & np.isfinite(shape.q).all(1)
        e = robot.free_angles.difference(shape.q[use], measured.q[use])
        tip, G = robot.tip_slopes(shape.q[use])
        away = tip - robot.tip_slopes(measured.q[use])[0]
        parts = [("tip", "mm", 1e3 * away, 1e3 * G)]
        for c in np.flatnonzero(~robot.fixed):
            quantity, unit, factor = units[c]
            parts.append((quantity, unit, factor * e[:, [c]], factor * np.eye(robot.n_q)[[c]]))
        for quantity, unit, error, slopes in parts:
            size, inside, grown = np.linalg.norm(error, axis=1), math.nan, math.nan
            if shape.covariance is not None:
                C = slopes @ (shape.covariance[use] + sigma) @ np.swapaxes(slopes, -1, -2)
                score = np.einsum("ti,tij,tj->t", error, np.linalg.pinv(C, rcond=1e-9, hermitian=True), error)
                limit = chi_square.ppf(_COVERED, min(error.shape[1], (~robot.fixed).sum()))
                inside = 100 * float((score <= limit).mean())
                grown = math.sqrt(np.quantile(score, _COVERED) / limit)
            numbers_of = {"mean": size.mean(), "rmse": np.sqrt(np.square(size).mean()), "largest": size.max()}
            numbers_of |= {
                "p95": np.quantile(size, 0.95),
                "coverage": inside,
                "grown": grown,
                "rows": len(size),
            }
            rows.append({"estimate": name, "quantity": quantity, "unit": unit, **numbers_of})
    return pd.DataFrame(rows)


def _picture(frames: Mapping[str, Any], units: Sequence[tuple[str, str, float]]) -> bytes:
    """Draw measured and estimated coordinates, and the error of the tip, over time."""
    from matplotlib import style
    from matplotlib.figure import Figure

    with style.context("default", after_reset=True):  # whatever the user has set
        figure = Figure(figsize=(8.0, 1.6 * len(units) + 2.6), layout="constrained")
        axes, tip = figure.subplots(len(units) + 1, 1, sharex=True), [f"tip_{axis}_mm" for axis in "xyz"]
        for k, (name, frame) in enumerate(frames.items()):
            look = {"lw": 1.0 if k else 3.0, "color": f"C{k - 1}" if k else "0.7", "label": name}
            look["ls"] = ":" if name.startswith("as described") else "-"
            for ax, (quantity, unit, _) in zip(axes, units, strict=False):
                ax.set_ylabel(f"{quantity}\n[{unit}]")
                if k == 0 or name.startswith("calibrated"):
                    ax.plot(frame["time_s"], frame[f"{quantity}_{unit}" if unit else quantity], **look)
            away = np.linalg.norm(frame[tip].to_numpy() - frames["measured"][tip].to_numpy(), axis=1)
            axes[-1].semilogy(frame["time_s"], np.where(away > 0, away, np.nan), **look)
        axes[-1].set(xlabel="time of the readings [s]", ylabel="error of the tip\n[mm]")
        figure.legend(*axes[-1].get_legend_handles_labels(), loc="outside upper center", ncols=2)
        picture = io.BytesIO()
        figure.savefig(picture, dpi=150, metadata={"Software": None})
    return picture.getvalue()
