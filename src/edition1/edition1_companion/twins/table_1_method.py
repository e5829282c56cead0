"""Table 1 of Baaij et al. 2023 with the paper's method: its networks, its settings, its errors.

Beside it the sensor models of the simulated robots by name: those that pages compare, with one member for each seed.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import pandas as pd
import torch
from torch import Tensor

from edition1.errors import bad_input
from edition1.estimation.base import Trajectory, track
from edition1.estimation.gradient_descent import GradientDescent
from edition1.kernels import compiled
from edition1.sensing.ensemble import SeedEnsemble
from edition1.sensing.magnetic import MagneticSensing
from edition1.sensing.magnets import ring
from edition1.sensing.multipole import MultipoleField
from edition1.sensing.weights import load_paper_network
from edition1_companion.book.parallel import table_in_processes
from edition1_companion.twins.networks import DATA_SEED, SEEDS, NetworkSpec, train_own
from edition1_companion.twins.table_1_rows import ROWS, Row, Simulation, groups, simulate
from edition1_companion.twins.training_set import training_set

STEP_SIZES = {1: (3.5e-4, 3.5e-4), 2: (3e-3, 3e-4), 3: (2e-3, 2e-4)}
"""Step sizes of section 3.3 for bending and for elongation, by number of segments (ring ``"released"``)."""
MOMENTUM = 0.3
ITERATIONS = 20


def available(rows: Sequence[Row], folder: Path, seeds: Sequence[int] = SEEDS) -> tuple[Row, ...]:
    """Rows whose networks are all there."""
    return tuple(r for r in rows if all(path.exists() for path in _files(r, folder, seeds)))


def _files(row: Row, folder: Path, seeds: Sequence[int]) -> list[Path]:
    specs = (
        NetworkSpec(row.n_segments, segment, row.earth_axis is not None, seed)
        for seed in seeds
        for segment in range(row.n_segments)
    )
    return [folder / f"{spec.name}.safetensors" for spec in specs]


def step_sizes(n_segments: int, bending: float | None = None, elongation: float | None = None) -> Tensor:
    """Step size of every coordinate: those of :data:`STEP_SIZES`, or the given ones."""
    default = STEP_SIZES.get(n_segments, STEP_SIZES[3])
    xy = default[0] if bending is None else bending
    dL = default[1] if elongation is None else elongation
    return torch.tensor([xy, xy, dL] * n_segments, dtype=torch.float64)


def networks(rows: Sequence[Row], folder: Path, seeds: Sequence[int]) -> SeedEnsemble:
    """Trained networks for these rows, one per seed and segment."""
    widest = max(row.sensors_per_segment for row in rows)
    files = iter(_files(rows[0], folder, seeds))
    n = rows[0].n_segments
    by_seed = [[load_paper_network(next(files)) for _ in range(n)] for _ in seeds]
    return SeedEnsemble(by_seed, [i for i in range(n) for _ in range(widest)])


def paper_method(
    simulation: Simulation,
    model: SeedEnsemble,
    n_seeds: int,
    *,
    iterations: int = ITERATIONS,
    step_size: Tensor | None = None,
    noise_mt: float = 0.0,
    noise_seed: int = 0,
    progress: str | None = None,
) -> tuple[Trajectory, Tensor]:
    """Gradient descent as in section 3.3 on the networks, for all rows and seeds at once.

    As in every simulated run of the paper the descent starts at the ground truth, and its momentum is carried
    from one time step to the next.

    Returns
    -------
    Trajectory, Tensor
        Estimates ``[t, seeds, rows, n_q]``, and the readings that the networks predict at the ground truth
        ``[seeds, t, rows, s]``.
    """
    s = simulation
    sensing = MagneticSensing(s.robot, model, "angles", s.earth_axis)
    n_q = s.q.shape[-1]
    start = s.q[0].expand(n_seeds, len(s.rows), n_q)
    u = s.u.unsqueeze(1).expand(-1, n_seeds, -1, -1)
    generator = torch.Generator().manual_seed(noise_seed)
    u = u + noise_mt * torch.randn(u.shape, generator=generator, dtype=u.dtype)
    step_size = step_sizes(s.rows[0].n_segments) if step_size is None else step_size
    estimator = GradientDescent(compiled(sensing), step_size, MOMENTUM, iterations)
    estimates = track(estimator, u, start, mask=s.mask.expand(len(u), 1, *s.mask.shape), progress=progress)
    with torch.no_grad():
        predicted = sensing(s.q[None, :, None].expand(n_seeds, -1, len(s.rows), -1))
    return estimates, predicted


def errors_of_estimates(
    simulation: Simulation, estimates: Trajectory, predicted: Tensor, seeds: Sequence[int]
) -> pd.DataFrame:
    """Errors of Table 1, one row per simulation, seed and column.

    ``e_u`` [mT] is the root-mean-squared error of the prediction at the ground truth, averaged over the sensors;
    the others are eq. (13) [%], with the range of each variable over the trajectory.
    """
    s = simulation
    squared = ((predicted - s.u) ** 2).mean(1).sqrt()
    e_u = torch.where(s.mask, squared, 0.0).sum(-1) / s.mask.sum(-1)
    span = s.q.amax(0) - s.q.amin(0)
    relative = 100 * ((estimates.q - s.q[:, None, None]) ** 2).mean(0).sqrt() / span
    table = []
    for i, seed in enumerate(seeds):
        for k, row in enumerate(s.rows):
            key = {"row": row.name, "seed": seed}
            table.append(key | {"quantity": "e_u", "unit": "mT", "error": float(e_u[i, k])})
            for name, value in zip(s.robot.coordinates, relative[i, k].tolist(), strict=True):
                table.append(key | {"quantity": name, "unit": "%", "error": value})
    return pd.DataFrame(table)


def run(
    rows: Sequence[Row],
    seeds: Sequence[int],
    folder: Path,
    *,
    iterations: int = ITERATIONS,
    step_size: Sequence[float] = (),
    noise_mt: float = 0.0,
    steps: int = 400,
    jobs: int | None = None,
) -> pd.DataFrame:
    """Errors of the paper's method on these rows: the table of :func:`errors`.

    Rows that share their networks are one batch, and batches run side by side in ``jobs`` processes.

    Raises
    ------
    InputError
        If ``step_size`` is neither empty nor a pair (bending, elongation).
    """
    if len(step_size) not in (0, 2):
        raise bad_input("step_size", "Table 1", "two numbers, for bending and elongation", step_size)
    options = {"iterations": iterations, "noise_mt": noise_mt}
    tasks = [
        partial(_run_group, g, tuple(seeds), folder, tuple(step_size), steps, options) for g in groups(rows)
    ]
    tasks.sort(key=lambda task: -len(task.args[0]) * task.args[0][0].n_segments)  # the longest first
    if not tasks:
        return pd.DataFrame(columns=["row", "seed", "quantity", "unit", "error"])
    order = {row.name: k for k, row in enumerate(ROWS)}
    table = table_in_processes(tasks, jobs)
    return table.sort_values("row", key=lambda names: names.map(order), kind="stable", ignore_index=True)


def _run_group(
    rows: tuple[Row, ...],
    seeds: tuple[int, ...],
    folder: Path,
    step_size: tuple[float, ...],
    steps: int,
    options: dict[str, Any],
) -> pd.DataFrame:
    simulation = simulate(rows, steps=steps)
    options["step_size"] = step_sizes(rows[0].n_segments, *step_size)
    model = networks(rows, folder, seeds)
    estimates, predicted = paper_method(simulation, model, len(seeds), **options)
    return errors_of_estimates(simulation, estimates, predicted, seeds)


MODELS = ("network of the paper", "fast network", "multipole")
SOLVERS = ("gradient descent", "Levenberg-Marquardt")


def sensor_models(
    wanted: Sequence[str],
    n_segments: int,
    seeds: Sequence[int],
    folder: Path,
    ring_name: str,
) -> dict[str, tuple[Callable[[Tensor], Tensor], str]]:
    """Sensor models by name, each with the form of its inputs, for all seeds in one batch.

    The paper's network only where its files are in ``folder``, for the ring ``"released"``; ours are trained here and
    now.
    """
    row = Row(f"n_b={n_segments}", n_segments=n_segments)
    found: dict[str, tuple[Callable[[Tensor], Tensor], str]] = {}
    if MODELS[0] in wanted and available([row], folder, seeds) and ring_name == "released":
        found[MODELS[0]] = (networks([row], folder, seeds), "angles")
    if MODELS[1] in wanted:
        data = training_set(n_segments, seed=DATA_SEED, magnet=ring(ring_name))
        trained = [train_own(data, seed=seed)[0] for seed in seeds]
        found[MODELS[1]] = SeedEnsemble(trained, list(data.robot.sensors.segment)), "cosines"
    if MODELS[2] in wanted:
        found[MODELS[2]] = (MultipoleField.of(ring(ring_name)), "cosines")
    return found
