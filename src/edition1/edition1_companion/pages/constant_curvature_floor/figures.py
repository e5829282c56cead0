"""Figures of the floors of shape models: by trial, by bend, and two frames with what a model makes of them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import matplotlib.pyplot as plt
import numpy as np
import pandas as pd
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from scipy.interpolate import CubicHermiteSpline

from edition1_companion.pages.constant_curvature_floor.floors import OFFSET, RAW, TIP, TIP_MIDDLE, TURNS
from edition1_companion.recordings.continuum_robot import LENGTH_M, STATIONS_M
from edition1_live.view.style import WIDTH_IN, page_figure, plain_ticks, wrapped_panels

COLOURS = {
    "one arc": "#D55E00",
    "two arcs": "#E69F00",
    "three arcs": "#CC79A7",
    "affine curvature": "#0072B2",
    "quadratic curvature": "#009E73",
}
"""Of each shape."""
TRIALS = ("o", "s", "^", "D", "v", "P", "X")
"""Markers of the trials, in their order."""


@page_figure
def floors_by_shape(table: pd.DataFrame) -> Figure:
    """Error by shape and trial, a panel for each set of sensors.

    Parameters
    ----------
    table
        Columns ``trial, setting, sensors, shape, error_mm, low_mm, high_mm``.
    """
    figure, panels = wrapped_panels(3, 1, 2.4, sharex=True, sharey=True)
    trials, shapes = list(dict.fromkeys(table["trial"])), list(COLOURS)
    for panel, sensors in zip(panels, (TIP, TIP_MIDDLE, TURNS), strict=True):
        for n, trial in enumerate(trials):
            x = np.arange(len(shapes)) + 0.5 * ((n + 0.5) / len(trials) - 0.5)
            here = table[(table["trial"] == trial) & (table["sensors"] == sensors)]
            raw, moved = (here[here["setting"] == s].set_index("shape").loc[shapes] for s in (RAW, OFFSET))
            lines = np.abs(raw[["low_mm", "high_mm"]].to_numpy().T - raw["error_mm"].to_numpy())
            panel.errorbar(x, raw["error_mm"], lines, fmt="none", ecolor="0.5", lw=1)
            marker = TRIALS[n % len(TRIALS)]
            panel.scatter(x, raw["error_mm"], 26, list(COLOURS.values()), marker=marker, zorder=3)
            panel.scatter(x, moved["error_mm"], 40, "none", marker=marker, edgecolors="0.3", lw=0.8)
        panel.set(yscale="log", title=sensors.capitalize())
        plain_ticks(panel.yaxis, subs=(1, 2, 5))
        panel.grid(axis="y", lw=0.4, alpha=0.6)
    panels[-1].set_xticks(range(len(shapes)), [name.replace(" ", "\n") for name in shapes])
    figure.supylabel("error where nothing was measured [mm]")
    handles = [
        Line2D([], [], color="0.3", ls="", marker=TRIALS[n % len(TRIALS)], label=trial.replace("_", " "))
        for n, trial in enumerate(trials)
    ]
    handles.append(Line2D([], [], color="0.3", ls="", marker="o", mfc="none", label=OFFSET))
    figure.legend(handles=handles, loc="outside upper center", ncols=2)
    return figure


@page_figure
def floors_by_bend(table: pd.DataFrame) -> Figure:
    """Error by the bend of the arm, all trials together: from the tip's pose, and from all orientations.

    Parameters
    ----------
    table
        Columns ``bend_from_deg, bend_to_deg, setting, sensors, shape, error_mm, low_mm, high_mm``.
    """
    figure, panels = plt.subplots(2, 1, figsize=(WIDTH_IN, 6.2), sharex=True, sharey=True)
    recorded = table[table["setting"] == RAW]
    bins = recorded[["bend_from_deg", "bend_to_deg"]].drop_duplicates().to_numpy()
    for panel, sensors in zip(panels, (TIP, TURNS), strict=True):
        for n, (shape, colour) in enumerate(COLOURS.items()):
            part = recorded[(recorded["sensors"] == sensors) & (recorded["shape"] == shape)]
            x = np.arange(len(bins)) + 0.1 * (n - 2)
            lines = np.abs(part[["low_mm", "high_mm"]].to_numpy().T - part["error_mm"].to_numpy())
            panel.errorbar(x, part["error_mm"], lines, fmt="o-", ms=4, lw=1, color=colour, label=shape)
        panel.set(yscale="log", ylabel="error [mm]", title=sensors.capitalize())
        plain_ticks(panel.yaxis, subs=(1, 2, 5))
        panel.grid(axis="y", lw=0.4, alpha=0.6)
    panels[-1].set_xticks(range(len(bins)), [f"{low:g} to {high:g}°" for low, high in bins])
    panels[-1].set_xlabel("angle between base and tip")
    figure.legend(*panels[0].get_legend_handles_labels(), loc="outside upper center", ncols=3)
    return figure


@page_figure
def two_frames(
    frames: Sequence[tuple[str, Float[np.ndarray, "4 4 4"], Mapping[str, Float[np.ndarray, "4 4 4"]]]],
) -> Figure:
    """Frames seen across the plane of the tip: where the bodies are, and the shapes through the pose of the tip.

    Parameters
    ----------
    frames
        Title, poses of the bodies in the base, and those of the fitted shapes.
    """
    figure, panels = plt.subplots(1, len(frames), figsize=(WIDTH_IN, 4.2))
    for panel, (title, T, shapes) in zip(np.atleast_1d(panels), frames, strict=True):
        side = T[-1, :2, 3] / np.linalg.norm(T[-1, :2, 3])
        for name, fit in shapes.items():
            _curve(panel, fit, side, COLOURS[name], name)
        points = np.concatenate([np.zeros((1, 3)), T[:, :3, 3]])
        panel.plot(1e3 * points[:, :2] @ side, 1e3 * points[:, 2], "ks", ms=6, label="motion capture")
        panel.set(xlabel="towards the tip [mm]", title=title)
        panel.set_aspect("equal", adjustable="datalim")
        panel.grid(lw=0.4, alpha=0.6)
    first = np.atleast_1d(panels)[0]
    first.set_ylabel("along the base [mm]")
    figure.legend(*first.get_legend_handles_labels(), loc="outside upper center", ncols=3)
    return figure


def _curve(panel: Axes, T: np.ndarray, side: np.ndarray, colour: str, name: str) -> None:
    """Draw a shape through its stations, with their directions."""
    points = np.concatenate([np.zeros((1, 3)), T[:, :3, 3]])
    along = np.concatenate([[[0.0, 0.0, 1.0]], T[:, :3, 2]])
    curve = CubicHermiteSpline([0.0, *STATIONS_M], points, along)(np.linspace(0, LENGTH_M, 65))
    panel.plot(1e3 * curve[:, :2] @ side, 1e3 * curve[:, 2], color=colour, lw=1.6, label=name)
