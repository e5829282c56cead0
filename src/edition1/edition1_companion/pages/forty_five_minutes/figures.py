"""Figures of the page: errors over the 45 minutes; what becomes known, and the minute with iron."""

from __future__ import annotations

import matplotlib.pyplot as plt
import pandas as pd
from matplotlib.figure import Figure

from edition1_companion.pages.forty_five_minutes.methods import LAST_MINUTES, METHODS
from edition1_live.view.style import WIDTH_IN, page_figure, plain_ticks

COLOURS = dict(zip(METHODS, ("#D55E00", "#0072B2", "#CC79A7", "#009E73", "0.4"), strict=True))
KINDS = {"moment": "#0072B2", "gain": "#D55E00", "offset": "#CC79A7", "heading": "#009E73", "tilt": "#E69F00"}
IN_WORDS = {"oracle": "knows the drift", "IMU only": "IMUs only"}


@page_figure
def errors_over_time(table: pd.DataFrame) -> Figure:
    """Median error of the tip by method over time; bands hold all twins.

    Parameters
    ----------
    table
        Columns of :func:`edition1_companion.pages.forty_five_minutes.tables.over_time`.
    """
    figure, panel = plt.subplots(figsize=(WIDTH_IN, 3.6))
    end = int(table["minute"].max())
    panel.axvspan(end - LAST_MINUTES + 0.5, end + 0.5, color="0.93", lw=0)
    for method in METHODS:
        part = table[table["method"] == method]
        style = "--" if method == "oracle" else "-"
        panel.plot(
            part["minute"],
            part["median_percent"],
            style,
            color=COLOURS[method],
            label=IN_WORDS.get(method, method),
        )
        if method in ("fused", "self-calibrating"):
            band = (part["minute"], part["least_percent"], part["most_percent"])
            panel.fill_between(*band, color=COLOURS[method], alpha=0.15, lw=0)
    panel.set(yscale="log", xlabel="time [min]", ylabel="error of the tip\n[% of the length]")
    plain_ticks(panel.yaxis)
    figure.legend(loc="outside upper center", ncols=3)
    return figure


@page_figure
def learnt_and_iron(learnt: pd.DataFrame, iron: pd.DataFrame) -> Figure:
    """Left, uncertainty of the errors over that without readings; right, error of the tip while iron is near.

    Parameters
    ----------
    learnt, iron
        Columns of the functions of these names in :mod:`edition1_companion.pages.forty_five_minutes.tables`.
    """
    figure, (left, right) = plt.subplots(1, 2, figsize=(WIDTH_IN, 3.4))
    for kind, colour in KINDS.items():
        part = learnt[learnt["kind"] == kind]
        left.plot(part["minute"], part["share"], color=colour, label=kind)
    left.set(yscale="log", xlabel="time [min]", ylabel="uncertainty, share of the prior")
    figure.legend(loc="outside upper center", ncols=len(KINDS))
    flagged = iron["flag_s"] > 0
    for part, filled, words in ((iron[flagged], True, "flag is up"), (iron[~flagged], False, "no flag")):
        if len(part):
            face = COLOURS["self-calibrating"] if filled else "none"
            points = (part["fused_percent"], part["self_percent"])
            right.scatter(*points, s=28, facecolors=face, edgecolors=COLOURS["self-calibrating"], label=words)
    most = max(iron["fused_percent"].max(), iron["self_percent"].max())
    right.plot([0, most], [0, most], color="0.6", lw=1)
    right.set(xlabel="error, fused [% of the length]", ylabel="error, self-calibrating [%]")
    right.legend()
    plain_ticks(left.yaxis)
    return figure
