"""Layouts that a search finds for a robot, and the errors that they let expect."""

from __future__ import annotations

import math
from collections.abc import Mapping

import pandas as pd
import torch

from edition1_companion.pages.sensor_placement.errors import field_check
from edition1_companion.pages.sensor_placement.layouts import Layout
from edition1_companion.pages.sensor_placement.search import Settings, search
from edition1_companion.pages.sensor_placement.tasks import (
    NOISE_MT,
    Task,
    guaranteed_error,
    mean_errors,
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
