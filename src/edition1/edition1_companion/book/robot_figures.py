"""Figures of the kinematics and field pages: tables in, a matplotlib figure out."""

from __future__ import annotations

from collections.abc import Callable

import matplotlib.pyplot as plt
import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.collections import PatchCollection
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Arc, Polygon
from matplotlib.ticker import MaxNLocator
from mpl_toolkits.mplot3d.axes3d import Axes3D

from edition1.sensing.magnets import ring
from edition1_live.view.style import INK_OF_MAPS, MAGNET, SENSOR, TIMES, WIDTH_IN, page_figure, plain_ticks

MM = 1e3


def segment_colours(n: int) -> np.ndarray:
    """Colours of the segments from base to tip: black to violet, as in the paper."""
    t = np.linspace(0, 1, max(n, 2))[:n, None]
    return (1 - t) * np.array([0.1, 0.1, 0.1]) + t * np.array([0.58, 0.24, 0.78])


@page_figure
def shapes_3d(table: pd.DataFrame) -> Figure:
    """Backbones of several configurations in 3-D, equal axes; columns of ``backbones``."""
    figure = plt.figure(figsize=(6.2, 5.4))
    axes = figure.add_subplot(projection="3d")
    assert isinstance(axes, Axes3D)
    n = table["shape"].nunique()
    instants = TIMES(np.linspace(0, 1, n))
    xyz, shapes, segments = (table[c].to_numpy() for c in (["x_mm", "y_mm", "z_mm"], "shape", "segment"))
    for shape in range(n):
        for segment in np.unique(segments):
            part = xyz[(shapes == shape) & (segments == segment)]
            label = f"shape {shape + 1}" if segment == 1 else None
            axes.plot(*part.T, color=instants[shape], lw=2.4, label=label)
            axes.plot(*part[-1:].T, "o", color=instants[shape], ms=4)
    equal_axes(axes, xyz)
    axes.view_init(elev=18, azim=-58)
    figure.legend(loc="outside upper center", ncols=3)
    return figure


def equal_axes(axes: Axes3D, points: np.ndarray) -> None:
    """Give a 3-D plot in mm equal scales and few ticks."""
    low, high = points.min(0), points.max(0)
    span = np.maximum(high - low, 0.25 * (high - low).max())
    centre = (low + high) / 2
    for name, c, s in zip("xyz", centre, span, strict=True):
        getattr(axes, f"set_{name}lim")(c - 0.55 * s, c + 0.55 * s)
        getattr(axes, f"set_{name}label")(f"{name} [mm]", labelpad=8)
        getattr(axes, f"{name}axis").set_major_locator(MaxNLocator(4))
    axes.set_box_aspect(tuple(span), zoom=0.88)


def stills(
    shapes: pd.DataFrame, parts: pd.DataFrame, colour: str, place: Callable[[Axes3D], None], tall_in: float
) -> Figure:
    """Backbones at several times, true and estimated, with magnets and sensors, two panels a row.

    Parameters
    ----------
    shapes, parts
        Columns of :func:`edition1_companion.twins.robot_tables.stills`.
    colour
        Of the estimates.
    place
        Gives a panel its limits and its view.
    tall_in
        Height of a row of panels [in].
    """
    times = np.unique(shapes["time_s"])
    lines = -(-len(times) // 2)
    figure = plt.figure(figsize=(WIDTH_IN, tall_in * lines))
    for k, time_s in enumerate(times):
        panel = figure.add_subplot(lines, 2, k + 1, projection="3d")
        assert isinstance(panel, Axes3D)
        for seed, part in shapes[shapes["time_s"] == time_s].groupby("seed"):
            style = (
                {"color": "black", "lw": 4.5} if seed == -1 else {"color": colour, "lw": 1.6, "alpha": 0.7}
            )
            panel.plot(part["x_mm"], part["y_mm"], part["z_mm"], **style)
        for name, ink, marker, size in (("magnet", MAGNET, "s", 5), ("sensor", SENSOR, "o", 4)):
            part = parts[(parts["time_s"] == time_s) & (parts["part"] == name)]
            panel.plot(part["x_mm"], part["y_mm"], part["z_mm"], color=ink, marker=marker, ls="", ms=size)
        panel.set_title(f"t = {time_s:.1f} s", y=0.96)
        panel.tick_params(labelsize=8, pad=-2)
        place(panel)
    handles = [
        Line2D([], [], color="black", lw=4, label="true shape"),
        Line2D([], [], color=colour, lw=1.6, label="estimated, one per seed"),
        Line2D([], [], color=MAGNET, marker="s", ls="", label="magnet"),
        Line2D([], [], color=SENSOR, marker="o", ls="", ms=4, label="sensor"),
    ]
    figure.legend(handles=handles, loc="outside lower center", ncols=2)
    return figure


@page_figure
def printed_equation(table: pd.DataFrame) -> Figure:
    """Eq. (15) as printed and corrected, in the plane of bending; columns of ``misprint``."""
    figure, axes = plt.subplots(figsize=(5.4, 4.2))
    axes.plot(table.x_mm, table.z_mm, label="without the\nfactor 1/v", lw=2.4)
    axes.plot(table.x_printed_mm, table.z_printed_mm, "--", label="as printed")
    axes.plot(0, 0, "ks", ms=6)
    axes.annotate("base", (0, 0), xytext=(6, -2), textcoords="offset points")
    axes.annotate("tip", table[["x_mm", "z_mm"]].iloc[-1], xytext=(6, -3), textcoords="offset points")
    axes.set(xlabel="x [mm]", ylabel="z [mm]", aspect="equal")
    axes.margins(0.12)
    axes.legend(loc="center left", bbox_to_anchor=(1.02, 0.5))
    return figure


@page_figure
def relation_sketch(parts: pd.DataFrame, sensor: int) -> Figure:
    """Quantities of Fig. 2(a) for one sensor and the magnet of its segment, drawn to scale in the x-z plane.

    Parameters
    ----------
    parts
        Columns of ``mounted_parts``, for a robot bent in the x-z plane.
    sensor
        Index among the sensors.
    """
    (positions_s, axes_s), (positions_m, axes_m) = _in_plane(parts, "sensor"), _in_plane(parts, "magnet")
    magnet = int(parts.loc[parts["part"] == "sensor", "segment"].iloc[sensor]) - 1
    p_s, o_s, p_m, o_m = positions_s[sensor], axes_s[sensor], positions_m[magnet], axes_m[magnet]
    offset = p_s - p_m
    figure, axes = plt.subplots(figsize=(WIDTH_IN, 4.2))
    for origin, vector, colour, name, along in (
        (p_m, offset, "0.3", "$p$", 0.5),
        (p_m, 28 * o_m, MAGNET, "$o_m$", 1.1),
        (p_s, 22 * o_s, SENSOR, "$o_s$", 1.18),
    ):
        arrow = {"arrowstyle": "-|>", "color": colour, "lw": 2, "shrinkA": 0, "shrinkB": 0}
        axes.annotate("", origin + vector, origin, arrowprops=arrow)
        aside = {"$p$": 4.0, "$o_m$": 0.0, "$o_s$": 4.0}[name]
        side = aside * np.array([vector[1], -vector[0]]) / np.linalg.norm(vector)
        axes.text(
            *(origin + along * vector + side), name, color=colour, ha="center", va="center", fontsize=13
        )
    axes.plot(*p_m, "o", color=MAGNET, ms=9, label="magnet")
    axes.plot(*p_s, "o", color=SENSOR, ms=9, label="sensor")
    carried = p_s + 24 * o_m
    axes.plot(*zip(p_s, carried, strict=True), ":", color=MAGNET, lw=1.4)
    beyond = p_s + 24 * offset / np.linalg.norm(offset)
    axes.plot(*zip(p_s, beyond, strict=True), ":", color="0.3", lw=1.4)
    _angle_mark(axes, p_m, o_m, offset, 15, r"$\theta$")
    _angle_mark(axes, p_s, o_s, o_m, 11, r"$\alpha$")
    _angle_mark(axes, p_s, o_s, offset, 17, r"$\beta$")
    axes.set(xlabel="x [mm]", ylabel="z [mm]", aspect="equal")
    axes.margins(0.22)
    figure.legend(loc="outside upper center", ncols=2)
    return figure


def _angle_mark(axes: Axes, at: np.ndarray, a: np.ndarray, b: np.ndarray, radius: float, name: str) -> None:
    """Arc between two directions, with the name of the angle beside it."""
    start, end = (np.degrees(np.arctan2(v[1], v[0])) for v in (a, b))
    turn = (end - start + 180) % 360 - 180
    low, high = (start, start + turn) if turn > 0 else (start + turn, start)
    axes.add_patch(Arc(at, 2 * radius, 2 * radius, theta1=low, theta2=high, color="0.25", lw=1.2))
    middle = np.radians((low + high) / 2)
    reach = radius + 4.5
    axes.text(at[0] + reach * np.cos(middle), at[1] + reach * np.sin(middle), name, ha="center", va="center")


@page_figure
def relations_over_time(table: pd.DataFrame) -> Figure:
    """Distance and angles of eq. (1) over time; columns of ``relations_along_lemniscate``."""
    figure, (upper, lower) = plt.subplots(2, 1, figsize=(6.4, 4.4), sharex=True, height_ratios=(1, 2))
    upper.plot(table.time_s, table.d_mm, color="0.2")
    upper.set(ylabel="$d$ [mm]")
    for name, symbol in (("alpha_deg", r"$\alpha$"), ("beta_deg", r"$\beta$"), ("theta_deg", r"$\theta$")):
        (line,) = lower.plot(table.time_s, table[name])
        lower.annotate(
            symbol,
            (table.time_s.iloc[-1], table[name].iloc[-1]),
            xytext=(5, 0),
            textcoords="offset points",
            color=line.get_color(),
            va="center",
            fontsize=12,
        )
    lower.set(xlabel="time [s]", ylabel="angle [deg]", ylim=(0, 185), yticks=range(0, 181, 45))
    return figure


@page_figure
def field_of_robot(
    field: pd.DataFrame, parts: pd.DataFrame, backbone: pd.DataFrame, ring_name: str
) -> Figure:
    """Field of all magnets in the x-z plane as in Fig. 4(a): streamlines, magnitude on a logarithmic scale.

    Parameters
    ----------
    field
        Columns of ``field_in_plane``.
    parts
        Columns of ``mounted_parts``.
    backbone
        Columns of ``backbones``, one shape.
    ring_name
        Ring whose cross-section is drawn.
    """
    grid = field.pivot(index="z_mm", columns="x_mm", values=["b_x_mT", "b_z_mT"])
    x, z = grid["b_x_mT"].columns.to_numpy(), grid.index.to_numpy()
    # The grid is evenly spaced; reading it back from decimals leaves rounding that streamplot would refuse.
    x, z = np.linspace(x[0], x[-1], len(x)), np.linspace(z[0], z[-1], len(z))
    bx, bz = grid["b_x_mT"].to_numpy(), grid["b_z_mT"].to_numpy()
    magnitude = np.hypot(bx, bz)
    plt.rcParams.update(INK_OF_MAPS)
    figure, axes = plt.subplots(figsize=(4.4, 6.4))
    axes.grid(visible=False)
    norm = LogNorm(vmin=max(magnitude.min(), 1e-3), vmax=100)
    image = axes.pcolormesh(x, z, magnitude, norm=norm, shading="gouraud", cmap="cividis", rasterized=True)
    axes.streamplot(x, z, bx, bz, color=(1, 1, 1, 0.55), linewidth=0.7, density=1.5, arrowsize=0.7)
    colours = segment_colours(backbone.segment.nunique())
    for i, colour in enumerate(colours, start=1):
        part = backbone[backbone["segment"] == i]
        axes.plot(part["x_mm"], part["z_mm"], color="white", lw=6)
        axes.plot(part["x_mm"], part["z_mm"], color=colour, lw=4)
    axes.add_collection(_cross_sections(parts, ring_name))
    positions, directions = _in_plane(parts, "sensor")
    style = {"color": "#56B4E9", "edgecolor": "black", "linewidth": 0.5, "scale": 14, "width": 0.012}
    axes.quiver(*positions.T, *directions.T, zorder=5, **style)
    axes.plot([], [], "s", color=MAGNET, label="magnet (cross-section)")
    axes.plot([], [], ">", color="#56B4E9", mec="black", mew=0.5, ms=9, label="sensor direction")
    axes.legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=2, columnspacing=1.2)
    axes.set(xlabel="x [mm]", ylabel="z [mm]", aspect="equal", xlim=(x[0], x[-1]), ylim=(z[0], z[-1]))
    colours = figure.colorbar(image, label="|B| in the x-z plane [mT]", shrink=0.8, pad=0.02, extend="max")
    plain_ticks(colours.ax.yaxis, subs=(1,))
    return figure


def _cross_sections(parts: pd.DataFrame, ring_name: str) -> PatchCollection:
    magnet = ring(ring_name)
    patches = []
    for centre, axis in zip(*_in_plane(parts, "magnet"), strict=True):
        across = np.array([axis[1], -axis[0]])
        inner, outer, h = (MM * d / 2 for d in (magnet.inner_diameter, magnet.outer_diameter, magnet.height))
        for side in (-1, 1):
            corners = [(inner, -h), (outer, -h), (outer, h), (inner, h)]
            patches.append(Polygon([centre + side * a * across + b * axis for a, b in corners]))
    return PatchCollection(patches, facecolor=MAGNET, edgecolor="white", linewidth=1.0, zorder=4)


def _in_plane(parts: pd.DataFrame, part: str) -> tuple[np.ndarray, np.ndarray]:
    """Positions [mm] and axes of the magnets or of the sensors, x and z only."""
    chosen = parts[parts["part"] == part]
    return chosen[["x_mm", "z_mm"]].to_numpy(dtype=float), chosen[["axis_x", "axis_z"]].to_numpy(dtype=float)
