"""How far the estimates of Table 2 can be relied on: what rounding decides, and whether the readings contradict them.

Rounding: errors of the paper's method from starts that differ by as little as rounding.

Consistency, judged without the truth: does another bend explain the readings much better? The map of T5.train, with a
common bias of the sensors that has a prior, is fitted to every reading: at the estimate, where only the bias is free,
and from bends all over the box. Where the best of these fits is better by far, and for long, the estimate is wrong,
whatever it claims.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pandas as pd
import torch
from jaxtyping import Float
from torch import Tensor

from edition1.estimation.base import Trajectory, track
from edition1.estimation.consistency import Status, lasting
from edition1.estimation.levenberg_marquardt import LevenbergMarquardt
from edition1.kernels import compiled
from edition1.sensing.ensemble import SeedEnsemble
from edition1_companion.recordings.baaij2023 import Recording
from edition1_companion.recordings.rig_robot import RIG_RATE_HZ
from edition1_companion.twins.rig_bank import OursConfig
from edition1_companion.twins.rig_data import RigData
from edition1_companion.twins.rig_descent import PaperRun, bend_errors, paper_descent, rig_sensing, row_name
from edition1_companion.twins.rig_map import SCALE_MM, BendMap

RELATIVE = 1e-12
"""By so much of each coordinate the starts differ: as much as rounding leaves after some thousand operations."""
ROUNDED_STARTS = 8
CHAOTIC = 0.1
"""A descent is chaotic if the errors of one seed from these starts differ by more than this share of their mean."""
MUCH_BETTER = 20.0
"""Decrease of chi-square."""
LASTING_S = 1.0
"""For so long another start must be better [s]."""
LOST_MM = 5.0
"""A bend farther from the truth is lost [mm]."""
STARTS = 6
"""Bends of T5.train from which the fits begin, those that explain a reading best."""


def errors_by_start(
    parts: dict[str, Recording],
    data: RigData,
    model: SeedEnsemble,
    seeds: Sequence[int],
    *,
    starts: int = ROUNDED_STARTS,
    shorter: int = 1,
) -> pd.DataFrame:
    """Errors of the bend with the paper's method, known elongation, from starts that are the truth but for rounding.

    Parameters
    ----------
    parts
        What it runs on, by trajectory.
    data
        Whole test parts, whose ranges the relative errors refer to.
    model, seeds
        Networks and their seeds.
    starts
        How many starts: each coordinate of the truth times 1 plus a number that is drawn within :data:`RELATIVE`.
    shorter
        Divides the step size and multiplies the iterations: 1 is the published method.

    Returns
    -------
    pandas.DataFrame
        ``row, seed, start, quantity, unit, error``.
    """
    descent = paper_descent(compiled(rig_sensing(model)), shorter)
    generator, rows = torch.Generator().manual_seed(0), []
    apart = 1 + RELATIVE * (2 * torch.rand(starts, 3, generator=generator, dtype=torch.float64) - 1)
    for name, part in parts.items():
        shape = (-1, len(seeds), starts, -1)
        q, u = (torch.from_numpy(x)[:, None, None].expand(*shape) for x in (part.q, part.u))
        known = torch.full_like(q, torch.nan, memory_format=torch.contiguous_format)
        known[..., 2] = q[..., 2]
        found = track(descent, u, q[0] * apart, rate_hz=RIG_RATE_HZ, known=known).q.numpy()
        for k, seed in enumerate(seeds):
            for cell in bend_errors(found[:, k], part, data.tests[name]):
                rows.append({"row": row_name(name), "seed": seed, "start": cell.pop("model")} | cell)
    return pd.DataFrame(rows)


def rounding_table(errors: pd.DataFrame) -> pd.DataFrame:
    """How far the cells of Table 2 move with starts that differ by rounding alone.

    Parameters
    ----------
    errors
        From :func:`errors_by_start`.

    Returns
    -------
    pandas.DataFrame
        ``row, quantity, unit``; ``lowest`` and ``highest``: of the mean over the seeds, over the starts;
        ``seed_apart_percent``: of the seed that moves most, the largest less the smallest error over the starts, in
        per cent of their mean; ``chaotic``: whether that is more than :data:`CHAOTIC`.
    """
    keys = ["row", "quantity", "unit"]
    means = errors.groupby([*keys, "start"], sort=False)["error"].mean().groupby(keys, sort=False)
    by_seed = errors.groupby([*keys, "seed"], sort=False)["error"]
    apart = ((by_seed.max() - by_seed.min()) / by_seed.mean()).groupby(keys, sort=False).max()
    columns = {
        "lowest": means.min(),
        "highest": means.max(),
        "seed_apart_percent": 100 * apart,
        "chaotic": apart > CHAOTIC,
    }
    return pd.DataFrame(columns).reset_index()


def decrease_of_chi2(
    bend_map: BendMap, readings_mv: Float[np.ndarray, "t 3"], bend_mm: Float[np.ndarray, "t 2"]
) -> Float[np.ndarray, " t"]:
    """By how much chi-square falls from an estimate to the best fit of the same readings.

    Parameters
    ----------
    bend_map
        Readings by bend.
    readings_mv
        Readings.
    bend_mm
        Estimates.
    """
    config = OursConfig()
    unit = torch.from_numpy(np.hypot(bend_map.noise_mv, bend_map.error_mv))

    def sensing(q: Tensor) -> Tensor:
        bias = q[..., 2:]
        return torch.cat([(_readings(bend_map, q[..., :2]) + bias) / unit, bias / config.bias_mv], dim=-1)

    low, high = (
        torch.from_numpy(np.append(x, s * config.widest_mv))
        for x, s in ((bend_map.lower, -1), (bend_map.upper, 1))
    )
    method = LevenbergMarquardt(sensing, low, high, iterations=12)
    u = torch.from_numpy(np.column_stack([readings_mv, np.zeros(len(readings_mv))]))
    u[:, :3] /= unit
    starts = torch.from_numpy(np.column_stack([bend_map.starts, np.zeros(len(bend_map.starts))]))
    apart = (u[:, None] - sensing(starts)).square().sum(-1)
    here = torch.from_numpy(np.column_stack([bend_mm, np.full(len(bend_mm), np.nan)])).clamp(low, high)
    begin = torch.where(here.isnan(), 0.0, here)
    _, held = method.step(method.init(begin), u, 0.0, known=here)
    elsewhere = torch.cat([begin[:, None], starts[apart.topk(STARTS, largest=False).indices]], dim=1)
    _, fits = method.step(method.init(elsewhere), u[:, None].expand(-1, STARTS + 1, -1), 0.0)
    return (held.diagnostics["chi2"] - fits.diagnostics["chi2"].amin(-1)).clamp_min(0.0).numpy()


def doubted(decrease: Float[np.ndarray, " t"]) -> np.ndarray:
    """Readings at which another start has been much better for a second.

    Examples
    --------
    >>> doubted(np.array([0.0] * 10 + [50.0] * 45)).nonzero()[0].tolist()
    [50, 51, 52, 53, 54]
    """
    return lasting(decrease > MUCH_BETTER, LASTING_S * RIG_RATE_HZ)


def doubt_table(bend_map: BendMap, paper: PaperRun, filtered: dict[str, Trajectory]) -> pd.DataFrame:
    """Share of the readings at which estimates are doubted, and at which the bend is lost, by recording and method.

    Returns
    -------
    pandas.DataFrame
        ``recording, method, lost_percent, doubted_percent, lost_and_doubted_percent``; of the paper's method the mean
        over its seeds. Of the filter ``suspicious_percent``, the share of frames that it doubts itself, and
        ``restarts``, how often it was started anew; of the paper's method, which does not watch, none.
    """
    rows = []
    for name, part in paper.parts.items():
        runs = {f"paper, elongation {held}": q for (held, of), q in paper.estimates.items() if of == name} | {
            "filter with a map": filtered[name].q[:, None].numpy()
        }
        for method, q in runs.items():
            found = []
            for seed in range(q.shape[1]):
                bend = 1e3 * q[:, seed, :2]
                lost = np.hypot(*(bend - 1e3 * part.q[: len(bend), :2]).T) > LOST_MM
                doubt = doubted(decrease_of_chi2(bend_map, part.u[: len(bend)], bend))
                found.append([lost.mean(), doubt.mean(), (lost & doubt).mean()])
            names = ("lost_percent", "doubted_percent", "lost_and_doubted_percent")
            shares = dict(zip(names, (100 * np.mean(found, axis=0)).tolist(), strict=True))
            rows.append({"recording": name, "method": method} | shares)
        own = filtered[name].diagnostics
        rows[-1] |= {
            "suspicious_percent": 100 * float((own["status"].numpy() != Status.CONSISTENT).mean()),
            "restarts": int(own["anew"][-1]),
        }
    return pd.DataFrame(rows)


def _readings(bend_map: BendMap, bend_mm: Tensor) -> Tensor:
    """Return the map in torch: readings [mV] of any batch of bends [mm]."""
    x, y = (bend_mm / SCALE_MM).unbind(-1)
    degree = bend_map.degree
    terms = [x ** (n - j) * y**j for n in range(degree + 1) for j in range(n + 1)]
    return torch.stack(terms, dim=-1) @ torch.from_numpy(bend_map.factors)
