"""What a line of the benchmark is: two rates side by side, their ratio, and whether both targets are met."""

from __future__ import annotations

import math
import statistics
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

COLUMNS = (
    "capability",
    "kind",
    "ours",
    "unit",
    "reference",
    "ratio",
    "error",
    "target",
    "target_ratio",
    "met",
    "note",
)
"""Columns of the benchmark's table."""

KINDS = ("implementation", "solver", "model")
"""What differs between ours and the reference: how the same is computed, the solver on one model, or the model."""
SCALING = "scaling"
"""Kind of lines that are no ratio: ours is the exponent of the cost."""
ARITHMETIC = "arithmetic limit"
"""Kind of lines whose reference is the limit, and whose ratio the share of it that is reached."""

RELEASED_TRACKER = {1: 3.4, 3: 0.71}
"""Time steps per CPU second of the released tracker of Baaij et al. 2023, by number of segments."""
RELEASED_GENERATOR = {1: 140.0, 2: 67.0, 3: 35.0}
"""Configurations per CPU second of their released generator of training sets, by number of segments."""
RELEASED_FILTER = 42.0
"""Updates per CPU second of the released filter of Mitchell et al. 2021 with 1000 particles."""


@dataclass(frozen=True)
class Goal:
    """What a capability has to reach.

    Parameters
    ----------
    rate
        Smallest rate, in the unit of the row.
    ratio
        Smallest ratio to the reference.
    released
        Rate of the authors' released code on a core like this one: a slower reference does not count.
    """

    rate: float | None = None
    ratio: float | None = None
    released: float | None = None


NO_GOAL = Goal()


def rate(work: Callable[[], int], repeats: int = 5, least: float = 0.05) -> float:
    """Items per second of processor time: the median of some repeats.

    Parameters
    ----------
    work
        Returns the number of items. The first two calls do not count: they may compile.
    repeats
        Number of repeats.
    least
        Duration of a repeat [s]: short work is called again until it has taken so long.
    """
    work()
    start = time.process_time()
    work()
    calls = math.ceil(least / max(time.process_time() - start, 1e-6))
    found = []
    for _ in range(repeats):
        start = time.process_time()
        items = sum(work() for _ in range(calls))
        found.append(items / (time.process_time() - start))
    return statistics.median(found)


def row(
    capability: str,
    kind: str,
    unit: str,
    rates: tuple[float, float],
    error: float,
    note: str,
    goal: Goal = NO_GOAL,
) -> dict[str, Any]:
    """Line of the table.

    Parameters
    ----------
    capability
        What is measured; no two lines have the same.
    kind
        One of :data:`KINDS`.
    unit
        Of both rates; more is better.
    rates
        Ours and the reference's.
    error
        Largest difference to the reference for the same input, or of estimates to the truth; the note says which, and
        the unit.
    note
        What the reference is.
    goal
        The targets. ``met`` is blank without any, and false where the reference does not count.
    """
    ours, reference = rates
    counts = goal.released is None or reference >= goal.released
    met = None
    if goal.rate is not None or goal.ratio is not None:
        met = ours >= (goal.rate or 0.0) and ours >= (goal.ratio or 0.0) * reference and counts
    if goal.released is not None:
        verdict = "counts" if counts else "DOES NOT COUNT"
        note += f"; the reference {verdict}: the released code makes {goal.released:g} per CPU second"
    return {
        "capability": capability,
        "kind": kind,
        "ours": ours,
        "unit": unit,
        "reference": reference,
        "ratio": ours / reference,
        "error": error,
        "target": goal.rate,
        "target_ratio": goal.ratio,
        "met": met,
        "note": note,
    }
