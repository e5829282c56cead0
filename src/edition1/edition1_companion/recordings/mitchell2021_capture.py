"""Motion capture of Mitchell et al. (2021), exported by OptiTrack Motive: tilt of a body, marker exchanges undone.

Motive's world has its y axis upwards. A body's frame is parallel to the world's when the body is defined, here
upright, so the tilt of the body's y axis is how far it bends from upright, and the azimuth of that axis is where to.
"""

from __future__ import annotations

import csv
from dataclasses import dataclass
from datetime import datetime, timedelta, timezone
from pathlib import Path

import numpy as np
import pandas as pd
from scipy.spatial.transform import Rotation

from edition1.errors import bad_input, require
from edition1_companion.recordings.marker_exchanges import not_turned, undo_exchanges
from edition1_live.own.optitrack import HEADER_LINES, read_frames, read_header

BODY = "Module"
"""Name of the rigid body in the files."""
ZONE = timezone(timedelta(hours=-5))
"""Of the capture start in their header."""
LARGEST_STEP_DEG = 2.0
"""Turn between consecutive frames that counts as a jump [deg]: 240 deg/s, where bending takes 10 s."""
GUARD_FRAMES = 6
"""Frames masked on either side of a jump: 50 ms at 120 Hz."""


@dataclass(frozen=True)
class Capture:
    """The motion of one rigid body, what was undone and what was masked.

    Attributes
    ----------
    name
        The take's name in the file.
    start_unix_s
        Start of the capture by the header's clock, seconds since 1970 UTC.
    rate_hz
        Frames per second.
    motion
        One row per frame: ``time_s`` after the start; ``bend_rad``, angle between the body's y axis and the world's;
        ``direction_rad``, azimuth of the body's y axis about the world's, from world z towards world x, in
        (-pi, pi] and meaningless at zero bend; ``tilt_z_rad``, angle between the body's z axis and the world's, equal
        to the bend only where the body bends about world x; NaN in masked frames. ``moved_mm`` and
        ``moved_towards_rad``, horizontal displacement of the body since its first tracked frame, and its azimuth,
        counted as the direction is; ``undone``, whether an exchange of markers was
        undone.
    lost
        Frames in which the body was not tracked.
    turned
        Frames that are turned by more than 90 deg and could not be turned back: masked.
    near_jumps
        Other frames within 50 ms of a jump: masked.
    undone
        Frames in which an exchange of markers was undone.
    turns
        Different exchanges of markers that were found.
    masked_if_not_undone
        Share of the frames that would be masked if nothing were undone.
    """

    name: str
    start_unix_s: float
    rate_hz: float
    motion: pd.DataFrame
    lost: int
    turned: int
    near_jumps: int
    undone: int
    turns: int
    masked_if_not_undone: float

    @property
    def masked_share(self) -> float:
        """Share of the frames that is masked."""
        return (self.lost + self.turned + self.near_jumps) / len(self.motion)


def read_text(path: Path) -> str:
    """Return the content of a text file in UTF-8, without a byte order mark.

    Raises
    ------
    FileNotFoundError
        If there is no such file.
    InputError
        Bytes that are no text.
    """
    content = path.read_bytes()
    try:
        text = content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        seen = f"byte 0x{content[error.start]:02x} at {error.start}"
        raise bad_input("content", path.name, "text in UTF-8", seen) from error
    if "\0" in text:
        raise bad_input("content", path.name, "text in UTF-8", f"a zero byte at {text.index(chr(0))}")
    return text


def read_capture(path: Path) -> Capture:
    """Read one exported take.

    What is undone and what is masked follows from the motion capture alone:

    * lost: frames with empty cells;
    * turned: frames that are turned by more than 90 deg from the last frame that is not. Where that is an exchange of
      markers it is undone (:mod:`edition1_companion.recordings.marker_exchanges`), else the frame is masked;
    * near a jump: frames within `GUARD_FRAMES` of a step of more than `LARGEST_STEP_DEG` between consecutive frames
      that are neither lost nor turned, after the undoing.

    Parameters
    ----------
    path
        The file: CSV, quaternions XYZW (body to world), positions in mm, time in seconds.

    Raises
    ------
    FileNotFoundError
        If there is no such file.
    InputError
        A file that is no text; another format, version, rotation type or unit; a body that is not there; fewer frames
        than the header says; numbers that are none; times that do not increase; quaternions that are not unit; or a
        first frame that is not upright (which frames are turned is told from it).
    """
    try:
        rows = list(csv.reader(read_text(path).splitlines()))
    except csv.Error as error:
        raise bad_input("rows", path.name, "cells between commas", error) from error
    header = read_header(rows, path.name, version="1.21", frames=len(rows) - HEADER_LINES)
    start_unix_s = _start(header, path.name)
    if header.get("Length Units") != "Millimeters":
        raise bad_input("Length Units", path.name, "Millimeters", header.get("Length Units", "nothing"))
    columns = list(zip(rows[3], rows[5], rows[6], strict=False))
    wanted = [(BODY, "Rotation", axis) for axis in "XYZW"] + [(BODY, "Position", axis) for axis in "XZ"]
    if missing := [f"{kind} {axis}" for _, kind, axis in wanted if (BODY, kind, axis) not in columns]:
        bodies = ", ".join(sorted({name for name, _, _ in columns if name}))
        seen = f"{BODY}, without {', '.join(missing)}"
        raise bad_input("body", path.name, f"one with rotation and position (there are: {bodies})", seen)
    table = read_frames(rows[HEADER_LINES:], [1, *map(columns.index, wanted)], path.name)
    if not len(table) or not (np.diff(table[:, 0]) > 0).all():
        raise bad_input("Time", path.name, "increasing from frame to frame", "other times, or no frame")
    rate_hz = float(header["Capture Frame Rate"])
    return Capture(header["Take Name"], start_unix_s, rate_hz, *_motion(table, path.name))


def _start(header: dict[str, str], owner: str) -> float:
    """Return the start of the capture, seconds since 1970 UTC."""
    name = "Capture Start Time"
    require(name in header, name, owner, "in the header", "nothing")
    try:
        began = datetime.strptime(header[name], "%Y-%m-%d %I.%M.%S.%f %p").replace(tzinfo=ZONE)
    except ValueError as error:
        raise bad_input(name, owner, "a date and time", header[name]) from error
    return began.timestamp()


def _motion(table: np.ndarray, owner: str) -> tuple[pd.DataFrame, int, int, int, int, int, float]:
    """Return the masked motion, and the counts of :class:`Capture` in their order."""
    time_s, quaternions, place = table[:, 0], table[:, 1:5], table[:, 5:]
    tracked = np.isfinite(quaternions).all(axis=1)
    error = np.abs(np.linalg.norm(quaternions[tracked], axis=1) - 1.0)
    if not tracked.any() or error.max() > 1e-3:
        seen = f"an error of {error.max():.3g}" if tracked.any() else "no frame at all"
        raise bad_input("quaternions", owner, "unit within 0.001", seen)
    first = int(np.argmax(tracked))
    tilt = np.degrees(np.arccos(np.clip(Rotation.from_quat(quaternions[first]).as_matrix()[1, 1], -1.0, 1.0)))
    require(tilt < 45.0, "first frame", owner, "upright within 45 deg", f"{tilt:.1f} deg")
    upright = not_turned(quaternions, tracked)
    upright_again, undone, turns = undo_exchanges(quaternions, tracked, upright)
    kept = upright | undone
    known = kept & ~_near_jumps(upright_again, kept)
    axes = np.full((len(table), 3, 3), np.nan)
    axes[known] = Rotation.from_quat(upright_again[known]).as_matrix()
    moved = place - place[first]
    motion = pd.DataFrame(
        {
            "time_s": time_s,
            "bend_rad": np.arccos(np.clip(axes[:, 1, 1], -1.0, 1.0)),
            "direction_rad": np.arctan2(axes[:, 0, 1], axes[:, 2, 1]),
            "tilt_z_rad": np.arccos(np.clip(axes[:, 2, 2], -1.0, 1.0)),
            "moved_mm": np.linalg.norm(moved, axis=1),
            "moved_towards_rad": np.arctan2(moved[:, 0], moved[:, 1]),
            "undone": undone,
        }
    )
    left = len(table) - int((upright & ~_near_jumps(quaternions, upright)).sum())
    return (
        motion,
        int((~tracked).sum()),
        int((tracked & ~kept).sum()),
        int((kept & ~known).sum()),
        int(undone.sum()),
        turns,
        left / len(table),
    )


def _near_jumps(quaternions: np.ndarray, kept: np.ndarray) -> np.ndarray:
    """Return the frames within `GUARD_FRAMES` of a jump between consecutive frames that are both kept."""
    pairs = np.abs((quaternions[1:] * quaternions[:-1]).sum(axis=1))
    steps = np.degrees(2.0 * np.arccos(np.clip(pairs, 0.0, 1.0)))
    near = np.zeros(len(quaternions), dtype=bool)
    for k in np.flatnonzero((steps > LARGEST_STEP_DEG) & kept[1:] & kept[:-1]):
        near[max(0, k + 1 - GUARD_FRAMES) : k + 1 + GUARD_FRAMES] = True
    return near
