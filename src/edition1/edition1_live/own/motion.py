"""A robot in motion as the filter that calibrates itself sees it: readings of all its sensors, and what it finds."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
import torch
from jaxtyping import Float
from scipy.spatial.transform import Rotation
from torch import Tensor
from tqdm import tqdm

from edition1.errors import bad_input
from edition1.estimation.orientations import UNIT_TOLERANCE, UPRIGHT
from edition1.estimation.self_calibration import SelfCalibratingFilter
from edition1.estimation.wander import Wander
from edition1.robot_file.imu_readings import imu_mounts
from edition1.robot_file.robot_file import RobotFile
from edition1_live.follow.imu_streams import quaternion
from edition1_live.follow.robot_estimator import VELOCITY_SHARE
from edition1_live.own.samples import TimedReadings
from edition1_live.robot.calibrate import Priors
from edition1_live.robot.calibration_poses import STILL

OWN = ("moment", "gain", "offset")
"""Errors that are kept; those of IMUs are forgotten."""
_HEADING_RAD, _FREE_HEADING_RAD = math.radians(10.0), 0.5
"""Heading of an IMU before the first reading, and of one that says itself that it is free; assumed."""
_HEADING_WALK = math.radians(10.0) / 60.0
"""It wanders by ten degrees in an hour [rad/s^0.5]: log of a BNO055, as on the page on 45 minutes."""
_TILTS = ((math.radians(1.0), 3.0), (math.radians(0.2), 1200.0))
"""Error of an IMU's vertical [rad], and time within which it fades [s], in motion and lasting; assumed, as there."""
_ACCELERATION_SHARE = 5.0
"""Widths of the bounds, as white noise [1/s^1.5]: next to nothing is believed of the motion. With the 0.2 of
estimators of the shape, gains and offsets take up what of a quicker motion it calls unlikely: on six synthetic robots
that are judged nowhere, with IMUs the tip then erred two to four times as much, and without IMUs offsets were off by
fifteen of the standard deviations that were stated."""
_WIDER = 4.0
"""Bounds of the filter, in those of the robot. A coordinate that is less sure than its bounds would be pulled to
their middle at each step, as if the motion had that mean, and the moments with it."""
_MOST_STEPS = 1500
"""Time steps that are used, evenly over the recording: of more a calibration learns little, and takes long."""
_LEAST_S = 5.0


def motion(
    robot: RobotFile, offset: Float[Tensor, " s"], readings: TimedReadings
) -> tuple[list[float], Float[Tensor, "steps readings"]]:
    """Times, and readings as the filter takes them: Hall sensors [mT], rotation vectors of IMUs [rad]."""
    seconds = readings.time_s[-1] - readings.time_s[0]
    if seconds < _LEAST_S:
        expected = f"of at least {_LEAST_S:g} s in which every segment bends every way"
        raise bad_input("readings", "repro calibrate --self", expected, f"{seconds:.3g} s")
    to_base = Rotation.from_quat(robot.base_orientation).inv()
    if robot.imus and abs(abs(to_base.as_matrix()[2, 2]) - 1) > 1e-6:
        expected = "upright, or upside down: to IMUs the vertical is the axis of the base"
        raise bad_input("base_orientation", robot.name, expected, robot.base_orientation)
    every = math.ceil(len(readings.steps) / _MOST_STEPS)
    chosen = readings.steps[::every]
    hall = (torch.from_numpy(readings.signal[::every]) - offset) / robot.gain
    turns = np.full((len(chosen), len(robot.imus), 3), np.nan)
    for k, imu in enumerate(robot.imus):
        missing = (math.nan,) * len(UPRIGHT)
        sent = np.array([quaternion(robot, step.frames[1 + k]) or missing for step in chosen])
        whole = np.abs(np.linalg.norm(sent, axis=1) - 1) < UNIT_TOLERANCE
        if not whole.any():
            raise bad_input(f"readings of IMU {imu.stream}", robot.name, "unit quaternions", "none")
        R = to_base * Rotation.from_quat(sent[whole])
        if imu.free_heading:  # as if it were right at first, when the robot hardly turns about the vertical
            first = (R[0] * Rotation.from_quat(imu.mounted).inv()).as_quat()
            R = Rotation.from_rotvec([0.0, 0.0, -2 * math.atan2(first[2], first[3])]) * R
        turns[whole, k] = R.as_rotvec()
    u = torch.cat([hall, torch.from_numpy(turns).flatten(1)], dim=1)
    if not torch.isfinite(u).any():
        raise bad_input("readings", "repro calibrate --self", "numbers in some time step", "none")
    _check_moves(robot, readings.signal)
    return [step.time_s - chosen[0].time_s for step in chosen], u


def _check_moves(robot: RobotFile, signal: Float[np.ndarray, "steps s"]) -> None:
    """Refuse readings of a robot that is as still as a pose has to be."""
    columns = [column[np.isfinite(column)] for column in signal.T]
    most = max((float((column - column[0]).std()) for column in columns if len(column)), default=0.0)
    if most > STILL * robot.noise:
        return
    expected = (
        f"of a robot in motion, by which some reading scatters over more than {STILL:g} times its noise: bend every "
        "segment every way while they are recorded (if it did move, look at power and wires of the sensors, and "
        f"whether the noise in {robot.name} is that of a sensor at rest)"
    )
    received = f"readings that scatter over {most:.2g} {robot.unit}, with a noise of {robot.noise:.2g}"
    raise bad_input("readings", "repro calibrate --self", expected, received)


@dataclass(frozen=True)
class Beginning:
    """Configuration of a robot at its first reading, and the covariance to which it is known."""

    q: Float[Tensor, " n_q"]
    covariance: Float[Tensor, "n_q n_q"]

    @classmethod
    def straight(
        cls, robot: RobotFile, elongation_m: float, covariance: Float[Tensor, "n_q n_q"]
    ) -> Beginning:
        """Without bend, every segment at an elongation [m]; nothing is known of the azimuth of no bend."""
        q, names = torch.zeros_like(robot.start), robot.robot.coordinates
        q[[name.startswith("delta_L") for name in names]] = elongation_m
        azimuth = torch.tensor([name.startswith("phi") for name in names])
        q[azimuth] = robot.start[azimuth]
        if not ((robot.lower <= q) & (q <= robot.upper)).all():
            expected = f"no bend and an elongation within the bounds in {robot.name}"
            raise bad_input("straight", "repro calibrate --self", expected, f"{1e3 * elongation_m:g} mm")
        anywhere = (robot.upper - robot.lower).square() / 12
        return cls(q, torch.where(torch.diag(azimuth), torch.diag(anywhere), covariance))


def at_elongation(robot: RobotFile, elongation_m: float, within_m: float) -> RobotFile:
    """The robot with segments that bend but keep an elongation [m], which is known to within a length [m]."""
    kept = torch.tensor([name.startswith("delta_L") for name in robot.robot.coordinates])
    low, high = (1e3 * bound[kept] for bound in (robot.lower, robot.upper))
    elongation_mm = 1e3 * elongation_m
    if not (kept.any() and (low <= elongation_mm).all() and (elongation_mm <= high).all()):
        expected = f"within the bounds of delta_L_mm in {robot.name}"
        raise bad_input("elongation", "repro calibrate --self", expected, f"{elongation_mm:g} mm")
    lower, upper = (
        torch.where(kept, elongation_m + x, bound)
        for x, bound in ((-within_m, robot.lower), (within_m, robot.upper))
    )
    return replace(robot, lower=lower, upper=upper)


def filter_of(robot: RobotFile, priors: Priors, noise_mt: float) -> SelfCalibratingFilter:
    """Filter of a robot with such priors of its moments, gains and offsets, and such noise of its Hall sensors."""
    width, middle = robot.upper - robot.lower, (robot.upper + robot.lower) / 2
    assert robot.moments is not None
    shared = robot.moments.ndim == 1 and len(robot.robot.magnets) > 1
    free = any(imu.free_heading for imu in robot.imus)
    wanders = (
        Wander("moment", priors.placement.moments, shared=shared),
        Wander("gain", priors.placement.sensor_gain),
        Wander("offset", priors.offset_mt),
        Wander("heading", _FREE_HEADING_RAD if free else _HEADING_RAD, _HEADING_WALK),
        *(Wander.fading("tilt", *tilt) for tilt in _TILTS),
    )
    return SelfCalibratingFilter(
        robot=robot.robot,
        lower=middle - _WIDER / 2 * width,
        upper=middle + _WIDER / 2 * width,
        acceleration=_ACCELERATION_SHARE * width,
        velocity=VELOCITY_SHARE * width,
        wanders=wanders,
        moments=robot.moments,
        imus=imu_mounts(robot.imus) if robot.imus else None,
        earth_mt=robot.earth_mt,
        noise_mt=noise_mt,
        imu_noise_rad=robot.imu_noise or 1e-3,
    )


def filtered(
    method: SelfCalibratingFilter,
    times: list[float],
    u: Tensor,
    bar: tqdm,
    *,
    start: Tensor | None = None,
    begins: Beginning | None = None,
) -> tuple[Tensor, Tensor, float]:
    """Moments, gains and offsets at the end, their covariance, and chi-square per reading.

    With a ``start`` the filter linearises there, and what it believes is moved back to a prior around zero.
    """
    n, k = method.robot.n_q, sum(name.startswith(OWN) for name in method.errors.names)
    state, chi2, dof = method.init((method.lower + method.upper) / 2), 0.0, 0
    if begins is not None:
        covariance = state.covariance.clone()
        covariance[:n, :n] = begins.covariance
        state = replace(state, q=torch.cat([begins.q, state.q[n:]]), covariance=covariance)
    if start is not None:
        state = replace(state, q=torch.cat([state.q[:n], start, state.q[n + k :]]))
    for t, row in zip(times, u, strict=True):
        if torch.isfinite(row).any():
            state, estimate = method.step(state, row, t)
            chi2, dof = chi2 + float(estimate.diagnostics["chi2"]), dof + int(estimate.diagnostics["dof"])
        bar.update()
    theta, F = state.q[n : n + k], state.covariance[n : n + k, n : n + k]
    if start is not None:
        theta = theta - F @ (start / torch.from_numpy(method.errors.start[:k]) ** 2)
    return theta, F, chi2 / dof
