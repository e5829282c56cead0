"""Which factor brings what: sensor model by solver on the same readings (Baaij et al. 2023, section 3)."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

import pandas as pd
import torch
from torch import Tensor

from repro.errors import bad_input
from repro.estimation.base import track
from repro.estimation.gradient_descent import GradientDescent
from repro.estimation.levenberg_marquardt import LevenbergMarquardt
from repro.kernels import compiled
from repro.sensing.ensemble import SeedEnsemble
from repro.sensing.magnetic import MagneticSensing
from repro.sensing.magnets import ring
from repro.sensing.multipole import MultipoleField
from repro.sensing.training_set import training_set
from repro_companion.book.pose_errors import pose_errors
from repro_companion.twins.calibrated_robots import box, start
from repro_companion.twins.networks import DATA_SEED, train_own
from repro_companion.twins.table_1_method import ITERATIONS, MOMENTUM, available, networks, step_sizes
from repro_companion.twins.table_1_rows import Row, simulate


def fast_networks(
    n_segments: int,
    seeds: Sequence[int],
    *,
    ring_name: str = "released",
    samples: int = 120_000,
    progress: bool = False,
) -> SeedEnsemble:
    """Networks of the fast recipe for the nominal robot: one per seed and segment, trained here and now."""
    data = training_set(n_segments, seed=DATA_SEED, samples=samples, magnet=ring(ring_name))
    trained = [train_own(data, seed=seed, progress=progress)[0] for seed in seeds]
    return SeedEnsemble(trained, list(data.robot.sensors.segment)).double()


MODELS = ("network of the paper", "fast network", "multipole")
SOLVERS = ("gradient descent", "Levenberg-Marquardt")


def sensor_models(
    wanted: Sequence[str], n_segments: int, seeds: Sequence[int], folder: Path, ring_name: str
) -> dict[str, tuple[Callable[[Tensor], Tensor], str]]:
    """Sensor models by name, each with the form of its inputs; the paper's network only where it is trained."""
    row = Row(f"n_b={n_segments}", n_segments=n_segments)
    found: dict[str, tuple[Callable[[Tensor], Tensor], str]] = {}
    if MODELS[0] in wanted and available([row], folder, seeds) and ring_name == "released":
        found[MODELS[0]] = (networks([row], folder, seeds), "angles")
    if MODELS[1] in wanted:
        found[MODELS[1]] = (fast_networks(n_segments, seeds, ring_name=ring_name), "cosines")
    if MODELS[2] in wanted:
        found[MODELS[2]] = (MultipoleField.of(ring(ring_name)), "cosines")
    return found


def model_by_solver(
    n_segments: int,
    seeds: Sequence[int],
    folder: Path,
    *,
    models: Sequence[str] = MODELS,
    solvers: Sequence[str] = SOLVERS,
    ring_name: str = "released",
    noise_mt: float = 0.0,
    steps: int = 400,
) -> pd.DataFrame:
    """Errors on T3 of every sensor model with every solver.

    Gradient descent is the paper's: 20 evaluations a step, started at the ground truth. Levenberg-Marquardt starts
    straight with mid elongation, at every time step anew, within the training box.

    Returns
    -------
    DataFrame
        Columns ``n_b, model, solver, start, seed, configuration_percent`` (mean over the variables of eq. 13),
        ``tip_mm, orientation_deg, shape_mm``, one row per seed (one for the multipole model without noise, which
        has no seed).

    Raises
    ------
    InputError
        If a model or a solver is unknown.
    """
    for name, given, known in (("models", models, MODELS), ("solvers", solvers, SOLVERS)):
        if unknown := [x for x in given if x not in known]:
            raise bad_input(name, "model_by_solver", f"among {', '.join(map(repr, known))}", unknown)
    simulation = simulate([Row("nominal", n_segments=n_segments)], ring_name=ring_name, steps=steps)
    q, n_q, robot = simulation.q, simulation.q.shape[-1], Row("nominal", n_segments=n_segments).robot()
    clean = simulation.u[:, 0]
    low, high = box(n_segments)
    tables = []
    for name, (model, inputs) in sensor_models(models, n_segments, seeds, folder, ring_name).items():
        own = tuple(seeds) if isinstance(model, SeedEnsemble) or noise_mt > 0 else tuple(seeds[:1])
        generator = torch.Generator().manual_seed(seeds[0])
        u = clean.unsqueeze(1).expand(-1, len(own), -1)
        u = u + noise_mt * torch.randn(u.shape, generator=generator, dtype=u.dtype)
        sensing = MagneticSensing(robot, model, inputs)
        estimates = {}
        if SOLVERS[0] in solvers:
            scale = 1.0 if ring_name == "released" else 16.0  # step sizes belong to the squared field
            descent = GradientDescent(compiled(sensing), scale * step_sizes(n_segments), MOMENTUM, ITERATIONS)
            run = track(descent, u, q[0].expand(len(own), n_q))
            estimates[SOLVERS[0], "ground truth"] = run.q
        solver = LevenbergMarquardt(compiled(sensing), low, high, noise_mt=max(noise_mt, 1e-6))
        everywhere = start(n_segments).expand(len(own), steps, n_q)
        state = solver.init(everywhere)
        estimates["Levenberg-Marquardt", "straight"] = solver.step(state, u.movedim(0, 1), 0.0)[1].q.movedim(
            1, 0
        )
        for (solver_name, started), q_hat in estimates.items():
            relative = ((q_hat - q.unsqueeze(1)) ** 2).mean(0).sqrt() / (q.amax(0) - q.amin(0))
            columns = {"configuration_percent": 100 * relative.mean(-1)} | pose_errors(
                robot, q_hat, q.unsqueeze(1)
            )
            table = pd.DataFrame({key: value.numpy() for key, value in columns.items()})
            labels = {"n_b": n_segments, "model": name, "solver": solver_name, "start": started}
            tables.append(pd.DataFrame({**labels, "seed": own}).join(table))
    return pd.concat(tables, ignore_index=True)
