"""A described robot as a board: held poses, their table, and what is sent in each format."""

from itertools import islice
from pathlib import Path

import numpy as np
import pytest
import torch
from moving_robot import robot_readings

from edition1.errors import InputError
from edition1.robot_file.load import load_robot
from edition1_live.emulate.board import Reading, passages
from edition1_live.emulate.faults import Faults
from edition1_live.emulate.hold_poses import (
    LEAST_POSES,
    MOVE_S,
    held_by_hand,
    held_in_time,
    measured_poses,
    spread_poses,
    write_poses,
)
from edition1_live.emulate.robot_board import carried, moving, open_board, robot_board
from edition1_live.emulate.robot_readings import course
from edition1_live.emulate.sensor_faults import SensorFaults
from edition1_live.robot.calibrate import calibrate, pose_covariance
from edition1_live.robot.calibration_poses import read_poses
from edition1_live.wire.formats import parser

ROBOTS = Path(__file__).parents[3] / "data" / "robots"
NETWORKS = ROBOTS.parent / "networks"


def robot(name="one_segment"):
    return load_robot(ROBOTS / f"{name}.toml")


@pytest.mark.parametrize(("name", "n"), [("one_segment", 12), ("two_segments", 24), ("bend_sensor", 12)])
def test_poses_are_within_the_bounds_and_far_from_each_other(name, n):
    found = robot(name)
    q = spread_poses(found)
    assert len(q) == n >= LEAST_POSES
    assert np.array_equal(q[0], found.start.numpy())
    low, high = found.lower.numpy(), found.upper.numpy()
    share = (q - low) / (high - low)
    assert share.min() >= 0.05 - 1e-12
    assert share.max() <= 0.95 + 1e-12
    assert (np.ptp(share, axis=0) > 0.8).all()
    distance = np.linalg.norm(share[:, None] - share, axis=-1) + 9 * np.eye(n)
    random = np.random.default_rng(0).random((n, len(low)))
    by_chance = np.linalg.norm(random[:, None] - random, axis=-1) + 9 * np.eye(n)
    assert distance.min() > 2 * by_chance.min()
    assert np.array_equal(q, spread_poses(found))
    assert not np.array_equal(q, spread_poses(found, seed=1))


def test_measured_poses_are_off_as_a_calibration_assumes():
    found = robot()
    q = np.zeros((4000, 3))
    assert abs(measured_poses(found, q).std() / 2e-4 - 1) < 0.03


def test_the_table_is_one_that_calibrate_reads(tmp_path):
    found = robot()
    q = measured_poses(found, spread_poses(found))
    write_poses(tmp_path / "poses.csv", found, q)
    table = read_poses(tmp_path / "poses.csv", found)
    assert table.window_s is None
    np.testing.assert_allclose(table.q, q, rtol=0, atol=0.5e-6)
    write_poses(tmp_path / "held.csv", found, q, hold_s=2.0)
    table = read_poses(tmp_path / "held.csv", found)
    assert table.window_s is not None
    motion = list(held_in_time(q, 100.0, 2.0))
    time_s, held = (np.concatenate(part) for part in zip(*motion, strict=True))
    assert time_s[-1] == pytest.approx(12 * 2.0 + 11 * MOVE_S, abs=0.02)
    assert np.allclose(np.diff(time_s), 0.01)
    for pose, (start_s, end_s) in zip(q, table.window_s, strict=True):
        inside = (time_s >= start_s) & (time_s <= end_s)
        assert inside.sum() > 80
        assert (held[inside] == pose).all()
    write_poses(tmp_path / "held.csv", found, q, hold_s=2.0)  # the same command once more
    with pytest.raises(InputError, match=r"must be a new file, or the same table; .*held\.csv\.$"):
        write_poses(tmp_path / "held.csv", found, q)


def test_between_poses_the_motion_is_smooth():
    q = np.array([[0.0, 1.0], [1.0, 0.0], [1.0, 1.0]])
    _, held = (np.concatenate(part) for part in zip(*held_in_time(q, 1000.0, 1.0), strict=True))
    assert held.min() == 0.0
    assert held.max() == 1.0
    acceleration = np.diff(held, n=2, axis=0) * 1e6
    assert np.abs(np.diff(acceleration, axis=0)).max() < 1e-3 * 60 / MOVE_S**3 * 1.1


def test_by_hand_a_pose_is_held_until_somebody_moves_it_on():
    """Each is said once it is still; what is told before counts, and after the last nothing does."""
    q, said, presses = np.eye(3), [], [False, False, True, True, True]
    motion = held_by_hand(q, 100.0, lambda: bool(presses) and presses.pop(0), said.append)
    parts = list(islice(motion, 200))
    time_s, held = (np.concatenate(part) for part in zip(*parts, strict=True))
    assert np.allclose(np.diff(time_s), 0.01)
    assert said == [0, 1, 2]
    assert len(presses) == 1  # nothing is asked once the last is held
    for k in range(3):
        assert (held == q[k]).all(axis=1).sum() >= 10
    assert (held[-100:] == q[2]).all()
    assert np.abs(np.diff(held, axis=0)).max() < 0.05


def test_a_robot_held_in_its_poses_is_calibrated(tmp_path):
    """From the table as measured and the readings of a robot that is off by its tolerances; by the windows."""
    found = robot()
    path = tmp_path / "held.csv"
    board = open_board(
        ROBOTS / "one_segment.toml", rate_hz=100.0, tolerances=1.0, hold_poses=path, hold_s=1.0, seed=2
    )
    sent = list(board.readings)
    time_s = np.array([reading.time_s for reading in sent])
    values = np.array([reading.values for reading in sent])
    table = read_poses(path, found)
    assert table.window_s is not None
    means = [values[(time_s >= a) & (time_s <= b)].mean(axis=0) for a, b in table.window_s]
    calibration = calibrate(
        found, torch.from_numpy(np.array(means)), table.q, pose_covariance(found, 2e-4, 0.01)
    )
    assert 0.3 < calibration.chi2 < 2
    assert calibration.after is not None
    assert calibration.before is not None
    assert calibration.after < 0.1 * calibration.before
    moved = robot_readings(found, tolerances=1.0, seed=2, duration_s=1.0, rate_hz=50.0)
    better = found.calibrated(calibration).values(torch.from_numpy(moved.q)).numpy()
    plain = found.values(torch.from_numpy(moved.q)).numpy()
    assert np.abs(better - moved.values).max() < 0.1 * np.abs(plain - moved.values).max()


@pytest.mark.parametrize("name", ["one_segment", "two_segments", "bend_sensor", "imu_arm"])
def test_every_format_carries_what_is_sent(name):
    """What a parser reads is what the sensors read, rounded to what the format carries."""
    found = robot(name)
    board = open_board(ROBOTS / f"{name}.toml", tolerances=1.0)
    assert board.label == f"{name}.toml, SYNTHETIC"
    assert board.notes == ()
    sent = list(islice(board.readings, 400))
    parse = parser(found.format)
    read = [frame for p in passages(sent, found.format) for frame in parse.feed(p.data)]
    text = found.format != "frames"
    assert len(read) == len(sent) - text  # a line of text that may have been cut is not read
    for frame, reading in zip(read, sent[text:], strict=True):
        assert frame.stream == reading.stream
        assert np.allclose(frame.values, reading.values, rtol=0, atol=1e-6)


def test_a_converter_clips(tmp_path):
    """Lines of millivolts hold 0 to 2048: what leaves that is clipped, and said."""
    text = (ROBOTS / "one_segment.toml").read_text().replace('"frames"', '"millivolts"')
    text = text.replace('unit = "mT"', 'unit = "mV"').replace("noise_mt = 7.1e-4", "noise_mv = 1")
    text = text.replace("radial_mm = 13.0", "radial_mm = 13.0\ngain_mv_per_mt = 500\noffset_mv = 1000")
    path = tmp_path / "robot.toml"
    path.write_text(text)
    board = open_board(path)
    assert board.notes == ("readings of sensor 1, 2, 3 leave 0 to 2048 mV, and are clipped to that.",)
    values = np.array([reading.values for reading in islice(board.readings, 5000)])
    assert values.min() == 0.0
    assert carried("hall", np.array([[9e3, -0.2]])).tolist() == [[8191.0, 0.0]]


def test_a_robot_with_networks_is_played_by_them(tmp_path):
    name = min(NETWORKS.glob("pcc_nb1_*.safetensors"))
    for suffix in (".safetensors", ".json"):
        (tmp_path / f"net{suffix}").write_bytes(name.with_suffix(suffix).read_bytes())
    path = tmp_path / "robot.toml"
    path.write_text((ROBOTS / "one_segment.toml").read_text() + '\n[model]\nnetworks = ["net.safetensors"]\n')
    found = load_robot(path)
    board = robot_board(found, moving(found, 1000.0))
    assert board.label == "robot.toml by its networks, SYNTHETIC"
    (first,) = islice(board.readings, 1)
    expected = found.sensing()(torch.from_numpy(course(found, np.zeros(1))))[0].detach().numpy()
    assert np.abs(np.array(first.values) - expected).max() < 6 * found.noise
    with pytest.raises(
        InputError, match=r"must be 0 for robot\.toml: its networks say what the sensors read"
    ):
        robot_board(found, moving(found, 1000.0), tolerances=1.0)


def test_faults_of_the_line_begin_at_their_time():
    """Nothing is damaged before; afterwards as with faults from the beginning. Drift has no beginning."""
    readings = [Reading(k / 100, 0, (float(k),)) for k in range(2000)]
    faults = Faults(flips=2e-3, stalls=2e-2, stall_s=0.1, drift_ppm=100.0)
    sent = list(passages(readings, "frames", faults, seed=3, from_s=10.0))
    whole = np.concatenate([p.intact for p in sent])
    assert whole[:1000].all()
    assert not whole[1000:].all()
    assert [p.silent_s for p in sent if p.time_s[0] < 10.0] == [0.0]
    assert sum(p.silent_s for p in sent) > 0
    assert sent[0].frames[500].device_us == round(5e6 * (1 + 1e-4))


def test_sensor_faults_begin_at_their_time():
    board = open_board(ROBOTS / "two_segments.toml", rate_hz=50.0, faults=SensorFaults(unplug=3), from_s=1.3)
    values = np.array([reading.values for reading in islice(board.readings, 200)])
    assert values[:65, 2].all()
    assert not values[65:, 2].any()


@pytest.mark.parametrize(
    ("name", "options", "message"),
    [
        ("one_segment", {"hold_s": 2.0}, "Input hold of repro emulate must be left out without --hold-poses"),
        ("one_segment", {"rate_hz": 0.0}, r"Input rate of repro emulate must be above zero \[Hz\]"),
        ("bend_sensor", {"faults": SensorFaults(nan=1)}, "Input fault of .* must be one that hall can carry"),
    ],
)
def test_messages(name, options, message):
    with pytest.raises(InputError, match=message):
        open_board(ROBOTS / f"{name}.toml", **options)
