"""Lines of sketches and wrong formats at a real pseudo-terminal: recorded with their names, or refused in words."""

from __future__ import annotations

import json
import subprocess
import sys
import threading
import time
from dataclasses import replace

import numpy as np
import pytest
from test_recorder import COMMANDS, Recorder, coded, frames, recorded

from edition1.errors import InputError
from edition1_companion.twins.played import played
from edition1_companion.twins.takes import open_take
from edition1_live.emulate.board import passages
from edition1_live.follow.robot_estimator import robot_estimator
from edition1_live.follow.session import follow
from edition1_live.record.recording import read_recording
from edition1_live.record.recording_file import sidecar_path
from edition1_live.record.summary import Suspect
from edition1_live.robot.calibration_poses import Poses, recorded_readings
from edition1_live.wire.csv_text import CsvParser

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="pseudo-terminals")


def test_lines_with_labels_are_recorded_with_their_names_units_and_times(board, tmp_path):
    lines = "".join(f"t: {10 * k} ms, X: {k}.5 uT, Y: -{k} uT\r\n" for k in range(50))
    recorder = Recorder(board, "csv", tmp_path / "a.rec")
    board.send(b"-3 uT\r\n" + lines.encode())
    recorder.finish()
    recording = read_recording(tmp_path / "a.rec")
    assert recording.channels == ["X_uT", "Y_uT"]
    assert recording.metadata["units"] == ["uT", "uT"]
    np.testing.assert_array_equal(recording.frames["X_uT"], np.arange(50) + 0.5)
    np.testing.assert_array_equal(
        recording.frames["device_us"].to_numpy(dtype=np.int64), 10_000 * np.arange(50)
    )
    assert recorder.said == ["The lines have 2 values a line, separated by commas: X_uT, Y_uT; times in t."]
    sidecar_path(tmp_path / "a.rec").unlink()
    assert read_recording(tmp_path / "a.rec").channels == ["X_uT", "Y_uT"]


def test_another_unit_than_expected_ends_it_before_anything_is_written(board, tmp_path):
    recorder = Recorder(board, "csv", tmp_path / "a.rec", unit="mT")
    board.send(b"\n" + 5 * b"X: 1.5 uT\r\n")
    with pytest.raises(InputError, match="unit of the robot file must be uT, as the lines say of X_uT"):
        recorder.finish()
    assert not (tmp_path / "a.rec").exists()


def test_recordings_of_lines_go_into_a_calibration(board, tmp_path, one_segment):
    recording = recorded(board, "csv", b"\n" + 20 * b"x=1,y=2,z=3\r\n", tmp_path / "a.rec")
    poses = Poses(one_segment.start[None], np.array([[0.0, 60.0]]), ("straight",))
    found = recorded_readings(recording, one_segment, poses)
    assert found.values.tolist() == [[1.0, 2.0, 3.0]]
    recording.metadata["units"] = ["uT"] * 3
    with pytest.raises(InputError, match="unit of the robot file must be uT, as the lines say of x"):
        recorded_readings(recording, one_segment, poses)


def test_a_sketch_is_followed_live_and_played_again(board, patient, tmp_path, one_segment):
    """Labels, units and times of the sketch's own; then its recording as a board that sends the same numbers."""
    sent = played(replace(one_segment, format="frames"), rate_hz=50.0, seconds=2.0, seed=1)
    over, found, said = threading.Event(), [], []
    estimator = robot_estimator(one_segment)
    options = {"output": tmp_path / "a.rec", "stop": over, "each": found.append, "warn": said.append}
    thread = threading.Thread(target=lambda: said.append(follow(str(board.port), estimator, **options)))
    estimator.prepared()
    thread.start()
    board.opened()
    rows, deadline = sent.take.values.tolist(), time.monotonic() + 60
    board.send(b"\n")
    for k, row in enumerate(rows):
        text = ", ".join(f"{name}: {x!r} mT" for name, x in zip("XYZ", row, strict=True))
        board.send(f"millis: {20 * k}, {text}\r\n".encode())
        time.sleep(0.005)
    while len(found) < 100 and time.monotonic() < deadline:
        time.sleep(0.05)
    over.set()
    thread.join(30)
    assert (
        said[0] == "The lines have 3 values a line, separated by commas: X_mT, Y_mT, Z_mT; times in millis."
    )
    times = np.array([e.step.time_s for e in found])
    np.testing.assert_allclose(times, 0.02 * np.arange(100), atol=1e-9)
    errors = [float((e.estimate.q - q).abs().max()) for e, q in zip(found, sent.q, strict=True)]
    assert np.median(errors) < 3e-4
    take = open_take(str(tmp_path / "a.rec"))
    assert take.format == "csv"
    np.testing.assert_array_equal(take.values, sent.take.values)
    [passage] = passages(take.readings(), "csv")
    reader = CsvParser()
    np.testing.assert_array_equal([f.values for f in reader.feed(b"\n" + passage.data)], sent.take.values)


@pytest.fixture
def one_segment(tmp_path):
    from pathlib import Path

    from edition1.robot_file.load import load_robot

    text = (Path(__file__).parents[3] / "data" / "robots" / "one_segment.toml").read_text()
    (tmp_path / "robot.toml").write_text(text.replace('format = "frames"', 'format = "csv"'))
    return load_robot(tmp_path / "robot.toml")


# ---- formats, channels and rates that do not fit ----


def verdict(format: str, data: bytes, channels=None) -> str:
    suspect = Suspect(format, channels)
    suspect.add(data)
    return str(suspect.verdict("board", 115200))


def test_a_format_is_recommended_only_if_nearly_all_lines_fit():
    signed = b"".join(b"%d.5,%d.25,1.0\r\n" % (k % 8 - 2, k) for k in range(180))
    said = verdict("frames", signed)
    assert "179 of 179 frames are csv (--format csv)" in said
    assert "the first '-1.5,1.25,1.0'" in said
    positive = signed.replace(b"-", b"")
    assert (
        "179 of 179 frames are millivolts (--format millivolts), or other numbers (--format csv)"
        in verdict("frames", positive)
    )
    few = b"".join(b"1,2,3\r\n" if k % 4 == 0 else b"<%d>\r\n" % k for k in range(100))
    said = verdict("frames", few)
    assert "text that fits none of frames, hall, millivolts, quaternions, csv" in said
    assert "--format" not in said
    assert "the first 31 2c 00" in verdict("hall", 100 * b"1,\x00\xff\n")
    assert "text that fits none of" in verdict("csv", 100 * b"1,2\r"), "lines that do not end"


def test_another_number_of_values_is_said_so():
    five = coded([f._replace(values=(1.0,) * 5) for f in frames(0, 179)])
    assert verdict("frames", five, 3).startswith(
        "Input channels of repro record must be 5 (frames of 5 values arrived, 3 were expected); instead received 3"
    )
    assert "must be 2 (lines of 2 values arrived, 3 were expected)" in verdict("csv", 50 * b"1.5,-2\r\n", 3)
    assert "must be 4 (lines of 4 values arrived, 3 were expected)" in verdict(
        "millivolts", 50 * b"1,2,3,4\r\n", 3
    )


def test_lines_that_no_format_takes_are_shown_with_the_reason(board, tmp_path):
    recorder = Recorder(board, "csv", tmp_path / "a.rec")
    for _ in range(25):
        board.send(5 * b"1,5;2,5\r\n")
        time.sleep(0.1)
    with pytest.raises(
        InputError, match=r"fits none of .* \('1,5' is no number with a decimal point\).*'1,5;2,5'"
    ):
        recorder.finish()


# ---- nothing is dropped without a word ----


def command(board, data: bytes, *arguments: str, seconds: float = 2.0) -> subprocess.CompletedProcess[str]:
    """Run `repro record` over a port that sends data once."""
    process = subprocess.Popen(
        [sys.executable, "-c", COMMANDS, "record", str(board.port), "--duration", f"{seconds}", *arguments],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    board.opened()
    for at in range(0, len(data), 500):
        board.send(data[at : at + 500])
        time.sleep(0.01)
    out, err = process.communicate(timeout=60)
    return subprocess.CompletedProcess([], process.returncode, out, err)


def test_signed_values_as_millivolts_do_not_vanish_silently(board, tmp_path):
    path = tmp_path / "a.rec"
    lines = b"\n" + b"".join(b"%d.5,2.0,1.0\r\n" % (-k if k % 4 else k + 1) for k in range(363))
    done = command(board, lines, "--format", "millivolts", "-o", str(path), seconds=4.0)
    assert done.returncode == 1, done.stderr
    assert "272 of 363 lines or frames were dropped (272 malformed); the first: '-1.5,2.0,1.0" in done.stderr
    assert len(read_recording(path).frames) == 91, "the file is kept"


def test_a_few_lines_that_were_dropped_are_said(board, tmp_path):
    path = tmp_path / "a.rec"
    lines = b"\n" + 50 * b"1,2,3\r\n" + b"ready\r\n" + 50 * b"1,2,3\r\n"
    done = command(board, lines, "--format", "csv", "-o", str(path), seconds=4.0)
    assert done.returncode == 0, done.stderr
    assert "1 of 101 lines or frames were dropped (1 malformed); the first: 'ready'" in done.stderr
    assert json.loads(sidecar_path(path).read_text())["counters"]["malformed"] == 1


def test_most_of_it_dropped_is_said_while_it_is_recorded(board, tmp_path):
    recorder = Recorder(board, "millivolts", tmp_path / "a.rec")
    board.send(b"\n" + 5 * b"1,2,3\r\n" + 30 * b"-1,2,3\r\n")
    time.sleep(1.2)
    recorder.finish()
    assert recorder.said == [
        "Most of what arrives is not millivolts: 30 of 35 lines or frames were dropped (30 malformed); "
        "the first: '-1,2,3'."
    ]
