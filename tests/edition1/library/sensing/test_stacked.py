"""Stacked sensors: information adds, in closed form and through the estimators."""

import pytest
import torch

from edition1.errors import InputError
from edition1.estimation.kalman_filter import IteratedKalmanFilter
from edition1.estimation.levenberg_marquardt import LevenbergMarquardt, jacobian
from edition1.kinematics.paper_robots import pcc_robot
from edition1.sensing.linearised import LinearisedSensing
from edition1.sensing.magnets import ring
from edition1.sensing.stacked import StackedSensing


def fisher_information(J, noise):
    return J.mT @ J / noise**2


FAR = torch.full((3,), 100.0, dtype=torch.float64)
A = torch.tensor([[1.0, 0.5, 0.0], [0.0, 2.0, -1.0]], dtype=torch.float64)
B = torch.tensor([[0.3, 0.0, 1.0], [1.0, -1.0, 0.2], [0.0, 0.4, 0.7]], dtype=torch.float64)
NOISE = (0.1, torch.tensor([0.5, 2.0, 1.0], dtype=torch.float64))


def test_both_together_equal_the_sum_of_informations():
    """Linear and Gaussian: the update is the closed form in information, prior included."""
    q_true = torch.tensor([0.3, -1.0, 2.0], dtype=torch.float64)
    g = torch.Generator().manual_seed(0)
    u = [q_true @ A.T + 0.1 * torch.randn(2, generator=g, dtype=torch.float64)]
    u.append(q_true @ B.T + NOISE[1] * torch.randn(3, generator=g, dtype=torch.float64))
    sensing = StackedSensing((lambda q: q @ A.T, lambda q: q @ B.T), NOISE)
    method = IteratedKalmanFilter(sensing, -FAR, FAR, 0 * FAR + 1, 0 * FAR + 1)
    q0 = torch.zeros(3, dtype=torch.float64)
    _, found = method.step(method.init(q0), sensing.scaled(u), 0.0)
    prior = torch.diag(12 / (2 * FAR) ** 2)
    weights = (torch.full((2,), 100.0, dtype=torch.float64), NOISE[1] ** -2)
    information = prior + A.T @ torch.diag(weights[0]) @ A + B.T @ torch.diag(weights[1]) @ B
    right = A.T @ (weights[0] * u[0]) + B.T @ (weights[1] * u[1])
    torch.testing.assert_close(found.q, torch.linalg.solve(information, right), atol=1e-9, rtol=0)
    torch.testing.assert_close(found.covariance, torch.linalg.inv(information), atol=1e-9, rtol=1e-8)


def test_derivatives_of_the_parts_are_used():
    field = LinearisedSensing(pcc_robot(1), torch.from_numpy(ring("released").multipoles(9)))
    fine, coarse = (
        StackedSensing((field, field), (1e-3, 1e-2)),
        StackedSensing((field, lambda q: field(q)), (1e-3, 1e-2)),
    )
    q = torch.tensor([[0.01, -0.002, 0.003], [0.0, 0.0, 0.0]], dtype=torch.float64)
    for one, other in zip(jacobian(fine, q), jacobian(coarse, q), strict=True):
        torch.testing.assert_close(one, other, rtol=1e-11, atol=1e-6)
    total = fisher_information(jacobian(fine, q)[1], 1.0)
    J = field.linearise(q)[1]
    torch.testing.assert_close(
        total, fisher_information(J, 1e-3) + fisher_information(J, 1e-2), atol=1e-3, rtol=1e-11
    )


def test_two_equal_sensors_halve_the_variance():
    field = LinearisedSensing(pcc_robot(1), torch.from_numpy(ring("released").multipoles(9)))
    box = torch.tensor([0.02, 0.02, 0.006], dtype=torch.float64)
    q = torch.tensor([0.005, -0.007, 0.002], dtype=torch.float64)
    variances = []
    for n in (1, 2):
        sensing = StackedSensing((field,) * n, (1e-3,) * n)
        method = LevenbergMarquardt(sensing, -box, box)
        variances.append(method.step(method.init(q), sensing(q), 0.0)[1].covariance)
    torch.testing.assert_close(variances[1], variances[0] / 2)


def test_bad_input():
    same = (lambda q: q,)
    with pytest.raises(InputError, match="one noise for each of some parts; instead received 1 parts and 2"):
        StackedSensing(same, (1.0, 1.0))
    with pytest.raises(InputError, match="noise of StackedSensing must be positive; instead received 0.0"):
        StackedSensing(same, (0.0,))
    sensing = StackedSensing(same, (torch.ones(2, dtype=torch.float64),))
    q = torch.zeros(3, dtype=torch.float64)
    with pytest.raises(InputError, match="one number or one for each of 3 readings of part 0"):
        sensing(q)
    with pytest.raises(InputError, match="readings of StackedSensing must be one for each of 1 parts"):
        sensing.scaled([q, q])
