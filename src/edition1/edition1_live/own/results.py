"""What is written of a judged recording: a folder, whole or not at all; a figure, and a report in words."""

from __future__ import annotations

import shutil
import uuid
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import pandas as pd
import torch
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from edition1.errors import bad_input
from edition1.sensing.weights import save_weights
from edition1_live.own.fit import Fit
from edition1_live.own.judge import Tracked, errors_of_estimates, tip_band, tip_positions
from edition1_live.own.models import LEAST_S
from edition1_live.own.poses import MeasuredPoses
from edition1_live.robot.calibrate import report as calibration_report
from edition1_live.robot.calibration_poses import coordinate_columns
from edition1_live.view.style import STYLE

_MOST_POINTS = 3000
"""Frames that are drawn; every so many-th one if there are more."""
_LEAST_DRAWN = 1e-3
"""Smallest residual that is drawn, in standard deviations of the noise: no residual is exactly 0."""
_COLOURS = {"levenberg_marquardt": "#0072B2", "kalman": "#D55E00"}


def _estimates_figure(found: Fit) -> Figure:
    """Measured (grey) and estimated coordinates with two standard deviations, tip error, residual of the readings.

    Gaps of the motion capture stay empty. Dotted in the lower panels: the robot as described.
    """
    columns = coordinate_columns(found.robot)
    every = slice(None, None, -(-len(found.time_s) // _MOST_POINTS))
    time_s, n = found.time_s[every], len(columns)
    with plt.style.context(STYLE):
        figure, panels = plt.subplots(n + 2, 1, sharex=True, figsize=(9.0, 1.3 * (n + 2) + 0.8))
        for track in found.tracks:
            colour, as_described = _COLOURS[track.estimator], track.model == "described"
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
            panel.set_ylim(bottom=_LEAST_DRAWN * found.robot.noise if panel is panels[-1] else None)
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


def check_new(folder: Path) -> None:
    """Refuse an output that exists.

    Raises
    ------
    InputError
        As said.
    """
    if folder.exists() or folder.is_symlink():
        raise bad_input("output", "repro fit", "a folder that does not exist yet", folder)


def write_results(folder: Path, found: Fit, poses: MeasuredPoses) -> str:
    """Write all results into a new folder, and return the report in words, which is among them.

    Files: ``errors.csv``, ``estimates.csv``, ``estimates.png``, ``report.txt``, and ``calibration.json`` or the
    networks ``sensor1.safetensors`` and so on. The folder appears when all of them are written.

    Raises
    ------
    InputError
        If the folder exists.
    """
    check_new(folder)
    folder.parent.mkdir(parents=True, exist_ok=True)
    stage = folder.with_name(f".{folder.name}-{uuid.uuid4().hex}")
    stage.mkdir()
    try:
        table = errors_of_estimates(found.robot, found.truth, found.tracks)
        text = report(found, poses, table)
        options = {"index": False, "lineterminator": "\n", "float_format": "%.6g"}
        table.to_csv(stage / "errors.csv", **options)
        estimates(found).to_csv(stage / "estimates.csv", **options)
        _estimates_figure(found).savefig(stage / "estimates.png", metadata={"Software": None})
        (stage / "report.txt").write_text(text + "\n", encoding="utf-8")
        if found.calibration is not None:
            found.calibration.write(stage / "calibration.json")
        if found.networks is not None:
            for k, network in enumerate(found.networks.networks):
                about = {
                    "recipe": "fast",
                    "sensor": k + 1,
                    f"rmse_{found.robot.unit}": found.networks.rmse[k],
                }
                save_weights(network.float(), stage / f"sensor{k + 1}.safetensors", about)
        check_new(folder)
        stage.rename(folder)
    finally:
        shutil.rmtree(stage, ignore_errors=True)
    return text


def estimates(found: Fit) -> pd.DataFrame:
    """Table of the judged frames: time, measured configuration, and estimates with standard deviations.

    Columns of estimates begin with model and estimator; measured ones are empty in gaps of the motion capture.
    """
    columns = coordinate_columns(found.robot)
    table = {"time_s": found.time_s}
    factor = torch.tensor(list(columns.values()), dtype=torch.float64)
    for name, values in zip(columns, (found.truth.q / factor).T, strict=True):
        table[f"measured_{name}"] = values.numpy()
    for axis, values in zip("xyz", 1e3 * found.truth.tip.T, strict=True):
        table[f"measured_tip_{axis}_mm"] = values.numpy()
    for track in found.tracks:
        head = f"{track.model}_{track.estimator}"
        deviation = track.covariance.diagonal(dim1=-2, dim2=-1).clamp_min(0).sqrt() / factor
        for k, name in enumerate(columns):
            table[f"{head}_{name}"] = (track.q[:, k] / factor[k]).numpy()
            table[f"{head}_sd_{name}"] = deviation[:, k].numpy()
        table[f"{head}_tip_error_mm"] = 1e3 * _tip_error(found, track)
        table[f"{head}_residual_{found.robot.unit}"] = track.residual
    return pd.DataFrame(table)


def report(found: Fit, poses: MeasuredPoses, table: pd.DataFrame) -> str:
    """Say in words what was found, and what to doubt."""
    lag, parts, robot = found.lag, found.parts, found.robot
    lines = [f"Note: {note}" for note in found.notes]
    lines.append(
        f"Lag: {1e3 * lag.lag_s:+.2f} +- {1e3 * lag.error_s:.2f} ms to be added to the times of the poses "
        f"(r = {lag.r:.4f}, residual {lag.residual:.3g} {robot.unit}, {lag.common_s:.1f} s)."
    )
    apart = found.rest_lag.lag_s - lag.lag_s
    lines.append(f"The judged part by itself has a lag that differs by {1e3 * apart:+.2f} ms.")
    step = float(np.median(np.diff(found.time_s)))
    spread = np.hypot(lag.error_s, found.rest_lag.error_s)
    if abs(apart) > max(step / 2, 4 * spread):
        middles = [sum(span) / 2 for span in (parts.first_s, parts.rest_s)]
        ppm = 1e6 * apart / (middles[1] - middles[0])
        lines.append(
            f"Doubt: the clocks drift ({ppm:+.0f} ppm), or the robot was not the same in both parts."
        )
    lines.append(
        f"Motion capture: {poses.frames} frames, {poses.frames - len(poses.time_s)} without a pose; gaps of over "
        f"{poses.longest_gap_s:.3g} s: {poses.gaps}, not interpolated over."
    )
    lines.append(
        f"First part {parts.first_s[0]:.2f} to {parts.first_s[1]:.2f} s; judged {parts.rest_s[0]:.2f} to "
        f"{parts.rest_s[1]:.2f} s: {len(found.time_s)} frames, of which {found.masked} "
        f"({found.masked / len(found.time_s):.1%}) have no measured pose and are not judged."
    )
    if found.calibration is not None:
        lines.append(f"Calibration: {calibration_report(found.calibration, robot.unit)}")
    if found.networks is not None:
        text = ", ".join(f"{x:.3g}" for x in found.networks.rmse)
        lines.append(
            f"Networks: error on readings of the first part they were not trained on {text} {robot.unit}."
        )
    lines += [
        "",
        _table(table),
        *(_band(found, track) for track in found.tracks if track.model != "described"),
    ]
    if parts.first_s[1] - parts.first_s[0] < 4 * LEAST_S:
        lines.append(f"Doubt: {parts.first_s[1] - parts.first_s[0]:.0f} s for the first part are few.")
    return "\n".join(lines)


def _band(found: Fit, track: Tracked) -> str:
    """Say by how much deviations have to grow to hold, or why that cannot be said."""
    band = tip_band(found.robot, found.truth, track, found.time_s)
    head = f"Band of {track.model}, {track.estimator}: "
    if not np.isfinite(band.grown):
        return f"{head}the halves of the judged part must have {band.least_s:.0f} s of poses each to tell what holds."
    return (
        f"{head}grown {band.grown:.2f}-fold by the first half of the judged part, the ellipsoid for {band.level:.0%} "
        f"holds {band.held:.0%} of the tips of the second, as stated {band.held_as_stated:.0%} "
        f"(repro live --grown {band.grown:.2f})."
    )


def _table(table: pd.DataFrame) -> str:
    """Tip and configuration by model and estimator, in words for a terminal."""
    lines = [
        f"{'':32s}{'tip error [mm]':>24s}{'':>10s}{'in 95 % ellipsoid':>20s}{'NEES':>10s}",
        f"{'':32s}{'mean':>8s}{'RMSE':>8s}{'95 %':>8s}{'% length':>10s}{'all':>10s}{'tip':>10s}{'all':>10s}",
    ]
    for name, rows in table.groupby(table["model"] + ", " + table["estimator"], sort=False):
        tip, full = (rows[rows["quantity"] == name].iloc[0] for name in ("tip", "configuration"))
        numbers = f"{tip['mean']:8.3f}{tip['rmse']:8.3f}{tip['p95']:8.3f}{tip['percent_of_length']:10.3f}"
        shares = f"{full['coverage']:10.1%}{tip['coverage']:10.1%}{full['nees']:10.3g}"
        lines.append(f"{name:32s}{numbers}{shares}")
    return "\n".join(lines)
