"""Readings of a described robot: the motion, the robot as built, and what its sensors read."""

from pathlib import Path

import numpy as np
import pytest
import torch
from moving_robot import robot_readings
from scipy.spatial.transform import Rotation

from edition1.errors import InputError
from edition1.estimation.base import track
from edition1.estimation.levenberg_marquardt import LevenbergMarquardt, jacobian
from edition1.robot_file._tables import IMU_NOISE_RAD
from edition1.robot_file.load import load_robot
from edition1_live.emulate.robot_readings import (
    REACH,
    SPEED,
    course,
    readings_along,
    true_robot,
)
from edition1_live.follow.robot_estimator import robot_estimator
from edition1_live.robot.calibrate import Priors

ROBOTS = Path(__file__).parents[3] / "data" / "robots"
NAMES = ("one_segment", "two_segments", "three_segments", "bend_sensor", "imu_arm")
MAGNETIC = NAMES[:-1]


def robot(name):
    return load_robot(ROBOTS / f"{name}.toml")


@pytest.mark.parametrize("seed", [0, 1])
@pytest.mark.parametrize("name", NAMES)
def test_the_motion_keeps_to_its_bounds_and_its_speed(name, seed):
    """Every coordinate moves, within the bounds, up to the speed and not above, from rest where estimators start."""
    found = robot(name)
    time_s = np.arange(0, 60, 1e-3)
    q = course(found, time_s, seed=seed)
    low, high = found.lower.numpy(), found.upper.numpy()
    share = (q - (low + high) / 2) / ((high - low) / 2)
    assert (np.abs(share) <= REACH).all()
    assert (np.ptp(share, axis=0) > 1.5 * REACH).all()
    speed = np.diff(q, axis=0) / 1e-3 / (high - low)
    assert (np.abs(speed) <= SPEED).all()
    assert (np.abs(speed).max(axis=0) > 0.8 * SPEED).all()
    assert np.abs(q[0] - found.start.numpy()).max() < 1e-15
    assert np.abs(speed[0]).max() < 2e-3 * SPEED
    # smooth: what changes of the acceleration in a millisecond is a thousandth of what the motion begins with
    jerk = np.abs(np.diff(speed, n=2, axis=0)) / 1e-6
    assert jerk.max() < 40 * SPEED


def test_a_motion_is_the_same_in_parts():
    found = robot("two_segments")
    whole = robot_readings(found, duration_s=2.0, seed=3, tolerances=1.0)
    parts = [
        robot_readings(found, duration_s=1.0, start_s=start, seed=3, tolerances=1.0) for start in (0.0, 1.0)
    ]
    assert np.array_equal(whole.q, np.concatenate([part.q for part in parts]))
    assert np.array_equal(whole.time_s, np.concatenate([part.time_s for part in parts]))
    assert torch.equal(whole.robot.offset, parts[1].robot.offset)
    assert not np.array_equal(whole.values[100:], parts[1].values)  # noise of its own
    again = robot_readings(found, duration_s=2.0, seed=3, tolerances=1.0)
    assert np.array_equal(whole.values, again.values)
    assert not np.array_equal(whole.q, course(found, whole.time_s, seed=4))


@pytest.mark.parametrize("name", MAGNETIC)
def test_noise_is_as_stated(name):
    found = robot(name)
    noisy = robot_readings(found, duration_s=4000 / found.rate_hz)
    clean = readings_along(found, noisy.time_s, noisy.q)
    z = (noisy.values - clean.values) / found.noise
    assert abs(z.std() - 1) < 0.05
    assert np.abs(np.corrcoef(z.T) - np.eye(found.channels)).max() < 0.1


@pytest.mark.parametrize("name", ["one_segment", "two_segments", "three_segments"])
def test_readings_agree_with_the_series_of_the_estimators(name):
    """The ring's series stops at the ninth order: what is left is smaller than the noise, and not zero."""
    found = robot(name)
    clean = readings_along(found, *along(found))
    series = found.values(torch.from_numpy(clean.q)).numpy()
    assert 0 < np.abs(clean.values - series).max() < found.noise


def along(found, n=50):
    time_s = np.linspace(0, 30, n)
    return time_s, course(found, time_s)


def test_gains_offsets_channels_and_the_earth(tmp_path):
    """Two sensors exchanged, in mV, on a board of five channels, in an Earth field."""
    text = (ROBOTS / "one_segment.toml").read_text()
    plain = load_robot(ROBOTS / "one_segment.toml")
    text = text.replace('unit = "mT"', 'unit = "mV"').replace(
        "noise_mt = 7.1e-4", "noise_mv = 1\nchannels = 5"
    )
    for k, channel in ((1, 4), (2, 2), (3, 1)):
        row = f"channel = {channel}\ngain_mv_per_mt = {10.0 * k}\noffset_mv = {100.0 * k}\n"
        text = text.replace(f"channel = {k}\nsegment", f"{row}segment")
    path = tmp_path / "robot.toml"
    path.write_text("earth_mt = [0.01, 0.02, -0.04]\n" + text)
    found = load_robot(path)
    time_s, q = along(found)
    field = readings_along(plain, time_s, q).values
    axes = found.robot.sensor_poses(torch.from_numpy(q))[..., :3, 2].numpy()
    field = field + axes @ np.array([0.01, 0.02, -0.04])
    values = readings_along(found, time_s, q).values
    for k, channel in ((1, 4), (2, 2), (3, 1)):
        np.testing.assert_allclose(
            values[:, channel - 1], 100.0 * k + 10.0 * k * field[:, k - 1], rtol=0, atol=1e-9
        )
    assert not values[:, [2, 4]].any()


def test_true_robots_are_off_by_the_tolerances():
    """Over many seeds offsets, gains and the Earth field scatter as the priors say; 0 is the drawing itself."""
    found = robot("two_segments")
    assert true_robot(found, 0.0) is found
    drawn = [true_robot(found, 1.0, seed=seed) for seed in range(200)]
    off = torch.stack([d.offset for d in drawn])
    assert abs(float(off.std()) / Priors().offset_mt - 1) < 0.1
    gain = torch.stack([d.gain - 1 for d in drawn])
    assert abs(float(gain.std()) / Priors().placement.sensor_gain - 1) < 0.1
    earth = torch.stack([d.earth_mt for d in drawn])
    assert abs(float(earth.std()) / Priors().earth_mt - 1) < 0.15
    polarisations = [d.magnet.polarisation_mt for d in drawn if d.magnet is not None]
    strength = np.array(polarisations) / 1450.0 - 1
    assert abs(strength.std() / Priors().placement.moments - 1) < 0.15
    place = torch.stack([d.robot.magnets.local[:, :3, 3] for d in drawn])
    assert abs(float(place.std()) / Priors().placement.magnet_position_m - 1) < 0.1
    half = true_robot(found, 0.5, seed=3)
    torch.testing.assert_close(half.offset, 0.5 * drawn[3].offset)


def test_least_squares_finds_the_motion():
    """From the readings of the robot as drawn the estimate is the truth within its noise."""
    found = robot("two_segments")
    made = robot_readings(found, duration_s=0.6)
    method = LevenbergMarquardt(found.sensing(), found.lower, found.upper, noise_mt=found.noise)
    estimates = track(method, torch.from_numpy(made.values), found.start)
    error = (estimates.q - torch.from_numpy(made.q)).numpy() * 1e3
    assert np.abs(error).max() < 6 * 0.018


def test_two_segments_are_as_well_determined_as_the_file_says():
    found = robot("two_segments")
    draw = torch.rand(500, 6, dtype=torch.float64, generator=torch.Generator().manual_seed(0))
    width = found.upper - found.lower
    _, J = jacobian(found.sensing(), found.lower + width * draw)
    J = J * width / found.noise
    deviation = torch.linalg.inv(J.mT @ J).diagonal(dim1=-2, dim2=-1).sqrt() * width * 1e6
    assert float(deviation.max()) < 19
    assert float(torch.linalg.cond(J).max()) < 7


def test_imus_read_the_orientation_of_the_backbone():
    """The chain of arcs, fed with them, gives the tip of the robot."""
    found = robot("imu_arm")
    clean = readings_along(found, *along(found, 5))
    assert clean.values.shape == (5, 0)
    T = found.robot.base_poses(torch.from_numpy(clean.q))[:, 1:, :3, :3].numpy()
    assert np.abs(Rotation.from_quat(clean.orientations[2]).as_matrix() - T[2]).max() < 1e-12
    noisy = readings_along(found, clean.time_s, clean.q, rng=np.random.default_rng(0))
    off = Rotation.from_quat(clean.orientations.reshape(-1, 4)).inv() * Rotation.from_quat(
        noisy.orientations.reshape(-1, 4)
    )
    assert abs(off.as_rotvec().std() / IMU_NOISE_RAD - 1) < 0.2
    method = robot_estimator(found)
    sent = list(clean.readings())
    assert [reading.stream for reading in sent[:9]] == [*range(8), 0]
    state = method.method.init(method.start, seed=0)
    u = torch.tensor([(0.0, 0.0, 0.0, 1.0), *(reading.values for reading in sent[16:24])]).flatten()
    _, estimate = method.method.step(state, u.double(), 0.0)
    straight = found.robot.tip(torch.from_numpy(clean.q[2] * 1.0))[:3, 3]
    stretch = clean.q[2][2::3].sum()  # which IMUs do not see
    assert float((estimate.q[-3:] - straight).norm()) < abs(stretch) + 0.01


def test_negative_tolerances_are_refused():
    with pytest.raises(
        InputError, match="^Input tolerances of true_robot must be 0 or more; instead received -1.0.$"
    ):
        true_robot(robot("one_segment"), -1.0)
