"""The figure of one robot with three sets of sensors: what is drawn is what the table holds."""

import pandas as pd
import pytest

from edition1_companion.pages.one_robot.estimates import METHODS
from edition1_companion.pages.one_robot.figures import three_ways
from edition1_companion.pages.one_robot.tables import CONDITIONS, QUANTITIES
from edition1_companion.twins.segment_motion import TRAJECTORIES


@pytest.fixture
def means():
    rows = []
    for i, trajectory in enumerate(TRAJECTORIES):
        for k, method in enumerate(METHODS):
            for calibrated in (True, False):
                for c, condition in enumerate(CONDITIONS):
                    row = dict(zip(("trajectory", "method"), (trajectory, method), strict=True))
                    row |= {"calibrated": calibrated, "condition": condition}
                    for quantity in QUANTITIES:
                        name, unit = quantity.rsplit("_", 1)
                        value = 1.0 + i + 10 * k + 100 * c + 0.5 * calibrated
                        row |= {quantity: value, f"{name}_low_{unit}": value - 0.2}
                        row |= {f"{name}_high_{unit}": value + 0.3}
                    rows.append(row)
    return pd.DataFrame(rows)


def test_a_mark_with_its_interval_for_every_method_and_trajectory(means):
    panels = three_ways(means).axes
    mark, _, (bar,) = panels[0].containers[0]
    assert mark.get_ydata().tolist() == [1.5]
    assert bar.get_segments()[0][:, 1] == pytest.approx([1.3, 1.8])


def test_the_last_panel_shows_calibrated_errors_when_something_is_amiss(means):
    panel = three_ways(means).axes[3]
    drawn = [container[0].get_ydata()[0] for container in panel.containers]
    first = drawn[:: len(METHODS)]
    assert first == pytest.approx([1.5, 101.5, 201.5, 3.5])
