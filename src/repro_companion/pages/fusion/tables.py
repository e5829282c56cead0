"""Tables of the fused filter: errors, normalised squared errors with bands, and gains against predictions."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import cast

import numpy as np
import pandas as pd
import torch
from jaxtyping import Float
from scipy.stats import chi2
from torch import Tensor

from repro.estimation.levenberg_marquardt import jacobian
from repro.kinematics.paper_robots import LENGTH_M
from repro.kinematics.trajectories import trajectory
from repro_companion.book.bootstrap import interval, resampled
from repro_companion.pages.fusion.filters import METHODS, SHARE, Tracked, estimates
from repro_companion.pages.fusion.orientation_readings import rotation_vector
from repro_companion.pages.fusion.readings import SETTINGS, STEPS, Surroundings, record
from repro_companion.twins.segment_motion import LOAD_N, ROBOT, TRAJECTORIES, Motion, motion

SKIPPED = 10
"""First steps (1 s) that do not count: the filter starts with the box."""
INFLATED = "both, inflated"
ALL = (*METHODS, INFLATED)
SHAPE_MT = 0.3
"""Noise for a wrong shape: the choice on the rod under half the load, see :func:`shape_choices`."""
SHARES = (0.1, 0.3, 1.0, 3.0)
SHAPES_MT = (0.0, 0.01, 0.03, 0.1, 0.3, 1.0)


def judged(steps: int = STEPS) -> list[Motion]:
    """Motions that are judged, or their first steps: those of the robot that carries the sensors of three papers."""
    return [_first(motion(name, steps=STEPS), steps) for name in TRAJECTORIES]


def random_motion() -> Motion:
    """Smooth random motion of constant curvature, on which the process noise is chosen."""
    whole, still = trajectory("T0", 1), motion(TRAJECTORIES[0], steps=STEPS)
    q = whole[:: len(whole) // STEPS]
    poses = ROBOT.segments[0].pose(q.unsqueeze(-2), still.arcs_m / LENGTH_M)
    return Motion("random motion", still.time_s, still.arcs_m, poses, q)


def _first(moved: Motion, steps: int) -> Motion:
    q = None if moved.q is None else moved.q[:steps]
    return replace(moved, time_s=moved.time_s[:steps], poses=moved.poses[:steps], q=q)


def errors(
    motions: Sequence[Motion],
    seeds: Sequence[int],
    *,
    settings: Sequence[Surroundings] = SETTINGS,
    methods: Sequence[str] = ALL,
    share: float = SHARE,
    shape_mt: float = SHAPE_MT,
) -> pd.DataFrame:
    r"""Errors and normalised squared errors of every step.

    Columns: ``setting, trajectory, method, seed, time_s``; ``tip_mm`` and ``orientation_deg``, distance and angle
    between estimated and true pose of the tip; ``nees_tip`` and ``nees_direction``, :math:`e^T C^{-1} e/n` of the
    position (n = 3; missing for the IMUs, which do not see the elongation) and of the direction of the tip (n = 2);
    ``predicted_tip_mm`` and ``predicted_orientation_deg``, what the covariance on readings without noise says.

    Parameters
    ----------
    motions, seeds, settings, methods
        What to run; ``INFLATED`` is both kinds with ``shape_mt``, in the first setting.
    share, shape_mt
        As for :func:`repro_companion.pages.fusion.filters.estimates`.
    """
    tables: list[pd.DataFrame] = []
    alone: dict[str, Tracked] = {}
    truth = torch.stack([x.at(LENGTH_M) for x in motions], dim=1).unsqueeze(2)
    for setting in settings:
        recorded = record(motions, seeds, setting)
        for method in methods:
            if method == INFLATED:
                if setting != settings[0]:
                    continue
                found = estimates(METHODS[2], recorded, setting, share=share, shape_mt=shape_mt)
            elif method == METHODS[1] and alone:
                found = alone[method]  # the IMUs read the same whatever disturbs the magnets
            else:
                found = estimates(method, recorded, setting, share=share)
            if method == METHODS[1]:
                alone[method] = found
            columns = _columns(found, truth)
            for place, moved in enumerate(motions):
                for k, seed in enumerate(seeds):
                    labels = {
                        "setting": setting.name,
                        "trajectory": moved.name,
                        "method": method,
                        "seed": seed,
                    }
                    values = {name: x[SKIPPED:, place, k].numpy() for name, x in columns.items()}
                    times = {"time_s": moved.time_s[SKIPPED:].numpy()}
                    tables.append(pd.DataFrame({**labels, **times, **values}))
    return pd.concat(tables, ignore_index=True)


def _columns(found: Tracked, truth: Float[Tensor, "t m 1 4 4"]) -> dict[str, Tensor]:
    """Errors of every step; what is predicted is that of the last draw, which has no noise."""
    n = found.covariance.shape[-1]

    def looked(q: Tensor) -> Tensor:
        T = ROBOT.tip(q)
        return torch.cat([T[..., :3, 3], T[..., :3, :3].flatten(-2)], dim=-1)

    _, J = jacobian(looked, found.q)
    J, T = J[..., :n], ROBOT.tip(found.q)
    R, R_true = T[..., :3, :3], truth[..., :3, :3]
    off = truth[..., :3, 3] - T[..., :3, 3]
    angle = torch.linalg.vector_norm(rotation_vector(R.mT @ R_true), dim=-1)
    # The direction of the tip, seen in the estimated frame.
    side = (R.mT @ R_true)[..., :2, 2]
    J_R = J[..., 3:, :].unflatten(-2, (3, 3))
    J_side = (R.mT @ J_R[..., :, 2, :])[..., :2, :]
    C, J_p = found.covariance, J[..., :3, :]
    C_p = J_p @ C @ J_p.mT
    turned = (J[..., 3:, :] @ C * J[..., 3:, :]).sum((-1, -2)) / 2
    empty = torch.full_like(angle, torch.nan)
    whole = n == 3
    predicted = C_p.diagonal(dim1=-2, dim2=-1).sum(-1).sqrt()
    return {
        "tip_mm": 1e3 * torch.linalg.vector_norm(off, dim=-1),
        "orientation_deg": angle.rad2deg(),
        "nees_tip": _normalised(off, C_p) if whole else empty,
        "nees_direction": _normalised(side, J_side @ C @ J_side.mT),
        "predicted_tip_mm": 1e3 * predicted[..., -1:].expand_as(angle) if whole else empty,
        "predicted_orientation_deg": turned.sqrt()[..., -1:].expand_as(angle).rad2deg(),
    }


def _normalised(error: Tensor, C: Tensor) -> Tensor:
    e = error.unsqueeze(-1)
    return (e.mT @ torch.linalg.solve(C, e)).squeeze(-1).squeeze(-1) / error.shape[-1]


def summary(table: pd.DataFrame) -> pd.DataFrame:
    """Errors, predictions, and the mean NEES with the 95 % band of a mean over the draws at one time.

    Columns: ``setting, trajectory, method, tip_mm, predicted_tip_mm, orientation_deg, predicted_orientation_deg``;
    and for ``direction`` and ``tip``: ``nees_*``, ``low_*``, ``high_*``, and ``inside_*_percent``, the share of
    times at which the mean over the draws lies in the band (95 % if the covariance is right).
    """
    lines = []
    draws = table["seed"].nunique()
    for labels, part in table.groupby(["setting", "trajectory", "method"], sort=False):
        setting, name, method = cast(tuple[str, str, str], labels)
        line = {"setting": setting, "trajectory": name, "method": method}
        for column in ("tip_mm", "orientation_deg"):
            line[column] = float(np.sqrt((part[column] ** 2).mean()))
            line[f"predicted_{column}"] = float(np.sqrt((part[f"predicted_{column}"] ** 2).mean()))
        for kind, n in (("direction", 2), ("tip", 3)):
            low, high = chi2.ppf([0.025, 0.975], n * draws) / (n * draws)
            at_time = part.groupby("time_s")[f"nees_{kind}"].mean()
            inside = 100 * float(((at_time >= low) & (at_time <= high)).mean())
            line |= {f"nees_{kind}": at_time.mean(), f"low_{kind}": low, f"high_{kind}": high}
            line[f"inside_{kind}_percent"] = np.nan if bool(at_time.isna().all()) else inside
        lines.append(line)
    return pd.DataFrame(lines)


def gains(table: pd.DataFrame, *, method: str = METHODS[2], seed: int = 0) -> pd.DataFrame:
    """Errors of a filter of both kinds over those of the better single one, with paired bootstrap intervals.

    Columns: ``setting, trajectory, quantity, single``, the single method with the smaller error; ``ratio, low,
    high``; ``predicted``, the ratio of the predictions (orientation: of the smaller one), which holds where the
    model is true.

    Parameters
    ----------
    table
        Of :func:`errors`.
    method
        The filter of both kinds.
    seed
        Of the bootstrap.
    """
    rng, lines = np.random.default_rng(seed), []
    for labels, part in table.groupby(["setting", "trajectory"], sort=False):
        setting, name = cast(tuple[str, str], labels)
        for quantity in ("tip_mm", "orientation_deg"):
            if method not in set(part["method"]):
                continue
            squared = part.assign(x=part[quantity] ** 2).pivot_table(
                index="seed", columns="method", values="x"
            )
            by_method = part.groupby("method")[f"predicted_{quantity}"].apply(lambda x: (x**2).mean())
            single = min(METHODS[:2], key=lambda m: squared[m].mean())
            drawn = resampled(len(squared), rng)
            both, alone = squared[method].to_numpy(), squared[single].to_numpy()
            ratios = np.sqrt(both[drawn].mean(1) / alone[drawn].mean(1))
            low, high = interval(ratios)
            lines.append(
                {
                    "setting": setting,
                    "trajectory": name,
                    "quantity": quantity,
                    "single": single,
                    "ratio": np.sqrt(both.mean() / alone.mean()),
                    "low": low,
                    "high": high,
                    "predicted": np.sqrt(by_method[method] / by_method[list(METHODS[:2])].min()),
                }
            )
    return pd.DataFrame(lines)


def choices(seeds: Sequence[int], shares: Sequence[float] = SHARES) -> pd.DataFrame:
    """Process noise on the random motion, 7 times the noise: ``share, tip_mm, nees_tip, inside_percent``.

    The choice is the smallest one whose NEES lies in its band.
    """
    moved, lines = [random_motion()], []
    for share in shares:
        options = {"settings": SETTINGS[1:2], "methods": METHODS[2:], "share": share}
        line = summary(errors(moved, seeds, **options)).iloc[0]
        kept = {
            "tip_mm": line["tip_mm"],
            "nees_tip": line["nees_tip"],
            "inside_percent": line["inside_tip_percent"],
        }
        lines.append({"share": share, **kept})
    return pd.DataFrame(lines)


def shape_choices(seeds: Sequence[int], shapes_mt: Sequence[float] = SHAPES_MT) -> pd.DataFrame:
    """Noise for a wrong shape, on the rod under half the load: ``shape_mt, tip_mm, orientation_deg, nees_direction``.

    The choice is the one with the smallest error of the orientation.
    """
    moved, lines = [motion(TRAJECTORIES[2], steps=STEPS, load_n=LOAD_N / 2)], []
    for shape_mt in shapes_mt:
        options = {"settings": SETTINGS[:1], "methods": (INFLATED,), "shape_mt": shape_mt}
        line = summary(errors(moved, seeds, **options)).iloc[0]
        lines.append(
            {"shape_mt": shape_mt, **line[["tip_mm", "orientation_deg", "nees_direction", "nees_tip"]]}
        )
    return pd.DataFrame(lines)
