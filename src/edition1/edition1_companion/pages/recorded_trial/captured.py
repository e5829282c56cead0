"""Real errors of the markers, for whoever has the motion-capture file of the trial of Martin et al. (2022)."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import pandas as pd

from edition1.errors import InputError
from edition1_companion.recordings.alignment import find_lag
from edition1_companion.recordings.martin2022_trial import (
    MARKER_POINTS,
    ORIGIN_M,
    SCORED_ROWS,
    MarkerCapture,
    ModelOutput,
    find_capture,
    read_capture,
)

COLUMNS = ["output", "frame", "marker", "samples", "median_mm", "q75_mm"]


def real_errors(
    rigid: ModelOutput, pcc: ModelOutput, shift: int, layout: Mapping[str, Any]
) -> tuple[pd.DataFrame, str]:
    """:func:`capture_errors` where the released motion capture is found and its layout is named.

    Parameters
    ----------
    rigid, pcc, shift
        The released outputs, and the rows by which the second is later.
    layout
        Of the file, as `edition1_companion.recordings.martin2022_trial.read_capture` asks for it.

    Returns
    -------
    DataFrame, str
        The errors, empty where there are none, and a sentence that says why or how many frames were used.

    Raises
    ------
    InputError
        If a layout is given that does not fit the file.
    """
    path, none = find_capture(), pd.DataFrame(columns=COLUMNS)
    if path is None:
        return none, "Motion capture not found: no real errors are stated."
    try:
        capture = read_capture(path, layout)
    except InputError as refused:
        if layout:
            raise
        return (
            none,
            f"Motion capture found, but what its columns hold is not named: no real errors. {refused}",
        )
    frames = f"{len(capture.time_s)} frames, {capture.dropped} marker positions not seen"
    return capture_errors(rigid, pcc, shift, capture), f"Motion capture found: {frames}."


def capture_errors(rigid: ModelOutput, pcc: ModelOutput, shift: int, capture: MarkerCapture) -> pd.DataFrame:
    """Real errors of the markers: the two released outputs against the motion capture of their trial.

    Times of rows are those of ``rigid.csv``, which was replayed in real time; ``pcc2.csv`` is aligned with it by row.
    The delay is where the heights of M2 correlate best. Errors are given with both origins at the base, and for the
    second half of the samples after a frame of six parameters was fitted to the first half.

    Parameters
    ----------
    rigid, pcc, shift
        The outputs, and the rows by which the second is later.
    capture
        The markers.

    Returns
    -------
    DataFrame
        Columns ``output, frame, marker, samples, median_mm, q75_mm``.

    Raises
    ------
    InputError
        If the heights have no clear peak of correlation.
    """
    first, end = SCORED_ROWS[0], min(SCORED_ROWS[1], len(rigid.points), len(pcc.points) - abs(shift))
    time_s, markers = rigid.replay_s[first:end], list(MARKER_POINTS)
    models = {
        "rigid.csv": rigid.points[first:end, markers],
        "pcc2.csv": pcc.points[first + shift : end + shift, markers],
    }
    up = np.array([0.0, 0.0, ORIGIN_M])
    height = models["pcc2.csv"][:, 1, 2]
    longest = max(5.0, float(capture.time_s[-1] - capture.time_s[0]), float(time_s[-1]))
    lag = find_lag(time_s, height, capture.time_s, capture.markers[:, 1, 2], longest_s=longest)
    flat = capture.markers.reshape(len(capture.time_s), -1)
    clock = capture.time_s + lag.lag_s
    seen = np.stack([np.interp(time_s, clock, column, np.nan, np.nan) for column in flat.T], axis=-1)
    seen = seen.reshape(-1, 2, 3)
    known = np.asarray(np.isfinite(seen).all(axis=(1, 2)))
    half = np.flatnonzero(known)[int(known.sum()) // 2]
    before, after = known & (np.arange(len(known)) < half), known & (np.arange(len(known)) >= half)
    lines = []
    for name, points in models.items():
        R, t = _frame((points[before] + up).reshape(-1, 3), seen[before].reshape(-1, 3))
        for frame, rows, positions in (
            ("origins at the base", known, points + up),
            ("fitted to the first half", after, (points + up) @ R.T + t),
        ):
            error = 1e3 * np.linalg.norm(positions[rows] - seen[rows], axis=-1)
            for marker, values in zip(("M1", "M2"), error.T, strict=True):
                lines.append((name, frame, marker, len(values), *np.percentile(values, [50, 75])))
    return pd.DataFrame(lines, columns=COLUMNS)


def _frame(positions: np.ndarray, markers: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Rotation and translation that take positions to markers best."""
    middle, target = positions.mean(axis=0), markers.mean(axis=0)
    left, _, right = np.linalg.svd((markers - target).T @ (positions - middle))
    R = left @ np.diag([1.0, 1.0, np.linalg.det(left @ right)]) @ right
    return R, target - R @ middle
