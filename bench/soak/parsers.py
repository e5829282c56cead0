"""Millions of frames through a real port with faults: nothing corrupt may arrive, nothing intact may be lost.

``python -m bench.soak.parsers [FRAMES [pty|socket]]`` runs it; ``make soak`` does so with ten million.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass

import numpy as np
from edition1.errors import InputError, bad_input
from edition1_live.emulate.board import Passage, Reading, passages
from edition1_live.emulate.emulator import Emulator
from edition1_live.emulate.faults import Faults
from edition1_live.emulate.links import open_link
from edition1_live.record.ports import close_port, open_port, read_available
from edition1_live.wire.formats import parser
from edition1_live.wire.frame import WRAP, Frame

RATE_HZ = 1000
"""Frames per second of the board's clock; they are sent as fast as they are read."""
CHANCE = 1e-4
"""Of flips, and of drops, of each byte."""
INTERRUPTIONS = 20
"""Disconnects, and stalls, to be expected during a run."""


@dataclass(frozen=True)
class SoakReport:
    """What was sent and what arrived.

    Attributes
    ----------
    sent
        Frames sent, damaged ones included; those sent while the port was away are not.
    intact
        Of these, frames whose bytes and delimiters arrived unchanged and alone.
    accepted
        Frames that the parser returned.
    corrupt
        Of these, frames that were never sent so.
    out_of_order
        Accepted frames that came again or late.
    intact_lost
        Intact frames that were not accepted.
    not_received_bytes
        Bytes that the port itself lost.
    connections
        How often the port was opened.
    gaps
        Frames that the parser says are missing.
    grown_bytes
        By how much the process grew after a tenth of the run; missing on Windows.
    seconds, cpu_seconds
        How long it took; time on the processor.
    """

    sent: int
    intact: int
    accepted: int
    corrupt: int
    out_of_order: int
    intact_lost: int
    not_received_bytes: int
    connections: int
    gaps: int
    grown_bytes: float
    seconds: float
    cpu_seconds: float

    @property
    def passed(self) -> bool:
        """Whether nothing corrupt was accepted and nothing intact lost, repeated or reordered."""
        return not (self.corrupt or self.out_of_order or self.intact_lost or self.not_received_bytes)


def soak(frames: int, *, port: str = "", seed: int = 0) -> SoakReport:
    """Send frames of three channels through a port as fast as they are read, with flips, drops, disconnects, stalls.

    Parameters
    ----------
    frames
        How many the board numbers.
    port
        ``pty`` or ``socket``; by default a pseudo-terminal where there are any.
    seed
        Of the faults.

    Raises
    ------
    InputError
        If there is no frame, or no such port.
    """
    if not 1 <= frames < WRAP:
        raise bad_input("frames", "soak", "1 or more, and a number of 32 bits", frames)
    if port not in ("", "pty", "socket"):
        raise bad_input("port", "soak", "pty or socket", port)
    rare = min(1.0, INTERRUPTIONS / frames)
    faults = Faults(flips=CHANCE, drops=CHANCE, disconnects=rare, away_s=0.05, stalls=rare, stall_s=0.2)
    link = open_link(port)
    ledger = _Ledger(frames)
    sent = ledger.noted(passages(_readings(frames), "frames", faults, seed=seed))
    began, cpu = time.monotonic(), time.process_time()
    gaps = _receive(Emulator(sent, link, speed=float("inf")), ledger)
    return ledger.report(gaps, time.monotonic() - began, time.process_time() - cpu)


def _receive(emulator: Emulator, ledger: _Ledger) -> int:
    """Read until everything was sent and read; return the gaps."""
    binary = parser("frames", 3)
    with emulator:
        port = open_port(emulator.address)
        received = 0
        while True:
            finished = emulator.finished.is_set()
            try:
                chunk = read_available(port, 0.2)
            except OSError:
                close_port(port)
                ledger.received.append(received)
                received = 0
                binary.reopened()
                port = _reopened(emulator.address)
                continue
            received += len(chunk)
            ledger.accept(binary.feed(chunk))
            if finished and not chunk:
                break
        ledger.received.append(received)
        close_port(port)
    return binary.counters.gaps


def _reopened(address: str):
    deadline = time.monotonic() + 10.0
    while True:
        try:
            return open_port(address)
        except InputError:
            if time.monotonic() > deadline:
                raise
            time.sleep(0.01)


def _readings(frames: int) -> Iterator[Reading]:
    for k in range(frames):
        yield Reading(k / RATE_HZ, 0, _values(k))


def _values(k):
    """Values that the sequence number alone tells, and that float32 holds; of a number or an array of them."""
    return k % 65536 / 16, k * 7919 % 65536 - 32768.0, k // 65536 * 1.0


class _Ledger:
    """What was sent intact and what was accepted: one byte for every number, so that memory does not grow."""

    def __init__(self, frames: int) -> None:
        self.intact, self.accepted = np.ones(frames, bool), np.ones(frames, bool)
        self.intact[:] = self.accepted[:] = False  # not zeros: those would take memory only when written
        self.sent = self.arrived = self.corrupt = self.out_of_order = 0
        self.bytes: list[int] = [0]
        self.received: list[int] = []
        self._last = -1
        self._early = float("nan")

    def noted(self, sent: Iterator[Passage]) -> Iterator[Passage]:
        """Pass on what is sent and note it."""
        for passage in sent:
            numbers = np.fromiter((frame.sequence for frame in passage.frames), np.int64)
            self.intact[numbers[passage.intact]] = True
            self.sent += len(numbers)
            self.bytes += [0] * (passage.connection + 1 - len(self.bytes))
            self.bytes[passage.connection] += len(passage.data)
            if np.isnan(self._early) and numbers[-1] > len(self.intact) // 10:
                self._early = _peak_bytes()
            yield passage

    def accept(self, frames: Sequence[Frame]) -> None:
        """Compare accepted frames with what must have been sent."""
        if not frames:
            return
        self.arrived += len(frames)
        _, sequence, device_us, values = zip(*frames, strict=True)
        numbers = np.array(sequence, np.int64)
        right = (np.array(device_us) == numbers * (10**6 // RATE_HZ) % WRAP) & (numbers < len(self.accepted))
        right &= (np.array(values) == np.column_stack(_values(numbers))).all(axis=1)
        right &= np.array([frame.stream == 0 for frame in frames])
        self.corrupt += int((~right).sum())
        numbers = numbers[right]
        self.out_of_order += int((np.diff(numbers, prepend=self._last) <= 0).sum())
        self.accepted[numbers] = True
        self._last = max(self._last, int(numbers.max(initial=-1)))

    def report(self, gaps: int, seconds: float, cpu_seconds: float) -> SoakReport:
        grown_bytes = _peak_bytes() - self._early  # before the tables below are made
        pairs = zip(self.bytes, self.received + [0] * len(self.bytes), strict=False)
        return SoakReport(
            sent=self.sent,
            intact=int(self.intact.sum()),
            accepted=self.arrived,
            corrupt=self.corrupt,
            out_of_order=self.out_of_order,
            intact_lost=int((self.intact & ~self.accepted).sum()),
            not_received_bytes=sum(abs(sent - received) for sent, received in pairs),
            connections=len(self.received),
            gaps=gaps,
            grown_bytes=grown_bytes,
            seconds=seconds,
            cpu_seconds=cpu_seconds,
        )


def _peak_bytes() -> float:
    """Largest memory of the process so far."""
    try:
        import resource
    except ImportError:  # Windows
        return float("nan")
    return float(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss) * (
        1 if sys.platform == "darwin" else 1024
    )


def main(arguments: Sequence[str]) -> int:
    """Run the soak with a number of frames through a port; return 0 if it passed."""
    frames = int(arguments[0]) if arguments else 10_000_000
    report = soak(frames, port=arguments[1] if len(arguments) > 1 else "")
    for name, value in asdict(report).items():
        print(f"{name:20} {value:,.0f}")
    print("passed" if report.passed else "FAILED")
    return 0 if report.passed else 1


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
