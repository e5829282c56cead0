"""Calibration from readings in measured poses."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from edition1.estimation.calibration import calibrate as calibrate_1
from edition1.kinematics.paper_robots import pcc_robot
from repro import ConstantCurvature, InputError, Magnet, Robot, Sensing, Sensor, Tolerances, calibrate
from repro.estimators.calibration import _moved, _names, _scale, _slopes

from .robots import RELEASED, paper_robot
from .test_sensing import MOMENTS

EARTH = [0.03, 0.01, -0.04]


def with_chip():
    chip = Sensor(2, 0.11, radial=0.02, azimuth=1.0, axes=3, orientation=[0.5, 0.5, 0.5, 0.5])
    base = Sensor(0, 0.0, position=[0.02, 0.01, -0.01], direction=[1, 1, 3])
    magnets = [Magnet(RELEASED, 1, 0.055), Magnet(RELEASED, 2, 0.05, direction=[0.2, 0, 1])]
    return Robot(
        [ConstantCurvature(0.11, 0.022)] * 2, magnets, [chip, base, Sensor(1, 0.11, radial=0.013, tilt=0.2)]
    )


def test_slopes_by_every_parameter_are_those_of_the_readings():
    drawn, rng = Sensing(with_chip(), earth=EARTH), np.random.default_rng(0)
    scale = _scale(drawn.robot, 5, Tolerances())
    z, q = 0.5 * rng.normal(size=len(scale)), 0.006 * rng.normal(size=(6, 6))
    J = _slopes(drawn, _moved(drawn, z * scale), z * scale, q)
    for k, name in enumerate(_names(drawn.robot, 5)):
        step = 1e-4 * scale * (np.arange(len(scale)) == k)
        central = (_moved(drawn, z * scale + step)(q) - _moved(drawn, z * scale - step)(q)) / (
            2e-4 * scale[k]
        )
        atol = 1e-6 * np.abs(central).max() + 1e-11 / scale[k]
        np.testing.assert_allclose(J[..., k], central, rtol=0, atol=atol, err_msg=name)


def test_agrees_with_the_first_edition():
    robot, rng = paper_robot(2, tilt=0.1), np.random.default_rng(0)
    drawn = Sensing(robot, earth=EARTH)
    scale = _scale(robot, 5, Tolerances())
    truth = _moved(drawn, scale * rng.normal(size=len(scale)))
    q, S = 0.006 * rng.normal(size=(60, 6)), 1e-8 * np.eye(6)
    u = truth(q) + 1e-3 * rng.normal(size=(60, 6))
    found = calibrate(robot, q, u, 1e-3, S, earth=EARTH)
    tensors = (torch.from_numpy(x) for x in (q, S, u, MOMENTS))
    first = calibrate_1(
        pcc_robot(2, 3, tilt=0.1), *tensors, noise_mt=1e-3, earth_mt=torch.tensor(EARTH).double()
    )
    np.testing.assert_allclose(
        found.estimate / found.deviation, first.estimate.numpy() / found.deviation, rtol=0, atol=1e-5
    )
    np.testing.assert_allclose(found.deviation, first.deviation.numpy(), rtol=1e-6)
    assert found.chi2 == pytest.approx(float(first.chi2), rel=1e-6)
    assert found.names == first.names


def test_a_robot_that_is_off_is_found_within_its_deviations():
    drawn, rng = Sensing(with_chip(), earth=EARTH), np.random.default_rng(1)
    scale = _scale(drawn.robot, 5, Tolerances())
    z = rng.normal(size=len(scale))
    truth = _moved(drawn, z * scale)
    q = rng.uniform(-1, 1, (200, 6)) * np.tile([0.02, 0.02, 0.003], 2)
    u = truth(q) + 1e-3 * rng.normal(size=(200, 5))
    found = calibrate(drawn.robot, q, u, 1e-3, earth=EARTH)
    assert (np.abs(found.estimate - z * scale) < 4.5 * found.deviation).all()
    new = 0.5 * q[:50]
    before, after = (np.abs(s(new) - truth(new)).mean() for s in (drawn, found.sensing()))
    assert after < 0.02 * before
    assert found.chi2 == pytest.approx(1.0, abs=0.15)


def test_without_information_the_tolerances_remain():
    robot = paper_robot(1)
    found = calibrate(robot, np.zeros((1, 3)), Sensing(robot)(np.zeros((1, 3))), noise=1e6)
    np.testing.assert_allclose(found.covariance, np.eye(len(found.names)), atol=1e-9)
    np.testing.assert_allclose(found.estimate, 0.0, atol=1e-12)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"q": np.zeros((0, 3))}, "at least one pose"),
        ({"q": np.zeros((4, 2))}, r"q of calibrate must be numbers of shape \(any, 3\)"),
        ({"u": np.zeros((4, 2))}, r"u of calibrate must be numbers of shape \(4, 3\)"),
        ({"u": np.full((4, 3), np.nan)}, "u of calibrate must be finite"),
        ({"noise": -1.0}, "noise of calibrate must be positive"),
        ({"noise": [1.0, 2.0]}, "one number or one for each reading"),
        ({"q_covariance": np.eye(2)}, "q_covariance of calibrate must be numbers of shape"),
        ({"iterations": 0}, "iterations of calibrate must be at least 1"),
        ({"robot": Robot([ConstantCurvature(0.1, 0.02)])}, "one with magnets and sensors"),
    ],
)
def test_what_cannot_be_is_refused_in_words(change, message):
    good = {"robot": paper_robot(1), "q": np.zeros((4, 3)), "u": np.zeros((4, 3)), "noise": 1e-3}
    with pytest.raises(InputError, match=message):
        calibrate(**{**good, **change})
    with pytest.raises(InputError, match="tolerances of Tolerances must be positive"):
        Tolerances(moments=0.0)
