"""What a result was made from: the key that decides whether a notebook runs again, and the record of a run.

The key depends on content only, never on modification times, and on everything a notebook could read: its own
text and parameters, all packages but the code of other pages, all files below ``data/``, all recordings found, the
lock and the versions installed. It may run a notebook once too often, never once too seldom.
"""

from __future__ import annotations

import importlib.metadata
import json
import os
import platform
import re
import shutil
import subprocess
from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

from edition1 import __version__
from edition1.files import write_whole
from edition1_companion.book.digests import combined_digest, file_digest, tree_digests
from edition1_companion.book.project import Project
from edition1_companion.recordings.sources import COMPILED_KERNELS, data_dir

LIBRARIES = ("torch", "numpy", "numba", "scipy", "magpylib", "matplotlib", "pandas", "papermill")
"""Libraries whose versions stand in every record."""

PACKAGES = ("edition1", "edition1_live", "edition1_companion")
"""What the project's code lies in."""
PAGES, AFTER = "edition1_companion/pages/", "edition1_companion/book/after/"
RECORD_SUFFIX = ".provenance.json"


@dataclass(frozen=True)
class Inputs:
    """Everything but the notebook itself that a result depends on."""

    sources: dict[str, str]
    """SHA-256 of each file of the packages."""
    data: dict[str, str]
    """SHA-256 of each file below ``data/``."""
    recordings: dict[str, str]
    """SHA-256 of each recording found."""
    lock: str
    """SHA-256 of the lock, empty without one."""
    python: str
    """Version of Python."""
    libraries: dict[str, str]
    """Versions of the libraries that compute."""


def read_inputs(project: Project) -> Inputs:
    """Hash everything but the notebook itself that a result depends on."""
    lock = project.root / "requirements.lock"
    sources = project.sources if project.sources.is_dir() else Path(__file__).parents[2]
    return Inputs(
        sources={
            f"{package}/{name}": digest
            for package in PACKAGES
            if (sources / package).is_dir()
            for name, digest in tree_digests(sources / package).items()
        },
        data=tree_digests(project.data),
        recordings=tree_digests(data_dir(), leave_out=[COMPILED_KERNELS]),
        lock=file_digest(lock) if lock.is_file() else "",
        python=platform.python_version(),
        libraries={name: _version(name) for name in LIBRARIES},
    )


def _version(library: str) -> str:
    try:
        return importlib.metadata.version(library)
    except importlib.metadata.PackageNotFoundError:
        return "not installed"


def version_lines() -> list[str]:
    """Return the versions of repro, Python and the libraries that compute, and where recordings are looked for."""
    return [
        f"repro {__version__}, Python {platform.python_version()}, {platform.platform()}",
        *(f"{name} {_version(name)}" for name in LIBRARIES),
        f"Recordings: {data_dir()}",
    ]


def processor() -> str:
    """Name of the processor's model: with the number of threads it decides the last digits of a training."""
    info = Path("/proc/cpuinfo")  # of Linux
    found = re.search(r"^model name\s*: (.*)$", info.read_text(), re.MULTILINE) if info.is_file() else None
    return found[1] if found else platform.processor() or platform.machine()


def notebook_key(notebook: Path, parameters: Mapping[str, Any], inputs: Inputs, project: Project) -> str:
    """Return the key of a notebook: 64 hexadecimal digits that change with anything its results depend on.

    Parameters
    ----------
    notebook
        The notebook; its bytes count, its name and place do not.
    parameters
        The parameters that differ from the notebook's own.
    inputs
        From :func:`read_inputs`; shared by all notebooks of a build.
    project
        Whose notebooks are pages: one of them does not depend on the code of other pages, and none on what runs
        after the notebooks. No module that it reaches may import those (import-linter). Any other notebook may.
    """
    if notebook.resolve().parent == project.notebooks.resolve():
        sources = {name: x for name, x in inputs.sources.items() if _reaches(notebook.stem, name)}
        inputs = replace(inputs, sources=sources)
    return combined_digest([file_digest(notebook), dict(parameters), asdict(inputs)])


def _reaches(page: str, source: str) -> bool:
    """Tell whether the notebook of a page can import a file of the packages."""
    if source.startswith(PAGES):
        return Path(source.removeprefix(PAGES)).parts[0] in (page, f"{page}.py", "__init__.py")
    return not source.startswith(AFTER)


@dataclass(frozen=True)
class Record:
    """What one finished run was made from and what it made; kept as ``<name>.provenance.json``."""

    notebook: str
    parameters: dict[str, Any]
    key: str
    code: dict[str, Any]
    """``commit`` and ``dirty`` (uncommitted changes), or ``source archive`` with a hash of the package."""
    python: str
    libraries: dict[str, str]
    data: dict[str, Any]
    """``source`` (where recordings were looked for) and ``recordings`` (their hashes)."""
    started: str
    """Date and time, UTC."""
    seconds: float
    results: dict[str, str]
    """SHA-256 of each table that the run wrote."""
    executed: str
    """SHA-256 of the executed notebook."""


def make_record(
    project: Project,
    notebook: Path,
    parameters: Mapping[str, Any],
    inputs: Inputs,
    *,
    started: str,
    seconds: float,
    results: dict[str, str],
    executed: str,
) -> Record:
    """Return the record of a finished run; the arguments are the fields of :class:`Record`."""
    inside = notebook.resolve().is_relative_to(project.root.resolve())
    return Record(
        notebook=notebook.resolve().relative_to(project.root.resolve()).as_posix()
        if inside
        else notebook.name,
        parameters=dict(parameters),
        key=notebook_key(notebook, parameters, inputs, project),
        code=_code_version(project, inputs),
        python=inputs.python,
        libraries=inputs.libraries,
        data={"source": _data_source(inputs), "recordings": inputs.recordings},
        started=started,
        seconds=round(seconds, 1),
        results=results,
        executed=executed,
    )


def _data_source(inputs: Inputs) -> str:
    place = "REPRO_DATA_DIR" if os.environ.get("REPRO_DATA_DIR") else "the user's cache"
    return place if inputs.recordings else f"none found in {place}"


def _code_version(project: Project, inputs: Inputs) -> dict[str, Any]:
    commit = _git(project, "rev-parse", "--verify", "--quiet", "HEAD")
    if not commit:
        return {"source archive": combined_digest(inputs.sources)}
    return {"commit": commit, "dirty": bool(_git(project, "status", "--porcelain"))}


def _git(project: Project, *arguments: str) -> str:
    # A project unpacked inside somebody else's repository must not report that repository's commit.
    if not (project.root / ".git").exists() or shutil.which("git") is None:
        return ""
    command = ["git", "-C", str(project.root), *arguments]
    return subprocess.run(command, capture_output=True, text=True, check=False).stdout.strip()


def record_path(executed: Path) -> Path:
    """Return where the record of an executed notebook lies: beside it."""
    return executed.with_name(f"{executed.stem}{RECORD_SUFFIX}")


def write_record(record: Record, path: Path) -> None:
    """Write a record as JSON, whole or not at all."""
    write_whole(path, json.dumps(asdict(record), indent=1, sort_keys=True) + "\n")


def read_record(path: Path) -> Record | None:
    """Return the record at a path; None where there is none, or none that this version can read."""
    try:
        return Record(**json.loads(path.read_text(encoding="utf-8")))
    except (FileNotFoundError, ValueError, TypeError, RecursionError):
        return None
