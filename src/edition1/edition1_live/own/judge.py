"""How far estimates are from measured poses, and whether their uncertainty says so."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import pandas as pd
import torch
from jaxtyping import Bool, Float
from scipy.stats import chi2
from torch import Tensor

from edition1.estimation.base import Estimate
from edition1.estimation.conformal import block_weights, conformal_factor
from edition1.kinematics.motion import tip_motion
from edition1.robot_file.robot_file import RobotFile
from edition1_live.follow.follower import Follower
from edition1_live.follow.robot_estimator import RobotEstimator
from edition1_live.own.samples import TimedReadings
from edition1_live.robot.calibration_poses import coordinate_columns

_COVERED = 0.95
_HELD = 0.9
_BLOCK_S = 2.0
"""Frames within this time count as one: their errors are alike."""


@dataclass(frozen=True)
class Tracked:
    """Estimates from a cold start, one for each frame; NaN where none was possible.

    Parameters
    ----------
    model, estimator
        ``described``, ``calibrated`` or ``network``; name of the estimator.
    q, covariance
        Configurations.
    residual
        Root mean square of magnetic readings minus prediction [unit].
    """

    model: str
    estimator: str
    q: Float[Tensor, "frames n_q"]
    covariance: Float[Tensor, "frames n_q n_q"]
    residual: Float[np.ndarray, " frames"]


@dataclass(frozen=True)
class Truth:
    """Measured poses at the frames that are judged; NaN in gaps of the motion capture.

    Parameters
    ----------
    q, covariance
        Configurations.
    tip
        Positions of the tip in the base frame [m].
    tip_covariance
        Of the tip [m^2].
    """

    q: Float[Tensor, "frames n_q"]
    covariance: Float[Tensor, "frames n_q n_q"]
    tip: Float[Tensor, "frames 3"]
    tip_covariance: Float[Tensor, "frames 3 3"]

    @property
    def known(self) -> Bool[Tensor, " frames"]:
        """Where there is a pose."""
        return torch.isfinite(self.q).all(-1)


def tracked(estimator: RobotEstimator, readings: TimedReadings, chosen: np.ndarray, model: str) -> Tracked:
    """Estimate from chosen readings, straight in the middle of the bounds at first, as live."""
    follower, n = Follower(estimator), len(estimator.start)
    nothing = torch.full((n,), torch.nan, dtype=torch.float64)
    q, covariance, residual = [], [], []
    for k in np.flatnonzero(chosen):
        u, estimate = follower.step(readings.steps[k])
        q.append(nothing if estimate is None else estimate.q)
        full = None if estimate is None else estimate.covariance
        covariance.append(nothing.expand(n, n) if full is None else full)
        residual.append(np.nan if estimate is None else _residual(estimator, u, estimate))
    return Tracked(model, estimator.name, torch.stack(q), torch.stack(covariance), np.array(residual))


def _residual(estimator: RobotEstimator, u: Tensor, estimate: Estimate) -> float:
    """Of the magnetic sensors [unit]; beside IMUs, readings are in units of their noise."""
    rest = (u - estimate.u_hat)[: len(estimator.robot.channel)]
    unit = 1.0 if estimator.stacked is None else estimator.robot.noise
    return unit * float(rest[~torch.isnan(rest)].square().mean().sqrt())


def tip_positions(
    robot: RobotFile, q: Float[Tensor, "frames n_q"], covariance: Float[Tensor, "frames n_q n_q"]
) -> tuple[Float[Tensor, "frames 3"], Float[Tensor, "frames 3 3"]]:
    """Positions of the tip in the base frame [m] and their covariances [m^2]; NaN where ``q`` is."""
    known = torch.isfinite(q).all(-1)
    tip, J = tip_motion(robot.robot, torch.where(known[:, None], q, 0.0))
    nan = torch.where(known, 0.0, torch.nan).to(q)
    return tip + nan[:, None], J @ covariance @ J.mT + nan[:, None, None]


def errors_of_estimates(robot: RobotFile, truth: Truth, tracks: list[Tracked]) -> pd.DataFrame:
    """Errors and consistency of all estimates.

    Rows are the coordinates, the whole configuration and the tip. Columns: ``model, estimator, quantity, unit``; the
    ``mean``, ``rmse``, ``p95`` and ``largest`` distance from the measured pose; ``percent_of_length``, the mean in
    per cent of the length of the robot; ``coverage``, the share of frames in which the 95 % ellipsoid of estimate
    and measured pose together holds the difference, and ``coverage_alone`` that of the estimate alone; ``nees``, the
    normalised squared error by both, per dimension (near 1 if both uncertainties are right); ``frames``.
    """
    return pd.DataFrame([row for track in tracks for row in _rows(robot, truth, track)])


def _rows(robot: RobotFile, truth: Truth, track: Tracked) -> Iterator[dict[str, str | float]]:
    use = truth.known & torch.isfinite(track.q).all(-1)
    difference, P, R = (track.q - truth.q)[use], track.covariance[use], truth.covariance[use]
    head = {"model": track.model, "estimator": track.estimator}
    to_percent = 100.0 / robot.robot.length
    for k, (name, factor) in enumerate(coordinate_columns(robot).items()):
        one = slice(k, k + 1)
        quantity, unit = name.rsplit("_", 1)
        percent = to_percent if unit == "mm" else None
        yield (
            head
            | {"quantity": quantity, "unit": unit}
            | _distances(difference[:, k].abs().numpy(), factor, percent)
            | _consistency(difference[:, one], P[:, one, one], R[:, one, one])
        )
    yield head | {"quantity": "configuration", "unit": ""} | _consistency(difference, P, R)
    tip, tip_covariance = tip_positions(robot, track.q, track.covariance)
    away = (tip - truth.tip)[use]
    yield (
        head
        | {"quantity": "tip", "unit": "mm"}
        | _distances(torch.linalg.vector_norm(away, dim=-1).numpy(), 1e-3, to_percent)
        | _consistency(away, tip_covariance[use], truth.tip_covariance[use])
    )


@dataclass(frozen=True)
class TipBand:
    """By how much the ellipsoid that an estimator states of the tip has to grow to hold.

    Parameters
    ----------
    level
        How often it is to hold.
    grown
        Times its semi-axes, from the first half of the judged frames; infinite where that is too short.
    held, held_as_stated
        Shares of the second half that the grown and the stated ellipsoid hold.
    """

    level: float
    grown: float
    held: float
    held_as_stated: float

    @property
    def least_s(self) -> float:
        """How long each half must be to say [s]."""
        return _BLOCK_S * self.level / (1 - self.level)


def tip_band(robot: RobotFile, truth: Truth, track: Tracked, time_s: Float[np.ndarray, " frames"]) -> TipBand:
    """Return the conformal band of the tip: grown by the first half of the frames, judged on the second."""
    use = truth.known & torch.isfinite(track.q).all(-1)
    if not use.any():
        return TipBand(_HELD, np.inf, np.nan, np.nan)
    tip, covariance = tip_positions(robot, track.q, track.covariance)
    scores = (_normalised((tip - truth.tip)[use], covariance[use]) / chi2.ppf(_HELD, 3)).sqrt().numpy()
    times = time_s[use.numpy()]
    early = times < (times[0] + times[-1]) / 2
    grown = conformal_factor(scores[early], _HELD, block_weights(times[early], _BLOCK_S))
    late = scores[~early]
    return TipBand(_HELD, grown, float((late <= grown).mean()), float((late <= 1.0).mean()))


def _distances(distance: np.ndarray, factor: float, to_percent: float | None) -> dict[str, float]:
    x = distance / factor
    found = {
        "mean": x.mean(),
        "rmse": np.sqrt((x**2).mean()),
        "p95": np.quantile(x, 0.95),
        "largest": x.max(),
        "percent_of_length": np.nan if to_percent is None else to_percent * distance.mean(),
    }
    return {name: float(value) for name, value in found.items()}


def _consistency(difference: Tensor, P: Tensor, R: Tensor) -> dict[str, float]:
    n, limit = difference.shape[-1], float(chi2.ppf(_COVERED, difference.shape[-1]))
    both, alone = _normalised(difference, P + R), _normalised(difference, P)
    return {
        "coverage": float((both <= limit).double().mean()),
        "coverage_alone": float((alone <= limit).double().mean()),
        "nees": float(both.mean()) / n,
        "frames": len(difference),
    }


def _normalised(difference: Tensor, C: Tensor) -> Tensor:
    """Squared errors in units of a covariance, which is singular where a robot has fewer coordinates than its tip."""
    return torch.einsum("fi,fij,fj->f", difference, torch.linalg.pinv(C, hermitian=True), difference)
