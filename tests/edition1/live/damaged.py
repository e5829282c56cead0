"""Damage to one frame or line, exhaustively, what comes of it, and the memory that a parser takes."""

import tracemalloc
from collections.abc import Iterator

from edition1_live.wire.formats import encode, parser
from edition1_live.wire.frame import Frame, Parser

TURN = (0.0625, -0.25, 0.5, (1 - 0.0625**2 - 0.25**2 - 0.5**2) ** 0.5)
EXAMPLES = {
    "frames": Frame(0, 41, 123_456_789, (1282.125, 1205.0625, 1387.4375)),
    "hall": Frame(0, None, None, (-12.0, 187.0, -2310.0)),
    "millivolts": Frame(0, None, None, (1282.125, 1205.0625, 1387.4375)),
    "quaternions": Frame(3, None, None, TURN),
    "csv": Frame(0, None, None, (1.25, -3.5, 0.0625)),
}


def neighbours(format: str) -> tuple[Frame, Frame]:
    """The frames sent before and after the example: other numbers, other readings."""
    example = EXAMPLES[format]
    values = (0.5, 0.5, -0.5, 0.5) if format == "quaternions" else tuple(v + 1 for v in example.values)
    if example.sequence is None:
        return example._replace(values=values), example._replace(values=values)
    return tuple(example._replace(sequence=example.sequence + step, values=values) for step in (-1, 1))


def flips(sent: bytes) -> Iterator[bytes]:
    for place in range(len(sent)):
        for bit in range(8):
            yield sent[:place] + bytes([sent[place] ^ 1 << bit]) + sent[place + 1 :]


def losses(sent: bytes) -> Iterator[bytes]:
    for place in range(len(sent)):
        yield sent[:place] + sent[place + 1 :]


def doubles(sent: bytes) -> Iterator[bytes]:
    for place in range(len(sent)):
        yield sent[: place + 1] + sent[place:]


DAMAGES = {"one bit flipped": flips, "one byte lost": losses, "one byte doubled": doubles}


def received(format: str, damaged: bytes) -> list[Frame]:
    """What a parser delivers of the damaged bytes between two sound neighbours, on a line long open."""
    before, after = (encode(format, frame) for frame in neighbours(format))
    reader = parser(format)
    reader.feed(b"" if format == "frames" else b"\n" + 3 * before)  # three lines of csv tell their form
    return reader.feed(before + damaged + after)


def false_readings(format: str, damage: str) -> tuple[int, int]:
    """How many ways of damage there are, and after how many of them something is delivered that was not sent."""
    sent = received(format, encode(format, EXAMPLES[format]))
    outcomes = [received(format, damaged) for damaged in DAMAGES[damage](encode(format, EXAMPLES[format]))]
    return len(outcomes), sum(any(frame not in sent for frame in outcome) for outcome in outcomes)


def memory_of(reader: Parser, chunk: bytes, times: int) -> tuple[int, int]:
    """Bytes that the modules of the wire hold after ``times`` chunks, and the peak of one of the last twenty feeds.

    Other threads of the process allocate meanwhile, as those of a test runner do: what they hold is not counted, and
    the smallest of twenty peaks is free of what they take for a moment.
    """
    peaks = []
    tracemalloc.start()
    try:
        for _ in range(times):
            tracemalloc.reset_peak()
            before = tracemalloc.get_traced_memory()[0]
            reader.feed(chunk)
            peaks.append(tracemalloc.get_traced_memory()[1] - before)
        wire = tracemalloc.Filter(True, "*/edition1_live/wire/*")
        held = tracemalloc.take_snapshot().filter_traces([wire])
    finally:
        tracemalloc.stop()
    return sum(trace.size for trace in held.traces), min(peaks[-20:])
