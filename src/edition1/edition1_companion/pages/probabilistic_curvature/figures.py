"""Figures of the page on probabilistic curvature: bend space, steps of the filter, errors, noise, field."""

from __future__ import annotations

import matplotlib.pyplot as plt
import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Circle, Rectangle
from matplotlib.ticker import MaxNLocator, NullFormatter

from edition1_live.view.style import INK_OF_MAPS, WIDTH_IN, page_figure, plain_ticks, wrapped_panels

COLOURS = {"spiral": "#0072B2", "flower": "#D55E00", "seagull": "#009E73"}
MARKERS = {"spiral": "o", "flower": "s", "seagull": "D"}
PUBLISHED = "0.45"
OFF_SCALE_MM = 0.12
RUNNING = 25
"""Steps of a running root mean square: single errors would hide each other."""


@page_figure
def bend_space(curves: pd.DataFrame, cloud: pd.DataFrame) -> Figure:
    """A cloud of particles in the bend space, enlarged (Fig. 3), and the curves in its disc (Fig. 4).

    Parameters
    ----------
    curves
        Columns ``curve, direction_rad, angle_rad``.
    cloud
        Columns ``bend_x_rad, bend_y_rad, is_truth``.
    """
    names = list(dict.fromkeys(curves["curve"]))
    figure, panels = wrapped_panels(1 + len(names), 2, 3.1)
    degrees = np.rad2deg(cloud[["bend_x_rad", "bend_y_rad"]].to_numpy())
    truth = cloud["is_truth"].to_numpy(dtype=bool)
    panels[0].plot(*degrees[~truth].T, "o", ms=2.5, color="#56B4E9", alpha=0.35, mew=0)
    panels[0].plot(*degrees[truth].T, "*", ms=13, color="black", mec="white")
    panels[0].set(title="Particles, truth (star), enlarged", aspect="equal")
    for panel, name in zip(panels[1:], names, strict=True):
        part = curves[curves["curve"] == name]
        radius = np.rad2deg(part["angle_rad"])
        x, y = radius * np.cos(part["direction_rad"]), radius * np.sin(part["direction_rad"])
        panel.plot(x, y, lw=1, color=COLOURS[name])
        panel.set_title(name.capitalize())
        _disc(panel)
    for panel in panels:
        panel.set(xlabel=r"$\varphi\,\cos\theta$ [deg]", ylabel=r"$\varphi\,\sin\theta$ [deg]")
    return figure


def _disc(panel: Axes) -> None:
    for radius in (30, 60, 90):
        panel.add_patch(Circle((0, 0), radius, fill=False, lw=1.2 if radius == 90 else 0.5, color="0.6"))
    ticks = [-90, 0, 90]
    panel.set(aspect="equal", xlim=(-95, 95), ylim=(-95, 95), xticks=ticks, yticks=ticks)
    panel.grid(visible=False)


@page_figure
def filter_steps(
    cloud: tuple[np.ndarray, np.ndarray, np.ndarray], truth_rad: np.ndarray, estimate_rad: np.ndarray
) -> Figure:
    """A cloud of particles at one reading, as it is weighed, and what is drawn anew from it.

    Parameters
    ----------
    cloud
        The particles [rad], their weights, and the indices of those that are drawn.
    truth_rad, estimate_rad
        Bend vectors at the reading [rad].
    """
    q, weights, drawn = cloud
    heavy, (kept, copies) = weights > 1e-3, np.unique(drawn, return_counts=True)
    truth, estimate = np.rad2deg(truth_rad), np.rad2deg(estimate_rad)
    figure, panels = plt.subplots(1, 3, figsize=(7.4, 3.3))
    for panel, title, reach in zip(panels, ("Cloud", "Weighed", "Drawn anew"), (11.0, 2.5, 2.5), strict=True):
        panel.set(
            aspect="equal", xlim=truth[0] + [-reach, reach], ylim=truth[1] + [-reach, reach], title=title
        )
        panel.plot(*truth, "*", color="black", ms=11, zorder=4)
        panel.plot(*estimate, "X", color="#D55E00", mec="white", ms=9, zorder=5)
    panels[0].add_patch(Rectangle(truth - 2.5, 5.0, 5.0, fill=False, color="black", lw=1.2, zorder=3))
    for panel in panels[:2]:
        panel.scatter(*np.rad2deg(q).T, s=6, color="0.6", linewidths=0, zorder=1)
    for panel, chosen, share, colour in (
        (panels[1], q[heavy], weights[heavy], "#E69F00"),
        (panels[2], q[kept], copies / len(q), "#0072B2"),
    ):
        panel.scatter(
            *np.rad2deg(chosen).T, s=8 + 600 * share, color=colour, alpha=0.7, linewidths=0, zorder=1
        )
    panels[0].set_ylabel(r"$\varphi\,\sin\theta$ [deg]")
    figure.supxlabel(r"$\varphi\,\cos\theta$ [deg]", fontsize="medium")
    large = {"ls": "none", "ms": 8}
    handles = [
        Line2D([], [], marker=".", color="0.6", ls="none", label="particles"),
        Line2D([], [], marker="o", color="#E69F00", **large, label="size: weight"),
        Line2D([], [], marker="o", color="#0072B2", **large, label="size: how often drawn"),
        Line2D([], [], marker="*", color="black", **large, label="truth"),
        Line2D([], [], marker="X", color="#D55E00", **large, label="estimate"),
    ]
    figure.legend(handles=handles, loc="outside upper center", ncols=5, columnspacing=1.2, handletextpad=0.2)
    return figure


@page_figure
def error_over_time(table: pd.DataFrame) -> Figure:
    """Running error of the position over the curves' parameter (Fig. 5), one panel per curve and process noise.

    Parameters
    ----------
    table
        Columns ``process_noise_pi, particles, curve, t, error_mm``.
    """
    curves = list(dict.fromkeys(table["curve"]))
    walks = list(dict.fromkeys(table["process_noise_pi"]))
    size = (WIDTH_IN, 2.3 * len(curves) + 0.6)
    figure, panels = plt.subplots(
        len(curves), len(walks), figsize=size, sharex=True, sharey=True, squeeze=False
    )
    for row, curve in zip(panels, curves, strict=True):
        for panel, walk in zip(row, walks, strict=True):
            part = table[(table["curve"] == curve) & (table["process_noise_pi"] == walk)]
            for particles, line in part.groupby("particles"):
                colour = "#56B4E9" if particles == part["particles"].min() else "#0072B2"
                square = line["error_mm"].pow(2).rolling(RUNNING, center=True, min_periods=1).mean()
                panel.plot(line["t"], square.pow(0.5), lw=1, color=colour, label=f"{particles} particles")
            panel.set(yscale="log", title=f"{curve.capitalize()},\nprocess noise {walk:g}π rad")
            plain_ticks(panel.yaxis)
    for panel in panels[-1]:
        panel.set_xlabel("parameter $t$ of the curve")
    for panel in panels[:, 0]:
        panel.set_ylabel("running RMSE [mm]")
    handles = [
        Line2D([], [], color=line.get_color(), label=line.get_label()) for line in panels[0, 0].get_lines()
    ]
    figure.legend(handles=handles, loc="outside upper center", ncols=len(handles))
    return figure


@page_figure
def process_noise(sweep: pd.DataFrame, law: pd.DataFrame, count: pd.DataFrame) -> Figure:
    """Error of the paper's equations over the process noise and over the number of particles, with the error law.

    Parameters
    ----------
    sweep, count
        Columns ``curve, process_noise_pi, particles, rmse_mm``.
    law
        Columns ``process_noise_pi, particles, law_mm``.
    """
    figure, (left, right) = plt.subplots(1, 2, figsize=(WIDTH_IN, 4.0), width_ratios=(1.5, 1), sharey=True)
    left.axhspan(0.0044, 0.0046, color=PUBLISHED, lw=0, alpha=0.5)
    left.annotate("published", (0.00052, 0.0047), fontsize=8, color="0.3", va="bottom")
    shown = ((left, sweep, "process_noise_pi", "particles"), (right, count, "particles", "process_noise_pi"))
    for panel, table, along, held in shown:
        for curve, part in table.groupby("curve", sort=False):
            style = {"color": COLOURS[curve], "ms": 5, "label": curve.capitalize()}
            panel.plot(part[along], part["rmse_mm"], MARKERS[curve], **style)
        line = law[law[held] == table[held].iloc[0]].sort_values(along)
        panel.plot(line[along], line["law_mm"], color="0.2", lw=1, label="law without bias")
        panel.set(xscale="log", yscale="log")
    left.set_ylabel("RMSE of the position [mm]")
    plain_ticks(left.yaxis, subs=(1,))
    left.axvline(0.02, color="0.6", lw=0.8, ls="--")
    left.annotate("stated", (0.019, 0.0007), ha="right", fontsize=8, color="0.3")
    left.set_ylim(5e-4, 6)
    _over_process_noise(left, sweep)
    figure.legend(*left.get_legend_handles_labels(), loc="outside upper center", ncols=2)
    walk = count["process_noise_pi"].iloc[0]
    right.set(xlabel="particles $N$", title=f"{count['curve'].iloc[0].capitalize()}, {walk:g}π rad")
    return figure


def _over_process_noise(panel: Axes, table: pd.DataFrame) -> None:
    panel.set(xscale="log", xlabel="process noise [π rad per step]")
    panel.set_xticks(sorted(set(table["process_noise_pi"])))
    panel.xaxis.set_major_formatter("{x:g}")
    panel.xaxis.set_minor_formatter(NullFormatter())
    panel.tick_params(axis="x", rotation=45)


@page_figure
def sensor_noise(sweep: pd.DataFrame, memoryless_mm: float) -> Figure:
    """Error with sensor noise over the process noise, for both motions; the choice is made on Spiral.

    Parameters
    ----------
    sweep
        Columns ``motion, curve, process_noise_pi, rmse_mm``.
    memoryless_mm
        Error of an estimate from one reading alone [mm].
    """
    motions = list(dict.fromkeys(sweep["motion"]))
    figure, panels = plt.subplots(1, len(motions), figsize=(WIDTH_IN, 4.0), sharey=True, squeeze=False)
    for panel, motion in zip(panels.flat, motions, strict=True):
        part = sweep[sweep["motion"] == motion]
        panel.axhline(memoryless_mm, color="0.4", lw=1, ls="--", label="least squares, one reading")
        for curve, line in part.groupby("curve", sort=False):
            style = {"color": COLOURS[curve], "marker": MARKERS[curve], "ms": 5}
            panel.plot(line["process_noise_pi"], line["rmse_mm"], **style, label=curve.capitalize())
        panel.set(yscale="log", title=motion.capitalize())
        _over_process_noise(panel, part)
        panel.yaxis.set_minor_formatter(NullFormatter())
        panel.set(ylim=(0.038, OFF_SCALE_MM))
        panel.set_yticks([0.04, 0.05, 0.06, 0.08, 0.1], ["0.04", "0.05", "0.06", "0.08", "0.1"])
        beyond = part["rmse_mm"][part["rmse_mm"] > OFF_SCALE_MM]
        if len(beyond):
            text = f"off the scale: {beyond.min():.1f} to {beyond.max():.1f} mm"
            panel.annotate(
                text, (0.98, 0.97), xycoords="axes fraction", fontsize=8, color="0.3", ha="right", va="top"
            )
    panels[0, 0].set_ylabel("RMSE of the position [mm]")
    figure.legend(*panels[0, 0].get_legend_handles_labels(), loc="outside upper center", ncols=2)
    return figure


@page_figure
def field_over_bend(table: pd.DataFrame) -> Figure:
    """Field over the bend space, the condition of its derivative, and the error gain.

    Parameters
    ----------
    table
        Columns ``bend_x_deg, bend_y_deg, abs_mt, condition, gain_mm_per_mt``.
    """
    panels_of = {
        "abs_mt": "flux density [mT]",
        "condition": "condition of its derivative",
        "gain_mm_per_mt": "error gain [mm/mT]",
    }
    plt.rcParams.update(INK_OF_MAPS)
    figure, panels = plt.subplots(1, len(panels_of), figsize=(WIDTH_IN, 3.0), sharey=True)
    for panel, (column, label) in zip(panels, panels_of.items(), strict=True):
        levels = panel.tricontourf(table["bend_x_deg"], table["bend_y_deg"], table[column], 12)
        figure.colorbar(levels, ax=panel, label=label, location="top", ticks=MaxNLocator(3))
        _disc(panel)
    panels[0].set_ylabel(r"$\varphi\,\sin\theta$ [deg]")
    figure.supxlabel(r"$\varphi\,\cos\theta$ [deg]", fontsize="medium")
    return figure
