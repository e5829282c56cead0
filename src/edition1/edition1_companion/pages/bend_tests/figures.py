"""Figures of the recorded bend tests of Mitchell et al. 2021 (Fig. 9)."""

from __future__ import annotations

import matplotlib.pyplot as plt
import numpy as np
import pandas as pd
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from edition1_companion.twins.bend_tests import take_in_words
from edition1_live.view.style import WIDTH_IN, page_figure

OURS, PRINTED, RELEASED, LOGGED = "#0072B2", "#CC79A7", "#D55E00", "#009E73"
STYLES = {
    "capture, y axis": {"color": "black", "lw": 1.8},
    "capture, z axis": {"color": "0.5", "lw": 1.4, "ls": "--"},
    "paper, as printed": {"color": PRINTED, "lw": 1.0},
    "paper, as released": {"color": RELEASED, "lw": 1.0},
    "authors' output": {"color": LOGGED, "lw": 1.2, "ls": ":"},
    "ours": {"color": OURS, "lw": 1.2},
}


@page_figure
def peaks(table: pd.DataFrame, source: str) -> Figure:
    """Largest bend of each take by both readings of motion capture and by the sensor, and the sensor's direction.

    Parameters
    ----------
    table
        Columns ``take, peak_tilt_y_deg, peak_tilt_z_deg, peak_hall_deg, direction_deg, turned_deg``.
    source
        Where the takes come from; stands in the title.
    """
    figure, (left, right) = plt.subplots(2, 1, figsize=(WIDTH_IN, 6.0))
    x = np.arange(len(table))
    left.plot(x, table["peak_tilt_y_deg"], "o", color="black", label="capture, tilt of y")
    left.plot(x, table["peak_tilt_z_deg"], "D", mfc="none", color="0.45", label="capture, tilt of z")
    left.plot(x, table["peak_hall_deg"], "s", color=OURS, label="sensor as drawn")
    left.set_xticks(x, [_short(name) for name in table["take"]])
    left.set(xlabel="test, try", ylabel="largest bend [deg]", title=f"Largest bend, {source}", ylim=(0, None))
    left.legend(loc="lower center", bbox_to_anchor=(0.5, 1.1), ncols=3)
    right.plot(table["direction_deg"], table["turned_deg"], "o", color=OURS)
    right.set(
        xlabel="captured azimuth at the peak [deg]",
        ylabel="sensor's direction\nless azimuth [deg]",
        title=f"Direction by the y axis, {source}",
        xlim=(-190, 190),
        ylim=(-180, 180),
        xticks=range(-180, 181, 90),
        yticks=range(-180, 181, 90),
    )
    return figure


@page_figure
def gain(table: pd.DataFrame, take: str, source: str) -> Figure:
    """Field along the body over time, as sent and over the gain that is inferred.

    Parameters
    ----------
    table
        Columns ``time_s, sent_mt, over_gain_mt``.
    take, source
        Name and origin of the take; stand in the title.
    """
    figure, panel = plt.subplots(figsize=(WIDTH_IN, 3.0))
    panel.plot(table["time_s"], table["sent_mt"], color=RELEASED, lw=1, label="as sent")
    panel.plot(table["time_s"], table["over_gain_mt"], color=OURS, lw=1, label="over the inferred gain")
    panel.set(xlabel="time [s]", ylabel="axial field [mT]")
    figure.suptitle(f"Field along the body, {take_in_words(take)}, {source}")
    figure.legend(loc="outside lower center", ncols=2)
    return figure


@page_figure
def bend_over_time(table: pd.DataFrame, calibration: str, source: str) -> Figure:
    """Bend angle (top) and direction (bottom) over time, one column per take: motion capture and estimators (Fig. 9).

    Parameters
    ----------
    table
        Columns ``take, method, calibration, time_s, bend_deg, direction_deg, deviation_deg``.
    calibration
        Which calibration of ours is drawn, with a band of two of its deviations.
    source
        Where the takes come from; stands in the titles.
    """
    takes = list(dict.fromkeys(table["take"]))
    figure, panels = plt.subplots(
        2,
        len(takes),
        figsize=(WIDTH_IN, 5.8),
        sharex="col",
        sharey="row",
        squeeze=False,
        height_ratios=(1.5, 1),
    )
    shown: dict[str, Line2D] = {}
    for column, take in enumerate(takes):
        part = table[table["take"] == take]
        for method, style in STYLES.items():
            chosen = calibration if method == "ours" else "none"
            line = part[(part["method"] == method) & (part["calibration"] == chosen)]
            if line.empty:
                continue
            for panel, name in zip(panels[:, column], ("bend_deg", "direction_deg"), strict=True):
                if name == "direction_deg" and method == "capture, z axis":
                    continue
                (shown[method],) = panel.plot(line["time_s"], line[name], **style)
            if method == "ours":
                band = 2.0 * line["deviation_deg"]
                low = (line["bend_deg"] - band).clip(lower=0)
                panels[0, column].fill_between(
                    line["time_s"], low, line["bend_deg"] + band, color=OURS, alpha=0.2, lw=0
                )
        panels[0, column].set_title(f"{take_in_words(take)},\n{source}".capitalize())
        panels[1, column].set(xlabel="time [s]", ylim=(-30, 30))
    panels[0, 0].set(ylabel="bend angle [deg]", ylim=(0, None))
    panels[1, 0].set_ylabel("direction less its mean [deg]")
    labels = [f"least squares ({calibration})" if name == "ours" else name for name in shown]
    figure.legend(list(shown.values()), labels, loc="outside lower center", ncols=3)
    return figure


@page_figure
def errors_by_take(table: pd.DataFrame, length_mm: float, source: str) -> Figure:
    """Error of the bend angle per take against both readings of motion capture, one row per method.

    Parameters
    ----------
    table
        Columns ``method, calibration, length_mm, take, rmse_deg, rmse_tilt_z_deg``.
    length_mm
        Arc length that is drawn [mm].
    source
        Where the takes come from; stands in the title.
    """
    panels = {"rmse_deg": "tilt of the y axis", "rmse_tilt_z_deg": "tilt of the z axis"}
    return _rows_of_methods(table, length_mm, panels, source)


@page_figure
def errors_by_bend(table: pd.DataFrame, length_mm: float, source: str) -> Figure:
    """Error of the bend angle per take against the tilt of the y axis, by that tilt, one row per method.

    Parameters
    ----------
    table
        Columns ``method, calibration, length_mm, take, rmse_below_20_deg, rmse_20_to_40_deg, rmse_above_40_deg``.
    length_mm
        Arc length that is drawn [mm].
    source
        Where the takes come from; stands in the title.
    """
    panels = {
        "rmse_below_20_deg": "below 20°",
        "rmse_20_to_40_deg": "20 to 40°",
        "rmse_above_40_deg": "above 40°",
    }
    return _rows_of_methods(table, length_mm, panels, f"bends of {source} takes")


def _rows_of_methods(table: pd.DataFrame, length_mm: float, titles: dict[str, str], above: str) -> Figure:
    """Draw one panel per column, in it one row per method with a dot per take and the median."""
    drawn = table[(table["length_mm"] == length_mm) | table["length_mm"].isna()]
    names = list(dict.fromkeys(zip(drawn["method"], drawn["calibration"], strict=True)))
    names.sort(key=lambda name: (name[0] == "ours", name[0]))
    figure, panels = plt.subplots(
        1, len(titles), figsize=(WIDTH_IN, 0.42 * len(names) + 1.7), sharey=True, sharex=True, squeeze=True
    )
    for panel, (column, title) in zip(panels, titles.items(), strict=True):
        for row, (method, calibration) in enumerate(reversed(names)):
            part = drawn[(drawn["method"] == method) & (drawn["calibration"] == calibration)]
            colour = STYLES[method]["color"]
            panel.plot(part[column], np.full(len(part), row), "o", color=colour, ms=5)
            panel.plot(part[column].median(), row, "|", color=colour, ms=14, mew=2)
        panel.axvline(2.0, color="0.6", lw=0.8, ls="--")
        panel.set(xlabel="RMSE [deg]", title=title)
    labels = [
        method if method != "ours" else f"least squares:\n{calibration.replace('none', 'not calibrated')}"
        for method, calibration in reversed(names)
    ]
    panels[0].set_yticks(range(len(names)), labels)
    largest = float(np.nanmax(drawn[list(titles)].to_numpy()))
    panels[0].set(ylim=(-0.6, len(names) - 0.4), xlim=(0, 1.05 * largest))
    handles = [
        Line2D([], [], color="0.3", marker="o", ls="none", label="take"),
        Line2D([], [], color="0.3", marker="|", ms=12, mew=2, ls="none", label="median"),
    ]
    figure.suptitle(f"Error of the bend angle, {above}")
    figure.legend(handles=handles, loc="outside lower center", ncols=2)
    return figure


def _short(name: str) -> str:
    """Numbers of test and try from a take's name."""
    return name.removeprefix("bend_").replace("_try_", ", ")
