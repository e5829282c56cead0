"""What the exact sensor model can and cannot do: consistency, cold starts, coverage, unobservable directions."""

from __future__ import annotations

import pandas as pd
import torch
from scipy.stats import chi2
from torch import Tensor

from repro.estimation.levenberg_marquardt import covariance, jacobian
from repro.kinematics.paper_robots import pcc_robot
from repro.kinematics.trajectories import lemniscate
from repro.sensing.linearised import LinearisedSensing
from repro.sensing.magnetic import readings
from repro.sensing.magnets import ring
from repro_companion.twins.calibrated_robots import box, estimator, relative_error, start
from repro_companion.twins.calibration_session import L_MAX, SENSOR_NOISE_MT
from repro_companion.twins.table_1_rows import Row

ITERATIONS = 60
"""Limit for runs that must converge to rounding; the iteration stops by itself when all have."""


def consistency(n_segments: int) -> pd.DataFrame:
    """Noise-free nominal robot on T3, readings by magpylib: what is left is the truncation of the series.

    Columns: ``n_segments``, ``quantity``, ``error_percent``.
    """
    robot, q = pcc_robot(n_segments), lemniscate(n_segments)
    method = estimator(n_segments, _nominal(n_segments), ITERATIONS)
    state = method.init(start(n_segments).expand_as(q))
    error = relative_error(method.step(state, readings(robot, q, ring("released")), 0.0)[1].q, q)
    columns = {"n_segments": n_segments, "quantity": list(robot.coordinates), "error_percent": error.numpy()}
    return pd.DataFrame(columns)


def cold_starts(n_segments: int, *, starts: int = 1000, seed: int = 0) -> pd.DataFrame:
    """Noise-free readings by magpylib anywhere in the training box, start at the straight pose.

    Columns: ``n_segments``, ``starts``, ``worst_mm`` (largest error of a coordinate), ``iterations`` (largest).
    """
    low, high = box(n_segments)
    q = low + (high - low) * _uniform(starts, 3 * n_segments, seed=seed)
    method = estimator(n_segments, _nominal(n_segments), ITERATIONS)
    u = readings(pcc_robot(n_segments), q, ring("released"))
    estimate = method.step(method.init(start(n_segments).expand_as(q)), u, 0.0)[1]
    worst = 1e3 * float((estimate.q - q).abs().max())
    iterations = int(estimate.diagnostics["iterations"].max())
    return pd.DataFrame(
        [{"n_segments": n_segments, "starts": starts, "worst_mm": worst, "iterations": iterations}]
    )


def coverage(n_segments: int, *, trials: int = 2000, seed: int = 0) -> pd.DataFrame:
    """How often the 95 % covariance ellipsoid of the estimate contains the truth.

    Truths are uniform in the training box, kept when every coordinate lies at least three standard deviations
    inside the bounds, where the estimate is not cut off.

    Columns: ``n_segments``, ``trials``, ``inside_percent``, ``kept_percent`` (of the truths drawn).
    """
    low, high = box(n_segments)
    sensing = _nominal(n_segments)
    method = estimator(n_segments, sensing, ITERATIONS)
    q = low + (high - low) * _uniform(20 * trials, 3 * n_segments, seed=seed)
    J = torch.cat([jacobian(sensing, part)[1] for part in q.split(1000)])
    margin = 3 * SENSOR_NOISE_MT * torch.linalg.inv(J.mT @ J).diagonal(dim1=-2, dim2=-1).sqrt()
    inside = ((q - margin >= low) & (q + margin <= high)).all(-1)
    kept = float(inside.double().mean())
    q = q[inside][:trials]
    u = readings(pcc_robot(n_segments), q, ring("released"))
    generator = torch.Generator().manual_seed(seed + 1)
    u = u + SENSOR_NOISE_MT * torch.randn(u.shape, generator=generator, dtype=torch.float64)
    estimate = method.step(method.init(start(n_segments).expand_as(q)), u, 0.0)[1]
    error = (estimate.q - q).unsqueeze(-1)
    C = covariance(jacobian(sensing, estimate.q)[1], SENSOR_NOISE_MT)  # the estimator's own
    distance = (error.mT @ torch.linalg.solve(C, error)).flatten()
    share = 100 * float((distance <= chi2.ppf(0.95, 3 * n_segments)).double().mean())
    return pd.DataFrame(
        [{"n_segments": n_segments, "trials": len(q), "inside_percent": share, "kept_percent": 100 * kept}]
    )


def checks(n_segments: int, *, starts: int = 1000, trials: int = 2000) -> pd.DataFrame:
    """The three checks of the multipole model with Levenberg-Marquardt in one row.

    Columns: ``n_segments``, ``consistency_percent`` (mean of :func:`consistency`), ``cold_starts``,
    ``worst_cold_start_mm``, ``trials``, ``inside_95_percent_ellipsoid`` (per cent), ``kept_percent`` (of the truths
    drawn, those three standard deviations inside the bounds: only these are tried).
    """
    cold, inside = cold_starts(n_segments, starts=starts), coverage(n_segments, trials=trials)
    row = {
        "n_segments": n_segments,
        "consistency_percent": consistency(n_segments)["error_percent"].mean(),
        "cold_starts": starts,
        "worst_cold_start_mm": cold["worst_mm"].iloc[0],
        "trials": inside["trials"].iloc[0],
        "inside_95_percent_ellipsoid": inside["inside_percent"].iloc[0],
        "kept_percent": inside["kept_percent"].iloc[0],
    }
    return pd.DataFrame([row])


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
    sensing = LinearisedSensing(
        robot, torch.from_numpy(ring("released").multipoles(L_MAX)), earth_mt=row.earth_mt()
    )
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
    return LinearisedSensing(pcc_robot(n_segments), torch.from_numpy(ring("released").multipoles(L_MAX)))


def _uniform(*shape: int, seed: int) -> Tensor:
    return torch.rand(*shape, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)
