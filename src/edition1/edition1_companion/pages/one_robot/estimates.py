"""The shape of the one robot by each of its sets of sensors, as drawn or calibrated in measured poses of its tip.

All take the segment for an arc, all start straight at mid elongation, and none is told the truth. Only the ring's
sensors see the elongation; for the others it stays at its middle.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float
from scipy.spatial.transform import Rotation
from torch import Tensor

from edition1.estimation.base import track
from edition1.estimation.calibration import calibrate
from edition1.estimation.imu_models import exact_arcs
from edition1.estimation.imu_selection import Selection
from edition1.estimation.levenberg_marquardt import LevenbergMarquardt
from edition1.estimation.particle_filter import ParticleFilter
from edition1.estimation.poses import configurations
from edition1.estimation.regions import Disc
from edition1.kernels import compiled
from edition1.kinematics.bend import MAX_BEND
from edition1.kinematics.paper_robots import Dimensions
from edition1.sensing.bend_sensor import BendSensor
from edition1.sensing.linearised import LinearisedSensing
from edition1_companion.twins.calibration_session import released_moments
from edition1_companion.twins.segment_imus import as_quaternions
from edition1_companion.twins.segment_motion import ROBOT
from edition1_companion.twins.segment_robot import (
    APART_M,
    HALL_NOISE_MT,
    MAGNET_NOISE_MT,
    MID_ELONGATION_M,
    PLACES_M,
    POSE_POSITION_M,
    POSE_ROTATION_RAD,
    Readings,
)
from edition1_companion.twins.training_set import ELONGATION_M

STRETCH = 1 + MID_ELONGATION_M / Dimensions.LENGTH_M
"""Length at mid elongation over the unextended length."""
_LENGTH_M = STRETCH * Dimensions.LENGTH_M
HALL_SENSOR = BendSensor(STRETCH * APART_M)
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
PAIR = Selection(imus=(0, 1), arcs=(0.0, _LENGTH_M), link_lengths=(_LENGTH_M,), sub_links=1)
STRAIGHT = torch.tensor([0.0, 0.0, MID_ELONGATION_M], dtype=torch.float64)


@dataclass(frozen=True)
class Models:
    r"""What the estimators know of the robots.

    Parameters
    ----------
    magnets
        Sensor model of the ring's sensors.
    hall_matrix, hall_offset
        The transverse field of a robot is :math:`A h(q) + b` of that of the drawing; b in mT.
    imu_world, imu_mounting
        Constant turns about the world and of the mounting: :math:`R = E \hat R M`.
    """

    magnets: LinearisedSensing
    hall_matrix: Float[Tensor, "*draws places 2 2"]
    hall_offset: Float[Tensor, "*draws places 2"]
    imu_world: Float[Tensor, "*draws imus 3 3"]
    imu_mounting: Float[Tensor, "*draws imus 3 3"]


def as_drawn() -> Models:
    """Models of the drawing."""
    eye, places = torch.eye(3, dtype=torch.float64), len(PLACES_M)
    return Models(
        LinearisedSensing(ROBOT, released_moments()),
        eye[:2, :2].expand(places, 2, 2),
        torch.zeros(places, 2, dtype=torch.float64),
        eye.expand(2, 3, 3),
        eye.expand(2, 3, 3),
    )


def calibrated(tips: Float[Tensor, "draws poses 4 4"], readings: Readings) -> Models:
    """Models of several robots from measured poses of the tip and what was read there.

    The ring's sensors: :func:`edition1.estimation.calibration.calibrate`. The Hall sensor: least squares, with the bend
    between it and the cube taken from the arc through the tip. The IMU at the tip: the two turns by which its
    readings agree best with the measured orientations; that at the base has not moved, and one turn is all there is.

    Parameters
    ----------
    tips
        Measured poses ``T_base_tip``.
    readings
        From :func:`edition1_companion.twins.segment_robot.calibration_session`, poses first.
    """
    q, covariance = configurations(
        ROBOT, tips.unsqueeze(-3), position_m=POSE_POSITION_M, rotation_rad=POSE_ROTATION_RAD
    )
    u = readings.magnets.transpose(0, 1)
    magnets = calibrate(ROBOT, q, covariance, u, released_moments(), noise_mt=MAGNET_NOISE_MT)
    field = HALL_SENSOR(q[..., :2] * (APART_M / Dimensions.LENGTH_M / Dimensions.RADIUS_M))[..., :2]
    columns = torch.cat([field, torch.ones_like(field[..., :1])], dim=-1).unsqueeze(1)  # [draws, 1, poses, 3]
    seen = readings.hall.movedim(0, 2)[..., :2]
    found = torch.linalg.lstsq(columns.expand(*seen.shape[:-1], 3), seen).solution
    read = _matrices(readings.imus).movedim(0, 2)  # [draws, imus, poses, 3, 3]
    mean = _nearest_rotation(read[:, 0].mean(1))
    world, mounting = two_turns(read[:, 1], tips[..., :3, :3])
    eye = torch.eye(3).to(mean).expand_as(mean)
    return Models(
        magnets.sensing(),
        found[..., :2, :].mT,
        found[..., 2, :],
        torch.stack([mean, world], dim=1),
        torch.stack([eye, mounting], dim=1),
    )


def _matrices(quaternions: Float[Tensor, "*batch 4"]) -> Float[Tensor, "*batch 3 3"]:
    """Rotation matrices of quaternions XYZW."""
    q = quaternions.numpy()
    return torch.from_numpy(Rotation.from_quat(q.reshape(-1, 4)).as_matrix().reshape(*q.shape[:-1], 3, 3))


def two_turns(
    read: Float[Tensor, "draws poses 3 3"], true: Float[Tensor, "draws poses 3 3"]
) -> tuple[Float[Tensor, "draws 3 3"], Float[Tensor, "draws 3 3"]]:
    """Turns E and M for which ``read`` is closest to ``E true M``: each by turns, with the other held.

    Parameters
    ----------
    read, true
        Rotation matrices of several poses that do not all share one axis.
    """
    M = torch.eye(3).to(read).expand(len(read), 3, 3)
    E = M
    for _ in range(20):
        E = _nearest_rotation((read @ (true @ M.unsqueeze(1)).mT).sum(1))
        M = _nearest_rotation(((E.unsqueeze(1) @ true).mT @ read).sum(1))
    return E, M


def _nearest_rotation(A: Tensor) -> Tensor:
    U, _, V = torch.linalg.svd(A)
    sign = torch.linalg.det(U @ V)
    return U @ torch.diag_embed(torch.stack([torch.ones_like(sign), torch.ones_like(sign), sign], -1)) @ V


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
    method, q0 = least_squares(models.magnets), STRAIGHT.expand_as(u)
    mask, known = None, None
    if failed is not None:
        mask = torch.arange(u.shape[-1]) != failed
        known = q0.new_tensor([torch.nan, torch.nan, MID_ELONGATION_M]).expand_as(q0)
    q = method.step(method.init(q0), u, 0.0, mask=mask, known=known)[1].q
    return arc(q, arcs_m)


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
        straight = arc(STRAIGHT.expand(*u.shape[:2], 3), arcs_m)
        return (straight,) * u.shape[2]
    offset = (u[..., :2] - models.hall_offset).unsqueeze(-1)
    transverse = torch.linalg.solve(models.hall_matrix, offset).squeeze(-1)
    # Where an array lies in memory may change the last bit of what linear algebra returns, and a last bit may change
    # which particle survives: far below the resolution of the sensor, but above that of the tables.
    seen = torch.round(torch.cat([transverse, u[..., 2:]], dim=-1) / ROUNDED_MT) * ROUNDED_MT
    mask = torch.tensor([True, True, False]).expand(len(u), 3)
    bend = track(particle_filter(), seen, seen.new_zeros(*seen.shape[1:-1], 2), seed=seed, mask=mask).q
    q = bend * (Dimensions.LENGTH_M / APART_M * Dimensions.RADIUS_M)
    q = torch.cat([q, torch.full_like(q[..., :1], MID_ELONGATION_M)], dim=-1)
    return tuple(arc(x, arcs_m) for x in q.unbind(2))


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
    R = models.imu_world.mT @ _matrices(quaternions) @ models.imu_mounting.mT
    base, tip = R.unbind(-3)
    if failed == 0:
        base = torch.eye(3).to(R).expand_as(base)
    elif failed == 1:
        tip = base
    ends = np.stack([as_quaternions(base), as_quaternions(tip)], axis=-2)
    points = exact_arcs(ends, PAIR, STRETCH * arcs_m.numpy())
    return Shape(torch.from_numpy(points), tip)


def least_squares(sensing: LinearisedSensing) -> LevenbergMarquardt:
    """Levenberg-Marquardt on the ring's sensors."""
    largest = Dimensions.RADIUS_M * LARGEST_BEND_RAD
    high = torch.tensor([largest, largest, ELONGATION_M["released"]], dtype=torch.float64)
    low = high * torch.tensor([-1.0, -1.0, 0.0], dtype=torch.float64)
    return LevenbergMarquardt(compiled(sensing), low, high, noise_mt=MAGNET_NOISE_MT, iterations=ITERATIONS)


def particle_filter() -> ParticleFilter:
    """The paper's filter on the Hall sensor."""
    noise = torch.full((2,), PROCESS_NOISE_RAD, dtype=torch.float64)
    region = Disc(LARGEST_BEND_RAD * APART_M / Dimensions.LENGTH_M)
    return ParticleFilter(compiled(HALL_SENSOR), noise, HALL_NOISE_MT, region, particles=PARTICLES)


def arc(q: Tensor, arcs_m: Tensor) -> Shape:
    """Shape of configurations."""
    T = ROBOT.segments[0].pose(q.unsqueeze(-2), torch.cat([arcs_m / Dimensions.LENGTH_M, arcs_m.new_ones(1)]))
    return Shape(T[..., :-1, :3, 3], T[..., -1, :3, :3])
