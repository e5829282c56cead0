"""A recording read with one call: a table of frames, its metadata, and what had to be left out."""

from __future__ import annotations

import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from jaxtyping import Float, Int

from edition1.errors import bad_input
from edition1_live.record.recording_file import (
    BLOCK,
    CRC,
    DEVICE,
    MAGIC,
    MOST_FRAMES,
    MOST_TEXT,
    SEQUENCE,
    row_type,
)
from edition1_live.record.recording_metadata import metadata_of, parsed
from edition1_live.wire.csv_text import RESERVED
from edition1_live.wire.formats import channel_names
from edition1_live.wire.frame import Frame

if TYPE_CHECKING:
    import pandas as pd

_HEADER_BYTES = BLOCK.size + CRC.size
"""Bytes of a block before its frames or text."""


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
    rows
        One row per frame in order of arrival, as :func:`~edition1_live.record.recording_file.row_type` has it.
    metadata
        The first block and the sidecar, or what there is of them; ``format`` and ``start_host_ns`` in any case.
    notes
        What happened to the port, in order.
    torn_bytes
        Bytes after the last whole block: cut off by a crash, or being written at the moment. Left out.
    damaged_bytes
        Bytes of damaged blocks before that; left out.
    remarks
        What is damaged or not known, in words; empty if nothing.
    """

    rows: np.ndarray
    metadata: dict[str, Any]
    notes: list[dict[str, Any]]
    torn_bytes: int
    damaged_bytes: int
    remarks: tuple[str, ...] = ()

    @property
    def format(self) -> str:
        """Wire format that the frames came in."""
        return self.metadata["format"]

    @cached_property
    def channels(self) -> list[str]:
        """Names of the values: those that the format gives them or, of ``csv``, those of the lines."""
        # Killed at once it has no frames yet, but the head tells their columns.
        return _columns(self.metadata, self.rows["values"].shape[1] or len(self.metadata.get("channels", ())))

    @property
    def widths(self) -> Int[np.ndarray, " frames"]:
        """Number of values of each frame."""
        return self.rows["width"].astype(np.int64)

    @property
    def host_ns(self) -> Int[np.ndarray, " frames"]:
        """Arrivals by the host's monotonic clock [ns]."""
        return self.rows["host_ns"].astype(np.int64)

    @property
    def time_s(self) -> Float[np.ndarray, " frames"]:
        """Arrivals after the start of the recording [s]."""
        return (self.host_ns - self.metadata["start_host_ns"]) / 1e9

    @property
    def stream(self) -> Int[np.ndarray, " frames"]:
        """Stream of each frame."""
        return self.rows["stream"].astype(np.int64)

    @property
    def values(self) -> Float[np.ndarray, "frames channels"]:
        """Values; NaN where a frame has fewer."""
        most = len(self.channels)
        values = self.rows["values"] if len(self.rows) else np.zeros((0, most))
        return np.where(np.arange(most) < self.rows["width"][:, None], values, np.nan)

    def sent(self, name: str) -> np.ma.MaskedArray:
        """Return ``sequence`` or ``device_us`` of each frame, as sent; masked where its format has none."""
        bit = {"sequence": SEQUENCE, "device_us": DEVICE}[name]
        return np.ma.array(self.rows[name].astype(np.int64), mask=(self.rows["known"] & bit) == 0)

    @cached_property
    def frames(self) -> pd.DataFrame:
        """A table of pandas: ``time_s``, ``host_ns``, ``stream``, ``sequence``, ``device_us``, then the values."""
        import pandas as pd

        numbers = {name: self.sent(name) for name in ("sequence", "device_us")}
        whole = {name: pd.arrays.IntegerArray(x.data, np.ma.getmaskarray(x)) for name, x in numbers.items()}
        heads = {"time_s": self.time_s, "host_ns": self.host_ns, "stream": self.stream}
        return pd.concat(
            [pd.DataFrame(heads | whole), pd.DataFrame(self.values, columns=self.channels)], axis=1
        )

    def as_frames(self) -> Iterator[tuple[int, Frame]]:
        """Yield arrival [ns] and frame, as they were given to `RecordingFile.append`."""
        numbers = [self.sent(name).tolist() for name in ("sequence", "device_us")]
        columns = (self.host_ns.tolist(), self.stream.tolist(), *numbers, self.rows["values"], self.widths)
        for host_ns, stream, sequence, device_us, row, width in zip(*columns, strict=True):
            yield host_ns, Frame(stream, sequence, device_us, tuple(row[:width].tolist()))


def read_recording(path: Path | str) -> Recording:
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
    path = Path(path)
    data = path.read_bytes()
    blocks = list(_blocks(data))
    if not blocks:
        begins = data.startswith(MAGIC)
        expected = (
            f"a recording ({'at least one block is whole' if begins else f'it starts with {MAGIC.decode()}'})"
        )
        received = f"{len(data)} bytes without a whole block" if begins else data[:16]
        raise bad_input("file", path.name, expected, received)
    head = blocks[0].content if blocks[0].start == 0 and blocks[0].kind == b"H" else None
    notes = [block.content for block in blocks if block.kind == b"H" and block.start]
    rows = _rows([block for block in blocks if block.kind == b"F"])
    first_ns = int(rows["host_ns"].min()) if len(rows) else None
    metadata, remarks = metadata_of(path, head, first_ns, numbered=bool(rows["known"].any()))
    torn = len(data) - blocks[-1].end
    damaged = blocks[-1].end - sum(block.end - block.start for block in blocks)
    if torn + damaged:
        remarks.insert(0, f"{torn + damaged} bytes of the recording are not whole and were left out")
    return Recording(rows, metadata, notes, torn, damaged, tuple(remarks))


class _Block(NamedTuple):
    start: int
    end: int
    kind: bytes
    width: int
    frames: int
    content: Any
    """Of a text what it says, of frames their bytes."""


def _blocks(data: bytes) -> Iterator[_Block]:
    """Find the whole blocks of a file, in order."""
    at = 0
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
        content = parsed(payload) if whole and kind == b"H" else payload
        if not whole or content is None:
            again = data.find(MAGIC, end if whole else at + 1)
            at = len(data) if again < 0 else again
            continue
        yield _Block(at, end, kind, width, count, content)
        at = end


def _rows(blocks: list[_Block]) -> np.ndarray:
    """Return the frames of all blocks, in the order of the file, as wide as the widest of them."""
    widths = np.repeat(*np.array([(block.width, block.frames) for block in blocks], int).reshape(-1, 2).T)
    rows = np.zeros(len(widths), row_type(max((block.width for block in blocks), default=0)))
    for width in sorted({block.width for block in blocks}):
        payload = b"".join(block.content for block in blocks if block.width == width)
        part, here = np.frombuffer(payload, row_type(width)), widths == width
        for name in ("host_ns", "device_us", "sequence", "stream", "width", "known"):
            rows[name][here] = part[name]
        rows["values"][here, :width] = part["values"]
    return rows
