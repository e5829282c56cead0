"""The printed numbers of Martin et al. (2022) as rows of the scorecard: Table II, Figs 3 to 5, sections IV-A to C."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd
from jaxtyping import Float

from edition1_companion.pages.imu_markers.calibration import FULL
from edition1_companion.recordings.martin2022_models import MARKERS
from edition1_companion.twins.arm_markers import DESCRIBED, EVALUATIONS, FILES, PCC_16, RIGID_8, SAME_POINT

SETTING = "synthetic"
BEST_METHOD = (
    "tangent spline of eight IMUs, calibrated on the first 60 s, judged on the rest; synthetic, 10 draws"
)
CAPABILITY = "first edition: PCC-extended chain, 8 IMUs, 16 segments [samples/s]"
"""Name of the rate in samples per CPU second in ``data/benchmark.csv``."""
SAMPLES = 8000
"""Samples of the paper's trial (section III-C)."""
TIME_NOTE = (
    "CPU seconds of one core for 8,000 samples; the printed 18 minutes are of another computer, and the times in the "
    "released pcc2.csv span 20.7 min, so replay may be included: no ratio is stated"
)
KEY = ["artefact", "row", "quantity", "unit"]
REDUCTION = "PCC-extended error against rigid-body"
_PERCENT_OF_MM = {f"M{k + 1}": 100 / (1e3 * arc) for k, arc in enumerate(MARKERS)}
_QUANTITIES = {"median": "median_mm", "q3": "q75_mm"}


@dataclass(frozen=True)
class Printed:
    """A printed error and the model that it belongs to."""

    artefact: str
    row: str
    quantity: str
    unit: str
    cases: tuple[str, ...]
    marker: str
    note: str = ""


def printed_errors() -> Iterator[Printed]:
    """All printed errors; of "16 segments and more" the mean is taken."""
    slip = {
        "M1": "section IV-B prints 13.6 % for the same",
        "M2": "section IV-B prints 11.5 % for the same",
    }
    for marker in ("M1", "M2"):
        for quantity in _QUANTITIES:
            note = slip[marker] if quantity == "median" else ""
            yield Printed("Table II", f"{marker} rigid-body", quantity, "%", (RIGID_8,), marker, note)
            yield Printed("Table II", f"{marker} PCC-extended", quantity, "%", (PCC_16,), marker)
    for n in (2, 4, 8):
        rigid, pcc = f"rigid-body, {n} IMUs", f"PCC-extended, {n} IMUs, 16 segments"
        yield Printed("Section IV-B", f"M1 rigid-body {n} IMUs", "median", "%", (rigid,), "M1")
        for marker in ("M1", "M2"):
            for quantity in _QUANTITIES:
                name = f"{marker} rigid-body {n} IMUs"
                yield Printed("Fig. 3", name, quantity, "mm", (rigid,), marker, "read off the figure")
                name = f"{marker} PCC-extended 16 segments {n} IMUs"
                yield Printed("Fig. 5", name, quantity, "mm", (pcc,), marker, "read off the figure")
    for model, case in (("rigid-body", RIGID_8), ("PCC-extended", PCC_16)):
        yield Printed("Section IV-A", f"{model} 8 IMUs", "median", "mm", (case,), "M1", "taken for marker M1")
    eight, more = ("PCC-extended, 8 IMUs, 8 segments",), (32, 64)
    finer = (PCC_16, *(f"PCC-extended, 8 IMUs, {n} segments" for n in more))
    yield Printed("Fig. 4", "M1 PCC-extended 8 segments", "q3", "%", eight, "M1")
    yield Printed(
        "Fig. 4", "M1 PCC-extended 16 segments and more", "q3", "%", finer, "M1", "mean of 16, 32, 64"
    )
    for marker in ("M1", "M2"):
        name = f"{marker} PCC-extended 8 IMUs 16 segments"
        yield Printed("Section IV-C", name, "q3", "mm", (PCC_16,), marker)


def scorecard_rows(table: pd.DataFrame, best: pd.DataFrame | None = None) -> list[dict[str, Any]]:
    """Rows of the scorecard: evaluated as in the released files; the other two evaluations stand in the note.

    None can be compared: the printed numbers are of hardware, these of a synthetic trial.

    Parameters
    ----------
    table
        Quantiles per draw, columns as from ``marker_errors``. Rows whose cases are not in it are left out.
    best
        Errors of the calibrated models, columns of the study ``martin_calibration``: what ours reaches.
    """
    found = table.drop_duplicates(["case", "evaluation", "marker", "draw"])
    rows = []
    for printed in printed_errors():
        ways = {way: _by_draw(found, printed, way) for way in EVALUATIONS}
        if ways[FILES].size:
            rows.append(_row(printed, ways) | _best(printed, best))
    return [*rows, *_reduction(found)]


def three_ways(table: pd.DataFrame, published: pd.DataFrame) -> pd.DataFrame:
    """The printed errors beside ours, evaluated three ways.

    Parameters
    ----------
    table
        As for :func:`scorecard_rows`.
    published
        Columns ``paper, artefact, row, quantity, unit, value``.

    Returns
    -------
    DataFrame
        Columns ``artefact, row, quantity, unit, paper`` and one per evaluation, means over the draws.
    """
    own = published[published["paper"] == "martin2022"]
    values = own.set_index(KEY)["value"].to_dict()
    found = table.drop_duplicates(["case", "evaluation", "marker", "draw"])
    lines = []
    for printed in printed_errors():
        key = (printed.artefact, printed.row, printed.quantity, printed.unit)
        ways = {way: _by_draw(found, printed, way) for way in EVALUATIONS}
        if ways[FILES].size:
            means = {way: numbers.mean() for way, numbers in ways.items()}
            lines.append(dict(zip(KEY, key, strict=True)) | {"paper": values[key]} | means)
    return pd.DataFrame(lines)


def time_rows(benchmark: pd.DataFrame) -> list[dict[str, Any]]:
    """Row of the computing time from ``data/benchmark.csv``; none while the benchmark has not measured it.

    Parameters
    ----------
    benchmark
        Columns ``capability, figure``; the figure in samples per CPU second.
    """
    measured = benchmark[benchmark["capability"] == CAPABILITY]
    return [
        {
            "paper": "martin2022",
            "artefact": "Section IV-A",
            "row": "PCC-extended time for 250 s of data",
            "quantity": "time",
            "unit": "s",
            "regenerated": SAMPLES / rate,
            "setting": "benchmark",
            "note": TIME_NOTE,
        }
        for rate in measured["figure"]
    ]


def _by_draw(found: pd.DataFrame, printed: Printed, evaluation: str) -> Float[np.ndarray, " draws"]:
    """One number per draw, in the printed unit; none where the case was not run."""
    here = found[found["case"].isin(printed.cases) & (found["evaluation"] == evaluation)]
    here = here[here["marker"] == printed.marker]
    error_mm = here.groupby("draw")[_QUANTITIES[printed.quantity]].mean()
    return np.asarray(error_mm, dtype=float) * (
        _PERCENT_OF_MM[printed.marker] if printed.unit == "%" else 1.0
    )


def _row(printed: Printed, ways: Mapping[str, np.ndarray]) -> dict[str, Any]:
    others = [f"{way} {ways[way].mean():.3g}" for way in (DESCRIBED, SAME_POINT)]
    numbers = ways[FILES]
    return {
        "paper": "martin2022",
        "artefact": printed.artefact,
        "row": printed.row,
        "quantity": printed.quantity,
        "unit": printed.unit,
        "regenerated": numbers.mean(),
        "regenerated_std": numbers.std(ddof=1) if len(numbers) > 1 else None,
        "n_seeds": len(numbers),
        "setting": SETTING,
        "note": "; ".join(filter(None, (printed.note, "evaluated " + "; ".join(others)))),
        "comparable": False,
    }


def _best(printed: Printed, best: pd.DataFrame | None) -> dict[str, Any]:
    """What the calibrated spline reaches, for the rows of the paper's best model."""
    if best is None or printed.cases != (PCC_16,):
        return {}
    point_mm = 1e3 * MARKERS[int(printed.marker[1]) - 1]
    here = best[(best["method"] == "spline" + FULL) & (best["mode"] == "all")]
    error = here.loc[(here["point_mm"] - point_mm).abs() < 1e-6, _QUANTITIES[printed.quantity]].mean()
    scale = _PERCENT_OF_MM[printed.marker] if printed.unit == "%" else 1.0
    return {"best": error * scale, "best_method": BEST_METHOD}


def _reduction(found: pd.DataFrame) -> list[dict[str, Any]]:
    """By how much the median of the PCC-extended model is lower, mean of both markers."""
    if not {RIGID_8, PCC_16} <= set(found["case"]):
        return []
    medians = found.set_index(["evaluation", "case", "draw", "marker"])["median_mm"].unstack("marker")
    printed = Printed(
        "Section IV-A", REDUCTION, "reduction", "%", (RIGID_8, PCC_16), "M1 and M2", "of the medians"
    )
    ways = {}
    for way in EVALUATIONS:
        pcc, rigid = (medians.loc[(way, case)].to_numpy(dtype=float) for case in (PCC_16, RIGID_8))
        ways[way] = 100 * (1 - pcc / rigid).mean(axis=1)
    return [_row(printed, ways)]
