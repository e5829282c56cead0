"""Figures of the Table 1 page: descents, published against regenerated cells, model by solver, calibration."""

from __future__ import annotations

from collections.abc import Mapping

import matplotlib.pyplot as plt
import numpy as np
import pandas as pd
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from edition1_live.view.style import WIDTH_IN, page_figure, plain_ticks, wrapped_panels
from edition1_live.view.symbols import coordinate_symbol, in_symbols

PUBLISHED, OURS, BEST = "0.45", "#0072B2", "#D55E00"
MODELS = {"network of the paper": "o", "fast network": "s", "multipole": "D"}
SOLVERS = {"gradient descent": ("#0072B2", "o"), "Levenberg-Marquardt": ("#D55E00", "D")}


@page_figure
def descents(
    sides_m: np.ndarray,
    off_mt: np.ndarray,
    paths_m: Mapping[str, np.ndarray],
    truth_m: np.ndarray,
) -> Figure:
    """Paths of the solvers over the bend on level lines of what the readings are off.

    Parameters
    ----------
    sides_m, off_mt
        Bends along either axis [m], and root mean square of the readings' error over them, ``[y, x]``.
    paths_m
        Configurations by solver, ``[updates + 1, 3]`` [m].
    truth_m
        True configuration [m].
    """
    figure, panel = plt.subplots(figsize=(5.6, 5.0))
    side = 1e3 * sides_m
    levels = panel.contour(side, side, off_mt, 12, colors="0.6", linewidths=0.8)
    panel.clabel(levels, np.asarray(levels.levels)[1::2], fmt="%g mT", fontsize=7, colors="0.35")
    panel.plot(*1e3 * truth_m[:2], "*", color="black", ms=13, label="truth")
    first = next(iter(paths_m.values()))
    panel.plot(*1e3 * first[0, :2], "s", color="black", ms=6, label="start")
    for name, path in paths_m.items():
        colour, marker = SOLVERS[name]
        panel.plot(
            *1e3 * path[:, :2].T,
            color=colour,
            marker=marker,
            ms=5,
            lw=1.4,
            markevery=slice(1, None),
            label=name,
        )
    panel.set(xlabel=r"$\Delta_x$ [mm]", ylabel=r"$\Delta_y$ [mm]", aspect="equal")
    panel.grid(visible=False)
    figure.legend(loc="outside upper center", ncols=4)
    return figure


@page_figure
def published_and_regenerated(cells: pd.DataFrame) -> Figure:
    """Every cell in % of Table 1: published, regenerated with the paper's method, and of the calibrated model.

    Parameters
    ----------
    cells
        Columns ``row, quantity, published, published_std, regenerated, regenerated_std, best``; numbers in %,
        empty where there is none.
    """
    rows = list(dict.fromkeys(cells["row"]))
    figure, panels = wrapped_panels(len(rows), 2, 1.75, sharey=True)
    for panel, row in zip(panels, rows, strict=True):
        part = cells[cells["row"] == row]
        x = np.arange(len(part))
        for offset, name, colour, marker in (
            (-0.16, "published", PUBLISHED, "s"),
            (0.16, "regenerated", OURS, "o"),
        ):
            value, spread = (part[c].to_numpy(dtype=float) for c in (name, f"{name}_std"))
            low = np.minimum(
                np.nan_to_num(spread), 0.95 * value
            )  # a bar below zero has no place on a log axis
            panel.errorbar(
                x + offset, value, yerr=[low, np.nan_to_num(spread)], fmt=marker, ms=4, lw=1.1, color=colour
            )
        panel.plot(x + 0.32, part["best"].to_numpy(dtype=float), "D", ms=4, color=BEST)
        panel.set_title(in_symbols(row), loc="left")
        labels = [coordinate_symbol(q) for q in part["quantity"]]
        panel.set(yscale="log", xticks=x, xticklabels=labels, xlim=(-0.6, len(part) - 0.4))
        panel.grid(axis="x", visible=False)
        plain_ticks(panel.yaxis, subs=(1,))
    for panel in panels[::2]:
        panel.set_ylabel("relative error [%]")
    handles = [
        Line2D([], [], marker=m, ls="", color=c, label=name)
        for name, c, m in (
            ("published (mean ± std of 3 networks)", PUBLISHED, "s"),
            ("regenerated, the paper's method", OURS, "o"),
            ("calibrated multipole model, robot not as drawn, with noise", BEST, "D"),
        )
    ]
    figure.legend(handles=handles, loc="outside upper center", ncols=1)
    return figure


@page_figure
def model_by_solver(table: pd.DataFrame) -> Figure:
    """Error of the configuration and of the tip by sensor model and solver, one point per seed.

    Parameters
    ----------
    table
        Columns of ``model_by_solver``.
    """
    figure, panels = plt.subplots(2, 1, figsize=(WIDTH_IN, 6.0), sharex=True)
    models = [m for m in MODELS if m in set(table["model"])]
    for panel, column, label in zip(
        panels,
        ("configuration_percent", "tip_mm"),
        ("error of the configuration [%]", "error of the tip [mm]"),
        strict=True,
    ):
        for k, (solver, (colour, marker)) in enumerate(SOLVERS.items()):
            part = table[table["solver"] == solver]
            x = np.array([models.index(m) for m in part["model"]]) + 0.24 * (k - 0.5)
            panel.plot(x, part[column], marker, color=colour, ms=5, alpha=0.85, label=solver)
        panel.set(yscale="log", ylabel=label, xticks=range(len(models)), xlim=(-0.5, len(models) - 0.5))
        panel.set_xticklabels(models)
        panel.grid(axis="x", visible=False)
    panels[0].legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=2)
    return figure


@page_figure
def calibration_gain(summary: pd.DataFrame) -> Figure:
    """Mean error of every row before and after calibration, with bootstrap intervals of their ratio.

    Parameters
    ----------
    summary
        Columns ``row, uncalibrated_percent, calibrated_percent, ratio, ratio_low, ratio_high``.
    """
    figure, (left, right) = plt.subplots(1, 2, figsize=(WIDTH_IN, 0.38 * len(summary) + 1.2), sharey=True)
    y = np.arange(len(summary))[::-1]
    left.hlines(y, summary["calibrated_percent"], summary["uncalibrated_percent"], color="0.8", lw=2)
    left.plot(summary["uncalibrated_percent"], y, "s", color=PUBLISHED, label="as drawn")
    left.plot(summary["calibrated_percent"], y, "D", color=BEST, label="calibrated")
    left.set(xscale="log", xlabel="mean relative\nerror [%]")
    left.set_yticks(y, [in_symbols(row) for row in summary["row"]])
    plain_ticks(left.xaxis, subs=(1,))
    figure.legend(*left.get_legend_handles_labels(), loc="outside upper center", ncols=2)
    ratio = summary["ratio"].to_numpy()
    spread = [ratio - summary["ratio_low"], summary["ratio_high"] - ratio]
    right.errorbar(ratio, y, xerr=spread, fmt="o", color=OURS, capsize=2)
    right.set(xlabel="calibrated / as drawn,\n95 % interval", xlim=(0, None))
    return figure
