"""Magnets against closed forms and against magpylib's own objects; multipoles against both.

Pairs checked here
------------------
dipole                        far field of ring and cube
ring                          outer cylinder less bore, closed form on the axis, CylinderSegment object
cube                          Cuboid object, the value of Mitchell et al.'s rest pose
multipole moments             J V / 4 pi, expansion of the closed form on the axis, published ratios
multipole field               magpylib beyond 43 mm
"""

import math

import magpylib as magpy
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from edition1.errors import InputError
from edition1.sensing._multipoles import multipole_polynomials
from edition1.sensing.magnets import _RINGS, B444B, Cube, Ring, ring


def directions(n, seed=0):
    x = np.random.default_rng(seed).normal(size=(n, 3))
    return x / np.linalg.norm(x, axis=1, keepdims=True)


def dipole(moment, x):
    r = np.linalg.norm(x, axis=-1, keepdims=True)
    z = np.array([0.0, 0.0, 1.0])
    return moment * (3 * x * x[..., 2:] / r**5 - z / r**3)


def on_axis(magnet, z):
    """Flux density of an axially magnetised ring on its axis, from two charged annuli."""
    total = 0.0
    for end, sign in ((magnet.height / 2, 1), (-magnet.height / 2, -1)):
        s = z - end
        for radius, part in ((magnet.outer_diameter / 2, -1), (magnet.inner_diameter / 2, 1)):
            total += sign * part * s / math.hypot(s, radius)
    return magnet.polarisation_mt / 2 * total


@pytest.mark.parametrize("name", _RINGS)
@pytest.mark.parametrize("z", [0.0, 0.004, 0.03, 0.055, -0.08])
def test_ring_on_its_axis(name, z):
    field = ring(name).field(np.array([0.0, 0.0, z]))
    np.testing.assert_allclose(field, [0, 0, on_axis(ring(name), z)], rtol=1e-9, atol=1e-12)


def test_ring_is_magpylibs_cylinder_segment():
    x = 0.06 * directions(20)
    r = ring("published")
    source = magpy.magnet.CylinderSegment(polarization=(0, 0, 1.45), dimension=(0.003, 0.006, 0.006, 0, 360))
    np.testing.assert_allclose(r.field(x), 1e3 * source.getB(x), rtol=1e-6, atol=1e-9)


def test_cube_is_magpylibs_cuboid():
    x = 0.02 * directions(20)
    source = magpy.magnet.Cuboid(polarization=(0, 0, 1.32), dimension=(6.35e-3,) * 3)
    np.testing.assert_allclose(B444B.field(x), 1e3 * source.getB(x), rtol=1e-12)


def test_cube_at_rest_reads_the_known_field():
    """15.83 mT at 15 mm: the rest pose of Mitchell et al. 2021."""
    assert B444B.field(np.array([0, 0, 0.015]))[2] == pytest.approx(15.83, abs=0.005)


@pytest.mark.parametrize("magnet", [*_RINGS.values(), B444B])
def test_far_field_is_a_dipole(magnet):
    if isinstance(magnet, Ring):
        volume = math.pi / 4 * (magnet.outer_diameter**2 - magnet.inner_diameter**2) * magnet.height
    else:
        volume = magnet.edge**3
    x = 2.0 * directions(50)
    expected = dipole(magnet.polarisation_mt * volume / (4 * math.pi), x)
    np.testing.assert_allclose(magnet.field(x), expected, rtol=0, atol=2e-4 * np.abs(expected).max())


@pytest.mark.parametrize("name", _RINGS)
def test_multipoles_sum_to_the_closed_form_on_the_axis(name):
    """B_z = sum (l + 1) A_l / z^(l + 2), far enough out for the series to converge to rounding."""
    r, z = ring(name), 0.12
    moments = r.multipoles(31)
    orders = np.arange(1, 32, 2)
    assert (moments * (orders + 1) / z ** (orders + 2)).sum() == pytest.approx(on_axis(r, z), rel=1e-11)


def test_multipoles_of_the_published_ring():
    moments = ring("published").multipoles(5)
    volume = math.pi * (6e-3**2 - 3e-3**2) * 6e-3
    assert moments[0] == pytest.approx(1450 * volume / (4 * math.pi), rel=1e-13)
    np.testing.assert_allclose(moments[1:] / moments[0], [-24.75e-6, 131.625e-12], rtol=1e-12)


# Largest error [mT] beyond 43 mm; the pairs of order and ring that every estimator relies on.
@pytest.mark.parametrize(
    ("name", "l_max", "bound"), [("published", 7, 1e-5), ("released", 9, 1e-5), ("released", 7, 2e-4)]
)
def test_multipole_field_against_magpylib(name, l_max, bound):
    rng = np.random.default_rng(1)
    x = directions(20_000, seed=2) * rng.uniform(0.043, 0.3, (20_000, 1))
    d = np.linalg.norm(x, axis=1)
    c = x[:, 2] / d
    along_axis, along_offset = multipole_polynomials(l_max)
    weights = ring(name).multipoles(l_max) / d[:, None] ** (np.arange(1, l_max + 1, 2) + 2)
    powers = c[:, None] ** np.arange(l_max + 1)
    f, g = ((weights * (powers @ p.T)).sum(1) for p in (along_axis, along_offset))
    series = f[:, None] * np.array([0, 0, 1]) + (g / d)[:, None] * x
    assert np.abs(series - ring(name).field(x)).max() < bound


@given(st.floats(0.03, 0.2), st.floats(0, math.pi), st.floats(-math.pi, math.pi))
def test_field_turns_with_the_axis_and_is_even(r, theta, phi):
    """A rotation about the axis turns the field; B(-x) = B(x) for a magnet symmetric about its middle."""
    x = r * np.array([math.sin(theta), 0.0, math.cos(theta)])
    c, s = math.cos(phi), math.sin(phi)
    turn = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
    magnet = ring("released")
    b = magnet.field(x)
    np.testing.assert_allclose(magnet.field(turn @ x), turn @ b, rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(magnet.field(-x), b, rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("shape", [(), (1,), (3, 1, 2), (0,)])
def test_shapes(shape):
    x = np.full((*shape, 3), 0.05)
    assert ring("released").field(x).shape == x.shape


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: ring("small"), "Input name of ring must be one of 'released', 'published'; .* 'small'."),
        (lambda: Ring(6e-3, 12e-3, 6e-3, 1450.0), "Input dimensions of Ring must be 0 <= inner < outer"),
        (lambda: Ring(12e-3, 6e-3, -6e-3, 1450.0), "Input dimensions of Ring"),
        (lambda: Cube(0.0, 1320.0), r"Input edge of Cube must be positive \[m\]; instead received 0.0."),
        (
            lambda: ring("released").multipoles(4),
            "Input l_max of Ring.multipoles must be a positive odd number",
        ),
        (lambda: B444B.field(np.array([0.0, math.nan, 0.0])), "Input positions of field must be finite"),
    ],
)
def test_bad_input(call, message):
    with pytest.raises(InputError, match=message):
        call()
