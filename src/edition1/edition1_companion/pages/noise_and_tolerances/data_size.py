"""Errors on T3 against the number of training configurations, by sensor model (Baaij et al. 2023, section 3.2).

Training readings carry noise, and the comparison that counts is on readings with noise: a model that is exact would
otherwise need no more readings than it has parameters.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

import pandas as pd
import torch
from edition1.kinematics.paper_robots import pcc_robot
from edition1.sensing.fast_training import epochs_of_steps, train_dipole_residual, train_fast
from edition1.sensing.magnetic import MagneticSensing, readings
from edition1.sensing.magnets import ring
from edition1.sensing.moments import fit_moments
from edition1.sensing.multipole import MultipoleField
from edition1.sensing.network import PerSensor
from edition1.sensing.relations import relations
from torch import Tensor
from tqdm import tqdm

from edition1_companion.pages.noise_and_tolerances.noise import LM_ITERATIONS
from edition1_companion.twins.calibrated_robots import least_squares, relative_error
from edition1_companion.twins.calibration_session import SENSOR_NOISE_MT
from edition1_companion.twins.networks import segment_rows
from edition1_companion.twins.table_1_method import DIPOLE, available, networks
from edition1_companion.twins.table_1_method import MODELS as TABLE_MODELS
from edition1_companion.twins.table_1_rows import Row
from edition1_companion.twins.training_set import TrainingSet, training_set
from edition1_companion.twins.trajectories import lemniscate

SIZES = (30, 100, 300, 1000, 10_000, 120_000)
"""Training configurations of the study; the last is the paper's."""
TERMS = {"3 moments": 3, "5 moments": 5}
"""Multipole models by their number of fitted moments, orders up to 5 and 9."""
TRAINERS = {DIPOLE: train_dipole_residual, TABLE_MODELS[1]: train_fast}
MODELS = (*TERMS, *TRAINERS)
"""Sensor models whose training is varied."""
PAPER = TABLE_MODELS[0]
PAPER_SIZE = 120_000
STEPS = 2520
"""Optimiser steps of every network, those of 10 epochs with 120,000 configurations: sizes differ in data alone."""
COLUMNS = ["n_b", "model", "configurations", "seed", "e_u_mt", "configuration_percent", "noisy_percent"]
ALL_MODELS = (PAPER, *MODELS)
"""The paper's networks, which are committed, and those trained here."""


def data_size_errors(
    sizes: Sequence[int],
    seeds: Sequence[int],
    folder: Path,
    *,
    models: Sequence[str] = ALL_MODELS,
    noise_mt: float = SENSOR_NOISE_MT,
    n_segments: int = 1,
    steps: int = 400,
    progress: bool = False,
) -> pd.DataFrame:
    """Error of the prediction and of the configuration on T3 after training with few or many configurations.

    Configurations and placements of the sensors are those of
    :func:`~edition1_companion.twins.training_set.training_set`, drawn anew for every seed and size; a seed also draws
    the noise, the initial weights and the batches. Moments are fitted by linear least squares to all readings;
    networks train on 70 % of them by the recipes ``"fast"`` and ``"dipole"``, all for the same number of steps. The
    configuration is found by Levenberg-Marquardt from the
    straight pose, at every time step anew. The paper's networks are one point: 120,000 configurations without noise.

    Parameters
    ----------
    sizes
        Numbers of training configurations.
    seeds
        Seeds of data and training; for the paper's networks, of the files.
    folder
        Trained networks of the paper's recipe; left out where they are not all there.
    models
        Among :data:`MODELS` and ``"network of the paper"``.
    noise_mt
        Noise of the training readings, and of the readings on T3 behind ``noisy_percent`` [mT].
    n_segments
        Segments of the robot.
    steps
        Time steps along T3.
    progress
        Show a progress bar.

    Returns
    -------
    DataFrame
        Columns ``n_b, model, configurations, seed``; ``e_u_mt``, the error of the predicted readings at the true
        configuration against readings without noise (root mean square of a sensor, mean over the sensors); and the
        mean relative error of the configuration, eq. (13), on readings without noise (``configuration_percent``)
        and with noise (``noisy_percent``).
    """
    rows = []
    row = Row("nominal", n_segments=n_segments)
    labels = {"n_b": n_segments}
    if PAPER in models and available([row], folder, seeds):
        for seed in seeds:
            ensemble = networks([row], folder, (seed,))
            score = _score(lambda xi, m=ensemble: m(xi[None])[0], "angles", n_segments, steps, noise_mt, seed)
            rows.append(labels | {"model": PAPER, "configurations": PAPER_SIZE, "seed": seed} | score)
    cases = [(size, seed) for size in sizes for seed in seeds]
    for size, seed in tqdm(cases, "training-set sizes", disable=not progress):
        data = _noisy_training_set(n_segments, size, seed, noise_mt)
        for name in (x for x in models if x != PAPER):
            model = _trained(name, data, seed)
            score = _score(model, "cosines", n_segments, steps, noise_mt, seed)
            rows.append(labels | {"model": name, "configurations": size, "seed": seed} | score)
    return pd.DataFrame(rows, columns=COLUMNS)


def _noisy_training_set(n_segments: int, size: int, seed: int, noise_mt: float) -> TrainingSet:
    data = training_set(n_segments, seed=1000 + seed, samples=size)
    generator = torch.Generator().manual_seed(2000 + seed)
    noise = noise_mt * torch.randn(data.u.shape, generator=generator, dtype=data.u.dtype)
    return TrainingSet(data.robot, data.q, data.earth_axis, data.u + noise)


def _trained(name: str, data: TrainingSet, seed: int) -> Callable[[Tensor], Tensor]:
    """Sensor model on cosines."""
    if name in TERMS:
        return MultipoleField(fit_moments(data.robot, data.q, data.u, terms=TERMS[name]).moments)
    cosines = relations(data.robot, data.q).cosines()
    trained = []
    for segment in range(len(data.robot.segments)):
        xi, u = segment_rows(data, cosines, segment)
        network, _ = TRAINERS[name](xi, u, seed=seed, epochs=epochs_of_steps(STEPS, len(u)), progress=False)
        trained.append(network.double().requires_grad_(False))
    return PerSensor(trained, data.robot.sensors.segment)


def _score(
    model: Callable[[Tensor], Tensor], inputs: str, n_segments: int, steps: int, noise_mt: float, seed: int
) -> dict[str, float]:
    robot, q = pcc_robot(n_segments), lemniscate(n_segments, steps=steps)
    sensing = MagneticSensing(robot, model, inputs)
    clean = readings(robot, q, ring("released"))
    generator = torch.Generator().manual_seed(seed)
    noisy = clean + noise_mt * torch.randn(clean.shape, generator=generator, dtype=clean.dtype)
    u = torch.stack([clean, noisy], dim=1)
    found = least_squares(sensing, u, n_segments, iterations=LM_ITERATIONS).q
    percent = relative_error(found, q).mean(-1).tolist()
    with torch.no_grad():
        e_u = (sensing(q) - clean).square().mean(0).sqrt().mean()
    return {"e_u_mt": float(e_u), "configuration_percent": percent[0], "noisy_percent": percent[1]}
