"""Sensor models from the first part of a recording: a calibration of the robot, or networks for its readings."""

from __future__ import annotations

from dataclasses import dataclass, replace

import torch
from jaxtyping import Float
from torch import Tensor

from repro.errors import bad_input
from repro.estimation.levenberg_marquardt import LevenbergMarquardt
from repro.kernels import compiled
from repro.robot_file.calibration_file import RobotCalibration
from repro.robot_file.reading_errors import WhiteError
from repro.robot_file.robot_file import RobotFile
from repro.sensing.fast_training import BATCH, train_fast
from repro.sensing.magnetic import MagneticSensing
from repro.sensing.network import CosineNetwork, PerSensor
from repro.sensing.relations import relations
from repro_live.follow.robot_estimator import RobotEstimator, monitored, robot_estimator
from repro_live.own.parts import spread
from repro_live.robot.calibrate import calibrate

TRACKERS = ("levenberg_marquardt", "kalman")
"""Estimators that are judged, by their names in :data:`repro_live.follow.robot_estimator.ESTIMATORS`."""
OUTLIER = 6.0
"""Poses whose readings a first fit misses by this many times the median are left out of the second."""
TRAINING_STEPS = 2000
"""Least number of steps of a training."""
LEAST_ROWS = 500


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
    out = size > OUTLIER * size.median()
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
    if len(q) < LEAST_ROWS:
        raise bad_input("readings", "repro fit", f"at least {LEAST_ROWS} with a pose to train on", len(q))
    xi = relations(robot.robot, q, earth_axis(robot)).cosines()
    epochs = -(-TRAINING_STEPS // -(-7 * len(q) // (10 * BATCH)))
    networks, errors = [], []
    for j in range(u.shape[-1]):
        network, metrics = train_fast(xi[:, j], u[:, j], seed=seed, epochs=epochs, progress=False)
        networks.append(network)
        errors.append(metrics["rmse_validation"])
    return Networks(tuple(networks), tuple(errors))
