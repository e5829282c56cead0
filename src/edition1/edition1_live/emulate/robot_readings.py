"""Readings of a described robot that moves: synthetic, never by the series of fields that estimators use.

A robot file says how a robot is drawn. :func:`true_robot` draws one that was built from it, :func:`course` moves it,
and :func:`readings_along` says what its sensors read.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
import torch
from jaxtyping import Float
from scipy.spatial.transform import Rotation
from torch import Tensor

from edition1.errors import bad_input, require
from edition1.kinematics.mounts import magnet_mounts
from edition1.robot_file.columns import MAGNETIC_STREAM
from edition1.robot_file.imu_readings import sent
from edition1.robot_file.robot_file import RobotFile
from edition1.sensing.magnetic import readings as field_readings
from edition1.sensing.placement import placed
from edition1_live.emulate.board import Reading
from edition1_live.robot.calibrate import Priors

SPEED = 0.5
"""Largest speed of every coordinate, in widths of its bounds per second."""
REACH = 0.9
"""How far from the middle of its bounds a coordinate goes, as a share of the way to them."""
_EASE_S = 0.5
"""Time constant with which the motion begins [s]."""


@dataclass(frozen=True)
class RobotReadings:
    """What the sensors of a robot read along a motion, and the truth beside it.

    Attributes
    ----------
    robot
        The robot that was read: not as described, but as built.
    time_s
        Time of each round of readings since the board was switched on [s].
    q
        True configuration of each.
    values
        Values of the frames of the magnetic sensors in the unit of the file, in the order of the channels; unused
        channels are zero. No columns without magnetic sensors.
    orientations
        Quaternions XYZW of the IMUs, sensor to base, from base to tip; NaN where an IMU sends nothing.
    """

    robot: RobotFile
    time_s: Float[np.ndarray, " rounds"]
    q: Float[np.ndarray, "rounds n_q"]
    values: Float[np.ndarray, "rounds channels"]
    orientations: Float[np.ndarray, "rounds imus 4"]

    def readings(self) -> Iterator[Reading]:
        """Yield them as a board sends them: of every round one frame of all channels, then one of every IMU."""
        streams = [imu.stream for imu in self.robot.imus]
        rows = zip(self.time_s.tolist(), self.values.tolist(), self.orientations.tolist(), strict=True)
        for time_s, values, orientations in rows:
            if values:
                yield Reading(time_s, MAGNETIC_STREAM, tuple(values))
            for stream, quaternion in zip(streams, orientations, strict=True):
                if not math.isnan(quaternion[0]):
                    yield Reading(time_s, stream, tuple(quaternion))


def course(robot: RobotFile, time_s: Float[np.ndarray, " n"], *, seed: int = 0) -> Float[np.ndarray, "n n_q"]:
    r"""Configurations of a smooth motion within the bounds; synthetic.

    Every coordinate is the sum of two sines of its own, with frequencies, shares and directions drawn from the seed.
    The motion begins at rest where estimators start (:attr:`~edition1.robot_file.robot_file.RobotFile.start`, or as near
    to it as the motion goes): its own time is :math:`t - \tau (1 - e^{-t/\tau})`, so position, speed and acceleration
    are continuous.

    Parameters
    ----------
    robot
        As described.
    time_s
        Times since the beginning [s].
    seed
        The same seed gives the same motion at whatever times.
    """
    rng = np.random.default_rng(seed)
    low, high, start = (x.numpy() for x in (robot.lower, robot.upper, robot.start))
    middle, half = (low + high) / 2, (high - low) / 2
    major = REACH * rng.uniform(0.6, 0.8, len(low))
    share = np.stack([major, REACH - major])  # of half the width
    ratio = np.stack([rng.uniform(0.7, 1.0, len(low)), rng.uniform(1.5, 2.2, len(low))])
    frequency = (
        2 * SPEED * ratio / (share * ratio).sum(axis=0)
    )  # [rad/s]: the speeds of both add to the limit
    sign = rng.choice([-1.0, 1.0], len(low))
    phase = np.arcsin(np.clip(sign * (start - middle) / (REACH * half), -1, 1))
    own_s = time_s + _EASE_S * np.expm1(-time_s / _EASE_S)
    sines = share * np.sin(own_s[:, None, None] * frequency + phase)
    return middle + half * sign * sines.sum(axis=1)


def true_robot(robot: RobotFile, tolerances: float, *, seed: int = 0) -> RobotFile:
    """Return a robot that was built from a file, not quite as it says.

    Places and tilts of the magnets, places, tilts, gains and offsets of the sensors, the polarisation of the magnets
    (one factor for all: it is that of the material) and the Earth field differ by normal random numbers. Their
    standard deviations are ``tolerances`` times those that :class:`~edition1_live.robot.calibrate.Priors` assumes. IMUs
    stay as described.

    Parameters
    ----------
    robot
        As described, not calibrated.
    tolerances
        0: as described; 1: as the priors say.
    seed
        The same seed draws the same robot, and with other tolerances one that is off in the same directions.

    Raises
    ------
    InputError
        If the tolerances are negative, or the robot has networks: they say what the sensors read, not where they are.
    """
    require(0 <= tolerances < math.inf, "tolerances", "true_robot", "0 or more", tolerances)
    if tolerances == 0 or robot.moments is None:
        return robot
    if robot.networks:
        expected = f"0 for {robot.name}: its networks say what the sensors read"
        raise bad_input("tolerances", "true_robot", expected, tolerances)
    rng, priors = np.random.default_rng([seed, 1]), Priors()
    n = len(robot.robot.sensors)
    deviation = priors.placement.of_parameters(robot.robot, robot.moments.shape)
    parameters = tolerances * deviation * torch.from_numpy(rng.standard_normal(len(deviation)))
    of_moments = parameters[-robot.moments.numel() :].view(robot.moments.shape)
    of_moments[:] = of_moments[..., :1].clone()  # one factor for all terms of a magnet
    strengths = (1 + of_moments[..., 0]).expand(len(robot.magnets)).tolist()
    offset_mt = tolerances * priors.offset_mt * torch.from_numpy(rng.standard_normal(n))
    earth_mt = tolerances * priors.earth_mt * torch.from_numpy(rng.standard_normal(3))
    parts = placed(robot.robot, robot.moments, parameters)
    return replace(
        robot,
        robot=replace(robot.robot, magnets=parts.magnets, sensors=parts.sensors),
        gain=robot.gain * parts.gain,
        offset=robot.offset + robot.gain * offset_mt,
        moments=parts.moments,
        magnets=tuple(
            replace(magnet, polarisation_mt=strength * magnet.polarisation_mt)
            for magnet, strength in zip(robot.magnets, strengths, strict=True)
        ),
        earth_mt=robot.earth_mt + earth_mt,
    )


def readings_along(
    robot: RobotFile,
    time_s: Float[np.ndarray, " rounds"],
    q: Float[np.ndarray, "rounds n_q"],
    *,
    rng: np.random.Generator | None = None,
) -> RobotReadings:
    """Return what the sensors of a robot read in given configurations.

    Magnetic sensors read the field of the magnets by magpylib, times their gains, plus their offsets; those of a
    robot with networks what the networks say. IMUs read the orientation of the backbone where they sit.

    Parameters
    ----------
    robot
        As built: from :func:`true_robot`, or a description as it is.
    time_s, q
        Times [s] and configurations.
    rng
        Of white noise: as stated in the file, and 0.2 degrees about each axis of an IMU. No noise without it.
    """
    configurations = torch.from_numpy(np.ascontiguousarray(q))
    values = np.zeros((len(q), robot.channels if robot.channel else 0))
    if robot.channel:
        u = _magnetic(robot, configurations).numpy()
        if rng is not None:
            u = u + robot.noise * rng.standard_normal(u.shape)
        values[:, list(robot.channel)] = u
    orientations = np.zeros((len(q), len(robot.imus), 4))
    if robot.imus:
        mounts = magnet_mounts([imu.segment for imu in robot.imus], [imu.at_m for imu in robot.imus])
        T = robot.robot.mount_poses(configurations, mounts)
        quaternions = sent(T[..., :3, :3].numpy(), robot.imus, robot.base_orientation)
        turn = Rotation.from_quat(quaternions.reshape(-1, 4))
        if rng is not None:
            turn = turn * Rotation.from_rotvec(robot.imu_noise * rng.standard_normal((len(turn), 3)))
        orientations = turn.as_quat().reshape(orientations.shape)
    return RobotReadings(robot, time_s, q, values, orientations)


def _magnetic(robot: RobotFile, q: Tensor) -> Tensor:
    if robot.networks:
        return robot.sensing()(q).detach() + robot.offset
    return robot.gain * field_readings(robot.robot, q, robot.magnets, earth_mt=robot.earth_mt) + robot.offset
