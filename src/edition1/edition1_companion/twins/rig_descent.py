"""Table 2 of Baaij et al. 2023 (section 5) with the paper's method, on recordings or SYNTHETIC ones, and errors."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd
import torch
from jaxtyping import Float
from torch import Tensor
from tqdm import tqdm

from edition1.errors import bad_input, require
from edition1.estimation.base import Trajectory, track
from edition1.estimation.gradient_descent import GradientDescent
from edition1.kernels import compiled
from edition1.sensing.ensemble import SeedEnsemble
from edition1.sensing.magnetic import MagneticSensing
from edition1_companion.recordings.baaij2023 import Recording
from edition1_companion.recordings.rig_robot import RIG_RATE_HZ, RIG_SENSORS, rig_earth_axis, rig_robot
from edition1_companion.twins.networks import rows_sha256
from edition1_companion.twins.rig_data import RigData
from edition1_companion.twins.rig_networks import RigSpec, rig_networks, train_rig, trained_on

STEP_SIZE = (1.5e-8, 1.5e-8, 0.0)
"""Step sizes of section 5.4 for delta_x and delta_y; the elongation is not optimised."""
MOMENTUM = 0.2
ITERATIONS = 20
"""Evaluations of the loss in each time step."""
SOLVERS = ("compiled", "torch")
ELLIPSE = 5.991
"""95 % quantile of chi-squared with two degrees of freedom."""
ELONGATIONS = ("known", "mean")
"""What the descent is told of the elongation: its true value at every step, as in the released code, or only its mean
over T5.train."""


def networks(
    data: RigData, seeds: Sequence[int], folder: Path, cache: Path, *, progress: bool = True
) -> SeedEnsemble:
    """Networks of the paper's recipe for these recordings, one for each sensor and seed.

    Those in ``folder`` are of T5.train of the two twins. They answer for the very rows that they were trained on, by
    the hash in their manifests. For any others networks are trained here, about a minute each, and kept in ``cache``.

    Parameters
    ----------
    data
        Its training part is what they must have been trained on.
    seeds
        Seeds of the networks.
    folder, cache
        Of the committed networks, and of those that are trained here.
    progress
        Show one progress bar where networks are trained, in a terminal only.

    Raises
    ------
    FloatingPointError
        If a training diverges.
    InputError
        If networks in the cache are not what their folder says.
    """
    part = data.train
    for second in (False, True):
        if trained_on(part, folder, seeds, second=second):
            return rig_networks(folder, seeds, second=second, twin_sha256=data.twin_sha256)
    content = rows_sha256(torch.from_numpy(part.q), torch.from_numpy(part.u))[:12]
    kept = cache / f"{part.name}_{content}"
    specs = [RigSpec(sensor, seed) for seed in seeds for sensor in range(RIG_SENSORS)]
    missing = [spec for spec in specs if not (kept / f"{spec.name}.safetensors").is_file()]
    if missing:
        print(
            f"No networks are kept that were trained on this {part.name} ({len(part)} frames, SHA-256 {content}):"
            f" {len(missing)} are trained now, about a minute each.",
            flush=True,
        )
    for spec in tqdm(missing, unit="network", disable=None if progress else True):
        train_rig(spec, kept, kept / "checkpoints", part=part, progress=False)
    if not trained_on(part, kept, seeds):
        expected = "of the readings that their folder is named after (remove it to train anew)"
        raise bad_input("networks", kept.name, expected, "others")
    return rig_networks(kept, seeds)


@dataclass(frozen=True)
class PaperRun:
    """What the paper's method finds on the test parts.

    Attributes
    ----------
    parts
        What it was run on.
    seeds
        Seeds of the networks.
    predicted
        Readings [mV] predicted at the true configuration, by trajectory ``[t, seeds, 3]``.
    estimates
        Configurations, by elongation and trajectory ``[t, seeds, 3]``.
    """

    parts: dict[str, Recording]
    seeds: tuple[int, ...]
    predicted: dict[str, np.ndarray]
    estimates: dict[tuple[str, str], np.ndarray]


def rig_sensing(model: SeedEnsemble) -> MagneticSensing:
    """Sensor model of the rig as drawn: networks of several seeds on the relations as angles."""
    return MagneticSensing(rig_robot(), model, "angles", rig_earth_axis())


def paper_descent(sensing: Callable[[Tensor], Tensor], shorter: int) -> GradientDescent:
    """Descent of section 5.4, with the step size divided and the iterations multiplied by ``shorter``."""
    gamma = torch.tensor(STEP_SIZE, dtype=torch.float64) / shorter
    return GradientDescent(sensing, gamma, MOMENTUM, ITERATIONS * shorter)


def paper_method(
    parts: dict[str, Recording],
    model: SeedEnsemble,
    seeds: Sequence[int],
    *,
    mean_elongation_m: float,
    elongations: Sequence[str] = ELONGATIONS,
    solver: str = "compiled",
    shorter: int = 1,
) -> PaperRun:
    """Gradient descent of section 5.4 on delta_x and delta_y, for all seeds at once.

    As in the published runs it starts at the ground truth and carries its momentum from step to step.

    Parameters
    ----------
    parts
        Recordings by trajectory.
    model, seeds
        Networks and their seeds.
    mean_elongation_m
        Elongation that is held when it is not known [m].
    elongations
        Among :data:`ELONGATIONS`.
    solver
        ``"compiled"``, or ``"torch"`` for the same without a kernel.
    shorter
        Divides the step size and multiplies the iterations: 1 is the published method.

    Raises
    ------
    InputError
        If the solver is unknown.
    """
    require(solver in SOLVERS, "solver", "paper_method", f"one of {', '.join(SOLVERS)}", solver)
    sensing, shape = rig_sensing(model), (len(seeds), len(elongations))
    descent = paper_descent(compiled(sensing) if solver == "compiled" else sensing, shorter)
    predicted, estimates = {}, {}
    for name, part in parts.items():
        q, u = (torch.from_numpy(x)[:, None, None].expand(-1, *shape, -1) for x in (part.q, part.u))
        known = torch.full_like(q, torch.nan, memory_format=torch.contiguous_format)
        for k, elongation in enumerate(elongations):
            known[:, :, k, 2] = q[:, :, k, 2] if elongation == "known" else mean_elongation_m
        found = track(descent, u, q[0], rate_hz=RIG_RATE_HZ, known=known).q
        with torch.no_grad():
            truth = torch.from_numpy(part.q).expand(len(seeds), -1, -1)
            predicted[name] = sensing(truth).movedim(0, 1).numpy()
        for k, elongation in enumerate(elongations):
            estimates[elongation, name] = found[:, :, k].numpy()
    return PaperRun(parts, tuple(seeds), predicted, estimates)


def row_name(trajectory: str) -> str:
    """Name of the row of Table 2."""
    return f"T5.train->{trajectory}{'' if trajectory == 'T4' else '.test'}"


def reading_errors(
    predicted: Float[np.ndarray, "t n 3"], part: Recording, whole: Recording
) -> list[dict[str, object]]:
    """Errors of the readings of ``n`` models: root mean square over time, averaged over the sensors.

    Relative ones are in per cent of the range of ``whole``, pooled over the three sensors including their offsets:
    from the smallest reading of any sensor to the largest of any.
    """
    e_u = np.sqrt(((predicted - part.u[:, None]) ** 2).mean(axis=0)).mean(axis=-1)
    width = np.ptp(whole.u)
    return [
        {"model": i, "quantity": "e_u", "unit": unit, "error": float(value)}
        for i, e in enumerate(e_u)
        for unit, value in (("mV", e), ("%", 100 * e / width))
    ]


def bend_errors(
    found: Float[np.ndarray, "t n q"], part: Recording, whole: Recording
) -> list[dict[str, object]]:
    """Errors of the bend of ``n`` estimates [mm], and in per cent of its range in ``whole`` (eq. 13)."""
    error = np.sqrt(((found[..., :2] - part.q[:, None, :2]) ** 2).mean(axis=0))
    width = np.ptp(whole.q[:, :2], axis=0)
    rows = []
    for i, e in enumerate(error):
        for k, quantity in enumerate(("delta_x", "delta_y")):
            for unit, value in (("mm", 1e3 * e[k]), ("%", 100 * e[k] / width[k])):
                rows.append({"model": i, "quantity": quantity, "unit": unit, "error": float(value)})
    return rows


def method_errors(part: Recording, found: dict[str, np.ndarray], own: Trajectory) -> dict[str, float]:
    """Errors of the bend of several methods and of ours.

    Parameters
    ----------
    part
        With the truth.
    found
        Configurations by method ``[t, seeds, 3]``, whose errors are the means over the seeds.
    own
        What ours finds.
    """
    row, own_q, covariance = {}, own.q.numpy(), own.covariance
    assert covariance is not None
    for method, q in (found | {"ours": own_q[:, None]}).items():
        error = np.sqrt(((q - part.q[:, None]) ** 2).mean(axis=0)).mean(axis=0)
        row |= {f"{method}_delta_{axis}_mm": 1e3 * error[k] for k, axis in enumerate("xy")}
    return row | _own_uncertainty(own_q - part.q, covariance.numpy())


def _own_uncertainty(error: np.ndarray, covariance: np.ndarray) -> dict[str, float]:
    """How the covariance of ours fits its errors."""
    e, C = error[:, :2], covariance[:, :2, :2]
    squares = np.einsum("ni,ni->n", e, np.linalg.solve(C, e[..., None])[..., 0])
    within = np.abs(error[:, 2]) < 1.96 * np.sqrt(covariance[:, 2, 2])
    return {
        "ours_delta_L_mm": 1e3 * float(np.sqrt((error[:, 2] ** 2).mean())),
        "covered": float((squares < ELLIPSE).mean()),
        "nees": float(np.median(squares)),
        "covered_delta_L": float(within.mean()),
    }


def paper_errors(run: PaperRun, data: RigData) -> pd.DataFrame:
    """Errors of Table 2 with the paper's method: ``elongation, row, seed, quantity, unit, error``.

    One row for each elongation, trajectory, seed, quantity and unit. Ranges are those of the whole test parts. The
    error of the readings, taken at the true configuration, stands with each elongation.
    """
    rows = []
    for (elongation, name), q in run.estimates.items():
        part, whole = run.parts[name], data.tests[name]
        cells = reading_errors(run.predicted[name], part, whole) + bend_errors(q, part, whole)
        for cell in cells:
            seed = run.seeds[int(cell.pop("model"))]
            rows.append({"elongation": elongation, "row": row_name(name), "seed": seed} | cell)
    return pd.DataFrame(rows)
