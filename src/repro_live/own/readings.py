"""Readings of one's own over time: time steps as estimators take them live, and the signals of the sensors."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import chain

import numpy as np
from jaxtyping import Float

from repro.errors import bad_input
from repro.robot_file.robot_file import RobotFile
from repro_live.follow.readings_file import Readings, time_steps
from repro_live.follow.time_steps import TimeStep


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


def timed_readings(readings: Readings, robot: RobotFile) -> TimedReadings:
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
    if len(steps) < 3:
        raise bad_input("readings", "repro fit", "of at least three time steps", len(steps))
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
