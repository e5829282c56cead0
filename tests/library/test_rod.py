"""The rod against closed forms, its filter against an exact Kalman filter and stored answers."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.linalg import expm

from repro import InputError, track
from repro.estimators.rod import Rod, RodFilter, RodSensor, _compare, _exponential, _logarithm

ROD = Rod(0.4, bending=2, torsion=1)
STD = (3.0, 1.0, 3.0, 1.0, 0.5)
POSE = RodSensor("pose", (1e-3,) * 3 + (5e-3,) * 3, arc_m=0.4)
GYRO = RodSensor("gyroscope", 0.02, arc_m=0.2)
FILTER = RodFilter(ROD, [POSE, GYRO], STD, rate=4.0)
strain = st.floats(-12, 12)


def hat(x):
    """The 4 x 4 matrix of a twist."""
    W = np.zeros((4, 4))
    W[:3, :3], W[:3, 3] = np.cross(np.eye(3), x[3:]), x[:3]
    return W


def is_covariance(P):
    """Symmetric to the bit, and positive after scaling to a unit diagonal."""
    d = np.sqrt(np.diagonal(P, axis1=-2, axis2=-1))
    scaled = P / d[..., :, None] / d[..., None, :]
    return np.array_equal(P, np.swapaxes(P, -1, -2)) and np.linalg.eigvalsh(scaled).min() > 0


# The rod


@settings(max_examples=30, deadline=None)
@given(strain, strain, strain, st.floats(0, 0.4))
def test_one_term_is_a_circle_or_a_helix(x, y, z, arc):
    expected = expm(arc * hat(np.array([0.0, 0.0, 1.0, x, y, z])))
    T, _ = Rod(0.4, bending=1, torsion=1, parts=3).motion([x, y, z], [arc])
    np.testing.assert_allclose(T[0], expected, atol=1e-13)


def test_pieces_converge_to_second_order():
    q = np.array([4.0, -3.0, 2.0, 5.0, 3.0])
    exact = Rod(0.4, 2, 1, parts=1000).motion(q, [0.4])[0]
    errors = [np.abs(Rod(0.4, 2, 1, parts=n).motion(q, [0.4])[0] - exact).max() for n in (10, 20)]
    assert 3.8 < errors[0] / errors[1] < 4.2


@settings(max_examples=40, deadline=None)
@given(st.sampled_from([0.0, 1e-9, 1e-4, 0.02, 0.5, 1.0]), st.integers(0, 10**6))
def test_exponential_and_logarithm(share, seed):
    """Up to half a turn, and exactly there."""
    x = np.random.default_rng(seed).normal(size=6)
    x[3:] *= share * math.pi / np.linalg.norm(x[3:])
    T, adjoint, _ = _exponential(x)
    np.testing.assert_allclose(T, expm(hat(x)), atol=1e-13)
    np.testing.assert_allclose(hat(adjoint @ x), T @ hat(x) @ np.linalg.inv(T), atol=1e-12)
    back = _logarithm(T)
    np.testing.assert_allclose(_exponential(back)[0], T, atol=1e-13)
    assert share == 1.0 or np.abs(back - x).max() < 1e-12


@pytest.mark.parametrize("base", [0, 6])
@pytest.mark.parametrize("scale", [0.0, 1e-8, 1.0, 3.0])
def test_body_jacobians(base, scale):
    rng, arcs = np.random.default_rng(1), np.array([0.4, 0.0, 0.13, 0.2])
    q = scale * rng.normal(size=(2, base + 5))
    T, J = ROD.motion(q, arcs)
    h = 1e-6
    for c, e in enumerate(np.eye(base + 5)):
        slopes = (ROD.motion(q + h * e, arcs)[0] - ROD.motion(q - h * e, arcs)[0]) / (2 * h)
        twists = np.linalg.inv(T) @ slopes
        expected = [[hat(j) for j in row] for row in J[..., c]]
        np.testing.assert_allclose(twists, expected, atol=1e-8)


# The process


@settings(max_examples=20, deadline=None)
@given(st.floats(1e-4, 3), st.floats(1e-4, 3))
def test_motion_composes_and_is_stationary(a, b):
    sensor = RodSensor("gyroscope", 0.1, lasting_std=[0.1, 0.2, 0.3], lasting_time_s=2.0)
    method = RodFilter(ROD, [sensor], STD, rate=4.0, base_std=(0.01, 0.1), base_rate=0.5)
    (F, Q), (G, R), (both, noise) = method.motion(a), method.motion(b), method.motion(a + b)
    np.testing.assert_allclose(G @ F, both, atol=1e-13)
    np.testing.assert_allclose(G @ Q @ G.T + R, noise, atol=1e-12)
    P = method.init().covariance
    np.testing.assert_allclose((F @ P)[6, 6], 9 * (1 + 4 * a) * math.exp(-4 * a), rtol=1e-12)
    np.testing.assert_allclose(method.predicted(method.init()._replace(t=0.0), a).covariance, P, atol=1e-12)
    usual = RodFilter(ROD, [sensor], STD, rate=4.0, base_std=(0.01, 0.1))  # a base changes within ten seconds
    np.testing.assert_allclose(usual.motion(a)[0][0, 0], (1 + a / 10) * math.exp(-a / 10), rtol=1e-12)


# The filter


def test_a_rod_that_only_twists_has_a_kalman_filter():
    """Turns about one axis add up. The reference has the process by its equation, lasting errors and drop-outs."""
    rng, std, rate, fade = np.random.default_rng(3), np.array([3.0, 1.0]), 4.0, 0.5
    rod = Rod(0.4, bending=0, torsion=2)
    middles = (2 * np.arange(8) + 1) / 8 - 1
    C = [
        0.05 * np.array([m, math.sqrt(3) * middles[:m].sum()]) for m in (8, 4)
    ]  # of the whole rod and its half
    lasting = {"lasting_std": [0.1, 0.3, 0.2], "lasting_time_s": fade}
    sensors = [RodSensor("orientation", 0.05, 0.4, **lasting), RodSensor("gyroscope", 0.02, 0.2, **lasting)]
    at = np.cumsum(rng.uniform(0.01, 0.2, size=30))
    u = np.zeros((30, 6))
    u[:, [2, 5]] = 0.2 * rng.normal(size=(30, 2))
    u[::5, 1], u[2::7, 5] = np.nan, np.nan  # an orientation is left out whole
    found = track(RodFilter(rod, sensors, std, rate), u, times=at, monitor=None)
    lost = np.hstack([np.isnan(u[:, :3]).any(1, keepdims=True).repeat(3, 1), np.isnan(u[:, 3:])])
    A = np.diag(np.r_[np.zeros(2), np.full(6, -1 / fade), np.full(2, -2 * rate)])
    A[:2, 8:], A[8:, :2] = np.eye(2), -(rate**2) * np.eye(2)
    rest = np.diag(np.r_[std, 0.1, 0.3, 0.2, 0.1, 0.3, 0.2, rate * std] ** 2)
    x, P, H = np.zeros(10), rest, np.hstack([np.zeros((6, 2)), np.eye(6), np.zeros((6, 2))])
    H[2, :2], H[5, 8:] = C
    for k in range(30):
        if k:
            F = expm(A * (at[k] - at[k - 1]))
            x, P = F @ x, F @ (P - rest) @ F.T + rest
        use = ~lost[k]
        S = H[use] @ P @ H[use].T + np.diag(np.repeat([0.05**2, 0.02**2], 3)[use])
        K, r = P @ H[use].T @ np.linalg.inv(S), u[k, use] - H[use] @ x
        x, P = x + K @ r, P - K @ H[use] @ P
        for mine, expected in (
            (found.q[k], x[:2]),
            (found.covariance[k], P[:2, :2]),
            (found.u_hat[k], H @ x),
            (found.details["lasting"][k], x[2:8]),
            (found.chi2[k], r @ np.linalg.inv(S) @ r),
        ):
            np.testing.assert_allclose(mine, expected, rtol=0, atol=1e-9)
    np.testing.assert_array_equal(found.missing, lost.sum(1))
    np.testing.assert_array_equal(found.dof, 6 - found.missing)


@pytest.mark.parametrize("base", [0, 6])
def test_slopes_of_what_is_read_are_differences(base):
    """Of poses and orientations everywhere; of a gyroscope where the rod rests. A base moves all of them."""
    rng, lasting = np.random.default_rng(2), {"lasting_std": 0.1}
    sensors = [RodSensor("pose", 0.1, 0.4, **lasting), RodSensor("orientation", 0.1, 0.3, **lasting), GYRO]
    method = RodFilter(ROD, sensors, STD, 4.0, base_std=(0.1, 0.1) if base else None)
    n = method.n_q
    x, u = 0.3 * rng.normal(size=2 * n + 9), 0.3 * rng.normal(size=12)
    x[n + 9 :] = 0.0
    _, r, H = _compare(method._layout, n, x, u)
    for e, slope in zip(1e-6 * np.eye(len(x)), H.T, strict=True):
        up, down = (_compare(method._layout, n, x + d, u)[1] for d in (e, -e))
        np.testing.assert_allclose((down - up) / 2e-6, slope, atol=1e-8)
    P = np.diag(rng.uniform(1, 2, n))
    places, C = method.positions(x[:n], P, [0.25, 0.4])
    J = [(method.positions(x[:n] + e, P, [0.25, 0.4])[0] - places) / 1e-7 for e in 1e-7 * np.eye(n)]
    np.testing.assert_allclose(C, np.einsum("aki,ab,bkj->kij", J, P, J), atol=1e-5)
    np.testing.assert_array_equal(r[9:], u[9:])  # at rest a gyroscope reads nothing


def test_ideal_sensors_recover_a_static_rod():
    q = np.array([2.0, -1.0, 4.0, 0.5, 0.4])
    T, _ = ROD.motion(q, [0.4, 0.2])
    sensors = [RodSensor("pose", 1e-7, arc_m=0.4), RodSensor("orientation", 1e-7, arc_m=0.2), GYRO]
    u = np.concatenate([_logarithm(T[0]), _logarithm(T[1])[3:], np.zeros(3)])
    method = RodFilter(ROD, sensors, STD, rate=4.0)
    state = method.init()
    for k in range(300):
        state, estimate = method.step(state, u, 0.01 * k)
    np.testing.assert_allclose(estimate.q, q, rtol=0, atol=1e-5)
    np.testing.assert_allclose(estimate.u_hat[:9], u[:9], atol=1e-8)
    assert is_covariance(state.covariance)


def test_what_is_missing():
    u = np.linspace(0.01, 0.09, 9)
    state, _ = FILTER.step(FILTER.init(), u)
    partly, without = np.where(np.arange(9) == 2, np.inf, u), np.arange(9) >= 6
    a, b = FILTER.step(state, partly, 0.1)[1], FILTER.step(state, u, 0.1, mask=without)[1]
    assert np.array_equal(a.q, b.q)
    assert a.missing == b.missing == 6
    after, c = FILTER.step(state, np.full(9, np.nan), 0.1)
    assert all(map(np.array_equal, after, FILTER.predicted(state, 0.1)))
    assert (c.missing, c.dof, c.chi2) == (9, 0, 0.0)


def test_known_coordinates_are_kept():
    known = [np.nan, 0.7, np.nan, np.nan, -0.2]
    state, estimate = FILTER.step(FILTER.init(), np.linspace(0.01, 0.09, 9), 0.0, known=known)
    assert estimate.q[[1, 4]].tolist() == [0.7, -0.2]
    assert not estimate.covariance[[1, 4]].any()
    _, estimate = FILTER.step(state, np.full(9, np.nan), 0.1, known=[np.nan] * 4 + [0.3])
    assert estimate.q[4] == 0.3


def test_a_sensor_at_the_tip_is_there_in_spite_of_rounding():
    at_the_tip = RodFilter(Rod(0.3), [replace(POSE, arc_m=0.1 + 0.2)], 1.0, 1.0)
    assert at_the_tip.sensors[0].arc_m > 0.3


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Rod(0.0), r"length of Rod must be positive \[m\]; instead received 0.0"),
        (lambda: Rod(1.0, 3, 1, parts=2), "parts of Rod must be a whole number, at least 3; instead received 2"),
        (lambda: Rod(1.0, 0, 0), "bending, torsion of Rod must be not both 0"),
        (lambda: ROD.motion(np.zeros(4), [0.1]), "q of Rod must be of last dimension 5, or 11 with the twist"),
        (lambda: ROD.motion(np.zeros(5), [0.5]), "arcs_m of Rod must be between 0 and the length 0.4 m"),
        (lambda: RodSensor("camera", 1.0), "kind of RodSensor must be one of pose, orientation, gyroscope"),
        (lambda: RodSensor("pose", (1.0, 1.0)), "std of RodSensor must be positive, one number or one .* of 6"),
        (lambda: RodSensor("gyroscope", 0.0), "std of RodSensor must be positive"),
        (lambda: RodSensor("gyroscope", 1.0, lasting_std=(1.0, 1.0)), "lasting_std of .* for each of 3;"),
        (lambda: RodFilter(ROD, [], STD, 1.0), "sensors of RodFilter must be at least one"),
        (lambda: RodFilter(ROD, [POSE], STD[:2], 1.0), "strain_std of RodFilter must be .* each of 5"),
        (lambda: RodFilter(ROD, [POSE], STD, 0.0), "rate of RodFilter must be positive"),
        (lambda: RodFilter(Rod(0.3), [POSE], 1.0, 1.0), "arc_m of RodFilter must be between 0 and .* 0.3 m"),
        (lambda: FILTER.init(np.zeros(4)), r"q0 of RodFilter must be numbers of shape \(..., 5\)"),
        (lambda: FILTER.step(FILTER.init(), np.zeros(8)), "u of RodFilter must be 9 readings"),
        (lambda: FILTER.step(FILTER.init()._replace(t=1.0), np.zeros(9), 1.0), "t of .* after the last step, 1.0 s"),
        (lambda: FILTER.predicted(FILTER.init()._replace(t=1.0), 0.9), "t of .* not before the last step, 1.0 s"),
        (lambda: track(FILTER, np.zeros((2, 9))), "times, rate_hz of track must be given for a filter"),
    ],
)  # fmt: skip
def test_refusals(make, message):
    with pytest.raises(InputError, match=message):
        make()
