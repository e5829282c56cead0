"""The recorded trial of Martin et al. (2022): our chain against released outputs, fewer IMUs in a recorded bag."""

# The stubs of pandas know less than the library does.
# pyright: reportArgumentType=false, reportCallIssue=false, reportAttributeAccessIssue=false

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pandas as pd
from jaxtyping import Float

from repro.errors import bad_input
from repro.estimation.imu_chain import link_orientations
from repro.estimation.imu_models import chain, pcc_extended, tangent_spline
from repro.estimation.imu_selection import IMU_ARCS, MARKERS, Selection, selection
from repro.estimation.orientations import exponential, product, tangents
from repro.experiments.martin2022.draws import draw
from repro.experiments.martin2022.trial import ArmTrial
from repro.recordings.martin2022 import find_bag, one_clock, read_readings
from repro.recordings.martin2022_outputs import (
    ORIGIN_M,
    OUTPUTS,
    PCC_BASE_LINK_M,
    PCC_POINTS_M,
    RIGID_LINKS_M,
    SCORED_ROWS,
    ModelOutput,
    find_output,
    read_output,
)
from repro.simulation.soft_arm import SoftArm

LARGEST_SHIFT = 40
"""Largest shift that is tried [rows]."""
BAG_AXIS = "y"
"""Axis of the IMUs along the arm in the released bags (checked on the page of the recorded arm)."""
SHARED_POINTS = 7
"""Points of ``pcc2.csv`` that need no IMU beyond #7; the last one lies between #7 and #8."""
_IMU_ARCS_M = tuple(PCC_BASE_LINK_M + 0.08 * k for k in range(8))
RELEASED_CHAIN = Selection(
    tuple(range(8)), (0.0, *_IMU_ARCS_M[:7]), (PCC_BASE_LINK_M, *(0.08,) * 6), sub_links=2
)
"""Chain of ``pcc2.csv`` up to IMU #7, from its origin: base and seven IMUs, two sub-segments per link."""


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


def frames_along(directions: Float[np.ndarray, "*samples imus 3"]) -> Float[np.ndarray, "*samples frames 4"]:
    """Orientations of an upright base and of IMUs whose z axes are given, without twist from one to the next.

    Positions say where an IMU's z axis points, not how it is turned about it. Each frame is the one before, turned
    by the smallest angle that takes its z axis to the next direction.

    Parameters
    ----------
    directions
        Unit vectors, base to tip.

    Returns
    -------
    Float[np.ndarray, "*samples frames 4"]
        Unit quaternions XYZW, the base first.
    """
    d = np.asarray(directions, dtype=float)
    frames = [np.broadcast_to([0.0, 0.0, 0.0, 1.0], (*d.shape[:-2], 4))]
    for following in np.moveaxis(d, -2, 0):
        before = tangents(frames[-1])
        axis = np.cross(before, following)
        sine = np.linalg.norm(axis, axis=-1, keepdims=True)
        angle = np.arctan2(sine, (before * following).sum(axis=-1, keepdims=True))
        frames.append(product(exponential(axis * angle / np.maximum(sine, 1e-300)), frames[-1]))
    return np.stack(frames, axis=-2)


@dataclass(frozen=True)
class Comparison:
    """Our chain beside a released output.

    Attributes
    ----------
    shift
        Rows by which the released output is later.
    turn_deg
        By how much the IMUs are turned about the arm, against the base, if the first points are to agree best: one
        number for all rows, in steps of 1 degree.
    points
        One row per point: ``point, arc_mm`` (from the base), ``median_mm`` and ``q75_mm`` of the distance,
        ``from_second_median_mm`` (distance with both chains put at the second point), ``direction_deg``, the median
        angle between the steps to this point (NaN for the first), and ``turned_median_mm``, the median distance with
        the IMUs turned.
    over_time
        ``row`` and the distance of every point, ``point_0_mm`` and so on.
    """

    shift: int
    turn_deg: float
    points: pd.DataFrame
    over_time: pd.DataFrame


def compare_chain(rigid: ModelOutput, pcc: ModelOutput, rows: tuple[int, int] | None = None) -> Comparison:
    """Our PCC-extended chain, from the directions of IMUs #1 to #7 in ``rigid.csv``, against ``pcc2.csv``.

    One shift of rows serves all samples and points: that at which the median distance of the last point is smallest.
    The base is taken as upright. How the IMUs are turned about the arm is not in their directions: no twist is
    assumed. Between IMUs a common turn has no effect, but the link from the base interpolates it, so one angle is
    also fitted there.

    Parameters
    ----------
    rigid, pcc
        The two outputs.
    rows
        First row and end of the rows of ``rigid`` that count; when not given those that the released analysis
        scores, as far as both tables have them.

    Raises
    ------
    InputError
        If a table is too short for these rows and the shifts that are tried.
    """
    last = min(len(rigid.points), len(pcc.points) - LARGEST_SHIFT)
    first, end = rows or (SCORED_ROWS[0], min(SCORED_ROWS[1], last))
    if not LARGEST_SHIFT <= first < end <= last:
        raise bad_input("rows", "compare_chain", f"within {LARGEST_SHIFT} and {last}", (first, end))
    steps = np.diff(rigid.points[first:end], axis=1)
    directions = steps / np.linalg.norm(steps, axis=-1, keepdims=True)
    arcs = PCC_POINTS_M[:SHARED_POINTS]
    frames = frames_along(directions)
    ours = pcc_extended(frames, RELEASED_CHAIN, arcs)

    def theirs(shift: int) -> np.ndarray:
        return pcc.points[first + shift : end + shift, :SHARED_POINTS]

    shifts = range(-LARGEST_SHIFT, LARGEST_SHIFT + 1)
    medians = [np.median(np.linalg.norm(theirs(k)[:, -1] - ours[:, -1], axis=-1)) for k in shifts]
    shift = shifts[int(np.argmin(medians))]
    released = theirs(shift)
    turn_deg = _best_turn(frames[::10], released[::10, 0])
    turned = pcc_extended(_about_arm(frames, turn_deg), RELEASED_CHAIN, arcs)
    error = 1e3 * np.linalg.norm(ours - released, axis=-1)
    moved = (ours - ours[:, 1:2]) - (released - released[:, 1:2])
    a, b = np.diff(ours, axis=1), np.diff(released, axis=1)
    sine = np.linalg.norm(np.cross(a, b), axis=-1)
    angle = np.degrees(np.arctan2(sine, (a * b).sum(axis=-1)))
    points = pd.DataFrame(
        {
            "point": range(SHARED_POINTS),
            "arc_mm": 1e3 * (np.array(arcs) + ORIGIN_M),
            "median_mm": np.median(error, axis=0),
            "q75_mm": np.percentile(error, 75, axis=0),
            "from_second_median_mm": 1e3 * np.median(np.linalg.norm(moved, axis=-1), axis=0),
            "direction_deg": np.append(np.nan, np.median(angle, axis=0)),
            "turned_median_mm": 1e3 * np.median(np.linalg.norm(turned - released, axis=-1), axis=0),
        }
    )
    columns = {f"point_{k}_mm": error[:, k] for k in range(SHARED_POINTS)}
    return Comparison(shift, turn_deg, points, pd.DataFrame({"row": np.arange(first, end)} | columns))


def _about_arm(frames: np.ndarray, turn_deg: float) -> np.ndarray:
    """Turn all frames but the base about their own z axes."""
    turn = exponential(np.array([0.0, 0.0, np.radians(turn_deg)]))
    turned = product(frames[:, 1:], np.broadcast_to(turn, frames[:, 1:].shape))
    return np.concatenate([frames[:, :1], turned], axis=1)


def _best_turn(frames: np.ndarray, first_points: np.ndarray) -> float:
    angles = np.arange(-179.0, 180.0)
    found = [
        pcc_extended(_about_arm(frames, angle), RELEASED_CHAIN, PCC_POINTS_M[:1])[:, 0] for angle in angles
    ]
    errors = np.median(np.linalg.norm(np.array(found) - first_points, axis=-1), axis=1)
    return float(angles[np.argmin(errors)])


def fewer_imus(orientations: Float[np.ndarray, "samples 8 4"]) -> pd.DataFrame:
    """Models with two, four and eight IMUs against the PCC-extended model with all eight.

    The reference is a model, not the truth: what it shares with the others, as errors of the sensors, is not seen.

    Parameters
    ----------
    orientations
        Link orientations of IMUs #1 to #8, unit quaternions XYZW; the base is taken as upright.

    Returns
    -------
    DataFrame
        Columns ``model, n_imus, point_mm, median_mm, q75_mm`` of the distance, at the markers and at 640 mm.
    """
    upright = np.broadcast_to([0.0, 0.0, 0.0, 1.0], (len(orientations), 1, 4))
    nine = np.concatenate([upright, orientations], axis=1)
    arcs = (*MARKERS, IMU_ARCS[-1])
    whole = selection("pcc", 8)
    reference = chain(whole.of(nine), whole, arcs)
    models = [("rigid-body", n, selection("rigid", n, "text"), chain) for n in (2, 4, 8)]
    models += [("PCC-extended, 16 segments", n, selection("pcc", n), chain) for n in (2, 4)]
    models += [("spline", n, selection("pcc", n), tangent_spline) for n in (2, 4, 8)]
    lines = []
    for name, n, made, model in models:
        error = 1e3 * np.linalg.norm(model(made.of(nine), made, arcs) - reference, axis=-1)
        for arc, values in zip(arcs, error.T, strict=True):
            lines.append((name, n, 1e3 * arc, *np.percentile(values, [50, 75])))
    return pd.DataFrame(lines, columns=["model", "n_imus", "point_mm", "median_mm", "q75_mm"])


def outputs(arm: SoftArm, seed: int = 0) -> tuple[ModelOutput, ModelOutput, str]:
    """``rigid.csv`` and ``pcc2.csv`` where both are found, else what they would hold for a synthetic trial.

    Returns
    -------
    tuple
        The two, and "recorded" or "synthetic".
    """
    rigid, pcc = (find_output(name) for name in OUTPUTS)
    if rigid is None or pcc is None:
        return *synthetic_outputs(draw(arm, seed).trial), "synthetic"
    return read_output(rigid), read_output(pcc), "recorded"


def links(bag: str, arm: SoftArm, seed: int = 0) -> tuple[Float[np.ndarray, "samples 8 4"], str]:
    """Link orientations of the eight IMUs of a released bag where it is found, else of a synthetic recording.

    Returns
    -------
    tuple
        Unit quaternions XYZW, and "recorded" or "synthetic".

    Raises
    ------
    InputError
        If the bag is none of those released.
    """
    path = find_bag(bag)
    if path is None:
        return draw(arm, seed).trial.orientations[:, 1:], "synthetic"
    return link_orientations(one_clock(read_readings(path)).orientations, BAG_AXIS), "recorded"


def synthetic_outputs(trial: ArmTrial, shift: int = 6) -> tuple[ModelOutput, ModelOutput]:
    """What the two released tables would hold for a synthetic trial, the second ``shift`` rows later."""
    made = Selection(tuple(range(9)), (0.0, *_IMU_ARCS_M), (PCC_BASE_LINK_M, *(0.08,) * 7), sub_links=2)
    steps = tangents(trial.orientations[:, 1:8]) * np.array(RIGID_LINKS_M)[:, None]
    joints = np.cumsum(np.concatenate([np.zeros_like(steps[:, :1]), steps], axis=1), axis=1)
    points = pcc_extended(made.of(trial.orientations), made, PCC_POINTS_M)
    later = np.concatenate([np.repeat(points[:1], shift, axis=0), points])
    times = trial.time_s - trial.time_s[0]
    late_s = np.concatenate([np.arange(-shift, 0) * (times[1] - times[0]), times])
    return ModelOutput(joints, times), ModelOutput(later, late_s - late_s[0])
