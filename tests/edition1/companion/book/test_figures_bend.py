"""Figures of the page on probabilistic curvature: what is drawn is what the tables hold."""

import numpy as np
import pandas as pd

from edition1_companion.pages.probabilistic_curvature import figures
from edition1_companion.pages.probabilistic_curvature.bend_space import curves_table


def test_bend_space_draws_curves_in_degrees_and_the_cloud():
    points = pd.DataFrame({"bend_x_rad": [0.1, 0.2, 0.15], "bend_y_rad": [0.0, 0.1, 0.05]})
    panels = figures.bend_space(curves_table(every=50), points.assign(is_truth=[False, False, True])).axes
    particles, truth = panels[0].get_lines()
    np.testing.assert_allclose(particles.get_xdata(), np.rad2deg([0.1, 0.2]))
    np.testing.assert_allclose(truth.get_ydata(), np.rad2deg([0.05]))
    x, y = panels[1].get_lines()[0].get_data()
    assert np.hypot(x, y).max() == np.rad2deg(0.03 * 31.0)


def test_a_cloud_is_weighed_and_drawn_anew():
    """Particles with little weight, and those that are not drawn, have no mark of their own."""
    truth, weights = np.deg2rad([10.0, 0.0]), np.array([0.7, 0.2995, 0.0005])
    q = truth + np.deg2rad([[0.0, 0.0], [0.5, 0.5], [1.0, 5.0]])
    cloud = (q, weights, np.array([0, 0, 1]))
    panels = figures.filter_steps(cloud, truth, truth + np.deg2rad([0.3, 0.4])).axes
    assert [len(panel.collections) for panel in panels] == [1, 2, 1]
    np.testing.assert_allclose(panels[0].collections[0].get_offsets(), np.rad2deg(q))
    np.testing.assert_allclose(panels[1].collections[1].get_sizes(), [428, 187.7])
    np.testing.assert_allclose(panels[2].collections[0].get_sizes(), [408, 208])


def test_errors_over_time_have_a_panel_for_every_curve_and_process_noise():
    rows = [
        {"process_noise_pi": walk, "particles": n, "curve": curve, "t": t, "error_mm": walk * n + t}
        for walk in (0.02, 0.005)
        for n in (100, 1000)
        for curve in ("spiral", "flower")
        for t in (0.0, 0.01)
    ]
    figure = figures.error_over_time(pd.DataFrame(rows))
    few, many = (line.get_ydata() for line in figure.axes[1].lines)
    np.testing.assert_allclose(
        few, np.sqrt(np.mean(np.square([0.5, 0.51])))
    )  # both lie within the running mean
    np.testing.assert_allclose(many, np.sqrt(np.mean(np.square([5.0, 5.01]))))


def test_process_noise_draws_points_law_and_the_published_band():
    sweep = pd.DataFrame(
        {"curve": "spiral", "process_noise_pi": [0.005, 0.02], "particles": 1000, "rmse_mm": [0.005, 0.021]}
    )
    count = pd.DataFrame(
        {"curve": "flower", "process_noise_pi": 0.02, "particles": [100, 1000], "rmse_mm": [0.06, 0.02]}
    )
    law = pd.DataFrame(
        {
            "process_noise_pi": [0.02, 0.005, 0.02],
            "particles": [1000, 1000, 100],
            "law_mm": [0.015, 0.004, 0.05],
        }
    )
    left, right = figures.process_noise(sweep, law, count).axes
    drawn = [line.get_ydata() for line in left.lines if len(line.get_ydata()) == 2]
    assert any(np.array_equal(y, [0.005, 0.021]) for y in drawn)
    assert any(np.array_equal(y, [0.004, 0.015]) for y in drawn)
    assert [line.get_ydata().tolist() for line in right.lines] == [[0.06, 0.02], [0.05, 0.015]]
    (band,) = left.patches
    np.testing.assert_allclose([band.get_y(), band.get_y() + band.get_height()], [0.0044, 0.0046])


def test_sensor_noise_has_a_panel_for_each_motion():
    sweep = pd.DataFrame(
        {
            "motion": ["random walk", "random walk", "constant velocity"],
            "curve": ["spiral", "spiral", "flower"],
            "process_noise_pi": [0.005, 0.02, 0.001],
            "rmse_mm": [0.06, 0.1, 0.05],
        }
    )
    first, second = figures.sensor_noise(sweep, 0.066).axes
    assert first.lines[0].get_ydata() == [0.066, 0.066]
    assert first.lines[1].get_ydata().tolist() == [0.06, 0.1]
    assert second.lines[1].get_ydata().tolist() == [0.05]
