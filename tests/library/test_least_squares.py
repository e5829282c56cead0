"""Gradient descent and Levenberg-Marquardt against closed forms, SciPy and stored answers."""

from __future__ import annotations

import warnings

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.interpolate import CubicSpline
from scipy.optimize import least_squares

from repro import (
    AffineCurvature,
    BallJoint,
    ConstantCurvature,
    GradientDescent,
    Imu,
    InputError,
    KalmanFilter,
    LevenbergMarquardt,
    Magnet,
    Robot,
    Sensing,
    Sensor,
    simulated_readings,
    track,
)

from .robots import RELEASED, paper_robot


def lemniscate(n_b, n):
    s = np.linspace(0, 1, n)
    rows = []
    for i in range(n_b):
        p = 2 * np.pi * i / n_b
        rows += [0.01728 * np.sin(4 * np.pi * s + p), 0.01728 * np.sin(2 * np.pi * s + p)]
        rows.append(0.00275 * (1 + np.sin(2 * np.pi * s + p)))
    return np.stack(rows, axis=-1)


def test_the_descent_on_a_parabola_is_its_recurrence():
    """Eqs (11) and (12) by hand, with the momentum carried into the next time step."""
    method = GradientDescent(lambda q: 2 * q, [0.02], momentum=0.3, iterations=5)
    state, q, b = method.init([0.0]), 0.0, 0.0
    for u in (1.0, 1.5):
        state, found = method.step(state, [u])
        iterates = [q]
        for _ in range(4):
            b = 2 * (2 * q - u) * 2 + 0.3 * b
            q -= 0.02 * b
            iterates.append(q)
        q = min(iterates, key=lambda x: (2 * x - u) ** 2)
        assert found.q[0] == pytest.approx(q, abs=1e-9)
        assert state.momentum[0] == pytest.approx(b, abs=1e-8)


BOUNDED = paper_robot(1, 6).replaced(
    lower=[-0.02, -0.02, 0.004], upper=[0.02, 0.02, 0.004], start=[0.001, 0.0, 0.004], noise=0.005
)


def test_the_descent_of_a_robot_keeps_its_start_its_bounds_and_fixed_coordinates():
    """Also where the readings are those of a robot beyond its bounds, and of another length."""
    method, rng = GradientDescent(BOUNDED, 3.5e-4), np.random.default_rng(0)
    np.testing.assert_array_equal(method.init().q, BOUNDED.start)
    q = rng.uniform(-1, 1, (50, 3)) * [0.03, 0.03, 0.006]
    found = track(method, BOUNDED.sensing()(q))
    assert ((BOUNDED.lower <= found.q) & (found.q <= BOUNDED.upper)).all()
    assert found.q[:, 2].tolist() == [0.004] * 50
    assert found.chi2[-1] > 0
    q = np.linspace(BOUNDED.start, [0.015, -0.01, 0.004], 60)
    np.testing.assert_allclose(track(method, BOUNDED.sensing()(q)).q, q, atol=3e-4)


def test_a_free_azimuth_stays_within_its_turn():
    turn = Robot([BallJoint("z"), ConstantCurvature(0.1, 1.0, extensible=False)], lower=[-np.pi, -1, -1],
                 upper=[np.pi, 1, 1], magnets=[Magnet(RELEASED, 2, 0.1)],
                 sensors=[Sensor(0, 0.0, radial=0.03, azimuth=k) for k in range(6)])  # fmt: skip
    q = np.array([3.1, 0.5, 0.0]) + np.outer(np.arange(40), [0.01, 0.0, 0.0])
    found = track(GradientDescent(turn, [10.0, 0.0, 0.0]), turn.sensing()(q), q[0]).q
    assert (np.abs(found[:, 0]) <= np.pi).all()
    assert found[:, 0].min() < 0 < found[:, 0].max()


@pytest.mark.parametrize("bad", [1e30, -1e90, np.nan])
def test_a_row_that_leads_astray_has_no_estimate_and_the_next_ones_are_as_without_it(bad):
    q = lemniscate(1, 20)
    u = simulated_readings(paper_robot(1), q)
    method = GradientDescent(Sensing(paper_robot(1)), [3.5e-4] * 3, noise=0.005)
    rows = np.insert(u, 9, bad, axis=0)
    found, expected = track(method, rows, q[0]), track(method, u, q[0])
    np.testing.assert_array_equal(np.delete(found.q, 9, axis=0), expected.q)
    assert np.isnan(found.q[9]).all()
    assert found.missing.tolist() == [0] * 9 + [3] + [0] * 11
    assert ("3 left out" in repr(found)) == np.isfinite(bad)
    assert np.sum(found.chi2) == pytest.approx(np.sum(expected.chi2))


def quadratic(q):
    x, y = q[..., 0], q[..., 1]
    return np.stack([x + y * y, x * y, np.sin(x) - y], axis=-1)


def one_at_a_time(q):
    return np.array([q[0] + q[1] * q[1], q[0] * q[1], np.sin(q[0]) - q[1]])


def looks_batched(q):
    """Given two configurations it returns a shape that a batch would have, with other numbers."""
    return np.array([q[0] + q[1] * q[1], q[0] * q[1], np.sin(q[0]) - q[1]]).T[..., :3]


def not_analytic(q):
    return np.abs(quadratic(q) + 10.0) - 10.0


class WithSlopes:
    def __call__(self, q):
        return quadratic(q)

    def linearise(self, q):
        x, y = q[..., 0], q[..., 1]
        one = np.ones_like(x)
        J = np.stack([np.stack([one, 2 * y], -1), np.stack([y, x], -1), np.stack([np.cos(x), -one], -1)], -2)
        return quadratic(q), J


@pytest.mark.parametrize("model", [quadratic, one_at_a_time, looks_batched, not_analytic, WithSlopes()])
def test_a_model_of_ones_own_is_minimised_as_by_scipy(model):
    noise = np.array([0.01, 0.03, 0.02])
    u = quadratic(np.array([0.4, -0.3])) + noise * [1.0, -2.0, 0.5]
    method = LevenbergMarquardt(model, [-1.0, -1.0], [1.0, 1.0], noise, tolerance=1e-9)
    _, found = method.step(method.init([0.0, 0.0]), u)
    best = least_squares(lambda q: (quadratic(q) - u) / noise, [0.0, 0.0], xtol=1e-15, ftol=1e-15, gtol=1e-15)
    np.testing.assert_allclose(found.q, best.x, rtol=0, atol=1e-8)
    information = best.jac.T @ best.jac + np.eye(2) / (2.0**2 / 12)  # that of the bounds
    np.testing.assert_allclose(found.covariance, np.linalg.inv(information), rtol=1e-5)
    assert found.chi2 == pytest.approx(2 * best.cost, rel=1e-8)


def test_how_a_callable_is_called_is_found_out_once():
    calls = []

    def model(q):
        calls.append(np.shape(q))
        return quadratic(q)

    method = LevenbergMarquardt(model, [-1.0, -1.0], [1.0, 1.0], 0.01)
    calls.clear()
    track(method, np.tile(quadratic(np.array([0.1, 0.1])), (3, 1)), [0.0, 0.0])
    assert set(calls) == {(2, 2)}  # complex steps along both coordinates, whose real parts are the readings


def test_a_spline_is_a_model_without_a_warning():
    """SciPy's splines drop an imaginary part: their slopes come from differences, and nobody hears of the try."""
    at = np.linspace(-1.0, 1.0, 30)
    spline = CubicSpline(at, np.stack([np.sin(at), at**2], axis=1))
    with warnings.catch_warnings(record=True) as heard:
        warnings.simplefilter("always")
        method = LevenbergMarquardt(lambda q: spline(q[..., 0]), [-1.0], [1.0], 0.01)
        found = method.step(method.init(), [np.sin(0.3), 0.09])[1]
    assert not heard
    assert found.q == pytest.approx([0.3], abs=1e-4)


def test_bounds_hold_and_do_not_stick():
    method = LevenbergMarquardt(quadratic, [-0.2, -1.0], [0.2, 1.0], 0.01)
    _, found = method.step(method.init([0.2, 0.0]), quadratic(np.array([0.5, 0.0])))
    assert found.q[0] == 0.2
    assert found.details["at_bound"].tolist() == [True, False]
    state, _ = method.step(method.init([0.2, 0.0]), quadratic(np.array([0.5, 0.0])))
    assert method.step(state, quadratic(np.array([0.1, 0.05])))[1].q == pytest.approx([0.1, 0.05], abs=1e-6)


def test_what_the_readings_do_not_determine_is_what_the_bounds_leave():
    """Of x and y only the sum is read. Their difference is in the middle, as uncertain as two uniform numbers'."""
    method = LevenbergMarquardt(lambda q: q[..., :1] + q[..., 1:], [-1.0, -2.0], [1.0, 4.0], 0.01)
    found = method.step(method.init([0.7, -0.9]), [1.0])[1]
    assert found.q == pytest.approx([0.82, 0.18], abs=1e-4)  # next to the start, in units of the widths
    _, found = method.step(method.init(), [1.0])
    assert found.q == pytest.approx([0.0, 1.0], abs=1e-4)
    assert found.covariance.sum() == pytest.approx(1e-4, rel=1e-3)
    width = np.array([2.0, 6.0])
    assert np.sqrt(np.diag(method.step(method.init([1.0, 0.0]), [1.0])[1].covariance)).min() > 1.0
    exact = np.linalg.inv(np.ones((2, 2)) / 0.01**2 + np.diag(12 / width**2))
    np.testing.assert_allclose(found.covariance, exact, rtol=1e-6)
    assert found.dof == 0


def test_a_bound_that_stops_an_estimate_is_named_where_a_direction_is_open_too():
    """Of x and y only the sum is read, so that what touches a bound depends on where the rest comes to lie."""
    low, high = np.array([-1.0, -2.0]), np.array([1.0, 4.0])
    method = LevenbergMarquardt(lambda q: q[..., :1] + q[..., 1:], low, high, 0.01)
    sums = np.linspace(-4, 6, 41)[:, None]
    _, found = method.step(method.init(np.tile([0.7, -0.9], (41, 1))), sums)
    touches = (found.q <= low) | (found.q >= high)
    np.testing.assert_array_equal(found.details["at_bound"], touches)
    assert 0 < touches.sum() < touches.size


@given(st.integers(0, 10_000))
def test_the_rank_is_how_many_directions_the_readings_know_better_than_the_bounds(seed):
    generator = np.random.default_rng(seed)
    n, s = generator.integers(1, 7), 8
    J, width = generator.normal(size=(s, n)), 10 ** generator.uniform(-2, 2, n)
    J = J * 10 ** generator.uniform(-6, 6, n)
    J[:, generator.random(n) < 0.3] = 0.0
    if n > 2 and seed % 3 == 0:
        J[:, 0] = J[:, 1] - 2 * J[:, 2]
    values = np.linalg.eigvalsh(J.T @ J * np.outer(width, width) / 12)
    method = LevenbergMarquardt(lambda q: q @ J.T, -width / 2, width / 2, 1.0)
    _, found = method.step(method.init(np.zeros(n)), np.zeros(s))
    if (np.abs(values - 1) > 1e-6).all() and not found.details["at_bound"].any():
        assert found.dof == s - (values > 1).sum()
    assert (np.sqrt(np.diag(found.covariance)) <= width / np.sqrt(12) * (1 + 1e-9)).all()


def test_an_unread_coordinate_stays_in_the_middle_and_leaves_the_degrees_of_freedom_alone():
    """An orientation says nothing of the length: two of three coordinates are seen by its three readings."""
    robot = Robot(
        [ConstantCurvature(0.08, 0.0125)], imus=[Imu(1, 0.08)], noise=0.02,
        lower=[-0.02, -0.02, -0.008], upper=[0.02, 0.02, 0.010],
    )  # fmt: skip
    q = np.array([0.004, -0.003, 0.006])
    u = robot.sensing()(q) + 0.02 * np.random.default_rng(0).standard_normal((400, 3))
    for make in (LevenbergMarquardt, KalmanFilter):
        found = track(make(robot), u, rate_hz=30.0)
        assert (found.status == "consistent").all()
        np.testing.assert_allclose(found.q[:, 2], 0.001, atol=1e-9)
        std = np.sqrt(found.covariance[:, 2, 2])
        assert std == pytest.approx(np.full(400, 0.018 / np.sqrt(12)), rel=0.02)
        if make is LevenbergMarquardt:
            assert (found.dof == 1).all()
            assert found.chi2.mean() == pytest.approx(1.0, abs=0.2)


def test_a_robot_beyond_a_bound_keeps_its_shape_and_says_so():
    """It bends 0.05 beyond a bound of 1: no reading is blamed, and rows within the bounds fit."""
    line = np.array([[1.0, 0.0], [0.0, 1.0], [1.0, 1.0], [1.0, -1.0], [2.0, 1.0]])
    method = LevenbergMarquardt(lambda q: q @ line.T, [-1.0, -1.0], [1.0, 1.0], 0.001)
    x = np.concatenate([np.linspace(0.0, 1.05, 60), np.linspace(1.05, 0.0, 60)])
    q = np.stack([x, 0.3 * np.sin(9 * x)], axis=-1)
    u = q @ line.T + 0.001 * np.random.default_rng(0).standard_normal((120, 5))
    found = track(method, u, rate_hz=20.0)
    outside = x > 1.005
    assert set(found.status[outside]) == {"beyond bounds"}
    assert set(found.status[x < 0.999]) == {"consistent"}
    assert not found.suspects.any()
    assert found.details["at_bound"][outside].tolist() == [[True, False]] * outside.sum()
    assert np.abs(found.q - q).max() < 0.06
    off, C = found.q - q, found.covariance
    assert ((off * np.linalg.solve(C, off[..., None])[..., 0]).sum(-1)[outside] < 6).all()
    table = found.to_frame()
    assert set(table["at_bound"][outside]) == {"q_1"}
    assert f"at a bound: q_1 in {(found.details['at_bound']).sum()} rows" in repr(found)


def affine_arm():
    magnets = [Magnet(RELEASED, 1, 0.054), Magnet(RELEASED, 2, 0.051), Magnet(RELEASED, 2, 0.081)]
    planes = [(1, 0.021), (1, 0.087), (2, 0.015), (2, 0.12)]
    sensors = [
        Sensor(g, at, radial=0.015, azimuth=np.radians(90 * k + 20 * i))
        for i, (g, at) in enumerate(planes)
        for k in range(4)
    ]
    high = np.tile([np.pi / 2, np.pi, np.pi, 0.012], 2)
    return magnets, sensors, high


def test_azimuths_do_not_trap_two_affine_segments():
    """500 shapes drawn evenly within the bounds, each once from straight: at most one ends more than 1 mm away."""
    magnets, sensors, high = affine_arm()
    robot, rng = Robot([AffineCurvature(0.12)] * 2, magnets, sensors), np.random.default_rng(0)
    q = high * rng.uniform(-1, 1, (500, 8))
    u = simulated_readings(robot, q) + 0.002 * rng.normal(size=(500, 16))
    method = LevenbergMarquardt(Sensing(robot), -high, high, noise=0.002)
    _, found = method.step(method.init(np.zeros((500, 8))), u)
    off = np.linalg.norm(robot.tip(found.q)[:, :3, 3] - robot.tip(q)[:, :3, 3], axis=1)
    assert (off > 1e-3).sum() <= 1
    assert (np.abs(found.q[:, robot.angles]) <= np.pi).all()


def test_a_richer_model_never_fits_worse():
    """Affine curvature contains constant curvature: from its optimum and from straight it fits at least as well."""
    magnets, sensors, high = affine_arm()
    rng = np.random.default_rng(1)
    poor = Robot([ConstantCurvature(0.12, 1.0)] * 2, magnets, sensors)
    rich = Robot([AffineCurvature(0.12)] * 2, magnets, sensors)
    q = high * rng.uniform(-1, 1, (200, 8))
    u = simulated_readings(rich, q) + 0.002 * rng.normal(size=(200, 16))
    limit = np.tile([np.pi / 2 + np.pi, np.pi / 2 + np.pi, 0.012], 2)
    arcs = LevenbergMarquardt(Sensing(poor), -limit, limit, noise=0.002)
    _, found = arcs.step(arcs.init(np.zeros((200, 6))), u)
    x, y, stretch = np.moveaxis(found.q.reshape(200, 2, 3), -1, 0)
    # A bend to (x, y) is kappa_0 at the azimuth whose direction (sin phi, -cos phi) is that of (x, y).
    contained = np.stack([np.hypot(x, y), 0 * x, np.arctan2(x, -y), stretch], axis=-1).reshape(200, 8)
    wide = np.tile([2 * np.pi, 4 * np.pi, np.pi, 0.012], 2)
    method = LevenbergMarquardt(Sensing(rich), -wide, wide, noise=0.002)
    for start in (contained, np.zeros((200, 8))):
        _, better = method.step(method.init(start), u)
        assert (better.chi2 <= found.chi2 * (1 + 1e-9)).all()


def test_without_a_start_it_searches():
    """A polynomial with a wrong valley at the middle of the bounds."""

    def valleys(q):
        return np.concatenate([(q**2 - 0.49) * (q + 0.05), 0.1 * q], axis=-1)

    u = valleys(np.array([0.69]))
    method = LevenbergMarquardt(valleys, [-1.0], [1.0], 0.001)
    stuck, found = (method.step(method.init(q0), u)[1] for q0 in ([-0.7], None))
    assert found.q == pytest.approx(0.69, abs=1e-3)
    assert found.chi2 < 0.01 < stuck.chi2


def first(method, q0, u):
    """Return the first estimate."""
    return method.step(method.init(q0), u)[1]


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: LevenbergMarquardt(quadratic, [1.0, 1.0], [0.0, 2.0], 0.1), "ordered bounds"),
        (
            lambda: LevenbergMarquardt(quadratic, [0.0, 0.0], [1.0, 1.0], -0.1),
            "noise of LevenbergMarquardt must be pos",
        ),
        (
            lambda: LevenbergMarquardt(quadratic, [0.0, 0.0], [1.0, 1.0], 0.1, iterations=0),
            "iterations .* positive",
        ),
        (
            lambda: LevenbergMarquardt(3, [0.0], [1.0], 0.1),
            "a callable from q to readings; instead received int",
        ),
        (
            lambda: LevenbergMarquardt(lambda q: q[7], [0.0], [1.0], 0.1),
            "callable of 1 coordinates; .* IndexError",
        ),
        (lambda: LevenbergMarquardt(lambda q: 1.0, [0.0], [1.0], 0.1), r"one that returns readings \[s\]"),
        (
            lambda: LevenbergMarquardt(Sensing(paper_robot(1)), [0.0], [1.0], 0.1),
            "bounds of its 3 coordinates",
        ),
        (
            lambda: GradientDescent(quadratic, [-1.0, 1.0]),
            "step_size of GradientDescent must be not negative",
        ),
        (
            lambda: GradientDescent(quadratic, 1e-6),
            "step_size of GradientDescent must be one number for each coordinate; instead received 1e-06",
        ),
        (
            lambda: GradientDescent(paper_robot(1), [1e-6] * 2),
            "one number for each of 3 coordinates, or one for all",
        ),
        (
            lambda: GradientDescent(BOUNDED, 1e-4).init([0.0, 0.0, 0.1]),
            "q0 of GradientDescent must be within",
        ),
        (lambda: GradientDescent(quadratic, [1.0, 1.0], momentum=1.0), r"in \[0, 1\)"),
        (
            lambda: GradientDescent(quadratic, [1.0, 1.0], noise=0.0),
            "noise of GradientDescent must be positive",
        ),
        (
            lambda: first(
                LevenbergMarquardt(lambda q: np.where(q < 0.2, np.nan, q), [0.0], [1.0], 0.1), [0.1], [0.5]
            ),
            "finite where the estimator starts",
        ),
        (
            lambda: first(
                LevenbergMarquardt(quadratic, [0.0, 0.0], [1.0, 1.0], [0.1, 0.2]), [0.5, 0.5], [0.1] * 3
            ),
            "one number or one for each of 3 readings",
        ),
        (
            lambda: LevenbergMarquardt(quadratic, [0.0, 0.0], [1.0, 1.0], [0.1, 0.2]).init([2.0, 0.0]),
            "q0 of LevenbergMarquardt must be within the bounds",
        ),
        (
            lambda: first(GradientDescent(quadratic, [1e200, 1e200]), [0.1, 0.2], [1.0] * 3),
            "small enough for a finite descent",
        ),
    ],
)
def test_what_cannot_be_is_refused_in_words(make, message):
    with pytest.raises(InputError, match=message), np.errstate(all="ignore"):
        make()


def test_a_torch_module_is_a_model_in_one_line_and_says_so_without_it():
    torch = pytest.importorskip("torch")
    module = torch.nn.Linear(2, 3).double()
    with pytest.raises(InputError, match=r"of a torch module, lambda q: module\(torch.as_tensor\(q\)\)"):
        LevenbergMarquardt(module, [-1.0, -1.0], [1.0, 1.0], 0.01)
    model = lambda q: module(torch.as_tensor(q)).detach().numpy()  # noqa: E731
    q = np.array([0.3, -0.2])
    method = LevenbergMarquardt(model, [-1.0, -1.0], [1.0, 1.0], 0.01)
    np.testing.assert_allclose(method.step(method.init(), model(q))[1].q, q, atol=1e-4)
