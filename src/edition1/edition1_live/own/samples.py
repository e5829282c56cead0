"""Signals over time: interpolated linearly, but never over a gap; readings of one's own as such signals."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import chain

import numpy as np
from jaxtyping import Bool, Float

from edition1.errors import require
from edition1.robot_file.robot_file import RobotFile
from edition1_live.follow.time_steps import TimeStep, time_steps
from edition1_live.robot.readings_file import Readings

GAP_STEPS = 2.5
"""Samples farther apart than this many of their usual steps are not interpolated over."""


def longest_gap_s(time_s: Float[np.ndarray, " samples"]) -> float:
    """Longest time between two samples over which is interpolated [s]: :data:`GAP_STEPS` median steps."""
    return GAP_STEPS * float(np.median(np.diff(time_s)))


def known(
    sampled_s: Float[np.ndarray, " samples"], time_s: Float[np.ndarray, " times"], gap_s: float
) -> Bool[np.ndarray, " times"]:
    """Whether times lie at a sample, or between two that are at most ``gap_s`` apart.

    Examples
    --------
    >>> known(np.array([0.0, 0.1, 0.9]), np.array([-0.1, 0.0, 0.05, 0.5, 0.9]), 0.25)
    array([False,  True,  True, False,  True])
    """
    after = np.searchsorted(sampled_s, time_s, side="right")
    k = np.clip(after, 1, len(sampled_s) - 1)
    between = (after > 0) & (after < len(sampled_s)) & (sampled_s[k] - sampled_s[k - 1] <= gap_s)
    return between | ((after > 0) & (sampled_s[np.clip(after - 1, 0, None)] == time_s))


def interpolated(
    sampled_s: Float[np.ndarray, " samples"],
    values: Float[np.ndarray, "samples k"],
    time_s: Float[np.ndarray, " times"],
    gap_s: float,
) -> Float[np.ndarray, "times k"]:
    """Values at times, linearly between samples; NaN where nothing is :func:`known`."""
    columns = [np.interp(time_s, sampled_s, column) for column in values.T]
    return np.where(known(sampled_s, time_s, gap_s)[:, None], np.stack(columns, axis=-1), np.nan)


@dataclass(frozen=True)
class Samples:
    """Signals over time; rows with a missing value are left out.

    Parameters
    ----------
    time_s
        Increasing times [s].
    values
        One column for each sensor.
    gap_s
        Longest time between two samples over which is interpolated [s].
    """

    time_s: Float[np.ndarray, " n"]
    values: Float[np.ndarray, "n s"]
    gap_s: float

    @classmethod
    def of(cls, time_s: np.ndarray, values: np.ndarray) -> Samples:
        """Leave out rows that are not complete."""
        whole = np.isfinite(values).all(axis=1)
        return cls(time_s[whole], values[whole], longest_gap_s(time_s))

    def at(self, time_s: np.ndarray) -> np.ndarray:
        """Values at times; NaN in gaps."""
        return interpolated(self.time_s, self.values, time_s, self.gap_s)


@dataclass(frozen=True)
class TimedReadings:
    """Readings over time.

    Parameters
    ----------
    steps
        As estimators take them; times by the board's clock where it sends one, else by arrival.
    signal
        Readings of the magnetic sensors without the offsets of the robot file [unit]; NaN where one is missing.
    notes
        What was left out.
    """

    steps: tuple[TimeStep, ...]
    signal: Float[np.ndarray, "steps s"]
    notes: tuple[str, ...]

    @property
    def time_s(self) -> Float[np.ndarray, " steps"]:
        """Times of the steps [s]."""
        return np.array([step.time_s for step in self.steps])

    def counted_from(self, start_s: float) -> TimedReadings:
        """Return the same with another zero of the clock [s]."""
        return replace(self, steps=tuple(s._replace(time_s=s.time_s - start_s) for s in self.steps))


def timed_readings(readings: Readings, robot: RobotFile, owner: str = "repro fit") -> TimedReadings:
    """Return the time steps of a robot with magnetic sensors, in the time of the file, and their signals.

    Raises
    ------
    InputError
        If there are fewer than three time steps.
    """
    steps = tuple(
        step._replace(time_s=readings.start_s + step.time_s)
        for step in chain.from_iterable(time_steps(readings, robot))
    )
    require(len(steps) >= 3, "readings", owner, "of at least three time steps", len(steps))
    signal = np.full((len(steps), len(robot.channel)), np.nan)
    for k, step in enumerate(steps):
        if (frame := step.frames[0]) is not None:
            signal[k] = robot.signal(frame.values).numpy()
    notes = list(readings.notes)
    if missing := int((~np.isfinite(signal)).any(axis=1).sum()):
        notes.append(f"{missing} time steps lack a magnetic reading.")
    rate_hz = 1.0 / float(np.median(np.diff([step.time_s for step in steps])))
    if not 0.8 < rate_hz / robot.rate_hz < 1.25:
        notes.append(f"{rate_hz:.4g} frames/s, where {robot.name} says {robot.rate_hz:g}.")
    return TimedReadings(steps, signal, tuple(notes))
