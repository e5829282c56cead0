"""The look of all figures, and the figures of the pages."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any

import matplotlib as mpl
import matplotlib.pyplot as plt
import numpy as np
import pandas as pd
from cycler import cycler
from IPython.display import HTML
from matplotlib.collections import PatchCollection
from matplotlib.colors import LinearSegmentedColormap, LogNorm
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Arc, Circle, Polygon
from matplotlib.ticker import MaxNLocator, MultipleLocator

from repro import Ring

WIDTH = 5.6
"""Width of a figure [in]: letters of 10.2 points are 9 px high where a phone shows it 358 px wide."""
BLUE, ORANGE, GREEN, PINK, YELLOW, SKY = "#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9"
"""Okabe and Ito: safe for colour-blind readers, and read on a light and on a dark ground."""
PUBLISHED, OURS, BEST = "#767676", BLUE, ORANGE
TRUTH = {"color": "#767676", "lw": 4.0, "alpha": 0.55, "solid_capstyle": "round"}
"""Look of the truth where an estimate lies on it: wide and pale."""

STYLE: Any = {
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


def use_style() -> None:
    """Draw all figures of a notebook in the book's style, whatever the reader's matplotlibrc says."""
    mpl.rcdefaults()
    mpl.rcParams.update(STYLE)


@contextmanager
def style() -> Iterator[None]:
    """Draw in the book's style, whatever the reader's matplotlibrc says; also a decorator."""
    with mpl.rc_context():
        use_style()
        yield


# Table 1 of Baaij et al.

COORDINATES = ("delta_x", "delta_y", "delta_L")
VERDICTS = {
    "reproduced": "within the scatter",
    "weak": "scatter so large that zero would pass",
    "better": "smaller",
    "differs": "differs",
}
TABLE_1 = """<style>
.table-1 { overflow-x: auto; margin: 0 0 0.4rem; --grey: #666d78; }
.table-1 :is(.better, .differs) { --grey: #4b515b; }
html[data-theme="dark"] .table-1 { --grey: #9ca4af; }
html[data-theme="dark"] .table-1 :is(.better, .differs) { --grey: #ced6dd; }
.table-1.table-1.table-1 table { border-collapse: collapse; width: 100%; margin: 0; font-size: 12px;
  line-height: 1.3; }
.table-1.table-1.table-1 table :is(th, td) { padding: 1px 4px; text-align: right; white-space: nowrap; border: 0;
  font-variant-numeric: tabular-nums; vertical-align: middle; color: var(--pst-color-text-base, inherit); }
.table-1.table-1.table-1 table thead th { font-weight: 600; border-bottom: 1px solid currentColor; }
.table-1.table-1.table-1 table tr > :first-child { text-align: left; position: sticky; left: 0; font-weight: 400;
  background: var(--pst-color-background, white); }
.table-1.table-1.table-1 table tr > .edge { border-left: 1px solid rgb(128 128 128 / 50%); }
.table-1.table-1.table-1 table small { display: block; font-size: inherit; color: var(--grey); }
.table-1.table-1.table-1 table tr.again :is(th, td, small) { color: var(--grey); }
.table-1 .reproduced { background: rgb(0 158 115 / 11%); }
.table-1 .weak { background: rgb(230 159 0 / 13%); }
.table-1 .better { background: rgb(86 180 233 / 30%); font-weight: 600; }
.table-1 .differs { background: rgb(213 94 0 / 28%); font-weight: 600; }
.table-1.table-1.table-1 table tr.again td { background: none; }
.table-1 span { padding: 0 0.2rem; }
</style>"""


def table_1(card: pd.DataFrame, labels: dict[str, str], repeated: Sequence[str]) -> HTML:
    """Return Table 1 as printed: in each cell the published number and below it ours, tinted by verdict."""
    columns = ["e_u", *(f"{name}_{segment}" for segment in (1, 2, 3) for name in COORDINATES)]
    signs = dict(zip(COORDINATES, ("Δx", "Δy", "δL"), strict=True))
    groups = "".join(f'<th colspan="3" scope="colgroup" class="edge">segment {k} [%]</th>' for k in (1, 2, 3))
    heads = [f'<th scope="col"{_edge(c)}>{signs.get(c[:-2], "e<sub>u</sub> [µT]")}</th>' for c in columns]
    lines = [f'<tr><th scope="row">robot</th><th scope="col">readings</th>{groups}</tr>']
    lines.append(f'<tr><th scope="row">mean ± std</th>{"".join(heads)}</tr></thead><tbody>')
    for name, label in labels.items():
        own = card[card["row"] == name].set_index("quantity")
        cells = [_cell(own.loc[c], c) if c in own.index else f"<td{_edge(c)}>–</td>" for c in columns]
        again = ' class="again"' if name in repeated else ""
        lines.append(f'<tr{again}><th scope="row">{label}</th>{"".join(cells)}</tr>')
    legend = " · ".join(f'<span class="{name}">{words}</span>' for name, words in VERDICTS.items())
    words = "Upper: published. Lower: regenerated. Pale rows repeat another row. Tint: "
    label = 'id="fig-table-1" aria-label="Table 1, published and regenerated"'
    box = f'<div class="table-1" tabindex="0" role="region" {label}>'
    table = f"<table><thead>{''.join(lines)}</tbody></table>"
    return HTML(f'{TABLE_1}{box}{table}</div><p class="table-1">{words}{legend}.</p>')


def table_1_in_words(card: pd.DataFrame, bias: pd.DataFrame, repeated: Sequence[str]) -> str:
    """Return how many numbers of Table 1 agree, and how large our errors are against the published ones."""
    own = card[~card["row"].isin(repeated) & card["verdict"].isin(VERDICTS)]
    count = {name: int((own["verdict"] == name).sum()) for name in ("reproduced", "better", "differs")}
    weak, total = int((own["weak"] == "true").sum()), bias.iloc[-1]
    numbers = "differs" if count["differs"] == 1 else "differ"
    whole = (
        f" Of the {total['cells']} relative errors (without six sensors) {total['below']} are smaller than published;"
        f" our errors are **{total['ratio']:.2f} times the published ones** in the geometric mean."
    )
    return (
        f"**{count['reproduced']} of {len(own)} distinct numbers lie within the scatter of the trainings**,"
        f" {count['better'] or 'none'} {'is' if count['better'] == 1 else 'are'} smaller and"
        f" {count['differs'] or 'none'} {numbers}. For {weak or 'none'} the scatter is so large that zero would pass."
        f"{whole if total['cells'] else ''}"
    )


def _edge(column: str) -> str:
    return ' class="edge"' if column.startswith("delta_x") else ""


def _cell(row: pd.Series, column: str) -> str:
    factor, places = (1e3, 0) if column == "e_u" else (1.0, 1)
    texts = []
    for name in ("published", "regenerated"):
        mean, std = (pd.to_numeric(row[key]) * factor for key in (name, f"{name}_std"))
        spread = "" if pd.isna(std) else f"±{std:.{places}f}"
        texts.append("–" if pd.isna(mean) else f"{mean:.{places}f}{spread}")
    kind = "weak" if row["weak"] == "true" and row["verdict"] in VERDICTS else row["verdict"]
    edge = " edge" if _edge(column) else ""
    title = VERDICTS.get(kind, kind)
    return f'<td class="{kind}{edge}" title="{title}"><small>{texts[0]}</small>{texts[1]}</td>'


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
        xscale="log", xlabel="mean error of the configuration [% of its range]", ylim=(-0.5, len(names) - 0.5)
    )
    panel.set_yticks(range(len(names)), names)
    figure.legend(loc="outside upper center", ncols=2, **BESIDE)
    return closed(figure)


@style()
def calibration(table: pd.DataFrame, labels: dict[str, str]) -> Figure:
    """Draw mean errors by row of Table 1: published, and of the nominal and of the calibrated multipole model."""
    figure, panel = plt.subplots(figsize=(WIDTH, 0.34 * len(table) + 1.1))
    y = np.arange(len(table))[::-1]
    panel.hlines(y, table["calibrated_percent"], table["uncalibrated_percent"], color="0.75", lw=1)
    looks = {
        "uncalibrated_percent": ("nominal", SKY, "s"),
        "calibrated_percent": ("calibrated", ORANGE, "D"),
        "published_percent": ("Table 1, published", PUBLISHED, "|"),
    }
    for column, (label, colour, marker) in looks.items():
        panel.plot(table[column], y, marker, color=colour, ms=11 if marker == "|" else 6, mew=2, label=label)
    panel.set_yticks(y, [labels[row] for row in table["row"]])
    panel.set(xscale="log", xlabel="mean error of the configuration [% of its range]")
    panel.xaxis.set_major_formatter("{x:g}")
    figure.legend(loc="outside upper center", ncols=3, **BESIDE)
    return closed(figure)


@style()
def tip_paths(paths: dict[int, tuple[np.ndarray, np.ndarray]]) -> Figure:
    """Draw true and estimated paths of tips ``[t, 3]`` [m] by number of segments, seen along the straight robot."""
    figure, panels = plt.subplots(1, len(paths), figsize=(WIDTH, 2.5), squeeze=False)
    for panel, (n, (truth, found)) in zip(panels[0], paths.items(), strict=True):
        panel.plot(*1e3 * truth[:, :2].T, label="truth", **TRUTH)
        panel.plot(*1e3 * found[:, :2].T, color=BLUE, lw=1.3, label="estimate")
        panel.set(title=f"{n} segment{'s' * (n > 1)}", xlabel="x [mm]", aspect="equal")
        panel.xaxis.set_major_locator(MaxNLocator(3))
        panel.yaxis.set_major_locator(MaxNLocator(4))
    panels[0, 0].set_ylabel("y [mm]")
    figure.legend(*panels[0, 0].get_legend_handles_labels(), loc="outside upper center", ncols=2, **BESIDE)
    return closed(figure)


# First steps, and sensors that fail: Figs 2(a), 4 and 5 of Baaij et al.

BODY = ("#1A1A1A", "#943DC7")
"""Segments from base to tip, black to violet as in the paper."""
FOUR = (BLUE, GREEN, PINK, ORANGE)
BESIDE = {"handlelength": 1.0, "handletextpad": 0.4, "columnspacing": 0.9, "labelspacing": 0.3}
XYZ = ["x_mm", "y_mm", "z_mm"]


def body_colours(n: int) -> list[Any]:
    """Return the colours of segments from base to tip."""
    return list(LinearSegmentedColormap.from_list("body", BODY)(np.linspace(0, 1, max(n, 2)))[:n])


@style()
def field_of_robot(field: pd.DataFrame, parts: pd.DataFrame, backbone: pd.DataFrame, ring: Ring) -> Figure:
    """Draw Fig. 4(a): the field of all magnets in the x-z plane around the robot."""
    grid = field.pivot(index="z_mm", columns="x_mm", values=["b_x_mT", "b_z_mT"])
    # Streamlines want even steps, which numbers from a file have only to their digits.
    x, z = (np.linspace(i[0], i[-1], len(i)) for i in (grid["b_x_mT"].columns, grid.index))
    b_x, b_z = grid["b_x_mT"].to_numpy(), grid["b_z_mT"].to_numpy()
    # A map of colours is not inverted in dark mode: its letters are read on both grounds.
    inks = ("text.color", "axes.labelcolor", "axes.edgecolor", "xtick.color", "ytick.color")
    mpl.rcParams.update(dict.fromkeys(inks, "#767676"))
    figure, panel = plt.subplots(figsize=(4.3, 5.4))
    panel.grid(visible=False)
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
    panel.set(xlabel="x [mm]", ylabel="z [mm]", aspect="equal", xlim=x[[0, -1]], ylim=z[[0, -1]])
    for axis in (panel.xaxis, panel.yaxis):
        axis.set_major_locator(MultipleLocator(50))
    bar = figure.colorbar(image, label="flux density in the plane [mT]", shrink=0.8, pad=0.02, extend="max")
    bar.ax.yaxis.set_major_formatter("{x:g}")
    return closed(figure)


def closed(figure: Figure) -> Figure:
    """Return a figure that a notebook shows once, as the result of its cell."""
    plt.close(figure)
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


@style()
def relations(parts: pd.DataFrame, backbone: pd.DataFrame, ring: Ring) -> Figure:
    """Draw Fig. 2(a) to scale: distance and angles between the first sensor and the magnet of its segment."""
    (p_m, o_m), (p_s, o_s) = ([x[0] for x in _in_plane(parts, part)] for part in ("magnet", "sensor"))
    p = p_s - p_m
    ahead, line = p / np.hypot(*p), backbone[["x_mm", "z_mm"]].to_numpy()
    figure, panel = plt.subplots(figsize=(5.2, 4.6))
    panel.grid(visible=False)
    tangent = np.gradient(line, axis=0)
    side = 22 * np.stack([tangent[:, 1], -tangent[:, 0]], 1) / np.linalg.norm(tangent, axis=1)[:, None]
    panel.add_patch(Polygon(np.concatenate([line + side, (line - side)[::-1]]), fc="#767676", alpha=0.13))
    panel.plot(*line.T, color="0.45", lw=1, ls=(0, (6, 3)))
    panel.add_collection(PatchCollection(_cut(p_m[None], o_m[None], ring), fc=GREEN, alpha=0.5))
    for start, vector, colour, name, share, aside in (
        (p_m, p, "0.2", "$p$", 0.55, 4.5),
        (p_m, 30 * o_m, GREEN, "$o_m$", 1.13, 0.0),
        (p_s, 26 * o_s, BLUE, "$o_s$", 0.85, 6.0),
    ):
        arrow = {"arrowstyle": "-|>", "color": colour, "lw": 2, "shrinkA": 0, "shrinkB": 0}
        panel.annotate("", start + vector, start, arrowprops=arrow)
        at = start + share * vector + aside * np.array([vector[1], -vector[0]]) / np.hypot(*vector)
        panel.text(*at, name, color=colour, ha="center", va="center", fontsize=14)
    for at, colour, name, offset in ((p_m, GREEN, "magnet", (-46, -4)), (p_s, BLUE, "sensor", (-16, -20))):
        panel.plot(*at, "o", color=colour, ms=8)
        panel.annotate(name, at, xytext=offset, textcoords="offset points", ha="center", color=colour)
    for direction, colour in ((o_m, GREEN), (ahead, "0.2")):
        panel.plot(*np.stack([p_s, p_s + 28 * direction], 1), ":", color=colour, lw=1.6)
    for at, first, second, radius, name in (
        (p_m, o_m, p, 17, r"$\theta$"),
        (p_s, o_s, o_m, 12, r"$\alpha$"),
        (p_s, o_s, p, 19, r"$\beta$"),
    ):
        start, end = (np.degrees(np.arctan2(v[1], v[0])) for v in (first, second))
        low, high = sorted((start, start + (end - start + 180) % 360 - 180))
        panel.add_patch(Arc(at, 2 * radius, 2 * radius, theta1=low, theta2=high, color="0.2", lw=1.3))
        middle = np.radians((low + high) / 2)
        where = at + (radius + 5) * np.array([np.cos(middle), np.sin(middle)])
        panel.text(*where, name, ha="center", va="center", fontsize=13)
    panel.plot([-22, 22], [0, 0], color="0.2", lw=4, solid_capstyle="butt")
    panel.set(xlabel="x [mm]", ylabel="z [mm]", aspect="equal", xlim=(-28, 98), ylim=(-6, 116))
    for axis in (panel.xaxis, panel.yaxis):
        axis.set_major_locator(MultipleLocator(20))
    return closed(figure)


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
    panel.set(xlabel="x [mm]", ylabel="z [mm]", aspect="equal", xlim=(-30, 90), ylim=(-8, 124))
    for axis in (panel.xaxis, panel.yaxis):
        axis.set_major_locator(MultipleLocator(20))
    return closed(figure)


@style()
def three_moves(table: pd.DataFrame) -> Figure:
    """Draw what the sensors of one segment read while it bends towards x, towards y, or becomes longer."""
    words = (r"bend $\Delta_x$ [mm]", r"bend $\Delta_y$ [mm]", r"longer by $\delta L$ [mm]")
    figure, panels = plt.subplots(1, 3, figsize=(WIDTH, 3.0), sharey=True)
    for panel, label, (_, part) in zip(panels, words, table.groupby("move", sort=False), strict=True):
        for k, sensor in enumerate(table.columns[2:]):
            look = {"color": FOUR[k % 4], "ls": ("-", "--", "-.", ":")[k % 4], "lw": 2.2}
            panel.plot(part["mm"], part[sensor], label=f"sensor {k + 1}", **look)
        panel.set_xlabel(label)
        panel.xaxis.set_major_locator(MultipleLocator(2 if np.ptp(part["mm"]) < 10 else 10))
    panels[0].set_ylabel("reading [mT]")
    figure.legend(*panels[0].get_legend_handles_labels(), loc="outside upper center", ncols=3)
    return closed(figure)


@style()
def readings_and_shape(u: pd.DataFrame, q: pd.DataFrame, failure_s: float) -> Figure:
    """Draw Fig. 4(b): readings above, configurations below; truth, and the mean over seeds with its deviation."""
    pairs = [(table, unit, s) for table, unit in ((u, "mT"), (q, "mm")) for s in u["segment"].unique()]
    names = {"delta_x": r"\Delta_{x,%d}", "delta_y": r"\Delta_{y,%d}", "delta_L": r"\delta L_{%d}"}
    figure, panels = plt.subplots(len(pairs), 1, figsize=(WIDTH, 0.92 * len(pairs) + 0.7), sharex=True)
    for panel, (table, unit, segment) in zip(panels, pairs, strict=True):
        own = table[table["segment"] == segment]
        for colour, (name, part) in zip(FOUR, own.groupby(table.columns[2], sort=False), strict=False):
            text = f"u_{{{name}}}" if unit == "mT" else names[str(name).rpartition("_")[0]] % segment
            t, truth = part["time_s"], part[f"true_{unit}"]
            mean, deviation = part[f"mean_{unit}"], part[f"std_{unit}"]
            works = part["working"] if unit == "mT" else truth.notna()
            panel.plot(t, truth.where(works), color=colour, lw=3.6, alpha=0.45, label=f"${text}$")
            panel.plot(t, truth.where(~works), color=colour, lw=3.6, alpha=0.15)
            panel.plot(t, mean, color=colour, lw=1.2, ls=(0, (4, 2)))
            panel.fill_between(t, mean - deviation, mean + deviation, color=colour, alpha=0.2, lw=0)
        panel.axvline(failure_s, color="0.4", lw=1.2, ls=":")
        panel.legend(loc="center left", bbox_to_anchor=(1.0, 0.5), **BESIDE)
        panel.margins(x=0.01)
        panel.yaxis.set_major_locator(MultipleLocator(0.5 if unit == "mT" else 10))
    panels[len(pairs) // 4].set_ylabel("reading [mT]")
    panels[-1 - len(pairs) // 4].set_ylabel("configuration [mm]")
    panels[-1].set_xlabel("time [s]")
    figure.align_ylabels(panels)
    ink = {"color": "0.4", "lw": 3.6}
    lines = [
        Line2D([], [], alpha=0.5, label="truth", **ink),
        Line2D([], [], color="0.4", lw=1.2, ls=(0, (4, 2)), label="estimate"),
        Line2D([], [], alpha=0.2, label="truth, sensor failed", **ink),
        Line2D([], [], color="0.4", lw=1.2, ls=":", label="failure"),
    ]
    figure.legend(handles=lines, loc="outside upper center", ncols=4, **BESIDE | {"handlelength": 1.6})
    return closed(figure)


@style()
def stills(shapes: pd.DataFrame, parts: pd.DataFrame) -> Figure:
    """Draw Fig. 5: shapes at several times, truth opaque and estimate pale, with magnets and sensors."""
    times = shapes["time_s"].unique()
    points = pd.concat([shapes, parts])[XYZ].to_numpy(float)
    middle, reach = (points.max(0) + points.min(0)) / 2, np.ptp(points, axis=0) / 2
    looks: dict[tuple[str, bool], dict[str, Any]] = {
        ("magnet", True): {"marker": "o", "color": GREEN, "ms": 6},
        ("sensor", True): {"marker": "s", "color": BLUE, "ms": 3.5},
        ("sensor", False): {"marker": "X", "color": ORANGE, "ms": 6.5, "mew": 0},
    }
    rows = -(-len(times) // 3)
    tall = 2.3 * rows + 0.3
    figure = plt.figure(figsize=(WIDTH, tall), layout="none")  # pictures in 3-D waste their margins
    for k, time_s in enumerate(times):
        place = (k % 3 / 3 - 0.06, (rows - 1 - k // 3) * 2.3 / tall - 0.04, 0.45, 2.3 / tall + 0.08)
        panel: Any = figure.add_axes(place, projection="3d")
        for estimated, alpha in ((True, 0.3), (False, 1.0)):
            own = [
                table[(table["time_s"] == time_s) & (table["estimated"] == estimated)]
                for table in (shapes, parts)
            ]
            for colour, (_, part) in zip(body_colours(3), own[0].groupby("segment"), strict=False):
                panel.plot(*part[XYZ].to_numpy().T, color=colour, lw=3.5, alpha=alpha)
            for (kind, works), look in looks.items():
                some = own[1][(own[1]["part"] == kind) & (own[1]["working"] == works)]
                panel.plot(*some[XYZ].to_numpy().T, ls="", alpha=alpha, **look)
        for name, centre, half in zip("xyz", middle, reach, strict=True):
            getattr(panel, f"set_{name}lim")(centre - half, centre + half)
            getattr(panel, f"{name}axis").set_major_locator(MultipleLocator(100))
            getattr(panel, f"set_{name}ticklabels")([])
        panel.patch.set_visible(False)
        panel.set_box_aspect(tuple(reach), zoom=0.98)
        panel.view_init(elev=15, azim=-60)
        panel.text2D(0.2, 0.88, f"{time_s:.0f} s", transform=panel.transAxes)
    lines = [
        Line2D([], [], color="0.3", lw=3.5, alpha=a, label=s) for a, s in ((1, "truth"), (0.3, "estimate"))
    ]
    words = ("magnet", "sensor", "failed sensor")
    lines += [Line2D([], [], ls="", label=w, **look) for w, look in zip(words, looks.values(), strict=True)]
    figure.legend(handles=lines, loc="upper center", ncols=5, **BESIDE)
    return closed(figure)


# Affine curvature: Figs 6 and 7 of Baaij et al.

AFFINE_NAMES = {
    "kappa_0": r"$\kappa_0$ [rad]",
    "kappa_1": r"$\kappa_1$ [rad]",
    "phi": r"$\phi$ [rad]",
    "delta_L": r"$\delta L$ [mm]",
}


@style()
def affine_over_time(series: pd.DataFrame) -> Figure:
    """Draw Fig. 6: readings above, configuration below; truth, and the mean over seeds with its deviation."""
    ratios = [2.3, 1, 1, 1, 1]
    figure, panels = plt.subplots(
        5, 1, figsize=(WIDTH, 6.3), sharex=True, gridspec_kw={"height_ratios": ratios}
    )
    readings = series[series["kind"] == "reading"]
    for number, (_, part) in enumerate(readings.groupby("name", sort=False)):
        _over_time(panels[0], part, FOUR[number % 3])
    for panel, (name, words) in zip(panels[1:], AFFINE_NAMES.items(), strict=True):
        _over_time(panel, series[series["name"] == name], BLUE)
        panel.set_ylabel(words)
    for panel, every in zip(panels, (1, 0.5, 2, 3, 3), strict=True):
        panel.yaxis.set_major_locator(MultipleLocator(every))
    panels[0].set_ylabel("readings [mT]")
    panels[-1].set_xlabel("time [s]")
    panels[-1].margins(x=0.01)
    figure.align_ylabels(panels)
    planes = [
        Line2D([], [], color=colour, lw=2.4, label=f"at {at} mm")
        for colour, at in zip(FOUR, (0, 100, 200), strict=False)
    ]
    looks = [
        Line2D([], [], color="0.4", lw=3.6, alpha=0.45, label="truth"),
        Line2D([], [], color="0.4", lw=1.2, ls=(0, (4, 2)), label="estimate"),
    ]
    figure.legend(handles=[*planes, *looks], loc="outside upper center", ncols=5, **BESIDE)
    return closed(figure)


def _over_time(panel: Any, part: pd.DataFrame, colour: str) -> None:
    t, mean, deviation = part["time_s"], part["mean"], part["std"]
    panel.plot(t, part["truth"], color=colour, lw=3.6, alpha=0.45)
    panel.plot(t, mean, color=colour, lw=1.2, ls=(0, (4, 2)))
    panel.fill_between(t, mean - deviation, mean + deviation, color=colour, alpha=0.2, lw=0)


@style()
def affine_stills(shapes: pd.DataFrame, parts: pd.DataFrame) -> Figure:
    """Draw Fig. 7: the true shape opaque, the estimates of all seeds pale, with magnets and sensors."""
    times = shapes["time_s"].unique()
    rows = -(-len(times) // 3)
    figure = plt.figure(figsize=(WIDTH, 1.95 * rows + 0.4))
    looks = {
        "magnet": {"marker": "o", "color": GREEN, "ms": 7},
        "sensor": {"marker": "s", "color": BLUE, "ms": 3.5},
    }
    estimate = {"color": ORANGE, "lw": 7, "alpha": 0.3}
    for k, time_s in enumerate(times):
        panel: Any = figure.add_subplot(rows, 3, k + 1, projection="3d", computed_zorder=False)
        own = shapes[shapes["time_s"] == time_s]
        for seed, part in own.sort_values("seed", ascending=False, kind="stable").groupby("seed", sort=False):
            look = {"color": BODY[0], "lw": 2} if seed == -1 else estimate
            panel.plot(*part[XYZ].to_numpy().T, **look)
        for kind, look in looks.items():
            some = parts[(parts["time_s"] == time_s) & (parts["part"] == kind)]
            panel.plot(*some[XYZ].to_numpy().T, ls="", **look)
        panel.set(xlim=(-125, 125), ylim=(-125, 125), zlim=(0, 210))
        for name in "xyz":
            getattr(panel, f"{name}axis").set_major_locator(MultipleLocator(100))
            getattr(panel, f"set_{name}ticklabels")([])
        panel.patch.set_visible(False)
        panel.set_box_aspect((250, 250, 210), zoom=1.75)
        panel.view_init(elev=18, azim=-55)
        panel.set_title(f"{time_s:.1f} s", loc="left", y=1.02)
    lines = [
        Line2D([], [], color=BODY[0], lw=2, label="truth"),
        Line2D([], [], label="estimates", **estimate),
        *(Line2D([], [], ls="", label=kind, **look) for kind, look in looks.items()),
    ]
    figure.legend(handles=lines, loc="outside upper center", ncols=4, **BESIDE)
    return closed(figure)


# The rig: Figs 8 to 11 of Baaij et al.

GREY_INK = dict.fromkeys(
    ("text.color", "axes.labelcolor", "axes.edgecolor", "xtick.color", "ytick.color"), "#767676"
)
"""Letters of a figure that is not inverted in dark mode: they are read on both grounds."""


RIG_COLUMNS = {"e_u": ("readings", "mV"), "delta_x": ("Δx", "mm"), "delta_y": ("Δy", "mm")}


def table_2(printed: pd.DataFrame, errors: pd.DataFrame, moved: pd.DataFrame, badge: str) -> HTML:
    """Return Table 2 as printed: published numbers, below them ours; ~ where rounding decides."""
    key = ["row", "quantity", "unit"]
    ours = errors[errors["elongation"] == "known"].groupby(key)["error"].agg(["mean", "std"])
    chaotic = set(moved[moved["chaotic"] & (moved["step"] == "published")].set_index(key[:2]).index)
    columns = [(name, part) for name, (_, unit) in RIG_COLUMNS.items() for part in (unit, "%")]
    heads = [f'<th scope="col">{RIG_COLUMNS[name][0]}<br>[{unit}]</th>' for name, unit in columns]
    lines = [f'<tr><th scope="row">mean ± std</th>{"".join(heads)}</tr></thead><tbody>']
    for row, own in printed.groupby("row", sort=False):
        cells, known = [], own.set_index(["quantity", "unit"])
        for name, unit in columns:
            if (name, unit) not in known.index:
                cells.append("<td>–</td>")
                continue
            above, below = known.loc[(name, unit)], ours.loc[(row, name, unit)]
            n = len(above["printed"].partition(".")[2])
            spread = f" ± {below['std']:.{n}f}" if np.isfinite(below["std"]) else ""
            mark = "~ " if (row, name) in chaotic else ""
            text = f"{above['printed']} ± {above['printed_std']}</small>{mark}{below['mean']:.{n}f}{spread}"
            cells.append(f"<td><small>{text}</td>")
        lines.append(f'<tr><th scope="row">{str(row).replace("->", " → ")}</th>{"".join(cells)}</tr>')
    box = '<div class="table-1" tabindex="0" role="region" aria-label="Table 2, published and regenerated">'
    words = "Upper: published. Lower: regenerated. ~ : rounding decides the error of at least one network, see below."
    mark = f'<span style="border: 1px solid; border-radius: 1em; padding: 0.1em 0.7em">{badge}</span>'
    return HTML(
        f"{TABLE_1}<p>{mark}</p>{box}<table><thead>{''.join(lines)}</tbody></table></div><p>{words}</p>"
    )


@style()
def rig_to_scale(robot: Any, markers_at: float) -> Figure:
    """Draw Fig. 8 as a section and from above, to scale [mm]: body, chambers, ring, sensors and markers."""
    figure, (side, top) = plt.subplots(1, 2, figsize=(WIDTH, 4.0), width_ratios=(1.15, 1))
    segment, magnet = robot.segments[0], robot.magnets[0]
    length, radius, at = 1e3 * segment.length, 1e3 * segment.radius, 1e3 * magnet.place.at
    inner, outer = 500 * magnet.shape.inner_diameter, 500 * magnet.shape.outer_diameter
    look = {"fc": "#76767622", "ec": "#767676"}
    side.add_patch(Polygon([(-radius, 0), (radius, 0), (radius, length), (-radius, length)], **look))
    for half in _cut(np.array([[0.0, at]]), np.array([[0.0, 1.0]]), magnet.shape):
        half.set(fc=GREEN, ec="none")
        side.add_patch(half)
    places = 1e3 * np.array([sensor.place.position for sensor in robot.sensors])
    side.plot(places[:, 0], 0 * places[:, 0] + length, "s", color=BLUE, ms=6, clip_on=False)
    side.plot([-radius - 4, radius + 4], [1e3 * markers_at] * 2, color=ORANGE, lw=2.5)
    side.plot([-radius - 4, radius + 4], [0, 0], color="#767676", lw=4)
    for z, words in (
        (0, "base"),
        (at, "ring magnet"),
        (1e3 * markers_at - 5, "markers"),
        (length + 2, "sensors"),
    ):
        side.annotate(words, (radius + 7, z), va="center", annotation_clip=False)
    side.set(
        xlim=(-radius - 6, radius + 6),
        ylim=(-4, length + 8),
        aspect="equal",
        xlabel="x [mm]",
        ylabel="z [mm]",
    )
    round_ = [(radius, look), (outer, {"fc": GREEN, "ec": "none"}), (inner, {"fc": "white", "ec": "none"})]
    for size, own in round_:
        top.add_patch(Circle((0, 0), size, **own))
    for azimuth in np.radians([180, 300, 60]):
        top.add_patch(
            Circle(
                13 * np.array([np.cos(azimuth), np.sin(azimuth)]),
                150**0.5 / np.pi**0.5,
                fc="none",
                ec="#767676",
                ls="--",
            )
        )
    top.plot(*places[:, :2].T, "s", color=BLUE, ms=7)
    top.set(
        xlim=(-radius - 2, radius + 2),
        ylim=(-radius - 2, radius + 2),
        aspect="equal",
        xlabel="x [mm]",
        ylabel="y [mm]",
    )
    top.set_title("from the tip")
    side.set_title("cut along x")
    for panel in (side, top):
        panel.grid(visible=False)
        panel.xaxis.set_major_locator(MultipleLocator(20))
        panel.yaxis.set_major_locator(MultipleLocator(20))
    return closed(figure)


def _in_space(panel: Any) -> None:
    """Set the axes of a panel to the whole segment [mm]."""
    panel.set(xlim=(-30, 30), ylim=(-30, 30), zlim=(0, 116))
    for name in "xyz":
        getattr(panel, f"{name}axis").set_major_locator(MultipleLocator(50 if name == "z" else 25))
        getattr(panel, f"set_{name}ticklabels")([])
    panel.patch.set_visible(False)
    panel.set_box_aspect((60, 60, 116), zoom=1.35)
    panel.view_init(elev=20, azim=-55)


@style()
def trajectories(paths: pd.DataFrame, shapes: dict[str, np.ndarray]) -> Figure:
    """Draw Fig. 9: shapes of the segment [m] pale, the path of its tip dark, a panel for each trajectory."""
    figure = plt.figure(figsize=(WIDTH, 6.8))
    for k, (name, curves) in enumerate(shapes.items()):
        panel: Any = figure.add_subplot(2, 3, k + 1, projection="3d", computed_zorder=False)
        for curve in 1e3 * curves:
            panel.plot(*curve.T, color=SKY, lw=1.2, alpha=0.8)
        tip = paths[paths["recording"] == name][["tip_x_mm", "tip_y_mm", "tip_z_mm"]]
        panel.plot(*tip.to_numpy().T, color=BLUE, lw=1.2)
        _in_space(panel)
        panel.set_title(name, y=1.08)
    lines = [Line2D([], [], color=SKY, label="shape"), Line2D([], [], color=BLUE, label="path of the tip")]
    figure.legend(handles=lines, loc="outside upper center", ncols=2, **BESIDE)
    return closed(figure)


@style()
def landscape_and_estimates(
    grid: pd.DataFrame,
    path: np.ndarray,
    truth: np.ndarray,
    series: dict[str, np.ndarray],
    zoom_s: tuple[float, float],
) -> Figure:
    """Draw Fig. 10: the loss [mV] with the path of a descent [mm]; below, the bend over time, and a part of T5.

    A series holds time, truth and the estimates of all seeds ``[t, 2, 1 + seeds]`` [mm] of a trajectory.
    """
    mpl.rcParams.update(GREY_INK)
    figure, panels = plt.subplots(4, 1, figsize=(WIDTH, 10.2), height_ratios=(3.4, 1.6, 1.6, 1.6))
    table = grid.pivot(index="delta_y_mm", columns="delta_x_mm", values="rmse_mV")
    mesh = panels[0].pcolormesh(table.columns, table.index, table, cmap="viridis", rasterized=True)
    figure.colorbar(mesh, label="error of the readings [mV]")
    panels[0].plot(*path.T, "o-", color=ORANGE, ms=3, label="descent")
    for point, marker, words in ((path[0], "s", "start"), (truth, "*", "truth")):
        panels[0].plot(*point, marker, color="white", mec="black", ms=10, ls="", label=words)
    panels[0].legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=3, **BESIDE)
    panels[0].set(xlabel=r"$\Delta_x$ [mm]", ylabel=r"$\Delta_y$ [mm]")
    panels[0].grid(visible=False)
    titles = [*series, f"{list(series)[-1]}, a part of it"]
    for panel, name, title in zip(panels[1:], [*series, list(series)[-1]], titles, strict=True):
        values = series[name]
        t = np.arange(len(values)) / 40
        for k, colour in enumerate((BLUE, ORANGE)):
            found = values[:, k, 1:]
            mean, deviation = found.mean(1), found.std(1, ddof=1) if found.shape[1] > 1 else 0 * t
            panel.plot(t, values[:, k, 0], color=colour, lw=3.0, alpha=0.45)
            panel.plot(t, mean, color=colour, lw=1.2, ls=(0, (4, 2)))
            panel.fill_between(t, mean - deviation, mean + deviation, color=colour, alpha=0.25, lw=0)
        panel.set_title(title)
        panel.set_ylabel("bend [mm]")
        panel.margins(x=0)
    panels[-1].set(xlim=zoom_s, xlabel="time [s]")
    lines = [
        Line2D([], [], color=c, lw=3, alpha=0.45, label=rf"$\Delta_{a}$, truth")
        for a, c in zip("xy", (BLUE, ORANGE), strict=True)
    ]
    lines += [
        Line2D([], [], color=c, lw=1.2, ls=(0, (4, 2)), label=rf"$\Delta_{a}$, estimate")
        for a, c in zip("xy", (BLUE, ORANGE), strict=True)
    ]
    panels[1].legend(handles=lines, loc="lower center", bbox_to_anchor=(0.5, 1.15), ncols=4, **BESIDE)
    return closed(figure)


@style()
def rig_stills(robot: Any, times: np.ndarray, truth: np.ndarray, found: np.ndarray) -> Figure:
    """Draw Fig. 11, lower row: the true segment opaque, the estimates ``[time, seed, 3]`` [m] pale."""
    figure = plt.figure(figsize=(WIDTH, 6.8))
    at = [robot.magnets[0].place, *(sensor.place for sensor in robot.sensors)]
    for k, time_s in enumerate(times):
        panel: Any = figure.add_subplot(2, 3, k + 1, projection="3d", computed_zorder=False)
        for q in found[k]:
            panel.plot(*(1e3 * robot.backbone(q)).T, color=ORANGE, lw=3, alpha=0.45)
        panel.plot(*(1e3 * robot.backbone(truth[k])).T, color="#1A1A1A", lw=3)
        p = 1e3 * robot.poses(truth[k], at)[:, :3, 3]
        panel.plot(*p[:1].T, "o", color=GREEN, ms=7)
        panel.plot(*p[1:].T, "s", color=BLUE, ms=4)
        _in_space(panel)
        panel.set_title(f"{time_s:.1f} s", y=1.08)
    lines = [
        Line2D([], [], color="#1A1A1A", lw=3, label="truth"),
        Line2D([], [], color=ORANGE, lw=3, alpha=0.45, label="estimates"),
        Line2D([], [], color=GREEN, marker="o", ls="", label="magnet"),
        Line2D([], [], color=BLUE, marker="s", ls="", label="sensor"),
    ]
    figure.legend(handles=lines, loc="outside upper center", ncols=4, **BESIDE)
    return closed(figure)


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
        for method, look in looks.items():
            line = own[own["method"] == method]
            angle.plot(line["time_s"], line["bend_deg"], **look)
            direction.plot(line["time_s"], line["direction_deg"], **look)
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
    lines = [Line2D([], [], label=method, **look) for method, look in looks.items()]
    figure.align_ylabels(panels)
    figure.legend(handles=lines, loc="outside upper center", ncols=2, **BESIDE)
    return closed(figure)


@style()
def bend_errors(errors: pd.DataFrame) -> Figure:
    """Draw the error of every take by the size of the bend, and the median of every method."""
    columns = {
        "rmse_below_20_deg": "below 20°",
        "rmse_20_to_40_deg": "20° to 40°",
        "rmse_above_40_deg": "above 40°",
    }
    figure, panel = plt.subplots(figsize=(WIDTH, 4.2))
    colours = (PINK, ORANGE, YELLOW, SKY, "#767676", BLUE, GREEN)
    for k, (name, own) in enumerate(errors.groupby("name", sort=False)):
        colour, marker = colours[k], "osDvPX^"[k]
        for j, column in enumerate(columns):
            x = j + 0.12 * (k - 3)
            panel.plot(np.full(len(own), x), own[column], marker, color=colour, ms=4, alpha=0.6, mew=0)
            panel.plot(x, own[column].median(), "_", color=colour, ms=11, mew=2.5)
        panel.plot([], [], marker, color=colour, ms=6, mew=0, label=name)
    panel.set(xlabel="bend by motion capture", ylabel="RMSE of the bend [°]", ylim=(0, None))
    panel.set_xticks(range(3), list(columns.values()))
    panel.grid(visible=False, axis="x")
    figure.legend(loc="outside upper center", ncols=2, **BESIDE)
    return closed(figure)


@style()
def light_bulb(curves: pd.DataFrame, events: pd.DataFrame, threshold: float) -> Figure:
    """Draw Fig. 8: bend by the paper's filter, and the ratio of the fields with its events, a column for a file."""
    files = list(curves["file"].unique())
    figure, panels = plt.subplots(
        2, len(files), figsize=(WIDTH, 4.0), sharex="col", sharey="row", squeeze=False
    )
    for (above, below), file in zip(panels.T, files, strict=True):
        own, found = curves[curves["file"] == file], events[events["file"] == file]
        above.plot(own["time_s"], own["bend_deg"], color=ORANGE, lw=1)
        below.plot(own["time_s"], own["ratio"], color=BLUE, lw=1)
        below.plot(own["time_s"], own["baseline"] + threshold, color="#767676", lw=1, ls="--")
        for start, end in found[["start_s", "end_s"]].to_numpy():
            above.axvspan(start, end, color=YELLOW, alpha=0.25, lw=0)
            below.axvspan(start, end, color=YELLOW, alpha=0.25, lw=0)
        above.set(title=file.replace("light_", "file "), ylim=(0, 95), yticks=(0, 30, 60, 90))
        below.set_xlabel("time [s]")
        below.xaxis.set_major_locator(MultipleLocator(10 if len(files) < 3 else 20))
    panels[0, 0].set_ylabel("bend [°]")
    panels[1, 0].set_ylabel("across over along")
    lines = [
        Line2D([], [], color=ORANGE, label="paper's filter"),
        Line2D([], [], color=BLUE, label="ratio of the fields"),
        Line2D([], [], color="#767676", ls="--", label="threshold"),
        Line2D([], [], color=YELLOW, lw=6, alpha=0.4, label="event"),
    ]
    figure.legend(handles=lines, loc="outside upper center", ncols=4, **BESIDE)
    return closed(figure)


# The particle filter: Figs 3 to 5 of Mitchell et al.

CURVE_LOOKS = {"spiral": (BLUE, "o"), "flower": (ORANGE, "s"), "seagull": (GREEN, "D")}


@style()
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
        panel.grid(visible=False)
        for radius in (30, 60, 90):
            panel.add_patch(Circle((0, 0), radius, fill=False, lw=1.2 if radius == 90 else 0.5, color="0.6"))
        panel.set(aspect="equal", xlim=(-95, 95), ylim=(-95, 95), xticks=(-90, 0, 90), yticks=(-90, 0, 90))
    figure.supxlabel(r"$\varphi\,\cos\theta$ [deg]")
    figure.supylabel(r"$\varphi\,\sin\theta$ [deg]")
    return closed(figure)


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
    figure.legend(*panels[0].get_legend_handles_labels(), loc="outside upper center", ncols=2, **BESIDE)
    return closed(figure)


@style()
def bend_error_over_time(table: pd.DataFrame, printed: dict[str, float]) -> Figure:
    """Draw Fig. 5: the error of the magnet's place [mm] over the parameter of a curve, by number of particles."""
    figure, panels = plt.subplots(len(printed), 1, figsize=(WIDTH, 4.6), sharex=True, sharey=True)
    for panel, (name, rmse) in zip(panels, printed.items(), strict=True):
        runs = table[table["curve"] == name].groupby("particles")
        for colour, (n, part) in zip((SKY, BLUE), runs, strict=False):
            panel.plot(part["t"], part["error_mm"], lw=1, color=colour, label=f"{n} particles")
        panel.axhline(rmse, color=PUBLISHED, ls="--", label="published RMSE, 1000 particles")
        panel.set(title=name.capitalize(), ylabel="error [mm]", ylim=(0, None))
        panel.margins(x=0)
    panels[-1].set_xlabel("parameter $t$ of the curve")
    figure.legend(*panels[0].get_legend_handles_labels(), loc="outside upper center", ncols=3, **BESIDE)
    return closed(figure)


@style()
def bend_error_by_noise(
    clean: pd.DataFrame, law: pd.Series, noisy: pd.DataFrame, single: float, printed: Sequence[float]
) -> Figure:
    """Draw the error [mm] over process noise: without sensor noise beside the law, and with it for two motions."""
    figure, (top, bottom) = plt.subplots(2, 1, figsize=(WIDTH, 6.4), sharex=True, height_ratios=(1.3, 1))
    for name, part in clean.groupby("curve", sort=False):
        colour, marker = CURVE_LOOKS[str(name)]
        x, label = part["process_noise_pi"], str(name).capitalize()
        top.plot(x, part["rmse_mm"], marker, color=colour, ms=6, label=label)
    top.plot(law.index, law, color="0.5", lw=1, label="law")
    top.axhspan(min(printed) - 5e-5, max(printed) + 5e-5, color=PUBLISHED, alpha=0.5, lw=0, label="published")
    top.axvline(0.02, color="0.5", lw=1, ls=":", label="noise in the paper")
    top.set(yscale="log", title="perfect sensor")
    for name, part in noisy.groupby("setting", sort=False):
        look = {"random walk": (SKY, "v"), "constant velocity": (ORANGE, "^")}[str(name)]
        own = part.groupby("process_noise_pi")["rmse_mm"].mean()
        bottom.plot(own.index, own, color=look[0], marker=look[1], ms=6, label=name)
    bottom.axhline(single, color="0.5", ls="--", label="least squares, one reading")
    bottom.set(xscale="log", yscale="log", ylim=(0.035, 0.13), title="real sensor, mean of the curves")
    bottom.set(
        xlabel="process noise [π rad per step]", xticks=[5e-4, 0.002, 0.005, 0.02], yticks=[0.04, 0.06, 0.1]
    )
    for axis in (bottom.xaxis, bottom.yaxis, top.yaxis):
        axis.set_major_formatter("{x:g}")
        axis.set_minor_formatter("")
    for panel in (top, bottom):
        panel.set_ylabel("RMSE [mm]")
        panel.legend(loc="center left", bbox_to_anchor=(1.0, 0.5), **BESIDE)
    return closed(figure)


# Motion sensors: Table II and Figs 3 to 6 of Martin et al.

MARKER_LOOKS = {"M1": (BLUE, 360.0), "M2": (PINK, 600.0)}
"""Colours of the paper, and distances along the arm [mm]."""


def table_ii(printed: pd.DataFrame, errors: pd.DataFrame, badge: str) -> HTML:
    """Return Table II as printed: published relative errors [%], below them ours."""
    known, names = printed.set_index(["row", "quantity"])["printed"], {"median": "median_mm", "q3": "q75_mm"}
    models, lines = (
        {"rigid-body": "rigid-body, 8 IMUs", "PCC-extended": "PCC-extended, 8 IMUs, 16 segments"},
        [],
    )
    for marker, (_, at) in MARKER_LOOKS.items():
        for quantity, column in names.items():
            cells = []
            for model, case in models.items():
                own = errors[(errors["case"] == case) & (errors["marker"] == marker)]
                ours = own.groupby("draw")[column].mean() * 100 / at
                spread = f" ± {ours.std():.1f}" if len(ours) > 1 else ""
                text = f"{ours.mean():.1f}{spread}" if len(ours) else "–"
                cells.append(f"<td><small>{known[f'{marker} {model}', quantity]}</small>{text}</td>")
            head = f"{marker} ({at:.0f} mm), {'median' if quantity == 'median' else 'Q3'}"
            lines.append(f'<tr><th scope="row">{head}</th>{"".join(cells)}</tr>')
    heads = "".join(f'<th scope="col">{model} [%]</th>' for model in models)
    mark = f'<span style="border: 1px solid; border-radius: 1em; padding: 0.1em 0.7em">{badge}</span>'
    box = '<div class="table-1" id="fig-table-ii" tabindex="0" role="region" aria-label="Table II">'
    head = f'<thead><tr><th scope="row">marker</th>{heads}</tr></thead>'
    body = f"<table>{head}<tbody>{''.join(lines)}</tbody></table>"
    words = "Upper: published, hardware. Lower: synthetic trials, mean ± standard deviation over draws of the sensors."
    return HTML(f'{TABLE_1}<p>{mark}</p>{box}{body}</div><p class="table-1">{words}</p>')


@style()
def marker_boxes(boxes: pd.DataFrame, printed: dict[str, pd.DataFrame]) -> Figure:
    """Draw Figs 3 to 5: boxes of the markers' errors [mm] with published medians and third quartiles."""
    groups = {"Fig. 3": ("n_imus", "IMUs"), "Fig. 4": ("segments", "segments"), "Fig. 5": ("n_imus", "IMUs")}
    figure, panels = plt.subplots(1, 3, figsize=(WIDTH, 3.6), sharey=True, width_ratios=(3, 4, 3))
    for panel, (name, (column, label)) in zip(panels, groups.items(), strict=True):
        own, known = boxes[boxes["figure"] == name], printed[name]
        steps = sorted(own[column].unique())
        for shift, (marker, (colour, at)) in zip((-0.2, 0.2), MARKER_LOOKS.items(), strict=True):
            for case in own[own["marker"] == marker].to_dict("records"):
                x, keys = steps.index(case[column]) + shift, ("whislo", "q1", "med", "q3", "whishi")
                values = [case[f"{q}_mm"] for q in ("q05", "q25", "median", "q75", "q95")]
                box = {"facecolor": colour, "alpha": 0.35, "edgecolor": colour}
                panel.bxp([dict(zip(keys, values, strict=True))], positions=[x], widths=0.34, showfliers=False,
                          patch_artist=True, manage_ticks=False, boxprops=box, medianprops={"color": colour, "lw": 2},
                          whiskerprops={"color": colour}, capprops={"color": colour})  # fmt: skip
                ending = {"n_imus": "IMUs", "segments": "segments( and more)?"}[column]
                number = min(case[column], 16)  # "16 segments and more"
                rows = known[known["row"].str.fullmatch(rf"{marker} .*\b{number} {ending}")]
                for row in rows.itertuples():
                    value = row.value * (at / 100 if row.unit == "%" else 1)
                    panel.plot(
                        x, value, "D" if row.quantity == "median" else "^", color="#1A1A1A", mec="white", ms=6
                    )
        panel.set(title=name, xlabel=label, ylim=(0, None))
        panel.set_xticks(range(len(steps)), [str(k) for k in steps])
        panel.grid(visible=False, axis="x")
    panels[0].set_ylabel("error [mm]")
    lines = [
        Line2D([], [], color=colour, lw=6, alpha=0.4, label=m) for m, (colour, _) in MARKER_LOOKS.items()
    ]
    for shape, words in (("D", "published median"), ("^", "published Q3")):
        lines.append(Line2D([], [], color="#1A1A1A", marker=shape, mec="white", ls="", label=words))
    figure.legend(handles=lines, loc="outside upper center", ncols=4, **BESIDE)
    return closed(figure)


@style()
def error_hull(hull: pd.DataFrame) -> Figure:
    """Draw Fig. 6: the arm in one pose of each mode, leaning to one side, in a hull with the error as radius."""
    modes = hull.groupby("mode", sort=False)
    figure, panels = plt.subplots(1, len(modes), figsize=(WIDTH, 2.2), sharex=True, sharey=True)
    for panel, (mode, part) in zip(np.atleast_1d(panels), modes, strict=True):
        away = part[["x_mm", "y_mm"]].iloc[-1].to_numpy()
        away = away / np.linalg.norm(away)
        for prefix, look in (("", {"color": "#1A1A1A", "lw": 2}), ("estimate_", {"color": ORANGE})):
            x = part[[f"{prefix}x_mm", f"{prefix}y_mm"]].to_numpy() @ away
            line = np.vstack([[0, 0], np.stack([x, part[f"{prefix}z_mm"]], axis=-1)])
            panel.plot(*line.T, **look)
            if not prefix:
                discs = [Circle(p, r) for p, r in zip(line[1:], part["radius_mm"], strict=True)]
                panel.add_collection(PatchCollection(discs, color=SKY, alpha=0.25, lw=0))
        panel.set(title=mode, aspect="equal", xlabel="aside [mm]")
    np.atleast_1d(panels)[0].set_ylabel("height [mm]")
    lines = [Line2D([], [], color="#1A1A1A", label="arm"), Line2D([], [], color=ORANGE, label="estimate")]
    lines.append(Line2D([], [], color=SKY, lw=6, alpha=0.5, label="within Q3 of the error"))
    figure.legend(handles=lines, loc="outside upper center", ncols=3, **BESIDE)
    return closed(figure)


@style()
def links_of_models(chains: dict[str, np.ndarray], arm: np.ndarray, links: int) -> Figure:
    """Draw joints of models ``[points, 3]`` [m] beside the arm, from the side, with the gap after each link."""
    figure, panels = plt.subplots(1, len(chains), figsize=(WIDTH, 3.8), sharex=True, sharey=True)
    away = arm[-1, :2] / np.linalg.norm(arm[-1, :2])
    side, colours = 1e3 * np.stack([arm[:, :2] @ away, arm[:, 2]], axis=-1), (ORANGE, BLUE)
    for panel, (name, joints), colour in zip(panels, chains.items(), colours, strict=True):
        line = np.vstack([[0, 0], 1e3 * np.stack([joints[:, :2] @ away, joints[:, 2]], axis=-1)])
        panel.plot(*side.T, color="#1A1A1A", lw=2, label="arm")
        panel.plot(*line.T, "o-", color=colour, ms=3.5, lw=2)
        ends = [x[:: (len(x) - 1) // links] for x in (line, side)]
        panel.plot(*np.stack(ends, axis=1)[1:].T, color="0.45", ls=":")
        panel.plot([], [], color="0.45", ls=":", label="from the end of a link to its place on the arm")
        panel.set(title=name, xlabel="aside [mm]", aspect="equal")
    panels[0].set_ylabel("height [mm]")
    figure.legend(*panels[0].get_legend_handles_labels(), loc="outside upper center", ncols=2, **BESIDE)
    return closed(figure)
