"""Figures of the errors of an arm's shape from IMUs: boxes, along the arm, hull, calibration."""

from __future__ import annotations

from collections.abc import Sequence

import matplotlib.pyplot as plt
import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from mpl_toolkits.mplot3d.axes3d import Axes3D

from edition1_live.view.style import WIDTH_IN, label_in_mm, page_figure

MARKER_COLOURS = {"M1": "#0072B2", "M2": "#CC79A7"}
"""As in the paper: M1 blue, M2 pink."""
MARKER_ARCS_MM = {"M1": 360.0, "M2": 600.0}
LINES = {
    "rigid-body, 8 IMUs": ("#D55E00", "rigid-body, 8 IMUs"),
    "IMUs at mid-section": ("#E69F00", "rigid-body, IMUs at mid-section"),
    "PCC-extended, 8 IMUs, 16 segments": ("#0072B2", "PCC-extended, 8 IMUs"),
}
QUANTITIES = {"median": ("D", "paper, median"), "q3": ("^", "paper, Q3")}
BOX = {"whislo": "q05_mm", "q1": "q25_mm", "med": "median_mm", "q3": "q75_mm", "whishi": "q95_mm"}
PANELS = {
    "Fig. 3": ("rigid-body:\nIMUs", "n_imus"),
    "Fig. 4": ("PCC-extended, 8 IMUs:\nsegments", "segments"),
    "Fig. 5": ("PCC-extended,\n16 segments: IMUs", "n_imus"),
}


@page_figure
def error_boxes(boxes: pd.DataFrame, published: pd.DataFrame) -> Figure:
    """Figs 3 to 5: boxes of the markers' errors, one row of panels per evaluation.

    Parameters
    ----------
    boxes
        Columns of ``over_draws``.
    published
        Columns ``artefact, row, quantity, unit, paper``, as from ``three_ways``: marked in the panels.
    """
    ways, figures = list(dict.fromkeys(boxes["evaluation"])), list(dict.fromkeys(boxes["figure"]))
    size = (WIDTH_IN, 2.5 * len(ways) + 0.9)
    widths = [boxes.loc[boxes["figure"] == name, "case"].nunique() for name in figures]
    figure, panels = plt.subplots(
        len(ways), len(figures), figsize=size, sharey=True, sharex="col", squeeze=False, width_ratios=widths
    )
    for row, way in zip(panels, ways, strict=True):
        for panel, name in zip(row, figures, strict=True):
            label, column = PANELS[name]
            here = boxes[(boxes["evaluation"] == way) & (boxes["figure"] == name)]
            groups = list(dict.fromkeys(here[column].tolist()))
            for shift, (marker, colour) in zip((-0.2, 0.2), MARKER_COLOURS.items(), strict=True):
                part = here[here["marker"] == marker]
                _boxes(panel, part, np.arange(len(part)) + shift, colour)
                _printed(panel, part, published, np.arange(len(part)) + shift, name, marker)
            panel.set_xticks(range(len(groups)), [f"{x:g}" for x in groups])
            panel.grid(axis="x", visible=False)
            if panel in panels[0]:
                panel.set_title(name)
            if panel in panels[-1]:
                panel.set_xlabel(label)
        row[0].set_ylabel(f"{way}\nerror [mm]")
    handles: list[Line2D | Patch] = [
        Patch(facecolor=c, alpha=0.35, label=m) for m, c in MARKER_COLOURS.items()
    ]
    handles += [
        Line2D([], [], color="black", marker=shape, mec="white", ms=6, linestyle="none", label=label)
        for shape, label in QUANTITIES.values()
    ]
    panels[0, 0].set_ylim(0, None)
    figure.legend(handles=handles, loc="outside upper center", ncols=2)
    return figure


def _boxes(panel: Axes, part: pd.DataFrame, at: np.ndarray, colour: str) -> None:
    stats = [{name: row[column] for name, column in BOX.items()} for row in part.to_dict("records")]
    panel.bxp(
        stats,
        positions=at,
        widths=0.34,
        showfliers=False,
        patch_artist=True,
        boxprops={"facecolor": colour, "alpha": 0.35, "edgecolor": colour},
        medianprops={"color": "black"},
        whiskerprops={"color": colour},
        capprops={"color": colour},
        manage_ticks=False,
    )


def _printed(
    panel: Axes, part: pd.DataFrame, published: pd.DataFrame, at: np.ndarray, name: str, marker: str
) -> None:
    """Mark what the paper prints for the same figure, marker and number of IMUs or segments."""
    for x, case in zip(at, part.to_dict("records"), strict=True):
        if name == "Fig. 4":
            ending = "8 segments" if case["segments"] == 8 else "16 segments and more"
        else:
            ending = f"{case['n_imus']} IMUs"
        own = published[
            (published["artefact"] == name) & published["row"].str.match(rf"{marker} .*\b{ending}$")
        ]
        for row in own.to_dict("records"):
            scale = 1.0 if row["unit"] == "mm" else MARKER_ARCS_MM[marker] / 100
            shape, _ = QUANTITIES[row["quantity"]]
            panel.plot(
                x, scale * row["paper"], marker=shape, color="black", mec="white", markersize=6, zorder=5
            )


@page_figure
def errors_along_arm(along: pd.DataFrame) -> Figure:
    """Errors along the arm (top) and by mode of motion (bottom): lines are medians, bands end at Q3.

    Parameters
    ----------
    along
        Columns ``model, mode, arc_mm, median_mm, q75_mm``.
    """
    figure, (left, right) = plt.subplots(2, 1, figsize=(WIDTH_IN, 6.4))
    everything = along[along["mode"] == "all"]
    for name, part in everything.groupby("model", sort=False):
        colour, label = LINES[str(name)]
        left.plot(part["arc_mm"], part["median_mm"], color=colour, label=label)
        left.fill_between(part["arc_mm"], part["median_mm"], part["q75_mm"], color=colour, alpha=0.18, lw=0)
    for marker, arc in MARKER_ARCS_MM.items():
        left.axvline(arc, color="0.5", lw=0.8, ls=":")
        left.annotate(marker, (arc, 0), xycoords=("data", "axes fraction"), xytext=(3, 4),
                      textcoords="offset points", color="0.35")  # fmt: skip
    left.set(xlabel="distance from the base [mm]", ylabel="error [mm]", xlim=(0, 650), ylim=(0, None))
    left.set_title("All samples: median, band to Q3")
    figure.legend(loc="outside upper center", ncols=2)
    modes = [mode for mode in dict.fromkeys(along["mode"]) if mode != "all"]
    names = list(dict.fromkeys(along["model"]))
    for k, name in enumerate(names):
        colour, _ = LINES[str(name)]
        for j, mode in enumerate(modes):
            here = along[(along["model"] == name) & (along["mode"] == mode)]
            for shift, marker in ((-0.02, "M1"), (0.06, "M2")):
                point = here[(here["arc_mm"] - MARKER_ARCS_MM[marker]).abs() < 1e-6].iloc[0]
                x = j + 0.24 * (k - (len(names) - 1) / 2) + shift
                filled = colour if marker == "M1" else "white"
                right.plot([x, x], [point["median_mm"], point["q75_mm"]], color=colour, lw=1.2)
                right.plot(x, point["median_mm"], "o", color=colour, mfc=filled, markersize=5)
    right.set_xticks(range(len(modes)), modes)
    right.grid(axis="x", visible=False)
    right.set(ylabel="error [mm]", title="By mode: dot median, line to Q3", ylim=(0, None))
    handles = [
        Line2D([], [], color="0.3", marker="o", ls="none", label="M1"),
        Line2D([], [], color="0.3", marker="o", mfc="white", ls="none", label="M2"),
    ]
    right.legend(handles=handles, loc="center left", bbox_to_anchor=(1.0, 0.5), handletextpad=0.1)
    return figure


@page_figure
def error_hull(hull: pd.DataFrame) -> Figure:
    """Fig. 6: hull around the arm whose radius is the third quartile of the error, in one pose per mode.

    Poses are turned about the vertical, so that all lean to the same side.

    Parameters
    ----------
    hull
        Columns ``mode, time_s, arc_mm, x_mm, y_mm, z_mm, radius_mm`` and ``estimate_x_mm`` and so on.
    """
    modes = list(dict.fromkeys(hull["mode"]))
    figure = plt.figure(figsize=(WIDTH_IN, 3.3 * -(-len(modes) // 2)))
    for k, mode in enumerate(modes):
        panel = figure.add_subplot(-(-len(modes) // 2), 2, k + 1, projection="3d")
        part = hull[hull["mode"] == mode]
        true, estimate = (
            np.vstack([np.zeros(3), part[[f"{prefix}{axis}_mm" for axis in "xyz"]].to_numpy(dtype=float)])
            for prefix in ("", "estimate_")
        )
        radius = np.append(0.0, part["radius_mm"].to_numpy(dtype=float))
        turn = _to_one_side(true[-1])
        true, estimate = true @ turn.T, estimate @ turn.T
        tube = _tube(true, radius)
        panel.plot_surface(*tube, color="#56B4E9", alpha=0.28, linewidth=0, shade=False, rcount=99, ccount=99)
        panel.plot(*true.T, color="black", lw=2, label="arm")
        panel.plot(*estimate.T, color="#D55E00", lw=1.6, label="estimate", zorder=5)
        _equal(panel, tube)
        panel.set_title(f"{mode}, {part['time_s'].iloc[0]:.0f} s", y=0.98)
    handles: list[Line2D | Patch] = [
        Line2D([], [], color="black", lw=2, label="arm"),
        Line2D([], [], color="#D55E00", label="estimate at this moment"),
        Patch(facecolor="#56B4E9", alpha=0.4, label="hull: Q3 of the error over the trial"),
    ]
    figure.legend(handles=handles, loc="outside lower center", ncols=2)
    return figure


def _to_one_side(tip: np.ndarray) -> np.ndarray:
    """Rotation about the vertical that takes a tip to the side of negative x."""
    angle = np.pi - np.arctan2(tip[1], tip[0])
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


def _tube(points: np.ndarray, radius: np.ndarray, around: int = 25) -> np.ndarray:
    """Surface ``[3, points, around]`` of circles across a curve, which turn along with it without twist."""
    direction = np.gradient(points, axis=0)
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    side = np.cross(direction[0], np.eye(3)[np.argmin(np.abs(direction[0]))])
    circles = []
    for centre, d, r in zip(points, direction, radius, strict=True):
        side = side - (side @ d) * d
        side /= np.linalg.norm(side)
        angle = np.linspace(0, 2 * np.pi, around)[:, None]
        circles.append(centre + r * (np.cos(angle) * side + np.sin(angle) * np.cross(d, side)))
    return np.moveaxis(np.array(circles), -1, 0)


def _equal(panel: Axes3D, tube: np.ndarray) -> None:
    low, high = tube.min(axis=(1, 2)), tube.max(axis=(1, 2))
    low[2] = min(low[2], 0.0)
    middle, half = (low + high) / 2, max((high - low).max() / 2, 60.0)
    limits = [(m - half, m + half) for m in middle]
    panel.set(xlim=limits[0], ylim=limits[1], zlim=limits[2])
    panel.set_box_aspect((1, 1, 1), zoom=0.9)
    label_in_mm(panel, fontsize=9.0, labelpad=-5.0)
    panel.tick_params(labelsize=8, pad=-3)
    panel.locator_params(nbins=4)
    panel.view_init(elev=14, azim=-60)


@page_figure
def calibration_ratios(ratios: pd.DataFrame, methods: Sequence[str] = ()) -> Figure:
    """Median errors after calibration against the uncalibrated PCC-extended model, with 95 % intervals and targets.

    Parameters
    ----------
    ratios
        Columns ``method, mode, point, ratio, ratio_low, ratio_high, target``.
    methods
        Which methods; those with a target when empty.
    """
    shown = list(methods) or list(dict.fromkeys(ratios.loc[ratios["target"].notna(), "method"]))
    figure, panels = plt.subplots(2, 1, figsize=(WIDTH_IN, 5.8), sharey=True)
    modes, points = list(dict.fromkeys(ratios["mode"])), list(dict.fromkeys(ratios["point"]))
    cuts = (
        (panels[0], "mode", modes, ratios[ratios["point"] == "markers"], "Both markers, by mode of motion"),
        (panels[1], "point", points, ratios[ratios["mode"] == "all"], "All modes, by point of the arm"),
    )
    for panel, column, labels, table, title in cuts:
        for k, (method, colour) in enumerate(zip(shown, ("#0072B2", "#D55E00", "#009E73"), strict=False)):
            part = table[table["method"] == method].set_index(column).loc[labels]
            x = np.arange(len(labels)) + 0.2 * (k - (len(shown) - 1) / 2)
            reach = [part["ratio"] - part["ratio_low"], part["ratio_high"] - part["ratio"]]
            panel.errorbar(x, part["ratio"], yerr=reach, fmt="o", ms=5, color=colour, capsize=3, label=method)
            target = part["target"].iloc[0]
            if np.isfinite(target):
                panel.axhline(target, color=colour, ls="--", lw=1)
        panel.set_xticks(range(len(labels)), [str(label).removesuffix(" mm") for label in labels])
        panel.set_title(title)
        panel.grid(axis="x", visible=False)
    panels[0].axhline(1.0, color="0.4", lw=0.8)
    panels[1].axhline(1.0, color="0.4", lw=0.8)
    panels[0].set_xlabel("mode of motion")
    panels[1].set_xlabel("distance of the point from the base [mm]")
    panels[0].set(ylim=(0, 1.08), ylabel="error / uncalibrated PCC-16")
    panels[1].set_ylabel("error / uncalibrated PCC-16")
    handles, names = panels[0].get_legend_handles_labels()
    handles.append(Line2D([], [], color="0.3", ls="--", lw=1, label="target of the same colour"))
    figure.legend(handles, [*names, "target of the same colour"], loc="outside upper center", ncols=2)
    return figure
