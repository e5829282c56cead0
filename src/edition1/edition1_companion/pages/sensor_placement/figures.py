"""Figures of the placement page: layouts to scale, errors to be expected and errors made, what choices cost."""

from __future__ import annotations

import matplotlib.pyplot as plt
import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Circle, Rectangle

from edition1.kinematics.paper_robots import Dimensions
from edition1.sensing.magnets import ring
from edition1_live.view.style import MAGNET, WIDTH_IN, page_figure, plain_ticks
from edition1_live.view.symbols import in_symbols

MM = 1e3
ARROW_MM = 14.0
SEGMENTS = ("#0072B2", "#D55E00", "#CC79A7")
LAYOUTS = ("0.35", "#0072B2", "#D55E00", "#CC79A7")
MARKERS = ("s", "o", "D", "^")


@page_figure
def layouts_drawn(table: pd.DataFrame) -> Figure:
    """Side and top view of every layout of a robot, straight, with the measuring directions as arrows.

    Parameters
    ----------
    table
        Columns of :func:`~edition1_companion.pages.sensor_placement.studies.layouts_table`, of one robot.
    """
    names = list(dict.fromkeys(table["layout"]))
    height = _length(table)
    sizes = (height + 30, 2 * MM * Dimensions.RADIUS_M + 30)
    inches_per_mm = min(0.026, 9.5 / sum(sizes))
    size = (WIDTH_IN, inches_per_mm * sum(sizes) + 0.5)
    figure, panels = plt.subplots(
        2, len(names), figsize=size, squeeze=False, sharex=True, height_ratios=sizes
    )
    for k, name in enumerate(names):
        part = table[table["layout"] == name]
        _side(panels[0, k], part, height)
        _top(panels[1, k], part)
        panels[0, k].set_title(name.replace(" for ", "\nfor "))
    panels[0, 0].set_ylabel("z [mm]")
    panels[1, 0].set_ylabel("y [mm]")
    handles = [Line2D([], [], marker="s", ls="", color=MAGNET, label="magnet")]
    segments = sorted(set(table["segment"]))
    for i in segments:
        label = f"sensors of segment {i}" if len(segments) > 1 else "sensors"
        handles.append(Line2D([], [], marker="o", ls="", color=SEGMENTS[(i - 1) % 3], label=label))
    figure.legend(handles=handles, loc="outside lower center", ncols=2)
    return figure


def _length(table: pd.DataFrame) -> float:
    """Height of the robot: that of the highest part, rounded up to 10 mm."""
    return float(10 * np.ceil(table["height_mm"].max() / 10 - 1e-6))


def _side(axes: Axes, part: pd.DataFrame, height: float) -> None:
    body = {"facecolor": "0.95", "edgecolor": "0.7", "zorder": 0}
    axes.add_patch(Rectangle((-MM * Dimensions.RADIUS_M, 0), 2 * MM * Dimensions.RADIUS_M, height, **body))
    axes.plot([0, 0], [0, height], color="0.4", lw=1)
    for base in sorted(set((part["height_mm"] - part["axial_mm"]).round(6)))[1:]:
        axes.plot([-MM * Dimensions.RADIUS_M, MM * Dimensions.RADIUS_M], [base, base], color="0.7", lw=1)
    magnet = ring("released")
    inner, outer, h = (MM * x / 2 for x in (magnet.inner_diameter, magnet.outer_diameter, magnet.height))
    for z in part.loc[part["part"] == "magnet", "height_mm"]:
        for x in (-outer, inner):
            axes.add_patch(Rectangle((x, z - h), outer - inner, 2 * h, color=MAGNET, zorder=2))
    r, phi, psi, z, colours = _sensors(part)
    _arrows(axes, r * np.cos(phi), z, -np.sin(psi) * np.cos(phi), -np.cos(psi), colours)
    axes.set(
        aspect="equal",
        ylim=(-15, height + 15),
        xlim=(-MM * Dimensions.RADIUS_M - 15, MM * Dimensions.RADIUS_M + 15),
    )
    axes.xaxis.set_tick_params(labelbottom=False)
    axes.grid(visible=False)


def _top(axes: Axes, part: pd.DataFrame) -> None:
    axes.add_patch(Circle((0, 0), MM * Dimensions.RADIUS_M, facecolor="0.95", edgecolor="0.7", zorder=0))
    magnet = ring("released")
    for diameter, colour in ((magnet.outer_diameter, MAGNET), (magnet.inner_diameter, "0.95")):
        axes.add_patch(Circle((0, 0), MM * diameter / 2, color=colour, alpha=0.5 if colour == MAGNET else 1))
    r, phi, psi, _, colours = _sensors(part)
    across = -np.sin(psi)
    _arrows(axes, r * np.cos(phi), r * np.sin(phi), across * np.cos(phi), across * np.sin(phi), colours)
    edge = MM * Dimensions.RADIUS_M + 15
    axes.set(aspect="equal", xlabel="x [mm]", xlim=(-edge, edge), ylim=(-edge, edge))
    axes.grid(visible=False)


def _sensors(part: pd.DataFrame) -> tuple[np.ndarray, ...]:
    sensors = part[part["part"] == "sensor"]
    phi, psi = (np.radians(sensors[c].to_numpy()) for c in ("azimuth_deg", "tilt_deg"))
    colours = np.array([SEGMENTS[(i - 1) % 3] for i in sensors["segment"]])
    return sensors["radial_mm"].to_numpy(), phi, psi, sensors["height_mm"].to_numpy(), colours


def _arrows(
    axes: Axes, x: np.ndarray, y: np.ndarray, dx: np.ndarray, dy: np.ndarray, colours: np.ndarray
) -> None:
    style = {"angles": "xy", "scale_units": "xy", "scale": 1, "width": 0.013, "zorder": 4}
    axes.quiver(x, y, ARROW_MM * dx, ARROW_MM * dy, color=colours, **style)
    axes.scatter(x, y, s=22, c=colours, edgecolors="white", linewidths=0.6, zorder=5)


@page_figure
def judged(bound: pd.DataFrame, summary: pd.DataFrame) -> Figure:
    """Bound along the held-out trajectory, and the errors that the estimator makes.

    Parameters
    ----------
    bound
        Columns of :func:`~edition1_companion.pages.sensor_placement.errors.bound_over_time`.
    summary
        Columns of :func:`~edition1_companion.pages.sensor_placement.errors.errors_by_layout`, of one robot.
    """
    figure, panels = plt.subplot_mosaic(
        [["bound", "bound"], ["drawn", "tolerant"]], figsize=(WIDTH_IN, 6.4), height_ratios=(1, 1.2)
    )
    left, middle, right = (panels[name] for name in ("bound", "drawn", "tolerant"))
    names = list(dict.fromkeys(bound["layout"]))
    for k, name in enumerate(names):
        part = bound[bound["layout"] == name]
        left.plot(part["time_s"], part["bound_percent"], color=LAYOUTS[k], label=name)
    left.set(
        yscale="log", xlabel="time [s]", ylabel="bound on the error [%]", title="bound along the trajectory"
    )
    plain_ticks(left.yaxis)
    tests = list(dict.fromkeys(summary["shapes"]))
    for panel, robot in ((middle, "as drawn"), (right, "within tolerances")):
        for k, name in enumerate(names):
            part = summary[(summary["robot"] == robot) & (summary["layout"] == name)]
            x = np.array([tests.index(test) for test in part["shapes"]]) + 0.2 * (k - (len(names) - 1) / 2)
            panel.errorbar(
                x,
                part["mean_percent"],
                yerr=part["std_percent"],
                fmt=MARKERS[k],
                ms=5,
                color=LAYOUTS[k],
                capsize=2,
            )
        panel.set(xticks=range(len(tests)), xlim=(-0.5, len(tests) - 0.5), title=f"measured, {robot}")
        panel.set(yscale="log", ylabel="error [%]")
        plain_ticks(panel.yaxis)
        panel.set_xticklabels([test.replace(" ", "\n") for test in tests])
        panel.grid(axis="x", visible=False)
    handles = [
        Line2D([], [], marker=m, color=c, label=name)
        for name, c, m in zip(names, LAYOUTS, MARKERS, strict=False)
    ]
    figure.legend(handles=handles, loc="outside upper center", ncols=3)
    return figure


@page_figure
def all_robots(summary: pd.DataFrame) -> Figure:
    """Errors of every layout relative to its reference, with their intervals, for several robots.

    Parameters
    ----------
    summary
        Columns of :func:`~edition1_companion.pages.sensor_placement.errors.errors_by_layout`. Layouts
        without a ratio near one, such as one that leaves a coordinate open, are left out where they exceed tenfold.
    """
    keys = list(dict.fromkeys(zip(summary["task"], summary["shapes"], strict=True)))
    names = [name for name in dict.fromkeys(summary["layout"]) if name.startswith("optimised")]
    figure, panels = plt.subplots(1, 2, figsize=(WIDTH_IN, 0.55 * len(keys) + 1.5), sharey=True)
    y = {key: len(keys) - 1 - k for k, key in enumerate(keys)}
    for panel, robot in zip(panels, ("as drawn", "within tolerances"), strict=True):
        panel.axvline(1.0, color=LAYOUTS[0], lw=1.2)
        for k, name in enumerate(names, start=1):
            part = summary[(summary["robot"] == robot) & (summary["layout"] == name)]
            height = [y[key] + 0.22 * (1.5 - k) for key in zip(part["task"], part["shapes"], strict=True)]
            ratio = part["ratio"].to_numpy()
            spread = [ratio - part["ratio_low"], part["ratio_high"] - ratio]
            panel.errorbar(ratio, height, xerr=spread, fmt=MARKERS[k], ms=5, color=LAYOUTS[k], capsize=2)
        panel.set(title=f"robot {robot}", xlabel="error over that\nof the reference", xlim=(0, None))
        panel.grid(axis="y", visible=False)
    panels[0].set(
        yticks=list(y.values()),
        yticklabels=[in_symbols(f"{task},\n{test}".replace(", elong", ",\nelong")) for task, test in keys],
    )
    handles = [Line2D([], [], color=LAYOUTS[0], label="reference")]
    handles += [
        Line2D([], [], marker=MARKERS[k], ls="", color=LAYOUTS[k], label=name)
        for k, name in enumerate(names, start=1)
    ]
    figure.legend(handles=handles, loc="outside upper center", ncols=len(handles))
    return figure


@page_figure
def choices(table: pd.DataFrame) -> Figure:
    """Price of the limit on the error from tolerances, and below it the error by what may be chosen.

    Parameters
    ----------
    table
        Columns of the study ``placement_choices``.
    """
    figure, (left, right) = plt.subplots(2, 1, figsize=(WIDTH_IN, 6.6))
    nominal = table[table["study"] == "number"].iloc[0]
    limits = table[table["study"] == "limit"].sort_values("tolerance_percent")
    left.plot(limits["tolerance_percent"], limits["noise_percent"], "o-", color=LAYOUTS[1], ms=5)
    for row in limits.itertuples():
        label = "no limit" if np.isinf(row.limit) else f"{row.limit:g}"
        side = {"xytext": (5, -13), "ha": "right"} if np.isinf(row.limit) else {"xytext": (5, 4)}
        left.annotate(label, (row.tolerance_percent, row.noise_percent), textcoords="offset points", **side)
    left.plot(nominal["tolerance_percent"], nominal["noise_percent"], "s", color=LAYOUTS[0], ms=6)
    at = (nominal["tolerance_percent"], nominal["noise_percent"])
    left.annotate("nominal", at, xytext=(7, 3), textcoords="offset points")
    left.set(
        xlabel="error from tolerances [%]",
        ylabel="error from noise [%]",
        title="by limit on the error from tolerances,\nas a multiple of the nominal one",
    )
    left.margins(x=0.22, y=0.12)
    left.set_ylim(0, None)
    bars = table[table["study"] != "limit"]
    y = np.arange(len(bars))[::-1]
    colours = [LAYOUTS[0] if study == "number" else LAYOUTS[1] for study in bars["study"]]
    right.barh(y, bars["noise_percent"], color=colours, height=0.65)
    right.set(
        yticks=y,
        yticklabels=bars["setting"],
        xlabel="error from noise [%]",
        title="what may be chosen (limit 1)",
    )
    right.grid(axis="y", visible=False)
    return figure
