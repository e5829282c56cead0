"""The figure of a sweep: what is drawn is what the table holds."""

import math

import pandas as pd
import pytest

from edition1_companion.pages.sweep.figures import sensors_noise_segments


def test_a_panel_for_every_robot_and_a_line_for_every_noise():
    rows = [
        (n_segments, n_sensors, noise, share * noise, math.inf if n_sensors == 2 else 2 * noise)
        for n_segments in (3, 1)
        for n_sensors in (6, 2, 3)
        for noise in (0.1, 0.01)
        for share in (1.0, 3.0)
    ]
    columns = ["n_segments", "n_sensors", "noise_mt", "mean_percent", "bound_percent"]
    figure = sensors_noise_segments(pd.DataFrame(rows, columns=columns))
    for panel in figure.axes:
        for container, noise in zip(panel.containers, (0.01, 0.1), strict=True):
            line, _, (bars,) = container.lines
            assert line.get_xdata().tolist() == [2, 3, 6]
            assert line.get_ydata().tolist() == pytest.approx([2 * noise] * 3)
            (_, low), (_, high) = bars.get_segments()[0]
            assert (low, high) == pytest.approx((noise, 3 * noise))
        bounds = [line for line in panel.lines if line.get_linestyle() == "--"]
        assert [line.get_xdata().tolist() for line in bounds] == [
            [3, 6]
        ] * 2  # an infinite bound is not drawn
