"""Figures of the pages beyond the papers."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
import pandas as pd
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator
from matplotlib.typing import LineStyleType

from repro.improve import Improvement
from repro_companion.plots.style import (
    BESIDE,
    BLUE,
    FOUR,
    GREEN,
    GREY_INK,
    LEVELS,
    NO_GRID,
    ORANGE,
    PINK,
    PUBLISHED,
    SKY,
    TRUTH,
    WIDTH,
    YELLOW,
    Look,
    column_of_panels,
    curves,
    plain_numbers,
    row_of_panels,
    style,
    with_legend,
)

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
    figure, panels = plt.subplots(rows, 4, figsize=(WIDTH, 2.0 * rows), squeeze=False)
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
