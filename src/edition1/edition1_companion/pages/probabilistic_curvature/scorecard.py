"""Sections II-D and IV of Mitchell et al. 2021 as rows of the scorecard."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pandas as pd

from edition1_companion.pages.probabilistic_curvature.simulation import BEST, FITS, PAPER, Setting
from edition1_companion.twins.bend_curves import CURVES, curve_times

SETTING = (
    "as printed: process noise 0.02 pi, L = 15 mm, noise-free; sigma 0.01 mT is not stated; start straight"
)
BEST_METHOD = (
    "weighted mean, constant velocity, 0.0005 pi (chosen on Spiral), 1000 particles; "
    "sensor noise 0.025 mT per axis, start straight"
)
CAPABILITY = "first edition: particle filter, N = 1000 [updates/s]"
"""Name of the update rate in ``data/benchmark.csv``."""


def setting(own: Setting = PAPER, steps: int | None = None) -> str:
    """What the paper's method was run with: what is printed, and what differs from it."""
    differing = {
        f"process noise {own.process_noise_pi:g} pi": own.process_noise_pi != PAPER.process_noise_pi,
        f"L = {1e3 * own.length_m:g} mm": own.length_m != PAPER.length_m,
        f"{steps} steps": steps is not None and steps < len(curve_times()),
    }
    return "; ".join([SETTING, *(f"here {text}" for text, differs in differing.items() if differs)])


def scorecard_rows(table: pd.DataFrame, *, setting: str = SETTING) -> list[dict[str, Any]]:
    """Rows of section II-D from errors with 1000 particles.

    Parameters
    ----------
    table
        Columns ``setting, particles, curve, rmse_mm``, with the settings ``PAPER``, and ``FITS`` and ``BEST`` where
        they were run; several rows of a setting and curve are seeds.
    setting
        What the errors were computed with, if it is not what the paper states.
    """
    cells = (
        table[table["particles"] == PAPER.particles]
        .groupby(["setting", "curve"])["rmse_mm"]
        .agg(["mean", "std", "count"])
    )
    rows = []
    for curve in CURVES:
        if (PAPER.name, curve) not in cells.index:
            continue
        own = cells.loc[PAPER.name, curve]
        line = {
            "paper": "mitchell2021",
            "artefact": "Section II-D",
            "row": curve,
            "quantity": "rmse_position",
            "unit": "mm",
            "regenerated": own["mean"],
            "regenerated_std": None if pd.isna(own["std"]) else own["std"],
            "n_seeds": int(own["count"]),
            "setting": setting,
            "note": "an average of 100 particles, spread by 0.02 pi, cannot come closer: see the page",
        }
        if (FITS.name, curve) in cells.index:
            fits = cells.loc[FITS.name, curve]["mean"]
            line["note"] = (
                f"the same equations at 0.005 pi and L = 14 mm, which fit but are not stated: {fits:.4f} mm"
            )
        if (BEST.name, curve) in cells.index:
            line |= {"best": cells.loc[BEST.name, curve]["mean"], "best_method": BEST_METHOD}
        rows.append(line)
    return rows


def update_rate_rows(benchmark: Path) -> list[dict[str, Any]]:
    """Row of section IV from ``data/benchmark.csv``; none while the benchmark has not measured it.

    Parameters
    ----------
    benchmark
        The file.
    """
    table = pd.read_csv(benchmark)
    measured = table[table["capability"] == CAPABILITY]
    return [
        {
            "paper": "mitchell2021",
            "artefact": "Section IV",
            "row": "1000 particles",
            "quantity": "update_rate",
            "unit": "Hz",
            "regenerated": ours,
            "setting": "benchmark",
            "note": "updates per second of one core's processor time; the printed 60 Hz is the rate of the sensor",
        }
        for ours in measured["figure"]
    ]
