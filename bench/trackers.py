"""Rates of the trackers of Baaij et al. 2023: compiled, in eager torch, and from the equations; and their errors.

All follow the lemniscate T3 from readings by magpylib with the noise of the real sensors. Networks were trained on
other configurations, by magpylib too. Side by side means that one call advances many robots by one time step, each at
its own point of the trajectory; one at a time is a loop over the time steps of one robot.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from pathlib import Path
from typing import Any

import torch
from edition1.estimation.base import Estimator, track
from edition1.estimation.gradient_descent import GradientDescent
from edition1.estimation.levenberg_marquardt import LevenbergMarquardt
from edition1.kernels import compiled
from edition1.kinematics.paper_robots import pcc_robot
from edition1.sensing.magnetic import MagneticSensing, readings
from edition1.sensing.magnets import ring
from edition1.sensing.multipole import MultipoleField
from edition1.sensing.weights import load_paper_network
from edition1_companion.pages.performance.rows import NO_GOAL, RELEASED_TRACKER, Goal, rate, row
from edition1_companion.twins.calibrated_robots import box, start
from edition1_companion.twins.calibration_session import SENSOR_NOISE_MT
from edition1_companion.twins.networks import NetworkSpec
from edition1_companion.twins.table_1_method import ITERATIONS, MOMENTUM, networks, step_sizes
from edition1_companion.twins.table_1_rows import Row
from edition1_companion.twins.trajectories import lemniscate
from torch import Tensor

from bench.references import Model, cosines_of, readings_by_equations

UNIT = "time steps per CPU second"
SETTLED = 200
"""Time steps after which errors are taken: all trackers have then forgotten the start."""
_FIRST = (
    20  # where the robots start along T3: nowhere near a straight segment, where the equations divide by zero
)

Tracker = LevenbergMarquardt | GradientDescent


@dataclass(frozen=True)
class Task:
    """Robots side by side on T3, and what they read.

    Parameters
    ----------
    n_segments
        Of each robot.
    members
        Number of robots.
    steps
        Number of time steps.
    repeats
        Of every timing.
    """

    n_segments: int
    members: int = 1000
    steps: int = 3
    repeats: int = 5

    @cached_property
    def trajectory(self) -> tuple[Tensor, Tensor]:
        """Configurations of T3, and readings with noise."""
        q = lemniscate(self.n_segments)
        u = readings(pcc_robot(self.n_segments), q, ring("released"))
        noise = torch.randn(u.shape, generator=torch.Generator().manual_seed(0), dtype=u.dtype)
        return q, u + SENSOR_NOISE_MT * noise

    def starts(self, members: int) -> Tensor:
        """Where the robots are before the first step: at points of T3, one time step behind the readings."""
        return self.trajectory[0][_FIRST + torch.arange(members) % 100]

    def readings(self, step: int, members: int) -> Tensor:
        """Readings of all robots at a time step."""
        return self.trajectory[1][_FIRST + 1 + step + torch.arange(members) % 100]


def advance(method: Estimator[Any], task: Task, members: int, *, seeds: bool) -> Tensor:
    """Estimates ``[steps, members, n_q]`` of robots side by side; ``seeds`` if the model has a dimension for them."""
    q0 = task.starts(members)
    state, found = method.init(q0.unsqueeze(0) if seeds else q0, seed=0), []
    for k in range(task.steps):
        u = task.readings(k, members)
        state, estimate = method.step(state, u.unsqueeze(0) if seeds else u, 0.0)
        found.append(estimate.q.reshape(members, -1))
    return torch.stack(found)


def rate_of(method: Estimator[Any], task: Task, members: int, *, seeds: bool) -> float:
    """Time steps per CPU second with so many robots side by side."""
    return rate(lambda: len(advance(method, task, members, seeds=seeds)) * members, task.repeats)


def tracking_error_mm(method: Estimator[Any], task: Task, *, seeds: bool) -> float:
    """Root-mean-squared error of the configuration [mm] on T3, from the straight pose, once that is forgotten."""
    q, u = task.trajectory
    q0 = start(task.n_segments)
    found = track(method, u.unsqueeze(1) if seeds else u, q0.unsqueeze(0) if seeds else q0).q.reshape(q.shape)
    return 1e3 * float((found - q)[SETTLED:].square().mean().sqrt())


@dataclass(frozen=True)
class Trackers:
    """One algorithm with one sensor model, compiled and in torch."""

    name: str
    torch: Tracker
    """In eager torch."""
    seeds: bool = False

    @cached_property
    def method(self) -> Tracker:
        """The same compiled."""
        return replace(self.torch, sensing=compiled(self.torch.sensing))


def least_squares(n: int, name: str, sensing: MagneticSensing, *, seeds: bool = False) -> Trackers:
    """Three iterations of Levenberg-Marquardt."""
    method = LevenbergMarquardt(sensing, *box(n), noise_mt=SENSOR_NOISE_MT, iterations=3)
    return Trackers(f"3 LM iterations, {name}, n_b = {n}", method, seeds)


def descent(n: int, name: str, sensing: MagneticSensing, *, seeds: bool = False) -> Trackers:
    """Twenty iterations of the paper's gradient descent."""
    method = GradientDescent(sensing, step_sizes(n), MOMENTUM, ITERATIONS)
    return Trackers(f"20 gradient-descent iterations, {name}, n_b = {n}", method, seeds)


def multipole(n: int) -> MagneticSensing:
    """Multipole field of the ring ``"released"`` up to order 9."""
    return MagneticSensing(pcc_robot(n), MultipoleField.of(ring("released")))


def network_of_the_paper(n: int, folder: Path) -> MagneticSensing:
    """Committed networks of the paper's recipe, those of the first seed."""
    return MagneticSensing(pcc_robot(n), networks([Row("nominal", n_segments=n)], folder, [0]), "angles")


def implementations(trackers: Trackers, task: Task, goal: Goal = NO_GOAL) -> list[dict[str, Any]]:
    """Compiled against torch: side by side against one at a time (the row with targets), and both in the same way."""
    method, seeds, few = trackers.method, trackers.seeds, min(task.members, 4)
    errors = [
        1e3
        * float(
            (advance(method, task, m, seeds=seeds) - advance(trackers.torch, task, m, seeds=seeds))
            .abs()
            .max()
        )
        for m in (few, task.members)
    ]
    side = rate_of(method, task, task.members, seeds=seeds)
    one = rate_of(method, task, 1, seeds=seeds)
    eager = rate_of(trackers.torch, task, 1, seeds=seeds)
    batched = rate_of(trackers.torch, task, task.members, seeds=seeds)
    name, note = f"time step, {trackers.name}", "; error: largest difference of the configurations [mm]"
    many = f"{task.members} robots side by side"
    rows = [
        (
            name,
            (side, eager),
            errors[0],
            f"{many}; reference: the same in eager torch, one robot at a time",
            goal,
        ),
        (
            f"{name}, torch batched",
            (side, batched),
            errors[1],
            f"{many}; reference: torch, as many side by side",
            NO_GOAL,
        ),
        (
            f"{name}, live",
            (one, eager),
            errors[0],
            "one robot at a time; reference: eager torch, too",
            NO_GOAL,
        ),
    ]
    return [row(c, "implementation", UNIT, rates, e, text + note, g) for c, rates, e, text, g in rows]


def from_the_equations(trackers: Trackers, models: Sequence[Model], task: Task) -> dict[str, Any]:
    """Compiled and side by side, against the same algorithm with loops over the equations, one robot at a time.

    Parameters
    ----------
    trackers
        The algorithm, and ours.
    models
        The same sensor model for one row of relations as angles, for each segment.
    task
        What is followed.
    """

    def plain(q: Tensor) -> Tensor:
        return readings_by_equations(q.reshape(-1), models).reshape(*q.shape[:-1], -1)

    method = replace(trackers.torch, sensing=plain)
    difference = advance(trackers.method, task, 1, seeds=trackers.seeds) - advance(
        method, task, 1, seeds=False
    )
    rates = (
        rate_of(trackers.method, task, task.members, seeds=trackers.seeds),
        rate_of(method, task, 1, seeds=False),
    )
    note = (
        f"{task.members} robots side by side; reference: loops over sensors and magnets in torch, one robot"
    )
    goal = Goal(released=RELEASED_TRACKER[task.n_segments])
    name = f"time step, {trackers.name}, from the equations"
    error = 1e3 * float(difference.abs().max())
    return row(name, "implementation", UNIT, rates, error, f"{note}; error: as above [mm]", goal)


def against(ours: Trackers, other: Trackers, kind: str, task: Task) -> dict[str, Any]:
    """Line of two compiled trackers: another solver on one model, or another model with one solver."""
    rates = [rate_of(t.method, task, task.members, seeds=t.seeds) for t in (ours, other)]
    errors = [tracking_error_mm(t.method, task, seeds=t.seeds) for t in (ours, other)]
    note = f"both compiled, side by side; error: RMSE on T3 [mm], of the reference {errors[1]:.3g}"
    name = f"time step, {ours.name}, against {other.name}"
    return row(name, kind, UNIT, (rates[0], rates[1]), errors[0], note)


def tracker_rows(folder: Path, mlp: MagneticSensing) -> list[dict[str, Any]]:
    """All lines of the trackers.

    Parameters
    ----------
    folder
        Where the trained networks are.
    mlp
        A fast network (64-64) of a robot of three segments, an ensemble of one seed.
    """
    one, three, some, few = Task(1, 2000), Task(3), Task(3, 200), Task(3, 100, 2)
    field_1, field_3 = (least_squares(n, "multipole", multipole(n)) for n in (1, 3))
    fast = least_squares(3, "MLP 64-64", mlp, seeds=True)
    paper = descent(3, "network of the paper", network_of_the_paper(3, folder), seeds=True)
    paper_lm = least_squares(3, "network of the paper", network_of_the_paper(3, folder), seeds=True)
    nets = [
        load_paper_network(folder / f"{NetworkSpec(3, k, False, 0).name}.safetensors").eval()
        for k in range(3)
    ]
    magnet, released = MultipoleField.of(ring("released")), RELEASED_TRACKER
    return [
        *implementations(field_1, one, Goal(80_000.0, 300.0, released[1])),
        *implementations(field_3, three, Goal(30_000.0, 300.0, released[3])),
        *implementations(fast, some, Goal(4_000.0, 80.0, released[3])),
        *implementations(paper, few, Goal(200.0, 12.0, released[3])),
        from_the_equations(field_1, [lambda xi: magnet(cosines_of(xi))], one),
        from_the_equations(field_3, [lambda xi: magnet(cosines_of(xi))] * 3, three),
        from_the_equations(fast, [partial(_of_segment, mlp.model, k) for k in range(3)], some),
        from_the_equations(paper, [lambda xi, net=net: net(xi.float()) for net in nets], few),
        against(field_3, descent(3, "multipole", multipole(3)), "solver", three),
        against(paper_lm, paper, "solver", few),
        against(field_3, fast, "model", some),
        against(field_3, paper_lm, "model", few),
    ]


def _of_segment(model: Model, k: int, angles: Tensor) -> Tensor:
    """Reading by the network of segment ``k`` of an ensemble of one seed, for one row of relations."""
    rows = cosines_of(angles).expand(9, -1).unsqueeze(0)
    return model(rows)[0, 3 * k : 3 * k + 1]
