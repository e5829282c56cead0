"""Figures of the closed loop: paths and distances from the reference, and ratios of the tracking errors."""

from __future__ import annotations

import matplotlib.pyplot as plt
import numpy as np
import pandas as pd
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from edition1_live.view.style import WIDTH_IN, page_figure, plain_ticks, wrapped_panels

FEEDBACK = {
    "truth": "#0072B2",
    "readings": "#D55E00",
    "lag": "#E69F00",
    "lag and command": "#009E73",
    "command alone": "#CC79A7",
}
"""Colour of the true bend and of each estimator."""
SESSION_MARKS = {"as trained": "o", "another": "s"}


@page_figure
def loops(series: pd.DataFrame, title: str) -> Figure:
    """Path of the true bend in its plane, and beside it its distance from the reference over time.

    Parameters
    ----------
    series
        Columns of `edition1_companion.pages.closed_loop.tables.loops_over_time`.
    title
        Above all panels.
    """
    names = list(dict.fromkeys(series["reference"]))
    figure, panels = plt.subplots(
        len(names), 2, figsize=(WIDTH_IN, 2.5 * len(names) + 0.8), width_ratios=(1, 1.6), squeeze=False
    )
    for name, (path, over_time) in zip(names, panels, strict=True):
        here = series[series["reference"] == name]
        wanted = here[here["feedback"] == "truth"]
        steps = (wanted[["reference_x_mm", "reference_y_mm"]].diff().abs() > 1.0).any(axis=1)
        marks = ("ks", 5) if steps.any() else ("k-", 3)
        path.plot(wanted["reference_x_mm"], wanted["reference_y_mm"], marks[0], lw=2.4, ms=marks[1])
        for feedback, part in here.groupby("feedback", sort=False):
            colour = FEEDBACK[feedback]
            path.plot(part["delta_x_mm"], part["delta_y_mm"], color=colour, lw=1.0)
            apart = [(part[f"reference_{a}_mm"] - part[f"delta_{a}_mm"]).to_numpy() for a in "xy"]
            over_time.semilogy(part["time_s"], np.maximum(np.hypot(*apart), 1e-2), color=colour, lw=0.9)
        path.set(title=name, ylabel=r"$\Delta_y$ [mm]", xlim=(-6, 10), ylim=(-10, 10), aspect="equal")
        over_time.set(ylabel="distance from the\nreference [mm]", ylim=(1e-2, 15))
        plain_ticks(over_time.yaxis, subs=(1,))
    panels[-1, 0].set_xlabel(r"$\Delta_x$ [mm]")
    panels[-1, 1].set_xlabel("time [s]")
    fed_back = list(dict.fromkeys(series["feedback"]))
    labels = {"truth": "true bend fed back"} | {f: f"estimate: {f}" for f in fed_back if f != "truth"}
    handles = [
        Line2D([], [], color="black", lw=2.4, label="reference"),
        *(Line2D([], [], color=FEEDBACK[f], label=labels[f]) for f in fed_back),
    ]
    figure.legend(handles=handles, loc="outside lower center", ncols=2)
    figure.suptitle(title)
    return figure


@page_figure
def tracking_ratios(table: pd.DataFrame, target: float, title: str) -> Figure:
    """Tracking error with the estimate over that with the true bend, by controller, reference, estimator, session.

    Parameters
    ----------
    table
        Columns of `edition1_companion.pages.closed_loop.tables.tracking_ratios`, and ``estimator``.
    target
        Drawn as a line.
    title
        Above the panel.
    """
    controllers, names, estimators = (
        list(dict.fromkeys(table[c])) for c in ("controller", "reference", "estimator")
    )
    figure, panels = wrapped_panels(len(controllers), 1, 2.1, sharey=True)
    for panel, controller in zip(panels, controllers, strict=True):
        here = table[table["controller"] == controller]
        for estimator, session in here[["estimator", "session"]].drop_duplicates().to_numpy():
            part = here[(here["estimator"] == estimator) & (here["session"] == session)]
            place = estimators.index(estimator) - (len(estimators) - 1) / 2
            aside = 0.18 * place + 0.07 * (list(SESSION_MARKS).index(session) - 0.5)
            rows = part.set_index("reference").loc[names]
            bars = np.abs(np.stack([rows["low"], rows["high"]]) - rows["ratio"].to_numpy())
            style = {"fmt": SESSION_MARKS[session], "ms": 4, "lw": 1.2, "color": FEEDBACK[estimator]}
            panel.errorbar(np.arange(len(names)) + aside, rows["ratio"], bars, **style)
        panel.axhline(1.0, color="0.6", lw=0.8)
        panel.axhline(target, color="0.3", lw=0.9, ls="--")
        panel.set(yscale="log", ylabel="error, estimate\nover true bend")
        plain_ticks(panel.yaxis, subs=(1,))
        panel.set(title=controller, xticks=range(len(names)), xlim=(-0.5, len(names) - 0.5))
        panel.set_xticklabels(names)
    handles = [
        *(Line2D([], [], color=FEEDBACK[e], marker="o", ls="", label=f"estimate: {e}") for e in estimators),
        *(
            Line2D([], [], color="0.3", marker=m, ls="", label=f"session: {k}")
            for k, m in SESSION_MARKS.items()
        ),
        Line2D([], [], color="0.3", ls="--", label="target"),
    ]
    figure.legend(handles=handles, loc="outside lower center", ncols=3)
    figure.suptitle(title)
    return figure
