"""Beyond Martin et al. (2022): IMUs calibrated against the motion capture of the first 60 s, judged on the rest.

The study ``martin_calibration`` did this; its code is that of the last commit of the first edition. Nothing was chosen
by what is judged: noise, tolerances and solver are the defaults of `edition1.estimation.imu_calibration`, every tenth
sample of the first 60 s was used (about three a second), and no fit saw the points at 200, 480 and 640 mm. In the
synthetic motion the first 60 s hold one mode, oscillating. The delay between the clocks is found over the whole trial,
as the paper does.
"""

from __future__ import annotations

import numpy as np
import pandas as pd

from edition1_companion.book.bootstrap import ratio_interval, resampled
from edition1_companion.recordings.martin2022_models import MARKERS

BASELINE = "PCC-16"
FRAME, FULL = " + frame", " + all"
"""Ends of the names of calibrated models: frame alone (6 parameters), with heading and mounting of each IMU (27)."""
TARGETS = {"PCC-16" + FRAME: 0.8, "spline" + FULL: 0.6}
"""Largest ratio to the baseline that was set as a target."""
MARKERS_MEAN = "markers"
"""Name of the mean over both markers in :func:`ratios`."""
BOOTSTRAPS = 2000


def ratio_to_uncalibrated(table: pd.DataFrame, *, seed: int = 0) -> pd.DataFrame:
    """Medians against those of the uncalibrated PCC-extended model, with paired bootstrap intervals over the draws.

    Parameters
    ----------
    table
        The study ``martin_calibration``: columns ``draw, method, mode, point_mm, median_mm``.
    seed
        Of the bootstrap.

    Returns
    -------
    DataFrame
        Columns ``method, mode, point`` ("200 mm" and so on; "markers": mean of the medians of both), ``median_mm``
        (mean over the draws), ``ratio`` of it to that of the baseline, with its 95 % interval ``ratio_low`` and
        ``ratio_high``, ``target`` (NaN where none was set) and ``draws``.
    """
    medians = table.pivot_table(index="draw", columns=["method", "mode", "point_mm"], values="median_mm")
    markers = [1e3 * arc for arc in MARKERS]
    points = {MARKERS_MEAN: markers} | {f"{x:g} mm": [x] for x in sorted(table["point_mm"].unique())}
    lines = []
    for method in dict.fromkeys(table["method"]):
        for mode in dict.fromkeys(table["mode"]):
            for name, arcs in points.items():
                ours, base = (
                    medians.loc[:, [(who, mode, x) for x in arcs]].mean(axis=1).to_numpy()
                    for who in (method, BASELINE)
                )
                index = resampled(len(ours), seed, bootstraps=BOOTSTRAPS)
                low, high = ratio_interval(ours, base, index)
                numbers = (ours.mean(), ours.mean() / base.mean(), low, high)
                lines.append((method, mode, name, *numbers, TARGETS.get(method, np.nan), len(ours)))
    columns = ["method", "mode", "point", "median_mm", "ratio", "ratio_low", "ratio_high", "target", "draws"]
    return pd.DataFrame(lines, columns=columns)
