"""The robots that the papers simulate."""

from __future__ import annotations

from typing import ClassVar

import torch
from torch import Tensor

from edition1.errors import bad_input
from edition1.kinematics.affine_curvature import AffineCurvature
from edition1.kinematics.constant_curvature import ConstantCurvature
from edition1.kinematics.mounts import magnet_mounts, ring_azimuths, sensor_mounts
from edition1.kinematics.robot import Robot

_AFFINE_LENGTH_M = 0.200
_AFFINE_PLANES_M = (0.0, 0.100, 0.200)
_AFFINE_MAGNETS_M = (0.050, 0.150)


class Dimensions:
    """Sizes of the segments that bend in arcs, section 3.1, and the shift of the affine robot's magnets [m]."""

    LENGTH_M = 0.110
    RADIUS_M = 0.022
    MAGNET_AXIAL_M = 0.055
    SENSOR_RADIAL_M = 0.013
    MAGNET_SHIFT_M: ClassVar[dict[str, float]] = {"released": -0.003, "published": 0.0}
    """Shift of the magnets of the affine robot along their own axes: in the released training data, and in print.

    The networks of the released code know nothing of it: their relations are those of the robot as printed.
    """


def pcc_robot(
    n_segments: int = 1,
    sensors_per_segment: int = 3,
    *,
    tilt: Tensor | float = 0.0,
    radial: Tensor | float = Dimensions.SENSOR_RADIAL_M,
    azimuth_offset: Tensor | float = 0.0,
) -> Robot:
    """Robot of Baaij et al. 2023, section 3.1: a ring in the middle and sensors in the tip plane of each segment.

    Parameters
    ----------
    n_segments
        Number of segments ``n_b``.
    sensors_per_segment
        Sensors in each tip plane, spaced evenly.
    tilt
        Tilt ``psi_s`` [rad], positive inwards; a batch of robots has a leading dimension.
    radial
        Distance ``d_s,r`` [m] of the sensors from the backbone.
    azimuth_offset
        Azimuth ``phi_off`` [rad] of the first sensor of each segment.

    Raises
    ------
    InputError
        If there is no segment or no sensor.

    Examples
    --------
    >>> robot = pcc_robot(n_segments=3)
    >>> robot.n_q, len(robot.magnets), len(robot.sensors)
    (9, 3, 9)
    """
    if n_segments < 1 or sensors_per_segment < 1:
        counts = (n_segments, sensors_per_segment)
        raise bad_input("n_segments, sensors_per_segment", "pcc_robot", "at least 1", counts)
    segment_of_sensor = [i for i in range(n_segments) for _ in range(sensors_per_segment)]
    azimuth = ring_azimuths(sensors_per_segment, azimuth_offset)
    azimuth = azimuth.repeat(*(1,) * (azimuth.ndim - 1), n_segments)
    per_robot = [x.unsqueeze(-1) if isinstance(x, Tensor) and x.ndim else x for x in (radial, tilt)]
    return Robot(
        segments=(ConstantCurvature(Dimensions.LENGTH_M, Dimensions.RADIUS_M),) * n_segments,
        magnets=magnet_mounts(range(n_segments), Dimensions.MAGNET_AXIAL_M),
        sensors=sensor_mounts(segment_of_sensor, Dimensions.LENGTH_M, per_robot[0], azimuth, per_robot[1]),
    )


def affine_robot(
    *, magnet_shift_m: float = Dimensions.MAGNET_SHIFT_M["released"], azimuth_offset: Tensor | float = 0.0
) -> Robot:
    """Robot of Baaij et al. 2023, section 4.1: one affine segment, two rings, nine sensors in three planes.

    Each plane, at 0, 100 and 200 mm, holds three sensors 120 degrees apart; the planes are turned against each
    other by 40 degrees. As in the released code sensor ``j`` is in plane ``j mod 3`` at the azimuth 40 j degrees.

    Parameters
    ----------
    magnet_shift_m
        Rigid shift [m] of both magnets along their own axes, towards the tip, from the cross-sections at 50 and
        150 mm: see :attr:`Dimensions.MAGNET_SHIFT_M`.
    azimuth_offset
        Azimuth ``phi_off`` [rad] of the first sensor; a batch of robots has a leading dimension.

    Examples
    --------
    >>> robot = affine_robot()
    >>> robot.coordinates, len(robot.magnets), len(robot.sensors)
    (('kappa_0_1', 'kappa_1_1', 'phi_1', 'delta_L_1'), 2, 9)
    """
    n = 9
    azimuth = ring_azimuths(n, azimuth_offset)
    axial = torch.tensor(_AFFINE_PLANES_M * (n // len(_AFFINE_PLANES_M)), dtype=torch.float64)
    return Robot(
        segments=(AffineCurvature(_AFFINE_LENGTH_M),),
        magnets=magnet_mounts([0] * len(_AFFINE_MAGNETS_M), _AFFINE_MAGNETS_M, shift=magnet_shift_m),
        sensors=sensor_mounts([0] * n, axial, Dimensions.SENSOR_RADIAL_M, azimuth),
    )
