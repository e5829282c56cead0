"""The particle filter and the bend sensor of Mitchell et al. 2021."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.signal import fftconvolve

from repro import ConstantCurvature, Cube, InputError, Magnet, Robot, Sensor, simulated_readings, track
from repro.estimators.particle import BendDisc, Box, ParticleFilter, _best_tenth, _drawn, _points
from repro.sensing import BendSensor

DISC = BendDisc(math.pi / 2)
B444B = Cube(6.35e-3, 1320.0)


def arc(length: float, cube: Cube) -> Robot:
    segment = ConstantCurvature(length, 1.0, extensible=False)
    return Robot([segment], [Magnet(cube, 1, length)], [Sensor(0, 0.0, axes=3)])


@pytest.mark.parametrize(
    ("length", "edge"), [(0.015, 6.35e-3), (0.013, 6.35e-3), (0.0081, 6.35e-3), (0.1, 5e-3)]
)
def test_bend_sensor_reads_the_exact_field_of_the_cube(length, edge):
    rng = np.random.default_rng(0)
    angle, direction = math.pi * np.sqrt(rng.random(2000)), rng.uniform(0, 2 * math.pi, 2000)
    q = np.stack([angle * np.cos(direction), angle * np.sin(direction)], axis=-1).reshape(4, 500, 2)
    q[0, :5] = [[0, 0], [1e-200, 0], [0, -1e-9], [1, 0], [0, -1.5]]
    cube, robot = Cube(edge, 1320.0), arc(length, Cube(edge, 1320.0))
    np.testing.assert_allclose(BendSensor(length, cube)(q), simulated_readings(robot, q), rtol=0, atol=1e-9)
    np.testing.assert_allclose(BendSensor(length, cube).position(q), robot.tip(q)[..., :3, 3], atol=1e-15)


def test_bend_sensor_stays_clear_of_its_magnet():
    with pytest.raises(InputError, match=r"length of BendSensor must be longer than 1.25 edges"):
        BendSensor(0.0079)
    with pytest.raises(InputError, match=r"q of BendSensor must be numbers of shape \(..., 2\)"):
        BendSensor(0.015)([1.0, 2.0, 3.0])


@pytest.mark.parametrize("resampling", ["multinomial", "systematic"])
def test_filter_agrees_with_the_exact_posterior_on_a_grid(resampling):
    sensing, region, noise, width, n = BendSensor(0.015), BendDisc(0.6), [0.9, 0.6, 0.4], [0.12, 0.08], 40_000
    x = np.linspace(-0.6, 0.6, 121)
    grid = np.stack(np.meshgrid(x, x, indexing="ij"), axis=-1)
    inside = region.contains(grid)
    move = np.exp(-0.5 * (np.add.outer((x / width[0]) ** 2, (x / width[1]) ** 2)))
    # Noise that leads outside is drawn again: from every place the share that stays is scaled to one.
    stay = fftconvolve(inside.astype(float), move, mode="same")
    p = np.where(inside, np.exp(-0.5 * (((grid - [0.3, 0.2]) / width) ** 2).sum(-1)), 0.0)
    method = ParticleFilter(sensing, width, noise, region, particles=n, resampling=resampling)
    state = method.init([0.3, 0.2], seed=3)
    rng = np.random.default_rng(1)
    for k in range(6):
        u = sensing([0.45 - 0.1 * k, 0.3]) + noise * rng.standard_normal(3)
        u[1] = np.nan if k == 2 else u[1]
        p = p * np.exp(-0.5 * np.nansum(((sensing(grid) - u) / noise) ** 2, axis=-1))
        p /= p.sum()
        mean = (p[..., None] * grid).sum((0, 1))
        C = np.einsum("ij,ija,ijb->ab", p, grid - mean, grid - mean)
        state, found = method.step(state, u)
        spread = np.sqrt(np.diag(C))
        assert (np.abs(found.q - mean) < 0.04 * spread).all()
        assert (np.abs(found.covariance - C) < 0.04 * np.outer(spread, spread)).all()
        p = np.where(inside, fftconvolve(p / stay, move, mode="same").clip(0), 0.0)


@given(st.lists(st.floats(0, 1), min_size=1, max_size=30), st.integers(0, 1000))
def test_systematic_resampling_takes_every_particle_within_one_of_its_expected_number(weights, seed):
    w = np.array([weights]) + 1e-12
    points = _points(w.size, "systematic", np.random.default_rng(seed))
    counts = np.bincount(_drawn(w, points)[0], minlength=w.size)
    assert counts.sum() == w.size
    assert (np.abs(counts - w.size * w[0] / w.sum()) < 1 + 1e-9).all()


@pytest.mark.parametrize(("rate_hz", "steps"), [(None, 50.0), (40.0, 80.0), (2.0, 10.0)])
def test_process_noise_that_is_not_given_is_half_of_the_range_in_a_second(rate_hz, steps):
    """A fiftieth of the range if no rate is stated, and at most a tenth."""
    robot = arc(0.03, B444B).replaced(lower=[-1.0, -0.5], upper=[1.0, 0.5], noise=0.1, rate_hz=rate_hz)
    np.testing.assert_allclose(ParticleFilter(robot).process_noise, [2.0 / steps, 1.0 / steps])


def test_multinomial_resampling_draws_independently():
    w, rng = np.array([[0.1, 0.2, 0.0, 0.7]]), np.random.default_rng(0)
    counts = np.array(
        [np.bincount(_drawn(w, _points(4, "multinomial", rng))[0], minlength=4) for _ in range(4000)]
    )
    np.testing.assert_allclose(counts.mean(0), 4 * w[0], atol=0.06)
    np.testing.assert_allclose(counts.var(0), 4 * w[0] * (1 - w[0]), atol=0.06)


def test_best_tenth_is_eqs_3_and_4():
    rng = np.random.default_rng(0)
    q, squares = rng.standard_normal((3, 95, 2)), rng.random((3, 95))
    near = np.take_along_axis(q, np.argsort(squares, axis=-1)[:, :10, None], axis=1)
    angles = np.arctan2(near[..., 1], near[..., 0])
    direction = np.arctan2(np.sin(angles).mean(1), np.cos(angles).mean(1))
    mean = np.hypot(*near.T).T.mean(1)[:, None] * np.stack([np.cos(direction), np.sin(direction)], axis=-1)
    np.testing.assert_allclose(_best_tenth(q, squares)[:, 0], mean, rtol=1e-12)


@pytest.mark.parametrize("motion", ["random walk", "constant velocity"])
@pytest.mark.parametrize("region", [BendDisc(0.5), Box([-0.5, 0.1], [0.3, 0.4])])
def test_particles_never_leave_the_region(motion, region):
    method = ParticleFilter(
        lambda q: q, [[0.5, 0.5], [30.0, 30.0]], 0.2, region, particles=300, motion=motion
    )
    state = method.init([0.25, 0.2])
    for _ in range(5):
        assert region.contains(state.q).all()
        assert state.q[0].std(0).min() > 0
        state, _ = method.step(state, [2.0, 0.2])
    everywhere = method.init(seed=1).q
    assert everywhere.shape == (2, 300, 2)
    assert region.contains(everywhere).all()


def test_surprise_is_standard_normal_while_the_filter_follows():
    rng = np.random.default_rng(0)
    q = np.cumsum(0.1 * rng.standard_normal((400, 2)), axis=0)
    A = np.array([[1.0, 0.3], [0.2, -1.0], [0.5, 0.5]])
    u = q @ A.T + 0.2 * rng.standard_normal((400, 3))
    found = track(ParticleFilter(lambda q: q @ A.T, [0.1, 0.1], 0.2), u, q[0], rate_hz=1).details["surprise"]
    assert abs(found.mean()) < 0.2
    assert abs(found.std() - 1) < 0.15


def test_constant_velocity_follows_a_ramp_without_lag():
    q = np.linspace(0, 3, 60)[:, None]
    lag = {}
    for motion in ("random walk", "constant velocity"):
        method = ParticleFilter(lambda q: q, [0.02], 0.05, motion=motion)
        lag[motion] = float((q - track(method, q, q[0], rate_hz=1).q)[20:].mean())
    assert lag["random walk"] > 0.05
    assert abs(lag["constant velocity"]) < 0.005


def test_missing_readings_and_known_coordinates():
    A = np.array([[1.0, 0.0], [0.0, 1.0], [1.0, 1.0]])
    both = ParticleFilter(lambda q: q @ A.T, [0.1, 0.1], 0.1)
    fewer = ParticleFilter(lambda q: q @ A[:2].T, [0.1, 0.1], 0.1)
    state = both.init([0.0, 0.0])
    _, expected = fewer.step(state, [0.1, -0.1])
    for u, mask in (([0.1, -0.1, np.inf], None), ([0.1, -0.1, 5.0], [True, True, False])):
        _, found = both.step(state, u, mask=mask)
        assert (found.missing, found.dof) == (1, 0)
        np.testing.assert_allclose(found.q, expected.q, rtol=1e-12)
        np.testing.assert_allclose(found.details["surprise"], expected.details["surprise"], rtol=1e-9)
    _, found = both.step(state, [0.1, 0.3, 0.4], known=[np.nan, 0.3])
    assert (found.q[1], found.covariance[1].tolist(), found.dof) == (0.3, [0.0, 0.0], 2)
    assert found.covariance[0, 0] > 0
    following, found = both.step(state, [np.nan] * 3)
    assert np.isnan(found.details["surprise"])
    assert abs(found.details["effective_sample_size"] - 1000) < 1e-6
    # A million standard deviations away no weight underflows.
    _, found = both.step(following, [1e5, 1e5, 2e5])
    assert np.isfinite(found.q).all()
    assert found.details["surprise"] > 6


WRONG = [
    ({"process_noise": [0.1, 0.0]}, "process_noise of ParticleFilter must be positive"),
    ({"noise": -1}, "noise of ParticleFilter must be positive"),
    ({"noise": [[1.0]]}, "noise of ParticleFilter must be one number, or one per reading"),
    ({"particles": 0.5}, "particles of ParticleFilter must be a positive whole number"),
    (
        {"estimate": "mean"},
        "estimate of ParticleFilter must be one of 'best tenth', 'weighted'",
    ),
    ({"estimate": "best tenth", "process_noise": [1.0]}, "instead received 'best tenth' for 1 coordinates"),
    ({"sensing": 1}, "sensing of ParticleFilter must be a callable"),
]


@pytest.mark.parametrize(("change", "message"), WRONG)
def test_a_filter_that_cannot_work_is_refused(change, message):
    with pytest.raises(InputError, match=message):
        ParticleFilter(**{"sensing": lambda q: q, "process_noise": [0.1, 0.1], "noise": 0.1, **change})


def test_calls_that_cannot_work_are_refused():
    method = ParticleFilter(BendSensor(0.015), [0.1, 0.1], 0.1, BendDisc(0.5))
    state = method.init([[0.1, 0.1]] * 2)
    no_batches = ParticleFilter(lambda q: np.zeros(3), [0.1, 0.1], 0.1)
    calls = {
        r"q0 of ParticleFilter must be within BendDisc\(radius=0.5\)": lambda: method.init([0.4, 0.4]),
        "q0 of ParticleFilter must be given for a filter without a region": lambda: no_batches.init(),
        "seed of ParticleFilter must be a whole number": lambda: method.init([0.1, 0.1], seed=-1),
        "u of ParticleFilter must be 3 readings": lambda: method.step(state, [1.0, 2.0]),
        "must be of batches that fit each other": lambda: method.step(state, np.zeros((3, 3))),
        "sensing of ParticleFilter must be a model that takes batches": lambda: no_batches.step(
            no_batches.init([0.1, 0.1]), np.zeros(3)
        ),
        "lower of Box must be not above upper": lambda: Box([0.0, 2.0], [1.0, 1.0]),
        "radius of BendDisc must be positive": lambda: BendDisc(0.0),
    }
    for message, call in calls.items():
        with pytest.raises(InputError, match=message):
            call()


@pytest.mark.parametrize("spike", [1e3, 1e15, 1e17, 1e30])
def test_one_reading_beyond_all_sense_costs_one_row(spike):
    method = ParticleFilter(BendSensor(0.015), [0.05] * 2, 0.1, DISC)
    u = np.tile(BendSensor(0.015)([0.3, 0.2]), (40, 1))
    u[20, 1] = spike
    found = track(method, u, [0.3, 0.2], rate_hz=10.0)
    assert np.abs(np.delete(found.q, 20, axis=0)[5:] - [0.3, 0.2]).max() < 0.1
    assert found.details["surprise"][20] > 10
