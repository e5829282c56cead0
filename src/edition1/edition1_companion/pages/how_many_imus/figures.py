"""Figures of the page on the number of IMUs: error by number and model, by placement, with sensor errors."""

from __future__ import annotations

from collections.abc import Sequence

import matplotlib.pyplot as plt
import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import NullFormatter, NullLocator

from edition1_live.view.style import WIDTH_IN, page_figure, plain_ticks, wrapped_panels

STYLES = {
    "rigid-body, IMU at the end": ("#D55E00", "s"),
    "rigid-body, IMU in the middle": ("#E69F00", "^"),
    "PCC-extended": ("#0072B2", "o"),
    "exact arcs": ("#56B4E9", "v"),
    "spline": ("#009E73", "D"),
}
"""Colour and marker of each model."""


@page_figure
def errors_and_bounds(tables: Sequence[pd.DataFrame], titles: Sequence[str]) -> Figure:
    """Largest error of the tip over the curves, and the bound, by number of IMUs; one panel per table.

    Parameters
    ----------
    tables
        Columns ``model, n_imus, largest_mm, bound_mm``.
    titles
        One per table.
    """
    figure, panels = wrapped_panels(len(tables), 1, 3.2, sharex=True, sharey=True)
    for panel, table, title in zip(panels, tables, titles, strict=True):
        for model, part in table.groupby("model", sort=False):
            colour, marker = STYLES[str(model)]
            panel.plot(part["n_imus"], part["largest_mm"], f"{marker}-", ms=4, color=colour)
            panel.plot(part["n_imus"], part["bound_mm"], "--", lw=1, color=colour)
        panel.set(yscale="log", ylabel="error of the tip [mm]", title=title)
        plain_ticks(panel.yaxis, subs=(1,))
        _counts(panel, table["n_imus"])
    panels[-1].set_xlabel("IMUs")
    handles = [Line2D([], [], color=c, marker=m, ms=4, label=name) for name, (c, m) in STYLES.items()]
    handles.append(Line2D([], [], color="0.3", ls="--", lw=1, label="bound of the same colour"))
    figure.legend(handles=handles, loc="outside upper center", ncols=2)
    return figure


@page_figure
def placement_and_sensors(placement: pd.DataFrame, sensors: pd.DataFrame, length_mm: float) -> Figure:
    """Largest error by crowding towards the base (top); median error with errors of the sensors (bottom).

    Parameters
    ----------
    placement
        Columns ``model, n_imus, crowding, largest_mm``.
    sensors
        Columns ``model, n_imus, sensor_deg, median_mm``.
    length_mm
        Length of the arm, for the line of the rule.
    """
    figure, (left, right) = plt.subplots(2, 1, figsize=(WIDTH_IN, 7.2))
    shown = ["rigid-body, IMU in the middle", "PCC-extended", "spline"]
    counts = np.unique(placement["n_imus"])
    for n, style in zip(counts, ("-", "--", ":"), strict=False):
        for model in shown:
            part = placement[(placement["model"] == model) & (placement["n_imus"] == n)]
            colour, marker = STYLES[model]
            left.plot(part["crowding"], part["largest_mm"], marker, ls=style, ms=4, color=colour)
    left.set(
        yscale="log", xlabel="crowding towards the base (1: even)", ylabel="largest error of the tip [mm]"
    )
    left.set_title("Shapes of the synthetic arm, perfect IMUs")
    lines = [
        Line2D([], [], color="0.3", ls=s, label=f"{n:g} IMUs")
        for n, s in zip(counts, ("-", "--", ":"), strict=False)
    ]
    left.legend(handles=lines, loc="center left", bbox_to_anchor=(1.0, 0.5))
    plain_ticks(left.yaxis)
    angles = np.unique(sensors["sensor_deg"])
    for angle, style in zip(angles, ("-", "--", ":", "-."), strict=False):
        here = sensors[sensors["sensor_deg"] == angle]
        for model in shown:
            part = here[here["model"] == model]
            right.plot(part["n_imus"], part["median_mm"], ls=style, color=STYLES[model][0], lw=1.3)
        if angle > 0:
            n = np.unique(here["n_imus"])
            right.plot(n, np.deg2rad(angle) * length_mm * np.sqrt(2 / n), ls=style, color="0.6", lw=1)
    right.set(yscale="log", xlabel="IMUs", ylabel="median error of the tip [mm]")
    right.set_title("Random curves, with sensor errors")
    _counts(right, sensors["n_imus"])
    lines = [
        Line2D([], [], color="0.3", ls=s, label=f"{a:g}°")
        for a, s in zip(angles, ("-", "--", ":", "-."), strict=False)
    ]
    right.legend(handles=lines, loc="center left", bbox_to_anchor=(1.0, 0.5), title="each axis")
    plain_ticks(right.yaxis, subs=(1,))
    handles = [Line2D([], [], color=STYLES[m][0], marker=STYLES[m][1], ms=4, label=m) for m in shown]
    handles.append(Line2D([], [], color="0.6", lw=1, label=r"$\sigma L\,(2/n)^{1/2}$"))
    figure.legend(handles=handles, loc="outside upper center", ncols=2)
    return figure


def _counts(panel: Axes, counts: pd.Series) -> None:
    panel.set_xscale("log")
    ticks = np.unique(counts)
    panel.set_xticks(ticks, [f"{n:g}" for n in ticks])
    panel.xaxis.set_minor_formatter(NullFormatter())
    panel.xaxis.set_minor_locator(NullLocator())
