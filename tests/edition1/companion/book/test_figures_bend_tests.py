"""Figures of the bend tests show what is in their tables."""

import pandas as pd
import pytest

from edition1_companion.pages.bend_tests import figures

TAKES = pd.DataFrame(
    {
        "take": ["bend_0_try_1", "bend_1_try_1"],
        "peak_tilt_y_deg": [50.0, 51.0],
        "peak_tilt_z_deg": [50.0, 25.0],
        "peak_hall_deg": [33.0, 34.0],
        "direction_deg": [0.0, 60.0],
        "turned_deg": [-20.0, -25.0],
    }
)
METHODS = (("paper, as printed", "none"), ("ours", "none"), ("ours", "other tests"))


def curves() -> pd.DataFrame:
    rows = []
    for method, calibration in (*METHODS, ("capture, y axis", "none"), ("capture, z axis", "none")):
        for time_s in (0.0, 1.0):
            line = {"take": "bend_0_try_1", "method": method, "calibration": calibration, "time_s": time_s}
            rows.append(line | {"bend_deg": 10.0 + time_s, "direction_deg": 1.0, "deviation_deg": 2.0})
    return pd.DataFrame(rows)


def test_peaks_and_gain():
    _, right = figures.peaks(TAKES, "synthetic").axes
    assert list(right.get_lines()[0].get_ydata()) == [-20, -25]


def test_over_time_draws_one_calibration_with_its_band():
    top, _ = figures.bend_over_time(curves(), "other tests", "synthetic").axes
    band = top.collections[0].get_paths()[0].vertices[:, 1]
    assert (band.min(), band.max()) == pytest.approx((6.0, 15.0))


def test_errors_have_a_row_for_each_method_and_a_panel_for_each_column():
    rows = [
        {"method": m, "calibration": c, "length_mm": 13.0, "take": t, "rmse_deg": 1.0}
        for m, c in METHODS
        for t in ("a", "b")
    ]
    table = pd.DataFrame(rows).assign(rmse_tilt_z_deg=3.0)
    left, right = figures.errors_by_take(table, 13.0, "synthetic").axes
    assert list(left.get_lines()[0].get_xdata()) == [1.0, 1.0]
    assert right.get_lines()[0].get_xdata()[0] == 3.0
    by_bend = {"rmse_below_20_deg": 1.0, "rmse_20_to_40_deg": 2.0, "rmse_above_40_deg": float("nan")}
    _, middle, _ = figures.errors_by_bend(table.assign(**by_bend), 13.0, "synthetic").axes
    assert middle.get_lines()[0].get_xdata()[0] == 2.0
