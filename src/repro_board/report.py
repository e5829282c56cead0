"""What a command says and writes: reports, tables of errors, pictures, and sentences about sensors."""

from __future__ import annotations

import io
import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from scipy.stats import chi2 as chi_square

from repro.common import Array, whole
from repro.estimators.calibration import Calibration
from repro.estimators.track import Trajectory
from repro.tolerances import in_words
from repro_board.record import Note

_COVERED = 0.95
MEANING = {
    "inconsistent": "the readings do not fit together, and no single sensor explains it "
    "(unit, order or sign of the columns wrong, or not calibrated?)",
    "frozen": "the board repeats itself: all readings are old",
    "undetermined": "there are fewer readings than unknowns",
    "beyond bounds": "the readings fit only beyond the bounds of the robot file; the shape stays within",
    "unchecked": "the fit uses up all readings: a wrong one would look like another shape",
}
"""What a status says of a row, in words."""


@dataclass(frozen=True)
class Report:
    """What a command did: ``str`` gives the words for its user, ``found`` the numbers."""

    text: str
    found: Any

    def __str__(self) -> str:
        """Return the words."""
        return self.text


def written(path: Path, text: str, owner: str) -> str:
    """Write a text, whole or not at all, and say so."""
    with whole(path, owner) as part:
        part.write_text(text, encoding="utf-8", newline="\n")
    return f"Written: {path.name}"


def csv(frame: pd.DataFrame) -> str:
    """Return a table as text; times keep their microseconds however large they are."""
    frame = frame.assign(time_s=frame["time_s"].map("{:.6f}".format)) if "time_s" in frame else frame
    return frame.to_csv(index=False, lineterminator="\n", float_format="%.7g")


def some(words: Sequence[object]) -> str:
    """Return the first five of some words, and how many more there are."""
    rest = f" and {len(words) - 5} more" if len(words) > 5 else ""
    return ", ".join(map(str, words[:5])) + rest


def suspicions(shape: Trajectory) -> list[str]:
    """Say in sentences which sensors do not fit the others, and what else the monitor found."""
    n, counts = len(shape.times), Counter(np.asarray(shape.status).tolist())
    lines = [f"In {counts[name]} of {n} rows {text}." for name, text in MEANING.items() if counts[name]]
    for name, rows in zip(shape.robot.part_names, np.asarray(shape.suspects).T, strict=True):
        if rows.any():
            first, last = shape.times[rows][[0, -1]]
            when = f"{rows.sum()} of {n} rows, from {first:.3f} to {last:.3f} s"
            lines.append(f"Suspected: {name} does not fit the other sensors in {when}.")
    lines += [
        f"{name} is at a bound of the robot in {rows} of {n} rows."
        for name, rows in shape.at_bounds().items()
    ]
    return lines or ["All rows are consistent, and no sensor is suspected."]


def tip_known(frame: pd.DataFrame) -> str:
    """Say how well the tip is known."""
    tip = np.sqrt(np.square(frame[[f"tip_{axis}_sd_mm" for axis in "xyz"]].to_numpy()).sum(1))
    middle, worst = float(np.median(tip)), float(tip.max())
    known_to = f"known to ±{middle:.2g} mm in most rows" if middle < 1e3 else "not known in most rows"
    return f"tip: {known_to}" + (f", ±{worst:.2g} mm in the worst" if middle < 1e3 and worst < 1e3 else "")


def calibration_report(found: Calibration, q: Array, u: Array) -> str:
    """Say what poses have determined, and what they leave of the readings."""
    n, models = found.robot.n_magnetic, (found.described, found.robot)
    before, after = (np.sqrt(np.square(u - x.sensing()(q))[:, :n].mean()) for x in models)
    kept = [
        in_words(found.robot, name)
        for name, now, prior in zip(found.names, found.deviation, found.tolerances, strict=True)
        if now > 0.9 * prior
    ]
    undetermined = f"{len(kept)} parameters stay as uncertain as before: {some(kept)}." if kept else ""
    lines = [
        repr(found),
        f"Residual of the readings: {before:.3g} mT as described, {after:.3g} mT calibrated.",
        undetermined or "The poses determine every parameter better than its tolerance.",
    ]
    return "\n".join(lines)


def errors_table(measured: Trajectory, sigma: Array, shapes: Mapping[str, Trajectory]) -> pd.DataFrame:
    """Return errors by estimate and quantity, and how often 95 % regions hold the measured pose, itself uncertain.

    ``grown`` is how many times larger every ± must be stated for them to hold it in 95 % of the rows.
    """
    rows, robot, units = [], measured.robot, measured.units()
    for name, shape in shapes.items():
        use = np.isfinite(measured.q).all(1) & np.isfinite(shape.q).all(1)
        e = robot.free_angles.difference(shape.q[use], measured.q[use])
        tip, G = robot.tip_slopes(shape.q[use])
        away = tip - robot.tip_slopes(measured.q[use])[0]
        C = None if shape.covariance is None else shape.covariance[use] + sigma
        parts = [("tip", "mm", 1e3 * away, 1e3 * G)]
        for c in np.flatnonzero(~robot.fixed):
            quantity, unit, factor = units[c]
            parts.append((quantity, unit, factor * e[:, [c]], factor * np.eye(robot.n_q)[[c]]))
        for quantity, unit, error, slopes in parts:
            dof = min(error.shape[1], (~robot.fixed).sum())
            about = {"estimate": name, "quantity": quantity, "unit": unit}
            covered = _coverage(error, None if C is None else slopes @ C @ slopes.mT, dof)
            rows.append(about | _sizes(error) | covered | {"rows": len(error)})
    return pd.DataFrame(rows)


def _sizes(error: Array) -> dict[str, float]:
    size = np.linalg.norm(error, axis=1)
    found = {"mean": size.mean(), "rmse": np.sqrt(np.square(size).mean()), "largest": size.max()}
    return found | {"p95": np.quantile(size, 0.95)}


def _coverage(error: Array, covariance: Array | None, dof: int) -> dict[str, float]:
    """Return in how many rows [%] a region holds errors ``[t, k]``, and how many times it must be larger."""
    if covariance is None:
        return {"coverage": math.nan, "grown": math.nan}
    score = np.einsum("ti,tij,tj->t", error, np.linalg.pinv(covariance, rcond=1e-9, hermitian=True), error)
    limit = chi_square.ppf(_COVERED, dof)
    grown = math.sqrt(np.quantile(score, _COVERED) / limit)
    return {"coverage": 100 * float((score <= limit).mean()), "grown": grown}


def notes_in_words(notes: Sequence[Note]) -> list[str]:
    """Return what was noted, a line for each note, with its number in the picture."""
    lines = [f"{k:4} {note.time_s:9.2f}  {note.text}" for k, note in enumerate(notes, 1)]
    return ["Notes with their times [s], numbered as in estimates.png:", *lines] if lines else []


def picture(
    frames: Mapping[str, pd.DataFrame],
    units: Sequence[tuple[str, str, float]],
    notes: Sequence[Note] = (),
) -> bytes:
    """Draw measured and estimated coordinates, and the error of the tip, over time, and numbers of notes."""
    from matplotlib import style
    from matplotlib.figure import Figure

    with style.context("default", after_reset=True):  # whatever the user has set
        figure = Figure(figsize=(8.0, 1.6 * len(units) + 2.6), layout="constrained")
        axes, tip = figure.subplots(len(units) + 1, 1, sharex=True), [f"tip_{axis}_mm" for axis in "xyz"]
        for k, (name, frame) in enumerate(frames.items()):
            look = {"lw": 1.0 if k else 3.0, "color": f"C{k - 1}" if k else "0.7", "label": name}
            look["ls"] = ":" if name.startswith("as described") else "-"
            for ax, (quantity, unit, _) in zip(axes, units, strict=False):
                ax.set_ylabel(f"{quantity}\n[{unit}]")
                if k == 0 or name.startswith("calibrated"):
                    ax.plot(frame["time_s"], frame[f"{quantity}_{unit}" if unit else quantity], **look)
            away = np.linalg.norm(frame[tip].to_numpy() - frames["measured"][tip].to_numpy(), axis=1)
            axes[-1].semilogy(frame["time_s"], np.where(away > 0, away, np.nan), **look)
        begin, end = frames["measured"]["time_s"].iloc[[0, -1]]
        there = [(k, note.time_s) for k, note in enumerate(notes, 1) if begin <= note.time_s <= end]
        for k, time_s in there:
            axes[0].annotate(k, (time_s, 1.02), xycoords=("data", "axes fraction"), ha="center", fontsize=8)
            for ax in axes:
                ax.axvline(time_s, color="0.3", lw=0.8, ls="--")
        axes[-1].set(xlabel="time of the readings [s]", ylabel="error of the tip\n[mm]")
        figure.legend(*axes[-1].get_legend_handles_labels(), loc="outside upper center", ncols=2)
        picture = io.BytesIO()
        figure.savefig(picture, dpi=150, metadata={"Software": None})
    return picture.getvalue()
