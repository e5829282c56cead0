"""A live session for minutes: whether it keeps up, and its memory stays.

``python -m bench.soak.live [MINUTES [RATE_HZ [ROBOT.toml]]]`` runs it; ``make soak`` does so for ten
minutes.
"""

from __future__ import annotations

import math
import multiprocessing
import os
import sys
import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from multiprocessing.connection import Connection
from pathlib import Path
from tempfile import TemporaryDirectory

import torch
from edition1.robot_file.load import load_robot
from edition1_companion.book.project import find_project
from edition1_companion.twins.played import PERIOD_S, played
from edition1_live.emulate.board import passages
from edition1_live.emulate.emulator import Emulator
from edition1_live.emulate.links import open_link
from edition1_live.follow.live_state import LiveState
from edition1_live.follow.robot_estimator import robot_estimator
from edition1_live.follow.session import follow
from edition1_live.record.recording import read_recording

from bench.soak.parsers import _peak_bytes

SETTLED = 0.1
"""Memory is compared from this part of the time on."""


@dataclass(frozen=True)
class LiveSoakReport:
    """What a session of minutes did.

    Attributes
    ----------
    estimated, dropped, refused
        Time steps; see :class:`edition1_live.follow.live_state.LiveState`.
    gaps
        Frames that did not arrive.
    recorded
        Frames in the recording.
    p50_ms, p99_ms
        From the arrival of the last bytes of a time step to its estimate.
    cpu_ms
        Time on the processor per estimate, reading and recording included.
    grown_bytes
        By how much the process grew after a tenth of the time; missing on Windows.
    load
        Mean number of processes of the computer that wanted to run, in the last minute; missing on Windows.
    """

    estimated: int
    dropped: int
    refused: int
    gaps: int
    recorded: int
    p50_ms: float
    p99_ms: float
    cpu_ms: float
    grown_bytes: float
    load: float


def live_soak(
    minutes: float, *, rate_hz: float = 1000.0, robot: Path | None = None, estimator: str = ""
) -> LiveSoakReport:
    """Follow and record an emulated board, which another process plays, over and over for minutes.

    Parameters
    ----------
    minutes
        How long.
    rate_hz
        Readings per second.
    robot
        A robot file as for `edition1_companion.twins.played.played`; one segment by default.
    estimator
        One of :data:`edition1_live.follow.robot_estimator.ESTIMATORS`.
    """
    path = robot or find_project().data / "robots" / "one_segment.toml"
    method = robot_estimator(load_robot(path), estimator)
    method.prepared()
    apart = multiprocessing.get_context("spawn")
    receive, send = apart.Pipe(duplex=False)
    board = apart.Process(target=_play, args=(str(path), rate_hz, send), daemon=True)
    board.start()
    early = math.nan

    def show(state: LiveState) -> None:
        nonlocal early
        if math.isnan(early) and state.seconds > SETTLED * 60 * minutes:
            early = _peak_bytes()

    try:
        with TemporaryDirectory() as folder:
            output = Path(folder) / "recording"
            address = receive.recv()
            cpu = time.process_time()
            state = follow(address, method, output=output, duration_s=60 * minutes, show=show)
            cpu, grown = time.process_time() - cpu, _peak_bytes() - early
            recorded = len(read_recording(output).frames)
    finally:
        board.terminate()
        board.join()
    total = state.latencies["total"]
    return LiveSoakReport(
        estimated=state.estimated,
        dropped=state.dropped,
        refused=state.refused,
        gaps=state.recorded.counters["gaps"],
        recorded=recorded,
        p50_ms=1e3 * total.quantile(0.5),
        p99_ms=1e3 * total.quantile(0.99),
        cpu_ms=1e3 * cpu / max(state.estimated, 1),
        grown_bytes=grown,
        load=os.getloadavg()[0] if hasattr(os, "getloadavg") else math.nan,
    )


def _play(robot: str, rate_hz: float, send: Connection) -> None:
    sent = played(load_robot(robot), rate_hz=rate_hz, seconds=PERIOD_S, seed=0)
    link = open_link()
    emulator = Emulator(passages(sent.take.readings(loop=True), sent.take.format), link)
    with emulator:
        send.send(link.address)
        emulator.wait()


def main(arguments: Sequence[str]) -> int:
    """Run the soak; return 0 if every frame was estimated and memory stayed."""
    torch.set_num_threads(1)
    minutes = float(arguments[0]) if arguments else 10.0
    rate_hz = float(arguments[1]) if len(arguments) > 1 else 1000.0
    robot = Path(arguments[2]) if len(arguments) > 2 else None
    report = live_soak(minutes, rate_hz=rate_hz, robot=robot)
    for name, value in asdict(report).items():
        print(f"{name:12} {value:,.3g}" if isinstance(value, float) else f"{name:12} {value:,}")
    passed = not (report.dropped or report.refused or report.gaps) and not report.grown_bytes > 8e6
    print("passed" if passed else "FAILED")
    return 0 if passed else 1


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
