"""Our best figures for Table 1 of Baaij et al. 2023: a robot that is not as drawn, calibrated in 100 poses.

Frozen before any figure on the lemniscate T3 was taken; what could be chosen was chosen on the half lemniscate T2.
Readings come from magpylib and the true robot; the estimator knows the drawing, its tolerances and, if calibrated,
readings in measured poses. Nothing starts at, or holds, a true coordinate of the trajectory.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import pandas as pd
import torch
from jaxtyping import Float
from torch import Tensor

from repro import se3
from repro.errors import bad_input
from repro.estimation.calibration import Calibration, calibrate
from repro.estimation.levenberg_marquardt import LevenbergMarquardt
from repro.estimation.poses import configurations
from repro.experiments.baaij2023_table1 import ROWS, Row
from repro.kinematics.robot import Robot
from repro.sensing.linearised import LinearisedSensing
from repro.sensing.magnetic import readings
from repro.sensing.magnets import ring
from repro.sensing.placement import Tolerances, placed
from repro.simulation.training_set import BENDING_M, ELONGATION_M
from repro.simulation.trajectories import lemniscate

SENSOR_NOISE_MT = 7.1e-4
L_MAX = 9
BOOTSTRAPS = 10_000


@dataclass(frozen=True)
class Config:
    """Settings of the comparison.

    Parameters
    ----------
    draws
        Robots per row, each with its own poses and noise.
    poses
        Calibration poses: random configurations in the training box.
    position_m, rotation_rad
        Noise of a measured pose: standard deviation of the position along, and of the rotation about, each axis.
    iterations
        Levenberg-Marquardt iterations per time step. Every time step starts from the straight pose at mid
        elongation, none from its predecessor; on T2 five iterations and twelve agree in four digits.
    seed
        Of all draws.
    half
        Evaluate on the half lemniscate T2 (for choices) instead of the full one T3.
    """

    draws: int = 10
    poses: int = 100
    position_m: float = 0.2e-3
    rotation_rad: float = math.radians(0.2)
    iterations: int = 5
    seed: int = 0
    half: bool = False

    def __post_init__(self) -> None:
        if self.draws < 1 or self.poses < 1:
            raise bad_input("draws, poses", "Config", "at least 1", (self.draws, self.poses))


def box(n_segments: int) -> tuple[Float[Tensor, " n_q"], Float[Tensor, " n_q"]]:
    """Bounds of the training box [m]: bending of 20.73 mm either way, elongation from 0 to 6.6 mm."""
    high = torch.tensor([BENDING_M, BENDING_M, ELONGATION_M["released"]] * n_segments, dtype=torch.float64)
    low = torch.tensor([-BENDING_M, -BENDING_M, 0.0] * n_segments, dtype=torch.float64)
    return low, high


def start(n_segments: int) -> Float[Tensor, " n_q"]:
    """Return the straight pose at mid elongation, (0, 0, 2.75 mm) for every segment."""
    return torch.tensor([0.0, 0.0, 2.75e-3] * n_segments, dtype=torch.float64)


def estimator(n_segments: int, sensing: LinearisedSensing, iterations: int) -> LevenbergMarquardt:
    """Levenberg-Marquardt within the training box."""
    return LevenbergMarquardt(sensing, *box(n_segments), noise_mt=SENSOR_NOISE_MT, iterations=iterations)


@dataclass(frozen=True)
class Session:
    """Draws of one row, batched: true robots, what was measured to calibrate them, what is to be estimated.

    Parameters
    ----------
    true_robot
        Batch of robots. Only the readings come from it.
    poses
        Measured poses of the segments' tips.
    pose_readings
        Readings in these poses [mT].
    q
        True configurations of the trajectory [m], to score the estimates.
    readings
        Readings on the trajectory [mT], time first.
    """

    true_robot: Robot
    poses: Float[Tensor, "draws poses i 4 4"]
    pose_readings: Float[Tensor, "draws poses s"]
    q: Float[Tensor, "t n_q"]
    readings: Float[Tensor, "t draws s"]


def session(row: Row, config: Config) -> Session:
    """Draw robots and measurements; every draw has a generator of its own, the same for all rows.

    Offsets and tilts of the magnets (0.5 mm, 2 degrees on each axis) and errors of the sensors (azimuth 1 % of a
    turn, radius 1 %) are uniform within their limits; noise is normal.
    """
    robot, magnet, moments = row.robot(), ring("released"), _moments()
    limits = Tolerances().of_parameters(robot, len(moments))
    n_m, n_s = len(robot.magnets), len(robot.sensors)
    limits[5 * n_m : 5 * n_m + 4 * n_s].view(n_s, 4)[:, 2:] = (
        0.0  # tilt and gain of the sensors are as drawn,
    )
    limits[5 * n_m + 4 * n_s :] = 0.0  # and so are the moments
    low, high = box(row.n_segments)
    q = lemniscate(row.n_segments, half=config.half)
    errors, poses_q, pose_noise, noise = [], [], [], []
    for draw in range(config.draws):
        g = torch.Generator().manual_seed(1000 * config.seed + draw)
        errors.append(limits * (2 * torch.rand(len(limits), generator=g, dtype=torch.float64) - 1))
        uniform = torch.rand(config.poses, robot.n_q, generator=g, dtype=torch.float64)
        poses_q.append(low + (high - low) * uniform)
        pose_noise.append(torch.randn(config.poses, row.n_segments, 6, generator=g, dtype=torch.float64))
        noise.append(
            SENSOR_NOISE_MT * torch.randn(config.poses + len(q), n_s, generator=g, dtype=torch.float64)
        )
    parts = placed(robot, moments, torch.stack(errors))
    true_robot = replace(robot, magnets=parts.magnets, sensors=parts.sensors)
    at_poses = torch.stack(poses_q, dim=1)
    u_poses = readings(true_robot, at_poses, magnet, earth_mt=row.earth_mt()).transpose(0, 1)
    u = readings(true_robot, q.unsqueeze(1), magnet, earth_mt=row.earth_mt())
    tips = true_robot.base_poses(at_poses.transpose(0, 1))[..., 1:, :, :]
    both = torch.stack(noise)
    return Session(
        true_robot=true_robot,
        poses=_measured(tips, torch.stack(pose_noise), config),
        pose_readings=u_poses + both[:, : config.poses],
        q=q,
        readings=u + both[:, config.poses :].transpose(0, 1),
    )


def calibration(row: Row, measured: Session, config: Config) -> Calibration:
    """Calibrate all draws of a row from their measured poses and readings."""
    robot = row.robot()
    q, covariance = configurations(
        robot, measured.poses, position_m=config.position_m, rotation_rad=config.rotation_rad
    )
    return calibrate(
        robot,
        q,
        covariance,
        measured.pose_readings,
        _moments(),
        noise_mt=SENSOR_NOISE_MT,
        earth_mt=row.earth_mt(),
    )


def best(rows: Sequence[Row] = ROWS, config: Config | None = None) -> pd.DataFrame:
    """Errors of the calibrated and of the uncalibrated multipole model, one line per row, draw and coordinate.

    Columns: ``row``, ``quantity`` (``delta_x_1`` and so on), ``draw``, ``calibrated``, ``error_percent`` (relative
    RMSE of eq. (13), in per cent of the range on the trajectory).
    """
    config = config or Config()
    tables = []
    for row in rows:
        measured = session(row, config)
        models = {
            True: calibration(row, measured, config).sensing(row.earth_mt()),
            False: LinearisedSensing(row.robot(), _moments(), earth_mt=row.earth_mt()),
        }
        for calibrated, sensing in models.items():
            method = estimator(row.n_segments, sensing, config.iterations)
            q0 = start(row.n_segments).expand(len(measured.q), config.draws, -1)
            found = method.step(method.init(q0), measured.readings, 0.0)[1].q
            error = relative_error(found, measured.q)
            table = pd.DataFrame(error.numpy(), columns=list(row.robot().coordinates))
            table = (
                table.rename_axis("draw")
                .reset_index()
                .melt("draw", var_name="quantity", value_name="error_percent")
            )
            tables.append(table.assign(row=row.name, calibrated=calibrated))
    columns = ["row", "quantity", "draw", "calibrated", "error_percent"]
    return pd.concat(tables, ignore_index=True).reindex(columns=columns)


def summary(table: pd.DataFrame, *, seed: int = 0) -> pd.DataFrame:
    """Means over draws and the gain by calibration, with a paired bootstrap interval over the draws.

    Columns: ``row``, ``quantity`` (a coordinate, or ``mean`` over the coordinates of a row), ``calibrated_percent``
    and ``uncalibrated_percent`` with ``_std`` (sample standard deviation over draws), ``ratio`` of the two means,
    ``ratio_low`` and ``ratio_high`` (95 %).
    """
    lines = []
    for row, quantity in _pairs(table):
        here = table.query("row == @row" if quantity == "mean" else "row == @row and quantity == @quantity")
        pairs = here.pivot_table(index="draw", columns="calibrated", values="error_percent", aggfunc="mean")
        yes, no = pairs[True].to_numpy(), pairs[False].to_numpy()
        index = np.random.default_rng(seed).integers(len(yes), size=(BOOTSTRAPS, len(yes)))
        low, high = np.quantile(yes[index].mean(1) / no[index].mean(1), [0.025, 0.975])
        spread = [x.std(ddof=1) if len(x) > 1 else math.nan for x in (yes, no)]
        lines.append(
            {
                "row": row,
                "quantity": quantity,
                "calibrated_percent": yes.mean(),
                "calibrated_percent_std": spread[0],
                "uncalibrated_percent": no.mean(),
                "uncalibrated_percent_std": spread[1],
                "ratio": yes.mean() / no.mean(),
                "ratio_low": low,
                "ratio_high": high,
            }
        )
    return pd.DataFrame(lines)


def against_published(table: pd.DataFrame, published: pd.DataFrame) -> pd.DataFrame:
    """Mean over the per-cent columns of each row of best/published.

    Parameters
    ----------
    table
        From :func:`best`.
    published
        Published values in long form: ``paper``, ``artefact``, ``row``, ``quantity``, ``unit``, ``value``.

    Returns
    -------
    DataFrame
        ``row``, ``calibrated`` and ``uncalibrated``: the mean ratio of each.
    """
    here = published.query("paper == 'baaij2023' and artefact == 'Table 1' and unit == '%'")
    means = table.pivot_table(
        index=["row", "quantity"], columns="calibrated", values="error_percent", sort=False
    )
    joined = means.reset_index().merge(here[["row", "quantity", "value"]], validate="one_to_one")
    joined = joined.assign(
        calibrated=joined[True] / joined["value"], uncalibrated=joined[False] / joined["value"]
    )
    return joined.pivot_table(index="row", values=["calibrated", "uncalibrated"], sort=False).reset_index()


def relative_error(
    found: Float[Tensor, "t *batch n_q"], truth: Float[Tensor, "t n_q"]
) -> Float[Tensor, "*batch n_q"]:
    """Relative RMSE over time, eq. (13): in per cent of the range of the truth."""
    width = truth.amax(0) - truth.amin(0)
    truth = truth.reshape(len(truth), *(1,) * (found.ndim - 2), -1)
    return 100 * (found - truth).square().mean(0).sqrt() / width


def _pairs(table: pd.DataFrame) -> list[tuple[str, str]]:
    """Rows and quantities in their order, ``mean`` last in each row."""
    keys: dict[str, list[str]] = {}
    for row, quantity in zip(table["row"], table["quantity"], strict=True):
        names = keys.setdefault(row, [])
        if quantity not in names:
            names.append(quantity)
    return [(row, quantity) for row, names in keys.items() for quantity in [*names, "mean"]]


def _moments() -> Tensor:
    """Moments of the ring as drawn."""
    return torch.from_numpy(ring("released").multipoles(L_MAX))


def _measured(T: Tensor, noise: Tensor, config: Config) -> Tensor:
    """Poses as a motion capture system sees them: small rotations about, and offsets along, each axis."""
    angle, offset = config.rotation_rad * noise[..., :3], config.position_m * noise[..., 3:]
    turn = se3.rotation_x(angle[..., 0]) @ se3.rotation_y(angle[..., 1]) @ se3.rotation_z(angle[..., 2])
    return se3.pose(T[..., :3, :3] @ turn, T[..., :3, 3] + offset)
