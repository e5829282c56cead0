r"""Several segments: the particle filter of Mitchell et al. 2021 on the robots of Baaij et al. 2023.

Section V of Mitchell et al. expects the filter to extend to several magnets and sensors in one body. Here a robot of
up to three segments, 3 to 9 coordinates, follows the lemniscate T3; the filter is compared with least squares and a
Kalman filter on the same readings. All readings are synthetic, by magpylib, with noise; every method has the
multipole model of the robot as drawn. What could be chosen was chosen on the half lemniscate T2
(:func:`repro_companion.pages.filter_on_segments.methods.tuning`). Here stands what they are given.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from repro.errors import bad_input
from repro.estimation.base import Trajectory
from repro.estimation.levenberg_marquardt import LevenbergMarquardt
from repro.kernels import compiled
from repro.kernels.sensing import CompiledSensing
from repro.kinematics.paper_robots import pcc_robot
from repro.kinematics.robot import Robot
from repro.kinematics.trajectories import lemniscate
from repro.sensing.linearised import LinearisedSensing
from repro.sensing.magnetic import readings
from repro.sensing.magnets import ring
from repro_companion.twins.calibrated_robots import box, start
from repro_companion.twins.calibration_session import SENSOR_NOISE_MT, released_moments

BEGUN = 2
"""Readings that a particle filter takes its start from; nothing is scored before."""
COLD_ITERATIONS = 30


@dataclass(frozen=True)
class CompiledModel(LinearisedSensing):
    """The same model with readings and slopes from the compiled kernel."""

    @cached_property
    def _kernel(self) -> CompiledSensing:
        return CompiledSensing(LinearisedSensing(self.robot, self.moments))

    def linearise(
        self, q: Float[Tensor, "*q n_q"]
    ) -> tuple[Float[Tensor, "*batch s"], Float[Tensor, "*batch s n_q"]]:
        """Readings [mT] and their derivatives with respect to ``q`` [mT/m]."""
        return self._kernel.linearise(q)


@dataclass(frozen=True)
class Course:
    """A robot, a part of a trajectory, and the noise of its readings.

    Parameters
    ----------
    n_segments, sensors_per_segment
        As for :func:`~repro.kinematics.paper_robots.pcc_robot`.
    noise_mt
        Standard deviation of a reading [mT], known to every method.
    draws
        Draws of the noise; the first ones do not depend on how many there are.
    first, steps
        The part: number of its first time step and of steps, at 40 Hz.
    half
        The half lemniscate T2 (for choices) instead of T3; the noise is another one.
    failed
        Numbers of the sensors, from 1, that are masked from ``failure`` on.
    failure
        Step of the part from which on they are.

    Raises
    ------
    InputError
        If there is no draw, the part is too short or not within the trajectory, or there is no such sensor.
    """

    n_segments: int
    sensors_per_segment: int = 4
    noise_mt: float = SENSOR_NOISE_MT
    draws: int = 10
    first: int = 0
    steps: int = 60
    half: bool = False
    failed: tuple[int, ...] = ()
    failure: int = 0

    def __post_init__(self) -> None:
        owner, n = "Course", self.n_segments * self.sensors_per_segment
        if self.draws < 1:
            raise bad_input("draws", owner, "at least 1", self.draws)
        if self.first < 0 or self.steps <= BEGUN or self.first + self.steps > 400:
            part = (self.first, self.steps)
            raise bad_input("first, steps", owner, f"more than {BEGUN} of the 400 steps", part)
        if not set(self.failed) < set(range(1, n + 1)):
            raise bad_input("failed", owner, f"some, not all, of 1 to {n}", self.failed)

    @cached_property
    def robot(self) -> Robot:
        """Robot as drawn."""
        return pcc_robot(self.n_segments, self.sensors_per_segment)

    @cached_property
    def model(self) -> CompiledModel:
        """What every method knows of it."""
        return CompiledModel(self.robot, released_moments())

    @cached_property
    def bounds(self) -> tuple[Float[Tensor, " n_q"], Float[Tensor, " n_q"]]:
        """Bounds of every method [m]: the training box."""
        return box(self.n_segments)

    @cached_property
    def whole(self) -> Float[Tensor, "t n_q"]:
        """True configurations [m] of the whole trajectory."""
        return lemniscate(self.n_segments, half=self.half)

    @cached_property
    def q(self) -> Float[Tensor, "t n_q"]:
        """True configurations of the part [m]."""
        return self.whole[self.first : self.first + self.steps]

    @cached_property
    def u(self) -> Float[Tensor, "t draws s"]:
        """Readings [mT], by magpylib, with noise."""
        clean = readings(self.robot, self.q, ring("released"))
        generators = [torch.Generator().manual_seed(2 * k + self.half) for k in range(self.draws)]
        noise = [torch.randn(clean.shape, generator=g, dtype=torch.float64) for g in generators]
        return clean.unsqueeze(1) + self.noise_mt * torch.stack(noise, dim=1)

    @cached_property
    def working(self) -> Bool[Tensor, "t s"]:
        """Sensors in use at every step."""
        failed = torch.zeros(len(self.robot.sensors), dtype=torch.bool)
        failed[[k - 1 for k in self.failed]] = True
        return ~((torch.arange(self.steps) >= self.failure).unsqueeze(-1) & failed)

    def least_squares(self, iterations: int) -> LevenbergMarquardt:
        """Levenberg-Marquardt within the box."""
        options = {"noise_mt": self.noise_mt, "iterations": iterations}
        return LevenbergMarquardt(compiled(self.model), *self.bounds, **options)

    def cold(self) -> Trajectory:
        """Least squares from the straight pose at mid elongation, at every step anew."""
        method = self.least_squares(COLD_ITERATIONS)
        q0 = start(self.n_segments).expand(self.steps, self.draws, -1)
        found = method.step(method.init(q0), self.u, 0.0, mask=self.working.unsqueeze(1))[1]
        return Trajectory(found.q, found.covariance, found.u_hat, found.diagnostics)
