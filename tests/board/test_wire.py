"""Frames and lines of text: laws over any bytes and any chunks, damage, and what boards print."""

import itertools
import math
import re
from zlib import crc32

import numpy as np
import pytest
from cobs import cobs
from hypothesis import given
from hypothesis import strategies as st

from repro import InputError
from repro_board.wire import COUNTERS, FORMATS, WRAP, Parser, encode, is_text, text_line

FLOATS = st.lists(st.floats(width=32, allow_nan=False), min_size=1, max_size=59)
INTEGERS = st.lists(st.integers(-32768, 32767), min_size=1, max_size=118)
WORDS32 = st.integers(0, WRAP - 1)
TURN = (0.0625, -0.25, 0.5, (1 - 0.0625**2 - 0.25**2 - 0.5**2) ** 0.5)
EXAMPLES = {
    "frames": (1282.125, 1205.0625, 1387.4375),
    "csv": (1.25, -3.5, 0.0625),
    "hall": (-12.0, 187.0, -2310.0),
    "millivolts": (1282.125, 1205.0625, 1387.4375),
    "quaternions": TURN,
}


def counted(**expected: int) -> dict[str, int]:
    return dict.fromkeys(COUNTERS, 0) | expected


def sent(count: int, first: int = 0, stream: int = 0) -> bytes:
    """Frames that differ in every number."""
    return b"".join(encode([k % 4096, k + 1, 0.5], stream, k, 1000 * k) for k in range(first, first + count))


def sequences(samples) -> list[int | None]:
    return [sample.sequence for sample in samples]


def rows(samples) -> list[list[float]]:
    return [sample.values.tolist() for sample in samples]


def lines(*printed: str, channels: int | None = None, first: str = "", format: str | None = "csv"):
    """A parser that was given lines behind the first line of its port, and the samples that came out."""
    parser = Parser(format, channels)
    return parser, parser.feed((first + "\n" + "".join(f"{line}\r\n" for line in printed)).encode())


def one(format: str, values, sequence: int = 0) -> bytes:
    if format == "frames":
        return encode(values, 0, sequence, 123_456_789)
    return text_line(values, format, 3 if format == "quaternions" else 0)


def with_checksum(body: bytes) -> bytes:
    return b"\0" + cobs.encode(body + crc32(body).to_bytes(4, "little")) + b"\0"


# ---- frames ----


@given(FLOATS, st.integers(0, 255), WORDS32, WORDS32)
def test_parsing_undoes_encoding(values, stream, sequence, time_us):
    (sample,) = Parser("frames").feed(encode(values, stream, sequence, time_us))
    assert sample[:4] == (stream, sequence, time_us, 1)
    assert rows([sample]) == [values]


@given(INTEGERS)
def test_whole_numbers_come_back(values):
    assert rows(Parser().feed(encode(values, kind="int16"))) == [values]


def test_a_missing_reading_passes_as_nan():
    (sample,) = Parser().feed(encode([math.nan, -math.inf, 1]))
    assert repr(rows([sample])) == "[[nan, -inf, 1.0]]"


@pytest.mark.parametrize(
    ("given_values", "message"),
    [
        (([1.0], 256), "stream of a frame must be 0 to 255; instead received 256."),
        (([], 0), "values of a frame must be 1 to 59 of float32; instead received 0."),
        (([0.0] * 60, 0), "values of a frame must be 1 to 59 of float32; instead received 60."),
        (([1e39], 0), "values of a frame must be numbers that float32 holds; instead received [1.e+39]."),
        (([0.5], 0, 0, 0, "int16"), "values of a frame must be numbers that int16 holds; instead received [0.5]."),
        (([1], 0, -1), "sequence, time_us of a frame must be not negative; instead received (-1, 0)."),
        (([1], 0, 0, 0, "int8"), "kind of a frame must be float32 or int16; instead received 'int8'."),
    ],
)  # fmt: skip
def test_what_a_frame_cannot_hold_is_refused(given_values, message):
    with pytest.raises(InputError) as refused:
        encode(*given_values)
    assert str(refused.value) == f"Input {message}"


def in_pieces(parser, data, cuts):
    """Return the samples of bytes that arrive cut in some places."""
    edges = [0, *sorted(cut for cut in cuts if cut < len(data)), len(data)]
    return [sample for a, b in itertools.pairwise(edges) for sample in parser.feed(data[a:b])]


@given(st.binary(max_size=400), st.lists(st.integers(0, 500), max_size=10), st.sampled_from([None, "frames"]))
def test_chunks_do_not_matter_and_every_byte_is_accounted_for(garbage, cuts, format):
    data = sent(3) + garbage + sent(3, 3) + garbage[::-1] + sent(2, 6)
    whole, pieces, accepted = Parser(format), Parser(format), 0
    expected = whole.feed(data)
    for sample in expected:
        end = data.find(b"\0", sample.start)
        accepted += end - sample.start
    assert repr(in_pieces(pieces, data, cuts)) == repr(expected)
    assert pieces.counters == whole.counters
    whole.close()
    assert whole.counters["frames"] == len(expected)
    assert accepted + whole.counters["discarded_bytes"] == len(data) - data.count(0)


@pytest.mark.parametrize("change", ["flip", "lose", "double"])
def test_no_damage_of_one_byte_passes_or_costs_a_neighbour(change):
    frame = encode(EXAMPLES["frames"], 0, 5)
    for place in range(len(frame)):
        for bit in range(8 if change == "flip" else 1):
            middle = {
                "flip": bytes([frame[place] ^ 1 << bit]),
                "lose": b"",
                "double": frame[place : place + 1] * 2,
            }
            damaged = frame[:place] + middle[change] + frame[place + 1 :]
            got = sequences(Parser().feed(sent(1, 4) + damaged + sent(1, 6)))
            assert got in ([4, 6], [4, 5, 6])
            assert (got == [4, 6]) or place in (0, len(frame) - 1)


@pytest.mark.parametrize(
    ("numbers", "gaps", "restarts"),
    [
        ([0, 1, 2], 0, 0),
        ([5, 6, 9], 2, 0),
        ([WRAP - 1, 0, 1], 0, 0),
        ([WRAP - 2, 1], 2, 0),
        ([9, 0, 1], 0, 1),
        ([0, WRAP // 2 - 1], WRAP // 2 - 2, 0),
        ([0, WRAP // 2], 0, 1),
    ],
)
def test_gaps_and_restarts(numbers, gaps, restarts):
    parser = Parser("frames")
    assert sequences(parser.feed(b"".join(encode([1], 3, k, k) for k in numbers))) == numbers
    assert parser.counters == counted(frames=len(numbers), gaps=gaps, restarts=restarts)


def test_streams_count_by_themselves_and_across_an_interruption():
    parser = Parser("frames")
    parser.feed(b"".join(encode([1], stream, 10 * stream) for stream in (0, 1, 2)))
    parser.reopened()
    parser.feed(encode([1], 1, 13))
    assert parser.counters == counted(frames=4, gaps=2)


def test_a_frame_sent_twice_is_one_and_the_same_number_with_another_content_is_a_restart():
    parser, frame = Parser("frames"), encode([1], 0, 5, 7)
    assert len(parser.feed(frame + frame)) == 1
    assert parser.counters == counted(frames=1, repeats=1, discarded_bytes=len(frame) - 2)
    assert len(parser.feed(encode([2], 0, 5, 8))) == 1
    assert parser.counters["restarts"] == 1


def test_the_clock_goes_on_over_its_wraps_and_begins_again_with_the_board():
    times = [WRAP - 2000, WRAP - 1000, 500, 1500]
    frames = b"".join(encode([1], 0, k, t) for k, t in enumerate(times))
    samples = Parser().feed(frames + encode([1], 0, 0, 3) + encode([1], 0, 1, 7))
    assert [sample.time_us for sample in samples] == [*times[:2], WRAP + 500, WRAP + 1500, 3, 7]
    assert [s.time_us for s in Parser().feed(encode([1], 0, 1, 10**9) + encode([1], 0, 2, 5))] == [10**9, 5]


@pytest.mark.parametrize(
    "body",
    [
        b"\x02\x00\x01\x01" + bytes(12),  # version
        b"\x01\x00\x03\x01" + bytes(12),  # type
        b"\x01\x00\x01\x00" + bytes(8),  # no value
        b"\x01\x00\x01\x02" + bytes(12),  # length
        b"\x01",
        b"",
    ],
)
def test_a_right_checksum_is_not_enough(body):
    parser = Parser("frames")
    assert parser.feed(sent(1) + with_checksum(body)) == [] or parser.counters["frames"] == 1
    assert parser.counters["malformed"] == 1


def test_channels_leave_other_frames_out():
    parser = Parser("frames", 2)
    assert rows(parser.feed(encode([1, 2]) + encode([1, 2, 3], 4, 1))) == [[1, 2]]
    assert parser.counters["malformed"] == 1
    assert parser.remarks == ["Left out were frames of another version or number of values (3 in stream 4)."]


def test_the_longest_frame_passes_and_a_run_without_delimiters_hides_none_behind_it():
    parser, longest = Parser("frames"), encode([1.5] * 59)
    assert len(longest) == 255
    assert len(parser.feed(longest)) == 1
    for _ in range(100):
        parser.feed(b"\1" * 300)
    assert sequences(parser.feed(b"\1\0" + sent(2, 1))) == [1, 2]
    assert parser.counters == counted(frames=3, oversized=1, discarded_bytes=30_001)
    parser.feed(b"\1" * 254 + b"\0" + b"\1" * 253 + b"\0")
    assert (parser.counters["oversized"], parser.counters["checksum_errors"]) == (2, 1)


def test_the_first_packet_after_an_opening_may_be_a_part():
    parser = Parser("frames")
    parser.feed(sent(1)[5:] + sent(1, 1))
    assert parser.counters["first_partial"] == 1
    parser.feed(sent(1, 2)[:9])
    parser.reopened()
    assert sequences(parser.feed(sent(1, 3))) == [3]
    assert parser.counters["checksum_errors"] == 0


def test_text_among_frames_is_told_and_costs_none():
    parser = Parser("frames")
    assert sequences(parser.feed(sent(2) + b"Sensor 3 does not answer\r\n" + sent(2, 2))) == [0, 1, 2, 3]
    assert parser.counters["checksum_errors"] == 1
    assert parser.remarks == ["Text arrives among the frames: a board that prints lines has the format csv."]


def test_a_line_without_an_end_costs_no_more_than_its_bytes():
    """A search that began anew at each letter would take hours here."""
    parser = Parser()
    for _ in range(64):
        parser.feed(b"1.5,2.5," * 2048)
    assert parser.counters["discarded_bytes"] == 1 << 20
    assert (parser.counters["oversized"], parser.counters["frames"]) == (1, 0)


@pytest.mark.parametrize("format", ["csv", "hall", "millivolts", "quaternions"])
def test_frames_where_lines_are_stated_are_told(format):
    said = f"Frames arrive among the lines: their format is frames, not {format}."
    parser = Parser(format)
    for k in range(5):
        assert parser.feed(sent(1, k)) == []
    assert parser.remarks.count(said) == 1
    lines = Parser(format)
    for k in range(5):
        lines.feed(one(format, EXAMPLES[format], k) + b"\0")
    assert said not in lines.remarks


# ---- which format ----


@pytest.mark.parametrize("cut", [0, 1, 7, 30])
def test_frames_are_recognised_behind_what_a_board_prints_when_it_starts(cut):
    parser = Parser()
    boot = (
        b"ets Jul 29 2019 12:21:46\r\nrst:0x1 (POWERON_RESET)\r\nload:0x3fff0030,len:1184\r\nho 0 tail 12\r\n"
    )
    assert parser.feed(boot[cut:]) == []
    assert parser.format is None
    assert sequences(parser.feed(sent(2))) == [0, 1]
    assert parser.format == "frames"


@pytest.mark.parametrize(
    ("format", "expected"),
    [
        ("frames", "frames"),
        ("csv", "csv"),
        ("quaternions", "quaternions"),
        ("hall", "csv"),
        ("millivolts", "csv"),
    ],
)
def test_a_format_is_recognised(format, expected):
    parser = Parser()
    for k in range(5):
        parser.feed(one(format, EXAMPLES[format], k))
    assert parser.format == expected
    assert parser.counters["frames"] == (5 if format == "frames" else 4)


def test_what_is_nothing_is_said():
    parser = Parser()
    parser.feed(np.random.default_rng(0).bytes(20_000))
    assert parser.format is None
    assert parser.remarks[-1] == "No frame and no lines of numbers arrive: are baud rate and format right?"


@pytest.mark.parametrize(
    ("given_format", "message"),
    [
        (("x",), "must be one of frames, csv, hall, millivolts, quaternions; instead received 'x'"),
        (("hall", 4), "channels of hall must be 3; instead received 4"),
        (("frames", 0), "channels of frames must be 1 to 118; instead received 0"),
    ],
)
def test_there_is_no_other_format_or_width(given_format, message):
    with pytest.raises(InputError, match=message):
        Parser(*given_format)


@pytest.mark.parametrize("format", [None, "frames", "csv", "millivolts"])
def test_a_sample_has_up_to_118_values(format):
    for channels in (1, 118):
        assert Parser(format, channels).format == format
    for channels in (0, 119):
        with pytest.raises(InputError, match=f"must be 1 to 118; instead received {channels}"):
            Parser(format, channels)
    assert [len(lines(*[",".join(["1.5"] * n)] * 3)[1]) for n in (118, 119)] == [3, 0]


# ---- lines of the papers ----


@pytest.mark.parametrize(
    ("format", "line", "stream", "values"),
    [
        ("hall", "-12,187,-2310", 0, [-12, 187, -2310]),
        ("hall", "0,8191,-8192", 0, [0, 8191, -8192]),
        ("millivolts", "1282.1250,0,2048", 0, [1282.125, 0, 2048]),
        ("quaternions", "255,0.826797,0.0625,-0.25,0.5", 255, [0.0625, -0.25, 0.5, 0.826797]),
        ("quaternions", "1, 1.0000, 0.0005, -0.0027, -0.0017", 1, [0.0005, -0.0027, -0.0017, 1]),
    ],
)
def test_a_line_of_a_paper_is_read(format, line, stream, values):
    parser, samples = lines(line, format=format)
    assert [(sample.stream, sample.values.tolist()) for sample in samples] == [(stream, values)]
    assert parser.counters["frames"] == 1


@pytest.mark.parametrize(
    ("format", "line"),
    [
        *(("hall", x) for x in ("1,2", "1,2,3,4", "1,,3", "1,2,3,", "1.0,2,3", "1, 2,3", "+1,2,3", "01,2,3")),
        *(("hall", x) for x in ("-0,2,3", "8192,0,0", "0,-8193,0", "1e2,2,3", "nan,2,3", "1_0,2,3", "\x00,2,3")),
        *(("millivolts", x) for x in ("1.0,2.0", "nan,1.0,1.0", "inf,1,1", "-0.5,1,1", "2048.1,1,1", "1.,2,3")),
        *(("millivolts", x) for x in (".5,1,1", "1e999,1,1", "1_000,1,1", "0x10,1,1", "1,5,2,5,3,5")),
        *(("quaternions", x) for x in ("0,0,0,0,0", "1,0,0,0", "256,1,0,0,0", "-1,1,0,0,0", "1.0,1,0,0,0")),
        *(("quaternions", x) for x in ("0,nan,0,0,1", "0,0.71,0.71,0,0", "0,1.0011,0,0,0", "0,0.9989,0,0,0")),
    ],
)  # fmt: skip
def test_a_line_that_is_none_of_a_paper_is_counted_and_never_data(format, line):
    parser, samples = lines(line, format=format)
    assert samples == []
    assert (parser.counters["malformed"], parser.counters["frames"]) == (1, 0)


@pytest.mark.parametrize("format", FORMATS[1:])
def test_what_is_written_is_read(format):
    parser = Parser(format)
    samples = parser.feed(b"\n" + 3 * one(format, EXAMPLES[format]))
    np.testing.assert_allclose(
        rows(samples), [EXAMPLES[format]] * 3, atol=1e-6 if format == "quaternions" else 0
    )
    assert samples[0].stream == (3 if format == "quaternions" else 0)


@pytest.mark.parametrize("format", FORMATS[1:])
def test_what_a_line_cannot_hold_is_not_written(format):
    good = EXAMPLES[format]
    infinite, large = (*good[1:], math.inf), [3e4] * len(good)
    for values, stream in [
        ((), 0),
        (infinite, 0),
        (large, 256),
        (good, 256 if format == "quaternions" else 1),
    ]:
        with pytest.raises(InputError):
            text_line(values, format, stream)


# ---- lines of numbers ----


@pytest.mark.parametrize(
    ("line", "values", "names", "units"),
    [
        ("1.2,-3.4,5e-2", [1.2, -3.4, 0.05], (), ()),
        ("  12,   7, 100", [12, 7, 100], (), ()),
        ("1.2;-3.4;+5", [1.2, -3.4, 5], (), ()),
        ("1.2\t-3.4\t.5", [1.2, -3.4, 0.5], (), ()),
        ("1.2 -3.4  5.", [1.2, -3.4, 5], (), ()),
        ("1,2,3,", [1, 2, 3], (), ()),
        ("512", [512], (), ()),
        ("X: 1.2 uT, Y: -3 uT", [1.2, -3], ("X", "Y"), ("uT", "uT")),
        ("x=1.2 y=3", [1.2, 3], ("x", "y"), ("", "")),
        ("x:1.2,y:3", [1.2, 3], ("x", "y"), ("", "")),
        ("u1: 1.5\tu2: 2\t", [1.5, 2], ("u1", "u2"), ("", "")),
        ("X: 0.12   Y: 3.4   Z: 5.6 uT", [0.12, 3.4, 5.6], ("X", "Y", "Z"), ("uT", "uT", "uT")),
        ("X: 0.12 \tY: 3.4 \tZ: 1.2 m/s^2 ", [0.12, 3.4, 1.2], ("X", "Y", "Z"), ("m/s^2",) * 3),
        ("Mag X: 1 uT; Mag Y: 2 uT", [1, 2], ("Mag X", "Mag Y"), ("uT", "uT")),
        ("x: 1.5 µT, y: 2 µT", [1.5, 2], ("x", "y"), ("uT", "uT")),
        ("x: 1.5 Gauss, y: 2 Gauss", [1.5, 2], ("x", "y"), ("gauss", "gauss")),
        ("Bx (mT) = .5, By (mT) = -1", [0.5, -1], ("Bx", "By"), ("mT", "mT")),
        ("Sensor 1: 5.2, Sensor 2: 3", [5.2, 3], ("Sensor 1", "Sensor 2"), ("", "")),
        ("Sensor 1: 5.2 Sensor 2: 3", [5.2, 3], ("Sensor 1", "Sensor 2"), ("", "")),
        ("1.2 mT 3 mT", [1.2, 3], ("u1", "u2"), ("mT", "mT")),
        ("a=1,a=2", [1, 2], ("u1", "u2"), ("", "")),
        ("(-2.1, 3)", [-2.1, 3], (), ()),
        ("[-2.1, 3]", [-2.1, 3], (), ()),
        (r"b'-2.1,3\r\n'", [-2.1, 3], (), ()),
        ('{"u1": -2.1, "u2": null, "u3": 4}', [-2.1, math.nan, 4], ("u1", "u2", "u3"), ("", "", "")),
    ],
)
def test_a_line_of_a_sketch_is_read(line, values, names, units):
    for format in (None, "csv"):
        parser, samples = lines(*[line] * 3, format=format)
        np.testing.assert_array_equal(rows(samples), [values] * 3)
        assert (parser.format, parser.names, parser.units) == ("csv", names, units)
        assert parser.counters == counted(frames=3, first_partial=1, discarded_bytes=0)


@pytest.mark.parametrize(
    ("header", "line", "values", "time_us"),
    [
        ("time_ms,X (uT),Y (uT)", "12,1,2", [1, 2], 12_000),
        ("X,Y,time [s]", "1,2,0.25", [1, 2], 250_000),
        ("millis x y", "7 1 2", [1, 2], 7000),
        ("micros;x;y", "7;1;2", [1, 2], 7),
        ("", "t: 5 ms, T: 23.4 °C, Bx: .5", [23.4, 0.5], 5000),
        ("t,x,y", "5,1,2", [1, 2], None),  # a time without a unit
        ("T,x,y", "5,1,2", [5, 1, 2], None),  # a temperature
        ("time_ms,x", "5,1,2", [5, 1, 2], None),  # names of another number of columns
        ("Sensor found", "5,1", [5, 1], None),  # not separated as the numbers are
    ],
)
def test_times_have_a_name_and_a_unit(header, line, values, time_us):
    parser, samples = lines(*([header] if header else []), *[line] * 3)
    assert rows(samples) == [values] * 3
    assert [sample.time_us for sample in samples] == [time_us] * 3
    assert bool(parser.remarks) == (header in ("t,x,y", "time_ms,x"))


def test_a_clock_of_milliseconds_wraps_where_its_32_bits_end():
    _, samples = lines("millis,x", f"{WRAP - 100},1", f"{WRAP - 50},2", "0,3", "50,4")
    assert [x.time_us for x in samples] == [1000 * (WRAP - 100 + 50 * k) for k in range(4)]
    _, samples = lines("millis,x", "70000,1", "70050,2", "20,3", "70,4")  # a reset
    assert [sample.time_us for sample in samples] == [70_000_000, 70_050_000, 20_000, 70_000]


@pytest.mark.parametrize(
    "word",
    [
        "nan",
        "NaN",
        "-nan",
        "inf",
        "-INF",
        "ovf",
        "NA",
        "N/A",
        "#N/A",
        "null",
        "NULL",
        "none",
        "-",
        "--",
        "1.#QNAN",
    ],
)
def test_a_word_for_a_missing_reading_is_nan(word):
    parser, samples = lines("1,2,3", "1,2,3", "1,2,3", f"1,{word},3", f"1,2, {word}")
    assert repr(rows(samples)[3:]) == "[[1.0, nan, 3.0], [1.0, 2.0, nan]]"
    assert parser.counters["malformed"] == 0


def test_an_empty_field_is_missing_but_not_behind_the_last_separator():
    _, samples = lines("1,2,3", "1,2,3", "1,2,3", ",2,3", "1,,3", "1,2,")
    assert repr(rows(samples)[3:]) == "[[nan, 2.0, 3.0], [1.0, nan, 3.0], [1.0, 2.0, nan]]"
    parser, samples = lines("1,2,", "1,2,", "1,2,", "1,2", ",2,")
    assert repr(rows(samples)[3:]) == "[[nan, 2.0]]"
    assert parser.counters["malformed"] == 1


@pytest.mark.parametrize(
    "line",
    [
        "1,5;2,5", "1,5, 2,5", "1,5 2,5", "X: 1,5, Y: 2,5", "0x10,2", "1.5e,2", "1.2.3,4", "1_000,2", "-2_113.4,1",
        "12:30:01,1.5", "1e999,2", "1e5000,2", "nanotesla 4", "mag: 1, 2, 3", "١,٢", "１,２", "−2.1,3", "x\x00=1",
        "time_ms=-5,x=1", "time_us=nan,x=1", "Calibrating: done!",
        "02,5", "-2,04614", "1 2,3", "1,2;3", "1-2,3", "nan,-",
    ],
)  # fmt: skip
def test_a_line_that_is_none_is_counted_and_never_data(line):
    parser, samples = lines(*[line] * 10)
    assert samples == []
    assert parser.counters["malformed"] == 10
    assert parser.counters["discarded_bytes"] == 10 * len(f"{line}\r".encode())
    assert parser.remarks[0].startswith(
        f"Left out were lines such as {line.replace(chr(0), chr(0xFFFD))!r}: "
    )


@pytest.mark.parametrize(
    ("good", "other"),
    [
        ("1,2,3", "1,2"), ("1,2,3", "1,2,3,4"), ("1,2,3", "1;2;3"), ("1,2,3", "1,2,3,"), ("X:1,Y:2", "X:1,Z:2"),
        ("X:1,Y:2", "1,2"), ("1.2 mT", "900 uT"), ("1,2", "\x80,2"),
    ],
)  # fmt: skip
def test_the_first_lines_that_agree_fix_the_form(good, other):
    parser, samples = lines(good, good, good, other, good)
    assert len(samples) == 4
    assert parser.counters["malformed"] == 1


def test_times_of_a_sketch_are_from_zero_to_ten_thousand_million_seconds():
    for time_s, there in (("0", True), ("1e10", True), ("1.1e10", False), ("-1", False), ("nan", False)):
        _, samples = lines("time_s,x", *["1,2"] * 3, f"{time_s},3")
        assert (len(samples) == 4) == there


def test_bytes_are_text_if_more_than_nine_of_ten_are_printed():
    for odd in (9, 10):
        assert is_text(b"ab \t\r\n~123"[:10] * 9 + b"a" * (10 - odd) + b"\xff" * odd) == (odd < 10)


def test_decimal_commas_are_refused_whatever_separates():
    for k in range(3):
        printed = [
            f"-2,{9000 + 97 * k:05d}{mark}-2,{10000 + 7 * k}"
            for k in range(40)
            for mark in [",", ", ", "; "][k : k + 1]
        ]
        parser, samples = lines(*printed)
        assert samples == []
        assert "Nothing is read: numbers must have decimal points, not commas." in parser.remarks
    printed = [f"-2,{10900 - 30 * k:05d}" for k in range(200)]  # the first leading zero comes late
    parser, samples = lines(*printed)
    assert len(samples) == 31
    assert parser.counters["malformed"] == 169


def test_whole_numbers_in_pairs_are_believed_after_twenty_lines():
    """One decimal in ten begins with a zero, which no whole number does; other lines need three."""
    for line, least in (("512,37", 20), ("512,3", 3), ("512,37,4", 3), ("512", 3)):
        assert [len(lines(*[line] * n)[1]) for n in (least - 1, least)] == [0, least]


def test_damaged_whole_numbers_are_no_decimal_commas():
    printed = [f"{512 + k % 7},{300 + k % 9}" for k in range(1000)]
    printed[100::100] = ["512,08"] * 9
    parser, samples = lines(*printed)
    assert (len(samples), parser.counters["malformed"]) == (991, 9)


def test_what_a_board_prints_when_it_starts_fixes_nothing():
    boot = """ets Jul 29 2019 12:21:46|configsip: 0, SPIWP:0xee|mode:DIO, clock div:1|load:0x3fff0030,len:1184
ho 0 tail 12 room 4|entry 0x400805e4|Calibrating... 10 20 30|Temp: 23.5, Hum: 41|3,2,1"""
    boot = boot.replace("\n", "|").split("|")
    parser, samples = lines(
        *boot, "millis,u1,u2", "1,2,3", "2,2,4", "3,2,5", *boot[:-1], "millis,u1,u2", "4,2,6"
    )
    assert rows(samples) == [[2, 3], [2, 4], [2, 5], [2, 6]]
    assert parser.counters["malformed"] == 17
    assert parser.counters["restarts"] == 1


@pytest.mark.parametrize("names", [["millis,x"], []])
def test_numbers_that_a_board_prints_before_its_data_do_not_keep_them_away(names):
    parser, samples = lines(
        "Attempt: 1", "Attempt: 2", "Attempt: 3", *names, *(f"{k},{k}.5" for k in range(99))
    )
    assert rows(samples)[-1] == ([98.5] if names else [98, 98.5])
    assert len(samples) == (102 if names else 69)
    assert parser.names == ("x",) * len(names)
    parser = Parser()
    parser.feed(b"\nAttempt: 1\nAttempt: 2\nAttempt: 3\n")
    assert sequences(parser.feed(sent(3))) == [0, 1, 2]
    assert (parser.format, parser.counters["frames"]) == ("frames", 3)


def test_lines_that_never_agree_are_counted_and_few_are_kept():
    parser, samples = lines(*(f"x{chr(97 + k % 26)}{k}=1" for k in range(100)))
    assert samples == []
    parser.reopened()
    assert parser.counters["malformed"] == 100


def test_channels_leave_other_lines_out():
    _, samples = lines("1,2", "1,2", "1,2", "1,2,3", "1,2,3", "1,2,3", channels=3)
    assert rows(samples) == [[1, 2, 3]] * 3
    _, samples = lines("time_ms,a,b", *["1,2,3"] * 3, channels=2)
    assert rows(samples) == [[2, 3]] * 3


def test_a_header_again_is_a_restart_and_another_one_stops_the_data():
    names = "time_ms,x,y"
    printed = [
        names,
        "1,2,3",
        "2,2,3",
        "3,2,3",
        names,
        "1,5,6",
        "time_ms,y,x",
        "1,6,5",
        "2,6,5",
        names,
        "9,5,6",
    ]
    parser, samples = lines(*printed)
    assert rows(samples) == [[2, 3]] * 3 + [[5, 6]] * 2
    assert (parser.counters["restarts"], parser.counters["malformed"]) == (2, 3)


def test_the_first_line_may_be_a_header_but_not_one_whose_time_may_be_cut():
    _, samples = lines(*["1,2,3"] * 3, first="time_ms,x,y")
    assert (samples[0].time_us, rows(samples)[0]) == (1000, [2, 3])
    for cut in ("me_ms,x,y", "s,x,y", "illis,x,y"):
        parser, samples = lines(*["1,2,3"] * 3, first=cut)
        assert (samples[0].time_us, rows(samples)[0], parser.names) == (None, [1, 2, 3], ())


def test_the_form_stays_when_the_port_is_opened_again():
    parser, _ = lines("time_ms,x", *["1,2"] * 3)
    parser.reopened()
    assert rows(parser.feed(b"9,9\r\n5,6\r\n")) == [[6]]
    parser.reopened()
    assert parser.feed(b"ime_ms,y\r\n5,6\r\n") == []  # other names


def test_lines_that_end_with_a_carriage_return_only():
    parser = Parser()
    assert rows(parser.feed(b"9,9\r" + b"".join(b"%d,2.5\r" % k for k in range(5)))) == [
        [k, 2.5] for k in range(5)
    ]


def test_a_last_line_without_its_end_is_no_sample():
    parser, _ = lines("1.5,2.5", "1.5,2.5", "1.5,2.5")
    assert parser.feed(b"1.5,2") == []
    parser.close()
    assert parser.remarks == ["The last line has no end and was left out: '1.5,2'."]
    assert parser.counters["discarded_bytes"] == 5


def test_lines_of_one_name_each_make_a_line():
    printed = [f">u{k}:{k + n}.5" for n in range(5) for k in (1, 2, 3)]
    parser, samples = lines(*printed)
    assert rows(samples) == [[1.5 + n, 2.5 + n, 3.5 + n] for n in range(4)]
    assert parser.names == ("u1", "u2", "u3")


@given(st.lists(st.floats(allow_nan=False, allow_infinity=False), min_size=1, max_size=118))
def test_values_are_exactly_those_printed(row):
    assert rows(Parser("csv").feed(b"\n" + 3 * text_line(row, "csv"))) == [row] * 3


@given(
    st.sampled_from([", ", ";", "\t", "  "]),
    st.sampled_from(["", "{}:", "{}: ", "{} ="]),
    st.sampled_from(["", " uT", "mV", " m/s^2"]),
    st.lists(
        st.from_regex(r"[+-]?(0|[1-9][0-9]{0,5}|[0-9]{0,3}\.[0-9]{1,4})(e-?[0-9]{1,2})?", fullmatch=True),
        min_size=1, max_size=20,
    ),
)  # fmt: skip
def test_any_form_gives_the_numbers_and_their_names(separator, label, unit, printed):
    fields = [label.format(f"c{k}") + number + unit for k, number in enumerate(printed)]
    if label.endswith(" =") and separator == "  ":
        return  # a blank separates there
    parser, samples = lines(*[separator.join(fields)] * 3, channels=len(printed))
    assert rows(samples) == [list(map(float, printed))] * 3
    n = len(printed)
    assert parser.names == (
        tuple(f"{'c' if label else 'u'}{k + (not label)}" for k in range(n)) if label or unit else ()
    )
    assert parser.units == ((unit.strip(),) * n if label or unit else ())


ALPHABET = st.text("0123456789.,;:= \t-+eExXyTnaifsmuµ()_\r\n\x00é", max_size=60)


@given(st.one_of(st.binary(max_size=200), ALPHABET.map(str.encode)), st.sampled_from((None, *FORMATS)))
def test_nothing_raises_and_no_number_is_invented(data, format):
    number = r"[+-]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][+-]?[0-9]+)?"
    printed = {float(text) for text in re.findall(number, data.decode(errors="replace"))}
    parser = Parser(format)
    for sample in parser.feed(b"\n" + 3 * (data + b"\n")):
        assert all(math.isnan(value) or value in printed for value in sample.values)
    parser.close()
    assert all(count >= 0 for count in parser.counters.values())


@given(
    st.lists(ALPHABET, max_size=12),
    st.lists(st.integers(0, 300), max_size=8),
    st.sampled_from(["csv", None, "hall"]),
)
def test_chunks_of_text_do_not_matter(printed, cuts, format):
    data = b"\n" + "\n".join(printed).encode()
    whole, pieces = Parser(format), Parser(format)
    assert repr(in_pieces(pieces, data, cuts)) == repr(whole.feed(data))
    assert (pieces.counters, pieces.remarks) == (whole.counters, whole.remarks)


@pytest.mark.parametrize("format", FORMATS[1:])
def test_memory_stays_bounded_without_line_ends(format):
    parser = Parser(format)
    for _ in range(100):
        parser.feed(b"1" * 4097)
    assert parser.counters == counted(oversized=1, discarded_bytes=409_700)
