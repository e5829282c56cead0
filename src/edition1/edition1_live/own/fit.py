"""A robot judged on a recording with motion capture: aligned, calibrated on the first part, tracked on the rest."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from edition1.errors import InputError, bad_input, require
from edition1.robot_file.calibration_file import RobotCalibration
from edition1.robot_file.robot_file import RobotFile
from edition1_live.follow.robot_estimator import robot_estimator
from edition1_live.follow.time_steps import TimeStep
from edition1_live.own.judge import Tracked, Truth, tip_positions, tracked
from edition1_live.own.lag import LEAST_R, MARGIN, OWNER, Correlations, Lag, check_peak, correlations, refined
from edition1_live.own.models import TRACKERS, Networks, TimeParts, calibrated, split_in_time, trained
from edition1_live.own.poses import MeasuredPoses
from edition1_live.own.samples import Samples, TimedReadings

_MODELS = ("calibration", "network")
_MOST_ROUNDS = 4
_SETTLED = 0.5
"""A lag that changes by less than this many of its standard deviations is final."""


@dataclass(frozen=True)
class Fit:
    """What :func:`fit` found.

    Parameters
    ----------
    robot
        As described.
    lag
        Between the clocks; with a calibration, by the calibrated robot on the first part.
    rest_lag
        The same by the rest alone, for comparison.
    parts
        Which readings were calibrated with, and which judged.
    time_s
        Of the judged frames, by the clock of the readings [s].
    truth
        Measured poses at these.
    tracks
        Estimates, of the robot as described first.
    calibration, networks
        Whichever was made.
    notes
        What was left out or looks odd.
    """

    robot: RobotFile
    lag: Lag
    rest_lag: Lag
    parts: TimeParts
    time_s: np.ndarray
    truth: Truth
    tracks: list[Tracked]
    calibration: RobotCalibration | None
    networks: Networks | None
    notes: tuple[str, ...]

    @property
    def masked(self) -> int:
        """Judged frames without a measured pose."""
        return int((~self.truth.known).sum())


def fit(
    robot: RobotFile,
    readings: TimedReadings,
    poses: MeasuredPoses,
    *,
    model: str = _MODELS[0],
    share: float = 0.4,
    longest_lag_s: float = 10.0,
    seed: int = 0,
    say: Callable[[str], object] = lambda _: None,
) -> Fit:
    """Align, split, calibrate (or train), and track the rest from a cold start.

    No measured pose enters an estimate: those of the first part enter the model, those of the rest are only compared.

    Parameters
    ----------
    robot
        As described, without a calibration.
    readings, poses
        Each on its own clock.
    model
        ``"calibration"`` or ``"network"``.
    share
        Of the time, for the first part.
    longest_lag_s
        Largest difference of the clocks that is tried [s].
    seed
        Of the networks.
    say
        Takes a line at every stage.

    Raises
    ------
    InputError
        If the two are not of one motion, too short, or do not fit the robot.
    """
    require(model in _MODELS, "model", "repro fit", " or ".join(_MODELS), repr(model))
    if model == "network" and robot.imus:
        raise bad_input("model", "repro fit", f"calibration for {robot.name}, which has IMUs", model)
    require(0 < longest_lag_s < np.inf, "longest-lag", "repro fit", "above 0, and finite", longest_lag_s)
    readings, poses, from_first = on_one_clock(readings, poses)
    notes = [*readings.notes, *poses.notes]
    if from_first:
        notes.append("The clocks have no time in common: each is counted from its first row.")
    say("Looking for the lag between the clocks.")
    near_s = find_clock_lag(robot, readings, poses, longest_lag_s)
    parts = _parts(readings, poses, near_s, share)
    measured, calibration, networks, left_out = Samples.of(readings.time_s, readings.signal), None, None, 0
    say("Calibrating." if model == "calibration" else "Training networks.")
    expected = predicted(robot.sensing(), poses, poses.q)
    lag = refined(_during(measured, parts.first_s), expected, near_s)
    for _ in range(_MOST_ROUNDS):  # the new model tells the lag better, and that the model
        before_s, parts = lag.lag_s, _parts(readings, poses, lag.lag_s, share)
        use = parts.first & np.isfinite(readings.signal).all(axis=1)
        values, q, covariance = _training(readings, poses, lag, use)
        if model == "calibration":
            calibration, left_out = calibrated(robot, values, q, covariance)
            sensing = robot.calibrated(calibration).sensing()
        else:
            networks = trained(robot, torch.from_numpy(readings.signal[use]), q, seed)
            sensing = networks.sensing(robot)
        expected = predicted(sensing, poses, poses.q)
        lag = refined(_during(measured, parts.first_s), expected, lag.lag_s)
        if abs(lag.lag_s - before_s) < _SETTLED * lag.error_s:
            break
    parts = _parts(readings, poses, lag.lag_s, share)
    if left_out:
        notes.append(f"{left_out} poses of the first part do not go with their readings: not fitted.")
    rest_lag = refined(_during(measured, parts.rest_s), expected, lag.lag_s)
    tracks = []
    for name in TRACKERS:
        say(f"Tracking with {name}.")
        tracks.append(tracked(robot_estimator(robot, name), readings, parts.rest, "described"))
        if networks is not None:
            after, label = networks.estimator(robot, name), "network"
        else:
            assert calibration is not None
            after, label = robot_estimator(robot.calibrated(calibration), name), "calibrated"
        tracks.append(tracked(after, readings, parts.rest, label))
    time_s = readings.time_s[parts.rest]
    truth = _truth(robot, poses, time_s, lag)
    return Fit(robot, lag, rest_lag, parts, time_s, truth, tracks, calibration, networks, tuple(notes))


def _parts(readings: TimedReadings, poses: MeasuredPoses, lag_s: float, share: float) -> TimeParts:
    known = np.isfinite(poses.at(poses.q.numpy(), readings.time_s - lag_s)).all(axis=1)
    return split_in_time(readings.time_s, np.asarray(known), share)


def _training(
    readings: TimedReadings, poses: MeasuredPoses, lag: Lag, use: np.ndarray
) -> tuple[Tensor, Tensor, Tensor]:
    """Values, configurations and their covariances of chosen frames; the error of the lag is in the last."""
    values = torch.tensor([_values(readings.steps[k]) for k in np.flatnonzero(use)], dtype=torch.float64)
    time_s = readings.time_s[use]
    q, covariance, _ = judged_at(poses, time_s, lag.lag_s)
    ahead, behind = (
        judged_at(poses, time_s + shift, lag.lag_s)[0] for shift in (poses.step_s, -poses.step_s)
    )
    speed = torch.nan_to_num(ahead - behind) / (2 * poses.step_s)
    return values, q, covariance + lag.error_s**2 * speed.unsqueeze(-1) * speed.unsqueeze(-2)


def _values(step: TimeStep) -> tuple[float, ...]:
    frame = step.frames[0]
    assert frame is not None  # its signal is complete
    return tuple(frame.values)


def _during(signal: Samples, span_s: tuple[float, float]) -> Samples:
    inside = (signal.time_s >= span_s[0]) & (signal.time_s <= span_s[1])
    return Samples(signal.time_s[inside], signal.values[inside], signal.gap_s)


def _truth(robot: RobotFile, poses: MeasuredPoses, time_s: np.ndarray, lag: Lag) -> Truth:
    q, covariance, tip = judged_at(poses, time_s, lag.lag_s)
    by_q, tip_covariance = tip_positions(robot, q, covariance)
    if tip is None or poses.tip_covariance is None:
        return Truth(q, covariance, by_q, tip_covariance)
    return Truth(q, covariance, tip, poses.tip_covariance.expand(len(q), 3, 3))


_CLEARLY = 2 * MARGIN
"""Poses with other axes must correlate by this much better to be what is meant."""
_COARSE_S = 0.04
"""Between the poses with which other axes are tried [s]."""
_TURNS = {
    "x and y exchanged": ((0.0, 1.0), (1.0, 0.0)),
    "x reversed": ((-1.0, 0.0), (0.0, 1.0)),
    "y reversed": ((1.0, 0.0), (0.0, -1.0)),
    "x and y reversed": ((-1.0, 0.0), (0.0, -1.0)),
    "x and y exchanged and reversed": ((0.0, -1.0), (-1.0, 0.0)),
    "(x, y) turned to (y, -x)": ((0.0, 1.0), (-1.0, 0.0)),
    "(x, y) turned to (-y, x)": ((0.0, -1.0), (1.0, 0.0)),
}


def on_one_clock(readings: TimedReadings, poses: MeasuredPoses) -> tuple[TimedReadings, MeasuredPoses, bool]:
    """Return readings and poses, and whether their times were counted from the first of each.

    They are where the two have no time in common, as a clock since 1970 and one since the start have none.
    """
    apart = readings.time_s[0] > poses.time_s[-1] or poses.time_s[0] > readings.time_s[-1]
    if not apart:
        return readings, poses, False
    starts = readings.time_s[0], poses.time_s[0]
    return readings.counted_from(starts[0]), poses.counted_from(starts[1]), True


def find_clock_lag(
    robot: RobotFile, readings: TimedReadings, poses: MeasuredPoses, longest_s: float
) -> float:
    """Lag of readings behind poses by a robot as described, to a sample [s].

    Raises
    ------
    InputError
        If the poses are not those of the readings, or other axes fit them better; or as
        :func:`edition1_live.own.lag.check_peak` and :func:`edition1_live.own.lag.correlations`.
    """
    measured = Samples.of(readings.time_s, readings.signal)
    require(len(measured.time_s) >= 3, "readings", OWNER, "complete in three frames", len(measured.time_s))
    as_given = correlations(measured, predicted(robot.sensing(), poses, poses.q), longest_s)
    _check_axes(robot, measured, poses, as_given, longest_s)
    check_peak(as_given, robot.name)
    return float(as_given.lag_s[as_given.best])


def predicted(
    sensing: Callable[[Tensor], Tensor], poses: MeasuredPoses, q: Float[Tensor, "poses n_q"], every: int = 1
) -> Samples:
    """Readings that a sensor model predicts, at the times of the poses, or of every so many-th."""
    with torch.no_grad():
        u = sensing(q[::every]).numpy()
    return Samples(poses.time_s[::every], u, every * poses.longest_gap_s)


def _check_axes(
    robot: RobotFile, measured: Samples, poses: MeasuredPoses, found: Correlations, longest_s: float
) -> None:
    """Refuse poses whose axes would fit much better exchanged or reversed, and readings of the other sign."""
    r, better, every = found.r[found.best], {}, max(1, round(_COARSE_S / poses.step_s))
    if not set(robot.robot.coordinates).difference(_delta_names(len(robot.robot.segments))):
        for words, turn in _TURNS.items():
            q = poses.q.clone().unflatten(-1, (-1, 3))
            q[..., :2] = q[..., :2] @ torch.tensor(turn, dtype=q.dtype).mT
            other = correlations(measured, predicted(robot.sensing(), poses, q.flatten(-2), every), longest_s)
            better[words] = float(other.r.max())
    as_given = predicted(robot.sensing(), poses, poses.q, every)
    try:
        turned = correlations(measured, Samples(as_given.time_s, -as_given.values, as_given.gap_s), longest_s)
        better["the readings of the other sign"] = float(turned.r.max())
    except InputError:
        pass
    words = max(better, key=better.__getitem__, default="")
    if words and better[words] > max(r + _CLEARLY, LEAST_R):
        expected = f"of one motion, in the axes of {robot.name}"
        seen = f"r = {r:.3f} at best, but {better[words]:.3f} with {words}"
        raise bad_input("readings and poses", OWNER, expected, seen)


def _delta_names(segments: int) -> set[str]:
    return {f"delta_{axis}_{k}" for k in range(1, segments + 1) for axis in "xyL"}


def judged_at(
    poses: MeasuredPoses, readings_s: Float[np.ndarray, " times"], lag_s: float
) -> tuple[Tensor, Tensor, Tensor | None]:
    """Configurations, their covariances and measured tips at the times of readings; NaN in gaps."""
    at = readings_s - lag_s
    n = poses.q.shape[-1]
    covariance = poses.at(poses.covariance.flatten(-2).numpy(), at)
    tip = None if poses.tip is None else torch.from_numpy(poses.at(poses.tip.numpy(), at))
    q = torch.from_numpy(poses.at(poses.q.numpy(), at))
    return q, torch.from_numpy(covariance).unflatten(-1, (n, n)), tip
