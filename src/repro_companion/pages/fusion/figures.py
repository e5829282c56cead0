"""Figure of magnets and IMUs in one filter: errors, and whether the covariance says so."""

from __future__ import annotations

import matplotlib.pyplot as plt
import numpy as np
import pandas as pd
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from repro_live.view.style import page_figure

LOOKS = {
    "magnets": ("#0072B2", "o"),
    "IMUs": ("#D55E00", "s"),
    "both": ("#009E73", "D"),
    "both, inflated": ("#CC79A7", "^"),
}


@page_figure
def errors_and_nees(summary: pd.DataFrame) -> Figure:
    """Error of the tip's orientation above, mean NEES of its direction below; one column per setting.

    Parameters
    ----------
    summary
        Columns of :func:`repro_companion.pages.fusion.tables.mean_errors`; the prediction is drawn as a bar.
    """
    settings = list(dict.fromkeys(summary["setting"]))
    names = list(dict.fromkeys(summary["trajectory"]))
    size = (2.7 * len(settings) + 1.2, 5.2)
    figure, panels = plt.subplots(2, len(settings), figsize=size, sharex=True, sharey="row", squeeze=False)
    methods = [method for method in LOOKS if method in set(summary["method"])]
    for column, setting in enumerate(settings):
        above, below = panels[:, column]
        for k, method in enumerate(methods):
            part = summary[(summary["setting"] == setting) & (summary["method"] == method)]
            if part.empty:
                continue
            part = part.set_index("trajectory").loc[names]
            at = np.arange(len(names)) + 0.17 * (k - (len(methods) - 1) / 2)
            colour, marker = LOOKS[method]
            above.plot(at, part["orientation_deg"], marker, color=colour, ms=5)
            above.plot(at, part["predicted_orientation_deg"], "_", color=colour, ms=9, mew=1.5)
            below.plot(at, part["nees_direction"], marker, color=colour, ms=5)
        band = summary[["low_direction", "high_direction"]].iloc[0]
        below.axhspan(*band, color="0.85", lw=0)
        above.set_title(setting, loc="left")
        above.set_yscale("log")
        below.set_yscale("log")
        below.set_xticks(range(len(names)), [name.replace(" ", "\n", 1) for name in names], fontsize="small")
    panels[0, 0].set_ylabel("error of the orientation [deg]")
    panels[1, 0].set_ylabel("mean NEES of the direction")
    handles = [Line2D([], [], color=LOOKS[m][0], marker=LOOKS[m][1], ms=5, ls="", label=m) for m in methods]
    handles.append(Line2D([], [], color="0.3", marker="_", ms=9, mew=1.5, ls="", label="predicted"))
    handles.append(Line2D([], [], color="0.85", lw=7, label="95 % band"))
    figure.legend(handles=handles, loc="outside upper center", ncols=len(handles))
    return figure
