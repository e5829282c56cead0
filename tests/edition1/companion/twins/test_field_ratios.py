"""Axes of the recordings, and ratios that know no gain."""

import math

import pytest
import torch

from edition1.sensing.bend_sensor import BendSensor
from edition1_companion.recordings.mitchell2021_conventions import MODEL_FROM_FILE, file_axes, model_axes
from edition1_companion.twins.field_ratios import FieldRatios, transverse_to_axial

TURN = torch.tensor([[0.6, 0.8], [-0.8, 0.6]], dtype=torch.float64)


def test_axes_lead_there_and_back():
    field = torch.tensor([[-22.0, 1.0, 0.5], [-12.0, -3.0, 4.0]], dtype=torch.float64)
    torch.testing.assert_close(file_axes(model_axes(field)), field)
    torch.testing.assert_close(MODEL_FROM_FILE @ MODEL_FROM_FILE.T, torch.eye(3, dtype=torch.float64))


@pytest.mark.parametrize("gain", [0.5, 1.154, 3.0])
def test_gain_does_not_matter(gain):
    u = torch.tensor([[1.0, -2.0, 20.0], [3.0, math.nan, 20.0]], dtype=torch.float64)
    torch.testing.assert_close(transverse_to_axial(gain * u), transverse_to_axial(u), equal_nan=True)
    assert transverse_to_axial(u)[1].isnan().all()


def test_ratio_is_that_of_a_dipole_far_from_the_cube():
    angle = torch.linspace(0.1, 1.5, 8, dtype=torch.float64)
    q = torch.stack([angle, torch.zeros_like(angle)], dim=-1)
    found = FieldRatios(BendSensor(1.0), torch.eye(2, dtype=torch.float64))(q)[:, 0]
    torch.testing.assert_close(found, angle.sin() / (3 + angle.cos()), rtol=1e-4, atol=0.0)


def test_length_matters_little():
    q = torch.tensor([math.radians(50), 0.0], dtype=torch.float64)
    one, other = (FieldRatios(BendSensor(length), TURN)(q).norm() for length in (13e-3, 15e-3))
    assert float(one / other) == pytest.approx(1, abs=0.02)


def test_matrix_scales_and_turns():
    q = torch.tensor([0.4, 0.2], dtype=torch.float64)
    sensor = BendSensor(13e-3)
    torch.testing.assert_close(FieldRatios(sensor, 2 * TURN)(q), 2 * TURN @ transverse_to_axial(sensor(q)))
