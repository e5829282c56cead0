"""Figures of the IMU pages: what is drawn is what the tables hold."""

import numpy as np
import pandas as pd

from edition1_companion.pages.how_many_imus.figures import errors_and_bounds, placement_and_sensors


def test_count_figures_draw_errors_and_bounds():
    lines = [
        (model, n, 1.0, angle, 50.0 / n, 100.0 / n, 400.0 / n)
        for model in ("PCC-extended", "spline")
        for n in (4, 8)
        for angle in (0.0, 3.0)
    ]
    table = pd.DataFrame(
        lines, columns=["model", "n_imus", "crowding", "sensor_deg", "median_mm", "largest_mm", "bound_mm"]
    )
    exact = table[table["sensor_deg"] == 0]
    panel = errors_and_bounds([exact], ["random"]).axes[0]
    np.testing.assert_array_equal(panel.lines[0].get_ydata(), [25, 12.5])
    np.testing.assert_array_equal(panel.lines[1].get_ydata(), [100, 50])
    right = placement_and_sensors(exact, table, 640.0).axes[1]
    rule = [line.get_ydata() for line in right.lines if line.get_color() == "0.6"]
    np.testing.assert_allclose(rule[0], 640 * np.deg2rad(3) * np.sqrt(2 / np.array([4, 8])))
