"""Our own frames: bytes derived by hand, laws over any frames and any chunks, damage, and the encoder in C."""

import ctypes
import itertools
import math
import random
import re
import shutil
import struct
import subprocess
from pathlib import Path

import pytest
from damaged import DAMAGES, EXAMPLES, false_readings, memory_of, neighbours, received
from hypothesis import given, settings
from hypothesis import strategies as st

from edition1.errors import InputError
from edition1_live.wire.binary import KINDS, LONGEST_PACKET, RESIDUE, BinaryParser, encode_frame
from edition1_live.wire.frame import Counters, Frame, Parser

BOOK = Path(__file__).parents[3] / "book"
FIRMWARE = BOOK.parent / "firmware"
NUMBERS = st.integers(0, 2**32 - 1)
FLOATS = st.floats(width=32, allow_nan=False)


def crc_by_division(body: bytes) -> int:
    """CRC-32 from its definition: the remainder of a division of polynomials, bit by bit, highest power first."""
    bits = [byte >> i & 1 for byte in body for i in range(8)] + [0] * 32
    for i in range(32):  # initial value: all ones on the first 32 bits
        bits[i] ^= 1
    divisor = [1, *(0x04C11DB7 >> i & 1 for i in reversed(range(32)))]
    for i in range(len(bits) - 32):
        if bits[i]:
            for j, bit in enumerate(divisor):
                bits[i + j] ^= bit
    return sum((1 - bit) << i for i, bit in enumerate(bits[-32:]))


def stuffed(body: bytes) -> bytes:
    """COBS from its definition: before each run without zeros, its length plus one."""
    return b"".join(bytes([len(run) + 1]) + run for run in body.split(b"\0"))


def on_the_line(body: bytes) -> bytes:
    """Any body with a right checksum and delimiters."""
    return b"\0" + stuffed(body + crc_by_division(body).to_bytes(4, "little")) + b"\0"


@st.composite
def frames(draw, kind: str | None = None, distinct: bool = False) -> tuple[Frame, str]:
    kind = kind or draw(st.sampled_from(list(KINDS)))
    one = FLOATS if kind == "float32" else st.integers(-32768, 32767).map(float)
    values = draw(st.lists(one, min_size=1, max_size=KINDS[kind][2]))
    return Frame(draw(st.integers(0, 255)), draw(NUMBERS), draw(NUMBERS), tuple(values)), kind


def numbered(count: int, first: int = 0, stream: int = 0, channels: int = 3) -> list[Frame]:
    """Frames that differ in every number."""
    return [
        Frame(stream, i % 2**32, 1000 * i % 2**32, tuple(float(i % 4096 + j) for j in range(channels)))
        for i in range(first, first + count)
    ]


def sent(many: list[Frame]) -> bytes:
    return b"".join(encode_frame(frame) for frame in many)


def accounted(counters: Counters, stream: bytes, accepted: bytes, pending: int) -> bool:
    """Every byte is a delimiter, accepted, discarded, or of a frame begun."""
    packets = len(accepted) - accepted.count(0)
    return len(stream) - stream.count(0) == packets + counters.discarded_bytes + pending


# ---- what the page says ----


def test_golden_bytes_by_hand():
    # version 1, stream 7, float32, 1 value | sequence 1 | 1000 us = 0x3e8 | 1.0 = 0x3f800000 | CRC-32 by division
    body = bytes.fromhex("01 07 01 0101 00 00 00e8 03 00 0000 00 80 3f")
    assert crc_by_division(b"123456789") == 0xCBF43926  # the check value of the definition
    assert crc_by_division(body) == 0xEED6307D
    # zeros at 5, 6, 7, 10, 11, 12, 13 of 20: the code byte is 6, then 1, 1, 3, 1, 1, 1, and 7 to the end
    golden = bytes.fromhex("0006 010701010101 0103 e80301 01 0107 803f7d30d6ee00")
    assert on_the_line(body) == golden
    assert encode_frame(Frame(7, 1, 1000, (1.0,))) == golden
    assert BinaryParser().feed(golden) == [Frame(7, 1, 1000, (1.0,))]
    page = (BOOK / "wire_formats.md").read_text(encoding="utf-8")
    example = re.search(r"^\| frame \| (.*) \|$", page, re.MULTILINE)
    assert example
    assert bytes.fromhex(example[1].replace("`", "")) == golden


def test_golden_bytes_of_int16():
    body = bytes.fromhex("01 00 02 03ff ff ff ff15 cd 5b 07f4 ffbb 00fa f6")
    frame = Frame(0, 2**32 - 1, 123_456_789, (-12.0, 187.0, -2310.0))
    assert encode_frame(frame, "int16") == on_the_line(body)
    assert BinaryParser(3).feed(on_the_line(body)) == [frame]


@given(frames())
def test_parsing_undoes_encoding(drawn):
    frame, kind = drawn
    data = encode_frame(frame, kind)
    assert data[0] == data[-1] == 0
    assert 0 not in data[1:-1]
    assert len(data) == 19 + len(frame.values) * (4 if kind == "float32" else 2) <= LONGEST_PACKET + 2
    reader = BinaryParser()
    assert isinstance(reader, Parser)
    assert reader.feed(data) == [frame]
    assert reader.counters == Counters(frames=1)


@given(frames())
def test_the_encoder_follows_the_definitions(drawn):
    frame, kind = drawn
    letter = KINDS[kind][1]
    body = struct.pack("<BBBBII", 1, frame.stream, KINDS[kind][0], len(frame.values), *frame[1:3])
    body += b"".join(struct.pack("<" + letter, v if letter == "f" else int(v)) for v in frame.values)
    assert encode_frame(frame, kind) == on_the_line(body)


def test_missing_and_infinite_readings_pass():
    [frame] = BinaryParser().feed(encode_frame(Frame(0, 0, 0, (math.nan, math.inf, -0.0))))
    assert math.isnan(frame.values[0])
    assert frame.values[1] == math.inf
    assert math.copysign(1, frame.values[2]) == -1


def test_readings_are_rounded_to_float32():
    [frame] = BinaryParser().feed(encode_frame(Frame(0, 0, 0, (0.1, 1282.1))))
    assert frame.values == struct.unpack("<2f", struct.pack("<2f", 0.1, 1282.1))


# ---- chunks ----


@given(st.data())
def test_chunks_do_not_matter(data):
    many = [encode_frame(frame, kind) for frame, kind in data.draw(st.lists(frames(), max_size=4))]
    junk = data.draw(st.lists(st.binary(max_size=300), min_size=len(many) + 1, max_size=len(many) + 1))
    stream = b"".join(a + b for a, b in zip(junk, [*many, b""], strict=True))
    whole = BinaryParser()
    expected = whole.feed(stream)
    cuts = sorted(data.draw(st.lists(st.integers(0, len(stream)), max_size=12)))
    pieces = BinaryParser()
    received = [
        frame
        for start, end in zip([0, *cuts], [*cuts, len(stream)], strict=True)
        for frame in pieces.feed(stream[start:end])
    ]
    single = BinaryParser()
    one_by_one = [frame for i in range(len(stream)) for frame in single.feed(stream[i : i + 1])]
    assert repr(received) == repr(expected) == repr(one_by_one)  # NaN is unlike itself
    assert pieces.counters == whole.counters == single.counters


@given(st.lists(st.one_of(st.binary(max_size=600), st.just(b"\0")), max_size=20), st.integers(1, 118))
def test_no_bytes_raise_and_all_are_accounted_for(chunks, channels):
    for reader in (BinaryParser(), BinaryParser(channels)):
        for i, chunk in enumerate(chunks):
            assert reader.feed(chunk) == []
            if i % 7 == 6:
                reader.reopened()
        reader.reopened()  # nothing stays begun
        stream = b"".join(chunks)
        assert accounted(reader.counters, stream, b"", pending=0)
        assert reader.counters.frames == 0


@pytest.mark.parametrize("step", [1, 100, 1000])
def test_the_longest_packet_and_one_byte_more(step):
    def counted(packet: bytes) -> Counters:
        reader, stream = BinaryParser(), b"\0" + packet + b"\0"
        for at in range(0, len(stream), step):
            reader.feed(stream[at : at + step])
        return reader.counters

    longest = encode_frame(Frame(0, 0, 0, (1.0,) * 118), "int16")[1:-1]
    assert len(longest) == LONGEST_PACKET == 253
    assert counted(longest) == Counters(frames=1)
    assert counted(b"a" * 253) == Counters(checksum_errors=1, discarded_bytes=253)
    assert counted(b"a" * 254) == Counters(oversized=1, discarded_bytes=254)
    assert counted(longest + b"\0" + b"a" * 600) == Counters(frames=1, oversized=1, discarded_bytes=600)


def test_a_run_without_delimiters_hides_no_frame_behind_it():
    many = numbered(2)
    for junk in (b"a" * 20, b"a" * 300):
        reader = BinaryParser()
        assert reader.feed(junk[:260]) + reader.feed(junk[260:] + sent(many)) == many


# ---- damage ----


@pytest.mark.parametrize("damage", DAMAGES)
def test_no_damage_of_one_byte_passes_or_costs_a_neighbour(damage):
    before, after = neighbours("frames")
    data = encode_frame(EXAMPLES["frames"])
    tries, false = false_readings("frames", damage)
    assert tries >= len(data)
    assert false == 0
    for damaged in DAMAGES[damage](data):
        got = received("frames", damaged)
        assert got in ([before, after], [before, EXAMPLES["frames"], after])


def test_no_two_flipped_bits_pass():
    data = encode_frame(EXAMPLES["frames"])
    assert len(data) == 31
    reader = BinaryParser()
    assert reader.feed(data) == [EXAMPLES["frames"]]
    got, inner = [], 8 * 29
    for first in range(inner):
        for second in range(first):
            damaged = bytearray(data)
            damaged[1 + first // 8] ^= 1 << first % 8
            damaged[1 + second // 8] ^= 1 << second % 8
            got += reader.feed(bytes(damaged))
    assert got == []
    counters = reader.counters
    assert counters.frames == 1
    # A flip to zero cuts a packet in two.
    assert counters.checksum_errors >= inner * (inner - 1) // 2


@given(st.data())
def test_any_damage_to_a_frame_loses_only_that_frame(data):
    frame, kind = data.draw(frames())
    packet = encode_frame(frame, kind)[1:-1]
    damaged = bytearray(packet)
    for _ in range(data.draw(st.integers(1, 5))):
        place = data.draw(st.integers(0, len(damaged) - 1))
        change = data.draw(st.sampled_from(["flip", "lose", "double", "set"]))
        if change == "flip":
            damaged[place] ^= 1 << data.draw(st.integers(0, 7))
        elif change == "set":
            damaged[place] = data.draw(st.integers(0, 255))
        elif change == "double":
            damaged.insert(place, damaged[place])
        elif len(damaged) > 1:
            del damaged[place]
    reader = BinaryParser()
    first, last = numbered(2, stream=(frame.stream + 1) % 256)
    got = reader.feed(sent([first]) + b"\0" + damaged + b"\0" + sent([last]))
    assert got == ([first, frame, last] if damaged == packet else [first, last])
    assert reader.counters.gaps == 0


def test_a_damaged_stream_delivers_every_intact_frame_once_and_in_order():
    """Flips, losses, doubled bytes and junk at one byte in 200; what is intact is decided byte by byte."""
    rng = random.Random(4)
    many = numbered(1500, first=2**32 - 500)
    stream, intact = bytearray(), []
    for frame in many:
        data, whole = encode_frame(frame), True
        for byte in data:
            chance = rng.random() * 200
            if chance >= 1:
                stream.append(byte)
                continue
            whole = False
            if chance < 0.25:
                stream.append(byte ^ 1 << rng.randrange(8))
            elif chance < 0.5:
                stream += bytes([byte, byte])
            elif chance < 0.75:
                stream += bytes([byte]) + rng.randbytes(rng.randrange(1, 600))
        if whole:
            intact.append(frame)
    reader, got, at = BinaryParser(3), [], 0
    while at < len(stream):
        step = rng.randrange(1, 900)
        got += reader.feed(bytes(stream[at : at + step]))
        at += step
    assert 1000 < len(intact) < 1450
    place = {frame: number for number, frame in enumerate(many)}
    places = [place[frame] for frame in got]  # nothing that was not sent
    assert set(intact) <= set(got)
    assert places == sorted(set(places))  # in order, none twice
    counters = reader.counters
    assert counters.frames == len(got)
    assert counters.gaps + len(got) == places[-1] - places[0] + 1
    assert counters.restarts == counters.repeats == counters.malformed == 0
    assert counters.oversized > 0
    reader.reopened()
    assert accounted(counters, bytes(stream), sent(got), pending=0)


# ---- opening, sequence numbers ----


def test_the_first_packet_after_an_opening_may_be_a_part():
    first, second, third = (encode_frame(frame) for frame in numbered(3))
    reader = BinaryParser()
    assert reader.feed(first[9:] + second) == [numbered(3)[1]]
    assert reader.counters == Counters(frames=1, first_partial=1, discarded_bytes=len(first[9:]) - 1)
    reader.feed(third[:12])
    reader.reopened()
    assert reader.feed(third[20:] + third) == [numbered(3)[2]]
    discarded = len(first[9:]) - 1 + 11 + len(third[20:]) - 1
    assert reader.counters == Counters(frames=2, first_partial=2, discarded_bytes=discarded)


def test_an_opening_between_two_frames_loses_nothing():
    first, second = numbered(2)
    for skipped in (0, 1):  # before the delimiter, or behind it
        reader = BinaryParser()
        assert reader.feed(sent([first, second])[skipped:]) == [first, second]
        assert reader.counters == Counters(frames=2)


@pytest.mark.parametrize(
    ("sequences", "gaps", "restarts"),
    [
        ([5, 6, 7], 0, 0),
        ([5, 7], 1, 0),
        ([5, 8, 20], 2 + 11, 0),
        ([2**32 - 1, 0], 0, 0),
        ([2**32 - 2, 1], 2, 0),
        ([900, 0, 1], 0, 1),
        ([900, 899], 0, 1),
        ([2**31 + 5, 4], 2**31 - 2, 0),  # less than half the circle ahead
        ([5, 2**31 + 5], 0, 1),
        ([5, 2**31 + 4], 2**31 - 2, 0),
    ],
)
def test_gaps_and_restarts(sequences, gaps, restarts):
    many = [Frame(0, sequence, i, (0.0,)) for i, sequence in enumerate(sequences)]
    reader = BinaryParser()
    assert reader.feed(sent(many)) == many
    assert reader.counters == Counters(frames=len(many), gaps=gaps, restarts=restarts)


def test_streams_count_by_themselves():
    a, b = numbered(4, first=10, stream=1), numbered(4, first=90, stream=2)
    reader = BinaryParser()
    assert reader.feed(sent([a[0], b[0], a[1], b[2], a[2], b[3], a[3]])) == [
        *(a[0], b[0], a[1], b[2], a[2], b[3], a[3])
    ]
    assert reader.counters == Counters(frames=7, gaps=1)


def test_a_frame_sent_twice_is_delivered_once():
    first, second = numbered(2)
    reader = BinaryParser()
    assert reader.feed(sent([first, first])) == [first]
    reader.reopened()
    assert reader.feed(sent([first, second])) == [second]
    size = len(sent([first])) - 2
    assert reader.counters == Counters(frames=2, repeats=2, discarded_bytes=2 * size)


def test_the_same_number_with_another_content_is_a_restart():
    first, other = Frame(0, 0, 10, (1.0,)), Frame(0, 0, 12, (1.0,))
    reader = BinaryParser()
    assert reader.feed(sent([first, other])) == [first, other]
    assert reader.counters == Counters(frames=2, restarts=1)


def test_gaps_are_followed_across_an_interruption():
    many = numbered(10)
    reader = BinaryParser()
    reader.feed(sent(many[:3]))
    reader.reopened()
    assert reader.feed(sent(many[7:])) == many[7:]
    assert reader.counters == Counters(frames=6, gaps=4)


# ---- what is refused ----


@pytest.mark.parametrize(
    "body",
    [
        "02 00 01 01 00000000 00000000 00000000",  # a version to come
        "00 00 01 01 00000000 00000000 00000000",
        "01 00 03 01 00000000 00000000 00000000",  # an unknown type
        "01 00 01 02 00000000 00000000 00000000",  # two values announced, one there
        "01 00 01 00 00000000 00000000",  # none
        "01 00 02 01 00000000 00000000 00000000",  # an int16 of four bytes
        "01 00 01",
        "",
    ],
)
def test_a_right_checksum_is_not_enough(body):
    data = on_the_line(bytes.fromhex(body))
    reader = BinaryParser()
    assert reader.feed(data) == []
    assert reader.counters == Counters(malformed=1, discarded_bytes=len(data) - 2)


def test_the_number_of_channels_can_be_asked_for():
    three, two = Frame(0, 0, 0, (1.0, 2.0, 3.0)), Frame(0, 1, 0, (1.0, 2.0))
    reader = BinaryParser(3)
    assert reader.feed(sent([three, two])) == [three]
    assert (reader.counters.frames, reader.counters.malformed) == (1, 1)
    assert BinaryParser().feed(sent([three, two])) == [three, two]


def test_the_residue_is_that_of_any_body():
    body = b"any bytes"
    assert crc_by_division(body + crc_by_division(body).to_bytes(4, "little")) == RESIDUE


@pytest.mark.parametrize(
    ("frame", "kind", "message"),
    [
        (
            Frame(0, 0, 0, (1.0,)),
            "int8",
            "kind of encode_frame must be float32 or int16; instead received int8.",
        ),
        (Frame(256, 0, 0, (1.0,)), "int16", "stream of encode_frame must be 0 to 255; instead received 256."),
        (
            Frame(0, None, 0, (1.0,)),
            "int16",
            "sequence of encode_frame must be a number of 32 bits without sign; instead received None.",
        ),
        (
            Frame(0, 0, 2**32, (1.0,)),
            "int16",
            "device_us of encode_frame must be a number of 32 bits without sign; instead received 4294967296.",
        ),
        (
            Frame(0, 0, 0, ()),
            "int16",
            "values of encode_frame must be 1 to 118 of int16; instead received 0.",
        ),
        (
            Frame(0, 0, 0, (0.0,) * 60),
            "float32",
            "values of encode_frame must be 1 to 59 of float32; instead received 60.",
        ),
        (
            Frame(0, 0, 0, (0.5,)),
            "int16",
            "values of encode_frame must be numbers that int16 holds; instead received (0.5,).",
        ),
        (
            Frame(0, 0, 0, (math.nan,)),
            "int16",
            "values of encode_frame must be numbers that int16 holds; instead received (nan,).",
        ),
        (
            Frame(0, 0, 0, (32768.0,)),
            "int16",
            "values of encode_frame must be numbers that int16 holds; instead received (32768.0,).",
        ),
        (
            Frame(0, 0, 0, (1e39,)),
            "float32",
            "values of encode_frame must be numbers that float32 holds; instead received (1e+39,).",
        ),
    ],
)
def test_what_does_not_fit_is_refused(frame, kind, message):
    with pytest.raises(InputError) as refused:
        encode_frame(frame, kind)
    assert str(refused.value) == "Input " + message


# ---- memory, speed ----


@pytest.mark.parametrize("channels", [None, 3])
def test_memory_stays_bounded_without_delimiters(channels):
    reader, chunk = BinaryParser(channels), bytes(range(1, 256)) * 16
    reader.feed(chunk)
    held, peak = memory_of(reader, chunk, 2000)
    assert held < 10_000
    assert peak < 10 * len(chunk)
    counters = reader.counters
    assert counters == Counters(oversized=1, discarded_bytes=2001 * len(chunk))
    [frame] = numbered(1)
    assert reader.feed(sent([frame, frame._replace(sequence=1)]))[-1].sequence == 1


def test_garbage_shows_at_once():
    """A wrong baud rate: bytes arrive, no frame does, and the counters say so before 2 s are over."""
    reader = BinaryParser()
    assert reader.feed(random.Random(0).randbytes(2000)) == []
    counters = reader.counters
    assert counters.frames == 0
    assert counters.discarded_bytes > 1000
    assert counters.checksum_errors + counters.first_partial + counters.oversized > 3


# ---- the encoder in C ----


def compiler(*names: str) -> str:
    found = next((name for name in names if shutil.which(name)), None)
    if found is None:
        pytest.skip(f"No compiler: none of {', '.join(names)} is installed.")
    return found


@pytest.fixture(scope="module")
def c_encoder(tmp_path_factory):
    library = tmp_path_factory.mktemp("c") / "frame_encoder.so"
    flags = ["-std=c99", "-Wall", "-Wextra", "-Wpedantic", "-Wconversion", "-Werror", "-shared", "-fPIC"]
    done = subprocess.run(
        [compiler("cc", "gcc", "clang"), *flags, str(FIRMWARE / "frame_encoder.c"), "-o", str(library)],
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    function = ctypes.CDLL(str(library)).encode_frame
    function.restype = ctypes.c_size_t
    u8, u32 = ctypes.c_uint8, ctypes.c_uint32
    function.argtypes = [ctypes.c_char_p, u8, u8, ctypes.c_void_p, u8, u32, u32]

    def call(frame: Frame, code: int, letter: str) -> bytes:
        out = ctypes.create_string_buffer(b"\xaa" * 300, 300)
        values = (ctypes.c_float if letter == "f" else ctypes.c_int16)(0).__class__ * max(
            len(frame.values), 1
        )
        numbers = frame.values if letter == "f" else map(int, frame.values)
        length = function(
            out, frame.stream, code, values(*numbers), len(frame.values), frame.sequence, frame.device_us
        )
        assert out.raw[max(length, 255) :] == b"\xaa" * (300 - max(length, 255))
        return out.raw[:length]

    return call


@settings(max_examples=300)
@given(drawn=frames())
def test_the_c_encoder_writes_the_same_bytes(c_encoder, drawn):
    frame, kind = drawn
    code, letter, _ = KINDS[kind]
    data = c_encoder(frame, code, letter)
    assert data == encode_frame(frame, kind)
    assert BinaryParser().feed(data) == [frame]


def test_the_c_encoder_refuses_what_does_not_fit(c_encoder):
    assert c_encoder(Frame(0, 0, 0, ()), 1, "f") == b""
    assert c_encoder(Frame(0, 0, 0, (0.0,) * 60), 1, "f") == b""
    assert c_encoder(Frame(0, 0, 0, (0.0,) * 119), 2, "h") == b""
    assert c_encoder(Frame(0, 0, 0, (0.0,)), 3, "f") == b""
    assert len(c_encoder(Frame(0, 0, 0, (0.0,) * 59), 1, "f")) == 255


def test_the_c_encoder_has_at_most_40_lines():
    assert len((FIRMWARE / "frame_encoder.c").read_text(encoding="utf-8").splitlines()) <= 40


ARDUINO = """
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>
static struct {
  void begin(long) {}
  size_t write(const uint8_t *data, size_t size) { return fwrite(data, 1, size, stdout); }
} Serial;
enum { A0, A1, A2 };
inline int analogRead(int pin) { return 100 * pin + 7; }
static uint32_t now = 3999999999ul;
static uint32_t micros() { return ++now; }
"""
WIRE = """
static struct {
  int address, first, count, at, resets;
  void begin() {}
  void setClock(long) {}
  void beginTransmission(int a) { address = a; }
  size_t write(const uint8_t *data, size_t size) { first = data[0]; return size; }
  int endTransmission(bool) { return address == 0x0E ? 2 : 0; }
  int requestFrom(int, int n) { at = 0; return n; }
  int read() {
    static const int mt[] = {0, 1000 >> 8, 1000 & 255, -2000 >> 8 & 255, -2000 & 255, 3000 >> 8, 3000 & 255};
    if (at > 0) return mt[at++];
    at++;
    return address == 0x0F && first == 0x3E && ++resets == 2 ? 0x04 : 0x01;
  }
} Wire;
"""


def sent_by(sketch: str, folder: Path) -> bytes:
    """Compile a sketch with a board that is made up, as strictly as may be, and return what three rounds send."""
    for name in ("frame_encoder.c", "frame_encoder.h"):
        shutil.copy(FIRMWARE / name, folder)
    source = ARDUINO + sketch + "int main() { setup(); for (int i = 0; i < 3; i++) loop(); return 0; }\n"
    (folder / "sketch.cpp").write_text(source, encoding="utf-8")
    (folder / "Wire.h").write_text(WIRE, encoding="utf-8")
    sources = ["-I.", "sketch.cpp", "-x", "c++", "frame_encoder.c"]
    build = [compiler("c++", "g++", "clang++"), "-Wall", "-Wextra", "-Werror", *sources, "-o", "sketch"]
    done = subprocess.run(build, cwd=folder, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return subprocess.run([str(folder / "sketch")], capture_output=True, check=True).stdout


def test_the_sketch_of_the_page_sends_frames(tmp_path):
    page = (BOOK / "wire_formats.md").read_text(encoding="utf-8")
    sketch = re.search(r"```cpp\n(.*?)```", page, re.DOTALL)
    assert sketch
    expected = [Frame(0, i, 4_000_000_000 + i, (7.0, 107.0, 207.0)) for i in range(3)]
    assert BinaryParser(3).feed(sent_by(sketch[1], tmp_path)) == expected


def test_the_example_sends_the_field_and_what_is_missing(tmp_path):
    """Four sensors, of which the third does not answer and the fourth says after the first round that it was reset."""
    sketch = (FIRMWARE / "firmware.ino").read_text(encoding="utf-8")
    frames = BinaryParser(12).feed(sent_by(sketch, tmp_path))
    assert [frame.sequence for frame in frames] == [0, 1, 2]
    assert all(abs(later[2] - frame[2] - 10_000) <= 1 for frame, later in itertools.pairwise(frames))
    mt = [1.502e-3 * 1000, 1.502e-3 * -2000, 2.420e-3 * 3000]
    missing = [math.nan] * 3
    for frame, fourth in zip(frames, (mt, missing, mt), strict=True):
        assert frame.values == pytest.approx([*mt, *mt, *missing, *fourth], rel=1e-6, nan_ok=True)
