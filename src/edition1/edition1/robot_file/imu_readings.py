"""IMUs of a described robot: their quaternions in the frame of the robot, alone or beside magnetic sensors.

Quaternions are XYZW and turn the frame of the IMU into a world whose z axis is the vertical. The file says how the
IMU sits on its cross-section and how the base stands in that world. Beside magnetic sensors an IMU is read as
directions that are fixed in the base, :mod:`edition1.sensing.seen_directions`: the three axes of the base if its heading
is absolute, the vertical alone if its heading is free.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float
from scipy.spatial.transform import Rotation
from torch import Tensor

from edition1 import se3
from edition1.estimation.orientations import UNIT_TOLERANCE, UPRIGHT
from edition1.kinematics.mounts import Mounts
from edition1.kinematics.robot import Robot
from edition1.sensing.seen_directions import SeenDirections
from edition1.sensing.stacked import StackedSensing


@dataclass(frozen=True)
class Imu:
    """An IMU on a robot.

    Parameters
    ----------
    stream
        Stream of its frames.
    segment
        Segment, from 0.
    at_m
        Distance from the base of that segment along the unextended backbone [m].
    arc_m
        Distance from the base of the robot [m].
    mounted
        Unit quaternion XYZW from the frame of the IMU to that of the cross-section.
    free_heading
        Whether its orientation about the vertical is arbitrary.
    """

    stream: int
    segment: int
    at_m: float
    arc_m: float
    mounted: tuple[float, ...] = tuple(UPRIGHT)
    free_heading: bool = False

    @property
    def components(self) -> int:
        """How many numbers it has in the model: nine, or three if its heading is free."""
        return 3 if self.free_heading else 9

    @property
    def freedoms(self) -> int:
        """How many of them are independent: three angles, or two if its heading is free."""
        return 2 if self.free_heading else 3

    def in_cross_section(self, values: Sequence[float], base_orientation: Sequence[float]) -> Sequence[float]:
        """Orientation of the cross-section in the base, from that of the IMU in the world; as given if they agree.

        Anything but a unit quaternion is returned as it is: the estimator refuses it.
        """
        as_they_are = list(self.mounted) == UPRIGHT and list(base_orientation) == UPRIGHT
        if as_they_are or not _is_unit(values):
            return values
        turned = Rotation.from_quat(values) * Rotation.from_quat(self.mounted).inv()
        return (Rotation.from_quat(base_orientation).inv() * turned).as_quat().tolist()

    def seen(
        self, values: Sequence[float] | None, base_orientation: Sequence[float]
    ) -> Float[Tensor, " components"]:
        """Directions fixed in the base as it sees them, from its quaternion; NaN without one, or if it is not unit.

        Examples
        --------
        >>> Imu(1, 0, 0.1, 0.1, free_heading=True).seen((0.0, 0.0, 1.0, 0.0), UPRIGHT)
        tensor([0., 0., 1.], dtype=torch.float64)
        """
        if values is None or not _is_unit(values):
            return torch.full((self.components,), math.nan, dtype=torch.float64)
        of_world = Rotation.from_quat(values).as_matrix().T  # columns: axes of the world as the IMU sees them
        if self.free_heading:
            return torch.from_numpy(of_world[:, 2].copy())
        return torch.from_numpy((of_world @ Rotation.from_quat(base_orientation).as_matrix()).T.flatten())


def sent(
    cross_sections: Float[np.ndarray, "*batch imus 3 3"],
    imus: Sequence[Imu],
    base_orientation: Sequence[float],
) -> Float[np.ndarray, "*batch imus 4"]:
    """Quaternions that IMUs without errors send, from the orientations of their cross-sections in the base.

    Examples
    --------
    >>> sent(np.eye(3)[None], [Imu(1, 0, 0.1, 0.1, mounted=(1.0, 0.0, 0.0, 0.0))], UPRIGHT) + 0.0
    array([[1., 0., 0., 0.]])
    """
    mounted = Rotation.from_quat([imu.mounted for imu in imus]).as_matrix()
    R = Rotation.from_quat(base_orientation).as_matrix() @ cross_sections @ mounted
    return Rotation.from_matrix(R.reshape(-1, 3, 3)).as_quat().reshape(*R.shape[:-2], 4)


def beside_imus(
    magnetic: Callable[[Tensor], Tensor],
    noise: float,
    robot: Robot,
    imus: Sequence[Imu],
    imu_noise: float,
    base_orientation: Sequence[float],
) -> StackedSensing:
    """Sensor model of magnetic sensors and IMUs together, each in units of its noise.

    Parameters
    ----------
    magnetic, noise
        Model of the magnetic sensors, and the standard deviation of their readings.
    robot, imus, imu_noise
        The robot, its IMUs, and the standard deviation of an orientation about each axis [rad].
    base_orientation
        How the base stands in the world of the IMUs, a unit quaternion XYZW.
    """
    sigma = [
        imu_noise * (1.0 if imu.free_heading else math.sqrt(2.0))
        for imu in imus
        for _ in range(imu.components)
    ]
    model = _directions(robot, imus, base_orientation)
    return StackedSensing((magnetic, model), (noise, torch.tensor(sigma, dtype=torch.float64)))


def _directions(robot: Robot, imus: Sequence[Imu], base_orientation: Sequence[float]) -> SeenDirections:
    """Sensor model of the IMUs: the axes of the base, or the vertical, as each sees them."""
    to_world = Rotation.from_quat(base_orientation).as_matrix()
    seen_by, rows = [], []
    for k, imu in enumerate(imus):
        seen = to_world[2:] if imu.free_heading else np.eye(3)
        seen_by += [k] * len(seen)
        rows.append(seen)
    return SeenDirections(robot, imu_mounts(imus), tuple(seen_by), torch.from_numpy(np.concatenate(rows)))


def imu_mounts(imus: Sequence[Imu]) -> Mounts:
    """Where IMUs sit, in frames of their own."""
    mounted = torch.from_numpy(Rotation.from_quat([imu.mounted for imu in imus]).as_matrix())
    at = torch.tensor([imu.at_m for imu in imus], dtype=torch.float64)
    return Mounts(tuple(imu.segment for imu in imus), at, se3.pose(mounted, mounted.new_zeros(3)))


def _is_unit(values: Sequence[float]) -> bool:
    return len(values) == len(UPRIGHT) and abs(math.hypot(*values) - 1) <= UNIT_TOLERANCE
