"""Our filter for the rig of Table 2: its map against SciPy, its weights against Bayes, and what it does when lost."""

import numpy as np
import pytest
from scipy.interpolate import RBFInterpolator
from scipy.stats import norm

from repro import KalmanFilter
from repro_companion.papers import bend_filter, rig
from repro_companion.papers.bend_filter import BendFilter, ThinPlates, weighed_step


def readings(bend):
    """Three sensors, of which the first cannot tell a bend along x from its mirror image."""
    x, y = bend[..., 0], bend[..., 1]
    return np.stack([1.5 * x**2, 6 * y, 4 * x + 3 * y], axis=-1)


@pytest.fixture(scope="module")
def train():
    """A spiral that covers a disc of 8 mm, at 40 Hz, with noise of 0.1 mV."""
    t = np.arange(6000) / rig.RATE_HZ
    radius = 8 * np.abs(np.sin(0.3 * t))
    bend = np.column_stack([radius * np.cos(0.11 * t), radius * np.sin(0.11 * t)])
    u = readings(bend) + 0.1 * np.random.default_rng(0).standard_normal((len(t), 3))
    return rig.Recording("T5", 1e-3 * np.column_stack([bend, 0 * t]), u)


def test_plates_are_those_of_scipy():
    """One frame ten times in each cell: the mean of a cell is that frame."""
    rng = np.random.default_rng(1)
    corners = np.stack(np.meshgrid(np.arange(6), np.arange(5)), axis=-1).reshape(-1, 2)
    bend = bend_filter.CELL_MM * (corners + rng.random(corners.shape))
    u = rng.normal(size=(len(bend), 3))
    plates = ThinPlates(np.repeat(bend, 10, axis=0), np.repeat(u, 10, axis=0))
    smoothing = bend_filter.SMOOTHING
    oracle = RBFInterpolator(bend, u, kernel="thin_plate_spline", smoothing=smoothing, degree=1)
    at = rng.uniform(-2, 9, (40, 2))
    found, slopes = plates.linearise(at)
    np.testing.assert_allclose(found, oracle(at), atol=1e-6)
    for k, step in enumerate(1e-5 * np.eye(2)):
        np.testing.assert_allclose(slopes[..., k], (oracle(at + step) - oracle(at - step)) / 2e-5, atol=1e-4)


def test_cells_with_few_frames_do_not_count():
    bend = np.repeat(
        bend_filter.CELL_MM * np.array([[0.5, 0.5], [1.5, 0.5], [0.5, 1.5], [7.5, 7.5]]), 10, axis=0
    )
    assert len(ThinPlates(bend[:-1], bend[:-1]).centres) == 3


def test_filters_are_weighed_as_bayes_says():
    """One step of a linear model: the weights are prior times density of the reading, the means are exact."""
    root, u, c = 3**0.5, 0.8, np.array([-1.0, 0.0, 2.0])
    kalman = KalmanFilter(lambda q: q, [-root], [root], noise=0.5, acceleration=[1.0], velocity=[1.0])
    log_prior, state = -0.5 * c**2, kalman.init(np.zeros((3, 1)))
    _, log_weight, q, C = weighed_step(kalman, state, log_prior, (u - c)[:, None], 0.0)
    weight = np.exp(log_prior) * norm.pdf(u - c, 0.0, np.sqrt(1 + 0.25))
    np.testing.assert_allclose(
        np.exp(log_weight) / np.exp(log_weight).sum(), weight / weight.sum(), rtol=1e-6
    )
    np.testing.assert_allclose(q[:, 0], (u - c) / 1.25, rtol=1e-6)
    np.testing.assert_allclose(C[:, 0, 0], 0.2, rtol=1e-6)


def test_the_filter_expects_the_speed_and_the_changes_of_its_training():
    """Along a circle of 8 mm each axis is a sine; its speed changes by 0.5 s times its acceleration in 0.5 s."""
    t, rate = np.arange(4000) / rig.RATE_HZ, 2 * np.pi / 20
    bend = 8 * np.column_stack([np.cos(rate * t), np.sin(rate * t)])
    kalman = BendFilter(rig.Recording("T5", 1e-3 * np.column_stack([bend, 0 * t]), readings(bend))).kalman
    speed_and_change = [[8 / 2**0.5 * rate] * 2, [0.5**0.5 * 8 / 2**0.5 * rate**2] * 2]
    np.testing.assert_allclose([kalman.velocity, kalman.acceleration], speed_and_change, rtol=0.02)


def motion(frames):
    t = np.arange(frames) / rig.RATE_HZ
    return np.column_stack([5 + np.cos(t), 2 * np.sin(t)])


def test_a_shared_bias_is_told_from_the_bend(train):
    truth = motion(80)
    found = BendFilter(train).follow((readings(truth) + 6.0)[:, None])
    off = found.mean[20:, 0] - truth[20:]
    assert np.linalg.norm(off, axis=1).max() < 0.3
    assert not found.doubtful.any()
    square = np.einsum("ti,tij,tj->t", off, np.linalg.inv(found.covariance[20:, 0]), off)
    assert square.max() < 16  # four deviations


def test_lost_filters_begin_anew_and_nothing_changes_before(train):
    truth = motion(80)
    u = readings(truth)
    u[:3] = readings(truth[:3] * [-1, 1])  # of the mirror image
    found, kept = (BendFilter(train, restarts=again).follow(u[:, None]) for again in (True, False))
    first = int(np.argmax((found.mean != kept.mean).any(axis=(1, 2))))
    assert found.begun.tolist() == [1]
    assert first >= bend_filter.LASTING
    assert np.linalg.norm(found.mean[first:, 0] - truth[first:], axis=1).max() < 0.5
    assert np.linalg.norm(kept.mean[first:, 0] - truth[first:], axis=1).min() > 5
    assert kept.doubtful[first + 1 :].all()


def test_what_no_start_explains_is_flagged_and_the_filters_go_on(train):
    """A reading that no bend has from the twentieth frame on, and beside it a trajectory without."""
    u = np.stack([readings(motion(60))] * 2, axis=1)
    u[20:, 0, 0] -= 300.0
    found = BendFilter(train).follow(u)
    assert found.doubtful[45:, 0].all()
    assert not found.doubtful[:, 1].any()
    assert found.begun.tolist() == [0, 0]


def test_own_biases_take_what_sensors_do_not_share(train):
    truth = motion(80)
    u = (readings(truth) + np.array([0.5, 0.5, -0.5]))[:, None]
    shared, own = (
        np.abs(BendFilter(train, own_biases=own).follow(u).mean[40:, 0] - truth[40:]).mean(axis=0)
        for own in (False, True)
    )
    assert (own < 0.95 * shared).all()
