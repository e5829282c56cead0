"""The authors' public recordings: which files there are, and their download, each verified by its hash.

``data/sources.json`` names for each paper the repository, the commit, per file its path there and its hash, and for
paths that begin alike the page that reads them, and for what.
"""

from __future__ import annotations

import hashlib
import json
import re
import signal
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from itertools import groupby
from pathlib import Path, PurePosixPath
from typing import BinaryIO
from urllib.parse import quote, urljoin

from repro.common import InputError, bad_input, printable, require
from repro_companion.run import project_folder, recordings_folder

FILES = "https://raw.githubusercontent.com"
LARGE_FILES = "https://media.githubusercontent.com/media"
"""Where GitHub has the content of a repository, and that of its Git-LFS files."""
SILENCE_S = 30.0
"""For how long a server may send nothing."""
SLOWEST_B_PER_S, EXTRA_S = 20e3, 60.0
"""A file may take the time of this rate, and so much more."""
REDIRECTS = 5
"""How often a server may send us on."""
LARGEST = 100_000_000
"""Most bytes of a file whose size is not listed."""
FORM = (
    "JSON such as {PAPER: {repository, commit, readers: [{files, page, use}], files: [{path, sha256, size}]}}"
)
NO_ANSWER, SILENT_IN_A_ROW = "the server did not answer in time", 3
"""After so many files for which nothing answered, the others are not tried: each would cost its time-out."""


@dataclass(frozen=True)
class Source:
    """One file of a public repository at one commit; it lies at ``paper/path`` below the folder of recordings."""

    paper: str
    path: str
    repository: str
    commit: str
    sha256: str
    git_blob: str
    """The hash by which git knows the content; one of both hashes may be empty."""
    size: int | None
    large: bool
    """Whether the content is in Git LFS."""
    page: str = ""
    """The page that reads it; empty where a study does."""
    use: str = ""
    """What for."""

    @property
    def name(self) -> str:
        """Paper and path."""
        return f"{self.paper}/{self.path}"

    def address(self, mirror: str = "") -> str:
        """Return where it is downloaded from: below a mirror it lies as in the folder of recordings."""
        if mirror:
            return f"{mirror.rstrip('/')}/{quote(self.name)}"
        host = LARGE_FILES if self.large else FILES
        return f"{host}/{self.repository}/{self.commit}/{quote(self.path)}"

    def is_at(self, path: Path) -> bool:
        """Return whether a file has the content that was released."""
        if not path.is_file():
            return False
        content = path.read_bytes()
        if self.sha256:
            return hashlib.sha256(content).hexdigest() == self.sha256
        blob = b"blob %d\0" % len(content) + content
        return hashlib.sha1(blob, usedforsecurity=False).hexdigest() == self.git_blob


def read_sources(path: Path, paper: str = "", page: str = "") -> list[Source]:
    """Return the files of one paper or all, or what a page reads of them; what could lead elsewhere is refused."""
    require(path.is_file(), "list", "repro fetch", "an existing file", path)
    try:
        listed = json.loads(path.read_text(encoding="utf-8"))
        require(not paper or paper in listed, "paper", "repro fetch", f"one of {', '.join(listed)}", paper)
        names = [paper] if paper else list(listed.keys())
        found = [
            _source(name, listed[name], entry, path.name) for name in names for entry in listed[name]["files"]
        ]
    except InputError:
        raise
    except (ValueError, LookupError, TypeError, AttributeError) as error:
        damage = f"{type(error).__name__}: {error}; take the file as it was released"
        raise bad_input("list", path.name, FORM, damage) from None
    require(found, "files", path.name, "one or more", "none")
    pages = sorted({source.page for source in found} - {""})
    require(not page or page in pages, "page", "repro fetch", f"one of {', '.join(pages)}", page)
    return [source for source in found if page in ("", source.page)]


def _source(paper: str, about: dict, entry: dict, owner: str) -> Source:
    repository = re.fullmatch(r"https://github\.com/([\w.-]+/[\w.-]+)", about["repository"])
    if not repository:
        raise bad_input("repository", owner, "https://github.com/OWNER/NAME", about["repository"])
    commit, path = about["commit"], entry["path"]
    require(re.fullmatch(r"[0-9a-f]{40}", commit), "commit", owner, "40 hexadecimal digits", commit)
    # A backslash or a drive letter would lead elsewhere on Windows.
    within = path == str(PurePosixPath(path)) and not re.search(r"^/|^\.|(^|/)\.\.(/|$)|[\\:\0]", path)
    require(re.fullmatch(r"\w+", paper) and within, "path", owner, "inside the paper's folder", repr(path))
    sha256, git_blob = entry.get("sha256", ""), entry.get("git_blob", "")
    hashed = re.fullmatch(r"[0-9a-f]{64}" if sha256 else r"[0-9a-f]{40}", sha256 or git_blob)
    require(hashed, f"hash of {path}", owner, "a SHA-256 or that of a git blob", sha256 or git_blob)
    size, large = entry.get("size"), about.get("storage") == "git-lfs"
    whole = size is None or (type(size) is int and size >= 0)
    require(whole, f"size of {path}", owner, "a whole number of bytes", size)
    readers = [reader for reader in about["readers"] if path.startswith(reader["files"])]
    require(len(readers) == 1, f"reader of {path}", owner, "one, with files, page and use", len(readers))
    page, use = (readers[0][key] for key in ("page", "use"))
    return Source(paper, path, repository[1], commit, sha256, git_blob, size, large, page, use)


def listed_files(paper: str) -> list[Source]:
    """Return the files of a paper that are listed."""
    return read_sources(project_folder() / "data" / "sources.json", paper)


def states(paper: str) -> dict[str, str]:
    """Return of each listed file of a paper, by its path, whether it is released, another, or missing here."""
    places = {source: recordings_folder() / source.name for source in listed_files(paper)}
    return {
        source.path: "released" if source.is_at(place) else "another" if place.is_file() else "missing"
        for source, place in places.items()
    }


def listing(sources: Sequence[Source], folder: Path) -> str:
    """Return for each paper how many files there are and where they come from, and a line for each use of them."""
    lines = []
    for paper, of_paper in groupby(sources, lambda source: source.paper):
        files = list(of_paper)
        origin = f"github.com/{files[0].repository} at {files[0].commit[:7]}"
        here = sum(source.is_at(folder / source.name) for source in files)
        lines.append(f"{paper}: {amount(files)}, {here} here; from {origin}")
        uses = groupby(files, lambda source: (source.page, source.use))
        lines += [f"  {page or 'a study'}: {amount(group)}: {use}" for (page, use), group in uses]
    return "\n".join(lines)


def amount(files: Iterable[Source]) -> str:
    """Return how many files these are and how large; the size of some is not listed."""
    sizes = [source.size for source in files]
    known = [size for size in sizes if size is not None]
    large = (
        f"{'at least ' * (len(known) < len(sizes))}{1e-6 * sum(known):.1f} MB" if known else "size not listed"
    )
    return f"{len(sizes)} {'file' if len(sizes) == 1 else 'files'}, {large}"


def fetch(sources: Sequence[Source], folder: Path, mirror: str = "", show: bool = False) -> tuple[str, bool]:
    """Download the files that are not here yet; return what became of them, and whether all are here.

    A file takes its place only when it is whole and verified. One that fails does not stop the others, and what is
    here is not asked for again, so that calling again goes on.
    """
    must_be = "an address that starts with http:// or https://"
    require(not mirror or re.match(r"https?://[^/]", mirror), "mirror", "repro fetch", must_be, mirror)
    kept, failed, silent = 0, [], 0
    for number, source in enumerate(sources, 1):
        place = folder / source.name
        if source.is_at(place):
            kept += 1
            continue
        if show:
            print(f"{number} of {len(sources)}: {source.name}", flush=True)
        address, why = source.address(mirror), "not tried, because nothing answered for those before"
        if silent < SILENT_IN_A_ROW:
            why = _download(source, address, place)
            silent = silent + 1 if why == NO_ANSWER else 0
        if why:
            failed.append(
                f"{source.path} of {source.paper} was not fetched: {why}.\n  Its address: {address}\n"
                f"  A copy downloaded by hand is found as: {place}"
            )
    counts = f"{len(sources) - kept - len(failed)} fetched, {kept} already here, {len(failed)} failed"
    return "\n".join([*failed, counts]), not failed


class _TimeUp(Exception):
    """A download took longer than it may. No library takes it for an error of its own."""


@contextmanager
def _at_most(seconds: float) -> Iterator[None]:
    """Raise `_TimeUp` where a block takes longer, whatever it waits for: a server may drip headers without end.

    It holds in the main thread; a library that drops the exception meets it again a second later.
    """
    over = False

    def stop(*_: object) -> None:
        if not over:
            raise _TimeUp

    before = signal.signal(signal.SIGALRM, stop)
    signal.setitimer(signal.ITIMER_REAL, seconds, 1.0)
    try:
        yield
    finally:
        over = True  # from here on it would leave the clock running
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGALRM, before)


def _download(source: Source, address: str, place: Path) -> str:
    """Bring one file to its place; return why that failed, or nothing."""
    import requests
    import urllib3

    partial, most = place.with_name(f".{place.name}.partial"), source.size or LARGEST
    limit_s = EXTRA_S + most / SLOWEST_B_PER_S
    try:
        place.parent.mkdir(parents=True, exist_ok=True)
        with _at_most(limit_s):
            if why := _receive(address, partial, most):
                return why
        if not source.is_at(partial):
            return "what arrived is not the released file, by its hash"
        partial.replace(place)
    except _TimeUp:
        received = partial.stat().st_size if partial.is_file() else 0
        return f"after {limit_s:.0f} s only {received} of {most} bytes had arrived" if received else NO_ANSWER
    except (requests.Timeout, urllib3.exceptions.TimeoutError):
        return NO_ANSWER
    except requests.ConnectionError:
        return "no connection"
    except (requests.RequestException, urllib3.exceptions.HTTPError) as error:
        return f"the download broke off ({type(error).__name__})"
    except OSError as error:
        return f"it cannot be written ({error.strerror})"
    finally:
        with suppress(OSError):  # not there, or nor is its folder
            partial.unlink()
    return ""


def _receive(address: str, path: Path, most: int) -> str:
    """Write what a server sends, up to so many bytes, after some redirects; return why it ends."""
    import requests

    options = {"stream": True, "timeout": SILENCE_S, "allow_redirects": False}
    options["headers"] = {"Accept-Encoding": "identity"}  # packed, a few bytes could become very many
    with requests.Session() as session:
        # It would read all that comes with a redirect, however much, so we follow redirects by ourselves.
        session.get_redirect_target = lambda _: None
        for _ in range(1 + REDIRECTS):
            with session.get(address, **options) as answer:
                if answer.is_redirect:
                    try:
                        address = urljoin(address, answer.headers["Location"])
                    except ValueError:
                        return "the server sent us on to what is no address"
                    continue
                if not answer.ok:
                    return f"the server answered {answer.status_code} {printable(str(answer.reason))}"
                return _written(answer.raw, path, most)
    return f"more than {REDIRECTS} redirects"


def _written(body: BinaryIO, path: Path, most: int) -> str:
    received = 0
    with path.open("wb") as file:
        # We take what has arrived, however little, so that a server that drips is seen to send something.
        while block := body.read1(65536):
            received += file.write(block)
            if received > most:
                return f"more than {most} bytes arrived"
    return ""
