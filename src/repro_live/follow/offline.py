"""A recording, or a table of readings, estimated as a live session would: same time steps, same estimator."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, field

from tqdm import tqdm

from repro.estimation.base import Estimate
from repro.estimation.consistency import STATUS
from repro_live.follow.follower import Follower
from repro_live.follow.readings_file import Readings, time_steps
from repro_live.follow.robot_estimator import RobotEstimator


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
    consistency: list[int] = field(default_factory=lambda: [0] * len(STATUS))

    def lines(self) -> list[str]:
        """Return the summary in words: estimates, consistency, and what could not be used."""
        follower = self.follower
        rate = f", {follower.estimated / self.seconds:.0f} per second" if self.seconds else ""
        said = [f"{follower.estimated} estimates by {follower.estimator.name} in {self.seconds:.1f} s{rate}."]
        if sum(self.consistency):
            counts = zip(self.consistency, STATUS, strict=True)
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
        From :func:`repro_live.follow.readings_file.read_readings`.
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
