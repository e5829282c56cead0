"""The recorder alone: with nothing but the packages of its own lock it records, exports, imports and emulates.

Each command runs in a process that refuses every other package that is installed here, as if it were not; or, with
`recorder_environment.py`, in an environment where no other is.
"""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
from importlib.metadata import packages_distributions
from pathlib import Path

import pandas as pd
import pytest
from edition1_live.record.recording_file import RecordingFile
from edition1_live.wire.frame import Frame
from mcap.reader import make_reader

pytestmark = pytest.mark.skipif(os.name != "posix", reason="pseudo-terminals")
ROOT = Path(__file__).parents[3]
ROBOT = str(ROOT / "data" / "robots" / "one_segment.toml")
PROGRAM = """
import sys
from importlib.abc import MetaPathFinder

class Refused(MetaPathFinder):
    names = frozenset({names!r})
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] in self.names:
            raise ModuleNotFoundError(f"No module named {{name!r}}", name=name)

sys.meta_path.insert(0, Refused())
from edition1_companion.cli import main
sys.exit(main())
"""

USED = """
import resource, subprocess, sys
done = subprocess.run(sys.argv[1:], stdout=subprocess.DEVNULL)
used = resource.getrusage(resource.RUSAGE_CHILDREN)
print(used.ru_utime + used.ru_stime, used.ru_maxrss / 1024)
sys.exit(done.returncode)
"""
"""A small process that starts a command: the memory of a process that starts one counts as its own until then."""
COMMANDS = (
    "--help",
    "record --help",
    "export --help",
    "import --help",
    "emulate --help",
    "record --list",
    "export a.rec -o b.csv",
    "export a.rec -o b.mcap",
    "import a.csv -o b.rec",
)
"""In the order in which they run; what one leaves behind is removed before the next."""
MODULES, MODULES_WITH_NUMPY = 300, 480
"""Most modules of a command that explains itself, and of one that reads a recording: 256 and 431 when written."""


def write_recording(path: Path) -> None:
    """Write a recording of a thousand frames, which the commands read."""
    with RecordingFile(path, {"format": "frames", "start_unix_s": 0.0, "start_host_ns": 0}) as file:
        for k in range(1000):
            file.append(k * 10**7, [Frame(0, k, 1000 * k, (1.5, -2.5, 3.5))])


def names_of(lock: str) -> set[str]:
    """Return the packages that a lock pins."""
    return set(re.findall(r"^([a-z0-9][a-z0-9._-]*)==", (ROOT / lock).read_text(), re.MULTILINE))


def refused() -> list[str]:
    """Return the modules of all installed packages that are not in the lock of the recorder."""
    allowed = names_of("requirements-recorder.lock")
    found = packages_distributions()
    names = [
        m
        for m, owners in found.items()
        if not m.startswith(("repro", "edition1"))
        and not {re.sub(r"[._]", "-", o.lower()) for o in owners} & allowed
    ]
    assert {"torch", "scipy", "numba", "magpylib", "rosbags", "matplotlib", "pandas"} <= set(names)
    return sorted(names)


@pytest.fixture(scope="module")
def program() -> list[str]:
    """Return what runs `repro` with these packages alone."""
    if fresh := os.environ.get("REPRO_RECORDER"):
        return ["env", "-u", "PYTHONPATH", fresh]
    return [sys.executable, "-c", PROGRAM.format(names=refused())]


def started(program: list[str], folder: Path, *arguments: str) -> subprocess.Popen[str]:
    """Start a command."""
    options = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
    return subprocess.Popen([*program, *arguments], cwd=folder, **options)


def called(program: list[str], folder: Path, *arguments: str) -> tuple[int, str, str]:
    """Run a command to its end."""
    process = started(program, folder, *arguments)
    out, err = process.communicate(timeout=60)
    return process.returncode, out, err


def test_both_locks_pin_the_same_versions():
    both = [
        set(re.findall(r"^[a-z0-9._-]+==[^\\\n]*", (ROOT / name).read_text(), re.MULTILINE))
        for name in ("requirements.lock", "requirements-recorder.lock")
    ]
    assert both[1] <= both[0]
    assert "torch" not in names_of("requirements-recorder.lock")


def test_from_an_emulated_board_to_files_and_back(program, tmp_path):
    board = started(program, tmp_path, "emulate", "lemniscate", "--loop", "--port-file", "board")
    try:
        assert board.stdout.readline() == "lemniscate T3 of one segment [mT], SYNTHETIC, as frames\n"
        assert board.stdout.readline() == f"Port: {tmp_path / 'board'}\n"
        code, out, err = called(program, tmp_path, "record", "board", "-o", "a.rec", "--duration", "1")
        assert (code, out) == (0, "a.rec\n"), err
    finally:
        board.send_signal(signal.SIGINT)
        assert board.communicate(timeout=20) == ("", "\n")
    for name in ("a.csv", "a.mcap"):
        code, out, err = called(program, tmp_path, "export", "a.rec", "-o", name)
        assert (code, err) == (0, ""), out
    table = pd.read_csv(tmp_path / "a.csv")
    with (tmp_path / "a.mcap").open("rb") as stream:
        readings = sum(1 for _ in make_reader(stream).iter_messages("/readings"))
    assert readings == len(table) > 20
    assert called(program, tmp_path, "import", "a.csv", "-o", "b.rec")[0] == 0
    assert called(program, tmp_path, "export", "b.rec", "-o", "b.csv")[0] == 0
    again = pd.read_csv(tmp_path / "b.csv")
    pd.testing.assert_frame_equal(again.drop(columns="unix_s"), table.drop(columns=["unix_s", "stream"]))


@pytest.mark.skipif("REPRO_RECORDER" not in os.environ, reason="for an environment of its own")
def test_starts_with_few_modules_and_80_mb(program, tmp_path):
    """What a start takes: modules and memory, also of a recording written as others read it, and back."""
    write_recording(tmp_path / "a.rec")
    assert called(program, tmp_path, "export", "a.rec", "-o", "a.csv")[0] == 0
    for command in COMMANDS:
        for written in tmp_path.glob("b.*"):
            written.unlink()
        counted = ["env", "PYTHONPROFILEIMPORTTIME=1", *program]
        code, out, err = called([sys.executable, "-c", USED, *counted], tmp_path, *command.split())
        assert code == 0, err
        megabytes, modules = float(out.split()[1]), err.count("import time:")
        print(f"{command:24} {modules} modules {megabytes:.0f} MB")
        assert modules <= (MODULES if "--help" in command else MODULES_WITH_NUMPY), command
        assert megabytes <= 80, command


@pytest.mark.parametrize("source", ["flower", "twin:T2", "arm"])
def test_built_in_courses(program, tmp_path, source):
    board = started(program, tmp_path, "emulate", source, "--port-file", "board")
    assert "SYNTHETIC" in board.stdout.readline()
    board.send_signal(signal.SIGINT)
    assert board.communicate(timeout=20)[1] == "\n"


@pytest.mark.parametrize(
    "arguments",
    [
        ("emulate", "--robot", ROBOT),
        ("emulate", "twin:T2", "--seed", "3"),
        ("live", "nothing", "--robot", ROBOT),
        ("track", "nothing", "--robot", ROBOT, "-o", "a.csv"),
    ],
)
def test_what_needs_torch_says_so_in_one_line(program, tmp_path, arguments):
    said = (
        "repro: This needs torch, which is not installed: the package without --no-deps brings it, "
        "its extra [book] what notebooks need.\n"
    )
    assert called(program, tmp_path, *arguments) == (2, "", said)
