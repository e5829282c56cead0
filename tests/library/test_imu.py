"""Positions along an arm from orientations: closed forms, printed sums, laws."""

import math
from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation, Slerp

from repro import (
    Arm,
    BallJoint,
    InputError,
    Link,
    Robot,
    calibrate_imus,
    calibrated,
    exact_arcs,
    pcc_extended,
    rigid_body,
)
from repro.chain import point_on

MODELS = (pcc_extended, exact_arcs, rigid_body)
UNEVEN = Arm([0, 1, 3, 4], [0.0, 0.08, 0.24, 0.32], [0.08, 0.16, 0.08], sub_segments=3)
EIGHT = Arm(range(9), 0.08 * np.arange(9), [0.08] * 8, markers=[0.36, 0.6], sub_segments=2)
POINTS = [0.0, 0.013, 0.08, 0.1, 0.2, 0.24, 0.3, 0.32]


def bent(seed, samples, imus, size=0.3):
    """Orientations whose neighbours differ by random turns, twist included."""
    turns = size * np.random.default_rng(seed).normal(size=(imus, samples, 3))
    frame, frames = Rotation.identity(samples), []
    for turn in turns:
        frame = frame * Rotation.from_rotvec(turn)
        frames.append(frame.as_quat())
    return np.stack(frames, axis=1)


def rotated(turn, points):
    return turn.apply(points.reshape(-1, 3)).reshape(points.shape)


@pytest.mark.parametrize("n", [1, 2, 5, (4, 1, 3)])
@pytest.mark.parametrize("interpolation", ["midpoints", "inner points"])
def test_printed_sum(n, interpolation):
    """Equations (3) to (7) as a loop, by SciPy's slerp."""
    arm, q = replace(UNEVEN, sub_segments=n, interpolation=interpolation), bent(0, 3, 4)
    for sample in q:
        joints, ends = [np.zeros(3)], [0.0]
        for i, (length, count) in enumerate(zip(arm.link_lengths, np.broadcast_to(n, 3), strict=True)):
            slerp = Slerp([0.0, 1.0], Rotation.from_quat(sample[i : i + 2]))
            for k in range(count):
                t = (k + 1) / (count + 1) if interpolation == "inner points" else (2 * k + 1) / (2 * count)
                joints.append(joints[-1] + slerp(t).apply([0.0, 0.0, length / count]))
                ends.append(ends[-1] + length / count)
        expected = [np.interp(POINTS, ends, x) for x in np.transpose(joints)]
        np.testing.assert_allclose(pcc_extended(sample, arm, POINTS).T, expected, atol=1e-14)


@pytest.mark.parametrize("angle", [1e-9, 1e-4, 1.0, 8.0])
def test_arcs_are_circles(angle):
    s, azimuth = np.linspace(0.0, 0.64, 33), 2.0
    axis = np.array([-np.sin(azimuth), np.cos(azimuth), 0.0])
    q = Rotation.from_rotvec(np.outer(np.array(EIGHT.imu_arcs) / 0.64 * angle, axis)).as_quat()
    at, radius = s / 0.64 * angle, 0.64 / angle
    out = 2 * radius * np.sin(at / 2) ** 2
    expected = np.stack([out * np.cos(azimuth), out * np.sin(azimuth), radius * np.sin(at)], axis=1)
    np.testing.assert_allclose(exact_arcs(q, EIGHT, s), expected, atol=1e-12)


def test_sub_segments_tend_to_arcs_at_second_order():
    q = bent(1, 20, 4)
    gaps = [
        np.abs(pcc_extended(q, replace(UNEVEN, sub_segments=n), 0.32) - exact_arcs(q, UNEVEN, 0.32)).mean()
        for n in (8, 16, 32)
    ]
    np.testing.assert_allclose(np.log2(np.divide(gaps[:-1], gaps[1:])), 2.0, atol=0.01)


def test_rigid_body_is_exact_on_rigid_links():
    robot = Robot([BallJoint(), Link(0.1), BallJoint(), Link(0.2)])
    arm = Arm([1, 2], [0.05, 0.2], [0.1, 0.2])
    T = robot.poses(np.random.default_rng(2).normal(size=(9, 6)), [point_on(2, 0.1), point_on(4, 0.15)])
    q = Rotation.from_matrix(T[..., :3, :3].reshape(-1, 3, 3)).as_quat().reshape(9, 2, 4)
    np.testing.assert_allclose(rigid_body(q, arm, [0.1, 0.25]), T[..., :3, 3], atol=1e-15)


@pytest.mark.parametrize("model", MODELS)
@given(seed=st.integers(0, 2**32 - 1), base=st.tuples(*[st.floats(-3, 3)] * 3))
def test_turned_worlds_signs_and_batches(model, seed, base):
    arm = Arm([1, 2, 3, 4], [0.04, 0.12, 0.2, 0.28], [0.08] * 4) if model is rigid_body else UNEVEN
    q, turn = bent(seed, 6, 4), Rotation.from_rotvec(base)
    shape = model(q, arm, POINTS)
    turned = (turn * Rotation.from_quat(q.reshape(-1, 4))).as_quat().reshape(2, 3, 4, 4)
    turned *= np.random.default_rng(seed).choice([-1.0, 1.0], (2, 3, 4, 1))
    found = model(turned.tolist(), arm, POINTS)
    np.testing.assert_allclose(found, rotated(turn, shape).reshape(2, 3, 8, 3), atol=1e-13)


def test_links_that_lead_aside_are_those_of_a_robot_and_are_found():
    """Positions of a chain whose links have a vector, and the vectors from positions."""
    offsets = np.array([[0.01, -0.02, 0.005], [0.0, 0.015, -0.01]])
    links = [Link(0.1, offset=offsets[0]), Link(0.15, offset=offsets[1])]
    robot = Robot([BallJoint("xyz"), links[0], BallJoint("xyz"), links[1]])
    turns = 0.5 * np.random.default_rng(2).normal(size=(40, 6))
    places = [point_on(2, 0.0), point_on(4, 0.0), point_on(2, 0.05), point_on(2, 0.1), point_on(4, 0.15)]
    T = robot.poses(turns, places)
    q = Rotation.from_matrix(T[:, :2, :3, :3].reshape(-1, 3, 3)).as_quat().reshape(40, 2, 4)
    drawn = Arm([1, 2], [0.0, 0.1], [0.1, 0.15], markers=[0.05, 0.1, 0.25])
    arm = replace(drawn, link_offsets=offsets.tolist())
    np.testing.assert_allclose(rigid_body(1.0004 * q, arm, arm.markers), T[:, 2:, :3, 3], atol=1e-14)

    markers = T[:, 2:, :3, 3]
    found = calibrate_imus(q, markers, rigid_body, drawn, noise=1e-5, link=0.02)
    assert found.names[-6:] == tuple(f"link_{x}_{k}" for k in (1, 2) for x in "xyz")
    again = rigid_body(calibrated(q, found), found.arm(drawn), drawn.markers) + found.translation
    np.testing.assert_allclose(again, markers, atol=2e-5)
    without = calibrate_imus(q, markers, rigid_body, drawn, noise=1e-5)
    assert found.rms < 1e-5 < 1e-3 < without.rms
    assert found.arm(drawn).link_offsets[0][2] == pytest.approx(0.005, abs=1e-3)  # a length has no rival
    assert without.arm(drawn) is drawn


@pytest.mark.parametrize(("last", "imus", "links"), [(0.05, "1", "1"), (0.1, "12", "1"), (0.11, "12", "12")])
def test_only_what_comes_before_the_last_marker_may_be_off(last, imus, links):
    """An IMU at the last marker turns the link that ends there; a link that begins there moves no marker."""
    arm = Arm([1, 2], [0.0, 0.1], [0.1, 0.15], markers=[last])
    names = calibrate_imus(bent(3, 40, 2), np.zeros((40, 1, 3)), rigid_body, arm, link=0.02).names
    for part, expected in (("heading_", imus), ("mounting_x_", imus), ("link_z_", links)):
        assert "".join(name[-1] for name in names if name.startswith(part)) == expected


def test_the_residual_is_the_root_mean_square_of_distances():
    """Markers that are 1 mm to one side and the other in turn: no frame explains it."""
    q = bent(3, 40, 9)
    seen = exact_arcs(q, EIGHT, EIGHT.markers)
    seen[..., 0] += 1e-3 * (-1) ** np.arange(40)[:, None]
    assert calibrate_imus(q, seen, exact_arcs, EIGHT, per_imu=False).rms == pytest.approx(1e-3, rel=0.05)


def test_an_imu_at_the_last_marker_counts():
    arm = Arm([0, 1, 2], [0.0, 0.3, 0.6], [0.3, 0.3], markers=[0.2, 0.6], sub_segments=1)
    q = bent(3, 20, 3)
    found = calibrate_imus(q, exact_arcs(q, arm, arm.markers), exact_arcs, arm)
    assert [name for name in found.names if "heading" in name] == ["heading_1", "heading_2"]


def test_orientations_of_an_arm():
    q, turn = bent(4, 3, 9), (0.0, 0.0, math.sqrt(0.5), math.sqrt(0.5))
    arm = replace(UNEVEN, base_turn=turn)
    expected = Rotation.from_quat(q[:, [0, 1, 3, 4]].reshape(-1, 4)).as_matrix().reshape(3, 4, 3, 3)
    expected[:, 0] = expected[:, 0] @ Rotation.from_quat(turn).as_matrix()  # the first IMU holds the base
    found = Rotation.from_quat(arm.select(q).reshape(-1, 4)).as_matrix().reshape(3, 4, 3, 3)
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-14)


@pytest.mark.parametrize("model", MODELS)
@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"q": np.ones((2, 3, 4)) / 2}, r"orientations of {} must be numbers of shape \(..., 4, 4\)"),
        ({"q": np.full((2, 4, 4), np.nan)}, "orientations of {} must be finite"),
        (
            {"q": np.full((2, 4, 4), 0.501)},
            r"orientations of {} must be unit quaternions .* norm of 1\.002",
        ),
        ({"points": [0.1, 0.33]}, r"arc_lengths of {} must be distances between 0 and 0\.32 m"),
        ({"points": [-1e-9]}, "arc_lengths of {} must be distances between 0 and"),
        ({"points": []}, "arc_lengths of {} must be distances .* at least one"),
        ({"arm": EIGHT.imus}, "arm of {} must be an Arm; instead received tuple"),
    ],
)
def test_bad_input_of_a_model(model, change, message):
    rigid = Arm([1, 2, 3, 4], [0.08, 0.16, 0.24, 0.32], [0.08] * 4)
    arms = (rigid, UNEVEN) if model is rigid_body else (UNEVEN, rigid)
    given = {"q": bent(5, 2, 4), "arm": arms[0], "points": [0.1]}
    for bad, words in ((change, message), ({"arm": arms[1]}, "arm of {} must be one with")):
        with pytest.raises(InputError, match=words.format(model.__name__)):
            model(*(given | bad).values())


SCALE = np.array([math.radians(10)] * 3 + [0.05] * 3 + [math.radians(x) for x in (10, 5, 5)] * 7)


def measured(seed, samples, noise=0.0, per_imu=True):
    """Orientations with known errors, and markers; truth drawn from the prior."""
    rng = np.random.default_rng(seed)
    z = SCALE * rng.normal(size=27) * np.where(np.arange(27) < 6, 1.0, per_imu)
    heading, mounting = np.zeros((9, 3)), np.zeros((9, 3))
    heading[1:8, 2], mounting[1:8, :2] = z[6::3], z[6:].reshape(7, 3)[:, 1:]
    true = bent(seed, samples, 9)
    before, after = Rotation.from_rotvec(-heading), Rotation.from_rotvec(-mounting)
    raw = np.stack([(before * Rotation.from_quat(q) * after).as_quat() for q in true])
    markers = rotated(Rotation.from_rotvec(z[:3]), exact_arcs(true, EIGHT, EIGHT.markers)) + z[3:6]
    return raw, markers + noise * rng.normal(size=markers.shape), z


@pytest.mark.parametrize("seed", range(4))
def test_frame_is_exact_without_noise(seed):
    raw, markers, z = measured(seed, 5, per_imu=False)
    found = calibrate_imus(raw, markers, exact_arcs, EIGHT, per_imu=False, noise=1e-7)
    np.testing.assert_allclose(found.estimate, z[:6], atol=1e-9)
    positions = exact_arcs(calibrated(raw, found), EIGHT, EIGHT.markers) + found.translation
    np.testing.assert_allclose(positions, markers, atol=1e-9)


def test_known_parameters_and_the_least_squares_of_the_docstring():
    raw, markers, z = measured(7, 60, noise=0.005)
    markers[3:8, 1] = np.nan
    markers[10, 0, 2] = np.inf
    found = calibrate_imus(raw, markers, exact_arcs, EIGHT, noise=0.005)
    assert found.names[5:8] == ("translation_z", "heading_1", "mounting_x_1")
    assert (found.used, found.missing) == (114, 6)
    assert (np.abs(found.estimate - z) < 4 * found.deviation).all()
    assert 10 < (found.estimate - z) @ np.linalg.solve(found.covariance, found.estimate - z) < 50

    def residuals(x):  # with all of x in units of the tolerances
        z = SCALE * x
        turns = np.zeros((9, 3)), np.zeros((9, 3))
        turns[0][1:8, 2], turns[1][1:8, :2] = z[6::3], z[6:].reshape(7, 3)[:, 1:]
        heading, mounting = map(Rotation.from_rotvec, turns)
        links = np.stack([(heading * Rotation.from_quat(q) * mounting).as_quat() for q in raw])
        points = rotated(Rotation.from_rotvec(z[:3]), exact_arcs(links, EIGHT, EIGHT.markers)) + z[3:6]
        off = (points - markers) / 0.005
        return np.append(off[np.isfinite(off).all(axis=-1)], x)

    fit = least_squares(residuals, z / SCALE, jac="3-point")
    deviation = SCALE * np.sqrt(np.diag(np.linalg.inv(fit.jac.T @ fit.jac)))
    np.testing.assert_allclose(found.estimate / deviation, SCALE * fit.x / deviation, atol=0.01)
    np.testing.assert_allclose(found.deviation, deviation, rtol=1e-3)


ARM = partial(replace, UNEVEN)
CALIBRATION = partial(
    calibrate_imus, model=exact_arcs, arm=EIGHT, orientations=bent(0, 5, 9), markers=np.zeros((5, 2, 3))
)


@pytest.mark.parametrize(
    ("call", "change", "message"),
    [
        (ARM, {"imus": [0, 1, 1, 4]}, "Input imus of Arm must be different whole numbers from 0 on"),
        (ARM, {"imus": [-1, 1, 3, 4]}, "imus of Arm must be different whole numbers"),
        (
            ARM,
            {"imu_arcs": [0.0, 0.08, 0.08, 0.3]},
            r"imu_arcs of Arm must be increasing from 0 or above \[m\]",
        ),
        (ARM, {"link_lengths": [0.1] * 4}, r"link_lengths of Arm must be numbers of shape \(3\); .* \(4,\)"),
        (ARM, {"link_lengths": [0.1, 0.0, 0.1]}, r"link_lengths of Arm must be positive \[m\]"),
        (
            ARM,
            {"sub_segments": [1, 2]},
            "sub_segments of Arm must be 0 or a positive whole number, or one such",
        ),
        (ARM, {"sub_segments": [1, 0, 2]}, "sub_segments of Arm must be 0 or a positive whole number"),
        (ARM, {"sub_segments": 1.5}, "sub_segments of Arm must be 0 or a positive whole number"),
        (ARM, {"interpolation": "middle"}, "interpolation of Arm must be 'midpoints' or 'inner points'"),
        (ARM, {"base_turn": [0, 0, 0, 2]}, "base_turn of Arm must be unit quaternions XYZW"),
        (UNEVEN.select, {"orientations": bent(0, 1, 4)}, r"those of IMUs 0 to 4; .* shape \(1, 4, 4\)"),
        (
            CALIBRATION,
            {"markers": np.zeros((5, 1, 3))},
            r"markers of .* must be numbers of shape \(5, 2, 3\)",
        ),
        (CALIBRATION, {"markers": np.full((5, 2, 3), np.nan)}, "at least two positions that were seen; .* 0"),
        (CALIBRATION, {"noise": 0.0}, r"noise of calibrate_imus must be positive; instead received 0\.0"),
        (CALIBRATION, {"heading": math.inf}, "heading of calibrate_imus must be positive"),
        (
            CALIBRATION,
            {"link": 0.01},
            "link of calibrate_imus must be not negative, and zero but for a rigid-body",
        ),
        (
            CALIBRATION,
            {"orientations": bent(0, 5, 8)},
            r"orientations of calibrate_imus must be .* \(any, 9, 4\)",
        ),
    ],
)
def test_bad_input(call, change, message):
    with pytest.raises(InputError, match=message):
        call(**change)
