"""Poses at a port: a person brings the robot into one after the other, and what then arrives is averaged."""

from __future__ import annotations

import queue
import threading
import time
from collections.abc import Callable, Generator, Iterator
from contextlib import contextmanager

import numpy as np
import torch

from edition1.errors import InputError, bad_input
from edition1.robot_file.columns import MAGNETIC_STREAM
from edition1.robot_file.robot_file import RobotFile
from edition1_live.record.ports import LastingPort
from edition1_live.robot.calibration_poses import (
    WINDOW_S,
    PoseReadings,
    Poses,
    moved,
    pose_readings,
)
from edition1_live.robot.kept_readings import KeptReadings, Part, part_of
from edition1_live.wire.formats import parser
from edition1_live.wire.frame import Frame

_SILENCE_S = 2.0
"""After so long without a frame the board counts as away, and the person is told [s]."""
_PATIENCE_S = 300.0
"""A board that stays away for longer is not waited for [s]."""
_SETTLE_S = 0.1
"""Frames that arrive so soon after the key may have been sent before it [s]: they lay in a buffer on the way."""
_LEAST_FRAMES = 2
"""Frames of a pose at least, however slow the board is."""
_LOOK_S = 0.1
"""How long a port is looked at for frames, or for its return, at a time [s]."""
_LEAVE_S = 1.0
"""How long the end of reading is waited for [s]."""


def guide(
    robot: RobotFile,
    poses: Poses,
    frames: Iterator[Frame | None],
    *,
    say: Callable[[str], object],
    ask: Callable[[str], object],
    kept: KeptReadings | None = None,
    silence_s: float = _SILENCE_S,
    patience_s: float = _PATIENCE_S,
) -> PoseReadings:
    """Lead a person through the poses: say each, wait for a key, average half a second of what then arrives.

    Frames are taken in all the time, so that those averaged arrived after the key was pressed. A pose that was not
    still is asked for once more. If the board goes silent its pose begins anew, by itself, when it is back.

    Parameters
    ----------
    robot
        As described.
    poses
        In the order in which they are asked for; times have no meaning here.
    frames
        From a port, without end, as of :func:`port_frames`; read in a thread of its own, which ends with the next
        one, or the next None.
    say, ask
        Show a line; show a line and wait for the Enter key.
    kept
        File that takes the readings of every pose as soon as they are there; poses that it holds already are not
        asked for again. None to keep them in memory only.
    silence_s, patience_s
        Time without a frame after which the board counts as away, and longest wait for it [s].

    Raises
    ------
    InputError
        If the board stays away, frames have another number of values than the file says, or ``kept`` holds
        readings of other poses. Poses that were taken stay in ``kept``.
    """
    parts = [] if kept is None else list(kept.parts)
    if kept is not None and parts:
        _check_same_poses(kept, poses)
        rest = f"Going on with pose {len(parts) + 1}" if len(parts) < len(poses.words) else "All are taken"
        say(
            f"{kept.path.name} holds the readings of {len(parts)} poses. {rest}; to begin anew, move it away."
        )
    if len(parts) == len(poses.words):
        return pose_readings(parts, robot)
    with _read(frames) as arriving:
        for k in range(len(parts), len(poses.words)):
            question = (
                f"Pose {k + 1} of {len(poses.words)}: {poses.words[k]}. Hold it still and press Enter. "
            )
            part = _taken(robot, arriving, question, say, ask, (silence_s, patience_s))
            if moved(part, robot):
                say("That was not still: once more.")
                part = _taken(robot, arriving, question, say, ask, (silence_s, patience_s))
            parts.append(part)
            if kept is not None:
                kept.add(poses.q[k], part)
    return pose_readings(parts, robot)


def _check_same_poses(kept: KeptReadings, poses: Poses) -> None:
    """Refuse readings that were taken in other poses.

    Raises
    ------
    InputError
        As said.
    """
    q = torch.tensor(kept.q, dtype=torch.float64).reshape(-1, poses.q.shape[-1])
    if len(q) > len(poses.q) or not torch.allclose(q, poses.q[: len(q)], rtol=1e-9, atol=1e-12):
        expected = (
            "of the first poses of the table (give the file in place of the port to use it with another table, or "
            "move it away to begin anew)"
        )
        raise bad_input("readings", kept.path.name, expected, f"those of {len(q)} other poses")


def port_frames(
    port: str, baud: int, robot: RobotFile, say: Callable[[str], object]
) -> Iterator[Frame | None]:
    """Open a port now, and return the frames of magnetic sensors, without end.

    A port that disappears is opened again when it is back. None comes after every look at the port, so that whoever
    reads can leave while nothing arrives.

    Raises
    ------
    InputError
        If it cannot be opened the first time.
    """
    channels = robot.channels if robot.format == "csv" else None
    board, parse = LastingPort(port, baud, "repro calibrate"), parser(robot.format, channels, robot.unit)

    def frames() -> Iterator[Frame | None]:
        try:
            while True:
                try:
                    arrived = parse.feed(board.read(_LOOK_S))
                except OSError as error:
                    say(f"{port} is gone ({error}); waiting for it.")
                    board.close()
                    while not board.reopen(time.monotonic() + _LOOK_S, threading.Event()):
                        yield None
                    parse.reopened()
                    say(f"{port} is back.")
                    continue
                yield from (x for x in arrived if x.stream == MAGNETIC_STREAM)
                yield None
        finally:
            board.close()

    return frames()


_Arriving = queue.SimpleQueue[tuple[float, Frame] | BaseException]
"""Frames with their arrival [s]; at the end, why no more will come."""


def _taken(
    robot: RobotFile,
    arriving: _Arriving,
    question: str,
    say: Callable[[str], object],
    ask: Callable[[str], object],
    limits_s: tuple[float, float],
) -> Part:
    """Ask for a pose, and return its readings; told and waited for while the board is away."""
    ask(question)
    silence_s, patience_s = limits_s
    since, told = time.monotonic(), False
    from_s = since + _SETTLE_S
    arrived: list[tuple[float, Frame]] = []
    while not (len(arrived) >= _LEAST_FRAMES and arrived[-1][0] - arrived[0][0] >= WINDOW_S):
        try:
            found = arriving.get(timeout=silence_s)
        except queue.Empty:
            if time.monotonic() - since >= patience_s:
                raise _too_few(f"none for {patience_s:g} s") from None
            if not told:
                say(f"No frame for {silence_s:g} s: waiting for the board. Keep the pose; Ctrl-C ends.")
            arrived, told = [], True
            continue
        if isinstance(found, BaseException):
            if not _usable(robot, arrived):
                _refuse(robot, arrived)
            raise _too_few(f"{len(arrived)} of them: {found}")
        if found[0] < from_s:  # it may have been on the way
            continue
        since = found[0]
        if told:
            say("The board is back; half a second from now on.")
            from_s, told = since + _SETTLE_S, False
            continue
        arrived.append(found)
    fit = _usable(robot, arrived)
    if 2 * len(fit) < len(arrived):
        _refuse(robot, arrived)
    return part_of(np.array([frame.values for _, frame in fit]), fit[-1][0] - fit[0][0])


def _too_few(received: str) -> InputError:
    return bad_input("frames", "repro calibrate", f"{WINDOW_S:g} s of them for a pose", received)


def _usable(robot: RobotFile, arrived: list[tuple[float, Frame]]) -> list[tuple[float, Frame]]:
    return [(t, f) for t, f in arrived if len(f.values) == robot.channels and np.isfinite(f.values).all()]


def _refuse(robot: RobotFile, arrived: list[tuple[float, Frame]]) -> None:
    """Say why frames cannot be used, if there are any."""
    for _, frame in arrived:
        robot.signal(frame.values)  # refuses another number of values
    if arrived:
        raise bad_input("frames", "the stream", "of finite numbers", arrived[-1][1].values)


@contextmanager
def _read(frames: Iterator[Frame | None]) -> Iterator[_Arriving]:
    """Read frames in a thread, all the time, so that their arrival is known."""
    arriving, over = _Arriving(), threading.Event()

    def read() -> None:
        end: BaseException = EOFError("the stream ended")
        try:
            for frame in frames:
                if over.is_set():
                    break
                if frame is not None:
                    arriving.put((time.monotonic(), frame))
        except Exception as error:  # belongs to whoever waits for frames
            end = error
        if isinstance(frames, Generator):
            frames.close()  # and with it the port
        arriving.put(end)

    thread = threading.Thread(target=read, daemon=True)
    thread.start()
    try:
        yield arriving
    finally:
        over.set()
        thread.join(_LEAVE_S)
