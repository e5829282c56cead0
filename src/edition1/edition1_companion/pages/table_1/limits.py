"""What limits the errors of Table 1: our best figures, model by solver, what the exact model can and cannot do."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import pandas as pd
import torch
from jaxtyping import Float
from scipy.stats import chi2
from torch import Tensor

from edition1.errors import bad_input
from edition1.estimation.base import track
from edition1.estimation.gradient_descent import GradientDescent
from edition1.estimation.levenberg_marquardt import covariance, jacobian
from edition1.kernels import compiled
from edition1.kinematics.paper_robots import pcc_robot
from edition1.sensing.ensemble import SeedEnsemble
from edition1.sensing.linearised import LinearisedSensing
from edition1.sensing.magnetic import MagneticSensing, readings
from edition1.sensing.magnets import ring
from edition1_companion.book.pose_errors import pose_errors
from edition1_companion.twins.calibrated_robots import (
    box,
    calibration,
    least_squares,
    relative_error,
    session,
    table_of_draws,
)
from edition1_companion.twins.calibration_session import SENSOR_NOISE_MT, Config, released_moments
from edition1_companion.twins.table_1_method import (
    ITERATIONS,
    MODELS,
    MOMENTUM,
    SOLVERS,
    sensor_models,
    step_sizes,
)
from edition1_companion.twins.table_1_rows import Row, simulate
from edition1_companion.twins.trajectories import lemniscate

CONVERGED = {"noise_mt": SENSOR_NOISE_MT, "iterations": 60}
"""For runs that must converge to rounding; the iteration stops by itself when all have."""


def best(rows: Sequence[Row], config: Config) -> pd.DataFrame:
    """Our best figures: errors of the calibrated and of the uncalibrated multipole model.

    One line per row, draw and coordinate.

    Columns: ``row``, ``quantity`` (``delta_x_1`` and so on), ``draw``, ``calibrated``, ``error_percent`` (relative
    RMSE of eq. (13), in per cent of the range on the trajectory).
    """
    tables = []
    for row in rows:
        measured = session(row, config)
        models = {
            True: calibration(row, measured, config).sensing(row.earth_mt()),
            False: LinearisedSensing(row.robot(), released_moments(), earth_mt=row.earth_mt()),
        }
        for calibrated, sensing in models.items():
            options = {"noise_mt": SENSOR_NOISE_MT, "iterations": config.iterations}
            found = least_squares(compiled(sensing), measured.readings, row.n_segments, **options).q
            table = table_of_draws(relative_error(found, measured.q), row.robot().coordinates)
            tables.append(table.assign(row=row.name, calibrated=calibrated))
    columns = ["row", "quantity", "draw", "calibrated", "error_percent"]
    return pd.concat(tables, ignore_index=True).reindex(columns=columns)


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
    nominal = Row("nominal", n_segments=n_segments)
    simulation = simulate([nominal], ring_name=ring_name, steps=steps)
    q, clean, robot = simulation.q, simulation.u[:, 0], nominal.robot()
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
            estimates[SOLVERS[0], "ground truth"] = track(descent, u, q[0].expand(len(own), -1)).q
        if SOLVERS[1] in solvers:
            by_seed = least_squares(
                compiled(sensing), u.movedim(0, 1), n_segments, noise_mt=max(noise_mt, 1e-6)
            )
            estimates[SOLVERS[1], "straight"] = by_seed.q.movedim(1, 0)
        for (solver_name, started), q_hat in estimates.items():
            columns = {"configuration_percent": relative_error(q_hat, q).mean(-1)}
            columns |= pose_errors(robot, q_hat, q.unsqueeze(1))
            table = pd.DataFrame({key: value.numpy() for key, value in columns.items()})
            labels = {"n_b": n_segments, "model": name, "solver": solver_name, "start": started}
            tables.append(pd.DataFrame({**labels, "seed": own}).join(table))
    return pd.concat(tables, ignore_index=True)


def consistency(n_segments: int) -> Float[Tensor, " n_q"]:
    """Relative errors [%] on T3 of the nominal robot without noise: what the truncation of the series leaves."""
    q = lemniscate(n_segments)
    u = readings(pcc_robot(n_segments), q, ring("released"))
    return relative_error(least_squares(compiled(_nominal(n_segments)), u, n_segments, **CONVERGED).q, q)


def worst_cold_start_mm(n_segments: int, *, starts: int = 1000, seed: int = 0) -> float:
    """Largest error of a coordinate from the straight pose, for noise-free readings anywhere in the training box."""
    q = _in_box(n_segments, starts, seed)
    u = readings(pcc_robot(n_segments), q, ring("released"))
    found = least_squares(compiled(_nominal(n_segments)), u, n_segments, **CONVERGED)
    return 1e3 * float((found.q - q).abs().max())


def coverage(n_segments: int, *, trials: int = 2000, seed: int = 0) -> dict[str, int | float]:
    """How often the 95 % covariance ellipsoid of the estimate contains the truth.

    Truths are uniform in the training box, kept when every coordinate lies at least three standard deviations
    inside the bounds, where the estimate is not cut off.

    Returns
    -------
    dict
        ``trials``, ``inside_95_percent_ellipsoid`` (per cent), ``kept_percent`` (of the truths drawn).
    """
    low, high = box(n_segments)
    sensing = _nominal(n_segments)
    q = _in_box(n_segments, 20 * trials, seed)
    J = torch.cat([jacobian(sensing, part)[1] for part in q.split(1000)])
    margin = 3 * SENSOR_NOISE_MT * torch.linalg.inv(J.mT @ J).diagonal(dim1=-2, dim2=-1).sqrt()
    inside = ((q - margin >= low) & (q + margin <= high)).all(-1)
    kept = float(inside.double().mean())
    q = q[inside][:trials]
    u = readings(pcc_robot(n_segments), q, ring("released"))
    generator = torch.Generator().manual_seed(seed + 1)
    u = u + SENSOR_NOISE_MT * torch.randn(u.shape, generator=generator, dtype=torch.float64)
    found = least_squares(compiled(sensing), u, n_segments, **CONVERGED).q
    error = (found - q).unsqueeze(-1)
    C = covariance(jacobian(sensing, found)[1], SENSOR_NOISE_MT)  # the estimator's own
    distance = (error.mT @ torch.linalg.solve(C, error)).flatten()
    share = 100 * float((distance <= chi2.ppf(0.95, 3 * n_segments)).double().mean())
    return {"trials": len(q), "inside_95_percent_ellipsoid": share, "kept_percent": 100 * kept}


def checks(n_segments: int, *, starts: int = 1000, trials: int = 2000) -> pd.DataFrame:
    """The three checks of the multipole model with Levenberg-Marquardt in one row.

    Columns: ``n_segments``, ``consistency_percent`` (mean of :func:`consistency`), ``cold_starts``,
    ``worst_cold_start_mm``, and those of :func:`coverage`.
    """
    row = {
        "n_segments": n_segments,
        "consistency_percent": float(consistency(n_segments).mean()),
        "cold_starts": starts,
        "worst_cold_start_mm": worst_cold_start_mm(n_segments, starts=starts),
    }
    return pd.DataFrame([row | coverage(n_segments, trials=trials)])


def observability(row: Row) -> pd.DataFrame:
    r"""Directions of the configuration that the readings determine, from weakest to strongest.

    Eigenvectors of the Fisher information :math:`J^T J/\sigma^2` with every coordinate in units of its range on the
    trajectory, along T3 (``where = "T3"``) and along T3 with every :math:`\Delta_y` set to zero (``"delta_y = 0"``).
    With two sensors per segment, three segments give six readings for nine coordinates: in three directions there is
    no information at all. Which ones follows from symmetry: all sensors lie in the x-z plane, so the robot and its
    mirror image in that plane read the same, and bending out of it changes the readings in second order only.

    Columns: ``row``, ``where``, ``direction`` (from 1, the weakest), ``relative_eigenvalue`` (median over time, of
    the largest), ``deviation_percent`` (median of the standard deviation along it at 7.1e-4 mT, per cent of the
    range; the prior width of a uniform distribution over the range is 29 %), ``unobservable_percent`` (share of
    time steps where it exceeds that), ``mainly`` (coordinates that make up the direction, by their share),
    ``mirror_difference_mT`` (largest difference between the readings of the robot and of its mirror image).
    """
    robot, q = row.robot(), lemniscate(row.n_segments)
    sensing = LinearisedSensing(robot, released_moments(), earth_mt=row.earth_mt())
    width = q.amax(0) - q.amin(0)
    across = torch.tensor([1.0, -1.0, 1.0] * row.n_segments, dtype=torch.float64)
    lines = []
    for where, path in (("T3", q), ("delta_y = 0", q * (across > 0))):
        J = jacobian(sensing, path)[1] * width / SENSOR_NOISE_MT
        mirror = float((sensing(path) - sensing(path * across)).abs().max())
        values, vectors = torch.linalg.eigh(J.mT @ J)
        values = values.clamp_min(values[:, -1:] * torch.finfo(values.dtype).eps)
        deviation = 100 / values.sqrt()
        for k in range(robot.n_q):
            share = vectors[:, :, k].square().mean(0)
            lines.append(
                {
                    "row": row.name,
                    "where": where,
                    "direction": k + 1,
                    "relative_eigenvalue": float((values[:, k] / values[:, -1]).median()),
                    "deviation_percent": float(deviation[:, k].median()),
                    "unobservable_percent": 100 * float((deviation[:, k] > 100 / 12**0.5).double().mean()),
                    "mainly": _in_words(share, robot.coordinates),
                    "mirror_difference_mT": mirror,
                }
            )
    return pd.DataFrame(lines)


def _in_words(share: Tensor, names: tuple[str, ...]) -> str:
    """Coordinates with at least a tenth of a direction, the largest first."""
    order = share.argsort(descending=True).tolist()
    return ", ".join(f"{names[k]} {100 * float(share[k]):.0f} %" for k in order if float(share[k]) >= 0.1)


def _nominal(n_segments: int) -> LinearisedSensing:
    return LinearisedSensing(pcc_robot(n_segments), released_moments())


def _in_box(n_segments: int, count: int, seed: int) -> Float[Tensor, "count n_q"]:
    (low, high), generator = box(n_segments), torch.Generator().manual_seed(seed)
    return low + (high - low) * torch.rand(count, len(low), generator=generator, dtype=torch.float64)
