"""Rows of the scorecard from errors by seed, and what the paper's method of Baaij et al. 2023 was run with."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

import pandas as pd

from edition1_companion.twins.table_1_method import ITERATIONS
from edition1_companion.twins.trajectories import STEPS

SETTING = "as released: ring 24/12 mm, start at ground truth, momentum carried"
BEST_METHOD = (
    "multipole model calibrated in 100 poses + Levenberg-Marquardt, start straight; "
    "robot off by 0.5 mm, 2 deg and 1 %, noise 7.1e-4 mT"
)


def setting(
    iterations: int,
    step_size: Sequence[float],
    noise_mt: float,
    steps: int,
    *,
    of_the_paper: Sequence[float] = (),
    released: str = SETTING,
) -> str:
    """What the paper's method was run with: the released setting, and what differs from the released code."""
    own = {
        f"{iterations} evaluations": iterations != ITERATIONS,
        f"step sizes {list(step_size)}": tuple(step_size) != tuple(of_the_paper),
        f"noise {noise_mt:g} mT": noise_mt != 0,
        f"{steps} steps": steps != STEPS,
    }
    return "; ".join([released, *(f"here {text}" for text, changed in own.items() if changed)])


def scorecard_lines(artefact: str, table: pd.DataFrame, setting: str) -> list[dict[str, Any]]:
    """Rows of the scorecard: means over the seeds of a table with columns ``row, seed, quantity, unit, error``."""
    by_cell = table.groupby(["row", "quantity", "unit"], sort=False)["error"]
    cells = by_cell.agg(["mean", "std", "count"]).reset_index()
    return [
        scorecard_line(artefact, *cell, setting) | {"note": note}
        for cell, note in zip(cells.itertuples(index=False), by_cell.agg(seeds_note), strict=True)
    ]


def seeds_note(errors: Iterable[float]) -> str:
    """What is known of a row beside its mean: the error of each seed."""
    return "of the single seeds: " + ", ".join(f"{error:.3g}" for error in errors)


def scorecard_line(
    artefact: str, row: str, quantity: str, unit: str, mean: float, std: float, count: int, setting: str
) -> dict[str, Any]:
    """One row of the scorecard, as `edition1_companion.book.results` writes it; a NaN std is left out."""
    line = {
        "paper": "baaij2023",
        "artefact": artefact,
        "row": row,
        "quantity": quantity,
        "unit": unit,
        "regenerated": mean,
        "n_seeds": count,
        "setting": setting,
    }
    return line if pd.isna(std) else line | {"regenerated_std": std}
