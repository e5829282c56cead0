r"""The segment of the experiments of Baaij et al. 2023 (section 5.1): geometry and Earth field.

The text gives :math:`L_0 = 110`, :math:`d_m = 55` and :math:`d_{s,a} = 116` mm. The released recordings were
processed with the geometry of the released code, which is the one here: 106.05, 46.05 and 106.05 mm.
"""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import Tensor

from edition1.kinematics.constant_curvature import ConstantCurvature
from edition1.kinematics.mounts import magnet_mounts, ring_azimuths, sensor_mounts
from edition1.kinematics.robot import Robot

RIG_LENGTH_M = 106.05e-3
"""Unextended length :math:`L_0` [m]."""
RIG_RADIUS_M = 22e-3
"""Radius ``d`` [m]."""
RIG_MARKERS_M = 100.05e-3
"""Distance :math:`l_r` of the ring of markers from the base along the unextended backbone [m]."""
_RIG_MAGNET_M = 46.05e-3
"""Distance :math:`d_m` of the magnet from the base [m]."""
_RIG_SENSORS_M = 106.05e-3
"""Distance :math:`d_{s,a}` of the plane of the sensors from the base [m]."""
_RIG_SENSOR_RADIAL_M = 13e-3
"""Distance :math:`d_{s,r}` of the sensors from the backbone [m]."""
_RIG_EARTH_AXIS = (-0.311, -0.234, 0.921)
"""Direction of the Earth field in the base frame (section 5.2)."""
RIG_RATE_HZ = 40.0
"""Rate of the motion capture and of the readings (section 5.2)."""
RIG_SENSORS = 3
"""Number of sensors."""


def rig_segment() -> ConstantCurvature:
    """Return the segment, without magnet and sensors."""
    return ConstantCurvature(RIG_LENGTH_M, RIG_RADIUS_M)


def rig_robot() -> Robot:
    """Return the segment with its magnet and three sensors, as drawn.

    Examples
    --------
    >>> robot = rig_robot()
    >>> robot.coordinates, len(robot.magnets), len(robot.sensors)
    (('delta_x_1', 'delta_y_1', 'delta_L_1'), 1, 3)
    """
    return Robot(
        segments=(rig_segment(),),
        magnets=magnet_mounts([0], _RIG_MAGNET_M),
        sensors=sensor_mounts(
            [0] * RIG_SENSORS, _RIG_SENSORS_M, _RIG_SENSOR_RADIAL_M, ring_azimuths(RIG_SENSORS)
        ),
    )


def rig_earth_axis() -> Float[Tensor, " 3"]:
    """Direction of the Earth field in the base frame, as a tensor: an input of the relations."""
    return torch.tensor(_RIG_EARTH_AXIS, dtype=torch.float64)
