"""Faults of sensors: what a broken one reads instead of what it should; pure functions, seeded."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
import torch
from magpylib.func import dipole_field
from scipy.spatial.transform import Rotation

from edition1.errors import bad_input, require
from edition1.robot_file.robot_file import RobotFile
from edition1_live.emulate.faults import NUMBERED
from edition1_live.emulate.robot_readings import RobotReadings, course, readings_along

_GAIN_CHANGE = 0.05
"""By how much a gain is off, relative."""
_MOMENT_AM2 = 1.0
"""Moment of a foreign magnet [A m^2]: a neodymium cube of 1 cm."""
_SURVEY_S = np.linspace(0.0, 60.0, 257)


@dataclass(frozen=True)
class SensorFaults:
    """What is wrong with the sensors of a robot; by default nothing.

    Parameters
    ----------
    unplug
        Number of a sensor, from 1, whose value in the frame is 0: an open input that is tied to ground, so 0 in the
        unit of the frame and not the offset. An unplugged IMU sends nothing.
    stick
        Number of a sensor that repeats its last value.
    saturate
        Number of a sensor that is clipped, on both sides of its offset, at a size that its signal exceeds half of the
        time (:func:`saturation_level`).
    gain
        Number of a sensor whose gain is 5 % too large; the offset stays.
    nan
        Number of a sensor that gives NaN.
    magnet
        Distance of a foreign magnet from the robot [mm]: a dipole of 1 A m^2 that points along z of the base, beside
        the middle of the straight robot, in the direction of x.
    noise
        The noise is this many times that of the file.

    Raises
    ------
    InputError
        If a number is out of range.
    """

    unplug: int = 0
    stick: int = 0
    saturate: int = 0
    gain: int = 0
    nan: int = 0
    magnet: float = 0.0
    noise: float = 1.0

    def __post_init__(self) -> None:
        for name in NUMBERED:
            if getattr(self, name) < 0:
                raise bad_input(name, "SensorFaults", "the number of a sensor, from 1", getattr(self, name))
        if not 0 <= self.magnet < math.inf:
            raise bad_input("magnet", "SensorFaults", "its distance from the robot [mm]", self.magnet)
        if not 1 <= self.noise < math.inf:
            raise bad_input("noise", "SensorFaults", "1 or more, times that of the file", self.noise)

    def check(self, robot: RobotFile) -> None:
        """Refuse what a robot cannot have.

        Raises
        ------
        InputError
            If it has no such sensor, or its sensors cannot fail like that.
        """
        magnetic = bool(robot.channel)
        n = len(robot.channel) if magnetic else len(robot.imus)
        for name in NUMBERED:
            number = getattr(self, name)
            require(number <= n, name, robot.name, f"the number of a sensor, 1 to {n}", number)
            if number and not magnetic and name not in ("unplug", "stick"):
                raise bad_input("fault", robot.name, "unplug, stick or noise for IMUs", name)
        if self.magnet and (not magnetic or robot.networks):
            kind = "networks, which know no field" if robot.networks else "IMUs"
            raise bad_input("fault", robot.name, f"another one for a robot with {kind}", "magnet")


def with_sensor_faults(
    part: RobotReadings,
    faults: SensorFaults,
    *,
    from_s: float = 0.0,
    before: RobotReadings | None = None,
    seed: int = 0,
) -> RobotReadings:
    """Return readings as a robot with broken sensors gives them; what was read before ``from_s`` stays as it was.

    Parameters
    ----------
    part
        Without faults.
    faults
        What is wrong.
    from_s
        Since when, by the times of the readings [s].
    before
        The part before this one, with its faults: where a stuck sensor has its last value from. Without it a sensor
        that is stuck from the beginning repeats the first value.
    seed
        Of the additional noise.

    Raises
    ------
    InputError
        If the robot cannot have these faults.

    Examples
    --------
    >>> from edition1.robot_file.load import load_robot
    >>> robot, time_s = load_robot("data/robots/two_segments.toml"), np.arange(200) / 100
    >>> made = readings_along(robot, time_s, course(robot, time_s), rng=np.random.default_rng([0, 2, 0]))
    >>> broken = with_sensor_faults(made, SensorFaults(unplug=3), from_s=1.0)
    >>> broken.values[99:101, 2].round(1) + 0.0
    array([-3.3,  0. ])
    """
    faults.check(part.robot)
    since = int(np.searchsorted(part.time_s, from_s - 1e-9))
    if since == len(part.time_s) or faults == SensorFaults():
        return part
    rng = np.random.default_rng([seed, 3, round(1e6 * float(part.time_s[0]))])
    signals = _signals(part)
    late, number = signals[since:], faults.stick - 1
    # what reaches all sensors first, then each sensor, then what is left of it on the way
    (_disturb_magnetic if part.robot.channel else _turn_imus)(part, faults, late, rng)
    if faults.stick:
        earlier = signals[since - 1] if since else late[0] if before is None else _signals(before)[-1]
        late[:, number] = earlier[number]
    if faults.unplug:
        late[:, faults.unplug - 1] = 0.0 if part.robot.channel else math.nan
    if faults.nan:
        late[:, faults.nan - 1] = math.nan
    if not part.robot.channel:
        return replace(part, orientations=signals)
    values = part.values.copy()
    values[:, list(part.robot.channel)] = signals
    return replace(part, values=values)


def _signals(part: RobotReadings) -> np.ndarray:
    """Readings of the magnetic sensors ``[rounds, sensors]``, or orientations of the IMUs ``[rounds, imus, 4]``."""
    channel = list(part.robot.channel)
    return part.values[:, channel] if channel else part.orientations.copy()


def _disturb_magnetic(
    part: RobotReadings, faults: SensorFaults, late: np.ndarray, rng: np.random.Generator
) -> None:
    robot = part.robot
    if faults.magnet:
        q = part.q[len(part.q) - len(late) :]
        late += robot.gain.numpy() * _foreign_field(robot, q, 1e-3 * faults.magnet)
    if faults.noise > 1:
        late += robot.noise * math.sqrt(faults.noise**2 - 1) * rng.standard_normal(late.shape)
    if k := faults.gain:
        offset = float(robot.offset[k - 1])
        late[:, k - 1] = offset + (1 + _GAIN_CHANGE) * (late[:, k - 1] - offset)
    if k := faults.saturate:
        offset, level = float(robot.offset[k - 1]), saturation_level(robot, k)
        late[:, k - 1] = late[:, k - 1].clip(offset - level, offset + level)


def _turn_imus(part: RobotReadings, faults: SensorFaults, late: np.ndarray, rng: np.random.Generator) -> None:
    if faults.noise > 1:
        more = part.robot.imu_noise * math.sqrt(faults.noise**2 - 1)
        turn = Rotation.from_rotvec(more * rng.standard_normal((late[..., 0].size, 3)))
        late[:] = (Rotation.from_quat(late.reshape(-1, 4)) * turn).as_quat().reshape(late.shape)


def saturation_level(robot: RobotFile, number: int) -> float:
    """Where sensor ``number``, from 1, is clipped: the median size of its signal in a motion of a minute [unit]."""
    surveyed = readings_along(robot, _SURVEY_S, course(robot, _SURVEY_S)).values
    signal = surveyed[:, robot.channel[number - 1]] - float(robot.offset[number - 1])
    return float(np.median(np.abs(signal)))


def _foreign_field(robot: RobotFile, q: np.ndarray, distance_m: float) -> np.ndarray:
    """Flux density of the foreign magnet along the axes of the sensors ``[rounds, s]`` [mT], by magpylib."""
    poses = robot.robot.sensor_poses(torch.from_numpy(np.ascontiguousarray(q))).numpy()
    observers = poses[..., :3, 3].reshape(-1, 3) - np.array([distance_m, 0.0, robot.robot.length / 2])
    flux = np.asarray(dipole_field("B", observers, np.array([0.0, 0.0, _MOMENT_AM2]), squeeze=False))
    return 1e3 * (flux.reshape(*poses.shape[:2], 3) * poses[..., :3, 2]).sum(-1)
