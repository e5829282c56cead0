"""Faults of sensors, seen by the monitor of an emulated robot and by the session of a port."""

import math
import threading
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from moving_robot import robot_readings
from scipy import stats

from edition1.estimation.consistency import Status
from edition1.robot_file.load import load_robot
from edition1_live.emulate.links import HAS_PTY
from edition1_live.emulate.robot_readings import course, readings_along
from edition1_live.emulate.sensor_faults import SensorFaults, with_sensor_faults
from edition1_live.follow import live_text
from edition1_live.follow.robot_estimator import robot_estimator
from edition1_live.follow.session import follow
from edition1_live.record.recording import read_recording
from edition1_live.wire.formats import encode
from edition1_live.wire.frame import Frame

ROBOTS = Path(__file__).parents[3] / "data" / "robots"
TWO = load_robot(ROBOTS / "two_segments.toml")
SINGLE = {"unplug": 8, "stick": 8, "saturate": 8, "gain": 8}
ALL = {"magnet": 150.0, "noise": 5.0}


def followed(fault=None, *, start_s=0.0, jump_s=0.0):
    """Verdicts and estimates of six seconds at 40 Hz; fault and jump come after two; and the true configurations."""
    slow, time_s = replace(TWO, rate_hz=40.0), np.arange(240) / 40
    q = course(slow, time_s + start_s + np.where(time_s >= 2.0, jump_s, 0.0), seed=7)
    sent = readings_along(slow, time_s, q, rng=np.random.default_rng([7, 1]))
    if fault:
        sent = with_sensor_faults(sent, SensorFaults(**fault), from_s=2.0, seed=7)
    estimator = robot_estimator(slow, "levenberg_marquardt")
    state, verdicts, estimates = estimator.method.init(estimator.start, seed=0), [], []
    for t, values in zip(time_s.tolist(), sent.values.tolist(), strict=True):
        state, found = estimator.method.step(state, slow.signal(values), t, mask=estimator.use)
        verdicts.append(state.verdict)
        estimates.append(found)
    return verdicts, estimates, torch.from_numpy(q)


@pytest.mark.parametrize("case", [{}, {"start_s": 20.0}, {"jump_s": 40.0}, {"fault": {"nan": 8}}])
def test_nothing_is_said_of_consistent_readings_whose_ellipsoids_hold_the_truth(case):
    verdicts, estimates, q = followed(**case)
    assert {verdict.status for verdict in verdicts} == {Status.CONSISTENT}
    C, error = torch.stack([x.covariance for x in estimates]), q - torch.stack([x.q for x in estimates])
    squared = (error * torch.linalg.solve(C, error)).sum(-1)[80:]
    share = float((squared <= stats.chi2.isf(0.05, q.shape[1])).double().mean())
    assert share == pytest.approx(0.95, abs=4 * math.sqrt(0.95 * 0.05 / len(squared)))


@pytest.mark.parametrize("name", SINGLE)
def test_a_single_sensor_is_named_and_no_other(name):
    verdicts = followed({name: SINGLE[name]})[0]
    assert all(verdict.status == Status.CONSISTENT for verdict in verdicts[:80])
    assert {verdict.suspects for verdict in verdicts if verdict.suspects} == {(7,)}


@pytest.mark.parametrize("name", ALL)
def test_what_reaches_all_sensors_is_no_single_one(name):
    verdicts = followed({name: ALL[name]})[0]
    assert all(verdict.status == Status.CONSISTENT for verdict in verdicts[:80])
    assert sum(verdict.status > Status.CONSISTENT for verdict in verdicts) > 20
    assert not any(verdict.suspects for verdict in verdicts)


@pytest.mark.skipif(not HAS_PTY, reason="no pseudo-terminals on this system")
def test_a_session_names_the_sensor_marks_the_shape_and_notes_it_in_the_recording(board, patient, tmp_path):
    slow = replace(TWO, rate_hz=50.0)
    sound = robot_readings(slow, duration_s=3.0, seed=1)
    sent = with_sensor_faults(sound, SensorFaults(unplug=3), from_s=1.0)
    estimator, states, stop = robot_estimator(slow), [], threading.Event()
    path = tmp_path / "run.rec"
    options = {"output": path, "stop": stop, "show": states.append}
    estimator.prepared()  # what is compiled meanwhile is an overload
    session = threading.Thread(target=lambda: follow(str(board.port), estimator, **options), daemon=True)
    session.start()
    deadline = time.monotonic() + 120
    board.opened()
    for k, values in enumerate(sent.values.tolist()):
        board.send(encode("frames", Frame(0, k, 20_000 * k, tuple(values))))
        time.sleep(0.02)
    while states[-1].estimated < len(sent.values) and time.monotonic() < deadline:
        time.sleep(0.05)
    stop.set()
    session.join(20)
    state = states[-1]
    assert (state.verdict.status, state.verdict.cause, state.verdict.suspects) == (
        Status.WRONG,
        "sensors",
        (2,),
    )
    assert live_text.mark(state) == "wrong, not to be trusted"
    assert "It is sensor 3 (--failed 3 leaves it out)." in live_text.alerts(estimator, state)[0]
    assert "Wrong, not to be trusted: residuals are" in " ".join(live_text.block(estimator, state))
    assert state.doubted == pytest.approx(100, abs=3)
    notes = [note for note in read_recording(path).notes if note.get("event") == "consistency"]
    assert notes[0]["consistency"] in ("suspicious", "wrong")
    assert (notes[-1]["consistency"], notes[-1]["cause"], notes[-1]["suspects"]) == (
        "wrong",
        "sensors",
        ["sensor 3"],
    )


def test_a_robot_without_redundancy_says_so():
    estimator = robot_estimator(load_robot(ROBOTS / "one_segment.toml"))
    assert estimator.redundancy == (3, 3)
    assert robot_estimator(TWO).redundancy == (8, 6)
    assert robot_estimator(TWO, failed=[1, 2]).redundancy == (6, 6)
    assert robot_estimator(load_robot(ROBOTS / "imu_arm.toml")).redundancy == (36, 36)
