"""Studies that take minutes: computed once, committed as tables with the settings that they were made with.

A study is a function and its settings. ``<name>.csv`` holds what the function returns and ``<name>.json`` the
settings, so that a page can say what its numbers belong to, and a change of the settings is noticed.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pandas as pd

from repro.errors import bad_input
from repro.experiments.baaij2023.data_size import MODELS as TRAINED
from repro.experiments.baaij2023.data_size import PAPER, SIZES, data_size_errors
from repro.experiments.baaij2023.noise import MODELS, NOISE_MT, noise_errors
from repro.experiments.baaij2023.robustness import FAMILIES, TWINS, robustness_errors
from repro.experiments.baaij2023.session import SENSOR_NOISE_MT
from repro.experiments.baaij2023.solvers import SOLVERS
from repro.experiments.baaij2023.table1_factors import NEW_ORDER, OTHER_DRAWS, factor_errors
from repro.experiments.baaij2023.tolerances import FACTORS, KINDS, tolerance_errors
from repro.experiments.closed_loop.estimators import changed_errors, estimator_errors, twin_errors
from repro.experiments.closed_loop.tables import cause_errors, loop_errors
from repro.experiments.martin2022.calibration import DRAWS, EVERY, FIRST_S, over_sensors
from repro.experiments.mitchell2021.study import particle_studies
from repro.report.files import write_whole
from repro.report.project import find_project

DIGITS = 5
"""Significant digits of a number in the tables."""
CACHED = ("cache", "progress")
"""What studies that train networks take."""


@dataclass(frozen=True)
class Study:
    """A table that takes long.

    Parameters
    ----------
    name
        Of the two files, without ending.
    compute
        Function that returns the table.
    settings
        Its keyword arguments, as JSON can hold them.
    needs
        Which of ``data`` (the folder), ``folder`` (of the trained networks), ``cache`` (of networks that are not
        kept) and ``progress`` the function takes besides.
    """

    name: str
    compute: Callable[..., pd.DataFrame]
    settings: dict[str, Any]
    needs: tuple[str, ...] = ()


def studies() -> tuple[Study, ...]:
    """All studies of the papers' methods and ours, with the settings of the committed tables."""
    descent, squares = SOLVERS
    descents = {
        1: MODELS,
        2: MODELS[:1],
        3: MODELS[:1],
    }  # minutes a robot: with more segments the paper's alone
    factors = {NEW_ORDER: [1, 2, 3], OTHER_DRAWS: [2]}  # two segments: the errors furthest from print
    return (
        *(_noise(f"noise_nb{n}", n, MODELS, squares) for n in (1, 2, 3)),
        *(_noise(f"noise_descent_nb{n}", n, models, descent) for n, models in descents.items()),
        *(_tolerances(n) for n in (1, 3)),
        _data_size(),
        Study("table_1_factors", factor_errors, {"robots": factors, "seeds": [0, 1, 2]}, CACHED),
        *(_robustness(family) for family in FAMILIES),
        *(Study(*x) for x in particle_studies()),
        *_closed_loop(),
        _martin_calibration(),
    )


def _closed_loop() -> tuple[Study, ...]:
    settings = {"seeds": list(range(12)), "duration_s": 25.0}
    return (
        Study("closed_loop", loop_errors, settings),
        Study("loop_causes", cause_errors, settings),
        Study("loop_estimators", estimator_errors, settings),
        Study("loop_changed", changed_errors, {"seeds": [0, 1, 2, 3], "duration_s": 25.0}),
        Study("loop_twins", twin_errors, {"twins": [2, 3, 4, 7], "seeds": [0, 1], "duration_s": 25.0}),
    )


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


def _robustness(family: str) -> Study:
    settings = {"family": family, "twins": list(TWINS), "seed": 0, "longest_s": 60.0}
    return Study(f"robustness_{family.replace(' ', '_')}", robustness_errors, settings, CACHED)


def _martin_calibration() -> Study:
    settings = {"draws": list(range(DRAWS)), "first_s": FIRST_S, "every": EVERY}
    return Study("martin_calibration", over_sensors, settings, ("data", "progress"))


def write_studies(folder: Path, further: Sequence[Study] = (), *, progress: bool) -> list[Path]:
    """Compute the studies whose files are missing or belong to other settings; return the paths of all tables.

    A study is written as a whole when it is done, so that an interrupted call goes on with the next one. A change
    of the code alone is not noticed: remove a table to have it computed anew.

    Parameters
    ----------
    folder
        Where the tables are, ``data/studies``.
    further
        Studies besides :func:`studies`.
    progress
        Name each study on standard error as it starts, with progress bars.
    """
    project = find_project()
    available = {
        "data": project.data,
        "folder": project.data / "networks",
        "cache": project.cache / "networks",
        "progress": progress,
    }
    paths = []
    for study in (*studies(), *further):
        path = folder / f"{study.name}.csv"
        paths.append(path)
        if path.is_file() and _settings(path) == study.settings:
            continue
        if progress:
            print(study.name, file=sys.stderr, flush=True)
        table = study.compute(**study.settings, **{name: available[name] for name in study.needs})
        path.with_suffix(".json").unlink(missing_ok=True)  # never old settings beside a new table
        write_whole(path, table.to_csv(index=False, float_format=f"%.{DIGITS}g", lineterminator="\n"))
        write_whole(path.with_suffix(".json"), json.dumps(study.settings, indent=1) + "\n")
    return paths


def read_study(name: str, folder: Path | None = None) -> tuple[pd.DataFrame, dict[str, Any]]:
    """Table of a study and the settings that it was made with.

    Parameters
    ----------
    name
        Of the study.
    folder
        ``data/studies`` of the project when not given.

    Raises
    ------
    InputError
        If one of its two files is missing.
    """
    path = (folder or find_project().data / "studies") / f"{name}.csv"
    settings = _settings(path)
    if settings is None or not path.is_file():
        raise bad_input(
            "name", "read_study", "a study in data/studies with its settings (make studies)", name
        )
    return pd.read_csv(path), settings


def committed(kind: str, folder: Path | None = None) -> pd.DataFrame:
    """Tables of all studies whose name begins with ``kind``, one below the other.

    Parameters
    ----------
    kind
        ``"noise"``, ``"tolerances"``, ``"data_size"`` or ``"robustness"``.
    folder
        ``data/studies`` of the project when not given.

    Raises
    ------
    InputError
        If there is no such study, or one of its files is missing.
    """
    names = [study.name for study in studies() if study.name.startswith(kind)]
    if not names:
        raise bad_input("kind", "committed", "the start of a study's name", kind)
    return pd.concat([read_study(name, folder)[0] for name in names], ignore_index=True)


def settings_of_studies(kinds: Sequence[str], folder: Path | None = None) -> pd.DataFrame:
    """Settings that tables in ``data/studies`` were made with, as they stand beside them.

    Columns ``setting, value, studies``: the last names all studies that share the value.

    Parameters
    ----------
    kinds
        Studies whose names begin with one of these.
    folder
        ``data/studies`` of the project when not given.
    """
    shared: dict[tuple[str, str], list[str]] = {}
    for study in (x for x in studies() if x.name.startswith(tuple(kinds))):
        for key, value in read_study(study.name, folder)[1].items():
            shared.setdefault((key, _in_words(value)), []).append(study.name)
    lines = [(*key, ", ".join(names)) for key, names in sorted(shared.items())]
    return pd.DataFrame(lines, columns=["setting", "value", "studies"])


def _settings(path: Path) -> dict[str, Any] | None:
    sidecar = path.with_suffix(".json")
    return json.loads(sidecar.read_text(encoding="utf-8")) if sidecar.is_file() else None


def _in_words(value: Any) -> str:
    return ", ".join(map(str, value)) if isinstance(value, list) else str(value)
