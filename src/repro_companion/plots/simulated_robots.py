"""Figures of the simulated robots of Baaij et al.: Table 1, Figs 2(a) and 4 to 7."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import matplotlib.pyplot as plt
import numpy as np
import pandas as pd
from IPython.display import HTML
from matplotlib.axes import Axes
from matplotlib.collections import PatchCollection
from matplotlib.colors import LinearSegmentedColormap, LogNorm
from matplotlib.figure import Figure
from matplotlib.patches import Arc, Polygon
from matplotlib.ticker import MaxNLocator, MultipleLocator

from repro import Ring
from repro_companion import scorecard_page
from repro_companion.papers.baaij import Row
from repro_companion.plots.style import (
    BESIDE,
    BLUE,
    BODY,
    FOUR,
    GREEN,
    GREY_INK,
    NO_GRID,
    ORANGE,
    PINK,
    PUBLISHED,
    SKY,
    TRUTH,
    TRUTH_ESTIMATE,
    WIDTH,
    Look,
    column_of_panels,
    halves_of_rings,
    over_time,
    row_of_panels,
    style,
    to_scale,
    with_legend,
    with_spread,
)
from repro_companion.show import rendered

# Table 1 of Baaij et al.

VERDICTS = {
    "reproduced": "reproduced",
    "weak": "weak, zero would pass too",
    "better": "better",
    "differs": "differs",
}


def table_1(card: pd.DataFrame, rows: Sequence[Row]) -> HTML:
    """Return Table 1 as printed: in each cell the published number and below it ours, tinted by verdict."""
    lines = []
    for row in rows:
        own = card[card["row"] == row.name].set_index("quantity")
        robot = f"n_b={row.n_segments}, n_s={row.n_segments * row.sensors_per_segment}"
        name = robot if row.name[:3] in ("n_b", "n_s", "nom") else row.name
        cells = {quantity: _cell(found) for quantity, found in own.iterrows()}
        about = {"again": row.same_as, "printed": scorecard_page.words(name), "label": row.label}
        lines.append(about | {"cells": cells})
    return HTML(rendered("table_1.html", rows=lines, verdicts=VERDICTS))


def _cell(row: pd.Series) -> dict[str, str]:
    factor, places = (1e3, 0) if row.name == "e_u" else (1.0, 1)
    texts = {}
    for name in ("published", "regenerated"):
        mean, std = (pd.to_numeric(row[key]) * factor for key in (name, f"{name}_std"))
        places += name == "regenerated" and std < 0.5 / 10**places  # no deviation is shown as zero
        texts[name] = with_spread(mean, std, places, "±")
    kind = "weak" if row["weak"] == "true" and row["verdict"] in VERDICTS else row["verdict"]
    return texts | {"kind": kind, "title": VERDICTS.get(kind, kind)}


@style()
def sensor_models(table: pd.DataFrame) -> Figure:
    """Draw the error of one segment by sensor model and estimator, one point for each seed."""
    figure, panel = plt.subplots(figsize=(WIDTH, 2.3))
    names = list(table["model"].unique())[::-1]
    looks = {"gradient descent": (BLUE, "o", 0.13), "Levenberg-Marquardt": (ORANGE, "D", -0.13)}
    for solver, part in table.groupby("solver", sort=False):
        colour, marker, shift = looks[str(solver)]
        places = part["model"].map(names.index) + shift
        panel.plot(part["configuration_percent"], places, marker, color=colour, ms=6, label=solver)
    panel.set(
        xscale="log", xlabel="mean error of the configuration [% of its range]",
        ylim=(-0.5, len(names) - 0.5), yticks=range(len(names)), yticklabels=names,
    )  # fmt: skip
    return with_legend(figure, columns=2)


@style()
def calibration(table: pd.DataFrame) -> Figure:
    """Draw mean errors by row of Table 1, a column for each method; hollow marks are with more noise."""
    figure, panel = plt.subplots(figsize=(WIDTH, 0.34 * len(table) + 1.6))
    y = np.arange(len(table))[::-1]
    looks = {
        "nominal": (SKY, "s", None),
        "nominal, more noise": (SKY, "s", "none"),
        "calibrated": (ORANGE, "D", None),
        "calibrated, more noise": (ORANGE, "D", "none"),
        "network of the paper": (BLUE, "o", None),
        "network, more noise": (BLUE, "o", "none"),
        "Table 1, published": (PUBLISHED, "|", None),
    }
    panel.hlines(y, table["calibrated"], table["nominal"], color="0.75", lw=1)
    for label, (colour, marker, face) in looks.items():
        size = 11 if marker == "|" else 6
        panel.plot(table[label], y, marker, color=colour, mfc=face, ms=size, mew=1.6, label=label)
    panel.set(
        xscale="log", xlabel="mean error of the configuration [% of its range]",
        yticks=y, yticklabels=table.index,
    )  # fmt: skip
    panel.xaxis.set_major_formatter("{x:g}")
    return with_legend(figure, columns=2)


@style()
def tip_paths(paths: dict[str, tuple[np.ndarray, np.ndarray]]) -> Figure:
    """Draw true and estimated paths of tips ``[t, 3]`` [m] of several robots, seen along the straight robot."""
    figure, panels = row_of_panels(len(paths), 2.5, "y [mm]")
    for panel, (name, (truth, found)) in zip(panels, paths.items(), strict=True):
        panel.plot(*1e3 * truth[:, :2].T, label="truth", **TRUTH)
        panel.plot(*1e3 * found[:, :2].T, color=BLUE, lw=1.3, label="estimate")
        panel.set(title=name, xlabel="x [mm]", aspect="equal")
        panel.xaxis.set_major_locator(MaxNLocator(3))
        panel.yaxis.set_major_locator(MaxNLocator(4))
    return with_legend(figure, panels[0])


# First steps, and sensors that fail: Figs 2(a), 4 and 5 of Baaij et al.

XYZ = ["x_mm", "y_mm", "z_mm"]


def body_colours(n: int) -> list[np.ndarray]:
    """Return the colours of segments from base to tip."""
    return list(LinearSegmentedColormap.from_list("body", BODY)(np.linspace(0, 1, max(n, 2)))[:n])


@style(**GREY_INK, **NO_GRID)
def field_of_robot(field: pd.DataFrame, parts: pd.DataFrame, backbone: pd.DataFrame, ring: Ring) -> Figure:
    """Draw Fig. 4(a): the field of all magnets in the x-z plane around the robot."""
    grid = field.pivot(index="z_mm", columns="x_mm", values=["b_x_mT", "b_z_mT"])
    # Streamlines want even steps, which numbers from a file have only to their digits.
    x, z = (np.linspace(i[0], i[-1], len(i)) for i in (grid["b_x_mT"].columns, grid.index))
    b_x, b_z = grid["b_x_mT"].to_numpy(), grid["b_z_mT"].to_numpy()
    figure, panel = plt.subplots(figsize=(4.3, 5.4))
    size = np.hypot(b_x, b_z)
    image = panel.pcolormesh(x, z, size, norm=LogNorm(1e-2, 100), shading="gouraud", cmap="cividis")
    panel.streamplot(x, z, b_x, b_z, color=(1, 1, 1, 0.55), linewidth=0.7, density=1.4, arrowsize=0.7)
    segments = backbone.groupby("segment")
    for colour, (_, part) in zip(body_colours(len(segments)), segments, strict=True):
        panel.plot(part["x_mm"], part["z_mm"], color="white", lw=6)
        panel.plot(part["x_mm"], part["z_mm"], color=colour, lw=4)
    panel.add_collection(
        PatchCollection(halves_of_rings(*_in_plane(parts, "magnet"), ring), fc=GREEN, ec="white", zorder=4)
    )
    at, along = _in_plane(parts, "sensor")
    panel.quiver(*at.T, *along.T, color=SKY, ec="black", lw=0.5, scale=14, width=0.014, zorder=5)
    panel.plot([], [], "s", color=GREEN, label="magnet, cut")
    panel.plot([], [], ">", color=SKY, mec="black", mew=0.5, ms=9, label="sensor")
    panel.legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=2, **BESIDE)
    to_scale(panel, x[[0, -1]], z[[0, -1]], every_mm=50)
    bar = figure.colorbar(image, label="flux density in the plane [mT]", shrink=0.8, pad=0.02, extend="max")
    bar.ax.yaxis.set_major_formatter("{x:g}")
    return figure


def _in_plane(parts: pd.DataFrame, part: str) -> tuple[np.ndarray, np.ndarray]:
    """Return places [mm] and axes of the magnets or of the sensors, x and z only."""
    own = parts[parts["part"] == part]
    return own[["x_mm", "z_mm"]].to_numpy(float), own[["axis_x", "axis_z"]].to_numpy(float)


@style(**NO_GRID)
def relations(parts: pd.DataFrame, backbone: pd.DataFrame, ring: Ring) -> Figure:
    """Draw Fig. 2(a) to scale: distance and angles between the first sensor and the magnet of its segment."""
    (p_m, o_m), (p_s, o_s) = ([x[0] for x in _in_plane(parts, part)] for part in ("magnet", "sensor"))
    p = p_s - p_m
    line = backbone[["x_mm", "z_mm"]].to_numpy()
    figure, panel = plt.subplots(figsize=(5.2, 4.6))
    tangent = np.gradient(line, axis=0)
    side = 22 * np.stack([tangent[:, 1], -tangent[:, 0]], 1) / np.linalg.norm(tangent, axis=1)[:, None]
    panel.add_patch(Polygon(np.concatenate([line + side, (line - side)[::-1]]), fc="#767676", alpha=0.13))
    panel.plot(*line.T, color="0.45", lw=1, ls=(0, (6, 3)))
    panel.add_collection(PatchCollection(halves_of_rings(p_m[None], o_m[None], ring), fc=GREEN, alpha=0.5))
    _arrow(panel, p_m, p, "$p$", "0.2", along=0.55, aside=4.5)
    _arrow(panel, p_m, 30 * o_m, "$o_m$", GREEN, along=1.13, aside=0.0)
    _arrow(panel, p_s, 26 * o_s, "$o_s$", BLUE, along=0.85, aside=6.0)
    for at, colour, name, offset in ((p_m, GREEN, "magnet", (-46, -4)), (p_s, BLUE, "sensor", (30, -5))):
        panel.plot(*at, "o", color=colour, ms=8)
        panel.annotate(name, at, xytext=offset, textcoords="offset points", ha="center", color=colour)
    for direction, colour in ((o_m, GREEN), (p / np.hypot(*p), "0.2")):
        panel.plot(*np.stack([p_s, p_s + 28 * direction], 1), ":", color=colour, lw=1.6)
    _angle(panel, p_m, (o_m, p), r"$\theta$", radius=17)
    _angle(panel, p_s, (o_s, o_m), r"$\alpha$", radius=12)
    _angle(panel, p_s, (o_s, p), r"$\beta$", radius=19)
    panel.plot([-22, 22], [0, 0], color="0.2", lw=4, solid_capstyle="butt")
    to_scale(panel, (-28, 98), (-6, 116), every_mm=20)
    return figure


def _arrow(
    panel: Axes, start: np.ndarray, vector: np.ndarray, name: str, colour: str, along: float, aside: float
) -> None:
    """Draw a vector; its name stands at a share of its length, so far aside."""
    arrow = {"arrowstyle": "-|>", "color": colour, "lw": 2, "shrinkA": 0, "shrinkB": 0}
    panel.annotate("", start + vector, start, arrowprops=arrow)
    at = start + along * vector + aside * np.array([vector[1], -vector[0]]) / np.hypot(*vector)
    panel.text(*at, name, color=colour, ha="center", va="center", fontsize=14)


def _angle(panel: Axes, at: np.ndarray, between: Sequence[np.ndarray], name: str, radius: float) -> None:
    """Draw the smaller angle between two directions, with its name."""
    start, end = (np.degrees(np.arctan2(v[1], v[0])) for v in between)
    low, high = sorted((start, start + (end - start + 180) % 360 - 180))
    panel.add_patch(Arc(at, 2 * radius, 2 * radius, theta1=low, theta2=high, color="0.2", lw=1.3))
    middle = np.radians((low + high) / 2)
    where = at + (radius + 5) * np.array([np.cos(middle), np.sin(middle)])
    panel.text(*where, name, ha="center", va="center", fontsize=13)


@style()
def equation_15(table: pd.DataFrame) -> Figure:
    """Draw one segment by eq. (15) as printed and without the division by v."""
    figure, panel = plt.subplots(figsize=(4.6, 4.4))
    arc, printed = table[["x_mm", "z_mm"]].to_numpy(), table[["x_printed_mm", "z_printed_mm"]].to_numpy()
    half = int((table["v"] - 0.5).abs().idxmin())
    panel.plot(*arc.T, lw=2.6, color=BLUE)
    panel.plot(*printed.T, "--", lw=2.2, color=ORANGE)
    panel.plot([-12, 12], [0, 0], color="0.2", lw=4, solid_capstyle="butt")
    for text, at, offset, colour in (
        ("middle", arc[half], (10, -6), BLUE),
        ("middle, as printed", printed[half], (8, 6), ORANGE),
        ("tip, both", arc[-1], (10, -4), "0.2"),
    ):
        panel.plot(*at, "o", color=colour)
        panel.annotate(text, at, xytext=offset, textcoords="offset points", color=colour)
    panel.annotate("base", (12, 0), xytext=(6, -3), textcoords="offset points", color="0.2")
    to_scale(panel, (-30, 90), (-8, 124), every_mm=20)
    return figure


@style()
def three_moves(table: pd.DataFrame) -> Figure:
    """Draw what the sensors of one segment read while it bends towards x, towards y, or becomes longer."""
    words = (r"bend $\Delta_x$ [mm]", r"bend $\Delta_y$ [mm]", r"longer by $\delta L$ [mm]")
    figure, panels = row_of_panels(3, 3.0, "reading [mT]", sharey=True)
    for panel, label, (_, part) in zip(panels, words, table.groupby("move", sort=False), strict=True):
        for k, sensor in enumerate(table.columns[2:]):
            look = {"color": FOUR[k % 4], "ls": ("-", "--", "-.", ":")[k % 4], "lw": 2.2}
            panel.plot(part["mm"], part[sensor], label=f"sensor {k + 1}", **look)
        panel.set_xlabel(label)
        panel.xaxis.set_major_locator(MultipleLocator(2 if np.ptp(part["mm"]) < 10 else 10))
    figure.legend(*panels[0].get_legend_handles_labels(), loc="outside upper center", ncols=3)
    return figure


@style()
def readings_and_shape(u: pd.DataFrame, q: pd.DataFrame, failed: Sequence[int], failure_s: float) -> Figure:
    """Draw Fig. 4(b): readings above, configurations below; truth, and the mean over seeds with its deviation."""
    signs = (r"\Delta_{x,%d}", r"\Delta_{y,%d}", r"\delta L_{%d}")
    n = u["name"].nunique() // 4  # segments
    figure, panels = column_of_panels(2 * n, 2.1 * n + 0.7, "time [s]")
    for table, own, per in ((u, panels[:n], 4), (q, panels[n:], 3)):
        for k, (name, part) in enumerate(table.groupby("name", sort=False)):
            text = f"u_{{{name}}}" if per == 4 else signs[k % 3] % (k // 3 + 1)
            works = (part["time_s"] < failure_s) | (per == 3) | (name not in failed)
            over_time(own[k // per], part, FOUR[k % per], works, label=f"${text}$")
    for panel, every in zip(panels, [0.5] * n + [10] * n, strict=True):
        panel.axvline(failure_s, color="0.4", lw=1.2, ls=":")
        panel.legend(
            loc="center left", bbox_to_anchor=(1.0, 0.5), fontsize=14.6, **BESIDE | {"labelspacing": 0}
        )
        panel.margins(x=0.01)
        panel.yaxis.set_major_locator(MultipleLocator(every))
    panels[n // 2].set_ylabel("reading [mT]")
    panels[-1 - n // 2].set_ylabel("configuration [mm]")
    figure.align_ylabels(panels)
    lost = TRUTH_ESTIMATE["truth"] | {"alpha": 0.2}
    looks = {"truth, sensor failed": lost, "failure": {"color": "0.4", "lw": 1.2, "ls": ":"}}
    return with_legend(figure, TRUTH_ESTIMATE | looks, columns=2, handlelength=1.6)


@style()
def stills(shapes: pd.DataFrame, parts: pd.DataFrame, beside: str = "") -> Figure:
    """Draw shapes at several times, the truth opaque and the estimates pale, with magnets and sensors: Figs 5 and 7.

    Above each stands the mean distance of the estimated tips from the true one; in brackets, of the run ``beside``,
    which is not drawn.
    """
    points = pd.concat([shapes, parts])[XYZ].to_numpy(float)
    low, high = points.min(0), points.max(0)
    times, looks = shapes["time_s"].unique(), STILLS if (~parts["working"]).any() else STILLS[:2]
    rows = -(-len(times) // 3)
    tall = 2.3 * rows + 0.45
    figure = plt.figure(figsize=(WIDTH, tall), layout="none")  # pictures in 3-D waste their margins
    for k, time_s in enumerate(times):
        place = (k % 3 * STILL_APART, (rows - 1 - k // 3) * 2.3 / tall - 0.04, 1 / 3, 2.3 / tall + 0.06)
        panel = figure.add_axes(place, projection="3d", computed_zorder=False, elev=15, azim=-60)
        panel.set(**{f"{name}lim": ends for name, *ends in zip("xyz", low, high, strict=True)})
        panel.set_box_aspect(high - low, zoom=1.06)
        for axis in (panel.xaxis, panel.yaxis, panel.zaxis):
            axis.set_major_locator(MultipleLocator(100))
            axis.set_major_formatter("")
        now = shapes[shapes["time_s"] == time_s]
        _shapes(panel, now[now["run"] != beside])
        _parts(panel, parts[parts["time_s"] == time_s], looks)
        tips = now.groupby("run")[XYZ].last()
        off = np.sqrt(((tips - tips.loc["truth"]) ** 2).sum(axis=1))
        bracket = f" ({off[beside]:.1f})" if beside else ""
        words = f"{time_s:.1f} s\n{off.drop(['truth', beside], errors='ignore').mean():.1f}{bracket} mm"
        figure.text(k % 3 * STILL_APART + 1 / 6, (rows - k // 3) * 2.3 / tall, words, ha="center", va="top")
    bodies = {
        name: {"color": BODY[0], "lw": 4, "alpha": a} for name, a in (("truth", 1.0), ("estimate", PALE))
    }
    parts_of = {words: look for _, _, words, look in looks}
    return with_legend(figure, bodies | parts_of, columns=5, loc="upper center")


def _shapes(panel: Axes, now: pd.DataFrame) -> None:
    """Draw the shapes of all runs at one time, the last run first."""
    for run, own in [*now.groupby("run", sort=False)][::-1]:
        for colour, (_, part) in zip(body_colours(3), own.groupby("segment"), strict=False):
            panel.plot(*part[XYZ].to_numpy().T, color=colour, lw=4, alpha=1.0 if run == "truth" else PALE)


def _parts(panel: Axes, now: pd.DataFrame, looks: Sequence[tuple[str, bool, str, Look]]) -> None:
    """Draw magnets and sensors at one time."""
    for kind, works, _, look in looks:
        chosen = (now["part"] == kind) & (now["working"] == works)
        panel.plot(*now.loc[chosen, XYZ].to_numpy().T, **look)


STILL_APART = 0.305
"""From one still to the next, of the width of the figure: their empty margins overlap."""
PALE = 0.45
"""Opacity of estimated shapes in stills; in print they are as wide as the true ones, and slightly transparent."""
STILLS: Sequence[tuple[str, bool, str, Look]] = (
    ("magnet", True, "magnet", {"marker": "o", "color": GREEN, "ms": 6, "ls": ""}),
    ("sensor", True, "sensor", {"marker": "s", "color": BLUE, "ms": 3.5, "ls": ""}),
    ("sensor", False, "failed sensor", {"marker": "X", "color": PINK, "ms": 7, "mew": 0, "ls": ""}),
)
"""Looks of parts in stills."""


# Affine curvature: Figs 6 and 7 of Baaij et al.

AFFINE_NAMES = {
    "kappa_0": r"$\kappa_0$ [rad]",
    "kappa_1": r"$\kappa_1$ [rad]",
    "phi": r"$\phi$ [rad]",
    "delta_L": r"$\delta L$ [mm]",
}


@style()
def affine_idea(shapes: Mapping[str, np.ndarray], tips: np.ndarray) -> Figure:
    """Draw shapes ``[n, 3]`` [m] from the side with their names, and the path of the tip ``[t, 3]`` from above."""
    figure, (left, right) = plt.subplots(1, 2, figsize=(WIDTH, 3.2))
    for name, points in shapes.items():
        x, _, z = 1e3 * points.T
        left.plot(x, z, lw=2.4)
        left.annotate(name, (x[-1], z[-1]), (-10, 5), textcoords="offset points")
    to_scale(left, (-100, 205), (-10, 225), every_mm=100, title="four shapes, from the side")
    right.plot(*1e3 * tips[:, :2].T, lw=2.4)
    right.set(title="the flower, from above", xlabel="x [mm]", ylabel="y [mm]", aspect="equal")
    return figure


@style()
def affine_over_time(series: pd.DataFrame) -> Figure:
    """Draw Fig. 6: readings above, configuration below; truth, and the mean over seeds with its deviation."""
    figure, panels = column_of_panels(5, 6.3, "time [s]", height_ratios=[2.3, 1, 1, 1, 1])
    readings = series[series["name"].str.startswith("u_")]
    for number, (_, part) in enumerate(readings.groupby("name", sort=False)):
        over_time(panels[0], part, FOUR[number % 3])
    for panel, (name, words) in zip(panels[1:], AFFINE_NAMES.items(), strict=True):
        over_time(panel, series[series["name"] == name], BLUE)
        panel.set_ylabel(words)
    for panel, every in zip(panels, (1, 0.5, 2, 3, 3), strict=True):
        panel.yaxis.set_major_locator(MultipleLocator(every))
    panels[0].set_ylabel("readings [mT]")
    panels[-1].set_xmargin(0.01)
    figure.align_ylabels(panels)
    planes = {f"at {100 * k} mm": {"color": FOUR[k], "lw": 2.4} for k in range(3)}
    return with_legend(figure, planes | TRUTH_ESTIMATE, columns=3)
