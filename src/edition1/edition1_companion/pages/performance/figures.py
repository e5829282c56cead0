"""Figures of the page on performance: rates against the rates of the sensors, and how the cost grows."""

from __future__ import annotations

from collections.abc import Sequence

import matplotlib.pyplot as plt
import numpy as np
import pandas as pd
from edition1_live.view.style import WIDTH_IN, page_figure, plain_ticks, wrapped_panels
from edition1_live.view.symbols import in_symbols
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from edition1_companion.pages.performance.tables import LIVE, exponents, with_targets

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
    figure, panel = plt.subplots(figsize=(WIDTH_IN, 0.52 * len(lines) + 1.6))
    y = np.arange(len(lines))[::-1]
    panel.hlines(y, lines["reference"], lines["ours"], color="0.8", lw=1.2, zorder=1)
    panel.plot(lines["reference"], y, "s", color=REFERENCE, mfc="white", ms=6, label="reference")
    panel.plot(lines["target"], y, "|", color=TARGET, ms=13, mew=2, label="target")
    panel.plot(lines["ours"], y, "o", color=OURS, ms=6, label="this book")
    for rate in sensor_rates_hz:
        panel.axvline(rate, color="black", ls="--", lw=1)
    panel.set(xscale="log", xlabel="items per second of processor time", ylim=(-0.8, len(lines) + 0.4))
    panel.set_yticks([])
    for at, name in zip(y, lines["capability"], strict=True):
        panel.annotate(in_symbols(name), (1.3 * max(sensor_rates_hz, default=1.0), at + 0.3))
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
    """Time of a call against what it grows with; lines are the power laws of the largest decade, with their exponent.

    Parameters
    ----------
    points
        Columns ``capability, against, size, seconds``.
    """
    names, fitted = list(dict.fromkeys(points["against"])), exponents(points)
    figure, panels = wrapped_panels(len(names), 2, 3.2)
    for panel, against in zip(panels, names, strict=True):
        models = fitted[fitted["against"] == against].itertuples()
        for k, (colour, found) in enumerate(zip(COLOURS, models, strict=False)):
            here = points[(points["against"] == against) & (points["capability"] == found.capability)]
            last = here[here["size"] >= here["size"].max() / 10 * (1 - 1e-9)]
            level = np.exp(np.mean(np.log(last["seconds"]) - found.exponent * np.log(last["size"])))
            panel.plot(here["size"], 1e3 * here["seconds"], "o", color=colour, ms=4)
            line = 1e3 * level * last["size"] ** found.exponent
            panel.plot(last["size"], line, color=colour, lw=1.2)
            end = (last["size"].max(), line.max())
            beside = {"xytext": (4, 5 - 10 * k), "textcoords": "offset points", "va": "center"}
            panel.annotate(f"{found.exponent:.2f}", end, color=colour, **beside)
        handles = [
            Line2D(
                [],
                [],
                color=c,
                marker="o",
                ms=4,
                lw=1.2,
                label=in_symbols(f.capability),
            )
            for c, f in zip(COLOURS, fitted[fitted["against"] == against].itertuples(), strict=False)
        ]
        panel.legend(handles=handles, loc="lower center", bbox_to_anchor=(0.5, 1.0))
        panel.margins(x=0.2, y=0.1)
        panel.set(xscale="log", yscale="log", xlabel=against)
        sizes = points.loc[points["against"] == against, "size"]
        if sizes.max() < 1e3 * sizes.min():  # numbers of more decades would touch
            plain_ticks(panel.xaxis, subs=(1,))
        plain_ticks(panel.yaxis, subs=(1, 3))
    for panel in panels[::2]:
        panel.set_ylabel("processor time of a call [ms]")
    return figure
