"""The studies of the page on noise, tolerances and the size of the training data."""

from __future__ import annotations

from collections.abc import Sequence

from edition1_companion.book.studies import Study
from edition1_companion.pages.noise_and_tolerances.data_size import MODELS as TRAINED
from edition1_companion.pages.noise_and_tolerances.data_size import PAPER, SIZES, data_size_errors
from edition1_companion.pages.noise_and_tolerances.noise import MODELS, NOISE_MT, noise_errors
from edition1_companion.pages.noise_and_tolerances.tolerances import FACTORS, KINDS, tolerance_errors
from edition1_companion.twins.calibration_session import SENSOR_NOISE_MT
from edition1_companion.twins.table_1_method import SOLVERS

DESCENT, SQUARES = SOLVERS
DESCENTS = {1: MODELS, 2: MODELS[:1], 3: MODELS[:1]}
"""Models by number of segments: minutes a robot, so that with more segments it is the paper's alone."""


def _noise(name: str, n_segments: int, models: Sequence[str], solver: str) -> Study:
    settings = {
        "n_segments": n_segments,
        "models": list(models),
        "solvers": [solver],
        "noise_mt": list(NOISE_MT),
        "seeds": [0, 1, 2],
        "ring_name": "released",
        "steps": 400,
        "samples": 120_000,
    }
    return Study(name, noise_errors, settings, ("folder", "progress"))


def _tolerances(n_segments: int) -> Study:
    settings = {
        "n_segments": n_segments,
        "kinds": list(KINDS),
        "factors": list(FACTORS),
        "draws": 20,
        "seed": 0,
        "ring_name": "released",
        "steps": 50,
    }
    return Study(f"tolerances_nb{n_segments}", tolerance_errors, settings)


def _data_size() -> Study:
    settings = {
        "n_segments": 1,
        "sizes": list(SIZES),
        "seeds": [0, 1, 2],
        "models": [PAPER, *TRAINED],
        "noise_mt": SENSOR_NOISE_MT,
        "steps": 400,
    }
    return Study("data_size", data_size_errors, settings, ("folder", "progress"))


NOISE = (
    *(_noise(f"noise_nb{n}", n, MODELS, SQUARES) for n in (1, 2, 3)),
    *(_noise(f"noise_descent_nb{n}", n, models, DESCENT) for n, models in DESCENTS.items()),
)
TOLERANCES = tuple(_tolerances(n) for n in (1, 3))
DATA_SIZE = _data_size()
STUDIES = (*NOISE, *TOLERANCES, DATA_SIZE)
