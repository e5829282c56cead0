"""The shape of the one robot by each of its three sets of sensors, as drawn or calibrated.

All take the segment for an arc, all start straight at mid elongation, and none is told the truth. Only the ring's
sensors see the elongation; for the others it stays at its middle.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from time import process_time

import numpy as np
import torch
from jaxtyping import Float
from scipy.spatial.transform import Rotation
from torch import Tensor

from repro.estimation.base import track
from repro.estimation.imu_models import exact_arcs
from repro.estimation.imu_selection import Selection
from repro.estimation.levenberg_marquardt import LevenbergMarquardt
from repro.estimation.particle_filter import ParticleFilter
from repro.estimation.regions import Disc
from repro.kernels import compiled
from repro.kinematics.bend import MAX_BEND
from repro.kinematics.paper_robots import LENGTH_M, RADIUS_M
from repro.sensing.linearised import LinearisedSensing
from repro.sensing.training_set import ELONGATION_M
from repro_companion.pages.one_robot.models import HALL_SENSOR, STRETCH, Models, as_drawn, matrices
from repro_companion.twins.segment_motion import ROBOT
from repro_companion.twins.segment_robot import (
    APART_M,
    HALL_NOISE_MT,
    MAGNET_NOISE_MT,
    MID_ELONGATION_M,
    Readings,
)

METHODS = ("ring and 3 sensors", "cube and Hall sensor, base", "cube and Hall sensor, middle", "2 IMUs")
ITERATIONS = 12
"""Of Levenberg-Marquardt at every time step, each from the straight pose."""
LARGEST_BEND_RAD = MAX_BEND
"""Bound of the bend of the segment for all magnetic estimates: 90 degrees, more than any tip turns."""
PROCESS_NOISE_RAD = 0.002 * torch.pi
"""Of the particle filter, for every component of the bend vector (Mitchell et al. 2021, section II-C: the value
for experiments)."""
PARTICLES = 1000
ROUNDED_MT = 1e-6
PAIR = Selection(imus=(0, 1), arcs=(0.0, STRETCH * LENGTH_M), link_lengths=(STRETCH * LENGTH_M,), sub_links=1)


@dataclass(frozen=True)
class Shape:
    """Estimated backbone and tip.

    Parameters
    ----------
    points
        Positions [m] at the arc lengths asked for.
    tip
        Orientation of the tip, body to base.
    """

    points: Float[Tensor, "*batch k 3"]
    tip: Float[Tensor, "*batch 3 3"]


def by_magnets(
    models: Models,
    u: Float[Tensor, "t draws s"],
    arcs_m: Float[Tensor, " k"],
    *,
    failed: int | None = None,
) -> Shape:
    """Shape by Levenberg-Marquardt on the ring's sensors, every time step for itself.

    With a failed sensor two readings are left for three coordinates: the elongation is held at its middle.

    Parameters
    ----------
    models
        Of the robots.
    u
        Readings [mT].
    arcs_m
        Where the backbone is wanted: distances along the unextended one [m].
    failed
        Number of a sensor that is left out, from 0.
    """
    method, q0 = _least_squares(models.magnets), _straight_and(MID_ELONGATION_M).expand_as(u)
    mask, known = None, None
    if failed is not None:
        mask = torch.arange(u.shape[-1]) != failed
        known = q0.new_tensor([torch.nan, torch.nan, MID_ELONGATION_M]).expand_as(q0)
    q = method.step(method.init(q0), u, 0.0, mask=mask, known=known)[1].q
    return _arc(q, arcs_m)


def by_hall(
    models: Models,
    u: Float[Tensor, "t draws places 3"],
    arcs_m: Float[Tensor, " k"],
    *,
    failed: int | None = None,
    seed: int = 0,
) -> tuple[Shape, ...]:
    """Shape by the particle filter on the Hall sensor, one for each of its places.

    The filter finds the bend between sensor and cube. The segment has more of it in the ratio of the lengths: the
    rest of its shape is extrapolated, not measured. Like the released code on recorded data, it leaves the component
    along the body out, which here would take an elongation for a bend.

    Parameters
    ----------
    models, u, arcs_m
        As for :func:`by_magnets`; the readings have three components.
    failed
        0 if the sensor has failed: then the estimate stays straight.
    seed
        Of the particles.
    """
    if failed is not None:
        straight = _arc(_straight_and(MID_ELONGATION_M).expand(*u.shape[:2], 3), arcs_m)
        return (straight,) * u.shape[2]
    offset = (u[..., :2] - models.hall_offset).unsqueeze(-1)
    transverse = torch.linalg.solve(models.hall_matrix, offset).squeeze(-1)
    # Where an array lies in memory may change the last bit of what linear algebra returns, and a last bit may change
    # which particle survives: far below the resolution of the sensor, but above that of the tables.
    seen = torch.round(torch.cat([transverse, u[..., 2:]], dim=-1) / ROUNDED_MT) * ROUNDED_MT
    mask = torch.tensor([True, True, False]).expand(len(u), 3)
    bend = track(_particle_filter(), seen, seen.new_zeros(*seen.shape[1:-1], 2), seed=seed, mask=mask).q
    q = bend * (LENGTH_M / APART_M * RADIUS_M)
    q = torch.cat([q, torch.full_like(q[..., :1], MID_ELONGATION_M)], dim=-1)
    return tuple(_arc(x, arcs_m) for x in q.unbind(2))


def by_imus(
    models: Models,
    quaternions: Float[Tensor, "t draws imus 4"],
    arcs_m: Float[Tensor, " k"],
    *,
    failed: int | None = None,
) -> Shape:
    """Shape as the arc between the orientations of the two ends.

    Without the IMU at the base the drawing says how the base is clamped; without that at the tip nothing is known of
    the bend, and the segment is straight along the base.

    Parameters
    ----------
    models, arcs_m
        As for :func:`by_magnets`.
    quaternions
        XYZW, body to world.
    failed
        0 if the IMU at the base has failed, 1 if that at the tip.
    """
    R = models.imu_world.mT @ matrices(quaternions) @ models.imu_mounting.mT
    base, tip = R.unbind(-3)
    if failed == 0:
        base = torch.eye(3).to(R).expand_as(base)
    elif failed == 1:
        tip = base
    ends = np.stack([_quaternions(base), _quaternions(tip)], axis=-2)
    points = exact_arcs(ends, PAIR, STRETCH * arcs_m.numpy())
    return Shape(torch.from_numpy(points), tip)


def cpu_times(readings: Readings, arcs_m: Float[Tensor, " k"], *, repeats: int = 200) -> dict[str, float]:
    """Processor time of one estimate of one robot [s], by method: the median of repeated single steps.

    Parameters
    ----------
    readings
        Of any robots; the first step of the first is used.
    arcs_m
        Where the backbone is wanted.
    repeats
        How often.
    """
    models = as_drawn()
    squares, cloud = _least_squares(models.magnets), _particle_filter()
    start, q0 = squares.init(_straight_and(MID_ELONGATION_M)), torch.zeros(2, dtype=torch.float64)
    particles, mask = cloud.init(q0), torch.tensor([True, True, False])
    u, hall, imus = readings.magnets[0, 0], readings.hall[0, 0, 0], readings.imus[:1, :1]

    def magnets() -> None:
        _arc(squares.step(start, u, 0.0)[1].q, arcs_m)

    def bend() -> None:
        q = cloud.step(particles, hall, 0.0, mask=mask)[1].q
        _arc(torch.cat([q, q[:1]]), arcs_m)

    calls = (magnets, bend, bend, partial(by_imus, models, imus, arcs_m))
    return {name: _median_time(call, repeats) for name, call in zip(METHODS, calls, strict=True)}


def _median_time(call: Callable[[], object], repeats: int) -> float:
    call()  # the first call compiles
    times = []
    for _ in range(repeats):
        start = process_time()
        call()
        times.append(process_time() - start)
    return float(np.median(times))


def _least_squares(sensing: LinearisedSensing) -> LevenbergMarquardt:
    largest = RADIUS_M * LARGEST_BEND_RAD
    high = torch.tensor([largest, largest, ELONGATION_M["released"]], dtype=torch.float64)
    low = high * torch.tensor([-1.0, -1.0, 0.0], dtype=torch.float64)
    return LevenbergMarquardt(compiled(sensing), low, high, noise_mt=MAGNET_NOISE_MT, iterations=ITERATIONS)


def _particle_filter() -> ParticleFilter:
    noise = torch.full((2,), PROCESS_NOISE_RAD, dtype=torch.float64)
    region = Disc(LARGEST_BEND_RAD * APART_M / LENGTH_M)
    return ParticleFilter(compiled(HALL_SENSOR), noise, HALL_NOISE_MT, region, particles=PARTICLES)


def _straight_and(elongation_m: float) -> Tensor:
    return torch.tensor([0.0, 0.0, elongation_m], dtype=torch.float64)


def _arc(q: Tensor, arcs_m: Tensor) -> Shape:
    T = ROBOT.segments[0].pose(q.unsqueeze(-2), torch.cat([arcs_m / LENGTH_M, arcs_m.new_ones(1)]))
    return Shape(T[..., :-1, :3, 3], T[..., -1, :3, :3])


def _quaternions(R: Tensor) -> np.ndarray:
    return Rotation.from_matrix(R.reshape(-1, 3, 3).numpy()).as_quat().reshape(*R.shape[:-2], 4)
