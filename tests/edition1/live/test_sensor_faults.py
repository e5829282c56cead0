"""Faults of sensors: each does what it says to its sensor, from its time on, and nothing to anything else."""

from pathlib import Path

import numpy as np
import pytest
import torch
from moving_robot import robot_readings

from edition1.errors import InputError
from edition1.robot_file._tables import IMU_NOISE_RAD
from edition1.robot_file.load import load_robot
from edition1_live.emulate.faults import Faults, faults_named
from edition1_live.emulate.robot_readings import readings_along
from edition1_live.emulate.sensor_faults import (
    SensorFaults,
    saturation_level,
    with_sensor_faults,
)

ROBOTS = Path(__file__).parents[3] / "data" / "robots"
FROM_S, SINCE = 4.0, 400
K = 3


def robot(name="two_segments"):
    return load_robot(ROBOTS / f"{name}.toml")


@pytest.fixture(scope="module")
def made():
    return robot_readings(robot(), duration_s=10.0, tolerances=1.0, seed=1)


def broken(made, **faults):
    return with_sensor_faults(made, SensorFaults(**faults), from_s=FROM_S).values


@pytest.mark.parametrize(
    "faults",
    [{name: K} for name in ("unplug", "stick", "saturate", "gain", "nan")]
    + [{"magnet": 80.0}, {"noise": 5.0}],
    ids=lambda faults: next(iter(faults)),
)
def test_before_its_time_and_beside_its_sensor_nothing_changes(made, faults):
    given = made.values.copy()
    found = broken(made, **faults)
    assert np.array_equal(made.values, given)  # what it was given stays as it is
    assert np.array_equal(found[:SINCE], given[:SINCE])
    assert not np.array_equal(found[SINCE:], given[SINCE:], equal_nan=True)
    if K in faults.values():
        others = np.arange(8) != K - 1
        assert np.array_equal(found[:, others], given[:, others])
    assert np.array_equal(found, broken(made, **faults), equal_nan=True)  # same seed, same bits


def test_what_each_fault_reads(made):
    was, offset = made.values[SINCE:, K - 1], float(made.robot.offset[K - 1])
    assert offset != 0
    assert not broken(made, unplug=K)[SINCE:, K - 1].any()
    assert set(broken(made, stick=K)[SINCE:, K - 1]) == {made.values[SINCE - 1, K - 1]}
    assert np.isnan(broken(made, nan=K)[SINCE:, K - 1]).all()
    np.testing.assert_allclose(
        broken(made, gain=K)[SINCE:, K - 1], offset + 1.05 * (was - offset), rtol=1e-12
    )
    clipped, level = broken(made, saturate=K)[SINCE:, K - 1], saturation_level(made.robot, K)
    assert np.abs(clipped - offset).max() == pytest.approx(level)
    assert 0.2 < (clipped != was).mean() < 0.8


def test_noise_is_so_many_times_that_of_the_file(made):
    clean = readings_along(made.robot, made.time_s, made.q).values
    z = (broken(made, noise=5.0) - clean) / made.robot.noise
    assert abs(z[:SINCE].std() - 1) < 0.1
    assert abs(z[SINCE:].std() / 5 - 1) < 0.05


def test_a_foreign_magnet_is_a_dipole():
    """On its axis and beside it, at the tip of the straight robot: mu_0 m / 4 pi d^3 times 2 or -1 along z."""
    found = robot("one_segment")
    q = found.start[None].numpy()
    still = readings_along(found, np.zeros(1), q)
    far = with_sensor_faults(still, SensorFaults(magnet=1e3)).values - still.values
    positions = found.robot.sensor_poses(torch.from_numpy(q))[0, :, :3, 3].numpy()
    d = positions - np.array([1.0, 0.0, found.robot.length / 2])
    r = np.linalg.norm(d, axis=1)
    along_z = 1e-7 * 1e3 * (3 * d[:, 2] ** 2 / r**5 - 1 / r**3)
    np.testing.assert_allclose(far[0], -along_z, rtol=1e-6)  # the sensors measure towards the base


def test_a_sensor_that_is_stuck_stays_so_in_the_next_part():
    found = robot()
    parts = [robot_readings(found, duration_s=1.0, start_s=start) for start in (0.0, 1.0)]
    whole = np.concatenate([part.values for part in parts])
    fault, before, values = SensorFaults(stick=K), None, []
    for part in parts:
        before = with_sensor_faults(part, fault, from_s=0.5, before=before)
        values.append(before.values)
    assert set(np.concatenate(values)[50:, K - 1]) == {whole[49, K - 1]}
    first = with_sensor_faults(parts[0], fault).values[:, K - 1]
    assert set(first) == {whole[0, K - 1]}


def test_imus():
    """An unplugged one sends nothing, a stuck one repeats, and noise turns them."""
    made = robot_readings(robot("imu_arm"), duration_s=4.0)
    gone = with_sensor_faults(made, SensorFaults(unplug=2), from_s=2.0)
    streams = [reading.stream for reading in gone.readings() if reading.time_s >= 2.0]
    assert 1 not in streams
    assert set(streams) == {0, *range(2, 8)}
    stuck = with_sensor_faults(made, SensorFaults(stick=2), from_s=2.0).orientations[62:, 1]
    assert (stuck == made.orientations[61, 1]).all()
    noisy = with_sensor_faults(made, SensorFaults(noise=5.0)).orientations.reshape(-1, 4)
    clean = readings_along(made.robot, made.time_s, made.q).orientations.reshape(-1, 4)
    angle = 2 * np.arccos(np.clip(np.abs((noisy * clean).sum(-1)), -1, 1))
    assert abs(np.sqrt((angle**2).mean() / 3) / (5 * IMU_NOISE_RAD) - 1) < 0.1


def test_names_and_values():
    given = [("unplug", "3"), ("magnet", "80"), ("stalls", "0.1"), ("noise", "5")]
    found = faults_named(given, Faults, SensorFaults)
    assert found == (Faults(stalls=0.1), SensorFaults(unplug=3, magnet=80.0, noise=5.0))


@pytest.mark.parametrize(
    ("given", "message"),
    [
        (
            [("gain", "0")],
            "Input gain of repro emulate must be the number of a sensor, from 1; instead received '0'.",
        ),
        (
            [("gain", "1.5")],
            "Input gain of repro emulate must be the number of a sensor, from 1; instead received '1.5'.",
        ),
        (
            [("nan", "1"), ("nan", "2")],
            "Input fault of repro emulate must be given once; instead received nan twice.",
        ),
        (
            [("noise", "0.5")],
            "Input noise of SensorFaults must be 1 or more, times that of the file; instead received 0.5.",
        ),
        (
            [("magnet", "-3")],
            "Input magnet of SensorFaults must be its distance from the robot [mm]; instead received -3.0.",
        ),
    ],
)
def test_messages(given, message):
    with pytest.raises(InputError) as raised:
        faults_named(given, Faults, SensorFaults)
    assert str(raised.value) == message


@pytest.mark.parametrize(
    ("name", "faults", "message"),
    [
        (
            "two_segments",
            SensorFaults(unplug=9),
            "Input unplug of two_segments.toml must be the number of a sensor, 1 to 8; instead received 9.",
        ),
        (
            "imu_arm",
            SensorFaults(gain=1),
            "Input fault of imu_arm.toml must be unplug, stick or noise for IMUs; instead received gain.",
        ),
        (
            "imu_arm",
            SensorFaults(magnet=50.0),
            "Input fault of imu_arm.toml must be another one for a robot with IMUs; instead received magnet.",
        ),
    ],
)
def test_a_robot_cannot_have_every_fault(name, faults, message):
    with pytest.raises(InputError) as raised:
        faults.check(robot(name))
    assert str(raised.value) == message
