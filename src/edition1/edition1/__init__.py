"""Shape sensing of soft continuum robots: a robot, its sensors, and the shape from their readings.

A robot is a chain of segments with magnets, sensors and IMUs on it::

    load_robot, RobotFile              a robot in a file
    Robot                              segments in series, and what is mounted on them
    ConstantCurvature, AffineCurvature a segment: configuration q -> poses along its backbone
    StrainSeries                       a whole rod by a short series of curvatures
    magnet_mounts, sensor_mounts       where magnets and sensors sit

A sensor model is any callable q -> readings u::

    Ring, Cube                         magnets, their fields and multipoles
    readings                           simulated readings, by magpylib
    LinearisedSensing                  readings from multipoles, with their derivatives
    MagneticSensing                    relations between sensors and magnets, then a model: a network, a closed form
    relations                          these relations
    paper_network, train_paper         the network of Baaij et al. 2023, and its training
    BendSensor                         one magnet over one three-axis sensor, Mitchell et al. 2021
    compiled                           the same model, many times faster

An estimator takes readings, one time step after the other, and says which q, how sure, and whether they fit::

    Estimator, Estimate                what every estimator is, and what it says
    track, Trajectory                  an estimator along recorded readings
    GradientDescent                    Baaij et al. 2023
    ParticleFilter                     Mitchell et al. 2021
    ImuShape, rigid_body, pcc_extended Martin et al. 2022: positions from orientations
    LevenbergMarquardt                 least squares within bounds, with a covariance
    IteratedKalmanFilter               the same, with what the readings before say
    SelfCalibratingFilter, Wander      the same, with errors of its sensors that wander and are found on the way
    RodFilter, RodSensor               a rod from poses, orientations, gyroscopes and models, at any time
    smooth                             a Kalman filter over a recording, and back
    calibrate                          a robot that is not as drawn, from poses and readings
    Monitored                          any estimator, watched for sensors that fail

Lengths are metres, angles radians, times seconds, flux densities millitesla; tensors have any leading batch
dimensions. What cannot be used is refused by an InputError that says what was expected and what came instead.
"""

from __future__ import annotations

from importlib import import_module
from typing import Any

__version__ = "0.1.0"

_HOMES = {
    "load_robot": "robot_file.load",
    "RobotFile": "robot_file.robot_file",
    "Robot": "kinematics.robot",
    "ConstantCurvature": "kinematics.constant_curvature",
    "AffineCurvature": "kinematics.affine_curvature",
    "StrainSeries": "kinematics.strain_series",
    "magnet_mounts": "kinematics.mounts",
    "sensor_mounts": "kinematics.mounts",
    "Ring": "sensing.magnets",
    "Cube": "sensing.magnets",
    "readings": "sensing.magnetic",
    "LinearisedSensing": "sensing.linearised",
    "MagneticSensing": "sensing.magnetic",
    "relations": "sensing.relations",
    "paper_network": "sensing.network",
    "train_paper": "sensing.training",
    "BendSensor": "sensing.bend_sensor",
    "compiled": "kernels",
    "Estimator": "estimation.base",
    "Estimate": "estimation.base",
    "track": "estimation.base",
    "Trajectory": "estimation.base",
    "GradientDescent": "estimation.gradient_descent",
    "ParticleFilter": "estimation.particle_filter",
    "ImuShape": "estimation.imu_shape",
    "rigid_body": "estimation.imu_chain",
    "pcc_extended": "estimation.imu_models",
    "LevenbergMarquardt": "estimation.levenberg_marquardt",
    "IteratedKalmanFilter": "estimation.kalman_filter",
    "SelfCalibratingFilter": "estimation.self_calibration",
    "Wander": "estimation.wander",
    "RodFilter": "estimation.rod_filter",
    "RodSensor": "estimation.rod_sensors",
    "smooth": "estimation.smoothing",
    "calibrate": "estimation.calibration",
    "Monitored": "estimation.monitor",
    "InputError": "errors",
}
"""Where each name is defined. It is imported when it is first used: the rest of the package loads no torch for it."""

__all__ = list(_HOMES)  # pyright: ignore[reportUnsupportedDunderAll]


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module 'edition1' has no attribute {name!r}")
    found = getattr(import_module(f"edition1.{_HOMES[name]}"), name)
    globals()[name] = found
    return found


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
