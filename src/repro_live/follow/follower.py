"""An estimator that is fed with time steps and counts what it could not use; a whole recording estimated by it."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, field

import torch
from jaxtyping import Float
from torch import Tensor
from tqdm import tqdm

from repro.errors import InputError
from repro.estimation.base import Estimate
from repro.estimation.consistency import Status, Verdict
from repro_live.follow import imu_streams
from repro_live.follow.robot_estimator import RobotEstimator
from repro_live.follow.time_steps import TimeStep, time_steps
from repro_live.robot.readings_file import Readings


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
        self.missing = [0] * len(estimator.sensors)
        self._silences = imu_streams.Silences(len(estimator.robot.channel))
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
                missing = self._silences.told(step, missing)
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
        return u, estimate


@dataclass
class Tracked:
    """What became of a recording.

    Attributes
    ----------
    follower
        The estimator behind the last time step, and its counters.
    seconds
        How long it took.
    notes
        What was left out, one sentence each.
    consistency
        How many estimates are consistent, suspicious, wrong; zeros where the estimator does not say.
    """

    follower: Follower
    seconds: float = 0.0
    notes: list[str] = field(default_factory=list)
    consistency: list[int] = field(default_factory=lambda: [0] * len(Status))

    def lines(self) -> list[str]:
        """Return the summary in words: estimates, consistency, and what could not be used."""
        follower = self.follower
        rate = f", {follower.estimated / self.seconds:.0f} per second" if self.seconds else ""
        said = [f"{follower.estimated} estimates by {follower.estimator.name} in {self.seconds:.1f} s{rate}."]
        if sum(self.consistency):
            counts = zip(self.consistency, (x.word for x in Status), strict=True)
            said.append(f"Consistency: {', '.join(f'{n} {word}' for n, word in counts)}.")
        if follower.refused:
            said.append(f"{follower.refused} time steps without an estimate. {follower.refusal}")
        for name, count in zip(follower.estimator.sensors, follower.missing, strict=True):
            if count:
                said.append(f"{name} gave no reading in {count} time steps and was left out there.")
        return said + self.notes


def track_readings(
    readings: Readings,
    estimator: RobotEstimator,
    each: Callable[[float, Estimate], None],
    *,
    progress: bool = False,
    seed: int = 0,
) -> Tracked:
    """Estimate readings at full speed, by the same steps as live.

    Parameters
    ----------
    readings
        From :func:`repro_live.robot.readings_file.read_readings`.
    estimator
        As for a live session.
    each
        Is given time [s] and estimate of every time step that has one.
    progress
        Show a progress bar.
    seed
        Of estimators that draw random numbers.
    """
    tracked = Tracked(Follower(estimator, seed=seed), notes=list(readings.notes))
    began = time.monotonic()
    with tqdm(total=len(readings.frames), unit="frames", disable=not progress) as bar:
        counted = 0
        for complete in time_steps(readings, estimator.robot):
            for step in complete:
                _, estimate = tracked.follower.step(step)
                if estimate is None:
                    continue
                if (status := estimate.diagnostics.get("status")) is not None:
                    tracked.consistency[int(status)] += 1
                each(readings.start_s + step.time_s, estimate)
            used = sum(frame is not None for step in complete for frame in step.frames)
            counted += used
            bar.update(used)
        bar.update(len(readings.frames) - counted)
    tracked.seconds = time.monotonic() - began
    return tracked
