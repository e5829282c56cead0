"""The simulations of Table 1 of Baaij et al. 2023: their robots, and the readings along the trajectory."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import torch
from torch import Tensor

from edition1.errors import bad_input
from edition1.kinematics.mounts import Mounts
from edition1.kinematics.paper_robots import Dimensions, pcc_robot
from edition1.kinematics.robot import Robot
from edition1.sensing.magnetic import EARTH_MT, readings
from edition1.sensing.magnets import ring
from edition1_companion.twins.trajectories import lemniscate


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
    radial_m: float = Dimensions.SENSOR_RADIAL_M
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


def groups(rows: Sequence[Row]) -> list[tuple[Row, ...]]:
    """Rows by the networks that they use, so that each group is one batch."""
    kinds: dict[tuple[int, bool], list[Row]] = {}
    for row in rows:
        kinds.setdefault((row.n_segments, row.earth_axis is not None), []).append(row)
    return [tuple(group) for group in kinds.values()]
