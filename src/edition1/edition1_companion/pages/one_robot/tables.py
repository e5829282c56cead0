"""Errors of the three ways to see one robot, and what they say about which one to build (synthetic)."""

from __future__ import annotations

from dataclasses import replace
from time import process_time
from timeit import repeat

import numpy as np
import pandas as pd
import torch
from torch import Tensor

from edition1.kinematics.paper_robots import Dimensions
from edition1_companion.book.bootstrap import interval, ratio_interval, resampled
from edition1_companion.book.pose_errors import angle_deg
from edition1_companion.pages.one_robot.estimates import (
    METHODS,
    STRAIGHT,
    Models,
    Shape,
    arc,
    as_drawn,
    by_hall,
    by_imus,
    by_magnets,
    calibrated,
    least_squares,
    particle_filter,
)
from edition1_companion.twins.segment_motion import LOAD_N, TRAJECTORIES, Motion, motion
from edition1_companion.twins.segment_robot import (
    APART_M,
    Readings,
    calibration_session,
    draw_parts,
    simulate,
)
from edition1_companion.twins.trajectories import STEPS

CONDITIONS = ("all sensors", "one sensor failed", "other magnet on board")
QUANTITIES = ("tip_mm", "orientation_deg", "shape_mm")
KEYS = ["trajectory", "method", "calibrated", "condition"]
EVERY = 4
"""Of the nodes of the backbone, those where shapes are compared: every 10 mm."""
BOOTSTRAPS = 2000
PARTS = {
    METHODS[0]: (
        "1 ring, 3 sensors of one axis",
        4,
        3,
        100 * (1 - Dimensions.MAGNET_AXIAL_M / Dimensions.LENGTH_M),
    ),
    METHODS[1]: ("1 cube, 1 sensor of three axes", 2, 3, 100 * APART_M / Dimensions.LENGTH_M),
    METHODS[2]: ("1 cube, 1 sensor of three axes", 2, 3, 100 * APART_M / Dimensions.LENGTH_M),
    METHODS[3]: ("2 IMUs", 2, 8, 100.0),
}
"""What is mounted, how many parts that is, numbers that are read at each step, and the share of the segment [%]
between the parts: of the rest nothing is measured."""


def one_robot_errors(
    draws: int = 12, *, seed: int = 0, steps: int = STEPS, load_n: float = LOAD_N, poses: int = 60
) -> pd.DataFrame:
    """Errors of every method on every trajectory, one line per draw of tolerances and noise.

    A failed sensor is the worst of them, draw by draw: of the ring's sensors, the Hall sensor as a whole, or one of
    the IMUs, from the first step on. With the other magnet on board (for the two that the same robot can carry) its
    field is in the readings and in no model, calibrated or not.

    Parameters
    ----------
    draws
        Robots.
    seed
        Of tolerances, noise and particles.
    steps
        Time steps of each trajectory of 10 s.
    load_n
        Sideways force on the tip of the rod [N].
    poses
        Poses for the calibration.

    Returns
    -------
    DataFrame
        Columns ``trajectory, method, calibrated, condition, draw``; root mean squares over time ``tip_mm`` (distance
        between estimated and true tip), ``orientation_deg`` (angle between their orientations) and ``shape_mm``
        (distance between corresponding points of the backbone, over its length, too).

    Raises
    ------
    InputError
        If there is no draw or no step, or there are fewer than three poses.
    """
    parts = draw_parts(draws, seed=seed)
    models = {True: calibrated(*calibration_session(parts, poses=poses, seed=seed)), False: as_drawn()}
    tables = []
    for name in TRAJECTORIES:
        moved = motion(name, steps=steps, load_n=load_n)
        alone, both = (simulate(moved, parts, seed=seed, both_magnets=x) for x in (False, True))
        seen = replace(moved, arcs_m=moved.arcs_m[::EVERY], poses=moved.poses[:, ::EVERY])
        for known, model in models.items():
            for method, condition, shapes in _estimates(model, alone, both, seen.arcs_m, seed):
                errors = [shape_errors(shape, seen) for shape in shapes]
                worst = {x: torch.stack([e[x] for e in errors]).amax(0).numpy() for x in QUANTITIES}
                labels = {"trajectory": name, "method": method, "calibrated": known, "condition": condition}
                tables.append(pd.DataFrame({**labels, "draw": range(draws), **worst}))
    return pd.concat(tables, ignore_index=True)


def shape_alone(*, steps: int = STEPS, load_n: float = LOAD_N) -> pd.DataFrame:
    """Errors of robots as drawn with sensors without noise: what is left is the assumed shape, and delay.

    Parameters
    ----------
    steps, load_n
        As for :func:`one_robot_errors`.

    Returns
    -------
    DataFrame
        Columns ``trajectory, method`` and ``QUANTITIES``.
    """
    parts, rows = draw_parts(1, as_drawn=True), []
    for name in TRAJECTORIES:
        moved = motion(name, steps=steps, load_n=load_n)
        readings = simulate(moved, parts, noise=False)
        for method, condition, shapes in _estimates(as_drawn(), readings, readings, moved.arcs_m, 0):
            if condition == CONDITIONS[0]:
                errors = {x: e.item() for x, e in shape_errors(shapes[0], moved).items()}
                rows.append({"trajectory": name, "method": method, **errors})
    return pd.DataFrame(rows)


def shape_errors(shape: Shape, moved: Motion) -> dict[str, Tensor]:
    """Root-mean-squared errors over time of an estimated shape, by ``QUANTITIES``, one number per draw.

    Parameters
    ----------
    shape
        At the arc lengths of the motion.
    moved
        Truth.
    """
    T = moved.poses.unsqueeze(1)
    off = (shape.points - T[..., :3, 3]).square().sum(-1)
    angle = angle_deg(T[..., -1, :3, :3].mT @ shape.tip)
    return {
        "tip_mm": 1e3 * off[..., -1].mean(0).sqrt(),
        "orientation_deg": angle.square().mean(0).sqrt(),
        "shape_mm": 1e3 * off.mean(-1).mean(0).sqrt(),
    }


def _estimates(
    models: Models, alone: Readings, both: Readings, arcs: Tensor, seed: int
) -> list[tuple[str, str, list[Shape]]]:
    """Method, condition and estimates, of which the worst counts."""
    whole, failed, beside = CONDITIONS
    ring, *halls, imus = METHODS
    found = [
        (ring, whole, [by_magnets(models, alone.magnets, arcs)]),
        (ring, failed, [by_magnets(models, alone.magnets, arcs, failed=k) for k in range(3)]),
        (ring, beside, [by_magnets(models, both.magnets, arcs)]),
        (imus, whole, [by_imus(models, alone.imus, arcs)]),
        (imus, failed, [by_imus(models, alone.imus, arcs, failed=k) for k in range(2)]),
    ]
    seen, blind = by_hall(models, alone.hall, arcs, seed=seed), by_hall(models, alone.hall, arcs, failed=0)
    for k, name in enumerate(halls):
        found += [(name, whole, [seen[k]]), (name, failed, [blind[k]])]
    matrix, offset = models.hall_matrix[..., :1, :, :], models.hall_offset[..., :1, :]
    at_base = replace(models, hall_matrix=matrix, hall_offset=offset)
    found.append((halls[0], beside, [by_hall(at_base, both.hall[:, :, :1], arcs, seed=seed)[0]]))
    return sorted(found, key=lambda entry: (METHODS.index(entry[0]), CONDITIONS.index(entry[1])))


def mean_errors(table: pd.DataFrame) -> pd.DataFrame:
    """Means over the draws with their bootstrap 95 % intervals.

    Parameters
    ----------
    table
        From :func:`one_robot_errors`.

    Returns
    -------
    DataFrame
        Columns ``trajectory, method, calibrated, condition``, then each of ``QUANTITIES`` with the ends of its
        interval, ``tip_low_mm`` and ``tip_high_mm`` and so on.
    """
    rows = []
    for key, part in table.groupby(KEYS, sort=False):
        row: dict[str, object] = dict(zip(KEYS, key, strict=True))
        for quantity in QUANTITIES:
            name, unit = quantity.rsplit("_", 1)
            values = part[quantity].to_numpy()
            low, high = interval(values[resampled(len(values), 0, bootstraps=BOOTSTRAPS)].mean(-1))
            row |= {quantity: values.mean(), f"{name}_low_{unit}": low, f"{name}_high_{unit}": high}
        rows.append(row)
    return pd.DataFrame(rows)


def ratio_to_imus(table: pd.DataFrame) -> pd.DataFrame:
    """Mean tip error of every calibrated method over that of the IMUs, with a paired bootstrap 95 % interval.

    Parameters
    ----------
    table
        From :func:`one_robot_errors`.

    Returns
    -------
    DataFrame
        Columns ``trajectory, method, ratio, low, high``.
    """
    *others, imus = METHODS
    chosen = table[table["calibrated"] & (table["condition"] == CONDITIONS[0])]
    wide = chosen.pivot(index=["trajectory", "draw"], columns="method", values="tip_mm")
    rows = []
    for name in TRAJECTORIES:
        errors = wide.loc[name]
        index = resampled(len(errors), 0, bootstraps=BOOTSTRAPS)
        below = errors[imus].to_numpy()
        for method in others:
            above = errors[method].to_numpy()
            rows.append((name, method, above.mean() / below.mean(), *ratio_interval(above, below, index)))
    return pd.DataFrame(rows, columns=["trajectory", "method", "ratio", "low", "high"])


def overview(means: pd.DataFrame) -> pd.DataFrame:
    """One line per method and calibration: parts, errors with intervals as text, and what robustness costs.

    Parameters
    ----------
    means
        From :func:`mean_errors`.

    Returns
    -------
    DataFrame
        ``parts``; the tip error on each trajectory; tip orientation and shape error under load; and tip errors on
        the constant curvature with the worst sensor failed and with the other magnet on board.
    """
    rows = []
    for method in METHODS:
        for known in (False, True):
            here = means[(means["method"] == method) & (means["calibrated"] == known)]
            cells = here.set_index(["trajectory", "condition"])
            steady, load = TRAJECTORIES[0], TRAJECTORIES[2]
            row = {"method": method, "calibrated": "yes" if known else "no", "parts": PARTS[method][1]}
            row |= {f"tip, {x} [mm]": _cell(cells, x, CONDITIONS[0], "tip_mm") for x in TRAJECTORIES}
            row |= {
                "orientation, load [deg]": _cell(cells, load, CONDITIONS[0], "orientation_deg"),
                "shape, load [mm]": _cell(cells, load, CONDITIONS[0], "shape_mm"),
                "tip, failed [mm]": _cell(cells, steady, CONDITIONS[1], "tip_mm"),
                "tip, other magnet [mm]": _cell(cells, steady, CONDITIONS[2], "tip_mm"),
            }
            rows.append(row)
    return pd.DataFrame(rows)


def latency(*, repeats: int = 200) -> pd.DataFrame:
    """Parts, numbers read per step, and the processor time of one estimate, which depends on the machine.

    Parameters
    ----------
    repeats
        Of every timing, of which the median counts.
    """
    moved, models = motion(TRAJECTORIES[0], steps=40), as_drawn()
    read = simulate(moved, draw_parts(1))
    u, hall, imus = read.magnets[0, 0], read.hall[0, 0, 0], read.imus[:1, :1]
    mask = torch.tensor([True, True, False])
    squares, cloud = least_squares(models.magnets), particle_filter()
    start, particles = squares.init(STRAIGHT), cloud.init(STRAIGHT[:2])

    def by_ring() -> None:
        arc(squares.step(start, u, 0.0)[1].q, moved.arcs_m)

    def by_bend() -> None:
        q = cloud.step(particles, hall, 0.0, mask=mask)[1].q
        arc(torch.cat([q, q[:1]]), moved.arcs_m)

    def by_ends() -> None:
        by_imus(models, imus, moved.arcs_m)

    rows = []
    for method, call in zip(METHODS, (by_ring, by_bend, by_bend, by_ends), strict=True):
        call()  # the first call compiles
        times = repeat(call, timer=process_time, repeat=repeats, number=1)
        rows.append((method, *PARTS[method], 1e3 * np.median(times)))
    return pd.DataFrame(
        rows, columns=["method", "mounted", "parts", "numbers_per_step", "seen_percent", "cpu_ms"]
    )


def _cell(cells: pd.DataFrame, trajectory: str, condition: str, quantity: str) -> str:
    if (trajectory, condition) not in cells.index:
        return ""
    name, unit = quantity.rsplit("_", 1)
    row = cells.loc[(trajectory, condition)]
    return f"{row[quantity]:.2g} ({row[f'{name}_low_{unit}']:.2g} to {row[f'{name}_high_{unit}']:.2g})"
