"""Table 1 of Baaij et al. 2023 with the paper's method: its rows, its settings, its errors."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import pandas as pd
import torch
from torch import Tensor

from repro.errors import bad_input
from repro.estimation.base import Trajectory, track
from repro.estimation.gradient_descent import GradientDescent
from repro.experiments.baaij2023_training import SEEDS, NetworkSpec
from repro.experiments.parallel import in_processes
from repro.kinematics.mounts import Mounts
from repro.kinematics.robot import Robot
from repro.sensing.ensemble import SeedEnsemble
from repro.sensing.magnetic import EARTH_MT, MagneticSensing, readings
from repro.sensing.magnets import ring
from repro.sensing.weights import load_paper_network
from repro.simulation.robots import SENSOR_RADIAL_M, pcc_robot
from repro.simulation.trajectories import lemniscate


@dataclass(frozen=True)
class Row:
    """One simulation of Table 1.

    Parameters
    ----------
    name
        As in the table of published values.
    n_segments, sensors_per_segment
        The robot.
    tilt_deg
        Tilt of all sensors inwards.
    radial_m
        Distance of all sensors from the backbone.
    earth_axis
        Direction of the Earth field; none without.
    same_as
        Names of other rows of the table that are the same run.
    """

    name: str
    n_segments: int = 3
    sensors_per_segment: int = 3
    tilt_deg: float = 0.0
    radial_m: float = SENSOR_RADIAL_M
    earth_axis: tuple[float, float, float] | None = None
    same_as: tuple[str, ...] = ()

    def robot(self) -> Robot:
        """Nominal robot of the row."""
        tilt = math.radians(self.tilt_deg)
        return pcc_robot(self.n_segments, self.sensors_per_segment, tilt=tilt, radial=self.radial_m)

    def earth_mt(self) -> Tensor | None:
        """Earth field [mT] in the base frame."""
        return (
            None if self.earth_axis is None else EARTH_MT * torch.tensor(self.earth_axis, dtype=torch.float64)
        )


ROWS = (
    Row("n_b=1", n_segments=1),
    Row("n_b=2", n_segments=2),
    Row("n_b=3", same_as=("n_s=9", "nominal")),
    Row("n_s=6", sensors_per_segment=2),
    Row("n_s=12", sensors_per_segment=4),
    Row("n_s=18", sensors_per_segment=6),
    Row("psi_s=10deg", tilt_deg=10.0),
    Row("d_s_r=16mm", radial_m=16e-3),
    Row("n_e=(1,0,0)", earth_axis=(1.0, 0.0, 0.0)),
    Row("n_e=(0,1,0)", earth_axis=(0.0, 1.0, 0.0)),
    Row("n_e=(0,0,1)", earth_axis=(0.0, 0.0, 1.0)),
)
"""The 11 distinct simulations of Table 1; three of its 13 rows are the same run."""

STEP_SIZES = {1: (3.5e-4, 3.5e-4), 2: (3e-3, 3e-4), 3: (2e-3, 2e-4)}
"""Step sizes of section 3.3 for bending and for elongation, by number of segments (ring ``"released"``)."""
MOMENTUM = 0.3
ITERATIONS = 20


def rows_named(names: Sequence[str]) -> tuple[Row, ...]:
    """Rows of these names, in the order of the table; all when there is no name.

    Raises
    ------
    InputError
        If there is no row of a name.
    """
    known = {row.name for row in ROWS}
    if unknown := [name for name in names if name not in known]:
        raise bad_input("rows", "Table 1", f"among {', '.join(map(repr, sorted(known)))}", unknown)
    return tuple(row for row in ROWS if not names or row.name in names)


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


@dataclass(frozen=True)
class Simulation:
    """Rows that share their networks, as one batch: sensors padded to the largest row and masked.

    Parameters
    ----------
    rows
        Of equal number of segments, all with or all without an Earth field.
    robot
        Batch of robots ``[rows]``.
    q
        Trajectory ``[t, n_q]``, the same for all rows.
    u
        Readings ``[t, rows, s]``, by magpylib.
    mask
        Which of the padded sensors exist ``[rows, s]``.
    earth_axis
        Directions of the Earth field ``[rows, 3]``.
    """

    rows: tuple[Row, ...]
    robot: Robot
    q: Tensor
    u: Tensor
    mask: Tensor
    earth_axis: Tensor | None


def simulate(rows: Sequence[Row], *, ring_name: str = "released", steps: int = 400) -> Simulation:
    """Trajectory T3 and the readings of every row on it."""
    n = rows[0].n_segments
    widest = max(row.sensors_per_segment for row in rows)
    robots = [row.robot() for row in rows]
    sensors = [
        _padded(r.sensors, n, row.sensors_per_segment, widest) for r, row in zip(robots, rows, strict=True)
    ]
    stacked = Mounts(
        sensors[0].segment, torch.stack([s.axial for s in sensors]), torch.stack([s.local for s in sensors])
    )
    robot = replace(robots[0], sensors=stacked)
    exists = [[j < row.sensors_per_segment for _ in range(n) for j in range(widest)] for row in rows]
    earth_axis = None
    if rows[0].earth_axis is not None:
        earth_axis = torch.tensor([row.earth_axis for row in rows], dtype=torch.float64)
    q = lemniscate(n, steps=steps)
    earth_mt = None if earth_axis is None else EARTH_MT * earth_axis
    u = readings(robot, q.unsqueeze(1), ring(ring_name), earth_mt=earth_mt)
    return Simulation(tuple(rows), robot, q, u, torch.tensor(exists), earth_axis)


def _padded(sensors: Mounts, n_segments: int, count: int, widest: int) -> Mounts:
    """Repeat the last sensor of each segment until all segments have ``widest``."""
    index = [i * count + min(j, count - 1) for i in range(n_segments) for j in range(widest)]
    return Mounts(tuple(sensors.segment[k] for k in index), sensors.axial[index], sensors.local[index])


def networks(rows: Sequence[Row], folder: Path, seeds: Sequence[int]) -> SeedEnsemble:
    """Committed networks of the paper's recipe for these rows, one per seed and segment."""
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
    estimator = GradientDescent(sensing, step_size, MOMENTUM, iterations, backend="compiled")
    estimates = track(estimator, u, start, mask=s.mask.expand(len(u), 1, *s.mask.shape), progress=progress)
    with torch.no_grad():
        predicted = sensing(s.q[None, :, None].expand(n_seeds, -1, len(s.rows), -1))
    return estimates, predicted


def errors(
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
    tables = in_processes(tasks, jobs)
    order = {row.name: k for k, row in enumerate(ROWS)}
    table = pd.concat(tables, ignore_index=True)
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
    estimates, predicted = paper_method(simulation, networks(rows, folder, seeds), len(seeds), **options)
    return errors(simulation, estimates, predicted, seeds)


def groups(rows: Sequence[Row]) -> list[tuple[Row, ...]]:
    """Rows by the networks that they use, so that each group is one batch."""
    kinds: dict[tuple[int, bool], list[Row]] = {}
    for row in rows:
        kinds.setdefault((row.n_segments, row.earth_axis is not None), []).append(row)
    return [tuple(group) for group in kinds.values()]
