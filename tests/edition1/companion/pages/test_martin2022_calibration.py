"""Calibration on the first part of a trial: ratios to the uncalibrated model, and the committed study."""

import numpy as np
import pandas as pd
import pytest

from edition1_companion.book.studies import read_study
from edition1_companion.pages.imu_markers.calibration import BASELINE, MARKERS_MEAN, ratio_to_uncalibrated


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


@pytest.mark.parametrize(("method", "target"), [("PCC-16 + frame", 0.8), ("spline + all", 0.6)])
def test_targets_are_met_in_every_mode_and_at_every_point(study, method, target):
    found = ratio_to_uncalibrated(study).query("method == @method")
    assert (found["ratio"] <= target).all()
    over_all = found[(found["mode"] == "all") & (found["point"] == MARKERS_MEAN)]
    assert (over_all["ratio_high"] <= target).all()
