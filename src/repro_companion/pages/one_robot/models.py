"""What the estimators of the one robot know of it: its drawing, or a calibration in measured poses of the tip."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from jaxtyping import Float
from scipy.spatial.transform import Rotation
from torch import Tensor

from repro.estimation.calibration import calibrate
from repro.estimation.poses import configurations
from repro.kinematics.paper_robots import LENGTH_M, RADIUS_M
from repro.sensing.bend_sensor import BendSensor
from repro.sensing.linearised import LinearisedSensing
from repro_companion.twins.calibration_session import released_moments
from repro_companion.twins.segment_motion import ROBOT
from repro_companion.twins.segment_robot import (
    APART_M,
    MAGNET_NOISE_MT,
    MID_ELONGATION_M,
    PLACES_M,
    POSE_POSITION_M,
    POSE_ROTATION_RAD,
    Readings,
)

STRETCH = 1 + MID_ELONGATION_M / LENGTH_M
"""Length at mid elongation over the unextended length."""
HALL_SENSOR = BendSensor(STRETCH * APART_M)


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

    The ring's sensors: :func:`repro.estimation.calibration.calibrate`. The Hall sensor: least squares, with the bend
    between it and the cube taken from the arc through the tip. The IMU at the tip: the two turns by which its
    readings agree best with the measured orientations; that at the base has not moved, and one turn is all there is.

    Parameters
    ----------
    tips
        Measured poses ``T_base_tip``.
    readings
        From :func:`repro_companion.twins.segment_robot.calibration_session`, poses first.
    """
    q, covariance = configurations(
        ROBOT, tips.unsqueeze(-3), position_m=POSE_POSITION_M, rotation_rad=POSE_ROTATION_RAD
    )
    u = readings.magnets.transpose(0, 1)
    magnets = calibrate(ROBOT, q, covariance, u, released_moments(), noise_mt=MAGNET_NOISE_MT)
    field = HALL_SENSOR(q[..., :2] * (APART_M / LENGTH_M / RADIUS_M))[..., :2]
    columns = torch.cat([field, torch.ones_like(field[..., :1])], dim=-1).unsqueeze(1)  # [draws, 1, poses, 3]
    seen = readings.hall.movedim(0, 2)[..., :2]
    found = torch.linalg.lstsq(columns.expand(*seen.shape[:-1], 3), seen).solution
    read = matrices(readings.imus).movedim(0, 2)  # [draws, imus, poses, 3, 3]
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


def matrices(quaternions: Float[Tensor, "*batch 4"]) -> Float[Tensor, "*batch 3 3"]:
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
