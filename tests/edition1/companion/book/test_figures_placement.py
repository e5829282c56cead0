"""The placement page: what is drawn is what the tables hold."""

import math

import numpy as np
import pandas as pd
import pytest

from edition1.kinematics.paper_robots import pcc_robot
from edition1_companion.pages.sensor_placement.figures import all_robots, choices, judged, layouts_drawn
from edition1_companion.pages.sensor_placement.layouts import layout_of
from edition1_companion.pages.sensor_placement.studies import layouts_table
from edition1_companion.pages.sensor_placement.tasks import pcc_task


@pytest.fixture
def summary():
    rows = []
    for task in ("n_b=1, n_s=3", "affine, n_s=9"):
        for robot, scale in (("as drawn", 0.1), ("within tolerances", 9.0)):
            for shapes in ("trajectory", "random shapes"):
                for layout, ratio in (
                    ("nominal", 1.0),
                    ("optimised", 0.5),
                    ("optimised for noise alone", 0.2),
                ):
                    rows.append(
                        (
                            task,
                            robot,
                            shapes,
                            layout,
                            scale * ratio,
                            0.02 * scale,
                            ratio,
                            ratio - 0.1,
                            ratio + 0.1,
                        )
                    )
    columns = [
        "task",
        "robot",
        "shapes",
        "layout",
        "mean_percent",
        "std_percent",
        "ratio",
        "ratio_low",
        "ratio_high",
    ]
    return pd.DataFrame(rows, columns=columns)  # fmt: skip


def test_layouts_are_drawn_to_scale_with_their_directions():
    task = pcc_task(1, shapes=1, steps=2)
    tilted = layout_of(pcc_robot(1, tilt=math.pi / 6))
    figure = layouts_drawn(layouts_table(task, {"nominal": task.nominal, "tilted": tilted}))
    side, tilted_side, top, tilted_top = figure.axes
    np.testing.assert_allclose(side.collections[1].get_offsets(), [[13, 110], [-6.5, 110], [-6.5, 110]])
    first = tilted_side.collections[0]
    assert (first.U[0], first.V[0]) == pytest.approx((-7.0, -14 * math.cos(math.pi / 6)))
    assert (first.U[1], first.V[1]) == pytest.approx((3.5, -14 * math.cos(math.pi / 6)))
    assert float(np.hypot(top.collections[0].U, top.collections[0].V).max()) < 1e-9
    np.testing.assert_allclose(np.hypot(tilted_top.collections[0].U, tilted_top.collections[0].V), 7.0)


def test_bound_and_errors_are_drawn(summary):
    time = np.arange(4.0)
    names = ("nominal", "optimised", "optimised for noise alone")
    bound = pd.concat(
        pd.DataFrame({"layout": name, "time_s": time, "bound_percent": 0.1 + time + k})
        for k, name in enumerate(names)
    )
    left, middle, _ = judged(bound, summary[summary["task"] == "n_b=1, n_s=3"]).axes
    np.testing.assert_allclose([line.get_ydata()[0] for line in left.lines], [0.1, 1.1, 2.1])
    means = [bars[0].get_ydata().tolist() for bars in middle.containers]
    assert means == [[0.1, 0.1], [0.05, 0.05], pytest.approx([0.02, 0.02])]


def test_ratios_of_all_robots_are_drawn_with_their_intervals(summary):
    left, right = all_robots(summary).axes
    for panel in (left, right):
        ratios = [bars[0].get_xdata().tolist() for bars in panel.containers]
        assert ratios == [[0.5] * 4, [0.2] * 4]


def test_choices_are_drawn():
    rows = [("number", "3 nominal sensors", math.nan, 0.1, 9.0), ("freedom", "tilts", 0.9, 0.08, 8.0)]
    rows += [("limit", "0.9", 0.9, 0.06, 8.0), ("limit", "inf", math.inf, 0.02, 17.0)]
    table = pd.DataFrame(rows, columns=["study", "setting", "limit", "noise_percent", "tolerance_percent"])
    left, right = choices(table).axes
    assert left.lines[0].get_ydata().tolist() == [0.06, 0.02]
    assert [bar.get_width() for bar in right.patches] == [0.1, 0.08]
