"""An estimator that is fed with time steps and counts what it could not use; a whole recording estimated by it."""

from __future__ import annotations

import time
from collections.abc import Callable

import torch
from jaxtyping import Float
from torch import Tensor
from tqdm import tqdm

from edition1.errors import InputError
from edition1.estimation.base import Estimate
from edition1.estimation.consistency import Status, Verdict
from edition1_live.follow.robot_estimator import RobotEstimator
from edition1_live.follow.time_steps import TimeStep, time_steps
from edition1_live.robot.readings_file import Readings

_SILENT_S = 1.0
"""A stream of which nothing was heard for so long gives no reading [s]; until then it is only slower than others."""


class Follower:
    """Steps an estimator from one time step to the next, and counts what it could not use.

    Parameters
    ----------
    estimator
        What to step.
    seed
        Of estimators that draw random numbers.

    Attributes
    ----------
    estimated
        Time steps with an estimate.
    consistency
        How many of these are consistent, suspicious, wrong.
    missing
        For every sensor, time steps in which it gave no number.
    refused
        Time steps without an estimate: no reading was a number, or one was infinite, or no orientation, or a frame
        has another number of values than the robot file says.
    refusal
        Why the last of these was refused.
    """

    def __init__(self, estimator: RobotEstimator, *, seed: int = 0) -> None:
        self.estimator = estimator
        self.estimated = self.refused = 0
        self.refusal = ""
        self.missing, self.consistency = [0] * len(estimator.sensors), [0] * len(Status)
        self._heard: dict[int, float] = {}
        self._state = estimator.method.init(estimator.start, seed=seed)

    @property
    def verdict(self) -> Verdict:
        """Whether the readings of the last time step fit the robot."""
        return self._state.verdict

    def step(self, step: TimeStep) -> tuple[Float[Tensor, " readings"], Estimate | None]:
        """Return the readings of a time step, and the estimate; none where the readings cannot be used.

        Readings are NaN where frames have another number of values than the robot file says.
        """
        u = torch.full(self.estimator.use.shape, torch.nan, dtype=torch.float64)
        try:
            u = self.estimator.readings(step)
            missing = self.estimator.missing(u)
            if self.estimator.stacked is not None:
                missing = self._told(step, missing)
            for k, gone in enumerate(missing):
                self.missing[k] += gone
            self._state, estimate = self.estimator.method.step(
                self._state, u, step.time_s, mask=self.estimator.use
            )
        except InputError as error:
            self.refused += 1
            self.refusal = str(error)
            return u, None
        self.estimated += 1
        self.consistency[self.verdict.status] += 1
        return u, self.estimator.stated(estimate)

    def _told(self, step: TimeStep, missing: list[bool]) -> list[bool]:
        """Which of the sensors that gave no number are to be told of: streams that are only slower are not."""
        n, said = len(self.estimator.robot.channel), list(missing)
        for k, frame in enumerate(step.frames):
            if frame is not None:
                self._heard[k] = step.time_s
            elif step.time_s - self._heard.setdefault(k, step.time_s) < _SILENT_S:
                first, last = (0, n) if k == 0 else (n + k - 1, n + k)
                said[first:last] = [False] * (last - first)
        return said


def track_readings(
    readings: Readings,
    estimator: RobotEstimator,
    each: Callable[[float, Estimate], None],
    *,
    progress: bool = False,
    seed: int = 0,
) -> tuple[Follower, list[str]]:
    """Estimate readings at full speed, by the same steps as live.

    Parameters
    ----------
    readings
        From :func:`edition1_live.robot.readings_file.read_readings`.
    estimator
        As for a live session.
    each
        Is given time [s] and estimate of every time step that has one.
    progress
        Show a progress bar.
    seed
        Of estimators that draw random numbers.

    Returns
    -------
    follower, summary
        The estimator behind the last time step, with its counts; and in sentences: how many estimates, how
        consistent, what could not be used, what was left out.
    """
    follower, began = Follower(estimator, seed=seed), time.monotonic()
    with tqdm(total=len(readings.frames), unit="frames", disable=not progress) as bar:
        for complete in time_steps(readings, estimator.robot):
            for step in complete:
                _, estimate = follower.step(step)
                if estimate is not None:
                    each(readings.start_s + step.time_s, estimate)
            bar.update(sum(frame is not None for step in complete for frame in step.frames))
        bar.update(len(readings.frames) - bar.n)
    return follower, _summary(follower, time.monotonic() - began) + readings.notes


def _summary(follower: Follower, seconds: float) -> list[str]:
    rate = f", {follower.estimated / seconds:.0f} per second" if seconds else ""
    said = [f"{follower.estimated} estimates by {follower.estimator.name} in {seconds:.1f} s{rate}."]
    if follower.estimated:
        counts = zip(follower.consistency, (x.word for x in Status), strict=True)
        said.append(f"Consistency: {', '.join(f'{n} {word}' for n, word in counts)}.")
    if follower.refused:
        said.append(f"{follower.refused} time steps without an estimate. {follower.refusal}")
    for name, count in zip(follower.estimator.sensors, follower.missing, strict=True):
        if count:
            said.append(f"{name} gave no reading in {count} time steps and was left out there.")
    return said
