"""The released chains of a made-up arm, against the same sums written out in NumPy, one sub-segment at a time."""

from dataclasses import replace

import numpy as np
import pytest

from edition1.errors import InputError
from edition1.estimation.imu_models import (
    chain,
    exact_arcs,
    pcc_extended,
    tangent_interpolation,
    tangent_spline,
)
from edition1.estimation.imu_selection import Selection
from edition1_companion.pages.how_many_imus.bounds import pcc_bound
from edition1_companion.recordings.martin2022_models import selection

FILES = [("rigid", 2, None), ("rigid", 4, None), ("pcc", 2, 16), ("pcc", 4, 16)]
FILES += [("pcc", 8, n) for n in (8, 16, 32, 64)]


@pytest.fixture
def arm():
    """Base upright, IMUs turned further and further, each also about the arm."""
    q = np.zeros((5, 9, 4))
    for row in range(5):
        for imu in range(9):
            bend, twist = np.radians(9.0 * imu + 3 * row), np.radians(7.0 * imu * (row - 2))
            # A turn about z, then one about x, written out.
            q[row, imu] = [
                np.sin(bend / 2) * np.cos(twist / 2),
                -np.sin(bend / 2) * np.sin(twist / 2),
                np.cos(bend / 2) * np.sin(twist / 2),
                np.cos(bend / 2) * np.cos(twist / 2),
            ]
    q[:, 0] = [0, 0, 0, 1]
    return q


def between(a, b, t):
    """Spherical linear interpolation as it is usually written, with sines, by the shorter way round."""
    b = b if a @ b >= 0 else -b
    angle = np.arccos(np.clip(a @ b, -1, 1))
    return a if angle == 0 else (np.sin((1 - t) * angle) * a + np.sin(t * angle) * b) / np.sin(angle)


def z_axis(q):
    x, y, z, w = q
    return np.array([2 * (x * z + w * y), 2 * (y * z - w * x), w * w - x * x - y * y + z * z])


def written_out(q, links, n, t, points):
    """Points of one sample, from the base: ``links`` in metres, ``t(k, n)`` the rule, all others as released."""
    joints, ends = [np.array([0.0, 0.0, 0.0178])], [0.0]
    for i, length in enumerate(links):
        for k in range(max(n, 1)):
            direction = z_axis(between(q[i], q[i + 1], t(k, n)) if n else q[i])
            joints.append(joints[-1] + length / max(n, 1) * direction)
            ends.append(ends[-1] + length / max(n, 1))
    return np.stack([np.interp(points, ends, column) for column in np.array(joints).T], axis=-1)


@pytest.mark.parametrize(("model", "imus", "segments"), FILES)
def test_released_chains(arm, model, imus, segments):
    made = selection(model, imus, "files", segments=segments)
    turned = arm.copy()
    turned[:, 0] = [0, 0, 1, 0]  # (w, x, y, z) = (0, 0, 0, 1)
    released = {
        ("rigid", 2): ([1, 6], [0.302, 0.32]),
        ("rigid", 4): ([1, 3, 5, 7], [0.142, 0.16, 0.16, 0.16]),
        ("pcc", 2): ([0, 4, 8], [0.3022, 0.32]),
        ("pcc", 4): ([0, 2, 4, 6, 8], [0.1422, 0.16, 0.16, 0.16]),
        ("pcc", 8): (list(range(8 if segments == 8 else 9)), [0.057] + [0.08] * (6 if segments == 8 else 7)),
    }
    used, links = released[model, imus]
    n = 0 if model == "rigid" else segments // imus

    def rule(k, n):
        return (k + 1) / (n + 1) if model == "pcc" and imus == 8 else (2 * k + 1) / (2 * n)

    points = [0.0, 0.013, 0.0285, *made.markers, sum(links)]
    expected = [written_out(sample[used], links, n, rule, points) for sample in turned]
    np.testing.assert_allclose(chain(made.of(arm), made, points), expected, atol=1e-14)


def test_both_rules_agree_with_one_sub_segment_and_in_the_limit(arm):
    one = selection("pcc", 8, segments=8)
    inner = replace(one, interpolation="inner points")
    np.testing.assert_allclose(chain(arm, inner, [0.36]), chain(arm, one, [0.36]), atol=1e-15)
    many = replace(inner, sub_links=4096)
    np.testing.assert_allclose(chain(arm, many, [0.36]), exact_arcs(arm, one, [0.36]), atol=2e-5)


def test_inner_points_of_an_arc():
    """A quarter circle of two links of 1 m: directions at 30 and 60 degrees; the printed rule has 22.5 and 67.5."""
    quarter = np.array([[0.0, 0.0, 0.0, 1.0], [0.0, np.sqrt(0.5), 0.0, np.sqrt(0.5)]])
    made = Selection((0, 1), (0.0, 2.0), (2.0,), sub_links=2, interpolation="inner points")
    side, up = 0.5, np.sqrt(0.75)
    expected = [[side, 0, up], [side + up, 0, side + up]]
    np.testing.assert_allclose(pcc_extended(quarter, made, [1.0, 2.0]), expected, atol=1e-15)
    linear = np.array([np.sqrt(0.2), 0, np.sqrt(0.8)])  # a third of the way along the chord
    np.testing.assert_allclose(tangent_interpolation(quarter, made, [1.0])[0], linear, atol=1e-15)


@pytest.mark.parametrize("model", [chain, exact_arcs, tangent_interpolation, tangent_spline])
def test_origin_moves_every_model(arm, model):
    made = selection("pcc", 8)
    moved = replace(made, origin_m=(0.1, -0.2, 0.0178))
    difference = model(arm, moved, [0.0, 0.36]) - model(arm, made, [0.0, 0.36])
    np.testing.assert_allclose(difference, np.broadcast_to([0.1, -0.2, 0.0178], (5, 2, 3)), atol=1e-15)


def test_bounds_hold_for_the_printed_rule_only():
    made = replace(selection("pcc", 8), interpolation="inner points")
    with pytest.raises(InputError, match='must be one with the interpolation "midpoints"'):
        pcc_bound(made, 0.1, curvature=1.0)
