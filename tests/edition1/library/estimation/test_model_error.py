"""What a wrong model adds to an estimate's uncertainty: closed forms, boundaries, and robots that were calibrated."""

import numpy as np
import pytest
import torch
from scipy.linalg import null_space
from scipy.stats import chi2

from edition1.errors import InputError
from edition1.estimation.kalman_filter import IteratedKalmanFilter
from edition1.estimation.levenberg_marquardt import LevenbergMarquardt
from edition1.estimation.model_error import WithModelError

NOISE = 0.1
DRAW = np.random.default_rng(0)
J = torch.from_numpy(DRAW.standard_normal((6, 3)))
ROOT = torch.from_numpy(DRAW.standard_normal((6, 2)))
E = ROOT @ ROOT.T
U = torch.from_numpy(DRAW.standard_normal(6))
FAR = torch.full((3,), 1e6, dtype=torch.float64)
ORIGIN = torch.zeros(3, dtype=torch.float64)


def linear(q):
    return q @ J.T


def always(q):
    return E.expand(*q.shape[:-1], 6, 6)


def wrapped(error=always, low=-FAR, high=FAR, **options):
    plain = LevenbergMarquardt(linear, low, high, noise_mt=NOISE)
    return WithModelError(plain, linear, NOISE, error, **{"bounds": (low, high), **options})


def estimate(method, u=U, **options):
    return method.step(method.init(torch.zeros_like(u[..., :3]), seed=0), u, 0.0, **options)[1]


def expected_test(rows, columns, u):
    """The three numbers by their definition."""
    rows, columns = np.array(rows), np.array(columns)
    A, M = J.numpy()[rows][:, columns], E.numpy()[np.ix_(rows, rows)]
    N = null_space(A.T)
    W = np.linalg.inv(N.T @ (NOISE**2 * np.eye(len(rows)) + M) @ N)
    p = N.T @ u.numpy()[rows]
    return p @ W @ p, N.shape[1], np.trace(N.T @ M @ N @ W) / N.shape[1]


def numbers(found):
    return [float(found.diagnostics[name]) for name in ("chi2", "dof", "systematic")]


@pytest.mark.parametrize("bounds", [(-FAR, FAR), None])
def test_covariance_and_chi_square_in_closed_form(bounds):
    found = estimate(wrapped(bounds=bounds))
    G = torch.linalg.inv(J.T @ J) @ J.T
    wanted = NOISE**2 * torch.linalg.inv(J.T @ J) + G @ E @ G.T
    torch.testing.assert_close(found.covariance, wanted, rtol=1e-9, atol=1e-12)
    assert numbers(found) == pytest.approx(expected_test(range(6), range(3), U), rel=1e-9)
    assert found.diagnostics["masked"] == 0


def test_without_an_error_it_is_the_estimator_itself():
    method = wrapped(lambda q: torch.zeros(6, 6, dtype=torch.float64))
    found, plain = estimate(method), estimate(method.estimator)
    assert torch.equal(found.q, plain.q)
    assert torch.equal(found.covariance, plain.covariance)
    residual = float(((U - plain.u_hat) / NOISE).square().sum())
    assert numbers(found) == pytest.approx([residual, 3, 0.0])


def test_a_sensor_not_in_use_counts_nowhere():
    mask = torch.tensor([True, False, True, True, True, True])
    broken = U.clone()
    broken[4] = torch.nan
    found = estimate(wrapped(), broken, mask=mask)
    rows = [0, 2, 3, 5]
    G = torch.linalg.inv(J[rows].T @ J[rows]) @ J[rows].T
    wanted = NOISE**2 * torch.linalg.inv(J[rows].T @ J[rows]) + G @ E[rows][:, rows] @ G.T
    torch.testing.assert_close(found.covariance, wanted, rtol=1e-9, atol=1e-12)
    assert numbers(found) == pytest.approx(expected_test(rows, range(3), U), rel=1e-9)


def test_coordinates_that_are_held_or_at_a_bound():
    known = torch.tensor([torch.nan, 0.3, torch.nan], dtype=torch.float64)
    found = estimate(wrapped(), known=known)
    assert bool((found.covariance[1] == 0).all())
    residual = U - linear(torch.tensor([0.0, 0.3, 0.0], dtype=torch.float64))
    assert numbers(found) == pytest.approx(expected_test(range(6), [0, 2], residual), rel=1e-9)
    free = estimate(wrapped()).q
    stop = torch.where(torch.arange(3) == 0, free - 0.01 * free.sign(), 1e6 * free.sign())
    low, high = torch.minimum(stop, -FAR), torch.maximum(stop, FAR)
    low, high = torch.where(free < 0, stop, low), torch.where(free < 0, high, stop)
    at_bound = estimate(wrapped(low=low, high=high))
    assert bool(at_bound.diagnostics["at_bound"])
    assert numbers(at_bound) == pytest.approx(
        expected_test(range(6), [1, 2], U - J[:, 0] * stop[0]), rel=1e-9
    )


def test_as_many_sensors_as_coordinates_leave_nothing_to_test():
    found = estimate(wrapped(), mask=torch.arange(6) < 3)
    assert numbers(found) == [0.0, 0.0, 0.0]


def test_a_batch_is_a_loop():
    u = torch.from_numpy(np.random.default_rng(1).standard_normal((2, 3, 6)))
    u[1, 2, 0] = torch.nan
    mask = torch.rand(2, 3, 6, generator=torch.Generator().manual_seed(0)) < 0.9
    method = wrapped(lambda q: always(q) * (1 + q[..., :1, None] ** 2))
    both = estimate(method, u, mask=mask)
    for i in range(2):
        for k in range(3):
            one = estimate(method, u[i, k], mask=mask[i, k])
            torch.testing.assert_close(both.covariance[i, k], one.covariance)
            for name in ("chi2", "dof", "systematic"):
                torch.testing.assert_close(both.diagnostics[name][i, k], one.diagnostics[name])


def test_covariance_and_chi_square_against_monte_carlo():
    """The error of the model drawn anew for every robot, noise for every reading."""
    generator = torch.Generator().manual_seed(0)
    n = 4000
    draw = torch.randn(n, 2, generator=generator, dtype=torch.float64) @ ROOT.T
    u = draw + NOISE * torch.randn(n, 6, generator=generator, dtype=torch.float64)
    found = estimate(wrapped(), u)
    nees = (found.q * torch.linalg.solve(found.covariance, found.q.unsqueeze(-1)).squeeze(-1)).sum(-1) / 3
    assert float(nees.mean()) == pytest.approx(1.0, abs=0.05)
    inside = found.diagnostics["chi2"] < chi2.ppf(0.95, 3)
    assert float(inside.double().mean()) == pytest.approx(0.95, abs=0.015)


def test_a_filter_follows_what_lasts_as_far_as_least_squares():
    """The same wrong reading again and again: the filter ends where least squares is, and its variance says so."""
    rest = {"acceleration": 0 * FAR + 0.01, "velocity": 0 * FAR + 0.01}
    plain = IteratedKalmanFilter(linear, -FAR, FAR, **rest, noise_mt=NOISE)
    method = WithModelError(plain, linear, NOISE, always, (-FAR, FAR))
    state, wrong = method.init(ORIGIN, seed=0), ROOT @ torch.tensor([1.0, -1.0], dtype=torch.float64)
    for k in range(200):
        state, found = method.step(state, wrong, 0.1 * k)
    G = torch.linalg.inv(J.T @ J) @ J.T
    torch.testing.assert_close(found.q, G @ wrong, rtol=1e-2, atol=1e-3)
    added = found.covariance - state.covariance[:3, :3]
    torch.testing.assert_close(added, G @ E @ G.T, rtol=1e-6, atol=1e-9)
    assert float(state.covariance[:3, :3].trace()) < 0.9 * float(estimate(wrapped()).covariance.trace())


def test_wrong_input():
    with pytest.raises(InputError, match="Input noise of WithModelError must be positive"):
        WithModelError(wrapped().estimator, linear, 0.0, always)
    with pytest.raises(InputError, match="Input error of WithModelError must be finite"):
        estimate(wrapped(lambda q: always(q) * torch.nan))
