"""A synthetic sensor board: it numbers its readings, stamps them by its clock, sends them, and sometimes fails."""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Iterable, Iterator
from itertools import islice
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from edition1_live.emulate.faults import Faults, damage
from edition1_live.wire.formats import encode
from edition1_live.wire.frame import WRAP, Frame

BLOCK = 4096
"""Readings that the board looks ahead; the faults of a seed do not depend on how fast they are played."""


class Reading(NamedTuple):
    """What the sensors of a board read at one time.

    Attributes
    ----------
    time_s
        True time since the board was switched on [s].
    stream
        As in a frame.
    values
        Readings, in the unit of the format.
    """

    time_s: float
    stream: int
    values: tuple[float, ...]


class Passage(NamedTuple):
    """Bytes that a board sends while its port is open, and what they were meant to be.

    Attributes
    ----------
    connection
        How often the port closed before.
    silent_s
        How long the board was stalled before [s]; `time_s` takes account of it.
    time_s
        When each frame is sent; true time [s].
    frames
        The frames, as a parser of the format would return them.
    data
        The bytes that arrive.
    ends
        Where in `data` what is left of each frame ends.
    intact
        Whether all bytes of the frame and both of its delimiters arrive unchanged and alone: a parser must return it.
    """

    connection: int
    silent_s: float
    time_s: Float[np.ndarray, " frames"]
    frames: list[Frame]
    data: bytes
    ends: Int[np.ndarray, " frames"]
    intact: Bool[np.ndarray, " frames"]


def passages(
    readings: Iterable[Reading],
    format: str,
    faults: Faults | None = None,
    *,
    seed: int = 0,
    from_s: float = 0.0,
    block: int = BLOCK,
) -> Iterator[Passage]:
    """Send readings: yield what arrives, as the faults of a seed leave it.

    Parameters
    ----------
    readings
        In the order of their times.
    format
        One of :data:`edition1.robot_file.columns.FORMATS`.
    faults
        None by default.
    seed
        Of the faults.
    from_s
        Since when there are faults, by the times of the readings [s]; the clock drifts from the beginning.
    block
        Readings that the board looks ahead: fewer where they depend on what somebody does meanwhile. The faults of a
        seed depend on it.
    """
    faults = faults or Faults()
    board = _Board(format, faults, seed)
    waiting = iter(readings)
    while ahead := list(islice(waiting, block)):
        before = bisect_left(ahead, from_s, key=lambda reading: reading.time_s)
        if before:
            board.faults = Faults(drift_ppm=faults.drift_ppm)
            yield from board.send(ahead[:before])
            board.faults = faults
        if before < len(ahead):
            yield from board.send(ahead[before:])


class _Board:
    def __init__(self, format: str, faults: Faults, seed: int) -> None:
        self._format, self.faults = format, faults
        self._rng = np.random.default_rng(seed)
        self._numbers: dict[int, int] = {}
        self._connection = 0
        self._booted_s = self._back_s = self._late_s = (
            0.0  # runs, port is there, stall is over: from this time on
        )
        self._began = True  # the port was opened, or the board has started
        self._cut_front = False
        self._silent_s = 0.0

    def send(self, block: list[Reading]) -> Iterator[Passage]:
        """Send a block of readings; the port may close in between."""
        faults, start = self.faults, 0
        for at, event in self._events(len(block)):
            time_s = block[at].time_s
            if at < start or time_s < max(self._booted_s, self._back_s):
                continue
            if event == "stall":
                if time_s < self._late_s:
                    continue
                yield from self._run(block[start:at])
                self._late_s = time_s + faults.stall_s
                self._silent_s += faults.stall_s
                start = at
                continue
            yield from self._run(block[start : at + 1], broken_off=True)
            start = at + 1
            if event == "disconnect":
                self._connection += 1
                self._back_s = time_s + faults.away_s
                self._began = self._cut_front = True
            else:
                self._booted_s = time_s + faults.boot_s
                self._numbers.clear()
        yield from self._run(block[start:])

    def _events(self, count: int) -> list[tuple[int, str]]:
        faults = self.faults
        chances = (("disconnect", faults.disconnects), ("reboot", faults.reboots), ("stall", faults.stalls))
        drawn = [(self._rng.integers(0, count, self._rng.binomial(count, p)), name) for name, p in chances]
        return sorted((int(at), name) for ats, name in drawn for at in ats)

    def _run(self, readings: list[Reading], *, broken_off: bool = False) -> Iterator[Passage]:
        """Number and send readings during which nothing happens to the port; the last may be broken off."""
        rng, numbered = self._rng, self._format == "frames"
        numbers, booted_s, back_s = self._numbers, self._booted_s, self._back_s
        tick = 1e6 * (1 + 1e-6 * self.faults.drift_ppm)
        time_s, frames, packets = [], [], []
        for at, stream, values in readings:
            if at < booted_s:
                continue
            number = numbers.get(stream, 0)
            numbers[stream] = (number + 1) % WRAP
            if at < back_s:
                continue
            frame = Frame(stream, number, round((at - booted_s) * tick) % WRAP, values)
            packets.append(encode(self._format, frame))
            frames.append(frame if numbered else Frame(stream, None, None, values))
            time_s.append(max(at, self._late_s))
        if not frames:
            return
        complete = np.ones(len(frames), bool)
        ended = True
        if self._cut_front:
            packets[0] = packets[0][int(rng.integers(1, len(packets[0]))) :]
            complete[0] = self._cut_front = False
        if broken_off and len(packets[-1]) > 1:
            packets[-1] = packets[-1][: int(rng.integers(1, len(packets[-1])))]
            complete[-1] = ended = False
        data, ends, whole, closed = damage(packets, self.faults, rng)
        intact = whole & complete
        if not numbered:  # the end of the line before is the delimiter in front of a line
            intact &= np.concatenate([[not self._began], closed[:-1]])
        self._began = not (ended and closed[-1])
        silent_s, self._silent_s = self._silent_s, 0.0
        yield Passage(self._connection, silent_s, np.array(time_s), frames, data, ends, intact)
