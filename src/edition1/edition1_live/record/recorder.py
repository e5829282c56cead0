"""Record a port: read, parse, write, and go on when the port disappears and comes back."""

from __future__ import annotations

import math
import platform
import queue
import threading
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

from edition1 import __version__
from edition1.errors import require
from edition1_live.record.clock import DeviceClock
from edition1_live.record.ports import LastingPort
from edition1_live.record.recording_file import RecordingFile, WriteFailed, check_new, write_sidecar
from edition1_live.record.summary import Summary, Suspect, channels_of
from edition1_live.wire.csv_text import CsvParser, Layout
from edition1_live.wire.formats import parser
from edition1_live.wire.frame import Frame, Parser

_WAIT_S = 0.1
"""Longest wait for bytes, and so for noticing a request to stop [s]."""
_SHOW_S = 1.0
_SIDECAR_S = 10.0
_CLOCK_FRAMES = 256
"""The device's clock is compared with the host's when so many frames have come, and when the metadata are written."""
_MOSTLY_DROPPED = 20
"""So many lines or frames that were dropped are said at once if they are more than were accepted."""


def record(
    port: str,
    format: str,
    output: Path | None,
    *,
    baud: int = 115200,
    channels: int | None = None,
    duration_s: float = math.inf,
    stop: threading.Event | None = None,
    show: Callable[[Summary], None] | None = None,
    warn: Callable[[str], None] = print,
    each: Callable[[int, Sequence[Frame]], None] | None = None,
    watch: Callable[[str, str], None] | None = None,
    owner: str = "repro record",
    unit: str | None = None,
    notes: queue.SimpleQueue[dict[str, Any]] | None = None,
) -> Summary:
    """Record a port until told to stop.

    The file is created when the first frame arrives. A port that disappears is opened again as soon as it is back;
    a port that was never there is an error.

    Parameters
    ----------
    port, baud
        As for `edition1_live.record.ports.open_port`.
    format, channels, unit
        As for `edition1_live.wire.formats.parser`.
    output
        The recording; its metadata are written beside it, see `edition1_live.record.recording.sidecar_path`. None to
        record nothing, for `each` alone.
    duration_s
        Stop after this time [s].
    stop
        Stop when this is set, from a signal or another thread.
    show
        Is given the state once per second.
    warn
        Is given what the user should know at once: the port is gone, is back, sends something else.
    each
        Is given arrival [ns] and frames of everything that arrives, before it is written; must not take long.
    watch
        Is given what `warn` is, after a word for it: ``lost``, ``reopened``, or ``foreign`` for bytes that hold no
        frame of the format. With it these do not end the recording, whenever they come.
    owner
        The command that asks, for the messages of errors.
    notes
        What is put in from another thread is written among the frames: texts as JSON can hold them.

    Returns
    -------
    Summary
        The state at the end.

    Raises
    ------
    InputError
        The port cannot be opened, or what it sends in the first two seconds has no frame of the format (wrong rate,
        format or number of values) or says another unit; the file exists.
    WriteFailed
        The disk is full or refuses. What was written is kept.
    """
    require(duration_s > 0, "duration", owner, "a time above zero [s]", duration_s)
    session = _Session(port, format, output, baud, channels, unit, warn, each, watch, owner, notes)
    stop = stop or threading.Event()
    try:
        session.run(duration_s, stop, show)
    except BaseException as error:
        session.finish(str(error) or type(error).__name__)
        raise
    session.finish("stopped")
    return session.summary()


class _Session:
    def __init__(
        self,
        port: str,
        format: str,
        output: Path | None,
        baud: int,
        channels: int | None,
        unit: str | None,
        warn: Callable[[str], None],
        each: Callable[[int, Sequence[Frame]], None] | None,
        watch: Callable[[str, str], None] | None,
        owner: str,
        notes: queue.SimpleQueue[dict[str, Any]] | None,
    ) -> None:
        self.format, self.output, self.warn, self.channels = format, output, warn, channels
        self.each, self.watch = each, watch
        self.notes = notes or queue.SimpleQueue[dict[str, Any]]()
        self.layout: Layout | None = None
        self.loss_said = False
        self.parser: Parser = parser(format, channels, unit)
        self.clock = DeviceClock()
        self.times: list[tuple[int, int]] = []  # host [ns], device [us]; not yet given to the clock
        self.file: RecordingFile | None = None
        self.received = 0
        self.suspect: Suspect | None = Suspect(format, channels)
        self.unchanging: dict[str, Any] = {}
        if output is not None:
            check_new(output, owner)
        # before the port is open: it takes longer than a buffer may hold frames
        self.versions = {"repro": __version__} | {name: version(name) for name in ("pyserial", "numpy")}
        self.versions |= {"python": platform.python_version(), "system": platform.system()}
        self.port = LastingPort(port, baud, owner)
        self.start_ns, self.start_unix_s = time.monotonic_ns(), time.time()

    def run(self, duration_s: float, stop: threading.Event, show: Callable[[Summary], None] | None) -> None:
        end = time.monotonic() + duration_s
        shown = saved = time.monotonic()
        while not stop.is_set() and (now := time.monotonic()) < end:
            if now - shown >= _SHOW_S:
                shown += _SHOW_S * ((now - shown) // _SHOW_S)
                self.check_garbage()
                self.check_losses()
                if show is not None:
                    show(self.summary())
            if self.file is not None and now - saved >= _SIDECAR_S:
                saved = now
                self.save(self.file.path)
            try:
                self.take(min(_WAIT_S, end - now))
            except OSError as error:
                self.reconnect(error, end, stop)

    def take(self, timeout_s: float) -> None:
        """Read what is there, and write the frames that it completes."""
        chunk = self.port.read(timeout_s)
        host_ns = time.monotonic_ns()
        if not chunk:
            return
        self.received += len(chunk)
        frames = self.parser.feed(chunk)
        if self.suspect is not None:
            if frames:
                self.suspect = None
            else:
                self.suspect.add(chunk)
                self.check_garbage()
        if not frames:
            return
        if self.layout is None and isinstance(self.parser, CsvParser) and self.parser.layout is not None:
            self.layout = self.parser.layout
            self.warn(f"The lines have {self.layout}.")
        if self.each is not None:
            self.each(host_ns, frames)
        if self.file is None and self.output is not None:
            self.unchanging = self.description(len(frames[0].values))
            self.file = RecordingFile(self.output, self.unchanging)
            self.save(self.file.path)
        if self.file is not None:
            self.file.append(host_ns, frames)
            self.write_notes(self.file)
        self.times += [(host_ns, sent_us) for _, _, sent_us, _ in frames if sent_us is not None]
        if len(self.times) >= _CLOCK_FRAMES:
            self.set_clock()

    def set_clock(self) -> None:
        """Give the clock what it has not had yet: many frames at once cost little more than one."""
        if self.times:
            host_ns, device_us = np.array(self.times, dtype=np.int64).T
            self.times.clear()
            self.clock.add(host_ns, device_us)

    def check_garbage(self) -> None:
        """Refuse, or after good frames report, bytes that hold no frame of the format."""
        if self.suspect is None or not self.suspect.ripe():
            return
        message = self.suspect.verdict(self.port.name, self.port.baud, self.port.owner, self.parser.refused)
        self.suspect = None
        if not self.parser.counters.frames and self.watch is None:
            raise message
        self.tell("foreign", str(message))

    def check_losses(self) -> None:
        """Say once that most of what arrives is dropped."""
        summary = self.summary()
        known = self.suspect or self.loss_said
        if not known and summary.mostly_dropped and summary.dropped >= _MOSTLY_DROPPED:
            self.loss_said = True
            self.warn(f"Most of what arrives is not {self.format}: {summary.losses()}")

    def reconnect(self, error: OSError, end: float, stop: threading.Event) -> None:
        """Wait until the port can be opened again."""
        self.port.close()
        self.tell("lost", f"{self.port.name} is gone ({error}); waiting for it.")
        self.event("lost")
        if not self.port.reopen(end, stop):
            return
        self.parser.reopened()
        self.set_clock()
        self.clock.reopened()
        self.suspect = Suspect(self.format, self.channels)
        self.event("reopened")
        self.tell("reopened", f"{self.port.name} is back.")

    def save(self, path: Path) -> None:
        """Write the metadata as they are now."""
        try:
            write_sidecar(path, self.unchanging | self.metadata(None))
        except OSError as error:  # would look like a lost port
            raise WriteFailed(f"Writing beside {path.name} failed: {error.strerror}.") from error

    def tell(self, what: str, words: str) -> None:
        if self.watch is not None:
            self.watch(what, words)
        self.warn(words)

    def event(self, name: str) -> None:
        if self.file is not None:
            self.file.note({"event": name, "host_ns": time.monotonic_ns()})

    def write_notes(self, file: RecordingFile) -> None:
        while not self.notes.empty():
            file.note(self.notes.get())

    def finish(self, reason: str) -> None:
        """Close port and file, and complete the metadata."""
        self.port.close()
        if self.file is None:
            return
        try:
            self.write_notes(self.file)
            self.file.close()
        finally:
            try:
                write_sidecar(self.file.path, self.unchanging | self.metadata(reason))
            except OSError as error:
                self.warn(f"The metadata of {self.file.path.name} are those of a moment before: {error}.")

    def summary(self) -> Summary:
        counters = self.parser.counters.as_dict()
        counters |= {"reconnects": self.port.reconnects, "received_bytes": self.received}
        seconds = 1e-9 * (time.monotonic_ns() - self.start_ns)
        return Summary(self.output if self.file else None, counters, seconds, self.parser.refused)

    def description(self, width: int) -> dict[str, Any]:
        """Metadata that do not change."""
        host = {"start_unix_s": self.start_unix_s, "start_host_ns": self.start_ns, "versions": self.versions}
        port = self.port
        named = {"port": port.name, "port_description": port.description, "baud": port.baud}
        return {"format": self.format, **channels_of(self.format, width, self.layout), **named, **host}

    def metadata(self, ended: str | None) -> dict[str, Any]:
        """Return metadata that change."""
        self.set_clock()
        summary, fit = self.summary(), self.clock.fit()
        clock = fit and {k: None if math.isnan(v) else v for k, v in asdict(fit).items()}  # JSON has no NaN
        counted = {"counters": summary.counters, "first_malformed": summary.refused or None}
        return {"seconds": summary.seconds, "ended": ended, **counted, "clock": clock}
