"""What the chapters derive: each step in symbols, and its end against the library."""

from __future__ import annotations

import math

import numpy as np
import pytest
import sympy as sp
import torch
from numpy.testing import assert_allclose

from edition1 import BendSensor, ConstantCurvature, LinearisedSensing, pcc_extended
from edition1.estimation.imu_models import exact_arcs, rigid_links
from edition1.estimation.imu_selection import Selection
from edition1.estimation.information import fisher_information
from edition1.kinematics.bend import Bend
from edition1.kinematics.paper_robots import pcc_robot
from edition1.sensing.magnets import ring
from edition1.sensing.multipole import MultipoleField
from edition1_companion.pages.how_many_imus import curves as imu_curves
from edition1_companion.twins.calibrated_robots import box
from edition1_companion.twins.robot_tables import misprint

QUARTER_MM = 34.56
"""Bending in the exercise of the first chapter: a right angle on the radius of 22 mm."""


def test_equation_15_is_the_integral_of_the_tangent():
    v, w, bend, d, length = sp.symbols("v w Delta d L", positive=True)
    across = length * sp.integrate(sp.sin(w * bend / d), (w, 0, v))
    ahead = length * sp.integrate(sp.cos(w * bend / d), (w, 0, v))
    assert sp.simplify(across - d * length / bend * (1 - sp.cos(v * bend / d))) == 0
    assert sp.simplify(ahead - d * length / bend * sp.sin(v * bend / d)) == 0
    assert sp.limit(ahead / v, v, 0) == length  # the printed position begins a length above the base
    assert sp.limit(across / v, v, 0) == 0


def test_tangent_of_the_library_is_the_last_column():
    segment = ConstantCurvature(0.11, 0.022)
    q = torch.tensor([0.01, -0.02, 0.003], dtype=torch.float64)
    v = torch.linspace(0, 1, 9, dtype=torch.float64)
    tangents = torch.stack([torch.func.jacfwd(lambda w: segment.pose(q, w)[:3, 3])(x) for x in v])
    assert_allclose(tangents, 0.113 * segment.pose(q, v)[:, :3, 2], atol=1e-12)


def test_exercise_right_angle():
    """Both curves end at 2 L / pi to the side and ahead; the printed one begins at L."""
    table = misprint(QUARTER_MM)
    last = table.iloc[-1][["x_mm", "z_mm", "x_printed_mm", "z_printed_mm"]]
    assert_allclose(last, 2 * 110 / math.pi, atol=0.02)
    assert_allclose(table.iloc[0][["x_printed_mm", "z_printed_mm"]], [0, 110], atol=2.5)


@pytest.mark.parametrize("order", [1, 2, 3, 5])
def test_gradient_of_a_term_of_the_potential(order):
    """In the plane of axis and point: the part along the axis and the part towards the point."""
    x, z = sp.symbols("x z", positive=True)
    d = sp.sqrt(x * x + z * z)
    c = sp.Symbol("c")
    slope, above = sp.diff(sp.legendre(order, c), c), sp.diff(sp.legendre(order + 1, c), c)
    assert sp.expand(c * slope + (order + 1) * sp.legendre(order, c) - above) == 0
    potential = sp.legendre(order, z / d) / d ** (order + 1)
    along, towards = -slope.subs(c, z / d), above.subs(c, z / d)
    field = [towards * x / d, along + towards * z / d]
    for coordinate, component in zip((x, z), field, strict=True):
        assert sp.simplify(-sp.diff(potential, coordinate) - component / d ** (order + 2)) == 0


def test_moments_of_a_ring():
    rho, a, b, h, J = sp.symbols("rho a b h J", positive=True)
    r = sp.sqrt(rho**2 + h**2 / 4)
    magnet = ring("released")
    sizes = {
        a: magnet.inner_diameter / 2,
        b: magnet.outer_diameter / 2,
        h: magnet.height,
        J: magnet.polarisation_mt,
    }
    moments = [
        J * sp.integrate(sp.expand(rho * r**n * sp.legendre(n, h / 2 / r)), (rho, a, b)) for n in (1, 3, 5)
    ]
    assert sp.simplify(moments[0] - J * h * (b**2 - a**2) / 4) == 0
    assert_allclose([float(moment.subs(sizes)) for moment in moments], magnet.multipoles(5), rtol=1e-12)


def test_series_is_the_field():
    """The reading by eq. (5) and the angles, against magpylib; a dipole of half the diameters has a quarter."""
    magnet, point = ring("released"), np.array([0.03, 0.0, 0.05])
    direction = np.array([0.6, 0.0, 0.8])
    d = np.linalg.norm(point)
    cosines = torch.tensor([0.0, d, direction[2], point @ direction / d, point[2] / d], dtype=torch.float64)
    assert_allclose(MultipoleField.of(magnet, 11)(cosines), magnet.field(point) @ direction, atol=1e-6)
    assert_allclose(ring("published").multipoles(1) / magnet.multipoles(1), 1 / 4)


def derivatives(n_sensors: int, q: torch.Tensor | None = None) -> torch.Tensor:
    """Return the derivatives of the readings of one segment by its configuration [mT/m], straight by default."""
    moments = torch.as_tensor(ring("released").multipoles(9))
    at = torch.zeros(3, dtype=torch.float64) if q is None else q
    return LinearisedSensing(pcc_robot(1, n_sensors), moments).linearise(at)[1]


@pytest.mark.parametrize("n", [3, 4, 6, 12])
def test_straight_segment_with_a_ring_of_sensors(n):
    azimuth = 2 * math.pi * torch.arange(n, dtype=torch.float64) / n
    (a, _, b) = derivatives(1)[0]
    rows = torch.stack([a * azimuth.cos(), a * azimuth.sin(), b.expand(n)], -1)
    assert_allclose(derivatives(n), rows, atol=1e-9)
    information = torch.diag(n * torch.stack([a * a / 2, a * a / 2, b * b]))
    assert_allclose(fisher_information(rows, 1.0), information, atol=1e-8)


def test_two_sensors_leave_a_bending_open():
    (a, _, b) = derivatives(1)[0]
    seen = torch.linalg.eigvalsh(fisher_information(derivatives(2), 1.0))
    assert_allclose(seen, [0, 2 * a * a, 2 * b * b], atol=1e-8)


def test_three_sensors_determine_every_shape_of_the_box():
    low, high = box(1)
    share = torch.rand(4000, 3, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    smallest = torch.linalg.svdvals(derivatives(3, low + share * (high - low)))[:, -1].min()
    assert smallest > 0.5 * torch.linalg.svdvals(derivatives(3))[-1]


def test_bend_space():
    """The series of both functions, and an arc that looks alike from both ends."""
    phi = sp.Symbol("phi", positive=True)
    along, side = sp.sin(phi) / phi, (1 - sp.cos(phi)) / phi
    assert sp.series(along, phi, 0, 4).removeO() == 1 - phi**2 / 6
    assert sp.series(side / phi, phi, 0, 4).removeO() == sp.Rational(1, 2) - phi**2 / 24
    turn = sp.Matrix([[sp.cos(phi), sp.sin(phi)], [-sp.sin(phi), sp.cos(phi)]])
    seen = -turn.T * sp.Matrix([side, along])
    assert sp.simplify(seen - sp.Matrix([side, -along])) == sp.zeros(2, 1)
    assert sp.simplify(side**2 + along**2 - (sp.sin(phi / 2) / (phi / 2)) ** 2) == 0


def test_bend_space_of_the_library():
    length, q = 0.015, torch.tensor([[0.4, -1.1], [1e-9, 0.0], [2.0, 1.5]], dtype=torch.float64)
    pose = Bend(length).pose(q, torch.ones((), dtype=torch.float64))
    p, z = pose[:, :3, 3], (q * q).sum(-1)
    seen = -(pose[:, :3, :3].mT @ p[:, :, None])[..., 0]
    assert_allclose(p, BendSensor(length).position(q), atol=1e-15)
    assert_allclose(seen, p * torch.tensor([1.0, 1.0, -1.0]), atol=1e-15)
    assert_allclose(p.norm(dim=-1), length * torch.sinc(z.sqrt() / 2 / math.pi), atol=1e-15)


def about_y(angle: float) -> list[float]:
    """Return the quaternion XYZW of a turn about the y axis."""
    return [0.0, math.sin(angle / 2), 0.0, math.cos(angle / 2)]


@pytest.mark.parametrize("n", [1, 2, 5])
@pytest.mark.parametrize("beta", [0.1, 1.2])
def test_interpolated_links(beta, n):
    """The chain has the direction of the arc, its length is off by the factor; a rigid link is off sideways."""
    length, ends = 0.08, np.array([about_y(0.0), about_y(beta)])
    link = Selection((0, 1), (0.0, length), (length,), (length, length), sub_links=n)
    arc, chain = (model(ends, link, [length])[0] for model in (exact_arcs, pcc_extended))
    mean = np.exp(1j * beta / 2) * np.sinc(beta / 2 / np.pi)
    assert_allclose(arc[[2, 0]], length * np.array([mean.real, mean.imag]), atol=1e-15)
    factor = beta / 2 / n / math.sin(beta / 2 / n)
    assert_allclose(chain, factor * arc, atol=1e-15)
    assert_allclose(factor - 1, beta**2 / 24 / n**2, rtol=0.1)
    far = Selection((1,), (length,), (length,), (length, length))
    rigid = rigid_links(ends[1:], far, [length])[0]
    assert_allclose(np.linalg.norm(rigid - arc), length * beta / 2, rtol=0.1)


def test_sum_of_evenly_turned_links():
    beta, t = sp.symbols("beta t", positive=True)
    mean = sp.integrate(sp.exp(sp.I * beta * t), (t, 0, 1))
    half = sp.exp(sp.I * beta / 2) * sp.sin(beta / 2)
    assert sp.simplify((mean - half * 2 / beta).rewrite(sp.exp)) == 0
    for n in (1, 2, 5):
        links = sum(sp.exp(sp.I * beta * sp.Rational(2 * k + 1, 2 * n)) for k in range(n))
        assert abs(complex((links - half / sp.sin(beta / (2 * n))).subs(beta, 1.4))) < 1e-12


def imus_by_rule(length_m: float, curvature: float, slope: float, tolerance_m: float) -> tuple[float, float]:
    """Return what the rule for designers asks for: rigid links that end at their IMU, and two sub-segments."""
    chain = length_m * math.sqrt(length_m / tolerance_m * (3 * slope / 32 + curvature**2 / 96))
    return curvature * length_m**2 / 2 / tolerance_m, chain


def test_exercises_on_the_rule_for_designers():
    """More curvature; and longer arms, whose random curves do not reach the limit of the slope."""
    rigid, chain = imus_by_rule(0.64, 8.0, 60.0, 0.01)
    assert_allclose(np.divide(imus_by_rule(0.64, 16.0, 60.0, 0.01), (rigid, chain)), [2, 1.15], atol=0.005)
    assert_allclose(np.divide(imus_by_rule(1.28, 8.0, 60.0, 0.01), (rigid, chain)), [4, 2 * math.sqrt(2)])
    longer = imu_curves.random_curves(20, length_m=1.28, curvature=8.0, slope=60.0, seed=0)
    occurring = imus_by_rule(1.28, float(longer.curvature.max()), float(longer.slope.max()), 0.01)
    assert_allclose(np.divide(occurring, (rigid, chain)), [4, 2.2], atol=0.05)
