"""Whether files are those that the authors released: their content against the list of the public recordings."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path

from repro.recordings.download import difference
from repro.recordings.sources import RecordedFile, data_dir


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
        The list, of :func:`repro.recordings.sources.read_sources`.
    folder
        Of the recordings; by default :func:`repro.recordings.sources.data_dir`.
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
