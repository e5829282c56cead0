"""Recordings: what a port sends goes into a file as it comes, and is understood when the file is read.

A recording is a row of blocks. Each is written by one call and never touched again:

====== ======= ===========================================================================================
offset bytes   content (little endian)
====== ======= ===========================================================================================
0      4       ``RRB3``; ``RRB2`` where a recording cannot hold notes
4      1       ``A``: about the recording (JSON); ``B``: bytes from the port; ``O``: the port was opened again,
               no content; ``N``: a note (text in UTF-8); ``E``: the end (JSON with all counters)
5      3       0
8      4       a random number, the same in all blocks of a recording
12     4       number of the block, from 0
16     4       bytes of the content, at most 65536
20     8       time of arrival since 1970 [ns]; of a note, when it was begun
28     4       CRC-32 (``zlib.crc32``) of the 28 bytes before and of the content
32     ...     the content
====== ======= ===========================================================================================

A wrong format spoils nothing, because the parser runs again whenever the file is read. A damaged block costs its own
bytes; the numbers say which blocks are missing, doubled or exchanged. A program that knows no notes refuses ``RRB3``,
so none gets lost unseen. Recordings of an earlier edition (``RRB1``) had values instead of bytes, and are refused.
"""

from __future__ import annotations

import contextlib
import itertools
import json
import math
import os
import re
import signal
import struct
import threading
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple
from zlib import crc32

import numpy as np

from repro.common import Array, require, whole
from repro.readings import Readings, read_readings
from repro.robot import Robot
from repro_board.steps import STANDS_STILL, STILL, Labels, Steps
from repro_board.wire import DAMAGED, FORMATS, Parser, Sample

_MAGIC = b"RRB3"
_KNOWN, _ANOTHER = re.compile(b"RRB[23]"), re.compile(b"RRB[^23]")
MOST_BYTES = 65536
"""Of a block."""
MOST_LETTERS = 200
"""Of a note."""
SYNC_S = 0.25
"""A power cut costs at most this time [s], and what the disk itself holds back."""
_HEAD, _CRC = struct.Struct("<4sc3xIIIq"), struct.Struct("<I")
_WRAP_S = 2**32 / 1e6


Json = dict[str, Any]


@contextlib.contextmanager
def stopping(stop: threading.Event) -> Iterator[None]:
    """Let Ctrl-C and signals to end set an event, so that nothing is interrupted in its middle."""
    main = threading.current_thread() is threading.main_thread()
    signals = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP) if main else ()
    before = {number: signal.signal(number, lambda *_: stop.set()) for number in signals}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


class Writer:
    """A recording that grows. What it has taken survives the process, and `SYNC_S` later a power cut.

    A recording without a byte from the port leaves no file. On a full disk the file ends with its last whole block.

    Raises
    ------
    InputError
        If the file is there, or cannot be made.
    OSError
        If the disk is full or refuses: from then on nothing is recorded.
    """

    def __init__(self, path: str | Path, about: Json) -> None:
        self.path, self.received, self.notes = Path(path), 0, 0
        self._id, self._blocks, self._size = int.from_bytes(os.urandom(4)), 0, 0
        # The clock of the day may be set while we record, so it is read once.
        self._since_1970_ns = time.time_ns() - time.monotonic_ns()
        self._failure: Exception | None = None
        self._closing, self._turn = threading.Event(), threading.Lock()
        # Killed before its first block it leaves no file of that name, rather than an empty one.
        with whole(self.path, "the recording") as part:
            self._file = os.open(part, os.O_WRONLY | os.O_CREAT | os.O_APPEND, 0o666)
            self._append(b"A", self.now_ns(), json.dumps(about).encode())
        self._thread = threading.Thread(target=self._keep_in_sync, daemon=True)
        self._thread.start()

    def now_ns(self) -> int:
        """Return the time since 1970 [ns], which passes evenly whatever is done to the clock of the day."""
        return self._since_1970_ns + time.monotonic_ns()

    def write(self, unix_ns: int, data: bytes) -> None:
        """Append bytes that arrived at a time [ns since 1970]."""
        for first in range(0, len(data), MOST_BYTES):
            self._append(b"B", unix_ns, data[first : first + MOST_BYTES])
        self.received += len(data)

    def take(self, data: bytes, again: bool) -> None:
        """Append bytes that have arrived now, and before them whether the port was opened again."""
        if again:
            self.opened(self.now_ns())
        self.write(self.now_ns(), data)

    def opened(self, unix_ns: int) -> None:
        """Mark that the port was opened again: what comes next need not follow what came before."""
        self._append(b"O", unix_ns, b"")

    def note(self, unix_ns: int, text: str) -> None:
        """Append what a person noted at a time [ns since 1970]; any thread may."""
        must = f"1 to {MOST_LETTERS} letters without control characters, no space around them"
        require(text and text == plain(text), "note", "the recording", must, repr(text))
        self._append(b"N", unix_ns, text.encode())
        self.notes += 1

    def close(self, end: Json | None = None) -> None:
        """Write the end, wait for the disk, close; may be called again."""
        if self._closing.is_set():
            return
        self._closing.set()
        self._thread.join()
        try:
            if self.received and not self._failure:
                counted = {"bytes": self.received} | (end or {})
                self._append(b"E", self.now_ns(), json.dumps(counted).encode())
                os.fsync(self._file)
        finally:
            os.close(self._file)
            if not self.received:
                self.path.unlink(missing_ok=True)

    def _append(self, kind: bytes, unix_ns: int, content: bytes) -> None:
        with self._turn:
            head = _HEAD.pack(_MAGIC, kind, self._id, self._blocks, len(content), unix_ns)
            block = head + _CRC.pack(crc32(content, crc32(head))) + content
            try:
                if self._failure:
                    raise self._failure
                done = 0
                while done < len(block):
                    done += os.write(self._file, block[done:])
            except OSError as error:
                self._failure = error
                with contextlib.suppress(OSError):
                    os.ftruncate(self._file, self._size)
                failed = OSError(f"Writing {self.path} failed: {error.strerror}. What came before is kept.")
                failed.errno = error.errno
                raise failed from error
            self._size += len(block)
            self._blocks += 1

    def _keep_in_sync(self) -> None:
        """Ask the disk apart from the reader, who must not wait for it; the next block raises a failure."""
        synced = 0
        while not self._closing.wait(SYNC_S):
            if self._size > synced and not self._failure:
                size = self._size
                try:
                    os.fsync(self._file)
                except Exception as error:  # the next block raises it
                    self._failure = error
                synced = size


class Note(NamedTuple):
    """What a person noted while it was recorded; ``time_s`` [s] is from the first sample."""

    time_s: float
    text: str


def plain(text: str) -> str:
    """Return a text as a note may be: no control characters, not too long."""
    return "".join(x if x.isprintable() else " " for x in text).strip()[:MOST_LETTERS].strip()


class Recording(NamedTuple):
    """A recording as it was read.

    ``arrived`` are times since 1970 [s]. ``times`` [s] begin at 0, which was at ``unix_s``. They are the board's, if
    it sends any, on the computer's clock; else those of arrival, with samples that came together spread before it.
    ``notes`` are in the order of time; where there is no sample, their times are from the first block.
    """

    path: Path
    about: Json
    samples: list[Sample]
    arrived: Array
    times: Array
    unix_s: float
    format: str | None
    names: tuple[str, ...]
    units: tuple[str, ...]
    counters: dict[str, int]
    remarks: tuple[str, ...]
    notes: Sequence[Note] = ()


def read_recording(path: str | Path, *, as_stated: bool = True) -> Recording:
    """Read a recording, finished or not, whole or damaged; its remarks tell what is missing.

    Format and number of values are ``as_stated`` when it was recorded; where nothing can be read so, the bytes tell.

    Raises
    ------
    InputError
        If no block is whole.
    """
    path, remarks = Path(path), list[str]()
    require(path.is_file(), "recording", "read_recording", "a file that exists", path)
    blocks = _in_order(_undamaged(path, remarks), path.name, remarks)
    about = _json(blocks[0].content) if 0 in blocks else {}
    said, n = (about.get("format"), about.get("channels")) if as_stated else (None, None)
    format, channels = said if said in FORMATS else None, n if isinstance(n, int) and n > 0 else None
    parser, began = Parser(format, channels), next(iter(blocks.values())).unix_ns / 1e9
    noted = _noted(blocks, remarks)
    samples, arrived = _parsed(blocks, parser)
    if (format or channels) and not samples:
        stated = " ".join([*([format] if format else []), *([f"of {channels} values"] if channels else [])])
        found = read_recording(path, as_stated=False)
        if found.samples:
            other = f"{path.name} was recorded as {stated}, but its bytes are {found.format}, and are read so"
            return found._replace(remarks=(*found.remarks, other))
    remarks += [*parser.remarks, *_lost(parser.counters)]
    times, unix_s = _times(samples, arrived, remarks)
    notes = sorted(Note(ns / 1e9 - (unix_s if samples else began), text) for ns, text in noted)
    if samples and (early := sum(note.time_s < 0 for note in notes)):
        remarks.append(f"notes from before the first sample, with times below zero: {early}")
    return Recording(
        path, about, samples, arrived, times, unix_s, parser.format, parser.names, parser.units, {**parser.counters},
        tuple(remarks), notes,
    )  # fmt: skip


def _lost(counters: dict[str, int]) -> list[str]:
    """Return what a parser dropped and missed, one sentence for each kind."""
    counts = {
        "frames or lines that are damaged, and left out": sum(counters[name] for name in DAMAGED),
        "frames that are missing by their numbers": counters["gaps"],
        "times that the board began anew": counters["restarts"],
    }
    return [f"{what}: {n}" for what, n in counts.items() if n]


class _Block(NamedTuple):
    kind: bytes
    recording: int
    number: int
    unix_ns: int
    content: bytes


def _undamaged(path: Path, remarks: list[str]) -> list[_Block]:
    """Return the whole blocks of one recording, each once, in the order of the file."""
    data = path.read_bytes()
    found = list(_blocks(data))
    must = "a recording with a whole block (it begins with RRB3 or RRB2)"
    other = "one of a later edition (a newer version of repro reads it)"
    if data.startswith(b"RRB1"):
        other = "one of an earlier edition (version 1.0 reads it, and repro export writes it as a table)"
    require(found or not _ANOTHER.match(data), "file", path.name, must, other)
    require(found, "file", path.name, must, f"{len(data)} bytes without one")
    if damaged := len(data) - sum(_HEAD.size + _CRC.size + len(block.content) for block in found):
        remarks.append(f"bytes that are damaged or cut off, and left out: {damaged}")
    blocks = list(dict.fromkeys(found))
    if len(blocks) < len(found):
        remarks.append(f"blocks that are there twice, and read once: {len(found) - len(blocks)}")
    own = [block for block in blocks if block.recording == blocks[0].recording]
    if len(own) < len(blocks):
        remarks.append(f"blocks of another recording, left out: {len(blocks) - len(own)}")
    return own


def _blocks(data: bytes) -> Iterator[_Block]:
    view, magic = memoryview(data), _KNOWN.search(data)
    while magic and magic.start() <= len(data) - _HEAD.size - _CRC.size:
        at, begin = magic.start(), magic.start() + _HEAD.size + _CRC.size
        _, kind, recording, number, size, unix_ns = _HEAD.unpack_from(data, at)
        fits = size <= MOST_BYTES and begin + size <= len(data)
        found = crc32(view[begin : begin + size], crc32(view[at : at + _HEAD.size])) if fits else -1
        if undamaged := found == _CRC.unpack_from(data, begin - _CRC.size)[0]:
            yield _Block(kind, recording, number, unix_ns, data[begin : begin + size])
        magic = _KNOWN.search(data, begin + size if undamaged else at + 1)


def _in_order(blocks: list[_Block], name: str, remarks: list[str]) -> dict[int, _Block]:
    """Return blocks by number as they were written; what is missing is told."""
    order = [block.number for block in blocks]
    kept, last = dict(sorted(zip(order, blocks, strict=True))), max(order)
    gaps = [(a + 1, b - a - 1) for a, b in itertools.pairwise([-1, *kept]) if b > a + 1]
    if gaps:
        words = ", ".join(f"{n} from number {a}" for a, n in gaps[:10]) + ", ..." * (len(gaps) > 10)
        remarks.append(f"blocks that are missing: {sum(n for _, n in gaps)} of {last + 1} ({words})")
    if sorted(order) != order:
        remarks.append("blocks are not in the order in which they were written, and were read in that order")
    if kept[last].kind != b"E":
        remarks.append(f"{name} has no end: the recorder still runs or was killed, or the file was cut")
    return kept


def _noted(blocks: dict[int, _Block], remarks: list[str]) -> list[tuple[int, str]]:
    """Return the notes with their times [ns since 1970]; what another program put in is made readable, and told."""
    notes = [block for block in blocks.values() if block.kind == b"N"]
    texts = [plain(note.content.decode(errors="replace")) for note in notes]
    if odd := sum(text.encode() != note.content or not text for text, note in zip(texts, notes, strict=True)):
        remarks.append(f"notes that are damaged, empty or too long, and cut to what is readable: {odd}")
    return [(note.unix_ns, text) for text, note in zip(texts, notes, strict=True) if text]


def _parsed(blocks: dict[int, _Block], parser: Parser) -> tuple[list[Sample], Array]:
    """Return samples and when they arrived since 1970 [s]; of a long recording only what is to be read is kept."""
    samples, size, offsets, stamps, previous = [], 0, [], [], 0
    for number in list(blocks):
        block = blocks.pop(number)
        if block.kind == b"O" or number > previous + 1:  # half a line before a gap is no number
            parser.reopened()
        if block.kind == b"B":
            offsets.append(size)
            stamps.append(block.unix_ns)
            samples += parser.feed(block.content)
            size += len(block.content)
        previous = number
    parser.close()
    began = np.searchsorted(offsets, [sample.start for sample in samples], side="right") - 1
    return samples, np.array(stamps, dtype=np.int64)[began] / 1e9


def _json(content: bytes) -> Json:
    try:
        found = json.loads(content)
    except (ValueError, RecursionError):
        found = None
    return found if isinstance(found, dict) else {}


def _times(samples: list[Sample], arrived: Array, remarks: list[str]) -> tuple[Array, float]:
    """Return times from 0, and when that was since 1970 [s]: by the board's clock, if it is one."""
    start, times = float(arrived.min(initial=math.inf)) if len(arrived) else 0.0, None
    board_us = [sample.time_us for sample in samples]
    if samples and None not in board_us:
        times, ppm, jumps = board_times(arrived - start, np.array(board_us) / 1e6)
        if times is None:
            remarks.append("the times that the board sends do not pass as the computer's, and were not used")
        elif _stands_still(samples):
            times = None
            remarks.append(STANDS_STILL)
        else:
            if abs(ppm) > 200:
                remarks.append(f"the board's clock is {ppm:+.0f} ppm fast, which was corrected")
            if jumps:
                remarks.append(
                    f"jumps of the board's clock, after which times go on from those of arrival: {jumps}"
                )
    times = arrival_times(arrived - start) if times is None else times
    first = float(times.min()) if len(times) else 0.0
    return times - first, start + first


def _stands_still(samples: list[Sample]) -> bool:
    """Return whether the clock of a stream shows one time in many samples in a row, or in all of them."""
    last: dict[int, tuple[int | None, int]] = {}
    longest = 1
    for sample in samples:
        time_us, alike = last.get(sample.stream, (None, 0))
        last[sample.stream] = sample.time_us, alike + 1 if sample.time_us == time_us else 1
        longest = max(longest, last[sample.stream][1])
    return longest > STILL or (longest > 1 and len({sample.time_us for sample in samples}) == 1)


def arrival_times(arrived: Array) -> Array:
    """Return strictly increasing times [s]: samples that arrived together are spread over the time before.

    They are as far apart as samples usually are, but no further than there is time since the block before them.
    """
    arrived = np.maximum.accumulate(arrived)
    _, first, count = np.unique(arrived, return_index=True, return_counts=True)
    room = np.diff(arrived[first]) / count[1:]
    usual = np.median(room) if len(room) else 0.0
    step = np.minimum(np.append(usual, room)[: len(count)], usual)
    behind = np.repeat(first + count, count) - 1 - np.arange(len(arrived))
    apart = 1e-6 * np.arange(len(arrived))
    return np.maximum.accumulate(arrived - behind * np.repeat(step, count) - apart) + apart


def board_times(arrived: Array, board: Array) -> tuple[Array | None, float, int]:
    """Return the board's times [s] on the computer's clock, by how much the board's is fast [ppm], and its jumps.

    A sample arrives late by what cable, driver and computer take, and never early. So we lay a line through the least
    latenesses of all parts of a recording, by the median of slopes. Where the board began anew, the line does too:
    its clock jumps there, unless a sample was only late. Without a common passage of time there are no times.
    """
    from scipy.stats import theilslopes  # takes half a second, for which no recorder should wait

    late = arrived - board
    late -= _WRAP_S * np.rint((late - late[0]) / _WRAP_S)
    board = arrived - late
    # A reset takes the board's time back, or leaves a step of at least the time that it ran before.
    resets = np.flatnonzero((np.diff(board) < -0.1) | (np.abs(np.diff(late)) > 1.0)) + 1
    times, ppm, longest = np.empty_like(board), 0.0, 10.0
    for part in np.split(np.arange(len(board)), resets):
        least = np.array([k[np.argmin(late[k])] for k in np.array_split(part, min(64, len(part)))])
        span, slope, offset = float(np.ptp(board[part])), 0.0, float(np.median(late[least]))
        if np.ptp(late[least]) > 1 + 0.05 * span:
            return None, 0.0, 0
        if span >= 10 and len(least) > 2:
            slope, offset, *_ = np.asarray(theilslopes(late[least], board[least])).tolist()
        if span >= longest:
            ppm, longest = 1e6 * (1 / (1 + slope) - 1), span
        times[part] = board[part] * (1 + slope) + offset
    back, ahead = np.diff(board) < -0.1, np.abs(np.diff(times - board)) > 1.0
    return np.maximum.accumulate(times), ppm, int((back | ahead).sum())


def is_recording(path: str | Path) -> bool:
    """Return whether a file begins as a recording of any edition does."""
    if not Path(path).is_file():
        return False
    with Path(path).open("rb") as file:
        return file.read(3) == _MAGIC[:3]


def readings_of(robot: Robot, source: object) -> Readings:
    """Return the readings ``[t, s]`` of a robot from a recording or a table: a path, or what was read of it.

    Raises
    ------
    InputError
        If it is neither, or does not belong to the robot.
    """
    if isinstance(source, str | Path) and is_recording(source):
        source = read_recording(source)
    if not isinstance(source, Recording):
        return read_readings(robot, source)
    received = f"0 samples. {' '.join(source.remarks)}"
    require(len(source.samples), "recording", source.path.name, "one with readings of the robot", received)
    steps = Steps(robot, source=Labels(source.names, source.units, source.format))
    table = steps.table(source.samples, source.times, source.path.name)
    return read_readings(robot, table._replace(remarks=(*source.remarks, *steps.remarks)))
