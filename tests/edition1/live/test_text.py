"""Text lines: what is read, what is refused, and how often damage passes, as the page says."""

import math
import random
import re
from pathlib import Path

import pytest
from damaged import DAMAGES, EXAMPLES, false_readings, memory_of, received
from hypothesis import given
from hypothesis import strategies as st

from edition1.errors import InputError
from edition1.estimation.orientations import UNIT_TOLERANCE
from edition1_live.wire.formats import encode, parser
from edition1_live.wire.frame import Counters, Frame
from edition1_live.wire.text import HALL, NORM_TOLERANCE, QUATERNION, TextParser, millivolts

PAGE = Path(__file__).parents[3] / "book/wire_formats.md"
LINES = {"hall": HALL, "millivolts": millivolts(), "quaternions": QUATERNION}


def opened(format: str) -> TextParser:
    """A parser behind the first line of its port, with all counters at zero."""
    reader = parser(format)
    assert isinstance(reader, TextParser)
    reader.feed(b"\n")
    reader.counters.first_partial = 0
    return reader


@st.composite
def quaternions(draw) -> Frame:
    raw = draw(st.tuples(*[st.floats(-1, 1)] * 4).filter(lambda q: math.hypot(*q) > 0.1))
    values = tuple(round(value / math.hypot(*raw), 6) + 0.0 for value in raw)
    return Frame(draw(st.integers(0, 255)), None, None, values)


def plain(values: st.SearchStrategy[float]) -> st.SearchStrategy[Frame]:
    return st.tuples(values, values, values).map(lambda three: Frame(0, None, None, three))


FRAMES = {
    "hall": plain(st.integers(-8192, 8191).map(float)),
    "millivolts": plain(st.integers(0, 20_480_000).map(lambda steps: steps / 10_000)),
    "quaternions": quaternions(),
}


# ---- what is read ----


@pytest.mark.parametrize(
    ("format", "line", "stream", "values"),
    [
        ("hall", b"-12,187,-2310", 0, (-12, 187, -2310)),
        ("hall", b"0,-8192,8191", 0, (0, -8192, 8191)),
        ("millivolts", b"1282.1250,1205.0625,1387.4375", 0, (1282.125, 1205.0625, 1387.4375)),
        ("millivolts", b"0,2048,2.5e2", 0, (0, 2048, 250)),
        (
            "quaternions",
            b"3,0.5,-0.5,0.5,0.5",
            3,
            (-0.5, 0.5, 0.5, 0.5),
        ),  # w first on the line, last in a frame
        ("quaternions", b"255,1,0.0,0,1e-05", 255, (0, 0, 1e-5, 1)),
        ("quaternions", b"0,0.0000,0.6,0.0,0.8009", 0, (0.6, 0, 0.8009, 0)),  # norm 1.0007
    ],
)
@pytest.mark.parametrize("end", [b"\r\n", b"\n"])
def test_a_line_is_read(format, line, stream, values, end):
    reader = opened(format)
    assert reader.feed(line + end) == [Frame(stream, None, None, values)]
    assert reader.counters == Counters(frames=1)


def test_the_examples_of_the_page_are_what_is_written():
    page = PAGE.read_text(encoding="utf-8")
    for format in LINES:
        assert f"Example: `{encode(format, EXAMPLES[format]).decode().strip()}`" in page


@pytest.mark.parametrize("format", LINES)
def test_parsing_undoes_encoding(format):
    @given(FRAMES[format])
    def law(frame):
        assert opened(format).feed(encode(format, frame)) == [frame]

    law()


@given(st.tuples(*[st.floats(0, 2048)] * 3))
def test_millivolts_are_rounded_to_four_decimals(values):
    [frame] = opened("millivolts").feed(encode("millivolts", Frame(0, None, None, values)))
    assert frame.values == pytest.approx(values, abs=0.5000001e-4, rel=0)


def test_the_converters_steps_are_exact():
    for step in [0, *(2**power + offset for power in range(15) for offset in (-1, 0, 1)), 32768]:
        frame = Frame(0, None, None, (step * 0.0625,) * 3)
        assert opened("millivolts").feed(encode("millivolts", frame)) == [frame]


def test_the_tolerance_is_that_of_the_estimators():
    assert NORM_TOLERANCE == UNIT_TOLERANCE


def test_channels_of_millivolts():
    reader = parser("millivolts", 5)
    assert reader.feed(b"\n1,2,3,4,5\r\n1,2,3\r\n") == [Frame(0, None, None, (1, 2, 3, 4, 5))]
    assert reader.counters.malformed == 1


# ---- what is refused ----


@pytest.mark.parametrize(
    ("format", "line"),
    [
        *(
            ("hall", line)
            for line in (
                *(
                    b"",
                    b"1,2",
                    b"1,2,3,4",
                    b"1,2,",
                    b",2,3",
                    b"1,,3",
                    b"1,2,3,",
                    b"a,2,3",
                    b"1.0,2,3",
                    b"1;2;3",
                ),
                *(b" 1,2,3", b"1, 2,3", b"1,2,3 ", b"+1,2,3", b"01,2,3", b"-0,2,3", b"--1,2,3", b"1e2,2,3"),
                *(b"8192,0,0", b"0,-8193,0", b"99999,0,0", b"1_0,2,3", b"nan,2,3", b"inf,2,3", b"1\r,2,3"),
                *(b"1,2,3\r4,5,6", b"\xd9\xa1,2,3", b"\x00,2,3", b"[1 2 3]", b"1,2,3\0"),
            )
        ),
        *(
            ("millivolts", line)
            for line in (
                *(
                    b"1.0,2.0",
                    b"nan,1.0,1.0",
                    b"inf,1.0,1.0",
                    b"-inf,1.0,1.0",
                    b"ovf,1.0,1.0",
                    b"NaN,1.0,1.0",
                ),
                *(
                    b"1e999,1.0,1.0",
                    b"-0.5,1.0,1.0",
                    b"2048.1,1.0,1.0",
                    b"1.,2.0,3.0",
                    b".5,1.0,1.0",
                    b"1.0.0,1,1",
                ),
                *(b"1_000.0,1.0,1.0", b"0x10,1.0,1.0", b"1,5,2,5,3,5", b"1.0\t,1.0,1.0", b"1e1000,1,1"),
            )
        ),
        *(
            ("quaternions", line)
            for line in (
                *(b"0,0,0,0,0", b"1,0,0,0", b"256,1,0,0,0", b"-1,1,0,0,0", b"01,1,0,0,0", b"1.0,1,0,0,0"),
                *(b"0,nan,0,0,1", b"0,0.71,0.71,0.0,0.0", b"0,1.0011,0,0,0", b"0,0.9989,0,0,0", b",1,0,0,0"),
                *(b"0,1,0,0,0,0", b"0,1e9,0,0,0", b"0,2,0,0,0"),
            )
        ),
    ],
)
def test_a_line_that_does_not_fit_is_counted_and_never_data(format, line):
    reader = opened(format)
    assert reader.feed(line + b"\r\n") == []
    assert reader.counters == Counters(malformed=1, discarded_bytes=len(line) + 1)
    good = EXAMPLES[format]
    assert len(reader.feed(encode(format, good))) == 1


@pytest.mark.parametrize("format", LINES)
def test_what_a_line_cannot_hold_is_not_written(format):
    good = EXAMPLES[format]
    impossible = [
        (),
        (math.nan, *good.values[1:]),
        (*good.values[1:], math.inf),
        tuple(3e4 for _ in good.values),
    ]
    for values in impossible:
        with pytest.raises(InputError):
            encode(format, good._replace(values=values))


@pytest.mark.parametrize(
    ("format", "frame", "message"),
    [
        (
            "hall",
            Frame(0, None, None, (0.5, 0.0, 0.0)),
            "values of a line of text must be whole numbers from -8192 to 8191; instead received (0.5, 0.0, 0.0).",
        ),
        (
            "hall",
            Frame(0, None, None, (0.0, 0.0)),
            "values of a line of text must be 3 numbers; instead received 2.",
        ),
        (
            "millivolts",
            Frame(1, None, None, (0.0, 0.0, 0.0)),
            "stream of a line of text must be 0, the only one; instead received 1.",
        ),
        (
            "millivolts",
            Frame(0, None, None, (0.0, 2048.5, 0.0)),
            "values of a line of text must be numbers from 0 to 2048; instead received (0.0, 2048.5, 0.0).",
        ),
        (
            "quaternions",
            Frame(256, None, None, (0.0, 0.0, 0.0, 1.0)),
            "stream of a line of text must be 0 to 255; instead received 256.",
        ),
        (
            "quaternions",
            Frame(0, None, None, (0.0, 0.0, 0.0, 0.9)),
            "values of a line of text must be a quaternion of norm 1 within 0.001; "
            "instead received (0.0, 0.0, 0.0, 0.9).",
        ),
    ],
)
def test_messages(format, frame, message):
    with pytest.raises(InputError) as refused:
        encode(format, frame)
    assert str(refused.value) == "Input " + message


# ---- chunks, openings ----


@pytest.mark.parametrize("format", LINES)
def test_chunks_do_not_matter(format):
    @given(st.data())
    def law(data):
        junk = st.one_of(st.binary(max_size=150), st.text("0123456789.,-\r\n", max_size=40).map(str.encode))
        parts = data.draw(st.lists(st.one_of(junk, FRAMES[format]), max_size=6))
        stream = b"".join(part if isinstance(part, bytes) else encode(format, part) for part in parts)
        cuts = sorted(data.draw(st.lists(st.integers(0, len(stream)), max_size=12)))
        whole, pieces, single = parser(format), parser(format), parser(format)
        expected = whole.feed(stream)
        received = [
            frame
            for start, end in zip([0, *cuts], [*cuts, len(stream)], strict=True)
            for frame in pieces.feed(stream[start:end])
        ]
        assert received == expected
        assert [frame for i in range(len(stream)) for frame in single.feed(stream[i : i + 1])] == expected
        assert pieces.counters == whole.counters == single.counters
        for reader in (whole, pieces, single):
            reader.reopened()
        assert pieces.counters == whole.counters == single.counters

    law()


@pytest.mark.parametrize("format", LINES)
def test_no_bytes_raise_and_nothing_impossible_comes_out(format):
    alphabet = st.one_of(
        st.binary(max_size=200), st.text("0123456789.,-+eE\r\n", max_size=60).map(str.encode)
    )

    @given(st.lists(alphabet, max_size=20))
    def law(chunks):
        reader, line = parser(format), LINES[format]
        got = [frame for chunk in chunks for frame in reader.feed(chunk)]
        assert reader.counters.frames == len(got)
        for frame in got:
            assert len(frame.values) == line.count
            assert line.possible(frame.values)
            assert 0 <= frame.stream <= 255

    law()


@pytest.mark.parametrize("format", LINES)
def test_the_first_line_of_every_opening_is_dropped(format):
    data, frame = encode(format, EXAMPLES[format]), EXAMPLES[format]
    reader = parser(format)
    assert len(reader.feed(data[3:] + 2 * data + data[:4])) == 2
    first = len(data) - 3 - 1
    assert reader.counters == Counters(frames=2, first_partial=1, discarded_bytes=first)
    reader.reopened()
    assert reader.feed(data) == []  # whole, but who knows
    assert len(reader.feed(data)) == 1
    assert reader.counters == Counters(frames=3, first_partial=2, discarded_bytes=first + 4 + len(data) - 1)
    assert reader.feed(data)[0].stream == frame.stream


# ---- damage, memory ----


def test_how_often_damage_passes_is_what_the_page_says():
    rows = dict(
        re.findall(r"^\| `(\w+)` \| (\d+ of \d+ \| \d+ of \d+ \| \d+ of \d+) \|$", PAGE.read_text(), re.M)
    )
    assert list(rows) == list(EXAMPLES)
    for format, row in rows.items():
        computed = ["{1} of {0}".format(*false_readings(format, damage)) for damage in DAMAGES]
        assert row.split(" | ") == computed, format


def test_two_lines_can_become_one():
    """As the page says: a loss in the middle joins the beginning of one with the end of another."""
    sent = b"-12,187,-2310\r\n-13,188,-2311\r\n"
    reader = opened("hall")
    assert reader.feed(sent.replace(b"187,-2310\r\n-13,", b"")) == [Frame(0, None, None, (-12, 188, -2311))]
    assert reader.counters == Counters(frames=1)


@pytest.mark.parametrize("format", LINES)
def test_damage_to_a_line_costs_one_line_or_two(format):
    for damage in DAMAGES.values():
        for damaged in damage(encode(format, EXAMPLES[format])):
            assert len(received(format, damaged)) >= 1


@pytest.mark.parametrize("format", LINES)
def test_memory_stays_bounded_without_line_ends(format):
    reader, chunk = opened(format), b"1" * 4096
    held, peak = memory_of(reader, chunk, 2000)
    assert held < 10_000
    assert peak < 10 * len(chunk)
    assert reader.counters == Counters(oversized=1, discarded_bytes=2000 * 4096)
    assert len(reader.feed(b"\n" + encode(format, EXAMPLES[format]))) == 1


@pytest.mark.parametrize("format", LINES)
def test_garbage_shows_at_once(format):
    reader = parser(format)
    assert reader.feed(random.Random(0).randbytes(2000)) == []
    assert reader.counters.frames == 0
    assert reader.counters.discarded_bytes > 1000
