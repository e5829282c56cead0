"""Follow a board for long, and look at delay and memory: run by ``make soak``.

``python -m bench.soak.live [MINUTES [HOURS]]`` follows eight sensors at 1 kHz through a port for so many minutes, in
their own time, and then so many hours of a board with faults as fast as it goes. It fails if readings are left out in
an hour of their own time, if the slowest hundredth takes longer than 2 ms, or if memory grows after the first hour.
"""

from __future__ import annotations

import itertools
import resource
import sys
import time
from collections import deque
from contextlib import closing
from pathlib import Path

import numpy as np

import repro
from repro_board.emulate import Emulator, board_bytes
from repro_board.session import Follower, Session, open_port
from repro_board.steps import Steps
from repro_board.wire import Parser

ROBOT = Path(__file__).parents[2] / "data" / "robots" / "two_segments.toml"
FAULTS = {"flips": 1e-4, "disconnects": 1e-5, "reboots": 1e-5, "stick": 3}
P99_MS, GROWTH_MB = 2.0, 30.0


def through_a_port(minutes: float, estimator: str = "") -> bool:
    """Print and judge the delay from bytes to estimates, and what was left out."""
    robot = repro.load_robot(ROBOT)
    follower = Follower(robot, estimator)
    follower.warm()
    with Emulator(board_bytes(robot, rate_hz=1000), 0) as board, closing(open_port(board.address)) as port:
        session = Session(follower, port)
        session.latencies = deque()  # all of them
        session.run(60 * minutes)
    delays = [*session.latencies]
    p50, p99 = 1e3 * np.percentile(delays[1000:], [50, 99])
    counters = session.counters()
    print(
        f"{follower.name}: {len(delays)} estimates in {minutes:g} min; from bytes to estimate {p50:.2f} ms in the"
        f" median, {p99:.2f} ms for the slowest hundredth; {counters['skipped']} left out, {counters['gaps']} lost"
    )
    return p99 <= P99_MS and not counters["skipped"] and not counters["gaps"]


def for_hours(hours: float, rate_hz: float = 40.0) -> bool:
    """Print and judge the memory of a session that lasts, with faults of line and chip from the first minute."""
    robot = repro.load_robot(ROBOT)
    parser = Parser()
    steps, follower, sizes = Steps(robot, source=parser), Follower(robot, "kalman"), []
    sent = board_bytes(robot, rate_hz=rate_hz, faults=FAULTS, fault_from=60.0)
    for hour in range(1, 1 + round(hours)):
        for time_s, data in itertools.takewhile(lambda item: item[0] < 3600 * hour, sent):  # noqa: B023
            if not data:
                parser.reopened()
            for step in steps.feed(parser.feed(data), time_s):
                follower.step(step.u, step.time_s)
        sizes.append(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024)
        print(f"hour {hour}: {steps.counters['steps']} time steps, {sizes[-1]:.0f} MB", flush=True)
    return sizes[-1] - sizes[0] < GROWTH_MB


def main(minutes: float = 10.0, hours: float = 10.0) -> int:
    """Run both."""
    began = time.monotonic()
    good = [through_a_port(minutes, name) for name in ("levenberg_marquardt", "kalman")] + [for_hours(hours)]
    print(f"{'good' if all(good) else 'NOT good'}, after {time.monotonic() - began:.0f} s")
    return int(not all(good))


if __name__ == "__main__":
    sys.exit(main(*map(float, sys.argv[1:])))
