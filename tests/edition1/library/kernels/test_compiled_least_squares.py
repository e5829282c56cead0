"""Levenberg-Marquardt compiled against torch: bounds, masks, covariance, undetermined directions."""

import math

import pytest
import torch

from edition1.errors import InputError
from edition1.estimation.base import track
from edition1.estimation.levenberg_marquardt import LevenbergMarquardt
from edition1.kernels import compiled
from edition1.kinematics.paper_robots import affine_robot, pcc_robot
from edition1.sensing.ensemble import SeedEnsemble
from edition1.sensing.linearised import LinearisedSensing
from edition1.sensing.magnetic import MagneticSensing, readings
from edition1.sensing.magnets import ring
from edition1.sensing.multipole import MultipoleField
from edition1.sensing.network import CosineNetwork
from edition1_companion.twins.trajectories import flower, lemniscate

MOMENTS = torch.from_numpy(ring("released").multipoles(9))
NOISE = 7.1e-4


def noisy(u, seed=0):
    return u + NOISE * torch.randn(u.shape, generator=torch.Generator().manual_seed(seed), dtype=u.dtype)


def box(n):
    bend = 22e-3 * math.radians(54)
    return tuple(
        torch.tensor(side * n, dtype=torch.float64) for side in ([-bend, -bend, 0.0], [bend, bend, 6.6e-3])
    )


def start(n):
    return torch.tensor([0.0, 0.0, 2.75e-3] * n, dtype=torch.float64)


def both(sensing, bounds, u, q0, *, iterations=10, **inputs):
    """One time step by torch and by the kernel."""
    estimates = []
    for model in (sensing, compiled(sensing)):
        method = LevenbergMarquardt(model, *bounds, noise_mt=NOISE, iterations=iterations)
        estimates.append(method.step(method.init(q0), u, 0.0, **inputs)[1])
    return estimates


def assert_equal(one, other, *, converged=True):
    """To rounding; a minimum is known only to the root of rounding, where steps no longer lower the error."""
    if converged:
        deviation = one.covariance.diagonal(dim1=-2, dim2=-1).sqrt()
        assert bool(((other.q - one.q).abs() <= 1e-3 * deviation).all())
    else:
        torch.testing.assert_close(other.q, one.q, atol=1e-10, rtol=1e-10)
        torch.testing.assert_close(other.u_hat, one.u_hat, atol=1e-9, rtol=1e-9)
        assert torch.equal(one.diagnostics["iterations"], other.diagnostics["iterations"])
    torch.testing.assert_close(other.u_hat, one.u_hat, atol=1e-3 * NOISE, rtol=0)
    torch.testing.assert_close(other.covariance, one.covariance, rtol=1e-4, atol=1e-16)
    torch.testing.assert_close(other.diagnostics["rmse"], one.diagnostics["rmse"], atol=1e-12, rtol=1e-8)
    for name in ("at_bound", "masked"):
        assert torch.equal(other.diagnostics[name], one.diagnostics[name])


@pytest.mark.parametrize("iterations", [1, 3, 10])
@pytest.mark.parametrize("n", [1, 2, 3])
def test_cold_starts(n, iterations):
    robot, q = pcc_robot(n, tilt=0.1), lemniscate(n)[::20]
    sensing = LinearisedSensing(robot, MOMENTS, earth_mt=torch.tensor([0.03, -0.05, 0.02]).double())
    u = noisy(sensing(q))
    one, other = both(sensing, box(n), u, start(n).expand_as(q), iterations=iterations)
    assert_equal(one, other, converged=iterations > 3)


def test_start_exactly_straight_and_a_converged_start():
    sensing, q = LinearisedSensing(pcc_robot(3), MOMENTS), lemniscate(3)[::100]
    assert_equal(*both(sensing, box(3), sensing(q), torch.zeros_like(q)))
    assert_equal(*both(sensing, box(3), sensing(q), q))


def test_estimates_on_the_bounds():
    """A box that leaves out most of the trajectory: many coordinates end on its faces."""
    sensing, q = LinearisedSensing(pcc_robot(2), MOMENTS), lemniscate(2)[::10]
    low, high = (0.4 * x for x in box(2))
    one, other = both(sensing, (low, high), noisy(sensing(q)), ((low + high) / 2).expand_as(q), iterations=30)
    assert_equal(one, other)
    assert 5 < int(other.diagnostics["at_bound"].sum()) <= len(q)
    assert bool(((other.q >= low) & (other.q <= high)).all())


def test_masks_missing_readings_and_known_coordinates():
    sensing, q = LinearisedSensing(pcc_robot(2, 4), MOMENTS), lemniscate(2)[::40]
    u = noisy(sensing(q).expand(2, -1, -1))
    u[0, 3, 2] = math.nan
    mask = torch.ones(10, 8, dtype=torch.bool)
    mask[4:, 1] = False
    known = torch.full((2, 10, 6), math.nan).double()
    known[1, :, 2] = q[:, 2]
    one, other = both(sensing, box(2), u, start(2).expand(2, 10, -1), mask=mask, known=known)
    assert_equal(one, other)
    assert torch.equal(other.q[1, :, 2], q[:, 2])
    assert (other.covariance[1, :, 2] == 0).all()
    assert other.diagnostics["masked"].tolist() == [[0] * 3 + [1] * 7, [0] * 4 + [1] * 6]


def test_directions_without_information_have_the_same_huge_variance():
    """Two sensors per segment, three segments, in the plane of the sensors: six readings for nine coordinates."""
    sensing = LinearisedSensing(pcc_robot(3, 2), MOMENTS)
    q = start(3).expand(3, -1)
    one, other = both(sensing, box(3), sensing(q), q, iterations=1)
    torch.testing.assert_close(other.covariance, one.covariance, rtol=1e-6, atol=1e-16)
    assert float(other.covariance.diagonal(dim1=-2, dim2=-1).max().sqrt()) > 1


def test_robots_with_moments_of_their_own_along_a_trajectory():
    robot = pcc_robot(2, tilt=torch.tensor([0.0, 0.1, 0.2]).double())
    sensing = LinearisedSensing(robot, MOMENTS * torch.tensor([[0.9], [1.0], [1.1]]).double())
    q = lemniscate(2)[:10]
    u = noisy(sensing(q.unsqueeze(1)))
    found = [
        track(
            LevenbergMarquardt(model, *box(2), noise_mt=NOISE, iterations=5),
            u,
            q[0].expand(3, -1),
        )
        for model in (sensing, compiled(sensing))
    ]
    assert_equal(*found)


def test_affine_segment():
    robot, q = affine_robot(), flower()[20:380:40]
    sensing = MagneticSensing(robot, MultipoleField(MOMENTS))
    low, high = torch.tensor([-1.0, -4.0, -7.0, 0.0]).double(), torch.tensor([1.0, 4.0, 7.0, 0.0066]).double()
    q0 = q + torch.tensor([0.1, -0.3, 0.2, 0.001]).double()
    u = noisy(readings(robot, q, ring("released")))
    assert_equal(*both(sensing, (low, high), u, torch.clamp(q0, low, high), iterations=15))


def test_networks_of_several_seeds():
    """Networks near a reading of the multipole field, so that there is something to find."""
    robot, q = pcc_robot(2), lemniscate(2)[::50]
    networks = []
    for seed in range(2):
        row = [CosineNetwork(9, torch.Generator().manual_seed(10 * seed + k)) for k in range(2)]
        for network in row:
            network.spread.copy_(torch.tensor([1.0] + [0.02, 0.3, 0.3, 0.3] * 2))
        networks.append(row)
    sensing = MagneticSensing(robot, SeedEnsemble(networks, robot.sensors.segment).double())
    u = noisy(sensing(q.expand(2, -1, -1)).detach())
    one, other = both(sensing, box(2), u, start(2).expand(2, len(q), -1), iterations=8)
    assert_equal(one, other)


def test_precision_of_the_caller_is_kept_and_bounds_hold_in_it():
    sensing = compiled(LinearisedSensing(pcc_robot(1), MOMENTS))
    low, high = (0.3 * x for x in box(1))
    method = LevenbergMarquardt(sensing, low, high)
    u = sensing(lemniscate(1)[::10]).float()
    state, estimate = method.step(method.init(torch.zeros(len(u), 3)), u, 0.0)
    assert estimate.q.dtype == estimate.covariance.dtype == estimate.u_hat.dtype == torch.float32
    method.init(state.q)  # refuses what is outside
    assert bool(estimate.diagnostics["at_bound"].any())


@pytest.mark.parametrize(
    ("act", "message"),
    [
        (
            lambda s: compiled(lambda q: q),
            "Input sensing of compiled must be LinearisedSensing, or MagneticSensing with .* received function",
        ),
        (
            lambda s: LevenbergMarquardt(compiled(s), *box(1)).step(
                LevenbergMarquardt(s, *box(1)).init(start(1)), torch.ones(2).double(), 0.0
            ),
            r"Input u of LevenbergMarquardt must be of last dimension 3; instead received shape \(2,\)",
        ),
    ],
)
def test_bad_input(act, message):
    with pytest.raises(InputError, match=message):
        act(LinearisedSensing(pcc_robot(1), MOMENTS))
