"""The commands of `repro` that talk to a port; registered by `repro.cli`.

Each imports what it needs when it runs, so that help is instant.
"""

from __future__ import annotations

import math
import signal
import sys
import threading
import time
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter

from repro.cli_pairs import pairs
from repro.errors import bad_input

if TYPE_CHECKING:
    from repro.live.record.recorder import Summary

Output = Annotated[Path | None, Parameter(name=["-o", "--output"])]
GivenFaults = Annotated[list[tuple[str, str]] | None, pairs("--fault", "NAME VALUE")]
PLAIN_S = 10.0
"""Time between two lines where the output is no terminal [s]."""


def record(
    port: str = "",
    /,
    *,
    format: str = "frames",
    output: Output = None,
    baud: int = 115200,
    channels: int | None = None,
    duration: float = math.inf,
    list_only: Annotated[bool, Parameter(name="--list", negative="")] = False,
) -> int:
    """Record a port: repro record PORT --format FORMAT -o FILE; stop with Ctrl-C.

    Parameters
    ----------
    port
        Such as /dev/ttyACM0, COM3 or socket://localhost:7000.
    format
        What the board sends: frames (ours), hall (integers of Mitchell et al.), millivolts (rig of Baaij et al.),
        quaternions (IMUs of Martin et al.).
    output
        The recording, a new file; its metadata are written beside it.
    baud
        Bits per second; means nothing to a board that is itself a USB device.
    channels
        Values that every frame must have; by default any number for frames, three for millivolts.
    duration
        Stop after this many seconds.
    list_only
        Record nothing; print the ports found with their descriptions.
    """
    from repro.live.record.ports import listing
    from repro.live.record.recorder import record as record_port
    from repro.live.record.recording_file import WriteFailed
    from repro.report.project import shown

    if list_only:
        print(listing())
        return 0
    if not port:
        raise bad_input("port", "repro record", "given (see repro record --list)", "none")
    if output is None:
        raise bad_input("output", "repro record", "given (-o FILE)", "none")
    stop, screen = threading.Event(), _Screen()
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: stop.set())
    try:
        summary = record_port(
            port,
            format,
            output,
            baud=baud,
            channels=channels,
            duration_s=duration,
            stop=stop,
            show=screen.show,
            warn=screen.line,
        )
    except WriteFailed as failure:
        screen.line(f"repro: {failure}")
        return 1
    screen.line(str(summary))
    if summary.path is None:
        screen.line("No frame came; nothing was written.")
        return 1
    print(shown(summary.path))
    return 0


def export(
    recording: Path, /, *, output: Output = None, schema: Annotated[str, Parameter(name="--as")] = ""
) -> int:
    """Write a recording as a file that the loaders read: repro export RECORDING -o FILE.

    Parameters
    ----------
    recording
        From repro record.
    output
        A new file: CSV for hall and millivolts, a ROS 1 bag for quaternions.
    schema
        hall, millivolts or quaternions; needed for a recording of the format frames, which tells no unit.
    """
    from repro.live.record.export import export as export_to
    from repro.live.record.recording import read_recording
    from repro.report.project import shown

    if output is None:
        raise bad_input("output", "repro export", "given (-o FILE)", "none")
    if not recording.is_file():
        raise bad_input("recording", "repro export", "a file", f"{recording}, which is not there")
    read = read_recording(recording)
    for remark in (*read.remarks, *export_to(read, output, schema)):
        print(f"Note: {remark}.", file=sys.stderr)
    print(f"{shown(output)}  ({len(read.frames)} frames)")
    return 0


def emulate(
    source: str = "",
    /,
    *,
    format: str = "",
    rate: float | None = None,
    speed: float = 1.0,
    loop: Annotated[bool, Parameter(negative="")] = False,
    fault: GivenFaults = None,
    seed: int = 0,
    port_file: Path | None = None,
    socket: int | None = None,
) -> int:
    """Play readings into a port as a board would: repro emulate SOURCE; stop with Ctrl-C.

    Parameters
    ----------
    source
        lemniscate, spiral, flower, seagull, twin:T0 to twin:T5, arm (all synthetic), or a recording.
    format
        As for repro record; by default that of the source. frames takes any source.
    rate
        Readings per second of each stream.
    speed
        Times real time; inf: as fast as it is read.
    loop
        Begin again at the end.
    fault
        A fault and its value, such as --fault flips 1e-4; may be repeated. Chances of each byte: flips, drops,
        duplicates, bursts (of burst_bytes); of each frame: stalls (stall_s), disconnects (away_s), reboots (boot_s);
        and drift_ppm of the clock.
    seed
        Of the faults and of synthetic readings.
    port_file
        Name of the port, a symbolic link; it goes and comes back with the port.
    socket
        Number of a TCP port of this computer instead, 0 for a free one; the default on Windows.
    """
    from repro.live.emulate.board import passages
    from repro.live.emulate.emulator import Emulator
    from repro.live.emulate.faults import faults_named
    from repro.live.emulate.links import HAS_PTY, PtyLink, SocketLink
    from repro.live.emulate.takes import SOURCES, open_take
    from repro.report.runner import stop_on_termination

    if not source:
        raise bad_input("source", "repro emulate", f"one of {', '.join(SOURCES)}, or a recording", "none")
    if socket is not None and port_file is not None:
        raise bad_input("port_file", "repro emulate", "left out with --socket", port_file)
    take = open_take(source, format, rate_hz=rate, seed=seed)
    sent = passages(take.readings(loop=loop), take.format, faults_named(fault or []), seed=seed)
    stop_on_termination()
    link = PtyLink(port_file) if HAS_PTY and socket is None else SocketLink(socket or 0)
    emulator = Emulator(sent, link, speed=speed)
    about = f"{take.label}, as {take.format}\nPort: {emulator.address}"
    try:
        emulator.run(lambda: print(about, flush=True))
    except KeyboardInterrupt:  # how it is stopped
        print(file=sys.stderr)
    return 0


class _Screen:
    """Standard error: one line that is written over on a terminal, now and then a line elsewhere."""

    def __init__(self) -> None:
        self._terminal = sys.stderr.isatty()
        self._shown = time.monotonic()
        self._width = 0

    def show(self, summary: Summary) -> None:
        if self._terminal:
            text = str(summary)
            print(f"\r{text:{self._width}}", end="", file=sys.stderr, flush=True)
            self._width = len(text)
        elif time.monotonic() - self._shown >= PLAIN_S - 0.5:
            self._shown = time.monotonic()
            print(summary, file=sys.stderr, flush=True)

    def line(self, text: str) -> None:
        print("\n" * (self._width > 0) + text, file=sys.stderr, flush=True)
        self._width = 0
