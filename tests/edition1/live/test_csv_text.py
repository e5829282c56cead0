"""Lines of numbers as sketches print them: what is read is what was printed, the rest is refused with its reason."""

import math
import re
from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st

from edition1.errors import InputError
from edition1_live.wire.csv_fields import read_header, read_line
from edition1_live.wire.csv_text import AGREEING, LONGEST_LINE, MOST_HELD, CsvParser, check_units
from edition1_live.wire.formats import encode
from edition1_live.wire.frame import Counters, Frame


def read(*lines: str, channels=None, first=""):
    """A parser that was given lines behind the first line of its port, and the frames that came out."""
    reader = CsvParser(channels)
    frames = reader.feed((first + "\n" + "".join(f"{line}\r\n" for line in lines)).encode())
    return reader, frames


def values(frames):
    return [frame.values for frame in frames]


# ---- what sketches print ----


@pytest.mark.parametrize(
    ("line", "expected", "names"),
    [
        ("1.2,-3.4,5e-2", (1.2, -3.4, 0.05), ["u1", "u2", "u3"]),
        ("1.2, -3.4, 5", (1.2, -3.4, 5.0), ["u1", "u2", "u3"]),
        ("  12,   7, 100", (12.0, 7.0, 100.0), ["u1", "u2", "u3"]),
        ("1.2;-3.4;+5", (1.2, -3.4, 5.0), ["u1", "u2", "u3"]),
        ("1.2\t-3.4\t.5", (1.2, -3.4, 0.5), ["u1", "u2", "u3"]),
        ("1.2 -3.4  5.", (1.2, -3.4, 5.0), ["u1", "u2", "u3"]),
        ("1,2,3,", (1.0, 2.0, 3.0), ["u1", "u2", "u3"]),
        ("512", (512.0,), ["u1"]),
        ("X: 1.2 uT, Y: -3 uT", (1.2, -3.0), ["X_uT", "Y_uT"]),
        ("x=1.2 y=3", (1.2, 3.0), ["x", "y"]),
        ("x:1.2,y:3", (1.2, 3.0), ["x", "y"]),
        ("X: 0.12 \tY: 3.4 \tZ: 1.2 m/s^2 ", (0.12, 3.4, 1.2), ["X_m/s^2", "Y_m/s^2", "Z_m/s^2"]),
        ("X: 0.12   Y: 3.4   Z: 1.2 uT", (0.12, 3.4, 1.2), ["X_uT", "Y_uT", "Z_uT"]),
        ("Mag X: 1 µT; Mag Y: 2 µT", (1.0, 2.0), ["Mag_X_µT", "Mag_Y_µT"]),
        ("Bx (mT) = .5, By (mT) = -1", (0.5, -1.0), ["Bx_mT", "By_mT"]),
        ("1.2 mT 3 mT", (1.2, 3.0), ["u1_mT", "u2_mT"]),
        ("a=1,a=2", (1.0, 2.0), ["u1", "u2"]),
        ("stream=1,b=2", (1.0, 2.0), ["u1", "u2"]),
    ],
)
def test_a_line_of_a_sketch_is_read(line, expected, names):
    reader, frames = read(*[line] * AGREEING)
    assert frames == [Frame(0, None, None, expected)] * AGREEING
    assert reader.layout is not None
    assert reader.layout.names == names
    assert reader.counters == Counters(frames=AGREEING, first_partial=1)


@pytest.mark.parametrize(
    ("header", "line", "expected", "device_us"),
    [
        ("time_ms,X (uT),Y (uT)", "12,1,2", (1.0, 2.0), 12_000),
        ("X,Y,time [s]", "1,2,0.25", (1.0, 2.0), 250_000),
        ("millis x y", "7 1 2", (1.0, 2.0), 7000),
        ("micros;x;y", "7;1;2", (1.0, 2.0), 7),
        ("Time_us\tx\ty", "4294967297\t1\t2", (1.0, 2.0), 1),
        ("", "t: 5 ms, T: 23.4 °C, Bx: .5", (23.4, 0.5), 5000),
        ("t,x,y", "5,1,2", (1.0, 2.0), None),  # a time without a unit
        ("T,x,y", "5,1,2", (5.0, 1.0, 2.0), None),  # a temperature
        ("time_ms,x", "5,1,2", (5.0, 1.0, 2.0), None),  # names of another number of columns
        ("Sensor found", "5,1", (5.0, 1.0), None),  # not separated as the numbers are
    ],
)
def test_times_have_a_name_and_a_unit(header, line, expected, device_us):
    _, frames = read(*([header] if header else []), *[line] * AGREEING)
    assert frames == [Frame(0, None, device_us, expected)] * AGREEING


def test_the_layout_says_what_was_found():
    reader, _ = read("time_ms,X (uT),Y (uT)", *["1,2,3"] * 3)
    assert str(reader.layout) == "2 values a line, separated by commas: X_uT, Y_uT; times in time"
    reader, _ = read("t,x", *["1,2"] * 3)
    assert str(reader.layout) == (
        "1 value a line, separated by commas: x; t is a time without a unit and is left out, "
        "times are those of arrival"
    )


# ---- what is refused ----


@pytest.mark.parametrize(
    ("line", "why"),
    [
        ("1,5;2,5", "'1,5' is no number"),
        ("1,5, 2,5", "decimal commas, or twice as many numbers"),
        ("1,5 2,5", "'5 2' is no number"),
        ("X: 1,5, Y: 2,5", "some numbers have a label"),
        ("1,,3", "a field is empty"),
        ("1,ovf,3", "'ovf' is no number"),
        ("1,inf,3", "'inf' is no number"),
        ("1,-,3", "'-' is no number"),
        ("0x10,2", "'0x10' is no number"),
        ("1.5e,2", "'1.5e' is no number"),
        ("1.2.3,4", "'1.2.3' is no number"),
        ("1_000,2", "'1_000' is no number"),
        ("12:30:01,1.5", "'12:30:01' is no number"),
        ("[1.2, 3]", "'[1.2' is no number"),
        ("1e999,2", "too large"),
        ("nanotesla 4", "is no number"),
        ("mag: 1, 2, 3", "some numbers have a label"),
        ("١,٢", "is no number"),
        ("x\x00=1", "is no number"),
        ("time_ms=-5,x=1", "a time must be from 0"),
        ("time_us=nan,x=1", "a time must be from 0"),
        ("Calibrating: done!", "is no number"),
    ],
)
def test_a_line_that_does_not_fit_is_counted_and_never_data(line, why):
    reader, frames = read(*[line] * 10)
    assert frames == []
    assert reader.counters.malformed == 10
    assert reader.counters.discarded_bytes == 10 * len(f"{line}\r".encode())
    assert why in reader.refused, reader.refused


@pytest.mark.parametrize(
    ("good", "other", "why"),
    [
        ("1,2,3", "1,2", "2 numbers, not 3"),
        ("1,2,3", "1,2,3,4", "4 numbers, not 3"),
        ("1,2,3", "1;2;3", "another separator"),
        ("1,2,3", "1,2,3,", "another end"),
        ("X:1,Y:2", "X:1,Z:2", "other labels"),
        ("X:1,Y:2", "1,2", "other labels"),
        ("1.2 mT", "900 uT", "other units"),
        ("1,2", "\x80,2", "is no number"),
    ],
)
def test_the_first_lines_that_agree_fix_the_form(good, other, why):
    reader, frames = read(good, good, good, other, good)
    assert len(frames) == 4
    assert reader.counters.malformed == 1
    assert why in reader.refused


def test_what_comes_before_the_lines_that_agree_does_not_fix_anything():
    reader, frames = read("Version: 1.2", "3", "1,2", "4", "5,6", "7,8")
    assert values(frames) == [(1, 2), (5, 6), (7, 8)]
    assert reader.counters.malformed == 3
    assert reader.refused == "'Version: 1.2': 1 numbers, not 2"


def test_lines_that_never_agree_are_counted_and_few_are_kept():
    reader, frames = read(*(f"x{k}=1" for k in range(100)))
    assert frames == []
    assert reader.counters.malformed == 100 - MOST_HELD
    assert "no 3 of the first lines have one form" in reader.refused


def test_lines_before_a_header_do_not_count_as_those_behind_it():
    """A board that was reset while the first lines waited for a third one."""
    reader = CsvParser()
    assert values(reader.feed(b"\n1,2\n3,4\nX,Y\n5,6\n7,8\n9,10\n")) == [(5, 6), (7, 8), (9, 10)]
    assert reader.counters.malformed == 2
    assert reader.refused == "'1,2': another header than the lines before"


def test_channels_leave_other_lines_out():
    reader, frames = read("1,2", "1,2", "1,2", "1,2,3", "1,2,3", "1,2,3", channels=3)
    assert values(frames) == [(1, 2, 3)] * 3
    assert reader.refused == "'1,2': 2 values, not 3"
    _, frames = read("time_ms,a,b", *["1,2,3"] * 3, channels=2)
    assert values(frames) == [(2, 3)] * 3


def test_a_missing_reading_is_nan_and_costs_nothing_else():
    _, frames = read("1,2", "nan,2", "NaN,-nan")
    assert repr(values(frames)) == "[(1.0, 2.0), (nan, 2.0), (nan, nan)]"


# ---- headers and openings ----


def test_a_header_again_is_a_restart_and_another_one_stops_the_data():
    lines = [
        "time_ms,x,y",
        "1,2,3",
        "2,2,3",
        "3,2,3",
        "time_ms,x,y",
        "1,5,6",
        "time_ms,y,x",
        "1,6,5",
        "2,6,5",
    ]
    reader, frames = read(*lines, "time_ms,x,y", "9,5,6")
    assert values(frames) == [(2, 3)] * 3 + [(5, 6)] * 2
    assert (reader.counters.restarts, reader.counters.malformed) == (2, 3)


def test_the_first_line_may_be_a_header_but_not_one_whose_time_may_be_cut():
    _, frames = read(*["1,2,3"] * 3, first="time_ms,x,y")
    assert frames[0] == Frame(0, None, 1000, (2.0, 3.0))
    for cut in ("me_ms,x,y", "s,x,y", "illis,x,y"):
        reader, frames = read(*["1,2,3"] * 3, first=cut)
        assert frames[0] == Frame(0, None, None, (1.0, 2.0, 3.0))
        assert reader.layout is not None
        assert reader.layout.names == ["u1", "u2", "u3"]


def test_the_form_stays_when_the_port_is_opened_anew():
    reader, _ = read("time_ms,x", *["1,2"] * 3)
    reader.reopened()
    assert reader.feed(b"9,9\r\n5,6\r\n") == [Frame(0, None, 5000, (6.0,))]
    reader.reopened()
    assert reader.feed(b"ime_ms,y\r\n5,6\r\n") == [], "other names"
    assert "after a header with other names" in reader.refused


def test_lines_that_wait_are_counted_when_the_port_goes():
    reader, frames = read("1,2", "1,2")
    reader.reopened()
    assert frames == []
    assert reader.counters == Counters(malformed=2, first_partial=1, discarded_bytes=8)


def test_memory_stays_bounded():
    reader = CsvParser()
    for _ in range(100):
        reader.feed(b"1" * LONGEST_LINE)
    assert reader.counters.oversized == 1


# ---- laws ----

NUMBERS = st.floats(allow_nan=False, allow_infinity=False)
ALPHABET = st.text("0123456789.,;:= \t-+eExXyTnaifsmuµ()_\r\n\x00é", max_size=60)


@given(st.lists(NUMBERS, min_size=1, max_size=118))
def test_values_are_exactly_those_printed(row):
    frame = Frame(0, None, None, tuple(row))
    reader = CsvParser()
    assert reader.feed(b"\n" + 3 * encode("csv", frame)) == [frame] * 3


@given(
    st.sampled_from([", ", ";", "\t", "  "]),
    st.sampled_from(["", "{}:", "{}: ", "{}="]),
    st.sampled_from(["", " uT", "mV", " m/s^2"]),
    st.lists(
        st.from_regex(r"[+-]?([0-9]{1,6}|[0-9]{0,3}\.[0-9]{1,4})(e-?[0-9]{1,2})?", fullmatch=True), min_size=1
    ),
)
def test_any_form_gives_the_numbers_and_their_names(separator, label, unit, numbers):
    fields = [label.format(f"c{k}") + number + unit for k, number in enumerate(numbers[:20])]
    reader, frames = read(*[separator.join(fields)] * 3)
    assert values(frames) == [tuple(map(float, numbers[:20]))] * 3
    assert reader.layout is not None
    plain = [f"c{k}" if label else f"u{k + 1}" for k in range(len(fields))]
    assert reader.layout.names == [name + (f"_{unit.strip()}" if unit else "") for name in plain]


@given(st.one_of(st.binary(max_size=200), ALPHABET.map(str.encode)))
def test_nothing_raises_and_no_number_is_invented(data):
    reader = CsvParser()
    printed = {
        float(text)
        for text in re.findall(
            r"[+-]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][+-]?[0-9]+)?", data.decode(errors="replace")
        )
    }
    for frame in reader.feed(b"\n" + 3 * (data + b"\n")):
        assert all(math.isnan(value) or value in printed for value in frame.values)
    left = reader.counters
    assert left.malformed >= 0
    assert left.frames == 0 or reader.layout is not None


@given(ALPHABET)
def test_no_line_raises(text):
    line = read_line(text)
    assert isinstance(line, str) or all(map(math.isfinite, filter(lambda x: x == x, line.values)))
    assert isinstance(read_header(text), tuple)


@given(st.lists(ALPHABET, max_size=12), st.lists(st.integers(0, 300), max_size=8))
def test_chunks_do_not_matter(lines, cuts):
    data = "\n".join(lines).encode()
    whole, pieces = CsvParser(), CsvParser()
    expected = whole.feed(data)
    edges = [0, *sorted(cut for cut in cuts if cut < len(data)), len(data)]
    got = [frame for a, b in pairwise(edges) for frame in pieces.feed(data[a:b])]
    assert repr(got) == repr(expected)
    assert pieces.counters == whole.counters


# ---- units, writing ----


def test_another_unit_than_the_robot_files_is_refused():
    reader, _ = read(*["X: 1.2 uT, Y: 3 uT"] * 3)
    assert reader.layout is not None
    for unit in (None, "raw", "uT"):
        check_units(reader.layout.names, reader.layout.value_units, unit)
    with pytest.raises(InputError) as refused:
        check_units(reader.layout.names, reader.layout.value_units, "mT")
    assert str(refused.value) == (
        'Input unit of the robot file must be uT, as the lines say of X_uT (or "raw", with gains in uT/mT); '
        "instead received mT."
    )
    reader = CsvParser(unit="mT")
    with pytest.raises(InputError, match="unit of the robot file must be uT"):
        reader.feed(b"\n" + 3 * b"X: 1.2 uT\r\n")


@pytest.mark.parametrize(
    "frame", [Frame(1, None, None, (1.0,)), Frame(0, None, None, ()), Frame(0, None, None, (math.inf,))]
)
def test_what_a_line_cannot_hold_is_not_written(frame):
    with pytest.raises(InputError):
        encode("csv", frame)
