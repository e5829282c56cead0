"""The filter with errors of the sensors in its state: against the textbook, and its covariance against its errors."""

import math

import numpy as np
import pytest
import torch
from scipy.stats import chi2

from edition1.errors import InputError
from edition1.estimation.drift_filter import Drift, DriftFilter

FAR = torch.full((1,), 50.0, dtype=torch.float64)
ONE = torch.ones(1, dtype=torch.float64)
STD, TIME = [0.5, 1.0], [2.0, math.inf]
H = np.array([[1.0, 1.0, 0.0], [2.0, 0.0, 1.0], [0.5, 0.0, 0.0]])  # readings of (q, b1, b2)
SIGMA, RATE, A = 0.2, 10.0, 0.8


def linear_filter(**options):
    drift = Drift(torch.tensor(STD, dtype=torch.float64), torch.tensor(TIME, dtype=torch.float64))
    sensing = lambda x: x @ torch.from_numpy(H).T  # noqa: E731
    return DriftFilter(sensing, -FAR, FAR, A * ONE, ONE, drift, **({"noise_mt": SIGMA} | options))


def simulated(steps, runs, seed=0):
    rng = np.random.default_rng(seed)
    tau = 1 / RATE
    root = np.linalg.cholesky(A**2 * np.array([[tau**3 / 3, tau**2 / 2], [tau**2 / 2, tau]]))
    q, v = 5 * rng.standard_normal(runs), rng.standard_normal(runs)
    b = rng.standard_normal((runs, 2)) * STD
    kept = np.exp(-tau / np.array(TIME))
    truth = []
    for k in range(steps):
        if k:
            kick = rng.standard_normal((runs, 2)) @ root.T
            q, v = q + tau * v + kick[:, 0], v + kick[:, 1]
            b = kept * b + STD * np.sqrt(1 - kept**2) * rng.standard_normal((runs, 2))
        truth.append(np.concatenate([q[:, None], b], axis=1))
    x = np.stack(truth)
    return torch.from_numpy(x), torch.from_numpy(x @ H.T + SIGMA * rng.standard_normal((steps, runs, 3)))


def run(method, u, **options):
    state = method.init(torch.zeros(*u.shape[1:-1], 1, dtype=torch.float64))
    found = []
    for k, row in enumerate(u):
        state, estimate = method.step(state, row, k / RATE, **options)
        found.append(estimate)
    return state, found


def test_equals_the_kalman_filter_on_a_linear_model():
    _, u = simulated(30, 1)
    _, found = run(linear_filter(), u[:, 0])
    tau, kept = 1 / RATE, np.exp(-(1 / RATE) / np.array(TIME))
    F = np.diag([1.0, 1.0, *kept])
    F[0, 1] = tau
    Q = np.zeros((4, 4))
    Q[:2, :2] = A**2 * np.array([[tau**3 / 3, tau**2 / 2], [tau**2 / 2, tau]])
    Q[2:, 2:] = np.diag(np.square(STD) * (1 - kept**2))
    M = np.insert(H, 1, 0.0, axis=1)
    x, P = np.zeros(4), np.diag([100.0**2 / 12, 1.0, *np.square(STD)])
    for k, y in enumerate(u[:, 0].numpy()):
        if k:
            x, P = F @ x, F @ P @ F.T + Q
        K = P @ M.T @ np.linalg.inv(M @ P @ M.T + SIGMA**2 * np.eye(3))
        x, P = x + K @ (y - M @ x), (np.eye(4) - K @ M) @ P
        np.testing.assert_allclose(found[k].q, x[:1], atol=1e-7)
        np.testing.assert_allclose(found[k].diagnostics["drift"], x[2:], atol=1e-7)
        np.testing.assert_allclose(found[k].covariance, P[:1, :1], atol=1e-8)


def test_covariance_is_consistent_where_a_filter_that_averages_is_not():
    runs = 300
    x, u = simulated(25, runs)
    low, high = chi2.ppf([5e-4, 1 - 5e-4], runs) / runs
    state, found = run(linear_filter(), u)
    for k in range(5, 25):
        e = (found[k].q - x[k, :, :1]).squeeze(-1)
        assert low < float((e**2 / found[k].covariance[:, 0, 0]).mean()) < high
    whole = (state.q - x[-1]).unsqueeze(-1)
    P = state.covariance[:, :3, :3]
    nees = float((whole.mT @ torch.linalg.solve(P, whole)).mean()) / 3
    assert abs(nees - 1) < 3.3 * math.sqrt(2 / (3 * runs))
    _, deaf = run(without_drift(), u)
    e = (deaf[-1].q - x[-1, :, :1]).squeeze(-1)
    assert float((e**2 / deaf[-1].covariance[:, 0, 0]).mean()) > 5


def without_drift():
    drift = Drift(torch.full((2,), 1e-6, dtype=torch.float64), torch.ones(2, dtype=torch.float64))
    sensing = lambda x: x @ torch.from_numpy(H).T  # noqa: E731
    return DriftFilter(sensing, -FAR, FAR, A * ONE, ONE, drift, noise_mt=SIGMA)


def test_a_known_pose_calibrates_and_is_forgotten():
    method = linear_filter(noise_mt=1e-3)
    state = method.init(0 * ONE)
    state, estimate = method.step(
        state, torch.tensor([0.3, -0.7, 0.0], dtype=torch.float64), 0.0, known=0 * ONE
    )
    torch.testing.assert_close(
        estimate.diagnostics["drift"], torch.tensor([0.3, -0.7], dtype=torch.float64), atol=1e-5, rtol=0
    )
    state = method.released(state, 2 * ONE)
    assert float(state.q[0]) == 2.0
    torch.testing.assert_close(state.q[1:], estimate.diagnostics["drift"])
    variances = state.covariance.diagonal()
    assert float(variances[0]) == pytest.approx(100.0**2 / 12)
    assert float(variances[1:3].max()) < 1.1e-6
    assert state.t == 0.0


def test_same_bits_and_state_not_mutated():
    _, u = simulated(3, 4)
    state = linear_filter().init(torch.zeros(4, 1, dtype=torch.float64))
    before = state.q.clone(), state.covariance.clone()
    one, two = (run(linear_filter(), u)[0] for _ in range(2))
    assert torch.equal(one.q, two.q)
    assert torch.equal(one.covariance, two.covariance)
    assert torch.equal(state.q, before[0])
    assert torch.equal(state.covariance, before[1])


def test_bad_input():
    one = torch.ones(2, dtype=torch.float64)
    with pytest.raises(InputError, match="time_s of Drift must be positive"):
        Drift(one, 0 * one)
    with pytest.raises(InputError, match="std, time_s of Drift must be one of each for every error"):
        Drift(one, one[:1])
    with pytest.raises(InputError, match="std of Drift must be finite"):
        Drift(one * math.inf, one)
    method = linear_filter()
    state, _ = method.step(method.init(0 * ONE), torch.zeros(3, dtype=torch.float64), 1.0)
    with pytest.raises(InputError, match="t of DriftFilter must be after the last step, 1.0 s"):
        method.step(state, torch.zeros(3, dtype=torch.float64), 1.0)
