"""Equations (9)-(12), step by step, and the law that ties step sizes to the field."""

import pytest
import torch

from edition1.errors import InputError
from edition1.estimation.base import track
from edition1.estimation.gradient_descent import GradientDescent
from edition1.kernels import compiled
from edition1.kinematics.paper_robots import pcc_robot
from edition1.sensing.magnetic import MagneticSensing, readings
from edition1.sensing.magnets import ring
from edition1.sensing.multipole import MultipoleField
from edition1_companion.twins.trajectories import lemniscate

A = torch.tensor([[1.0, 0.5], [-0.3, 2.0], [0.2, 0.1]], dtype=torch.float64)


def linear(q):
    return q @ A.T


def test_updates_are_equation_11():
    """A hand-written loop on a linear model: gradient (2/n) J^T (u_hat - u), b = mu b + g, q = q - gamma b."""
    u, q, b = torch.tensor([1.0, -1.0, 0.5]).double(), torch.zeros(2).double(), torch.zeros(2).double()
    gamma, mu = torch.tensor([0.1, 0.05]).double(), 0.3
    iterates = []
    for _ in range(5):
        iterates.append(q)
        b = mu * b + 2 / 3 * A.T @ (A @ q - u)
        q = q - gamma * b
    estimator = GradientDescent(linear, gamma, momentum=mu, iterations=5)
    state, estimate = estimator.step(estimator.init(torch.zeros(2).double()), u, 0.0)
    losses = torch.stack([((A @ x - u) ** 2).mean() for x in iterates])
    torch.testing.assert_close(estimate.q, iterates[int(losses.argmin())])
    torch.testing.assert_close(estimate.diagnostics["loss"], losses.min())
    four_updates = torch.zeros(2).double()
    q = torch.zeros(2).double()
    for _ in range(4):  # five evaluations are four updates
        four_updates = mu * four_updates + 2 / 3 * A.T @ (A @ q - u)
        q = q - gamma * four_updates
    torch.testing.assert_close(state.momentum, four_updates)


def test_best_iterate_is_kept_when_the_descent_overshoots():
    u, start = torch.tensor([0.0, 0.0, 0.0]).double(), torch.tensor([0.1, 0.1]).double()
    estimator = GradientDescent(linear, torch.tensor([5.0, 5.0]).double(), momentum=0.0)
    _, estimate = estimator.step(estimator.init(start), u, 0.0)
    torch.testing.assert_close(estimate.q, start)
    assert float(estimate.diagnostics["best_iteration"]) == 0


def test_momentum_is_carried_or_not():
    u = torch.tensor([1.0, -1.0, 0.5]).double().expand(3, 3)
    q0, gamma = torch.zeros(2).double(), torch.tensor([0.02, 0.02]).double()
    carried = GradientDescent(linear, gamma, iterations=3)
    reset = GradientDescent(linear, gamma, iterations=3, carry_momentum=False)
    assert torch.equal(track(carried, u, q0).q[0], track(reset, u, q0).q[0])
    assert not torch.equal(track(carried, u, q0).q[1], track(reset, u, q0).q[1])


@pytest.mark.parametrize("factor", [0.25, 3.0])
def test_step_sizes_scale_with_the_squared_field(factor):
    """A field c times as strong and step sizes / c^2 give the same iterates."""
    robot, q = pcc_robot(1), lemniscate(1)[:5]
    u = readings(robot, q, ring("released"))
    field = MultipoleField.of(ring("released"))
    step = torch.full((3,), 3.5e-4).double()
    plain = GradientDescent(MagneticSensing(robot, field), step)
    scaled = GradientDescent(MagneticSensing(robot, MultipoleField(factor * field.moments)), step / factor**2)
    torch.testing.assert_close(track(plain, u, q[0]).q, track(scaled, factor * u, q[0]).q, atol=1e-13, rtol=0)


def test_on_exact_physics_twenty_evaluations_nearly_suffice():
    """0.065 % mean relative error on the full lemniscate of one segment, against percents with a network."""
    robot, q = pcc_robot(1), lemniscate(1)
    u = readings(robot, q, ring("released"))
    sensing = compiled(MagneticSensing(robot, MultipoleField.of(ring("released"))))
    estimate = track(GradientDescent(sensing, torch.full((3,), 3.5e-4)), u, q[0])
    error = ((estimate.q - q) ** 2).mean(0).sqrt() / (q.amax(0) - q.amin(0))
    assert 100 * float(error.mean()) == pytest.approx(0.065, abs=0.002)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"step_size": torch.tensor([-1.0, 1.0])}, "Input step_size"),
        ({"momentum": 1.0}, r"Input momentum of GradientDescent must be in \[0, 1\); instead received 1.0."),
        ({"iterations": 0}, "Input iterations of GradientDescent must be at least 1"),
    ],
)
def test_bad_input(change, message):
    with pytest.raises(InputError, match=message):
        GradientDescent(**({"sensing": linear, "step_size": torch.ones(2)} | change))
