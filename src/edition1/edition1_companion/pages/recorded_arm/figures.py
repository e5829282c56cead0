"""Figures of an arm whose shape follows from IMUs: shapes, path of the tip, angles between neighbours."""

from __future__ import annotations

import matplotlib.pyplot as plt
import numpy as np
import pandas as pd
from matplotlib.cm import ScalarMappable
from matplotlib.collections import LineCollection
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from edition1_live.view.style import TIMES, WIDTH_IN, page_figure

HEADING, OTHER = "#D55E00", "#E69F00"
HEADING_AXIS_Z = 0.95  # a jump about an axis within 18 deg of the vertical is drawn as a change of heading


@page_figure
def arm_shapes(shapes: pd.DataFrame, source: str) -> Figure:
    """Draw the arm at several times in 3-D, with equal axes and coloured by time.

    Parameters
    ----------
    shapes
        ``time_s, joint, x_mm, y_mm, z_mm``: the joints of each shape, from the base (0) to the tip, in the
        world frame.
    source
        Where the orientations come from; stands in the title.
    """
    figure = plt.figure(figsize=(WIDTH_IN, 6.0))
    axes = figure.add_subplot(projection="3d")
    times = shapes["time_s"].to_numpy(dtype=float)
    colours = ScalarMappable(Normalize(times.min(), max(times.max(), times.min() + 1e-9)), TIMES)
    for time_s in np.unique(times):
        points = shapes.loc[times == time_s, ["x_mm", "y_mm", "z_mm"]].to_numpy(dtype=float)
        axes.plot(*points.T, color=colours.to_rgba(time_s), marker="o", markersize=2.5, linewidth=2)
    axes.plot(0, 0, 0, color="black", marker="s", markersize=7, linestyle="none", label="base")
    reach = 1.05 * float(np.abs(shapes[["x_mm", "y_mm"]].to_numpy(dtype=float)).max())
    axes.set(xlim=(-reach, reach), ylim=(-reach, reach))  # a square floor leaves room for both axes' labels
    axes.set_aspect("equal")
    axes.set(xlabel="x [mm]", ylabel="y [mm]", zlabel="z [mm]", title=f"Shapes of the arm, {source}")
    axes.locator_params(nbins=5)
    axes.view_init(elev=18, azim=-60)
    axes.legend(loc="upper left")
    figure.colorbar(colours, ax=axes, label="time [s]", shrink=0.65, location="bottom", pad=0.08)
    return figure


@page_figure
def tip_path(tip: pd.DataFrame, source: str) -> Figure:
    """Draw z of the tip over time, and its path seen along z.

    Parameters
    ----------
    tip
        ``time_s, x_mm, y_mm, z_mm`` of the tip; the base is at the origin.
    source
        Where the orientations come from; stands in the title.
    """
    figure, (height, above) = plt.subplots(2, 1, figsize=(WIDTH_IN, 8.0), height_ratios=(1, 1.5))
    height.plot(tip["time_s"], tip["z_mm"], color="#0072B2", linewidth=1)
    height.axhline(0, color="black", linewidth=0.8, linestyle="--")
    height.annotate(
        "base",
        (1, 0),
        xycoords=("axes fraction", "data"),
        xytext=(-4, 3),
        textcoords="offset points",
        ha="right",
    )
    height.set(xlabel="time [s]", ylabel="z of the tip [mm]")
    pieces = np.stack([tip[["x_mm", "y_mm"]].to_numpy()[:-1], tip[["x_mm", "y_mm"]].to_numpy()[1:]], axis=1)
    path = LineCollection(list(pieces), array=tip["time_s"].to_numpy()[:-1], cmap=TIMES, linewidth=1)
    above.add_collection(path)
    above.autoscale()
    above.plot(0, 0, "ks", markersize=6)
    above.set_aspect("equal", adjustable="datalim")
    above.set(xlabel="x [mm]", ylabel="y [mm]", title="along z; square: base")
    figure.colorbar(path, ax=above, label="time [s]")
    height.set_title(f"Tip, {source}")
    return figure


@page_figure
def neighbour_angles(angles: pd.DataFrame, jumps: pd.DataFrame, source: str) -> Figure:
    """Draw the angle between each IMU and the next one over time, one panel per pair, with jumps marked.

    Parameters
    ----------
    angles
        ``time_s`` and one column ``angle_<imu>_<next>_deg`` per pair, base to tip.
    jumps
        ``time_s, imu, step_deg, axis_z``: steps of one IMU between two readings; each is marked in the panels
        of the pairs to which that IMU belongs. May be empty.
    source
        Where the orientations come from; stands in the title.
    """
    columns = [name for name in angles.columns if name.startswith("angle_")]
    figure = plt.figure(figsize=(WIDTH_IN, 1.05 * len(columns) + 0.9))
    panels = figure.subplots(len(columns), 1, sharex=True, sharey=True, squeeze=False)[:, 0]
    top = float(angles[columns].to_numpy(dtype=float).max())
    for panel, column in zip(panels, columns, strict=True):
        first, second = (int(part) for part in column.split("_")[1:3])
        panel.plot(angles["time_s"], angles[column], color="#0072B2", linewidth=0.8)
        of_pair = jumps["imu"].isin([first, second])
        about_vertical = jumps["axis_z"].abs() > HEADING_AXIS_Z
        for chosen, colour in ((of_pair & ~about_vertical, OTHER), (of_pair & about_vertical, HEADING)):
            for time_s in jumps.loc[chosen, "time_s"]:
                panel.axvline(float(time_s), color=colour, linewidth=1.2, alpha=0.8, zorder=0)
        panel.set_ylabel(f"{first} to {second}")
        panel.grid(axis="y", linewidth=0.4, alpha=0.6)
    panels[0].set(ylim=(0, 1.08 * top), title=f"Angle between neighbours, {source}")
    if len(jumps):
        figure.legend(
            handles=[
                Line2D([], [], color=HEADING, label="an IMU of the pair jumps about the vertical"),
                Line2D([], [], color=OTHER, label="about another axis"),
            ],
            loc="outside lower center",
            ncols=2,
        )
    panels[-1].set_xlabel("time [s]")
    figure.supylabel("angle between IMUs [deg]")
    return figure
