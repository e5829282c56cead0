"""The inversion of ratios against the model it inverts, and its deviation against Monte Carlo."""

import math

import pytest
import torch

from edition1.kinematics.bend import MAX_BEND, bend_vector
from edition1.sensing.bend_sensor import BendSensor
from edition1_companion.twins.field_ratios import FieldRatios, _dipole_bend, invert

MATRIX = torch.tensor([[0.6, 0.25], [-0.3, 0.55]], dtype=torch.float64)
DIRECTIONS = torch.linspace(0, 2 * math.pi, 17, dtype=torch.float64)


def test_dipole_is_inverted_up_to_its_largest_ratio():
    phi = torch.linspace(0, 1.9, 50, dtype=torch.float64)
    torch.testing.assert_close(_dipole_bend(phi.sin() / (3 + phi.cos())), phi)
    assert float(_dipole_bend(torch.tensor(0.6, dtype=torch.float64))) > math.radians(109)


@pytest.mark.parametrize("length_m", [13e-3, 15e-3])
@pytest.mark.parametrize("bend_deg", [0.0, 1e-6, 1.0, 50.0, 85.0])
def test_model_is_inverted(length_m, bend_deg):
    model = FieldRatios(BendSensor(length_m), MATRIX)
    q = bend_vector(torch.full_like(DIRECTIONS, math.radians(bend_deg)), DIRECTIONS)
    found, deviation = invert(model(q), model, 1e-3)
    torch.testing.assert_close(found, q, rtol=0, atol=1e-12)
    assert bool((deviation > 0).all())


def test_bends_beyond_the_bound_stay_there_and_missing_ratios_stay_missing():
    model = FieldRatios(BendSensor(13e-3), MATRIX)
    measured = torch.tensor([[0.5, 0.0], [math.nan, math.nan], [0.1, 0.0]], dtype=torch.float64)
    q, deviation = invert(measured, model, 1e-3)
    assert float(q[0].norm()) == pytest.approx(MAX_BEND)
    assert q[1].isnan().all()
    assert deviation.isnan().tolist() == [False, True, False]
    alone, _ = invert(measured[2:], model, 1e-3)
    torch.testing.assert_close(q[2:], alone)


@pytest.mark.parametrize("bend_deg", [20.0, 60.0])
def test_deviation_is_that_of_many_noisy_ratios(bend_deg):
    model = FieldRatios(BendSensor(13e-3), MATRIX)
    q = bend_vector(torch.tensor(math.radians(bend_deg), dtype=torch.float64), torch.tensor(0.7))
    generator = torch.Generator().manual_seed(0)
    noise = 1e-3 * torch.randn((4000, 2), generator=generator, dtype=torch.float64)
    found, deviation = invert(model(q) + noise, model, 1e-3)
    assert float(found.norm(dim=-1).std()) == pytest.approx(float(deviation.mean()), rel=0.05)
