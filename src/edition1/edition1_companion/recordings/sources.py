"""Where recordings lie on this computer, and which files of which repository they are.

The list of the public recordings is ``data/sources.json``: per paper the repository, the commit, and per file its
path there and its hash. Of the authors' repositories it names what an experiment of this project can use: from
Baaij et al. the trajectories T0 to T5 (readings, motion capture, configurations, and both merged, whole and as the
authors split them), from Mitchell et al. the bend and light-bulb tests, their motion capture, the authors' output
and the calibration readings, from Martin et al. the bags, the outputs behind the published figures, and the trial
itself. Files that repeat another byte by byte are left out.
"""

from __future__ import annotations

import json
import os
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Any

import platformdirs

from edition1.errors import bad_input, require

REPOSITORY = re.compile(r"https://github\.com/([\w.-]+/[\w.-]+)")


def data_dir() -> Path:
    """Return the folder of the recordings, absolute; it need not exist.

    The environment variable ``REPRO_DATA_DIR`` when it is set and not empty, else the user's cache
    (``~/.cache/repro`` on Linux, ``~/Library/Caches/repro`` on macOS).

    Returns
    -------
    Path
        The folder, with ``~`` expanded. Nothing is created: only the download of recordings writes there.
    """
    chosen = os.environ.get("REPRO_DATA_DIR", "")
    folder = (
        Path(chosen).expanduser() if chosen else Path(platformdirs.user_cache_dir("repro", appauthor=False))
    )
    return folder.absolute()


COMPILED_KERNELS = "numba"
"""Folder in the user's cache beside the recordings, which a run may fill: see :mod:`edition1.kernels.compilation`."""


def recordings_are_here() -> bool:
    """Return whether there is any recording below `data_dir`."""
    folder = data_dir()
    papers = [path for path in folder.iterdir() if path.name != COMPILED_KERNELS] if folder.is_dir() else []
    return any(path.is_file() for paper in papers for path in (paper, *paper.rglob("*")))


@dataclass(frozen=True)
class RecordedFile:
    """One file of a public repository, at one commit."""

    paper: str
    """Name of the paper, such as ``mitchell2021``: the folder below `data_dir`."""
    path: str
    """Path in the repository and below the paper's folder, with ``/``."""
    repository: str
    """Owner and name at GitHub."""
    commit: str
    """The commit, 40 hexadecimal digits."""
    sha256: str
    """SHA-256 of the content, empty where only the other hash is known."""
    git_blob: str
    """Hash under which git stores the content, empty where unknown."""
    size: int | None
    """Bytes, None where unknown."""
    large: bool
    """Whether the repository keeps the content in Git LFS; ``sha256`` is then its object id."""

    def place(self, folder: Path) -> Path:
        """Return where the file lies below a folder of recordings."""
        return folder / self.paper / self.path


def read_sources(manifest: Path, papers: Sequence[str] = ()) -> list[RecordedFile]:
    """Read the list of the public recordings.

    Parameters
    ----------
    manifest
        The list, ``data/sources.json``.
    papers
        Names of papers; all when empty.

    Raises
    ------
    InputError
        If there is no list, a paper is not in it, or an entry cannot be used: a repository that is not at GitHub, a
        commit that is not one, a path that is absolute or leads out of the paper's folder, or no hash.
    """
    require(manifest.is_file(), "list", "the recordings", "an existing file", manifest)
    listed: dict[str, Any] = json.loads(manifest.read_text(encoding="utf-8"))
    for paper in papers:
        require(paper in listed, "paper", "the recordings", f"one of {', '.join(sorted(listed))}", paper)
    return [
        _checked(paper, listed[paper], entry, manifest.name)
        for paper in papers or sorted(listed)
        for entry in listed[paper]["files"]
    ]


def _checked(paper: str, source: dict[str, Any], entry: dict[str, Any], owner: str) -> RecordedFile:
    require(re.fullmatch(r"\w+", paper), "paper", owner, "letters and digits", paper)
    if not (repository := REPOSITORY.fullmatch(source["repository"])):
        raise bad_input("repository", owner, "https://github.com/OWNER/NAME", source["repository"])
    if not re.fullmatch(r"[0-9a-f]{40}", source["commit"]):
        raise bad_input("commit", owner, "40 hexadecimal digits", source["commit"])
    path = PurePosixPath(entry["path"])
    # A backslash or a drive letter would lead elsewhere on Windows.
    inside = path.parts and not path.is_absolute() and ".." not in path.parts
    if not inside or re.search(r"[\\:\0]", entry["path"]) or str(path) != entry["path"]:
        raise bad_input("path", owner, f"a path inside the folder {paper}, without ..", repr(entry["path"]))
    hashes = entry.get("sha256", ""), entry.get("git_blob", "")
    if not any(hashes) or not re.fullmatch(r"([0-9a-f]{64})?,([0-9a-f]{40})?", ",".join(hashes)):
        raise bad_input("hash", owner, "a sha256 or a git blob hash", f"{hashes} for {entry['path']}")
    return RecordedFile(
        paper=paper,
        path=entry["path"],
        repository=repository[1],
        commit=source["commit"],
        sha256=hashes[0],
        git_blob=hashes[1],
        size=entry.get("size"),
        large=source.get("storage") == "git-lfs",
    )
