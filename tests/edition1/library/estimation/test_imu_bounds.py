"""Bounds of the model error: never below the error of smooth curves, of the right order, and not far above."""

import math

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.optimize import brentq
from smooth_curves import LENGTH, STEPS, evenly, read, smooth_curves

from edition1.errors import InputError
from edition1.estimation.imu_models import exact_arcs, pcc_extended, rigid_links
from edition1.estimation.imu_selection import Selection
from edition1_companion.pages.how_many_imus.bounds import arcs_bound, pcc_bound, rigid_bound
from edition1_companion.pages.how_many_imus.needed import imus_needed
from edition1_companion.recordings.martin2022_models import selection

# model, bound, sub-segments, IMU in the middle, order in the spacing with a known slope
PAIRS = {
    "rigid, ends": (rigid_links, rigid_bound, 0, False, 1),
    "rigid, middles": (rigid_links, rigid_bound, 0, True, 2),
    "PCC-1": (pcc_extended, pcc_bound, 1, False, 2),
    "PCC-2": (pcc_extended, pcc_bound, 2, False, 2),
    "PCC-8": (pcc_extended, pcc_bound, 8, False, 2),
    "arcs": (exact_arcs, arcs_bound, 1, False, 2),
}
AT = np.arange(0, STEPS + 1, 8)
POINTS = LENGTH * AT / STEPS
ROUNDING = 2e-7  # of the curves [m]


@pytest.mark.parametrize(("model", "bound", "sub_links", "middle", "order"), PAIRS.values(), ids=PAIRS)
@pytest.mark.parametrize(
    ("bend", "planar"), [(0.5, True), (0.5, False), (2.0, True), (2.0, False), (5.0, False)]
)
def test_error_is_never_above_the_bound(model, bound, sub_links, middle, order, bend, planar):
    frames, points, curvatures, slopes = smooth_curves(12, bend=bend, planar=planar, seed=3)
    for imus in (2, 4, 8, 16):
        arm = evenly(imus, sub_links, middle=middle)
        errors = np.linalg.norm(model(read(frames, arm), arm, POINTS) - points[:, AT], axis=-1)
        for error, curvature, slope in zip(errors, curvatures.tolist(), slopes.tolist(), strict=True):
            with_slope = bound(arm, POINTS, curvature=curvature, slope=slope)
            without = bound(arm, POINTS, curvature=curvature)
            assert (error <= with_slope + ROUNDING).all()
            assert (with_slope <= without + 1e-15).all()
            assert (without <= 2 * POINTS).all()


@pytest.mark.parametrize(("model", "bound", "sub_links", "middle", "order"), PAIRS.values(), ids=PAIRS)
def test_bounds_have_the_order_of_the_errors_and_are_not_far_above(model, bound, sub_links, middle, order):
    frames, points, curvatures, slopes = smooth_curves(12, bend=1.0, seed=4)
    ratios, tips = [], []
    for imus in (8, 16, 32):
        arm = evenly(imus, sub_links, middle=middle)
        tip = model(read(frames, arm), arm, [LENGTH])[:, 0] - points[:, -1]
        numbers = zip(curvatures.tolist(), slopes.tolist(), strict=True)
        bounds = [bound(arm, LENGTH, curvature=c, slope=s)[0] for c, s in numbers]
        ratios.append(np.median(np.linalg.norm(tip, axis=-1) / bounds))
        tips.append(np.mean(bounds))
    np.testing.assert_allclose(np.log2(np.array(tips[:-1]) / tips[1:]), order, atol=0.1)
    assert min(ratios) > 0.1


def test_rigid_bound_is_attained_where_curvature_is_constant():
    """One straight link with its IMU at the end, on a circle: the chords of all points nearly align."""
    arm, curvature = Selection((1,), (0.08,), (0.08,)), 2.0
    half = curvature * 0.08 / 2
    first, last = np.array([0.0, 1.0]), np.array([np.sin(2 * half), np.cos(2 * half)])
    middle = (first + last) / np.linalg.norm(first + last)
    true = 0.08 * np.sin(half) / half * middle
    error = np.linalg.norm(0.08 * last - true)
    bound = rigid_bound(arm, 0.08, curvature=curvature, slope=0.0)[0]
    assert 0.99 < error / bound < 1


def test_circles_and_straight_arms_leave_no_error_of_arcs():
    arm = selection("pcc", 8)
    np.testing.assert_array_equal(arcs_bound(arm, POINTS, curvature=5.0, slope=0.0), 0.0)
    for bound in (pcc_bound, arcs_bound):
        np.testing.assert_allclose(bound(arm, POINTS, curvature=0.0, slope=0.0), 0.0, atol=1e-15)
    np.testing.assert_array_equal(rigid_bound(selection("rigid", 8), POINTS, curvature=0.0, slope=0.0), 0.0)


def extremal_share(x):
    """Integral of (y^2 + (1 - y)^2)/2 from the nearer end of a link of length 1: largest angle for a unit slope."""
    near = min(x, 1 - x)
    return (near**3 + 1 - (1 - near) ** 3) / 6


@pytest.mark.parametrize(("k", "a"), [(0.3, 0.1), (1.0, 0.5), (2.0, 0.5)])
def test_bound_of_one_arc_solves_the_inequality_at_the_head_of_the_module(k, a):
    """k = curvature x length, a = slope x length^2. The constants by quadrature, the smallest solution by bracketing.

    The largest angle that a slope allows, integrated over the link, is 3/32; the bound of a link is that plus Dh/4.
    """
    constant = quad(extremal_share, 0, 0.5)[0] + quad(extremal_share, 0.5, 1)[0]
    assert constant == pytest.approx(3 / 32)

    def excess(Dh):
        e = a / 6 + Dh / 2
        return k * (constant * a + Dh / 4) + (1 - e / 2 / math.tan(e / 2)) * (a / 3 + Dh) - Dh

    Dh = brentq(excess, 0.0, 2.0 * constant * a * (1 + k))
    found = arcs_bound(evenly(1, 1), LENGTH, curvature=k / LENGTH, slope=a / LENGTH**2)
    np.testing.assert_allclose(found, LENGTH * min(constant * a + Dh / 4, k / 2), rtol=1e-6)


def test_bound_of_an_arc_is_nearly_reached_by_an_even_change_of_curvature():
    """A clothoid in a plane: its angle to the arc is slope x (h - x)/2, a mean of 1/12 beside 3/32, or 8/9 of it."""
    arm, slope, n = evenly(1, 1), 0.05, 4000
    s = np.linspace(0, LENGTH, n + 1)
    angle = slope * s**2 / 2
    middle = (angle[1:] + angle[:-1]) / 2
    steps = LENGTH / n * np.stack([np.sin(middle), np.zeros(n), np.cos(middle)], axis=-1)
    end = steps.sum(axis=0)
    chord = 0.5 * angle[-1]
    arc = LENGTH * np.sinc(chord / np.pi) * np.array([np.sin(chord), 0.0, np.cos(chord)])
    bound = arcs_bound(arm, LENGTH, curvature=slope * LENGTH, slope=slope)[0]
    assert np.linalg.norm(end - arc) / bound == pytest.approx(8 / 9, rel=0.02)


@pytest.mark.parametrize("imus", [2, 8])
def test_worst_case_of_pcc_on_a_circle_is_the_stated_factor(imus):
    arm = evenly(imus, 2)
    half = 2.0 * LENGTH / imus / 4
    expected = LENGTH * (half / math.sin(half) - 1)
    bound = pcc_bound(arm, LENGTH, curvature=2.0, slope=0.0)
    np.testing.assert_allclose(bound, expected, rtol=1e-12)


def test_bounds_grow_along_the_arm_with_curvature_and_with_slope():
    for _, bound, sub_links, middle, _ in PAIRS.values():
        arm = evenly(8, sub_links, middle=middle)
        ends = np.linspace(0.08, LENGTH, 8)
        values = np.array(
            [[bound(arm, ends, curvature=c, slope=s) for s in (0.0, 10.0, 100.0)] for c in (0.5, 2.0, 8.0)]
        )
        for axis in range(3):
            assert (np.diff(values, axis=axis) >= -1e-15).all()


def test_smallest_number_of_imus():
    for _, bound, sub_links, middle, _ in PAIRS.values():
        n = imus_needed(bound, LENGTH, 0.02, curvature=4.0, slope=20.0, sub_links=max(sub_links, 1))
        if bound is not rigid_bound or middle:
            enough, fewer = (evenly(k, sub_links, middle=middle) for k in (n, n - 1))
            tip, far = ({"curvature": 4.0, "slope": 20.0}, 0.64 - 1e-12)
            assert bound(enough, far, **tip)[0] <= 0.02 < bound(fewer, far, **tip)[0]
    assert imus_needed(arcs_bound, LENGTH, 1e-6, curvature=1.0, slope=0.0) == 1


@pytest.mark.parametrize("bound", [rigid_bound, pcc_bound, arcs_bound])
@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"curvature": -1.0}, r"Input curvature of {} must be finite and not negative \[rad/m\]; .* -1\.0"),
        ({"curvature": math.inf}, "curvature of {} must be finite"),
        ({"slope": -1.0}, r"Input slope of {} must be not negative \[rad/m\^2\]; instead received -1\.0"),
        ({"slope": math.nan}, "slope of {} must be not negative"),
        ({"points": 0.65}, r"Input arc_lengths of {} must be distances between 0 and 0\.64 m"),
        ({"points": math.nan}, "arc_lengths of {}"),
    ],
)
def test_bad_input(bound, change, message):
    arm = selection("rigid" if bound is rigid_bound else "pcc", 8)
    given = {"points": 0.1, "curvature": 1.0, "slope": 1.0} | change
    with pytest.raises(InputError, match=message.format(bound.__name__)):
        bound(arm, given["points"], curvature=given["curvature"], slope=given["slope"])


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (
            lambda: rigid_bound(selection("pcc", 8), 0.1, curvature=1.0),
            r"selection of rigid_bound must be one link per IMU \(sub_links 0\)",
        ),
        (
            lambda: arcs_bound(selection("rigid", 8), 0.1, curvature=1.0),
            "selection of arcs_bound must be links from IMU to IMU, from the base on",
        ),
        (
            lambda: pcc_bound(selection("pcc", 8, "files"), 0.1, curvature=1.0),
            "must be links from IMU to IMU",
        ),
        (
            lambda: imus_needed(pcc_bound, 0.0, 0.01, curvature=1.0, slope=1.0),
            "length_m of imus_needed must be pos",
        ),
        (
            lambda: imus_needed(pcc_bound, 0.64, -1.0, curvature=1.0, slope=1.0),
            "tolerance_m of imus_needed must be",
        ),
        (
            lambda: imus_needed(rigid_bound, 0.64, 1e-9, curvature=10.0, slope=1.0),
            r"tolerance_m of imus_needed must be within reach of 1000 IMUs \[m\]; instead received 1e-09",
        ),
    ],
)
def test_bad_use(call, message):
    with pytest.raises(InputError, match=message):
        call()
