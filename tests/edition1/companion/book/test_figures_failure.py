"""The sensor-failure page: what is drawn is what the tables hold."""

import numpy as np
import pandas as pd
import pytest

from edition1_companion.pages.sensor_failure.figures import (
    error_and_deviation,
    readings_and_estimates,
)

TIMES = [0.0, 2.5, 5.0, 7.5]


@pytest.fixture
def u() -> pd.DataFrame:
    index = pd.MultiIndex.from_product([TIMES, range(1, 13)], names=["time_s", "sensor"])
    table = pd.DataFrame(index=index).reset_index()
    failed = (table["sensor"] % 4 == 0) & (table["time_s"] >= 5)
    values = {"true_mT": 0.1 * table["sensor"] - table["time_s"], "mean_mT": -table["time_s"], "std_mT": 0.02}
    return table.assign(segment=(table["sensor"] + 3) // 4, working=~failed, **values)


@pytest.fixture
def q() -> pd.DataFrame:
    names = [f"{name}_{i}" for i in (1, 2, 3) for name in ("delta_x", "delta_y", "delta_L")]
    table = pd.DataFrame(
        index=pd.MultiIndex.from_product([TIMES, names], names=["time_s", "quantity"])
    ).reset_index()
    return table.assign(
        segment=table["quantity"].str[-1].astype(int), true_mm=table["time_s"], mean_mm=1.1, std_mm=np.nan
    )


def test_truth_estimate_and_failure_are_drawn(u, q):
    panels = readings_and_estimates(u, q, 5.0).axes
    seen, unseen, mean = (line.get_ydata() for line in panels[2].lines[9:12])  # sensor 8
    np.testing.assert_allclose(seen, [0.8, -1.7, np.nan, np.nan])
    np.testing.assert_allclose(unseen, [np.nan, np.nan, -4.2, -6.7])
    np.testing.assert_allclose(mean, [0.0, -2.5, -5.0, -7.5])
    assert all(panel.lines[-1].get_xdata()[0] == 5.0 for panel in panels)


def test_both_runs_are_drawn_from_zero():
    index = pd.MultiIndex.from_product(
        [TIMES, ["all sensors", "failure"], ["delta_x", "delta_y", "delta_L"]],
        names=["time_s", "run", "quantity"],
    )
    table = pd.DataFrame({"error_mm": 0.04, "deviation_mm": np.arange(24) / 24}, index=index).reset_index()
    panels = error_and_deviation(table, 5.0).axes
    chosen = table.query("run == 'failure' and quantity == 'delta_y'")
    assert panels[3].lines[0].get_ydata().tolist() == chosen["deviation_mm"].tolist()
