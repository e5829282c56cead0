"""Errors on T3 of a robot that is not as drawn and not calibrated, against how far its parts are off.

The sensor model is the multipole field of the drawing; readings come from magpylib and the true robot. Each tolerance
is studied alone, so that its share is seen, and beside what first order predicts.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict, replace

import numpy as np
import pandas as pd
import torch
from edition1.errors import bad_input, require
from edition1.kinematics.paper_robots import pcc_robot
from edition1.kinematics.robot import Robot
from edition1.sensing.linearised import LinearisedSensing
from edition1.sensing.magnetic import readings
from edition1.sensing.magnets import Ring, ring
from edition1.sensing.placement import PlacedReadings, Tolerances, placed
from jaxtyping import Float
from torch import Tensor

from edition1_companion.book.bootstrap import BOOTSTRAPS, interval, resampled
from edition1_companion.pages.noise_and_tolerances.noise import LM_ITERATIONS
from edition1_companion.twins.calibrated_robots import least_squares, relative_error, standard_normal
from edition1_companion.twins.calibration_session import L_MAX
from edition1_companion.twins.trajectories import lemniscate

KINDS = {
    "magnet_position_m": ("magnet position", "mm", 1e3),
    "magnet_tilt_rad": ("magnet tilt", "deg", 180 / math.pi),
    "sensor_azimuth_rad": ("sensor azimuth", "deg", 180 / math.pi),
    "sensor_radius": ("sensor radius", "%", 100.0),
    "sensor_tilt_rad": ("sensor tilt", "deg", 180 / math.pi),
    "sensor_gain": ("sensor gain", "%", 100.0),
    "moments": ("magnet moments", "%", 100.0),
}
"""Fields of :class:`~edition1.sensing.placement.Tolerances`: name, unit in tables, factor to that unit."""
FACTORS = (0.03125, 0.0625, 0.125, 0.25, 0.5, 1.0, 2.0, 4.0)
"""Sizes of the study, in units of the default tolerances."""


def sensitivity(
    robot: Robot, q: Float[Tensor, "t n_q"], moments: Float[Tensor, " terms"]
) -> Float[Tensor, "t n_q k"]:
    r"""Derivative of the least-squares estimate with respect to the parameters of the true robot.

    The estimate minimises :math:`\|h(q, p) - h(\hat q, 0)\|^2`. Where the robot is as drawn, :math:`p = 0`, the
    residual vanishes and the implicit function theorem gives

    .. math:: \frac{\partial \hat q}{\partial p} = J_q^+ J_p, \qquad J_q^+ = (J_q^T J_q)^{-1} J_q^T,

    with both Jacobians in closed form. Parameters are in the order of
    :func:`edition1.sensing.placement.parameter_names`: m, rad, relative.
    """
    model = PlacedReadings(robot, q, moments)
    names = 5 * len(robot.magnets) + 4 * len(robot.sensors) + moments.shape[-1]
    _, J_p, J_q = model.linearise(q.new_zeros(names))
    return torch.linalg.pinv(J_q) @ J_p


def placed_readings(
    robot: Robot, parameters: Float[Tensor, "*draws k"], q: Float[Tensor, "t n_q"], magnet: Ring
) -> Float[Tensor, "t *draws s"]:
    """Readings [mT] of robots that differ from their drawing by ``parameters``, by magpylib.

    Magpylib's magnet has the moments of the drawing; the part of the field that belongs to their change is linear
    in it, and added as a multipole series.
    """
    moments = torch.from_numpy(magnet.multipoles(L_MAX))
    parts = placed(robot, moments, parameters)
    true_robot = replace(robot, magnets=parts.magnets, sensors=parts.sensors)
    q = q.reshape(len(q), *(1,) * (parameters.ndim - 1), -1)
    u = readings(true_robot, q, magnet)
    if bool((parts.moments != moments).any()):
        u = u + LinearisedSensing(true_robot, parts.moments - moments)(q)
    return parts.gain * u


def tolerance_errors(
    n_segments: int,
    kinds: Sequence[str] = tuple(KINDS),
    factors: Sequence[float] = FACTORS,
    *,
    draws: int = 10,
    seed: int = 0,
    ring_name: str = "released",
    steps: int = 400,
) -> pd.DataFrame:
    """Errors on T3 without noise, each tolerance alone, for robots drawn at random.

    The parameters of the kind are normal, with the tolerance as standard deviation; all others are as drawn. Robots
    of the same draw differ by a factor only, and every draw has a generator of its own. Levenberg-Marquardt starts
    straight at mid elongation, at every time step anew, within the training box.

    Parameters
    ----------
    n_segments
        Segments of the robot.
    kinds
        Which tolerances: keys of :data:`KINDS`.
    factors
        Sizes, in units of the defaults of :class:`~edition1.sensing.placement.Tolerances`.
    draws
        Robots per size.
    seed
        Of all draws.
    ring_name
        Magnet: ``"released"`` or ``"published"``.
    steps
        Time steps along T3.

    Returns
    -------
    DataFrame
        Columns ``n_b, kind, factor, size, unit, draw``, then the mean relative error, eq. (13), of all coordinates:
        ``error_percent``, and ``linear_percent`` as first order predicts it for the same robot.

    Raises
    ------
    InputError
        If a kind is unknown, a factor is negative, or there is no draw.
    """
    if unknown := [kind for kind in kinds if kind not in KINDS]:
        raise bad_input("kinds", "tolerance_errors", f"among {', '.join(map(repr, KINDS))}", unknown)
    if not all(factor >= 0 for factor in factors):
        raise bad_input("factors", "tolerance_errors", "not negative", list(factors))
    require(draws >= 1, "draws", "tolerance_errors", "at least 1", draws)
    robot, q, magnet = pcc_robot(n_segments), lemniscate(n_segments, steps=steps), ring(ring_name)
    moments = torch.from_numpy(magnet.multipoles(L_MAX))
    sensing = LinearisedSensing(robot, moments)
    derivative = sensitivity(robot, q, moments)
    width = q.amax(0) - q.amin(0)
    normal = standard_normal(derivative.shape[-1:], range(1000 * seed, 1000 * seed + draws))
    tables = []
    for kind in kinds:
        scale = torch.tensor(list(factors), dtype=q.dtype)[:, None, None] * _only(kind, robot, len(moments))
        parameters = scale * normal  # [factor, draw, k]
        u = placed_readings(robot, parameters, q, magnet)
        found = least_squares(sensing, u, n_segments, iterations=LM_ITERATIONS)
        error = relative_error(found.q, q).mean(-1)
        moved = torch.einsum("tqk,fdk->tfdq", derivative, parameters)
        linear = (100 * moved.square().mean(0).sqrt() / width).mean(-1)
        index = pd.MultiIndex.from_product([factors, range(draws)], names=["factor", "draw"])
        columns = {"error_percent": error.flatten().tolist(), "linear_percent": linear.flatten().tolist()}
        table = pd.DataFrame(columns, index=index).reset_index()
        _, unit, to_unit = KINDS[kind]
        size = table["factor"] * asdict(Tolerances())[kind] * to_unit
        tables.append(table.assign(n_b=n_segments, kind=kind, size=size, unit=unit))
    columns = ["n_b", "kind", "factor", "size", "unit", "draw", "error_percent", "linear_percent"]
    return pd.concat(tables, ignore_index=True).reindex(columns=columns)


def tolerance_means(table: pd.DataFrame, *, seed: int = 0) -> pd.DataFrame:
    """Means over the draws with their 95 % bootstrap interval.

    Columns: ``n_b, kind, factor, size, unit, error_percent, low_percent, high_percent, linear_percent``.
    """
    keys = ["n_b", "kind", "factor", "size", "unit"]
    lines = []
    for labels, part in table.groupby(keys, sort=False):
        errors = part["error_percent"].to_numpy()
        low, high = interval(_resampled(errors, seed).mean(1))
        lines.append((*labels, errors.mean(), low, high, part["linear_percent"].mean()))
    return pd.DataFrame(
        lines, columns=[*keys, "error_percent", "low_percent", "high_percent", "linear_percent"]
    )


def allowed(table: pd.DataFrame, *, error_percent: float = 1.0, seed: int = 0) -> pd.DataFrame:
    """How large each tolerance may be, alone, for a given mean error.

    Parameters
    ----------
    table
        From :func:`tolerance_errors`.
    error_percent
        Mean relative error that is accepted, over the coordinates and the draws.
    seed
        Of the bootstrap.

    Returns
    -------
    DataFrame
        Columns ``n_b, tolerance, unit, allowed`` with its 95 % bootstrap interval over the draws ``low, high``,
        ``linear`` (as first order predicts it) and ``assumed`` (the default of
        :class:`~edition1.sensing.placement.Tolerances`). Sizes between those of the study are interpolated along
        straight lines in logarithms; a size outside them is not a number.
    """
    lines = []
    for (n_b, kind), part in table[table["size"] > 0].groupby(["n_b", "kind"], sort=False):
        name, unit, to_unit = KINDS[kind]
        errors = part.pivot_table(index="draw", columns="size", values="error_percent")
        size = errors.columns.to_numpy(dtype=float)
        found = _crossing(size, errors.to_numpy().mean(0), error_percent)
        resampled = _resampled(errors.to_numpy(), seed).mean(1)
        spread = [_crossing(size, mean, error_percent) for mean in resampled]
        low, high = interval(np.array(spread)) if np.isfinite(spread).all() else (math.nan, math.nan)
        slope = (part["linear_percent"] / part["size"]).mean()
        assumed = asdict(Tolerances())[kind] * to_unit
        lines.append((n_b, name, unit, found, low, high, error_percent / slope, assumed))
    columns = ["n_b", "tolerance", "unit", "allowed", "low", "high", "linear", "assumed"]
    return pd.DataFrame(lines, columns=columns)


def _only(kind: str, robot: Robot, terms: int) -> Tensor:
    """Default tolerance of every parameter of one kind, zero for the others."""
    # Marked through the class itself, so that the order of the parameters stands in one place only.
    others = dict.fromkeys(KINDS, 1.0) | {kind: 2.0}
    marked = Tolerances(**others).of_parameters(robot, terms) == 2.0
    return Tolerances().of_parameters(robot, terms) * marked


def _resampled(values: np.ndarray, seed: int) -> np.ndarray:
    """Bootstrap samples ``[sample, draw, ...]`` of the first dimension."""
    return values[resampled(len(values), seed, bootstraps=BOOTSTRAPS // 10)]


def _crossing(size: np.ndarray, error: np.ndarray, wanted: float) -> float:
    """Size at which an error that grows with it takes a value, along straight lines in logarithms."""
    above = np.flatnonzero(error >= wanted)
    if not len(above) or above[0] == 0:
        return math.nan
    k = above[0]
    x, y = np.log(size[k - 1 : k + 1]), np.log(error[k - 1 : k + 1])
    return float(np.exp(np.interp(math.log(wanted), y, x)))
