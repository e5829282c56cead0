"""What rounding decides in Table 2: errors of the paper's method from starts that differ by as little as rounding."""

from __future__ import annotations

from collections.abc import Sequence

import pandas as pd
import torch

from repro.errors import bad_input
from repro.estimation.base import track
from repro.estimation.gradient_descent import GradientDescent
from repro.kernels import compiled
from repro.sensing.ensemble import SeedEnsemble
from repro.sensing.rig import RIG_RATE_HZ
from repro_companion.recordings.baaij2023 import Recording
from repro_companion.twins.rig_data import RigData
from repro_companion.twins.rig_descent import (
    ITERATIONS,
    MOMENTUM,
    STEP_SIZE,
    bend_errors,
    rig_sensing,
    row_name,
)

RELATIVE = 1e-12
"""By so much of each coordinate the starts differ: as much as rounding leaves after some thousand operations."""
STARTS = 8
CHAOTIC = 0.1
"""A descent is chaotic if the errors of one seed from these starts differ by more than this share of their mean."""


def errors_by_start(
    parts: dict[str, Recording],
    data: RigData,
    model: SeedEnsemble,
    seeds: Sequence[int],
    *,
    starts: int = STARTS,
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

    Raises
    ------
    InputError
        If there are fewer than two starts.
    """
    if starts < 2:
        raise bad_input("starts", "errors_by_start", "at least 2", starts)
    gamma = torch.tensor(STEP_SIZE, dtype=torch.float64) / shorter
    descent = GradientDescent(compiled(rig_sensing(model)), gamma, MOMENTUM, ITERATIONS * shorter)
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
