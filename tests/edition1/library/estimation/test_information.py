"""Fisher information and its inverse: closed forms, laws, Monte Carlo, what is not determined."""

import math

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from edition1.errors import InputError
from edition1.estimation.information import cramer_rao, fisher_information
from edition1.estimation.levenberg_marquardt import LevenbergMarquardt, covariance


def random_jacobian(*shape, seed=0):
    return torch.randn(*shape, dtype=torch.float64, generator=torch.Generator().manual_seed(seed))


def test_a_straight_line_in_closed_form():
    """Offset and slope from readings at x: the textbook variances of linear regression."""
    x, noise = torch.linspace(-1, 2, 7, dtype=torch.float64), 0.3
    bound = cramer_rao(fisher_information(torch.stack([torch.ones_like(x), x], dim=-1), noise))
    spread = (x - x.mean()).square().sum()
    torch.testing.assert_close(bound[1, 1], noise**2 / spread)
    torch.testing.assert_close(bound[0, 0], noise**2 * (1 / 7 + x.mean() ** 2 / spread))


@given(st.floats(1e-6, 1e3), st.floats(1e-3, 1e3))
def test_bound_is_proportional_to_the_squared_noise(noise, factor):
    J = random_jacobian(5, 3)
    one, two = (cramer_rao(fisher_information(J, x)) for x in (noise, noise * factor))
    torch.testing.assert_close(two, factor**2 * one, rtol=1e-9, atol=0)


def test_information_of_independent_sensors_adds_up():
    J, noise = random_jacobian(2, 4, 3), torch.tensor([0.1, 0.2, 1.0, 5.0], dtype=torch.float64)
    parts = [torch.outer(row, row) / s**2 for row, s in zip(J[0], noise, strict=True)]
    torch.testing.assert_close(fisher_information(J, noise)[0], sum(parts))
    torch.testing.assert_close(fisher_information(J, 0.2), fisher_information(J, torch.full((4,), 0.2)))


def test_a_sensor_without_weight_counts_as_none():
    J = random_jacobian(4, 3)
    noise = torch.tensor([0.1, 0.1, math.inf, 0.1], dtype=torch.float64)
    torch.testing.assert_close(fisher_information(J, noise), fisher_information(J[[0, 1, 3]], 0.1))


def test_another_sensor_never_raises_the_bound():
    J = random_jacobian(20, 5, 3)
    fewer, more = (cramer_rao(fisher_information(x, 1.0)) for x in (J[:, :4], J))
    assert float(torch.linalg.eigvalsh(fewer - more).min()) > -1e-9


def test_least_squares_in_a_linear_model_reaches_the_bound():
    """Covariance over 20,000 draws of noise, against the bound: within the scatter of such an estimate."""
    J, noise, n = random_jacobian(4, 2), 0.2, 20_000
    wide = torch.full((2,), 50.0, dtype=torch.float64)
    estimator = LevenbergMarquardt(lambda q: q @ J.T, -wide, wide, noise_mt=noise)
    truth = torch.tensor([1.0, -2.0], dtype=torch.float64)
    u = truth @ J.T + noise * random_jacobian(n, 4, seed=1)
    found = estimator.step(estimator.init(torch.zeros(n, 2, dtype=torch.float64)), u, 0.0)[1]
    bound = cramer_rao(fisher_information(J, noise))
    error = found.q - truth
    whitened = torch.linalg.solve_triangular(torch.linalg.cholesky(bound), error.T, upper=False)
    torch.testing.assert_close(torch.cov(whitened), torch.eye(2).double(), atol=4 * (2 / n) ** 0.5, rtol=0)
    torch.testing.assert_close(found.covariance[0], bound)


def test_bound_is_the_covariance_of_the_estimator():
    J = random_jacobian(3, 2, 9, 6) * torch.tensor([1e3, 1.0, 1e-3, 1.0, 1.0, 1e4], dtype=torch.float64)
    torch.testing.assert_close(cramer_rao(fisher_information(J, 0.3)), covariance(J, 0.3), rtol=1e-7, atol=0)


def test_what_is_not_determined_is_infinite_and_leaves_the_rest():
    """Only the sum of the first two coordinates is seen: they are open, the third is not."""
    J = torch.tensor([[1.0, 1.0, 0.0], [2.0, 2.0, 0.5], [0.0, 0.0, 2.0]], dtype=torch.float64)
    bound = cramer_rao(fisher_information(J, 0.1))
    assert torch.isinf(bound.diagonal()).tolist() == [True, True, False]
    assert torch.isnan(bound[0, 1])
    assert torch.isnan(bound[2, 0])
    reduced = cramer_rao(fisher_information(J[:, 1:], 0.1))  # the sum as one coordinate
    torch.testing.assert_close(bound[2, 2], reduced[1, 1])


def test_no_information_at_all():
    bound = cramer_rao(torch.zeros(2, 2, dtype=torch.float64))
    assert torch.isinf(bound.diagonal()).all()


def test_a_batch_is_its_members_and_a_singular_one_does_not_spoil_it():
    J = random_jacobian(2, 3, 4, 3)
    J[1, 1, :, 0] = 0.0
    bound = cramer_rao(fisher_information(J, 1.0))
    assert torch.isinf(bound[1, 1, 0, 0])
    torch.testing.assert_close(bound[0, 2], torch.linalg.inv(J[0, 2].T @ J[0, 2]))
    torch.testing.assert_close(bound[1, 1], cramer_rao(fisher_information(J[1, 1], 1.0)), equal_nan=True)


def test_derivative_of_the_bound():
    J = random_jacobian(5, 3).requires_grad_()
    assert torch.autograd.gradcheck(lambda x: cramer_rao(fisher_information(x, 0.7)), (J,))


@pytest.mark.parametrize(
    ("noise", "message"),
    [
        (0.0, r"Input noise_mt of fisher_information must be positive; instead received 0.0"),
        (math.nan, "Input noise_mt of fisher_information must be positive"),
        (torch.ones(3), r"one number, or one for each of 4 sensors; instead received shape \(3,\)"),
    ],
)
def test_noise_that_is_refused(noise, message):
    with pytest.raises(InputError, match=message):
        fisher_information(random_jacobian(4, 2), noise)


@pytest.mark.parametrize(
    ("information", "expected"),
    [
        ([[1.0, math.inf], [math.inf, 1.0]], "finite"),
        ([[1.0, 0.5], [0.0, 1.0]], "symmetric"),
        ([[1.0, 2.0], [2.0, 1.0]], "positive semi-definite; instead received an eigenvalue of -1"),
    ],
)
def test_matrices_that_are_no_information(information, expected):
    with pytest.raises(InputError, match=f"Input information of cramer_rao must be {expected}"):
        cramer_rao(torch.tensor(information, dtype=torch.float64))
