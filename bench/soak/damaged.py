"""Damage recordings in every way, and read them: no wrong value, no traceback, and all that is missing is told.

``python -m bench.soak.damaged [N]`` does so with 10,000; ``tests/board/test_record.py`` with a few hundred.
"""

from __future__ import annotations

import itertools
import struct
import sys
from collections import Counter
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from repro.common import InputError
from repro_board.record import Writer, read_recording
from repro_board.wire import encode

HEAD = struct.Struct("<4sc3xIIIqI")
"""Of a block, with its checksum: see the table in :mod:`repro_board.record`."""
KINDS, NOTE = ("frames", "csv"), "load on"


def values(k: int) -> list[float]:
    """Return the readings that the number of a sample alone tells."""
    return [k + 0.5, (k * 7919) % 1000 - 500.25, k % 7 + 1.125]


def write(path: Path, kind: str, n: int, rng: np.random.Generator) -> None:
    """Write a recording of samples 0 to n - 1, in blocks that are cut anywhere."""
    lines = ("".join(f"{value}," for value in values(k))[:-1] + "\r\n" for k in range(n))
    frames = (encode(values(k), sequence=k, time_us=1000 * k) for k in range(n))
    data = b"".join(frames) if kind == "frames" else b"\n" + "".join(lines).encode()
    cuts = np.sort(rng.choice(len(data), n // 3, replace=False))
    writer = Writer(path, {"port": "a board"})
    for k, part in enumerate(np.split(np.frombuffer(data, np.uint8), cuts)):
        writer.write(10**18 + 10**7 * k, part.tobytes())
        if k == 9:
            writer.note(10**18 + 10**8, NOTE)
    writer.close()


def starts(data: bytes) -> list[int]:
    """Return where the blocks of a whole recording begin, and its length."""
    at = [0]
    while at[-1] < len(data):
        at.append(at[-1] + HEAD.size + HEAD.unpack_from(data, at[-1])[4])
    return at


def damaged(data: bytes, rng: np.random.Generator) -> tuple[str, bytes]:
    """Return a recording with one damage, and its name."""
    bounds = starts(data)
    blocks = [data[a:b] for a, b in itertools.pairwise(bounds)]
    j, k = sorted(rng.choice(len(blocks), 2, replace=False))
    place, size = int(rng.integers(len(data))), int(rng.integers(1, 200))
    flipped = bytearray(data)
    for bit in rng.integers(8 * len(data), size=rng.integers(1, 9)):
        flipped[bit // 8] ^= 1 << bit % 8
    ways = {
        "bits flipped": bytes(flipped),
        "end cut off": data[:place],
        "end cut off at a block": data[: bounds[k]],
        "beginning cut off": data[place:],
        "bytes lost": data[:place] + data[place + size :],
        "bytes put in": data[:place] + rng.bytes(size) + data[place:],
        "another behind it": data + data[: bounds[k]].replace(data[8:12], b"else"),
        "zeros at the end": data + bytes(size),
        "block lost": b"".join(blocks[:j] + blocks[j + 1 :]),
        "block doubled": b"".join(blocks[:k] + blocks[j:]),
        "blocks exchanged": b"".join(
            [*blocks[:j], blocks[k], *blocks[j + 1 : k], blocks[j], *blocks[k + 1 :]]
        ),
        "block somewhere else": b"".join([*blocks[:j], *blocks[j + 1 : k + 1], blocks[j], *blocks[k + 1 :]]),
    }
    name = str(rng.choice(list(ways)))
    return name, ways[name]


def check(path: Path, n: int, changed: bool) -> str:
    """Read a damaged recording of n samples; return how that ended, or raise what must not be."""
    try:
        recording = read_recording(path)
    except InputError as error:
        if "without one" not in str(error):
            raise
        return "refused: no block is whole"
    numbers = [round(sample.values[0] - 0.5) for sample in recording.samples]
    for number, sample in zip(numbers, recording.samples, strict=True):
        if not 0 <= number < n or sample.values.tolist() != values(number):
            raise AssertionError(f"{sample} was never sent")
    if any(note.text != NOTE for note in recording.notes):
        raise AssertionError(f"{recording.notes} were never written")
    if len(recording.notes) != 1 and not recording.remarks:
        raise AssertionError(f"{len(recording.notes)} notes, and nothing is said")
    if sorted(set(numbers)) != numbers:
        raise AssertionError("samples are doubled or exchanged")
    if (len(numbers) < n or changed) and not recording.remarks:
        raise AssertionError(f"{n - len(numbers)} samples are missing, and nothing is said")
    if not (np.isfinite(recording.times).all() and (np.diff(recording.times) >= 0).all()):
        raise AssertionError("times go back")
    return "read"


def soak(n: int, seed: int, folder: Path) -> Counter[tuple[str, str, str]]:
    """Damage and read n recordings; return how many were read or refused, by kind and by damage."""
    rng = np.random.default_rng(seed)
    outcomes: Counter[tuple[str, str, str]] = Counter()
    whole = {}
    for kind in KINDS:
        write(folder / kind, kind, 60, rng)
        whole[kind] = (folder / kind).read_bytes()
        read = read_recording(folder / kind)
        if len(read.samples) < 59 or read.remarks:
            raise AssertionError(f"{kind}: {len(read.samples)} samples, {read.remarks}")
    for k in range(n):
        kind = KINDS[k % len(KINDS)]
        name, data = damaged(whole[kind], rng)
        (folder / kind).write_bytes(data)
        try:
            ended = check(folder / kind, 60, data != whole[kind])
        except Exception as error:
            raise AssertionError(f"damage {k} of seed {seed}: {kind}, {name}: {error}") from error
        outcomes[kind, name, ended] += 1
    return outcomes


def main() -> int:
    """Print what became of all damaged recordings."""
    n = int(sys.argv[1]) if len(sys.argv) > 1 else 10_000
    with TemporaryDirectory() as folder:
        outcomes = soak(n, 0, Path(folder))
    for (kind, name, ended), count in sorted(outcomes.items()):
        print(f"{count:6}  {kind:15} {name:25} {ended}")
    print(f"{n} damaged recordings: no wrong value, no traceback, all that is missing is told.")
    return 0


if __name__ == "__main__":
    sys.exit(main())
