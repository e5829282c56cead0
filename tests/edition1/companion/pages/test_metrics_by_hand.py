"""Errors, ratios and shares of tables, on small cases that are counted by hand."""

import math
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
import torch
from scipy.stats import norm

from edition1.sensing.placement import Tolerances
from edition1_companion.book.bootstrap import interval
from edition1_companion.pages.bend_tests import errors as bend_errors
from edition1_companion.pages.closed_loop import tables as loops
from edition1_companion.pages.closed_loop.loop import reference_mm
from edition1_companion.pages.fusion import study as fusion
from edition1_companion.twins.bend_tests import BendTake
from edition1_companion.twins.segment_motion import TRAJECTORIES, motion


class TestLoops:
    def test_ratio_is_a_mean_of_ratios_and_the_target_belongs_to_it(self):
        """1.25/1 and 2.7/2: the mean of ratios is 1.3, the ratio of means would be 3.95/3 = 1.32."""
        rows = [
            {"estimator": "e", "controller": "PI", "session": "s", "reference": "r", "seed": k}
            | {"tracking_mm": own, "tracking_truth_mm": truth}
            | {"estimate_mm": 0.2 + 0.2 * k, "offset_mm": 0.1}
            for k, (own, truth) in enumerate([(1.25, 1.0), (2.5, 2.0)])
        ]
        line = loops.tracking_ratios(pd.DataFrame(rows), "estimator", draws=100).iloc[0]
        assert (line["ratio"], line["worst"], line["seeds"]) == (1.25, 1.25, 2)
        assert (line["tracking_mm"], line["tracking_truth_mm"]) == (1.875, 1.5)
        assert line["estimate_mm"] == pytest.approx(0.3)
        rows[1]["tracking_mm"] = 2.7
        line = loops.tracking_ratios(pd.DataFrame(rows), "estimator", draws=100).iloc[0]
        assert line["ratio"] == pytest.approx(1.3)
        assert line["worst"] == pytest.approx(1.35)
        for target, met in ((2.6, True), (2.75, False)):
            rows[1]["tracking_mm"] = target
            assert loops.tracking_ratios(pd.DataFrame(rows), "estimator", draws=10).iloc[0]["met"] == met

    def test_references_have_their_sizes(self):
        """A circle of 4 mm and a lemniscate of 3 and 6 mm in 10 s about (2.5, 0); the training reaches 5 mm."""
        time_s = np.linspace(0.0, 10.0, 1001)
        circle, eight = (reference_mm(name, time_s) - [2.5, 0.0] for name in ("circle", "lemniscate"))
        assert np.hypot(*circle.T) == pytest.approx(np.full(1001, 4.0))
        assert circle[250] == pytest.approx([0.0, 4.0], abs=1e-9)
        assert np.abs(eight).max(axis=0) == pytest.approx([3.0, 6.0], rel=1e-4)
        steps = np.diff(reference_mm("step", np.arange(0.0, 30.0, 5.0)), axis=0)
        assert np.abs(steps).sum(axis=1).tolist() == [4.0, 4.0, 7.0, 9.0, 3.0]


def bend_take(name, test, truth_deg, direction_deg, n=4):
    """A take that motion capture saw at one bend and direction, its second reading masked."""
    truth = pd.DataFrame({
        "bend_rad": np.full(n, math.radians(truth_deg)),
        "direction_rad": np.full(n, math.radians(direction_deg)),
        "tilt_z_rad": np.full(n, math.radians(truth_deg / 2)),
    })  # fmt: skip
    truth.iloc[1] = np.nan
    one = torch.ones(n, 3, dtype=torch.float64)
    times = np.arange(float(n))
    return BendTake(
        name, test, 1, times, one, np.ones(n), one[0, :2], one[0], truth, None, math.nan, "none", {}
    )


def bend_run(take, off_deg, turned_deg, deviation_deg):
    bend = np.nan_to_num(take.truth["bend_rad"].to_numpy()) + np.radians(off_deg)
    direction = take.truth["direction_rad"] + np.radians(turned_deg)
    found = pd.DataFrame(
        {"bend_rad": bend, "direction_rad": direction, "deviation_rad": np.radians(deviation_deg)}
    )
    return bend_errors.Run("ours", "none", 13.0, take, found)


class TestBendTests:
    def test_errors_of_made_up_takes(self):
        """Three readings count. Errors of 3, 4 and 0 degrees: sqrt(25/3); the z axis tilts by half, so 18, 19, 15."""
        first = bend_run(bend_take("a", 0, 30.0, 10.0), np.array([3.0, 50.0, 4.0, 0.0]), 12.0, 1.9)
        second = bend_run(bend_take("b", 1, 30.0, 90.0), np.array([1.0, 50.0, -1.0, 1.0]), 7.0, 0.49)
        table = bend_errors.errors_by_take([first, second]).set_index("take")
        assert table["rmse_deg"].tolist() == pytest.approx([math.sqrt(25 / 3), 1.0])
        assert table["rmse_tilt_z_deg"]["a"] == pytest.approx(math.sqrt((18**2 + 19**2 + 15**2) / 3))
        # Within two deviations: 3.0 and 0.0 of 3.8 degrees; of 0.98 degrees none.
        assert table["within_percent"].tolist() == pytest.approx([200 / 3, 0.0])
        # Turned by 12 and 7 degrees: each less the other.
        assert table["direction_deg"].tolist() == pytest.approx([5.0, 5.0])
        in_frame = bend_errors.errors_by_take([replace(first, in_capture_frame=True), second]).set_index(
            "take"
        )
        assert in_frame["direction_deg"]["a"] == pytest.approx(12.0)

    @pytest.mark.parametrize(("bend_deg", "counts"), [(19.0, False), (21.0, True)])
    def test_directions_count_from_twenty_degrees(self, bend_deg, counts):
        runs = [
            bend_run(bend_take(name, k, bend_deg, 0.0), 0.0, 10.0 * k, 1.0) for k, name in enumerate("ab")
        ]
        found = bend_errors.errors_by_take(runs)["direction_deg"]
        assert found.notna().all() == counts
        if counts:
            assert found.tolist() == pytest.approx([10.0, 10.0])

    def test_medians_are_those_over_all_takes(self):
        runs = [bend_run(bend_take(name, k, 30.0, 0.0), off, 0.0, 1.0)
                for k, (name, off) in enumerate([("a", 1.0), ("b", 2.0), ("c", 9.0)])]  # fmt: skip
        table = bend_errors.median_errors(bend_errors.errors_by_take(runs))
        assert table["rmse_deg"].tolist() == pytest.approx([2.0])
        assert table["takes"].tolist() == [3]

    def test_difference_from_the_log_and_the_largest_bend(self):
        take = bend_take("a", 0, 30.0, 0.0)
        logged = pd.DataFrame({"bend_rad": np.radians([27.0, 0.0, 26.0, 30.0]), "direction_rad": np.zeros(4)})
        run = replace(bend_run(take, 0.0, 0.0, 1.0), method="paper, as released")
        run = replace(run, take=replace(take, logged=logged))
        found = bend_errors.beside_log([run])
        assert found["difference_deg"].tolist() == pytest.approx([math.sqrt((9 + 0 + 16 + 0) / 4)])
        curves = bend_errors.estimates_over_time([bend_run(take, 2.0, 5.0, 1.5)], ["a"], every=1)
        own = curves[curves["method"] == "ours"]
        assert own["bend_deg"].iloc[[0, 2, 3]].tolist() == pytest.approx([32.0] * 3)
        assert own["deviation_deg"].tolist() == pytest.approx([1.5] * 4)
        assert own["direction_deg"].dropna().tolist() == pytest.approx([0.0] * 3, abs=1e-9)


def test_interval_holds_ninety_five_per_cent():
    values = norm.ppf(np.linspace(0.5e-4, 1 - 0.5e-4, 10_000))
    assert interval(values) == pytest.approx((norm.ppf(0.025), norm.ppf(0.975)), abs=1e-3)


def test_tolerances_are_those_that_the_pages_state():
    """Magnets 0.5 mm, 2 degrees; sensors 1 % of a turn, of the radius and of the gain, 1 degree; moments 2 %."""
    found = Tolerances()
    assert (found.magnet_position_m, found.sensor_radius, found.sensor_gain, found.moments) == (
        5e-4,
        0.01,
        0.01,
        0.02,
    )
    assert found.magnet_tilt_rad == pytest.approx(math.pi / 90)
    assert found.sensor_azimuth_rad == pytest.approx(math.pi / 50)
    assert found.sensor_tilt_rad == pytest.approx(math.pi / 180)


class TestRecordOfOneRobot:
    def test_magnets_scatter_by_the_noise_of_their_setting(self):
        """7.1e-4 mT and seven times that: 20 draws of 40 steps of three sensors; the last draw has none."""
        moved = motion(TRAJECTORIES[0], steps=40)
        for setting, noise_mt in zip(fusion.SETTINGS[:2], (7.1e-4, 7 * 7.1e-4), strict=True):
            found = fusion.record([moved], range(20), setting)
            noise = found.magnets[:, 0, :-1] - found.magnets[:, 0, -1:]
            assert float(noise.std()) == pytest.approx(noise_mt, rel=0.06)

    def test_stray_field_is_that_of_the_earth_in_size(self):
        """0.065 mT in all, so a third of its square along a sensor; 24 draws, three of their errors."""
        assert fusion.SETTINGS[2].stray_mt == pytest.approx(0.065 / math.sqrt(3))
        found = fusion.record([motion(TRAJECTORIES[0], steps=3)], range(24), fusion.SETTINGS[2])
        off = (found.magnets[:, 0, :-1] - found.magnets[:, 0, -1:])[2]
        assert float(off.square().mean().sqrt()) == pytest.approx(0.065 / math.sqrt(3), rel=0.43)
