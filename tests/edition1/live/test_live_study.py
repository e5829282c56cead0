"""What the live page says: estimates do not depend on timing, uncertainty is honest, failures do what is stated."""

import math
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from edition1.errors import InputError
from edition1.robot_file.load import load_robot
from edition1_companion.pages.live import figures
from edition1_companion.pages.live.study import failure_summary, failures, live_run
from edition1_companion.twins.played import played, with_sensors
from edition1_live.follow import session

ROBOTS = Path(__file__).parents[3] / "data" / "robots"


@pytest.fixture(scope="module")
def robot():
    return load_robot(ROBOTS / "one_segment.toml")


@pytest.fixture(scope="module")
def run(robot):
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(session, "SHORTEST_QUEUE", 1000)  # no pause of the computer may drop any
        return live_run(played(robot, rate_hz=100.0, seconds=2.0, seed=3))


def test_the_live_estimates_are_those_of_the_recording(run):
    both = run.recorded.set_index("row").loc[run.live["row"]].reset_index()
    pd.testing.assert_frame_equal(both, run.live, check_exact=True)
    assert run.recorded["row"].tolist() == list(range(200))
    assert run.state.estimated + run.state.dropped == 200
    assert "equal to those from the recording" in run.words


def test_another_run_gives_the_same_table(robot, run):
    again = live_run(played(robot, rate_hz=100.0, seconds=2.0, seed=3))
    pd.testing.assert_frame_equal(again.recorded, run.recorded, check_exact=True)


def test_stages_add_up_to_the_whole(run):
    stages = run.latencies.drop(columns="total_ms")
    assert (stages >= 0).all().all()
    np.testing.assert_allclose(stages.sum(axis=1), run.latencies["total_ms"], rtol=1e-9, atol=1e-9)


def test_errors_are_as_large_as_stated(run):
    table = run.recorded
    for name in ("delta_x_1", "delta_y_1", "delta_L_1"):
        z = (table[f"{name}_mm"] - table[f"{name}_true_mm"]) / table[f"{name}_std_mm"]
        assert 0.9 < (z.abs() < 2).mean() < 0.99  # 0.954 of a normal distribution
    ratio = math.sqrt((table["tip_error_mm"] ** 2).mean() / (table["tip_std_mm"] ** 2).mean())
    assert 0.85 < ratio < 1.15


def test_what_a_failed_sensor_does(robot):
    table = failures(robot, at_s=2.0, seconds=4.0)
    summary = failure_summary(table, 2.0).set_index(["sensors", "failure"])
    error, stated = summary["median_tip_error_mm"], summary["median_tip_std_mm"]
    assert error[3, "none"] < 0.2
    assert error[3, "stuck"] > 5, "believed"
    assert stated[3, "stuck"] < 0.2, "and not known to be wrong"
    assert stated[3, "no reading"] > 3, "known to be uncertain"
    assert error[6, "no reading"] < 1.5 * error[6, "none"], "the other five do"
    assert error[6, "stuck"] > 5
    assert error[6, "stuck, not used"] < 1.5 * error[6, "none"]
    before = table[
        (table["time_s"] < 1.99) & (table["failure"] != "stuck, not used") & (table["sensors"] == 3)
    ]
    per_case = [part["tip_error_mm"].to_numpy() for _, part in before.groupby("failure")]
    for one in per_case[1:]:
        np.testing.assert_array_equal(one, per_case[0])
    figure = figures.failures(table, 2.0)
    assert [axes.get_title() for axes in figure.axes[:2]] == ["3 sensors", "6 sensors"]


def test_figures_take_tables(run):
    panels = figures.estimates(run.recorded).axes
    assert [panel.get_ylabel() for panel in panels[0:6:2]] == [
        r"$\Delta_{x1}$ [mm]",
        r"$\Delta_{y1}$ [mm]",
        r"$\delta L_{1}$ [mm]",
    ]
    drawn = panels[0].lines[1].get_ydata()
    np.testing.assert_array_equal(drawn, run.recorded["delta_x_1_mm"])
    counted = figures.latency(run.latencies).axes[1].patches
    assert sum(bar.get_height() for bar in counted) == len(run.latencies)


def test_other_robots_are_refused(robot):
    arm = load_robot(ROBOTS / "imu_arm.toml")
    with pytest.raises(
        InputError, match=r"^Input robot of played must be one of Baaij et al\. that sends frames; "
    ):
        played(arm, rate_hz=10.0, seconds=1.0, seed=0)
    with pytest.raises(
        InputError, match=r"^Input seconds of played must be of one reading at least, 10 at most; "
    ):
        played(robot, rate_hz=10.0, seconds=11.0, seed=0)
    with pytest.raises(InputError, match=r"^Input robot of with_sensors must be one of one segment; "):
        with_sensors(load_robot(ROBOTS / "three_segments.toml"), 6)
