"""Figure of the page on one robot with three sets of sensors: errors by trajectory, and what robustness costs."""

from __future__ import annotations

import matplotlib.pyplot as plt
import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from edition1_companion.pages.one_robot.estimates import METHODS
from edition1_companion.pages.one_robot.tables import CONDITIONS, QUANTITIES
from edition1_companion.twins.segment_motion import TRAJECTORIES
from edition1_live.view.style import WIDTH_IN, page_figure, plain_ticks

STYLES = dict(
    zip(METHODS, (("#0072B2", "o"), ("#D55E00", "s"), ("#CC79A7", "D"), ("#009E73", "^")), strict=True)
)
TITLES = (
    "error of the tip's position [mm]",
    "error of the tip's orientation [deg]",
    "error of the shape [mm]",
)
ROBUSTNESS = (
    (TRAJECTORIES[0], CONDITIONS[0], "all\nsensors"),
    (TRAJECTORIES[0], CONDITIONS[1], "worst\nfailed"),
    (TRAJECTORIES[0], CONDITIONS[2], "other\nmagnet"),
    (TRAJECTORIES[2], CONDITIONS[0], "load on\nthe tip"),
)
"""Trajectory and condition of each place of the last panel, and its name."""


@page_figure
def three_ways(means: pd.DataFrame) -> Figure:
    """Errors of every method on every trajectory; last, what becomes of the calibrated ones if something goes amiss.

    Filled marks are calibrated, open ones as drawn; bars are 95 % intervals of the means.

    Parameters
    ----------
    means
        Columns of :func:`edition1_companion.pages.one_robot.tables.mean_errors`.
    """
    figure, panels = plt.subplots(2, 2, figsize=(WIDTH_IN, 7.0))
    healthy = means[means["condition"] == CONDITIONS[0]]
    for panel, quantity, title in zip(panels.flat, QUANTITIES, TITLES, strict=False):
        for place, trajectory in enumerate(TRAJECTORIES):
            _marks(panel, place, healthy[healthy["trajectory"] == trajectory], quantity)
        panel.set_ylabel(title)
        panel.set_xticks(range(len(TRAJECTORIES)), [name.replace(" ", "\n", 1) for name in TRAJECTORIES])
    panel = panels[1, 1]
    known = means[means["calibrated"]]
    for place, (trajectory, condition, _) in enumerate(ROBUSTNESS):
        here = known[(known["trajectory"] == trajectory) & (known["condition"] == condition)]
        _marks(panel, place, here, QUANTITIES[0])
    panel.set(title="calibrated, and something amiss", ylabel=TITLES[0])
    panel.set_xticks(range(len(ROBUSTNESS)), [name for *_, name in ROBUSTNESS])
    for panel in panels.flat:
        panel.set_yscale("log")
        panel.grid(axis="x", visible=False)
        plain_ticks(panel.yaxis)
    handles = [Line2D([], [], color=c, marker=m, ls="", label=name) for name, (c, m) in STYLES.items()]
    handles.append(Line2D([], [], color="0.3", marker="o", ls="", label="calibrated"))
    handles.append(Line2D([], [], color="0.3", marker="o", mfc="white", ls="", label="as drawn"))
    figure.legend(handles=handles, loc="outside upper center", ncols=2)
    return figure


def _marks(panel: Axes, place: int, here: pd.DataFrame, quantity: str) -> None:
    """Mean and interval of every method beside each other; as drawn a little to the right."""
    name, unit = quantity.rsplit("_", 1)
    for k, (method, (colour, marker)) in enumerate(STYLES.items()):
        for line in here[here["method"] == method].to_dict("records"):
            x = place + 0.19 * (k - 1.5) + (0.0 if line["calibrated"] else 0.06)
            ends = [
                [line[quantity] - line[f"{name}_low_{unit}"]],
                [line[f"{name}_high_{unit}"] - line[quantity]],
            ]
            fill = colour if line["calibrated"] else "white"
            panel.errorbar(
                x, line[quantity], yerr=np.array(ends), fmt=marker, color=colour, mfc=fill, ms=5, capsize=2
            )
