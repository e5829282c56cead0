"""The file of a recording: what goes in comes out, and damage costs what was damaged."""

from __future__ import annotations

import json
import os
import struct
import subprocess
import sys
import time
import zlib
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from edition1.errors import InputError
from edition1_live.record.export import export
from edition1_live.record.recording import read_recording
from edition1_live.record.recording_file import (
    MOST_FRAMES,
    RecordingFile,
    WriteFailed,
    sidecar_path,
    write_sidecar,
)
from edition1_live.wire.formats import channel_names
from edition1_live.wire.frame import Frame

HEAD = {"format": "frames", "start_host_ns": 1000, "start_unix_s": 1.7e9}
numbers_32 = st.none() | st.integers(0, 2**32 - 1)
any_frame = st.builds(
    Frame,
    st.integers(0, 65535),
    numbers_32,
    numbers_32,
    st.lists(st.floats(allow_nan=False), max_size=9).map(tuple),
)
arrivals = st.lists(st.tuples(st.integers(0, 2**62), st.lists(any_frame, min_size=1, max_size=4)), max_size=4)


def some_frames(first: int, n: int, width: int = 3) -> list[Frame]:
    return [
        Frame(k % 3, k, 1000 * k, tuple(k + 0.25 * j for j in range(width))) for k in range(first, first + n)
    ]


def written(path: Path, blocks: int = 5, n: int = 4) -> list[tuple[int, Frame]]:
    frames = []
    with RecordingFile(path, HEAD) as file:
        for k in range(blocks):
            part = some_frames(k * n, n)
            file.append(2000 + k, part)
            frames += [(2000 + k, frame) for frame in part]
    return frames


@settings(max_examples=15)
@given(arrivals)
def test_whatever_is_written_is_read(tmp_path_factory, arrived):
    path = tmp_path_factory.mktemp("any") / "a.rec"
    with RecordingFile(path, HEAD) as file:
        for host_ns, frames in arrived:
            file.append(host_ns, frames)
    recording = read_recording(path)
    expected = [(host_ns, frame) for host_ns, frames in arrived for frame in frames]
    assert list(recording.as_frames()) == expected
    assert (recording.torn_bytes, recording.damaged_bytes) == (0, 0)


def test_a_recording_is_a_table(tmp_path):
    path = tmp_path / "a.rec"
    with RecordingFile(path, HEAD | {"format": "millivolts"}) as file:
        file.append(500_001_000, [Frame(0, None, None, (1.5, 2.5, 3.5))])
        file.note({"event": "lost", "host_ns": 5})
        file.append(1_000_001_000, [Frame(0, None, None, (4.5, 5.5, float("nan")))])
    recording = read_recording(path)
    assert list(recording.frames) == [
        "time_s",
        "host_ns",
        "stream",
        "sequence",
        "device_us",
        "u1_mV",
        "u2_mV",
        "u3_mV",
    ]
    assert recording.frames["time_s"].tolist() == [0.5, 1.0]
    assert recording.frames["sequence"].isna().all()
    np.testing.assert_array_equal(
        recording.frames[recording.channels].to_numpy(), [[1.5, 2.5, 3.5], [4.5, 5.5, np.nan]]
    )
    assert recording.notes == [{"event": "lost", "host_ns": 5}]
    assert (recording.format, recording.metadata["start_unix_s"]) == ("millivolts", 1.7e9)


def test_names_tell_the_unit_where_the_format_has_one():
    assert channel_names("hall", 3) == ["z_counts", "y_counts", "x_counts"]
    assert channel_names("quaternions", 4) == ["x", "y", "z", "w"]
    assert channel_names("millivolts", 2) == ["u1_mV", "u2_mV"]
    assert channel_names("frames", 1) == ["u1"]


def test_the_bytes_are_those_of_the_page(tmp_path):
    """Decoded by nothing but struct and zlib, from the table at the head of the module."""
    path = tmp_path / "a.rec"
    with RecordingFile(path, HEAD) as file:
        file.append(77, [Frame(258, 3, None, (1.5, -2.0))])
    data = path.read_bytes()
    (length,) = struct.unpack_from("<I", data, 8)
    assert json.loads(data[16 : 16 + length]) == HEAD
    block = data[16 + length :]
    assert block[:8] == b"RRB1F\0\x02\0"
    assert struct.unpack_from("<II", block, 8) == (1, zlib.crc32(block[:12] + block[16:]))
    assert struct.unpack("<qIIHBB2d", block[16:]) == (77, 0, 3, 258, 2, 1, 1.5, -2.0)


def test_cut_anywhere_all_whole_blocks_are_read(tmp_path):
    path, cut = tmp_path / "a.rec", tmp_path / "cut.rec"
    frames = written(path)
    data = path.read_bytes()
    block = 16 + 4 * (20 + 3 * 8)
    head = len(data) - 5 * block
    for length in [*range(head, len(data), 13), *range(len(data) - 20, len(data) + 1)]:
        cut.write_bytes(data[:length])
        recording = read_recording(cut)
        whole, rest = divmod(length - head, block)
        assert list(recording.as_frames()) == frames[: 4 * whole]
        assert (recording.torn_bytes, recording.damaged_bytes) == (rest, 0)


def test_zeros_after_a_power_cut_are_left_out(tmp_path):
    frames = written(path := tmp_path / "a.rec")
    with path.open("ab") as file:
        file.write(bytes(4096))
    recording = read_recording(path)
    assert list(recording.as_frames()) == frames
    assert recording.torn_bytes == 4096


def test_one_flipped_bit_costs_its_block_only(tmp_path):
    path, flipped = tmp_path / "a.rec", tmp_path / "flipped.rec"
    frames = written(path)
    data = path.read_bytes()
    block = 16 + 4 * (20 + 3 * 8)
    second = len(data) - 4 * block
    for bit in range(0, 8 * block, 31):
        damaged = bytearray(data)
        damaged[second + bit // 8] ^= 1 << bit % 8
        flipped.write_bytes(damaged)
        recording = read_recording(flipped)
        assert list(recording.as_frames()) == frames[:4] + frames[8:]
        assert (recording.torn_bytes, recording.damaged_bytes) == (0, block)


def test_it_is_read_while_it_is_written(tmp_path):
    path = tmp_path / "a.rec"
    with RecordingFile(path, HEAD) as file:
        assert len(read_recording(path).frames) == 0
        for k in range(3):
            file.append(k, some_frames(4 * k, 4))
            assert len(read_recording(path).frames) == 4 * (k + 1)


def test_more_frames_than_a_block_holds(tmp_path):
    path = tmp_path / "a.rec"
    with RecordingFile(path, HEAD) as file:
        file.append(1, some_frames(0, MOST_FRAMES + 3, 1))
    assert read_recording(path).frames["sequence"].tolist() == list(range(MOST_FRAMES + 3))


def test_the_disk_is_asked_once_per_second(tmp_path):
    with RecordingFile(tmp_path / "a.rec", HEAD) as file:
        head = file.synced_bytes
        file.append(1, some_frames(0, 4))
        assert file.synced_bytes == head < file.written_bytes
        deadline = time.monotonic() + 3.0
        while file.synced_bytes < file.written_bytes and time.monotonic() < deadline:
            time.sleep(0.02)
        assert file.synced_bytes == file.written_bytes
    file.close()  # again


def test_an_existing_recording_is_never_overwritten(tmp_path):
    written(path := tmp_path / "a.rec")
    before = path.read_bytes()
    expected = "must be a new file .give another name, or move the old one.; instead received .*a.rec"
    with pytest.raises(InputError, match=expected):
        RecordingFile(path, HEAD)
    assert path.read_bytes() == before
    write_sidecar(tmp_path / "b.rec", HEAD)
    with pytest.raises(InputError, match="a new file"):
        RecordingFile(tmp_path / "b.rec", HEAD)


RACE = """
import sys, time
from pathlib import Path
from edition1.errors import InputError
from edition1_live.wire.frame import Frame
from edition1_live.record.recording_file import RecordingFile
folder, number = Path(sys.argv[1]), int(sys.argv[2])
(folder / f"ready-{number}").touch()
while not (start := folder / "start").exists():
    pass
begin = start.stat().st_mtime
for k in range(40):
    while time.time() < begin + 0.03 * (k + 1):
        pass
    try:
        with RecordingFile(folder / f"{k}.rec", {"format": "frames", "start_host_ns": 0, "by": number}) as file:
            file.append(k, [Frame(0, j, None, (float(number),)) for j in range(50)])
        print(k, "made")
    except InputError as error:
        print(k, error)
"""


def test_of_two_processes_that_make_one_file_at_once_exactly_one_does(tmp_path):
    command = [sys.executable, "-c", RACE, str(tmp_path)]
    both = [subprocess.Popen([*command, str(n)], stdout=subprocess.PIPE, text=True) for n in range(2)]
    while len(list(tmp_path.glob("ready-*"))) < 2:
        assert all(process.poll() is None for process in both)
        time.sleep(0.01)
    (tmp_path / "start").touch()
    said = [process.communicate(timeout=60)[0].splitlines() for process in both]
    assert [process.returncode for process in both] == [0, 0]
    for k in range(40):
        recording = read_recording(tmp_path / f"{k}.rec")
        by = recording.metadata["by"]
        assert said[by][k] == f"{k} made"
        refused = said[1 - by][k]
        assert refused.startswith(
            f"{k} Input output of RecordingFile must be a new file (give another name"
        ), refused
        assert recording.frames["u1"].tolist() == [by] * 50
        assert (recording.torn_bytes, recording.damaged_bytes) == (0, 0)
    assert not list(tmp_path.glob(".*"))


def test_the_sidecar_adds_to_the_first_block_and_may_be_lost(tmp_path):
    written(path := tmp_path / "a.rec")
    write_sidecar(path, {"counters": {"frames": 20}})
    assert read_recording(path).metadata == HEAD | {"counters": {"frames": 20}}
    sidecar_path(path).write_text("{")
    assert read_recording(path).metadata == HEAD


def block_starts(data: bytes) -> list[int]:
    """Return where the blocks of a recording begin, and its length."""
    starts = [0]
    while starts[-1] < len(data):
        kind, width, count = struct.unpack_from("<4xcxHI", data, starts[-1])
        starts.append(starts[-1] + 16 + count * (20 + 8 * width if kind == b"F" else 1))
    return starts


MIXED = {
    "frames": lambda k: some_frames(3 * k, 3, 1 + k),
    "millivolts": lambda k: [Frame(0, None, None, (k + 0.5, 2.0, 3.0))],
}


def mixed(path: Path, format: str, sidecar: bool) -> list[list[tuple[int, Frame]]]:
    """Write a recording of texts and blocks of several widths; return the frames of every block."""
    head = HEAD | {"format": format}
    blocks: list[list[tuple[int, Frame]]] = [[]]
    with RecordingFile(path, head) as file:
        for k in range(4):
            part = MIXED[format](k)
            file.append(5000 + k, part)
            file.note({"event": "lost", "host_ns": 5000 + k})
            blocks += [[(5000 + k, frame) for frame in part], []]
    if sidecar:
        write_sidecar(path, head | {"counters": {"frames": 12}})
    return blocks


@settings(max_examples=150)
@given(st.data(), st.sampled_from(list(MIXED)), st.booleans())
def test_any_flipped_bit_loses_at_most_its_block_and_is_told(tmp_path_factory, data, format, sidecar):
    path = tmp_path_factory.mktemp("flipped") / "a.rec"
    blocks = mixed(path, format, sidecar)
    content = bytearray(path.read_bytes())
    intact = read_recording(path)
    assert intact.remarks == ()
    bit = data.draw(st.integers(0, 8 * len(content) - 1) | st.integers(0, 8 * 80))
    starts = block_starts(bytes(content))
    (hit,) = [k for k, start in enumerate(starts[:-1]) if start <= bit // 8 < starts[k + 1]]
    content[bit // 8] ^= 1 << bit % 8
    path.write_bytes(content)
    recording = read_recording(path)
    expected = [frame for k, block in enumerate(blocks) if k != hit for frame in block]
    assert list(recording.as_frames()) == expected
    assert len(recording.notes) == 4 - (hit > 0 and not blocks[hit])
    lost = starts[hit + 1] - starts[hit]
    assert recording.torn_bytes + recording.damaged_bytes == lost
    assert recording.remarks[0] == f"{lost} bytes of the recording are not whole and were left out"
    if hit > 0 or sidecar:
        assert recording.metadata == intact.metadata
        kept = intact.frames["host_ns"].isin(recording.frames["host_ns"])
        assert recording.frames["time_s"].tolist() == intact.frames["time_s"][kept].tolist()
    if hit == 0:
        assert recording.remarks[1].startswith("its first block is damaged")
        assert len(recording.remarks) == (2 if sidecar else 4 if format == "millivolts" else 3)


@settings(max_examples=60)
@given(st.data())
def test_a_flipped_bit_of_the_sidecar_changes_no_frame(tmp_path_factory, data):
    path = tmp_path_factory.mktemp("flipped") / "a.rec"
    mixed(path, "frames", sidecar=True)
    intact = read_recording(path)
    content = bytearray(sidecar_path(path).read_bytes())
    bit = data.draw(st.integers(0, 8 * len(content) - 1))
    content[bit // 8] ^= 1 << bit % 8
    sidecar_path(path).write_bytes(content)
    recording = read_recording(path)
    assert recording.frames.equals(intact.frames)
    assert recording.metadata.items() >= (HEAD | {"format": "frames"}).items()


def with_head(path: Path, text: bytes, n: int = 4) -> None:
    """Write a recording whose first block is a text with a checksum that is right."""
    written(path, 1, n)
    data = path.read_bytes()
    head = struct.pack("<4scxHI", b"RRB1", b"H", 0, len(text))
    path.write_bytes(head + struct.pack("<I", zlib.crc32(head + text)) + text + data[block_starts(data)[1] :])


DEEP = "[" * 200_000


@pytest.mark.parametrize(
    ("text", "remark"),
    [
        ("{", "its first block is damaged, and nothing beside it says the same"),
        (DEEP, "its first block is damaged, and nothing beside it says the same"),
        ("[1, 2]", "its first block is damaged, and nothing beside it says the same"),
        ('{"format": "frames"}', "when it started is not known: time is counted from its first frame"),
        (
            '{"format": "frames", "start_host_ns": "soon", "channels": 3}',
            "its first block has no usable start_host_ns, channels",
        ),
    ],
)
def test_a_first_block_that_says_nothing_usable(tmp_path, text, remark):
    with_head(path := tmp_path / "a.rec", text.encode())
    recording = read_recording(path)
    assert remark in recording.remarks
    assert [frame for _, frame in recording.as_frames()] == some_frames(0, 4)
    assert recording.frames["time_s"].tolist() == [0.0] * 4


def test_without_frames_such_a_recording_is_empty(tmp_path):
    text = b'{"start_host_ns": 1e999, "channels": [7]}'
    with_head(path := tmp_path / "a.rec", text)
    path.write_bytes(path.read_bytes()[: 16 + len(text)])
    recording = read_recording(path)
    assert (len(recording.frames), recording.format) == (0, "frames")
    assert recording.remarks[0] == "its first block has no usable start_host_ns, channels"


@pytest.mark.parametrize(
    ("text", "remark"),
    [
        ("[]", "a.rec.json is not a JSON object and was left out"),
        (DEEP, "a.rec.json is not a JSON object and was left out"),
        ("\x00", "a.rec.json is not a JSON object and was left out"),
        (
            '{"counters": 3, "start_unix_s": 1' + "0" * 400 + "}",
            "a.rec.json has no usable start_unix_s, counters",
        ),
        (
            '{"start_host_ns": 7, "format": "hall"}',
            "a.rec.json belongs to another recording and was left out",
        ),
    ],
)
def test_a_sidecar_that_is_wrong_is_left_out_and_told(tmp_path, text, remark):
    written(path := tmp_path / "a.rec")
    sidecar_path(path).write_text(text)
    recording = read_recording(path)
    assert (recording.remarks, recording.metadata) == ((remark,), HEAD)


def test_a_text_that_is_no_json_costs_itself(tmp_path):
    path = tmp_path / "a.rec"
    with RecordingFile(path, HEAD) as file:
        file.append(1, some_frames(0, 4))
        before = path.stat().st_size
        file._write(
            b"RRB1H\0\0\0\x01\0\0\0" + struct.pack("<I", zlib.crc32(b"RRB1H\0\0\0\x01\0\0\0{")) + b"{"
        )
        bad = path.stat().st_size - before
        file.append(2, some_frames(4, 4))
    recording = read_recording(path)
    assert [frame for _, frame in recording.as_frames()] == some_frames(0, 8)
    assert recording.damaged_bytes == bad


def test_nothing_whole_is_said_as_it_is(tmp_path):
    RecordingFile(path := tmp_path / "a.rec", HEAD).close()
    data = bytearray(path.read_bytes())
    data[20] ^= 1
    path.write_bytes(data)
    with pytest.raises(InputError) as refused:
        read_recording(path)
    assert str(refused.value) == (
        "Input file of a.rec must be a recording (at least one block is whole); "
        f"instead received {len(data)} bytes without a whole block."
    )


def test_an_unknown_start_is_no_time_of_day(tmp_path):
    with_head(path := tmp_path / "a.rec", b'{"format": "hall", "start_host_ns": 0}', 1)
    expected = "recording of export must be one that says when it started"
    with pytest.raises(InputError, match=expected):
        export(read_recording(path), tmp_path / "a.csv", "hall")
    export(read_recording(path), tmp_path / "b.csv")
    assert "unix_s" not in (tmp_path / "b.csv").read_text().splitlines()[0]


def test_a_recording_killed_before_its_first_frame_has_its_columns(tmp_path):
    path = tmp_path / "a.rec"
    RecordingFile(path, HEAD | {"channels": ["u1", "u2"]}).close()
    frames = read_recording(path).frames
    assert len(frames) == 0
    assert list(frames.columns[-2:]) == ["u1", "u2"]


def test_another_file_is_refused(tmp_path):
    (tmp_path / "a.rec").write_bytes(b"time,u1\n0,1\n")
    with pytest.raises(InputError, match=r"file of a.rec must be a recording \(it starts with RRB1\)"):
        read_recording(tmp_path / "a.rec")
    with pytest.raises(FileNotFoundError):
        read_recording(tmp_path / "none.rec")


FILL = """
import resource, sys
from pathlib import Path
from edition1_live.wire.frame import Frame
from edition1_live.record.recording_file import RecordingFile, WriteFailed
resource.setrlimit(resource.RLIMIT_FSIZE, (int(sys.argv[2]), int(sys.argv[2])))
try:
    with RecordingFile(Path(sys.argv[1]), {"format": "frames", "start_host_ns": 0}) as file:
        for k in range(1000):
            file.append(k, [Frame(0, k, k, (1.0, 2.0, 3.0))])
except WriteFailed as failure:
    print(failure)
"""


@pytest.mark.skipif(os.name != "posix", reason="limits of POSIX")
def test_a_full_disk_stops_loudly_and_keeps_what_is_written(tmp_path):
    """A limit of the file size, which the operating system enforces as it does a full disk."""
    path = tmp_path / "a.rec"
    ran = subprocess.run(
        [sys.executable, "-c", FILL, str(path), "10000"], capture_output=True, text=True, check=True
    )
    kept = (10000 - 16 - len(json.dumps({"format": "frames", "start_host_ns": 0}))) // (16 + 44)
    assert ran.stdout == (
        f"Writing a.rec failed: File too large; the {kept} frames written before are kept and can be read.\n"
    )
    recording = read_recording(path)
    assert recording.frames["sequence"].tolist() == list(range(kept))
    assert 0 < recording.torn_bytes < 60


def test_a_folder_that_cannot_be_written_is_named(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(WriteFailed, match=r"a\.rec cannot be written: (File exists|Not a directory)\."):
        RecordingFile(tmp_path / "file" / "a.rec", HEAD)
