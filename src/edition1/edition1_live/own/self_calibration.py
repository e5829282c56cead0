r"""Calibration of a described robot without measured poses: what drifts of magnets and sensors, from motion alone.

A :class:`~edition1.estimation.self_calibration.SelfCalibratingFilter` finds moments, gains and offsets :math:`\theta`
together with the configuration; headings and tilts of IMUs are found too and forgotten. The place of magnets and
sensors and the Earth field, :math:`p`, it takes as they are known before. They are not known exactly: with a root
:math:`L L^T` of their covariance and the changes :math:`\Delta` of what the filter finds when :math:`p` changes by a
column of L,

.. math:: \Sigma_{\theta\theta} = F + \Delta \Delta^T, \qquad \Sigma_{\theta p} = \Delta L^T,

where F is the covariance that the filter states.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import torch
from jaxtyping import Float
from torch import Tensor
from tqdm import tqdm

from edition1.errors import bad_input
from edition1.estimation.undetermined import not_determined
from edition1.robot_file.calibration_file import RobotCalibration
from edition1.robot_file.robot_file import RobotFile
from edition1.sensing.placement import Tolerances
from edition1_live.own.motion import OWN, Beginning, filter_of, filtered, motion
from edition1_live.own.samples import TimedReadings
from edition1_live.robot.calibrate import DOUBTFUL_CHI2, MOST_CHI2, Priors, calibration_names

PRIORS = Priors(placement=Tolerances(sensor_gain=0.05, moments=0.05))
"""Moments and gains may be off by as much: what is not determined of a product is then named as a product."""
_PLACEMENT = (
    "The place and tilt of magnets and sensors and the Earth field are not determined by this motion."
)
_ROUGHLY = 10.0
"""So many times the noise in a first pass, which says where to linearise."""
_CURVATURE = 0.003
"""Share of a reading that counts as noise at least: linearised, finer readings would teach what is not so."""
_FARTHEST = 5.0
"""Farther from what was known than so many standard deviations is no drift. In simulation, drawn from the priors, 3.7
was the most; with axes exchanged or of the wrong sign it is 14 and more."""
_CONFIGURATIONS = 64
"""Configurations over which the error of the place of the parts is averaged."""


@dataclass(frozen=True)
class SelfCalibration:
    """What motion says of a robot.

    Parameters
    ----------
    calibration
        As of measured poses, of which there are none; ``undetermined`` are sentences.
    parameters
        For each moment, gain and offset its name, its change, its uncertainty, and that before, all against the robot
        as it was known before; relative, offsets in mT.
    steps, seconds
        Time steps that were used, and the time from the first to the last [s].
    """

    calibration: RobotCalibration
    parameters: tuple[tuple[str, float, float, float], ...]
    steps: int
    seconds: float


def self_calibrate(
    robot: RobotFile,
    readings: TimedReadings,
    *,
    earlier: RobotCalibration | None = None,
    begins: Beginning | None = None,
    priors: Priors = PRIORS,
    progress: bool = False,
) -> SelfCalibration:
    """Find the moments, gains and offsets of a robot from its readings in motion.

    Parameters
    ----------
    robot
        As described, with magnets and magnetic sensors; IMUs at which the base is upright make more of it known.
    readings
        In motion. What is found counts as constant meanwhile.
    earlier
        A calibration that knows the place of the parts and the Earth field; without it they are as described, within
        the tolerances. Moments, gains and offsets start from it, and may have changed by as much as without it.
    begins
        Where the robot is at its first reading, if that is known.
    priors
        How far the robot may be from what is known before.
    progress
        Show a progress bar.

    Raises
    ------
    InputError
        If the robot has no magnetic sensors or its base leans, the motion is too short, or no motion of this robot.
    """
    before = _before(robot, earlier, priors)
    known, own, values = robot.calibrated(before), _own(before), _values(before)
    times, u = motion(known, before.offset, readings)
    placement = replace(before, covariance=before.covariance * ~(own | own.unsqueeze(-1)))
    noise_mt, root = _noise_mt(robot.calibrated(placement)), _root(before.covariance[~own][:, ~own])
    root = root[:, root.any(dim=0)]  # what is known exactly adds nothing
    method, changes = filter_of(known, priors, noise_mt), []
    with tqdm(total=len(times) * (2 + root.shape[1]), unit="steps", disable=not progress) as bar:
        first = filtered(replace(method, noise_mt=_ROUGHLY * noise_mt), times, u, bar, begins=begins)[0]
        at = {"start": first, "begins": begins}
        theta, F, chi2 = filtered(method, times, u, bar, **at)
        prior = torch.from_numpy(method.errors.start[: len(theta)])
        _check_plausible(robot, chi2, float((theta / prior).abs().max()))
        for column in root.T:
            moved = robot.calibrated(_with(before, values.index_add(0, torch.nonzero(~own)[:, 0], column)))
            changes.append(filtered(filter_of(moved, priors, noise_mt), times, u, bar, **at)[0] - theta)
    delta = torch.stack(changes, dim=-1) if changes else theta.new_zeros(len(theta), 0)
    total = F + delta @ delta.T
    std, errors = total.diagonal().sqrt(), method.errors.names[: len(theta)]
    to_own = _to_own(before, errors, known.gain)
    # by what the filter leaves open, and by what is uncertain of the rest
    both = torch.zeros(len(own), len(theta) + root.shape[1], dtype=torch.float64)
    both[own, : len(theta)] = to_own @ _root(F)
    both[own, len(theta) :] = to_own @ delta
    both[~own, len(theta) :] = root
    covariance = both @ both.T
    values = values.index_add(0, torch.nonzero(own)[:, 0], to_own @ theta)
    open_ = *not_determined(errors, (total / torch.outer(prior, prior)).numpy()), _PLACEMENT
    found = replace(
        _with(before, values), covariance=(covariance + covariance.mT) / 2, undetermined=open_, chi2=chi2
    )
    rows = zip(errors, theta.tolist(), std.tolist(), prior.tolist(), strict=True)
    return SelfCalibration(found, tuple(rows), len(times), times[-1])


def report(found: SelfCalibration) -> str:
    """Say in words what motion told, and what it did not."""
    lines = [f"{found.steps} time steps over {found.seconds:.0f} s, chi2 {found.calibration.chi2:.2f}."]
    for name, value, std, prior in found.parameters:
        scale, unit = (1.0, "mT") if name.startswith("offset") else (100.0, "%")
        lines.append(
            f"{name}: {scale * value:+.2g} ± {scale * std:.2g} {unit} (before ± {scale * prior:.2g} {unit})"
        )
    if found.calibration.chi2 > DOUBTFUL_CHI2:
        lines.append("chi2 should not be above 1: noise or parts are farther off than stated.")
    lines.append("Kept near what was known before:")
    return "\n".join(lines + [f"  {text}" for text in found.calibration.undetermined])


def _check_plausible(robot: RobotFile, chi2: float, farthest: float) -> None:
    """Refuse residuals, or a change of a moment, gain or offset in units of its prior, that cannot be right."""
    if chi2 > MOST_CHI2 or farthest > _FARTHEST:
        causes = (
            "axes exchanged or of the wrong sign, another unit than the file says, a robot file of another robot, "
            "iron or magnets that came near, or parts farther off than the tolerances (calibrate in measured poses)"
        )
        expected = f"those of {robot.name} in motion (usual causes if not: {causes})"
        received = f"chi2 {chi2:.3g}, and a moment, gain or offset {farthest:.2g} times as far off as assumed"
        raise bad_input("readings", "repro calibrate --self", expected, received)


def _before(robot: RobotFile, earlier: RobotCalibration | None, priors: Priors) -> RobotCalibration:
    """What is known before the motion."""
    robot.sensing()  # refuses robots without magnetic sensors
    if robot.moments is None or robot.networks:
        expected = "one whose sensors read the field of magnets"
        raise bad_input("robot", "repro calibrate --self", expected, f"{len(robot.networks)} networks")
    placement = priors.placement.of_parameters(robot.robot, robot.moments.shape)
    std = torch.cat([placement, priors.offset_mt * robot.gain, torch.full((3,), priors.earth_mt).double()])
    nothing = RobotCalibration(
        robot=robot.name,
        robot_sha256=robot.sha256,
        names=calibration_names(robot),
        parameters=torch.zeros_like(placement),
        offset=torch.zeros_like(robot.offset),
        earth_mt=robot.earth_mt,
        covariance=torch.diag(std**2),
        undetermined=(),
        poses=0,
        held_out=0,
        before=None,
        after=None,
        chi2=0.0,
    )
    if earlier is None:
        return nothing
    robot.calibrated(earlier)  # refuses that of another file
    own = _own(nothing)
    covariance = torch.where(own | own.unsqueeze(-1), nothing.covariance, earlier.covariance)
    return replace(earlier, covariance=covariance, poses=0, held_out=0, before=None, after=None)


def _own(calibration: RobotCalibration) -> Tensor:
    """Whether a parameter is a moment, a gain or an offset."""
    return torch.tensor([bool(set(OWN) & set(name.split())) for name in calibration.names])


def _values(calibration: RobotCalibration) -> Float[Tensor, " all"]:
    return torch.cat([calibration.parameters, calibration.offset, calibration.earth_mt])


def _with(calibration: RobotCalibration, values: Float[Tensor, " all"]) -> RobotCalibration:
    p, offset, earth = values.split([len(calibration.parameters), len(calibration.offset), 3])
    return replace(calibration, parameters=p, offset=offset, earth_mt=earth)


def _root(C: Float[Tensor, "p p"]) -> Float[Tensor, "p p"]:
    """Root of a covariance whose parameters have units that are far apart."""
    size = C.diagonal().clamp_min(torch.finfo(C.dtype).tiny).sqrt()
    values, vectors = torch.linalg.eigh(C / size.unsqueeze(-1) / size)
    return size.unsqueeze(-1) * vectors * values.clamp_min(0.0).sqrt()


def _noise_mt(robot: RobotFile) -> float:
    """Noise of a Hall sensor, and the error of its reading by the place of the parts, over the bounds [mT]."""
    assert robot.error is not None
    share = torch.rand(
        _CONFIGURATIONS, len(robot.lower), dtype=torch.float64, generator=torch.Generator().manual_seed(0)
    )
    q = robot.lower + share * (robot.upper - robot.lower)
    C, u_hat = robot.error(q), robot.sensing()(q)
    size = (u_hat / robot.gain).square().mean()
    white = (robot.noise / robot.gain).square().max() + _CURVATURE**2 * size
    return float((white + (C.diagonal(dim1=-2, dim2=-1) / robot.gain**2).mean()).sqrt())


def _to_own(
    before: RobotCalibration, errors: tuple[str, ...], gain: Float[Tensor, " s"]
) -> Float[Tensor, "own errors"]:
    """What errors of the filter add to the moments, gains and offsets of a calibration, in its units."""
    rows = []
    for name, value in zip(before.names, _values(before).tolist(), strict=True):
        # sensor 2 gain, magnet 1 moment A3, or of magnets that are alike moment A3
        owner, part, *kind = name.split()
        if not set(OWN) & set(name.split()):
            continue
        at = 0 if owner == "moment" else errors.index(f"{kind[0]} {part}")
        rows.append(torch.zeros(len(errors), dtype=torch.float64))
        rows[-1][at] = gain[int(part) - 1] if kind[:1] == ["offset"] else 1 + value
    return torch.stack(rows)
