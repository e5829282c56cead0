"""Table 2 of Baaij et al. 2023 (section 5) with the paper's method, on the authors' recordings or a SYNTHETIC twin's.

Trained on T5.train; tested on the ends of T0, T1, T2, T3 and T5, and on the whole of T4.
"""

# The stubs of pandas know less than the library does.
# pyright: reportArgumentType=false, reportCallIssue=false, reportAttributeAccessIssue=false

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pandas as pd
import torch
from jaxtyping import Float

from repro.errors import bad_input
from repro.estimation.base import track
from repro.estimation.gradient_descent import GradientDescent
from repro.experiments.baaij2023_rig_training import RECORDING_SEED, RigSpec, rig_networks, train_rig
from repro.experiments.baaij2023_twin import record_twin
from repro.recordings.baaij2023 import NAMES, Recording, find_recording, process, split
from repro.sensing.ensemble import SeedEnsemble
from repro.sensing.magnetic import MagneticSensing
from repro.sensing.rig import RIG_RATE_HZ, RIG_SENSORS, rig_earth_axis, rig_robot
from repro.simulation.pneumatic_actuation import TRAJECTORIES
from repro.simulation.pneumatic_rig import TwinConfig
from repro.simulation.rig_twins import nominal_twin

STEP_SIZE = (1.5e-8, 1.5e-8, 0.0)
"""Step sizes of section 5.4 for delta_x and delta_y; the elongation is not optimised."""
MOMENTUM = 0.2
ITERATIONS = 20
"""Evaluations of the loss in each time step."""
ELONGATIONS = ("known", "mean")
"""What the descent is told of the elongation: its true value at every step, as in the released code, or only its mean
over T5.train."""
SOURCES = ("auto", "recorded", "twin")


@dataclass(frozen=True)
class RigData:
    """What Table 2 is made from.

    Attributes
    ----------
    train
        T5.train.
    tests
        Test part of each trajectory, whole for T4.
    twin_sha256
        Hash of the digital twin that recorded them; None for the authors' recordings.
    """

    train: Recording
    tests: dict[str, Recording]
    twin_sha256: str | None

    def shortened(self, longest_s: float) -> dict[str, Recording]:
        """Beginnings of the test parts, of at most this length [s]; all of them for 0."""
        kept = slice(0, round(longest_s * RIG_RATE_HZ) or None)
        return {
            name: replace(part, frame=part.frame[kept], q=part.q[kept], u=part.u[kept])
            for name, part in self.tests.items()
        }


def load_recordings(
    source: str = "auto",
    *,
    trajectories: Sequence[str] = TRAJECTORIES,
    test_share: float = 0.3,
    folder: Path | None = None,
    config: TwinConfig | None = None,
    longest_s: float | None = None,
) -> RigData:
    """Training part of T5 and test parts.

    Parameters
    ----------
    source
        ``"recorded"``: the authors' raw files; ``"twin"``: the digital twin, synthetic; ``"auto"``: the first if all
        files are found.
    trajectories
        Which ones to test on.
    test_share
        Share of the test parts: 0.3 in the released code, 0.2 in section 5.3.
    folder
        The paper's folder, see `repro.recordings.baaij2023.find_recording`.
    config
        The twin; the nominal one when not given.
    longest_s
        Cut the twin's sequences to this length [s].

    Raises
    ------
    InputError
        If the source or a trajectory is unknown, there is none, or recorded files were asked for and are not there.
    """
    if source not in SOURCES:
        raise bad_input("source", "load_recordings", f"one of {', '.join(map(repr, SOURCES))}", repr(source))
    if not trajectories or not set(trajectories) <= set(TRAJECTORIES):
        expected = f"among {', '.join(TRAJECTORIES)}, at least one"
        raise bad_input("trajectories", "load_recordings", expected, trajectories)
    wanted = [name for name in TRAJECTORIES if name in trajectories or name == "T5"]
    missing = [name for name in wanted if find_recording(name, folder) is None]
    if source == "recorded" and missing:
        expected = "recorded: the authors' raw files of " + ", ".join(wanted)
        raise bad_input("source", "load_recordings", expected, f"none of {', '.join(missing)}")
    digest = None
    if source == "twin" or missing:
        twin = config or nominal_twin()
        recorded = record_twin(twin, seed=RECORDING_SEED, trajectories=wanted, longest_s=longest_s).read
        digest = twin.sha256
    else:
        recorded = {name: process(NAMES[name], folder) for name in wanted}
    train, _ = split(recorded["T5"], test_share)
    tests = {
        name: recorded[name] if name == "T4" else split(recorded[name], test_share)[1]
        for name in wanted
        if name in trajectories
    }
    return RigData(train, tests, digest)


def networks(
    data: RigData, seeds: Sequence[int], folder: Path, cache: Path, *, progress: bool = True
) -> SeedEnsemble:
    """Networks of the paper's recipe for these recordings, one for each sensor and seed.

    Those of the twin are committed in ``folder``. For the authors' recordings they are trained here, about a minute
    for each, and kept in ``cache``.

    Raises
    ------
    InputError
        If the data are of a twin and the networks are not there, or belong to another twin.
    """
    if data.twin_sha256 is not None:
        return rig_networks(folder, seeds, twin_sha256=data.twin_sha256)
    kept = cache / f"{data.train.name}_{len(data.train)}"
    for seed in seeds:
        for sensor in range(RIG_SENSORS):
            train_rig(RigSpec(sensor, seed), kept, kept / "checkpoints", part=data.train, progress=progress)
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


def paper_method(
    parts: dict[str, Recording],
    model: SeedEnsemble,
    seeds: Sequence[int],
    *,
    mean_elongation_m: float,
    elongations: Sequence[str] = ELONGATIONS,
    backend: str = "torch",
    progress: bool = False,
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
    backend
        Of :class:`~repro.estimation.gradient_descent.GradientDescent`.
    progress
        Show a progress bar for each trajectory.

    Raises
    ------
    InputError
        If an elongation is unknown.
    """
    if not elongations or not set(elongations) <= set(ELONGATIONS):
        expected = f"among {', '.join(ELONGATIONS)}, at least one"
        raise bad_input("elongations", "paper_method", expected, elongations)
    sensing, shape = rig_sensing(model), (len(seeds), len(elongations))
    gamma = torch.tensor(STEP_SIZE, dtype=torch.float64)
    descent = GradientDescent(sensing, gamma, MOMENTUM, ITERATIONS, backend=backend)
    predicted, estimates = {}, {}
    for name, part in parts.items():
        q, u = (torch.from_numpy(x)[:, None, None].expand(-1, *shape, -1) for x in (part.q, part.u))
        known = torch.full_like(q, torch.nan, memory_format=torch.contiguous_format)
        for k, elongation in enumerate(elongations):
            known[:, :, k, 2] = q[:, :, k, 2] if elongation == "known" else mean_elongation_m
        label = name if progress else None
        found = track(descent, u, q[0], rate_hz=RIG_RATE_HZ, known=known, progress=label).q
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


def summary(table: pd.DataFrame) -> pd.DataFrame:
    """Mean and sample standard deviation over the seeds: ``row, quantity, unit, mean, std, count``."""
    cells = table.groupby(["row", "quantity", "unit"], sort=False)["error"]
    return cells.agg(["mean", "std", "count"]).reset_index()


def whole_errors(
    *, folder: Path, seeds: Sequence[int], elongations: Sequence[str], backend: str, progress: bool = False
) -> pd.DataFrame:
    """Errors of the paper's method on the whole test parts of the nominal twin; synthetic. Minutes: kept as a study.

    Parameters
    ----------
    folder
        Of the committed networks.
    seeds, elongations, backend, progress
        As in :func:`paper_method`.
    """
    data = load_recordings("twin")
    model = rig_networks(folder, seeds, twin_sha256=data.twin_sha256)
    held = float(data.train.q[:, 2].mean())
    options = {"elongations": elongations, "backend": backend, "progress": progress}
    return paper_errors(paper_method(data.tests, model, seeds, mean_elongation_m=held, **options), data)
