"""Figures of Table 2 of Baaij et al. 2023: trajectories, loss landscape, estimates over time, stills."""

from __future__ import annotations

from functools import partial

import matplotlib.pyplot as plt
import pandas as pd
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from mpl_toolkits.mplot3d.axes3d import Axes3D

from edition1_companion.book import robot_figures
from edition1_live.view.style import INK_OF_MAPS, TRUTH, WIDTH_IN, label_in_mm, page_figure

PAPER, OURS = "#0072B2", "#D55E00"
SHAPE, TIP = "#56B4E9", "#0072B2"


@page_figure
def trajectories(paths: pd.DataFrame, shapes: pd.DataFrame, title: str) -> Figure:
    """Fig. 9: bend of the tip, and beside it the shape of the segment with the path of the tip.

    Parameters
    ----------
    paths
        Columns ``recording, delta_x_mm, delta_y_mm, tip_x_mm, tip_y_mm, tip_z_mm``.
    shapes
        Columns ``recording, shape, x_mm, y_mm, z_mm``.
    title
        Above all panels.
    """
    names = list(dict.fromkeys(paths["recording"]))
    figure = plt.figure(figsize=(WIDTH_IN, 2.5 * len(names) + 0.5))
    reach = 1.08 * float(paths[["delta_x_mm", "delta_y_mm"]].abs().to_numpy().max())
    for k, name in enumerate(names):
        path = paths[paths["recording"] == name]
        flat = figure.add_subplot(len(names), 2, 2 * k + 1)
        flat.plot(path["delta_x_mm"], path["delta_y_mm"], color=TIP, lw=0.7)
        flat.set(xlim=(-reach, reach), ylim=(-reach, reach), aspect="equal", title=name)
        flat.set(xticks=(-8, 0, 8), yticks=(-8, 0, 8), ylabel=r"$\Delta_y$ [mm]")
        if name == names[-1]:
            flat.set_xlabel(r"$\Delta_x$ [mm]")
        deep = figure.add_subplot(len(names), 2, 2 * k + 2, projection="3d")
        for _, curve in shapes[shapes["recording"] == name].groupby("shape"):
            deep.plot(curve["x_mm"], curve["y_mm"], curve["z_mm"], color=SHAPE, lw=0.8)
        deep.plot(path["tip_x_mm"], path["tip_y_mm"], path["tip_z_mm"], color=TIP, lw=0.7)
        _in_space(deep, elevation=20)
    figure.suptitle(title)
    return figure


@page_figure
def landscape(grid: pd.DataFrame, path: pd.DataFrame, title: str) -> Figure:
    """Fig. 10(a): error of the readings over the bend, with the path of the descent and the truth.

    Parameters
    ----------
    grid
        Columns ``delta_x_mm, delta_y_mm, rmse_mV`` on a regular grid.
    path
        Columns ``iteration, delta_x_mm, delta_y_mm, rmse_mV``; iteration -1 is the truth.
    title
        Above the panel.
    """
    plt.rcParams.update(INK_OF_MAPS)
    figure, panel = plt.subplots(figsize=(WIDTH_IN, 5.2))
    table = grid.pivot(index="delta_y_mm", columns="delta_x_mm", values="rmse_mV")
    mesh = panel.pcolormesh(
        table.columns, table.index, table.to_numpy(), cmap="viridis", shading="nearest", rasterized=True
    )
    figure.colorbar(mesh, label="RMSE of the readings [mV]")
    steps, truth = path[path["iteration"] >= 0], path[path["iteration"] == -1]
    best = steps.loc[[steps["rmse_mV"].idxmin()]]
    panel.plot(steps["delta_x_mm"], steps["delta_y_mm"], "o-", color=OURS, ms=3, lw=1, label="descent")
    for point, marker, colour, label in (
        (steps.iloc[:1], "s", "white", "start"),
        (best, "D", OURS, "best"),
        (truth, "*", "white", "truth"),
    ):
        panel.plot(
            point["delta_x_mm"], point["delta_y_mm"], marker, color=colour, mec="black", ms=9, label=label
        )
    panel.set(xlabel=r"$\Delta_x$ [mm]", ylabel=r"$\Delta_y$ [mm]", title=title)
    panel.grid(visible=False)
    figure.legend(loc="outside lower center", ncols=4)
    return figure


@page_figure
def estimates(series: pd.DataFrame, title: str, *, longest_s: float = 20.0) -> Figure:
    """Fig. 10(b): bend over time; truth black, the paper's method dashed with a band, the filter orange.

    Parameters
    ----------
    series
        Columns ``recording, time_s, name, truth, mean, std, ours, ours_std``.
    title
        Above all panels.
    longest_s
        How much is drawn [s].
    """
    names = list(dict.fromkeys(series["recording"]))
    figure, panels = plt.subplots(
        2, len(names), figsize=(WIDTH_IN, 5.4), sharex="col", sharey="row", squeeze=False
    )
    for k, name in enumerate(names):
        for i, axis in enumerate("xy"):
            panel = panels[i, k]
            chosen = (series["recording"] == name) & (series["name"] == f"delta_{axis}")
            part = series[chosen & (series["time_s"] <= longest_s)]
            t = part["time_s"].to_numpy()
            panel.plot(t, part["truth"], color="black", **TRUTH)
            for column, style, colour in (("mean", (0, (4, 2)), PAPER), ("ours", "-", OURS)):
                spread = part["std" if column == "mean" else "ours_std"].fillna(0).to_numpy()
                value = part[column].to_numpy()
                panel.plot(t, value, ls=style, color=colour, lw=1.1)
                panel.fill_between(t, value - spread, value + spread, color=colour, alpha=0.25, lw=0)
            panel.set_ylabel(rf"$\Delta_{axis}$ [mm]" if k == 0 else None)
        panels[0, k].set_title(name)
        panels[1, k].set_xlabel("time [s]")
    handles = [
        Line2D([], [], color="black", **TRUTH, label="truth"),
        Line2D([], [], color=PAPER, ls="--", label="the paper's method: mean, std over seeds"),
        Line2D([], [], color=OURS, label="filter with a map, with its own std"),
    ]
    figure.legend(handles=handles, loc="outside lower center", ncols=1)
    figure.suptitle(title)
    return figure


@page_figure
def stills(shapes: pd.DataFrame, parts: pd.DataFrame, title: str) -> Figure:
    """Fig. 11, lower row: true and estimated backbone with the magnet and the sensors.

    Parameters
    ----------
    shapes, parts
        Columns of :func:`edition1_companion.twins.robot_tables.stills`.
    title
        Above all panels.
    """
    figure = robot_figures.stills(shapes, parts, PAPER, partial(_in_space, elevation=15), 3.5)
    figure.suptitle(title)
    return figure


def _in_space(panel: Axes3D, *, elevation: float) -> None:
    """Axes of the whole segment [mm], seen from this elevation [deg]."""
    panel.set(xlim=(-40, 40), ylim=(-40, 40), zlim=(0, 115))
    panel.set(xticks=(-30, 30), yticks=(-30, 30), zticks=(0, 50, 100))
    panel.set_aspect("equal")
    panel.tick_params(labelsize=8, pad=-2)
    label_in_mm(panel, fontsize=9.0, labelpad=-6.0)
    panel.view_init(elev=elevation, azim=-55)
