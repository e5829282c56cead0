"""Figures of the page on performance: what is drawn is what the tables hold."""

import numpy as np
import pandas as pd
import pytest
from edition1_companion.pages.performance.figures import rates, scaling_curves
from edition1_companion.pages.performance.rows import Goal, row


def test_rates_with_targets_and_the_rates_of_the_sensors():
    table = pd.DataFrame(
        [
            row("a", "implementation", "per s", (100.0, 10.0), 0.0, "n", Goal(50.0, 5.0)),
            row("a, torch batched", "implementation", "per s", (100.0, 30.0), 0.0, "n"),
            row("a, live", "implementation", "per s", (20.0, 10.0), 0.0, "n"),
        ]
    )
    (panel,) = rates(table, [40.0, 60.0]).axes
    reference, target, ours, *sensor = panel.lines
    assert reference.get_xdata().tolist() == [10.0, 10.0]
    assert target.get_xdata().tolist() == pytest.approx([50.0, np.nan], nan_ok=True)
    assert ours.get_xdata().tolist() == [100.0, 20.0]
    assert [line.get_xdata()[0] for line in sensor] == [40.0, 60.0]
    assert [text.get_text() for text in panel.texts] == ["a", "a, live", "sensor rate, 40 and 60 Hz"]
    assert len(rates(table, []).axes[0].texts) == 2


def test_a_panel_for_everything_the_cost_grows_with():
    size = np.array([1.0, 10.0, 30.0, 100.0])
    points = pd.concat(
        pd.DataFrame({"capability": name, "against": against, "size": size, "seconds": 1e-3 * size**power})
        for name, against, power in (("a", "samples", 1.0), ("b", "samples", 1.1), ("a", "segments", 2.0))
    )
    panels = scaling_curves(points).axes
    assert [panel.get_xlabel() for panel in panels] == ["samples", "segments"]
    labels = [[text.get_text() for text in panel.get_legend().get_texts()] for panel in panels]
    assert labels == [["a", "b"], ["a"]]
    assert [[text.get_text() for text in panel.texts] for panel in panels] == [["1.00", "1.10"], ["2.00"]]
    measured, law = panels[1].lines
    assert measured.get_ydata().tolist() == pytest.approx((size**2.0).tolist())
    assert law.get_ydata().tolist() == pytest.approx([100.0, 900.0, 1e4])
