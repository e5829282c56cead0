"""Closed-form cuboid and the sensor of one bent arc: against magpylib, the dipole, and the facts of the paper.

| physics | reference |
| --- | --- |
| cuboid, any point outside | magpylib |
| far away | dipole of moment J V |
| bent arc by its mirror image | poses of the kinematics and magpylib |
"""

import math

import magpylib as magpy
import numpy as np
import pytest
import torch

from edition1.errors import InputError
from edition1.estimation.levenberg_marquardt import jacobian
from edition1.kernels._bend import CompiledBendSensor
from edition1.kinematics.bend import bend_vector
from edition1.sensing._cuboid import cuboid_field
from edition1.sensing.bend_sensor import BendSensor
from edition1.sensing.magnetic import field_at_sensors
from edition1.sensing.magnets import B444B
from edition1_companion.twins.bend_curves import bend_robot

DIMENSIONS = (4e-3, 6e-3, 9e-3)


def outside(n, seed=0):
    p = 8e-3 * torch.randn(n, 3, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)
    return p[(2 * p.abs() > 1.01 * torch.tensor(DIMENSIONS)).any(-1)]


def test_cuboid_is_that_of_magpylib():
    p = outside(2000)
    theirs = magpy.func.cuboid_field(
        "B",
        p.numpy(),
        dimensions=np.broadcast_to(np.array(DIMENSIONS), p.shape),
        polarizations=np.broadcast_to(np.array([0.0, 0.0, 1.32]), p.shape),
    )
    np.testing.assert_allclose(cuboid_field(p, DIMENSIONS, 1320.0), 1e3 * theirs, atol=1e-10, rtol=0)


@pytest.mark.parametrize("shape", [(), (1,), (0,), (3, 1, 2)])
def test_batches(shape):
    p = 0.02 + torch.rand(*shape, 3, dtype=torch.float64)
    field = cuboid_field(p, DIMENSIONS, 1320.0)
    assert field.shape == p.shape
    one_by_one = [cuboid_field(x, DIMENSIONS, 1320.0) for x in p.reshape(-1, 3)]
    expected = torch.stack(one_by_one) if one_by_one else torch.zeros(0, 3).double()
    torch.testing.assert_close(field.reshape(-1, 3), expected)


def test_far_away_it_is_the_dipole():
    p = outside(50) * 100
    r = torch.linalg.vector_norm(p, dim=-1, keepdim=True)
    m = 1320.0 * math.prod(DIMENSIONS) / (4 * math.pi) * torch.tensor([0.0, 0.0, 1.0]).double()
    dipole = 3 * p * (p @ m).unsqueeze(-1) / r**5 - m / r**3
    error = (cuboid_field(p, DIMENSIONS, 1320.0) - dipole).abs() * r**3
    # The next moment is smaller by (size/distance)^2; rounding of the closed form grows with the distance cubed.
    assert float((error / (m.norm() * 20 * (9e-3 / r) ** 2 + 1e-10)).max()) < 1


def test_derivatives_also_on_the_axis():
    points = torch.tensor(
        [[0.0, 0.0, 0.015], [0.004, 0.0, -0.013], [-0.01, 0.002, 0.001]], dtype=torch.float64
    )
    scaled = points.clone().mul_(1e3).requires_grad_()
    assert torch.autograd.gradcheck(lambda p: cuboid_field(1e-3 * p, DIMENSIONS, 1320.0), scaled)


def test_field_has_no_sources():
    p = outside(20)
    J = torch.func.vmap(torch.func.jacfwd(lambda x: cuboid_field(x, DIMENSIONS, 1.0)))(p)
    scale = J.abs().amax((-1, -2))
    assert float((J.diagonal(dim1=-2, dim2=-1).sum(-1).abs() / scale).max()) < 1e-9
    assert float(((J - J.mT).abs().amax((-1, -2)) / scale).max()) < 1e-9


@pytest.mark.parametrize("length", [13e-3, 15e-3])
def test_bend_sensor_reads_what_poses_and_magpylib_say(length):
    q = torch.pi * (torch.rand(200, 2, generator=torch.Generator().manual_seed(1), dtype=torch.float64) - 0.5)
    q = torch.cat([q, torch.zeros(1, 2).double(), 1e-9 * q[:1]])
    robot = bend_robot(length)
    sensor = BendSensor(length)
    torch.testing.assert_close(sensor(q), field_at_sensors(robot, q, B444B)[..., 0, :], atol=1e-11, rtol=0)
    torch.testing.assert_close(sensor.position(q), robot.magnet_poses(q)[..., 0, :3, 3], atol=1e-16, rtol=0)


@pytest.mark.parametrize(
    ("degrees", "axial", "radial", "absolute", "singular"),
    [
        (0, 15.83, 0.00, 15.83, (4.06, 4.06)),
        (30, 15.87, 2.10, 16.00, (4.03, 3.90)),
        (60, 16.02, 4.03, 16.51, (3.89, 3.34)),
        (90, 16.47, 5.50, 17.36, (3.60, 2.40)),
    ],
)
def test_ideal_field_over_the_bend_space(degrees, axial, radial, absolute, singular):
    """Golden values: magpylib's Cuboid on the arc of Mitchell et al. (2021), section III, 15 mm long.

    Its polarisation is 1.32 T, as in the authors' code (github.com/MasonDMitchell/pose-chain, magsim.py at 954a759).
    The cube is not quite axisymmetric: the values are means over the directions, where it matters.
    """
    direction = torch.linspace(0, 2 * torch.pi, 17, dtype=torch.float64)[:-1]
    q = bend_vector(torch.full_like(direction, math.radians(degrees)), direction)
    u, J = jacobian(BendSensor(15e-3), q)
    towards = torch.stack([direction.cos(), direction.sin()], dim=-1)
    assert float(u[:, 2].mean()) == pytest.approx(axial, abs=0.006)
    assert float((u[:, :2] * towards).sum(-1).mean()) == pytest.approx(radial, abs=0.006)
    assert float(torch.linalg.vector_norm(u, dim=-1).mean()) == pytest.approx(absolute, abs=0.006)
    np.testing.assert_allclose(torch.linalg.svdvals(J)[0], singular, atol=0.006)


def test_compiled_bend_sensor_reads_the_same():
    q = torch.pi * (
        torch.rand(3, 200, 2, generator=torch.Generator().manual_seed(2), dtype=torch.float64) - 0.5
    )
    # At the straight pose, on the axes, and on both sides of the switch to the series.
    q[0, :5] = torch.tensor([[0.0, 0.0], [1e-9, 0.0], [0.0, -0.0316], [0.0317, 0.0], [-1.5, 0.0]])
    for length in (10e-3, 15e-3):
        fast = CompiledBendSensor(length)(q)
        torch.testing.assert_close(fast, BendSensor(length)(q), atol=1e-11, rtol=0)
    assert CompiledBendSensor(15e-3)(q[0, 0].float()).dtype == torch.float32


def test_bend_sensor_is_differentiable_where_it_is_straight():
    q = torch.zeros(2, dtype=torch.float64, requires_grad=True)
    assert torch.autograd.gradcheck(BendSensor(15e-3), q)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (
            lambda: cuboid_field(torch.ones(3).double(), (1.0, 0.0, 1.0), 1.0),
            r"Input dimensions of cuboid_field must be positive \[m\]; instead received \(1.0, 0.0, 1.0\).",
        ),
        (
            lambda: BendSensor(0.0),
            r"Input length of BendSensor must be positive \[m\]; instead received 0.0.",
        ),
        (
            lambda: CompiledBendSensor(-1.0),
            r"Input length of CompiledBendSensor must be positive \[m\]; instead received -1.0.",
        ),
    ],
)
def test_bad_input(call, message):
    with pytest.raises(InputError, match=message):
        call()
