"""A rod of a series of strains: closed forms of one and two terms, and the order of its integration."""

import math

import pytest
import torch

from edition1.errors import InputError
from edition1.kinematics.affine_curvature import AffineCurvature
from edition1.kinematics.strain_series import StrainSeries

LENGTH = 0.3
V = torch.tensor([0.0, 0.2, 0.5, 0.73, 1.0]).double()


def test_one_term_about_x_is_an_arc_of_that_curvature():
    rod = StrainSeries(LENGTH, bending=1, torsion=0, parts=3)
    T = rod.pose(torch.tensor([4.0, 0.0]).double(), V)
    s = 4.0 * LENGTH * V
    torch.testing.assert_close(T[:, 1, 3], -(1 - s.cos()) / 4)
    torch.testing.assert_close(T[:, 2, 3], s.sin() / 4)
    torch.testing.assert_close(T[:, 1, 1], s.cos())


def test_bending_and_twist_together_make_a_helix():
    """Of curvature k and torsion t: its pitch angle, and a radius of k / (k^2 + t^2)."""
    k, t = 6.0, 8.0
    rod = StrainSeries(LENGTH, bending=1, torsion=1, parts=1)
    T = rod.pose(torch.tensor([k, 0.0, t]).double(), torch.linspace(0, 1, 200).double())
    axis = torch.tensor([k, 0.0, t]).double() / math.hypot(k, t)
    along = T[:, :3, 3] @ axis
    torch.testing.assert_close(along, LENGTH * torch.linspace(0, 1, 200).double() * t / math.hypot(k, t))
    across = T[:, :3, 3] - along[:, None] * axis
    centre = torch.linalg.cross(axis, torch.tensor([0.0, 0.0, 1.0]).double())
    centre = centre / centre.norm() * k / (k * k + t * t)
    torch.testing.assert_close(
        (across - centre).norm(dim=-1), torch.full((200,), k / (k * k + t * t)).double()
    )


@pytest.mark.parametrize("parts", [8, 16])
def test_two_terms_are_affine_curvature_to_second_order(parts):
    """Of the mean 3 and the slope 4 about x; the error falls by four when the pieces are halved."""
    mean, slope = 1.5, 4.0
    q = torch.tensor([mean / LENGTH, slope / LENGTH / math.sqrt(12), 0.0, 0.0]).double()
    affine = AffineCurvature(LENGTH).pose(torch.tensor([mean - slope / 2, slope, 0.0, 0.0]).double(), V)

    def error(parts):
        return float((StrainSeries(LENGTH, 2, 0, parts).pose(q, V) - affine)[-1, :3, 3].norm())

    assert error(parts) < 0.01 * LENGTH * (8 / parts) ** 2
    assert error(parts) / error(2 * parts) == pytest.approx(4.0, rel=0.05)


@pytest.mark.parametrize("scale", [0.0, 1e-8, 1.0, 20.0])
def test_derivatives(scale):
    rod = StrainSeries(LENGTH, bending=2, torsion=1, parts=4)
    q = scale * torch.tensor([1.0, -0.5, 0.3, 0.8, 0.2]).double()
    assert torch.autograd.gradcheck(lambda q: rod.pose(q, V[1:]), q.requires_grad_())


def test_names_and_numbers_of_the_terms():
    rod = StrainSeries(LENGTH, bending=2, torsion=1)
    assert rod.coordinates == ("kappa_x0", "kappa_x1", "kappa_y0", "kappa_y1", "kappa_z0")
    assert rod.n_q == 5


def test_terms_are_of_unit_mean_square():
    basis = StrainSeries(LENGTH, bending=3, torsion=0, parts=400).basis[:, 0, :3]
    torch.testing.assert_close(
        torch.from_numpy(basis.T @ basis / 400), torch.eye(3).double(), atol=1e-4, rtol=0
    )


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: StrainSeries(0.0), "Input length of StrainSeries must be positive"),
        (lambda: StrainSeries(0.1, 0, 0), r"Input bending, torsion of StrainSeries .* \(0, 0\)"),
        (lambda: StrainSeries(0.1, 3, 1, parts=2), "Input parts of StrainSeries must be at least the number"),
        (lambda: StrainSeries(0.1, 1, 0).pose(torch.zeros(3), V), "Input q of .* of last dimension 2"),
        (lambda: StrainSeries(0.1, 1, 0).pose(torch.full((2,), math.nan), V), "Input q of .* finite"),
    ],
)
def test_bad_input(make, message):
    with pytest.raises(InputError, match=message):
        make()
