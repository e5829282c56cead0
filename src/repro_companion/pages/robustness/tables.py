"""What the errors on random twins come to, by twin, by family and by trajectory."""

from __future__ import annotations

from typing import cast

import numpy as np
import pandas as pd

from repro_companion.book.bootstrap import interval, resampled
from repro_companion.pages.robustness.studies import METHODS


def ratios(table: pd.DataFrame) -> pd.DataFrame:
    """Error of ours over that of the paper's method, for each twin: geometric mean over trajectories and axes.

    Returns
    -------
    pandas.DataFrame
        ``family, twin, hysteresis, drift, drift_mV, known, mean, shorter, worst, covered``: the ratios to the
        variants, the trajectory and axis with the largest ratio to the first, the mean share of frames in the 95 %
        ellipse.
    """
    rows = []
    for _, part in table.groupby(["family", "twin"], sort=False):
        against = _log_ratios(part)
        known = against["known"]
        row, axis = np.unravel_index(known.argmax(), known.shape)
        first = part.iloc[0]
        rows.append(
            {name: first[name] for name in ("family", "twin", "hysteresis", "drift", "drift_mV")}
            | {m: float(np.exp(x.mean())) for m, x in against.items()}
            | {
                "worst": f"{part['trajectory'].iloc[row]} {'xy'[axis]}: {np.exp(known.max()):.2f}",
                "covered": part["covered"].mean(),
            }
        )
    return pd.DataFrame(rows)


def medians(table: pd.DataFrame, *, draws: int) -> pd.DataFrame:
    """Median ratio over the twins of a family with a bootstrap 95 % interval, over all of them and by kind of twin.

    Returns
    -------
    pandas.DataFrame
        ``family, kind, twins, against, median, low, high, lost, covered``: the number of twins whose ratio is above
        one, and the mean share of frames in the 95 % ellipse.
    """
    rng, rows, groups = np.random.default_rng(0), [], []
    for family, per_twin in ratios(table).groupby("family", sort=False):
        groups.append((family, "all", per_twin))
        for column in ("hysteresis", "drift"):
            groups += [(family, kind, part) for kind, part in per_twin.groupby(column)]
    for family, kind, part in groups:
        for against in METHODS[:-1]:
            values = part[against].to_numpy()
            low, high = interval(np.median(values[resampled(len(values), rng, bootstraps=draws)], axis=1))
            rows.append(
                {
                    "family": family,
                    "kind": kind,
                    "twins": len(values),
                    "against": against,
                    "median": np.median(values),
                    "low": low,
                    "high": high,
                    "lost": int((values > 1).sum()),
                    "covered": part["covered"].mean(),
                }
            )
    return pd.DataFrame(rows)


def by_trajectory(table: pd.DataFrame) -> pd.DataFrame:
    """How ours fares on each trajectory, over the twins of a family.

    Returns
    -------
    pandas.DataFrame
        ``family, trajectory``; the ratios ``known`` and ``shorter``, geometric means over twins and axes;
        ``lost_%`` and ``lost_to_shorter_%``, shares of twins and axes on which the error of ours is larger; and the
        means of ``covered, nees, covered_delta_L, ours_delta_L_mm``, see
        :func:`~repro_companion.pages.robustness.studies.twin_errors`.
    """
    rows = []
    for cell, part in table.groupby(["family", "trajectory"], sort=False):
        family, name = cast("tuple[str, str]", cell)
        against = _log_ratios(part)
        known, shorter = against["known"], against["shorter"]
        rows.append(
            {
                "family": family,
                "trajectory": name,
                "known": float(np.exp(known.mean())),
                "shorter": float(np.exp(shorter.mean())),
                "lost_%": 100 * float((known > 0).mean()),
                "lost_to_shorter_%": 100 * float((shorter > 0).mean()),
            }
            | {m: part[m].mean() for m in ("covered", "nees", "covered_delta_L", "ours_delta_L_mm")}
        )
    return pd.DataFrame(rows)


def _log_ratios(part: pd.DataFrame) -> dict[str, np.ndarray]:
    """Logarithms of the ratios of ours to each variant of the paper's method, by trajectory and axis."""
    logs = {m: np.log(part[[f"{m}_delta_{a}_mm" for a in "xy"]].to_numpy()) for m in METHODS}
    return {m: logs["ours"] - logs[m] for m in METHODS[:-1]}
