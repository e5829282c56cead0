"""Errors, ratios and shares of tables, on small cases that are counted by hand."""

import math

import numpy as np
import pandas as pd
import pytest
from scipy.stats import norm

from edition1.sensing.placement import Tolerances
from edition1_companion.book.bootstrap import interval
from edition1_companion.pages.closed_loop import tables as loops
from edition1_companion.pages.closed_loop.loop import reference_mm
from edition1_companion.pages.fusion import study as fusion
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
