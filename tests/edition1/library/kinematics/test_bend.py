"""The bending arc: pose map of Mitchell et al. 2021, and its two ways to write a configuration."""

import math

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from edition1.errors import InputError
from edition1.kinematics.bend import Bend, bend_angle_and_direction, bend_vector
from edition1.kinematics.robot import Segment

angles = st.floats(0.01, math.pi / 2)
directions = st.floats(-math.pi, math.pi)


@given(angles, directions)
def test_pose_map_of_the_paper(phi, theta):
    """p = (r cos, r sin, L sin(phi)/phi); rotation vector phi (-sin, cos, 0)."""
    L = 15e-3
    T = Bend(L).pose(
        bend_vector(torch.tensor(phi).double(), torch.tensor(theta).double()), torch.tensor(1.0).double()
    )
    r = L * (1 - math.cos(phi)) / phi
    p = torch.tensor([r * math.cos(theta), r * math.sin(theta), L * math.sin(phi) / phi], dtype=torch.float64)
    torch.testing.assert_close(T[:3, 3], p, atol=1e-9, rtol=0)
    R = Rotation.from_rotvec([-phi * math.sin(theta), phi * math.cos(theta), 0]).as_matrix()
    torch.testing.assert_close(T[:3, :3], torch.from_numpy(R), atol=1e-6, rtol=0)


def test_is_a_segment_that_keeps_its_length():
    bend = Bend(0.1)
    assert isinstance(bend, Segment)
    v = torch.linspace(0, 1, 2001, dtype=torch.float64)
    points = bend.pose(torch.tensor([0.9, -0.6], dtype=torch.float64), v)[:, :3, 3]
    assert float(points.diff(dim=0).norm(dim=-1).sum()) == pytest.approx(0.1, rel=1e-6)


@given(st.floats(1e-6, 3), directions)
def test_vector_and_angles_are_inverse(phi, theta):
    angle, direction = bend_angle_and_direction(
        bend_vector(torch.tensor(phi).double(), torch.tensor(theta).double())
    )
    assert float(angle) == pytest.approx(phi, rel=1e-6)
    assert math.cos(float(direction) - theta) == pytest.approx(1)


def test_negative_angle_is_the_opposite_direction():
    folded = bend_vector(torch.tensor(0.4).double(), torch.tensor(0.3 + math.pi).double())
    torch.testing.assert_close(bend_vector(torch.tensor(-0.4).double(), torch.tensor(0.3).double()), folded)


def test_bad_input():
    with pytest.raises(
        InputError, match=r"Input length of Bend must be positive \[m\]; instead received -1.0."
    ):
        Bend(-1.0)
