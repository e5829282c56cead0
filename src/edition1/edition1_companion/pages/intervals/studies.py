"""How far the bend filter is off on random twins of the rig, and how far it says it is; all numbers are SYNTHETIC."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pandas as pd
from edition1.estimation.base import Trajectory

from edition1_companion.book.studies import Study
from edition1_companion.recordings.baaij2023 import Recording
from edition1_companion.recordings.rig_robot import RIG_RATE_HZ
from edition1_companion.twins.rig_data import RigData, load_recordings
from edition1_companion.twins.rig_filter import filtered
from edition1_companion.twins.rig_map import fit_map
from edition1_companion.twins.rig_twins import random_twin

TWINS = tuple(range(24))
"""Seeds of the random twins; methods were chosen on seeds 1000 to 1003."""
AS_IT_IS, NO_LAG = "as it is", "no lag across the bend"


def distances(
    *, twins: Sequence[int], longest_s: float, every_s: float, unlagged: Sequence[str]
) -> pd.DataFrame:
    """Mahalanobis distance of the bend from the truth, in time.

    Parameters
    ----------
    twins
        Seeds.
    longest_s
        Length of each test part [s].
    every_s
        One estimate in this time is kept [s].
    unlagged
        Trajectories that are also recorded by the same twin without its lag across the direction of bending.

    Returns
    -------
    pandas.DataFrame
        Columns ``twin, changed, trajectory, time_s, distance, deviation_mm``: the last is the geometric mean of the
        standard deviations along the axes of the stated ellipse.
    """
    tables = []
    for seed in twins:
        config = random_twin(seed)
        data = load_recordings("twin", config=config)
        tables.append(_of_parts(data, longest_s, every_s).assign(twin=seed, changed=AS_IT_IS))
        config = replace(config, inner=replace(config.inner, across_s=0.0))
        data = load_recordings("twin", config=config, trajectories=[*unlagged])
        tables.append(_of_parts(data, longest_s, every_s).assign(twin=seed, changed=NO_LAG))
    columns = ["twin", "changed", "trajectory", "time_s", "distance", "deviation_mm"]
    return pd.concat(tables, ignore_index=True)[columns]


def _of_parts(data: RigData, longest_s: float, every_s: float) -> pd.DataFrame:
    bend_map, tables = fit_map(data.train), []
    every = round(every_s * RIG_RATE_HZ)
    for name, part in data.shortened(longest_s).items():
        found = filtered(bend_map, part.u)
        distance, deviation_mm = distance_and_deviation(found, part)
        table = pd.DataFrame({"distance": distance, "deviation_mm": deviation_mm})
        tables.append(table.assign(trajectory=name, time_s=table.index / RIG_RATE_HZ).iloc[::every])
    return pd.concat(tables)


def distance_and_deviation(found: Trajectory, part: Recording) -> tuple[np.ndarray, np.ndarray]:
    """Mahalanobis distance of the bend from the truth, and the geometric mean of its stated deviations [mm]."""
    assert found.covariance is not None
    error, C = (found.q.numpy() - part.q)[:, :2], found.covariance.numpy()[:, :2, :2]
    squared = np.einsum("ti,ti->t", error, np.linalg.solve(C, error[..., None])[..., 0])
    return np.sqrt(squared), 1e3 * np.linalg.det(C) ** 0.25


STUDIES = (
    Study(
        "intervals_twins",
        distances,
        {"twins": list(TWINS), "longest_s": 60.0, "every_s": 1.0, "unlagged": ["T3"]},
        digits=4,
    ),
)
