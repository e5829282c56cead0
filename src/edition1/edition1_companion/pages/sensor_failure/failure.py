"""Sensor failure (Baaij et al. 2023, Figs 4b and 5): three of twelve sensors are lost half way along the lemniscate.

Every estimate is made twice from the same readings, with the failure and with all sensors to the end. The second half
of the trajectory has other shapes than the first, so the two runs over the same steps tell what the failure does;
before against after mixes that with the shapes.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from edition1.errors import bad_input, require
from edition1.estimation.base import track
from edition1.estimation.gradient_descent import GradientDescent
from edition1.estimation.levenberg_marquardt import LevenbergMarquardt
from edition1.kernels import compiled
from edition1.sensing.magnetic import MagneticSensing, readings
from edition1.sensing.magnets import ring
from edition1_companion.twins.calibrated_robots import box, calibration, session, start
from edition1_companion.twins.calibration_session import SENSOR_NOISE_MT, Config
from edition1_companion.twins.table_1_method import ITERATIONS, MOMENTUM, available, networks, step_sizes
from edition1_companion.twins.table_1_rows import Row, rows_named
from edition1_companion.twins.trajectories import RATE_HZ, STEPS, lemniscate

ROW: Row = rows_named(["n_s=12"])[0]
"""The robot: three segments with four sensors each."""
RUNS = ("all sensors", "failure")
"""The two runs over the same readings, in the order of the dimension ``runs``."""
DURATION_S = STEPS / RATE_HZ


@dataclass(frozen=True)
class Failure:
    """Sensors that fail at some time, and are masked from then on.

    Parameters
    ----------
    sensors
        Their numbers from 1 to 12, base to tip, as in the paper: 1 to 4 are those of the first segment.
    time_s
        First time without them [s].

    Raises
    ------
    InputError
        If there is no such sensor, one is given twice, none is left, or nothing is left before or after the time.
    """

    sensors: Sequence[int] = (4, 8, 12)
    time_s: float = 5.0

    def __post_init__(self) -> None:
        n = len(ROW.robot().sensors)
        given = list(self.sensors)
        if not set(given) <= set(range(1, n + 1)) or len(set(given)) < len(given):
            raise bad_input("sensors", "Failure", f"numbers from 1 to {n}, each once", given)
        require(len(given) != n, "sensors", "Failure", f"fewer than all {n} sensors", given)
        if not 0 < self.time_s < DURATION_S:
            raise bad_input(
                "time_s", "Failure", f"within the {DURATION_S:g} s of the trajectory", self.time_s
            )

    def after(self, steps: int = STEPS) -> Bool[Tensor, " t"]:
        """Which time steps come with or after the failure.

        Raises
        ------
        InputError
            If these are none, or all.
        """
        after = times(steps) >= self.time_s - 1e-9
        if bool(after.all()) or not bool(after.any()):
            raise bad_input("time_s", "Failure", "between two time steps", self.time_s)
        return after

    def working(self, steps: int = STEPS) -> Bool[Tensor, "t runs s"]:
        """Which sensors are in use in each of :data:`RUNS`."""
        failed = torch.zeros(len(ROW.robot().sensors), dtype=torch.bool)
        failed[[k - 1 for k in self.sensors]] = True
        masked = self.after(steps).unsqueeze(-1) & failed
        return torch.stack([torch.ones_like(masked), ~masked], dim=1)


def times(steps: int = STEPS) -> Float[Tensor, " t"]:
    """Times [s] of the steps, when the trajectory of 10 s has so many."""
    return torch.arange(steps, dtype=torch.float64) * (DURATION_S / steps)


@dataclass(frozen=True)
class Estimates:
    """Estimates along T3 in each of :data:`RUNS`, by several members: seeds of networks, or draws of robots.

    Parameters
    ----------
    q
        True configurations [m].
    u
        True readings [mT], of the failed sensors too.
    q_hat, u_hat
        Estimated configurations [m] and the readings predicted there [mT].
    deviation
        Standard deviations that the estimator reports [m]; none for gradient descent.
    """

    q: Float[Tensor, "t n_q"]
    u: Float[Tensor, "t members s"]
    q_hat: Float[Tensor, "t members runs n_q"]
    u_hat: Float[Tensor, "t members runs s"]
    deviation: Float[Tensor, "t members runs n_q"] | None = None


def paper_method(failure: Failure, seeds: Sequence[int], folder: Path, *, steps: int = STEPS) -> Estimates:
    """Gradient descent as in section 3.3 on the networks of several seeds; it starts at the ground truth.

    Readings are free of noise, and momentum is carried from one time step to the next, as in the paper's runs.

    Parameters
    ----------
    failure
        What fails.
    seeds
        Seeds of the networks.
    folder
        Where their weights are.
    steps
        Time steps of the trajectory.

    Raises
    ------
    InputError
        If there is no seed, or a network is missing.
    """
    if not seeds or not available([ROW], folder, seeds):
        raise bad_input("seeds", "paper_method", "seeds whose networks are trained", list(seeds))
    robot, q = ROW.robot(), lemniscate(ROW.n_segments, steps=steps)
    sensing = MagneticSensing(robot, networks([ROW], folder, seeds), "angles")
    method = GradientDescent(compiled(sensing), step_sizes(ROW.n_segments), MOMENTUM, ITERATIONS)
    u = readings(robot, q, ring("released")).unsqueeze(1).expand(-1, len(seeds), -1)
    batch = (len(seeds), len(RUNS))
    found = track(
        method,
        u.unsqueeze(2).expand(-1, *batch, -1),
        q[0].expand(*batch, -1),
        rate_hz=steps / DURATION_S,
        mask=failure.working(steps).unsqueeze(1),
    )
    return Estimates(q, u, found.q, found.u_hat)


def calibrated_method(
    failure: Failure, *, noise_mt: float = SENSOR_NOISE_MT, draws: int = 10, steps: int = STEPS
) -> Estimates:
    """Multipole model with Levenberg-Marquardt, on robots that are not as drawn and noisy readings.

    Robots, tolerances and calibration in 100 measured poses are those of
    :mod:`~edition1_companion.twins.calibrated_robots`, and so is the start: straight with mid elongation, at every
    time step anew. No true coordinate enters.

    Parameters
    ----------
    failure
        What fails.
    noise_mt
        Standard deviation of the noise of every sensor along the trajectory [mT], known to the estimator.
    draws
        Robots, each with its own calibration and noise; the first ones do not depend on how many there are.
    steps
        Time steps of the trajectory.
    """
    config = Config(draws=draws)
    measured = session(ROW, config)
    sensing = calibration(ROW, measured, config).sensing()
    q = lemniscate(ROW.n_segments, steps=steps)
    clean = readings(measured.true_robot, q.unsqueeze(1), ring("released"))
    generators = [torch.Generator().manual_seed(1_000_000 + draw) for draw in range(draws)]
    noise = [torch.randn(clean[:, 0].shape, generator=g, dtype=torch.float64) for g in generators]
    u = clean + noise_mt * torch.stack(noise, dim=1)
    method = LevenbergMarquardt(
        compiled(sensing), *box(ROW.n_segments), noise_mt=noise_mt, iterations=config.iterations
    )
    batch = (steps, len(RUNS), draws)  # draws last: the batch of the calibrated robots
    state = method.init(start(ROW.n_segments).expand(*batch, -1))
    found = method.step(
        state, u.unsqueeze(1).expand(*batch, -1), 0.0, mask=failure.working(steps).unsqueeze(2)
    )[1]
    assert found.covariance is not None
    deviation = found.covariance.diagonal(dim1=-2, dim2=-1).sqrt()
    return Estimates(q, clean, found.q.movedim(1, 2), found.u_hat.movedim(1, 2), deviation.movedim(1, 2))
