"""The download of recordings, from a server of every temper."""

from __future__ import annotations

import ast
import hashlib
import http.server
import json
import re
import signal
import threading
import time
from collections import Counter
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import ClassVar

import pytest

from repro.common import InputError
from repro_companion import cli
from repro_companion.papers import fetch as tool
from repro_companion.run import project_folder
from tests.board.waiting import until

CONTENT = b"time,x\n0,1\n"
COMMIT = "a1" * 20
SHA256 = hashlib.sha256(CONTENT).hexdigest()
BLOB = hashlib.sha1(b"blob %d\0" % len(CONTENT) + CONTENT).hexdigest()
ENTRY = {"path": "data/a b.csv", "sha256": SHA256, "git_blob": BLOB, "size": len(CONTENT)}


READERS = [{"files": "", "page": "one", "use": "all"}]


def listed(path: Path, *entries: dict, **about: object) -> Path:
    """Write a list of recordings of one paper."""
    about = {"repository": "https://github.com/o/n", "commit": COMMIT, "readers": READERS} | about
    path.write_text(json.dumps({"p2020": {**about, "files": entries or [ENTRY]}}))
    return path


@pytest.fixture
def sources(tmp_path: Path) -> list[tool.Source]:
    return tool.read_sources(listed(tmp_path / "sources.json"))


class Server(http.server.BaseHTTPRequestHandler):
    """It answers as the first word of the address says."""

    sent: ClassVar = Counter[str]()

    def do_GET(self) -> None:
        temper, _, file = self.path.lstrip("/").partition("/")
        sent = CONTENT if file == "p2020/data/a%20b.csv" else b""
        to = {
            "file": "file:///etc/passwd",
            "bad": "http://[::1",
            "moved": f"/good/{file}",
            "circle": f"/circle/{file}",
        }.get(temper)
        if temper == "red":
            self.send_response(500, "\x1b[31mred")
        else:
            self.send_response(404 if temper == "missing" else 302 if to else 200)
        if to:
            self.send_header("Location", to)
        if temper == "short":
            self.send_header("Content-Length", str(len(sent) + 5))
        if temper == "header":  # of one that has no end
            self.wfile.write(b"HTTP/1.1 200 OK\r\nX: ")
        else:
            self.end_headers()
        many, drop = b"x" * 65536, b"x"
        blocks = {"flood": many, "circle": many, "drip": drop, "header": drop, "other": drop * len(sent)}
        try:
            for _ in range(10_000):
                self.wfile.write(
                    blocks.get(temper, sent) if temper not in ("missing", "file", "bad", "moved") else b""
                )
                self.wfile.flush()
                Server.sent[temper] += len(blocks.get(temper, sent))
                if temper not in ("flood", "circle", "drip", "header"):
                    return
                time.sleep(0.02 if blocks[temper] == drop else 0.0)
        except OSError:
            pass

    def log_message(self, *_: object) -> None:
        """Be silent."""


@pytest.fixture(scope="module")
def server() -> Iterator[str]:
    with http.server.ThreadingHTTPServer(("127.0.0.1", 0), Server) as served:
        served.daemon_threads = True
        threading.Thread(target=served.serve_forever, daemon=True).start()
        yield f"http://127.0.0.1:{served.server_address[1]}"
        served.shutdown()


def test_what_is_here_is_not_asked_for_again(sources, tmp_path, server):
    folder = tmp_path / "recordings"
    assert tool.fetch(sources, folder, f"{server}/good") == ("1 fetched, 0 already here, 0 failed", True)
    assert (folder / "p2020/data/a b.csv").read_bytes() == CONTENT
    assert tool.fetch(sources, folder, f"{server}/missing") == ("0 fetched, 1 already here, 0 failed", True)
    (folder / "p2020/data/a b.csv").write_bytes(b"edited")
    assert tool.fetch(sources, folder, f"{server}/good/")[0] == "1 fetched, 0 already here, 0 failed"
    assert tool.listing(sources, folder).splitlines() == [
        "p2020: 1 file, 0.0 MB, 1 here; from github.com/o/n at a1a1a1a",
        "  one: 1 file, 0.0 MB: all",
    ]
    assert tool.amount([replace(source, size=2_500_000) for source in sources]) == "1 file, 2.5 MB"


@pytest.mark.parametrize(
    ("temper", "said"),
    [
        ("missing", "the server answered 404 Not Found"),
        ("other", "what arrived is not the released file, by its hash"),
        ("short", "what arrived is not|broke off"),
        ("flood", f"more than {len(CONTENT)} bytes arrived"),
        ("file", "broke off .InvalidSchema."),
        ("bad", "the server sent us on to what is no address"),
        ("red", r"the server answered 500 \\x1b\[31mred"),
        ("circle", "more than 5 redirects"),
    ],
)
def test_a_file_that_fails_leaves_nothing(sources, tmp_path, server, temper, said):
    folder = tmp_path / "recordings"
    if temper == "short":  # the connection ends before all that was announced has come
        sources = [tool.Source(**{**vars(sources[0]), "size": 100, "sha256": "0" * 64})]
    text, complete = tool.fetch(sources, folder, f"{server}/{temper}")
    assert not complete
    assert re.search(rf"^data/a b.csv of p2020 was not fetched: .*({said})", text)
    assert f"A copy downloaded by hand is found as: {folder}/p2020/data/a b.csv" in text
    assert [path for path in folder.rglob("*") if path.is_file()] == []


@pytest.mark.parametrize(
    ("temper", "said"),
    [("drip", r"after \d+ s only \d+ of 400 bytes had arrived"), ("header", "did not answer in time")],
)
def test_a_server_that_drips_is_left(sources, tmp_path, server, monkeypatch, temper, said):
    """One limit holds from the start: for redirects, headers and content. It passes once some bytes have come."""
    monkeypatch.setattr(tool, "EXTRA_S", 45.0)
    slow = [tool.Source(**{**vars(sources[0]), "size": 400})]
    before, left = Server.sent[temper], []

    def time_passes() -> None:
        until(lambda: Server.sent[temper] > before + 20)
        left.append(signal.getitimer(signal.ITIMER_REAL)[0])
        signal.setitimer(signal.ITIMER_REAL, 1e-3, 1.0)

    threading.Thread(target=time_passes, daemon=True).start()
    text, _ = tool.fetch(slow, tmp_path / "recordings", f"{server}/{temper}")
    assert re.search(said, text)
    assert 0 < left[0] <= 45.0 + 400 / tool.SLOWEST_B_PER_S
    assert Server.sent[temper] - before < 400
    assert signal.getitimer(signal.ITIMER_REAL) == (0.0, 0.0)


def test_a_redirect_is_followed_and_nothing_else_of_it_is_read(sources, tmp_path, server):
    assert tool.fetch(sources, tmp_path / "recordings", f"{server}/moved")[1]
    before = Server.sent["circle"]
    tool.fetch(sources, tmp_path / "other", f"{server}/circle")
    time.sleep(0.2)  # what is under way
    assert Server.sent["circle"] - before < 50e6, "of 650 MB with each redirect"


@pytest.mark.parametrize(
    ("answers", "tried"), [("sssss", 3), ("sswss", 5), ("wwwww", 5), ("sgsss", 5), ("gsssg", 4)]
)
def test_after_three_silent_files_in_a_row_no_other_is_tried(sources, tmp_path, monkeypatch, answers, tried):
    """Files do not answer (s), are wrong (w) or good (g)."""
    said = [{"s": tool.NO_ANSWER, "w": "it is wrong", "g": ""}[answer] for answer in answers]
    rest = iter(said)
    monkeypatch.setattr(tool, "_download", lambda *_: next(rest))
    text, _ = tool.fetch(sources * 5, tmp_path)
    for why in (tool.NO_ANSWER, "it is wrong"):
        assert text.count(why) == said[:tried].count(why)
    assert text.count("not tried, because nothing answered for those before") == 5 - tried
    with pytest.raises(InputError, match="mirror of repro fetch must be an address that starts with http"):
        tool.fetch(sources, tmp_path, "ftp://x/y")


def test_where_github_has_a_file(tmp_path):
    (plain,) = tool.read_sources(listed(tmp_path / "a.json"))
    (large,) = tool.read_sources(listed(tmp_path / "b.json", storage="git-lfs"))
    assert plain.address() == f"https://raw.githubusercontent.com/o/n/{COMMIT}/data/a%20b.csv"
    assert large.address() == f"https://media.githubusercontent.com/media/o/n/{COMMIT}/data/a%20b.csv"
    only_git = {"path": "x", "git_blob": BLOB}
    (by_git,) = tool.read_sources(listed(tmp_path / "c.json", only_git))
    (tmp_path / "x").write_bytes(CONTENT)
    assert by_git.is_at(tmp_path / "x")
    (tmp_path / "x").write_bytes(CONTENT + b"\n")
    assert not by_git.is_at(tmp_path / "x")


@pytest.mark.parametrize("path", ["/etc/x", "../x", "a/../../x", "a\\b", "C:x", "a//b", "./a", ".", ""])
def test_paths_that_lead_elsewhere_are_refused(tmp_path, path):
    with pytest.raises(InputError, match="path of sources.json must be inside the paper's folder"):
        tool.read_sources(listed(tmp_path / "sources.json", {**ENTRY, "path": path}))


@pytest.mark.parametrize(
    ("about", "entry", "message"),
    [
        ({"repository": "https://example.org/o/n"}, {}, "repository of sources.json must be https://github"),
        ({"commit": "main"}, {}, "commit of sources.json must be 40 hexadecimal digits"),
        ({}, {"sha256": "", "git_blob": ""}, "hash of data/a b.csv of sources.json must be a SHA-256 or"),
        ({}, {"sha256": "ab"}, "hash of data/a b.csv of sources.json must be a SHA-256 or"),
        ({}, {"size": "10"}, "size of data/a b.csv of sources.json must be a whole number of bytes"),
        ({"readers": []}, {}, "reader of data/a b.csv of sources.json must be one, .*; instead received 0"),
        ({"readers": READERS * 2}, {}, "must be one, with files, page and use; instead received 2"),
        ({"readers": [{"files": ""}]}, {}, "list of sources.json must be JSON such as .*KeyError: 'page'"),
        ({"commit": 1}, {}, "list of sources.json must be JSON such as .*TypeError"),
    ],
)
def test_entries_that_cannot_be_used_are_refused(tmp_path, about, entry, message):
    with pytest.raises(InputError, match=message):
        tool.read_sources(listed(tmp_path / "sources.json", {**ENTRY, **entry}, **about))


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (
            "<<<<<<< HEAD\n{}\n",
            "list of sources.json must be JSON such as .PAPER.*JSONDecodeError.*as it was released",
        ),
        ("[]", "must be JSON such as|must be one of"),
        ("{}", "files of sources.json must be one or more|must be one of"),
        ('{"p2020": []}', "must be JSON such as"),
        ('{"p2020": {"repository": "https://github.com/a/b"}}', "must be JSON such as .*KeyError: 'files'"),
        (
            '{"p2020": {"repository": "https://github.com/a/b", "files": []}}',
            "files of sources.json must be one or more",
        ),
        ('{"p2020": {"files": [{"path": "x"}]}}', "KeyError: 'repository'"),
    ],
)
def test_a_damaged_list_is_refused_in_words(tmp_path, text, said):
    (tmp_path / "sources.json").write_text(text)
    for paper in ("", "p2020"):
        with pytest.raises(InputError, match=said):
            tool.read_sources(tmp_path / "sources.json", paper)


def test_a_page_can_be_fetched_alone(tmp_path, server, monkeypatch, capsys):
    """Of two files the one that the page reads; it is told how many files each page reads, and of what size."""
    (tmp_path / "data/published").mkdir(parents=True)
    readers = [{"files": "data", "page": "one", "use": "x"}, {"files": "other", "page": "", "use": "y"}]
    path = listed(tmp_path / "data/sources.json", ENTRY, {"path": "other", "git_blob": BLOB}, readers=readers)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("REPRO_DATA_DIR", str(tmp_path / "recordings"))
    assert cli.fetch("p2020", page="one", mirror=f"{server}/good") == 0
    assert [file.name for file in (tmp_path / "recordings").rglob("*") if file.is_file()] == ["a b.csv"]
    capsys.readouterr()
    assert cli.fetch(list_only=True) == 0
    assert capsys.readouterr().out.splitlines()[:3] == [
        "p2020: 2 files, at least 0.0 MB, 1 here; from github.com/o/n at a1a1a1a",
        "  one: 1 file, 0.0 MB: x",
        "  a study: 1 file, size not listed: y",
    ]
    with pytest.raises(InputError, match="page of repro fetch must be one of one; instead received two"):
        tool.read_sources(path, page="two")


def texts_of(module: Path) -> set[str]:
    """Return the strings in a module's code that could name files, with * for what is put into them."""
    nodes = ast.walk(ast.parse(module.read_text(encoding="utf-8")))
    texts = [ast.unparse(node) for node in nodes if isinstance(node, ast.Constant | ast.JoinedStr)]
    names = {re.sub(r"{.*?}", "*", text.lstrip("f").strip("'\"")) for text in texts}
    # "mocap" may be any word, and "*_*.csv" any file.
    told = re.compile(r".*[/_]")
    return {
        name for name in names if told.match(name) and len(re.sub(r"\.csv|[\W_]", "", Path(name).name)) > 2
    }


def test_every_listed_file_has_a_reader():
    """It is a page of the book, and code of a paper or a robot names the file, or the folder that is listed."""
    root = project_folder()
    modules = [*(root / "src/repro_companion/papers").glob("*.py"), *(root / "data/others").glob("*/use.py")]
    texts = {text for module in modules if module.stem != "fetch" for text in texts_of(module)}
    unread = set()
    for paper, about in json.loads((root / "data/sources.json").read_text()).items():
        for reader in about["readers"]:
            assert not reader["page"] or (root / f"notebooks/{reader['page']}.ipynb").is_file()
            folder, files = Path(paper, reader["files"]), [Path(paper, one["path"]) for one in about["files"]]
            files = [file for file in files if file.is_relative_to(folder)]
            assert files, f"{folder} has no file"
            for file in files:
                places = [place for place in (file, *file.parents) if place.is_relative_to(folder)]
                if not any(place.match(text) for place in places for text in texts):
                    unread.add((folder.name, reader["page"]))
    assert unread == {("LICENSE", "real_arm")}


def test_the_list_of_the_project_can_be_used():
    path = project_folder() / "data/sources.json"
    listed = [source.name for source in tool.read_sources(path)]
    assert len(listed) == len(set(listed)) > 0
    with pytest.raises(InputError, match="must be one of baaij2023, .*; instead received none"):
        tool.read_sources(path, "none")
    with pytest.raises(InputError, match="list of repro fetch must be an existing file"):
        tool.read_sources(path.with_name("none.json"))
