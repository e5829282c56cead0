"""A whole recording smoothed: what later readings say about the shape before them."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

from tqdm import tqdm

from edition1.errors import InputError, bad_input, require
from edition1.estimation.base import Estimate, Estimator
from edition1.estimation.kalman_filter import IteratedKalmanFilter
from edition1.estimation.smoothing import smoothed
from edition1_live.follow.robot_estimator import RobotEstimator
from edition1_live.follow.time_steps import time_steps
from edition1_live.robot.readings_file import Readings


def smooth_readings(
    readings: Readings, estimator: RobotEstimator, *, lag_s: float = math.inf, progress: bool = False
) -> tuple[list[tuple[float, Estimate]], list[str]]:
    """Filter readings, then go back over them.

    The filter is not restarted where readings do not fit: ``chi2`` and ``dof`` are those of the filter, and there is
    no ``status``. The error that a calibration says the model has is not less for later readings: it is added as in
    the filter.

    Parameters
    ----------
    readings
        From :func:`edition1_live.robot.readings_file.read_readings`.
    estimator
        The ``kalman`` one of :func:`~edition1_live.follow.robot_estimator.robot_estimator`.
    lag_s
        As of :func:`edition1.estimation.smoothing.smoothed`.
    progress
        Show a progress bar.

    Returns
    -------
    estimates, summary
        Time [s] and estimate of every time step that has one; and what could not be used, in sentences.

    Raises
    ------
    InputError
        If the estimator is another one, or no time step can be used.
    """
    method: Estimator[Any] = estimator.method.estimator
    plain = _plain(method)
    state, states, found, times, refused, refusal = method.init(estimator.start, seed=0), [], [], [], 0, ""
    with tqdm(total=len(readings.frames), unit="frames", disable=not progress) as bar:
        for complete in time_steps(readings, estimator.robot):
            for step in complete:
                try:
                    u = estimator.readings(step)
                    state, estimate = method.step(state, u, step.time_s, mask=estimator.use)
                except InputError as error:
                    refused, refusal = refused + 1, str(error)
                    continue
                states.append(state)
                found.append(estimate)
                times.append(readings.start_s + step.time_s)
            bar.update(sum(frame is not None for step in complete for frame in step.frames))
        bar.update(len(readings.frames) - bar.n)
    require(states, "readings", "repro smooth", "a time step that can be used", refusal or "none")
    n, estimates = len(estimator.start), []
    for before, after, estimate in zip(states, smoothed(plain, states, lag_s=lag_s), found, strict=True):
        beyond = estimate.covariance - before.covariance[:n, :n]
        covariance = after.covariance[:n, :n] + beyond
        estimates.append(replace(estimate, q=after.q[:n], covariance=covariance))
    said = [
        f"{len(estimates)} estimates, smoothed{'' if math.isinf(lag_s) else f' by readings up to {lag_s:g} s later'}."
    ]
    if refused:
        said.append(f"{refused} time steps without an estimate. {refusal}")
    return list(zip(times, estimates, strict=True)), said + readings.notes


def _plain(method: Any) -> IteratedKalmanFilter:
    """The filter below what counts its readings and what adds the error of a model."""
    while not isinstance(method, IteratedKalmanFilter):
        method = getattr(method, "estimator", None)
        if method is None:
            raise bad_input(
                "estimator", "repro smooth", "the Kalman filter, for magnetic sensors", "another one"
            )
    return method
