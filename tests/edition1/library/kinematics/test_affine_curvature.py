"""Limits, an independent quadrature, laws, derivatives and the ambiguity of the affine-curvature segment."""

import math

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from mpmath import mp

from edition1.errors import InputError
from edition1.kinematics.affine_curvature import AffineCurvature
from edition1.kinematics.constant_curvature import ConstantCurvature
from edition1.kinematics.mounts import sensor_mounts
from edition1.kinematics.robot import Robot

L = 0.2
SEGMENT = AffineCurvature(L)
kappa_0, kappa_1, azimuth = st.floats(-1, 1), st.floats(-4, 4), st.floats(-7, 7)
elongation, coordinate = st.floats(0, 0.006), st.floats(0, 1)


def double(*x):
    return torch.tensor(x, dtype=torch.float64)


@pytest.mark.parametrize(
    ("k0", "k1"), [(0.5, 3.0), (-math.pi, 4 * math.pi), (math.pi, -4 * math.pi), (0.0, 1e-9)]
)
@pytest.mark.parametrize("v", [0.3, 1.0])
def test_position_against_quadrature_in_thirty_digits(k0, k1, v):
    """The stated bound: 2e-14 of the length over the stated range of curvatures."""
    phi, mp.dps = 0.7, 30
    across, ahead = (
        float(mp.quad(lambda s, f=f: f(k0 * s + k1 * s * s / 2), [0, v])) for f in (mp.sin, mp.cos)
    )
    expected = L * double(across * math.sin(phi), -across * math.cos(phi), ahead)
    p = SEGMENT.pose(double(k0, k1, phi, 0.0), double(v)[0])[:3, 3]
    assert float((p - expected).abs().max()) < 2e-14 * L


@given(st.floats(-3, 3), azimuth, elongation, coordinate)
def test_without_linear_part_it_is_constant_curvature(k0, phi, dL, v):
    d = 0.022
    delta = d * k0
    q = double(delta * math.sin(phi), -delta * math.cos(phi), dL)
    v = double(v)[0]
    T = SEGMENT.pose(double(k0, 0.0, phi, dL), v)
    torch.testing.assert_close(T, ConstantCurvature(L, d).pose(q, v), atol=1e-14, rtol=0)


@given(kappa_0, kappa_1, azimuth, elongation, coordinate)
def test_tangent_is_the_derivative_of_the_position(k0, k1, phi, dL, v):
    q, v = double(k0, k1, phi, dL), double(v)[0]
    slope = torch.func.jacfwd(lambda x: SEGMENT.pose(q, x)[:3, 3])(v)
    torch.testing.assert_close(slope, (L + dL) * SEGMENT.pose(q, v)[:3, 2], atol=1e-13, rtol=0)


@given(kappa_0, kappa_1, azimuth, elongation, coordinate)
def test_rotation_is_eq_18_as_printed(k0, k1, phi, dL, v):
    theta = k0 * v + k1 * v * v / 2
    S, C, s, c = math.sin(phi), math.cos(phi), math.sin(theta), math.cos(theta)
    printed = double(
        [S * S * c + C * C, -S * C * c + S * C, S * s],
        [-S * C * c + S * C, S * S + C * C * c, -s * C],
        [-S * s, s * C, c],
    )
    T = SEGMENT.pose(double(k0, k1, phi, dL), double(v)[0])
    torch.testing.assert_close(T[:3, :3], printed, atol=1e-14, rtol=0)


@given(kappa_0, kappa_1, azimuth, elongation)
def test_two_configurations_of_one_shape(k0, k1, phi, dL):
    v = torch.linspace(0, 1, 5, dtype=torch.float64)
    q, other = double(k0, k1, phi, dL), double(-k0, -k1, phi + math.pi, dL)
    torch.testing.assert_close(SEGMENT.pose(q, v), SEGMENT.pose(other, v), atol=1e-14, rtol=0)


@pytest.mark.parametrize("size", [0.0, 1e-8, 1.0, 3.0])
def test_derivatives(size):
    q = double(0.3 * size, size, 0.4, 0.002).requires_grad_()
    v = torch.tensor(1.0, dtype=torch.float64)
    assert torch.autograd.gradcheck(lambda x: SEGMENT.pose(x, v), q)
    assert torch.autograd.gradgradcheck(lambda x: SEGMENT.pose(x, v), q)


def test_mixes_with_constant_curvature_in_one_robot():
    robot = Robot(
        (SEGMENT, ConstantCurvature(0.11, 0.022)), sensors=sensor_mounts([1, 0], [0.11, 0.1], 0.013)
    )
    assert robot.n_q == 7
    assert robot.coordinates == (
        "kappa_0_1",
        "kappa_1_1",
        "phi_1",
        "delta_L_1",
        "delta_x_2",
        "delta_y_2",
        "delta_L_2",
    )
    q = double(0.5, 1.0, 0.3, 0.0, 0.01, -0.005, 0.002).expand(3, 7)
    T = robot.sensor_poses(q)
    upper = Robot((robot.segments[1],), sensors=sensor_mounts([0], 0.11, 0.013)).sensor_poses(q[:, 4:])
    tip = SEGMENT.pose(q[:, :4], torch.ones(3))
    torch.testing.assert_close(T[:, 0], tip @ upper[:, 0])
    assert robot.backbone(q).shape == (3, 66, 3)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: AffineCurvature(-0.2), "Input length of AffineCurvature must be positive"),
        (
            lambda: SEGMENT.pose(double(0.0, math.nan, 0.0, 0.0), torch.tensor(1.0)),
            "Input q of .* must be finite",
        ),
    ],
)
def test_bad_input(call, message):
    with pytest.raises(InputError, match=message):
        call()
