"""Calibration from readings in measured poses."""

from __future__ import annotations

import math
import re
from contextlib import nullcontext
from dataclasses import asdict, replace

import numpy as np
import pandas as pd
import pytest
from scipy.spatial.transform import Rotation

from repro import (
    BallJoint,
    ConstantCurvature,
    Disc,
    FreeBody,
    Imu,
    InputError,
    LevenbergMarquardt,
    Link,
    Magnet,
    Robot,
    Sensing,
    Sensor,
    calibrate,
    example,
    load_robot,
)
from repro.chain import point_on
from repro.estimators.calibration import _judge, _model_error, outside
from repro.tolerances import Tolerances, placed, priors_of, slopes_of

from .robots import RELEASED, bounds, paper_robot

EARTH = [0.03, 0.01, -0.04]
STATED = Tolerances(sensor_offset=0.1, earth=0.05)
FIXED = Tolerances(**dict.fromkeys(list(asdict(Tolerances()))[:8], 1e-9))


def with_chip(**of_chip):
    chip = Sensor(2, 0.07, radial=0.02, azimuth=1.0, axes=3, orientation=[0.5, 0.5, 0.5, 0.5], **of_chip)
    base = Sensor(0, 0.0, position=[0.02, 0.01, -0.01], direction=[1, 1, 3])
    magnets = [Magnet(RELEASED, 1, 0.055), Magnet(RELEASED, 2, 0.05, direction=[0.2, 0, 1])]
    return Robot(
        [ConstantCurvature(0.11, 0.022)] * 2, magnets, [chip, base, Sensor(1, 0.11, radial=0.013, tilt=0.2)]
    )


def off(robot, rng, tolerances=None, size=1.0):
    """Parameters drawn from their tolerances, by name."""
    priors = priors_of(robot, tolerances or Tolerances())
    return {name: size * std * rng.normal() for name, std in priors.items()}


def shapes(n, rng, n_b=2):
    return rng.uniform(-1, 1, (n, 3 * n_b)) * np.tile([0.02, 0.02, 0.003], n_b)


def test_slopes_by_every_parameter_are_those_of_the_readings():
    stated = {"position": 3e-4, "offset": 0.1, "gain": 0.02, "tilt": 0.02, "azimuth": 0.02, "radius": 2e-4}
    robot, rng = with_chip(tolerance=stated, gain=[1.1, 0.9, 1.0], offset=0.2), np.random.default_rng(0)
    robot = robot.replaced(earth=EARTH, moments=Sensing(robot).moments)
    of_magnet = {"at": 1e-3, "size": 2e-4, "polarisation": 0.05}
    robot = robot.replaced(
        magnets=[replace(part, tolerance=of_magnet) for part in robot.magnets],
        sensors=[*robot.sensors[:2], replace(robot.sensors[2], tolerance={"at": 1e-3})],
    )
    scale = np.array(list(priors_of(robot, STATED).values()))
    there, q = off(robot, rng, STATED, 0.5), shapes(6, rng)
    J = slopes_of(robot, placed(robot, there).sensing(), there, q)
    wanted = {
        "sensor 1 tilt about x",
        "sensor 1 tilt about z",
        "sensor 1 y",
        "sensor 1 gain z",
        "sensor 1 offset x",
    }
    wanted |= {
        "magnet 1 along",
        "magnet 2 height",
        "magnet 1 polarisation",
        "sensor 2 offset",
        "sensor 3 along",
    }
    assert wanted | {"Earth field along y", "moment A9"} <= there.keys()
    for k, name in enumerate(there):
        h = 1e-4 * scale[k]
        up, down = (placed(robot, {**there, name: there[name] + x}).sensing()(q) for x in (h, -h))
        central = (up - down) / (2 * h)
        atol = 1e-6 * np.abs(central).max() + 1e-11 / scale[k]
        np.testing.assert_allclose(J[..., k], central, rtol=0, atol=atol, err_msg=name)


def test_links_and_a_base_that_are_off_are_found_where_they_state_a_tolerance():
    """The base is turned by 3 degrees, and a link ends 2 mm aside; without tolerances both would bend the robot."""
    base = Link(0.0, orientation=[0.0, 0.0, 0.6, 0.8], tolerance={"tilt": 0.05})
    elbow = Link(0.03, offset=[0.01, 0.0, 0.0], tolerance={"offset": 2e-3})
    segments = [base, ConstantCurvature(0.11, 0.022), elbow]
    chips = [Sensor(g, at, position=[0.02, 0.01, 0.0], axes=3) for g, at in ((0, 0.0), (2, 0.09), (3, 0.03))]
    magnets = [Magnet(RELEASED, 2, 0.055), Magnet(RELEASED, 3, 0.0), Magnet(RELEASED, 1, 0.0, [1, 0, 0])]
    robot, rng = Robot(segments, magnets, chips), np.random.default_rng(0)
    true = {f"segment 1 tilt about {x}": angle for x, angle in zip("xyz", [0.05, -0.02, 0.03], strict=True)}
    true |= {f"segment 3 {x}": off for x, off in zip("xyz", [2e-3, -1e-3, 5e-4], strict=True)}
    truth, q = placed(robot, true), shapes(60, rng, 1)
    ends = [point_on(2, 0.0), point_on(3, 0.03)]
    straight = truth.poses([0.0, 0.0, 0.0], ends)
    expected = Rotation.from_quat([0, 0, 0.6, 0.8]) * Rotation.from_rotvec([0.05, -0.02, 0.03])
    np.testing.assert_allclose(straight[0, :3, :3], expected.as_matrix(), atol=1e-14)
    np.testing.assert_allclose(
        straight[1, :3, 3], expected.apply([0.012, -1e-3, 0.11 + 0.03 + 5e-4]), atol=1e-14
    )
    found = calibrate(robot, q, truth.sensing()(q) + 1e-3 * rng.normal(size=(60, 9)), 1e-3, tolerances=FIXED)
    errors = {
        name: value - true.get(name, 0.0) for name, value in zip(found.names, found.estimate, strict=True)
    }
    for name, std in zip(found.names, found.deviation, strict=True):
        assert abs(errors[name]) < 4.5 * std
    assert max(abs(errors[name]) for name in true) < 2e-4
    np.testing.assert_allclose(found.robot.poses(q, ends), truth.poses(q, ends), atol=5e-4)
    assert not [
        name
        for name in priors_of(robot.replaced(segments=[Link(0.0), *segments[1:]]), FIXED)
        if "segment 1" in name
    ]


def test_a_chip_turns_about_its_own_axes_and_about_the_backbone():
    robot, turn = with_chip(), Rotation.from_euler("z", 0.1).as_matrix()
    old = robot.sensors[0].place
    for name, expected in (
        ("tilt about z", old.rotation @ turn),
        ("tilt about x", old.rotation @ Rotation.from_euler("x", 0.1).as_matrix()),
        ("tilt", old.rotation @ Rotation.from_euler("y", -0.1).as_matrix()),
        ("azimuth", turn @ old.rotation),
    ):
        new = placed(robot, {f"sensor 1 {name}": 0.1}).sensors[0].place
        np.testing.assert_allclose(new.rotation, expected, atol=1e-14, err_msg=name)
    np.testing.assert_allclose(new.position, turn @ old.position, atol=1e-17)


def test_a_robot_that_is_off_is_found_within_its_deviations():
    robot, rng = with_chip(tolerance={"tilt": 0.03, "at": 5e-4}), np.random.default_rng(1)
    robot = robot.replaced(earth=EARTH)
    true = off(robot, rng)
    truth = placed(robot, true).sensing()
    q = shapes(200, rng)
    u = truth(q) + 1e-3 * rng.normal(size=(200, 5))
    found = calibrate(robot, q, u, 1e-3)
    assert found.names == tuple(true)
    assert (np.abs(found.estimate - list(true.values())) < 4.5 * found.deviation).all()
    new = 0.5 * q[:50]
    before, after = (np.abs(s(new) - truth(new)).mean() for s in (robot.sensing(), found.sensing()))
    assert after < 0.02 * before
    assert found.chi2 == pytest.approx(1.0, abs=0.15)
    assert found.before > 20 > 1.2 > found.after > 0.8


@pytest.mark.parametrize(
    ("name", "value", "stated"),
    [
        ("sensor 1 tilt about x", 0.03, {"tilt": 0.03}),
        ("sensor 1 tilt about z", -0.03, {"tilt": 0.03}),
        ("sensor 1 along", 6e-4, {"at": 5e-4}),
        ("sensor 3 along", 6e-4, {"at": 5e-4}),
        ("sensor 1 gain z", 0.02, {"gain": 0.02}),
        ("sensor 3 offset", 0.1, {"offset": 0.1}),
        ("magnet 2 polarisation", -0.2, {"polarisation": 0.1}),
        ("Earth field along z", 0.05, {}),
    ],
)
def test_each_new_parameter_is_recovered_where_little_else_is_uncertain(name, value, stated):
    robot, q, kind = with_chip(), shapes(30, np.random.default_rng(2)), name.split()[0]
    if stated:
        parts = {"magnet": robot.magnets, "sensor": robot.sensors}[kind]
        parts = [replace(p, tolerance=stated) if f" {k} " in name else p for k, p in enumerate(parts, 1)]
        robot = robot.replaced(**{f"{kind}s": parts})
    u = placed(robot, {name: value}).sensing()(q)
    found = calibrate(robot, q, u, 1e-3, tolerances=FIXED if stated else replace(FIXED, earth=0.03))
    by_name = dict(zip(found.names, found.estimate, strict=True))
    assert by_name[name] == pytest.approx(value, rel=2e-2)
    # The prior pulls by the squared ratio of the deviations, and noise-free readings say the rest.
    k = found.names.index(name)
    pull = (found.deviation / found.tolerances)[k] ** 2
    assert by_name[name] == pytest.approx(value * (1 - pull), abs=0.3 * found.deviation[k])
    others = {x: v for x, v in by_name.items() if x != name}
    worst = max(others, key=lambda x: abs(others[x]) / found.tolerances[found.names.index(x)])
    assert abs(others[worst]) < 1.2 * found.deviation[found.names.index(worst)], worst
    assert np.abs(found.sensing()(q) - u).max() < 2e-3


def test_a_magnet_of_another_size_and_place_is_found_where_its_tolerance_allows_it():
    tolerance = {"at": 2e-3, "size": 1e-3, "polarisation": 0.2, "tilt": 0.1}
    chips = [Sensor(0, 0.0, position=[x, y, -0.02], axes=3) for x in (-0.02, 0.02) for y in (-0.02, 0.02)]
    drawn = Robot([FreeBody()], [Magnet(Disc(8e-3, 6e-3, 1300.0), 1, 0.0, tolerance=tolerance)], chips)
    true = {"magnet 1 along": 3e-3, "magnet 1 diameter": 1.5e-3, "magnet 1 polarisation": -0.2}
    truth = placed(drawn, true)
    shape = Disc(8e-3 * math.exp(1.5 / 8), 6e-3, 1300.0 * math.exp(-0.2))
    assert truth.magnets[0].shape == shape
    np.testing.assert_allclose(truth.moments[0], shape.multipoles(9), rtol=1e-12)
    q = np.random.default_rng(4).uniform(-1, 1, (60, 6)) * [0.02, 0.02, 0.01, 0.8, 0.8, 0.8]
    found = calibrate(drawn, q, truth.sensing()(q), 1e-3)
    assert dict(zip(found.names, found.estimate, strict=True))["magnet 1 along"] == pytest.approx(
        3e-3, abs=2e-4
    )
    assert np.abs(found.sensing()(q) - truth.sensing()(q)).max() < 5e-3
    tight = drawn.replaced(magnets=[replace(drawn.magnets[0], tolerance={"at": 0.0, "position": 1e-5})])
    with pytest.raises(InputError, match="a magnet of another size, polarity or place than described"):
        calibrate(tight, q, truth.sensing()(q), 1e-3, tolerances=replace(FIXED, magnet_position=1e-5))


def test_what_a_size_changes_of_the_moments_adds_to_what_is_known_of_them():
    robot, change = paper_robot(1), {"magnet 1 polarisation": 0.1}
    drawn = robot.sensing().moments
    calibrated = placed(robot.replaced(moments=1.2 * drawn), change)
    np.testing.assert_allclose(calibrated.moments, (1.2 + math.expm1(0.1)) * drawn, rtol=1e-12)


def test_a_part_moves_along_the_curve_and_beyond_its_end_straight_on():
    robot, q = paper_robot(1), np.array([0.02, -0.01, 0.004])
    inside = robot.replaced(sensors=[Sensor(1, 0.10, radial=0.013)])
    for far, at, z in ((4e-3, 0.104, 0.0), (-0.01, 0.09, 0.0), (0.013, 0.11, 3e-3), (-0.102, 0.0, -2e-3)):
        moved = placed(inside, {"sensor 1 along": far})
        same = inside.replaced(sensors=[Sensor(1, at, position=[0.013, 0.0, z], direction=[0, 0, -1])])
        np.testing.assert_allclose(moved.sensing()(q), same.sensing()(q), rtol=1e-9)
    for far in (-1e-3, 1e-3):  # on the end plate
        moved = placed(robot, {"sensor 1 along": far}).sensors[0]
        assert moved.at == 0.11
        np.testing.assert_allclose(moved.position, [0.013, 0.0, far])


def test_a_chip_is_one_part_whose_axes_stay_at_right_angles():
    robot = with_chip(tolerance={"tilt": 0.02, "at": 5e-4})
    names = [name for name in priors_of(robot, Tolerances()) if name.startswith("sensor 1")]
    assert [name.removeprefix("sensor 1 ") for name in names] == [
        "azimuth", "radius", "tilt", "gain x", "gain y", "gain z", "tilt about x", "tilt about z", "x", "y", "along"
    ]  # fmt: skip
    moved = placed(robot, off(robot, np.random.default_rng(5))).sensors[0].place.rotation
    np.testing.assert_allclose(moved.T @ moved, np.eye(3), atol=1e-12)
    gained = placed(robot, {"sensor 1 gain y": 0.1})
    u, more = robot.sensing()(np.zeros(6)), gained.sensing()(np.zeros(6))
    np.testing.assert_allclose(more, u * [1, 1.1, 1, 1, 1], rtol=1e-12)


def test_tolerances_of_a_part_come_first_and_what_is_not_stated_is_as_ever():
    usual = priors_of(paper_robot(1), Tolerances())
    assert len(usual) == 5 + 3 * 4 + 5
    own = {"radius": 2.6e-4, "azimuth": 0.01, "tilt": 0.05, "gain": 0.0, "offset": 0.1, "at": 1e-3}
    parts = paper_robot(1).sensors
    robot = paper_robot(1).replaced(sensors=[replace(parts[0], tolerance=own), *parts[1:]])
    robot = robot.replaced(magnets=[replace(robot.magnets[0], tolerance={"at": 2e-3})])
    stated = priors_of(robot, Tolerances())
    assert {name: std for name, std in stated.items() if usual.get(name) != std} == pytest.approx(
        {
            "magnet 1 along": 2e-3, "sensor 1 azimuth": 0.01, "sensor 1 radius": 0.02, "sensor 1 tilt": 0.05,
            "sensor 1 tilt about x": 0.05, "sensor 1 offset": 0.1, "sensor 1 along": 1e-3,
        }
    )  # fmt: skip
    assert usual.keys() - stated.keys() == {"sensor 1 gain"}
    on_plate = paper_robot(1).replaced(sensors=[replace(parts[0], tolerance={"position": 3e-4})])
    stated = priors_of(on_plate, Tolerances())
    there = {name for name in stated if name.startswith("sensor 1")}
    assert there == {f"sensor 1 {name}" for name in ("tilt", "gain", "x", "y", "z")}
    assert stated["sensor 1 x"] == 3e-4


def test_a_drawn_chip_is_off_in_every_turn_and_every_place_unless_its_file_says_otherwise():
    def stated(**tolerance):
        chip = Sensor(1, 0.11, axes=3, tolerance=tolerance)
        priors = priors_of(paper_robot(1).replaced(sensors=[chip]), Tolerances())
        return {
            name.removeprefix("sensor 1 "): std for name, std in priors.items() if name.startswith("sensor 1")
        }

    turns, places = ("tilt", "tilt about x", "tilt about z"), ("x", "y", "along")
    assert {stated()[name] for name in turns} == {math.radians(1.0)}
    assert {stated()[name] for name in places} == {3e-4}
    assert {stated(tilt=0.05)[name] for name in turns} == {0.05}
    assert {stated(position=1e-3)[name] for name in "xyz"} == {1e-3}
    assert "along" not in stated(position=1e-3)
    assert stated(at=2e-3)["along"] == 2e-3


def covered(found, q, u):
    """Return of which shapes ``[t, 3]`` the 90 % ellipsoid of a calibrated robot holds the truth."""
    method = LevenbergMarquardt(found.robot)
    x = method.step(method.init(q), u)[1].q
    return ((x - q) * np.linalg.solve(found.q_covariance(x), (x - q)[..., None])[..., 0]).sum(-1) < 6.25


@pytest.mark.parametrize("orientation", [None, [0.1, 0.2, 0.3, 0.9274]])
def test_chips_turned_and_moved_in_every_direction_are_calibrated_as_they_are(orientation):
    """Nothing is stated: 1 degree about and 0.3 mm along every axis are what is expected of a drawn chip."""
    places = [[0.013 * math.cos(a), 0.013 * math.sin(a), 0.0] for a in (0.0, 2.1, 4.2)]
    chips = [Sensor(1, 0.11, axes=3, position=p, orientation=orientation) for p in places]
    low, high = bounds(1)
    robot = paper_robot(1).replaced(sensors=chips, lower=low, upper=high, noise=2e-3)
    held = []
    for seed in range(3):
        rng = np.random.default_rng(seed)
        names = [
            f"sensor {j} {x}"
            for j in (1, 2, 3)
            for x in ("tilt", "tilt about x", "tilt about z", "x", "y", "along")
        ]
        sizes = np.tile([math.radians(1.0)] * 3 + [3e-4] * 3, 3)
        true = placed(robot, dict(zip(names, (sizes * rng.standard_normal(18)).tolist(), strict=True)))
        q = rng.uniform(low, high, (330, 3))
        u = true.sensing()(q) + 2e-3 * rng.standard_normal((330, 9))
        found = calibrate(robot, q[:30], u[:30])
        assert not found.model_error.any()
        held.append(covered(found, q[30:], u[30:]))
    assert 0.83 < np.mean(held) < 0.96


def test_what_left_out_poses_show_beyond_the_noise_is_an_error_of_the_model():
    """The readings have a part that no parameter describes, twice the noise: the deviations hold it."""
    low, high = bounds(1)
    robot = paper_robot(1, 6).replaced(lower=low, upper=high, noise=1e-3)
    rng, waves = np.random.default_rng(0), np.random.default_rng(1).normal(0.0, 300.0, (3, 6))
    q = rng.uniform(low, high, (360, 3))
    u = placed(robot, off(robot, rng)).sensing()(q) + 1e-3 * rng.standard_normal((360, 6))
    for size in (0.0, 3e-3):
        readings = u + size * np.sin(q @ waves)
        found = calibrate(robot, q[:60], readings[:60])
        assert found.model_error.any() == (size > 0)
        assert ("the model is inexact" in repr(found)) == (size > 0)
        assert 0.8 < covered(found, q[60:], readings[60:]).mean() < 0.97
        assert np.sqrt(np.diag(found.model_error)).mean() == pytest.approx(size / 2**0.5, rel=0.25)


def test_more_poses_show_a_smaller_error_of_the_model():
    """A tenth more variance is six standard deviations of the mean square of 8,000 readings, and two of 800."""
    off = np.random.default_rng(0).standard_normal((1000, 8))
    off *= np.sqrt(1.1 / np.square(off).mean())
    expected, own = np.tile(np.eye(8), (1000, 1, 1)), np.sqrt(np.square(off).mean(1))
    assert _model_error(off, expected, own).any()
    assert not _model_error(off[:100], expected[:100], own[:100]).any()


@pytest.mark.parametrize(
    ("poses", "before", "after", "mostly", "worst", "far", "good"),
    [
        (9, 2.0, 1.0, 4.0, 4.0, 10.0, True),
        (9, 2.0, 1.0, 4.01, 4.01, 1.0, False),  # most poses
        (9, 2.0, 1.0, 1.0, 5.0, 1.0, True),
        (9, 2.0, 1.0, 1.0, 5.01, 1.0, False),  # one pose, in units of most
        (9, 2.0, 1.0, 0.5, 4.0, 1.0, True),
        (9, 2.0, 1.0, 0.5, 4.01, 1.0, False),
        (9, 2.0, 1.0, 1.0, 1.0, 10.01, False),  # a part
        (9, 1.9, 1.9, 2.0, 2.0, 1.0, True),
        (9, 1.9, 1.9, 2.01, 2.01, 1.0, False),  # no better than the drawing
        (9, 1.6, 1.6, 1.0, 1.0, 1.0, True),
        (10, 1.6, 1.6, 1.0, 1.0, 1.0, False),
        (10, 1.6, 1.59, 1.0, 1.0, 1.0, True),
        (10, 1.5, 1.5, 1.0, 1.0, 1.0, True),
    ],
)
def test_a_fit_that_is_taken_is_good_in_most_poses_in_each_and_in_all_parts(
    poses, before, after, mostly, worst, far, good
):
    own = np.r_[np.full(poses - 1, mostly), worst]
    with nullcontext() if good else pytest.raises(InputError, match="readings of this robot in these poses"):
        _judge(np.array([0.0, -far]), ("a", "b"), (before, after, own, np.zeros((1, 1))), None)


@pytest.mark.parametrize("late", [0.049, 0.051])
def test_poses_and_readings_of_two_tables_are_of_one_time(late):
    robot, q = paper_robot(1), shapes(12, np.random.default_rng(0), 1)
    poses = pd.DataFrame(1e3 * q, columns=[f"{name}_mm" for name in robot.coordinates]).assign(
        time_s=np.arange(12.0)
    )
    u = pd.DataFrame(robot.sensing()(q), columns=["u1_mT", "u2_mT", "u3_mT"]).assign(
        time_s=np.arange(12) + late
    )
    with pytest.raises(InputError, match="times of calibrate must be") if late > 0.05 else nullcontext():
        found = calibrate(robot, poses, u, 1e-3)
        for chi2, larger in ((1.5, False), (1.51, True)):
            assert ("tolerances or noise that are larger" in repr(replace(found, chi2=chi2))) == larger


def test_magnets_of_several_shapes_have_moments_of_their_own():
    robot = with_chip()
    robot = robot.replaced(
        magnets=[robot.magnets[0], replace(robot.magnets[1], shape=Disc(0.02, 6e-3, 1300.0))]
    )
    q = shapes(40, np.random.default_rng(7))
    u = placed(robot, {"magnet 2 moment A1": 0.04}).sensing()(q)
    found = calibrate(robot, q, u, 1e-4, tolerances=replace(FIXED, moments=0.02))
    assert dict(zip(found.names, found.estimate, strict=True))["magnet 2 moment A1"] == pytest.approx(
        0.04, rel=1e-2
    )


def test_without_information_the_tolerances_remain():
    robot = with_chip(tolerance={"tilt": 0.02, "position": 1e-3})
    found = calibrate(robot, np.zeros((2, 6)), Sensing(robot)(np.zeros((2, 6))), noise=1e6, tolerances=STATED)
    np.testing.assert_allclose(found.covariance, np.eye(len(found.names)), atol=1e-9)
    np.testing.assert_allclose(found.estimate, 0.0, atol=1e-12)
    np.testing.assert_allclose(found.deviation, found.tolerances)


def test_the_order_of_poses_does_not_matter():
    robot, rng = with_chip(tolerance={"tilt": 0.02, "at": 5e-4}), np.random.default_rng(8)
    q, covariance = shapes(30, rng), 1e-8 * np.einsum("kij,klj->kil", *[rng.normal(size=(30, 6, 6))] * 2)
    u, order = (
        placed(robot, off(robot, rng)).sensing()(q) + 1e-3 * rng.normal(size=(30, 5)),
        rng.permutation(30),
    )
    a = calibrate(robot, q, u, 1e-3, covariance)
    b = calibrate(robot, q[order], u[order], 1e-3, covariance[order])
    np.testing.assert_allclose(a.estimate, b.estimate, rtol=0, atol=1e-6 * a.tolerances.max())
    assert (a.before, a.after) == pytest.approx((b.before, b.after))


def test_a_pose_predicted_from_the_others_is_what_a_fit_without_it_predicts():
    robot, rng = paper_robot(1), np.random.default_rng(9)
    q = shapes(12, rng, 1)
    u = placed(robot, off(robot, rng, size=0.2)).sensing()(q) + 1e-3 * rng.normal(size=(12, 3))
    rms = []
    for k in range(12):
        rest = np.arange(12) != k
        r = (calibrate(robot, q[rest], u[rest], 1e-3).sensing()(q[k]) - u[k]) / 1e-3
        rms.append(math.sqrt(np.mean(r**2)))
    assert calibrate(robot, q, u, 1e-3).after == pytest.approx(np.median(rms), rel=0.05)


def test_the_calibrated_robot_is_complete():
    q = shapes(20, np.random.default_rng(10), 1)
    lower, upper = bounds(1)
    drawn = paper_robot(1)
    robot = Robot(
        drawn.segments, drawn.magnets, drawn.sensors, [Imu(1, 0.11)], lower=lower - 0.01, upper=upper + 0.01,
        noise=[1e-3] * 3 + [0.01] * 3, rate_hz=25.0, earth=EARTH,
    )  # fmt: skip
    u = np.concatenate([1.01 * robot.sensing()(q)[:, :3], np.zeros((20, 3))], axis=1)
    found = calibrate(robot, q, u)
    same = calibrate(robot.replaced(imus=[], noise=1e-3), q, u[:, :3], earth=EARTH)
    np.testing.assert_allclose(found.estimate, same.estimate, rtol=1e-9)
    assert (found.robot.rate_hz, len(found.robot.imus), found.poses) == (25.0, 1, 20)
    np.testing.assert_array_equal(found.robot.earth, EARTH)
    again = placed(found.described, dict(zip(found.names, found.estimate.tolist(), strict=True)))
    np.testing.assert_array_equal(again.sensing()(q), found.sensing()(q))
    certain = replace(found, covariance=np.zeros_like(found.covariance))
    method = LevenbergMarquardt(found.robot)
    known = method.step(method.init(q), found.sensing()(q))[1].covariance
    np.testing.assert_allclose(certain.q_covariance(q), known, rtol=1e-5)
    assert (np.linalg.eigvalsh(found.q_covariance(q) - known) > -1e-12 * np.trace(known[0])).all()
    np.testing.assert_allclose(found.q_covariance(q)[0], found.q_covariance(q[:1])[0], rtol=1e-9)


def test_a_calibrated_robot_is_wrong_as_much_as_robots_drawn_from_the_posterior():
    robot, rng = paper_robot(1), np.random.default_rng(11)
    q = shapes(15, rng, 1)
    found = calibrate(robot, q, robot.sensing()(q), 1e-2)
    root, at, drawn = np.linalg.cholesky(found.covariance), q[:2], []
    method = LevenbergMarquardt(found.sensing(), *bounds(1), 1e-2)
    for _ in range(300):
        z = found.estimate + found.tolerances * (root @ rng.normal(size=len(root)))
        true = placed(found.described, dict(zip(found.names, z.tolist(), strict=True))).sensing()
        drawn.append(method.step(method.init(at), true(at))[1].q)
    std = np.sqrt(np.diagonal(found.q_covariance(at, 1e-9), 0, -2, -1))
    np.testing.assert_allclose(np.std(drawn, axis=0), std, rtol=0.15)


def test_ellipsoids_of_calibrated_robots_cover_the_truth():
    tolerance, held = {"tilt": math.radians(1.5), "at": 5e-4}, []
    sensors = [replace(s, at=0.105, tolerance=tolerance) for s in paper_robot(2).sensors]
    sensors = [replace(s, direction=s.place.rotation[:, 2]) for s in sensors]
    low, high = bounds(2)
    robot = Robot(
        paper_robot(2).segments, paper_robot(2).magnets, sensors, lower=low, upper=high, noise=7.1e-4
    )
    middle, half = (low + high) / 2, (high - low) / 2
    for seed in range(5):
        rng = np.random.default_rng(seed)
        truth = placed(robot, off(robot, rng)).sensing()
        q, new = (middle + s * half * rng.uniform(-1, 1, (n, 6)) for s, n in ((0.95, 30), (0.7, 200)))
        u, u_new = (truth(x) + 7.1e-4 * rng.normal(size=(len(x), 6)) for x in (q, new))
        found = calibrate(robot, q + 1e-4 * rng.normal(size=q.shape), u, None, 1e-8 * np.eye(6))
        method = LevenbergMarquardt(found.sensing(), low - 0.01, high + 0.01, 7.1e-4)
        at = method.step(method.init(new), u_new)[1].q
        e, C = at - new, found.q_covariance(at)
        held.append(
            float(np.mean(np.einsum("ki,ki->k", e, np.linalg.solve(C, e[..., None])[..., 0]) < 12.592))
        )
    assert 0.93 <= np.mean(held) <= 0.98
    assert min(held) > 0.85, held


def _one_pose_wrong(q, u):
    q[7, 0] *= 1000


WRONG = {
    "polarity": lambda q, u: np.negative(u, out=u),
    "order of sensors": lambda q, u: u.__setitem__(slice(None), np.roll(u, 1, axis=1)),
    "unit of readings": lambda q, u: np.multiply(u, 1000, out=u),
    "unit of poses": lambda q, u: np.divide(q, 10, out=q),
    "axes exchanged": lambda q, u: q.__setitem__((slice(None), slice(0, 2)), q[:, [1, 0]]),
    "another order of poses": lambda q, u: q.__setitem__(slice(None), q[::-1].copy()),
    "one pose in another unit": _one_pose_wrong,
}


@pytest.mark.parametrize("pose_noise", [None, 1e-4, 5e-4])
@pytest.mark.parametrize("wrong", WRONG)
def test_a_calibration_no_better_than_the_description_is_refused_with_likely_causes(wrong, pose_noise):
    robot, rng = paper_robot(1), np.random.default_rng(12)
    robot = robot.replaced(
        sensors=[replace(chip, name=name) for chip, name in zip(robot.sensors, "ABC", strict=True)]
    )
    q = shapes(30, rng, 1)
    u = placed(robot, off(robot, rng)).sensing()(q) + 7.1e-4 * rng.normal(size=(30, 3))
    S = None if pose_noise is None else pose_noise**2 * np.eye(3)
    assert calibrate(robot, q, u, 7.1e-4, S).after < 1.2
    WRONG[wrong](q, u)
    with pytest.raises(
        InputError, match="must be readings of this robot in these poses .*poses in another unit"
    ) as e:
        calibrate(robot, q, u, 7.1e-4, S)
    assert len(str(e.value).split("received")[1]) < 200
    if wrong == "one pose in another unit":
        assert "row 8" in str(e.value)
    if wrong == "order of sensors" and pose_noise:  # each where another is drawn, a third of a turn away
        assert re.search("received [ABC] azimuth off by .* times its tolerance", str(e.value))


@pytest.mark.slow
def test_a_rough_drawing_is_calibrated_if_its_tolerances_say_so():
    """Magnets 8 mm and 30 degrees off: the fit next to the drawing ends in a narrow valley far from the robot."""
    rough = Tolerances(magnet_position=8e-3, magnet_tilt=0.5, chip_position=5e-3, sensor_tilt=0.3)
    robot, rng = with_chip(), np.random.default_rng(3)
    truth = placed(robot, off(robot, rng, rough)).sensing()
    q = shapes(24, rng)
    u = truth(q) + 1e-2 * rng.normal(size=(24, 5))
    found = calibrate(robot, q, u, 1e-2, tolerances=rough, starts=1)
    assert found.after < 1.5
    assert found.before > 100
    new = 0.5 * q
    before, after = (np.abs(s(new) - truth(new)).mean() for s in (robot.sensing(), found.sensing()))
    assert after < 0.01 * before
    with pytest.raises(InputError, match="by .* times its tolerance|standard deviations against"):
        calibrate(robot, q, u, 1e-2, tolerances=rough)


@pytest.mark.slow
def test_a_constant_field_is_found_if_it_has_a_tolerance_and_named_if_it_has_none():
    robot, rng = paper_robot(1), np.random.default_rng(0)
    q = shapes(30, rng, 1)
    true = placed(robot.replaced(earth=[3.0, -2.0, 3.0]), off(robot, rng))
    u = true.sensing()(q) + 1e-3 * rng.normal(size=(30, 3))
    found = calibrate(robot, q, u, 1e-3, tolerances=Tolerances(earth=5.0))
    assert found.after < 1.5
    with pytest.raises(InputError, match=r"a constant field of .* mT they fit: state Tolerances\(earth="):
        calibrate(robot, q, u, 1e-3)


@pytest.mark.parametrize("poses", [2, 4, 8, 10, 12, 30])
def test_a_robot_that_is_as_described_is_no_reason_to_refuse(poses):
    robot = with_chip(tolerance={"tilt": 0.02, "at": 5e-4})
    for seed in range(4):
        rng = np.random.default_rng(seed)
        q = shapes(poses, rng)
        assert calibrate(robot, q, robot.sensing()(q) + 1e-3 * rng.normal(size=(poses, 5)), 1e-3).chi2 < 2


@pytest.mark.parametrize(("std", "slack"), [(0.0, 0.01), (0.02, 0.11)])
def test_a_pose_may_be_outside_by_a_hundredth_of_the_range_and_five_deviations(std, slack):
    robot = Robot([BallJoint("x"), Link(0.1)], lower=[-0.3], upper=[0.7])
    q = np.array([[-0.3 - slack], [0.7 + slack]])
    for more, out in ((-1e-4, False), (1e-4, True)):
        assert (outside(robot, q + np.array([[-more], [more]]), [[std**2]]) == out).all()


def test_poses_outside_the_bounds_are_named_by_their_row():
    low, high = bounds(1)
    robot, rng = paper_robot(1).replaced(lower=low, upper=high, noise=7.1e-4), np.random.default_rng(13)
    q = low + (high - low) * rng.random((12, 3))
    q[3, 2] = 0.0
    u = robot.sensing()(q) + 7.1e-4 * rng.normal(size=(12, 3))
    q[3, 2] = -1e-4  # measured, by no more than it is uncertain
    assert calibrate(robot, q, u, None, 1e-9 * np.eye(3)).poses == 12
    q[3, 2] = 0.0
    for wrong in (1e3 * q[7, 0], 1e305, -1e305):
        q[7, 0] = wrong
        expected = rf"q of calibrate must be within the robot's bounds, for delta_x_1 -0.02073 to 0.02073 .*{wrong:g}"
        with pytest.raises(InputError, match=expected.replace("+", r"\+") + " in row 8"):
            calibrate(robot, q, u)
    turns = Robot(
        [FreeBody()], [Magnet(Disc(8e-3, 3e-3, 1300.0), 1, 0.0)], [Sensor(0, 0.0, axes=3)], noise=1e-3
    )
    turns = turns.replaced(lower=[-0.1] * 3 + [-np.pi] * 3, upper=[0.1] * 3 + [np.pi] * 3)
    x = np.array([[0.03, 0.04, 0.05, 3.5, 0.0, 0.0], [0.03, -0.04, 0.05, 0.0, -3.4, 0.0]])
    assert calibrate(turns, x, turns.sensing()(x)).poses == 2


def refusal(robot, **given):
    """What is said against it, or nothing if all that is found is finite."""
    try:
        found = calibrate(robot, **given)
    except InputError as error:
        return str(error)
    return "" if np.isfinite([*found.estimate, *found.deviation, found.chi2]).all() else "not finite" * 100


@pytest.mark.parametrize("value", [1e305, -1e305, 1e200, 1e100, 1e20])
@pytest.mark.parametrize("where", ["q", "u", "q_covariance", "noise"])
def test_no_number_ends_in_anything_but_words(where, value):
    robot, q = paper_robot(1), shapes(10, np.random.default_rng(14), 1)
    given = {
        "q": q,
        "u": robot.sensing()(q),
        "noise": np.full(3, 1e-3),
        "q_covariance": np.tile(1e-8 * np.eye(3), (10, 1, 1)),
    }
    given[where].flat[-1] = value
    words = refusal(robot, **given)
    assert len(words) < 750
    assert words or where in ("noise", "q_covariance")


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"q": np.zeros((0, 3)), "u": np.zeros((0, 3))}, "two poses or more, .*; instead received 0"),
        ({"q": np.zeros((1, 3)), "u": np.zeros((1, 3))}, "two poses or more, .*; instead received 1"),
        ({"q": np.zeros((4, 2))}, r"q of calibrate must be numbers of shape \(any, 3\)"),
        ({"u": np.zeros((4, 2))}, r"u of calibrate must be numbers of shape \(4, 3\)"),
        ({"u": np.full((4, 3), np.nan)}, "u of calibrate must be finite"),
        ({"noise": -1.0}, "noise of calibrate must be positive"),
        ({"noise": None}, "noise of calibrate must be positive.*received none"),
        ({"noise": [1.0, 2.0]}, "one number or one for each reading"),
        ({"q_covariance": np.eye(2)}, "q_covariance of calibrate must be numbers of shape"),
        ({"robot": Robot([ConstantCurvature(0.1, 0.02)])}, "one with magnets and sensors"),
        ({"robot": paper_robot(1).replaced(model=lambda xi: xi[..., 1])}, "multipoles of its magnets"),
    ],
)
def test_what_cannot_be_is_refused_in_words(change, message):
    good = {"robot": paper_robot(1), "q": np.zeros((4, 3)), "u": np.zeros((4, 3)), "noise": 1e-3}
    with pytest.raises(InputError, match=message):
        calibrate(**{**good, **change})
    for wrong in ({"moments": 0.0}, {"sensor_offset": -1.0}, {"earth": math.inf}):
        with pytest.raises(InputError, match="tolerances of Tolerances must be positive, or zero"):
            Tolerances(**wrong)


def test_a_fixed_coordinate_has_no_covariance_and_steps_count_as_noise():
    robot = load_robot(example() / "robot.toml")
    rng = np.random.default_rng(0)
    q = rng.uniform(robot.lower, robot.upper, (60, robot.n_q))
    u = robot.sensing()(q) + robot.noise * rng.normal(size=(60, robot.n_readings))
    found = calibrate(robot, q, u)
    C = found.q_covariance(q[:5])
    assert (np.abs(C[:, robot.fixed]) < 1e-20).all()
    free = ~robot.fixed
    J = robot.sensing().linearise(q[:5])[1][..., free] / robot.noise[:, None]
    bound = np.linalg.inv(np.swapaxes(J, 1, 2) @ J)
    assert (np.diagonal(C[:, free][:, :, free], 0, 1, 2) > 0.99 * np.diagonal(bound, 0, 1, 2)).all()
    coarse = robot.replaced(sensors=[replace(sensor, resolution=0.1) for sensor in robot.sensors])
    assert 0.5 < calibrate(coarse, q, np.round(u / 0.1) * 0.1).chi2 < 1.5


def test_a_calibration_belongs_to_the_robot_of_its_file(tmp_path):
    robot = load_robot(example() / "robot.toml")
    q = np.random.default_rng(0).uniform(robot.lower, robot.upper, (30, robot.n_q))
    for other in (robot.replaced(earth=[0.02, 0.0, 0.045]), robot.replaced(magnets=robot.magnets[::-1])):
        found = calibrate(other, q, other.sensing()(q))
        with pytest.raises(InputError, match="must be of a robot that load_robot has read"):
            found.save(tmp_path / "other.json")
    again = calibrate(calibrate(robot, q, robot.sensing()(q)).robot, q, robot.sensing()(q))
    with pytest.raises(InputError, match="must be of a robot that load_robot has read"):
        again.save(tmp_path / "again.json")
