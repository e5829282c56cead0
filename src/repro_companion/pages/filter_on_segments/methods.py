r"""Methods that follow a course of several segments: particle filters, least squares and a Kalman filter.

What could be chosen was chosen on the half lemniscate T2 (:func:`tuning`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import pandas as pd
import torch

from repro.errors import bad_input
from repro.estimation.base import Trajectory, stacked, track
from repro.estimation.kalman_filter import IteratedKalmanFilter
from repro.estimation.particle_filter import ParticleFilter, ParticleState
from repro.estimation.regions import Box
from repro.kinematics.trajectories import RATE_HZ
from repro_companion.pages.filter_on_segments.courses import BEGUN, COLD_ITERATIONS, Course
from repro_companion.twins.calibrated_robots import start
from repro_companion.twins.calibration_session import SENSOR_NOISE_MT

NOISE_MT = (SENSOR_NOISE_MT, 0.02)
"""Noise of a reading [mT]: that of the sensors of Baaij et al., and about that of the sensor of Mitchell et al."""
FILTERS = ("random walk", "constant velocity", "constant velocity + Gauss-Newton")
METHODS = (*FILTERS, "least squares, last estimate", "least squares, straight start", "Kalman filter")
WARM_ITERATIONS = 8
VELOCITY_SHARE = 0.5
"""Standard deviation of a velocity that the Kalman filter expects at first, in widths of the box per second."""


@dataclass(frozen=True)
class Tuned:
    """What is chosen on T2 for a robot and a noise.

    Parameters
    ----------
    share
        Process noise of one step in widths of the box; for the Kalman filter per s^1.5.
    inflation
        Noise that a particle filter assumes, relative to that of the readings: a wider likelihood keeps more
        particles, and forgets more slowly.
    """

    share: float
    inflation: float = 1.0


def run(course: Course, method: str, tuned: Tuned | None = None, *, particles: int = 300) -> Trajectory:
    """Estimates of a method along a course, for all draws; those of a particle filter lack the first two steps.

    Parameters
    ----------
    course
        Robot and readings.
    method
        One of ``METHODS``.
    tuned
        Choices; those of :data:`TUNED` when not given. Least squares has none.
    particles
        Of the particle filters.

    Raises
    ------
    InputError
        If the method is unknown, or nothing was chosen for this robot and noise.
    """
    q0 = start(course.n_segments).expand(course.draws, -1)
    if method == "least squares, straight start":
        return course.cold()
    if method == "least squares, last estimate":
        # As many iterations as a cold start, of which a warm one needs few.
        warm = course.least_squares(COLD_ITERATIONS)
        return track(warm, course.u, q0, rate_hz=RATE_HZ, mask=course.working)
    tuned = tuned or chosen(course, method)
    width = course.bounds[1] - course.bounds[0]
    if method == "Kalman filter":
        options = {"noise_mt": course.noise_mt, "iterations": WARM_ITERATIONS}
        moving = {"acceleration": tuned.share * width, "velocity": VELOCITY_SHARE * width}
        kalman = IteratedKalmanFilter(course.model, *course.bounds, **moving, **options)
        return track(kalman, course.u, q0, rate_hz=RATE_HZ, mask=course.working)
    particle_filter = ParticleFilter(
        course.model,
        tuned.share * width,
        tuned.inflation * course.noise_mt,
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
    whole = begin(course, method)
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


def begin(course: Course, method: ParticleFilter) -> ParticleState:
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


TUNED: dict[tuple[int, float, str], Tuned] = {
    (1, NOISE_MT[0], "random walk"): Tuned(0.005, 1.0),
    (1, NOISE_MT[0], "constant velocity"): Tuned(0.0005, 1.0),
    (1, NOISE_MT[0], "Kalman filter"): Tuned(0.05),
    (1, NOISE_MT[1], "random walk"): Tuned(0.01, 1.0),
    (1, NOISE_MT[1], "constant velocity"): Tuned(0.002, 1.0),
    (1, NOISE_MT[1], "Kalman filter"): Tuned(0.02),
    (2, NOISE_MT[0], "random walk"): Tuned(0.01, 3.0),
    (2, NOISE_MT[0], "constant velocity"): Tuned(0.0005, 1.0),
    (2, NOISE_MT[0], "Kalman filter"): Tuned(0.05),
    (2, NOISE_MT[1], "random walk"): Tuned(0.01, 1.0),
    (2, NOISE_MT[1], "constant velocity"): Tuned(0.005, 1.0),
    (2, NOISE_MT[1], "Kalman filter"): Tuned(0.02),
    (3, NOISE_MT[0], "random walk"): Tuned(0.01, 3.0),
    (3, NOISE_MT[0], "constant velocity"): Tuned(0.0005, 1.0),
    (3, NOISE_MT[0], "Kalman filter"): Tuned(0.05),
    (3, NOISE_MT[1], "random walk"): Tuned(0.02, 1.0),
    (3, NOISE_MT[1], "constant velocity"): Tuned(0.002, 1.0),
    (3, NOISE_MT[1], "Kalman filter"): Tuned(0.02),
}
"""Choices by robot, noise and method: the least error of the tip on T2 (:func:`tuning`)."""


def chosen(course: Course, method: str) -> Tuned:
    """Choice of :data:`TUNED` for a course.

    Raises
    ------
    InputError
        If there is none.
    """
    key = (course.n_segments, course.noise_mt, method.removesuffix(" + Gauss-Newton"))
    if key not in TUNED:
        known = f"one of {', '.join(map(repr, METHODS))}, at a noise of {NOISE_MT[0]} or {NOISE_MT[1]} mT"
        raise bad_input("method", "mitchell2021_segments", known, f"{method!r} at {course.noise_mt} mT")
    return TUNED[key]


def tuning(
    n_segments: int,
    noise_mt: float,
    method: str,
    candidates: Sequence[Tuned],
    *,
    draws: int = 4,
    steps: int = 50,
) -> pd.DataFrame:
    """Errors of the tip for choices, on a part of the half lemniscate T2 from 1 s on, with noise of its own.

    Columns: ``share``, ``inflation``, ``tip_mm`` (RMSE over steps and draws).

    Parameters
    ----------
    n_segments, noise_mt, draws, steps
        As for :class:`~repro_companion.pages.filter_on_segments.courses.Course`.
    method
        One of ``METHODS`` that takes choices.
    candidates
        What to try.
    """
    course = Course(n_segments, noise_mt=noise_mt, draws=draws, first=40, steps=steps, half=True)
    tips = course.robot.base_poses(course.q)[BEGUN:, None, -1, :3, 3]
    rows = []
    for tuned in candidates:
        found = course.robot.base_poses(run(course, method, tuned).q[BEGUN - steps :])[..., -1, :3, 3]
        error = float((found - tips).square().sum(-1).mean().sqrt())
        rows.append({"share": tuned.share, "inflation": tuned.inflation, "tip_mm": 1e3 * error})
    return pd.DataFrame(rows)
