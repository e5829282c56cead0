"""Sensor models from the first part of a recording: a calibration of the robot, or networks for its readings."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from edition1.errors import bad_input, require
from edition1.estimation.levenberg_marquardt import LevenbergMarquardt
from edition1.estimation.model_error import WhiteError
from edition1.kernels import compiled
from edition1.robot_file.calibration_file import RobotCalibration
from edition1.robot_file.robot_file import RobotFile
from edition1.sensing.fast_training import epochs_of_steps, train_fast
from edition1.sensing.magnetic import MagneticSensing
from edition1.sensing.network import CosineNetwork, PerSensor
from edition1.sensing.relations import relations
from edition1_live.follow.robot_estimator import RobotEstimator, monitored, robot_estimator
from edition1_live.robot.calibrate import calibrate
from edition1_live.robot.calibration_poses import farthest_points

LEAST_S = 5.0
"""Shortest time with poses for each of the two parts [s]."""
_APART_S = 1.0
"""Time between the two parts, which belongs to neither [s]."""
_POSES = 100
"""Most poses that a robot is calibrated with."""
_LEAST_POSES = 20


@dataclass(frozen=True)
class TimeParts:
    """What a robot is calibrated with, and what it is judged on.

    Parameters
    ----------
    first
        Readings with a pose in the first part.
    rest
        All readings of the second part.
    first_s, rest_s
        Beginning and end of the two by the clock of the readings [s].
    """

    first: Bool[np.ndarray, " readings"]
    rest: Bool[np.ndarray, " readings"]
    first_s: tuple[float, float]
    rest_s: tuple[float, float]


def split_in_time(
    time_s: Float[np.ndarray, " readings"], known: Bool[np.ndarray, " readings"], share: float
) -> TimeParts:
    """Split the time over which poses are known: a share first, a gap of one second, the rest.

    Parameters
    ----------
    time_s
        Of the readings [s].
    known
        At which of them there is a pose.
    share
        Of the first part.

    Raises
    ------
    InputError
        If a part is shorter than :data:`LEAST_S`, or has too few readings with a pose.
    """
    require(0 < share < 1, "share", "repro fit", "between 0 and 1", share)
    require(known.any(), "readings and poses", "repro fit", "of one time", "no reading with a pose")
    start, end = float(time_s[known][0]), float(time_s[known][-1])
    border = start + share * (end - start)
    lengths = border - start, end - border - _APART_S
    if min(lengths) < LEAST_S:
        expected = f"of {LEAST_S:g} s to calibrate with and {LEAST_S:g} s to judge, {_APART_S:g} s apart"
        seen = f"{end - start:.1f} s in common, a share of {share:g} to calibrate with"
        raise bad_input("readings and poses", "repro fit", expected, seen)
    first = known & (time_s <= border)
    rest = (time_s >= border + _APART_S) & (time_s <= end)
    for words, chosen in (("the first part", first), ("the rest", rest & known)):
        if chosen.sum() < _LEAST_POSES:
            expected = f"at least {_LEAST_POSES} readings with a pose in {words}"
            raise bad_input("readings and poses", "repro fit", expected, int(chosen.sum()))
    return TimeParts(first, rest, (start, border), (border + _APART_S, end))


def spread(robot: RobotFile, q: Float[Tensor, "poses n_q"]) -> Int[Tensor, " chosen"]:
    """Indices of poses that spread, in order: each next one is the farthest from those chosen before.

    Distances are in widths of the bounds; the first is the one nearest to the mean.
    """
    x = q / (robot.upper - robot.lower)
    first = (x - x.mean(0)).square().sum(-1).argmin()
    return torch.cat([first[None], farthest_points(x, x[first], min(_POSES, len(q)) - 1)]).sort().values


TRACKERS = ("levenberg_marquardt", "kalman")
"""Estimators that are judged, by their names in :data:`edition1_live.follow.robot_estimator.ESTIMATORS`."""
_OUTLIER = 6.0
"""Poses whose readings a first fit misses by this many times the median are left out of the second."""
TRAINING_STEPS = 2000
"""Least number of steps of a training."""
_LEAST_ROWS = 500


@dataclass(frozen=True)
class Networks:
    """Networks trained on readings, one for each sensor.

    Parameters
    ----------
    networks
        From relations as cosines, of the robot as described, to readings without offset [unit].
    rmse
        Root mean square error on rows that they were not trained on [unit].
    """

    networks: tuple[CosineNetwork, ...]
    rmse: tuple[float, ...]

    def sensing(self, robot: RobotFile) -> MagneticSensing:
        """Sensor model of an estimator: configuration to readings without offset [unit]."""
        model = PerSensor(list(self.networks), range(len(self.networks))).double()
        return MagneticSensing(robot.robot, model, earth_axis=earth_axis(robot))

    def estimator(self, robot: RobotFile, name: str) -> RobotEstimator:
        """Return one of :data:`TRACKERS` with the networks for a sensor model, and their error beside the noise."""
        robot = replace(robot, error=WhiteError(torch.tensor(self.rmse, dtype=torch.float64)))
        sensing = compiled(self.sensing(robot))
        solver = LevenbergMarquardt(sensing, robot.lower, robot.upper, noise_mt=robot.noise)
        return replace(robot_estimator(robot, name), method=monitored(robot, name, solver))


def earth_axis(robot: RobotFile) -> Float[Tensor, " 3"] | None:
    """Direction of the Earth field in the base frame; none if there is none."""
    size = float(torch.linalg.vector_norm(robot.earth_mt))
    return robot.earth_mt / size if size else None


def calibrated(
    robot: RobotFile,
    values: Float[Tensor, "readings channels"],
    q: Float[Tensor, "readings n_q"],
    covariance: Float[Tensor, "readings n_q n_q"],
) -> tuple[RobotCalibration, int]:
    """Calibrate with poses that spread, again without outliers; return also how many of these there were."""
    chosen = spread(robot, q)
    found = calibrate(robot, values[chosen], q[chosen], covariance[chosen])
    model = robot.calibrated(found)
    rest = values[:, list(robot.channel)] - model.offset - model.sensing()(q)
    size = rest.square().mean(-1).sqrt()
    out = size > _OUTLIER * size.median()
    if not bool(out[chosen].any()):
        return found, int(out.sum())
    q, values, covariance = q[~out], values[~out], covariance[~out]
    chosen = spread(robot, q)
    return calibrate(robot, values[chosen], q[chosen], covariance[chosen]), int(out.sum())


def trained(
    robot: RobotFile, u: Float[Tensor, "readings s"], q: Float[Tensor, "readings n_q"], seed: int
) -> Networks:
    """Train a small network for every sensor.

    Parameters
    ----------
    robot
        As described.
    u
        Readings without offset [unit].
    q
        Measured configurations.
    seed
        Of initial weights, batches and the 30 % of the rows that are kept to tell the error.

    Raises
    ------
    InputError
        If there are fewer than 500 rows.
    """
    if len(q) < _LEAST_ROWS:
        raise bad_input("readings", "repro fit", f"at least {_LEAST_ROWS} with a pose to train on", len(q))
    xi = relations(robot.robot, q, earth_axis(robot)).cosines()
    epochs = epochs_of_steps(TRAINING_STEPS, len(q))
    networks, errors = [], []
    for j in range(u.shape[-1]):
        network, metrics = train_fast(xi[:, j], u[:, j], seed=seed, epochs=epochs, progress=False)
        networks.append(network)
        errors.append(metrics["rmse_validation"])
    return Networks(tuple(networks), tuple(errors))
