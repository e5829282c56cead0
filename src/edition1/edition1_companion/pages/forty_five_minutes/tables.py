"""Tables of the page: errors by twin and over time, what they share, what became of the iron, and calibrations."""

from __future__ import annotations

import numpy as np
import pandas as pd

from edition1.estimation.self_calibration import SelfCalibratingFilter
from edition1_companion.book.bootstrap import interval, resampled
from edition1_companion.pages.forty_five_minutes.methods import LAST_MINUTES, METHODS


def by_twin(minutes: pd.DataFrame, last: int = LAST_MINUTES) -> pd.DataFrame:
    """Root mean square error of the tip and mean normalised error over the last minutes.

    Columns ``twin, method, tip_rmse_percent, nees``.

    Parameters
    ----------
    minutes
        Columns of the study ``forty_five_minutes``.
    last
        Minutes at the end that count.
    """
    end = minutes[minutes["minute"] > minutes["minute"].max() - last]
    end = end.assign(tip_rmse_percent=end["tip_rmse_percent"] ** 2)
    means = end.groupby(["twin", "method"], sort=False)[["tip_rmse_percent", "nees"]].mean().reset_index()
    return means.assign(tip_rmse_percent=np.sqrt(means["tip_rmse_percent"].to_numpy()))


def summary(twins: pd.DataFrame) -> pd.DataFrame:
    """By method, the median, smallest and largest error of the twins; their mean NEES with its 95 % interval."""
    rows = []
    for method in METHODS:
        here = twins[twins["method"] == method]
        tip, nees = here["tip_rmse_percent"], here["nees"].to_numpy()
        low, high = interval(nees[resampled(len(nees), 0)].mean(-1))
        rows.append((method, tip.median(), tip.min(), tip.max(), nees.mean(), low, high))
    columns = ["method", "median_percent", "least_percent", "most_percent", "nees", "nees_low", "nees_high"]
    return pd.DataFrame(rows, columns=columns)


def drift_left(twins: pd.DataFrame) -> pd.Series:
    """What self-calibration leaves of the error that the drift adds to the fusion, for each twin."""
    tip = twins.pivot(index="twin", columns="method", values="tip_rmse_percent")
    return (tip["self-calibrating"] - tip["oracle"]) / (tip["fused"] - tip["oracle"])


def over_time(minutes: pd.DataFrame) -> pd.DataFrame:
    """Median, smallest and largest error of the twins, by method and minute."""
    grouped = minutes.groupby(["method", "minute"], sort=False)["tip_rmse_percent"]
    columns = {"median_percent": "median", "least_percent": "min", "most_percent": "max"}
    return grouped.agg(**columns).reset_index()


def iron(minutes: pd.DataFrame) -> pd.DataFrame:
    """By twin, the error of the tip in the minutes with iron, and flags then and at other times [s].

    Columns ``twin, fused_percent, self_percent, oracle_percent, flag_s, false_s``; flags are those of the filter that
    calibrates itself.
    """
    near = minutes[minutes["iron_s"] > 0]
    near = near.assign(square=near["tip_rmse_percent"] ** 2 * near["iron_s"])
    by = {"index": "twin", "columns": "method", "aggfunc": "sum"}
    tip = (near.pivot_table("square", **by) / near.pivot_table("iron_s", **by)) ** 0.5
    own = minutes[minutes["method"] == "self-calibrating"].groupby("twin")
    table = pd.DataFrame(
        {
            "fused_percent": tip["fused"],
            "self_percent": tip["self-calibrating"],
            "oracle_percent": tip["oracle"],
            "flag_s": own["flag_iron_s"].sum(),
            "false_s": own["flag_else_s"].sum(),
        }
    )
    return table.reset_index()


def learnt(method: SelfCalibratingFilter, errors_std: np.ndarray, times_s: np.ndarray) -> pd.DataFrame:
    """How uncertain errors of each kind are, over what they would be without readings, at the end of every minute.

    Columns ``minute, kind, share``: the mean over the errors of a kind; those that fade fast are left out.
    """
    lasting = np.isinf(method.errors.fast_std)
    kinds = np.array([name.split()[0] for name in method.errors.names])
    rows = []
    for k in np.flatnonzero(np.diff(times_s // 60, append=-1)):
        share = errors_std[k] / method.errors.prior_std(float(times_s[k]))
        for kind in dict.fromkeys(kinds[lasting]):
            rows.append((int(times_s[k] // 60) + 1, kind, share[lasting & (kinds == kind)].mean()))
    return pd.DataFrame(rows, columns=["minute", "kind", "share"])


def against_poses(draws: pd.DataFrame) -> pd.DataFrame:
    """By robot, what is off and calibration: error of the tip, that stated, and both against calibration with poses.

    Columns ``robot, off, calibration, minutes``, then over the draws ``median_percent, least_percent, most_percent``
    of the error, ``stated_percent``, its median, and ``ratio_median, ratio_least, ratio_most`` to the error of the
    same robot calibrated with poses; ``robots`` counts those that were not refused.

    Parameters
    ----------
    draws
        Columns of the studies ``forty_five_minutes_poses_1`` and so on.
    """
    same = ["robot", "off", "draw"]
    posed = draws[draws["calibration"] == "poses"].set_index(same)["tip_rmse_percent"].rename("posed")
    ratio = draws["tip_rmse_percent"] / draws.join(posed, on=same)["posed"]
    grouped = draws.assign(ratio=ratio).groupby(["robot", "off", "calibration", "minutes"], sort=False)
    return grouped.agg(
        robots=("draw", "size"),
        median_percent=("tip_rmse_percent", "median"),
        least_percent=("tip_rmse_percent", "min"),
        most_percent=("tip_rmse_percent", "max"),
        stated_percent=("stated_percent", "median"),
        ratio_median=("ratio", "median"),
        ratio_least=("ratio", "min"),
        ratio_most=("ratio", "max"),
    ).reset_index()
