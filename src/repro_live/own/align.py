"""Readings and poses on one clock: the lag, after a check that the poses are those of the readings."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from repro.errors import InputError, bad_input, require
from repro.robot_file.robot_file import RobotFile
from repro_live.own.lag import LEAST_R, MARGIN, OWNER, Correlations, check_peak, correlations
from repro_live.own.poses import MeasuredPoses
from repro_live.own.samples import Samples, TimedReadings

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
        :func:`repro_live.own.lag.check_peak` and :func:`repro_live.own.lag.correlations`.
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
