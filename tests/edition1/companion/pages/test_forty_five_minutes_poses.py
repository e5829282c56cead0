"""Calibration by motion against calibration with poses: one robot again, the committed table, and what is drawn."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
import torch
from edition1.robot_file.load import load_robot
from edition1_companion.book.project import find_project
from edition1_companion.book.studies import committed, read_study
from edition1_companion.pages.forty_five_minutes import tables
from edition1_companion.pages.forty_five_minutes.poses import (
    DRIFT,
    HEADING_RAD,
    PLACES,
    POSE_M,
    RATE_HZ,
    SENSORS,
    STRAIGHT,
    becomes_known,
    drawn,
    equipments,
    in_motion,
    one,
)
from edition1_companion.pages.forty_five_minutes.studies import DRAWS, KNOWN, POSES, ROBOTS, STRAIGHT_AT_FIRST
from edition1_companion.pages.forty_five_minutes.twin import FAST_TILT
from edition1_live.emulate.robot_readings import course
from scipy.spatial.transform import Rotation

KEYS = ["robot", "off", "draw", "calibration", "minutes"]


@pytest.fixture(scope="module")
def robot():
    described = load_robot(find_project().data / "robots" / "one_segment.toml")
    return replace(described, rate_hz=RATE_HZ)


@pytest.fixture(scope="module")
def table():
    return committed([*POSES, STRAIGHT_AT_FIRST])


@pytest.fixture(scope="module")
def against(table):
    return tables.against_poses(table).set_index(["robot", "off", "calibration", "minutes"])


def test_a_robot_of_the_table_again(table):
    again = pd.concat(
        [one("one_segment", DRIFT, 3, [1.0], straight) for straight in (False, True)]
    ).set_index(KEYS)
    rows = table.set_index(KEYS).loc[again.index]
    assert len(rows) == 3 + len(SENSORS) + len(STRAIGHT)
    np.testing.assert_allclose(again, rows, rtol=0.02)


def test_the_committed_table_is_whole(table):
    """No motion is refused but where the place of the parts is off."""
    counts = table.groupby(["robot", "off", "calibration", "minutes"])["draw"].agg(tuple)
    ways = {("none", 0.0), ("poses", 0.0), ("true", 0.0)}
    for study in POSES:
        (name,), (off,) = study.settings["robots"], study.settings["off"]
        sets = SENSORS if off == PLACES else SENSORS + STRAIGHT
        motion = {(sensors, minutes) for sensors in sets for minutes in study.settings["minutes"]}
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


def test_only_with_places_off_are_parts_elsewhere(robot):
    drift, places = (drawn(robot, off, 5) for off in (DRIFT, PLACES))
    assert torch.equal(drift.robot.sensors.local, robot.robot.sensors.local)
    assert torch.equal(drift.earth_mt, robot.earth_mt)
    assert not torch.equal(places.robot.sensors.local, robot.robot.sensors.local)
    assert torch.equal(places.gain, drift.gain)
    assert places.magnets == drift.magnets
    strength = drift.magnets[0].polarisation_mt / robot.magnets[0].polarisation_mt
    torch.testing.assert_close(drift.moments, strength * robot.moments)


def test_imus_lean_and_are_turned_and_a_held_robot_does_not_stretch(robot):
    leaning, held = (equipments(robot)[way] for way in SENSORS[1:])
    moving = in_motion(leaning, robot, 300.0, 5)
    q = torch.from_numpy(course(leaning, moving.time_s, seed=5))
    true = Rotation.from_matrix(leaning.tip(q)[:, :3, :3].numpy())
    frames = [frame for step in moving.steps if (frame := step.frames[1]) is not None]
    sent = Rotation.from_quat(np.array([frame.values for frame in frames]))
    off = (sent * true.inv()).as_rotvec()
    heading = np.median(off[:, 2])
    assert 0 < abs(heading) < 4 * HEADING_RAD
    lean = (Rotation.from_rotvec([0.0, 0.0, -heading]) * sent * true.inv()).as_rotvec()
    np.testing.assert_allclose(lean[:, :2].std(0), FAST_TILT[0], rtol=0.3)
    middle = (robot.lower + robot.upper)[2] / 2
    stretch = course(held, moving.time_s, seed=5)[:, 2] - float(middle)
    assert 0.5 * POSE_M < np.abs(stretch).max() < POSE_M


def test_ratios_are_those_of_the_same_robot():
    ways = {"poses": (1.0, 2.0), SENSORS[0]: (4.0, 6.0)}
    rows = [("one", DRIFT, draw, way, 0.0, e, 0.5) for way, tip in ways.items() for draw, e in enumerate(tip)]
    made_up = pd.DataFrame(rows, columns=[*KEYS, "tip_rmse_percent", "stated_percent"])
    of_motion = tables.against_poses(made_up).iloc[1]
    assert of_motion["robots"] == 2
    assert of_motion[["ratio_least", "ratio_median", "ratio_most"]].tolist() == [3.0, 3.5, 4.0]
    assert of_motion[["median_percent", "stated_percent"]].tolist() == [5.0, 0.5]


def test_what_becomes_known_does_so_with_time_and_sensors():
    """One row again; an offset is known better after more of the same motion, and with more sensors."""
    table, _ = read_study(KNOWN.name)
    again = becomes_known([1], ["one_segment"], [0.5]).set_index(["robot", "draw", "calibration", "minutes"])
    rows = table.set_index(again.index.names).loc[again.index]
    np.testing.assert_allclose(again, rows, rtol=0.02)
    assert table["calibration"].unique().tolist() == list(SENSORS)
    offset = table["offset"].to_numpy().reshape(-1, len(SENSORS), len(KNOWN.settings["minutes"]))
    assert (np.diff(offset, axis=-1) < 0).all()
    assert (np.diff(offset, axis=-2) < 0).all()
