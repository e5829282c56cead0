"""Figures of the page on intervals: how often bands hold by recording, and the band on a fast motion."""

from __future__ import annotations

import matplotlib.pyplot as plt
import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from edition1_live.view.style import WIDTH_IN, page_figure

STYLES = {
    "gaussian": ("#D55E00", "s", "Gaussian, as stated"),
    "split": ("#E69F00", "v", "split"),
    "weighted": ("#CC79A7", "^", "split, weighted"),
    "conformal": ("#0072B2", "o", "conformal"),
    "adaptive": ("#009E73", "D", "adaptive, told the truth later"),
}
"""Colour, marker and words of each method."""


@page_figure
def coverage(table: pd.DataFrame, level: float) -> Figure:
    """How often the bands of each method hold, a row for each recording.

    Parameters
    ----------
    table
        Columns ``recording, method, coverage_percent, coverage_low_percent, coverage_high_percent``.
    level
        How often they are to hold.
    """
    names = list(dict.fromkeys(table["recording"]))
    figure, panel = plt.subplots(figsize=(WIDTH_IN, 1.6 + 0.27 * len(names)))
    for method, (colour, marker, words) in STYLES.items():
        part = table[table["method"] == method].set_index("recording")
        rows = np.array([names.index(name) for name in part.index])
        panel.plot(part["coverage_percent"], rows, marker, color=colour, ms=5, label=words)
        if method == "conformal":
            ends = (part["coverage_low_percent"], part["coverage_high_percent"])
            panel.hlines(rows, *ends, color=colour, lw=1.4)
    panel.axvline(100 * level, color="k", lw=0.9, ls="--")
    panel.set(xlabel="truths in the band [%]", xlim=(-3, 103))
    panel.set_yticks(range(len(names)), names)
    panel.invert_yaxis()
    panel.grid(lw=0.4, alpha=0.6)
    figure.legend(loc="outside upper center", ncols=2)
    return figure


@page_figure
def bands_over_time(table: pd.DataFrame) -> Figure:
    """Error and the radius of its bands over time.

    Parameters
    ----------
    table
        Columns ``time_s, error_mm, gaussian_mm, conformal_mm``.
    """
    figure, panel = plt.subplots(figsize=(WIDTH_IN, 3.0))
    panel.fill_between(table["time_s"], table["error_mm"], color="k", alpha=0.25, lw=0, label="error")
    for method in ("gaussian", "conformal"):
        colour, _, words = STYLES[method]
        panel.plot(table["time_s"], table[f"{method}_mm"], color=colour, lw=1.6, label=f"band, {words}")
    panel.set(xlabel="time [s]", ylabel="error, radius of the band [mm]", ylim=(0, None))
    panel.grid(lw=0.4, alpha=0.6)
    figure.legend(loc="outside upper center", ncols=3)
    return figure
