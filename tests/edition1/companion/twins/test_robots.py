"""The robots as drawn in section 3.1 and 4.1."""

import math

import pytest
import torch

from edition1.errors import InputError
from edition1.kinematics.paper_robots import affine_robot, pcc_robot

STRAIGHT = torch.tensor([0.0, 0.0, 0.0, 0.0], dtype=torch.float64)


def test_sensors_of_the_affine_robot_lie_in_three_planes_120_degrees_apart():
    p = affine_robot().sensor_poses(STRAIGHT)[:, :3, 3]
    torch.testing.assert_close(p[:, :2].norm(dim=-1), torch.full((9,), 0.013, dtype=torch.float64))
    for plane in range(3):
        own = p[(p[:, 2] - 0.1 * plane).abs() < 1e-12]
        azimuth = torch.atan2(own[:, 1], own[:, 0]).rad2deg().remainder(360).sort().values
        assert azimuth.tolist() == pytest.approx([40 * plane, 40 * plane + 120, 40 * plane + 240], abs=1e-9)


@pytest.mark.parametrize(("shift", "expected"), [(-0.003, [0.047, 0.147]), (0.0, [0.05, 0.15])])
def test_magnets_of_the_affine_robot(shift, expected):
    T = affine_robot(magnet_shift_m=shift).magnet_poses(STRAIGHT)
    assert T[:, 2, 3].tolist() == pytest.approx(expected)
    torch.testing.assert_close(T[:, :3, :3], torch.eye(3, dtype=torch.float64).expand(2, 3, 3))


def test_magnets_of_a_bent_robot_are_shifted_along_their_own_axes():
    """On a circle: the shifted magnets lie on the tangents at 50 and 150 mm, outside the circle, and do not turn."""
    bend, shift = 2.0, -0.003
    radius = 0.200 / bend
    angle = bend * torch.tensor([0.25, 0.75], dtype=torch.float64)
    zero = torch.zeros_like(angle)
    place = radius * torch.stack([zero, angle.cos() - 1, angle.sin()], dim=-1)
    axis = torch.stack([zero, -angle.sin(), angle.cos()], dim=-1)
    q = torch.tensor([bend, 0.0, 0.0, 0.0], dtype=torch.float64)
    T = affine_robot().magnet_poses(q)
    torch.testing.assert_close(T[:, :3, 3], place + shift * axis)
    torch.testing.assert_close(T[:, :3, 2], axis)
    torch.testing.assert_close(T[:, :3, :3], affine_robot(magnet_shift_m=0.0).magnet_poses(q)[:, :3, :3])
    centre = torch.tensor([0.0, -radius, 0.0], dtype=torch.float64)
    outside = torch.full((2,), math.hypot(radius, shift), dtype=torch.float64)
    torch.testing.assert_close((T[:, :3, 3] - centre).norm(dim=-1), outside)


def test_all_sensors_measure_towards_the_base():
    for robot, q in ((affine_robot(), STRAIGHT), (pcc_robot(2), STRAIGHT.new_zeros(6))):
        torch.testing.assert_close(robot.sensor_poses(q)[:, 2, 2], -torch.ones(len(robot.sensors)).double())


def test_azimuth_offset_turns_all_sensors():
    offset = torch.tensor([0.0, 0.3], dtype=torch.float64)
    T = affine_robot(azimuth_offset=offset).sensor_poses(STRAIGHT)
    turned = torch.atan2(T[1, :, 1, 3], T[1, :, 0, 3]) - torch.atan2(T[0, :, 1, 3], T[0, :, 0, 3])
    assert turned.remainder(2 * math.pi).tolist() == pytest.approx([0.3] * 9)


def test_bad_input():
    with pytest.raises(InputError, match="Input n_segments, sensors_per_segment of pcc_robot must be at lea"):
        pcc_robot(0)
