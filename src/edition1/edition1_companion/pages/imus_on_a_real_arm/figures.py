"""Figures of the models of IMUs on the recorded arm: a frame, errors by number, and with errors of the sensors."""

from __future__ import annotations

from collections.abc import Mapping

import matplotlib.pyplot as plt
import numpy as np
import pandas as pd
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from edition1_companion.pages.imus_on_a_real_arm.chains import ARCS, END, INNER, MIDDLE, PCC, RAW, SPLINE
from edition1_live.view.style import WIDTH_IN, page_figure, plain_ticks, wrapped_panels

STYLES = {
    END: ("#D55E00", "s"),
    MIDDLE: ("#E69F00", "^"),
    PCC: ("#0072B2", "o"),
    INNER: ("#CC79A7", "P"),
    ARCS: ("#56B4E9", "v"),
    SPLINE: ("#009E73", "D"),
}
"""Colour and marker of each model."""


@page_figure
def chains_in_a_frame(
    T: Float[np.ndarray, "4 4 4"], chains: Mapping[int, Mapping[str, Float[np.ndarray, "points 3"]]]
) -> Figure:
    """Chains of a frame, seen across the plane of the tip, a panel for each number of IMUs.

    Parameters
    ----------
    T
        Poses of the stations in the base.
    chains
        Points from the base to the tip [m], by number of IMUs and model.
    """
    figure, panels = plt.subplots(1, len(chains), figsize=(WIDTH_IN, 3.9), sharex=True, sharey=True)
    side = T[-1, :2, 3] / np.linalg.norm(T[-1, :2, 3])
    bodies = np.concatenate([np.zeros((1, 3)), T[:, :3, 3]])
    for panel, (n, models) in zip(np.atleast_1d(panels), chains.items(), strict=True):
        for model, points in models.items():
            panel.plot(
                1e3 * points[:, :2] @ side, 1e3 * points[:, 2], color=STYLES[model][0], lw=1.5, label=model
            )
        panel.plot(1e3 * bodies[:, :2] @ side, 1e3 * bodies[:, 2], "ks", ms=5, label="motion capture")
        panel.set(title=f"{n} IMUs", aspect="equal")
        panel.grid(lw=0.4, alpha=0.6)
    first = np.atleast_1d(panels)[0]
    first.set_ylabel("along the base [mm]")
    figure.supxlabel("towards the tip [mm]")
    figure.legend(*first.get_legend_handles_labels(), loc="outside upper center", ncols=2)
    return figure


@page_figure
def errors_by_number(table: pd.DataFrame) -> Figure:
    """Error by number of IMUs and model, a panel for each trial.

    Parameters
    ----------
    table
        Columns ``trial, setting, n_imus, model, error_mm, low_mm, high_mm``.
    """
    recorded = table[table["setting"] == RAW]
    trials = list(dict.fromkeys(recorded["trial"]))
    figure, panels = wrapped_panels(len(trials), 1, 2.4, sharex=True, sharey=True)
    for panel, trial in zip(panels, trials, strict=True):
        _over_numbers(panel, recorded.loc[recorded["trial"] == trial])
        panel.set(title=trial.replace("_", " "), ylabel="error [mm]")
    panels[-1].set_xlabel("IMUs, the base among them")
    _model_legend(figure)
    return figure


@page_figure
def errors_with_sensors(table: pd.DataFrame) -> Figure:
    """Error by the error of the sensors, a panel for each number of IMUs.

    Parameters
    ----------
    table
        Columns ``n_imus, model, sensor_deg, error_mm, low_mm, high_mm``.
    """
    counts = np.unique(table["n_imus"])
    figure, panels = wrapped_panels(len(counts), 1, 2.3, sharex=True, sharey=True)
    for panel, n in zip(panels, counts, strict=True):
        for model, (colour, marker) in STYLES.items():
            part = table[(table["n_imus"] == n) & (table["model"] == model)]
            panel.fill_between(
                part["sensor_deg"], part["low_mm"], part["high_mm"], color=colour, alpha=0.15, lw=0
            )
            panel.plot(part["sensor_deg"], part["error_mm"], f"{marker}-", ms=4, lw=1, color=colour)
        panel.set(yscale="log", title=f"{n} IMUs", ylabel="error [mm]")
        plain_ticks(panel.yaxis, subs=(1, 2, 5))
        panel.grid(axis="y", lw=0.4, alpha=0.6)
    panels[-1].set_xlabel("synthetic error of an IMU about each axis [°]")
    _model_legend(figure)
    return figure


def _over_numbers(panel: Axes, table: pd.DataFrame) -> None:
    counts = np.unique(table["n_imus"])
    for n, (model, (colour, marker)) in enumerate(STYLES.items()):
        part = table[table["model"] == model]
        x = np.arange(len(counts)) + 0.08 * (n - 2.5)
        lines = np.abs(part[["low_mm", "high_mm"]].to_numpy().T - part["error_mm"].to_numpy())
        panel.errorbar(x, part["error_mm"], lines, fmt=marker, ms=4.5, lw=1, color=colour)
    panel.set_yscale("log")
    panel.set_xticks(range(len(counts)), [f"{n:g}" for n in counts])
    plain_ticks(panel.yaxis, subs=(1, 2, 5))
    panel.grid(axis="y", lw=0.4, alpha=0.6)


def _model_legend(figure: Figure) -> None:
    handles = [Line2D([], [], color=c, marker=m, ms=4.5, lw=1, label=name) for name, (c, m) in STYLES.items()]
    figure.legend(handles=handles, loc="outside upper center", ncols=2)
