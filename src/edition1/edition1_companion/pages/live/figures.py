"""Figures of the live page: where the time goes, estimates with their uncertainty, and a sensor that fails."""

from __future__ import annotations

import matplotlib.pyplot as plt
import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from edition1_live.view.style import WIDTH_IN, page_figure, plain_ticks
from edition1_live.view.symbols import coordinate_symbol

COLOURS = ("#0072B2", "#E69F00", "#009E73", "#CC79A7")
TRUTH, ESTIMATE = "black", "#D55E00"
TARGET_MS = 5.0
"""From the last byte to the estimate, at the 99th percentile [ms]."""
BINS = 60
MEDIAN_S = 0.2
"""Width of the running median of errors [s]: single ones would hide each other."""


@page_figure
def latency(latencies: pd.DataFrame) -> Figure:
    """Histograms of the time from the last byte to the estimate: of each stage, and of all together.

    Parameters
    ----------
    latencies
        One row per estimate: ``line_ms, parse_ms, queue_ms, estimate_ms, total_ms``.
    """
    figure, (left, right) = plt.subplots(2, 1, figsize=(WIDTH_IN, 5.2), sharex=True)
    values = latencies.clip(lower=1e-3)
    edges = np.geomspace(values.min().min() / 1.1, max(values.max().max(), TARGET_MS) * 1.3, BINS + 1)
    stages = [name for name in latencies if name != "total_ms"]
    for colour, name in zip(COLOURS, stages, strict=True):
        left.hist(values[name], edges, histtype="step", lw=1.6, color=colour, label=name.removesuffix("_ms"))
    left.set_title("stages")
    left.legend(loc="center left", bbox_to_anchor=(1.0, 0.5))
    right.hist(values["total_ms"], edges, color="0.7")
    for share, style in ((0.5, "-"), (0.99, "--")):
        at = latencies["total_ms"].quantile(share)
        right.axvline(at, color=TRUTH, ls=style, label=f"{100 * share:.0f} % within {at:.2f} ms")
    right.axvline(TARGET_MS, color=ESTIMATE, ls=":", label=f"target: 99 % within {TARGET_MS:g} ms")
    right.set_title("from the last byte to the estimate")
    right.legend(loc="upper center", bbox_to_anchor=(0.5, -0.28))
    for panel in (left, right):
        panel.set_xscale("log")
        panel.set_ylabel("time steps")
    plain_ticks(right.xaxis, subs=(1,))
    right.set_xlabel("time [ms]")
    return figure


@page_figure
def estimates(table: pd.DataFrame) -> Figure:
    """Coordinates with the truth, and beside them their errors with a band of two standard deviations.

    Parameters
    ----------
    table
        Columns ``time_s`` and, for each coordinate, such as ``delta_x_1_mm, delta_x_1_true_mm, delta_x_1_std_mm``.
    """
    names = [name.replace("_true_", "_") for name in table if "_true_" in name]
    figure, panels = plt.subplots(
        len(names), 2, figsize=(WIDTH_IN, 2.1 * len(names) + 0.6), sharex=True, squeeze=False
    )
    time_s = table["time_s"]
    for (left, right), name in zip(panels, names, strict=True):
        coordinate, unit = name.rsplit("_", 1)
        truth, std = table[f"{coordinate}_true_{unit}"], table[f"{coordinate}_std_{unit}"]
        left.plot(time_s, truth, color=TRUTH, lw=3.4, alpha=0.4, label="truth")
        left.plot(time_s, table[name], color=ESTIMATE, ls=(0, (4, 2)), lw=1.3, label="estimate")
        left.set_ylabel(f"{coordinate_symbol(coordinate)} [{unit}]")
        if bool(std.notna().all()):
            right.fill_between(time_s, -2 * std, 2 * std, color="#56B4E9", alpha=0.45, lw=0, label="± 2 std")
        right.plot(time_s, table[name] - truth, ".", ms=2, color=ESTIMATE, label="error")
        right.set_ylabel(f"its error [{unit}]")
    for panel, scale in zip(panels[0], (1, 4), strict=True):
        panel.legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=2, markerscale=scale)
    for panel in panels[-1]:
        panel.set_xlabel("time [s]")
    return figure


@page_figure
def failures(table: pd.DataFrame, at_s: float) -> Figure:
    """Error of the tip, and the standard deviation that the estimator states, when a sensor fails: running medians.

    Parameters
    ----------
    table
        Columns ``sensors, failure, time_s, tip_error_mm, tip_std_mm``.
    at_s
        When it fails [s].
    """
    counts, kinds = table["sensors"].unique(), table["failure"].unique()
    figure, panels = plt.subplots(
        2, len(counts), figsize=(WIDTH_IN, 5.4), sharex=True, sharey=True, squeeze=False
    )
    columns = {"tip_error_mm": "error of the tip [mm]", "tip_std_mm": "stated deviation [mm]"}
    steps = max(1, round(MEDIAN_S / np.median(np.diff(np.unique(table["time_s"])))))
    for column, n in zip(panels.T, counts, strict=True):
        column[0].set_title(f"{n} sensors")
        for panel, name in zip(column, columns, strict=True):
            for k, kind in enumerate(kinds):
                part = table[(table["sensors"] == n) & (table["failure"] == kind)]
                panel.plot(
                    part["time_s"],
                    part[name].rolling(steps, center=True, min_periods=1).median(),
                    color=COLOURS[k],
                    ls=("-", "--", ":", "-.")[k],
                    lw=1.4,
                    label=kind,
                )
            panel.axvline(at_s, color="0.6", lw=0.8)
            panel.set_yscale("log")
            plain_ticks(panel.yaxis, subs=(1,))
        column[-1].set_xlabel("time [s]")
    for panel, label in zip(panels[:, 0], columns.values(), strict=True):
        panel.set_ylabel(label)
    figure.legend(
        *panels[0, 0].get_legend_handles_labels(),
        loc="outside lower center",
        title="failure of sensor 1",
        ncols=4,
    )
    return figure
