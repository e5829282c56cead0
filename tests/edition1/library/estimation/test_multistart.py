"""Every minimum within the noise is reported; none is picked in silence."""

import math

import pytest
import torch
from edition1.errors import InputError
from edition1.estimation.levenberg_marquardt import LevenbergMarquardt
from edition1.estimation.multistart import search, starts_within
from edition1.kinematics.paper_robots import affine_robot, pcc_robot
from edition1.sensing.linearised import LinearisedSensing
from edition1.sensing.magnetic import readings
from edition1.sensing.magnets import ring

LOW, HIGH = torch.tensor([-0.02, -0.02, 0.0]).double(), torch.tensor([0.02, 0.02, 0.0066]).double()
MOMENTS = torch.from_numpy(ring("released").multipoles(9))


def fits(robot, low, high, q, count=8, noise=1e-3):
    method = LevenbergMarquardt(LinearisedSensing(robot, MOMENTS), low, high, noise_mt=noise)
    u = readings(robot, q, ring("released"))
    return search(method, u, starts_within(low, high, count, seed=0))


def test_three_sensors_determine_a_segment():
    q = torch.tensor([[0.012, -0.007, 0.002], [-0.015, 0.011, 0.005]], dtype=torch.float64)
    found = fits(pcc_robot(1), LOW, HIGH, q)
    assert found.count.tolist() == [1, 1]
    torch.testing.assert_close(found.only(), q, atol=1e-6, rtol=0)


def test_two_sensors_leave_two_mirror_images():
    """Sensors on the x axis do not tell delta_y from -delta_y; the elongation is known here."""
    q = torch.tensor([0.012, -0.009, 0.002], dtype=torch.float64)
    robot = pcc_robot(1, sensors_per_segment=2)
    u = readings(robot, q, ring("released"))
    low, high = LOW.clone(), HIGH.clone()
    low[2], high[2] = 0.002 - 1e-9, 0.002 + 1e-9
    method = LevenbergMarquardt(LinearisedSensing(robot, MOMENTS), low, high, noise_mt=1e-4)
    found = search(method, u, starts_within(low, high, 12, seed=0))
    y = found.q[found.candidate][:, 1]
    assert int(found.count) == 2
    assert sorted(y.tolist()) == pytest.approx([-0.009, 0.009], abs=2e-4)
    with pytest.raises(InputError, match=r"received 2 configurations within the noise"):
        found.only()


def test_affine_segment_has_two_configurations_of_each_shape():
    q = torch.tensor([0.4, 2.0, 1.0, 2e-3], dtype=torch.float64)
    low = torch.tensor([-0.95, -3.8, -math.pi, 0.0], dtype=torch.float64)
    found = fits(affine_robot(), low, -low + torch.tensor([0, 0, 0, 0.0066]), q, count=24)
    assert int(found.count) == 2
    other = torch.tensor([-0.4, -2.0, 1.0 - math.pi, 2e-3], dtype=torch.float64)
    ours = found.q[found.candidate]
    ours = ours[ours[:, 1].argsort()]
    torch.testing.assert_close(ours, torch.stack([other, q]), atol=1e-4, rtol=0)


def test_starts_fill_the_box():
    starts = starts_within(LOW, HIGH, 65, seed=0)
    torch.testing.assert_close(starts[0], (LOW + HIGH) / 2)
    assert bool((starts >= LOW).all() & (starts <= HIGH).all())
    octants = (starts[1:] > starts[0]).int() @ torch.tensor([1, 2, 4], dtype=torch.int32)
    assert torch.bincount(octants.long(), minlength=8).tolist() == [8] * 8
    assert torch.equal(starts, starts_within(LOW, HIGH, 65, seed=0))


def test_bad_input():
    method = LevenbergMarquardt(lambda q: q, LOW, HIGH)
    with pytest.raises(InputError, match="Input starts of search must be at least one configuration"):
        search(method, LOW, LOW[:0].reshape(0, 3))
    with pytest.raises(InputError, match="Input count of starts_within must be at least 1"):
        starts_within(LOW, HIGH, 0, seed=0)
