"""Smoothing against the dense posterior of a linear Gaussian model, whole and with a lag, for every filter."""

import math

import numpy as np
import pytest
import torch

from edition1.errors import InputError
from edition1.estimation.kalman_filter import IteratedKalmanFilter
from edition1.estimation.rod_filter import RodFilter
from edition1.estimation.rod_sensors import RodSensor
from edition1.estimation.smoothing import smooth, smoothed
from edition1.kinematics.strain_series import StrainSeries

A = torch.tensor([[1.0, 0.5], [-0.3, 2.0], [0.7, 0.1]]).double()
FAR = torch.full((2,), 30.0).double()
ONE = torch.ones(2).double()
NOISE = 0.3
TIMES = [0.0, 0.1, 0.15, 0.4, 0.45, 0.9, 1.0]


def seen(q):
    return q @ A.mT


def seen_with_bias(x):
    return seen(x[..., :2]) + x[..., 2:]


ROD = RodFilter(
    StrainSeries(1.0, bending=1, torsion=0),
    (RodSensor("model", (NOISE,) * 3, lasting_std=(0.2,) * 3, lasting_time_s=0.7, sensing=seen),),
    (3.0, 2.0),
    rate=2.0,
)
KALMAN = IteratedKalmanFilter(seen, -FAR, FAR, 2.0 * ONE, 3.0 * ONE, noise_mt=NOISE)
# Each with the derivative of its readings by its states: configuration, lasting errors, velocity.
FILTERS = {
    "rod": (ROD, torch.cat([A, torch.eye(3).double(), 0 * A], 1)),
    "Kalman": (KALMAN, torch.cat([A, 0 * A], 1)),
}
U = torch.from_numpy(np.random.default_rng(0).normal(size=(len(TIMES), 3)))
U[2, 1] = U[4, 0] = math.nan


def run(method):
    state, states = method.init(torch.zeros(2).double()), []
    for u, t in zip(U, TIMES, strict=True):
        state, _ = method.step(state, u, t)
        states.append(state)
    return states


def dense(method, H, last):
    """Mean and covariance of all states given the readings up to ``last``, in one solution."""
    P = method.init(torch.zeros(2).double()).covariance
    n, steps = len(P), len(TIMES)
    blocks = torch.zeros(steps * n, steps * n).double()
    blocks[:n, :n] = P
    for k in range(1, steps):
        move, noise = method.motion(TIMES[k] - TIMES[k - 1])
        here, before = slice(k * n, (k + 1) * n), slice((k - 1) * n, k * n)
        blocks[here, : k * n] = move @ blocks[before, : k * n]
        blocks[: k * n, here] = blocks[here, : k * n].mT
        blocks[here, here] = move @ blocks[before, before] @ move.mT + noise
    rows = [(k, i) for k in range(last + 1) for i in range(3) if not math.isnan(U[k, i])]
    C = torch.zeros(len(rows), steps * n).double()
    for row, (k, i) in enumerate(rows):
        C[row, k * n : (k + 1) * n] = H[i]
    u = torch.stack([U[k, i] for k, i in rows])
    gain = torch.linalg.solve(C @ blocks @ C.mT + NOISE**2 * torch.eye(len(rows)).double(), C @ blocks).mT
    mean, cov = gain @ u, blocks - gain @ C @ blocks
    return mean.reshape(steps, n), torch.stack(
        [cov[k * n : (k + 1) * n, k * n : (k + 1) * n] for k in range(steps)]
    )


@pytest.fixture(params=FILTERS.values(), ids=FILTERS)
def case(request):
    return request.param


def assert_states(states, mean, cov, atol=1e-8):
    x = torch.stack([torch.cat([s.q, s.velocity]) for s in states])
    torch.testing.assert_close(x, mean, atol=atol, rtol=0)
    torch.testing.assert_close(torch.stack([s.covariance for s in states]), cov, atol=atol, rtol=0)


def test_the_filter_is_the_posterior_given_the_readings_so_far(case):
    method, H = case
    for k, state in enumerate(run(method)):
        mean, cov = dense(method, H, k)
        assert_states([state], mean[k : k + 1], cov[k : k + 1])


def test_the_smoother_is_the_posterior_given_all_readings(case):
    method, H = case
    assert_states(smoothed(method, run(method)), *dense(method, H, len(TIMES) - 1))


def test_a_lag_counts_the_readings_within_it(case):
    method, H = case
    lagged = smoothed(method, run(method), lag_s=0.3)
    for k, state in enumerate(lagged):
        last = max(j for j, t in enumerate(TIMES) if t <= TIMES[k] + 0.3)
        mean, cov = dense(method, H, last)
        assert_states([state], mean[k : k + 1], cov[k : k + 1])


def test_a_state_without_readings_is_smoothed_between_its_neighbours(case):
    """As the posterior at its time: a step whose readings say nothing."""
    method, _ = case
    states = run(method)
    between = method.predicted(states[3], 0.42)
    back = smoothed(method, [*states[:4], between, *states[4:]])
    plain = smoothed(method, states)
    for k, whole in enumerate([*range(4), *range(5, 8)]):
        torch.testing.assert_close(back[whole].q, plain[k].q, atol=1e-9, rtol=0)
    assert float(back[4].covariance[0, 0]) < float(between.covariance[0, 0])


def test_smooth_is_filter_and_smoother(case):
    method, _ = case
    found = smooth(method, U, torch.zeros(2).double(), TIMES)
    states = smoothed(method, run(method))
    assert torch.equal(found.q, torch.stack([s.q[:2] for s in states]))
    assert torch.equal(found.covariance, torch.stack([s.covariance[:2, :2] for s in states]))
    assert found.diagnostics["masked"].tolist() == [0, 0, 1, 0, 1, 0, 0]


def test_a_batch_is_smoothed_member_by_member(case):
    method, _ = case
    u = torch.stack([U, 2 * U], 1)
    both = smooth(method, u, torch.zeros(2, 2).double(), TIMES)
    for k in range(2):
        alone = smooth(method, u[:, k], torch.zeros(2).double(), TIMES)
        torch.testing.assert_close(both.q[:, k], alone.q, atol=1e-9, rtol=0)


def test_bad_input():
    states = run(ROD)
    with pytest.raises(InputError, match="Input states of smoothed must be at least one, each after a step"):
        smoothed(ROD, [])
    with pytest.raises(InputError, match="each after a step"):
        smoothed(ROD, [ROD.init(torch.zeros(2).double())])
    with pytest.raises(InputError, match=r"in the order of time; instead received 0.0 s after 1.0 s"):
        smoothed(ROD, [states[-1], states[0]])
    with pytest.raises(InputError, match="Input lag_s of smoothed must be not negative"):
        smoothed(ROD, states, lag_s=-1.0)
    with pytest.raises(InputError, match="Input times_s of smooth must be one for each of 7 rows"):
        smooth(ROD, U, torch.zeros(2).double(), TIMES[:3])
