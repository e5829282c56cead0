"""The particle filter on several segments as tidy tables: errors and calibration, and what is left of two modes."""

from __future__ import annotations

import math
from collections.abc import Sequence

import pandas as pd
import torch
from edition1.estimation.base import Trajectory
from edition1.estimation.multistart import search, starts_within
from jaxtyping import Float
from scipy.stats import chi2
from torch import Tensor

from edition1_companion.book.bootstrap import interval, ratio_interval, resampled
from edition1_companion.pages.filter_on_segments.methods import (
    BEGUN,
    COLD_ITERATIONS,
    METHODS,
    NOISE_MT,
    Course,
    run,
)
from edition1_companion.twins.trajectories import RATE_HZ

REFERENCE = "least squares, last estimate"
"""Ratios of errors are relative to this method."""
BENT_OUT = 4
"""Coordinate that the failure makes ambiguous: bending of the second segment along y."""
FAILED = (6, 8)
"""Sensors of the second segment at +y and -y; those that stay read alike for a bend along y and its mirror image."""
STARTS = 16
"""Starts of the search for all minima."""
CLEAR_MM = 5.0
"""Least bending of the truth [mm] after the failure to count."""
BOTH = 0.05
"""A cloud has two modes if each holds at least this share of the particles."""


def mirrored(noise_mt: float, draws: int = 10, steps: int = 80) -> Course:
    """Course around t = 5 s, half of it before, where both segments are straight; sensors fail a quarter into it."""
    first = 200 - steps // 2
    return Course(
        2, noise_mt=noise_mt, draws=draws, first=first, steps=steps, failed=FAILED, failure=steps // 4
    )


def calibration(q: Float[Tensor, "*truth n_q"], found: Trajectory) -> Float[Tensor, "*batch"]:
    r"""Squared errors in units of the reported covariance, :math:`e^T C^{-1} e`: chi-square if it is right.

    Parameters
    ----------
    q
        True configurations.
    found
        Estimates with a covariance. A cloud of few particles has no full rank: every direction gets at least the
        variance of 1 micrometre.
    """
    assert found.covariance is not None
    C = found.covariance + 1e-12 * torch.eye(q.shape[-1], dtype=q.dtype)
    e = (found.q - q).unsqueeze(-1)
    return (e * torch.linalg.solve(C, e)).sum((-1, -2))


def tracking(
    segments: Sequence[int] = (1, 2, 3),
    noise_mt: Sequence[float] = NOISE_MT,
    *,
    draws: int = 10,
    steps: int = 40,
    particles: int = 300,
) -> pd.DataFrame:
    """Errors from the start of T3 on, with all sensors: one row per robot, noise, method and draw.

    Columns: ``n_b``, ``n_s``, ``noise_mt``, ``method``, ``draw``; ``error_percent``, relative RMSE of eq. (13) of
    Baaij et al. 2023 in per cent of the ranges on the whole trajectory, mean over the coordinates; ``tip_mm``, RMSE
    of the tip; ``calibration``, median over the steps of the squared error in units of the covariance and per
    coordinate (0.8 to 0.9 if it is right); ``covered_percent``, steps whose 95 % ellipsoid contains the truth;
    ``effective_sample_size``; ``evaluations`` of the sensor model per step.

    Parameters
    ----------
    segments, noise_mt
        Robots, and noise of the readings [mT].
    draws, steps
        As for :class:`~edition1_companion.pages.filter_on_segments.methods.Course`.
    particles
        Of the particle filters.
    """
    rows = []
    for n in segments:
        for noise in noise_mt:
            course = Course(n, noise, draws, steps=steps)
            for method in METHODS:
                found = _scored(run(course, method, particles=particles), course)
                key = {"n_b": n, "n_s": len(course.robot.sensors), "noise_mt": noise, "method": method}
                columns = errors_by_draw(course, found)
                columns["evaluations"] = _evaluations(found, particles, course.robot.n_q, method)
                values = {name: x.tolist() for name, x in columns.items()}
                rows.append(pd.DataFrame({**key, "draw": range(draws), **values}))
    return pd.concat(rows, ignore_index=True)


def errors_by_draw(course: Course, found: Trajectory) -> dict[str, Tensor]:
    """Columns of :func:`tracking` of one run, one number per draw each."""
    q = course.q[-len(found.q) :].unsqueeze(1)
    span = course.whole.amax(0) - course.whole.amin(0)
    squared = calibration(q, found)
    n_q = q.shape[-1]
    ess = found.diagnostics.get("effective_sample_size", torch.full_like(squared, math.nan))
    return {
        "error_percent": 100 * ((found.q - q) / span).square().mean(0).sqrt().mean(-1),
        "tip_mm": tip_errors_mm(course, found).square().mean(0).sqrt(),
        "calibration": squared.quantile(0.5, dim=0) / n_q,
        "covered_percent": 100 * (squared < chi2.ppf(0.95, n_q)).double().mean(0),
        "effective_sample_size": ess.mean(0),
    }


def tip_errors_mm(course: Course, found: Trajectory) -> Float[Tensor, "t draws"]:
    """Distances of the estimated from the true tip [mm]."""
    tips = [course.robot.base_poses(q)[..., -1, :3, 3] for q in (found.q, course.q[-len(found.q) :])]
    return 1e3 * torch.linalg.vector_norm(tips[0] - tips[1].unsqueeze(1), dim=-1)


def _scored(found: Trajectory, course: Course) -> Trajectory:
    """All methods over the same steps: those after the start of the particle filters."""
    n = course.steps - BEGUN
    assert found.covariance is not None
    diagnostics = {k: x[-n:] for k, x in found.diagnostics.items()}
    return Trajectory(found.q[-n:], found.covariance[-n:], found.u_hat[-n:], diagnostics)


def _evaluations(found: Trajectory, particles: int, n_q: int, method: str) -> Tensor:
    if "iterations" in found.diagnostics:
        return 1 + found.diagnostics["iterations"].double().mean(0)
    step = 2 * n_q + 1 if method.endswith("Gauss-Newton") else 0
    return torch.full(found.q.shape[1:2], float(particles + 1 + step))


def mean_errors(table: pd.DataFrame) -> pd.DataFrame:
    """Means over draws, and the error of the tip relative to least squares with a paired bootstrap interval (95 %).

    Columns: ``n_b``, ``n_s``, ``noise_mt``, ``method``, means of the columns of :func:`tracking`, ``tip_mm_low`` and
    ``tip_mm_high``; ``ratio`` to :data:`REFERENCE` with ``ratio_low`` and ``ratio_high``.

    Parameters
    ----------
    table
        From :func:`tracking`.
    """
    keys, lines = ["n_b", "n_s", "noise_mt"], []
    for key, part in table.groupby(keys, sort=False):
        tips = part.pivot(index="draw", columns="method", values="tip_mm")
        index = resampled(len(tips), 0)
        reference = tips[REFERENCE].to_numpy()
        for method, rows in part.groupby("method", sort=False):
            tip = tips[method].to_numpy()
            means = rows.drop(columns=[*keys, "method", "draw"]).mean()
            low, high = interval(tip[index].mean(1))
            line = {**dict(zip(keys, key, strict=True)), "method": method, **means}
            line |= {"tip_mm_low": low, "tip_mm_high": high, "ratio": tip.mean() / reference.mean()}
            line["ratio_low"], line["ratio_high"] = ratio_interval(tip, reference, index)
            lines.append(line)
    return pd.DataFrame(lines)


def two_modes(
    noise_mt: Sequence[float] = NOISE_MT, *, draws: int = 10, steps: int = 80, particles: int = 300
) -> pd.DataFrame:
    """Bending along y of the segment that loses two sensors, where it passes through zero; one row per step.

    Columns: ``noise_mt``, ``method``, ``draw``, ``time_s``, ``failed``, ``true_mm``, ``found_mm``, ``tip_mm``;
    ``share``, of the cloud that bends to the true side; ``covered``, 1 where the 95 % ellipsoid contains the truth
    and 0 elsewhere. A method ``"search"`` has only ``minima``: how many configurations the readings of that step do
    not exclude.

    Parameters
    ----------
    noise_mt, draws, steps
        As for :func:`mirrored`.
    particles
        Of the particle filters.
    """
    tables = []
    for noise in noise_mt:
        course = mirrored(noise, draws, steps)
        q = course.q[BEGUN:]
        for method in METHODS:
            found = _scored(run(course, method, particles=particles), course)
            columns = {
                "found_mm": 1e3 * found.q[..., BENT_OUT],
                "tip_mm": tip_errors_mm(course, found),
                "covered": (calibration(q.unsqueeze(1), found) < chi2.ppf(0.95, q.shape[-1])).double(),
            }
            if "positive" in found.diagnostics:
                positive = found.diagnostics["positive"][..., BENT_OUT]
                columns["share"] = torch.where(q[:, BENT_OUT, None] > 0, positive, 1 - positive)
            tables.append(_course_table(course, method, columns))
        starts = starts_within(*course.bounds, STARTS, seed=0)
        mask = course.working[BEGUN:].unsqueeze(1)
        minima = search(course.least_squares(COLD_ITERATIONS), course.u[BEGUN:], starts, mask=mask)
        tables.append(_course_table(course, "search", {"minima": minima.count}))
    return pd.concat(tables, ignore_index=True)


def _course_table(course: Course, method: str, columns: dict[str, Tensor]) -> pd.DataFrame:
    """Columns ``[t, draws]`` of a method as rows, with the truth beside them."""
    shape = (course.steps - BEGUN, course.draws)
    given = {
        "time_s": ((course.first + torch.arange(BEGUN, course.steps)) / RATE_HZ).unsqueeze(1),
        "failed": ~course.working[BEGUN:].all(-1, keepdim=True),
        "true_mm": 1e3 * course.q[BEGUN:, BENT_OUT, None],
        "draw": torch.arange(course.draws),
    }
    flat = {k: x.expand(shape).flatten().tolist() for k, x in (given | columns).items()}
    return pd.DataFrame({"noise_mt": course.noise_mt, "method": method, **flat})


def kept_modes(table: pd.DataFrame) -> pd.DataFrame:
    """What is kept after the segment has passed through the plane of its two sensors, where it is clearly bent again.

    Columns: ``noise_mt``, ``method``, ``true_side_percent`` (of draws and steps: estimates on the true side),
    ``always_percent`` (draws that are on it at every step), ``tip_mm`` (RMSE), ``covered_percent``,
    ``true_share_percent`` (of the particles), ``both_percent`` (clouds with two modes), ``minima`` (mean number).

    Parameters
    ----------
    table
        From :func:`two_modes`.
    """
    late = table[table["failed"] & (table["time_s"] > 5.0) & (table["true_mm"].abs() >= CLEAR_MM)]
    lines = []
    for key, part in late.groupby(["noise_mt", "method"], sort=False):
        line: dict[str, object] = dict(zip(("noise_mt", "method"), key, strict=True))
        if line["method"] == "search":
            lines.append({**line, "minima": part["minima"].mean()})
            continue
        right = part["found_mm"] * part["true_mm"] > 0
        line |= {
            "true_side_percent": 100 * right.mean(),
            "always_percent": 100 * right.groupby(part["draw"]).all().mean(),
            "tip_mm": math.sqrt((part["tip_mm"] ** 2).mean()),
            "covered_percent": 100 * part["covered"].mean(),
        }
        if bool(part["share"].notna().all()):
            line["true_share_percent"] = 100 * part["share"].mean()
            line["both_percent"] = 100 * part["share"].between(BOTH, 1 - BOTH).mean()
        lines.append(line)
    return pd.DataFrame(lines)
