r"""The file of a recording: it only grows, and a crash cannot spoil it.

The file is a row of blocks, each written by one call and never touched again:

====== ======= ===========================================================
offset bytes   content (little endian)
====== ======= ===========================================================
0      4       ``RRB1``
4      1       ``H``: text (JSON); ``F``: frames
5      1       0
6      2       largest number of values of a frame of this block; 0 in text
8      4       number of frames; bytes of the text
12     4       CRC-32 (``zlib.crc32``) of the 12 bytes before and of what follows
16     ...     the frames or the text
====== ======= ===========================================================

A frame takes 20 bytes and 8 for each value: arrival by the host's monotonic clock [ns] (int64), device time [µs]
(uint32), sequence number (uint32), stream (uint16), number of values (uint8), which of sequence number (1) and device
time (2) the format has (uint8), values (float64). The first block tells the format and the start; later texts are
notes, such as that the port was opened anew. A block cut off at the end, or damaged, fails its checksum and is left
out and reported; the blocks after it are found again. Where it is the first one, the file beside the recording says
the same; without that, format and start are not known, and the frames are read all the same. The file can be read
while it is being written.
"""

from __future__ import annotations

import json
import os
import struct
import threading
import time
import uuid
import zlib
from collections.abc import Sequence
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from edition1.errors import bad_input, require
from edition1.files import write_whole
from edition1_live.wire.frame import Frame

MAGIC = b"RRB1"
SYNC_S = 1.0
"""The disk is asked to keep what was written once in this time [s]."""
MOST_FRAMES = 65536
"""Frames of one block."""
BLOCK = struct.Struct("<4scxHI")
CRC = struct.Struct("<I")
MOST_TEXT = 1 << 20
"""Bytes of one text."""
SEQUENCE, DEVICE = 1, 2
_NEW = "a new file (give another name, or move the old one)"


class WriteFailed(RuntimeError):
    """A recording that cannot be continued, such as on a full disk; what was written can be read."""


@cache
def row_type(width: int) -> np.dtype:
    """Return how a frame lies in a block whose frames have at most ``width`` values."""
    return np.dtype(
        [
            ("host_ns", "<i8"),
            ("device_us", "<u4"),
            ("sequence", "<u4"),
            ("stream", "<u2"),
            ("width", "u1"),
            ("known", "u1"),
            ("values", "<f8", (width,)),
        ]
    )


def _block(kind: bytes, width: int, count: int, payload: bytes) -> bytes:
    head = BLOCK.pack(MAGIC, kind, width, count)
    return head + CRC.pack(zlib.crc32(payload, zlib.crc32(head))) + payload


def _text(content: dict[str, Any]) -> bytes:
    payload = json.dumps(content).encode()
    return _block(b"H", 0, len(payload), payload)


@cache
def _row(width: int) -> struct.Struct:
    """Return :func:`row_type` for one frame at a time."""
    return struct.Struct(f"<qIIHBB{width}d")


def _frames(host_ns: int, frames: Sequence[Frame]) -> bytes:
    width = max(len(frame.values) for frame in frames)
    pack, payload = _row(width).pack, []
    for stream, sequence, device_us, values in frames:
        known = SEQUENCE * (sequence is not None) + DEVICE * (device_us is not None)
        padding = (0.0,) * (width - len(values))
        payload.append(
            pack(host_ns, device_us or 0, sequence or 0, stream, len(values), known, *values, *padding)
        )
    return _block(b"F", width, len(frames), b"".join(payload))


class RecordingFile:
    """A recording being written; use it in a ``with`` statement.

    Each call of `append` and `note` hands its block to the operating system at once, so that a killed process loses
    nothing that was handed over; a thread asks the disk to keep it every :data:`SYNC_S`, so that a power cut loses at
    most that time and what the disk itself holds back.

    Parameters
    ----------
    path
        The file, created here.
    metadata
        First block: ``format``, ``start_unix_s`` and ``start_host_ns`` at least.

    Raises
    ------
    InputError
        If the file exists, or another process makes it at the same moment: one of them has it, the other is refused.
    WriteFailed
        If it cannot be written.
    """

    def __init__(self, path: Path, metadata: dict[str, Any]) -> None:
        check_new(path, "RecordingFile")
        self.path = path
        self.frames = 0
        self.written_bytes = 0
        self.synced_bytes = 0
        """Bytes that a power cut leaves."""
        self._failure: OSError | None = None
        self._closing = threading.Event()
        head = _text(metadata)
        try:
            if not _created(path, head):
                raise bad_input(
                    "output", "RecordingFile", _NEW, f"{path}, which another program has just made"
                )
            self._file = os.open(path, os.O_WRONLY | os.O_APPEND | getattr(os, "O_BINARY", 0))
        except OSError as error:
            raise WriteFailed(f"{path} cannot be written: {error.strerror}.") from error
        self.written_bytes = self.synced_bytes = len(head)
        self._thread = threading.Thread(target=self._keep_in_sync, daemon=True)
        self._thread.start()

    def append(self, host_ns: int, frames: Sequence[Frame]) -> None:
        """Write frames that arrived together.

        Parameters
        ----------
        host_ns
            Their arrival by the host's monotonic clock [ns].
        frames
            In order of arrival.

        Raises
        ------
        WriteFailed
            If the disk is full or refuses; this and everything later is not recorded.
        """
        for first in range(0, len(frames), MOST_FRAMES):
            part = frames[first : first + MOST_FRAMES]
            self._write(_frames(host_ns, part))
            self.frames += len(part)

    def note(self, content: dict[str, Any]) -> None:
        """Write a text: what happened to the port, such as ``{"event": "reopened", "host_ns": 17}``."""
        self._write(_text(content))

    def close(self) -> None:
        """Keep everything on the disk and close the file; may be called again."""
        if self._closing.is_set():
            return
        self._closing.set()
        self._thread.join()
        try:
            self._sync()
        finally:
            os.close(self._file)

    def __enter__(self) -> RecordingFile:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _write(self, block: bytes) -> None:
        try:
            if self._failure is not None:
                raise self._failure
            rest = memoryview(block)
            while rest:
                rest = rest[os.write(self._file, rest) :]
        except OSError as error:
            self._failure = error
            raise self._failed(error) from error
        self.written_bytes += len(block)

    def _sync(self) -> None:
        written = self.written_bytes
        try:
            os.fsync(self._file)
        except OSError as error:
            self._failure = error
            raise self._failed(error) from error
        self.synced_bytes = written

    def _keep_in_sync(self) -> None:
        """Sync apart from the reader, which must not wait for a disk; a failure is raised by the next write."""
        due = time.monotonic() + SYNC_S
        while not self._closing.wait(max(0.0, due - time.monotonic())):
            due = time.monotonic() + SYNC_S
            try:
                self._sync()
            except WriteFailed:
                return

    def _failed(self, error: OSError) -> WriteFailed:
        kept = f"the {self.frames} frames written before are kept and can be read"
        return WriteFailed(f"Writing {self.path.name} failed: {error.strerror}; {kept}.")


def _created(path: Path, head: bytes) -> bool:
    """Put a file with its first block at ``path`` in one step: whoever finds the file can read it.

    Return False, and change nothing, if there is one.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    temporary = path.with_name(f".{path.name}-{uuid.uuid4().hex}")
    try:
        _write_new(temporary, head)
        try:
            os.link(temporary, path)  # never replaces a file, as a renaming does
        except FileExistsError:
            return False
        except OSError:  # a disk without links: the name is taken first, the block follows at once
            try:
                _write_new(path, head)
            except FileExistsError:
                return False
    finally:
        temporary.unlink(missing_ok=True)
    if os.name == "posix":  # the name of a file is kept by its folder
        folder = os.open(path.parent, os.O_RDONLY)
        try:
            os.fsync(folder)
        finally:
            os.close(folder)
    return True


def _write_new(path: Path, content: bytes) -> None:
    with path.open("xb") as stream:
        stream.write(content)
        stream.flush()
        os.fsync(stream.fileno())


def check_new(path: Path, owner: str) -> None:
    """Refuse a path at which a recording or its sidecar lies already."""
    for taken in (path, sidecar_path(path)):
        require(not taken.exists(), "output", owner, _NEW, taken)


def sidecar_path(path: Path) -> Path:
    """Return where the metadata of a recording lie: beside it, under its whole name and ``.json``."""
    return path.with_name(f"{path.name}.json")


def write_sidecar(path: Path, metadata: dict[str, Any]) -> None:
    """Write the metadata of the recording ``path`` beside it, whole or not at all."""
    write_whole(sidecar_path(path), json.dumps(metadata, indent=1) + "\n")
