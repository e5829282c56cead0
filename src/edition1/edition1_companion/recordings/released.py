"""Whether files are those that the authors released: their content against the list of the public recordings."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

from edition1.errors import require
from edition1_companion.recordings.sources import RecordedFile, data_dir


def unlike_released(
    paths: Iterable[Path], files: Sequence[RecordedFile], folder: Path | None = None
) -> dict[str, str]:
    """Return which files are not those of the list, as path below the folder and what differs; empty if all are.

    A file whose columns are exchanged, whose numbers were edited or whose end is missing reads like a good one; its
    hash does not.

    Parameters
    ----------
    paths
        Files that were read; they exist.
    files
        The list, of :func:`edition1_companion.recordings.sources.read_sources`.
    folder
        Of the recordings; by default :func:`edition1_companion.recordings.sources.data_dir`.
    """
    folder = folder or data_dir()
    listed = {file.place(folder): file for file in files}
    unlike = {}
    for path in paths:
        name = path.relative_to(folder).as_posix()
        if (file := listed.get(path)) is None:
            unlike[name] = "not in the list of the released files"
        elif difference(file, path):
            size = path.stat().st_size
            same = "of the same size" if size == file.size else f"{size} bytes instead of {file.size}"
            unlike[name] = f"other content than the released file, {same}"
    return unlike


def difference(file: RecordedFile, path: Path) -> str | None:
    """Return how a file's content differs from the released one, by hash, or None.

    Parameters
    ----------
    file
        The released file.
    path
        A file that exists.
    """
    kind, expected, found = _hashes(path, file.sha256, file.git_blob)
    return None if found == expected else f"{kind} {found} instead of {expected}"


def verified(path: Path, name: str, folder: str, *, sha256: str = "", git_blob: str = "") -> Path | None:
    """Return a released file's path, or None if it is not there.

    Raises
    ------
    InputError
        If the file found is not the released one, by its hash.
    """
    if not path.is_file():
        return None
    kind, expected, found = _hashes(path, sha256, git_blob)
    require(found == expected, name, folder, f"the released file, {kind} {expected}", f"{kind} {found}")
    return path


def _hashes(path: Path, sha256: str, git_blob: str) -> tuple[str, str, str]:
    """Which hash is known, the one expected, and the one found."""
    if sha256:
        with path.open("rb") as stream:
            return "sha256", sha256, hashlib.file_digest(stream, "sha256").hexdigest()
    return "git blob", git_blob, git_blob_hash(path.read_bytes())


def git_blob_hash(content: bytes) -> str:
    """Return the hash under which git stores a file's content.

    Examples
    --------
    >>> git_blob_hash(b"")
    'e69de29bb2d1d6434b8b29ae775ad8c2e48c5391'
    """
    return hashlib.sha1(b"blob %d\0" % len(content) + content, usedforsecurity=False).hexdigest()


def said_of_files(found: int, unlike: Mapping[str, str]) -> str:
    """Whether the files are the released ones."""
    if not found:
        return (
            "There are no recordings: what follows is **synthetic** and says nothing about the real sensor."
        )
    if not unlike:
        return f"All {found} files of this page that were found are the released ones, by their hashes."
    lines = [f"- `{name}`: {what}" for name, what in unlike.items()]
    said = f"**{len(unlike)} of {found} files are not the released ones; trust no number below.**"
    return "\n".join([said, "", *lines])
