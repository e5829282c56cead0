r"""Calibration: a robot that is not as drawn, from readings in measured poses, with the tolerances as priors.

Parameters :math:`z` in units of their tolerances minimise

.. math:: \|z\|^2 + \sum_i r_i^T S_i^{-1} r_i, \qquad r_i = u_i - h(q_i, z), \qquad
          S_i = \sigma_u^2 I + J_i \Sigma_{q,i} J_i^T .

A pose is known only up to its measurement, so a residual is uncertain by the noise of the sensors and by the noise
of the pose, seen through :math:`J_i = \partial u/\partial q`. The posterior covariance of :math:`z` is the inverse of
the Hessian; directions in which it stays near one are what the poses do not determine.
"""

from __future__ import annotations

import math
from dataclasses import astuple, dataclass, replace
from typing import Any

import numpy as np

from repro.common import Array, numbers, require
from repro.robot import Robot, point_on
from repro.sensing import Sensing


@dataclass(frozen=True)
class Tolerances:
    """How far a robot may be from its drawing: standard deviations.

    Parameters
    ----------
    magnet_position, magnet_tilt
        Centre of a magnet along each axis of its mount [m], and its tilt about each transverse axis [rad].
    sensor_azimuth, sensor_radius, sensor_tilt, sensor_gain
        Azimuth [rad], relative distance from the backbone, tilt about the tangential direction [rad], relative gain.
    moments
        Every multipole moment, relative.

    Raises
    ------
    InputError
        If one of them is not positive.

    Examples
    --------
    >>> Tolerances(magnet_position=1e-3).magnet_tilt == math.radians(2.0)
    True
    """

    magnet_position: float = 0.5e-3
    magnet_tilt: float = math.radians(2.0)
    sensor_azimuth: float = 0.01 * 2 * math.pi
    sensor_radius: float = 0.01
    sensor_tilt: float = math.radians(1.0)
    sensor_gain: float = 0.01
    moments: float = 0.02

    def __post_init__(self) -> None:
        require(all(0 < x < math.inf for x in astuple(self)), "tolerances", "Tolerances", "positive", self)


@dataclass(frozen=True)
class Calibration:
    """A calibrated robot, and how well it is known.

    Parameters
    ----------
    robot
        With its parts where they were found.
    moments
        Of every magnet ``[m, terms]`` [mT m^(l+2)].
    gain
        Of every magnetic reading.
    names
        Names of the parameters.
    estimate, deviation
        Parameters [m, rad, relative], and their posterior standard deviations.
    covariance
        Posterior covariance in units of the tolerances: the identity before the first pose.
    chi2
        Squared residual per reading in units of its variance: near one if noise and tolerances are as stated.
    earth
        Field of the Earth in the base frame [mT].
    """

    robot: Robot
    moments: Array
    gain: Array
    names: tuple[str, ...]
    estimate: Array
    deviation: Array
    covariance: Array
    chi2: float
    earth: Array

    def sensing(self) -> Sensing:
        """Return the sensor model of the calibrated robot."""
        return Sensing(self.robot, moments=self.moments, gain=self.gain, earth=self.earth)


def calibrate(
    robot: Robot,
    q: Any,
    u: Any,
    noise: Any,
    q_covariance: Any = None,
    *,
    tolerances: Tolerances | None = None,
    moments: Any = None,
    earth: Any = None,
    iterations: int = 8,
) -> Calibration:
    """Find the places of magnets and sensors, gains and moments, by Gauss-Newton with Gaussian priors.

    Parameters
    ----------
    robot
        As drawn, with magnets and sensors. All its magnets have one shape and share what is found of their moments.
    q
        Measured configurations ``[poses, n_q]``.
    u
        Readings of its sensors ``[poses, s]`` [mT].
    noise
        Standard deviation of a reading, one number or one for each [mT].
    q_covariance
        Covariance of ``q`` ``[n_q, n_q]`` or ``[poses, n_q, n_q]``; exact poses if not given.
    tolerances
        Standard deviations of the priors.
    moments
        As drawn ``[terms]`` [mT m^(l+2)]; those of the magnets' shape if not given.
    earth
        Field of the Earth in the base frame [mT]; none if not given.
    iterations
        Largest number of iterations; six are enough as a rule.

    Raises
    ------
    InputError
        If readings, poses and robot do not fit or are not finite.

    Examples
    --------
    A magnet that is stronger by 2 % than it was drawn:

    >>> from repro import ConstantCurvature, Magnet, Ring, Robot, Sensor, simulated_readings
    >>> magnets = [Magnet(Ring(24e-3, 12e-3, 6e-3, 1450.0), segment=1, at=0.055)]
    >>> sensors = [Sensor(1, 0.11, radial=0.013, azimuth=k * 2 * np.pi / 3) for k in range(3)]
    >>> robot = Robot([ConstantCurvature(0.11, 0.022)], magnets, sensors)
    >>> q = 0.01 * np.random.default_rng(0).random((20, 3))
    >>> found = calibrate(robot, q, 1.02 * simulated_readings(robot, q), noise=1e-3)
    >>> (found.moments[0, 0] * found.gain / Sensing(robot).moments[0, 0]).round(2)
    array([1.02, 1.02, 1.02])
    """
    owner = "calibrate"
    require(robot.magnets and robot.sensors, "robot", owner, "one with magnets and sensors", "neither")
    shapes = {magnet.shape for magnet in robot.magnets}
    require(len(shapes) == 1, "robot", owner, "one whose magnets have one shape", f"{len(shapes)} shapes")
    robot = Robot(robot.segments, robot.magnets, robot.sensors)
    drawn = Sensing(robot, moments=moments, earth=earth)
    q = numbers(q, "q", owner, (None, robot.n_q))
    require(len(q), "q", owner, "at least one pose", "none")
    u = numbers(u, "u", owner, (len(q), drawn.n_readings))
    std = numbers(noise, "noise", owner)
    fits = std.shape in ((), (drawn.n_readings,)) and (std > 0).all()
    require(fits, "noise", owner, "positive, one number or one for each reading", noise)
    zero = np.zeros((robot.n_q, robot.n_q))
    sigma = zero if q_covariance is None else numbers(q_covariance, "q_covariance", owner, (..., *zero.shape))
    require(iterations >= 1, "iterations", owner, "at least 1", iterations)
    terms, scale = drawn.moments.shape[1], _scale(robot, drawn.moments.shape[1], tolerances or Tolerances())
    z, data = np.zeros(len(scale)), (q, u, np.broadcast_to(std, u.shape[1:]), sigma, scale)
    r, J = _whitened(drawn, z, *data)
    hessian = J.T @ J + np.eye(len(z))
    for _ in range(iterations):
        step = np.linalg.solve(hessian, J.T @ r - z)
        z = z + step
        r, J = _whitened(drawn, z, *data)
        hessian = J.T @ J + np.eye(len(z))
        if np.abs(step).max() < 1e-6:
            break
    covariance = np.linalg.inv(hessian)
    moved = _moved(drawn, z * scale)
    return Calibration(
        moved.robot,
        moved.moments,
        moved.tables.gain,
        _names(robot, terms),
        z * scale,
        np.sqrt(np.diag(covariance)) * scale,
        covariance,
        float(np.mean(r**2)),
        moved.tables.earth,
    )


def _names(robot: Robot, terms: int) -> tuple[str, ...]:
    magnet, sensor = ("x", "y", "z", "tilt about x", "tilt about y"), ("azimuth", "radius", "tilt", "gain")
    return (
        *(f"magnet {k + 1} {name}" for k in range(len(robot.magnets)) for name in magnet),
        *(f"sensor {j + 1} {name}" for j in range(len(robot.sensors)) for name in sensor),
        *(f"moment A{2 * k + 1}" for k in range(terms)),
    )


def _scale(robot: Robot, terms: int, tolerance: Tolerances) -> Array:
    t = tolerance
    magnet = [t.magnet_position] * 3 + [t.magnet_tilt] * 2
    sensor = [t.sensor_azimuth, t.sensor_radius, t.sensor_tilt, t.sensor_gain]
    return np.array(magnet * len(robot.magnets) + sensor * len(robot.sensors) + [t.moments] * terms)


def _split(sensing: Sensing, parameters: Array) -> tuple[Array, Array, Array]:
    n_m, n_s = len(sensing.robot.magnets), len(sensing.robot.sensors)
    magnet, rest = parameters[: 5 * n_m].reshape(n_m, 5), parameters[5 * n_m :]
    return magnet, rest[: 4 * n_s].reshape(n_s, 4), rest[4 * n_s :]


def _about(axis: int, angle: float) -> Array:
    c, s, R = math.cos(angle), math.sin(angle), np.eye(3)
    j, k = (axis + 1) % 3, (axis + 2) % 3
    R[j, j], R[j, k], R[k, j], R[k, k] = c, -s, s, c
    return R


def _moved(drawn: Sensing, parameters: Array) -> Sensing:
    """Sensor model of the robot whose parts are off their drawing by the parameters."""
    magnet, sensor, moment = _split(drawn, parameters)
    magnets, sensors = [], []
    for part, p in zip(drawn.robot.magnets, magnet, strict=True):
        at, R = part.place.position, part.place.rotation
        tilted = R @ _about(0, p[3]) @ _about(1, p[4])
        magnets.append(replace(part, position=at + R @ p[:3], direction=tilted[:, 2]))
    for part, p in zip(drawn.robot.sensors, sensor, strict=True):
        position = _about(2, p[0]) @ (part.place.position * [1 + p[1], 1 + p[1], 1.0])
        R = _about(2, p[0]) @ part.place.rotation @ _about(1, -p[2])
        turned: dict[str, Any] = {"direction": R[:, 2]}
        if part.axes == 3:
            from scipy.spatial.transform import Rotation

            turned = {"orientation": Rotation.from_matrix(R).as_quat()}
        sensors.append(replace(part, position=position, radial=0.0, azimuth=0.0, tilt=0.0, **turned))
    robot = Robot(drawn.robot.segments, magnets, sensors)
    gain = np.repeat(1 + sensor[:, 3], [part.axes for part in sensors])
    return Sensing(robot, moments=drawn.moments * (1 + moment), gain=gain, earth=drawn.tables.earth)


def _whitened(
    drawn: Sensing, z: Array, q: Array, u: Array, std: Array, q_covariance: Array, scale: Array
) -> tuple[Array, Array]:
    """Residuals ``[poses * s]`` of unit variance, and the slopes of the prediction by ``z``."""
    moved = _moved(drawn, z * scale)
    u_hat, J_q = moved.linearise(q)
    J = _slopes(drawn, moved, z * scale, q) * scale
    noise = np.diag(std**2) + J_q @ q_covariance @ np.swapaxes(J_q, -1, -2)
    rows = np.concatenate([(u - u_hat)[..., None], J], axis=-1)
    rows = np.linalg.solve(np.linalg.cholesky(noise), rows)
    rows = rows.reshape(-1, rows.shape[-1])
    return rows[:, 0], rows[:, 1:]


def _slopes(drawn: Sensing, moved: Sensing, parameters: Array, q: Array) -> Array:
    """Slopes of readings by the parameters ``[poses, s, k]``: the wrench of a pair times how the part moves."""
    magnet, sensor, _ = _split(drawn, parameters)
    robot, n_m, gain = drawn.robot, len(drawn.robot.magnets), moved.tables.gain
    u, wrench = moved.wrenches(q)
    J = np.zeros((*u.shape, len(parameters)))
    parts = (*robot.magnets, *robot.sensors)
    on_backbone = [point_on(part.place.segment, part.place.at) for part in parts]
    frames = robot.poses(q, on_backbone)
    for k, (part, p) in enumerate(zip(robot.magnets, magnet, strict=True)):
        R = frames[:, k, :3, :3] @ part.place.rotation
        centre = frames[:, k, :3, 3] + frames[:, k, :3, :3] @ moved.robot.magnets[k].place.position
        turns = np.stack([np.eye(3)[:, 0], _about(0, p[3])[:, 1]], axis=1)
        force = wrench[:, :, k, :3]
        torque = wrench[:, :, k, 3:] - np.cross(centre[:, None], force)
        J[:, :, 5 * k : 5 * k + 3] = -force @ R
        J[:, :, 5 * k + 3 : 5 * k + 5] = -torque @ (R @ turns)
    row = 0
    for j, (part, p) in enumerate(zip(robot.sensors, sensor, strict=True)):
        F, c = frames[:, n_m + j, :3, :3], 5 * n_m + 4 * j
        place = moved.robot.sensors[j].place
        at = frames[:, n_m + j, :3, 3] + F @ place.position
        rows = slice(row, row + part.axes)
        total = wrench[:, rows].sum(2)
        force, torque = total[..., :3], total[..., 3:] - np.cross(at[:, None], total[..., :3])
        around = np.cross([0.0, 0.0, 1.0], place.position)
        outwards = _about(2, p[0]) @ (part.place.position * [1.0, 1.0, 0.0])
        across = -(_about(2, p[0]) @ part.place.rotation)[:, 1]
        J[:, rows, c] = np.einsum("psi,pi->ps", force, F @ around) + np.einsum(
            "psi,pi->ps", torque, F[..., 2]
        )
        J[:, rows, c + 1] = np.einsum("psi,pi->ps", force, F @ outwards)
        J[:, rows, c + 2] = np.einsum("psi,pi->ps", torque, F @ across)
        J[:, rows, c + 3] = u[:, rows] / gain[rows]
        row += part.axes
    for k in range(drawn.moments.shape[1]):
        one = np.zeros_like(drawn.moments)
        one[:, k] = drawn.moments[:, k]
        J[:, :, len(parameters) - drawn.moments.shape[1] + k] = Sensing(moved.robot, moments=one)(q)
    return J * gain[:, None]
