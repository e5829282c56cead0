r"""Calibration of a robot: moments and geometry from readings in measured poses, with the tolerances as priors.

Parameters :math:`z` in units of their tolerance minimise

.. math:: \|z\|^2 + \sum_i r_i^T S_i^{-1} r_i, \qquad r_i = u_i - h(q_i, z), \qquad
          S_i = \sigma_u^2 I + J_i \Sigma_{q,i} J_i^T :

the configuration of a pose is known only up to its measurement, so the residual is uncertain by the noise of the
sensors and by that of the pose, seen through :math:`J_i = \partial u/\partial q`. The posterior covariance of
:math:`z` is the inverse of the Hessian; directions in which it stays near one are what the poses do not determine.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import torch
from jaxtyping import Float
from torch import Tensor

from edition1 import se3
from edition1.errors import bad_input, require
from edition1.estimation.undetermined import undetermined
from edition1.kinematics.robot import Robot
from edition1.sensing.linearised import LinearisedSensing
from edition1.sensing.moments import check_readings
from edition1.sensing.placement import PlacedReadings, Tolerances, parameter_names, placed


@dataclass(frozen=True)
class Calibration:
    """A calibrated robot and how well it is known.

    Parameters
    ----------
    robot
        With corrected mounts.
    moments
        Moments :math:`A_1, A_3, ...` [mT m^(l+2)].
    gain
        Gain of every sensor.
    names
        Names of the parameters.
    estimate
        Parameters: m, rad, relative.
    deviation
        Their posterior standard deviations, in the same units.
    covariance
        Posterior covariance in units of the tolerances: the identity before the first pose.
    chi2
        Weighted sum of squared residuals per reading: near one when noise and tolerances are as stated.
    last_step
        Largest change of a parameter in the last iteration, in units of its tolerance.
    """

    robot: Robot
    moments: Float[Tensor, "*batch terms"]
    gain: Float[Tensor, "*batch s"]
    names: tuple[str, ...]
    estimate: Float[Tensor, "*batch k"]
    deviation: Float[Tensor, "*batch k"]
    covariance: Float[Tensor, "*batch k k"]
    chi2: Float[Tensor, "*batch"]
    last_step: float

    def sensing(self, earth_mt: Float[Tensor, " 3"] | None = None) -> LinearisedSensing:
        """Sensor model ``u = sensing(q)`` of the calibrated robot, in an Earth field [mT] if there is one."""
        return LinearisedSensing(self.robot, self.moments, self.gain, earth_mt)

    def undetermined(self, threshold: float = 0.9) -> list[str]:
        """Combinations of parameters that stay as uncertain as their tolerances, in words.

        As :func:`edition1.estimation.undetermined.undetermined` says them; the priors are the tolerances.

        Parameters
        ----------
        threshold
            Ratio of posterior to prior standard deviation from which a combination counts as undetermined.

        Raises
        ------
        InputError
            For a batch of calibrations: ask one of them.
        """
        if self.covariance.ndim != 2:
            shape = f"covariance of shape {tuple(self.covariance.shape)}"
            raise bad_input("calibration", "undetermined", "that of one robot", shape)
        return undetermined(self.names, self.covariance.numpy(), threshold)


def calibrate(
    robot: Robot,
    q: Float[Tensor, "*batch poses n_q"],
    q_covariance: Float[Tensor, "*c k k"],
    u: Float[Tensor, "*batch poses s"],
    moments: Float[Tensor, " terms"],
    *,
    noise_mt: float,
    tolerances: Tolerances | None = None,
    earth_mt: Float[Tensor, " 3"] | None = None,
    iterations: int = 8,
) -> Calibration:
    """Moments, placement of magnets and sensors, and gains, by Gauss-Newton with Gaussian priors.

    Parameters
    ----------
    robot
        As drawn. Its magnets share the moments.
    q
        Measured configurations; a batch calibrates as many robots at once.
    q_covariance
        Covariance of ``q``, of every pose or common to all (:func:`edition1.estimation.poses.configurations`).
    u
        Readings [mT].
    moments
        Moments of the magnet as drawn [mT m^(l+2)].
    noise_mt
        Standard deviation of a reading [mT].
    tolerances
        Standard deviations of the priors.
    earth_mt
        Earth field in the base frame [mT]; none when not given.
    iterations
        Largest number of iterations; six are enough as a rule.

    Raises
    ------
    InputError
        If readings, poses and moments do not fit or are not finite, there is no pose, or the noise is not positive.

    Examples
    --------
    >>> from edition1.kinematics.paper_robots import pcc_robot
    >>> from edition1.sensing.magnetic import readings
    >>> from edition1.sensing.magnets import ring
    >>> robot, magnet = pcc_robot(1), ring("released")
    >>> q = 0.01 * torch.rand(20, 3, dtype=torch.float64, generator=torch.Generator().manual_seed(0))
    >>> moments = torch.from_numpy(magnet.multipoles(5))
    >>> known = 1e-12 * torch.eye(3, dtype=torch.float64)
    >>> u = 1.02 * readings(robot, q, magnet)  # a magnet that is stronger by 2 %
    >>> found = calibrate(robot, q, known, u, moments, noise_mt=1e-3)
    >>> [round(float(x), 2) for x in found.moments[0] / moments[0] * found.gain]
    [1.02, 1.02, 1.02]
    """
    check_readings("calibrate", robot, q, u)
    require(q.shape[-2], "q", "calibrate", "at least one pose", "none")
    if q_covariance.shape[-2:] != (robot.n_q, robot.n_q):
        expected = f"of last dimensions ({robot.n_q}, {robot.n_q})"
        raise bad_input("q_covariance", "calibrate", expected, f"shape {tuple(q_covariance.shape)}")
    se3.require_finite(q_covariance, "q_covariance", "calibrate")
    if moments.ndim != 1:
        expected = "those that all magnets share, of one dimension"
        raise bad_input("moments", "calibrate", expected, f"shape {tuple(moments.shape)}")
    se3.require_finite(moments, "moments", "calibrate")
    require(noise_mt > 0, "noise_mt", "calibrate", "positive [mT]", noise_mt)
    require(iterations >= 1, "iterations", "calibrate", "at least 1", iterations)
    terms = moments.shape[-1]
    model = PlacedReadings(robot, q, moments, earth_mt)
    scale = (tolerances or Tolerances()).of_parameters(robot, terms).to(q)
    z = q.new_zeros(*q.shape[:-2], len(scale))
    step = torch.full_like(z, torch.inf)
    r, J, hessian = _whitened(model, z, scale, u, q_covariance.to(q), noise_mt)
    for _ in range(iterations):
        step = torch.linalg.solve(hessian, (J.mT @ r.unsqueeze(-1)).squeeze(-1) - z)
        z = z + step
        r, J, hessian = _whitened(model, z, scale, u, q_covariance.to(q), noise_mt)
        if float(step.abs().max()) < 1e-6:
            break
    covariance = torch.linalg.inv(hessian)
    parts = placed(robot, moments.to(q), z * scale)
    return Calibration(
        robot=replace(robot, magnets=parts.magnets, sensors=parts.sensors),
        moments=parts.moments,
        gain=parts.gain,
        names=parameter_names(robot, terms),
        estimate=z * scale,
        deviation=covariance.diagonal(dim1=-2, dim2=-1).sqrt() * scale,
        covariance=covariance,
        chi2=r.square().mean(-1),
        last_step=float(step.abs().max()),
    )


def _whitened(
    model: PlacedReadings, z: Tensor, scale: Tensor, u: Tensor, q_covariance: Tensor, noise_mt: float
) -> tuple[Tensor, Tensor, Tensor]:
    """Residuals ``[..., poses * s]`` of unit covariance, derivatives by ``z`` in their units, Hessian."""
    u_hat, J, J_q = model.linearise(z * scale)
    noise = noise_mt**2 * torch.eye(u.shape[-1]).to(u) + J_q @ q_covariance @ J_q.mT
    rows = torch.cat([(u - u_hat).unsqueeze(-1), J * scale], dim=-1)
    rows = torch.linalg.solve_triangular(torch.linalg.cholesky(noise), rows, upper=False).flatten(-3, -2)
    r, J = rows[..., 0], rows[..., 1:]
    return r, J, J.mT @ J + torch.eye(len(scale)).to(u)
