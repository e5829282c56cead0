"""Figures of the page on random twins of the rig."""

from __future__ import annotations

import matplotlib.pyplot as plt
import numpy as np
import pandas as pd
from edition1_live.view.style import WIDTH_IN, page_figure
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import FixedLocator, FuncFormatter, NullFormatter, NullLocator

HYSTERESES = {"bouc-wen": ("#0072B2", "o"), "prandtl-ishlinskii": ("#D55E00", "^")}
"""Colour and marker of each model of hysteresis."""
VARIANTS = {"known": "elongation known", "mean": "mean elongation", "shorter": "known, half the step size"}
"""Variants of the paper's method, and what the panels say of them."""
FAMILIES = {"first": "#0072B2", "second": "#D55E00", "own biases": "#009E73"}
"""Colours of the families of twins."""
AXES = {"x": "o", "y": "^"}
"""Markers of the axes of the bend."""


@page_figure
def twin_ratios(per_twin: pd.DataFrame, title: str) -> Figure:
    """Ratio of the bend filter to the paper's method: each twin against all variants, by family.

    Parameters
    ----------
    per_twin
        Columns of :func:`edition1_companion.pages.robustness.studies.ratio_by_twin`.
    title
        Above the panels.
    """
    figure, panels = plt.subplots(len(VARIANTS), 1, figsize=(WIDTH_IN, 8.4), sharex=True, sharey=True)
    families = list(dict.fromkeys(per_twin["family"]))
    for panel, against in zip(panels, VARIANTS, strict=True):
        for k, family in enumerate(families):
            part = per_twin[per_twin["family"] == family].sort_values(against)
            across = np.linspace(-0.22, 0.22, len(part)) if len(part) > 1 else np.zeros(1)
            for (_, twin), x in zip(part.iterrows(), k + across, strict=True):
                colour, marker = HYSTERESES[twin["hysteresis"]]
                panel.plot(x, twin[against], marker, color=colour, ms=5)
            panel.plot([k - 0.32, k + 0.32], [part[against].median()] * 2, color="black", lw=1.5)
        panel.axhline(1.0, color="0.6", lw=0.8)
        panel.set_xticks(range(len(families)), families)
        panel.set(yscale="log", title=VARIANTS[against], xlim=(-0.5, len(families) - 0.5))
        panel.set_ylabel("bending error:\nbend filter / paper's method")
    panels[0].yaxis.set_major_locator(FixedLocator([0.1, 0.2, 0.3, 0.5, 0.7, 1.0, 1.5, 2.0]))
    panels[0].yaxis.set_minor_locator(NullLocator())
    panels[0].yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    marks = [
        Line2D([], [], ls="", marker=m, color=c, label=name.title()) for name, (c, m) in HYSTERESES.items()
    ]
    marks.append(Line2D([], [], color="black", lw=1.5, label="median"))
    figure.legend(handles=marks, loc="outside lower center", ncols=3)
    figure.suptitle(title)
    return figure


@page_figure
def error_pairs(table: pd.DataFrame, title: str) -> Figure:
    """Error of the bend filter against that of the paper's method, elongation known: a point for each twin and axis.

    Parameters
    ----------
    table
        Columns of :func:`edition1_companion.pages.robustness.studies.twin_errors`.
    title
        Above the panels.
    """
    names, families = (list(dict.fromkeys(table[column])) for column in ("trajectory", "family"))
    figure, panels = plt.subplots(2, 3, figsize=(WIDTH_IN, 5.4), sharex=True, sharey=True)
    errors = table.filter(regex="^(known|ours)_delta_[xy]").to_numpy()
    ends = np.array([0.8 * errors.min(), 1.25 * errors.max()])
    for panel, name in zip(panels.flat, names, strict=False):
        part = table[table["trajectory"] == name]
        for family, of_family in part.groupby("family", sort=False):
            for axis, marker in AXES.items():
                columns = [of_family[f"{m}_delta_{axis}_mm"] for m in ("known", "ours")]
                panel.plot(*columns, marker, color=FAMILIES[family], ms=4, mew=0, alpha=0.55)
        panel.plot(ends, ends, color="0.6", lw=0.8)
        panel.set(xscale="log", yscale="log", xlim=ends, ylim=ends, title=name)
        for side in (panel.xaxis, panel.yaxis):
            side.set_minor_formatter(NullFormatter())
            side.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    # Of the panel: one of the figure would lie on the legend.
    panels[-1, 1].set_xlabel("paper's method, elongation known: RMSE [mm]")
    for panel in panels[:, 0]:
        panel.set_ylabel("bend filter: RMSE [mm]")
    marks = [Line2D([], [], ls="", marker=m, color="0.3", label=rf"$\Delta_{a}$") for a, m in AXES.items()]
    marks += [Line2D([], [], ls="", marker="o", color=FAMILIES[f], label=f) for f in families]
    figure.legend(handles=marks, loc="outside lower center", ncols=3)
    figure.suptitle(title)
    return figure
