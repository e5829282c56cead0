"""Segments in series and mounts: closed forms, laws over batch shapes, refused input."""

import math

import pytest
import torch

from edition1 import se3
from edition1.errors import InputError
from edition1.kinematics.constant_curvature import ConstantCurvature
from edition1.kinematics.mounts import Mounts, magnet_mounts, ring_azimuths, sensor_mounts
from edition1.kinematics.robot import Robot

L, D = 0.11, 0.022
SEGMENT = ConstantCurvature(L, D)


def three_segments(**mounts):
    return Robot((SEGMENT,) * 3, **mounts)


def random_q(*shape, seed=0):
    return 0.02 * (
        torch.rand(*shape, dtype=torch.float64, generator=torch.Generator().manual_seed(seed)) - 0.3
    )


def test_two_opposite_quarter_circles_make_an_s():
    a = D * math.pi / 2
    q = torch.tensor([a, 0, 0, -a, 0, 0], dtype=torch.float64)
    T = Robot((SEGMENT,) * 2).tip(q)
    r = L / (math.pi / 2)
    torch.testing.assert_close(T[:3, 3], torch.tensor([2 * r, 0, 2 * r], dtype=torch.float64))
    torch.testing.assert_close(T[:3, :3], torch.eye(3, dtype=torch.float64), atol=1e-12, rtol=0)


def test_split_segment_is_the_whole_segment():
    """Two halves with half the bending each are one segment."""
    q = torch.tensor([0.012, -0.007, 0.004], dtype=torch.float64)
    halves = Robot((ConstantCurvature(L / 2, D),) * 2)
    whole = Robot((SEGMENT,))
    torch.testing.assert_close(halves.tip(torch.cat([q / 2, q / 2])), whole.tip(q))


@pytest.mark.parametrize("shape", [(), (1,), (3, 1, 2)])
def test_batch_equals_loop(shape):
    mounts = sensor_mounts([2, 0, 1], [L, 0.0, 0.05], [0.013, 0.0, 0.01], [0.1, 0.2, 0.3], [0.0, 0.1, -0.2])
    robot, q = three_segments(sensors=mounts), random_q(*shape, 9)
    batched = robot.sensor_poses(q)
    assert batched.shape == (*shape, 3, 4, 4)
    flat = torch.stack([robot.sensor_poses(row) for row in q.reshape(-1, 9)])
    torch.testing.assert_close(batched.reshape(-1, 3, 4, 4), flat)


def test_batch_of_robots_broadcasts_against_one_configuration():
    tilt = torch.linspace(-0.3, 0.3, 5, dtype=torch.float64).unsqueeze(-1)
    robot = three_segments(sensors=sensor_mounts([0, 1], L, 0.013, 0.0, tilt))
    poses = robot.sensor_poses(random_q(9))
    assert poses.shape == (5, 2, 4, 4)
    one = three_segments(sensors=sensor_mounts([0, 1], L, 0.013, 0.0, float(tilt[3])))
    torch.testing.assert_close(poses[3], one.sensor_poses(random_q(9)))


@pytest.mark.parametrize("psi", [0.0, 0.2, -0.4])
@pytest.mark.parametrize("phi", [0.0, 2.1, -1.0])
def test_measurement_direction(phi, psi):
    """o_s = Rz(phi) (-sin psi, 0, -cos psi): a positive tilt points inwards."""
    T = Robot((SEGMENT,), sensors=sensor_mounts([0], L, 0.013, phi, psi)).sensor_poses(
        torch.zeros(3).double()
    )[0]
    expected = [-math.sin(psi) * math.cos(phi), -math.sin(psi) * math.sin(phi), -math.cos(psi)]
    torch.testing.assert_close(T[:3, 2], torch.tensor(expected, dtype=torch.float64))
    torch.testing.assert_close(
        T[:3, 3], torch.tensor([0.013 * math.cos(phi), 0.013 * math.sin(phi), L], dtype=torch.float64)
    )
    inwards = -T[:2, 3] / 0.013
    assert float(T[:2, 2] @ inwards) == pytest.approx(math.sin(psi), abs=1e-12)


def test_mounts_keep_their_order_and_follow_their_segment():
    robot = three_segments(magnets=magnet_mounts([2, 0, 1], [L / 2, 0.0, L]))
    q = random_q(9)
    T = robot.magnet_poses(q)
    bases = robot.base_poses(q)
    torch.testing.assert_close(T[1], bases[0])
    torch.testing.assert_close(T[2], bases[2])
    torch.testing.assert_close(T[0], bases[2] @ SEGMENT.pose(q[6:], torch.tensor(0.5)))


def test_a_shifted_magnet_moves_rigidly_along_its_own_axis():
    """Along the backbone or across it, each by its own shift; a shift of zero leaves every bit as it is."""
    axial, across, shift = [L / 2, 0.02], [[0.0, 0.0, 1.0], [1.0, 0.0, 0.0]], [-0.003, 0.002]
    q = random_q(5, 9)
    plain, shifted = (
        three_segments(magnets=magnet_mounts([1, 2], axial, across, s)).magnet_poses(q) for s in (0.0, shift)
    )
    assert torch.equal(shifted[..., :3, :3], plain[..., :3, :3])
    expected = plain[..., :3, 3] + torch.tensor(shift).double()[:, None] * plain[..., :3, 2]
    torch.testing.assert_close(shifted[..., :3, 3], expected)
    assert magnet_mounts([0], 0.05).local.numpy().tobytes() == torch.eye(4).double().numpy().tobytes()


def test_backbone_runs_from_base_to_tip():
    robot, q = three_segments(), random_q(4, 9)
    points = robot.backbone(q, n_points=5)
    assert points.shape == (4, 15, 3)
    torch.testing.assert_close(points[:, 0], torch.zeros(4, 3, dtype=torch.float64))
    torch.testing.assert_close(points[:, -1], robot.tip(q)[:, :3, 3])
    torch.testing.assert_close(points[:, 4], points[:, 5])


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_precision_of_the_caller_is_kept(dtype):
    robot = three_segments(sensors=sensor_mounts([0], L, 0.013), magnets=magnet_mounts([1], 0.05))
    q = torch.zeros(9, dtype=dtype)
    assert {robot.sensor_poses(q).dtype, robot.magnet_poses(q).dtype, robot.backbone(q).dtype} == {dtype}


def test_derivatives_of_sensor_poses_at_the_straight_pose():
    robot = three_segments(sensors=sensor_mounts([2], L, 0.013, 0.4, 0.1))
    q = torch.zeros(9, dtype=torch.float64, requires_grad=True)
    assert torch.autograd.gradcheck(lambda x: robot.sensor_poses(x * D), q)
    assert torch.autograd.gradgradcheck(lambda x: robot.sensor_poses(x * D), q, atol=1e-5)


def test_names_of_the_configuration():
    assert three_segments().coordinates[:4] == ("delta_x_1", "delta_y_1", "delta_L_1", "delta_x_2")


def test_mounts_join_in_order_and_broadcast_their_batches():
    tilt = torch.linspace(-0.3, 0.3, 5, dtype=torch.float64).unsqueeze(-1)
    one, batch = magnet_mounts([2], 0.05), sensor_mounts([0, 1], L, 0.013, 0.0, tilt)
    both = one.joined(Mounts(batch.segment, batch.axial[0], batch.local))  # only ``local`` is a batch
    assert both.segment == (2, 0, 1)
    assert both.axial.shape == (5, 3)
    assert torch.equal(both.local[:, 1:], batch.local)


def test_azimuths_of_a_ring():
    torch.testing.assert_close(
        ring_azimuths(4, 0.5), 0.5 + torch.arange(4, dtype=torch.float64) * math.pi / 2
    )


def test_no_mounts_give_no_poses():
    assert three_segments().sensor_poses(random_q(2, 9)).shape == (2, 0, 4, 4)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: Robot(()), "Input segments of Robot must be at least one segment"),
        (lambda: three_segments().tip(torch.zeros(8)), r"last dimension 9 \(delta_x_1, .* shape \(8,\)"),
        (
            lambda: three_segments().tip(torch.full((9,), math.nan)),
            "Input q of Robot must be finite; instead received 9 values",
        ),
        (
            lambda: three_segments(sensors=sensor_mounts([0, 1], [0.1, 0.116], 0.013)),
            r"sensors.axial of Robot must be between 0 and the length 0.11 m of segment 1; .* 0.116 m for mount 1",
        ),
        (
            lambda: three_segments(magnets=magnet_mounts([3], 0.05)),
            "magnets.segment of Robot .* 3 for mount 0",
        ),
        (lambda: three_segments(magnets=magnet_mounts([0], -0.001)), "magnets.axial of Robot .* -0.001 m"),
        (lambda: sensor_mounts([0], L, -0.013), r"Input radial of sensor_mounts must be not negative"),
        (
            lambda: sensor_mounts([0, 1], L, [0.01, 0.01, 0.01]),
            r"radial .* each of 2 mounts; .* shape \(3,\)",
        ),
        (lambda: sensor_mounts([0], L, 0.013, math.nan), "Input azimuth of sensor_mounts must be finite"),
        (
            lambda: Mounts((0, 1), torch.zeros(2), torch.eye(4).expand(3, 4, 4)),
            "Input axial, local of Mounts must be for the 2 mounts",
        ),
    ],
)
def test_bad_input(call, message):
    with pytest.raises(InputError, match=message):
        call()


def test_mount_beyond_the_segment_in_a_batch_of_robots():
    axial = torch.tensor([[0.1], [0.2]], dtype=torch.float64)
    with pytest.raises(InputError, match="0.2 m for mount 0"):
        three_segments(sensors=sensor_mounts([0], axial))


def test_inverse_of_the_tip_leads_back():
    robot, q = three_segments(), random_q(9)
    torch.testing.assert_close(se3.inverse(robot.tip(q)) @ robot.tip(q), torch.eye(4, dtype=torch.float64))
