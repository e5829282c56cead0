"""Figures of the bend tests show what is in their tables."""

import matplotlib.pyplot as plt
import pandas as pd
import pytest
from edition1_companion.pages.bend_tests import figures
from edition1_companion.pages.light_bulb import events_over_time

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
    left, right = figures.peaks(TAKES, "synthetic").axes
    assert [text.get_text() for text in left.get_xticklabels()] == ["0, 1", "1, 1"]
    assert "synthetic" in left.get_title()
    assert len(left.get_lines()) == 3
    assert list(right.get_lines()[0].get_ydata()) == [-20, -25]
    axial = pd.DataFrame({"time_s": [0.0, 1.0], "sent_mt": [22.0, 25.0], "over_gain_mt": [22.0, 22.0]})
    assert len(figures.gain(axial, "bend_0_try_1", "synthetic").axes[0].get_lines()) == 2


def test_over_time_draws_one_calibration_with_its_band():
    figure = figures.bend_over_time(curves(), "other tests", "synthetic")
    top, bottom = figure.axes
    assert len(top.get_lines()) == 4
    assert len(bottom.get_lines()) == 3  # the z axis gives no direction
    band = top.collections[0].get_paths()[0].vertices[:, 1]
    assert (band.min(), band.max()) == pytest.approx((6.0, 15.0))
    assert "least squares (other tests)" in [text.get_text() for text in figure.legends[0].get_texts()]
    assert not plt.get_fignums()


def test_errors_have_a_row_for_each_method_and_a_panel_for_each_column():
    rows = [
        {"method": m, "calibration": c, "length_mm": 13.0, "take": t, "rmse_deg": 1.0}
        for m, c in METHODS
        for t in ("a", "b")
    ]
    table = pd.DataFrame(rows).assign(rmse_tilt_z_deg=3.0)
    left, right = figures.errors_by_take(table, 13.0, "synthetic").axes
    labels = [text.get_text() for text in left.get_yticklabels()]
    assert labels == ["least squares:\nother tests", "least squares:\nnot calibrated", "paper, as printed"]
    assert list(left.get_lines()[0].get_xdata()) == [1.0, 1.0]
    assert right.get_lines()[0].get_xdata()[0] == 3.0
    by_bend = {"rmse_below_20_deg": 1.0, "rmse_20_to_40_deg": 2.0, "rmse_above_40_deg": float("nan")}
    low, middle, high = figures.errors_by_bend(table.assign(**by_bend), 13.0, "synthetic").axes
    assert low.get_title() == "below 20°"
    assert middle.get_lines()[0].get_xdata()[0] == 2.0
    assert high.get_xlim() == low.get_xlim() == (0, 2.1)


def test_light_bulb_shades_events():
    table = pd.DataFrame({"file": "light_0", "time_s": [0.0, 1.0], "ratio": 0.1, "baseline": 0.1})
    events = pd.DataFrame({"file": ["light_0"], "start_s": [0.2], "end_s": [0.4]})
    figure = events_over_time(table.assign(bend_deg=30.0, deviation_deg=1.0), events, 0.01, "synthetic")
    left, right = figure.axes
    assert len(left.patches) == len(right.patches) == 1
    assert left.get_title(loc="left") == "file 0, synthetic"
