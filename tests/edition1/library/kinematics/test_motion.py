"""The tip and its derivatives: closed form of one arc, central differences, the chain of segments."""

import math

import pytest
import torch

from edition1.errors import InputError
from edition1.kinematics.affine_curvature import AffineCurvature
from edition1.kinematics.constant_curvature import ConstantCurvature
from edition1.kinematics.motion import backbone_motion, tip_motion
from edition1.kinematics.mounts import magnet_mounts
from edition1.kinematics.robot import Robot

L, D = 0.11, 0.022
SEGMENT = ConstantCurvature(L, D)
ROBOTS = [
    Robot((SEGMENT,)),
    Robot((SEGMENT, ConstantCurvature(0.08, 0.02), SEGMENT)),
    Robot((AffineCurvature(L), SEGMENT)),
]


def random(*shape, seed=0):
    return torch.rand(*shape, dtype=torch.float64, generator=torch.Generator().manual_seed(seed)) - 0.5


@pytest.mark.parametrize("angle", [1e-3, 0.3, math.pi / 2, 3.0])
def test_one_segment_bent_towards_x_in_closed_form(angle):
    """An arc of length l = L + delta_L: x = l (1 - cos a)/a, z = l sin(a)/a, with a = delta_x/d."""
    length = L + 0.004
    position, J = tip_motion(Robot((SEGMENT,)), torch.tensor([D * angle, 0.0, 0.004], dtype=torch.float64))
    rise = 2 * math.sin(angle / 2) ** 2  # 1 - cos(a), without its cancellation
    x, z = length * rise / angle, length * math.sin(angle) / angle
    expected = [
        [(length * math.sin(angle) - x) / angle / D, 0.0, x / length],
        [0.0, x / (angle * D), 0.0],
        [(length * math.cos(angle) - z) / angle / D, 0.0, z / length],
    ]
    torch.testing.assert_close(position, position.new_tensor([x, 0.0, z]), atol=1e-15, rtol=1e-12)
    torch.testing.assert_close(J, J.new_tensor(expected), atol=1e-11, rtol=1e-11)


@pytest.mark.parametrize("shape", [(), (1,), (3, 1, 2), (0,)])
@pytest.mark.parametrize("robot", ROBOTS, ids=["one", "unequal", "affine"])
def test_derivatives_are_central_differences_of_the_tip(robot, shape):
    q = 0.03 * random(*shape, robot.n_q)
    position, J = tip_motion(robot, q)
    torch.testing.assert_close(position, robot.tip(q)[..., :3, 3], atol=0, rtol=0)
    steps = 1e-6 * torch.eye(robot.n_q, dtype=torch.float64)
    ahead, behind = (robot.tip(q.unsqueeze(-2) + sign * steps)[..., :3, 3] for sign in (1, -1))
    torch.testing.assert_close(J, ((ahead - behind) / 2e-6).mT, atol=1e-8, rtol=1e-7)


@pytest.mark.parametrize("robot", ROBOTS, ids=["one", "unequal", "affine"])
def test_the_tip_moves_as_the_end_of_the_backbone_straight_or_bent(robot):
    q = torch.cat([0.03 * random(5, robot.n_q), torch.zeros(1, robot.n_q).double()])
    last = len(robot.segments) - 1
    T, dT = backbone_motion(robot, q, magnet_mounts([last], robot.segments[last].length))
    position, J = tip_motion(robot, q)
    torch.testing.assert_close(position, T[:, 0, :3, 3], atol=1e-15, rtol=0)
    torch.testing.assert_close(J, dT[:, 0, :, :3, 3].mT, atol=1e-12, rtol=1e-12)


def test_single_precision_stays():
    position, J = tip_motion(ROBOTS[0], torch.zeros(2, 3))
    assert (position.dtype, J.dtype) == (torch.float32, torch.float32)


@pytest.mark.parametrize("q", [torch.zeros(4), torch.tensor([0.0, math.nan, 0.0])])
def test_configurations_of_another_robot_or_with_gaps_are_refused(q):
    with pytest.raises(InputError, match="Input q of Robot must be "):
        tip_motion(ROBOTS[0], q)
