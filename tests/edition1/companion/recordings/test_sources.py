"""The list of recordings, and their download from a real server on this computer."""

import hashlib
import json
import os
import socket
import threading
from collections import Counter
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from urllib.parse import unquote

import pytest

from edition1.errors import InputError
from edition1_companion.recordings import download
from edition1_companion.recordings.download import address, fetch, is_there, listing
from edition1_companion.recordings.released import git_blob_hash
from edition1_companion.recordings.sources import RecordedFile, data_dir, read_sources

MANIFEST = Path(__file__).parents[4] / "data" / "sources.json"
COMMIT = "382a4aefdf529fdf50e42244b850e330057d27e0"
BODY = b"time,value\n0,1.5\n" * 5000
OTHER = b"another file\n"


def entry(path: str, content: bytes = BODY) -> dict[str, object]:
    return {"path": path, "sha256": hashlib.sha256(content).hexdigest(), "size": len(content)}


def manifest(folder: Path, *entries: dict[str, object], **source: str) -> Path:
    about = {"repository": "https://github.com/owner/name", "commit": COMMIT} | source
    path = folder / "sources.json"
    path.write_text(json.dumps({"p2021": about | {"files": list(entries)}}))
    return path


def listed(folder: Path, *entries: dict[str, object], **source: str) -> list[RecordedFile]:
    return read_sources(manifest(folder, *entries, **source))


def below(folder: Path) -> list[str]:
    """All files of a folder, hidden ones too."""
    return sorted(p.relative_to(folder).as_posix() for p in folder.rglob("*") if p.is_file())


class Server(ThreadingHTTPServer):
    """Serves ``contents``; ``cut`` paths are announced whole and sent in half; counts requests per path."""

    def __init__(self) -> None:
        super().__init__(("127.0.0.1", 0), Handler)
        self.contents: dict[str, bytes] = {}
        self.cut: set[str] = set()
        self.asked: Counter[str] = Counter()
        self.address = f"http://127.0.0.1:{self.server_port}"


class Handler(BaseHTTPRequestHandler):
    def do_GET(self) -> None:
        assert isinstance(self.server, Server)
        path = unquote(self.path).lstrip("/")
        self.server.asked[path] += 1
        if path not in self.server.contents:
            self.send_error(404)
            return
        body = self.server.contents[path]
        self.send_response(200)
        self.send_header("Content-Length", str(len(body)))
        self.end_headers()
        self.wfile.write(body[: len(body) // 2] if path in self.server.cut else body)

    def log_message(self, *_: object) -> None:
        pass


@pytest.fixture
def server(monkeypatch):
    monkeypatch.setenv("NO_PROXY", "127.0.0.1")
    with Server() as running:
        thread = threading.Thread(target=running.serve_forever, kwargs={"poll_interval": 0.01})
        thread.start()
        yield running
        running.shutdown()
        thread.join()


def closed_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


def test_files_arrive_verified_and_are_not_asked_for_again(server, tmp_path):
    files = listed(tmp_path, entry("data/a.csv"), entry("data/b.csv", OTHER))
    server.contents = {"p2021/data/a.csv": BODY, "p2021/data/b.csv": OTHER}
    folder = tmp_path / "recordings"
    report = fetch(files, folder, mirror=server.address)
    assert (report.fetched, report.kept, report.failed) == (["p2021/data/a.csv", "p2021/data/b.csv"], [], {})
    assert below(folder) == report.fetched
    assert (folder / "p2021/data/a.csv").read_bytes() == BODY
    again = fetch(files, folder, mirror=server.address + "/")
    assert (again.fetched, again.kept) == ([], report.fetched)
    assert max(server.asked.values()) == 1
    assert str(again) == "0 fetched, 2 already there, 0 failed"


def test_path_with_spaces(server, tmp_path):
    files = listed(tmp_path, entry("data analysis/a #1 100%.csv"))
    server.contents = {"p2021/data analysis/a #1 100%.csv": BODY}
    assert fetch(files, tmp_path / "r", mirror=server.address).failed == {}
    assert below(tmp_path / "r") == ["p2021/data analysis/a #1 100%.csv"]


@pytest.mark.parametrize(
    ("sent", "why"),
    [
        ("half", "the download broke off (ChunkedEncodingError)"),
        (
            "other",
            "what arrived is not the released file "
            f"(sha256 {hashlib.sha256(OTHER).hexdigest()} instead of {hashlib.sha256(BODY).hexdigest()})",
        ),
        ("nothing", "the server answered 404 Not Found"),
    ],
)
def test_a_failed_file_is_absent_named_and_stops_no_other(server, tmp_path, sent, why):
    files = listed(tmp_path, entry("a.csv"), entry("b.csv"))
    server.contents = {"p2021/a.csv": OTHER if sent == "other" else BODY, "p2021/b.csv": BODY}
    if sent == "half":
        server.cut = {"p2021/a.csv"}
    if sent == "nothing":
        del server.contents["p2021/a.csv"]
    folder = tmp_path / "r"
    report = fetch(files, folder, mirror=server.address)
    assert report.fetched == ["p2021/b.csv"]
    assert below(folder) == ["p2021/b.csv"]
    assert str(report) == (
        f"a.csv of p2021 was not fetched: {why}.\n"
        f"  Its address: {server.address}/p2021/a.csv\n"
        f"  A copy downloaded by hand is found as: {folder}/p2021/a.csv\n"
        "1 fetched, 0 already there, 1 failed"
    )


def test_interrupted_midway_then_continued(server, tmp_path):
    files = listed(tmp_path, entry("a.csv"), entry("b.csv"), entry("c.csv"))
    server.contents = dict.fromkeys(["p2021/a.csv", "p2021/b.csv", "p2021/c.csv"], BODY)
    server.cut = {"p2021/b.csv"}
    folder = tmp_path / "r"
    assert list(fetch(files, folder, mirror=server.address).failed) == ["p2021/b.csv"]
    server.cut = set()
    report = fetch(files, folder, mirror=server.address)
    assert (report.fetched, report.kept) == (["p2021/b.csv"], ["p2021/a.csv", "p2021/c.csv"])
    assert server.asked == {"p2021/a.csv": 1, "p2021/b.csv": 2, "p2021/c.csv": 1}
    assert all(is_there(file, folder) for file in files)


def test_interruption_from_the_keyboard_leaves_whole_files_only(server, tmp_path, monkeypatch):
    files = listed(tmp_path, entry("a.csv"), entry("b.csv"))
    server.contents = {"p2021/a.csv": BODY, "p2021/b.csv": BODY}

    def interrupt(stream, kind: str):
        if "b.csv" in stream.name:
            raise KeyboardInterrupt
        return hashlib.new(kind, stream.read())

    monkeypatch.setattr("hashlib.file_digest", interrupt)
    with pytest.raises(KeyboardInterrupt):
        fetch(files, tmp_path / "r", mirror=server.address)
    assert below(tmp_path / "r") == ["p2021/a.csv"]


def test_a_file_with_other_content_is_replaced_when_the_right_one_has_arrived(server, tmp_path):
    files = listed(tmp_path, entry("a.csv"))
    folder = tmp_path / "r"
    (folder / "p2021").mkdir(parents=True)
    (folder / "p2021/a.csv").write_bytes(OTHER)
    assert fetch(files, folder, mirror=server.address).failed
    assert (folder / "p2021/a.csv").read_bytes() == OTHER
    server.contents = {"p2021/a.csv": BODY}
    assert fetch(files, folder, mirror=server.address).fetched == ["p2021/a.csv"]
    assert below(folder) == ["p2021/a.csv"]
    assert (folder / "p2021/a.csv").read_bytes() == BODY


def test_file_known_by_its_git_hash_only(server, tmp_path):
    files = listed(tmp_path, {"path": "a.csv", "git_blob": git_blob_hash(BODY)})
    server.contents = {"p2021/a.csv": OTHER}
    (message,) = fetch(files, tmp_path / "r", mirror=server.address).failed.values()
    assert f"(git blob {git_blob_hash(OTHER)} instead of {git_blob_hash(BODY)})" in message
    server.contents = {"p2021/a.csv": BODY}
    assert fetch(files, tmp_path / "r", mirror=server.address).fetched == ["p2021/a.csv"]


def test_git_hash_is_the_one_of_git():
    """The example of the chapter on objects in the Git book (git-scm.com/book, 10.2)."""
    assert git_blob_hash(b"test content\n") == "d670460b4b4aece5915caf5c68d12f560a9fe3e4"


def test_offline(tmp_path, monkeypatch):
    monkeypatch.setenv("NO_PROXY", "127.0.0.1")
    mirror = f"http://127.0.0.1:{closed_port()}"
    files = listed(tmp_path, *(entry(f"data/{k}.csv") for k in range(5)))
    report = fetch(files, tmp_path / "r", mirror=mirror)
    assert str(report).splitlines()[-4:] == [
        "data/4.csv of p2021 was not fetched: no connection.",
        f"  Its address: {mirror}/p2021/data/4.csv",
        f"  A copy downloaded by hand is found as: {tmp_path}/r/p2021/data/4.csv",
        "0 fetched, 0 already there, 5 failed",
    ]
    assert below(tmp_path / "r") == []


def test_a_silent_server_is_given_up_after_three_files(tmp_path, monkeypatch):
    monkeypatch.setenv("NO_PROXY", "127.0.0.1")
    monkeypatch.setattr(download, "TIMEOUT_S", 0.1)
    files = listed(tmp_path, *(entry(f"{k}.csv") for k in range(5)))
    with socket.create_server(("127.0.0.1", 0)) as silent:
        report = fetch(files, tmp_path / "r", mirror=f"http://127.0.0.1:{silent.getsockname()[1]}")
    reasons = [message.split(": ")[1].split(".\n")[0] for message in report.failed.values()]
    assert reasons == [download.NO_ANSWER] * 3 + [download.NOT_TRIED] * 2


@pytest.mark.skipif(os.geteuid() == 0, reason="the superuser may write everywhere")
def test_folder_that_cannot_be_written(server, tmp_path):
    folder = tmp_path / "r"
    folder.mkdir(mode=0o500)
    server.contents = {"p2021/a.csv": BODY}
    (message,) = fetch(listed(tmp_path, entry("a.csv")), folder, mirror=server.address).failed.values()
    assert "it cannot be written (Permission denied)" in message


def test_a_file_in_the_way_of_a_folder(server, tmp_path):
    (tmp_path / "r").write_text("")
    server.contents = {"p2021/a.csv": BODY}
    (message,) = fetch(
        listed(tmp_path, entry("a.csv")), tmp_path / "r", mirror=server.address
    ).failed.values()
    assert "was not fetched: it cannot be written (" in message


def test_bars_name_the_file(server, tmp_path, capsys):
    server.contents = {"p2021/data/a.csv": BODY}
    files = listed(tmp_path, entry("data/a.csv"))
    fetch(files, tmp_path / "quiet", mirror=server.address)
    assert capsys.readouterr().err == ""
    assert fetch(files, tmp_path / "r", mirror=server.address, progress=True).failed == {}
    shown = capsys.readouterr().err
    assert "a.csv" in shown
    assert "1/1" in shown


def test_addresses(tmp_path):
    (plain,) = listed(tmp_path, entry("data analysis/a.csv"))
    (large,) = listed(tmp_path, entry("data analysis/a.csv"), storage="git-lfs")
    tail = f"owner/name/{COMMIT}/data%20analysis/a.csv"
    assert address(plain) == f"https://raw.githubusercontent.com/{tail}"
    assert address(large) == f"https://media.githubusercontent.com/media/{tail}"
    assert address(large, "https://host/x/") == "https://host/x/p2021/data%20analysis/a.csv"


def test_the_pointer_of_a_large_file_is_not_taken_for_it(server, tmp_path):
    oid = hashlib.sha256(BODY).hexdigest()
    pointer = f"version https://git-lfs.github.com/spec/v1\noid sha256:{oid}\nsize {len(BODY)}\n".encode()
    server.contents = {"p2021/a.csv": pointer}
    files = listed(tmp_path, entry("a.csv"), storage="git-lfs")
    assert "not the released file" in str(fetch(files, tmp_path / "r", mirror=server.address))
    assert below(tmp_path / "r") == []


@pytest.mark.parametrize("mirror", ["file:///etc", "ftp://host/", "localhost:8000", "http://", ""])
def test_other_schemes_are_refused(tmp_path, mirror):
    files = listed(tmp_path, entry("a.csv"))
    with pytest.raises(InputError) as caught:
        fetch(files, tmp_path / "r", mirror=mirror)
    assert str(caught.value) == (
        "Input mirror of repro fetch must be an address that starts with http:// or https://; "
        f"instead received {mirror}."
    )
    assert not (tmp_path / "r").exists()


@pytest.mark.parametrize(
    "path",
    ["../a.csv", "a/../../b.csv", "/etc/passwd", "a\\..\\b.csv", "C:/a.csv", "", ".", "a//b.csv", "./a"],
)
def test_paths_that_lead_elsewhere_are_refused(tmp_path, path):
    with pytest.raises(InputError) as caught:
        listed(tmp_path, entry(path))
    assert str(caught.value) == (
        "Input path of sources.json must be a path inside the folder p2021, without ..; "
        f"instead received {path!r}."
    )


@pytest.mark.parametrize(
    ("source", "entries", "message"),
    [
        (
            {"repository": "https://example.org/a/b"},
            {},
            "repository of sources.json must be https://github.com/",
        ),
        ({"commit": "main"}, {}, "commit of sources.json must be 40 hexadecimal digits"),
        ({}, {"sha256": "12"}, "hash of sources.json must be a sha256 or a git blob hash"),
        ({}, {"sha256": ""}, "hash of sources.json must be a sha256 or a git blob hash"),
    ],
)
def test_entries_that_cannot_be_used_are_refused(tmp_path, source, entries, message):
    with pytest.raises(InputError, match=message):
        listed(tmp_path, entry("a.csv") | entries, **source)


def test_unknown_paper(tmp_path):
    with pytest.raises(
        InputError, match=r"paper of the recordings must be one of p2021; instead received x\."
    ):
        read_sources(manifest(tmp_path, entry("a.csv")), ["x"])


def test_no_list(tmp_path):
    with pytest.raises(InputError, match="list of the recordings must be an existing file; instead received"):
        read_sources(tmp_path / "sources.json")


def test_the_projects_list():
    files = read_sources(MANIFEST)
    counts = {"baaij2023": 36, "continuum_robot": 46, "martin2022": 13, "mitchell2021": 151}
    assert Counter(file.paper for file in files) == counts
    assert {file.paper for file in files if file.large} == {"baaij2023"}
    assert len({file.place(Path()) for file in files}) == len(files)
    assert read_sources(MANIFEST, ["martin2022"]) == [f for f in files if f.paper == "martin2022"]
    # Files without a sha256 would otherwise be compared as equal. Two trials of the robot are one recording.
    twice = [file for file in files if "fast_contact" in file.path]
    known = [file.sha256 or file.git_blob for file in files if file not in twice]
    assert len(set(known)) == len(known)
    assert {file.sha256 or file.git_blob for file in twice} < set(known)


def test_listing(tmp_path):
    files = listed(tmp_path, entry("a.csv"), entry("b.csv"))
    (tmp_path / "p2021").mkdir()
    (tmp_path / "p2021/b.csv").write_bytes(BODY)
    assert (
        listing(files, tmp_path) == "p2021: 2 files, 0.2 MB, 1 there; from github.com/owner/name at 382a4ae"
    )


def test_recordings_found_are_the_released_ones():
    found = [file for file in read_sources(MANIFEST) if file.place(data_dir()).is_file()]
    if not found:
        pytest.skip("no recordings below REPRO_DATA_DIR")
    assert [file.path for file in found if not is_there(file, data_dir())] == []
