"""The rod at rest against arcs, beam theory and the elastica in closed form."""

import math
from dataclasses import replace

import pytest
import torch
from scipy.optimize import brentq
from scipy.special import ellipk, ellipkinc

from edition1.errors import InputError
from edition1.kinematics.constant_curvature import ConstantCurvature
from edition1_companion.twins.segment_motion import SHEAR_FACTOR, StaticRod

ROD = StaticRod(length_m=0.11, radius_m=0.011, youngs_modulus_pa=1e6)
STRAIGHT, ONE = torch.zeros(2, dtype=torch.float64), torch.tensor(1.0, dtype=torch.float64)


def force(*components):
    return torch.tensor(components, dtype=torch.float64)


def thin(rod, factor):
    """A rod of the same bending stiffness that hardly stretches or shears."""
    return replace(rod, radius_m=rod.radius_m / factor, youngs_modulus_pa=rod.youngs_modulus_pa * factor**4)


def test_without_a_force_it_is_the_arc_of_its_rest_shape():
    bend = torch.tensor([[0.0, 0.0], [0.7, -0.4], [1e-9, 0.0]], dtype=torch.float64)
    stretch = torch.tensor([1.0, 1.05, 0.98], dtype=torch.float64)
    found = ROD.equilibrium(bend, stretch, force(0.0, 0.0, 0.0))
    arc = ConstantCurvature(0.11, 0.022)
    q = torch.cat([0.022 * bend, 0.11 * (stretch - 1).unsqueeze(-1)], dim=-1)
    expected = arc.pose(q.unsqueeze(-2), torch.linspace(0, 1, 45))
    assert torch.allclose(found, expected, atol=1e-9)  # the arc lengths are rounded to single precision
    assert found[0, 10, 2, 3].item() == pytest.approx(10 * 2.5e-3, rel=1e-12)


def test_a_little_force_bends_it_as_a_beam_with_shear():
    push = 1e-4
    tip = ROD.equilibrium(STRAIGHT, ONE, force(0.0, push, 0.0))[-1]
    shear = SHEAR_FACTOR * ROD.youngs_modulus_pa / 3 * math.pi * ROD.radius_m**2
    expected = push * (0.11**3 / (3 * ROD.bending_stiffness) + 0.11 / shear)
    assert tip[1, 3].item() == pytest.approx(expected, rel=2e-4)  # 44 elements
    assert tip[1, 2].item() == pytest.approx(push * 0.11**2 / (2 * ROD.bending_stiffness), rel=1e-6)


def test_a_pull_along_it_stretches_it_by_hookes_law():
    tip = ROD.equilibrium(STRAIGHT, ONE, force(0.0, 0.0, 2.0))[-1]
    strain = 2.0 / (ROD.youngs_modulus_pa * math.pi * ROD.radius_m**2)
    assert tip[2, 3].item() == pytest.approx(0.11 * (1 + strain), rel=1e-12)


@pytest.mark.parametrize("load", [0.5, 1.5])
def test_a_large_force_gives_the_elastica(load):
    """Tip angle by elliptic integrals: sqrt(F L^2/EI) = K(k) - F(asin(1/(k sqrt 2)), k), 2 k^2 = 1 + sin(angle)."""

    def defect(angle):
        m = (1 + math.sin(angle)) / 2
        return ellipk(m) - ellipkinc(math.asin(math.sqrt(0.5 / m)), m) - math.sqrt(load)

    angle = brentq(defect, 1e-9, math.pi / 2 - 1e-6)
    rod = thin(replace(ROD, elements=88), 20)
    push = load * rod.bending_stiffness / rod.length_m**2
    tip = rod.equilibrium(STRAIGHT, ONE, force(push, 0.0, 0.0))[-1]
    assert math.asin(tip[0, 2]) == pytest.approx(angle, rel=2e-4)


def test_too_large_a_force_is_refused():
    with pytest.raises(
        InputError, match=r"must be small enough for an equilibrium of a rod of E I = 0.0115 N m²"
    ):
        ROD.equilibrium(STRAIGHT, ONE, force(1e3, 0.0, 0.0))
