"""Recordings, written and read: whole, damaged, cut; ports that are lost; the clock of a board."""

from __future__ import annotations

import contextlib
import itertools
import json
import os
import resource
import signal
import socket
import struct
import threading
import time
import tty
import zlib
from contextlib import closing
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bench.soak import damaged, kills
from repro import ConstantCurvature, Imu, InputError, Link, Robot, Sensor
from repro_board import live as module
from repro_board.live import Summary, _Taker, record
from repro_board.record import (
    MOST_LETTERS,
    Note,
    Writer,
    arrival_times,
    board_times,
    read_recording,
    readings_of,
)
from repro_board.session import open_port, ports
from repro_board.steps import JUMPED, STANDS_STILL, Steps
from repro_board.wire import Parser, encode
from tests.board.waiting import LONGEST_S, until

START = 17 * 10**17


def frames(numbers, period_us: int = 1000) -> list[bytes]:
    return [encode([k + 0.5, -1.0], sequence=k, time_us=period_us * k) for k in numbers]


def written(path: Path, parts: list[bytes], step_ns: int = 10**7) -> Path:
    writer = Writer(path, {"port": "a board"})
    for k, part in enumerate(parts):
        writer.write(START + k * step_ns, part)
    writer.close()
    return path


def block_of(kind: bytes, number: int, content: bytes, magic: bytes = b"RRB2") -> bytes:
    """A block, by the table at the head of the module."""
    head = struct.pack("<4sc3xIIIq", magic, kind, 5, number, len(content), START)
    return head + struct.pack("<I", zlib.crc32(head + content)) + content


# ------------------------------------------------------------------------------------------------ what is written
@settings(max_examples=40)
@given(st.lists(st.binary(max_size=300), max_size=8), st.lists(st.booleans(), min_size=8, max_size=8))
def test_the_bytes_are_those_of_the_table(tmp_path_factory, parts, again):
    """Decoded by nothing but struct and zlib, from the table at the head of the module."""
    path = tmp_path_factory.mktemp("a") / "a.rec"
    writer = Writer(path, {"port": "COM3"})
    for k, part in enumerate(parts):
        if again[k]:
            writer.opened(START + k)
        writer.write(START + k, part)
        if again[-1]:
            writer.note(START + k, f"Grüße {k}")
    writer.close({"samples": 3})
    if not any(parts):
        assert not path.exists()
        return
    data, at, found = path.read_bytes(), 0, []
    while at < len(data):
        magic, kind, identity, number, size, unix_ns = struct.unpack_from("<4sc3xIIIq", data, at)
        content = data[at + 32 : at + 32 + size]
        assert struct.unpack_from("<I", data, at + 28)[0] == zlib.crc32(data[at : at + 28] + content)
        assert (magic, number, identity) == (b"RRB3", len(found), struct.unpack_from("<I", data, 8)[0])
        found.append((kind, unix_ns, content))
        at += 32 + size
    assert (found[0][0], json.loads(found[0][2])) == (b"A", {"port": "COM3"})
    assert (found[-1][0], json.loads(found[-1][2])) == (b"E", {"bytes": len(b"".join(parts)), "samples": 3})
    expected = []
    for k, part in enumerate(parts):
        expected += [(b"O", START + k, b"")] * again[k] + [(b"B", START + k, part)] * bool(part)
        expected += [(b"N", START + k, f"Grüße {k}".encode())] * again[-1]
    assert found[1:-1] == expected


@settings(max_examples=25)
@given(st.integers(1, 30), st.lists(st.integers(0, 800), max_size=12), st.sampled_from(["frames", "csv"]))
def test_whatever_is_written_is_read_wherever_it_was_cut(tmp_path_factory, n, cuts, form):
    lines = [f"{k + 0.5},{-k}\n".encode() for k in range(n + 2)]
    data = b"".join(frames(range(n))) if form == "frames" else b"\n" + b"".join(lines)
    cuts = sorted(min(cut, len(data)) for cut in cuts)
    parts = [data[a:b] for a, b in zip([0, *cuts], [*cuts, len(data)], strict=True)]
    recording = read_recording(written(tmp_path_factory.mktemp("b") / "a.rec", parts))
    n += 2 * (form == "csv")
    assert recording.format == form
    assert [sample.values.tolist() for sample in recording.samples] == [
        [k + 0.5, -1.0 if form == "frames" else -k] for k in range(n)
    ]
    assert recording.remarks == ()
    assert recording.about == {"port": "a board"}
    ends = np.cumsum([len(part) for part in parts])
    block = np.searchsorted(ends, [sample.start for sample in recording.samples], side="right")
    np.testing.assert_allclose(recording.arrived, START / 1e9 + 0.01 * block, atol=1e-6)
    assert recording.times[0] == 0.0


def test_a_format_that_was_wrong_when_recorded_spoils_nothing(tmp_path):
    for about, words in (
        ({"format": "csv"}, "csv"),
        ({"format": "frames", "channels": 5}, "frames of 5 values"),
    ):
        path = tmp_path / f"{words}.rec"
        writer = Writer(path, about)
        writer.write(START, b"".join(frames(range(20))))
        writer.close()
        recording = read_recording(path)
        assert [sample.sequence for sample in recording.samples] == list(range(20))
        assert (
            recording.remarks[-1]
            == f"{path.name} was recorded as {words}, but its bytes are frames, and are read so"
        )


def test_long_bytes_are_cut_into_blocks(tmp_path):
    data = b"".join(frames(range(5000)))
    recording = read_recording(written(tmp_path / "a.rec", [data]))
    assert [sample.sequence for sample in recording.samples] == list(range(5000))
    assert [block[3] for block in struct_heads(tmp_path / "a.rec")] == [0, 1, 2, 3, 4]


def struct_heads(path: Path) -> list[tuple]:
    data = path.read_bytes()
    return [damaged.HEAD.unpack_from(data, at) for at in damaged.starts(data)[:-1]]


def test_a_recording_is_never_written_over(tmp_path):
    path = written(tmp_path / "a.rec", frames(range(9)))
    before = path.read_bytes()
    message = r"output of the recording must be a new file .*received .*a\.rec \(File exists\)"
    with pytest.raises(InputError, match=message):
        Writer(path, {})
    with pytest.raises(InputError, match=r"must be a file that can be made.*\(No such file or directory\)"):
        Writer(tmp_path / "none" / "a.rec", {})
    assert path.read_bytes() == before


def test_it_is_read_while_it_is_written(tmp_path):
    writer = Writer(tmp_path / "a.rec", {})
    for k, frame in enumerate(frames(range(5))):
        writer.write(START, frame)
        recording = read_recording(tmp_path / "a.rec")
        assert len(recording.samples) == k + 1
        assert recording.remarks == (
            "a.rec has no end: the recorder still runs or was killed, or the file was cut",
        )
    writer.close()
    writer.close()  # again
    assert read_recording(tmp_path / "a.rec").remarks == ()


def test_a_clock_of_the_day_that_is_set_changes_no_time_of_a_recording(tmp_path, monkeypatch):
    """It goes back and forth by an hour whenever somebody looks at it."""
    real, looks, writer = time.time_ns, itertools.count(), Writer(tmp_path / "a.rec", {})
    monkeypatch.setattr(time, "time_ns", lambda: real() + 3600 * 10**9 * (next(looks) % 2))
    for frame in frames(range(30)):
        writer.take(frame, False)
    writer.close()
    assert np.ptp(read_recording(tmp_path / "a.rec").arrived) < 2


def test_a_full_disk_is_told_and_the_file_ends_with_a_whole_block(tmp_path):
    """A limit of the file size, which the operating system enforces as it does a full disk."""
    before, writer = resource.getrlimit(resource.RLIMIT_FSIZE), Writer(tmp_path / "a.rec", {})
    resource.setrlimit(resource.RLIMIT_FSIZE, (1000, before[1]))
    sent = iter(frames(range(100)))
    try:
        message = r"a\.rec failed: File too large\. What came before is kept\."
        with pytest.raises(OSError, match=message):
            [writer.write(START, frame) for frame in sent]
        with pytest.raises(OSError, match="failed"):
            writer.write(START, b"more")
        writer.close()
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
    taken = 99 - len(list(sent))
    recording = read_recording(tmp_path / "a.rec")
    assert len(recording.samples) == taken > 10
    assert len(recording.remarks) == 1
    assert damaged.starts((tmp_path / "a.rec").read_bytes())  # ends where a block ends


def test_a_killed_recorder_leaves_all_that_it_has_taken(tmp_path):
    killed = kills.soak(1, tmp_path, seed=1)
    assert all(one.good and one.samples for one in killed), killed


def test_a_recorder_killed_before_its_first_block_leaves_no_file_of_that_name(tmp_path, monkeypatch):
    monkeypatch.setattr(Writer, "_append", lambda *_: os._exit(9))
    if not (child := os.fork()):
        Writer(tmp_path / "a.rec", {})
    assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 9
    monkeypatch.undo()
    assert not (tmp_path / "a.rec").exists()
    assert len(read_recording(written(tmp_path / "a.rec", frames(range(9)))).samples) == 9


# -------------------------------------------------------------------------------------------------------- notes
TEXTS = st.text(min_size=1, max_size=MOST_LETTERS).filter(
    lambda text: text.isprintable() and text == text.strip()
)


@settings(max_examples=30)
@given(st.lists(st.tuples(TEXTS, st.integers(-(10**10), 10**10)), max_size=5))
def test_notes_are_read_as_they_were_written_with_their_times(tmp_path_factory, notes):
    path = tmp_path_factory.mktemp("n") / "a.rec"
    with contextlib.closing(Writer(path, {})) as writer:
        for k, frame in enumerate(frames(range(30), 10_000)):
            writer.write(START + 10**7 * k, frame)
        for text, after_ns in notes:
            writer.note(START + after_ns, text)
    recording, after = read_recording(path), sorted((ns / 1e9, text) for text, ns in notes)
    np.testing.assert_allclose([note.time_s for note in recording.notes], [s for s, _ in after], atol=1e-6)
    assert sorted(note.text for note in recording.notes) == sorted(text for text, _ in notes)
    early = sum(note.time_s < 0 for note in recording.notes)
    assert recording.remarks == (
        (f"notes from before the first sample, with times below zero: {early}",) * bool(early)
    )
    assert len(recording.samples) == 30


@pytest.mark.parametrize(
    "text", ["", " load", "on\n", "\x1b[2J", "x" * (MOST_LETTERS + 1), "\udc80", "a\u202eb"]
)
def test_a_note_that_cannot_be_shown_is_refused_and_repaired_where_another_program_wrote_it(tmp_path, text):
    message, writer = "note of the recording must be 1 to 200 letters without", Writer(tmp_path / "a.rec", {})
    with contextlib.closing(writer), pytest.raises(InputError, match=message):
        writer.note(START, text)
    content = text.encode(errors="surrogateescape")
    blocks = [block_of(b"A", 0, b"{}", b"RRB3"), block_of(b"B", 1, b"".join(frames(range(3))), b"RRB3")]
    (tmp_path / "b.rec").write_bytes(b"".join([*blocks, block_of(b"N", 2, content, b"RRB3")]))
    recording = read_recording(tmp_path / "b.rec")
    assert "notes that are damaged, empty or too long, and cut to what is readable: 1" in recording.remarks
    assert all(note.text.isprintable() and 0 < len(note.text) <= MOST_LETTERS for note in recording.notes)
    assert len(recording.notes) == bool(text)


def test_notes_without_a_sample_have_their_times_from_the_first_block(tmp_path):
    (tmp_path / "a.rec").write_bytes(block_of(b"A", 0, b"{}", b"RRB3") + block_of(b"N", 1, b"on", b"RRB3"))
    assert read_recording(tmp_path / "a.rec").notes == [Note(0.0, "on")]


def test_an_edition_without_notes_is_read_and_a_later_one_refused_in_words(tmp_path):
    content = b"".join(frames(range(9)))
    for magic in (b"RRB2", b"RRB3", b"RRB4"):
        blocks = [
            block_of(b"A", 0, b"{}", magic),
            block_of(b"B", 1, content, magic),
            block_of(b"E", 2, b"{}", magic),
        ]
        (tmp_path / magic.decode()).write_bytes(b"".join(blocks))
    for name in ("RRB2", "RRB3"):
        recording = read_recording(tmp_path / name)
        assert (len(recording.samples), recording.notes, recording.remarks) == (9, [], ())
    with pytest.raises(
        InputError, match=r"file of RRB4 .* received one of a later edition \(a newer version"
    ):
        read_recording(tmp_path / "RRB4")


# ----------------------------------------------------------------------------------------------- what is damaged
def test_damaged_recordings_hold_no_wrong_value_and_tell_what_is_missing(tmp_path):
    assert sum(damaged.soak(300, 7, tmp_path).values()) == 300


@pytest.mark.parametrize(("gaps", "end"), [(10, "1 from number 19)"), (11, "1 from number 19, ...)")])
def test_ten_gaps_are_named(tmp_path, gaps, end):
    path = written(tmp_path / "a.rec", frames(range(2 * gaps)))
    data = path.read_bytes()
    blocks = [data[a:b] for a, b in itertools.pairwise(damaged.starts(data))]
    path.write_bytes(b"".join([*blocks[::2], blocks[-1]]))
    said = read_recording(path).remarks[0]
    assert said.startswith(f"blocks that are missing: {gaps} of {2 * gaps + 2} (1 from number 1, ")
    assert said.endswith(end)


@settings(max_examples=25)
@given(st.lists(st.sampled_from(["whole", "half", "lost"]), min_size=2, max_size=20), st.booleans())
def test_every_frame_that_did_not_arrive_whole_is_told(tmp_path_factory, fates, again):
    """Of those between two whole ones the numbers tell; after a restart they begin again."""
    sent = ["whole", *fates, "whole"]
    parts = {"whole": lambda x: x, "half": lambda x: x[: len(x) // 2], "lost": lambda _: b""}
    data = [parts[fate](x) for fate, x in zip(sent, frames(range(len(sent))), strict=True)]
    path = written(tmp_path_factory.mktemp("c") / "a.rec", data + list(frames(range(2))) * again)
    recording = read_recording(path)
    halves, missing = sent.count("half"), len(sent) - sent.count("whole")
    assert len(recording.samples) == sent.count("whole") + 2 * again
    assert recording.remarks[-3:] == (
        *[f"frames or lines that are damaged, and left out: {halves}"] * bool(halves),
        *[f"frames that are missing by their numbers: {missing}"] * bool(missing),
        *["times that the board began anew: 1"] * again,
    )


def test_blocks_that_are_missing_are_named_by_their_numbers(tmp_path):
    path = written(tmp_path / "a.rec", frames(range(9)))
    data = path.read_bytes()
    cuts = damaged.starts(data)
    blocks = [data[a:b] for a, b in itertools.pairwise(cuts)]  # about, nine of bytes, end

    def remarks(kept: list[bytes]) -> tuple[tuple[str, ...], int]:
        path.write_bytes(b"".join(kept))
        recording = read_recording(path)
        return recording.remarks, len(recording.samples)

    no_end = "a.rec has no end: the recorder still runs or was killed, or the file was cut"
    order = "blocks are not in the order in which they were written, and were read in that order"
    gap = "blocks that are missing: 4 of 11 (3 from number 2, 1 from number 7)"
    assert remarks(blocks[:2] + blocks[5:7] + blocks[8:])[0][0] == gap
    assert remarks(blocks[:6]) == ((no_end,), 5)
    assert remarks([*blocks, blocks[4]]) == (("blocks that are there twice, and read once: 1",), 9)
    assert remarks([*blocks[:3], blocks[4], blocks[3], *blocks[5:]]) == ((order,), 9)
    other = written(tmp_path / "b.rec", frames(range(5))).read_bytes()
    assert remarks([*blocks, other]) == (("blocks of another recording, left out: 7",), 9)
    assert remarks([*blocks, bytes(40)]) == (("bytes that are damaged or cut off, and left out: 40",), 9)
    assert remarks(blocks[1:])[0][0] == "blocks that are missing: 1 of 11 (1 from number 0)"


def test_half_a_line_before_a_missing_block_is_no_number(tmp_path):
    path = written(
        tmp_path / "a.rec", [b"\n", *[b"1.5,2.5\n"] * 4, b"1.5,2", b"2.5\n1.5,", b"77.5\n1.5,2.5\n"]
    )
    data = path.read_bytes()
    cuts = damaged.starts(data)
    path.write_bytes(data[: cuts[7]] + data[cuts[8] :])
    recording = read_recording(path)
    assert {tuple(sample.values) for sample in recording.samples} == {(1.5, 2.5)}
    assert len(recording.samples) == 5


@pytest.mark.parametrize("content", [b"", b"RRB2", b"RRB2" * 99, b"time_s,u1\n0,1\n", bytes(999)])
def test_what_has_no_whole_block_is_refused(tmp_path, content):
    (tmp_path / "a.rec").write_bytes(content)
    with pytest.raises(
        InputError, match=rf"file of a\.rec must be a recording .* received {len(content)} bytes"
    ):
        read_recording(tmp_path / "a.rec")
    with pytest.raises(InputError, match="must be a file that exists"):
        read_recording(tmp_path / "none.rec")


@pytest.mark.parametrize("about", [b"{", b"[1]", b"[" * 50_000, b'{"format": 7, "channels": "x"}', b"\xff"])
def test_a_first_block_that_says_nothing_usable_costs_nothing(tmp_path, about):
    data = block_of(b"A", 0, about) + b"".join(
        block_of(b"B", k, x) for k, x in enumerate(frames(range(3)), 1)
    )
    (tmp_path / "a.rec").write_bytes(data)
    assert len(read_recording(tmp_path / "a.rec").samples) == 3


def test_a_recording_of_an_earlier_edition_is_refused_in_words(tmp_path):
    """A whole block of it, whose values had a width of zero; or many, that end where a block ends."""
    content = b'{"format": "frames"}'
    head = struct.pack("<4scxHI", b"RRB1", b"H", 0, len(content))
    block = head + struct.pack("<I", zlib.crc32(head + content)) + content
    robot = Robot([ConstantCurvature(0.1, 0.02)], sensors=[Sensor(1, 0.05)])
    for data in (block, 30 * block):
        (tmp_path / "a.rec").write_bytes(data)
        with pytest.raises(
            InputError, match=r"file of a\.rec .* one of an earlier edition \(version 1\.0 reads"
        ):
            readings_of(robot, tmp_path / "a.rec")


# ------------------------------------------------------------------------------------------------------ clocks
@pytest.mark.parametrize("ppm", [0.0, 50.0, -400.0, 5000.0])
def test_times_of_the_board_are_on_the_computers_clock_whatever_the_delays(ppm):
    rng = np.random.default_rng(0)
    sent = np.arange(0.0, 600.0, 0.05)
    board = (4000.0 + sent * (1 + 1e-6 * ppm)) % 4294.967296  # wraps on its way
    board[1::2] += 4294.967296  # a stream that was there at the wrap before
    delay = 0.001 + rng.exponential(0.004, len(sent)) + 0.5 * (rng.random(len(sent)) < 0.01)
    times, found, jumps = board_times(sent + delay, board)
    assert times is not None
    assert jumps == 0
    np.testing.assert_allclose(times - times[0], sent, atol=0.5e-3)
    assert found == pytest.approx(ppm, abs=2.0)


@pytest.mark.parametrize(
    ("span_s", "slower", "found"),
    [(9.9, 1e-3, "as sent"), (10.1, 1e-3, "corrected"), (600.0, 0.049, "corrected"), (600.0, 0.06, "none")],
)
def test_a_clock_is_corrected_from_ten_seconds_on_if_it_is_off_by_less_than_a_twentieth(
    span_s, slower, found
):
    board = np.linspace(0.0, span_s, 2001)
    times, ppm, _ = board_times(2e-3 + board * (1 + slower), 100.0 + board)
    assert (times is None) == (found == "none")
    if times is not None:
        corrected = slower * (found == "corrected")
        np.testing.assert_allclose(times - times[0], board * (1 + corrected), atol=1e-6)
        assert ppm == pytest.approx(1e6 * (1 / (1 + corrected) - 1), abs=1e-3)


def test_a_board_that_begins_anew_goes_on_in_time():
    sent = np.concatenate(
        [np.arange(0.0, 30.0, 0.01), np.arange(32.0, 60.0, 0.01), np.arange(75.0, 80.0, 0.01)]
    )
    board = np.concatenate([sent[:3000] + 100.0, sent[3000:5800] - 31.5, sent[5800:] - 74.0])
    times, _, jumps = board_times(sent + 0.002, board)
    np.testing.assert_allclose(times, sent + 0.002, atol=1e-6)
    assert jumps == 2


@pytest.mark.parametrize("jump_s", [0.0, -0.5, -40.0, 1.5, 3600.0])
def test_every_jump_of_the_boards_clock_is_told_and_a_late_sample_is_none(tmp_path, jump_s):
    """In a recording and live. For 1.5 s nothing arrives, and then all that was held up."""
    sent = np.arange(0.0, 40.0, 0.05)
    arrived = np.where((sent > 8.0) & (sent < 9.5), 9.5, sent)
    clock = 100.0 + sent + jump_s * (sent >= 20.0)
    parts = [encode([1.0 + k], sequence=k, time_us=round(1e6 * t)) for k, t in enumerate(clock)]
    with closing(Writer(tmp_path / "a.rec", {})) as writer:
        for t, data in zip(arrived, parts, strict=True):
            writer.write(round(1e9 * (1.7e9 + t)), data)
    recording, chip = read_recording(tmp_path / "a.rec"), Robot([Link(0.1)], sensors=[Sensor(1, 0.05)])
    told = "jumps of the board's clock, after which times go on from those of arrival: 1"
    assert recording.remarks == (told,) * bool(jump_s)
    np.testing.assert_allclose(recording.times, sent, atol=1e-3)
    if jump_s in (0.0, -40.0, 3600.0):  # live, a second or two may be the delay of a cable
        steps = Steps(chip)
        taken = zip(recording.samples, arrived, strict=True)
        found = [step.time_s for sample, t in taken for step in steps.feed([sample], t)]
        assert steps.counters["clock_jumps"] == bool(jump_s)
        assert steps.remarks == [JUMPED] * bool(jump_s)
        assert np.abs(np.array(found) - sent).max() < 2.0


@pytest.mark.parametrize("board", [np.zeros(500), np.arange(500) / 1e5, np.arange(500) * 1.0])
def test_a_clock_that_is_none_is_told_and_not_used(tmp_path, board):
    assert board_times(np.arange(500) / 100, board)[0] is None
    parts = [encode([1.0], sequence=k, time_us=round(1e6 * board[k])) for k in range(500)]
    recording = read_recording(written(tmp_path / "a.rec", parts))
    assert (
        "the times that the board sends do not pass as the computer's, and were not used" in recording.remarks
    )
    np.testing.assert_allclose(recording.times, np.arange(500) / 100, atol=2e-6)


@pytest.mark.parametrize("board", [np.zeros(30), np.minimum(np.arange(90), 60) / 100, [0.0, 0.0]])
def test_a_clock_that_stands_still_for_a_moment_is_told_and_not_used(tmp_path, board):
    """Too short for it to differ much from the computer's."""
    parts = [encode([1.0 + k], sequence=k, time_us=round(1e6 * t)) for k, t in enumerate(board)]
    path = written(tmp_path / "a.rec", parts)
    readings = readings_of(Robot([ConstantCurvature(0.1, 0.02)], sensors=[Sensor(1, 0.05)]), path)
    np.testing.assert_allclose(readings.times, np.arange(len(board)) / 100, atol=2e-6)
    assert readings.remarks == (STANDS_STILL,)


def test_a_clock_beyond_200_ppm_is_told(tmp_path):
    parts = [encode([1.0], sequence=k, time_us=round(10_000 * k * (1 + 3e-4))) for k in range(2000)]
    recording = read_recording(written(tmp_path / "a.rec", parts))
    assert recording.remarks == ("the board's clock is +300 ppm fast, which was corrected",)
    np.testing.assert_allclose(recording.times, np.arange(2000) / 100, atol=1e-5)


@given(st.lists(st.tuples(st.floats(0.0, 5.0), st.integers(1, 9)), min_size=1, max_size=20))
def test_times_of_arrival_increase_and_stay_between_the_blocks(blocks):
    ends = np.cumsum([gap for gap, _ in blocks])
    arrived = np.repeat(ends, [n for _, n in blocks])
    times = arrival_times(arrived)
    assert (np.diff(times) > 0).all()
    spread = arrived - times
    assert (spread >= -1e-6 * len(times) - 1e-9).all()
    for end, before in zip(ends[1:], ends[:-1], strict=True):
        assert (times[(arrived == end) & (end > before)] > before - 1e-9).all()


def test_samples_that_arrive_together_are_spread():
    times = arrival_times(np.repeat([1.0, 1.2, 1.4, 9.4], 4))
    expected = [end - 0.05 * behind for end in (1.0, 1.2, 1.4, 9.4) for behind in (3, 2, 1, 0)]
    np.testing.assert_allclose(times, expected, atol=1e-9)


# ------------------------------------------------------------------------------------------------------- ports
class Board:
    """A board on a pseudo-terminal behind a link, so that it can be plugged out and in."""

    def __init__(self, folder: Path) -> None:
        self.port = folder / "port"
        self.plug_in()

    def plug_in(self) -> None:
        self.board, self.line = os.openpty()
        tty.setraw(self.line)
        self.port.symlink_to(os.ttyname(self.line))

    def unplug(self) -> None:
        self.port.unlink()
        os.close(self.board)
        os.close(self.line)

    def send(self, data: bytes) -> None:
        os.write(self.board, data)


@pytest.fixture
def board(tmp_path):
    board = Board(tmp_path)
    yield board
    with contextlib.suppress(OSError):
        board.unplug()


def taken(port, n: int) -> bytes:
    """Return so many bytes that a port gives."""
    found = bytearray()
    until(lambda: found.extend(port.read(0.1)) or len(found) >= n)
    return bytes(found)


def test_a_port_gives_what_a_board_sends_and_comes_back_after_it_was_lost(board):
    port = open_port(str(board.port))
    assert port.read(0.01) == b""
    for data in (b"\x00\xff\r\n\x03\x04\x11\x13", bytes(range(256))):  # what a terminal would act on
        board.send(data)
        assert taken(port, len(data)) == data
    with pytest.raises(InputError, match=r"must be free \(close the program that has it open\)"):
        open_port(str(board.port))
    board.unplug()
    until(lambda: port.read(0.01) == b"" and port.lost)
    assert (port.opened, port.read(0.01)) == (1, b"")
    board.plug_in()
    until(lambda: port.read(0.05) == b"" and port.opened == 2)
    assert not port.lost
    board.send(b"again")
    assert taken(port, 5) == b"again"
    port.close()
    port.close()


def test_a_socket_is_a_port():
    with socket.create_server(("localhost", 0)) as server:
        port = open_port(f"socket://localhost:{server.getsockname()[1]}")
        peer, _ = server.accept()
        peer.sendall(b"x" * 1000)
        assert taken(port, 1000) == b"x" * 1000
        peer.close()
        until(lambda: port.read(0.1) == b"" and port.lost)
        assert port.lost == "closed at the other side"
        until(lambda: port.read(0.05) == b"" and port.opened == 2)
        peer, _ = server.accept()
        peer.sendall(b"y")
        assert taken(port, 1) == b"y"
        port.close()
        peer.close()


@pytest.mark.parametrize(
    ("address", "baud", "message"),
    [
        ("/dev/ttyNone", 9600, r"port of the board must be one that is there; found: "),
        ("socket://localhost:1", 9600, r"or socket://HOST:PORT of a listening .*\(Connection refused\)"),
        ("socket://localhost:x", 9600, "must be a serial port, or socket://HOST:PORT"),
        ("socket://localhost", 9600, "must be a serial port, or socket://HOST:PORT"),
        ("/dev", 9600, "must be a serial port"),
        ("/dev/null", 9600, "must be a serial port"),
        ("/dev/ttyNone", 0, "baud of the board must be a rate above zero; instead received 0"),
    ],
)  # fmt: skip
def test_ports_that_cannot_be_are_refused_in_words(address, baud, message):
    with pytest.raises(InputError, match=message):
        open_port(address, baud)
    assert ports()


@pytest.fixture
def opened(monkeypatch):
    """An event that is set when a port was opened."""
    event = threading.Event()
    monkeypatch.setattr(module, "open_port", lambda *given: (open_port(*given), event.set())[0])
    return event


def samples_in(path: Path) -> int:
    return len(read_recording(path).samples) if path.is_file() else 0


def test_a_port_is_recorded_until_ctrl_c(board, tmp_path, opened):
    shown, path = [], tmp_path / "a.rec"

    def play() -> None:
        assert opened.wait(LONGEST_S)
        for frame in frames(range(120), 10_000):
            time.sleep(0.01)
            board.send(frame)
        until(lambda: samples_in(path) == 120 and shown)
        os.kill(os.getpid(), signal.SIGINT)

    threading.Thread(target=play, daemon=True).start()
    done = record(str(board.port), path, format="frames", show=shown.append, duration_s=3 * LONGEST_S)
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler
    recording = read_recording(path)
    assert [sample.sequence for sample in recording.samples] == list(range(120))
    assert (done.samples, done.received, done.path) == (120, 120 * len(frames([0])[0]), path)
    assert recording.about["format"] == "frames"
    assert recording.about["port"] == str(board.port)
    assert recording.remarks == ()
    assert shown
    assert "samples of frames" in str(shown[-1])


def test_a_lost_port_is_waited_for_and_marked(board, tmp_path, opened):
    stop, path = threading.Event(), tmp_path / "a.rec"

    def play() -> None:
        parts = frames(range(20))
        assert opened.wait(LONGEST_S)
        board.send(b"".join(parts[:10]) + parts[10][:5])
        until(lambda: samples_in(path) == 10)
        board.unplug()
        board.plug_in()
        until(lambda: any(block[1] == b"O" for block in struct_heads(path)))
        board.send(b"".join(parts[11:]))
        until(lambda: samples_in(path) == 19)
        stop.set()

    player = threading.Thread(target=play, daemon=True)
    player.start()
    done = record(str(board.port), path, stop=stop, duration_s=5 * LONGEST_S)
    player.join(LONGEST_S)
    recording = read_recording(path)
    assert [sample.sequence for sample in recording.samples] == [*range(10), *range(11, 20)]
    assert (done.reconnects, done.samples) == (1, 19)


@pytest.mark.parametrize(
    ("apart_s", "silent_s", "said"),
    [(0.0, 0.5, False), (0.0, 1.5, True), (3.0, 5.0, False), (3.0, 6.5, True)],
)
def test_a_port_is_silent_after_a_second_or_twice_its_longest_pause(apart_s, silent_s, said):
    taker = _Taker(SimpleNamespace(received=9), SimpleNamespace(opened=1, lost=""), Parser("csv"))
    taker.apart_s = apart_s
    taker.heard = taker.sampled = time.monotonic() - silent_s
    assert [text.startswith("Nothing arrives any more.") for text in taker.wrong()] == [True] * said


def test_one_of_a_kind_is_said_in_the_singular():
    counters = {"frames": 20, "gaps": 1, "first_partial": 1, "restarts": 2, "repeats": 0}
    said = Summary(None, 9.96, 100, 20, 1, "csv", counters, ("A remark.",), 3)
    numbers = (
        "10 s: 100 bytes, 20 samples of csv (2.0/s), 1 reconnect, 3 notes, 1 gap, 1 first partial, 2 restarts"
    )
    assert str(said) == f"{numbers}\nA remark."
    short = said._replace(seconds=0.99, format=None, counters={}, reconnects=0, notes=1, remarks=())
    assert str(short) == "1 s: 100 bytes, 20 samples of no known format, 1 note"


def test_a_recording_of_nothing_leaves_no_file(board, tmp_path):
    done = record(str(board.port), tmp_path / "a.rec", duration_s=0.05)
    assert (done.path, done.received) == (None, 0)
    with pytest.raises(InputError):
        record("/dev/ttyNone", tmp_path / "a.rec")
    with pytest.raises(InputError, match="duration of repro record must be a time above zero"):
        record(str(board.port), tmp_path / "a.rec", duration_s=-1)
    assert not (tmp_path / "a.rec").exists()


# ---------------------------------------------------------------------------------------------------- readings
def test_a_recording_and_a_table_give_the_same_readings(tmp_path):
    sensors = [Sensor(1, 0.05, 0.01) for _ in range(2)]
    robot = Robot([ConstantCurvature(0.1, 0.02)], sensors=sensors)
    u = np.random.default_rng(0).normal(size=(1500, 2)).astype(np.float32)
    parts = [encode(row, sequence=k, time_us=10_000 * k) for k, row in enumerate(u)]
    readings = readings_of(robot, written(tmp_path / "a.rec", parts))
    np.testing.assert_array_equal(readings, u)
    np.testing.assert_allclose(readings.times, np.arange(1500) / 100, atol=2e-6)
    text = "time_s,u1_mT,u2_mT\n" + "".join(f"{k / 100},{x!r},{y!r}\n" for k, (x, y) in enumerate(u.tolist()))
    (tmp_path / "a.csv").write_text(text)
    table = readings_of(robot, tmp_path / "a.csv")
    np.testing.assert_array_equal(table, readings)
    np.testing.assert_allclose(table.times, readings.times, atol=2e-6)


def test_a_recording_without_readings_is_refused(tmp_path):
    robot = Robot([ConstantCurvature(0.1, 0.02)], imus=[Imu(1, 0.1)])
    path = written(tmp_path / "a.rec", [b"nothing that is a sample"])
    with pytest.raises(
        InputError, match=r"recording of a\.rec must be one with readings of the robot; .* 0 samples"
    ):
        readings_of(robot, path)
    lines = "".join(f"{-40 * k},0.25\n" for k in range(1, 9)).encode()
    path = written(tmp_path / "b.rec", [b"x\ntime_ms,Bx\n", lines])
    cause = (
        r"0 samples\. Left out were lines such as '-.*: a number is too large, or the time is missing or neg"
    )
    with pytest.raises(InputError, match=cause):
        readings_of(robot, path)
