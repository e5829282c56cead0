"""Directions that IMUs see: derivatives, and the information of an orientation."""

import pytest
import torch

from edition1 import se3
from edition1.errors import InputError
from edition1.estimation.levenberg_marquardt import jacobian
from edition1.kinematics.mounts import Mounts
from edition1.kinematics.paper_robots import pcc_robot
from edition1.sensing.seen_directions import SeenDirections


def random(*shape, seed=0):
    return torch.rand(*shape, dtype=torch.float64, generator=torch.Generator().manual_seed(seed)) - 0.5


def imus(n):
    x, y, z = (4 * random(n, 3)).T
    o = torch.zeros_like(x)
    crossed = torch.stack([o, -z, y, z, o, -x, -y, x, o], -1).reshape(n, 3, 3)
    mounted = torch.linalg.matrix_exp(crossed)
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


def test_bad_input():
    with pytest.raises(InputError, match="directions of SeenDirections must be one for each of seen_by"):
        SeenDirections(pcc_robot(2), imus(2), (), torch.zeros(0, 3).double())
    with pytest.raises(InputError, match=r"seen_by of SeenDirections must be from 0 to 1; .* \(2,\)"):
        SeenDirections(pcc_robot(2), imus(2), (2,), torch.eye(3).double()[:1])
