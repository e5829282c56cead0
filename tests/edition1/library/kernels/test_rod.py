"""The kernels of a rod against torch: poses with their derivatives, readings, innovations, motion of the states."""

import math

import numpy as np
import pytest
import torch

from edition1 import se3
from edition1.estimation.rod_filter import RodFilter
from edition1.estimation.rod_sensors import RodSensor
from edition1.kernels._rod import exponential, logarithm, rod_motion
from edition1.kernels._rod_filter import carry, rod_innovation, rod_readings
from edition1.kinematics.strain_series import StrainSeries

ROD = StrainSeries(0.466)
ARCS = (0.0, 0.1165, 0.233, 0.4, 0.466)
LASTING = {"lasting_std": (0.1,) * 3, "lasting_time_s": 2.0}
SENSORS = (
    RodSensor("pose", (0.1,) * 6, arc_m=0.466, lasting_std=(0.1,) * 6),
    RodSensor("orientation", (0.1,) * 3, arc_m=0.3, **LASTING),
    RodSensor("gyroscope", (0.1,) * 3, arc_m=0.233, **LASTING),
    RodSensor("gyroscope", (0.1,) * 3, arc_m=0.466),
)
FILTER = RodFilter(ROD, SENSORS, (2.0,) * 7, 5.0, (0.01, 0.1))
N = FILTER.n_q


def states(scale, seed=0):
    return (
        scale
        * np.random.default_rng(seed).normal(size=2 * N + 12)
        * np.array([0.05] * 6 + [1.0] * (2 * N + 6))
    )


def pose(q, arc):
    base = se3.exponential(q[:6])
    return base @ ROD.pose(q[6:], torch.tensor(arc / ROD.length, dtype=torch.float64))


def read(x):
    """The readings by torch."""
    q, errors, rates = x[:N], x[N : N + 12], x[-N:]

    def body(arc, d):
        return se3.logarithm(se3.inverse(pose(q, arc).detach()) @ pose(q + d, arc))

    def turning(arc):
        J = torch.autograd.functional.jacobian(lambda d: body(arc, d), torch.zeros(N).double())
        return J[3:] @ rates

    tilt = torch.cat([torch.zeros(3).double(), errors[6:9]])
    return torch.cat(
        [
            se3.logarithm(pose(q, 0.466) @ se3.exponential(errors[:6])),
            se3.logarithm(pose(q, 0.3) @ se3.exponential(tilt))[3:],
            turning(0.233) + errors[9:],
            turning(0.466),
        ]
    )


@pytest.mark.parametrize("scale", [0.0, 1e-9, 1e-4, 0.02, 0.3, 2.0])
def test_exponential_and_logarithm(scale):
    x = scale * np.array([0.3, -0.2, 0.5, 0.6, -0.7, 0.4])
    T = exponential(x)
    np.testing.assert_allclose(T, se3.exponential(torch.from_numpy(x)).numpy(), atol=1e-15)
    np.testing.assert_allclose(logarithm(T), x, atol=1e-13)


@pytest.mark.parametrize("scale", [0.0, 1e-8, 1.0, 5.0])
def test_poses_and_their_derivatives(scale):
    x = states(scale)[:N]
    T, J = rod_motion(x, ROD.basis, ROD.length / ROD.parts, True, np.array(ARCS))
    q = torch.from_numpy(x)
    for k, arc in enumerate(ARCS):
        torch.testing.assert_close(torch.from_numpy(T[k]), pose(q, arc), atol=1e-13, rtol=0)
        by_torch = torch.autograd.functional.jacobian(
            lambda d, arc=arc, k=k: se3.logarithm(se3.inverse(torch.from_numpy(T[k])) @ pose(q + d, arc)),
            torch.zeros(N).double(),
        )
        torch.testing.assert_close(torch.from_numpy(J[k]), by_torch, atol=1e-12, rtol=0)


def test_readings_are_those_of_torch():
    x, out = states(0.3), np.empty(15)
    rod_readings(FILTER._layout, x, N, np.zeros(15), out)
    torch.testing.assert_close(torch.from_numpy(out), read(torch.from_numpy(x)), atol=1e-12, rtol=0)


def innovation(x, u):
    r, H, R = np.zeros(15), np.zeros((15, len(x))), np.zeros(15)
    none = np.zeros(15), np.zeros((15, ROD.n_q))
    rod_innovation(FILTER._layout, x, x, np.eye(len(x)), u, np.ones(15, dtype=bool), N, *none, r, H, R)
    return r, H, R


def test_readings_of_a_state_are_no_surprise_to_it():
    """With lasting errors of orientations that are small: they are added to the twist."""
    x = states(0.3)
    x[N : N + 9] = 0.0
    r, _, R = innovation(x, read(torch.from_numpy(x)).numpy())
    np.testing.assert_allclose(r, 0, atol=1e-12)
    np.testing.assert_allclose(R, 0.01)


def test_innovations_fall_as_their_derivatives_say():
    """By differences; a gyroscope's by the velocities and its bias (how its place turns is of second order)."""
    x, h = states(0.3), 1e-6
    u = read(torch.from_numpy(states(0.35))).numpy()
    _, H, _ = innovation(x, u)
    differences = np.stack(
        [(innovation(x - h * e, u)[0] - innovation(x + h * e, u)[0]) / (2 * h) for e in np.eye(len(x))]
    )
    np.testing.assert_allclose(H[:9], differences.T[:9], atol=1e-8)
    np.testing.assert_allclose(H[9:, N:], differences.T[9:, N:], atol=1e-8)


def test_states_move_by_the_transition():
    rng = np.random.default_rng(1)
    x, root = states(1.0), rng.normal(size=(2 * N + 12, 2 * N + 12))
    P = root @ root.T
    move, noise = (y.numpy() for y in FILTER.motion(0.07))
    mean, cov = move @ x, move @ P @ move.T + noise
    carry(x, P, FILTER._std, FILTER._rates, *FILTER._lasting, 0.07)
    np.testing.assert_allclose(x, mean, atol=1e-12)
    np.testing.assert_allclose(P, cov, atol=1e-9)


@pytest.mark.parametrize("tau", [1e-4, 0.05, 1.0, 20.0])
def test_the_process_is_stationary_with_the_covariance_of_matern(tau):
    move, noise = FILTER.motion(tau)
    P = FILTER.init(torch.zeros(N).double()).covariance
    torch.testing.assert_close(move @ P @ move.mT + noise, P, atol=1e-12, rtol=0)
    lam, var = 5.0, 4.0
    expected = var * (1 + lam * tau) * math.exp(-lam * tau)
    assert float((move @ P)[6, 6]) == pytest.approx(expected)
