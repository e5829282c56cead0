"""Files by content: hashes of files and folders, and files that are written only if they change."""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Collection, Iterator
from pathlib import Path
from typing import Any

from edition1.files import write_whole


def file_digest(path: Path) -> str:
    """Return the SHA-256 of a file's content, as 64 hexadecimal digits."""
    with path.open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


def tree_digests(folder: Path, *, leave_out: Collection[str] = ()) -> dict[str, str]:
    """Return the SHA-256 of every file below a folder.

    Parameters
    ----------
    folder
        Where to look; links are followed. A folder that does not exist counts as empty.
    leave_out
        Folders, as paths relative to ``folder`` with ``/``, that are not entered.

    Returns
    -------
    dict
        Path relative to ``folder`` (with ``/``) to hash, sorted by path. Hidden files and folders and
        ``__pycache__`` are left out: nothing reads them as input.
    """
    found = {
        path.relative_to(folder).as_posix(): path for path in _files(folder, folder, set(leave_out), set())
    }
    return {name: file_digest(found[name]) for name in sorted(found)}


def _files(folder: Path, top: Path, leave_out: set[str], entered: set[str]) -> Iterator[Path]:
    real = os.path.realpath(folder)
    # A link to a folder further up would otherwise be followed for ever.
    if real in entered or not folder.is_dir():
        return
    entered.add(real)
    for entry in os.scandir(folder):
        path = Path(entry.path)
        if entry.name.startswith(".") or entry.name == "__pycache__":
            continue
        if entry.is_dir():
            if path.relative_to(top).as_posix() not in leave_out:
                yield from _files(path, top, leave_out, entered)
        elif entry.is_file():
            yield path


def combined_digest(content: Any) -> str:
    """Return one SHA-256 of anything that JSON can hold; the order of dictionaries does not matter."""
    return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()


def write_if_changed(path: Path, text: str) -> bool:
    """Write a text file with :func:`write_whole` unless it has this content; return whether it wrote."""
    if path.is_file() and path.read_text(encoding="utf-8") == text:
        return False
    write_whole(path, text)
    return True
