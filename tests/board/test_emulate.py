"""Emulated motion, and readings of sensors that fail."""

import numpy as np
import pytest

from repro import ConstantCurvature, InputError, Robot
from repro_board.emulate import FAULTS, REACH, SPEED, course, faulty

LOW, HIGH = np.array([-0.01, -0.02, 0.0, -0.01, 0.0, 0.0]), np.array([0.01, 0.02, 0.006, 0.01, 0.0, 0.006])
ROBOT = Robot(
    [ConstantCurvature(0.1, 0.02)] * 2, lower=LOW, upper=HIGH, start=[0.002, 0.0, 0.0, 0.0, 0.0, 0.001]
)
TIMES = np.arange(20_000) / 1000
U = np.random.default_rng(0).normal(size=(50, 4))


@pytest.mark.parametrize("seed", range(4))
def test_a_motion_starts_at_rest_keeps_within_its_bounds_and_below_its_speed(seed):
    q = course(ROBOT, TIMES, seed=seed)
    width = HIGH - LOW
    expected = np.array([0.002, 0.0, 0.05 * 0.006, 0.0, 0.0, 0.001])  # no nearer to a bound than it reaches
    np.testing.assert_allclose(q[0], expected, atol=1e-15)
    assert (np.abs(q - (LOW + HIGH) / 2) <= REACH * width / 2 + 1e-15).all()
    speed = np.abs(np.diff(q, axis=0)) * 1000
    assert (speed[0] <= 1e-2 * width).all()
    assert (speed <= SPEED * width * (1 + 1e-9) + 1e-12).all()
    moves = width > 0
    assert (np.ptp(q, axis=0)[moves] > 0.7 * width[moves]).all()
    np.testing.assert_array_equal(course(ROBOT, TIMES[::7], seed=seed), q[::7])


@pytest.mark.parametrize("fault", FAULTS)
def test_only_what_fails_changes_and_only_from_then_on(fault):
    sound = U.copy()
    sent = faulty(sound, fault, [1, 2], 20, 0.3)
    np.testing.assert_array_equal(sound, U)
    np.testing.assert_array_equal(sent[:20], U[:20])
    assert (sent[20, 1:3] != U[20, 1:3]).any() or fault == "saturated"
    if fault == "frozen":
        assert (sent[20:] == U[19]).all()
    else:
        np.testing.assert_array_equal(sent[:, [0, 3]], U[:, [0, 3]])
    mask = np.array([False, True, True, False])
    np.testing.assert_array_equal(faulty(U, fault, mask, 20, 0.3), sent)


def test_each_fault_reads_what_the_table_says():
    late = U[20:, 1]
    expected = {
        ("missing", None): np.full(30, np.nan),
        ("unplugged", None): np.zeros(30),
        ("unplugged", 1.5): np.full(30, 1.5),
        ("stuck", None): np.full(30, U[19, 1]),
        ("saturated", 0.5): np.clip(late, -0.5, 0.5),
        ("saturated", None): np.clip(late, -np.median(np.abs(U[:, 1])), np.median(np.abs(U[:, 1]))),
        ("scaled", None): 1.05 * late,
        ("drifting", 0.1): late + 0.1 * np.arange(1, 31),
        ("spike", 9.0): np.concatenate([[9.0], late[1:]]),
        ("frozen", None): np.full(30, U[19, 1]),
    }
    for (fault, size), values in expected.items():
        np.testing.assert_allclose(faulty(U, fault, 1, 20, size)[20:, 1], values, rtol=1e-14)
    assert (faulty(U, "stuck", 1, 0)[:, 1] == U[0, 1]).all()


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: faulty(U, "tired", 1), "Input fault of faulty must be one of missing, unplugged"),
        (
            lambda: faulty(U, "spike", 1),
            "Input size of faulty must be given for spike; instead received nothing",
        ),
        (
            lambda: course(Robot([ConstantCurvature(0.1, 0.02)]), [0.0]),
            "Input robot of course must be one with bounds",
        ),
    ],
)
def test_what_cannot_be_is_refused(call, message):
    with pytest.raises(InputError, match=message):
        call()
