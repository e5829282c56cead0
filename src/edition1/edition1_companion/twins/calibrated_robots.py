"""Robots of Baaij et al. 2023 that are not as drawn: calibration in measured poses, estimates from the straight pose.

Frozen before any figure on the lemniscate T3 was taken; what could be chosen was chosen on the half lemniscate T2.
Readings come from magpylib and the true robot; the estimator knows the drawing, its tolerances and, if calibrated,
readings in measured poses. Nothing starts at, or holds, a true coordinate of the trajectory.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import pandas as pd
import torch
from jaxtyping import Float
from torch import Tensor

from edition1.estimation.base import Estimate
from edition1.estimation.calibration import Calibration, calibrate
from edition1.estimation.levenberg_marquardt import LevenbergMarquardt
from edition1.estimation.poses import configurations
from edition1_companion.twins.calibration_session import (
    SENSOR_NOISE_MT,
    Config,
    Session,
    draw_session,
    released_moments,
)
from edition1_companion.twins.table_1_rows import Row
from edition1_companion.twins.training_set import BENDING_M, ELONGATION_M
from edition1_companion.twins.trajectories import lemniscate

VELOCITY_SHARE = 0.5
"""Standard deviation of a velocity before the first reading, in widths of the box per second."""


def box(n_segments: int) -> tuple[Float[Tensor, " n_q"], Float[Tensor, " n_q"]]:
    """Bounds of the training box [m]: bending of 20.73 mm either way, elongation from 0 to 6.6 mm."""
    high = torch.tensor([BENDING_M, BENDING_M, ELONGATION_M["released"]] * n_segments, dtype=torch.float64)
    low = torch.tensor([-BENDING_M, -BENDING_M, 0.0] * n_segments, dtype=torch.float64)
    return low, high


def start(n_segments: int) -> Float[Tensor, " n_q"]:
    """Return the straight pose at mid elongation, (0, 0, 2.75 mm) for every segment."""
    return torch.tensor([0.0, 0.0, 2.75e-3] * n_segments, dtype=torch.float64)


def least_squares(
    sensing: Callable[[Tensor], Tensor],
    u: Float[Tensor, "*batch s"],
    n_segments: int,
    *,
    noise_mt: float = 1.0,
    iterations: int = 30,
) -> Estimate:
    """Levenberg-Marquardt within the training box, for each of the readings from the straight pose."""
    method = LevenbergMarquardt(sensing, *box(n_segments), noise_mt=noise_mt, iterations=iterations)
    return method.step(method.init(start(n_segments).expand(*u.shape[:-1], -1)), u, 0.0)[1]


def session(row: Row, config: Config) -> Session:
    """Draws of a row of Table 1: see :func:`draw_session`."""
    q = lemniscate(row.n_segments, half=config.half)
    return draw_session(row.robot(), q, box(row.n_segments), config, earth_mt=row.earth_mt())


def calibration(row: Row, measured: Session, config: Config) -> Calibration:
    """Calibrate all draws of a row from their measured poses and readings."""
    robot = row.robot()
    q, covariance = configurations(
        robot, measured.poses, position_m=config.position_m, rotation_rad=config.rotation_rad
    )
    return calibrate(
        robot,
        q,
        covariance,
        measured.pose_readings,
        released_moments(),
        noise_mt=SENSOR_NOISE_MT,
        earth_mt=row.earth_mt(),
    )


def relative_error(
    found: Float[Tensor, "t *batch n_q"], truth: Float[Tensor, "t n_q"]
) -> Float[Tensor, "*batch n_q"]:
    """Relative RMSE over time, eq. (13): in per cent of the range of the truth."""
    width = truth.amax(0) - truth.amin(0)
    truth = truth.reshape(len(truth), *(1,) * (found.ndim - 2), -1)
    return 100 * (found - truth).square().mean(0).sqrt() / width


def table_of_draws(error: Float[Tensor, "draws n"], quantities: Sequence[str]) -> pd.DataFrame:
    """Errors in long form: columns ``draw, quantity, error_percent``."""
    table = pd.DataFrame(error.numpy(), columns=list(quantities)).rename_axis("draw").reset_index()
    return table.melt("draw", var_name="quantity", value_name="error_percent")


def from_best_start(
    sensing: Callable[[Tensor], Tensor],
    box: tuple[Float[Tensor, " n_q"], Float[Tensor, " n_q"]],
    starts: Float[Tensor, "starts n_q"],
    u: Float[Tensor, "*batch s"],
    iterations: tuple[int, int],
    *,
    noise_mt: float,
    known: Float[Tensor, "*batch n_q"] | None = None,
) -> Float[Tensor, "*batch n_q"]:
    """Levenberg-Marquardt: a few iterations from every start, then the one with the least residual to the end.

    Parameters
    ----------
    sensing, box, starts
        Sensor model, bounds of the configuration, and where to start.
    u
        Readings [mT].
    iterations
        From every start, and of the best of them.
    noise_mt
        Noise of a reading [mT].
    known
        Coordinates that are held, not a number where they are not.
    """
    first, last = (LevenbergMarquardt(sensing, *box, noise_mt=noise_mt, iterations=n) for n in iterations)
    fits = [first.step(first.init(q0.expand(*u.shape[:-1], -1)), u, 0.0, known=known)[1] for q0 in starts]
    best = torch.stack([fit.diagnostics["rmse"] for fit in fits]).argmin(0)
    found = torch.stack([fit.q for fit in fits])
    found = found.gather(0, best[None, ..., None].expand(1, *found.shape[1:])).squeeze(0)
    return last.step(last.init(found), u, 0.0, known=known)[1].q
