"""Figure of the filter over time: its gain over least squares, and its errors within their bands."""

from __future__ import annotations

import matplotlib.pyplot as plt
import numpy as np
import pandas as pd
from edition1_live.view.style import WIDTH_IN, page_figure
from matplotlib.figure import Figure

COLOURS = {"Levenberg-Marquardt": "#0072B2", "Kalman filter": "#D55E00"}


@page_figure
def gain_and_bands(gains: pd.DataFrame, over_time: pd.DataFrame) -> Figure:
    """Ratio of the errors by trajectory and robot, above one coordinate over time with two standard deviations.

    Parameters
    ----------
    gains
        Columns of ``filter_to_least_squares``; the trajectory that the choice was made on is drawn open.
    over_time
        Columns ``time_s, method, error_mm, two_sigma_mm``, of one coordinate.
    """
    figure, (left, right) = plt.subplots(2, 1, figsize=(WIDTH_IN, 6.4))
    names, robots = list(dict.fromkeys(gains["trajectory"])), sorted(gains["n_b"].unique())
    for k, n_b in enumerate(robots):
        part = gains[gains["n_b"] == n_b].set_index("trajectory").loc[names]
        at, ratio = np.arange(len(names)) + 0.18 * (k - (len(robots) - 1) / 2), part["ratio"].to_numpy()
        bars = np.abs(np.stack([part["ratio_low"], part["ratio_high"]]) - ratio)
        colour, marker = (("#009E73", "o"), ("#CC79A7", "s"), ("#E69F00", "D"))[k % 3]
        left.errorbar(at, ratio, bars, fmt="none", lw=1.2, color=colour)
        for chosen in (False, True):
            here = part["chosen_here"].to_numpy() == chosen
            face, label = ("white", None) if chosen else (colour, f"$n_b = {n_b}$")
            left.plot(at[here], ratio[here], marker, ms=5, color=colour, mfc=face, label=label)
    left.axhline(1.0, color="0.6", lw=0.8, ls="--")
    left.set(ylim=(0, 1.4), xticks=range(len(names)), ylabel="error of the filter / least squares")
    left.set_xticklabels(names)
    left.legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=len(robots))
    for method, part in over_time.groupby("method", sort=False):
        colour, t = COLOURS[method], part["time_s"]
        right.fill_between(t, -part["two_sigma_mm"], part["two_sigma_mm"], color=colour, alpha=0.15, lw=0)
        right.plot(t, part["error_mm"], color=colour, lw=0.8, label=method)
    right.set(xlabel="time [s]", ylabel=r"error of $\Delta_x$ [mm]")
    right.legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=2)
    return figure
