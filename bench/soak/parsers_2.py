"""The parser of frames against that of the first edition, over streams with every fault: ``parsers_2.py [FRAMES]``.

Frames and counters must be equal, and every frame whose bytes arrive intact must be there.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Iterator

import numpy as np
from edition1_live.emulate.board import Reading, passages
from edition1_live.emulate.faults import Faults
from edition1_live.wire.formats import parser

from repro_board.wire import WRAP, Parser, encode

FAULTS = Faults(
    flips=2e-4, drops=2e-4, duplicates=2e-4, bursts=2e-5, stalls=1e-3, disconnects=1e-4, reboots=1e-4
)


def readings(frames: int, streams: int) -> Iterator[Reading]:
    """Yield readings of several streams at 1 kHz, whose values their number tells."""
    for k in range(frames):
        yield Reading(4000.0 + k / 1000, k % streams, (k % 65536 / 16, k // 65536, -1.0)[: 1 + k % 3])


def compare(frames: int, *, streams: int = 3, seed: int = 0, channels: int | None = None) -> dict[str, int]:
    """Return what was counted, and how much differs."""
    rng, old, new, connection = (
        np.random.default_rng(seed),
        parser("frames", channels),
        Parser("frames", channels),
        0,
    )
    found = dict.fromkeys(("intact", "different", "lost"), 0)
    extras = (
        b"",
        b"",
        b"Sensor 2 does not answer\r\n",
        b"\1" * 300,
        b"\0\0",
        encode([0.5]),
        encode([0.5] * 59),
    )
    for passage in passages(readings(frames, streams), "frames", FAULTS, seed=seed):
        if passage.connection != connection:
            connection = passage.connection
            old.reopened()
            new.reopened()
        ends = np.sort(rng.integers(0, len(passage.data) + 1, len(passage.data) // 500))
        extra = extras[rng.integers(len(extras))] * int(rng.integers(1, 3))
        chunks = [*np.split(np.frombuffer(passage.data, np.uint8), ends), np.frombuffer(extra, np.uint8)]
        before = [frame for chunk in chunks for frame in old.feed(chunk.tobytes())]
        samples = [sample for chunk in chunks for sample in new.feed(chunk.tobytes())]
        after = [(x.stream, x.sequence, (x.time_us or 0) % WRAP, tuple(x.values)) for x in samples]
        found["different"] += sum(a != b for a, b in zip(before, after, strict=False)) + abs(
            len(before) - len(after)
        )
        there = {frame[:2] for frame in after}
        intact = [frame for frame, whole in zip(passage.frames, passage.intact, strict=True) if whole]
        found["intact"] += len(intact)
        found["lost"] += sum(channels in (None, len(frame[3])) and frame[:2] not in there for frame in intact)
    counters = old.counters.as_dict()
    found["counters"] = sum(counters[name] != new.counters[name] for name in counters)
    return found | new.counters


def main() -> int:
    """Print what was counted; return 0 if nothing differs and nothing intact is lost."""
    start = time.process_time()
    found = compare(int(sys.argv[1]) if sys.argv[1:] else 1_000_000)
    print(*(f"{name:16} {number:>12,}" for name, number in found.items()), sep="\n")
    print(f"{time.process_time() - start:.0f} s")
    return int(any(found[name] for name in ("different", "lost", "counters")))


if __name__ == "__main__":
    sys.exit(main())
