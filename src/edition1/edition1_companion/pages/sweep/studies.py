"""The study of the page on sweeps: the table that its command joins, from one process."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import pandas as pd

from edition1_companion.book.studies import Study
from edition1_companion.book.sweep_grid import grid_points
from edition1_companion.twins.sensor_count import sensor_count_errors

GRID = {"n_segments": [1, 2, 3], "n_sensors": [2, 3, 4, 6], "noise_mt": [4.8e-5, 7.1e-4, 0.005, 0.02]}
"""As ``repro sweep notebooks/sensor_count.ipynb`` is given it."""


def sensor_sweep(*, grid: Mapping[str, Sequence[float]], seed: int, draws: int) -> pd.DataFrame:
    """Errors at every point of a grid: its parameters, then the columns of :func:`sensor_count_errors`."""
    tables = []
    for point in grid_points(grid):
        table = sensor_count_errors(**point, seed=seed, draws=draws)
        tables.append(pd.concat([pd.DataFrame(point, index=table.index), table], axis=1))
    return pd.concat(tables, ignore_index=True)


STUDIES = (Study("sensor_sweep", sensor_sweep, {"grid": GRID, "seed": 0, "draws": 10}, digits=10),)
