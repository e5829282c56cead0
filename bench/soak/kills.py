"""Kill a recorder at random moments, and look at what it leaves: run by ``make soak``.

``python -m bench.soak.kills [N]`` kills 100 of them, or N. A recorder says how many bytes its file has taken; none of
these may be missing.
"""

from __future__ import annotations

import os
import subprocess
import sys
import threading
import time
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import NamedTuple

import numpy as np

from repro_board.record import read_recording
from repro_board.wire import encode

RATE_HZ = 1000
LONGEST_S = 1.0
"""A recorder is killed up to this time after its first bytes, so before and after the disk is first asked [s]."""
START_S = 60.0
FRAME = len(encode([0.0, 0.5, -1.0]))
RECORDER = """
import sys
from repro_board import live
class Writer(live.Writer):
    def write(self, unix_ns, data):
        super().write(unix_ns, data)
        if data:
            print(self.received, flush=True)
live.Writer = Writer
live.record(sys.argv[1], sys.argv[2])
"""


class Killed(NamedTuple):
    """What one kill left: samples that can be read, those acknowledged, and what the reader said."""

    after_s: float
    samples: int
    acknowledged: int
    in_order: bool
    remarks: tuple[str, ...]

    @property
    def good(self) -> bool:
        """Whether nothing acknowledged is missing, and all that is there was sent so."""
        return self.in_order and self.samples >= self.acknowledged


def kill(path: Path, after_s: float) -> Killed:
    """Start a recorder on a pseudo-terminal that sends 1000 frames/s, kill it (SIGKILL), read what it left."""
    import tty  # not on Windows

    board, port = os.openpty()
    tty.setraw(port)
    os.set_blocking(board, False)
    over = threading.Event()
    sender = threading.Thread(target=send, args=(board, over))
    command = [sys.executable, "-c", RECORDER, os.ttyname(port), str(path)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as recorder:
        assert recorder.stdout is not None
        sender.start()
        said: list[str] = []
        try:
            said.append(recorder.stdout.readline())
            time.sleep(after_s)
        finally:
            recorder.kill()
            said += recorder.stdout.readlines()
            over.set()
            sender.join()
            os.close(board)
            os.close(port)
    recording = read_recording(path)
    numbers = np.array([sample.sequence or 0 for sample in recording.samples])
    values = np.array([sample.values for sample in recording.samples]).reshape(-1, 3)
    sent = np.column_stack([numbers % 1000, np.full(len(numbers), 0.5), np.full(len(numbers), -1.0)])
    right = np.array_equal(values, sent) and bool((np.diff(numbers) == 1).all())
    received = max(int(line) for line in said if line.endswith("\n"))
    # Opening empties the port, so that the first frame may be cut; the kill may cut the last.
    acknowledged = received // FRAME - 1
    return Killed(after_s, len(numbers), acknowledged, right, recording.remarks)


def send(board: int, over: threading.Event) -> None:
    """Send frames in real time, each of them whole; a full port delays all later ones."""
    start, number, rest = time.monotonic(), 0, b""
    while not over.wait(0.004):
        due = min(number + RATE_HZ, int(RATE_HZ * (time.monotonic() - start)))
        while number < due or rest:
            if not rest:
                rest = encode([number % 1000, 0.5, -1.0], sequence=number, time_us=1000 * number)
                number += 1
            try:
                rest = rest[os.write(board, rest) :]
            except BlockingIOError:
                break


def soak(n: int, folder: Path, seed: int = 0) -> list[Killed]:
    """Kill n recorders, at moments drawn from a seed."""
    moments = np.random.default_rng(seed).uniform(0, LONGEST_S, n)
    return [kill(folder / f"{k}.rec", float(after_s)) for k, after_s in enumerate(moments)]


def main() -> int:
    """Print what the kills left; return 1 if anything acknowledged is missing."""
    with TemporaryDirectory() as folder:
        killed = soak(int(sys.argv[1]) if len(sys.argv) > 1 else 100, Path(folder))
    torn = sum(any("cut off" in remark for remark in one.remarks) for one in killed)
    bad = [one for one in killed if not one.good]
    print(
        f"{len(killed)} kills: all recordings open, {torn} with a torn end, "
        f"{sum(one.samples for one in killed)} samples, {len(bad)} recordings lack what was acknowledged.",
        *bad,
    )
    return int(bool(bad))


if __name__ == "__main__":
    sys.exit(main())
