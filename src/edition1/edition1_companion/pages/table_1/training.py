"""What the training of Table 1's networks makes of the errors: a seed is a split; one factor changed at a time."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pandas as pd
import torch
from jaxtyping import Float

from edition1.sensing.magnetic import MagneticSensing
from edition1.sensing.weights import read_manifest
from edition1_companion.twins.networks import NetworkSpec
from edition1_companion.twins.table_1_method import networks
from edition1_companion.twins.table_1_rows import rows_named, simulate

NEW_ORDER = "new order in every epoch"
OTHER_DRAWS = "other draws of the data"
RELEASED_MT = {
    (1, 0): (0.0124, 0.0232, 0.0118),
    (2, 0): (0.0168, 0.0210, 0.0146),
    (2, 1): (0.0140, 0.0209, 0.0122),
    (3, 0): (0.0158, 0.0214, 0.0158),
    (3, 1): (0.0188, 0.0216, 0.0138),
    (3, 2): (0.0138, 0.0209, 0.0089),
}
"""Root mean square error [mT] of the released networks over the training distribution, by robot, segment (from 0) and
seed: computed from their weights, which are not part of this project."""


def splits_table(folder: Path, seeds: Sequence[int]) -> pd.DataFrame:
    """Errors of the networks without Earth field over the rows that trained them, by seed.

    Parameters
    ----------
    folder
        Networks and manifests.
    seeds
        Those of the networks.

    Returns
    -------
    pandas.DataFrame
        ``n_b, segment`` (from 1) ``, seed, rmse_mt``, ``released_mt`` (NaN where none was released), and whether it
        is the ``worst`` of this network's seeds.
    """
    rows = []
    for (n, segment), released in RELEASED_MT.items():
        specs = [NetworkSpec(n, segment, earth=False, seed=seed) for seed in seeds]
        errors = [
            read_manifest(folder / f"{spec.name}.safetensors")["metrics_mt"]["rmse_train"] for spec in specs
        ]
        for seed, error in zip(seeds, errors, strict=True):
            key = {"n_b": n, "segment": segment + 1, "seed": seed}
            of_seed = {"rmse_mt": error, "released_mt": dict(enumerate(released)).get(seed)}
            rows.append(key | of_seed | {"worst": error == max(errors)})
    return pd.DataFrame(rows)


def offsets_table(folder: Path, seeds: Sequence[int], steps: int = 400) -> pd.DataFrame:
    """Errors of the networks along T3, taken apart: what the sensors of a segment share, and what they do not.

    The shared part moves the estimated elongation, the other one the estimated bend.

    Parameters
    ----------
    folder, seeds
        Of the networks.
    steps
        Time steps of T3.

    Returns
    -------
    pandas.DataFrame
        ``n_b, segment`` (from 1) ``, seed, offset_mt, shared_mt, between_mt``: see :func:`parts_of_errors`.
    """
    rows = []
    for n in sorted({n for n, _ in RELEASED_MT}):
        row = rows_named([f"n_b={n}"])
        s, model = simulate(row, steps=steps), networks(row, folder, seeds)
        with torch.no_grad():
            found = MagneticSensing(s.robot, model, "angles", s.earth_axis)(
                s.q[None, :, None].expand(len(seeds), -1, 1, -1)
            )
        error = (found - s.u)[:, :, 0].unflatten(-1, (n, -1))
        rows += [
            {"n_b": n, "segment": segment + 1, "seed": seed} | parts_of_errors(error[k, :, segment].numpy())
            for segment in range(n)
            for k, seed in enumerate(seeds)
        ]
    return pd.DataFrame(rows)


def parts_of_errors(error: Float[np.ndarray, "t s"]) -> dict[str, float]:
    """Take the errors of one segment's sensors over time apart; the squares of the three add up to their mean square.

    Returns
    -------
    dict
        ``offset_mt``, their mean; ``shared_mt``, the deviation over time of what they share; ``between_mt``, the root
        mean square of the rest.
    """
    shared = error.mean(axis=1)
    return {
        "offset_mt": float(shared.mean()),
        "shared_mt": float(shared.std()),
        "between_mt": float(np.sqrt(((error - shared[:, None]) ** 2).mean())),
    }


def orders_table(errors: pd.DataFrame, shuffled: pd.DataFrame, published: pd.DataFrame) -> pd.DataFrame:
    """Errors with the rows in one order for ever, and in a new one in every epoch, beside the printed ones.

    Parameters
    ----------
    errors, shuffled
        Columns ``row, seed, quantity, unit, error``.
    published
        Columns ``row, quantity, unit, published``.

    Returns
    -------
    pandas.DataFrame
        ``row, quantity, unit, published``; ``one_order`` and ``shuffled``, means over the seeds of each; rows that
        both have.
    """
    keys = ["row", "quantity", "unit"]
    table = published[[*keys, "published"]]
    for name, part in (("one_order", errors), ("shuffled", shuffled)):
        means = part.groupby(keys, as_index=False)["error"].mean().rename(columns={"error": name})
        table = table.merge(means, on=keys)
    return table
