"""The studies of the placement page that take minutes: more robots, more starts, one freedom after the other."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from functools import partial
from pathlib import Path

import pandas as pd
import torch
from tqdm import tqdm

from repro.sensing.placement import Tolerances
from repro_companion.pages.sensor_placement.bounds import NOISE_MT, expected_errors, guaranteed_error
from repro_companion.pages.sensor_placement.errors import field_check, measured_errors, summary
from repro_companion.pages.sensor_placement.layouts import Layout, Room
from repro_companion.pages.sensor_placement.sensor_placement import Settings, search
from repro_companion.pages.sensor_placement.tasks import Task, affine_task, pcc_task

NOMINAL, OPTIMISED, NOISE_ONLY, QUARTER = (
    "nominal",
    "optimised",
    "optimised for noise alone",
    "90 degrees apart",
)
"""Names of layouts: of the paper; optimised with a limit on the error from tolerances; without that limit; two
sensors per segment a quarter turn apart instead of opposite each other."""
OPEN_PERCENT = 100.0
"""Guaranteed error above which a layout leaves a direction open: the whole range."""
FREEDOMS = {
    "tilts": ("tilt",),
    "magnets": ("magnet",),
    "heights and radii": ("axial", "radial"),
    "heights, radii, tilts": ("axial", "radial", "tilt"),
    "all": ("axial", "radial", "azimuth", "tilt", "magnet"),
}
"""What may change, by the name of the row."""
TABLES = ("layouts", "starts", "expected", "errors", "choices")
"""Committed tables, ``placement_<name>.csv``."""
LIMITS = (0.8, 0.9, 1.0, 1.25, math.inf)
"""Limits of the error from tolerances, relative to the nominal layout."""
NEAREST_M = 0.050
"""Distance of magnets and sensors [m] in the row that rules out gains by mere closeness; nominal is 56 mm."""


def optimised_layouts(
    task: Task, *, starts: int, seed: int = 0, iterations: int = 60, noise_mt: float = NOISE_MT
) -> tuple[dict[str, Layout], pd.DataFrame]:
    """Nominal and optimised layouts of a robot, and a line for every start.

    Where the nominal layout leaves a direction open, the layouts are optimised from, and compared with, pairs of
    sensors a quarter turn apart: the two sensors per segment of Table 1, opposite each other, hardly see the bending
    out of their plane even when the elongation is known.

    Returns
    -------
    tuple
        Layouts by their names, and the table of
        :func:`~repro_companion.pages.sensor_placement.sensor_placement.search` with the columns ``task`` and
        ``layout`` in front.
    """
    layouts = {NOMINAL: task.nominal}
    if guaranteed_error(task, task.nominal, noise_mt=noise_mt) > OPEN_PERCENT:
        layouts[QUARTER] = quarter_turn(task.nominal)
    reference = layouts[reference_name(layouts)]
    tables = []
    for name, limit in ((OPTIMISED, Settings().limit), (NOISE_ONLY, math.inf)):
        settings = Settings(limit=limit, iterations=iterations, noise_mt=noise_mt)
        layouts[name], table = search(task, settings, starts=starts, seed=seed, reference=reference)
        table.insert(0, "layout", name)
        tables.append(table)
    both = pd.concat(tables, ignore_index=True)
    both.insert(0, "task", task.name)
    return layouts, both


def reference_name(layouts: Mapping[str, Layout]) -> str:
    """Name of the layout that the optimised ones are compared with: the quarter turn where there is one."""
    return QUARTER if QUARTER in layouts else NOMINAL


def quarter_turn(layout: Layout) -> Layout:
    """Layout of pairs of sensors with the second of each pair a quarter turn from the first."""
    axial, radial, azimuth, tilt, magnet = layout.parts()
    azimuth = azimuth.clone()
    azimuth[1::2] = azimuth[::2] + math.pi / 2
    return layout.moved(torch.cat([axial, radial, azimuth, tilt, magnet]))


def expected(task: Task, layout: Layout, noise_mt: float = NOISE_MT) -> dict[str, float]:
    """Errors to be expected on the held-out random shapes: two means, and the guaranteed (largest) one."""
    q = task.tests["random shapes"]
    noise, tolerance = expected_errors(task, layout, q, noise_mt=noise_mt, tolerances=Tolerances())
    assert tolerance is not None
    return {
        "noise_percent": noise.mean().item(),
        "tolerance_percent": tolerance.mean().item(),
        "guaranteed_percent": guaranteed_error(task, layout, q, noise_mt=noise_mt),
    }


def layouts_table(task: Task, layouts: Mapping[str, Layout]) -> pd.DataFrame:
    """Parts of several layouts: ``task``, ``layout``, and the columns of :meth:`Layout.table`."""
    tables = [layout.table().assign(task=task.name, layout=name) for name, layout in layouts.items()]
    table = pd.concat(tables, ignore_index=True)
    first = ["task", "layout"]
    return table.reindex(columns=[*first, *(c for c in table.columns if c not in first)])


def expected_table(task: Task, layouts: Mapping[str, Layout], noise_mt: float = NOISE_MT) -> pd.DataFrame:
    """Errors to be expected of layouts, and what their field is like.

    Columns ``task``, ``layout``, those of :func:`expected` and of
    :func:`~repro_companion.pages.sensor_placement.errors.field_check`.
    """
    rows = [
        {"task": task.name, "layout": name, **expected(task, layout, noise_mt)} | field_check(task, layout)
        for name, layout in layouts.items()
    ]
    return pd.DataFrame(rows)


def choices(task: Task, *, starts: int, seed: int = 0) -> pd.DataFrame:
    """Which freedom pays, what the limit of the tolerance error costs, and how many nominal sensors do the same.

    For one segment of constant curvature. Freedoms are compared at the limit of the nominal layout, 1.

    Returns
    -------
    DataFrame
        Columns ``study`` (``freedom``, ``limit`` or ``number``), ``setting`` and those of :func:`expected`; the
        limit itself in ``limit`` where there is one.
    """
    steps = len(task.tests["random shapes"])
    lines = []
    for n in (3, 4, 6, 12):
        more = pcc_task(1, n, seed=seed, steps=steps)
        numbers = expected(more, more.nominal)
        lines.append({"study": "number", "setting": f"{n} nominal sensors", "limit": math.nan, **numbers})
    common = Settings(limit=1.0)
    wanted = [("freedom", name, replace(common, free=free)) for name, free in FREEDOMS.items()]
    far = Room(magnet_to_sensor_m=NEAREST_M)
    wanted.append(("freedom", f"all, at least {1e3 * NEAREST_M:.0f} mm apart", replace(common, room=far)))
    wanted += [("limit", f"{limit:g}", replace(common, limit=limit)) for limit in LIMITS]
    for study, name, settings in wanted:
        layout = search(task, settings, starts=starts, seed=seed)[0]
        lines.append({"study": study, "setting": name, "limit": settings.limit, **expected(task, layout)})
    return pd.DataFrame(lines)


def write_placement_study(folder: Path, *, progress: bool) -> list[Path]:
    """Write the studies that the placement page shows beside its own run, about six minutes of one core.

    Files: ``placement_layouts.csv`` (:func:`layouts_table`), ``placement_starts.csv`` (:func:`optimised_layouts`),
    ``placement_expected.csv`` (:func:`expected_table`), ``placement_errors.csv``
    (:func:`~repro_companion.pages.sensor_placement.errors.summary`) and ``placement_choices.csv`` (:func:`choices`).
    Nothing is computed where all of them are there: remove one to have them computed anew.

    Parameters
    ----------
    folder
        Where the files are written; it is created.
    progress
        Show a bar.

    Returns
    -------
    list of Path
        The files.
    """
    files = [folder / f"placement_{name}.csv" for name in TABLES]
    if all(path.is_file() for path in files):
        return files
    one = pcc_task(1, shapes=48, steps=100)
    robots = [one, pcc_task(3, shapes=48, steps=100), affine_task(shapes=48, steps=100)]
    robots.append(pcc_task(3, 2, known_elongation=True, shapes=48, steps=100))
    steps = [*(partial(_robot, task) for task in robots), lambda: {"choices": choices(one, starts=2)}]
    tables: dict[str, list[pd.DataFrame]] = {}
    for step in tqdm(steps, desc="placement", disable=not progress):
        for name, table in step().items():
            tables.setdefault(name, []).append(table)
    folder.mkdir(parents=True, exist_ok=True)
    for name, path in zip(TABLES, files, strict=True):
        table = pd.concat(tables[name], ignore_index=True)
        table.to_csv(path, index=False, float_format="%.8g", lineterminator="\n")
    return files


def _robot(task: Task) -> dict[str, pd.DataFrame]:
    layouts, starts = optimised_layouts(task, starts=4)
    errors = measured_errors(task, layouts, draws=20)
    return {
        "layouts": layouts_table(task, layouts),
        "starts": starts,
        "expected": expected_table(task, layouts),
        "errors": summary(errors, reference=reference_name(layouts)),
    }
