"""Figure of the recorded light-bulb tests of Mitchell et al. 2021 (Fig. 8)."""

from __future__ import annotations

import matplotlib.pyplot as plt
import pandas as pd
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from repro_live.view.style import page_figure

OURS, EVENT = "#0072B2", "#D55E00"


@page_figure
def light_bulb(curves: pd.DataFrame, events: pd.DataFrame, threshold: float, source: str) -> Figure:
    """Bend angle and ratios over time with the events that were detected, one row per file (Fig. 8).

    Parameters
    ----------
    curves
        Columns ``file, time_s, ratio, baseline, bend_deg, deviation_deg``.
    events
        Columns ``file, start_s, end_s``.
    threshold
        Rise over the baseline that counts.
    source
        Where the files come from; stands in the title.
    """
    files = list(dict.fromkeys(curves["file"]))
    figure, panels = plt.subplots(
        len(files), 2, figsize=(9.6, 1.9 * len(files) + 0.7), sharex=True, squeeze=False
    )
    for (left, right), file in zip(panels, files, strict=True):
        part = curves[curves["file"] == file]
        band = 2.0 * part["deviation_deg"]
        left.fill_between(
            part["time_s"], part["bend_deg"] - band, part["bend_deg"] + band, color=OURS, alpha=0.25, lw=0
        )
        left.plot(part["time_s"], part["bend_deg"], color=OURS, lw=0.7)
        left.axhline(90.0, color="0.6", lw=0.8, ls="--")
        left.set(ylim=(0, 98), yticks=(0, 30, 60, 90))
        right.plot(part["time_s"], part["ratio"], color="black", lw=0.7)
        right.plot(part["time_s"], part["baseline"], color="0.6", lw=1)
        right.plot(part["time_s"], part["baseline"] + threshold, color="0.6", lw=0.8, ls=":")
        for _, event in events[events["file"] == file].iterrows():
            for panel in (left, right):
                panel.axvspan(event["start_s"], event["end_s"], color=EVENT, alpha=0.25, lw=0)
        left.set_title(f"{file}, {source}", loc="left")
        left.set_ylabel("bend [deg]")
        right.set_ylabel("transverse / axial")
    for panel in panels[-1]:
        panel.set_xlabel("time [s]")
    handles = [
        Line2D([], [], color="0.6", lw=1, label="running median"),
        Line2D([], [], color="0.6", lw=0.8, ls=":", label="threshold"),
        Line2D([], [], color=EVENT, lw=6, alpha=0.3, label="event"),
    ]
    figure.legend(handles=handles, loc="outside lower center", ncols=3)
    return figure
