"""The design check against bounds computed another way, simulated tracking, and designs whose answer is known."""

from __future__ import annotations

import sys
from dataclasses import replace

import numpy as np
import pytest

from repro import (
    BallJoint,
    ConstantCurvature,
    Cube,
    Disc,
    FreeBody,
    Imu,
    InputError,
    KalmanFilter,
    LevenbergMarquardt,
    Link,
    Magnet,
    Ring,
    Robot,
    Sensor,
    calibrate,
    simulated_readings,
    track,
)
from repro.check import _verdict, check_design, length_in_words, mirrored_chips
from repro.networks import Network
from repro_board import cli

from .robots import RELEASED

DISC = Disc(8e-3, 3e-3, 1300.0)


def arm(at=(0.055, 0.045), stretch=0.0, **more):
    """Two segments, a disc in each, and four chips, some millimetres from the discs along the arm or beside them."""
    chips = [
        Sensor(g, at[g - 1], radial=0.012, azimuth=a, axes=3, name=f"B{2 * g - 1 + (a > 0)}", **more)
        for g in (1, 2)
        for a in (0.0, np.pi)
    ]
    return Robot(
        [ConstantCurvature(0.09, 0.015), ConstantCurvature(0.07, 0.015)],
        [Magnet(DISC, 1, 0.045), Magnet(DISC, 2, 0.035)],
        chips,
        lower=[-0.012, -0.012, 0.0] * 2,
        upper=[0.012, 0.012, stretch] * 2,
        noise=0.02,
    )


def good(**more):
    """The robot of Baaij et al. 2023 with one segment and five sensors."""
    return Robot(
        [ConstantCurvature(0.11, 0.022)],
        [Magnet(RELEASED, 1, 0.055)],
        [Sensor(1, 0.11, radial=0.013, azimuth=k * 2 * np.pi / 5) for k in range(5)],
        lower=[-0.02, -0.02, 0.0],
        upper=[0.02, 0.02, 0.006],
        noise=5e-3,
        **more,
    )


def bound(robot, q):
    """Cramér-Rao bound of the tip by magpylib's exact fields and differences."""
    free = robot.upper > robot.lower
    step = 1e-5 * np.diag(robot.upper - robot.lower)[free]

    def slope(function):
        return np.stack([(function(q + h) - function(q - h)) / 2e-5 for h in step], axis=-1)

    J = slope(lambda x: simulated_readings(robot, x)) / robot.noise[:, None]
    G = slope(lambda x: robot.tip(x)[..., :3, 3])
    C = np.linalg.inv(np.swapaxes(J, -1, -2) @ J)
    return np.sqrt(np.trace(G @ C @ np.swapaxes(G, -1, -2), axis1=-2, axis2=-1))


@pytest.mark.parametrize("robot", [arm(), arm(at=(0.045, 0.035)), good()], ids=["rough", "hopeless", "good"])
def test_the_bound_is_that_of_an_independent_computation(robot):
    found = check_design(robot, samples=60)
    np.testing.assert_allclose(found.tip, bound(robot, found.q), rtol=0.05)


def test_a_first_layout_that_cannot_work_is_called_hopeless():
    """Every chip beside a disc: its field hardly changes with the shape."""
    found = check_design(arm(at=(0.045, 0.035)))
    assert np.median(found.tip) == pytest.approx(0.149, rel=0.02)
    assert not found.can_work
    assert found.verdict == (
        "This robot cannot work: the readings allow ±150 mm, and the bounds alone allow ±72 mm."
    )
    assert found.undetermined == ("every coordinate",)
    assert repr(found).splitlines()[-1] == found.verdict
    assert repr(arm(at=(0.045, 0.035)).check()) == repr(found)


def test_a_good_design_is_confirmed_by_simulated_tracking():
    robot = good()
    found = check_design(robot, samples=600)
    assert found.can_work
    assert found.verdict.startswith("This robot can work: the tip is known to ±")
    assert found.idle == found.undetermined == found.notes == ()
    rng = np.random.default_rng(1)
    q = rng.uniform(robot.lower + 0.1 * (robot.upper - robot.lower), robot.upper, (600, 3))
    u = simulated_readings(robot, q) + robot.noise * rng.normal(size=(600, 5))
    method = LevenbergMarquardt(robot, robot.lower - 0.1, robot.upper + 0.1)
    tip = robot.tip(method.step(method.init(q), u)[1].q)[:, :3, 3]
    error = np.linalg.norm(tip - robot.tip(q)[:, :3, 3], axis=-1)
    assert np.sqrt(np.mean(error**2)) == pytest.approx(np.sqrt(np.mean(found.tip**2)), rel=0.2)


def test_tolerances_are_what_robots_built_so_show():
    """Least squares that does not know how the magnet is off, over many robots that are off so."""
    std = {"position": 0.2e-3, "tilt": 0.01}
    quiet = {"tolerance": dict.fromkeys(("azimuth", "radius", "tilt", "gain"), 0.0)}
    sensors = [Sensor(1, 0.11, radial=0.013, azimuth=k * 2 * np.pi / 5, **quiet) for k in range(5)]
    magnet = Magnet(RELEASED, 1, 0.055, tolerance=std)
    robot = good().replaced(magnets=[magnet], sensors=sensors, noise=5e-3)
    found, rng = check_design(robot, samples=200), np.random.default_rng(2)
    errors = []
    for _ in range(40):
        x, y = std["tilt"] * rng.normal(size=2)
        off = Magnet(RELEASED, 1, 0.055, [y, -x, 1.0], std["position"] * rng.normal(size=3))
        u = simulated_readings(robot.replaced(magnets=[off]), found.q) * (1 + 0.02 * rng.normal())
        u = u + robot.noise * rng.normal(size=u.shape)
        method = LevenbergMarquardt(robot, robot.lower - 0.1, robot.upper + 0.1)
        q = method.step(method.init(found.q), u)[1].q
        errors.append(robot.tip(q)[:, :3, 3] - robot.tip(found.q)[:, :3, 3])
    rms = np.sqrt(np.mean(np.square(errors).sum(-1)))
    assert rms == pytest.approx(np.sqrt(np.mean(found.tip_as_built**2)), rel=0.2)
    assert rms > 2 * np.sqrt(np.mean(found.tip**2))


def test_a_reading_beyond_its_range_counts_nothing():
    robot = good()
    low = [Sensor(1, 0.11, radial=0.013, azimuth=0.0, range=1.0, name="low"), *robot.sensors[1:]]
    found = check_design(robot.replaced(sensors=low, noise=5e-3))
    share, most = found.saturated["low"]
    beyond = np.abs(simulated_readings(robot, found.q)[:, 0])
    assert share == pytest.approx(np.mean(beyond > 1.0), abs=0.01)
    assert most == pytest.approx(beyond.max(), rel=0.01)
    without = check_design(robot.replaced(sensors=robot.sensors[1:], noise=5e-3))
    np.testing.assert_allclose(found.tip[beyond > 1.01], without.tip[beyond > 1.01])
    assert f"low saturates in {100 * share:.3g} % of the workspace (up to {most:.3g} mT)" in repr(found)


def test_undetermined_combinations_are_said_in_words():
    arms = [ConstantCurvature(0.1, 0.02)] * 2
    at_the_tip = Robot(
        arms, imus=[Imu(2, 0.1)], lower=[-0.02, -0.02, 0] * 2, upper=[0.02, 0.02, 0.004] * 2, noise=1e-3
    )
    found = check_design(at_the_tip)
    bends = "combinations of delta_x_1, delta_y_1, delta_x_2 and delta_y_2"
    assert found.undetermined == ("delta_L_1", "delta_L_2", bends)
    assert np.isinf(found.tip).all()
    assert "3 readings for 6 unknowns, none to spare: a sensor that fails is never noticed" in found.notes
    plane = at_the_tip.replaced(lower=[-0.02, 0, 0] * 2, upper=[0.02, 0, 0] * 2)
    assert check_design(plane).undetermined == ("combinations of delta_x_1 and delta_x_2",)
    both = check_design(at_the_tip.replaced(imus=[Imu(1, 0.1), Imu(2, 0.1)], noise=1e-3))
    assert both.undetermined == ("delta_L_1", "delta_L_2")
    assert any(note.startswith("6 readings for 6 unknowns, none to spare") for note in both.notes)
    assert both.can_work  # the bounds hold what the IMUs leave open
    assert "(without readings ±112 mm)" in both.verdict


def test_a_magnet_that_turns_about_its_own_axis():
    chips = [Sensor(0, 0.0, position=[x, y, -0.06], axes=3) for x in (-0.03, 0.03) for y in (-0.03, 0.03)]
    turns = np.r_[0.02, 0.02, 0.02, 0.1, 0.1, 0.1]
    robot = Robot(
        [FreeBody()], [Magnet(Cube(0.01, 1300.0), 1, 0.0)], chips, lower=-turns, upper=turns, noise=3e-3
    )
    found = check_design(robot)
    assert found.undetermined == ("rotation_z_1",)
    assert np.isfinite(found.tip).all()  # its place does not depend on it
    free = check_design(
        robot.replaced(lower=-turns * [1, 1, 1, 20, 20, 20], upper=turns * [1, 1, 1, 20, 20, 20])
    )
    assert free.undetermined == ("combinations of rotation_x_1, rotation_y_1 and rotation_z_1",)


def test_a_trained_network_has_no_tolerances():
    width = 1 + 4 * len(good().magnets)
    layer = (np.random.default_rng(0).normal(size=(1, width)), np.zeros(1))
    found = check_design(good(model=Network([layer], "silu", "cosines")))
    np.testing.assert_array_equal(found.tip_as_built, found.tip_within_bounds)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (
            lambda: good().replaced(lower=None, upper=None),
            "bounds of check must be stated by the robot; instead",
        ),
        (
            lambda: good().replaced(noise=None),
            "noise of check must be stated by the robot; instead received none",
        ),
        (lambda: good().replaced(upper=good().lower), "a coordinate is free"),
        (lambda: Robot([BallJoint()], imus=[Imu(1, 0.0)], noise=0.01), "one whose tip moves"),
    ],
)
def test_what_a_robot_must_state(make, message):
    with pytest.raises(InputError, match=message):
        check_design(make())


def test_the_command(tmp_path, capsys, monkeypatch):
    answers = {"good": good(), "bad": arm(at=(0.045, 0.035))}
    monkeypatch.setattr("repro.robot_file.load_robot", lambda path: answers[str(path)])
    assert cli.main(["check", "good"]) == 0
    assert capsys.readouterr().out.splitlines()[-1].startswith("This robot can work")
    assert cli.main(["check", "bad", "--samples", "50"]) == 1
    assert capsys.readouterr().out.splitlines()[-1].startswith("This robot cannot work")
    monkeypatch.undo()
    assert cli.main(["check", str(tmp_path / "no.toml")]) == 2
    assert "no.toml" in capsys.readouterr().err
    assert "jupyter" not in sys.modules


def test_a_reading_so_close_to_a_magnet_that_its_field_is_unknown_counts_nothing():
    """The series of multipoles holds beyond the sphere around a magnet; a ball joint swings this one over a chip."""
    robot = Robot(
        [BallJoint("xy"), Link(0.012)], [Magnet(Cube(4e-3, 1300.0), 2, 0.006)],
        [Sensor(0, 0.0, position=[0.0, 0.0, 0.0035], axes=3, name="chip")],
        lower=[-0.5, -0.5], upper=[0.5, 0.5], noise=6e-3,
    )  # fmt: skip
    found = check_design(robot)
    assert found.notes[0].startswith("chip comes so close to a magnet")
    assert not found.can_work
    lower = robot.replaced(sensors=[Sensor(0, 0.0, position=[0.0, 0.0, -0.006], axes=3, name="chip")])
    assert check_design(lower).can_work
    assert not any("close" in note for note in check_design(lower).notes)


def test_a_lone_chip_cannot_tell_a_mirrored_shape_and_two_can():
    one = Sensor(1, 0.03, axes=3, name="a")
    robot = Robot(
        [ConstantCurvature(0.09, 0.015)], [Magnet(Disc(10e-3, 4e-3, 1300.0), 1, 0.055)], [one],
        lower=[-0.012, -0.012, 0.0], upper=[0.012, 0.012, 0.0], noise=0.01,
    )  # fmt: skip
    assert mirrored_chips(robot) == ("a",)
    behind = robot.replaced(  # a joint that moves no magnet tells nothing
        segments=[*robot.segments, BallJoint("x"), Link(0.01)],
        lower=[*robot.lower, -1.0],
        upper=[*robot.upper, 1.0],
    )
    assert mirrored_chips(behind) == ("a",)
    assert any("axes of a are exchanged" in note for note in check_design(robot).notes)
    assert mirrored_chips(robot.replaced(sensors=[one, Sensor(1, 0.09, axes=3)])) == ()
    assert (
        mirrored_chips(robot.replaced(sensors=[Sensor(1, 0.03, position=[0.004, 0.001, 0.0], axes=3)])) == ()
    )


def test_steps_of_the_readings_count_as_estimators_take_them():
    robot = good()
    coarse = [replace(sensor, resolution=0.1) for sensor in robot.sensors]
    found = check_design(robot.replaced(sensors=coarse, noise=5e-3))
    rounded = np.hypot(5e-3, 0.1 / np.sqrt(12))
    np.testing.assert_allclose(found.tip, check_design(robot.replaced(noise=rounded)).tip)


def test_a_reading_too_near_a_magnet_is_left_out_by_every_estimator_and_named():
    """Within the sphere of the ring the series says 827 mT for 60: the healthy chip must not be blamed."""
    robot = Robot(
        [ConstantCurvature(0.06, 0.015)], [Magnet(Ring(24e-3, 12e-3, 6e-3, 1450.0), 1, 0.05)],
        [Sensor(1, 0.04, axes=3, name="inside"), Sensor(1, 0.025, axes=3)],
        lower=[-0.004, -0.004, 0.0], upper=[0.004, 0.004, 0.0], noise=0.05, rate_hz=50.0,
    )  # fmt: skip
    t = np.arange(60) / 20
    q = np.stack([3e-3 * np.sin(t), 2e-3 * np.cos(t), 0 * t], axis=-1)
    u = simulated_readings(robot, q) + 0.05 * np.random.default_rng(0).standard_normal((60, 6))
    for make in (LevenbergMarquardt, KalmanFilter):
        found = track(make(robot), u)
        assert (found.status == "consistent").all()
        assert np.abs(found.q - q).max() < 2e-3
        assert found.details["too_near"].all(0).tolist() == [True] * 3 + [False] * 3
        assert "left out, too close to a magnet: inside in 60 rows" in repr(found)
    with pytest.raises(InputError, match="inside of the robot must be farther from every magnet"):
        calibrate(robot, q[:30], u[:30])


@pytest.mark.parametrize(("widest", "noted"), [(np.pi, False), (3.0, True)])
def test_a_start_at_a_bound_is_noted_unless_the_angle_comes_round_there(widest, noted):
    hinge = Robot(
        [BallJoint("x"), Link(0.1)],
        imus=[Imu(2, 0.1)],
        lower=[-widest],
        upper=[widest],
        noise=0.1,
        start=[widest],
    )
    assert any("starts at a bound" in note for note in check_design(hinge).notes) == noted


@pytest.mark.parametrize(
    ("std", "words"), [(0.0994, "±99 mm"), (0.0996, "±100 mm"), (0.999, "±999 mm"), (1.0, "not determined")]
)
def test_a_deviation_from_a_metre_on_determines_nothing(std, words):
    assert length_in_words(std) == words


@pytest.mark.parametrize(
    ("information", "undetermined"), [(0.0195, 1), (0.0208, 1), (1.0, 1), (2.0, 1), (8.0, 0)]
)
def test_a_hinge_with_an_imu_has_its_numbers_in_closed_form(information, undetermined):
    """A range of root 12 hundredths has a deviation of 0.01 rad, at 0.1 m 1 mm; readings may know more."""
    box = {"lower": [-0.01 * np.sqrt(3)], "upper": [0.01 * np.sqrt(3)], "noise": 0.01 / np.sqrt(information)}
    imu = Imu(2, 0.1, name="imu", tolerance={"heading": 0.01})
    found = check_design(Robot([BallJoint("x"), Link(0.1)], imus=[imu], **box))
    np.testing.assert_allclose(found.tip, 1e-3 / np.sqrt(information), rtol=1e-9)
    np.testing.assert_allclose(found.tip_within_bounds, 1e-3 / np.sqrt(1 + information), rtol=1e-9)
    # The estimate follows the error of the IMU by the weight of its readings.
    built = 1 / (1 + information) + (information / (1 + information)) ** 2
    np.testing.assert_allclose(found.tip_as_built, 1e-3 * np.sqrt(built), rtol=1e-9)
    assert found.spread == pytest.approx(1e-3, rel=0.1)
    assert found.added == {"imu": pytest.approx(np.log(1 + information) / 2)}
    assert found.idle == ("imu",) * (information < 0.0202)
    assert ("contributes nothing: imu" in repr(found)) == bool(found.idle)
    assert len(found.undetermined) == undetermined  # from half of the deviation on


@pytest.mark.parametrize(
    ("share", "words"),
    [
        ([0.29] * 20, "can work: the tip is known to ±29 mm, to ±29 mm in all but"),
        ([0.31] * 20, "cannot work"),
        (
            [0.29] * 17 + [0.31] * 3,
            "works in part of its workspace: the tip is known to ±29 mm, to ±31 mm in all but",
        ),
        (np.arange(101) / 400, "can work: the tip is known to ±12 mm, to ±24 mm in all but"),  # median, 95 %
    ],
)
def test_a_design_works_below_three_tenths_of_what_the_bounds_leave(share, words):
    assert words in _verdict(*[0.1 * np.array(share)] * 3, 0.1)[1]
