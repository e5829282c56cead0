"""What this computer is and what lies here, in plain text: to be shown with "a number differs on my machine"."""

from __future__ import annotations

import importlib.metadata
import os
import platform
import re
from collections.abc import Iterator

from edition1.errors import InputError
from edition1_live.record.ports import listing as ports

from edition1 import __version__
from edition1_companion.book.digests import file_digest
from edition1_companion.book.project import Project, find_project
from edition1_companion.book.provenance import LIBRARIES, RECORD_SUFFIX, processor, read_record

SETTINGS = (
    "OMP_NUM_THREADS",
    "OPENBLAS_NUM_THREADS",
    "MKL_NUM_THREADS",
    "NUMBA_NUM_THREADS",
    "OPENBLAS_CORETYPE",
    "NPY_DISABLE_CPU_FEATURES",
)
"""Variables that can change the last digits of a result."""
TROUBLE = "! "
"""What a line begins with that calls for something."""


def report() -> list[str]:
    """Return the lines; those that begin with :data:`TROUBLE` say what is not as it should be."""
    lines = [
        f"repro {__version__}, Python {platform.python_version()}, {platform.platform()}",
        f"Processor: {processor()}, {os.cpu_count()} cores",
        f"Set: {', '.join(f'{x}={os.environ[x]}' for x in SETTINGS if x in os.environ) or 'nothing'}",
        f"Serial ports: {ports()}",
    ]
    try:
        project = find_project()
    except InputError:
        return [*lines, *_libraries({}), "No checkout of the project here: no recordings, no results."]
    lock = project.root / "requirements.lock"
    pins = pinned(lock.read_text(encoding="utf-8")) if lock.is_file() else {}
    return [*lines, *_libraries(pins), *_recordings(project), *_results(project)]


def pinned(lock: str) -> dict[str, set[str]]:
    """Return which versions of a package a lock names; there may be one for each version of Python."""
    found: dict[str, set[str]] = {}
    for name, version in re.findall(r"^([\w.-]+)==([^\s;]+)", lock, re.MULTILINE):
        found.setdefault(name.lower(), set()).add(version)
    return found


def _libraries(pins: dict[str, set[str]]) -> Iterator[str]:
    for name in LIBRARIES:
        try:
            version = importlib.metadata.version(name)
        except importlib.metadata.PackageNotFoundError:
            version = "not installed"
        if name in pins and version not in pins[name]:
            yield f"{TROUBLE}{name} {version}; the lock has {' or '.join(sorted(pins[name]))}"
        else:
            yield f"{name} {version}"


def _recordings(project: Project) -> Iterator[str]:
    from edition1_companion.recordings.download import listing
    from edition1_companion.recordings.sources import data_dir, read_sources

    place = "REPRO_DATA_DIR" if os.environ.get("REPRO_DATA_DIR") else "the user's cache"
    manifest = project.data / "sources.json"
    yield f"Recordings in {place}:"
    if manifest.is_file():
        yield from (f"  {line}" for line in listing(read_sources(manifest), data_dir()).splitlines())


def _results(project: Project) -> Iterator[str]:
    from edition1_companion.book.scorecard import changed_verdicts, compute_scorecard

    records = sorted(project.results.glob(f"*{RECORD_SUFFIX}"))
    if not records:
        yield "Results: none yet; `make book` computes them."
        return
    broken, count = [], 0
    for path in records:
        record = read_record(path)
        for table, digest in (record.results if record else {}).items():
            file, count = project.results / table, count + 1
            if not file.is_file() or file_digest(file) != digest:
                broken.append(f"{TROUBLE}results/{table} is not what {path.name} says was written")
    yield f"Results: {count} tables"
    yield from broken
    reference = project.data / "scorecard_reference.csv"
    if reference.is_file():
        changed = changed_verdicts(compute_scorecard(project), reference)
        yield f"Verdicts other than in data/{reference.name}: {len(changed)}"
        yield from (f"{TROUBLE}{line}" for line in changed)
