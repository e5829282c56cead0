"""A robot of one's own: what it knows, estimators that take it, the lines in an empty folder, an array of others."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from scipy.optimize import least_squares

import repro
from repro import (
    BallJoint,
    ConstantCurvature,
    Disc,
    FreeBody,
    Imu,
    InputError,
    KalmanFilter,
    LevenbergMarquardt,
    Link,
    Magnet,
    ParticleFilter,
    Robot,
    Sensor,
    load_robot,
    simulated_readings,
    track,
)
from repro.estimators.particle import Box

DATA = Path(__file__).parents[2] / "data"
LINES = (DATA.parent / "README.md").read_text(encoding="utf-8").split("```python\n")[1].split("```")[0]


def chip(**stated) -> Robot:
    """One segment that does not lengthen, a disc in it, a chip and a plain sensor at its tip, and an IMU."""
    magnet = Magnet(Disc(12e-3, 6e-3, 1300.0), 1, 0.06)
    sensors = [
        Sensor(1, 0.09, radial=0.012, axes=3, channels=["a", "b", "c"], range=50.0, noise=[0.1, 0.2, 0.3]),
        Sensor(1, 0.09, radial=0.012, azimuth=1.5, name="edge", resolution=0.01, gain=2.0, offset=0.5),
    ]
    return Robot([ConstantCurvature(0.09, 0.015)], [magnet], sensors, [Imu(1, 0.05, noise=0.01)], **stated)


class TestRobot:
    """What a robot knows of itself."""

    def test_readings_have_names_parts_ranges_and_noise(self):
        robot = chip(noise=0.05, rate_hz=25.0, earth=[0.02, 0.0, 0.04])
        assert robot.names == ("a", "b", "c", "edge", "imu 1 x", "imu 1 y", "imu 1 z")
        assert robot.part_names == ("sensor 1", "edge", "imu 1")
        assert robot.parts.tolist() == [0, 0, 0, 1, 2, 2, 2]
        assert robot.noise.tolist() == [0.1, 0.2, 0.3, 0.05, 0.01, 0.01, 0.01]
        assert robot.range.tolist() == [50.0] * 3 + [np.inf] * 4
        assert robot.resolution.tolist() == [0.0] * 3 + [0.01] + [0.0] * 3
        assert chip().noise is None
        assert chip().lower is None

    def test_its_sensor_model_has_earth_gains_and_offsets(self):
        robot = chip(earth=[0.02, 0.0, 0.04])
        q = [0.004, -0.002, 0.0]
        exact = simulated_readings(robot, q, [0.02, 0.0, 0.04])
        exact[3] = 2 * exact[3] + 0.5
        np.testing.assert_allclose(robot.sensing()(q), exact, atol=2e-3)

    def test_rotations_need_no_bounds(self):
        robot = Robot(
            [FreeBody(), BallJoint("x")], lower=[-1, -2, -3] + [np.nan] * 4, upper=[1, 2, 3] + [np.inf] * 4
        )
        assert robot.upper.tolist() == [1, 2, 3] + [np.pi] * 4
        assert Robot([BallJoint("xy")]).lower.tolist() == [-np.pi] * 2

    def test_another_robot_keeps_what_is_not_changed(self):
        robot = chip(
            noise=0.05, rate_hz=25.0, lower=[-0.01] * 2 + [0.0], upper=[0.01] * 2 + [0.0], start=[0.0] * 3
        )
        other = robot.replaced(imus=[])
        assert (other.rate_hz, other.n_readings, other.fixed.tolist()) == (25.0, 4, [False, False, True])
        assert other.start.tolist() == [0.0] * 3

    @pytest.mark.parametrize(
        ("made", "message"),
        [
            (lambda: chip(lower=[-1.0] * 3, upper=[-2.0] * 3), "ordered bounds for delta_x_1; instead received"),
            (lambda: chip(lower=[-1.0] * 3), "upper of Robot must be finite for delta_x_1; instead received nan"),
            (lambda: chip(lower=[-1.0] * 2, upper=[1.0] * 2), "lower of Robot must be numbers of shape (3)"),
            (lambda: chip(lower=[-1] * 3, upper=[1] * 3, start=[2, 0, 0]), "start of Robot must be within the"),
            (lambda: chip(noise=[0.1, 0.2]), "noise of Robot must be one number or one for each of 7 readings"),
            (lambda: chip(noise=-1.0), "noise of Robot must be positive"),
            (lambda: chip(rate_hz=0.0), "rate_hz of Robot must be positive"),
            (lambda: Sensor(1, 0.1, axes=3, channels=["a"]), "channels of Sensor must be a list of 3, one for"),
            (lambda: Sensor(1, 0.1, channels="B"), "channels of Sensor must be a list of 1, one for every axis"),
            (lambda: Sensor(1, 0.1, range=-1.0), "resolution of Sensor must be from 0 to below the range"),
            (lambda: Sensor(1, 0.1, range=1.0, resolution=2.0), "resolution of Sensor must be from 0 to below the"),
            (lambda: Sensor(1, 0.1, gain=[1.0, 2.0]), "gain of Sensor must be one number or 1"),
            (lambda: Sensor(1, 0.1, noise=0.0), "noise of Sensor must be positive [mT]"),
            (lambda: Sensor(1, 0.1, per_mt=0.0), "per_mt of Sensor must be not zero"),
            (lambda: Sensor(1, 0.1, tolerance={"tlt": 0.1}), "azimuth, tilt, gain, offset; instead received 'tlt'"),
            (lambda: Imu(1, 0.1, tolerance={"tilt": -0.1}), "tolerance tilt of Imu must be not negative"),
            (lambda: Imu(1, 0.1, noise=0.0), "noise of Imu must be positive [rad]"),
            (lambda: Imu(1, 0.1, world=[0, 0, 0, 2]), "world of Imu must be unit quaternions XYZW"),
        ],
    )  # fmt: skip
    def test_what_cannot_be_is_refused(self, made, message):
        with pytest.raises(InputError, match=re.escape(message)):
            made()


@pytest.fixture(scope="module")
def arm() -> Robot:
    return load_robot(repro.example() / "robot.toml")


@pytest.fixture(scope="module")
def motion(arm) -> np.ndarray:
    """A slow swing of the example's arm, simulated, whose fixed coordinates stay."""
    t = np.arange(60) / arm.rate_hz
    return (
        0.006 * np.sin(2 * np.pi * t[:, None] * [0.2, 0.3, 0.0, 0.25, 0.15, 0.0] + np.arange(6)) * ~arm.fixed
    )


class TestEstimators:
    """Estimators take a robot: bounds, noise and start are its own, and what it fixes stays fixed."""

    def test_a_robot_stands_for_its_model_bounds_and_noise(self, arm, motion):
        u = arm.sensing()(motion[:5])
        rounding = arm.resolution / np.sqrt(12)
        given = LevenbergMarquardt(arm.sensing(), arm.lower, arm.upper, np.hypot(arm.noise, rounding))
        shapes = [track(fit, u, motion[0], rate_hz=25).q for fit in (LevenbergMarquardt(arm), given)]
        np.testing.assert_allclose(*shapes, atol=1e-14)
        with pytest.raises(
            InputError, match="noise of LevenbergMarquardt must be given, or stated by the robot"
        ):
            LevenbergMarquardt(chip(lower=[-0.01] * 3, upper=[0.01] * 3))
        with pytest.raises(InputError, match="lower of KalmanFilter must be given, or stated by the robot"):
            KalmanFilter(chip(noise=0.1))

    @pytest.mark.parametrize("kind", [LevenbergMarquardt, KalmanFilter])
    def test_a_fixed_coordinate_is_known_without_variance(self, arm, motion, kind):
        """As if the robot had no such coordinate."""
        u = simulated_readings(arm, motion) + 0.005 * np.random.default_rng(0).standard_normal((60, 12))
        shape = track(kind(arm), u, motion[0], rate_hz=25)
        assert not shape.q[:, arm.fixed].any()
        assert not shape.covariance[:, arm.fixed].any()
        assert not shape.covariance[:, :, arm.fixed].any()
        shorter = [ConstantCurvature(s.length, s.radius, extensible=False) for s in arm.segments]
        free = ~arm.fixed
        without = arm.replaced(segments=shorter, lower=arm.lower[free], upper=arm.upper[free])
        other = track(kind(without), u, motion[0, free], rate_hz=25)
        np.testing.assert_allclose(shape.q[:, free], other.q, atol=1e-9)
        np.testing.assert_allclose(
            shape.covariance[:, free][:, :, free], other.covariance, rtol=1e-5, atol=1e-14
        )
        np.testing.assert_array_equal(shape.dof, other.dof)

    def test_what_is_known_besides(self, arm, motion):
        fit = LevenbergMarquardt(arm)
        known = np.where(np.arange(6) == 1, motion[3], np.nan)
        _, estimate = fit.step(fit.init(motion[3]), arm.sensing()(motion[3]), known=known)
        assert np.flatnonzero(estimate.covariance.diagonal() == 0).tolist() == [1, 2, 5]
        np.testing.assert_allclose(estimate.q, motion[3], atol=1e-8)

    def test_particles_keep_fixed_coordinates(self, arm, motion):
        method = ParticleFilter(arm, particles=300)
        assert repr(method).endswith("half of each range in a second")
        state, estimate = method.step(method.init(seed=1), arm.sensing()(motion[0]))
        assert not state.q[:, arm.fixed].any()
        assert (np.abs(state.q) <= arm.upper).all()
        assert not estimate.covariance[arm.fixed].any()
        assert estimate.dof == 12 - 4
        with pytest.raises(InputError, match="process_noise of ParticleFilter must be given without a robot"):
            ParticleFilter(lambda q: q, noise=1.0)

    def test_estimators_start_where_the_robot_does(self, arm, motion):
        robot = arm.replaced(start=motion[7])
        np.testing.assert_array_equal(LevenbergMarquardt(robot).init().q, motion[7])
        np.testing.assert_array_equal(KalmanFilter(robot).init().q, motion[7])
        cloud = ParticleFilter(robot).init().q
        assert np.abs(cloud.mean(0) - motion[7]).max() < 1e-4
        assert LevenbergMarquardt(arm).init().q is None

    def test_the_rules_of_thumb_are_said(self, arm):
        method = KalmanFilter(arm)
        np.testing.assert_allclose(method.acceleration, [0.012, 0.012, 0.0] * 2)
        np.testing.assert_allclose(method.velocity, [0.012, 0.012, 0.0] * 2)
        assert repr(method).endswith("[unit/s^1.5], by the rule of thumb: half of each range")
        own = KalmanFilter(arm, acceleration=np.full(6, 0.1), velocity=np.full(6, 0.1))
        assert "rule" not in repr(own)
        assert not own.acceleration[arm.fixed].any()
        np.testing.assert_allclose(ParticleFilter(arm).process_noise, np.array([0.024, 0.024, 0.0] * 2) / 50)
        np.testing.assert_allclose(ParticleFilter(arm.replaced(rate_hz=None)).process_noise[0], 0.024 / 50)
        np.testing.assert_allclose(ParticleFilter(arm.replaced(rate_hz=1.0)).process_noise[0], 0.024 / 10)

    def test_angles_have_no_bounds_for_particles(self):
        box = Box([-1.0, -np.pi], [1.0, np.pi], [False, True])
        assert box.contains(np.array([[0.5, 9.0], [1.5, 0.0]])).tolist() == [True, False]

    def test_a_hinge_over_one_chip(self):
        """Three readings, one unknown angle of two; the other is fixed."""
        magnet, sensor = (
            Magnet(repro.Cube(4e-3, 1300.0), 2, 6e-3),
            Sensor(0, 0.0, position=[0, 0, -8e-3], axes=3),
        )
        limits = {"lower": [-0.7, 0.1], "upper": [0.7, 0.1], "noise": 0.006}
        robot = Robot([BallJoint("xy"), Link(0.012)], [magnet], [sensor], **limits)
        shape = track(LevenbergMarquardt(robot), [robot.sensing()([0.3, 0.1])])
        np.testing.assert_allclose(shape.q, [[0.3, 0.1]], atol=1e-6)
        assert shape.dof.tolist() == [2]


def test_the_lines_of_the_design_run_in_an_empty_folder(tmp_path):
    """As a newcomer has them after installing: example data come with the package."""
    source = os.pathsep.join([str(Path(repro.__file__).parents[1]), os.environ.get("PYTHONPATH", "")])
    environment = {**os.environ, "PYTHONPATH": source, "MPLBACKEND": "agg"}
    tips = "robot.tip(shape.q[::5])[:, :3, 3] - robot.tip(found.q)[:, :3, 3]"
    command = [
        sys.executable,
        "-W",
        "ignore",
        "-c",
        f"{LINES}\nprint(len(shape.q), 1e3 * abs({tips}).mean() < 1)",
    ]
    done = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True, check=False)
    assert "This robot can work" in done.stdout, done.stderr
    assert done.stdout.endswith("200 True\n"), done.stderr
    assert (tmp_path / "estimates.csv").stat().st_size > 10_000
    assert {file.name for file in repro.example().iterdir()} == {"robot.toml", "mine.csv", "poses.csv"}


class TestMagnetArray:
    """A magnet before sixteen chips, simulated by others (data/magnet_array): nothing of it is our own code's."""

    @pytest.fixture(scope="class")
    @classmethod
    def array(cls):
        robot = load_robot(DATA / "magnet_array" / "robot.toml")
        truth = np.loadtxt(DATA / "magnet_array" / "magnet.csv", delimiter=",", skiprows=1)
        return robot, robot.readings(DATA / "magnet_array" / "readings.csv"), truth

    def test_the_covariance_says_how_exact_the_pose_is(self, array):
        robot, readings, truth = array
        shape = track(LevenbergMarquardt(robot), readings, times=readings.times)
        error = shape.q[:, :3] - truth[:, 1:4] * 1e-3
        nees = np.einsum("ti,tij,tj->t", error, np.linalg.inv(shape.covariance[:, :3, :3]), error) / 3
        assert 0.6 <= nees.mean() <= 1.4
        assert 0.9 <= shape.chi2.sum() / shape.dof.sum() <= 1.1

    def test_magpylib_and_scipy_end_in_the_same_place(self, array):
        robot, readings, _ = array
        gain, offset = robot.per_reading("gain", 1, 1), robot.per_reading("offset", 0, 0)
        shape = track(LevenbergMarquardt(robot), readings[:1])

        def residual(q):
            return (gain * simulated_readings(robot, q) + offset - readings[0]) / 0.003

        found = least_squares(residual, shape.q[0], method="lm", x_scale=[0.01] * 3 + [0.5] * 3)
        np.testing.assert_allclose(shape.q[0, :3], found.x[:3], atol=2e-5)


def test_files_frames_and_readings_are_one_and_bring_their_times(tmp_path):
    """Nothing that a robot file or a table says is repeated by hand."""
    robot, file = load_robot(repro.example() / "robot.toml"), tmp_path / "gap.csv"
    pd.read_csv(repro.example() / "mine.csv").drop(index=range(50, 60)).to_csv(file, index=False)
    readings = robot.readings(file)
    expected = track(repro.KalmanFilter(robot), np.asarray(readings), times=readings.times)
    for given in (readings, file, str(file), pd.read_csv(file)):
        found = track(repro.KalmanFilter(robot), given)
        np.testing.assert_array_equal(found.q, expected.q)
        np.testing.assert_array_equal(found.times, readings.times)
    without = pd.read_csv(file).drop(columns="time_s")
    by_rate = track(repro.KalmanFilter(robot), without)  # 25 Hz, as the robot file says
    np.testing.assert_allclose(by_rate.times, np.arange(190) / 25)


def test_calibration_takes_tables(tmp_path):
    robot = load_robot(repro.example() / "robot.toml")
    q = np.random.default_rng(0).uniform(robot.lower, robot.upper, (30, robot.n_q))
    u = simulated_readings(robot, q)
    free = np.flatnonzero(~robot.fixed)
    poses = pd.DataFrame({f"{robot.coordinates[c]}_mm": 1e3 * q[:, c] for c in free})
    readings = pd.DataFrame(dict(zip(robot.names, u.T, strict=True)))
    poses.to_csv(tmp_path / "poses.csv", index=False)
    expected = repro.calibrate(robot, q, u)
    for source in (poses, tmp_path / "poses.csv"):
        found = repro.calibrate(robot, source, readings)
        np.testing.assert_allclose(found.estimate, expected.estimate, rtol=0, atol=1e-9)
    poses.iloc[7, 0] *= 1000
    poses.to_csv(tmp_path / "poses.csv", index=False)
    for source, where in ((poses, "the table, line 8"), (tmp_path / "poses.csv", "poses.csv, line 9")):
        with pytest.raises(
            InputError, match=rf"must be within the robot's bounds, for delta_x_1 .* in {where}"
        ):
            repro.calibrate(robot, source, readings)


def test_poses_and_readings_of_two_clocks_are_refused():
    robot = load_robot(repro.example() / "robot.toml")
    q = np.random.default_rng(0).uniform(robot.lower, robot.upper, (20, robot.n_q))
    poses = pd.DataFrame({f"{name}_mm": 1e3 * x for name, x in zip(robot.coordinates, q.T, strict=True)})
    readings = pd.DataFrame(dict(zip(robot.names, simulated_readings(robot, q).T, strict=True)))
    times = np.arange(20) / 5
    with pytest.raises(InputError, match="times of calibrate must be those of the poses"):
        repro.calibrate(robot, poses.assign(time_s=times), readings.assign(time_s=times + 100))
    poses.iloc[3, 1] = np.nan
    with pytest.raises(InputError, match="line 4, must be a number for delta_y_1; instead received none"):
        repro.calibrate(robot, poses, readings)


def test_an_impossible_number_ends_nothing():
    robot = load_robot(repro.example() / "robot.toml")
    u = np.asarray(robot.readings(repro.example() / "mine.csv")).copy()
    u[50, 2] = 1e200
    found = track(LevenbergMarquardt(robot), u)
    assert found.missing[50] == 1
    assert np.isfinite(found.q).all()


@pytest.mark.skipif(
    not hasattr(os, "getuid") or os.getuid() != 0, reason="only root can become somebody else"
)
def test_a_user_without_a_home_can_work(tmp_path):
    """As in some containers: no HOME, no entry among the users. Kernels are compiled for the process alone."""
    code = (
        "import os; os.setgroups([]); os.setresgid(12345, 12345, 12345); os.setresuid(12345, 12345, 12345)\n"
        "from repro.common import cache_folder, kernel\n"
        "assert str(cache_folder()).startswith(os.devnull), cache_folder()\n"
        "@kernel(entry=True)\ndef twice(x):\n    return 2 * x\nassert twice(21) == 42"
    )
    file = tmp_path / "homeless.py"
    file.write_text(code)
    kept = {name: value for name, value in os.environ.items() if name in ("PATH", "PYTHONPATH")}
    environment = kept | {"PYTHONPATH": os.pathsep.join(sys.path)}
    # Its modules are loaded before it changes: they may lie in a folder of root's.
    preload = "import numba, platformdirs, repro.common; numba.njit(lambda x: x)(1)\n"
    file.write_text(preload + code)
    done = subprocess.run(
        [sys.executable, file], env=environment, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr[-2000:]
