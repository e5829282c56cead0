"""Faults of sensors, seen by the session of a port and in trials of an emulated robot."""

import math
import threading
import time
from dataclasses import replace
from itertools import product
from pathlib import Path

import pandas as pd
import pytest
from edition1.estimation.consistency import Status
from edition1.robot_file.load import load_robot
from edition1_companion.book.studies import read_study
from edition1_companion.pages.sensor_failure.studies import (
    SCENARIOS,
    STUDIES,
    alarm_sums,
    alarm_table,
    alarm_trials,
)
from edition1_live.emulate.links import HAS_PTY
from edition1_live.emulate.sensor_faults import SensorFaults, with_sensor_faults
from edition1_live.follow import live_text
from edition1_live.follow.robot_estimator import robot_estimator
from edition1_live.follow.session import follow
from edition1_live.record.recording import read_recording
from edition1_live.wire.formats import encode
from edition1_live.wire.frame import Frame
from moving_robot import robot_readings

ROBOTS = Path(__file__).parents[3] / "data" / "robots"
TWO = load_robot(ROBOTS / "two_segments.toml")
SINGLE = ("unplugged", "stuck", "saturated", "gain +5 %")


@pytest.fixture(scope="module")
def counts():
    """One trial of every scenario, at 40 Hz."""
    slow = replace(TWO, rate_hz=40.0)
    return {name: alarm_trials(slow, "levenberg_marquardt", name, trials=1, seed=7) for name in SCENARIOS}


def test_what_is_due_is_noticed(counts):
    assert all(count["noticed"] == count["due"] for count in counts.values())
    assert sum(count["due"] for count in counts.values()) > 100


def test_nothing_is_said_of_consistent_readings(counts):
    for name in ("none", "start bent", "no reading", "jump"):
        assert counts[name]["alarms"] == 0, name
    assert not any(count["alarms_before"] for count in counts.values())


@pytest.mark.parametrize("name", SINGLE)
def test_a_single_sensor_is_named_and_no_other(counts, name):
    assert counts[name]["named"] == counts[name]["named_right"] == counts[name]["clear"] == 1
    assert counts[name]["named_readings"] == counts[name]["named_readings_right"]


@pytest.mark.parametrize("name", ["magnet near", "noise x 5"])
def test_what_reaches_all_sensors_is_no_single_one(counts, name):
    assert counts[name]["alarms"] > 20
    assert counts[name]["named_readings"] == 0


def test_trusted_ellipsoids_hold_the_truth(counts):
    calm = [counts[name] for name in ("none", "start bent", "jump", "no reading")]
    share = sum(c["trusted_hold"] for c in calm) / sum(c["trusted"] for c in calm)
    assert share == pytest.approx(0.95, abs=4 * math.sqrt(0.95 * 0.05 / sum(c["trusted"] for c in calm)))


def test_shares_are_those_of_the_counts(counts):
    rows = [{"robot": "r", "estimator": "e", "scenario": name} | count for name, count in counts.items()]
    table = alarm_table(pd.DataFrame(rows)).set_index("scenario")
    assert table.loc["unplugged", "noticed_percent"] == table.loc["unplugged", "named_right_percent"] == 100
    assert math.isnan(table.loc["none", "noticed_percent"])


def test_the_table_has_a_row_for_every_case(counts):
    options = {"estimators": ["levenberg_marquardt"], "scenarios": ["none", "stuck"], "trials": 1, "seed": 7}
    table = alarm_sums({"two_segments": 40.0}, **options)
    head = {"robot": "two_segments", "estimator": "levenberg_marquardt"}
    assert table.to_dict("records") == [head | {"scenario": x} | counts[x] for x in ("none", "stuck")]


def test_the_committed_table_belongs_to_the_settings_of_today():
    (study,) = STUDIES
    table, settings = read_study(study.name)
    assert settings == study.settings
    cases = product(settings["rates_hz"], settings["estimators"], settings["scenarios"])
    assert list(table[["robot", "estimator", "scenario"]].itertuples(index=False, name=None)) == list(cases)
    assert (table["trials"] == settings["trials"]).all()


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
