"""What the last readings say about the next ones: the iterated Kalman filter on simulated trajectories.

The process noise is chosen on the half lemniscate T2 and frozen; it is judged on the others. Readings come from
magpylib with noise; both methods have the multipole model of the robot as drawn, and neither knows where it starts.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import pandas as pd
import torch
from edition1.estimation.base import Trajectory, track
from edition1.estimation.kalman_filter import IteratedKalmanFilter
from edition1.estimation.levenberg_marquardt import LevenbergMarquardt
from edition1.estimation.multistart import search, starts_within
from edition1.kernels import compiled
from edition1.kinematics.paper_robots import affine_robot, pcc_robot
from edition1.sensing.linearised import LinearisedSensing
from edition1.sensing.magnetic import readings
from edition1.sensing.magnets import ring
from jaxtyping import Float
from scipy.stats import chi2
from torch import Tensor

from edition1_companion.book.bootstrap import ratio_of_means, resampled
from edition1_companion.twins.calibrated_robots import (
    VELOCITY_SHARE,
    box,
    least_squares,
    standard_normal,
    start,
)
from edition1_companion.twins.calibration_session import released_moments
from edition1_companion.twins.trajectories import RATE_HZ, STEPS, TRAJECTORIES, flower, lemniscate, trajectory

NOISE_MT = 5e-3
"""Noise of a reading [mT]: seven times the larger one of the real sensors, where the prior matters most."""
METHODS = ("Levenberg-Marquardt", "Kalman filter")
SHARE = {1: 0.1, 3: 0.1}
"""Process noise by number of segments, in widths of the box per s^1.5: of 0.02, 0.05, 0.1, 0.2, 0.5 and 1 those with
the best score on T2, as a test finds again."""
ITERATIONS = 8
STARTS = 40
"""Of the search for configurations that explain the same readings."""


def noisy_readings(
    q: Float[Tensor, "t n_q"], n_segments: int, seeds: Sequence[int], noise_mt: float
) -> Float[Tensor, "t seeds s"]:
    """Readings by magpylib, with noise of its own for every seed."""
    u = readings(pcc_robot(n_segments), q, ring("released"))
    return (u + noise_mt * standard_normal(u.shape, seeds)).movedim(0, 1)


def estimates(
    method: str,
    u: Float[Tensor, "t seeds s"],
    n_segments: int,
    noise_mt: float,
    *,
    share: float | None = None,
) -> Trajectory:
    """Estimates from the straight pose at mid elongation: at every step anew, or carried over by the filter.

    Parameters
    ----------
    method
        One of :data:`METHODS`.
    u
        Readings.
    n_segments
        Number of segments.
    noise_mt
        Noise of a reading, which both methods know.
    share
        Process noise of the filter; that of :data:`SHARE` when not given.
    """
    sensing = compiled(LinearisedSensing(pcc_robot(n_segments), released_moments()))
    if method == METHODS[0]:
        found = least_squares(sensing, u, n_segments, noise_mt=noise_mt, iterations=2 * ITERATIONS)
        return Trajectory(found.q, found.covariance, found.u_hat, found.diagnostics)
    low, high = box(n_segments)
    share = SHARE[n_segments] if share is None else share
    width = high - low
    moving = {"acceleration": share * width, "velocity": VELOCITY_SHARE * width}
    kalman = IteratedKalmanFilter(sensing, low, high, **moving, noise_mt=noise_mt, iterations=ITERATIONS)
    return track(kalman, u, start(n_segments).expand(u.shape[1], -1), rate_hz=RATE_HZ)


def errors_by_draw(
    n_segments: int,
    names: Sequence[str] = TRAJECTORIES,
    seeds: Sequence[int] = tuple(range(10)),
    *,
    noise_mt: float = NOISE_MT,
    share: float | None = None,
    steps: int = STEPS,
) -> pd.DataFrame:
    r"""Errors and calibration of both methods, one row per trajectory, method and seed.

    Columns: ``n_b, trajectory, method, seed``; ``error_percent``, the mean over the coordinates of the
    root-mean-squared error in per cent of the range of T3, there eq. (13); ``covered_percent``, how often the
    95 % ellipsoid contains the truth; ``nees``, the normalised squared error :math:`e^T C^{-1} e/n_q`, 1 on average
    if the covariance is right; ``score``, the mean negative logarithm of the density at the truth, which counts
    accuracy and calibration.

    Parameters
    ----------
    n_segments, names, seeds, noise_mt, share, steps
        Robot, trajectories, draws of the noise, its size, process noise and number of steps.
    """
    lines = []
    full = lemniscate(n_segments)
    span = full.amax(0) - full.amin(0)
    for name in names:
        q = trajectory(name, n_segments, steps=steps)
        u = noisy_readings(q, n_segments, seeds, noise_mt)
        for method in METHODS:
            found = estimates(method, u, n_segments, noise_mt, share=share)
            error = (found.q - q.unsqueeze(1)).unsqueeze(-1)
            assert found.covariance is not None
            distance = (error.mT @ torch.linalg.solve(found.covariance, error)).squeeze(-1).squeeze(-1)
            n_q = q.shape[-1]
            size = torch.linalg.slogdet(2 * math.pi * found.covariance / span / span.unsqueeze(-1)).logabsdet
            percent = 100 * (error.squeeze(-1).square().mean(0).sqrt() / span).mean(-1)
            for k, seed in enumerate(seeds):
                lines.append(
                    {
                        "n_b": n_segments,
                        "trajectory": name,
                        "method": method,
                        "seed": seed,
                        "error_percent": float(percent[k]),
                        "covered_percent": 100
                        * float((distance[:, k] <= chi2.ppf(0.95, n_q)).double().mean()),
                        "nees": float(distance[:, k].mean()) / n_q,
                        "score": float((distance + size)[:, k].mean()) / 2,
                    }
                )
    return pd.DataFrame(lines)


def filter_to_least_squares(table: pd.DataFrame, *, seed: int = 0) -> pd.DataFrame:
    """Filter beside least squares, by robot and trajectory: means, and the ratio of errors with its 95 % interval.

    The interval is a paired bootstrap over the draws of the noise. Columns: ``n_b, trajectory, chosen_here``,
    ``lm_percent, filter_percent, ratio, ratio_low, ratio_high``, ``lm_covered_percent, filter_covered_percent``,
    ``lm_nees, filter_nees``.

    Parameters
    ----------
    table
        Of :func:`errors_by_draw`.
    seed
        Of the bootstrap.
    """
    rng, lines = np.random.default_rng(seed), []
    for (n_b, name), part in table.groupby(["n_b", "trajectory"], sort=False):
        by = part.pivot_table(
            index="seed", columns="method", values=["error_percent", "covered_percent", "nees"]
        )
        alone, kalman = (by["error_percent"][method].to_numpy() for method in METHODS)
        line = {"n_b": n_b, "trajectory": name, "chosen_here": name == "T2"}
        line |= {"lm_percent": alone.mean(), "filter_percent": kalman.mean()}
        line |= ratio_of_means(kalman, alone, resampled(len(alone), rng))
        lines.append(
            line
            | {
                "lm_covered_percent": by["covered_percent"][METHODS[0]].mean(),
                "filter_covered_percent": by["covered_percent"][METHODS[1]].mean(),
                "lm_nees": by["nees"][METHODS[0]].mean(),
                "filter_nees": by["nees"][METHODS[1]].mean(),
            }
        )
    return pd.DataFrame(lines)


def minima_by_robot(noise_mt: float = 7.1e-4, *, seed: int = 0) -> pd.DataFrame:
    """Minima that the readings do not exclude, found by a search from many starts, for three robots.

    The affine segment has an exact ambiguity: both curvatures negated and the azimuth turned by half a turn are the
    same shape. Two sensors per segment do not tell a robot from its mirror image in their plane. Columns: ``robot,
    minima, furthest_mm`` (largest distance between the tips of two of them).

    Parameters
    ----------
    noise_mt
        Noise of a reading.
    seed
        Of noise and starts.
    """
    generator, lines = torch.Generator().manual_seed(seed), []
    half_turn = torch.tensor([1.2, 4.5, math.pi, 6.6e-3], dtype=torch.float64)
    affine = (torch.tensor([-1.2, -4.5, -math.pi, 0.0], dtype=torch.float64), half_turn)
    cases = (
        ("three sensors, constant curvature", pcc_robot(1), box(1), lemniscate(1)[40]),
        ("two sensors, constant curvature", pcc_robot(1, 2), box(1), lemniscate(1)[40]),
        ("nine sensors, affine curvature", affine_robot(), affine, flower()[40]),
    )
    for name, robot, (low, high), q in cases:
        u = readings(robot, q, ring("released"))
        u = u + noise_mt * torch.randn(u.shape, generator=generator, dtype=u.dtype)
        sensing = LinearisedSensing(robot, released_moments())
        method = LevenbergMarquardt(compiled(sensing), low, high, noise_mt=noise_mt, iterations=50)
        found = search(method, u, starts_within(low, high, STARTS, seed=seed))
        tips = 1e3 * robot.tip(found.q[found.candidate])[:, :3, 3]
        lines.append((name, int(found.count), float(torch.cdist(tips, tips).max())))
    return pd.DataFrame(lines, columns=["robot", "minima", "furthest_mm"])
