"""The look of all figures, and the figures of the pages."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from itertools import product
from typing import Any

import matplotlib as mpl
import matplotlib.pyplot as plt
import numpy as np
import pandas as pd
from cycler import cycler
from IPython.display import HTML
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.collections import PatchCollection
from matplotlib.colors import LinearSegmentedColormap, LogNorm
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Arc, Circle, Polygon
from matplotlib.ticker import LogLocator, MaxNLocator, MultipleLocator
from matplotlib.typing import LineStyleType

from repro import Ring, Robot
from repro.improve import Improvement
from repro_companion import scorecard_page
from repro_companion.papers.baaij import Row
from repro_companion.show import rendered

WIDTH = 5.5
"""Width of a figure [in]: letters of 10.2 points are 9 px high where a phone shows it and its margin 358 px wide."""
BLUE, ORANGE, GREEN, PINK, YELLOW, SKY = "#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9"
"""Okabe and Ito: safe for colour-blind readers, and read on a light and on a dark ground."""
PUBLISHED, OURS, BEST = "#767676", BLUE, ORANGE
TRUTH = {"color": "#767676", "lw": 4.0, "alpha": 0.55, "solid_capstyle": "round"}
"""Look of the truth where an estimate lies on it: wide and pale."""

Look = Mapping[str, Any]
"""How something is drawn: options of matplotlib."""
STYLE: Look = {
    "figure.facecolor": "none",  # a page shows its own ground, and inverts figures in dark mode
    "axes.facecolor": "none",
    "savefig.facecolor": "none",
    "figure.figsize": (WIDTH, 3.6),
    "figure.dpi": 120,
    "savefig.dpi": 120,
    "figure.constrained_layout.use": True,
    "font.size": 10.2,
    "axes.titlesize": 10.2,
    "axes.labelsize": 10.2,
    "figure.labelsize": 10.2,
    "xtick.labelsize": 10.2,
    "ytick.labelsize": 10.2,
    "legend.fontsize": 10.2,
    "legend.frameon": False,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "grid.alpha": 0.25,
    "lines.linewidth": 1.6,
    "axes.prop_cycle": cycler(color=[BLUE, ORANGE, GREEN, PINK, YELLOW, SKY, "#000000"]),
    "image.cmap": "viridis",
    "svg.hashsalt": "repro",
}
GREY_INK = dict.fromkeys(
    ("text.color", "axes.labelcolor", "axes.edgecolor", "xtick.color", "ytick.color"), "#767676"
)
"""Letters of a figure that is not inverted in dark mode: they are read on both grounds."""
NO_GRID, LEVELS = {"axes.grid": False}, {"axes.grid.axis": "y"}
"""Grids of figures that are no curves: none, or lines of the same height."""


def use_style() -> None:
    """Draw all figures of a notebook in the book's style, whatever the reader's matplotlibrc says."""
    mpl.rcdefaults()
    mpl.rcParams.update(STYLE)


@contextmanager
def style(**more: str | bool) -> Iterator[None]:
    """Draw one figure in the book's style, for a notebook to show once, as the result of its cell; a decorator."""
    with mpl.rc_context():
        use_style()
        mpl.rcParams.update(more)
        yield
    plt.close()


BESIDE = {"handlelength": 1.0, "handletextpad": 0.4, "columnspacing": 0.9, "labelspacing": 0.3}
"""Spaces of a legend that has little room."""


def row_of_panels(count: int, height: float, ylabel: str, **grid: object) -> tuple[Figure, Sequence[Axes]]:
    """Return a figure and its panels side by side; the label of the vertical axis stands once."""
    figure, (panels,) = plt.subplots(1, count, figsize=(WIDTH, height), squeeze=False, **grid)
    panels[0].set_ylabel(ylabel)
    return figure, panels


def column_of_panels(count: int, height: float, xlabel: str, **grid: object) -> tuple[Figure, Sequence[Axes]]:
    """Return a figure and its panels below each other, with one horizontal axis whose label stands once."""
    figure, panels = plt.subplots(count, 1, figsize=(WIDTH, height), squeeze=False, sharex=True, **grid)
    panels[-1, 0].set_xlabel(xlabel)
    return figure, panels[:, 0]


def marks(looks: Mapping[str, Look]) -> list[Line2D]:
    """Return entries of a legend from what they say and how it is drawn."""
    return [Line2D([], [], label=label, **look) for label, look in looks.items()]


def with_legend(
    figure: Figure, of: Axes | Mapping[str, Look] | None = None, columns: int = 2, **look: object
) -> Figure:
    """Return a figure for its cell with a legend above all panels: of one panel, of given looks, or of everything."""
    lines = of.get_legend_handles_labels()[0] if isinstance(of, Axes) else marks(of) if of else None
    figure.legend(handles=lines, ncols=columns, **({"loc": "outside upper center"} | BESIDE | look))
    return figure


def curves(
    panel: Axes,
    table: pd.DataFrame,
    by: str,
    x: str,
    y: str,
    looks: Mapping[Any, Look],
    **more: Any,
) -> None:
    """Draw a line for each group of a table, in the order of the table, and name it."""
    for name, part in table.groupby(by, sort=False):
        panel.plot(part[x], part[y], label=name, **more, **looks[name])


def plain_numbers(*axes: Axis) -> None:
    """Write numbers along logarithmic axes as they are typed, and none between the main ticks."""
    for axis in axes:
        axis.set_major_formatter("{x:g}")
        axis.set_minor_formatter("")


def to_scale(panel: Axes, x: Sequence[float], z: Sequence[float], every_mm: float, **more: str) -> None:
    """Give a panel the same scale [mm] along x and z, with even ticks."""
    panel.set(**({"xlabel": "x [mm]", "ylabel": "z [mm]"} | more), aspect="equal", xlim=x, ylim=z)
    for axis in (panel.xaxis, panel.yaxis):
        axis.set_major_locator(MultipleLocator(every_mm))


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

BODY = ("#222222", "#8A2BE2")
"""Segments from base to tip, black to violet as in the paper."""
FOUR = (BLUE, GREEN, PINK, ORANGE)
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
        PatchCollection(_cut(*_in_plane(parts, "magnet"), ring), fc=GREEN, ec="white", zorder=4)
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


def _cut(centres: np.ndarray, axes: np.ndarray, ring: Ring) -> list[Polygon]:
    """Return the two halves of each ring, cut along its axis."""
    inner, outer, h = (500 * size for size in (ring.inner_diameter, ring.outer_diameter, ring.height))
    across, along = np.array([inner, outer, outer, inner]), np.array([-h, -h, h, h])
    return [
        Polygon(centre + np.outer(side * across, [axis[1], -axis[0]]) + np.outer(along, axis))
        for centre, axis in zip(centres, axes, strict=True)
        for side in (-1, 1)
    ]


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
    panel.add_collection(PatchCollection(_cut(p_m[None], o_m[None], ring), fc=GREEN, alpha=0.5))
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
    figure, panels = column_of_panels(2 * n, 1.84 * n + 0.7, "time [s]")
    for table, own, per in ((u, panels[:n], 4), (q, panels[n:], 3)):
        for k, (name, part) in enumerate(table.groupby("name", sort=False)):
            text = f"u_{{{name}}}" if per == 4 else signs[k % 3] % (k // 3 + 1)
            works = (part["time_s"] < failure_s) | (per == 3) | (name not in failed)
            _over_time(own[k // per], part, FOUR[k % per], works, label=f"${text}$")
    for panel, every in zip(panels, [0.5] * n + [10] * n, strict=True):
        panel.axvline(failure_s, color="0.4", lw=1.2, ls=":")
        panel.legend(loc="center left", bbox_to_anchor=(1.0, 0.5), **BESIDE)
        panel.margins(x=0.01)
        panel.yaxis.set_major_locator(MultipleLocator(every))
    panels[n // 2].set_ylabel("reading [mT]")
    panels[-1 - n // 2].set_ylabel("configuration [mm]")
    figure.align_ylabels(panels)
    lost = TRUTH_ESTIMATE["truth"] | {"alpha": 0.2}
    looks = {"truth, sensor failed": lost, "failure": {"color": "0.4", "lw": 1.2, "ls": ":"}}
    return with_legend(figure, TRUTH_ESTIMATE | looks, columns=2, handlelength=1.6)


TRUTH_ESTIMATE: dict[str, dict[str, Any]] = {
    "truth": {"color": "0.4", "lw": 3.6, "alpha": 0.45},
    "estimate": {"color": "0.4", "lw": 1.2, "ls": (0, (4, 2))},
}
"""Looks of curves over time."""


def _over_time(
    panel: Axes, part: pd.DataFrame, colour: str, works: pd.Series | None = None, label: str = ""
) -> None:
    t, truth, mean, deviation = (part[name] for name in ("time_s", "truth", "mean", "std"))
    valid = truth.notna() if works is None else works
    wide, dashed = (look | {"color": colour} for look in TRUTH_ESTIMATE.values())
    panel.plot(t, truth.where(valid), label=label, **wide)
    panel.plot(t, truth.mask(valid), **wide | {"alpha": 0.15})
    panel.plot(t, mean, **dashed)
    panel.fill_between(t, mean - deviation, mean + deviation, color=colour, alpha=0.2, lw=0)


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
        _over_time(panels[0], part, FOUR[number % 3])
    for panel, (name, words) in zip(panels[1:], AFFINE_NAMES.items(), strict=True):
        _over_time(panel, series[series["name"] == name], BLUE)
        panel.set_ylabel(words)
    for panel, every in zip(panels, (1, 0.5, 2, 3, 3), strict=True):
        panel.yaxis.set_major_locator(MultipleLocator(every))
    panels[0].set_ylabel("readings [mT]")
    panels[-1].set_xmargin(0.01)
    figure.align_ylabels(panels)
    planes = {f"at {100 * k} mm": {"color": FOUR[k], "lw": 2.4} for k in range(3)}
    return with_legend(figure, planes | TRUTH_ESTIMATE, columns=3)


# The rig: Figs 8 to 11 of Baaij et al.

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


def with_spread(mean: float, std: float, places: int, between: str = " ± ") -> str:
    """Return a mean with its deviation, if there is one, to so many places; a dash where there is no mean."""
    spread = f"{between}{std:.{places}f}" if np.isfinite(std) else ""
    return f"{mean:.{places}f}{spread}" if np.isfinite(mean) else "–"


@style(**NO_GRID)
def rig_to_scale(robot: Robot, markers_at: float) -> Figure:
    """Draw Fig. 8 as a section and from above, to scale [mm]: body, chambers, ring, sensors and markers."""
    figure, (side, top) = plt.subplots(1, 2, figsize=(WIDTH, 4.0), width_ratios=(1.15, 1))
    segment, magnet = robot.segments[0], robot.magnets[0]
    length, radius, at = 1e3 * segment.length, 1e3 * segment.radius, 1e3 * magnet.place.at
    inner, outer = 500 * magnet.shape.inner_diameter, 500 * magnet.shape.outer_diameter
    look = {"fc": "#76767622", "ec": "#767676"}
    side.add_patch(Polygon([(-radius, 0), (radius, 0), (radius, length), (-radius, length)], **look))
    for half in _cut(np.array([[0.0, at]]), np.array([[0.0, 1.0]]), magnet.shape):
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
def landscape_and_estimates(
    maps: dict[str, tuple[pd.DataFrame, list[pd.DataFrame], np.ndarray]],
    series: dict[str, np.ndarray],
    zoom_s: tuple[float, float],
) -> Figure:
    """Draw Fig. 10: the loss [mV] with the paths of descents [mm]; below, the bend over time, and a part of T5.

    A map holds the loss, what the descent tries (and what it would try with half the step), and the truth. A series
    holds truth and the estimates of all seeds ``[t, 2, 1 + seeds]`` [mm] of a trajectory.
    """
    places = [[*maps], *([name] * len(maps) for name in (*series, "a part"))]
    figure, panels = plt.subplot_mosaic(places, figsize=(WIDTH, 9.6), height_ratios=(2.8, 1.6, 1.6, 1.6))
    for title, of_map in maps.items():
        _landscape(panels[title], *of_map)
        panels[title].set_title(title)
    drawn_on = [panels[title] for title in maps]
    figure.colorbar(drawn_on[0].collections[0], ax=drawn_on, label="error of the readings [mV]")
    last = [*series][-1]
    for name, values in (series | {"a part": series[last]}).items():
        for k, colour in enumerate((BLUE, ORANGE)):
            found = pd.DataFrame(values[:, k, 1:])
            curves = {"time_s": np.arange(len(values)) / 40, "truth": values[:, k, 0]}
            curves |= {"mean": found.mean(axis=1), "std": found.std(axis=1)}
            _over_time(panels[name], pd.DataFrame(curves), colour)
        panels[name].set(title=name, ylabel="bend [mm]", xmargin=0)
    panels["a part"].set(xlim=zoom_s, xlabel="time [s]", title=f"{last}, a part of it")
    looks: dict[str, Look] = {
        r"$\Delta_x$": {"color": BLUE, "lw": 3},
        r"$\Delta_y$": {"color": ORANGE, "lw": 3},
        "truth": {"color": "#767676", "lw": 3, "alpha": 0.6},
        "estimate": {"color": "#767676", "lw": 1.2, "ls": (0, (4, 2))},
    }
    beside = {"loc": "lower center", "bbox_to_anchor": (0.5, 1.15), **BESIDE}
    panels[next(iter(series))].legend(handles=marks(looks), ncols=4, **beside)
    return with_legend(figure, MAP, columns=5)


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


# Bend tests and light bulb: Figs 9 and 8 of Mitchell et al.

BEND_LOOKS = (
    {"color": "#767676", "lw": 4.0, "alpha": 0.55},
    {"color": ORANGE, "lw": 1.2},
    {"color": BLUE, "lw": 1.4, "ls": (0, (4, 2))},
    {"color": GREEN, "lw": 1.6, "ls": ":"},
    {"color": PINK, "lw": 1.2, "ls": (0, (6, 1.5, 1, 1.5))},
)
"""Of motion capture and of the methods, in the order of the table."""


def take_name(name: str) -> str:
    """Return a take's name as a reader sees it."""
    return name.replace("bend_", "test ").replace("_try_", ", try ")


@style()
def bend_tests(table: pd.DataFrame) -> Figure:
    """Draw Fig. 9: bend and direction over time, a pair of panels for each take."""
    takes = list(table["take"].unique())
    looks = dict(zip(table["method"].unique(), BEND_LOOKS, strict=False))
    columns = min(len(takes), 3)
    rows = -(-len(takes) // columns)
    end = table["time_s"].max()
    figure, panels = plt.subplots(
        2 * rows, columns, figsize=(WIDTH, (1.85 if rows > 1 else 3.0) * rows + 0.9), squeeze=False,
        sharey="row", height_ratios=[1.7, 1] * rows,
    )  # fmt: skip
    for k in range(len(takes), rows * columns):
        for panel in panels[2 * rows - 2 :, k % columns]:
            panel.set_axis_off()
    for k, take in enumerate(takes):
        angle, direction = panels[2 * (k // columns) : 2 * (k // columns) + 2, k % columns]
        own = table[table["take"] == take]
        curves(angle, own, "method", "time_s", "bend_deg", looks)
        curves(direction, own, "method", "time_s", "direction_deg", looks)
        angle.set(title=take_name(take), xlim=(0, end), ylim=(-4, 66), yticks=(0, 30, 60))
        direction.set(xlim=(0, end), ylim=(-40, 40), yticks=(-30, 0, 30))
        for panel in (angle, direction):
            panel.xaxis.set_major_locator(MultipleLocator(5 if columns == 1 else 20))
        angle.tick_params(labelbottom=False)
        if k % columns == 0:
            angle.set_ylabel("bend [°]")
            direction.set_ylabel("direction\n[°]")
        if k >= len(takes) - columns:
            direction.set_xlabel("time [s]")
    figure.align_ylabels(panels)
    return with_legend(figure, looks, columns=2)


@style(**LEVELS)
def bend_errors(errors: pd.DataFrame) -> Figure:
    """Draw the errors of bend and direction by take, a mark for each method."""
    takes, names = sorted(errors["take"].unique()), list(errors["name"].unique())
    figure, panels = plt.subplots(2, 1, figsize=(WIDTH, 5.6), sharex=True, height_ratios=[1.4, 1])
    colours = (PINK, ORANGE, YELLOW, SKY, BLUE, GREEN, "#767676")
    for k, (name, colour, marker) in enumerate(zip(names, colours, "osDvX^P", strict=False)):
        own = errors[errors["name"] == name].set_index("take").reindex(takes)
        x = np.arange(len(takes)) + 0.12 * (k - (len(names) - 1) / 2)
        look = {"color": colour, "ls": "", "marker": marker, "ms": 5, "mew": 0}
        panels[0].plot(x, own["rmse_deg"], label=name, **look)
        panels[1].plot(x, own["direction_deg"], **look)
    panels[0].set(ylabel="bend: RMSE [°]", ylim=(0, None))
    panels[1].set(ylabel="direction: RMSE [°]", ylim=(0, None), xlabel="test and try")
    panels[1].set_xticks(range(len(takes)), [take[5:].replace("_try_", "\ntry ") for take in takes])
    for panel in panels:
        for edge in range(1, len(takes)):
            panel.axvline(edge - 0.5, color="#767676", lw=0.5, alpha=0.5)
    return with_legend(figure, columns=2, handlelength=0.5)


@style()
def light_bulb(curves: pd.DataFrame, events: pd.DataFrame, threshold: float) -> Figure:
    """Draw Fig. 8: angle and direction of the bend by the paper's filter, and below the ratio that tells events."""
    files = list(curves["file"].unique())
    figure, panels = plt.subplots(
        3,
        len(files),
        figsize=(WIDTH, 5.4),
        sharex="col",
        sharey="row",
        squeeze=False,
        height_ratios=[3, 3, 2],
    )
    for column, file in zip(panels.T, files, strict=True):
        own = curves[curves["file"] == file]
        column[0].plot(own["time_s"], own["bend_deg"], color=ORANGE, lw=1)
        column[1].plot(own["time_s"], own["direction_deg"], ".", color=ORANGE, ms=1.5)
        column[2].plot(own["time_s"], own["ratio"], color=BLUE, lw=1)
        column[2].plot(own["time_s"], own["baseline"] + threshold, color="#767676", lw=1, ls="--")
        for start, end in events.loc[events["file"] == file, ["start_s", "end_s"]].to_numpy():
            for panel in column:
                panel.axvspan(start, end, color=YELLOW, alpha=0.25, lw=0)
        column[0].set(title=file.replace("light_", "file "), ylim=(0, 95), yticks=(0, 30, 60, 90))
        column[1].set(ylim=(-190, 190), yticks=(-180, -90, 0, 90, 180))
        column[2].set_xlabel("time [s]")
        column[2].xaxis.set_major_locator(MultipleLocator(20))
    for panel, words in zip(panels[:, 0], ("bend angle [°]", "bend direction [°]", "ratio"), strict=True):
        panel.set_ylabel(words)
    looks: dict[str, Look] = {
        "paper's filter": {"color": ORANGE},
        "ratio of the fields": {"color": BLUE},
        "threshold": {"color": "#767676", "ls": "--"},
        "event": {"color": YELLOW, "lw": 6, "alpha": 0.4},
    }
    figure.align_ylabels(panels)
    return with_legend(figure, looks, columns=4)


# The particle filter: Figs 3 to 5 of Mitchell et al.

CURVE_LOOKS = {"spiral": (BLUE, "o"), "flower": (ORANGE, "s"), "seagull": (GREEN, "D")}


@style(**NO_GRID)
def bend_space(curves: pd.DataFrame, cloud: pd.DataFrame) -> Figure:
    """Draw Figs 3 and 4: the disc of bends [deg] with a cloud of particles, and with each curve."""
    figure, panels = plt.subplots(2, 2, figsize=(WIDTH, 5.6), sharex=True, sharey=True)
    particles, truth = cloud[cloud["part"] == "particle"], cloud[cloud["part"] == "truth"]
    panels[0, 0].plot(particles["x_deg"], particles["y_deg"], ".", color=SKY, ms=3, mew=0)
    panels[0, 0].plot(truth["x_deg"], truth["y_deg"], "o", color="#D00000", ms=5)
    panels[0, 0].set_title("one state, and particles")
    for panel, (name, part) in zip(panels.flat[1:], curves.groupby("curve", sort=False), strict=True):
        panel.plot(part["x_deg"], part["y_deg"], lw=1, color=CURVE_LOOKS[str(name)][0])
        panel.set_title(str(name).capitalize())
    for panel in panels.flat:
        for radius in (30, 60, 90):
            panel.add_patch(Circle((0, 0), radius, fill=False, lw=1.2 if radius == 90 else 0.5, color="0.6"))
        panel.set(aspect="equal", xlim=(-95, 95), ylim=(-95, 95), xticks=(-90, 0, 90), yticks=(-90, 0, 90))
    figure.supxlabel(r"$\varphi\,\cos\theta$ [deg]")
    figure.supylabel(r"$\varphi\,\sin\theta$ [deg]")
    return figure


@style()
def filter_steps(
    q: np.ndarray, w: np.ndarray, drawn: np.ndarray, truth: np.ndarray, estimate: np.ndarray
) -> Figure:
    """Draw a cloud of bend vectors [rad] as it is weighed and drawn again; dots grow with weight and copies."""
    figure, panels = plt.subplots(1, 3, figsize=(WIDTH, 2.6))
    heavy, (kept, copies), middle = w > 1e-3, np.unique(drawn, return_counts=True), np.degrees(truth)
    panels[1].scatter(*np.degrees(q[heavy]).T, s=6 + 400 * w[heavy], color=YELLOW, alpha=0.7, lw=0)
    panels[2].scatter(*np.degrees(q[kept]).T, s=6 + 400 * copies / len(q), color=BLUE, alpha=0.7, lw=0)
    square = middle + np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
    panels[0].add_patch(Polygon(square, fill=False, zorder=4))
    for panel, title, reach in zip(panels, ("before", "weighed", "drawn again"), (11, 1, 1), strict=True):
        if title != "drawn again":
            panel.plot(*np.degrees(q).T, ".", color="0.6", ms=3, mew=0)
        panel.plot(*middle, "o", color="#D00000", ms=6, label="truth")
        panel.plot(*np.degrees(estimate), "x", color="#1A1A1A", ms=7, mew=2, label="estimate")
        x, y = ((at - reach, at + reach) for at in middle)
        panel.set(title=title, aspect="equal", xlim=x, ylim=y)
        panel.locator_params(nbins=3, integer=True)
    panels[0].set_ylabel(r"$\varphi\,\sin\theta$ [deg]")
    figure.supxlabel(r"$\varphi\,\cos\theta$ [deg]")
    return with_legend(figure, panels[0], columns=2)


@style()
def bend_error_over_time(table: pd.DataFrame, printed: dict[str, float]) -> Figure:
    """Draw Fig. 5: the error of the magnet's place [mm] over the parameter of a curve, by number of particles."""
    figure, panels = column_of_panels(len(printed), 4.6, "parameter $t$ of the curve", sharey=True)
    for panel, (name, rmse) in zip(panels, printed.items(), strict=True):
        runs = table[table["curve"] == name].groupby("particles")
        for colour, (n, part) in zip((SKY, BLUE), runs, strict=False):
            panel.plot(part["t"], part["error_mm"], lw=1, color=colour, label=f"{n} particles")
        panel.axhline(rmse, color=PUBLISHED, ls="--", label="published RMSE, 1000 particles")
        panel.set(title=name.capitalize(), ylabel="error [mm]", ylim=(0, None), xmargin=0)
    return with_legend(figure, panels[0], columns=3)


@style()
def bend_error_by_noise(
    clean: pd.DataFrame, law: pd.Series, noisy: pd.DataFrame, single: float, printed: Sequence[float]
) -> Figure:
    """Draw the error [mm] over process noise: without sensor noise beside the law, and with it for two motions."""
    figure, (top, bottom) = column_of_panels(2, 6.4, "process noise [π rad per step]", height_ratios=(1.3, 1))
    for name, part in clean.groupby("curve", sort=False):
        colour, marker = CURVE_LOOKS[str(name)]
        label = str(name).capitalize()
        top.plot("process_noise_pi", "rmse_mm", marker, data=part, color=colour, ms=6, label=label)
    top.plot(law.index, law, color="0.5", lw=1, label="law")
    top.axhspan(min(printed) - 5e-5, max(printed) + 5e-5, color=YELLOW, alpha=0.8, lw=0, label="published")
    top.axvline(0.02, color="0.5", lw=1, ls=":", label="noise in the paper")
    top.set(yscale="log", title="perfect sensor")
    for name, part in noisy.groupby("setting", sort=False):
        look = {"random walk": (SKY, "v"), "constant velocity": (ORANGE, "^")}[str(name)]
        own = part.groupby("process_noise_pi")["rmse_mm"].mean()
        bottom.plot(own.index, own, color=look[0], marker=look[1], ms=6, label=name)
    bottom.axhline(single, color="0.5", ls="--", label="least squares, one reading")
    bottom.set(
        title="real sensor, mean of the curves", yscale="log", ylim=(0.035, 0.13), yticks=[0.04, 0.06, 0.1],
        xscale="log", xticks=[5e-4, 0.002, 0.005, 0.02],
    )  # fmt: skip
    plain_numbers(bottom.xaxis, bottom.yaxis, top.yaxis)
    for panel in (top, bottom):
        panel.set_ylabel("RMSE [mm]")
        panel.legend(loc="center left", bbox_to_anchor=(1.0, 0.5), **BESIDE)
    return figure


# Motion sensors: Table II and Figs 3 to 6 of Martin et al.

MARKER_LOOKS = {"M1": (BLUE, 360.0), "M2": (PINK, 600.0)}
"""Colours of the paper, and distances along the arm [mm]."""


def table_ii(printed: pd.DataFrame, errors: pd.DataFrame, badge: str, words: str) -> HTML:
    """Return Table II as printed: published relative errors [%], below them ours; words say what ours are."""
    known = printed.set_index(["row", "quantity"])["printed"]
    models = {"rigid-body": "rigid-body, 8 IMUs", "PCC-extended": "PCC-extended, 8 IMUs, 16 segments"}
    quantities = {"median": ("median", "median_mm"), "q3": ("Q3", "q75_mm")}
    rows = {}
    for (marker, (_, at)), (quantity, (name, column)) in product(MARKER_LOOKS.items(), quantities.items()):
        cells = []
        for model, case in models.items():
            own = errors[(errors["case"] == case) & (errors["marker"] == marker)]
            ours = own.groupby("draw")[column].mean() * 100 / at
            cells.append((known[f"{marker} {model}", quantity], with_spread(ours.mean(), ours.std(), 1)))
        rows[f"{marker} ({at:.0f} mm), {name}"] = cells
    return HTML(rendered("table_ii.html", models=models, rows=rows, badge=badge, words=words))


@style(**LEVELS)
def marker_boxes(boxes: pd.DataFrame, printed: dict[str, pd.DataFrame]) -> Figure:
    """Draw Figs 3 to 5: boxes of the markers' errors [mm] with published medians and third quartiles."""
    groups = {
        "Fig. 3": ("n_imus", "IMUs", "rigid-body"),
        "Fig. 4": ("segments", "segments", "PCC, 8 IMUs"),
        "Fig. 5": ("n_imus", "IMUs", "PCC, 16 segments"),
    }
    figure, panels = row_of_panels(3, 3.6, "error [mm]", sharey=True, width_ratios=(3, 4, 3))
    for panel, (name, (column, label, model)) in zip(panels, groups.items(), strict=True):
        own = boxes[boxes["figure"] == name]
        steps = sorted(own[column].unique())
        for _, case in own.iterrows():
            shift = -0.2 if case["marker"] == "M1" else 0.2
            _box(panel, case, steps.index(case[column]) + shift, case[column], column, printed[name])
        panel.set(
            title=f"{name}:\n{model}", xlabel=label, ylim=(0, None),
            xticks=range(len(steps)), xticklabels=steps,
        )  # fmt: skip
    looks = {marker: {"color": colour, "lw": 6, "alpha": 0.4} for marker, (colour, _) in MARKER_LOOKS.items()}
    looks |= {"published median": PRINTED | {"marker": "D"}, "published Q3": PRINTED | {"marker": "^"}}
    return with_legend(figure, looks, columns=4)


PRINTED: dict[str, Any] = {"color": "#1A1A1A", "mec": "white", "ls": ""}
"""Look of what is printed, on boxes."""


def _box(panel: Axes, case: pd.Series, x: float, number: int, column: str, printed: pd.DataFrame) -> None:
    """Draw the box of one case, and what is printed of it."""
    colour, at = MARKER_LOOKS[case["marker"]]
    shares = {"whislo": "q05", "q1": "q25", "med": "median", "q3": "q75", "whishi": "q95"}
    panel.bxp([{key: case[f"{q}_mm"] for key, q in shares.items()}], positions=[x], widths=0.34,
              showfliers=False, patch_artist=True, manage_ticks=False,
              boxprops={"facecolor": colour, "alpha": 0.35, "edgecolor": colour},
              medianprops={"color": colour, "lw": 2}, whiskerprops={"color": colour},
              capprops={"color": colour})  # fmt: skip
    ending = {"n_imus": "IMUs", "segments": "segments( and more)?"}[column]
    printed_as = rf"{case['marker']} .*\b{min(number, 16)} {ending}"  # "16 segments and more"
    for row in printed[printed["row"].str.fullmatch(printed_as)].itertuples():
        value = row.value * (at / 100 if row.unit == "%" else 1)
        panel.plot(x, value, marker="D" if row.quantity == "median" else "^", ms=6, **PRINTED)


@style()
def error_hull(hull: pd.DataFrame) -> Figure:
    """Draw Fig. 6: the arm in one pose of each mode, leaning to one side, in a hull with the error as radius."""
    modes = hull.groupby("mode", sort=False)
    figure, panels = row_of_panels(len(modes), 2.2, "height [mm]", sharex=True, sharey=True)
    for panel, (mode, part) in zip(panels, modes, strict=True):
        arm, estimate = (part[[f"{of}{axis}_mm" for axis in "xyz"]].to_numpy() for of in ("", "estimate_"))
        line = from_the_side(arm, arm)
        joints, fine = np.arange(len(line)), np.linspace(0, len(line) - 1, 400)
        dense = [np.interp(fine, joints, y) for y in (*line.T, np.r_[0.0, part["radius_mm"]])]
        discs = [Circle((x, z), r) for x, z, r in zip(*dense, strict=True)]
        for look in ({"color": BLUE, "lw": 2.5}, {"color": "#A6D5F2", "lw": 0}):  # outline, hull
            panel.add_collection(PatchCollection(discs, **look))
        panel.plot(*line.T, color="#1A1A1A", lw=2)
        panel.plot(*from_the_side(estimate, arm).T, color=ORANGE)
        panel.set(title=mode, aspect="equal", xlabel="horizontal [mm]")
    looks = {"arm": {"color": "#1A1A1A"}, "estimate": {"color": ORANGE}}
    looks["within Q3 of the error"] = {"color": "#A6D5F2", "lw": 6}
    return with_legend(figure, looks, columns=3)


def from_the_side(points: np.ndarray, arm: np.ndarray) -> np.ndarray:
    """Return the base and points ``[n, 3]`` as seen from the side to which an arm leans ``[1 + n, 2]``."""
    away = arm[-1, :2] / np.linalg.norm(arm[-1, :2])
    return np.vstack([[0, 0], np.stack([points[:, :2] @ away, points[:, 2]], axis=-1)])


@style()
def links_of_models(chains: dict[str, np.ndarray], arm: np.ndarray, links: int) -> Figure:
    """Draw joints of models ``[points, 3]`` [m] beside the arm, from the side, with the gap after each link."""
    figure, panels = row_of_panels(len(chains), 3.8, "height [mm]", sharex=True, sharey=True)
    side = 1e3 * from_the_side(arm, arm)[1:]
    for panel, (name, joints), colour in zip(panels, chains.items(), (ORANGE, BLUE), strict=True):
        line = 1e3 * from_the_side(joints, arm)
        panel.plot(*side.T, color="#1A1A1A", lw=2, label="arm")
        panel.plot(*line.T, "o-", color=colour, ms=3.5, lw=2)
        ends = [x[:: (len(x) - 1) // links] for x in (line, side)]
        panel.plot(*np.stack(ends, axis=1)[1:].T, color="0.45", ls=":")
        panel.plot([], [], color="0.45", ls=":", label="from the end of a link to its place on the arm")
        panel.set(title=name, xlabel="horizontal [mm]", aspect="equal")
    return with_legend(figure, panels[0], columns=2)


@style()
def errors_at_markers(choices: Mapping[Sequence[int], np.ndarray], marked: np.ndarray) -> Figure:
    """Draw median errors at both markers [mm] of choices of IMUs, and of one other."""
    figure, (panel,) = row_of_panels(1, 3.2, "error at M2 [mm]")
    panel.plot(*np.transpose([*choices.values()]), "o", ms=4, label="three IMUs")
    panel.plot(*marked, "s", color=ORANGE, ms=7, label="IMUs 2, 4, 6 and 8")
    best = min(choices, key=lambda imus: choices[imus][1])
    panel.annotate(", ".join(map(str, best)), choices[best], (6, -4), textcoords="offset points")
    panel.set(xlabel="error at M1 [mm]", xlim=(0, None), ylim=(0, None))
    return with_legend(figure)


# A real arm

ARM_LOOKS = {
    "released filter": ("#B0B0B0", "filter, released"),
    "released window": ("#8A8A8A", "window, released"),
    "released batch": ("#5E5E5E", "batch, released"),
    "filter": (SKY, "our filter"),
    "smoother": (BLUE, "our smoother"),
}


@style(**LEVELS)
def real_arm_errors(errors: pd.DataFrame) -> Figure:
    """Draw mean errors [mm] by trial as bars, raw readings above calibrated ones."""
    names = list(errors["trial"].unique())
    figure, panels = plt.subplots(2, 1, figsize=(WIDTH, 4.6), sharex=True, sharey=True)
    for panel, (setting, part) in zip(panels, errors.groupby("setting", sort=False), strict=True):
        for k, (estimator, (colour, label)) in enumerate(ARM_LOOKS.items()):
            own = part[part["estimator"] == estimator].set_index("trial")["rmse_mm"].reindex(names)
            panel.bar(np.arange(len(names)) + 0.17 * (k - 2), own, 0.16, color=colour, label=label)
        panel.set(ylabel="error [mm]", title=f"{setting} readings")
    panels[1].set_xticks(range(len(names)), names)
    return with_legend(figure, panels[0], columns=3)


@style()
def real_arm_still(points: pd.DataFrame) -> Figure:
    """Draw the arm from two sides at one moment: motion capture and estimates at the base and four stations [mm]."""
    looks = {
        "motion capture": TRUTH,
        "our smoother": {"color": BLUE, "marker": "o", "ms": 4},
        "window, released": {"color": "#5E5E5E", "marker": "s", "ms": 4, "ls": "--"},
    }
    figure, panels = row_of_panels(2, 3.6, "z [mm]", sharey=True)
    for panel, axis in zip(panels, "xy", strict=True):
        for name, part in points.groupby("line", sort=False):
            along, up = np.append(0.0, part[f"{axis}_mm"]), np.append(0.0, part["z_mm"])
            panel.plot(along, up, label=name, **looks[str(name)])
        panel.set(xlabel=f"{axis} [mm]", aspect="equal", xmargin=0.3)
    return with_legend(figure, panels[0], columns=3)


# Robots of others

OTHERS: Mapping[str, Look] = {
    "shape": {"color": BLUE, "lw": 2.2},
    "drawn": {"color": PUBLISHED, "lw": 2.2},
    "sensors": {"color": GREEN, "marker": "s", "ms": 3, "ls": ""},
    "bodies": {"color": PUBLISHED, "marker": "s", "ms": 4, "ls": ""},
    "found": {"color": BLUE, "marker": ".", "ms": 4, "ls": ""},
    "measured": {"color": ORANGE, "marker": "o", "ms": 4.5, "mfc": "none", "ls": ""},
}
"""Looks of what the small pictures show."""


@style(**NO_GRID)
def robots_of_others(shapes: pd.DataFrame) -> Figure:
    """Draw a small picture of each robot, the base below, above a bar of its scale."""
    names = list(shapes["robot"].unique())
    rows = -(-len(names) // 4)
    figure, panels = plt.subplots(rows, 4, figsize=(WIDTH, 2.25 * rows), squeeze=False)
    for panel in panels.ravel():
        panel.set_axis_off()
    for panel, (name, part) in zip(panels.ravel(), shapes.groupby("robot", sort=False), strict=False):
        curves(panel, part, "look", "x_mm", "z_mm", OTHERS)
        low, high = part[["x_mm", "z_mm"]].min(), part[["x_mm", "z_mm"]].max()
        size, middle, bar = (high - low).max(), (high + low) / 2, part["bar_mm"].iloc[0]
        below = middle["z_mm"] - 0.62 * size
        if bar:
            panel.plot(middle["x_mm"] + np.array([-0.5, 0.5]) * bar, [below, below], color="0.5", lw=1.5)
            panel.text(middle["x_mm"], below - 0.05 * size, f"{bar} mm", ha="center", va="top")
        x, z = (middle[axis] + 0.6 * size * np.array([-1, 1]) for axis in ("x_mm", "z_mm"))
        panel.set(xlim=x, ylim=(z[0] - 0.2 * size, z[1]), aspect="equal", title=name)
    looks = {label: OTHERS[look] for look, label in OTHERS_WORDS.items()}
    return with_legend(figure, looks, columns=4, loc="outside lower center")


OTHERS_WORDS = {"shape": "found", "measured": "measured", "sensors": "sensors", "drawn": "drawn by us"}


@style()
def tips_of_trunk(table: pd.DataFrame) -> Figure:
    """Draw how far the tip is off over the judged frames, a panel for each motion."""
    figure, panels = plt.subplots(2, 1, figsize=(WIDTH, 4.2), sharey=True)
    for panel, (name, part) in zip(panels, table.groupby("motion", sort=False), strict=True):
        for column, colour in (("arcs", SKY), ("with what was learned", BLUE)):
            panel.plot(part["frame"], part[column], color=colour, lw=1.2, label=column)
        panel.set(title=str(name), ylabel="tip is off [mm]", ylim=(0, None))
    panels[-1].set_xlabel("frame")
    return with_legend(figure, panels[0])


@style(**LEVELS)
def markers_of_tentacle(table: pd.DataFrame) -> Figure:
    """Draw the mean error at each marker, a line for each model."""
    figure, panel = plt.subplots(figsize=(WIDTH, 2.9))
    for name, colour in zip(table.columns[1:], (PUBLISHED, BLUE, SKY, GREEN), strict=True):
        panel.plot(table["marker"], table[name], "o-", color=colour, label=name)
    panel.set(xlabel="marker, base to tip", ylabel="mean error [mm]", xticks=table["marker"], ylim=(0, None))
    return with_legend(figure)


@style()
def contacts(table: pd.DataFrame) -> Figure:
    """Draw the errors of all contacts in the plane, and the median of the stated half-widths as an ellipse."""
    figure, panel = plt.subplots(figsize=(0.75 * WIDTH, 3.9))
    panel.plot(table["x_mm"], table["y_mm"], ".", color=BLUE, ms=3, alpha=0.5, label="a contact")
    angle = np.linspace(0, 2 * np.pi, 100)
    half = table[["half_x_mm", "half_y_mm"]].median()
    ring = {"color": ORANGE, "lw": 2, "label": "stated interval of 90 % of each axis, median"}
    panel.plot(half["half_x_mm"] * np.cos(angle), half["half_y_mm"] * np.sin(angle), **ring)
    panel.set(xlabel="error in x [mm]", ylabel="error in y [mm]", aspect="equal")
    return with_legend(figure, columns=1)


@style()
def magnet_errors(table: pd.DataFrame) -> Figure:
    """Draw the errors of all poses along each axis with their stated intervals."""
    figure, panels = column_of_panels(3, 4.6, "pose", sharey=True)
    for panel, axis in zip(panels, "xyz", strict=True):
        bars = {"yerr": table[f"half_{axis}_mm"], "fmt": "o", "ms": 3, "color": BLUE, "ecolor": SKY}
        panel.errorbar(range(1, len(table) + 1), table[f"{axis}_mm"], **bars)
        panel.axhline(0, color="0.5", lw=1)
        panel.set_ylabel(f"{axis} [mm]")
    return figure


# How many sensors

NOISE_COLOURS = (SKY, BLUE, ORANGE, PINK, GREEN, YELLOW)


@style()
def sensors_and_noise(table: pd.DataFrame) -> Figure:
    """Draw errors [%] of the longest arm over sensors per segment, a line for each noise; dashed: the bound."""
    n = table["n_segments"].max()
    part = table[table["n_segments"] == n]
    figure, panel = plt.subplots(figsize=(WIDTH, 3.4))
    for colour, (noise, own) in zip(NOISE_COLOURS, part.groupby("noise_mt"), strict=False):
        label = f"{float(f'{1e3 * noise:.1g}'):g} µT"
        panel.plot(own["n_sensors"], own["mean_percent"], "o-", color=colour, ms=5, label=label)
        known = own[np.isfinite(own["bound_percent"])]
        panel.plot(known["n_sensors"], known["bound_percent"], "--", color="0.2", lw=1)
    panel.set(
        title=f"{n} segment" + "s" * int(n > 1),
        xticks=sorted(part["n_sensors"].unique()), xlabel="sensors on each segment",
        yscale="log", ylabel="mean error [% of the range]",
    )  # fmt: skip
    panel.yaxis.set_major_formatter("{x:g}")
    panel.plot([], [], "--", color="0.2", lw=1, label="bound")
    return with_legend(figure, panel, columns=5)


@style()
def chips_and_error(better: Improvement) -> Figure:
    """Draw the median deviation of the tip [mm] over the number of chips of a design."""
    figure, panel = plt.subplots(figsize=(WIDTH, 2.8))
    better.plot(panel)
    return figure


@style()
def noise_study(table: pd.DataFrame) -> Figure:
    """Draw errors [%] over the noise by sensor model; a column for each estimator, a row by number of segments."""
    names = ("network of the paper", "fast network", "multipole")
    looks = {
        name: {"color": c, "marker": m}
        for name, c, m in zip(names, (BLUE, GREEN, ORANGE), "osD", strict=True)
    }
    solvers, segments = table["solver"].unique(), table["n_b"].unique()
    figure, panels = plt.subplots(
        len(segments), len(solvers), figsize=(WIDTH, 1.0 + 2.1 * len(segments)),
        sharex=True, sharey=True, squeeze=False,
    )  # fmt: skip
    for row, n in zip(panels, segments, strict=True):
        for panel, solver in zip(row, solvers, strict=True):
            own = table[(table["solver"] == solver) & (table["n_b"] == n)]
            curves(panel, own, "model", "noise_mt", "mean_percent", looks, ms=4)
            limit = own.drop_duplicates("noise_mt")
            panel.plot(limit["noise_mt"], limit["bound_percent"], "--", color="0.2", lw=1, label="bound")
            panel.set(xscale="log", yscale="log", xticks=[1e-4, 1e-2], xticklabels=["10⁻⁴", "10⁻²"])
        row[0].set_ylabel(f"{n} segment" + "s" * int(n > 1) + "\nerror [%]")
        row[0].yaxis.set_major_formatter("{x:g}")
    for panel, solver in zip(panels[0], solvers, strict=True):
        panel.set_title(solver)
    figure.supxlabel("noise of a reading [mT]")
    return with_legend(figure, panels[0, 0])


@style(**GREY_INK, **NO_GRID)
def sensor_places(table: pd.DataFrame, marked: dict[str, tuple[float, float]]) -> Figure:
    """Draw deviations of the tip [mm] over radius and height of the sensors: by noise, and before calibration."""
    columns = {"noise_mm": "noise alone", "off_mm": "noise and tolerances"}
    figure, panels = row_of_panels(2, 4.0, "height above the magnet [mm]", sharex=True, sharey=True)
    for panel, (column, title) in zip(panels, columns.items(), strict=True):
        wide = table.pivot(index="above_mm", columns="radial_mm", values=column)
        colours = panel.pcolormesh(wide.columns, wide.index, wide, norm=LogNorm(), shading="nearest")
        bar = figure.colorbar(colours, ax=panel, location="bottom", label="± of the tip [mm]")
        bar.ax.xaxis.set_major_locator(LogLocator(subs=(1, 2, 5)))
        plain_numbers(bar.ax.xaxis)
        for marker, (name, place) in zip("so^", marked.items(), strict=False):
            panel.plot(*place, marker=marker, mfc="white", mec="black", ms=9, ls="none", label=name)
        panel.set(title=title, xlabel="radius [mm]")
    return with_legend(figure, panels[0], columns=3)


@style()
def imus_and_errors(table: pd.DataFrame) -> Figure:
    """Draw errors of the tip [mm] over the number of IMUs: perfect ones by model, and with errors of their own."""
    figure, (upper, lower) = column_of_panels(2, 6.6, "number of IMUs", sharey=True)
    perfect, models = table[table["sensor_deg"] == 0], table["model"].unique()
    for model, colour in zip(models, (PINK, ORANGE, BLUE, GREEN), strict=True):
        own = perfect[perfect["model"] == model]
        upper.plot(own["n_imus"], own["largest_mm"], "o-", color=colour, ms=4, label=model)
        upper.plot(own["n_imus"], own["bound_mm"], "--", color=colour, lw=1)
    real = table[(table["model"] == models[1]) & (table["sensor_deg"] > 0)]
    for (deg, own), colour in zip(real.groupby("sensor_deg"), (SKY, YELLOW, "0.3"), strict=False):
        lower.plot(own["n_imus"], own["rms_mm"], "o", color=colour, ms=5)
        lower.plot(own["n_imus"], own["rule_mm"], color=colour, lw=1)
        end = own[["n_imus", "rule_mm"]].iloc[-1]
        lower.annotate(f"{deg:g}°", end, (6, 0), textcoords="offset points", va="center")
    for panel, title in ((upper, "perfect IMUs"), (lower, "IMUs with errors")):
        panel.set(
            title=title, xscale="log", xticks=[1, 2, 4, 8, 16], yscale="log", ylabel="error of the tip [mm]"
        )
        plain_numbers(panel.xaxis)
    upper.yaxis.set_major_formatter("{x:g}")
    return with_legend(figure, upper, columns=2)


# Closing the loop


@style()
def loop_over_time(series: pd.DataFrame) -> Figure:
    """Draw paths of the bend [mm] for every estimate that is fed back, and distances to the reference.

    The distances are without the third run, which would hide the others.
    """
    runs = list(series.groupby("feedback", sort=False))
    figure = plt.figure(figsize=(WIDTH, 4.8))
    grid = figure.add_gridspec(2, len(runs) - 1, height_ratios=(1.25, 1))
    below, first = figure.add_subplot(grid[1, :]), None
    for k, ((name, part), colour) in enumerate(zip(runs, ("0.45", ORANGE, PINK, BLUE), strict=True)):
        away = np.hypot(*(part[f"delta_{axis}_mm"] - part[f"reference_{axis}_mm"] for axis in "xy"))
        if k != 2:
            below.plot(part["time_s"], away, lw=1.2, color=colour, label=name)
        if k:
            panel = figure.add_subplot(grid[0, k - 1], sharex=first, sharey=first)
            first = first or panel
            panel.plot(part["reference_x_mm"], part["reference_y_mm"], **TRUTH)
            panel.plot(part["delta_x_mm"], part["delta_y_mm"], lw=1, color=colour)
            panel.set(aspect="equal", xlabel="bend in x [mm]", title=str(name).replace("r with", "r\nwith"))
            panel.set_ylabel("bend in y [mm]") if k == 1 else panel.tick_params(labelleft=False)
    below.set(xlabel="time [s]", ylabel="distance [mm]", ylim=(0, None), xmargin=0)
    return with_legend(figure, below, columns=3, loc="outside lower center")


# Which sensors

SEGMENT_LOOKS = {
    "ring and 3 sensors": (BLUE, "o"),
    "cube and Hall sensor, middle": (PINK, "v"),
    "2 IMUs": (ORANGE, "s"),
    "ring and IMUs, one arc": (SKY, "^"),
    "ring and IMUs, two arcs": (GREEN, "D"),
}


@style(**LEVELS)
def segment_errors(means: pd.DataFrame) -> Figure:
    """Draw mean tip errors [mm] by trajectory and method with their intervals: filled if calibrated, else open."""
    names = list(means["trajectory"].unique())
    figure, panel = plt.subplots(figsize=(WIDTH, 4.2))
    looks = {method: look for method, look in SEGMENT_LOOKS.items() if method in set(means["method"])}
    for k, (method, (colour, marker)) in enumerate(looks.items()):
        for calibrated, part in means[means["method"] == method].groupby("calibrated"):
            at = np.arange(len(names)) + 0.16 * (k - (len(looks) - 1) / 2) + (0.0 if calibrated else 0.05)
            part = part.set_index("trajectory").loc[names]
            ends = [part["tip_mm"] - part["low_mm"], part["high_mm"] - part["tip_mm"]]
            fill = {"mfc": colour if calibrated else "none", "label": method if calibrated else ""}
            panel.errorbar(
                at, part["tip_mm"], ends, fmt=marker, color=colour, ms=6, capsize=2, lw=1.0, **fill
            )
    panel.set(
        xticks=range(len(names)), xticklabels=names, xlim=(-0.5, len(names) - 0.5),
        yscale="log", yticks=[0.1, 0.3, 1, 3, 10, 30, 100], ylabel="error at the tip [mm]",
    )  # fmt: skip
    panel.yaxis.set_major_formatter("{x:g}")
    panel.minorticks_off()
    points = {name: {"color": colour, "marker": marker, "ls": ""} for name, (colour, marker) in looks.items()}
    grey = {"color": "#767676", "marker": "o", "ls": ""}
    points |= {"calibrated": grey, "not calibrated": grey | {"mfc": "none"}}
    return with_legend(figure, points, columns=2)


# Sensors that drift

SPAN: Look = {"color": "#505050", "alpha": 0.16, "lw": 0}
"""A time that is marked: seen on a light ground and, inverted, on a dark one."""
DRIFT_LOOKS: Mapping[str, tuple[str, LineStyleType, str]] = {
    "IMU only": (ORANGE, "-", "IMUs only"),
    "magnets only": (SKY, "-", "magnets only"),
    "magnets self-calibrating": (SKY, ":", "magnets, drift in state"),
    "fused": (PINK, (0, (3, 2)), "calibrated once"),
    "self-calibrating": (GREEN, "-", "drift in the state"),
    "oracle": ("#767676", "--", "knows the drift"),
}


@style()
def drift_errors(minutes: pd.DataFrame, last: int) -> Figure:
    """Draw the median error of the tip [% of the length] of all runs by minute; two bands hold all runs."""
    figure, panel = plt.subplots(figsize=(WIDTH, 3.2))
    end = int(minutes["minute"].max())
    panel.axvspan(end - last + 0.5, end + 0.5, **SPAN)
    for method, (colour, line, label) in DRIFT_LOOKS.items():
        by_minute = minutes[minutes["method"] == method].groupby("minute")["tip_rmse_percent"]
        middle = by_minute.median()
        panel.plot(middle.index, middle, ls=line, color=colour, label=label)
        if method in ("fused", "self-calibrating"):
            panel.fill_between(middle.index, by_minute.min(), by_minute.max(), color=colour, alpha=0.15, lw=0)
    panel.set(
        xlabel="time [min]", xlim=(0.5, None), xticks=[1, *range(5, end + 1, 5)],
        ylabel="error of the tip\n[% of the length]", yscale="log", yticks=[0.2, 0.5, 1, 2, 5],
    )  # fmt: skip
    plain_numbers(panel.yaxis)
    return with_legend(figure, panel, columns=2)


@style()
def drift_learnt(learnt: pd.DataFrame) -> Figure:
    """Draw true and estimated errors of sensors over time, with two standard deviations to either side."""
    figure, panels = column_of_panels(learnt["error"].nunique(), 5.2, "time [min]")
    for panel, (name, part) in zip(panels, learnt.groupby("error", sort=False), strict=True):
        time, middle, wide = part["minute"], part["estimate"], 2 * part["std"]
        panel.plot(time, part["truth"], label="truth", **TRUTH)
        panel.plot(time, middle, color=GREEN, label="estimate")
        panel.fill_between(time, middle - wide, middle + wide, color=GREEN, alpha=0.2, lw=0)
        panel.set(ylabel=str(name).replace(" [", "\n["))
    return with_legend(figure, panels[0], columns=2)


@style()
def live_failures(table: pd.DataFrame, fails_at_s: float) -> Figure:
    """Draw error and stated deviation of the tip over time: a panel for each failure, a colour for each arm."""
    failures = list(table[table["failure"] != "none"].groupby("failure", sort=False))
    height = 1.55 * len(failures) + 1.0
    figure, panels = column_of_panels(len(failures), height, "time [s]", sharey=True)
    for panel, (failure, part) in zip(panels, failures, strict=True):
        for (chips, rows), colour in zip(part.groupby("sensors", sort=False), (BLUE, ORANGE), strict=True):
            for column, line, name in (("tip_error_mm", "-", "error"), ("tip_std_mm", "--", "stated ±")):
                panel.plot(rows["time_s"], rows[column], line, color=colour, label=f"{name}, {chips} chips")
        panel.axvline(fails_at_s, color=PUBLISHED, lw=4, alpha=0.5, zorder=0)
        panel.set(yscale="log", yticks=[0.1, 1, 10, 100], title=failure, ylabel="tip [mm]")
        panel.yaxis.set_major_formatter("{x:g}")
    return with_legend(figure, panels[0])


# A robot of one's own


@style()
def failing_chip(shape: Any, tip_std_mm: np.ndarray, fails_at_s: float) -> Figure:
    """Draw the stated deviation of the tip, and the first reading of every chip with its residual, over time."""
    figure, (stated, above, below) = column_of_panels(3, 6.6, "time [s]")
    stated.plot(shape.times, tip_std_mm, color="0.35")
    stated.set_yscale("log", subs=[])
    stated.set_yticks([1, 2, 5, 10, 20], ["1", "2", "5", "10", "20"])
    for k, (name, colour) in enumerate(zip(shape.robot.part_names, FOUR, strict=True)):
        rows, first = np.flatnonzero(shape.suspects[:, k])[::10], np.argmax(shape.robot.parts == k)
        u, u_hat = shape.readings[:, first], shape.u_hat[:, first]
        above.plot(shape.times, u, color=colour, lw=5, alpha=0.35)
        above.plot(shape.times, u_hat, color=colour, lw=1.2, label=name)
        below.plot(shape.times, u - u_hat, ".", ms=3, color=colour)
        below.plot(shape.times[rows], (u - u_hat)[rows], "x", color="black", ms=5, mew=1)
    above.legend(loc="lower center", bbox_to_anchor=(0.5, 0.98), ncols=4, **BESIDE)
    for panel, name in zip(
        figure.axes, ("± of the tip [mm]", "readings [mT]", "residuals [mT]"), strict=True
    ):
        panel.axvline(fails_at_s, color=PUBLISHED, lw=4, alpha=0.5, zorder=0)
        panel.set_ylabel(name)
    return figure
