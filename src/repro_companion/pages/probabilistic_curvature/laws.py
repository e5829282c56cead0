"""What the errors of the particle filter of Mitchell et al. 2021 follow: the law, the choice, and the reference."""

from __future__ import annotations

import math

import pandas as pd
import torch

from repro.errors import bad_input
from repro.estimation.levenberg_marquardt import LevenbergMarquardt
from repro.kinematics.bend import MAX_BEND
from repro.sensing.bend_sensor import BendSensor
from repro_companion.twins.bend_curves import CURVES, LENGTH_M, bend_curve, bend_readings
from repro_companion.twins.bend_simulation import SENSOR_NOISE_MT


def law_mm(process_noise_pi: float, particles: int = 1000, length_m: float = LENGTH_M) -> float:
    r"""RMSE [mm] of the best tenth where the process noise ``q`` is much wider than motion and likelihood.

    A tenth of the ``N`` particles is averaged: :math:`0.325\, q\, (L/2)/\sqrt{N/10}`, with the measured factor.
    Where the arc is straight averaging angles adds a bias.

    Examples
    --------
    >>> round(law_mm(0.02), 4)
    0.0153
    """
    return 1e3 * 0.325 * process_noise_pi * math.pi * length_m / 2 / math.sqrt(particles / 10)


def law_table(*tables: pd.DataFrame) -> pd.DataFrame:
    """Error law at every process noise, number of particles and length of some tables of ``errors``.

    Returns
    -------
    DataFrame
        Columns ``process_noise_pi, particles, length_mm, law_mm``.
    """
    points = pd.concat(tables)[["process_noise_pi", "particles", "length_mm"]].drop_duplicates()
    law = [law_mm(walk, n, length / 1e3) for walk, n, length in points.itertuples(index=False)]
    return points.assign(law_mm=law).reset_index(drop=True)


def chosen(sweep: pd.DataFrame) -> dict[str, float | str]:
    """Motion and process noise with the smallest error on Spiral, of a table of ``errors``.

    Raises
    ------
    InputError
        If the table has no row of Spiral.
    """
    spiral = sweep[sweep["curve"] == "spiral"]
    if spiral.empty:
        raise bad_input("sweep", "chosen", "a table with rows of spiral", sorted(set(sweep["curve"])))
    means = spiral.groupby(["motion", "process_noise_pi"], as_index=False)["rmse_mm"].mean()
    best = means.sort_values("rmse_mm").iloc[0]
    return {"motion": str(best["motion"]), "process_noise_pi": float(best["process_noise_pi"])}


def over_seeds(table: pd.DataFrame) -> pd.DataFrame:
    """Mean and standard deviation over the seeds of a table of ``errors``, by setting and curve.

    Returns
    -------
    DataFrame
        Columns ``setting, process_noise_pi, noise_mt, curve, rmse_mm, rmse_std_mm, seeds``.
    """
    by = table.groupby(["setting", "process_noise_pi", "noise_mt", "curve"], sort=False)["rmse_mm"]
    columns = {"mean": "rmse_mm", "std": "rmse_std_mm", "count": "seeds"}
    return by.agg(list(columns)).rename(columns=columns).reset_index()


def memoryless(steps: int | None = None, *, noise_mt: float = SENSOR_NOISE_MT, seed: int = 0) -> pd.DataFrame:
    """Error of least squares on every reading by itself, from the straight pose: columns ``curve, rmse_mm``.

    Parameters
    ----------
    steps
        Number of steps; all when not given.
    noise_mt
        Noise of the readings per axis [mT].
    seed
        Of the noise.
    """
    q = torch.stack([bend_curve(name) for name in CURVES], dim=1)[:steps]
    u = bend_readings(q, noise_mt=noise_mt, seed=seed)
    sensor, bound = BendSensor(LENGTH_M), torch.full((2,), MAX_BEND, dtype=torch.float64)
    solver = LevenbergMarquardt(sensor, -bound, bound, noise_mt=noise_mt)
    _, found = solver.step(solver.init(torch.zeros_like(q)), u, 0.0)
    error = 1e3 * torch.linalg.vector_norm(sensor.position(found.q) - sensor.position(q), dim=-1)
    return pd.DataFrame({"curve": CURVES, "rmse_mm": (error**2).mean(0).sqrt().numpy()})
