"""Calibration by motion against calibration with measured poses, on robots that are not as described (synthetic).

Moments, gains and offsets of a robot are off by what ``repro calibrate --self`` believes, and in one of two cases the
place of its parts and the Earth field by their tolerances as well; both ways of calibration know which. The robot is
calibrated from a motion, or with poses that are known as well as ``repro calibrate`` assumes. Then another motion is
estimated from its Hall sensors by least squares. All fields come from magpylib, IMUs err as on the rest of the page.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import replace
from functools import partial

import numpy as np
import pandas as pd
import torch
from edition1.errors import InputError
from edition1.estimation.base import track
from edition1.estimation.levenberg_marquardt import LevenbergMarquardt, jacobian
from edition1.kernels import compiled
from edition1.kinematics.motion import tip_motion
from edition1.robot_file.calibration_file import RobotCalibration
from edition1.robot_file.imu_readings import Imu
from edition1.robot_file.load import load_robot
from edition1.robot_file.robot_file import RobotFile
from edition1.sensing.placement import Tolerances
from edition1_live.emulate.robot_readings import course, readings_along, true_robot
from edition1_live.own.motion import Beginning, at_elongation
from edition1_live.own.samples import TimedReadings, timed_readings
from edition1_live.own.self_calibration import PRIORS, SelfCalibration, self_calibrate
from edition1_live.robot.calibrate import Priors, calibrate, pose_covariance
from edition1_live.robot.readings_file import Readings
from edition1_live.wire.frame import Frame
from jaxtyping import Float
from scipy.spatial.transform import Rotation
from torch import Tensor

from edition1_companion.book.parallel import table_in_processes
from edition1_companion.book.project import find_project
from edition1_companion.pages.forty_five_minutes.twin import FAST_TILT, Sizes
from edition1_companion.twins.imu_errors import ornstein_uhlenbeck

RATE_HZ = 5.0
"""Of all motions: five minutes then have as many time steps as ``repro calibrate --self`` uses."""
TEST_S = 120.0
POSES, POSE_M, POSE_RAD = 100, 0.2e-3, float(np.radians(0.5))
"""How many poses, and how well they are known: what ``repro calibrate`` assumes."""
IMU_NOISE_RAD, HEADING_RAD = float(np.radians(0.2)), float(np.radians(10.0))
"""White noise of an IMU, and its heading at the start; assumed."""
DRIFT, PLACES = "drift", "drift and places"
SENSORS = ("magnets", "magnets and IMUs", "magnets, IMUs and length")
"""What motion teaches from; with the length, every segment stays as long as poses would know it to be."""
STRAIGHT = ("magnets, straight at first", "magnets and IMUs, straight at first")
"""The same motion, of which it is known that it begins straight, in the middle of the elongation."""
EXACT = Priors(
    Tolerances(1e-6, 1e-5, 1e-5, 1e-5, 1e-5, PRIORS.placement.sensor_gain, PRIORS.placement.moments),
    earth_mt=1e-5,
)
"""Of poses, where the place of the parts and the Earth field are known."""


def compared(
    draws: Sequence[int],
    robots: Sequence[str],
    off: Sequence[str],
    minutes: Sequence[float],
    straight: bool = False,
) -> pd.DataFrame:
    """Error of the tip on robots drawn at random, by the way they are calibrated.

    Columns ``robot, off, draw, calibration, minutes, tip_rmse_percent, stated_percent``: the root mean square over
    the motion of the test, in percent of the length, and what it should be by the covariance of the calibration and
    the noise, if the sensor model were linear and exact. What ``repro calibrate --self`` refuses has no row. With
    ``straight`` the rows are those of `STRAIGHT` alone.
    """
    return table_in_processes(
        [
            partial(one, robot, case, draw, minutes, straight)
            for robot in robots
            for case in off
            for draw in draws
        ]
    )


def one(name: str, off: str, draw: int, minutes: Sequence[float], straight: bool = False) -> pd.DataFrame:
    """Rows of one robot: not calibrated, by motion, with poses, and with its true parameters."""
    robot = described(name)
    truth = drawn(robot, off, draw)
    posed = _in_poses(robot, truth, off, draw)
    before = _as_described(robot, posed) if off == DRIFT else None
    rows = (
        []
        if straight
        else [("none", 0.0, robot), ("poses", 0.0, robot.calibrated(posed)), ("true", 0.0, truth)]
    )
    for sensors, time, found in by_motion(robot, truth, before, draw, minutes, straight):
        rows.append((sensors, time, robot.calibrated(found.calibration)))
    test = _test(robot, truth, draw)
    errors = [(name, off, draw, way, time, *tip_percent(found, *test)) for way, time, found in rows]
    columns = ["robot", "off", "draw", "calibration", "minutes", "tip_rmse_percent", "stated_percent"]
    return pd.DataFrame(errors, columns=columns)


def by_motion(
    robot: RobotFile,
    truth: RobotFile,
    before: RobotCalibration | None,
    draw: int,
    minutes: Sequence[float],
    straight: bool = False,
) -> Iterator[tuple[str, float, SelfCalibration]]:
    """What motions of so many minutes say to every set of sensors, but for what is refused."""
    sets, begins = equipments(robot), None
    if straight:
        C, rng = pose_covariance(robot, POSE_M, POSE_RAD), np.random.default_rng([25, draw, 4])
        off = torch.from_numpy(rng.standard_normal(robot.start.shape)) @ C.sqrt()
        begins = Beginning(robot.start + off, C)  # the motion begins at the start, which is not known better
        sets = {name: sets[sensors] for name, sensors in zip(STRAIGHT, SENSORS, strict=False)}
    for sensors, equipped in sets.items():
        for time in minutes:
            moving = in_motion(equipped, truth, 60 * time, draw)
            with suppress(InputError):  # as no motion of this robot
                yield sensors, time, self_calibrate(equipped, moving, earlier=before, begins=begins)


def becomes_known(draws: Sequence[int], robots: Sequence[str], minutes: Sequence[float]) -> pd.DataFrame:
    """How uncertain moments, gains and offsets are after a motion, over what they were before; places are known.

    Columns ``robot, draw, calibration, minutes, moment, gain, offset``: means over the parts.
    """
    rows = []
    for name in robots:
        robot = described(name)
        for draw in draws:
            truth = drawn(robot, DRIFT, draw)
            before = _as_described(robot, _in_poses(robot, truth, DRIFT, draw))
            for sensors, time, found in by_motion(robot, truth, before, draw, minutes):
                shares = pd.DataFrame(found.parameters, columns=["name", "value", "std", "prior"])
                mean = (shares["std"] / shares["prior"]).groupby(shares["name"].str.split().str[0]).mean()
                rows.append({"robot": name, "draw": draw, "calibration": sensors, "minutes": time, **mean})
    return pd.DataFrame(rows)[["robot", "draw", "calibration", "minutes", "moment", "gain", "offset"]]


def equipments(robot: RobotFile) -> dict[str, RobotFile]:
    """Robots by the sensors they have: an IMU at the tip of each segment or none, and one that cannot stretch."""
    length = [segment.length for segment in robot.robot.segments]
    imus = tuple(Imu(k + 1, k, at, sum(length[: k + 1])) for k, at in enumerate(length))
    leaning = replace(robot, imus=imus, imu_noise=IMU_NOISE_RAD)
    kept = at_elongation(leaning, float(robot.start[2]), POSE_M)  # that of all segments
    return dict(zip(SENSORS, (robot, leaning, kept), strict=True))


def drawn(robot: RobotFile, off: str, draw: int) -> RobotFile:
    """Draw a robot whose magnets, gains and offsets are off, and in one case the place of its parts."""
    rng, n, size = np.random.default_rng([25, draw, 0]), len(robot.gain), PRIORS.placement
    parts = true_robot(robot, float(off == PLACES), seed=draw)
    stronger = 1 + size.moments * rng.standard_normal()
    return replace(
        parts,
        gain=robot.gain * (1 + torch.from_numpy(size.sensor_gain * rng.standard_normal(n))),
        offset=robot.offset + robot.gain * torch.from_numpy(PRIORS.offset_mt * rng.standard_normal(n)),
        moments=stronger * _moments(robot),
        magnets=tuple(replace(x, polarisation_mt=stronger * x.polarisation_mt) for x in robot.magnets),
    )


def in_motion(robot: RobotFile, truth: RobotFile, seconds: float, draw: int) -> TimedReadings:
    """Readings of a robot that moves."""
    rng = np.random.default_rng([25, draw, 1])
    time_s = np.arange(round(seconds * RATE_HZ)) / RATE_HZ
    q = course(robot, time_s, seed=draw)
    found = readings_along(replace(truth, imus=robot.imus, imu_noise=robot.imu_noise), time_s, q, rng=rng)
    shape, size = (len(time_s), len(robot.imus)), Sizes()
    if robot.imus:
        turns = np.zeros((*shape, 3))
        for std, tau in (FAST_TILT, (size.tilt_rad, size.tilt_time_s)):
            turns[..., :2] += ornstein_uhlenbeck((*shape, 2), 1 / RATE_HZ, std=std, time_s=tau, rng=rng)
        heading = np.zeros((*shape, 3))
        heading[..., 2] = HEADING_RAD * rng.standard_normal(shape[1])
        lean, turn = (Rotation.from_rotvec(x.reshape(-1, 3)) for x in (turns, heading))
        sent = (turn * lean * Rotation.from_quat(found.orientations.reshape(-1, 4))).as_quat()
        found = replace(found, orientations=sent.reshape(*shape, 4))
    frames = [(round(1e9 * t), Frame(k, None, round(1e6 * t), values)) for t, k, values in found.readings()]
    return timed_readings(Readings(frames, 0.0, []), robot)


def tip_percent(
    robot: RobotFile, time_s: list[float], q: Float[Tensor, "t n_q"], values: Float[Tensor, "t channels"]
) -> tuple[float, float]:
    """Root mean square error of the tip of a robot as calibrated, and that which its calibration states.

    Both in percent of the length; the second is NaN for a robot whose parameters have no covariance.
    """
    method = LevenbergMarquardt(compiled(robot.sensing()), robot.lower, robot.upper, noise_mt=robot.noise)
    found = track(method, values[:, list(robot.channel)] - robot.offset, robot.start, times_s=time_s)
    off = (robot.tip(found.q) - robot.tip(q))[:, :3, 3]
    error = 100 / robot.robot.length * float(off.square().sum(-1).mean().sqrt())
    return error, np.nan if robot.error is None else stated_percent(robot, q, robot.error(q))


def stated_percent(robot: RobotFile, q: Float[Tensor, "t n_q"], error: Float[Tensor, "t s s"]) -> float:
    """Root mean square error of the tip in percent of the length, by noise and a covariance of readings' errors."""
    _, by_q = jacobian(robot.sensing(), q)
    to_tip = tip_motion(robot.robot, q)[1] @ torch.linalg.pinv(by_q)
    C = to_tip @ (error + robot.noise**2 * torch.eye(by_q.shape[-2]).double()) @ to_tip.mT
    return 100 / robot.robot.length * float(C.diagonal(dim1=-2, dim2=-1).sum(-1).mean().sqrt())


def described(name: str) -> RobotFile:
    """The robot of a file in ``data/robots``, read at `RATE_HZ`."""
    return replace(load_robot(find_project().data / "robots" / f"{name}.toml"), rate_hz=RATE_HZ)


def _test(robot: RobotFile, truth: RobotFile, draw: int) -> tuple[list[float], Tensor, Tensor]:
    """Times, true configurations and readings of a motion that no calibration has seen."""
    time_s = np.arange(round(TEST_S * RATE_HZ)) / RATE_HZ
    q = course(robot, time_s, seed=10_000 + draw)
    found = readings_along(truth, time_s, q, rng=np.random.default_rng([25, draw, 2]))
    return time_s.tolist(), torch.from_numpy(q), torch.from_numpy(found.values)


def _in_poses(robot: RobotFile, truth: RobotFile, off: str, draw: int) -> RobotCalibration:
    """Calibration with measured poses all over the bounds."""
    rng, covariance = np.random.default_rng([25, draw, 3]), pose_covariance(robot, POSE_M, POSE_RAD)
    share = torch.from_numpy(rng.random((POSES, len(robot.lower))))
    q = robot.lower + share * (robot.upper - robot.lower)
    values = torch.from_numpy(readings_along(truth, np.arange(1.0 * POSES), q.numpy(), rng=rng).values)
    measured = q + torch.from_numpy(rng.standard_normal(q.shape)) @ covariance.sqrt()
    return calibrate(robot, values, measured, covariance, priors=EXACT if off == DRIFT else PRIORS)


def _as_described(robot: RobotFile, like: RobotCalibration) -> RobotCalibration:
    """Calibration that knows: the robot is as described."""
    same = {"parameters": 0 * like.parameters, "offset": 0 * like.offset, "earth_mt": robot.earth_mt}
    return replace(like, **same, covariance=0 * like.covariance)


def _moments(robot: RobotFile) -> Tensor:
    assert robot.moments is not None
    return robot.moments
