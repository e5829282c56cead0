"""The studies of the placement page that take minutes: more robots, more starts, one freedom after the other."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from functools import cache, partial

import pandas as pd
import torch

from edition1_companion.book.studies import Study
from edition1_companion.pages.sensor_placement.errors import errors_by_layout, field_check, measured_errors
from edition1_companion.pages.sensor_placement.layouts import Layout, Room
from edition1_companion.pages.sensor_placement.search import Settings, search
from edition1_companion.pages.sensor_placement.tasks import (
    NOISE_MT,
    Task,
    affine_task,
    guaranteed_error,
    mean_errors,
    pcc_task,
)

NOMINAL = "nominal"
"""Name of the layout of the paper."""
OPTIMISED = "optimised"
"""With a limit on the error from tolerances."""
NOISE_ONLY = "optimised for noise alone"
"""Without that limit."""
QUARTER = "90 degrees apart"
"""Two sensors per segment a quarter turn apart instead of opposite each other."""
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
        :func:`~edition1_companion.pages.sensor_placement.search.search` with the columns ``task`` and
        ``layout`` in front.
    """
    layouts = {NOMINAL: task.nominal}
    if guaranteed_error(task, task.nominal, noise_mt=noise_mt) > OPEN_PERCENT:
        layouts[QUARTER] = quarter_turn(task.nominal)
    reference = layouts[reference_name(layouts)]
    tables = {}
    for name, limit in ((OPTIMISED, Settings().limit), (NOISE_ONLY, math.inf)):
        settings = Settings(limit=limit, iterations=iterations, noise_mt=noise_mt)
        found = search(task, settings, starts=starts, seed=seed, reference=reference)
        layouts[name], tables[task.name, name] = found
    return layouts, _labelled(tables)


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
    noise, tolerance = mean_errors(task, layout, noise_mt, q)
    guaranteed = guaranteed_error(task, layout, q, noise_mt=noise_mt)
    return {"noise_percent": noise, "tolerance_percent": tolerance, "guaranteed_percent": guaranteed}


def layouts_table(task: Task, layouts: Mapping[str, Layout]) -> pd.DataFrame:
    """Parts of several layouts: ``task``, ``layout``, and the columns of :meth:`Layout.table`."""
    return _labelled({(task.name, name): layout.table() for name, layout in layouts.items()})


def _labelled(tables: Mapping[tuple[str, str], pd.DataFrame]) -> pd.DataFrame:
    """Tables below each other, ``task`` and ``layout`` in front."""
    names = ["task", "layout"]
    return pd.concat(tables, names=names).reset_index(level=names).reset_index(drop=True)


def expected_table(task: Task, layouts: Mapping[str, Layout], noise_mt: float = NOISE_MT) -> pd.DataFrame:
    """Errors to be expected of layouts, and what their field is like.

    Columns ``task``, ``layout``, those of :func:`expected` and of
    :func:`~edition1_companion.pages.sensor_placement.errors.field_check`.
    """
    rows = [
        {"task": task.name, "layout": name, **expected(task, layout, noise_mt)} | field_check(task, layout)
        for name, layout in layouts.items()
    ]
    return pd.DataFrame(rows)


def choices(*, shapes: int, steps: int, starts: int) -> pd.DataFrame:
    """Which freedom pays, what the limit of the tolerance error costs, and how many nominal sensors do the same.

    For one segment of constant curvature. Freedoms are compared at the limit of the nominal layout, 1.

    Returns
    -------
    DataFrame
        Columns ``study`` (``freedom``, ``limit`` or ``number``), ``setting`` and those of :func:`expected`; the
        limit itself in ``limit`` where there is one.
    """
    task, lines = pcc_task(1, shapes=shapes, steps=steps), []
    for n in (3, 4, 6, 12):
        more = pcc_task(1, n, steps=steps)
        numbers = expected(more, more.nominal)
        lines.append({"study": "number", "setting": f"{n} nominal sensors", "limit": math.nan, **numbers})
    common = Settings(limit=1.0)
    wanted = [("freedom", name, replace(common, free=free)) for name, free in FREEDOMS.items()]
    far = Room(magnet_to_sensor_m=NEAREST_M)
    wanted.append(("freedom", f"all, at least {1e3 * NEAREST_M:.0f} mm apart", replace(common, room=far)))
    wanted += [("limit", f"{limit:g}", replace(common, limit=limit)) for limit in LIMITS]
    for study, name, settings in wanted:
        layout = search(task, settings, starts=starts)[0]
        lines.append({"study": study, "setting": name, "limit": settings.limit, **expected(task, layout)})
    return pd.DataFrame(lines)


@cache
def _of_robots(shapes: int, steps: int, starts: int, draws: int) -> dict[str, pd.DataFrame]:
    """The four tables of all robots, about six minutes of one core: one search for layouts serves all."""
    size = {"shapes": shapes, "steps": steps}
    tasks = [pcc_task(1, **size), pcc_task(3, **size), affine_task(**size)]
    tasks.append(pcc_task(3, 2, known_elongation=True, **size))
    parts: dict[str, list[pd.DataFrame]] = {name: [] for name in ROBOT_TABLES}
    for task in tasks:
        layouts, starts_of_task = optimised_layouts(task, starts=starts)
        errors = measured_errors(task, layouts, draws=draws)
        parts["layouts"].append(layouts_table(task, layouts))
        parts["starts"].append(starts_of_task)
        parts["expected"].append(expected_table(task, layouts))
        parts["errors"].append(errors_by_layout(errors, reference=reference_name(layouts)))
    return {name: pd.concat(tables, ignore_index=True) for name, tables in parts.items()}


def _of_robots_named(name: str, **settings: int) -> pd.DataFrame:
    return _of_robots(**settings)[name]


ROBOT_TABLES = ("layouts", "starts", "expected", "errors")
"""Of :func:`layouts_table`, :func:`optimised_layouts`, :func:`expected_table` and
:func:`~edition1_companion.pages.sensor_placement.errors.errors_by_layout`."""
SIZE = {"shapes": 48, "steps": 100}
STUDIES = (
    *(
        Study(
            f"placement_{name}", partial(_of_robots_named, name), SIZE | {"starts": 4, "draws": 20}, digits=8
        )
        for name in ROBOT_TABLES
    ),
    Study("placement_choices", choices, SIZE | {"starts": 2}, digits=8),
)
