"""What every estimator promises: one suite for all of them."""

import math

import pytest
import torch

from repro.errors import InputError
from repro.estimation.base import track
from repro.estimation.gradient_descent import GradientDescent
from repro.estimation.levenberg_marquardt import LevenbergMarquardt
from repro.sensing.magnetic import MagneticSensing, readings
from repro.sensing.magnets import ring
from repro.sensing.multipole import MultipoleField
from repro.simulation.robots import pcc_robot
from repro.simulation.trajectories import lemniscate

ROBOT = pcc_robot(1)
SENSING = MagneticSensing(ROBOT, MultipoleField.of(ring("released")))
Q = lemniscate(1)[:6]
U = readings(ROBOT, Q, ring("released"))
LOW, HIGH = torch.tensor([-0.021, -0.021, 0.0]).double(), torch.tensor([0.021, 0.021, 0.0066]).double()
ESTIMATORS = {
    "gradient descent": GradientDescent(SENSING, torch.full((3,), 3.5e-4)),
    "gradient descent, momentum reset": GradientDescent(
        SENSING, torch.full((3,), 3.5e-4), carry_momentum=False
    ),
    "Levenberg-Marquardt": LevenbergMarquardt(SENSING, LOW, HIGH, noise_mt=1e-3),
}


@pytest.fixture(params=ESTIMATORS.values(), ids=ESTIMATORS)
def estimator(request):
    return request.param


def flatten(state):
    return [x for x in vars(state).values() if isinstance(x, torch.Tensor)]


def test_step_leaves_the_state_and_the_readings_alone(estimator):
    state = estimator.init(Q[0], seed=0)
    before, u = [x.clone() for x in flatten(state)], U[1].clone()
    estimator.step(state, u, 0.0)
    assert all(torch.equal(a, b) for a, b in zip(before, flatten(state), strict=True))
    assert torch.equal(u, U[1])


def test_same_seed_same_bits(estimator):
    first, second = (track(estimator, U, Q[0], seed=3) for _ in range(2))
    assert torch.equal(first.q, second.q)
    assert torch.equal(first.u_hat, second.u_hat)


def test_tracks_the_lemniscate(estimator):
    estimate = track(estimator, U, Q[0])
    assert float((estimate.q - Q).abs().max()) < 2e-4


def test_prediction_belongs_to_the_estimate(estimator):
    estimate = track(estimator, U, Q[0])
    torch.testing.assert_close(estimate.u_hat, SENSING(estimate.q))


def test_batch_equals_loop(estimator):
    """Also for a batch of two dimensions, and with different masks for its members."""
    noise = 1e-3 * torch.randn(6, 2, 2, 3, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    u = U[:, None, None] + noise
    u[2, 1, 0, 1] = math.nan
    batched = track(estimator, u, Q[0].expand(2, 2, 3))
    assert batched.q.shape == (6, 2, 2, 3)
    for i in range(2):
        for j in range(2):
            alone = track(estimator, u[:, i, j], Q[0])
            torch.testing.assert_close(batched.q[:, i, j], alone.q, atol=1e-9, rtol=0)


def test_a_reading_that_is_nan_is_a_masked_sensor_and_is_counted(estimator):
    mask = torch.ones(6, 3, dtype=torch.bool)
    mask[3, 1] = False
    u = U.clone()
    u[3, 1] = math.nan
    by_mask, by_nan = track(estimator, U, Q[0], mask=mask), track(estimator, u, Q[0])
    assert torch.equal(by_mask.q, by_nan.q)
    assert by_nan.diagnostics["masked"].tolist() == [0, 0, 0, 1, 0, 0]


def test_masked_readings_have_no_effect(estimator):
    mask = torch.tensor([True, True, False]).expand(6, 3)
    u = U.clone()
    u[:, 2] = 1e6
    assert torch.equal(track(estimator, U, Q[0], mask=mask).q, track(estimator, u, Q[0], mask=mask).q)


def test_known_coordinates_are_held(estimator):
    known = torch.full((6, 3), math.nan, dtype=torch.float64)
    known[:, 2] = Q[:, 2]
    estimate = track(estimator, U, Q[0], known=known)
    assert torch.equal(estimate.q[:, 2], Q[:, 2])
    if estimate.covariance is not None:
        assert (estimate.covariance[:, 2] == 0).all()


def test_precision_of_the_caller_is_kept(estimator):
    state, estimate = estimator.step(estimator.init(Q[0].float(), seed=0), U[0].float(), 0.0)
    assert estimate.q.dtype == state.q.dtype == torch.float32


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (
            lambda e: e.step(e.init(Q[0], seed=0), torch.full((3,), math.nan).double(), 0.0),
            "Input u of .* at least one",
        ),
        (
            lambda e: e.step(e.init(Q[0], seed=0), U[0], 0.0, mask=torch.zeros(3, dtype=torch.bool)),
            "Input u of .* must be at least one reading that is a number and not masked; instead received none.",
        ),
        (
            lambda e: e.step(e.init(Q[0], seed=0), torch.full((3,), math.inf).double(), 0.0),
            "infinite readings",
        ),
        (
            lambda e: e.step(e.init(Q[0], seed=0), U[0], 0.0, mask=torch.ones(4, dtype=torch.bool)),
            "each of 3 sensors",
        ),
        (lambda e: e.step(e.init(Q[0], seed=0), U[0], 0.0, mask=torch.ones(3)), "Input mask of .* boolean"),
        (lambda e: e.init(torch.full((3,), math.nan), seed=0), "Input q0 of .* must be finite"),
        (lambda e: e.init(torch.zeros(2), seed=0), r"Input q0 of .* of last dimension 3; .* \(2,\)"),
        (lambda e: track(e, U[:0], Q[0]), "Input readings of track must be at least one time step"),
    ],
)
def test_bad_input(estimator, call, message):
    with pytest.raises(InputError, match=message):
        call(estimator)
