"""Figures of noise and tolerances: what is drawn is what the tables hold."""

import pandas as pd
import pytest
from edition1_companion.pages.noise_and_tolerances.figures import (
    data_size_curves,
    noise_curves,
    tolerance_curves,
)


def noise_table():
    rows = [
        (n_b, model, solver, noise, error * noise, 10 * noise)
        for n_b in (1, 3)
        for model, error in (("multipole", 10), ("network of the paper", 50))
        for solver in ("gradient descent", "Levenberg-Marquardt")
        for noise in (1e-3, 1e-5)
    ]
    return pd.DataFrame(rows, columns=["n_b", "model", "solver", "noise_mt", "mean_percent", "bound_percent"])


def test_a_panel_for_every_solver_and_robot():
    figure = noise_curves(noise_table())
    titles = [panel.get_title(loc="left") for panel in figure.axes]
    assert titles == [
        "gradient descent, $n_b = 1$", "Levenberg-Marquardt, $n_b = 1$",
        "gradient descent, $n_b = 3$", "Levenberg-Marquardt, $n_b = 3$",
    ]  # fmt: skip
    for panel in figure.axes:
        paper, exact, bound = (line.get_ydata().tolist() for line in panel.lines)
        assert paper == [50 * 1e-5, 50 * 1e-3]  # in the order of the noise
        assert exact == bound == [10 * 1e-5, 10 * 1e-3]
    assert len(noise_curves(noise_table().query("n_b == 1 and solver == 'gradient descent'")).axes) == 1


def test_tolerances_with_interval_and_first_order():
    means = pd.DataFrame(
        {
            "n_b": 1,
            "kind": ["sensor_gain", "sensor_gain", "magnet_tilt_rad"],
            "size": [0.0, 1.0, 2.0],
            "error_percent": [1e-6, 2.0, 3.0],
            "low_percent": [1e-6, 1.5, 2.5],
            "high_percent": [1e-6, 2.5, 3.5],
            "linear_percent": [0.0, 2.1, 2.9],
        }
    )
    here = pd.DataFrame({"kind": ["sensor_gain"], "size": [1.5], "error_percent": [2.9]})
    tilt, gain = tolerance_curves(means, here).axes
    assert (tilt.get_xlabel(), gain.get_xlabel()) == ("magnet tilt [°]", "sensor gain [%]")
    points, line, own, level = gain.lines
    assert (own.get_xdata().tolist(), own.get_ydata().tolist()) == ([1.5], [2.9])
    assert points.get_ydata().tolist() == [2.0]  # a size of zero has no place on a logarithmic axis
    assert line.get_ydata().tolist() == [2.1]
    assert list(level.get_ydata()) == [1.0, 1.0]


def test_training_sizes_with_a_point_per_seed():
    table = pd.DataFrame(
        {
            "model": ["5 moments"] * 4 + ["network of the paper"],
            "configurations": [30, 30, 300, 300, 120_000],
            "e_u_mt": [2e-4, 4e-4, 2e-5, 4e-5, 1e-2],
            "noisy_percent": [0.2, 0.3, 0.1, 0.2, 1.5],
        }
    )
    left, right = data_size_curves(table, 0.123).axes
    paper, _, points, means = left.lines
    assert paper.get_ydata().tolist() == [1e-2]
    assert len(points.get_ydata()) == 4
    assert means.get_ydata().tolist() == pytest.approx([3e-4, 3e-5])
    assert list(right.lines[-1].get_ydata()) == [0.123, 0.123]
