"""The Kalman filter and the smoother: against exact filters and closed forms; and drift."""

from __future__ import annotations

import numba
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from repro import (
    ConstantCurvature,
    Drift,
    Drifting,
    Imu,
    InputError,
    KalmanFilter,
    LevenbergMarquardt,
    Magnet,
    Robot,
    Sensing,
    Sensor,
    simulated_readings,
    smooth,
    track,
)
from repro.estimators.drift import DriftModel
from repro.estimators.kalman import _predict, _update, smoothed

from .robots import RELEASED, bounds, paper_robot
from .test_least_squares import lemniscate

H = np.array([[1.0, 0.5], [0.2, -1.0], [0.3, 0.3]])
WIDE = ([-5.0, -5.0], [5.0, 5.0])
NOISE, DENSITY, SPEED = np.array([0.1, 0.2, 0.15]), np.array([0.7, 1.3]), np.array([2.0, 3.0])


def linear(q):
    return q @ H.T


def exact(u, times):
    """The textbook filter on (q, velocity), and the smoother by one least-squares problem over all states."""
    n = 2
    P = np.diag([100 / 12, 100 / 12, *SPEED**2])
    x, C = np.zeros(2 * n), np.hstack([H, np.zeros((3, n))])
    means, covariances, t0 = [], [], times[0]
    A, b = [np.linalg.inv(np.linalg.cholesky(P))], [np.zeros(4)]
    for row, t in zip(u, times, strict=True):
        tau, eye = t - t0, np.eye(n)
        F = np.block([[eye, tau * eye], [0 * eye, eye]])
        D = np.diag(DENSITY**2)
        Q = np.block([[tau**3 / 3 * D, tau**2 / 2 * D], [tau**2 / 2 * D, tau * D]])
        x, P = F @ x, F @ P @ F.T + Q
        use = np.isfinite(row)
        S = C[use] @ P @ C[use].T + np.diag(NOISE[use] ** 2)
        K = P @ C[use].T @ np.linalg.inv(S)
        x, P = x + K @ (row[use] - C[use] @ x), P - K @ C[use] @ P
        means.append(x), covariances.append(P)
        A.append((F, Q)), b.append((use, row))
        t0 = t
    return np.array(means), np.array(covariances), A, b


def batch_solution(A, b):
    """Means of all states given all readings, by least squares."""
    T = len(A) - 1
    rows, right = [], []

    def block(k, M):
        out = np.zeros((len(M), 4 * T))
        out[:, 4 * k : 4 * k + 4] = M
        return out

    rows.append(block(0, A[0])), right.append(b[0])
    for k in range(T):
        (F, Q), (use, row) = A[k + 1], b[k + 1]
        if k:
            W = np.linalg.inv(np.linalg.cholesky(Q))
            rows.append(block(k, W) - block(k - 1, W @ F)), right.append(np.zeros(4))
        (
            rows.append(block(k, np.hstack([H, np.zeros((3, 2))])[use] / NOISE[use, None])),
            right.append(row[use] / NOISE[use]),
        )
    M, y = np.vstack(rows), np.concatenate(right)
    return np.linalg.lstsq(M, y, rcond=None)[0].reshape(T, 4), np.linalg.inv(M.T @ M)


def linear_case():
    rng = np.random.default_rng(0)
    times = np.cumsum(rng.uniform(0.02, 0.2, 30))
    u = linear(np.stack([np.sin(times), np.cos(2 * times)], -1)) + NOISE * rng.normal(size=(30, 3))
    u[5], u[9, 1] = np.nan, np.nan
    method = KalmanFilter(linear, *WIDE, NOISE, DENSITY, SPEED, tolerance=1e-12)
    return method, u, times


def test_on_a_linear_model_it_is_the_exact_kalman_filter():
    method, u, times = linear_case()
    means, covariances, *_ = exact(u, times)
    found = track(method, u, [0.0, 0.0], times=times)
    np.testing.assert_allclose(found.q, means[:, :2], rtol=0, atol=1e-9)
    np.testing.assert_allclose(found.covariance, covariances[:, :2, :2], rtol=0, atol=1e-9)


def test_on_a_linear_model_the_smoother_is_the_posterior_of_everything():
    method, u, times = linear_case()
    _, _, A, b = exact(u, times)
    means, covariance = batch_solution(A, b)
    found = smooth(method, u, [0.0, 0.0], times=times)
    np.testing.assert_allclose(found.q, means[:, :2], rtol=0, atol=1e-8)
    for k in range(len(u)):
        np.testing.assert_allclose(
            found.covariance[k], covariance[4 * k : 4 * k + 2, 4 * k : 4 * k + 2], rtol=0, atol=1e-8
        )


def test_with_a_flat_prior_it_is_least_squares():
    _, u, _ = linear_case()
    flat = KalmanFilter(linear, [-1e7] * 2, [1e7] * 2, NOISE, DENSITY, SPEED, tolerance=1e-12)
    _, one = flat.step(flat.init([0.0, 0.0]), u[0], 0.0)
    least = LevenbergMarquardt(linear, [-1e7] * 2, [1e7] * 2, NOISE, tolerance=1e-12)
    _, two = least.step(least.init([0.0, 0.0]), u[0])
    np.testing.assert_allclose(one.q, two.q, rtol=0, atol=1e-9)
    np.testing.assert_allclose(one.covariance, two.covariance, rtol=0, atol=1e-9)


@numba.njit
def _many(x, P, F, Q, J, steps):
    """Predict and update at the same place, in compiled code."""
    q, C, information, M = np.zeros(2), np.zeros((2, 2)), np.zeros((2, 2)), np.zeros((2, 2))
    for _ in range(steps):
        _predict(F, Q, np.array([[-9.0, -9.0], [9.0, 9.0]]), x, P, q, information)
        M[:] = information + J
        det = M[0, 0] * M[1, 1] - M[0, 1] * M[1, 0]
        C[0, 0], C[1, 1], C[0, 1], C[1, 0] = M[1, 1] / det, M[0, 0] / det, -M[0, 1] / det, -M[1, 0] / det
        _update(np.zeros(2), x, P, q, C, information)


@pytest.mark.slow
def test_covariances_stay_symmetric_and_positive_over_a_million_steps():
    method, *_ = linear_case()
    F, Q = method.motion(0.01)
    x, P, J = np.zeros(4), np.diag([8.0, 8.0, *SPEED**2]), H.T @ np.diag(1 / NOISE**2) @ H
    _many(x, P, F, Q, J, 1_000_000)
    np.testing.assert_array_equal(P, P.T)
    assert np.linalg.eigvalsh(P).min() > 0
    before = P.copy()
    _many(x, P, F, Q, J, 1000)
    np.testing.assert_allclose(P, before, rtol=1e-9)


@given(st.floats(0.01, 3.0), st.floats(0.01, 3.0))
def test_two_steps_of_motion_are_one(a, b):
    method = KalmanFilter(
        Drifting(linear, [Drift("offset", 0.1, 0.2, time_s=2.0)]), *WIDE, NOISE, DENSITY, SPEED
    )
    (F1, Q1), (F2, Q2), (F, Q) = (method.motion(t) for t in (a, b, a + b))
    np.testing.assert_allclose(F2 @ F1, F, rtol=0, atol=1e-12)
    np.testing.assert_allclose(F2 @ Q1 @ F2.T + Q2, Q, rtol=1e-9, atol=1e-12)


def test_acceleration_and_velocity_that_are_not_given_are_half_of_the_range():
    usual, same = (KalmanFilter(lambda q: q, [-1.0], [3.0], 0.1, *given) for given in ((), ([2.0], [2.0])))
    for first, second in zip(usual.init([0.0]), same.init([0.0]), strict=True):
        np.testing.assert_array_equal(first, second)
    np.testing.assert_array_equal(usual.motion(0.1)[1], same.motion(0.1)[1])


def test_a_remembered_motion_is_that_of_its_own_time():
    """More times than are remembered, some again: all bits as of a filter that remembers nothing."""
    times = np.cumsum([0.01, 0.02, *np.linspace(0.001, 0.02, 100), 0.02, 0.01])
    method = KalmanFilter(lambda q: q, [-1.0], [1.0], noise=0.1)
    state = other = method.init([0.0])
    for t in times:
        state = method.step(state, np.array([0.1]), t)[0]
        forgetful = KalmanFilter(lambda q: q, [-1.0], [1.0], noise=0.1)
        other = forgetful.step(other, np.array([0.1]), t)[0]
        np.testing.assert_array_equal(state.covariance, other.covariance)
        np.testing.assert_array_equal(state.velocity, other.velocity)


def test_states_without_order_are_refused():
    method, u, _ = linear_case()
    state, _ = method.step(method.init([0.0, 0.0]), u[0], 0.0)
    for states, message in [
        ([], "at least one, each after a step"),
        ([method.init([0.0, 0.0])], "each after a step"),
        ([method.predicted(state, 2.0), state], "in the order of time"),
    ]:
        with pytest.raises(InputError, match=message):
            smoothed(method, states)
    with pytest.raises(InputError, match="not before the last step"):
        method.predicted(state, -1.0)
    with pytest.raises(InputError, match="acceleration of KalmanFilter must be positive"):
        KalmanFilter(linear, *WIDE, NOISE, [0.0, 1.0], SPEED)


# Drift


def arm_of_both():
    magnets = [Magnet(RELEASED, 1, 0.055), Magnet(RELEASED, 2, 0.055)]
    sensors = [Sensor(g, 0.11, radial=0.013, azimuth=2 * k) for g in (1, 2) for k in range(3)]
    return Robot(
        [ConstantCurvature(0.11, 0.022)] * 2,
        magnets,
        sensors,
        [Imu(1, 0.11), Imu(2, 0.11, [0.5, 0.5, 0.5, 0.5])],
    )


ALL = [
    Drift("offset", 0.01),
    Drift("gain", 0.01),
    Drift("gain", 0.01, shared=True),
    Drift("moment", 0.01),
    Drift("moment", 0.01, shared=True),
    Drift("stray", 0.01),
    Drift("heading", 0.1),
    Drift("tilt", 0.1),
]


def test_slopes_of_every_kind_of_drift_are_those_of_the_readings():
    sensing = Sensing(arm_of_both(), earth=[0.02, 0.01, -0.04])
    low, high = bounds(2)
    model = DriftModel(Drifting(sensing, ALL), low, high, "test")
    rng = np.random.default_rng(0)
    x = np.concatenate([0.008 * rng.normal(size=6), 0.02 * rng.normal(size=model.n_q - 6)])[None]
    u, J = model.linearise(x)
    for c in range(model.n_q):
        step = np.zeros((1, model.n_q))
        step[0, c] = 1e-6 if c >= 6 else 1e-8
        # The difference turns rotation vectors into turns in the base, which the slopes of IMUs are.
        up, down = model.difference(model(x + step), u), model.difference(model(x - step), u)
        np.testing.assert_allclose(
            J[..., c], (up - down) / (2 * step[0, c]), rtol=0, atol=2e-6 * np.abs(J).max()
        )
    assert model.names[:2] == ("offset 1", "offset 2")


def test_readings_with_errors_are_those_of_a_robot_with_them():
    """A stronger magnet, a turned IMU, an offset: each as the physics has it."""
    robot, (low, high) = arm_of_both(), bounds(2)
    drifts = [Drift("moment", 0.01), Drift("tilt", 0.1), Drift("heading", 0.1), Drift("offset", 0.1)]
    sensing = Sensing(robot)
    model = DriftModel(Drifting(sensing, drifts), low, high, "test")
    q = 0.005 * np.ones(6)
    x = np.concatenate([q, [0.1, -0.05], [0.0, 0.0, 0.2, 0.1], [0.0, 0.3], np.arange(6) * 0.01])
    (u,) = model(x[None])
    stronger = Sensing(robot, moments=sensing.moments * [[1.1], [0.95]], offset=np.arange(6) * 0.01)(q)
    np.testing.assert_allclose(u[:9], stronger[:9], rtol=0, atol=1e-12)
    turned = (
        Rotation.from_rotvec([0, 0, 0.3])
        * Rotation.from_rotvec([0.2, 0.1, 0])
        * Rotation.from_rotvec(stronger[9:])
    )
    np.testing.assert_allclose(u[9:], turned.as_rotvec(), rtol=0, atol=1e-12)


def test_errors_of_no_size_change_nothing():
    sensing, (low, high) = Sensing(paper_robot(1)), bounds(1)
    fast = [1.0] * 3, [0.1] * 3
    u = simulated_readings(paper_robot(1), lemniscate(1, 20))
    plain = track(KalmanFilter(sensing, low, high, 1e-3, *fast), u, [0.0, 0.0, 0.003], rate_hz=40.0)
    none = Drifting(sensing, [Drift("offset", 0.0), Drift("moment", 0.0)])
    found = track(KalmanFilter(none, low, high, 1e-3, *fast), u, [0.0, 0.0, 0.003], rate_hz=40.0)
    np.testing.assert_allclose(found.q, plain.q, rtol=0, atol=1e-12)
    np.testing.assert_array_equal(found.details["drift"], np.zeros((20, 4)))


def test_an_offset_and_a_heading_are_found_where_the_readings_tell_them():
    """Hall sensors with offsets and IMUs with headings on a moving arm: each is told by the other kind."""
    robot, (low, high) = arm_of_both(), bounds(2)
    q, rng = lemniscate(2, 400), np.random.default_rng(0)
    u = simulated_readings(robot, q)
    offset, heading = 0.05 * rng.normal(size=6), 0.1
    u[:, :6] += offset
    for i in (6, 9):
        u[:, i : i + 3] = (
            Rotation.from_rotvec([0, 0, heading]) * Rotation.from_rotvec(u[:, i : i + 3])
        ).as_rotvec()
    noise = np.array([1e-3] * 6 + [1e-2] * 6)
    u += noise * rng.normal(size=u.shape)
    drifts = [Drift("offset", 0.1), Drift("heading", 0.2)]
    method = KalmanFilter(Drifting(Sensing(robot), drifts), low, high, noise, [0.5] * 6, [0.1] * 6)
    found = track(method, u, q[0] * 0 + (low + high) / 2, rate_hz=40.0)
    truth = np.array([*offset, heading, heading])
    error = found.details["drift"][-1] - truth
    assert (np.abs(error) < 4 * found.details["drift_std"][-1]).all()
    assert (found.details["drift_std"][-1] < 0.2 * np.array([0.1] * 6 + [0.2] * 2)).all()


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Drift("wobble", 1.0), "kind of Drift must be one of offset, gain, moment"),
        (lambda: Drift("gain", -1.0), "start of Drift must be finite and not negative"),
        (lambda: Drift("gain", 1.0, time_s=0.0), "time_s of Drift must be positive"),
        (lambda: Drift("tilt", 1.0, shared=True), "shared of Drift must be of each"),
        (lambda: Drift("stray", 1.0, shared=True), "shared of Drift must be of each"),
        (lambda: Drifting(linear, []), "at least one; instead received none"),
        (
            lambda: Drifting(linear, [Drift("moment", 1.0)]),
            "kind moment, of Drifting must be of a robot whose model",
        ),
        (lambda: Drifting(Sensing(paper_robot(1)), [Drift("tilt", 1.0)]), "must be of a robot with IMUs"),
    ],
)
def test_what_cannot_wander_is_refused_in_words(make, message):
    with pytest.raises(InputError, match=message):
        make()


def test_what_is_set_on_a_used_estimator_holds_from_then_on():
    """What is derived from an attribute is derived anew, and an array among them cannot be changed unnoticed."""

    def filter_of(acceleration):
        return KalmanFilter(lambda q: 2 * q, [-9.0, -9.0], [9.0, 9.0], 0.1, acceleration, [1.0, 1.0])

    def fit_of(noise, upper):
        return LevenbergMarquardt(lambda q: q, [-9.0, -9.0], upper, noise)

    used, new = filter_of([1.0, 1.0]), filter_of([5.0, 2.0])
    state = used.step(used.init([0.0, 0.0]), [0.1, 0.2], 0.0)[0]
    used.step(state, [0.3, 0.1], 0.5)
    used.acceleration = np.array([5.0, 2.0])
    for mine, other in zip(
        used.step(state, [0.3, 0.1], 0.5)[0], new.step(state, [0.3, 0.1], 0.5)[0], strict=True
    ):
        np.testing.assert_array_equal(mine, other)
    with pytest.raises(ValueError, match="read-only"):
        used.acceleration[0] = 1.0
    fit, other = fit_of(0.1, [9.0, 9.0]), fit_of([0.3, 0.7], [1.0, 9.0])
    fit.step(fit.init([0.0, 0.0]), [2.0, 2.0])
    fit.noise, fit.upper = np.array([0.3, 0.7]), np.array([1.0, 9.0])
    mine, theirs = (x.step(x.init([0.0, 0.0]), [2.0, 2.0])[1] for x in (fit, other))
    np.testing.assert_array_equal(mine.q, theirs.q)
    np.testing.assert_array_equal(mine.covariance, theirs.covariance)
    np.testing.assert_array_equal(fit.by_bounds, other.by_bounds)
