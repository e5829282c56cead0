"""Kill a recorder at random moments, and look at what it leaves: run by ``make soak``."""

from __future__ import annotations

import os
import subprocess
import sys
import threading
import time
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from edition1.errors import bad_input
from edition1_live.record.recording import read_recording
from edition1_live.wire.formats import encode
from edition1_live.wire.frame import Frame

RATE_HZ = 1000
LONGEST_S = 1.2
"""A recorder is killed up to this time after its file appears [s], so before and after it first asks the disk."""
START_S = 60.0
_RECORDER = """
import sys
from pathlib import Path
from edition1_live.record.recorder import record
record(sys.argv[1], "frames", Path(sys.argv[2]))
"""


@dataclass(frozen=True)
class Killed:
    """What one kill left.

    Attributes
    ----------
    after_s
        Time from the appearance of the file to the kill [s].
    frames
        Frames that can be read.
    torn_bytes, damaged_bytes
        As in `edition1_live.record.recording.Recording`.
    missing_s
        Time from the last frame that can be read being sent to the kill [s].
    in_order
        Whether the frames are those sent, each once, in order and without a gap.
    """

    after_s: float
    frames: int
    torn_bytes: int
    damaged_bytes: int
    missing_s: float
    in_order: bool


def kill_soak(n: int, *, seed: int = 0) -> list[Killed]:
    """Start a recorder on a pseudo-terminal that sends 1000 frames/s, and kill it (SIGKILL); ``n`` times.

    Parameters
    ----------
    n
        How often.
    seed
        Of the moments.
    """
    if n < 1:
        raise bad_input("n", "kill_soak", "1 or more", n)
    rng = np.random.default_rng(seed)
    with TemporaryDirectory() as folder:
        return [_kill(Path(folder) / f"{k}.rec", float(rng.uniform(0, LONGEST_S))) for k in range(n)]


def _kill(path: Path, after_s: float) -> Killed:
    import pty  # not on Windows
    import tty

    board, port = pty.openpty()
    tty.setraw(port)
    os.set_blocking(board, False)
    command = [sys.executable, "-c", _RECORDER, os.ttyname(port), str(path)]
    process = subprocess.Popen(command)
    sent: list[float] = []
    over = threading.Event()
    sender = threading.Thread(target=_send, args=(board, sent, over))
    sender.start()
    try:
        limit = time.monotonic() + START_S
        while not path.exists() and process.poll() is None and time.monotonic() < limit:
            time.sleep(0.005)
        time.sleep(after_s)
        process.kill()
        killed = time.monotonic()
    finally:
        process.kill()
        process.wait()
        over.set()
        sender.join()
        os.close(board)
        os.close(port)
    recording = read_recording(path)
    numbers = recording.frames["sequence"].to_numpy(dtype=np.int64)
    values = recording.frames["u1"].to_numpy()
    return Killed(
        after_s=after_s,
        frames=len(numbers),
        torn_bytes=recording.torn_bytes,
        damaged_bytes=recording.damaged_bytes,
        missing_s=killed - sent[numbers[-1]] if len(numbers) else after_s,
        in_order=bool((np.diff(numbers) == 1).all() and (values == numbers % 1000).all()),
    )


def _send(board: int, sent: list[float], over: threading.Event) -> None:
    """Send frames in real time; ``sent`` gets the time of each. A full port delays all later ones."""
    start, rest = time.monotonic(), b""
    while not over.wait(0.004):
        due = int(RATE_HZ * (time.monotonic() - start))
        while len(sent) < due:
            k = len(sent)
            rest = rest or encode("frames", Frame(0, k, k * 1000 % (1 << 32), (float(k % 1000), 0.5, -1.0)))
            try:
                rest = rest[os.write(board, rest) :]
            except BlockingIOError:
                start += (due - k) / RATE_HZ
                break
            if not rest:
                sent.append(time.monotonic())


def main() -> int:
    """Kill as often as the command line says; print what was left; return 1 if more than one second is missing."""
    killed = kill_soak(int(sys.argv[1]) if len(sys.argv) > 1 else 100)
    missing = max(kill.missing_s for kill in killed)
    torn = sum(kill.torn_bytes > 0 for kill in killed)
    good = all(kill.in_order and not kill.damaged_bytes for kill in killed) and missing <= 1.0
    print(
        f"{len(killed)} kills: all recordings open, {torn} with a torn end, at most {missing:.3f} s missing."
    )
    return 0 if good else 1


if __name__ == "__main__":
    sys.exit(main())
