"""Figure of magnets and IMUs in one filter: errors, and whether the covariance says so."""

from __future__ import annotations

import matplotlib.pyplot as plt
import numpy as np
import pandas as pd
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from edition1_live.view.style import WIDTH_IN, page_figure, plain_ticks

LOOKS = {
    "magnets": ("#0072B2", "o"),
    "IMUs": ("#D55E00", "s"),
    "both": ("#009E73", "D"),
    "both, inflated": ("#CC79A7", "^"),
}


@page_figure
def errors_and_nees(summary: pd.DataFrame) -> Figure:
    """Error of the tip's orientation at the left, mean NEES of its direction at the right; one row per setting.

    Parameters
    ----------
    summary
        Columns of :func:`edition1_companion.pages.fusion.tables.mean_errors`; the prediction is drawn as a bar.
    """
    settings = list(dict.fromkeys(summary["setting"]))
    names = list(dict.fromkeys(summary["trajectory"]))
    size = (WIDTH_IN, 2.4 * len(settings) + 0.9)
    figure, panels = plt.subplots(len(settings), 2, figsize=size, sharex=True, sharey="col", squeeze=False)
    methods = [method for method in LOOKS if method in set(summary["method"])]
    for (error, nees), setting in zip(panels, settings, strict=True):
        for k, method in enumerate(methods):
            part = summary[(summary["setting"] == setting) & (summary["method"] == method)]
            if part.empty:
                continue
            part = part.set_index("trajectory").loc[names]
            at = np.arange(len(names)) + 0.17 * (k - (len(methods) - 1) / 2)
            colour, marker = LOOKS[method]
            error.plot(at, part["orientation_deg"], marker, color=colour, ms=5)
            error.plot(at, part["predicted_orientation_deg"], "_", color=colour, ms=9, mew=1.5)
            nees.plot(at, part["nees_direction"], marker, color=colour, ms=5)
        band = summary[["low_direction", "high_direction"]].iloc[0]
        nees.axhspan(*band, color="0.85", lw=0)
        error.set_title(setting, loc="left")
        for panel, label in (
            (error, "error of the\norientation [deg]"),
            (nees, "mean NEES\nof the direction"),
        ):
            panel.set(yscale="log", ylabel=label)
            plain_ticks(panel.yaxis, subs=(1,))
            panel.set_xticks(range(len(names)), [name.replace(" ", "\n", 1) for name in names])
    handles = [Line2D([], [], color=LOOKS[m][0], marker=LOOKS[m][1], ms=5, ls="", label=m) for m in methods]
    handles.append(Line2D([], [], color="0.3", marker="_", ms=9, mew=1.5, ls="", label="predicted"))
    handles.append(Line2D([], [], color="0.85", lw=7, label="95 % band"))
    figure.legend(handles=handles, loc="outside upper center", ncols=3)
    return figure
