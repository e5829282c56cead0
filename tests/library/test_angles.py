"""Free angles: the same shapes, within the bounds, for every estimator."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from repro import (
    AffineCurvature,
    BallJoint,
    Disc,
    FreeBody,
    KalmanFilter,
    LevenbergMarquardt,
    Link,
    Magnet,
    ParticleFilter,
    Robot,
    Sensor,
    smooth,
    track,
)
from repro.angles import FreeAngles

TURN, HALF = 2 * np.pi, np.pi
CHAIN = [AffineCurvature(0.1), BallJoint(), BallJoint("z"), BallJoint("xy"), FreeBody()]
ROBOT = Robot(
    CHAIN,
    lower=[-3, -3, np.nan, -0.1, *[np.nan] * 6, *[-9.0] * 6],
    upper=[3, 3, np.nan, 0.1, *[np.nan] * 6, *[9.0] * 6],
)


@given(st.lists(st.floats(-20.0, 20.0), min_size=16, max_size=16), st.integers(0, 100))
def test_what_is_next_to_a_reference_is_the_same_shape(values, seed):
    q, reference = np.array(values), np.random.default_rng(seed).normal(0.0, 4.0, 16)
    found = ROBOT.free_angles.nearest(q, reference)
    np.testing.assert_allclose(ROBOT.tip(found), ROBOT.tip(q), rtol=0, atol=1e-12 * np.abs(q).max() + 1e-11)
    for one in map(list, ROBOT.rotations):  # no whole turn about its axis brings it closer
        w = found[one]
        axis = w / (np.linalg.norm(w) or 1.0)
        for turns in (-TURN, TURN):
            there = np.linalg.norm(w + turns * axis - reference[one])
            assert np.linalg.norm(w - reference[one]) <= there + 1e-9


@given(st.lists(st.floats(-20.0, 20.0), min_size=16, max_size=16))
def test_the_slopes_of_a_wrap_are_its_differences(values):
    q, angles, h = np.array(values), ROBOT.free_angles, 1e-6
    wrapped = angles.wrapped(q)
    assert ((wrapped >= ROBOT.lower) & (wrapped <= ROBOT.upper))[angles.free].all()
    near = [(angles.nearest(q + s * h * e, wrapped)) for e in np.eye(16) for s in (1, -1)]
    expected = (np.array(near[::2]) - near[1::2]).T / (2 * h)
    sizes = np.array([np.linalg.norm(q[list(one)]) for one in ROBOT.rotations])
    if (np.abs(np.sin(sizes / 2)) > 1e-3).all() and (np.abs(np.cos(sizes / 2)) > 1e-3).all():
        np.testing.assert_allclose(angles.slopes(q, wrapped), expected, rtol=0, atol=1e-4)


def test_means_of_angles_are_those_a_person_draws():
    degrees = np.radians([[170.0], [-170.0], [-150.0]])
    one = FreeAngles([(0,)], np.array([-HALF]), np.array([HALF]))
    assert np.degrees(one.mean(degrees[:2], np.full(2, 0.5)))[0] == pytest.approx(180.0)
    assert np.degrees(one.mean(degrees, np.full(3, 1 / 3)))[0] == pytest.approx(-170.0, abs=0.2)
    body = FreeAngles([(0, 1, 2)], np.full(3, -HALF), np.full(3, HALF))
    three = np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 2.0], [0.0, 0.0, -2.0]])  # the lightest has its own mean
    np.testing.assert_allclose(body.mean(three, np.array([0.5, 0.3, 0.2])), [0.0, 0.0, 0.2], atol=1e-12)
    found = body.mean(np.array([[3.0, 0.0, 0.0], [-3.0, 0.0, 0.0]]), np.array([0.5, 0.5]))
    np.testing.assert_allclose(
        Rotation.from_rotvec(found).as_matrix(), np.diag([1.0, -1.0, -1.0]), atol=1e-12
    )


@pytest.mark.parametrize(
    ("axes", "low", "high", "free"),
    [
        ("x", [-180], [180], [True]),
        ("x", [90], [270], [False]),
        ("x", [0], [360], [True]),
        ("xyz", [-180, -180, -180], [180, 180, 180], [True, True, True]),
        ("xyz", [-180, -20, -20], [180, 20, 20], [False, False, False]),
        ("xyz", [-180, 0, 0], [180, 0, 0], [True, False, False]),
        ("xy", [0, 0], [360, 360], [False, False]),
    ],
)
def test_an_angle_is_free_only_if_every_turn_stays_within_the_bounds(axes, low, high, free):
    robot = Robot([BallJoint(axes)], lower=np.radians(low), upper=np.radians(high))
    assert robot.free_angles.free.tolist() == free


def hinge(low: float, high: float, axes: str = "x") -> Robot:
    """Return a joint amid two magnets, with two chips on the link behind it."""
    disc = Disc(12e-3, 6e-3, 1300.0)
    magnets = [Magnet(disc, 0, 0.0), Magnet(disc, 0, 0.0, [1.0, 0.3, 0.0], [0.015, 0.0, 0.0])]
    sensors = [Sensor(2, 0.05, axes=3), Sensor(2, 0.035, position=[0.01, 0.0, 0.0], axes=3)]
    n = len(axes)
    return Robot(
        [BallJoint(axes), Link(0.05)], magnets, sensors,
        lower=np.full(n, np.radians(low)), upper=np.full(n, np.radians(high)), noise=0.002,
    )  # fmt: skip


@pytest.mark.parametrize("make", [LevenbergMarquardt, KalmanFilter, ParticleFilter])
@pytest.mark.parametrize(("low", "high"), [(90, 270), (-180, 180), (0, 360), (170, 190), (-720, 720)])
def test_every_estimate_of_a_hinge_is_right_and_within_its_bounds(make, low, high):
    robot, t = hinge(low, high), np.arange(60) / 25
    q = np.radians((low + high) / 2 + 0.45 * min(high - low, 420) * np.sin(t))[:, None]
    u = robot.sensing()(q) + 0.002 * np.random.default_rng(0).standard_normal((60, 6))
    runs = [track(make(robot), u, rate_hz=25.0)]
    runs += [smooth(make(robot), u, rate_hz=25.0)] if make is KalmanFilter else []
    for found in runs:
        assert ((found.q >= robot.lower) & (found.q <= robot.upper)).all()
        off = np.degrees(np.abs(robot.free_angles.difference(found.q, q)))
        assert off[5:].max() < 1.5
        if found.status is not None:
            assert (found.status == "consistent").all()


def test_particles_average_over_the_seam():
    """A cloud on both sides of half a turn has its mean there, and the deviation of the cloud."""
    robot = hinge(-180, 180)
    u = robot.sensing()(np.full((12, 1), HALF))
    for seed in range(3):
        found = track(ParticleFilter(robot), u, rate_hz=20.0, seed=seed)
        assert np.degrees(np.abs(robot.free_angles.difference(found.q, np.array([HALF])))).max() < 2.0
        assert np.degrees(np.sqrt(found.covariance[1:])).max() < 2.0


def test_a_body_goes_through_a_whole_turn():
    """The rotation vector is singular after a whole turn: filter and smoother never come near it."""
    robot, t = hinge(-180, 180, "xyz"), np.arange(150) / 50
    axis = np.array([0.3, 0.5, 0.81]) / np.linalg.norm([0.3, 0.5, 0.81])
    q = (TURN * t / 2.5)[:, None] * axis + 0.1 * np.sin(t)[:, None]
    u = robot.sensing()(q) + 0.002 * np.random.default_rng(0).standard_normal((150, 6))
    method = KalmanFilter(robot, acceleration=[6.0] * 3, velocity=[4.0] * 3)
    for run in (track, smooth):
        found = run(method, u, q[0], rate_hz=50.0)
        assert np.linalg.norm(found.q, axis=1).max() <= HALF + 1e-9
        off = (Rotation.from_rotvec(found.q).inv() * Rotation.from_rotvec(q)).magnitude()
        assert np.degrees(off).max() < 1.5
        assert (found.status == "consistent").all()
        assert np.degrees(np.sqrt(np.diagonal(found.covariance, 0, 1, 2))).max() < 2.0


def test_a_wrapped_state_moves_on_as_before():
    """Velocity and covariance turn with the rotation vector: a moment later it is the same shape, as uncertain."""
    method, dt = KalmanFilter(hinge(-180, 180, "xyz")), 1e-5
    state = method.init([2.0, 0.1, 0.0])
    state = state._replace(q=np.array([3.3, 0.4, -0.5]), velocity=np.array([0.3, -2.0, 1.0]), t=0.0)
    wrapped = method.wrapped(state)
    assert np.linalg.norm(wrapped.q) < HALF
    for a, b in ((state, wrapped), (method.predicted(state, dt), method.predicted(wrapped, dt))):
        apart = Rotation.from_rotvec(a.q).inv() * Rotation.from_rotvec(b.q)
        assert apart.magnitude() < 1e-9
    back = method.near(wrapped, state.q)
    np.testing.assert_allclose(back.q, state.q, atol=1e-12)
    np.testing.assert_allclose(back.velocity, state.velocity, atol=1e-12)
    np.testing.assert_allclose(back.covariance, state.covariance, atol=1e-10)


def test_a_turning_body_has_no_jumps_in_its_coordinates():
    axis = np.array([0.6, 0.0, 0.8])
    angles = FreeAngles([(0, 1, 2)], np.full(3, -HALF), np.full(3, HALF))
    turns = np.linspace(0.0, 15.0, 60)[:, None] * axis
    seen = angles.wrapped(turns)
    seen[30] = np.nan
    found = angles.continuous(seen)
    np.testing.assert_allclose(np.delete(found, 30, 0), np.delete(turns, 30, 0), atol=1e-9)
