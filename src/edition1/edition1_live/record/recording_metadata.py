"""What is known of a recording besides its frames: from its first block, the file beside it, or the frames."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from edition1_live.record.recording_file import sidecar_path


def _is_unix_time(x: object) -> bool:
    return isinstance(x, int | float) and not isinstance(x, bool) and abs(x) < 1e12


def _is_time(x: object) -> bool:
    return isinstance(x, int) and not isinstance(x, bool) and abs(x) < 1 << 63


def _are_names(x: object) -> bool:
    return isinstance(x, list) and all(isinstance(name, str) for name in x)


_FITS = {
    "format": lambda x: isinstance(x, str),
    "start_host_ns": _is_time,
    "start_unix_s": _is_unix_time,
    "channels": _are_names,
    "counters": lambda x: isinstance(x, dict),
    "clock": lambda x: x is None or isinstance(x, dict),
}


def parsed(payload: bytes) -> dict[str, Any] | None:
    """Return the content of a text; None if it is not a JSON object."""
    try:
        content = json.loads(payload.decode())
    except (ValueError, RecursionError):
        return None
    return content if isinstance(content, dict) else None


def metadata_of(
    path: Path, head: dict[str, Any] | None, first_ns: int | None, *, numbered: bool
) -> tuple[dict[str, Any], list[str]]:
    """Return the metadata of a recording, with ``format`` and ``start_host_ns`` in any case, and what they lack.

    The first block says what does not change; the file beside it adds to it, or takes its place where it is damaged.

    Parameters
    ----------
    path
        Of the recording.
    head
        Content of the first block; None if it is damaged.
    first_ns
        Arrival of the first frame [ns]; None without one.
    numbered
        Whether frames have sequence numbers or times of the board, as those of the format ``frames`` alone have.
    """
    remarks: list[str] = []
    kept = {} if head is None else _usable(head, "its first block", remarks)
    beside = sidecar_path(path)
    try:
        added = parsed(beside.read_bytes())
    except OSError:  # a power cut may have left none
        added = {}
    if added is None:
        remarks.append(f"{beside.name} is not a JSON object and was left out")
        added = {}
    added = _usable(added, beside.name, remarks)
    start = added.get("start_host_ns")
    if start is not None and not _belongs(start, kept.get("start_host_ns"), first_ns):
        remarks.append(f"{beside.name} belongs to another recording and was left out")
        added = {}
    if head is None and added:
        remarks.append(f"its first block is damaged: what that said is taken from {beside.name}")
    elif head is None:
        remarks.append("its first block is damaged, and nothing beside it says the same")
    found = added | kept
    if "format" not in found:
        found["format"] = "frames"
        if not numbered:
            remarks.append("its format is not known: the values are read as those of frames, without a unit")
    if "start_host_ns" not in found:
        found["start_host_ns"] = 0 if first_ns is None else first_ns
        remarks.append("when it started is not known: time is counted from its first frame")
    return found, remarks


def _usable(content: dict[str, Any], name: str, remarks: list[str]) -> dict[str, Any]:
    """Return metadata without those that are not of their type, which are named in the remarks."""
    wrong = [key for key, fits in _FITS.items() if key in content and not fits(content[key])]
    if wrong:
        remarks.append(f"{name} has no usable {', '.join(wrong)}")
    return {key: value for key, value in content.items() if key not in wrong}


def _belongs(start_ns: int, own_start_ns: int | None, first_ns: int | None) -> bool:
    """Return whether metadata with this start can be those of a recording with this start or first frame."""
    if own_start_ns is not None:
        return start_ns == own_start_ns
    return first_ns is None or start_ns <= first_ns
