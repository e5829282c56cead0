"""Figures of the affine segment: readings and configuration over time, stills, published against regenerated."""

from __future__ import annotations

import matplotlib.pyplot as plt
import numpy as np
import pandas as pd
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from repro_live.view.style import (
    ESTIMATE,
    MAGNET,
    SENSOR,
    TRUTH,
    WIDTH_IN,
    coordinate_symbol,
    label_in_mm,
    page_figure,
    plain_ticks,
)

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
    shapes
        Columns ``time_s, kind, seed, x_mm, y_mm, z_mm``.
    parts
        Columns ``time_s, part, x_mm, y_mm, z_mm``: magnets and sensors in the true shape.
    """
    times = np.unique(shapes["time_s"])
    columns = 2
    figure = plt.figure(figsize=(WIDTH_IN, 2.9 * -(-len(times) // columns)))
    for k, time_s in enumerate(times):
        panel = figure.add_subplot(-(-len(times) // columns), columns, k + 1, projection="3d")
        here = shapes[shapes["time_s"] == time_s]
        for seed in np.unique(here["seed"]):
            part = here[here["seed"] == seed]
            xyz = part[["x_mm", "y_mm", "z_mm"]].to_numpy()
            truth = part["kind"].iloc[0] == "truth"
            panel.plot(
                *xyz.T, color="black" if truth else OURS, lw=4 if truth else 1.6, alpha=1 if truth else 0.7
            )
        for name, colour, marker in (("magnet", MAGNET, "s"), ("sensor", SENSOR, "o")):
            xyz = parts.loc[
                (parts["time_s"] == time_s) & (parts["part"] == name), ["x_mm", "y_mm", "z_mm"]
            ].to_numpy()
            panel.plot(*xyz.T, color=colour, marker=marker, ls="", ms=5 if name == "magnet" else 3)
        panel.set(xlim=(-130, 130), ylim=(-130, 130), zlim=(0, 210))
        panel.set_aspect("equal")
        panel.set_title(f"t = {time_s:.1f} s", y=0.94)
        panel.view_init(elev=20, azim=-55)
        panel.set(xticks=(-100, 0, 100), yticks=(-100, 0, 100), zticks=(0, 100, 200))
        panel.tick_params(labelsize=8, pad=-2)
        label_in_mm(panel, fontsize=9.0, labelpad=-5.0)
    handles = [
        Line2D([], [], color="black", lw=4, label="true shape"),
        Line2D([], [], color=OURS, lw=1.6, label="estimated, one per seed"),
        Line2D([], [], color=MAGNET, marker="s", ls="", label="magnets"),
        Line2D([], [], color=SENSOR, marker="o", ls="", ms=4, label="sensors"),
    ]
    figure.legend(handles=handles, loc="outside upper center", ncols=2)
    return figure


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
