"""Figures of the digital twin of the rig: actuation, hysteresis, readings; all data are synthetic."""

from __future__ import annotations

import matplotlib.pyplot as plt
import pandas as pd
from edition1_live.view.style import WIDTH_IN, page_figure
from matplotlib.figure import Figure

SENSOR_COLOURS = ("#0072B2", "#D55E00", "#009E73")
CHAMBER_COLOURS = ("#000000", "#56B4E9", "#E69F00")


@page_figure
def actuation(table: pd.DataFrame, *, pressure_s: float = 20.0) -> Figure:
    """Path of the tip's bend, and beside it the pressures of the three chambers, for each sequence.

    Parameters
    ----------
    table
        Columns of ``actuation_table``: ``recording, time_s, delta_x_mm, delta_y_mm, pressure_1_mbar`` and so on.
    pressure_s
        How much of the pressures is drawn [s].
    """
    names = list(dict.fromkeys(table["recording"]))
    figure, panels = plt.subplots(
        len(names), 2, figsize=(WIDTH_IN, 2.0 * len(names) + 0.6), width_ratios=(1, 1.8), squeeze=False
    )
    reach = 1.08 * float(table[["delta_x_mm", "delta_y_mm"]].abs().to_numpy().max())
    for k, name in enumerate(names):
        part = table[table["recording"] == name]
        path, pressure = panels[k]
        path.plot(part["delta_x_mm"], part["delta_y_mm"], color="#0072B2", linewidth=0.7)
        path.set(
            title=name,
            xlim=(-reach, reach),
            ylim=(-reach, reach),
            aspect="equal",
            xticks=(-8, 0, 8),
            yticks=(-8, 0, 8),
        )
        shown = part[part["time_s"] <= pressure_s]
        for i, colour in enumerate(CHAMBER_COLOURS, start=1):
            label = f"chamber {i}" if k == 0 else None
            pressure.plot(
                shown["time_s"], shown[f"pressure_{i}_mbar"], color=colour, linewidth=1, label=label
            )
        pressure.set(ylim=(-10, 470), yticks=(0, 225, 450), xlim=(0, pressure_s))
        path.set_ylabel(r"$\Delta_y$ [mm]")
        pressure.set_ylabel("pressure [mbar]")
    panels[-1, 0].set_xlabel(r"$\Delta_x$ [mm]")
    panels[-1, 1].set_xlabel("time [s]")
    figure.legend(loc="outside lower center", ncols=3)
    figure.suptitle("Actuation and bend of the tip, synthetic")
    return figure


@page_figure
def hysteresis_loops(actuated: pd.DataFrame, differences: pd.DataFrame) -> Figure:
    """Bend against torque, and what the readings of sensor 1 differ from T5's quadratic map.

    Parameters
    ----------
    actuated
        Columns of ``actuation_table``; T5 and T3 are drawn.
    differences
        Columns of ``differences_table``, with the same recordings.
    """
    figure, (bend, reading) = plt.subplots(2, 1, figsize=(WIDTH_IN, 6.0))
    for name, colour in (("T5", "0.6"), ("T3", "#D55E00")):
        part = actuated[(actuated["recording"] == name) & (actuated["time_s"] <= 60.0)]
        bend.plot(part["torque_x"], part["delta_x_mm"], color=colour, linewidth=0.9, label=name)
        apart = differences[differences["recording"] == name]
        reading.plot(apart["time_s"], apart["u_1_mV"], color=colour, linewidth=0.9, label=name)
    bend.set(
        xlabel="torque along x / its reference",
        ylabel=r"bend $\Delta_x$ [mm]",
        title="Bend and torque, synthetic",
    )
    reading.axhline(0, color="black", linewidth=0.8)
    reading.set(
        xlabel="time [s]", ylabel="difference [mV]", title="Sensor 1 less T5's quadratic map, synthetic"
    )
    bend.set_xticks([-0.8, -0.4, 0.0, 0.4, 0.8])
    bend.legend(loc="upper left")
    return figure


@page_figure
def readings_over_time(table: pd.DataFrame, names: tuple[str, ...] = ("T5", "T3")) -> Figure:
    """Readings of the three sensors, each less its mean, and the bend, for some recordings.

    Parameters
    ----------
    table
        Columns of ``readings_table``.
    names
        Recordings drawn, one column each.
    """
    figure, panels = plt.subplots(
        2, len(names), figsize=(WIDTH_IN, 4.4), sharex="col", sharey="row", squeeze=False
    )
    for k, name in enumerate(names):
        part = table[table["recording"] == name]
        sensors, bend = panels[:, k]
        for j, colour in enumerate(SENSOR_COLOURS, start=1):
            u = part[f"u_{j}_mV"]
            sensors.plot(part["time_s"], u - u.mean(), color=colour, linewidth=0.8, label=f"sensor {j}")
        for axis, colour in (("x", "#CC79A7"), ("y", "black")):
            label = rf"$\Delta_{axis}$"
            bend.plot(part["time_s"], part[f"delta_{axis}_mm"], color=colour, linewidth=1, label=label)
        sensors.set_title(f"{name}, synthetic")
        bend.set_xlabel("time [s]")
    panels[0, 0].set_ylabel("reading less\nits mean [mV]")
    panels[1, 0].set_ylabel("bend [mm]")
    lines = [line for panel in panels[:, 0] for line in panel.get_lines()]
    figure.legend(handles=lines, loc="outside lower center", ncols=len(lines))
    return figure
