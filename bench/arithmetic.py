"""How far each kernel is from what the core's arithmetic allows: operations counted, throughput measured.

The limit is the time of all operations at full throughput, multiplications and additions two by two as one
instruction, and nothing else: no loads, comparisons, waiting for results. Kernels whose inner loops hold several
numbers per instruction are compared with the throughput of such instructions.
"""

from __future__ import annotations

import types
from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from edition1.kernels import _bend_series as compiled_bend_series
from edition1.kernels import _descent as compiled_descent
from edition1.kernels import _least_squares as compiled_least_squares
from edition1.kinematics.bend import MAX_BEND
from edition1.sensing.magnetic import MagneticSensing
from edition1_companion.pages.performance.rows import ARITHMETIC, rate, row
from edition1_companion.twins.bend_curves import LENGTH_M, bend_curve

from bench import compiled_arithmetic as one_operation
from bench import compiled_training_set
from bench.operation_count import counting
from bench.trackers import (
    Task,
    Trackers,
    advance,
    descent,
    least_squares,
    multipole,
    network_of_the_paper,
)

_SINGLE, _DOUBLE, _SCALAR = "single", "double", "scalar"


def throughput() -> dict[str, float]:
    """Operations per second of processor time on this core.

    ``scalar``: multiplications with addition, one number at a time, double precision; ``double`` and ``single``:
    several numbers at a time; then divisions, roots and functions, of one number each.
    """
    n, x = 200_000, np.linspace(0.5, 1.5, 4096)
    found = {_SCALAR: rate(lambda: (one_operation.multiply_add(0.5, 0.3, n), one_operation.CHAINS * n)[1])}
    for name, dtype in ((_DOUBLE, np.float64), (_SINGLE, np.float32)):
        given = x.astype(dtype), np.empty(4096, dtype), np.array([0.1, 0.2, 0.3, 0.4], dtype)

        def horner(given: tuple[np.ndarray, ...] = given) -> int:
            one_operation.polynomial(*given)
            return len(x) * one_operation.TERMS

        found[name] = rate(horner)
    kernels = {
        "div": one_operation.divide,
        "sqrt": one_operation.root,
        "sin": one_operation.sine,
        "cos": one_operation.cosine,
        "exp": one_operation.exponential,
        "log": one_operation.logarithm,
        "atan2": one_operation.arctangent,
    }
    many = np.tile(x, 200)
    return found | {name: rate(lambda k=kernel: (k(many), len(many))[1]) for name, kernel in kernels.items()}


def limit_rate(operations: Mapping[str, float], speed: dict[str, float], width: str = _SCALAR) -> float:
    """Items per second if only the operations of an item took time.

    Parameters
    ----------
    operations
        Of one item, by kind.
    speed
        From :func:`throughput`.
    width
        Which throughput counts for multiplications and additions: ``"scalar"``, ``"double"`` or ``"single"``.
    """
    seconds = (operations.get("add", 0.0) + operations.get("mul", 0.0)) / 2 / speed[width]
    seconds += sum(count / speed[kind] for kind, count in operations.items() if kind not in ("add", "mul"))
    return 1 / seconds


def operations(module: types.ModuleType, kernel: str, work: Callable[[], int]) -> dict[str, float]:
    """Operations per item of what a module's kernel does in ``work``, which returns the number of items."""
    with counting(module, kernel) as tally:
        items = work()
    return {kind: count / items for kind, count in tally.items()}


def arithmetic_rows(folder: Path, mlp: MagneticSensing) -> Iterator[dict[str, Any]]:
    """Lines of all kernels: ours and the limit in items per CPU second.

    Parameters
    ----------
    folder
        Where the trained networks are.
    mlp
        A fast network (64-64) of a robot of three segments.
    """
    speed, unit = throughput(), "time steps per CPU second"
    for n in (1, 3):
        trackers = least_squares(n, "multipole", multipole(n))
        yield _line(f"time step, {trackers.name}", unit, *_least_squares(trackers, n, 1000), speed, _SCALAR)
    trackers = least_squares(3, "MLP 64-64", mlp, seeds=True)
    yield _line(f"time step, {trackers.name}", unit, *_least_squares(trackers, 3, 200), speed, _DOUBLE)
    trackers = descent(3, "network of the paper", network_of_the_paper(3, folder), seeds=True)
    yield _line(f"time step, {trackers.name}", unit, *_descent(trackers), speed, _SINGLE)
    yield _line("training set, n_b = 3", "configurations per CPU second", *_training_set(), speed, _SCALAR)
    yield _line("field of the particle filter, N = 1000", "fields per CPU second", *_series(), speed, _DOUBLE)


def _line(
    name: str, unit: str, ours: float, counted: Mapping[str, float], speed: dict[str, float], width: str
) -> dict[str, Any]:
    kinds = ", ".join(f"{count:.4g} {kind}" for kind, count in sorted(counted.items()))
    instructions = {_SCALAR: "one number at a time", _DOUBLE: "vectors, double", _SINGLE: "vectors, single"}[
        width
    ]
    note = f"per item: {kinds}; multiply-add at {2e-9 * speed[width]:.3g} Gflop/s ({instructions})"
    return row(
        f"{ARITHMETIC}: {name}", ARITHMETIC, unit, (ours, limit_rate(counted, speed, width)), np.nan, note
    )


def _least_squares(trackers: Trackers, n: int, members: int) -> tuple[float, dict[str, float]]:
    task, seeds = Task(n, members), trackers.seeds
    few = replace(task, members=2, steps=1)
    counted = operations(
        compiled_least_squares,
        "_fit",
        lambda: advance(trackers.method, few, 2, seeds=seeds).shape[:2].numel(),
    )
    return rate(lambda: task.steps * len(advance(trackers.method, task, members, seeds=seeds)[0])), counted


def _descent(trackers: Trackers) -> tuple[float, dict[str, float]]:
    task = Task(3, 100, 2)
    few = replace(trackers.method, iterations=2), replace(trackers.method, iterations=3)
    one = replace(task, members=1, steps=1)
    tallies = [
        operations(compiled_descent, "_descend", lambda m=m: len(advance(m, one, 1, seeds=True))) for m in few
    ]
    # Iterations cost the same up to the nodes that a ReLU switches off: two and three stand for twenty.
    counted = {k: tallies[0][k] + 18 * (tallies[1][k] - tallies[0][k]) for k in tallies[0]}
    return rate(lambda: task.steps * len(advance(trackers.method, task, 100, seeds=True)[0])), counted


def _training_set() -> tuple[float, dict[str, float]]:
    def drawn(samples: int) -> int:
        return len(compiled_training_set.training_rows(3, seed=0, samples=samples).q)

    return rate(lambda: drawn(50_000)), operations(compiled_training_set, "_rows", lambda: drawn(10))


def _series() -> tuple[float, dict[str, float]]:
    series, q = compiled_bend_series.BendSeries(LENGTH_M, MAX_BEND), bend_curve("flower")[50:1050]
    _ = series.coefficients  # by least squares, once

    counted = operations(compiled_bend_series, "series_field", lambda: len(series(q[:10])))
    per_field = {kind: len(q) * count for kind, count in counted.items()}
    return rate(lambda: bool(len(series(q)))), per_field
