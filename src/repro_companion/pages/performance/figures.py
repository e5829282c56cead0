"""Figures of the page on performance: rates against the rates of the sensors, and how the cost grows."""

from __future__ import annotations

from collections.abc import Sequence

import matplotlib.pyplot as plt
import numpy as np
import pandas as pd
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from repro_companion.pages.performance.tables import LIVE, exponents, with_targets
from repro_live.view.style import in_symbols, page_figure, plain_ticks

OURS, REFERENCE, TARGET = "#0072B2", "#D55E00", "0.25"
COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7")


@page_figure
def rates(table: pd.DataFrame, sensor_rates_hz: Sequence[float]) -> Figure:
    """Rates of ours and of the references on a logarithmic axis, with targets; dashed lines are the sensors' rates.

    Parameters
    ----------
    table
        Columns of the benchmark's table.
    sensor_rates_hz
        Where to draw lines.
    """
    lines = pd.concat([with_targets(table), table[table["capability"].str.endswith(LIVE)]])
    figure, panel = plt.subplots(figsize=(9.0, 0.42 * len(lines) + 1.6))
    y = np.arange(len(lines))[::-1]
    panel.hlines(y, lines["reference"], lines["ours"], color="0.8", lw=1.2, zorder=1)
    panel.plot(lines["reference"], y, "s", color=REFERENCE, mfc="white", ms=6, label="reference")
    panel.plot(lines["target"], y, "|", color=TARGET, ms=13, mew=2, label="target")
    panel.plot(lines["ours"], y, "o", color=OURS, ms=6, label="ours")
    for rate in sensor_rates_hz:
        panel.axvline(rate, color="black", ls="--", lw=1)
    panel.set(xscale="log", xlabel="items per second of processor time", ylim=(-0.8, len(lines) + 0.4))
    panel.set_yticks(y, [in_symbols(name) for name in lines["capability"]])
    panel.grid(axis="y", visible=False)
    if len(sensor_rates_hz):
        names = " and ".join(f"{rate:g}" for rate in sensor_rates_hz)
        panel.annotate(
            f"sensor rate, {names} Hz",
            (max(sensor_rates_hz), len(lines) - 0.2),
            xytext=(5, 0),
            textcoords="offset points",
            va="center",
        )
    figure.legend(loc="outside upper center", ncols=3)
    return figure


@page_figure
def scaling_curves(points: pd.DataFrame) -> Figure:
    """Time of a call against what it grows with; lines are the power laws of the largest decade.

    Parameters
    ----------
    points
        Columns ``capability, against, size, seconds``.
    """
    names, fitted = list(dict.fromkeys(points["against"])), exponents(points)
    columns = min(3, len(names))
    rows = -(-len(names) // columns)
    figure, panels = plt.subplots(rows, columns, figsize=(3.3 * columns, 3.4 * rows), squeeze=False)
    for panel, against in zip(panels.flat, names, strict=False):
        for colour, found in zip(COLOURS, fitted[fitted["against"] == against].itertuples(), strict=False):
            here = points[(points["against"] == against) & (points["capability"] == found.capability)]
            last = here[here["size"] >= here["size"].max() / 10 * (1 - 1e-9)]
            level = np.exp(np.mean(np.log(last["seconds"]) - found.exponent * np.log(last["size"])))
            panel.plot(here["size"], 1e3 * here["seconds"], "o", color=colour, ms=4)
            panel.plot(last["size"], 1e3 * level * last["size"] ** found.exponent, color=colour, lw=1.2)
        handles = [
            Line2D(
                [],
                [],
                color=c,
                marker="o",
                ms=4,
                lw=1.2,
                label=in_symbols(f"{f.capability}: {f.exponent:.2f}"),
            )
            for c, f in zip(COLOURS, fitted[fitted["against"] == against].itertuples(), strict=False)
        ]
        panel.legend(handles=handles, loc="lower center", bbox_to_anchor=(0.5, 1.0), fontsize=8)
        panel.set(xscale="log", yscale="log", xlabel=against)
        plain_ticks(panel.xaxis, subs=(1,))
        plain_ticks(panel.yaxis, subs=(1, 3))
    for panel in panels.flat[len(names) :]:
        panel.set_visible(False)
    figure.supylabel("processor time of a call [ms]", fontsize="medium")
    return figure
