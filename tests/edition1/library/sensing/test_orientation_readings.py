"""Rotation vectors against SciPy, at zero and near pi; the readings of two IMUs and their derivatives."""

import math

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from edition1.kinematics.paper_robots import Dimensions
from edition1_companion.pages.fusion.models import Imus, left_jacobian, rotation_vector
from edition1_companion.twins.segment_motion import ROBOT, rotation_matrix

ANGLES = (0.0, 1e-12, 1e-8, 1e-4, 0.19, 0.21, 1.0, 2.0, 3.0, math.pi - 1e-3, math.pi - 1e-7)


def vectors(angle, n=40, seed=0):
    v = np.random.default_rng(seed).standard_normal((n, 3))
    return torch.from_numpy(angle * v / np.linalg.norm(v, axis=1, keepdims=True))


@pytest.mark.parametrize("angle", ANGLES)
def test_there_and_back_to_rounding(angle):
    v = vectors(angle)
    R = rotation_matrix(v)
    np.testing.assert_allclose(R, Rotation.from_rotvec(v.numpy()).as_matrix(), atol=4e-15)
    np.testing.assert_allclose(rotation_vector(R), v, atol=4e-15 + 4e-15 * angle, rtol=1e-14)


def test_axes_at_exactly_half_a_turn():
    for axis in torch.eye(3, dtype=torch.float64):
        found = rotation_vector(2 * axis.outer(axis) - torch.eye(3, dtype=torch.float64))
        torch.testing.assert_close(found.abs(), math.pi * axis)


@pytest.mark.parametrize("angle", [0.0, 1e-8, 0.2, 1.0, 3.0])
def test_derivatives_of_the_chart(angle):
    v = vectors(angle, n=3)
    for one in v:
        back = torch.func.jacrev(lambda x: rotation_vector(rotation_matrix(x)))(one)
        torch.testing.assert_close(back, torch.eye(3, dtype=torch.float64), atol=1e-11, rtol=0)
        R = rotation_matrix(one)
        small = torch.func.jacrev(lambda x, R=R: rotation_vector(rotation_matrix(x) @ R.T))(one)
        torch.testing.assert_close(left_jacobian(one), small, atol=1e-11, rtol=0)


def test_a_small_turn_across_is_seen_larger_by_half_the_angle_over_its_sine():
    theta, small = math.pi / 2, 1e-6
    R = rotation_matrix(torch.tensor([theta, 0.0, 0.0], dtype=torch.float64))
    turn = rotation_matrix(torch.tensor([0.0, small, 0.0], dtype=torch.float64))
    seen = (rotation_vector(turn @ R) - rotation_vector(R)).norm() / small
    assert float(seen) == pytest.approx(theta / 2 / math.sin(theta / 2), rel=1e-5)


def test_a_segment_of_constant_curvature_reads_its_bending_linearly():
    q = torch.tensor([[0.01, -0.004, 0.001], [0.0, 0.0, 0.005], [-0.02, 0.02, 0.0]], dtype=torch.float64)
    expected = torch.stack([-q[:, 1], q[:, 0], 0 * q[:, 0]], dim=-1) / Dimensions.RADIUS_M
    read = Imus(False)(torch.nn.functional.pad(q, (0, 9)))
    torch.testing.assert_close(read, expected, atol=1e-14, rtol=0)


@pytest.mark.parametrize("batch", [(), (4,), (2, 1, 3)])
@pytest.mark.parametrize("bend", [0.0, 0.01])
def test_closed_form_derivatives(batch, bend):
    """Against those of the same formula, log(exp(left) R exp(right)), by torch; straight, too."""
    g = torch.Generator().manual_seed(0)
    q = bend * torch.randn(*batch, 3, generator=g, dtype=torch.float64)
    errors = 0.2 * torch.randn(*batch, 9, generator=g, dtype=torch.float64)
    x = torch.cat([q, errors], dim=-1)

    def read(x):
        left, right = rotation_matrix(x[3:6] + x[6:9]), rotation_matrix(x[9:])
        return rotation_vector(left @ ROBOT.tip(x[:3])[:3, :3] @ right)

    u, J = Imus(False).linearise(x)
    flat = x.reshape(-1, 12)
    torch.testing.assert_close(u.reshape(-1, 3), torch.stack([read(one) for one in flat]), atol=1e-13, rtol=0)
    expected = torch.stack([torch.func.jacrev(read)(one) for one in flat])
    torch.testing.assert_close(J.reshape(expected.shape), expected, atol=1e-11, rtol=1e-11)
