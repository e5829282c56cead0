r"""Section II-D of Mitchell et al. 2021: a particle filter on Spiral, Flower and Seagull.

All readings are synthetic, by magpylib; the filter's own model is the closed form of
:mod:`edition1.sensing.bend_sensor`, compiled as a polynomial (:mod:`edition1.kernels._bend_series`). Every filter
starts straight, where all three curves start. Here are the filters, their errors, and what these follow: the law, and
the reference.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import pandas as pd
import torch
from torch import Tensor

from edition1.estimation.base import track
from edition1.estimation.levenberg_marquardt import LevenbergMarquardt
from edition1.estimation.particle_filter import ParticleFilter
from edition1.estimation.regions import Disc
from edition1.kernels import compiled
from edition1.kinematics.bend import MAX_BEND
from edition1.sensing.bend_sensor import BendSensor
from edition1_companion.recordings.mitchell2021_conventions import noise_of_sigma
from edition1_companion.twins.bend_curves import (
    CURVES,
    LENGTH_M,
    SENSOR_NOISE_MT,
    bend_curve,
    bend_readings,
    curve_times,
)


@dataclass(frozen=True)
class Setting:
    r"""A filter and what it is run on.

    Parameters
    ----------
    name
        For tables and legends.
    process_noise_pi
        Standard deviation of the noise that moves a particle in one step [pi rad].
    length_m
        Distance of sensor and magnet along the arc [m], for the readings and the filter.
    sigma_mt
        :math:`\sigma` of eq. (1) [mT]: :math:`\sqrt 2` times the noise per axis that the filter assumes.
    sensor_noise_mt
        Noise of the readings per axis [mT].
    particles, estimate, resampling, motion
        As for :class:`~edition1.estimation.particle_filter.ParticleFilter`.
    """

    name: str
    process_noise_pi: float = 0.02
    length_m: float = LENGTH_M
    sigma_mt: float = 0.01
    sensor_noise_mt: float = 0.0
    particles: int = 1000
    estimate: str = "best tenth"
    resampling: str = "multinomial"
    motion: str = "random walk"

    def filter(self, process_noise_pi: Sequence[float] | None = None) -> ParticleFilter:
        """Filter of this setting; with several process noises a batch of them, times the curves."""
        noise = torch.tensor(process_noise_pi or [self.process_noise_pi], dtype=torch.float64) * math.pi
        return ParticleFilter(
            compiled(BendSensor(self.length_m)),
            noise[:, None, None].expand(-1, 1, 2),
            noise_of_sigma(self.sigma_mt),
            Disc(MAX_BEND),
            particles=self.particles,
            estimate=self.estimate,
            resampling=self.resampling,
            motion=self.motion,
        )


PAPER = Setting("as printed")
"""The paper's equations at the stated process noise; sigma is that of the released code, the paper gives none."""
FITS = replace(PAPER, name="fits, not stated", process_noise_pi=0.005, length_m=14e-3)
"""The same with the process noise (0.01 pi/2) and the arc length of the released code's simulations."""
NOISY = replace(
    PAPER,
    name="best tenth, sensor noise",
    sigma_mt=math.sqrt(2) * SENSOR_NOISE_MT,
    sensor_noise_mt=SENSOR_NOISE_MT,
)
"""The paper's equations for a real sensor."""
BEST = replace(
    NOISY,
    name="weighted mean, constant velocity, sensor noise",
    process_noise_pi=0.0005,
    estimate="weighted",
    resampling="systematic",
    motion="constant velocity",
)
"""Ours for a real sensor; motion and process noise are those with the smallest error on Spiral in the study
``particle_sensor_noise``."""


def follow(
    setting: Setting,
    *,
    seed: int = 0,
    process_noise_pi: Sequence[float] | None = None,
    steps: int | None = None,
    curves: Sequence[str] = CURVES,
) -> tuple[Tensor, Tensor]:
    """Run a setting along the curves.

    Parameters
    ----------
    setting
        What to run.
    seed
        Of the filter; noise of the readings has the same seed.
    process_noise_pi
        Several process noises [pi rad] in place of the setting's.
    steps
        Number of steps; all when not given.
    curves
        Names of the curves.

    Returns
    -------
    tuple
        Errors of the magnet's position [mm] and whether the filter was lost, ``[steps, process noises, curves]``.
    """
    q = torch.stack([bend_curve(name) for name in curves], dim=1)[:steps]
    u = bend_readings(q, setting.length_m, noise_mt=setting.sensor_noise_mt, seed=seed)
    many = len(process_noise_pi or [0])
    u = u.unsqueeze(1).expand(-1, many, -1, -1)
    start = torch.zeros(many, len(curves), 2, dtype=torch.float64)
    found = track(setting.filter(process_noise_pi), u, start, seed=seed)
    position = BendSensor(setting.length_m).position
    error = torch.linalg.vector_norm(position(found.q) - position(q).unsqueeze(1), dim=-1)
    return 1e3 * error, found.diagnostics["lost"]


def errors_over_time(
    settings: Sequence[Setting], *, seed: int = 0, steps: int | None = None, curves: Sequence[str] = CURVES
) -> pd.DataFrame:
    """Error of every step, as in Fig. 5.

    Parameters
    ----------
    settings, seed, steps, curves
        As for :func:`follow`.

    Returns
    -------
    DataFrame
        Columns ``curve, t, error_mm, setting, process_noise_pi, particles``.
    """
    t = curve_times()[:steps].numpy()
    tables = []
    for setting in settings:
        error, _ = follow(setting, seed=seed, steps=steps, curves=curves)
        run = {
            "setting": setting.name,
            "process_noise_pi": setting.process_noise_pi,
            "particles": setting.particles,
        }
        for c, curve in enumerate(curves):
            tables.append(pd.DataFrame({"curve": curve, "t": t, "error_mm": error[:, 0, c].numpy(), **run}))
    return pd.concat(tables, ignore_index=True)


def errors_by_setting(over_time: pd.DataFrame) -> pd.DataFrame:
    """Errors of a table of :func:`errors_over_time` by setting, number of particles and curve.

    Columns: those, and ``rmse_mm, mean_mm, worst_mm``.
    """
    squared = over_time.assign(squared=over_time["error_mm"] ** 2)
    by = squared.groupby(["setting", "process_noise_pi", "particles", "curve"], sort=False)
    table = by.agg(rmse_mm=("squared", "mean"), mean_mm=("error_mm", "mean"), worst_mm=("error_mm", "max"))
    return table.assign(rmse_mm=table["rmse_mm"] ** 0.5).reset_index()


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
    """Error law at every process noise, number of particles and length of some tables of studies.

    Returns
    -------
    DataFrame
        Columns ``process_noise_pi, particles, length_mm, law_mm``.
    """
    points = pd.concat(tables)[["process_noise_pi", "particles", "length_mm"]].drop_duplicates()
    law = [law_mm(walk, n, length / 1e3) for walk, n, length in points.itertuples(index=False)]
    return points.assign(law_mm=law).reset_index(drop=True)


def over_seeds(table: pd.DataFrame) -> pd.DataFrame:
    """Mean and standard deviation over the seeds of a table of errors, by setting and curve.

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
