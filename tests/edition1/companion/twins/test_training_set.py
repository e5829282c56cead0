"""Statistics of the published training set, ranges of every draw, determinism."""

import math
from dataclasses import replace

import pytest
import torch

from edition1.errors import InputError
from edition1.kinematics.paper_robots import Dimensions, affine_robot
from edition1.sensing.magnetic import readings
from edition1.sensing.magnets import ring
from edition1_companion.twins import networks as training
from edition1_companion.twins.training_set import BENDING_M, ELONGATION_M, affine_training_set, training_set


@pytest.fixture(scope="module")
def one_segment():
    return training_set(1, seed=1)


def test_range_and_mean_of_the_readings(one_segment):
    """Released training set, one segment: range 1.86038 mT, mean -2.053962 mT.

    The range is an extreme of random draws and scatters by 1.5 % between seeds (1.80 to 1.86 mT over 0-5); the
    corners of the box span 1.919 mT. Seed 1 is the one that the networks are trained on.
    """
    u = one_segment.u
    assert float(u.max() - u.min()) == pytest.approx(1.86038, rel=5e-3)
    assert float(u.mean()) == pytest.approx(-2.053962, abs=0.002)


def test_draws_fill_their_ranges(one_segment):
    q, local = one_segment.q, one_segment.robot.sensors.local
    assert q.shape == (120_000, 3)
    for column, low, high in (
        (0, -BENDING_M, BENDING_M),
        (1, -BENDING_M, BENDING_M),
        (2, 0, ELONGATION_M["released"]),
    ):
        assert float(q[:, column].min()) == pytest.approx(low, abs=1e-3 * (high - low))
        assert float(q[:, column].max()) == pytest.approx(high, abs=1e-3 * (high - low))
        assert float(q[:, column].mean()) == pytest.approx((low + high) / 2, abs=0.004 * (high - low))
    radius = local[..., :2, 3].norm(dim=-1)
    assert float(radius.min()) == pytest.approx(8.67e-3, abs=2e-5)
    assert float(radius.max()) == pytest.approx(17.33e-3, abs=2e-5)
    tilt = (-local[..., 2, 2]).arccos()
    assert math.degrees(float(tilt.max())) == pytest.approx(20, abs=0.05)
    azimuth = torch.atan2(local[:, 0, 1, 3], local[:, 0, 0, 3])
    assert float(azimuth.min()) == pytest.approx(0, abs=1e-3)
    assert float(azimuth.max()) == pytest.approx(2 * math.pi / 3, abs=1e-3)


def test_one_placement_is_shared_by_all_sensors_of_a_sample():
    data = training_set(2, seed=3, samples=50)
    radius = data.robot.sensors.local[..., :2, 3].norm(dim=-1)
    torch.testing.assert_close(radius, radius[:, :1].expand_as(radius))
    torch.testing.assert_close(data.robot.sensors.local[:, :3], data.robot.sensors.local[:, 3:])


def test_readings_belong_to_their_configurations():
    data = training_set(2, seed=3, samples=20, magnet=ring("published"))
    torch.testing.assert_close(data.u, readings(data.robot, data.q, ring("published")))


def test_earth_field_changes_direction_and_fixes_the_placement():
    data = training_set(3, seed=0, samples=2000, earth=True)
    assert data.earth_axis is not None
    torch.testing.assert_close(data.earth_axis.norm(dim=-1), torch.ones(2000, dtype=torch.float64))
    assert (data.robot.sensors.local[..., :2, 3].norm(dim=-1) - 0.013).abs().max() < 1e-12
    without = readings(data.robot, data.q, ring("released"))
    axis = data.robot.sensor_poses(data.q)[..., :3, 2]
    expected = 0.065 * (axis * data.earth_axis.unsqueeze(-2)).sum(-1)
    torch.testing.assert_close(data.u - without, expected, atol=1e-12, rtol=0)


def test_same_seed_same_bits():
    a, b, c = (training_set(1, seed=seed, samples=100) for seed in (5, 5, 6))
    assert torch.equal(a.u, b.u)
    assert torch.equal(a.q, b.q)
    assert not torch.equal(a.q, c.q)


def test_bad_input():
    with pytest.raises(
        InputError, match="Input samples of training_set must be positive; instead received 0."
    ):
        training_set(1, seed=0, samples=0)


def relative_shift(data):
    """Largest difference of the means of the three planes from the released ones, in standard errors of both."""
    released = torch.tensor([-3.34117, -5.61551, -2.55219]).double()
    planes = data.u.unflatten(-1, (3, 3)).mean(-2)  # sensor j is in plane j mod 3
    error = planes.std(0) * (1 / len(planes) + 1 / 120_000) ** 0.5
    return float(((planes.mean(0) - released).abs() / error).max())


@pytest.fixture(scope="module")
def affine():
    return affine_training_set(seed=1, samples=20_000)


class TestAffine:
    def test_draws_fill_their_ranges(self, affine):
        bounds = (
            (-0.942478, 0.942478),
            (-3.769911, 3.769911),
            (0.0, 2 * math.pi),
            (0.0, ELONGATION_M["released"]),
        )
        for column, (low, high) in enumerate(bounds):
            x = affine.q[:, column]
            assert float(x.min()) == pytest.approx(low, abs=1e-3 * (high - low))
            assert float(x.max()) == pytest.approx(high, abs=1e-3 * (high - low))
            assert float(x.mean()) == pytest.approx((low + high) / 2, abs=0.01 * (high - low))

    def test_readings_belong_to_the_robots(self, affine):
        torch.testing.assert_close(affine.u, readings(affine.robot, affine.q, ring("released")))

    def test_sensors_of_a_plane_see_the_same_distribution(self, affine):
        """The azimuth is uniform, so by symmetry sensors j and j + 3 read alike in the mean; the planes differ."""
        mean, deviation = affine.u.mean(0), affine.u.std(0) / 20_000**0.5
        for plane in range(3):
            for other in (plane + 3, plane + 6):
                assert abs(float(mean[plane] - mean[other])) < 5 * float(deviation[plane])
        assert float((mean[0] - mean[1]).abs()) > 1

    def test_means_of_the_planes_are_those_of_the_released_data(self, affine):
        """-3.34117, -5.61551 and -2.55219 mT, kept with the released networks, within three standard errors.

        A magnet that slides along the bent backbone, and turns, is ten standard errors off in the first plane.
        """
        assert relative_shift(affine) < 3
        slid = affine_robot(magnet_shift_m=0.0)
        magnets = replace(slid.magnets, axial=slid.magnets.axial + Dimensions.MAGNET_SHIFT_M["released"])
        robot = replace(affine.robot, magnets=magnets)
        turned = replace(affine, u=readings(robot, affine.q, ring("released")))
        assert relative_shift(turned) > 10

    def test_networks_know_nothing_of_the_shift(self, monkeypatch, affine):
        """Readings of shifted magnets; distances to where the backbone is at 50 and 150 mm."""
        monkeypatch.setattr(training, "affine_training_set", lambda **_: affine)
        xi, u = training.AffineSpec(sensor=4, seed=0).rows()
        torch.testing.assert_close(u, affine.u[:, 4].float())
        segment = affine.robot.segments[0]
        sensor = affine.robot.sensor_poses(affine.q)[:, 4, :3, 3]
        for k, v in enumerate((0.25, 0.75)):
            place = segment.pose(affine.q, torch.tensor(v).double())[:, :3, 3]
            expected = (sensor - place).norm(dim=-1).float()
            torch.testing.assert_close(xi[:, 1 + 4 * k], expected)

    def test_same_seed_same_bits(self, affine):
        again = affine_training_set(seed=1, samples=20_000)
        assert torch.equal(affine.u, again.u)
        assert not torch.equal(affine.q, affine_training_set(seed=2, samples=20_000).q)

    def test_bad_input(self):
        with pytest.raises(InputError, match="Input samples of affine_training_set must be positive"):
            affine_training_set(seed=0, samples=0)
