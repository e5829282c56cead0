"""The light-bulb tests of Mitchell et al. 2021 (Fig. 8): bend angle over time, and attempts to tighten the bulb.

Four files exist for three published experiments. File -1 alone sets what the detector needs, the ratios at rest and
the threshold; both are then frozen. There is no motion capture of these tests.

Events are found in the magnitude of the ratios of the transverse over the axial field, without a model: while a bulb
is held that magnitude comes near and beyond the largest that the model of a free arc knows (0.34 at 90 deg), where an
estimated bend angle stays at its bound.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

import matplotlib.pyplot as plt
import numpy as np
import pandas as pd
import torch
from jaxtyping import Float
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from scipy.ndimage import median_filter
from torch import Tensor

from edition1.errors import bad_input, require
from edition1.kinematics.bend import MAX_BEND
from edition1.sensing.bend_sensor import BendSensor
from edition1_companion.recordings.mitchell2021 import FIELD, HallTake, read_hall, takes
from edition1_companion.recordings.mitchell2021_conventions import model_axes
from edition1_companion.twins.bend_curves import SENSOR_NOISE_MT
from edition1_companion.twins.bend_takes import write_light_tests
from edition1_companion.twins.field_ratios import FieldRatios, invert, transverse_to_axial
from edition1_live.view.style import WIDTH_IN, page_figure

FIRST = "light_-1"
"""The file that sets rest and threshold."""
QUIET_S = 10.0
"""Length of the part of that file which counts as rest: the one in which the field varies least [s]."""
BASELINE_S = 10.0
"""Width of the running median from which a spike rises [s]; a spike lasts less than half of it."""
TIMES_NOISE = 10.0
"""Threshold over the standard deviation of a ratio at rest."""
OTHER_TIMES_NOISE = (5.0, TIMES_NOISE, 20.0, 40.0)
"""Other thresholds at which events are counted, for comparison."""
LEAST_S = 0.1
"""Shortest event [s]."""
MERGED_S = 1.0
"""Events closer to each other are one [s]."""
OURS, EVENT = "#0072B2", "#D55E00"


@dataclass(frozen=True)
class Detector:
    """What file -1 says, frozen for all others.

    Attributes
    ----------
    rest
        Ratios of the transverse over the axial field at rest.
    noise
        Standard deviation of a ratio at rest.
    threshold
        Rise of the ratios' magnitude over the baseline that counts as an event.
    quiet_from_s
        Where the part at rest begins [s].
    """

    rest: Float[Tensor, " 2"]
    noise: float
    threshold: float
    quiet_from_s: float


def light_tests(folder: Path | None = None) -> dict[str, HallTake]:
    """Return the light-bulb files that are found by names such as ``light_0``, by default those of the recordings."""
    return {
        take.name: read_hall(take.hall)
        for take in takes(folder)
        if take.hall and take.name.startswith("light_")
    }


def recorded_or_synthetic(*, seed: int = 0) -> tuple[dict[str, HallTake], str]:
    """Return the recorded light-bulb files, or where there are none synthetic ones, and a label that says which."""
    found = light_tests()
    if found:
        return found, "recorded"
    with TemporaryDirectory() as folder:
        write_light_tests(Path(folder), seed=seed)
        return light_tests(Path(folder)), "synthetic"


def facts(tests: dict[str, HallTake]) -> pd.DataFrame:
    """What was dropped of each file: ``file, readings, unreadable, drained, beyond_range, longest_gap_s``."""
    columns = ["file", "readings", "unreadable", "drained", "beyond_range", "longest_gap_s"]
    rows = [
        (name, len(hall.readings), hall.unreadable, hall.drained, hall.masked, hall.longest_gap_s)
        for name, hall in tests.items()
    ]
    return pd.DataFrame(rows, columns=columns)


def detector(first: HallTake) -> Detector:
    """Find rest and threshold from one file, in which the module is left alone for a while.

    Raises
    ------
    InputError
        If the file is shorter than twice `QUIET_S`.
    """
    time_s, seen = first.readings["time_s"].to_numpy(), _ratios(first)
    if not time_s[-1] > 2 * QUIET_S:
        raise bad_input("recording", "detector", f"longer than {2 * QUIET_S:g} s", f"{time_s[-1]:g} s")
    starts = np.arange(0.0, time_s[-1] - QUIET_S, 0.5)
    parts = [(time_s >= start) & (time_s < start + QUIET_S) for start in starts]
    scatter = [float(np.nanstd(seen[part].numpy(), axis=0).mean()) for part in parts]
    quiet = int(np.argmin(scatter))
    rest = seen[torch.from_numpy(parts[quiet])].nanmedian(0).values
    return Detector(rest, scatter[quiet], TIMES_NOISE * scatter[quiet], float(starts[quiet]))


def bend_over_time(hall: HallTake, found: Detector, model: FieldRatios) -> pd.DataFrame:
    """Ratios and estimates of ours over time; readings beyond the range are left out.

    Parameters
    ----------
    hall
        A light-bulb file.
    found
        Rest and threshold.
    model
        The model of the ratios.

    Returns
    -------
    DataFrame
        Columns ``time_s, ratio, baseline`` (the ratios' magnitude and its running median), ``bend_rad,
        deviation_rad`` (at most the paper's bound) and ``at_bound``.
    """
    readable = hall.readings[FIELD].notna().all(axis=1).to_numpy(copy=True)
    table = hall.readings[readable]
    measured = _ratios(hall)[torch.from_numpy(readable)] - found.rest
    ratio = torch.linalg.vector_norm(measured, dim=-1).numpy()
    q, deviation = invert(measured, model, SENSOR_NOISE_MT / float(table["bx_mT"].abs().median()))
    bend = torch.linalg.vector_norm(q, dim=-1).numpy()
    width = 1 + 2 * round(BASELINE_S / 2 / float(table["time_s"].diff().median()))
    return pd.DataFrame(
        {
            "time_s": table["time_s"].to_numpy(),
            "ratio": ratio,
            "baseline": median_filter(ratio, size=width, mode="nearest"),
            "bend_rad": bend,
            "deviation_rad": deviation.numpy(),
            "at_bound": bend > MAX_BEND - 1e-6,
        }
    )


def events(table: pd.DataFrame, threshold: float, merged_s: float = MERGED_S) -> pd.DataFrame:
    """Times at which the ratios' magnitude is above its baseline by more than the threshold.

    Parameters
    ----------
    table
        Columns ``time_s, ratio, baseline``.
    threshold
        Rise that counts.
    merged_s
        Events closer to each other are one [s].

    Returns
    -------
    DataFrame
        Columns ``start_s, end_s, rise``, one row per event: at least `LEAST_S` long, and more than ``merged_s``
        after the end of the one before.
    """
    rise = table["ratio"] - table["baseline"]
    above = table.assign(rise=rise)[rise > threshold]
    event = (above["time_s"].diff() > merged_s).cumsum()
    found = above.groupby(event).agg(start_s=("time_s", "min"), end_s=("time_s", "max"), rise=("rise", "max"))
    return found[found["end_s"] - found["start_s"] >= LEAST_S].reset_index(drop=True)


def all_events(tests: dict[str, HallTake], model: FieldRatios) -> tuple[Detector, pd.DataFrame, pd.DataFrame]:
    """Bend angles and events of all files, with the detector that file -1 gave.

    Parameters
    ----------
    tests
        Files by name, `FIRST` among them.
    model
        The model of the ratios.

    Returns
    -------
    tuple
        The detector; a table ``file, time_s, ratio, baseline, bend_deg, deviation_deg, at_bound``; and one with the
        columns of :func:`events` after ``file``.

    Raises
    ------
    InputError
        If file -1 is not there.
    """
    require(FIRST in tests, "files", "all_events", f"with {FIRST} among them", sorted(tests))
    found = detector(tests[FIRST])
    curves, marks = [], []
    for name, hall in tests.items():
        table = bend_over_time(hall, found, model)
        marks.append(events(table, found.threshold).assign(file=name))
        degrees = {f"{angle}_deg": np.degrees(table[f"{angle}_rad"]) for angle in ("bend", "deviation")}
        curves.append(table[["time_s", "ratio", "baseline", "at_bound"]].assign(file=name, **degrees))
    marked = pd.concat(marks, ignore_index=True)[["file", "start_s", "end_s", "rise"]]
    return found, pd.concat(curves, ignore_index=True), marked


def counts(curves: pd.DataFrame, found: Detector) -> pd.DataFrame:
    """Count events at other settings of the detector: how far the count depends on those that were frozen.

    Parameters
    ----------
    curves, found
        Of :func:`all_events`.

    Returns
    -------
    DataFrame
        Columns ``times_noise, threshold, merged_s, frozen`` and one with the count for each file.
    """
    rows = []
    for times in OTHER_TIMES_NOISE:
        for merged in (MERGED_S / 4, MERGED_S):
            row = {"times_noise": times, "threshold": times * found.noise, "merged_s": merged}
            row["frozen"] = times == TIMES_NOISE and merged == MERGED_S
            for file, table in curves.groupby("file", sort=False):
                row[str(file)] = len(events(table, row["threshold"], merged))
            rows.append(row)
    return pd.DataFrame(rows)


def _ratios(hall: HallTake) -> Tensor:
    return transverse_to_axial(model_axes(torch.from_numpy(hall.readings[FIELD].to_numpy(copy=True))))


def in_words(file: str) -> str:
    """The name of a file as pages have it."""
    return "trial run" if file == FIRST else f"file {file.removeprefix('light_')}"


def as_drawn(length_mm: float) -> FieldRatios:
    """Model of the ratios without calibration, for an arc length [mm]."""
    return FieldRatios(BendSensor(1e-3 * length_mm), torch.eye(2, dtype=torch.float64))


@page_figure
def events_over_time(curves: pd.DataFrame, events: pd.DataFrame, threshold: float, source: str) -> Figure:
    """Bend angle and ratios over time, one row per file (Fig. 8); events, which rise above the threshold, shaded."""
    files = list(dict.fromkeys(curves["file"]))
    figure, panels = plt.subplots(
        len(files), 2, figsize=(WIDTH_IN, 1.9 * len(files) + 0.7), sharex=True, sharey="col", squeeze=False
    )
    for (left, right), file in zip(panels, files, strict=True):
        part = curves[curves["file"] == file]
        band = 2.0 * part["deviation_deg"]
        left.fill_between(
            part["time_s"], part["bend_deg"] - band, part["bend_deg"] + band, color=OURS, alpha=0.25, lw=0
        )
        left.plot(part["time_s"], part["bend_deg"], color=OURS, lw=0.7)
        left.axhline(90.0, color="0.6", lw=0.8, ls="--")
        left.set(ylim=(0, 98), yticks=(0, 30, 60, 90))
        right.plot(part["time_s"], part["ratio"], color="black", lw=0.7)
        right.plot(part["time_s"], part["baseline"], color="0.6", lw=1)
        right.plot(part["time_s"], part["baseline"] + threshold, color="0.3", lw=1.2, ls=":")
        for _, event in events[events["file"] == file].iterrows():
            for panel in (left, right):
                panel.axvspan(event["start_s"], event["end_s"], color=EVENT, alpha=0.25, lw=0)
        left.set_title(f"{in_words(file)}, {source}", loc="left")
        left.set_ylabel("bend [deg]")
        right.set_ylabel("transverse / axial")
    for panel in panels[-1]:
        panel.set_xlabel("time [s]")
    handles = [
        Line2D([], [], color="0.6", lw=1, label="running median"),
        Line2D([], [], color="0.3", lw=1.2, ls=":", label="threshold"),
        Line2D([], [], color=EVENT, lw=6, alpha=0.3, label="event"),
    ]
    figure.legend(handles=handles, loc="outside lower center", ncols=3)
    return figure
