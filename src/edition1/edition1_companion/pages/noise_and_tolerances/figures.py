"""Figures of the page on noise and tolerances."""

from __future__ import annotations

import matplotlib.pyplot as plt
import pandas as pd
from edition1_live.view.style import WIDTH_IN, page_figure, plain_ticks, wrapped_panels
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from edition1_companion.pages.noise_and_tolerances.noise import REAL_MT
from edition1_companion.pages.noise_and_tolerances.tolerances import KINDS

LOOKS = {
    "network of the paper": ("#0072B2", "o"),
    "fast network": ("#E69F00", "s"),
    "dipole and residual": ("#009E73", "^"),
    "multipole": ("#D55E00", "D"),
    "3 moments": ("#CC79A7", "v"),
    "5 moments": ("#D55E00", "D"),
}
"""Colour and marker of every sensor model."""
SEGMENTS = {1: ("#0072B2", "o"), 2: ("#009E73", "^"), 3: ("#D55E00", "D")}


@page_figure
def noise_curves(table: pd.DataFrame) -> Figure:
    """Mean error against the noise of the sensors: a column of panels per solver, a row per robot.

    The dashed line is the Cramér-Rao bound, the grey band the noise of the real sensors.

    Parameters
    ----------
    table
        Columns of :func:`edition1_companion.pages.noise_and_tolerances.noise.against_bound`.
    """
    solvers, robots = list(dict.fromkeys(table["solver"])), sorted(set(table["n_b"]))
    size = (WIDTH_IN, 2.4 * len(robots) + 1.0)
    figure, panels = plt.subplots(
        len(robots), len(solvers), figsize=size, sharex=True, sharey=True, squeeze=False
    )
    models = [model for model in LOOKS if model in set(table["model"])]
    for column, solver in zip(panels.T, solvers, strict=True):
        for panel, n_b in zip(column, robots, strict=True):
            here = table[(table["solver"] == solver) & (table["n_b"] == n_b)]
            panel.axvspan(*REAL_MT, color="0.92", zorder=0)
            for model in models:
                part = here[here["model"] == model].sort_values("noise_mt")
                colour, marker = LOOKS[model]
                panel.plot(part["noise_mt"], part["mean_percent"], color=colour, marker=marker, ms=4, lw=1.2)
            limit = here.drop_duplicates("noise_mt").sort_values("noise_mt")
            panel.plot(limit["noise_mt"], limit["bound_percent"], "--", color="black", lw=1.2)
            panel.set(xscale="log", yscale="log")
            panel.set_title(f"{solver}, $n_b = {n_b}$", loc="left")
            plain_ticks(panel.yaxis, subs=(1,))
        column[-1].set_xlabel("noise of a sensor [mT]")
    for panel in panels[:, 0]:
        panel.set_ylabel("mean relative error [%]")
    handles = [Line2D([], [], color=LOOKS[m][0], marker=LOOKS[m][1], ms=4, lw=1.2, label=m) for m in models]
    handles.append(Line2D([], [], color="black", ls="--", lw=1.2, label="Cramér-Rao bound"))
    handles.append(Line2D([], [], color="0.88", lw=7, label="real sensors"))
    figure.legend(handles=handles, loc="outside upper center", ncols=2)
    return figure


@page_figure
def tolerance_curves(means: pd.DataFrame, here: pd.DataFrame) -> Figure:
    """Mean error against the size of every tolerance: points with intervals, and lines of first order.

    Parameters
    ----------
    means
        Columns of :func:`edition1_companion.pages.noise_and_tolerances.tolerances.tolerance_means`: the committed study.
    here
        The same for what was computed with parameters of the reader: open circles.
    """
    kinds = [kind for kind in KINDS if kind in set(means["kind"])]
    figure, panels = wrapped_panels(len(kinds), 2, 2.3, sharey=True)
    robots = sorted(set(means["n_b"]))
    for panel, kind in zip(panels, kinds, strict=True):
        for n_b in robots:
            part = means[(means["kind"] == kind) & (means["n_b"] == n_b) & (means["size"] > 0)]
            colour, marker = SEGMENTS.get(n_b, ("0.3", "s"))
            error = part["error_percent"]
            spread = [error - part["low_percent"], part["high_percent"] - error]
            panel.errorbar(part["size"], error, yerr=spread, fmt=marker, ms=4, lw=1.1, color=colour)
            panel.plot(part["size"], part["linear_percent"], "-", color=colour, lw=1.0, alpha=0.8)
        part = here[(here["kind"] == kind) & (here["size"] > 0)]
        panel.plot(part["size"], part["error_percent"], "o", color="black", ms=7, mfc="none", lw=1.0)
        panel.axhline(1.0, color="0.5", lw=0.9, ls=":")
        name, unit, _ = KINDS[kind]
        panel.set(xscale="log", yscale="log", xlabel=f"{name} [{unit.replace('deg', '°')}]")
        plain_ticks(panel.xaxis, subs=(1, 3))
        panel.yaxis.set_major_formatter("{x:g}")
    for panel in panels[::2]:
        panel.set_ylabel("mean relative error [%]")
    handles = []
    for n_b in robots:
        colour, marker = SEGMENTS.get(n_b, ("0.3", "s"))
        handles.append(Line2D([], [], color=colour, marker=marker, ms=4, ls="", label=f"$n_b = {n_b}$"))
    handles.append(Line2D([], [], color="black", marker="o", ms=7, mfc="none", ls="", label="computed here"))
    handles.append(Line2D([], [], color="0.3", lw=1.0, label="first order"))
    handles.append(Line2D([], [], color="0.5", lw=0.9, ls=":", label="1 %"))
    figure.legend(handles=handles, loc="outside upper center", ncols=3)
    return figure


@page_figure
def data_size_curves(table: pd.DataFrame, bound_percent: float) -> Figure:
    """Error of the readings and of the configuration against the number of training configurations.

    Lines are means over the seeds, points single seeds; the paper's networks are points.

    Parameters
    ----------
    table
        Columns of :func:`edition1_companion.pages.noise_and_tolerances.data_size.data_size_errors`.
    bound_percent
        Cramér-Rao bound of the configuration at the noise of the table [%].
    """
    figure, panels = plt.subplots(2, 1, figsize=(WIDTH_IN, 6.6))
    models = [model for model in LOOKS if model in set(table["model"])]
    labels = ("error of the readings $e_u$ [mT]", "error of the configuration [%]")
    for panel, column, label in zip(panels, ("e_u_mt", "noisy_percent"), labels, strict=True):
        for model in models:
            part = table[table["model"] == model]
            colour, marker = LOOKS[model]
            panel.plot(part["configurations"], part[column], marker, color=colour, ms=3.5, alpha=0.6)
            means = part.groupby("configurations")[column].mean()
            panel.plot(means.index, means, "-", color=colour, lw=1.2)
        panel.set(xscale="log", yscale="log", xlabel="training configurations", ylabel=label)
    panels[1].axhline(bound_percent, color="black", ls="--", lw=1.2)
    plain_ticks(panels[1].yaxis)
    handles = [Line2D([], [], color=LOOKS[m][0], marker=LOOKS[m][1], ms=4, lw=1.2, label=m) for m in models]
    handles.append(Line2D([], [], color="black", ls="--", lw=1.2, label="Cramér-Rao bound"))
    figure.legend(handles=handles, loc="outside upper center", ncols=3)
    return figure
