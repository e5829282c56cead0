"""A board that is not there: its motion, what it sends, how it fails, over real ports."""

import signal
import subprocess
import sys
import threading
import time
from contextlib import closing
from functools import partial
from itertools import islice
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import serial
from scipy.spatial.transform import Rotation

from repro import (
    ConstantCurvature,
    Disc,
    Imu,
    InputError,
    Magnet,
    Robot,
    Sensor,
    example,
    load_robot,
    simulated_readings,
)
from repro.parts import Source
from repro_board.emulate import (
    FAULTS,
    MOVE_S,
    OF_SENSORS,
    REACH,
    SPEED,
    Emulator,
    board_bytes,
    built,
    course,
    emulate,
    faulty,
    held,
    spread_poses,
    write_poses,
)
from repro_board.steps import Steps
from repro_board.wire import Parser
from tests.board.waiting import LONGEST_S, until

LOW, HIGH = np.array([-0.01, -0.02, 0.0, -0.01, 0.0, 0.0]), np.array([0.01, 0.02, 0.006, 0.01, 0.0, 0.006])
ROBOT = Robot(
    [ConstantCurvature(0.1, 0.02)] * 2, lower=LOW, upper=HIGH, start=[0.002, 0.0, 0.0, 0.0, 0.0, 0.001]
)
TIMES = np.arange(20_000) / 1000
U = np.random.default_rng(0).normal(size=(50, 4))


@pytest.mark.parametrize("seed", range(4))
def test_a_motion_starts_at_rest_keeps_within_its_bounds_and_below_its_speed(seed):
    q = course(ROBOT, TIMES, seed=seed)
    width = HIGH - LOW
    expected = np.array([0.002, 0.0, 0.05 * 0.006, 0.0, 0.0, 0.001])  # no nearer to a bound than it reaches
    np.testing.assert_allclose(q[0], expected, atol=1e-15)
    assert (np.abs(q - (LOW + HIGH) / 2) <= REACH * width / 2 + 1e-15).all()
    speed = np.abs(np.diff(q, axis=0)) * 1000
    assert (speed[0] <= 1e-2 * width).all()
    assert (speed <= SPEED * width * (1 + 1e-9) + 1e-12).all()
    moves = width > 0
    assert (np.ptp(q, axis=0)[moves] > 0.7 * width[moves]).all()
    np.testing.assert_array_equal(course(ROBOT, TIMES[::7], seed=seed), q[::7])


@pytest.mark.parametrize("fault", FAULTS)
def test_only_what_fails_changes_and_only_from_then_on(fault):
    sound = U.copy()
    sent = faulty(sound, fault, [1, 2], 20, 0.3)
    np.testing.assert_array_equal(sound, U)
    np.testing.assert_array_equal(sent[:20], U[:20])
    assert (sent[20, 1:3] != U[20, 1:3]).any() or fault == "saturated"
    if fault == "frozen":
        assert (sent[20:] == U[19]).all()
    else:
        np.testing.assert_array_equal(sent[:, [0, 3]], U[:, [0, 3]])
    mask = np.array([False, True, True, False])
    np.testing.assert_array_equal(faulty(U, fault, mask, 20, 0.3), sent)


def test_each_fault_reads_what_the_table_says():
    late = U[20:, 1]
    expected = {
        ("missing", None): np.full(30, np.nan),
        ("unplugged", None): np.zeros(30),
        ("unplugged", 1.5): np.full(30, 1.5),
        ("stuck", None): np.full(30, U[19, 1]),
        ("saturated", 0.5): np.clip(late, -0.5, 0.5),
        ("saturated", None): np.clip(late, -np.median(np.abs(U[:, 1])), np.median(np.abs(U[:, 1]))),
        ("scaled", None): 1.05 * late,
        ("drifting", 0.1): late + 0.1 * np.arange(1, 31),
        ("spike", 9.0): np.concatenate([[9.0], late[1:]]),
        ("frozen", None): np.full(30, U[19, 1]),
    }
    for (fault, size), values in expected.items():
        np.testing.assert_allclose(faulty(U, fault, 1, 20, size)[20:, 1], values, rtol=1e-14)
    assert (faulty(U, "stuck", 1, 0)[:, 1] == U[0, 1]).all()


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: faulty(U, "tired", 1), "Input fault of faulty must be one of missing, unplugged"),
        (
            lambda: faulty(U, "spike", 1),
            "Input size of faulty must be given for spike; instead received nothing",
        ),
        (
            lambda: course(Robot([ConstantCurvature(0.1, 0.02)]), [0.0]),
            "Input robot of course must be one with bounds",
        ),
    ],
)
def test_what_cannot_be_is_refused(call, message):
    with pytest.raises(InputError, match=message):
        call()


# ----------------------------------------------------------------------------------------- what a board sends
DATA = Path(__file__).parents[2] / "data" / "robots"
EXACT = Robot(
    [ConstantCurvature(0.07, 0.01)] * 2,
    magnets=[Magnet(Disc(0.012, 0.006, 1300.0), segment=1, at=0.035)],
    sensors=[
        Sensor(1, 0.06, radial=0.013, gain=1.1, offset=0.2, channels=[2]),
        Sensor(2, 0.01, radial=0.013, axes=3, channels=[5, 4, 3], per_mt=100.0, unit="raw"),
    ],
    imus=[Imu(2, 0.07, channels=7, world=[0.6, 0.0, 0.0, 0.8])],
    lower=[-0.01, -0.01, -0.007] * 2,
    upper=[0.01, 0.01, 0.007] * 2,
    rate_hz=200.0,
)
"""Without noise; its values have the channels 2 to 5, and the first one is not used."""


def samples(source, until_s, *, format="frames", **options):
    """Return the samples of each stream, by the parser of a format."""
    parser, found = Parser(format), {}
    for time_s, data in board_bytes(source, **options):
        if time_s >= until_s:
            break
        for sample in parser.feed(data):
            found.setdefault(sample.stream, []).append(sample)
    return found


def magnetic(source, until_s, **options):
    return np.array([sample.values for sample in samples(source, until_s, **options)[0]])


def test_frames_hold_what_the_sensors_read_at_their_times():
    robot = EXACT.replaced(earth=[0.2, -0.1, 0.4])
    found = samples(robot, 0.6, seed=3)
    times = np.arange(120) / 200.0
    q = course(robot, times, seed=3)
    u = simulated_readings(robot, q, [0.2, -0.1, 0.4])
    sent = np.zeros((120, 5))
    sent[:, 1] = 1.1 * u[:, 0] + 0.2
    sent[:, [4, 3, 2]] = 100.0 * u[:, 1:4]
    assert set(found) == {0, 7}
    for stream in found.values():
        assert [sample.sequence for sample in stream] == list(range(120))
        np.testing.assert_array_equal([sample.time_us for sample in stream], np.round(times * 1e6))
    np.testing.assert_allclose([sample.values for sample in found[0]], sent.astype(np.float32), rtol=3e-7)
    turned = Rotation.from_quat([0.6, 0.0, 0.0, 0.8]) * Rotation.from_rotvec(u[:, 4:])
    got = Rotation.from_quat([sample.values for sample in found[7]])
    assert (got.inv() * turned).magnitude().max() < 1e-6


CHIP = Sensor(2, 0.01, radial=0.013, axes=3, channels=["Bx", "By", "Bz"])
NAMED = Imu(1, 0.03, channels=["x", "y", "z", "w"], world=[0.0, 0.6, 0.0, 0.8])
PLAIN = EXACT.replaced(imus=[Imu(1, 0.03), Imu(2, 0.07)], sensors=[Sensor(1, 0.06, radial=0.013)])


@pytest.mark.parametrize(
    ("robot", "format"),
    [
        (EXACT, "frames"),
        (EXACT.replaced(imus=[NAMED], sensors=[CHIP]), "csv"),
        (PLAIN, "frames"),
        (PLAIN.replaced(sensors=[]), "frames"),
        (PLAIN.replaced(imus=[]), "csv"),
    ],
    ids=["channels and a stream", "names", "no channels", "IMUs alone", "a line"],
)
def test_what_is_sent_becomes_the_readings_of_the_robot_again(robot, format):
    robot = robot.replaced(source=Source("robot.toml", "", {"format": format}))
    parser, steps = Parser(), None
    found = []
    for time_s, data in islice(board_bytes(robot), 90):
        arrived = parser.feed(data)
        steps = steps or Steps(robot, source=parser)
        found += steps.feed(arrived, time_s)
    lost = 90 - len(found) if format == "csv" else 0  # a first line that may be cut
    times = np.arange(lost, lost + len(found)) / 200.0
    u = simulated_readings(robot, course(robot, times))
    u = u * robot.per_reading("gain", 1.0, 1.0) + robot.per_reading("offset", 0.0, 0.0)
    assert len(found) + lost >= 29
    assert lost <= 1
    np.testing.assert_allclose([step.u for step in found], u, atol=1e-5)
    np.testing.assert_allclose(np.diff([step.time_s for step in found]), 0.005, atol=2e-5)


@pytest.mark.parametrize(("name", "format"), [("imu_arm", "quaternions"), ("bend_sensor", "hall")])
def test_lines_of_the_papers_are_read_again(name, format):
    robot = load_robot(DATA / f"{name}.toml")
    found = samples(robot, 1.0, format=format)
    lost = {0: 1}  # no one knows whether the first line is whole
    n = round(robot.rate_hz)
    assert {stream: len(rows) for stream, rows in found.items()} == {
        stream: n - lost.get(stream, 0) for stream in range(len(robot.imus) or 1)
    }
    if format == "hall":
        u = simulated_readings(robot, course(robot, np.arange(1, n) / robot.rate_hz)) * 100.0
        error = np.array([sample.values for sample in found[0]]) - u
        np.testing.assert_allclose(error.std(), 2.5, rtol=0.2)


def test_a_board_that_prints_tells_its_columns_and_rounds_to_its_resolution():
    robot = load_robot(example() / "robot.toml")
    data = b"".join(data for _, data in islice(board_bytes(robot), 25))
    parser = Parser("csv")
    values = np.array([sample.values for sample in parser.feed(data)])
    assert parser.names == robot.names
    assert values.shape == (25, 12)
    np.testing.assert_allclose(values / 0.005, np.round(values / 0.005), atol=1e-9)
    error = values - simulated_readings(robot, course(robot, np.arange(25) / 25.0))
    np.testing.assert_allclose(error.std(), np.hypot(0.005, 0.005 / np.sqrt(12)), rtol=0.15)


def test_a_sensor_reads_no_more_than_its_range():
    sensors = [Sensor(1, 0.06, radial=0.013, range=0.5)]
    robot = EXACT.replaced(sensors=sensors, imus=[])
    found, free = magnetic(robot, 3.0), simulated_readings(robot, course(robot, np.arange(600) / 200))
    assert (np.abs(free) > 0.5).any()
    np.testing.assert_allclose(found, free.clip(-0.5, 0.5), atol=1e-6)


def test_one_seed_gives_the_same_bytes_and_another_one_others():
    robot = load_robot(DATA / "two_segments.toml")
    faults = {"flips": 1e-3, "bursts": 1e-3, "stalls": 0.01, "disconnects": 0.01, "unplug": 2, "noise": 3}
    first, again, other = (
        list(islice(board_bytes(robot, tolerances=1.0, faults=faults, seed=seed), 300)) for seed in (5, 5, 6)
    )
    assert first == again
    assert first != other


def test_a_robot_off_its_drawing_has_one_material_and_errors_in_proportion():
    one, two = built(EXACT, 1.0, seed=1), built(EXACT, 2.0, seed=1)
    for x, y, drawn in zip(one.magnets, two.magnets, EXACT.magnets, strict=True):
        moved = x.place.position - drawn.place.position
        assert (np.abs(moved) < 4 * 0.5e-3).all()
        np.testing.assert_allclose(y.place.position - drawn.place.position, 2 * moved)
        strength = np.log(x.shape.polarisation_mt / 1300.0)
        assert 0 < abs(strength) < 4 * 0.02
        np.testing.assert_allclose(np.log(y.shape.polarisation_mt / 1300.0), 2 * strength)
    pair = EXACT.replaced(magnets=[EXACT.magnets[0], Magnet(Disc(0.01, 0.005, -900.0), segment=2, at=0.05)])
    strengths = [m.shape.polarisation_mt for m in built(pair, 1.0).magnets]
    np.testing.assert_allclose(strengths[0] / 1300.0, strengths[1] / -900.0)
    assert built(EXACT, 0.0) is EXACT
    u, drawn = magnetic(EXACT, 1.0, tolerances=1.0), magnetic(EXACT, 1.0)
    assert 0.01 < np.abs(u - drawn).max(axis=0)[1] / np.abs(drawn).max(axis=0)[1] < 0.5


# ------------------------------------------------------------------------------------------ sensors that fail
@pytest.mark.parametrize("fault", [*OF_SENSORS, "magnet", "noise"])
def test_sensors_fail_from_a_time_on(fault):
    robot = EXACT.replaced(noise=0.01)
    value = {"magnet": 60.0, "noise": 4.0}.get(fault, 1)
    sound = magnetic(robot, 2.0)
    broken = magnetic(robot, 2.0, faults={fault: value}, fault_from=0.75)
    np.testing.assert_array_equal(broken[:150], sound[:150])
    if fault in ("magnet", "noise"):
        changed = broken[150:] - sound[150:]
        assert (changed[:, 1:] != 0).any(axis=0).all()
    else:
        a_minute = simulated_readings(EXACT, course(EXACT, np.linspace(0, 60, 257)))[:, 0]
        limit = np.median(np.abs(1.1 * a_minute + 0.2)) if fault == "saturate" else None
        expected = faulty(sound, OF_SENSORS[fault], 1, 150, limit)
        np.testing.assert_allclose(broken, expected, rtol=1e-6)
    if fault == "saturate":
        assert 0 < (broken != sound).sum() < 250
    if fault == "noise":
        exact = magnetic(EXACT, 2.0)
        np.testing.assert_allclose(
            [np.std((broken - exact)[150:, 1]), np.std((sound - exact)[:, 1])], [0.04, 0.01], rtol=0.15
        )


def test_a_foreign_magnet_is_a_dipole_beside_the_robot():
    robot = EXACT.replaced(imus=[])
    q = course(robot, [0.0])
    added = magnetic(robot, 0.001, faults={"magnet": 100.0}) - magnetic(robot, 0.001)
    pose = robot.poses(q, [robot.sensors[0].place])[0, 0]
    r = pose[:3, 3] - [0.1, 0.0, 0.07]
    d, m = np.linalg.norm(r), np.array([0.0, 0.0, 1.0])
    dipole = 1e-7 * (3 * r * (m @ r) / d**5 - m / d**3) * 1e3
    np.testing.assert_allclose(added[0, 1], 1.1 * dipole @ pose[:3, 2], rtol=0.01)


def test_an_imu_that_is_unplugged_sends_nothing_and_one_that_sticks_repeats():
    robot = load_robot(DATA / "imu_arm.toml")
    silent = samples(robot, 2.0, format="quaternions", faults={"unplug": 3}, fault_from=1.0)
    assert [len(silent[stream]) for stream in range(1, 4)] == [62, 31, 62]
    stuck = samples(robot, 2.0, format="quaternions", faults={"stick": 3}, fault_from=1.0)[2]
    assert len({tuple(sample.values) for sample in stuck}) == 31


# ------------------------------------------------------------------------------------------ a line that fails
def sent(faults, readings=4000, **options):
    """Return what a robot with one sensor sends: bytes without faults, and items with them."""
    robot = EXACT.replaced(sensors=EXACT.sensors[1:], imus=[], rate_hz=1000.0)
    given = list(islice(board_bytes(robot, faults=faults, **options), readings))
    return b"".join(data for _, data in islice(board_bytes(robot), readings)), given


@pytest.mark.parametrize("fault", ["drops", "duplicates", "flips", "bursts"])
def test_bytes_are_lost_doubled_and_changed_as_often_as_stated(fault):
    sound, given = sent({fault: 0.01, "burst_bytes": 4})
    arrived = b"".join(data for _, data in given)
    changes = {"drops": -0.01, "duplicates": 0.01}.get(fault, 0.0)
    np.testing.assert_allclose(len(arrived) - len(sound), changes * len(sound), rtol=0.15, atol=1e-9)
    if changes:
        return
    a, b = np.frombuffer(sound, np.uint8), np.frombuffer(arrived, np.uint8)
    if fault == "flips":
        np.testing.assert_allclose((a != b).mean(), 0.01, rtol=0.15)
        assert set(np.bitwise_count(a[a != b] ^ b[a != b])) == {1}
    else:
        assert 0.03 < (a != b).mean() < 0.04


def test_another_seed_damages_other_bytes():
    def line(seed, **faults):
        still = lambda times: np.zeros((len(times), EXACT.n_q))  # noqa: E731
        return b"".join(x for _, x in islice(board_bytes(EXACT, motion=still, faults=faults, seed=seed), 100))

    assert line(0) == line(1)
    assert line(0, flips=0.01) == line(0, flips=0.01) != line(1, flips=0.01)


def test_a_stall_holds_readings_back_and_loses_none():
    sound, given = sent({"stalls": 0.002, "stall_s": 0.3})
    assert b"".join(data for _, data in given) == sound
    late = np.array([time_s for time_s, _ in given]) - np.arange(4000) / 1000
    assert late.min() == 0
    assert 0.29 < late.max() <= 0.3
    assert (np.diff([time_s for time_s, _ in given]) >= 0).all()


def test_a_disconnect_takes_the_port_away_in_the_middle_of_a_reading_and_the_board_goes_on():
    sound, given = sent({"disconnects": 0.002, "away_s": 0.25})
    gone = [k for k, (_, data) in enumerate(given) if not data]
    assert 3 <= len(gone) <= 12
    parser = Parser("frames")
    found = []
    for _, data in given:
        found += parser.feed(data) if data else []
        if not data:
            parser.reopened()
    for k in gone[:-1]:
        assert len(given[k - 1][1]) < len(sound) / 4000 - 0.5
        np.testing.assert_allclose(given[k + 1][0] - given[k][0], 0.25, atol=0.0011)
    np.testing.assert_array_equal([s.sequence for s in found], np.round([s.time_us / 1000 for s in found]))
    assert parser.counters["gaps"] >= 250 * (len(gone) - 1)


def test_a_reboot_starts_numbers_and_clock_anew():
    _, given = sent({"reboots": 0.002, "boot_s": 0.25})
    parser, found = Parser("frames"), []
    for time_s, data in given:
        found += [(time_s, sample) for sample in parser.feed(data)]
    anew = [k for k in range(1, len(found)) if found[k][1].sequence < found[k - 1][1].sequence]
    assert 3 <= len(anew) <= 14
    for k in anew:
        if found[k][1].sequence == 0:
            assert found[k][1].time_us <= 1000
        assert found[k][0] - found[k - 1][0] > 0.25
    assert all(data for _, data in given)


def test_a_clock_that_drifts_is_fast_and_only_that():
    fast, usual = (samples(EXACT, 2.0, faults={"drift_ppm": x})[0] for x in (500.0, 0.0))
    assert fast[-1].time_us - usual[-1].time_us == round(500e-6 * 1.995e6)
    np.testing.assert_array_equal(fast[-1].values, usual[-1].values)


def test_nothing_fails_before_its_time():
    sound, given = sent({"flips": 0.5, "disconnects": 1.0, "stalls": 1.0}, 500, fault_from=0.5)
    assert b"".join(data for _, data in given) == sound


# ------------------------------------------------------------------------------------------------- poses held
@pytest.mark.parametrize(("free", "n"), [(1, 12), (2, 16), (3, 24)])
def test_poses_fill_the_bounds_evenly_eight_for_each_coordinate_that_is_free(free, n):
    high = 0.01 * (np.arange(3) < free)
    poses = spread_poses(Robot([ConstantCurvature(0.1, 0.02)], lower=-high, upper=high, start=high / 2))
    assert len(poses) == n
    np.testing.assert_allclose(poses[0], high / 2)
    cells = (np.sort(poses[1:] / 0.01 / REACH, axis=0) + 1) / 2 * (n - 1) - 0.5
    np.testing.assert_allclose(cells[:, :free], np.tile(np.arange(n - 1.0)[:, None], free), atol=1e-9)
    assert not poses[:, free:].any()


def test_a_robot_goes_from_pose_to_pose_without_a_jerk_at_their_ends():
    """The way of least jerk, in half a second: at rest, and without a force, at both ends."""
    share = np.array([-0.1, 0.0, 0.1, 0.5, 0.9, 1.0, 1.1, 99.0])
    way = held(np.array([[0.0], [2.0]]), 3.0, 3.0 + MOVE_S * share)[:, 0] / 2
    np.testing.assert_allclose(way, [0.0, 0.0, 0.00856, 0.5, 0.99144, 1.0, 1.0, 1.0])


def test_a_robot_stands_still_in_every_pose_of_its_table(tmp_path):
    poses = spread_poses(EXACT, seed=2)
    assert poses.shape == (48, 6)
    np.testing.assert_allclose(poses[0], 0.0, atol=1e-12)
    for k, width in enumerate(EXACT.upper - EXACT.lower):
        assert np.ptp(poses[:, k]) > 0.75 * width
    write_poses(tmp_path / "held.csv", EXACT, poses, 0.4)
    table = pd.read_csv(tmp_path / "held.csv")
    assert list(table) == [*(f"{name}_mm" for name in EXACT.coordinates), "start_s", "end_s"]
    for row in table.itertuples():
        inside = np.linspace(row.start_s, row.end_s, 5)
        q = held(poses, 0.4, inside)
        np.testing.assert_allclose(q, np.broadcast_to(np.array(row[1:7]) / 1e3, (5, 6)), atol=1e-9)
    times = np.arange(0.0, 25.0, 0.001)
    speed = np.abs(np.diff(held(poses, 0.4, times), axis=0)).max(axis=0) * 1000
    assert (speed < 1.9 * (EXACT.upper - EXACT.lower) / MOVE_S).all()
    u = magnetic(EXACT, 3.0, motion=partial(held, poses, 0.4))
    assert (u[:80] == u[0]).all()
    assert (u[180:250] == u[180]).all()
    assert (u[0] != u[180])[1:].any()
    with pytest.raises(InputError, match="output of emulate must be a new file"):
        write_poses(tmp_path / "held.csv", EXACT, poses, 0.4)


# ------------------------------------------------------------------------------------------------- real ports
def read_until(address, enough, opened=None):
    """Open a port, and return what arrives until it is enough, and when each part did; say when it is open."""
    found, times = b"", []

    def arrives() -> bool:
        nonlocal found
        if data := port.read(65536):
            found += data
            times.append((time.monotonic(), len(found)))
        return enough(found, np.array(times))

    with serial.serial_for_url(address, timeout=0.005) as port:
        if opened is not None:
            opened.set()
        until(arrives)
    return found, np.array(times)


def at_least(n):
    """Whether so many frames have arrived."""
    return lambda found, _: len(Parser("frames").feed(found)) >= n


@pytest.fixture(params=["pty", "tcp"])
def link(request, tmp_path):
    return tmp_path / "board" if request.param == "pty" else 0


def test_as_fast_as_it_is_read_every_byte_arrives_in_order(link):
    expected = b"".join(data for _, data in islice(board_bytes(EXACT), 1000))
    opened = threading.Event()

    def sent():
        assert opened.wait(LONGEST_S)  # a reader that opens it drops what came before
        yield from islice(board_bytes(EXACT), 1000)

    with Emulator(sent(), link, speed=np.inf) as board:
        found, _ = read_until(board.address, lambda found, _: len(found) == len(expected), opened)
        assert board.ended.wait(LONGEST_S)
    assert found == expected
    assert not Path(board.address).exists()


def test_in_real_time_its_rate_is_that_of_the_robot(link):
    """A busy machine delays many parts, but not all: with another rate, no time would be long enough."""
    robot = EXACT.replaced(imus=[])
    size = len(next(board_bytes(robot))[1])

    def in_time(_, times):
        if len(times) < 9 or times[-1, 1] < 1000 * size:
            return False
        third, late = len(times) // 3, times[:, 0] - times[:, 1] / size / 1000.0
        return abs(late[-third:].min() - late[:third].min()) < 0.02 * (times[-1, 0] - times[0, 0])

    with Emulator(board_bytes(robot, rate_hz=500.0), link, speed=2.0) as board:
        read_until(board.address, in_time)


def test_a_port_that_disappears_comes_back_under_its_name(tmp_path):
    both = threading.Barrier(2, timeout=LONGEST_S)

    def sent():
        both.wait()  # the reader has opened it
        yield 0.0, b"first"
        both.wait()  # and read that
        yield 0.0, b""
        both.wait()  # it has left
        yield 0.0, b"lost"
        both.wait()  # that is lost
        both.wait()  # it has opened it again
        yield 0.0, b"second"

    with Emulator(sent(), tmp_path / "board") as board:
        with serial.serial_for_url(board.address, timeout=LONGEST_S) as port:
            both.wait()
            assert port.read(5) == b"first"
            both.wait()
            until(lambda: not Path(board.address).exists())
        both.wait()
        both.wait()
        with serial.serial_for_url(board.address, timeout=LONGEST_S) as port:
            both.wait()
            assert port.read(6) == b"second"


def test_what_fails_in_its_thread_is_raised():
    def sent():
        yield 0.0, b"first"
        raise InputError("no more")

    def played():
        with Emulator(sent(), 0) as board:
            read_until(board.address, lambda *_: board.ended.is_set())

    with pytest.raises(InputError, match="no more"):
        played()


def test_a_reader_that_leaves_loses_what_is_sent_and_another_one_may_come():
    """While nobody has the port open the board goes on in time, or makes up for it where the computer stopped."""
    robot, played = EXACT.replaced(imus=[]), []

    def late_s(k: int) -> float:
        return played[k] - k / robot.rate_hz

    with Emulator((played.append(time.monotonic()) or item for item in board_bytes(robot)), 0) as board:
        first, _ = read_until(board.address, at_least(100))
        left = len(played)
        until(lambda: len(played) > left + 40 and late_s(len(played) - 1) < late_s(0) + 0.1)
        away = len(played) - 1
        second, _ = read_until(board.address, at_least(50))
    a, b = ([sample.sequence for sample in Parser("frames").feed(data)] for data in (first, second))
    assert a == list(range(len(a)))
    assert b == list(range(b[0], b[0] + len(b)))
    assert len(a) <= left <= away - 40 <= b[0] - 40


@pytest.mark.parametrize("ends", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_the_command_plays_a_robot_until_it_is_interrupted(tmp_path, ends):
    """By Ctrl-C, by another program, and by a terminal that is closed: no port file stays that leads elsewhere."""
    code = (
        "from repro_board.emulate import emulate; import sys\n"
        "sys.exit(emulate(sys.argv[1], 'board', hold_poses='held.csv', hold_s=1.0))"
    )
    command = [sys.executable, "-c", code, str(DATA / "two_segments.toml")]
    with subprocess.Popen(command, cwd=tmp_path, stdout=subprocess.PIPE, text=True) as process:
        try:
            assert process.stdout.readline() == "two_segments.toml, SYNTHETIC\n"
            address = process.stdout.readline().removeprefix("Port: ").strip()
            assert address == str(tmp_path / "board")
            found, _ = read_until(address, at_least(60))
            process.send_signal(ends)
            assert process.wait(LONGEST_S) == 0
        finally:
            process.kill()
    assert len(Parser("frames").feed(found)) > 50
    assert not (tmp_path / "board").is_symlink()
    assert len(pd.read_csv(tmp_path / "held.csv")) == 48


def test_a_recording_is_played_again_and_in_a_loop(tmp_path):
    records = pytest.importorskip("repro_board.record")
    path = tmp_path / "one.rec"
    with closing(records.Writer(path, {"format": "frames"})) as writer:
        for time_s, data in islice(board_bytes(EXACT), 100):
            writer.write(10**18 + round(time_s * 1e9), data)
    recording = records.read_recording(path)
    again = samples(recording, np.inf)
    whole = samples(EXACT, 0.2451)
    for stream in (0, 7):
        np.testing.assert_array_equal(
            [s.values for s in again[stream]], [s.values for s in whole[stream]][:50]
        )
    looped = samples(recording, 0.6, loop=True)[0]
    assert [s.sequence for s in looped] == list(range(len(looped)))
    assert len(looped) == 120
    np.testing.assert_array_equal(looped[50].values, looped[0].values)
    with pytest.raises(InputError, match="tolerances of emulate must be left out for a recording"):
        board_bytes(recording, tolerances=1.0)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"faults": {"tired": 1}}, "Input fault of emulate must be one of flips, drops"),
        ({"faults": [("flips", "often")]}, "Input fault flips of emulate must be numbers"),
        (
            {"faults": {"drops": -1}},
            "Input fault drops of emulate must be not negative, at most 1; instead received -1",
        ),
        (
            {"faults": {"unplug": 4}},
            r"one of sensor 1 \(1\), sensor 2 \(2\), imu 1 \(3\); instead received 4",
        ),
        ({"faults": {"gain": 3}}, "fault gain of emulate must be of a magnetic sensor; instead received 3"),
        ({"faults": {"stick": 1.5}}, r"one of sensor 1 \(1\), .*; instead received 1.5"),
        (
            {"faults": {"drops": 1.5}},
            "fault drops of emulate must be not negative, at most 1; instead received 1.5",
        ),
        ({"faults": {"drift_ppm": -1e7}}, "fault drift_ppm of emulate must be a number within 1e6 of zero"),
        ({"fault_from": np.nan}, "Input fault_from of emulate must be 0 or above"),
        ({"seed": -1}, "Input seed of emulate must be a whole number, 0 or above; instead received -1"),
        ({"rate_hz": -1.0}, "Input rate of emulate must be above zero"),
        ({"rate_hz": 1e12}, "Input rate of emulate must be above zero .* and at most 100000"),
        ({"tolerances": -1.0}, "Input tolerances of emulate must be 0 to 100"),
    ],
)
def test_a_board_that_cannot_be_is_refused_at_once(options, message):
    with pytest.raises(InputError, match=message):
        board_bytes(EXACT, **options)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"hold_poses": "held.csv", "hold_s": 0.0}, "Input hold of emulate must be above zero"),
        ({"hold_s": 1.0}, "Input hold of emulate must be left out without hold_poses"),
        ({"loop": True}, "Input loop of emulate must be left out for a robot, which moves for ever"),
        ({"fault_from": 1.0}, "Input fault_from of emulate must be left out without a fault"),
    ],
)
def test_what_would_mean_nothing_is_refused(options, message):
    with pytest.raises(InputError, match=message):
        emulate(example() / "robot.toml", **options)


def test_lines_of_one_stream_carry_no_imu_of_its_own():
    robot = PLAIN.replaced(source=Source("robot.toml", "", {"format": "csv"}))
    expected = (
        "format of robot.toml must be one that carries the streams of IMUs: frames; instead received csv"
    )
    with pytest.raises(InputError, match=expected):
        board_bytes(robot)


@pytest.mark.parametrize(
    ("sensors", "imus", "form"),
    [(1, 0, "csv"), (1, 2, "frames"), (0, 2, "quaternions")],
)
def test_a_file_without_a_format_gets_one_that_carries_its_parts(sensors, imus, form):
    robot = PLAIN.replaced(
        sensors=PLAIN.sensors[:sensors], imus=PLAIN.imus[:imus], noise=None,
        source=Source("robot.toml", "", {"format": None}),
    )  # fmt: skip
    stated = robot.replaced(source=Source("robot.toml", "", {"format": form}))
    first, second = (list(islice(board_bytes(one, seed=2), 9)) for one in (robot, stated))
    assert first == second


def test_lines_of_counts_carry_no_missing_reading():
    with pytest.raises(InputError, match="fault of emulate must be one that lines of hall can carry"):
        board_bytes(load_robot(DATA / "bend_sensor.toml"), faults={"nan": 1})


def test_a_port_takes_no_file_and_no_other_port(tmp_path):
    (tmp_path / "mine.csv").write_text("1,2\n")
    with pytest.raises(InputError, match="port_file of emulate must be a new name"):
        Emulator([], tmp_path / "mine.csv")
    with pytest.raises(InputError, match="port_file of emulate must be in a folder that exists"):
        Emulator([], tmp_path / "nowhere/port")
    assert (tmp_path / "mine.csv").read_text() == "1,2\n"
    with Emulator([], 0) as board:
        number = int(board.address.rpartition(":")[2])
        with pytest.raises(InputError, match="socket of emulate must be a free port"):
            Emulator([], number)
    with pytest.raises(InputError, match="socket of emulate must be a free port"):
        Emulator([], 70000)
