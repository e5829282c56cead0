"""The monitor: silent on consistent readings, a new start where it helps, the right sensor where it can be told."""

import math

import pytest
import torch

from edition1.errors import InputError
from edition1.estimation.base import track
from edition1.estimation.gradient_descent import GradientDescent
from edition1.estimation.kalman_filter import IteratedKalmanFilter
from edition1.estimation.levenberg_marquardt import LevenbergMarquardt
from edition1.estimation.monitor import Monitored
from edition1.estimation.multistart import starts_within

LOW, HIGH = -torch.ones(2, dtype=torch.float64), torch.ones(2, dtype=torch.float64)
NOISE, RATE = 0.01, 40.0
SIGHTS = torch.tensor([[1.0, 0.0], [0.0, 1.0], [1.0, 1.0], [1.0, -1.0], [2.0, 1.0]]).double()
STARTS = starts_within(LOW, HIGH, 3, seed=0)


def bent(q):
    """Five readings of two coordinates, with a bend that makes a second, worse minimum."""
    return q @ SIGHTS.T + 0.2 * (q @ SIGHTS.T).sin()


def solver(sensing=bent, **options):
    return LevenbergMarquardt(sensing, LOW, HIGH, noise_mt=NOISE, iterations=8, **options)


def course(steps):
    t = torch.arange(steps, dtype=torch.float64) / RATE
    return torch.stack([0.5 * torch.sin(t), 0.4 * torch.cos(0.7 * t)], -1)


def readings(q, seed=0):
    noise = torch.randn(len(q), 5, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)
    return bent(q) + NOISE * noise


def kalman():
    return IteratedKalmanFilter(bent, LOW, HIGH, 0.2 * HIGH, 0.5 * HIGH, noise_mt=NOISE)


def monitored(estimator, **options):
    return Monitored(estimator, solver(), STARTS, RATE, **options)


@pytest.mark.parametrize("estimator", [solver(), kalman()], ids=["least squares", "Kalman filter"])
def test_consistent_readings_leave_the_estimates_as_they_are(estimator):
    q = course(40)
    found, plain = (track(m, readings(q), q[0], rate_hz=RATE) for m in (monitored(estimator), estimator))
    assert not found.diagnostics["status"].any()
    assert not found.diagnostics["anew"].any()
    assert torch.equal(found.q, plain.q)
    assert torch.equal(found.covariance, plain.covariance)


@pytest.mark.parametrize("estimator", [solver(), kalman()], ids=["least squares", "Kalman filter"])
@pytest.mark.parametrize("sensor", [0, 4])
def test_the_sensor_that_fails_is_named_and_the_covariance_grows(estimator, sensor):
    q = course(35)
    u = readings(q)
    u[15:, sensor] += 2.0
    found = track(monitored(estimator), u, q[0], rate_hz=RATE)
    status = found.diagnostics["status"]
    assert not status[:15].any()
    assert (status[17:] == 2).all()
    assert found.diagnostics["suspects"][-1].nonzero().flatten().tolist() == [sensor]
    plain = track(estimator, u, q[0], rate_hz=RATE)
    wider = found.covariance[-1] / plain.covariance[-1]
    assert float(wider.min()) == pytest.approx(float(wider.max()))
    assert float(wider.min()) > 100


def test_leaving_the_named_sensor_out_ends_the_alarm():
    q = course(50)
    u = readings(q)
    u[10:, 1] += 2.0
    mask = torch.ones(50, 5, dtype=torch.bool)
    mask[25:, 1] = False
    found = track(monitored(solver()), u, q[0], rate_hz=RATE, mask=mask)
    assert not found.diagnostics["status"][40:].any()
    assert float((found.q[40:] - q[40:]).abs().max()) < 0.05


def test_a_sensor_that_recovers_ends_the_alarm():
    q = course(50)
    u = readings(q)
    u[10:25, 1] += 2.0
    found = track(monitored(kalman()), u, q[0], rate_hz=RATE)
    assert found.diagnostics["status"][11:25].all()
    assert not found.diagnostics["status"][45:].any()
    assert float((found.q[45:] - q[45:]).abs().max()) < 0.05


def test_what_all_sensors_share_is_no_single_sensor():
    q = course(35)
    u = readings(q)
    u[15:] += torch.tensor([1.5, -1.0, 0.7, 2.0, -1.2])
    state = monitored(solver()).init(q[0])
    for k, row in enumerate(u):
        state, _ = monitored(solver()).step(state, row, k / RATE)
    assert (state.verdict.status, state.verdict.cause) == (2, "several")


def two_ways(q):
    """Two branches: readings of a circle, and a weak third one that tells its halves apart."""
    x = 2.5 * q[..., :1]
    return torch.cat([x.sin(), 0.1 * x, (2 * x).sin()], dim=-1)


def test_it_starts_anew_from_a_wrong_branch_and_only_then():
    one = torch.ones(1, dtype=torch.float64)
    fit = LevenbergMarquardt(two_ways, -one, one, noise_mt=NOISE)
    truth, wrong = 0.9 * one, -0.9 * one
    u = two_ways(truth).expand(40, 3)
    assert float(track(fit, u, wrong).q[-1]) < 0  # least squares alone stays on the wrong branch
    found = track(Monitored(fit, fit, starts_within(-one, one, 5, seed=0), RATE), u, wrong, rate_hz=RATE)
    assert found.diagnostics["anew"].tolist() == [1] * 40
    torch.testing.assert_close(found.q, truth.expand(40, 1))
    assert found.diagnostics["status"].tolist() == [1] * 10 + [0] * 30  # told for a moment
    right = track(Monitored(fit, fit, starts_within(-one, one, 5, seed=0), RATE), u, truth, rate_hz=RATE)
    assert not right.diagnostics["anew"].any()


def test_a_jump_of_the_robot_restarts_a_filter_that_did_not_expect_it():
    q = course(40)
    q[15:] = -q[15:]
    u = readings(q)
    found, plain = (track(m, u, q[0], rate_hz=RATE) for m in (monitored(kalman()), kalman()))
    assert int(found.diagnostics["anew"][-1]) == 1
    error, alone = ((x.q[15:] - q[15:]).abs().amax(-1) for x in (found, plain))
    assert float(error.max()) < 0.05
    assert float(alone.max()) > 0.1
    assert not found.diagnostics["status"][30:].any()


def test_a_descent_that_lags_is_brought_back_and_no_sensor_is_blamed():
    q = course(40)
    slow = GradientDescent(bent, 1e-3 * HIGH, noise_mt=NOISE)
    found, plain = (track(m, readings(q), 0 * HIGH, rate_hz=RATE) for m in (monitored(slow), slow))
    assert not found.diagnostics["suspects"].any()
    assert found.diagnostics["status"].any()
    error, alone = (float((x.q - q).abs().max(-1).values.median()) for x in (found, plain))
    assert error < 0.5 * alone


def test_without_redundancy_nothing_is_claimed():
    fit = LevenbergMarquardt(lambda q: bent(q)[..., :2], LOW, HIGH, noise_mt=NOISE)
    method = Monitored(fit, fit, STARTS, RATE)
    u = readings(course(30))[:, :2]
    u[15:, 0] += 0.3
    state = method.init(0 * HIGH)
    for k, row in enumerate(u):
        state, _ = method.step(state, row, k / RATE)
        assert (state.verdict.status, state.verdict.testable) == (0, False)


def test_fewer_readings_than_unknowns_are_told():
    method = monitored(solver(), unknowns=2)
    u = readings(course(3))
    u[1:, :4] = math.nan
    found = track(method, u, 0 * HIGH, rate_hz=RATE)
    assert found.diagnostics["status"].tolist() == [0, 1, 1]


def test_same_seed_same_bits_and_the_state_stays_as_it_is():
    q = course(25)
    u = readings(q)
    u[10:, 2] -= 1.0
    first, second = (track(monitored(kalman()), u, q[0], rate_hz=RATE, seed=3) for _ in range(2))
    assert torch.equal(first.q, second.q)
    method = monitored(kalman())
    state = method.init(q[0])
    for k in range(15):
        before = (state.steps, state.window, state.verdict)
        following, _ = method.step(state, u[k], k / RATE)
        assert (state.steps, state.window, state.verdict) == before
        state = following


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: monitored(solver()).init(torch.zeros(3, 2).double()), "one configuration, no batch"),
        (
            lambda: Monitored(solver(), solver(), STARTS[:0], RATE),
            "Input starts of Monitored must be at least one",
        ),
        (lambda: Monitored(solver(), solver(), STARTS, 0.0), "Input rate_hz of Monitored must be positive"),
        (lambda: monitored(solver(), false_alarms_per_hour=-1.0), "false_alarms_per_hour"),
    ],
)
def test_bad_input(call, message):
    with pytest.raises(InputError, match=message):
        call()
