"""Errors on T3 against the noise of the sensors, beside the Cramér-Rao bound (Baaij et al. 2023, sections 3, 5.2)."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import pandas as pd
import torch
from edition1.errors import bad_input, require
from edition1.estimation.base import track
from edition1.estimation.gradient_descent import GradientDescent
from edition1.estimation.information import cramer_rao, fisher_information
from edition1.kinematics.paper_robots import pcc_robot
from edition1.kinematics.robot import Robot
from edition1.sensing.linearised import LinearisedSensing
from edition1.sensing.magnetic import MagneticSensing, readings
from edition1.sensing.magnets import ring
from edition1.sensing.relations import relations
from jaxtyping import Float
from torch import Tensor
from tqdm import tqdm

from edition1_companion.twins.calibrated_robots import least_squares, relative_error, standard_normal
from edition1_companion.twins.calibration_session import L_MAX
from edition1_companion.twins.table_1_method import (
    DIPOLE,
    ITERATIONS,
    MOMENTUM,
    SOLVERS,
    sensor_models,
    step_sizes,
)
from edition1_companion.twins.table_1_method import MODELS as TABLE_MODELS
from edition1_companion.twins.trajectories import lemniscate

REAL_MT = (4.8e-5, 7.1e-4)
"""Noise of the real sensors [mT], inferred from 0.24 and 3.55 mV (section 5.2) at 5000 mV/mT."""
NOISE_MT = (1e-5, REAL_MT[0], 2e-4, REAL_MT[1], 2e-3, 5e-3, 2e-2, 1e-1)
"""Noise levels of the study [mT]."""
MODELS = (*TABLE_MODELS[:2], DIPOLE, TABLE_MODELS[2])
"""Sensor models; all but the first are ours."""
LM_ITERATIONS = 8
"""Iterations at every time step, each from the straight pose. Twenty change the mean errors on T3 by some per cent of
themselves at most (networks of the paper), those of the multipole model by less than 0.01 %."""
STEP_SCALE = {"released": 1.0, "published": 16.0}
"""Step sizes of gradient descent belong to the squared field of the ring."""


def noise_bound(
    n_segments: int, noise_mt: Sequence[float] = NOISE_MT, *, ring_name: str = "released", steps: int = 400
) -> pd.DataFrame:
    r"""Cramér-Rao bound on T3 in the measure of eq. (13), to stand beside :func:`noise_errors`.

    For every coordinate the root over time of the mean variance of :math:`(J^T J/\sigma^2)^{-1}` along the
    trajectory, in per cent of the range. It bounds estimates from the readings of one time step that are not biased.

    Columns: ``n_b, noise_mt, mean_percent, bending_percent, elongation_percent``.
    """
    robot, q = pcc_robot(n_segments), lemniscate(n_segments, steps=steps)
    J = _multipole(robot, ring_name).linearise(q)[1]
    variance = cramer_rao(fisher_information(J, 1.0)).diagonal(dim1=-2, dim2=-1)  # of 1 mT, times the square
    percent = 100 * variance.mean(0).sqrt() / (q.amax(0) - q.amin(0))
    levels = torch.tensor(list(noise_mt), dtype=torch.float64)
    return pd.DataFrame({"n_b": n_segments, "noise_mt": noise_mt} | _means(levels.unsqueeze(-1) * percent))


def noise_errors(
    n_segments: int,
    noise_mt: Sequence[float],
    seeds: Sequence[int],
    folder: Path,
    *,
    models: Sequence[str] = MODELS,
    solvers: Sequence[str] = SOLVERS,
    ring_name: str = "released",
    steps: int = 400,
    samples: int = 120_000,
    progress: bool = False,
) -> pd.DataFrame:
    """Errors on T3 of every sensor model with every solver at every noise level.

    Readings come from magpylib. A seed names a network, where the model is one, and the noise; the noise of two
    levels differs by a factor only. Gradient descent is the paper's: 20 evaluations a step, started at the ground
    truth. Levenberg-Marquardt starts straight at mid elongation, at every time step anew, within the training box.
    The paper's networks take part where all their files are in ``folder``, for the ring ``"released"``; ours are
    trained here, on ``samples`` configurations.

    Returns
    -------
    DataFrame
        Columns ``n_b, model, solver, start, noise_mt, seed``, then relative errors, eq. (13): ``mean_percent`` over
        all coordinates, ``bending_percent``, ``elongation_percent``; and ``at_bound_percent``, the share of time
        steps at which a bound holds the estimate (empty for gradient descent, which has none).

    Raises
    ------
    InputError
        If a model, a solver or the ring is unknown, or a noise is not positive.
    """
    for name, given, known in (("models", models, MODELS), ("solvers", solvers, SOLVERS)):
        if unknown := [x for x in given if x not in known]:
            raise bad_input(name, "noise_errors", f"among {', '.join(map(repr, known))}", unknown)
    require(all(noise > 0 for noise in noise_mt), "noise_mt", "noise_errors", "positive", list(noise_mt))
    robot, q = pcc_robot(n_segments), lemniscate(n_segments, steps=steps)
    clean = readings(robot, q, ring(ring_name))
    u = clean + torch.tensor(list(noise_mt), dtype=q.dtype)[:, None, None, None] * standard_normal(
        clean.shape, seeds
    )
    found = sensor_models(models, n_segments, seeds, folder, ring_name, samples=samples)
    tables = []
    if SOLVERS[0] in solvers and found:
        sensing = _SideBySide(robot, tuple(found.values()))
        gamma = STEP_SCALE[ring_name] * step_sizes(n_segments)
        descent = GradientDescent(sensing, gamma, MOMENTUM, ITERATIONS)
        stream = u.movedim(2, 0).transpose(1, 2).unsqueeze(1)  # [t, model, seed, noise, s]
        stream = stream.expand(-1, len(found), -1, -1, -1)
        label = f"gradient descent, {n_segments} segments" if progress else None
        run = track(descent, stream, q[0].expand(*stream.shape[1:-1], -1), progress=label)
        error = relative_error(run.q, q).transpose(1, 2)
        for name, percent in zip(found, error, strict=True):
            tables.append(_table(percent, noise_mt, seeds, model=name, solver=SOLVERS[0]))
    if SOLVERS[1] in solvers:
        for name, (model, inputs) in found.items():
            exact = name == TABLE_MODELS[2]
            sensing = _multipole(robot, ring_name) if exact else MagneticSensing(robot, model, inputs)
            levels = tqdm(u, f"{name}, {n_segments} segments", disable=not progress)
            estimates = [least_squares(sensing, x, n_segments, iterations=LM_ITERATIONS) for x in levels]
            error = torch.stack([relative_error(e.q.movedim(1, 0), q) for e in estimates])
            held = torch.stack([100 * e.diagnostics["at_bound"].double().mean(-1) for e in estimates])
            tables.append(_table(error, noise_mt, seeds, model=name, solver=SOLVERS[1], held=held))
    columns = [*KEYS, "seed", *MEASURES, "at_bound_percent"]
    if not tables:
        return pd.DataFrame(columns=columns)
    return pd.concat(tables, ignore_index=True).assign(n_b=n_segments).reindex(columns=columns)


KEYS = ["n_b", "model", "solver", "start", "noise_mt"]
MEASURES = ["mean_percent", "bending_percent", "elongation_percent"]


def against_bound(errors: pd.DataFrame, *, ring_name: str = "released", steps: int = 400) -> pd.DataFrame:
    """Means over the seeds beside the bound, one line per setting.

    ``ring_name`` and ``steps`` are those of the errors. Columns: those of :func:`noise_errors` without ``seed``, then
    ``bound_percent`` (mean over the coordinates) and ``of_bound``, the ratio of the errors to it.
    """
    means = errors.groupby(KEYS, sort=False, as_index=False)[[*MEASURES, "at_bound_percent"]].mean()
    levels = sorted(set(errors["noise_mt"]))
    robots = [
        noise_bound(int(n), levels, ring_name=ring_name, steps=steps) for n in sorted(set(errors["n_b"]))
    ]
    limits = pd.concat(robots)[["n_b", "noise_mt", "mean_percent"]]
    limits = limits.rename(columns={"mean_percent": "bound_percent"})
    joined = means.merge(limits, on=["n_b", "noise_mt"], validate="many_to_one")
    return joined.assign(of_bound=joined["mean_percent"] / joined["bound_percent"])


@dataclass(frozen=True)
class _SideBySide:
    """Several sensor models of one robot as one batch ``[model, seed, ...]``: the relations are shared."""

    robot: Robot
    models: tuple[tuple[Callable[[Tensor], Tensor], str], ...]

    def __call__(self, q: Tensor) -> Tensor:
        related = relations(self.robot, q)
        xi = {name: getattr(related, name)() for name in {inputs for _, inputs in self.models}}
        return torch.stack([model(xi[inputs][k]) for k, (model, inputs) in enumerate(self.models)])


def _multipole(robot: Robot, ring_name: str) -> LinearisedSensing:
    return LinearisedSensing(robot, torch.from_numpy(ring(ring_name).multipoles(L_MAX)))


def _means(percent: Float[Tensor, "*batch n_q"]) -> dict[str, list[float]]:
    """Means over all coordinates, over bending and over elongation."""
    by_segment = percent.unflatten(-1, (-1, 3))
    means = (percent.mean(-1), by_segment[..., :2].mean((-2, -1)), by_segment[..., 2].mean(-1))
    return {name: x.flatten().tolist() for name, x in zip(MEASURES, means, strict=True)}


def _table(
    percent: Float[Tensor, "noise seeds n_q"],
    noise_mt: Sequence[float],
    seeds: Sequence[int],
    *,
    model: str,
    solver: str,
    held: Tensor | None = None,
) -> pd.DataFrame:
    index = pd.MultiIndex.from_product([noise_mt, seeds], names=["noise_mt", "seed"])
    started = "ground truth" if solver == SOLVERS[0] else "straight"
    held_percent = [float("nan")] * len(index) if held is None else held.flatten().tolist()
    table = pd.DataFrame(_means(percent) | {"at_bound_percent": held_percent}, index=index).reset_index()
    return table.assign(model=model, solver=solver, start=started)
