"""The wire formats in the browser against the parsers in Python: the same frames and counters of the same bytes.

``book/_static/board/wire.js`` runs in a page that is opened from disk. Lines are damaged at random, chunks are cut
anywhere, and the port is opened anew now and then.
"""

from __future__ import annotations

import base64
import ctypes
import math
import shutil
import struct
import subprocess
import zlib
from pathlib import Path

import numpy as np
import pytest
from cobs import cobs
from edition1_live.emulate.faults import Faults, damage
from edition1_live.record.recording import channel_names
from edition1_live.record.summary import Suspect, channels_of
from edition1_live.wire.binary import encode_frame
from edition1_live.wire.csv_text import CsvParser
from edition1_live.wire.formats import encode, parser
from edition1_live.wire.frame import Frame

BOOK = Path(__file__).resolve().parents[2] / "book"
BOARD = BOOK / "_static" / "board"
FRAMES = 100_000
FAULTS = Faults(flips=3e-4, drops=2e-4, duplicates=2e-4, bursts=2e-5)
PAGE = '<!doctype html><meta charset="utf-8"><title>Wire</title><script src="WIRE"></script>'
READ = """({format, channels, data, cuts, reopened}) => {
  const bytes = Uint8Array.from(atob(data), c => c.charCodeAt(0));
  const reader = BOARD.parser(format, channels), out = [], counts = [];
  let begin = 0;
  cuts.forEach((end, k) => {
    const frames = reader.feed(bytes.subarray(begin, end));
    counts.push(frames.length);
    for (const f of frames) out.push(f.stream, f.sequence ?? -1, f.device_us ?? -1, f.values.length, ...f.values);
    if (reopened.includes(k)) reader.reopened();
    begin = end;
  });
  const packed = new Uint8Array(Float64Array.from(out).buffer), parts = [];
  for (let k = 0; k < packed.length; k += 32768) parts.push(String.fromCharCode(...packed.subarray(k, k + 32768)));
  const layout = reader.layout ? String(reader.layout) : null;
  const { counters, refused, begun } = reader;
  return {numbers: btoa(parts.join("")), counts, counters, refused, begun: begun.length, layout};
}"""


@pytest.fixture(scope="module")
def page(browser, tmp_path_factory):
    """Open a page that has the parsers."""
    path = tmp_path_factory.mktemp("wire") / "wire.html"
    path.write_text(PAGE.replace("WIRE", (BOARD / "wire.js").as_uri()), encoding="utf-8")
    page = browser.new_page()
    page.goto(path.as_uri())
    yield page
    page.close()


def assert_same(page, format: str, data: bytes, rng: np.random.Generator, channels: int | None = None) -> int:
    """Feed both the same chunks, compare everything they say, and return how many frames there were."""
    cuts = [*np.sort(rng.integers(0, len(data) + 1, len(data) // 300)).tolist(), len(data)]
    reopened = rng.integers(0, len(cuts), len(cuts) // 500).tolist()
    reader, expected, counts = parser(format, channels), [], []
    for k, (start, end) in enumerate(zip([0, *cuts], cuts, strict=False)):
        frames = reader.feed(data[start:end])
        counts.append(len(frames))
        for stream, sequence, device_us, values in frames:
            known = [-1 if number is None else number for number in (sequence, device_us)]
            expected += [stream, *known, len(values), *values]
        if k in reopened:
            reader.reopened()
    given = {"format": format, "channels": channels, "cuts": cuts, "reopened": reopened}
    found = page.evaluate(READ, {**given, "data": base64.b64encode(data).decode()})
    assert found["counters"] == reader.counters.as_dict()
    assert found["counts"] == counts
    np.testing.assert_array_equal(np.frombuffer(base64.b64decode(found["numbers"])), np.array(expected))
    assert found["refused"] == reader.refused
    assert found["begun"] == len(reader._begun)
    if isinstance(reader, CsvParser):
        assert found["layout"] == (reader.layout and str(reader.layout))
    return reader.counters.frames


def damaged(packets: list[bytes], rng: np.random.Generator) -> bytes:
    return damage(packets, FAULTS, rng).data


def random_packets(rng: np.random.Generator, count: int) -> list[bytes]:
    """Frames of several streams, with lost and repeated ones, resets, wraps, messages and foreign bodies."""
    packets, sequence = [], [2**32 - 5, 0, 77, 1000]
    for _ in range(count):
        stream, kind = int(rng.integers(4)), ("float32", "int16")[rng.random() < 0.3]
        n = 3 if rng.random() < 0.8 else int(rng.integers(1, 60 if kind == "float32" else 119))
        if kind == "int16":
            values = rng.integers(-32768, 32768, n).astype(float).tolist()
        else:
            values = rng.normal(0, 10.0 ** rng.integers(-3, 5), n).astype(np.float32).tolist()
            if rng.random() < 0.02:
                values[0] = (math.nan, math.inf, -math.inf, 0.0, -0.0)[int(rng.integers(5))]
        event = rng.random()
        sequence[stream] += 1 + int(rng.integers(1, 40)) * (event < 0.01)
        if 0.01 < event < 0.012:
            sequence[stream] = int(rng.integers(2**32))
        packet = encode_frame(
            Frame(stream, sequence[stream] % 2**32, int(rng.integers(2**32)), tuple(values)), kind
        )
        packets.append(packet)
        if event > 0.995:
            packets.append(packet)
        elif event > 0.99:
            body = bytes(rng.integers(0, 4, int(rng.integers(1, 60)), dtype=np.uint8))
            packets.append(b"\0" + cobs.encode(body + zlib.crc32(body).to_bytes(4, "little")) + b"\0")
        elif event > 0.985:
            packets.append(b"out of range\r\n" * int(rng.integers(1, 60)))
        elif event > 0.983:
            packets.append(b"\0\0")
    return packets


def test_frames(page):
    rng = np.random.default_rng(1)
    data = damaged(random_packets(rng, FRAMES), rng)
    assert assert_same(page, "frames", data, rng) > 0.8 * FRAMES


def test_frames_of_as_many_values_as_asked_for(page):
    rng = np.random.default_rng(2)
    assert_same(page, "frames", damaged(random_packets(rng, 5000), rng), rng, channels=3)


def test_every_single_damage_to_a_frame(page):
    """Each bit flipped, each byte lost or doubled, one after the other."""
    rng, sent = np.random.default_rng(3), encode_frame(Frame(3, 41, 123_456_789, (1282.125, -3.5, 0.0625)))
    flipped = [
        sent[:k] + bytes([sent[k] ^ 1 << bit]) + sent[k + 1 :] for k in range(len(sent)) for bit in range(8)
    ]
    moved = [sent[:k] + sent[k + step :] for k in range(len(sent)) for step in (1, -1) if k + step >= 0]
    assert_same(page, "frames", b"".join(one + sent for one in flipped + moved), rng)


def test_frames_of_the_encoder_in_c(page, tmp_path):
    compiler = shutil.which("gcc") or shutil.which("cc")
    if compiler is None:
        pytest.skip("no compiler for C")
    source, library = BOOK.parent / "firmware/frame_encoder.c", tmp_path / "frame_encoder.so"
    subprocess.run([compiler, "-shared", "-fPIC", "-O2", source, "-o", library], check=True)
    encode_frame_c = ctypes.CDLL(str(library)).encode_frame
    encode_frame_c.restype = ctypes.c_size_t
    rng, packets, buffer = np.random.default_rng(4), [], (ctypes.c_uint8 * 255)()
    for sequence in range(FRAMES):
        code, letter, most = ((1, "f", 59), (2, "h", 118))[int(rng.integers(2))]
        n = int(rng.integers(1, most + 1))
        values = rng.normal(size=n).tolist() if letter == "f" else rng.integers(-32768, 32768, n).tolist()
        raw = struct.pack(f"<{n}{letter}", *values)
        time_us = ctypes.c_uint32(997 * sequence)
        size = encode_frame_c(
            buffer,
            ctypes.c_uint8(5),
            ctypes.c_uint8(code),
            raw,
            ctypes.c_uint8(n),
            ctypes.c_uint32(sequence),
            time_us,
        )
        packets.append(bytes(buffer[:size]))
    assert assert_same(page, "frames", b"".join(packets), rng) > 0.99 * len(packets)
    assert assert_same(page, "frames", damaged(packets, rng), rng) > len(packets) // 2


def random_line(format: str, rng: np.random.Generator) -> bytes:
    if format == "hall":
        return encode(
            format, Frame(0, None, None, tuple(rng.integers(-8192, 8192, 3).astype(float).tolist()))
        )
    if format == "millivolts":
        return encode(format, Frame(0, None, None, tuple(rng.uniform(0, 2048, 3).tolist())))
    q = rng.normal(size=4)
    return encode(format, Frame(int(rng.integers(256)), None, None, tuple((q / np.linalg.norm(q)).tolist())))


@pytest.mark.parametrize("format", ["hall", "millivolts", "quaternions"])
def test_lines_of_the_papers(page, format):
    rng = np.random.default_rng(5)
    lines = [random_line(format, rng) for _ in range(FRAMES)]
    assert assert_same(page, format, damaged(lines, rng), rng) > 0.8 * FRAMES


FORMS = [
    "{0:.3f},{1:.2e},{2}\r\n",
    "{0:.3f}; {1:.3f}; {2:+.1f};\n",
    "X: {0:.2f} uT, Y: {1:.0f} uT\r\n",
    "x={0:.3f} y={1:.3f} z=.5\n",
    "X: {0:.2f}   Y: {1:.1f}   Z: {2:.2f} uT\r\n",
    "t: {3} ms, Bx: {0:.3f}, By: {1:.3f}\r\n",
    "time_s\tB µT\r\n{4:.7f}\t{0:.4g}\r\n",
    "millis, X (uT), Y (uT)\r\n{3},{0:.3f},nan\r\n",
    "t,Ω_1,T\n{3}.5,{0:.3f},{1:.2f}\n",
    "{0:.1f}\t{1:.1f}\t\r\n",
    "{0:.3f}\n",
]


@pytest.mark.parametrize("form", FORMS)
def test_lines_of_sketches(page, form):
    rng = np.random.default_rng(6)
    numbers = rng.normal(0, 100, (FRAMES // len(FORMS), 3)).tolist()
    lines = [form.format(*x, 17 * k, 1e-3 * k).encode() for k, x in enumerate(numbers)]
    assert assert_same(page, "csv", damaged(lines, rng), rng) > 0.5 * len(lines)


WORDS = """1 -2.5 +.5e3 1e400 nan NaN ovf inf 0x1F 5. . - e5 1,5 , ; : = x Y t T time ms micros time_ _
    µT (uT) [ms] m/s² é % ° # ' \""""
OTHERS = ("\x1c", "\ufeff", "\u2028", "\U0001f916")


def test_any_text_as_lines_of_sketches(page):
    """Lines put together from what such lines are made of, a new parser for every twenty."""
    rng = np.random.default_rng(7)
    parts = [*WORDS.split(), *OTHERS, " ", " ", "  ", "\t", ", ", " uT", "\r", ","]
    for _ in range(400):
        shapes = ["".join(rng.choice(parts, int(rng.integers(1, 9)))) for _ in range(3)]
        lines = [
            str(rng.choice(shapes)).encode() + bytes(rng.choice([b"", b"", b"", b"\xff", b"\xe2\x82"]))
            for _ in range(20)
        ]
        assert_same(page, "csv", b"\n" + b"\n".join(lines) + b"\n", rng)


@pytest.mark.parametrize("channels", [None, 1, 2])
def test_any_bytes(page, channels):
    rng = np.random.default_rng(8)
    data = rng.choice(np.frombuffer(b"0123456789,.-+eE:= \t\r\n;\0\xffnax", np.uint8), 60_000).tobytes()
    for format in ("frames", "csv", "millivolts") + (("hall", "quaternions") if channels is None else ()):
        assert_same(page, format, data + 5000 * b"7" + data, rng, channels)


def test_the_format_is_recognised_as_by_the_recorder(page):
    rng, csv = np.random.default_rng(9), [f"{x:.2f},{-x:.2f}\r\n".encode() for x in range(60)]
    lines = {
        format: [random_line(format, rng) for _ in range(60)]
        for format in ("hall", "millivolts", "quaternions")
    }
    lines |= {"frames": random_packets(rng, 60), "csv": csv, "": [b"hello world\n"] * 60}
    for format, packets in lines.items():
        data = b"".join(packets)[5:]
        suspect = Suspect("millivolts")
        suspect.add(data)
        tried = {
            other: suspect._tried(other) for other in ("frames", "hall", "millivolts", "quaternions", "csv")
        }
        expected = next(
            (name for name, (frames, n) in tried.items() if frames and len(frames) >= 0.95 * n), ""
        )
        found = page.evaluate(
            "text => BOARD.detected(Uint8Array.from(atob(text), c => c.charCodeAt(0)))",
            base64.b64encode(data).decode(),
        )
        assert found == expected == format


def test_values_are_named_as_in_a_recording(page):
    for format, n in [("frames", 2), ("hall", 3), ("millivolts", 4), ("quaternions", 4), ("csv", 2)]:
        assert page.evaluate("([format, n]) => BOARD.channelNames(format, n)", [format, n]) == channel_names(
            format, n
        )
    data = b"time_ms, X (uT), Y\n1,2,3\n1,2,3\n1,2,3\n"
    reader = CsvParser()
    reader.feed(data)
    body = "p.feed(new TextEncoder().encode(text)); return BOARD.channelNames('csv', 2, p.layout);"
    names = page.evaluate("text => { const p = BOARD.parser('csv'); " + body + "}", data.decode())
    assert names == channels_of("csv", 2, reader.layout)["channels"]
