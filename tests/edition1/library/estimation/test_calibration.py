"""Calibration: known errors found again, its uncertainty against Monte Carlo, what poses do not determine."""

import math
from dataclasses import replace

import pytest
import torch

from edition1 import se3
from edition1.errors import InputError
from edition1.estimation.calibration import calibrate
from edition1.estimation.poses import configurations
from edition1.kinematics.paper_robots import pcc_robot
from edition1.sensing.linearised import LinearisedSensing
from edition1.sensing.magnetic import readings
from edition1.sensing.magnets import ring
from edition1.sensing.placement import Tolerances, placed

MOMENTS = torch.from_numpy(ring("released").multipoles(9))
NOISE = 7.1e-4
POSE = {"position_m": 0.2e-3, "rotation_rad": math.radians(0.2)}
NO_POSE_NOISE = 1e-20 * torch.eye(3).double()


def generator(seed=0):
    return torch.Generator().manual_seed(seed)


def random_poses(robot, *shape, seed=0):
    n = len(robot.segments)
    low = torch.tensor([-0.02, -0.02, 0.0] * n).double()
    return low + torch.tensor([0.04, 0.04, 0.0066] * n) * torch.rand(
        *shape, robot.n_q, dtype=torch.float64, generator=generator(seed)
    )


def measured(T, seed=0):
    noise = torch.randn(*T.shape[:-2], 6, dtype=torch.float64, generator=generator(seed))
    angle = POSE["rotation_rad"] * noise[..., :3]
    turn = se3.rotation_z(angle[..., 2]) @ se3.rotation_y(angle[..., 1]) @ se3.rotation_x(angle[..., 0])
    return se3.pose(T[..., :3, :3] @ turn, T[..., :3, 3] + POSE["position_m"] * noise[..., 3:])


def moved(robot, parameters):
    parts = placed(robot, MOMENTS, parameters)
    return replace(robot, magnets=parts.magnets, sensors=parts.sensors)


def test_configurations_invert_the_poses():
    robot = pcc_robot(3)
    q = random_poses(robot, 4, 50)
    found, covariance = configurations(robot, robot.base_poses(q)[..., 1:, :, :], **POSE)
    torch.testing.assert_close(found, q, atol=1e-9, rtol=0)
    assert covariance.shape == (4, 50, 9, 9)


def test_covariance_of_configurations_is_what_they_scatter():
    robot = pcc_robot(2)
    q = random_poses(robot, 1).expand(4000, -1)
    found, covariance = configurations(robot, measured(robot.base_poses(q)[..., 1:, :, :]), **POSE)
    torch.testing.assert_close(
        (found - q).std(0), covariance.diagonal(dim1=-2, dim2=-1).mean(0).sqrt(), rtol=0.05, atol=0
    )


def test_known_errors_are_found_in_noise_free_poses():
    """Placement errors of the size of the tolerances, readings by magpylib."""
    robot = pcc_robot(1)
    scale = Tolerances().of_parameters(robot, 5)
    truth = scale * (2 * torch.rand(22, dtype=torch.float64, generator=generator(1)) - 1)
    truth[8:17:4] = truth[17:] = 0.0  # gains, moments
    q = random_poses(robot, 60)
    u = readings(moved(robot, truth), q, ring("released"))
    found = calibrate(robot, q, NO_POSE_NOISE, u, MOMENTS, noise_mt=1e-6, iterations=15)
    assert found.last_step < 1e-6
    placement = [k for k in range(17) if k not in (8, 12, 16)]
    assert float(((found.estimate - truth) / scale)[placement].abs().max()) < 0.02
    q = random_poses(robot, 200, seed=1)
    error = found.sensing()(q) - readings(moved(robot, truth), q, ring("released"))
    assert float(error.abs().max()) < 5e-6


def test_gains_are_found():
    robot, q = pcc_robot(1), random_poses(pcc_robot(1), 60)
    gain = torch.tensor([1.01, 0.99, 1.0]).double()
    u = LinearisedSensing(robot, MOMENTS, gain)(q)
    found = calibrate(robot, q, NO_POSE_NOISE, u, MOMENTS, noise_mt=1e-6)
    torch.testing.assert_close(found.gain, gain, atol=1e-3, rtol=0)


def test_uncertainty_is_what_the_estimates_scatter():
    """Robots drawn from the prior, noisy poses and readings: errors are as large as stated."""
    robot, n = pcc_robot(1), 200
    tolerances = Tolerances()
    scale = tolerances.of_parameters(robot, 5)
    truth = scale * torch.randn(n, 22, dtype=torch.float64, generator=generator(2))
    parts = placed(robot, MOMENTS, truth)
    q = random_poses(robot, n, 50)
    true = placed(robot, MOMENTS, truth.unsqueeze(1))
    sensing = LinearisedSensing(
        replace(robot, magnets=true.magnets, sensors=true.sensors), parts.moments.unsqueeze(1), true.gain
    )
    u = sensing(q)
    u = u + NOISE * torch.randn(u.shape, dtype=torch.float64, generator=generator(3))
    found_q, covariance = configurations(robot, measured(robot.base_poses(q)[..., 1:, :, :]), **POSE)
    found = calibrate(robot, found_q, covariance, u, MOMENTS, noise_mt=NOISE, tolerances=tolerances)
    z = (found.estimate - truth) / found.deviation
    assert 0.9 < float(z.square().mean().sqrt()) < 1.1
    assert float(z.square().mean(0).sqrt().max()) < 1.3
    assert 0.85 < float(found.chi2.mean()) < 1.05


def test_a_calibrated_robot_predicts_better():
    robot = pcc_robot(3)
    scale = Tolerances().of_parameters(robot, 5)
    truth = scale * (2 * torch.rand(len(scale), dtype=torch.float64, generator=generator(4)) - 1)
    truth[-5:] = 0.0
    truth[18:-5:4] = 0.0
    q, other = random_poses(robot, 100), random_poses(robot, 100, seed=1)
    u = readings(moved(robot, truth), q, ring("released"))
    u = u + NOISE * torch.randn(u.shape, dtype=torch.float64, generator=generator(5))
    found_q, covariance = configurations(robot, measured(robot.base_poses(q)[..., 1:, :, :]), **POSE)
    sensing = calibrate(robot, found_q, covariance, u, MOMENTS, noise_mt=NOISE).sensing()
    reference = readings(moved(robot, truth), other, ring("released"))
    before = (LinearisedSensing(robot, MOMENTS)(other) - reference).square().mean().sqrt()
    after = (sensing(other) - reference).square().mean().sqrt()
    assert after < before / 10


def noisy_calibration(n=60, batch=(), **options):
    robot = pcc_robot(1)
    q = random_poses(robot, *batch, n)
    u = readings(robot, q, ring("released"))
    u = u + NOISE * torch.randn(u.shape, dtype=torch.float64, generator=generator(6))
    covariance = torch.diag(torch.tensor([5e-5, 5e-5, 2e-4]).double() ** 2)
    return calibrate(robot, q, covariance, u, MOMENTS, noise_mt=NOISE, **options)


def test_report_names_what_is_not_determined():
    """High moments are far below the noise; one pose leaves nearly everything open."""
    report = noisy_calibration().undetermined()
    assert any("moment A7" in line for line in report)
    assert any("moment A9" in line for line in report)
    assert not any("sensor 1 azimuth" in line for line in report)
    assert len(noisy_calibration(1).undetermined()) >= 22 - 3


def test_report_names_the_common_gain():
    """A common gain and a common factor of all moments are the same thing, however many poses there are."""
    robot, q = pcc_robot(1), random_poses(pcc_robot(1), 60)
    tolerances = Tolerances(moments=0.01)
    u = LinearisedSensing(robot, MOMENTS[:1])(q)
    found = calibrate(robot, q, NO_POSE_NOISE, u, MOMENTS[:1], noise_mt=1e-7, tolerances=tolerances)
    report = found.undetermined()
    assert len(report) == 1
    for name in ("sensor 1 gain", "sensor 2 gain", "sensor 3 gain", "moment A1"):
        assert name in report[0]
    assert report[0].endswith("(uncertainty 1.00 of the prior)")


def test_batch_is_its_members_and_the_same_bits_twice():
    both = noisy_calibration(batch=(2,))
    again = noisy_calibration(batch=(2,))
    assert torch.equal(both.estimate, again.estimate)
    robot = pcc_robot(1)
    q = random_poses(robot, 2, 60)
    u = readings(robot, q, ring("released"))
    u = u + NOISE * torch.randn(u.shape, dtype=torch.float64, generator=generator(6))
    covariance = torch.diag(torch.tensor([5e-5, 5e-5, 2e-4]).double() ** 2)
    one = calibrate(robot, q[1], covariance, u[1], MOMENTS, noise_mt=NOISE)
    torch.testing.assert_close(both.estimate[1], one.estimate, atol=1e-7, rtol=1e-4)
    with pytest.raises(InputError, match="calibration of undetermined must be that of one robot"):
        both.undetermined()


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (
            {"q": torch.zeros(0, 3).double(), "u": torch.zeros(0, 3).double()},
            "q of calibrate must be at least one pose",
        ),
        ({"q": torch.zeros(4, 6).double()}, "q of calibrate must be of last dimension 3"),
        ({"u": torch.zeros(4, 2).double()}, r"u of calibrate must be one reading for each of 3 sensors"),
        (
            {"u": torch.full((4, 3), math.nan).double()},
            "u of calibrate must be finite; instead received 12 values",
        ),
        (
            {"q_covariance": torch.eye(2).double()},
            r"q_covariance of calibrate must be of last dimensions \(3, 3\)",
        ),
        ({"noise_mt": 0.0}, "noise_mt of calibrate must be positive"),
        ({"iterations": 0}, "iterations of calibrate must be at least 1"),
    ],
)
def test_bad_input(change, message):
    arguments = {
        "robot": pcc_robot(1),
        "q": torch.zeros(4, 3).double(),
        "q_covariance": torch.eye(3).double(),
        "u": torch.zeros(4, 3).double(),
        "moments": MOMENTS,
        "noise_mt": NOISE,
    }
    with pytest.raises(InputError, match=message):
        calibrate(**(arguments | change))


@pytest.mark.parametrize(
    ("T", "noise", "message"),
    [
        (
            torch.eye(4).double().expand(5, 2, 4, 4),
            POSE,
            r"T_0_tip of configurations must be of shape \(..., 1, 4, 4\)",
        ),
        (torch.full((5, 1, 4, 4), math.nan).double(), POSE, "T_0_tip of configurations must be finite"),
        (torch.eye(4).double().expand(5, 1, 4, 4), POSE | {"position_m": 0.0}, "must be positive"),
    ],
)
def test_bad_poses(T, noise, message):
    with pytest.raises(InputError, match=message):
        configurations(pcc_robot(1), T, **noise)
