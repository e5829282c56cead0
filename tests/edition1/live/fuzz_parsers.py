"""Coverage-guided fuzzing of the parsers, by `make fuzz`.

Any bytes, in any chunks, to every parser: none raises, all chunks give the same frames and counters, every byte is
accounted for, and what is accepted is encoded and accepted again. Since no fuzzer guesses a checksum, one mode puts a
right one behind the bytes it is given, and COBS around them.
"""

import contextlib
import math
import sys
import tempfile
import zlib
from pathlib import Path

from cobs import cobs

if __name__ == "__main__":
    import atheris

    instrumented = atheris.instrument_imports(include=["repro.live"])
else:  # pytest reads every file for its doctests
    instrumented = contextlib.nullcontext()
with instrumented:
    from edition1.robot_file.columns import FORMATS
    from edition1_live.wire.formats import encode, parser
    from edition1_live.wire.frame import Frame

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
    """Inputs to start from: a good one for every mode."""
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


def main() -> None:
    """Run the fuzzer; its options, such as ``-runs=1000000``, are those of libFuzzer."""
    for seed in seeds():
        try_one(seed)
    with tempfile.TemporaryDirectory() as corpus:
        for number, seed in enumerate(seeds()):
            (Path(corpus) / str(number)).write_bytes(seed)
        atheris.Setup([*sys.argv, corpus, "-max_len=300"], try_one)
        atheris.Fuzz()


if __name__ == "__main__":
    main()
