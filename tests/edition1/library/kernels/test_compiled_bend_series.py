"""The polynomial for the field of a bent arc: against magpylib, its symmetries, and where it is refused."""

import math

import numpy as np
import pytest
import torch

from edition1.errors import InputError
from edition1.kernels._bend import CompiledBendSensor
from edition1.kernels._bend_series import BendSeries
from edition1.sensing.magnets import Cube
from edition1_companion.twins.bend_curves import bend_readings

REACH = math.pi / 2


def bends(n=5000, reach=REACH, seed=0):
    rng = np.random.default_rng(seed)
    radius, direction = reach * np.sqrt(rng.random(n)), 2 * math.pi * rng.random(n)
    return torch.from_numpy(np.stack([radius * np.cos(direction), radius * np.sin(direction)], axis=1))


@pytest.mark.parametrize(
    ("length", "tolerance"), [(15e-3, 1e-8), (14e-3, 5e-8), (13e-3, 2e-7), (12e-3, 1e-6)]
)
def test_equals_magpylib(length, tolerance):
    q, series = bends(), BendSeries(length, REACH)
    assert float((series(q) - bend_readings(q, length)).abs().max()) < tolerance


@pytest.mark.parametrize("reach", [0.1, 1.0, REACH, 2.2])
@pytest.mark.parametrize("edge", [3e-3, 6.35e-3])
def test_error_is_certified_on_other_points(reach, edge):
    cube = Cube(edge, 1000.0)
    series, q = BendSeries(15e-3, reach, cube), bends(20_000, reach, seed=1)
    difference = float((series(q) - CompiledBendSensor(15e-3, cube)(q)).abs().max())
    assert difference < 1.1 * series.error_mt + 1e-12


def test_symmetries_are_exact():
    """A quarter turn about the straight arc turns the field, a mirror mirrors it."""
    q, series = bends(50), BendSeries(15e-3, REACH)
    u = series(q)
    x, y = q.unbind(-1)
    turned = series(torch.stack([-y, x], dim=-1))
    torch.testing.assert_close(turned, torch.stack([-u[:, 1], u[:, 0], u[:, 2]], dim=-1), atol=1e-14, rtol=0)
    mirrored = series(torch.stack([-x, y], dim=-1))
    torch.testing.assert_close(mirrored, u * torch.tensor([-1.0, 1.0, 1.0]), atol=1e-14, rtol=0)


@pytest.mark.parametrize("shape", [(), (1,), (3, 1, 2), (0,)])
def test_batches_and_precision(shape):
    q, series = torch.zeros(*shape, 2), BendSeries(15e-3, REACH)
    assert series(q).shape == (*shape, 3)
    assert series(q).dtype == torch.float32


def test_refuses():
    with pytest.raises(InputError, match=r"length of BendSeries must be positive \[m\]"):
        BendSeries(0.0, 1.0)
    with pytest.raises(InputError, match=r"reach of BendSeries must be between 0 and pi \[rad\]"):
        BendSeries(15e-3, math.pi)
    with pytest.raises(
        InputError,
        match=r"within 0.0001 mT of the closed form; instead received 0.008 m and 1.5708 rad, 0.\d+ mT",
    ):
        BendSeries(8e-3, REACH)
    with pytest.raises(InputError, match=r"q of BendSeries must be of a bend of 1 rad at most"):
        BendSeries(15e-3, 1.0)(torch.tensor([1.0, 0.1]))
