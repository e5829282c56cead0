"""What is drawn and measured of robots that are not as drawn, and that calibration knows nothing but that."""

import math

import pytest
import torch

from edition1.errors import InputError
from edition1.estimation.levenberg_marquardt import LevenbergMarquardt
from edition1.kinematics.paper_robots import pcc_robot
from edition1.sensing.linearised import LinearisedSensing
from edition1.sensing.magnetic import readings
from edition1.sensing.magnets import ring
from edition1_companion.twins.calibrated_robots import box, calibration, least_squares, session, start
from edition1_companion.twins.calibration_session import Config, draw_session, released_moments
from edition1_companion.twins.table_1_rows import ROWS
from edition1_companion.twins.trajectories import lemniscate

NOISE_MT = 3.55 / 5000
"""Noise of a real sensor: 3.55 mV (Baaij et al. 2023, section 5.2) at 5000 mV/mT [mT]."""
BY_NAME = {row.name: row for row in ROWS}
ONE, FEW = BY_NAME["n_b=1"], Config(draws=2)


@pytest.fixture(scope="module")
def many():
    """Two hundred robots of one segment in two calibration poses, and three steps of the trajectory."""
    config = Config(draws=200, poses=2)
    return draw_session(pcc_robot(1), lemniscate(1)[:3], box(1), config), config


def same_size(values, expected):
    """Standard deviation of white noise within four of its own errors, its mean as well."""
    n = values.numel()
    assert float(values.std()) == pytest.approx(expected, rel=4 / math.sqrt(2 * n))
    assert abs(float(values.mean())) < 4 * expected / math.sqrt(n)


def test_readings_are_those_of_the_true_robot_and_noise_of_its_size(many):
    """On the trajectory that is judged: 1800 numbers, so 7 % is four errors of a standard deviation."""
    drawn, _ = many
    without = readings(drawn.true_robot, drawn.q.unsqueeze(1), ring("released"))
    same_size(drawn.readings - without, NOISE_MT)


def test_calibration_readings_have_noise_of_their_own():
    """Two poses at one place: what differs is noise alone, of variance 2 sigma^2, and not that of the trajectory."""
    q = torch.tensor([[2e-3, -1e-3, 3e-3]], dtype=torch.float64)
    config = Config(draws=300, poses=2)
    drawn = draw_session(pcc_robot(1), q, (q[0], q[0]), config)
    same_size(drawn.pose_readings[:, 0] - drawn.pose_readings[:, 1], math.sqrt(2) * NOISE_MT)
    same_size(drawn.readings[0] - drawn.pose_readings[:, 0], math.sqrt(2) * NOISE_MT)


def test_measured_poses_scatter_as_stated():
    """One pose in every draw: positions by 0.2 mm along, rotations by 0.2 degrees about, each axis."""
    q = torch.tensor([[2e-3, -1e-3, 3e-3]], dtype=torch.float64)
    robot = pcc_robot(1)
    drawn = draw_session(robot, q, (q[0], q[0]), Config(draws=300, poses=2))
    T, tip = drawn.poses.flatten(0, -3), robot.base_poses(q)[0, -1]
    for axis in range(3):
        same_size(T[:, axis, 3] - tip[axis, 3], 0.2e-3)
    turn = tip[:3, :3].mT @ T[:, :3, :3]
    for i, j in ((2, 1), (0, 2), (1, 0)):
        same_size((turn[:, i, j] - turn[:, j, i]) / 2, math.radians(0.2))


def test_parts_are_off_within_their_limits_and_reach_them(many):
    """Uniform within the limits: of 200 draws the largest is above 95 % of its limit, but for one chance in 28,000.

    Limits: 0.5 mm and 2 degrees for a magnet; 1 % of a turn and 1 % of the radius for a sensor (the text on the page
    of the best figures). Sensors keep their tilt, and so their direction within their own plane.
    """
    robot, true = pcc_robot(1), many[0].true_robot
    off = true.magnets.local[..., :3, 3] - robot.magnets.local[..., :3, 3]
    axis = true.magnets.local[..., :3, 2]
    tilt = torch.asin(axis[..., :2])  # about y and about x; each is small, so their order hardly matters
    position = true.sensors.local[..., :2, 3]
    drawn = robot.sensors.local[:, :2, 3]
    azimuth = torch.atan2(position[..., 1], position[..., 0]) - torch.atan2(drawn[:, 1], drawn[:, 0])
    azimuth = torch.atan2(azimuth.sin(), azimuth.cos())
    radius = position.norm(dim=-1) / drawn.norm(dim=-1) - 1
    limits = ((off, 0.5e-3), (tilt, math.radians(2)), (azimuth, 0.02 * math.pi), (radius, 0.01))
    for values, limit in limits:
        reached = values.abs().flatten(0, -2).amax(0)
        assert bool((reached > 0.95 * limit).all())
        assert bool((reached < (1 + 1e-3) * limit).all())
        assert abs(float(values.mean())) < 4 * limit / math.sqrt(3 * values.numel())
    assert float(true.sensors.local[..., 2, 2].add(1).abs().max()) < 1e-12


def test_start_is_straight_at_mid_elongation():
    """The lemniscate of the paper elongates by 0 to 5.5 mm: its middle is 2.75 mm, and straight is no bending."""
    assert start(2).tolist() == [0.0, 0.0, 2.75e-3] * 2


def test_every_estimate_is_a_step_from_the_straight_pose():
    """One iteration is far from converged, so it shows where it began: that of an estimator started straight."""
    measured, model = session(ONE, FEW), LinearisedSensing(pcc_robot(1), released_moments())
    low = torch.tensor([-20.73e-3, -20.73e-3, 0.0], dtype=torch.float64)
    high = torch.tensor([20.73e-3, 20.73e-3, 6.6e-3], dtype=torch.float64)
    method = LevenbergMarquardt(model, low, high, noise_mt=NOISE_MT, iterations=1)
    straight = torch.tensor([0.0, 0.0, 2.75e-3], dtype=torch.float64)
    expected = method.step(method.init(straight.expand(400, 2, 3)), measured.readings, 0.0)[1].q
    found = least_squares(model, measured.readings, 1, noise_mt=NOISE_MT, iterations=1).q
    torch.testing.assert_close(found, expected, rtol=0, atol=1e-5)  # bounds are rounded here
    assert float((found - measured.q.unsqueeze(1)).abs().max()) > 1e-4


def test_draws_do_not_depend_on_their_number():
    one, two = session(ONE, Config(draws=1)), session(ONE, FEW)
    torch.testing.assert_close(one.readings[:, 0], two.readings[:, 0])
    assert not torch.equal(session(ONE, Config(draws=1, seed=1)).readings, one.readings)


def test_the_true_robot_does_not_reach_the_calibration():
    """The calibrated robot is near the true one, yet depends on nothing but poses and readings."""
    measured = session(ONE, FEW)
    found = calibration(ONE, measured, FEW)
    unknown = torch.empty(0, 3, dtype=torch.float64), torch.empty(0, 2, 3, dtype=torch.float64)
    blind = type(measured)(ONE.robot(), measured.poses, measured.pose_readings, *unknown)
    assert torch.equal(found.estimate, calibration(ONE, blind, FEW).estimate)
    offset = measured.true_robot.magnets.local - ONE.robot().magnets.local
    left = measured.true_robot.magnets.local - found.robot.magnets.local
    assert float(left[..., :2, 3].norm()) < 0.5 * float(offset[..., :2, 3].norm())


def test_earth_field_is_known_to_the_estimator():
    row = BY_NAME["n_e=(0,0,1)"]
    measured = session(row, Config(draws=1))
    sensing = calibration(row, measured, Config(draws=1)).sensing(row.earth_mt())
    error = sensing(measured.q.unsqueeze(1)) - measured.readings
    assert float(error.square().mean().sqrt()) < 3e-3
    without = LinearisedSensing(sensing.robot, sensing.moments, sensing.gain)(measured.q.unsqueeze(1))
    assert float((without - measured.readings).square().mean().sqrt()) > 0.03


def test_bad_input():
    with pytest.raises(
        InputError, match=r"draws, poses of Config must be at least 1; instead received \(0, 100\)"
    ):
        Config(draws=0)
