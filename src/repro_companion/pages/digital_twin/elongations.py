"""How the elongation differs between recordings: what is known of the authors', beside SYNTHETIC ones of twins."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pandas as pd

from repro_companion.twins.pneumatic_actuation import TRAJECTORIES
from repro_companion.twins.rig_facts import TwinRecordings
from repro_companion.twins.rig_twins import ELONGATION_MM

KNOWN_ELONGATION = {
    name: {"mean_mm": mean, "per_mm2": slope, "centre_x_mm": centre}
    for name, mean, slope, centre in zip(
        TRAJECTORIES,
        ELONGATION_MM,
        (0.0255, 0.0255, -0.038, 0.0255, np.nan, 0.0255),  # the middle of 0.021 to 0.030, of T4 nothing
        (np.nan, 5.1, -2.0, np.nan, np.nan, 1.9),
        strict=True,
    )
}
"""Of the authors' recordings, from running means and variances of networks that were trained on them."""


def elongations_table(twins: Mapping[str, TwinRecordings]) -> pd.DataFrame:
    """What twins and the authors' recordings T0 to T5 (networks trained on them) say of the elongation.

    Returns
    -------
    pandas.DataFrame
        ``of, recording``; mean elongation ``mean_mm``, its change with the square of the bend ``per_mm2``, and the
        mean bend along x ``centre_x_mm``, where known.
    """
    rows = [{"of": "authors", "recording": name} | KNOWN_ELONGATION[name] for name in TRAJECTORIES]
    for of, twin in twins.items():
        for name, recording in twin.read.items():
            x, y, elongation = 1e3 * recording.q.T
            slope = np.polynomial.Polynomial.fit(x**2 + y**2, elongation, 1).convert().coef[1]
            found = {"mean_mm": elongation.mean(), "per_mm2": slope, "centre_x_mm": x.mean()}
            rows.append({"of": of, "recording": name} | found)
    return pd.DataFrame(rows)
