"""The commands of `repro` that talk to a port; registered by `edition1_companion.cli`.

Each imports what it needs when it runs, so that help is instant.
"""

from __future__ import annotations

import math
import sys
import threading
from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from edition1.errors import bad_input, require
from edition1_companion.book.project import shown
from edition1_companion.cli_terminal import Screen, pairs, set_by_signals

Output = Annotated[Path | None, Parameter(name=["-o", "--output"])]
GivenFaults = Annotated[list[tuple[str, str]] | None, pairs("--fault", "NAME VALUE")]


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
        quaternions (IMUs of Martin et al.), csv (lines of numbers, with labels and units or without).
    output
        The recording, a new file; its metadata are written beside it.
    baud
        Bits per second; means nothing to a board that is itself a USB device.
    channels
        Values that every frame must have; by default any number for frames, that of the first lines
        for csv, three for millivolts.
    duration
        Stop after this many seconds.
    list_only
        Record nothing; print the ports found with their descriptions.
    """
    from edition1_live.record.ports import listing
    from edition1_live.record.recorder import record as record_port
    from edition1_live.record.recording_file import WriteFailed

    if list_only:
        print(listing())
        return 0
    require(port, "port", "repro record", "given (see repro record --list)", "none")
    if output is None:
        raise bad_input("output", "repro record", "given (-o FILE)", "none")
    stop, screen = threading.Event(), Screen(lambda summary: [str(summary)])
    set_by_signals(stop)
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
    if summary.dropped:
        screen.line(summary.losses())
    return int(summary.mostly_dropped)


def export(
    recording: Path,
    /,
    *,
    output: Output = None,
    to: str = "",
    schema: Annotated[str, Parameter(name="--as")] = "",
    robot: Path | None = None,
    estimates: Path | None = None,
) -> int:
    """Write a recording as a file for other programs: repro export RECORDING -o FILE.csv, .parquet or .mcap.

    Parameters
    ----------
    recording
        From repro record, of any number of channels.
    output
        A new file: a table with time_s, unix_s, stream and sequence where there are any, and a column for each value.
    to
        csv, parquet or mcap (for Foxglove and PlotJuggler); by default that of the name of the file, or csv.
    schema
        The layout of a paper instead: hall, millivolts (CSV) or quaternions (a ROS 1 bag).
    robot
        The robot file that says which unit the values have; columns are named by it.
    estimates
        For mcap: the table that repro track, smooth or live wrote of this recording; it stands beside the readings.
    """
    from edition1_live.record.export import export as export_to
    from edition1_live.record.recording import read_recording

    if output is None:
        raise bad_input("output", "repro export", "given (-o FILE)", "none")
    require(recording.is_file(), "recording", "repro export", "a file", f"{recording}, which is not there")
    unit = ""
    read = read_recording(recording)
    if robot is not None:
        from edition1.robot_file.load import load_robot
        from edition1_live.robot.readings_file import frames_of

        described = load_robot(robot)
        frames_of(read, described)  # refuses recordings of another robot; the table has all frames
        unit = described.unit if described.channel and not described.imus else ""
    for remark in (*read.remarks, *export_to(read, output, schema, to=to, unit=unit, estimates=estimates)):
        print(f"Note: {remark}.", file=sys.stderr)
    print(f"{shown(output)}  ({len(read.rows)} frames)")
    return 0


def import_(
    file: Path,
    /,
    *,
    output: Output = None,
    format: str = "",
    rate: float | None = None,
    unit: str = "",
) -> int:
    """Make a recording of a table, or of the lines that a sketch printed: repro import FILE.csv -o FILE.rec.

    Parameters
    ----------
    file
        A CSV with named columns, or lines such as x: 12 y: 3; with commas, semicolons, tabs or blanks, header or not.
        A column of times is called time_s, t_ms, millis or the like.
    output
        The recording, a new file; its metadata are written beside it.
    format
        As for repro record, where a robot file says another one than csv, such as frames.
    rate
        Readings per second, where the file has no times.
    unit
        Of the values whose names say none, such as mT.
    """
    from edition1_live.record.import_text import import_text

    if output is None:
        raise bad_input("output", "repro import", "given (-o FILE)", "none")
    summary, notes = import_text(file, output, format=format, rate_hz=rate, unit=unit)
    for note in notes:
        print(f"Note: {note}.", file=sys.stderr)
    if summary.dropped:
        print(summary.losses(), file=sys.stderr)
    print(f"{shown(output)}  ({summary.counters['frames']} frames)")
    return int(summary.mostly_dropped)


def emulate(
    source: str = "",
    /,
    *,
    format: str = "",
    rate: float | None = None,
    speed: float = 1.0,
    loop: Annotated[bool, Parameter(negative="")] = False,
    robot: Path | None = None,
    tolerances: float | None = None,
    hold_poses: Path | None = None,
    hold: float | None = None,
    fault: GivenFaults = None,
    fault_from: float = 0.0,
    seed: int = 0,
    port_file: Path | None = None,
    socket: int | None = None,
) -> int:
    """Play readings into a port as a board would: repro emulate SOURCE, or --robot ROBOT.toml; stop with Ctrl-C.

    Parameters
    ----------
    source
        lemniscate, spiral, flower, seagull, twin:T0 to twin:T5, arm (all synthetic), or a recording. Left out with
        --robot.
    format
        As for repro record; by default that of the source. frames takes any source.
    rate
        Readings per second of each stream.
    speed
        Times real time; inf: as fast as it is read.
    loop
        Begin again at the end.
    robot
        Play a robot as described in this file: it moves without end, and its sensors read what they would; synthetic.
    tolerances
        How far that robot is from its file: 0, the default, as described; 1 as repro calibrate assumes.
    hold_poses
        Write a table of poses to this new file, and hold that robot in one after the other: Enter moves it on.
    hold
        Move it on by itself after so many seconds instead, and write to the table when it is held.
    fault
        A fault and its value, such as --fault flips 1e-4; may be repeated. Chances of each byte: flips, drops,
        duplicates, bursts (of burst_bytes); of each frame: stalls (stall_s), disconnects (away_s), reboots (boot_s);
        and drift_ppm of the clock. With --robot also of a sensor, by its number: unplug, stick, saturate, gain (5 %
        more), nan; a foreign magnet at so many mm from the robot; and noise, times that of the file.
    fault_from
        The faults begin so many seconds after the first reading was sent.
    seed
        Of the faults, of synthetic readings, and of the robot and its motion.
    port_file
        Name of the port, a symbolic link; it goes and comes back with the port.
    socket
        Number of a TCP port of this computer instead, 0 for a free one; the default on Windows.
    """
    from edition1_companion.book.termination import stop_on_termination
    from edition1_companion.twins.takes import SOURCES, open_take
    from edition1_live.emulate.board import BLOCK, passages
    from edition1_live.emulate.emulator import Emulator
    from edition1_live.emulate.faults import Faults, faults_named
    from edition1_live.emulate.links import HAS_PTY, PtyLink, SocketLink

    require(fault_from >= 0, "fault_from", "repro emulate", "0 or more [s]", fault_from)
    require(seed >= 0, "seed", "repro emulate", "0 or more", seed)
    if not source and robot is None:
        expected = f"one of {', '.join(SOURCES)}, or a recording; or --robot ROBOT.toml"
        raise bad_input("source", "repro emulate", expected, "none")
    if socket is not None and port_file is not None:
        raise bad_input("port_file", "repro emulate", "left out with --socket", port_file)
    block = BLOCK
    if robot is None:
        (faults,) = faults_named(fault or [], Faults)
        options = {"tolerances": tolerances, "hold_poses": hold_poses, "hold": hold}
        for name, value in options.items():
            require(value is None, name, "repro emulate", "left out without --robot", value)
        take = open_take(source, format, rate_hz=rate, seed=seed)
        label, form, readings = take.label, take.format, take.readings(loop=loop)
    else:
        for name, value in (("source", source), ("format", format), ("loop", loop)):
            require(not value, name, "repro emulate", "left out with --robot", value)
        from edition1_live.emulate.robot_board import open_board
        from edition1_live.emulate.sensor_faults import SensorFaults

        faults, sensors = faults_named(fault or [], Faults, SensorFaults)
        board = open_board(
            robot,
            rate_hz=rate,
            tolerances=tolerances or 0.0,
            hold_poses=hold_poses,
            hold_s=hold,
            faults=sensors,
            from_s=fault_from,
            seed=seed,
        )
        label, form, readings, block = board.label, board.format, board.readings, board.block
        for note in board.notes:
            print(f"Warning: {note}", file=sys.stderr)
    sent = passages(readings, form, faults, seed=seed, from_s=fault_from, block=block)
    stop_on_termination()
    link = PtyLink(port_file) if HAS_PTY and socket is None else SocketLink(socket or 0)
    emulator = Emulator(sent, link, speed=speed)
    about = f"{label}, as {form}\nPort: {emulator.address}"
    try:
        with emulator:
            print(about, flush=True)
            emulator.wait()
    except KeyboardInterrupt:  # how it is stopped
        print(file=sys.stderr)
    return 0
