"""Fields and moments of magnets, and simulated readings."""

from __future__ import annotations

import numpy as np
import pytest

from repro import (
    ConstantCurvature,
    Cube,
    Disc,
    FreeBody,
    Imu,
    InputError,
    Magnet,
    Ring,
    Robot,
    Sensor,
    simulated_readings,
)

from .robots import RELEASED

SHAPES = (RELEASED, Disc(8e-3, 3e-3, 1300.0), Cube(6.35e-3, 1320.0))


def series(moments, position):
    """Axial multipoles by their scalar potential, differentiated numerically."""

    def potential(p):
        r = np.linalg.norm(p)
        terms = [
            A / r ** (2 * k + 2) * np.polynomial.Legendre.basis(2 * k + 1)(p[2] / r)
            for k, A in enumerate(moments)
        ]
        return sum(terms)

    h = 1e-6
    return np.array(
        [(potential(position - h * e) - potential(position + h * e)) / (2 * h) for e in np.eye(3)]
    )


@pytest.mark.parametrize("shape", SHAPES, ids=lambda s: type(s).__name__)
def test_the_field_far_away_is_that_of_its_moments(shape):
    axial = 9 if not isinstance(shape, Cube) else 5
    for direction in ([0, 0, 1.0], [1.0, 0, 0], [0.5, 0.3, -0.8]):
        position = 0.06 * np.array(direction) / np.linalg.norm(direction)
        expected = series(shape.multipoles(axial), position)
        np.testing.assert_allclose(shape.field(position), expected, rtol=0, atol=2e-5)


def test_the_first_moment_is_that_of_the_volume():
    assert Disc(8e-3, 3e-3, 1000.0).multipoles(1)[0] == pytest.approx(
        1000 * np.pi * 16e-6 * 3e-3 / (4 * np.pi)
    )
    assert Cube(5e-3, 1000.0).multipoles(1)[0] == pytest.approx(1000 * 125e-9 / (4 * np.pi))
    assert Ring(8e-3, 4e-3, 3e-3, 1000.0).multipoles(1)[0] == pytest.approx(1000 * 12e-6 * 3e-3 / 4)


def test_readings_turn_with_everything():
    """A rigid motion of magnet, chip and field together changes nothing that a chip reads."""
    free = Robot(
        [FreeBody()], [Magnet(SHAPES[2], 1, 0.0, position=[0.03, 0, 0.02])], [Sensor(1, 0.0, axes=3)]
    )
    u = simulated_readings(free, [[0.0] * 6, [0.1, -0.2, 0.3, 0.5, -1.0, 0.7]])
    np.testing.assert_allclose(u[0], u[1], rtol=0, atol=1e-12)


def test_the_published_ranges_of_the_readings():
    """Golden values of the released data: range of u over the lemniscate, one segment [mT]."""
    magnets = [Magnet(RELEASED, 1, 0.055)]
    sensors = [Sensor(1, 0.11, radial=0.013, azimuth=k * 2 * np.pi / 3) for k in range(3)]
    robot = Robot([ConstantCurvature(0.11, 0.022)], magnets, sensors)
    s = np.linspace(0, 1, 400)
    D = 0.01728
    q = np.stack(
        [D * np.sin(4 * np.pi * s), D * np.sin(2 * np.pi * s), 0.00275 * (1 + np.sin(2 * np.pi * s))], -1
    )
    assert np.ptp(simulated_readings(robot, q)) == pytest.approx(0.92345, abs=1e-4)


def test_three_axes_and_the_field_of_the_earth():
    earth = np.array([0.02, -0.01, 0.04])
    chip = Sensor(0, 0.0, axes=3, orientation=[0.5, 0.5, 0.5, 0.5])
    robot = Robot([FreeBody()], [Magnet(RELEASED, 1, 0.0)], [chip])
    far = [0.0, 0.0, 1e4, 0.0, 0.0, 0.0]
    np.testing.assert_allclose(
        simulated_readings(robot, far, earth), chip.place.rotation.T @ earth, atol=1e-12
    )


def test_an_imu_reads_the_rotation_vector_of_its_frame():
    robot = Robot([ConstantCurvature(0.1, 1.0)], imus=[Imu(1, 0.05)])
    np.testing.assert_allclose(simulated_readings(robot, [0.4, 0.2, 0.0]), [-0.1, 0.2, 0.0], atol=1e-15)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Ring(5e-3, 6e-3, 1e-3, 1300.0), "dimensions of Ring must be 0 <= inner < outer"),
        (lambda: Disc(5e-3, 0.0, 1300.0), "height of Disc must be positive"),
        (lambda: Cube(5e-3, np.nan), "polarisation_mt of Cube must be finite"),
        (
            lambda: RELEASED.multipoles(4),
            "l_max of multipoles must be a positive odd number; instead received 4",
        ),
        (lambda: RELEASED.field([1.0, 2.0]), r"positions of field must be numbers of shape \(..., 3\)"),
        (
            lambda: Magnet("disc", 1, 0.0),
            "shape of Magnet must be a Ring, Disc or Cube; instead received str",
        ),
        (
            lambda: simulated_readings(Robot([FreeBody()]), [0.0] * 6),
            "one with sensors or IMUs; instead received neither",
        ),
    ],
)
def test_what_cannot_be_is_refused_in_words(make, message):
    with pytest.raises(InputError, match=message):
        make()


@pytest.mark.parametrize("shape", [*SHAPES, Disc(2e-3, 8e-3, 1300.0), Ring(2e-3, 1e-3, 8e-3, 1300.0)])
def test_multipoles_describe_the_field_beyond_the_reach_and_not_within(shape):
    """On the axis of a magnet the field is the series sum of (l + 1) A_l / z^(l + 2), if that converges."""
    moments = shape.multipoles(41)
    orders = np.arange(1, 42, 2)
    for far, converges in ((1.3, True), (0.6, False)):
        z = far * shape.reach
        series = (orders + 1) * moments / z ** (orders + 2)
        assert (abs(series[-1]) < 1e-3 * abs(series[0])) == converges
        if converges:
            np.testing.assert_allclose(series.sum(), shape.field([0, 0, z])[2], rtol=2e-3)
