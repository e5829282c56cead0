"""Figure of the page on sweeps: error by sensors, noise and segments."""

from __future__ import annotations

import matplotlib.pyplot as plt
import numpy as np
import pandas as pd
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import NullFormatter

from edition1_companion.book.formatted import all_digits
from edition1_live.view.style import WIDTH_IN, page_figure

COLOURS = ("#0072B2", "#009E73", "#E69F00", "#D55E00", "#CC79A7", "#56B4E9")
MARKERS = ("o", "s", "^", "D", "v", "P")


@page_figure
def sensors_noise_segments(table: pd.DataFrame) -> Figure:
    """Mean error against sensors per segment: a panel per number of segments, a line per noise.

    Points are means over the draws of the noise. Bars, often smaller than a point, reach from the lowest to the
    highest draw. Dashed is the Cramér-Rao bound, where there is one.

    Parameters
    ----------
    table
        Joined table of a sweep of ``sensor_count.ipynb`` over ``n_segments``, ``n_sensors`` and ``noise_mt``.
    """
    robots, levels = sorted(set(table["n_segments"])), sorted(set(table["noise_mt"]))
    figure, panels = plt.subplots(
        1, len(robots), figsize=(WIDTH_IN, 4.2), sharex=True, sharey=True, squeeze=False
    )
    styles = {noise: (COLOURS[i % 6], MARKERS[i % 6]) for i, noise in enumerate(levels)}
    for panel, n_segments in zip(panels[0], robots, strict=True):
        for noise in levels:
            here = table[(table["n_segments"] == n_segments) & (table["noise_mt"] == noise)]
            lines = here.groupby("n_sensors")[["mean_percent", "bound_percent"]].agg(["mean", "min", "max"])
            mean, low, high = (lines["mean_percent", x].to_numpy() for x in ("mean", "min", "max"))
            bound, (colour, marker) = lines["bound_percent", "min"].to_numpy(), styles[noise]
            panel.errorbar(
                lines.index,
                mean,
                yerr=[mean - low, high - mean],
                fmt=f"{marker}-",
                ms=4,
                lw=1.2,
                capsize=2,
                color=colour,
            )
            finite = np.isfinite(bound)
            panel.plot(lines.index[finite], bound[finite], "--", color="black", lw=1.0, zorder=3)
        panel.set(yscale="log", xticks=sorted(set(table["n_sensors"])))
        panel.set_title(f"{n_segments} segment" + "s" * (n_segments > 1), loc="left")
        panel.yaxis.set_major_formatter("{x:g}")
        panel.yaxis.set_minor_formatter(NullFormatter())
        panel.set_xlabel("sensors on\neach segment")
    panels[0, 0].set_ylabel("mean relative error [%]")
    handles = [
        Line2D([], [], color=c, marker=m, ms=4, lw=1.2, label=f"noise {all_digits(x)} mT")
        for x, (c, m) in styles.items()
    ]
    handles.append(Line2D([], [], color="black", ls="--", lw=1.0, label="Cramér-Rao bound"))
    figure.legend(handles=handles, loc="outside upper center", ncols=2)
    return figure
