"""The recording that the browser writes: the bytes of Python's recorder, read by Python's reader."""

from __future__ import annotations

import base64
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from edition1_live.record.export import export
from edition1_live.record.recording import channel_names, read_recording
from edition1_live.record.recording_file import RecordingFile
from edition1_live.wire.formats import parser
from test_board_wire import BOARD, FRAMES, damaged, random_line, random_packets

WRITE = """({format, data, cuts, times, reopened, metadata}) => {
  const bytes = Uint8Array.from(atob(data), c => c.charCodeAt(0)), reader = BOARD.parser(format);
  metadata.start_host_ns = BigInt(metadata.start_host_ns);
  const recording = new BOARD.Recording(metadata);
  let begin = 0;
  cuts.forEach((end, k) => {
    const frames = reader.feed(bytes.subarray(begin, end));
    if (frames.length) recording.append(BigInt(times[k]), frames);
    if (reopened.includes(k)) { reader.reopened(); recording.note({event: "reopened", host_ns: BigInt(times[k])}); }
    begin = end;
  });
  return new Promise(done => {
    const file = new FileReader();
    file.onload = () => done(file.result.split(",")[1]);
    file.readAsDataURL(recording.blob());
  });
}"""


@pytest.fixture(scope="module")
def page(browser, tmp_path_factory):
    """Open a page that has the parsers and the recording."""
    path = tmp_path_factory.mktemp("recording") / "recording.html"
    scripts = "".join(
        f'<script src="{(BOARD / name).as_uri()}"></script>' for name in ("wire.js", "recording.js")
    )
    path.write_text(f'<!doctype html><meta charset="utf-8"><title>R</title>{scripts}', encoding="utf-8")
    page = browser.new_page()
    page.goto(path.as_uri())
    yield page
    page.close()


def recorded_by_both(
    page, format: str, data: bytes, rng: np.random.Generator, folder: Path, *, cuts=None
) -> Path:
    """Write the same chunks at the same times in Python and in the browser; the files are equal."""
    cuts = cuts or [*np.sort(rng.integers(0, len(data) + 1, len(data) // 400)).tolist(), len(data)]
    times = (2**62 + np.cumsum(rng.integers(1, 10**7, len(cuts)))).tolist()
    reopened = rng.integers(0, len(cuts), min(5, len(cuts) - 1)).tolist()
    metadata = {
        "format": format,
        "channels": channel_names(format, 3),
        "port": 'COM3 "µ" \x7f \U0001f916',
        "baud": 115200,
        "start_unix_s": 1764052029.123456,
        "start_host_ns": 2**62 + 1,
        "versions": {"system": "a browser"},
    }
    path, reader = folder / "python.rec", parser(format)
    with RecordingFile(path, metadata) as file:
        for k, (start, end) in enumerate(zip([0, *cuts], cuts, strict=False)):
            if frames := reader.feed(data[start:end]):
                file.append(times[k], frames)
            if k in reopened:
                reader.reopened()
                file.note({"event": "reopened", "host_ns": times[k]})
    given = {"format": format, "data": base64.b64encode(data).decode(), "cuts": cuts, "reopened": reopened}
    given |= {"times": list(map(str, times)), "metadata": metadata | {"start_host_ns": str(2**62 + 1)}}
    written = folder / "browser.rec"
    written.write_bytes(base64.b64decode(page.evaluate(WRITE, given)))
    assert written.read_bytes() == path.read_bytes()
    return written


def test_frames_are_recorded_byte_for_byte(page, tmp_path):
    rng = np.random.default_rng(1)
    path = recorded_by_both(page, "frames", damaged(random_packets(rng, FRAMES), rng), rng, tmp_path)
    recording = read_recording(path)
    assert (recording.torn_bytes, recording.damaged_bytes, recording.remarks) == (0, 0, ())
    assert [note["event"] for note in recording.notes] == ["reopened"] * len(recording.notes) != []


@pytest.mark.parametrize("format", ["hall", "millivolts", "quaternions"])
def test_lines_are_recorded_byte_for_byte_and_exported(page, tmp_path, format):
    rng = np.random.default_rng(2)
    lines = [random_line(format, rng) for _ in range(FRAMES // 10)]
    path = recorded_by_both(page, format, damaged(lines, rng), rng, tmp_path)
    export(read_recording(path), tmp_path / "table.csv")
    assert len(pd.read_csv(tmp_path / "table.csv")) == len(read_recording(path).frames) > 0.8 * len(lines)


def test_many_frames_at_once_are_split_as_by_the_recorder(page, tmp_path):
    """More frames in one chunk than a block may hold."""
    data = b"\n" + b"1,2,3\n" * 70_000
    path = recorded_by_both(page, "hall", data, np.random.default_rng(3), tmp_path, cuts=[len(data)])
    assert len(read_recording(path).frames) == 70_000
