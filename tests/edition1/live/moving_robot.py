"""Readings of a described robot that moves through its configuration space, for the tests."""

import math

import numpy as np

from edition1_live.emulate.robot_readings import RobotReadings, course, readings_along, true_robot


def robot_readings(
    robot, *, duration_s=20.0, start_s=0.0, rate_hz=None, tolerances=0.0, seed=0
) -> RobotReadings:
    """Parts of one seed belong to one motion of one robot; only their noise depends on where a part begins."""
    rate_hz = rate_hz or robot.rate_hz
    first, last = math.ceil(start_s * rate_hz - 1e-6), math.ceil((start_s + duration_s) * rate_hz - 1e-6)
    time_s = np.arange(first, last) / rate_hz
    rng = np.random.default_rng([seed, 2, first])
    built = true_robot(robot, tolerances, seed=seed)
    return readings_along(built, time_s, course(robot, time_s, seed=seed), rng=rng)
