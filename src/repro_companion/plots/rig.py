"""Figures of the experiments of Baaij et al.: Table 2, Figs 8 to 11."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import matplotlib.pyplot as plt
import numpy as np
import pandas as pd
from IPython.display import HTML
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Circle, Polygon

from repro import Robot
from repro_companion.plots.style import (
    BLUE,
    BODY,
    GREEN,
    GREY_INK,
    NO_GRID,
    ORANGE,
    PINK,
    SKY,
    TRUTH_ESTIMATE,
    WIDTH,
    Look,
    halves_of_rings,
    over_time,
    style,
    to_scale,
    with_legend,
    with_spread,
)
from repro_companion.show import rendered

RIG_COLUMNS = {"e_u": ("readings", "mV"), "delta_x": ("Δx", "mm"), "delta_y": ("Δy", "mm")}


def table_2(printed: pd.DataFrame, lines: dict[str, pd.DataFrame], chaotic: set[tuple[str, str]]) -> HTML:
    """Return Table 2 as printed: in each cell the published number, below it those of the named tables of errors.

    The first of these stands beside ``chaotic`` rows and quantities, whose error rounding decides: they have a ~.
    """
    key = ["row", "quantity", "unit"]
    means = [
        table[table["elongation"] == "known"].groupby(key)["error"].agg(["mean", "std"])
        for table in lines.values()
    ]
    columns = [(name, part) for name, (_, unit) in RIG_COLUMNS.items() for part in (unit, "%")]

    def cell(row: str, name: str, unit: str) -> list[str]:
        if (row, name, unit) not in known.index:
            return []
        above = known.loc[(row, name, unit)]
        places = len(above["printed"].partition(".")[2])
        found = [table.reindex([(row, name, unit)]).iloc[0] for table in means]
        texts = [with_spread(mean, std, places) for mean, std in found]
        texts[0] = "~ " * ((row, name) in chaotic) + texts[0]
        return [f"{above['printed']} ± {above['printed_std']}", *texts]

    known = printed.set_index(key)
    rows = {row: [cell(row, *column) for column in columns] for row in printed["row"].unique()}
    heads = [(RIG_COLUMNS[name][0], unit) for name, unit in columns]
    return HTML(rendered("table_2.html", heads=heads, rows=rows, names=list(lines), chaotic=chaotic))


@style(**NO_GRID)
def rig_to_scale(robot: Robot, markers_at: float) -> Figure:
    """Draw Fig. 8 as a section and from above, to scale [mm]: body, chambers, ring, sensors and markers."""
    figure, (side, top) = plt.subplots(1, 2, figsize=(WIDTH, 4.0), width_ratios=(1.15, 1))
    segment, magnet = robot.segments[0], robot.magnets[0]
    length, radius, at = 1e3 * segment.length, 1e3 * segment.radius, 1e3 * magnet.place.at
    inner, outer = 500 * magnet.shape.inner_diameter, 500 * magnet.shape.outer_diameter
    look = {"fc": "#76767622", "ec": "#767676"}
    side.add_patch(Polygon([(-radius, 0), (radius, 0), (radius, length), (-radius, length)], **look))
    for half in halves_of_rings(np.array([[0.0, at]]), np.array([[0.0, 1.0]]), magnet.shape):
        side.add_patch(half)
        half.set(fc=GREEN, ec="none")
    places = 1e3 * np.array([sensor.place.position for sensor in robot.sensors])
    side.plot(places[:, 0], 0 * places[:, 0] + length, "s", color=BLUE, ms=6, clip_on=False)
    side.plot([-radius - 4, radius + 4], [1e3 * markers_at] * 2, color=ORANGE, lw=2.5)
    side.plot([-radius - 4, radius + 4], [0, 0], color="#767676", lw=4)
    heights = {"base": 0, "ring magnet": at, "markers": 1e3 * markers_at - 5, "sensors": length + 2}
    for words, z in heights.items():
        side.annotate(words, (radius + 7, z), va="center", annotation_clip=False)
    round_ = [(radius, look), (outer, {"fc": GREEN, "ec": "none"}), (inner, {"fc": "white", "ec": "none"})]
    for size, own in round_:
        top.add_patch(Circle((0, 0), size, **own))
    for azimuth in np.radians([180, 300, 60]):
        centre = 13 * np.array([np.cos(azimuth), np.sin(azimuth)])
        top.add_patch(Circle(centre, 150**0.5 / np.pi**0.5, fc="none", ec="#767676", ls="--"))
    top.plot(*places[:, :2].T, "s", color=BLUE, ms=7)
    to_scale(side, (-radius - 6, radius + 6), (-4, length + 8), every_mm=20, title="cut along x")
    reach = (-radius - 2, radius + 2)
    to_scale(top, reach, reach, every_mm=20, ylabel="y [mm]", title="from the tip")
    return figure


def _six_in_space(titles: Sequence[str]) -> tuple[Figure, list[Axes]]:
    """Return a figure with six panels in 3-D for the whole segment [mm], stretched sideways."""
    figure = plt.figure(figsize=(WIDTH, 5.4), layout="none")  # pictures in 3-D waste their margins
    figure.subplots_adjust(0, 0.03, 0.94, 0.9, 0.02, 0.08)
    for k, title in enumerate(titles):
        panel = figure.add_subplot(2, 3, k + 1, projection="3d", computed_zorder=False, elev=20, azim=-55)
        panel.set(
            xlim=(-25, 25), ylim=(-25, 25), zlim=(0, 120), zticks=(0, 50, 100),
            xticks=(-20, 0, 20), yticks=(0, 20),  # -20 would lie on the 20 of x
        )  # fmt: skip
        for name, pad in (("x", -4), ("y", -4), ("z", 0)):
            panel.tick_params(name, pad=pad)
            words = f"{name} [mm]" if name != "z" or k % 3 == 2 else ""  # no room between the panels
            getattr(panel, f"set_{name}label")(words, labelpad=pad - 3)
        panel.set_box_aspect((1, 1, 1.5), zoom=1.12)
        panel.set_title(title, y=1.03)
    return figure, figure.axes


@style()
def trajectories(paths: pd.DataFrame, shapes: dict[str, np.ndarray]) -> Figure:
    """Draw Fig. 9: shapes of the segment [m] pale, the path of its tip dark, a panel for each trajectory."""
    figure, panels = _six_in_space(list(shapes))
    for panel, (name, curves) in zip(panels, shapes.items(), strict=True):
        for curve in 1e3 * curves:
            panel.plot(*curve.T, color=SKY, lw=1.2, alpha=0.8)
        tip = paths[paths["recording"] == name][["tip_x_mm", "tip_y_mm", "tip_z_mm"]]
        panel.plot(*tip.to_numpy().T, color=BLUE, lw=1.2)
    looks = {"shape": {"color": SKY}, "path of the tip": {"color": BLUE}}
    return with_legend(figure, looks, columns=2, loc="upper center")


MAP: Mapping[str, Look] = {
    "start": {"marker": "s", "color": "white", "mec": "black", "ms": 8, "ls": ""},
    "descent": {"marker": "o", "color": ORANGE, "ms": 3, "lw": 1.2},
    "half the step": {"marker": "o", "color": PINK, "ms": 2.5, "lw": 1.0},
    "truth": {"marker": "*", "color": "white", "mec": "black", "ms": 13, "ls": ""},
    "estimate": {"marker": "D", "color": ORANGE, "mec": "black", "ms": 6, "ls": ""},
}
"""Looks of what a map shows; in Fig. 10(a) start, descent and estimate are q̂0, q̂t and q̂*."""


@style(**GREY_INK)
def landscapes(maps: dict[str, tuple[pd.DataFrame, list[pd.DataFrame], np.ndarray]]) -> Figure:
    """Draw Fig. 10(a): the loss [mV] with the paths of descents [mm].

    A map holds the loss, what the descent tries (and what it would try with half the step), and the truth.
    """
    figure, (panels,) = plt.subplots(1, len(maps), figsize=(WIDTH, 3.4), squeeze=False)
    for panel, (title, of_map) in zip(panels, maps.items(), strict=True):
        _landscape(panel, *of_map)
        panel.set_title(title)
    figure.colorbar(panels[0].collections[0], ax=panels, label="error of the readings [mV]")
    return with_legend(figure, MAP, columns=5)


@style()
def estimates_over_time(series: dict[str, np.ndarray], zoom_s: tuple[float, float]) -> Figure:
    """Draw Fig. 10(b): truth and the estimates of all seeds ``[t, 2, 1 + seeds]`` [mm], and a part of the last."""
    last = [*series][-1]
    figure, panels = plt.subplots(len(series) + 1, 1, figsize=(WIDTH, 5.4))
    for panel, (name, values) in zip(
        panels, [*series.items(), (f"{last}, a part of it", series[last])], strict=True
    ):
        for k, colour in enumerate((BLUE, ORANGE)):
            found = pd.DataFrame(values[:, k, 1:])
            curves = {"time_s": np.arange(len(values)) / 40, "truth": values[:, k, 0]}
            curves |= {"mean": found.mean(axis=1), "std": found.std(axis=1)}
            over_time(panel, pd.DataFrame(curves), colour)
        panel.set(title=name, ylabel="bend [mm]", xmargin=0)
    panels[-1].set(xlim=zoom_s, xlabel="time [s]")
    bends = {r"$\Delta_x$": {"color": BLUE, "lw": 3}, r"$\Delta_y$": {"color": ORANGE, "lw": 3}}
    return with_legend(figure, bends | TRUTH_ESTIMATE, columns=4)


def _landscape(panel: Axes, grid: pd.DataFrame, paths: list[pd.DataFrame], truth: np.ndarray) -> None:
    """Draw the loss over the bend, and the paths of descents on it."""
    table = grid.pivot(index="delta_y_mm", columns="delta_x_mm", values="rmse_mV")
    look = {"vmin": 0, "vmax": 100, "rasterized": True}
    panel.pcolormesh(table.columns, table.index, table, cmap="viridis", **look)
    bends = [path[["delta_x_mm", "delta_y_mm"]].to_numpy() for path in paths]
    best = bends[0][paths[0]["rmse_mV"].argmin()]
    drawn = {"half the step": bends[-1], "descent": bends[0], "start": bends[0][0], "truth": truth}
    for name, points in (drawn | {"estimate": best}).items():
        panel.plot(*points.T, **MAP[name])
    panel.set(
        xlabel=r"$\Delta_x$ [mm]", xlim=table.columns[[0, -1]],
        ylabel=r"$\Delta_y$ [mm]", ylim=table.index[[0, -1]],
    )  # fmt: skip
    panel.grid(visible=False)


@style()
def rig_stills(robot: Robot, times: np.ndarray, truth: np.ndarray, found: np.ndarray) -> Figure:
    """Draw Fig. 11, lower row: the true segment opaque, the estimates ``[time, seed, 3]`` [m] pale."""
    figure, panels = _six_in_space([f"{time_s:.1f} s" for time_s in times])
    at = [robot.magnets[0].place, *(sensor.place for sensor in robot.sensors)]
    looks: dict[str, Look] = {
        "truth": {"color": BODY[0], "lw": 3},
        "estimates": {"color": ORANGE, "lw": 3, "alpha": 0.45},
        "magnet": {"color": GREEN, "marker": "o", "ls": ""},
        "sensor": {"color": BLUE, "marker": "s", "ls": ""},
    }
    for k, panel in enumerate(panels):
        for q in found[k]:
            panel.plot(*(1e3 * robot.backbone(q)).T, **looks["estimates"])
        panel.plot(*(1e3 * robot.backbone(truth[k])).T, **looks["truth"])
        p = 1e3 * robot.poses(truth[k], at)[:, :3, 3]
        panel.plot(*p[:1].T, ms=7, **looks["magnet"])
        panel.plot(*p[1:].T, ms=4, **looks["sensor"])
    return with_legend(figure, looks, columns=4, loc="upper center")
