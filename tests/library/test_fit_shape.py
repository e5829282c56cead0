"""Shapes from motion capture: against SciPy, closed forms and known rigs."""

from __future__ import annotations

import re

import numpy as np
import pandas as pd
import pytest
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from repro import (
    AffineCurvature,
    BallJoint,
    ConstantCurvature,
    FreeBody,
    InputError,
    Link,
    Magnet,
    Robot,
)
from repro.chain import point_on
from repro.estimators.fit_shape import Rig, fit_shape

from .robots import RELEASED, tips

SEGMENT = ConstantCurvature(0.11, 0.022)
NOISE = 0.5e-3, 0.01


def shapes(robot, n, seed=0, share=1.0):
    size = {"delta_x": 0.03, "delta_y": 0.03, "delta_L": 0.006, "kappa_0": 1.5, "kappa_1": 1.5, "phi": 3.0}
    sizes = [
        size.get(name, 0.8 if "rotation" in name else 0.05) for s in robot.segments for name in s.coordinates
    ]
    return share * np.random.default_rng(seed).uniform(-1, 1, (n, robot.n_q)) * sizes


def noisy(T, seed=0):
    rng, T = np.random.default_rng(seed), T.copy()
    T[..., :3, 3] += NOISE[0] * rng.normal(size=T[..., :3, 3].shape)
    turns = Rotation.from_rotvec(NOISE[1] * rng.normal(size=(T[..., 0, 0].size, 3))).as_matrix()
    T[..., :3, :3] = turns.reshape(T[..., :3, :3].shape) @ T[..., :3, :3]
    return T


def test_three_segments_are_those_of_scipy():
    robot = Robot([SEGMENT] * 3)
    T = noisy(robot.poses(shapes(robot, 60), tips(robot)))
    T[3, 1, :3, :3], T[4, 2, :3, :3], T[5, 1:] = np.nan, np.nan, np.nan
    found = fit_shape(robot, T)

    def residuals(q, T):
        hat = robot.poses(q, tips(robot))
        turns = np.full((3, 3), np.nan)
        seen = np.isfinite(T[:, 0, 0])
        turns[seen] = Rotation.from_matrix(T[seen, :3, :3] @ np.swapaxes(hat[seen, :3, :3], 1, 2)).as_rotvec()
        r = np.concatenate([(T[:, :3, 3] - hat[:, :3, 3]) / NOISE[0], turns / NOISE[1]])
        return r[np.isfinite(r)]

    for k in range(7):
        q0, n = np.nan_to_num(found.q[k]) + 1e-4, 3 if k == 5 else 9
        best = least_squares(
            lambda x, k=k, q0=q0, n=n: residuals(np.r_[x, q0[n:]], T[k]), q0[:n], xtol=1e-15, ftol=1e-15, gtol=1e-15,
            x_scale="jac", jac="3-point",
        )  # fmt: skip
        np.testing.assert_allclose(found.q[k, :n], best.x, rtol=0, atol=1e-7)
        assert found.chi2[k] == pytest.approx(2 * best.cost, rel=1e-6)


def test_errors_are_of_the_size_that_is_stated():
    robot = Robot([SEGMENT] * 2)
    q = shapes(robot, 2000)
    found = fit_shape(robot, noisy(robot.poses(q, tips(robot))), noise=NOISE)
    error = found.q - q
    nees = np.einsum("ti,tij,tj->t", error, np.linalg.inv(found.covariance), error) / robot.n_q
    assert nees.mean() == pytest.approx(1.0, abs=0.05)
    assert (found.chi2 / found.dof).mean() == pytest.approx(1.0, abs=0.05)


def test_a_covariance_grows_where_the_robot_is_another():
    robot, other = Robot([SEGMENT]), Robot([AffineCurvature(0.11)])
    T = other.poses(shapes(other, 200), tips(other))
    found = fit_shape(robot, T)
    grown = np.median(found.chi2 / found.dof)
    assert grown > 4
    alone = fit_shape(robot, robot.poses(np.nan_to_num(found.q), tips(robot)))
    np.testing.assert_allclose(found.covariance, grown * alone.covariance, rtol=1e-5)


@pytest.mark.parametrize(
    "robot",
    [
        Robot([SEGMENT]),
        Robot([AffineCurvature(0.2), Link(0.02), SEGMENT]),
        Robot([BallJoint("xyz"), Link(0.1), BallJoint("y"), Link(0.1)]),
        Robot([FreeBody()]),
    ],
    ids=repr,
)
def test_exact_poses_give_the_shape_back(robot):
    q = shapes(robot, 300, 1)
    T = robot.poses(q, tips(robot))
    found = fit_shape(robot, T)
    np.testing.assert_allclose(robot.poses(found.q, tips(robot)), T, atol=1e-7)
    assert found.residual.max() < 1e-8


def test_quaternions_and_one_shape_alone_are_taken():
    robot = Robot([SEGMENT])
    T = robot.poses(shapes(robot, 4), tips(robot))
    rows = np.concatenate([T[..., :3, 3], Rotation.from_matrix(T[:, 0, :3, :3]).as_quat()[:, None]], axis=-1)
    np.testing.assert_allclose(fit_shape(robot, rows).q, fit_shape(robot, T).q, atol=1e-9)
    np.testing.assert_allclose(fit_shape(robot, rows[2]).q[0], fit_shape(robot, T).q[2], atol=1e-9)


def test_markers_beside_the_backbone_and_mounted_parts():
    robot = Robot([SEGMENT] * 2, [Magnet(RELEASED, 2, 0.055)])
    q = shapes(robot, 50, 2)
    at = [(1, 0.05, [0.02, 0.0, 0.0]), (1, 0.11), robot.magnets[0], (2, 0.11, [0.0, -0.02, 0.0])]
    places = [point_on(s, v)._replace(position=np.array(r)) for s, v, r in [
        (1, 0.05, [0.02, 0, 0]), (1, 0.11, [0, 0, 0]), (2, 0.055, [0, 0, 0]), (2, 0.11, [0, -0.02, 0])]]  # fmt: skip
    markers = robot.poses(q, places)[..., :3, 3]
    found = fit_shape(robot, markers, at)
    np.testing.assert_allclose(found.q, q, atol=1e-8)
    assert (found.missing == 12).all()  # four rotations


def test_lost_bodies():
    robot = Robot([ConstantCurvature(0.11, 0.022, extensible=False)] * 3)
    q = shapes(robot, 6, 3)
    T = robot.poses(q, tips(robot))
    T[1, 0], T[2, 2], T[3] = np.nan, np.nan, np.nan
    found = fit_shape(robot, T)
    np.testing.assert_allclose(
        found.q[[0, 1, 4, 5]], q[[0, 1, 4, 5]], atol=1e-7
    )  # two poses hold three segments
    np.testing.assert_allclose(found.q[2, :4], q[2, :4], atol=1e-8)
    assert np.isnan(found.q[2, 4:]).all()
    assert np.isnan(found.q[3]).all()
    variances = np.diagonal(found.covariance, axis1=1, axis2=2)
    assert np.isinf(variances[2, 4:]).all()
    assert np.isfinite(variances[2, :4]).all()
    assert found.missing.tolist() == [0, 6, 6, 18, 0, 0]
    assert "30 of 108 readings missing" in repr(found)
    assert repr(found).endswith("residual, root mean square: 0 mm") or "e-" in repr(found).splitlines()[-1]


def test_fixed_coordinates_stay():
    robot = Robot([SEGMENT], lower=[-0.1, 0.002, -0.01], upper=[0.1, 0.002, 0.01])
    q = shapes(robot, 10)
    q[:, 1] = 0.002
    found = fit_shape(robot, robot.poses(q, tips(robot)))
    np.testing.assert_allclose(found.q, q, atol=1e-8)
    assert (found.q[:, 1] == 0.002).all()
    assert (found.covariance[:, 1] == 0).all()
    assert (found.dof == 4).all()


def test_a_base_that_moves_takes_the_robot_along():
    robot = Robot([SEGMENT])
    q = shapes(robot, 20, 4)
    rng = np.random.default_rng(0)
    base = np.tile(np.eye(4), (20, 1, 1))
    base[:, :3, :3] = Rotation.from_rotvec(rng.normal(size=(20, 3))).as_matrix()
    base[:, :3, 3] = rng.normal(size=(20, 3))
    T = np.concatenate([base[:, None], base[:, None] @ robot.poses(q, tips(robot))], axis=1)
    np.testing.assert_allclose(fit_shape(robot, T).q, q, atol=1e-7)
    T[3, 0] = np.nan
    assert np.isnan(fit_shape(robot, T).q[3]).all()


@pytest.mark.parametrize("wrong", [0, 20])
def test_the_rig_is_found_from_many_shapes_even_if_some_are_wrong(wrong):
    robot = Robot([SEGMENT] * 2)
    q, rng = shapes(robot, 300, 5), np.random.default_rng(1)
    base = np.eye(4)
    base[:3, :3], base[:3, 3] = Rotation.from_rotvec([0.5, -1.2, 0.8]).as_matrix(), [0.3, -1.0, 0.5]
    bodies = np.tile(np.eye(4), (2, 1, 1))
    bodies[:, :3, :3] = Rotation.from_rotvec(0.1 * rng.normal(size=(2, 3))).as_matrix()
    bodies[:, :3, 3] = 5e-3 * rng.normal(size=(2, 3))
    T = noisy(base @ robot.poses(q, tips(robot)) @ bodies)
    if wrong:
        T[:wrong, 1, :3, 3] += 0.3
    found = fit_shape(robot, T, noise=NOISE, fit_rig=True)
    good = slice(wrong, None)
    assert (found.chi2[good] / found.dof[good]).mean() == pytest.approx(1.0, abs=0.1)
    # Every constant is within four of its deviations, many of which are the prior's: a tilt there is a bend here.
    assert found.rig is not None
    off = np.linalg.inv(found.rig.base) @ base
    off = np.concatenate([off[None], np.linalg.inv(found.rig.bodies) @ bodies])
    off = np.concatenate([off[:, :3, 3], Rotation.from_matrix(off[:, :3, :3]).as_rotvec()], axis=1)
    assert np.abs(off / found.rig.deviation).max() < 4
    again = fit_shape(robot, T, noise=NOISE, rig=found.rig)
    np.testing.assert_allclose(again.q, found.q, atol=1e-9)
    with pytest.raises(InputError, match="in the frame of the base"):
        fit_shape(robot, T, noise=NOISE)


def test_the_deviation_of_a_rig_is_that_of_the_residuals_where_shapes_determine_it():
    """A hinge shows how its base lies across the axis, as well if the stated noise is a tenth of the true one."""
    robot = Robot([BallJoint("x"), Link(0.1)])
    T = noisy(robot.poses(np.linspace(-1, 1, 80)[:, None], [point_on(2, 0.1)]))
    right, tenth = (
        fit_shape(robot, T, [(2, 0.1)], noise=(NOISE[0] / n, NOISE[1] / n), fit_rig=True).rig.deviation
        for n in (1, 10)
    )
    np.testing.assert_allclose(tenth[0, [1, 2, 4, 5]], right[0, [1, 2, 4, 5]], rtol=0.2)  # y and z
    assert (np.maximum(tenth, right)[1] <= [*[10e-3 + 1e-9] * 3, *[0.2 + 1e-9] * 3]).all(), (
        "never above the prior"
    )


def test_more_segments_fit_a_rod_better():
    """Which segments describe my robot: one, two and three, fitted to a rod whose curvature changes along it."""
    rod, sizes = Robot([AffineCurvature(0.33)]), []
    q = shapes(rod, 100, 6) * [1, 2, 1, 0]
    s = [0.11, 0.22, 0.33]
    T = rod.poses(q, [point_on(1, x) for x in s])
    for n in (1, 2, 3):
        robot = Robot([ConstantCurvature(0.33 / n, 0.022)] * n)
        at = [
            (int(np.ceil(x * n / 0.33 - 1e-9)), x - 0.33 / n * (np.ceil(x * n / 0.33 - 1e-9) - 1)) for x in s
        ]
        sizes.append(float(np.sqrt(np.mean(fit_shape(robot, T, at).residual ** 2))))
    assert sizes[0] > 3 * sizes[1] > 9 * sizes[2]


@pytest.mark.parametrize(
    ("change", "options", "message"),
    [
        (lambda T: T[:, :, 0, 0], {}, "poses of fit_shape must be of shape (t, n, 4, 4), (t, n, 7) or (t, n, 3); "
         "instead received shape (3, 2)."),
        (lambda T: T[:, :1], {}, "at of fit_shape must be given unless there are 2 bodies, one on the tip of each"),
        (lambda T: T, {"at": [(1, 0.11)]}, "at of fit_shape must be one place for each of 2 bodies; instead"),
        (lambda T: T, {"at": [(1, 0.11), (2, 0.2)]}, "must be between 0 and 110 mm along segment 2"),
        (lambda T: T * np.reshape([1.0, 1.1, 1.0], (3, 1, 1, 1)), {}, "a matrix that is none in row 2, body 1"),
        (lambda T: T, {"noise": (1e-3, 0.0)}, "Input noise of fit_shape must be positive"),
        (lambda T: T[:, :1], {"at": [(0, 0.0)]}, "a body beyond the base"),
    ],
)  # fmt: skip
def test_what_cannot_be_used_is_refused(change, options, message):
    robot = Robot([SEGMENT] * 2)
    T = robot.poses(shapes(robot, 3), tips(robot))
    with pytest.raises(InputError, match=re.escape(message)):
        fit_shape(robot, change(T), **options)


def test_poses_in_another_unit_or_frame_are_refused():
    robot = Robot([ConstantCurvature(0.1, 0.02)] * 2)
    T = robot.poses(0.01 * np.ones((5, 6)), [point_on(1, 0.1), point_on(2, 0.1)])
    mm = T.copy()
    mm[..., :3, 3] *= 1000
    with pytest.raises(InputError, match=r"poses of fit_shape must be in metres .* positions \d+ m from"):
        fit_shape(robot, mm)
    T[..., :3, 3] += [3.0, 0.0, 1.0]  # of the cameras
    with pytest.raises(InputError, match="in the frame of the base .* positions 3.* m from the base"):
        fit_shape(robot, T)
    assert fit_shape(robot, T, fit_rig=True).residual.max() < 1e-4


def test_coordinates_that_nothing_shows_take_no_freedom():
    """A body between two segments, whichever it is said to be on: the second one counts as if it were not there."""
    two, one = (Robot([ConstantCurvature(0.1, 0.02)] * n) for n in (2, 1))
    rng = np.random.default_rng(0)
    q = 0.01 * rng.normal(size=(40, 3))
    T = one.poses(q, [point_on(1, 0.1)])
    T[..., :3, 3] += 3e-3 * rng.normal(size=T[..., :3, 3].shape)
    b = fit_shape(one, T, [(1, 0.1)])
    for where in ((1, 0.1), (2, 0.0)):
        a = fit_shape(two, T, [where])
        np.testing.assert_array_equal(a.dof, b.dof)
        np.testing.assert_allclose(a.covariance[:, :3, :3], b.covariance, rtol=1e-6)
        assert np.isnan(a.q[:, 3:]).all()


def test_one_slip_of_a_unit_does_not_turn_the_base():
    robot = Robot([ConstantCurvature(0.1, 0.02, extensible=False)] * 2)
    q = 0.01 * np.random.default_rng(0).normal(size=(60, 4))
    T = robot.poses(q, [point_on(1, 0.1), point_on(2, 0.1)])
    T[..., :3, 3] += [1.0, 0.0, 2.0]
    T[5, 0, :3, 3] *= 1000
    found = fit_shape(robot, T, fit_rig=True)
    assert np.median(found.residual) < 1e-3


def test_times_of_ones_own_count():
    T = np.tile(np.eye(4), (3, 1, 1, 1))
    T[..., 2, 3] = 0.1
    robot = Robot([ConstantCurvature(0.1, 0.02)])
    frame = pd.DataFrame({"x_1_mm": [0.0] * 3, "y_1_mm": [0.0] * 3, "z_1_mm": [100.0] * 3})
    np.testing.assert_array_equal(fit_shape(robot, frame, times=[0.0, 0.2, 0.4]).times, [0.0, 0.2, 0.4])
    for options, words in (
        ({"noise": 0.001}, "noise of fit_shape"),
        ({"at": 3}, "at of fit_shape must be a list"),
    ):
        with pytest.raises(InputError, match=words):
            fit_shape(robot, frame, **options)
    with pytest.raises(InputError, match="robot of fit_shape must be one with a coordinate"):
        fit_shape(Robot([Link(0.1)]), frame)


def test_rotations_alone_give_the_bend():
    """What they do not tell, the elongation, stays at the start; nothing is taken from a position that is lost."""
    stiff = Robot([ConstantCurvature(0.11, 0.022, extensible=False)] * 2)
    q = shapes(stiff, 20)
    T = stiff.poses(q, tips(stiff))
    T[..., :3, 3] = np.nan
    found = fit_shape(stiff, T)
    np.testing.assert_allclose(found.q, q, atol=1e-8)
    assert (found.dof == 2).all()
    assert (found.status == "consistent").all()
    stretching = Robot([SEGMENT] * 2)
    free = fit_shape(stretching, T)
    np.testing.assert_allclose(free.q[:, [0, 1, 3, 4]], q, atol=1e-8)
    assert (free.q[:, [2, 5]] == 0).all()
    assert np.isinf(free.covariance[:, [2, 5], [2, 5]]).all()
    assert (free.dof == 2).all()
    assert (free.status == "undetermined").all()
    with pytest.raises(InputError, match="rig of fit_shape must be given to fit a rig to rotations alone"):
        fit_shape(stiff, T, fit_rig=True)


def test_one_body_without_its_position():
    robot = Robot([SEGMENT] * 2)
    q = shapes(robot, 20)
    T = robot.poses(q, tips(robot))
    T[:, 0, :3, 3] = np.nan
    np.testing.assert_allclose(fit_shape(robot, T).q, q, atol=1e-7)


def test_bodies_that_do_not_fit_are_left_out_and_counted():
    """Turned over, exchanged by a turn that is no half turn, 0.6 m off: each is named, and its shape stays right."""
    robot = Robot([ConstantCurvature(0.11, 0.022, extensible=False)] * 3)
    q = shapes(robot, 60)
    T = noisy(robot.poses(q, tips(robot)))
    good = fit_shape(robot, T, noise=NOISE)
    assert not good.left_out.any()
    assert (good.status == "consistent").all()
    T[3, 0, :3, :3] @= np.diag([1.0, -1.0, -1.0])
    T[4, 1, :3, :3] = T[4, 1, :3, :3] @ Rotation.from_rotvec([0.0, 0.0, 1.9]).as_matrix()
    T[5, 0, :3, 3] += 0.6
    T[6, :2, :3, 3] += [[0.0, 0.6, 0.0], [0.3, 0.0, -0.4]]
    found = fit_shape(robot, T, noise=NOISE)
    assert np.argwhere(found.left_out).tolist() == [[3, 0], [4, 1], [5, 0]]
    assert found.status is not None
    assert found.status[3:7].tolist() == ["left out"] * 3 + ["inconsistent"]
    assert (np.delete(found.status, [3, 4, 5, 6]) == "consistent").all()
    np.testing.assert_allclose(found.q[3:6], good.q[3:6], atol=5e-3)
    assert np.isnan(found.residuals[found.left_out]).all()
    assert "0 of 1080 readings missing, 18 left out; 56 rows consistent" in repr(found)
    assert repr(found).endswith("left out: body 1 in 2 shapes, body 2 in 1 shapes")
    whole = fit_shape(robot, T, noise=NOISE, leave_out=False)
    assert not whole.left_out.any()
    assert whole.status is not None
    assert (whole.status[3:7] == "inconsistent").all()
    assert whole.residual[5] > 0.05


def test_where_two_bodies_explain_a_misfit_none_is_left_out():
    """One segment and two bodies on it, of which one shows another shape."""
    robot = Robot([SEGMENT])
    at = [(1, 0.11), (1, 0.06)]
    T = robot.poses(shapes(robot, 9), [point_on(1, 0.11), point_on(1, 0.06)])
    T[4, 1] = T[0, 1]
    found = fit_shape(robot, T, at)
    assert found.status is not None
    assert found.status[4] == "inconsistent"
    assert not found.left_out.any()


def test_a_rig_is_poses():
    with pytest.raises(InputError, match="poses of Rig must be"):
        Rig(np.eye(3), [np.eye(4)])
    with pytest.raises(InputError, match="poses of Rig must be"):
        Rig(np.eye(4), [2 * np.eye(4)])
    assert Rig(np.eye(4), [np.eye(4)] * 3).deviation.shape == (4, 6)


def test_bodies_on_rigid_pieces_at_the_base_are_no_obstacle():
    """No coordinate moves the first two bodies, so the search begins with the third."""
    robot = Robot([Link(0.05), Link(0.02), ConstantCurvature(0.1, 0.02), ConstantCurvature(0.1, 0.02)])
    q = np.random.default_rng(0).uniform(-0.015, 0.015, (20, robot.n_q))
    found = fit_shape(robot, robot.poses(q, tips(robot)))
    np.testing.assert_allclose(found.q, q, atol=1e-7)
    assert set(found.status) == {"consistent"}
