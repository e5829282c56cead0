"""What the recorder costs: processor time and memory of its commands beside NumPy's import, and a parser's rate."""

from __future__ import annotations

import struct
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from statistics import median
from tempfile import TemporaryDirectory
from typing import Any
from zlib import crc32

import pandas as pd
from cobs import cobs
from edition1_companion.pages.performance.rows import rate
from edition1_live.record.recording_file import RecordingFile
from edition1_live.wire.binary import RESIDUE, BinaryParser, encode_frame
from edition1_live.wire.frame import Frame

USED = """
import resource, subprocess, sys
done = subprocess.run(sys.argv[1:], stdout=subprocess.DEVNULL)
used = resource.getrusage(resource.RUSAGE_CHILDREN)
print(used.ru_utime + used.ru_stime, used.ru_maxrss / 1024)
sys.exit(done.returncode)
"""
"""A small process that starts a command: the memory of a process that starts one counts as its own until then."""
NUMPY = [sys.executable, "-c", "import numpy"]
"""The reference: a start depends on the computer, and on how long its disk takes for a module, as this does."""
REPRO = [sys.executable, "-m", "edition1_companion.cli"]
COMMANDS = (
    "--help",
    "record --help",
    "export --help",
    "import --help",
    "emulate --help",
    "record --list",
    "export a.rec -o b.csv",
    "export a.rec -o b.mcap",
    "import a.csv -o b.rec",
)
"""In the order in which they run; what one leaves behind is removed before the next."""


def used(folder: Path, *command: str) -> tuple[float, float]:
    """Processor time [s] and largest memory [MB] of a command.

    Raises
    ------
    CalledProcessError
        If the command fails.
    """
    program = [sys.executable, "-c", USED, *command]
    done = subprocess.run(program, cwd=folder, stdout=subprocess.PIPE, text=True, check=True)
    seconds, megabytes = map(float, done.stdout.split())
    return seconds, megabytes


def write_recording(path: Path) -> None:
    """Write a recording of a thousand frames, which the commands read."""
    with RecordingFile(path, {"format": "frames", "start_unix_s": 0.0, "start_host_ns": 0}) as file:
        for k in range(1000):
            file.append(k * 10**7, [Frame(0, k, 1000 * k, (1.5, -2.5, 3.5))])


def start_rows(repeats: int = 5) -> Iterator[dict[str, Any]]:
    """Commands of the recorder, each alternated with the import of NumPy: medians."""
    with TemporaryDirectory() as name:
        folder = Path(name)
        write_recording(folder / "a.rec")
        used(folder, *REPRO, "export", "a.rec", "-o", "a.csv")
        for command in COMMANDS:
            pairs = []
            for _ in range(repeats):
                for written in folder.glob("b.*"):
                    written.unlink()
                pairs.append((used(folder, *REPRO, *command.split()), used(folder, *NUMPY)))
            ours, reference = (median(pair[k][0] for pair in pairs) for k in range(2))
            yield {
                "what": f"repro {command}",
                "ours": ours,
                "unit": "CPU seconds",
                "reference": reference,
                "ratio": ours / reference,
                "memory_mb": median(pair[0][1] for pair in pairs),
                "note": "reference: Python that imports NumPy",
            }


def parser_row(frames: int = 50_000) -> dict[str, Any]:
    """Frames of three values, parsed on one core, beside their bare decoding."""
    data = b"".join(encode_frame(Frame(0, i, 1000 * i, (i + 0.25, i + 0.5, i + 0.75))) for i in range(frames))

    def parsed() -> int:
        reader = BinaryParser()
        return sum(len(reader.feed(data[at : at + 4096])) for at in range(0, len(data), 4096))

    ours, reference = rate(parsed), rate(lambda: len(decoded(data)))
    return {
        "what": "frames of three values, parsed",
        "ours": ours,
        "unit": "frames per CPU second",
        "reference": reference,
        "ratio": ours / reference,
        "note": "reference: COBS, CRC-32 and struct alone, without streams, counters and pieces of frames",
    }


def decoded(data: bytes) -> list[tuple[float, ...]]:
    """Values of frames of three ``float32`` that follow each other without a fault."""
    bodies = [cobs.decode(packet) for packet in data.split(b"\0") if packet]
    return [struct.unpack("<4xII3f4x", body) for body in bodies if crc32(body) == RESIDUE]


def recorder_table() -> pd.DataFrame:
    """A line for every command, and one for the parser."""
    return pd.DataFrame([*start_rows(), parser_row()])
