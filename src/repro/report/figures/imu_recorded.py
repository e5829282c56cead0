"""Figures of the recorded trial: our chain beside the released output, and models with fewer IMUs."""

# The stubs of matplotlib and pandas know less than the libraries do.
# pyright: reportArgumentType=false, reportCallIssue=false, reportAttributeAccessIssue=false

from __future__ import annotations

import matplotlib.pyplot as plt
import numpy as np
import pandas as pd
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from repro.report.style import page_figure

STYLES = {
    "rigid-body": ("#D55E00", "s"),
    "PCC-extended, 16 segments": ("#0072B2", "o"),
    "spline": ("#009E73", "D"),
}
"""Colour and marker of each model."""


@page_figure
def chain_beside_output(points: pd.DataFrame, over_rows: pd.DataFrame, source: str) -> Figure:
    """Distance between our chain and the released one, per point (left) and over the rows (right).

    Parameters
    ----------
    points
        Columns ``arc_mm, median_mm, q75_mm, from_second_median_mm, turned_median_mm``.
    over_rows
        Column ``row``, and ``point_k_mm`` for the points.
    source
        "recorded" or "synthetic"; stands in the title.
    """
    figure, (left, right) = plt.subplots(1, 2, figsize=(9.0, 3.4), width_ratios=(2, 3))
    arcs = points["arc_mm"]
    left.plot(arcs, points["median_mm"], "o-", color="#0072B2", label="median")
    left.plot(arcs, points["q75_mm"], "^:", color="#0072B2", label="Q3")
    left.plot(
        arcs, points["from_second_median_mm"], "s--", color="#D55E00", label="median, from the second point"
    )
    left.plot(arcs, points["turned_median_mm"], "D-.", ms=4, color="#009E73", label="median, IMUs turned")
    highest = float(points["q75_mm"].max())
    left.set(xlabel="distance from the base [mm]", ylabel="distance between chains [mm]")
    left.set(xlim=(0, None), ylim=(0, 1.65 * max(highest, 0.1)), title=f"Per point, {source}")
    left.legend(loc="upper left")
    names = [name for name in over_rows if str(name).startswith("point_")]
    for name, colour, label in ((names[1], "#56B4E9", "second point"), (names[-1], "#0072B2", "last point")):
        right.plot(over_rows["row"], over_rows[name], color=colour, lw=0.8, label=label)
    right.set(xlabel="row of the released table", ylabel="distance between chains [mm]")
    right.set(title=f"Over the trial, {source}", ylim=(0, None))
    right.legend(loc="upper right", ncols=2)
    low, high = right.get_ylim()
    right.set_ylim(low, 1.15 * high)
    return figure


@page_figure
def fewer_imus(table: pd.DataFrame, source: str) -> Figure:
    """Distance from the model with all IMUs: medians, and lines up to Q3, one panel per point.

    Parameters
    ----------
    table
        Columns ``model, n_imus, point_mm, median_mm, q75_mm``.
    source
        "recorded" or "synthetic"; stands in the title.
    """
    points, counts = np.unique(table["point_mm"]), np.unique(table["n_imus"])
    size = (3.0 * len(points), 3.3)
    figure, panels = plt.subplots(1, len(points), figsize=size, sharey=True, squeeze=False)
    for panel, point in zip(panels[0], points, strict=True):
        for k, (model, (colour, marker)) in enumerate(STYLES.items()):
            part = table[(table["model"] == model) & (table["point_mm"] == point)]
            x = np.searchsorted(counts, part["n_imus"]) + 0.2 * (k - 1)
            panel.vlines(x, part["median_mm"], part["q75_mm"], color=colour, lw=1.5)
            panel.plot(x, part["median_mm"], marker, color=colour, ms=5)
        panel.set_xticks(range(len(counts)), [f"{n:g}" for n in counts])
        panel.set(title=f"at {point:.0f} mm, {source}", xlabel="IMUs", xlim=(-0.5, len(counts) - 0.5))
        panel.grid(axis="x", visible=False)
    panels[0, 0].set(ylim=(0, None), ylabel="distance from PCC-extended,\n8 IMUs [mm]")
    handles = [Line2D([], [], color=c, marker=k, ls="none", label=m) for m, (c, k) in STYLES.items()]
    handles.append(Line2D([], [], color="0.3", label="from the median to Q3"))
    figure.legend(handles=handles, loc="outside upper center", ncols=4)
    return figure
