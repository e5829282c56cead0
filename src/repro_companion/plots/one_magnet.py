"""Figures of Mitchell et al.: Figs 3 to 5, 8 and 9."""

from __future__ import annotations

from collections.abc import Sequence

import matplotlib.pyplot as plt
import numpy as np
import pandas as pd
from matplotlib.figure import Figure
from matplotlib.patches import Circle, Polygon
from matplotlib.ticker import MultipleLocator

from repro_companion.plots.style import (
    BESIDE,
    BLUE,
    GREEN,
    LEVELS,
    NO_GRID,
    ORANGE,
    PINK,
    PUBLISHED,
    SKY,
    WIDTH,
    YELLOW,
    Look,
    column_of_panels,
    curves,
    plain_numbers,
    style,
    with_legend,
)

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
    """Draw the errors of the bend against both tilts, and of its direction, by take: a mark for each method."""
    takes, names = sorted(errors["take"].unique()), list(errors["name"].unique())
    figure, panels = plt.subplots(3, 1, figsize=(WIDTH, 6.4), sharex=True)
    columns = {
        "rmse_deg": "bend, tilt of y",
        "rmse_tilt_z_deg": "bend, tilt of z",
        "direction_deg": "direction",
    }
    for k, (name, colour, marker) in enumerate(zip(names, (ORANGE, PINK, GREEN, BLUE), "sXDo", strict=False)):
        own = errors[errors["name"] == name].set_index("take").reindex(takes)
        x = np.arange(len(takes)) + 0.2 * (k - (len(names) - 1) / 2)
        look = {"color": colour, "ls": "", "marker": marker, "ms": 7, "mew": 0}
        for panel, column in zip(panels, columns, strict=True):
            panel.plot(x, own[column], label=name if column == "rmse_deg" else None, **look)
    top = 1.08 * errors[[*columns]].to_numpy().max()  # of all panels, which are to be compared
    for panel, words in zip(panels, columns.values(), strict=True):
        panel.set(ylabel=f"{words}:\nRMSE [°]", ylim=(0, top), yticks=(0, 5, 10, 15))
    panels[2].set_xlabel("test and try")
    panels[2].set_xticks(range(len(takes)), [take[5:].replace("_try_", "\ntry ") for take in takes])
    for panel in panels:
        for edge in range(1, len(takes)):
            panel.axvline(edge - 0.5, color="#767676", lw=0.5, alpha=0.5)
    return with_legend(figure, columns=1, handlelength=0.5)


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
    top.plot(law.index, law, color="0.5", lw=1, label="law (see text)")
    top.axhspan(min(printed) - 5e-5, max(printed) + 5e-5, color=YELLOW, alpha=0.8, lw=0, label="published")
    top.axvline(0.02, color="0.5", lw=1, ls=":", label="paper's noise")
    top.set(yscale="log", title="without sensor noise")
    for name, part in noisy.groupby("setting", sort=False):
        look = {"random walk": (SKY, "v"), "constant velocity": (ORANGE, "^")}[str(name)]
        own = part.groupby("process_noise_pi")["rmse_mm"].mean()
        bottom.plot(own.index, own, color=look[0], marker=look[1], ms=6, label=name)
    bottom.axhline(single, color="0.5", ls="--", label="least squares, one reading")
    bottom.set(
        title="with sensor noise, mean of the curves", yscale="log", ylim=(0.035, 0.13), yticks=[0.04, 0.06, 0.1],
        xscale="log", xticks=[5e-4, 0.002, 0.005, 0.02],
    )  # fmt: skip
    plain_numbers(bottom.xaxis, bottom.yaxis, top.yaxis)
    for panel in (top, bottom):
        panel.set_ylabel("RMSE [mm]")
    top.legend(loc="upper right", ncols=2, **BESIDE)
    bottom.legend(loc="lower right", **BESIDE)
    return figure
