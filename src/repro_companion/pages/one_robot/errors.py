"""Errors of the three ways to see one robot, draw by draw (synthetic)."""

from __future__ import annotations

from dataclasses import replace

import pandas as pd
import torch
from torch import Tensor

from repro.kinematics.trajectories import STEPS
from repro_companion.pages.one_robot.estimates import METHODS, Shape, by_hall, by_imus, by_magnets
from repro_companion.pages.one_robot.models import Models, as_drawn, calibrated
from repro_companion.twins.segment_motion import LOAD_N, TRAJECTORIES, Motion, motion
from repro_companion.twins.segment_robot import Readings, calibration_session, draw_parts, simulate

CONDITIONS = ("all sensors", "one sensor failed", "other magnet on board")
QUANTITIES = ("tip_mm", "orientation_deg", "shape_mm")
EVERY = 4
"""Of the nodes of the backbone, those where shapes are compared: every 10 mm."""


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
    turn = T[..., -1, :3, :3].mT @ shape.tip
    skew = turn - turn.mT
    sine = torch.stack([skew[..., 2, 1], skew[..., 0, 2], skew[..., 1, 0]], dim=-1).norm(dim=-1) / 2
    cosine = (turn.diagonal(dim1=-2, dim2=-1).sum(-1) - 1) / 2
    angle = torch.atan2(sine, cosine).rad2deg()
    found = (
        1e3 * off[..., -1].mean(0).sqrt(),
        angle.square().mean(0).sqrt(),
        1e3 * off.mean(-1).mean(0).sqrt(),
    )
    return dict(zip(QUANTITIES, found, strict=True))


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
    found.append((halls[0], beside, [by_hall(_at_base(models), both.hall[:, :, :1], arcs, seed=seed)[0]]))
    return sorted(found, key=lambda entry: (METHODS.index(entry[0]), CONDITIONS.index(entry[1])))


def _at_base(models: Models) -> Models:
    """Models with the first of the places of the Hall sensor alone."""
    matrix, offset = models.hall_matrix[..., :1, :, :], models.hall_offset[..., :1, :]
    return replace(models, hall_matrix=matrix, hall_offset=offset)
