"""From a port to a file: real pseudo-terminals, a real process, real signals."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import numpy as np
import pytest
from pty_board import Board

from edition1.errors import InputError
from edition1_companion.recordings.baaij2023 import read_readings as read_rig
from edition1_live.record.export import export
from edition1_live.record.recorder import record
from edition1_live.record.recording import Recording, read_recording
from edition1_live.record.recording_file import sidecar_path
from edition1_live.wire.formats import encode
from edition1_live.wire.frame import Frame
from repro_companion.papers.mitchell import MODEL_FROM_FILE, read_hall

pytestmark = pytest.mark.skipif(os.name != "posix", reason="pseudo-terminals")
COMMANDS = """
import sys
from cyclopts import App
from edition1_companion.cli_live import export, record
from edition1.errors import InputError
app = App(); app.command(record); app.command(export)
try:
    sys.exit(app(exit_on_error=False, print_error=False, result_action="return_value"))
except InputError as error:
    print(f"repro: {error}", file=sys.stderr); sys.exit(2)
"""


class Recorder(threading.Thread):
    """`record` in a thread; `finish` stops it and returns what it returned, or raises what it raised."""

    def __init__(self, board: Board, format: str, output: Path, **options) -> None:
        super().__init__()
        self.said, self.shown, self.result = [], [], None
        self.over = threading.Event()
        self.options = {"stop": self.over, "show": self.shown.append, "warn": self.said.append} | options
        self.arguments = (str(board.port), format, output)
        self.start()
        board.opened()

    def run(self) -> None:
        try:
            self.result = record(*self.arguments, **self.options)
        except Exception as error:
            self.result = error

    def finish(self):
        time.sleep(0.4)
        self.over.set()
        self.join(10)
        assert not self.is_alive()
        if isinstance(self.result, Exception):
            raise self.result
        return self.result


def frames(first: int, n: int) -> list[Frame]:
    return [Frame(0, k, 10_000 * k, (float(k), 0.5, -2.0)) for k in range(first, first + n)]


def coded(part: list[Frame], format: str = "frames") -> bytes:
    return b"".join(encode(format, frame) for frame in part)


def recorded(board: Board, format: str, data: bytes, path: Path) -> Recording:
    recorder = Recorder(board, format, path)
    board.send(data)
    recorder.finish()
    return read_recording(path)


def test_every_frame_is_recorded_with_its_metadata(board, tmp_path):
    recorder = Recorder(board, "frames", tmp_path / "a.rec")
    for first in range(0, 2000, 100):
        board.send(coded(frames(first, 100)))
    time.sleep(1.2)
    summary = recorder.finish()
    recording = read_recording(tmp_path / "a.rec")
    assert [frame for _, frame in recording.as_frames()] == frames(0, 2000)
    assert summary.counters["frames"] == 2000
    assert str(summary).endswith("bytes")
    assert recorder.shown[-1].counters["frames"] == 2000
    assert recorder.said == []
    metadata = json.loads(sidecar_path(tmp_path / "a.rec").read_text())
    assert recording.metadata == metadata
    assert metadata["counters"] == summary.counters
    assert metadata["ended"] == "stopped"
    assert metadata["format"] == "frames"
    assert metadata["channels"] == ["u1", "u2", "u3"] == recording.channels
    assert abs(metadata["start_unix_s"] - time.time()) < 60
    assert metadata["clock"]["span_s"] == pytest.approx(19.99, abs=1.1)


def test_what_is_cut_off_by_opening_is_counted_not_recorded(board, tmp_path):
    recording = recorded(board, "hall", b"34,5\r\n1,2,3\r\n4,5,6\r\n7,x,9\r\n", tmp_path / "a.rec")
    assert recording.frames[recording.channels].to_numpy().tolist() == [[1, 2, 3], [4, 5, 6]]
    counters = recording.metadata["counters"]
    assert (counters["frames"], counters["first_partial"], counters["malformed"]) == (2, 1, 1)
    assert recording.metadata["clock"] is None
    assert recording.frames["device_us"].isna().all()


def test_a_port_that_comes_back_is_recorded_on(board, tmp_path):
    recorder = Recorder(board, "frames", tmp_path / "a.rec")
    board.send(coded(frames(0, 10)) + coded(frames(10, 1))[:9])
    time.sleep(0.3)
    board.unplug()
    time.sleep(0.5)
    board.plug_in()
    board.opened()
    board.send(coded(frames(13, 10)))
    summary = recorder.finish()
    recording = read_recording(tmp_path / "a.rec")
    assert [frame for _, frame in recording.as_frames()] == frames(0, 10) + frames(13, 10)
    assert summary.counters["reconnects"] == 1
    assert summary.counters["gaps"] == 3
    assert [note["event"] for note in recording.notes] == ["lost", "reopened"]
    assert "is gone" in recorder.said[0]
    assert recorder.said[1].endswith("is back.")


def test_another_format_is_recognised(board, tmp_path):
    recorder = Recorder(board, "frames", tmp_path / "a.rec")
    line = coded([Frame(k % 4, None, None, (0.0, 0.6, 0.0, 0.8)) for k in range(20)], "quaternions")
    for _ in range(25):
        board.send(line)
        time.sleep(0.1)
    with pytest.raises(
        InputError, match=r"Input format of repro record .*frames are quaternions \(--format quater"
    ):
        recorder.finish()
    assert not (tmp_path / "a.rec").exists()
    assert not sidecar_path(tmp_path / "a.rec").exists()


def misread(data: bytes, ratio: int) -> bytes:
    """What a receiver makes of bytes sent ``ratio`` times as fast: 8 bits, no parity, one stop bit."""
    line = np.concatenate(
        [[0, *((byte >> k) & 1 for k in range(8)), 1] for byte in data] + [np.ones(20 * ratio, int)]
    )
    out, at = bytearray(), 0
    while at + 10 * ratio < len(line):
        if line[at]:
            at += 1
            continue
        bits = line[at + ratio // 2 + ratio * np.arange(1, 10)]
        out.append(int((bits[:8] << np.arange(8)).sum()))
        at += int(9.5 * ratio)
    return bytes(out)


@pytest.mark.parametrize("format", ["frames", "hall"])
def test_a_wrong_rate_is_noticed_within_two_seconds(board, tmp_path, format):
    """Bits of a board at 115200, received at 9600."""
    values = (12.0, -7.0, 2310.0)
    sent = coded([Frame(0, k, k, values) for k in range(3000)], format)
    garbage = misread(sent, 12)
    assert len(garbage) > 1000
    recorder = Recorder(board, format, tmp_path / "a.rec", baud=9600)
    start = time.monotonic()
    while recorder.is_alive() and time.monotonic() < start + 5:
        board.send(garbage[:60])
        garbage = garbage[60:] + garbage[:60]
        time.sleep(0.05)
    assert time.monotonic() - start < 3.5
    expected = (
        r"Input baud of repro record must be the rate of the board \(2 s of garbage.*received 9600, \d+ bytes"
    )
    with pytest.raises(InputError, match=expected):
        recorder.finish()
    assert not (tmp_path / "a.rec").exists()


def test_garbage_after_good_frames_only_warns(board, tmp_path):
    recorder = Recorder(board, "hall", tmp_path / "a.rec")
    board.send(b"1,2,3\r\n1,2,3\r\n4,5,6\r\n")
    time.sleep(0.3)
    board.unplug()
    board.plug_in()
    board.opened()
    for _ in range(40):
        time.sleep(0.1)
        board.send(bytes(range(128, 188)))
    recorder.finish()
    assert "2 s of garbage" in recorder.said[-1]
    assert len(read_recording(tmp_path / "a.rec").frames) == 2


def test_duration_ends_it_and_no_frame_leaves_no_file(board, tmp_path):
    summary = record(str(board.port), "frames", tmp_path / "a.rec", duration_s=0.3)
    assert 0.3 <= summary.seconds < 1.5
    assert summary.path is None
    assert not (tmp_path / "a.rec").exists()


def test_an_existing_file_is_refused_before_the_port_is_opened(tmp_path):
    (tmp_path / "a.rec").write_text("mine")
    with pytest.raises(InputError, match="output of repro record must be a new file"):
        record("/dev/ttyNone", "frames", tmp_path / "a.rec")
    with pytest.raises(InputError, match="duration of repro record must be a time above zero"):
        record("/dev/ttyNone", "frames", tmp_path / "b.rec", duration_s=0.0)


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_ends_the_command_cleanly(board, tmp_path, number):
    output = tmp_path / "a.rec"
    command = [
        sys.executable,
        "-c",
        COMMANDS,
        "record",
        str(board.port),
        "--format",
        "hall",
        "-o",
        str(output),
    ]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    deadline = time.monotonic() + 20
    while not output.exists() and time.monotonic() < deadline:
        board.send(b"1,2,3\r\n")
        time.sleep(0.02)
    process.send_signal(number)
    out, err = process.communicate(timeout=10)
    assert process.returncode == 0, err
    assert out == f"{output}\n"
    assert " frames (" in err
    recording = read_recording(output)
    assert (recording.metadata["ended"], recording.torn_bytes) == ("stopped", 0)
    assert len(recording.frames) == recording.metadata["counters"]["frames"] > 0


def test_two_recorders_with_one_output_whose_first_frames_come_together(tmp_path):
    for attempt in range(3):
        output, boards = tmp_path / f"{attempt}.rec", []
        for n in range(2):
            (folder := tmp_path / f"{attempt}-{n}").mkdir()
            boards.append(Board(folder))
            boards[n].plug_in()
        command = [sys.executable, "-c", COMMANDS, "record", "--format", "hall", "-o", str(output)]
        both = [
            subprocess.Popen([*command, str(board.port)], stdout=-1, stderr=-1, text=True) for board in boards
        ]
        deadline = time.monotonic() + 30
        for board in boards:
            board.opened()
        for k in range(20):
            for n, board in enumerate(boards):
                board.send(b"%d,%d,0\r\n" % (n, k))
            time.sleep(0.02)
        while all(process.poll() is None for process in both):
            assert time.monotonic() < deadline
            time.sleep(0.01)
        for process in both:
            if process.poll() is None:
                process.send_signal(signal.SIGINT)
        said = [process.communicate(timeout=20)[1] for process in both]
        codes = [process.returncode for process in both]
        assert sorted(codes) == [0, 2], said
        loser = codes.index(2)
        assert "Input output of RecordingFile must be a new file (give another name" in said[loser]
        recording = read_recording(output)
        assert set(recording.frames[recording.channels[0]]) == {1.0 - loser}
        assert recording.remarks == ()
        assert recording.metadata["port"] == str(boards[1 - loser].port)
        for board in boards:
            board.unplug()


def test_the_command_says_what_is_wrong(board, tmp_path):
    def repro(*arguments: str) -> subprocess.CompletedProcess[str]:
        command = [sys.executable, "-c", COMMANDS, *arguments]
        return subprocess.run(command, capture_output=True, text=True, check=False)

    assert repro("record", "--list").returncode == 0
    missing = repro("record", "/dev/ttyNone", "-o", str(tmp_path / "a.rec"))
    assert missing.returncode == 2
    assert missing.stderr.startswith("repro: Input port of repro record must be one that is there")
    silent = repro("record", str(board.port), "-o", str(tmp_path / "a.rec"), "--duration", "0.2")
    assert silent.returncode == 1
    assert silent.stderr.endswith("\nNo frame came; nothing was written.\n")


def test_a_pty_at_full_speed(board, tmp_path):
    """20,000 frames as fast as the terminal takes them, none lost."""
    n = 20_000
    data = coded([Frame(0, k, k, (1.0, 2.0, 3.0)) for k in range(n)])
    recorder = Recorder(board, "frames", tmp_path / "a.rec")
    board.send(data)
    summary = recorder.finish()
    assert summary.counters["frames"] == n
    sequence = read_recording(tmp_path / "a.rec").frames["sequence"].to_numpy(dtype=np.int64)
    np.testing.assert_array_equal(sequence, np.arange(n))


def test_millivolts_reach_their_loader(board, tmp_path):
    rng = np.random.default_rng(1)
    readings = np.round(rng.uniform(1, 2047, (40, 3)) * 16) / 16  # steps of the converter
    lines = coded([Frame(0, None, None, tuple(row)) for row in readings], "millivolts")
    recording = recorded(board, "millivolts", b"1.0\r\n" + lines, tmp_path / "a.rec")
    remarks = export(recording, tmp_path / "T_SV.csv", "millivolts")
    found, dropped = read_rig(tmp_path / "T_SV.csv")
    np.testing.assert_array_equal(found, readings)
    assert dropped == 0
    assert "the loader takes 40 Hz" in remarks[0]  # they came at once
    with pytest.raises(InputError, match="output of export must be a new file"):
        export(recording, tmp_path / "T_SV.csv", "millivolts")
    with pytest.raises(InputError, match="recording of export as hall must be of the format hall or frames"):
        export(recording, tmp_path / "hall.csv", "hall")


def test_hall_lines_reach_their_loader(board, tmp_path):
    path = tmp_path / "a.rec"
    recorder = Recorder(board, "hall", path)
    board.send(b"9\r\n")
    counts = np.random.default_rng(2).integers(-2000, 2000, (30, 3))
    for row in counts:
        board.send(b"%d,%d,%d\r\n" % tuple(row.tolist()))
        time.sleep(0.012)
    recorder.finish()
    recording = read_recording(path)
    export(recording, tmp_path / "hall.csv", "hall")
    take = read_hall(tmp_path / "hall.csv")
    kept = len(take.u)
    assert kept + take.facts["buffered"] == 30
    # Column 0, along the body, is the last field on the wire; one count is 0.01 mT.
    np.testing.assert_allclose(take.u @ MODEL_FROM_FILE, counts[-kept:, ::-1] * 0.01, atol=1e-12)
    unix_s = recording.metadata["start_unix_s"] + recording.frames["time_s"].to_numpy()[-kept:]
    np.testing.assert_allclose(take.time_s, unix_s, atol=1e-6)


def test_frames_are_exported_only_as_what_they_are_said_to_be(board, tmp_path):
    recording = recorded(board, "frames", coded(frames(1, 5)), tmp_path / "a.rec")
    with pytest.raises(InputError, match="schema of export must be one of hall, millivolts, quaternions, or"):
        export(recording, tmp_path / "a.csv", "frames")
    with pytest.raises(
        InputError, match="as quaternions must be frames of 4 values each; instead received .3.[.]$"
    ):
        export(recording, tmp_path / "a.bag", "quaternions")
    export(recording, tmp_path / "a.csv", "millivolts")
    head, first, *_ = (tmp_path / "a.csv").read_text().splitlines()
    assert head == "u1,u2,u3,time_s"
    assert first == f"1.0,0.5,-2.0,{float(recording.frames['time_s'][0])!r}"
