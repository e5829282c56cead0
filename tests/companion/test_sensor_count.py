"""How many sensors: bounds by closed forms and by magpylib, errors that reach them, and the rule for IMUs."""

from __future__ import annotations

import math
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest
from scipy.spatial.transform import Rotation

from repro import Sensing, simulated_readings
from repro_companion.papers import baaij, sensor_count
from repro_companion.papers.sensor_count import ARCS, END, IMU_MODELS, MIDDLE, PCC, STEPS
from repro_companion.show import study

LIMITS = 0.64, 8.0, 60.0
"""Length [m], curvature [rad/m] and its slope [rad/m^2]."""


@pytest.fixture(scope="module")
def curves():
    return sensor_count.random_curves(40, *LIMITS, seed=3)


def drawn(steps, draws, sensors, seed=5):
    return np.random.default_rng(seed).standard_normal((steps, draws, sensors))


# Magnets


def test_the_bound_is_that_of_the_slopes_of_magpylib():
    robot, q = baaij.robot(1), baaij.lemniscate(1, steps=7)
    J = np.stack(
        [
            (simulated_readings(robot, q + move) - simulated_readings(robot, q - move)) / 2e-6
            for move in 1e-6 * np.eye(3)
        ],
        axis=-1,
    )
    exact = 0.01**2 * np.linalg.inv(np.swapaxes(J, 1, 2) @ J)
    np.testing.assert_allclose(sensor_count.covariance(Sensing(robot), q, 0.01), exact, rtol=1e-4, atol=1e-12)


def test_twice_the_same_sensors_halve_the_variance_and_noise_scales_the_bound():
    robot, q = baaij.robot(2), baaij.lemniscate(2, steps=9)
    once = sensor_count.bound_percent(Sensing(robot), q, 0.01)
    twice = robot.replaced(sensors=robot.sensors * 2)
    assert sensor_count.bound_percent(Sensing(twice), q, 0.01) == pytest.approx(once / math.sqrt(2), rel=1e-9)
    assert sensor_count.bound_percent(Sensing(robot), q, 0.03) == pytest.approx(3 * once, rel=1e-9)


def test_two_sensors_leave_a_coordinate_open():
    robot, q = baaij.robot(1, 2), baaij.lemniscate(1, steps=9)
    assert sensor_count.bound_percent(Sensing(robot), q, 1e-9) == math.inf
    assert sensor_count.errors(1, 2, 1e-9, drawn(9, 1, 2))["mean_percent"].item() > 5


@pytest.mark.parametrize("n_segments", [1, 3])
def test_errors_of_exact_robots_reach_the_bound_and_vanish_without_noise(n_segments):
    normal = drawn(60, 6, 4 * n_segments)
    table = sensor_count.errors(n_segments, 4, 7.1e-4, normal)
    assert table["mean_percent"].mean() == pytest.approx(table["bound_percent"][0], rel=0.05)
    quiet = sensor_count.errors(n_segments, 4, 7.1e-4, 0 * normal)
    assert quiet["mean_percent"].max() < 1e-3 * table["mean_percent"].min()
    assert quiet["tip_mm"].max() < 1e-3 * table["tip_mm"].min()


def test_the_grid_compares_with_three_sensors():
    table = sensor_count.grid([1], [2, 3, 6], [0.02, 1e-3], draws=2, steps=20, seed=1)
    assert list(table["noise_mt"]) == [1e-3] * 3 + [0.02] * 3
    three = table[table["n_sensors"] == 3]
    assert (three[["ratio", "averaging"]] == 1).all(axis=None)
    assert table["averaging"].isna().sum() == 2
    six = table[table["n_sensors"] == 6]
    np.testing.assert_allclose(six["averaging"], math.sqrt(0.5))
    expected = six["mean_percent"].to_numpy() / three["mean_percent"].to_numpy()
    np.testing.assert_allclose(six["ratio"], expected)


@pytest.mark.parametrize(
    ("found", "expected"),
    [
        # Deviations of 1 and 7 are 5 in the root mean square: 50 and 25 % of the ranges 10 and 20.
        (
            lambda: sensor_count.bound_percent(
                SimpleNamespace(linearise=lambda q: (q, np.stack([np.eye(2), np.eye(2) / 7]))),
                np.array([[0.0, 0.0], [10.0, 20.0]]),
                1.0,
            ),
            37.5,
        ),
        # The median deviations of a design in mm.
        (
            lambda: sensor_count.chips_table(
                SimpleNamespace(by_chips=[{"chips": 3, "calibrated": 1e-3, "as_built": 2e-3}])
            ).to_numpy()[0],
            [3, 1, 2],
        ),
        # From where on no error is above a tolerance.
        (lambda: sensor_count._enough(np.array([5.0, 1.0, 3.0, 1.0]), 5.0), 1),
        (lambda: sensor_count._enough(np.array([5.0, 1.0, 3.0, 1.0]), 1.0), 4),
        (lambda: sensor_count._enough(np.array([5.0, 1.0, 3.0, 1.0]), 0.5), np.nan),
    ],
)
def test_numbers_of_the_page_by_hand(found, expected):
    assert found() == pytest.approx(expected, nan_ok=True)


def test_errors_of_curves_are_root_mean_squares(curves, monkeypatch):
    monkeypatch.setattr(sensor_count, "tip_errors", lambda *_: np.array([0.0, 0.0, 0.0, 8e-3]))
    table = sensor_count.imu_errors(curves, LIMITS[1:], [2], [1.0], seed=0)
    np.testing.assert_allclose(table[["rms_mm", "largest_mm"]], [[4, 8]] * 4)


def test_the_bound_of_the_tip_is_that_of_the_check():
    robot = sensor_count.moved(0.040, 0.010)
    check = robot.check(samples=30)
    bound = sensor_count.tip_bound(robot, check.q, baaij.NOISE_MT)
    assert bound == pytest.approx(1e3 * math.sqrt((check.tip**2).mean()), rel=1e-9)


def test_sensors_move_to_where_they_are_asked():
    straight = np.zeros(3)
    robot = sensor_count.moved(0.030, 0.007, n_sensors=4)
    sensors = robot.poses(straight, [sensor.place for sensor in robot.sensors])[:, :3, 3]
    np.testing.assert_allclose(sensors[:, 2], baaij.MAGNET_AT + 0.030)
    np.testing.assert_allclose(np.linalg.norm(sensors[:, :2], axis=1), 0.007)
    assert len(sensors) == 4
    even, t = np.linspace(-1, 1, 100_001).std(), baaij.ERRORS  # the draws are even
    sizes = {"azimuth": t.sensor_azimuth, "radius": 0.007 * t.sensor_radius, "tilt": 0.0, "gain": 0.0}
    for part, limits in (
        (robot.magnets[0], {"position": t.magnet_position, "tilt": t.magnet_tilt}),
        (robot.sensors[3], sizes),
    ):
        deviations = {name: even * limit for name, limit in limits.items()}
        assert part.tolerance == pytest.approx(deviations, rel=1e-4)


def test_closer_sensors_feel_noise_less_and_tolerances_more():
    far, near = (row for _, row in sensor_count.places([55, 35], [13], samples=20).iterrows())
    assert near["noise_mm"] < far["noise_mm"] / 2
    assert near["off_mm"] > far["off_mm"]
    check = sensor_count.moved(0.035, 0.013).check(samples=20)
    assert near[2:].to_list() == pytest.approx([1e3 * np.median(x) for x in (check.tip, check.tip_as_built)])


def test_errors_are_root_mean_squares_over_time_and_means_over_draws(monkeypatch):
    """In the first of four steps the segment is straight, and the first of two draws makes it 8 mm longer there."""
    found = np.repeat(baaij.lemniscate(1, steps=4)[:, None], 2, axis=1)
    found[0, 0, 2] += 8e-3
    fit = SimpleNamespace(q=found, details={"at_bound": np.zeros((4, 2), dtype=bool)})
    monkeypatch.setattr(baaij, "least_squares", lambda *_: fit)
    np.testing.assert_allclose(sensor_count.errors(1, 3, 0.01, drawn(4, 2, 3))["tip_mm"], [4, 0], atol=1e-9)
    assert sensor_count.grid([1], [3], [0.01], 2, 4, 0)["tip_mm"].to_list() == pytest.approx([2])


@pytest.mark.parametrize("above", [0.055, 0.035])
def test_simulated_errors_lie_within_a_fifth_of_the_bound_and_calibration_pays(above):
    found = sensor_count.simulated(sensor_count.moved(above, 0.013), draws=2, steps=40)
    assert found["drawn_mm"] == pytest.approx(found["bound_mm"], rel=0.2)
    assert found["bound_mm"] < found["calibrated_mm"] < 0.1 * found["off_mm"]


# IMUs


def circle(curvature, length=0.64):
    """An arc in a plane, as one of the curves."""
    s = np.linspace(0, length, STEPS + 1)
    frames = Rotation.from_rotvec(np.outer(curvature * s, [0, 1, 0])).as_quat()
    angle = curvature * length
    tip = np.array([1 - math.cos(angle), 0.0, math.sin(angle)]) / curvature
    return sensor_count.Curves(length, frames[None], tip[None], np.array([curvature]), np.array([1e-9]))


@pytest.mark.parametrize("n", [1, 4, 16])
def test_models_on_a_circle_have_their_closed_forms(n):
    arc = circle(3.0)
    half, far = 3.0 * arc.length / n / 2, np.linalg.norm(arc.tips[0])
    assert sensor_count.tip_errors(arc, ARCS, n)[0] == pytest.approx(0, abs=1e-12)
    longer = half / math.sin(half) - 1
    assert sensor_count.tip_errors(arc, MIDDLE, n)[0] == pytest.approx(far * longer, rel=1e-9)
    longer = half / 2 / math.sin(half / 2) - 1  # two sub-segments for every link
    assert sensor_count.tip_errors(arc, PCC, n)[0] == pytest.approx(far * longer, rel=1e-9)
    # The links of MIDDLE, all turned by half a link.
    turned = far * np.hypot(half / math.tan(half) - 1, half)
    assert sensor_count.tip_errors(arc, END, n)[0] == pytest.approx(turned, rel=1e-9)


def test_curves_use_up_a_limit_and_end_where_their_frames_lead(curves):
    assert (curves.curvature <= LIMITS[1] * (1 + 1e-12)).all()
    assert (curves.slope <= LIMITS[2] * (1 + 1e-12)).all()
    used = np.maximum(curves.curvature / LIMITS[1], curves.slope / LIMITS[2])
    np.testing.assert_allclose(used, 1)
    turns = Rotation.from_quat(curves.frames.reshape(-1, 4)).as_matrix().reshape(40, -1, 3, 3)
    along = turns[..., 2]
    tips = LIMITS[0] / STEPS * (along[:, 1:] + along[:, :-1]).sum(1) / 2  # the trapezoidal rule
    np.testing.assert_allclose(curves.tips, tips, atol=1e-5)
    bend = np.linalg.norm(np.diff(along, axis=1), axis=-1).max(1) * STEPS / LIMITS[0]
    np.testing.assert_allclose(bend, curves.curvature, rtol=1e-3)


@pytest.mark.parametrize("model", IMU_MODELS)
def test_no_error_lies_above_its_bound(model, curves):
    for n in (2, 3, 5, 8, 16):
        bounds = [
            sensor_count.imu_bound(model, n, curves.length, *own)
            for own in zip(curves.curvature, curves.slope, strict=True)
        ]
        share = sensor_count.tip_errors(curves, model, n) / (np.array(bounds) + 1e-6)
        assert share.max() <= 1
    assert share.max() > 0.2, "the bound is of the order of the errors"


@pytest.mark.parametrize("model", IMU_MODELS)
def test_the_rule_is_the_leading_term_of_the_bound(model):
    bound = sensor_count.imu_bound(model, 400, *LIMITS)
    assert sensor_count.imu_rule(model, LIMITS[0], bound, *LIMITS[1:]) == pytest.approx(400, abs=2)


def test_the_rule_by_hand():
    assert sensor_count.imu_rule(END, 1.0, 0.01, 2.0, 0.0) == 100
    assert sensor_count.imu_rule(MIDDLE, 1.0, 0.01, 0.0, 24.0) == 10
    assert sensor_count.imu_rule(ARCS, 1.0, 0.01, 0.0, 32.0 / 3) == 10
    assert sensor_count.imu_rule(PCC, 1.0, 0.01, math.sqrt(96.0), 0.0) == 10
    assert sensor_count.imu_rule(PCC, 1.0, 1e3, 1.0, 1.0) == 1


def test_independent_errors_of_imus_move_a_straight_arm_by_the_rule():
    straight = sensor_count.Curves(
        0.64, np.tile([0.0, 0.0, 0.0, 1.0], (3000, STEPS + 1, 1)), np.tile([0.0, 0.0, 0.64], (3000, 1)), *2 * [None]
    )  # fmt: skip
    for n in (2, 8):
        off = sensor_count.tip_errors(straight, MIDDLE, n, sigma=0.01, seed=2)
        assert np.sqrt((off**2).mean()) == pytest.approx(0.01 * 0.64 * math.sqrt(2 / n), rel=0.03)
    # An arc from a base that is known to an IMU at the tip: the tip moves by half of what a rigid link would.
    off = sensor_count.tip_errors(straight, ARCS, 1, sigma=0.01, seed=2)
    assert np.sqrt((off**2).mean()) == pytest.approx(0.01 * 0.64 / math.sqrt(2), rel=0.03)


def test_a_rule_that_comes_out_whole_needs_no_imu_more_for_rounding():
    """A curvature of 3/m moves the tip of 0.1 m by 15 mm: three IMUs for 5 mm, four for a little less."""
    assert sensor_count.imu_rule(sensor_count.END, 0.1, 0.005, 3.0, 0.0) == 3
    assert sensor_count.imu_rule(sensor_count.END, 0.1, 0.0049, 3.0, 0.0) == 4


def test_needed_numbers_keep_the_tolerance_and_one_less_does_not(curves):
    table = sensor_count.imus_needed(curves, LIMITS[1:], [0.01, 0.04]).set_index(["model", "tolerance_mm"])
    assert (table["by_curves"].dropna() <= table["by_rule"][table["by_curves"].notna()]).all()
    for model in (MIDDLE, PCC):
        n, own = int(table.loc[(model, 10.0), "by_curves"]), table.loc[(model, 10.0), "by_bound"]
        assert sensor_count.tip_errors(curves, model, n).max() <= 0.01
        assert sensor_count.tip_errors(curves, model, n - 1).max() > 0.01
        assert sensor_count.imu_bound(model, int(own), *LIMITS) <= 0.01
        assert sensor_count.imu_bound(model, int(own) - 1, *LIMITS) > 0.01
    nobody = sensor_count.imus_needed(curves, LIMITS[1:], [1e-4]).set_index("model")
    assert np.isnan(nobody.loc[END, "by_curves"]), "more than we try"


def test_errors_of_imus_have_a_bound_if_they_are_perfect_and_a_rule_if_not(curves):
    table = sensor_count.imu_errors(curves, LIMITS[1:], [2, 8], [0.0, 3.0], seed=0)
    perfect = table["sensor_deg"] == 0
    assert (perfect == table["bound_mm"].notna()).all()
    assert (perfect == table["rule_mm"].isna()).all()
    assert (table["rms_mm"] <= table["largest_mm"]).all()
    assert (table["largest_mm"] <= table["bound_mm"] + 1e-3)[perfect].all()
    own = table[(table["n_imus"] == 8) & ~perfect]
    np.testing.assert_allclose(own["rule_mm"], 640 * math.radians(3) / 2)


def test_the_page_says_what_its_tables_say():
    means = pd.DataFrame({"n_segments": 1, "noise_mt": 7.1e-4, "n_sensors": [3, 6], "ratio": [1.0, 0.7]})
    said = sensor_count.in_words(means, 640.0, 8.0, 60.0)
    assert (
        "one three-axis chip in place of the three also does, with 1.5 times their error (0.20 against 0.13 mm"
        in said.lower()
    )
    assert "6 sensors have 70 % of the error of three" in said
    assert "about 10 of them" in said
    needed = pd.DataFrame({
        "model": [sensor_count.END, sensor_count.MIDDLE, sensor_count.PCC, sensor_count.ARCS], "tolerance_mm": 10.0,
        "by_rule": [90, 10, 12, 9], "by_bound": [90, 11, 12, 9], "by_curves": [10, 8, 6, None],
    })  # fmt: skip
    assert "at most 1 more than the rule" in sensor_count.needed_in_words(needed)
    assert "1.2 to 2.0 times" in sensor_count.needed_in_words(needed)
    assert sensor_count.needed_table(needed)["10 mm"].to_list() == [
        f"{rule}\u00a0({curves})" for rule, curves in ((90, 10), (10, 8), (12, 6), (9, "–"))
    ]


def test_bounds_and_errors_stand_by_coordinate():
    table = pd.DataFrame({"mean_percent": [1.0, 2.0], "bound_percent": [2.0, 2.0]})
    said = sensor_count.bound_in_words(table, study("noise"), np.full(6, 0.1), np.arange(6.0) / 10)
    assert "Δx 0.10 and 0.00, Δy 0.10 and 0.10, δL 0.10 and 0.20, Δx 0.10 and 0.30" in said
    assert "Over 2 draws of the noise the mean error is 0.75 times the bound" in said
    assert "18 times the error of the bound (2.2 against 0.12 % of the range)" in said


def test_a_shape_that_is_beside_the_truth_is_off_by_as_much_everywhere():
    robot = baaij.robot(1)
    truth = baaij.lemniscate(1, steps=5)
    assert sensor_count.shape_error_mm(robot, truth[:, None] + np.zeros((5, 2, 3)), truth) == pytest.approx(0)
    longer = truth[:, None] + np.array([[[0, 0, 1e-3]]])
    assert 0.3 < sensor_count.shape_error_mm(robot, longer, truth)[0] < 1.0


def test_places_carry_their_height_and_radius():
    table = pd.DataFrame({
        "above_mm": [55.0, 35.0], "radial_mm": 13.0, "bound_mm": 1.0, "drawn_mm": 2.0, "off_mm": [3.7, 6.1],
        "calibrated_mm": [0.14, 0.07], "place": ["paper", "closer"],
    })  # fmt: skip
    assert sensor_count.places_table(table)["where"].to_list() == ["paper (55, 13)", "closer (35, 13)"]
    assert "6.1 mm at the closer place, against 3.7 mm" in sensor_count.places_in_words(table)
