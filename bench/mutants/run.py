"""Whether the tests see a changed expression: make each change of ``mutants.toml`` in a copy, and run its tests.

``python bench/mutants/run.py [WORD ...]`` runs the mutants whose name or file contains a word, without words all of
them. First the tests have to pass on the unchanged copy. Exit code: 0 if every mutant is killed, else 1.
"""

from __future__ import annotations

import fcntl
import os
import re
import shutil
import subprocess
import sys
import time
import tomllib
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[2]
LIST = Path(__file__).with_name("mutants.toml")
LONGEST_S = 900.0
"""After this time tests count as failed: a changed expression may never end."""


def outcome(root: Path, work: Path, tests: list[str], change: dict[str, Any] | None = None) -> str:
    """Copy the sources, change them and run tests: ``killed``, ``survived``, or what is wrong with the mutant."""
    shutil.rmtree(work / "src", ignore_errors=True)
    # At one place and with their times, so that compiled kernels are found again; those of a changed one are new.
    shutil.copytree(root / "src", work / "src", ignore=shutil.ignore_patterns("__pycache__"))
    if change is not None:
        path = work / "src" / change["file"]
        text = path.read_text(encoding="utf-8") if path.is_file() else ""
        if (count := text.count(change["old"])) != 1 or change["old"] == change["new"]:
            return f"refused: the old expression is there {count} times"
        path.write_text(text.replace(change["old"], change["new"]), encoding="utf-8")
    sources = work / "src"
    places = {"PYTHONPATH": str(sources), "NUMBA_CACHE_DIR": str(work / "kernels")}
    # pytest puts the project's own sources first, unless it is told to take the copy.
    copied = f"pythonpath={root} {root / 'scripts'} {sources}"
    command = [sys.executable, "-m", "pytest", "-x", "-q", "-p", "no:cacheprovider", "-o", copied, *tests]
    try:
        done = subprocess.run(
            command, cwd=root, env=os.environ | places, capture_output=True, text=True, timeout=LONGEST_S
        )
    except subprocess.TimeoutExpired:
        return "killed"
    if done.returncode > 1 or (done.returncode and not re.search(r"\d (failed|error)", done.stdout)):
        return f"refused: the tests cannot be run\n{done.stdout[-2000:]}{done.stderr[-2000:]}"
    return "killed" if done.returncode else "survived"


def run(root: Path, mutants: list[dict[str, Any]], work: Path) -> int:
    """Print what becomes of each mutant; return the exit code."""
    work.mkdir(parents=True, exist_ok=True)
    with (work / "lock").open("w") as lock:
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            print(f"Another run is using {work}: wait for it to end.", file=sys.stderr)
            return 1
        before = outcome(root, work, sorted({test for mutant in mutants for test in mutant["tests"]}))
        if before != "survived":
            print("The tests do not pass without a change.", before.removeprefix("killed"), file=sys.stderr)
            return 1
        bad = 0
        for mutant in mutants:
            start = time.monotonic()
            found = outcome(root, work, mutant["tests"], mutant)
            bad += found != "killed"
            print(f"{time.monotonic() - start:6.1f} s  {mutant['name']}: {found}", flush=True)
    print(f"{len(mutants)} mutants, {bad} not killed")
    return int(bad > 0)


if __name__ == "__main__":
    listed = tomllib.loads(LIST.read_text(encoding="utf-8"))["mutant"]
    chosen = [m for m in listed if not sys.argv[1:] or any(w in m["name"] + m["file"] for w in sys.argv[1:])]
    sys.exit(run(ROOT, chosen, ROOT / ".cache" / "mutants") if chosen else "There is no such mutant.")
