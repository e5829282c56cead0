"""A recording read with one call: a table of frames, its metadata, and what had to be left out."""

from __future__ import annotations

import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from jaxtyping import Int

from repro.errors import bad_input
from repro_live.record.recording_file import (
    BLOCK,
    CRC,
    DEVICE,
    MAGIC,
    MOST_FRAMES,
    MOST_TEXT,
    SEQUENCE,
    row_type,
)
from repro_live.record.recording_metadata import metadata_of, parsed
from repro_live.wire.csv_text import RESERVED
from repro_live.wire.frame import Frame

_HEADER_BYTES = BLOCK.size + CRC.size
"""Bytes of a block before its frames or text."""
_NAMES = {
    "hall": ["z_counts", "y_counts", "x_counts"],
    "quaternions": ["x", "y", "z", "w"],
}


def channel_names(format: str, n: int) -> list[str]:
    """Return the names of the values of a frame, with the unit where the format has one.

    Parameters
    ----------
    format
        One of `repro_live.wire.formats.FORMATS`.
    n
        Number of values.

    Examples
    --------
    >>> channel_names("millivolts", 3)
    ['u1_mV', 'u2_mV', 'u3_mV']
    """
    names = _NAMES.get(format, [])
    if len(names) == n:
        return list(names)
    unit = "_mV" if format == "millivolts" else ""
    return [f"u{j + 1}{unit}" for j in range(n)]


def _columns(head: dict[str, Any], n: int) -> list[str]:
    """Return the names of the values: those of the lines where they have any."""
    names = head.get("channels")
    if head["format"] != "csv" or not isinstance(names, list) or len(names) != n:
        return channel_names(head["format"], n)
    plain = all(isinstance(name, str) and name not in RESERVED for name in names) and len(set(names)) == n
    return names if plain else channel_names("csv", n)


@dataclass(frozen=True)
class Recording:
    """A recording as read from its file.

    Attributes
    ----------
    frames
        One row per frame in order of arrival: ``time_s``, arrival after the start of the recording; ``host_ns``,
        arrival by the host's monotonic clock; ``stream``; ``sequence`` and ``device_us``, as sent, missing where the
        format has none; then the values under the names of :func:`channel_names` or, of ``csv``, of the lines;
        NaN where a frame has fewer.
    metadata
        The first block and the sidecar, or what there is of them; ``format`` and ``start_host_ns`` in any case.
    widths
        Number of values of each frame.
    notes
        What happened to the port, in order.
    torn_bytes
        Bytes after the last whole block: cut off by a crash, or being written at the moment. Left out.
    damaged_bytes
        Bytes of damaged blocks before that; left out.
    remarks
        What is damaged or not known, in words; empty if nothing.
    """

    frames: pd.DataFrame
    metadata: dict[str, Any]
    widths: Int[np.ndarray, " frames"]
    notes: list[dict[str, Any]]
    torn_bytes: int
    damaged_bytes: int
    remarks: tuple[str, ...] = ()

    @property
    def format(self) -> str:
        """Wire format that the frames came in."""
        return self.metadata["format"]

    @property
    def channels(self) -> list[str]:
        """Names of the columns that hold values."""
        return list(self.frames.columns[5:])

    def as_frames(self) -> Iterator[tuple[int, Frame]]:
        """Yield arrival [ns] and frame, as they were given to `RecordingFile.append`."""
        numbers = [
            [None if missing else int(number) for number, missing in zip(column, column.isna(), strict=True)]
            for column in (self.frames["sequence"], self.frames["device_us"])
        ]
        values = self.frames[self.channels].to_numpy(dtype=float)
        heads = zip(self.frames["host_ns"], self.frames["stream"], *numbers, values, self.widths, strict=True)
        for host_ns, stream, sequence, device_us, row, width in heads:
            yield int(host_ns), Frame(int(stream), sequence, device_us, tuple(row[:width].tolist()))


def read_recording(path: Path) -> Recording:
    """Read a recording, finished or not, whole or damaged: a damaged block costs what it held.

    Where the first block is damaged, the file beside the recording says what it said; without that file, format and
    start are taken from the frames, and the remarks say what is not known.

    Raises
    ------
    FileNotFoundError
        If there is no such file.
    InputError
        If it has no whole block of a recording.
    """
    data = path.read_bytes()
    found = _scan(data)
    if not found.blocks:
        begins = data.startswith(MAGIC)
        expected = (
            f"a recording ({'at least one block is whole' if begins else f'it starts with {MAGIC.decode()}'})"
        )
        received = f"{len(data)} bytes without a whole block" if begins else data[:16]
        raise bad_input("file", path.name, expected, received)
    tables = [
        np.frombuffer(b"".join(block.payload for block in blocks), row_type(width))
        for width, blocks in found.frames.items()
    ]
    first_ns = min((int(table["host_ns"].min()) for table in tables if len(table)), default=None)
    numbered = any(bool(table["known"].any()) for table in tables)
    metadata, remarks = metadata_of(path, found.head, first_ns, numbered=numbered)
    if left_out := found.torn_bytes + found.damaged_bytes:
        remarks.insert(0, f"{left_out} bytes of the recording are not whole and were left out")
    frames, widths = _table(found.frames, tables, metadata)
    return Recording(
        frames, metadata, widths, found.notes, found.torn_bytes, found.damaged_bytes, tuple(remarks)
    )


class _Block(NamedTuple):
    number: int
    """Place among the blocks of the file."""
    frames: int
    payload: bytes


class _Scan(NamedTuple):
    head: dict[str, Any] | None
    """Content of the text at the beginning of the file; None if that is damaged."""
    notes: list[dict[str, Any]]
    frames: dict[int, list[_Block]]
    """Blocks of frames by width."""
    blocks: int
    """Whole blocks of any kind."""
    torn_bytes: int
    damaged_bytes: int


def _scan(data: bytes) -> _Scan:
    head: dict[str, Any] | None = None
    notes: list[dict[str, Any]] = []
    frames: dict[int, list[_Block]] = {}
    at = lost = number = 0
    good_until = 0
    while at + _HEADER_BYTES <= len(data):
        magic, kind, width, count = BLOCK.unpack_from(data, at)
        size = count * row_type(width).itemsize if kind == b"F" and count <= MOST_FRAMES else count
        end = at + _HEADER_BYTES + size
        plausible = (
            magic == MAGIC and (kind == b"F" or (kind == b"H" and count <= MOST_TEXT)) and end <= len(data)
        )
        payload = data[at + _HEADER_BYTES : end] if plausible else b""
        (crc,) = CRC.unpack_from(data, at + BLOCK.size)
        whole = plausible and zlib.crc32(payload, zlib.crc32(data[at : at + BLOCK.size])) == crc
        text = parsed(payload) if whole and kind == b"H" else None
        if not whole or (kind == b"H" and text is None):
            again = data.find(MAGIC, end if whole else at + 1)
            at = len(data) if again < 0 else again
            continue
        lost += at - good_until
        if kind == b"F":
            frames.setdefault(width, []).append(_Block(number, count, payload))
        elif at == 0:
            head = text
        elif text is not None:
            notes.append(text)
        number += 1
        at = good_until = end
    return _Scan(head, notes, frames, number, len(data) - good_until, lost)


def _table(
    found: dict[int, list[_Block]], tables: list[np.ndarray], head: dict[str, Any]
) -> tuple[pd.DataFrame, np.ndarray]:
    """Put the frames of all blocks into one table, in the order of the file; return it and the frames' widths."""
    # Killed at once it has no frames yet, but the head tells their columns.
    most = max(found, default=len(head.get("channels", ())))
    numbers_of_blocks = [
        np.repeat([b.number for b in blocks], [b.frames for b in blocks]) for blocks in found.values()
    ]
    order = np.concatenate(numbers_of_blocks or [np.zeros(0)]).argsort(kind="stable")

    def column(name: str) -> np.ndarray:
        return np.concatenate([table[name] for table in tables] or [np.zeros(0, np.int64)])[order]

    values = np.full((len(order), most), np.nan)
    values[:] = np.concatenate(
        [np.pad(t["values"], ((0, 0), (0, most - t["values"].shape[1]))) for t in tables] or [values]
    )[order]
    widths, known, host_ns = (
        column("width").astype(np.int64),
        column("known"),
        column("host_ns").astype(np.int64),
    )
    values[np.arange(most) >= widths[:, None]] = np.nan
    numbers = {
        name: pd.arrays.IntegerArray(column(name).astype(np.int64), (known & bit) == 0)
        for name, bit in (("sequence", SEQUENCE), ("device_us", DEVICE))
    }
    stream = column("stream").astype(np.int64)
    table = pd.DataFrame(
        {"time_s": 1e-9 * (host_ns - head["start_host_ns"]), "host_ns": host_ns, "stream": stream} | numbers
    )
    names = _columns(head, most)
    return pd.concat([table, pd.DataFrame(values, columns=names)], axis=1), widths
