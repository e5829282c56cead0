"""Kill a writer of mcap and the recorder's own file after the same minute, and count what each left.

Not part of ``make soak``: the page "Decisions" states what it said, ``python -m bench.soak.mcap_kill [SECONDS]``.
"""

from __future__ import annotations

import json
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from tempfile import TemporaryDirectory

from mcap.exceptions import McapError
from mcap.reader import NonSeekingReader

from repro_board.record import read_recording

RATE_HZ = 40
_MCAP = """
from mcap.writer import Writer
writer = Writer(open(sys.argv[1], "wb"))
writer.start()
schema = writer.register_schema("readings", "jsonschema", b'{"type": "object"}')
channel = writer.register_channel("/readings", "json", schema)
def write(k):
    content = {"stream": 0, "sequence": k, "u": [k % 1000, 0.5, -1.0]}
    writer.add_message(channel, time.time_ns(), json.dumps(content).encode(), time.time_ns())
"""
_OWN = """
from repro_board.record import Writer
from repro_board.wire import encode
file = Writer(sys.argv[1], {})
def write(k):
    file.write(time.time_ns(), encode([k % 1000, 0.5, -1.0], sequence=k, time_us=k * 25000))
"""
_LOOP = f"""
start, k = time.monotonic(), 0
while True:
    if time.monotonic() - start >= k / {RATE_HZ}:
        write(k)
        k += 1
        print(k, flush=True)
    time.sleep(0.002)
"""


def _left_by_mcap(path: Path) -> Iterator[int]:
    """Yield the numbers of the messages that a reader finds before the end that is missing."""
    with path.open("rb") as stream:
        try:
            for _, _, message in NonSeekingReader(stream).iter_messages():
                yield json.loads(message.data)["sequence"]
        except McapError:
            return


def left(program: str, path: Path, seconds: float) -> tuple[int, int]:
    """Write frames for so many seconds, kill the writer (SIGKILL); return frames written and frames left."""
    command = [sys.executable, "-c", f"import json, sys, time\n{program}{_LOOP}", str(path)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        process.stdout.readline()
        time.sleep(seconds)
        process.kill()
        written = 1 + len(process.stdout.read().split())
    if path.suffix == ".mcap":
        return written, len(list(_left_by_mcap(path)))
    return written, len(read_recording(path).samples)


def main() -> int:
    """Print what each left; return 1 if the recorder's own file lost a frame."""
    seconds = float(sys.argv[1]) if len(sys.argv) > 1 else 60.0
    with TemporaryDirectory() as folder:
        for name, program in (("a.mcap", _MCAP), ("a.rec", _OWN)):
            written, kept = left(program, Path(folder) / name, seconds)
            size = (Path(folder) / name).stat().st_size
            lost_s = (written - kept) / RATE_HZ
            print(f"{name}: {written} frames written, {kept} left ({size} bytes); {lost_s:.1f} s are lost.")
    return int(kept < written)


if __name__ == "__main__":
    sys.exit(main())
