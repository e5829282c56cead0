"""Segments, chains and mounts: poses and twists by independent routes, at all kinds of points."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from repro import AffineCurvature, BallJoint, ConstantCurvature, Imu, InputError, Link, Robot, Sensor
from repro.chain import point_on
from repro.estimators.calibration import load_calibration

from .robots import CHAINS, chain, complex_pose, configuration

NEAR_SINGULAR = (0.0, 1e-9, 1e-4, 0.49, 0.51, 1.0)


@pytest.mark.parametrize("names", CHAINS, ids="-".join)
@pytest.mark.parametrize("scale", NEAR_SINGULAR)
def test_poses_and_twists_agree_with_complex_steps(names, scale):
    robot = chain(names)
    q = configuration(robot, scale * np.random.default_rng(len(names)).uniform(-1, 1, robot.n_q))
    places = [part.place for part in (*robot.magnets, *robot.sensors, *robot.imus)]
    T, X = robot.motion(q, places)
    for k, place in enumerate(places):
        R, p = complex_pose(robot, q, place)
        np.testing.assert_allclose(T[k, :3, :3], R.real, rtol=0, atol=1e-13)
        np.testing.assert_allclose(T[k, :3, 3], p.real, rtol=0, atol=1e-13)
        for c in range(robot.n_q):
            step = np.zeros(robot.n_q, dtype=complex)
            step[c] = 1e-20j
            dR, dp = (x.imag / 1e-20 for x in complex_pose(robot, q + step, place))
            turn, motion = X[k, c, :3], X[k, c, 3:]
            scale_of = max(1.0, np.abs(X[k, c]).max())
            np.testing.assert_allclose(motion + np.cross(turn, p.real), dp, rtol=0, atol=1e-12 * scale_of)
            np.testing.assert_allclose(np.cross(turn, R.real.T).T, dR, rtol=0, atol=1e-12 * scale_of)


@pytest.mark.parametrize("batch", [(), (3,), (2, 1, 2), (0,)])
def test_every_batch_gives_what_its_members_give_alone(batch):
    robot = chain(("constant", "hinge", "affine"))
    q = configuration(robot, np.random.default_rng(0).uniform(-1, 1, (*batch, robot.n_q)))
    T = robot.tip(q)
    assert T.shape == (*batch, 4, 4)
    for k in np.ndindex(batch):
        np.testing.assert_array_equal(T[k], robot.tip(q[k]))


@given(st.floats(-3.0, 3.0), st.floats(-3.0, 3.0), st.floats(0.0, 1.0))
@example(0.0, 0.0, 1.0)
def test_an_arc_is_the_circle_of_its_curvature(x, y, v):
    """The chord of a circle, and a rotation about the axis across the bend."""
    robot = Robot([ConstantCurvature(0.1, 1.0)])
    (T,) = robot.poses([x, y, 0.01], [point_on(1, v * 0.1)])
    angle = np.hypot(x, y)
    chord = v * 0.11 * np.sinc(v * angle / 2 / np.pi)
    assert np.linalg.norm(T[:3, 3]) == pytest.approx(chord, abs=1e-15)
    expected = Rotation.from_rotvec(v * np.array([-y, x, 0.0])).as_matrix()
    np.testing.assert_allclose(T[:3, :3], expected, rtol=0, atol=1e-14)


@pytest.mark.parametrize("length", [0.0, 1e-3, 0.1, 5.0])
def test_a_part_lies_on_its_segment_and_not_a_nanometre_beyond(length):
    robot = Robot([Link(0.2), Link(length)])
    for at in (0.0, length, length * (1 + 1e-14)):
        np.testing.assert_allclose(robot.poses([], [point_on(2, at)])[0, 2, 3], 0.2 + at, rtol=1e-15)
    for segment, at in ((2, -1e-9), (2, length + 1e-9), (0, 1e-9), (3, 0.0)):
        with pytest.raises(InputError, match="places of Robot must be (between 0 and|on a segment from 0)"):
            robot.poses([], [point_on(segment, at)])


def test_places_are_printed_only_where_they_are_refused(monkeypatch):
    """To print one takes many times as long as its pose."""
    robot, place = Robot([ConstantCurvature(0.1, 1.0)]), point_on(1, 0.05)
    monkeypatch.setattr(type(place), "__repr__", lambda _: 1 / 0)
    robot.poses([0.1, 0.2, 0.0], [place])
    for wrong, words in (
        (3, "must be a list of places"),
        ([3], "must be a place: that of a part, or one from"),
    ):
        with pytest.raises(InputError, match=words):
            robot.poses([0.1, 0.2, 0.0], wrong)


@given(st.floats(-2.0, 2.0), st.floats(-3.0, 3.0))
def test_affine_curvature_without_its_slope_is_constant_curvature(k, phi):
    affine = Robot([AffineCurvature(0.2)]).tip([k, 0.0, phi, 0.003])
    arc = Robot([ConstantCurvature(0.2, 1.0)]).tip([k * np.sin(phi), -k * np.cos(phi), 0.003])
    np.testing.assert_allclose(affine, arc, rtol=0, atol=1e-14)


def test_the_slopes_of_the_tip_are_those_of_its_position():
    robot = chain(("constant", "link", "affine"))
    q = configuration(robot, np.full(robot.n_q, 0.3))
    p, slopes = robot.tip_slopes(q)
    np.testing.assert_allclose(p, robot.tip(q)[:3, 3])
    for c in range(robot.n_q):
        step = np.eye(robot.n_q)[c] * 1e-7
        central = (robot.tip(q + step)[:3, 3] - robot.tip(q - step)[:3, 3]) / 2e-7
        np.testing.assert_allclose(slopes[:, c], central, rtol=0, atol=1e-8)


ONE = Robot([ConstantCurvature(0.1, 0.02)])


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: ConstantCurvature(0.0, 0.02), "length of ConstantCurvature must be positive"),
        (
            lambda: BallJoint("zx"),
            "axes of BallJoint must be some of 'xyz', in this order; instead received zx",
        ),
        (lambda: Robot([]), "segments of Robot must be at least one segment"),
        (lambda: Robot([3]), "segments of Robot must be of ConstantCurvature, .* instead received int"),
        (
            lambda: Robot([Link(0.1)], sensors=[Sensor(2, 0.0)]),
            "number 1, of Robot must be on a segment from 0",
        ),
        (
            lambda: Robot([Link(0.1)], imus=[Imu(1, 0.2)]),
            "between 0 and 100 mm along segment 1; instead received 200",
        ),
        (lambda: Robot([Link(0.1)], sensors=[Imu]), "sensors of Robot must be parts with a place"),
        (lambda: Sensor(1, 0.1, radial=-1.0), "radial of Sensor must be not negative"),
        (lambda: Sensor(1, 0.1, axes=3, tilt=0.1), "must be for one axis; orientation is for three"),
        (
            lambda: Sensor(1, 0.1, direction=[0, 0, 0]),
            "direction of Sensor must be a vector that is not zero",
        ),
        (lambda: Imu(1, 0.1, [0, 0, 0, 2]), r"unit quaternions XYZW \(norm 1 within 0.001\); .* a norm of 2"),
        *(
            (lambda x=x: Sensor(1, 0.1, **x), f"{next(iter(x))} .*of Sensor must be {words}")
            for x, words in (
                ({"resolution": 5.0, "range": 5.0}, "from 0 to below the range"),
                ({"resolution": -1e-9}, "from 0 to below the range"),
                ({"noise": 0.0}, "positive"),
                ({"noise": [1.0, 1.0, 1.0]}, "one number or 1, one for every axis"),
                ({"gain": 0.0}, "not zero"),
                ({"per_mt": 0.0}, "not zero"),
                ({"axes": 2}, "1 or 3"),
                ({"channels": "u1"}, "a list of 1, one for every axis"),
                ({"tolerance": {"tilt": -1e-9}}, "not negative"),
                ({"tolerance": {"heading": 0.1}}, "of position, at, radius"),
                ({"free": {"at": (0.1, 0.1)}}, r"\(lowest, highest\)"),
                ({"free": {"height": (0.1, 0.2)}}, "of at, azimuth"),
            )
        ),
        (lambda: Sensor("tip", 0.1), "segment of Sensor must be 0 or above"),
        (lambda: Robot([Link(0.1)]).tip([1.0]), r"q of Robot must be of last dimension 0 \(\)"),
        (
            lambda: Robot([ConstantCurvature(0.1, 0.02)]).tip([0.0, 0.0]),
            r"of last dimension 3 \(delta_x_1, delta_y_1, delta_L_1\); instead received shape \(2,\)",
        ),
        (lambda: Robot([ConstantCurvature(0.1, 0.02)]).tip([0, 0, np.nan]), "q of Robot must be finite"),
        (lambda: Robot([ConstantCurvature(0.1, 0.02)]).tip("abc"), "q of Robot must be numbers"),
        (lambda: Robot(3), "segments of Robot must be .*; instead received int"),
        *(
            (
                lambda x=x: ONE.poses(np.zeros(3), x),
                "places of Robot must be a (list of places|place: that of a part)",
            )
            for x in (3, [(1, 0.0)], [np.eye(4)], point_on(1, 0.0))
        ),
        (
            lambda: load_calibration(3, ONE),
            "calibration of load_calibration must be a path; instead received int",
        ),
        (lambda: ONE.check(samples=2.5), "samples of check must be a whole number"),
    ],
)
def test_what_cannot_be_is_refused_in_words(make, message):
    with pytest.raises(InputError, match=message):
        make()
