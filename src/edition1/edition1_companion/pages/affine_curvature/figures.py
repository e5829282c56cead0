"""Figures of the affine segment: readings and configuration over time, stills, published against regenerated."""

from __future__ import annotations

import matplotlib.pyplot as plt
import numpy as np
import pandas as pd
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from mpl_toolkits.mplot3d.axes3d import Axes3D

from edition1_companion.book import robot_figures
from edition1_live.view.style import (
    ESTIMATE,
    TRUTH,
    WIDTH_IN,
    label_in_mm,
    page_figure,
    plain_ticks,
)
from edition1_live.view.symbols import coordinate_symbol

PUBLISHED, OURS, BEST = "0.45", "#0072B2", "#D55E00"
UNITS = {"kappa_0": "rad", "kappa_1": "rad", "phi": "rad", "delta_L": "mm"}


@page_figure
def readings_and_configuration(series: pd.DataFrame) -> Figure:
    """Fig. 6: truth wide and pale, mean over the seeds dashed, one standard deviation as a band.

    Parameters
    ----------
    series
        Columns ``time_s, kind, name, truth, mean, std``.
    """
    figure = plt.figure(figsize=(WIDTH_IN, 8.4))
    rows = figure.add_gridspec(5, 2)
    readings = series[series["kind"] == "reading"]
    names = list(dict.fromkeys(readings["name"]))
    colours = colormaps["viridis"](np.linspace(0, 0.85, 3))
    for plane in range(3):
        panel = figure.add_subplot(rows[plane, :])
        for name, colour in zip(names[plane::3], colours, strict=True):
            _lines(panel, readings[readings["name"] == name], colour)
            panel.plot([], [], color=colour, label=f"${name[0]}_{name[2:]}$")
        panel.set_title(f"sensors at {100 * plane} mm", loc="left")
        panel.set(xlabel="time [s]" if plane == 2 else None, ylabel="reading [mT]")
        panel.legend(loc="center left", bbox_to_anchor=(1.0, 0.5), handlelength=1)
    estimates = series[series["kind"] == "configuration"]
    for k, (name, unit) in enumerate(UNITS.items()):
        panel = figure.add_subplot(rows[3 + k // 2, k % 2])
        _lines(panel, estimates[estimates["name"] == name], OURS)
        panel.set(ylabel=f"{coordinate_symbol(name)} [{unit}]", xlabel="time [s]" if k > 1 else None)
    handles = [
        Line2D([], [], color="0.3", **TRUTH, label="truth"),
        Line2D([], [], color="0.3", **ESTIMATE, label="mean over the seeds, band: standard deviation"),
    ]
    figure.legend(handles=handles, loc="outside upper center", ncols=2)
    return figure


def _lines(panel: Axes, part: pd.DataFrame, colour: object) -> None:
    t, mean, std = (part[c].to_numpy(dtype=float) for c in ("time_s", "mean", "std"))
    panel.plot(t, part["truth"], color=colour, **TRUTH)
    panel.plot(t, mean, color=colour, **ESTIMATE)
    panel.fill_between(t, mean - std, mean + std, color=colour, alpha=0.3, lw=0)


@page_figure
def stills(shapes: pd.DataFrame, parts: pd.DataFrame) -> Figure:
    """Fig. 7: true (black) and estimated (blue, one per seed) backbone with the magnets and sensors.

    Parameters
    ----------
    shapes, parts
        Columns of :func:`edition1_companion.twins.robot_tables.stills`.
    """
    return robot_figures.stills(shapes, parts, OURS, _in_space, 2.9)


def _in_space(panel: Axes3D) -> None:
    panel.set(xlim=(-130, 130), ylim=(-130, 130), zlim=(0, 210))
    panel.set_aspect("equal")
    panel.view_init(elev=20, azim=-55)
    panel.set(xticks=(-100, 0, 100), yticks=(-100, 0, 100), zticks=(0, 100, 200))
    label_in_mm(panel, fontsize=9.0, labelpad=-5.0)


@page_figure
def published_and_regenerated(cells: pd.DataFrame) -> Figure:
    """Relative errors of section 4.4: published, regenerated with the paper's method, calibrated model.

    Parameters
    ----------
    cells
        Columns ``quantity, published, published_std, regenerated, regenerated_std, best``; numbers in %.
    """
    figure, panel = plt.subplots(figsize=(5.6, 3.2))
    x = np.arange(len(cells))
    for offset, name, colour, marker, label in (
        (-0.16, "published", PUBLISHED, "s", "published (mean ± std of 3 seeds)"),
        (0.16, "regenerated", OURS, "o", "regenerated, the paper's method"),
    ):
        value, spread = (cells[c].fillna(0).to_numpy(dtype=float) for c in (name, f"{name}_std"))
        low = np.minimum(spread, 0.95 * value)  # a bar below zero has no place on a log axis
        panel.errorbar(x + offset, value, yerr=[low, spread], fmt=marker, color=colour, label=label)
    panel.plot(
        x + 0.32,
        cells["best"],
        "D",
        color=BEST,
        label="calibrated multipole model, robot not as drawn, with noise",
    )
    labels = [coordinate_symbol(q) for q in cells["quantity"]]
    panel.set(yscale="log", xticks=x, xticklabels=labels, xlim=(-0.6, len(x) - 0.4))
    panel.set(ylabel="relative error [%]")
    plain_ticks(panel.yaxis, subs=(1,))
    panel.grid(axis="x", visible=False)
    figure.legend(loc="outside upper center", ncols=1)
    return figure
