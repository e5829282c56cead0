"""What a live session says when readings stop, cannot be used or come too fast: over real ports, real signals."""

from __future__ import annotations

import os
import re
import signal
import socket
import subprocess
import sys
import threading
import time
from dataclasses import replace
from pathlib import Path

import pytest
from pty_board import Board

from edition1.errors import InputError
from edition1.estimation.consistency import Verdict
from edition1.robot_file.load import load_robot
from edition1_companion import cli_robot
from edition1_companion.cli_terminal import Screen
from edition1_live.emulate.links import HAS_PTY
from edition1_live.follow import live_text, session
from edition1_live.follow.live_state import LiveState, trusted
from edition1_live.follow.live_text import CAUSES
from edition1_live.follow.robot_estimator import RobotEstimator, robot_estimator
from edition1_live.follow.session import follow
from edition1_live.record.recording import read_recording
from edition1_live.wire.formats import encode
from edition1_live.wire.frame import Frame

ONE_SEGMENT = Path(__file__).parents[3] / "data" / "robots" / "one_segment.toml"

pytestmark = pytest.mark.skipif(not HAS_PTY, reason="no pseudo-terminals on this system")


@pytest.fixture(scope="module")
def estimator() -> RobotEstimator:
    made = robot_estimator(load_robot(ONE_SEGMENT))
    made.prepared()
    return made


class Session(threading.Thread):
    """A live session in a thread of its own, and the states it shows."""

    def __init__(self, board: Board, estimator: RobotEstimator, **options) -> None:
        super().__init__(daemon=True)
        self.board, self.estimator, self.options = board, estimator, options
        self.stop, self.states, self.said = threading.Event(), list[LiveState](), list[str]()
        self.sent, self.values = 0, tuple(estimator.robot.values(estimator.robot.start).tolist())
        self.end: LiveState | Exception | None = None
        self.start()
        board.opened()
        self.until(lambda state: True)

    def run(self) -> None:
        options = {"stop": self.stop, "show": self.states.append, "warn": self.said.append} | self.options
        try:
            self.end = follow(str(self.board.port), self.estimator, **options)
        except Exception as error:
            self.end = error

    def send(self, frames: int = 20) -> float:
        """Send readings at 50 Hz, or what a busy machine makes of it; return the rate."""
        began = time.monotonic()
        for _ in range(frames):
            assert self.is_alive(), self.end  # else nobody reads, and the line fills up
            self.board.send(encode("frames", Frame(0, self.sent, 20_000 * self.sent, self.values)))
            self.sent += 1
            time.sleep(0.02)
        return frames / (time.monotonic() - began)

    def until(self, true_of, seconds: float = 15.0) -> LiveState:
        """Wait for a state."""
        deadline = time.monotonic() + seconds
        while not (self.states and true_of(self.states[-1])):
            assert self.is_alive(), self.end
            assert time.monotonic() < deadline, self.states[-1:]
            time.sleep(0.01)
        return self.states[-1]

    def finish(self) -> LiveState:
        self.stop.set()
        self.join(10)
        assert isinstance(self.end, LiveState), self.end
        return self.end


def alerts(session: Session, state: LiveState) -> list[str]:
    return live_text.alerts(session.estimator, state)


def troubles(session: Session, state: LiveState) -> str:
    return " ".join(live_text.troubles(session.estimator, state))


def test_a_board_that_stops_is_told_in_seconds_and_leaves_a_gap(board, estimator):
    live = Session(board, estimator)
    live.send(40)
    before = live.until(lambda state: state.estimated == 40)
    assert trusted(before)
    assert live_text.pace(estimator, before).endswith(" estimates/s by levenberg_marquardt")
    silent = live.until(lambda state: state.age_s > 2.1)
    assert live_text.pace(estimator, silent) == "no readings for 2 s"
    assert not trusted(silent)
    assert live_text.mark(silent) == "2 s old"
    head, *rows = live_text.block(estimator, silent)
    assert ": no readings for 2 s; latency" in head
    assert rows[0].startswith("2 s old: delta_x_1 ")
    assert alerts(live, silent) == ["No readings: nothing arrives any more."]
    assert "Has the board stopped, or lost its power" in troubles(live, silent)
    live.sent += round(50 * silent.age_s)  # its clock went on
    rate_hz = live.send(80)
    after = live.until(lambda state: state.estimated == 120)
    assert trusted(after)
    assert alerts(live, after) == []
    assert before.since_s == silent.since_s == 0.0
    assert after.since_s > silent.time_s, "what is drawn begins anew after the gap"
    assert after.rate_hz == pytest.approx(rate_hz, rel=0.2), "the rate is that of now"
    assert after.rate_hz > 1.2 * after.estimated / after.seconds, "not the session's average"


def test_what_ends_in_silence_says_so_at_the_end(board, estimator):
    live = Session(board, estimator, duration_s=3.0)
    live.send(10)
    live.join(10)
    assert live.end.silent
    assert live_text.pace(estimator, live.end).startswith("no readings for ")
    assert live.end.seconds == pytest.approx(3.0)


def test_a_slow_board_is_not_silent(board, estimator):
    """Two readings per second, whatever the robot file says."""
    live = Session(board, estimator)
    for _ in range(9):
        live.send(1)
        live.sent += 24  # by its clock half a second
        time.sleep(0.48)
    state = live.until(lambda state: state.estimated == 9)
    late = [s for s in live.states if s.seconds > state.seconds - 2]
    assert all(map(trusted, late))
    assert all(s.since_s < s.time_s for s in late[-5:]), "the trace is drawn through"
    live.finish()


def test_a_board_that_never_speaks_gets_a_hint(board, estimator):
    live = Session(board, estimator)
    state = live.until(lambda state: state.silent)
    assert (state.arriving, state.estimate) == ("nothing", None)
    assert alerts(live, state) == ["No readings: nothing arrives."]
    assert live_text.mark(state) == "", "there is nothing that could be old"
    words = troubles(live, state)
    for hint in ("powered", "wired", "reset", "--baud", "format frames, as one_segment.toml says"):
        assert hint in words
    live.send(10)
    state = live.until(lambda state: state.estimated == 10)
    assert troubles(live, state) == ""
    live.finish()


def test_another_format_is_told_and_ends_nothing(board, estimator, tmp_path):
    live = Session(board, estimator, output=tmp_path / "r")
    line = encode("quaternions", Frame(0, None, None, (0.0, 0.6, 0.0, 0.8)))
    deadline = time.monotonic() + 10
    while not live.said and time.monotonic() < deadline:
        board.send(line * 20)
        time.sleep(0.1)
    assert live.said[0].startswith("Input format of repro live must be that of the board: ")
    assert 'frames are quaternions (format = "quaternions" in the robot file)' in live.said[0]
    board.send(line)
    state = live.until(lambda state: state.foreign)
    assert alerts(live, state) == ["Bytes arrive, but no frame of the format frames."]
    assert live.said[0] in troubles(live, state)
    live.send(10)
    state = live.until(lambda state: state.estimated >= 9)  # the first may end what went before
    assert (state.foreign, alerts(live, state)) == ("", [])
    assert live.finish().recorded.path == tmp_path / "r"
    assert len(read_recording(tmp_path / "r").frames) >= 9


def test_bytes_that_are_no_frames_any_more_are_told(board, estimator):
    live = Session(board, estimator)
    live.send(20)
    deadline = time.monotonic() + 10
    while not live.states[-1].silent and time.monotonic() < deadline:
        board.send(b"rst:0x1 (POWERON_RESET)\r\n")
        time.sleep(0.1)
    state = live.until(lambda state: state.arriving == "bytes")
    assert alerts(live, state) == ["Bytes arrive, but no frame of the format frames."]
    assert "Is the board's rate that of --baud, and does it send frames?" in troubles(live, state)
    live.finish()


def test_a_port_that_goes_and_comes_back_is_told_and_the_recording_goes_on(board, estimator, tmp_path):
    live = Session(board, estimator, output=tmp_path / "r")
    live.send(10)
    live.until(lambda state: state.estimated == 10)
    board.unplug()
    state = live.until(lambda state: state.silent)
    assert alerts(live, state) == ["The port is gone; waiting for it to come back."]
    assert len(live_text.troubles(estimator, state)) == 1
    board.plug_in()
    live.until(lambda state: state.arriving == "nothing")
    board.opened()
    live.send(10)
    state = live.until(lambda state: state.estimated == 20)
    assert alerts(live, state) == []
    assert [text.split(" (")[0] for text in live.said] == [f"{board.port} is gone", f"{board.port} is back."]
    live.finish()
    assert len(read_recording(tmp_path / "r").frames) == 20


def test_frames_that_none_can_use_are_told(board, estimator):
    live = Session(board, estimator)
    live.values = (1.0, 2.0, 3.0, 4.0)
    while not (live.states[-1].silent and live.states[-1].refused):
        live.send(5)
    state = live.states[-1]
    assert live_text.pace(estimator, state).startswith("no usable readings for ")
    assert alerts(live, state) == ["Frames arrive, but none of them can be used."]
    assert "of 3 channels, as described in one_segment.toml; instead received 4 values." in troubles(
        live, state
    )
    live.finish()


def test_an_overload_is_over_when_it_is(board, estimator, monkeypatch):
    step, slow = session.Follower.step, threading.Event()

    def slowly(self, one):
        time.sleep(0.1 * slow.is_set())
        return step(self, one)

    monkeypatch.setattr(session.Follower, "step", slowly)
    live = Session(board, estimator)
    slow.set()
    while not live.states[-1].dropped:
        live.send(5)
    state = live.until(lambda state: state.dropped)
    assert alerts(live, state) == ["Overload: the estimator is too slow, time steps are left out."]
    slow.clear()
    while live.states[-1].dropped_now:
        live.send(5)
    state = live.states[-1]
    assert alerts(live, state) == []
    assert troubles(live, state) == (
        f"{state.dropped} time steps were not estimated, in an overload that is over; nothing is recorded."
    )
    live.finish()


def test_words_of_silence_with_frames_tell_why(estimator, board):
    live = Session(board, estimator)
    state = replace(live.finish(), silent=True, arriving="frames", age_s=5.0)
    assert live_text.silence(estimator, state) == "Frames arrive, but the estimator is done with none."
    state = replace(state, other_streams={5: 3})
    assert live_text.silence(estimator, state) == "Frames arrive, but none of a stream of one_segment.toml."
    assert live_text.silence(estimator, replace(state, silent=False)) == ""


def test_a_missing_port_is_told_before_the_estimator_is_compiled(estimator, monkeypatch, tmp_path):
    def compiled(self):
        raise AssertionError("compiled first")

    monkeypatch.setattr(RobotEstimator, "prepared", compiled)
    with pytest.raises(
        InputError, match="^Input port of repro live must be one that is there .*/none, which is"
    ):
        follow(str(tmp_path / "none"), estimator)
    (tmp_path / "taken").touch()
    with pytest.raises(InputError, match="^Input output of repro live must be a new file"):
        follow(str(tmp_path / "none"), estimator, output=tmp_path / "taken")


def test_the_page_quotes_what_is_said(estimator, board):
    good = Session(board, estimator)
    good.send(10)
    state = good.finish()
    refused = "Input frame of the stream must be of 3 channels, as described in one_segment.toml; instead received 4"
    cases = [
        {"silent": True, "age_s": 6.0, "arriving": "nothing"},
        {
            "silent": True,
            "age_s": 6.0,
            "arriving": "nothing",
            "recorded": replace(state.recorded, counters={}),
        },
        {"silent": True, "age_s": 6.0, "arriving": "bytes"},
        {"silent": True, "age_s": 6.0, "arriving": "no port"},
        {"refused": 3, "refusal": refused},
        {"dropped": 3, "dropped_now": True},
        {"dropped": 3},
        {"missing": (0, 3, 0), "missing_now": (False, True, False)},
        {"verdict": Verdict(2, True, 42.0, "sensors", (2,))},
        {"verdict": Verdict(2, True, 42.0, "sensors", (2, 0))},
        *({"verdict": Verdict(2, True, 42.0, cause)} for cause in CAUSES if cause),
    ]
    said = "\n".join(" | ".join(live_text.block(estimator, replace(state, **case))) for case in cases)
    said = said.replace("or sensor 1", "or sensor 5")  # the robot of the page has more sensors
    page = (ONE_SEGMENT.parents[2] / "book" / "own_robot.md").read_text()
    tables = [part.split("\n\n")[0] for part in page.split("| it says |")[1:]]
    quoted = [
        words
        for row in "\n".join(tables).splitlines()
        if row.startswith("| `")
        for words in re.findall("`(.*?)`", row.split("|")[1])
    ]
    assert len(quoted) == 18
    for words in quoted:
        assert re.search(".*".join(map(re.escape, words.split("…"))), said), words


def test_on_a_narrow_terminal_everything_can_be_read(board, estimator, monkeypatch):
    live = Session(board, estimator)
    state = live.until(lambda state: state.silent)
    live.finish()
    master, slave = os.openpty()
    monkeypatch.setenv("COLUMNS", "40")
    with os.fdopen(slave, "w") as terminal:
        monkeypatch.setattr(sys, "stderr", terminal)
        screen = Screen(lambda state: live_text.block(estimator, state))
        screen._shown -= 1
        screen.show(state)
        lines = os.read(master, 65536).decode().splitlines()
    os.close(master)
    assert max(map(len, lines)) < 40
    assert " ".join(live_text.block(estimator, state)).split() == " ".join(lines).split()


# -- the commands


def command(*arguments: object) -> list[str]:
    return [sys.executable, "-m", "edition1_companion.cli", *map(str, arguments)]


def on_a_terminal(arguments: list[str]) -> tuple[subprocess.Popen, int, list[bytes]]:
    """Start a command as the first of a terminal, which is hung up when the returned end is closed; and its words."""
    import fcntl
    import termios

    master, slave = os.openpty()

    def lead() -> None:
        os.setsid()
        fcntl.ioctl(slave, termios.TIOCSCTTY, 0)
        signal.signal(signal.SIGHUP, signal.SIG_DFL)  # ignored where these tests are started by nohup

    process = subprocess.Popen(arguments, stdin=slave, stdout=slave, stderr=slave, preexec_fn=lead)
    os.close(slave)
    said: list[bytes] = []
    threading.Thread(target=listen, args=(master, said), daemon=True).start()
    return process, master, said


def listen(master: int, said: list[bytes]) -> None:
    try:
        while part := os.read(master, 4096):
            said.append(part)
    except OSError:  # it was closed
        pass


@pytest.mark.parametrize("name", ["record", "live"])
def test_a_terminal_that_is_closed_leaves_a_complete_recording(board, estimator, tmp_path, name):
    output = tmp_path / "a.rec"
    options = ["--robot", ONE_SEGMENT] if name == "live" else ["--format", "frames"]
    process, terminal, said = on_a_terminal(command(name, board.port, *options, "-o", output))
    values = tuple(estimator.robot.values(estimator.robot.start).tolist())
    deadline, sent = time.monotonic() + 120, 0
    try:
        while not (output.exists() and sent > 100):
            assert process.poll() is None, b"".join(said)
            assert time.monotonic() < deadline, b"".join(said)
            board.send(encode("frames", Frame(0, sent, 20_000 * sent, values)))
            sent += output.exists()
            time.sleep(0.005)
        os.close(terminal)
        process.wait(20)
    finally:
        process.kill()
        process.wait()
    recording = read_recording(output)
    assert recording.metadata["ended"] == "stopped"
    assert len(recording.frames) == recording.metadata["counters"]["frames"] >= 100
    assert recording.torn_bytes == 0


def test_nohup_is_heeded(board, tmp_path):
    output = tmp_path / "a.rec"
    process = subprocess.Popen(
        command("record", board.port, "-o", output),
        stderr=subprocess.DEVNULL,
        preexec_fn=lambda: signal.signal(signal.SIGHUP, signal.SIG_IGN),
    )
    deadline, sent = time.monotonic() + 60, 0
    while not output.exists() and time.monotonic() < deadline:
        board.send(encode("frames", Frame(0, sent, sent, (1.0,))))
        sent += 1
        time.sleep(0.02)
    process.send_signal(signal.SIGHUP)
    time.sleep(0.5)
    assert process.poll() is None
    process.terminate()
    assert process.wait(20) == 0
    assert read_recording(output).metadata["ended"] == "stopped"


def test_the_page_gets_the_port_that_is_asked_for(board):
    with socket.create_server(("127.0.0.1", 0)) as taken:
        number = taken.getsockname()[1]
    with pytest.raises(InputError) as error:
        cli_robot.live(str(board.port), robot=ONE_SEGMENT, browser_socket=number)
    assert str(error.value) == (
        f"Input browser_socket of repro live must be left out without --browser; instead received {number}."
    )
    options = ("--robot", ONE_SEGMENT, "--browser", "--browser-socket", number, "--duration", "0.5")
    done = subprocess.run(
        command("live", board.port, *options), capture_output=True, text=True, timeout=120, check=False
    )
    assert done.stdout == f"Open http://127.0.0.1:{number}/ in a browser.\n"
    assert done.returncode == 1, "no frame came"
