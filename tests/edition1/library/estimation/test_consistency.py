"""Chi-square of the estimators, and the test of it, against the distributions they must have."""

import math

import numpy as np
import pytest
import torch
from scipy import stats

from edition1.estimation._step import driven
from edition1.estimation._window import Seen, limit, verdict_on
from edition1.estimation.base import track
from edition1.estimation.consistency import lasting
from edition1.estimation.kalman_filter import IteratedKalmanFilter
from edition1.estimation.levenberg_marquardt import LevenbergMarquardt

A = torch.randn(5, 2, generator=torch.Generator().manual_seed(1), dtype=torch.float64)
FAR = 100 * torch.ones(2, dtype=torch.float64)
NOISE = 0.1


def linear(q):
    return q @ A.T


def normal(*shape, seed=0):
    return torch.randn(*shape, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)


def test_least_squares_residuals_have_the_chi_square_distribution():
    method = LevenbergMarquardt(linear, -FAR, FAR, noise_mt=NOISE)
    u = linear(torch.ones(2, dtype=torch.float64)) + NOISE * normal(4000, 5)
    _, found = method.step(method.init(torch.zeros(4000, 2, dtype=torch.float64)), u, 0.0)
    assert (found.diagnostics["dof"] == 3).all()
    assert stats.kstest(found.diagnostics["chi2"].numpy(), stats.chi2(3).cdf).pvalue > 0.01


def test_each_coordinate_at_a_bound_and_each_that_is_held_is_a_degree_of_freedom():
    low, high = torch.tensor([-1.0, 2.0]).double(), torch.tensor([1.0, 3.0]).double()
    method = LevenbergMarquardt(linear, low, high, noise_mt=NOISE)
    start = torch.tensor([0.0, 2.5]).double()
    u = linear(torch.tensor([0.5, 0.0]).double())  # the second coordinate ends at its bound
    _, found = method.step(method.init(start), u, 0.0)
    assert int(found.diagnostics["dof"]) == 4
    known = torch.tensor([0.5, math.nan]).double()
    _, found = method.step(method.init(start), u, 0.0, known=known)
    assert int(found.diagnostics["dof"]) == 5
    mask = torch.tensor([True, False, True, False, True])
    _, found = method.step(method.init(start), linear(start), 0.0, mask=mask)
    assert int(found.diagnostics["dof"]) == 1


def test_kalman_filter_reports_the_normalised_innovation_of_its_own_model():
    """Truth drawn from the prior of the filter: innovations are independent, each chi-square of five readings."""
    acceleration = torch.tensor([0.3, 0.5]).double()
    move, spread = driven(0.1, acceleration)
    steps, members = 12, 400
    width = 200 / 12**0.5
    start = torch.zeros(2, dtype=torch.float64)
    x = torch.cat([width * normal(members, 2, seed=1), normal(members, 2, seed=2)], dim=1)
    u = []
    for k in range(steps):
        u.append(linear(x[:, :2]) + NOISE * normal(members, 5, seed=10 + k))
        x = x @ move.T + normal(members, 4, seed=100 + k) @ torch.linalg.cholesky(spread).T
    method = IteratedKalmanFilter(linear, -1e4 * FAR, 1e4 * FAR, acceleration, torch.ones(2).double(), NOISE)
    object.__setattr__(method, "lower", -FAR)  # the prior of the start is that of these bounds
    object.__setattr__(method, "upper", FAR)
    state = method.init(start.expand(members, 2))
    object.__setattr__(method, "lower", -1e4 * FAR)
    object.__setattr__(method, "upper", 1e4 * FAR)
    for k in range(steps):
        state, found = method.step(state, u[k], 0.1 * k)
        assert (found.diagnostics["dof"] == 5).all()
        assert stats.kstest(found.diagnostics["chi2"].numpy(), stats.chi2(5).cdf).pvalue > 1e-3


def windows(chi2, systematic=0.0):
    u = torch.zeros(3)
    return tuple(Seen(u, u == 0, float(c), 2, systematic) for c in chi2)


def test_alarms_come_as_often_as_the_chance_says():
    chi2 = normal(4000, 10, 2).square().sum(-1)
    rate = sum(verdict_on(windows(row), 0.05).status > 0 for row in chi2) / 4000
    assert rate == pytest.approx(0.05, abs=4 * (0.05 * 0.95 / 4000) ** 0.5)


@pytest.mark.parametrize("share", [0.3, 0.7, 1.0])
def test_errors_that_last_raise_no_more_alarms(share):
    """A part of the variance is the same in all readings of a window: at most twice the stated chance."""
    common, own = normal(4000, 1, 2, seed=1), normal(4000, 10, 2, seed=2)
    chi2 = (share**0.5 * common + (1 - share) ** 0.5 * own).square().sum(-1)
    rate = sum(verdict_on(windows(row, share), 0.01).status > 0 for row in chi2) / 4000
    assert 0.001 < rate < 0.02


def test_wrong_is_rarer_than_suspicious_and_nothing_is_said_without_redundancy():
    chance = 1e-4
    low, high = limit(chance, 20), limit(0.01 * chance, 20)
    assert [
        verdict_on(windows([x / 10] * 10), chance).status for x in (0.99 * low, 0.99 * high, 1.01 * high)
    ] == [
        0,
        1,
        2,
    ]
    silent = verdict_on((Seen(torch.zeros(3), torch.ones(3) == 1, 1e9, 0, 0.0),), chance)
    assert (silent.status, silent.testable) == (0, False)


def test_a_trajectory_carries_chi_square():
    method = LevenbergMarquardt(linear, -FAR, FAR, noise_mt=NOISE)
    found = track(method, linear(torch.ones(4, 2, dtype=torch.float64)), torch.zeros(2, dtype=torch.float64))
    assert found.diagnostics["chi2"].shape == found.diagnostics["dof"].shape == (4,)
    assert float(found.diagnostics["chi2"].max()) < 1e-12


@pytest.mark.parametrize("readings", [0, 1, 2.5, 3, 100])
def test_a_condition_lasts_where_all_of_the_last_readings_meet_it(readings):
    condition = np.random.default_rng(3).random(200) < 0.7
    n = math.floor(readings) + 1  # more than so many
    expected = [k + 1 >= n and bool(condition[k + 1 - n : k + 1].all()) for k in range(200)]
    assert lasting(condition, readings).tolist() == expected


def test_a_condition_that_always_or_never_holds():
    assert lasting(np.ones(5, dtype=bool), 3).tolist() == [False, False, False, True, True]
    assert not lasting(np.zeros(5, dtype=bool), 0).any()
    assert lasting(np.zeros(0, dtype=bool), 0).tolist() == []
