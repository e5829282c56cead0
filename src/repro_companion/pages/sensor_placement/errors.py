"""Layouts judged by what an estimator makes of their readings: other shapes, another field, noise and tolerances."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import pandas as pd
import torch
from jaxtyping import Float
from torch import Tensor

from repro.errors import bad_input
from repro.estimation.levenberg_marquardt import LevenbergMarquardt
from repro.kinematics.affine_curvature import AffineCurvature
from repro.kinematics.robot import Robot
from repro.kinematics.trajectories import RATE_HZ, STEPS
from repro.sensing.linearised import LinearisedSensing
from repro.sensing.magnetic import readings
from repro.sensing.magnets import ring
from repro.sensing.placement import Tolerances, placed
from repro_companion.book.bootstrap import ratio_interval, resampled
from repro_companion.pages.sensor_placement.bounds import NOISE_MT, expected_errors, ring_moments
from repro_companion.pages.sensor_placement.layouts import Layout
from repro_companion.pages.sensor_placement.tasks import TEST_SEED, Task

FIRST, LAST = 4, 10
"""Iterations from every start, and those of the best of them."""
ROBOTS = ("as drawn", "within tolerances")
"""Robots to which a layout is put: exactly as drawn, or off by normal draws of
:class:`~repro.sensing.placement.Tolerances` and not calibrated."""


def measured_errors(
    task: Task,
    layouts: Mapping[str, Layout],
    *,
    draws: int = 10,
    noise_mt: float = NOISE_MT,
    seed: int = 0,
    tolerances: Tolerances | None = None,
) -> pd.DataFrame:
    """Relative errors, eq. (13), on the held-out shapes, one line per coordinate and draw.

    Readings come from magpylib, the estimates from Levenberg-Marquardt with the multipole model of the layout as
    drawn. Every shape is estimated on its own, from the starts of the task. All layouts meet the same draws.

    Parameters
    ----------
    task
        Robot and held-out shapes.
    layouts
        Layouts of that robot by their names.
    draws
        Number of draws of the noise and of the parts.
    noise_mt
        Noise of a reading [mT].
    seed
        Of the draws.
    tolerances
        Standard deviations of the parts; the default ones when not given. Multipole moments are as drawn.

    Returns
    -------
    DataFrame
        Columns ``task``, ``layout``, ``robot`` (of :data:`ROBOTS`), ``shapes`` (name of the test), ``draw``,
        ``quantity``, ``error_percent``.

    Raises
    ------
    InputError
        If there is no draw, or a layout has another number of parts than the nominal one.
    """
    if draws < 1:
        raise bad_input("draws", "measured_errors", "at least 1", draws)
    for name, layout in layouts.items():
        if layout.values.shape != task.nominal.values.shape:
            received = f"{len(layout.values)} values in {name}"
            raise bad_input("layouts", "measured_errors", f"of {len(task.nominal.values)} values", received)
    tables = []
    for test, q in task.tests.items():
        generator = torch.Generator().manual_seed(seed + TEST_SEED)
        n_s = len(task.nominal.sensor_segment)
        spread = (tolerances or Tolerances()).of_parameters(task.nominal.robot(), len(ring_moments()))
        spread[-len(ring_moments()) :] = 0.0
        parts = spread * torch.randn(draws, len(spread), generator=generator, dtype=torch.float64)
        noise = noise_mt * torch.randn(len(q), draws, n_s, generator=generator, dtype=torch.float64)
        for name, layout in layouts.items():
            for robot, off in zip(ROBOTS, (0 * parts[:1], parts), strict=True):
                u = _readings(layout, q, off) + noise
                error = _relative_error(task, estimate(task, layout, u, q, noise_mt), q)
                table = (
                    pd.DataFrame(error.numpy(), columns=task.coordinates).rename_axis("draw").reset_index()
                )
                table = table.melt("draw", var_name="quantity", value_name="error_percent")
                tables.append(table.assign(task=task.name, layout=name, robot=robot, shapes=test))
    columns = ["task", "layout", "robot", "shapes", "draw", "quantity", "error_percent"]
    return pd.concat(tables, ignore_index=True).reindex(columns=columns)


def estimate(
    task: Task,
    layout: Layout,
    u: Float[Tensor, "t draws s"],
    q: Float[Tensor, "t n_q"],
    noise_mt: float = NOISE_MT,
) -> Float[Tensor, "t draws n_q"]:
    """Levenberg-Marquardt: a few iterations from every start, then the one with the least residual to the end.

    Parameters
    ----------
    task, layout
        Bounds, starts and known coordinates; placement as drawn.
    u
        Readings [mT].
    q
        True configurations, of which only the known coordinates are used.
    noise_mt
        Noise of a reading [mT].
    """
    sensing = LinearisedSensing(layout.robot(), ring_moments())
    known = None
    if task.known:
        known = torch.full_like(q, math.nan)
        known[:, list(task.known)] = q[:, list(task.known)]
        known = known.unsqueeze(1).expand(*u.shape[:-1], -1)
    first, last = (
        LevenbergMarquardt(sensing, task.low, task.high, noise_mt=noise_mt, iterations=n)
        for n in (FIRST, LAST)
    )
    fits = [
        first.step(first.init(q0.expand(*u.shape[:-1], -1)), u, 0.0, known=known)[1] for q0 in task.starts
    ]
    best = torch.stack([fit.diagnostics["rmse"] for fit in fits]).argmin(0)
    found = torch.stack([fit.q for fit in fits])
    found = found.gather(0, best[None, ..., None].expand(1, *found.shape[1:])).squeeze(0)
    return last.step(last.init(found), u, 0.0, known=known)[1].q


def summary(table: pd.DataFrame, *, reference: str = "nominal", seed: int = 0) -> pd.DataFrame:
    """Mean errors over coordinates and draws, beside those of one layout.

    Parameters
    ----------
    table
        Of :func:`measured_errors`.
    reference
        Layout to compare with.
    seed
        Of the bootstrap.

    Returns
    -------
    DataFrame
        A line per ``task``, ``robot``, ``shapes`` and ``layout``: ``mean_percent``, ``std_percent`` (over draws),
        ``ratio`` to the mean of the reference, and its paired bootstrap interval over draws, ``ratio_low`` and
        ``ratio_high`` (95 %).

    Raises
    ------
    InputError
        If the reference is not in the table.
    """
    lines = []
    keys = ["task", "robot", "shapes"]
    for labels in table[keys].drop_duplicates().itertuples(index=False):
        part = table[(table[keys] == list(labels)).all(axis=1)]
        by_draw = part.pivot_table(index="draw", columns="layout", values="error_percent", sort=False)
        if reference not in by_draw.columns:
            raise bad_input("reference", "summary", f"one of {list(by_draw.columns)}", reference)
        index = resampled(len(by_draw), seed)
        base = by_draw[reference].to_numpy()
        for layout in by_draw.columns:
            here = by_draw[layout].to_numpy()
            low, high = ratio_interval(here, base, index)
            spread = here.std(ddof=1) if len(here) > 1 else math.nan
            numbers = (here.mean(), spread, here.mean() / base.mean(), low, high)
            lines.append((*labels, layout, *numbers))
    names = ["layout", "mean_percent", "std_percent", "ratio", "ratio_low", "ratio_high"]
    return pd.DataFrame(lines, columns=[*keys, *names])


def bound_over_time(task: Task, layouts: Mapping[str, Layout], noise_mt: float = NOISE_MT) -> pd.DataFrame:
    """Cramér-Rao bound along the held-out trajectory, mean over coordinates.

    Columns ``layout``, ``time_s``, ``bound_percent``.
    """
    q = next(iter(task.tests.values()))
    time = np.linspace(0.0, (STEPS - 1) / RATE_HZ, len(q))
    tables = []
    for name, layout in layouts.items():
        bound = expected_errors(task, layout, q, noise_mt=noise_mt)[0].detach().mean(-1)
        tables.append(pd.DataFrame({"layout": name, "time_s": time, "bound_percent": bound.numpy()}))
    return pd.concat(tables, ignore_index=True)


def field_check(task: Task, layout: Layout) -> dict[str, float]:
    """Multipole model against magpylib on all held-out shapes of a task.

    ``closest_mm`` (sensor and magnet), ``largest_reading_mT``, ``largest_difference_mT`` (model and magpylib).
    """
    q, robot = torch.cat(list(task.tests.values())), layout.robot()
    T_m, T_s = robot.magnet_and_sensor_poses(q)
    distance = torch.linalg.vector_norm(T_s[..., :, None, :3, 3] - T_m[..., None, :, :3, 3], dim=-1)
    u = readings(robot, q, ring("released"))
    difference = LinearisedSensing(robot, ring_moments())(q) - u
    return {
        "closest_mm": 1e3 * float(distance.min()),
        "largest_reading_mT": float(u.abs().max()),
        "largest_difference_mT": float(difference.abs().max()),
    }


def _readings(layout: Layout, q: Tensor, off: Tensor) -> Tensor:
    """Readings [mT] without noise of robots that are off by a batch of parameters; time first."""
    drawn = layout.robot()
    parts = placed(drawn, ring_moments(), off)
    robot: Robot = replace(drawn, magnets=parts.magnets, sensors=parts.sensors)
    return parts.gain * readings(robot, q.unsqueeze(1), ring("released"))


def _relative_error(task: Task, found: Tensor, truth: Tensor) -> Tensor:
    """Of every draw and unknown coordinate, eq. (13), in per cent of the range in the test."""
    width = truth.amax(0) - truth.amin(0)
    truth = truth.unsqueeze(1)
    if isinstance(task.nominal.segments[0], AffineCurvature):
        found = _nearest(found, truth)
    return (100 * (found - truth).square().mean(0).sqrt() / width)[..., task.unknown]


def _nearest(found: Tensor, truth: Tensor) -> Tensor:
    """Of the configurations of one affine shape the one whose azimuth is nearest to the truth."""
    turns = torch.round((found[..., 2] - truth[..., 2]) / math.pi)
    sign = torch.where(turns % 2 == 0, 1.0, -1.0).to(found)
    k0, k1, phi, dL = found.unbind(-1)
    return torch.stack([sign * k0, sign * k1, phi - turns * math.pi, dL], dim=-1)
