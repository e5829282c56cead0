"""Download of the public recordings: every file arrives complete and verified, or not at all."""

from __future__ import annotations

import re
import uuid
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from urllib.parse import quote

import pooch
from tqdm import tqdm

from edition1.errors import bad_input
from edition1_companion.recordings.released import difference
from edition1_companion.recordings.sources import RecordedFile

FILES = "https://raw.githubusercontent.com"
LARGE_FILES = "https://media.githubusercontent.com/media"
TIMEOUT_S = 30.0
NO_ANSWER, SILENT_IN_A_ROW = "the server did not answer in time", 3
NOT_TRIED = "not tried, because the server did not answer for those before"


@dataclass(frozen=True)
class FetchReport:
    """What became of the files asked for; each is named ``paper/path``. As text: all failures, then the counts."""

    fetched: list[str]
    """Downloaded and verified now."""
    kept: list[str]
    """Found verified; not asked for again."""
    failed: dict[str, str]
    """Why each missing file is missing: the message names file, address and place for a copy by hand."""

    def __str__(self) -> str:
        counts = f"{len(self.fetched)} fetched, {len(self.kept)} already there, {len(self.failed)} failed"
        return "\n".join([*self.failed.values(), counts])


def address(file: RecordedFile, mirror: str | None = None) -> str:
    """Return where a file is downloaded from.

    Parameters
    ----------
    file
        The file.
    mirror
        Address below which files lie as in the folder of recordings (``MIRROR/paper/path``): any such folder, served
        over HTTP. By default the file's commit at GitHub, for Git-LFS files at its media host.

    Raises
    ------
    InputError
        If the mirror is not an address that starts with http:// or https://.

    Examples
    --------
    >>> bag = RecordedFile("p2022", "bags/a b.bag", "owner/name", "0" * 40, "", "1" * 40, None, large=False)
    >>> address(bag, "http://localhost:8000")
    'http://localhost:8000/p2022/bags/a%20b.bag'
    """
    if mirror is not None:
        if not re.match(r"https?://[^/]", mirror):
            raise bad_input(
                "mirror", "repro fetch", "an address that starts with http:// or https://", mirror
            )
        return "/".join([mirror.rstrip("/"), quote(file.paper), quote(file.path)])
    host = LARGE_FILES if file.large else FILES
    return "/".join([host, file.repository, file.commit, quote(file.path)])


def is_there(file: RecordedFile, folder: Path) -> bool:
    """Return whether a folder of recordings holds the file, with the right content."""
    return difference(file, file.place(folder)) is None if file.place(folder).is_file() else False


def fetch(
    files: Sequence[RecordedFile], folder: Path, *, mirror: str | None = None, progress: bool = False
) -> FetchReport:
    """Download the files that a folder of recordings does not hold yet.

    A file is written under a hidden temporary name beside its place, verified, and only then renamed. So an
    interrupted download is continued by calling again: what has arrived is kept. A file of the right name but
    another content is replaced, once the right one has arrived. A file that fails does not stop the others.

    Parameters
    ----------
    files
        From `edition1_companion.recordings.sources.read_sources`.
    folder
        The folder of recordings, `edition1_companion.recordings.sources.data_dir`; created when needed. Files come to
        lie at ``paper/path``.
    mirror
        See `address`.
    progress
        Whether to show bars on standard error.

    Raises
    ------
    InputError
        As `address`; before anything is downloaded.
    """
    addresses = [address(file, mirror) for file in files]
    fetched, kept, failed, silent = [], [], {}, 0
    for file, url in tqdm(list(zip(files, addresses, strict=True)), unit="file", disable=not progress):
        name = f"{file.paper}/{file.path}"
        if is_there(file, folder):
            kept.append(name)
            continue
        # One silent host would otherwise cost its time-out once per file.
        why = NOT_TRIED if silent == SILENT_IN_A_ROW else _download(file, url, folder, progress)
        if why is None:
            fetched.append(name)
        else:
            failed[name] = (
                f"{file.path} of {file.paper} was not fetched: {why}.\n"
                f"  Its address: {url}\n"
                f"  A copy downloaded by hand is found as: {file.place(folder)}"
            )
        if why != NOT_TRIED:
            silent = silent + 1 if why == NO_ANSWER else 0
    return FetchReport(fetched, kept, failed)


def listing(files: Sequence[RecordedFile], folder: Path) -> str:
    """Return one line per paper: how many files, how many of them are in the folder, and where they come from."""
    lines = []
    for paper in dict.fromkeys(file.paper for file in files):
        listed = [file for file in files if file.paper == paper]
        there = sum(is_there(file, folder) for file in listed)
        megabytes = sum(file.size or 0 for file in listed) / 1e6
        source = f"github.com/{listed[0].repository} at {listed[0].commit[:7]}"
        lines.append(f"{paper}: {len(listed)} files, {megabytes:.1f} MB, {there} there; from {source}")
    return "\n".join(lines)


def _download(file: RecordedFile, url: str, folder: Path, progress: bool) -> str | None:
    """Bring one file to its place; return why that failed, or None."""
    import requests  # as pooch does: slow to import, and only this function needs it

    place = file.place(folder)
    temporary = place.with_name(f".{place.name}-{uuid.uuid4().hex}")
    try:
        place.parent.mkdir(parents=True, exist_ok=True)
        bar = {"desc": place.name, "total": file.size or 1, "unit": "B", "unit_scale": True, "leave": False}
        with tqdm(**bar, disable=not progress) as shown:
            loader = pooch.HTTPDownloader(progressbar=shown, chunk_size=65536, timeout=TIMEOUT_S)
            loader(url, str(temporary), None)
        if why := difference(file, temporary):
            return f"what arrived is not the released file ({why})"
        temporary.replace(place)
    except requests.HTTPError as error:
        answer = error.response
        return (
            f"the server answered {answer.status_code} {answer.reason}" if answer is not None else str(error)
        )
    except requests.Timeout:
        return NO_ANSWER
    except requests.ConnectionError:
        return "no connection"
    except requests.RequestException as error:
        return f"the download broke off ({type(error).__name__})"
    except OSError as error:
        return f"it cannot be written ({error.strerror})"
    finally:
        with suppress(OSError):  # not there, or nor is its folder
            temporary.unlink()
    return None
