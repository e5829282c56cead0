"""Figure of a judged recording: coordinates, tip error and residual over time."""

from __future__ import annotations

import matplotlib.pyplot as plt
import numpy as np
import torch
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from repro_live.own.fit import Fit
from repro_live.own.judge import Tracked, tip_positions
from repro_live.robot.calibration_poses import coordinate_columns
from repro_live.view.style import STYLE

MOST_POINTS = 3000
"""Frames that are drawn; every so many-th one if there are more."""
LEAST_DRAWN = 1e-3
"""Smallest residual that is drawn, in standard deviations of the noise: no residual is exactly 0."""
COLOURS = {"levenberg_marquardt": "#0072B2", "kalman": "#D55E00"}


def estimates_figure(found: Fit) -> Figure:
    """Measured (grey) and estimated coordinates with two standard deviations, tip error, residual of the readings.

    Gaps of the motion capture stay empty. Dotted in the lower panels: the robot as described.
    """
    columns = coordinate_columns(found.robot)
    every = slice(None, None, -(-len(found.time_s) // MOST_POINTS))
    time_s, n = found.time_s[every], len(columns)
    with plt.style.context(STYLE):
        figure, panels = plt.subplots(n + 2, 1, sharex=True, figsize=(9.0, 1.3 * (n + 2) + 0.8))
        for track in found.tracks:
            colour, as_described = COLOURS[track.estimator], track.model == "described"
            label = f"{track.estimator.replace('_', '-')}, {track.model}"
            style = {"color": colour, "lw": 0.9, "ls": ":" if as_described else "-", "label": label}
            panels[n].plot(time_s, 1e3 * _tip_error(found, track)[every], **style)
            panels[n + 1].plot(time_s, track.residual[every], **style)
            if as_described:
                continue
            deviation = 2.0 * track.covariance.diagonal(dim1=-2, dim2=-1).clamp_min(0).sqrt()
            for k, factor in enumerate(columns.values()):
                x, band = ((values[every, k] / factor).numpy() for values in (track.q, deviation))
                panels[k].plot(time_s, x, color=colour, lw=0.9)
                panels[k].fill_between(time_s, x - band, x + band, color=colour, alpha=0.25, lw=0)
        for k, (name, factor) in enumerate(columns.items()):
            panels[k].plot(
                time_s, found.truth.q[every, k] / factor, color="0.75", lw=3.0, zorder=1, label="measured"
            )
            _frame(panels[k], found, k, factor)
            coordinate, unit = name.rsplit("_", 1)
            panels[k].set_ylabel(f"{coordinate}\n[{unit}]")
        panels[n].set_ylabel("tip error\n[mm]")
        panels[n + 1].set_ylabel(f"residual\n[{found.robot.unit}]")
        for panel in panels[n:]:
            panel.set_yscale("log")
            panel.set_ylim(bottom=LEAST_DRAWN * found.robot.noise if panel is panels[-1] else None)
        handles = [*panels[0].get_legend_handles_labels()[0], *panels[n].get_legend_handles_labels()[0]]
        figure.legend(handles=handles, loc="outside upper center", ncols=3)
        panels[-1].set_xlabel("time by the clock of the readings [s]")
    plt.close(figure)
    return figure


def _frame(panel: Axes, found: Fit, k: int, factor: float) -> None:
    """Show what was measured and what the bounds allow, not how far a band reaches."""
    low, high = float(found.robot.lower[k]) / factor, float(found.robot.upper[k]) / factor
    measured = found.truth.q[found.truth.known, k].numpy() / factor
    low, high = min(low, measured.min()), max(high, measured.max())
    panel.set_ylim(low - 0.05 * (high - low), high + 0.05 * (high - low))


def _tip_error(found: Fit, track: Tracked) -> np.ndarray:
    tip, _ = tip_positions(found.robot, track.q, track.covariance)
    return torch.linalg.vector_norm(tip - found.truth.tip, dim=-1).numpy()
