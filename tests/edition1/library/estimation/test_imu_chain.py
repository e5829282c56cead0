"""The rigid-link chain against closed forms, laws and a loop."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from edition1.errors import InputError
from edition1.estimation.imu_chain import (
    adjacent_angles,
    link_orientations,
    point_at,
    rigid_body,
    sensor_orientations,
)

UPRIGHT = np.array([0.0, 0.0, 0.0, 1.0])
LENGTHS = np.array([0.102, 0.08, 0.0, 0.08, 0.05])


def random_orientations(seed: int, *shape: int) -> np.ndarray:
    q = np.random.default_rng(seed).normal(size=(*shape, 4))
    return q / np.linalg.norm(q, axis=-1, keepdims=True)


def arc_tangents(angle: float, links: int, at: np.ndarray | None = None) -> np.ndarray:
    """Link orientations on an arc bent by ``angle`` about y, taken in the middle of each link."""
    middle = (np.arange(links) + 0.5) / links if at is None else at
    return Rotation.from_rotvec(np.outer(middle * angle, [0.0, 1.0, 0.0])).as_quat()


def printed_rotation_matrix(q: np.ndarray) -> np.ndarray:
    """Equation (1) as printed, for q = a + ib + jc + kd."""
    b, c, d, a = q
    return np.array(
        [
            [1 - 2 * (c**2 + d**2), 2 * (b * c - a * d), 2 * (b * d + a * c)],
            [2 * (b * c + a * d), 1 - 2 * (b**2 + d**2), 2 * (c * d - a * b)],
            [2 * (b * d - a * c), 2 * (c * d + a * b), 1 - 2 * (b**2 + c**2)],
        ]
    )


def printed_rigid_body(orientations: np.ndarray, lengths: np.ndarray) -> np.ndarray:
    """Equation (2) as printed, one sample and one joint at a time."""
    joints = np.zeros((len(orientations), len(lengths) + 1, 3))
    for sample, quaternions in enumerate(orientations):
        for i in range(1, len(lengths) + 1):
            for j in range(i):
                joints[sample, i] += printed_rotation_matrix(quaternions[j]) @ [0.0, 0.0, lengths[j]]
    return joints


def test_straight_arm_ends_at_the_sum_of_its_links():
    joints = rigid_body(np.tile(UPRIGHT, (8, 1)), (0.08,) * 8)
    np.testing.assert_allclose(joints[:, 2], np.arange(9) * 0.08, atol=1e-15)
    np.testing.assert_array_equal(joints[:, :2], 0.0)


def test_quarter_circle_is_the_limit_of_many_links_at_second_order():
    length, radius = 0.64, 0.64 / (np.pi / 2)
    errors = []
    for links in (8, 16, 32, 64):
        tip = rigid_body(arc_tangents(np.pi / 2, links), np.full(links, length / links))[-1]
        errors.append(np.linalg.norm(tip - [radius, 0.0, radius]))
    orders = np.log2(np.array(errors[:-1]) / errors[1:])
    np.testing.assert_allclose(orders, 2.0, atol=0.01)
    assert errors[-1] < 2e-5


def test_rotation_matrix_printed_in_the_paper_is_the_one_used():
    for q in random_orientations(0, 20):
        np.testing.assert_allclose(printed_rotation_matrix(q), Rotation.from_quat(q).as_matrix(), atol=1e-14)


def test_agrees_with_the_equation_as_a_loop():
    q = random_orientations(1, 7, 5)
    np.testing.assert_allclose(rigid_body(q, LENGTHS), printed_rigid_body(q, LENGTHS), atol=1e-15)


@pytest.mark.parametrize("batch", [(), (1,), (3, 1, 2), (0,)])
def test_any_batch_shape(batch):
    q = random_orientations(2, *batch, 5)
    joints = rigid_body(q, LENGTHS)
    assert joints.shape == (*batch, 6, 3)
    assert point_at(joints, LENGTHS, [0.1, 0.2, 0.3]).shape == (*batch, 3, 3)
    assert adjacent_angles(q).shape == (*batch, 4)
    flat = rigid_body(q.reshape(-1, 5, 4), LENGTHS).reshape(joints.shape)
    np.testing.assert_array_equal(joints, flat)


@given(seed=st.integers(0, 2**32 - 1), base=st.tuples(*[st.floats(-3, 3)] * 3))
def test_turning_the_base_turns_the_shape(seed, base):
    q, turn = random_orientations(seed, 4, 5), Rotation.from_rotvec(base)
    turned = (turn * Rotation.from_quat(q.reshape(-1, 4))).as_quat().reshape(q.shape)
    expected = turn.apply(rigid_body(q, LENGTHS).reshape(-1, 3)).reshape(4, 6, 3)
    np.testing.assert_allclose(rigid_body(turned, LENGTHS), expected, atol=1e-14)
    np.testing.assert_allclose(adjacent_angles(turned), adjacent_angles(q), atol=1e-7)


@given(seed=st.integers(0, 2**32 - 1))
def test_links_keep_their_lengths_and_signs_of_quaternions_do_not_matter(seed):
    q = random_orientations(seed, 4, 5)
    joints = rigid_body(q, LENGTHS)
    np.testing.assert_allclose(
        np.linalg.norm(np.diff(joints, axis=1), axis=2), np.tile(LENGTHS, (4, 1)), atol=1e-15
    )
    np.testing.assert_array_equal(rigid_body(-q, LENGTHS), joints)


def test_point_at_interpolates_between_adjacent_joints():
    joints = rigid_body(random_orientations(3, 6, 5), LENGTHS)
    ends = np.concatenate([[0.0], np.cumsum(LENGTHS)])
    np.testing.assert_allclose(point_at(joints, LENGTHS, ends), joints, atol=1e-15)
    s = np.linspace(0, ends[-1], 57)
    knots = np.delete(ends, 3)  # numpy's interpolation wants increasing knots; link 2 has no length
    expected = [[np.interp(s, knots, np.delete(x, 3)) for x in sample.T] for sample in joints]
    np.testing.assert_allclose(point_at(joints, LENGTHS, s), np.swapaxes(expected, 1, 2), atol=1e-14)


@given(angle=st.floats(0, np.pi), axis=st.tuples(*[st.floats(0.1, 1)] * 3))
def test_adjacent_angle_is_the_angle_of_the_turn_between_neighbours(angle, axis):
    turn = Rotation.from_rotvec(angle * np.array(axis) / np.linalg.norm(axis))
    q = random_orientations(4, 1)[0]
    pair = np.array([q, -(turn * Rotation.from_quat(q)).as_quat()])
    np.testing.assert_allclose(adjacent_angles(pair), [angle], atol=1e-14)


@pytest.mark.parametrize(("along_arm", "column"), [("x", 0), ("y", 1), ("z", 2)])
def test_mounting_puts_the_named_sensor_axis_along_the_link(along_arm, column):
    sensors = random_orientations(5, 6, 8)
    links = link_orientations(sensors, along_arm)
    axis = Rotation.from_quat(sensors.reshape(-1, 4)).as_matrix()[:, :, column]
    along = Rotation.from_quat(links.reshape(-1, 4)).apply([0.0, 0.0, 1.0])
    np.testing.assert_allclose(along, axis, atol=1e-14)
    np.testing.assert_allclose(
        np.abs((sensor_orientations(links, along_arm) * sensors).sum(-1)), 1, atol=1e-14
    )


def test_unknown_mounting_axis_is_refused():
    with pytest.raises(InputError, match='along_arm of link_orientations must be one of "x", "y" and "z"'):
        link_orientations(np.tile(UPRIGHT, (8, 1)), "up")


@pytest.mark.parametrize(
    ("lengths", "message"),
    [
        (
            [0.08, -0.08],
            r"link_lengths of rigid_body must be finite and not negative \[m\]; instead received",
        ),
        ([0.08, np.nan], "must be finite and not negative"),
        ([0.08], r"must be one length per link, 2 in all; instead received shape \(1,\)"),
        (np.array([0.08] * 3), "must be one length per link"),
    ],
)
def test_bad_lengths_are_refused(lengths, message):
    with pytest.raises(InputError, match=message):
        rigid_body(np.tile(UPRIGHT, (2, 1)), lengths)


@pytest.mark.parametrize("value", [np.nan, np.inf, 0.0, 1.01])
def test_quaternions_that_are_not_unit_are_refused(value):
    q = np.tile(UPRIGHT, (3, 2, 1))
    q[1, 1, 3] = value
    with pytest.raises(InputError, match=r"orientations of rigid_body must be finite unit quaternions"):
        rigid_body(q, [0.08, 0.08])
    with pytest.raises(InputError, match=r"orientations of adjacent_angles"):
        adjacent_angles(q)


@pytest.mark.parametrize("shape", [(5, 8, 3), (4,), (5, 0, 4)])
def test_wrong_shapes_are_refused(shape):
    # Where annotations are checked too, that check (a TypeError) comes first.
    with pytest.raises((InputError, TypeError), match="orientations"):
        rigid_body(np.ones(shape), [0.08] * 8)


@pytest.mark.parametrize("arc", [-0.01, 0.17, np.nan])
def test_points_beyond_the_chain_are_refused(arc):
    joints = rigid_body(np.tile(UPRIGHT, (2, 1)), [0.08, 0.08])
    with pytest.raises(InputError, match=r"arc_lengths of point_at must be distances between 0 and 0\.16 m"):
        point_at(joints, [0.08, 0.08], arc)


def test_input_is_not_changed():
    q = random_orientations(6, 3, 5)
    before = q.copy()
    rigid_body(q, LENGTHS)
    link_orientations(q, "y")
    adjacent_angles(q)
    np.testing.assert_array_equal(q, before)
