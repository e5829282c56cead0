r"""Optimal placement of sensors and magnets, the question that Baaij et al. 2023 leave open in section 6.

Readings are differentiable in the configuration, and what they tell about it is differentiable in the placement of
the parts. Minimised is the error to be expected from noise (:mod:`edition1_companion.pages.sensor_placement.tasks`),
averaged over coordinates and shapes: it is the quantity that is judged afterwards, on other shapes. The determinant
of the information would weigh what is known well as much as what is not.

The error to be expected from parts that are not as drawn is kept below that of the nominal layout. Without this limit
most of the gain comes from magnets close to the sensors, where an offset of half a millimetre counts for more.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pandas as pd
import torch
from scipy.optimize import minimize
from torch import Tensor

from edition1.errors import bad_input
from edition1.sensing.placement import Tolerances
from edition1_companion.pages.sensor_placement.layouts import KINDS, Layout, Room
from edition1_companion.pages.sensor_placement.tasks import NOISE_MT, Task, expected_errors, mean_errors

CANDIDATES = 40
"""Random layouts of which the most promising are optimised."""
SLACK = 1e-3
"""Share by which the limit may be missed: the solver meets it to rounding only."""


@dataclass(frozen=True)
class Settings:
    """What an optimisation may change, and how far.

    Parameters
    ----------
    room
        Limits and distances of the parts.
    limit
        Bound of the error to be expected from tolerances, as a multiple of that of the reference; infinite for none.
        At 0.9 the errors that an estimator makes on the shapes of the task are 0.95 of those of the nominal layout,
        for one segment and for three; at 1 they are 1.06 and 0.98 of them (60 draws of robots).
    free
        Kinds of values that may change, of :data:`~edition1_companion.pages.sensor_placement.layouts.KINDS`.
    iterations
        Largest number of iterations from one start.
    noise_mt
        Noise of a reading [mT].
    """

    room: Room = field(default_factory=Room)
    limit: float = 0.9
    free: tuple[str, ...] = KINDS
    iterations: int = 60
    noise_mt: float = NOISE_MT


def optimise(
    task: Task, start: Layout, settings: Settings | None = None, *, reference: Layout | None = None
) -> tuple[Layout, dict[str, Any]]:
    """Minimise the error to be expected from noise by sequential quadratic programming (SciPy's SLSQP).

    Parameters
    ----------
    task
        Robot and shapes.
    start
        Layout to start from, within the limits; it need not keep the distances.
    settings
        Limits.
    reference
        Layout that sets the bound of the error from tolerances; the nominal one when not given.

    Returns
    -------
    tuple
        The layout where it ended, within its limits; and ``noise_percent`` and ``tolerance_percent``, the errors to
        be expected on the shapes of the task, ``feasible``, whether it keeps all distances and the bound of the
        error from tolerances, and ``evaluations`` of the objective.

    Raises
    ------
    InputError
        If the start or the reference leaves a coordinate open.
    """
    settings = settings or Settings()
    low, high = settings.room.limits(start)
    unit = _determined("start", task, start, settings.noise_mt)[0]
    bound = _bound(task, reference or task.nominal, settings)
    problem = _Problem(task, start, bound, settings)
    constraints = [{"type": "ineq", "fun": problem.clearances, "jac": problem.clearance_slopes}]
    if math.isfinite(bound):
        below = {
            "fun": lambda x: 1 - problem.evaluate(x)[1] / bound,
            "jac": lambda x: -problem.evaluate(x)[3] / bound,
        }
        constraints.append({"type": "ineq", **below})
    found = minimize(
        lambda x: problem.evaluate(x)[0] / unit,
        problem.scaled(start.values),
        jac=lambda x: problem.evaluate(x)[2] / unit,
        bounds=[(0.0, 1.0)] * int(problem.chosen.sum()),
        constraints=constraints,
        method="SLSQP",
        options={"maxiter": settings.iterations, "ftol": 1e-6},
    )
    values = problem.layout(torch.from_numpy(np.clip(found.x, 0, 1))).values
    layout = start.moved(torch.clamp(values, low, high))
    noise, tolerance = mean_errors(task, layout, settings.noise_mt)
    feasible = settings.room.holds(layout) and tolerance <= bound * (1 + SLACK)
    return layout, {
        "noise_percent": noise,
        "tolerance_percent": tolerance,
        "feasible": feasible,
        "evaluations": problem.count,
    }


def search(
    task: Task,
    settings: Settings | None = None,
    *,
    starts: int = 4,
    seed: int = 0,
    reference: Layout | None = None,
) -> tuple[Layout, pd.DataFrame]:
    """Best of several optimisations: from a known layout, then from the most promising of random ones.

    Parameters
    ----------
    task
        Robot and shapes.
    settings
        Limits.
    starts
        Number of optimisations.
    seed
        Of the random layouts.
    reference
        Layout to start from first, and to be compared with; the nominal one when not given. It is returned if no
        start ends below it, so what is returned is never worse on the shapes of the task.

    Returns
    -------
    tuple
        The layout, and a line per start: ``start`` (0 is the reference), ``noise_percent``, ``tolerance_percent``,
        ``feasible``, ``evaluations``, ``chosen``.

    Raises
    ------
    InputError
        If there is no start or iteration, or the reference does not keep its distances or leaves a coordinate open.
    """
    settings, reference = settings or Settings(), reference or task.nominal
    if min(starts, settings.iterations) < 1:
        raise bad_input("starts, iterations", "search", "at least 1", (starts, settings.iterations))
    if not settings.room.holds(reference):
        raise bad_input("reference", "search", "a layout that the room allows", reference.values.tolist())
    best, lowest = reference, _determined("reference", task, reference, settings.noise_mt)[0]
    promising = _promising(task, reference, settings, seed) if starts > 1 else []
    lines, chosen = [], None
    for k, start in enumerate([reference, *promising[: starts - 1]]):
        layout, line = optimise(task, start, settings, reference=reference)
        if line["feasible"] and line["noise_percent"] < lowest:
            best, lowest, chosen = layout, line["noise_percent"], k
        lines.append({"start": k} | line)
    table = pd.DataFrame(lines)
    return best, table.assign(chosen=table["start"] == chosen)


def _promising(task: Task, reference: Layout, settings: Settings, seed: int) -> list[Layout]:
    """Random layouts, those with the least error first; a missed bound raises the error in proportion."""
    generator, bound = torch.Generator().manual_seed(seed), _bound(task, reference, settings)
    chosen = torch.from_numpy(reference.of_kind(settings.free))
    found: list[tuple[float, int, Layout]] = []
    for k in range(CANDIDATES):
        values = settings.room.random(reference, generator).values
        layout = reference.moved(torch.where(chosen, values, reference.values))
        with torch.no_grad():
            noise, tolerance = mean_errors(task, layout, settings.noise_mt)
        if math.isfinite(noise):
            found.append((noise * max(1.0, tolerance / bound), k, layout))
    return [layout for _, _, layout in sorted(found, key=lambda x: x[:2])]


def _determined(name: str, task: Task, layout: Layout, noise_mt: float) -> tuple[float, float]:
    errors = mean_errors(task, layout, noise_mt)
    if not math.isfinite(errors[0]):
        expected = "a layout whose readings determine every coordinate in every shape"
        raise bad_input(name, "optimise", expected, "one whose readings do not")
    return errors


def _bound(task: Task, reference: Layout, settings: Settings) -> float:
    if math.isinf(settings.limit):
        return math.inf
    return settings.limit * _determined("reference", task, reference, settings.noise_mt)[1]


class _Problem:
    """Both errors and the distances as functions of the free values, scaled to their limits."""

    def __init__(self, task: Task, start: Layout, bound: float, settings: Settings) -> None:
        self.task, self.start, self.settings = task, start, settings
        self.chosen = torch.from_numpy(start.of_kind(settings.free))
        low, high = settings.room.limits(start)
        self.low, self.width = low[self.chosen], (high - low)[self.chosen]
        self.fixed = torch.where(self.chosen, 0.0, start.values)
        self.embedding = torch.eye(len(start.values), dtype=torch.float64)[:, self.chosen]
        self.tolerances = Tolerances() if math.isfinite(bound) else None
        self.count, self._at, self._found = 0, b"", (0.0, 0.0, np.empty(0), np.empty(0))

    def scaled(self, values: Tensor) -> np.ndarray:
        return ((values[self.chosen] - self.low) / self.width).numpy()

    def layout(self, x: Tensor) -> Layout:
        return self.start.moved(self.fixed + self.embedding @ (self.low + self.width * x))

    def evaluate(self, x: np.ndarray) -> tuple[float, float, np.ndarray, np.ndarray]:
        """Errors from noise and from tolerances, then their slopes; objective and bound share an evaluation."""
        if x.tobytes() != self._at:
            at = torch.tensor(x, requires_grad=True)
            noise, tolerance = expected_errors(
                self.task, self.layout(at), noise_mt=self.settings.noise_mt, tolerances=self.tolerances
            )
            a = noise.mean()
            b = 0 * a if tolerance is None else tolerance.mean()
            (slope_a,) = torch.autograd.grad(a, at, retain_graph=True)
            (slope_b,) = torch.autograd.grad(b, at)
            self.count, self._at = self.count + 1, x.tobytes()
            self._found = (float(a.detach()), float(b.detach()), slope_a.numpy(), slope_b.numpy())
        return self._found

    def clearances(self, x: np.ndarray) -> np.ndarray:
        return self._clearances(torch.tensor(x)).numpy()

    def clearance_slopes(self, x: np.ndarray) -> np.ndarray:
        return torch.func.jacrev(self._clearances)(torch.tensor(x)).numpy()

    def _clearances(self, x: Tensor) -> Tensor:
        """In units of 10 mm."""
        return 100 * self.settings.room.clearances(self.layout(x))
