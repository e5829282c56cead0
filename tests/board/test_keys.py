"""Keys in a terminal while a port is read. The terminal and the board's line are real: two pseudo-terminals."""

from __future__ import annotations

import contextlib
import os
import re
import resource
import signal
import sys
import termios
import threading
import time
import traceback
from collections.abc import Callable
from types import SimpleNamespace

import pytest

import repro
from repro_board import live, session
from repro_board.cli import main
from repro_board.keys import Keys
from repro_board.record import MOST_LETTERS, Writer, read_recording
from repro_board.session import LET_GO, Follower, open_port
from repro_board.wire import encode
from tests.board.test_record import Board, struct_heads
from tests.board.waiting import LONGEST_S, Clock, until

HINT = "Keys: n writes a note into the recording, u lets go of the port for 30 s, to upload firmware, Ctrl-C ends."
COUNTDOWN = "u takes the port back at once ("


class Program:
    """A command in a process whose standard input, output and error are a terminal of its own."""

    def __init__(self, words: list[str], before: Callable[[], object] = lambda: None) -> None:
        self.keys, self.terminal = os.openpty()
        self.as_it_was, self.shown, self.before = termios.tcgetattr(self.terminal), "", 0
        self.pid = os.fork()
        if not self.pid:
            self._run(words, before)
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()

    def _run(self, words: list[str], before: Callable[[], object]) -> None:
        status = 99
        try:
            os.login_tty(self.terminal)
            sys.stdin, sys.stdout, sys.stderr = (os.fdopen(k, mode) for k, mode in enumerate("rww"))
            os.environ |= {"TERM": "xterm", "COLUMNS": "200"}
            before()
            status = main(words)
        except BaseException:
            traceback.print_exc()
        finally:
            sys.stdout.flush()
            os._exit(status)

    def _read(self) -> None:
        with contextlib.suppress(OSError):
            while data := os.read(self.keys, 4096):
                self.shown += data.decode()

    def press(self, keys: str) -> None:
        self.before = len(self.shown)
        os.write(self.keys, keys.encode())

    def shows(self, text: str) -> None:
        """Wait until a text is shown that was not before the last keys."""
        until(lambda: text in self.shown[self.before :])

    def counts_down(self) -> None:
        """Wait until two times are shown for which the port is still let go of, neither of them long."""
        times = lambda: [int(x) for x in re.findall(f"{re.escape(COUNTDOWN)}(\\d+) s left", self.shown)]  # noqa: E731
        until(lambda: 0 < min(times(), default=0) < max(times()) <= 30)

    def at_once(self) -> bool:
        """Whether keys are read one by one and unseen."""
        return not termios.tcgetattr(self.terminal)[3] & (termios.ICANON | termios.ECHO)

    def ended(self) -> int:
        """Wait for the end, and return the status; the terminal must be as it was."""
        until(lambda: os.waitid(os.P_PID, self.pid, os.WEXITED | os.WNOHANG | os.WNOWAIT) is not None)
        status = os.waitstatus_to_exitcode(os.waitpid(self.pid, 0)[1])
        self.pid = 0
        assert termios.tcgetattr(self.terminal) == self.as_it_was
        return status

    def close(self) -> None:
        if self.pid:
            os.kill(self.pid, signal.SIGKILL)
            os.waitpid(self.pid, 0)
        os.close(self.terminal)
        self._reader.join(LONGEST_S)
        os.close(self.keys)


@pytest.fixture
def board(tmp_path):
    """A board that sends a frame every 10 ms, for as long as somebody listens."""
    board, over = Board(tmp_path), threading.Event()
    os.set_blocking(board.board, False)

    def send() -> None:
        k, began = 0, time.monotonic()
        while not over.wait(0.01):
            with contextlib.suppress(BlockingIOError):
                board.send(encode([k + 0.5], sequence=k, time_us=round(1e6 * (time.monotonic() - began))))
            k += 1

    thread = threading.Thread(target=send)
    thread.start()
    yield board
    over.set()
    thread.join(LONGEST_S)
    board.unplug()


@pytest.fixture
def started():
    """A function that starts a command in a terminal."""
    with contextlib.ExitStack() as programs:
        yield lambda *given: programs.enter_context(contextlib.closing(Program(*given)))


def recorder(board, tmp_path, *more: str) -> list[str]:
    return ["record", str(board.port), "-o", str(tmp_path / "a.rec"), *more]


def test_notes_are_written_with_the_time_of_their_first_key(board, tmp_path, started):
    program = started(recorder(board, tmp_path))
    program.shows(HINT)
    assert program.at_once()
    before = time.time()
    program.press("n")
    program.shows("Note: _")
    after = time.time()
    time.sleep(0.5)  # the time of a note is when it was begun
    program.press("lox\x08s\x7fad \x1b[A\x1b[1;5Con, müde\r")
    program.shows("Noted: load on, müde")
    for keys in ("nno such thing\x1b", "n  \r", "npasted\nu unload\r"):
        program.press(keys)
        program.shows(HINT)
    program.press("n" + (MOST_LETTERS + 50) * "x")
    program.shows("Enter keeps it, Esc drops it. 0 letters are left.")
    program.press("\x03")
    assert program.ended() == 0
    recording = read_recording(tmp_path / "a.rec")
    assert [note.text for note in recording.notes] == ["load on, müde", "pasted", MOST_LETTERS * "x"]
    assert before - 0.1 < recording.unix_s + recording.notes[0].time_s < after + 0.1
    assert recording.remarks == ()
    assert "3 notes" in program.shown


def test_what_became_of_a_note_is_said_until_the_next_one_begins(board, tmp_path):
    with contextlib.closing(Writer(tmp_path / "a.rec", {})) as writer:
        keys = Keys(open_port(str(board.port)), writer)
        keys.read = True
        keys.press("n")
        assert keys.lines()[0] == "A note needs a recording, and nothing has arrived yet."
        writer.write(0, b"1")
        keys.press("nload on\r")
        assert keys.lines() == ("Noted: load on", HINT)
        keys.press("nno\x1b")
        assert keys.lines() == (HINT,)
        keys.port.close()


def its_time_passes() -> None:
    """Let an hour pass in a program when it is told to."""
    passed = []
    signal.signal(signal.SIGUSR1, lambda *_: passed.append(3600.0))
    clock = SimpleNamespace(
        monotonic=lambda: time.monotonic() + sum(passed), strftime=time.strftime, gmtime=time.gmtime
    )
    live.time = clock


def its_disk_fills() -> None:
    """Let no file grow in a program when it is told to."""
    sys.dont_write_bytecode = True  # of a module that is loaded later: it would be cut off, and stay so
    signal.signal(signal.SIGUSR1, lambda *_: resource.setrlimit(resource.RLIMIT_FSIZE, (100, 100)))


ENDS = {
    "its time is over": (its_time_passes, lambda program: os.kill(program.pid, signal.SIGUSR1), 0),
    "Ctrl-C": (lambda: None, lambda program: program.press("\x03"), 0),
    "SIGTERM": (lambda: None, lambda program: os.kill(program.pid, signal.SIGTERM), 0),
    "SIGHUP": (lambda: None, lambda program: os.kill(program.pid, signal.SIGHUP), 0),
    "a full disk": (its_disk_fills, lambda program: os.kill(program.pid, signal.SIGUSR1), 1),
}


@pytest.mark.parametrize("end", ENDS)
def test_however_it_ends_the_terminal_is_as_it_was_and_a_note_that_was_begun_is_kept(
    board, tmp_path, started, end
):
    before, act, status = ENDS[end]
    program = started(recorder(board, tmp_path, "--duration", "1800"), before)
    program.shows(HINT)
    until(lambda: read_recording(tmp_path / "a.rec").samples)
    program.press("nhalf a n")
    program.shows("half a n_")
    assert program.at_once()
    act(program)
    assert program.ended() == status
    texts = [note.text for note in read_recording(tmp_path / "a.rec").notes]
    assert texts == ([] if status else ["half a n"])


def from_a_pipe() -> None:
    end, begin = os.pipe()
    os.write(begin, b"nnote\ru")
    os.dup2(end, 0)


def in_the_background() -> None:
    """Reading or setting the terminal would stop it."""
    children = []
    signal.signal(signal.SIGTERM, lambda *_: [os.kill(child, signal.SIGTERM) for child in children])
    if child := os.fork():
        children.append(child)
        os._exit(os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]))
    os.setpgid(0, 0)


@pytest.mark.parametrize("run", [from_a_pipe, in_the_background])
def test_without_a_terminal_in_front_nothing_changes(board, tmp_path, started, run):
    program = started(recorder(board, tmp_path, "--duration", f"{2 * LONGEST_S:.0f}"), run)
    program.shows("samples of frames")
    program.press("nnote\ru")
    program.shows("samples of frames")
    assert not program.at_once()
    os.kill(program.pid, signal.SIGTERM)
    assert program.ended() == 0
    assert "Keys" not in program.shown
    assert {block[1] for block in struct_heads(tmp_path / "a.rec")} == {b"A", b"B", b"E"}


def test_the_port_is_let_go_of_and_taken_back(board, tmp_path, started):
    program, path = started(recorder(board, tmp_path)), tmp_path / "a.rec"
    program.shows("samples of frames")
    program.press("u")
    program.shows(f"{board.port} is away ({LET_GO}); waiting for it")
    program.counts_down()
    with contextlib.closing(open_port(str(board.port))):  # as a program that uploads does
        received = len(read_recording(path).samples)
    program.press("u")
    program.shows(HINT)
    until(lambda: len(read_recording(path).samples) > received + 20)
    program.press("\x03")
    assert program.ended() == 0
    assert [block[1] for block in struct_heads(path)].count(b"O") == 1
    assert "1 reconnect" in program.shown.replace("1 reconnects", "")


def test_a_port_comes_back_by_itself(board, monkeypatch):
    clock = Clock()
    monkeypatch.setattr(session, "time", clock)
    port = open_port(str(board.port))
    until(lambda: port.read(0.1))
    port.let_go()
    began = clock.now_s
    assert port.read(0.01) == b""
    assert (port.lost, port.opened) == (LET_GO, 1)
    until(lambda: port.read(1.0))
    assert session.UPLOAD_S <= clock.now_s - began < session.UPLOAD_S + 0.01
    assert (port.lost, port.opened, port.free_s) == ("", 2, 0.0)
    port.close()


@pytest.mark.slow
def test_the_keys_of_live_are_those_of_record(tmp_path, started):
    robot = repro.example() / "robot.toml"
    board = Board(tmp_path)
    Follower(repro.load_robot(robot)).warm()  # no process has to compile
    line = b",".join([b"0.5"] * repro.load_robot(robot).n_readings) + b"\r\n"
    words = ["live", str(board.port), "--robot", str(robot)]
    without = HINT.replace("n writes a note into the recording, ", "")
    for more, keys in (([], without), (["-o", "a.rec"], HINT)):
        program = started([*words, *more], lambda: os.chdir(tmp_path))
        program.shows(keys)
        program.press("n")
        program.shows("A note needs a recording, and nothing has arrived yet." if more else "(-o FILE.rec)")
        program.press("u")
        program.shows(f"The port is {LET_GO}.")
        program.shows(COUNTDOWN)
        program.press("u")
        program.shows(keys)
        board.send(b"\r\n" + 5 * line)
        if more:
            until(lambda: read_recording(tmp_path / "a.rec").samples)
            program.press("nload on\r")
            program.shows("Noted: load on")
        os.kill(program.pid, signal.SIGTERM)
        assert program.ended() == 0
    board.unplug()
    assert "notes: 1 in a.rec" in program.shown
    assert [note.text for note in read_recording(tmp_path / "a.rec").notes] == ["load on"]
    assert [block[1] for block in struct_heads(tmp_path / "a.rec")].count(b"O") == 1


def test_a_terminal_shows_why_there_are_no_samples_and_the_last_bytes(tmp_path, started):
    board = Board(tmp_path)
    program = started(recorder(board, tmp_path), its_time_passes)
    program.shows("Nothing arrives yet. Is the board powered and programmed? Reset it.")
    os.kill(program.pid, signal.SIGUSR1)  # for two hours from then on even a busy computer sees no silence
    board.send(b"\x00\xf9\xa5" * 40)
    until(lambda: any(block[1] == b"B" for block in struct_heads(tmp_path / "a.rec")))
    os.kill(program.pid, signal.SIGUSR1)
    program.shows("Bytes arrive, but no readings. Is --baud the rate of the board?")
    board.send(b"ets Jul 29 2019 12:21:46\r\n[/b]rst:0x1 (POWERON),boot:0x13\xff")
    program.shows("as text: [/b]rst:0x1 (POWERON),boot:0x13.")
    program.shows("28 50 4f 57 45 52 4f 4e 29 2c 62 6f 6f 74 3a 30 78 31 33 ff")
    words = "Nothing arrives any more. Has the board lost its power or its wires?"
    until(lambda: os.kill(program.pid, signal.SIGUSR1) or words in program.shown)
    program.press("\x03")
    assert program.ended() == 1
    board.unplug()
