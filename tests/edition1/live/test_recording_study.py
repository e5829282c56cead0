"""What the recording page says: no fault makes a frame of ours wrong, a flipped digit makes a line wrong."""

from dataclasses import replace
from itertools import islice

import numpy as np
import pytest

from edition1_companion.pages.recording.study import CASES, TOGETHER, formats_table, trace_tables
from edition1_companion.twins.recorded_run import matched, play_and_record
from edition1_companion.twins.takes import open_take
from edition1_live.emulate.board import passages
from edition1_live.emulate.faults import Faults
from edition1_live.emulate.links import HAS_PTY
from edition1_live.wire.frame import Frame

READINGS = 1500
OFTEN = {"disconnects": 4e-3, "reboots": 4e-3}
PORTS = ["socket", *(["pty"] if HAS_PTY else [])]


@pytest.fixture(scope="module")
def take():
    return open_take("lemniscate", rate_hz=1000.0)


@pytest.mark.parametrize("port", PORTS)
def test_all_faults_together_cost_nothing_that_was_intact(take, port):
    faults = replace(TOGETHER, **OFTEN)
    run = play_and_record(take, faults, readings=READINGS, seed=1, port=port)
    found = run.matches()
    intact = np.concatenate([passage.intact for passage in run.sent])
    assert (found >= 0).all()
    assert set(np.flatnonzero(intact)) <= set(found)
    assert (np.diff(found) > 0).all()
    assert run.counters["reconnects"] == run.sent[-1].connection > 0
    assert run.counters["received_bytes"] == sum(len(passage.data) for passage in run.sent)
    # the same through any port: what the results of the page rest on
    expected = list(passages(islice(take.readings(), READINGS), "frames", faults, seed=1))
    assert [passage.data for passage in run.sent] == [passage.data for passage in expected]


@pytest.mark.parametrize(
    ("fault", "counted"),
    [
        ("none", {}),
        ("stalls", {}),
        ("flips", {"checksum_errors", "gaps", "discarded_bytes"}),
        ("disconnects", {"gaps", "reconnects", "first_partial", "discarded_bytes"}),
        ("reboots", {"restarts", "checksum_errors", "discarded_bytes"}),
    ],
)
def test_each_fault_has_its_counters(take, fault, counted):
    faults = replace(CASES[fault], **{fault: OFTEN[fault]}) if fault in OFTEN else CASES[fault]
    run = play_and_record(take, faults, readings=READINGS, seed=3, port="socket")
    counters = {
        name: value for name, value in run.counters.items() if name not in ("frames", "received_bytes")
    }
    assert {name for name, value in counters.items() if value} == set(counted)
    sequence = run.recording.frames["sequence"].to_numpy(np.int64)
    if fault in ("flips", "disconnects"):
        assert run.counters["gaps"] == sequence[-1] - sequence[0] + 1 - len(sequence)
    if fault == "disconnects":
        assert run.counters["first_partial"] == run.counters["reconnects"]


def test_flips_make_lines_wrong_but_no_frame_of_ours():
    errors, series = formats_table(readings=1200, seed=2, flips=2e-3)
    table = errors.set_index("format")
    assert (table["intact_lost"] == 0).all()
    assert table.loc["frames", "wrong"] == 0
    assert (table.drop("frames")["wrong"] > 0).all()
    assert (table["accepted"] < table["sent"]).all()
    assert series.groupby("format")["wrong"].sum().to_dict() == {
        "frames": 0,
        "millivolts": table.loc["millivolts", "wrong"],
    }


def test_an_accepted_frame_is_looked_for_where_it_can_be():
    a, b, other = (Frame(0, None, None, (x,)) for x in (1.0, 2.0, 3.0))
    # the second of two equal frames was intact; a wrong one in between does not move the rest
    assert matched([a, other, b], [a, a, b], [False, True, True]).tolist() == [1, -1, 2]
    # a damaged one may read the same
    assert matched([a, b], [a, other, b], [False, False, True]).tolist() == [0, 2]
    # an intact one that is missing shows
    assert matched([b], [a, b], [True, True]).tolist() == [-1]


def test_counters_over_time_end_at_those_of_the_recorder():
    recorded, counters = trace_tables(readings=1000, seed=1, disconnects=4e-3, reboots=4e-3)
    assert recorded["time_s"].notna().all()
    assert (np.diff(recorded["time_s"]) > 0).all()
    assert (counters.diff().iloc[1:].min() >= 0).all()
    last = counters.iloc[-1]
    assert last["frames"] == len(recorded)
    assert last["reconnects"] > 0
    assert last["restarts"] == (np.diff(recorded["device_s"]) < 0).sum() > 0


def test_a_drifting_clock_is_recorded_as_it_came():
    fast = Faults(drift_ppm=1000.0)
    run = play_and_record(open_take("lemniscate", rate_hz=100.0), fast, readings=300, seed=0, port="socket")
    device_us = run.recording.frames["device_us"].to_numpy(np.int64)
    np.testing.assert_array_equal(device_us, np.round(np.arange(300) * 10_010.0))
