"""Calibration on the first part of a trial: what it may see, what it recovers, and the committed study."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from edition1.errors import InputError
from edition1_companion.book.studies import read_study
from edition1_companion.pages.imu_markers.calibration import (
    BASELINE,
    FIRST_S,
    MARKERS_MEAN,
    calibration_errors,
    over_sensors,
    ratio_to_uncalibrated,
)
from edition1_companion.twins.arm_recording import MotionCapture
from edition1_companion.twins.arm_trial import draw, drawn
from edition1_companion.twins.imu_errors import PERFECT
from edition1_companion.twins.stick_motion import SCHEDULE
from short_arm import DATA, short_arm


@pytest.fixture(scope="module")
def arm():
    return short_arm()


def medians(table):
    return table[table["mode"] == "all"].set_index(["method", "point_mm"])["median_mm"]


def test_a_frame_that_is_off_is_found(arm):
    capture = MotionCapture(noise_m=0.0, origin_m=(0.02, -0.01, -0.03), heading_rad=0.2)
    trial = drawn(arm, 0, PERFECT, capture).trial
    found = medians(calibration_errors(trial, first_s=20.0, every=40))
    assert found["spline", 600.0] > 35
    assert found["spline + frame", 600.0] < 3
    assert found["spline + frame", 480.0] < 3  # seen by no fit


def test_only_the_first_part_and_the_markers_are_used(arm):
    trial = draw(arm, 0).trial
    expected = calibration_errors(trial, first_s=20.0, every=40)
    late = trial.time_s >= trial.time_s[0] + 20.0
    points = trial.points.copy()
    points[~late, 2:] = 99.0  # points that no fit may use
    changed = calibration_errors(replace(trial, points=points), first_s=20.0, every=40)
    pd.testing.assert_frame_equal(changed, expected)
    points[late, 0] += [0.1, 0.0, 0.0]  # the rest is judged only
    judged = calibration_errors(replace(trial, points=points), first_s=20.0, every=40)
    others = judged["point_mm"] != 360.0
    pd.testing.assert_frame_equal(judged[others], expected[others])
    assert (judged.loc[~others, "median_mm"] > expected.loc[~others, "median_mm"]).all()


def test_no_samples_to_judge(arm):
    trial = draw(arm, 0).trial
    message = (
        r"Input first_s of calibration_errors must be within the trial, above 0 s; instead received 60\.0\."
    )
    with pytest.raises(InputError, match=message):
        calibration_errors(trial)


def test_ratios_are_paired():
    rng = np.random.default_rng(0)
    base = rng.uniform(10, 30, 8)
    parts = [
        pd.DataFrame(
            {"method": method, "mode": "all", "point_mm": point, "median_mm": factor * base, "draw": range(8)}
        )
        for method, factor in ((BASELINE, 1.0), ("spline + all", 0.5))
        for point in (360.0, 600.0)
    ]
    found = (
        ratio_to_uncalibrated(pd.concat(parts))
        .set_index(["method", "point"])
        .loc[("spline + all", MARKERS_MEAN)]
    )
    # The same factor in every draw: no spread is left, whatever the draws are.
    np.testing.assert_allclose(found[["ratio", "ratio_low", "ratio_high"]].to_numpy(dtype=float), 0.5)
    assert found["median_mm"] == pytest.approx(0.5 * base.mean())
    assert found["target"] == 0.6


@pytest.fixture(scope="module")
def study():
    """The committed table."""
    return read_study("martin_calibration")[0]


def test_study_is_whole(study):
    counts = [study[name].nunique() for name in ("draw", "method", "mode", "point_mm")]
    assert counts == [10, 6, 4, 5]
    assert len(study) == np.prod(counts)


def test_a_draw_of_the_study_is_found_again(study):
    _, settings = read_study("martin_calibration")
    table = over_sensors(**settings | {"draws": [3]}, data=DATA)
    expected = study[study["draw"] == 3].reset_index(drop=True)
    pd.testing.assert_frame_equal(table, expected, check_dtype=False, rtol=1e-4)


def test_first_part_holds_one_mode():
    assert SCHEDULE[1][0] > FIRST_S


@pytest.mark.parametrize(("method", "target"), [("PCC-16 + frame", 0.8), ("spline + all", 0.6)])
def test_targets_are_met_in_every_mode_and_at_every_point(study, method, target):
    found = ratio_to_uncalibrated(study).query("method == @method")
    assert (found["ratio"] <= target).all()
    over_all = found[(found["mode"] == "all") & (found["point"] == MARKERS_MEAN)]
    assert (over_all["ratio_high"] <= target).all()
