"""The curves of eqs (5)-(7) and their synthetic readings."""

import math

import pytest
import torch

from edition1.kinematics.bend import bend_angle_and_direction
from edition1.sensing.bend_sensor import BendSensor
from edition1_companion.twins.bend_curves import CURVES, bend_curve, bend_readings, bend_robot, curve_times


def test_curves_have_the_steps_of_the_paper_and_start_straight():
    t = curve_times()
    assert len(t) == 3142
    assert float(t[-1]) == pytest.approx(31.41)
    for name in CURVES:
        q = bend_curve(name)
        assert q.shape == (3142, 2)
        assert float(q[0].norm()) == 0
        assert float(q.norm(dim=-1).max()) <= 1  # Fig. 4


@pytest.mark.parametrize(
    ("name", "angle", "direction"),
    [
        ("spiral", lambda t: 0.03 * t, lambda t: t),
        ("flower", math.sin, lambda t: (0.1 * t) ** 2),
        ("seagull", lambda t: abs(math.sin(t)), lambda t: math.sin(t) + math.pi / 2),
    ],
)
def test_equations(name, angle, direction):
    for k in (17, 400, 2871):  # at 400 sin t is negative: folded
        t = 0.01 * k
        phi, theta = angle(t), direction(t)
        found, towards = bend_angle_and_direction(bend_curve(name)[k])
        assert float(found) == pytest.approx(abs(phi))
        folded = theta if phi >= 0 else theta + math.pi
        assert math.cos(float(towards) - folded) == pytest.approx(1)


def test_flower_is_smooth_and_seagull_turns_round():
    turns = {name: bend_curve(name).diff(n=2, dim=0).norm(dim=-1).max() for name in CURVES}
    assert float(turns["flower"]) < 3e-4
    assert float(turns["seagull"]) > 1e-2


def test_readings_are_those_of_magpylib_with_white_noise():
    q = bend_curve("spiral")
    clean = bend_readings(q)
    torch.testing.assert_close(clean, BendSensor(15e-3)(q), atol=1e-11, rtol=0)
    noisy = bend_readings(q, noise_mt=0.025, seed=3)
    assert torch.equal(noisy, bend_readings(q, noise_mt=0.025, seed=3))
    noise = noisy - clean
    assert float(noise.std()) == pytest.approx(0.025, rel=0.03)
    assert float(noise.mean()) == pytest.approx(0, abs=0.001)


def test_robot_has_one_cube_and_one_sensor():
    robot = bend_robot(14e-3)
    assert (robot.n_q, len(robot.magnets), len(robot.sensors), robot.length) == (2, 1, 1, 14e-3)
