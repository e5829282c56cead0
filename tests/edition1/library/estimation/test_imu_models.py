"""Shapes between IMUs: closed forms, laws, the printed equations, and orders of convergence on smooth curves."""

import tracemalloc
from dataclasses import replace

import numpy as np
import pytest
import roma
import torch
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation, Slerp
from smooth_curves import LENGTH, STEPS, evenly, read, smooth_curves

from edition1.errors import InputError
from edition1.estimation.imu_models import (
    chain,
    exact_arcs,
    pcc_extended,
    rigid_links,
    tangent_interpolation,
    tangent_spline,
)
from edition1.estimation.imu_selection import Selection
from edition1_companion.recordings.martin2022_models import selection

BETWEEN = (pcc_extended, exact_arcs, tangent_interpolation, tangent_spline)
UNEVEN = Selection((0, 1, 3, 4), (0.0, 0.08, 0.24, 0.32), (0.08, 0.16, 0.08), sub_links=3)
POINTS = np.array([0.0, 0.013, 0.08, 0.1, 0.2, 0.24, 0.3, 0.32])


def random_orientations(seed, *shape):
    return Rotation.random(int(np.prod(shape)), rng=seed).as_quat().reshape(*shape, 4)


def mild_orientations(seed, samples, imus):
    """Neighbours at most about 1 rad apart, twist included."""
    rng = np.random.default_rng(seed)
    turns = (
        Rotation.from_rotvec(0.3 * rng.normal(size=(samples * imus, 3))).as_quat().reshape(samples, imus, 4)
    )
    links = [Rotation.from_quat(turns[:, 0])]
    for imu in range(1, imus):
        links.append(links[-1] * Rotation.from_quat(turns[:, imu]))
    return np.stack([link.as_quat() for link in links], axis=1)


def circle(angle, arcs, turn=0.0):
    """Frames and points of an arc of 640 mm that bends towards the azimuth ``turn``, upright at the base."""
    at = np.asarray(arcs) / LENGTH * angle
    radius = LENGTH / angle
    out, up = 2 * radius * np.sin(at / 2) ** 2, radius * np.sin(at)
    frames = Rotation.from_rotvec(at[:, None] * np.array([-np.sin(turn), np.cos(turn), 0.0])).as_quat()
    return frames, np.stack([np.cos(turn) * out, np.sin(turn) * out, up], axis=1)


def printed_pcc(orientations, lengths, n):
    """Equations (3) to (7) as printed, one sample and sub-segment at a time, by SciPy's slerp."""
    joints = np.zeros((len(orientations), len(lengths) * n + 1, 3))
    for sample, q in enumerate(orientations):
        at = joints[sample]
        for i, length in enumerate(lengths):
            slerp = Slerp([0.0, 1.0], Rotation.from_quat(q[i : i + 2]))
            for k in range(n):
                step = slerp((2 * k + 1) / (2 * n)).as_matrix() @ [0.0, 0.0, length / n]
                at[i * n + k + 1] = at[i * n + k] + step
    return joints


@pytest.mark.parametrize("n", [1, 2, 3, 8])
def test_agrees_with_the_equations_as_a_loop(n):
    q, arm = mild_orientations(0, 5, 4), replace(UNEVEN, sub_links=n)
    joints = printed_pcc(q, arm.link_lengths, n)
    ends = np.append(0.0, np.cumsum(np.repeat(np.array(arm.link_lengths) / n, n)))
    np.testing.assert_allclose(pcc_extended(q, arm, ends), joints, atol=1e-14)
    between = [np.interp(POINTS, ends, x) for x in joints[0].T]
    np.testing.assert_allclose(pcc_extended(q, arm, POINTS)[0].T, between, atol=1e-14)


def test_orientations_between_are_those_of_roma():
    """Tangents of the arcs by differences of positions, against RoMa's slerp."""
    q = mild_orientations(1, 1, 2)[0]
    arm, t = Selection((0, 1), (0.0, 0.08), (0.08,), sub_links=1), np.array([0.1, 0.5, 0.8])
    points = exact_arcs(q, arm, np.concatenate([0.08 * t - 1e-6, 0.08 * t + 1e-6]))
    q0, q1 = torch.from_numpy(q)
    between = roma.unitquat_slerp(q0, q1, torch.from_numpy(t), shortest_arc=True)
    expected = roma.unitquat_to_rotmat(between)[:, :, 2].numpy()
    np.testing.assert_allclose((points[3:] - points[:3]) / 2e-6, expected, atol=1e-9)


def test_arcs_are_the_left_jacobian_of_so3():
    q = mild_orientations(2, 20, 2)
    arm = Selection((0, 1), (0.0, 0.08), (0.08,), sub_links=1)
    w = (Rotation.from_quat(q[:, 1]) * Rotation.from_quat(q[:, 0]).inv()).as_rotvec()
    angle = np.linalg.norm(w, axis=1)[:, None]
    d = Rotation.from_quat(q[:, 0]).apply([0.0, 0.0, 1.0])
    wd = np.cross(w, d)
    J_d = d + (1 - np.cos(angle)) / angle**2 * wd + (angle - np.sin(angle)) / angle**3 * np.cross(w, wd)
    np.testing.assert_allclose(exact_arcs(q, arm, 0.08)[:, 0], 0.08 * J_d, atol=1e-15)


@pytest.mark.parametrize("angle", [1e-9, 1e-4, 1.0, 3.0, 8.0])
@pytest.mark.parametrize("turn", [0.0, 2.0])
def test_arcs_are_exact_for_constant_curvature(angle, turn):
    arm = selection("pcc", 8)
    points = np.linspace(0.0, 0.64, 33)
    frames, expected = circle(angle, arm.arcs, turn)[0], circle(angle, points, turn)[1]
    np.testing.assert_allclose(exact_arcs(frames, arm, points), expected, atol=1e-12)


@pytest.mark.parametrize("imus", [2, 8])
def test_pcc_extended_tends_to_the_circle_at_second_order(imus):
    frames, tip = circle(2.0, evenly(imus, 1).arcs)[0], circle(2.0, [LENGTH])[1]
    errors = [
        np.linalg.norm(pcc_extended(frames, evenly(imus, n), LENGTH) - tip) for n in (1, 2, 4, 8, 16, 1024)
    ]
    np.testing.assert_allclose(np.log2(np.array(errors[:4]) / errors[1:5]), 2.0, atol=0.1 / imus)
    assert errors[-1] < 1e-6


def test_linear_interpolation_of_tangents_is_not_quite_the_circle():
    """Its angle lags behind that of the circle, then runs ahead; at the next IMU little of that is left."""
    frames, points = circle(1.0, [0.0, LENGTH])[0], circle(1.0, [LENGTH / 2, LENGTH])[1]
    arm = Selection((0, 8), (0.0, LENGTH), (LENGTH,), sub_links=512)
    off = np.linalg.norm(tangent_interpolation(frames, arm, [LENGTH / 2, LENGTH]) - points, axis=1)
    angles = np.linspace(0.0, 1.0, 20001)
    lerp = np.arctan2(angles * np.sin(1.0), 1 - angles + angles * np.cos(1.0))
    tip = LENGTH * np.trapezoid(np.stack([np.sin(lerp), 0 * lerp, np.cos(lerp)]), angles, axis=1)
    np.testing.assert_allclose(off[1], np.linalg.norm(tip - points[1]), rtol=1e-3)
    assert 1e-5 < off[1] < off[0] < 5e-3


def test_chain_joints_lie_on_the_arc_widened_as_stated():
    """On a planar arc the joints of n sub-segments are those of the arc times 1/sinc(phi/2n)."""
    angle, n = 1.3, 3
    arm = Selection((0, 8), (0.0, LENGTH), (LENGTH,), sub_links=n)
    frames, points = circle(angle, [0.0, LENGTH])[0], circle(angle, LENGTH * np.arange(n + 1) / n)[1]
    factor = (angle / (2 * n)) / np.sin(angle / (2 * n))
    np.testing.assert_allclose(
        pcc_extended(frames, arm, LENGTH * np.arange(n + 1) / n), factor * points, atol=1e-15
    )


def test_twist_alone_and_helices():
    """A twisted straight arm stays straight; a constant rate with twist is a helix, by the matrix exponential."""
    arm = selection("pcc", 8)
    twisted = Rotation.from_rotvec(np.outer(np.linspace(0.0, 5.0, 9), [0.0, 0.0, 1.0])).as_quat()
    for model in BETWEEN:
        np.testing.assert_allclose(model(twisted, arm, arm.arcs)[:, 2], arm.arcs, atol=1e-15)
    rate = torch.tensor([2.0, 1.0, 4.0, 0.0, 0.0, 1.0], dtype=torch.float64)  # per m, body frame
    generator = torch.zeros(4, 4, dtype=torch.float64)
    generator[:3, :3], generator[:3, 3] = (
        torch.tensor([[0, -4, 1], [4, 0, -2], [-1, 2, 0]]).double(),
        rate[3:],
    )
    poses = torch.linalg.matrix_exp(torch.tensor(arm.arcs)[:, None, None] * generator).numpy()
    frames = Rotation.from_matrix(poses[:, :3, :3]).as_quat()
    np.testing.assert_allclose(exact_arcs(frames, arm, arm.arcs), poses[:, :3, 3], atol=1e-14)


def test_straight_arm_is_straight_in_all_models():
    upright = np.tile([0.0, 0.0, 0.0, 1.0], (9, 1))
    points = np.linspace(0.0, 0.64, 20)
    for model in BETWEEN:
        found = model(upright, selection("pcc", 8), points)
        np.testing.assert_allclose(found, points[:, None] * [0.0, 0.0, 1.0], atol=1e-15)
    found = rigid_links(upright[1:], selection("rigid", 8), points)
    np.testing.assert_allclose(found, points[:, None] * [0.0, 0.0, 1.0], atol=1e-15)


@pytest.mark.parametrize("model", BETWEEN)
@given(seed=st.integers(0, 2**32 - 1), base=st.tuples(*[st.floats(-3, 3)] * 3))
def test_turning_the_world_turns_the_shape_and_signs_do_not_matter(model, seed, base):
    q, turn = mild_orientations(seed, 3, 4), Rotation.from_rotvec(base)
    shape = model(q, UNEVEN, POINTS)
    turned = (turn * Rotation.from_quat(q.reshape(-1, 4))).as_quat().reshape(q.shape)
    expected = turn.apply(shape.reshape(-1, 3)).reshape(shape.shape)
    np.testing.assert_allclose(model(turned, UNEVEN, POINTS), expected, atol=1e-13)
    flipped = q * np.random.default_rng(seed).choice([-1.0, 1.0], (3, 4, 1))
    np.testing.assert_allclose(model(flipped, UNEVEN, POINTS), shape, atol=1e-14)


@pytest.mark.parametrize("model", [tangent_interpolation, tangent_spline])
def test_twist_of_the_imus_has_no_effect_on_models_of_tangents(model):
    q = mild_orientations(3, 4, 4)
    twist = Rotation.from_rotvec(np.outer(np.arange(16.0), [0.0, 0.0, 1.0]))
    twisted = (Rotation.from_quat(q.reshape(-1, 4)) * twist).as_quat().reshape(q.shape)
    np.testing.assert_allclose(model(twisted, UNEVEN, POINTS), model(q, UNEVEN, POINTS), atol=1e-14)


@pytest.mark.parametrize("model", BETWEEN)
def test_lengths_along_the_curve(model):
    """Points on one sub-segment are as far apart as on the arm; farther points at most."""
    q = mild_orientations(4, 6, 4)
    s = np.linspace(0.0, 0.32, 400)
    steps = np.linalg.norm(np.diff(model(q, UNEVEN, s), axis=1), axis=2) / np.diff(s)
    assert steps.max() < 1 + 1e-12
    assert np.quantile(steps, 0.05) > 1 - (1e-4 if model in (exact_arcs, tangent_spline) else 1e-12)


@pytest.mark.parametrize("model", BETWEEN)
@pytest.mark.parametrize("batch", [(), (1,), (3, 1, 2), (0,)])
def test_any_batch_shape(model, batch):
    q = mild_orientations(5, int(np.prod(batch)), 4).reshape(*batch, 4, 4)
    found = model(q, UNEVEN, POINTS)
    assert found.shape == (*batch, len(POINTS), 3)
    flat = model(q.reshape(-1, 4, 4), UNEVEN, POINTS)
    np.testing.assert_allclose(found.reshape(flat.shape), flat, atol=1e-15)
    assert model(q, UNEVEN, 0.1).shape == (*batch, 1, 3)


def test_single_imu():
    tilted = Rotation.from_rotvec([0.0, 0.5, 0.0]).as_quat()[None]
    rigid = Selection((4,), (0.32,), (0.64,))
    np.testing.assert_allclose(
        rigid_links(tilted, rigid, [0.64]), [[0.64 * np.sin(0.5), 0.0, 0.64 * np.cos(0.5)]], atol=1e-15
    )
    pair = np.concatenate([[[0.0, 0.0, 0.0, 1.0]], tilted])
    arm = Selection((0, 8), (0.0, 0.64), (0.64,), sub_links=64)
    expected = circle(0.5, [0.64])[1]
    for model in BETWEEN:
        np.testing.assert_allclose(model(pair, arm, [0.64]), expected, atol=0.64 * 0.5**3 / 200)


def test_chain_takes_either_kind_of_links():
    q = mild_orientations(6, 2, 9)
    for arm, model in ((selection("rigid", 8), rigid_links), (selection("rigid", 8, "files"), pcc_extended)):
        np.testing.assert_array_equal(chain(arm.of(q), arm, arm.markers), model(arm.of(q), arm, arm.markers))


def test_spline_is_exact_for_a_straight_line_of_tangents_and_agrees_with_fine_quadrature():
    q = mild_orientations(7, 3, 4)
    fine = np.linspace(0.0, 0.32, 321)
    points = tangent_spline(q, UNEVEN, fine)
    directions = np.diff(points, axis=1) / np.diff(fine)[:, None]
    at_imus = np.cumsum(np.append(0.0, UNEVEN.link_lengths))
    tangents = Rotation.from_quat(q.reshape(-1, 4)).apply([0, 0, 1]).reshape(3, 4, 3)
    np.testing.assert_allclose(directions[:, 0], tangents[:, 0], atol=0.02)
    np.testing.assert_allclose(directions[:, -1], tangents[:, -1], atol=0.02)
    for arc in at_imus:
        alone = tangent_spline(q, UNEVEN, [arc])[:, 0]
        np.testing.assert_allclose(alone, points[:, round(arc / 1e-3)], atol=2e-6)


def errors_mm(model, arm, frames, points, at=None):
    at = np.array(arm.markers) if at is None else at
    truth = points[:, np.round(at / LENGTH * STEPS).astype(int)]
    return 1e3 * np.linalg.norm(model(read(frames, arm), arm, at) - truth, axis=-1)


def test_targets_on_smooth_curves():
    """Perfect sensors, medians over 200 curves, both markers: the targets of the models against each other."""
    frames, points, curvature, _ = smooth_curves(200)
    assert 3 < np.median(curvature) < 6  # rad/m: neighbours 14 to 28 deg apart where the arm bends most
    rigid, pcc, arcs, spline = (
        np.median(errors_mm(model, arm, frames, points), axis=0)
        for model, arm in (
            (rigid_links, selection("rigid", 8)),
            (pcc_extended, selection("pcc", 8)),
            (exact_arcs, selection("pcc", 8)),
            (tangent_spline, selection("pcc", 8)),
        )
    )
    assert (pcc <= 0.7 * rigid).all()
    assert (arcs <= pcc).all()
    assert (spline <= 0.5 * pcc).all()


@pytest.mark.parametrize(
    ("model", "sub_links", "middle", "order"),
    [
        (rigid_links, 0, False, 1),
        (rigid_links, 0, True, 2),
        (pcc_extended, 2, False, 2),
        (exact_arcs, 1, False, 2),
        (tangent_interpolation, 2, False, 2),
    ],
)
def test_order_in_the_spacing_of_the_imus(model, sub_links, middle, order):
    frames, points, _, _ = smooth_curves(40, bend=1.0, seed=1)
    tip = np.array([LENGTH])
    errors = [
        errors_mm(model, evenly(n, sub_links, middle=middle), frames, points, tip).mean()
        for n in (16, 32, 64)
    ]
    np.testing.assert_allclose(np.log2(np.array(errors[:-1]) / errors[1:]), order, atol=0.05)


def test_spline_is_of_fourth_order_or_better():
    frames, points, _, _ = smooth_curves(40, bend=1.0, seed=1)
    errors = [
        errors_mm(tangent_spline, evenly(n, 1), frames, points, np.array([LENGTH])).mean()
        for n in (8, 16, 32)
    ]
    assert (np.log2(np.array(errors[:-1]) / errors[1:]) > 4).all()


def test_sub_segments_tend_to_the_arcs_at_second_order():
    frames = smooth_curves(40, bend=1.0, seed=1)[0]
    limit = exact_arcs(read(frames, evenly(8, 1)), evenly(8, 1), LENGTH)
    gaps = []
    for n in (1, 2, 4, 8, 16):
        chain_of_n = pcc_extended(read(frames, evenly(8, n)), evenly(8, n), LENGTH)
        gaps.append(np.linalg.norm(chain_of_n - limit, axis=-1).mean())
    np.testing.assert_allclose(np.log2(np.array(gaps[:-1]) / gaps[1:]), 2.0, atol=0.01)


@pytest.mark.parametrize("model", BETWEEN)
def test_eight_thousand_samples_in_little_memory(model):
    q, arm = mild_orientations(8, 8000, 9), selection("pcc", 8)
    plain = getattr(model, "__wrapped__", model)  # without the checks of annotations
    plain(q, arm, arm.markers)  # what is kept from a first call is not its memory
    tracemalloc.start()
    plain(q, arm, arm.markers)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 200e6


@pytest.mark.parametrize("model", BETWEEN)
@pytest.mark.parametrize(
    ("change", "message"),
    [
        (
            {"q": random_orientations(9, 2, 3)},
            r"orientations of {} must be those of the 4 IMUs of the selection",
        ),
        (
            {"q": np.full((2, 4, 4), np.nan)},
            r"orientations of {} must be finite unit quaternions \(within 1e-3\)",
        ),
        ({"q": 1.01 * random_orientations(9, 2, 4)}, "orientations of {} must be finite unit quaternions"),
        ({"points": [0.1, 0.33]}, r"arc_lengths of {} must be distances between 0 and 0\.32 m"),
        ({"points": [-1e-9]}, r"arc_lengths of {} must be distances between 0 and 0\.32 m"),
        ({"points": [np.nan]}, r"arc_lengths of {} must be distances between 0 and 0\.32 m"),
        (
            {"arm": Selection((1, 2, 3, 4), (0.08, 0.16, 0.24, 0.32), (0.08,) * 4)},
            r"selection of {} must be one with links between IMUs \(sub_links above 0\)",
        ),
    ],
)
def test_bad_input(model, change, message):
    given = {"q": random_orientations(9, 2, 4), "arm": UNEVEN, "points": [0.1]} | change
    owner = "(tangent_interpolation|point_at)" if model is tangent_interpolation else model.__name__
    with pytest.raises(InputError, match=message.format(owner)):
        model(given["q"], given["arm"], given["points"])


def test_rigid_links_needs_one_link_per_imu():
    with pytest.raises(InputError, match="link_lengths of rigid_body must be one length per link, 4 in all"):
        rigid_links(random_orientations(9, 2, 4), UNEVEN, [0.1])


@pytest.mark.parametrize("model", [tangent_interpolation, tangent_spline])
def test_opposite_neighbours_have_no_tangent_between_them(model):
    q = Rotation.from_rotvec([[0.0, 0.0, 0.0], [np.pi, 0.0, 0.0]]).as_quat()
    arm = Selection((0, 1), (0.0, 0.08), (0.08,), sub_links=1)
    message = (
        "orientations of {} must be such that neighbours do not point in opposite directions; .* 1 that do"
    )
    with pytest.raises(InputError, match=message.format(model.__name__)):
        model(q, arm, [0.08])
