"""An estimator that is fed with time steps, and counts what it could not use."""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import Tensor

from repro.errors import InputError
from repro.estimation.base import Estimate
from repro.estimation.consistency import Verdict
from repro_live.follow import imu_streams
from repro_live.follow.robot_estimator import RobotEstimator
from repro_live.follow.time_steps import TimeStep


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
