"""The arms of the page: which one is found, and the recorded robot against its own motion capture."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from edition1.errors import InputError
from edition1.estimation.imu_chain import link_orientations, rigid_body
from edition1_companion.book.project import find_project
from edition1_companion.pages.recorded_arm.sources import (
    BAG,
    ROBOT,
    SHORT_S,
    SYNTHETIC,
    links_about,
    load_arm,
    off_capture,
)
from edition1_companion.recordings.continuum_robot import (
    LENGTH_M,
    STATIONS_M,
    find_trials,
    poses,
    read_readings,
)
from edition1_companion.twins.captured_rod import captured

RECORDED = find_project().data / "recordings" / "continuum_robot"


@pytest.fixture(autouse=True)
def _nothing_fetched(monkeypatch, tmp_path):
    monkeypatch.setenv("REPRO_DATA_DIR", str(tmp_path))


def arm_of(recording, along="of the recording", fast=False):
    options = {"along": along, "between": "interpolate", "jump_deg": 20.0, "seed": 0, "fast": fast}
    return load_arm(recording, RECORDED, bag="prev_saved_data_to_play.bag", **options)


def test_without_the_bag_the_robot_is_found():
    arm = arm_of("first found")
    assert (arm.recording, arm.source, arm.along) == (ROBOT, "recorded robot", "z")
    assert arm_of(SYNTHETIC).along == "y"
    with pytest.raises(InputError, match="recording of load_arm must be one that is found"):
        arm_of(BAG)


def test_a_bag_that_is_found_but_is_not_the_released_one_is_refused(tmp_path):
    """It is looked for before the robot."""
    path = tmp_path / "martin2022/ros_packages/sesa/bags/prev_saved_data_to_play.bag"
    path.parent.mkdir(parents=True)
    path.write_bytes(b"another file")
    with pytest.raises(InputError):
        arm_of("first found")
    assert arm_of(ROBOT).recording == ROBOT


def test_stream_is_the_recording_at_the_last_body():
    """At its stamps, where the others were seen as well, nothing is interpolated."""
    arm = arm_of(ROBOT)
    folder = next(trial.folder for trial in find_trials(RECORDED) if trial.name == "slow_free_space")
    bodies = [read_readings(folder / f"vicon{k}.csv") for k in range(5)]
    start = max(body.time_s[0] for body in bodies)
    for k, body in enumerate(bodies):
        common, here, there = np.intersect1d(
            np.round(arm.stream.time_s + start, 6), np.round(body.time_s, 6), return_indices=True
        )
        assert len(common) > 700
        seen = Rotation.from_matrix(poses(body)[there, :3, :3])
        off = (seen.inv() * Rotation.from_quat(arm.stream.orientations[here, k])).magnitude()
        assert off.max() < 1e-4
    assert arm.stream.facts["readings"].tolist() == [len(body.time_s) for body in bodies]


def test_a_fast_run_shows_the_robot_where_it_moves():
    arm = arm_of(ROBOT, fast=True)
    assert arm.stream.time_s[-1] < SHORT_S
    z = rigid_body(link_orientations(arm.stream.orientations, arm.along), arm.links_m)[:, -1, 2]
    assert np.ptp(z) > 0.1


def test_links_are_about_their_sensors():
    links = links_about(LENGTH_M, 5)
    ends = np.cumsum(links)
    assert ends[-1] == pytest.approx(LENGTH_M)
    np.testing.assert_allclose((ends[1:-1] + ends[:-2]) / 2, STATIONS_M[:-1])
    np.testing.assert_allclose(arm_of(ROBOT).sensors_m, [0, *STATIONS_M])


def test_chain_is_judged_at_the_stations():
    """A straight chain of the same length is off by far more than the chain of the orientations."""
    table = off_capture(RECORDED, links_about(LENGTH_M, 5))
    np.testing.assert_allclose(table["station_mm"], 1e3 * np.array(STATIONS_M))
    assert (table["rmse_mm"] < 15).all()
    trial = next(trial for trial in find_trials(RECORDED) if trial.name == "slow_free_space")
    T = captured(trial, whole=True)[1]
    tip = T[:, 4, :3, 3] - T[:, 0, :3, 3]
    straight = 1e3 * np.sqrt(((tip - [0, 0, LENGTH_M]) ** 2).sum(-1).mean())
    assert straight > 3 * table["rmse_mm"].iloc[-1]
