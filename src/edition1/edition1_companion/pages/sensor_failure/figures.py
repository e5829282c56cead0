"""Figures of the page: readings and estimates over time (Fig. 4b), stills (Fig. 5), calibrated model."""

from __future__ import annotations

import matplotlib.pyplot as plt
import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import MultipleLocator
from mpl_toolkits.mplot3d.axes3d import Axes3D

from edition1_companion.book.robot_figures import segment_colours
from edition1_live.view.style import ESTIMATE, MAGNET, SENSOR, TRUTH, WIDTH_IN, label_in_mm, page_figure
from edition1_live.view.symbols import coordinate_symbol

COLOURS = ("#0072B2", "#009E73", "#CC79A7", "#D55E00")
FAILED = "#D55E00"
UNSEEN = {"lw": 3.4, "alpha": 0.18}
GRID_MM = 100.0
RUN_COLOURS = {"failure": "#D55E00", "all sensors": "#0072B2"}


@page_figure
def readings_and_estimates(u: pd.DataFrame, q: pd.DataFrame, failure_s: float) -> Figure:
    """Fig. 4(b): readings at the left and configurations at the right, one row per segment.

    Truth wide and pale, so that it shows below the mean over the seeds, which is dashed, with a band of one standard
    deviation; the readings of failed sensors, which the estimate no longer sees, are fainter still.

    Parameters
    ----------
    u, q
        Columns of ``over_time``.
    failure_s
        Time of the failure [s], marked.
    """
    segments = np.unique(u["segment"])
    size = (WIDTH_IN, 2.7 * len(segments) + 1.0)
    figure, panels = plt.subplots(len(segments), 2, figsize=size, sharex=True, squeeze=False)
    for (left, right), segment in zip(panels, segments, strict=True):
        here = u[u["segment"] == segment]
        for colour, (sensor, part) in zip(COLOURS, here.groupby("sensor"), strict=False):
            _truth_and_mean(left, part, "mT", colour, f"$u_{{{sensor}}}$", seen=part["working"])
        here = q[q["segment"] == segment]
        for colour, (quantity, part) in zip(COLOURS, here.groupby("quantity", sort=False), strict=False):
            _truth_and_mean(right, part, "mm", colour, coordinate_symbol(quantity.rpartition("_")[0]))
        left.set_ylabel(f"segment {segment}: reading [mT]")
        right.set_ylabel("configuration [mm]")
        for panel in (left, right):
            panel.axvline(failure_s, color="0.3", lw=1, ls=":")
            panel.legend(
                loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=4, handlelength=1, columnspacing=0.9
            )
    for panel in panels[-1]:
        panel.set_xlabel("time [s]")
    figure.legend(
        handles=[
            Line2D([], [], color="0.3", **TRUTH, label="truth"),
            Line2D([], [], color="0.3", **ESTIMATE, label="mean over seeds,\nband: one standard deviation"),
            Line2D([], [], color="0.3", **UNSEEN, label="truth, sensor failed"),
            Line2D([], [], color="0.3", ls=":", lw=1, label="failure"),
        ],
        loc="outside lower center",
        ncols=2,
    )
    return figure


def _truth_and_mean(
    panel: Axes, part: pd.DataFrame, unit: str, colour: str, label: str, seen: pd.Series | None = None
) -> None:
    t, truth, mean, std = (part[c] for c in ("time_s", f"true_{unit}", f"mean_{unit}", f"std_{unit}"))
    if seen is None:
        panel.plot(t, truth, color=colour, **TRUTH, label=label)
    else:
        panel.plot(t, truth.where(seen), color=colour, **TRUTH, label=label)
        panel.plot(t, truth.where(~seen), color=colour, **UNSEEN)
    panel.plot(t, mean, color=colour, **ESTIMATE)
    panel.fill_between(t, mean - std, mean + std, color=colour, alpha=0.2, lw=0)


@page_figure
def shape_stills(shapes: pd.DataFrame, parts: pd.DataFrame) -> Figure:
    """Fig. 5: true (opaque) and estimated (transparent) shape at several times, with magnets and sensors.

    Parameters
    ----------
    shapes, parts
        Columns of ``stills``.
    """
    moments = np.unique(shapes["time_s"])
    columns = min(2, len(moments))
    lines = -(-len(moments) // columns)
    figure = plt.figure(figsize=(WIDTH_IN, 3.6 * lines + 0.6))
    colours = segment_colours(shapes["segment"].nunique())
    points = pd.concat([shapes, parts])[["x_mm", "y_mm", "z_mm"]].to_numpy(dtype=float)
    middle, reach = (points.max(0) + points.min(0)) / 2, np.ptp(points, axis=0) / 2
    for k, time_s in enumerate(moments):
        axes = figure.add_subplot(lines, columns, k + 1, projection="3d")
        assert isinstance(axes, Axes3D)
        for estimated, alpha in ((False, 1.0), (True, 0.35)):
            here = shapes[(shapes["time_s"] == time_s) & (shapes["estimated"] == estimated)]
            for colour, (_, segment) in zip(colours, here.groupby("segment"), strict=True):
                xyz = segment[["x_mm", "y_mm", "z_mm"]].to_numpy()
                axes.plot(*xyz.T, color=colour, lw=3.5 if estimated else 2.5, alpha=alpha)
            part = parts[(parts["time_s"] == time_s) & (parts["estimated"] == estimated)]
            for kind, working, style in (
                ("magnet", True, {"marker": "o", "color": MAGNET, "ms": 6}),
                ("sensor", True, {"marker": "s", "color": SENSOR, "ms": 3.5}),
                ("sensor", False, {"marker": "X", "color": FAILED, "ms": 6}),
            ):
                chosen = part[(part["part"] == kind) & (part["working"] == working)]
                axes.plot(*chosen[["x_mm", "y_mm", "z_mm"]].to_numpy().T, ls="", mew=0, alpha=alpha, **style)
        for name, centre, half in zip("xyz", middle, reach, strict=True):
            getattr(axes, f"set_{name}lim")(centre - half, centre + half)
            getattr(axes, f"{name}axis").set_major_locator(MultipleLocator(GRID_MM))
        axes.tick_params(labelsize=8, pad=-2)
        label_in_mm(axes, fontsize=9.0, labelpad=-5.0)
        axes.set_box_aspect(tuple(reach), zoom=1.0)
        axes.view_init(elev=15, azim=-60)
        axes.set_title(f"t = {time_s:.1f} s", loc="left", y=0.95)
    handles = [
        Line2D([], [], color="0.1", lw=2.5, label="truth"),
        Line2D([], [], color="0.1", lw=3.5, alpha=0.35, label="estimate"),
        Line2D([], [], marker="o", ls="", color=MAGNET, label="magnet"),
        Line2D([], [], marker="s", ls="", color=SENSOR, label="sensor"),
        Line2D([], [], marker="X", ls="", color=FAILED, mew=0, ms=8, label="failed sensor"),
    ]
    figure.legend(handles=handles, loc="outside lower center", ncols=3)
    return figure


@page_figure
def error_and_deviation(table: pd.DataFrame, failure_s: float) -> Figure:
    """Calibrated model with the failure and with all sensors: error at the left, reported deviation at the right.

    Parameters
    ----------
    table
        Columns of ``uncertainty``.
    failure_s
        Time of the failure [s], marked.
    """
    quantities = list(dict.fromkeys(table["quantity"]))
    figure, panels = plt.subplots(
        len(quantities), 2, figsize=(WIDTH_IN, 2.0 * len(quantities) + 0.6), sharex=True, sharey="col"
    )
    for row, quantity in zip(panels, quantities, strict=True):
        for panel, name in zip(row, ("error_mm", "deviation_mm"), strict=True):
            for run, colour in RUN_COLOURS.items():
                part = table[(table["quantity"] == quantity) & (table["run"] == run)]
                panel.plot(part["time_s"], part[name], color=colour, lw=1, label=run)
            panel.axvline(failure_s, color="0.3", lw=1, ls=":")
        row[0].set_ylabel(f"error of {coordinate_symbol(quantity)} [mm]")
        row[1].set_ylabel("reported [mm]")
    panels[0, 0].set_title("error")
    panels[0, 1].set_title("reported standard deviation")
    for panel in panels[-1]:
        panel.set(xlabel="time [s]", ylim=(0, None))
    figure.legend(*panels[0, 0].get_legend_handles_labels(), loc="outside lower center", ncols=2)
    return figure
