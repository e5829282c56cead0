"""Moments by linear least squares: exact where the series is, against the closed form, refused input."""

import math

import pytest
import torch
from edition1.errors import InputError
from edition1.kinematics.paper_robots import pcc_robot
from edition1.sensing.magnetic import readings
from edition1.sensing.magnets import ring
from edition1.sensing.moments import fit_moments


def poses(n, segments=1, seed=0):
    generator = torch.Generator().manual_seed(seed)
    return 0.03 * (torch.rand(n, 3 * segments, dtype=torch.float64, generator=generator) - 0.5)


def exact(name, terms):
    return torch.from_numpy(ring(name).multipoles(2 * terms - 1))


@pytest.mark.parametrize("terms", [1, 3, 5])
def test_moments_of_a_series_are_recovered(terms):
    robot, q = pcc_robot(2), poses(30, 2)
    u = readings(robot, q, ring("released"), route="multipole", l_max=2 * terms - 1)
    fit = fit_moments(robot, q, u, terms=terms)
    torch.testing.assert_close(fit.moments, exact("released", terms), rtol=1e-6, atol=0)
    assert fit.rms_mt < 1e-10


def test_moments_of_a_ring_with_its_whole_series():
    """What the cut-off orders carry goes into the highest moments kept; the readings are still explained."""
    robot, q = pcc_robot(3), poses(40, 3)
    fit = fit_moments(robot, q, readings(robot, q, ring("published")), terms=3)
    torch.testing.assert_close(fit.moments[:2], exact("published", 2), rtol=1e-3, atol=0)
    assert fit.rms_mt < 2e-6


def test_moments_serve_another_robot():
    small, large = pcc_robot(1), pcc_robot(3, 4, tilt=0.1)
    fit = fit_moments(small, poses(60), readings(small, poses(60), ring("released")), terms=4)
    q = poses(100, 3, seed=1)
    u = readings(large, q, ring("released"))
    from edition1.sensing.linearised import LinearisedSensing

    assert float((LinearisedSensing(large, fit.moments)(q) - u).abs().max()) < 2e-4


def test_earth_field_is_taken_off():
    robot, q, earth = pcc_robot(1), poses(30), torch.tensor([0.03, -0.04, 0.02], dtype=torch.float64)
    u = readings(robot, q, ring("released"), route="multipole", l_max=3, earth_mt=earth)
    fit = fit_moments(robot, q, u, terms=2, earth_mt=earth)
    torch.testing.assert_close(fit.moments, exact("released", 2), rtol=1e-8, atol=0)


def test_no_earth_field_is_a_field_too():
    robot, q = pcc_robot(1), poses(30)
    u = readings(robot, q, ring("released"), route="multipole", l_max=3)
    none, zero = (fit_moments(robot, q, u, terms=2, earth_mt=e) for e in (None, torch.zeros(3).double()))
    torch.testing.assert_close(zero.moments, none.moments, rtol=1e-12, atol=0)


def test_condition_grows_with_every_term():
    robot, q = pcc_robot(1), poses(40)
    u = readings(robot, q, ring("released"))
    conditions = [fit_moments(robot, q, u, terms=terms).condition for terms in (1, 2, 3)]
    assert conditions[0] == pytest.approx(1)
    assert conditions[0] < conditions[1] < conditions[2]


@pytest.mark.parametrize(
    ("q", "u", "message"),
    [
        (poses(1)[:, :2], torch.ones(1, 3).double(), "q of fit_moments must be of last dimension 3"),
        (poses(4), torch.ones(4, 2).double(), "u of fit_moments must be one reading for each of 3 sensors"),
        (poses(4), torch.full((4, 3), math.nan).double(), "u of fit_moments must be finite"),
        (
            poses(1),
            torch.ones(1, 3).double(),
            "u of fit_moments must be at least 4 readings; instead received 3",
        ),
    ],
)
def test_bad_input(q, u, message):
    with pytest.raises(InputError, match=message):
        fit_moments(pcc_robot(1), q, u, terms=4)
