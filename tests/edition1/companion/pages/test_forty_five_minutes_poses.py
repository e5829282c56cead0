"""Calibration by motion against calibration with poses: the committed table, and what is drawn."""

import numpy as np
import pandas as pd
import pytest

from edition1_companion.book.studies import joined, read_study
from edition1_companion.pages.forty_five_minutes import tables
from edition1_companion.pages.forty_five_minutes.poses import SENSORS, STRAIGHT
from edition1_companion.pages.forty_five_minutes.studies import POSES, ROBOTS

DRIFT, PLACES = "drift", "drift and places"
DRAWS = tuple(range(10))
KEYS = ["robot", "off", "draw", "calibration", "minutes"]


@pytest.fixture(scope="module")
def table():
    return joined([f"forty_five_minutes_poses_{name}" for name in POSES])


@pytest.fixture(scope="module")
def against(table):
    return tables.against_poses(table).set_index(["robot", "off", "calibration", "minutes"])


def test_the_committed_table_is_whole(table):
    """No motion is refused but where the place of the parts is off."""
    counts = table.groupby(["robot", "off", "calibration", "minutes"])["draw"].agg(tuple)
    ways = {("none", 0.0), ("poses", 0.0), ("true", 0.0)}
    for study in POSES[:-1]:
        _, settings = read_study(f"forty_five_minutes_poses_{study}")
        (name,), (off,) = settings["robots"], settings["off"]
        sets = SENSORS if off == PLACES else SENSORS + STRAIGHT
        motion = {(sensors, minutes) for sensors in sets for minutes in settings["minutes"]}
        assert set(counts[name, off].index) == ways | motion
    _, imus, length = SENSORS
    for robot, way in (("one_segment", length), ("two_segments", imus), ("two_segments", length)):
        some_refused = set(counts.pop((robot, PLACES, way, 5.0)))
        assert some_refused < set(DRAWS)
    assert set(counts) == {DRAWS}


def test_poses_err_as_their_own_noise_lets_them_and_true_parameters_less(against):
    for case in [(robot, DRIFT) for robot in ROBOTS] + [("one_segment", PLACES), ("two_segments", PLACES)]:
        posed, true = (against.loc[(*case, way, 0.0)] for way in ("poses", "true"))
        assert 0.6 < posed["median_percent"] / posed["stated_percent"] < 1.6
        assert true["most_percent"] < 0.3
        assert true["median_percent"] < posed["median_percent"]


def test_self_calibration_is_within_its_target_where_all_is_determined(against):
    """On two segments with IMUs, and on all robots where the length is held or they begin straight."""
    imus, length = SENSORS[1:]
    assert against.loc[("two_segments", DRIFT, imus, 5.0), "ratio_median"] <= 1.5
    for robot in ROBOTS:
        for way in (length, STRAIGHT[1]):
            assert against.loc[(robot, DRIFT, way, 5.0), "ratio_median"] <= 1.5
        alone, straight = (
            against.loc[(robot, DRIFT, way, 5.0), "median_percent"] for way in (SENSORS[0], STRAIGHT[0])
        )
        assert straight < 0.4 * alone
    free, held, misplaced = (
        against.loc[("one_segment", off, way, 5.0), "ratio_median"]
        for off, way in ((DRIFT, imus), (DRIFT, length), (PLACES, imus))
    )
    assert held < free < misplaced


def test_ratios_are_those_of_the_same_robot():
    ways = {"poses": (1.0, 2.0), SENSORS[0]: (4.0, 6.0)}
    rows = [("one", DRIFT, draw, way, 0.0, e, 0.5) for way, tip in ways.items() for draw, e in enumerate(tip)]
    made_up = pd.DataFrame(rows, columns=[*KEYS, "tip_rmse_percent", "stated_percent"])
    of_motion = tables.against_poses(made_up).iloc[1]
    assert of_motion["robots"] == 2
    assert of_motion[["ratio_least", "ratio_median", "ratio_most"]].tolist() == [3.0, 3.5, 4.0]
    assert of_motion[["median_percent", "stated_percent"]].tolist() == [5.0, 0.5]


def test_what_becomes_known_does_so_with_time_and_sensors():
    """An offset is known better after more of the same motion, and with more sensors."""
    table, settings = read_study("forty_five_minutes_known")
    assert table["calibration"].unique().tolist() == list(SENSORS)
    offset = table["offset"].to_numpy().reshape(-1, len(SENSORS), len(settings["minutes"]))
    assert (np.diff(offset, axis=-1) < 0).all()
    assert (np.diff(offset, axis=-2) < 0).all()
