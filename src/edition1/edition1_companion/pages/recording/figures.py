"""Figures of the recording page: a signal with interruptions and what was counted, and what a flipped digit does."""

from __future__ import annotations

import matplotlib.pyplot as plt
import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from edition1_live.view.style import WIDTH_IN, page_figure

COLOURS = ("#0072B2", "#009E73", "#CC79A7")
WRONG = "#D55E00"
COUNTED = {
    "gaps": "missing by sequence number",
    "checksum_errors": "wrong checksum",
    "restarts": "restarts of the board",
    "reconnects": "reconnects",
}
"""Counters that are drawn."""
INTERRUPTED_S = 0.5
"""Silence longer than this is marked [s]."""


@page_figure
def interruptions(recorded: pd.DataFrame, counters: pd.DataFrame) -> Figure:
    """Readings, the board's clock, and the counters, over the time at which frames were sent; silences are shaded.

    Parameters
    ----------
    recorded, counters
        From ``trace_tables``: ``time_s, device_s, u_…`` and ``time_s, gaps, checksum_errors, restarts, reconnects``.
    """
    figure, panels = plt.subplots(3, 1, figsize=(WIDTH_IN, 7.6), sharex=True, height_ratios=(1.3, 1.0, 1.2))
    recorded = _broken(recorded[recorded["time_s"].notna()])
    names = [name for name in recorded if name.startswith("u_")]
    for j, (colour, name) in enumerate(zip(COLOURS, names, strict=False)):
        panels[0].plot(recorded["time_s"], recorded[name], color=colour, label=f"sensor {j + 1}")
    panels[0].set_ylabel("reading [mT]")
    panels[1].plot(recorded["time_s"], recorded["device_s"], color="0.2")
    panels[1].set_ylabel("clock of the board [s]")
    looks = (
        {"ls": "-"},
        {"ls": "--"},
        {"lw": 5.0, "alpha": 0.5},
        {"ls": "-."},
    )  # equal counts lie on each other
    for colour, look, (name, label) in zip((*COLOURS, WRONG), looks, COUNTED.items(), strict=True):
        panels[2].step(counters["time_s"], counters[name], where="post", color=colour, label=label, **look)
    most = max(1.0, counters[list(COUNTED)].to_numpy().max())
    panels[2].set_yscale("symlog", linthresh=1.0)
    panels[2].set_yticks([0, *10 ** np.arange(np.ceil(np.log10(most)) + 1)])
    panels[2].yaxis.set_major_formatter("{x:g}")
    panels[2].set_ylim(-0.1, 5.0 * most)
    panels[2].set_ylabel("counted so far")
    panels[2].set_xlabel("time of sending [s]")
    panels[0].legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=3)
    panels[2].legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=2)
    times = recorded.loc[recorded["device_s"].notna(), "time_s"].to_numpy()
    for at in np.flatnonzero(np.diff(times) > INTERRUPTED_S):
        for panel in panels:
            panel.axvspan(times[at], times[at + 1], color="0.85", lw=0)
    return figure


@page_figure
def flipped_digits(series: pd.DataFrame) -> Figure:
    """Readings of one sensor as recorded in each format; those that were never sent are marked.

    Parameters
    ----------
    series
        Columns ``format, index, u_1_mV, wrong``.
    """
    formats = list(dict.fromkeys(series["format"]))
    figure, panels = plt.subplots(
        1, len(formats), figsize=(WIDTH_IN, 3.4), sharex=True, sharey=True, squeeze=False
    )
    for panel, format in zip(panels[0], formats, strict=True):
        part = series[series["format"] == format]
        right, wrong = part[~part["wrong"]], part[part["wrong"]]
        panel.plot(right["index"], right["u_1_mV"], ".", ms=2, color=COLOURS[0], label="as sent")
        panel.plot(wrong["index"], wrong["u_1_mV"], "o", mfc="none", ms=6, color=WRONG, label="never sent")
        panel.set_title(f"{format}:\n{len(wrong)} of {len(part)} wrong")
        panel.set_xlabel("number of the reading")
    panels[0, 0].set_ylabel("reading of sensor 1 [mV]")
    figure.legend(
        *panels[0, 0].get_legend_handles_labels(), loc="outside lower center", ncols=2, markerscale=2
    )
    return figure


def _broken(table: pd.DataFrame) -> pd.DataFrame:
    """Put an empty row into every silence, so that no line crosses it."""
    silent = np.flatnonzero(np.diff(table["time_s"].to_numpy()) > INTERRUPTED_S)
    middle = [float(table["time_s"].iloc[k : k + 2].mean()) for k in silent]
    rows = pd.DataFrame({"time_s": middle}).reindex(columns=table.columns)
    whole = pd.concat([table.astype(float), rows.astype(float)]) if len(rows) else table
    return whole.sort_values("time_s").reset_index(drop=True)
