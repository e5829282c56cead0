"""A live session: what arrives is estimated, in order; what is not is counted and said; the recording has all."""

import math
import threading
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from edition1.errors import InputError
from edition1.estimation.imu_models import exact_arcs
from edition1.estimation.imu_selection import Selection
from edition1.robot_file.load import load_robot
from edition1_companion.twins.played import played
from edition1_companion.twins.takes import open_take
from edition1_live.emulate.board import Reading, passages
from edition1_live.emulate.emulator import Emulator
from edition1_live.emulate.links import SocketLink
from edition1_live.follow import live_text, session
from edition1_live.follow.follower import Follower
from edition1_live.follow.latency import Latencies
from edition1_live.follow.robot_estimator import ESTIMATORS, robot_estimator
from edition1_live.follow.session import follow
from edition1_live.follow.time_steps import TimeStep, TimeSteps
from edition1_live.record.recording import read_recording
from edition1_live.wire.frame import Frame

ROBOTS = Path(__file__).parents[3] / "data" / "robots"
SECOND_NS = 10**9


@pytest.fixture(scope="module")
def robot():
    return load_robot(ROBOTS / "one_segment.toml")


@pytest.fixture(scope="module")
def arm():
    return load_robot(ROBOTS / "imu_arm.toml")


def board(readings, format="frames", speed=1.0):
    """A board whose port disappears at the end."""
    return Emulator(passages(readings, format), SocketLink(), speed=speed, hang_up=True)


def followed(emulator, estimator, **options):
    """Follow a board until its port is gone for good; return the state, the estimates, and what was said."""
    stop, found, said = threading.Event(), [], []

    def warn(text):
        said.append(text)
        if emulator.finished.is_set():
            stop.set()

    with emulator:
        state = follow(emulator.address, estimator, stop=stop, each=found.append, warn=warn, **options)
    return state, found, said


def step(values, k=0, stream=0):
    return TimeStep(0.01 * k, 0, 0, (Frame(stream, k, None, tuple(values)),))


# -- time steps


def test_frames_of_all_streams_make_a_step_and_a_silent_stream_is_missing():
    steps = TimeSteps((3, 1, 2), 10.0)
    frames = [Frame(stream, None, None, (float(k),)) for k, stream in enumerate([1, 2, 3, 1, 3, 1, 9, 2, 3])]
    found = [[frame and frame.values[0] for frame in s.frames] for s in steps.add(SECOND_NS, frames)]
    assert found == [[2.0, 0.0, 1.0], [4.0, 3.0, None], [8.0, 5.0, 7.0]]
    assert steps.others == {9: 1}


def test_times_follow_the_clock_of_the_board_through_its_wrap_and_a_reset():
    steps = TimeSteps((0,), 100.0)
    sent_us = [2**32 - 10_000, 0, 10_000, 50, 10_050]
    arrivals_ms = [0, 25, 30, 540, 545]  # late, and a reset within half a second
    times = []
    for ms, us in zip(arrivals_ms, sent_us, strict=True):
        times += [s.time_s for s in steps.add(10**6 * ms, [Frame(0, 0, us, (1.0,))])]
    np.testing.assert_allclose(np.diff(times), [0.01, 0.01, 0.51, 0.01], atol=1e-9)


def test_frames_without_times_that_arrive_together_are_spread():
    steps = TimeSteps((0,), 100.0)
    lines = [Frame(0, None, None, (1.0,))] * 3
    times = [s.time_s for ns in (SECOND_NS, 2 * SECOND_NS) for s in steps.add(ns, lines)]
    np.testing.assert_allclose(times, [0, 0.01, 0.02, 1.0, 1.01, 1.02], atol=1e-9)


def test_times_increase_whatever_the_clocks_do():
    rng = np.random.default_rng(0)
    steps = TimeSteps((0,), 1000.0)
    times = []
    for _ in range(500):
        frames = [Frame(0, 0, int(rng.integers(2**32)), (1.0,))] * int(rng.integers(1, 4))
        times += [s.time_s for s in steps.add(int(rng.integers(10 * SECOND_NS)), frames)]
    assert (np.diff(times) > 0).all()


# -- latencies


def test_quantiles_of_a_histogram_bound_those_of_the_sample():
    sample = np.random.default_rng(0).lognormal(-7, 1.5, 3000)
    times = Latencies()
    for x in sample:
        times.add(float(x))
    for share in (0.5, 0.99):
        exact = float(np.quantile(sample, share, method="inverted_cdf"))
        assert exact * (1 - 1e-12) <= times.quantile(share) <= exact * 1.048
    assert times.count == 3000
    assert math.isnan(Latencies().quantile(0.5))
    for out in (0.0, 1e9):
        times.add(out)  # counted at the ends
    assert times.count == 3002


# -- estimators from robot files


@pytest.mark.parametrize("name", ESTIMATORS[:-1])
def test_every_estimator_finds_the_shape(robot, name):
    sent = played(robot, rate_hz=100.0, seconds=0.2, seed=2)
    follower = Follower(robot_estimator(sent.robot, name))
    for k, values in enumerate(sent.take.values.tolist()):
        _, estimate = follower.step(step(values, k))
    assert estimate is not None
    assert float((estimate.q - sent.q[-1]).abs().max()) < 3e-4


def test_imus_give_positions_and_one_that_is_silent_is_filled(arm):
    take = open_take("arm", seed=1)
    follower = Follower(robot_estimator(arm))
    steps = TimeSteps(follower.estimator.streams, arm.rate_hz)
    frames = [
        Frame(int(s), None, None, tuple(v)) for s, v in zip(take.stream, take.values.tolist(), strict=True)
    ][:24]
    whole, silent, _ = steps.add(SECOND_NS, [f for k, f in enumerate(frames) if k != 11])
    assert [f is None for f in silent.frames] == [k == 3 for k in range(8)]
    _, first = follower.step(whole)
    _, second = follower.step(silent)
    tips = [e.q[-3:] for e in (first, second)]
    quaternions = np.array([(0.0, 0.0, 0.0, 1.0), *(f.values for f in whole.frames)])
    expected = exact_arcs(
        quaternions, Selection(tuple(range(9)), tuple(0.08 * np.arange(9)), (0.08,) * 8, sub_links=2), [0.64]
    )  # IMUs as in table I of the paper
    np.testing.assert_allclose(tips[0], expected[0], atol=1e-12)
    assert float((tips[1] - tips[0]).norm()) < 0.05
    spread = [float(e.covariance[-3:, -3:].trace()) for e in (first, second)]
    assert spread[1] > 4 * spread[0], "what was filled is less certain"
    assert follower.missing == [0, 0, 0, 1, 0, 0, 0, 0]


def test_a_reading_that_is_no_number_is_masked_and_one_that_is_infinite_refused(robot):
    follower = Follower(robot_estimator(robot, "kalman"))
    q = robot.start
    good = robot.values(q).tolist()
    assert follower.step(step(good, 0))[1] is not None
    _, estimate = follower.step(step([good[0], math.nan, good[2]], 1))
    assert int(estimate.diagnostics["masked"]) == 1
    assert follower.step(step([math.nan] * 3, 2))[1] is None
    assert follower.step(step([math.inf, *good[1:]], 3))[1] is None
    assert follower.refusal == (
        "Input u of IteratedKalmanFilter must be finite, or NaN for a missing reading; "
        "instead received infinite readings."
    )
    assert (follower.estimated, follower.refused, follower.missing) == (2, 2, [1, 2, 1])
    assert follower.step(step(good, 4))[1] is not None, "it goes on"


@pytest.mark.parametrize(
    ("file", "options", "message"),
    [
        (
            "one_segment",
            {"name": "best"},
            "Input estimator of repro live must be one of levenberg_marquardt, kalman, gradient_descent, "
            "particle_filter, imu_chain; instead received best.",
        ),
        (
            "one_segment",
            {"name": "imu_chain"},
            "Input estimator of repro live must be levenberg_marquardt or kalman or gradient_descent or "
            "particle_filter for the magnetic sensors of one_segment.toml; instead received imu_chain.",
        ),
        (
            "imu_arm",
            {"name": "kalman"},
            "Input estimator of repro live must be imu_chain for the IMUs of imu_arm.toml; instead received kalman.",
        ),
        (
            "three_segments",
            {"name": "particle_filter"},
            "Input estimator of repro live must be another one for three_segments.toml: particles fill at most 4 "
            "coordinates; instead received particle_filter for 9.",
        ),
        (
            "one_segment",
            {"failed": [4]},
            "Input failed of repro live must be numbers of sensors, 1 to 3; instead received 4.",
        ),
        (
            "one_segment",
            {"failed": [1, 2, 3]},
            "Input failed of repro live must be fewer than all 3 sensors; instead received 3 of them.",
        ),
    ],
)
def test_what_does_not_fit_the_robot_is_refused(file, options, message):
    with pytest.raises(InputError) as error:
        robot_estimator(load_robot(ROBOTS / f"{file}.toml"), **options)
    assert str(error.value) == message


# -- sessions


def test_everything_is_estimated_and_recorded_in_order(robot, patient, tmp_path):
    sent = played(robot, rate_hz=100.0, seconds=1.0, seed=0)
    states = []
    state, found, _ = followed(
        board(sent.take.readings()), robot_estimator(sent.robot), output=tmp_path / "r", show=states.append
    )
    assert [one.step.frames[0].sequence for one in found] == list(range(100))
    np.testing.assert_allclose([one.step.time_s for one in found], np.arange(100) / 100, atol=2e-6)
    assert (state.estimated, state.dropped, state.refused, state.missing) == (100, 0, 0, (0, 0, 0))
    for one in found:
        assert one.step.arrival_ns <= one.step.parsed_ns <= one.taken_ns <= one.done_ns
    assert all(times.count == 100 for times in state.latencies.values())
    recording = read_recording(tmp_path / "r")
    np.testing.assert_array_equal(recording.frames[recording.channels].to_numpy(), sent.take.values)
    assert state.recorded.counters["frames"] == 100
    assert len(states) >= 3
    text = live_text.block(robot_estimator(sent.robot), state)
    assert text[0].startswith(f"{state.seconds:.0f} s: ")
    assert text[1].startswith("delta_x_1 ")
    assert " mm   delta_y_1 " in text[1]
    assert text[2:3] == ["100 frames"]
    never = "a wrong sensor looks like another shape and cannot be told."
    assert text[3:] == [f"No redundancy, 3 readings for 3 unknowns: {never}"], "nothing to complain about"


def test_overload_drops_the_newest_says_so_and_the_recording_has_all(robot, tmp_path, monkeypatch):
    sent = played(robot, rate_hz=40.0, seconds=3.0, seed=0)
    estimator = robot_estimator(sent.robot)
    slow = session.Follower.step

    def slowly(self, step):
        time.sleep(0.02)
        return slow(self, step)

    monkeypatch.setattr(session.Follower, "step", slowly)
    state, found, said = followed(board(sent.take.readings(), speed=20.0), estimator, output=tmp_path / "r")
    numbers = [one.step.frames[0].sequence for one in found]
    assert state.dropped > 20
    assert state.estimated + state.dropped == 120
    assert numbers == sorted(set(numbers))
    assert numbers[:10] == list(range(10)), "what waited stays in order: the newest went"
    assert said[0] == (
        "Overload: the estimator is slower than the stream. What arrives while 10 time steps wait is not estimated, "
        "only recorded."
    )
    lasting, over = replace(state, dropped_now=True), replace(state, dropped_now=False)
    assert live_text.troubles(estimator, lasting) == [
        "Overload: the estimator is slower than the stream. "
        f"{state.dropped} time steps were not estimated so far, the newest first; the recording has them."
    ]
    assert live_text.alerts(estimator, lasting) == [
        "Overload: the estimator is too slow, time steps are left out."
    ]
    assert live_text.troubles(estimator, over) == [
        f"{state.dropped} time steps were not estimated, in an overload that is over; the recording has them."
    ]
    assert live_text.alerts(estimator, over) == []
    assert len(read_recording(tmp_path / "r").frames) == 120


def test_a_sensor_that_falls_silent_is_left_out_and_named(robot, patient):
    sent = played(robot, rate_hz=100.0, seconds=0.6, seed=0)
    values = sent.take.values.copy()
    values[30:, 1] = math.nan
    take = replace(sent.take, values=values)
    estimator = robot_estimator(sent.robot, "kalman")
    state, _, _ = followed(board(take.readings()), estimator)
    assert state.missing == (0, 30, 0)
    doubt, left_out = live_text.troubles(estimator, state)
    assert doubt.endswith("There are fewer readings than unknowns: they do not determine the shape.")
    assert left_out == "sensor 2 gives no reading and is left out: 30 time steps so far."
    assert live_text.alerts(estimator, state)[1:] == ["sensor 2 gives no reading and is left out."]
    assert state.recorded.path is None, "nothing was to be recorded"


def test_frames_of_another_number_of_values_are_refused_counted_and_recorded(robot, patient, tmp_path):
    good = tuple(robot.values(robot.start).tolist())
    readings = [Reading(k / 100, 0, good if k % 3 else (1.0, 2.0, 3.0, 4.0)) for k in range(90)]
    estimator = robot_estimator(robot)
    state, _, _ = followed(board(readings), estimator, output=tmp_path / "r")
    assert (state.estimated, state.refused, state.missing) == (60, 30, (0, 0, 0))
    assert live_text.troubles(estimator, state) == [
        "30 time steps without an estimate. Input frame of the stream must be of 3 channels, as described in "
        "one_segment.toml; instead received 4 values."
    ]
    recording = read_recording(tmp_path / "r")
    assert np.bincount(recording.widths).tolist() == [0, 0, 0, 60, 30], "the recording has all"
    assert recording.metadata["ended"] == "stopped"


def test_an_orientation_of_another_number_of_values_is_refused(arm):
    follower = Follower(robot_estimator(arm))
    frames = [Frame(k, None, None, (0.0, 0.0, 0.0, 1.0)) for k in range(7)] + [Frame(7, None, None, (1.0,))]
    u, estimate = follower.step(TimeStep(0.0, 0, 0, tuple(frames)))
    assert (u.isnan().all(), estimate, follower.refused) == (True, None, 1)
    assert follower.refusal.endswith("as described in imu_arm.toml; instead received 1 values.")


def test_another_stream_is_counted_and_named(robot, patient):
    values = tuple(robot.values(robot.start).tolist())
    readings = [Reading(k / 200, k % 2 * 5, values) for k in range(100)]
    estimator = robot_estimator(robot)
    state, _, _ = followed(board(readings), estimator)
    assert (state.estimated, state.other_streams) == (50, {5: 50})
    assert live_text.troubles(estimator, state) == [
        "Streams that one_segment.toml does not have: 5 (50 frames)."
    ]


def test_errors_of_the_reader_end_the_session(robot, tmp_path):
    taken = tmp_path / "taken"
    taken.touch()
    estimator = robot_estimator(robot)
    with pytest.raises(InputError, match=r"^Input duration of repro live must be a time above zero \[s\]; "):
        follow("socket://127.0.0.1:1", estimator, duration_s=0.0)
    with pytest.raises(InputError, match=r"^Input port of repro live must be reachable"):
        follow("socket://127.0.0.1:1", estimator)
    with pytest.raises(InputError, match=r"^Input output of repro live must be a new file"):
        follow("socket://127.0.0.1:1", estimator, output=taken)


def test_a_coordinate_that_no_reading_determines_is_called_so(robot):
    estimator = robot_estimator(robot, failed=[2])
    sent = played(robot, rate_hz=100.0, seconds=0.3, seed=0)
    state, _, _ = followed(board(sent.take.readings()), estimator)
    assert all(str(x).endswith(" mm (undetermined)") for x in live_text.quantities(estimator, state))
    doubt, asked = live_text.troubles(estimator, state)
    assert doubt.endswith("There are fewer readings than unknowns: they do not determine the shape.")
    assert asked == "Not used, as asked: sensor 2."
