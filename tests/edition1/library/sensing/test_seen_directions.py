"""Directions that IMUs see: derivatives, and the information of an orientation."""

import pytest
import torch

from edition1 import se3
from edition1.errors import InputError
from edition1.estimation.levenberg_marquardt import jacobian
from edition1.kinematics.mounts import Mounts
from edition1.kinematics.paper_robots import pcc_robot
from edition1.sensing.seen_directions import SeenDirections
from edition1_companion.pages.fusion.models import rotation_vector
from edition1_companion.twins.segment_motion import rotation_matrix


def random(*shape, seed=0):
    return torch.rand(*shape, dtype=torch.float64, generator=torch.Generator().manual_seed(seed)) - 0.5


def imus(n):
    mounted = rotation_matrix(4 * random(n, 3))
    return Mounts(tuple(range(n)), torch.full((n,), 0.08).double(), se3.pose(mounted, mounted.new_zeros(3)))


@pytest.mark.parametrize("shape", [(), (1,), (3, 1, 2)])
def test_components_and_derivatives_are_those_of_the_poses(shape):
    robot, q = pcc_robot(2), 0.06 * random(*shape, 6)
    d = torch.nn.functional.normalize(random(3, 3), dim=-1)
    sensing = SeenDirections(robot, imus(2), (1, 0, 1), d)
    R = robot.mount_poses(q, imus(2))[..., [1, 0, 1], :3, :3]
    torch.testing.assert_close(sensing(q), (R.mT @ d.unsqueeze(-1)).flatten(-3), rtol=0, atol=1e-14)
    u, J = sensing.linearise(q)
    torch.testing.assert_close(torch.stack([sensing(q), u]), torch.stack([u, u]), rtol=0, atol=0)
    plain = jacobian(
        lambda x: (robot.mount_poses(x, imus(2))[..., [1, 0, 1], :3, :3].mT @ d.unsqueeze(-1)).flatten(-3), q
    )[1]
    torch.testing.assert_close(J, plain, rtol=1e-11, atol=1e-11)
    torch.testing.assert_close(jacobian(sensing, q)[1], J, rtol=0, atol=1e-13)


def test_three_axes_have_the_information_of_the_orientation_and_jump_nowhere():
    """Also where the rotation vector jumps: two segments that bend by more than half a turn in all."""
    robot, mounts = pcc_robot(2), imus(2)
    sensing = SeenDirections(robot, mounts, (1, 1, 1), torch.eye(3).double())
    for q in (0.03 * random(6), torch.tensor([0.05, 0, 0, 0.05, 0, 0]).double()):
        J = sensing.linearise(q)[1] / 2**0.5
        R = robot.mount_poses(q, mounts)[1, :3, :3]
        turn = torch.func.jacfwd(
            lambda x, R=R: rotation_vector(R.mT @ robot.mount_poses(x, mounts)[1, :3, :3])
        )(q)
        torch.testing.assert_close(J.mT @ J, turn.mT @ turn, rtol=1e-9, atol=1e-9)


def test_bad_input():
    with pytest.raises(InputError, match="directions of SeenDirections must be one for each of seen_by"):
        SeenDirections(pcc_robot(2), imus(2), (), torch.zeros(0, 3).double())
    with pytest.raises(InputError, match=r"seen_by of SeenDirections must be from 0 to 1; .* \(2,\)"):
        SeenDirections(pcc_robot(2), imus(2), (2,), torch.eye(3).double()[:1])
