"""The emulated port: what is played arrives, in time, and the port goes and comes back."""

import math
import os
import socket
import sys
import time

import numpy as np
import pytest

from edition1.errors import InputError
from edition1_live.emulate.board import Reading, passages
from edition1_live.emulate.emulator import Emulator
from edition1_live.emulate.faults import Faults
from edition1_live.emulate.links import HAS_PTY, PtyLink, SocketLink
from edition1_live.record.ports import close_port, open_port, read_available
from edition1_live.wire.formats import parser

LINKS = [SocketLink, *([PtyLink] if HAS_PTY else [])]
needs_pty = pytest.mark.skipif(not HAS_PTY, reason="no pseudo-terminals on this system")


def readings(count, rate_hz=100.0):
    return (Reading(k / rate_hz, 0, (float(k), 0.5)) for k in range(count))


def receive(emulator, seconds=10.0):
    """Read until the emulator has finished; return chunks with their times, for every opening of the port."""
    openings = [[]]
    port = open_port(emulator.address)
    deadline = time.monotonic() + seconds
    while time.monotonic() < deadline:
        finished = emulator.finished.is_set()
        if port is None:
            try:
                port = open_port(emulator.address)
            except InputError:
                if emulator.finished.is_set():
                    break
                time.sleep(0.005)
                continue
            openings.append([])
        try:
            chunk = read_available(port, 0.1)
        except OSError:
            close_port(port)
            port = None
            continue
        if chunk:
            openings[-1].append((time.monotonic(), chunk))
        elif finished:
            break
    if port is not None:
        close_port(port)
    return openings


def joined(opening):
    return b"".join(chunk for _, chunk in opening)


@pytest.mark.parametrize("link", LINKS)
def test_as_fast_as_it_is_read_nothing_is_lost(link):
    sent = list(passages(readings(20_000), "frames", Faults(flips=1e-4), seed=0))
    data = b"".join(passage.data for passage in sent)
    with Emulator(sent, link(), speed=math.inf) as emulator:
        (opening,) = receive(emulator)
    assert joined(opening) == data


@pytest.mark.parametrize("link", LINKS)
def test_the_port_disappears_and_comes_back_under_the_same_name(link):
    faults = Faults(disconnects=2e-3, away_s=0.1)
    sent = list(passages(readings(2000), "frames", faults, seed=1))
    connections = [
        b"".join(p.data for p in sent if p.connection == c) for c in range(sent[-1].connection + 1)
    ]
    assert len(connections) > 2
    with Emulator(sent, link(), speed=math.inf) as emulator:
        openings = receive(emulator)
    assert [joined(opening) for opening in openings] == connections


@pytest.mark.parametrize("link", LINKS)
def test_frames_come_in_time(link):
    sent = passages(readings(60), "frames", Faults(stalls=0.03, stall_s=0.5), seed=2)
    sent = list(sent)
    late = sum(passage.silent_s for passage in sent)
    assert late == 0.5  # one stall
    with Emulator(sent, link(), speed=2.0) as emulator:
        (opening,) = receive(emulator)
    binary = parser("frames")
    arrival = [(at, frame.sequence) for at, chunk in opening for frame in binary.feed(chunk)]
    at, number = (np.array(column) for column in zip(*arrival, strict=True))
    assert number.tolist() == list(range(60))
    due = np.concatenate([passage.time_s for passage in sent]) / 2.0
    behind = (at - at[0]) - (due - due[0])
    assert behind.min() > -0.2  # never early, but for the delay of the first
    assert np.median(behind) < 0.2


@pytest.mark.parametrize("link", LINKS)
def test_a_board_that_plays_in_time_does_not_wait_for_a_reader(link):
    with Emulator(passages(readings(100), "frames"), link()) as emulator:
        port, data = open_port(emulator.address), b""
        while not data:
            data = read_available(port, 0.1)
        close_port(port)
        time.sleep(0.4)
        (opening,) = receive(emulator)
    before, after = parser("frames").feed(data), parser("frames").feed(joined(opening))
    assert after[-1].sequence == 99
    assert after[0].sequence - before[-1].sequence > 20


@pytest.mark.parametrize("link", LINKS)
def test_as_fast_as_it_is_read_means_not_before_somebody_reads(link):
    sent = list(passages(readings(100), "frames"))
    with Emulator(sent, link(), speed=math.inf) as emulator:
        assert not emulator.finished.wait(0.3)
        (opening,) = receive(emulator)
    assert joined(opening) == sent[0].data


@pytest.mark.parametrize("link", LINKS)
def test_it_stops_at_once_with_and_without_a_reader(link):
    for speed in (1.0, math.inf):
        for with_reader in (False, True):
            sent = passages(readings(10**9), "frames")  # longer than anybody waits
            began = time.monotonic()
            with Emulator(sent, link(), speed=speed) as emulator:
                port = open_port(emulator.address) if with_reader else None
                time.sleep(0.4)  # the buffers are full
            assert time.monotonic() - began < 2.5
            if port is not None:
                close_port(port)


@needs_pty
def test_the_link_of_a_pseudo_terminal_is_removed(tmp_path):
    path = tmp_path / "port"
    for _ in range(2):
        with Emulator(passages(readings(3), "frames"), PtyLink(path)) as emulator:
            assert emulator.address == str(path)
            assert os.readlink(path).startswith("/dev/")
        assert not path.is_symlink()
    path.symlink_to("/dev/pts/none")  # as a killed emulator leaves it
    with Emulator(passages(readings(3), "frames"), PtyLink(path)):
        assert os.readlink(path) != "/dev/pts/none"
    path.write_text("something else", encoding="utf-8")
    with pytest.raises(
        InputError, match="^Input port_file of PtyLink must be a new name, or that of an earlier port; .*$"
    ):
        PtyLink(path)
    assert path.read_text(encoding="utf-8") == "something else"


@needs_pty
def test_a_temporary_folder_is_removed():
    link = PtyLink()
    with Emulator(passages(readings(3), "frames"), link):
        assert os.path.islink(link.address)
    assert not os.path.exists(os.path.dirname(link.address))


def test_only_this_computer_reaches_the_socket_and_a_port_is_used_once():
    with socket.create_server(("127.0.0.1", 0)) as other:
        number = other.getsockname()[1]
        with pytest.raises(
            InputError,
            match=f"^Input socket of SocketLink must be a free port; instead received {number}: .*$",
        ):
            SocketLink(number)
    with pytest.raises(
        InputError, match="^Input socket of SocketLink must be 0 to 65535; instead received 70000.$"
    ):
        SocketLink(70000)
    link = SocketLink()
    assert link.address.startswith("socket://127.0.0.1:")
    link.remove()


def test_an_error_in_what_is_played_reaches_the_caller():
    def broken():
        yield from passages(readings(3), "frames")
        raise RuntimeError("no more")

    with pytest.raises(RuntimeError, match="^no more$"), Emulator(broken(), SocketLink()) as emulator:
        receive(emulator)


def test_the_speed_must_be_positive():
    link = SocketLink()
    with pytest.raises(
        InputError, match="^Input speed of Emulator must be above zero; instead received nan.$"
    ):
        Emulator([], link, speed=math.nan)
    link.remove()


class WatchedLink(SocketLink):
    """Says whether its socket is open: once it is closed, another program may listen at the same number."""

    def is_open(self) -> bool:
        return self._listener is not None


@pytest.mark.parametrize("line", range(1, 31))
def test_an_interruption_of_the_wait_ends_it_wherever_it_comes(line):
    """Before any line of the wait, those of the standard library among them; no other error takes its place."""
    left, former = line, sys.gettrace()

    def trace(frame, event, argument):
        nonlocal left
        left -= event == "line"
        if left == 0:
            raise KeyboardInterrupt
        return trace

    link = WatchedLink()
    emulator = Emulator(passages(readings(100), "frames"), link)
    assert link.is_open()

    def play():
        with emulator:
            sys.settrace(trace)
            try:
                emulator.wait()
            finally:
                sys.settrace(former)

    with pytest.raises(KeyboardInterrupt):
        play()
    assert not link.is_open()


def test_a_port_that_is_gone_when_it_begins_is_told_before_anything_is_announced(monkeypatch):
    def gone():
        raise OSError("no more ports")

    link, entered = SocketLink(), []
    monkeypatch.setattr(link, "appear", gone)
    with pytest.raises(OSError, match="no more ports"), Emulator(passages(readings(3), "frames"), link):
        entered.append(True)
    assert not entered
