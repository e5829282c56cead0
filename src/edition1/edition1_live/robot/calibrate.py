r"""Calibration of a described robot: what its parts, gains, offsets and base really are, from measured poses.

As :mod:`edition1.estimation.calibration`, with parameters that only add to a reading: the offset of every sensor and the
Earth field in the base frame, which also says how the base is turned in it. All are found together by Gauss-Newton
with Gaussian priors, :math:`\|z\|^2 + \sum_i r_i^T S_i^{-1} r_i` in units of the priors, so that the posterior
covariance tells what the poses do not determine.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import torch
from jaxtyping import Float
from torch import Tensor

from edition1 import se3
from edition1.errors import bad_input, require
from edition1.estimation.undetermined import undetermined
from edition1.kinematics.robot import Robot
from edition1.robot_file.calibration_file import RobotCalibration
from edition1.robot_file.robot_file import RobotFile
from edition1.sensing.moments import check_readings
from edition1.sensing.placement import PlacedReadings, Tolerances, parameter_names, placed

_ITERATIONS = 12
_HOLD_OUT_EVERY = 4
"""Of the poses every fourth is held out, if there are at least eight."""
DOUBTFUL_CHI2 = 4.0
MOST_CHI2 = 16.0
"""Residuals twice, and four times, as large as stated: doubtful, and refused. In simulation, poses that are as good
as stated give 0.3 to 1.2, three times worse ones 9 at most; exchanged axes, another unit, order or sign give 26 and
more, as a rule above 1000."""
_CAUSES = (
    "axes exchanged or of the wrong sign, another unit than the column says (m or cm for mm), poses in another order "
    "than the readings, a robot file of another robot, or poses known less well than stated (--pose-noise-mm, "
    "--pose-noise-deg)"
)


@dataclass(frozen=True)
class Priors:
    """How far a robot may be from its file: standard deviations.

    Parameters
    ----------
    placement
        Of geometry, gains and moments.
    offset_mt
        Of the reading without field of every sensor [mT].
    earth_mt
        Of every component of the Earth field [mT].

    Raises
    ------
    InputError
        If one of them is not positive.
    """

    placement: Tolerances = field(default_factory=lambda: Tolerances(sensor_gain=0.05))
    offset_mt: float = 0.5
    earth_mt: float = 0.05

    def __post_init__(self) -> None:
        if not (self.offset_mt > 0 and self.earth_mt > 0):
            raise bad_input("priors", "Priors", "positive", (self.offset_mt, self.earth_mt))


def calibrate(
    robot: RobotFile,
    values: Float[Tensor, "poses channels"],
    q: Float[Tensor, "poses n_q"],
    q_covariance: Float[Tensor, "*c k k"],
    *,
    priors: Priors | None = None,
) -> RobotCalibration:
    """Fit a robot to readings in measured poses.

    The residuals before and after are those of poses that the fit has not seen; the calibration itself is fitted to
    all poses. Poses of the tips instead of configurations: :func:`edition1.estimation.poses.configurations` turns
    them into ``q`` and ``q_covariance``.

    Parameters
    ----------
    robot
        As described, without a calibration.
    values
        Values of a frame, averaged over each pose [unit of the file].
    q
        Measured configurations.
    q_covariance
        Covariance of ``q``, of every pose or common to all.
    priors
        How far the robot may be from its file.

    Raises
    ------
    InputError
        If poses and readings do not fit the robot, are not finite, or the robot has no magnets.
    """
    priors = priors or Priors()
    robot.sensing()  # refuses robots without magnetic sensors
    if robot.networks:
        raise bad_input(
            "robot",
            "calibrate",
            "one whose sensors read the field of magnets",
            f"{len(robot.networks)} networks",
        )
    if values.ndim != 2 or values.shape[-1] != robot.channels:
        expected = f"of {robot.channels} channels, as described in {robot.name}"
        raise bad_input("values", "calibrate", expected, f"shape {tuple(values.shape)}")
    u = (values[:, list(robot.channel)] - robot.offset) / robot.gain
    check_readings("calibrate", robot.robot, q, u)
    require(len(q), "q", "calibrate", "at least one pose", "none")
    if q_covariance.shape[-2:] != (robot.robot.n_q, robot.robot.n_q):
        expected = f"of last dimensions ({robot.robot.n_q}, {robot.robot.n_q})"
        raise bad_input("q_covariance", "calibrate", expected, f"shape {tuple(q_covariance.shape)}")
    se3.require_finite(q_covariance, "q_covariance", "calibrate")
    covariance = q_covariance.to(q).expand(len(q), *q_covariance.shape[-2:])
    out = torch.arange(len(q)) % _HOLD_OUT_EVERY == _HOLD_OUT_EVERY - 1
    before = after = None
    if len(q) >= 2 * _HOLD_OUT_EVERY:
        problem = _Problem(robot, u[~out], q[~out], covariance[~out], priors)
        before = _rms(robot, q[out], values[out], None)
        after = _rms(robot, q[out], values[out], problem.calibration(problem.solve()))
    problem = _Problem(robot, u, q, covariance, priors)
    found = problem.calibration(problem.solve())
    held_out = 0 if before is None else int(out.sum())
    return replace(found, held_out=held_out, before=before, after=after)


def pose_covariance(robot: RobotFile, length_m: float, angle_rad: float) -> Float[Tensor, "n_q n_q"]:
    """Covariance of poses whose coordinates are known to a length [m], or to an angle [rad].

    Raises
    ------
    InputError
        If one of them is not positive.
    """
    if not (length_m > 0 and angle_rad > 0):
        raise bad_input("pose noise", "calibrate", "positive", f"{length_m} m and {angle_rad} rad")
    deviation = [length_m if name.startswith("delta") else angle_rad for name in robot.robot.coordinates]
    return torch.diag(torch.tensor(deviation, dtype=torch.float64).square())


class _Problem:
    """Readings [mT] in poses, and the priors of all parameters."""

    def __init__(self, robot: RobotFile, u: Tensor, q: Tensor, covariance: Tensor, priors: Priors) -> None:
        self.file, self.u, self.q, self.covariance = robot, u, q, covariance
        self.moments = robot.moments if robot.moments is not None else u.new_zeros(0)
        self.noise = torch.diag((robot.noise / robot.gain).square())
        placement = priors.placement.of_parameters(robot.robot, self.moments.shape)
        rest = [priors.offset_mt] * u.shape[-1] + [priors.earth_mt] * 3
        self.scale = torch.cat([placement, u.new_tensor(rest)])
        self.sizes = [len(placement), u.shape[-1], 3]

    def solve(self) -> Tensor:
        """Parameters in units of their priors."""
        z = self.u.new_zeros(len(self.scale))
        for _ in range(_ITERATIONS):
            r, J, hessian = self.whitened(z)
            step = torch.linalg.solve(hessian, J.mT @ r - z)
            z = z + step
            if float(step.abs().max()) < 1e-6:
                break
        return z

    def whitened(self, z: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Residuals of unit covariance, their derivatives by ``z``, Hessian."""
        p, offset, earth = self.split(z)
        u_hat, J, J_q = PlacedReadings(self.file.robot, self.q, self.moments, earth).linearise(p)
        parts = placed(self.file.robot, self.moments, p)
        moved = Robot(self.file.robot.segments, parts.magnets, parts.sensors)
        by_earth = parts.gain.unsqueeze(-1) * moved.sensor_poses(self.q)[..., :3, 2]
        by_offset = torch.eye(len(offset)).to(z).expand(len(self.q), -1, -1)
        noise = self.noise + J_q @ self.covariance @ J_q.mT
        rows = torch.cat(
            [(self.u - u_hat - offset).unsqueeze(-1), torch.cat([J, by_offset, by_earth], -1) * self.scale],
            -1,
        )
        rows = torch.linalg.solve_triangular(torch.linalg.cholesky(noise), rows, upper=False).flatten(0, 1)
        r, J = rows[:, 0], rows[:, 1:]
        return r, J, J.mT @ J + torch.eye(len(z)).to(z)

    def split(self, z: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Geometry, gains and moments; offsets [mT]; Earth field [mT]."""
        p, offset, earth = (z * self.scale).split(self.sizes)
        return p, offset, self.file.earth_mt + earth

    def calibration(self, z: Tensor) -> RobotCalibration:
        r, _, hessian = self.whitened(z)
        covariance = torch.linalg.inv(hessian)
        p, offset, earth = self.split(z)
        names = calibration_names(self.file)
        units = self.scale.clone()
        n, s = self.sizes[0], self.sizes[1]
        units[n : n + s] *= self.file.gain
        scaled = units.unsqueeze(-1) * covariance * units
        return RobotCalibration(
            robot=self.file.name,
            robot_sha256=self.file.sha256,
            names=names,
            parameters=p,
            offset=offset * self.file.gain,
            earth_mt=earth,
            covariance=(scaled + scaled.mT) / 2,
            undetermined=tuple(undetermined(names, covariance.numpy())),
            poses=len(self.q),
            held_out=0,
            before=None,
            after=None,
            chi2=float(r.square().mean()),
        )


def calibration_names(robot: RobotFile) -> tuple[str, ...]:
    """Names of what a calibration says: geometry, gains and moments, then offsets and the Earth field."""
    moments = robot.moments.shape if robot.moments is not None else 0
    return (
        *parameter_names(robot.robot, moments),
        *(f"sensor {j + 1} offset" for j in range(len(robot.channel))),
        *(f"Earth field along {axis}" for axis in "xyz"),
    )


def _rms(robot: RobotFile, q: Tensor, values: Tensor, calibration: RobotCalibration | None) -> float:
    """Root mean square residual of the readings [unit]."""
    model = robot if calibration is None else robot.calibrated(calibration)
    r = values[:, list(robot.channel)] - model.offset - model.sensing()(q)
    return float(r.square().mean().sqrt())


def check_plausible(calibration: RobotCalibration, robot: RobotFile) -> None:
    """Refuse a calibration that cannot be right, whatever the reason.

    Raises
    ------
    InputError
        If the residuals are more than four times as large as stated, or poses that the fit has not seen are
        predicted worse than by the robot as described while the fit does not explain its own poses either.
    """
    if calibration.chi2 > MOST_CHI2:
        received = (
            f"chi2 {calibration.chi2:.3g}, residuals {calibration.chi2**0.5:.3g} times as large as stated"
        )
    elif (
        calibration.before is not None
        and calibration.after is not None
        and calibration.after > calibration.before
        and calibration.chi2 > DOUBTFUL_CHI2
    ):
        received = (
            f"a residual of {calibration.after:.3g} {robot.unit} in poses held out of the fit, above the "
            f"{calibration.before:.3g} {robot.unit} as described, and chi2 {calibration.chi2:.3g}"
        )
    else:
        return
    expected = f"readings of {robot.name} in these poses (usual causes if not: {_CAUSES})"
    raise bad_input("poses and readings", "repro calibrate", expected, received)


def report(calibration: RobotCalibration, unit: str) -> str:
    """Say in words what a calibration found: residuals, and what the poses do not determine."""
    lines = [f"{calibration.poses} poses, {len(calibration.names)} parameters, chi2 {calibration.chi2:.2f}."]
    if calibration.before is not None and calibration.after is not None:
        lines.append(
            f"Residual of {calibration.held_out} poses held out of the fit: {calibration.before:.3g} {unit} as "
            f"described, {calibration.after:.3g} {unit} calibrated."
        )
    else:
        lines.append(f"No residual of poses held out of the fit: that takes {2 * _HOLD_OUT_EVERY} poses.")
    if calibration.chi2 > DOUBTFUL_CHI2:
        lines.append("chi2 should be near 1: noise, poses or parts are farther off than stated.")
    if calibration.undetermined:
        lines.append("Not determined by these poses, kept near the robot file within the tolerance:")
        lines += [f"  {text}" for text in calibration.undetermined]
    else:
        lines.append("The poses determine all parameters better than their tolerances.")
    return "\n".join(lines)
