"""Straight rod, circular arcs, laws, derivatives at the straight pose, the inverse, and the printed equation."""

import math

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from edition1.errors import InputError
from edition1.kinematics.constant_curvature import ConstantCurvature

L, D = 0.11, 0.022
SEGMENT = ConstantCurvature(L, D)
delta = st.floats(-0.06, 0.06).map(lambda x: 0.0 if abs(x) < 1e-200 else x)
elongation = st.floats(-0.01, 0.02)
coordinate = st.floats(0, 1)


def double(*x):
    return torch.tensor(x, dtype=torch.float64)


def test_straight_segment():
    T = SEGMENT.pose(double(0.0, 0.0, 0.01), torch.tensor(0.5))
    torch.testing.assert_close(T[:3, :3], torch.eye(3, dtype=torch.float64))
    torch.testing.assert_close(T[:3, 3], double(0, 0, 0.06))


@pytest.mark.parametrize("direction", [0.0, 0.7, 2.0, -3.0])
@pytest.mark.parametrize("angle", [1e-9, 0.3, math.pi / 2, 3.0])
@pytest.mark.parametrize("v", [0.25, 1.0])
def test_circular_arc_in_any_plane(direction, angle, v):
    """Centre of the circle at distance 1/kappa in the direction of bending."""
    q = double(D * angle * math.cos(direction), D * angle * math.sin(direction), 0.005)
    r, a = (L + 0.005) / angle, v * angle
    in_plane = 2 * r * math.sin(a / 2) ** 2
    expected = double(in_plane * math.cos(direction), in_plane * math.sin(direction), r * math.sin(a))
    T = SEGMENT.pose(q, torch.tensor(v))
    torch.testing.assert_close(T[:3, 3], expected, atol=1e-14, rtol=1e-12)
    axis = double(-math.sin(direction), math.cos(direction), 0.0)  # bending turns z towards the direction
    K = torch.linalg.cross(axis.expand(3, 3), torch.eye(3, dtype=torch.float64)).T
    torch.testing.assert_close(T[:3, :3], torch.linalg.matrix_exp(a * K), atol=1e-13, rtol=0)


def test_printed_equation_15_is_right_at_the_tip_only():
    """With the printed 1/v the middle of a straight segment would lie at the tip."""
    dx, dy, dL = 0.01, -0.004, 0.003
    for v, ratio in ((1.0, 1.0), (0.5, 2.0)):
        d2 = dx * dx + dy * dy
        angle = v * math.sqrt(d2) / D
        c, s = 1 - math.cos(angle), math.sqrt(d2) * math.sin(angle)
        printed = D * (L + dL) / (v * d2) * double(dx * c, dy * c, s)
        ours = SEGMENT.pose(double(dx, dy, dL), torch.tensor(v))[:3, 3]
        torch.testing.assert_close(printed, ratio * ours)


@given(delta, delta, elongation, coordinate)
def test_poses_are_rigid_motions(dx, dy, dL, v):
    T = SEGMENT.pose(double(dx, dy, dL), torch.tensor(v, dtype=torch.float64))
    R = T[:3, :3]
    torch.testing.assert_close(R @ R.T, torch.eye(3, dtype=torch.float64), atol=1e-13, rtol=0)
    assert float(torch.linalg.det(R)) == pytest.approx(1, abs=1e-12)


@given(delta, delta, elongation)
def test_length_of_the_backbone(dx, dy, dL):
    v = torch.linspace(0, 1, 2001, dtype=torch.float64)
    p = SEGMENT.pose(double(dx, dy, dL), v)[:, :3, 3]
    length = float(torch.linalg.vector_norm(p.diff(dim=0), dim=-1).sum())
    assert length == pytest.approx(L + dL, rel=2e-6)


@given(delta, delta, elongation, coordinate)
def test_tangent_is_the_derivative_of_the_position(dx, dy, dL, v):
    q = double(dx, dy, dL)
    tangent = torch.func.jacfwd(lambda x: SEGMENT.pose(q, x)[:3, 3])(torch.tensor(v, dtype=torch.float64))
    expected = (L + dL) * SEGMENT.pose(q, torch.tensor(v, dtype=torch.float64))[:3, 2]
    torch.testing.assert_close(tangent, expected, atol=1e-13, rtol=1e-11)


@given(delta, delta, elongation, coordinate, coordinate)
def test_a_part_of_an_arc_is_an_arc(dx, dy, dL, v, w):
    """T(v) T(w) = T(v + w): constant curvature along the whole segment."""
    q, v, w = double(dx, dy, dL), double(v) / 2, double(w) / 2
    product = SEGMENT.pose(q, v) @ SEGMENT.pose(q, w)
    torch.testing.assert_close(product, SEGMENT.pose(q, v + w), atol=1e-12, rtol=0)


@pytest.mark.parametrize("size", [0.0, 1e-8, D * (1 - 1e-7), D, D * (1 + 1e-7), 3 * D])
def test_derivatives(size):
    """Zero, nearly zero, both sides of the series switch (theta = 1), large."""
    q = double(size * 0.6, size * 0.8, 0.002).requires_grad_()
    v = torch.tensor(1.0, dtype=torch.float64)
    scale = 1 / D  # so that the finite differences of gradcheck see numbers of order one
    assert torch.autograd.gradcheck(
        lambda x: SEGMENT.pose(x / scale, v), q.detach().mul(scale).requires_grad_()
    )
    assert torch.autograd.gradgradcheck(
        lambda x: SEGMENT.pose(x / scale, v), q.detach().mul(scale).requires_grad_(), atol=1e-4
    )


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_derivatives_at_the_straight_pose_are_the_closed_forms(dtype):
    """d p_x / d Delta_x = L/(2 d); d2 p_z / d Delta_x2 = -L/(3 d2); in the caller's precision."""
    zero = torch.zeros(3, dtype=dtype)
    v = torch.ones((), dtype=dtype)
    jacobian = torch.func.jacrev(lambda q: SEGMENT.pose(q, v)[:3, 3])(zero)
    hessian = torch.func.hessian(lambda q: SEGMENT.pose(q, v)[2, 3])(zero)
    eps = 4 * torch.finfo(dtype).eps
    assert jacobian.dtype == dtype
    assert float(jacobian[0, 0]) == pytest.approx(L / 2 / D, rel=eps)
    assert float(jacobian[2, 2]) == pytest.approx(1, rel=eps)
    assert float(hessian[0, 0]) == pytest.approx(-L / 3 / D**2, rel=eps)
    assert torch.isfinite(hessian).all()


@given(delta.filter(lambda x: abs(x) < 0.04), delta.filter(lambda x: abs(x) < 0.04), elongation)
def test_inverse_returns_the_configuration(dx, dy, dL):
    q = double(dx, dy, dL)
    back = SEGMENT.configuration(SEGMENT.pose(q, torch.tensor(1.0)))
    torch.testing.assert_close(back, q, atol=1e-10, rtol=0)


@pytest.mark.parametrize("shape", [(), (1,), (3, 1, 2)])
def test_inverse_of_a_batch_and_of_the_straight_pose(shape):
    q = torch.zeros(*shape, 3, dtype=torch.float64)
    back = SEGMENT.configuration(SEGMENT.pose(q, torch.tensor(1.0)))
    assert back.shape == q.shape
    torch.testing.assert_close(back, q, atol=1e-10, rtol=0)


def test_inverse_is_differentiable_at_the_straight_pose():
    jacobian = torch.func.jacrev(lambda q: SEGMENT.configuration(SEGMENT.pose(q, torch.tensor(1.0))))(
        torch.zeros(3, dtype=torch.float64)
    )
    torch.testing.assert_close(jacobian, torch.eye(3, dtype=torch.float64), atol=1e-12, rtol=0)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (
            lambda: ConstantCurvature(-0.1, D),
            r"Input length of ConstantCurvature must be positive \[m\]; .* -0.1.",
        ),
        (lambda: ConstantCurvature(L, 0.0), r"Input radius of ConstantCurvature must be positive"),
        (lambda: ConstantCurvature(math.nan, D), r"Input length of ConstantCurvature must be positive"),
        (lambda: SEGMENT.pose(double(math.nan, 0, 0), torch.tensor(1.0)), r"Input q .* finite; .* 1 values"),
        (lambda: SEGMENT.configuration(2 * torch.eye(4)), r"T_base_tip .* a rigid motion"),
        (lambda: SEGMENT.configuration(torch.diag(double(1, -1, -1, 1))), r"bent by less than pi"),
    ],
)
def test_bad_input(call, message):
    with pytest.raises(InputError, match=message):
        call()
