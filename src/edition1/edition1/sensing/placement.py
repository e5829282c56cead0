"""A robot whose magnets, sensors and moments are off by a little: its parameters, and readings with derivatives."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import astuple, dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from edition1 import se3
from edition1.errors import bad_input, require
from edition1.kinematics.motion import backbone_motion
from edition1.kinematics.mounts import Mounts
from edition1.kinematics.robot import Robot
from edition1.sensing._slopes import contract, pair_readings

_MAGNET = ("x", "y", "z", "tilt about x", "tilt about y")
"""Parameters of a magnet: offset of its centre [m] and tilts [rad], in the frame of its mount."""
_SENSOR = ("azimuth", "radius", "tilt", "gain")
"""Parameters of a sensor: rotation about the backbone [rad], relative change of the distance from it, rotation about
the tangential direction (positive inwards) [rad], relative change of the gain."""


@dataclass(frozen=True)
class Tolerances:
    """How far a robot may be from its drawing: standard deviations.

    Parameters
    ----------
    magnet_position_m
        Centre of a magnet along each axis of its mount [m].
    magnet_tilt_rad
        Tilt of a magnet about each of its transverse axes [rad].
    sensor_azimuth_rad
        Azimuth of a sensor [rad]; 1 % of a turn.
    sensor_radius
        Distance of a sensor from the backbone, relative.
    sensor_tilt_rad
        Tilt of a sensor about the tangential direction [rad].
    sensor_gain
        Gain of a sensor, relative.
    moments
        Every multipole moment, relative.

    Raises
    ------
    InputError
        If one of them is not positive.
    """

    magnet_position_m: float = 0.5e-3
    magnet_tilt_rad: float = math.radians(2.0)
    sensor_azimuth_rad: float = 0.01 * 2 * math.pi
    sensor_radius: float = 0.01
    sensor_tilt_rad: float = math.radians(1.0)
    sensor_gain: float = 0.01
    moments: float = 0.02

    def __post_init__(self) -> None:
        require(all(x > 0 for x in astuple(self)), "tolerances", "Tolerances", "positive", self)

    def of_parameters(self, robot: Robot, terms: int | torch.Size) -> Float[Tensor, " k"]:
        """Tolerance of every parameter of a robot, in the order of :func:`parameter_names`."""
        terms = terms if isinstance(terms, int) else terms.numel()
        magnet = [self.magnet_position_m] * 3 + [self.magnet_tilt_rad] * 2
        sensor = [self.sensor_azimuth_rad, self.sensor_radius, self.sensor_tilt_rad, self.sensor_gain]
        values = magnet * len(robot.magnets) + sensor * len(robot.sensors) + [self.moments] * terms
        return torch.tensor(values, dtype=torch.float64)


def parameter_names(robot: Robot, terms: int | torch.Size) -> tuple[str, ...]:
    """Names of the parameters: magnets, then sensors, in the order of their mounts and counted from 1, then moments.

    Parameters
    ----------
    robot
        With its magnets and sensors.
    terms
        Number of moments that the magnets share, or the shape of the moments: ``[terms]``, or ``[m, terms]`` where
        each magnet has its own.

    Examples
    --------
    >>> from edition1.kinematics.paper_robots import pcc_robot
    >>> parameter_names(pcc_robot(1, 1), terms=2)[3:]
    ('magnet 1 tilt about x', 'magnet 1 tilt about y', 'sensor 1 azimuth', 'sensor 1 radius', 'sensor 1 tilt', \
'sensor 1 gain', 'moment A1', 'moment A3')
    """
    magnets = [f"magnet {k + 1} {name}" for k in range(len(robot.magnets)) for name in _MAGNET]
    sensors = [f"sensor {j + 1} {name}" for j in range(len(robot.sensors)) for name in _SENSOR]
    *unlike, n = [terms] if isinstance(terms, int) else terms
    owners = [f"magnet {k + 1} " for k in range(unlike[0])] if unlike else [""]
    return (*magnets, *sensors, *(f"{owner}moment A{2 * k + 1}" for owner in owners for k in range(n)))


@dataclass(frozen=True)
class _Parts:
    """The parts of a robot after its parameters have been applied."""

    magnets: Mounts
    sensors: Mounts
    gain: Float[Tensor, "*batch s"]
    moments: Float[Tensor, "*moments terms"]


def placed(robot: Robot, moments: Float[Tensor, "*m terms"], parameters: Float[Tensor, "*batch k"]) -> _Parts:
    """Mounts, gains and moments of a robot that differs from its drawing by ``parameters``.

    Parameters
    ----------
    robot
        As drawn.
    moments
        As drawn [mT m^(l+2)], common to all magnets or a row for each.
    parameters
        In the order of :func:`parameter_names`; m, rad, relative.

    Raises
    ------
    InputError
        If the number of parameters does not fit.
    """
    magnet, sensor, moment = _split(robot, moments.shape, parameters)
    return _Parts(
        _with_local(robot.magnets, _moved_magnets(robot.magnets.local, magnet)),
        _with_local(robot.sensors, _moved_sensors(robot.sensors.local, sensor)),
        1 + sensor[..., 3],
        moments * (1 + moment),
    )


class PlacedReadings:
    """Readings in given poses as a function of the parameters, with all derivatives in closed form.

    Parameters
    ----------
    robot
        As drawn; one robot, not a batch.
    q
        Configurations of the poses; a batch belongs to a batch of parameters.
    moments
        As drawn [mT m^(l+2)], common to all magnets or a row for each.
    earth_mt
        Earth field in the base frame [mT]; none when not given.

    Raises
    ------
    InputError
        If ``robot`` is a batch.
    """

    def __init__(
        self,
        robot: Robot,
        q: Float[Tensor, "*batch poses n_q"],
        moments: Float[Tensor, "*m terms"],
        earth_mt: Float[Tensor, " 3"] | None = None,
    ) -> None:
        mounts = robot.magnets.joined(robot.sensors)
        if mounts.local.ndim != 3 or mounts.axial.ndim != 1:
            shape = f"mounts of shape {tuple(mounts.local.shape)}"
            raise bad_input("robot", "PlacedReadings", "one robot, not a batch", shape)
        self.robot, self.moments, self.earth_mt = robot, moments.to(q), earth_mt
        self._frames, self._motions = backbone_motion(robot, q, mounts)

    def linearise(
        self, parameters: Float[Tensor, "*batch k"]
    ) -> tuple[
        Float[Tensor, "*batch poses s"],
        Float[Tensor, "*batch poses s k"],
        Float[Tensor, "*batch poses s n_q"],
    ]:
        """Readings [mT] and their derivatives with respect to the parameters and to the configurations."""
        n_m, shared = len(self.robot.magnets), self.moments.ndim == 1
        magnet, sensor, moment = _split(
            self.robot, self.moments.shape, parameters.unsqueeze(-2)
        )  # the same in all poses
        local_m, by_magnet = _derivatives(_moved_magnets, self.robot.magnets.local, magnet)
        local_s, by_sensor = _derivatives(_moved_sensors, self.robot.sensors.local, sensor[..., :3])
        local = torch.cat([local_m, local_s], dim=-3)
        axis, position = (self._frames @ local)[..., :3, :].unbind(-1)
        offset = position[..., n_m:, None, :] - position[..., None, :n_m, :]
        o, m = axis[..., n_m:, :], axis[..., :n_m, :]
        moments = self.moments * (1 + moment)
        pairs = pair_readings((moments.unsqueeze(-2) if shared else moments).unsqueeze(-3), o, m, offset)
        by_moment = pairs.columns.sum(-2) * self.moments if shared else pairs.columns * self.moments
        by_o, by_m, by_p = pairs.by_sensor_axis.sum(-2), pairs.by_magnet_axis, pairs.by_offset
        u = pairs.u.sum(-1)
        if self.earth_mt is not None:
            u, by_o = u + o @ self.earth_mt.to(u), by_o + self.earth_mt.to(u)
        gain = 1 + sensor[..., 3]

        def to_world(frames: Tensor, columns: Tensor) -> tuple[Tensor, Tensor]:
            """Axis and position by parameter, ``[..., n, p, 3]``, from the columns in the frames of the mounts."""
            moved = (frames.unsqueeze(-3) @ columns)[..., :3, :]
            return moved[..., 0], moved[..., 1]

        d_axis, d_position = to_world(self._frames[..., :n_m, :, :], by_magnet)
        magnets = by_m.unsqueeze(-2) * d_axis.unsqueeze(-4) - by_p.unsqueeze(-2) * d_position.unsqueeze(-4)
        d_axis, d_position = to_world(self._frames[..., n_m:, :, :], by_sensor)
        by_offset = by_p.sum(-2)
        own = (d_axis @ by_o.unsqueeze(-1) + d_position @ by_offset.unsqueeze(-1)).squeeze(-1)
        own = torch.cat([own, (u / gain).unsqueeze(-1)], dim=-1)  # all rows are multiplied by the gain below
        sensors = torch.diag_embed(own.movedim(-1, -2)).movedim(-3, -1)  # [..., s, s, 4]
        J = torch.cat(
            [
                magnets.sum(-1).flatten(-2),
                sensors.flatten(-2),
                by_moment if shared else by_moment.flatten(-2),
            ],
            dim=-1,
        )
        motion = (self._motions.flatten(-3, -2) @ local).unflatten(-2, (-1, 4))
        d_axis, d_position = motion[..., :3, :].unbind(-1)
        J_q = (d_axis[..., n_m:, :, :] @ by_o.unsqueeze(-1)).squeeze(-1)
        J_q = J_q + (d_position[..., n_m:, :, :] @ by_offset.unsqueeze(-1)).squeeze(-1)
        J_q = J_q + contract(by_m, d_axis[..., :n_m, :, :]) - contract(by_p, d_position[..., :n_m, :, :])
        gain = gain.unsqueeze(-1)
        return gain.squeeze(-1) * u, gain * J, gain * J_q


def mount_slopes(
    robot: Robot, moments: Float[Tensor, "*m terms"], parameters: Float[Tensor, " k"]
) -> tuple[Float[Tensor, "m 5 2 3"], Float[Tensor, "s 3 2 3"]]:
    """Axis and position [m] of magnets and of sensors by the parameters that move them, in the backbone frame."""
    magnet, sensor, _ = _split(robot, moments.shape, parameters)
    _, by_magnet = _derivatives(_moved_magnets, robot.magnets.local, magnet)
    _, by_sensor = _derivatives(_moved_sensors, robot.sensors.local, sensor[..., :3])
    return by_magnet[..., :3, :].mT, by_sensor[..., :3, :].mT


def _split(robot: Robot, moments: torch.Size, parameters: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    n_m, n_s = len(robot.magnets), len(robot.sensors)
    sizes = [len(_MAGNET) * n_m, len(_SENSOR) * n_s, moments.numel()]
    if parameters.shape[-1] != sum(sizes):
        expected = f"of last dimension {sum(sizes)}"
        raise bad_input("parameters", "placed", expected, f"shape {tuple(parameters.shape)}")
    magnet, sensor, moment = parameters.split(sizes, dim=-1)
    magnet, sensor = magnet.unflatten(-1, (n_m, len(_MAGNET))), sensor.unflatten(-1, (n_s, len(_SENSOR)))
    return magnet, sensor, moment.unflatten(-1, moments)


def _with_local(mounts: Mounts, local: Tensor) -> Mounts:
    return Mounts(mounts.segment, mounts.axial.expand(local.shape[:-2]), local)


def _moved_magnets(local: Tensor, p: Tensor) -> Tensor:
    rotation = se3.rotation_x(p[..., 3]) @ se3.rotation_y(p[..., 4])
    return local.to(p) @ se3.pose(rotation, p[..., :3])


def _moved_sensors(local: Tensor, p: Tensor) -> Tensor:
    r"""Apply azimuth, radius and tilt: with :math:`R_x(\pi)` last, inwards is :math:`R_y(-\psi)` in the mount."""
    local = local.to(p)
    azimuth = se3.rotation_z(p[..., 0])
    stretch = torch.stack([1 + p[..., 1], 1 + p[..., 1], torch.ones_like(p[..., 1])], dim=-1)
    position = (azimuth @ (stretch * local[..., :3, 3]).unsqueeze(-1)).squeeze(-1)
    return se3.pose(azimuth @ local[..., :3, :3] @ se3.rotation_y(-p[..., 2]), position)


def _derivatives(move: Callable[[Tensor, Tensor], Tensor], local: Tensor, p: Tensor) -> tuple[Tensor, Tensor]:
    """Axis and position columns ``[..., n, 4, 2]`` of moved mounts and derivatives ``[..., n, p, 4, 2]``."""

    def along(direction: Tensor) -> tuple[Tensor, Tensor]:
        tangent = direction.expand_as(p)
        return torch.func.jvp(lambda x: move(local, x)[..., 2:], (p,), (tangent,))[:2]

    columns, by_p = torch.func.vmap(along)(torch.eye(p.shape[-1]).to(p))
    return columns[0], by_p.movedim(0, -3)
