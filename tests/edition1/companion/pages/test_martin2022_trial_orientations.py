"""Orientations from directions: closed forms, and a made-up chain that is taken apart and put together again."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation, Slerp

from edition1.errors import InputError
from edition1_companion.pages.recorded_trial.orientations import (
    last_orientation,
    next_orientation,
    orientations_between,
    unevenness_deg,
)

ROWS = 200


def angle_deg(a, b):
    return np.degrees((Rotation.from_quat(a).inv() * Rotation.from_quat(b)).magnitude())


def share(a, b, t):
    """Orientations a share of the shorter way from a to b, by SciPy."""
    turn = Rotation.from_quat(b) * Rotation.from_quat(a).inv()
    return (Rotation.from_rotvec(t * turn.as_rotvec()) * Rotation.from_quat(a)).as_quat()


def z_axes(q):
    return Rotation.from_quat(q).apply([0.0, 0.0, 1.0])


@pytest.fixture
def chain():
    """A turned base and eight IMUs, of any turn about the arm; neighbours differ by up to 170 degrees."""
    rng = np.random.default_rng(3)
    q = [np.tile([0.0, 0.0, 1.0, 0.0], (ROWS, 1))]
    for _ in range(8):
        axis = rng.normal(size=(ROWS, 3))
        turn = axis / np.linalg.norm(axis, axis=1, keepdims=True) * np.radians(rng.uniform(5, 170, (ROWS, 1)))
        q.append((Rotation.from_rotvec(turn) * Rotation.from_quat(q[-1])).as_quat())
    return np.stack(q, axis=1)


def test_bend_and_twist_in_closed_form():
    """From upright by 2a about the axis x + z: the z axis goes round a cone, after half of it to x."""
    upright = np.array([[0.0, 0.0, 0.0, 1.0]])
    for a in np.radians([30.0, 60.0, 89.0]):
        axis = np.array([1.0, 0.0, 1.0]) / np.sqrt(2)

        def z_after(angle, axis=axis):
            z = np.array([0.0, 0.0, 1.0])  # Rodrigues, written out
            return (
                np.cos(angle) * z + np.sin(angle) * np.cross(axis, z) + (1 - np.cos(angle)) * axis[2] * axis
            )

        found = next_orientation(upright, z_after(a)[None], z_after(2 * a)[None])
        expected = np.append(np.sin(a) * axis, np.cos(a))
        np.testing.assert_allclose(found[0] * np.sign(found[0, 3]), expected, atol=1e-12)


def test_twist_of_the_frame_before_is_carried_on():
    twist = np.array([[0.0, 0.0, np.sin(0.7), np.cos(0.7)]])
    h = np.sqrt(0.5)
    found = next_orientation(twist, np.array([[0.0, -h, h]]), np.array([[0.0, -1.0, 0.0]]))
    expected = Rotation.from_euler("x", 90, degrees=True) * Rotation.from_quat(twist)
    np.testing.assert_allclose(angle_deg(found, expected.as_quat()), 0, atol=1e-6)


def test_all_orientations_of_a_chain(chain):
    halfway = np.stack([z_axes(share(chain[:, k], chain[:, k + 1], 0.5)) for k in range(7)], axis=1)
    following = np.stack([z_axes(chain[:, k + 1]) for k in range(7)], axis=1)
    found = orientations_between(chain[:, 0], halfway, following)
    for k in range(8):
        assert angle_deg(found[:, k], chain[:, k]).max() < 1e-5
    before = np.stack([z_axes(chain[:, k]) for k in range(7)], axis=1)
    assert np.abs(unevenness_deg(before, halfway, following)).max() < 1e-9


def test_direction_is_met_where_the_halfway_one_is_a_little_off(chain):
    halfway, following = z_axes(share(chain[:, 0], chain[:, 1], 0.5)), z_axes(chain[:, 1])
    off = halfway + 1e-6 * np.random.default_rng(0).normal(size=halfway.shape)
    off /= np.linalg.norm(off, axis=1, keepdims=True)
    found = next_orientation(chain[:, 0], off, following)
    np.testing.assert_allclose(z_axes(found), following, atol=1e-11)
    left = unevenness_deg(z_axes(chain[:, 0]), off, following)
    assert 1e-5 < np.abs(left).max() < 1e-3


def test_straight_link_keeps_its_direction():
    upright, up = np.array([[0.0, 0.0, 0.0, 1.0]]), np.array([[0.0, 0.0, 1.0]])
    np.testing.assert_allclose(z_axes(next_orientation(upright, up, up)), up, atol=1e-12)


def test_last_orientation(chain):
    """Eight sub-segments from the fifth frame to the last, summed one by one; the neighbour's turn after a third."""
    q = chain.copy()
    rng = np.random.default_rng(4)
    turn = rng.normal(size=(ROWS, 3))
    turn *= np.radians(rng.uniform(10, 60, (ROWS, 1))) / np.linalg.norm(turn, axis=1, keepdims=True)
    q[:, 8] = (Rotation.from_rotvec(turn) * Rotation.from_quat(q[:, 7])).as_quat()
    step = sum(0.04 * z_axes(share(q[:, 4], q[:, 8], (2 * k + 1) / 16)) for k in range(6))
    third = z_axes(Slerp([0, 3], Rotation.from_quat(q[0, 7:9]))(1).as_quat())
    np.testing.assert_allclose(third, z_axes(share(q[:, 7], q[:, 8], 1 / 3))[0], atol=1e-12)
    found = last_orientation(q[:, 7], z_axes(share(q[:, 7], q[:, 8], 1 / 3)), q[:, 4], step, 0.32, 8)
    assert angle_deg(found, q[:, 8]).max() < 1e-4
    with pytest.raises(InputError, match="sub_links of last_orientation must be a multiple of 4; .* 6"):
        last_orientation(q[:, 7], z_axes(q[:, 8]), q[:, 4], step, 0.32, 6)
