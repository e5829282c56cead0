"""One contract for all estimators."""

from __future__ import annotations

import tracemalloc
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pandas as pd
import pytest

from repro import (
    BendSensor,
    Drift,
    Drifting,
    GradientDescent,
    InputError,
    KalmanFilter,
    LevenbergMarquardt,
    ParticleFilter,
    Sensing,
    smooth,
    track,
)
from repro.estimators.base import Estimator, evenly
from repro.estimators.rod import Rod, RodFilter, RodSensor

from .robots import bounds, paper_robot

LOW, HIGH = bounds(1)
SENSING = Sensing(paper_robot(1, 6))
Q0 = np.array([0.004, -0.003, 0.002])
FAST = ([1.0] * 3, [0.1] * 3)


def callable_model(q):
    return np.stack([q.sum(-1), q[..., 0] - q[..., 1], 2 * q[..., 2], q[..., 1] * q[..., 2]], axis=-1)


ESTIMATORS = {
    "descent": (GradientDescent(SENSING, [3.5e-4] * 3, noise=1e-3), Q0, SENSING(Q0 + 2e-4)),
    "descent of a robot": (
        GradientDescent(paper_robot(1, 6).replaced(lower=LOW, upper=HIGH, noise=1e-3), 3.5e-4),
        Q0,
        SENSING(Q0 + 2e-4),
    ),
    "descent of a callable": (GradientDescent(callable_model, [0.1] * 3), Q0, callable_model(Q0 + 1e-3)),
    "least squares": (LevenbergMarquardt(SENSING, LOW, HIGH, 1e-3), Q0, SENSING(Q0 + 2e-4)),
    "least squares of a callable": (
        LevenbergMarquardt(callable_model, LOW, HIGH, 1e-3),
        Q0,
        callable_model(Q0 + 1e-3),
    ),
    "Kalman": (KalmanFilter(SENSING, LOW, HIGH, 1e-3, *FAST), Q0, SENSING(Q0 + 2e-4)),
    "Kalman with drift": (
        KalmanFilter(Drifting(SENSING, [Drift("offset", 0.01, 1e-3)]), LOW, HIGH, 1e-3, *FAST),
        Q0,
        SENSING(Q0 + 2e-4),
    ),
    "particles": (
        ParticleFilter(BendSensor(0.015), [0.02] * 2, 0.05, particles=200),
        np.array([0.3, 0.1]),
        BendSensor(0.015)([0.31, 0.12]),
    ),
    "particles with a velocity": (
        ParticleFilter(BendSensor(0.015), [0.1] * 2, 0.1, particles=200, motion="constant velocity"),
        np.array([0.1, 0.2]),
        BendSensor(0.015)([0.11, 0.19]),
    ),
    "rod": (
        RodFilter(
            Rod(1.0, bending=1, torsion=0), (RodSensor("pose", 1e-3, arc_m=1.0),), (10.0, 10.0), rate=1.0
        ),
        np.zeros(2),
        np.array([0.0, 0.0, 1.0, 0.01, 0.0, 0.0]),
    ),
}
GROUP = {"rod": 6}
"""Readings that count as missing together."""


@pytest.fixture(params=ESTIMATORS)
def case(request):
    return request.param, *ESTIMATORS[request.param]


def same(a, b, rtol=0.0, atol=0.0):
    for x, y in zip(a[:-1], b[:-1], strict=True):
        if x is not None:
            np.testing.assert_allclose(x, y, rtol=rtol, atol=atol, equal_nan=True)
    for name in a.details:
        np.testing.assert_allclose(a.details[name], b.details[name], rtol=rtol, atol=atol)


def test_a_state_is_never_changed_and_gives_the_same_bits_twice(case):
    _, method, q0, u = case
    assert isinstance(method, Estimator)
    state, _ = method.step(method.init(q0, seed=3), u, 0.0)
    later, first = method.step(state, u, 0.025)
    _, second = method.step(state, u, 0.025)
    same(first, second)
    method.step(later, u, 0.05)
    same(first, method.step(state, u, 0.025)[1])


def test_a_batch_gives_what_its_members_give_alone(case):
    name, method, q0, u = case
    rng = np.random.default_rng(0)
    noise = 0.0 if name in GROUP else 1e-4
    rows = u + noise * rng.normal(size=(2, 3, len(u)))
    state, found = method.step(method.init(np.broadcast_to(q0, (2, 3, len(q0)))), rows, 0.0)
    state, found = method.step(state, rows, 0.1)
    for k in np.ndindex(2, 3):
        alone, _ = method.step(method.init(q0), rows[k], 0.0)
        _, alone = method.step(alone, rows[k], 0.1)
        np.testing.assert_allclose(found.q[k], alone.q, rtol=1e-9, atol=1e-12)
        np.testing.assert_allclose(found.u_hat[k], alone.u_hat, rtol=1e-9, atol=1e-12)
        if found.covariance is not None:
            np.testing.assert_allclose(found.covariance[k], alone.covariance, rtol=1e-6, atol=1e-15)
        for field in ("chi2", "dof", "missing"):
            np.testing.assert_allclose(getattr(found, field)[k], getattr(alone, field), rtol=1e-6, atol=1e-9)


def test_a_start_without_a_batch_serves_a_batch_of_readings(case):
    _, method, q0, u = case
    _, found = method.step(method.init(q0), np.stack([u, u]), 0.0)
    assert found.q.shape == (2, len(q0))


@pytest.mark.parametrize("make", [
    lambda robot: GradientDescent(robot, 3.5e-4), LevenbergMarquardt, KalmanFilter,
    lambda robot: ParticleFilter(robot, particles=10),
])  # fmt: skip
def test_a_robot_whose_coordinates_are_all_fixed_is_refused(make):
    """Its shape would be known exactly, whatever is read. One free coordinate will do."""
    robot = paper_robot(1, 6).replaced(noise=1e-3, rate_hz=25.0)
    make(robot.replaced(lower=[*LOW[:2], 0.0], upper=[*LOW[:2], 4e-3]))
    with pytest.raises(
        InputError, match="one with a coordinate that is free; instead received delta_x_1, .* fixed by"
    ):
        make(robot.replaced(lower=LOW, upper=LOW))


@pytest.mark.parametrize("how", ["nan", "infinite", "mask"])
def test_what_is_missing_is_left_out_and_counted(case, how):
    name, method, q0, u = case
    n = GROUP.get(name, 1)
    rows, mask = np.stack([u, u]), np.ones((2, len(u)), dtype=bool)
    if how == "mask":
        mask[1, -1] = False
        rows[1, -1] = 1e6
    else:
        rows[1, -1] = np.nan if how == "nan" else -np.inf
    _, found = method.step(method.init(q0), rows, 0.0, mask=mask)
    assert found.missing.tolist() == [0, n]
    assert np.isfinite(found.q).all()
    assert np.isfinite(found.u_hat).all()
    if name not in GROUP:
        np.testing.assert_allclose(found.q[0], found.q[1], rtol=0, atol=0.1 * np.abs(q0).max() + 1e-9)


def test_known_coordinates_are_taken_over(case):
    name, method, q0, u = case
    known = np.full(len(q0), np.nan)
    known[-1] = q0[-1] + (0.0 if name in GROUP else 5e-4)
    _, found = method.step(method.init(q0), u, 0.0, known=known)
    assert found.q[-1] == pytest.approx(known[-1], abs=1e-12)
    if found.covariance is not None:
        np.testing.assert_allclose(found.covariance[-1], 0.0, atol=1e-18)


def test_lists_and_data_frames_are_arrays(case):
    _, method, q0, u = case
    _, expected = method.step(method.init(q0), u, 0.0)
    same(method.step(method.init(list(q0)), list(u), 0.0)[1], expected)
    frame = pd.DataFrame([u, u])
    options = {"times": [0.0, 0.1]}
    np.testing.assert_array_equal(track(method, frame, q0, **options).q[0], expected.q)


def test_tracking_is_stepping(case):
    _, method, q0, u = case
    rows, times = np.stack([u] * 4), np.array([0.0, 0.1, 0.25, 0.3])
    found = track(method, rows, q0, times=times, seed=2, monitor=None)
    state = method.init(q0, seed=2)
    for k, t in enumerate(times):
        state, estimate = method.step(state, rows[k], t)
        np.testing.assert_array_equal(found.q[k], estimate.q)
        np.testing.assert_array_equal(found.dof[k], estimate.dof)
    assert len(repr(found).splitlines()) == 3


def test_wrong_shapes_types_and_masks_are_refused_in_words(case):
    name, method, q0, u = case
    state = method.init(q0)
    refused = [
        (lambda: method.step(state, u[:-1], 0.0), "u of .* must be "),
        (lambda: method.step(state, "abc", 0.0), "u of .* must be numbers"),
        (lambda: method.step(state, u, 0.0, mask=[True]), "mask of .* must be true or false for each of"),
        (lambda: method.step(state, u, 0.0, known=np.zeros(9)), "known of .* must be numbers of shape"),
        (lambda: method.init(np.zeros(11)), "q0 of .* must be numbers of shape"),
        (lambda: method.init(np.full(len(q0), np.nan)), "q0 of .* must be finite"),
    ]
    if name.startswith("particles"):
        refused = refused[1:]  # any callable may have any number of readings: the model itself would refuse
    for call, message in refused:
        with pytest.raises(InputError, match=message):
            call()


def test_tracking_refuses_what_does_not_fit():
    method, q0, u = ESTIMATORS["Kalman"]
    rows = np.stack([u] * 3)
    for call, message in [
        (lambda: track(method, rows, q0), "times, rate_hz of track must be given for a filter"),
        (lambda: track(method, rows, q0, times=[0.0, 0.2, 0.1]), "increasing .* 0.1 after 0.2 in row 2"),
        (lambda: track(method, rows, q0, rate_hz=0.0), "rate_hz of track must be positive"),
        (lambda: track(method, rows, q0, rate_hz=9.0, mask=[[True]]), "one row for each of 3 time steps"),
        (lambda: track(method, [], q0, rate_hz=9.0), r"of shape \(t, ..., s\)"),
        (lambda: track(3, rows, q0), "estimator of track must be an estimator; instead received int"),
        (lambda: track(method, rows, q0, rate_hz=9.0, monitor="always"), '"auto" or None'),
        (lambda: smooth(ESTIMATORS["least squares"][0], rows, q0, rate_hz=9.0), "a Kalman or rod filter"),
        (lambda: method.step(method.step(method.init(q0), u, 1.0)[0], u, 1.0), "after the last step, 1.0 s"),
    ]:
        with pytest.raises(InputError, match=message):
            call()


@pytest.mark.parametrize(("name", "dof"), [("least squares", 3), ("Kalman", 6)])
def test_chi_square_has_its_degrees_of_freedom(name, dof):
    """With the right noise its mean is 3, six readings less three coordinates, within three standard errors.

    A prior far wider than the noise adds a residual for each coordinate, and these are nearly zero.
    """
    method, q0, _ = ESTIMATORS[name]
    u = SENSING(Q0) + 1e-3 * np.random.default_rng(0).normal(size=(400, 6))
    _, found = method.step(method.init(q0), u, 0.0)
    assert (found.dof == dof).all()
    assert found.chi2.mean() == pytest.approx(3.0, abs=3 * np.sqrt(6 / 400))


def test_threads_find_what_one_finds(case):
    """Kernels run without Python's lock; threads that share an estimator must not meet."""
    _, estimator, q0, u = case
    readings = np.repeat(np.asarray(u)[None], 30, axis=0)

    def tracked(_):
        return track(estimator, readings, q0, rate_hz=40).q

    with ThreadPoolExecutor(4) as pool:
        several = list(pool.map(tracked, range(8)))
    assert all(np.array_equal(one, tracked(0)) for one in several)


@pytest.mark.parametrize("method", [LevenbergMarquardt, KalmanFilter])
def test_a_row_of_three_coordinates_takes_few_bytes(method):
    """At its peak, with the monitor, its three readings and what is returned."""
    estimator = method(np.array, [-1.0] * 3, [1.0] * 3, 0.01)
    u = 0.5 + 0.01 * np.random.default_rng(0).normal(size=(1280, 3))
    peaks = []
    for n in (512, 1280):
        tracemalloc.start()
        found = track(estimator, u[:n], rate_hz=100.0)
        peaks.append(tracemalloc.get_traced_memory()[1])
        tracemalloc.stop()
    assert len(found.q) == 1280
    assert peaks[1] - peaks[0] <= 400 * 768


def test_rows_are_the_same_whether_written_at_once_or_some_at_a_time(monkeypatch):
    estimator = LevenbergMarquardt(lambda q: q * np.ones(4), [-1.0], [1.0], 0.01)
    u = 0.5 + 0.01 * np.random.default_rng(0).normal(size=(40, 4))
    u[20:, 3] = 0.0  # the monitor says more of these
    whole = vars(track(estimator, u, [0.5], rate_hz=100.0))
    monkeypatch.setattr("repro.estimators.track._AT_ONCE", 7)
    parts = vars(track(estimator, u, [0.5], rate_hz=100.0))
    assert whole["details"].keys() == parts["details"].keys()
    assert len(set(parts["status"].tolist())) > 1
    for name, expected in (whole | whole["details"]).items():
        found = (parts | parts["details"])[name]
        if isinstance(expected, np.ndarray):
            assert found.dtype == expected.dtype, name
            np.testing.assert_array_equal(found, expected, name)


@pytest.mark.parametrize("size", [9.9e99, -9.9e99, 1e100, -1e100, np.inf])
def test_a_reading_of_1e100_and_more_is_missing_whatever_reads_it(size):
    robot = paper_robot(1, 3).replaced(lower=LOW, upper=HIGH, noise=1e-3)
    for method, u in (
        (LevenbergMarquardt(lambda q: q * np.ones(3), [-1.0], [1.0], 0.1), np.full(3, 0.5)),
        (LevenbergMarquardt(robot), Sensing(robot)(Q0)),
    ):
        rows = np.stack([u, np.where(np.arange(3) == 1, size, u)])
        assert track(method, rows, rate_hz=1.0, monitor=None).missing.tolist() == [0, abs(size) >= 1e100]


@pytest.mark.parametrize("n", [1, 7, 100, 1000])
def test_starts_fill_a_box_evenly_from_its_middle_on(n):
    """In one dimension the golden ratio leaves no gap as wide as two and a half even ones."""
    one, many = evenly(np.array([-1.0]), np.array([3.0]), n), evenly(LOW, HIGH, n)
    assert one[0] == [1.0]
    np.testing.assert_allclose(many[0], (LOW + HIGH) / 2)
    assert ((many >= LOW) & (many <= HIGH)).all()
    assert np.diff(np.sort(np.r_[-1.0, one[:, 0], 3.0])).max() < 2.5 * 4.0 / n
