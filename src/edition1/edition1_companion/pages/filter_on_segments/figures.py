"""Figures of the particle filter on several segments: errors by method, and a bend with two possible signs."""

from __future__ import annotations

import matplotlib.pyplot as plt
import numpy as np
import pandas as pd
from edition1_live.view.style import WIDTH_IN, page_figure, plain_ticks
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

STYLES = {
    "random walk": ("#E69F00", "o"),
    "constant velocity": ("#D55E00", "^"),
    "constant velocity + Gauss-Newton": ("#CC79A7", "v"),
    "least squares, last estimate": ("#0072B2", "s"),
    "least squares, straight start": ("#56B4E9", "P"),
    "Kalman filter": ("#009E73", "D"),
}
"""Colour and marker of each method."""


@page_figure
def errors_by_method(table: pd.DataFrame) -> Figure:
    """Error of the tip of every method, one panel per noise: means over draws with 95 % intervals.

    Parameters
    ----------
    table
        Columns of ``mean_errors``.
    """
    noises, robots = table["noise_mt"].unique(), sorted(table["n_b"].unique())
    figure, panels = plt.subplots(1, len(noises), figsize=(WIDTH_IN, 4.2), sharey=True, squeeze=False)
    methods = list(dict.fromkeys(table["method"]))
    for panel, noise in zip(panels[0], noises, strict=True):
        for k, method in enumerate(methods):
            part = table[(table["noise_mt"] == noise) & (table["method"] == method)].sort_values("n_b")
            at = np.array([robots.index(n) for n in part["n_b"]]) + 0.12 * (k - (len(methods) - 1) / 2)
            mean = part["tip_mm"].to_numpy()
            bars = np.abs(np.stack([part["tip_mm_low"], part["tip_mm_high"]]) - mean)
            colour, marker = STYLES[method]
            panel.errorbar(at, mean, bars, fmt=marker, ms=5, lw=1.2, color=colour, label=method)
        panel.set(
            title=f"noise {noise:g} mT", yscale="log", xlabel="segments $n_b$", xticks=range(len(robots))
        )
        panel.set_xticklabels([f"{n}" for n in robots])
        panel.set_xlim(-0.5, len(robots) - 0.5)
    panels[0, 0].set_ylabel("error of the tip [mm]")
    plain_ticks(panels[0, 0].yaxis)
    figure.legend(*panels[0, 0].get_legend_handles_labels(), loc="outside lower center", ncols=2)
    return figure


@page_figure
def two_modes(table: pd.DataFrame, methods: list[str]) -> Figure:
    """Bending out of the plane of the remaining sensors over time: every draw of every method, truth and its mirror.

    Parameters
    ----------
    table
        Columns of ``two_modes``.
    methods
        One row each; columns are the noises.
    """
    noises = table["noise_mt"].unique()
    size = (WIDTH_IN, 2.1 * len(methods) + 0.9)
    figure, panels = plt.subplots(
        len(methods), len(noises), figsize=size, sharex=True, sharey=True, squeeze=False
    )
    for column, noise in zip(panels.T, noises, strict=True):
        for panel, method in zip(column, methods, strict=True):
            part = table[(table["noise_mt"] == noise) & (table["method"] == method)]
            truth = part[part["draw"] == 0]
            for _, draw in part.groupby("draw"):
                panel.plot(draw["time_s"], draw["found_mm"], color=STYLES[method][0], lw=0.8, alpha=0.7)
            panel.plot(truth["time_s"], truth["true_mm"], color="0.1", lw=1.2)
            mirror = truth["true_mm"].where(truth["failed"])
            panel.plot(truth["time_s"], -mirror, color="0.1", lw=1.2, ls=":")
            panel.axvline(truth["time_s"][truth["failed"]].min(), color="0.6", lw=0.8, ls="--")
            panel.set_title(f"{method},\nnoise {noise:g} mT", loc="left")
        column[-1].set_xlabel("time [s]")
    for panel in panels[:, 0]:
        panel.set_ylabel(r"$\Delta_y$, segment 2 [mm]")
    figure.legend(
        handles=[
            Line2D([], [], color="0.1", lw=1.2, label="truth"),
            Line2D([], [], color="0.1", lw=1.2, ls=":", label="its mirror image"),
            Line2D([], [], color="0.5", lw=0.8, label="estimates, one line per draw"),
            Line2D([], [], color="0.6", lw=0.8, ls="--", label="two sensors fail"),
        ],
        loc="outside lower center",
        ncols=2,
    )
    return figure
