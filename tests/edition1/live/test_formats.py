"""The formats by name, and laws of all parsers over any bytes.

Any bytes, in any chunks, to every parser: none raises, all chunks give the same frames and counters, every byte is
accounted for, and what is accepted is encoded and accepted again. No generator guesses a checksum, so one mode puts a
right one behind the bytes it is given, and COBS around them.
"""

import math
import zlib

import pytest
from cobs import cobs
from damaged import EXAMPLES
from hypothesis import given
from hypothesis import strategies as st

from edition1.errors import InputError
from edition1.estimation.orientations import UNIT_TOLERANCE
from edition1.robot_file._tables import MOST_VALUES
from edition1.robot_file.columns import FORMATS
from edition1_live.wire.binary import KINDS
from edition1_live.wire.formats import encode, parser
from edition1_live.wire.frame import Counters, Frame, Parser
from edition1_live.wire.text import HALL, NORM_TOLERANCE

CHECKED = len(FORMATS)
"""The mode after the formats: frames with a right checksum."""


def stream_of(mode: int, data: bytes) -> bytes:
    """The bytes on the line: as given, or in pieces at ``ff ff``, each with its checksum, in COBS."""
    if mode != CHECKED:
        return data
    bodies = [body + zlib.crc32(body).to_bytes(4, "little") for body in data.split(b"\xff\xff")]
    return b"".join(b"\0" + cobs.encode(body) + b"\0" for body in bodies)


def try_one(data: bytes) -> None:
    """Feed one input to one parser: at once, and in chunks with interruptions."""
    if len(data) < 3:
        return
    mode, parts, reopen = data[0] % (CHECKED + 1), data[1] % 8 + 1, data[2] % 8
    stream = stream_of(mode, data[3:])
    step = len(stream) // parts + 1
    format = FORMATS[mode % CHECKED]
    whole, pieces = parser(format), parser(format)
    expected = whole.feed(stream)
    frames = [frame for at in range(0, len(stream), step) for frame in pieces.feed(stream[at : at + step])]
    check(repr(frames) == repr(expected), "chunks change the frames")
    check(whole.counters == pieces.counters, "chunks change the counters")
    check(whole.counters.frames == len(frames), "frames are not counted")
    for frame in frames:
        again = written(format, frame)
        if again is not None:
            reader = parser(format)
            reader.feed(b"" if format == "frames" else b"\n")
            if format == "csv":  # three lines that agree tell their form
                reader.feed(again + again)
                again_read = reader.feed(again)[-1:]
                check(
                    repr(again_read) == repr([frame._replace(device_us=None)]), f"{frame} is read otherwise"
                )
            else:
                check(len(reader.feed(again)) == 1, f"{frame} is not read again")
    if format == "frames":
        accepted = alone(stream)
        check(repr([frame for _, frame in accepted]) == repr(frames), "a frame depends on its neighbours")
        whole.reopened()
        left = len(stream) - stream.count(0) - whole.counters.discarded_bytes
        check(sum(len(packet) for packet, _ in accepted) == left, "bytes are not accounted for")
    for number, at in enumerate(range(0, len(stream), step)):
        pieces.feed(stream[at : at + step])
        if number == reopen:
            pieces.reopened()


def alone(stream: bytes) -> list[tuple[bytes, Frame]]:
    """The packets that a new parser accepts, each by itself, without repeats, and their frames."""
    accepted, last = [], {}
    for packet in stream.split(b"\0")[:-1]:
        for frame in parser("frames").feed(packet + b"\0"):
            if last.get(frame.stream) != packet:
                accepted.append((packet, frame))
            last[frame.stream] = packet
    return accepted


def written(format: str, frame: Frame) -> bytes | None:
    """The bytes of an accepted frame; None for those that lines round to what is not possible any more."""
    if format == "frames":
        kind = "float32" if len(frame.values) <= 59 else "int16"
        return encode(format, frame, kind=kind)
    if format == "quaternions" and abs(abs(math.hypot(*frame.values) - 1) - 1e-3) < 1e-5:
        return None
    return encode(format, frame)


def check(holds: bool, what: str) -> None:
    if not holds:
        raise AssertionError(what)


def seeds() -> list[bytes]:
    """A good input for every mode."""
    good = [
        encode("frames", Frame(1, 7, 1000, (1.0, -2.5, 3.0))) * 2,
        b"\n-12,187,-2310\r\n0,5,8191\r\n",
        b"\n1282.1250,1205.0625,1387.4375\r\n0,1e-3,2048\r\n",
        b"\n3,0.826797,0.062500,-0.250000,0.500000\r\n",
        b"time_ms,X (uT),Y (uT)\r\n" + b"12,1.5,-.25e2\r\n" * 4 + b"ok\r\n12,nan,1\r\n",
        bytes.fromhex("01070101 01000000 e8030000 0000803f")
        + b"\xff\xff"
        + bytes.fromhex("010702010200000000000000f4ff"),
    ]
    return [bytes([mode, 9, 3]) + data for mode, data in enumerate(good)]


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
def test_the_laws_hold_for_any_bytes(data):
    try_one(data)


@pytest.mark.parametrize("seed", seeds())
def test_the_laws_hold_for_frames_that_are_accepted(seed):
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
