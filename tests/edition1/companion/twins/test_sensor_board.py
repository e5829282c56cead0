"""The sensor board: the drawn one against the project's field, converter, noise and drift."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from edition1.sensing.magnetic import readings
from edition1.sensing.magnets import ring
from edition1_companion.recordings.rig_robot import rig_earth_axis, rig_robot
from edition1_companion.twins.rig_twins import nominal_twin
from edition1_companion.twins.sensor_board import LSB_MV, analogue_readings, converted, disturbance, field

BOARD = nominal_twin().board
DRAWN = replace(
    BOARD,
    sensitivity=((0.0, 0.0, 5000.0),) * 3,
    shift_mm=((0.0, 0.0, 0.0),) * 3,
    magnet_shift_mm=(0.0, 0.0, 0.0),
    magnet_tilt_deg=(0.0, 0.0),
    curvature=((0.0, 0.0, 0.0),) * 3,
    ripple_mv=(0.0, 0.0, 0.0),
)
Q = np.random.default_rng(0).uniform([-8e-3, -8e-3, 0], [8e-3, 8e-3, 5e-3], (20, 3))


def test_drawn_board_reads_the_field_of_the_drawn_robot():
    q = torch.from_numpy(np.vstack([np.zeros(3), Q]))
    u = readings(rig_robot(), q, ring("published"), earth_mt=BOARD.earth_mt * rig_earth_axis()).numpy()
    expected = np.array(BOARD.rest_mv) + 5000 * (u[1:] - u[0])
    np.testing.assert_allclose(analogue_readings(DRAWN, Q, Q), expected, atol=1e-8)


def test_readings_at_rest_are_the_trimmed_ones_on_any_board():
    rest = np.zeros((1, 3))
    np.testing.assert_allclose(analogue_readings(BOARD, rest, rest), [BOARD.rest_mv], atol=1e-9)


def test_a_shift_of_the_magnet_is_the_opposite_shift_of_all_sensors():
    step = (0.4, -0.2, 0.3)
    magnet = replace(DRAWN, magnet_shift_mm=step, earth_mt=0.0)
    straight = np.array([[0.0, 0.0, 2e-3]])
    in_sensor = rig_robot().sensors.local[:, :3, :3].mT.numpy() @ np.array(step)
    sensors = replace(DRAWN, shift_mm=tuple(tuple((-v).tolist()) for v in in_sensor), earth_mt=0.0)
    np.testing.assert_allclose(
        field(magnet, straight, straight), field(sensors, straight, straight), atol=1e-12
    )


def test_converter_has_sixteen_bits_over_plus_and_minus_2048_mv():
    assert LSB_MV == 0.0625
    mv = np.random.default_rng(0).uniform(0, 2047, 1000)
    steps = converted(mv) / LSB_MV
    np.testing.assert_array_equal(steps, np.round(steps))
    assert np.abs(converted(mv) - mv).max() <= LSB_MV / 2
    np.testing.assert_array_equal(converted(np.array([-1.0, 3000.0])), [0.0, 2047.9375])


def test_noise_has_its_two_sizes():
    time_s = np.arange(40_000) / 40
    quiet = replace(BOARD, drift_mv=0.0)
    for inflation, expected in ((0.0, 0.24), (1.0, np.hypot(0.24, BOARD.inflated_noise_mv))):
        noise = disturbance(quiet, time_s, np.full(len(time_s), inflation), np.random.default_rng(0))
        assert noise.std() == pytest.approx(expected, rel=0.02)
        assert abs(noise.mean()) < 0.01


def drift(shape: str, seed: int) -> np.ndarray:
    quiet = replace(BOARD, noise_mv=0.0, inflated_noise_mv=0.0, drift_mv=1.0, drift=shape)
    time_s = np.arange(1501.0)
    return disturbance(quiet, time_s, np.ones(len(time_s)), np.random.default_rng(seed))


def test_shapes_of_the_drift():
    constant, ramp, walk = (drift(shape, 0) for shape in ("constant", "ramp", "random walk"))
    np.testing.assert_array_equal(constant, np.tile(constant[0], (1501, 1)))
    np.testing.assert_allclose(ramp[-1], constant[0])  # the same draw, reached after 1500 s
    np.testing.assert_allclose(np.diff(ramp, axis=0, n=2), 0, atol=1e-12)
    assert (walk[0] == 0).all()
    ends = np.array([drift("random walk", seed)[-1] for seed in range(150)])
    assert ends.std() == pytest.approx(1.0, rel=0.15)
