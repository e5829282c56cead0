"""Closed forms, derivatives at zero and at the series switch, laws of rigid motions, RoMa as a second opinion."""

import math

import numpy as np
import pytest
import roma
import scipy.linalg
import torch
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from edition1 import se3
from edition1.errors import InputError

ANGLES = [0.0, 1e-12, 1e-8, 1e-4, 0.1, 1 - 1e-9, 1.0, 1 + 1e-9, 1.5, 3.0, 10.0]


def double(x):
    return torch.tensor(x, dtype=torch.float64)


@pytest.mark.parametrize("angle", ANGLES)
def test_even_functions_match_extended_precision(angle):
    from mpmath import mp, mpf

    mp.dps = 40
    t = mpf(angle)
    z = double(float(t * t))
    root = mp.sqrt(mpf(float(z)))
    expected_sinc = mp.sin(root) / root if root else mpf(1)
    expected_cosc = (1 - mp.cos(root)) / root**2 if root else mpf(1) / 2
    assert float(se3.sinc(z)) == pytest.approx(float(expected_sinc), rel=4e-16, abs=1e-16)
    assert float(se3.cosc(z)) == pytest.approx(float(expected_cosc), rel=4e-16, abs=1e-16)


@pytest.mark.parametrize("function", [se3.sinc, se3.cosc])
@pytest.mark.parametrize("z", [1e-8, 0.5, 1 - 1e-7, 1 + 1e-7, 5.0])
def test_first_and_second_derivative(function, z):
    x = double(z).requires_grad_()
    assert torch.autograd.gradcheck(function, x, eps=1e-9 if z < 1e-6 else 1e-6)
    assert torch.autograd.gradgradcheck(function, x, eps=1e-9 if z < 1e-6 else 1e-6)


@pytest.mark.parametrize(
    ("function", "first", "second"), [(se3.sinc, -1 / 6, 1 / 60), (se3.cosc, -1 / 24, 1 / 360)]
)
@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_derivatives_at_zero_are_the_series(function, first, second, dtype):
    z = torch.zeros((), dtype=dtype, requires_grad=True)
    (g,) = torch.autograd.grad(function(z), z, create_graph=True)
    (gg,) = torch.autograd.grad(g, z)
    eps = torch.finfo(dtype).eps
    assert float(g.detach()) == pytest.approx(first, rel=2 * eps)
    assert float(gg) == pytest.approx(second, rel=2 * eps)


@pytest.mark.parametrize("theta", [0.0, 1e-8, 1e-3, 0.45, 0.4510268, 0.46, 1.0, 2.0, 3.0])
def test_acosc(theta):
    expected = theta / math.sin(theta) if theta else 1.0
    assert float(se3.acosc(double(math.cos(theta)))) == pytest.approx(expected, rel=1e-13)


def test_acosc_derivative_across_its_switch():
    c = double([1.0, 1 - 1e-9, 0.9 + 1e-7, 0.9 - 1e-7, 0.0, -0.9]).requires_grad_()
    assert torch.autograd.gradcheck(se3.acosc, c, eps=1e-7)


@pytest.mark.parametrize("shape", [(), (1,), (3, 1, 2)])
@pytest.mark.parametrize(
    ("function", "axis"), [(se3.rotation_x, 0), (se3.rotation_y, 1), (se3.rotation_z, 2)]
)
def test_rotations_are_roma_rotations(function, axis, shape):
    angle = torch.rand(shape, dtype=torch.float64, generator=torch.Generator().manual_seed(0)) * 6 - 3
    vector = angle.unsqueeze(-1) * torch.eye(3, dtype=torch.float64)[axis]
    torch.testing.assert_close(function(angle), roma.rotvec_to_rotmat(vector))


@pytest.mark.parametrize("shape", [(), (1,), (3, 1, 2)])
def test_inverse_undoes_the_motion(shape):
    generator = torch.Generator().manual_seed(1)
    angle = torch.rand(shape, dtype=torch.float64, generator=generator)
    p = torch.rand(*shape, 3, dtype=torch.float64, generator=generator)
    T = se3.pose(se3.rotation_x(angle) @ se3.rotation_z(2 * angle), p)
    torch.testing.assert_close(se3.inverse(T) @ T, torch.eye(4, dtype=torch.float64).expand_as(T))


def test_pose_broadcasts_its_batches():
    T = se3.pose(torch.eye(3).expand(5, 1, 3, 3), torch.zeros(4, 3))
    assert T.shape == (5, 4, 4, 4)


@given(st.floats(-10, 10), st.floats(-10, 10))
def test_rotations_about_one_axis_add_up(a, b):
    torch.testing.assert_close(
        se3.rotation_y(double(a)) @ se3.rotation_y(double(b)),
        se3.rotation_y(double(a + b)),
        atol=1e-12,
        rtol=0,
    )


def test_values_that_are_not_finite_are_counted():
    with pytest.raises(InputError, match=r"Input x of f must be finite; instead received 2 values"):
        se3.require_finite(torch.tensor([1.0, math.nan, math.inf]), "x", "f")


def test_finite_check_passes_inside_vmap():
    def function(x):
        se3.require_finite(x, "x", "f")
        return 2 * x

    assert torch.func.vmap(function)(torch.ones(3)).tolist() == [2, 2, 2]


@given(twist=arrays(float, 6, elements=st.floats(-1.7, 1.7)))
def test_exponential_is_the_matrix_exponential(twist):
    """By SciPy's matrix exponential, and back by the logarithm."""
    xi = torch.as_tensor(twist)
    generator = torch.zeros(4, 4, dtype=torch.float64)
    generator[:3, :3], generator[:3, 3] = se3.cross_matrix(xi[3:]), xi[:3]
    T = se3.exponential(xi)
    np.testing.assert_allclose(T, scipy.linalg.expm(generator.numpy()), atol=1e-14)
    torch.testing.assert_close(se3.logarithm(T), xi, rtol=0, atol=1e-12)


@pytest.mark.parametrize("angle", [0.0, 1e-8, 0.999, 1.001, 2.5])
def test_derivatives_of_exponential_and_logarithm(angle):
    """At zero, beside it, at the switch of the series, and large."""
    xi = torch.tensor(
        [0.3, -0.2, 0.5, 0.6 * angle, 0.0, 0.8 * angle], dtype=torch.float64, requires_grad=True
    )
    assert torch.autograd.gradcheck(se3.exponential, xi)
    assert torch.autograd.gradcheck(lambda x: se3.logarithm(se3.exponential(x)), xi)
