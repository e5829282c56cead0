"""Tables and sentences of the two pages on an emulated board: a robot of one's own, and from a board to a shape."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pandas as pd
from scipy.spatial.transform import Rotation

from repro import Robot
from repro.estimators.track import Trajectory
from repro_board.emulate import course
from repro_companion.papers.baaij import tips
from repro_companion.show import sentences

# A robot of one's own

CAPTURE_HZ, CAPTURE_LATE_S = 40.0, 1.7
"""Rate of the motion capture, and how late its clock is [s], which nobody tells the evaluation."""
CAPTURE_MM, CAPTURE_RAD = 0.1, 1e-3
"""Noise of the motion capture."""


def captured(robot: Robot, seconds: float, seed: int) -> pd.DataFrame:
    """Return what motion capture would record of a body on the end of each segment."""
    rng, t = np.random.default_rng(seed), np.arange(0, seconds, 1 / CAPTURE_HZ)
    poses = np.moveaxis(robot.poses(course(robot, t, seed=seed), tips(robot)), 1, 0)
    columns = {"time_s": t + CAPTURE_LATE_S}
    for k, T in enumerate(poses, 1):
        p = 1e3 * T[:, :3, 3] + CAPTURE_MM * rng.standard_normal((len(t), 3))
        turned = Rotation.from_rotvec(CAPTURE_RAD * rng.standard_normal((len(t), 3)))
        q = (turned * Rotation.from_matrix(T[:, :3, :3])).as_quat()
        columns |= {f"{axis}_{k}_mm": p[:, j] for j, axis in enumerate("xyz")}
        columns |= {f"q{axis}_{k}": q[:, j] for j, axis in enumerate("xyzw")}
    return pd.DataFrame(columns)


CALIBRATED = """
The check assumes a perfect calibration. {{ poses }} poses leave some parameters open, so the stated ± is
{{ "larger, " if std > design else "" }}{{ std | fixed(1) }} mm in the median.
{{ "This is too much: the" if error < std / 2 and share >= 97 else "The" }} median error is
{{ "%.2g" | format(error) }} mm, and the 95 % ellipsoid contains the true tip in
{{ "all" if share == 100 else "nearly all" if share > 99 else "%.0f %% of the" | format(share) }} rows.
"""


def calibrated_in_words(
    error: np.ndarray, std: np.ndarray, inside: np.ndarray, poses: int, design_mm: float
) -> str:
    """Return how far off a calibrated robot is, and whether it knows, beside the median ± of the check [mm]."""
    values = {"error": np.median(error), "std": np.median(std), "share": 100 * inside.mean()}
    return sentences(CALIBRATED, **values, poses=poses, design=design_mm)


FAILING = """
After the failure the monitor names the right chip, and no other, in {{ named | fixed(0) }} % of the rows. The
estimate goes on without the readings that do not fit. In the median the ± that it states
for the tip {{ "grows" if high > low else "goes" }} in this run from {{ low | fixed(1) }} mm before the failure to
{{ high | fixed(1) }} mm after it.
"""


def failing_in_words(
    times: np.ndarray, suspects: np.ndarray, std: np.ndarray, chip: int, fails_at_s: float
) -> str:
    """Return how often the monitor names the chip that fails, and what that does to the stated ± [mm]."""
    after = times > fails_at_s
    named = suspects[after, chip - 1] & (suspects[after].sum(axis=1) == 1)
    low, high = (np.median(std[rows]) for rows in (~after, after))
    return sentences(FAILING, named=100 * named.mean(), low=low, high=high)


CASES = {
    "robot": "case",
    "median": "median error [mm]",
    "largest": "largest error [mm]",
    "std": "stated ± [mm]",
    "alarm": "alarm [% of rows]",
}


def cases(found: Mapping[str, tuple[Trajectory, np.ndarray, np.ndarray]]) -> pd.DataFrame:
    """Return errors and stated ± of the tip [mm] and the share of alarms, by case."""
    rows = [
        (name, np.median(error), error.max(), np.median(std), 100 * np.mean(shape.status != "consistent"))
        for name, (shape, error, std) in found.items()
    ]
    return pd.DataFrame(rows, columns=list(CASES)).round(3)


CASES_IN_WORDS = """
**What to see.** As its file describes it, this robot is useless, with a tip error of {{ median[0] | fixed(0) }} mm.
After a calibration in {{ poses }} exact poses the error is {{ "%.2g" | format(median[1]) }} mm; in poses known to
1 mm, as you may have them, {{ rough | min | fixed(1) }} to {{ rough | max | fixed(1) }} mm. If a chip freezes during
the motion, the monitor leaves it out, and the error over the whole motion is
{{ "%.2g" | format(median[2]) }} mm. All errors and ± are medians over the motion.
"""


def cases_in_words(table: pd.DataFrame, poses: int, rough: list[float]) -> str:
    """Return what a calibration gains, in exact poses and in rough ones, and what a chip that fails costs."""
    return sentences(CASES_IN_WORDS, median=list(table["median"]), poses=poses, rough=rough)


# From a board to a shape

LINE_FAULTS = ("flips", "drops", "duplicates", "bursts", "stalls", "disconnects", "reboots")
"""What may happen to bytes between a board and us."""
FAULTS = {"fault": "fault", "intact": "intact", "accepted": "kept", "wrong": "wrong", "intact_lost": "lost"}
FAULTS |= {"gaps": "missing"}

FAULTS_IN_WORDS = """
Of {{ "{:,}".format(intact) }} intact frames {{ lost or "none" }}
{{ "is" if lost in (0, 1) else "are" }} lost, and {{ wrong or "no" }} wrong
{{ "reading is" if wrong == 1 else "readings are" }} kept. The parser drops what is damaged, and counts it.
"""


def faults_in_words(table: pd.DataFrame) -> str:
    """Return how many frames are lost, and how many wrong ones kept."""
    intact, lost, wrong = (int(table[name].sum()) for name in ("intact", "intact_lost", "wrong"))
    return sentences(FAULTS_IN_WORDS, intact=intact, lost=lost, wrong=wrong)


SILENT = "sends nothing"
FAILURES = {
    "sensors": "chips",
    "failure": "failure",
    "error": "error [mm]",
    "std": "stated ± [mm]",
    "alarm": "alarm [%]",
    "named": "named [%]",
}


FAILURES_IN_WORDS = """
**What to see.** If one of four chips fails, the median error of the tip grows from {{ healthy | two }} to at most
{{ four | two }} mm.
{% if late %}
But the monitor takes {{ late.late_s | fixed(1) }} s to name the chip (*{{ late.failure }}*), and until then the error
reaches {{ late.before_mm | two }} mm at a stated ± of {{ late.before_std_mm | two }} mm.
{% endif %}
If one of two chips fails, the rest does not determine the shape: the median error grows to {{ two | two }} mm at
most, and a median ± of {{ stated | two }} mm or more says so. The monitor names a chip that goes on sending in
{{ named.min() | fixed(0) }} to {{ named.max() | fixed(0) }} % of the time.
"""
FAILURE_TERMS = """
All numbers count from the failure on. *Error* is the distance of the estimated tip from the true one, and *stated ±*
one standard deviation of the tip; both are medians. *Alarm* says how much of the time the monitor doubts the
readings, and *named* how much of the time it names the right chip and no other. A chip that is *stuck* repeats its
last reading. Two rows agree where the chip is left out from the same time step on.
"""


def failures_in_words(table: pd.DataFrame) -> str:
    """Return how the error grows if one of four chips fails, or one of two, and how often the chip is named."""
    whole = table["failure"] == "none"
    four, two = (table[~whole & (table["sensors"] == chips)] for chips in (4, 2))
    named = four[four["before_mm"] > 0]  # late, not at once
    return sentences(
        FAILURES_IN_WORDS,
        healthy=table.loc[whole & (table["sensors"] == 4), "error"].item(),
        four=four["error"].max(),
        two=two["error"].max(),
        stated=two["std"].min(),
        named=table.loc[~whole & (table["failure"] != SILENT), "named"],
        late={} if named.empty else named.loc[named["before_mm"].idxmax()].to_dict(),
    )


def failures(steps: pd.DataFrame, fails_at_s: float) -> pd.DataFrame:
    """Return median error and ± of the tip [mm], and shares of alarms and right names [%], after the failure.

    Then how late the chip is named [s], and the largest error and ± until then; of a chip that never is, NaN.
    """
    after = steps[steps["time_s"] > fails_at_s]
    after = after.assign(alarm=100.0 * (after["status"] > 0), named=100.0 * after["named"])
    groups = after.groupby(["sensors", "failure"], sort=False)
    medians = groups[["tip_error_mm", "tip_std_mm"]].median().set_axis(["error", "std"], axis=1)
    first = after[after["named"] > 0].groupby(["sensors", "failure"], sort=False)["time_s"].min()
    named_s = after.set_index(["sensors", "failure"]).index.map(first)
    before = after[after["time_s"] < named_s].groupby(["sensors", "failure"], sort=False)
    largest = before[["tip_error_mm", "tip_std_mm"]].max().set_axis(["before_mm", "before_std_mm"], axis=1)
    return (
        medians.join(groups[["alarm", "named"]].mean())
        .join((first - fails_at_s).rename("late_s"))
        .join(largest)
        .reset_index()
        .sort_values("sensors", kind="stable", ascending=False)
    )
