r"""Several segments: the particle filter of Mitchell et al. 2021 on the robots of Baaij et al. 2023.

Section V of Mitchell et al. expects the filter to extend to several magnets and sensors in one body. Here a robot of
up to three segments, 3 to 9 coordinates, follows the lemniscate T3; the filter is compared with least squares and a
Kalman filter on the same readings. All readings are synthetic, by magpylib, with noise; every method has the
multipole model of the robot as drawn. What could be chosen was chosen on the half lemniscate T2 (:data:`TUNED`).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import torch
from edition1.errors import bad_input, require
from edition1.estimation.base import Trajectory, stacked, track
from edition1.estimation.kalman_filter import IteratedKalmanFilter
from edition1.estimation.levenberg_marquardt import LevenbergMarquardt
from edition1.estimation.particle_filter import ParticleFilter, ParticleState
from edition1.estimation.regions import Box
from edition1.kernels import compiled
from edition1.kernels._sensing import CompiledSensing
from edition1.kinematics.paper_robots import pcc_robot
from edition1.kinematics.robot import Robot
from edition1.sensing.linearised import LinearisedSensing
from edition1.sensing.magnetic import readings
from edition1.sensing.magnets import ring
from jaxtyping import Bool, Float
from torch import Tensor

from edition1_companion.twins.calibrated_robots import VELOCITY_SHARE, box, start
from edition1_companion.twins.calibration_session import SENSOR_NOISE_MT, released_moments
from edition1_companion.twins.trajectories import RATE_HZ, lemniscate

BEGUN = 2
"""Readings that a particle filter takes its start from; nothing is scored before."""
COLD_ITERATIONS = 30
WARM_ITERATIONS = 8
NOISE_MT = (SENSOR_NOISE_MT, 0.02)
"""Noise of a reading [mT]: that of the sensors of Baaij et al., and about that of the sensor of Mitchell et al."""
FILTERS = ("random walk", "constant velocity", "constant velocity + Gauss-Newton")
METHODS = (*FILTERS, "least squares, last estimate", "least squares, straight start", "Kalman filter")
TUNED: dict[tuple[int, float, str], tuple[float, float]] = {
    (1, NOISE_MT[0], "random walk"): (0.005, 1.0),
    (1, NOISE_MT[0], "constant velocity"): (0.0005, 1.0),
    (1, NOISE_MT[0], "Kalman filter"): (0.05, 1.0),
    (1, NOISE_MT[1], "random walk"): (0.01, 1.0),
    (1, NOISE_MT[1], "constant velocity"): (0.002, 1.0),
    (1, NOISE_MT[1], "Kalman filter"): (0.02, 1.0),
    (2, NOISE_MT[0], "random walk"): (0.01, 3.0),
    (2, NOISE_MT[0], "constant velocity"): (0.0005, 1.0),
    (2, NOISE_MT[0], "Kalman filter"): (0.05, 1.0),
    (2, NOISE_MT[1], "random walk"): (0.01, 1.0),
    (2, NOISE_MT[1], "constant velocity"): (0.005, 1.0),
    (2, NOISE_MT[1], "Kalman filter"): (0.02, 1.0),
    (3, NOISE_MT[0], "random walk"): (0.01, 3.0),
    (3, NOISE_MT[0], "constant velocity"): (0.0005, 1.0),
    (3, NOISE_MT[0], "Kalman filter"): (0.05, 1.0),
    (3, NOISE_MT[1], "random walk"): (0.02, 1.0),
    (3, NOISE_MT[1], "constant velocity"): (0.002, 1.0),
    (3, NOISE_MT[1], "Kalman filter"): (0.02, 1.0),
}
"""Choices by robot, noise and method, with the least error of the tip on T2. First the process noise of one step in
widths of the box (for the Kalman filter per s^1.5); then the noise that a particle filter assumes, relative to that
of the readings: a wider likelihood keeps more particles, and forgets more slowly."""


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
    n_segments
        Of the robot, each with four sensors.
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
        If there is no draw, or the part is too short or not within the trajectory.
    """

    n_segments: int
    noise_mt: float = SENSOR_NOISE_MT
    draws: int = 10
    first: int = 0
    steps: int = 60
    half: bool = False
    failed: tuple[int, ...] = ()
    failure: int = 0

    def __post_init__(self) -> None:
        require(self.draws >= 1, "draws", "Course", "at least 1", self.draws)
        if self.first < 0 or self.steps <= BEGUN or self.first + self.steps > 400:
            part = (self.first, self.steps)
            raise bad_input("first, steps", "Course", f"more than {BEGUN} of the 400 steps", part)

    @cached_property
    def robot(self) -> Robot:
        """Robot as drawn."""
        return pcc_robot(self.n_segments, 4)

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
        return LevenbergMarquardt(
            compiled(self.model), *self.bounds, noise_mt=self.noise_mt, iterations=iterations
        )

    def cold(self) -> Trajectory:
        """Least squares from the straight pose at mid elongation, at every step anew."""
        method = self.least_squares(COLD_ITERATIONS)
        q0 = start(self.n_segments).expand(self.steps, self.draws, -1)
        found = method.step(method.init(q0), self.u, 0.0, mask=self.working.unsqueeze(1))[1]
        return Trajectory(found.q, found.covariance, found.u_hat, found.diagnostics)


def run(course: Course, method: str, *, particles: int = 300) -> Trajectory:
    """Estimates of a method along a course, for all draws; those of a particle filter lack the first two steps.

    Parameters
    ----------
    course
        Robot and readings.
    method
        One of ``METHODS``.
    particles
        Of the particle filters.

    Raises
    ------
    InputError
        If the method is unknown, or nothing was chosen for this robot and noise.
    """
    if method == "least squares, straight start":
        return course.cold()
    q0 = start(course.n_segments).expand(course.draws, -1)
    along = {"readings": course.u, "q0": q0, "rate_hz": RATE_HZ, "mask": course.working}
    if method == "least squares, last estimate":
        # As many iterations as a cold start, of which a warm one needs few.
        return track(course.least_squares(COLD_ITERATIONS), **along)
    key = (course.n_segments, course.noise_mt, method.removesuffix(" + Gauss-Newton"))
    if key not in TUNED:
        known = f"one of {', '.join(map(repr, METHODS))}, at a noise of {NOISE_MT[0]} or {NOISE_MT[1]} mT"
        raise bad_input("method", "mitchell2021_segments", known, f"{method!r} at {course.noise_mt} mT")
    share, inflation = TUNED[key]
    width = course.bounds[1] - course.bounds[0]
    if method == "Kalman filter":
        moving = {"acceleration": share * width, "velocity": VELOCITY_SHARE * width}
        options = {"noise_mt": course.noise_mt, "iterations": WARM_ITERATIONS}
        return track(IteratedKalmanFilter(course.model, *course.bounds, **moving, **options), **along)
    particle_filter = ParticleFilter(
        course.model,
        share * width,
        inflation * course.noise_mt,
        Box(*course.bounds),
        particles=particles,
        estimate="Gauss-Newton" if method.endswith("Gauss-Newton") else "weighted",
        motion="random walk" if method == "random walk" else "constant velocity",
    )
    return _followed(course, particle_filter)


def _followed(course: Course, method: ParticleFilter) -> Trajectory:
    """Run a particle filter, with random numbers of its own for every draw.

    ``positive`` in the diagnostics is the share of the cloud in which each coordinate is positive.
    """
    whole = first_cloud(course, method)
    members = []
    for draw in range(course.draws):
        state = ParticleState(whole.q[draw], whole.velocity[draw], draw, whole.steps)
        estimates = []
        for k in range(BEGUN, course.steps):
            state, found = method.step(state, course.u[k, draw], k / RATE_HZ, mask=course.working[k])
            positive = (state.q > 0).double().mean(-2)
            estimates.append(replace(found, diagnostics={**found.diagnostics, "positive": positive}))
        members.append(stacked(estimates))
    return stacked(members, dim=1)


def first_cloud(course: Course, method: ParticleFilter) -> ParticleState:
    """Cloud before the third readings, from least squares on the first two, each by itself from the straight pose.

    The second fit is the configuration, the difference of both the velocity; velocities have the same prior as in the
    Kalman filter. No true coordinate enters.
    """
    fits = course.cold()
    assert fits.covariance is not None
    first, second = fits.covariance[:BEGUN]
    shape = (course.draws, method.particles, course.robot.n_q)
    g = torch.Generator().manual_seed(0)
    of_q, of_velocity, of_motion = (torch.randn(shape, generator=g, dtype=torch.float64) for _ in range(3))
    q = fits.q[1].unsqueeze(-2) + of_q @ torch.linalg.cholesky(second).mT
    velocity = torch.zeros_like(q)
    if method.motion == "constant velocity":
        width = course.bounds[1] - course.bounds[0]
        prior = torch.diag((VELOCITY_SHARE / RATE_HZ * width) ** 2)
        gain = torch.linalg.solve(prior + first + second, prior).mT
        C = gain @ (first + second)
        velocity = (gain @ (fits.q[1] - fits.q[0]).unsqueeze(-1)).mT
        velocity = velocity + of_velocity @ torch.linalg.cholesky((C + C.mT) / 2).mT
    moved = q + velocity + method.process_noise * of_motion
    return ParticleState(torch.clamp(moved, *course.bounds), velocity, 0, 1)
