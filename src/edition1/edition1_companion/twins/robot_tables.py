"""Kinematics and field of the simulated robots of Baaij et al. 2023 as tidy tables (section 2.2, appendix A)."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import pandas as pd
import torch
from jaxtyping import Float
from torch import Tensor

from edition1.errors import require
from edition1.kinematics.constant_curvature import ConstantCurvature
from edition1.kinematics.paper_robots import Dimensions, pcc_robot
from edition1.kinematics.robot import Robot
from edition1.sensing.magnetic import field_at_sensors, readings
from edition1.sensing.magnets import Cube, Ring, ring
from edition1.sensing.relations import relations
from edition1_companion.twins.trajectories import RATE_HZ, lemniscate

MM = 1e3


def backbones(robot: Robot, q: Tensor, n_points: int = 25) -> pd.DataFrame:
    """Backbone points of several configurations: one row per point.

    Columns: ``shape`` (row of ``q``), ``segment`` (from 1), ``x_mm``, ``y_mm``, ``z_mm`` in the base frame.
    """
    n = len(robot.segments)
    points = MM * robot.backbone(q, n_points)
    table = pd.DataFrame(points.reshape(-1, 3).numpy(), columns=["x_mm", "y_mm", "z_mm"])
    table.insert(0, "shape", [k for k in range(len(q)) for _ in range(n * n_points)])
    table.insert(1, "segment", [i + 1 for _ in range(len(q)) for i in range(n) for _ in range(n_points)])
    return table


def stills(
    robot: Robot,
    times_s: Sequence[float],
    truth: Float[Tensor, "stills n_q"],
    estimates: Float[Tensor, "stills seeds n_q"],
    seeds: Sequence[int],
) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Backbone at some times, true and estimated, and the parts in the true shape.

    Returns
    -------
    DataFrame, DataFrame
        ``time_s``, ``kind`` (``truth``, or ``estimate`` with its ``seed``), ``x_mm``, ``y_mm``, ``z_mm``; and
        ``time_s``, ``part`` (``magnet`` or ``sensor``), ``x_mm``, ``y_mm``, ``z_mm``.
    """
    shapes, parts = [], []
    for time_s, true, found in zip(times_s, truth, estimates, strict=True):
        curves = [("truth", -1, true), *(("estimate", s, q) for s, q in zip(seeds, found, strict=True))]
        for kind, seed, q in curves:
            shapes.append(_points(robot.backbone(q)).assign(time_s=time_s, kind=kind, seed=seed))
        for part, T in (("magnet", robot.magnet_poses(true)), ("sensor", robot.sensor_poses(true))):
            parts.append(_points(T[:, :3, 3]).assign(time_s=time_s, part=part))
    return pd.concat(shapes, ignore_index=True), pd.concat(parts, ignore_index=True)


def _points(positions: Float[Tensor, "n 3"]) -> pd.DataFrame:
    return pd.DataFrame(MM * positions.numpy(), columns=["x_mm", "y_mm", "z_mm"])


def misprint(delta_mm: float, n_points: int = 41) -> pd.DataFrame:
    """Backbone of one segment by eq. (15) as printed and with the factor ``1/v`` removed.

    Columns: ``v``, ``x_mm`` and ``z_mm`` (corrected), ``x_printed_mm`` and ``z_printed_mm``; bending in the x-z
    plane, no elongation.
    """
    segment = ConstantCurvature(Dimensions.LENGTH_M, Dimensions.RADIUS_M)
    v = torch.linspace(0, 1, n_points, dtype=torch.float64)
    p = MM * segment.pose(torch.tensor([delta_mm / MM, 0.0, 0.0], dtype=torch.float64), v)[:, :3, 3]
    columns = {
        "v": v,
        "x_mm": p[:, 0],
        "z_mm": p[:, 2],
        "x_printed_mm": p[:, 0] / v,
        "z_printed_mm": p[:, 2] / v,
    }
    return pd.DataFrame({name: x.numpy() for name, x in columns.items()}).iloc[1:]


def inverse_round_trip(n: int = 10_000, seed: int = 0) -> pd.DataFrame:
    """Largest error of the closed-form inverse by bending angle, over random tip poses.

    Columns: ``bending_deg``, ``samples``, ``error_nm`` (largest over the three configuration variables).
    """
    segment = ConstantCurvature(Dimensions.LENGTH_M, Dimensions.RADIUS_M)
    generator = torch.Generator().manual_seed(seed)
    rows = []
    for degrees in (0.0, 1e-6, 1.0, 45.0, 90.0, 170.0):
        direction = 2 * math.pi * torch.rand(n, generator=generator, dtype=torch.float64)
        delta = Dimensions.RADIUS_M * math.radians(degrees)
        dL = 5.5e-3 * torch.rand(n, generator=generator, dtype=torch.float64)
        q = torch.stack([delta * direction.cos(), delta * direction.sin(), dL], dim=-1)
        back = segment.configuration(segment.pose(q, torch.ones(())))
        rows.append({"bending_deg": degrees, "samples": n, "error_nm": 1e9 * float((back - q).abs().max())})
    return pd.DataFrame(rows)


def planar_configuration(n_segments: int, bend_deg: float) -> Tensor:
    """Configuration in the x-z plane, neighbouring segments bent to opposite sides by ``bend_deg`` [m]."""
    delta = Dimensions.RADIUS_M * math.radians(bend_deg)
    signs = [(-1) ** i for i in range(n_segments)]
    return torch.tensor([x for s in signs for x in (s * delta, 0.0, 2.75e-3)], dtype=torch.float64)


def relations_along_lemniscate(n_segments: int, sensors_per_segment: int, sensor: int) -> pd.DataFrame:
    """Quantities of Fig. 2 for one sensor and the magnet of its own segment along the lemniscate T3.

    Columns: ``time_s``, ``d_mm``, ``alpha_deg``, ``beta_deg``, ``theta_deg``.

    Parameters
    ----------
    n_segments, sensors_per_segment
        The robot.
    sensor
        Index of the sensor, from 0.

    Raises
    ------
    InputError
        If the robot has no such sensor.
    """
    robot, q = pcc_robot(n_segments, sensors_per_segment), lemniscate(n_segments)
    require(0 <= sensor < len(robot.sensors), "sensor", "the robot", f"0 to {len(robot.sensors) - 1}", sensor)
    magnet = robot.sensors.segment[sensor]
    xi = relations(robot, q).angles()[:, sensor, 1:].unflatten(-1, (-1, 4))[:, magnet]
    table = pd.DataFrame({"time_s": torch.arange(len(q)).numpy() / RATE_HZ, "d_mm": MM * xi[:, 0].numpy()})
    for k, name in enumerate(("alpha_deg", "beta_deg", "theta_deg"), start=1):
        table[name] = xi[:, k].rad2deg().numpy()
    return table


def reading_ranges(n_segments: int, sensors_per_segment: int) -> pd.DataFrame:
    """Range of the readings on the lemniscate T3 for both rings, and how far the two field routes differ.

    Columns: ``ring``, ``segment`` (its sensors are pooled), ``range_mT``, ``route_difference_mT`` (magpylib
    against multipoles up to order 9, largest over time and sensors).
    """
    robot, q = pcc_robot(n_segments, sensors_per_segment), lemniscate(n_segments)
    rows = []
    for name in ("released", "published"):
        u = readings(robot, q, ring(name))
        difference = (u - readings(robot, q, ring(name), route="multipole")).abs()
        for i in range(n_segments):
            here = [j for j, s in enumerate(robot.sensors.segment) if s == i]
            pooled = u[:, here]
            rows.append(
                {
                    "ring": name,
                    "segment": i + 1,
                    "range_mT": float(pooled.max() - pooled.min()),
                    "route_difference_mT": float(difference[:, here].max()),
                }
            )
    return pd.DataFrame(rows)


def field_in_plane(robot: Robot, q: Tensor, ring_name: str, n_points: int = 121) -> pd.DataFrame:
    """Flux density in the x-z plane around a robot, as in Fig. 4(a): one row per grid point.

    Columns: ``x_mm``, ``z_mm``, ``b_x_mT``, ``b_z_mT``.
    """
    backbone = robot.backbone(q)
    low = backbone.amin(0) - 0.06
    high = backbone.amax(0) + 0.04
    n_z = n_points
    n_x = max(2, round(n_z * float((high[0] - low[0]) / (high[2] - low[2]))))
    z, x = torch.meshgrid(
        torch.linspace(float(low[2]), float(high[2]), n_z, dtype=torch.float64),
        torch.linspace(float(low[0]), float(high[0]), n_x, dtype=torch.float64),
        indexing="ij",
    )
    points = torch.stack([x, torch.zeros_like(x), z], dim=-1).flatten(0, 1)
    B = field_on_grid(robot, q, ring(ring_name), points.numpy())
    return pd.DataFrame(
        {"x_mm": MM * points[:, 0], "z_mm": MM * points[:, 2], "b_x_mT": B[:, 0], "b_z_mT": B[:, 2]}
    )


def mounted_parts(robot: Robot, q: Tensor, ring_name: str) -> pd.DataFrame:
    """Magnets and sensors of a robot: where they are, where they point, what the sensors read.

    Columns: ``part`` (``magnet`` or ``sensor``), ``segment``, ``x_mm``, ``y_mm``, ``z_mm``, ``axis_x``, ``axis_y``,
    ``axis_z``, ``reading_mT`` (sensors).
    """
    u = field_at_sensors(robot, q, ring(ring_name))[:, 2]
    frames = []
    for part, mounts in (("magnet", robot.magnets), ("sensor", robot.sensors)):
        T = robot.mount_poses(q, mounts)
        position, axis = MM * T[:, :3, 3], T[:, :3, 2]
        table = pd.DataFrame({"part": part, "segment": [i + 1 for i in mounts.segment]})
        for k, name in enumerate("xyz"):
            table[f"{name}_mm"] = position[:, k].numpy()
            table[f"axis_{name}"] = axis[:, k].numpy()
        table["reading_mT"] = u.numpy() if part == "sensor" else math.nan
        frames.append(table)
    return pd.concat(frames, ignore_index=True)


def field_on_grid(
    robot: Robot, q: Float[Tensor, " n_q"], magnet: Ring | Cube, points: Float[np.ndarray, "*grid 3"]
) -> Float[np.ndarray, "*grid 3"]:
    """Flux density [mT] of all magnets of a robot at points [m], both in the base frame, by magpylib."""
    total = np.zeros(points.shape)
    for T in robot.magnet_poses(q).detach().double().numpy():
        rotation, position = T[:3, :3], T[:3, 3]
        total += magnet.field((points - position) @ rotation) @ rotation.T
    return total
