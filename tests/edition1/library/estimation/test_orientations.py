"""Quaternion arithmetic against SciPy and RoMa, and the filling of missing IMUs."""

import numpy as np
import pytest
import roma
import torch
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation, Slerp

from edition1.errors import InputError
from edition1.estimation._quaternions import axis_and_angle, filled, turn_between, unit_quaternions
from edition1.estimation.orientations import exponential, product, tangents

ARCS = [0.0, 0.1, 0.16, 0.3]


def random_orientations(seed, *shape):
    return unit_quaternions(
        Rotation.random(int(np.prod(shape)), rng=seed).as_quat().reshape(*shape, 4), "test"
    )


def same(a, b):
    np.testing.assert_allclose(np.abs((a * b).sum(-1)), 1.0, atol=1e-14)


def test_arithmetic_is_that_of_scipy_and_roma():
    a, b = random_orientations(0, 50), random_orientations(1, 50)
    same(product(a, b), (Rotation.from_quat(a) * Rotation.from_quat(b)).as_quat())
    same(product(a, b), roma.quat_product(torch.from_numpy(a), torch.from_numpy(b)).numpy())
    np.testing.assert_allclose(tangents(a), Rotation.from_quat(a).apply([0, 0, 1]), atol=1e-15)
    vectors = Rotation.from_quat(a).as_rotvec()
    same(exponential(vectors), a)
    expected = (Rotation.from_quat(b) * Rotation.from_quat(a).inv()).as_rotvec()
    np.testing.assert_allclose(turn_between(a, b), expected, atol=1e-13)


@given(angle=st.floats(0, 3.14), seed=st.integers(0, 100))
def test_turn_is_found_again_down_to_the_smallest_angle(angle, seed):
    q = random_orientations(seed, 1)[0]
    axis = tangents(random_orientations(seed + 1, 1)[0])
    turned = product(exponential(angle * axis), q)
    for sign in (1.0, -1.0):
        np.testing.assert_allclose(turn_between(q, sign * turned), angle * axis, atol=1e-14)
    unit, size = axis_and_angle(angle * axis)
    np.testing.assert_allclose(size[..., None] * unit, angle * axis, atol=1e-15)


def test_rescales_within_the_tolerance_only():
    q = random_orientations(2, 3, 2)
    np.testing.assert_allclose(unit_quaternions(q * 1.0009, "test"), q, atol=1e-15)
    with pytest.raises(
        InputError, match=r"^Input orientations of test must be finite unit quaternions \(within"
    ):
        unit_quaternions(q * 1.0011, "test")


def test_missing_imus_are_interpolated_as_by_slerp_and_held_beyond_the_last():
    q = random_orientations(3, 6, 4)
    gaps = q.copy()
    gaps[1, 1] = gaps[2, 1, 2] = np.nan  # one component is enough
    gaps[2, 2] = gaps[3, :3] = gaps[4, 3] = np.nan
    found = filled(gaps, ARCS)
    same(found[[0, 5]], q[[0, 5]])
    same(found[1, 1], Slerp([0.0, 0.16], Rotation.from_quat(q[1, [0, 2]]))(0.1).as_quat())
    same(found[2, 1:3], Slerp([0.0, 0.3], Rotation.from_quat(q[2, [0, 3]]))([0.1, 0.16]).as_quat())
    q1, q2 = torch.from_numpy(q[2, [0, 3]])
    same(found[2, 1], roma.unitquat_slerp(q1, q2, torch.tensor([0.1 / 0.3]), shortest_arc=True)[0].numpy())
    same(found[3], np.tile(q[3, 3], (4, 1)))
    same(found[4, 3], q[4, 2])
    np.testing.assert_array_equal(np.isnan(gaps).sum(), 1 + 4 * 6)  # the input is not changed


def test_a_sample_without_imus_is_refused():
    q = random_orientations(4, 2, 4)
    q[1] = np.nan
    message = (
        "^Input orientations of filled must be at least one IMU that is not NaN in every sample; .* none"
    )
    with pytest.raises(InputError, match=message):
        filled(q, ARCS)
