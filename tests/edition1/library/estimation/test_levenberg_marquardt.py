"""Linear problems in closed form, bounds, the covariance against Monte Carlo, cold starts."""

import math

import numpy as np
import pytest
import torch

from edition1.errors import InputError
from edition1.estimation.base import track
from edition1.estimation.levenberg_marquardt import LevenbergMarquardt, covariance, jacobian
from edition1.kinematics.paper_robots import pcc_robot
from edition1.sensing.magnetic import MagneticSensing, readings
from edition1.sensing.magnets import ring
from edition1.sensing.multipole import MultipoleField

A = torch.tensor([[1.0, 0.5], [-0.3, 2.0], [0.2, 0.1]], dtype=torch.float64)
WIDE = torch.tensor([10.0, 10.0], dtype=torch.float64)


def linear(q):
    return q @ A.T


def solve(u, low=-WIDE, high=WIDE, **options):
    estimator = LevenbergMarquardt(linear, low, high, **options)
    start = (low + high) / 2
    return estimator.step(estimator.init(start), u, 0.0)[1]


def test_linear_problem_is_the_least_squares_solution():
    u = torch.tensor([1.0, -1.0, 0.5]).double()
    expected = torch.linalg.lstsq(A, u.unsqueeze(-1)).solution.squeeze(-1)
    torch.testing.assert_close(solve(u).q, expected, atol=1e-10, rtol=0)


def test_bounded_problem_is_scipys():
    from scipy.optimize import lsq_linear

    u, low, high = np.array([4.0, -1.0, 0.5]), np.array([-1.0, -0.2]), np.array([1.0, 0.7])
    expected = lsq_linear(A.numpy(), u, (low, high)).x
    estimate = solve(torch.from_numpy(u), torch.from_numpy(low), torch.from_numpy(high))
    np.testing.assert_allclose(estimate.q, expected, atol=1e-8)
    assert bool(estimate.diagnostics["at_bound"])


def test_covariance_of_a_linear_problem():
    C = solve(torch.tensor([1.0, -1.0, 0.5]).double(), noise_mt=0.3).covariance
    torch.testing.assert_close(C, 0.09 * torch.linalg.inv(A.T @ A), rtol=1e-10, atol=0)


def test_covariance_of_what_is_not_determined_is_huge():
    J = torch.tensor([[1.0, 0.0], [2.0, 0.0]], dtype=torch.float64)
    C = covariance(J, 1.0)
    assert float(C[0, 0]) == pytest.approx(0.2)
    assert float(C[1, 1]) > 1e14


def test_jacobian_of_a_batch_is_that_of_its_members():
    robot = pcc_robot(2)
    sensing = MagneticSensing(robot, MultipoleField.of(ring("released")))
    q = 0.01 * torch.rand(3, 2, 6, dtype=torch.float64, generator=torch.Generator().manual_seed(0))
    u, J = jacobian(sensing, q)
    torch.testing.assert_close(u, sensing(q))
    torch.testing.assert_close(J[1, 1], torch.func.jacfwd(sensing)(q[1, 1]))


def box(n):
    low, high = [-0.02073, -0.02073, 0.0] * n, [0.02073, 0.02073, 0.0066] * n
    return torch.tensor(low).double(), torch.tensor(high).double()


@pytest.mark.parametrize("n", [1, 2, 3])
def test_cold_starts_reach_the_truth(n):
    """From the straight pose to anywhere in the training box, readings from magpylib: below 1 micrometre."""
    robot, (low, high) = pcc_robot(n), box(n)
    q = low + (high - low) * torch.rand(
        100, 3 * n, dtype=torch.float64, generator=torch.Generator().manual_seed(n)
    )
    sensing = MagneticSensing(robot, MultipoleField.of(ring("released")))
    estimator = LevenbergMarquardt(sensing, low, high, iterations=60)
    start = torch.tensor([0.0, 0.0, 2.75e-3] * n).double().expand(100, -1)
    estimate = estimator.step(estimator.init(start), readings(robot, q, ring("released")), 0.0)[1]
    assert float((estimate.q - q).abs().max()) < 1e-6


def test_covariance_ellipsoids_contain_the_truth_as_often_as_they_say():
    noise, n = 7.1e-4, 2000
    robot, (low, high) = pcc_robot(1), box(1)
    generator = torch.Generator().manual_seed(0)
    centre, half = (low + high) / 2, (high - low) / 2
    q = centre + 0.7 * half * (2 * torch.rand(n, 3, dtype=torch.float64, generator=generator) - 1)
    u = readings(robot, q, ring("released"))
    u = u + noise * torch.randn(u.shape, dtype=torch.float64, generator=generator)
    sensing = MagneticSensing(robot, MultipoleField.of(ring("released")))
    estimator = LevenbergMarquardt(sensing, low, high, noise_mt=noise)
    estimate = estimator.step(estimator.init(centre.expand(n, 3)), u, 0.0)[1]
    error = (estimate.q - q).unsqueeze(-1)
    distance = (error.mT @ torch.linalg.solve(estimate.covariance, error)).flatten()
    assert 0.93 < float((distance < 7.815).double().mean()) < 0.97  # chi-square, 3 degrees of freedom


def test_covariance_grows_when_sensors_fail():
    robot, (low, high) = pcc_robot(1, 4), box(1)
    q = torch.tensor([0.005, -0.003, 0.002]).double()
    u = readings(robot, q, ring("released")).expand(2, 4)
    sensing = MagneticSensing(robot, MultipoleField.of(ring("released")))
    mask = torch.tensor([[True] * 4, [True, True, True, False]])
    C = track(LevenbergMarquardt(sensing, low, high), u, (low + high) / 2, mask=mask).covariance
    assert (C[1].diagonal() > C[0].diagonal()).all()


def test_start_outside_the_bounds_is_refused():
    estimator = LevenbergMarquardt(linear, -WIDE, WIDE)
    with pytest.raises(
        InputError, match=r"Input q0 of LevenbergMarquardt must be within the bounds \[-10.0, -10.0\]"
    ):
        estimator.init(torch.tensor([11.0, 0.0]).double())


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"lower": WIDE}, "Input lower, upper of LevenbergMarquardt must be ordered bounds"),
        ({"noise_mt": math.nan}, "Input noise_mt of LevenbergMarquardt must be positive"),
        ({"iterations": 0}, "Input iterations of LevenbergMarquardt must be at least 1"),
    ],
)
def test_bad_input(change, message):
    with pytest.raises(InputError, match=message):
        LevenbergMarquardt(**({"sensing": linear, "lower": -WIDE, "upper": WIDE} | change))
