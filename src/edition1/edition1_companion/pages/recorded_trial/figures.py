"""Figures of the recorded trial: chains beside the released tables, settings of Fig. 5, models with fewer IMUs."""

from __future__ import annotations

import matplotlib.pyplot as plt
import numpy as np
import pandas as pd
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from edition1_live.view.style import WIDTH_IN, page_figure, plain_ticks

STYLES = {
    "rigid-body": ("#D55E00", "s"),
    "PCC-extended, 16 segments": ("#0072B2", "o"),
    "spline": ("#009E73", "D"),
}
"""Colour and marker of each model."""


CHAINS = {
    "as described": ("#0072B2", "o"),
    "base turned, at the markers": ("#E69F00", "s"),
    "base upright, points of the file": ("#009E73", "^"),
    "as in the file": ("#D55E00", "D"),
}
"""Colour and marker of each setting of the chains of Fig. 5."""


@page_figure
def differences_of_files(files: pd.DataFrame, source: str) -> Figure:
    """Median and largest distance between each released table and its chain, on a logarithmic scale.

    Parameters
    ----------
    files
        Columns ``file, median_um, largest_um``.
    source
        "recorded" or "synthetic"; stands in the title.
    """
    figure, panel = plt.subplots(figsize=(WIDTH_IN, 1.0 + 0.35 * len(files)))
    rows = np.arange(len(files))
    panel.hlines(rows, files["median_um"], files["largest_um"], color="#0072B2", lw=1.5)
    panel.plot(files["median_um"], rows, "o", color="#0072B2", label="median")
    panel.plot(files["largest_um"], rows, "^", color="#D55E00", label="largest")
    panel.axvline(1.0, color="0.3", ls="--", lw=1.0, label="a millionth of a metre")
    panel.set_yticks(rows, [str(name).rsplit("/", 1)[-1] for name in files["file"]])
    panel.set(
        xscale="log",
        xlabel="distance from the chain of this library [µm]",
        title=f"{'Released tables' if source == 'recorded' else 'Tables of the trial'}, {source}",
    )
    panel.set(ylim=(len(files) - 0.5, -0.5), xlim=(1e-3, None))
    plain_ticks(panel.xaxis, subs=(1,))
    figure.legend(loc="outside lower center", ncols=3)
    return figure


@page_figure
def settings_of_figure_5(table: pd.DataFrame, source: str) -> Figure:
    """Distance of the chains of Fig. 5 from the spline, by setting, beside the printed errors: medians, lines to Q3.

    Parameters
    ----------
    table
        Columns ``n_imus, chain, marker, median_mm, q75_mm, printed_median_mm, printed_q75_mm``.
    source
        "recorded" or "synthetic"; stands in the titles.
    """
    counts = np.unique(table["n_imus"])
    figure, panels = plt.subplots(1, 2, figsize=(WIDTH_IN, 4.2), sharey=True)
    for panel, (marker, part) in zip(panels, table.groupby("marker"), strict=True):
        for k, (name, (colour, shape)) in enumerate(CHAINS.items()):
            own = part[part["chain"] == name]
            x = np.searchsorted(counts, own["n_imus"]) + 0.15 * (k - 2)
            panel.vlines(x, own["median_mm"], own["q75_mm"], color=colour, lw=1.5)
            panel.plot(x, own["median_mm"], shape, color=colour, ms=5)
        printed = part.drop_duplicates("n_imus")
        x = np.searchsorted(counts, printed["n_imus"]) + 0.3
        panel.vlines(x, printed["printed_median_mm"], printed["printed_q75_mm"], color="black", lw=1.5)
        panel.plot(x, printed["printed_median_mm"], "_", color="black", ms=10)
        panel.set_xticks(range(len(counts)), [f"{n:g}" for n in counts])
        panel.set(title=f"{marker}, {source}", xlabel="IMUs", xlim=(-0.5, len(counts) - 0.5))
        panel.grid(axis="x", visible=False)
    panels[0].set(ylim=(0, None), ylabel="distance from the spline [mm]\n(dash: printed error)")
    handles = [Line2D([], [], color=c, marker=m, ls="none", label=n) for n, (c, m) in CHAINS.items()]
    handles.append(Line2D([], [], color="black", marker="_", ls="none", ms=10, label="printed, Fig. 5"))
    figure.legend(handles=handles, loc="outside upper center", ncols=2)
    return figure


@page_figure
def fewer_imus(table: pd.DataFrame, source: str) -> Figure:
    """Distance from the model with all IMUs: medians, and lines up to Q3, one panel per point.

    Parameters
    ----------
    table
        Columns ``model, n_imus, point_mm, median_mm, q75_mm``.
    source
        "recorded" or "synthetic"; stands in the title.
    """
    points, counts = np.unique(table["point_mm"]), np.unique(table["n_imus"])
    size = (WIDTH_IN, 3.8)
    figure, panels = plt.subplots(1, len(points), figsize=size, sharey=True, squeeze=False)
    for panel, point in zip(panels[0], points, strict=True):
        for k, (model, (colour, marker)) in enumerate(STYLES.items()):
            part = table[(table["model"] == model) & (table["point_mm"] == point)]
            x = np.searchsorted(counts, part["n_imus"]) + 0.2 * (k - 1)
            panel.vlines(x, part["median_mm"], part["q75_mm"], color=colour, lw=1.5)
            panel.plot(x, part["median_mm"], marker, color=colour, ms=5)
        panel.set_xticks(range(len(counts)), [f"{n:g}" for n in counts])
        panel.set(title=f"at {point:.0f} mm,\n{source}", xlabel="IMUs", xlim=(-0.5, len(counts) - 0.5))
        panel.grid(axis="x", visible=False)
    panels[0, 0].set(ylim=(0, None), ylabel="distance from the spline,\n8 IMUs [mm]")
    handles = [Line2D([], [], color=c, marker=k, ls="none", label=m) for m, (c, k) in STYLES.items()]
    handles.append(Line2D([], [], color="0.3", label="from the median to Q3"))
    figure.legend(handles=handles, loc="outside upper center", ncols=2)
    return figure
