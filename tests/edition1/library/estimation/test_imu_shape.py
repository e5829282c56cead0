"""The estimator of positions: its covariance against Monte Carlo, and IMUs that are missing."""

import math

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation
from smooth_curves import read, smooth_curves

from edition1.errors import InputError
from edition1.estimation.base import Estimator, track
from edition1.estimation.imu_models import exact_arcs, pcc_extended, rigid_links, tangent_spline
from edition1.estimation.imu_shape import ImuShape
from edition1_companion.recordings.martin2022_models import selection

MARKERS = (0.36, 0.6)
NOISE = math.radians(1.0)
ORIGIN = torch.zeros(6, dtype=torch.float64)


def readings(arm, count=5):
    frames, points, _, _ = smooth_curves(count, seed=5)
    return read(frames, arm), points[:, [720, 1200]]


def noisy(q, rng, rows=slice(None), size=NOISE):
    turns = np.zeros((*q.shape[:-1], 3))
    turns[:, rows] = size * rng.normal(size=turns[:, rows].shape)
    turned = Rotation.from_rotvec(turns.reshape(-1, 3)) * Rotation.from_quat(q.reshape(-1, 4))
    return turned.as_quat().reshape(q.shape)


def flat(q):
    return torch.from_numpy(q.reshape(len(q), -1))


@pytest.mark.parametrize(
    ("model", "kind"), [(rigid_links, "rigid"), (pcc_extended, "pcc"), (tangent_spline, "pcc")]
)
def test_positions_are_those_of_the_model(model, kind):
    arm = selection(kind, 8)
    q, points = readings(arm)
    estimator = ImuShape(model, arm, MARKERS, NOISE)
    assert isinstance(estimator, Estimator)
    estimate = track(estimator, flat(q), ORIGIN)
    np.testing.assert_array_equal(estimate.q, model(q, arm, MARKERS).reshape(5, 6))
    assert np.linalg.norm(estimate.q.numpy().reshape(5, 2, 3) - points, axis=-1).max() < (
        0.09 if kind == "rigid" else 0.01
    )


@pytest.mark.parametrize(
    ("model", "kind"), [(rigid_links, "rigid"), (exact_arcs, "pcc"), (tangent_spline, "pcc")]
)
def test_covariance_is_what_noisy_sensors_scatter(model, kind):
    arm = selection(kind, 8)
    q = readings(arm, 1)[0]
    _, estimate = (e := ImuShape(model, arm, MARKERS, NOISE)).step(e.init(ORIGIN), flat(q)[0], 0.0)
    sensors = slice(1, None) if kind == "pcc" else slice(None)  # the base is exact
    scattered = noisy(np.repeat(q, 20000, axis=0), np.random.default_rng(0), sensors)
    scatter = np.cov(model(scattered, arm, MARKERS).reshape(-1, 6).T)
    largest = np.sqrt(np.outer(np.diag(scatter), np.diag(scatter)))
    np.testing.assert_allclose(estimate.covariance.numpy() / largest, scatter / largest, atol=0.04)


@pytest.mark.parametrize("missing", [[3], [4, 5], [8], [0], [1, 2, 8]])
def test_covariance_with_missing_imus_is_that_of_a_random_walk(missing):
    """True orientations drawn as a random walk around the filled ones, pinned at the IMUs that are there."""
    arm, rough = selection("pcc", 8), 0.05
    q = readings(arm, 1)[0]
    gaps = q.copy()
    gaps[:, missing] = np.nan
    estimator = ImuShape(exact_arcs, arm, MARKERS, 1e-9, roughness=rough)
    _, estimate = estimator.step(estimator.init(ORIGIN), flat(gaps)[0], 0.0)
    there = np.setdiff1d(np.arange(9), missing)
    arcs = np.array(arm.arcs)
    # A walk from a free start, conditioned on no turn at the IMUs that are there.
    walk = rough**2 * (np.minimum.outer(arcs, arcs) + 1e3)
    inverse = np.linalg.pinv(walk[np.ix_(there, there)], hermitian=True)
    pinned = walk - walk[:, there] @ inverse @ walk[there]
    pinned = pinned[np.ix_(missing, missing)]
    root = np.linalg.cholesky(pinned + 1e-12 * np.eye(len(missing)))
    turns = np.zeros((20000, 9, 3))
    turns[:, missing] = np.einsum(
        "ij,njk->nik", root, np.random.default_rng(1).normal(size=(20000, len(missing), 3))
    )
    used = estimate.u_hat.numpy().reshape(9, 4)
    true = Rotation.from_rotvec(turns.reshape(-1, 3)) * Rotation.from_quat(np.tile(used, (20000, 1)))
    scatter = np.cov(exact_arcs(true.as_quat().reshape(-1, 9, 4), arm, MARKERS).reshape(-1, 6).T)
    largest = np.sqrt(np.outer(np.diag(scatter), np.diag(scatter))) + 1e-12
    np.testing.assert_allclose(estimate.covariance.numpy() / largest, scatter / largest, atol=0.05)


def test_a_missing_imu_is_filled_reported_and_makes_the_estimate_less_certain():
    arm = selection("pcc", 8)
    q, points = readings(arm, 40)
    gaps = q.copy()
    gaps[:, 5] = np.nan
    estimator = ImuShape(tangent_spline, arm, MARKERS, NOISE)
    state = estimator.init(ORIGIN.expand(40, 6))
    whole, found = (estimator.step(state, flat(x), 0.0)[1] for x in (q, gaps))
    assert found.diagnostics["masked"].tolist() == [1] * 40
    assert found.diagnostics["missing"].nonzero()[:, 1].tolist() == [5] * 40
    assert not whole.diagnostics["missing"].any()
    more, less = (t.covariance.diagonal(dim1=-2, dim2=-1).sum(-1) for t in (found, whole))
    assert (more > 1.5 * less).all()
    errors = found.q.numpy().reshape(-1, 2, 3) - points
    normalised = np.einsum(
        "ni,nij,nj->n", errors.reshape(-1, 6), np.linalg.inv(found.covariance), errors.reshape(-1, 6)
    )
    assert np.median(normalised) < 12.6  # 95 % of a chi-squared with six degrees of freedom


def test_known_coordinates_correct_the_others_as_the_covariance_says():
    """M1 known: M2 as by conditioning samples, and nearer to the truth."""
    arm = selection("pcc", 8)
    q, points = readings(arm, 100)
    tilted = noisy(q, np.random.default_rng(2), slice(1, None), math.radians(3.0))
    truth = torch.from_numpy(points.reshape(-1, 6))
    known = truth.clone()
    known[:, 3:] = math.nan
    estimator = ImuShape(tangent_spline, arm, MARKERS, math.radians(3.0))
    state = estimator.init(ORIGIN.expand(100, 6))
    free, held = (
        estimator.step(state, flat(tilted), 0.0)[1],
        estimator.step(state, flat(tilted), 0.0, known=known)[1],
    )
    assert torch.equal(held.q[:, :3], truth[:, :3])
    before, after = ((e.q - truth)[:, 3:].norm(dim=-1).median() for e in (free, held))
    assert float(after) < 0.7 * float(before)
    C = free.covariance
    expected = C[:, 3:, 3:] - C[:, 3:, :3] @ torch.linalg.solve(C[:, :3, :3], C[:, :3, 3:])
    torch.testing.assert_close(held.covariance[:, 3:, 3:], expected, rtol=1e-6, atol=1e-12)
    assert (held.covariance[:, :3] == 0).all()
    inside = (held.q - truth)[:, 3:].unsqueeze(1) @ torch.linalg.solve(
        expected, (held.q - truth)[:, 3:].unsqueeze(-1)
    )
    assert 1.5 < float(inside.median()) < 4.0  # 2.37 for a chi-squared with three degrees of freedom


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (
            {"arc_lengths": ()},
            r"Input arc_lengths of ImuShape must be at least one point; instead received \(\)",
        ),
        ({"noise_rad": 0.0}, r"Input noise_rad of ImuShape must be positive \[rad\]; instead received 0\.0"),
        ({"noise_rad": math.nan}, "noise_rad of ImuShape must be positive"),
        (
            {"roughness": -1.0},
            r"roughness of ImuShape must be positive \[rad/sqrt\(m\)\]; instead received -1\.0",
        ),
    ],
)
def test_bad_settings(change, message):
    settings = {"arc_lengths": MARKERS, "noise_rad": NOISE} | change
    with pytest.raises(InputError, match=message):
        ImuShape(exact_arcs, selection("pcc", 8), **settings)


def test_bad_readings():
    arm = selection("pcc", 2)
    estimator = ImuShape(exact_arcs, arm, (0.6,), NOISE)
    state, u = estimator.init(torch.zeros(3).double()), flat(readings(arm, 1)[0])[0]
    with pytest.raises(
        InputError, match=r"Input u of ImuShape must be of last dimension 12; .* shape \(8,\)"
    ):
        estimator.step(state, u[:8], 0.0)
    with pytest.raises(InputError, match="orientations of filled must be finite unit quaternions"):
        estimator.step(state, 1.1 * u, 0.0)
    u[[0, 5, 10]] = math.nan  # no IMU is whole
    message = (
        "Input u of ImuShape must be at least one IMU that is whole and not masked; instead received none."
    )
    with pytest.raises(InputError, match=message):
        estimator.step(state, u, 0.0)
