"""The filter against the textbook on linear models; calibration of its covariance; time, bounds, masks."""

import math

import numpy as np
import pytest
import torch
from torch import Tensor

from edition1.errors import InputError
from edition1.estimation.base import track
from edition1.estimation.kalman_filter import IteratedKalmanFilter
from edition1.estimation.levenberg_marquardt import LevenbergMarquardt
from edition1.kernels import compiled
from edition1.kinematics.paper_robots import pcc_robot
from edition1.sensing.linearised import LinearisedSensing
from edition1.sensing.magnetic import readings
from edition1.sensing.magnets import ring
from edition1_companion.twins.trajectories import lemniscate

H = torch.tensor([[1.0, 0.5], [0.0, 1.0], [-1.0, 0.3]], dtype=torch.float64)
FAR = torch.full((2,), 50.0, dtype=torch.float64)
A, V = torch.tensor([0.8, 0.3], dtype=torch.float64), torch.tensor([1.0, 2.0], dtype=torch.float64)
SIGMA, RATE = 0.2, 10.0


def linear(q: Tensor) -> Tensor:
    return q @ H.to(q).T


def linear_filter(**options):
    return IteratedKalmanFilter(
        linear, -FAR, FAR, **({"acceleration": A, "velocity": V} | options), noise_mt=SIGMA
    )


def simulated(steps, runs, seed=0):
    """Motions of the process itself, and their readings: ``[t, runs, ...]``."""
    rng = np.random.default_rng(seed)
    tau = 1 / RATE
    Q = np.array([[tau**3 / 3, tau**2 / 2], [tau**2 / 2, tau]])
    root = np.linalg.cholesky(Q)
    width = 2 * FAR.numpy() / 12**0.5
    q, v = rng.standard_normal((runs, 2)) * width * 0.1, rng.standard_normal((runs, 2)) * V.numpy()
    motion = []
    for k in range(steps):
        if k:
            kick = rng.standard_normal((runs, 2, 2)) @ root.T * A.numpy()[:, None]
            q, v = q + tau * v + kick[..., 0], v + kick[..., 1]
        motion.append(q)
    q = torch.from_numpy(np.stack(motion))
    return q, linear(q) + SIGMA * torch.from_numpy(rng.standard_normal((steps, runs, 3)))


def textbook(u):
    """Kalman filter in covariance form with the gain, written out; the same prior."""
    tau, n = 1 / RATE, 2
    x = np.zeros(4)
    P = np.diag(np.concatenate([(2 * FAR.numpy()) ** 2 / 12, V.numpy() ** 2]))
    F = np.block([[np.eye(n), tau * np.eye(n)], [np.zeros((n, n)), np.eye(n)]])
    a2 = np.diag(A.numpy() ** 2)
    Q = np.block([[tau**3 / 3 * a2, tau**2 / 2 * a2], [tau**2 / 2 * a2, tau * a2]])
    M = np.hstack([H.numpy(), np.zeros((3, n))])
    means, covariances = [], []
    for k, y in enumerate(u.numpy()):
        if k:
            x, P = F @ x, F @ P @ F.T + Q
        seen = ~np.isnan(y)
        S = M[seen] @ P @ M[seen].T + SIGMA**2 * np.eye(seen.sum())
        K = P @ M[seen].T @ np.linalg.inv(S)
        x, P = x + K @ (y[seen] - M[seen] @ x), (np.eye(4) - K @ M[seen]) @ P
        means.append(x[:n])
        covariances.append(P[:n, :n])
    return np.stack(means), np.stack(covariances)


@pytest.mark.parametrize("missing", [False, True])
def test_equals_the_kalman_filter_on_a_linear_model(missing):
    _, u = simulated(30, 1)
    u = u[:, 0]
    if missing:
        u[5:9, 0] = torch.nan
        u[7] = torch.tensor([torch.nan, 0.1, torch.nan])
    found = track(linear_filter(), u, torch.zeros(2, dtype=torch.float64), rate_hz=RATE)
    mean, covariance = textbook(u)
    np.testing.assert_allclose(found.q, mean, atol=1e-8)
    np.testing.assert_allclose(found.covariance, covariance, atol=1e-9)


def test_covariance_is_calibrated():
    """The mean normalised squared error of 400 motions lies within its 99.9 % band at every time."""
    q, u = simulated(25, 400)
    found = track(linear_filter(), u, torch.zeros(400, 2, dtype=torch.float64), rate_hz=RATE)
    error = (found.q - q).unsqueeze(-1)
    nees = (error.mT @ torch.linalg.solve(found.covariance, error)).squeeze((-1, -2)).mean(1)
    assert float((nees[5:] / 2 - 1).abs().max()) < 3.3 * (1 / 400) ** 0.5  # variance of chi2(2)/2 is 1


def test_prediction_halves_the_error_of_single_time_steps():
    """A slow lemniscate with much noise; the process noise is that of its accelerations, not fitted."""
    robot, q = pcc_robot(1), lemniscate(1, half=True)[:120]
    sensing = compiled(LinearisedSensing(robot, torch.from_numpy(ring("released").multipoles(9))))
    g = torch.Generator().manual_seed(0)
    clean = readings(robot, q, ring("released"))
    u = clean + 0.005 * torch.randn(clean.shape, generator=g, dtype=torch.float64)
    low = torch.tensor([-0.021, -0.021, 0.0], dtype=torch.float64)
    high = torch.tensor([0.021, 0.021, 0.0066], dtype=torch.float64)
    a = torch.tensor([0.01, 0.003, 0.002], dtype=torch.float64)
    method = IteratedKalmanFilter(sensing, low, high, a, torch.full_like(a, 0.02), noise_mt=0.005)
    start = torch.tensor([0.0, 0.0, 2.75e-3], dtype=torch.float64)
    filtered = track(method, u, start)
    alone = LevenbergMarquardt(sensing, low, high, noise_mt=0.005)
    single = alone.step(alone.init(start.expand(120, 3)), u, 0.0)[1]
    rmse = [(x - q)[20:].square().mean(0).sqrt() for x in (filtered.q, single.q)]
    assert bool((rmse[0] < 0.75 * rmse[1]).all())
    assert bool((filtered.q >= low).all() & (filtered.q <= high).all())


def test_covariance_stays_symmetric_over_many_steps():
    g = torch.Generator().manual_seed(0)
    M = torch.randn(8, 6, generator=g, dtype=torch.float64) * torch.logspace(0, 3, 6, dtype=torch.float64)
    one = torch.ones(6, dtype=torch.float64)
    method = IteratedKalmanFilter(lambda q: q @ M.T, -one, one, 0.1 * one, one, noise_mt=1e-3)
    state = method.init(0 * one)
    for k in range(100):
        u = 1e-3 * torch.randn(8, generator=g, dtype=torch.float64)
        state, _ = method.step(state, u, k / 40)
    assert torch.equal(state.covariance, state.covariance.mT)
    assert bool((torch.linalg.eigvalsh(state.covariance) > 0).all())


def test_known_coordinates_are_held():
    _, u = simulated(3, 1)
    held = torch.tensor([0.7, torch.nan], dtype=torch.float64)
    method = linear_filter()
    _, estimate = method.step(method.init(torch.zeros(2, dtype=torch.float64)), u[0, 0], 0.0, known=held)
    assert float(estimate.q[0]) == pytest.approx(0.7)
    assert float(estimate.covariance[0, 0]) == pytest.approx(0.0)
    assert float(estimate.covariance[1, 1]) > 0


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (
            {"acceleration": 0 * A},
            "Input acceleration of IteratedKalmanFilter must be positive, one for each of 2",
        ),
        (
            {"velocity": -V},
            "Input velocity of IteratedKalmanFilter must be positive, one for each of 2 coord",
        ),
    ],
)
def test_bad_parameters(options, message):
    with pytest.raises(InputError, match=message):
        linear_filter(**options)


def test_time_must_go_on():
    method, u = linear_filter(), torch.zeros(3, dtype=torch.float64)
    state, _ = method.step(method.init(torch.zeros(2, dtype=torch.float64)), u, 1.0)
    with pytest.raises(
        InputError, match="Input t of IteratedKalmanFilter must be after the last step, 1.0 s"
    ):
        method.step(state, u, 1.0)


@pytest.mark.parametrize("n_segments", [1, 2])
def test_compiled_update_is_that_of_torch(n_segments):
    """Masked and missing readings, a held coordinate, bounds that are reached, and a batch."""
    robot, n_q = pcc_robot(n_segments, 4), 3 * n_segments
    sensing = LinearisedSensing(robot, torch.from_numpy(ring("released").multipoles(9)))
    q = lemniscate(n_segments)[:12]
    g = torch.Generator().manual_seed(0)
    u = sensing(q).unsqueeze(1) + 0.02 * torch.randn(12, 3, 4 * n_segments, generator=g, dtype=torch.float64)
    u[4, 1, 2] = math.nan
    mask = torch.ones(12, 1, 4 * n_segments, dtype=torch.bool)
    mask[6:, :, 1] = False
    known = torch.full((12, 3, n_q), math.nan).double()
    known[:, 2, 0] = q[:, 0]
    low, high = -0.02 * torch.ones(n_q).double(), 0.02 * torch.ones(n_q).double()
    low[2], high[2] = 2.9e-3, 3.1e-3
    a = 0.02 * torch.ones(n_q).double()
    one, other = (
        track(
            IteratedKalmanFilter(model, low, high, a, a, noise_mt=0.02),
            u,
            torch.tensor([0.0, 0.0, 3e-3] * n_segments).double().expand(3, -1),
            mask=mask,
            known=known,
        )
        for model in (sensing, compiled(sensing))
    )
    # Next to the minimum rounding decides which trials are taken: a nanometre, where the noise is worth millimetres.
    torch.testing.assert_close(other.q, one.q, atol=1e-9, rtol=0)
    torch.testing.assert_close(other.covariance, one.covariance, atol=1e-13, rtol=1e-6)
    torch.testing.assert_close(other.u_hat, one.u_hat, atol=1e-8, rtol=0)
    assert torch.equal(other.diagnostics["at_bound"], one.diagnostics["at_bound"])
    assert bool(one.diagnostics["at_bound"].any())
