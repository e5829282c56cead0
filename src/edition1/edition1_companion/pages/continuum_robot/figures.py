"""Figures of the filter on a real robot: errors over time, by estimator, by setting, and the 3-D view."""

from __future__ import annotations

import matplotlib.pyplot as plt
import numpy as np
import pandas as pd
from jaxtyping import Float
from matplotlib.figure import Figure

from edition1_live.view.shape_view import Markers, Shape, ShapeView, Traces
from edition1_live.view.style import WIDTH_IN, page_figure, wrapped_panels

COLOURS = {
    "filter": "#0072B2",
    "smoother": "#009E73",
    "released filter": "#E69F00",
    "released window": "#CC79A7",
    "released batch": "#D55E00",
}
"""Of each estimator."""


@page_figure
def errors_by_estimator(table: pd.DataFrame) -> Figure:
    """Mean error over the stations, a panel for each setting.

    Parameters
    ----------
    table
        Columns ``trial, setting, estimator, rmse_mm``, one row for each.
    """
    figure, panels = wrapped_panels(2, 1, 2.4, sharex=True, sharey=True)
    trials = list(dict.fromkeys(table["trial"]))
    for panel, setting in zip(panels, ("raw", "calibrated"), strict=True):
        for k, (name, colour) in enumerate(COLOURS.items()):
            part = table[(table["setting"] == setting) & (table["estimator"] == name)].set_index("trial")
            here = [n for n, trial in enumerate(trials) if trial in part.index]
            x = np.array(here) + (k - 2) * 0.15
            heights = part.loc[[trials[n] for n in here], "rmse_mm"]
            panel.bar(x, heights, 0.14, color=colour, label=name)
        panel.set(title=setting.capitalize(), ylim=(0, None))
        panel.grid(axis="y", lw=0.4, alpha=0.6)
    panels[-1].set_xticks(range(len(trials)), [trial.replace("_", " ") for trial in trials])
    figure.supylabel("mean error of the stations [mm]")
    figure.legend(*panels[0].get_legend_handles_labels(), loc="outside upper center", ncols=3)
    return figure


def broken_at_gaps(time_s: Float[np.ndarray, "t"], values: Float[np.ndarray, "t"]) -> list[np.ndarray]:
    """Points of a line that is broken where there is none for more than three of the usual steps."""
    steps = np.diff(time_s)
    after = np.flatnonzero(steps > 3 * np.median(steps)) + 1
    return [np.insert(time_s, after, time_s[after]), np.insert(values, after, np.nan)]


@page_figure
def errors_over_time(table: pd.DataFrame) -> Figure:
    """Error at the middle and at the tip over time, a panel for each trial.

    Parameters
    ----------
    table
        Columns ``trial, estimator, station_mm, time_s, error_mm``.
    """
    trials = list(dict.fromkeys(table["trial"]))
    figure, panels = wrapped_panels(len(trials), 1, 1.9)
    for panel, trial in zip(np.ravel(panels), trials, strict=True):
        for name in ("filter", "smoother"):
            for station, style in ((233.0, "-"), (466.0, ":")):
                part = table[
                    (table["trial"] == trial)
                    & (table["estimator"] == name)
                    & (table["station_mm"] == station)
                ]
                at = "middle" if station == 233.0 else "tip"
                panel.plot(
                    *broken_at_gaps(part["time_s"].to_numpy(), part["error_mm"].to_numpy()),
                    style,
                    color=COLOURS[name],
                    lw=1.2,
                    label=f"{name}, {at}",
                )
        panel.set(title=trial.replace("_", " "), ylim=(0, None))
        panel.grid(lw=0.4, alpha=0.6)
    np.ravel(panels)[-1].set_xlabel("time [s]")
    figure.supylabel("error [mm]")
    figure.legend(*np.ravel(panels)[0].get_legend_handles_labels(), loc="outside upper center", ncols=2)
    return figure


@page_figure
def errors_by_setting(table: pd.DataFrame) -> Figure:
    """Mean error by trial, for one setting changed at a time.

    Parameters
    ----------
    table
        Columns ``changed, trial, rmse_mm``, of the filter.
    """
    labels, trials = list(dict.fromkeys(table["changed"])), list(dict.fromkeys(table["trial"]))
    figure, panel = plt.subplots(figsize=(WIDTH_IN, 1.6 + 0.3 * len(labels)))
    for trial, marker in zip(trials, "osDv^PX", strict=False):
        values = table[table["trial"] == trial].set_index("changed").loc[labels, "rmse_mm"]
        panel.plot(values, np.arange(len(labels)), marker, label=trial.replace("_", " "))
    panel.set(xscale="log", xlabel="mean error of the stations, filter [mm]")
    panel.set_yticks(range(len(labels)), labels)
    ticks = [5, 10, 20, 40]
    panel.set_xticks(ticks, [str(tick) for tick in ticks])
    panel.minorticks_off()
    panel.invert_yaxis()
    panel.grid(lw=0.4, alpha=0.6)
    figure.legend(loc="outside upper center", ncols=2)
    return figure


def robot_view(
    trial: str,
    time_s: Float[np.ndarray, " m"],
    backbone: tuple[Float[np.ndarray, "m points 3"], Float[np.ndarray, "m points"]],
    bodies: Float[np.ndarray, "m 4 4 4"],
    error_mm: Float[np.ndarray, " m"],
) -> ShapeView:
    """The filter's shape over time with the bodies of the motion capture.

    Parameters
    ----------
    trial
        Its name.
    time_s
        Of the frames that show all bodies.
    backbone
        Points of the estimate from base to tip, and their standard deviations [m].
    bodies
        Poses of the bodies of the motion capture.
    error_mm
        Mean error over the stations.
    """
    tip_mm = 1e3 * bodies[:, -1, :3, 3]
    label = (
        f"Recorded robot, trial {trial}: the filter's shape and four bodies of the motion capture along it. "
        f"{len(time_s)} frames from {time_s[0]:.4g} to {time_s[-1]:.4g} s; the tip is at z = "
        f"{tip_mm[:, 2].min():.0f} to {tip_mm[:, 2].max():.0f} mm."
    )
    points, deviation = backbone
    return ShapeView(
        label=label,
        time_s=time_s,
        shapes=(Shape("filter", points, deviation, role="estimate"),),
        radius_m=0.006,
        sensors=Markers(bodies[..., :3, 3], bodies[..., :3, 2], "bodies of the motion capture"),
        traces=(Traces("mean error of the stations", "mm", {"filter": error_mm}),),
    )
