"""What the chapters derive: each step in symbols, and its end against the library."""

from __future__ import annotations

import math

import numpy as np
import pytest
import sympy as sp
from numpy.testing import assert_allclose

from edition1 import pcc_extended
from edition1.estimation.imu_models import exact_arcs, rigid_links
from edition1.estimation.imu_selection import Selection
from edition1_companion.pages.how_many_imus import curves as imu_curves


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
