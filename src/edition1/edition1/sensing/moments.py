"""Multipole moments of a magnet from readings in known poses: a linear least-squares problem."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from edition1 import se3
from edition1.errors import bad_input, require
from edition1.kinematics.robot import Robot
from edition1.sensing._multipoles import multipole_factors
from edition1.sensing.relations import relations


@dataclass(frozen=True)
class MomentFit:
    """Moments that explain a set of readings best.

    Parameters
    ----------
    moments
        :math:`A_1, A_3, ...` [mT m^(l+2)], common to all magnets.
    condition
        Condition number of the columns scaled to unit length. It grows about tenfold with every term: the higher
        moments can be told apart only where poses bring the sensors close to a magnet and noise is low.
    rms_mt
        Root mean square of what the moments leave unexplained [mT].
    """

    moments: Float[Tensor, " terms"]
    condition: float
    rms_mt: float


def _moment_columns(
    terms: int, d: Float[Tensor, "*batch m"], cosines: tuple[Tensor, Tensor, Tensor]
) -> Float[Tensor, "*batch terms"]:
    r"""Reading per unit of each moment: :math:`\sum_k [-P'_l \cos\alpha_k + P'_{l+1} \cos\beta_k]/d_k^{l+2}`.

    Parameters
    ----------
    terms
        Number of moments, orders :math:`l = 1, 3, ...`.
    d
        Distances from the magnets [m].
    cosines
        Of alpha, beta and theta, eqs (4)-(6), as ``d``.
    """
    cos_alpha, cos_beta, cos_theta = (c.expand(terms, *c.shape) for c in cosines)
    unit = torch.eye(terms).to(d).reshape(terms, *(1,) * d.ndim, terms)
    f, g = multipole_factors(unit, d.expand(terms, *d.shape), cos_theta)
    return (f * cos_alpha + g * cos_beta).sum(-1).movedim(0, -1)


def fit_moments(
    robot: Robot,
    q: Float[Tensor, "poses n_q"],
    u: Float[Tensor, "poses s"],
    *,
    terms: int = 3,
    earth_mt: Float[Tensor, " 3"] | None = None,
) -> MomentFit:
    r"""Moments by linear least squares, all magnets alike.

    Given the geometry the reading is linear in the moments. The fitted moments serve every number of segments and
    every placement of sensors.

    Parameters
    ----------
    robot
        Its geometry, taken as exact.
    q
        Configurations of the poses.
    u
        Readings [mT].
    terms
        Number of moments.
    earth_mt
        Earth field in the base frame [mT], subtracted first; none when not given.

    Raises
    ------
    InputError
        If the readings do not fit the robot and the poses, are not finite, or are fewer than the moments.

    Examples
    --------
    >>> from edition1.sensing.magnetic import readings
    >>> from edition1.sensing.magnets import ring
    >>> from edition1.kinematics.paper_robots import pcc_robot
    >>> q = 0.02 * torch.rand(40, 3, dtype=torch.float64, generator=torch.Generator().manual_seed(0))
    >>> fit = fit_moments(pcc_robot(1), q, readings(pcc_robot(1), q, ring("published")), terms=2)
    >>> [round(float(x)) for x in fit.moments * torch.tensor([1e9, 1e15])]  # exact: 58725, -1453444 mT mm^(l+2)
    [58722, -1445446]
    """
    check_readings("fit_moments", robot, q, u)
    if terms < 1 or u.numel() < terms:
        raise bad_input("u", "fit_moments", f"at least {max(terms, 1)} readings", f"{u.numel()} readings")
    related = relations(robot, q)
    cosines = related.cosines()
    d, cos_alpha, cos_beta, cos_theta = cosines[..., 1:].unflatten(-1, (-1, 4)).unbind(-1)
    columns = _moment_columns(terms, d, (cos_alpha, cos_beta, cos_theta)).reshape(-1, terms)
    earth = 0.0 if earth_mt is None else related.sensor_axis @ earth_mt.to(q)
    rest = (u - earth).reshape(-1, 1)
    scale = torch.linalg.vector_norm(columns, dim=0)
    scaled = columns / scale
    solution = torch.linalg.lstsq(scaled, rest).solution
    return MomentFit(
        moments=solution.squeeze(-1) / scale,
        condition=float(torch.linalg.cond(scaled)),
        rms_mt=float((rest - scaled @ solution).square().mean().sqrt()),
    )


def check_readings(owner: str, robot: Robot, q: Tensor, u: Tensor) -> None:
    """Refuse readings that are not one finite number for each sensor of the robot in each pose.

    Raises
    ------
    InputError
        As said.
    """
    require(q.shape[-1] == robot.n_q, "q", owner, f"of last dimension {robot.n_q}", f"shape {tuple(q.shape)}")
    expected = (*q.shape[:-1], len(robot.sensors))
    if q.ndim < 2 or u.shape != expected:
        words = f"one reading for each of {len(robot.sensors)} sensors in each pose, shape {expected}"
        raise bad_input("u", owner, words, f"shape {tuple(u.shape)}")
    se3.require_finite(q, "q", owner)
    se3.require_finite(u, "u", owner)
