"""The recorded trial of Martin et al. (2022): orientations, released tables, Fig. 5, models with fewer IMUs."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pandas as pd
from jaxtyping import Float

from edition1.errors import InputError
from edition1.estimation.imu_chain import link_orientations
from edition1.estimation.imu_models import chain, tangent_spline
from edition1_companion.pages.recorded_trial.released import (
    NEEDED,
    PCC_2,
    RIGID,
    TrialOrientations,
    compared,
    released_chains,
    trial_orientations,
)
from edition1_companion.recordings.martin2022 import find_bag, one_clock, read_readings
from edition1_companion.recordings.martin2022_models import IMU_ARCS, MARKERS, selection
from edition1_companion.recordings.martin2022_trial import (
    OUTPUTS,
    POINTS,
    RIGID_LINKS_M,
    SCORED_ROWS,
    ModelOutput,
    find_output,
    read_output,
)
from edition1_companion.twins.arm_markers import DESCRIBED, FILES, MARKER_NAMES, SAME_POINT, Case
from edition1_companion.twins.arm_trial import ArmTrial, draw
from edition1_companion.twins.soft_arm import SoftArm

BAG_AXIS = "y"
"""Axis of the IMUs along the arm in the released bags (checked on the page of the recorded arm)."""


@dataclass(frozen=True)
class Trial:
    """The paper's trial, or a synthetic one in its place.

    Attributes
    ----------
    outputs
        Tables by their names in `edition1_companion.recordings.martin2022_trial.OUTPUTS`.
    found
        Orientations that follow from them.
    source
        "recorded" or "synthetic".
    notes
        Sentences: which tables are missing or cannot be used.
    """

    outputs: dict[str, ModelOutput]
    found: TrialOrientations
    source: str
    notes: tuple[str, ...] = ()

    @property
    def scored(self) -> Float[np.ndarray, "rows 9 4"]:
        """Orientations of the rows that the released analysis scores, as far as there are that many."""
        return self.found.orientations[slice(*SCORED_ROWS)]


def load_trial(arm: SoftArm, seed: int = 0) -> Trial:
    """The recorded trial where the tables that tell its orientations are found, else a synthetic one.

    A table that is not needed for the orientations and cannot be used costs its own comparison only.

    Raises
    ------
    InputError
        If a table that is needed is found, but is damaged or another than the released one.
    """
    outputs, notes = {}, []
    for name in OUTPUTS:
        try:
            if path := find_output(name):
                outputs[name] = read_output(path)
        except InputError as refused:
            if name in NEEDED:
                raise
            notes.append(str(refused))
    if missing := [
        name for name in OUTPUTS if name not in outputs and not any(name in note for note in notes)
    ]:
        notes.append(f"Not found: {', '.join(missing)}.")
    if all(name in outputs for name in NEEDED):
        return Trial(outputs, trial_orientations(outputs), "recorded", tuple(notes))
    outputs = synthetic_outputs(draw(arm, seed).trial)
    return Trial(outputs, trial_orientations(outputs), "synthetic", tuple(notes))


def synthetic_outputs(trial: ArmTrial, later: int = 6) -> dict[str, ModelOutput]:
    """What the released tables would hold for a synthetic trial, all but ``rigid.csv`` some rows later."""
    times = trial.time_s - trial.time_s[0]
    made = {}
    for name, given in released_chains().items():
        rows = 0 if name == RIGID else later
        points = np.full((len(times) + rows, POINTS, 3), np.nan)
        points[rows:, list(given.arcs)] = given.points(trial.orientations)
        points[:rows] = points[rows]
        late_s = np.concatenate([np.arange(-rows, 0) * (times[1] - times[0]), times])
        # The released numbers are those of 32 bits.
        made[name] = ModelOutput(points.astype(np.float32).astype(float), late_s - late_s[0])
    return made


def link_lengths(output: ModelOutput) -> pd.DataFrame:
    """Links of ``rigid.csv`` as they are in the table: a check of the reader, not of a model.

    Returns
    -------
    DataFrame
        Columns ``link, expected_mm, mean_mm, largest_error_mm``.
    """
    lengths = 1e3 * np.linalg.norm(np.diff(output.points, axis=1), axis=-1)
    expected = 1e3 * np.array(RIGID_LINKS_M)
    return pd.DataFrame(
        {
            "link": range(1, len(expected) + 1),
            "expected_mm": expected,
            "mean_mm": lengths.mean(axis=0),
            "largest_error_mm": np.abs(lengths - expected).max(axis=0),
        }
    )


def compare_files(trial: Trial) -> pd.DataFrame:
    """Every table beside what its chain gives from the orientations of the trial; see `compared`.

    Returns
    -------
    DataFrame
        Columns as `compared`, a line for each table there is.
    """
    lines = [compared(name, output, trial.found.orientations) for name, output in trial.outputs.items()]
    return pd.DataFrame(lines)


def rows_later(files: pd.DataFrame) -> int:
    """Rows by which ``pcc2.csv`` is later than ``rigid.csv``, from :func:`compare_files`."""
    later = files.set_index("file")["later"]
    return int(later[PCC_2] - later[RIGID])


def figure_5(nine: Float[np.ndarray, "rows 9 4"], published: pd.DataFrame) -> pd.DataFrame:
    """What the released chains of Fig. 5 are off, one setting changed at a time, beside the printed errors.

    Distances are from the cubic spline through the tangents of all eight IMUs with an upright base, at the markers: a
    model, not motion capture. What the sensors get wrong, and where the frame of the motion capture is, is not in it.

    Parameters
    ----------
    nine
        Orientations of base and IMUs, unit quaternions XYZW.
    published
        Printed numbers, columns ``artefact, row, quantity, unit, value``.

    Returns
    -------
    DataFrame
        Columns ``n_imus, chain, marker, median_mm, q75_mm, printed_median_mm, printed_q75_mm``.
    """
    reference = tangent_spline(nine, selection("pcc", 8), MARKERS)
    printed = published[published["artefact"] == "Fig. 5"].set_index(["row", "quantity"])["value"]
    lines = []
    for n in (2, 4, 8):
        case = Case("Fig. 5", "pcc", n, 16)
        released, at_markers = case.chain(FILES), case.chain(SAME_POINT)
        chains = {
            "as described": case.chain(DESCRIBED),
            "base turned, at the markers": at_markers,
            "base upright, points of the file": replace(released, base_turn=(0.0, 0.0, 0.0, 1.0)),
            "as in the file": released,
        }
        for name, made in chains.items():
            error = 1e3 * np.linalg.norm(chain(made.of(nine), made, made.markers) - reference, axis=-1)
            for marker, values in zip(MARKER_NAMES, error.T, strict=True):
                row = f"{marker} PCC-extended 16 segments {n} IMUs"
                paper = printed[row, "median"], printed[row, "q3"]
                lines.append((n, name, marker, *np.percentile(values, [50, 75]), *paper))
    columns = ["n_imus", "chain", "marker", "median_mm", "q75_mm", "printed_median_mm", "printed_q75_mm"]
    return pd.DataFrame(lines, columns=columns)


def fewer_imus(nine: Float[np.ndarray, "samples 9 4"]) -> pd.DataFrame:
    """All models with two, four and eight IMUs against the spline through the tangents of all eight.

    The reference is a model, not the truth: what it shares with the others, as errors of the sensors, is not seen.

    Parameters
    ----------
    nine
        Orientations of an upright base and of IMUs #1 to #8, unit quaternions XYZW, z along the arm.

    Returns
    -------
    DataFrame
        Columns ``model, n_imus, point_mm, median_mm, q75_mm`` of the distance, at the markers and at 640 mm.
    """
    arcs, whole = (*MARKERS, IMU_ARCS[-1]), selection("pcc", 8)
    reference = tangent_spline(whole.of(nine), whole, arcs)
    models = [("rigid-body", n, selection("rigid", n, "text"), chain) for n in (2, 4, 8)]
    models += [("PCC-extended, 16 segments", n, selection("pcc", n), chain) for n in (2, 4, 8)]
    models += [("spline", n, selection("pcc", n), tangent_spline) for n in (2, 4)]
    lines = []
    for name, n, made, model in models:
        error = 1e3 * np.linalg.norm(model(made.of(nine), made, arcs) - reference, axis=-1)
        for arc, values in zip(arcs, error.T, strict=True):
            lines.append((name, n, 1e3 * arc, *np.percentile(values, [50, 75])))
    return pd.DataFrame(lines, columns=["model", "n_imus", "point_mm", "median_mm", "q75_mm"])


def bag_orientations(bag: str, arm: SoftArm, seed: int = 0) -> tuple[Float[np.ndarray, "samples 9 4"], str]:
    """Orientations of an upright base and the eight IMUs in a released bag where it is found, else synthetic ones.

    Returns
    -------
    tuple
        Unit quaternions XYZW, z along the arm, and "recorded" or "synthetic".

    Raises
    ------
    InputError
        If the bag is none of those released.
    """
    path = find_bag(bag)
    if path is None:
        return draw(arm, seed).trial.orientations, "synthetic"
    eight = link_orientations(one_clock(read_readings(path)).orientations, BAG_AXIS)
    upright = np.broadcast_to([0.0, 0.0, 0.0, 1.0], (len(eight), 1, 4))
    return np.concatenate([upright, eight], axis=1), "recorded"


def said_of_files(trial: Trial, files: pd.DataFrame) -> str:
    """What the comparison of :func:`compare_files` shows, in sentences; first of all what the data are."""
    within = files["largest_um"] <= 1.0
    others = files[~within]
    words = [
        f"**{trial.source.capitalize()}** trial, {len(trial.found.orientations)} rows.",
        f"Of {len(files)} tables, {int(within.sum())} follow to 1 µm in every point of every row that is compared.",
    ]
    for line in others.to_dict("records"):
        same, largest = np.floor(10 * line["same_percent"]) / 10, line["largest_um"]
        words.append(
            f"Of {line['file']}, {same:.1f} % of the points do; the largest distance is {largest:.1f} µm."
        )
    if others["file"].str.startswith("fly/pcc16/").any():
        words.append(
            "Straight links do not tell how an IMU is turned about the arm, and long links depend on it most."
        )
    if tied := int(files["half_turns"].max()):
        words.append(
            f"Left out: {tied} rows in which base and IMU #1 are half a turn apart, so that neither way is shorter."
        )
    if trial.source == "synthetic":
        words.append(
            "These tables were made with the same chains: a check of the orientations found, of no released one."
        )
    words.append(f"The equations agree to {trial.found.unevenness_deg.max():.0e} degrees on every row.")
    return " ".join(words)


def said_of_figure_5(table: pd.DataFrame, source: str) -> str:
    """What :func:`figure_5` says of two IMUs, in sentences that are true of its source."""
    two = table[table["n_imus"] == 2].set_index(["chain", "marker"])

    def numbers(chain_name: str, marker: str) -> str:
        line = two.loc[(chain_name, marker)]
        return f"{line['median_mm']:.0f} mm (Q3 {line['q75_mm']:.0f}) at {marker}"

    def both(chain_name: str) -> str:
        return f"{numbers(chain_name, 'M1')} and {numbers(chain_name, 'M2')}"

    printed = (
        f"{m:.0f} mm (Q3 {q:.0f})"
        for m, q in two.loc["as in the file", ["printed_median_mm", "printed_q75_mm"]].to_numpy()
    )
    return (
        f"{source.capitalize()} trial, two IMUs: the chain as described is {both('as described')} from the spline, "
        f"with the turned base at the markers {both('base turned, at the markers')}, as in the file "
        f"{both('as in the file')}. "
        f"Fig. 5 prints errors of {' and '.join(printed)}, against motion capture."
    )
