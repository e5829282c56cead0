"""Tables of the fused filter: errors, normalised squared errors with bands, and gains against predictions."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pandas as pd
import torch
from jaxtyping import Float
from scipy.stats import chi2
from torch import Tensor

from edition1.estimation.levenberg_marquardt import jacobian
from edition1.kinematics.paper_robots import Dimensions
from edition1_companion.book.bootstrap import interval, resampled
from edition1_companion.pages.fusion.models import rotation_vector
from edition1_companion.pages.fusion.study import (
    METHODS,
    SETTINGS,
    STEPS,
    Surroundings,
    Tracked,
    estimates,
    record,
)
from edition1_companion.twins.segment_motion import ROBOT, TRAJECTORIES, Motion, motion

SKIPPED = 10
"""First steps (1 s) that do not count: the filter starts with the box."""
INFLATED = "both, inflated"
SHARE = 0.3
"""Process noise in widths of the box per s^1.5. Of 0.1, 0.3, 1 and 3, the smallest whose NEES lay in its band on a
smooth random motion of constant curvature, at 7 times the noise."""
SHAPE_MT = 0.3
"""Noise for a wrong shape [mT]. Of 0, 0.01, 0.03, 0.1, 0.3 and 1, the one with the smallest error of the orientation
on the rod under half the load."""
KEYS = ["setting", "trajectory", "method"]
QUANTITIES = ("tip_mm", "orientation_deg")


def judged(steps: int = STEPS) -> list[Motion]:
    """Motions that are judged, or their first steps: those of the robot that carries the sensors of three papers."""
    whole = [motion(name, steps=STEPS) for name in TRAJECTORIES]
    return [replace(x, time_s=x.time_s[:steps], poses=x.poses[:steps], q=None) for x in whole]


def errors_by_step(
    motions: Sequence[Motion],
    seeds: Sequence[int],
    *,
    settings: Sequence[Surroundings] = SETTINGS,
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
    motions, seeds, settings
        What to run; in the first setting also ``INFLATED``, both kinds with ``shape_mt``.
    share, shape_mt
        As for :func:`edition1_companion.pages.fusion.study.estimates`.
    """
    tables: list[pd.DataFrame] = []
    truth = torch.stack([x.at(Dimensions.LENGTH_M) for x in motions], dim=1).unsqueeze(2)
    along = [[x.name for x in motions], seeds, motions[0].time_s[SKIPPED:].tolist()]
    steps = pd.MultiIndex.from_product(along, names=["trajectory", "seed", "time_s"])
    alone = None
    for setting in settings:
        recorded = record(motions, seeds, setting)
        # The IMUs read the same whatever disturbs the magnets.
        alone = alone or estimates("IMUs", recorded, setting, share=share)
        found = {m: alone if m == "IMUs" else estimates(m, recorded, setting, share=share) for m in METHODS}
        if setting == settings[0]:
            found[INFLATED] = estimates("both", recorded, setting, share=share, shape_mt=shape_mt)
        for method, tracked in found.items():
            # [time, motions, draws]; the last draw has no noise.
            columns = {k: x[SKIPPED:, :, :-1].movedim(0, -1) for k, x in _columns(tracked, truth).items()}
            table = pd.DataFrame({name: x.flatten().numpy() for name, x in columns.items()}, index=steps)
            tables.append(table.reset_index().assign(setting=setting.name, method=method))
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


def mean_errors(table: pd.DataFrame) -> pd.DataFrame:
    """Errors, predictions, and the mean NEES with the 95 % band of a mean over the draws at one time.

    Columns: ``setting, trajectory, method, tip_mm, predicted_tip_mm, orientation_deg, predicted_orientation_deg``;
    and for ``direction`` and ``tip``: ``nees_*``, ``low_*``, ``high_*``, and ``inside_*_percent``, the share of
    times at which the mean over the draws lies in the band (95 % if the covariance is right).
    """
    lines = []
    draws = table["seed"].nunique()
    for labels, part in table.groupby(KEYS, sort=False):
        line: dict[str, object] = dict(zip(KEYS, labels, strict=True))
        for quantity in QUANTITIES:
            for column in (quantity, f"predicted_{quantity}"):
                line[column] = np.sqrt((part[column] ** 2).mean())
        for kind, n in (("direction", 2), ("tip", 3)):
            low, high = chi2.ppf([0.025, 0.975], n * draws) / (n * draws)
            at_time = part.groupby("time_s")[f"nees_{kind}"].mean()
            inside = np.nan if bool(at_time.isna().all()) else 100 * at_time.between(low, high).mean()
            line |= {f"nees_{kind}": at_time.mean(), f"low_{kind}": low, f"high_{kind}": high}
            line[f"inside_{kind}_percent"] = inside
        lines.append(line)
    return pd.DataFrame(lines)


def ratio_to_better_single(table: pd.DataFrame, *, method: str = "both", seed: int = 0) -> pd.DataFrame:
    """Errors of a filter of both kinds over those of the better single one, with paired bootstrap intervals.

    Columns: ``setting, trajectory, quantity, single``, the single method with the smaller error; ``ratio, low,
    high``; ``predicted``, the ratio of the predictions (orientation: of the smaller one), which holds where the
    model is true.

    Parameters
    ----------
    table
        Of :func:`errors_by_step`.
    method
        The filter of both kinds.
    seed
        Of the bootstrap.
    """
    rng, lines = np.random.default_rng(seed), []
    chosen = table[table["setting"].isin(table["setting"][table["method"] == method])]
    for labels, part in chosen.groupby(KEYS[:2], sort=False):
        for quantity in QUANTITIES:
            squared = part.assign(x=part[quantity] ** 2).pivot_table("x", index="seed", columns="method")
            predicted = part.groupby("method")[f"predicted_{quantity}"].apply(lambda x: (x**2).mean())
            single = min(METHODS[:2], key=lambda m: squared[m].mean())
            drawn = resampled(len(squared), rng)
            both, alone = squared[method].to_numpy(), squared[single].to_numpy()
            low, high = interval(np.sqrt(both[drawn].mean(1) / alone[drawn].mean(1)))
            ratio = np.sqrt(both.mean() / alone.mean())
            foretold = np.sqrt(predicted[method] / predicted[list(METHODS[:2])].min())
            lines.append((*labels, quantity, single, ratio, low, high, foretold))
    columns = [*KEYS[:2], "quantity", "single", "ratio", "low", "high", "predicted"]
    return pd.DataFrame(lines, columns=columns)
