"""The formats by name."""

import pytest
from damaged import EXAMPLES
from edition1.errors import InputError
from edition1.estimation.orientations import UNIT_TOLERANCE
from edition1.robot_file._tables import MOST_VALUES
from edition1.robot_file.columns import FORMATS
from edition1_live.wire.binary import KINDS
from edition1_live.wire.formats import encode, parser
from edition1_live.wire.frame import Counters, Parser
from edition1_live.wire.text import HALL, NORM_TOLERANCE
from fuzz_parsers import seeds, stream_of, try_one
from hypothesis import given
from hypothesis import strategies as st


@pytest.mark.parametrize("format", FORMATS)
def test_every_format_has_a_parser_and_an_encoder(format):
    reader, data = parser(format), encode(format, EXAMPLES[format])
    assert isinstance(reader, Parser)
    assert isinstance(data, bytes)
    # Three lines of csv that agree tell their form.
    sent = 3 if format == "csv" else 1
    got = reader.feed(b"\n" + sent * data if format != "frames" else data)
    assert reader.counters.frames == len(got) == sent
    assert reader.refused == ""
    assert got[0].stream == EXAMPLES[format].stream
    assert got[0].values == pytest.approx(EXAMPLES[format].values, abs=5e-7)


def test_a_robot_file_knows_how_many_values_a_frame_has_and_how_long_a_quaternion_is():
    assert {"frames": max(most for _, _, most in KINDS.values()), "hall": HALL.count} == MOST_VALUES
    assert UNIT_TOLERANCE == NORM_TOLERANCE


@pytest.mark.parametrize("format", FORMATS)
def test_one_format_is_not_read_as_another(format):
    data = b"\n" + 50 * encode(format, EXAMPLES[format])
    # The lines of the papers are lines of numbers.
    for other in set(FORMATS) - {format} - ({"csv"} if format != "frames" else set()):
        reader = parser(other)
        # Counts are decimal numbers too: only their range tells them from millivolts, and here one is negative.
        assert reader.feed(data) == []
        counters = reader.counters
        assert counters.frames == 0
        assert counters.malformed + counters.oversized + counters.checksum_errors + counters.first_partial > 0


@given(st.binary(max_size=300))
def test_the_fuzzers_laws_hold_without_it(data):
    try_one(data)


@pytest.mark.parametrize("seed", seeds())
def test_the_fuzzer_starts_from_frames_that_are_accepted(seed):
    try_one(seed)
    assert len(parser(FORMATS[seed[0] % len(FORMATS)]).feed(stream_of(seed[0], seed[3:]))) > 0


def test_counters_start_at_zero_and_have_names():
    assert set(parser("hall").counters.as_dict().values()) == {0}
    assert Counters(frames=3).as_dict()["frames"] == 3


@pytest.mark.parametrize(
    ("format", "channels", "message"),
    [
        (
            "binary",
            None,
            "format of the parser must be one of frames, hall, millivolts, quaternions, csv; "
            "instead received binary.",
        ),
        ("frames", 0, "channels of frames must be 1 to 118; instead received 0."),
        ("frames", 119, "channels of frames must be 1 to 118; instead received 119."),
        ("hall", 4, "channels of hall must be 3, or none given; instead received 4."),
        ("quaternions", 3, "channels of quaternions must be 4, or none given; instead received 3."),
        ("millivolts", 0, "channels of millivolts must be 1 or more; instead received 0."),
        ("csv", 0, "channels of csv must be 1 to 118; instead received 0."),
    ],
)
def test_what_there_is_not(format, channels, message):
    with pytest.raises(InputError) as refused:
        parser(format, channels)
    assert str(refused.value) == "Input " + message


def test_an_unknown_format_is_not_encoded():
    with pytest.raises(InputError, match="format of the parser must be one of"):
        encode("binary", EXAMPLES["frames"])


@pytest.mark.parametrize("format", ["hall", "quaternions"])
def test_the_number_of_channels_may_be_named(format):
    assert parser(format, len(EXAMPLES[format].values)).feed(b"") == []
