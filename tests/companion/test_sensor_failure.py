"""The page of Figs 4(b) and 5: errors, the argument of the root of three, the table of alarms."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import repro
from repro_companion.papers import baaij, failure

ROOT = Path(__file__).resolve().parents[2]


def test_errors_are_root_mean_squares_before_and_after():
    q = np.linspace(0, 1, 11)[:, None] * [[1.0, 2.0, 4.0]]
    after = np.arange(11) >= 5
    off = np.zeros((11, 1))
    off[0], off[5] = 0.1 * 5**0.5, 0.2 * 6**0.5  # in one of five steps, and in one of six
    table = failure.errors({(0, "failure"): q + off, (0, "all sensors"): q + 0.1}, q, after)
    found = table.set_index(["run", "part"])["error_percent"].sort_index()
    assert list(found["failure", "before"].round(9)) == [10, 5, 2.5]
    assert list(found["failure", "after"].round(9)) == [20, 10, 5]
    assert list(found["all sensors", "after"].round(9)) == [10, 5, 2.5]


def test_what_a_failure_costs_by_hand():
    """Means over coordinates and networks, and changes of each network; a small change is no minus zero."""
    found = {
        "all sensors": [[2.0, 2.0, 2.0], [2.0, 2.0, 2.0]],
        "failure": [[1.97, 3.0, 2.0], [2.5, 1.0, 2.3]],
    }
    lines = [
        (seed, run, "after", f"{name}_1", error)
        for run, networks in found.items()
        for seed, errors in enumerate(networks)
        for name, error in zip(failure.KINDS, errors, strict=True)
    ]
    columns = ["member", "run", "part", "quantity", "error_percent"]
    table = failure.cost(pd.DataFrame([*lines, (0, "failure", "before", "delta_x_1", 99.0)], columns=columns))
    assert list(table["", "coordinate"]) == [*failure.KINDS.values(), "mean"]
    np.testing.assert_allclose(table["error [%]", "with failure"], [2.235, 2.0, 2.15, 12.77 / 6])
    np.testing.assert_allclose(table["error [%]", "all sensors"], 2.0)
    changes = table["change, network"].to_numpy()
    np.testing.assert_allclose(changes.T, [[0.0, 1.0, 0.0, 0.3], [0.5, -1.0, 0.3, -0.1]])
    assert not np.signbit(changes[0, 0])


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (3.1, "**The failure costs accuracy.**"),
        (2.9, "cannot tell whether the failure costs"),
        (-2.9, "cannot tell whether"),
        (-3.1, "**With the failure the errors are smaller.**"),
    ],
)
def test_a_failure_is_a_loss_or_a_gain_from_three_standard_errors_on(change, words):
    """Of two networks whose changes differ by two the standard error of the mean is one."""
    runs = {"all sensors": (5.0, 5.0), "failure": (4.0 + change, 6.0 + change)}
    lines = [
        (seed, run, "after", f"{name}_1", error)
        for run, errors in runs.items()
        for seed, error in enumerate(errors)
        for name in failure.KINDS
    ]
    table = pd.DataFrame(lines, columns=["member", "run", "part", "quantity", "error_percent"])
    means = {"after_percent": [3.0], "all_sensors_percent": [2.0], "authors_after_percent": [3.9]}
    assert words in failure.cost_in_words(table, pd.DataFrame(means))


def test_a_lost_sensor_costs_the_roots_of_one_two_and_three():
    _, J = repro.Sensing(baaij.robot(1, 4)).linearise([0.0, 0.0, 2.75e-3])
    four, three = (np.linalg.inv(rows.T @ rows).diagonal() for rows in (J, J[:3]))
    np.testing.assert_allclose(np.sqrt(three / four), np.sqrt([1, 3, 2]), rtol=1e-9)


def test_courses_hold_mean_and_deviation_over_seeds():
    q = baaij.lemniscate(3, steps=4)
    robot = baaij.robot(3, 4)
    course = baaij.over_seeds(np.arange(4.0), robot.coordinates, q, np.stack([q, q, q + 3e-3]))
    assert list(course["name"]) == 4 * list(robot.coordinates)
    np.testing.assert_allclose(course["mean"] - course["truth"], 1e-3)
    np.testing.assert_allclose(course["std"], np.sqrt(3) * 1e-3)
    assert baaij.over_seeds(np.arange(4.0), robot.coordinates, q, q[None])["std"].isna().all()


def test_stills_show_all_runs_and_cross_out_what_failed():
    robot, q = baaij.robot(3, 4), baaij.lemniscate(3, steps=4)
    works = np.ones((4, 12), dtype=bool)
    works[2:, [3, 7, 11]] = False
    shapes, parts = baaij.stills(robot, np.arange(4.0), {"truth": q, "failure": q + 1e-3}, works)
    tips = shapes.groupby(["run", "time_s"])[["x_mm", "y_mm", "z_mm"]].last()
    np.testing.assert_allclose(tips.loc["truth"], 1e3 * robot.tip(q)[:, :3, 3])
    np.testing.assert_allclose(tips.loc["failure"], 1e3 * robot.tip(q + 1e-3)[:, :3, 3])
    lost = parts[~parts["working"]]
    assert list(lost["time_s"]) == [2, 2, 2, 3, 3, 3]
    assert set(lost["part"]) == {"sensor"}
    assert len(parts) == 4 * (3 + 12)


def test_alarms_are_shares_of_the_study():
    study = pd.read_csv(ROOT / "data" / "studies" / "alarms.csv")
    expected = pd.read_csv(
        ROOT / "results" / "sensor_failure_alarms.csv", keep_default_na=False, na_values=[""]
    )
    shares = failure.alarms(study)
    pd.testing.assert_frame_equal(shares, expected, rtol=1e-8, check_dtype=False)
    assert (shares["alarm_right_percent"] <= shares["alarm_percent"]).all()
    shown = failure.alarms_shown(shares)
    assert list(shown["", "fault"]) == list(failure.FAULTS.values())
    named = shown["8 sensors", "named"].isna()  # where no sensor fails, none is the right one
    assert list(shown.index[named]) == ["no reading", "magnet near"]
    lines = shares[shares["estimator"] == "levenberg_marquardt"].set_index(["robot", "scenario"])
    for column, (name, robot) in failure.SEEN.items():
        off = shown[column].astype(float) - lines.loc[robot, name]
        assert off.abs().max() <= 0.5


def test_the_words_about_alarms_are_those_of_the_study():
    study = (
        pd.read_csv(ROOT / "data" / "studies" / "alarms.csv")
        .set_index(["robot", "estimator", "scenario"])
        .sort_index()
    )
    share = study["alarms"] / study["readings"]
    squares, kalman = (share["one_segment", name] for name in ("levenberg_marquardt", "kalman"))
    assert squares["no reading"] == 1
    assert kalman["no reading"] == 0
    assert min(x[fault] for x in (squares, kalman) for fault in ("unplugged", "stuck")) > 0.5
    assert squares["gain +5 %"] < 0.05 < 0.3 < kalman["gain +5 %"] < 0.4
    jumps = study["alarms"].xs("jump", level="scenario").unstack("estimator")
    assert (jumps == [study["trials"].iloc[0], 0]).all(axis=None)  # one reading of each, and none
    eight = study.loc["two_segments"]
    assert (eight["noticed"] == eight["due"]).all()
    assert (study["alarms_before"] == 0).all()
