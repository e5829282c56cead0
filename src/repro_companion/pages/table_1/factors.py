"""Table 1's training with one factor changed at a time: what its errors, and their distance from print, belong to."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import pandas as pd

from repro.sensing.weights import save_weights
from repro_companion.twins.networks import DATA_SEED, PCC_LEARNING_RATE, NetworkSpec, training_rows
from repro_companion.twins.rig_together import train_together
from repro_companion.twins.table_1_method import run
from repro_companion.twins.table_1_rows import ROWS

NEW_ORDER = "new order in every epoch"
OTHER_DRAWS = "other draws of the data"
FACTORS: dict[str, dict[str, Any]] = {
    NEW_ORDER: {"shuffled": True},
    OTHER_DRAWS: {"data_seed": DATA_SEED + 1},
}
"""Factors, and what they change: of the training, or the seed of its data."""


def factor_errors(
    robots: Mapping[str, Sequence[int]], seeds: Sequence[int], cache: Path, *, progress: bool = False
) -> pd.DataFrame:
    """Errors of the paper's method with networks of whose training one factor is changed; hours.

    Parameters
    ----------
    robots
        Numbers of segments by factor, of :data:`FACTORS`; all without an Earth field.
    seeds
        Of the networks.
    cache
        Folder of a folder of networks for each factor: those that are missing are trained.
    progress
        Show progress bars.

    Returns
    -------
    pandas.DataFrame
        As :func:`repro_companion.twins.table_1_method.run`, after a column ``factor``.
    """
    tables = []
    for factor, n_segments in robots.items():
        folder = cache / factor.replace(" ", "_")
        for n in n_segments:
            for seed in seeds:
                train_factor(factor, n, seed, folder, progress=progress)
        rows = [row for row in ROWS if row.n_segments in n_segments and row.earth_axis is None]
        table = run(rows, seeds, folder)
        table.insert(0, "factor", factor)
        tables.append(table)
    return pd.concat(tables, ignore_index=True)


def train_factor(factor: str, n_segments: int, seed: int, folder: Path, *, progress: bool = False) -> None:
    """Train the networks of all segments of a robot side by side, if one is missing; ten to twenty minutes."""
    specs = [NetworkSpec(n_segments, segment, earth=False, seed=seed) for segment in range(n_segments)]
    if all((folder / f"{spec.name}.safetensors").exists() for spec in specs):
        return
    options = {"data_seed": DATA_SEED, "shuffled": False} | FACTORS[factor]
    data_seed = options.pop("data_seed")
    sets = [training_rows(n_segments, k, earth=False, data_seed=data_seed) for k in range(n_segments)]
    trained = train_together(sets, seed=seed, learning_rate=PCC_LEARNING_RATE, progress=progress, **options)
    for spec, (network, metrics) in zip(specs, trained, strict=True):
        manifest = {"recipe": "paper", "changed": factor, **asdict(spec), "metrics_mt": metrics}
        save_weights(network, folder / f"{spec.name}.safetensors", manifest)
