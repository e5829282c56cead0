"""Particle filter against an exact Kalman filter, and where it must not break: underflow, bounds, lost tracks.

| law | reference |
| --- | --- |
| mean and covariance, linear and Gaussian | Kalman filter |
| covariance over a long track | chi-square of the normalised squared error |
| one Gauss-Newton step on a linear model | least squares |
| surprise while the cloud follows | standard normal |
"""

import math

import numpy as np
import pytest
import torch

from edition1.errors import InputError
from edition1.estimation._particle_cloud import best_tenth
from edition1.estimation.base import Estimator, track
from edition1.estimation.particle_filter import ParticleFilter
from edition1.estimation.regions import Box, Disc
from edition1.kinematics.paper_robots import pcc_robot
from edition1.sensing.bend_sensor import BendSensor
from edition1.sensing.magnetic import MagneticSensing, readings
from edition1.sensing.magnets import ring
from edition1.sensing.multipole import MultipoleField
from edition1_companion.twins.bend_curves import bend_curve, bend_readings
from edition1_companion.twins.trajectories import lemniscate

H = torch.tensor([[1.0, 0.3], [-0.4, 0.8], [0.2, 0.2]], dtype=torch.float64)
WALK, NOISE = torch.tensor([0.5, 0.3], dtype=torch.float64), 0.4
START = torch.zeros(2, dtype=torch.float64)
SENSOR = BendSensor(15e-3)


def linear(q):
    return q @ H.T


def linear_track(steps, seed):
    """Configurations of a random walk from the start, and their readings."""
    g = torch.Generator().manual_seed(seed)
    q = (WALK * torch.randn(steps, 2, generator=g, dtype=torch.float64)).cumsum(0)
    return q, linear(q) + NOISE * torch.randn(steps, 3, generator=g, dtype=torch.float64)


def kalman(readings):
    """Means and covariances of the exact filter."""
    mean, P, means, covariances = START, torch.zeros(2, 2).double(), [], []
    for u in readings:
        P = P + torch.diag(WALK**2)
        S = H @ P @ H.T + NOISE**2 * torch.eye(3).double()
        K = P @ H.T @ torch.linalg.inv(S)
        mean, P = mean + K @ (u - H @ mean), P - K @ H @ P
        means.append(mean)
        covariances.append(P)
    return torch.stack(means), torch.stack(covariances)


def bend_filter(**options):
    defaults = {
        "sensing": SENSOR,
        "process_noise": torch.full((2,), 0.01 * math.pi, dtype=torch.float64),
        "noise_mt": 0.05,
        "region": Disc(math.pi / 2),
    }
    return ParticleFilter(**(defaults | options))


@pytest.mark.parametrize("scheme", ["multinomial", "systematic"])
def test_mean_and_covariance_are_those_of_the_kalman_filter(scheme):
    n, (_, u) = 40_000, linear_track(8, seed=1)
    means, covariances = kalman(u)
    found = track(ParticleFilter(linear, WALK, NOISE, particles=n, resampling=scheme), u, START)
    ess = found.diagnostics["effective_sample_size"].unsqueeze(-1)
    deviation = covariances.diagonal(dim1=-2, dim2=-1).sqrt()
    # Errors of resampling before the step add to those of the weights: twice the plain Monte-Carlo error, 4 sigma.
    assert bool(((found.q - means).abs() < 8 * deviation / ess.sqrt()).all())
    scale = deviation.unsqueeze(-1) * deviation.unsqueeze(-2)
    assert float(
        ((found.covariance - covariances).abs() / scale * ess.unsqueeze(-1).sqrt()).max()
    ) < 8 * math.sqrt(2)


def test_mean_has_no_bias():
    _, u = linear_track(6, seed=2)
    exact, _ = kalman(u)
    filter_ = ParticleFilter(linear, WALK, NOISE, particles=800)
    found = torch.stack([track(filter_, u, START, seed=seed).q for seed in range(60)])
    z = (found.mean(0) - exact) / (found.std(0) / math.sqrt(60))
    assert float(z.abs().max()) < 4


def test_covariance_is_calibrated():
    """The normalised squared error has the mean 2 of a chi-square; 600 steps, nearly independent."""
    q, u = linear_track(600, seed=3)
    found = track(ParticleFilter(linear, WALK, NOISE, particles=1000), u, START)
    error = (found.q - q).unsqueeze(-1)
    nees = (error.mT @ torch.linalg.solve(found.covariance, error)).flatten()
    assert float(nees.mean()) == pytest.approx(2, abs=4 * 2 / math.sqrt(600))
    assert float((nees < 5.991).double().mean()) == pytest.approx(0.95, abs=0.03)


def test_surprise_is_standard_normal_while_the_cloud_follows():
    _, u = linear_track(600, seed=4)
    found = track(ParticleFilter(linear, WALK, NOISE, particles=1000), u, START)
    surprise = found.diagnostics["surprise"]
    assert float(surprise.mean()) == pytest.approx(0, abs=0.2)
    assert float(surprise.std()) == pytest.approx(1, abs=0.12)
    assert not bool(found.diagnostics["lost"].any())


def test_gauss_newton_on_a_linear_model_is_least_squares():
    _, u = linear_track(5, seed=5)
    found = track(ParticleFilter(linear, WALK, NOISE, particles=100, estimate="Gauss-Newton"), u, START)
    torch.testing.assert_close(found.q, u @ torch.linalg.pinv(H).T, atol=1e-5, rtol=0)
    exact = NOISE**2 * torch.linalg.inv(H.T @ H)
    torch.testing.assert_close(found.covariance[0], exact, atol=1e-8, rtol=1e-6)


def test_constant_velocity_follows_steady_motion_without_lag():
    u = linear(torch.arange(1, 61).double().unsqueeze(-1) * torch.tensor([0.05, -0.02], dtype=torch.float64))
    lag = {}
    for motion in ("random walk", "constant velocity"):
        filter_ = ParticleFilter(linear, 0.02 * WALK, 0.05, motion=motion)
        lag[motion] = float((linear(track(filter_, u, START).q) - u)[30:].norm(dim=-1).mean())
    assert lag["constant velocity"] < 0.2 * lag["random walk"]


def test_reading_a_million_deviations_away_leaves_finite_numbers():
    far = torch.tensor([1e6, -1e6, 1e6], dtype=torch.float64)
    filter_ = ParticleFilter(linear, WALK, 1.0)
    state = filter_.init(START, seed=0)
    after, estimate = filter_.step(state, far, 0.0)
    nearest = state.q[(linear(state.q) - far).norm(dim=-1).argmin()]
    torch.testing.assert_close(estimate.q, nearest)
    assert float(estimate.diagnostics["effective_sample_size"]) == pytest.approx(1)
    assert bool(estimate.diagnostics["lost"])
    for x in (after.q, estimate.covariance, estimate.diagnostics["surprise"]):
        assert bool(torch.isfinite(x).all())


def test_particles_never_leave_the_region():
    q = torch.tensor([math.pi / 2, 0.0], dtype=torch.float64)
    filter_ = bend_filter()
    state = filter_.init(q, seed=0)
    u = bend_readings(q)
    for _ in range(20):
        assert bool((state.q.norm(dim=-1) <= math.pi / 2).all())
        assert float(state.q.norm(dim=-1).max()) > 1.5
        state, _ = filter_.step(state, u, 0.0)


def test_particle_that_cannot_stay_inside_stays_where_it_is():
    """Drawing again must end: noise far wider than the region, and a velocity that leads outside."""
    box = Box(-1e-6 * torch.ones(2).double(), 1e-6 * torch.ones(2).double())
    filter_ = ParticleFilter(linear, WALK, NOISE, box, particles=50, motion="constant velocity")
    state, _ = filter_.step(filter_.init(START, seed=0), linear(START), 0.0)
    assert torch.equal(state.q, torch.zeros(50, 2).double())
    assert torch.equal(state.velocity, torch.zeros(50, 2).double())


def test_noise_that_was_drawn_again_is_that_of_a_truncated_walk():
    """Half of the cloud at a wall: the rest is half-normal, whose mean is sqrt(2/pi) sigma."""
    wall = Box(torch.tensor([-9.0, -9.0]).double(), torch.tensor([0.0, 9.0]).double())
    state = ParticleFilter(linear, WALK, NOISE, wall, particles=40_000).init(START, seed=0)
    assert float(state.q[:, 0].mean()) == pytest.approx(-float(WALK[0]) * math.sqrt(2 / math.pi), abs=0.006)
    assert float(state.q[:, 1].mean()) == pytest.approx(0, abs=0.008)


def test_lost_filter_says_so_and_starts_again():
    before, after = torch.tensor([[0.9, 0.3], [-0.7, -1.0]], dtype=torch.float64)
    u = bend_readings(torch.stack([before] * 3 + [after] * 3))
    stubborn, restarting = (track(bend_filter(restart=r), u, before) for r in (False, True))
    assert stubborn.diagnostics["lost"].tolist() == [False] * 3 + [True] * 3
    assert restarting.diagnostics["lost"].tolist() == [False] * 3 + [True] + [False] * 2
    assert float((stubborn.q[-1] - after).norm()) > 1
    # 0.05 mT of noise at 2.4-4 mT/rad: 0.02 rad.
    assert float((restarting.q[3:] - after).norm(dim=-1).max()) < 0.02


def test_restart_needs_no_start_anywhere_in_the_disc():
    truth = Disc(math.pi / 2).sample(40, np.random.default_rng(1))
    found = track(bend_filter(restart=True), bend_readings(truth)[None], torch.zeros(40, 2).double())
    assert float((found.q[0] - truth).norm(dim=-1).max()) < 0.02


def test_restart_keeps_every_configuration_that_explains_the_readings():
    """The square of the first coordinate does not tell its sign."""
    filter_ = ParticleFilter(
        lambda q: q * q, torch.full((1,), 0.01).double(), 0.01, Box(-torch.ones(1).double(), torch.ones(1).double()),
        restart=True,
    )  # fmt: skip
    state = filter_.init(torch.zeros(1).double(), seed=0)
    state, _ = filter_.step(state, torch.tensor([0.49]).double(), 0.0)
    positive = float((state.q > 0).double().mean())
    assert 0.2 < positive < 0.8
    assert float((state.q.abs() - 0.7).abs().max()) < 0.08


def test_only_the_lost_member_of_a_batch_starts_again():
    start = torch.tensor([[0.5, 0.5], [-0.5, 0.2]], dtype=torch.float64)
    u = bend_readings(torch.stack([start[0], -start[1]]))
    filter_, calm = bend_filter(restart=True), bend_filter()
    both, alone = track(filter_, u[None], start), track(calm, u[None, :1], start[:1])
    assert both.diagnostics["lost"][0].tolist() == [False, True]
    assert torch.equal(both.q[0, 0], alone.q[0, 0])
    assert float((both.q[0, 1] + start[1]).norm()) < 0.02


def test_state_stepped_twice_gives_the_same_bits_and_seeds_differ():
    filter_, u = bend_filter(), bend_readings(torch.tensor([0.01, 0.0], dtype=torch.float64))
    state = filter_.init(START, seed=7)
    (first, a), (second, b) = (filter_.step(state, u, 0.0) for _ in range(2))
    assert torch.equal(first.q, second.q)
    assert torch.equal(a.q, b.q)
    other, _ = filter_.step(filter_.init(START, seed=8), u, 0.0)
    assert not torch.equal(first.q, other.q)
    assert not torch.equal(first.q - state.q, state.q - START)  # no step repeats the numbers of another


def test_process_noise_of_each_member():
    walk = torch.tensor([[0.02], [0.005]]).double() * math.pi * torch.ones(2).double()
    u = bend_readings(bend_curve("flower")[:20])
    both = track(bend_filter(process_noise=walk), u[:, None].expand(-1, 2, 3), torch.zeros(2, 2).double())
    for k in range(2):
        alone = track(bend_filter(process_noise=walk[k]), u, START)
        torch.testing.assert_close(both.q[:, k], alone.q, atol=1e-12, rtol=0)


def test_without_the_axial_reading_the_bend_is_still_found():
    """The released code drops the component along the body: a masked sensor here."""
    q = bend_curve("flower")[40:80]
    mask = torch.tensor([True, True, False]).expand(40, 3)
    found = track(bend_filter(particles=500), bend_readings(q), q[0], mask=mask)
    assert found.diagnostics["masked"].unique().tolist() == [1]
    assert float((found.q - q).norm(dim=-1).max()) < 0.02


def test_robot_of_two_segments_with_several_magnets_and_sensors():
    """Any batched model: two rings, six sensors, six coordinates; readings by magpylib, one sensor lost."""
    robot, q = pcc_robot(2), lemniscate(2)[:8]
    model = MagneticSensing(robot, MultipoleField.of(ring("released")))
    u = readings(robot, q, ring("released"))
    u[3:, 4] = math.nan
    walk = torch.tensor([5e-4, 5e-4, 8e-5] * 2).double()
    filter_ = ParticleFilter(model, walk, 1e-3, particles=300, estimate="Gauss-Newton")
    known = torch.full((8, 6), math.nan).double()
    known[:, 5] = q[:, 5]  # five readings for five coordinates
    found = track(filter_, u, q[0], known=known)
    assert found.diagnostics["masked"].tolist() == [0] * 3 + [1] * 5
    assert float((found.q - q).abs().max()) < 1e-4
    # Without a Gauss-Newton step the cloud is as close as its particles are.
    cloud = ParticleFilter(model, walk, 0.01, particles=3000)
    assert float((track(cloud, u, q[0], known=known).q - q).abs().max()) < 1.5e-3


def test_best_tenth_turns_with_the_cloud_and_its_angles_are_biased_when_straight():
    g = torch.Generator().manual_seed(0)
    q = torch.randn(2000, 2, generator=g, dtype=torch.float64)
    log_w = torch.randn(2000, generator=g, dtype=torch.float64)
    turn = torch.tensor([[0.6, -0.8], [0.8, 0.6]], dtype=torch.float64)
    torch.testing.assert_close(best_tenth(q @ turn.T, log_w), turn @ best_tenth(q, log_w))
    # The mean length of a standard normal vector in the plane is sqrt(pi/2), whatever its mean is.
    assert float(best_tenth(q, log_w).norm()) == pytest.approx(math.sqrt(math.pi / 2), abs=0.15)


def test_is_an_estimator():
    assert isinstance(bend_filter(), Estimator)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (
            lambda: bend_filter(noise_mt=0.0),
            "Input noise_mt of ParticleFilter must be positive; instead received 0.0.",
        ),
        (
            lambda: bend_filter(particles=0),
            "Input particles of ParticleFilter must be positive; instead received 0.",
        ),
        (
            lambda: bend_filter(process_noise=torch.tensor([0.1, 0.0])),
            r"Input process_noise of ParticleFilter must be positive; instead received \[0.1.*, 0.0\].",
        ),
        (
            lambda: bend_filter(estimate="mean"),
            "Input estimate of ParticleFilter must be one of 'best tenth', 'weighted', 'Gauss-Newton'; "
            "instead received 'mean'.",
        ),
        (
            lambda: bend_filter(process_noise=torch.ones(3), estimate="best tenth"),
            "Input estimate of ParticleFilter must be 'weighted' or 'Gauss-Newton' for a configuration that is no "
            "bend vector; instead received 'best tenth' for 3 coordinates.",
        ),
        (
            lambda: bend_filter(region=None, restart=True),
            "Input region of ParticleFilter must be given for restart=True; instead received None.",
        ),
        (
            lambda: bend_filter().init(torch.full((2,), 1.25).double(), seed=0),
            r"Input q0 of ParticleFilter must be within Disc\(radius=1.57.*\); instead received \[1.25, 1.25\].",
        ),
        (
            lambda: bend_filter().init(START, seed=-1),
            "Input seed of ParticleFilter must be not negative; instead received -1.",
        ),
    ],
)
def test_bad_input(call, message):
    with pytest.raises(InputError, match=message):
        call()
