"""IMU errors: laws of the processes, each error by itself, exact readings without errors."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from edition1.errors import InputError
from edition1_companion.twins.imu_errors import (
    PERFECT,
    ImuErrors,
    continuous_signs,
    ornstein_uhlenbeck,
    read_imus,
)

IMUS = 8
AXES = np.random.default_rng(7).standard_normal((IMUS, 3))
UPRIGHT = np.array([0.0, 0.0, 0.0, 1.0])


def moving(time_s):
    """IMUs that turn at constant rates about fixed axes."""
    turns = np.asarray(time_s)[:, None, None] * AXES
    return Rotation.from_rotvec(turns.reshape(-1, 3)).as_quat().reshape(len(time_s), IMUS, 4)


def still(time_s):
    return np.broadcast_to(UPRIGHT, (len(time_s), IMUS, 4))


def read(orientations_at=still, duration_s=10.0, seed=0, **changes):
    errors = replace(PERFECT, **changes)
    return read_imus(orientations_at, start_s=0.0, stop_s=duration_s, errors=errors, seed=seed)


def rotvecs(orientations):
    return Rotation.from_quat(orientations.reshape(-1, 4)).as_rotvec().reshape(*orientations.shape[:-1], 3)


def test_perfect_sensors_tell_the_truth_of_their_time_stamps():
    readings = read(moving)
    np.testing.assert_allclose(np.diff(readings.time_s, axis=0), 1 / 31, atol=1e-12)
    np.testing.assert_allclose(np.diff(readings.time_s, axis=1), 0.0038, atol=1e-12)
    true = np.stack([moving(readings.time_s[:, i])[:, i] for i in range(IMUS)], axis=1)
    np.testing.assert_allclose(np.abs((readings.orientations * true).sum(-1)), 1.0, atol=1e-12)


def test_latency_makes_readings_old():
    late, now = read(moving, latency_s=0.01), read(moving)
    np.testing.assert_allclose(late.time_s, now.time_s + 0.01, atol=1e-12)
    np.testing.assert_array_equal(late.orientations, now.orientations)


@pytest.mark.parametrize(("std", "time_s"), [(2.0, 40.0), (1.0, 3.0)])
def test_ornstein_uhlenbeck_is_stationary_with_its_correlation_time(std, time_s):
    rng = np.random.default_rng(0)
    x = ornstein_uhlenbeck((1000, 4000), 0.1, std=std, time_s=time_s, rng=rng)
    for k in (0, 10, 500, 999):  # from the first sample on
        assert x[k].std() == pytest.approx(std, rel=0.05)
    for seconds in (1.0, 3.0, 10.0):
        lag = round(seconds / 0.1)
        correlation = (x[:-lag] * x[lag:]).mean() / (x**2).mean()
        assert correlation == pytest.approx(np.exp(-seconds / time_s), abs=0.03)


def test_each_error_has_its_standard_deviation_about_its_axes():
    """Over many seeds; with an upright arm, sensor and world axes coincide."""
    degree = float(np.radians(1.0))

    def of(**changes):
        seeds = [read(duration_s=0.03, seed=seed, **changes).orientations[0] for seed in range(300)]
        return rotvecs(np.stack(seeds)).reshape(-1, 3) / degree

    np.testing.assert_allclose(of(mounting_rad=3 * degree).std(axis=0), [3, 3, 3], rtol=0.07)
    np.testing.assert_allclose(of(heading_offset_rad=6 * degree).std(axis=0), [0, 0, 6], rtol=0.07, atol=1e-9)
    np.testing.assert_allclose(of(heading_wander_rad=2 * degree).std(axis=0), [0, 0, 2], rtol=0.07, atol=1e-9)
    np.testing.assert_allclose(of(tilt_static_rad=degree).std(axis=0), [1, 1, 0], rtol=0.07, atol=1e-9)
    np.testing.assert_allclose(of(tilt_dynamic_rad=degree).std(axis=0), [1, 1, 0], rtol=0.07, atol=1e-9)


def test_constant_errors_are_constant_and_the_others_are_not():
    def wobble(**changes):
        return np.degrees(np.ptp(rotvecs(read(**changes).orientations), axis=0).max())

    assert wobble(mounting_rad=0.1, heading_offset_rad=0.1, tilt_static_rad=0.1) < 1e-9
    assert wobble(heading_wander_rad=0.1) > 0.1
    assert wobble(tilt_dynamic_rad=0.1) > 0.1


def test_heading_turns_about_the_vertical_and_mounting_about_the_sensor():
    """On a sensor that lies down, a heading error is about the vertical, a mounting error about the sensor's axes."""
    down = Rotation.from_rotvec([np.pi / 2, 0.0, 0.0])

    def lying(time_s):
        return np.broadcast_to(down.as_quat(), (len(time_s), IMUS, 4))

    headed = Rotation.from_quat(read(lying, heading_offset_rad=0.3).orientations[0])
    assert np.abs(headed.apply([0, 0, 1])[:, 2]).max() < 1e-12
    assert np.abs((headed * down.inv()).as_rotvec()[:, :2]).max() < 1e-12
    mounted = down.inv() * Rotation.from_quat(read(lying, mounting_rad=0.1).orientations[0])
    upright = rotvecs(read(mounting_rad=0.1).orientations[0])
    np.testing.assert_allclose(mounted.as_rotvec(), upright, atol=1e-12)


def test_one_error_can_be_changed_and_the_others_stay():
    few, more = read(mounting_rad=0.05), read(mounting_rad=0.05, heading_offset_rad=0.2, repeats=0.01)
    turned = Rotation.from_quat(more.orientations[0]) * Rotation.from_quat(few.orientations[0]).inv()
    assert np.abs(turned.as_rotvec()[:, :2]).max() < 1e-12


def test_rounding_repeats_and_signs():
    quantum = 2.0**-14
    rounded = read(moving, quantum=quantum).orientations
    np.testing.assert_array_equal(rounded, np.round(rounded / quantum) * quantum)
    exact = continuous_signs(read(moving).orientations, axis=0)
    assert np.abs(rounded - exact).max() <= quantum / 2 + 1e-15

    repeated = read(moving, duration_s=200.0, repeats=0.01).orientations
    share = (np.diff(repeated, axis=0) == 0).all(axis=-1).mean()
    assert share == pytest.approx(0.01, abs=0.002)

    flipped = read(moving, duration_s=200.0, sign_flips=0.01).orientations
    share = ((flipped[1:] * flipped[:-1]).sum(-1) < 0).mean()
    assert share == pytest.approx(0.01, abs=0.002)
    plain = read(moving, duration_s=200.0).orientations
    np.testing.assert_allclose(np.abs((flipped * plain).sum(-1)), 1.0, atol=1e-12)  # the same rotations


def test_same_seed_same_bits_and_another_seed_differs():
    a, b, c = (
        read_imus(moving, start_s=0.0, stop_s=5.0, errors=ImuErrors(), seed=seed) for seed in (1, 1, 2)
    )
    np.testing.assert_array_equal(a.orientations, b.orientations)
    assert (a.orientations != c.orientations).any()


def test_scaling_acts_on_angles_alone():
    twice = ImuErrors().scaled(2.0)
    assert twice.mounting_rad == 2 * ImuErrors().mounting_rad
    assert twice.tilt_dynamic_rad == 2 * ImuErrors().tilt_dynamic_rad
    assert (twice.quantum, twice.latency_s, twice.tilt_time_s) == (2.0**-14, 0.010, 3.0)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"rate_hz": 0.0}, r"Input rate_hz of ImuErrors must be above zero; instead received 0.0\."),
        (
            {"mounting_rad": -0.1},
            r"Input mounting_rad of ImuErrors must be finite and not negative; instead received -0.1\.",
        ),
        (
            {"repeats": 1.5},
            r"Input repeats of ImuErrors must be a share between 0 and 1; instead received 1.5\.",
        ),
    ],
)
def test_bad_errors_are_refused(change, message):
    with pytest.raises(InputError, match=message):
        ImuErrors(**change)


def test_no_time_for_a_round_is_refused():
    with pytest.raises(InputError, match="Input stop_s of read_imus must be at least one round after 0 s"):
        read(duration_s=0.02)
