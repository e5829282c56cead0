"""Section 4.4 of Baaij et al. 2023 as rows of the scorecard."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import pandas as pd

from repro.kinematics.trajectories import STEPS
from repro_companion.pages.affine_curvature.method import ITERATIONS, ROW, STEP_SIZE
from repro_companion.twins.table_1_scorecard import BEST_METHOD, SETTING, scorecard_line

NOTES = {
    "mT": "nine networks of our own per seed against nine of the authors",
    "%": "nine networks of our own per seed against nine of the authors",
    "rad/m": "an angle [rad]: the released code integrates the curvature over the normalised coordinate",
    "rad/m^2": "an angle [rad]: the released code integrates the curvature over the normalised coordinate",
    "rad": "nine networks of our own per seed against nine of the authors",
    "mm": "the printed 0.001 does not belong to the printed 3.8 %, which are 0.21 mm of the range of 5.5 mm",
}


def affine_setting(iterations: int, step_size: Sequence[float], noise_mt: float, steps: int) -> str:
    """What the paper's method was run with: the released setting, and what differs from the released code."""
    own = {
        f"{iterations} evaluations": iterations != ITERATIONS,
        f"step sizes {list(step_size)}": tuple(step_size) != STEP_SIZE,
        f"noise {noise_mt:g} mT": noise_mt != 0,
        f"{steps} steps": steps != STEPS,
    }
    released = f"{SETTING}; magnets at 47 and 147 mm"
    return "; ".join([released, *(f"here {text}" for text, changed in own.items() if changed)])


def affine_rows(table: pd.DataFrame, best: pd.DataFrame, *, setting: str) -> list[dict[str, Any]]:
    """Rows of the scorecard from the errors of the paper's method.

    Parameters
    ----------
    table
        Columns ``row, seed, quantity, unit, error``.
    best
        Columns ``quantity, error_percent``: what ours reaches.
    setting
        From :func:`affine_setting`.
    """
    ours = dict(zip(best["quantity"], best["error_percent"], strict=True))
    cells = table.groupby(["quantity", "unit"], sort=False)["error"].agg(["mean", "std", "count"])
    rows = []
    for cell in cells.reset_index().to_dict("records"):
        quantity, unit = cell["quantity"], cell["unit"]
        numbers = (cell["mean"], cell["std"], cell["count"], setting)
        line = scorecard_line("Section 4.4", ROW, quantity, unit, *numbers) | {"note": NOTES[unit]}
        if unit == "mm":
            line["comparable"] = False
        if unit == "%":
            line |= {"best": ours[quantity], "best_method": BEST_METHOD}
        rows.append(line)
    return rows
