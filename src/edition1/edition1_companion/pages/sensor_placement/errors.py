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

from edition1.errors import bad_input
from edition1.kinematics.affine_curvature import AffineCurvature
from edition1.kinematics.robot import Robot
from edition1.sensing.linearised import LinearisedSensing
from edition1.sensing.magnetic import readings
from edition1.sensing.magnets import ring
from edition1.sensing.placement import Tolerances, placed
from edition1_companion.book.bootstrap import ratio_of_means, resampled
from edition1_companion.pages.sensor_placement.layouts import Layout
from edition1_companion.pages.sensor_placement.tasks import (
    NOISE_MT,
    TEST_SEED,
    Task,
    expected_errors,
    ring_moments,
    spread_of_parts,
)
from edition1_companion.twins.calibrated_robots import from_best_start, table_of_draws
from edition1_companion.twins.trajectories import RATE_HZ, STEPS

ITERATIONS = (4, 10)
"""Iterations from every start, and those of the best of them."""
ROBOTS = ("as drawn", "within tolerances")
"""Robots to which a layout is put: exactly as drawn, or off by normal draws of
:class:`~edition1.sensing.placement.Tolerances` and not calibrated."""


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
        If there is no draw.
    """
    if draws < 1:
        raise bad_input("draws", "measured_errors", "at least 1", draws)
    tables = []
    for test, q in task.tests.items():
        generator = torch.Generator().manual_seed(seed + TEST_SEED)
        n_s = len(task.nominal.sensor_segment)
        spread = spread_of_parts(task.nominal.robot(), tolerances or Tolerances())
        parts = spread * torch.randn(draws, len(spread), generator=generator, dtype=torch.float64)
        noise = noise_mt * torch.randn(len(q), draws, n_s, generator=generator, dtype=torch.float64)
        for name, layout in layouts.items():
            for robot, off in zip(ROBOTS, (0 * parts[:1], parts), strict=True):
                u = _readings(layout, q, off) + noise
                error = _relative_error(task, estimate(task, layout, u, q, noise_mt), q)
                table = table_of_draws(error, task.coordinates)
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
    known = None
    if task.known:
        known = torch.full_like(q, math.nan)
        known[:, list(task.known)] = q[:, list(task.known)]
        known = known.unsqueeze(1).expand(*u.shape[:-1], -1)
    sensing, box = LinearisedSensing(layout.robot(), ring_moments()), (task.low, task.high)
    return from_best_start(sensing, box, task.starts, u, ITERATIONS, noise_mt=noise_mt, known=known)


def errors_by_layout(table: pd.DataFrame, *, reference: str = "nominal", seed: int = 0) -> pd.DataFrame:
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
    """
    keys, lines = ["task", "robot", "shapes"], []
    for labels, part in table.groupby(keys, sort=False):
        by_draw = part.pivot_table(index="draw", columns="layout", values="error_percent", sort=False)
        index, base = resampled(len(by_draw), seed), by_draw[reference].to_numpy()
        for layout, here in by_draw.items():
            line = dict(zip(keys, labels, strict=True)) | {"layout": layout}
            line |= {"mean_percent": here.mean(), "std_percent": here.std()}
            lines.append(line | ratio_of_means(here.to_numpy(), base, index))
    return pd.DataFrame(lines)


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
