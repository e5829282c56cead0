"""The page of Figs 4(b) and 5: errors, the argument of the root of three, the table of alarms."""

from pathlib import Path

import numpy as np
import pandas as pd

import repro
from repro_companion.papers import baaij

ROOT = Path(__file__).resolve().parents[2]


def test_errors_of_a_constant_offset():
    q = np.linspace(0, 1, 11)[:, None] * [[1.0, 2.0, 4.0]]
    after = np.arange(11) >= 5
    off = np.where(after[:, None], 0.2, 0.1)
    errors = baaij.failure_errors({(0, "failure"): q + off, (0, "all sensors"): q + 0.1}, q, after)
    found = errors.set_index(["run", "part"])["error_percent"].sort_index()
    assert list(found["failure", "before"].round(9)) == [10, 5, 2.5]
    assert list(found["failure", "after"].round(9)) == [20, 10, 5]
    assert list(found["all sensors", "after"].round(9)) == [10, 5, 2.5]


def test_means_over_seeds_are_those_of_the_committed_table():
    errors = pd.read_csv(ROOT / "results" / "sensor_failure_errors.csv")
    expected = pd.read_csv(ROOT / "results" / "sensor_failure_authors.csv")
    pd.testing.assert_frame_equal(baaij.failure_means(errors), expected, rtol=1e-8)


def test_a_lost_sensor_costs_the_roots_of_one_two_and_three():
    _, J = repro.Sensing(baaij.robot(1, 4)).linearise([0.0, 0.0, 2.75e-3])
    four, three = (np.linalg.inv(rows.T @ rows).diagonal() for rows in (J, J[:3]))
    np.testing.assert_allclose(np.sqrt(three / four), np.sqrt([1, 3, 2]), rtol=1e-9)


def test_courses_mark_the_sensors_that_failed():
    robot, q = baaij.robot(3, 4), baaij.lemniscate(3, steps=4)
    u, works = np.zeros((4, 12)), np.ones((4, 12), dtype=bool)
    works[2:, [3, 7, 11]] = False
    estimates = np.stack([u, u + 2.0]), np.stack([q, q + 2e-3])
    readings, shape = baaij.failure_course(np.arange(4.0), robot, (u, q), estimates, works)
    lost = readings[~readings["working"]]
    assert set(lost["sensor"]) == {4, 8, 12}
    assert lost["time_s"].min() == 2
    assert set(readings["mean_mT"]) == {1.0}
    np.testing.assert_allclose(shape["std_mm"], np.sqrt(2))
    assert list(shape["segment"][:9]) == [1, 1, 1, 2, 2, 2, 3, 3, 3]


def test_alarms_are_shares_of_the_study():
    study = pd.read_csv(ROOT / "data" / "studies" / "alarms.csv")
    expected = pd.read_csv(
        ROOT / "results" / "sensor_failure_alarms.csv", keep_default_na=False, na_values=[""]
    )
    pd.testing.assert_frame_equal(baaij.alarms(study), expected, rtol=1e-8, check_dtype=False)
