"""Shape sensing of soft robots: describe a robot, predict its readings, estimate its shape.

A robot is a chain of segments with magnets, sensors and IMUs on it::

    Robot                                      segments in series, and what is mounted on them
    ConstantCurvature, AffineCurvature         soft segments
    Link, BallJoint, FreeBody                  rigid pieces, joints, bodies that are not attached
    Magnet, Ring, Disc, Cube                   magnets and their fields
    Sensor, Imu                                magnetic sensors with one axis or three; orientation sensors
    simulated_readings                         what they read, by magpylib
    load_robot, example                        a robot in a file, and the folder of an example

A sensor model is any callable from a configuration q to readings u::

    Sensing                                    magnets by their multipoles or by a trained network, and IMUs
    BendSensor                                 one cube over one three-axis sensor, Mitchell et al. 2021

An estimator takes readings one time step after the other and returns q, how sure it is, and how well they fit::

    track, smooth                              an estimator over recorded readings; a Kalman filter and back
    GradientDescent                            Baaij et al. 2023
    LevenbergMarquardt                         least squares within bounds, with a covariance
    KalmanFilter                               the same, with what the readings before say
    ParticleFilter                             Mitchell et al. 2021
    rigid_body, pcc_extended, Arm              Martin et al. 2022: positions along an arm from orientations of IMUs
    exact_arcs                                 the same with arcs, ours
    Drift, Drifting                            errors of sensors that wander, estimated on the way
    calibrate                                  a robot that is not as drawn, from readings in measured poses
    calibrate_imus, calibrated                 headings and mountings of IMUs, from motion capture
    fit_shape, Rig                             configurations from motion capture of bodies or markers

Lengths are metres, angles radians, times seconds, flux densities millitesla. Arrays, lists and data frames are
taken, arrays are returned; leading dimensions are a batch. What cannot be used is refused by an ``InputError`` that
says what was expected and what came instead. Beside these names there are a rod seen by poses, orientations and
gyroscopes at any time (``repro.estimators.rod``), trained networks without torch, and torch modules
(``repro.networks``).
"""

from __future__ import annotations

TYPE_CHECKING = False  # the one of typing takes five times as long to import as all else here

if TYPE_CHECKING:
    from typing import Any

    from repro.chain import (
        AffineCurvature as AffineCurvature,
        BallJoint as BallJoint,
        ConstantCurvature as ConstantCurvature,
        FreeBody as FreeBody,
        Link as Link,
    )
    from repro.common import (
        InputError as InputError,
    )
    from repro.estimators.calibration import (
        calibrate as calibrate,
    )
    from repro.estimators.drift import (
        Drift as Drift,
        Drifting as Drifting,
    )
    from repro.estimators.fit_shape import (
        Rig as Rig,
        fit_shape as fit_shape,
    )
    from repro.estimators.gradient_descent import (
        GradientDescent as GradientDescent,
    )
    from repro.estimators.imu import (
        Arm as Arm,
        calibrate_imus as calibrate_imus,
        calibrated as calibrated,
        exact_arcs as exact_arcs,
        pcc_extended as pcc_extended,
        rigid_body as rigid_body,
    )
    from repro.estimators.kalman import (
        KalmanFilter as KalmanFilter,
    )
    from repro.estimators.least_squares import (
        LevenbergMarquardt as LevenbergMarquardt,
    )
    from repro.estimators.particle import (
        ParticleFilter as ParticleFilter,
    )
    from repro.estimators.track import (
        smooth as smooth,
        track as track,
    )
    from repro.magnets import (
        Cube as Cube,
        Disc as Disc,
        Magnet as Magnet,
        Ring as Ring,
        simulated_readings as simulated_readings,
    )
    from repro.parts import (
        Imu as Imu,
        Sensor as Sensor,
    )
    from repro.robot import (
        Robot as Robot,
    )
    from repro.robot_file import (
        example as example,
        load_robot as load_robot,
    )
    from repro.sensing import (
        BendSensor as BendSensor,
        Sensing as Sensing,
    )

__version__ = "1.1.0"

_HOMES = {
    "chain": "AffineCurvature BallJoint ConstantCurvature FreeBody Link",
    "common": "InputError",
    "estimators.calibration": "calibrate",
    "estimators.drift": "Drift Drifting",
    "estimators.fit_shape": "Rig fit_shape",
    "estimators.gradient_descent": "GradientDescent",
    "estimators.imu": "Arm calibrate_imus calibrated exact_arcs pcc_extended rigid_body",
    "estimators.kalman": "KalmanFilter",
    "estimators.least_squares": "LevenbergMarquardt",
    "estimators.particle": "ParticleFilter",
    "estimators.track": "smooth track",
    "magnets": "Cube Disc Magnet Ring simulated_readings",
    "parts": "Imu Sensor",
    "robot": "Robot",
    "robot_file": "example load_robot",
    "sensing": "BendSensor Sensing",
}
_HOME_OF = {name: module for module, names in _HOMES.items() for name in names.split()}

__all__ = list(_HOME_OF)  # pyright: ignore[reportUnsupportedDunderAll]


def __getattr__(name: str) -> Any:
    """Import a public name when it is first used: ``import repro`` alone takes no time."""
    if name not in _HOME_OF:
        raise AttributeError(f"module 'repro' has no attribute {name!r}")
    from importlib import import_module

    found = getattr(import_module(f"repro.{_HOME_OF[name]}"), name)
    globals()[name] = found
    return found


def __dir__() -> list[str]:
    """List what there is."""
    return sorted({*globals(), *__all__})
